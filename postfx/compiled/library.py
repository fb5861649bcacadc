"""Kernels in C++: the library that holds them, and their rows as Python calls them.

A wheel brings a library for every level of the processor. So has a checkout where it was installed;
where sources have changed since, it compiles kernels for this processor's level when they are first
used, each as a library of its own or with those of its file (`build.py`). A plug-in's kernels are
compiled likewise from the header that it brings, into the user's cache.
"""

from __future__ import annotations

import atexit
import ctypes
import os
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path
from threading import Lock

import numpy as np

from postfx.compiled import build
from postfx.compiled.calls import BoundRows, Form, Kinds, failure_of, form_of, kinds_of, words_of
from postfx.errors import BindingError, DeviceError
from postfx.system import private_folder
from postfx.workers import Workers

FOLDER = "native"
"""In the user's cache: libraries of plug-ins, and ours where the package cannot be written to."""
SLEEP = "sleep_unless_main"
"""The function of threads.cpp that C++ calls in place of an abort while the program ends."""


class Rows:
    """Rows of a kernel in C++: `rows(first, last, *arrays)`.

    Args:
        name: that the kernel is exported by.
        header: the file that holds a plug-in's kernel; None for ours.
        level: of the processor; None for the best that this one has.
    """

    def __init__(self, name: str, header: Path | None = None, level: str | None = None) -> None:
        self.name, self.header, self.level = name, header, level
        self._forms: dict[Kinds, Form] = {}

    def __call__(self, first: int, last: int, *arrays: np.ndarray) -> None:
        kinds = kinds_of(arrays)
        form = self._forms.get(kinds)
        if form is None:
            form = self._forms[kinds] = self.form(kinds)
        if form.entry(form.pack(first, last, *words_of(arrays)), None):
            raise failure_of(self.name)

    def bind(self, arrays: Sequence[np.ndarray]) -> BoundRows:
        """The call of these rows on arrays that are given now, for threads."""
        return BoundRows(self.name, self.form(kinds_of(arrays)).entry, arrays)

    def form(self, kinds: Kinds) -> Form:
        """How the kernel is called with arrays of these kinds. Raises BindingError if it takes
        others."""
        return _form(self.name, self.header, self.level, kinds)

    def prepare(self, kinds: Kinds) -> None:
        """Have the kernel ready before the first frame. One of ours that is to be compiled is so
        beside others."""
        if self.header is None and not _is_compiled(self.name, self.level):
            # an error is raised by `form`, not here
            _compilers().submit(open_library, self.name, None, self.level)
        else:
            self.form(kinds)


def find_function(name: str, count: int) -> Callable[..., int]:
    """A function of ours in C++ of so many whole numbers and addresses, by the name that it is
    exported by. It runs without the interpreter's lock, and returns a whole number."""
    entry = getattr(open_library(name), name)
    entry.argtypes, entry.restype = (ctypes.c_int64,) * count, ctypes.c_int64
    found: Callable[..., int] = entry
    return found


class CompileWatch:
    """Counts the libraries that are compiled, and how long that takes. Use as a context manager.

    Args:
        tell: called before each library with the count of earlier ones, perhaps by another thread.

    Attributes:
        count: libraries whose compiling has begun: one kernel, or those of a file.
    """

    def __init__(self, tell: Callable[[int], None] = lambda _: None) -> None:
        self.count = 0
        self._tell, self._depth, self._begin, self._past = tell, 0, 0.0, 0.0
        self._lock = Lock()

    @property
    def seconds(self) -> float:
        """Seconds by the clock in which anything was compiled."""
        with self._lock:
            return self._past + (time.perf_counter() - self._begin if self._depth else 0.0)

    def start(self) -> None:
        """Start timing a library, possibly beside others."""
        with self._lock:
            earlier, self.count = self.count, self.count + 1
            if self._depth == 0:
                self._begin = time.perf_counter()
            self._depth += 1
        self._tell(earlier)

    def end(self) -> None:
        """Stop timing it."""
        with self._lock:
            self._depth -= 1
            if self._depth == 0:
                self._past += time.perf_counter() - self._begin

    def __enter__(self) -> CompileWatch:
        _watches.append(self)
        return self

    def __exit__(self, *_: object) -> None:
        _watches.remove(self)


_watches: list[CompileWatch] = []


@contextmanager
def _told() -> Iterator[None]:
    """Tell those that watch that something is compiled meanwhile."""
    told = tuple(_watches)
    for watch in told:
        watch.start()
    try:
        yield
    finally:
        for watch in told:
            watch.end()


@cache
def _form(name: str, header: Path | None, level: str | None, kinds: Kinds) -> Form:
    """The entry of a kernel for arrays of these kinds; BindingError if it takes others."""
    library = open_library(name, header, level)
    try:
        takes = getattr(library, f"{name}_takes")
    except AttributeError:
        raise _no_kernel(header or build.KERNELS, name) from None
    takes.restype = ctypes.c_char_p
    wanted, given = list(_split(takes().decode())), [_written(kind) for kind in kinds]
    fits = len(wanted) == len(given) and all(one in (other, f"{other[:-1]}r") for one, other in
                                             zip(wanted, given, strict=True))
    if not fits:
        raise BindingError(f"kernel '{name}' takes arrays {' '.join(wanted)} (type:axes, r if it "
                           f"only reads them), not {' '.join(given)}")
    return form_of(getattr(library, name), kinds)


