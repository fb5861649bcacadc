"""Kernels of whole pictures: resampling, transparency overlays, a checkerboard, and comparing places.

- Cubic resampling of any plane to another size.
- Overlays of premultiplied RGBA: cubic enlarging without halos, and compositing.
- A checkerboard of two greys (float32): rows (height,) and columns (width,) alternate between 0 and 1 from cell to
  cell; greys (2,) are of cells where both are equal and of the others; output (height, width, 3). The torch definition
  is `training.kernels.tonemap.Checkerboard`.
- On the host: how far points of a picture are from another one at many places, by which the doctor tries motion.
"""

from __future__ import annotations

import math
from typing import TypeAlias

import numpy as np

from postfx.kernels import Kernel
from postfx.kernels.numeric import Real, clamp, compiled, inline

ZERO, ONE, INFINITE = np.float32(0), np.float32(1), np.float32(np.inf)
MARGIN = 5  # pixels beside a row, so that no tap lies outside
EVEN = np.float32(1e-3)
Taps: TypeAlias = tuple[Real, Real, Real, Real]


@inline
def catmull_rom(t: Real) -> Taps:
    """Weights of the four taps around a position ``t`` in [0, 1) after the second one (Keys 1981, a = -0.5)."""
    half = np.float32(0.5)
    return (((-half * t + ONE) * t - half) * t, (np.float32(1.5) * t - np.float32(2.5)) * t * t + ONE,
            ((np.float32(-1.5) * t + np.float32(2)) * t + half) * t, (half * t - half) * t * t)


@inline
def make_finite(value: Real) -> Real:
    return value if abs(value) < INFINITE else ZERO


@compiled
def clean(source: np.ndarray, target: np.ndarray) -> None:
    for i in range(source.size):
        target[i] = make_finite(source[i])


@compiled
def clean_row(source: np.ndarray, channels: int, line: np.ndarray) -> None:
    """A flat row with its first and last pixel repeated in the margins; non-finite values count as 0."""
    first, end = MARGIN * channels, MARGIN * channels + source.size
    clean(source, line[first:])
    for beside in range(MARGIN):
        for k in range(channels):
            line[beside * channels + k] = line[first + k]
            line[end + beside * channels + k] = line[end - channels + k]


@compiled
def down_row(a: np.ndarray, b: np.ndarray, c: np.ndarray, d: np.ndarray, weights: Taps, value: np.ndarray) -> None:
    """Cubic sum of four rows."""
    u, v, w, z = weights
    for i in range(value.size):
        value[i] = u * a[i] + v * b[i] + w * c[i] + z * d[i]


@compiled
def bounds_row(b: np.ndarray, c: np.ndarray, channels: int, low: np.ndarray, high: np.ndarray, least: np.ndarray,
               most: np.ndarray) -> None:
    """The least and the largest of two rows, of each pixel and the one after it; `low` and `high` of each alone."""
    for i in range(b.size):
        low[i], high[i] = min(b[i], c[i]), max(b[i], c[i])
    next_low, next_high = low[channels:], high[channels:]
    for i in range(next_low.size):
        least[i], most[i] = min(low[i], next_low[i]), max(high[i], next_high[i])


@compiled
def across_row(value: np.ndarray, least: np.ndarray, most: np.ndarray, index: np.ndarray, weights: np.ndarray,
               channels: int, row: np.ndarray) -> None:
    """Cubic sums along a row whose taps begin at `index`, held within the four nearest samples."""
    for x in range(index.size):
        u, v, w, z = weights[0, x], weights[1, x], weights[2, x], weights[3, x]
        for i in range(index[x], index[x] + channels):
            a, b, c, d = i, i + channels, i + 2 * channels, i + 3 * channels
            cubic = u * value[a] + v * value[b] + w * value[c] + z * value[d]
            row[channels * x + i - index[x]] = min(max(cubic, least[b]), most[b])


@compiled
def is_doubled(columns: np.ndarray, w: int) -> bool:
    """Whether the result has twice the columns, evenly, so that all even ones lie alike, and all odd ones."""
    if columns.size != 2 * w or abs(columns[0]) > MARGIN - 3 or abs(columns[1]) > MARGIN - 3:
        return False
    for x in range(w):
        if abs(columns[2 * x] - x - columns[0]) > EVEN or abs(columns[2 * x + 1] - x - columns[1]) > EVEN:
            return False
    return True


@compiled
def even_row(a: np.ndarray, b: np.ndarray, c: np.ndarray, d: np.ndarray, least: np.ndarray, most: np.ndarray,
             weights: Taps, out: np.ndarray) -> None:
    """Like `across_row` for every second pixel, whose four taps lie alike."""
    u, v, w, z = weights
    for i in range(out.size):
        out[i] = min(max(u * a[i] + v * b[i] + w * c[i] + z * d[i], least[i]), most[i])


