"""Code values to eight bits by thresholds, on the host: one walk over the picture where NumPy makes eight."""

from __future__ import annotations

import numpy as np

from postfx.kernels.numeric import compiled

ZERO, ONE = np.float32(0), np.float32(1)


@compiled
def dither_rows(codes, top, thresholds, output):
    """output (height, values) uint8 = the whole part of top * codes, cut to 0..1, plus a threshold.

    codes: (height, values) float32, NaN counts as 0; thresholds (rows, columns) float32 in (0, 1), repeated.
    """
    height, values = codes.shape
    rows, columns = thresholds.shape
    for y in range(height):
        row = thresholds[y % rows]
        for start in range(0, values, columns):
            # pieces with an index from 0: otherwise the compiler finds no vector instructions for them
            some, found = codes[y, start : start + columns], output[y, start : start + columns]
            for i in range(some.size):
                value = some[i] if some[i] > ZERO else ZERO  # NaN, too
                value = value if value < ONE else ONE
                found[i] = np.uint8(np.int32(value * top + row[i]))
