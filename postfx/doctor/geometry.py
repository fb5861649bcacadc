"""What depth says of the surfaces: positions and normals in camera space, flat surfaces, view angles.

Camera space here is that of the picture: x right, y down, z along the view axis.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from postfx.frame import DEPTH_MISS, Frame, Role

PICTURE_AXES = np.diag([-1.0, -1.0, 1.0])
"""From the axes of worldToCamera (x left, y up, z forward) to those of the picture."""
STEP = 2
NEIGHBOURS = 0.05
"""Most relative difference in depth of neighbours on one surface."""
LIKELY_FOV = tuple(range(20, 121, 10))


class Fit(NamedTuple):
    """An orthogonal matrix that takes normals of depth to the stored ones (row vectors), and how well."""

    matrix: np.ndarray
    agreement: float
    fov_x: float


def is_hit(depth: np.ndarray) -> np.ndarray:
    """(height, width): whether a pixel shows a surface at a positive distance."""
    return np.isfinite(depth[..., 0]) & (depth[..., 0] > 0) & (depth[..., 0] < DEPTH_MISS)


def rays(width: int, height: int, fov_x: float, jitter: tuple[float, float] = (0.0, 0.0)) -> np.ndarray:
    """(height, width, 3) directions through the samples, with z = 1; fov_x in degrees."""
    step = 2 * math.tan(math.radians(fov_x) / 2) / width
    x = (np.arange(width) + 0.5 + jitter[0] - width / 2) * step
    y = (np.arange(height) + 0.5 + jitter[1] - height / 2) * step
    return np.stack([*np.meshgrid(x, y), np.ones((height, width))], -1)


def normals_of_depth(frame: Frame, fov_x: float) -> tuple[np.ndarray, np.ndarray]:
    """Unit normals facing the viewer (height, width, 3), and where they are known: off edges, borders and misses."""
    depth = frame[Role.DEPTH]
    hit = is_hit(depth)
    z = np.where(hit, depth[..., 0], 1.0).astype(np.float64)
    height, width = z.shape
    if min(height, width) < 2 * STEP + 1:
        return np.zeros((height, width, 3)), np.zeros((height, width), bool)
    place = rays(width, height, fov_x, frame.jitter) * z[..., None]
    normal, known = np.zeros_like(place), np.zeros_like(hit)
    inner = (slice(STEP, -STEP), slice(STEP, -STEP))
    across, down = place[STEP:-STEP, 2 * STEP :] - place[STEP:-STEP, : -2 * STEP], \
        place[2 * STEP :, STEP:-STEP] - place[: -2 * STEP, STEP:-STEP]
    cross = np.cross(across, down)
    length = np.linalg.norm(cross, axis=-1, keepdims=True)
    facing = np.sign((cross * place[inner]).sum(-1, keepdims=True))
    normal[inner] = -cross * facing / np.maximum(length, 1e-30)
    known[inner] = _on_one_surface(z, hit) & (length[..., 0] > 1e-30) & (facing[..., 0] != 0)
    return normal, known


def _on_one_surface(z: np.ndarray, hit: np.ndarray) -> np.ndarray:
    middle = z[STEP:-STEP, STEP:-STEP]
    same = hit[STEP:-STEP, STEP:-STEP].copy()
    arms = ((slice(STEP, -STEP), slice(2 * STEP, None)), (slice(STEP, -STEP), slice(None, -2 * STEP)),
            (slice(2 * STEP, None), slice(STEP, -STEP)), (slice(None, -2 * STEP), slice(STEP, -STEP)))
    for arm in arms:
        same &= hit[arm] & (np.abs(z[arm] - middle) < NEIGHBOURS * middle)
    pairs = ((arms[0], arms[1]), (arms[2], arms[3]))
    for one, other in pairs:  # a step to one side only is an edge
        same &= np.abs(z[one] + z[other] - 2 * middle) < NEIGHBOURS / 5 * middle
    return same


def unit_normals(frame: Frame) -> tuple[np.ndarray, np.ndarray]:
    """Stored normals scaled to length 1, and where there are any."""
    normal = np.nan_to_num(frame[Role.NORMAL].astype(np.float64), posinf=0, neginf=0)
    length = np.linalg.norm(normal, axis=-1, keepdims=True)
    return normal / np.maximum(length, 1e-12), length[..., 0] > 0.1


def agreement(normals: np.ndarray, others: np.ndarray) -> float:
    """Median cosine between normals, both (count, 3); 0 of none."""
    return float(np.median((normals * others).sum(-1))) if len(normals) else 0.0


def fit_rotation(frame: Frame) -> Fit | None:
    """The orthogonal matrix between the normals of depth and the stored ones, over likely fields of view.

    Orthogonal Procrustes (Schoenemann 1966), repeated without the worst half; None without enough surfaces.
    """
    stored, there = unit_normals(frame)
    fits = []
    for fov in (frame.fov_x,) if frame.fov_x else LIKELY_FOV:
        seen, known = normals_of_depth(frame, fov)
        known &= there
        if known.sum() < 500:
            continue
        matrix, cosine = _procrustes(seen[known], stored[known])
        fits.append(Fit(matrix, cosine, fov))
    return max(fits, key=lambda fit: fit.agreement, default=None)


def _procrustes(seen: np.ndarray, stored: np.ndarray) -> tuple[np.ndarray, float]:
    keep = np.ones(len(seen), bool)
    for _ in range(4):
        u, _, v = np.linalg.svd(seen[keep].T @ stored[keep])
        cosines = ((seen @ (u @ v)) * stored).sum(-1)
        keep = cosines >= np.median(cosines)
    return u @ v, float(np.median(cosines))
