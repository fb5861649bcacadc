"""A frame with left and right exchanged, and its results turned back.

A network's errors differ in a mirrored picture, so the mean of both results has less of them. The
frames in reverse order run mirrored, which costs nothing there.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from postfx.frame import Frame, Role


def mirror(frame: Frame) -> Frame:
    """The frame with left and right exchanged: planes, guides, parts, motion, jitter and camera.

    Its other views stay out, as each of them runs alone.
    """
    planes = {role: mirror_plane(plane) for role, plane in frame.planes.items()}
    if Role.MOTION in planes:
        planes[Role.MOTION] *= np.array([-1.0, 1.0], np.float32)
    return replace(
        frame,
        planes=planes,
        guides={role: mirror_plane(guide) for role, guide in frame.guides.items()},
        parts={name: mirror_plane(part) for name, part in frame.parts.items()},
        jitter=(-frame.jitter[0], frame.jitter[1]),
        guide_jitter=(-frame.guide_jitter[0], frame.guide_jitter[1]),
        world_to_camera=mirror_camera(frame.world_to_camera),
        views={},
    )


def mirror_plane(plane: np.ndarray) -> np.ndarray:
    """A plane (height, width, channels) with left and right exchanged."""
    return np.ascontiguousarray(plane[:, ::-1])


def mirror_camera(world_to_camera: np.ndarray | None) -> np.ndarray | None:
    """The camera that sees left and right exchanged: its x axis is the opposite one."""
    if world_to_camera is None:
        return None
    mirrored: np.ndarray = world_to_camera * np.array([-1.0, 1.0, 1.0, 1.0])
    return mirrored
