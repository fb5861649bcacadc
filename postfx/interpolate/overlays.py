"""Overlays, which lie over the scene and do not move as it does: found in pictures, taken out, and
told from pictures without them.
"""

from __future__ import annotations

import numpy as np

from postfx.compiled.calls import whole
from postfx.compiled.library import Rows
from postfx.sampling import local_sum

COVERED = 0.98
"""Coverage from which an overlay hides the picture."""

_find_overlay = Rows("find_overlay")
"""In postfx/kernels/interpolate/flow.cpp."""


def find_overlay(before: np.ndarray, after: np.ndarray, motion: np.ndarray, reach: int,
                 known: np.ndarray) -> None:
    """Mark as unknown, in `known` (h, w), what is drawn over both pictures (h, w, 3) and stands
    still while the scene behind it moves: its motion (h, w, 2) is half a pixel or more.

    Such pixels have the same bits in both frames and an edge beside them that has, too; `reach`
    pixels with the same bits around them belong to them.
    """
    planes = (whole(plane, np.float32) for plane in (before, after, motion))
    _find_overlay(0, 1, *planes, np.array([reach], np.float32), known)


def remove_overlay(colour: np.ndarray, overlay: np.ndarray) -> np.ndarray:
    """The picture under an overlay that was composited over it; black where nothing of it is
    left."""
    clear = 1 - overlay[..., 3:]
    picture = np.zeros_like(colour)
    np.divide(colour - overlay[..., :3], clear, out=picture, where=clear > 1 - COVERED)
    return picture


def measure_clearness(one: np.ndarray, other: np.ndarray, below: np.ndarray,
                      below_other: np.ndarray) -> np.ndarray:
    """How much of the picture an overlay lets through (h, w, 1), 0 to 1, by the difference of two
    frames with and without it: least squares of colour = overlay + clearness * picture over 5x5
    pixels, for an overlay that stands still. 1 where the picture does not change, as it makes no
    difference there."""
    change, seen = below_other - below, other - one
    product, square = (local_sum((change * by).sum(-1), 2) for by in (seen, change))
    clear = np.divide(product, square, out=np.ones_like(square), where=square > 0).clip(0, 1)
    still = (seen == 0).all(-1) & (change != 0).any(-1)
    clear[still] = 0  # to the pixel, where nothing comes through
    found: np.ndarray = clear[..., None]
    return found