@inline
def put_pixel(source: np.ndarray, at: int, row: np.ndarray, target: int) -> None:
    """Three values, and the one after them, which the next pixel is written over: four are one instruction."""
    a, b, c, d = source[at], source[at + 1], source[at + 2], source[at + 3]
    row[target], row[target + 1], row[target + 2], row[target + 3] = a, b, c, d


@compiled
def interleave(even: np.ndarray, odd: np.ndarray, channels: int, row: np.ndarray) -> None:
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
def double_row(value: np.ndarray, least: np.ndarray, most: np.ndarray, columns: np.ndarray, channels: int,
               sides: np.ndarray, row: np.ndarray) -> None:
    """A row of twice as many pixels, evenly."""
    for side in range(2):
        at = math.floor(columns[side])
        first = channels * (MARGIN + int(at) - 1)
        second, third, fourth = first + channels, first + 2 * channels, first + 3 * channels
        even_row(value[first:], value[second:], value[third:], value[fourth:], least[second:], most[second:],
                 catmull_rom(columns[side] - np.float32(at)), sides[side])
    interleave(sides[0], sides[1], channels, row)


@compiled
def taps_of(columns: np.ndarray, w: int, channels: int) -> tuple[np.ndarray, np.ndarray]:
    """Where in a row with margins the four taps of each column begin, and their weights."""
    index, weights = np.empty(columns.size, np.int64), np.empty((4, columns.size), np.float32)
    for x in range(columns.size):
        left = math.floor(columns[x])
        weights[0, x], weights[1, x], weights[2, x], weights[3, x] = catmull_rom(columns[x] - np.float32(left))
        index[x] = channels * (MARGIN - 1 + min(max(int(left), -3), w + 2))
    return index, weights


@compiled
def resample_rows(y0: int, y1: int, image: np.ndarray, rows: np.ndarray, columns: np.ndarray,
                  output: np.ndarray) -> None:
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


def resample(image: np.ndarray, height: int, width: int, jitter: tuple[float, float]) -> np.ndarray:
    """Cubic interpolation of (h, w, C), whose samples are `jitter` (x, y) pixels off their centres, in this thread."""
    output = np.empty((height, width, image.shape[2]), np.float32)
    h, w = image.shape[:2]
    resample_rows(0, height, np.ascontiguousarray(image, np.float32), positions(h, height, jitter[1]),
                  positions(w, width, jitter[0]), output)
    return output


RESAMPLE = Kernel("resample", ("image", "rows", "columns"), ("output",), resample_rows, ("output", 0),
                  {"image": ("h", "w", "channels"), "rows": ("height",), "columns": ("width",),
                   "output": ("height", "width", "channels")}, pixels=(2, 2))




@inline
def straight(light: Real, alpha: Real, empty: Real) -> Real:
    """Colour of what covers a pixel: light over alpha; infinite where light comes from what covers nothing, `empty`
    where there is nothing at all."""
    light, alpha = make_finite(light), make_finite(alpha)
    if alpha > ZERO:
        return light / alpha
    return empty if light == ZERO else INFINITE if light > ZERO else -INFINITE


@compiled
def straight_row(upper: np.ndarray, lower: np.ndarray, least: np.ndarray, most: np.ndarray) -> None:
    """Least and largest straight colour (w, 3) of two rows (w, 4), pixel by pixel."""
    for x in range(least.shape[0]):
        above, below = upper[x, 3], lower[x, 3]
        for c in range(3):
            first, second = upper[x, c], lower[x, c]
            least[x, c] = min(straight(first, above, INFINITE), straight(second, below, INFINITE))
            most[x, c] = max(straight(first, above, -INFINITE), straight(second, below, -INFINITE))


@compiled
def hold_row(least: np.ndarray, most: np.ndarray, near: np.ndarray, row: np.ndarray) -> None:
    """Alpha within [0, 1], and colours within the nearest unpremultiplied colours times that alpha."""
    for x in range(row.shape[0]):
        left, right = near[0, x], near[1, x]
        alpha = clamp(row[x, 3], ZERO, ONE)
        row[x, 3] = alpha
        for c in range(3):
            low, high = min(least[left, c], least[right, c]), max(most[left, c], most[right, c])
            held = min(row[x, c], high * alpha) if abs(high) < INFINITE else row[x, c]
            row[x, c] = max(held, low * alpha) if abs(low) < INFINITE else held


@inline
def nearest(position: Real, size: int) -> tuple[int, int]:
    """The two samples around a position."""
    first = int(math.floor(position))
    return min(max(first, 0), size - 1), min(max(first + 1, 0), size - 1)


