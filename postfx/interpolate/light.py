"""Light that changes from one frame to the next: flashes, fades, lamps that move or flicker.

Where only one of two frames shows a place, it would be as bright as there, in a patch. And paths
are compared by light, so that none fits. So the ratio of light of both frames is measured along the
motion, in blocks, as the median of its pixels. What stands around carries it to where it is not
known. Both frames are then brought to the light of the time that is asked for, the mean of theirs,
before anything is compared or mixed.
"""

from __future__ import annotations

import numpy as np

from postfx.colour import luminance
from postfx.motion.flow import consistent_motion, estimate_motion, middle_light
from postfx.sampling import local_mean

SHORTER = 96
"""Rows or columns that are looked at of a picture's shorter side."""
BLOCK_SIDE_CELLS = 8
"""Cells along the side of a block."""
LEAST_KNOWN = 12
"""Pixels of a block from which its ratio is known."""
CHANGED = 0.1
"""Natural logarithm of the ratio from which light is brought to the time, in a tenth of the
blocks."""
MOST_CARRIED_LOG = 4.0
"""Largest logarithm that is carried on."""
HALF_WEIGHT_SPREAD = 0.2
"""Spread of the logarithms in a block at which it counts half: a shadow that moves is no change of
its light."""
DARK_LIGHT_SHARE = 0.02
"""Part of the middle light: what is added to both before they are divided, and what is too dark to
tell."""
AROUND_PX = 8
"""Pixels each way over which light around is averaged."""

# Blocks over which the ratio is averaged, and the weight of the ratio of all of the picture
# there.
CARRIED_BLOCKS = 2
WHOLE_PICTURE_WEIGHT = 1e-3
"""Weight of the whole picture's change, which counts where no block near shows any."""


def change_of_light(before: np.ndarray, after: np.ndarray, motion: np.ndarray | None, longest: float
                    ) -> np.ndarray | None:
    """Natural logarithm of the later light over the earlier, (rows, columns, 3) of blocks spread
    over the picture; None where it hardly changes.

    before, after: (h, w, 3). motion: (h, w, 2) of the later picture, in pixels, or None, and it is
    estimated. longest: pixels beyond which a vector stands for none.
    """
    step = max(1, min(after.shape[:2]) // SHORTER)
    if motion is None:
        before = before[step // 2::step, step // 2::step]
        after = after[step // 2::step, step // 2::step]
        motion, step = _estimated(before, after), 1
    one, other, known = _pairs(before, after, motion, step, longest)
    dark = np.float32(DARK_LIGHT_SHARE * middle_light((before, after)))
    known &= luminance(np.maximum(one, other)) > dark
    ratio = np.log((np.maximum(other, 0) + dark) / (np.maximum(one, 0) + dark))
    if min(known.shape) < BLOCK_SIDE_CELLS:
        return None
    blocks, weight = _medians(ratio, known)
    if not (weight > 0).any():
        return None
    found = _carried(blocks, weight).clip(-MOST_CARRIED_LOG, MOST_CARRIED_LOG)
    return found if np.quantile(np.abs(found.mean(-1)), 0.9) > CHANGED else None


def lit_at(before: np.ndarray, after: np.ndarray, change: np.ndarray,
           t: float) -> tuple[np.ndarray, np.ndarray]:
    """Both pictures in the light of a time from 0 to 1."""
    ratio = np.exp(change)
    first, last = 1 - t + t * ratio, (1 - t) / ratio + t
    size = before.shape[:2]
    return before * enlarge_field(first, *size), after * enlarge_field(last, *size)


def _estimated(before: np.ndarray, after: np.ndarray) -> np.ndarray:
    """Motion of small pictures, NaN where it is not consistent, by their light in parts of that
    around."""
    light = [np.maximum(luminance(picture), 0)[..., None] + np.float32(1e-9)
             for picture in (before, after)]
    first, last = (np.sqrt(one / (one + local_mean(one, AROUND_PX)))[..., 0] for one in light)
    _, back = consistent_motion(estimate_motion(first, last), estimate_motion(last, first))
    return back


def _pairs(before: np.ndarray, after: np.ndarray, motion: np.ndarray, step: int, longest: float
           ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Every step-th pixel of the later picture: the earlier one where it was, itself, and whether
    that is known."""
    h, w = after.shape[:2]
    rows, columns = np.arange(step // 2, h, step), np.arange(step // 2, w, step)
    moved = motion[rows[:, None], columns]
    known = (np.abs(moved) <= longest).all(-1)
    moved = np.where(known[..., None], moved, 0)
    x = np.rint(columns + moved[..., 0]).astype(int)
    y = np.rint(rows[:, None] + moved[..., 1]).astype(int)
    known &= (x >= 0) & (x < w) & (y >= 0) & (y < h)
    return before[y.clip(0, h - 1), x.clip(0, w - 1)], after[rows[:, None], columns], known


def _medians(ratio: np.ndarray, known: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Medians (rows, columns, 3) over whole blocks of known pixels, and how much each counts (rows,
    columns, 1)."""
    rows, columns = known.shape[0] // BLOCK_SIDE_CELLS, known.shape[1] // BLOCK_SIDE_CELLS
    ratio = ratio[:rows * BLOCK_SIDE_CELLS, :columns * BLOCK_SIDE_CELLS]
    known = known[:rows * BLOCK_SIDE_CELLS, :columns * BLOCK_SIDE_CELLS, None]
    cells, is_known = (plane.reshape(rows, BLOCK_SIDE_CELLS, columns, BLOCK_SIDE_CELLS, -1)
                       .swapaxes(1, 2).reshape(rows, columns, BLOCK_SIDE_CELLS**2, -1)
                       for plane in (ratio, known))
    held = is_known[..., 0]
    cells = np.where(is_known, cells, np.nan)
    enough = held.sum(-1) >= LEAST_KNOWN
    cells[~enough] = 0
    middle = np.nanmedian(cells, 2)
    spread = np.nanmedian(np.abs(cells - middle[:, :, None]).mean(-1), 2)
    weight = enough / (1 + np.square(spread / HALF_WEIGHT_SPREAD))
    return middle, weight[..., None]


def _carried(blocks: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """Averages over blocks around, by weight; far from those that are known, that of the whole
    picture."""
    whole = np.median(blocks[weight[..., 0] > weight.max() / 2], 0)
    total = local_mean(weight, CARRIED_BLOCKS) + WHOLE_PICTURE_WEIGHT
    found: np.ndarray = (local_mean(blocks * weight, CARRIED_BLOCKS)
                         + WHOLE_PICTURE_WEIGHT * whole) / total
    return found


def enlarge_field(field: np.ndarray, height: int, width: int) -> np.ndarray:
    """A field (rows, columns, 3) of blocks of a picture, between their middles."""
    down, across = _between(field.shape[0], height), _between(field.shape[1], width)
    larger: np.ndarray = np.einsum("yr,rxc->yxc", down,
                                   np.einsum("xs,rsc->rxc", across, field)).astype(np.float32)
    return larger


def _between(count: int, size: int) -> np.ndarray:
    """Weights (size, count) of linear interpolation."""
    at = ((np.arange(size) + 0.5) * count / size - 0.5).clip(0, count - 1)
    weights: np.ndarray = np.maximum(1 - np.abs(at[:, None] - np.arange(count)), 0)
    return weights
