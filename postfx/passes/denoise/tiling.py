"""Windows of a frame for the networks: around active pixels, or in tiles within a memory budget."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from typing import NamedTuple

import numpy as np

from postfx.errors import MemoryBudgetError
from postfx.kernels.image import mark_positive
from postfx.runtime import Tensor
from postfx.system import PROCESS, Scratch

LEVELS = 4
"""Times that the filter pyramid halves its size."""
GRID = 2**LEVELS
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
        frame, (rows, columns) = self.frame, self.padded
        return _cells(rows, frame.h, frame.grid, i), _cells(columns, frame.w, frame.grid, i)

    def area(self, i: int) -> np.ndarray:
        """Rows and columns of a pyramid level that hold picture."""
        ends = min(self.top + self.rows, self.frame.h), min(self.left + self.columns, self.frame.w)
        firsts = self.top, self.left
        return np.array([-(-end >> i) - (first >> i) for first, end in zip(firsts, ends, strict=True)], np.float32)

    def finer(self, i: int) -> tuple[np.ndarray, np.ndarray]:
        """For each row and column of a pyramid level the first one of the finer level that it is made of; it may lie
        before the window."""
        rows, columns = (2 * np.arange(size, dtype=np.float32) - (first >> i - 1 & 1)
                         for size, first in zip(self.level(i), (self.top, self.left), strict=True))
        return rows, columns

    def coarser(self, i: int) -> tuple[np.ndarray, np.ndarray]:
        """For each row and column of a pyramid level, the row and column of the coarser level that contains it."""
        sides = zip(self.level(i), self.level(i + 1), (self.top, self.left), strict=True)
        rows, columns = (np.minimum(np.arange(size) + (first >> i & 1) >> 1, coarse - 1).astype(np.float32)
                         for size, coarse, first in sides)
        return rows, columns

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


def _cells(count: int, size: int, grid: int, i: int) -> int:
    """Rows of a pyramid level that so many rows of a frame touch, wherever they begin."""
    return max(-(-(first + count) >> i) - (first >> i) for first in _firsts(count, size, grid))


def _firsts(count: int, size: int, grid: int) -> range:
    """First rows of windows of so many rows, as far as cells of the coarsest level tell them apart."""
    return range(0, 1 if count >= size else GRID, grid)


def _counted(first: int, count: int, size: int) -> np.ndarray:
    """Numbers from `first` on, the last pixel's of a side repeated."""
    return np.minimum(np.arange(first, first + count), size - 1)


def _mirrored(count: int, held: int) -> np.ndarray:
    """Indices that continue beyond a side as in a mirror, and stop at its start."""
    places: np.ndarray = np.maximum(held - 1 - np.abs(np.arange(count) - (held - 1)), 0)
    return places


HALOS, GUIDED_HALO = {"s": 72, "m": 44, "l": 48}, 104
"""Render pixels around what is active that a network must see, so that the result there differs by less than 1e-3 from
that of the whole frame: by size, the largest for others, and of models that read guides. docs/denoiser.md has measured
differences."""

REACH = 2
"""Render pixels that a pixel's strength reaches when it is resampled."""

CELL = 2 * REACH
"""Render pixels along a side of the squares that are active or not."""
COARSE = 4
"""Such squares along a side of those by which boxes are searched."""

FIXED = 10000
"""Render pixels whose time a window takes beyond that of its own, at least. samples/window_cost.py measures 11200 for
model m at 960x540 (7 ms), 23500 for s, and 27500 for m at 1920x1080, where it matters less."""

MOST_BOXES = 6
GAIN = 0.9
"""Windows must be expected to take at most this share of the whole frame's time: a frame with windows takes 7 % of it
more with m and 11 % with s, measured likewise, for what is done everywhere."""


@dataclass(frozen=True)
class Tile:
    """A window, and the rows and columns of the frame that it is for; the rest of it is halo."""

    window: Window
    inner: Box


@dataclass(frozen=True)
class Band:
    """Rows of the frame, and the tiles that they are made of."""

    top: int
    rows: int
    tiles: tuple[Tile, ...]

    @property
    def own(self) -> Rows:
        """Its rows."""
        return self.top, self.top + self.rows

    @property
    def held(self) -> Rows:
        """The rows of the frame that its windows hold, halo included."""
        windows = [tile.window for tile in self.tiles]
        return min(one.top for one in windows), min(max(one.top + one.rows for one in windows), windows[0].frame.h)

    @property
    def share(self) -> float:
        """Of the frame's pixels that are in windows, counted as often as they are."""
        frame = self.tiles[0].window.frame
        return sum(tile.window.rows * tile.window.columns for tile in self.tiles) / (frame.h * frame.w)


Shape = tuple[int, int]


