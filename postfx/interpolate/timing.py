"""Which frames a sequence gets when frames are put between its own: times, numbers, frame rate, time code and camera;
and the course of light through the frames around a time: of still surfaces, and of sparks.

Time codes are those of SMPTE ST 12-1 as OpenEXR stores them: hours, minutes, seconds and frames as decimal digits of 4
bits in one word. Above 30 frames a second, frames are counted in pairs and a bit tells the second one of a pair.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any, NamedTuple

import numpy as np

from postfx.caching import new_array
from postfx.errors import OptionError
from postfx.frame import Frame, Role
from postfx.interpolate.choose import STILL
from postfx.interpolate.paths import ALIKE
from postfx.kernels.numeric import Real, compiled, inline, uncounted, vectorised
from postfx.system import in_bands

_DROP, _FIELD = 1 << 6, 1 << 15
_PLACES = ((24, 30), (16, 23), (8, 15), (0, 6))
"""First and last bit of hours, minutes, seconds and frames."""
STEADY, MEAN = np.float32(8), np.float32(0.1)
"""How many times as bright light may become in four frames to be the same, and by how much of it a pixel may differ
from the mean of both frames."""
SPARK, SHOWN = np.float32(60), np.float32(32)
"""How many times as bright a spark is as the other frame and what is around it, and from when its light is summed."""
AROUND, DARKER = 0.09, 5
"""How far away what is around a spark is looked for, as a share of the picture's shorter side, and in how many of eight
directions it must be dark."""
SCALES = 0.5, 2.5
"""By how much the light of sparks may be scaled, least and most."""
MOST_RATE = 60
"""Frames a second that a time code can count."""


class Moment(NamedTuple):
    """A frame of the new sequence.

    Attributes:
        number: its frame number.
        start: of the frame before it, or of itself, in the old sequence, from 0.
        t: time since that frame, 0 to 1 (not included); 0 for that frame itself.
        previous: the time of the new frame before, to which its motion leads, counted like t; for t = 0 counted in the
            interval that ends there.
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

    def header(self, metadata: Mapping[str, Any], count: int, first: Mapping[str, Any]) -> dict[str, Any]:
        """Metadata of the new frame with this count from 0, in the place of `metadata`.

        first: metadata of the old sequence's first frame. Without an even rate there is no frame rate and no time code,
        without a known one no time code.
        """
        found = {name: value for name, value in metadata.items() if name not in ("framesPerSecond", "timeCode")}
        rate = self.rate or as_rate(first.get("framesPerSecond"))
        if self.ratio is None or rate is None:
            return found
        found["framesPerSecond"] = float(rate * self.ratio)
        code = first.get("timeCode")
        if code is not None and nominal(rate * self.ratio) <= MOST_RATE:
            frames = math.floor(read_code(code[0], rate) * self.ratio) + count
            found["timeCode"] = (make_code(frames, rate * self.ratio, bool(code[0] & _DROP)), int(code[1]))
        return found


