"""Values of planes between their pixels and around them. Positions count pixels, and are whole at pixel centres.

Functions of arrays come first, then compiled ones that sample two pictures along paths, by the cubics of Mitchell and
Netravali (1988, B = 1 - k, C = k / 2) within the range of the four pixels around a place: where sharp, k, is 1, Catmull
and Rom's, which keep all detail; where it is 0, B-splines, which average over noise.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any, TypeAlias

import numpy as np

from postfx.kernels.numeric import Real, inline, uncounted
from postfx.kernels.vectors import in_lanes

Curve = Callable[[np.ndarray], np.ndarray]
Taps: TypeAlias = tuple[Real, Real, Real, Real]
Three: TypeAlias = tuple[Real, Real, Real]

BAND = 128
"""Rows of a band: whole squares of those in which `postfx.masks.noise` measures noise."""


def bilinear(plane: np.ndarray, x: np.ndarray, y: np.ndarray, curve: Curve | None = None) -> np.ndarray:
    """Bilinear values (count, ...) of a plane (height, width, ...) at places x and y (count,); edges are repeated.

    `curve` is applied to the samples that are needed, before they are mixed.
    """
    height, width = plane.shape[:2]
    x, y = np.clip(x, 0, width - 1), np.clip(y, 0, height - 1)
    left, top = (np.minimum(at.astype(np.int64), max(side - 2, 0)) for at, side in ((x, width), (y, height)))
    right, bottom = np.minimum(left + 1, width - 1), np.minimum(top + 1, height - 1)
    u, v = (at.astype(plane.dtype).reshape(-1, *[1] * (plane.ndim - 2)) for at in (x - left, y - top))
    flat = plane.reshape(height * width, *plane.shape[2:])

    def near(rows: np.ndarray, columns: np.ndarray) -> np.ndarray:
        values: np.ndarray = flat.take(rows * width + columns, axis=0)  # a quarter of the time of two indices
        return curve(values) if curve else values

    upper = near(top, left) * (1 - u) + near(top, right) * u
    lower = near(bottom, left) * (1 - u) + near(bottom, right) * u
    mixed: np.ndarray = upper * (1 - v) + lower * v
    return mixed


def is_inside(plane: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """(count,): whether places lie between the outermost pixel centres of a plane (height, width, ...)."""
    height, width = plane.shape[:2]
    inside: np.ndarray = (x >= 0) & (x <= width - 1) & (y >= 0) & (y <= height - 1)
    return inside


def motion_at(
    motion: np.ndarray, rows: np.ndarray, columns: np.ndarray, height: int, width: int
) -> np.ndarray:
    """Motion (rows, columns, 2) at these rows and columns of a picture of height x width, in its pixels.

    motion: (h, w, 2) in its own pixels; each pixel of the picture gets the one that its centre lies in.
    """
    h, w = motion.shape[:2]
    near = ((2 * rows + 1) * h // (2 * height))[:, None], (2 * columns + 1) * w // (2 * width)
    scaled: np.ndarray = motion[near] * np.array([width / w, height / h], np.float32)
    return scaled


def bands(height: int, reach: int) -> Iterator[tuple[int, int, int, int]]:
    """First and last row of each band of a picture, and of the band with up to `reach` rows around it.

    Work on bands takes less memory than work on the whole picture.
    """
    for first in range(0, height, BAND):
        last = min(height, first + BAND)
        yield first, last, max(0, first - reach), min(height, last + reach)


def local_mean(plane: np.ndarray, radius: int) -> np.ndarray:
    """Mean over windows of (2 radius + 1)^2 pixels: (height, width, C) float32, of any floats; borders are repeated."""
    for axis in (0, 1):
        padding = [(radius + 1, radius) if side == axis else (0, 0) for side in range(3)]
        sums = np.cumsum(np.pad(plane, padding, mode="edge"), axis=axis, dtype=np.float64)
        size, window = plane.shape[axis], 2 * radius + 1
        upper = np.take(sums, range(window, window + size), axis)
        plane = ((upper - np.take(sums, range(size), axis)) / window).astype(np.float32)
    return plane


def three_by_three(plane: np.ndarray, step: int, join: np.ufunc) -> np.ndarray:
    """3x3 pixels of a plane (h, w), `step` apart, joined by a function of two; borders are repeated."""
    wide, last = np.pad(plane, step, "edge"), -2 * step
    rows = join(join(wide[:last], wide[step:-step]), wide[2 * step:])
    found: np.ndarray = join(join(rows[:, :last], rows[:, step:-step]), rows[:, 2 * step:])
    return found


def local_maximum(plane: np.ndarray, radius: int) -> np.ndarray:
    """Largest value within windows of (2 radius + 1)^2 pixels: (height, width) -> the same; borders are repeated."""
    return _reduce_windows(np.maximum, plane, radius)


def local_sum(plane: np.ndarray, radius: int) -> np.ndarray:
    """Sum over windows of (2 radius + 1)^2 pixels: (height, width) -> the same; borders are repeated.

    It takes no running sums: in these, the rounding of one huge value spreads along its whole row.
    """
    return _reduce_windows(np.add, plane, radius)


def _reduce_windows(operation: np.ufunc, plane: np.ndarray, radius: int) -> np.ndarray:
    height, width = plane.shape
    padded, shifts = np.pad(plane, radius, mode="edge"), range(2 * radius + 1)
    rows = operation.reduce([padded[shift:shift + height] for shift in shifts])
    reduced: np.ndarray = operation.reduce([rows[:, shift:shift + width] for shift in shifts])
    return reduced


# Cubics, compiled

CUBIC = ((0.0, 1.0, 0.0, 0.0), (-0.5, 0.0, 0.5, 0.0), (1.0, -2.5, 2.0, -0.5), (-0.5, 1.5, -1.5, 0.5))
SPLINE = ((1 / 6, 2 / 3, 1 / 6, 0.0), (-0.5, 0.0, 0.5, 0.0), (0.5, -1.0, 0.5, 0.0), (-1 / 6, 0.5, -0.5, 1 / 6))
"""Weights of four taps around a place after the second one: of its powers from 0 to 3."""


def weights_at(v: Any, t: Any, sharp: Any, places: int = 1) -> Any:
    """Weights of four taps around places in [0, 1) after the second one: sharp times CUBIC, and SPLINE."""
    ones, first, squares, cubes = (v.constant(places * soft).to(v.constant(places * cubic), sharp)
                                   for soft, cubic in zip(SPLINE, CUBIC, strict=True))
    return ((cubes * t + squares) * t + first) * t + ones


@in_lanes(4, results=4)
def taps_at(v: Any, t: Any, sharp: Any) -> Any:
    """The same in numbers."""
    weights = weights_at(v, t, sharp)
    return tuple(weights.number(k) for k in range(4))


def weigh_taps(v: Any, flat: Any, at: Any, stride: Any, down: list[Any], across: list[Any]) -> tuple[Any, ...]:
    """Weighted sum of 4x4 pixels of three numbers, within the range of the middle four. Reads a third of a pixel on."""
    rows = [v.load(flat, v.step(at, stride, j)) for j in range(4)]
    column = v.sum([row * weight for row, weight in zip(rows, down, strict=True)])
    value = v.sum([column.part(3 * i, 4) * weight for i, weight in enumerate(across)])
    p, q, r, s = (row.part(3 * i, 4) for row in rows[1:3] for i in (1, 2))
    low, high = p.least(q).least(r.least(s)), p.largest(q).largest(r.largest(s))
    value = value.largest(low).least(high)
    return tuple(value.number(k) for k in range(3))


@in_lanes(16, results=3)
def cubic_three(v: Any, flat: Any, at: Any, stride: Any, down: Any, across: Any, sharp: Any) -> Any:
    """The same at a place after the pixel of the second taps."""
    under, beside = weights_at(v, down, sharp), weights_at(v, across, sharp)
    return weigh_taps(v, flat, at, stride, *([side.number(k) for k in range(4)] for side in (under, beside)))


@in_lanes(16, results=6)
def cubic_pair(v: Any, before: Any, at: Any, after: Any, there: Any, stride: Any, taps: Any, first: Any) -> Any:
    """The same in both frames, by weights as `aim_row` leaves them."""
    across, down, beside, under = (v.numbers(taps, v.step(first, 4 * k), 4) for k in range(4))
    return weigh_taps(v, before, at, stride, down, across) + weigh_taps(v, after, there, stride, under, beside)


@in_lanes(4, results=0)
def aim(v: Any, paths: Any, at: Any, y: Any, x: Any, low: Any, right: Any, pixels: Any, place: Any, taps: Any,
        first: Any) -> Any:
    """`corner_of`, the nearest pixels, and weights of taps for both ends of a path."""
    start, way, last = v.join(x, y, x, y), v.load(paths, at), v.join(right, low, right, low)
    corners, offsets = v.corners(start, way, last)
    nearest, _ = v.corners(start + 0.5, way, last)
    v.store(pixels, place, corners)
    v.store(pixels, v.step(place, 4), nearest)
    sharp, = v.numbers(paths, v.step(at, 6), 1)
    v.store(taps, first, weights_at(v, offsets.pick([k // 4 for k in range(16)]), sharp, 4))


@uncounted
def aim_row(y: int, h: int, w: int, columns: np.ndarray, count: int, paths: np.ndarray, pixels: np.ndarray,
            taps: np.ndarray) -> None:
    """The same for paths of a row, at these columns (float32): pixels (count, 8), across and down in both frames, those
    before and the nearest ones, and taps of each, flat. Loads of pictures that wait for places in a loop of their own
    overlap more."""
    v, low, right = np.float32(y), np.float32(h - 1), np.float32(w - 1)
    for k in range(count):
        aim(paths, 8 * k, v, columns[k], low, right, pixels, 8 * k, taps, 16 * k)


@inline
def cubic_one(picture: np.ndarray, j: int, i: int, down: Taps, across: Taps, c: int) -> Real:
    """One channel at a place after a pixel: likewise, anywhere in the picture."""
    h, w = picture.shape[:2]
    first, third, fourth = max(i - 1, 0), min(i + 1, w - 1), min(i + 2, w - 1)
    value, low = np.float32(0), min(j + 1, h - 1)
    for b in range(4):
        row = min(max(j - 1 + b, 0), h - 1)
        value += down[b] * (across[0] * picture[row, first, c] + across[1] * picture[row, i, c]
                            + across[2] * picture[row, third, c] + across[3] * picture[row, fourth, c])
    p, q, r, s = picture[j, i, c], picture[j, third, c], picture[low, i, c], picture[low, third, c]
    return min(max(value, min(min(p, q), min(r, s))), max(max(p, q), max(r, s)))


@inline
def corner_of(y: Real, x: Real, h: int, w: int) -> tuple[int, int, Real, Real]:
    """The pixel before a place, which is held in the picture, and how far after it the place lies, down and across."""
    y, x = min(max(y, np.float32(0)), np.float32(h - 1)), min(max(x, np.float32(0)), np.float32(w - 1))
    j, i = int(y), int(x)
    return j, i, np.float32(y - j), np.float32(x - i)


@inline
def has_taps(i: int, j: int, n: int, m: int, h: int, w: int) -> bool:
    """Whether all taps at two places, after the pixels (j, i) and (m, n), lie in the picture."""
    return (min(j, m) >= 1) & (max(j, m) < h - 2) & (min(i, n) >= 1) & (max(i, n) < w - 4)


@uncounted
def colour_beside(picture: np.ndarray, j: int, i: int, v: Real, u: Real, sharp: Real) -> Three:
    """Three channels at a place after a pixel, near the edge of the picture."""
    down, across = taps_at(v, sharp), taps_at(u, sharp)
    return (cubic_one(picture, j, i, down, across, 0), cubic_one(picture, j, i, down, across, 1),
            cubic_one(picture, j, i, down, across, 2))


@inline
def colour_at(picture: np.ndarray, flat: np.ndarray, y: Real, x: Real, sharp: Real) -> Three:
    """Three channels at a place."""
    h, w = picture.shape[:2]
    j, i, v, u = corner_of(y, x, h, w)
    if 1 <= j < h - 2 and 1 <= i < w - 4:
        inner: Three = cubic_three(flat, ((j - 1) * w + i - 1) * 3, 3 * w, v, u, sharp)
        return inner
    beside: Three = colour_beside(picture, j, i, v, u, sharp)
    return beside