def active_cells(strength: np.ndarray) -> np.ndarray:
    """Which squares of 4 pixels have an effect: (h, w, 1) -> (rows, columns) of bool."""
    mask = np.zeros([whole_steps(side, CELL) // REACH for side in strength.shape[:2]], bool)
    mark_positive(strength, REACH, mask)
    for _ in range(2):
        halves = np.pad(mask, ((1, 1), (0, 0)))
        mask = np.logical_or.reduce([halves[i:len(mask) + i:2] for i in range(4)]).T
    return mask


def _grouped(mask: np.ndarray, step: int) -> np.ndarray:
    """Whether any of so many rows of a mask holds."""
    padded = np.pad(mask, ((0, -len(mask) % step), (0, 0)))
    groups: np.ndarray = np.logical_or.reduce([padded[i::step] for i in range(step)])
    return groups


def halo_of(models: Iterable[str]) -> int:
    """The halo that is enough for all of some models."""
    return max(map(_halo, models))


def _halo(model: str) -> int:
    if model.removesuffix(".onnx").endswith(".guides"):
        return GUIDED_HALO
    size = "" if "/" in model else model.split(".")[1]  # of other libraries, nothing was measured
    return HALOS.get(size, max(HALOS.values()))


def boxes_of(cells: np.ndarray) -> Iterator[list[Box]]:
    """One box around all active cells, then two, three and more, as long as that leaves cells out; in pixels."""
    coarse = _grouped(_grouped(cells, COARSE).T, COARSE).T
    boxes = [_trimmed(coarse, Box(0, 0, *coarse.shape))]
    while True:
        yield [_in_pixels(cells, box) for box in boxes]
        cuts = [(*_best_cut(coarse, box), i) for i, box in enumerate(boxes)]
        gain, halves, i = max(cuts, key=lambda cut: cut[0])
        if gain <= 0 or len(boxes) == MOST_BOXES:
            return
        boxes[i:i + 1] = [_trimmed(coarse, half) for half in halves]


def _in_pixels(cells: np.ndarray, box: Box) -> Box:
    """The active part of a box that was found by larger squares."""
    return Box(*(CELL * side for side in _trimmed(cells, Box(*(COARSE * side for side in box)))))


def _best_cut(cells: np.ndarray, box: Box) -> tuple[int, tuple[Box, Box]]:
    """The cut of a box that leaves most cells out, and how many; the box holds active cells at all of its sides."""
    top, left, rows, columns = box
    part = cells[top:top + rows, left:left + columns]
    down, across = (_areas(side)[:-1] + _areas(side[::-1])[-2::-1] for side in (part, part.T))
    if not across.size or (down.size and down.min() <= across.min()):
        if not down.size:
            return 0, (box, box)
        i = int(down.argmin()) + 1
        return _area(box) - int(down[i - 1]), (Box(top, left, i, columns), Box(top + i, left, rows - i, columns))
    i = int(across.argmin()) + 1
    return _area(box) - int(across[i - 1]), (Box(top, left, rows, i), Box(top, left + i, rows, columns - i))


def _areas(part: np.ndarray) -> np.ndarray:
    """Of the first row, the first two and so on: the area of the box around what is active in them; in the very first
    row something is."""
    active, count = part.any(1), part.shape[1]
    first = np.minimum.accumulate(np.where(active, part.argmax(1), count))
    last = np.maximum.accumulate(np.where(active, count - part[:, ::-1].argmax(1), 0))
    areas: np.ndarray = np.maximum.accumulate(np.where(active, np.arange(1, len(part) + 1), 0)) * (last - first)
    return areas


def _trimmed(cells: np.ndarray, box: Box) -> Box:
    """The active part of a box."""
    part = cells[box.top:box.top + box.rows, box.left:box.left + box.columns]
    rows, columns = np.flatnonzero(part.any(1)), np.flatnonzero(part.any(0))
    if not rows.size:
        return Box(box.top, box.left, 0, 0)
    return Box(box.top + int(rows[0]), box.left + int(columns[0]), int(rows[-1] - rows[0]) + 1,
               int(columns[-1] - columns[0]) + 1)


def _area(box: Box) -> int:
    return box.rows * box.columns


def shape_for(frame: Sizes, boxes: Iterable[Box], halo: int) -> Shape:
    """The least window that holds each of some boxes with its halo."""
    spans = [(_span(box.top, box.rows, frame.h, halo, frame.grid),
              _span(box.left, box.columns, frame.w, halo, frame.grid)) for box in boxes]
    return whole_sides(frame, tuple(max(end - first for first, end in side) for side in zip(*spans, strict=True)))


def whole_sides(frame: Sizes, shape: Shape) -> Shape:
    """A window's size, limited to the frame's."""
    return min(shape[0], frame.h), min(shape[1], frame.w)


def _span(first: int, count: int, size: int, halo: int, grid: int) -> tuple[int, int]:
    return max(0, first - halo) // grid * grid, min(whole_steps(size, grid), whole_steps(first + count + halo, grid))


def tiles_of(frame: Sizes, boxes: Iterable[Box], shape: Shape, halo: int) -> tuple[Tile, ...]:
    """A window of one shape for each box."""
    tiles = []
    for box in boxes:
        origin = (_origin(box.top, shape[0], frame.h, halo, frame.grid),
                  _origin(box.left, shape[1], frame.w, halo, frame.grid))
        inner = Box(box.top, box.left, min(box.rows, frame.h - box.top), min(box.columns, frame.w - box.left))
        tiles.append(Tile(Window(frame, *origin, *shape), inner))
    return tuple(tiles)


def _origin(first: int, count: int, size: int, halo: int, grid: int) -> int:
    last = 0 if count >= size else whole_steps(size, grid) - count
    return min(max(0, first - halo) // grid * grid, last)


def cost(shape: Shape, count: int) -> int:
    """About how long windows take, in render pixels."""
    return count * (shape[0] * shape[1] + FIXED)


def around(frame: Sizes, cells: np.ndarray, halo: int) -> tuple[list[Box], Shape]:
    """The boxes around active cells whose windows take least, and the size of these."""
    found = [(boxes, shape_for(frame, boxes, halo)) for boxes in boxes_of(cells)]
    return min(found, key=lambda item: cost(item[1], len(item[0])))


def grids(frame: Sizes, halo: int) -> Iterator[tuple[Shape, Shape]]:
    """Sizes of boxes that fill a frame row by row, and the size of their windows: from one box to many."""
    most = (-(-side // frame.grid) for side in (frame.h, frame.w))
    for down, across in itertools.product(*map(_some, most)):
        rows, columns = (whole_steps(-(-side // count), frame.grid)
                         for side, count in ((frame.h, down), (frame.w, across)))
        window = (_longest(rows, frame.h, halo, frame.grid), _longest(columns, frame.w, halo, frame.grid))
        yield (rows, columns), whole_sides(frame, window)


def count_of(frame: Sizes, box: Shape) -> int:
    """How many boxes of a size fill a frame."""
    return -(-frame.h // box[0]) * -(-frame.w // box[1])


@cache
def _longest(count: int, size: int, halo: int, grid: int) -> int:
    """Rows of the largest window of boxes of so many rows."""
    return max(end - first for first, end in (_span(top, count, size, halo, grid) for top in range(0, size, count)))


def _some(most: int) -> list[int]:
    """A few of the numbers up to `most`, dense among the small ones."""
    return sorted({*(round(1.15**power) for power in range(60)), most} & {*range(1, most + 1)})


def bands_of(frame: Sizes, box: Shape, shape: Shape, halo: int) -> list[Band]:
    """Bands of boxes that fill a frame."""
    rows, columns = box
    tops, lefts = range(0, frame.h, rows), range(0, frame.w, columns)
    return [Band(top, min(rows, frame.h - top), tiles_of(frame, [Box(top, left, *box) for left in lefts], shape, halo))
            for top in tops]


def band_of(frame: Sizes, boxes: Iterable[Box], shape: Shape, halo: int) -> Band:
    """The rows that hold some boxes, of which only these are worked on."""
    tiles = tiles_of(frame, boxes, shape, halo)
    top = min(tile.inner.top for tile in tiles)
    return Band(top, max(tile.inner.top + tile.inner.rows for tile in tiles) - top, tiles)


PIXEL = 2000
"""Bytes that a render pixel of a window takes, of which somewhat more than half are the network's own (1800 with models
s, m and l, measured from 480x272 to 960x544, and more with l in float32)."""

TILE = 230_000
"""Bytes that the commands of a tile take (measured with 240 to 920 tiles of 1920x1080)."""

WINDOW = 0.75
"""Share of what a budget leaves that a window may take; tensors of the frame, and what is looked at of files, have the
other part."""


def bands_within(scratch: Scratch | None, frame: Sizes, models: Sequence[str]) -> list[Band]:
    """Bands that fill the frame; none where all of it may be worked on at once.

    Raises MemoryBudgetError, which names the smallest budget, when no window is small enough.
    """
    if scratch is None:
        return []
    if _needed((frame.h, frame.w), 0) <= scratch.budget:
        return []
    halo = seamless(models)
    needed = {(box, shape): _needed(shape, count_of(frame, box)) for box, shape in grids(frame, halo)}
    fitting = [grid for grid, nbytes in needed.items() if nbytes <= scratch.budget]
    if not fitting:
        raise MemoryBudgetError(f"{frame.w}x{frame.h} cannot be denoised within {scratch.budget >> 20}M: "
                                f"give a memory budget of {(min(needed.values()) >> 20) + 1}M or more")
    box, shape = min(fitting, key=lambda grid: cost(grid[1], count_of(frame, grid[0])))
    return bands_of(frame, box, shape, halo)


def _needed(shape: Shape, tiles: int) -> int:
    """The budget within which a frame can be worked on in so many tiles with windows of a shape."""
    return PROCESS + tiles * TILE + int(shape[0] * shape[1] * PIXEL / WINDOW)


def seamless(models: Sequence[str]) -> int:
    """A halo for tiles side by side, larger than that of a mask, as all of its seams are seen: with it the networks in
    integers give the same, too, frame after frame."""
    return halo_of(models) * 4 // 3
