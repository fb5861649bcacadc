"""Kernels that prepare what the network and its filters read.

They compute the scale of depth, spread motion over edges, average reflectance in cells, and weight what accumulates
over time.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from postfx.kernels import Blocks
from postfx.kernels.denoise import (
    BORDER_CELLS,
    DISTRUST,
    EXPOSURE,
    FARTHEST,
    FINE,
    HIDDEN,
    IMPORTANCE,
    LEFT,
    MAX_COLOUR,
    MAX_COUNT,
    MAX_FLOAT,
    MAX_LIGHT,
    MEMORY,
    MOST_MOTION,
    MOST_STATE,
    NEAREST,
    PLANE_TRUST,
    REFLECTANCE,
    TOP,
    TRUST_CELL,
    in_half,
    kernel,
)
from postfx.kernels.numeric import (
    Real,
    clamp,
    compiled,
    demodulation_row,
    inline,
    place,
    summed,
)

ZERO, HALF, ONE = np.float32(0), np.float32(0.5), np.float32(1)
CLEARLY = np.float32(0.9)
"""Share of a pixel's depth below which a neighbour is clearly nearer."""


@summed
def scale_rows(y0: int, y1: int, depth: np.ndarray, scale: np.ndarray) -> None:
    """Harmonic mean depth of all hits, 1 without any; a single row, so that one thread sums in a fixed order."""
    hits, near, flat = 0.0, 0.0, depth.reshape(depth.size)
    for i in range(flat.size):
        z = flat[i]
        hit = (z > ZERO) & (z < FARTHEST)
        hits += np.float64(ONE if hit else ZERO)
        near += np.float64(ONE / max(z, NEAREST) if hit else ZERO)
    scale[0] = hits / near if hits else 1.0


@inline
def finite(value: Real) -> Real:
    """Motion of a pixel; impossible values (NaN, infinity) become 0."""
    return value if -MOST_MOTION < value < MOST_MOTION else ZERO


@compiled
def nearer(line: np.ndarray, place: Real, near: np.ndarray, found: np.ndarray) -> None:
    """Keep the nearest depth so far, and its place."""
    for x in range(near.size):
        here, best, at = line[x], near[x], found[x]
        found[x] = place if here < best else at
        near[x] = here if here < best else best


@compiled
def dilate_row(y: int, left: int, depth: np.ndarray, lines: np.ndarray, near: np.ndarray, found: np.ndarray) -> None:
    """For the pixels of a row from `left` on, the offset of the pixel whose motion they take: of the nearest neighbour
    in 3x3 that is clearly nearer, the first of equals, else none. `depth` is (h, w)."""
    h, w = depth.shape
    count = near.size
    lines[:] = np.inf  # pixels beyond the picture are never nearer
    before, after = min(left, 1), min(w - left - count, 1)
    for j in range(max(y - 1, 0), min(y + 2, h)):
        lines[j - y + 1, 1 - before:1 + count + after] = depth[j, left - before:left + count + after]
    for x in range(count):
        near[x], found[x] = lines[1, x + 1] * CLEARLY, 0
    for j in range(3):
        for i in range(3):
            nearer(lines[j, i:], np.int32((j - 1) * w + i - 1), near, found)


@compiled
def dilate_rows(y0: int, y1: int, motion: np.ndarray, depth: np.ndarray, part_rows: np.ndarray,
                part_columns: np.ndarray, moved: np.ndarray) -> None:
    """Motion of a clearly nearer neighbour in 3x3, else the pixel's own."""
    (h, w), left = depth.shape[:2], int(part_columns[0])
    count = min(moved.shape[1], w - left)
    lines = np.empty((3, count + 2), np.float32)
    near, found = np.empty(count, np.float32), np.empty(count, np.int32)
    flat = motion.reshape(h * w, 2)
    for row in range(y0, y1):
        y = int(part_rows[row])
        dilate_row(y, left, depth.reshape(h, w), lines, near, found)
        for x in range(count):
            at = y * w + left + x + found[x]
            moved[row, x, 0], moved[row, x, 1] = finite(flat[at, 0]), finite(flat[at, 1])
        for x in range(count, moved.shape[1]):
            moved[row, x, 0], moved[row, x, 1] = moved[row, count - 1, 0], moved[row, count - 1, 1]


@compiled
def add_cells(row: np.ndarray, starts: np.ndarray, total: np.ndarray) -> None:
    """Add the pixels of a row to the sums of the cells that begin at ``starts``, the first of them at the row's first
    pixel."""
    for column in range(starts.size):
        found, start = total[column], starts[column] - starts[0]
        for x in range(start, min(start + TRUST_CELL, row.size)):
            found += row[x]
        total[column] = found


