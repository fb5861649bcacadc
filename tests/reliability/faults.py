"""Faults by groups, injected one by one and counted: `python -m tests.reliability.faults [GROUP...]
[--share 1]`.

Prints a row of a table for each group: faults that were injected, and those that were survived.
Survived means: exit code 0, or one line that says what is wrong, without a traceback, a hang or a
file that is not whole; and after a run that was stopped, the next one ends with the very bytes of
one that nothing happened to. What did not survive is printed below, and the exit code is then 1.
`--share 0.1` injects a tenth of each group; `--at-once 4` that many at a time. With `--denoised`
runs denoise by the network that they choose themselves; else their passes take no time.
"""

from __future__ import annotations

import argparse
import ast
import os
import shutil
import signal
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from itertools import count, product
from pathlib import Path

from postfx.compiled import build
from postfx.errors import PostfxError
from postfx.runs.manifest import MANIFEST_NAME, verify
from postfx.runtime import Device, Library
from tests.fuzz.bombs import BOMBS
from tests.fuzz.mutate import KINDS
from tests.reliability.conftest import FRAMES, QUICK, write_frame
from tests.reliability.faulty import DAMAGE, WRITE, Fault, Faulty
from tests.reliability.model_files import model_of, outside

ROOT = Path(__file__).resolve().parents[2]
READ = "postfx.io.sequence.Sequence.read"
ENCODE = "postfx.io.writer.write_exr"
PREVIEW = "postfx.cli.job.Job.preview"
MANIFEST = "postfx.runs.manifest.write_atomically"
CHECKPOINT = "postfx.runs.folder.write_atomically"
DENOISED = ("--denoise-only", "--threads", "1")
"""Passes that keep the render's size, where a run takes the largest network."""
HANGS_S = 300
"""After which a run on a busy machine counts as one that hangs."""
HOUR, DAY = 3600.0, 86400.0
OUTSIDE = ("/etc/hostname", "/dev/zero", "/proc/self/mem", "../secret.bin", "../../etc/passwd",
           "a/../../secret.bin", "./../secret.bin", "~/secret.bin", "//secret.bin",
           "\\\\host\\share", "C:\\secret.bin", "link.bin",
           "folder.bin", "pipe.bin", "", ".", "..", "a\0b")
"""Where weights of a network that someone sent might be said to lie."""


class Shot:
    """Frames of a shot in a folder of their own, and what a run makes of them that nothing happens
    to."""

    def __init__(self, folder: Path, passes: tuple[str, ...] = QUICK) -> None:
        self.folder, self.passes, self._numbers = folder, passes, count(1)
        (folder / "in").mkdir()
        for number in range(1, FRAMES + 1):
            write_frame(folder / f"in/in.{number:04d}.exr", number)
        self.whole = self.files_of(self.run(folder / "whole"))

    @staticmethod
    def files_of(folder: Path) -> dict[str, bytes]:
        return {path.name: path.read_bytes() for path in sorted(folder.glob("out.*.exr"))}

    def new_folder(self) -> Path:
        folder = self.folder / f"run {next(self._numbers)}"
        folder.mkdir()
        return folder

    def start(self, words: list[str], *faults: Fault) -> Faulty:
        return Faulty(list(faults), words, self.folder / f"said {next(self._numbers)}.txt")

    def words(self, folder: Path, *more: str, shot: str = "") -> list[str]:
        return ["run", shot or str(self.folder / "in/in.####.exr"), "-o",
                str(folder / "out.####.exr"), *self.passes, *more]

    def run(self, folder: Path, *more: str) -> Path:
        """A run that nothing happens to."""
        code, said = self.start(self.words(folder, *more)).finished(HANGS_S)
        assert code == 0, said
        return folder

    def goes_on(self, folder: Path) -> None:
        """The next run ends with the bytes of one that nothing happened to, and leaves nothing else
        behind."""
        assert all(self.whole[name] == content
                   for name, content in self.files_of(folder).items()), "half a file"
        self.run(folder, "--skip-existing")
        assert self.files_of(folder) == self.whole, "other bytes"
        assert sorted(path.name
                      for path in folder.iterdir()) == [*self.whole, MANIFEST_NAME], "left-overs"
        assert verify(folder).is_well, "verify"


