"""The HDR shaper of the tone mapper, on rows: log2(1 + exposure * x / toe) * scale, clipped to [0, 1]."""

from __future__ import annotations

import numpy as np

from postfx.kernels.numeric import compiled

EXPOSURE, TOE, SCALE = 0, 1, 2  # places in `params`
SQRT_HALF_BITS = np.int32(0x3F3504F3)
ONE = np.float32(1.0)
CUBIC, QUINTIC, SEPTIC = np.float32(1 / 3), np.float32(1 / 5), np.float32(1 / 7)
TWO_OVER_LN2 = np.float32(2.0 / np.log(2.0))


@compiled
def shape_row(row, params, out, scratch):
    """Shape a flat row of colour; `scratch` is int32 of the same length. NaN and negative values become 0.

    The logarithm splits off the exponent and sums the series of atanh over the mantissa in [0.707, 1.414):
    absolute error below 3e-7, and every loop is one that the compiler turns into vector code.
    """
    count = row.shape[0]
    gain, scale = np.float32(params[EXPOSURE] / params[TOE]), np.float32(params[SCALE])
    most = np.float32(2.0 ** min(126.0, 1.0 / params[SCALE] + 1.0))
    for i in range(count):
        x = row[i] if row[i] > np.float32(0.0) else np.float32(0.0)
        out[i] = min(x * gain + ONE, most)
    bits = out.view(np.int32)
    for i in range(count):
        exponent = (bits[i] - SQRT_HALF_BITS) >> np.int32(23)
        bits[i] = bits[i] - (exponent << np.int32(23))
        scratch[i] = exponent
    for i in range(count):
        z = (out[i] - ONE) / (out[i] + ONE)
        q = z * z
        series = z * (ONE + q * (CUBIC + q * (QUINTIC + q * SEPTIC)))
        out[i] = min((np.float32(scratch[i]) + TWO_OVER_LN2 * series) * scale, ONE)
