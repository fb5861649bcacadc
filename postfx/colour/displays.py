"""Displays: primaries, transfer function, and the brightness of white.

Transfer functions take light 0..1 to code values 0..1 and back, on arrays of any shape.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, cached_property
from typing import NamedTuple

import numpy as np

from postfx.colour import LUMA_REC2020, P3_D65, REC709, REC2020, Chromaticities
from postfx.errors import ColourError, offer

PQ_NITS = 10000.0
"""Light of the PQ code value 1, cd/m2."""
_M1 = 2610 / 16384
_M2 = 2523 / 4096 * 128
_C1 = 3424 / 4096
_C2 = 2413 / 4096 * 32
_C3 = 2392 / 4096 * 32
# Constants of HLG (ITU-R BT.2100-2, table 5).
_A = 0.17883277
_B = 1 - 4 * _A
_C = 0.5 - _A * np.log(4 * _A)


class Curve(NamedTuple):
    """A transfer function: light in [0, 1] to code values in [0, 1], and its inverse. Values
    outside are clipped."""

    encode: Callable[[np.ndarray], np.ndarray]
    decode: Callable[[np.ndarray], np.ndarray]


def srgb_encode(linear: np.ndarray) -> np.ndarray:
    """Display-linear light 0..1 -> sRGB code values 0..1; negative light becomes 0. float64 stays,
    else float32."""
    linear = np.maximum(_floats(linear), 0)
    return np.where(linear <= 0.0031308, 12.92 * linear,
                    1.055 * np.maximum(linear, 0.0031308) ** (1 / 2.4) - 0.055)


def srgb_decode(encoded: np.ndarray) -> np.ndarray:
    """sRGB code values 0..1 -> display-linear light 0..1; negative codes become 0. float64 stays,
    else float32."""
    encoded = np.maximum(_floats(encoded), 0)
    return np.where(encoded <= 0.04045, encoded / 12.92,
                    ((np.maximum(encoded, 0.04045) + 0.055) / 1.055) ** 2.4)


def _floats(values: np.ndarray) -> np.ndarray:
    values = np.asarray(values)
    return values if values.dtype == np.float64 else values.astype(np.float32, copy=False)


def _unit(values: np.ndarray) -> np.ndarray:
    clipped: np.ndarray = np.clip(np.nan_to_num(values), 0, 1)
    return clipped


def _pq_encode(light: np.ndarray) -> np.ndarray:
    light = _unit(light).astype(np.float64)
    power = light**_M1
    return np.where(light > 0, ((_C1 + _C2 * power) / (1 + _C3 * power)) ** _M2, 0.0)


def _pq_decode(codes: np.ndarray) -> np.ndarray:
    power = _unit(codes).astype(np.float64) ** (1 / _M2)
    light: np.ndarray = (np.maximum(power - _C1, 0) / (_C2 - _C3 * power)) ** (1 / _M1)
    return light


def _hlg_encode(light: np.ndarray) -> np.ndarray:
    light = _unit(light).astype(np.float64)
    bright: np.ndarray = _A * np.log(np.maximum(12 * light - _B, 1e-9)) + _C
    return np.where(light <= 1 / 12, np.sqrt(3 * light), bright)


def _hlg_decode(codes: np.ndarray) -> np.ndarray:
    codes = _unit(codes).astype(np.float64)
    return np.where(codes <= 0.5, codes**2 / 3, (np.exp((codes - _C) / _A) + _B) / 12)


SRGB = Curve(lambda light: srgb_encode(_unit(light)), lambda codes: srgb_decode(_unit(codes)))
"""IEC 61966-2-1:1999, 5.2; `srgb_encode` and `srgb_decode` keep light and codes above 1."""
BT1886 = Curve(lambda light: _unit(light) ** (1 / 2.4), lambda codes: _unit(codes) ** 2.4)
"""ITU-R BT.1886, annex 1, for a display whose black emits no light."""
PQ = Curve(_pq_encode, _pq_decode)
"""SMPTE ST 2084 and ITU-R BT.2100-2, table 4; light is a fraction of 10,000 cd/m2; no light is
code 0."""
HLG = Curve(_hlg_encode, _hlg_decode)
"""ITU-R BT.2100-2, table 5: the OETF, which takes light of the scene."""


DIFFUSE_WHITE_NITS = 203.0
"""Light of diffuse white on an HDR display, cd/m2 (ITU-R BT.2408-7, table 1)."""
PEAK = 1000.0
"""Light of an HDR display at full code values, cd/m2, unless another one is given."""
_HLG_PEAKS = (400.0, 2000.0)  # outside, BT.2100's formula for the system gamma does not hold
_DARK = 1e-9
"""Luminance that darker light counts as, where a negative power of it is taken."""


class Kind(NamedTuple):
    """The properties shared by all displays of one name.

    Attributes:
        title: name for people.
        primaries, curve: as in `postfx.colour`.
        cicp: code points of ITU-T H.273: primaries, transfer, matrix (0: RGB), full range. None for
            BT.1886: its code in H.273 means a camera's transfer function, which viewers would
            invert.
    """

    title: str
    primaries: Chromaticities
    curve: Curve
    cicp: tuple[int, int, int, int] | None


DISPLAY_KINDS = {
    "srgb": Kind("sRGB", REC709, SRGB, (1, 13, 0, 1)),
    "p3": Kind("Display P3", P3_D65, SRGB, (12, 13, 0, 1)),
    "rec709": Kind("Rec.709, BT.1886", REC709, BT1886, None),
    "rec2020": Kind("Rec.2020, BT.1886", REC2020, BT1886, None),
    "pq": Kind("Rec.2100 PQ", REC2020, PQ, (9, 16, 0, 1)),
    "hlg": Kind("Rec.2100 HLG", REC2020, HLG, (9, 18, 0, 1)),
}
HDR = ("pq", "hlg")


@dataclass(frozen=True)
class Display:
    """A display. Light is linear RGB of its primaries; 1 is white: all it can give in SDR, diffuse
    white in HDR.

    Attributes:
        name: one of `DISPLAY_KINDS`.
        peak: most light of an HDR display, cd/m2; for HLG its nominal peak. None in SDR.
        white: light of 1 on an HDR display, cd/m2. None in SDR, where it is as bright as the viewer
            likes.
    """

    name: str
    peak: float | None = None
    white: float | None = None

    @cached_property
    def kind(self) -> Kind:
        """The properties shared with other displays of its name."""
        return DISPLAY_KINDS[self.name]

    @cached_property
    def hdr(self) -> bool:
        """Whether it shows light above diffuse white."""
        return self.name in HDR

    @cached_property
    def most(self) -> float:
        """The most light that it can show; 1 is white."""
        return self.peak / self.white if self.peak is not None and self.white is not None else 1.0

    @cached_property
    def unit(self) -> float:
        """Light at the curve's value 1; 1 is white. For HLG, before the system gamma is
        inverted."""
        return {"pq": PQ_NITS / (self.white or 1), "hlg": self.most}.get(self.name, 1.0)

    @cached_property
    def system_gamma(self) -> float:
        """Exponent of the HLG display's OOTF (ITU-R BT.2100-2, note 5f); 1 for all others."""
        return (1.2 + 0.42 * math.log10(self.peak / 1000)
                if self.name == "hlg" and self.peak is not None else 1.0)

    def __str__(self) -> str:
        return f"{self.name},peak={self.peak:g},white={self.white:g}" if self.hdr else self.name

    def encode(self, light: np.ndarray) -> np.ndarray:
        """Light (..., 3) to code values in [0, 1]; light that the display cannot show is clipped in
        each channel."""
        if not self.hdr:  # the curve clips at 1, which is all that the display shows
            return self.kind.curve.encode(light)
        signal = np.clip(np.nan_to_num(light, posinf=self.most), 0, self.most) / self.unit
        return self.kind.curve.encode(signal * self._gain(signal, 1 / self.system_gamma - 1))

    def decode(self, codes: np.ndarray) -> np.ndarray:
        """Code values (..., 3) to light."""
        return self.apply_ootf(self.kind.curve.decode(codes))

    def apply_ootf(self, signal: np.ndarray) -> np.ndarray:
        """Light (..., 3), 1 is white, from code values after the inverse curve."""
        return (signal if not self.hdr
                else signal * self._gain(signal, self.system_gamma - 1) * self.unit)

    def _gain(self, light: np.ndarray, exponent: float) -> np.ndarray | float:
        """Power of the luminance, kept above zero."""
        return np.maximum(light @ np.array(LUMA_REC2020),
                          _DARK)[..., None] ** exponent if exponent else 1.0


