"""Ways to show light.

Views turn exposed scene-linear light into code values of a display. A view is a function of one
colour. It is evaluated for every pixel, which is exact, or once, at the corners of a cube on
logarithmic axes; the kernel `apply_cube` then interpolates every pixel between them.
Camera operators judge exposure by false colour and zebra, and pictures are compared as code values.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from postfx.colour import ACESCG, REC709, Chromaticities, ocio, to_xyz
from postfx.colour.displays import SRGB, Display, parse_display, srgb_encode

CUBE_SIDE = 65
"""Entries of a view's cube along each axis."""

# The axes: log2(1 + x / AXIS_TOE) * AXIS_SCALE is 0..1 for light of 0..WHITEST, where mid grey is
# 0.18.
AXIS_TOE = 2.0**-10
WHITEST = 2.0**8

AXIS_SCALE = float(1 / np.log2(1 + WHITEST / AXIS_TOE))
_START = 0.8
_DESATURATION = 0.15
_OFFSET = 0.04


@dataclass(frozen=True)
class View:
    """A view, its input light and its display.

    Attributes:
        apply: light (..., 3) -> code values (..., 3) in [0, 1].
        primaries: primaries of the light.
        display: the display that the code values are for.
        title: name for people.
    """

    apply: Callable[[np.ndarray], np.ndarray]
    primaries: Chromaticities
    display: Display
    title: str



def reinhard(light: np.ndarray, primaries: Chromaticities = REC709,
             most: float = 1.0) -> np.ndarray:
    """Luminance L to L / (1 + L / most), colours in proportion: Reinhard et al. 2002, equation 3,
    where most is 1.

    light (..., 3) scene-linear, at least 0; the result is display light, below `most` in luminance
    only.
    """
    luminance = light @ to_xyz(primaries)[1]
    mapped: np.ndarray = light / (1 + luminance / most)[..., None]
    return mapped


def neutral(light: np.ndarray) -> np.ndarray:
    """Khronos PBR Neutral: light (..., 3) scene-linear Rec.709, at least 0 -> display light in [0,
    1].

    Source: Khronos PBR Neutral Tone Mapper, specification 1.0.
    """
    least = light.min(-1, keepdims=True)
    colour = light - np.where(least < 2 * _OFFSET, least - 6.25 * least**2, _OFFSET)
    peak = colour.max(-1, keepdims=True)
    start = _START - _OFFSET
    room = 1 - start
    squeezed = 1 - room**2 / np.maximum(peak + room - start, room)
    scaled = colour * squeezed / np.maximum(peak, start)
    grey = 1 - 1 / (_DESATURATION * (peak - squeezed) + 1)
    return np.where(peak < start, colour, scaled + grey * (squeezed - scaled))


def find_view(text: str, display: Display) -> View:
    """A view by name: 'reinhard', 'neutral', 'ocio:VIEW' or 'FILE.cube,input=SPACE', preferably for
    a display.

    `View.display` is the display that the view is made for. Raises ColourError if there is no such
    view.
    """
    if text == "reinhard":
        own = display.kind.primaries
        return View(lambda x: display.encode(reinhard(np.maximum(x, 0), own, display.most)), own,
                    display, "Reinhard 2002")
    if text == "neutral":
        return View(lambda x: SRGB.encode(neutral(np.maximum(x, 0))), REC709, parse_display("srgb"),
                    "Khronos PBR Neutral")
    if text.startswith(ocio.PREFIX):
        transform = ocio.view_transform(text.removeprefix(ocio.PREFIX), display)
    else:
        transform = ocio.file_transform(text)
    return View(transform.apply, ACESCG, transform.display, transform.title)


VIEWS = ("reinhard", "neutral")
"""Views that have a plain name."""


def is_view(text: str) -> bool:
    """Whether a look's name means a view, not a network."""
    return text in VIEWS or text.startswith(ocio.PREFIX) or ocio.is_lut(text)


