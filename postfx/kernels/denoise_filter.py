"""Kernels after the upscaler's network: filter the pyramid from coarse to fine, upsample, blend with the history.

Pyramid levels are planar (channels, h, w) so that the inner loops run along rows with vector instructions.
"""
import math

import numpy as np

from postfx.kernels.denoise_prepare import EXPOSURE, FINE, FRESH, JITTER_X, JITTER_Y, REFLECTANCE
from postfx.kernels.kernel import Kernel
from postfx.kernels.numeric import centre, compiled, demodulation, expm1, inline, log_encode, vectorised

KERNEL, PHASES, MIX = 25, 25, 65
BLEND = 61
SIGMA = 0.5
ZERO, ONE, TINY = np.float32(0), np.float32(1), np.float32(1e-8)


@vectorised
def pool_rows(y0, y1, finer, level):
    """Importance-weighted mean over 2x2 pixels; the last channel is the mean importance."""
    w = level.shape[2]
    quarter = np.float32(0.25)
    for y in range(y0, y1):
        for x in range(w):
            a, b = finer[3, 2 * y, 2 * x], finer[3, 2 * y, 2 * x + 1]
            c, d = finer[3, 2 * y + 1, 2 * x], finer[3, 2 * y + 1, 2 * x + 1]
            total = quarter * (a + b + c + d)
            share = quarter / (total + TINY)
            for k in range(3):
                level[k, y, x] = share * (a * finer[k, 2 * y, 2 * x] + b * finer[k, 2 * y, 2 * x + 1]
                                          + c * finer[k, 2 * y + 1, 2 * x] + d * finer[k, 2 * y + 1, 2 * x + 1])
            level[3, y, x] = total