def parse_times(times: str | None, rates: str | None = None) -> Times:
    """Of --times ('2', or '0.25,0.5') and --fps ('24:60', or '24' for the old rate alone).

    Raises OptionError for anything else.
    """
    old, _, new = (rates or "").partition(":")
    rate = _number(old, f"--fps {rates}") if old else None
    if new and times:
        raise OptionError(f"--times {times} and --fps {rates} both say how many frames: give --times with --fps {old}")
    if new and rate:
        ratio = _number(new, f"--fps {rates}") / rate
        if ratio <= 1:
            raise OptionError(f"--fps {rates}: {new} is not above {old}: give a higher one, like 24:60")
        return Times(ratio=ratio, rate=rate)
    text = times or "2"
    if text.isdigit():
        count = int(text)
        if not 2 <= count <= 64:
            raise OptionError(f"--times {text}: give 2 to 64 times as many frames, or times like 0.25,0.5")
        return Times(tuple(Fraction(k, count) for k in range(count)), Fraction(count), rate)
    within = sorted({Fraction(0), *(_number(one, f"--times {text}") for one in text.split(","))})
    if within[-1] >= 1:
        raise OptionError(f"--times {text}: {float(within[-1]):g} is not between two frames: give times below 1")
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
    return Fraction(1000 * whole, 1001) if 5e-4 < whole / rate - 1 < 2e-3 else Fraction(rate).limit_denominator(1001)


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
    """A time code's first word; drop: whether frame numbers are left out to keep up with the clock, as they can be at
    30 and 60 times 1000/1001 frames a second."""
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
    """World to camera (4, 4) at a time between two: turned about one axis, and moved straight. None where there is
    none."""
    if one is None or other is None:
        return None
    try:
        first, last = np.linalg.inv(one), np.linalg.inv(other)
        turn = np.linalg.inv(first[:3, :3]) @ last[:3, :3]
        angle = math.acos(min(max((np.trace(turn) - 1) / 2, -1), 1))
        if not np.allclose(turn @ turn.T, np.eye(3), atol=1e-3) or angle > 3:
            return None
        axis = (turn - turn.T) / (2 * math.sin(angle)) if angle > 1e-9 else np.zeros((3, 3))
        part = np.eye(3) + math.sin(t * angle) * axis + (1 - math.cos(t * angle)) * axis @ axis  # Rodrigues
        camera = first.copy()
        camera[:3, :3] = first[:3, :3] @ part
        camera[3] = (1 - t) * first[3] + t * last[3]
        found: np.ndarray = np.linalg.inv(camera)
    except np.linalg.LinAlgError:
        return None
    return found


def follow_light(frames: Sequence[Frame | None], t: float, picture: np.ndarray) -> None:
    """Lead light through four frames, a frame apart, where nothing moves: at time t between the middle two, in place.

    Lagrange's cubic, within what the middle two show. It is left out where a frame is missing or has no depth or no
    motion, a shot begins, or sizes differ. picture: (h, w, 3) of that time.
    """
    if any(one is None or Role.COLOUR not in one or one[Role.COLOUR].shape != picture.shape or
           Role.DEPTH not in one or (k > 0 and (one.reset or Role.MOTION not in one)) for k, one in enumerate(frames)):
        return
    known = [one for one in frames if one is not None]
    motions, depths = [one[Role.MOTION] for one in known[1:]], [one[Role.DEPTH] for one in known]
    if any(plane.shape[:2] != picture.shape[:2] for plane in (*motions, *depths)) or \
            not (np.abs(motions[1][::8, ::8]).max(-1) < STILL).any():
        return
    shares = (-t * (t - 1) * (t - 2) / 6, (t + 1) * (t - 1) * (t - 2) / 2, -t * (t + 1) * (t - 2) / 2,
              t * (t + 1) * (t - 1) / 6)
    in_bands(len(picture), curve_rows, *(np.ascontiguousarray(one[Role.COLOUR], np.float32) for one in known),
             *(np.ascontiguousarray(plane, np.float32) for plane in (*motions, *depths)),
             tuple(np.float32(share) for share in shares), np.float32(t), picture)


@uncounted
def curve_rows(y0: int, y1: int, earlier: np.ndarray, before: np.ndarray, after: np.ndarray, later: np.ndarray,
               came: np.ndarray, motion: np.ndarray, goes: np.ndarray, far_earlier: np.ndarray, far_before: np.ndarray,
               far_after: np.ndarray, far_later: np.ndarray, shares: tuple[Real, ...], t: Real, picture: np.ndarray
               ) -> None:
    """The same of pixels that show one surface and are the mean of both frames."""
    zero = np.float32(0)
    for y in range(y0, y1):
        for x in range(picture.shape[1]):
            way = max(abs(came[y, x, 0]), abs(came[y, x, 1]))
            way = max(way, max(abs(motion[y, x, 0]), abs(motion[y, x, 1])))
            if not max(way, max(abs(goes[y, x, 0]), abs(goes[y, x, 1]))) < STILL:
                continue
            p, q, r, s = far_earlier[y, x, 0], far_before[y, x, 0], far_after[y, x, 0], far_later[y, x, 0]
            if not max(max(p, q), max(r, s)) - min(min(p, q), min(r, s)) <= ALIKE * q:  # something was in front
                continue
            p, q, r, s, apart = zero, zero, zero, zero, zero
            for c in range(3):
                p, q, r, s = p + earlier[y, x, c], q + before[y, x, c], r + after[y, x, c], s + later[y, x, c]
                apart += abs(picture[y, x, c] - before[y, x, c] - t * (after[y, x, c] - before[y, x, c]))
            low, high = min(min(p, q), min(r, s)), max(max(p, q), max(r, s))
            if not ((high <= STEADY * low) & (apart <= MEAN * low)):
                continue
            for c in range(3):
                one, other = before[y, x, c], after[y, x, c]
                light = shares[0] * earlier[y, x, c] + shares[1] * one + shares[2] * other + shares[3] * later[y, x, c]
                picture[y, x, c] = min(max(light, min(one, other)), max(one, other))


