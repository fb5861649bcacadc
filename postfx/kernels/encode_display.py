"""Colour as light or SDR code values to a display's code values: decode, turn to its primaries, cut, encode.

Bindings (float32): colour (height, width, 3); params (12,): 3x3 matrix row-major, whether colour is code values (0 or
1), most light that is let through, exponent of the luminance that light is multiplied by; decode (4098,): light of
code values 0..1, evenly spaced; encode (4098,): code values over the eighth root of light 0..1; output (height, width,
3) code values 0..1. NaN becomes 0. The tables end with their last value twice; `postfx.passes.display` makes them. The
torch definition is `training.kernels.tonemap.EncodeDisplay`.
"""

from __future__ import annotations

import numpy as np

from postfx.colour.primaries import LUMA_REC2020
from postfx.kernels.kernel import Kernel
from postfx.kernels.numeric import compiled, inline

STEPS = 4096
ROOT = 8
CODES, MOST, EXPONENT = 9, 10, 11  # places in `params`
LARGEST = 1e10  # light beyond counts as this much, so that infinity times zero is no NaN
DARK = 1e-9
ZERO, ONE, COUNT = np.float32(0), np.float32(1), np.float32(STEPS)
RED, GREEN, BLUE = map(np.float32, LUMA_REC2020)


@inline
def looked_up(table, place):
    """A table between its entries; place is in [0, STEPS]."""
    i = int(place)
    low = table[i]
    return low + (place - np.float32(i)) * (table[i + 1] - low)


@inline
def known(value):
    """A NaN becomes 0, an infinity finite."""
    value = value if value == value else ZERO
    return min(max(value, np.float32(-LARGEST)), np.float32(LARGEST))


@inline
def encoded(light, most, gain, table):
    """Code value of light, which is cut to [0, most] and then multiplied by a gain."""
    unit = min(min(max(light, ZERO), most) * gain, ONE)
    return looked_up(table, np.sqrt(np.sqrt(np.sqrt(unit))) * COUNT)


@compiled
def rows(y0, y1, colour, params, decode, encode, output):
    """Output rows y0..y1-1."""
    m = params
    most, exponent, codes = params[MOST], params[EXPONENT], params[CODES] > ZERO
    for y in range(y0, y1):
        for x in range(colour.shape[1]):
            r, g, b = known(colour[y, x, 0]), known(colour[y, x, 1]), known(colour[y, x, 2])
            if codes:
                r = looked_up(decode, min(max(r, ZERO), ONE) * COUNT)
                g = looked_up(decode, min(max(g, ZERO), ONE) * COUNT)
                b = looked_up(decode, min(max(b, ZERO), ONE) * COUNT)
            red = m[0] * r + m[1] * g + m[2] * b
            green = m[3] * r + m[4] * g + m[5] * b
            blue = m[6] * r + m[7] * g + m[8] * b
            gain = ONE
            if exponent != ZERO:
                luminance = (RED * min(max(red, ZERO), most) + GREEN * min(max(green, ZERO), most)
                             + BLUE * min(max(blue, ZERO), most))
                gain = max(luminance, np.float32(DARK)) ** exponent
            output[y, x, 0] = encoded(red, most, gain, encode)
            output[y, x, 1] = encoded(green, most, gain, encode)
            output[y, x, 2] = encoded(blue, most, gain, encode)


ENCODE_DISPLAY = Kernel(
    name="encode_display",
    reads=("colour", "params", "decode", "encode"),
    writes=("output",),
    rows=rows,
    row_axis=("output", 0),
    shapes={
        "colour": ("height", "width", 3),
        "params": (12,),
        "decode": (STEPS + 2,),
        "encode": (STEPS + 2,),
        "output": ("height", "width", 3),
    },
)
