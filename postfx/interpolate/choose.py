"""Which of the paths that meet at a cell, between two frames, shows what is there.

Cells are squares of pixels. `choose_paths` compares what a path shows in both frames, over 8x6
pixels of toned grey pictures around a cell. A cell keeps the path that arrived at it unless a
neighbour's path, or the flow's, agrees much better: edges of planes are coarse, averaged over
samples, or noisy. A path that only one frame shows cannot be compared. It counts as a fair match,
as geometry says that it is there.

Fields of paths are (rows, columns, 6) float32: from the cell to its place in the frame before (x,
y) and in the one after (x, y), in pixels of the pictures, and whether each of the two shows the
point, 0 or 1. NaN: no path.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from postfx.caching import new_array
from postfx.compiled.calls import whole
from postfx.compiled.library import Rows
from postfx.interpolate.paths import FAR, Paths  # noqa: F401  # FAR is choose.cu's
from postfx.system import in_bands

MARGIN = 8
"""Pixels around a picture whose paths are compared: its edges, repeated."""
ROWS = 6
"""Rows of eight pixels that are compared."""
OTHER = np.float32(0.3)
"""Pixels by which paths must differ to be worth a comparison."""
BETTER = np.float32(1.5)
"""How many times better another path must fit to be taken. A neighbour's must also be better by the
misfit of noise."""

STILL = np.float32(0.01)
"""Length of a path, in pixels, below which it stands still."""
BETTER_STILL = np.float32(4)
"""How many times better another path must fit than one that stands still: others are compared
between pixels, where noise is averaged."""

# Misfit that a path counts with if it cannot be compared: the sum of both.
UNSEEN = np.float32(0.12)
"""A part that is fixed."""
UNSEEN_NOISE = np.float32(2)
"""A multiple of the misfit of noise."""

TRUSTED = np.float32(0.5)
"""Share of that misfit below which a path that seemed hidden is seen after all."""

TWIST = np.float32(0.15)
"""Change of the way from pixel to pixel from which windows in both frames show different things."""
EVEN = np.float32(0.5)
"""Pixels by which that change may differ from cell to cell."""

BEFORE = np.float32(0.85)
"""Depth of a thing over that of the background, up to which the thing keeps its cell if both frames
show it there."""
ONE_THING = np.float32(0.7)
"""How much a thing in front may differ from frame to frame, as a share of its difference to the
background."""
MOSTLY = np.float32(0.4)
"""Share of detail from which a cell that stands still keeps its path."""
APART = np.float32(0.15)
"""Misfit from which a cell that stands still must show something else."""
JOINED = np.float32(0.6)
"""Pixels by which paths of neighbouring cells may differ for pixels between them to have paths
between theirs."""

TURNING = np.float32(3)
"""The same where paths change evenly from cell to cell."""
SMOOTH = np.float32(0.25)
"""How much that change may itself change, in pixels."""

RED = np.float32(0.2126)
GREEN = np.float32(0.7152)
BLUE = np.float32(0.0722)
LUMINANCE = np.array([RED, GREEN, BLUE])
"""Shares of channels in how bright a colour is (BT.709)."""
TAPER = (0.25, 0.75, 1.0, 1.0, 1.0, 1.0, 0.75, 0.25)
"""Weights of the eight pixels of a row."""

SLOPES = np.float32((2 * ROWS - 1) * sum(TAPER))
"""Sum of the weights of the slopes in a window."""
MOST_NOISE = np.float32(4)
"""Square of a slope over the square of the noise, above which it is no noise. Gaussian noise makes
pi between pixels."""
COUNT = np.float32(ROWS * sum(TAPER))
"""Sum of the weights of the pixels in a window."""

# Kernels: postfx/kernels/interpolate/choose.cpp

_merge = Rows("merge_sides")
_change = Rows("measure_change")
_choose = Rows("choose_paths")
_detail = Rows("measure_detail")
_misfits = Rows("measure_misfits")


@dataclass(frozen=True)
class Toned:
    """Two grey pictures by which paths are compared.

    Attributes:
        before, after: (h + 2 MARGIN, w + 2 MARGIN) float32 of the range 0 to 1, edges repeated.
        known_before, known_after: (h, w) bool, False under overlays.
        scale: pixels along a side of a cell, 1 or 2.
    """

    before: np.ndarray
    after: np.ndarray
    known_before: np.ndarray
    known_after: np.ndarray
    scale: int

    @property
    def planes(self) -> tuple[np.ndarray, ...]:
        """What kernels take."""
        return self.before, self.after, self.known_before, self.known_after


@dataclass(frozen=True)
class Arrived:
    """Paths of both frames that arrived at cells at a time, as `paths.splat_paths` gives them.

    Attributes:
        before, after: (rows, columns, 8) paths, in cells, NaN without.
        depth_before, depth_after: (rows, columns), `paths.FAR` without.
    """

    before: np.ndarray
    after: np.ndarray
    depth_before: np.ndarray
    depth_after: np.ndarray

    @property
    def planes(self) -> tuple[np.ndarray, ...]:
        """What kernels take."""
        return self.before, self.after, self.depth_before, self.depth_after


@dataclass(frozen=True)
class Flows:
    """Other motion that may lead to a cell; any of these may be empty (0, 0, 2).

    Attributes:
        ahead, back: (rows, columns, 2) flow of both frames to the other one at the time, in pixels.
        mirrored: motion of what the frame after reflects, to the one before.
    """

    ahead: np.ndarray
    back: np.ndarray
    mirrored: np.ndarray


def merge_sides(arrived: Arrived, scale: int) -> np.ndarray:
    """The nearer of the paths of both sides at each cell (rows, columns, 8), or their mean where
    they are alike; NaN without. The last two numbers are not set. scale: pixels of a cell."""
    own = new_array(arrived.before.shape)
    in_bands(len(own), _merge.bind((*arrived.planes, np.array([scale], np.float32), own)))
    return own


def measure_change(arrived: Arrived, scale: int, own: np.ndarray) -> None:
    """Measure, in pixels, how much the paths of both sides differ from a cell's own one, and how
    much that one differs from those to the right and below: the last two numbers of `own` (rows,
    columns, 8)."""
    in_bands(len(own),
             _change.bind((arrived.before, arrived.after, np.array([scale], np.float32), own)))


def choose_paths(toned: Toned, own: np.ndarray, arrived: Arrived, flows: Flows,
                 sides: Sequence[Paths], numbers: tuple[float, float]) -> np.ndarray:
    """The path of each cell (rows, columns, 8): its own, or another one around it or of the flow
    that fits much better; the last two numbers are left.

    Args:
        own: (rows, columns, 8), as `measure_change` leaves it.
        sides: paths of the pixels of the frame before and of the one after, for flows.
        numbers: the time, 0 to 1, and the misfit of paths that are right, which is noise.
    """
    cells = new_array(own.shape)
    time, noise = numbers
    seen = [plane for name in ("ends", "seen") for plane in (getattr(side, name) for side in sides)]
    depth = [whole(side.depth[..., 0], np.float32) for side in sides]
    leading = (whole(flow, np.float32) for flow in (flows.ahead, flows.back, flows.mirrored))
    in_bands(len(own), _choose.bind((*toned.planes, own, *arrived.planes, *leading, *seen, *depth,
                                     np.array((time, toned.scale, noise), np.float32), cells)))
    return cells


def measure_detail(toned: Toned, noise: float, cells: np.ndarray) -> None:
    """Measure how sharp the pictures are at cells (rows, columns, 8), 0 to 1: the last but one of
    their numbers. Two by two cells that follow one path are measured once, so cells must be joined
    before (`blend.join_cells`). noise: misfit of paths that are right."""
    planes = (toned.before, toned.after, toned.known_before, toned.known_before)
    in_bands(len(cells),
             _detail.bind((*planes, np.array((0, toned.scale, noise), np.float32), cells)))


def measure_misfits(toned: Toned, side: Paths) -> np.ndarray:
    """Misfit of the paths of one in 4x4 cells, (rows / 4, columns / 4); -1 where the other frame
    does not show the point. side: paths of the frame after."""
    found = np.empty([length // 4 for length in side.seen.shape], np.float32)
    _misfits(0, len(found), *toned.planes, side.ends, side.seen,
             np.array([toned.scale], np.float32), found)
    return found
