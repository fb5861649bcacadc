"""Common mistakes in motion vectors, how to correct each, and which correction fits the pictures.

Every variant of the motion warps the previous frame onto this one, and guides and colour score the
result. A score is the error of the warped pictures in units of what one pixel of misregistration
costs: 0 is a perfect fit. Only pixels with contrast count. The fifth of them that fits worst is
left out, to ignore occlusions, as are pixels that come from outside the picture.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cache
from typing import NamedTuple

import numpy as np

from postfx.colour import luminance
from postfx.doctor import finite, largest
from postfx.frame import Frame, Role
from postfx.kernels.image import compare_places
from postfx.sampling import is_inside, local_mean

Size = tuple[int, int]
PIXEL_SCALES = (0.5, 2.0, 2 / 3, 1 / 3)
"""Factors to pixels of the frame from pixels of an output twice as large, half as large, and so
on."""

ENCODED_SCALES = tuple(2 ** (step / 4) for step in range(8, 45))
"""Lengths in pixels that motion stored as a colour may span, in steps that the scores can tell
apart."""

COMPARED_POINTS = 1500
"""Pixels of a plane that are compared, at most."""
CONTRAST_QUANTILE = 0.75
"""They are drawn from the quarter with the most contrast."""
OCCLUDED_SHARE = 0.2
"""Share of the points, those that fit worst, that is left out."""
LEAST_INSIDE_SHARE = 0.5
"""Share of the points that must come from inside the picture."""
RELATED_SCORE_RATIO = 0.7
"""Pictures have something in common when their score is below this part of the score of chance."""
GUIDE_WEIGHTS = ((Role.DIFFUSE_ALBEDO, 1.0), (Role.SPECULAR_ALBEDO, 1.0), (Role.NORMAL, 1.0))

# Depth changes where the camera goes forward, colour is noisy
DEPTH_WEIGHT = 0.2
COLOUR_WEIGHT = 0.2


@dataclass(frozen=True)
class Variant:
    """One mistake that stored motion may hold, and its correction.

    Attributes:
        code: code of the finding; '' for the motion as it is.
        name: how the motion is stored, if this is the mistake.
        cause: the likely reason.
        fix: what to do with the stored values.
        correct: (..., 2) motion, size (width, height) and jitter difference -> (..., 2) motion in
            pixels of the frame.
        priority: of two variants that fit equally well, the finding names the one with the lower
            priority.
        is_colour: whether it makes sense only for motion within 0..1.
        change: the correction for a profile: whether axes are swapped, a factor for each, and a
            unit; None where a profile cannot say it.
    """

    code: str
    name: str
    cause: str
    fix: str
    correct: Callable[[np.ndarray, Size, np.ndarray], np.ndarray]
    priority: int = 0
    is_colour: bool = False
    change: tuple[bool, tuple[float, float], str] | None = None


@dataclass(frozen=True)
class _Unit:
    """A unit of stored motion: pixels = (stored + offset) * scale * size of `unit`, as profiles
    have it."""

    name: str
    cause: str
    scale: float = 1.0
    unit: str = "pixels"
    offset: float = 0.0
    code: str = "motion-scale"

    def factor(self, size: Size) -> tuple[float, float]:
        part = {"pixels": (1.0, 1.0), "uv": size, "ndc": (size[0] / 2, size[1] / 2)}[self.unit]
        return self.scale * part[0], self.scale * part[1]


_SIGNS = {
    (1, 1): ("", ""),
    (-1, 1): ("motion-sign-x", "negated in x"),
    (1, -1): ("motion-sign-y", "negated in y"),
    (-1, -1): ("motion-sign", "negated in x and y"),
}
_STORED_AS_COLOUR = "motion was stored as a colour"
_UNIT_VARIANTS = (
    *(_Unit(f"{factor:.3g} times as long",
            f"pixels of a picture {1 / factor:.3g} times as large were written", factor)
      for factor in PIXEL_SCALES),
    _Unit("as a fraction of the image (uv 0..1)",
          "fractions of the image were written instead of pixels", unit="uv"),
    _Unit("in -1..1 of the image (ndc)",
          "normalised device coordinates were written instead of pixels", unit="ndc"),
    _Unit("in uv around 0.5, or ndc as (v + 1) / 2", _STORED_AS_COLOUR, 1.0, "uv", -0.5,
          "motion-encoded"),
    _Unit("in uv as (v + 1) / 2", _STORED_AS_COLOUR, 2.0, "uv", -0.5, "motion-encoded"),
    *(_Unit(f"in pixels as v / {scale:.3g} + 0.5", _STORED_AS_COLOUR, scale, offset=-0.5,
            code="motion-encoded")
      for scale in ENCODED_SCALES),
)


def _pair(values: float | tuple[float, float]) -> np.ndarray:
    """One factor or one a channel, in the precision of the planes."""
    return np.asarray(values, np.float32)


def _signed(signs: tuple[int, int]) -> Variant:
    """The stored motion with other signs of its axes, or as it is."""
    code, name = _SIGNS[signs]
    if not code:
        name, cause, fix, priority = "as it is", "", "", 0
    else:
        cause = ("current minus previous, or motion to the next frame, was written"
                 if code == "motion-sign"
                 else "the axis counts the other way, for example y up instead of down")
        fix, priority = _profile(_Unit("", ""), signs), 1
    return Variant(code, name, cause, fix, lambda motion, size, jitter: motion * _pair(signs),
                   priority, change=(False, signs, "pixels"))


def _swapped(signs: tuple[int, int]) -> Variant:
    name = "swapped, x for y" + (f", then {_SIGNS[signs][1]}" if signs != (1, 1) else "")
    also = f", scale = [{signs[0]}, {signs[1]}]" if signs != (1, 1) else ""
    return Variant("motion-axes", name, "the channels are in the order y, x",
                   f'in a profile channels = ["YX"]{also}',
                   lambda motion, size, jitter: motion[..., ::-1] * _pair(signs), 3,
                   change=(True, signs, "pixels"))


def _scaled(unit: _Unit, signs: tuple[int, int]) -> Variant:
    name = unit.name + (f", {_SIGNS[signs][1]}" if signs != (1, 1) else "")

    def correct(motion: np.ndarray, size: Size, jitter: np.ndarray) -> np.ndarray:
        result: np.ndarray = (motion + _pair(unit.offset)) * _pair(unit.factor(size)) * _pair(signs)
        return result

    priority = (2 if signs == (1, 1) else 3) + (unit.unit == "pixels" and unit.offset != 0)
    change = None if unit.offset else (False, (unit.scale * signs[0], unit.scale * signs[1]),
                                       unit.unit)
    return Variant(unit.code, name, unit.cause, _profile(unit, signs), correct, priority,
                   unit.offset != 0, change)


def _profile(unit: _Unit, signs: tuple[int, int]) -> str:
    """Keys of a profile's plane that correct motion which was read without them."""
    scale = [sign * unit.scale for sign in signs]
    keys = [f"offset = [{unit.offset:g}, {unit.offset:g}]"] if unit.offset else []
    keys += [f"scale = [{scale[0]:.4g}, {scale[1]:.4g}]"] if scale != [1, 1] else []
    keys += [f'unit = "{unit.unit}"'] if unit.unit != "pixels" else []
    return f"in a profile {', '.join(keys)}"


