"""Sizes, windows and tiles: which pixels of a frame a network works on at once.

A window is a rectangle of the frame at the render's size. A tile is a window and the inner part of
it that is kept; the rest is halo, which the network needs to see. Tiles that lie side by side make
a band, whose rows are put together.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from postfx.runtime import Tensor

PYRAMID_LEVELS = 4
"""Times that the filter pyramid halves its size."""
SIDE_MULTIPLE = 2**PYRAMID_LEVELS
"""Height and width of a network's input are multiples of this if it computes all levels of the
pyramid."""
CELL = 4
"""Side, in render pixels, of the squares that are either active or not."""
HISTORY_REACH_PX = 48
"""Rows above and below a tile's inner part that still leave a history to the next frame, for
networks of filters without guides. Things may move this far from one frame to the next. Later
frames then differ from those of the whole frame by no more than with a history in all rows
(docs/lab/denoiser.md)."""

Rows = tuple[int, int]
"""The first row, and the row after the last."""
Shape = tuple[int, int]
"""Rows and columns."""


class Size(NamedTuple):
    """Height and width in pixels."""

    height: int
    width: int

    def __str__(self) -> str:
        return f"{self.width}x{self.height}"


@dataclass(frozen=True)
class Sizes:
    """The size of a frame as it is rendered and as it leaves the pass.

    Attributes:
        render: of the planes that come in.
        output: of the picture that goes out.
        grid: the first row and column of a window are multiples of this many render pixels.
    """

    render: Size
    output: Size
    grid: int = SIDE_MULTIPLE

    def output_rows(self, rows: Rows) -> Rows:
        """The output rows of a range of render rows."""
        output, render = self.output.height, self.render.height
        return rows[0] * output // render, rows[1] * output // render


class Box(NamedTuple):
    """A rectangle of pixels: first row, first column, number of rows and of columns."""

    top: int
    left: int
    rows: int
    columns: int

    def grown_to(self, side: int) -> Box:
        """The squares of this side, counted from the picture's first pixel, that the box touches.
        The last of them may end beyond the frame."""
        top, left = self.top // side * side, self.left // side * side
        return Box(top, left, whole_steps(self.top + self.rows, side) - top,
                   whole_steps(self.left + self.columns, side) - left)


@dataclass(frozen=True)
class Window:
    """A part of a frame, in render pixels.

    Its first row and column are multiples of the frame's grid, and it may end beyond the frame. A
    window that is smaller than the frame has a size that is a multiple of the grid, or ends where
    the frame ends.
    """

    frame: Sizes
    top: int
    left: int
    rows: int
    columns: int

    @classmethod
    def whole(cls, frame: Sizes) -> Window:
        """The window that is the whole frame."""
        return cls(frame, 0, 0, *frame.render)

    @cached_property
    def out(self) -> Box:
        """The window in output pixels: all that its render pixels touch. Windows of one size have
        equally many."""
        grid, render, output = self.frame.grid, self.frame.render, self.frame.output
        top, rows = _enlarged(self.top, self.rows, render.height, output.height, grid)
        left, columns = _enlarged(self.left, self.columns, render.width, output.width, grid)
        return Box(top, left, rows, columns)

    @property
    def padded_size(self) -> Shape:
        """Rows and columns that the network sees: the next multiples of the grid."""
        return whole_steps(self.rows, self.frame.grid), whole_steps(self.columns, self.frame.grid)

    def level(self, i: int) -> Shape:
        """Size of a pyramid level, whose cells lie where those of the whole frame do. All windows
        of one size have the same, so the last row and column may be empty."""
        (rows, columns), grid = self.padded_size, self.frame.grid
        return (_cells(rows, self.frame.render.height, grid, i),
                _cells(columns, self.frame.render.width, grid, i))

    def area(self, i: int) -> np.ndarray:
        """How many rows and columns of a pyramid level lie in the picture, (2,) float32."""
        ends = (min(self.top + self.rows, self.frame.render.height),
                min(self.left + self.columns, self.frame.render.width))
        firsts = self.top, self.left
        return np.array([-(-end >> i) - (first >> i)
                         for first, end in zip(firsts, ends, strict=True)], np.float32)

    def finer(self, i: int) -> tuple[np.ndarray, np.ndarray]:
        """For each row and column of a pyramid level, the first row or column of the finer level in
        it, which may lie before the window."""
        rows, columns = (2 * np.arange(size, dtype=np.float32) - (first >> i - 1 & 1)
                         for size, first in zip(self.level(i), (self.top, self.left), strict=True))
        return rows, columns

    def coarser(self, i: int) -> tuple[np.ndarray, np.ndarray]:
        """For each row and column of a pyramid level, the row and column of the coarser level that
        contains it."""
        sides = zip(self.level(i), self.level(i + 1), (self.top, self.left), strict=True)
        rows, columns = (np.minimum(np.arange(size) + (first >> i & 1) >> 1, coarse - 1)
                         .astype(np.float32) for size, coarse, first in sides)
        return rows, columns

    def out_rows_of(self, rows: Rows) -> Rows:
        """Output rows of some of the window's rows, counted from its first output row. The last
        ones reach to the window's end."""
        first, last = (at - self.out.top
                       for at in self.frame.output_rows((self.top + rows[0], self.top + rows[1])))
        return first, self.out.rows if rows[1] == self.rows else last

    def place(self, skipped: int = 0) -> np.ndarray:
        """What kernels know of where the window lies, (8,) float32: its first row and column and
        the frame's size, in render pixels, then in output pixels. `skipped`: output rows at the top
        that the kernels leave out."""
        out = self.out
        return np.array([self.top, self.left, *self.frame.render, out.top + skipped, out.left,
                         *self.frame.output], np.float32)

    def places(self) -> dict[str, np.ndarray]:
        """Arrays that describe the window to the kernels, by name; those of a pyramid level end in
        its number."""
        render, output, out = self.frame.render, self.frame.output, self.out
        values: dict[str, Any] = {
            "window": self.place(),
            "part_rows": _counted(self.top, self.rows, render.height),
            "part_columns": _counted(self.left, self.columns, render.width),
            "seen_rows": _mirrored(self.padded_size[0], min(self.rows, render.height - self.top)),
            "seen_columns": _mirrored(self.padded_size[1],
                                      min(self.columns, render.width - self.left)),
            "out_rows": _counted(out.top, out.rows, output.height),
            "out_columns": _counted(out.left, out.columns, output.width)}
        values |= {f"area {i}": self.area(i) for i in range(PYRAMID_LEVELS + 1)}
        for i in range(PYRAMID_LEVELS):
            values[f"coarse_rows {i}"], values[f"coarse_columns {i}"] = self.coarser(i)
            values[f"finer_rows {i + 1}"], values[f"finer_columns {i + 1}"] = self.finer(i + 1)
        values["firsts"] = [values[f"finer_{side} {i}"][0] for side in ("rows", "columns")
                            for i in range(1, PYRAMID_LEVELS + 1)]
        return {name: np.asarray(value, np.float32) for name, value in values.items()}


