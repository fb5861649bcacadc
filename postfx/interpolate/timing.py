"""Which frames a sequence gets when frames are put between its own: times, numbers, frame rate,
time code and camera; and the course of light through the frames around a time: of still surfaces,
and of sparks.

Time codes are those of SMPTE ST 12-1 as OpenEXR stores them: hours, minutes, seconds and frames as
decimal digits of 4 bits in one word. Above 30 frames a second, frames are counted in pairs and a
bit tells the second one of a pair.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any, NamedTuple

import numpy as np

from postfx.caching import new_array
from postfx.compiled.calls import whole
from postfx.compiled.library import Rows
from postfx.errors import OptionError
from postfx.frame import Frame, Role
from postfx.interpolate.choose import STILL
from postfx.system import in_bands

# Bits of a time code's word: dropped frame numbers, and the second frame of a pair.
_DROP = 1 << 6
_FIELD = 1 << 15

_PLACES = ((24, 30), (16, 23), (8, 15), (0, 6))
"""First and last bit of hours, minutes, seconds and frames."""
SPARK_SURROUNDINGS_SHARE = 0.09
"""How far away what is around a spark is looked for, as a share of the picture's shorter side."""
SPARK_SCALES = 0.5, 2.5
"""By how much the light of sparks may be scaled, least and most."""
MOST_RATE = 60
"""Frames a second that a time code can count."""

# Kernels: postfx/kernels/interpolate/timing.cpp

_curve = Rows("curve_light")
_brightest = Rows("brightest_cells")
_mark = Rows("mark_sparks")
_grow = Rows("grow_marks")
_settle = Rows("settle_sparks")
_sum = Rows("sum_sparks")
_scale = Rows("scale_sparks")


class Moment(NamedTuple):
    """A frame of the new sequence.

    Attributes:
        number: its frame number.
        start: of the frame before it, or of itself, in the old sequence, from 0.
        t: time since that frame, 0 to 1 (not included); 0 for that frame itself.
        previous: the time of the new frame before, to which its motion leads, counted like t; for
            t = 0 counted in the interval that ends there.
    """

    number: int
    start: int
    t: float
    previous: float


@dataclass(frozen=True)
class Times:
    """Times at which there are frames.

    Attributes:
        within: times in each interval, ascending from 0; empty where a rate decides.
        ratio: new frames for one old frame; None where times are not evenly spaced.
        rate: frames a second of the old sequence, if it was given.
    """

    within: tuple[Fraction, ...] = ()
    ratio: Fraction | None = None
    rate: Fraction | None = None

    def moments(self, numbers: Sequence[int]) -> Iterator[Moment]:
        """All frames of a sequence with these numbers, numbered on from its first one."""
        last, before = len(numbers) - 1, Fraction(0)
        for count, time in enumerate(self._all(last)):
            index = min(int(time), last)
            # the last frame's motion leads through the interval that ends there
            origin = index - 1 if time == index and index else index
            yield Moment(numbers[0] + count, index, float(time - index), float(before - origin))
            before = time

    def _all(self, last: int) -> Iterator[Fraction]:
        if self.within:
            yield from (index + t for index in range(last) for t in self.within)
            yield Fraction(last)
        elif self.ratio:
            yield from (count / self.ratio for count in range(int(last * self.ratio) + 1))

    def header(self, metadata: Mapping[str, Any], count: int,
               first: Mapping[str, Any]) -> dict[str, Any]:
        """Metadata of the new frame with this count from 0, in the place of `metadata`.

        first: metadata of the old sequence's first frame. Without an even rate there is no frame
        rate and no time code, without a known one no time code.
        """
        found = {name: value
                 for name, value in metadata.items() if name not in ("framesPerSecond", "timeCode")}
        rate = self.rate or as_rate(first.get("framesPerSecond"))
        if self.ratio is None or rate is None:
            return found
        found["framesPerSecond"] = float(rate * self.ratio)
        code = first.get("timeCode")
        if code is not None and nominal(rate * self.ratio) <= MOST_RATE:
            frames = math.floor(read_code(code[0], rate) * self.ratio) + count
            found["timeCode"] = (make_code(frames, rate * self.ratio, bool(code[0] & _DROP)),
                                 int(code[1]))
        return found


