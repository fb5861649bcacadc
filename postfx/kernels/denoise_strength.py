"""Kernel that leaves the noise in, pixel by pixel, as far as the strength of denoising says."""

import numpy as np

from postfx.kernels.denoise_layout import kernel
from postfx.kernels.numeric import clamp, compiled

ZERO, ONE = np.float32(0), np.float32(1)


@compiled
def strength_rows(y0, y1, denoised, plain, strength, amount, output):
    """From ``plain`` to ``denoised`` by strength times amount; both ends are exact."""
    factor = clamp(amount[0], ZERO, ONE)
    for y in range(y0, y1):
        for x in range(output.shape[1]):
            share = clamp(strength[y, x, 0], ZERO, ONE) * factor
            for c in range(3):
                noisy, clean = plain[y, x, c], denoised[y, x, c]
                output[y, x, c] = clean if share == ONE else noisy + (clean - noisy) * share


IMAGE = ("height", "width", 3)
STRENGTH = kernel("strength", ("denoised", "plain", "strength", "amount"), ("output",), strength_rows, ("output", 0),
                  denoised=IMAGE, plain=IMAGE, output=IMAGE, strength=("height", "width", 1), amount=(1,))
