"""Whether planes are in the right place: edges of one frame's planes coincide, and blocks move as
their vectors say.

Planes of one frame show the same outlines. A plane whose outlines fit another frame better, or fit
when it is flipped or moved, was written to the wrong place. Where a block of the previous frame
does not fit after its vectors moved it, but fits after one more step, the vectors belong to
something else than the block shows.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from postfx.doctor import blocks, finite, largest
from postfx.frame import ALBEDOS, DEPTH_MISS, Frame, Role
from postfx.sampling import bilinear, is_inside, local_mean

ALIGNED_PLANES = (*ALBEDOS, Role.NORMAL, Role.ROUGHNESS, Role.DEPTH, Role.MOTION)
ALIGNING_GUIDES = (*ALBEDOS, Role.NORMAL)
WINDOW_SIDE_PX = 512
"""Of a larger picture only the middle is examined: this many pixels wide and high at most."""
STRONGEST_QUANTILE = 0.98
"""Edges that are stronger count as this strong."""
ALIGNED_BLOCK_PX = 8
STEP_REACH_PX = 8
"""Pixels each way that a block is moved by beyond its vectors."""
MOST_ALIGNED_BLOCKS = 48
"""Blocks that are moved, the worst ones."""

# A block fits badly when its error is at least this many times the median, and at least this
# large.
MISFIT_RATIO = 4.0
LEAST_MISFIT = 0.04

FITTING_ERROR_SHARE = 0.4
"""Share of a block's error that may remain after the right step."""

# Pixels by which steps may differ: between blocks of one object, and among the steps that fit one
# block.
ALIKE_STEPS_PX = 1
CERTAIN_STEPS_PX = 3

FLIPS: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "upside down": lambda edges: edges[::-1],
    "mirrored left to right": lambda edges: edges[:, ::-1],
    "turned by 180 degrees": lambda edges: edges[::-1, ::-1],
}


class Placement(NamedTuple):
    """Correlations of a plane's edges with the edges of the other planes.

    Attributes:
        at: indices of the frames in which the plane has edges.
        own: mean correlation within its own frame.
        frames: (frames, frames) correlations of the other planes of a frame (row) with the plane of
            another (column).
        flips: mean correlation within its own frame when the plane is flipped, by the name of the
            flip.
    """

    at: list[int]
    own: float
    frames: np.ndarray
    flips: dict[str, float]


class Mover(NamedTuple):
    """An object that does not move as its vectors say: its place, the missing step in pixels, its
    number of blocks."""

    x: int
    y: int
    step: tuple[int, int]
    blocks: int


def compare_edges(frames: Sequence[Frame]) -> dict[Role, Placement]:
    """How each plane's edges coincide with the others' edges; needs frames of one size with at
    least two planes."""
    edges = [_edges_of_planes(frame) for frame in frames]
    roles = dict.fromkeys(role for found in edges for role in found)
    placements = {role: _placement(edges, role) for role in roles}
    return {role: placement for role, placement in placements.items() if placement}


def _edges_of_planes(frame: Frame) -> dict[Role, np.ndarray]:
    """`_edges` of the planes that have any."""
    found = {}
    for role in (*ALIGNED_PLANES, Role.COLOUR):
        edges = _edges(_window(frame[role]), role) if role in frame else None
        if edges is not None:
            found[role] = edges
    return found


