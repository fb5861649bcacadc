"""Exposure of a whole sequence: metered first, then followed by a smooth curve that looks both ways in time."""

from __future__ import annotations

import copy
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from postfx.errors import PostfxError
from postfx.exposure.metering import frame_rate, measure
from postfx.frame import Frame, Role
from postfx.io.prefetch import read_ahead

if TYPE_CHECKING:
    from postfx.io.sequence import Sequence as FrameSequence

SMOOTH = "smooth"
SECONDS = 0.5
"""Standard deviation of the Gaussian weights in time."""
REACH = 4  # standard deviations; what lies further away has no weight


class Metered(NamedTuple):
    """What the meter says about a frame.

    Attributes:
        number: frame number.
        ev: stops that bring the picture to mid grey, None for a black frame.
        cut: whether a shot begins here.
    """

    number: int
    ev: float | None
    cut: bool


class SmoothExposure:
    """Exposure by two passes; used like an `ExposureMeter`, and given to a `Pipeline` in its place.

    frames: the sequence, at least once iterable; it is metered when the first multiplier is asked for. Within each
    shot the EV follows a local straight line, weighted by a Gaussian of `seconds` in time (Cleveland 1979), which lags
    behind nothing; it is broken at cuts (`frame.reset`). A frame that was not metered has the multiplier of the one
    with the nearest number.
    """

    def __init__(self, frames: Iterable[Frame], seconds: float = SECONDS) -> None:
        self._frames, self._seconds = frames, seconds
        self._ev: dict[int, float] = {}

    def reset(self) -> None:
        """Nothing to forget: the curve belongs to the sequence."""

    remembers = False

    def history(self) -> dict[str, np.ndarray]:
        """Nothing, likewise."""
        return {}

    def recall(self, history: Mapping[str, np.ndarray]) -> None:
        """Nothing to take."""

    def __call__(self, frame: Frame) -> float:
        """Multiplier for `frame`, by its number."""
        if not self._ev:
            readings = list(metered(self._frames))
            self._ev = smooth_ev(readings, self._seconds * frame_rate(frame))
        nearest = min(self._ev, key=lambda number: abs(number - frame.number), default=None)
        return 1.0 if nearest is None else 2.0 ** self._ev[nearest]


def metered(frames: Iterable[Frame]) -> Iterator[Metered]:
    """Each frame's reading, one frame in memory at a time."""
    for frame in frames:
        yield Metered(frame.number, measure(frame[Role.COLOUR]), frame.reset)


def colours_of(sequence: FrameSequence, lenient: bool = False) -> Iterator[Frame]:
    """Frames of a sequence with nothing but their colour; what else reads the sequence meanwhile is not disturbed.

    When `lenient`, those that cannot be read are left out.
    """
    own = copy.copy(sequence)  # which frame was read last decides what is a cut
    own.rewind()
    return (frame for _, frame in read_ahead(own.numbers, lambda number: _colour_of(own, number, lenient)) if frame)


def _colour_of(sequence: FrameSequence, number: int, lenient: bool) -> Frame | None:
    try:
        return sequence.read(number, (Role.COLOUR,), ())
    except PostfxError:
        if not lenient:
            raise
        return None


def shots(cuts: Sequence[bool]) -> list[slice]:
    """Runs of frames from cut to cut."""
    edges = [0, *(index for index, cut in enumerate(cuts) if cut and index), len(cuts)]
    return [slice(*edge) for edge in zip(edges, edges[1:], strict=False)]


def smooth_ev(readings: Sequence[Metered], width: float) -> dict[int, float]:
    """Frame number -> smooth EV. width: standard deviation in frames; a shot of black frames only has 0 EV."""
    curve: dict[int, float] = {}
    for shot in shots([reading.cut for reading in readings]):
        ev = np.array([np.nan if reading.ev is None else reading.ev for reading in readings[shot]])
        curve |= zip((reading.number for reading in readings[shot]), _smoothed(ev, width), strict=True)
    return curve


def _smoothed(ev: np.ndarray, width: float) -> list[float]:
    """A straight line fitted around each frame; a line, and not a mean, as it does not bend at the shot's ends."""
    known = np.flatnonzero(np.isfinite(ev))
    if known.size == 0:
        return [0.0] * len(ev)
    result = []
    for at in range(len(ev)):
        near = known[abs(known - at) <= REACH * width]
        if near.size < 2:  # a black stretch: hold what was known last
            result.append(float(ev[known[abs(known - at).argmin()]]))
            continue
        time = near - at
        weight = np.exp(-0.5 * (time / width) ** 2)
        centre, mean = np.average(time, weights=weight), np.average(ev[near], weights=weight)
        slope = (weight * (time - centre)) @ (ev[near] - mean) / (weight @ (time - centre) ** 2)
        result.append(float(np.clip(mean - slope * centre, ev[near].min(), ev[near].max())))
    return result
