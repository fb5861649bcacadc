"""Kernel before a network in integers: keeps the planes that it reads in 8 bits, all channels of a pixel together.

``coding`` (2, C) holds what a channel is multiplied by and the code of zero; codes beyond 0 to 255 are taken for these.
``stored`` (1, h, w, C) may have more channels than ``planes``, which mean nothing; where it is ringed, it has one more
row and column on every side, where all channels are zero.
"""

import numpy as np

from postfx.kernels.kernel import Kernel
from postfx.kernels.numeric import compiled, vectorised

LEAST, MOST, HALF = np.float32(0), np.float32(255), np.float32(0.5)


@compiled
def codes(values, scale, zero, row):
    """8-bit codes of a channel's row; of what is no number, that of zero."""
    for x in range(values.size):
        value = values[x] * scale if values[x] == values[x] else LEAST
        row[x] = np.uint8(min(max(value + zero + HALF, LEAST), MOST))


@vectorised
def interleave(rows, pixels):
    """(C, w) -> (w, C)."""
    for x in range(pixels.shape[0]):
        for channel in range(pixels.shape[1]):
            pixels[x, channel] = rows[channel, x]


@compiled
def store_rows(y0, y1, planes, coding, stored):
    """Codes of the planes, and those of zero around them."""
    _, channels, h, w = planes.shape
    ring = (stored.shape[1] - h) // 2
    rows = np.empty((stored.shape[3], stored.shape[2]), np.uint8)
    for channel in range(stored.shape[3]):
        rows[channel] = np.uint8(coding[1, channel])
    for row in range(y0, y1):
        y = row - ring
        for channel in range(channels):
            if 0 <= y < h:
                codes(planes[0, channel, y], coding[0, channel], coding[1, channel], rows[channel, ring:ring + w])
            else:
                rows[channel] = np.uint8(coding[1, channel])
        interleave(rows, stored[0, row])


def _kernel(name: str, rows: str, columns: str) -> Kernel:
    return Kernel(name, ("planes", "coding"), ("stored",), store_rows, ("stored", 1),
                  {"planes": (1, "channels", "hp", "wp"), "coding": (2, "wide"), "stored": (1, rows, columns, "wide")},
                  {"stored": "uint8"})


STORE = _kernel("denoise_store", "hp", "wp")
STORE_RINGED = _kernel("denoise_store_ringed", "ringed_hp", "ringed_wp")
