"""Jitter of the samples from frame to frame, and the exposure that a renderer suggests."""

from __future__ import annotations

import math

import numpy as np

from postfx.errors import IntegrationError
from postfx.exposure import measure


def halton(index: int, base: int) -> float:
    """Element `index` >= 1 of the Halton sequence in a base >= 2, within 0..1 (Halton 1960): digits mirrored."""
    if index < 0 or base < 2:
        raise IntegrationError(f"halton({index}, {base}): give an index from 0 and a base from 2")
    value, digit = 0.0, 1.0 / base
    while index:
        index, rest = divmod(index, base)
        value += rest * digit
        digit /= base
    return value


def jitter_length(scale: float) -> int:
    """Frames after which the jitter may repeat: 8 samples for each output pixel, 8 scale^2 rounded up."""
    return math.ceil(8 * scale * scale)


def jitter_sequence(count: int) -> np.ndarray:
    """Jitter (count, 2) in pixels, -0.5..0.5, x right, y down: Halton bases 2 and 3 from index 1, minus 0.5.

    All samples of frame k of a real-time renderer go through the pixel position 0.5 + jitter[k % count]; take
    `jitter_length(scale)` as count. A renderer that spreads its samples over the pixel has no jitter: write (0, 0).
    """
    return np.array([[halton(index, 2) - 0.5, halton(index, 3) - 0.5] for index in range(1, count + 1)]).reshape(-1, 2)


def exposure_hint(colour: np.ndarray) -> float | None:
    """Multiplier > 0 that brings a picture to mid grey, for `Frame.exposure`; None for a black one.

    colour: (height, width, 3) scene-linear; measured as `postfx.exposure.measure` does. Hold it over a shot: take the
    first frame's, or the median of all.
    """
    ev = measure(np.ascontiguousarray(colour, np.float32))
    return None if ev is None else 2.0**ev


def exposure_of_camera(f_number: float, shutter: float, iso: float = 100.0) -> float:
    """Multiplier > 0 for colours in cd/m^2: luminance * multiplier is 1 where the sensor saturates.

    shutter: seconds. The sensor saturates at 1.2 * 2^EV100 with EV100 = log2(f_number^2 / shutter * 100 / iso)
    (ISO 12232, saturation-based speed; Lagarde and de Rousiers 2014, "Moving Frostbite to Physically Based Rendering").
    IntegrationError unless all are positive.
    """
    if min(f_number, shutter, iso) <= 0:
        raise IntegrationError(f"f/{f_number:g}, {shutter:g} s, ISO {iso:g}: give positive numbers")
    return 1 / (1.2 * f_number**2 / shutter * 100 / iso)
