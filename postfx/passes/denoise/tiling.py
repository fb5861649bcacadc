"""Windows of a frame for the networks: around active pixels, or in tiles within a memory budget."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from typing import Any, NamedTuple

import numpy as np

from postfx.errors import MemoryBudgetError
from postfx.kernels.statistics import mark_positive
from postfx.runtime import Tensor
from postfx.system import PROCESS, Scratch

PYRAMID_LEVELS = 4
"""Times that the filter pyramid halves its size."""
SIDE_MULTIPLE = 2**PYRAMID_LEVELS
"""Height and width of a network's input are multiples of this if it computes all levels of the
pyramid."""

Rows = tuple[int, int]
"""The first row, and the row after the last."""


@dataclass(frozen=True)
class Sizes:
    """Render and output size of a frame, and the number that rows and columns of its windows are
    multiples of."""

    h: int
    w: int
    height: int
    width: int
    grid: int = SIDE_MULTIPLE

    def output_rows(self, rows: Rows) -> Rows:
        """The output rows of a range of render rows."""
        return rows[0] * self.height // self.h, rows[1] * self.height // self.h


class Box(NamedTuple):
    """A rectangle of pixels: first row, first column, height and width."""

    top: int
    left: int
    rows: int
    columns: int

    def whole_tiles(self) -> Box:
        """All tiles of 16 pixels that it has pixels of. Those of the last ones may lie beyond the
        frame."""
        top, left = (side // TILE_SIDE * TILE_SIDE for side in (self.top, self.left))
        return Box(top, left, whole_steps(self.top + self.rows, TILE_SIDE) - top,
                   whole_steps(self.left + self.columns, TILE_SIDE) - left)


@dataclass(frozen=True)
class Window:
    """A part of a frame at render size. Its first row and column are multiples of the frame's grid.
    It may end beyond the frame. If it is smaller than the frame, its size is a multiple of the
    grid, too, or it ends with the frame."""

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
        """The window at output size: all output pixels that the render pixels touch. Windows of one
        size have equally many."""
        frame, grid = self.frame, self.frame.grid
        top, rows = _enlarged(self.top, self.rows, frame.h, frame.height, grid)
        left, columns = _enlarged(self.left, self.columns, frame.w, frame.width, grid)
        return Box(top, left, rows, columns)

    @property
    def padded_size(self) -> tuple[int, int]:
        """Rows and columns that the network sees: the next multiples of the grid."""
        return whole_steps(self.rows, self.frame.grid), whole_steps(self.columns, self.frame.grid)

    def level(self, i: int) -> tuple[int, int]:
        """Size of a pyramid level, whose cells lie where the whole frame's cells do. It is the same
        for all windows of one size, so the last row and column may be empty."""
        frame, (rows, columns) = self.frame, self.padded_size
        return _cells(rows, frame.h, frame.grid, i), _cells(columns, frame.w, frame.grid, i)

    def area(self, i: int) -> np.ndarray:
        """Rows and columns of a pyramid level that lie in the picture."""
        ends = min(self.top + self.rows, self.frame.h), min(self.left + self.columns, self.frame.w)
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
        """At output size and counted from its first row there, some of its rows. The last ones
        reach to its end."""
        first, last = (at - self.out.top
                       for at in self.frame.output_rows((self.top + rows[0], self.top + rows[1])))
        return first, self.out.rows if rows[1] == self.rows else last

    def place(self, skipped: int = 0) -> np.ndarray:
        """What kernels know of where it lies, (8,): its first row and column, the frame's size, and
        both at output size, without so many `skipped` rows of the output."""
        frame, out = self.frame, self.out
        return np.array([self.top, self.left, frame.h, frame.w, out.top + skipped, out.left,
                         frame.height, frame.width], np.float32)

    def places(self) -> dict[str, np.ndarray]:
        """Arrays that describe the window to the kernels, by name; those of a pyramid level have
        its number behind."""
        frame, out = self.frame, self.out
        values: dict[str, Any] = {
            "window": self.place(),
            "part_rows": _counted(self.top, self.rows, frame.h),
            "part_columns": _counted(self.left, self.columns, frame.w),
            "seen_rows": _mirrored(self.padded_size[0], min(self.rows, frame.h - self.top)),
            "seen_columns": _mirrored(self.padded_size[1], min(self.columns, frame.w - self.left)),
            "out_rows": _counted(out.top, out.rows, frame.height),
            "out_columns": _counted(out.left, out.columns, frame.width)}
        values |= {f"area {i}": self.area(i) for i in range(PYRAMID_LEVELS + 1)}
        for i in range(PYRAMID_LEVELS):
            values[f"coarse_rows {i}"], values[f"coarse_columns {i}"] = self.coarser(i)
            values[f"finer_rows {i + 1}"], values[f"finer_columns {i + 1}"] = self.finer(i + 1)
        values["firsts"] = [values[f"finer_{side} {i}"][0] for side in ("rows", "columns")
                            for i in range(1, PYRAMID_LEVELS + 1)]
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
    """Rows of a pyramid level that `count` rows of a frame touch at most, wherever they begin."""
    return max(-(-(first + count) >> i) - (first >> i) for first in _firsts(count, size, grid))


def _firsts(count: int, size: int, grid: int) -> range:
    """First rows of windows of `count` rows that lie differently in the cells of the coarsest
    level."""
    return range(0, 1 if count >= size else SIDE_MULTIPLE, grid)


def _counted(first: int, count: int, size: int) -> np.ndarray:
    """`count` indices from `first` on; beyond the side, that of the last pixel is repeated."""
    return np.minimum(np.arange(first, first + count), size - 1)


def _mirrored(count: int, held: int) -> np.ndarray:
    """`count` indices from 0 on, mirrored beyond the last of `held` pixels and 0 beyond that."""
    places: np.ndarray = np.maximum(held - 1 - np.abs(np.arange(count) - (held - 1)), 0)
    return places


STRENGTH_REACH_PX = 2
"""Distance in render pixels that a pixel's strength reaches when it is resampled."""

