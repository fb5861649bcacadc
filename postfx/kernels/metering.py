"""Block averages of luminance that exposure is metered on; runs on the host, before a frame is uploaded."""

from __future__ import annotations

import numpy as np

from postfx.kernels.numeric import Real, compiled, inline


@inline
def luminance(colour: np.ndarray, y: int, x: int) -> Real:
    """Luminance of a pixel of Rec.709."""
    return 0.2126 * colour[y, x, 0] + 0.7152 * colour[y, x, 1] + 0.0722 * colour[y, x, 2]


@compiled
def block_means(colour: np.ndarray, block: int, means: np.ndarray) -> None:
    """Mean luminance of each block x block pixels without the brightest; colour (h, w, 3) -> means (rows, columns).

    Non-finite pixels are left out, negative ones count as 0. Averaging keeps the noise of one sample a pixel out of
    the logarithm that follows, which would read it as darkness; without the brightest pixel a firefly is no light.
    """
    for j in range(means.shape[0]):
        for i in range(means.shape[1]):
            total, brightest, count = 0.0, 0.0, 0
            for y in range(j * block, min((j + 1) * block, colour.shape[0])):
                for x in range(i * block, min((i + 1) * block, colour.shape[1])):
                    value = luminance(colour, y, x)
                    if abs(value) < np.inf:  # false for NaN too
                        value = max(value, 0.0)
                        total += value
                        brightest = max(brightest, value)
                        count += 1
            means[j, i] = (total - brightest) / (count - 1) if count > 1 else total


@compiled
def half_means(colour: np.ndarray, block: int, means: np.ndarray) -> None:
    """Mean luminance of the two halves of each whole block; colour (h, w, 3) -> means (2, rows, columns).

    The halves are the even and the odd rows, so they show the same with other noise. The brightest pixel of each is
    left out, as by `block_means`; pixels that are not finite and negative ones count as 0.
    """
    for half in range(2):
        for j in range(means.shape[1]):
            for i in range(means.shape[2]):
                total, brightest, count = 0.0, 0.0, 0
                for y in range(j * block + half, (j + 1) * block, 2):
                    for x in range(i * block, (i + 1) * block):
                        value = luminance(colour, y, x)
                        if abs(value) < np.inf:  # false for NaN too
                            value = max(value, 0.0)
                            total += value
                            brightest = max(brightest, value)
                    count += block
                means[half, j, i] = (total - brightest) / (count - 1)
