"""Which windows of a frame the networks run on: around the active parts of the frame (`around`), or
side by side over all of it within a memory budget (`bands_within`)."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator, Sequence
from functools import cache

import numpy as np

from postfx.errors import MemoryBudgetError
from postfx.passes.denoise.activity import TILE_SIDE_PX, boxes_of
from postfx.passes.denoise.geometry import Band, Box, Rows, Shape, Sizes, Tile, Window, whole_steps
from postfx.system import PROCESS, Scratch

WINDOW_COST_PX = 10_000
"""Least overhead of a window on a CPU: the time of so many render pixels. samples/window_cost.py
measures 11200 for model m at 960x540 (7 ms), 23500 for s, and 27500 for m at 1920x1080, where it
matters less."""
GPU_WINDOW_COST_PX = 400_000
"""The same on a GPU, where small kernels wait for each other. An H100 takes 0.23 ms more than in
proportion with s, the time of 415000 pixels (docs/lab/gpu.md)."""
WORTH_TIME_SHARE = 0.9
"""Windows are used if they are expected to take at most this share of the whole frame's time. Work
that is done everywhere adds 7 % of that time with m and 11 % with s, measured in the same way."""

WINDOW_PIXEL_BYTES = 2000
"""Memory that a render pixel of a window takes. Somewhat more than half is the network's own (1800
with models s, m and l, measured from 480x272 to 960x544, and more with l in float32)."""
TILE_BYTES = 230_000
"""Memory that the commands of a tile take (measured with 240 to 920 tiles of 1920x1080)."""
WINDOW_BUDGET_SHARE = 0.75
"""Share of the remaining budget that a window may take. The frame's tensors and the parts of files
in use have the rest."""


# Windows around active parts


def around(frame: Sizes, cells: np.ndarray, halo: int,
           overhead: int = WINDOW_COST_PX) -> tuple[list[Box], Shape]:
    """The boxes around active cells whose windows take the least time, and the windows' size.
    `overhead` of a window as in `window_cost`."""
    found = [(boxes, shape_for(frame, boxes, halo)) for boxes in boxes_of(cells)]
    return min(found, key=lambda item: window_cost(item[1], len(item[0]), overhead))


def shape_for(frame: Sizes, boxes: Iterable[Box], halo: int) -> Shape:
    """Size of the smallest window that can hold any of these boxes with its halo."""
    height, width = frame.render
    rows, columns = zip(*((_span(box.top, box.rows, height, halo, frame.grid),
                           _span(box.left, box.columns, width, halo, frame.grid))
                          for box in boxes), strict=True)
    return _longest_of(rows, height, frame.grid), _longest_of(columns, width, frame.grid)


def window_cost(shape: Shape, count: int, overhead: int = WINDOW_COST_PX) -> int:
    """About how long `count` windows take, as the time of so many render pixels. `overhead`: of
    each window, in the same unit."""
    return count * (shape[0] * shape[1] + overhead)


def can_serve(frame: Sizes, shape: Shape, ready: Shape) -> bool:
    """Whether windows of the size `ready` can take the place of those of a shape: they are no
    smaller, and must end with the frame only where the others do."""
    sides = zip(shape, ready, frame.render, strict=True)
    return all(have >= side and (have % frame.grid == 0 or have == size or side % frame.grid > 0)
               for side, have, size in sides)


def limited_to(frame: Sizes, shape: Shape) -> Shape:
    """A window's size, limited to the frame's."""
    return min(shape[0], frame.render.height), min(shape[1], frame.render.width)


def band_of(frame: Sizes, boxes: Iterable[Box], shape: Shape, halo: int,
            judged: bool = False) -> Band:
    """The rows that hold these boxes, and a window of one shape for each box. `judged`: as in
    `tiles_of`."""
    tiles = tiles_of(frame, boxes, shape, halo, judged)
    top = min(tile.inner.top for tile in tiles)
    return Band(top, max(tile.inner.top + tile.inner.rows for tile in tiles) - top, tiles)


def tiles_of(frame: Sizes, boxes: Iterable[Box], shape: Shape, halo: int,
             judged: bool = False) -> tuple[Tile, ...]:
    """A window of one shape for each box.

    judged: whether the result is judged in tiles of 16 pixels. Windows are then for all of the
    tiles that their box touches; the halo is still the box's.
    """
    tiles, (height, width) = [], frame.render
    for box in boxes:
        origin = (_origin(box.top, shape[0], height, halo, frame.grid),
                  _origin(box.left, shape[1], width, halo, frame.grid))
        box = box.grown_to(TILE_SIDE_PX) if judged else box
        inner = Box(box.top, box.left, min(box.rows, height - box.top),
                    min(box.columns, width - box.left))
        tiles.append(Tile(Window(frame, *origin, *shape), inner))
    return tuple(tiles)


def _span(first: int, count: int, size: int, halo: int, grid: int) -> Rows:
    """Rows of the window around `count` rows from `first` on."""
    return max(0, first - halo) // grid * grid, min(whole_steps(size, grid),
                                                    whole_steps(first + count + halo, grid))


def _longest_of(spans: Sequence[Rows], size: int, grid: int) -> int:
    """The longest of some spans. If all of them end beyond the frame's side, it ends with the side,
    so that windows can be written in place."""
    longest, end = max(end - first for first, end in spans), whole_steps(size, grid)
    return longest - (end - size) if all(span[1] == end for span in spans) else min(longest, size)


def _origin(first: int, count: int, size: int, halo: int, grid: int) -> int:
    """First row of a window of `count` rows that is for rows from `first` on."""
    last = 0 if count >= size else whole_steps(size, grid) - whole_steps(count, grid)
    return min(max(0, first - halo) // grid * grid, last)


# Tiles over the whole frame


def bands_within(scratch: Scratch | None, frame: Sizes, halo: int) -> list[Band]:
    """Bands that fill the frame, with this halo around their tiles; none if the whole frame fits
    the budget at once.

    Raises MemoryBudgetError, which names the smallest budget, when no window is small enough.
    """
    if scratch is None:
        return []
    if _needed_bytes(frame.render, 0) <= scratch.budget:
        return []
    needed = {(box, shape): _needed_bytes(shape, count_of(frame, box))
              for box, shape in grids(frame, halo)}
    fitting = [grid for grid, nbytes in needed.items() if nbytes <= scratch.budget]
    if not fitting:
        raise MemoryBudgetError(f"{frame.render} cannot be denoised within "
                                f"{scratch.budget >> 20}M: give a memory budget of "
                                f"{(min(needed.values()) >> 20) + 1}M or more")
    box, shape = min(fitting, key=lambda grid: window_cost(grid[1], count_of(frame, grid[0])))
    return bands_of(frame, box, shape, halo)


def grids(frame: Sizes, halo: int) -> Iterator[tuple[Shape, Shape]]:
    """Sizes of boxes that fill a frame row by row, each with the size of its windows: from one box
    to many."""
    height, width = frame.render
    most = (-(-side // frame.grid) for side in (height, width))
    for down, across in itertools.product(*map(_some_counts, most)):
        rows, columns = (whole_steps(-(-side // count), frame.grid)
                         for side, count in ((height, down), (width, across)))
        window = (_longest(rows, height, halo, frame.grid),
                  _longest(columns, width, halo, frame.grid))
        yield (rows, columns), limited_to(frame, window)


def count_of(frame: Sizes, box: Shape) -> int:
    """How many boxes of a size fill a frame."""
    return -(-frame.render.height // box[0]) * -(-frame.render.width // box[1])


def bands_of(frame: Sizes, box: Shape, shape: Shape, halo: int) -> list[Band]:
    """Bands of boxes that fill a frame."""
    (rows, columns), (height, width) = box, frame.render
    tops, lefts = range(0, height, rows), range(0, width, columns)
    return [Band(top, min(rows, height - top),
                 tiles_of(frame, [Box(top, left, *box) for left in lefts], shape, halo))
            for top in tops]


@cache
def _longest(count: int, size: int, halo: int, grid: int) -> int:
    """Rows of the largest window of boxes of so many rows."""
    return max(end - first for first, end in (_span(top, count, size, halo, grid)
                                              for top in range(0, size, count)))


def _some_counts(most: int) -> list[int]:
    """A few of the numbers up to `most`, dense among the small ones."""
    return sorted({*(round(1.15**power) for power in range(60)), most} & {*range(1, most + 1)})


def _needed_bytes(shape: Shape, tiles: int) -> int:
    """The smallest budget for a frame in this many tiles with windows of this shape."""
    pixels = shape[0] * shape[1]
    return PROCESS + tiles * TILE_BYTES + int(pixels * WINDOW_PIXEL_BYTES / WINDOW_BUDGET_SHARE)
