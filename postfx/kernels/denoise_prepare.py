"""Kernels before the upscaler's network: follow motion, bring history to the current frame, fill the features.

``params`` is float32 (5,): exposure, jitter x, jitter y, fresh (0 drops the history) and the exposure's gain since
the previous frame. ``state`` (h, w, 12) holds accumulated demodulated colour (3), effective
sample count and hidden channels (8), colour already exposed; ``history`` (H, W, 3) is log(1 + exposed output).
"""
import math
from collections.abc import Callable

import numpy as np

from postfx.kernels.kernel import Kernel
from postfx.kernels.numeric import MAX_COLOUR, centre, clamp, compiled, demodulation, expm1, inline, log1p, log_encode

HIDDEN = 8
FEATURES = 27 + HIDDEN
FINE = 68 + HIDDEN
MAX_COUNT = 32.0
EXPOSURE, JITTER_X, JITTER_Y, FRESH, GAIN = range(5)
ZERO, ONE = np.float32(0), np.float32(1)
MAX_DEPTH, MAX_FLOAT = np.float32(1e10), np.float32(3e38)


@compiled
def scale_rows(y0, y1, depth, scale):
    """Harmonic mean depth of what was hit, 1 where nothing was; a single row, so one thread sums in one order."""
    hits, near = 0, 0.0
    for y in range(depth.shape[0]):
        for x in range(depth.shape[1]):
            z = depth[y, x, 0]
            if 0 < z < 1e9:
                hits += 1
                near += 1 / max(z, np.float32(1e-6))
    scale[0] = hits / near if hits else 1.0


@inline
def finite(value):
    """Motion of a pixel; what no picture can have (NaN, infinity) is none."""
    return value if -1e5 < value < 1e5 else ZERO


@compiled
def dilate_rows(y0, y1, motion, depth, moved):
    """Motion of a clearly nearer neighbour in 3x3, else the pixel's own."""
    h, w = depth.shape[:2]
    for y in range(y0, y1):
        for x in range(w):
            near, at_y, at_x = depth[y, x, 0] * np.float32(0.9), y, x
            for j in range(max(0, y - 1), min(h, y + 2)):
                for i in range(max(0, x - 1), min(w, x + 2)):
                    if depth[j, i, 0] < near:
                        near, at_y, at_x = depth[j, i, 0], j, i
            moved[y, x, 0] = finite(motion[at_y, at_x, 0])
            moved[y, x, 1] = finite(motion[at_y, at_x, 1])


@inline
def cubic(t):
    """The four weights of cubic convolution with a = -0.75, the ONNX GridSample and OpenCV default."""
    a = np.float32(-0.75)
    u, v, s = t + ONE, ONE - t, np.float32(2) - t
    return (((a * u - 5 * a) * u + 8 * a) * u - 4 * a, ((a + 2) * t - (a + 3)) * t * t + ONE,
            ((a + 2) * v - (a + 3)) * v * v + ONE, ((a * s - 5 * a) * s + 8 * a) * s - 4 * a)


@compiled
def history_rows(y0, y1, history, moved, params, warped):
    """The last output where its pixels are now, bicubic, edge repeated; rescaled where the exposure changed."""
    height, width = history.shape[:2]
    h, w = moved.shape[:2]
    scale_x, scale_y = np.float32(width / w), np.float32(height / h)
    gain = params[GAIN]
    weight = np.empty(4, np.float32)
    column = np.empty(4, np.int64)
    for y in range(y0, y1):
        iy, _ = centre(y, h, height)
        for x in range(width):
            ix, _ = centre(x, w, width)
            px = np.float32(x) + moved[iy, ix, 0] * scale_x
            py = np.float32(y) + moved[iy, ix, 1] * scale_y
            px = min(max(px, np.float32(-8)), np.float32(width + 8))
            py = min(max(py, np.float32(-8)), np.float32(height + 8))
            left, top = math.floor(px), math.floor(py)
            weight[0], weight[1], weight[2], weight[3] = cubic(px - np.float32(left))
            down = cubic(py - np.float32(top))
            for i in range(4):
                column[i] = min(max(int(left) - 1 + i, 0), width - 1)
            r, g, b = ZERO, ZERO, ZERO
            for j in range(4):
                row = history[min(max(int(top) - 1 + j, 0), height - 1)]
                for i in range(4):
                    k = down[j] * weight[i]
                    r += k * row[column[i], 0]
                    g += k * row[column[i], 1]
                    b += k * row[column[i], 2]
            warped[y, x, 0] = rescale(r, gain)
            warped[y, x, 1] = rescale(g, gain)
            warped[y, x, 2] = rescale(b, gain)


