"""The picture of a time between two frames, made of their planes along the chosen paths.

Each pixel is taken from both frames, weighted by time, or from the one that shows its point. Where
the four cells around it follow one path, the path is interpolated between them; elsewhere the pixel
is the mean over their paths (overlapped block motion compensation; Orchard and Sullivan 1994).
Pictures are sampled by cubics, which keep detail where both frames show the same, and average over
noise where they do not.

Cells are (rows, columns, 8) float32: a path as in `choose`, the share k of its detail that both
frames show, and 0.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from postfx.caching import new_array
from postfx.compiled.library import Rows
from postfx.frame import Role
from postfx.interpolate.choose import OTHER  # noqa: F401  # it is blend.cu's
from postfx.system import in_bands

LEAST = np.float32(1e-4)
"""Weight of a frame that does not show a point, so that something is there where none does."""
LITTLE = np.float32(1e-3)
"""Weight below which a frame does not count."""

ALIKE = np.float32(0.05**2)
"""Squared relative difference of both frames from which a path counts less beside others."""
UNSURE = np.float32(0.2)
"""Value that stands for it where only one frame shows a point."""
TINY = np.float32(1e-6)
"""Light below which nothing counts."""

NEARER = np.float32(0.1)
"""Relative difference in depth from which two paths are of two surfaces."""
HIDDEN = np.float32(0.2)
"""Share that a path keeps if another one hides it."""

CRISP = np.float32(0.97)
"""Share of detail that both frames show, from which a cell keeps all of it, up to the middles of
its neighbours: light does not leak over an edge."""

ELSE = np.float32(100)
"""How many times brighter a place is in one frame than in the other if only one shows it."""
DARK = np.float32(0.05)
"""Light over the middle light, summed over channels, up to which a place counts as dark there."""

Pair: TypeAlias = tuple[np.ndarray, np.ndarray]
"""A plane of both frames."""


def stack_planes(planes: list[np.ndarray], size: tuple[int, ...]) -> np.ndarray:
    """All channels (h, w, n) of planes of this size, of which there may be none."""
    if len(planes) == 1:
        return np.ascontiguousarray(planes[0], np.float32)
    return (np.concatenate(planes, -1, dtype=np.float32) if planes
            else np.empty((*size, 0), np.float32))


def split_planes(stack: np.ndarray, group: dict[Role | str, Pair]) -> dict[Role | str, np.ndarray]:
    """The planes in a stack of them."""
    ends = np.cumsum([pair[0].shape[2] for pair in group.values()])
    return {key: stack[..., end - pair[0].shape[2]:end]
            for (key, pair), end in zip(group.items(), ends, strict=True)}


# Kernels: postfx/kernels/interpolate/blend.cpp

_join = Rows("join_cells")
_compose = Rows("compose")


def join_cells(cells: np.ndarray) -> None:
    """Mark cells (rows, columns, 8) that follow one path with those to the right and below by 1,
    and by 2 where it changes evenly, as on what turns: their last number."""
    in_bands(len(cells), _join.bind((cells,)))


@dataclass(frozen=True)
class PairPlanes:
    """Planes of both frames, of which the ones between are made.

    Attributes:
        pictures: (h, w, 3) colours.
        known: (h, w) bool: where the frames show the scene, and not an overlay.
        depth: (h, w, 1), or empty.
        light: (h, w, n) of what is mixed as colours are: alpha, reflectances.
        data: (h, w, m) of what is taken from one frame's nearest pixel: depth, normals, ids.
    """

    pictures: Pair
    known: Pair
    depth: Pair
    light: Pair
    data: Pair


@dataclass(frozen=True)
class Mixture:
    """How planes are mixed.

    Attributes:
        time: 0 to 1.
        scale: pixels of a cell.
        level: light in the middle between dark and bright.
        masked: whether anything is not known.
        back: weights of the ways to the frame before and to the one after, whose sum is the
            motion.
    """

    time: float
    scale: int
    level: float
    masked: bool
    back: tuple[float, float]


def compose(cells: np.ndarray, planes: PairPlanes, mixture: Mixture,
            has_motion: bool) -> tuple[np.ndarray, ...]:
    """The planes between: colour (h, w, 3), light (h, w, n), data (h, w, m), and motion (h, w, 2)
    in pixels, which is empty where it is not asked for.

    Light is mixed, data is that of the nearest pixel in the frame that counts more. cells: (rows,
    columns, 8).
    """
    h, w = planes.pictures[0].shape[:2]
    made = [new_array(pair[0].shape) for pair in (planes.pictures, planes.light, planes.data)]
    made.append(new_array((h, w, 2) if has_motion else (0, 0, 2)))
    numbers = (mixture.time, mixture.scale, DARK * np.float32(mixture.level), mixture.masked,
               *mixture.back)
    given = [plane
             for pair in (planes.pictures, planes.known, planes.depth, planes.light, planes.data)
             for plane in pair]
    in_bands(h, _compose.bind((cells, *given, np.array(numbers, np.float32), *made)))
    return tuple(made)
