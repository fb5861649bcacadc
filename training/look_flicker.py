"""How steady a look holds a moving picture: its change from frame to frame, followed by the motion."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
from scipy.optimize import minimize_scalar

from postfx.bench.metrics import FOLLOWED, moved
from postfx.exposure import ExposureMeter
from postfx.frame import Frame, Role
from postfx.io.sequence import read_sequence
from postfx.sampling import motion_at
from training.views import View, exact_view

Maker = Callable[[Frame], np.ndarray]
"""A clean frame, exposed, in order; the first is marked as a beginning -> sRGB code values (H,W,3)."""
SPARSE = 4  # pixels to the next that an exposure is fitted to, along both axes
STOPS = 6.0  # the farthest that an exposure is searched


def exposed(folder: Path) -> Iterator[Frame]:
    """Clean frames of a folder's `reference.####.exr`, exposed as the run-time's meter would."""
    meter = ExposureMeter("auto")
    for number, clean in enumerate(read_sequence(str(folder / "reference.####.exr"))):
        yield Frame({Role.COLOUR: clean[Role.COLOUR] * np.float32(meter(clean))}, number=clean.number, reset=not number)


def motions(folder: Path) -> Iterator[np.ndarray]:
    """Motion of a folder's `noisy.####.exr`, (h, w, 2) in its own pixels."""
    return (given[Role.MOTION] for given in read_sequence(str(folder / "noisy.####.exr")))


def nearest_exposure(view: View, light: list[np.ndarray], shown: list[np.ndarray]) -> float:
    """Stops before a view that bring it nearest to what a look made of a sequence: least squares of code values.

    light: frames of exposed scene-linear (H,W,3); shown: the look's code values of them. One number for all frames.
    """
    given, wanted = (np.stack([x[::SPARSE, ::SPARSE] for x in frames]) for frames in (light, shown))

    def error(stops: float) -> float:
        return float(np.square(exact_view(view, given * np.float32(2.0**stops)) - wanted).mean())

    return float(minimize_scalar(error, bounds=(-STOPS, STOPS), method="bounded", options={"xatol": 1e-4}).x)


def flicker(folder: Path, looks: dict[str, Maker], judge: str) -> dict[str, dict[str, float]]:
    """Two figures of each look, over pixels where the look named `judge` changes by less than 0.1 along the motion
    (elsewhere the motion does not tell):

    flicker: 1000 times the mean absolute change from frame to frame along the motion.
    contrast: 1000 times the mean absolute change to the next pixels, right and below, in the same frames. A static
        curve flickers by as much as it shows of a render's noise and detail, so by as much as it has of contrast.
    """
    before, sums, count = {}, {name: np.zeros(2) for name in looks}, 0
    for frame, motion in zip(exposed(folder), motions(folder), strict=False):
        now = {name: make(frame) for name, make in looks.items()}
        if before:
            height, width = frame[Role.COLOUR].shape[:2]
            along = motion_at(motion, np.arange(height), np.arange(width), height, width)
            change = {name: np.abs(now[name] - moved(before[name], along)) for name in looks}
            followed = change[judge].max(-1) < FOLLOWED
            count += int(followed.sum())
            for name in looks:
                sums[name] += [x.mean(-1)[followed].sum(dtype=np.float64) for x in (change[name], contrast(now[name]))]
        before = now
    figures = {name: 1000 * both / max(1, count) for name, both in sums.items()}
    return {name: {"flicker": round(float(x[0]), 3), "contrast": round(float(x[1]), 3)} for name, x in figures.items()}


def contrast(picture: np.ndarray) -> np.ndarray:
    """Mean absolute difference of each pixel (H,W,3) to the next on its right and below; 0 beyond the edges."""
    right, below = (np.abs(np.diff(picture, axis=axis, append=picture.take([-1], axis))) for axis in (1, 0))
    return (right + below) / 2