CELL = 2 * STRENGTH_REACH_PX
"""Side in render pixels of the squares that are active or not."""
HISTORY_REACH_PX = 48
"""Rows above and below what is denoised that leave a history to the next frame, with networks of
filters and without guides. So far something may move from frame to frame, and later frames differ
from the whole frame's by no more than with a history in all rows (docs/lab/denoiser.md)."""
COARSE = 4
"""Side, in such squares, of the larger squares that boxes are searched by."""
TILE_SIDE = COARSE * CELL
"""The same in render pixels, as wide as the tiles in which lost detail is looked for."""

FIXED = 10000
"""Least overhead of a window: the time of so many render pixels. samples/window_cost.py measures
11200 for model m at 960x540 (7 ms), 23500 for s, and 27500 for m at 1920x1080, where it matters
less."""
GPU_FIXED = 400_000
"""The same on a GPU, where small kernels wait for each other. An H100 takes 0.23 ms more than in
proportion with s, the time of 415000 pixels (docs/lab/gpu.md)."""

MOST_BOXES = 6
WORTH_TIME_SHARE = 0.9
"""Windows are used if they are expected to take at most this share of the whole frame's time. Work
that is done everywhere adds 7 % of that time with m and 11 % with s, measured in the same way."""


@dataclass(frozen=True)
class Tile:
    """A window, and the rows and columns of the frame that it is for; the rest of it is halo."""

    window: Window
    inner: Box

    @property
    def lasting(self) -> Rows:
        """Of the window, the rows that leave a history to the next frame: see HISTORY_REACH_PX."""
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
        """Its rows."""
        return self.top, self.top + self.rows

    def over(self, rows: int) -> Band:
        """This band's tiles, for all rows of the frame."""
        return Band(0, rows, self.tiles)

    @property
    def rows_held(self) -> Rows:
        """The rows of the frame that its windows hold, halo included."""
        windows = [tile.window for tile in self.tiles]
        return min(one.top for one in windows), min(max(one.top + one.rows for one in windows),
                                                    windows[0].frame.h)

    @property
    def share(self) -> float:
        """Pixels of all windows over pixels of the frame; pixels in several windows count several
        times."""
        frame = self.tiles[0].window.frame
        return sum(tile.window.rows * tile.window.columns
                   for tile in self.tiles) / (frame.h * frame.w)


