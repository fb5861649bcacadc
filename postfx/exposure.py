"""Exposure metering: one multiplier a frame, from the picture, from its header, fixed, or from the
whole sequence.

The tone mapper and the eye should see colour times the multiplier; middle grey is 0.18.
`ExposureMeter` uses only this frame and earlier ones, so a sequence gets the same numbers in one
run as frame by frame. `SmoothExposure` meters the whole sequence first, then fits a smooth curve,
which depends on earlier and on later frames.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from postfx.errors import ExposureError, PostfxError
from postfx.files import read_ahead
from postfx.frame import KEY, Frame, Role, factor_of_stops
from postfx.kernels.statistics import block_means

if TYPE_CHECKING:
    from postfx.io.sequence import Sequence as FrameSequence

LIMITS_EV = (-40.0, 40.0)
"""Least and largest exposure in stops. Beyond them light would not stay finite."""
PERCENTILES = (2.0, 98.0)
"""Percentiles of a picture's blocks between which they are metered."""
RANGE_EV = 9.0
"""Stops below the upper percentile that count at most: darker blocks count as if they had these."""
BLACK_LUMINANCE = KEY / 2.0 ** LIMITS_EV[1]
"""Mean luminance of a block up to which no exposure brings it to middle grey. It is far below the
least light of half floats, so that pictures in any unit of light are metered alike."""
EMPTY_SHARE = 2.0**-24
"""Luminance of a block over that of bright ones, up to which it is empty, as borders and misses
are."""
METERED_BLOCK_PX = 8
"""Side of a block, at least."""
MOST_METERED_BLOCKS = 160
"""Blocks along a picture's longer side, at most: in larger pictures blocks are larger."""

# Time constants; eyes and cameras close faster than they open.
BRIGHTEN_SECONDS = 1.0
DARKEN_SECONDS = 0.4

FRAMES_PER_SECOND = 24.0
"""Frame rate of files whose header does not say it."""
MODES = ("auto", "lit", "metadata")
USED_EXPOSURE_ATTRIBUTE = "postfx:exposureUsedEV"
"""Header attribute with the stops that a run used, for later programs; the author's own is
postfx:exposureEV."""
APPLIED = "postfx:exposureAppliedEV"
"""The attribute's name if the pixels already include the exposure."""
USED_FACTOR = "postfx:exposureUsed"
"""What versions before wrote in place of `USED_EXPOSURE_ATTRIBUTE`: what light is multiplied by."""

SMOOTH_MODE = "smooth"
SECONDS = 0.5
"""Standard deviation of the Gaussian weights in time."""
REACH_DEVIATIONS = 4
"""Standard deviations beyond which frames have no weight."""


def measure(colour: np.ndarray) -> float | None:
    """EV that brings a picture to middle grey, or None if it is black.

    colour: (height, width, 3) scene-linear Rec.709. The mean of log2 luminance over blocks of
    pixels, between the 2nd and the 98th percentile, is brought to log2(0.18); blocks more than 9
    stops below the 98th percentile count as 9 stops below. The result is limited to +-40 EV.
    """
    height, width = colour.shape[:2]
    block = max(METERED_BLOCK_PX, math.ceil(max(height, width) / MOST_METERED_BLOCKS))
    means = block_means(colour, block)
    if not (means > BLACK_LUMINANCE).any():
        return None
    bright = float(np.percentile(means[means > 0], PERCENTILES[1]))
    log = np.log2(means[means > EMPTY_SHARE * bright])
    in_order, low_at, high_at = np.sort(log), *[(log.size - 1) * (percent / 100)
                                                for percent in PERCENTILES]
    # members: two blocks have no inside
    low, high = in_order[math.floor(low_at)], in_order[math.ceil(high_at)]
    inner = np.maximum(log[(log >= low) & (log <= high)], high - RANGE_EV)
    return min(max(float(math.log2(KEY) - inner.sum() / inner.size), LIMITS_EV[0]), LIMITS_EV[1])


