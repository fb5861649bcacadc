"""Exposure: one multiplier a frame. Metering, following it over time, and measuring whether a chain applies it."""

from postfx.errors import ExposureError
from postfx.exposure.metering import (
    KEY,
    LIMITS_EV,
    MODES,
    SMOOTH,
    ExposureMeter,
    Metered,
    SmoothExposure,
    colours_of,
    frame_rate,
    measure,
    metered,
    smooth_ev,
)

__all__ = [
    "KEY",
    "LIMITS_EV",
    "MODES",
    "SMOOTH",
    "ExposureError",
    "ExposureMeter",
    "Metered",
    "SmoothExposure",
    "colours_of",
    "frame_rate",
    "measure",
    "metered",
    "smooth_ev",
]
