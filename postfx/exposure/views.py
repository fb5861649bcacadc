"""Ways to show light: as code values to compare, and as camera operators judge exposure: false colour and zebra."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from postfx.colour.curves import srgb_encode

LUMA = np.array((0.2126, 0.7152, 0.0722), np.float32)


class Band(NamedTuple):
    """A range of the signal, its colour (sRGB code values) and its meaning."""

    low: float
    high: float
    colour: tuple[int, int, int]
    meaning: str


BANDS = (
    Band(0.0, 0.025, (120, 40, 170), "black clipping"),
    Band(0.025, 0.04, (40, 80, 230), "just above black"),
    Band(0.38, 0.42, (60, 180, 75), "18 % mid grey"),
    Band(0.52, 0.56, (245, 150, 185), "a stop over grey"),
    Band(0.97, 0.99, (250, 220, 50), "just below white"),
    Band(0.99, 1.0, (225, 40, 40), "white clipping"),
)
"""ARRI, ALEXA Mini LF user manual, "Monitoring", page 83: signal levels and colours of the false colour display."""

ZEBRA = 0.95
STRIPE = 6  # pixels of a stripe and of a gap


def luma(rgb: np.ndarray) -> np.ndarray:
    """(height, width, 3) -> (height, width), Rec.709 weights."""
    return rgb @ LUMA


def to_codes(colour: np.ndarray, exposure: float) -> np.ndarray:
    """sRGB code values 0..1 of x / (1 + x), x = colour * exposure, to compare pictures; non-finite values count as
    0."""
    exposed = np.maximum(np.nan_to_num(colour * exposure), 0)
    return srgb_encode(exposed / (1 + exposed))


def log_c(linear: np.ndarray) -> np.ndarray:
    """ARRI Log C3 at EI 800 of exposed scene-linear values, where 0.18 becomes 0.391.

    Source: ARRI, "ALEXA Log C Curve: Usage in VFX" (2012), table for EI 800, linear scene exposure.
    """
    upper = 0.247190 * np.log10(5.555556 * np.maximum(linear, 0.010591) + 0.052272) + 0.385537
    return np.where(linear > 0.010591, upper, 5.367655 * linear + 0.092809)


def false_colour(signal: np.ndarray) -> np.ndarray:
    """ARRI's false colour of a signal 0..1, (height, width) -> uint8 (height, width, 3); grey between the bands."""
    signal = np.clip(np.nan_to_num(signal, nan=0.0), 0, 1)
    picture = np.repeat((signal * 255 + 0.5).astype(np.uint8)[..., None], 3, axis=-1)
    for band in BANDS:
        picture[(signal >= band.low) & (signal <= band.high)] = band.colour
    return picture


def zebra(display: np.ndarray, level: float = ZEBRA) -> np.ndarray:
    """Diagonal stripes where the luma of a display picture (height, width, 3), 0..1, is `level` or more; uint8."""
    picture: np.ndarray = (np.clip(np.nan_to_num(display, nan=0.0), 0, 1) * 255 + 0.5).astype(np.uint8)
    rows, columns = np.indices(display.shape[:2])
    dark = (rows + columns) // STRIPE % 2 == 0
    picture[(luma(display) >= level) & dark] = 0
    return picture
