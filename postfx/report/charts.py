"""Charts over the frames of a sequence: a canvas that needs no plotting library, a false-colour
key, and curves."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import OpenImageIO as oiio

from postfx.colour.views import FALSE_COLOUR_BANDS
from postfx.errors import WriteError
from postfx.exposure.debugger import DRIFTING_VERDICT, RIGHT_VERDICT, Report, Shot
from postfx.files import write_atomically
from postfx.report.frame_log import Row
from postfx.thumbnails import png

Colour = tuple[int, int, int]


class Canvas:
    """A picture to draw on; positions are x right and y down in pixels, colours sRGB code values
    0..255.

    Attributes:
        pixels: float32 (height, width, 3), 0..255.
    """

    def __init__(self, width: int, height: int, colour: Colour) -> None:
        self.pixels = np.empty((height, width, 3), np.float32)
        self.pixels[:] = colour

    def box(self, x0: float, y0: float, x1: float, y1: float, colour: Colour,
            opacity: float = 1.0) -> None:
        """Fill from (x0, y0) to (x1, y1), exclusive, rounded to whole pixels."""
        part = self.pixels[round(y0) : round(y1), round(x0) : round(x1)]
        part += opacity * (np.array(colour, np.float32) - part)

    def line(self, x: np.ndarray, y: np.ndarray, colour: Colour, width: float = 2.0) -> None:
        """A smooth-edged line through points, in order."""
        points = np.column_stack([x, y]).astype(float)
        self._strokes(zip(points, points[1:], strict=False), colour, width)

    def dots(self, x: np.ndarray, y: np.ndarray, colour: Colour, width: float) -> None:
        """Round dots."""
        points = np.column_stack([x, y]).astype(float)
        self._strokes(zip(points, points, strict=True), colour, width)

    def text(self, x: float, y: float, text: str, colour: Colour, size: int = 15,
             align: str = "left") -> None:
        """A line of text; (x, y) is the middle of its left, right or centre ('left', 'right',
        'center')."""
        buffer = oiio.ImageBuf(np.ascontiguousarray(self.pixels / 255))
        channels = tuple(value / 255 for value in colour)
        oiio.ImageBufAlgo.render_text(buffer, round(x), round(y), text, size, "DroidSans", channels,
                                      align, "center")
        self.pixels = np.asarray(buffer.get_pixels(oiio.FLOAT), np.float32) * 255

    def save(self, path: Path) -> None:
        """Write a PNG; WriteError if that fails."""
        save_png(path, (np.clip(self.pixels, 0, 255) + 0.5).astype(np.uint8))

    def _strokes(self, strokes: Iterable[tuple[np.ndarray, np.ndarray]], colour: Colour,
                 width: float) -> None:
        cover = np.zeros(self.pixels.shape[:2], np.float32)
        for start, end in strokes:
            self._cover_segment(cover, start, end, width)
        self.pixels += cover[..., None] * (np.array(colour, np.float32) - self.pixels)

    @staticmethod
    def _cover_segment(cover: np.ndarray, start: np.ndarray, end: np.ndarray, width: float) -> None:
        height, columns = cover.shape
        low = np.maximum(np.floor(np.minimum(start, end) - width - 1), 0).astype(int)
        high = np.ceil(np.maximum(start, end) + width + 2).astype(int)
        window = np.s_[low[1] : min(high[1], height), low[0] : min(high[0], columns)]
        rows, places = np.indices(cover[window].shape)
        pixel = np.stack([places + low[0], rows + low[1]], axis=-1) - start
        along = end - start
        share = np.clip(pixel @ along / max(along @ along, 1e-9), 0, 1)
        distance = np.linalg.norm(pixel - share[..., None] * along, axis=-1)
        cover[window] = np.maximum(cover[window], np.clip(width / 2 + 0.5 - distance, 0, 1))


def save_png(path: Path, pixels: np.ndarray) -> None:
    """Write uint8 (height, width, 3) as PNG; makes missing folders. Raises WriteError."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_atomically(path, lambda file: file.write(png(pixels)), durable=True)
    except OSError as error:
        raise WriteError(f"{path}: cannot be written: {error.strerror}; check the folder and its "
                         "rights") from error


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


class Chart(NamedTuple):
    """A chart of all readings whose names begin with `prefix`; the rest of a name is the curve's
    name. `span` is the least height in the readings' unit."""

    prefix: str
    title: str
    span: float
    note: str


CHARTS = (
    Chart("change ", "Change along the motion", 10,
          "1000 times the mean difference to the frame before, followed by the motion, in code "
          "values as shown, of the calmest 80 % of the pixels: flicker and changes of light."),
    Chart("exposure ", "Exposure, EV", 1,
          "Used: the exposure of the run. Metered: the meter's reading of each input frame alone."),
    Chart("psnr ", "PSNR against the reference, dB", 2,
          "Of code values as shown, at full size; up is better."),
    Chart("flip ", "FLIP against the reference", 0.02,
          "Mean error as the eye sees it at 67 pixels a degree, 0 to 1; down is better."),
    Chart("ms ", "Milliseconds a frame", 10,
          "In the passes, without reading and writing; the first frame, which compiles, is left "
          "out."),
)


def charts(rows: Sequence[Row]) -> list[dict[str, Any]]:
    """Charts with a curve of at least two values: 'title', 'note', least 'span', and 'curves':
    name -> values."""
    names = dict.fromkeys(name for row in rows for name in row.readings)
    curves = {name: [row.readings.get(name) for row in rows] for name in names}
    drawn = {name: values
             for name, values in curves.items() if sum(value is not None for value in values) > 1}
    found = [_drawn(chart, drawn) for chart in CHARTS]
    return [chart for chart in found if chart["curves"]]


def _drawn(chart: Chart, curves: Mapping[str, list[float | None]]) -> dict[str, Any]:
    own = {name.removeprefix(chart.prefix): curve
           for name, curve in curves.items() if name.startswith(chart.prefix)}
    return {"title": chart.title, "note": chart.note, "span": chart.span, "curves": own}


PAGE_WIDTH_PX = 1200
PAGE_HEIGHT_PX = 560
PLOT_LEFT_PX = 84
PLOT_RIGHT_PX = 1176
PLOT_TOP_PX = 74
PLOT_BOTTOM_PX = 400
STRIP_ROWS_PX = (432, 488)
PAPER_RGB = (250, 250, 248)
INK_RGB = (40, 42, 48)
FAINT_RGB = (130, 132, 138)
GRID_RGB = (226, 226, 222)
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