Shape = tuple[int, int]


def active_cells(strength: np.ndarray) -> np.ndarray:
    """Which squares of 4 pixels have an effect: (h, w, 1) -> (rows, columns) of bool."""
    mask = np.zeros([whole_steps(side, CELL) // STRENGTH_REACH_PX for side in strength.shape[:2]],
                    bool)
    mark_positive(strength, STRENGTH_REACH_PX, mask)
    for _ in range(2):
        halves = np.pad(mask, ((1, 1), (0, 0)))
        mask = np.logical_or.reduce([halves[i:len(mask) + i:2] for i in range(4)]).T
    return mask


def grown(cells: np.ndarray, pixels: int) -> np.ndarray:
    """Squares of 4 pixels that are active, or within so many pixels of one that is, along both
    sides."""
    steps = -(-pixels // CELL)
    for _ in range(2):
        counts = np.pad(cells, ((steps + 1, steps), (0, 0))).cumsum(0, np.int32)
        cells = (counts[2 * steps + 1:] > counts[:-2 * steps - 1]).T
    return cells


def whole_tiles(cells: np.ndarray) -> np.ndarray:
    """Squares of 4 pixels, all active in tiles of 16 where any is."""
    tiles = tiles_with(cells).repeat(COARSE, 0).repeat(COARSE, 1)
    return tiles[:cells.shape[0], :cells.shape[1]]


def tiles_with(cells: np.ndarray) -> np.ndarray:
    """Which tiles of 16 pixels have active squares: (rows, columns) of bool."""
    return _grouped(_grouped(cells, COARSE).T, COARSE).T


def active_rows(cells: np.ndarray, h: int) -> Rows:
    """The rows of a frame's pixels from the first active square to the last; there is one."""
    found = np.flatnonzero(cells.any(1))
    return CELL * int(found[0]), min(CELL * (int(found[-1]) + 1), h)


def full_rows(strength: np.ndarray, at: np.ndarray, rows: Rows) -> Rows:
    """The longest run of some output rows, which lie `at` rows of a frame, in which a strength (h,
    w, 1) is 1 in both rows around each."""
    ones = np.logical_and(strength >= 1, strength < np.inf).reshape(len(strength), -1).all(axis=1)
    above = np.floor(at[slice(*rows)]).astype(int)
    full = np.logical_and(*(np.take(ones, near, mode="clip") for near in (above, above + 1)))
    runs = np.flatnonzero(np.diff(full, prepend=False, append=False)).reshape(-1, 2).tolist()
    first, end = max(runs, key=lambda run: run[1] - run[0], default=(len(above), len(above)))
    return rows[0] + first, rows[0] + end


def _grouped(mask: np.ndarray, step: int) -> np.ndarray:
    """For each group of `step` rows of a mask, whether any of them is set."""
    padded = np.pad(mask, ((0, -len(mask) % step), (0, 0)))
    groups: np.ndarray = np.logical_or.reduce([padded[i::step] for i in range(step)])
    return groups


def boxes_of(cells: np.ndarray) -> Iterator[list[Box]]:
    """One box around all active cells, then two, three and more, as long as that leaves cells out;
    in pixels."""
    coarse = tiles_with(cells)
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
    """The cut of a box that leaves out the most cells, and how many. The box has active cells at
    all of its sides."""
    top, left, rows, columns = box
    part = cells[top:top + rows, left:left + columns]
    down, across = (_areas(side)[:-1] + _areas(side[::-1])[-2::-1] for side in (part, part.T))
    if not across.size or (down.size and down.min() <= across.min()):
        if not down.size:
            return 0, (box, box)
        i = int(down.argmin()) + 1
        return _area(box) - int(down[i - 1]), (Box(top, left, i, columns),
                                               Box(top + i, left, rows - i, columns))
    i = int(across.argmin()) + 1
    return _area(box) - int(across[i - 1]), (Box(top, left, rows, i),
                                             Box(top, left + i, rows, columns - i))


def _areas(part: np.ndarray) -> np.ndarray:
    """Area of the box around the active cells of the first row, of the first two rows and so on.
    The first row has some."""
    active, count = part.any(1), part.shape[1]
    first = np.minimum.accumulate(np.where(active, part.argmax(1), count))
    last = np.maximum.accumulate(np.where(active, count - part[:, ::-1].argmax(1), 0))
    areas: np.ndarray = (np.maximum.accumulate(np.where(active, np.arange(1, len(part) + 1), 0))
                         * (last - first))
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
    """Size of the smallest window that can hold any of these boxes with its halo."""
    rows, columns = zip(*((_span(box.top, box.rows, frame.h, halo, frame.grid),
                           _span(box.left, box.columns, frame.w, halo, frame.grid))
                          for box in boxes), strict=True)
    return _longest_of(rows, frame.h, frame.grid), _longest_of(columns, frame.w, frame.grid)


def _longest_of(spans: Sequence[Rows], size: int, grid: int) -> int:
    """The longest of some spans. Where all end beyond the frame's side, it ends with it, so that
    windows can be written in place."""
    longest, end = max(end - first for first, end in spans), whole_steps(size, grid)
    return longest - (end - size) if all(span[1] == end for span in spans) else min(longest, size)


def can_serve(frame: Sizes, shape: Shape, ready: Shape) -> bool:
    """Whether windows that are ready can take the place of those of a shape: they are no smaller,
    and must end with the frame only where the others do."""
    sides = zip(shape, ready, (frame.h, frame.w), strict=True)
    return all(have >= side and (have % frame.grid == 0 or have == size or side % frame.grid > 0)
               for side, have, size in sides)


def whole_sides(frame: Sizes, shape: Shape) -> Shape:
    """A window's size, limited to the frame's."""
    return min(shape[0], frame.h), min(shape[1], frame.w)


def _span(first: int, count: int, size: int, halo: int, grid: int) -> tuple[int, int]:
    return max(0, first - halo) // grid * grid, min(whole_steps(size, grid),
                                                    whole_steps(first + count + halo, grid))


def tiles_of(frame: Sizes, boxes: Iterable[Box], shape: Shape, halo: int,
             judged: bool = False) -> tuple[Tile, ...]:
    """A window of one shape for each box. Where tiles of 16 pixels are `judged`, windows are for
    all of those that the boxes touch; the halo is that of the boxes."""
    tiles = []
    for box in boxes:
        origin = (_origin(box.top, shape[0], frame.h, halo, frame.grid),
                  _origin(box.left, shape[1], frame.w, halo, frame.grid))
        box = box.whole_tiles() if judged else box
        inner = Box(box.top, box.left, min(box.rows, frame.h - box.top),
                    min(box.columns, frame.w - box.left))
        tiles.append(Tile(Window(frame, *origin, *shape), inner))
    return tuple(tiles)


def _origin(first: int, count: int, size: int, halo: int, grid: int) -> int:
    last = 0 if count >= size else whole_steps(size, grid) - whole_steps(count, grid)
    return min(max(0, first - halo) // grid * grid, last)


def cost(shape: Shape, count: int, fixed: int = FIXED) -> int:
    """About how long windows take, in render pixels; `fixed`: the overhead of each."""
    return count * (shape[0] * shape[1] + fixed)


def around(frame: Sizes, cells: np.ndarray, halo: int,
           fixed: int = FIXED) -> tuple[list[Box], Shape]:
    """The boxes around active cells whose windows take the least time, and the windows' size."""
    found = [(boxes, shape_for(frame, boxes, halo)) for boxes in boxes_of(cells)]
    return min(found, key=lambda item: cost(item[1], len(item[0]), fixed))


def grids(frame: Sizes, halo: int) -> Iterator[tuple[Shape, Shape]]:
    """Sizes of boxes that fill a frame row by row, and the size of their windows: from one box to
    many."""
    most = (-(-side // frame.grid) for side in (frame.h, frame.w))
    for down, across in itertools.product(*map(_some, most)):
        rows, columns = (whole_steps(-(-side // count), frame.grid)
                         for side, count in ((frame.h, down), (frame.w, across)))
        window = (_longest(rows, frame.h, halo, frame.grid),
                  _longest(columns, frame.w, halo, frame.grid))
        yield (rows, columns), whole_sides(frame, window)


def count_of(frame: Sizes, box: Shape) -> int:
    """How many boxes of a size fill a frame."""
    return -(-frame.h // box[0]) * -(-frame.w // box[1])


@cache
def _longest(count: int, size: int, halo: int, grid: int) -> int:
    """Rows of the largest window of boxes of so many rows."""
    return max(end - first for first, end in (_span(top, count, size, halo, grid)
                                              for top in range(0, size, count)))


def _some(most: int) -> list[int]:
    """A few of the numbers up to `most`, dense among the small ones."""
    return sorted({*(round(1.15**power) for power in range(60)), most} & {*range(1, most + 1)})


def bands_of(frame: Sizes, box: Shape, shape: Shape, halo: int) -> list[Band]:
    """Bands of boxes that fill a frame."""
    rows, columns = box
    tops, lefts = range(0, frame.h, rows), range(0, frame.w, columns)
    return [Band(top, min(rows, frame.h - top),
                 tiles_of(frame, [Box(top, left, *box) for left in lefts], shape, halo))
            for top in tops]


def band_of(frame: Sizes, boxes: Iterable[Box], shape: Shape, halo: int,
            judged: bool = False) -> Band:
    """The rows that hold these boxes, or the tiles that are `judged`; only these are worked on."""
    tiles = tiles_of(frame, boxes, shape, halo, judged)
    top = min(tile.inner.top for tile in tiles)
    return Band(top, max(tile.inner.top + tile.inner.rows for tile in tiles) - top, tiles)


PIXEL = 2000
"""Bytes that a render pixel of a window takes, of which somewhat more than half are the network's
own (1800 with models s, m and l, measured from 480x272 to 960x544, and more with l in float32)."""

TILE_BYTES = 230_000
"""Bytes that the commands of a tile take (measured with 240 to 920 tiles of 1920x1080)."""

WINDOW_BUDGET_SHARE = 0.75
"""Share of the remaining budget that a window may take. The frame's tensors and the parts of files
in use have the rest."""


def bands_within(scratch: Scratch | None, frame: Sizes, halo: int) -> list[Band]:
    """Bands that fill the frame, with this halo around their tiles; none if the whole frame fits
    the budget at once.

    Raises MemoryBudgetError, which names the smallest budget, when no window is small enough.
    """
    if scratch is None:
        return []
    if _needed((frame.h, frame.w), 0) <= scratch.budget:
        return []
    needed = {(box, shape): _needed(shape, count_of(frame, box))
              for box, shape in grids(frame, halo)}
    fitting = [grid for grid, nbytes in needed.items() if nbytes <= scratch.budget]
    if not fitting:
        raise MemoryBudgetError(f"{frame.w}x{frame.h} cannot be denoised within "
                                f"{scratch.budget >> 20}M: give a memory budget of "
                                f"{(min(needed.values()) >> 20) + 1}M or more")
    box, shape = min(fitting, key=lambda grid: cost(grid[1], count_of(frame, grid[0])))
    return bands_of(frame, box, shape, halo)


def _needed(shape: Shape, tiles: int) -> int:
    """The smallest budget for a frame in this many tiles with windows of this shape."""
    return PROCESS + tiles * TILE_BYTES + int(shape[0] * shape[1] * PIXEL / WINDOW_BUDGET_SHARE)
