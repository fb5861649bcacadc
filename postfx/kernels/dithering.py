"""Code values to eight bits by thresholds, on the host: one walk over the picture where NumPy makes eight."""

from __future__ import annotations

import numpy as np

from postfx.kernels.numeric import compiled

ZERO, ONE = np.float32(0), np.float32(1)


@compiled
def dither_rows(codes, top, thresholds, shifts, output):
    """output (height, width, channels) uint8 = the whole part of top * codes, cut to 0..1, plus a threshold.

    codes: float32, NaN counts as 0; thresholds (side, side) float32 in (0, 1), repeated; shifts (channels, 2): row
    and column of the thresholds that a channel's first pixel gets.
    """
    height, width, channels = codes.shape
    side = thresholds.shape[0]
    for y in range(height):
        for c in range(channels):
            row, right = thresholds[(y + shifts[c, 0]) % side], shifts[c, 1]
            for start in range(0, width, side):
                count = min(side, width - start)
                for i in range(count):
                    value = codes[y, start + i, c]
                    value = value if value == value else ZERO
                    at = i + right
                    at = at if at < side else at - side
                    output[y, start + i, c] = np.uint8(min(max(value, ZERO), ONE) * top + row[at])
