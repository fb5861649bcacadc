"""Colour by look-up: a shaper, a cube of colours, and the code values of a display.

Cube: (size, size, size, 3): red, green, blue, channel. Tetrahedral look-up: of the eight corners
around a colour only the four on the path from the lowest to the highest count, so greys come from
the cube's diagonal. Formula: Kasson et al. 1995, "Performing color space conversions with
three-dimensional linear interpolation".

Shaper: a matrix, then log2(1 + exposure * x / toe) * scale in [0, 1]. The matrix converts Rec.709
to wider primaries (Rec.2020 for the shipped looks), so that colours outside Rec.709, which are
negative there, are not clipped. Light above the range is scaled down as a whole: its channels keep
their ratio, and so its hue.

`apply_cube` looks exposed light up in a cube, through the shaper. Bindings (float32): colour
(height, width, 3) scene-linear; params (3,): exposure, toe and scale of the shaper; matrix (9,)
row-major, to the cube's primaries; cube; output (height, width, 3). Negative values after the
matrix and NaN count as 0. The torch definition is `training.kernels.tonemap.ApplyCube`.

`encode_display` converts light or SDR code values to a display's code values: decode, convert
primaries, clip, encode. Bindings (float32): colour (height, width, 3); params (12,): 3x3 matrix
row-major, whether colour is code values (0 or 1), the light above which it clips, and the exponent
of the luminance by which light is multiplied; decode (4098,): light of evenly spaced code values
0..1; encode (4098,): code values over the eighth root of light 0..1; output (height, width, 3) code
values 0..1. NaN becomes 0. Both tables repeat their last value; `postfx.passes.display` makes them.
The torch definition is `training.kernels.tonemap.EncodeDisplay`.

`show_neutral` and `show_reinhard` are the formulas of `postfx.colour.views`: light of a scene to
light of a display. Bindings (float32): colour (height, width, 3); params (14,): exposure, a 3x3
matrix row-major to the formula's primaries, the weights of luminance there, and the display's most
light; output (height, width, 3). Negative values after the matrix and NaN count as 0.

`convert_primaries` is a matrix alone: colour (height, width, 3); matrix (9,) row-major; output
(height, width, 3), of any sign. The torch definition is
`training.kernels.tonemap.ConvertPrimaries`.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from postfx.colour import LUMA_REC2020
from postfx.compiled.library import Rows
from postfx.kernels import BRIGHTEST as BRIGHTEST
from postfx.kernels import Kernel

APPLY_CUBE = Kernel(
    name="apply_cube",
    reads=("colour", "params", "matrix", "cube"),
    writes=("output",),
    rows=Rows("apply_cube"),
    row_axis=("output", 0),
    shapes={
        "colour": ("height", "width", 3),
        "params": (3,),
        "matrix": (9,),
        "cube": ("size", "size", "size", 3),
        "output": ("height", "width", 3),
    },
    pixels=(1, 2),
)


def apply_cube_fours_rows(y0: int, y1: int, colour: np.ndarray, params: np.ndarray,
                          matrix: np.ndarray, cube: np.ndarray, output: np.ndarray) -> None:
    """What the kernel below computes. Only a GPU runs it."""
    APPLY_CUBE.rows(y0, y1, colour, params, matrix, np.ascontiguousarray(cube[..., :3]), output)


APPLY_CUBE_FOURS = replace(APPLY_CUBE, name="apply_cube_fours", rows=apply_cube_fours_rows,
                           shapes={**APPLY_CUBE.shapes, "cube": ("size", "size", "size", 4)})


def form_of(cube: np.ndarray, on_gpu: bool) -> tuple[Kernel, np.ndarray]:
    """The kernel that looks colours up in a cube (size, size, size, 3), and the cube as it reads
    it: on a GPU with a number more, so that a colour is read at once."""
    return ((APPLY_CUBE_FOURS, np.pad(cube, ((0, 0), (0, 0), (0, 0), (0, 1)))) if on_gpu
            else (APPLY_CUBE, cube))


STEPS = 4096
ROOT = 8

# Places in `params`
CODES = 9
MOST = 10
EXPONENT = 11

DARK = 1e-9
RED = np.float32(LUMA_REC2020[0])
GREEN = np.float32(LUMA_REC2020[1])
BLUE = np.float32(LUMA_REC2020[2])

ENCODE_DISPLAY = Kernel(
    name="encode_display",
    reads=("colour", "params", "decode", "encode"),
    writes=("output",),
    rows=Rows("encode_display"),
    row_axis=("output", 0),
    shapes={
        "colour": ("height", "width", 3),
        "params": (12,),
        "decode": (STEPS + 2,),
        "encode": (STEPS + 2,),
        "output": ("height", "width", 3),
    },
)

SHOW_NEUTRAL = Kernel(
    name="show_neutral",
    reads=("colour", "params"),
    writes=("output",),
    rows=Rows("show_neutral"),
    row_axis=("output", 0),
    shapes={"colour": ("height", "width", 3), "params": (14,), "output": ("height", "width", 3)},
)
SHOW_REINHARD = replace(SHOW_NEUTRAL, name="show_reinhard", rows=Rows("show_reinhard"))

CONVERT_PRIMARIES = Kernel(
    name="convert_primaries",
    reads=("colour", "matrix"),
    writes=("output",),
    rows=Rows("convert_primaries"),
    row_axis=("output", 0),
    shapes={"colour": ("height", "width", 3), "matrix": (9,), "output": ("height", "width", 3)},
)
