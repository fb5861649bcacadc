"""A canvas that needs no plotting library, and what pages that are drawn on it look like."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import numpy as np
import OpenImageIO as oiio

from postfx.files import refusal, write_atomically
from postfx.thumbnails import png

Colour = tuple[int, int, int]

PAGE_WIDTH_PX = 1200
PAGE_HEIGHT_PX = 560
PLOT_LEFT_PX = 84
PLOT_RIGHT_PX = 1176
PLOT_TOP_PX = 74
PAPER_RGB = (250, 250, 248)
INK_RGB = (40, 42, 48)
FAINT_RGB = (130, 132, 138)
GRID_RGB = (226, 226, 222)


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
        raise refusal(path, error.strerror or str(error)) from error
