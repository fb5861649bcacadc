"""Code values as whole numbers: plain, or dithered by blue noise, so that 8 bits show no bands."""

from __future__ import annotations

from enum import StrEnum
from functools import cache
from typing import Never

import numpy as np

from postfx.errors import WriteError, offer
from postfx.io.pixel_formats import dither_rows

NOISE_SIDE_PX = 64
"""Of the square of blue noise, in pixels."""
NEIGHBOURHOOD_PX = 1.5
"""Standard deviation of the weights around a place."""
TURN_SHIFT = np.array([0.7548776662466927, 0.5698402909980532])
"""A shift, in squares, that comes back late: Roberts 2018, R2."""


class Dither(StrEnum):
    """Pattern of the dither: another one each frame, the same for all frames, or no dither."""

    MOVING = "moving"
    STATIC = "static"
    NONE = "none"

    @classmethod
    def _missing_(cls, value: object) -> Never:
        """WriteError for a word that is no pattern."""
        raise WriteError(f"dither '{value}'{offer(value, cls, 'give')}")


def quantise(
    codes: np.ndarray, bits: int, dither: Dither, number: int = 1, first_row: int = 0
) -> np.ndarray:
    """Code values (height, width, channels) to whole numbers of 8 or 16 bits; cut to 0..1, NaN
    becomes 0.

    Dithered, a value between two whole numbers becomes one of them, the larger the more often the
    nearer it is: the error stays below 1, and over each 64x64 pixels of a flat area the mean is
    kept to 1/8192. The pattern depends on the pixel, the channel and, if it moves, on the frame's
    number; `first_row` is the place of the first row. 16 bits are not dithered.
    """
    top = np.float32(2**bits - 1)
    if bits != 8 or dither is Dither.NONE:
        rounded: np.ndarray = np.rint(np.clip(np.nan_to_num(codes), 0, 1) * top)
        return rounded.astype(np.uint8 if bits == 8 else np.uint16)
    height, width, channels = codes.shape
    turns = (
        range(0, channels) if dither is Dither.STATIC else range(3 * number, 3 * number + channels)
    )
    whole = np.empty((height, width * channels), np.uint8)
    flat = np.ascontiguousarray(codes, np.float32).reshape(whole.shape)
    dither_rows(
        flat,
        top,
        np.stack([_thresholds(first_row, turn) for turn in turns], 2).reshape(NOISE_SIDE_PX, -1),
        whole,
    )
    return whole.reshape(codes.shape)


def _thresholds(first_row: int, turn: int) -> np.ndarray:
    """Blue noise (64, 64) with another pixel first in each turn."""
    down, right = (turn * TURN_SHIFT % 1 * NOISE_SIDE_PX).astype(int)
    return np.roll(blue_noise(), (-down - first_row, -right), (0, 1))


@cache
def blue_noise(side: int = NOISE_SIDE_PX) -> np.ndarray:
    """Thresholds (side, side) float32, each of (0.5 .. side^2 - 0.5) / side^2 once, repeating
    without a seam.

    Source: Ulichney, "The void-and-cluster method for dither array generation", 1993.
    """
    weight, taken = _neighbourhood(side), np.zeros((side, side), bool)
    energy = np.random.default_rng(0).uniform(0, 1e-6, (side, side))  # breaks ties
    first = _scatter(taken, energy, weight)
    ranks = np.empty((side, side))
    started = taken.copy(), energy.copy()
    for rank in reversed(range(first)):
        ranks[_put(np.argmax(np.where(taken, energy, -np.inf)), taken, energy, weight)] = rank
    taken, energy = started
    for rank in range(first, side * side):
        ranks[_put(np.argmin(np.where(taken, np.inf, energy)), taken, energy, weight)] = rank
    return ((ranks + 0.5) / side**2).astype(np.float32)


def _scatter(taken: np.ndarray, energy: np.ndarray, weight: np.ndarray) -> int:
    """Take a tenth of the places, as far from each other as they go; returns how many."""
    count = taken.size // 10
    for _ in range(count):
        _put(np.argmin(np.where(taken, np.inf, energy)), taken, energy, weight)
    while True:
        removed = _put(np.argmax(np.where(taken, energy, -np.inf)), taken, energy, weight)
        if removed == _put(np.argmin(np.where(taken, np.inf, energy)), taken, energy, weight):
            return count


def _put(at: np.intp, taken: np.ndarray, energy: np.ndarray, weight: np.ndarray) -> tuple[int, int]:
    """Take a free place, or give a taken one back; returns its row and column."""
    side = len(taken)
    y, x = divmod(int(at), side)
    energy += (-1 if taken[y, x] else 1) * weight[side - y : 2 * side - y, side - x : 2 * side - x]
    taken[y, x] = not taken[y, x]
    return y, x


def _neighbourhood(side: int) -> np.ndarray:
    """How near places are to the one at (side, side), on a torus; (2 * side, 2 * side)."""
    distance = np.minimum(np.arange(2 * side) % side, -np.arange(2 * side) % side)
    near = np.exp(-(distance**2) / (2 * NEIGHBOURHOOD_PX**2))
    return near[:, None] * near
