"""How much of the last frame's grid is kept: nearly all while the light stays as it is, less while it changes.

Light is the mean of the shaped small copy, in stops. It changes where it is more than `LAG` from what the grid was made
for, or more than `JUMP` from the last frame's; beyond twice as much, `follow` of the way is gone in a frame, and
`RELEASE` of that in each frame after it. Two speeds for little and for much are those of the 1 euro filter (Casiez,
Roussel and Vogel 2012); a camera's motion moves the mean less than a grid, so that the mean tells light from motion.

Bindings (float32): light (256, 3) of `postfx.kernels.light`; params (4,): keep and follow in [0, 1], whether there is a
past (1, else 0), scale of the shaper, which is one stop; before and after (1, 4): part of the grid that is kept, the
light that the grid is made for, the light, and what the kept part lacks to 1, which is 0 where there was no past. A
past that is broken is none. The torch definition is `training.tonemap.model.follow`.
"""

from __future__ import annotations

import numpy as np

from postfx.kernels.kernel import Kernel
from postfx.kernels.light import SIDE
from postfx.kernels.numeric import compiled

LAG, JUMP = 1 / 4, 1 / 16
"""Stops: a camera that crossed a staircase in 8 frames moved the mean by 0.17, by no more than 0.04 in a frame."""
RELEASE = 0.95
MOST = 1e4
"""Stops between two lights that cannot be, as is NaN: there is no past, then."""


@compiled
def rows(y0, y1, light, params, before, after):
    """The one row; in float64, so that nothing depends on the order of the sum."""
    keep, follow, past, scale = params[0], params[1], params[2], params[3]
    for y in range(y0, y1):
        total = np.float64(0.0)
        for value in light.flat:
            total += value
        now = total / light.size / scale
        lag, jump = abs(before[y, 1] - now), abs(before[y, 2] - now)
        after[y, 0], after[y, 1], after[y, 2], after[y, 3] = 0.0, now, now, 0.0
        if past > 0 and lag <= MOST and jump <= MOST and abs(before[y, 3]) <= 1:
            change = min(max(max(lag / LAG, jump / JUMP) - 1, 0.0), 1.0)
            share = max(max(follow * change, RELEASE * before[y, 3]), 1 - keep)
            after[y, 0], after[y, 3] = 1 - share, share
            after[y, 1] = now + (1 - share) * (before[y, 1] - now)


FOLLOW = Kernel(
    name="follow",
    reads=("light", "params", "before"),
    writes=("after",),
    rows=rows,
    row_axis=("after", 0),
    shapes={"light": (SIDE, 3), "params": (4,), "before": (1, 4), "after": (1, 4)},
)
