"""Motion vectors: previous minus current position in pixels of this frame, x right, y down, without jitter.

Matrices are 4x4 for row vectors and without jitter, see `postfx.integrate.camera`. Positions are those of the surface
in the world, (height, width, 3).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from postfx.errors import IntegrationError
from postfx.frame import DEPTH_MISS
from postfx.integrate.camera import as_plane, pixel_positions, project, view_rays

OUT_OF_SIGHT = 4.0
"""Motion, in widths and heights of the picture, of points that were behind the camera: it leads far outside."""

_UNITS = ("pixels", "uv", "ndc")


def motion_from_depth(
    depth: np.ndarray, world_to_clip: np.ndarray, previous_world_to_clip: np.ndarray,
    jitter: Sequence[float] = (0.0, 0.0),
) -> np.ndarray:
    """Motion (height, width, 2) of a scene at rest under a moving camera.

    depth: (height, width) or (height, width, 1), along the view axis, misses 1e10. jitter: where the samples lie,
    minus 0.5, in pixels. Misses are infinitely far, so they move by the camera's rotation only.
    """
    depth = as_plane(depth)
    height, width = depth.shape
    eye, rays = view_rays(width, height, world_to_clip, jitter)
    missed = ~(depth < DEPTH_MISS)[..., None]
    points = np.where(missed, rays, eye + depth[..., None] * rays)
    before = project(np.concatenate([points, ~missed], axis=-1), previous_world_to_clip, width, height)
    return _finite(before - pixel_positions(width, height, jitter))


def motion_from_positions(
    positions: np.ndarray, previous_positions: np.ndarray, world_to_clip: np.ndarray,
    previous_world_to_clip: np.ndarray,
) -> np.ndarray:
    """Motion (height, width, 2) of surfaces that moved: rigid, skinned or otherwise deformed.

    positions, previous_positions: (height, width, 3), of the same surface point now and then, or (height, width, 4)
    with a last coordinate of 0 where the ray hit nothing and the other three are its direction.
    """
    height, width = positions.shape[:2]
    now = project(positions, world_to_clip, width, height)
    return _finite(project(previous_positions, previous_world_to_clip, width, height) - now)


def rigid_previous_positions(
    positions: np.ndarray, ids: np.ndarray, to_world: Mapping[int, np.ndarray],
    previous_to_world: Mapping[int, np.ndarray],
) -> np.ndarray:
    """Where each surface point was in the frame before, (height, width, 3), by the transforms of its object.

    ids: (height, width) integers; to_world, previous_to_world: id -> object to world, (4, 4), row vectors, now and
    then. Ids in neither stay where they are. p_before = p @ inverse(to_world) @ previous_to_world. IntegrationError
    when an id is in one of the two only.
    """
    unpaired = sorted(set(to_world) ^ set(previous_to_world))
    if unpaired:
        raise IntegrationError(f"object {unpaired[0]} has a transform in one frame only: give it for both")
    before, ids = np.array(positions, np.float64), np.asarray(ids).reshape(positions.shape[:2])
    for identity, matrix in to_world.items():
        change = np.linalg.inv(matrix) @ previous_to_world[identity]
        inside = ids == identity
        before[inside] = before[inside] @ change[:3, :3] + change[3, :3]
    return before


def skinned_previous_positions(
    positions: np.ndarray, bones: np.ndarray, weights: np.ndarray, to_world: np.ndarray, previous_to_world: np.ndarray
) -> np.ndarray:
    """Where each point of a skinned surface was in the frame before, (height, width, 3).

    Linear blend skinning (Magnenat-Thalmann 1988): p = rest @ M, where M is the weighted sum of the bones' matrices;
    so p_before = p @ inverse(M) @ M_before, without the rest pose. bones: (height, width, k) indices of the bones that
    move the point; weights: (height, width, k), summing to 1, or to 0 where nothing is skinned, which stays. to_world,
    previous_to_world: (bones, 4, 4), rest pose to world, row vectors.
    """
    positions, weights = np.asarray(positions, np.float64), np.asarray(weights, np.float64)
    skinned = weights.sum(axis=-1) > 0.5
    blend = weights[skinned][..., None, None]
    now, then = ((np.asarray(each, np.float64)[bones[skinned]] * blend).sum(axis=1) for each in
                 (to_world, previous_to_world))
    change, before = np.linalg.solve(now, then), positions.copy()
    before[skinned] = np.einsum("ni,nij->nj", positions[skinned], change[:, :3, :3]) + change[:, 3, :3]
    return before


def dejitter_motion(motion: np.ndarray, jitter: Sequence[float], previous_jitter: Sequence[float]) -> np.ndarray:
    """Motion (height, width, 2) without jitter, from one computed with the jittered matrices of both frames.

    motion: previous minus current, pixels, y down. A jittered matrix moves the picture by -jitter, so previous minus
    current is off by jitter - previous_jitter, which is taken away.
    """
    return np.asarray(motion, np.float64) + (np.asarray(previous_jitter, np.float64) - np.asarray(jitter, np.float64))


def motion_in_pixels(
    motion: np.ndarray, unit: str = "pixels", y_up: bool = False, from_previous: bool = False, encoded: bool = False
) -> np.ndarray:
    """Motion (height, width, 2) in postfx's convention from another one.

    unit: "pixels" of the frame, "uv" (1 is the whole width or height) or "ndc" (2 is). y_up: whether y grows upwards.
    from_previous: whether it leads from the previous position to the current one instead of back; it must be stored at
    the current position. (Motion from the current to the next frame cannot be converted: its values belong to other
    pixels.)
    encoded: stored as 0.5 + 0.5 * value, in 0..1. IntegrationError for another unit.
    """
    if unit not in _UNITS:
        raise IntegrationError(f"motion unit '{unit}': use {', '.join(_UNITS)}")
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
