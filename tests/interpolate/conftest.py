"""A scene of two layers whose picture is known at any time: a wall, and a disc in front of it."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from postfx.frame import Frame, Role

SIZE = HEIGHT, WIDTH = 72, 112
WALL, DISC = (-3.0, 1.5), (7.0, 2.0)
"""Pixels that they go a frame, x and y."""
RADIUS = 14


def wall(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Radiance (..., 3) of the wall at places of its own."""
    waves = [np.sin(x * 0.35 + k) * np.sin(y * 0.27 - k) + 0.5 * np.sin(0.11 * (x + 2 * y) + k)
             for k in range(3)]
    return np.exp(np.stack(waves, -1))


def picture(t: float) -> tuple[np.ndarray, np.ndarray]:
    """Colour (h, w, 3), of 4x4 samples a pixel, and whether the disc covers a pixel's middle (h,
    w)."""
    y, x = (np.indices((4 * HEIGHT, 4 * WIDTH)) - 1.5) / 4
    colour = wall(x - WALL[0] * t, y - WALL[1] * t)
    u, v = x - 40 - DISC[0] * t, y - 34 - DISC[1] * t
    there = u**2 + v**2 < RADIUS**2
    colour[there] = 20 * wall(2 * u + 300, 2 * v)[there]
    colour = colour.reshape(HEIGHT, 4, WIDTH, 4, 3).mean((1, 3))
    return colour, there.reshape(HEIGHT, 4, WIDTH, 4).mean((1, 3)) >= 0.5


@pytest.fixture
def scene() -> Callable[..., Frame]:
    """Makes the scene's frame of a time, with motion from the time `step` before."""

    def make(t: float, step: float = 1.0, roles: tuple[Role, ...] = tuple(Role)) -> Frame:
        colour, there = picture(t)
        motion = np.where(there[..., None], np.array(DISC), np.array(WALL)) * -step
        planes = {Role.COLOUR: colour, Role.DEPTH: np.where(there, 2.0, 9.0)[..., None],
                  Role.MOTION: motion}
        return Frame({role: plane.astype(np.float32)
                      for role, plane in planes.items() if role in roles},
                     number=round(t) + 1)

    return make
