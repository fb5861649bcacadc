"""Which path shows what is at a cell between two frames.

Cells are squares of pixels. `choose_paths` compares what a path shows in both frames, over 8x6
pixels of toned grey pictures around a cell. A cell keeps the path that arrived at it unless a
neighbour's, or the flow's, agrees much better: edges of planes are coarse, averaged over samples or
noisy. A path that only one frame shows cannot be compared; it counts as a fair match, for it is
there by geometry.

Fields of paths are (rows, columns, 6) float32: in pixels of the pictures from the cell to its place
in the frame before (x, y) and in the one after (x, y), and whether each of the two shows the point,
0 or 1. NaN: no path.
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
"""How many times as well another path must fit to be taken; one of a cell beside, by the misfit of
noise more."""

# Pixels below which a path stands still, and how much better another one must fit than that: it
# is compared between pixels, where noise is averaged.
STILL = np.float32(0.01)
BETTER_STILL = np.float32(4)

# What stands for the misfit of a path that cannot be compared: a part that is fixed, and a
# multiple of the noise's.
UNSEEN = np.float32(0.12)
UNSEEN_NOISE = np.float32(2)

TRUSTED = np.float32(0.5)
"""Share of that misfit below which a path that was thought unseen is seen after all."""

# Change of the way from frame to frame along a pixel from which windows show different things,
# and pixels by which it may be uneven from cell to cell.
TWIST = np.float32(0.15)
EVEN = np.float32(0.5)

BEFORE = np.float32(0.85)
"""Share of the depth of what lies behind a thing that keeps its cell if both frames show it
there."""
ONE_THING = np.float32(0.7)
"""Share of the difference to what lies behind it up to which a thing in front may differ from frame
to frame."""
MOSTLY = np.float32(0.4)
"""Share of detail from which what stands still is left as it is."""
APART = np.float32(0.15)
"""Misfit from which what stands still must be something else."""
JOINED = np.float32(0.6)
"""Pixels by which paths of cells beside each other may differ for there to be others between
them."""

# The same where paths change evenly from cell to cell, and how much that change itself may
# change.
TURNING = np.float32(3)
SMOOTH = np.float32(0.25)

RED = np.float32(0.2126)
GREEN = np.float32(0.7152)
BLUE = np.float32(0.0722)
LUMINANCE = np.array([RED, GREEN, BLUE])
"""Shares of channels in how bright a colour is (BT.709)."""
TAPER = (0.25, 0.75, 1.0, 1.0, 1.0, 1.0, 0.75, 0.25)
"""Weights of the eight pixels of a row."""

# Slopes that are summed up in a window, and the square of a slope that noise makes at most, in
# squares of the noise: even noise of Gauss makes pi between pixels. What differs by more is no
# noise.
SLOPES = np.float32((2 * ROWS - 1) * sum(TAPER))
MOST_NOISE = np.float32(4)

COUNT = np.float32(ROWS * sum(TAPER))



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
    """The nearer path of both sides at each cell (rows, columns, 8), or their mean where they are
    alike; NaN without. The last two numbers are left. scale: pixels of a cell."""
    own = new_array(arrived.before.shape)
    in_bands(len(own), _merge.bind((*arrived.planes, np.array([scale], np.float32), own)))
    return own


def measure_change(arrived: Arrived, scale: int, own: np.ndarray) -> None:
    """How much both sides' paths differ from a cell's own one, and that from those to the right and
    below, in pixels: its last two numbers. own: (rows, columns, 8)."""
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
    """How sharp the pictures are at cells (rows, columns, 8), which are joined, measured once for
    two by two that follow one path: the last but one of their numbers, 0 to 1. noise: misfit of
    paths that are right."""
    planes = (toned.before, toned.after, toned.known_before, toned.known_before)
    in_bands(len(cells),
             _detail.bind((*planes, np.array((0, toned.scale, noise), np.float32), cells)))


def measure_misfits(toned: Toned, side: Paths) -> np.ndarray:
    """Misfit of one of 4x4 cells of the frame after, whose paths these are, that the frame before
    shows too; -1 elsewhere."""
    found = np.empty([length // 4 for length in side.seen.shape], np.float32)
    _misfits(0, len(found), *toned.planes, side.ends, side.seen,
             np.array([toned.scale], np.float32), found)
    return found
