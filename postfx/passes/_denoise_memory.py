"""Tiles that the denoised upscaler works on one after the other, so that it stays within a memory budget."""

from __future__ import annotations

from collections.abc import Sequence

from postfx.errors import MemoryBudgetError
from postfx.passes._denoise_layout import Band, Shape, bands_of, cost, count_of, grids, halo_of
from postfx.passes._denoise_window import Sizes
from postfx.system import PROCESS, Scratch

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
