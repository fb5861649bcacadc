"""What a chain makes of mid grey that is so many stops off: sampled on a ramp of light, and not assumed."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from postfx.colour.curves import SRGB
from postfx.colour.views import neutral
from postfx.errors import ExposureError
from postfx.exposure.metering import KEY
from postfx.exposure.views import luma
from postfx.frame import Frame, Role
from postfx.passes.base import Pass
from postfx.passes.display import Display, View
from postfx.passes.exposure_tool import CELLS, STOPS, ExposureTool, cells
from postfx.passes.tonemap import ToneMap
from postfx.pipeline import Pipeline
from postfx.runtime import Device

STEPS_EV = np.arange(-8.0, 8.01, 0.25)
"""Where a response is sampled."""
HEIGHT = 20 * CELLS
FLAT = 0.02
"""Levels of a response that tells nothing differ by less."""
ALIKE = 0.01
"""Two responses are the same curve, one brighter, where no level differs by more than this."""
SHIFTS_EV = np.arange(-6.0, 6.001, 0.01)
TELLING = (0.03, 0.97)
"""Levels at which a curve has its shape; near black and white all are alike."""
OWN_CURVE, VIEW = "its own", "the view's"
_BUILT_IN = (Display, ToneMap, View)


class Board:
    """A chain of passes that sees nothing but the checkerboard.

    passes: what comes after the upscaler. aspect: width over height of the frames. The board is 180 rows high whatever
    the frames are: it looks the same at every size, and what it covers does not matter.
    """

    def __init__(self, passes: Sequence[Pass], aspect: float = 16 / 9, device: Device | None = None) -> None:
        self._reference: dict[int, float] = {}
        self._blank = np.zeros((HEIGHT, max(round(HEIGHT * aspect), 1), 3), np.float32)
        tool = ExposureTool(reference=self._reference)
        self._pipeline = Pipeline([tool, *passes], device, "metadata")

    def level(self, exposure: float, reference: float, cut: bool) -> float:
        """Level of mid grey on the board divided by `reference`, when the chain is told to multiply by `exposure`."""
        number = len(self._reference)
        self._reference[number] = reference
        frame = Frame({Role.COLOUR: self._blank}, number=number, exposure=exposure, reset=cut)
        return grey_level(self._pipeline(frame)[Role.COLOUR])


def grey_level(picture: np.ndarray) -> float:
    """Mean of the levels of a board's two greys; picture: (height, width, 3) as it leaves the chain."""
    rows, columns = cells(*picture.shape[:2])
    dark = rows[:, None] == columns[None, :]
    level = luma(picture)
    return float((level[dark].mean(dtype=np.float64) + level[~dark].mean(dtype=np.float64)) / 2)


class Response:
    """Levels of the board over the stops that its light is too bright.

    Args:
        ev: stops, rising; levels: of the board there. Where levels fall, the curve is held.
        gain_ev: stops that the chain is too bright throughout, as far as that is known.

    Attributes:
        grey: level of the board when it is exposed right.
        limits_ev: stops between which the level tells the exposure; beyond, a view is black or white.

    Raises ExposureError where all levels are alike.
    """

    def __init__(self, ev: np.ndarray, levels: Iterable[float], gain_ev: float = 0.0) -> None:
        self._levels, rising = np.unique(np.maximum.accumulate([*levels]), return_index=True)
        if np.ptp(self._levels) < FLAT:
            raise ExposureError(f"the chain shows light of any brightness alike, at {self._levels[0]:.0%} of the "
                                "signal: it meters for itself: switch that off, and give it the frame's exposure")
        self._ev = ev[rising] + gain_ev
        self.grey = self.level_at(0.0)
        self.limits_ev = float(self._ev[0]), float(self._ev[-1])

    @classmethod
    def of_board(cls, board: Board) -> Response:
        """The response of a chain, by a ramp of light that it is told to leave as it is."""
        return cls(STEPS_EV, [board.level(1.0, 2.0**-ev, cut=True) for ev in STEPS_EV])

    @classmethod
    def of_curve(cls, curve: Callable[[np.ndarray], np.ndarray]) -> Response:
        """The response of a function of exposed light (n,) to levels (n,) 0..1."""
        dark, light = (np.clip(curve(KEY * np.exp2(STEPS_EV + stops)), 0, 1) for stops in (-STOPS, STOPS))
        return cls(STEPS_EV, (dark + light) / 2)

    def brighter(self, gain_ev: float) -> Response:
        """The same levels, of a chain that is so many stops too bright throughout."""
        return Response(self._ev, self._levels, gain_ev)

    def level_at(self, ev: float) -> float:
        """Level of mid grey that is `ev` stops too bright."""
        return float(np.interp(ev, self._ev, self._levels))

    def ev_of(self, level: float) -> float:
        """Stops that mid grey of this level is too bright, within the limits."""
        return float(np.interp(level, self._levels, self._ev))

    def gain_over(self, other: Response) -> float | None:
        """Stops that this is brighter than another one throughout; None where it is another curve."""
        tells = (self._levels > TELLING[0]) & (self._levels < TELLING[1])
        ev, levels = self._ev[tells], self._levels[tells]
        if len(ev) < 8:
            return None
        off = [np.abs(np.interp(ev + shift, other._ev, other._levels) - levels).max() for shift in SHIFTS_EV]
        best = int(np.argmin(off))
        return float(SHIFTS_EV[best]) if off[best] <= ALIKE else None


