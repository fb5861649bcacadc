"""Pictures in bands of rows, so that what is worked out of them takes little memory; and what spreads over them."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

BAND = 128
"""Rows of a band, whole squares of those in which noise is measured."""


def bands(height: int, reach: int) -> Iterator[tuple[int, int, int, int]]:
    """First and last row of bands, and the same with as many rows around them as are there."""
    for first in range(0, height, BAND):
        last = min(height, first + BAND)
        yield first, last, max(0, first - reach), min(height, last + reach)


def spread(plane: np.ndarray, radius: int) -> np.ndarray:
    """Largest value within a square of (2 radius + 1)^2 pixels: (height, width) -> the same; borders are repeated."""
    return _over_squares(np.maximum, plane, radius)


def sum_near(plane: np.ndarray, radius: int) -> np.ndarray:
    """Sum over such a square, not by running sums, in which the rounding of one huge value reaches along its row."""
    return _over_squares(np.add, plane, radius)


def _over_squares(operation: np.ufunc, plane: np.ndarray, radius: int) -> np.ndarray:
    height, width = plane.shape
    padded, shifts = np.pad(plane, radius, mode="edge"), range(2 * radius + 1)
    rows = operation.reduce([padded[shift:shift + height] for shift in shifts])
    return operation.reduce([rows[:, shift:shift + width] for shift in shifts])
