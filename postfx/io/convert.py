"""Bringing stored planes to postfx's one convention, as a profile's rules say."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from postfx.depth import depth_from_device, depth_from_normalised, depth_from_ray, normals_to_world
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
        display_size: width and height of the display window, which the field of view and motion in parts of the image
            refer to; None where the planes cover just that.
        shift: from the centre of the display window to that of the planes, in pixels, x right, y down.
        near, far: distances of the near and far plane, or None.
    """

    world_to_camera: np.ndarray | None = None
    fov_x: float | None = None
    jitter: tuple[float, float] = (0.0, 0.0)
    pixel_aspect: float = 1.0
    near: float | None = None
    far: float | None = None
    display_size: tuple[int, int] | None = None
    shift: tuple[float, float] = (0.0, 0.0)

    def fov_over(self, width: int) -> float | None:
        """Horizontal field of view, in degrees, of planes of a width."""
        if self.fov_x is None or self.display_size is None:
            return self.fov_x
        return math.degrees(2 * math.atan(math.tan(math.radians(self.fov_x) / 2) * width / self.display_size[0]))


def convert(
    plane: np.ndarray, rule: PlaneRule, camera: Camera, first: int = 0, height: int | None = None
) -> np.ndarray:
    """Stored values (height, width, channels) of one plane in postfx's convention, float32; the input may be reused.

    Of a plane of another `height` these are the rows from the `first` on.
    """
    height = plane.shape[0] if height is None else height
    if rule.role is Role.DEPTH:
        return _depth(plane, rule, camera, first, height)
    plane = _affine(plane, rule)
    if rule.role is Role.MOTION:
        plane = _motion_pixels(plane, rule.unit, *(camera.display_size or (plane.shape[1], height)))
        plane[~np.isfinite(plane)] = 0
    if rule.role is Role.NORMAL and rule.space == "camera":
        plane = normals_to_world(plane, camera.world_to_camera)
    if rule.clamp is not None:
        plane = np.clip(plane, *rule.clamp)
    return np.ascontiguousarray(plane, np.float32)


def fill_value(rule: PlaneRule) -> float:
    """Stored value that means 'nothing here', for pixels outside the data window."""
    if rule.role is Role.DEPTH:
        return _empty(rule) if rule.miss is None else rule.miss
    return -rule.offset[0] if rule.role is Role.MOTION else 0.0


def _affine(plane: np.ndarray, rule: PlaneRule) -> np.ndarray:
    if any(rule.offset):
        plane = plane + np.float32(rule.offset)
    return plane * np.float32(rule.scale) if any(scale != 1 for scale in rule.scale) else plane


def _depth(stored: np.ndarray, rule: PlaneRule, camera: Camera, first: int, height: int) -> np.ndarray:
    missed = ~np.isfinite(stored)
    if rule.miss is not None:
        missed |= stored == np.float32(rule.miss)
    plane = _affine(np.where(missed, 0, stored), rule)
    missed |= plane >= DEPTH_MISS
    return np.ascontiguousarray(np.where(missed, DEPTH_MISS, _planar(plane, rule, camera, first, height)), np.float32)


def _planar(plane: np.ndarray, rule: PlaneRule, camera: Camera, first: int, height: int) -> np.ndarray:
    """Depth along the view axis; what the camera must be known for is checked when the plane is found."""
    if rule.kind == "ray" and camera.fov_x is not None:
        sample = (camera.jitter[0] + camera.shift[0], camera.jitter[1] + camera.shift[1])
        return depth_from_ray(plane, camera.fov_over(plane.shape[1]), sample, camera.pixel_aspect, first, height)
    if rule.kind == "device":
        return depth_from_device(plane, camera.near, camera.far or math.inf, rule.reversed)
    if rule.kind == "normalised":
        return depth_from_normalised(plane, camera.near, camera.far, rule.reversed)
    return plane


def _empty(rule: PlaneRule) -> float:
    """Stored value of a pixel without a surface, where the profile names none."""
    return math.inf if rule.kind in ("planar", "ray") else 0.0 if rule.reversed else 1.0


def _motion_pixels(plane: np.ndarray, unit: str, width: int, height: int) -> np.ndarray:
    size = {"pixels": None, "uv": (width, height), "ndc": (width / 2, height / 2)}[unit]
    return plane if size is None else plane * np.float32(size)
