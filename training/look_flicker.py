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

Maker = Callable[[Frame], np.ndarray]
"""A clean frame, exposed, in order; the first is marked as a beginning -> sRGB code values (H,W,3)."""


def exposed(folder: Path) -> Iterator[Frame]:
    """Clean frames of a folder's `reference.####.exr`, exposed as the run-time's meter would."""
    meter = ExposureMeter("auto")
    for number, clean in enumerate(read_sequence(str(folder / "reference.####.exr"))):
        yield Frame({Role.COLOUR: clean[Role.COLOUR] * np.float32(meter(clean))}, number=clean.number, reset=not number)


def motions(folder: Path) -> Iterator[np.ndarray]:
    """Motion of a folder's `noisy.####.exr`, (h, w, 2) in its own pixels."""
    return (given[Role.MOTION] for given in read_sequence(str(folder / "noisy.####.exr")))


def flicker(folder: Path, looks: dict[str, Maker], judge: str) -> dict[str, float]:
    """1000 times the mean absolute change of each look from frame to frame along the motion.

    Counts pixels where the look named `judge` changes by less than 0.1: elsewhere the motion does not tell.
    """
    before, sums, count = {}, dict.fromkeys(looks, 0.0), 0
    for frame, motion in zip(exposed(folder), motions(folder), strict=False):
        now = {name: make(frame) for name, make in looks.items()}
        if before:
            height, width = frame[Role.COLOUR].shape[:2]
            along = motion_at(motion, np.arange(height), np.arange(width), height, width)
            change = {name: np.abs(now[name] - moved(before[name], along)) for name in looks}
            followed = change[judge].max(-1) < FOLLOWED
            count += int(followed.sum())
            for name in looks:
                sums[name] += float(change[name].mean(-1)[followed].sum())
        before = now
    return {name: round(1000 * total / max(1, count), 3) for name, total in sums.items()}