def axis(size: int = CUBE_SIDE) -> np.ndarray:
    """Light at the corners along one axis of a cube, (size,)."""
    return AXIS_TOE * (np.exp2(np.linspace(0, 1, size) / AXIS_SCALE) - 1)


def bake(view: View) -> np.ndarray:
    """A view's cube, (CUBE_SIDE, CUBE_SIDE, CUBE_SIDE, 3) float32: red, green, blue, channel."""
    light = axis()
    corners = np.stack(np.meshgrid(light, light, light, indexing="ij"), -1)
    cube: np.ndarray = np.clip(view.apply(corners), 0, 1).astype(np.float32)
    cube.setflags(write=False)
    return cube


LUMA = np.array((0.2126, 0.7152, 0.0722), np.float32)


class Band(NamedTuple):
    """A range of the signal, its colour (sRGB code values) and its meaning."""

    low: float
    high: float
    colour: tuple[int, int, int]
    meaning: str


FALSE_COLOUR_BANDS = (
    Band(0.0, 0.025, (120, 40, 170), "black clipping"),
    Band(0.025, 0.04, (40, 80, 230), "just above black"),
    Band(0.38, 0.42, (60, 180, 75), "18 % mid grey"),
    Band(0.52, 0.56, (245, 150, 185), "a stop over grey"),
    Band(0.97, 0.99, (250, 220, 50), "just below white"),
    Band(0.99, 1.0, (225, 40, 40), "white clipping"),
)
"""ARRI, ALEXA Mini LF user manual, "Monitoring", page 83: signal levels and colours of the false
colour display."""

ZEBRA = 0.95
"""Luma, 0..1 of the display's, from which pixels get stripes."""
STRIPE = 6  # pixels of a stripe and of a gap


def luma(rgb: np.ndarray) -> np.ndarray:
    """(height, width, 3) -> (height, width), Rec.709 weights."""
    return rgb @ LUMA


def to_codes(colour: np.ndarray, exposure_factor: float) -> np.ndarray:
    """sRGB code values 0..1 of x / (1 + x), x = colour * exposure_factor, to compare pictures;
    non-finite values count as 0."""
    exposed = np.maximum(np.nan_to_num(colour * exposure_factor), 0)
    return srgb_encode(exposed / (1 + exposed))


def log_c(linear: np.ndarray) -> np.ndarray:
    """ARRI Log C3 at EI 800 of exposed scene-linear values, where 0.18 becomes 0.391.

    Source: ARRI, "ALEXA Log C Curve: Usage in VFX" (2012), table for EI 800, linear scene exposure.
    """
    upper = 0.247190 * np.log10(5.555556 * np.maximum(linear, 0.010591) + 0.052272) + 0.385537
    return np.where(linear > 0.010591, upper, 5.367655 * linear + 0.092809)


def false_colour(signal: np.ndarray) -> np.ndarray:
    """ARRI's false colour of a signal 0..1, (height, width) -> uint8 (height, width, 3); grey
    between the bands."""
    signal = np.clip(np.nan_to_num(signal, nan=0.0), 0, 1)
    picture = np.repeat((signal * 255 + 0.5).astype(np.uint8)[..., None], 3, axis=-1)
    for band in FALSE_COLOUR_BANDS:
        picture[(signal >= band.low) & (signal <= band.high)] = band.colour
    return picture


def zebra(display: np.ndarray) -> np.ndarray:
    """Diagonal stripes where the luma of a display picture (height, width, 3), 0..1, is ZEBRA or
    more; uint8."""
    picture: np.ndarray = (np.clip(np.nan_to_num(display, nan=0.0), 0, 1) * 255
                           + 0.5).astype(np.uint8)
    rows, columns = np.indices(display.shape[:2])
    dark = (rows + columns) // STRIPE % 2 == 0
    picture[(luma(display) >= ZEBRA) & dark] = 0
    return picture
