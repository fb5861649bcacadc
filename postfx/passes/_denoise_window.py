"""The part of a frame that the denoised upscaler's kernels work on, at render and at output size."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from postfx.runtime import Tensor

ALIGN = 16

Rows = tuple[int, int]
"""The first of some rows, and the one after the last."""


@dataclass(frozen=True)
class Sizes:
    """Render and output size of a frame."""

    h: int
    w: int
    height: int
    width: int

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
    """Rows and columns of a frame at render size, the first ones multiples of 16. It may end beyond the frame; where it
    is less than the frame, its size is a multiple of 16, too."""

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
        top, rows = _enlarged(self.top, self.rows, self.frame.h, self.frame.height)
        left, columns = _enlarged(self.left, self.columns, self.frame.w, self.frame.width)
        return Box(top, left, rows, columns)

    @property
    def padded(self) -> tuple[int, int]:
        """Rows and columns that the network sees: the next multiples of 16."""
        return -(-self.rows // ALIGN) * ALIGN, -(-self.columns // ALIGN) * ALIGN

    def level(self, i: int) -> tuple[int, int]:
        """Size of a pyramid level."""
        return self.padded[0] >> i, self.padded[1] >> i

    def area(self, i: int) -> np.ndarray:
        """Rows and columns of a pyramid level that hold picture."""
        held = min(self.rows, self.frame.h - self.top), min(self.columns, self.frame.w - self.left)
        return np.array([-(-side // 2**i) for side in held], np.float32)

    def places(self) -> dict[str, np.ndarray]:
        """What tells the kernels of the window, by their bindings' names."""
        frame, out = self.frame, self.out
        values = {
            "window": [self.top, self.left, frame.h, frame.w, out.top, out.left, frame.height, frame.width],
            "part_rows": _counted(self.top, self.rows, frame.h),
            "part_columns": _counted(self.left, self.columns, frame.w),
            "out_rows": _counted(out.top, out.rows, frame.height),
            "out_columns": _counted(out.left, out.columns, frame.width)}
        return {name: np.asarray(value, np.float32) for name, value in values.items()}


def rows_of(tensor: Tensor, rows: Rows) -> Tensor:
    """Some rows of a tensor, along its first axis; no copy."""
    one = math.prod(tensor.shape[1:])
    return tensor.view(tensor.name, (rows[1] - rows[0], *tensor.shape[1:]), rows[0] * one)


def _enlarged(first: int, count: int, size: int, out_size: int) -> tuple[int, int]:
    whole = ALIGN * out_size % size == 0 or count >= size
    return first * out_size // size, -(-count * out_size // size) + (not whole)


def _counted(first: int, count: int, size: int) -> np.ndarray:
    """Numbers from `first` on, the last pixel's of a side repeated."""
    return np.minimum(np.arange(first, first + count), size - 1)