def in_words(code: int, said: str) -> None:
    """Whether a run ended well, or with an error in words."""
    assert code in (0, 2, 3), f"exit code {code}: {said[-300:]}"
    assert "Traceback" not in said, said[-600:]
    assert code == 0 or "error: " in said or "left out" in said or "could not" in said, said[-300:]


def kills(shot: Shot, at: tuple[str, ...], calls: range) -> Iterator[Callable[[], None]]:
    for place, call, when in product(at, calls, ("before", "after")):
        def kill(place: str = place, call: int = call, when: str = when) -> None:
            folder = shot.new_folder()
            fault: Fault = {"at": place, "do": "kill", "calls": [call], "when": when}
            code, said = shot.start(shot.words(folder, "--checkpoint", "0"),
                                    fault).finished(HANGS_S)
            assert code in (0, -signal.SIGKILL), said[-300:]
            shot.goes_on(folder)
        yield kill


def killed_runs(shot: Shot) -> Iterator[Callable[[], None]]:
    yield from kills(shot, (READ, WRITE, ENCODE), range(1, FRAMES + 1))
    yield from kills(shot, (MANIFEST, CHECKPOINT, "os.replace", "os.fsync"), range(1, 4))


def failing_disks(shot: Shot) -> Iterator[Callable[[], None]]:
    for place, call in product((READ, ENCODE, MANIFEST, CHECKPOINT), (1, 2, 5, FRAMES)):
        def fail(place: str = place, call: int = call) -> None:
            folder = shot.new_folder()
            kind = "fail" if place == READ else "full"
            faults: Fault = {"at": place, "do": kind, "calls": [call]}
            in_words(*shot.start(shot.words(folder, "--checkpoint", "0"), faults).finished(HANGS_S))
            shot.goes_on(folder)
        yield fail


def rewritten_inputs(shot: Shot) -> Iterator[Callable[[], None]]:
    """What is read is one frame or the other, and each file is whole; a run of the old inputs makes
    all good again."""
    for how, number in product(DAMAGE, (3, 6)):
        def rewrite(how: str = how, number: int = number) -> None:
            folder = shot.new_folder()
            source = Path(shutil.copytree(shot.folder / "in",
                                          folder.with_name(f"{folder.name} in")))
            fault: Fault = {"at": READ, "do": "damage", "how": how, "calls": [2],
                     "file": str(source / f"in.{number:04d}.exr")}
            words = shot.words(folder, shot=str(source / "in.####.exr"))
            in_words(*shot.start(words, fault).finished(HANGS_S))
            found = verify(folder) if (folder / MANIFEST_NAME).exists() else None
            assert found is None or not (found.altered or found.missing or found.unknown), "verify"
            # the first frames' history is of later ones, as far as these can be read
            if how != "of one frame later" and shot.passes is not DENOISED:
                others = {name: content for name, content in shot.files_of(folder).items()
                          if int(name.split(".")[1]) < number}
                assert all(shot.whole[name] == content
                           for name, content in others.items()), "other bytes"
        yield rewrite


def deleted_outputs(shot: Shot) -> Iterator[Callable[[], None]]:
    for how, number in product(("gone", "emptied", "cut short"), (2, 4)):
        def delete(how: str = how, number: int = number) -> None:
            folder = shot.new_folder()
            fault: Fault = {"at": WRITE, "do": "damage", "how": how, "calls": [number + 2],
                     "file": str(folder / f"out.{number:04d}.exr")}
            in_words(*shot.start(shot.words(folder), fault).finished(HANGS_S))
            found = verify(folder)
            assert not found.is_well, "verify did not see it"
            shot.run(folder, "--skip-existing")
            assert shot.files_of(folder) == shot.whole, "other bytes"
        yield delete


