"""Kernels after a network in integers, whose last products are summed in 32 bits and scaled here.

``products`` are sums of 8-bit products; ``scaling`` (2, C) holds what those of a channel are multiplied by and what is
added, which gives its logit. Both and the activations are one pass. Of each channel of the fine head there are four
phases, as in `postfx.kernels.denoise_open`.
"""

import numpy as np

from postfx.kernels.denoise_layout import BLEND, FINE, KERNEL, MEMORY
from postfx.kernels.denoise_open import gate, state, weight
from postfx.kernels.kernel import Kernel
from postfx.kernels.numeric import compiled, fused


@fused
def weights(left, right, scales, row):
    """Filter weights of a row of pixels; `scales` (2, 2) are what even and odd columns are scaled by."""
    for x in range(left.size):
        row[2 * x] = weight(np.float32(left[x]) * scales[0, 0] + scales[1, 0])
        row[2 * x + 1] = weight(np.float32(right[x]) * scales[0, 1] + scales[1, 1])


@fused
def gates(left, right, scales, row):
    """Logistic function, likewise."""
    for x in range(left.size):
        row[2 * x] = gate(np.float32(left[x]) * scales[0, 0] + scales[1, 0])
        row[2 * x + 1] = gate(np.float32(right[x]) * scales[0, 1] + scales[1, 1])


@fused
def states(left, right, scales, row):
    """Hyperbolic tangent, likewise."""
    for x in range(left.size):
        row[2 * x] = state(np.float32(left[x]) * scales[0, 0] + scales[1, 0])
        row[2 * x + 1] = state(np.float32(right[x]) * scales[0, 1] + scales[1, 1])


@compiled
def open_fine_products_rows(y0, y1, products, scaling, fine):
    """The fine head: weights, gates and the hidden state."""
    for channel in range(FINE):
        for y in range(y0, y1):
            first = 4 * channel + 2 * (y % 2)
            left, right, row = products[0, first, y // 2], products[0, first + 1, y // 2], fine[0, channel, y]
            scales = scaling[:, first:first + 2]
            if channel < BLEND:
                weights(left, right, scales, row)
            elif channel < MEMORY:
                gates(left, right, scales, row)
            else:
                states(left, right, scales, row)


@fused
def level_weights(sums, scale, bias, row):
    """Filter weights of a row of places."""
    for x in range(row.size):
        row[x] = weight(np.float32(sums[x]) * scale + bias)


@fused
def level_gates(sums, scale, bias, row):
    """Logistic function, likewise."""
    for x in range(row.size):
        row[x] = gate(np.float32(sums[x]) * scale + bias)


@compiled
def open_products_rows(y0, y1, products, scaling, heads):
    """Weights of a level's filters and its mix, which the coarsest level has not."""
    for channel in range(heads.shape[1]):
        scale, bias = scaling[0, channel], scaling[1, channel]
        for y in range(y0, y1):
            if channel < KERNEL:
                level_weights(products[0, channel, y], scale, bias, heads[0, channel, y])
            else:
                level_gates(products[0, channel, y], scale, bias, heads[0, channel, y])


OPEN_PRODUCTS = Kernel(
    "denoise_open_products", ("products", "scaling"), ("heads",), open_products_rows, ("heads", 2),
    {"products": (1, "heads", "hp", "wp"), "scaling": (2, "heads"), "heads": (1, "heads", "hp", "wp")},
    {"products": "int32"})
OPEN_FINE_PRODUCTS = Kernel(
    "denoise_open_fine_products", ("products", "scaling"), ("fine",), open_fine_products_rows, ("fine", 2),
    {"products": (1, 4 * FINE, "half_hp", "half_wp"), "scaling": (2, 4 * FINE),
     "fine": (1, FINE, "2*half_hp", "2*half_wp")},
    {"products": "int32"})
