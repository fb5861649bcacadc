"""Kernels that mix a picture with another denoiser's.

Both pictures are compared in logarithms of exposed light, log(1 + x). Between them lies an interval around their
weighted mean. The last mixture, moved along the motion, is what comes out where it lies in that interval, and the
nearest end of the interval elsewhere. So the mixture is as steady as both pictures allow, and shows nothing that
neither of them shows.

colour, partner, history (height, width, 3); motion (height, width, 2), or (1, 1, 2) for one vector everywhere; weight
and strength (height, width, 1), or (1, 1, 1) for one number: how much the partner counts, and how strongly all of it
acts; settings (4,): exposure; how far the interval reaches from the mean to the nearer picture, 0 to 1; whether there
is a history; and what all strengths are multiplied by.
"""

from __future__ import annotations

import numpy as np

from postfx.kernels import Kernel
from postfx.kernels.numeric import Real, clamp, compiled, expm1, inline, log1p

ZERO, ONE, INFINITE = np.float32(0), np.float32(1), np.float32(np.inf)
MOST_LIGHT = np.float32(1e30)
"""Exposed light: more counts as this much."""
MOST_MOVED = np.float32(1 << 24)
"""Pixels: beyond, float32 has no fractions, and the place lies outside of any picture."""


@inline
def number_at(plane: np.ndarray, y: int, x: int) -> Real:
    """A number within 0..1 of a plane, or of one pixel for all."""
    return clamp(plane[min(y, plane.shape[0] - 1), min(x, plane.shape[1] - 1), 0], ZERO, ONE)


@inline
def encode(light: Real) -> Real:
    """Logarithm of exposed light; that of light below 0 is the negative one. No number counts as 0."""
    size = log1p(min(max(ZERO, abs(light)), MOST_LIGHT))
    return size if light > ZERO else -size


@inline
def decode(coded: Real) -> Real:
    """The inverse of `encode`."""
    size = expm1(abs(coded))
    return size if coded > ZERO else -size


@inline
def place_of(at: int, moved: Real, size: int) -> Real:
    """Where a pixel was along an axis; -1 if that is outside of the picture or unknown."""
    if not abs(moved) < MOST_MOVED:
        return -ONE
    place = np.float32(at) + moved
    return place if ZERO <= place <= np.float32(size - 1) else -ONE


@compiled
def mix_rows(y0: int, y1: int, colour: np.ndarray, partner: np.ndarray, history: np.ndarray, motion: np.ndarray,
             weight: np.ndarray, strength: np.ndarray, settings: np.ndarray, output: np.ndarray) -> None:
    height, width = output.shape[:2]
    exposure, reach, keep = settings[0], settings[1], settings[2] > ZERO
    for y in range(y0, y1):
        for x in range(width):
            acting = clamp(settings[3], ZERO, ONE) * number_at(strength, y, x)
            share = acting * number_at(weight, y, x)
            most = reach * min(share, acting - share)
            row, column = min(y, motion.shape[0] - 1), min(x, motion.shape[1] - 1)
            at_y = place_of(y, motion[row, column, 1], height)
            at_x = place_of(x, motion[row, column, 0], width)
            known = keep and at_y >= ZERO and at_x >= ZERO
            top, left = max(int(at_y), 0), max(int(at_x), 0)
            below, right = min(top + 1, height - 1), min(left + 1, width - 1)
            v, u = at_y - np.float32(top), at_x - np.float32(left)
            for c in range(3):
                own = encode(exposure * colour[y, x, c])
                apart = encode(exposure * partner[y, x, c]) - own
                if (share == ZERO or apart == ZERO) and abs(colour[y, x, c]) < INFINITE:
                    output[y, x, c] = colour[y, x, c]
                    continue
                mixed = own + share * apart
                if known:
                    upper = history[top, left, c] + u * (history[top, right, c] - history[top, left, c])
                    lower = history[below, left, c] + u * (history[below, right, c] - history[below, left, c])
                    before = encode(exposure * (upper + v * (lower - upper)))
                    mixed = min(max(before, mixed - most * abs(apart)), mixed + most * abs(apart))
                output[y, x, c] = decode(mixed) / exposure


PICTURE = ("height", "width", 3)
MIX_PARTNER = Kernel(
    name="mix_partner",
    reads=("colour", "partner", "history", "motion", "weight", "strength", "settings"),
    writes=("output",),
    rows=mix_rows,
    row_axis=("output", 0),
    shapes={"colour": PICTURE, "partner": PICTURE, "history": PICTURE, "motion": ("motion_h", "motion_w", 2),
            "weight": ("weight_h", "weight_w", 1), "strength": ("strength_h", "strength_w", 1), "settings": (4,),
            "output": PICTURE},
)


@compiled
def enlarge_motion_rows(y0: int, y1: int, motion: np.ndarray, rows: np.ndarray, columns: np.ndarray,
                        ratio: np.ndarray, enlarged: np.ndarray) -> None:
    h, w = motion.shape[:2]
    for y in range(y0, y1):
        row = min(max(int(np.rint(rows[y])), 0), h - 1)
        for x in range(columns.size):
            column = min(max(int(np.rint(columns[x])), 0), w - 1)
            for c in range(2):
                moved = motion[row, column, c]
                enlarged[y, x, c] = moved * ratio[c] if abs(moved) < MOST_MOVED else MOST_MOVED


ENLARGE_MOTION = Kernel(
    name="enlarge_motion",
    reads=("motion", "rows", "columns", "ratio"),
    writes=("enlarged",),
    rows=enlarge_motion_rows,
    row_axis=("enlarged", 0),
    shapes={"motion": ("h", "w", 2), "rows": ("height",), "columns": ("width",), "ratio": (2,),
            "enlarged": ("height", "width", 2)},
)
"""Motion of the nearest render pixel, in pixels of the output; ratio (2,): output size over render size, x and y."""
