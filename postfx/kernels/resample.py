"""Cubic resampling of any plane to another size."""

import math

import numpy as np

from postfx.kernels.kernel import Kernel
from postfx.kernels.numeric import compiled, inline

ZERO, ONE = np.float32(0), np.float32(1)


@inline
def catmull_rom(t):
    """Weights of the four taps around a position ``t`` in [0, 1) after the second one (Keys 1981, a = -0.5)."""
    half = np.float32(0.5)
    return (((-half * t + ONE) * t - half) * t, (np.float32(1.5) * t - np.float32(2.5)) * t * t + ONE,
            ((np.float32(-1.5) * t + np.float32(2)) * t + half) * t, (half * t - half) * t * t)


@inline
def known(value):
    return value if abs(value) < np.inf else ZERO


@compiled
def down_rows(a, b, c, d, weights, value, low, high):
    """Cubic sum of four flat rows, and the least and the largest of the two in the middle."""
    u, v, w, z = weights
    for i in range(value.size):
        before, left, right, after = known(a[i]), known(b[i]), known(c[i]), known(d[i])
        value[i] = u * before + v * left + w * right + z * after
        low[i], high[i] = min(left, right), max(left, right)


@compiled
def across_row(value, low, high, index, weights, channels, row):
    """The same along a row, held within the four nearest samples."""
    for x in range(index.shape[1]):
        u, v, w, z = weights[0, x], weights[1, x], weights[2, x], weights[3, x]
        a, b, c, d = index[0, x], index[1, x], index[2, x], index[3, x]
        for k in range(channels):
            least, most = min(low[b + k], low[c + k]), max(high[b + k], high[c + k])
            cubic = u * value[a + k] + v * value[b + k] + w * value[c + k] + z * value[d + k]
            row[channels * x + k] = min(max(cubic, least), most)


@compiled
def resample_rows(y0, y1, image, rows, columns, output):
    """Cubic interpolation at `rows` (height,) and `columns` (width,), positions in the image, pixel centres whole.

    Values stay within those of the four nearest samples, so that edges do not ring and nothing turns negative. What is
    not finite counts as 0.
    """
    h, w, channels = image.shape
    width = output.shape[1]
    flat = image.reshape(h, w * channels)
    index, weights = np.empty((4, width), np.int64), np.empty((4, width), np.float32)
    for x in range(width):
        left = math.floor(columns[x])
        weights[0, x], weights[1, x], weights[2, x], weights[3, x] = catmull_rom(columns[x] - np.float32(left))
        for i in range(4):
            index[i, x] = channels * min(max(int(left) - 1 + i, 0), w - 1)
    value, low = np.empty(w * channels, np.float32), np.empty(w * channels, np.float32)
    high = np.empty(w * channels, np.float32)
    for y in range(y0, y1):
        top = math.floor(rows[y])
        near = [min(max(int(top) - 1 + j, 0), h - 1) for j in range(4)]
        down_rows(flat[near[0]], flat[near[1]], flat[near[2]], flat[near[3]], catmull_rom(rows[y] - np.float32(top)),
                  value, low, high)
        across_row(value, low, high, index, weights, channels, output[y].reshape(width * channels))


def positions(size: int, out_size: int, shift: float = 0.0) -> np.ndarray:
    """Where the output's pixel centres lie in an image whose samples are `shift` pixels off their centres."""
    return ((np.arange(out_size) + 0.5) * (size / out_size) - 0.5 - shift).astype(np.float32)


RESAMPLE = Kernel("resample", ("image", "rows", "columns"), ("output",), resample_rows, ("output", 0),
                  {"image": ("h", "w", "channels"), "rows": ("height",), "columns": ("width",),
                   "output": ("height", "width", "channels")})