@inline
def rescale(encoded, gain):
    """A log-encoded colour after an exposure change."""
    value = max(encoded, ZERO)
    return value if gain == ONE else log1p(expm1(value) * gain)


@inline
def bilinear(image, py, px, first, count, out):
    """Sample ``count`` channels from ``first`` on at (py, px), edge repeated."""
    h, w = image.shape[:2]
    px = min(max(px, ZERO), np.float32(w - 1))
    py = min(max(py, ZERO), np.float32(h - 1))
    x0, y0 = int(px), int(py)
    x1, y1 = min(x0 + 1, w - 1), min(y0 + 1, h - 1)
    tx, ty = px - np.float32(x0), py - np.float32(y0)
    for c in range(first, first + count):
        top = image[y0, x0, c] + (image[y0, x1, c] - image[y0, x0, c]) * tx
        bottom = image[y1, x0, c] + (image[y1, x1, c] - image[y1, x0, c]) * tx
        out[c] = top + (bottom - top) * ty


@inline
def box_mean(warped, y, x, h, w, out):
    """Mean of the output pixels that a render pixel covers."""
    height, width = warped.shape[:2]
    r, g, b = ZERO, ZERO, ZERO
    top, bottom = y * height // h, -(-(y + 1) * height // h)
    left, right = x * width // w, -(-(x + 1) * width // w)
    for j in range(top, bottom):
        for i in range(left, right):
            r += warped[j, i, 0]
            g += warped[j, i, 1]
            b += warped[j, i, 2]
    share = ONE / np.float32((bottom - top) * (right - left))
    out[0], out[1], out[2] = r * share, g * share, b * share


@compiled
def feature_rows(y0, y1, colour, diffuse_albedo, specular_albedo, normal, roughness, depth, moved, state, last_depth,
                 warped, depth_scale, params, past, features):
    """The network's input, padded to its size by repeating the edge, and the reprojected accumulation."""
    h, w = colour.shape[:2]
    exposure, scale, fresh, gain = params[EXPOSURE], depth_scale[0], params[FRESH], params[GAIN]
    inverse_scale = np.float32(w) / np.float32(warped.shape[1])
    sample = np.empty(4 + HIDDEN, np.float32)
    mean = np.empty(3, np.float32)
    factor = np.empty(3, np.float32)
    for row in range(y0, y1):
        y = min(row, h - 1)
        for x in range(w):
            factor[0], factor[1], factor[2] = demodulation(diffuse_albedo, specular_albedo, y, x)
            px, py = np.float32(x) + moved[y, x, 0], np.float32(y) + moved[y, x, 1]
            held = -0.5 <= px <= w - 0.5 and -0.5 <= py <= h - 0.5
            valid = fresh if held else ZERO
            if valid > 0:
                bilinear(state, py, px, 0, 4 + HIDDEN, sample)
                box_mean(warped, y, x, h, w, mean)
                near_y = min(max(int(np.rint(py)), 0), h - 1)
                near_x = min(max(int(np.rint(px)), 0), w - 1)
                before = clamp(last_depth[near_y, near_x, 0], np.float32(1e-6), MAX_DEPTH)
                change = 4 * math.log(before / clamp(depth[y, x, 0], np.float32(1e-6), MAX_DEPTH))
                features[0, 20, row, x] = min(max(np.float32(change), -ONE), ONE)
            else:
                sample[:], mean[:] = ZERO, ZERO
                features[0, 20, row, x] = ZERO
            for c in range(3):
                kept = sample[c] * gain
                features[0, c, row, x] = log_encode(clamp(colour[y, x, c], ZERO, MAX_FLOAT) * exposure / factor[c])
                features[0, 3 + c, row, x] = log_encode(kept)
                features[0, 6 + c, row, x] = log_encode(expm1(mean[c]) / factor[c])
                features[0, 9 + c, row, x] = clamp(diffuse_albedo[y, x, c], ZERO, np.float32(2))
                features[0, 12 + c, row, x] = clamp(specular_albedo[y, x, c], ZERO, np.float32(2))
                features[0, 15 + c, row, x] = clamp(normal[y, x, c], -ONE, ONE)
                if row < h:
                    past[row, x, c] = kept
            if row < h:
                past[row, x, 3] = sample[3]
            features[0, 18, row, x] = clamp(roughness[y, x, 0], ZERO, ONE)
            features[0, 19, row, x] = scale / (scale + clamp(depth[y, x, 0], ZERO, MAX_DEPTH))
            features[0, 21, row, x] = valid
            features[0, 22, row, x] = sample[3] / np.float32(MAX_COUNT)
            features[0, 23, row, x] = params[JITTER_X]
            features[0, 24, row, x] = params[JITTER_Y]
            length = math.sqrt(moved[y, x, 0] * moved[y, x, 0] + moved[y, x, 1] * moved[y, x, 1])
            features[0, 25, row, x] = log1p(np.float32(length)) / np.float32(4)
            features[0, 26, row, x] = inverse_scale
            for c in range(HIDDEN):
                features[0, 27 + c, row, x] = sample[4 + c]
        for c in range(FEATURES):
            for x in range(w, features.shape[3]):
                features[0, c, row, x] = features[0, c, row, w - 1]