def parse_times(times: str | None, rates: str | None = None) -> Times:
    """Times that --times ('2', or '0.25,0.5') and --fps ('24:60', or '24' for the old rate alone)
    ask for.

    Raises OptionError for anything else.
    """
    old, _, new = (rates or "").partition(":")
    rate = _number(old, f"--fps {rates}") if old else None
    if new and times:
        raise OptionError(f"--times {times} and --fps {rates} both say how many frames: give "
                          f"--times with --fps {old}")
    if new and rate:
        ratio = _number(new, f"--fps {rates}") / rate
        if ratio <= 1:
            raise OptionError(f"--fps {rates}: {new} is not above {old}: give a higher one, like "
                              "24:60")
        return Times(ratio=ratio, rate=rate)
    text = times or "2"
    if text.isdigit():
        count = int(text)
        if not 2 <= count <= 64:
            raise OptionError(f"--times {text}: give 2 to 64 times as many frames, or times like "
                              "0.25,0.5")
        return Times(tuple(Fraction(k, count) for k in range(count)), Fraction(count), rate)
    within = sorted({Fraction(0), *(_number(one, f"--times {text}") for one in text.split(","))})
    if within[-1] >= 1:
        raise OptionError(f"--times {text}: {float(within[-1]):g} is not between two frames: give "
                          "times below 1")
    even = all(t == Fraction(k, len(within)) for k, t in enumerate(within))
    return Times(tuple(within), Fraction(len(within)) if even else None, rate)


def _number(text: str, option: str) -> Fraction:
    try:
        number = Fraction(text.strip())
    except (ValueError, ZeroDivisionError):
        number = Fraction(0)
    if number <= 0:
        raise OptionError(f"{option}: '{text.strip()}' is no number above 0")
    return number


def as_rate(value: Any) -> Fraction | None:
    """Frames a second as a fraction, 23.976 as 24000/1001; None for no rate."""
    try:
        rate = float(value)
    except (TypeError, ValueError):
        return None
    if not 0 < rate < MOST_RATE * 1000:
        return None
    whole = round(rate)
    return (Fraction(1000 * whole, 1001) if 5e-4 < whole / rate - 1 < 2e-3
            else Fraction(rate).limit_denominator(1001))


def nominal(rate: Fraction) -> int:
    """The frames that a time code counts in a second."""
    return math.ceil(rate - Fraction(1, 1000))


