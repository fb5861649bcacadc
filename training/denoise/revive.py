"""Find channels of a denoiser's network that are never active, and let training begin anew with them.

    python -m training.denoise.revive run/checkpoint.pt --clips clips                       # a table of layers
    python -m training.denoise.revive run/checkpoint.pt --clips clips -o revived.pt         # for train --start

A ReLU that is 0 for every input passes no gradient back, so what feeds it never learns again. Such channels get random
incoming weights and outgoing weights of zero: the network computes what it did, and both sides can learn.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Mapping
from pathlib import Path

import torch
from torch import Tensor, nn

from training.denoise.dataset import Batch, collate, load, to_batch
from training.denoise.model import LEVELS, DenoiseUpscale, TrunkConfig, empty_state

SHY = 0.01
"""Part of the usual spread for channels that skip connections add to others: what they reach cannot be set to zero."""


@torch.no_grad()
def active_channels(model: DenoiseUpscale, batches: Iterable[Batch]) -> dict[str, Tensor]:
    """Which channels (C,) of every ReLU of the trunk are above 0 anywhere in the batches, by the module's name."""
    active: dict[str, Tensor] = {}

    def watch(name: str):
        def look(module: nn.Module, inputs: tuple[Tensor], output: Tensor) -> None:
            here = (output.flatten(2).amax(2) > 0).any(0)
            active[name] = active[name] | here if name in active else here

        return look

    named = [(name, module) for name, module in model.trunk.named_modules() if isinstance(module, nn.ReLU)]
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
def revive(config: TrunkConfig, weights: Mapping[str, Tensor], active: Mapping[str, Tensor],
           seed: int = 0) -> dict[str, Tensor]:
    """Weights of a `DenoiseUpscale` with another start for the channels that are not active."""
    made, random = {name: weight.clone() for name, weight in weights.items()}, torch.Generator().manual_seed(seed)
    for name, channels in active.items():
        dead = ~channels.cpu()
        block, number = name.rsplit(".", 1)
        source, (targets, skips) = f"trunk.{block}.{int(number) - 1}", _readers(config, block, int(number))
        weight = made[f"{source}.weight"]
        spread = (2 / weight[0].numel()) ** 0.5 * (SHY if skips else 1)  # He et al. 2015, for ReLU
        fresh = torch.randn(weight.shape, generator=random) * spread
        weight[dead] = fresh[dead].to(weight)
        made[f"{source}.bias"][dead] = 0
        for target in targets:
            made[f"trunk.{target}.weight"][:, dead] = 0
    return made


def _readers(config: TrunkConfig, block: str, number: int) -> tuple[list[str], bool]:
    """Convolutions of the trunk that alone read a ReLU of a block, and whether a skip connection reads it, too."""
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
    """Lines that tell how many channels of each layer are active."""
    return "\n".join(f"{name:10} {int(channels.sum()):4} of {channels.numel():4} active"
                     for name, channels in active.items())


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("checkpoint", type=Path, help="as training.denoise.train leaves it")
    parser.add_argument("--clips", type=Path, required=True, help="folder of clips to look at")
    parser.add_argument("--most", type=int, default=40, help="clips to look at (default: 40)")
    parser.add_argument("-o", "--output", type=Path, help="where to write the checkpoint with another start")
    args = parser.parse_args()
    checkpoint = torch.load(args.checkpoint, map_location="cpu", weights_only=True)
    config = TrunkConfig.from_dict(checkpoint["config"])
    device = torch.device("cuda" if torch.cuda.is_available() else "cpu")
    model = DenoiseUpscale(config)
    model.load_state_dict({name: weight.float() for name, weight in checkpoint["weights"].items()})
    paths = sorted(args.clips.glob("[!.]*.npz"))[:args.most]
    if not paths:
        parser.error(f"{args.clips} holds no clips: training.datagen.render writes them")
    clips = (load(path, device, config.guides) for path in paths)
    active = active_channels(model.to(device).eval(), (to_batch(collate([clip], [0])) for clip in clips))
    print(f"{len(paths)} clips\n{table(active)}")
    if args.output:
        weights = {name: weight.cpu() for name, weight in model.state_dict().items()}
        torch.save(checkpoint | {"weights": revive(config, weights, active)}, args.output)


if __name__ == "__main__":
    main()
