"""A checkerboard of two greys.

Bindings (float32): rows (height,) and columns (width,), 0 or 1 by turns from cell to cell; greys (2,), of cells where
both are the same and of the others; output (height, width, 3). The torch definition is
`training.kernels.tonemap.Checkerboard`.
"""

from __future__ import annotations

import numpy as np

from postfx.kernels.kernel import Kernel
from postfx.kernels.numeric import compiled


@compiled
def rows(y0, y1, rows, columns, greys, output):
    """Output rows y0..y1-1."""
    for y in range(y0, y1):
        for x in range(columns.size):
            grey = greys[0] if rows[y] == columns[x] else greys[1]
            for c in range(3):
                output[y, x, c] = grey


def turns(size: int, side: float) -> np.ndarray:
    """0 or 1 of each of `size` pixels in a row, changing every `side` pixels; float32 (size,)."""
    return ((np.arange(size) + 0.5) // side % 2).astype(np.float32)


CHECKERBOARD = Kernel(
    name="checkerboard",
    reads=("rows", "columns", "greys"),
    writes=("output",),
    rows=rows,
    row_axis=("output", 0),
    shapes={"rows": ("height",), "columns": ("width",), "greys": (2,), "output": ("height", "width", 3)},
)
