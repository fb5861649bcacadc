"""Find channels and levels of a denoiser's network that do nothing: restart such channels, cut such
levels.

    python -m training.denoise.prune channels run/checkpoint.pt --clips clips              # a table
    python -m training.denoise.prune channels run/checkpoint.pt --clips clips -o revived.pt  # new
    python -m training.denoise.prune levels denoise_upscale.m --clips clips              # cuts them

channels: a ReLU that is 0 for every input passes no gradient back, so its weights never learn
again. Such channels get random incoming weights and outgoing weights of zero: the network computes
the same as before, and both sides can learn.

levels: if a coarse level's convolutions on the way up are never active, it passes nothing to finer
levels, its own filters are the same everywhere, and those of coarser levels hardly matter. Such
levels are removed and their filters replaced by their means; the pictures stay the same. Run
`training.denoise.fp16` and `training.denoise.quantise` afterwards.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import torch
from torch import Tensor, nn

from postfx.passes.denoise.models import GUIDED, UNSCALED, split_ending
from training.denoise.checkpoint import PREFIX, weights_of
from training.denoise.clips import load
from training.denoise.dataset import Batch, collate, to_batch
from training.denoise.export import card, export_trunk, load_trunk
from training.denoise.model import (
    LEVELS,
    DenoiseUpscale,
    Trunk,
    TrunkConfig,
    empty_state,
    logits_of,
)
from training.export import MODELS, known_recipe, write_card

# Channels -----------------------------------------------------------------------------------------

SHY = 0.01
"""Factor on the usual spread for channels with skip connections: their outgoing weights cannot be
set to zero."""


@torch.no_grad()
def active_channels(model: DenoiseUpscale, batches: Iterable[Batch]) -> dict[str, Tensor]:
    """Module's name -> channels (C,) of each ReLU of the trunk that are above 0 anywhere in the
    batches."""
    active: dict[str, Tensor] = {}

    def watch(name: str) -> Callable[[nn.Module, tuple[Tensor], Tensor], None]:
        def look(module: nn.Module, inputs: tuple[Tensor], output: Tensor) -> None:
            here = (output.flatten(2).amax(2) > 0).any(0)
            active[name] = active[name] | here if name in active else here

        return look

    named = [(name, module)
             for name, module in model.trunk.named_modules() if isinstance(module, nn.ReLU)]
    hooks = [module.register_forward_hook(watch(name)) for name, module in named]
    try:
        for batch in batches:
            state = empty_state(batch.frames[0], *batch.references.shape[-2:])
            for inputs, keep in zip(batch.frames, batch.keep, strict=True):
                _, state, _ = model(inputs, state.drop(keep))
    finally:
        for hook in hooks:
            hook.remove()
    return active


@torch.no_grad()
def revive(config: TrunkConfig, weights: Mapping[str, Tensor],
           active: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """Weights of a `DenoiseUpscale` with restarted channels in place of those that are never
    active."""
    made = {name: weight.clone() for name, weight in weights.items()}
    random = torch.Generator().manual_seed(0)
    for name, channels in active.items():
        dead = ~channels.cpu()
        block, number = name.rsplit(".", 1)
        source = f"trunk.{block}.{int(number) - 1}"
        (targets,
                 skips) = _readers(config, block, int(number))
        weight = made[f"{source}.weight"]
        spread = (2 / weight[0].numel()) ** 0.5 * (SHY if skips else 1)  # He et al. 2015, for ReLU
        fresh = torch.randn(weight.shape, generator=random) * spread
        weight[dead] = fresh[dead].to(weight)
        made[f"{source}.bias"][dead] = 0
        for target in targets:
            made[f"trunk.{target}.weight"][:, dead] = 0
    return made


def _readers(config: TrunkConfig, block: str, number: int) -> tuple[list[str], bool]:
    """The only convolutions of the trunk that read a ReLU of a block, and whether a skip connection
    reads it, too."""
    way, level = block.split(".")[0], int(block.split(".")[1])
    last, top = 2 * (1 if block == "down.0" else config.depth) - 1, len(config.widths) - 1
    if number < last:
        return [f"{block}.{number + 1}"], False
    if way == "up":
        return [f"heads.{level}", f"lift.{level - 1}" if level else "fine"], False
    if level == top:
        return [f"up.{top}.0"] if top + 1 < LEVELS else [f"heads.{top}", f"lift.{top - 1}"], False
    return [f"down.{level + 1}.0"], True


def table(active: Mapping[str, Tensor]) -> str:
    """Lines with the number of active channels of each layer."""
    return "\n".join(f"{name:10} {int(channels.sum()):4} of {channels.numel():4} active"
                     for name, channels in active.items())


def prune_channels(args: argparse.Namespace, parser: argparse.ArgumentParser) -> None:
    """Print how many channels are active and, on request, write a checkpoint that restarts the
    others."""
    checkpoint = torch.load(args.checkpoint, map_location="cpu", weights_only=True)
    config = TrunkConfig.from_dict(checkpoint["config"])
    device = torch.device("cuda" if torch.cuda.is_available() else "cpu")
    model = DenoiseUpscale(config)
    model.load_state_dict({name: weight.float() for name, weight in checkpoint["weights"].items()})
    paths = sorted(args.clips.glob("[!.]*.npz"))[:args.most]
    if not paths:
        parser.error(f"{args.clips} holds no clips: training.datagen.render writes them")
    clips = (load(path, device, config.guides) for path in paths)
    active = active_channels(model.to(device).eval(),
                             (to_batch(collate([clip], [0])) for clip in clips))
    print(f"{len(paths)} clips\n{table(active)}")
    if args.output:
        weights = {name: weight.cpu() for name, weight in model.state_dict().items()}
        torch.save(checkpoint | {"weights": revive(config, weights, active)}, args.output)

# Levels -------------------------------------------------------------------------------------------

class Means:
    """The mean of each channel of the levels' heads."""

    def __init__(self) -> None:
        self._sums: list[Tensor] = []
        self._runs = 0

    def add(self, module: nn.Module, inputs: object, heads: tuple[Tensor, ...]) -> None:
        """Add the outputs of a trunk; a forward hook."""
        means = [level.mean((0, 2, 3)) for level in heads[1:]]
        self._sums = ([a + b for a, b in zip(self._sums, means, strict=True)] if self._sums
                      else means)
        self._runs += 1

    def logits(self, level: int) -> Tensor:
        """Logits of these means, (1, C, 1, 1), of a level counted from 0."""
        return logits_of((self._sums[level] / self._runs)[None, :, None, None])