@compiled
def enlarge_rows(y0: int, y1: int, image: np.ndarray, rows: np.ndarray, columns: np.ndarray,
                 output: np.ndarray) -> None:
    """Cubic like `resample_rows`, and colours are no brighter and no darker than the nearest four pixels' own colours
    at the coverage that comes out: so edges have no halo, whatever they are composited over."""
    resample_rows(y0, y1, image, rows, columns, output)
    h, w = image.shape[:2]
    near = np.empty((2, columns.size), np.int64)
    for x in range(columns.size):
        near[0, x], near[1, x] = nearest(columns[x], w)
    least, most = np.empty((w, 3), np.float32), np.empty((w, 3), np.float32)
    held = -1, -1
    for y in range(y0, y1):
        lines = nearest(rows[y], h)
        if lines != held:
            straight_row(image[lines[0]], image[lines[1]], least, most)
        held = lines
        hold_row(least, most, near, output[y])


@inline
def over(front: Real, alpha: Real, behind: Real) -> Real:
    """Porter and Duff 1984, premultiplied."""
    return make_finite(front) + (ONE - clamp(alpha, ZERO, ONE)) * make_finite(behind)


@compiled
def over_rows(y0: int, y1: int, overlay: np.ndarray, colour: np.ndarray, output: np.ndarray) -> None:
    for y in range(y0, y1):
        for x in range(output.shape[1]):
            for c in range(3):
                output[y, x, c] = over(overlay[y, x, c], overlay[y, x, 3], colour[y, x, c])


@compiled
def over_alpha_rows(y0: int, y1: int, overlay: np.ndarray, alpha: np.ndarray, output: np.ndarray) -> None:
    for y in range(y0, y1):
        for x in range(output.shape[1]):
            covered = clamp(overlay[y, x, 3], ZERO, ONE)
            output[y, x, 0] = over(covered, covered, alpha[y, x, 0])


RGBA, COLOUR, ALPHA = (("height", "width", channels) for channels in (4, 3, 1))
ENLARGE = Kernel("overlay_enlarge", ("image", "rows", "columns"), ("output",), enlarge_rows, ("output", 0),
                 {"image": ("h", "w", 4), "rows": ("height",), "columns": ("width",), "output": RGBA})
OVER = Kernel("overlay_over", ("overlay", "colour"), ("output",), over_rows, ("output", 0),
              {"overlay": RGBA, "colour": COLOUR, "output": COLOUR})
OVER_ALPHA = Kernel("overlay_over_alpha", ("overlay", "alpha"), ("output",), over_alpha_rows, ("output", 0),
                    {"overlay": RGBA, "alpha": ALPHA, "output": ALPHA})


@compiled
def rows(y0: int, y1: int, rows: np.ndarray, columns: np.ndarray, greys: np.ndarray, output: np.ndarray) -> None:
    """Output rows y0..y1-1."""
    for y in range(y0, y1):
        for x in range(columns.size):
            grey = greys[0] if rows[y] == columns[x] else greys[1]
            for c in range(3):
                output[y, x, c] = grey


def turns(size: int, side: float) -> np.ndarray:
    """0 or 1 of each of `size` pixels in a row, changing every `side` pixels; float32 (size,)."""
    return ((np.arange(size) + 0.5) // side % 2).astype(np.float32)


CHECKERBOARD = Kernel(
    name="checkerboard",
    reads=("rows", "columns", "greys"),
    writes=("output",),
    rows=rows,
    row_axis=("output", 0),
    shapes={"rows": ("height",), "columns": ("width",), "greys": (2,), "output": ("height", "width", 3)},
)


@compiled
def compare_places(before: np.ndarray, now: np.ndarray, x: np.ndarray, y: np.ndarray, apart: np.ndarray,
                   inside: np.ndarray) -> None:
    """Largest difference of a channel between points now (points, channels) and a picture before (h, w, channels),
    mixed of four pixels at places x and y (count, points), which are brought to its edge; and whether they lie in it.
    """
    height, width, channels = before.shape
    last_x, last_y = np.float32(width - 1), np.float32(height - 1)
    for i in range(x.shape[0]):
        for p in range(x.shape[1]):
            at_x, at_y = x[i, p], y[i, p]
            inside[i, p] = at_x >= ZERO and at_x <= last_x and at_y >= ZERO and at_y <= last_y
            at_x = min(at_x, last_x) if at_x > ZERO else ZERO
            at_y = min(at_y, last_y) if at_y > ZERO else ZERO
            left, top = min(int(at_x), max(width - 2, 0)), min(int(at_y), max(height - 2, 0))
            right, bottom = min(left + 1, width - 1), min(top + 1, height - 1)
            u, v = at_x - np.float32(left), at_y - np.float32(top)
            largest = ZERO
            for k in range(channels):
                upper = before[top, left, k] * (ONE - u) + before[top, right, k] * u
                lower = before[bottom, left, k] * (ONE - u) + before[bottom, right, k] * u
                largest = max(largest, abs(upper * (ONE - v) + lower * v - now[p, k]))
            apart[i, p] = largest
