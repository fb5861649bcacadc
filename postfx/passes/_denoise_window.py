"""The part of a frame that the denoised upscaler's kernels work on, at render and at output size."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from postfx.runtime import Tensor

GRID = 16
"""What a network's input is a multiple of, if it computes all levels of the pyramid."""

Rows = tuple[int, int]
"""The first of some rows, and the one after the last."""


@dataclass(frozen=True)
class Sizes:
    """Render and output size of a frame, and what rows and columns of its windows are multiples of."""

    h: int
    w: int
    height: int
    width: int
    grid: int = GRID

    def enlarged(self, rows: Rows) -> Rows:
        """The output rows of some render rows."""
        return rows[0] * self.height // self.h, rows[1] * self.height // self.h


class Box(NamedTuple):
    """Pixels of a picture: first row and column, and how many there are of each."""

    top: int
    left: int
    rows: int
    columns: int


@dataclass(frozen=True)
class Window:
    """Rows and columns of a frame at render size, the first ones multiples of the frame's grid. It may end beyond the
    frame; where it is less than the frame, its size is a multiple of the grid, too."""

    frame: Sizes
    top: int
    left: int
    rows: int
    columns: int

    @classmethod
    def whole(cls, frame: Sizes) -> Window:
        return cls(frame, 0, 0, frame.h, frame.w)

    @cached_property
    def out(self) -> Box:
        """The same at output size: all pixels that the render pixels touch; as many for all windows of one size."""
        frame, grid = self.frame, self.frame.grid
        top, rows = _enlarged(self.top, self.rows, frame.h, frame.height, grid)
        left, columns = _enlarged(self.left, self.columns, frame.w, frame.width, grid)
        return Box(top, left, rows, columns)

    @property
    def padded(self) -> tuple[int, int]:
        """Rows and columns that the network sees: the next multiples of the grid."""
        return whole_steps(self.rows, self.frame.grid), whole_steps(self.columns, self.frame.grid)

    def level(self, i: int) -> tuple[int, int]:
        """Size of a pyramid level, whose cells lie where those of the whole frame do; the same for all windows of one
        size, the last row and column may hold nothing."""
        frame = self.frame
        return tuple(max(-(-(first + count) >> i) - (first >> i) for first in _firsts(count, size, frame.grid))
                     for count, size in zip(self.padded, (frame.h, frame.w), strict=True))

    def area(self, i: int) -> np.ndarray:
        """Rows and columns of a pyramid level that hold picture."""
        ends = min(self.top + self.rows, self.frame.h), min(self.left + self.columns, self.frame.w)
        firsts = self.top, self.left
        return np.array([-(-end >> i) - (first >> i) for first, end in zip(firsts, ends, strict=True)], np.float32)

    def finer(self, i: int) -> tuple[np.ndarray, np.ndarray]:
        """For each row and column of a pyramid level the first one of the finer level that it is made of; it may lie
        before the window."""
        return tuple(2 * np.arange(size, dtype=np.float32) - (first >> i - 1 & 1)
                     for size, first in zip(self.level(i), (self.top, self.left), strict=True))

    def coarser(self, i: int) -> tuple[np.ndarray, np.ndarray]:
        """For each row and column of a pyramid level that of the coarser level in which it lies."""
        sides = zip(self.level(i), self.level(i + 1), (self.top, self.left), strict=True)
        return tuple(np.minimum(np.arange(size) + (first >> i & 1) >> 1, coarse - 1).astype(np.float32)
                     for size, coarse, first in sides)

    def places(self) -> dict[str, np.ndarray]:
        """What tells the kernels of the window, by their bindings' names."""
        frame, out = self.frame, self.out
        values = {
            "window": [self.top, self.left, frame.h, frame.w, out.top, out.left, frame.height, frame.width],
            "part_rows": _counted(self.top, self.rows, frame.h),
            "part_columns": _counted(self.left, self.columns, frame.w),
            "seen_rows": _mirrored(self.padded[0], min(self.rows, frame.h - self.top)),
            "seen_columns": _mirrored(self.padded[1], min(self.columns, frame.w - self.left)),
            "out_rows": _counted(out.top, out.rows, frame.height),
            "out_columns": _counted(out.left, out.columns, frame.width)}
        return {name: np.asarray(value, np.float32) for name, value in values.items()}


def whole_steps(side: int, step: int) -> int:
    """The next multiple of a step."""
    return -(-side // step) * step


def rows_of(tensor: Tensor, rows: Rows) -> Tensor:
    """Some rows of a tensor, along its first axis; no copy."""
    one = math.prod(tensor.shape[1:])
    return tensor.view(tensor.name, (rows[1] - rows[0], *tensor.shape[1:]), rows[0] * one)


def _enlarged(first: int, count: int, size: int, out_size: int, grid: int) -> tuple[int, int]:
    whole = grid * out_size % size == 0 or count >= size
    return first * out_size // size, -(-count * out_size // size) + (not whole)


def _firsts(count: int, size: int, grid: int) -> range:
    """First rows of windows of so many rows, as far as cells of the coarsest level tell them apart."""
    return range(0, 1 if count >= size else GRID, grid)


def _counted(first: int, count: int, size: int) -> np.ndarray:
    """Numbers from `first` on, the last pixel's of a side repeated."""
    return np.minimum(np.arange(first, first + count), size - 1)


def _mirrored(count: int, held: int) -> np.ndarray:
    """Numbers that go on beyond those of a side as in a mirror, and stop at its start."""
    return np.maximum(held - 1 - np.abs(np.arange(count) - (held - 1)), 0)
