"""Ways in which motion vectors are commonly wrong, and how each is put right."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

Size = tuple[int, int]
SCALES = (0.5, 2.0, 2 / 3, 1 / 3)
"""Factors to pixels of the frame: from pixels of an output twice as large, of one half as large, and so on."""


@dataclass(frozen=True)
class Variant:
    """What could make stored motion right.

    Attributes:
        code: finding that it leads to; '' for the motion as it is.
        name: what the motion would have to be.
        cause: what was done to it.
        mend: what to do with the stored values.
        fix: (..., 2) motion, size (width, height) and jitter difference -> (..., 2) motion in pixels of the frame.
        priority: of two variants that fit alike, the lower one is named.
    """

    code: str
    name: str
    cause: str
    mend: str
    fix: Callable[[np.ndarray, Size, np.ndarray], np.ndarray]
    priority: int = 0


@dataclass(frozen=True)
class _Unit:
    name: str
    mend: str
    factor: Callable[[Size], tuple[float, float]]
    offset: float = 0.0
    code: str = "motion-scale"


_SIGNS = {
    (1, 1): ("", "", ""),
    (-1, 1): ("motion-sign-x", "x negated", "scale = [-1, 1]"),
    (1, -1): ("motion-sign-y", "y negated", "scale = [1, -1]"),
    (-1, -1): ("motion-sign", "both axes negated", "scale = [-1, -1]"),
}


def _uniform(factor: float) -> Callable[[Size], tuple[float, float]]:
    return lambda size: (factor, factor)


_UNITS = (
    *(_Unit(f"{factor:.3g} times as long", f"scale by {factor:.3g}", _uniform(factor)) for factor in SCALES),
    _Unit("in parts of the image (uv 0..1)", 'unit = "uv"', lambda size: (float(size[0]), float(size[1]))),
    _Unit("in -1..1 of the image (ndc)", 'unit = "ndc"', lambda size: (size[0] / 2, size[1] / 2)),
    _Unit("in uv, stored around 0.5", 'offset = [-0.5, -0.5], unit = "uv"',
          lambda size: (float(size[0]), float(size[1])), -0.5, "motion-encoded"),
    _Unit("in ndc, stored around 0.5", 'offset = [-0.5, -0.5], scale = [2, 2], unit = "ndc"',
          lambda size: (float(size[0]), float(size[1])), -0.5, "motion-encoded"),
)


def _signed(signs: tuple[int, int]) -> Variant:
    code, name, mend = _SIGNS[signs]
    cause = {"motion-sign": "current minus previous, or motion to the next frame, was written"}.get(
        code, "the axis counts the other way, for example y up instead of down")
    return Variant(code, name or "as it is", cause if code else "", mend and f"in a profile {mend}",
                   lambda motion, size, jitter: motion * np.float32(signs), 0 if not code else 1)


def _swapped(signs: tuple[int, int]) -> Variant:
    name = "x and y swapped" + (f", then {_SIGNS[signs][1]}" if _SIGNS[signs][1] else "")
    return Variant("motion-axes", name, "the channels are in the order y, x", "in a profile channels in the order y, x",
                   lambda motion, size, jitter: motion[..., ::-1] * np.float32(signs), 3)


def _scaled(unit: _Unit, signs: tuple[int, int]) -> Variant:
    name = unit.name + (f", {_SIGNS[signs][1]}" if _SIGNS[signs][1] else "")
    mend = unit.mend + (f" and {_SIGNS[signs][2]}" if _SIGNS[signs][2] else "")

    def fix(motion: np.ndarray, size: Size, jitter: np.ndarray) -> np.ndarray:
        return (motion + np.float32(unit.offset)) * np.float32(unit.factor(size)) * np.float32(signs)

    return Variant(unit.code, name, "the unit is not pixels of this frame", f"in a profile {mend}", fix,
                   2 if signs == (1, 1) else 3)


def _jittered(times: int, code: str, name: str, cause: str, mend: str) -> Variant:
    return Variant(code, name, cause, mend, lambda motion, size, jitter: motion + times * jitter, 4)


_SIGN_PAIRS = tuple(_SIGNS)
VARIANTS = (
    *(_signed(signs) for signs in _SIGN_PAIRS),
    *(_swapped(signs) for signs in _SIGN_PAIRS),
    *(_scaled(unit, signs) for unit in _UNITS for signs in _SIGN_PAIRS),
    _jittered(-1, "motion-jitter", "without the jitter's change", "motion was taken between jittered positions",
              "compute motion with matrices that hold no jitter, or add jitter of the frame before minus this one's"),
    _jittered(1, "motion-jitter", "without the jitter's change, taken twice with the wrong sign",
              "the jitter was taken off with the wrong sign", "compute motion with matrices that hold no jitter"),
    _jittered(-2, "jitter-sign", "right, with the jitter of the header negated",
              "the header's jitter is that of the projection, not of the sample", "negate postfx:jitter (both axes)"),
    Variant("motion-worse-than-none", "0 everywhere", "vectors of another frame, or in a unit that is not known",
            "write the renderer's motion vectors for this frame, or leave the plane out",
            lambda motion, size, jitter: motion * 0, 5),
)
"""All variants; the first one is the motion as it is."""
