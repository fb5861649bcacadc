"""Cameras: pixels, depth and positions in the world through a frame's matrices, and motion vectors
between two frames; jitter and exposure of a frame's samples.

Matrices are 4x4 for row vectors, as in `postfx.frame.Frame`: clip = [x, y, z, 1] @ world_to_clip.
Renderers with column vectors give the transposed ones. Clip space has x to the right and y up
within -w..w, and w is the distance along the view axis; z is never read, so any depth range will
do: reversed, 0..1 or -1..1, finite or infinite far plane. Pixel positions are (x, y) from the upper
left corner, x right, y down: the centre of the first pixel is (0.5, 0.5). Motion is previous minus
current position in pixels of this frame, x right, y down, without jitter. Positions are those of
the surface in the world, (height, width, 3). Results are float64; `Frame` stores planes as float32.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from postfx.errors import IntegrationError, offer
from postfx.exposure import measure
from postfx.frame import DEPTH_MISS
from postfx.spelling import takes_both_spellings

_SIGNED_AXES = {"+x": 0, "+y": 1, "+z": 2, "-x": 0, "-y": 1, "-z": 2}


def perspective(
    fov_x: float, width: int, height: int, right: str = "+x", up: str = "+y", forward: str = "-z",
    pixel_aspect: float = 1.0,
) -> np.ndarray:
    """Camera to clip space, (4, 4), of a pinhole camera whose renderer has no such matrix.

    fov_x: horizontal field of view in degrees, between 0 and 180. right, up, forward: the camera's
    own axes, such as "+x", "-x", "-z"; the defaults are those of OpenGL and Blender, pbrt has
    forward="+z", Mitsuba also right="-x". pixel_aspect: width of a pixel over its height. Clip z is
    1: reversed depth 1 / w, infinite far plane. IntegrationError for another angle or axes that do
    not span space.
    """
    if not 0 < fov_x < 180:
        raise IntegrationError(f"fov_x {fov_x}: give degrees between 0 and 180")
    axes = [_axis(name) for name in (right, up, forward)]
    if abs(np.linalg.det(axes)) < 1:
        raise IntegrationError(f"axes {right}, {up}, {forward}: give one of x, y, z each")
    x = 1 / math.tan(math.radians(fov_x) / 2)
    matrix = np.zeros((4, 4))
    matrix[:3, 0] = axes[0] * x
    matrix[:3, 1] = axes[1] * x * width / height * pixel_aspect
    matrix[:3, 3] = axes[2]
    matrix[3, 2] = 1
    return matrix


def with_jitter(projection: np.ndarray, jitter: Sequence[float], width: int,
                height: int) -> np.ndarray:
    """Projection, or world to clip, (4, 4), whose pixel centres lie `jitter` away from those of the
    given one.

    jitter: sample position minus 0.5, pixels, x right, y down: the header `postfx:jitter`. That
    position moves to the pixel's centre, so clip x loses 2 jitter_x / width times w, and y, which
    is up, gains 2 jitter_y / height.
    """
    matrix = np.array(projection, np.float64)
    matrix[:, 0] -= 2 * jitter[0] / width * matrix[:, 3]
    matrix[:, 1] += 2 * jitter[1] / height * matrix[:, 3]
    return matrix


def without_jitter(projection: np.ndarray, jitter: Sequence[float], width: int,
                   height: int) -> np.ndarray:
    """The inverse of `with_jitter`: the matrix to compute motion with, from the one that the
    renderer draws with."""
    return with_jitter(projection, (-jitter[0], -jitter[1]), width, height)


def pixel_positions(width: int, height: int, jitter: Sequence[float] = (0.0, 0.0)) -> np.ndarray:
    """Where the samples of each pixel lie: (height, width, 2), pixels from the upper left corner, x
    right, y down."""
    x, y = np.arange(width) + 0.5 + jitter[0], np.arange(height) + 0.5 + jitter[1]
    return np.stack(np.meshgrid(x, y), axis=-1)


def view_rays(
    width: int, height: int, world_to_clip: np.ndarray, jitter: Sequence[float] = (0.0, 0.0)
) -> tuple[np.ndarray, np.ndarray]:
    """Eye (3,) and directions (height, width, 3) in the world; eye + depth * direction is the point
    at that depth.

    Directions are 1 long along the view axis, not unit vectors. `world_to_clip` is without jitter;
    `jitter` is where the samples lie. Follows from clip = [x, y, z, 1] @ world_to_clip solved for
    the columns x, y and w. IntegrationError for a matrix that is not a perspective one.
    """
    matrix = np.asarray(world_to_clip, np.float64)
    columns = matrix[:, [0, 1, 3]] if matrix.shape == (4, 4) else np.zeros((4, 3))
    if abs(np.linalg.det(columns[:3])) < 1e-12 * np.abs(columns[:3]).max(initial=1e-30) ** 3:
        raise IntegrationError("world_to_clip is not a perspective matrix: give world_to_camera @ "
                               "projection, for row vectors")
    inverse = np.linalg.inv(columns[:3])
    position = pixel_positions(width, height, jitter)
    clip = np.stack(
        [2 * position[..., 0] / width - 1, 1 - 2 * position[..., 1] / height,
         np.ones((height, width))], axis=-1
    )
    return -columns[3] @ inverse, clip @ inverse


def positions_from_depth(
    depth: np.ndarray, world_to_clip: np.ndarray, jitter: Sequence[float] = (0.0, 0.0)
) -> np.ndarray:
    """Positions in the world, (height, width, 3), of a depth plane.

    depth: (height, width) or (height, width, 1), along the view axis; misses (1e10) give points
    that far away.
    """
    depth = as_plane(depth)
    eye, rays = view_rays(depth.shape[1], depth.shape[0], world_to_clip, jitter)
    result: np.ndarray = eye + depth[..., None] * rays
    return result


def project(points: np.ndarray, world_to_clip: np.ndarray, width: int, height: int) -> np.ndarray:
    """Pixel positions (..., 2) of points in the world.

    points: (..., 3), or (..., 4) with a last coordinate of 0 for directions, as of the sky. NaN for
    what lies in or behind the plane of the eye.
    """
    clip = _clip(points, world_to_clip)
    w = np.where(clip[..., 3] > 0, clip[..., 3], np.nan)
    return np.stack([(clip[..., 0] / w + 1) * width / 2, (1 - clip[..., 1] / w) * height / 2],
                    axis=-1)


def depth_of(points: np.ndarray, world_to_clip: np.ndarray) -> np.ndarray:
    """Depth plane (...,) of points (..., 3) in the world: along the view axis; 1e10 at most, also
    where not finite."""
    depth = _clip(points, world_to_clip)[..., 3]
    return np.where(np.isfinite(depth), np.minimum(depth, DEPTH_MISS), DEPTH_MISS)


def as_plane(values: np.ndarray) -> np.ndarray:
    """A plane of one channel, (height, width) or (height, width, 1), as (height, width) float64."""
    values = np.asarray(values, np.float64)
    plane = values[..., 0] if values.ndim == 3 and values.shape[2] == 1 else values
    if plane.ndim != 2:
        raise IntegrationError(f"plane has shape {values.shape}: give (height, width) or (height, "
                               "width, 1)")
    return plane


def _clip(points: np.ndarray, world_to_clip: np.ndarray) -> np.ndarray:
    points, matrix = np.asarray(points, np.float64), np.asarray(world_to_clip, np.float64)
    return points @ matrix if points.shape[-1] == 4 else points @ matrix[:3] + matrix[3]


def _axis(name: str) -> np.ndarray:
    if name not in _SIGNED_AXES:
        raise IntegrationError(f"axis '{name}': use {', '.join(_SIGNED_AXES)}")
    result: np.ndarray = np.eye(3)[_SIGNED_AXES[name]] * (-1 if name[0] == "-" else 1)
    return result


def halton(index: int, base: int) -> float:
    """Element `index` >= 1 of the Halton sequence in a base >= 2, within 0..1 (Halton 1960): digits
    mirrored."""
    if index < 0 or base < 2:
        raise IntegrationError(f"halton({index}, {base}): give an index from 0 and a base from 2")
    value, digit = 0.0, 1.0 / base
    while index:
        index, rest = divmod(index, base)
        value += rest * digit
        digit /= base
    return value


def jitter_length(scale: float) -> int:
    """Frames after which the jitter may repeat: 8 samples for each output pixel, 8 scale^2 rounded
    up."""
    return math.ceil(8 * scale * scale)


def jitter_sequence(count: int) -> np.ndarray:
    """Jitter (count, 2) in pixels, -0.5..0.5, x right, y down: Halton bases 2 and 3 from index 1,
    minus 0.5.

    All samples of frame k of a real-time renderer go through the pixel position 0.5 + jitter[k %
    count]; take `jitter_length(scale)` as count. A renderer that spreads its samples over the pixel
    has no jitter: write (0, 0).
    """
    return np.array([[halton(index, 2) - 0.5, halton(index, 3) - 0.5]
                     for index in range(1, count + 1)]).reshape(-1, 2)


@takes_both_spellings
def exposure_hint(colour: np.ndarray) -> float | None:
    """Stops that bring a picture to mid grey, for `Frame.exposure`; None for a black one.

    colour: (height, width, 3) scene-linear; measured as `postfx.exposure.measure` does. Hold it
    over a shot: take the first frame's, or the median of all.
    """
    return measure(np.ascontiguousarray(colour, np.float32))


def exposure_of_camera(f_number: float, shutter: float, iso: float = 100.0) -> float:
    """Stops for colours in cd/m^2, for `Frame.exposure`: luminance * 2 ** stops is 1 where the
    sensor saturates.

    shutter: seconds. The sensor saturates at 1.2 * 2^EV100 with EV100 = log2(f_number^2 / shutter *
    100 / iso) (ISO 12232, saturation-based speed; Lagarde and de Rousiers 2014, "Moving Frostbite
    to Physically Based Rendering"). IntegrationError unless all are positive.
    """
    if min(f_number, shutter, iso) <= 0:
        raise IntegrationError(f"f/{f_number:g}, {shutter:g} s, ISO {iso:g}: give positive numbers")
    return -math.log2(1.2 * f_number**2 / shutter * 100 / iso)


# Motion vectors.

OUT_OF_SIGHT = 4.0
"""Motion, in widths and heights of the picture, of points that were behind the camera: it leads far
outside."""

_MOTION_UNITS = ("pixels", "uv", "ndc")


def motion_from_depth(
    depth: np.ndarray, world_to_clip: np.ndarray, previous_world_to_clip: np.ndarray,
    jitter: Sequence[float] = (0.0, 0.0),
) -> np.ndarray:
    """Motion (height, width, 2) of a scene at rest under a moving camera.

    depth: (height, width) or (height, width, 1), along the view axis, misses 1e10. jitter: where
    the samples lie, minus 0.5, in pixels. Misses are infinitely far, so they move by the camera's
    rotation only.
    """
    depth = as_plane(depth)
    height, width = depth.shape
    eye, rays = view_rays(width, height, world_to_clip, jitter)
    missed = ~(depth < DEPTH_MISS)[..., None]
    points = np.where(missed, rays, eye + depth[..., None] * rays)
    before = project(np.concatenate([points, ~missed], axis=-1), previous_world_to_clip, width,
                     height)
    return _finite(before - pixel_positions(width, height, jitter))


def motion_from_positions(
    positions: np.ndarray, previous_positions: np.ndarray, world_to_clip: np.ndarray,
    previous_world_to_clip: np.ndarray,
) -> np.ndarray:
    """Motion (height, width, 2) of surfaces that moved: rigid, skinned or otherwise deformed.

    positions, previous_positions: (height, width, 3), of the same surface point now and then, or
    (height, width, 4) with a last coordinate of 0 where the ray hit nothing and the other three are
    its direction.
    """
    height, width = positions.shape[:2]
    now = project(positions, world_to_clip, width, height)
    return _finite(project(previous_positions, previous_world_to_clip, width, height) - now)


def rigid_previous_positions(
    positions: np.ndarray, ids: np.ndarray, to_world: Mapping[int, np.ndarray],
    previous_to_world: Mapping[int, np.ndarray],
) -> np.ndarray:
    """Where each surface point was in the frame before, (height, width, 3), by the transforms of
    its object.

    ids: (height, width) integers; to_world, previous_to_world: id -> object to world, (4, 4), row
    vectors, now and then. Ids in neither stay where they are. p_before = p @ inverse(to_world) @
    previous_to_world. IntegrationError when an id is in one of the two only.
    """
    unpaired = sorted(set(to_world) ^ set(previous_to_world))
    if unpaired:
        raise IntegrationError(f"object {unpaired[0]} has a transform in one frame only: give it "
                               "for both")
    before, ids = np.array(positions, np.float64), np.asarray(ids).reshape(positions.shape[:2])
    for identity, matrix in to_world.items():
        change = np.linalg.inv(matrix) @ previous_to_world[identity]
        inside = ids == identity
        before[inside] = before[inside] @ change[:3, :3] + change[3, :3]
    return before


def skinned_previous_positions(
    positions: np.ndarray, bones: np.ndarray, weights: np.ndarray, to_world: np.ndarray,
    previous_to_world: np.ndarray
) -> np.ndarray:
    """Where each point of a skinned surface was in the frame before, (height, width, 3).

    Linear blend skinning (Magnenat-Thalmann 1988): p = rest @ M, where M is the weighted sum of the
    bones' matrices; so p_before = p @ inverse(M) @ M_before, without the rest pose. bones: (height,
    width, k) indices of the bones that move the point; weights: (height, width, k), summing to 1,
    or to 0 where nothing is skinned, which stays. to_world, previous_to_world: (bones, 4, 4), rest
    pose to world, row vectors.
    """
    positions, weights = np.asarray(positions, np.float64), np.asarray(weights, np.float64)
    skinned = weights.sum(axis=-1) > 0.5
    blend = weights[skinned][..., None, None]
    now, then = ((np.asarray(each, np.float64)[bones[skinned]] * blend).sum(axis=1) for each in
                 (to_world, previous_to_world))
    change, before = np.linalg.solve(now, then), positions.copy()
    before[skinned] = (np.einsum("ni,nij->nj", positions[skinned], change[:, :3, :3])
                       + change[:, 3, :3])
    return before


def dejitter_motion(motion: np.ndarray, jitter: Sequence[float],
                    previous_jitter: Sequence[float]) -> np.ndarray:
    """Motion (height, width, 2) without jitter, from one computed with the jittered matrices of
    both frames.

    motion: previous minus current, pixels, y down. A jittered matrix moves the picture by -jitter,
    so previous minus current is off by jitter - previous_jitter, which is taken away.
    """
    return np.asarray(motion, np.float64) + (np.asarray(previous_jitter, np.float64)
                                             - np.asarray(jitter, np.float64))


def motion_in_pixels(
    motion: np.ndarray, unit: str = "pixels", y_up: bool = False, from_previous: bool = False,
    encoded: bool = False
) -> np.ndarray:
    """Motion (height, width, 2) in postfx's convention from another one.

    unit: "pixels" of the frame, "uv" (1 is the whole width or height) or "ndc" (2 is). y_up:
    whether y grows upwards. from_previous: whether it leads from the previous position to the
    current one instead of back; it must be stored at the current position. (Motion from the current
    to the next frame cannot be converted: its values belong to other pixels.)
    encoded: stored as 0.5 + 0.5 * value, in 0..1. IntegrationError for another unit.
    """
    if unit not in _MOTION_UNITS:
        raise IntegrationError(f"motion unit '{unit}'{offer(unit, _MOTION_UNITS)}")
    motion = np.asarray(motion, np.float64)
    motion = 2 * motion - 1 if encoded else motion
    height, width = motion.shape[:2]
    size = {"pixels": (1, 1), "uv": (width, height), "ndc": (width / 2, height / 2)}[unit]
    return motion * (np.array(size) * (1, -1 if y_up else 1) * (-1 if from_previous else 1))


def _finite(motion: np.ndarray) -> np.ndarray:
    height, width = motion.shape[:2]
    unseen = np.isnan(motion).any(axis=-1, keepdims=True)
    most = OUT_OF_SIGHT * np.array([width, height])
    return np.where(unseen, most, np.clip(motion, -most, most))
