"""Sequences under transparency overlays, right and wrong ones."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from postfx.frame import Frame, Role

Frames = list[Frame]


def puffs(frame: Frame) -> np.ndarray:
    """Premultiplied RGBA (h, w, 4): soft and hard-edged discs over each other, twice as bright as
    the picture."""
    random = np.random.default_rng(7)
    height, width = frame.spec.height, frame.spec.width
    y, x = np.indices((height, width)) + 0.5
    overlay, level = np.zeros((height, width, 4)), 2 * float(frame[Role.COLOUR].mean())
    for number in range(24):
        radius = random.uniform(0.02, 0.1) * width
        distance = np.hypot(x - random.uniform(0, width), y - random.uniform(0, height)) / radius
        alpha = 0.8 * (np.exp(-2 * distance**2) if number % 2
                       else np.clip((1 - distance) * radius + 0.5, 0, 1))
        layer = alpha[..., None] * np.append(level * random.uniform(0.5, 1.5, 3), 1)
        overlay = layer + (1 - layer[..., 3:]) * overlay
    return overlay


def over(change: Callable[[np.ndarray], np.ndarray]) -> Callable[[Frames], Frames]:
    """Gives every frame an overlay, changed."""
    return lambda frames: [with_plane(frame, Role.OVERLAY, change(puffs(frame)))
                           for frame in frames]


def with_plane(frame: Frame, role: Role, plane: np.ndarray) -> Frame:
    return replace(frame, planes={**frame.planes, role: plane.astype(np.float32)})


def right(overlay: np.ndarray) -> np.ndarray:
    return overlay


def straight(overlay: np.ndarray) -> np.ndarray:
    return np.concatenate([overlay[..., :3] / np.maximum(overlay[..., 3:], 1e-6), overlay[..., 3:]],
                          2)


def in_percent(overlay: np.ndarray) -> np.ndarray:
    return overlay * (1, 1, 1, 100)


def opaque(overlay: np.ndarray) -> np.ndarray:
    return np.concatenate([overlay[..., :3], np.ones_like(overlay[..., 3:])], 2)


def composited(frames: Frames) -> Frames:
    """The colour holds the overlay already. It stands still where the picture moves."""
    found = []
    for frame in over(right)(frames):
        light, alpha = frame[Role.OVERLAY][..., :3], frame[Role.OVERLAY][..., 3:]
        found.append(with_plane(frame, Role.COLOUR, light + (1 - alpha) * frame[Role.COLOUR]))
    return found


def two_colours(frames: Frames) -> Frames:
    """With and without transparents, and no overlay."""
    return [with_plane(frame, Role.OPAQUE_COLOUR, 0.9 * frame[Role.COLOUR]) for frame in frames]
