"""Kernels that enlarge the filtered radiance by predicted weights, sharpen it, and blend it with the last output."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from postfx.kernels.denoise import (
    BOTH,
    GUIDE_REFLECTANCE,
    HEIGHT,
    OUT_HEIGHT,
    OUT_TOP,
    OUT_WIDTH,
    TOP,
    WIDTH,
    in_half,
    kernel,
)
from postfx.kernels.numeric import (
    Real,
    centre,
    inline,
)

SIGMA = 0.5
ZERO, HALF, ONE = np.float32(0), np.float32(0.5), np.float32(1)
TAPS = 9


@inline
def gauss(distance: Real) -> Real:
    """Weight of a sample for an output pixel at a distance in render pixels."""
    return np.float32(math.exp(-(distance * distance) / (2 * SIGMA * SIGMA)))


@inline
def lean(offset: Real) -> Real:
    """Share of the right or lower of the two quarter-pixel corners at an offset."""
    return np.float32(min(max(2 * offset + 0.5, 0.0), 1.0))


@inline
def pixel_of(position: int, side: int, window: np.ndarray, size: int) -> tuple[int, Real]:
    """The render pixel that holds the centre of a row (``side`` TOP) or column (LEFT) of a window's output, of the
    window's ``size`` rows or columns, and how far off its centre."""
    full, out = int(window[HEIGHT + side]), int(window[OUT_HEIGHT + side])
    at, offset = centre(min(int(window[OUT_TOP + side]) + position, out - 1), full, out)
    return min(max(at - int(window[TOP + side]), 0), size - 1), offset


@inline
def is_doubled(window: np.ndarray) -> bool:
    """Whether the output has twice the frame's rows and columns."""
    return bool(window[OUT_WIDTH] == 2 * window[WIDTH] and window[OUT_HEIGHT] == 2 * window[HEIGHT])


WRITES = ("output", "next_history")
BETWEEN, LAST = ("moved", "past", "warped"), ("params", "window", "keep")
HELD, CODED = ("radiance", "fine", *BETWEEN), ("radiance", "codes", "factors", "scaling", *BETWEEN)
GUIDES_READ = (*GUIDE_REFLECTANCE, "trust")
UPSAMPLE = kernel("upsample", (*HELD, *LAST), WRITES, None, ("output", 0))
UPSAMPLE_GUIDED = kernel("upsample_guided", (*HELD, *GUIDES_READ, *LAST), WRITES, None, ("output", 0),
                         radiance=BOTH)
UPSAMPLE_UNSCALED = kernel("upsample_unscaled", (*HELD, "factor", *LAST), WRITES, None, ("output", 0),
                           radiance=BOTH)
CODES_PLAIN = kernel("upsample_codes", (*CODED, *LAST), WRITES, None, ("output", 0))
CODES_GUIDED = kernel("upsample_guided_codes", (*CODED, *GUIDES_READ, *LAST), WRITES, None, ("output", 0),
                      radiance=BOTH)
CODES_UNSCALED = kernel("upsample_unscaled_codes", (*CODED, "factor", *LAST), WRITES, None,
                        ("output", 0), radiance=BOTH)
UPSAMPLE, UPSAMPLE_GUIDED = (replace(one, pixels=(2, 2)) for one in (UPSAMPLE, UPSAMPLE_GUIDED))
BLEND_PICTURE = kernel("blend_picture", ("picture", "controls", *BETWEEN, *LAST), WRITES, None, ("output", 0))
"""A picture that a network gives itself, blended with the last output: its first control is its share."""
for one in (UPSAMPLE, UPSAMPLE_GUIDED, UPSAMPLE_UNSCALED):
    in_half(one, "fine")
