"""Cubic resampling of any plane to another size."""

import math

import numpy as np

from postfx.kernels.kernel import Kernel
from postfx.kernels.numeric import compiled, inline

ZERO, ONE, INFINITE = np.float32(0), np.float32(1), np.float32(np.inf)
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
    return value if abs(value) < INFINITE else ZERO


@compiled
def clean(source, target):
    for i in range(source.size):
        target[i] = known(source[i])


@compiled
def clean_row(source, channels, line):
    """A flat row with its first and last pixel repeated in the margins; what is not finite counts as 0."""
    first, end = MARGIN * channels, MARGIN * channels + source.size
    clean(source, line[first:])
    for beside in range(MARGIN):
        for k in range(channels):
            line[beside * channels + k] = line[first + k]
            line[end + beside * channels + k] = line[end - channels + k]


@compiled
def down_row(a, b, c, d, weights, value):
    """Cubic sum of four rows."""
    u, v, w, z = weights
    for i in range(value.size):
        value[i] = u * a[i] + v * b[i] + w * c[i] + z * d[i]


@compiled
def bounds_row(b, c, channels, low, high, least, most):
    """The least and the largest of two rows, of each pixel and the one after it; `low` and `high` of each alone."""
    for i in range(b.size):
        low[i], high[i] = min(b[i], c[i]), max(b[i], c[i])
    next_low, next_high = low[channels:], high[channels:]
    for i in range(next_low.size):
        least[i], most[i] = min(low[i], next_low[i]), max(high[i], next_high[i])


@compiled
def across_row(value, least, most, index, weights, channels, row):
    """Cubic sums along a row whose taps begin at `index`, held within the four nearest samples."""
    for x in range(index.size):
        u, v, w, z = weights[0, x], weights[1, x], weights[2, x], weights[3, x]
        for i in range(index[x], index[x] + channels):
            a, b, c, d = i, i + channels, i + 2 * channels, i + 3 * channels
            cubic = u * value[a] + v * value[b] + w * value[c] + z * value[d]
            row[channels * x + i - index[x]] = min(max(cubic, least[b]), most[b])


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
def even_row(a, b, c, d, least, most, weights, out):
    """Like `across_row` for every second pixel, whose four taps lie alike."""
    u, v, w, z = weights
    for i in range(out.size):
        out[i] = min(max(u * a[i] + v * b[i] + w * c[i] + z * d[i], least[i]), most[i])


@inline
def put_pixel(source, at, row, target):
    """Three values, and the one after them, which the next pixel is written over: four are one instruction."""
    a, b, c, d = source[at], source[at + 1], source[at + 2], source[at + 3]
    row[target], row[target + 1], row[target + 2], row[target + 3] = a, b, c, d


@compiled
def interleave(even, odd, channels, row):
    """Pixels of two rows in turn."""
    first = 0
    if channels == 1:
        for x in range(even.size):
            row[2 * x], row[2 * x + 1] = even[x], odd[x]
        return
    if channels == 3:
        first = even.size // 3 - 1
        for x in range(first):
            put_pixel(even, 3 * x, row, 6 * x)
            put_pixel(odd, 3 * x, row, 6 * x + 3)
    for x in range(first, even.size // channels):
        for k in range(channels):
            row[2 * channels * x + k] = even[channels * x + k]
            row[channels * (2 * x + 1) + k] = odd[channels * x + k]


@compiled
def double_row(value, least, most, columns, channels, sides, row):
    """A row of twice as many pixels, evenly."""
    for side in range(2):
        at = math.floor(columns[side])
        first = channels * (MARGIN + int(at) - 1)
        second, third, fourth = first + channels, first + 2 * channels, first + 3 * channels
        even_row(value[first:], value[second:], value[third:], value[fourth:], least[second:], most[second:],
                 catmull_rom(columns[side] - np.float32(at)), sides[side])
    interleave(sides[0], sides[1], channels, row)


@compiled
def taps_of(columns, w, channels):
    """Where in a row with margins the four taps of each column begin, and their weights."""
    index, weights = np.empty(columns.size, np.int64), np.empty((4, columns.size), np.float32)
    for x in range(columns.size):
        left = math.floor(columns[x])
        weights[0, x], weights[1, x], weights[2, x], weights[3, x] = catmull_rom(columns[x] - np.float32(left))
        index[x] = channels * (MARGIN - 1 + min(max(int(left), -3), w + 2))
    return index, weights


@compiled
def resample_rows(y0, y1, image, rows, columns, output):
    """Cubic interpolation at `rows` (height,) and `columns` (width,), positions in the image, pixel centres whole.

    Values stay within those of the four nearest samples, so that edges do not ring and nothing turns negative; of a
    position on a row or column of the image, the next one after it counts as near. What is not finite counts as 0.
    """
    h, w, channels = image.shape
    flat, width, size = image.reshape(h, w * channels), output.shape[1], (w + 2 * MARGIN) * channels
    doubled = is_doubled(columns, w)
    index, weights = taps_of(columns[:0] if doubled else columns, w, channels)
    lines, numbers, slots = np.empty((4, size), np.float32), np.full(4, -1), np.empty(4, np.int64)
    value, low, high = np.empty(size, np.float32), np.empty(size, np.float32), np.empty(size, np.float32)
    least, most = np.empty(size, np.float32), np.empty(size, np.float32)
    sides, bounded = np.empty((2, w * channels), np.float32), np.full(2, -1)
    for y in range(y0, y1):
        top = math.floor(rows[y])
        for j in range(4):  # rows near each other have places of their own
            near = min(max(int(top) - 1 + j, 0), h - 1)
            slots[j] = near % 4
            if numbers[slots[j]] != near:
                numbers[slots[j]] = near
                clean_row(flat[near], channels, lines[slots[j]])
        down_row(lines[slots[0]], lines[slots[1]], lines[slots[2]], lines[slots[3]],
                 catmull_rom(rows[y] - np.float32(top)), value)
        if bounded[0] != numbers[slots[1]] or bounded[1] != numbers[slots[2]]:
            bounded[0], bounded[1] = numbers[slots[1]], numbers[slots[2]]
            bounds_row(lines[slots[1]], lines[slots[2]], channels, low, high, least, most)
        row = output[y].reshape(width * channels)
        if doubled:
            double_row(value, least, most, columns, channels, sides, row)
        else:
            across_row(value, least, most, index, weights, channels, row)


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
