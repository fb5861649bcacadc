"""The tone mapper's shaper, on rows: a matrix, then log2(1 + exposure * x / toe) * scale in [0, 1].

The matrix turns Rec.709 to wider primaries (Rec.2020 for the shipped looks), so that colours outside Rec.709, which are
negative there, are not cut. Light above the range is scaled down as a whole: its channels keep their ratio, and so its
hue.
"""

from __future__ import annotations

import numpy as np

from postfx.kernels.numeric import clamp, fused

EXPOSURE, TOE, SCALE = 0, 1, 2  # places in `params`
LARGEST = np.float32(1e10)  # stands for infinity
SQRT_HALF_BITS = np.int32(0x3F3504F3)
ZERO, ONE = np.float32(0.0), np.float32(1.0)
CUBIC, QUINTIC, SEPTIC = np.float32(1 / 3), np.float32(1 / 5), np.float32(1 / 7)
TWO_OVER_LN2 = np.float32(2.0 / np.log(2.0))


@fused
def shape_row(row, params, matrix, out, scratch):
    """Shape a row of colour (width, 3) into out (3, width); `scratch` is int32 (width,). NaN counts as 0.

    The logarithm splits off the exponent and sums the series of atanh over the mantissa in [0.707, 1.414):
    absolute error below 3e-7, and every loop is one that the compiler turns into vector code.
    """
    gain, scale = np.float32(params[EXPOSURE] / params[TOE]), np.float32(params[SCALE])
    most = np.float32(2.0 ** min(126.0, 1.0 / params[SCALE]) - 1.0)
    rr, rg, rb, gr, gg, gb = matrix[0], matrix[1], matrix[2], matrix[3], matrix[4], matrix[5]
    br, bg, bb = matrix[6], matrix[7], matrix[8]
    red, green, blue, flat = out[0], out[1], out[2], row.reshape(row.size)
    for x in range(red.size):
        r, g = clamp(flat[3 * x], -LARGEST, LARGEST), clamp(flat[3 * x + 1], -LARGEST, LARGEST)
        b = clamp(flat[3 * x + 2], -LARGEST, LARGEST)
        red[x] = max(rr * r + rg * g + rb * b, ZERO) * gain
        green[x] = max(gr * r + gg * g + gb * b, ZERO) * gain
        blue[x] = max(br * r + bg * g + bb * b, ZERO) * gain
    for x in range(red.size):
        fit = most / max(max(red[x], green[x]), max(blue[x], most))
        red[x], green[x], blue[x] = red[x] * fit + ONE, green[x] * fit + ONE, blue[x] * fit + ONE
    for c in range(3):
        _log_row(out[c], scale, scratch)


@fused
def _log_row(values, scale, scratch):
    """Replace values >= 1 by min(log2(value) * scale, 1)."""
    bits = values.view(np.int32)
    for x in range(values.shape[0]):
        exponent = (bits[x] - SQRT_HALF_BITS) >> np.int32(23)
        bits[x] = bits[x] - (exponent << np.int32(23))
        scratch[x] = exponent
    for x in range(values.shape[0]):
        z = (values[x] - ONE) / (values[x] + ONE)
        q = z * z
        series = z * (ONE + q * (CUBIC + q * (QUINTIC + q * SEPTIC)))
        values[x] = min((np.float32(scratch[x]) + TWO_OVER_LN2 * series) * scale, ONE)
