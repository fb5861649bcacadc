"""Kernel that enlarges the filtered radiance and blends it with the reprojected history.

Every output row is made in planar rows, where loops over few arrays become vector code, and interleaved at its end.
"""

import math

import numpy as np

from postfx.kernels.denoise_layout import BLEND, EXPOSURE, FRESH, JITTER_X, JITTER_Y, PHASES, kernel
from postfx.kernels.numeric import add, add_product, centre, compiled, expm1, inline, log_encode, vectorised

TAPS = 9
SIGMA = 0.5
ZERO, ONE, HALF, TINY = np.float32(0), np.float32(1), np.float32(0.5), np.float32(1e-8)


@inline
def gauss(distance):
    return np.float32(math.exp(-(distance * distance) / (2 * SIGMA * SIGMA)))


@inline
def lean(offset):
    """Share of the right or lower of the two quarter-pixel corners at an offset."""
    return np.float32(min(max(2 * offset + 0.5, 0.0), 1.0))


@inline
def held(px, py, width, height):
    """Whether a position lies in a picture."""
    return -HALF <= px <= np.float32(width) - HALF and -HALF <= py <= np.float32(height) - HALF


@vectorised
def between(upper, lower, share, scale, out):
    """Linear interpolation of two rows, scaled."""
    for x in range(out.size):
        out[x] = (upper[x] + (lower[x] - upper[x]) * share) * scale


@vectorised
def scaled(row, scale, out):
    for x in range(out.size):
        out[x] = row[x] * scale


@vectorised
def add_picked(corners, source, gauss_x, index, leans, total, row):
    """Add a tap to a row at any scale; ``index`` and ``leans`` say which pixel and how far right in it."""
    for x in range(index.size):
        at = index[x]
        k = (corners[0, at] + (corners[1, at] - corners[0, at]) * leans[x]) * gauss_x[x]
        total[x] += k
        for c in range(3):
            row[c, x] += k * source[c, at]


@vectorised
def encode(row, total):
    """Normalise by the sum of weights and log-encode."""
    for x in range(total.size):
        row[x] = log_encode(row[x] / total[x])


@vectorised
def place(row, first, step, flat):
    """Spread a row over an interleaved one."""
    for x in range(row.size):
        flat[first + step * x] = row[x]


@vectorised
def blend_rows(current, warped, trust, darken, history, output):
    """Blend with the reprojected history and decode, all channels interleaved."""
    for i in range(history.size):
        history[i] = current[i] + (warped[i] - current[i]) * trust[i]
    for i in range(history.size):
        output[i] = expm1(history[i]) * darken


@compiled
def trust_side(side, y, size, moved, scale, fresh, trust):
    """At scale 2, how much of the history each output pixel on one side of the render pixels keeps.

    ``trust`` holds the predicted blend at first; nothing is kept where the pixel lay beyond the border.
    """
    for x in range(trust.size):
        px, py = np.float32(2 * x + side) + moved[x, 0] * scale[0], y + moved[x, 1] * scale[1]
        trust[x] = fresh * (ONE - trust[x]) if held(px, py, size[0], size[1]) else ZERO


@compiled
def double_row(y, iy, lower, radiance, fine, moved, gauss_x, gauss_y, size, scale, fresh, rows, current, trust):
    """A row at scale 2, where output pixels lie at the corners of render pixels: all loops are free of gaps."""
    w = rows.shape[1]
    for side in range(2):
        corner = 2 * lower + side
        rows[:4], rows[4] = ZERO, TINY
        for tap in range(TAPS):
            j, i = tap // 3, tap % 3
            scaled(fine[0, PHASES + 4 * tap + corner, iy], gauss_y[j] * gauss_x[i, side], rows[3])
            add(rows[3], rows[4])
            for c in range(3):
                add_product(rows[3], radiance[c, iy + j, i:i + w], rows[c])
        for c in range(3):
            encode(rows[c], rows[4])
            place(rows[c], 3 * side + c, 6, current)
        rows[3] = fine[0, BLEND + corner, iy, :w]
        trust_side(side, np.float32(y), size, moved[iy], scale, fresh, rows[3])
        for c in range(3):
            place(rows[3], 3 * side + c, 6, trust)


@compiled
def any_row(y, iy, ty, radiance, fine, moved, gauss_x, gauss_y, size, scale, fresh, index, leans, corners, rows,
            current, trust):
    """A row at any scale."""
    w = corners.shape[1]
    rows[:4], rows[4] = ZERO, TINY
    for tap in range(TAPS):
        j, i = tap // 3, tap % 3
        for side in range(2):
            corner = PHASES + 4 * tap + side
            between(fine[0, corner, iy], fine[0, corner + 2, iy], ty, gauss_y[j], corners[side])
        add_picked(corners, radiance[:, iy + j, i:i + w], gauss_x[i], index, leans, rows[4], rows[:3])
    for c in range(3):
        encode(rows[c], rows[4])
        place(rows[c], c, 3, current)
    for side in range(2):
        between(fine[0, BLEND + side, iy], fine[0, BLEND + 2 + side, iy], ty, ONE, corners[side])
    for x in range(index.size):
        at = index[x]
        px, py = np.float32(x) + moved[iy, at, 0] * scale[0], np.float32(y) + moved[iy, at, 1] * scale[1]
        blend = corners[0, at] + (corners[1, at] - corners[0, at]) * leans[x]
        kept = fresh * (ONE - blend) if held(px, py, size[0], size[1]) else ZERO
        trust[3 * x] = trust[3 * x + 1] = trust[3 * x + 2] = kept


@compiled
def upsample_rows(y0, y1, radiance, fine, moved, warped, params, output, history):
    """Output pixels from 3x3 samples by predicted weight and distance, blended with the reprojected history."""
    h, w = moved.shape[:2]
    height, width = output.shape[:2]
    size, scale = (width, height), (np.float32(width / w), np.float32(height / h))
    index, leans = np.empty(width, np.int64), np.empty(width, np.float32)
    gauss_x, gauss_y = np.empty((3, width), np.float32), np.empty(3, np.float32)
    for x in range(width):
        index[x], offset = centre(x, w, width)
        leans[x] = lean(offset)
        for i in range(3):
            gauss_x[i, x] = gauss(i - 1 + params[JITTER_X] - offset)
    double = width == 2 * w
    corners, rows = np.empty((2, w), np.float32), np.empty((5, w if double else width), np.float32)
    current, trust = np.empty(3 * width, np.float32), np.empty(3 * width, np.float32)
    for y in range(y0, y1):
        iy, offset = centre(y, h, height)
        for j in range(3):
            gauss_y[j] = gauss(j - 1 + params[JITTER_Y] - offset)
        if double:
            double_row(y, iy, y % 2, radiance, fine, moved, gauss_x, gauss_y, size, scale, params[FRESH], rows,
                       current, trust)
        else:
            any_row(y, iy, lean(offset), radiance, fine, moved, gauss_x, gauss_y, size, scale, params[FRESH], index,
                    leans, corners, rows, current, trust)
        blend_rows(current, warped[y].reshape(3 * width), trust, ONE / params[EXPOSURE], history[y].reshape(3 * width),
                   output[y].reshape(3 * width))


UPSAMPLE = kernel("upsample", ("radiance", "fine", "moved", "warped", "params"), ("output", "next_history"),
                  upsample_rows, ("output", 0))
