"""Curves over the frames of a sequence: as data for a page, and the exposure as a picture."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from postfx.exposure.debugger import DRIFTING, RIGHT, Report, Shot
from postfx.report.drawing import Canvas
from postfx.report.frame_log import Row


class Chart(NamedTuple):
    """A chart: `prefix` of the readings that it shows, what follows it is the curve's name; `span`: least height."""

    prefix: str
    title: str
    span: float
    note: str


CHARTS = (
    Chart("change ", "Change along the motion", 10, "1000 times the mean difference to the frame before, followed by "
          "the motion, in code values as shown, of the calmest 80 % of the pixels: flicker, and what light does."),
    Chart("exposure ", "Exposure, EV", 1, "Used: what the run exposed by. Metered: what the meter says of each input "
          "frame alone."),
    Chart("psnr ", "PSNR against the reference, dB", 2, "Of code values as shown, at full size; up is better."),
    Chart("flip ", "FLIP against the reference", 0.02, "Mean error as the eye sees it at 67 pixels a degree, 0 to 1; "
          "down is better."),
    Chart("ms ", "Milliseconds a frame", 10, "In the passes, without reading and writing; the first frame, which "
          "compiles, is left out."),
)


def charts(rows: Sequence[Row]) -> list[dict[str, Any]]:
    """Charts that have a curve of at least two values: 'title', 'note', least 'span', and 'curves': name -> values."""
    names = dict.fromkeys(name for row in rows for name in row.readings)
    curves = {name: [row.readings.get(name) for row in rows] for name in names}
    drawn = {name: values for name, values in curves.items() if sum(value is not None for value in values) > 1}
    found = [_drawn(chart, drawn) for chart in CHARTS]
    return [chart for chart in found if chart["curves"]]


def _drawn(chart: Chart, curves: Mapping[str, list[float | None]]) -> dict[str, Any]:
    own = {name.removeprefix(chart.prefix): curve for name, curve in curves.items() if name.startswith(chart.prefix)}
    return {"title": chart.title, "note": chart.note, "span": chart.span, "curves": own}


WIDTH, HEIGHT = 1200, 560
LEFT, RIGHT_EDGE, TOP, BOTTOM = 84, 1176, 74, 400
STRIP = (432, 488)
PAPER, INK, FAINT, GRID = (250, 250, 248), (40, 42, 48), (130, 132, 138), (226, 226, 222)
USED, NEEDED = (200, 80, 10), (11, 98, 184)
LEAST_SPAN_EV = 2.0


def draw_exposure(report: Report, title: str, path: Path) -> None:
    """Write the PNG, 1200x560. Raises WriteError."""
    canvas = Canvas(WIDTH, HEIGHT, PAPER)
    plot = _Plot(canvas, report)
    plot.axes()
    plot.curves()
    plot.checkerboard()
    canvas.text(LEFT, 24, title, INK, 20)
    _legend(canvas)
    canvas.save(path)


class _Plot:
    """Scales of the plot, and what is drawn by them."""

    def __init__(self, canvas: Canvas, report: Report) -> None:
        self.canvas, self.report = canvas, report
        self.used = np.array([item.exposure_ev for item in report.readings])
        self.needed = np.array([item.exposure_ev - item.mismatch_ev for item in report.readings])
        low, high = min(self.used.min(), self.needed.min()), max(self.used.max(), self.needed.max())
        half, middle = max(high - low + 0.5, LEAST_SPAN_EV) / 2, (low + high) / 2
        self.low, self.high = middle - half, middle + half
        self.edges = np.linspace(LEFT, RIGHT_EDGE, len(report.readings) + 1)

    def x(self, index: np.ndarray | int) -> np.ndarray:
        """Middle of a frame's column."""
        middle: np.ndarray = (self.edges[index] + self.edges[np.asarray(index) + 1]) / 2
        return middle

    def y(self, ev: np.ndarray | float) -> np.ndarray:
        place: np.ndarray = BOTTOM - (np.asarray(ev) - self.low) / (self.high - self.low) * (BOTTOM - TOP)
        return place

    def axes(self) -> None:
        step = next(step for step in (0.25, 0.5, 1, 2, 4, 8, 16) if (self.high - self.low) / step <= 8)
        for ev in np.arange(np.ceil(self.low / step), np.floor(self.high / step) + 1) * step:
            y = float(self.y(ev))
            self.canvas.box(LEFT, y, RIGHT_EDGE, y + 1, FAINT if ev == 0 else GRID)
            self.canvas.text(LEFT - 10, y, f"{ev:+g} EV" if ev else "0 EV", FAINT, 14, "right")
        every = -(-len(self.used) // 16)
        for index in range(0, len(self.used), every):
            number = str(self.report.readings[index].number)
            self.canvas.text(float(self.x(index)), STRIP[1] + 16, number, FAINT, 14, "center")
        self.canvas.text((LEFT + RIGHT_EDGE) / 2, STRIP[1] + 44, "frame", FAINT, 14, "center")

    def curves(self) -> None:
        cuts = [index for index, item in enumerate(self.report.readings) if item.cut and index]
        for cut in cuts:
            for y in range(TOP, BOTTOM, 10):
                self.canvas.box(self.edges[cut], y, self.edges[cut] + 1, y + 5, FAINT)
            self.canvas.text(self.edges[cut] + 6, TOP + 8, "cut", FAINT, 14)
        begin = 0
        for shot in self.report.shots:
            end = next((cut for cut in cuts if cut > begin), len(self.used))
            index = np.arange(begin, end)
            for values, colour in ((self.needed, NEEDED), (self.used, USED)):
                self.canvas.line(self.x(index), self.y(values[index]), colour, 3)
                self.canvas.dots(self.x(index), self.y(values[index]), colour, min(8, 300 / len(self.used) + 3))
            self._name(shot, self.edges[begin], self.edges[end])
            begin = end

    def checkerboard(self) -> None:
        """Each frame's mid grey as it looked, over the grey that would be right."""
        top, bottom = STRIP
        right = round(self.report.grey * 255)
        for index, item in enumerate(self.report.readings):
            level = round(item.level * 255)
            self.canvas.box(self.edges[index], top, self.edges[index + 1], bottom, (level, level, level))
        self.canvas.box(LEFT, bottom - 14, RIGHT_EDGE, bottom, (right, right, right))
        self.canvas.text(LEFT - 10, top + 21, "seen", FAINT, 14, "right")
        self.canvas.text(LEFT - 10, bottom - 7, "right", FAINT, 14, "right")

    def _name(self, shot: Shot, begin: float, end: float) -> None:
        """The verdict below a shot, where there is room."""
        by = shot.drift_ev if shot.verdict == DRIFTING else abs(shot.mismatch_ev)
        text = shot.verdict if shot.verdict == RIGHT else f"{shot.verdict} by {by:.2f} EV"
        if end - begin > 9 * len(text):
            self.canvas.text((begin + end) / 2, BOTTOM + 16, text, INK, 16, "center")


def _legend(canvas: Canvas) -> None:
    for x, colour, text in ((LEFT, USED, "exposure used"), (LEFT + 170, NEEDED, "exposure that would be right")):
        canvas.line(np.array([x, x + 26]), np.array([52, 52]), colour, 3)
        canvas.text(x + 36, 52, text, INK, 15)
