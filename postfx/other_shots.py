"""Renders that show different pictures, though they are given as renders of one frame.

Two renders of a frame differ by their noise. So the mean light of a square of pixels differs by a
few of its standard errors, which the light's variance within both squares tells. Texture and
fireflies make these larger, so they hide a difference rather than feign one. In thirteen kinds of
content at 4 samples a pixel at most 1.4 % of the squares differ so much between two seeds, also
where a pixel filter of a whole pixel ties neighbours together; between two shots, 20 % and more.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from postfx.colour import luminance

SIDE_PX = 16
"""Side of a square."""
FEWEST_SQUARES = 12
"""With fewer squares that both renders have, nothing is told."""
DIFFERENT_ERRORS = 8.0
"""Standard errors by which light of two squares differs, at least, if they show something else."""
DIFFERENT_SHARE = 0.15
"""Share of the larger one's light by which it does, at least."""
OTHER_PICTURE = 0.15
"""Share of the squares that differ, from which on the picture is another one."""


class Squares(NamedTuple):
    """Light of a picture's squares, (rows, columns) each.

    Attributes:
        mean: mean luminance, NaN where pixels are not known or not finite.
        error: the squared standard error of the mean.
    """

    mean: np.ndarray
    error: np.ndarray


def squares_of(colour: np.ndarray, known: np.ndarray | None = None) -> Squares:
    """Light of the squares of a picture (height, width, 3), linear; `known`: (height, width), which
    of its pixels were rendered, None for all."""
    light = luminance(np.asarray(colour, np.float32)).astype(np.float64)
    light[~np.isfinite(light)] = np.nan
    if known is not None:
        light[~known] = np.nan
    rows, columns = light.shape[0] // SIDE_PX, light.shape[1] // SIDE_PX
    cut = light[: rows * SIDE_PX, : columns * SIDE_PX]
    parts = cut.reshape(rows, SIDE_PX, columns, SIDE_PX).swapaxes(1, 2)
    each = parts.reshape(rows, columns, SIDE_PX**2)
    return Squares(each.mean(axis=-1), each.var(axis=-1) / SIDE_PX**2)


def is_other_picture(first: Squares, second: Squares) -> bool:
    """Whether two renders of one size show different pictures, by more than their noise."""
    largest = np.maximum(np.abs(first.mean), np.abs(second.mean))
    both = largest > 0  # False for NaN
    if both.sum() < FEWEST_SQUARES:
        return False
    difference = np.abs(first.mean - second.mean)
    differ = ((difference > DIFFERENT_ERRORS * np.sqrt(first.error + second.error))
              & (difference > DIFFERENT_SHARE * largest))
    return bool(differ[both].mean() > OTHER_PICTURE)
