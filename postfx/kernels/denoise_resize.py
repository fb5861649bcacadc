"""Kernel that brings what a frame leaves to the next one to that one's render size."""

import numpy as np

from postfx.kernels.denoise_layout import HIDDEN, kernel
from postfx.kernels.numeric import compiled

ZERO, ONE, HALF = np.float32(0), np.float32(1), np.float32(0.5)
STATE = 4 + HIDDEN


@compiled
def resize_rows(y0, y1, state, last_depth, at_rows, at_columns, resized, resized_depth):
    """Bilinear at ``at_rows`` (height,) and ``at_columns`` (width,), edge repeated; depth of the nearest pixel.

    Pixels whose count is 0 hold nothing and do not count; where they are half of it, nothing is held.
    """
    h, w = state.shape[:2]
    share = np.empty(4, np.float32)
    for y in range(y0, y1):
        top = int(np.floor(at_rows[y]))
        ty = at_rows[y] - np.float32(top)
        upper, lower = min(max(top, 0), h - 1), min(max(top + 1, 0), h - 1)
        near_y = min(max(int(np.rint(at_rows[y])), 0), h - 1)
        for x in range(resized.shape[1]):
            first = int(np.floor(at_columns[x]))
            tx = at_columns[x] - np.float32(first)
            left, right = min(max(first, 0), w - 1), min(max(first + 1, 0), w - 1)
            resized_depth[y, x, 0] = last_depth[near_y, min(max(int(np.rint(at_columns[x])), 0), w - 1), 0]
            a, b, c, d = state[upper, left], state[upper, right], state[lower, left], state[lower, right]
            share[0] = (ONE - ty) * (ONE - tx) if a[3] > ZERO else ZERO
            share[1] = (ONE - ty) * tx if b[3] > ZERO else ZERO
            share[2] = ty * (ONE - tx) if c[3] > ZERO else ZERO
            share[3] = ty * tx if d[3] > ZERO else ZERO
            total = share[0] + share[1] + share[2] + share[3]
            scale = ONE / total if total > HALF else ZERO
            for k in range(STATE):
                value = share[0] * a[k] + share[1] * b[k] + share[2] * c[k] + share[3] * d[k]
                resized[y, x, k] = value * scale


RESIZE = kernel("resize", ("state", "last_depth", "at_rows", "at_columns"), ("resized", "resized_depth"),
                resize_rows, ("resized", 0), at_rows=("height",), at_columns=("width",),
                resized=("height", "width", STATE), resized_depth=("height", "width", 1))
