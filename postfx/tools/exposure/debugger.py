"""The exposure debugger: is the exposure of a sequence right, steady and applied? If not, by how
much, and why?"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from postfx.errors import ExposureError
from postfx.exposure import (
    SECONDS,
    SMOOTH_MODE,
    ExposureMeter,
    MeterReading,
    frame_rate,
    measure,
    shots,
    smooth_ev,
)
from postfx.frame import Frame, Role
from postfx.passes import Pass
from postfx.runtime import Device
from postfx.tools.exposure.response import (
    VIEW_CURVE,
    Board,
    Calibration,
    Response,
    calibrate,
    is_built_in,
)

TOLERANCE_EV = 0.2
"""Largest mean mismatch that counts as right: below a quarter of a stop, above the meter's
noise."""

# Largest drift from the darkest to the brightest frame, of a steady scene and of one that
# changes: exposure need not follow such a change fully.
DRIFT_EV = 0.25
MOVING_DRIFT_EV = 0.5

RIGHT_VERDICT = "right"
DARK_VERDICT = "too dark"
BRIGHT_VERDICT = "too bright"
DRIFTING_VERDICT = "drifting"

NEAR_EV = 0.25
"""A picture this close to mid grey needs no exposure: noise may move the meter by as much."""
SAME_EV = 0.125
"""Stops by which a header's exposure and a picture's brightness may differ to be one."""
APPLIED_EV = 0.05  # the board's own error is smaller
STEADY_EV = 0.1
"""Stops by which a steady exposure, or a steady picture, may vary over a shot."""
OPPOSED = -0.8  # correlation


class Reading(NamedTuple):
    """One frame at the end of the chain.

    Attributes:
        number: frame number.
        cut: whether a shot begins here.
        exposure_ev: stops of exposure that the chain is told to apply.
        reference_ev: stops of the right exposure, by which the checkerboard is divided.
        picture_ev: stops that the picture itself needs, metered and smooth.
        level: level of the board's mid grey, 0..1.
        mismatch_ev: stops by which the level is too bright, within the limits of the view's
            response.
        expected_ev: the mismatch of a view that applies the exposure as told.
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
        mismatch_ev: mean of the stops by which frames are too bright.
        drift_ev: stops from the darkest to the brightest frame.
        level: mean level of mid grey.
        right_ev: mean of the right exposure in stops.
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
        limits_ev: smallest and largest mismatch that the level can show; a mismatch at a limit may
            be larger.
        curve: whose curve levels were compared with: the view's or the chain's own.
        remark: what else that curve shows; it never changes a verdict.
    """

    readings: list[Reading]
    shots: list[Shot]
    grey: float
    limits_ev: tuple[float, float]
    curve: str = VIEW_CURVE
    remark: str | None = None

    @property
    def verdict(self) -> str:
        """The verdict on all shots: drifting if one drifts, else the verdict on the shot with the
        largest mismatch."""
        drifting = [shot for shot in self.shots if shot.verdict == DRIFTING_VERDICT]
        return (drifting or [max(self.shots, key=lambda shot: abs(shot.mismatch_ev))])[0].verdict


def debug(
    frames: Iterable[Frame],
    view: Sequence[Pass],
    exposure: str | float = "auto",
    reference: str | float = SMOOTH_MODE,
    chain: Sequence[Pass] | None = None,
    device: Device | None = None,
) -> Report:
    """Measure the exposure of frames; reads them once, in order, and needs only their colour.

    Args:
        view: passes that show exposed scene-linear colour on a display, such as `[ToneMap()]`, or
            your own.
        exposure: the mode under test: 'auto', 'smooth', 'lit', 'metadata' or stops, as in `postfx
            run`.
        reference: the mode that is right; 'smooth' meters the pictures.
        chain: the passes after the upscaler, if they are not `view`.

    Passes of your own are judged by their own response, sampled on a ramp of light at 0 EV, so any
    curve is right if it applies the exposure that it is told. A `chain` with the curve of `view` is
    judged by `view`: a gain over it is a mistake, too. A gain over a known curve is a remark.

    Raises ExposureError if a mode has no exposure for a frame, or if there is no frame.
    """
    told = _Told(frames, exposure, reference)
    seen = Board(view, told.aspect, device)
    tested = seen if chain is None else Board(chain, told.aspect, device)
    judged = _judge_chain(view, seen, tested)
    levels = [tested.level(frame.exposure_ev, frame.reference_ev, frame.begins)
              for frame in told.frames]
    expected = [float(np.clip(frame.ordered_ev, *judged.response.limits_ev))
                for frame in told.frames]
    if judged.curve == VIEW_CURVE:  # the view's own history is no mistake
        wanted = (levels if tested is seen else [
            seen.level(frame.exposure_ev, frame.reference_ev, frame.begins)
            for frame in told.frames])
        expected = [judged.response.ev_of(level) for level in wanted]
    return _report(told.frames, levels, judged, list(map(judged.response.ev_of, levels)), expected)


def debug_graded(
    frames: Iterable[Frame],
    level: Callable[[int], float],
    judged: Calibration,
    exposure: str | float = "auto",
    reference: str | float = SMOOTH_MODE,
) -> Report:
    """Measure the exposure by checkerboards that another program graded.

    Args:
        frames: the render's frames, as for `debug`.
        level: frame number -> level of mid grey on its graded board, such as
            `postfx.tools.exposure.response.GradedBoards.level`.
        judged: the response that levels are compared with, by `read_response` or `judge_view` of
            `postfx.tools.exposure.response`.
        exposure: mode or stops of the run that wrote the boards, by which it divided them.

    Raises ExposureError as `debug` does, and if a frame has no board.
    """
    told = _Told(frames, exposure, reference)
    levels = [level(frame.number) for frame in told.frames]
    found = [judged.response.ev_of(one) + frame.ordered_ev
             for one, frame in zip(levels, told.frames, strict=True)]
    return _report(told.frames, levels, judged, found, [frame.ordered_ev for frame in told.frames])


def judge_view(view: Sequence[Pass], device: Device | None = None) -> Calibration:
    """Compare levels with the response of a view, as if the chain were that view."""
    return Calibration(Response.of_board(Board(view, device=device)), VIEW_CURVE)


def _judge_chain(view: Sequence[Pass], seen: Board, tested: Board) -> Calibration:
    """A chain with the view's curve is judged by the view, gain included; any other one by its own
    response."""
    response = Response.of_board(tested)
    if tested is seen:
        return Calibration(response, VIEW_CURVE) if is_built_in(view) else calibrate(response)
    shown = Response.of_board(seen)
    return (calibrate(response) if response.gain_over(shown) is None
            else Calibration(shown, VIEW_CURVE))


class _Frame(NamedTuple):
    """Stops of a frame: those that the chain is told, those that are right, and those that the
    meter reads; and whether a shot begins, because its file says so or because it is the first
    frame."""

    number: int
    cut: bool
    begins: bool
    exposure_ev: float
    reference_ev: float
    picture_ev: float

    @property
    def ordered_ev(self) -> float:
        """Stops by which the exposure under test is too bright."""
        return self.exposure_ev - self.reference_ev


class _Told:
    """The exposures that a chain is told, frame by frame; reads the frames once."""

    def __init__(self, frames: Iterable[Frame], exposure: str | float,
                 reference: str | float) -> None:
        told, right = _Mode(exposure), _Mode(reference)
        found, width, self.aspect = [], 1.0, 1.0
        for frame in frames:
            found.append(MeterReading(frame.number, measure(frame[Role.COLOUR]), frame.reset))
            told.see(frame)
            right.see(frame)
            width, self.aspect = SECONDS * frame_rate(frame), frame.spec.width / frame.spec.height
        if not found:
            raise ExposureError("there is no frame to measure: give at least one")
        smooth = smooth_ev(found, width)
        self.frames = [_Frame(number, cut, cut or index == 0, told.ev(number, smooth),
                              right.ev(number, smooth), smooth[number])
                       for index, (number, _, cut) in enumerate(found)]


def _report(frames: Sequence[_Frame], levels: Sequence[float], judged: Calibration,
            found: Sequence[float], expected: Sequence[float]) -> Report:
    """The report of frames from the stops by which each is too bright: as found, and as
    expected."""
    readings = [Reading(
        frame.number, frame.cut, frame.exposure_ev, frame.reference_ev, frame.picture_ev, level,
        mismatch, wanted
    ) for frame, level, mismatch, wanted in zip(frames, levels, found, expected, strict=True)]
    judged_shots = [_judge(readings[shot]) for shot in shots([item.cut for item in readings])]
    return Report(readings, judged_shots, judged.response.grey, judged.response.limits_ev,
                  judged.curve, judged.remark)


class _Mode:
    """Stops of each frame in one of the modes."""

    def __init__(self, mode: str | float) -> None:
        self._meter = None if mode == SMOOTH_MODE else ExposureMeter(mode)
        self._ev: dict[int, float] = {}

    def see(self, frame: Frame) -> None:
        if self._meter:
            self._ev[frame.number] = float(np.log2(self._meter(frame)))

    def ev(self, number: int, smooth: dict[int, float]) -> float:
        return self._ev[number] if self._meter else smooth[number]


def _judge(readings: Sequence[Reading]) -> Shot:
    """What the readings of one shot say of it."""
    mismatch = np.array([reading.mismatch_ev for reading in readings])
    verdict = _verdict(mismatch, np.ptp([reading.reference_ev for reading in readings]))
    return Shot(
        first=readings[0].number,
        last=readings[-1].number,
        verdict=verdict,
        mismatch_ev=float(mismatch.mean()),
        drift_ev=float(np.ptp(mismatch)),
        level=float(np.mean([reading.level for reading in readings])),
        right_ev=float(np.mean([reading.exposure_ev - reading.mismatch_ev
                                for reading in readings])),
        cause=None if verdict == RIGHT_VERDICT
              else likely_cause(readings, verdict == DRIFTING_VERDICT),
    )


def _verdict(mismatch: np.ndarray, scene_moves: float) -> str:
    if np.ptp(mismatch) > (MOVING_DRIFT_EV if scene_moves > DRIFT_EV else DRIFT_EV):
        return DRIFTING_VERDICT
    if abs(mismatch.mean()) <= TOLERANCE_EV:
        return RIGHT_VERDICT
    return BRIGHT_VERDICT if mismatch.mean() > 0 else DARK_VERDICT


def likely_cause(readings: Sequence[Reading], drifting: bool) -> str | None:
    """A sentence with the mistake and its fix; None if no mistake fits and the exposure may be
    intended."""
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
    """Exposure that the passes after the upscaler apply in addition to the one that they are
    told."""
    if abs(extra).max() <= APPLIED_EV:
        return None
    if np.ptp(extra) > STEADY_EV:
        return (
            f"after the upscaler the chain adds {extra.min():+.2f} to {extra.max():+.2f} EV to "
            "the exposure that it is told: it meters for itself or lags; give the tone mapper the "
            "frame's exposure"
        )
    return (
        f"after the upscaler the chain adds {extra.mean():+.2f} EV to the exposure that it is "
        "told: give the tone mapper the frame's exposure and nothing else"
    )


def _pattern(told: np.ndarray, picture: np.ndarray) -> str | None:
    """Mistakes in the kind of number: applied twice, not passed on, inverted, or stops."""
    if abs(picture).max() <= NEAR_EV < abs(told).max():
        return (
            "the colour is at mid grey before it is exposed: if it already includes the exposure, "
            "it is exposed a second time; divide the colour by it, or give an exposure of 1 (0 EV)"
        )
    if not told.any():
        return "the exposure is 1 (0 EV) throughout: it is probably not passed on"
    if abs(told + picture).max() <= SAME_EV:
        return "the exposure is inverted: give the multiplier, not its inverse"
    if (picture > 0).all() and abs(np.exp2(told) - picture).max() <= SAME_EV:
        return ("the exposure is the number of stops that the picture needs: give 2 to the power "
                "of it")
    return None


def _movement(told: np.ndarray, picture: np.ndarray) -> str:
    """How exposure and picture move."""
    told_moves, picture_moves = np.ptp(told) > STEADY_EV, np.ptp(picture) > STEADY_EV
    if told_moves and not picture_moves:
        return "the exposure changes while the picture does not"
    if picture_moves and not told_moves:
        return ("the picture's brightness changes and the exposure does not follow, which may be "
                "intended")
    if told_moves and np.corrcoef(told, picture)[0, 1] < OPPOSED:
        return (
            "the picture gets brighter as the exposure rises, so the meter sees colour that is "
            "already exposed, and feeds back; meter before exposing"
        )
    return "the exposure follows the picture late or not far enough; --exposure smooth looks ahead"
