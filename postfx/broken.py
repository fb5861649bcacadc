"""Pixels that hold no number: counted in every plane, and mended in colour where their neighbours know better."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator

import numpy as np

from postfx.frame import Frame, Role
from postfx.system import Scratch

ROWS = 256
"""Rows that are looked at together: less memory than the picture."""
KNOWN = 0.75
"""Part of a pixel's neighbours that must be known to mend it: one, two or three bad pixels, not the edge of a sun."""
MOST = 0.5
"""Part of the colour's pixels above which the frame tells nothing, and what is not finite counts as black."""
AROUND = tuple((y, x) for y in (-1, 0, 1) for x in (-1, 0, 1) if y or x)


def mended(frame: Frame, roles: tuple[Role, ...], scratch: Scratch | None = None) -> tuple[Frame, dict[Role, int]]:
    """The frame with its colour mended, and how many pixels of which of these planes are not finite, if any.

    An infinite depth is a miss and does not count. A pixel of the colour gets the mean of its finite neighbours, where
    at least 6 of 8 are (as many by proportion at the picture's edge). Others stay: passes take NaN for 0 and infinities
    for the largest light; where more than half of the frame is broken, all of that becomes 0. The given frame is not
    changed. `scratch` is the budget within which its planes are looked at and copied.
    """
    found = {role: bad for role in roles if (bad := broken(frame[role], role, scratch)) is not None}
    counts = {role: int(bad.sum()) for role, bad in found.items()}
    if Role.COLOUR not in found:
        return frame, counts
    colour, bad = _copied(frame[Role.COLOUR], scratch), found[Role.COLOUR]
    if is_lost(frame, counts):
        colour[bad] = 0
    else:
        _mend(colour, bad)
    return dataclasses.replace(frame, planes={**frame.planes, Role.COLOUR: colour}), counts


def is_lost(frame: Frame, counts: dict[Role, int]) -> bool:
    """Whether a frame with these counts tells nothing: more than half of its colour is no number."""
    return Role.COLOUR in counts and counts[Role.COLOUR] > MOST * frame[Role.COLOUR][..., 0].size


def broken(plane: np.ndarray, role: Role, scratch: Scratch | None = None) -> np.ndarray | None:
    """(height, width) bool: pixels of a plane (height, width, C) that are not finite; None where all are."""
    is_bad = np.isnan if role is Role.DEPTH else _is_not_finite
    if not any(is_bad(band).any() for band in _bands(plane, scratch)):
        return None
    return np.concatenate([is_bad(band).any(axis=2) for band in _bands(plane, scratch)])


def _is_not_finite(values: np.ndarray) -> np.ndarray:
    return ~np.isfinite(values)


def _bands(plane: np.ndarray, scratch: Scratch | None) -> Iterator[np.ndarray]:
    """Rows of a plane, `ROWS` at a time."""
    for first in range(0, plane.shape[0], ROWS):
        yield plane[first : first + ROWS]
        if scratch:
            scratch.relax()


def _copied(plane: np.ndarray, scratch: Scratch | None) -> np.ndarray:
    copy = scratch.empty(plane.shape) if scratch else np.empty_like(plane)
    for source, target in zip(_bands(plane, scratch), _bands(copy, None), strict=True):
        target[:] = source
    return copy


def _mend(colour: np.ndarray, bad: np.ndarray) -> None:
    """Write the mean of the neighbours into bad pixels of which enough are known."""
    height, width = bad.shape
    rows, columns = np.nonzero(bad)
    total, known, there = np.zeros((rows.size, 3)), np.zeros(rows.size), np.zeros(rows.size)
    for down, right in AROUND:
        y, x = rows + down, columns + right
        inside = (y >= 0) & (y < height) & (x >= 0) & (x < width)
        y, x = np.clip(y, 0, height - 1), np.clip(x, 0, width - 1)
        good = inside & ~bad[y, x]
        total += np.where(good[:, None], colour[y, x], 0)
        known, there = known + good, there + inside
    mend = (known > 0) & (known >= KNOWN * there)
    colour[rows[mend], columns[mend]] = total[mend] / known[mend, None]
