"""Kernels that come compiled, and what the others need of Numba, which is imported only for them.

A wheel has a shared library for each level of a processor, and an index of the functions in it with the types of their
arguments (`build_kernels.py` makes both). Called with such types, a function runs from the library, and Numba is never
imported: that takes a third of a second and 70 MB, and compiling takes half a minute. With other types, on another
processor, or where a source differs from the one that was compiled, Numba compiles it.
"""

from __future__ import annotations

import ctypes
import hashlib
import json
import os
import platform
import struct
import sys
import time
from collections.abc import Callable, Iterable, Sequence
from functools import cache, cached_property, update_wrapper
from importlib import import_module
from itertools import pairwise
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

FOLDER = Path(__file__).resolve().parents[1] / "_kernels" / f"{sys.platform}-{platform.machine()}"
_V3 = {"avx", "avx2", "bmi1", "bmi2", "f16c", "fma", "abm", "movbe"}
_V4 = _V3 | {"avx512f", "avx512bw", "avx512cd", "avx512dq", "avx512vl"}
_VNNI, _VNNI_FEATURE = "-vnni", "+avx512vnni"
LEVELS = {f"x86-64-v4{_VNNI}": _V4 | {"avx512_vnni"}, "x86-64-v4": _V4, "x86-64-v3": _V3}
"""Levels of the x86-64 psABI, the highest first, and what they need, as Linux names it. The first also adds products of
8-bit numbers at once."""
FEATURES = "-prefer-256-bit"
"""Vectors as wide as the level has them: what processors that Numba knows by name get, so pixels are the same bits."""
SCALARS = {bool: "?", np.bool_: "?", int: "q", np.int64: "q", float: "d", np.float64: "d", np.float32: "f"}
"""Types of numbers that a function may be called with, as `struct` names them."""
_WITHOUT_GAPS, _ALIGNED, _WRITEABLE = 0x1, 0x100, 0x400  # NumPy's flags of arrays
WORDS = {"?": "q", "q": "q", "d": "d", "f": "f4x"}
"""How they are put into words of 8 bytes."""

# What Numba would give


class LazyModule(ModuleType):
    """A module that is imported when something of it is used."""

    def __getattr__(self, name: str) -> Any:
        return getattr(import_module(self.__name__), name)


ir, types, cgutils = (LazyModule(name) for name in ("llvmlite.ir", "numba.core.types", "numba.core.cgutils"))


class Intrinsic:
    """A function that writes LLVM's instructions: `numba.extending.intrinsic`, made when a kernel is compiled."""

    def __init__(self, function: Callable[..., Any]) -> None:
        self.function = function

    @cached_property
    def _numba_type_(self) -> Any:
        from numba.core.registry import cpu_target
        from numba.extending import intrinsic

        self._made = intrinsic(self.function)  # Numba holds it by a weak reference
        cpu_target.typing_context.refresh()
        return cpu_target.typing_context.resolve_value_type(self._made)


def intrinsic(function: Callable[..., Any]) -> Any:
    """Decorator of a function that writes LLVM's instructions for a call of it."""
    return Intrinsic(function)


watches: list[CompileWatch] = []
"""Those that are told what Numba compiles."""


class CompileWatch:
    """Counts what Numba compiles, and how long that takes. Use as a context manager.

    Args:
        tell: called before each function with the count of earlier ones.

    Attributes:
        count: compiled functions, without those from the cache.
        seconds: total time of compiling.
    """

    def __init__(self, tell: Callable[[int], None] = lambda _: None) -> None:
        self.count, self.seconds = 0, 0.0
        self._tell, self._depth, self._begin = tell, 0, 0.0

    def start(self) -> None:
        """Start timing a function, possibly inside one that calls it."""
        self._tell(self.count)
        if self._depth == 0:
            self._begin = time.perf_counter()
        self._depth += 1

    def end(self) -> None:
        """Stop timing it."""
        self._depth, self.count = self._depth - 1, self.count + 1
        if self._depth == 0:
            self.seconds += time.perf_counter() - self._begin

    def __enter__(self) -> CompileWatch:
        watches.append(self)
        return self

    def __exit__(self, *_: object) -> None:
        watches.remove(self)


# What is compiled already