@vectorised
def mix_rows(y0, y1, coarse, level, heads, mixed):
    """The coarser result where the network trusts it more than the level's own colour."""
    at = MIX if heads.shape[1] > KERNEL + 1 else KERNEL
    for y in range(y0, y1):
        for k in range(3):
            for x in range(level.shape[2]):
                below = coarse[k, y // 2, x // 2]
                mixed[k, y, x] = below + (level[k, y, x] - below) * heads[0, at, y, x]


@vectorised
def filter_rows(y0, y1, mixed, heads, area, filtered):
    """A normalised 5x5 kernel of its own for every pixel; taps beyond the picture's ``area`` do not count."""
    h, w = int(area[0]), int(area[1])
    total = np.empty(w, np.float32)
    for y in range(y0, y1):
        filtered[:3, y, :] = ZERO
        if y >= h:
            continue
        total[:] = TINY
        for j in range(max(0, 2 - y), min(5, h + 2 - y)):
            for i in range(5):
                weight = heads[0, 5 * j + i, y]
                left, right = max(0, 2 - i), min(w, w + 2 - i)
                source = mixed[:, y + j - 2]
                for x in range(left, right):
                    k = weight[x]
                    total[x] += k
                    filtered[0, y, x] += k * source[0, x + i - 2]
                    filtered[1, y, x] += k * source[1, x + i - 2]
                    filtered[2, y, x] += k * source[2, x + i - 2]
        for k in range(3):
            for x in range(w):
                filtered[k, y, x] /= total[x]


@compiled
def remodulate_rows(y0, y1, filtered, diffuse_albedo, specular_albedo, radiance):
    """Filtered colour times reflectance: (3, h + 2, w + 2) exposed linear, a border of repeated pixels around it."""
    h, w = diffuse_albedo.shape[:2]
    for row in range(y0, y1):
        y = min(max(row - 1, 0), h - 1)
        for x in range(w):
            r, g, b = demodulation(diffuse_albedo, specular_albedo, y, x)
            radiance[0, row, x + 1] = filtered[0, y, x] * r
            radiance[1, row, x + 1] = filtered[1, y, x] * g
            radiance[2, row, x + 1] = filtered[2, y, x] * b
        for c in range(3):
            radiance[c, row, 0] = radiance[c, row, 1]
            radiance[c, row, w + 1] = radiance[c, row, w]


@inline
def gauss(distance):
    return np.float32(math.exp(-(distance * distance) / (2 * SIGMA * SIGMA)))


@inline
def lean(offset):
    """Share of the right or lower of the two quarter-pixel corners at an offset."""
    return np.float32(min(max(2 * offset + 0.5, 0.0), 1.0))


@vectorised
def corner_weights(fine, y, tap, share, gauss_y, weights):
    """A tap's weights (2, w) along a row, at the left and right corners, linear between upper and lower ones."""
    for side in range(2):
        upper, lower = fine[0, PHASES + 4 * tap + side, y], fine[0, PHASES + 4 * tap + 2 + side, y]
        for x in range(weights.shape[1]):
            weights[side, x] = (upper[x] + (lower[x] - upper[x]) * share) * gauss_y


@vectorised
def add_tap_double(weights, source, left_gauss, right_gauss, total, row):
    """Add a tap to a row at scale 2, where output pixels lie at the corners; ``source`` (3, w) is the tap's pixels."""
    for x in range(weights.shape[1]):
        left, right = weights[0, x] * left_gauss, weights[1, x] * right_gauss
        total[2 * x] += left
        total[2 * x + 1] += right
        for c in range(3):
            row[c, 2 * x] += left * source[c, x]
            row[c, 2 * x + 1] += right * source[c, x]


@compiled
def add_tap(weights, source, gauss_x, index, leans, total, row):
    """Add a tap to a row at any scale; ``index`` and ``leans`` say which pixel and how far right in it."""
    for x in range(index.size):
        at = index[x]
        k = (weights[0, at] + (weights[1, at] - weights[0, at]) * leans[x]) * gauss_x[x]
        total[x] += k
        for c in range(3):
            row[c, x] += k * source[c, at]


@compiled
def trust_row(y, iy, ty, index, leans, fine, moved, params, height, trust):
    """How much of the reprojected history each pixel of a row keeps; none where it lay beyond the border."""
    h, w = moved.shape[:2]
    width = index.size
    scale_x, scale_y = np.float32(width / w), np.float32(height / h)
    for x in range(width):
        at, tx = index[x], leans[x]
        px, py = np.float32(x) + moved[iy, at, 0] * scale_x, np.float32(y) + moved[iy, at, 1] * scale_y
        if -0.5 <= px <= width - 0.5 and -0.5 <= py <= height - 0.5:
            upper = fine[0, BLEND, iy, at] * (ONE - tx) + fine[0, BLEND + 1, iy, at] * tx
            lower = fine[0, BLEND + 2, iy, at] * (ONE - tx) + fine[0, BLEND + 3, iy, at] * tx
            trust[x] = params[FRESH] * (ONE - upper + (upper - lower) * ty)
        else:
            trust[x] = ZERO


@vectorised
def blend_row(row, total, trust, warped, darken, output, history):
    """Normalise, encode, blend with the reprojected history and decode a row."""
    for x in range(total.size):
        scale = ONE / total[x]
        for c in range(3):
            current = log_encode(row[c, x] * scale)
            mixed = current + (warped[x, c] - current) * trust[x]
            history[x, c] = mixed
            output[x, c] = expm1(mixed) * darken


@compiled
def upsample_rows(y0, y1, radiance, fine, moved, warped, params, output, history):
    """Output pixels from 3x3 samples by predicted weight and distance, blended with the reprojected history."""
    h, w = moved.shape[:2]
    height, width = output.shape[:2]
    double = width == 2 * w
    index, leans = np.empty(width, np.int64), np.empty(width, np.float32)
    gauss_x = np.empty((3, width), np.float32)
    for x in range(width):
        index[x], offset = centre(x, w, width)
        leans[x] = lean(offset)
        for i in range(3):
            gauss_x[i, x] = gauss(i - 1 + params[JITTER_X] - offset)
    weights, row = np.empty((2, w), np.float32), np.empty((3, width), np.float32)
    total, trust = np.empty(width, np.float32), np.empty(width, np.float32)
    for y in range(y0, y1):
        iy, offset = centre(y, h, height)
        ty = lean(offset)
        total[:], row[:] = TINY, ZERO
        for tap in range(9):
            j, i = tap // 3, tap % 3
            corner_weights(fine, iy, tap, ty, gauss(j - 1 + params[JITTER_Y] - offset), weights)
            source = radiance[:, iy + j, i:i + w]
            if double:
                add_tap_double(weights, source, gauss_x[i, 0], gauss_x[i, 1], total, row)
            else:
                add_tap(weights, source, gauss_x[i], index, leans, total, row)
        trust_row(y, iy, ty, index, leans, fine, moved, params, height, trust)
        blend_row(row, total, trust, warped[y], ONE / params[EXPOSURE], output[y], history[y])


LEVEL, PLANAR = (4, "hp", "wp"), (3, "hp", "wp")
HEADS = (1, "heads", "hp", "wp")
POOL = Kernel("denoise_pool", ("finer",), ("level",), pool_rows, ("level", 1),
              {"finer": (4, "2*hp", "2*wp"), "level": LEVEL})
MIX_LEVELS = Kernel("denoise_mix", ("coarse", "level", "heads"), ("mixed",), mix_rows, ("mixed", 1),
                    {"coarse": (3, "half_hp", "half_wp"), "level": LEVEL, "heads": HEADS, "mixed": PLANAR})
FILTER = Kernel("denoise_filter", ("mixed", "heads", "area"), ("filtered",), filter_rows, ("filtered", 1),
                {"mixed": ("channels", "hp", "wp"), "heads": HEADS, "area": (2,), "filtered": PLANAR})
REMODULATE = Kernel("denoise_remodulate", ("filtered", *REFLECTANCE), ("radiance",), remodulate_rows, ("radiance", 1),
                    {"filtered": PLANAR, "diffuse_albedo": ("h", "w", 3), "specular_albedo": ("h", "w", 3),
                     "radiance": (3, "padded_h", "padded_w")})
UPSAMPLE = Kernel("denoise_upsample", ("radiance", "fine", "moved", "warped", "params"), ("output", "next_history"),
                  upsample_rows, ("output", 0),
                  {"radiance": (3, "padded_h", "padded_w"), "fine": (1, FINE, "hp", "wp"), "moved": ("h", "w", 2),
                   "warped": ("height", "width", 3), "params": (5,), "output": ("height", "width", 3),
                   "next_history": ("height", "width", 3)})