def _rescaled_jitter(name: str, fix: str, factor: Callable[[Size], tuple[float, float]]) -> Variant:
    def change(motion: np.ndarray, size: Size, jitter: np.ndarray) -> np.ndarray:
        result: np.ndarray = motion + (_pair(factor(size)) - 1) * jitter
        return result

    return Variant("jitter-unit", f"right, with the jitter of the header {name}",
                   "the header's jitter is not in pixels", fix, change, 4)


def _jittered(times: int | tuple[int, int], code: str, name: str, cause: str, fix: str) -> Variant:
    return Variant(code, name, cause, fix,
                   lambda motion, size, jitter: motion + _pair(times) * jitter, 4)


_SIGN_PAIRS = tuple(_SIGNS)
VARIANTS = (
    *(_signed(signs) for signs in _SIGN_PAIRS),
    *(_swapped(signs) for signs in _SIGN_PAIRS),
    *(_scaled(unit, signs) for unit in _UNIT_VARIANTS for signs in _SIGN_PAIRS),
    _jittered(-1, "motion-jitter", "without the jitter's change",
              "motion was taken between jittered positions",
              "compute motion with matrices that hold no jitter, or add the previous jitter minus "
              "this one's"),
    _jittered(1, "motion-jitter", "without the jitter's change, taken twice with the wrong sign",
              "the jitter was taken off with the wrong sign",
              "compute motion with matrices that hold no jitter"),
    _jittered(-2, "jitter-sign", "right, with the jitter of the header negated",
              "the header's jitter shifts the projection, not the sample",
              "negate postfx:jitter (both axes)"),
    _jittered((0, -2), "jitter-sign", "right, with y of the header's jitter negated",
              "the header's jitter has y up", "negate y of postfx:jitter"),
    _jittered((-2, 0), "jitter-sign", "right, with x of the header's jitter negated",
              "x of the header's jitter shifts the projection, not the sample",
              "negate x of postfx:jitter"),
    _rescaled_jitter("as a fraction of the image (uv)",
                     "multiply postfx:jitter by the picture's size",
                     lambda size: (size[0], size[1])),
    _rescaled_jitter("in -1..1 of the image (ndc)",
                     "multiply postfx:jitter by half the picture's size",
                     lambda size: (size[0] / 2, size[1] / 2)),
    _rescaled_jitter("in -1..1 of the image (ndc) with y up",
                     "multiply postfx:jitter by half the picture's size, and negate y",
                     lambda size: (size[0] / 2, -size[1] / 2)),
    _rescaled_jitter("twice as long", "multiply postfx:jitter by 2: it counts from -0.5 to 0.5",
                     lambda size: (2, 2)),
    _rescaled_jitter("half as long", "divide postfx:jitter by 2: it counts from -0.5 to 0.5",
                     lambda size: (0.5, 0.5)),
    Variant("motion-worse-than-none", "0 everywhere",
            "vectors of another frame, or in a unit that is not known",
            "write the renderer's motion vectors for this frame, or delete the AOV",
            lambda motion, size, jitter: motion * 0, 5),
)
"""All variants; the first is the stored motion."""


