"""Exponential smoothing over time: result = current + keep * (previous - current).

Bindings (float32): previous, current and result (1, 16, 16, 8, 12); keep (1, 4), of which the first number counts: see
`postfx.kernels.follow`. It is 0 at the first frame and at cuts. The torch definition is
`training.tonemap.model.smooth`.
"""

from __future__ import annotations

import numpy as np

from postfx.kernels.kernel import Kernel
from postfx.kernels.numeric import compiled

GRID = (1, 16, 16, 8, 12)
BROKEN = np.float32(1e4)
"""Change beyond that of any grid, as is NaN: there `previous` counts for nothing."""


@compiled
def rows(y0, y1, previous, current, keep, result):
    """Grid rows y0..y1-1; with keep 0 `previous` is not looked at, so it may hold anything."""
    weight = np.float32(keep[0, 0])
    for y in range(y0, y1):
        for x in range(current.shape[2]):
            for level in range(current.shape[3]):
                for k in range(current.shape[4]):
                    value = current[0, y, x, level, k]
                    change = previous[0, y, x, level, k] - value
                    if weight > 0 and abs(change) <= BROKEN:
                        value += weight * change
                    result[0, y, x, level, k] = value


SMOOTH = Kernel(
    name="smooth",
    reads=("previous", "current", "keep"),
    writes=("result",),
    rows=rows,
    row_axis=("result", 1),
    shapes={"previous": GRID, "current": GRID, "keep": (1, 4), "result": GRID},
)
