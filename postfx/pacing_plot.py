"""The picture of a presenter's pacing."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from postfx.canvas import (
    FAINT_RGB,
    GRID_RGB,
    INK_RGB,
    PAGE_HEIGHT_PX,
    PAGE_WIDTH_PX,
    PAPER_RGB,
    PLOT_LEFT_PX,
    PLOT_RIGHT_PX,
    PLOT_TOP_PX,
    Canvas,
)


def draw_pacing(title: str, interval: float, intervals: Sequence[float],
                histogram: Mapping[float, int], bucket: float, path: Path) -> None:
    """Write the PNG of measured ``intervals`` in seconds, 1200x560: each in order, and right of it
    how many fall into each bucket, of a width of ``bucket`` of the wanted ``interval``. Raises
    WriteError."""
    canvas = Canvas(PAGE_WIDTH_PX, PAGE_HEIGHT_PX, PAPER_RGB)
    canvas.text(PLOT_LEFT_PX, 24, title, INK_RGB, 18)
    measured, bottom, middle = np.array(intervals), PAGE_HEIGHT_PX - 60, round(0.75 * PAGE_WIDTH_PX)
    top = max(2 * interval, float(measured.max(initial=0)) * 1.05)

    def y(seconds: np.ndarray | float) -> np.ndarray:
        return np.asarray(bottom - np.asarray(seconds) / top * (bottom - PLOT_TOP_PX))

    for turns in range(int(top / interval) + 1):
        place = float(y(turns * interval))
        canvas.box(PLOT_LEFT_PX, place, PLOT_RIGHT_PX, place + 1,
                   FAINT_RGB if turns == 1 else GRID_RGB)
        canvas.text(PLOT_LEFT_PX - 10, place, f"{1e3 * turns * interval:.1f} ms", FAINT_RGB, 14,
                    "right")
    if measured.size:
        canvas.dots(np.linspace(PLOT_LEFT_PX + 8, middle - 20, measured.size), y(measured), INK_RGB,
                    5)
    half, most = bucket * interval / 2, max(histogram.values(), default=1)
    for seconds, count in histogram.items():
        end = middle + (PLOT_RIGHT_PX - middle - 60) * count / most
        canvas.box(middle, float(y(seconds + half)), max(end, middle + 2), float(y(seconds - half)),
                   INK_RGB, 0.6)
        canvas.text(end + 8, float(y(seconds)), str(count), INK_RGB, 14)
    canvas.text((PLOT_LEFT_PX + middle) / 2, bottom + 26, "pictures in order", FAINT_RGB, 14,
                "center")
    canvas.text((middle + PLOT_RIGHT_PX) / 2, bottom + 26, "intervals of each length", FAINT_RGB,
                14, "center")
    canvas.save(path)
