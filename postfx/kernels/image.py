"""Kernels of whole pictures: resampling, transparency overlays, a checkerboard, and comparing
places.

- Cubic resampling of any plane to another size.
- Overlays of premultiplied RGBA: cubic enlarging without halos, and compositing.
- A checkerboard of two greys (float32): rows (height,) and columns (width,) alternate between 0 and
  1 from cell to cell; greys (2,) are of cells where both are equal and of the others; output
  (height, width, 3). The torch definition is `training.kernels.tonemap.Checkerboard`.
- On the host: how far points of a picture are from another one at many places, by which the doctor
  tries motion.
"""

from __future__ import annotations

import numpy as np

from postfx.compiled.library import Rows
from postfx.kernels import Kernel


def positions(size: int, out_size: int, shift: float = 0.0) -> np.ndarray:
    """Where the output's pixel centres lie in an image whose samples are `shift` pixels off their
    centres."""
    return ((np.arange(out_size) + 0.5) * (size / out_size) - 0.5 - shift).astype(np.float32)


def resample(image: np.ndarray, height: int, width: int, jitter: tuple[float, float]) -> np.ndarray:
    """Cubic interpolation of (h, w, C), whose samples are `jitter` (x, y) pixels off their centres,
    in this thread."""
    output = np.empty((height, width, image.shape[2]), np.float32)
    h, w = image.shape[:2]
    RESAMPLE.rows(0, height, np.ascontiguousarray(image, np.float32),
                  positions(h, height, jitter[1]), positions(w, width, jitter[0]), output)
    return output


RESAMPLE = Kernel("resample", ("image", "rows", "columns"), ("output",), Rows("resample"),
                  ("output", 0),
                  {"image": ("h", "w", "channels"), "rows": ("height",), "columns": ("width",),
                   "output": ("height", "width", "channels")}, pixels=(2, 2))

RGBA_SHAPE = ("height", "width", 4)
COLOUR_SHAPE = ("height", "width", 3)
ALPHA_SHAPE = ("height", "width", 1)
ENLARGE_OVERLAY = Kernel("overlay_enlarge", ("image", "rows", "columns"), ("output",),
                         Rows("overlay_enlarge"), ("output", 0),
                         {"image": ("h", "w", 4), "rows": ("height",), "columns": ("width",),
                          "output": RGBA_SHAPE})
OVER = Kernel("overlay_over", ("overlay", "colour"), ("output",), Rows("overlay_over"),
              ("output", 0),
              {"overlay": RGBA_SHAPE, "colour": COLOUR_SHAPE, "output": COLOUR_SHAPE})
OVER_ALPHA = Kernel("overlay_over_alpha", ("overlay", "alpha"), ("output",),
                    Rows("overlay_over_alpha"), ("output", 0),
                    {"overlay": RGBA_SHAPE, "alpha": ALPHA_SHAPE, "output": ALPHA_SHAPE})


def turns(size: int, side: float) -> np.ndarray:
    """0 or 1 of each of `size` pixels in a row, changing every `side` pixels; float32 (size,)."""
    return ((np.arange(size) + 0.5) // side % 2).astype(np.float32)


CHECKERBOARD = Kernel(
    name="checkerboard",
    reads=("rows", "columns", "greys"),
    writes=("output",),
    rows=Rows("checkerboard"),
    row_axis=("output", 0),
    shapes={"rows": ("height",), "columns": ("width",), "greys": (2,),
            "output": ("height", "width", 3)},
)

_compare = Rows("compare_places")


def compare_places(before: np.ndarray, now: np.ndarray, x: np.ndarray, y: np.ndarray,
                   apart: np.ndarray, inside: np.ndarray) -> None:
    """Largest difference of a channel between points now (points, channels) and a picture before
    (h, w, channels), mixed of four pixels at places x and y (count, points), which are brought to
    its edge; and whether they lie in it.
    """
    given = (np.ascontiguousarray(array, np.float32) for array in (before, now, x, y))
    _compare(0, len(x), *given, apart, inside.view(np.uint8))
