"""What a small network of a scene reads of each pixel, and what its light is multiplied by."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from postfx.errors import ModelError

POINT = 9
"""Numbers of a point: place in the scene's box, normal, and mirrored view direction."""
FARTHEST_PLACE = 1.5
"""Places farther out than so many half sides of the box count as there."""
LAMP_REFLECTANCE = 0.005
"""Less reflectance than this have lamps and misses only."""

# Of each channel's reflectance: a share of the largest channel, and what is added.
REFLECTANCE_SHARE = 0.15
REFLECTANCE_OFFSET = 0.01

MOST_LIGHT_LOG = 20.0
"""Bound of the logarithm of light that a network may give."""
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

    def card(self) -> dict[str, Any]:
        """What `of_card` reads."""
        return {CARD: {"middle": [float(side) for side in self.middle], "reach": self.reach}}


def rays_of(camera: np.ndarray, height: int, width: int,
            rows: slice = slice(None)) -> np.ndarray:
    """View rays (height, width, 3) of a picture or of some of its rows, 1 long along the view axis.

    camera: (16,): its axes left, up and forward, its place, tangents of half the field of view,
        and jitter.
    """
    across = (1 - 2 * (np.arange(width, dtype=np.float32) + 0.5 + camera[14]) / width) * camera[12]
    places = np.arange(height, dtype=np.float32)[rows]
    down = (1 - 2 * (places + 0.5 + camera[15]) / height) * camera[13]
    along = down[:, None] * camera[3:6] + camera[6:9]
    return np.asarray(across[None, :, None] * camera[:3] + along[:, None], np.float32)


def places_of(camera: np.ndarray, depth: np.ndarray) -> np.ndarray:
    """Places in the world (height, width, 3) of a depth plane (height, width, 1)."""
    return np.asarray(camera[9:12] + depth * rays_of(camera, *depth.shape[:2]), np.float32)


def points_of(
    camera: np.ndarray, depth: np.ndarray, normal: np.ndarray, box: SceneBox
) -> np.ndarray:
    """What the network reads, (pixels, 9).

    depth: (height, width, 1). normal: (height, width, 3), in the world.
    """
    points = np.empty((*depth.shape[:2], POINT), np.float32)
    find_points(0, len(points), camera, depth, normal, box, points)
    return points.reshape(-1, POINT)


def find_points(first: int, last: int, camera: np.ndarray, depth: np.ndarray, normal: np.ndarray,
                box: SceneBox, points: np.ndarray) -> None:
    """Rows `first` to `last` - 1 of `points` (height, width, 9), as `points_of` makes them."""
    rows = slice(first, last)
    height, width = depth.shape[:2]
    rays, here, facing = rays_of(camera, height, width, rows), points[rows], normal[rows]
    place = camera[9:12] - box.middle + depth[rows] * rays
    np.clip(place / np.float32(box.reach), -FARTHEST_PLACE, FARTHEST_PLACE, out=here[..., :3])
    here[..., 3:6] = facing
    rays /= np.sqrt(np.einsum("ijk,ijk->ij", rays, rays))[..., None]
    here[..., 6:] = rays - 2 * np.einsum("ijk,ijk->ij", rays, facing)[..., None] * facing


def reflectance_of(diffuse: np.ndarray, specular: np.ndarray) -> np.ndarray:
    """What light (height, width, 3) is divided by: both albedos with a floor, 1 for lamps and
    misses."""
    total = diffuse + specular
    peak = total.max(-1, keepdims=True)
    floored = np.maximum(total, REFLECTANCE_SHARE * peak) + REFLECTANCE_OFFSET
    return np.where(peak < LAMP_REFLECTANCE, np.float32(1), floored).astype(np.float32)


def light_to_learn(light: np.ndarray, reflectance: np.ndarray) -> np.ndarray:
    """What the network is to give: (pixels, 3) of light (height, width, 3), 0 and more."""
    logs: np.ndarray = np.log1p(np.maximum(light, 0) / reflectance).reshape(-1, 3)
    return logs.astype(np.float32)


def light_of(
    values: np.ndarray, diffuse: np.ndarray, specular: np.ndarray, colour: np.ndarray
) -> np.ndarray:
    """Light (height, width, 3) of what the network gave; lamps and misses keep their colour."""
    learnt = np.expm1(np.clip(values.reshape(colour.shape), 0, np.float32(MOST_LIGHT_LOG)))
    is_emitter = (diffuse + specular).max(-1, keepdims=True) < LAMP_REFLECTANCE
    light: np.ndarray = np.where(is_emitter, colour, learnt * reflectance_of(diffuse, specular))
    return light
