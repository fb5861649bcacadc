"""Cubic resampling of any plane to another size."""

import math

import numpy as np

from postfx.kernels.kernel import Kernel
from postfx.kernels.numeric import compiled, inline

ZERO, ONE = np.float32(0), np.float32(1)
MARGIN = 5  # pixels beside a row, so that no tap lies outside
EVEN = np.float32(1e-3)


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
def is_doubled(columns, w):
    """Whether the result has twice the columns, evenly, so that all even ones lie alike, and all odd ones."""
    if columns.size != 2 * w or abs(columns[0]) > MARGIN - 3 or abs(columns[1]) > MARGIN - 3:
        return False
    for x in range(w):
        if abs(columns[2 * x] - x - columns[0]) > EVEN or abs(columns[2 * x + 1] - x - columns[1]) > EVEN:
            return False
    return True


@compiled
def repeat_edges(line, channels):
    """Fill the margins of a row with its first and last pixel."""
    first, end = MARGIN * channels, line.size - MARGIN * channels
    for i in range(first):
        line[i] = line[first + i % channels]
        line[end + i] = line[end - channels + i % channels]


@compiled
def even_row(a, b, c, d, low, low_after, high, high_after, weights, out):
    """Like `across_row` for every second pixel, whose four taps lie alike."""
    u, v, w, z = weights
    for i in range(out.size):
        least, most = min(low[i], low_after[i]), max(high[i], high_after[i])
        out[i] = min(max(u * a[i] + v * b[i] + w * c[i] + z * d[i], least), most)


@compiled
def interleave(even, odd, channels, row):
    """Pixels of two rows in turn."""
    for x in range(even.size // channels):
        for k in range(channels):
            row[2 * channels * x + k] = even[channels * x + k]
            row[channels * (2 * x + 1) + k] = odd[channels * x + k]


@compiled
def double_row(value, low, high, columns, channels, sides, row):
    """A row of twice as many pixels, evenly; the input's rows have margins."""
    for side in range(2):
        at = math.floor(columns[side])
        first = channels * (MARGIN + int(at) - 1)
        second, third, fourth = first + channels, first + 2 * channels, first + 3 * channels
        even_row(value[first:], value[second:], value[third:], value[fourth:], low[second:], low[third:], high[second:],
                 high[third:], catmull_rom(columns[side] - np.float32(at)), sides[side])
    interleave(sides[0], sides[1], channels, row)


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
    doubled, margin = is_doubled(columns, w), MARGIN * channels
    lines, sides = np.empty((3, w * channels + 2 * margin), np.float32), np.empty((2, w * channels), np.float32)
    inner = slice(margin, margin + w * channels)
    value, low, high = lines[0][inner], lines[1][inner], lines[2][inner]
    for y in range(y0, y1):
        top = math.floor(rows[y])
        near = [min(max(int(top) - 1 + j, 0), h - 1) for j in range(4)]
        down_rows(flat[near[0]], flat[near[1]], flat[near[2]], flat[near[3]], catmull_rom(rows[y] - np.float32(top)),
                  value, low, high)
        row = output[y].reshape(width * channels)
        if doubled:
            for i in range(3):
                repeat_edges(lines[i], channels)
            double_row(lines[0], lines[1], lines[2], columns, channels, sides, row)
        else:
            across_row(value, low, high, index, weights, channels, row)


def positions(size: int, out_size: int, shift: float = 0.0) -> np.ndarray:
    """Where the output's pixel centres lie in an image whose samples are `shift` pixels off their centres."""
    return ((np.arange(out_size) + 0.5) * (size / out_size) - 0.5 - shift).astype(np.float32)


def resampled(image: np.ndarray, height: int, width: int, jitter: tuple[float, float]) -> np.ndarray:
    """Cubic interpolation of (h, w, C), whose samples are `jitter` (x, y) pixels off their centres, in this thread."""
    output = np.empty((height, width, image.shape[2]), np.float32)
    h, w = image.shape[:2]
    resample_rows(0, height, np.ascontiguousarray(image, np.float32), positions(h, height, jitter[1]),
                  positions(w, width, jitter[0]), output)
    return output


RESAMPLE = Kernel("resample", ("image", "rows", "columns"), ("output",), resample_rows, ("output", 0),
                  {"image": ("h", "w", "channels"), "rows": ("height",), "columns": ("width",),
                   "output": ("height", "width", "channels")})