@cache
def parse_display(text: str) -> Display:
    """A display from 'p3' or 'pq,peak=1000,white=203'. Raises ColourError, which lists the
    displays."""
    name, *settings = text.split(",")
    if name not in DISPLAY_KINDS:
        raise ColourError(f"unknown display '{name}'{offer(name, DISPLAY_KINDS)}, e.g. "
                          "pq,peak=1000")
    values = dict(_parse_setting(text, item) for item in settings)
    if name not in HDR:
        if values:
            raise ColourError(f"display '{text}': peak and white are for {' and '.join(HDR)}")
        return Display(name)
    return _hdr_display(name, values.get("peak", PEAK), values.get("white", DIFFUSE_WHITE_NITS))


def _parse_setting(text: str, item: str) -> tuple[str, float]:
    key, _, value = item.partition("=")
    try:
        number = float(value)
    except ValueError:
        number = math.nan
    if key not in ("peak", "white") or not math.isfinite(number):
        raise ColourError(f"display '{text}': '{item}' is neither peak=NITS nor white=NITS")
    return key, number


def _hdr_display(name: str, peak: float, white: float) -> Display:
    display = Display(name, peak, white)
    if not 0 < white <= peak <= PQ_NITS:
        raise ColourError(f"display '{display}': 0 < white <= peak <= {PQ_NITS:g} nits must hold")
    if name == "hlg" and not _HLG_PEAKS[0] <= peak <= _HLG_PEAKS[1]:
        raise ColourError(f"display '{display}': HLG is defined for peaks of 400 to 2000 nits")
    return display
