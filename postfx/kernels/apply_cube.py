"""Look colours up in a cube: exposed light turned to the cube's primaries, shaped, and read between eight corners.

Bindings (float32): colour (height, width, 3) scene-linear; params (3,): exposure, toe, scale of the shaper; matrix (9,)
row-major, to the cube's primaries; cube (size, size, size, 3): red, green, blue, channel; output (height, width, 3).
See `postfx.kernels.shaper` and `postfx.kernels.cube` for the two steps. What is negative after the matrix counts as 0,
and so does NaN. The torch definition is `training.kernels.tonemap.ApplyCube`.
"""

from __future__ import annotations

import numpy as np

from postfx.kernels.cube import cube_row
from postfx.kernels.kernel import Kernel
from postfx.kernels.numeric import compiled
from postfx.kernels.shaper import shape_row


@compiled
def rows(y0, y1, colour, params, matrix, cube, output):
    """Output rows y0..y1-1."""
    width = colour.shape[1]
    shaped, scratch = np.empty((3, width), np.float32), np.empty(width, np.int32)
    places, shares = np.empty((3, width), np.int32), np.empty((3, width), np.float32)
    for y in range(y0, y1):
        shape_row(colour[y], params, matrix, shaped, scratch)
        cube_row(shaped, cube, places, shares, output[y])


APPLY_CUBE = Kernel(
    name="apply_cube",
    reads=("colour", "params", "matrix", "cube"),
    writes=("output",),
    rows=rows,
    row_axis=("output", 0),
    shapes={
        "colour": ("height", "width", 3),
        "params": (3,),
        "matrix": (9,),
        "cube": ("size", "size", "size", 3),
        "output": ("height", "width", 3),
    },
)