class ExposureMeter:
    """Stateful exposure: call it with each frame in order to get the multiplier (> 0) for that
    frame.

    mode: 'auto' meters each picture and follows it smoothly in EV, slower towards brighter (1 s)
    than towards darker (0.4 s), but at once on the first frame and at cuts (`frame.reset`); a black
    frame keeps the shot's last value. 'lit' shows the light as its author made it:
    `frame.exposure`, or 0 if the header has none. 'metadata' is an error if the header has none,
    unless an earlier run wrote the frame: then it takes that run's stops
    (`USED_EXPOSURE_ATTRIBUTE`). A number is an EV: the multiplier is 2 ** EV.
    """

    def __init__(self, mode: str | float = "auto") -> None:
        is_word = isinstance(mode, str) and mode in MODES
        self.mode: str | float = mode if is_word else _fixed_ev(mode)
        self._ev: float | None = None

    def reset(self) -> None:
        """Forget the past: the next frame is metered like the first one."""
        self._ev = None

    @property
    def remembers(self) -> bool:
        """Whether the multiplier depends on earlier frames."""
        return self.mode == "auto"

    def history(self) -> dict[str, np.ndarray]:
        """The state that the next multiplier depends on."""
        return {} if self._ev is None else {"ev": np.array(self._ev, np.float64)}

    def recall(self, history: Mapping[str, np.ndarray]) -> None:
        """Continue from this `history`."""
        self._ev = float(history["ev"]) if history else None

    def __call__(self, frame: Frame) -> float:
        """Multiplier for `frame`; ExposureError if the mode is 'metadata' and the header has
        none."""
        if self.mode == "lit" and frame.exposure is None:
            return 1.0
        if self.mode in ("lit", "metadata"):
            return _header_factor(frame)
        if self.mode == "auto":
            return float(2.0 ** self._follow(frame))
        return factor_of(self.mode)

    def _follow(self, frame: Frame) -> float:
        """Stops for a frame that follow its metering by and by, as an eye does; at once where a
        shot begins."""
        wanted = measure(frame[Role.COLOUR])
        if frame.reset:
            self._ev = None
        if wanted is not None:
            if self._ev is None:
                self._ev = wanted
            else:
                seconds = BRIGHTEN_SECONDS if wanted > self._ev else DARKEN_SECONDS
                # the share of the way that one frame covers
                share = 1.0 - math.exp(-1.0 / (frame_rate(frame) * seconds))
                self._ev += (wanted - self._ev) * share
        return self._ev if self._ev is not None else 0.0


def frame_rate(frame: Frame) -> float:
    """Frames per second from the header, else 24."""
    rate = frame.metadata.get("framesPerSecond", FRAMES_PER_SECOND)
    return float(rate) if isinstance(rate, int | float) and rate > 0 else FRAMES_PER_SECOND


def factor_of(stops: str | float) -> float:
    """The multiplier of an exposure in stops. Raises ExposureError for what is not a number within
    -64..64."""
    return float(2.0 ** _fixed_ev(stops))


def _fixed_ev(mode: str | float) -> float:
    try:
        ev = float(mode)
    except (TypeError, ValueError):
        ev = math.nan
    if not abs(ev) <= 64:
        raise ExposureError(
            f"exposure '{mode}': use auto, lit, metadata or a number of stops (EV) within -64..64; "
            "for sequences smooth too"
        )
    return ev


def _header_factor(frame: Frame) -> float:
    name = frame.source or f"frame {frame.number}"
    factor = _factor_used(frame) if frame.exposure is None else frame.exposure_factor
    if factor is None:
        raise ExposureError(f"{name}: no exposure in its header (postfx:exposureEV): use "
                            "--exposure auto or an EV number")
    if not 0 < factor < math.inf:
        raise ExposureError(f"{name}: exposure {frame.exposure} in its header is no number of "
                            "stops: use --exposure auto")
    return factor


