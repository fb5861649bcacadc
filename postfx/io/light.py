"""Light as OpenEXR files store it."""

from __future__ import annotations

from functools import cache

import numpy as np

from postfx.colour.displays import KINDS, Display
from postfx.kernels.storing import halve, look_up

_STEPS = 1 << 16


def halves(light: np.ndarray) -> np.ndarray:
    """float16 nearest to light of any shape, cut to +-65504; NaN stays."""
    values = np.ascontiguousarray(light, np.float32).reshape(-1)
    found = np.empty(values.shape, np.uint16)
    halve(values, values.view(np.int32), found)
    return found.view(np.float16).reshape(light.shape)


def light_of(codes: np.ndarray, display: Display) -> np.ndarray:
    """Code values (..., 3) of a display to its light, float32, 1 is white: what `Display.decode` gives, by a table
    where all are from 0 to 1.

    Where light is a normal half float it errs by less than 2e-6 of itself; a half float is as near as 2.4e-4.
    """
    values = np.ascontiguousarray(codes, np.float32).reshape(-1)
    light = np.empty_like(values)
    if not look_up(values, _table(display.name), light):
        return display.decode(codes).astype(np.float32, copy=False)
    return display.lit(light.reshape(codes.shape)).astype(np.float32, copy=False)


@cache
def _table(name: str) -> np.ndarray:
    light = KINDS[name].curve.decode(np.linspace(0, 1, _STEPS + 1))
    return np.append(light, light[-1]).astype(np.float32)