def find_movers(before: Frame, now: Frame) -> list[Mover]:
    """Objects with the vectors of something else, the largest first; found by albedos and normals,
    which hold no shadows."""
    roles = [role for role in ALIGNING_GUIDES if role in before and role in now]
    if (not roles or Role.MOTION not in now
        or min(now.spec.width, now.spec.height) < 4 * ALIGNED_BLOCK_PX):
        return []
    old, new = (np.concatenate([_window(finite(frame[role])) for role in roles], -1)
                for frame in (before, now))
    motion = _window(finite(now[Role.MOTION])) + np.float32(np.subtract(now.jitter, before.jitter))
    steps = np.array([(right, down) for down in range(-STEP_REACH_PX, STEP_REACH_PX + 1)
                      for right in range(-STEP_REACH_PX, STEP_REACH_PX + 1)])
    found = []
    for row, column in _bad_blocks(old, new, motion):
        errors = _step_errors(old, new, motion, row, column, steps.astype(np.float32))
        fitting = steps[errors < FITTING_ERROR_SHARE * errors[len(steps) // 2]]
        best = steps[errors.argmin()]
        # where steps far apart fit, any step along an edge would do
        if len(fitting) and np.abs(fitting - best).max() <= CERTAIN_STEPS_PX:
            found.append((column * ALIGNED_BLOCK_PX, row * ALIGNED_BLOCK_PX, int(best[0]),
                          int(best[1])))
    return _cluster(found)


def _window(plane: np.ndarray) -> np.ndarray:
    """The middle of a plane, at most `WINDOW_SIDE_PX` high and wide."""
    height, width = plane.shape[:2]
    top, left = max(0, height - WINDOW_SIDE_PX) // 2, max(0, width - WINDOW_SIDE_PX) // 2
    return plane[top : top + WINDOW_SIDE_PX, left : left + WINDOW_SIDE_PX]


def _edges(plane: np.ndarray, role: Role) -> np.ndarray | None:
    """Strength of the edges, scaled to mean 0 and length 1; None for a plane without edges."""
    if min(plane.shape[:2]) < 8:
        return None
    if role is Role.DEPTH:
        plane = np.log(np.clip(np.nan_to_num(plane, nan=DEPTH_MISS), 1e-3, 1e4))
    elif role is Role.COLOUR:
        light = local_mean(np.maximum(finite(plane), 0).mean(2, keepdims=True), 1)
        plane = local_mean(np.log(light / max(float(light.mean()), 1e-6) + np.float32(1e-2)), 1)
    plane = np.clip(finite(plane), -1e4, 1e4)
    strength = (largest(np.abs(np.diff(plane, axis=1)))[:-1]
                + largest(np.abs(np.diff(plane, axis=0)))[:, :-1])
    top = float(np.quantile(strength, STRONGEST_QUANTILE))
    if top < 1e-6:
        return None
    strength = np.minimum(strength / np.float32(top), 1)
    strength -= strength.mean()
    length = float(np.linalg.norm(strength))
    result: np.ndarray = strength / np.float32(length)
    return result if length > 1e-3 else None


def _placement(edges: list[dict[Role, np.ndarray]], role: Role) -> Placement | None:
    """How a plane's edges coincide with those of the others, without the colour's; None where no
    frame has both. edges: of the planes of each frame."""
    at = [number for number, found in enumerate(edges)
          if role in found and found.keys() - {role, Role.COLOUR}]
    if not at:
        return None
    others = []
    for number in at:
        planes = [plane for name, plane in edges[number].items() if name not in (role, Role.COLOUR)]
        others.append(_normalise(np.sum(planes, axis=0)))
    own = [edges[number][role] for number in at]
    table = np.array([[float(np.vdot(other, plane)) for plane in own] for other in others])
    flips = {name: float(np.mean([np.vdot(other, flip(plane))
                                  for other, plane in zip(others, own, strict=True)]))
             for name, flip in FLIPS.items()}
    return Placement(at, float(np.mean(np.diag(table))), table, flips)


def _normalise(edges: np.ndarray) -> np.ndarray:
    result: np.ndarray = edges / max(float(np.linalg.norm(edges)), 1e-6)
    return result


def _bad_blocks(old: np.ndarray, new: np.ndarray, motion: np.ndarray) -> list[tuple[int, int]]:
    """(row, column) of blocks that fit worse than most, the worst first."""
    rows, columns = np.indices(new.shape[:2])
    x, y = columns.astype(np.float32) + motion[..., 0], rows.astype(np.float32) + motion[..., 1]
    apart = largest(np.abs(bilinear(old, x.ravel(), y.ravel()).reshape(new.shape) - new))
    errors = blocks(np.where(is_inside(old, x, y), apart, 0), ALIGNED_BLOCK_PX)
    least = max(MISFIT_RATIO * float(np.median(errors)), LEAST_MISFIT)
    bad = np.argwhere(errors > least)
    worst = np.argsort(-errors[bad[:, 0], bad[:, 1]])[:MOST_ALIGNED_BLOCKS]
    return [(int(row), int(column)) for row, column in bad[worst]]


def _step_errors(old: np.ndarray, new: np.ndarray, motion: np.ndarray, row: int, column: int,
                 steps: np.ndarray) -> np.ndarray:
    """(steps,): mean error of every other pixel of a block after each further step (x, y)."""
    part = (slice(row * ALIGNED_BLOCK_PX, (row + 1) * ALIGNED_BLOCK_PX, 2),
            slice(column * ALIGNED_BLOCK_PX, (column + 1) * ALIGNED_BLOCK_PX, 2))
    y, x = np.mgrid[part].astype(np.float32)
    places = np.stack([x, y], -1).reshape(-1, 2) + motion[part].reshape(-1, 2) + steps[:, None]
    values = bilinear(old, places[..., 0].ravel(), places[..., 1].ravel())
    apart = largest(np.abs(values.reshape(*places.shape[:2], -1)
                           - new[part].reshape(-1, new.shape[2])))
    result: np.ndarray = apart.mean(1)
    return result


def _cluster(found: list[tuple[int, int, int, int]]) -> list[Mover]:
    """Group blocks (x, y, step x, step y) that take the same step into objects."""
    rest = np.array(found, int).reshape(-1, 4)
    things = []
    while len(rest):
        near = [(np.abs(rest[:, 2:] - step) <= ALIKE_STEPS_PX).all(1) for step in rest[:, 2:]]
        members = max(near, key=np.sum)
        x, y, right, down = np.median(rest[members], axis=0).astype(int)
        things.append(Mover(int(x), int(y), (int(right), int(down)), int(members.sum())))
        rest = rest[~members]
    return [thing for thing in things if thing.step != (0, 0)]
