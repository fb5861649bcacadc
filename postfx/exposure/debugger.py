"""The exposure debugger: is the exposure of a sequence right, steady and applied as told, by how much not, and why."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from postfx.errors import ExposureError
from postfx.exposure.board import Board, Response
from postfx.exposure.causes import likely_cause
from postfx.exposure.metering import ExposureMeter, frame_rate, measure
from postfx.exposure.smoothing import SECONDS, SMOOTH, Metered, shots, smooth_ev
from postfx.frame import Frame, Role
from postfx.passes.base import Pass
from postfx.runtime import Device

TOLERANCE_EV = 0.2
"""A mean mismatch that is right: a quarter of a stop is found, noise that moves the meter is not."""
DRIFT_EV, MOVING_DRIFT_EV = 0.25, 0.5
"""From the darkest to the brightest frame; more where the scene itself moves, as exposure need not follow all of it."""
RIGHT, DARK, BRIGHT, DRIFTING = "right", "too dark", "too bright", "drifting"


class Reading(NamedTuple):
    """One frame at the end of the chain.

    Attributes:
        number: frame number.
        cut: whether a shot begins here.
        exposure_ev: stops that the chain is told to expose by.
        reference_ev: stops that the checkerboard is divided by: the right exposure.
        picture_ev: stops that the picture itself needs, metered and smooth.
        level: of the board's mid grey, 0..1.
        mismatch_ev: stops that the level is too bright, within the limits of the view's response.
        expected_ev: the same, where the view does as it is told.
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
    """What the debugger says about the frames from one cut to the next.

    Attributes:
        first, last: frame numbers.
        verdict: 'right', 'too dark', 'too bright' or 'drifting'.
        mismatch_ev: mean stops too bright.
        drift_ev: stops from the darkest to the brightest frame.
        level: mean level of mid grey.
        right_ev: mean stops that would have been right.
        cause: what is likely wrong, or None.
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
    """All readings, and the shots that they fall into.

    Attributes:
        grey: level that mid grey has when the exposure is right.
        limits_ev: mismatches between which the level tells the exposure; one at a limit may be larger.
    """

    readings: list[Reading]
    shots: list[Shot]
    grey: float
    limits_ev: tuple[float, float]

    @property
    def verdict(self) -> str:
        """Of all shots: drifting where one does, else that of the shot which is furthest off."""
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
        exposure: what is under test: 'auto', 'smooth', 'metadata' or stops, as in `postfx run`.
        reference: what would be right: the same modes; 'smooth' is metered on the pictures.
        chain: what comes after the upscaler, where that is not `view` but should do the same.

    Raises ExposureError where a mode has no answer and when there is no frame.
    """
    told, right = _Mode(exposure), _Mode(reference)
    found, width, aspect = [], 1.0, 1.0
    for frame in frames:
        found.append(Metered(frame.number, measure(frame[Role.COLOUR]), frame.reset))
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
