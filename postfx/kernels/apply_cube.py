"""Look colours up in a cube: exposed light turned to the cube's primaries, shaped, and read between eight corners.

Bindings (float32): colour (height, width, 3) scene-linear; params (3,): exposure, toe, scale of the shaper; matrix (9,)
row-major, to the cube's primaries; cube (size, size, size, 3): red, green, blue, channel; output (height, width, 3).
Between the corners the look-up is tetrahedral, which keeps greys what the cube's diagonal says (Kasson et al. 1995).
What is negative after the matrix, and NaN, count as 0. The torch definition is
`training.networks.tonemap_kernels.ApplyCube`.
"""

from __future__ import annotations

import numpy as np

from postfx.kernels.encode_display import known
from postfx.kernels.kernel import Kernel
from postfx.kernels.numeric import compiled
from postfx.kernels.shaper import shape_row


@compiled
def _turned(row, m, out):
    """Colour (width, 3) times a matrix -> out, flat."""
    for x in range(row.shape[0]):
        r, g, b = known(row[x, 0]), known(row[x, 1]), known(row[x, 2])
        out[3 * x] = m[0] * r + m[1] * g + m[2] * b
        out[3 * x + 1] = m[3] * r + m[4] * g + m[5] * b
        out[3 * x + 2] = m[6] * r + m[7] * g + m[8] * b


@compiled
def _middle(fr, fg, fb, a, b, c):
    """The two corners between the first and the last of a tetrahedron, as steps from the first, and the shares of a
    colour sorted, largest first. a, b, c are the steps along red, green and blue."""
    if fr >= fg:
        if fg >= fb:
            return a, a + b, fr, fg, fb
        if fr >= fb:
            return a, a + c, fr, fb, fg
        return c, a + c, fb, fr, fg
    if fr >= fb:
        return b, a + b, fg, fr, fb
    if fg >= fb:
        return b, b + c, fg, fb, fr
    return c, b + c, fb, fg, fr


@compiled
def rows(y0, y1, colour, params, matrix, cube, output):
    """Output rows y0..y1-1."""
    width, size = colour.shape[1], cube.shape[0]
    flat, corners = cube.reshape(size * size * size, 3), np.float32(size - 1)
    light, shaped = np.empty(3 * width, np.float32), np.empty(3 * width, np.float32)
    scratch = np.empty(3 * width, np.int32)
    blue, green, red = 1, size, size * size
    for y in range(y0, y1):
        _turned(colour[y], matrix, light)
        shape_row(light, params, shaped, scratch)
        for x in range(width):
            r, g, b = shaped[3 * x] * corners, shaped[3 * x + 1] * corners, shaped[3 * x + 2] * corners
            i, j, k = min(int(r), size - 2), min(int(g), size - 2), min(int(b), size - 2)
            first = i * red + j * green + k * blue
            second, third, most, middle, least = _middle(
                r - np.float32(i), g - np.float32(j), b - np.float32(k), red, green, blue)
            second, third, last = first + second, first + third, first + red + green + blue
            w0, w1, w2 = np.float32(1) - most, most - middle, middle - least
            for c in range(3):
                output[y, x, c] = (w0 * flat[first, c] + w1 * flat[second, c]
                                   + (w2 * flat[third, c] + least * flat[last, c]))


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