def read_code(word: int, rate: Fraction) -> int:
    """Frames since midnight of a time code's first word, at a rate."""
    hours, minutes, seconds, frames = (_digits(word, first, last) for first, last in _PLACES)
    base = nominal(rate)
    if base > 30:
        frames = 2 * frames + bool(word & _FIELD)
    total = ((hours * 60 + minutes) * 60 + seconds) * base + frames
    if word & _DROP:
        whole = hours * 60 + minutes
        total -= _dropped(base) * (whole - whole // 10)
    return total


def make_code(total: int, rate: Fraction, drop: bool) -> int:
    """A time code's first word; drop: whether frame numbers are left out to keep up with the clock,
    as they can be at 30 and 60 times 1000/1001 frames a second."""
    base = nominal(rate)
    drop = drop and base in (30, 60) and rate != base
    if drop:
        skipped, minute = _dropped(base), 60 * base
        ten = 10 * minute - 9 * skipped
        tens, rest = divmod(total, ten)
        late = max(rest - skipped, 0) // (minute - skipped) if rest >= minute else 0
        total += skipped * (9 * tens + late)
    seconds, frames = divmod(total, base)
    word = _FIELD if base > 30 and frames % 2 else 0
    frames = frames // 2 if base > 30 else frames
    parts = seconds // 3600 % 24, seconds // 60 % 60, seconds % 60, frames
    for (first, _), value in zip(_PLACES, parts, strict=True):
        word |= (value // 10 << 4 | value % 10) << first
    return word | (_DROP if drop else 0)


def _dropped(base: int) -> int:
    """Frame numbers left out in a minute."""
    return 2 * base // 30


def _digits(word: int, first: int, last: int) -> int:
    """Two decimal digits in these bits."""
    value = word >> first & ((1 << (last - first)) - 1)
    return (value >> 4) * 10 + (value & 15)


def camera_between(one: np.ndarray | None, other: np.ndarray | None, t: float) -> np.ndarray | None:
    """World to camera (4, 4) at a time between two: turned about one axis, and moved straight. None
    where there is none."""
    if one is None or other is None:
        return None
    try:
        first, last = np.linalg.inv(one), np.linalg.inv(other)
        turn = np.linalg.inv(first[:3, :3]) @ last[:3, :3]
        angle = math.acos(min(max((np.trace(turn) - 1) / 2, -1), 1))
        if not np.allclose(turn @ turn.T, np.eye(3), atol=1e-3) or angle > 3:
            return None
        axis = (turn - turn.T) / (2 * math.sin(angle)) if angle > 1e-9 else np.zeros((3, 3))
        # Rodrigues
        part = np.eye(3) + math.sin(t * angle) * axis + (1 - math.cos(t * angle)) * axis @ axis
        camera = first.copy()
        camera[:3, :3] = first[:3, :3] @ part
        camera[3] = (1 - t) * first[3] + t * last[3]
        found: np.ndarray = np.linalg.inv(camera)
    except np.linalg.LinAlgError:
        return None
    return found


def follow_light(frames: Sequence[Frame | None], t: float, picture: np.ndarray) -> None:
    """Lead light through four frames, a frame apart, where nothing moves: at time t between the
    middle two, in place.

    Lagrange's cubic, within what the middle two show. It is left out where a frame is missing or
    has no depth or no motion, a shot begins, or sizes differ. picture: (h, w, 3) of that time.
    """
    size = picture.shape[:2]
    known = [one for one in frames if one is not None]
    if len(known) < len(frames):
        return
    if not all(_has_sized(one, size, Role.COLOUR, Role.DEPTH) for one in known):
        return
    if not all(_has_sized(one, size, Role.MOTION) and not one.reset for one in known[1:]):
        return
    motions = [one[Role.MOTION] for one in known[1:]]
    depths = [one[Role.DEPTH] for one in known]
    if not (np.abs(motions[1][::8, ::8]).max(-1) < STILL).any():
        return
    shares = (-t * (t - 1) * (t - 2) / 6, (t + 1) * (t - 1) * (t - 2) / 2,
              -t * (t + 1) * (t - 2) / 2, t * (t + 1) * (t - 1) / 6)
    planes = [whole(plane, np.float32)
              for plane in (*(one[Role.COLOUR] for one in known), *motions, *depths)]
    in_bands(len(picture), _curve.bind((*planes, np.array((*shares, t), np.float32), picture)))


def _has_sized(frame: Frame, size: tuple[int, int], *roles: Role) -> bool:
    """Whether a frame has planes of these roles, of this height and width."""
    return all(role in frame and frame[role].shape[:2] == size for role in roles)


# Sparks: isolated, bright, and gone from where a path leads in the other frame.


def find_sparks(picture: np.ndarray, scale: int, dim: float, grid: tuple[int, int]) -> np.ndarray:
    """Marks of cells (rows, columns) of a picture (h, w, 3): 3 and 2 where a pixel is 60 and 32
    times as bright as the dark and as what is around it, and 1 up to two cells beside.

    scale: pixels of a cell. dim: light that counts as dark, summed over channels.
    """
    bright, found = new_array(grid), np.zeros(grid, np.uint8)
    in_bands(grid[0], _brightest.bind((picture, np.array([scale], np.float32), bright)))
    reach = max(1, int(SPARK_SURROUNDINGS_SHARE * min(grid)))
    in_bands(grid[0], _mark.bind((bright, np.array((dim, reach), np.float32), found)))
    _grow(0, 1, found)
    return found


@dataclass(frozen=True)
class Sparks:
    """Sparks of both frames.

    Attributes:
        pictures: (h, w, 3) colours.
        marks: (rows, columns) uint8 of cells, of `find_sparks`.
        scale: pixels of a cell.
        dim: light that counts as dark, summed over channels.
    """

    pictures: tuple[np.ndarray, np.ndarray]
    marks: Sequence[np.ndarray]
    scale: int
    dim: float

    def arrays(self, t: float) -> tuple[np.ndarray, ...]:
        """The arguments of kernels that they share, at a time."""
        return *self.pictures, *self.marks, np.array((self.scale, self.dim, t), np.float32)


def settle_sparks(sparks: Sparks, t: float, own: np.ndarray, cells: np.ndarray) -> np.ndarray:
    """Take cells (rows, columns, 8), within a pixel of which only the frame that is farther from a
    time t shows a spark, from the nearer one alone: also a spark's edge, which a mean would leave
    as a ring.

    own: (rows, columns, 8), paths of cells by their planes. Gives the mark of the cells to which
    each path leads; else 1 where the cell's own path leads to marked ones: (rows, columns) uint8.
    """
    near = np.empty(cells.shape[:2], np.uint8)
    in_bands(len(cells), _settle.bind((*sparks.arrays(t), own, cells, near)))
    return near


def keep_sparks(sparks: Sparks, t: float, own: np.ndarray, near: np.ndarray,
                picture: np.ndarray) -> None:
    """Give the light of sparks that the picture of a time t (h, w, 3) has lost to those that it
    shows, in place.

    Fast sparks have no right path: some of them are hidden where a path of what is behind them fits
    better. What the two frames show of them, by time, is what the picture should.

    own: (rows, columns, 8), paths of cells by their planes. near: as `settle_sparks` gives it.
    """
    given, sums = sparks.arrays(t), np.zeros(2)
    _sum(0, 1, *given, own, picture, near, sums)
    if sums[1] > 0:
        factor = np.clip(sums[0] / sums[1], *SPARK_SCALES)
        _scale(0, 1, *given, own, np.array([factor], np.float32), near, picture)
