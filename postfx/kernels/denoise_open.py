"""Kernel after a network in float32: activations of the fine head, and its four phases brought to their places.

``phased_fine`` (1, 4 * 80, hp / 2, wp / 2) is what the network's last convolution writes: of each channel the four
phases of 2x2 pixels, top left first. One pass over it takes less time than activations and a shuffle inside the
network, each of which reads and writes 160 MB at 960x540.
"""

import numpy as np

from postfx.kernels.denoise_layout import BLEND, FINE, MEMORY, kernel
from postfx.kernels.numeric import compiled, exp, fused, fused_inline

ONE, TWO = np.float32(1), np.float32(2)
STEEPEST, LEAST, MOST = np.float32(8), np.float32(-80), np.float32(80)


@fused_inline
def weight(logit):
    """Filter weight, with which sums stay within half precision, too."""
    return exp(min(max(logit, -STEEPEST), STEEPEST))


@fused_inline
def gate(logit):
    """Logistic function."""
    return ONE / (ONE + exp(min(max(-logit, LEAST), MOST)))


@fused_inline
def state(logit):
    """Hyperbolic tangent."""
    return ONE - TWO / (ONE + exp(min(max(TWO * logit, LEAST), MOST)))


@fused
def weights(left, right, row):
    for x in range(left.size):
        row[2 * x], row[2 * x + 1] = weight(left[x]), weight(right[x])


@fused
def gates(left, right, row):
    for x in range(left.size):
        row[2 * x], row[2 * x + 1] = gate(left[x]), gate(right[x])


@fused
def states(left, right, row):
    for x in range(left.size):
        row[2 * x], row[2 * x + 1] = state(left[x]), state(right[x])


@compiled
def open_phased_rows(y0, y1, phased_fine, fine):
    """The fine head: weights, gates and the hidden state."""
    for channel in range(FINE):
        for y in range(y0, y1):
            first = 4 * channel + 2 * (y % 2)
            left, right, row = phased_fine[0, first, y // 2], phased_fine[0, first + 1, y // 2], fine[0, channel, y]
            if channel < BLEND:
                weights(left, right, row)
            elif channel < MEMORY:
                gates(left, right, row)
            else:
                states(left, right, row)


OPEN_PHASED = kernel("open_phased", ("phased_fine",), ("fine",), open_phased_rows, ("fine", 2),
                     phased_fine=(1, 4 * FINE, "half_hp", "half_wp"), fine=(1, FINE, "2*half_hp", "2*half_wp"))
