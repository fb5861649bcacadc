"""Whole planes of float32 on the host: whether all numbers are finite, 0 or the same, and how they
are copied. A pipeline lends threads for the largest of these.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar

import numpy as np

from postfx.compiled.calls import whole
from postfx.compiled.library import Rows

INFINITY_BITS = 0x7F800000
"""The bits of an infinite float32; those of NaN, without the sign, are larger."""
LARGEST_HALF = 65504
"""The largest number that a half float holds."""
LARGEST_FLOAT = float(np.finfo(np.float32).max)
"""The largest number that a float holds."""
LEAST_NEGATIVE = 3e-3
"""Share of a part's light that must be negative for the part to count as such. Pixel filters leave
less, which is cut, as in the picture."""
LEAST_OF_PICTURE = 1e-5
"""The same as a share of the picture's light: a part without light has negative rounding alone."""
SAMPLED_ROW_STEP = 8
"""One row in so many is looked at, where a frame's light is."""
WORTH = 1 << 20
"""Bytes to look at or to copy that are worth another thread."""

Divide = Callable[[Callable[[int, int], None], int, int], None]
"""`divide(rows, count, nbytes)` runs `rows(first, last)` over 0 to count - 1, in several threads or
in pieces that fit a memory budget. nbytes: of what all of it reads."""
_lent: ContextVar[Divide | None] = ContextVar("divide", default=None)


@contextmanager
def lend(divide: Divide | None) -> Iterator[None]:
    """Let `share` divide work by `divide`."""
    token = _lent.set(divide)
    try:
        yield
    finally:
        _lent.reset(token)


def share(rows: Rows, count: int, *arrays: np.ndarray) -> None:
    """Run `rows(first, last, *arrays)` over rows 0 to count - 1, divided as a pipeline lends it if
    it is worth that. The first array is by far the largest."""
    divide = _lent.get()
    if divide is None or arrays[0].nbytes < 2 * WORTH:
        rows(0, count, *arrays)
    else:
        divide(rows.bind(arrays), count, arrays[0].nbytes)


def sampled(plane: np.ndarray, down: int, across: int, first: int = 0) -> np.ndarray:
    """Every so many rows and columns of a plane (height, width, channels), from the `first` of both
    on; a copy. It is divided like other work: a file's pages come into memory many at a time, so
    that a few rows take as much of it as all."""
    chosen = plane[first::down, first::across]
    found = np.empty_like(chosen)

    def copy(begin: int, end: int) -> None:
        found[begin:end] = chosen[begin:end]

    divide = _lent.get()
    if divide is None or not found.size or plane.nbytes < 2 * WORTH:
        copy(0, len(found))
    else:
        divide(copy, len(found), plane.nbytes)
    return found


copy_pieces = Rows("copy_pieces")
"""`copy_pieces(first, last, source, target)`: pieces of `WORTH` bytes of flat uint32, the last of
which may be smaller."""
_largest_bits = Rows("largest_bits")
_is_blank = Rows("is_blank")
_is_same_plane = Rows("is_same_plane")


def largest_bits_of(plane: np.ndarray) -> int:
    """The largest bits of the numbers of a plane (height, ...) of float32, without their signs, on
    the threads that are lent if it is worth that."""
    bits = whole(plane, np.float32).view(np.uint32)
    divides = bits.nbytes >= 2 * WORTH and _lent.get()
    rows = bits.reshape(len(bits) if divides else 1, -1)
    largest = np.empty(len(rows), np.uint32)
    share(_largest_bits, len(rows), rows, largest)
    return int(largest.max())


def is_finite(plane: np.ndarray) -> bool:
    """Whether all numbers of a plane of float32 are finite."""
    return largest_bits_of(plane) < INFINITY_BITS


def is_blank(plane: np.ndarray) -> bool:
    """Whether all numbers of a plane of float32 are 0."""
    found = np.empty(1, bool)
    _is_blank(0, 1, whole(plane, np.float32).view(np.uint32).reshape(-1), found)
    return bool(found[0])


def is_same_plane(one: np.ndarray, other: np.ndarray) -> bool:
    """Whether all numbers of two planes of float32 and of one size are the same, or NaN in both."""
    found = np.empty(1, bool)
    _is_same_plane(0, 1, *(whole(plane, np.float32).reshape(-1) for plane in (one, other)), found)
    return bool(found[0])


def has_negative_light(part: np.ndarray, picture: np.ndarray | None) -> bool:
    """Whether a part (h, w, n) has negative light, and more of it than rounding or a pixel filter
    leaves; `picture`: (h, w, 3), to which it belongs, None if that is not known."""
    seen = part[::SAMPLED_ROW_STEP]
    seen = seen[np.isfinite(seen)]
    negative = np.maximum(-seen, 0).sum(dtype=np.float64)
    if negative <= LEAST_NEGATIVE * np.abs(seen).sum(dtype=np.float64):
        return False
    if picture is None:
        return True
    whole = picture[::SAMPLED_ROW_STEP]
    light = np.abs(whole[np.isfinite(whole)]).sum(dtype=np.float64)
    return bool(negative > LEAST_OF_PICTURE * light)
