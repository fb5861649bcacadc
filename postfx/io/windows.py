"""Windows of what is written: those of the input, scaled to the output's size."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from postfx.frame import Frame
from postfx.io.part import AREA, Window

Pixels = Callable[[slice], np.ndarray]
"""Rows -> pixels (rows, width, channels) as they are stored."""


class OutputWindows(NamedTuple):
    """Rectangles of an output: what the frame's planes cover, the display window, and where there is data."""

    area: Window
    display: Window
    data: Window


def output_windows(frame: Frame) -> OutputWindows:
    """Windows of a frame's size out of those in its metadata, which are of the input's.

    Corners scale along, rounded to the nearest pixel, those of the data window outwards. A frame without windows covers
    the display window from (0, 0).
    """
    width, height = frame.spec.width, frame.spec.height
    display = Window(*frame.metadata.get("displayWindow", (0, 0, width - 1, height - 1)))
    covered = Window(*frame.metadata.get(AREA, display))
    return scaled_windows(covered, display, Window(*frame.metadata.get("dataWindow", covered)), width, height)


def scaled_windows(covered: Window, display: Window, data: Window, width: int, height: int) -> OutputWindows:
    """Windows of an output of a size, out of those of the input."""
    scale = (width / covered.width, height / covered.height)
    corner = _scaled(covered, scale)
    area = Window(corner.x0, corner.y0, corner.x0 + width - 1, corner.y0 + height - 1)
    shown = area if display == covered else _scaled(display, scale).common(area) or area
    return OutputWindows(area, shown, _outwards(data, scale).common(area) or area)


def cut(pixels: Pixels, area: Window, window: Window) -> Pixels:
    """Pixels of a rectangle within the area that they cover."""
    if window == area:
        return pixels
    x, y = window.x0 - area.x0, window.y0 - area.y0
    return lambda rows: pixels(slice(rows.start + y, rows.stop + y))[:, x : x + window.width]


def _scaled(window: Window, scale: tuple[float, float]) -> Window:
    x0, y0 = round(window.x0 * scale[0]), round(window.y0 * scale[1])
    return Window(x0, y0, round((window.x1 + 1) * scale[0]) - 1, round((window.y1 + 1) * scale[1]) - 1)


def _outwards(window: Window, scale: tuple[float, float]) -> Window:
    x0, y0 = math.floor(window.x0 * scale[0]), math.floor(window.y0 * scale[1])
    return Window(x0, y0, math.ceil((window.x1 + 1) * scale[0]) - 1, math.ceil((window.y1 + 1) * scale[1]) - 1)