# Sparks: isolated, bright, and gone from where a path leads in the other frame.


def find_sparks(picture: np.ndarray, scale: int, dim: Real, grid: tuple[int, int]) -> np.ndarray:
    """Marks of cells (rows, columns) of a picture (h, w, 3): 3 and 2 where a pixel is SPARK and SHOWN times as bright
    as the dark and as what is around it, and 1 up to two cells beside.

    scale: pixels of a cell. dim: light that counts as dark, summed over channels.
    """
    bright, found = new_array(grid), np.zeros(grid, np.uint8)
    in_bands(grid[0], brightest_rows, picture, scale, bright)
    in_bands(grid[0], mark_sparks, bright, dim, max(1, int(AROUND * min(grid))), found)
    grow_marks(found)
    return found


@vectorised
def sum_of_threes(numbers: np.ndarray, sums: np.ndarray) -> None:
    for x in range(sums.size):
        sums[x] = numbers[3 * x] + numbers[3 * x + 1] + numbers[3 * x + 2]


@vectorised
def largest_of_fours(upper: np.ndarray, lower: np.ndarray, largest: np.ndarray) -> None:
    for x in range(largest.size):
        largest[x] = max(max(upper[2 * x], upper[2 * x + 1]), max(lower[2 * x], lower[2 * x + 1]))


@compiled
def brightest_rows(y0: int, y1: int, picture: np.ndarray, scale: int, bright: np.ndarray) -> None:
    """Light of the brightest pixel of each cell, summed over channels."""
    h, w = picture.shape[:2]
    lines, upper, lower = picture.reshape(h, 3 * w), np.empty(w + 1, np.float32), np.empty(w + 1, np.float32)
    for row in range(y0, y1):
        sum_of_threes(lines[row * scale], upper[:w])
        if scale == 1:
            bright[row] = upper[:w]
            continue
        sum_of_threes(lines[min(row * scale + 1, h - 1)], lower[:w])
        upper[w], lower[w] = upper[w - 1], lower[w - 1]
        largest_of_fours(upper, lower, bright[row])


@inline
def is_isolated(bright: np.ndarray, y: int, x: int, reach: int, slant: int, most: Real) -> bool:
    """Whether in enough of eight directions around a cell there is less light than `most`."""
    h, w = bright.shape
    up, low, left, right = max(y - reach, 0), min(y + reach, h - 1), max(x - reach, 0), min(x + reach, w - 1)
    light = (bright[up, x] >= most) + (bright[low, x] >= most) + (bright[y, left] >= most) + (bright[y, right] >= most)
    if light > 8 - DARKER:
        return False
    up, low, left, right = max(y - slant, 0), min(y + slant, h - 1), max(x - slant, 0), min(x + slant, w - 1)
    light += (bright[up, left] >= most) + (bright[up, right] >= most) + (bright[low, left] >= most)
    return bool(light + (bright[low, right] >= most) <= 8 - DARKER)


@uncounted
def mark_sparks(y0: int, y1: int, bright: np.ndarray, dim: Real, reach: int, found: np.ndarray) -> None:
    """Mark isolated bright cells, by 2 or 3."""
    slant = (7 * reach + 5) // 10
    for y in range(y0, y1):
        for x in range(bright.shape[1]):
            light = bright[y, x]
            if light > SHOWN * dim and is_isolated(bright, y, x, reach, slant, light / SHOWN):
                found[y, x] = 2
                if light > SPARK * dim and is_isolated(bright, y, x, reach, slant, light / SPARK):
                    found[y, x] = 3


