"""Paths: where the points of two frames are at a time between them. "Pixels" are those of the plane
of motion here, which may be coarser than the picture.

A path is a curve from a point's place in the frame before (time 0) to its place in the frame after
(time 1). Every pixel of both frames has one. A pixel of the frame after follows its motion back. A
pixel of the frame before follows that motion the other way; if the frame after hides the point, it
goes on as it came. If a frame further back or further ahead is known, paths are bent: Lagrange's
polynomial through three or four places.

`splat_paths` brings paths to a time. Of all that arrive at a pixel the nearest ones count, and
their mean is kept.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from postfx.caching import filled_array, new_array
from postfx.compiled.calls import whole
from postfx.compiled.library import Rows
from postfx.frame import DEPTH_MISS
from postfx.motion.camera import centre_positions, fit_camera
from postfx.system import in_bands
from postfx.temporal import reverse_motion
from postfx.temporal.reverse_motion import LOST  # noqa: F401  # it is paths.cu's

FAR = np.float32(1e30)
"""Stands for an unknown depth or a larger one."""
ALIKE = np.float32(0.04)
"""Relative difference in depth of paths that arrive at a pixel as one surface."""
SIMILAR = reverse_motion.ALIKE
"""Relative difference in depth of neighbours from whose motion a crack is filled where motion is
inverted."""
SEEN = np.float32(1)
"""Pixels by which motion to the other frame and back may miss for the point to be seen by both."""
SURE = np.float32(0.7)
"""Share of the paths that arrive at a cell that the other frame must see."""
COVERS = np.float32(0.9)
"""Depth that is seen over the depth of a point, below which something in front covers the point."""

FITTED_POINTS = 2000
"""Points that a camera is fitted to."""
LEAST_POINTS = 64
"""Points that the fit of a camera needs."""
FITTING = 0.4
"""Share of the points that the camera must explain."""

SPRUNG = np.float32(0.5)
"""Bend, as a share of the motion, from which a path is no curve but a jump and is taken as
straight."""
ROUND = np.float32(0.7)
"""Relative difference of the bends before and after, up to which a path is a curve in any case:
things that swing, or turn by 70 degrees a frame."""

EXACT = np.float32(0.05)
"""Pixels by which motion may differ from one pixel to the next, and there and back, before it
matters."""
ROUNDLY = np.float32(0.1)
"""Share of the motion by which the motion of the frame before or after may differ from that of a
thing that turns evenly."""
LEAST_COSINE = np.float32(0.2)
"""Least cosine of the angle by which a thing turns from frame to frame."""

# Kernels: postfx/kernels/interpolate/paths.cpp

_gather = Rows("gather_cells")
_rank = Rows("rank_paths")
_refine = Rows("refine_inverse")
_lead_back = Rows("lead_back")
_lead_ahead = Rows("lead_ahead")
_splat_nearest = Rows("splat_nearest")
_splat_means = Rows("splat_means")
_close_cracks = Rows("close_cracks")
_fill_holes = Rows("fill_holes")


@dataclass
class Paths:
    """Paths of one frame's pixels.

    Attributes:
        ends: (h, w, 4) float32: from the pixel to the point's place in the frame before (x, y) and
            in the one after.
        bend: (h, w, 2): half the second difference of the places, in pixels.
        depth: (h, w, 1): decides between paths that meet; the smaller one is in front.
        seen: (h, w): 1 where the other frame shows the point as well, else 0.
    """

    ends: np.ndarray
    bend: np.ndarray
    depth: np.ndarray
    seen: np.ndarray


def paths_of(motion: np.ndarray, ahead: np.ndarray, depth_before: np.ndarray,
             depth_after: np.ndarray,
             came: np.ndarray | None, goes: np.ndarray | None = None) -> tuple[Paths, Paths]:
    """Paths of the pixels of the frame before, and of those of the frame after.

    Args:
        motion: (h, w, 2) of the frame after: previous place minus this one, in pixels.
        ahead: likewise of the frame before, to the frame after; LOST where that hides a point.
        depth_before, depth_after: (h, w, 1), without NaN.
        came: motion of the frame before, from a frame further back; None without.
        goes: motion from the frame after to one further ahead, LOST where that hides a point; None
            without.
    """
    h, w = motion.shape[:2]
    first, last = (Paths(new_array((h, w, 4)), filled_array((h, w, 2), 0), depth, new_array((h, w)))
                   for depth in (depth_before, depth_after))
    none = np.zeros((0, 0, 2), np.float32)
    came, goes = none if came is None else came, none if goes is None else goes
    between = [whole(plane, np.float32)
               for plane in (motion, ahead, depth_before, depth_after, came)]
    in_bands(h,
             _lead_back.bind((*between, whole(goes, np.float32), last.ends, last.bend, last.seen)))
    in_bands(h, _lead_ahead.bind((*between, last.bend, first.ends, first.bend, first.seen)))
    return first, last


def splat_paths(paths: Paths, t: float) -> tuple[np.ndarray, np.ndarray]:
    """The path that arrives at each pixel at time t, and its depth.

    Returns (h, w, 8), the mean path of the nearest surface, NaN where none arrives: its ends, then
    the share of paths that the other frame sees; and (h, w), FAR where none arrives.
    """
    h, w = paths.seen.shape
    nearest, found, depth = filled_array((h, w), FAR), filled_array((h, w, 8), 0), new_array((h, w))
    moment, own_depth = np.array((t, t * (t - 1)), np.float32), whole(paths.depth, np.float32)
    _splat_nearest(0, h, paths.ends, paths.bend, own_depth, moment, nearest)
    _splat_means(0, h, paths.ends, paths.bend, own_depth, paths.seen, moment, nearest, found)
    _close_cracks(0, 1, nearest, found, depth)
    return found, depth


def gather_cells(motion: np.ndarray, depth: np.ndarray, scale: int, most: float,
                 grid: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    """Motion (rows, columns, 2), in cells, and depth (rows, columns, 1) of cells of one pixel or
    2x2: means of those of the nearest surface.

    Either plane (h, w, channels) may have one row, which stands for all. Motion beyond `most`
    pixels, out of any picture, becomes NaN; depth lies between 0 and a miss. scale: pixels of a
    cell. grid: rows and columns.
    """
    found = new_array((*grid, 2)), new_array((*grid, 1))
    planes = (whole(plane, np.float32) for plane in (motion, depth))
    _gather(0, grid[0], *planes, np.array((scale, most), np.float32), *found)
    return found


def rank_paths(one: np.ndarray, other: np.ndarray, motion: np.ndarray) -> np.ndarray:
    """Stands in for depth, (rows, columns, 1): a path that fits both pictures is in front of one
    that does not. 1 plus the difference of a grey picture (rows, columns) to another one where its
    motion leads; 2 where it leads out of the other one.
    """
    rank = np.empty((*one.shape, 1), np.float32)
    _rank(0, len(rank), one, other, whole(motion, np.float32), rank)
    return rank


def refine(motion: np.ndarray, inverse: np.ndarray) -> None:
    """Refine, in place, motion (rows, columns, 2) that was inverted for whole pixels, to the places
    between them whose motion leads back: one step of Newton's method, where motion is even."""
    in_bands(len(inverse), _refine.bind((whole(motion, np.float32), inverse)))


