"""Response of a chain: its level of mid grey by how many stops the light is too bright, measured
and not assumed.

A chain of passes is sampled here, on a ramp of light. A tone mapper or a grade in another program
is sampled by a chart that goes through it; its boards are then read by that response.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from os import PathLike
from pathlib import Path
from typing import NamedTuple

import numpy as np
import OpenImageIO as oiio

from postfx.colour.displays import SRGB
from postfx.colour.views import luma, neutral
from postfx.errors import ExposureError
from postfx.exposure import USED_EXPOSURE_ATTRIBUTE
from postfx.frame import KEY, Frame, Role
from postfx.io.image_file import reason_of
from postfx.io.pattern import describe_absence, locate
from postfx.io.writer import write_frame
from postfx.passes import Pass
from postfx.passes.display import Display, View
from postfx.passes.exposure_tool import CELLS, STOPS, ExposureTool, board_area, cells
from postfx.passes.tonemap import ToneMap
from postfx.pipeline import Pipeline
from postfx.runtime import Device

STEPS_EV = np.arange(-8.0, 8.01, 0.25)
"""Stops at which a response is sampled."""
BOARD_HEIGHT_PX = 20 * CELLS
FLAT_RESPONSE_DIFFERENCE = 0.02
"""A response whose levels differ by less does not show the exposure."""
ALIKE_LEVEL_DIFFERENCE = 0.01
"""Two responses are one curve, shifted by a gain, if no level differs by more than this."""
SAME_GAIN_EV = 0.05
"""A gain that is not worth a remark."""
SHIFTS_EV = np.arange(-6.0, 6.001, 0.01)
TELLING_LEVELS = (0.03, 0.97)
"""Levels between which curves differ; near black and white all are alike."""
OWN_CURVE = "its own"
VIEW_CURVE = "the view's"
_BUILT_IN = (Display, ToneMap, View)


class Board:
    """A chain of passes that processes nothing but the checkerboard.

    passes: the passes after the upscaler. aspect: width over height of the frames. The board always
    has 180 rows: it looks the same at every size, and the picture under it does not matter.
    """

    def __init__(self, passes: Sequence[Pass], aspect: float = 16 / 9,
                 device: Device | None = None) -> None:
        self._reference: dict[int, float] = {}
        self._blank = np.zeros((BOARD_HEIGHT_PX, max(round(BOARD_HEIGHT_PX * aspect), 1), 3),
                               np.float32)
        tool = ExposureTool(reference=self._reference)
        self._pipeline = Pipeline([tool, *passes], device, "metadata")

    def level(self, exposure: float, reference: float, cut: bool) -> float:
        """Level of mid grey on the board for `reference` stops, when the chain is told of
        `exposure` stops."""
        number = len(self._reference)
        self._reference[number] = 2.0**reference
        frame = Frame({Role.COLOUR: self._blank}, number=number, exposure=exposure, reset=cut)
        return grey_level(self._pipeline(frame)[Role.COLOUR])


def grey_level(picture: np.ndarray) -> float:
    """Mean of the levels of a board's two greys; picture: (height, width, 3) as it leaves the
    chain."""
    rows, columns = cells(*picture.shape[:2])
    dark = rows[:, None] == columns[None, :]
    level = luma(picture)
    return float((level[dark].mean(dtype=np.float64) + level[~dark].mean(dtype=np.float64)) / 2)


class Response:
    """Levels of the board over the stops by which its light is too bright.

    Args:
        ev: stops, rising.
        levels: levels of the board at these stops. Where levels fall, the curve stays at the
            highest before.

    Attributes:
        grey: level of the board at the right exposure.
        limits_ev: stops between which the level shows the exposure; beyond, a view is black or
            white.

    Raises ExposureError if all levels are alike.
    """

    def __init__(self, ev: np.ndarray, levels: Iterable[float]) -> None:
        self._levels, rising = np.unique(np.maximum.accumulate([*levels]), return_index=True)
        if np.ptp(self._levels) < FLAT_RESPONSE_DIFFERENCE:
            raise ExposureError("the chain shows light of any brightness at the same level, "
                                f"{self._levels[0]:.0%} of the signal: it meters for itself: "
                                "switch that off, and give it the frame's exposure")
        self._ev = ev[rising]
        self.grey = self.level_at(0.0)
        self.limits_ev = float(self._ev[0]), float(self._ev[-1])

    @classmethod
    def of_board(cls, board: Board) -> Response:
        """The response of a chain to a ramp of light at 0 EV."""
        return cls(STEPS_EV, [board.level(0.0, -ev, cut=True) for ev in STEPS_EV])

    @classmethod
    def of_curve(cls, curve: Callable[[np.ndarray], np.ndarray]) -> Response:
        """The response of a function of exposed light (n,) to levels (n,) 0..1."""
        dark, light = (np.clip(curve(KEY * np.exp2(STEPS_EV + stops)), 0, 1)
                       for stops in (-STOPS, STOPS))
        return cls(STEPS_EV, (dark + light) / 2)

    def level_at(self, ev: float) -> float:
        """Level of mid grey that is `ev` stops too bright."""
        return float(np.interp(ev, self._ev, self._levels))

    def ev_of(self, level: float) -> float:
        """Stops by which mid grey of this level is too bright, within the limits."""
        return float(np.interp(level, self._levels, self._ev))

    def gain_over(self, other: Response) -> float | None:
        """Stops by which this response is brighter than another one throughout; None if it is
        another curve."""
        tells = (self._levels > TELLING_LEVELS[0]) & (self._levels < TELLING_LEVELS[1])
        ev, levels = self._ev[tells], self._levels[tells]
        if len(ev) < 8:
            return None
        off = [np.abs(np.interp(ev + shift, other._ev, other._levels) - levels).max()
               for shift in SHIFTS_EV]
        best = int(np.argmin(off))
        return float(SHIFTS_EV[best]) if off[best] <= ALIKE_LEVEL_DIFFERENCE else None


def _narkowicz(light: np.ndarray) -> np.ndarray:
    """K. Narkowicz, "ACES Filmic Tone Mapping Curve", 2015."""
    return light * (2.51 * light + 0.03) / (light * (2.43 * light + 0.59) + 0.14)


def _hable(light: np.ndarray) -> np.ndarray:
    """J. Hable, "Filmic Tonemapping Operators", 2010, with its exposure bias of 2 and white at
    11.2."""
    def curve(x: np.ndarray) -> np.ndarray:
        return (x * (0.15 * x + 0.05) + 0.004) / (x * (0.15 * x + 0.5) + 0.06) - 0.02 / 0.3

    found: np.ndarray = curve(2 * light) / curve(np.array(11.2))
    return found


_LIGHT_OF_CURVES: Mapping[str, Callable[[np.ndarray], np.ndarray]] = {
    "no tone curve": lambda light: light,
    "Reinhard": lambda light: light / (1 + light),
    "1 - exp(-x)": lambda light: 1 - np.exp(-light),
    "Khronos PBR Neutral": lambda light: neutral(np.repeat(light[:, None], 3, 1))[:, 1],
    "Narkowicz's ACES": _narkowicz,
    "Hable": _hable,
}
_ENCODINGS: Mapping[str, Callable[[np.ndarray], np.ndarray]] = {
    "sRGB": SRGB.encode, "gamma 2.2": lambda light: light ** (1 / 2.2),
    "gamma 2.4": lambda light: light ** (1 / 2.4),
}


def known_curves() -> dict[str, Response]:
    """Responses of tone curves that many chains use, by name."""
    def response_of(curve: Callable[[np.ndarray], np.ndarray],
                    encode: Callable[[np.ndarray], np.ndarray]) -> Response:
        return Response.of_curve(lambda light: np.asarray(encode(np.clip(curve(light), 0, 1))))

    return {f"{name}, {encoding}": response_of(curve, encode)
            for name, curve in _LIGHT_OF_CURVES.items() for encoding, encode in _ENCODINGS.items()}


class Calibration(NamedTuple):
    """The response that a chain is judged by.

    Attributes:
        response: the truth: light at the right exposure has its levels.
        curve: whose response it is, `OWN_CURVE` or `VIEW_CURVE`.
        remark: what else the response shows. It never changes a verdict.
    """

    response: Response
    curve: str
    remark: str | None = None


def calibrate(own: Response, known: Mapping[str, Response] | None = None) -> Calibration:
    """Judge a chain by its own response, which is the truth: what else is measured is compared with
    it.

    A response that is a known curve but for a gain has a remark. It is no mistake: curves of
    different authors may be one curve at two exposures, so a gain is as likely a part of the look.

    known: responses by name; default `known_curves()`.
    """
    others = known_curves() if known is None else known
    gains = {name: gain
             for name, other in others.items() if (gain := own.gain_over(other)) is not None}
    if not gains:
        return Calibration(own, OWN_CURVE)
    name = min(gains, key=lambda name: abs(gains[name]))
    gain = gains[name]
    if abs(gain) <= SAME_GAIN_EV:
        return Calibration(own, OWN_CURVE, f"its curve is that of {name}")
    brighter = "brighter" if gain > 0 else "darker"
    return Calibration(own, OWN_CURVE,
                                       f"its curve is like that of {name}, {abs(gain):.2f} EV "
                                       f"{brighter} throughout: this counts as its look, not as a "
                                       "mistake")


def is_built_in(passes: Sequence[Pass]) -> bool:
    """Whether passes are postfx's own, which are right, and not subclasses of them."""
    return all(type(item) in _BUILT_IN for item in passes)