def _narkowicz(light: np.ndarray) -> np.ndarray:
    """K. Narkowicz, "ACES Filmic Tone Mapping Curve", 2015."""
    return light * (2.51 * light + 0.03) / (light * (2.43 * light + 0.59) + 0.14)


def _hable(light: np.ndarray) -> np.ndarray:
    """J. Hable, "Filmic Tonemapping Operators", 2010, with its exposure bias of 2 and white at 11.2."""
    def curve(x: np.ndarray) -> np.ndarray:
        return (x * (0.15 * x + 0.05) + 0.004) / (x * (0.15 * x + 0.5) + 0.06) - 0.02 / 0.3

    found: np.ndarray = curve(2 * light) / curve(np.array(11.2))
    return found


_LIGHT: Mapping[str, Callable[[np.ndarray], np.ndarray]] = {
    "no tone curve": lambda light: light,
    "Reinhard": lambda light: light / (1 + light),
    "1 - exp(-x)": lambda light: 1 - np.exp(-light),
    "Khronos PBR Neutral": lambda light: neutral(np.repeat(light[:, None], 3, 1))[:, 1],
    "Narkowicz's ACES": _narkowicz,
    "Hable": _hable,
}
_ENCODINGS: Mapping[str, Callable[[np.ndarray], np.ndarray]] = {
    "sRGB": SRGB.encode, "gamma 2.2": lambda light: light ** (1 / 2.2), "gamma 2.4": lambda light: light ** (1 / 2.4),
}


def known_curves() -> dict[str, Response]:
    """Responses of tone curves that many chains use, by name."""
    def made(curve: Callable[[np.ndarray], np.ndarray], encode: Callable[[np.ndarray], np.ndarray]) -> Response:
        return Response.of_curve(lambda light: np.asarray(encode(np.clip(curve(light), 0, 1))))

    return {f"{name}, {encoding}": made(curve, encode) for name, curve in _LIGHT.items()
            for encoding, encode in _ENCODINGS.items()}


class Calibration(NamedTuple):
    """By what a chain is judged.

    Attributes:
        response: of the chain, with the gain that it has over a curve that is known.
        curve: the name of that curve; `OWN_CURVE` where it is none that is known: a gain that is the same throughout
            cannot be told from the look then.
    """

    response: Response
    curve: str


def calibrate(own: Response, known: Mapping[str, Response]) -> Calibration:
    """Judge a chain by its own response, and by its gain over the known curve of the same shape; the least gain where
    there are several."""
    gains = {name: gain for name, other in known.items() if (gain := own.gain_over(other)) is not None}
    if not gains:
        return Calibration(own, OWN_CURVE)
    name = min(gains, key=lambda name: abs(gains[name]))
    return Calibration(own.brighter(gains[name]), name)


def is_built_in(passes: Sequence[Pass]) -> bool:
    """Whether passes are postfx's own, which are right, and not classes made of them."""
    return all(type(item) in _BUILT_IN for item in passes)
