"""Cubic resampling of any plane to another size."""

import math

import numpy as np

from postfx.kernels.kernel import Kernel
from postfx.kernels.numeric import compiled, inline

ONE = np.float32(1)


@inline
def catmull_rom(t):
    """Weights of the four taps around a position ``t`` in [0, 1) after the second one (Keys 1981, a = -0.5)."""
    half = np.float32(0.5)
    return (((-half * t + ONE) * t - half) * t, (np.float32(1.5) * t - np.float32(2.5)) * t * t + ONE,
            ((np.float32(-1.5) * t + np.float32(2)) * t + half) * t, (half * t - half) * t * t)


@compiled
def resample_rows(y0, y1, image, jitter, output):
    """Cubic interpolation at output centres, samples lying ``jitter`` (x, y) pixels off their centres.

    Values stay within those of the four nearest samples, so that edges do not ring and nothing turns negative.
    """
    h, w, channels = image.shape
    height, width = output.shape[:2]
    column = np.empty(4, np.int64)
    for y in range(y0, y1):
        py = np.float32((y + 0.5) * h / height - 0.5 - jitter[1])
        top = math.floor(py)
        down = catmull_rom(np.float32(py - top))
        for x in range(width):
            px = np.float32((x + 0.5) * w / width - 0.5 - jitter[0])
            left = math.floor(px)
            across = catmull_rom(np.float32(px - left))
            for i in range(4):
                column[i] = min(max(int(left) - 1 + i, 0), w - 1)
            for c in range(channels):
                value, low, high = np.float32(0), np.float32(np.inf), np.float32(-np.inf)
                for j in range(4):
                    row = min(max(int(top) - 1 + j, 0), h - 1)
                    for i in range(4):
                        sample = image[row, column[i], c]
                        value += down[j] * across[i] * sample
                        if 0 < i < 3 and 0 < j < 3:
                            low, high = min(low, sample), max(high, sample)
                output[y, x, c] = min(max(value, low), high)


RESAMPLE = Kernel("resample", ("image", "jitter"), ("output",), resample_rows, ("output", 0),
                  {"image": ("h", "w", "channels"), "jitter": (2,), "output": ("height", "width", "channels")})