def first_unused(config: TrunkConfig, active: Mapping[str, Tensor]) -> int | None:
    """The finest level that passes nothing to finer ones, counted from 0."""
    last, rising = 2 * config.depth - 1, min(len(config.widths), LEVELS - 1)
    silent = [level for level in range(1, rising) if not active[f"up.{level}.{last}"].any()]
    return min(silent, default=None)


def cut(config: TrunkConfig, weights: Mapping[str, Tensor], first: int, means: Means) -> Trunk:
    """The network without levels from `first` on."""
    trunk = Trunk(replace(config, widths=config.widths[:first]))
    made = {name: weights[f"{PREFIX}{name}"]
            for name in trunk.state_dict().keys() & _plain(weights)}
    made["rest"] = weights[f"{PREFIX}lift.{first - 1}.bias"][None, :, None, None]
    made |= {f"alike.{i}": means.logits(level) for i, level in enumerate(range(first, LEVELS))}
    trunk.load_state_dict(made)
    return trunk.eval()


def _plain(weights: Mapping[str, Tensor]) -> set[str]:
    """Names of the trunk's weights, except those that stand for cut levels."""
    names = {name.removeprefix(PREFIX) for name in weights}
    return {name for name in names if name != "rest" and not name.startswith("alike.")}


def observe(model: DenoiseUpscale, batches: Iterable[Batch]) -> tuple[dict[str, Tensor], Means]:
    """Active channels and the heads' means over some clips."""
    means = Means()
    hook = model.trunk.register_forward_hook(means.add)
    try:
        return active_channels(model, batches), means
    finally:
        hook.remove()


def prune_levels(args: argparse.Namespace, parser: argparse.ArgumentParser) -> None:
    """Cut the levels that a model does not use, and write it again with its card."""
    path = args.models / f"{args.name}.onnx"
    facts, weights = json.loads(path.with_suffix(".json").read_text()), weights_of(path)
    ending = split_ending(args.name)[1]
    config = TrunkConfig.from_dict(facts["config"])
    model = DenoiseUpscale(config)
    model.load_state_dict(weights)
    found = (load(clip, torch.device("cpu"), ending == GUIDED)
             for clip in sorted(args.clips.glob("[!.]*.npz")))
    clips = [clip for clip in found
             if ending != UNSCALED or clip.reference.shape[-2:] == clip.planes.shape[-2:]]
    if not clips:
        parser.error(f"{args.clips} holds no clips for {args.name}: training.datagen.render writes "
                     "them")
    active, means = observe(model.eval(), (to_batch(collate([clip], [0])) for clip in clips))
    first = first_unused(config, active)
    if first is None:
        print(f"{args.name} uses all its levels: nothing is cut")
        return
    trunk = cut(config, weights, first, means)
    notes = {key: value for key, value in facts["training"].items() if key != "script"}
    checkpoint = {"config": trunk.config.as_dict(), "notes": notes,
                  "weights": {PREFIX + key: value for key, value in trunk.state_dict().items()}}
    error = export_trunk(load_trunk(checkpoint), path)
    recipe = known_recipe(path.with_suffix(".json"))
    write_card(path, card(checkpoint, facts["tag"], error, facts["quality"]) | recipe)
    print(f"{len(clips)} clips: nothing comes from level {first + 1} of {len(config.widths)} or "
          "beyond")


# Commands -----------------------------------------------------------------------------------------

def options() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(dest="command", required=True)
    channels = commands.add_parser("channels", help="find channels that are never active")
    channels.add_argument("checkpoint", type=Path, help="checkpoint.pt of training.denoise.train")
    channels.add_argument("--most", type=int, default=40,
                          help="number of clips to examine (default: 40)")
    channels.add_argument("-o", "--output", type=Path,
                          help="where to write the checkpoint with restarted channels")
    levels = commands.add_parser("levels", help="cut levels that pass nothing to finer ones")
    levels.add_argument("name",
                        help="float32 model of the library, as denoise_upscale.m or "
                        "denoise_upscale.m.1x")
    levels.add_argument("-o", "--models", type=Path, default=MODELS,
                        help="where the model is read and written")
    for command in (channels, levels):
        command.add_argument("--clips", type=Path, required=True, help="folder of clips to examine")
    channels.set_defaults(act=prune_channels, parser=channels)
    levels.set_defaults(act=prune_levels, parser=levels)
    return parser


def main(argv: Sequence[str] | None = None) -> None:
    args = options().parse_args(argv)
    args.act(args, args.parser)


if __name__ == "__main__":
    main()
