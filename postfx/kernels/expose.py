"""Exposure over time: how many stops a look adds, mixed with the last frame's, as the numbers that `apply_cube` takes.

Bindings (float32): previous and result (3,): 2 ** stops, toe over the frame's exposure, and scale, which shape light as
exposure, toe and scale do; current (1, 1): stops; keep (1, 4), of which the first number counts: see
`postfx.kernels.follow`; params (3,): exposure, toe, scale of the frame. Stops are mixed, not factors. A past that is
broken is none. The torch definition is `training.tonemap.model.expose`.
"""

from __future__ import annotations

import numpy as np

from postfx.kernels.kernel import Kernel
from postfx.kernels.numeric import compiled

MOST = 64.0
"""Stops between two exposures that cannot be, as is NaN: there `previous` counts for nothing."""


@compiled
def rows(y0, y1, previous, current, keep, params, result):
    """Numbers y0..y1-1; in float64, so that the exposure of a still picture stays as it is to the bit."""
    stops = np.float64(current[0, 0])
    before = np.log2(np.float64(previous[0])) if previous[0] > 0 else np.nan
    if keep[0, 0] > 0 and abs(before - stops) <= MOST:
        stops += keep[0, 0] * (before - stops)
    for y in range(y0, y1):
        if y == 0:
            result[y] = 2.0**stops
        elif y == 1:
            result[y] = params[1] / params[0]
        else:
            result[y] = params[y]


EXPOSE = Kernel(
    name="expose",
    reads=("previous", "current", "keep", "params"),
    writes=("result",),
    rows=rows,
    row_axis=("result", 0),
    shapes={"previous": (3,), "current": (1, 1), "keep": (1, 4), "params": (3,), "result": (3,)},
)