class Feature(NamedTuple):
    """A plane of the earlier frame, and its pixels with contrast in the later one, with their
    values and motion."""

    role: Role
    weight: float
    before: np.ndarray
    now: np.ndarray
    rows: np.ndarray
    columns: np.ndarray
    motion: np.ndarray
    contrast: float


@dataclass
class PairScores:
    """Scores of one pair of frames.

    Attributes:
        before, now: the frames.
        size: width and height of the pictures that they are, or are windows of.
        features: the planes that they were compared by.
        scores: variant -> score; infinite if most of the picture comes from outside.
        by_role: variant -> role -> score of that plane.
        unrelated: score of positions chosen at random: the score of pictures that have nothing in
            common.
        moved: mean length of the stored motion.
    """

    before: Frame
    now: Frame
    size: Size
    features: list[Feature]
    scores: dict[Variant, float] = field(default_factory=dict)
    by_role: dict[Variant, dict[Role, float]] = field(default_factory=dict)
    unrelated: float = np.inf
    moved: float = 0.0

    @property
    def jitter(self) -> np.ndarray:
        """Jitter of this frame minus that of the previous one."""
        jitter: np.ndarray = np.array(self.now.jitter, np.float32) - np.array(self.before.jitter,
                                                                              np.float32)
        return jitter

    def errors(self, variants: Sequence[Variant]) -> dict[Role, np.ndarray]:
        """Role -> errors (count,) of that plane, of variants."""
        jitter = float(self.jitter[0]), float(self.jitter[1])
        return {feature.role: _errors_of_variants(feature, variants, self.size, jitter)
                for feature in self.features}

    @property
    def as_it_is(self) -> float:
        """Score of the stored motion."""
        return self.scores[VARIANTS[0]]

    @property
    def is_related(self) -> bool:
        """Whether any variant fits better than chance."""
        return min(self.scores.values()) < RELATED_SCORE_RATIO * self.unrelated


