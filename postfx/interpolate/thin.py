"""Thin things whose vectors are wrong, where estimated motion is right: a wire whose vectors are
those of the wall behind it, or (1, 1) for "none"."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import partial

import numpy as np

from postfx.interpolate.ways import LED_CELLS, tone_light
from postfx.sampling import bilinear, is_inside, local_mean

COMPARED_PIXELS = 1
"""Pixels around one of a thin thing that are compared with it: motion seldom finds such things to a
pixel."""
MOST_MISFIT = np.float32(0.3)
"""Difference of toned light that a pixel counts with, at most."""
SURELY_RIGHT = 0.95
"""Misfit of vectors over that of estimated motion, up to which vectors alone count."""
SURELY_WRONG = 1.1
"""The same, from which estimated motion alone counts: 1.01 and more for wrong vectors of drawn
wires. Right ones may have more, too, along a wire; estimated motion is as good there."""
LEAST_FLOW_ERROR = 1e-6
"""Misfit that is divided by, at least."""
SIDE_CELLS = 3
"""Distance in cells from a thin thing at which the background is seen."""
STRAIGHT = ((0, 1), (1, 0))
"""Steps, down and to the right, to one side of a thing, and across."""
DIAGONAL = ((1, 1), (1, -1))
"""The same for things that lie diagonally."""
IN_FRONT = np.float32(0.9)
"""Depth of a thin thing over that of the background, at most."""
NEAREST = np.float32(1.05)
"""Depth of a thin thing's pixels over that of their cell, at most."""
MOST_APART_SHARE = 0.3
"""Share of the pixels at which vectors and estimated motion differ, from which the reason may be
other things than thin ones: 0.42 and more in six rendered sequences, up to 0.39 in drawn wires."""
MORE_SURELY = 4.0
"""How many times as large the ratios above must be then: up to 3.1 in those sequences, 6.1 and more
in drawn wires."""
MOST_THIN_CELLS = 64
"""Cells of thin things that are compared."""
AROUND_CELLS = 2
"""Cells around the way of a thin thing in which the picture along estimated motion counts."""
MOST_REACH_CELLS = 12
"""Length of such a way in cells, at most."""
LED_SHARE = 0.95
"""Share of a thing's cells that go no farther."""


@dataclass(frozen=True)
class ThinInputs:
    """Two frames in which thin things are looked for.

    Attributes:
        pictures: (h, w, 3) colours of the earlier and the later frame.
        level: light that is toned to about the middle.
        pixel_depth: (h, w, 1) depth of the later frame.
        motion: (rows, columns, 2) of the later frame's cells to the earlier frame, in cells; NaN
            without vectors.
        depths: (rows, columns, 1) of both frames' cells: depth of the nearest pixel.
        scale: pixels of a cell.
    """

    pictures: tuple[np.ndarray, np.ndarray]
    level: float
    pixel_depth: np.ndarray
    motion: np.ndarray
    depths: tuple[np.ndarray, np.ndarray]
    scale: int


def where_flow_is_right(seen: ThinInputs, ahead: np.ndarray, back: np.ndarray,
                        apart: float) -> np.ndarray | None:
    """How much the picture along estimated motion counts in place of the one along vectors, (rows,
    columns) in [0, 1]; None if it counts nowhere, or nothing is thin.

    ahead, back: estimated motion (rows, columns, 2) of the earlier and of the later frame to the
    other one, in cells. apart: share of the pixels at which vectors and `back` differ.
    """
    thin = _moving_thin(seen)
    if not thin.any():
        return None
    worse = _misfit_of_vectors(seen, back, thin) / (MORE_SURELY if apart > MOST_APART_SHARE else 1)
    share = min(max((worse - SURELY_RIGHT) / (SURELY_WRONG - SURELY_RIGHT), 0.0), 1.0)
    if not share:
        return None
    led = np.nan_to_num(np.abs(np.stack([seen.motion[thin], back[thin]]))).max(-1)
    reach = min(math.ceil(float(np.quantile(led, LED_SHARE))), MOST_REACH_CELLS) + AROUND_CELLS
    y, x = np.mgrid[:thin.shape[0], :thin.shape[1]].astype(np.float32)
    was = bilinear(thin.astype(np.float32), (x + ahead[..., 0]).ravel(),
                   (y + ahead[..., 1]).ravel()).reshape(x.shape) > 0.5
    near = (local_mean((thin | was)[..., None], reach) > 0).astype(np.float32)
    return np.float32(share) * local_mean(near, AROUND_CELLS)[..., 0]


