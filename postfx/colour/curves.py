"""Transfer functions of displays: light 0..1 to code values 0..1 and back, on arrays of any shape."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

PQ_NITS = 10000.0
"""Light of the PQ code value 1, cd/m2."""
_M1, _M2 = 2610 / 16384, 2523 / 4096 * 128
_C1, _C2, _C3 = 3424 / 4096, 2413 / 4096 * 32, 2392 / 4096 * 32
_A = 0.17883277
_B, _C = 1 - 4 * _A, 0.5 - _A * np.log(4 * _A)


class Curve(NamedTuple):
    """A transfer function: light in [0, 1] to code values in [0, 1], and its inverse. Values outside are clipped."""

    encode: Callable[[np.ndarray], np.ndarray]
    decode: Callable[[np.ndarray], np.ndarray]


def srgb_encode(linear: np.ndarray) -> np.ndarray:
    """Display-linear light 0..1 -> sRGB code values 0..1; negative light becomes 0. float64 stays, else float32."""
    linear = np.maximum(_floats(linear), 0)
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * np.maximum(linear, 0.0031308) ** (1 / 2.4) - 0.055)


def srgb_decode(encoded: np.ndarray) -> np.ndarray:
    """sRGB code values 0..1 -> display-linear light 0..1; negative codes become 0. float64 stays, else float32."""
    encoded = np.maximum(_floats(encoded), 0)
    return np.where(encoded <= 0.04045, encoded / 12.92, ((np.maximum(encoded, 0.04045) + 0.055) / 1.055) ** 2.4)


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
"""SMPTE ST 2084 and ITU-R BT.2100-2, table 4; light is a fraction of 10,000 cd/m2; no light is code 0."""
HLG = Curve(_hlg_encode, _hlg_decode)
"""ITU-R BT.2100-2, table 5: the OETF, which takes light of the scene."""
