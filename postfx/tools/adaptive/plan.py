"""How many more samples the tiles of a shot need until its denoised frames are good enough.

The expected squared error of a denoised pixel falls with its samples as n ** -SLOPE, more slowly
than noise, as the denoiser has removed most of the noise already. A tile needs samples until its
error is at the quality that is asked for. A budget that does not suffice for that goes where it
lowers the error of the shot most: the sum of the errors e n^a (n + m)^-a over tiles is least, for a
given sum of m, where all tiles with more samples have the same gain of a further one, so n + m is
proportional to (e n^a)^(1 / (1 + a)). A quality in FLIP sums that in place of squared errors:
within a scene FLIP goes with a power of them, and so do both e and n^-a.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from postfx.errors import OptionError

SLOPE = 0.5
"""By which power of its samples the squared error of a denoised tile falls, see
docs/howto/render_more.md."""
MOST_SAMPLES_FACTOR = 8
"""How many times its samples a tile gets at most in one round: predictions further on say
little."""
FEWEST_SAMPLES = 4
"""Samples below which a render of a tile does not pay."""
QUALITY_DECIBELS = {"draft": 30.0, "visible": 36.0, "fine": 42.0}
"""Word -> PSNR of the displayed picture in dB, which each tile is to reach."""
FLIP_POWER = 0.4
"""By which power of squared errors FLIP goes, over tiles and with more samples: see
docs/lab/render_more.md."""
FLIP_AT = {30.0: 0.086, 36.0: 0.052, 42.0: 0.031}
"""PSNR of a denoised tile -> its mean FLIP, to which 'flip=' refers."""


@dataclass(frozen=True)
class Quality:
    """The error that is good enough: a squared error of display code values, and the words that
    asked for it.

    power: of squared errors whose sum a budget makes least.
    """

    words: str
    error: float
    power: float = 1.0

    @property
    def psnr(self) -> float:
        """The error as PSNR in dB."""
        return psnr(self.error)


def psnr(error: float) -> float:
    """PSNR in dB of a mean squared error of code values 0..1."""
    return float(-10 * np.log10(max(error, 1e-12)))


def parse_quality(text: str) -> Quality:
    """Quality of 'visible', '38dB' or 'flip=0.05'. Raises OptionError for anything else."""
    found = re.fullmatch(r"(?:(\d+(?:\.\d+)?) ?db|flip=(0?\.\d+))", text.lower())
    if text.lower() in QUALITY_DECIBELS:
        level = QUALITY_DECIBELS[text.lower()]
    elif found and found[1] and 10 <= float(found[1]) <= 80:
        level = float(found[1])
    elif found and found[2] and float(found[2]) > 0:
        places = np.log([*reversed(FLIP_AT.values())])
        slope = (max(FLIP_AT) - min(FLIP_AT)) / (places[0] - places[-1])
        level = float(max(FLIP_AT) + slope * (np.log(float(found[2])) - places[0]))
    else:
        raise OptionError(f"--quality {text}: give {', '.join(QUALITY_DECIBELS)}, a PSNR like "
                          "38dB, or a FLIP like flip=0.05")
    return Quality(text.lower(), 10 ** (-level / 10),
                   FLIP_POWER if text.lower().startswith("flip") else 1.0)


@dataclass(frozen=True)
class Tiles:
    """What is known of the tiles of one frame; arrays (rows, columns).

    Attributes:
        number: of the frame.
        size: width and height of the frame.
        side: of a tile, in pixels; those at the right and the bottom may be smaller.
        errors: mean squared error of the pixels that count, in code values.
        samples: mean samples a pixel.
        counted: how many pixels count, 0 where all are masked.
        seconds: that the frame took to render, None if that is not known.
    """

    number: int
    size: tuple[int, int]
    side: int
    errors: np.ndarray
    samples: np.ndarray
    counted: np.ndarray
    seconds: float | None = None

    @property
    def areas(self) -> np.ndarray:
        """Pixels of each tile."""
        width, height = self.size
        columns, rows = (np.minimum(self.side, length - np.arange(0, length, self.side))
                         for length in (width, height))
        return rows[:, None] * columns[None, :]

    def error_with(self, more: np.ndarray | float) -> np.ndarray:
        """Expected squared error of the tiles with more samples."""
        return np.asarray(self.errors * (self.samples / (self.samples + more)) ** SLOPE)

    def needed(self, error: float) -> np.ndarray:
        """More samples until each tile has this error, at most `MOST_SAMPLES_FACTOR` times as many
        as it has."""
        factor = (np.maximum(self.errors, 0) / error) ** (1 / SLOPE) - 1
        return np.asarray(np.where(self.counted > 0,
                                   np.clip(factor, 0, MOST_SAMPLES_FACTOR) * self.samples, 0))


def make_tiles(number: int, error: np.ndarray, samples: np.ndarray | float,
               strength: np.ndarray | None, side: int, seconds: float | None = None) -> Tiles:
    """Tiles of a frame from planes (height, width); strength: 0 where pixels do not count, 1 where
    they do."""
    counts = np.ones_like(error) if strength is None else (strength > 0).astype(np.float32)
    finite = np.isfinite(error)
    weights = counts * finite
    counted = tile_sums(counts, side)
    mean = tile_sums(np.where(finite, error, 0) * weights,
                     side) / np.maximum(tile_sums(weights, side), 1)
    held = np.broadcast_to(np.asarray(samples, np.float64), error.shape)
    each = tile_sums(held, side) / tile_sums(np.ones_like(error), side)
    return Tiles(number, (error.shape[1], error.shape[0]), side, mean, np.maximum(each, 1), counted,
                 seconds)


def tile_sums(plane: np.ndarray, side: int) -> np.ndarray:
    """Sums over tiles of a plane (height, width), those at the end smaller."""
    rows = np.add.reduceat(plane.astype(np.float64), np.arange(0, plane.shape[0], side), axis=0)
    return np.asarray(np.add.reduceat(rows, np.arange(0, plane.shape[1], side), axis=1))


def tile_means(plane: np.ndarray, side: int) -> np.ndarray:
    """Means over tiles of a plane (height, width, channels) and of its channels."""
    mean: np.ndarray = tile_sums(plane.mean(axis=2), side) / tile_sums(np.ones(plane.shape[:2]),
                                                                       side)
    return mean


def plan_samples(shot: Sequence[Tiles], quality: Quality,
                 budget: float | None = None) -> list[np.ndarray]:
    """More samples a pixel for the tiles of each frame: powers of two, 0 for tiles that are done.

    budget: mean of more samples a pixel over the shot that is not exceeded; None for as many as the
    quality needs.
    """
    needed = [tiles.needed(quality.error) for tiles in shot]
    exact = [in_steps(more, up=True) for more in needed]
    if budget is None or _mean(shot, exact) <= budget:
        return exact

    def share(level: float) -> list[np.ndarray]:
        found = []
        for tiles, most in zip(shot, needed, strict=True):
            slope = SLOPE * quality.power
            weight = np.maximum(tiles.errors, 0) ** quality.power * tiles.counted / tiles.areas
            wanted = level * (weight * tiles.samples**slope) ** (1 / (1 + slope)) - tiles.samples
            found.append(in_steps(np.clip(wanted, 0, most), up=False))
        return found

    return share(_search(lambda level: _mean(shot, share(level)) <= budget, 0.0, 1e9))


def in_steps(more: np.ndarray, up: bool) -> np.ndarray:
    """Numbers of samples as powers of two, the next one up or down; fewer than `FEWEST_SAMPLES` are
    that many or none."""
    exponents = np.log2(np.maximum(more, 1e-9))
    steps = 2.0 ** (np.ceil(exponents - 1e-9) if up else np.floor(exponents + 1e-9))
    return np.where(more < (FEWEST_SAMPLES / 2 if up else FEWEST_SAMPLES), 0,
                    np.maximum(steps, FEWEST_SAMPLES))


@dataclass(frozen=True)
class Outlook:
    """What a plan costs and gives, over a shot.

    Attributes:
        now, after: mean squared error of the pixels that count.
        more: mean of more samples a pixel.
        uniform: more samples everywhere that would give the same mean error.
        hours, uniform_hours: of rendering both, None where the time of the renders is not known.
        done: share of tiles that have the quality, with the plan carried out.
    """

    now: float
    after: float
    more: float
    uniform: float
    hours: float | None
    uniform_hours: float | None
    done: float


def look_ahead(shot: Sequence[Tiles], plan: Sequence[np.ndarray], quality: Quality) -> Outlook:
    """What a plan costs and gives, if the errors are as predicted."""
    after = _error(shot, plan)
    uniform = _search(lambda more: _error(shot, [np.float64(more)] * len(shot)) >= after, 0.0, 1e6)
    reached = [tiles.error_with(more) <= quality.error * 1.001
               for tiles, more in zip(shot, plan, strict=True)]
    counted = [tiles.counted > 0 for tiles in shot]
    tiles = sum(int(one.sum()) for one in counted)
    done = sum(int((ok & one).sum())
               for ok, one in zip(reached, counted, strict=True)) / max(tiles, 1)
    known = [one.seconds for one in shot if one.seconds]
    rate = None
    if len(known) == len(shot) and known:
        rate = sum(known) / 3600 / sum(float((one.samples * one.areas).sum()) for one in shot)
    pixels = sum(int(one.areas.sum()) for one in shot)
    more = _mean(shot, plan)
    return Outlook(_error(shot, [np.float64(0)] * len(shot)), after, more, uniform,
                   None if rate is None else rate * more * pixels,
                   None if rate is None else rate * uniform * pixels, done)


@dataclass(frozen=True)
class Region:
    """A rectangle of a frame to render again, in pixels from the top left, and its samples a
    pixel."""

    x: int
    y: int
    width: int
    height: int
    samples: int


def find_regions(tiles: Tiles, more: np.ndarray) -> list[Region]:
    """Rectangles of tiles that get the same samples: as wide as they go, then as high."""
    width, height = tiles.size
    left, found = more.copy(), []
    for row, column in np.argwhere(more > 0):
        value = left[row, column]
        if not value:
            continue
        last = column + 1
        while last < more.shape[1] and left[row, last] == value:
            last += 1
        below = row + 1
        while below < more.shape[0] and (left[below, column:last] == value).all():
            below += 1
        left[row:below, column:last] = 0
        x, y = int(column) * tiles.side, int(row) * tiles.side
        found.append(Region(x, y, min(int(last) * tiles.side, width) - x,
                            min(int(below) * tiles.side, height) - y, int(value)))
    return found


def spread(tiles: Tiles, values: np.ndarray) -> np.ndarray:
    """Values of tiles for each pixel (height, width), float32."""
    width, height = tiles.size
    whole = values.astype(np.float32).repeat(tiles.side, axis=0).repeat(tiles.side, axis=1)
    return np.ascontiguousarray(whole[:height, :width])


def _mean(shot: Sequence[Tiles], plan: Sequence[np.ndarray]) -> float:
    """Mean of more samples a pixel."""
    pixels = sum(int(tiles.areas.sum()) for tiles in shot)
    return sum(float((more * tiles.areas).sum())
               for tiles, more in zip(shot, plan, strict=True)) / pixels


def _error(shot: Sequence[Tiles], plan: Sequence[np.ndarray | np.float64]) -> float:
    """Mean squared error of the pixels that count."""
    pixels = sum(float(tiles.counted.sum()) for tiles in shot)
    total = sum(float((tiles.error_with(more) * tiles.counted).sum())
                for tiles, more in zip(shot, plan, strict=True))
    return total / max(pixels, 1)


def _search(is_below: Callable[[float], bool], low: float, high: float) -> float:
    """The largest number for which a condition that fails from some number on holds."""
    for _ in range(80):
        middle = (low + high) / 2
        low, high = (middle, high) if is_below(middle) else (low, middle)
    return low
