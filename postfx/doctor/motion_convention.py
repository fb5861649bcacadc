"""Find the convention of motion that no profile reads, and give it as lines to copy into a profile.

Stored values become pixels by (stored + offset) * scale * unit, perhaps with swapped channels. All
signs and orders of the axes are tried with a range of scales, in pixels and in parts of the image,
by warping the previous frame as `postfx.doctor.motion_variants` does. The best convention is
refined; a common unit that fits as well takes its place.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from postfx.doctor import finite
from postfx.doctor.motion_variants import Feature, Size, features_of, is_like_colour, score_shifts
from postfx.frame import Frame, Role
from postfx.io.profile import PlaneRule

MOST_TRIED_PAIRS = 3
"""Pairs of frames that conventions are tried on."""
TELLING_STILL_MISFIT = 0.05
"""Least misfit without motion, in units of what one pixel costs: below, too little moves."""
MOST_KEPT = 8
"""Conventions that are tried on all pairs, of those that fit the first pair best."""

# Lengths in pixels that are tried for the 95th percentile of the motion.
SHORTEST_TRIED_PX = 0.25
LONGEST_TRIED_PX = 128.0

COARSE_FACTOR = 2**0.5
FINE_FACTORS = (2**0.25, 2**0.125, 2**0.0625, 2**0.03125)

# Logarithm of the factor by which a common unit may be off, along both axes and along the axis
# that moves more.
WIDE_UNIT_LOG = 0.17
NARROW_UNIT_LOG = 0.1

ALIKE_MISFIT_RATIO = 1.08
"""A common unit takes the place of the best fit if its misfit is at most this many times as
large."""

# Motion is understood if its misfit is below this part of the misfit without motion: in any unit,
# in a common one.
FITTING_MISFIT_SHARE = 0.7
FITTING_COMMON_MISFIT_SHARE = 0.87

_SIGN_CHOICES = ((1, 1), (1, -1), (-1, 1), (-1, -1))


@dataclass(frozen=True)
class UnreadMotion:
    """A layer that may be motion.

    Attributes:
        layer: full name in the file.
        letters: names of its first two channels, in the order of the file's axes.
        planes: stored values (height, width, 2), one for each frame that was looked at.
        profile: name of the profile that does not read it.
    """

    layer: str
    letters: tuple[str, str]
    planes: tuple[np.ndarray, ...]
    profile: str = "generic"


@dataclass(frozen=True)
class ReadMotion:
    """Motion that a profile reads: its layer, the letters of its channels, and the rule by which
    they become pixels."""

    profile: str
    layer: str
    letters: tuple[str, str]
    rule: PlaneRule

    def correct(self, swapped: bool, scale: tuple[float, float], unit: str) -> str | None:
        """A profile that swaps, then scales the motion as it is read now, and takes it as in
        `unit`; None where no profile can say that."""
        if unit != "pixels" and self.rule.unit != "pixels":
            return None
        own_scale = np.broadcast_to(self.rule.scale, 2)
        offset = np.broadcast_to(self.rule.offset, 2)
        if swapped:
            own_scale, offset = own_scale[::-1], offset[::-1]
        x, y = np.multiply(own_scale, scale)
        lines = profile_lines(self.profile, self.layer, self.letters, swapped,
                              self.rule.unit if unit == "pixels" else unit, offset,
                              (round_to(float(x)), round_to(float(y))))
        return f'{lines}\nper = "shutter"' if self.rule.per == "shutter" else lines


class Convention(NamedTuple):
    """How stored motion becomes pixels to the previous frame, x right, y down; `offset` is added
    first."""

    swapped: bool
    signs: tuple[int, int]
    unit: str
    factor: float = 1.0
    offset: float = 0.0

    def pixels(self, stored: np.ndarray, size: Size) -> np.ndarray:
        """Motion (..., 2) in pixels of a picture of this size."""
        motion = (stored[..., ::-1] if self.swapped else stored) + np.float32(self.offset)
        unit = np.asarray(unit_size(self.unit, size), np.float32)
        signs = np.asarray(self.signs, np.float32)
        found: np.ndarray = motion * np.float32(self.factor) * unit * signs
        return found

    def lines(self, motion: UnreadMotion) -> str:
        """A profile that reads a layer by this convention."""
        scale = [round_to(sign * self.factor) for sign in self.signs]
        return profile_lines(motion.profile, motion.layer, motion.letters, self.swapped, self.unit,
                             (self.offset,) * 2, (scale[0], scale[1]))

    def __str__(self) -> str:
        words = {"pixels": "pixels", "uv": "fractions of the image (uv)",
                 "ndc": "-1..1 of the image (ndc)", "width": "fractions of the image's width"}
        way = {(1, 1): "", (-1, 1): ", x the other way", (1, -1): ", y the other way",
               (-1, -1): ", both the other way"}
        times = f" times {self.factor:.3g}" if abs(self.factor - 1) > 1e-6 else ""
        still = f", {-self.offset:g} is still" if self.offset else ""
        return (f"{words[self.unit]}{times}{still}{way[self.signs]}"
                f"{', y before x' if self.swapped else ''}")


class Measurement(NamedTuple):
    """The convention that fits best, its misfit, the misfit without motion, and whether a renderer
    uses it."""

    convention: Convention
    misfit: float
    still: float
    is_common: bool

    @property
    def fits(self) -> bool:
        """Whether the pictures move, and the convention explains how."""
        share = FITTING_COMMON_MISFIT_SHARE if self.is_common else FITTING_MISFIT_SHARE
        return self.still > TELLING_STILL_MISFIT and self.misfit < share * self.still


def unit_size(unit: str, size: Size) -> tuple[float, float]:
    """Pixels that a stored 1 means, across and down."""
    width, height = size
    return {"pixels": (1.0, 1.0), "uv": (width, height), "ndc": (width / 2, height / 2),
            "width": (width, width)}[unit]


def measure_convention(frames: Sequence[Frame], motion: UnreadMotion) -> Measurement | None:
    """The convention of a layer in these frames; None without two frames of one shot that have
    contrast."""
    shown = [replace(frame, planes={**frame.planes, Role.MOTION: finite(plane)})
             for frame, plane in zip(frames, motion.planes, strict=False)]
    pairs = [_Pair(before, now) for before, now in zip(shown, shown[1:], strict=False)
             if not now.reset and before.spec.width == now.spec.width
             and before.spec.height == now.spec.height]
    pairs = [pair for pair in pairs if pair.features][:MOST_TRIED_PAIRS]
    if not pairs:
        return None
    tried = _coarse(pairs, 0.0)
    if all(is_like_colour(pair.now) for pair in pairs):
        tried += _coarse(pairs, -0.5)
    if not tried:
        return None
    rough = pairs[0].scores(tried)
    best = _best(pairs, [tried[at] for at in np.argsort(rough)[:MOST_KEPT]])[0]
    for step in FINE_FACTORS:
        best = _best(pairs, [best._replace(factor=best.factor * step**power)
                             for power in (-2, -1, 0, 1, 2)])[0]
    best, misfit = _best(pairs, [best])
    common = [one for one in _common(best, pairs[0].size)
              if _misfit(pairs, one) <= ALIKE_MISFIT_RATIO * misfit]
    still = float(np.mean([pair.score_still() for pair in pairs]))
    chosen = common[0] if common else best._replace(factor=round_to(best.factor, 3))
    # coded pixels are in parts of a largest velocity, which may be any
    is_common = bool(common) or (chosen.offset != 0 and chosen.unit == "pixels")
    return Measurement(chosen, _misfit(pairs, chosen), still, is_common)


class _Pair:
    """Two frames; the later one holds stored motion."""

    def __init__(self, before: Frame, now: Frame) -> None:
        self.now, self.size = now, (now.spec.width, now.spec.height)
        self.features = features_of(before, now)
        self._jitter = np.subtract(now.jitter, before.jitter).astype(np.float32)

    def scores(self, conventions: Sequence[Convention]) -> np.ndarray:
        """Misfit of each convention."""
        def shifts(feature: Feature) -> np.ndarray:
            return (np.stack([one.pixels(feature.motion, self.size) for one in conventions])
                    + self._jitter)

        return score_shifts(self.features, shifts)

    def score_still(self) -> float:
        """Misfit if nothing moves."""
        return float(score_shifts(self.features, lambda feature: np.zeros_like(feature.motion)[None]
                                  + self._jitter)[0])


def _coarse(pairs: Sequence[_Pair], offset: float) -> list[Convention]:
    """All signs, orders and units, with scales that give the motion a likely length."""
    stored = np.concatenate([np.abs(pair.now[Role.MOTION] + np.float32(offset)).reshape(-1)
                             for pair in pairs])
    length = float(np.quantile(stored, 0.95))
    if length < 1e-12:
        return []
    width, height = pairs[0].size
    found = []
    for unit in ("pixels", "uv"):
        unit_px = 1.0 if unit == "pixels" else (width + height) / 2
        steps = int(np.log(LONGEST_TRIED_PX / SHORTEST_TRIED_PX) / np.log(COARSE_FACTOR)) + 1
        least = SHORTEST_TRIED_PX / length / unit_px
        factors = [least * COARSE_FACTOR**step for step in range(steps)]
        found += [Convention(swapped, signs, unit, factor, offset)
                  for factor in factors for swapped in (False, True) for signs in _SIGN_CHOICES]
    return found


def _best(pairs: Sequence[_Pair], conventions: Sequence[Convention]) -> tuple[Convention, float]:
    """The convention that fits all pairs best, and its misfit."""
    scores = np.mean([pair.scores(conventions) for pair in pairs], axis=0)
    at = int(np.argmin(scores))
    return conventions[at], float(scores[at])


def _misfit(pairs: Sequence[_Pair], convention: Convention) -> float:
    return float(np.mean([pair.scores([convention])[0] for pair in pairs]))


def _common(best: Convention, size: Size) -> list[Convention]:
    """Conventions of renderers near the one that fits best, the most common first."""
    units = [("pixels", 1.0), ("uv", 1.0), ("ndc", 1.0), ("uv", 2.0), ("width", 1.0),
             ("pixels", 2.0)]
    near = [best._replace(unit=unit, factor=factor) for unit, factor in units]
    own = np.multiply(unit_size(best.unit, size), best.factor)
    apart = [np.abs(np.log(np.multiply(unit_size(one.unit, size), one.factor) / own))
             for one in near]
    return [one for one, each in zip(near, apart, strict=True)
            if each.max() < WIDE_UNIT_LOG or each.min() < NARROW_UNIT_LOG]


def round_to(value: float, digits: int = 4) -> float:
    """Round a number to significant digits."""
    return float(f"{value:.{digits}g}")


def plane_lines(profile: str, role: Role, layer: str, letters: Sequence[str]) -> list[str]:
    """Lines of TOML of a profile that extends another one by a plane in a layer, whose channels are
    in this order."""
    return [f"extends = {json.dumps(profile)}", "[[plane]]", f'role = "{role}"',
            f"names = [{json.dumps(layer)}]", f"channels = [{json.dumps(list(letters))}]"]


def profile_lines(
    profile: str, layer: str, letters: Sequence[str], swapped: bool, unit: str,
    offset: Iterable[float], scale: tuple[float, float]
) -> str:
    """TOML of a profile that extends another one by motion in a layer; channels are in the order x,
    y."""
    order = list(letters)[::-1] if swapped else list(letters)
    lines = plane_lines(profile, Role.MOTION, layer, order)
    if any(offset := list(offset)):
        lines.append(f"offset = [{offset[0]:g}, {offset[1]:g}]")
    if scale != (1, 1):
        lines.append(f"scale = [{scale[0]:g}, {scale[1]:g}]")
    lines += [f'unit = "{unit}"'] if unit != "pixels" else []
    return "\n".join(lines)
