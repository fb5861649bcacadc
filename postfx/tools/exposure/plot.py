"""Pictures of exposure: its curves over a sequence, and a key of the false-colour bands."""

from __future__ import annotations

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
from postfx.colour.views import FALSE_COLOUR_BANDS
from postfx.tools.exposure.debugger import DRIFTING_VERDICT, RIGHT_VERDICT, Report, Shot

KEY_PAPER = (24, 24, 26)
KEY_INK = (225, 225, 225)
KEY_ROW_PX = 22
KEY_COLUMN_PX = 210
TEXT_SIZE_PX = 13


def add_key(picture: np.ndarray) -> np.ndarray:
    """The picture, uint8 (height, width, 3), with a key of the false-colour bands below."""
    height, width, _ = picture.shape
    across = max(width // KEY_COLUMN_PX, 1)
    rows = -(-len(FALSE_COLOUR_BANDS) // across)
    canvas = Canvas(width, rows * KEY_ROW_PX + 8, KEY_PAPER)
    for index, band in enumerate(FALSE_COLOUR_BANDS):
        x, y = 10 + index % across * (width // across), 4 + index // across * KEY_ROW_PX
        canvas.box(x, y + 5, x + 14, y + 17, band.colour)
        text = f"{100 * band.low:g}-{100 * band.high:g} %  {band.meaning}"
        canvas.text(x + 22, y + 11, text, KEY_INK, TEXT_SIZE_PX)
    return np.concatenate([picture, canvas.pixels.round().astype(np.uint8)])


PLOT_BOTTOM_PX = 400
STRIP_ROWS_PX = (432, 488)
USED_RGB = (200, 80, 10)
NEEDED_RGB = (11, 98, 184)
LEAST_SPAN_EV = 2.0


def draw_exposure(report: Report, title: str, path: Path) -> None:
    """Write the PNG, 1200x560. Raises WriteError."""
    canvas = Canvas(PAGE_WIDTH_PX, PAGE_HEIGHT_PX, PAPER_RGB)
    plot = _Plot(canvas, report)
    plot.axes()
    plot.curves()
    plot.checkerboard()
    canvas.text(PLOT_LEFT_PX, 24, title, INK_RGB, 20)
    _legend(canvas)
    canvas.save(path)


class _Plot:
    """The scales of the plot, and drawing with them."""

    def __init__(self, canvas: Canvas, report: Report) -> None:
        self.canvas, self.report = canvas, report
        self.used = np.array([item.exposure_ev for item in report.readings])
        self.needed = np.array([item.exposure_ev - item.mismatch_ev for item in report.readings])
        low, high = min(self.used.min(), self.needed.min()), max(self.used.max(), self.needed.max())
        half, middle = max(high - low + 0.5, LEAST_SPAN_EV) / 2, (low + high) / 2
        self.low, self.high = middle - half, middle + half
        self.edges = np.linspace(PLOT_LEFT_PX, PLOT_RIGHT_PX, len(report.readings) + 1)

    def x(self, index: np.ndarray | int) -> np.ndarray:
        """Middle of a frame's column."""
        middle: np.ndarray = (self.edges[index] + self.edges[np.asarray(index) + 1]) / 2
        return middle

    def y(self, ev: np.ndarray | float) -> np.ndarray:
        place: np.ndarray = (PLOT_BOTTOM_PX - (np.asarray(ev) - self.low) / (self.high - self.low)
                             * (PLOT_BOTTOM_PX - PLOT_TOP_PX))
        return place

    def axes(self) -> None:
        step = next(step
                    for step in (0.25, 0.5, 1, 2, 4, 8, 16) if (self.high - self.low) / step <= 8)
        for ev in np.arange(np.ceil(self.low / step), np.floor(self.high / step) + 1) * step:
            y = float(self.y(ev))
            self.canvas.box(PLOT_LEFT_PX, y, PLOT_RIGHT_PX, y + 1,
                            FAINT_RGB if ev == 0 else GRID_RGB)
            self.canvas.text(PLOT_LEFT_PX - 10, y, f"{ev:+g} EV" if ev else "0 EV", FAINT_RGB, 14,
                             "right")
        every = -(-len(self.used) // 16)
        for index in range(0, len(self.used), every):
            number = str(self.report.readings[index].number)
            self.canvas.text(float(self.x(index)), STRIP_ROWS_PX[1] + 16, number, FAINT_RGB, 14,
                             "center")
        self.canvas.text((PLOT_LEFT_PX + PLOT_RIGHT_PX) / 2, STRIP_ROWS_PX[1] + 44, "frame",
                         FAINT_RGB, 14, "center")

    def curves(self) -> None:
        cuts = [index for index, item in enumerate(self.report.readings) if item.cut and index]
        for cut in cuts:
            for y in range(PLOT_TOP_PX, PLOT_BOTTOM_PX, 10):
                self.canvas.box(self.edges[cut], y, self.edges[cut] + 1, y + 5, FAINT_RGB)
            self.canvas.text(self.edges[cut] + 6, PLOT_TOP_PX + 8, "cut", FAINT_RGB, 14)
        begin = 0
        for shot in self.report.shots:
            end = next((cut for cut in cuts if cut > begin), len(self.used))
            index = np.arange(begin, end)
            for values, colour in ((self.needed, NEEDED_RGB), (self.used, USED_RGB)):
                self.canvas.line(self.x(index), self.y(values[index]), colour, 3)
                self.canvas.dots(self.x(index), self.y(values[index]), colour,
                                 min(8, 300 / len(self.used) + 3))
            self._name(shot, self.edges[begin], self.edges[end])
            begin = end

    def checkerboard(self) -> None:
        """Each frame's mid grey as shown, above the right grey."""
        top, bottom = STRIP_ROWS_PX
        right = round(self.report.grey * 255)
        for index, item in enumerate(self.report.readings):
            level = round(item.level * 255)
            self.canvas.box(self.edges[index], top, self.edges[index + 1], bottom,
                            (level, level, level))
        self.canvas.box(PLOT_LEFT_PX, bottom - 14, PLOT_RIGHT_PX, bottom, (right, right, right))
        self.canvas.text(PLOT_LEFT_PX - 10, top + 21, "seen", FAINT_RGB, 14, "right")
        self.canvas.text(PLOT_LEFT_PX - 10, bottom - 7, "right", FAINT_RGB, 14, "right")

    def _name(self, shot: Shot, begin: float, end: float) -> None:
        """The verdict below a shot, if there is room."""
        by = shot.drift_ev if shot.verdict == DRIFTING_VERDICT else abs(shot.mismatch_ev)
        text = shot.verdict if shot.verdict == RIGHT_VERDICT else f"{shot.verdict} by {by:.2f} EV"
        if end - begin > 9 * len(text):
            self.canvas.text((begin + end) / 2, PLOT_BOTTOM_PX + 16, text, INK_RGB, 16, "center")


def _legend(canvas: Canvas) -> None:
    for x, colour, text in ((PLOT_LEFT_PX, USED_RGB, "exposure used"),
                            (PLOT_LEFT_PX + 170, NEEDED_RGB, "exposure that would be right")):
        canvas.line(np.array([x, x + 26]), np.array([52, 52]), colour, 3)
        canvas.text(x + 36, 52, text, INK_RGB, 15)
