"""Compiles the kernels' C++ by ziglang, for this machine or any other: one shared library for each level of a
processor, in a folder with an index, which is written last.

Only the standard library is used, and nothing else of this package: a build hook runs this file by itself.
"""

from __future__ import annotations

import hashlib
import importlib.util
import json
import os
import platform
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, NamedTuple

HERE = Path(__file__).resolve().parent
PACKAGED = HERE.parent / "_native"
"""The libraries of a wheel, or of a checkout."""
ZIG = "0.17.1"
"""The compiler's version; another one may give other bits. `pyproject.toml` has the same."""
FLAGS = (
    "-std=c++20", "-O3", "-shared", "-fPIC", "-s", "-fvisibility=hidden", "-fno-exceptions", "-fno-rtti",
    "-ffp-contract=on",  # a * b + c becomes one instruction where the source says so, not where a compiler likes
    "-fno-math-errno", "-fno-trapping-math", "-fno-sanitize=all", "-Wall", "-Wextra", "-Werror", "-Wno-psabi",
)
X86_64 = {"baseline": "x86_64", "v3": "x86_64_v3", "v4": "x86_64_v4", "vnni": "x86_64_v4+avx512vnni"}
"""Levels and what the compiler calls them, the lowest first; `level.cpp` counts in this order."""
UNUSED = 7 * 86400
"""Seconds after which libraries of other sources are removed."""


class Target(NamedTuple):
    """A kind of machine: the compiler's name, levels, ending of a library, a wheel's tag, and what else to link."""

    name: str
    levels: dict[str, str]
    suffix: str
    tag: str
    flags: tuple[str, ...] = ()


ALONE = ("-nostdlib",)
"""On Linux, what a kernel calls of C's library is found in the process: nothing is linked, which takes seconds less."""
TARGETS = {
    "linux-x86_64": Target("x86_64-linux-gnu.2.28", X86_64, ".so", "manylinux_2_28_x86_64", ALONE),
    "linux-aarch64": Target("aarch64-linux-gnu.2.28", {"baseline": "generic"}, ".so", "manylinux_2_28_aarch64",
                            ALONE),
    "macos-arm64": Target("aarch64-macos.11.0", {"baseline": "apple_m1"}, ".dylib", "macosx_11_0_arm64",
                          ("-nostdlib++",)),
    "macos-x86_64": Target("x86_64-macos.11.0", X86_64, ".dylib", "macosx_11_0_x86_64", ("-nostdlib++",)),
    "windows-x86_64": Target("x86_64-windows-gnu", X86_64, ".dll", "win_amd64", ("-nostdlib++",)),
}


class CannotBuild(Exception):
    """There is no compiler, or it found a fault."""


def this_target() -> str:
    """The target's name of this machine. Raises CannotBuild if it is none of them."""
    system = {"linux": "linux", "darwin": "macos", "win32": "windows"}.get(sys.platform, sys.platform)
    machine = {"amd64": "x86_64", "arm64": "arm64" if system == "macos" else "aarch64"}
    kind = platform.machine().lower()
    name = f"{system}-{machine.get(kind, kind)}"
    if name not in TARGETS:
        raise CannotBuild(f"kernels cannot be compiled for {name}: choose one of {', '.join(TARGETS)}")
    return name


# Sources


def our_units() -> list[Path]:
    """The files that are compiled into our library."""
    return sorted(HERE.rglob("*.cpp"))


def digest_of(units: Sequence[Path], target: str) -> str:
    """Of all that a library is made of: these files and the headers beside them, ours, and how they are compiled."""
    folders = dict.fromkeys(unit.parent for unit in units if not unit.is_relative_to(HERE))
    headers = [path for folder in folders for path in sorted(folder.glob("*.h"))]
    found = hashlib.sha256(repr((ZIG, FLAGS, TARGETS[target])).encode())
    for path in dict.fromkeys((*units, *headers, *sorted(HERE.rglob("*.h")))):
        found.update(f"\0{path.name}\0".encode() + path.read_bytes())
    return found.hexdigest()[:24]


# Folders of libraries


