"""What a small network of a scene reads of each pixel, and what its light is multiplied by."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from postfx.errors import ModelError
from postfx.kernels.scene import (
    CAMERA_FORWARD,
    CAMERA_JITTER_X,
    CAMERA_JITTER_Y,
    CAMERA_LEFT,
    CAMERA_PLACE,
    CAMERA_TANGENT_ACROSS,
    CAMERA_TANGENT_DOWN,
    CAMERA_UP,
    FIND_POINTS,
    LAMP_REFLECTANCE,
    POINT,
    REFLECTANCE_OFFSET,
    REFLECTANCE_SHARE,
)

CARD = "scene"
"""Key of the box in a model's card."""


class SceneBox(NamedTuple):
    """Where a scene lies: its middle (3,), and half its longest side, > 0, in the scene's units."""

    middle: np.ndarray
    reach: float

    @classmethod
    def around(cls, places: np.ndarray) -> SceneBox:
        """The box of most of the places (count, 3)."""
        low, high = np.quantile(places, (0.01, 0.99), axis=0)
        return cls(((low + high) / 2).astype(np.float32), float((high - low).max() / 2) or 1.0)

    @classmethod
    def of_card(cls, card: Mapping[str, Any], model: str) -> SceneBox:
        """The box that training wrote into a model's card. ModelError if there is none."""
        facts = card.get(CARD, {})
        middle = np.asarray(facts.get("middle", ()), np.float32)
        reach = float(facts.get("reach", 0))
        if middle.shape != (3,) or not np.isfinite(middle).all() or not 0 < reach < np.inf:
            raise ModelError(f"model '{model}' has no card with the scene's box beside it: keep "
                             "the JSON file that python -m training.train_scene points wrote with "
                             "it")
        return cls(middle, reach)

    def numbers(self) -> np.ndarray:
        """The box as kernels read it, (4,): the middle, and the reach."""
        return np.array([*self.middle, self.reach], np.float32)

    def card(self) -> dict[str, Any]:
        """The box as an entry of a model's card, which `of_card` reads."""
        return {CARD: {"middle": [float(side) for side in self.middle], "reach": self.reach}}


def places_of(camera: np.ndarray, depth: np.ndarray) -> np.ndarray:
    """Places in the world (height, width, 3) of a depth plane (height, width, 1).

    camera: (16,): its axes left, up and forward, its place, tangents of half the field of view,
        and jitter.
    """
    height, width = depth.shape[:2]
    columns = np.arange(width, dtype=np.float32) + 0.5 + camera[CAMERA_JITTER_X]
    rows = np.arange(height, dtype=np.float32) + 0.5 + camera[CAMERA_JITTER_Y]
    across = (1 - 2 * columns / width) * camera[CAMERA_TANGENT_ACROSS]
    down = (1 - 2 * rows / height) * camera[CAMERA_TANGENT_DOWN]
    along = down[:, None] * camera[CAMERA_UP] + camera[CAMERA_FORWARD]
    rays = across[None, :, None] * camera[CAMERA_LEFT] + along[:, None]
    return np.asarray(camera[CAMERA_PLACE] + depth * rays, np.float32)


def points_of(
    camera: np.ndarray, depth: np.ndarray, normal: np.ndarray, box: SceneBox
) -> np.ndarray:
    """The network's inputs, (pixels, 9).

    depth: (height, width, 1). normal: (height, width, 3), in the world.
    """
    points = np.empty((depth.shape[0] * depth.shape[1], POINT), np.float32)
    FIND_POINTS.rows(0, len(points), camera, box.numbers(), np.ascontiguousarray(depth),
                     np.ascontiguousarray(normal), points)
    return points


def reflectance_of(diffuse: np.ndarray, specular: np.ndarray) -> np.ndarray:
    """The reflectance that light (height, width, 3) is divided by: both albedos with a floor, 1 for
    lamps and misses."""
    total = diffuse + specular
    peak = total.max(-1, keepdims=True)
    floored = np.maximum(total, REFLECTANCE_SHARE * peak) + REFLECTANCE_OFFSET
    return np.where(peak < LAMP_REFLECTANCE, np.float32(1), floored).astype(np.float32)


def light_to_learn(light: np.ndarray, reflectance: np.ndarray) -> np.ndarray:
    """The outputs that the network is to learn, (pixels, 3): light (height, width, 3) of 0 and
    more, coded."""
    logs: np.ndarray = np.log1p(np.maximum(light, 0) / reflectance).reshape(-1, 3)
    return logs.astype(np.float32)