def _split(text: str) -> Iterable[str]:
    return (text[at:at + 5] for at in range(0, len(text), 5))


def _written(kind: str | None) -> str:
    """A kind of `native` as the library writes it: '<f4:2r' is f4:2r, '|u1:1' is u1:1w."""
    if kind is None or ":" not in kind:
        return "with-gaps"
    return f"{kind.lstrip('<|=')}" if kind.endswith("r") else f"{kind.lstrip('<|=')}w"


@cache
def open_library(name: str, header: Path | None = None, level: str | None = None) -> ctypes.CDLL:
    """The library of a plug-in, or that which has a kernel of ours, for this processor's level or
    another one.

    Raises DeviceError where there is none and none can be made.
    """
    level = level or levels()[-1]
    if header:
        return ctypes.CDLL(str(_find_or_build([header], level, own=False)))
    part = _parts().get(name)
    if part is None:
        raise _no_kernel(build.KERNELS, name)
    path = _whole_library(level) or _find_or_build([part.unit], level, own=True, flags=part.flags)
    return ctypes.CDLL(str(path))


@atexit.register
def _let_stopped_threads_sleep() -> None:
    """Keep daemon threads that Python stops inside of C++ from an abort of the process: they sleep.

    Before 3.14 Python unwinds such a thread where it next asks for the interpreter's lock. C++
    calls its terminate handler if that is in a destructor, as in NumPy's quantiles and OpenImageIO.
    """
    is_needed = sys.platform == "linux" and sys.version_info < (3, 14)
    if not (is_needed and open_library.cache_info().currsize and _is_compiled(SLEEP, None)):
        return
    with suppress(OSError):  # no other library in C++ is loaded
        others = ctypes.CDLL("libstdc++.so.6", os.RTLD_NOLOAD)
        set_terminate = others._ZSt13set_terminatePFvvE
        set_terminate(ctypes.cast(open_library(SLEEP)[SLEEP], ctypes.c_void_p))


def library_of(name: str) -> Path:
    """The file of the library that has a function of ours, for this processor's level. Raises
    DeviceError where there is none and none can be made."""
    return Path(open_library(name)._name)


def _no_kernel(where: Path, name: str) -> BindingError:
    return BindingError(f"{where} exports no kernel '{name}': write EXPORT({name}, rows) there")


_parts = cache(build.our_parts)


@cache
def _compilers() -> Workers:
    return Workers(os.cpu_count(), thread_name_prefix="postfx compiler")


@cache
def _whole_library(level: str) -> Path | None:
    """The library of all our kernels, where there is one."""
    return _find(_folders(own=True), build.digest_of(build.our_units(), _this_target()), level)


def _is_compiled(name: str, level: str | None) -> bool:
    level, part = level or levels()[-1], _parts().get(name)
    if part is None or _whole_library(level):
        return True
    return (part, level) in _compiled_parts or _found_part(part, level)


_compiled_parts = set[tuple[build.Part, str]]()
"""Parts and levels that were found compiled: to look reads and hashes all their sources."""


def _found_part(part: build.Part, level: str) -> bool:
    digest = build.digest_of([part.unit], _this_target(), part.flags)
    found = _find(_folders(own=True), digest, level) is not None
    if found:
        _compiled_parts.add((part, level))
    return found


@cache
def levels() -> tuple[str, ...]:
    """The levels that this processor has, the lowest first."""
    lowest = next(iter(build.TARGETS[_this_target()].levels))
    return build.levels_of(_find_or_build(build.PROBE, lowest, own=True))


def has_byte_products() -> bool:
    """Whether kernels can multiply numbers of 8 bits by this processor's own instructions: above
    the lowest level."""
    return len(levels()) > 1


def _this_target() -> str:
    try:
        return build.this_target()
    except build.CannotBuild as error:
        raise DeviceError(str(error)) from None


def _folders(own: bool) -> list[Path]:
    """Where libraries may lie: ours in the package, and all in the user's cache."""
    cache_folder = private_folder(FOLDER)
    return [build.PACKAGED / _this_target()] * own + ([cache_folder] if cache_folder else [])


def _find(folders: Iterable[Path], digest: str, level: str) -> Path | None:
    return next((found[level] for found in (build.find(folder, digest) for folder in folders)
                 if level in found), None)


def _find_or_build(units: list[Path], level: str, own: bool, flags: Sequence[str] = ()) -> Path:
    """The library of some sources for a level: one that is kept, or else a new one. own: whether
    they are ours, which may come compiled with the package."""
    target = _this_target()
    try:
        folders = _folders(own)
        found = _find(folders, build.digest_of(units, target, flags), level)
        if found:
            with suppress(OSError):
                found.touch()  # marks it as used
            return found
        writable = [folder for folder in folders if _can_write(folder)]
        if not writable:
            raise build.CannotBuild("compiled kernels can be kept nowhere: set XDG_CACHE_HOME to a "
                                    "folder of your own")
        with _told():
            return build.build(units, target, writable[0], [level], flags, Workers)[level]
    except (build.CannotBuild, OSError) as error:
        raise DeviceError(str(error)) from None


def _can_write(folder: Path) -> bool:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError:
        return False
    return os.access(folder, os.W_OK)
