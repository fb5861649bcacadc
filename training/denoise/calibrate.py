"""Calibrate the error that a picture network predicts: fit the last layer of the prediction anew.

    python -m training.denoise.calibrate CHECKPOINT --clips FOLDER FOLDER ... -o OUT.pt

A mixture of networks, or a change of other layers, moves what the prediction reads. The prediction
is one layer of 1x1 pixels, the natural logarithm of the expected squared error; nothing else reads
it, so the pictures stay the same to the bit. It is fitted on clips of `training.datagen` (.npz;
folders are searched with those below) so that it gives the mean of the squared error. Errors
count relative to the prediction: small ones are to be right as well as large ones. Weights are held
near those of the training, which saw more clips.

Prints measured over predicted error by tenths of the prediction, before and after: of clips that a
fit without them was tried on, one in five at a time.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from postfx.passes.denoise.network import FEATURE_PARTS
from training.denoise.checkpoint import PREFIX, read, save
from training.denoise.dataset import Clip, collate, compared, load, to_batch
from training.denoise.export import export_trunk, load_trunk
from training.denoise.loss import display
from training.denoise.model import empty_state
from training.denoise.picture import PictureDenoiser, PictureNetwork

DRAWN = 3000
"""Pixels of each frame that are kept."""
FOLDS = 5
PARTS = 10
HOLD = 0.01
"""Weight of the squared change of the layer beside the mean loss of a pixel, for inputs of variance
1."""
STEPS = 60
"""Of the fit at most; it converges in fewer."""
WEIGHT, BIAS = f"{PREFIX}error.weight", f"{PREFIX}error.bias"


@dataclass(frozen=True)
class Pixels:
    """What the layer reads (pixels, channels), the squared errors of code values (pixels,), without
    the references' noise in the mean, and the number of each pixel's clip (pixels,)."""

    inputs: Tensor
    squared: Tensor
    clips: Tensor


@dataclass(frozen=True)
class Layer:
    """The last layer of the prediction: weights (channels,) and a bias (1,)."""

    weight: Tensor
    bias: Tensor

    def __call__(self, inputs: Tensor) -> Tensor:
        """Logarithm of the expected squared error."""
        return inputs @ self.weight + self.bias


class Reader:
    """Runs the trunk of a network by ONNX Runtime, which takes a fifth of PyTorch's time on a CPU,
    and keeps what the last layer of the prediction reads."""

    def __init__(self, trunk: PictureNetwork) -> None:
        import onnx
        import onnxruntime

        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "trunk.onnx"
            export_trunk(trunk, path)
            model = onnx.load(path)
        layer = next(node for node in model.graph.node
                     if any(name.startswith("error.weight") for name in node.input))
        model.graph.output.append(onnx.helper.make_empty_tensor_value_info(layer.input[0]))
        self._session = onnxruntime.InferenceSession(model.SerializeToString(),
                                                     providers=["CPUExecutionProvider"])
        self.read: Tensor = torch.empty(0)

    def __call__(self, features: Tensor, mirrored: Tensor) -> tuple[Tensor, ...]:
        """As the trunk's `forward`; in place of the planes, which training alone looks at, it gives
        the picture."""
        parts = features.split(list(FEATURE_PARTS.values()), 1)
        given = {name: part.numpy() for name, part in
                 zip((*FEATURE_PARTS, "mirrored"), (*parts, mirrored), strict=True)}
        picture, controls, error, read = map(torch.from_numpy, self._session.run(None, given))
        self.read = read
        return picture, controls, error, picture


def squared_error(output: Tensor, clip: Clip, variant: int, frame: int) -> Tensor:
    """Squared error (h, w) of the display-encoded ``output`` (3, h, w) of one frame of a render, in
    the mean without the noise of the reference.

    The product of the differences from the two halves of a reference; the render of one half is
    compared with the other half, whose noise is as large as its own.
    """
    reference = clip.reference[frame].float() * clip.exposure
    if clip.half is None:
        return (output - display(reference)).square().mean(0)
    second = clip.half[frame].float() * clip.exposure
    one, other = display(2 * reference - second), display(second)
    if clip.halved[variant]:
        return ((output - other).square() - (one - other).square() / 2).mean(0)
    return ((output - one) * (output - other)).mean(0)


@torch.no_grad()
def observe(checkpoint: dict[str, Any], paths: Sequence[Path]) -> Pixels:
    """Pixels of all renders of clips at the render's size."""
    trunk = load_trunk(checkpoint)
    assert isinstance(trunk, PictureNetwork)
    reader, denoiser = Reader(trunk), PictureDenoiser(trunk)
    trunk.forward = reader  # type: ignore[method-assign]
    generator = torch.Generator().manual_seed(0)
    found = []
    for number, path in enumerate(paths):
        clip = load(path, torch.device("cpu"), blank_volumes=False)
        if clip.planes.shape[-2:] != clip.reference.shape[-2:]:
            continue
        for variant in compared(clip):
            for inputs, squared in _frames(denoiser, reader, clip, variant):
                drawn = torch.randperm(squared.numel(), generator=generator)[:DRAWN]
                found.append((inputs.flatten(1).T[drawn], squared.flatten()[drawn],
                              torch.full((len(drawn),), number)))
    if not found:
        raise ValueError("no clips of the render's size: training.datagen.render makes them")
    return Pixels(*(torch.cat(parts) for parts in zip(*found, strict=True)))


