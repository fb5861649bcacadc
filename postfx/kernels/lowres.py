"""Shape colour and average it by area to the 256x256 copy that the tone mapper's network sees.

Bindings (float32): colour (height, width, 3) scene-linear; params (3,): exposure, toe, scale of the shaper; matrix (9,)
row-major, in front of it; lowres (1, 3, 256, 256) in [0, 1]. The average is taken after the shaper, so a firefly moves
it by at most its share of the area. The torch definition is `training.tonemap.model.lowres`.
"""

from __future__ import annotations

import numpy as np

from postfx.kernels.kernel import Kernel
from postfx.kernels.numeric import compiled, fused
from postfx.kernels.shaper import shape_row

SIDE = 256


@fused
def _sum_rows(colour, params, matrix, top, bottom, total, shaped, scratch):
    """total (3, width) = mean of the shaped rows between `top` and `bottom` (in pixels), each by its share."""
    height, width = colour.shape[0], colour.shape[1]
    total[:] = np.float32(0.0)
    for y in range(int(top), min(int(np.ceil(bottom)), height)):
        weight = np.float32((min(y + 1.0, bottom) - max(float(y), top)) / (bottom - top))
        if weight > 0:
            shape_row(colour[y], params, matrix, shaped, scratch)
            for c in range(3):
                for x in range(width):
                    total[c, x] += weight * shaped[c, x]


@compiled
def rows(y0, y1, colour, params, matrix, lowres):
    """Rows y0..y1-1 of the low-resolution copy."""
    height, width = colour.shape[0], colour.shape[1]
    shaped, scratch = np.empty((3, width), np.float32), np.empty(width, np.int32)
    total = np.empty((3, width), np.float32)
    for y in range(y0, y1):
        _sum_rows(colour, params, matrix, y * height / SIDE, (y + 1) * height / SIDE, total, shaped, scratch)
        for x in range(SIDE):
            left, right = x * width / SIDE, (x + 1) * width / SIDE
            r = g = b = np.float32(0.0)
            for i in range(int(left), min(int(np.ceil(right)), width)):
                weight = np.float32((min(i + 1.0, right) - max(float(i), left)) / (right - left))
                r += weight * total[0, i]
                g += weight * total[1, i]
                b += weight * total[2, i]
            lowres[0, 0, y, x], lowres[0, 1, y, x], lowres[0, 2, y, x] = r, g, b


LOWRES = Kernel(
    name="lowres",
    reads=("colour", "params", "matrix"),
    writes=("lowres",),
    rows=rows,
    row_axis=("lowres", 2),
    shapes={"colour": ("height", "width", 3), "params": (3,), "matrix": (9,), "lowres": (1, 3, SIDE, SIDE)},
)
