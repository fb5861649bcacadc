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
    between,
    centre,
    compiled,
    inline,
    vectorised,
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


@inline
def is_inside(px: Real, py: Real, width: Real, height: Real) -> Real:
    """Whether a position lies in a picture."""
    return -HALF <= px <= np.float32(width) - HALF and -HALF <= py <= np.float32(height) - HALF


@vectorised
def lean_on(corners: np.ndarray, index: np.ndarray, leans: np.ndarray, out: np.ndarray) -> None:
    """Linear interpolation between the left and right corners of the pixels at ``index``."""
    for x in range(index.size):
        at = index[x]
        out[x] = corners[0, at] + (corners[1, at] - corners[0, at]) * leans[x]


@compiled
def trust_side(first: int, y: Real, size: tuple[int, int], moved: np.ndarray, past: np.ndarray,
               scale: tuple[Real, Real], share: np.ndarray, trust: np.ndarray) -> None:
    """At scale 2, how much of the history each output pixel on one side of the render pixels keeps, from ``first`` on.

    ``share`` is how much each render pixel may keep, ``trust`` the predicted blend at first; nothing is kept where the
    pixel lay beyond the border, or where the history does not hold it. Flat arrays, numbers of 32 bits and tests
    without jumps become vector code.
    """
    flat, held_count, (across, down) = moved.reshape(moved.size), past.reshape(past.size), scale
    right, bottom = np.float32(size[0]) - HALF, np.float32(size[1]) - HALF
    for x in range(trust.size):
        px, py = np.float32(np.int32(2 * x + first)) + flat[2 * x] * across, y + flat[2 * x + 1] * down
        inside = (px >= -HALF) & (px <= right) & (py >= -HALF) & (py <= bottom) & (held_count[4 * x + 3] >= ZERO)
        kept = share[x] * (ONE - trust[x])
        trust[x] = kept if inside else ZERO


@compiled
def trust_picked(left: int, y: Real, size: tuple[int, int], moved: np.ndarray, past: np.ndarray,
                 scale: tuple[Real, Real], share: np.ndarray, index: np.ndarray, blend: np.ndarray,
                 trust: np.ndarray) -> None:
    """The same for a row at any scale, three times a pixel."""
    for x in range(index.size):
        at = index[x]
        px, py = np.float32(left + x) + moved[at, 0] * scale[0], y + moved[at, 1] * scale[1]
        inside = is_inside(px, py, size[0], size[1]) and past[at, 3] >= ZERO
        trust[3 * x] = trust[3 * x + 1] = trust[3 * x + 2] = share[at] * (ONE - blend[x]) if inside else ZERO


@compiled
def control_row(first: int, iy: int, ty: Real, fine: np.ndarray, index: np.ndarray, leans: np.ndarray,
                corners: np.ndarray, out: np.ndarray) -> None:
    """A control that is predicted at four phases, for a row at any scale."""
    for side in range(2):
        between(fine[0, first + side, iy], fine[0, first + 2 + side, iy], ty, np.float32(1), corners[side])
    lean_on(corners, index, leans, out)


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
for one in (UPSAMPLE, UPSAMPLE_GUIDED, UPSAMPLE_UNSCALED):
    in_half(one, "fine")
