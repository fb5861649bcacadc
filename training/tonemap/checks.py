"""Faults that a look must not have, measured on charts: tinted greys, reversed ramps, banding,
flipped hues, haloes.

A `Render` takes exposed scene-linear Rec.709 (H,W,3) float32 to sRGB code values (H,W,3) in [0, 1].
Code values are given in steps of 8 bits, colour differences in Delta E ITP (ITU-R BT.2124) of a
display whose white is 100 cd/m2.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import minimize_scalar

from postfx.colour.displays import parse_display
from postfx.exposure import ExposureMeter
from postfx.frame import Frame, Role
from postfx.io.sequence import read_sequence
from postfx.sampling import motion_at
from postfx.tools.bench.metrics import FOLLOWED_DIFFERENCE, LUMINANCE_WEIGHTS, warp
from postfx.tools.look_table import to_itp
from training.tonemap.looks import View, exact_view
from training.tonemap.model import MID_GREY
from training.tonemap.pictures import hue_chart, ramp

# Checks of a look ---------------------------------------------------------------------------------

Render = Callable[[np.ndarray], np.ndarray]
SRGB = parse_display("srgb")
STEPS = 255
SWEEP = range(-6, 7)
COLOURFUL = 20.0  # Delta E ITP from grey: below that a hue means little
EDGE_STOPS = 6.0
"""Height of the step of light."""
EDGE_REACH = 0.25
"""Distance from the step within which pixels count, as a share of the picture's width."""


def chroma(codes: np.ndarray) -> np.ndarray:
    """Delta E ITP of sRGB code values (..., 3) from the grey of the same intensity."""
    return 720 * np.hypot(*np.moveaxis(to_itp(codes, SRGB)[..., 1:], -1, 0))


def hue(codes: np.ndarray) -> np.ndarray:
    """Angle of sRGB code values (..., 3) in the plane of T and P, radians."""
    return np.arctan2(*np.moveaxis(to_itp(codes, SRGB)[..., 1:], -1, 0))


def greys(render: Render, reference: Render) -> dict[str, float]:
    """What becomes of a grey ramp: largest chroma, largest fall and largest step between neighbours
    in steps of 8 bits.

    `rough` is how much the largest step is larger than the reference's: a band that eight bits
    alone do not make.
    """
    found, wanted = (make(ramp())[32] for make in (render, reference))
    rise, wanted_rise = (np.diff(x @ LUMINANCE_WEIGHTS) * STEPS for x in (found, wanted))
    return {
        "chroma": float(chroma(found).max()),
        "fall": float(max(0.0, -rise.min())),
        "rough": float(max(0.0, rise.max() - wanted_rise.max())),
    }


def hue_flips(found: np.ndarray, wanted: np.ndarray) -> float:
    """Share of pixels, colourful in both, whose hue is more than a quarter turn from the
    reference's."""
    both = (chroma(found) > COLOURFUL) & (chroma(wanted) > COLOURFUL)
    turn = np.abs((hue(found) - hue(wanted) + np.pi) % (2 * np.pi) - np.pi)
    return float((both & (turn > np.pi / 2)).mean())


def sweep(render: Render, reference: Render, picture: np.ndarray) -> dict[str, float | bool]:
    """A picture from -6 to +6 EV and a chart of 23 stops: all finite and in range, and the largest
    share of flips."""
    light = [picture * np.float32(2.0**ev) for ev in SWEEP] + [hue_chart()]
    found = [render(x) for x in light]
    fine = all(np.isfinite(x).all() and x.min() >= 0 and x.max() <= 1 for x in found)
    flips = max(hue_flips(x, reference(y)) for x, y in zip(found, light, strict=True))
    return {"in_range": fine, "hue_flips": flips}


def halo(render: Render, reference: Render) -> float:
    """How much more than the reference a look swings beside an edge of 6 stops, in steps of 8 bits.

    The swing is how far luminance departs, near the edge, from what it is far away on the same
    side.
    """
    return max(0.0, _swing(render) - _swing(reference))