def clocks(shot: Shot) -> Iterator[Callable[[], None]]:
    for seconds, call in product((1.0, DAY, 20_000 * DAY, -DAY), (1, 4)):
        def turn(seconds: float = seconds, call: int = call) -> None:
            folder = shot.new_folder()
            clock = {"at": READ, "do": "clock", "seconds": seconds, "calls": [call]}
            kill: Fault = {"at": WRITE, "do": "kill", "calls": [6]}
            code, said = shot.start(shot.words(folder, "--checkpoint", "0"), clock,
                                    kill).finished(HANGS_S)
            assert code == -signal.SIGKILL, said[-300:]
            shot.goes_on(folder)
        yield turn


def slow_disks(shot: Shot) -> Iterator[Callable[[], None]]:
    for place, call in product((READ, ENCODE, MANIFEST), (1, 4)):
        def slow(place: str = place, call: int = call) -> None:
            folder = shot.new_folder()
            fault: Fault = {"at": place, "do": "sleep", "seconds": 1.0, "calls": [call]}
            code, said = shot.start(shot.words(folder), fault).finished(HANGS_S)
            assert code == 0, said[-300:]
            shot.goes_on(folder)
        yield slow


def four_at_once(shot: Shot) -> Iterator[Callable[[], None]]:
    """Of the same frames: one of them makes them; of frames of their own: each makes its own."""
    ranges = (("1-8",) * 4, ("1-2", "3-4", "5-6", "7-8"), ("1-8", "1-8", "3-4", "5-8"))
    for frames, doomed in product(ranges, (None, 0, 1)):
        def race(frames: tuple[str, ...] = frames, doomed: int | None = doomed) -> None:
            folder = shot.new_folder()
            kill: Fault = {"at": WRITE, "do": "kill", "calls": [1], "when": "after"}
            runs = [shot.start(shot.words(folder, "--skip-existing", "--frames", some, "--preroll",
                                          str(int(some[0]) - 1)), *([kill] * (number == doomed)))
                    for number, some in enumerate(frames)]
            for number, run in enumerate(runs):
                code, said = run.finished(HANGS_S)
                if number != doomed or code != -signal.SIGKILL:
                    in_words(code, said)
            shot.goes_on(folder)
        yield race


def killed_watches(shot: Shot) -> Iterator[Callable[[], None]]:
    for place, call in product((PREVIEW, READ, WRITE, ENCODE), (1, 5)):
        def kill(place: str = place, call: int = call) -> None:
            folder = shot.new_folder()
            words = ["watch", str(shot.folder / "in"), "-o", str(folder / "out.####.exr"),
                     "--settle", "0.05", "--until", str(FRAMES), "--", *shot.passes]
            code, said = shot.start(words,
                                    {"at": place, "do": "kill", "calls": [call]}).finished(HANGS_S)
            assert code == -signal.SIGKILL, said[-300:]
            done = shot.files_of(folder)
            code, said = shot.start(words).finished(HANGS_S)
            made = shot.files_of(folder)
            assert code == 0 and len(made) == FRAMES, said[-300:]
            assert all(made[name] == content for name, content in done.items()), "half a file"
            assert not [path.name
                        for path in folder.iterdir() if path.name not in made], "left-overs"
        yield kill


def killed_chunks(shot: Shot) -> Iterator[Callable[[], None]]:
    """Two chunks of four frames; one of them is killed, and taken again."""
    for place, call, chunk in product((READ, WRITE, ENCODE), (2,), (0, 1)):
        def kill(place: str = place, call: int = call, chunk: int = chunk) -> None:
            folder = shot.new_folder()
            words = [shot.words(folder, "--checkpoint", "0", "--frames", frames)
                     for frames in ("1-4", "5-8")]
            code, said = shot.start(words[1 - chunk]).finished(HANGS_S)
            assert code == 0, said[-300:]
            fault: Fault = {"at": place, "do": "kill", "calls": [call]}
            code, said = shot.start(words[chunk], fault).finished(HANGS_S)
            assert code == -signal.SIGKILL, said[-300:]
            check = ["verify", str(folder), "--frames", "1-8"]
            assert shot.start(check).finished(HANGS_S)[0] == 1, "verify did not see what is missing"
            code, said = shot.start([*words[chunk], "--skip-existing"]).finished(HANGS_S)
            assert code == 0, said[-300:]
            assert (shot.start(check).finished(HANGS_S)[0] == 0
                    and len(shot.files_of(folder)) == FRAMES)
        yield kill


