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
    """A unit of stored motion: pixels = (stored + offset) * scale * size of `unit`, as profiles have it."""

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
    (-1, 1): ("motion-sign-x", "x negated"),
    (1, -1): ("motion-sign-y", "y negated"),
    (-1, -1): ("motion-sign", "both axes negated"),
}
_ENCODED = "motion was stored as a colour"
_UNITS = (
    *(_Unit(f"{factor:.3g} times as long", f"pixels of a picture {1 / factor:.3g} times as large were written", factor)
      for factor in SCALES),
    _Unit("in parts of the image (uv 0..1)", "parts of the image were written instead of pixels", unit="uv"),
    _Unit("in -1..1 of the image (ndc)", "normalised device coordinates were written instead of pixels", unit="ndc"),
    _Unit("in uv around 0.5, or ndc as (v + 1) / 2", _ENCODED, 1.0, "uv", -0.5, "motion-encoded"),
    _Unit("in uv as (v + 1) / 2", _ENCODED, 2.0, "uv", -0.5, "motion-encoded"),
)


def _pair(values: float | tuple[float, float]) -> np.ndarray:
    """One factor or one a channel, in the precision of the planes."""
    return np.asarray(values, np.float32)


def _signed(signs: tuple[int, int]) -> Variant:
    code, name = _SIGNS[signs]
    cause = {"": "", "motion-sign": "current minus previous, or motion to the next frame, was written"}.get(
        code, "the axis counts the other way, for example y up instead of down")
    return Variant(code, name or "as it is", cause, _profile(_Unit("", ""), signs) if code else "",
                   lambda motion, size, jitter: motion * _pair(signs), 1 if code else 0)


def _swapped(signs: tuple[int, int]) -> Variant:
    name = "x and y swapped" + (f", then {_SIGNS[signs][1]}" if signs != (1, 1) else "")
    also = f", scale = [{signs[0]}, {signs[1]}]" if signs != (1, 1) else ""
    return Variant("motion-axes", name, "the channels are in the order y, x", f'in a profile channels = ["YX"]{also}',
                   lambda motion, size, jitter: motion[..., ::-1] * _pair(signs), 3)


def _scaled(unit: _Unit, signs: tuple[int, int]) -> Variant:
    name = unit.name + (f", {_SIGNS[signs][1]}" if signs != (1, 1) else "")

    def fix(motion: np.ndarray, size: Size, jitter: np.ndarray) -> np.ndarray:
        result: np.ndarray = (motion + _pair(unit.offset)) * _pair(unit.factor(size)) * _pair(signs)
        return result

    return Variant(unit.code, name, unit.cause, _profile(unit, signs), fix, 2 if signs == (1, 1) else 3)


def _profile(unit: _Unit, signs: tuple[int, int]) -> str:
    """Keys of a profile's plane that put motion right which is read without them."""
    scale = [sign * unit.scale for sign in signs]
    keys = [f"offset = [{unit.offset:g}, {unit.offset:g}]"] if unit.offset else []
    keys += [f"scale = [{scale[0]:.4g}, {scale[1]:.4g}]"] if scale != [1, 1] else []
    keys += [f'unit = "{unit.unit}"'] if unit.unit != "pixels" else []
    return f"in a profile {', '.join(keys)}"


def _jittered(times: int | tuple[int, int], code: str, name: str, cause: str, mend: str) -> Variant:
    return Variant(code, name, cause, mend, lambda motion, size, jitter: motion + _pair(times) * jitter, 4)


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
    _jittered((0, -2), "jitter-sign", "right, with y of the header's jitter negated", "the header's jitter has y up",
              "negate y of postfx:jitter"),
    _jittered((-2, 0), "jitter-sign", "right, with x of the header's jitter negated",
              "x of the header's jitter is that of the projection", "negate x of postfx:jitter"),
    Variant("motion-worse-than-none", "0 everywhere", "vectors of another frame, or in a unit that is not known",
            "write the renderer's motion vectors for this frame, or leave the plane out",
            lambda motion, size, jitter: motion * 0, 5),
)
"""All variants; the first one is the motion as it is."""