def _frames(denoiser: PictureDenoiser, reader: Reader, clip: Clip,
            variant: int) -> Iterator[tuple[Tensor, Tensor]]:
    """What the layer reads (channels, h, w) and the squared errors (h, w), frame by frame."""
    batch = to_batch(collate([clip], [variant]))
    height, width = batch.references.shape[-2:]
    state = empty_state(batch.frames[0], height, width)
    for frame, (inputs, keep) in enumerate(zip(batch.frames, batch.keep, strict=True)):
        step = denoiser.step(inputs, state.drop(keep))
        state = step.state
        squared = squared_error(display(step.output)[0], clip, variant, frame)
        yield reader.read[0, :, :height, :width], squared


def fit(pixels: Pixels, begin: Layer) -> Layer:
    """The layer with the least mean of squared / expected + log(expected), near the one that it
    begins with.

    The least value is at the mean of the squared error, and each pixel counts relative to what is
    expected of it.
    """
    mean, spread = pixels.inputs.mean(0), pixels.inputs.std(0).clamp(min=1e-6)
    inputs = ((pixels.inputs - mean) / spread).double()
    held = torch.cat((begin.weight * spread, begin(mean))).double()
    inputs = torch.cat((inputs, torch.ones(len(inputs), 1, dtype=torch.double)), 1)
    squared = pixels.squared.double()
    values = held.clone().requires_grad_()
    optimiser = torch.optim.LBFGS([values], max_iter=STEPS, line_search_fn="strong_wolfe")

    def loss() -> Tensor:
        optimiser.zero_grad()
        predicted = inputs @ values
        found: Tensor = ((squared * torch.exp(-predicted) + predicted).mean()
                         + HOLD * (values - held)[:-1].square().sum())
        found.backward()  # type: ignore[no-untyped-call]
        return found

    optimiser.step(loss)
    found = values.detach().float()
    weight = found[:-1] / spread
    return Layer(weight, found[-1:] - weight @ mean)


def ratios(layer: Layer, pixels: Pixels) -> list[float]:
    """Measured over predicted error of each tenth of the pixels, from the least prediction to the
    largest."""
    expected = layer(pixels.inputs).exp()
    order = expected.argsort()
    return [float(pixels.squared[part].mean() / expected[part].mean())
            for part in order.tensor_split(PARTS)]


def held_back(pixels: Pixels, begin: Layer) -> list[float]:
    """`ratios` of fits without every fifth clip on those clips, the mean over the folds."""
    found = []
    for fold in range(FOLDS):
        out = pixels.clips % FOLDS == fold
        if not out.any() or out.all():
            continue
        layer = fit(_of(pixels, ~out), begin)
        found.append(ratios(layer, _of(pixels, out)))
    return list(np.mean(found, axis=0)) if found else []


def _of(pixels: Pixels, chosen: Tensor) -> Pixels:
    return Pixels(pixels.inputs[chosen], pixels.squared[chosen], pixels.clips[chosen])


def calibrate(checkpoint: dict[str, Any], paths: Sequence[Path]) -> dict[str, Any]:
    """A checkpoint whose predicted error is fitted to clips; its notes say so."""
    weights = dict(checkpoint["weights"])
    begin = Layer(weights[WEIGHT].float().flatten(), weights[BIAS].float())
    pixels = observe(checkpoint, paths)
    layer = fit(pixels, begin)
    clips = int(pixels.clips.unique().numel())
    print(f"{clips} clips, {len(pixels.squared)} pixels; measured over predicted, by tenths")
    for name, found in (("before", ratios(begin, pixels)), ("after", ratios(layer, pixels)),
                        ("held back", held_back(pixels, begin))):
        print(f"{name:9}", *(f"{ratio:5.2f}" for ratio in found))
    weights[WEIGHT] = layer.weight.reshape(weights[WEIGHT].shape).to(weights[WEIGHT])
    weights[BIAS] = layer.bias.to(weights[BIAS])
    notes = checkpoint["notes"] | {"error": f"its last layer fitted to {clips} clips of the same "
                                   "making, by training/denoise/calibrate.py"}
    return {"config": checkpoint["config"], "weights": weights, "notes": notes}


def main(argv: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("checkpoint", type=Path, help="of a picture network")
    parser.add_argument("--clips", type=Path, nargs="+", required=True, metavar="FOLDER")
    parser.add_argument("-o", "--output", type=Path, required=True, help="checkpoint to write")
    args = parser.parse_args(argv)
    checkpoint = read(args.checkpoint)
    if WEIGHT not in checkpoint["weights"]:
        parser.error(f"{args.checkpoint}: predicts no error: give a picture network")
    paths = [path for folder in args.clips for path in sorted(folder.rglob("[!.]*.npz"))]
    try:
        save(calibrate(checkpoint, paths), args.output)
    except (OSError, ValueError) as fault:
        parser.error(str(fault))


if __name__ == "__main__":
    main()
