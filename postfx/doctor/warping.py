"""Warping the previous frame onto this one by every variant of the motion, scored on guides and colour.

A score is the error of the warped pictures in units of their own contrast, that is of what one pixel of
misregistration costs: 0 is a perfect fit. Only pixels with contrast count; the fifth that fits worst is left out,
which takes out occlusions; so are pixels that come from outside the picture.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from postfx.colour.primaries import luminance
from postfx.doctor.statistics import finite
from postfx.doctor.variants import VARIANTS, Variant
from postfx.frame import Frame, Role
from postfx.sampling import bilinear, is_inside, local_mean

POINTS = 3000
CONTRASTY = 0.75
OCCLUDED = 0.2
LEAST_INSIDE = 0.5
RELATED = 0.7
"""Part of the score of chance that pictures with something in common stay below."""
GUIDES = ((Role.DIFFUSE_ALBEDO, 1.0), (Role.SPECULAR_ALBEDO, 1.0), (Role.NORMAL, 1.0))
DEPTH_WEIGHT, COLOUR_WEIGHT = 0.2, 0.2  # depth changes where the camera goes forward, colour is noisy


class Feature(NamedTuple):
    """A plane of the earlier frame, and the pixels of the later one where it has contrast, with values and motion."""

    role: Role
    weight: float
    before: np.ndarray
    now: np.ndarray
    rows: np.ndarray
    columns: np.ndarray
    motion: np.ndarray
    contrast: float


@dataclass
class Warped:
    """Scores of one pair of frames.

    Attributes:
        before, now: the frames.
        features: what they were compared by.
        scores: variant -> score; infinite where most of the picture comes from outside.
        by_role: variant -> role -> score of that plane.
        unrelated: score of places chosen at random: what pictures that have nothing in common would get.
        moved: mean length of the stored motion.
    """

    before: Frame
    now: Frame
    features: list[Feature]
    scores: dict[Variant, float] = field(default_factory=dict)
    by_role: dict[Variant, dict[Role, float]] = field(default_factory=dict)
    unrelated: float = np.inf
    moved: float = 0.0

    @property
    def jitter(self) -> np.ndarray:
        """Jitter of this frame minus that of the previous one."""
        jitter: np.ndarray = np.array(self.now.jitter, np.float32) - np.array(self.before.jitter, np.float32)
        return jitter

    @property
    def as_it_is(self) -> float:
        """Score of the motion as it is stored."""
        return self.scores[VARIANTS[0]]

    @property
    def is_related(self) -> bool:
        """Whether any variant fits better than chance."""
        return min(self.scores.values()) < RELATED * self.unrelated


def warp_pair(before: Frame, now: Frame) -> Warped | None:
    """Scores of all variants; None without motion or where nothing has contrast."""
    features = features_of(before, now) if Role.MOTION in now else []
    if not features:
        return None
    result, size = Warped(before, now, features), (now.spec.width, now.spec.height)
    result.moved = float(np.linalg.norm(finite(now[Role.MOTION]), axis=-1).mean())
    for variant in VARIANTS:
        result.by_role[variant] = {
            f.role: _error(f, variant.fix(f.motion, size, result.jitter) + result.jitter) for f in features
        }
        result.scores[variant] = _mean(result.by_role[variant], features)
    result.unrelated = _unrelated(features)
    return result


def features_of(before: Frame, now: Frame) -> list[Feature]:
    """Planes that both frames hold and that have contrast; the later one has motion."""
    rng, motion, found = np.random.default_rng(1), finite(now[Role.MOTION]), []
    for role, weight in (*GUIDES, (Role.DEPTH, DEPTH_WEIGHT), (Role.COLOUR, COLOUR_WEIGHT)):
        if role in before and role in now:
            feature = _feature(role, weight, prepared(before, role), prepared(now, role), motion, rng)
            found += [feature] if feature else []
    return found


def prepared(frame: Frame, role: Role) -> np.ndarray:
    """A plane as it is compared: depth and blurred colour as logarithms, the others as they are."""
    plane = frame[role]
    if role is Role.DEPTH:
        result: np.ndarray = np.log(np.clip(np.nan_to_num(plane, nan=1e4), 1e-3, 1e4))
        return result
    if role is Role.COLOUR:
        light = np.maximum(luminance(finite(plane)), 0)[..., None]
        mean = float(light.mean()) or 1.0
        return local_mean(np.log(local_mean(np.minimum(light / mean, 1e3), 1) + np.float32(1e-2)), 1)
    return finite(plane)


def score_offset(features: list[Feature], offset: np.ndarray) -> float:
    """Score of the motion as it is plus one offset for the whole picture, in pixels."""
    errors = {f.role: _error(f, f.motion + np.float32(offset)) for f in features}
    return _mean(errors, features)


def _feature(role: Role, weight: float, before: np.ndarray, now: np.ndarray, motion: np.ndarray,
             rng: np.random.Generator) -> Feature | None:
    if min(now.shape[:2]) < 8:
        return None
    across = np.abs(np.diff(now, axis=1, append=now[:, -1:])).max(2)
    down = np.abs(np.diff(now, axis=0, append=now[-1:])).max(2)
    slope = across + down
    rows, columns = np.nonzero(slope > max(float(np.quantile(slope, CONTRASTY)), 1e-4))
    if rows.size < 100:
        return None
    chosen = rng.permutation(rows.size)[:POINTS]
    rows, columns = rows[chosen], columns[chosen]
    steepness = slope[rows, columns]
    contrast = float(np.minimum(steepness, np.quantile(steepness, 0.9)).mean())
    return Feature(role, weight, before, now[rows, columns], rows, columns, motion[rows, columns], contrast)


def _error(feature: Feature, shift: np.ndarray) -> float:
    x, y = feature.columns + shift[:, 0], feature.rows + shift[:, 1]
    inside = is_inside(feature.before, x, y)
    if inside.mean() < LEAST_INSIDE:
        return np.inf
    own = is_inside(feature.before, feature.columns + feature.motion[:, 0], feature.rows + feature.motion[:, 1])
    apart = np.abs(bilinear(feature.before, x, y) - feature.now)
    # what only this shift throws out counts, too, or it would throw out what it makes worse
    errors = apart.T.copy().max(0)[inside | own]  # a twentieth of the time of max(1)
    return float(np.sort(errors)[: int((1 - OCCLUDED) * errors.size)].mean() / feature.contrast)


def _mean(errors: dict[Role, float], features: list[Feature]) -> float:
    weights = {feature.role: feature.weight for feature in features}
    return sum(errors[role] * weights[role] for role in errors) / sum(weights.values())


def _unrelated(features: list[Feature]) -> float:
    rng, errors = np.random.default_rng(2), {}
    for feature in features:
        height, width = feature.before.shape[:2]
        places = rng.random((feature.rows.size, 2)) * (width - 1, height - 1)
        errors[feature.role] = _error(feature, places - np.stack([feature.columns, feature.rows], -1))
    return _mean(errors, features)
