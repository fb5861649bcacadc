"""How compiled rows are called: numbers and arrays as words of 8 bytes, so that threads can call
them without Python's lock.
"""

from __future__ import annotations

import ctypes
import struct
from collections.abc import Callable, Iterable, Sequence
from functools import cache
from typing import Any, NamedTuple

import numpy as np

# NumPy's flags of arrays
_WITHOUT_GAPS = 0x1
_ALIGNED = 0x100
_WRITEABLE = 0x400

Kinds = tuple[str | None, ...]
"""Kinds of arrays: type, axes and 'r' if read-only, such as '<f4:3r'; None what has no name."""


class Form(NamedTuple):
    """How rows of a library are called with arrays of given kinds.

    Attributes:
        entry: of the library: `int entry(const void *words, void *)`. Words are the first and the
            last row, and of each array its address and shape; it returns 0, unless memory was
            wanting.
        pack: makes the words' bytes.
    """

    entry: Any
    pack: Callable[..., bytes]


def form_of(entry: Any, kinds: Kinds) -> Form:
    """The form of a library's entry for arrays of these kinds."""
    entry.argtypes, entry.restype = (ctypes.c_char_p, ctypes.c_void_p), ctypes.c_int
    words = "".join("Q" + "q" * _axes_of(kind) for kind in kinds if kind)
    return Form(entry, struct.Struct(f"=qq{words}").pack)


class BoundRows:
    """A kernel's rows with all arrays given, as a function of the first and the last row, which
    threads may also call without Python's lock.

    Args:
        name: the kernel's, for messages.
        function: of the library, as `Form.entry`.
        arrays: which live as long as their addresses.

    Attributes:
        entry: address of the function.
    """

    def __init__(self, name: str, function: Any, arrays: Sequence[np.ndarray]) -> None:
        words = words_of(arrays)
        self.entry = ctypes.cast(function, ctypes.c_void_p).value or 0
        self._name, self._function = name, function
        self._words, self._arrays = [0, 0, *words], tuple(arrays)
        self._packed_words = struct.pack(f"={len(words)}Q", *words)

    def __call__(self, first: int, last: int) -> None:
        if self._function(_PAIR.pack(first, last) + self._packed_words, None):
            raise failure_of(self._name)

    def blocks(self, edges: Sequence[int]) -> np.ndarray:
        """The words (bands, count) of each band between two edges: the first two are its rows."""
        blocks = np.empty((len(edges) - 1, len(self._words)), np.int64)
        blocks[:] = self._words
        blocks[:, 0], blocks[:, 1] = edges[:-1], edges[1:]
        return blocks

    def explain(self, blocks: np.ndarray) -> None:
        """Raises the error of a band that failed."""
        for first, last in blocks[:, :2].tolist():
            self(first, last)
        raise failure_of(self._name)


_PAIR = struct.Struct("=qq")
"""The first and the last row."""


def failure_of(name: str) -> RuntimeError:
    """The error of a kernel that returned another number than 0."""
    return RuntimeError(f"kernel {name} failed, probably for want of memory")


def kinds_of(arrays: Iterable[np.ndarray]) -> Kinds:
    """Kinds of arrays."""
    return tuple([_kind_of(array.dtype, array.ndim, array.flags.num)
                  if isinstance(array, np.ndarray) else None for array in arrays])


@cache  # looking at a type and at flags by name takes longer than many a kernel
def _kind_of(dtype: np.dtype, axes: int, flags: int) -> str | None:
    if ~flags & (_WITHOUT_GAPS | _ALIGNED):
        return None
    return f"{dtype.str}:{axes}{'' if flags & _WRITEABLE else 'r'}"


def _axes_of(kind: str) -> int:
    return int(kind.rstrip("r").split(":")[1])


def words_of(arrays: Iterable[Any]) -> list[int]:
    """Address and shape of each array."""
    words: list[int] = []
    for array in arrays:
        try:
            # In a quarter of the time. NumPy's types only say from Python 3.12 on that an array is
            # a buffer.
            words.append(ctypes.addressof(ctypes.c_char.from_buffer(array)))  # type: ignore[arg-type,unused-ignore]
        except (TypeError, ValueError):  # only to be read, or empty
            words.append(array.__array_interface__["data"][0])
        words += array.shape
    return words


def bind_rows(rows: Callable[..., None],
              arrays: Sequence[np.ndarray]) -> Callable[[int, int], None]:
    """A function of the first and the last of a kernel's rows, with all arrays given."""
    if hasattr(rows, "bind"):
        bound: Callable[[int, int], None] = rows.bind(arrays)
        return bound
    return lambda first, last: rows(first, last, *arrays)


def whole(array: np.ndarray, dtype: type) -> np.ndarray:
    """The array without gaps, at an address that its numbers may have: those of a file's bytes may
    lie anywhere."""
    found: np.ndarray = np.require(array, dtype, ("C_CONTIGUOUS", "ALIGNED"))
    return found
