"""How well the plane `error` predicts: measured over predicted error, by tenths of the prediction.

    python -m training.measure.predicted_error FOLDER [--model xl] [--kinds water,fog]
        [--calibrate CHECKPOINT -o OUT.pt]

FOLDER holds one folder for each kind, as for `training.measure.table`. All pixels of the sequences
are sorted by the error that was predicted for them, and divided into ten equal parts; for each the
mean of the measured squared error is divided by the mean of the predicted one. 1 is right. Errors
are those of code values at the exposure of the run.

The last rows are of predictions that a curve has changed: the logarithm times a slope, plus a bias,
fitted to all other kinds, so that each is right by the tenths in what it was not fitted to.
--calibrate writes the network of a checkpoint, of which --model is the export, with the curve of
all kinds in its last layer of the prediction. Where a network guards its history (`guarded` in its
card), the guard reads that layer, so later frames change, too: measure them again. Else its
pictures stay the same to the bit.

References have noise of their own, which no prediction can know. It is taken out by the mean over
the part: the second differences of a reference less its denoised picture show it. The denoised one
has the planes of the render with the most samples.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from postfx import DenoiseUpscale, Device, Frame, Pipeline
from postfx.colour.views import to_codes
from postfx.frame import Role
from postfx.io.sequence import Sequence
from training.denoise.checkpoint import PREFIX, read, save
from training.measure.table import Shot, parser_of_kinds, shots

WEIGHT, BIAS = f"{PREFIX}error.weight", f"{PREFIX}error.bias"
PARTS = 10
"""As many equal parts of the pixels, by their prediction."""
LOW, HIGH = 0.8, 1.25
"""Ratios of measured to predicted errors between which a part counts as right."""
LEAST_ERROR = 1e-7
"""A tenth's least squared error: the noise that is taken out may leave nothing."""
SECOND_DIFFERENCES_GAIN = 36
"""Variance of the second differences along both axes of white noise of variance 1."""


@dataclass(frozen=True)
class Errors:
    """Of the pixels of one frame: what was predicted and measured, and the reference's noise in the
    latter."""

    predicted: np.ndarray
    measured: np.ndarray
    noise: np.ndarray


Kinds = dict[tuple[str, int], list[Errors]]
"""Kind and samples a pixel -> frames."""


def white_noise(codes: np.ndarray) -> np.ndarray:
    """Variance of the noise of each pixel (height, width) of codes (height, width, channels) that
    hold hardly anything else; right in the mean over many pixels (Immerkaer 1996)."""
    padded = np.pad(codes, ((1, 1), (1, 1), (0, 0)), mode="reflect")
    rows = padded[:-2] - 2 * padded[1:-1] + padded[2:]
    both = rows[:, :-2] - 2 * rows[:, 1:-1] + rows[:, 2:]
    found: np.ndarray = np.square(both).mean(axis=2) / SECOND_DIFFERENCES_GAIN
    return found


@dataclass(frozen=True)
class Curve:
    """A correction of predicted errors: slope times their logarithm, plus bias."""

    slope: float
    bias: float

    def __call__(self, frames: list[Errors]) -> list[Errors]:
        """The frames with predictions that it changed."""
        return [replace(one, predicted=one.predicted**self.slope * np.exp(self.bias))
                for one in frames]


def tenths(frames: list[Errors]) -> tuple[np.ndarray, np.ndarray]:
    """Mean predicted and mean measured error of each tenth of the pixels, from the least prediction
    to the largest."""
    predicted = np.concatenate([one.predicted.ravel() for one in frames])
    measured = np.concatenate([(one.measured - one.noise).ravel() for one in frames])
    parts = np.array_split(np.argsort(predicted, kind="stable"), PARTS)
    expected, found = (np.array([values[part].mean(dtype=np.float64) for part in parts])
                       for values in (predicted, measured))
    return expected, found


def ratios(frames: list[Errors]) -> np.ndarray:
    """Measured over predicted error of each tenth."""
    expected, found = tenths(frames)
    return np.asarray(found / expected)


def fit(frames: list[Errors]) -> Curve:
    """The curve that brings the tenths near 1, by least squares of logarithms."""
    expected, found = tenths(frames)
    slope, bias = np.polyfit(np.log(expected), np.log(np.maximum(found, LEAST_ERROR)), 1)
    return Curve(float(slope), float(bias))


def left_out(found: Kinds) -> Kinds:
    """All frames, with predictions that the curve of the other kinds changed."""
    made: Kinds = {}
    for kind in {kind for kind, _ in found}:
        curve = fit([one for (other, _), frames in found.items() if other != kind
                     for one in frames])
        made |= {key: curve(frames) for key, frames in found.items() if key[0] == kind}
    return made


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
    return f"{name:17} {' '.join(f'{ratio:5.2f}' for ratio in found)}  {right:2} right"


def calibrate(checkpoint: dict[str, Any], curve: Curve, kinds: int) -> dict[str, Any]:
    """A checkpoint whose last layer of the prediction holds a curve; its notes say so."""
    weights = dict(checkpoint["weights"])
    kept = weights[BIAS].dtype
    weights[WEIGHT] = (weights[WEIGHT].float() * curve.slope).to(kept)
    weights[BIAS] = (weights[BIAS].float() * curve.slope + curve.bias).to(kept)
    told = (f"logarithm times {curve.slope:.3f} plus {curve.bias:.3f}, fitted to {kinds} kinds by "
            "training/measure/predicted_error.py")
    return {"config": checkpoint["config"], "weights": weights,
            "notes": checkpoint["notes"] | {"predicted_error": told}}


def report(found: Kinds) -> str:
    """The rows of all kinds, as predicted and with the curves of the others."""
    lines = []
    made = {"all": found}
    if len({kind for kind, _ in found}) > 1:
        made["others' curve"] = left_out(found)
    for name, kinds in made.items():
        for samples in sorted({count for _, count in kinds}):
            lines.append(row(f"{name} {samples}", [one for (_, count), frames in kinds.items()
                                                   if count == samples for one in frames]))
        lines.append(row(name, [one for frames in kinds.values() for one in frames]))
    return "\n".join(lines)


def main(argv: list[str] | None = None) -> None:
    parser = parser_of_kinds(__doc__)
    parser.add_argument("--calibrate", type=Path, metavar="CHECKPOINT",
                        help="checkpoint that --model was exported from")
    parser.add_argument("-o", "--output", type=Path, help="checkpoint to write")
    given = parser.parse_args(argv)
    if (given.calibrate is None) != (given.output is None):
        parser.error("--calibrate and -o go together")
    wanted = list(shots(given.folder, list(filter(None, given.kinds.split(","))), ["1x"], []))
    if not wanted:
        parser.error(f"{given.folder} holds no kinds with references: "
                     "training/measure/validation/render_scenes.py makes them")
    found: Kinds = {}
    for kind in sorted({shot.kind for shot in wanted}):
        mine = [shot for shot in wanted if shot.kind == kind]
        richest = max(mine, key=lambda shot: shot.samples)
        references = References(mine[0], richest, given.model, given.threads)
        for shot in mine:
            found[kind, shot.samples] = list(measure(shot, references, given.model,
                                                     given.threads))
            print(row(f"{kind} {shot.samples}", found[kind, shot.samples]), flush=True)
    print(report(found))
    curve = fit([one for frames in found.values() for one in frames])
    print(f"curve of all: slope {curve.slope:.3f}, bias {curve.bias:.3f}")
    if given.calibrate:
        kinds = len({kind for kind, _ in found})
        save(calibrate(read(given.calibrate), curve, kinds), given.output)


if __name__ == "__main__":
    main()
