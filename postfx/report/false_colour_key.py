"""The key below a false colour picture."""

from __future__ import annotations

import numpy as np

from postfx.exposure.views import BANDS
from postfx.report.drawing import Canvas

PAPER, INK = (24, 24, 26), (225, 225, 225)
ROW, COLUMN, SIZE = 22, 210, 13


def with_key(picture: np.ndarray) -> np.ndarray:
    """uint8 (height, width, 3) with a strip below that names the bands, as many in a row as there is room for."""
    height, width, _ = picture.shape
    across = max(width // COLUMN, 1)
    rows = -(-len(BANDS) // across)
    canvas = Canvas(width, rows * ROW + 8, PAPER)
    for index, band in enumerate(BANDS):
        x, y = 10 + index % across * (width // across), 4 + index // across * ROW
        canvas.box(x, y + 5, x + 14, y + 17, band.colour)
        text = f"{100 * band.low:g}-{100 * band.high:g} %  {band.meaning}"
        canvas.text(x + 22, y + 11, text, INK, SIZE)
    return np.concatenate([picture, canvas.pixels.round().astype(np.uint8)])
