"""What a look must never do, measured on charts: tint greys, turn ramps round, band, flip hues, make haloes.

A `Render` takes exposed scene-linear Rec.709 (H,W,3) float32 to sRGB code values (H,W,3) in [0, 1]. Code values are
given in steps of 8 bits, colour differences in Delta E ITP (ITU-R BT.2124) of a display whose white is 100 cd/m2.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from postfx.bench.metrics import LUMINANCE
from postfx.colour.difference import itp
from postfx.colour.displays import parse_display
from training.charts import MID_GREY, hue_chart, ramp

Render = Callable[[np.ndarray], np.ndarray]
SRGB = parse_display("srgb")
STEPS = 255
SWEEP = range(-6, 7)
COLOURFUL = 20.0  # Delta E ITP from grey: below that a hue means little
EDGE_STOPS, EDGE_REACH = 6.0, 0.25  # of the step, and how near to it counts, in shares of the picture's width


def chroma(codes: np.ndarray) -> np.ndarray:
    """Delta E ITP of sRGB code values (..., 3) to the grey of the same intensity."""
    return 720 * np.hypot(*np.moveaxis(itp(codes, SRGB)[..., 1:], -1, 0))


def hue(codes: np.ndarray) -> np.ndarray:
    """Angle of sRGB code values (..., 3) in the plane of T and P, radians."""
    return np.arctan2(*np.moveaxis(itp(codes, SRGB)[..., 1:], -1, 0))


def greys(render: Render, reference: Render) -> dict[str, float]:
    """Of a grey ramp: largest chroma, largest fall and largest step between neighbours in steps of 8 bits.

    `rough` is how much the largest step is larger than the reference's: a band that eight bits alone do not make.
    """
    found, wanted = (make(ramp())[32] for make in (render, reference))
    rise, wanted_rise = (np.diff(x @ LUMINANCE) * STEPS for x in (found, wanted))
    return {
        "chroma": float(chroma(found).max()),
        "fall": float(max(0.0, -rise.min())),
        "rough": float(max(0.0, rise.max() - wanted_rise.max())),
    }


def hue_flips(found: np.ndarray, wanted: np.ndarray) -> float:
    """Share of pixels, colourful in both, whose hue is more than a quarter turn from the reference's."""
    both = (chroma(found) > COLOURFUL) & (chroma(wanted) > COLOURFUL)
    turn = np.abs((hue(found) - hue(wanted) + np.pi) % (2 * np.pi) - np.pi)
    return float((both & (turn > np.pi / 2)).mean())


def sweep(render: Render, reference: Render, picture: np.ndarray) -> dict[str, float | bool]:
    """A picture from -6 to +6 EV and a chart of 23 stops: all finite and in range, and the largest share of flips."""
    light = [picture * np.float32(2.0**ev) for ev in SWEEP] + [hue_chart()]
    found = [render(x) for x in light]
    fine = all(np.isfinite(x).all() and x.min() >= 0 and x.max() <= 1 for x in found)
    flips = max(hue_flips(x, reference(y)) for x, y in zip(found, light, strict=True))
    return {"in_range": fine, "hue_flips": flips}


def halo(render: Render, reference: Render) -> float:
    """How much more than the reference a look swings beside an edge of 6 stops, in steps of 8 bits.

    The swing is how far luminance departs, near the edge, from what it is far away on the same side.
    """
    return max(0.0, _swing(render) - _swing(reference))


def _swing(render: Render, height: int = 256, width: int = 512) -> float:
    edge = np.full((height, width, 3), MID_GREY * 2.0 ** (-EDGE_STOPS / 2), np.float32)
    edge[:, width // 2 :] *= np.float32(2.0**EDGE_STOPS)
    row = (render(edge) @ LUMINANCE)[height // 2] * STEPS
    reach, half = int(EDGE_REACH * width), width // 2
    dark, bright = row[half - reach : half - 1] - row[half // 4], row[half + 1 : half + reach] - row[-half // 4]
    return float(max(np.abs(dark).max(), np.abs(bright).max()))