def _factor_used(frame: Frame) -> float | None:
    """What an earlier run multiplied a frame's light by; NaN for what is no number."""
    stops, factor = (frame.metadata.get(name) for name in (USED_EXPOSURE_ATTRIBUTE, USED_FACTOR))
    if stops is not None:
        return factor_of_stops(stops) if isinstance(stops, int | float) else math.nan
    return factor if factor is None or isinstance(factor, int | float) else math.nan


class MeterReading(NamedTuple):
    """The meter's reading of a frame.

    Attributes:
        number: frame number.
        ev: stops that bring the picture to mid grey, None for a black frame.
        cut: whether a shot begins here.
    """

    number: int
    ev: float | None
    cut: bool


class SmoothExposure:
    """Exposure that meters the whole sequence first; use it in place of an `ExposureMeter`.

    frames: the sequence, which is read once, when the first multiplier is needed. Within each shot,
    from cut to cut (`frame.reset`), a straight line is fitted around each frame, weighted by a
    Gaussian of `seconds` in time (Cleveland 1979); it does not lag. A frame that was not metered
    gets the multiplier of the nearest frame number.
    """

    def __init__(self, frames: Iterable[Frame], seconds: float = SECONDS) -> None:
        self._frames, self._seconds = frames, seconds
        self._ev: dict[int, float] = {}

    def reset(self) -> None:
        """Does nothing: the curve belongs to the sequence."""

    remembers = False

    def history(self) -> dict[str, np.ndarray]:
        """Empty: the curve belongs to the sequence."""
        return {}

    def recall(self, history: Mapping[str, np.ndarray]) -> None:
        """Does nothing."""

    def __call__(self, frame: Frame) -> float:
        """Multiplier for `frame`, by its number."""
        if not self._ev:
            readings = list(meter_frames(self._frames))
            self._ev = smooth_ev(readings, self._seconds * frame_rate(frame))
        nearest = min(self._ev, key=lambda number: abs(number - frame.number), default=None)
        return 1.0 if nearest is None else 2.0 ** self._ev[nearest]


def meter_frames(frames: Iterable[Frame]) -> Iterator[MeterReading]:
    """Each frame's reading, one frame in memory at a time."""
    for frame in frames:
        yield MeterReading(frame.number, measure(frame[Role.COLOUR]), frame.reset)


def colours_of(sequence: FrameSequence, lenient: bool = False) -> Iterator[Frame]:
    """Frames of a sequence with their colour only; does not disturb other readers of the sequence.

    If `lenient`, frames that cannot be read are skipped.
    """
    own = sequence.reader()  # cuts depend on the frame that was read last
    own.rewind()
    return (frame
            for _, frame in read_ahead(own.numbers, lambda number: _colour_of(own, number, lenient))
            if frame)


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


def smooth_ev(readings: Sequence[MeterReading], width: float) -> dict[int, float]:
    """Frame number -> smooth EV. width: standard deviation in frames; an all-black shot has 0
    EV."""
    curve: dict[int, float] = {}
    for shot in shots([reading.cut for reading in readings]):
        ev = np.array([np.nan if reading.ev is None else reading.ev for reading in readings[shot]])
        curve |= zip((reading.number for reading in readings[shot]), _smooth(ev, width),
                     strict=True)
    return curve


def _smooth(ev: np.ndarray, width: float) -> list[float]:
    """A straight line fitted around each frame; a mean would bend at the shot's ends."""
    known = np.flatnonzero(np.isfinite(ev))
    if known.size == 0:
        return [0.0] * len(ev)
    result = []
    for at in range(len(ev)):
        near = known[abs(known - at) <= REACH_DEVIATIONS * width]
        if near.size < 2:  # all black here: keep the last known value
            result.append(float(ev[known[abs(known - at).argmin()]]))
            continue
        time = near - at
        weight = np.exp(-0.5 * (time / width) ** 2)
        centre, mean = np.average(time, weights=weight), np.average(ev[near], weights=weight)
        slope = (weight * (time - centre)) @ (ev[near] - mean) / (weight @ (time - centre) ** 2)
        result.append(float(np.clip(mean - slope * centre, ev[near].min(), ev[near].max())))
    return result
