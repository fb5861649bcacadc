"""What is prepared for the network and the filters: scale of depth, motion, accumulation, another size.

Kernels around the upscaler's network: the scale of depth, motion at edges, and accumulation over time.

Kernel that brings what a frame leaves to the next one to that one's render size.
"""

from __future__ import annotations

import numpy as np

from postfx.kernels.denoise.layout import (
    DISTRUST,
    EXPOSURE,
    HIDDEN,
    IMPORTANCE,
    LEFT,
    MAX_COLOUR,
    MAX_COUNT,
    MAX_FLOAT,
    MEMORY,
    MOST_STATE,
    REFLECTANCE,
    TOP,
    kernel,
)
from postfx.kernels.numeric import Real, clamp, compiled, demodulation, inline, summed

ZERO, ONE = np.float32(0), np.float32(1)
NEAREST, FARTHEST, MOST_MOTION = np.float32(1e-6), np.float32(1e9), np.float32(1e5)


@summed
def scale_rows(y0: int, y1: int, depth: np.ndarray, scale: np.ndarray) -> None:
    """Harmonic mean depth of what was hit, 1 where nothing was; a single row, so one thread sums in one order."""
    hits, near, flat = 0.0, 0.0, depth.reshape(depth.size)
    for i in range(flat.size):
        z = flat[i]
        hit = (z > ZERO) & (z < FARTHEST)
        hits += np.float64(ONE if hit else ZERO)
        near += np.float64(ONE / max(z, NEAREST) if hit else ZERO)
    scale[0] = hits / near if hits else 1.0


@inline
def finite(value: Real) -> Real:
    """Motion of a pixel; what no picture can have (NaN, infinity) is none."""
    return value if -MOST_MOTION < value < MOST_MOTION else ZERO


@compiled
def nearer(line: np.ndarray, place: Real, near: np.ndarray, found: np.ndarray) -> None:
    """Take what is nearer than what was found so far, and note its place."""
    for x in range(near.size):
        here, best, at = line[x], near[x], found[x]
        found[x] = place if here < best else at
        near[x] = here if here < best else best


@compiled
def dilate_row(y: int, left: int, depth: np.ndarray, lines: np.ndarray, near: np.ndarray, found: np.ndarray) -> None:
    """For pixels of a row from `left` on, where the depth lies whose motion they take, from the pixel: that of a
    clearly nearer neighbour in 3x3, the first of the nearest, or its own. `depth` is (h, w)."""
    h, w = depth.shape
    count = near.size
    lines[:] = np.inf  # what is beyond the picture is never nearer
    before, after = min(left, 1), min(w - left - count, 1)
    for j in range(max(y - 1, 0), min(y + 2, h)):
        lines[j - y + 1, 1 - before:1 + count + after] = depth[j, left - before:left + count + after]
    for x in range(count):
        near[x], found[x] = lines[1, x + 1] * np.float32(0.9), 0
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
def accumulate_rows(y0: int, y1: int, colour: np.ndarray, diffuse_albedo: np.ndarray, specular_albedo: np.ndarray,
                    depth: np.ndarray, past: np.ndarray, fine: np.ndarray, params: np.ndarray, window: np.ndarray,
                    state: np.ndarray, next_depth: np.ndarray, level: np.ndarray) -> None:
    """Running mean of demodulated colour; ``level`` (4, hp, wp) is it with its importance, zero beyond the frame.

    A state of zeros is one that is not known: as at the part's edge, where the frame goes on, since what is read of the
    last output around a known pixel must be known, too.
    """
    top, left = int(window[TOP]), int(window[LEFT])
    under, beside = top + past.shape[0] < colour.shape[0], left + past.shape[1] < colour.shape[1]
    rows, columns = min(past.shape[0], colour.shape[0] - top), min(past.shape[1], colour.shape[1] - left)
    for y in range(y0, y1):
        first = columns if y < rows else 0
        level[:, y, first:] = ZERO
        if y < past.shape[0]:
            state[y, first:], next_depth[y, first:] = ZERO, ZERO
        for x in range(first):
            v, u = top + y, left + x
            f0, f1, f2 = demodulation(diffuse_albedo, specular_albedo, v, u)
            share = ONE / (max(past[y, x, 3], ZERO) + ONE)
            alpha = share + (ONE - share) * fine[0, DISTRUST, y, x]
            level[3, y, x] = fine[0, IMPORTANCE, y, x]
            next_depth[y, x, 0] = depth[v, u, 0]
            state[y, x, 3] = min(ONE / alpha, np.float32(MAX_COUNT))
            total = state[y, x, 3] + abs(level[3, y, x])
            for c in range(HIDDEN):
                state[y, x, 4 + c] = fine[0, MEMORY + c, y, x]
                total += abs(state[y, x, 4 + c])
            for c, f in enumerate((f0, f1, f2)):
                exposed = clamp(colour[v, u, c], ZERO, MAX_FLOAT) * params[EXPOSURE]
                level[c, y, x] = min(exposed / f, np.float32(MAX_COLOUR))
                state[y, x, c] = past[y, x, c] + (level[c, y, x] - past[y, x, c]) * alpha
                total += abs(state[y, x, c])
            if total <= MOST_STATE:
                for c in range(3):
                    level[c, y, x] = state[y, x, c]
            else:  # broken: this frame's colour alone, and nothing that the next one knows
                level[3, y, x] = ONE
                state[y, x] = ZERO
        if (y == 0 and top > 0) or (y == past.shape[0] - 1 and under):
            state[y] = ZERO
        elif y < past.shape[0]:
            if left > 0:
                state[y, 0] = ZERO
            if beside:
                state[y, past.shape[1] - 1] = ZERO


