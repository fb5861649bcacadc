"""Mean of each row and channel of the tone mapper's small copy: how much light there is.

Bindings (float32): lowres (1, 3, 256, 256) in [0, 1]; light (256, 3). The torch definition is
`training.tonemap.model.light`.
"""

from __future__ import annotations

import numpy as np

from postfx.kernels.kernel import Kernel
from postfx.kernels.lowres import SIDE
from postfx.kernels.numeric import compiled


@compiled
def rows(y0, y1, lowres, light):
    """Rows y0..y1-1 of the means."""
    for y in range(y0, y1):
        for c in range(3):
            total = np.float64(0.0)
            for x in range(SIDE):
                total += lowres[0, c, y, x]
            light[y, c] = total / SIDE


LIGHT = Kernel(
    name="light",
    reads=("lowres",),
    writes=("light",),
    rows=rows,
    row_axis=("light", 0),
    shapes={"lowres": (1, 3, SIDE, SIDE), "light": (SIDE, 3)},
)