def motion_of_reflections(motion: np.ndarray, depth: np.ndarray, length: np.ndarray,
                          fov_x: float | None) -> np.ndarray:
    """Motion (h, w, 2) of what flat mirrors show; NaN where there is no mirror, all of it where no
    camera is found.

    A mirror's image lies along the view ray, as far behind the mirror as the reflected point is
    from it, and moves like any point at rest: as the camera that fits the motion of surfaces
    (`camera.fit_camera`).

    Args:
        motion, depth: (h, w, 2) and (h, w, 1).
        length: (h, w, 1) from a surface to what it reflects; 0 or less where there is nothing.
        fov_x: horizontal field of view in degrees, by which depth is told from distance; None if
            unknown.
    """
    h, w = depth.shape[:2]
    found = np.full((h, w, 2), np.nan, np.float32)
    is_mirror = (length[..., 0] > 0) & (depth[..., 0] < DEPTH_MISS)
    some = np.zeros((h, w), bool)
    step = max(1, round(math.sqrt(depth.size / FITTED_POINTS)))
    some[::step, ::step] = True
    rows, columns = np.nonzero(some & (depth[..., 0] < DEPTH_MISS) & np.isfinite(motion[..., 0]))
    if not is_mirror.any() or rows.size < LEAST_POINTS:
        return found
    median = float(np.median(depth[rows, columns]))
    now = centre_positions(rows, columns, h, w)
    camera, _, _, share = fit_camera(now, now[:, :2] + motion[rows, columns].astype(float) / w,
                                     median / depth[rows, columns, 0].astype(float), 1 / w)
    if share < FITTING:
        return found
    rows, columns = np.nonzero(is_mirror)
    now = centre_positions(rows, columns, h, w)
    ahead = (np.ones(rows.size) if not fov_x else 1
             / np.hypot(1, np.hypot(now[:, 0], now[:, 1]) * 2 * math.tan(math.radians(fov_x) / 2)))
    beyond = depth[rows, columns, 0] + length[rows, columns, 0].astype(float) * ahead
    place = np.append(camera[:8], 1).reshape(3, 3) @ now.T + camera[8:, None] * (median / beyond)
    found[rows, columns] = ((place[:2] / place[2]).T - now[:, :2]) * w
    return found


def fill_holes(field: np.ndarray, depth: np.ndarray) -> None:
    """Give cells (rows, columns, 8) without a path one from around, in place. Of the next cells to
    the left, to the right, above and below it is the farthest one's, as uncovered places show
    background. Without any, the cell stands still. depth: (rows, columns)."""
    _fill_holes(0, 1, whole(depth, np.float32), field)
