"""What depth says of the surfaces: normals in camera space, view angles, the camera's turn and its motion.

Camera space here is that of the picture: x right, y down, z along the view axis.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from postfx.depth import pixel_aspect, ray_slopes
from postfx.doctor.statistics import finite
from postfx.errors import IntegrationError
from postfx.frame import DEPTH_MISS, Frame, Role
from postfx.integrate.camera import perspective
from postfx.integrate.motion import motion_from_depth

CAMERA_AXES = tuple(map(np.diag, ((-1.0, -1.0, 1.0), (1.0, -1.0, -1.0), (1.0, -1.0, 1.0), (1.0, 1.0, 1.0))))
"""From axes that worldToCamera may have (x left, y up, z forward; x right, y up, z back; x right, y up, z forward; x
right, y down, z forward) to those of the picture."""
STEP = 2
NEIGHBOURS, BEND = 0.05, 0.01
"""Most relative difference in depth of neighbours on one surface, and most second difference."""
POINTS, LEAST_POINTS = 12000, 500
LIKELY_FOV = tuple(range(20, 121, 10))
AGREEING = 0.75
"""Share of the points that a fit must explain."""


class Points(NamedTuple):
    """Pixels inside smooth surfaces."""

    rows: np.ndarray
    columns: np.ndarray


class Fit(NamedTuple):
    """An orthogonal matrix that takes normals of depth to the stored ones (row vectors).

    `angle`: degrees within which three quarters of the normals agree; `fov_x`: field of view that it holds for.
    """

    matrix: np.ndarray
    angle: float
    fov_x: float


def is_hit(depth: np.ndarray) -> np.ndarray:
    """(height, width): whether a pixel shows a surface at a positive distance."""
    result: np.ndarray = np.isfinite(depth[..., 0]) & (depth[..., 0] > 0) & (depth[..., 0] < DEPTH_MISS)
    return result


def rays(frame: Frame, fov_x: float, rows: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """(..., 3) directions through the samples of pixels, with z = 1; fov_x in degrees."""
    size = frame.spec.width, frame.spec.height
    x, y = ray_slopes(columns, rows, size, fov_x, frame.jitter, pixel_aspect(frame.metadata))
    return np.stack([x, y, np.ones_like(x)], -1)


def smooth_points(depth: np.ndarray) -> Points:
    """Up to 12000 pixels whose neighbours two pixels away lie on the same surface."""
    z = np.where(is_hit(depth), depth[..., 0], np.nan).astype(np.float64)
    if min(z.shape) < 2 * STEP + 1:
        return Points(np.zeros(0, int), np.zeros(0, int))
    middle = z[STEP:-STEP, STEP:-STEP]
    left, right = z[STEP:-STEP, : -2 * STEP], z[STEP:-STEP, 2 * STEP :]
    up, down = z[: -2 * STEP, STEP:-STEP], z[2 * STEP :, STEP:-STEP]
    with np.errstate(invalid="ignore"):
        smooth = np.abs(left + right - 2 * middle) < BEND * middle  # a step to one side only is an edge
        smooth &= np.abs(up + down - 2 * middle) < BEND * middle
        smooth &= (np.abs(left - right) < 2 * NEIGHBOURS * middle) & (np.abs(up - down) < 2 * NEIGHBOURS * middle)
    rows, columns = np.nonzero(smooth)
    chosen = np.random.default_rng(4).permutation(rows.size)[:POINTS]
    return Points(rows[chosen] + STEP, columns[chosen] + STEP)


def normals_of_depth(frame: Frame, fov_x: float, points: Points) -> tuple[np.ndarray, np.ndarray]:
    """Unit normals (count, 3) that face the viewer, and cosines (count,) between them and the way to the eye."""
    z = frame[Role.DEPTH][..., 0].astype(np.float64)

    def place(down: int, right: int) -> np.ndarray:
        rows, columns = points.rows + down, points.columns + right
        result: np.ndarray = rays(frame, fov_x, rows, columns) * z[rows, columns][:, None]
        return result

    normal = np.cross(place(0, STEP) - place(0, -STEP), place(STEP, 0) - place(-STEP, 0))
    normal /= np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-30)
    ray = rays(frame, fov_x, points.rows, points.columns)
    towards = -(normal * ray).sum(-1) / np.linalg.norm(ray, axis=-1)
    return normal * np.sign(towards)[:, None], np.abs(towards)


def unit_normals(frame: Frame, points: Points) -> np.ndarray:
    """Stored normals (count, 3) scaled to length 1; (0, 0, 0) where there are none."""
    normal = finite(frame[Role.NORMAL][points.rows, points.columns]).astype(np.float64)
    length = np.linalg.norm(normal, axis=-1, keepdims=True)
    return np.where(length > 0.1, normal / np.maximum(length, 0.1), 0)


def surface_normals(frame: Frame) -> np.ndarray:
    """(count, 3) stored normals that are finite and not zero, of hits where there is depth."""
    normal = finite(frame[Role.NORMAL])
    used = np.abs(normal).max(2) > 0
    hit = is_hit(frame[Role.DEPTH]) if Role.DEPTH in frame else used
    result: np.ndarray = normal[used & hit] if hit.any() else normal[used]
    return result


def lengths_of(vectors: np.ndarray) -> np.ndarray:
    """Lengths along the last axis."""
    result: np.ndarray = np.linalg.norm(vectors, axis=-1)
    return result


def are_unit(normals: np.ndarray) -> bool:
    """Whether the median length is 1 within 3 %."""
    return len(normals) > 0 and 0.97 < float(np.median(lengths_of(normals))) < 1.03


def is_unsigned(frame: Frame) -> bool:
    """Whether normals are stored as (n + 1) / 2."""
    normal = surface_normals(frame) if Role.NORMAL in frame else np.zeros((0, 3))
    if not len(normal) or np.percentile(normal, 0.1) < -0.01 or normal.max() > 1.01:
        return False
    return are_unit(2 * normal - 1) and not are_unit(normal)


def fit_rotation(frame: Frame, views: Sequence[float] = ()) -> Fit | None:
    """The orthogonal matrix between the normals of depth and the stored ones.

    Of the fields of view given, by default the frame's, or all likely ones, the best counts. Orthogonal Procrustes
    (Schoenemann 1966), repeated without the worst quarter; None without enough smooth surfaces.
    """
    points = smooth_points(frame[Role.DEPTH])
    stored = unit_normals(frame, points)
    there = np.abs(stored).sum(-1) > 0
    if there.sum() < LEAST_POINTS:
        return None
    points, stored = Points(points.rows[there], points.columns[there]), stored[there]
    views = views or ((frame.fov_x,) if frame.fov_x else LIKELY_FOV)
    return min((_procrustes(normals_of_depth(frame, view, points)[0], stored, view) for view in views),
               key=lambda fit: fit.angle)


def angle_by(frame: Frame, fov_x: float, matrix: np.ndarray) -> float:
    """Degrees within which three quarters of the stored normals agree with those of depth, taken by a matrix."""
    points = smooth_points(frame[Role.DEPTH])
    stored = unit_normals(frame, points)
    cosines = ((normals_of_depth(frame, fov_x, points)[0] @ matrix) * stored).sum(-1)[np.abs(stored).sum(-1) > 0]
    return float(np.degrees(np.arccos(np.clip(np.quantile(cosines, 1 - AGREEING), -1, 1))))


def motion_of_camera(before: Frame, now: Frame) -> np.ndarray | None:
    """Motion (count, 2) in pixels that the cameras alone give to up to 12000 surface points; None without them.

    Points behind the earlier camera have `postfx.integrate.motion.OUT_OF_SIGHT`.
    """
    if now.fov_x is None or before.fov_x is None or Role.DEPTH not in now:
        return None
    if now.world_to_camera is None or before.world_to_camera is None:
        return None
    points = smooth_points(now[Role.DEPTH])
    try:
        cameras = (_world_to_clip(now, now.world_to_camera, now.fov_x),
                   _world_to_clip(before, before.world_to_camera, before.fov_x))
        motion = motion_from_depth(now[Role.DEPTH], *cameras, now.jitter)
    except IntegrationError:  # a matrix of zeros, or an angle that no camera has
        return None
    result: np.ndarray = motion[points.rows, points.columns]
    return result


def _world_to_clip(frame: Frame, world_to_camera: np.ndarray, fov_x: float) -> np.ndarray:
    to_clip = perspective(fov_x, frame.spec.width, frame.spec.height, right="-x", up="+y", forward="+z",
                          pixel_aspect=pixel_aspect(frame.metadata))
    matrix: np.ndarray = world_to_camera @ to_clip
    return matrix


def _procrustes(seen: np.ndarray, stored: np.ndarray, fov_x: float) -> Fit:
    keep = np.ones(len(seen), bool)
    for _ in range(4):
        u, _, v = np.linalg.svd(seen[keep].T @ stored[keep])
        cosines = ((seen @ (u @ v)) * stored).sum(-1)
        worst = np.quantile(cosines, 1 - AGREEING)
        keep = cosines >= worst
    return Fit(u @ v, float(np.degrees(np.arccos(np.clip(worst, -1, 1)))), fov_x)