@dataclass(frozen=True)
class Tile:
    """A window, and the part of the frame that it is worked on for; the rest of it is halo."""

    window: Window
    inner: Box

    @property
    def lasting(self) -> Rows:
        """The window's rows that leave a history to the next frame: see HISTORY_REACH_PX."""
        first, last = (self.inner.top - self.window.top - HISTORY_REACH_PX,
                       self.inner.top + self.inner.rows - self.window.top + HISTORY_REACH_PX)
        return max(0, first // CELL * CELL), min(self.window.rows, whole_steps(last, CELL))


@dataclass(frozen=True)
class Band:
    """Rows of the frame, and the tiles that they are made of."""

    top: int
    rows: int
    tiles: tuple[Tile, ...]

    @property
    def own(self) -> Rows:
        """Its rows in the frame."""
        return self.top, self.top + self.rows

    def over(self, rows: int) -> Band:
        """A band of the same tiles that stands for all `rows` of the frame."""
        return Band(0, rows, self.tiles)

    @property
    def rows_held(self) -> Rows:
        """The frame's rows that its windows hold, halo included."""
        windows = [tile.window for tile in self.tiles]
        last = max(one.top + one.rows for one in windows)
        return min(one.top for one in windows), min(last, windows[0].frame.render.height)

    @property
    def share(self) -> float:
        """Pixels of all windows over pixels of the frame. A pixel in several windows counts several
        times, so this may be above 1."""
        height, width = self.tiles[0].window.frame.render
        return sum(tile.window.rows * tile.window.columns for tile in self.tiles) / (height * width)


def whole_steps(side: int, step: int) -> int:
    """The next multiple of a step."""
    return -(-side // step) * step


def rows_of(tensor: Tensor, rows: Rows) -> Tensor:
    """Some rows of a tensor, along its first axis; no copy."""
    one = math.prod(tensor.shape[1:])
    return tensor.view(tensor.name, (rows[1] - rows[0], *tensor.shape[1:]), rows[0] * one)


def _enlarged(first: int, count: int, size: int, out_size: int, grid: int) -> tuple[int, int]:
    """First output row, and number of output rows, of `count` render rows from `first` on."""
    whole = grid * out_size % size == 0 or count >= size
    return first * out_size // size, -(-count * out_size // size) + (not whole)


def _cells(count: int, size: int, grid: int, i: int) -> int:
    """Rows of a pyramid level that `count` rows of a frame touch at most, wherever they begin."""
    return max(-(-(first + count) >> i) - (first >> i) for first in _firsts(count, size, grid))


def _firsts(count: int, size: int, grid: int) -> range:
    """First rows of windows of `count` rows that lie differently in the cells of the coarsest
    level."""
    return range(0, 1 if count >= size else SIDE_MULTIPLE, grid)


def _counted(first: int, count: int, size: int) -> np.ndarray:
    """`count` indices from `first` on; beyond the side, the last pixel's is repeated."""
    return np.minimum(np.arange(first, first + count), size - 1)


def _mirrored(count: int, held: int) -> np.ndarray:
    """`count` indices from 0 on, mirrored beyond the last of `held` pixels and 0 beyond that."""
    places: np.ndarray = np.maximum(held - 1 - np.abs(np.arange(count) - (held - 1)), 0)
    return places