class KernelFunction:
    """A function of the library, or for other types one that Numba compiles.

    Attributes:
        py_func: the function in Python.
        forms: those in the library, by the kinds of their arguments.
    """

    def __init__(self, function: Callable[..., Any], compile_it: Callable[[], Any], forms: dict[Kinds, Form]) -> None:
        update_wrapper(self, function)
        self.py_func = function
        self._compile_it, self.forms = compile_it, forms

    @cached_property
    def dispatcher(self) -> Any:
        """Numba's."""
        return self._compile_it()

    @property
    def _numba_type_(self) -> Any:  # for kernels that call it
        return self.dispatcher._numba_type_

    @property
    def targetoptions(self) -> Any:
        """Whether it is to be put into kernels that call it."""
        return self.dispatcher.targetoptions

    def __call__(self, *arguments: Any) -> Any:
        form = self.forms.get(kinds_of(arguments))
        return self.dispatcher(*arguments) if form is None else form(*arguments)

    def compile(self, types: tuple[Any, ...]) -> Any:
        """Compile it for Numba's types of arguments."""
        return self.dispatcher.compile(types)

    def bind(self, arrays: Sequence[np.ndarray]) -> Callable[[int, int], None]:
        """`function(first, last, *arrays)` as a function of `first` and `last`, which is called often."""
        form = self.forms.get(("q", "q", *kinds_of(arrays)))
        return bind_rows(self.dispatcher, arrays) if form is None else form.bind(arrays)


Kinds = tuple[str | None, ...]
"""Types of arguments: numbers by their letter, arrays by type, axes and 'r' if read-only; None what has no name."""


class Form:
    """A function of the library for arguments of given kinds.

    Args:
        entry: of the library: `int entry(const void *words, void *result)`. Words are numbers, and of each array its
            address and shape; it returns 0, unless the function raised an error.
        result: letter of the result, or '' if there is none.
    """

    def __init__(self, name: str, entry: Any, kinds: Kinds, result: str) -> None:
        entry.argtypes, entry.restype = (ctypes.c_char_p, ctypes.c_void_p), ctypes.c_int
        self._name, self._entry = name, entry
        self._pack = struct.Struct("=" + "".join(
            WORDS[kind] if kind in WORDS else "Q" + "q" * axes_of(kind) for kind in kinds if kind)).pack
        self._result = struct.Struct("=" + result) if result else None

    def __call__(self, *arguments: Any) -> Any:
        words = self._pack(*words_of(arguments))
        if self._result is None:
            return self._check(self._entry(words, None))
        found = ctypes.create_string_buffer(8)
        self._check(self._entry(words, found))
        return self._result.unpack_from(found)[0]

    def bind(self, arrays: Sequence[np.ndarray]) -> BoundRows:
        """The function of rows, with all arrays given."""
        entry, check, pair = self._entry, self._check, struct.Struct("=qq").pack
        words = words_of(arrays)
        rest = self._pack(0, 0, *words)[16:]

        def rows(first: int, last: int) -> None:
            check(entry(pair(first, last) + rest, None))

        address = ctypes.cast(entry, ctypes.c_void_p).value or 0
        return BoundRows(self._name, rows, address, [0, 0, *words], tuple(arrays))

    def _check(self, status: int) -> None:
        if status:
            raise RuntimeError(f"kernel {self._name} failed, probably for want of memory")


class BoundRows:
    """A kernel's rows with all arrays given, as a function of the first and the last row, which threads may also call
    without Python's lock.

    Args:
        call: the function.
        entry: address of `int entry(const int64_t *words, void *)`.
        words: with zeros for the first and the last row.
        arrays: which live as long as their addresses.

    Attributes:
        entry: as given.
    """

    def __init__(self, name: str, call: Callable[[int, int], None], entry: int, words: Sequence[int],
                 arrays: Sequence[np.ndarray]) -> None:
        self._name, self._call, self.entry, self._words, self._arrays = name, call, entry, words, arrays
        self._edges: Sequence[int] = ()
        self._blocks = np.empty((0, 0), np.int64)

    def __call__(self, first: int, last: int) -> None:
        self._call(first, last)

    def blocks(self, edges: Sequence[int]) -> np.ndarray:
        """The words (bands, count) of each band between two edges."""
        if self._edges != edges:
            blocks = np.empty((len(edges) - 1, len(self._words)), np.int64)
            blocks[:] = self._words
            blocks[:, 0], blocks[:, 1] = edges[:-1], edges[1:]
            self._edges, self._blocks = edges, blocks
        return self._blocks

    def explain(self, edges: Sequence[int]) -> None:
        """Raises the error of a band that failed."""
        for first, last in pairwise(edges):
            self._call(first, last)
        raise RuntimeError(f"kernel {self._name} failed, probably for want of memory")


def kinds_of(arguments: Iterable[Any]) -> Kinds:
    """Kinds of arguments."""
    return tuple([_array_kind(value.dtype, value.ndim, value.flags.num) if isinstance(value, np.ndarray)
                  else SCALARS.get(type(value)) for value in arguments])


