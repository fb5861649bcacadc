"""Overlays, which lie over the scene and do not move as it does: found in pictures, taken out, and told from pictures
without them.
"""

from __future__ import annotations

import numpy as np

from postfx.kernels.numeric import compiled, inline
from postfx.sampling import local_sum

COVERED = 0.98
"""Coverage from which an overlay hides the picture."""


@compiled
def find_overlay(before: np.ndarray, after: np.ndarray, motion: np.ndarray, reach: int, known: np.ndarray) -> None:
    """Mark as unknown what is drawn over both pictures and stands still while the scene behind it moves.

    Such pixels have the same bits in both frames and an edge beside them that has, too, and their motion is half a
    pixel or more; `reach` pixels with the same bits around them belong to them.
    """
    h, w = known.shape
    steps = np.full((h, w), -1, np.int32)
    queue = np.empty((h * w, 2), np.int64)
    head, tail = 0, 0
    for y in range(h):
        for x in range(w):
            if not (is_same(before, after, y, x) and abs(motion[y, x, 0]) + abs(motion[y, x, 1]) >= 0.5):
                continue
            for j, i in ((y, x + 1), (y + 1, x), (y, x - 1), (y - 1, x)):
                if 0 <= j < h and 0 <= i < w and is_same(before, after, j, i) and steps[y, x] < 0:
                    edge = False
                    for c in range(3):
                        size = abs(before[y, x, c]) + abs(before[j, i, c])
                        edge = edge or abs(before[y, x, c] - before[j, i, c]) > np.float32(0.02) * size
                    if edge:
                        steps[y, x] = 0
                        queue[tail, 0], queue[tail, 1] = y, x
                        tail += 1
    while head < tail:
        y, x = queue[head, 0], queue[head, 1]
        head += 1
        known[y, x] = False
        if steps[y, x] >= reach:
            continue
        for j, i in ((y, x + 1), (y + 1, x), (y, x - 1), (y - 1, x)):
            if 0 <= j < h and 0 <= i < w and steps[j, i] < 0 and is_same(before, after, j, i):
                steps[j, i] = steps[y, x] + 1
                queue[tail, 0], queue[tail, 1] = j, i
                tail += 1


@inline
def is_same(before: np.ndarray, after: np.ndarray, y: int, x: int) -> bool:
    """Whether a pixel has the same colour in both frames."""
    return bool(before[y, x, 0] == after[y, x, 0] and before[y, x, 1] == after[y, x, 1]
                and before[y, x, 2] == after[y, x, 2])


def remove_overlay(colour: np.ndarray, overlay: np.ndarray) -> np.ndarray:
    """The picture under an overlay that was composited over it; black where nothing of it is left."""
    clear = 1 - overlay[..., 3:]
    picture = np.zeros_like(colour)
    np.divide(colour - overlay[..., :3], clear, out=picture, where=clear > 1 - COVERED)
    return picture


def measure_clearness(one: np.ndarray, other: np.ndarray, below: np.ndarray, below_other: np.ndarray) -> np.ndarray:
    """How much of the picture an overlay lets through (h, w, 1), 0 to 1, by the difference of two frames with and
    without it: least squares of colour = overlay + clearness * picture over 5x5 pixels, for an overlay that stands
    still. 1 where the picture does not change, as it makes no difference there."""
    change, seen = below_other - below, other - one
    product, square = (local_sum((change * by).sum(-1), 2) for by in (seen, change))
    clear = np.divide(product, square, out=np.ones_like(square), where=square > 0).clip(0, 1)
    still = (seen == 0).all(-1) & (change != 0).any(-1)
    clear[still] = 0  # to the pixel, where nothing comes through
    found: np.ndarray = clear[..., None]
    return found
