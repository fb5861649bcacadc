"""Kernels of the reactive mask: the share of the history that each pixel must not use, from 0 (none) to 1 (all).

What a reactive pixel leaves to the next frame does not move with the surface seen there. So a pixel is limited by its
own mask and by the mask at the place where it was in the last frame; the larger of both counts. ``last_reactive`` is
the last frame's mask, spread by a pixel because the history is interpolated between pixels.
"""

import numpy as np

from postfx.kernels.denoise import MAX_COLOUR, MAX_FLOAT, kernel
from postfx.kernels.numeric import Real, clamp, compiled

ZERO, ONE = np.float32(0), np.float32(1)
SPREAD = 1  # render pixels


@compiled
def compress(light: Real) -> Real:
    """Exposed light as a display shows it, 0 to 1."""
    held = min(light, np.float32(MAX_COLOUR))
    return np.sqrt(held / (ONE + held))


@compiled
def reactive_rows(y0: int, y1: int, colour: np.ndarray, opaque_colour: np.ndarray, difference: np.ndarray,
                  reactive: np.ndarray) -> None:
    """The mask of what is in front of opaque things; ``difference`` is exposure, scale and threshold.

    The largest channel's difference of the two colours as seen, times the scale, at most 1; 0 below the threshold.
    """
    exposure, scale, threshold = difference
    for y in range(y0, y1):
        for x in range(reactive.shape[1]):
            most = ZERO
            for c in range(3):
                with_all = compress(clamp(colour[y, x, c], ZERO, MAX_FLOAT) * exposure)
                most = max(most, abs(with_all - compress(clamp(opaque_colour[y, x, c], ZERO, MAX_FLOAT) * exposure)))
            reactive[y, x, 0] = min(most * scale, ONE) if most >= threshold else ZERO


@compiled
def spread_rows(y0: int, y1: int, reactive: np.ndarray, next_reactive: np.ndarray) -> None:
    """The largest value around each pixel, within 0 and 1."""
    h, w = reactive.shape[:2]
    for y in range(y0, y1):
        for x in range(w):
            most = ZERO
            for j in range(max(0, y - SPREAD), min(h, y + SPREAD + 1)):
                for i in range(max(0, x - SPREAD), min(w, x + SPREAD + 1)):
                    most = max(most, clamp(reactive[j, i, 0], ZERO, ONE))
            next_reactive[y, x, 0] = most


@compiled
def keep_rows(y0: int, y1: int, reactive: np.ndarray, last_reactive: np.ndarray, moved: np.ndarray,
              part_rows: np.ndarray, part_columns: np.ndarray, keep: np.ndarray) -> None:
    """How much of the history each pixel of a part uses."""
    h, w = reactive.shape[:2]
    for row in range(y0, y1):
        y = int(part_rows[row])
        for column in range(keep.shape[1]):
            x = int(part_columns[column])
            from_y = min(max(int(np.rint(np.float32(y) + moved[row, column, 1])), 0), h - 1)
            from_x = min(max(int(np.rint(np.float32(x) + moved[row, column, 0])), 0), w - 1)
            keep[row, column, 0] = ONE - max(clamp(reactive[y, x, 0], ZERO, ONE), last_reactive[from_y, from_x, 0])


@compiled
def kept_row(keep: np.ndarray, y: int, share: np.ndarray) -> None:
    """A row of ``keep``, which has one value for all pixels or one for each."""
    row, last = keep[min(y, keep.shape[0] - 1)], keep.shape[1] - 1
    for x in range(share.size):
        share[x] = row[min(x, last), 0]


MASK = ("h", "w", 1)
REACTIVE = kernel("reactive", ("colour", "opaque_colour", "difference"), ("reactive",), reactive_rows,
                  ("reactive", 0), opaque_colour=("h", "w", 3), difference=(3,), reactive=MASK)
SPREAD_MASK = kernel("spread", ("reactive",), ("next_reactive",), spread_rows, ("next_reactive", 0), reactive=MASK,
                     next_reactive=MASK)
KEEP = kernel("keep", ("reactive", "last_reactive", "moved", "part_rows", "part_columns"), ("keep",), keep_rows,
              ("keep", 0), reactive=MASK, last_reactive=MASK, keep=("th", "tw", 1))
