"""Check the albedo by the colour: across a texture on one surface, both change together.

A picture is cut into squares of 8 x 8 pixels. Squares that show one smooth surface with a texture are split into the
third with the least albedo and the third with the most. Both thirds receive nearly the same light, so the ratio of
their colours equals the ratio of their albedos, or is smaller where a gloss adds light: the slope between the
logarithms is at most 1. An albedo stored with a display curve has too little contrast, which doubles the slope or so.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from postfx.doctor.geometry import is_hit
from postfx.doctor.statistics import finite
from postfx.frame import Frame, Role

SIDE = 8
LEAST_RATIO = 0.2
"""Least logarithm of the ratio of the two thirds' albedos."""
FIREFLY = 4.0
"""Colour is cut off at this many times the median of its square."""
DARK = 0.02
"""Squares whose median is below this part of the picture's mean are too noisy to use."""
ALIGNED, FLAT = 0.97, 1.15
"""On one surface the mean normal is at least this long, and the ratio of depths is at most this large."""


class Slopes(NamedTuple):
    """Quartiles of the slope, weighted by the albedo's contrast, and the count of squares."""

    lower: float
    median: float
    upper: float
    squares: int


def measure_slopes(frames: Sequence[Frame]) -> tuple[Slopes | None, Slopes | None]:
    """Slopes of brightness, and of red over blue; None where fewer than 5 squares show a texture.

    frames: with colour and diffuse albedo. Fireflies are cut off in each square.
    """
    brightness, tint = [], []
    for frame in frames:
        if min(frame.spec.width, frame.spec.height) < SIDE:
            continue
        squares = _one_surface(frame)
        colour, albedo = (_squares(np.maximum(finite(frame[role]), 0))[squares]
                          for role in (Role.COLOUR, Role.DIFFUSE_ALBEDO))
        if not len(colour):
            continue
        middle = np.median(colour, axis=1, keepdims=True)
        lit = (middle[:, 0] > DARK * colour.mean()).all(1)
        colour, albedo = np.minimum(colour, FIREFLY * middle)[lit], albedo[lit]
        brightness.append(_ratios(colour.sum(-1), albedo.sum(-1), albedo.sum(-1)))
        key = np.log((albedo[..., 0] + 1e-3) / (albedo[..., 2] + 1e-3))
        red, blue = (_ratios(colour[..., channel], albedo[..., channel], key) for channel in (0, 2))
        tint.append(red - blue)
    if not brightness:
        return None, None
    return _slopes(np.concatenate(brightness)), _slopes(np.concatenate(tint))


def _one_surface(frame: Frame) -> np.ndarray:
    """(squares,): whether normals agree and depth hardly changes."""
    found = np.ones(frame.spec.height // SIDE * (frame.spec.width // SIDE), bool)
    if Role.NORMAL in frame:
        normals = _squares(finite(frame[Role.NORMAL]))
        mean = np.linalg.norm(normals.mean(1), axis=-1)
        found &= (mean > ALIGNED * np.linalg.norm(normals, axis=-1).mean(1)) & (mean > 0.3)
    if Role.DEPTH in frame:
        depth = _squares(np.where(is_hit(frame[Role.DEPTH])[..., None], frame[Role.DEPTH], np.inf))[..., 0]
        found &= np.isfinite(depth).all(1) & (depth.max(1) < FLAT * depth.min(1))
    return found


def _squares(plane: np.ndarray) -> np.ndarray:
    """Whole squares (count, 64, C) of a plane (height, width, C)."""
    rows, columns = plane.shape[0] // SIDE, plane.shape[1] // SIDE
    cut = plane[: rows * SIDE, : columns * SIDE].reshape(rows, SIDE, columns, SIDE, -1)
    return cut.swapaxes(1, 2).reshape(rows * columns, SIDE * SIDE, -1)


def _ratios(colour: np.ndarray, albedo: np.ndarray, key: np.ndarray) -> np.ndarray:
    """(squares, 2): logarithms of the ratios of colours and of albedos, between the thirds with the most and least key.

    All arguments are (squares, 64).
    """
    order, third = np.argsort(key, axis=1), SIDE * SIDE // 3
    parts = order[:, -third:], order[:, :third]
    means = [[np.take_along_axis(plane, part, 1).mean(1) for part in parts] for plane in (colour, albedo)]
    return np.stack([np.log((most + least_value) / (least + least_value))
                     for (most, least), least_value in zip(means, (1e-4, 1e-3), strict=True)], -1)


def _slopes(ratios: np.ndarray) -> Slopes | None:
    used = ratios[ratios[:, 1] > LEAST_RATIO]
    if len(used) < 5:
        return None
    slopes, weights = used[:, 0] / used[:, 1], used[:, 1]
    order = np.argsort(slopes)
    shares = np.cumsum(weights[order]) / weights.sum()
    lower, median, upper = (float(slopes[order][np.searchsorted(shares, share)]) for share in (0.25, 0.5, 0.75))
    return Slopes(lower, median, upper, len(used))
