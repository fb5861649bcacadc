"""Pixels that are not finite: counted in every plane, and repaired in colour from the neighbours
that are; and fireflies, which are clamped."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Iterator, Mapping

import numpy as np

from postfx.errors import OptionError
from postfx.frame import Frame, Role
from postfx.planes import INFINITY_BITS, WORTH, largest_bits_of
from postfx.system import Scratch

LEAST_KNOWN_SHARE = 0.75
"""Share of a pixel's neighbours that must be finite: repairs one, two or three bad pixels, not the
edge of a sun."""

# Longest side in pixels of a block of bad pixels that is repaired, and the share of finite
# neighbours at its rim.
LONGEST_BLOCK_PX = 4
LEAST_RIM_SHARE = 0.375

MOST_BAD_SHARE = 0.5
"""Share of bad pixels in the colour above which the frame is lost, and bad pixels count as
black."""
_INFINITY = int(INFINITY_BITS)

# Fireflies are told by the pixels so far around them, of which the brightest `FIREFLY_RANK` - 1
# may be fireflies, too.
FIREFLY_REACH_PX = 2
FIREFLY_RANK = 3

NEIGHBOUR_OFFSETS = tuple((y, x) for y in (-1, 0, 1) for x in (-1, 0, 1) if y or x)


def repair_nonfinite(
    frame: Frame, roles: tuple[Role, ...], scratch: Scratch | None = None
) -> tuple[Frame, dict[Role, int]]:
    """The frame with its colour repaired, and role -> number of pixels that are not finite, for
    planes that have any.

    An infinite depth is a miss and does not count. Motion that is NaN is unknown: it does not count
    either, and becomes none, as most that is without vectors stands still. A bad pixel of the
    colour gets the mean of its finite neighbours, if at least 6 of 8 are finite (in proportion at
    the picture's edge). What is left of blocks of up to 4 x 4 pixels is filled from the rim
    inwards. Larger blocks, lines two pixels wide and suns cannot be repaired, as nothing tells what
    they should show: they stay, and passes take NaN for 0 and infinities for the largest light. If
    more than half of the colour is bad, all bad pixels become 0. The given frame does not change.
    `scratch` is the memory budget for looking at planes and copying them.
    """
    found = find_nonfinite({role: frame.planes[role] for role in roles}, scratch)
    if Role.MOTION in found:
        infinite = found.pop(Role.MOTION) & np.isinf(frame[Role.MOTION]).any(axis=2)
        motion = still_where_unknown(frame[Role.MOTION], scratch)
        frame = dataclasses.replace(frame, planes={**frame.planes, Role.MOTION: motion})
        found |= {Role.MOTION: infinite} if infinite.any() else {}
    counts = {role: int(bad.sum()) for role, bad in found.items()}
    if Role.COLOUR not in found:
        return frame, counts
    colour, bad = _copy(frame[Role.COLOUR], scratch), found[Role.COLOUR]
    if is_unusable(frame, counts):
        colour[bad] = 0
    else:
        _fill(colour, bad)
    return dataclasses.replace(frame, planes={**frame.planes, Role.COLOUR: colour}), counts


def still_where_unknown(motion: np.ndarray, scratch: Scratch | None = None) -> np.ndarray:
    """Motion (height, width, 2) with 0 where it is not finite; itself where all of it is."""
    if largest_bits_of(motion) < _INFINITY:
        return motion
    known = _copy(motion, scratch)
    known[_nonfinite(motion, Role.MOTION, scratch)] = 0
    return known


def is_unusable(frame: Frame, counts: dict[Role, int]) -> bool:
    """Whether a frame with these counts is lost: more than half of its colour is not finite."""
    return (Role.COLOUR in counts
            and counts[Role.COLOUR] > MOST_BAD_SHARE * frame[Role.COLOUR][..., 0].size)


def find_nonfinite(planes: Mapping[Role, np.ndarray],
                   scratch: Scratch | None = None) -> dict[Role, np.ndarray]:
    """Role -> (height, width) bool: pixels of planes (height, width, C) that are not finite, for
    planes with any."""
    found = []
    for role, plane in planes.items():
        most = _INFINITY if role is Role.DEPTH else _INFINITY - 1
        if any([largest_bits_of(band) > most
                for band in (_bands(plane, scratch) if scratch else (plane,))]):
            found.append(role)
    return {role: _nonfinite(planes[role], role, scratch) for role in found}


def _nonfinite(plane: np.ndarray, role: Role, scratch: Scratch | None) -> np.ndarray:
    is_bad = np.isnan if role is Role.DEPTH else _is_not_finite
    return np.concatenate([is_bad(band).any(axis=2) for band in _bands(plane, scratch)])


def _is_not_finite(values: np.ndarray) -> np.ndarray:
    bad: np.ndarray = ~np.isfinite(values)
    return bad


def _bands(plane: np.ndarray, scratch: Scratch | None) -> Iterator[np.ndarray]:
    """Rows of a plane, about `WORTH` bytes at a time, which takes less memory than the whole
    picture."""
    rows = max(1, WORTH // max(1, plane[:1].nbytes))
    for first in range(0, plane.shape[0], rows):
        yield plane[first : first + rows]
        if scratch:
            scratch.relax()


def _copy(plane: np.ndarray, scratch: Scratch | None) -> np.ndarray:
    copy = scratch.empty(plane.shape) if scratch else np.empty_like(plane)
    for source, target in zip(_bands(plane, scratch), _bands(copy, None), strict=True):
        target[:] = source
    return copy


def _fill(colour: np.ndarray, bad: np.ndarray) -> None:
    """Repair single bad pixels of the colour, then small blocks from the rim inwards."""
    rows, columns = np.nonzero(bad)
    _fill_some(colour, bad, rows, columns, LEAST_KNOWN_SHARE)
    left = bad.copy()
    left[rows, columns] = ~np.isfinite(colour[rows, columns]).all(axis=1)
    rows, columns = _in_small_blocks(left)
    while rows.size:
        filled = _fill_some(colour, left, rows, columns, LEAST_RIM_SHARE)
        if not filled.any():
            return
        left[rows[filled], columns[filled]] = False
        rows, columns = rows[~filled], columns[~filled]


def _fill_some(colour: np.ndarray, bad: np.ndarray, rows: np.ndarray, columns: np.ndarray,
               share: float) -> np.ndarray:
    """Write the mean of the finite neighbours into these pixels; (count,) whether each had a large
    enough share."""
    height, width = bad.shape
    total, known, there = np.zeros((rows.size, 3)), np.zeros(rows.size), np.zeros(rows.size)
    for down, right in NEIGHBOUR_OFFSETS:
        y, x = rows + down, columns + right
        inside = (y >= 0) & (y < height) & (x >= 0) & (x < width)
        y, x = np.clip(y, 0, height - 1), np.clip(x, 0, width - 1)
        good = inside & ~bad[y, x]
        total += np.where(good[:, None], colour[y, x], 0)
        known, there = known + good, there + inside
    enough: np.ndarray = (known > 0) & (known >= share * there)
    colour[rows[enough], columns[enough]] = total[enough] / known[enough, None]
    return enough


def _in_small_blocks(bad: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rows and columns of bad pixels that have at most `LONGEST_BLOCK_PX` bad ones in a row, across
    and down."""
    rows, columns = np.nonzero(bad)
    for down, right in ((0, 1), (1, 0)):
        run = _run(bad, rows, columns, down, right) + _run(bad, rows, columns, -down, -right) + 1
        rows, columns = rows[run <= LONGEST_BLOCK_PX], columns[run <= LONGEST_BLOCK_PX]
    return rows, columns


def _run(bad: np.ndarray, rows: np.ndarray, columns: np.ndarray, down: int,
         right: int) -> np.ndarray:
    """(count,): bad pixels in a row beside each pixel in one direction, counted up to
    `LONGEST_BLOCK_PX`."""
    height, width = bad.shape
    length, goes_on = np.zeros(rows.size, int), np.ones(rows.size, bool)
    for step in range(1, LONGEST_BLOCK_PX + 1):
        y, x = rows + step * down, columns + step * right
        inside = (y >= 0) & (y < height) & (x >= 0) & (x < width)
        goes_on &= inside & bad[np.clip(y, 0, height - 1), np.clip(x, 0, width - 1)]
        length += goes_on
    return length


@dataclasses.dataclass
class Fireflies:
    """Light that was clamped in a number of frames.

    Attributes:
        pixels, frames: how many had too much light.
        light, taken: sum of all light before, and of what was taken.
    """

    pixels: int = 0
    frames: int = 0
    light: float = 0.0
    taken: float = 0.0

    @property
    def share(self) -> float:
        """Share of the light that was taken, 0 to 1."""
        return self.taken / self.light if self.light > 0 else 0.0

    def as_dict(self) -> dict[str, float]:
        """In plain types."""
        return {"pixels": self.pixels, "frames": self.frames, "light_taken": self.share}

    def __str__(self) -> str:
        pixels, frames = (f"{count} {word}{'s' * (count != 1)}" for count, word in
                          ((self.pixels, "pixel"), (self.frames, "frame")))
        return f"{pixels} in {frames}: {self.share:.2%} of the light was taken"


def parse_limit(limit: float | str | None) -> float | None:
    """How many times as bright as its surroundings a pixel may be, above 1; OptionError for other
    values."""
    if limit is None:
        return None
    try:
        number = float(limit)
    except ValueError:
        number = 0.0
    if not 1 < number < float("inf"):
        raise OptionError(f"--clamp-fireflies {limit}: give a number above 1, such as 8: how many "
                          "times as bright as the pixels around it a pixel may be")
    return number


def clamp_fireflies(frame: Frame, limit: float, count: Fireflies,
                    lights: Iterable[str] = ()) -> None:
    """Darken pixels of the colour that are more than `limit` times as bright as the third brightest
    of the 24 around them, or as the mean of the frame where that is brighter; in the frame itself,
    which `count` counts.

    A pixel's brightness is its largest channel, and its hue stays. Its parts `lights` are darkened
    like it, so that they add up as before. Pixels that are not finite are not looked at, and beyond
    the border lies a mirror.
    """
    colour = frame[Role.COLOUR]
    bright = np.where(np.isfinite(colour), colour, 0).max(axis=2)
    most = limit * np.maximum(_third_brightest(bright),
                              bright.mean(dtype=np.float64).astype(np.float32))
    found = bright > most
    count.light += float(np.where(np.isfinite(colour), colour, 0).sum(dtype=np.float64))
    if not found.any():
        return
    factor = (most[found] / bright[found])[:, None]
    frame.planes[Role.COLOUR] = np.array(colour)
    before = colour[found]
    for plane in (frame.planes[Role.COLOUR], *(frame.parts[name] for name in lights)):
        plane[found] *= factor
    lost = np.where(np.isfinite(before), before - before * factor, 0)
    count.taken += float(lost.sum(dtype=np.float64))
    count.pixels, count.frames = count.pixels + int(found.sum()), count.frames + 1


def _third_brightest(bright: np.ndarray) -> np.ndarray:
    """The third brightest of the pixels around each one, (height, width)."""
    height, width = bright.shape
    wide = np.pad(bright, FIREFLY_REACH_PX, "reflect")
    brightest = [np.zeros_like(bright) for _ in range(FIREFLY_RANK)]
    for down in range(2 * FIREFLY_REACH_PX + 1):
        for right in range(2 * FIREFLY_REACH_PX + 1):
            value = wide[down : down + height, right : right + width]
            if (down, right) == (FIREFLY_REACH_PX, FIREFLY_REACH_PX):
                continue
            for i, held in enumerate(brightest):
                brightest[i], value = np.maximum(held, value), np.minimum(held, value)
    return brightest[-1]
