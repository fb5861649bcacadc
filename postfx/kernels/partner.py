"""Kernels that mix a picture with another denoiser's.

Both pictures are compared in logarithms of exposed light, log(1 + x). Between them lies an interval
around their weighted mean. The last mixture, moved along the motion, is what comes out where it
lies in that interval, and the nearest end of the interval elsewhere. So the mixture is as steady as
both pictures allow, and shows nothing that neither of them shows.

colour, partner, history (height, width, 3); motion (height, width, 2), or (1, 1, 2) for one vector
everywhere; weight and strength (height, width, 1), or (1, 1, 1) for one number: how much the
partner counts, and how strongly all of it acts; settings (4,): exposure; how far the interval
reaches from the mean to the nearer picture, 0 to 1; whether there is a history; and what all
strengths are multiplied by.
"""

from __future__ import annotations

import numpy as np

from postfx.compiled.library import Rows
from postfx.kernels import Kernel

MOST_LIGHT = np.float32(1e30)
"""Exposed light: more counts as this much."""
MOST_MOVED = np.float32(1 << 24)
"""Pixels: beyond, float32 has no fractions, and the place lies outside of any picture."""
PICTURE_SHAPE = ("height", "width", 3)
MIX_PARTNER = Kernel(
    name="mix_partner",
    reads=("colour", "partner", "history", "motion", "weight", "strength", "settings"),
    writes=("output",),
    rows=Rows("mix_partner"),
    row_axis=("output", 0),
    shapes={"colour": PICTURE_SHAPE, "partner": PICTURE_SHAPE, "history": PICTURE_SHAPE,
            "motion": ("motion_h", "motion_w", 2), "weight": ("weight_h", "weight_w", 1),
            "strength": ("strength_h", "strength_w", 1), "settings": (4,), "output": PICTURE_SHAPE},
)

ENLARGE_MOTION = Kernel(
    name="enlarge_motion",
    reads=("motion", "rows", "columns", "ratio"),
    writes=("enlarged",),
    rows=Rows("enlarge_motion"),
    row_axis=("enlarged", 0),
    shapes={"motion": ("h", "w", 2), "rows": ("height",), "columns": ("width",), "ratio": (2,),
            "enlarged": ("height", "width", 2)},
)
"""Motion of the nearest render pixel, in pixels of the output; ratio (2,): output size over render
size, x and y."""
