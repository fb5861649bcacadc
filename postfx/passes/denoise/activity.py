"""Which parts of a frame are active, so that the others cost nothing.

A mask marks pixels; the frame is divided into squares of `CELL` x `CELL` pixels, and a square is
active if anything in it has an effect. Boxes are then put around the active squares: one, two and
more, each time cut where that leaves the most squares out.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from postfx.kernels.statistics import mark_positive
from postfx.passes.denoise.geometry import CELL, Box, Rows, whole_steps

STRENGTH_REACH_PX = CELL // 2
"""Distance in render pixels that a pixel's strength reaches when it is resampled."""
CELLS_OF_A_TILE = 4
"""Cells along a side of the larger squares by which boxes are searched."""
TILE_SIDE_PX = CELLS_OF_A_TILE * CELL
"""The same in render pixels: as wide as the tiles in which lost detail is looked for."""
MOST_BOXES = 6


def active_cells(strength: np.ndarray) -> np.ndarray:
    """Which cells a strength (h, w, 1) has an effect on: (rows, columns) of bool."""
    mask = np.zeros([whole_steps(side, CELL) // STRENGTH_REACH_PX for side in strength.shape[:2]],
                    bool)
    mark_positive(strength, STRENGTH_REACH_PX, mask)
    for _ in range(2):
        halves = np.pad(mask, ((1, 1), (0, 0)))
        mask = np.logical_or.reduce([halves[i:len(mask) + i:2] for i in range(4)]).T
    return mask


def grown(cells: np.ndarray, pixels: int) -> np.ndarray:
    """Cells that are active, or within so many pixels of one that is, along both sides."""
    steps = -(-pixels // CELL)
    for _ in range(2):
        counts = np.pad(cells, ((steps + 1, steps), (0, 0))).cumsum(0, np.int32)
        cells = (counts[2 * steps + 1:] > counts[:-2 * steps - 1]).T
    return cells


def whole_tiles(cells: np.ndarray) -> np.ndarray:
    """Cells, all of a tile of 16 pixels active if any of them is."""
    tiles = tiles_with(cells).repeat(CELLS_OF_A_TILE, 0).repeat(CELLS_OF_A_TILE, 1)
    return tiles[:cells.shape[0], :cells.shape[1]]


def tiles_with(cells: np.ndarray) -> np.ndarray:
    """Which tiles of 16 pixels have active cells: (rows, columns) of bool."""
    return _grouped(_grouped(cells, CELLS_OF_A_TILE).T, CELLS_OF_A_TILE).T


def active_rows(cells: np.ndarray, height: int) -> Rows:
    """A frame's rows of pixels from the first active cell to the last; there is one."""
    found = np.flatnonzero(cells.any(1))
    return CELL * int(found[0]), min(CELL * (int(found[-1]) + 1), height)


def full_rows(strength: np.ndarray, at: np.ndarray, rows: Rows) -> Rows:
    """The longest run of output rows, among `rows`, whose strength is 1 everywhere.

    strength: (h, w, 1). at: where each output row lies among the rows of the strength; it is
    resampled from the row on either side, so both must be 1.
    """
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
    in pixels. Boxes are searched by tiles of 16 pixels, which is faster."""
    tiles = tiles_with(cells)
    boxes = [_trimmed(tiles, Box(0, 0, *tiles.shape))]
    while True:
        yield [_in_pixels(cells, box) for box in boxes]
        cuts = [(*_best_cut(tiles, box), i) for i, box in enumerate(boxes)]
        gain, halves, i = max(cuts, key=lambda cut: cut[0])
        if gain <= 0 or len(boxes) == MOST_BOXES:
            return
        boxes[i:i + 1] = [_trimmed(tiles, half) for half in halves]


def _in_pixels(cells: np.ndarray, box: Box) -> Box:
    """A box of tiles, trimmed to its active cells, in pixels."""
    in_cells = Box(*(CELLS_OF_A_TILE * side for side in box))
    return Box(*(CELL * side for side in _trimmed(cells, in_cells)))


def _best_cut(mask: np.ndarray, box: Box) -> tuple[int, tuple[Box, Box]]:
    """The cut of a box that leaves out the most squares of a mask, and how many. The box has set
    squares at all of its sides."""
    top, left, rows, columns = box
    part = mask[top:top + rows, left:left + columns]
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
    """Area of the box around the set squares of the first row, of the first two rows and so on.
    The first row has some."""
    active, count = part.any(1), part.shape[1]
    first = np.minimum.accumulate(np.where(active, part.argmax(1), count))
    last = np.maximum.accumulate(np.where(active, count - part[:, ::-1].argmax(1), 0))
    areas: np.ndarray = (np.maximum.accumulate(np.where(active, np.arange(1, len(part) + 1), 0))
                         * (last - first))
    return areas


def _trimmed(mask: np.ndarray, box: Box) -> Box:
    """The smallest box around what is set in a box of a mask."""
    part = mask[box.top:box.top + box.rows, box.left:box.left + box.columns]
    rows, columns = np.flatnonzero(part.any(1)), np.flatnonzero(part.any(0))
    if not rows.size:
        return Box(box.top, box.left, 0, 0)
    return Box(box.top + int(rows[0]), box.left + int(columns[0]), int(rows[-1] - rows[0]) + 1,
               int(columns[-1] - columns[0]) + 1)


def _area(box: Box) -> int:
    return box.rows * box.columns
