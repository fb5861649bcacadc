"""How well the plane `error` predicts: measured over predicted error, by tenths of the prediction.

    python -m training.measure.predicted_error FOLDER [--model xl] [--kinds water,fog]
        [--calibrate CHECKPOINT -o OUT.pt]

FOLDER holds one folder for each kind, as for `training.measure.table`. Only frames with two
references count, each of which has noise of its own: the mean product of the differences to both
is the squared error without that noise. All pixels of the sequences are sorted by the error that
was predicted for them, and divided into ten equal parts; for each the mean of the measured squared
error is divided by the mean of the predicted one. 1 is right. Errors are those of code values at
the exposure of the run.

The last rows are of predictions that a curve has changed: the logarithm times a slope, plus a bias,
fitted to all other kinds, so that each is right by the tenths in what it was not fitted to.
--calibrate writes the network of a checkpoint, of which --model is the export, with the curve of
all kinds. Its pictures stay the same to the bit.
"""

from __future__ import annotations

import argparse
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
LOW = 0.8
"""Least ratio of a measured error to the predicted one with which a part counts as right."""
HIGH = 1.25
"""The largest."""
LEAST_ERROR = 1e-7
"""A tenth's least squared error: the noise that is taken out may leave nothing."""


@dataclass(frozen=True)
class Errors:
    """Squared errors of the pixels of one frame, (height, width): what was predicted, and what was
    measured without the noise of references, which can be below 0 in single pixels."""

    predicted: np.ndarray
    measured: np.ndarray


Kinds = dict[tuple[str, int], list[Errors]]
"""Kind and samples a pixel -> frames."""


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
    measured = np.concatenate([one.measured.ravel() for one in frames])
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


def measure(shot: Shot, model: str, threads: int) -> Iterator[Errors]:
    """The frames of a shot that have two references."""
    denoise = DenoiseUpscale(scale=1.0, model=model, error=True)
    pipeline = Pipeline([denoise], Device("cpu", threads))
    noisy, references = Sequence(shot.noisy), [Sequence(shot.reference), Sequence(shot.second)]
    measured = references[1].numbers
    for number in noisy.numbers:
        result: Frame = pipeline(noisy.read(number))
        if number not in measured:
            continue
        exposure = pipeline.exposure_factor or 1.0
        found = to_codes(result[Role.COLOUR], exposure)
        first, second = (
            found - to_codes(sequence.read(number, [Role.COLOUR])[Role.COLOUR], exposure)
            for sequence in references)
        yield Errors(result[Role.ERROR][:, :, 0].copy(), (first * second).mean(axis=2))


def row(name: str, frames: list[Errors]) -> str:
    """A line of the table: the ratios, and how many of them are right."""
    found = ratios(frames)
    right = sum(LOW <= ratio <= HIGH for ratio in found)
    return f"{name:17} {' '.join(f'{ratio:5.2f}' for ratio in found)}  {right:2} right"


def calibrate(checkpoint: dict[str, Any], curve: Curve, kinds: int) -> dict[str, Any]:
    """A checkpoint that predicts by a curve; its notes say so.

    The curve goes into the last layer of the prediction, or, where the network itself reads the
    prediction to guard its history, behind that.
    """
    config, weights = dict(checkpoint["config"]), dict(checkpoint["weights"])
    if config.get("guarded"):
        config["error_slope"] = config.get("error_slope", 1.0) * curve.slope
        config["error_bias"] = config.get("error_bias", 0.0) * curve.slope + curve.bias
    else:
        kept = weights[BIAS].dtype
        weights[WEIGHT] = (weights[WEIGHT].float() * curve.slope).to(kept)
        weights[BIAS] = (weights[BIAS].float() * curve.slope + curve.bias).to(kept)
    told = (f"logarithm times {curve.slope:.3f} plus {curve.bias:.3f}, fitted to {kinds} kinds by "
            "training/measure/predicted_error.py")
    return {"config": config, "weights": weights,
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


def options() -> argparse.ArgumentParser:
    """Options of the command."""
    parser = parser_of_kinds(__doc__)
    parser.add_argument("--calibrate", type=Path, metavar="CHECKPOINT",
                        help="checkpoint that --model was exported from")
    parser.add_argument("-o", "--output", type=Path, help="checkpoint to write")
    return parser


def main(argv: list[str] | None = None) -> None:
    parser = options()
    given = parser.parse_args(argv)
    if (given.calibrate is None) != (given.output is None):
        parser.error("--calibrate and -o go together")
    kinds = list(filter(None, given.kinds.split(",")))
    wanted = [shot for shot in shots(given.folder, kinds, ["1x"], [])
              if any(shot.folder.glob("second.*.exr"))]
    if not wanted:
        parser.error(f"{given.folder} holds no kinds with two references: "
                     "training/measure/validation/render_scenes.py makes them, with --second")
    found: Kinds = {}
    for shot in wanted:
        found[shot.kind, shot.samples] = list(measure(shot, given.model, given.threads))
        print(row(f"{shot.kind} {shot.samples}", found[shot.kind, shot.samples]), flush=True)
    print(report(found))
    curve = fit([one for frames in found.values() for one in frames])
    print(f"curve of all: slope {curve.slope:.3f}, bias {curve.bias:.3f}")
    if given.calibrate:
        count = len({kind for kind, _ in found})
        save(calibrate(read(given.calibrate), curve, count), given.output)


if __name__ == "__main__":
    main()
