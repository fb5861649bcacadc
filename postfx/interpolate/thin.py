"""Thin things whose vectors lead nowhere right, where estimated motion does: a wire that has (1, 1)
for none, or its wall's vectors."""

from __future__ import annotations

import math

import numpy as np

from postfx.sampling import bilinear, is_inside, local_mean

COMPARED_CELLS = 1
"""Around a cell whose misfit is measured."""
LEAST_WRONG_MISFIT = np.float32(0.05)
"""Misfit of wrong vectors, in toned light, at least."""
FAR_OFF = np.float32(2)
"""The same, in that of estimated motion."""
LEADS_APART_CELLS = np.float32(0.5)
"""Cells by which both differ."""
SIDE_CELLS = 3
"""Cells beside a thin thing where what is behind it is seen."""
IN_FRONT = np.float32(0.9)
"""Depth of a thin thing, in that behind it, at most."""
MOST_APART_SHARE = 0.3
"""Share of the pixels at which vectors and estimated motion differ, up to which such things are
looked for: 0.42 and more in six rendered sequences, up to 0.29 of drawn wires."""
LEAST_WRONG_SHARE = 0.25
"""Share of the thin things' cells that must have wrong vectors: up to 0.1 at the edge of a disc
with right ones, 0.29 and more of wires with wrong ones."""
AROUND_CELLS = 2
"""Cells around all that such a thing may pass, in which the picture by estimated motion counts."""
MOST_REACH_CELLS = 12
"""Cells that it may pass."""
LED_SHARE = 0.95
"""Share of its cells that go no farther."""


def where_flow_is_right(small: tuple[np.ndarray, np.ndarray],
                        vectors: tuple[np.ndarray, np.ndarray],
                        estimated: tuple[np.ndarray, np.ndarray]) -> np.ndarray | None:
    """How much the picture by estimated motion counts in place of that by vectors, (rows, columns)
    in [0, 1]; None where it nowhere does.

    Args:
        small: grey pictures (rows, columns) of the earlier and the later frame, toned.
        vectors: of the later one, the motion (rows, columns, 2) to the earlier one in cells, NaN
            where there is none, and the depth (rows, columns, 1).
        estimated: motion of the earlier and of the later frame to the other one.
    """
    (before, after), (motion, depth), (ahead, back) = small, vectors, estimated
    thin = _is_thin(depth[..., 0])
    if not thin.any():
        return None
    y, x = np.mgrid[:after.shape[0], :after.shape[1]].astype(np.float32)
    along = _misfit(before, after, x + motion[..., 0], y + motion[..., 1])
    flowing = _misfit(before, after, x + back[..., 0], y + back[..., 1])
    apart = np.abs(motion - back).max(-1) > LEADS_APART_CELLS
    found = (thin & (along > LEAST_WRONG_MISFIT) & (along > FAR_OFF * flowing) & apart
             & is_inside(before, x + back[..., 0], y + back[..., 1]))
    if not found.any() or found.sum() < LEAST_WRONG_SHARE * thin.sum():
        return None
    led = np.abs(np.stack([motion[found], back[found]])).max(-1)
    reach = min(math.ceil(float(np.quantile(led, LED_SHARE))), MOST_REACH_CELLS) + AROUND_CELLS
    was = _at(found.astype(np.float32), x + ahead[..., 0], y + ahead[..., 1]) > 0.5
    near = (local_mean((found | was)[..., None], reach) > 0).astype(np.float32)
    return local_mean(near, AROUND_CELLS)[..., 0]


def _is_thin(depth: np.ndarray) -> np.ndarray:
    """Cells (rows, columns) in front of what is on both sides of them."""
    behind, found = IN_FRONT * np.pad(depth, SIDE_CELLS, mode="edge"), np.zeros(depth.shape, bool)
    rows, columns = depth.shape
    for down, across in ((0, 1), (1, 0), (1, 1), (1, -1)):
        sides = [behind[SIDE_CELLS * (1 + way * down):, SIDE_CELLS * (1 + way * across):]
                 for way in (1, -1)]
        found |= np.logical_and(*(depth < side[:rows, :columns] for side in sides))
    return found


def _at(plane: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Values of a plane (rows, columns) at places; at its edge where these are not known."""
    return bilinear(plane, np.nan_to_num(x).ravel(), np.nan_to_num(y).ravel()).reshape(x.shape)


def _misfit(before: np.ndarray, after: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Mean difference around each cell to what places (rows, columns) of the earlier frame show."""
    return local_mean(np.abs(_at(before, x, y) - after)[..., None], COMPARED_CELLS)[..., 0]