def outside_weights(shot: Shot) -> Iterator[Callable[[], None]]:
    """A network whose weights are said to lie outside of its folder is refused before anything is
    opened."""
    for place in OUTSIDE:
        def load(place: str = place) -> None:
            folder = shot.new_folder() / "models"
            folder.mkdir()
            (folder.parent / "secret.bin").write_bytes(bytes(16))
            (folder / "link.bin").symlink_to("../secret.bin")
            (folder / "folder.bin").mkdir()
            os.mkfifo(folder / "pipe.bin")
            (folder / "bad.onnx").write_bytes(model_of(weights=[outside(place)])
                                              .SerializeToString())
            try:
                Device("cpu", threads=1).pipeline_state(Library(folder), "bad", {"height": 4})
            except PostfxError as error:
                assert str(error).count("\n") == 0, str(error)
                return
            raise AssertionError("it was loaded")
        yield load


def _flip(path: Path) -> None:
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    path.write_bytes(content)


def _put_pipe(path: Path) -> None:
    path.unlink()
    os.mkfifo(path)


def _put_folder(path: Path) -> None:
    path.unlink()
    path.mkdir()


def _put_dangling(path: Path) -> None:
    path.unlink()
    path.symlink_to("nowhere/else")


COMPILED = ("*.json", "*.so", "*.lock", "objects/*.o")
"""Kinds of files in the folder of compiled kernels."""
IN_PLACE = (lambda path: path.write_bytes(b""), lambda path: path.write_text("[" * 100_000), _flip,
            _put_pipe, _put_folder, _put_dangling)
"""What may have become of one of them."""
KERNEL = """#include "rows.h"
static void halve_rows(Long first, Long last, View<const float, 2> given, View<float, 2> made) {
    for (Long y = first; y < last; y++) made(y)[0] = given(y)[0] / 2;
}
EXPORT(halve, halve_rows)
"""


def damaged_kernels(shot: Shot) -> Iterator[Callable[[], None]]:
    """Compiled kernels of which a file is damaged are made again, to the bit."""
    target = build.this_target()
    lowest = next(iter(build.TARGETS[target].levels))
    for kind, damaged in product(COMPILED, IN_PLACE):
        def make_again(kind: str = kind, damaged: Callable[[Path], object] = damaged) -> None:
            folder = shot.new_folder()
            (folder / "halve.cpp").write_text(KERNEL)
            units, made = [folder / "halve.cpp"], folder / "made"
            before = build.build(units, target, made, [lowest])[lowest].read_bytes()
            for path in made.glob(kind):
                if path.stat().st_size or damaged is not _flip:
                    damaged(path)
            if kind == "objects/*.o":  # so that it is linked again
                next(made.glob("*.json")).unlink()
            assert build.build(units, target, made, [lowest])[lowest].read_bytes() == before
        yield make_again


@dataclass(frozen=True)
class Group:
    """Faults of a kind: `make` gives a function for each, which raises AssertionError where it is
    not survived; of damage in a process of its own, `damaged` names the kind of `tests.fuzz.mutate`
    and how many there are."""

    title: str
    make: Callable[[Shot], Iterator[Callable[[], None]]] | None = None
    damaged: tuple[str, int] = ("", 0)