@vectorised
def count_marks(row: np.ndarray, least: int) -> int:
    """How many marks of a row are at least this."""
    count = 0
    for x in range(row.size):
        count += row[x] >= least
    return count


@uncounted
def grow_marks(found: np.ndarray) -> None:
    rows, columns = found.shape
    for y in range(rows):
        for x in range(columns if count_marks(found[y], 2) else 0):
            if found[y, x] >= 2:
                for j in range(max(y - 2, 0), min(y + 3, rows)):
                    for i in range(max(x - 2, 0), min(x + 3, columns)):
                        found[j, i] = max(found[j, i], np.uint8(1))


@inline
def light_at(picture: np.ndarray, y: int, x: int) -> Real:
    """Light of a pixel, summed over channels."""
    return picture[y, x, 0] + picture[y, x, 1] + picture[y, x, 2]


@inline
def mark_at(found: np.ndarray, y: Real, x: Real, size: Real) -> int:
    """The mark of the cell at a place; 0 outside. size: cells of a pixel."""
    half = np.float32(0.5)
    v, u = np.float32((np.float32(y) + half) * size), np.float32((np.float32(x) + half) * size)
    if not ((v >= 0) & (u >= 0) & (v < np.float32(found.shape[0])) & (u < np.float32(found.shape[1]))):
        return 0
    return int(found[np.uint32(v), np.uint32(u)])


@inline
def lights_along(before: np.ndarray, after: np.ndarray, y: int, x: int, path: np.ndarray) -> tuple[Real, Real]:
    """Light of the pixels of both frames to which a path (8,) leads; 0 where it leads out of one."""
    half = np.float32(0.5)
    j, i = int(np.floor(y + path[1] + half)), int(np.floor(x + path[0] + half))
    m, n = int(np.floor(y + path[3] + half)), int(np.floor(x + path[2] + half))
    h, w = np.uint64(before.shape[0]), np.uint64(before.shape[1])
    if not ((np.uint64(j) < h) & (np.uint64(i) < w) & (np.uint64(m) < h) & (np.uint64(n) < w)):
        return np.float32(0), np.float32(0)
    return light_at(before, j, i), light_at(after, m, n)


@inline
def mark_along(sparks_before: np.ndarray, sparks_after: np.ndarray, y: Real, x: Real, path: np.ndarray, size: Real
               ) -> int:
    """The higher mark of the cells to which a path leads from the middle (y, x) of one."""
    before, after = (mark_at(sparks_before, y + path[1], x + path[0], size),
                     mark_at(sparks_after, y + path[3], x + path[2], size))
    return int(before if before > after else after)


@uncounted
def settle_sparks(y0: int, y1: int, before: np.ndarray, after: np.ndarray, sparks_before: np.ndarray,
                  sparks_after: np.ndarray, own: np.ndarray, scale: int, dim: Real, is_first: bool, cells: np.ndarray,
                  near: np.ndarray) -> None:
    """Take cells (rows, columns, 8), within a pixel of which only the frame that is farther in time shows a spark, from
    the nearer one alone: also a spark's edge, which a mean would leave as a ring.

    is_first: whether the frame before is the nearer one. near: (rows, columns), is made the mark of the cells to which
    the path leads; else 1 where the cell's own path, by planes, leads to marked ones.
    """
    h, w = before.shape[:2]
    middle, size = np.float32(0.5 * (scale - 1)), np.float32(1 / scale)
    for row in range(y0, y1):
        for column in range(cells.shape[1]):
            path = cells[row, column]
            y, x = scale * row, scale * column
            v, u = np.float32(y) + middle, np.float32(x) + middle
            near[row, column] = mark_along(sparks_before, sparks_after, v, u, path, size)
            if near[row, column] == 0:
                plain = own[row, column]
                if not ((plain[0] == path[0]) & (plain[1] == path[1]) & (plain[2] == path[2]) & (plain[3] == path[3])):
                    near[row, column] = min(mark_along(sparks_before, sparks_after, v, u, plain, size), 1)
                continue
            if path[4] + path[5] < 2:
                continue
            here, there = False, False
            for j in range(max(y - 1, 0), min(y + scale + 1, h)):
                for i in range(max(x - 1, 0), min(x + scale + 1, w)):
                    one, other = lights_along(before, after, j, i, path)
                    if one > SPARK * max(other, dim):
                        here = here or mark_at(sparks_before, j + path[1], i + path[0], size) == 3
                    elif other > SPARK * max(one, dim):
                        there = there or mark_at(sparks_after, j + path[3], i + path[2], size) == 3
            if there > here if is_first else here > there:
                cells[row, column, 4], cells[row, column, 5] = np.float32(is_first), np.float32(not is_first)


