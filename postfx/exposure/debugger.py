"""The exposure debugger: whether the exposure of a sequence is right, steady and applied; by how much not, and why."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from postfx.errors import ExposureError
from postfx.exposure.metering import (
    SECONDS,
    SMOOTH,
    ExposureMeter,
    MeterReading,
    frame_rate,
    measure,
    shots,
    smooth_ev,
)
from postfx.exposure.views import luma
from postfx.frame import Frame, Role
from postfx.passes.base import Pass
from postfx.passes.exposure_tool import CELLS, ExposureTool, cells
from postfx.pipeline import Pipeline
from postfx.runtime import Device

TOLERANCE_EV = 0.2
"""Largest mean mismatch that counts as right: below a quarter of a stop, above the meter's noise."""
DRIFT_EV, MOVING_DRIFT_EV = 0.25, 0.5
"""Largest drift from the darkest to the brightest frame; more where the scene changes, which exposure need not follow
entirely."""
RIGHT, DARK, BRIGHT, DRIFTING = "right", "too dark", "too bright", "drifting"

NEAR_EV = 0.25
"""A picture this close to mid grey needs no exposure: about what noise does to the meter."""
SAME_EV = 0.125
APPLIED_EV = 0.05  # the board's own error is smaller
STEADY_EV = 0.1
OPPOSED = -0.8  # correlation

STEPS_EV = np.arange(-8.0, 8.01, 0.25)
"""Stops at which a view's response is sampled."""
HEIGHT = 20 * CELLS


class Reading(NamedTuple):
    """One frame at the end of the chain.

    Attributes:
        number: frame number.
        cut: whether a shot begins here.
        exposure_ev: stops of exposure that the chain is given.
        reference_ev: stops that the checkerboard is divided by: the right exposure.
        picture_ev: stops that the picture itself needs, metered and smooth.
        level: of the board's mid grey, 0..1.
        mismatch_ev: stops that the level is too bright, within the limits of the view's response.
        expected_ev: the same for a view that applies the exposure as given.
    """

    number: int
    cut: bool
    exposure_ev: float
    reference_ev: float
    picture_ev: float
    level: float
    mismatch_ev: float
    expected_ev: float


@dataclass(frozen=True)
class Shot:
    """The debugger's verdict on the frames from one cut to the next.

    Attributes:
        first, last: frame numbers.
        verdict: 'right', 'too dark', 'too bright' or 'drifting'.
        mismatch_ev: mean stops too bright.
        drift_ev: stops from the darkest to the brightest frame.
        level: mean level of mid grey.
        right_ev: mean stops that would have been right.
        cause: the likely mistake, or None.
    """

    first: int
    last: int
    verdict: str
    mismatch_ev: float
    drift_ev: float
    level: float
    right_ev: float
    cause: str | None


@dataclass(frozen=True)
class Report:
    """All readings, grouped into shots.

    Attributes:
        grey: level of mid grey at the right exposure.
        limits_ev: smallest and largest mismatch that the level can show; one at a limit may be larger.
    """

    readings: list[Reading]
    shots: list[Shot]
    grey: float
    limits_ev: tuple[float, float]

    @property
    def verdict(self) -> str:
        """The verdict on all shots: drifting if one drifts, else the verdict on the shot with the largest mismatch."""
        drifting = [shot for shot in self.shots if shot.verdict == DRIFTING]
        return (drifting or [max(self.shots, key=lambda shot: abs(shot.mismatch_ev))])[0].verdict


