"""Bringing stored planes to postfx's one convention, as a profile's rules say."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from postfx.frame import DEPTH_MISS, Role
from postfx.io.profile import PlaneRule


@dataclass(frozen=True)
class Camera:
    """What a header says about the camera.

    Attributes:
        world_to_camera: 4x4, row vectors (p_camera = p_world @ M), or None.
        fov_x: horizontal field of view in degrees, or None.
        jitter: sample position minus 0.5 in pixels, x right, y down.
        pixel_aspect: width of a pixel over its height.
    """

    world_to_camera: np.ndarray | None = None
    fov_x: float | None = None
    jitter: tuple[float, float] = (0.0, 0.0)
    pixel_aspect: float = 1.0


def convert(
    plane: np.ndarray, rule: PlaneRule, camera: Camera, first: int = 0, height: int | None = None
) -> np.ndarray:
    """Stored values (height, width, channels) of one plane in postfx's convention, float32; the input may be reused.

    Of a plane of another `height` these are the rows from the `first` on.
    """
    height = plane.shape[0] if height is None else height
    plane = _affine(plane, rule)
    if rule.role is Role.DEPTH:
        return _depth(plane, rule, camera, first, height)
    if rule.role is Role.MOTION:
        plane = np.nan_to_num(_motion_pixels(plane, rule.unit, height), copy=False, nan=0.0, posinf=0.0, neginf=0.0)
    if rule.role is Role.NORMAL and rule.space == "camera":
        plane = _camera_to_world(plane, camera)
    if rule.clamp is not None:
        plane = np.clip(plane, *rule.clamp)
    return np.ascontiguousarray(plane, np.float32)


def fill_value(rule: PlaneRule) -> float:
    """Stored value that means 'nothing here', for pixels outside the data window."""
    if rule.role is Role.DEPTH:
        return DEPTH_MISS if rule.miss is None else rule.miss
    return -rule.offset[0] if rule.role is Role.MOTION else 0.0


def _affine(plane: np.ndarray, rule: PlaneRule) -> np.ndarray:
    if any(rule.offset):
        plane = plane + np.float32(rule.offset)
    return plane * np.float32(rule.scale) if any(scale != 1 for scale in rule.scale) else plane


def _depth(plane: np.ndarray, rule: PlaneRule, camera: Camera, first: int, height: int) -> np.ndarray:
    missed = ~np.isfinite(plane) | (plane >= DEPTH_MISS)
    if rule.miss is not None:
        missed |= plane == np.float32(rule.miss)
    if rule.kind == "ray" and camera.fov_x is not None:
        plane = plane * _cosine_to_axis(plane.shape[1], height, camera, range(first, first + plane.shape[0]))
    return np.ascontiguousarray(np.where(missed, np.float32(DEPTH_MISS), plane), np.float32)


def _cosine_to_axis(width: int, height: int, camera: Camera, rows: range) -> np.ndarray:
    """(rows, width, 1): cosine between each pixel's ray and the view axis; planar depth = ray distance x cosine."""
    half = math.tan(math.radians(camera.fov_x) / 2)
    step = 2 * half / width
    x = (np.arange(width) + 0.5 + camera.jitter[0] - width / 2) * step
    y = (np.array(rows) + 0.5 + camera.jitter[1] - height / 2) * step / camera.pixel_aspect
    return (1 / np.sqrt(1 + x[None, :] ** 2 + y[:, None] ** 2)).astype(np.float32)[:, :, None]


def _motion_pixels(plane: np.ndarray, unit: str, height: int) -> np.ndarray:
    width = plane.shape[1]
    size = {"pixels": (1, 1), "uv": (width, height), "ndc": (width / 2, height / 2)}[unit]
    return plane * np.float32(size)


def _camera_to_world(normals: np.ndarray, camera: Camera) -> np.ndarray:
    """Row vectors: n_camera = n_world @ R for a rotation R, so n_world = n_camera @ R transposed."""
    rotation = camera.world_to_camera[:3, :3]
    rotation = rotation / np.linalg.norm(rotation, axis=0, keepdims=True)
    return normals @ rotation.T.astype(np.float32)