def find(folder: Path, digest: str) -> dict[str, Path] | None:
    """Libraries by level, if a folder has whole ones of these sources."""
    try:
        index = json.loads((folder / f"{digest}.json").read_text("utf-8"))
        found = {level: folder / name for level, (name, _) in index.items()}
        whole = all(_hash(folder / name) == wanted for name, wanted in index.values())
    except (OSError, ValueError, AttributeError, TypeError):
        return None
    return found if whole else None


def build(units: Sequence[Path], target: str, folder: Path) -> dict[str, Path]:
    """Libraries by level, which are compiled unless another process has done so meanwhile."""
    folder.mkdir(parents=True, exist_ok=True)
    digest = digest_of(units, target)
    with _locked(folder / "lock"):
        found = find(folder, digest)
        if found is not None:
            return found
        _remove_unused(folder)
        compiler = find_compiler()
        kind = TARGETS[target]
        with tempfile.TemporaryDirectory(dir=folder) as made:
            with ThreadPoolExecutor(os.cpu_count()) as pool:
                jobs = {level: pool.submit(_compile, compiler, units, kind, level, Path(made))
                        for level in kind.levels}
            paths = {level: job.result() for level, job in jobs.items()}
            index = {level: (f"{digest}-{path.name}", _hash(path)) for level, path in paths.items()}
            for level, path in paths.items():
                os.replace(path, folder / index[level][0])
            (Path(made) / "index").write_text(json.dumps(index), "utf-8")
            os.replace(Path(made) / "index", folder / f"{digest}.json")
        return {level: folder / name for level, (name, _) in index.items()}


def find_compiler() -> list[str]:
    """The command that compiles C++. Raises CannotBuild without one."""
    if importlib.util.find_spec("ziglang") is None:
        raise CannotBuild(f"the kernels are not compiled, and there is no compiler: pip install ziglang=={ZIG}")
    from importlib.metadata import version

    found = version("ziglang")
    if found != ZIG:
        raise CannotBuild(f"ziglang {found} would compile other kernels: pip install ziglang=={ZIG}")
    return [sys.executable, "-m", "ziglang", "c++"]


def _compile(compiler: list[str], units: Sequence[Path], target: Target, level: str, folder: Path) -> Path:
    path = folder / f"{level}{target.suffix}"
    kind = [argument for unit in units for argument in (("-x", "c++", unit) if unit.suffix == ".h" else (unit,))]
    command = [*compiler, *FLAGS, *target.flags, "-target", target.name, f"-mcpu={target.levels[level]}", "-I", HERE,
               "-o", path, *kind]
    caches = {"ZIG_LOCAL_CACHE_DIR": str(folder / "local")}
    if target.flags == ALONE:
        caches["ZIG_GLOBAL_CACHE_DIR"] = str(folder / "global")  # nothing is kept that another run could use
    done = subprocess.run(command, capture_output=True, text=True, errors="replace", env=os.environ | caches)
    if done.returncode:
        lines = done.stderr.strip().splitlines() or [f"the compiler ended with {done.returncode}"]
        raise CannotBuild(next((line for line in lines if "error:" in line), lines[-1]))
    return path


def _hash(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


@contextmanager
def _locked(path: Path) -> Iterator[None]:
    """One process at a time, where the file system has locks; elsewhere all of them write the same files."""
    with open(path, "ab") as file:
        with suppress(OSError):
            if sys.platform == "win32":
                import msvcrt

                msvcrt.locking(file.fileno(), msvcrt.LK_LOCK, 1)
            else:
                import fcntl

                fcntl.flock(file, fcntl.LOCK_EX)
        yield


def _remove_unused(folder: Path) -> None:
    now = time.time()
    for path in folder.glob("*-*.*"):
        with suppress(OSError):
            if now - path.stat().st_mtime > UNUSED:
                path.unlink()
                path.with_name(path.name.partition("-")[0] + ".json").unlink(missing_ok=True)


def main(names: Iterable[str]) -> None:
    """Build for targets by name, by default this machine's."""
    for name in tuple(names) or (this_target(),):
        begin = time.monotonic()
        found: dict[str, Any] = build(our_units(), name, PACKAGED / name)
        sizes = ", ".join(f"{level} {path.stat().st_size / 1e3:.0f} kB" for level, path in found.items())
        print(f"{name}: {sizes}, {time.monotonic() - begin:.1f} s")


if __name__ == "__main__":
    try:
        main(sys.argv[1:])
    except CannotBuild as error:
        sys.exit(str(error))