def debug(
    frames: Iterable[Frame],
    view: Sequence[Pass],
    exposure: str | float = "auto",
    reference: str | float = SMOOTH,
    chain: Sequence[Pass] | None = None,
    device: Device | None = None,
) -> Report:
    """Measure the exposure of frames, read once in order; only their colour is needed.

    Args:
        view: passes that show exposed scene-linear colour on a display, such as `[ToneMap()]`.
        exposure: the mode under test: 'auto', 'smooth', 'metadata' or stops, as in `postfx run`.
        reference: the mode that would be right; 'smooth' is metered on the pictures.
        chain: the passes after the upscaler, if they are not `view` but should have the same effect.

    Raises ExposureError if a mode has no exposure for a frame, or there is no frame.
    """
    told, right = _Mode(exposure), _Mode(reference)
    found, width, aspect = [], 1.0, 1.0
    for frame in frames:
        found.append(MeterReading(frame.number, measure(frame[Role.COLOUR]), frame.reset))
        told.see(frame)
        right.see(frame)
        width, aspect = SECONDS * frame_rate(frame), frame.spec.width / frame.spec.height
    if not found:
        raise ExposureError("there is no frame to measure: give at least one")
    smooth = smooth_ev(found, width)
    seen = Board(view, aspect, device)
    response = Response(seen)
    tested = seen if chain is None else Board(chain, aspect, device)
    readings = []
    for index, (number, _, cut) in enumerate(found):
        ev = told.ev(number, smooth), right.ev(number, smooth)
        multipliers = 2.0 ** ev[0], 2.0 ** ev[1], cut or index == 0
        level = tested.level(*multipliers)
        wanted = level if tested is seen else seen.level(*multipliers)
        mismatch = response.ev_of(level), response.ev_of(wanted)
        readings.append(Reading(number, cut, *ev, smooth[number], level, *mismatch))
    judged = [_judged(readings[shot]) for shot in shots([item.cut for item in readings])]
    return Report(readings, judged, response.grey, response.limits_ev)


class _Mode:
    """Stops by one of the modes, frame by frame."""

    def __init__(self, mode: str | float) -> None:
        self._meter = None if mode == SMOOTH else ExposureMeter(mode)
        self._ev: dict[int, float] = {}

    def see(self, frame: Frame) -> None:
        if self._meter:
            self._ev[frame.number] = float(np.log2(self._meter(frame)))

    def ev(self, number: int, smooth: dict[int, float]) -> float:
        return self._ev[number] if self._meter else smooth[number]


def _judged(readings: Sequence[Reading]) -> Shot:
    mismatch = np.array([reading.mismatch_ev for reading in readings])
    verdict = _verdict(mismatch, np.ptp([reading.reference_ev for reading in readings]))
    return Shot(
        first=readings[0].number,
        last=readings[-1].number,
        verdict=verdict,
        mismatch_ev=float(mismatch.mean()),
        drift_ev=float(np.ptp(mismatch)),
        level=float(np.mean([reading.level for reading in readings])),
        right_ev=float(np.mean([reading.exposure_ev - reading.mismatch_ev for reading in readings])),
        cause=None if verdict == RIGHT else likely_cause(readings, verdict == DRIFTING),
    )


def _verdict(mismatch: np.ndarray, scene_moves: float) -> str:
    if np.ptp(mismatch) > (MOVING_DRIFT_EV if scene_moves > DRIFT_EV else DRIFT_EV):
        return DRIFTING
    if abs(mismatch.mean()) <= TOLERANCE_EV:
        return RIGHT
    return BRIGHT if mismatch.mean() > 0 else DARK


class Board:
    """A chain of passes that only sees the checkerboard.

    passes: those after the upscaler. aspect: width over height of the frames. The board is always 180 rows high, for it
    looks the same at every size.
    """

    def __init__(self, passes: Sequence[Pass], aspect: float = 16 / 9, device: Device | None = None) -> None:
        self._reference: dict[int, float] = {}
        self._blank = np.zeros((HEIGHT, max(round(HEIGHT * aspect), 1), 3), np.float32)
        tool = ExposureTool(reference=self._reference)
        self._pipeline = Pipeline([tool, *passes], device, "metadata")

    def level(self, exposure: float, reference: float, cut: bool) -> float:
        """Level of mid grey on the board divided by `reference`, in a chain that is given `exposure`."""
        number = len(self._reference)
        self._reference[number] = reference
        frame = Frame({Role.COLOUR: self._blank}, number=number, exposure=exposure, reset=cut)
        return grey_level(self._pipeline(frame)[Role.COLOUR])