SCALE = kernel("scale", ("depth",), ("depth_scale",), scale_rows, ("depth_scale", 0))
DILATE = kernel("dilate", ("motion", "depth", "part_rows", "part_columns"), ("moved",), dilate_rows, ("moved", 0))
ACCUMULATE = kernel("accumulate", ("colour", *REFLECTANCE, "depth", "past", "fine", "params", "window"),
                    ("next_state", "next_depth", "level"), accumulate_rows, ("level", 1))


HALF = np.float32(0.5)
STATE = 4 + HIDDEN


@compiled
def resize_rows(y0: int, y1: int, state: np.ndarray, last_depth: np.ndarray, at_rows: np.ndarray,
                at_columns: np.ndarray, resized: np.ndarray, resized_depth: np.ndarray) -> None:
    """Bilinear at ``at_rows`` (height,) and ``at_columns`` (width,), edge repeated; depth of the nearest pixel.

    Pixels whose count is 0 hold nothing and do not count; where they are half of it, nothing is held.
    """
    h, w = state.shape[:2]
    share = np.empty(4, np.float32)
    for y in range(y0, y1):
        top = int(np.floor(at_rows[y]))
        ty = at_rows[y] - np.float32(top)
        upper, lower = min(max(top, 0), h - 1), min(max(top + 1, 0), h - 1)
        near_y = min(max(int(np.rint(at_rows[y])), 0), h - 1)
        for x in range(resized.shape[1]):
            first = int(np.floor(at_columns[x]))
            tx = at_columns[x] - np.float32(first)
            left, right = min(max(first, 0), w - 1), min(max(first + 1, 0), w - 1)
            resized_depth[y, x, 0] = last_depth[near_y, min(max(int(np.rint(at_columns[x])), 0), w - 1), 0]
            a, b, c, d = state[upper, left], state[upper, right], state[lower, left], state[lower, right]
            share[0] = (ONE - ty) * (ONE - tx) if a[3] > ZERO else ZERO
            share[1] = (ONE - ty) * tx if b[3] > ZERO else ZERO
            share[2] = ty * (ONE - tx) if c[3] > ZERO else ZERO
            share[3] = ty * tx if d[3] > ZERO else ZERO
            total = share[0] + share[1] + share[2] + share[3]
            scale = ONE / total if total > HALF else ZERO
            for k in range(STATE):
                value = share[0] * a[k] + share[1] * b[k] + share[2] * c[k] + share[3] * d[k]
                resized[y, x, k] = value * scale


RESIZE = kernel("resize", ("state", "last_depth", "at_rows", "at_columns"), ("resized", "resized_depth"),
                resize_rows, ("resized", 0), at_rows=("height",), at_columns=("width",),
                resized=("height", "width", STATE), resized_depth=("height", "width", 1))
