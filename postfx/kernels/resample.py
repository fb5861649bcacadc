"""Cubic resampling of any plane to another size."""

import math

import numpy as np

from postfx.kernels.kernel import Kernel
from postfx.kernels.numeric import compiled, inline

ZERO, ONE = np.float32(0), np.float32(1)


@inline
def catmull_rom(t):
    """Weights of the four taps around a position ``t`` in [0, 1) after the second one (Keys 1981, a = -0.5)."""
    half = np.float32(0.5)
    return (((-half * t + ONE) * t - half) * t, (np.float32(1.5) * t - np.float32(2.5)) * t * t + ONE,
            ((np.float32(-1.5) * t + np.float32(2)) * t + half) * t, (half * t - half) * t * t)


@compiled
def resample_rows(y0, y1, image, rows, columns, output):
    """Cubic interpolation at `rows` (height,) and `columns` (width,), positions in the image, pixel centres whole.

    Values stay within those of the four nearest samples, so that edges do not ring and nothing turns negative. What is
    not finite counts as 0.
    """
    h, w, channels = image.shape
    column = np.empty(4, np.int64)
    for y in range(y0, y1):
        top = math.floor(rows[y])
        down = catmull_rom(rows[y] - np.float32(top))
        for x in range(output.shape[1]):
            left = math.floor(columns[x])
            across = catmull_rom(columns[x] - np.float32(left))
            for i in range(4):
                column[i] = min(max(int(left) - 1 + i, 0), w - 1)
            for c in range(channels):
                value, low, high = ZERO, np.float32(np.inf), np.float32(-np.inf)
                for j in range(4):
                    row = image[min(max(int(top) - 1 + j, 0), h - 1)]
                    for i in range(4):
                        sample = row[column[i], c]
                        sample = sample if abs(sample) < np.inf else ZERO
                        value += down[j] * across[i] * sample
                        if 0 < i < 3 and 0 < j < 3:
                            low, high = min(low, sample), max(high, sample)
                output[y, x, c] = min(max(value, low), high)


def positions(size: int, out_size: int, shift: float = 0.0) -> np.ndarray:
    """Where the output's pixel centres lie in an image whose samples are `shift` pixels off their centres."""
    return ((np.arange(out_size) + 0.5) * (size / out_size) - 0.5 - shift).astype(np.float32)


RESAMPLE = Kernel("resample", ("image", "rows", "columns"), ("output",), resample_rows, ("output", 0),
                  {"image": ("h", "w", "channels"), "rows": ("height",), "columns": ("width",),
                   "output": ("height", "width", "channels")})
