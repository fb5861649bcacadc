"""Kernels that prepare what the network and its filters read.

They compute the scale of depth, spread motion over edges, average reflectance in cells, weight what accumulates over
time, resize what one frame leaves to the next, and warp the last output to where its pixels are now.
"""

from __future__ import annotations

import numpy as np

from postfx.kernels.denoise import (
    BORDER_CELLS,
    DISTRUST,
    EXPOSURE,
    GAIN,
    HEIGHT,
    HIDDEN,
    IMPORTANCE,
    LEFT,
    MAX_COLOUR,
    MAX_COUNT,
    MAX_FLOAT,
    MAX_LIGHT,
    MEMORY,
    MOST_STATE,
    PLANE_TRUST,
    REFLECTANCE,
    TOP,
    TRUST_CELL,
    WIDTH,
    kernel,
)
from postfx.kernels.numeric import (
    Four,
    Real,
    add_four,
    centre,
    clamp,
    compiled,
    demodulation,
    expm1,
    fused,
    fused_inline,
    inline,
    load_four,
    log1p,
    store_four,
    summed,
    vectorised,
)

ZERO, HALF, ONE = np.float32(0), np.float32(0.5), np.float32(1)
NEAREST, FARTHEST, MOST_MOTION = np.float32(1e-6), np.float32(1e9), np.float32(1e5)


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
def mean_rows(y0: int, y1: int, diffuse_albedo: np.ndarray, specular_albedo: np.ndarray, part_rows: np.ndarray,
              part_columns: np.ndarray, means: np.ndarray) -> None:
    """Mean reflectance of the frame's cells from the one before the part's first row and column on; the frame's first
    and last cells repeat beyond it."""
    h, w = diffuse_albedo.shape[:2]
    top, left = int(part_rows[0]) // TRUST_CELL - 1, int(part_columns[0]) // TRUST_CELL - 1
    for row in range(y0, y1):
        first = min(max(top + row, 0), (h - 1) // TRUST_CELL) * TRUST_CELL
        end = min(first + TRUST_CELL, h)
        for column in range(means.shape[1]):
            start = min(max(left + column, 0), (w - 1) // TRUST_CELL) * TRUST_CELL
            stop = min(start + TRUST_CELL, w)
            r = g = b = ZERO
            for y in range(first, end):
                for x in range(start, stop):
                    own = demodulation(diffuse_albedo, specular_albedo, y, x)
                    r, g, b = r + own[0], g + own[1], b + own[2]
            share = ONE / np.float32((end - first) * (stop - start))
            means[row, column, 0], means[row, column, 1], means[row, column, 2] = r * share, g * share, b * share


@inline
def cell_place(at: int, size: int) -> Real:
    """Where a pixel of a side lies among the frame's cells, from centre to centre."""
    place = (np.float32(at) + HALF) / np.float32(TRUST_CELL) - HALF
    return min(max(place, ZERO), np.float32((size - 1) // TRUST_CELL))


@compiled
def doubt_row(y: int, top: int, left: int, h: int, w: int, means: np.ndarray, trust: np.ndarray, line: np.ndarray,
              factor: np.ndarray) -> None:
    """A row of reflectance (tw, 3), blended towards the mean around each pixel as far as it is not trusted; ``y``,
    ``top`` and ``left`` count the frame's pixels."""
    place = cell_place(y, h)
    first = top // TRUST_CELL - 1
    upper, lower = int(place) - first, min(int(place) + 1, (h - 1) // TRUST_CELL) - first
    down = place - np.float32(int(place))
    for i in range(line.shape[0]):
        for c in range(3):
            line[i, c] = means[upper, i, c] + (means[lower, i, c] - means[upper, i, c]) * down
    first = left // TRUST_CELL - 1
    for x in range(min(factor.shape[0], w - left)):
        place = cell_place(left + x, w)
        before, after = int(place) - first, min(int(place) + 1, (w - 1) // TRUST_CELL) - first
        across = place - np.float32(int(place))
        doubt = HALF - HALF * trust[x]
        doubt = doubt if ZERO <= doubt <= ONE else ZERO  # a broken answer doubts nothing
        for c in range(3):
            mean = line[before, c] + (line[after, c] - line[before, c]) * across
            factor[x, c] -= (factor[x, c] - mean) * doubt


@compiled
def accumulate_rows(y0: int, y1: int, colour: np.ndarray, diffuse_albedo: np.ndarray, specular_albedo: np.ndarray,
                    means: np.ndarray, depth: np.ndarray, past: np.ndarray, fine: np.ndarray, params: np.ndarray,
                    window: np.ndarray, state: np.ndarray, next_depth: np.ndarray, level: np.ndarray,
                    factor: np.ndarray) -> None:
    """Running mean of demodulated colour; ``level`` (4, hp, wp) holds it and its importance, zero beyond the frame.

    A state of zeros is unknown. It is so at the part's edges within the frame, because all pixels of the last output
    that are read around a known one must be known, too.
    """
    top, left = int(window[TOP]), int(window[LEFT])
    under, beside = top + past.shape[0] < colour.shape[0], left + past.shape[1] < colour.shape[1]
    rows, columns = min(past.shape[0], colour.shape[0] - top), min(past.shape[1], colour.shape[1] - left)
    line = np.empty((means.shape[1], 3), np.float32)
    for y in range(y0, y1):
        first = columns if y < rows else 0
        level[:, y, first:] = ZERO
        if y < past.shape[0]:
            state[y, first:], next_depth[y, first:], factor[y, first:] = ZERO, ZERO, ZERO
        for x in range(first):
            factor[y, x, 0], factor[y, x, 1], factor[y, x, 2] = demodulation(
                diffuse_albedo, specular_albedo, top + y, left + x)
        if first and means.shape[0] > 1:
            doubt_row(top + y, top, left, colour.shape[0], colour.shape[1], means, fine[0, PLANE_TRUST, y], line,
                      factor[y])
        for x in range(first):
            v, u = top + y, left + x
            share = ONE / (max(past[y, x, 3], ZERO) + ONE)
            alpha = share + (ONE - share) * fine[0, DISTRUST, y, x]
            level[3, y, x] = fine[0, IMPORTANCE, y, x]
            next_depth[y, x, 0] = depth[v, u, 0]
            state[y, x, 3] = min(ONE / alpha, np.float32(MAX_COUNT))
            total = state[y, x, 3] + abs(level[3, y, x])
            for c in range(HIDDEN):
                state[y, x, 4 + c] = fine[0, MEMORY + c, y, x]
                total += abs(state[y, x, 4 + c])
            brightest = np.float32(MAX_COLOUR)
            for c in range(3):
                exposed = clamp(colour[v, u, c], ZERO, MAX_FLOAT) * params[EXPOSURE]
                level[c, y, x] = min(exposed / factor[y, x, c], np.float32(MAX_LIGHT))
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


SCALE = kernel("scale", ("depth",), ("depth_scale",), scale_rows, ("depth_scale", 0))
DILATE = kernel("dilate", ("motion", "depth", "part_rows", "part_columns"), ("moved",), dilate_rows, ("moved", 0))
MEANS = kernel("means", (*REFLECTANCE, "part_rows", "part_columns"), ("means",), mean_rows, ("means", 0))
ACCUMULATE = kernel("accumulate", ("colour", *REFLECTANCE, "means", "depth", "past", "fine", "params", "window"),
                    ("next_state", "next_depth", "level", "factor"), accumulate_rows, ("level", 1))


def means_size(rows: int, columns: int) -> tuple[int, int]:
    """Cells of mean reflectance, down and across, that a part of the frame needs wherever it begins."""
    return -(-rows // TRUST_CELL) + BORDER_CELLS, -(-columns // TRUST_CELL) + BORDER_CELLS


STATE = 4 + HIDDEN


@compiled
def resize_rows(y0: int, y1: int, state: np.ndarray, last_depth: np.ndarray, at_rows: np.ndarray,
                at_columns: np.ndarray, resized: np.ndarray, resized_depth: np.ndarray) -> None:
    """Bilinear at ``at_rows`` (height,) and ``at_columns`` (width,), edge repeated; depth of the nearest pixel.

    Pixels whose count is 0 are unknown and have no weight. Where they would have half of it, the result is unknown.
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


@fused_inline
def cubic(t: Real) -> tuple[Real, Real, Real, Real]:
    """The four weights of cubic convolution with a = -0.75, the ONNX GridSample and OpenCV default."""
    a = np.float32(-0.75)
    u, v, s = t + ONE, ONE - t, np.float32(2) - t
    return (((a * u - 5 * a) * u + 8 * a) * u - 4 * a, ((a + 2) * t - (a + 3)) * t * t + ONE,
            ((a + 2) * v - (a + 3)) * v * v + ONE, ((a * s - 5 * a) * s + 8 * a) * s - 4 * a)


@vectorised
def steps(moved: np.ndarray, axis: int, scale: Real, shift: np.ndarray, weights: np.ndarray) -> None:
    """Motion along a row in whole output pixels, and the weights (4, w) of the cubic taps for the rest of it.

    All output pixels in a render pixel share them, for they share its motion.
    """
    for x in range(shift.size):
        at = moved[x, axis] * scale
        whole = np.floor(at)
        shift[x] = np.int32(whole)
        weights[0, x], weights[1, x], weights[2, x], weights[3, x] = cubic(at - whole)


@fused_inline
def weigh(a: Four, b: Four, c: Four, d: Four, u: Real, v: Real, w: Real, z: Real) -> Four:
    """u a + v b + w c + z d."""
    zero = np.float32(0)
    return add_four(add_four(add_four(add_four((zero, zero, zero, zero), b, v), a, u), c, w), d, z)


@fused_inline
def down(flat: np.ndarray, start: int, line: int, d0: Real, d1: Real, d2: Real, d3: Real) -> Four:
    """Weighted sum of four pixels below one another in a flat picture, and of the number behind each; unsigned places
    need no check for below 0."""
    second, third = start + line, start + line + line
    return weigh(load_four(flat, start), load_four(flat, second), load_four(flat, third),
                 load_four(flat, third + line), d0, d1, d2, d3)


@fused_inline
def down_last(flat: np.ndarray, start: int, line: int, d0: Real, d1: Real, d2: Real, d3: Real) -> Four:
    """The same of pixels behind which there may be nothing."""
    _, r, g, b = down(flat, start - np.uint64(1), line, d0, d1, d2, d3)
    return r, g, b, b


@fused_inline
def columns_of(flat: np.ndarray, start: int, line: int, d0: Real, d1: Real, d2: Real,
               d3: Real) -> tuple[Four, Four, Four, Four]:
    """Weighted sums down four columns of pixels, from a place on."""
    step = np.uint64(3)
    return (down(flat, start, line, d0, d1, d2, d3), down(flat, start + step, line, d0, d1, d2, d3),
            down(flat, start + step + step, line, d0, d1, d2, d3),
            down_last(flat, start + step + step + step, line, d0, d1, d2, d3))


@fused
def edge_pixel(left: int, top: int, history: np.ndarray, at: int, wx: np.ndarray, wy: np.ndarray,
               pixel: np.ndarray) -> None:
    """One pixel near the picture's edge, which is repeated."""
    height, width = history.shape[:2]
    pixel[:] = ZERO
    for j in range(4):
        for i in range(4):
            weight = wy[j, at] * wx[i, at]
            found = history[min(max(top + j, 0), height - 1), min(max(left + i, 0), width - 1)]
            for c in range(3):
                pixel[c] += weight * found[c]


@fused
def warp_row(y: int, columns: np.ndarray, history: np.ndarray, index: np.ndarray, shift_x: np.ndarray,
             shift_y: np.ndarray, wx: np.ndarray, wy: np.ndarray, row: np.ndarray) -> None:
    """Row ``y`` of the history moved, at ``columns``; ``index`` is the render pixel of each output pixel. ``row`` has
    one more number than pixels have: they are written with the number behind each.

    Two neighbours in one render pixel share their motion, and so three of their four columns of taps.
    """
    height, width = history.shape[:2]
    flat = history.reshape(height * width * 3)
    line, next_pixel = np.uint64(3 * width), np.uint64(3)
    x = 0
    while x < index.size:
        at = index[x]
        left, top = columns[x] + shift_x[at] - 1, y + shift_y[at] - 1
        if not (0 <= left <= width - 4 and 0 <= top <= height - 4):
            edge_pixel(left, top, history, at, wx, wy, row[3 * x:3 * x + 3])
            x += 1
            continue
        w0, w1, w2, w3 = wx[0, at], wx[1, at], wx[2, at], wx[3, at]
        d0, d1, d2, d3 = wy[0, at], wy[1, at], wy[2, at], wy[3, at]
        start = np.uint64((top * width + left) * 3)
        a, b, c, d = columns_of(flat, start, line, d0, d1, d2, d3)
        store_four(row, np.uint64(3 * x), weigh(a, b, c, d, w0, w1, w2, w3))
        x += 1
        if x < index.size and index[x] == at and columns[x] == columns[x - 1] + 1 and left < width - 4:
            e = down_last(flat, start + next_pixel * np.uint64(4), line, d0, d1, d2, d3)
            store_four(row, np.uint64(3 * x), weigh(b, c, d, e, w0, w1, w2, w3))
            x += 1


@vectorised
def rescale_row(row: np.ndarray, gain: Real) -> None:
    """A row of log-encoded colour after an exposure change."""
    for i in range(row.size):
        row[i] = log1p(expm1(row[i]) * gain)


@compiled
def history_rows(y0: int, y1: int, history: np.ndarray, moved: np.ndarray, params: np.ndarray, window: np.ndarray,
                 out_rows: np.ndarray, out_columns: np.ndarray, warped: np.ndarray) -> None:
    """The last output where its pixels are now, bicubic, edge repeated; rescaled where the exposure changed."""
    height, width = history.shape[:2]
    h, w = int(window[HEIGHT]), int(window[WIDTH])
    columns, count = out_columns.astype(np.int64), moved.shape[1]
    index = np.empty(columns.size, np.int64)
    for x in range(index.size):
        at, _ = centre(columns[x], w, width)
        index[x] = min(max(at - int(window[LEFT]), 0), count - 1)
    shift_x, shift_y = np.empty(count, np.int32), np.empty(count, np.int32)
    wx, wy = np.empty((4, count), np.float32), np.empty((4, count), np.float32)
    line, last = np.empty(3 * index.size + 1, np.float32), -1
    for out in range(y0, y1):
        y = int(out_rows[out])
        iy, _ = centre(y, h, height)
        iy = min(max(iy - int(window[TOP]), 0), moved.shape[0] - 1)
        if iy != last:
            steps(moved[iy], 0, np.float32(width / w), shift_x, wx)
            steps(moved[iy], 1, np.float32(height / h), shift_y, wy)
            last = iy
        row = warped[out].reshape(3 * index.size)
        warp_row(y, columns, history, index, shift_x, shift_y, wx, wy, line)
        np.maximum(line[:row.size], ZERO, row)
        if params[GAIN] != ONE:
            rescale_row(row, params[GAIN])


HISTORY = kernel("history", ("history", "moved", "params", "window", "out_rows", "out_columns"), ("warped",),
                 history_rows, ("warped", 0))
