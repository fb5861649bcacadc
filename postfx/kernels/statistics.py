"""What the host looks at in a frame's planes before it is uploaded: the light of blocks of pixels,
on which exposure is metered, a coarse grid's cells, by which cuts are found, where alpha differs,
whether depth is noise, and how much light lies outside the gamut.

Sums keep their order, so that a multiplier does not depend on vectors, nor on the threads that a
pipeline lends for the largest of these.
"""

from __future__ import annotations

import math

import numpy as np

from postfx.colour import TO_WIDER_PRIMARIES
from postfx.compiled.calls import whole
from postfx.compiled.library import Rows
from postfx.planes import sampled, share

LEAST_DEPTH = 1e-6
"""Depth that is no nearer for logarithms, in scene units."""

# Blocks of pixels

_block_means = Rows("block_means")
_half_means = Rows("half_means")
_pair_means = Rows("pair_means")
_bounds_of_cells = Rows("bounds_of_cells")
_mark_positive = Rows("mark_positive")
_mark_lit = Rows("mark_lit")
_coverage_noise = Rows("coverage_noise")


def block_means(colour: np.ndarray, side: int) -> np.ndarray:
    """Mean luminance of each block of side x side pixels without the brightest; colour (h, w, 3) ->
    float64 (rows, columns), blocks at the edges smaller.

    Non-finite pixels are left out, negative ones count as 0. Averaging keeps the noise of one
    sample a pixel out of the logarithm that follows, which would read it as darkness; without the
    brightest pixel a firefly is no light.
    """
    means = np.empty([-(-length // side) for length in colour.shape[:2]])
    share(_block_means, len(means), whole(colour, np.float32), np.array([side]), means)
    return means


def half_means(colour: np.ndarray, side: int) -> np.ndarray:
    """Mean luminance of the two halves of each whole block of side x side pixels; colour (h,
    w, 3) -> float64 (2, rows, columns).

    The halves are the even and the odd rows, so they show the same with other noise. The brightest
    pixel of each is left out, as by `block_means`; pixels that are not finite and negative ones
    count as 0.
    """
    means = np.empty((2, colour.shape[0] // side, colour.shape[1] // side))
    share(_half_means, means.shape[1], whole(colour, np.float32), np.array([side]), means)
    return means


def pair_means(plane: np.ndarray, side: int) -> np.ndarray:
    """Means of two pairs of pixels of each whole block of side x side; plane (h, w, C) -> float64
    (rows, columns, 2, C).

    Each pair lies on a diagonal, a quarter of the block from its corners. Means that are not finite
    become 0.
    """
    means = np.empty((plane.shape[0] // side, plane.shape[1] // side, 2, plane.shape[2]))
    _pair_means(0, len(means), whole(plane, np.float32), np.array([side]), means)
    return means


def bounds_of_cells(plane: np.ndarray, side: int) -> tuple[np.ndarray, np.ndarray]:
    """The lowest and the highest value, 0 to 1, of a plane (h, w) in each cell of side x side
    pixels, each (rows, columns)."""
    cells = [-(-length // side) for length in plane.shape]
    low, high = np.empty(cells, np.float32), np.empty(cells, np.float32)
    _bounds_of_cells(0, cells[0], whole(plane, np.float32), np.array([side]), low, high)
    return low, high


def mark_positive(plane: np.ndarray, side: int, cells: np.ndarray) -> None:
    """Set cells of side x side pixels in which a plane (h, w, 1) is positive anywhere."""
    rows = -(-len(plane) // side)
    _mark_positive(0, rows, whole(plane[..., 0], np.float32), np.array([side]), cells)


def lit_cells(plane: np.ndarray, side: int) -> np.ndarray:
    """The cells of side x side pixels of a plane (h, w, C) of float32 that are not 0 everywhere:
    (rows, columns) of bool."""
    cells = np.zeros([-(-length // side) for length in plane.shape[:2]], bool)
    bits = whole(plane, np.float32).view(np.uint32)
    share(_mark_lit, len(cells), bits, np.array([side]), cells)
    return cells


def pick_light(colour: np.ndarray, rows: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """Luminance of a picture (h, w, 3) at some of its rows and columns, numbers of any shape; a
    copy of float32 (rows.size, columns.size). Negative channels and what is no number count as 0,
    infinite ones as much light."""
    light = np.empty((rows.size, columns.size), np.float32)
    places = [whole(one.reshape(-1), np.int64) for one in (rows, columns)]
    _pick_light(0, len(light), whole(colour, np.float32), *places, light)
    return light


def coverage_noise(depth: np.ndarray, farthest: float) -> float:
    """Share of the pixels of depth (h, w) that are a hit where at least three of four neighbours
    are misses, or the other way round. Surfaces have next to none; of white noise it is up to 5/16.
    Every second row is looked at."""
    rows, inner = max(depth.shape[0] - 1, 0) // 2, depth.shape[1] - 2
    odd = np.zeros(rows, np.float32)
    _coverage_noise(0, rows, whole(depth, np.float32), np.array([farthest], np.float32), odd)
    found: float = odd.sum(dtype=np.float64).item() / max(rows * inner, 1)
    return found


# The coarse grid

_band_of = Rows("band_of")
_pick_light = Rows("pick_light")
_compare_cells = Rows("compare_cells")


def depth_doublings(depth: np.ndarray, beyond: float) -> np.ndarray:
    """log2 of depths, of which those from `beyond` on, and what is no number, lie one doubling
    behind the farthest of the others; none is less than `LEAST_DEPTH`."""
    is_hit = depth < beyond
    limited = np.where(is_hit, np.maximum(depth, LEAST_DEPTH),
                       2 * depth.max(initial=LEAST_DEPTH, where=is_hit))
    doublings: np.ndarray = np.log2(limited)
    return doublings


def band_of(planes: np.ndarray, narrow: int, wide: int) -> np.ndarray:
    """Mean over narrow x narrow cells less that over wide x wide ones, both odd; planes (rows,
    columns, ...) to the same. Edges are repeated."""
    flat = whole(planes.reshape(*planes.shape[:2], -1), np.float64)
    band = np.empty(flat.shape)
    _band_of(0, len(band), flat, np.array([narrow, wide]), band)
    return band.reshape(planes.shape)


def relate_cells(
    before: np.ndarray, now: np.ndarray, motion: np.ndarray, least_spread: float,
    least_reliability: float
) -> tuple[float | None, int]:
    """Correlation of cells (rows, columns, 2 halves, ...) with what was where their motion (rows,
    columns, 2), in cells, leads: all channels together, as it would be without noise. And how many
    lead between the outermost cells' centres, as others do not count.

    None where the mean of the halves varies by less than `least_spread`, or where less than
    `least_reliability` of its variance is no noise.
    """
    flat = [whole(one.reshape(*one.shape[:2], -1), np.float64) for one in (before, now, motion)]
    channels, inside = flat[0].shape[2] // 2, np.empty(1, np.int64)
    moments = np.empty((3, channels, 3))
    _compare_cells(0, channels, *flat, moments, inside)
    count = int(inside[0])
    correlations: list[float | None] = []
    means = (moments.sum(axis=1) / max(channels * count, 1)).tolist()
    for (square, other_square, both), least in zip(means, (least_spread, 0.0, 0.0), strict=True):
        spread, other_spread = math.sqrt(square), math.sqrt(other_square)
        varies = min(spread, other_spread) > least
        correlations.append(both / (spread * other_spread) if varies else None)
    found, *of_halves = correlations

    # What of the variance of a mean of two halves is no noise, by Spearman and Brown.
    shared = [max(one or 0.0, 0.0) for one in of_halves]
    first, second = (2 * one / (1 + one) for one in shared)
    if found is None or min(first, second) < least_reliability:
        return None, count
    return found / math.sqrt(first * second), count


# Light outside the gamut

LOOKED_AT_PX = 128
"""Pixels along a side that are looked at for light outside the gamut, up to twice as many."""
OUTSIDE = 0.006
"""From this share of light outside the gamut on, it is worth denoising in wider primaries: they
gained 0.7 dB at 0.008. Below it are pixel filters with negative lobes, up to 0.005 by Lanczos,
where they neither gain nor lose."""


def light_outside(colour: np.ndarray) -> float:
    """Share of the light of a picture (h, w, 3) that is negative and that wider primaries turn
    positive.

    Pixels count by their brightness up to that of the usual pixel, brighter ones no more, so that a
    few fireflies decide nothing. Grey light below 0, as pixel filters leave it beside bright edges,
    does not count, nor do pixels without any positive number.
    """
    down, right = (max(1, side // LOOKED_AT_PX) for side in colour.shape[:2])
    pixels = sampled(colour, down, right).reshape(-1, 3)
    if not (pixels < 0).any():
        return 0.0
    pixels = pixels[np.isfinite(pixels).all(1)].astype(np.float64)
    brightest = np.abs(pixels).max(1, initial=0.0)
    lit = brightest > 0
    seen = (pixels[lit] / (np.exp(np.log(brightest[lit]).mean()) + brightest[lit])[:, None]
            if lit.any() else pixels)
    mixed = seen[seen.max(1, initial=-1.0) > 0]
    gained = np.minimum(mixed @ TO_WIDER_PRIMARIES.T, 0).sum() - np.minimum(mixed, 0).sum()
    return float(gained / max(np.abs(seen).sum(), 1e-12))