@cache  # looking at a type and at flags by name takes longer than many a kernel
def _array_kind(dtype: np.dtype, axes: int, flags: int) -> str | None:
    if ~flags & (_WITHOUT_GAPS | _ALIGNED):
        return None
    return f"{dtype.str}:{axes}{'' if flags & _WRITEABLE else 'r'}"


def axes_of(kind: str) -> int:
    """Axes of an array of this kind."""
    return int(kind.rstrip("r").split(":")[1])


def signature(kinds: Kinds) -> tuple[Any, ...]:
    """Numba's types of arguments of these kinds."""
    from numba import from_dtype, types

    scalars = {"?": types.boolean, "q": types.int64, "d": types.float64, "f": types.float32}
    return tuple(scalars.get(kind) or types.Array(from_dtype(np.dtype(kind.split(":")[0])), axes_of(kind), "C",
                                                  readonly=kind.endswith("r")) for kind in kinds if kind)


def words_of(arguments: Iterable[Any]) -> list[Any]:
    """Numbers, and address and shape of each array."""
    words: list[Any] = []
    for value in arguments:
        if isinstance(value, np.ndarray):
            try:
                # In a quarter of the time. NumPy's types only say from Python 3.12 on that an array is a buffer.
                words.append(ctypes.addressof(ctypes.c_char.from_buffer(value)))  # type: ignore[arg-type,unused-ignore]
            except (TypeError, ValueError):  # only to be read, or empty
                words.append(value.__array_interface__["data"][0])
            words += value.shape
        else:
            words.append(value)
    return words


def bind_rows(rows: Callable[..., None], arrays: Sequence[np.ndarray]) -> Callable[[int, int], None]:
    """A function of the first and the last of a kernel's rows, with all arrays given."""
    if hasattr(rows, "bind"):
        bound: Callable[[int, int], None] = rows.bind(arrays)
        return bound
    return lambda first, last: rows(first, last, *arrays)


def compile_rows(rows: Callable[..., None], arrays: Sequence[str]) -> None:
    """Have a kernel's rows ready for arrays of these kinds; Numba compiles them unless a library has them."""
    kinds = ("q", "q", *arrays)
    if hasattr(rows, "prepare"):
        rows.prepare(tuple(arrays))
    elif hasattr(rows, "compile") and not (isinstance(rows, KernelFunction) and kinds in rows.forms):
        rows.compile(signature(kinds))


@cache
def functions() -> dict[str, dict[Kinds, Form]]:
    """Functions of the library for this processor, by the names of their modules and their own; none without one."""
    level = processor_level()
    try:
        index = json.loads((FOLDER / f"{level}.json").read_text("utf-8"))
        if index["sources"] != digest_of_sources(index["sources"]):
            return {}
        library = ctypes.CDLL(str(FOLDER / f"{level}.so"))
    except OSError:  # none for this processor, or one of another system
        return {}
    found: dict[str, dict[Kinds, Form]] = {}
    for symbol, (name, kinds, result) in index["functions"].items():
        found.setdefault(name, {})[tuple(kinds)] = Form(name, library[symbol], tuple(kinds), result)
    return found


def digest_of_sources(names: Iterable[str]) -> dict[str, str]:
    """SHA-256 of source files of this package. Raises OSError if there is none of a name."""
    package = Path(__file__).resolve().parents[1]
    return {name: hashlib.sha256((package / name).read_bytes()).hexdigest() for name in names}


def compiled_level() -> str | None:
    """The level of this processor, or of that which Numba was told to compile for."""
    told, features = os.environ.get("NUMBA_CPU_NAME"), os.environ.get("NUMBA_CPU_FEATURES", "")
    return processor_level() if told is None else told + _VNNI * (_VNNI_FEATURE in features)


def target_of(level: str) -> dict[str, str]:
    """What tells Numba to compile for a level: LLVM's names of a processor and its features."""
    features = f"{FEATURES},{_VNNI_FEATURE}" if level.endswith(_VNNI) else FEATURES
    return {"NUMBA_CPU_NAME": level.removesuffix(_VNNI), "NUMBA_CPU_FEATURES": features}


def wide_vectors() -> bool:
    """Whether vector instructions hold sixteen numbers."""
    return (compiled_level() or "").startswith("x86-64-v4")


def adds_byte_products() -> bool:
    """Whether one of them adds four products of 8 bits to each of its numbers."""
    return wide_vectors() and (compiled_level() or "").endswith(_VNNI)


@cache
def processor_level() -> str | None:
    """The highest level that this processor has; None where that is not known."""
    try:
        with open("/proc/cpuinfo") as file:
            flags = next(line for line in file if line.startswith("flags")).split()
    except (OSError, StopIteration):
        return None
    return next((level for level, wanted in LEVELS.items() if wanted <= {*flags}), None)