@compiled
def mean_rows(y0: int, y1: int, diffuse_albedo: np.ndarray, specular_albedo: np.ndarray, part_rows: np.ndarray,
              part_columns: np.ndarray, means: np.ndarray) -> None:
    """Mean reflectance of the frame's cells from the one before the part's first row and column on; the frame's first
    and last cells repeat beyond it."""
    h, w = diffuse_albedo.shape[:2]
    top, left, last = int(part_rows[0]) // TRUST_CELL - 1, int(part_columns[0]) // TRUST_CELL - 1, (w - 1) // TRUST_CELL
    starts = np.empty(means.shape[1], np.int64)
    for column in range(starts.size):
        starts[column] = min(max(left + column, 0), last) * TRUST_CELL
    begin, total = starts[0], np.empty((3, starts.size), np.float32)
    own = np.empty((3, min(starts[-1] + TRUST_CELL, w) - begin), np.float32)
    for row in range(y0, y1):
        first = min(max(top + row, 0), (h - 1) // TRUST_CELL) * TRUST_CELL
        end = min(first + TRUST_CELL, h)
        total[:] = ZERO
        for y in range(first, end):
            demodulation_row(diffuse_albedo[y, begin:], specular_albedo[y, begin:], own[0], own[1], own[2])
            for c in range(3):
                add_cells(own[c], starts, total[c])
        for column in range(starts.size):
            share = ONE / np.float32((end - first) * (min(starts[column] + TRUST_CELL, w) - starts[column]))
            for c in range(3):
                means[row, column, c] = total[c, column] * share


@inline
def cell_place(at: int, size: int) -> Real:
    """Where a pixel of a side lies among the frame's cells, from centre to centre."""
    place = (np.float32(at) + HALF) / np.float32(TRUST_CELL) - HALF
    return min(max(place, ZERO), np.float32((size - 1) // TRUST_CELL))


@compiled
def cells_beside(left: int, count: int, w: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The cells before and after each of a part's columns, from the one before its first column's on, and where between
    them it lies."""
    before, after, across = np.empty(count, np.int32), np.empty(count, np.int32), np.empty(count, np.float32)
    first, last = left // TRUST_CELL - 1, (w - 1) // TRUST_CELL
    for x in range(count):
        at = cell_place(left + x, w)
        before[x], after[x] = int(at) - first, min(int(at) + 1, last) - first
        across[x] = at - np.float32(int(at))
    return before, after, across


@compiled
def mean_between(y: int, top: int, h: int, means: np.ndarray, line: np.ndarray) -> None:
    """The means of the cells (3, columns) at a row; ``y`` and ``top`` count the frame's."""
    at, first = cell_place(y, h), top // TRUST_CELL - 1
    upper, lower = means[int(at) - first], means[min(int(at) + 1, (h - 1) // TRUST_CELL) - first]
    down = at - np.float32(int(at))
    for i in range(line.shape[1]):
        for c in range(3):
            line[c, i] = upper[i, c] + (lower[i, c] - upper[i, c]) * down


@compiled
def doubt_row(line: np.ndarray, before: np.ndarray, after: np.ndarray, across: np.ndarray, trust: np.ndarray,
              factor: np.ndarray) -> None:
    """A row of reflectance, blended towards the mean around each pixel as far as it is not trusted."""
    for x in range(factor.size):
        mean = line[before[x]] + (line[after[x]] - line[before[x]]) * across[x]
        doubt = HALF - HALF * trust[x]
        doubt = doubt if ZERO <= doubt <= ONE else ZERO  # a broken answer doubts nothing
        factor[x] -= (factor[x] - mean) * doubt


@compiled
def accumulate_rows(y0: int, y1: int, colour: np.ndarray, diffuse_albedo: np.ndarray, specular_albedo: np.ndarray,
                    means: np.ndarray, depth: np.ndarray, past: np.ndarray, fine: np.ndarray, params: np.ndarray,
                    window: np.ndarray, state: np.ndarray, next_depth: np.ndarray, level: np.ndarray,
                    factor: np.ndarray) -> None:
    """Running mean of demodulated colour; ``level`` (4, hp, wp) holds it and its importance, zero beyond the frame.

    A state of zeros is unknown. It is so at the part's edges within the frame, because all pixels of the last output
    that are read around a known one must be known, too. Of the fine head, the last channels are enough.
    """
    top, left, first_held = int(window[TOP]), int(window[LEFT]), FINE - fine.shape[1]
    under, beside = top + past.shape[0] < colour.shape[0], left + past.shape[1] < colour.shape[1]
    rows, columns = min(past.shape[0], colour.shape[0] - top), min(past.shape[1], colour.shape[1] - left)
    line, reflectance = np.empty((3, means.shape[1]), np.float32), np.empty((3, columns), np.float32)
    red, green, blue = reflectance[0], reflectance[1], reflectance[2]
    before, after, across = cells_beside(left, columns, colour.shape[1])
    for y in range(y0, y1):
        first = columns if y < rows else 0
        level[:, y, first:] = ZERO
        if y < past.shape[0]:
            state[y, first:], next_depth[y, first:], factor[y, first:] = ZERO, ZERO, ZERO
        if first:
            demodulation_row(diffuse_albedo[top + y, left:], specular_albedo[top + y, left:], red, green, blue)
            if means.shape[0] > 1:
                mean_between(top + y, top, colour.shape[0], means, line)
                for c in range(3):
                    doubt_row(line[c], before, after, across, fine[0, PLANE_TRUST - first_held, y], reflectance[c])
            for c in range(3):
                place(reflectance[c], c, 3, factor[y].reshape(factor[y].size))
        for x in range(first):
            v, u = top + y, left + x
            share = ONE / (max(past[y, x, 3], ZERO) + ONE)
            alpha = share + (ONE - share) * fine[0, DISTRUST - first_held, y, x]
            level[3, y, x] = fine[0, IMPORTANCE - first_held, y, x]
            next_depth[y, x, 0] = depth[v, u, 0]
            state[y, x, 3] = min(ONE / alpha, np.float32(MAX_COUNT))
            total = state[y, x, 3] + abs(level[3, y, x])
            for c in range(HIDDEN):
                state[y, x, 4 + c] = fine[0, MEMORY + c - first_held, y, x]
                total += abs(state[y, x, 4 + c])
            brightest = np.float32(MAX_COLOUR)
            for c in range(3):
                exposed = clamp(colour[v, u, c], ZERO, MAX_FLOAT) * params[EXPOSURE]
                level[c, y, x] = min(exposed / reflectance[c, x], np.float32(MAX_LIGHT))
                brightest = max(brightest, level[c, y, x])
            for c in range(3):
                level[c, y, x] *= np.float32(MAX_COLOUR) / brightest  # the sun keeps its hue
                state[y, x, c] = past[y, x, c] + (level[c, y, x] - past[y, x, c]) * alpha
                total += abs(state[y, x, c])
            if total <= MOST_STATE:
                for c in range(3):
                    level[c, y, x] = state[y, x, c]
            else:  # broken: this frame's colour alone, and nothing for the next
                level[3, y, x] = ONE
                state[y, x] = ZERO
        if (y == 0 and top > 0) or (y == past.shape[0] - 1 and under):
            state[y] = ZERO
        elif y < past.shape[0]:
            if left > 0:
                state[y, 0] = ZERO
            if beside:
                state[y, past.shape[1] - 1] = ZERO


SUMMING = 256
"""Threads of a GPU's blocks that sum, and how many such blocks there are at most."""
SCALE = replace(kernel("scale", ("depth",), ("depth_scale",), scale_rows, ("depth_scale", 0)),
                blocks=Blocks(0, SUMMING, most=SUMMING // 2, between=4 * SUMMING + 4))
DILATE = kernel("dilate", ("motion", "depth", "part_rows", "part_columns"), ("moved",), dilate_rows, ("moved", 0))
MEANS = replace(kernel("means", (*REFLECTANCE, "part_rows", "part_columns"), ("means",), mean_rows, ("means", 0)),
                blocks=Blocks(0, SUMMING, most=1024))
ACCUMULATE = kernel("accumulate", ("colour", *REFLECTANCE, "means", "depth", "past", "fine", "params", "window"),
                    ("next_state", "next_depth", "level", "factor"), accumulate_rows, ("level", 1),
                    fine=(1, "controls", "hp", "wp"))
in_half(ACCUMULATE, "fine")


def means_size(rows: int, columns: int) -> tuple[int, int]:
    """Cells of mean reflectance, down and across, that a part of the frame needs wherever it begins."""
    return -(-rows // TRUST_CELL) + BORDER_CELLS, -(-columns // TRUST_CELL) + BORDER_CELLS
