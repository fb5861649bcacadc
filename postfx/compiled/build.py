"""Compiles the kernels' C++ by ziglang, for this machine or any other: one shared library for each
level of a processor, in a folder with an index, which is written last. Each file is compiled by
itself and its object is kept, so that a change costs the files that it touches.

Only the standard library is used, and nothing else of this package: a build hook runs this file by
itself.
"""

from __future__ import annotations

import ctypes
import errno
import hashlib
import importlib.util
import json
import os
import platform
import re
import shutil
import stat
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path
from typing import NamedTuple

PACKAGE = Path(__file__).resolve().parent.parent
KERNELS = PACKAGE / "kernels"
"""All C++, and the headers that it shares."""
PACKAGED = PACKAGE / "_native"
"""The libraries of a wheel, or of a checkout."""
ZIG = "0.17.1"
"""The compiler's version; another one may give other bits. `pyproject.toml` has the same."""
FLAGS = (
    "-std=c++20", "-O3", "-fPIC", "-fvisibility=hidden", "-fno-exceptions", "-fno-rtti",
    # a * b + c becomes one instruction where the source says so, not where a compiler likes
    "-ffp-contract=on", "-fno-math-errno", "-fno-trapping-math", "-fno-sanitize=all",
    # vectors are written out; looking for more takes a fifth of the compiler's time
    "-fno-slp-vectorize", "-g0", "-Wall", "-Wextra", "-Werror", "-Wno-psabi",
)
LINKED = ("-shared", "-s")
X86_64 = {"baseline": "x86_64", "v3": "x86_64_v3", "v4": "x86_64_v4",
          "vnni": "x86_64_v4+avx512vnni"}
"""Levels and what the compiler calls them, the lowest first; `level.cpp` counts in this order."""
NAMED_BY = {"vnni": ("v4", "__AVX512VNNI__")}
"""Levels that differ from the one below only in files of ours that name a macro of the compiler:
others came out the same to the byte."""
UNUSED = 7 * 86400
"""Seconds after which libraries of other sources are removed."""


class Target(NamedTuple):
    """A kind of machine: the compiler's name, levels, ending of a library, a wheel's tag, and what
    else to link."""

    name: str
    levels: dict[str, str]
    suffix: str
    tag: str
    flags: tuple[str, ...] = ()


NO_LIBRARY_FLAGS = ("-nostdlib",)
"""On Linux, what a kernel calls of C's library is found in the process: nothing is linked, which
takes seconds less."""
TARGETS = {
    "linux-x86_64": Target("x86_64-linux-gnu.2.28", X86_64, ".so", "manylinux_2_28_x86_64",
                           NO_LIBRARY_FLAGS),
    "linux-aarch64": Target("aarch64-linux-gnu.2.28", {"baseline": "generic"}, ".so",
                            "manylinux_2_28_aarch64", NO_LIBRARY_FLAGS),
    "macos-arm64": Target("aarch64-macos.11.0", {"baseline": "apple_m1"}, ".dylib",
                          "macosx_11_0_arm64", ("-nostdlib++",)),
    "macos-x86_64": Target("x86_64-macos.11.0", X86_64, ".dylib", "macosx_11_0_x86_64",
                           ("-nostdlib++",)),
    "windows-x86_64": Target("x86_64-windows-gnu", X86_64, ".dll", "win_amd64", ("-nostdlib++",)),
}


class CannotBuild(Exception):
    """There is no compiler, or it found a fault."""


def this_target() -> str:
    """The target's name of this machine. Raises CannotBuild if it is none of them."""
    system = {"linux": "linux", "darwin": "macos", "win32": "windows"}.get(sys.platform,
                                                                           sys.platform)
    machine = {"amd64": "x86_64", "arm64": "arm64" if system == "macos" else "aarch64"}
    kind = platform.machine().lower()
    name = f"{system}-{machine.get(kind, kind)}"
    if name not in TARGETS:
        raise CannotBuild(f"kernels cannot be compiled for {name}: choose one of "
                          f"{', '.join(TARGETS)}")
    return name


