"""Motion estimated from the planes of two frames, for files without motion vectors.

Albedo and normal do not depend on the light, so they make pictures that optical flow can follow.
Where there is depth, nearly everything moves as the camera does: a point (x, y, 1) at depth z was
at H (x, y, 1) + e / z (Hartley and Zisserman, Multiple View Geometry, 2nd edition, 13.4). H and e
are fitted to the flow, then to the pictures themselves (direct alignment: Baker and Matthews 2004,
"Lucas-Kanade 20 Years On"), which is exact to a fraction of a pixel. The flow is kept where it
explains the pictures clearly better: things that move.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from postfx.compiled.calls import whole
from postfx.compiled.library import Rows
from postfx.errors import FrameError
from postfx.frame import DEPTH_MISS, Frame, Role
from postfx.motion import MOTION_SOURCES
from postfx.motion.camera import camera_equations, centre_positions, fit_camera
from postfx.motion.flow import consistent_motion, enlarge_motion, estimate_motion
from postfx.system import usable_cores
from postfx.workers import Workers

MOST_SIDE_PX = 640
"""Pixels of a picture's longer side; larger frames are halved, or taken in thirds, and so on."""

# Pixels that a motion is fitted to, about this many and no fewer than that; those that it is then
# aligned by, and how often.
_FITTED_POINTS = 2000
_FEWEST_FITTED_POINTS = 64
_ALIGNED_POINTS = 4000
_ALIGNING_ROUNDS = 5

# Least share of points that the fit must explain, and the most of the picture's own contrast that
# it may leave.
_FITTING = 0.4
_RELATED = 0.5
# What a thing that moves must leave of the camera's misfit, and by how much less.
_BETTER = np.float32(0.6)
_LESS = np.float32(0.02)
# A camera is at rest where that leaves at most this share of what its motion leaves; flow alone
# follows noise, too.
_AS_WELL = 1.02, 1.25


class Picture(NamedTuple):
    """What motion is estimated from.

    Attributes:
        values: (h, w) float32 of albedo and normal, smoothed a little.
        step: pixels of the frame along a side of one of these.
        size: height and width of the frame.
        jitter: of the frame, in its pixels.
    """

    values: np.ndarray
    step: int
    size: tuple[int, int]
    jitter: tuple[float, float]