def warp_pair(before: Frame, now: Frame, size: Size | None = None) -> PairScores | None:
    """Scores of all variants; None without motion or without contrast. size: of the pictures that
    these are windows of, if they are."""
    features = features_of(before, now) if Role.MOTION in now else []
    if not features:
        return None
    result = PairScores(before, now, size or (now.spec.width, now.spec.height), features)
    result.moved = float(np.linalg.norm(finite(now[Role.MOTION]), axis=-1).mean())
    colour_like = is_like_colour(now)
    tried = [variant for variant in VARIANTS if colour_like or not variant.is_colour]
    errors = result.errors(tried)
    for number, variant in enumerate(tried):
        result.by_role[variant] = {role: float(values[number]) for role, values in errors.items()}
        result.scores[variant] = _mean(result.by_role[variant], features)
    result.unrelated = _unrelated(features)
    return result


def is_like_colour(frame: Frame) -> bool:
    """Whether motion lies within 0..1 and mostly near 0.5: only then can it be stored as a
    colour."""
    motion = finite(frame[Role.MOTION])
    return bool(motion.min() >= 0 and motion.max() <= 1.001
                and 0.2 < float(np.median(motion)) < 0.8)


def score_variants(warped: PairScores, variants: Sequence[Variant]) -> dict[Variant, float]:
    """Scores of variants, which need not be of `VARIANTS`."""
    by_role = warped.errors(variants)
    return {variant: _mean({role: float(errors[number]) for role, errors in by_role.items()},
                           warped.features)
            for number, variant in enumerate(variants)}


@cache
def scaled_variants() -> tuple[Variant, ...]:
    """Variants for motion in an unknown unit of 1/128 to 128 pixels, in steps of the root of 2."""
    units = [_Unit(f"about {factor:.3g} times as long",
                   "motion was written in a unit that is not pixels of the frame, for example for "
                   "each second or for a picture of another size", factor)
             for factor in (2 ** (step / 2) for step in range(-14, 15)) if factor != 1]
    return tuple(_scaled(unit, signs) for unit in units for signs in _SIGN_PAIRS)


def features_of(before: Frame, now: Frame) -> list[Feature]:
    """Planes with contrast that both frames hold; the later frame has motion."""
    motion = now[Role.MOTION]
    found = []
    for role, weight in (*GUIDE_WEIGHTS, (Role.DEPTH, DEPTH_WEIGHT), (Role.COLOUR, COLOUR_WEIGHT)):
        if role in before and role in now:
            feature = _feature(role, weight, prepare_plane(before, role), prepare_plane(now, role),
                               motion)
            found += [feature] if feature else []
    return found


def prepare_plane(frame: Frame, role: Role) -> np.ndarray:
    """A plane in the form that is compared: depth and blurred colour as logarithms, the others
    unchanged."""
    plane = frame[role]
    if role is Role.DEPTH:
        result: np.ndarray = np.log(np.clip(np.nan_to_num(plane, nan=1e4), 1e-3, 1e4))
        return result
    if role is Role.COLOUR:
        light = np.maximum(luminance(finite(plane)), 0)[..., None]
        mean = float(light.mean()) or 1.0
        return local_mean(np.log(local_mean(np.minimum(light / mean, 1e3), 1) + np.float32(1e-2)),
                          1)
    return finite(plane)