@compiled
def accumulate_rows(y0, y1, colour, diffuse_albedo, specular_albedo, depth, past, fine, params, state, next_depth,
                    level):
    """Running mean of demodulated colour; ``level`` (4, hp, wp) is it with its importance, zero in the padding."""
    h, w = colour.shape[:2]
    for y in range(y0, y1):
        if y >= h:
            level[:, y, :] = ZERO
            continue
        level[:, y, w:] = ZERO
        for x in range(w):
            f0, f1, f2 = demodulation(diffuse_albedo, specular_albedo, y, x)
            share = ONE / (past[y, x, 3] + ONE)
            alpha = share + (ONE - share) * fine[0, 66, y, x]
            for c, f in enumerate((f0, f1, f2)):
                exposed = clamp(colour[y, x, c], ZERO, MAX_FLOAT) * params[EXPOSURE]
                noisy = min(exposed / f, np.float32(MAX_COLOUR))
                mean = past[y, x, c] + (noisy - past[y, x, c]) * alpha
                state[y, x, c] = mean
                level[c, y, x] = mean
            level[3, y, x] = fine[0, 67, y, x]
            next_depth[y, x, 0] = depth[y, x, 0]
            state[y, x, 3] = min(ONE / alpha, np.float32(MAX_COUNT))
            for c in range(HIDDEN):
                state[y, x, 4 + c] = fine[0, 68 + c, y, x]


PLANES = {
    "colour": ("h", "w", 3), "diffuse_albedo": ("h", "w", 3), "specular_albedo": ("h", "w", 3), "normal": ("h", "w", 3),
    "roughness": ("h", "w", 1), "depth": ("h", "w", 1), "motion": ("h", "w", 2),
}
SHAPES = PLANES | {
    "depth_scale": (1,), "moved": ("h", "w", 2), "history": ("height", "width", 3), "warped": ("height", "width", 3),
    "params": (5,), "state": ("h", "w", 4 + HIDDEN), "last_depth": ("h", "w", 1), "past": ("h", "w", 4),
    "features": (1, FEATURES, "hp", "wp"), "fine": (1, FINE, "hp", "wp"), "next_state": ("h", "w", 4 + HIDDEN),
    "next_depth": ("h", "w", 1), "level": (4, "hp", "wp"),
}


def _kernel(name: str, reads: tuple[str, ...], writes: tuple[str, ...], rows: Callable, axis: int) -> Kernel:
    shapes = {binding: SHAPES[binding] for binding in reads + writes}
    return Kernel(f"denoise_{name}", reads, writes, rows, (writes[-1], axis), shapes)


REFLECTANCE = ("diffuse_albedo", "specular_albedo")
SCALE = _kernel("scale", ("depth",), ("depth_scale",), scale_rows, 0)
DILATE = _kernel("dilate", ("motion", "depth"), ("moved",), dilate_rows, 0)
HISTORY = _kernel("history", ("history", "moved", "params"), ("warped",), history_rows, 0)
FEATURE = _kernel("features", ("colour", *REFLECTANCE, "normal", "roughness", "depth", "moved", "state", "last_depth",
                               "warped", "depth_scale", "params"), ("past", "features"), feature_rows, 2)
ACCUMULATE = _kernel("accumulate", ("colour", *REFLECTANCE, "depth", "past", "fine", "params"),
                     ("next_state", "next_depth", "level"), accumulate_rows, 1)
