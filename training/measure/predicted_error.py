"""How well the plane `error` predicts: measured over predicted error, by tenths of the prediction.

    python -m training.measure.predicted_error FOLDER [--model xl] [--kinds water,fog]

FOLDER holds one folder for each kind, as for `training.measure.table`. All pixels of the sequences
are sorted by the error that was predicted for them, and divided into ten equal parts; for each the
mean of the measured squared error is divided by the mean of the predicted one. 1 is right. Errors
are those of code values at the exposure of the run.

References have noise of their own, which no prediction can know. It is taken out by the mean over
the part: the second differences of a reference less its denoised picture show it. The denoised one
has the planes of the render with the most samples.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from postfx import DenoiseUpscale, Device, Frame, Pipeline
from postfx.colour.views import to_codes
from postfx.frame import Role
from postfx.io.sequence import Sequence
from training.measure.table import Shot, shots

PARTS = 10
"""As many equal parts of the pixels, by their prediction."""
LOW, HIGH = 0.8, 1.25
"""Ratios of measured to predicted errors between which a part counts as right."""
SECOND_DIFFERENCES_GAIN = 36
"""Variance of the second differences along both axes of white noise of variance 1."""


@dataclass(frozen=True)
class Errors:
    """Of the pixels of one frame: what was predicted and measured, and the reference's noise in the
    latter."""

    predicted: np.ndarray
    measured: np.ndarray
    noise: np.ndarray


def white_noise(codes: np.ndarray) -> np.ndarray:
    """Variance of the noise of each pixel (height, width) of codes (height, width, channels) that
    hold hardly anything else; right in the mean over many pixels (Immerkaer 1996)."""
    padded = np.pad(codes, ((1, 1), (1, 1), (0, 0)), mode="reflect")
    rows = padded[:-2] - 2 * padded[1:-1] + padded[2:]
    both = rows[:, :-2] - 2 * rows[:, 1:-1] + rows[:, 2:]
    found: np.ndarray = np.square(both).mean(axis=2) / SECOND_DIFFERENCES_GAIN
    return found


def ratios(frames: list[Errors]) -> list[float]:
    """Measured over predicted error of each tenth of the pixels, from the least prediction to the
    largest."""
    predicted = np.concatenate([one.predicted.ravel() for one in frames])
    measured = np.concatenate([(one.measured - one.noise).ravel() for one in frames])
    order = np.argsort(predicted, kind="stable")
    return [float(measured[part].mean() / predicted[part].mean())
            for part in np.array_split(order, PARTS)]


class References:
    """The references of a kind, denoised once at each exposure."""

    def __init__(self, shot: Shot, richest: Shot, model: str, threads: int) -> None:
        self._references, self._richest = Sequence(shot.reference), Sequence(richest.noisy)
        self._denoiser = Pipeline([DenoiseUpscale(scale=1.0, model=model)], Device("cpu", threads))
        self._clean: dict[int, np.ndarray] = {}

    def codes(self, number: int, exposure: float) -> tuple[np.ndarray, np.ndarray]:
        """Codes of a reference (height, width, 3), and its noise (height, width)."""
        colour = self._references.read(number, [Role.COLOUR])[Role.COLOUR]
        if number not in self._clean:
            planes = self._richest.read(number)
            self._denoiser.reset()
            guided = replace(planes, planes={**planes.planes, Role.COLOUR: colour})
            self._clean[number] = self._denoiser(guided)[Role.COLOUR].copy()
        codes = to_codes(colour, exposure)
        return codes, white_noise(codes - to_codes(self._clean[number], exposure))


def measure(shot: Shot, references: References, model: str,
            threads: int) -> Iterator[Errors]:
    """The frames of a shot."""
    denoise = DenoiseUpscale(scale=1.0, model=model, error=True)
    pipeline = Pipeline([denoise], Device("cpu", threads))
    noisy = Sequence(shot.noisy)
    for number in noisy.numbers:
        result: Frame = pipeline(noisy.read(number))
        exposure = pipeline.exposure_factor or 1.0
        wanted, noise = references.codes(number, exposure)
        found = to_codes(result[Role.COLOUR], exposure)
        yield Errors(result[Role.ERROR][:, :, 0].copy(),
                     np.square(found - wanted).mean(axis=2), noise)


def row(name: str, frames: list[Errors]) -> str:
    """A line of the table: the ratios, and how many of them are right."""
    found = ratios(frames)
    right = sum(LOW <= ratio <= HIGH for ratio in found)
    return f"{name:14} {' '.join(f'{ratio:5.2f}' for ratio in found)}  {right:2} right"


def main(argv: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--model", default="xl", help="tag or file (default: xl)")
    parser.add_argument("--kinds", default="", help="folders, with commas (default: all)")
    parser.add_argument("--threads", type=int, default=2)
    given = parser.parse_args(argv)
    found: dict[tuple[str, int], list[Errors]] = {}
    wanted = list(shots(given.folder, list(filter(None, given.kinds.split(","))), ["1x"], []))
    if not wanted:
        parser.error(f"{given.folder} holds no kinds with references: "
                     "training/measure/validation/render_scenes.py makes them")
    for kind in sorted({shot.kind for shot in wanted}):
        mine = [shot for shot in wanted if shot.kind == kind]
        richest = max(mine, key=lambda shot: shot.samples)
        references = References(mine[0], richest, given.model, given.threads)
        for shot in mine:
            found[kind, shot.samples] = list(measure(shot, references, given.model,
                                                           given.threads))
            print(row(f"{kind} {shot.samples}", found[kind, shot.samples]), flush=True)
    for samples in sorted({count for _, count in found}):
        print(row(f"all {samples}", [one for (_, count), frames in found.items()
                                     if count == samples for one in frames]))
    print(row("all", [one for frames in found.values() for one in frames]))


if __name__ == "__main__":
    main()