def score_shifts(features: list[Feature], shifts: Callable[[Feature], np.ndarray]) -> np.ndarray:
    """Scores (count,) of motions; `shifts` gives those of a feature's points in pixels, (count,
    points, 2)."""
    weights = sum(feature.weight for feature in features)
    scores = [feature.weight * _errors(feature, shifts(feature)) for feature in features]
    total: np.ndarray = np.sum(scores, axis=0)
    return total / weights


def score_offset(features: list[Feature], offset: np.ndarray) -> float:
    """Score of the stored motion plus one offset for the whole picture, in pixels."""
    errors = {f.role: _error(f, f.motion + np.float32(offset)) for f in features}
    return _mean(errors, features)


def _feature(role: Role, weight: float, before: np.ndarray, now: np.ndarray,
             motion: np.ndarray) -> Feature | None:
    """Pixels with contrast of a plane; None where there are too few."""
    if min(now.shape[:2]) < 8:
        return None
    across = largest(np.abs(np.diff(now, axis=1, append=now[:, -1:])))
    down = largest(np.abs(np.diff(now, axis=0, append=now[-1:])))
    slope = across + down
    rows, columns = np.nonzero(slope > max(float(np.quantile(slope, CONTRAST_QUANTILE)), 1e-4))
    if rows.size < 100:
        return None
    chosen = np.random.default_rng(1).permutation(rows.size)[:COMPARED_POINTS]
    rows, columns = rows[chosen], columns[chosen]
    steepness = slope[rows, columns]
    contrast = float(np.minimum(steepness, np.quantile(steepness, 0.9)).mean())
    return Feature(role, weight, np.ascontiguousarray(before, np.float32),
                   now[rows, columns].astype(np.float32),
                   rows.astype(np.float32), columns.astype(np.float32),
                   finite(motion[rows, columns]), contrast)


def _errors(feature: Feature, shifts: np.ndarray) -> np.ndarray:
    """Scores (count,) of shifts (count, points, 2); infinite if most points come from outside the
    picture."""
    x = (feature.columns + shifts[..., 0]).astype(np.float32)
    y = (feature.rows + shifts[..., 1]).astype(np.float32)
    inside, apart = np.empty(x.shape, bool), np.empty(x.shape, np.float32)
    compare_places(feature.before, feature.now, x, y, apart, inside)
    own = is_inside(feature.before, feature.columns + feature.motion[:, 0],
                    feature.rows + feature.motion[:, 1])
    # Points that only this shift moves outside count, too: otherwise a shift could hide where it
    # fits worse.
    used = inside | own
    apart[~used] = np.inf
    apart.sort(axis=1)
    kept = np.maximum(((1 - OCCLUDED_SHARE) * used.sum(1)).astype(int), 1)
    sums = np.where(np.arange(apart.shape[1]) < kept[:, None], apart, 0).sum(1)
    result: np.ndarray = np.where(inside.mean(1) < LEAST_INSIDE_SHARE, np.inf,
                                  sums / kept / feature.contrast)
    return result


def _errors_of_variants(
    feature: Feature, variants: Sequence[Variant], size: Size, jitter: tuple[float, float]
) -> np.ndarray:
    """Scores (count,) of variants of the stored motion."""
    offset = np.array(jitter, np.float32)
    return _errors(feature, np.stack([one.correct(feature.motion, size, offset) + offset
                                      for one in variants]))


def _error(feature: Feature, shift: np.ndarray) -> float:
    return float(_errors(feature, shift[None])[0])


def _mean(errors: dict[Role, float], features: list[Feature]) -> float:
    weights = {feature.role: feature.weight for feature in features}
    return sum(errors[role] * weights[role] for role in errors) / sum(weights.values())


def _unrelated(features: list[Feature]) -> float:
    """Score of positions chosen at random."""
    rng = np.random.default_rng(2)
    errors = {}
    for feature in features:
        height, width = feature.before.shape[:2]
        places = rng.random((feature.rows.size, 2), np.float32) * _pair((width - 1, height - 1))
        errors[feature.role] = _error(feature,
                                      places - np.stack([feature.columns, feature.rows], -1))
    return _mean(errors, features)
