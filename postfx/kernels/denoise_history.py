"""Kernel that brings the upscaler's last output to where its pixels are now."""

import numpy as np

from postfx.kernels.denoise_layout import GAIN, HEIGHT, LEFT, TOP, WIDTH, kernel
from postfx.kernels.numeric import centre, compiled, expm1, fused, fused_inline, log1p, vectorised

ZERO, ONE = np.float32(0), np.float32(1)


@fused_inline
def cubic(t):
    """The four weights of cubic convolution with a = -0.75, the ONNX GridSample and OpenCV default."""
    a = np.float32(-0.75)
    u, v, s = t + ONE, ONE - t, np.float32(2) - t
    return (((a * u - 5 * a) * u + 8 * a) * u - 4 * a, ((a + 2) * t - (a + 3)) * t * t + ONE,
            ((a + 2) * v - (a + 3)) * v * v + ONE, ((a * s - 5 * a) * s + 8 * a) * s - 4 * a)


@vectorised
def steps(moved, axis, scale, shift, weights):
    """Motion along a row in whole output pixels, and the weights (4, w) of the cubic taps for the rest of it.

    All output pixels in a render pixel share them, for they share its motion.
    """
    for x in range(shift.size):
        at = moved[x, axis] * scale
        whole = np.floor(at)
        shift[x] = np.int32(whole)
        weights[0, x], weights[1, x], weights[2, x], weights[3, x] = cubic(at - whole)


@fused_inline
def across(flat, start, w0, w1, w2, w3):
    """Weighted sum of four neighbouring pixels in a flat picture; an unsigned ``start`` needs no check for below 0."""
    three, six, nine = np.uint64(3), np.uint64(6), np.uint64(9)
    at, one, two = start, start + np.uint64(1), start + np.uint64(2)
    return (w0 * flat[at] + w1 * flat[at + three] + w2 * flat[at + six] + w3 * flat[at + nine],
            w0 * flat[one] + w1 * flat[one + three] + w2 * flat[one + six] + w3 * flat[one + nine],
            w0 * flat[two] + w1 * flat[two + three] + w2 * flat[two + six] + w3 * flat[two + nine])


@fused
def warp_row(y, columns, history, index, shift_x, shift_y, wx, wy, row):
    """Row ``y`` of the history moved, at ``columns``; ``index`` is the render pixel of each output pixel."""
    height, width = history.shape[:2]
    flat = history.reshape(height * width * 3)
    line = np.uint64(3 * width)
    for x in range(index.size):
        at = index[x]
        left, top = columns[x] + shift_x[at] - 1, y + shift_y[at] - 1
        w0, w1, w2, w3 = wx[0, at], wx[1, at], wx[2, at], wx[3, at]
        d0, d1, d2, d3 = wy[0, at], wy[1, at], wy[2, at], wy[3, at]
        if 0 <= left <= width - 4 and 0 <= top <= height - 4:
            start = np.uint64((top * width + left) * 3)
            r0, g0, b0 = across(flat, start, w0, w1, w2, w3)
            r1, g1, b1 = across(flat, start + line, w0, w1, w2, w3)
            r2, g2, b2 = across(flat, start + line + line, w0, w1, w2, w3)
            r3, g3, b3 = across(flat, start + line + line + line, w0, w1, w2, w3)
            row[3 * x] = d0 * r0 + d1 * r1 + d2 * r2 + d3 * r3
            row[3 * x + 1] = d0 * g0 + d1 * g1 + d2 * g2 + d3 * g3
            row[3 * x + 2] = d0 * b0 + d1 * b1 + d2 * b2 + d3 * b3
        else:
            row[3 * x] = row[3 * x + 1] = row[3 * x + 2] = ZERO
            for j in range(4):
                for i in range(4):
                    weight = wy[j, at] * wx[i, at]
                    pixel = history[min(max(top + j, 0), height - 1), min(max(left + i, 0), width - 1)]
                    for c in range(3):
                        row[3 * x + c] += weight * pixel[c]


@vectorised
def rescale_row(row, gain):
    """A row of log-encoded colour after an exposure change."""
    for i in range(row.size):
        row[i] = log1p(expm1(row[i]) * gain)


@compiled
def history_rows(y0, y1, history, moved, params, window, out_rows, out_columns, warped):
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
