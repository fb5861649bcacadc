"""Exposure: one multiplier a frame. Meter it, smooth it over time, and measure whether a chain applies it."""

from postfx.errors import ExposureError
from postfx.exposure.metering import (
    APPLIED,
    KEY,
    LIMITS_EV,
    MODES,
    SMOOTH,
    USED,
    ExposureMeter,
    MeterReading,
    SmoothExposure,
    colours_of,
    frame_rate,
    measure,
    meter_frames,
    smooth_ev,
)

__all__ = [
    "APPLIED",
    "KEY",
    "LIMITS_EV",
    "MODES",
    "SMOOTH",
    "USED",
    "ExposureError",
    "ExposureMeter",
    "MeterReading",
    "SmoothExposure",
    "colours_of",
    "frame_rate",
    "measure",
    "meter_frames",
    "smooth_ev",
]
