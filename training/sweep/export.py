"""A variant's network as ONNX, with the activations of its heads."""

from __future__ import annotations

from pathlib import Path

import torch
from torch import Tensor, nn

from training.export import export, parity
from training.networks.trunk import weights_from
from training.sweep.trunk import BareTrunk, fine_parts
from training.sweep.variants import Variant


class ExportedTrunk(BareTrunk):
    """The same numbers; a head and its pixel shuffle are one transposed convolution for each activation: neither the
    shuffle, which runs on one thread, nor the slices that select channels are left."""

    def __init__(self, trunk: BareTrunk):
        super().__init__(trunk.config)
        self.load_state_dict(trunk.state_dict())
        self.fine_parts = parts_of(self.fine, self._source(0)[1], fine_parts(trunk.config))
        rest = [trunk.config.kernel, 1]
        self.level_parts = nn.ModuleList(
            parts_of(head, self._source(i)[1], rest if i < trunk.config.levels else rest[:1])
            for i, head in enumerate(self.heads, 1))

    def _fine(self, x: Tensor) -> Tensor:
        return activated(self.fine_parts, x)

    def _level(self, level: int, x: Tensor) -> Tensor:
        if self._source(level)[1] == 1:
            return super()._level(level, x)
        return activated(self.level_parts[level - 1], x)


def parts_of(head: nn.Conv2d, larger: int, sizes: list[int]) -> nn.ModuleList:
    """Transposed convolutions that give `sizes` channels of a head each, `larger` times as large; none for 0 channels.

    The bias, which differs from phase to phase, is the weight of one more input. Where the size stays, they are plain
    convolutions.
    """
    inputs = head.in_channels
    weight = head.weight.detach().reshape(-1, larger, larger, inputs).permute(3, 0, 1, 2)
    bias = head.bias.detach().reshape(1, -1, larger, larger)
    modules = []
    for share in [share for share in torch.cat((weight, bias)).split(sizes, 1) if share.shape[1]]:
        if larger == 1:
            part = nn.Conv2d(inputs + 1, share.shape[1], 1, bias=False)
            share = share.transpose(0, 1)
        else:
            part = nn.ConvTranspose2d(inputs + 1, share.shape[1], larger, stride=larger, bias=False)
        part.weight = nn.Parameter(share.contiguous())
        modules.append(part)
    return nn.ModuleList(modules)


def activated(parts: nn.ModuleList, x: Tensor) -> Tensor:
    """The heads' filter weights, gates and hidden state, those of them that there are."""
    padded = torch.cat((x, torch.ones_like(x[:, :1])), 1)
    activations = (weights_from, torch.sigmoid, torch.tanh)
    return torch.cat([activate(part(padded)) for part, activate in zip(parts, activations, strict=False)], 1)


def export_variant(variant: Variant, weights: dict[str, Tensor], path: Path) -> float:
    """Write the network; returns its largest relative error to torch. Raises ParityError."""
    trunk = BareTrunk(variant)
    trunk.load_state_dict({key.removeprefix("trunk."): value.half().float() for key, value in weights.items()})
    align, names = trunk.align, outputs(variant)
    # torch checks that the sizes of skip connections match, so it must know what the input is a multiple of.
    free = {2: align * torch.export.Dim("rows", min=1), 3: align * torch.export.Dim("columns", min=1)}
    shapes = {"features": (1, trunk.features, "height", "width")}
    shapes |= {name: (1, channels, "?", "?") for name, channels in names.items()}
    export(ExportedTrunk(trunk), [example(trunk, 2, 3)], ["features"], list(names), path, [free], shapes)
    return parity(trunk, path, [example(trunk, 3, 5)], {"height": 3 * align, "width": 5 * align})


def outputs(variant: Variant) -> dict[str, int]:
    """Names of the network's outputs and their channels."""
    levels = {f"level{i}": variant.kernel + (i < variant.levels) for i in range(1, variant.levels + 1)}
    return {"fine": sum(variant.fine_channels().values())} | levels


def example(trunk: BareTrunk, rows: int, columns: int) -> Tensor:
    """Features with the range of real ones, so many times as large as they must be a multiple of."""
    generator = torch.Generator().manual_seed(0)
    shape = (1, trunk.features, rows * trunk.align, columns * trunk.align)
    return torch.rand(*shape, generator=generator) * 2 - 0.5
