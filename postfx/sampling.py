"""Values of planes between their pixels and around them. Positions count pixels, and are whole at
pixel centres."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

Curve = Callable[[np.ndarray], np.ndarray]

BAND_ROWS = 128
"""Rows of a band: whole squares of those in which `postfx.masks.noise` measures noise."""


def bilinear(plane: np.ndarray, x: np.ndarray, y: np.ndarray,
             curve: Curve | None = None) -> np.ndarray:
    """Bilinear values (count, ...) of a plane (height, width, ...) at places x and y (count,);
    edges are repeated.

    `curve` is applied to the samples that are needed, before they are mixed.
    """
    height, width = plane.shape[:2]
    x, y = np.clip(x, 0, width - 1), np.clip(y, 0, height - 1)
    left, top = (np.minimum(at.astype(np.int64), max(side - 2, 0))
                 for at, side in ((x, width), (y, height)))
    right, bottom = np.minimum(left + 1, width - 1), np.minimum(top + 1, height - 1)
    u, v = (at.astype(plane.dtype).reshape(-1, *[1] * (plane.ndim - 2))
            for at in (x - left, y - top))
    flat = plane.reshape(height * width, *plane.shape[2:])

    def near(rows: np.ndarray, columns: np.ndarray) -> np.ndarray:
        # a quarter of the time of two indices
        values: np.ndarray = flat.take(rows * width + columns, axis=0)
        return curve(values) if curve else values

    upper = near(top, left) * (1 - u) + near(top, right) * u
    lower = near(bottom, left) * (1 - u) + near(bottom, right) * u
    mixed: np.ndarray = upper * (1 - v) + lower * v
    return mixed


def is_inside(plane: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """(count,): whether places lie between the outermost pixel centres of a plane (height,
    width, ...)."""
    height, width = plane.shape[:2]
    inside: np.ndarray = (x >= 0) & (x <= width - 1) & (y >= 0) & (y <= height - 1)
    return inside


def motion_at(
    motion: np.ndarray, rows: np.ndarray, columns: np.ndarray, height: int, width: int
) -> np.ndarray:
    """Motion (rows, columns, 2) at these rows and columns of a picture of height x width, in its
    pixels.

    motion: (h, w, 2) in its own pixels; each pixel of the picture gets the one that its centre lies
    in.
    """
    h, w = motion.shape[:2]
    near = ((2 * rows + 1) * h // (2 * height))[:, None], (2 * columns + 1) * w // (2 * width)
    scaled: np.ndarray = motion[near] * np.array([width / w, height / h], np.float32)
    return scaled


def bands(height: int, reach: int) -> Iterator[tuple[int, int, int, int]]:
    """First and last row of each band of a picture, and of the band with up to `reach` rows around
    it.

    Work on bands takes less memory than work on the whole picture.
    """
    for first in range(0, height, BAND_ROWS):
        last = min(height, first + BAND_ROWS)
        yield first, last, max(0, first - reach), min(height, last + reach)


def local_mean(plane: np.ndarray, radius: int) -> np.ndarray:
    """Mean over windows of (2 radius + 1)^2 pixels: (height, width, C) float32, of any floats;
    borders are repeated."""
    for axis in (0, 1):
        padding = [(radius + 1, radius) if side == axis else (0, 0) for side in range(3)]
        sums = np.cumsum(np.pad(plane, padding, mode="edge"), axis=axis, dtype=np.float64)
        size, window = plane.shape[axis], 2 * radius + 1
        upper = np.take(sums, range(window, window + size), axis)
        plane = ((upper - np.take(sums, range(size), axis)) / window).astype(np.float32)
    return plane


def three_by_three(plane: np.ndarray, step: int, join: np.ufunc) -> np.ndarray:
    """3x3 pixels of a plane (h, w), `step` apart, joined by a function of two; borders are
    repeated."""
    wide, last = np.pad(plane, step, "edge"), -2 * step
    rows = join(join(wide[:last], wide[step:-step]), wide[2 * step:])
    found: np.ndarray = join(join(rows[:, :last], rows[:, step:-step]), rows[:, 2 * step:])
    return found


def local_maximum(plane: np.ndarray, radius: int) -> np.ndarray:
    """Largest value within windows of (2 radius + 1)^2 pixels: (height, width) -> the same; borders
    are repeated."""
    return _reduce_windows(np.maximum, plane, radius)


def local_sum(plane: np.ndarray, radius: int) -> np.ndarray:
    """Sum over windows of (2 radius + 1)^2 pixels: (height, width) -> the same; borders are
    repeated.

    It takes no running sums: in these, the rounding of one huge value spreads along its whole row.
    """
    return _reduce_windows(np.add, plane, radius)


def _reduce_windows(operation: np.ufunc, plane: np.ndarray, radius: int) -> np.ndarray:
    height, width = plane.shape
    padded, shifts = np.pad(plane, radius, mode="edge"), range(2 * radius + 1)
    rows = operation.reduce([padded[shift:shift + height] for shift in shifts])
    reduced: np.ndarray = operation.reduce([rows[:, shift:shift + width] for shift in shifts])
    return reduced