def _misfit_of_vectors(seen: ThinInputs, back: np.ndarray, thin: np.ndarray) -> float:
    """Misfit of thin things along vectors over that along estimated motion; 0 if nothing tells.
    thin: marks their cells."""
    y, x = _pixels_of(seen, thin)
    cells = y // seen.scale, x // seen.scale
    before, after = seen.pictures
    places = [(x + seen.scale * way[cells][:, 0], y + seen.scale * way[cells][:, 1])
              for way in (seen.motion, back)]
    led = np.logical_and(*(is_inside(before, *place) for place in places))  # false for NaN
    if not led.any():
        return 0.0
    shown = partial(_around, level=seen.level)
    now = shown(after, x[led], y[led])
    given, flowing = (float(np.minimum(np.abs(shown(before, across[led], down[led]) - now),
                                       MOST_MISFIT).mean()) for across, down in places)
    worse: float = given / max(flowing, LEAST_FLOW_ERROR)
    return worse


def _pixels_of(seen: ThinInputs, thin: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rows and columns of the pixels of thin things: those that are nearer than others of their
    cells."""
    scale, (h, w) = seen.scale, seen.pixel_depth.shape[:2]
    rows, columns = np.nonzero(thin)
    step = 1 + len(rows) // MOST_THIN_CELLS
    rows, columns = rows[::step], columns[::step]
    down, across = (part.ravel()[:, None] for part in np.mgrid[:scale, :scale])
    y, x = (scale * rows + down).ravel(), (scale * columns + across).ravel()
    is_pixel = (y < h) & (x < w)
    y, x = y[is_pixel], x[is_pixel]
    nearest = seen.depths[1][y // scale, x // scale, 0]
    is_thin = seen.pixel_depth[y, x, 0] <= NEAREST * nearest
    return y[is_thin], x[is_thin]


def _around(picture: np.ndarray, x: np.ndarray, y: np.ndarray, level: float) -> np.ndarray:
    """Mean toned colours (count, 3) around places in a picture (h, w, 3)."""
    steps = np.arange(-COMPARED_PIXELS, COMPARED_PIXELS + 1, dtype=np.float32)
    down, across = (part.ravel()[:, None] for part in np.meshgrid(steps, steps))
    shown = bilinear(picture, (x + across).ravel(), (y + down).ravel(),
                     partial(tone_light, level=level))
    mean: np.ndarray = shown.reshape(down.size, len(x), -1).mean(0)
    return mean


def _moving_thin(seen: ThinInputs) -> np.ndarray:
    """Marks cells (rows, columns) of thin things, except those that stand still by vectors and by
    depth: estimated motion may follow a change of light there."""
    was, now = (depth[..., 0] for depth in seen.depths)
    thin = _is_thin(now)
    one, other = was[thin], now[thin]
    is_same_depth = (one >= IN_FRONT * other) & (other >= IN_FRONT * one)
    stands_still = np.abs(seen.motion[thin]).max(-1) <= LED_CELLS
    thin[thin] = ~(is_same_depth & stands_still)
    return thin


def _is_thin(depth: np.ndarray) -> np.ndarray:
    """Marks cells (rows, columns) in front of the background on two opposite sides. On the other
    two sides, background must be on both or on neither: at a corner, or at the end of a wire, it is
    on one."""
    behind, found = IN_FRONT * np.pad(depth, SIDE_CELLS, mode="edge"), np.zeros(depth.shape, bool)
    rows, columns = depth.shape

    def is_before(down: int, across: int) -> np.ndarray:
        side = behind[SIDE_CELLS * (1 + down):, SIDE_CELLS * (1 + across):]
        before: np.ndarray = depth < side[:rows, :columns]
        return before

    for ways in STRAIGHT, DIAGONAL:
        one, other = ((is_before(*way), is_before(-way[0], -way[1])) for way in ways)
        found |= one[0] & one[1] & (other[0] == other[1])
        found |= other[0] & other[1] & (one[0] == one[1])
    return found