class Response:
    """A view's level of mid grey by stops of mismatch, as measured.

    Attributes:
        grey: level of the board at the right exposure.
        limits_ev: stops between which the level depends on the exposure; beyond, a view is black or white.
    """

    def __init__(self, view: Board) -> None:
        levels = [view.level(2.0**ev, 1.0, cut=True) for ev in STEPS_EV]
        self._levels, rising = np.unique(np.maximum.accumulate(levels), return_index=True)
        self._ev = STEPS_EV[rising]
        self.grey = self.level_at(0.0)
        self.limits_ev = float(self._ev[0]), float(self._ev[-1])

    def level_at(self, ev: float) -> float:
        """Level of mid grey that is `ev` stops too bright."""
        return float(np.interp(ev, self._ev, self._levels))

    def ev_of(self, level: float) -> float:
        """Stops that mid grey of this level is too bright, within the limits."""
        return float(np.interp(level, self._levels, self._ev))


def grey_level(picture: np.ndarray) -> float:
    """Mean of the levels of a board's two greys; picture: (height, width, 3), the chain's output."""
    rows, columns = cells(*picture.shape[:2])
    dark = rows[:, None] == columns[None, :]
    level = luma(picture)
    return float((level[dark].mean(dtype=np.float64) + level[~dark].mean(dtype=np.float64)) / 2)


def likely_cause(readings: Sequence[Reading], drifting: bool) -> str | None:
    """A sentence with the mistake and its fix; None if no mistake fits and the exposure may be intended."""
    told, picture, found, expected = (
        np.array([getattr(reading, name) for reading in readings])
        for name in ("exposure_ev", "picture_ev", "mismatch_ev", "expected_ev")
    )
    return (
        _otherwise_applied(found - expected)
        or _pattern(told, picture)
        or (_movement(told, picture) if drifting else None)
    )


def _otherwise_applied(extra: np.ndarray) -> str | None:
    """Exposure that the passes after the upscaler applied beyond the one they were given."""
    if abs(extra).max() <= APPLIED_EV:
        return None
    if np.ptp(extra) > STEADY_EV:
        return (
            f"after the upscaler the chain exposes by {extra.min():+.2f} to {extra.max():+.2f} EV besides what it is "
            "given: it meters for itself or lags; give the tone mapper the frame's exposure"
        )
    return (
        f"after the upscaler the chain exposes by {extra.mean():+.2f} EV besides what it is given: give the tone "
        "mapper the frame's exposure and nothing else"
    )


def _pattern(told: np.ndarray, picture: np.ndarray) -> str | None:
    """Mistakes in the kind of number: applied twice, not passed on, inverted, or stops."""
    if abs(picture).max() <= NEAR_EV < abs(told).max():
        return (
            "the colour is at mid grey before it is exposed: if the exposure is multiplied in already, it is given a "
            "second time; divide it out or give an exposure of 1 (0 EV)"
        )
    if not told.any():
        return "the exposure is 1 (0 EV) throughout: it is probably not passed on"
    if abs(told + picture).max() <= SAME_EV:
        return "the exposure is inverted: give the multiplier and not its inverse"
    if (picture > 0).all() and abs(np.exp2(told) - picture).max() <= SAME_EV:
        return "the exposure is the number of stops that is needed: give 2 to the power of it"
    return None


def _movement(told: np.ndarray, picture: np.ndarray) -> str:
    """How exposure and picture move."""
    told_moves, picture_moves = np.ptp(told) > STEADY_EV, np.ptp(picture) > STEADY_EV
    if told_moves and not picture_moves:
        return "the exposure changes while the picture does not"
    if picture_moves and not told_moves:
        return "the picture's brightness changes and the exposure does not follow; if that is intended, it is right"
    if told_moves and np.corrcoef(told, picture)[0, 1] < OPPOSED:
        return (
            "the picture gets brighter as the exposure rises, so the exposure is in the colour when it is metered: it "
            "feeds back; meter before exposing"
        )
    return "the exposure follows the picture late or not far enough; --exposure smooth looks ahead"