# Sources

PROBE = [KERNELS / "level.cpp"]
"""What tells the levels of a processor, in a library of its own for the lowest one."""


def our_units() -> list[Path]:
    """The files that are compiled into our library."""
    return sorted({*KERNELS.rglob("*.cpp")} - {*PROBE})


def sources_of(unit: Path) -> list[Path]:
    """A file and the headers that it includes, itself or by others."""
    found = [unit]
    for path in found:
        found += [header
                  for header in _headers_of(path, path.stat().st_mtime_ns) if header not in found]
    return found


@cache
def _headers_of(path: Path, changed_ns: int) -> tuple[Path, ...]:
    """The headers that a file includes itself, as of when it changed: many files include the same
    ones."""
    names = re.findall(r'^#include "(.+)"', path.read_text("utf-8"), re.M)
    places = [[(folder / name).resolve() for folder in (path.parent, KERNELS)] for name in names]
    held = [[place for place in both if place.exists()][:1] for both in places]
    return tuple(header for one in held for header in one)


class Part(NamedTuple):
    """A part of our library: kernels of a file that a checkout compiles together, or one of them
    alone."""

    unit: Path
    alone: str = ""

    @property
    def flags(self) -> tuple[str, ...]:
        """The compiler's flags."""
        chosen = (("-DALONE", f"-DALONE_{self.alone}=~,EXPORT_ONE") if self.alone
                  else ("-DTOGETHER",))
        return *chosen, "-Wno-unused-function", "-Wno-unneeded-internal-declaration"


def our_parts() -> dict[str, Part]:
    """Parts by the names that they export."""
    found: dict[str, Part] = {}
    for unit in our_units():
        text = unit.read_text("utf-8")
        found |= {name: Part(unit, name)
                  for name in re.findall(r"^EXPORT_ALONE\((\w+),", text, re.M)}
        together = re.findall(r"^(?:EXPORT\(|EXPORTED Word )(\w+)[,(]", text, re.M)
        found |= dict.fromkeys(together, Part(unit))
    return found


def digest_of(units: Sequence[Path], target: str, flags: Sequence[str] = ()) -> str:
    """Digest of all that a library is made of: these files, their headers, and how they are
    compiled."""
    found = hashlib.sha256(repr((ZIG, FLAGS, LINKED, TARGETS[target], *flags)).encode())
    for path in dict.fromkeys(path for unit in units for path in sources_of(unit)):
        found.update(f"\0{path.name}\0".encode() + path.read_bytes())
    return found.hexdigest()[:24]


# Folders of libraries


def find(folder: Path, digest: str) -> dict[str, Path]:
    """Libraries by level: the whole ones of these sources in a folder."""
    return {level: folder / name for level, (name, _) in _read_index(folder, digest).items()}


def _read_index(folder: Path, digest: str) -> dict[str, tuple[str, str]]:
    try:
        index = json.loads(_read(folder / f"{digest}.json"))
        return {level: (name, wanted)
                for level, (name, wanted) in index.items() if _hash(folder / name) == wanted}
    except (OSError, ValueError, AttributeError, TypeError, RecursionError):
        return {}