def _swing(render: Render, height: int = 256, width: int = 512) -> float:
    edge = np.full((height, width, 3), MID_GREY * 2.0 ** (-EDGE_STOPS / 2), np.float32)
    edge[:, width // 2 :] *= np.float32(2.0**EDGE_STOPS)
    row = (render(edge) @ LUMINANCE_WEIGHTS)[height // 2] * STEPS
    reach, half = int(EDGE_REACH * width), width // 2
    dark = row[half - reach : half - 1] - row[half // 4]
    bright = row[half + 1 : half + reach] - row[-half // 4]
    return float(max(np.abs(dark).max(), np.abs(bright).max()))


# Flicker ------------------------------------------------------------------------------------------
# How steady a look is in motion: its change from frame to frame along the motion.

Maker = Callable[[Frame], np.ndarray]
"""A clean frame, exposed, in order; the first is marked as a beginning -> sRGB code values
(H,W,3)."""
SPARSE = 4  # pixels to the next that an exposure is fitted to, along both axes
STOPS = 6.0  # largest exposure that is tried


def exposed_frames(folder: Path) -> Iterator[Frame]:
    """Clean frames of a folder's `reference.####.exr`, exposed as the run-time's meter would."""
    meter = ExposureMeter("auto")
    for number, clean in enumerate(read_sequence(str(folder / "reference.####.exr"))):
        yield Frame({Role.COLOUR: clean[Role.COLOUR] * np.float32(meter(clean))},
                    number=clean.number, reset=not number)


def motions(folder: Path) -> Iterator[np.ndarray]:
    """Motion of a folder's `noisy.####.exr`, (h, w, 2) in its own pixels."""
    return (given[Role.MOTION] for given in read_sequence(str(folder / "noisy.####.exr")))


def nearest_exposure(view: View, light: list[np.ndarray], shown: list[np.ndarray]) -> float:
    """Exposure in stops, applied before a view, that brings it nearest to a look's pictures of a
    sequence.

    One number for all frames, by least squares of code values. light: frames of exposed
    scene-linear (H,W,3); shown: the look's code values of them.
    """
    given, wanted = (np.stack([x[::SPARSE, ::SPARSE] for x in frames]) for frames in (light, shown))

    def error(stops: float) -> float:
        return float(np.square(exact_view(view, given * np.float32(2.0**stops)) - wanted).mean())

    return float(minimize_scalar(error, bounds=(-STOPS, STOPS), method="bounded",
                                 options={"xatol": 1e-4}).x)


def flicker(folder: Path, looks: dict[str, Maker], judge: str) -> dict[str, dict[str, float]]:
    """Two figures of each look, over pixels where the look named `judge` changes by less than 0.1
    along the motion; elsewhere the motion cannot be trusted.

    flicker: 1000 times the mean absolute change from frame to frame along the motion.
    contrast: 1000 times the mean absolute change to the next pixels, right and below, in the same
    frames. A static
        curve shows a render's noise and detail as flicker, in proportion to its contrast.
    """
    before: dict[str, Any] = {}
    sums, count = {name: np.zeros(2) for name in looks}, 0
    for frame, motion in zip(exposed_frames(folder), motions(folder), strict=False):
        now = {name: make(frame) for name, make in looks.items()}
        if before:
            height, width = frame[Role.COLOUR].shape[:2]
            along = motion_at(motion, np.arange(height), np.arange(width), height, width)
            change = {name: np.abs(now[name] - warp(before[name], along)) for name in looks}
            followed = change[judge].max(-1) < FOLLOWED_DIFFERENCE
            count += int(followed.sum())
            for name in looks:
                sums[name] += [x.mean(-1)[followed].sum(dtype=np.float64)
                               for x in (change[name], contrast(now[name]))]
        before = now
    figures = {name: 1000 * both / max(1, count) for name, both in sums.items()}
    return {name: {"flicker": round(float(x[0]), 3), "contrast": round(float(x[1]), 3)}
            for name, x in figures.items()}


def contrast(picture: np.ndarray) -> np.ndarray:
    """Mean absolute difference of each pixel (H,W,3) to the next on its right and below; 0 beyond
    the edges."""
    right, below = (np.abs(np.diff(picture, axis=axis, append=picture.take([-1], axis)))
                    for axis in (1, 0))
    return (right + below) / 2
