"""How steady a look holds a moving picture: its change from frame to frame, followed by the motion."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from postfx.bench.metrics import FOLLOWED, moved
from postfx.exposure import ExposureMeter
from postfx.frame import Frame, Role
from postfx.io.sequence import read_sequence
from postfx.sampling import motion_at

Maker = Callable[[Frame, float], np.ndarray]
"""A clean frame and its exposure, in order -> sRGB code values (H,W,3)."""


def frames(folder: Path) -> Iterator[tuple[Frame, np.ndarray]]:
    """Clean frames of a folder's `reference.####.exr` and the motion of `noisy.####.exr`, enlarged to their size."""
    noisy = read_sequence(str(folder / "noisy.####.exr"))
    for clean, given in zip(read_sequence(str(folder / "reference.####.exr")), noisy, strict=False):
        height, width = clean[Role.COLOUR].shape[:2]
        yield clean, motion_at(given[Role.MOTION], np.arange(height), np.arange(width), height, width)


def flicker(folder: Path, looks: dict[str, Maker], judge: str) -> dict[str, float]:
    """1000 times the mean absolute change of each look from frame to frame along the motion.

    Counts pixels where the look named `judge` changes by less than 0.1: elsewhere the motion does not tell.
    """
    meter, before, sums, count = ExposureMeter("auto"), {}, dict.fromkeys(looks, 0.0), 0
    for clean, motion in frames(folder):
        exposure = meter(clean)
        now = {name: make(clean, exposure) for name, make in looks.items()}
        if before:
            change = {name: np.abs(now[name] - moved(before[name], motion)) for name in looks}
            followed = change[judge].max(-1) < FOLLOWED
            count += int(followed.sum())
            for name in looks:
                sums[name] += float(change[name].mean(-1)[followed].sum())
        before = now
    return {name: round(1000 * total / max(1, count), 3) for name, total in sums.items()}
