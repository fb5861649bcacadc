"""Tiles that the denoised upscaler works on one after the other, so that it stays within a memory budget."""

from __future__ import annotations

from collections.abc import Sequence

from postfx.passes._denoise_layout import Band, bands_of, cost, count_of, grids, halo_of
from postfx.passes._denoise_window import Sizes
from postfx.scratch import MemoryBudgetError, Scratch

PROCESS = 300 << 20
"""Bytes of a process in which nothing is worked on yet, and of what is read and written meanwhile."""

PIXEL = 1800
"""Bytes that a render pixel of a window takes, of which somewhat more than half are the network's own (models s, m and
l, measured from 480x272 to 960x544)."""

WINDOW = 0.55
"""Share of the rest of a budget that a window may take; tensors of the frame and of its tiles have the other part."""


def bands_within(scratch: Scratch | None, frame: Sizes, models: Sequence[str]) -> list[Band]:
    """Bands that fill the frame; none where all of it may be worked on at once.

    Raises MemoryBudgetError, which names the smallest budget, when no window is small enough.
    """
    if scratch is None:
        return []
    most = int((scratch.budget - PROCESS) * WINDOW / PIXEL)
    if frame.h * frame.w <= most:
        return []
    halo = seamless(models)
    possible = list(grids(frame, halo))
    fitting = [(box, shape) for box, shape in possible if shape[0] * shape[1] <= most]
    if not fitting:
        least = PROCESS + min(shape[0] * shape[1] for _, shape in possible) * PIXEL / WINDOW
        raise MemoryBudgetError(f"{frame.w}x{frame.h} cannot be denoised within {scratch.budget >> 20}M: "
                                f"give a memory budget of {(int(least) >> 20) + 1}M or more")
    box, shape = min(fitting, key=lambda item: cost(item[1], count_of(frame, item[0])))
    return bands_of(frame, box, shape, halo)


def seamless(models: Sequence[str]) -> int:
    """A halo for tiles side by side, larger than that of a mask, as all of its seams are seen: with it the networks in
    integers give the same, too, frame after frame."""
    return halo_of(models) * 4 // 3
