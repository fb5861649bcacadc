"""Tetrahedral look-up in a colour cube, on rows.

A cube is (size, size, size, 3): red, green, blue, channel. Of the eight corners around a colour only the four on the
path from the lowest to the highest count, so that greys are what the cube's diagonal says. Formula: Kasson et al. 1995,
"Performing color space conversions with three-dimensional linear interpolation".
"""

from __future__ import annotations

import numpy as np

from postfx.kernels.numeric import compiled, fused

ZERO, ONE = np.float32(0.0), np.float32(1.0)


@compiled
def cube_row(shaped, cube, places, shares, output):
    """Look a row up: shaped (3, width), clipped to [0, 1], to output (width, 3). NaN counts as 0.

    `places` (3, width) int32 and `shares` (3, width) float32 are scratch. First where and how much, in vector code,
    then the look-ups: measured four times as fast as pixel by pixel.
    """
    size = cube.shape[0]
    _find(shaped, size, places, shares)
    _gather(cube.reshape(3 * size * size * size), 3 * (size * size + size + 1), places, shares, output)


@fused
def _find(shaped, size, places, shares):
    """Numbers before the first three of the four corners, and the shares of a colour, largest first."""
    last, end = np.float32(size - 1), np.int32(size - 2)
    along_red, along_green, along_blue = np.int32(3 * size * size), np.int32(3 * size), np.int32(3)
    red, green, blue = shaped[0], shaped[1], shaped[2]
    first, second, third = places[0], places[1], places[2]
    most, middle, least = shares[0], shares[1], shares[2]
    for x in range(red.shape[0]):
        r = min(max(red[x], ZERO), ONE) * last
        g = min(max(green[x], ZERO), ONE) * last
        b = min(max(blue[x], ZERO), ONE) * last
        i, j, k = min(np.int32(r), end), min(np.int32(g), end), min(np.int32(b), end)
        r, g, b = r - np.float32(i), g - np.float32(j), b - np.float32(k)
        # The first step goes along the axis of the largest share, the last along that of the smallest.
        step = along_red if r >= g and r >= b else (along_green if g >= b else along_blue)
        final = along_blue if r >= b and g >= b else (along_green if r >= g else along_red)
        most[x], least[x] = max(max(r, g), b), min(min(r, g), b)
        middle[x] = max(min(r, g), min(max(r, g), b))
        at = i * along_red + j * along_green + k * along_blue
        first[x], second[x], third[x] = at, at + step, at + (along_red + along_green + along_blue) - final


@fused
def _gather(flat, across, places, shares, output):
    """Weighted sums of the corners' colours; the fourth corner is `across` numbers after the first."""
    for x in range(output.shape[0]):
        a, b, c = np.uint32(places[0, x]), np.uint32(places[1, x]), np.uint32(places[2, x])  # signs would be looked at
        d = a + np.uint32(across)
        most, middle, least = shares[0, x], shares[1, x], shares[2, x]
        w0, w1, w2 = ONE - most, most - middle, middle - least
        output[x, 0] = w0 * flat[a] + w1 * flat[b] + (w2 * flat[c] + least * flat[d])
        output[x, 1] = w0 * flat[a + 1] + w1 * flat[b + 1] + (w2 * flat[c + 1] + least * flat[d + 1])
        output[x, 2] = w0 * flat[a + 2] + w1 * flat[b + 2] + (w2 * flat[c + 2] + least * flat[d + 2])
