"""Kernels of transparency overlays, premultiplied RGBA: cubic enlarging without halos, and compositing."""

import math

import numpy as np

from postfx.kernels.kernel import Kernel
from postfx.kernels.numeric import clamp, compiled, inline
from postfx.kernels.resample import known, resample_rows

ZERO, ONE, INFINITE = np.float32(0), np.float32(1), np.float32(np.inf)


@inline
def straight(light, alpha, empty):
    """Colour of what covers a pixel: light over alpha; infinite where light comes from what covers nothing, `empty`
    where there is nothing at all."""
    light, alpha = known(light), known(alpha)
    if alpha > ZERO:
        return light / alpha
    return empty if light == ZERO else INFINITE if light > ZERO else -INFINITE


@compiled
def straight_row(upper, lower, least, most):
    """Least and largest straight colour (w, 3) of two rows (w, 4), pixel by pixel."""
    for x in range(least.shape[0]):
        above, below = upper[x, 3], lower[x, 3]
        for c in range(3):
            first, second = upper[x, c], lower[x, c]
            least[x, c] = min(straight(first, above, INFINITE), straight(second, below, INFINITE))
            most[x, c] = max(straight(first, above, -INFINITE), straight(second, below, -INFINITE))


@compiled
def hold_row(least, most, near, row):
    """Alpha within [0, 1], and colours within what the nearest straight colours make of that alpha."""
    for x in range(row.shape[0]):
        left, right = near[0, x], near[1, x]
        alpha = clamp(row[x, 3], ZERO, ONE)
        row[x, 3] = alpha
        for c in range(3):
            low, high = min(least[left, c], least[right, c]), max(most[left, c], most[right, c])
            held = min(row[x, c], high * alpha) if abs(high) < INFINITE else row[x, c]
            row[x, c] = max(held, low * alpha) if abs(low) < INFINITE else held


@inline
def nearest(position, size):
    """The two samples around a position."""
    first = int(math.floor(position))
    return min(max(first, 0), size - 1), min(max(first + 1, 0), size - 1)


@compiled
def enlarge_rows(y0, y1, image, rows, columns, output):
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
def over(front, alpha, behind):
    """Porter and Duff 1984, premultiplied."""
    return known(front) + (ONE - clamp(alpha, ZERO, ONE)) * known(behind)


@compiled
def over_rows(y0, y1, overlay, colour, output):
    for y in range(y0, y1):
        for x in range(output.shape[1]):
            for c in range(3):
                output[y, x, c] = over(overlay[y, x, c], overlay[y, x, 3], colour[y, x, c])


@compiled
def over_alpha_rows(y0, y1, overlay, alpha, output):
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