# Frames that were graded elsewhere

# Pixels of a step of the chart, and its rows.
CHART_STEP_PX = 16
CHART_HEIGHT_PX = 270

# Greatest spread of a board's greys, as a part of their difference, and least difference: JPEG
# and dither add some.
MOST_GREY_SPREAD = 0.35
LEAST_GREY_DIFFERENCE = 0.01
"""Part of the signal, 0..1, by which dither does not change levels."""


def write_chart(path: str | PathLike[str]) -> Path:
    """Write the chart as an EXR: mid grey times 2^-8 to 2^8 in steps of a quarter stop from left to
    right.

    Its header gives an exposure of 0 stops. Raises WriteError.
    """
    steps = np.repeat(KEY * np.exp2(STEPS_EV), CHART_STEP_PX).astype(np.float32)
    colour = np.ascontiguousarray(np.broadcast_to(steps[None, :, None],
                                                  (CHART_HEIGHT_PX, steps.size, 3)))
    frame = Frame({Role.COLOUR: colour}, metadata={"postfx:exposureEV": 0.0})
    return write_frame(path, frame, bits=32, provenance={USED_EXPOSURE_ATTRIBUTE: 0.0})


def read_response(path: str | PathLike[str]) -> Calibration:
    """Calibration from a picture of the chart that went through a tone mapper at an exposure of 1;
    its other pictures are judged by that. Raises ExposureError if the file does not show the
    chart."""
    level = luma(load_picture(Path(path)))
    height, width = level.shape
    if width < 4 * STEPS_EV.size:
        raise ExposureError(f"{path}: {width} pixels for {STEPS_EV.size} steps of the chart: write "
                            "it at its own size")
    edges = np.linspace(0, width, STEPS_EV.size + 1)
    middle = slice(height // 4, max(height // 4 + 1, height * 3 // 4))
    columns = [slice(round(first + (last - first) / 4), round(last - (last - first) / 4))
               for first, last in zip(edges, edges[1:], strict=False)]
    steps = np.array([level[middle, column].mean() for column in columns])
    if (np.diff(steps) < -LEAST_GREY_DIFFERENCE).any():
        raise ExposureError(f"{path}: gets darker where the chart gets brighter: give the chart "
                            "that --chart wrote, after the tone mapper and nothing else")
    board = (steps[:-2] + steps[2:]) / 2  # the board's greys are a quarter stop below and above
    return calibrate(Response(STEPS_EV[1:-1], board))


class GradedBoards:
    """Pictures of a sequence's boards after the chain.

    source: pattern of PNG, TIFF, JPEG or EXR files with display code values, numbered like the
    render.
    """

    def __init__(self, source: str) -> None:
        self.pattern, _ = locate(source)
        self._files = {number: next(iter(files.values()))
                       for number, files in self.pattern.find_frames().items()}
        if not self._files:
            raise ExposureError(f"{source}: {describe_absence(self.pattern)}")

    def level(self, number: int) -> float:
        """Level of mid grey on a frame's board. Raises ExposureError if it is missing or shows no
        board."""
        if number not in self._files:
            raise ExposureError(f"{self.pattern.path(number)}: frame {number} is missing: grade "
                                "it, or leave it out with --frames")
        path = self._files[number]
        return board_level(load_picture(path), str(path))


def board_level(picture: np.ndarray, name: str) -> float:
    """Mean of the levels of a board's two greys, in either form; picture: (height, width, 3).

    Raises ExposureError if the picture shows no board.
    """
    level = luma(picture)
    halves = [_halves(level[board_area(level.shape[0], level.shape[1], part)])
              for part in (True, False)]
    for dark, light in halves:
        greys = float(np.median(dark)), float(np.median(light))
        spread = max(np.percentile(np.abs(half - grey), 75)
                     for half, grey in zip((dark, light), greys, strict=True))
        if (greys[1] - greys[0] > LEAST_GREY_DIFFERENCE
            and spread <= max(MOST_GREY_SPREAD * (greys[1] - greys[0]), LEAST_GREY_DIFFERENCE)):
            return (greys[0] + greys[1]) / 2
    if np.ptp(level) <= 2 * LEAST_GREY_DIFFERENCE:  # all black or all white
        return float(level.mean())
    raise ExposureError(f"{name}: shows no checkerboard: give the frames of "
                        "'POSTFX_EXPOSURE_TOOL=1 postfx run' after your program, not cropped")


def _halves(level: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Levels of the board's dark cells and of its light cells."""
    rows, columns = cells(level.shape[0], level.shape[1])
    is_dark = rows[:, None] == columns[None, :]
    return level[is_dark], level[~is_dark]


def load_picture(path: Path) -> np.ndarray:
    """A picture's code values, (height, width, 3) float32, 0..1 where the file holds whole
    numbers."""
    image = oiio.ImageInput.open(str(path))
    if image is None:
        raise ExposureError(f"{path}: cannot be read: {reason_of(oiio.geterror)}; give a PNG, "
                            "TIFF, JPEG or EXR")
    pixels = image.read_image(0, 0, 0, min(3, image.spec().nchannels), oiio.FLOAT)
    reason = image.geterror()
    image.close()
    if pixels is None:
        raise ExposureError(f"{path}: broken file: {reason}; grade this frame again")
    found: np.ndarray = np.nan_to_num(pixels if pixels.shape[2] == 3
                                      else np.repeat(pixels[..., :1], 3, 2))
    return found
