"""Depth as renderers store it, to and from the distance along the view axis; and normals between
spaces."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from postfx.errors import DepthError
from postfx.frame import DEPTH_MISS


def depth_from_device(
    device: np.ndarray, near: float, far: float = math.inf, reversed_z: bool = False,
    signed: bool = False
) -> np.ndarray:
    """Depth along the view axis from a depth buffer; any shape; values on the far plane are misses,
    1e10.

    device: 0 at the near plane and 1 at the far plane, the other way round with reversed_z, or
    -1..1 (OpenGL's normalised device coordinates) with signed. near, far: distances of the planes,
    0 < near < far, far may be infinite. With v = 1 at the near plane and 0 at the far plane, 1 /
    depth = 1 / far + v (1 / near - 1 / far). DepthError for other planes.
    """
    inverse_near, inverse_far = _inverse_planes(near, far)
    value = np.asarray(device, np.float64)
    value = (value + 1) / 2 if signed else value
    nearness = value if reversed_z else 1 - value
    missed = ~(nearness > 0)
    depth = 1 / np.where(missed, 1, inverse_far + nearness * (inverse_near - inverse_far))
    return np.where(missed, DEPTH_MISS, depth)


def depth_to_device(
    depth: np.ndarray, near: float, far: float = math.inf, reversed_z: bool = False,
    signed: bool = False
) -> np.ndarray:
    """The inverse of `depth_from_device`; misses come out on the far plane."""
    inverse_near, inverse_far = _inverse_planes(near, far)
    depth = np.asarray(depth, np.float64)
    nearness = (1 / depth - inverse_far) / (inverse_near - inverse_far)
    nearness = np.where(depth < DEPTH_MISS, np.clip(nearness, 0, 1), 0)
    value = nearness if reversed_z else 1 - nearness
    return 2 * value - 1 if signed else value


def depth_from_normalised(normalised: np.ndarray, near: float, far: float,
                          reversed_z: bool = False) -> np.ndarray:
    """Depth along the view axis from one that is linear between a near (0) and a far plane (1); any
    shape.

    With reversed_z, 1 is near and 0 far. What lies on the far plane or beyond is a miss, 1e10. near
    may be 0 here; DepthError unless 0 <= near < far < infinity.
    """
    if not 0 <= near < far < math.inf:
        raise DepthError(f"near {near:g} and far {far:g}: normalised depth needs 0 <= near < far < "
                         "infinity")
    value = np.asarray(normalised, np.float64)
    value = 1 - value if reversed_z else value
    return np.where(value < 1, near + value * (far - near), DEPTH_MISS)


def depth_from_ray(
    distance: np.ndarray, fov_x: float, jitter: Sequence[float] = (0.0, 0.0),
    pixel_aspect: float = 1.0, first: int = 0, height: int | None = None,
) -> np.ndarray:
    """Depth along the view axis from the distance to the eye; misses (1e10 and more, not finite)
    become 1e10.

    distance: (height, width) or (height, width, 1). fov_x: horizontal field of view in degrees, the
    view axis in the middle of the picture. jitter: sample position minus 0.5, pixels. Of a frame of
    another `height` these are the rows from the `first` on. depth = distance * cosine to the view
    axis. DepthError for an angle outside 0..180.
    """
    distance = np.asarray(distance, np.float64)
    hit = np.isfinite(distance) & (distance < DEPTH_MISS)
    cosines = _cosines(distance.shape, fov_x, jitter, pixel_aspect, first, height)
    return np.where(hit, distance * cosines, DEPTH_MISS)


def ray_from_depth(
    depth: np.ndarray, fov_x: float, jitter: Sequence[float] = (0.0, 0.0), pixel_aspect: float = 1.0
) -> np.ndarray:
    """The inverse of `depth_from_ray`: distance to the eye; misses stay 1e10."""
    depth = np.asarray(depth, np.float64)
    return np.where(depth < DEPTH_MISS, depth / _cosines(depth.shape, fov_x, jitter, pixel_aspect),
                    DEPTH_MISS)


def ray_slopes(
    columns: np.ndarray, rows: np.ndarray, size: tuple[int, int], fov_x: float,
    jitter: Sequence[float] = (0.0, 0.0), pixel_aspect: float = 1.0,
) -> tuple[np.ndarray, np.ndarray]:
    """How far the rays of pixels go to the right and down, each as `columns` and `rows`, on 1 along
    the view axis.

    size: width and height of the frame; the rest is as for `depth_from_ray`.
    """
    width, height = size
    step = 2 * math.tan(math.radians(fov_x) / 2) / width
    x = (columns + 0.5 + jitter[0] - width / 2) * step
    return x, (rows + 0.5 + jitter[1] - height / 2) * step / pixel_aspect


def depth_with_misses(depth: np.ndarray, miss: float) -> np.ndarray:
    """Depth, any shape, whose pixels of the value `miss`, and those that are not finite, become
    1e10."""
    depth = np.asarray(depth, np.float64)
    return np.where(np.isfinite(depth) & (depth != miss), np.minimum(depth, DEPTH_MISS), DEPTH_MISS)


def normals_to_world(normals: np.ndarray, world_to_camera: np.ndarray) -> np.ndarray:
    """World-space normals (..., 3) from normals along the camera's axes.

    world_to_camera: (4, 4), row vectors, of rotation, uniform scale and shift: n_camera = n_world @
    R, so n_world = n_camera @ R transposed. Zero (a miss) stays zero.
    """
    world: np.ndarray = np.asarray(normals, np.float64) @ _rotation(world_to_camera).T
    return world


def normals_to_camera(normals: np.ndarray, world_to_camera: np.ndarray) -> np.ndarray:
    """The inverse of `normals_to_world`."""
    camera: np.ndarray = np.asarray(normals, np.float64) @ _rotation(world_to_camera)
    return camera


def facing_normals(normals: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """Normals (..., 3) turned towards the viewer; directions (..., 3) of the view rays, of any
    length, same space."""
    normals = np.asarray(normals, np.float64)
    away = (normals * directions).sum(axis=-1, keepdims=True) > 0
    return np.where(away, -normals, normals)


def normals_from_encoded(encoded: np.ndarray) -> np.ndarray:
    """Signed normals (..., 3) from ones stored as 0.5 + 0.5 * n; what is stored as 0 or 0.5 all
    over is a miss, 0."""
    encoded = np.asarray(encoded, np.float64)
    missed = (encoded == 0).all(axis=-1, keepdims=True)
    return np.where(missed, 0, 2 * encoded - 1)


def _cosines(
    shape: tuple[int, ...], fov_x: float, jitter: Sequence[float], pixel_aspect: float,
    first: int = 0, height: int | None = None,
) -> np.ndarray:
    """Cosine between each pixel's ray and the view axis, shaped to multiply a plane."""
    if not 0 < fov_x < 180:
        raise DepthError(f"field of view {fov_x:g}: give degrees between 0 and 180")
    rows, width = shape[:2]
    size = (width, rows if height is None else height)
    x, y = ray_slopes(np.arange(width)[None, :], np.arange(first, first + rows)[:, None], size,
                      fov_x, jitter, pixel_aspect)
    cosines: np.ndarray = 1 / np.sqrt(1 + x**2 + y**2)
    return cosines.reshape(rows, width, *shape[2:])


def _inverse_planes(near: float, far: float) -> tuple[float, float]:
    if not 0 < near < far:
        raise DepthError(f"near {near:g} and far {far:g}: a depth buffer needs 0 < near < far")
    return 1 / near, 1 / far


def _rotation(world_to_camera: np.ndarray) -> np.ndarray:
    rotation = np.asarray(world_to_camera, np.float64)[:3, :3]
    unit: np.ndarray = rotation / np.linalg.norm(rotation, axis=0, keepdims=True)
    return unit
