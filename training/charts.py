"""Charts of light that photographs seldom hold, exposed scene-linear Rec.709 (H,W,3) float32."""

from __future__ import annotations

import numpy as np

MID_GREY = 0.18
RAMP_EV = (-8.0, 6.0)


def ramp(width: int = 4096, height: int = 64) -> np.ndarray:
    """Grey from 8 stops below to 6 above mid grey, (height, width, 3)."""
    light = MID_GREY * np.exp2(np.linspace(*RAMP_EV, width, dtype=np.float32))
    return np.ascontiguousarray(np.broadcast_to(light[None, :, None], (height, width, 3)))


def hue_chart(stops: float = 23.0, hues: int = 24, size: int = 8) -> np.ndarray:
    """Patches of all hues in two saturations, over `stops` stops about mid grey."""
    levels = np.exp2(np.linspace(-stops / 2, stops / 2, 24)) * MID_GREY
    angles = np.arange(hues) * 2 * np.pi / hues
    colours = np.clip(0.5 + np.cos(angles[:, None] - np.array([0, 2, 4]) * np.pi / 3), 0, 1)
    rows = [colours, 0.3 + 0.7 * colours]
    chart = np.concatenate([levels[None, :, None] * row[:, None] for row in rows])
    return np.ascontiguousarray(chart.repeat(size, 0).repeat(size, 1), np.float32)