GROUPS = {
    "exr": Group("EXR files with bytes changed, cut, doubled or swapped", damaged=("exr", 500)),
    "hdr": Group("Radiance files, likewise", damaged=("hdr", 100)),
    "cryptomatte": Group("manifests of ids, in the header and beside it",
                         damaged=("cryptomatte", 100)),
    "settings": Group("`postfx.toml`", damaged=("settings", 120)),
    "profile": Group("profiles of renderers", damaged=("profile", 60)),
    "cube": Group("`.cube`", damaged=("cube", 60)),
    "spi3d": Group("`.spi3d`", damaged=("spi3d", 50)),
    "csp": Group("`.csp`", damaged=("csp", 50)),
    "records": Group("manifests of runs, claims, locks, checkpoints", damaged=("records", 60)),
    "model": Group("networks and their cards", damaged=("model", 60)),
    "bomb": Group("files that claim much, or become much", damaged=("bomb", len(BOMBS))),
    "weights": Group("weights of a network outside of its folder", outside_weights),
    "kernels": Group("files of compiled kernels, in place of which others lie", damaged_kernels),
    "killed": Group("`run` killed, at seven places", killed_runs),
    "disk": Group("reads that fail and full disks", failing_disks),
    "inputs": Group("inputs rewritten while a run reads them", rewritten_inputs),
    "outputs": Group("outputs deleted while a run writes others", deleted_outputs),
    "clock": Group("a clock that goes back or ahead, then a kill", clocks),
    "slow": Group("a slow disk", slow_disks),
    "four": Group("four runs into one folder, one of them killed", four_at_once),
    "watch": Group("`watch` killed", killed_watches),
    "chunks": Group("a chunk killed, then `verify`", killed_chunks),
}


def damage(kind: str, count: int) -> tuple[int, list[str]]:
    """How many damaged inputs were read or refused in a line, and what happened to the others."""
    survived, first = 0, 0
    faults: list[str] = []
    with tempfile.TemporaryDirectory() as folder:
        while first < count:
            done = subprocess.run([sys.executable, "-m", "tests.fuzz.mutate", kind,
                                   str(count - first), str(first)],
                                  cwd=folder, capture_output=True, text=True, check=False,
                                  errors="replace", env={**os.environ, "PYTHONPATH": str(ROOT)})
            if done.returncode == 0:
                return (survived + sum(ast.literal_eval(done.stdout.splitlines()[-1]).values()),
                        faults)
            at = int((Path(folder) / "at").read_text())
            faults.append(f"{kind} {at}: {done.stderr[-300:]}")
            survived, first = survived + at - first, at + 1
    return survived, faults


def attempted(name: str, number: int, attempt: Callable[[], None]) -> tuple[int, list[str]]:
    """1 where a fault was survived, and what happened where it was not."""
    try:
        attempt()
    except (AssertionError, OSError) as error:
        return 0, [f"{name} {number}: {type(error).__name__} {error}"]
    return 1, []


def main(names: list[str], share: float, at_once: int, passes: tuple[str, ...] = QUICK) -> int:
    folder = Path(tempfile.mkdtemp(prefix="postfx faults "))
    chosen = names or list(GROUPS)
    begun: dict[str, list[Future[tuple[int, list[str]]]]] = {}
    counts: dict[str, int] = {}
    with ThreadPoolExecutor(at_once) as pool:
        shot = Shot(folder, passes) if any(GROUPS[name].make for name in chosen) else None
        for name in chosen:
            make, (kind, most) = GROUPS[name].make, GROUPS[name].damaged
            assert make or kind in KINDS, name
            if make is None or shot is None:
                counts[name] = max(1, round(share * most))
                begun[name] = [pool.submit(damage, kind, counts[name])]
                continue
            attempts = list(make(shot))[::max(1, round(1 / share))]
            counts[name] = len(attempts)
            begun[name] = [pool.submit(attempted, name, number, attempt)
                           for number, attempt in enumerate(attempts)]
        survived, told = 0, list[str]()
        print("| faults | injected | survived | group |\n| --- | --- | --- | --- |")
        for name in chosen:
            found = [one.result() for one in begun[name]]
            well = sum(count for count, _ in found)
            survived += well
            told += [line for _, lines in found for line in lines]
            print(f"| {GROUPS[name].title} | {counts[name]} | {well} | `{name}` |", flush=True)
    print(f"| all | {sum(counts.values())} | {survived} | |", *told, sep="\n")
    shutil.rmtree(folder, ignore_errors=True)
    return 1 if told else 0


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("groups", nargs="*", metavar="GROUP")
    parser.add_argument("--share", type=float, default=1.0)
    parser.add_argument("--at-once", type=int, default=2)
    parser.add_argument("--denoised", action="store_true")
    given = parser.parse_args()
    sys.exit(main(given.groups, given.share, given.at_once,
                  DENOISED if given.denoised else QUICK))