def keep_sparks(pictures: Sequence[np.ndarray], sparks: Sequence[np.ndarray], own: np.ndarray, near: np.ndarray,
                scale: int, dim: Real, t: float, picture: np.ndarray) -> None:
    """Give the light of sparks that the picture of a time t (h, w, 3) has lost to those that it shows, in place.

    Fast sparks have no right path: some of them are hidden where a path of what is behind them fits better. What the
    two frames show of them, by time, is what the picture should.

    own: (rows, columns, 8), paths of cells by their planes. sparks: of `find_sparks`, of both frames. near: as
    `settle_sparks` leaves it.
    """
    sums = np.zeros(2)
    sum_sparks(*pictures, *sparks, own, scale, dim, np.float32(t), picture, near, sums)
    if sums[1] > 0:
        factor = np.float32(np.clip(sums[0] / sums[1], *SCALES))
        scale_sparks(*pictures, own, scale, dim, factor, near, picture)


@uncounted
def sum_sparks(before: np.ndarray, after: np.ndarray, sparks_before: np.ndarray, sparks_after: np.ndarray,
               own: np.ndarray, scale: int, dim: Real, t: Real, picture: np.ndarray, near: np.ndarray, sums: np.ndarray
               ) -> None:
    """Light of sparks (2,): of both frames by time, and of the picture."""
    h, w = before.shape[:2]
    one, size = np.float32(1), np.float32(1 / scale)
    for row in range(own.shape[0]):
        for column in range(own.shape[1] if count_marks(near[row], 1) else 0):
            path = own[row, column]
            if near[row, column] == 0 or path[4] + path[5] < 2:
                continue
            for j in range(scale * row, min(scale * row + scale, h)):
                for i in range(scale * column, min(scale * column + scale, w)):
                    p, q = lights_along(before, after, j, i, path)
                    dark, light = min(p, q), light_at(picture, j, i)
                    least = SHOWN * max(dark, dim)
                    if p > least and mark_at(sparks_before, j + path[1], i + path[0], size) >= 2:
                        sums[0] += (one - t) * (p - dark)
                    if q > least and mark_at(sparks_after, j + path[3], i + path[2], size) >= 2:
                        sums[0] += t * (q - dark)
                    if light > least and near[row, column] >= 2:
                        sums[1] += light - dark


@uncounted
def scale_sparks(before: np.ndarray, after: np.ndarray, own: np.ndarray, scale: int, dim: Real, factor: Real,
                 near: np.ndarray, picture: np.ndarray) -> None:
    """Scale what the sparks of a picture add to the darker of both frames."""
    h, w = before.shape[:2]
    for row in range(own.shape[0]):
        for column in range(own.shape[1] if count_marks(near[row], 2) else 0):
            if near[row, column] < 2:
                continue
            for j in range(scale * row, min(scale * row + scale, h)):
                for i in range(scale * column, min(scale * column + scale, w)):
                    p, q = lights_along(before, after, j, i, own[row, column])
                    dark, light = min(p, q), light_at(picture, j, i)
                    if light > SHOWN * max(dark, dim):
                        share = 1 + (factor - 1) * (light - dark) / light
                        for c in range(3):
                            picture[j, i, c] *= share
