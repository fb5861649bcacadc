"""Motion of cells whose vectors were lost.

An estimate of motion goes on past the edges of what moves: beside a thing that has vectors, it
gives that thing's motion to the cells that lost theirs. Those cells are known, as the way there and
back does not end where it began. They get the motion of the lost cells around that are consistent.
"""

from __future__ import annotations

import numpy as np

from postfx.sampling import local_mean

FIRST_REACH_CELLS = 2
"""Cells around a cell in which others are looked for at first: then in twice as many, again and
again."""
ENOUGH = np.float32(0.1)
"""Share of the window's cells that must be known."""


def motion_of_lost(estimated: np.ndarray, consistent: np.ndarray,
                   is_lost: np.ndarray) -> np.ndarray:
    """Motion (rows, columns, 2) that is estimated, with that of consistent lost cells around where
    a lost cell's is not consistent.

    consistent: the same motion, NaN where it is not. is_lost: (rows, columns). Where no lost cell
    is consistent, the estimate stays.
    """
    is_known = is_lost & np.isfinite(consistent).all(-1)
    found = np.array(estimated, np.float32)
    is_open = is_lost & ~is_known
    if not is_known.any():
        return found
    weight = is_known[..., None].astype(np.float32)
    known = np.where(is_known[..., None], consistent, np.float32(0))
    radius = FIRST_REACH_CELLS
    while is_open.any() and radius < 2 * max(is_lost.shape):
        share = local_mean(weight, radius)
        mean = local_mean(known, radius) / np.maximum(share, np.float32(1e-6))
        is_filled = is_open & (share[..., 0] >= ENOUGH)
        found[is_filled] = mean[is_filled]
        is_open &= ~is_filled
        radius *= 2
    return found
