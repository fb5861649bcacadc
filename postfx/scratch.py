"""Memory within a budget: what is too large for it lies in temporary files, and is looked at through a mapping."""

from __future__ import annotations

import errno
import math
import mmap
import re
import tempfile
import weakref
from collections.abc import Iterator

import numpy as np

from postfx.errors import MemoryBudgetError

_UNITS = {"": 1, "K": 1 << 10, "M": 1 << 20, "G": 1 << 30, "T": 1 << 40}
_SIZE = re.compile(r"(\d+(?:\.\d+)?)\s*([KMGT]?)(?:i?B)?", re.IGNORECASE)
PROCESS = 320 << 20
"""Bytes of a process in which nothing is worked on yet, and of small things."""
LEAST = 16
"""A budget that is no larger than PROCESS leaves this part of itself."""
SMALL = 128
"""Arrays below this part of what is left stay in memory."""
PIECE = 16
"""Work on large arrays goes in pieces of this part of what is left."""


def bytes_of(size: str | int) -> int:
    """Bytes of '4G', '512M' or a number; MemoryBudgetError for anything else."""
    found = _SIZE.fullmatch(str(size).strip())
    if found is None or not float(found[1]):
        raise MemoryBudgetError(f"memory budget '{size}' is no size: give bytes, or a number with K, M, G or T: 4G")
    return int(float(found[1]) * _UNITS[found[2].upper()])


class Scratch:
    """Arrays within a budget.

    Attributes:
        budget: bytes that the process may have in memory.
        left: bytes of it beside those that a process has anyway.
    """

    def __init__(self, budget: str | int) -> None:
        self.budget = bytes_of(budget)
        self.left = max(self.budget - PROCESS, self.budget // LEAST)
        self._maps: weakref.WeakSet[mmap.mmap] = weakref.WeakSet()

    def empty(self, shape: tuple[int, ...], dtype: str = "float32") -> np.ndarray:
        """An array of any content, in a temporary file if it is large."""
        nbytes = math.prod(shape) * np.dtype(dtype).itemsize
        if nbytes < self.left // SMALL:
            return np.empty(shape, dtype)
        return np.frombuffer(self.mapped(nbytes), dtype, math.prod(shape)).reshape(shape)

    def mapped(self, nbytes: int) -> mmap.mmap:
        """A temporary file of zeros; it is gone when nothing refers to its mapping."""
        try:
            with tempfile.TemporaryFile(prefix="postfx-") as file:
                file.truncate(nbytes)
                found = mmap.mmap(file.fileno(), nbytes)
        except OSError as error:
            raise MemoryBudgetError(_refused(error, nbytes)) from error
        self._maps.add(found)
        return found

    def relax(self) -> None:
        """Let go of the pages that were looked at; their content stays in the files."""
        for each in list(self._maps):
            each.madvise(mmap.MADV_DONTNEED)

    def pieces(self, rows: int, row_bytes: int) -> Iterator[tuple[int, int]]:
        """First and last row, not included, of pieces of something large; pages are let go of after each."""
        step = max(1, self.left // PIECE // max(1, row_bytes))
        for first in range(0, rows, step):
            yield first, min(rows, first + step)
            self.relax()


def _refused(error: OSError, nbytes: int) -> str:
    if error.errno in (errno.EMFILE, errno.ENFILE):
        return "too many open files, as every large plane that is kept is one: keep fewer frames, or raise 'ulimit -n'"
    return f"{tempfile.gettempdir()}: no room for {nbytes >> 20} MB: set TMPDIR to a larger disk"
