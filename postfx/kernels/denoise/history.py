"""Kernel that brings the upscaler's last output to where its pixels are now."""

import numpy as np

from postfx.kernels.denoise.layout import GAIN, HEIGHT, LEFT, TOP, WIDTH, kernel
from postfx.kernels.numeric import Real, centre, compiled, expm1, fused, fused_inline, log1p, vectorised

ZERO, ONE = np.float32(0), np.float32(1)


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
def down(flat: np.ndarray, start: int, line: int, d0: Real, d1: Real, d2: Real, d3: Real) -> tuple[Real, Real, Real]:
    """Weighted sum of four pixels below one another in a flat picture; unsigned places need no check for below 0."""
    one, two = np.uint64(1), np.uint64(2)
    second, third = start + line, start + line + line
    fourth = third + line
    return (d0 * flat[start] + d1 * flat[second] + d2 * flat[third] + d3 * flat[fourth],
            d0 * flat[start + one] + d1 * flat[second + one] + d2 * flat[third + one] + d3 * flat[fourth + one],
            d0 * flat[start + two] + d1 * flat[second + two] + d2 * flat[third + two] + d3 * flat[fourth + two])


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
    """Row ``y`` of the history moved, at ``columns``; ``index`` is the render pixel of each output pixel.

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
        r0, g0, b0 = down(flat, start, line, d0, d1, d2, d3)
        r1, g1, b1 = down(flat, start + next_pixel, line, d0, d1, d2, d3)
        r2, g2, b2 = down(flat, start + next_pixel * np.uint64(2), line, d0, d1, d2, d3)
        start += next_pixel * np.uint64(3)
        r3, g3, b3 = down(flat, start, line, d0, d1, d2, d3)
        row[3 * x] = w0 * r0 + w1 * r1 + w2 * r2 + w3 * r3
        row[3 * x + 1] = w0 * g0 + w1 * g1 + w2 * g2 + w3 * g3
        row[3 * x + 2] = w0 * b0 + w1 * b1 + w2 * b2 + w3 * b3
        x += 1
        if x < index.size and index[x] == at and columns[x] == columns[x - 1] + 1 and left < width - 4:
            r4, g4, b4 = down(flat, start + next_pixel, line, d0, d1, d2, d3)
            row[3 * x] = w0 * r1 + w1 * r2 + w2 * r3 + w3 * r4
            row[3 * x + 1] = w0 * g1 + w1 * g2 + w2 * g3 + w3 * g4
            row[3 * x + 2] = w0 * b1 + w1 * b2 + w2 * b3 + w3 * b4
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
    last = -1
    for out in range(y0, y1):
        y = int(out_rows[out])
        iy, _ = centre(y, h, height)
        iy = min(max(iy - int(window[TOP]), 0), moved.shape[0] - 1)
        if iy != last:
            steps(moved[iy], 0, np.float32(width / w), shift_x, wx)
            steps(moved[iy], 1, np.float32(height / h), shift_y, wy)
            last = iy
        row = warped[out].reshape(3 * index.size)
        warp_row(y, columns, history, index, shift_x, shift_y, wx, wy, row)
        np.maximum(row, ZERO, row)
        if params[GAIN] != ONE:
            rescale_row(row, params[GAIN])


HISTORY = kernel("history", ("history", "moved", "params", "window", "out_rows", "out_columns"), ("warped",),
                 history_rows, ("warped", 0))
