"""Expose, clip to [0, 1] and encode by the sRGB curve (IEC 61966-2-1).

Bindings (float32): colour (height, width, 3) linear; exposure (1,) multiplier; output (height, width, 3). NaN becomes
0. The torch definition is `training.networks.tonemap_kernels.EncodeSrgb`.
"""

from __future__ import annotations

import numpy as np

from postfx.kernels.kernel import Kernel
from postfx.kernels.numeric import compiled

STEPS = 4096
ZERO, ONE = np.float32(0.0), np.float32(1.0)


def _curve_of_root() -> np.ndarray:
    """The curve over the square root of its argument, where straight lines between 4096 steps err by under 1e-6."""
    linear = np.linspace(0.0, 1.0, STEPS + 1) ** 2
    bright = 1.055 * np.maximum(linear, 0.0031308) ** (1 / 2.4) - 0.055
    return np.append(np.where(linear <= 0.0031308, 12.92 * linear, bright), 1.0).astype(np.float32)


TABLE = _curve_of_root()


@compiled
def rows(y0, y1, colour, exposure, output):
    """Output rows y0..y1-1."""
    scale = exposure[0]
    for y in range(y0, y1):
        for x in range(colour.shape[1]):
            for c in range(3):
                value = colour[y, x, c] * scale
                value = min(value, ONE) if value > ZERO else ZERO
                place = np.sqrt(value) * np.float32(STEPS)
                i = int(place)
                low = TABLE[i]
                output[y, x, c] = low + (place - np.float32(i)) * (TABLE[i + 1] - low)


ENCODE_SRGB = Kernel(
    name="encode_srgb",
    reads=("colour", "exposure"),
    writes=("output",),
    rows=rows,
    row_axis=("output", 0),
    shapes={"colour": ("height", "width", 3), "exposure": (1,), "output": ("height", "width", 3)},
)
