"""Where reflections were in the frame before, by its camera and this one's."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from postfx.frame import DEPTH_MISS, FrameSpec, Role, pixel_aspect
from postfx.kernels.denoise.history import CAMERA
from postfx.passes import ResidentFrame
from postfx.passes.denoise.graph import REFLECTED, kernels_of, run_steps
from postfx.runtime import CommandBuffer, Device, Tensor

NEEDS = (Role.MOTION, Role.DEPTH, Role.NORMAL, Role.ROUGHNESS, Role.DIFFUSE_ALBEDO,
         Role.SPECULAR_ALBEDO)
"""Without one of these the hit distance is of no use."""

AXES = ((-1, -1, 1), (1, -1, -1), (1, -1, 1))
"""Signs that turn x, y and z of cameras into the picture's (x right, y down, z forward): for
Mitsuba, OpenGL, pbrt."""

SAMPLES = 24
"""Pixels along a side whose motion tells which axes a camera has."""

# How far half of those pixels may be off: the sum of both.
MOST_OFF = 0.25
"""Part of it in pixels."""
PART_OFF = 0.05
"""Part of it as a share of the motion."""

NO_CAMERA = "no worldToCamera and field of view (postfx:fovX) in the headers"
NO_FIT = "worldToCamera, field of view and depth do not give the motion that the frame has"


class Camera(NamedTuple):
    """A frame's camera: world to camera (4, 4), row vectors; horizontal field of view in
    degrees."""

    matrix: np.ndarray
    fov_x: float

    @classmethod
    def of(cls, frame: ResidentFrame) -> Camera | None:
        """None where the frame does not know it."""
        if (frame.world_to_camera is None or not frame.fov_x
            or abs(np.linalg.det(frame.world_to_camera)) < 1e-12):
            return None
        return cls(frame.world_to_camera, frame.fov_x)


def can_follow(spec: FrameSpec) -> bool:
    """Whether frames of a spec have the planes for the motion of reflections, some possibly as
    guides."""
    return spec.has(Role.SPECULAR_HIT_DISTANCE) and all(spec.has(role) for role in NEEDS)


class Reflections:
    """Replaces the motion of smooth surfaces with a hit distance by the motion of their virtual
    image."""

    def __init__(self, device: Device, spec: FrameSpec) -> None:
        self._camera = device.heap.tensor("camera", (CAMERA,))
        self._output = device.heap.transient("motion of reflections", (spec.height, spec.width, 2))
        device.make_ready(*kernels_of(REFLECTED))

    def encode(self, commands: CommandBuffer, frame: ResidentFrame, params: np.ndarray,
               planes: Mapping[str, Tensor]) -> Tensor:
        """Record the work with the kernel's `params`; returns the motion."""
        self._camera.upload(params)
        run_steps(commands, REFLECTED, {
            **planes, "camera": self._camera, "reflected": self._output,
            "hit_distance": frame[Role.SPECULAR_HIT_DISTANCE]})
        return self._output


class Cameras:
    """Follows the camera from frame to frame."""

    def __init__(self) -> None:
        self._last: Camera | None = None

    def reset(self) -> None:
        """Forget the frame before."""
        self._last = None

    def snapshot(self) -> dict[str, np.ndarray]:
        """Between two frames: the last camera and its facts."""
        return ({"camera": self._last.matrix, "fov_x": np.array(self._last.fov_x, np.float64)}
                if self._last else {})

    def recall(self, kept: Mapping[str, np.ndarray]) -> None:
        """Between two frames: replace these facts by `kept`."""
        self._last = Camera(kept["camera"], float(kept["fov_x"])) if "camera" in kept else None

    def step(self, frame: ResidentFrame, moves: bool) -> tuple[np.ndarray | None, str]:
        """The kernel's parameters for a frame, float32 (27,); None if it has nothing to do. Then
        why reflections cannot be followed; empty if they can be, or need not.

        moves: whether the frame has a history, and something moves.
        """
        then, self._last = self._last, Camera.of(frame)
        if not moves or {Role.MOTION, Role.DEPTH} - frame.host_planes.keys():
            return None, ""
        if not (then and self._last):
            return None, NO_CAMERA
        if not _is_moving(self._last, then):
            return None, ""
        params = _best_params(frame, self._last, then)
        return params, NO_FIT if params is None else ""


def _is_moving(now: Camera, then: Camera) -> bool:
    """Whether a camera differs from the last one; if not, everything at rest is where it was."""
    return not (np.allclose(now.matrix, then.matrix, rtol=0, atol=1e-9) and now.fov_x == then.fov_x)


def _best_params(frame: ResidentFrame, now: Camera, then: Camera) -> np.ndarray | None:
    """None if no camera axes explain the frame's motion."""
    tried = [_params(frame, now, then, axes) for axes in AXES]
    errors = [_misfit(frame, params) for params in tried]
    best = int(np.argmin(errors))
    return tried[best].astype(np.float32) if errors[best] <= 1 else None


def _params(frame: ResidentFrame, now: Camera, then: Camera,
            axes: tuple[int, int, int]) -> np.ndarray:
    signs, change = np.diag(axes).astype(float), np.linalg.inv(now.matrix) @ then.matrix
    aspect = pixel_aspect(frame.metadata)
    focal = [side / 2 / math.tan(math.radians(camera.fov_x) / 2) for camera in (now, then)
             for side in (frame.spec.width, frame.spec.width * aspect)]
    turn, shift = signs @ change[:3, :3] @ signs, change[3, :3] @ signs
    return np.concatenate([focal, frame.jitter, turn.ravel(), shift,
                           (now.matrix[:3, :3] @ signs).ravel()])


def _misfit(frame: ResidentFrame, params: np.ndarray) -> float:
    """Median over some pixels of the difference from the motion of surfaces at rest, in units of
    the tolerance."""
    depth, motion = frame.host_planes[Role.DEPTH], frame.host_planes[Role.MOTION]
    height, width = depth.shape[:2]
    rows = np.linspace(0, height - 1, min(height, SAMPLES)).astype(int)[:, None]
    columns = np.linspace(0, width - 1, min(width, SAMPLES)).astype(int)[None]
    z, moved = depth[rows, columns, 0].astype(float), motion[rows, columns].astype(float)
    hit = (z > 0) & (z < DEPTH_MISS) & np.isfinite(moved).all(-1)
    if not hit.any():
        return math.inf
    at = np.stack(np.broadcast_arrays(columns, rows), -1) + 0.5 + params[4:6] - (width / 2,
                                                                                 height / 2)
    ray = np.concatenate([at / params[:2], np.ones((*z.shape, 1))], -1)[hit]
    place = ray @ params[6:15].reshape(3, 3) + params[15:18] / z[hit][:, None]
    error = np.abs(place[:, :2] / np.maximum(place[:, 2:], 1e-6) * params[2:4] - at[hit]
                   - moved[hit]).max(-1)
    return float(np.median(error / (MOST_OFF + PART_OFF * np.abs(moved[hit]).max(-1))))
