"""A trunk built as a variant says. It computes no channel that the variant goes without."""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from training.networks.denoise_upscale import DenoiseUpscale
from training.networks.trunk import (
    FEATURES,
    HIDDEN,
    NO_SHARPENING,
    Block,
    weights_from,
)
from training.sweep.variants import Variant

STEM = {1: (3, 1), 2: (4, 1), 4: (4, 0)}
"""Stride of the stem -> its kernel and padding."""


class BareTrunk(nn.Module):
    """Features (N, 27 + hidden, h, w) -> the heads that the variant has, activated, from fine to coarse.

    `fine` (N, sum of `Variant.fine_channels`, h, w); level i (N, taps^2 + 1, h / 2^i, w / 2^i), the coarsest without
    its last channel. Names and order of the modules are those of `training.networks.trunk.Trunk`: with the same options
    the weights are interchangeable.
    """

    def __init__(self, variant: Variant):
        super().__init__()
        self.config, self.align = variant, 2**variant.levels
        w, d = variant.widths, variant.depth
        kernel, padding = STEM[variant.stride]
        self.features = FEATURES - HIDDEN + variant.hidden
        self.stem = nn.Conv2d(self.features, w[0], kernel, stride=variant.stride, padding=padding)
        self.down = nn.ModuleList([Block(w[max(i - 1, 0)], w[i], 1 if i == 0 else d) for i in range(len(w))])
        self.lift = nn.ModuleList([nn.Conv2d(w[i + 1], w[i], 1) for i in range(len(w) - 1)])
        self.up = nn.ModuleList([Block(w[i], w[i], d) for i in range(len(w) - 1)])
        levels = range(1, variant.levels + 1)
        self.heads = nn.ModuleList([self._head(i, variant.kernel + (i < variant.levels)) for i in levels])
        self.fine = self._head(0, sum(variant.fine_channels().values()))
        self._initialise()

    def _source(self, level: int) -> tuple[int, int]:
        """The level of the network that a pyramid level's head reads, and how many times as large the pyramid's is."""
        at = max(0, level - self.config.shift)
        return at, 2 ** (at + self.config.shift - level)

    def _head(self, level: int, channels: int) -> nn.Conv2d:
        at, larger = self._source(level)
        return nn.Conv2d(self.config.widths[at], larger**2 * channels, 1)

    @torch.no_grad()
    def _initialise(self) -> None:
        """As the shipped trunk's: filters that mean, no sharpening."""
        for head in (*self.heads, self.fine):
            nn.init.normal_(head.weight, std=0.01)
            nn.init.zeros_(head.bias)
        phases, sizes = self._source(0)[1] ** 2, list(self.config.fine_channels().values())
        parts = dict(zip(self.config.fine_channels(), self.fine.bias.split([n * phases for n in sizes]), strict=True))
        parts["sharpen"][:] = NO_SHARPENING

    def forward(self, features: Tensor) -> tuple[Tensor, ...]:
        x = F.relu(self.stem(features))
        found = []
        for i, block in enumerate(self.down):
            x = block(F.max_pool2d(x, 2) if i else x)
            found.append(x)
        for i in reversed(range(len(self.up))):
            above = F.interpolate(self.lift[i](found[i + 1]), scale_factor=2.0, mode="nearest")
            found[i] = self.up[i](found[i] + above)
        levels = [self._level(i, found[self._source(i)[0]]) for i in range(1, self.config.levels + 1)]
        return (self._fine(found[0]), *levels)

    def _level(self, level: int, x: Tensor) -> Tensor:
        head = F.pixel_shuffle(self.heads[level - 1](x), self._source(level)[1])
        kernel, mix = head[:, :self.config.kernel], head[:, self.config.kernel:]
        return torch.cat((weights_from(kernel), torch.sigmoid(mix)), 1)

    def _fine(self, x: Tensor) -> Tensor:
        fine = F.pixel_shuffle(self.fine(x), self._source(0)[1])
        weights, gates, hidden = fine.split(fine_parts(self.config), 1)
        return torch.cat((weights_from(weights), torch.sigmoid(gates), torch.tanh(hidden)), 1)


def fine_parts(variant: Variant) -> list[int]:
    """Channels of the fine head that are filter weights, gates and hidden state."""
    sizes = list(variant.fine_channels().values())
    return [sum(sizes[:2]), sum(sizes[2:-1]), sizes[-1]]


class SweepTrunk(BareTrunk):
    """The same with the heads as `DenoiseUpscale` reads them: what the variant goes without is filled in so that it
    does nothing. The hidden state keeps the variant's own number of channels."""

    def forward(self, features: Tensor) -> tuple[Tensor, ...]:
        # A clip's first state is all zeros and as wide as the shipped models': it is cut or filled up.
        missing = self.features - features.shape[1]
        fine, *levels = super().forward(F.pad(features, (0, 0, 0, 0, 0, missing)))
        return (self._filled(fine), *(self._grown(level) for level in levels))

    def _filled(self, fine: Tensor) -> Tensor:
        channels = self.config.fine_channels()
        parts = dict(zip(channels, fine.split(list(channels.values()), 1), strict=True))
        parts["kernel"] = self._grown(parts["kernel"])
        if not channels["blend"]:
            parts["blend"] = fine.new_ones(len(fine), 4, *fine.shape[-2:])
        return torch.cat(list(parts.values()), 1)

    def _grown(self, head: Tensor) -> Tensor:
        """A head that begins with kernels of 3x3 taps as one of 5x5 taps, of which the outer ones weigh nothing."""
        if self.config.taps == 5:
            return head
        kernel, rest = head[:, :9].unflatten(1, (3, 3)), head[:, 9:]
        return torch.cat((F.pad(kernel, (0, 0, 0, 0, 1, 1, 1, 1)).flatten(1, 2), rest), 1)


def build(variant: Variant) -> DenoiseUpscale:
    """The whole recurrent step with the variant's network, untrained."""
    return DenoiseUpscale(trunk=SweepTrunk(variant))