def picture_of(frame: Frame) -> Picture | None:
    """The picture of a frame that has the plane diffuse_albedo or normal; None without both."""
    albedo, normal = (frame.planes.get(role) for role in MOTION_SOURCES)
    held = albedo if albedo is not None else normal
    if held is None:
        return None
    height, width = held.shape[:2]
    step = math.ceil(max(height, width) / MOST_SIDE_PX)
    means = np.empty((-(-height // step), -(-width // step)), np.float32)
    planes = (np.zeros((1, 1, 3)) if plane is None else plane for plane in (albedo, normal))
    _shade(0, len(means), *(whole(plane, np.float32) for plane in planes),
           np.array([step], np.float32), means)
    values = np.empty_like(means)
    _smooth(0, len(values), means, values)
    return Picture(values, step, (height, width), frame.jitter)


def motion_of(frame: Frame, before: Frame | None) -> np.ndarray:
    """Motion (height, width, 2) of a frame after another, by `motion_between`. FrameError without
    albedo and normal."""
    picture = picture_of(frame)
    if picture is None:
        raise FrameError(f"{frame.source or 'frame'}: motion cannot be estimated without one of "
                         f"the AOVs {', '.join(MOTION_SOURCES)}: render them")
    return motion_between(None if before is None else picture_of(before), picture,
                          frame.planes.get(Role.DEPTH))


def motion_between(before: Picture | None, after: Picture, depth: np.ndarray | None) -> np.ndarray:
    """Motion (height, width, 2) of a frame: previous place minus this one, in pixels; x right, y
    down, no jitter.

    before: of the frame before it. depth: (height, width, 1) of this one, along the view axis,
    misses 1e10; without it all motion is the flow. Zero where the camera is at rest, where the
    frames are of different scenes or sizes, and where there is no frame before.
    """
    height, width = after.size
    still = np.zeros((height, width, 2), np.float32)
    if before is None or before.size != after.size or min(after.values.shape) < 2:
        return still
    one, other, step = after.values, before.values, after.step
    # jitter moves the pictures, but is no part of motion
    jitter = np.subtract(after.jitter, before.jitter).astype(np.float32)
    rest = np.broadcast_to(jitter / step, (*one.shape, 2)).astype(np.float32)
    at_rest = _misfit(one, other, rest)
    if not at_rest.any():
        return still
    with Workers(min(2, usable_cores())) as threads:
        flow, back = threads.map(estimate_motion, (one, other), (other, one))
    by_flow = _misfit(one, other, flow)
    found = None if depth is None else _camera(one, other, consistent_motion(flow, back)[0], depth,
                                               step)
    if found is not None:
        assert depth is not None
        camera_misfit = _misfit(one, other, found.move(depth, step, np.zeros(2), one.shape))
        moves = by_flow + _LESS < _BETTER * camera_misfit
        best_misfit = np.where(moves, by_flow, camera_misfit)
    else:
        moves, best_misfit = np.ones(one.shape, bool), by_flow
    if best_misfit.mean() > _RELATED * np.abs(one - one.mean()).mean():
        return still
    if at_rest.mean() <= _AS_WELL[found is None] * best_misfit.mean():
        return still
    if found is None:
        motion = _enlarge(flow, step, height, width)
        return np.ascontiguousarray(motion - jitter, np.float32)
    assert depth is not None
    motion = found.move(depth, 1, jitter, (height, width))
    if moves.any():
        _put(0, height, flow, moves, np.array((step, *jitter), np.float32), motion)
    return motion


def _enlarge(flow: np.ndarray, step: int, height: int, width: int) -> np.ndarray:
    rows, columns = flow.shape[:2]
    return enlarge_motion(flow, rows * step, columns * step)[:height, :width]


def _camera(one: np.ndarray, other: np.ndarray, flow: np.ndarray, depth: np.ndarray, step: int
            ) -> _Camera | None:
    """The camera's motion; None where nothing fits."""
    height, width = depth.shape[:2]
    middles = [np.minimum(np.arange(count) * step + step // 2, side - 1)
               for count, side in zip(one.shape, (height, width), strict=True)]
    near_plane = depth[..., 0][np.ix_(*middles)]
    hit = (near_plane > 0) & (near_plane < DEPTH_MISS)
    thin = max(1, round(math.sqrt(one.size / _FITTED_POINTS)))
    some = np.zeros(one.shape, bool)
    some[::thin, ::thin] = True
    rows, columns = np.nonzero(some & hit & np.isfinite(flow[..., 0]))
    if rows.size < _FEWEST_FITTED_POINTS:
        return None
    median = float(np.median(near_plane[rows, columns]))
    whole = max(width, 1) / step  # width of the frame in pixels of the picture
    shape = (height / step, whole)
    now = centre_positions(rows, columns, *shape)
    near = median / near_plane[rows, columns].astype(np.float64)
    found, _, _, share = fit_camera(now,
                                    now[:, :2] + flow[rows, columns].astype(np.float64) / whole,
                                    near, 1 / whole)
    if share < _FITTING:
        return None
    near = np.where(hit, median / np.where(hit, near_plane, 1), 0)
    return _Camera(_align(one, other, found, near, shape).astype(np.float32), np.float32(median))


def _align(one: np.ndarray, other: np.ndarray, found: np.ndarray, near: np.ndarray,
           shape: tuple[float, float]) -> np.ndarray:
    """H and e that make the pictures fit best, from ones that are nearly right: Gauss-Newton steps
    with little weight for pixels that do not fit."""
    down, right = np.gradient(one)
    slope = np.hypot(down, right)
    slope[:2], slope[-2:], slope[:, :2], slope[:, -2:] = 0, 0, 0, 0
    slope[near == 0] = 0  # misses may be fog, or glass, whose planes move like something nearer
    rows, columns = np.nonzero(slope > max(2 * float(np.median(slope)), 0.01))
    if rows.size < _FEWEST_FITTED_POINTS:
        return found
    every = max(1, rows.size // _ALIGNED_POINTS)
    rows, columns = rows[::every], columns[::every]
    now, close = centre_positions(rows, columns, *shape), near[rows, columns].astype(np.float64)
    value, g_x, g_y = (plane[rows, columns].astype(np.float64) for plane in (one, right, down))
    there, best, least, scale = np.empty((rows.size, 3), np.float32), found, math.inf, 0.0
    for _ in range(_ALIGNING_ROUNDS + 1):
        place = np.append(found[:8], 1).reshape(3, 3) @ now.T + found[8:, None] * close
        before = (place[:2] / place[2]).T
        places = before.T[::-1] * shape[1] + np.array([[shape[0]], [shape[1]]]) / 2 - 0.5
        _sample(0, len(there), other, whole(places, np.float64), there)
        inside = np.isfinite(there[:, 0])
        if inside.sum() < _FEWEST_FITTED_POINTS:
            break
        # mean slope of both pictures (Malis 2004), which converges faster than one of them alone
        x, y = (g_x + there[:, 1]) / 2, (g_y + there[:, 2]) / 2
        errors = np.where(inside, there[:, 0] - value, 0)
        typical = max(float(np.median(np.abs(errors[inside]))), 1e-4)
        scale = scale or 3 * typical
        total = float((1 - 1 / (1 + (errors[inside] / scale) ** 2)).mean())  # of Geman and McClure
        if total < least:
            best, least = found, total
        weights = inside * (1 + (errors / (3 * typical)) ** 2) ** -2
        sides = camera_equations(now, before, close).reshape(2, -1, 11)
        across = (x[:, None] * np.where(inside[:, None], sides[0], 0)
                  + y[:, None] * np.where(inside[:, None], sides[1], 0)) * shape[1]
        weighted = across * weights[:, None]
        normal = weighted.T @ across
        normal += 1e-6 * np.trace(normal) / 11 * np.eye(11)
        found = found - np.linalg.solve(normal, weighted.T @ errors)
    return best


def _misfit(one: np.ndarray, other: np.ndarray, motion: np.ndarray) -> np.ndarray:
    """(h, w) mean difference of the pictures around each pixel under a motion; points out of the
    picture count as 0."""
    apart = np.empty_like(one)
    around = np.empty_like(one)
    across = np.empty(one.shape[::-1], np.float32)
    _differ(0, len(one), one, other, whole(motion, np.float32), apart)
    _average(0, len(apart), apart, across)
    _average(0, len(across), across, around)
    return around


# Kernels: postfx/kernels/interpolate/estimated_motion.cpp

_shade = Rows("estimate_shade")
_smooth = Rows("estimate_smooth")
_differ = Rows("estimate_differ")
_average = Rows("estimate_average")
_sample = Rows("estimate_sample")
_move = Rows("estimate_move")
_put = Rows("estimate_put")


class _Camera(NamedTuple):
    """Motion of a camera: H and e (11,), and the depth that e is in units of."""

    numbers: np.ndarray
    median: np.float32

    def move(self, depth: np.ndarray, step: int, jitter: np.ndarray,
             shape: tuple[int, int]) -> np.ndarray:
        """Motion (*shape, 2) in pixels of a picture that has one for `step` x `step` of the depth
        (height, width, 1). jitter: (2,), what is taken off it."""
        motion = np.empty((*shape, 2), np.float32)
        numbers = np.array((*self.numbers, self.median, step, *jitter), np.float32)
        _move(0, len(motion), numbers, whole(depth, np.float32), motion)
        return motion