def build(units: Sequence[Path], target: str, folder: Path, levels: Iterable[str] = (),
          flags: Sequence[str] = (),
          make_pool: Callable[[int], Executor] = ThreadPoolExecutor) -> dict[str, Path]:
    """Libraries by level, those given or all, which are compiled unless another process has done so
    meanwhile. ``make_pool``: of as many threads, which wait for the compiler."""
    folder.mkdir(parents=True, exist_ok=True)
    digest, kind = digest_of(units, target, flags), TARGETS[target]
    # a lock for these sources alone: others are compiled at the same time
    with _locked(folder / f"{digest}.lock"):
        index = _read_index(folder, digest)
        missing = [level for level in tuple(levels) or kind.levels if level not in index]
        if missing:
            _remove_unused(folder)
            with tempfile.TemporaryDirectory(dir=folder) as made:
                compiler = _Compiler(find_compiler(), kind, Path(made), flags, make_pool)
                for level, path in compiler.make(units, target, missing,
                                                 folder / "objects").items():
                    name = f"{digest}-{path.name}"
                    index[level] = name, _hash(path)
                    _put(path, folder / name)
                (Path(made) / "index").write_text(json.dumps(index), "utf-8")
                _put(Path(made) / "index", folder / f"{digest}.json")
    return {level: folder / name for level, (name, _) in index.items()}


def levels_of(probe: Path) -> tuple[str, ...]:
    """Levels that this processor has, the lowest first, as the probe's library tells."""
    known = tuple(TARGETS[this_target()].levels)
    return known[:ctypes.CDLL(str(probe)).best_level() + 1]


def build_here() -> None:
    """Compile what this machine needs into a checkout."""
    target = this_target()
    folder, lowest = PACKAGED / target, next(iter(TARGETS[target].levels))
    build(our_units(), target, folder,
          levels_of(build(PROBE, target, folder, [lowest])[lowest])[-1:])


def build_all(target: str, folder: Path) -> list[Path]:
    """All files that a wheel brings for a kind of machine."""
    lowest = next(iter(TARGETS[target].levels))
    made = [build(PROBE, target, folder, [lowest])[lowest],
            *build(our_units(), target, folder).values()]
    return [*made, *(folder / f"{digest_of(units, target)}.json" for units in (PROBE, our_units()))]


def find_compiler() -> list[str]:
    """The command that compiles C++. Raises CannotBuild without one."""
    package = importlib.util.find_spec("ziglang")
    if package is None or package.origin is None:
        raise CannotBuild("the kernels are not compiled, and there is no compiler: pip install "
                          f"ziglang=={ZIG}")
    from importlib.metadata import version

    found = version("ziglang")
    if found != ZIG:
        raise CannotBuild(f"ziglang {found} would compile other kernels: pip install "
                          f"ziglang=={ZIG}")
    # itself: `python -m ziglang` would start a Python for each file
    return [str(Path(package.origin).with_name("zig.exe" if sys.platform == "win32" else "zig")),
            "c++"]


class _Compiler:
    """Runs the compiler for a kind of machine, in a folder that is removed afterwards."""

    def __init__(self, command: list[str], target: Target, folder: Path, flags: Sequence[str],
                 make_pool: Callable[[int], Executor]) -> None:
        self._command, self._target, self._folder, self._flags = command, target, folder, flags
        self._make_pool = make_pool
        self._environment = os.environ | {"ZIG_LOCAL_CACHE_DIR": str(folder / "local")}
        if target.flags == NO_LIBRARY_FLAGS:
            # there is nothing to keep in it
            self._environment["ZIG_GLOBAL_CACHE_DIR"] = str(folder / "global")

    def make(self, units: Sequence[Path], target: str, levels: Sequence[str],
             objects: Path) -> dict[str, Path]:
        """Libraries of some levels; what is whole in the folder of objects is not compiled
        again."""
        _make_way(objects, stat.S_ISDIR)
        objects.mkdir(exist_ok=True)
        coming: dict[tuple[Path, str], Future[Path]] = {}
        parts: dict[tuple[Path, str], Future[Path]] = {}
        with self._make_pool(os.cpu_count() or 1) as pool:
            for unit in sorted(units, key=lambda unit: -unit.stat().st_size):
                for level in levels:
                    own = _compiled_for(unit, level)
                    name = f"{digest_of([unit], target, self._flags)}-{unit.stem}-{own}-"
                    if (unit, own) not in coming:
                        coming[unit, own] = pool.submit(self._find_or_compile, unit, own, objects,
                                                        name)
                    parts[unit, level] = coming[unit, own]
        libraries = {level: self._folder / f"{level}{self._target.suffix}" for level in levels}
        for level, library in libraries.items():
            made = [parts[unit, level].result() for unit in units]
            self._run(level, *LINKED, "-o", library, *made)
        return libraries

    def _find_or_compile(self, unit: Path, level: str, objects: Path, name: str) -> Path:
        """The object of a file, whose name ends with the hash of its bytes: a damaged one would
        link."""
        for kept in objects.glob(f"{name}*.o"):
            if kept.is_file() and kept.name == f"{name}{_hash(kept)}.o":
                return kept
        made = self._folder / f"{name}.o"
        language = ("-x", "c++") if unit.suffix == ".h" else ()
        self._run(level, *FLAGS, *self._flags, "-I", KERNELS, "-c", "-o", made, *language, unit)
        path = objects / f"{name}{_hash(made)}.o"
        _put(made, path)
        return path

    def _run(self, level: str, *arguments: str | Path) -> None:
        target = self._target
        command = [*self._command, *target.flags, "-target", target.name,
                   f"-mcpu={target.levels[level]}", *arguments]
        done = subprocess.run(command, capture_output=True, text=True, errors="replace",
                              env=self._environment)
        if done.returncode:
            lines = (done.stderr.strip().splitlines()
                     or [f"the compiler ended with {done.returncode}"])
            raise CannotBuild(next((line for line in lines if "error:" in line), lines[-1]))


