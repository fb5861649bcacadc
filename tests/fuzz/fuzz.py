"""Coverage-guided fuzzing of one target: `python tests/fuzz/fuzz.py TARGET [SECONDS] [REPRODUCER]
[-FLAG=VALUE...]`. Of several, `TARGET,TARGET...`, in turn; what each says is in TARGET.log, and
exit codes are printed.

Ends with an error when a target raises anything but PostfxError, computes for more than 10 seconds
on one input, takes more than 2 GiB in all, opens a file outside of its folder, or ends the process;
the input is written to the folder of POSTFX_FUZZ_OUT (by default where it runs). Flags are
libFuzzer's: -seed=7 draws other inputs, -runs=500 counts them.
"""

from __future__ import annotations

import os
import shutil
import sys
import tempfile
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

CHECKOUT = Path(__file__).resolve().parents[2]
WATCHED = ["postfx.io", "postfx.masks", "postfx.cli.run_options", "postfx.system", "postfx.files",
           "postfx.runs", "postfx.passes.tonemap", "postfx.runtime.models",
           "postfx.runtime.model_file"]
SECONDS, MOST_MB, LONGEST_INPUT = 5, 2048, 1 << 16
LONGEST_S = 10
"""Of computing, for one input: by the clock a busy machine takes as long as it likes."""
HANGS_S = 120
"""By the clock, for one input: what waits computes nothing."""
OPENING = {"open", "os.listdir", "os.scandir", "os.mkdir", "os.remove", "os.rename", "os.rmdir",
           "os.utime"}
"""Python's audit events of what reads or changes the disk."""


class Fence:
    """Notes which files outside of some folders are opened: what lies on a machine must not decide
    what comes out."""

    def __init__(self, *folders: str) -> None:
        self.outside: set[str] = set()
        self._folders = {os.path.realpath(folder) for folder in folders} | {*folders}
        sys.addaudithook(self._note)

    def _note(self, event: str, arguments: tuple[object, ...]) -> None:
        if event in OPENING and isinstance(arguments[0], str | bytes | os.PathLike):
            path = os.path.abspath(os.fsdecode(arguments[0]))
            if not any(path == folder or path.startswith(f"{folder}/") for folder in self._folders):
                self.outside.add(path)


def limit(target: Callable[[bytes], None], fence: Fence) -> Callable[[bytes], None]:
    """A target that fails, too, when it opens a file outside or computes for long."""
    from postfx.errors import PostfxError

    def attempt(content: bytes) -> None:
        begin = time.process_time()
        fence.outside.clear()
        try:
            target(content)
        except PostfxError as error:
            assert str(error), "an error without a word"
        assert not fence.outside, f"looked at {sorted(fence.outside)}"
        assert (took := time.process_time() - begin) < LONGEST_S, f"computed for {took:.1f} s"

    return attempt


def make_home() -> Path:
    """A folder for all that a run reads and writes, in memory if there is room: also a user's
    cache, where networks of earlier runs would decide, with links to the compiled kernels of the
    user's, which only their sources do."""
    in_memory = os.path.isdir("/dev/shm") and shutil.disk_usage("/dev/shm").free > MOST_MB << 18
    home = Path(tempfile.mkdtemp(prefix="postfx-fuzz-", dir="/dev/shm" if in_memory else None))
    for folder in ("work", "corpus", "cache/postfx"):
        (home / folder).mkdir(parents=True)
    cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "postfx"
    (cache / "native").mkdir(mode=0o700, parents=True, exist_ok=True)
    for kernels in cache.glob("native*"):
        (home / "cache/postfx" / kernels.name).symlink_to(kernels.resolve())
    return home


def fuzz(name: str, seconds: str, reproducers: list[str], flags: list[str], home: Path) -> None:
    """Fuzz in a folder of its own; ends the process."""
    import atheris

    from postfx.errors import PostfxError
    from tests.fuzz import targets

    out = os.path.abspath(os.environ.get("POSTFX_FUZZ_OUT", "."))
    given = [os.path.abspath(path) for path in reproducers] or [str(home / "corpus")]
    os.environ |= {"TMPDIR": str(home), "XDG_CACHE_HOME": str(home / "cache")}
    tempfile.tempdir = None
    os.chdir(home / "work")
    os.getpid = lambda: 1  # a number of its own would change what is tried from a seed
    with atheris.instrument_imports(include=WATCHED):
        targets.seeds(name, home / "corpus")
        target = targets.TARGETS[name]
        # imports what is left, and compiles: no input's time
        for seed in sorted((home / "corpus").iterdir()):
            with suppress(PostfxError):
                target(seed.read_bytes())
    fence = Fence(str(home), *filter(None, sys.path), sys.prefix, sys.base_prefix, "/proc",
                  "/dev/fd")
    limits = [f"-max_total_time={seconds}", f"-timeout={HANGS_S}", f"-rss_limit_mb={MOST_MB}",
              f"-max_len={LONGEST_INPUT}", f"-artifact_prefix={out}/", "-print_final_stats=1",
              "-close_fd_mask=0"]
    atheris.Setup([sys.argv[0], *limits, *flags, *given], limit(target, fence))
    atheris.Fuzz()


def attempt(name: str, seconds: str, reproducers: list[str], flags: list[str],
            log: Path | None) -> int:
    """Exit code of a process that fuzzes a target: libFuzzer ends its process at once, and leaves
    its files."""
    home = make_home()
    if child := os.fork():
        code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
        shutil.rmtree(home, ignore_errors=True)
        return code if code >= 0 else 128 - code
    if log:
        os.dup2(os.open(log, os.O_WRONLY | os.O_CREAT | os.O_TRUNC), 2)
    fuzz(name, seconds, reproducers, flags, home)
    return 1


def main(words: list[str]) -> int:
    """Fuzz what the command line names; exit code."""
    import atheris

    flags = [word for word in words if word.startswith("-")]
    names, *others = [word for word in words if word not in flags]
    sys.path.insert(0, str(CHECKOUT))
    with atheris.instrument_imports(include=WATCHED):
        from tests.fuzz import targets  # noqa: F401 - once for all targets
    seconds, reproducers, codes = others[0] if others else str(SECONDS), others[1:], {}
    for name in names.split(","):
        log = Path(os.environ.get("POSTFX_FUZZ_OUT", "."), f"{name}.log") if "," in names else None
        codes[name] = attempt(name, seconds, reproducers, flags, log)
    if "," in names:
        print(*(f"{name} {code}" for name, code in codes.items()), sep="\n")
    return max(codes.values())


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
