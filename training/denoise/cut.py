"""Cut the coarse levels of a denoiser's network that it makes no use of; its pictures stay what they were.

    python -m training.denoise.cut denoise_upscale.m --clips clips

A level whose convolutions on the way up are never active passes nothing on to finer levels, and its own filters are the
same everywhere; those of coarser ones hardly weigh. The network goes without such levels, and their filters are the
means of what they were. Run `training.denoise.fp16` and `training.denoise.quantise` after it.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path

import torch
from torch import Tensor, nn

from postfx.passes.denoise.models import GUIDED, UNSCALED, parted
from training.denoise.dataset import Batch, collate, load, to_batch
from training.denoise.export import card, export_trunk, load_trunk
from training.denoise.model import LEVELS, DenoiseUpscale, Trunk, TrunkConfig, logits_of
from training.denoise.restore import PREFIX, weights_of
from training.denoise.revive import active_channels
from training.export import MODELS, write_card


class Means:
    """The mean of each channel of the levels' heads."""

    def __init__(self) -> None:
        self._sums: list[Tensor] = []
        self._runs = 0

    def add(self, module: nn.Module, inputs: object, heads: tuple[Tensor, ...]) -> None:
        """Note what a trunk gives; a forward hook."""
        means = [level.mean((0, 2, 3)) for level in heads[1:]]
        self._sums = [a + b for a, b in zip(self._sums, means, strict=True)] if self._sums else means
        self._runs += 1

    def logits(self, level: int) -> Tensor:
        """What would give them, of a level counted from 0: (1, C, 1, 1)."""
        return logits_of((self._sums[level] / self._runs)[None, :, None, None])


def first_unused(config: TrunkConfig, active: Mapping[str, Tensor]) -> int | None:
    """The finest level that passes nothing on, counted from 0."""
    last, rising = 2 * config.depth - 1, min(len(config.widths), LEVELS - 1)
    silent = [level for level in range(1, rising) if not active[f"up.{level}.{last}"].any()]
    return min(silent, default=None)


def cut(config: TrunkConfig, weights: Mapping[str, Tensor], first: int, means: Means) -> Trunk:
    """The network without levels from `first` on."""
    trunk = Trunk(replace(config, widths=config.widths[:first]))
    made = {name: weights[f"{PREFIX}{name}"] for name in trunk.state_dict().keys() & _plain(weights)}
    made["rest"] = weights[f"{PREFIX}lift.{first - 1}.bias"][None, :, None, None]
    made |= {f"alike.{i}": means.logits(level) for i, level in enumerate(range(first, LEVELS))}
    trunk.load_state_dict(made)
    return trunk.eval()


def _plain(weights: Mapping[str, Tensor]) -> set[str]:
    """Names of weights in the trunk, but for those that stand for cut levels."""
    names = {name.removeprefix(PREFIX) for name in weights}
    return {name for name in names if name != "rest" and not name.startswith("alike.")}


def looked_at(model: DenoiseUpscale, batches: Iterable[Batch]) -> tuple[dict[str, Tensor], Means]:
    """Active channels and the heads' means over some clips."""
    means = Means()
    hook = model.trunk.register_forward_hook(means.add)
    try:
        return active_channels(model, batches), means
    finally:
        hook.remove()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("name", help="float32 model of the library, as denoise_upscale.m or denoise_upscale.m.1x")
    parser.add_argument("--clips", type=Path, required=True, help="folder of clips to look at")
    parser.add_argument("-o", "--models", type=Path, default=MODELS, help="where the model is read and written")
    args = parser.parse_args()
    path = args.models / f"{args.name}.onnx"
    facts, weights, ending = json.loads(path.with_suffix(".json").read_text()), weights_of(path), parted(args.name)[1]
    config = TrunkConfig.from_dict(facts["config"])
    model = DenoiseUpscale(config)
    model.load_state_dict(weights)
    found = (load(clip, torch.device("cpu"), ending == GUIDED) for clip in sorted(args.clips.glob("[!.]*.npz")))
    clips = [clip for clip in found if ending != UNSCALED or clip.reference.shape[-2:] == clip.planes.shape[-2:]]
    if not clips:
        parser.error(f"{args.clips} holds no clips for {args.name}: training.datagen.render writes them")
    active, means = looked_at(model.eval(), (to_batch(collate([clip], [0])) for clip in clips))
    first = first_unused(config, active)
    if first is None:
        parser.error(f"{args.name} makes use of all its levels")
    trunk = cut(config, weights, first, means)
    notes = {key: value for key, value in facts["training"].items() if key != "script"}
    checkpoint = {"config": trunk.config.as_dict(), "notes": notes,
                  "weights": {PREFIX + key: value for key, value in trunk.state_dict().items()}}
    error = export_trunk(load_trunk(checkpoint), path)
    write_card(path, card(checkpoint, facts["tag"], error, facts["quality"]))
    print(f"{len(clips)} clips: nothing comes from level {first + 1} of {len(config.widths)} or beyond")


if __name__ == "__main__":
    main()