def _compiled_for(unit: Path, level: str) -> str:
    """The level that a file's object is compiled for where a level's library is wanted. Compilers
    may find uses for new instructions in a plug-in."""
    if level not in NAMED_BY or not unit.is_relative_to(KERNELS):
        return level
    below, macro = NAMED_BY[level]
    named = any(macro in source.read_text("utf-8") for source in sources_of(unit))
    return level if named else below


def _hash(path: Path) -> str:
    return hashlib.sha256(_read(path)).hexdigest()


def _read(path: Path) -> bytes:
    """A file; OSError where something else has its name, as to read a pipe may take for ever."""
    if not path.is_file():
        raise FileNotFoundError(errno.ENOENT, "there is no such file", str(path))
    return path.read_bytes()


def _put(made: Path, path: Path) -> None:
    """Give a file its name, in place of whatever has it."""
    _make_way(path, stat.S_ISREG)
    os.replace(made, path)


def _make_way(path: Path, fits: Callable[[int], bool]) -> None:
    """Remove what has a name and is of another kind than a build leaves there."""
    if os.path.lexists(path) and not fits(path.lstat().st_mode):
        if path.is_dir() and not path.is_symlink():
            shutil.rmtree(path)
        else:
            path.unlink()


@contextmanager
def _locked(path: Path) -> Iterator[None]:
    """One process at a time, where the file system has locks; elsewhere all of them write the same
    files."""
    _make_way(path, stat.S_ISREG)
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
    for path in (*folder.glob("*-*.*"), *folder.glob("*.lock"), *folder.glob("objects/*.o")):
        with suppress(OSError):
            if now - path.stat().st_mtime > UNUSED:
                path.unlink()
                path.with_name(path.name.partition("-")[0] + ".json").unlink(missing_ok=True)


def main(names: Iterable[str]) -> None:
    """Build for targets by name, by default this machine's."""
    for name in tuple(names) or (this_target(),):
        begin = time.monotonic()
        paths = build_all(name, PACKAGED / name)
        sizes = ", ".join(f"{path.stem.rpartition('-')[2]} {path.stat().st_size / 1e3:.0f} kB"
                          for path in paths if path.suffix != ".json")
        print(f"{name}: {sizes}, {time.monotonic() - begin:.1f} s")


if __name__ == "__main__":
    try:
        main(sys.argv[1:])
    except CannotBuild as error:
        sys.exit(str(error))
