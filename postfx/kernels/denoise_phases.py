"""Loops over rows from render size to output size: taps, phases and sharpening of the upscaler's last kernels.

What a row needs is split into many small loops over few arrays, because those become vector code.
"""

import math

import numpy as np

from postfx.kernels.numeric import inline, log_encode, vectorised

SIGMA, WIDE_SIGMA = 0.5, 1.0
ZERO, HALF = np.float32(0), np.float32(0.5)


@inline
def gauss(distance):
    """How much a sample says about an output pixel at a distance in render pixels."""
    return np.float32(math.exp(-(distance * distance) / (2 * SIGMA * SIGMA)))


@inline
def wide_gauss(offset):
    """Normalised weights of the samples at -1, 0 and 1 plus ``offset`` for the softened picture."""
    a = math.exp(-((offset - 1) * (offset - 1)) / (2 * WIDE_SIGMA * WIDE_SIGMA))
    b = math.exp(-(offset * offset) / (2 * WIDE_SIGMA * WIDE_SIGMA))
    c = math.exp(-((offset + 1) * (offset + 1)) / (2 * WIDE_SIGMA * WIDE_SIGMA))
    total = a + b + c
    return np.float32(a / total), np.float32(b / total), np.float32(c / total)


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
def lean_on(corners, index, leans, out):
    """Linear interpolation between the left and right corners of the pixels at ``index``."""
    for x in range(index.size):
        at = index[x]
        out[x] = corners[0, at] + (corners[1, at] - corners[0, at]) * leans[x]


@vectorised
def scaled(row, scale, out):
    for x in range(out.size):
        out[x] = row[x] * scale


@vectorised
def weighted(a, b, c, u, v, w, out):
    """a * u + b * v + c * w, over the length of ``out``."""
    for x in range(out.size):
        out[x] = a[x] * u + b[x] * v + c[x] * w


@vectorised
def weighted_picked(row, weights, index, out):
    """Three neighbours of a row, beginning at ``index``, by weights (3, width)."""
    for x in range(index.size):
        at = index[x]
        out[x] = row[at] * weights[0, x] + row[at + 1] * weights[1, x] + row[at + 2] * weights[2, x]


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
def encode_sharp(row, total, soft, sharpen):
    """Normalise a row by its sum of weights, log-encode it, and sharpen it against a softened one."""
    for x in range(total.size):
        row[x] = log_encode(row[x] / total[x])
    for x in range(total.size):
        row[x] = max(row[x] + sharpen[x] * (row[x] - log_encode(soft[x])), ZERO)


@vectorised
def place(row, first, step, flat):
    """Spread a row over an interleaved one."""
    for x in range(row.size):
        flat[first + step * x] = row[x]
