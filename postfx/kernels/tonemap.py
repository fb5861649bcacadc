"""Kernels of the tone mapper, in the order in which they run. All bindings are float32.

`lowres` shapes colour and averages it by area to the 256x256 copy that the network sees. Bindings:
colour (height, width, 3) scene-linear; params (3,): exposure, toe and scale of the shaper; matrix
(9,) row-major, applied first; lowres (1, 3, 256, 256) in [0, 1]. Averaging after the shaper limits
a firefly's effect to its share of the area.

`light` is the mean of each row and channel of the copy. Bindings: lowres; light (256, 3).

`follow` decides how much of the last frame's grid is kept: nearly all in steady light, less while
the light changes. Light is the mean of the shaped copy, in stops. It changes if it differs by more
than `LAG` from the light that the grid was made for, or by more than `JUMP` from the last frame's.
Beyond twice as much, the grid covers `follow` of the way in one frame, and `RELEASE` of that in
each later frame. Two speeds for small and large changes come from the 1 euro filter (Casiez,
Roussel and Vogel 2012). A camera's motion changes the mean less than the grid, so the mean
separates light from motion. Bindings: light (256, 3); params (4,): keep and follow in [0, 1],
whether there is a past (1 or 0), scale of the shaper, which is one stop; before and after (1, 4):
kept part of the grid, the light that the grid is made for, the light, and 1 minus the kept part,
which is 0 without a past. A past with NaN or infinity counts as none.

`smooth` is exponential smoothing over time: result = current + keep * (previous - current).
Bindings: previous, current and result (1, 16, 16, 8, 12); keep (1, 4), the output of `follow`, of
which the first number counts; it is 0 on the first frame and at cuts.

`expose` mixes the stops that a look adds with the last frame's, into the parameters of
`apply_cube`. Bindings: previous and result (3,): 2 ** stops, toe over the frame's exposure, and
scale, which act like exposure, toe and scale; current (1, 1): stops; keep (1, 4); params (3,): the
frame's exposure, toe, scale. It mixes stops, not factors. A past with NaN or infinity counts as
none.

`slice_apply` looks up the bilateral grid at every pixel, applies the affine colour matrix found
there, then the cube. Bindings: colour (height, width, 3) scene-linear; params (3,): exposure, toe
and scale of the shaper; matrix (9,) row-major, to the cube's primaries; guide (112,): matrix 9,
bias 3, shifts 3x16, slopes 3x16, mix 3, mix bias 1; grid (1, 16, 16, 8, 12): y, x, guide level, 3x4
matrix row-major; cube (size, size, size, 3): red, green, blue, channel; output (height, width, 3)
in the cube's values. Formula: Gharbi et al. 2017, between the shaper and the cube.

The torch definitions are the functions of these names in `training.tonemap.model`.
"""

from __future__ import annotations

import numpy as np

from postfx.compiled.library import Rows
from postfx.kernels import Kernel

SIDE = 256

LOWRES = Kernel(
    name="lowres",
    reads=("colour", "params", "matrix"),
    writes=("lowres",),
    rows=Rows("lowres"),
    row_axis=("lowres", 2),
    shapes={"colour": ("height", "width", 3), "params": (3,), "matrix": (9,),
            "lowres": (1, 3, SIDE, SIDE)},
)

LIGHT = Kernel(
    name="light",
    reads=("lowres",),
    writes=("light",),
    rows=Rows("light"),
    row_axis=("light", 0),
    shapes={"lowres": (1, 3, SIDE, SIDE), "light": (SIDE, 3)},
)

# Stops that count as a change of light: from the light of the grid, and from the last frame's. A
# camera that crossed a staircase in 8 frames moved the mean by 0.17, by no more than 0.04 in a
# frame.
LAG = np.float64(1 / 4)
JUMP = np.float64(1 / 16)

RELEASE = np.float64(0.95)
"""Share of the way that the grid covers in each later frame, of what it covered in the one
before."""
MOST = np.float64(1e4)
"""Stops between two lights that cannot be, as is NaN: there is no past, then."""

FOLLOW = Kernel(
    name="follow",
    reads=("light", "params", "before"),
    writes=("after",),
    rows=Rows("follow"),
    row_axis=("after", 0),
    shapes={"light": (SIDE, 3), "params": (4,), "before": (1, 4), "after": (1, 4)},
)

LEVELS = 8
COEFFICIENTS = 12
GRID_SHAPE = (1, 16, 16, LEVELS, COEFFICIENTS)
BROKEN = np.float32(1e4)
"""Change beyond that of any grid, as is NaN: there `previous` counts for nothing."""

SMOOTH_GRID = Kernel(
    name="smooth",
    reads=("previous", "current", "keep"),
    writes=("result",),
    rows=Rows("smooth"),
    row_axis=("result", 1),
    shapes={"previous": GRID_SHAPE, "current": GRID_SHAPE, "keep": (1, 4), "result": GRID_SHAPE},
)

MOST_STOPS = np.float64(64)
"""Stops between two exposures that cannot be, as is NaN: there `previous` counts for nothing."""

EXPOSE = Kernel(
    name="expose",
    reads=("previous", "current", "keep", "params"),
    writes=("result",),
    rows=Rows("expose"),
    row_axis=("result", 0),
    shapes={"previous": (3,), "current": (1, 1), "keep": (1, 4), "params": (3,), "result": (3,)},
)

KNOTS = 16
GUIDE_SIZE = 9 + 3 + 6 * KNOTS + 3 + 1
SHIFTS = 12
SLOPES = 12 + 3 * KNOTS
MIX = 12 + 6 * KNOTS

SLICE_APPLY = Kernel(
    name="slice_apply",
    reads=("colour", "params", "matrix", "guide", "grid", "cube"),
    writes=("output",),
    rows=Rows("slice_apply"),
    row_axis=("output", 0),
    shapes={
        "colour": ("height", "width", 3),
        "params": (3,),
        "matrix": (9,),
        "guide": (GUIDE_SIZE,),
        "grid": GRID_SHAPE,
        "cube": ("size", "size", "size", 3),
        "output": ("height", "width", 3),
    },
)
