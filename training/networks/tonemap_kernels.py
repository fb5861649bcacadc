"""The tone mapper's compute kernels as torch modules with the kernels' own bindings: what is exported to ONNX."""

from __future__ import annotations

import torch
from torch import nn

from training.networks import hdrnet


def to_image(colour: torch.Tensor) -> torch.Tensor:
    """(H,W,3) -> (1,3,H,W)."""
    return colour.permute(2, 0, 1)[None]


class SliceApply(nn.Module):
    """colour (H,W,3), params (3,), guide (112,), grid (1,16,16,8,12) -> output (H,W,3)."""

    def forward(
        self, colour: torch.Tensor, params: torch.Tensor, guide: torch.Tensor, grid: torch.Tensor
    ) -> torch.Tensor:
        return hdrnet.slice_apply(to_image(colour), params, guide, grid)[0].permute(1, 2, 0)


class Lowres(nn.Module):
    """colour (H,W,3), params (3,) -> lowres (1,3,256,256)."""

    def forward(self, colour: torch.Tensor, params: torch.Tensor) -> torch.Tensor:
        return hdrnet.lowres(to_image(colour), params)


class Smooth(nn.Module):
    """previous, current (1,16,16,8,12), keep (1,) -> result (1,16,16,8,12)."""

    def forward(self, previous: torch.Tensor, current: torch.Tensor, keep: torch.Tensor) -> torch.Tensor:
        return hdrnet.smooth(previous, current, keep)


class EncodeSrgb(nn.Module):
    """colour (H,W,3) linear, exposure (1,) -> output (H,W,3): clip to [0, 1], then the curve of IEC 61966-2-1."""

    def forward(self, colour: torch.Tensor, exposure: torch.Tensor) -> torch.Tensor:
        x = colour * exposure
        x = torch.where(x > 0, x, torch.zeros_like(x)).clamp_max(1.0)  # NaN compares false
        bright = 1.055 * x.clamp_min(0.0031308) ** (1 / 2.4) - 0.055
        return torch.where(x <= 0.0031308, 12.92 * x, bright)


class Checkerboard(nn.Module):
    """rows (H,), columns (W,), greys (2,) -> output (H,W,3): the first grey where row and column are the same."""

    def forward(self, rows: torch.Tensor, columns: torch.Tensor, greys: torch.Tensor) -> torch.Tensor:
        grey = torch.where(rows[:, None] == columns[None, :], greys[0], greys[1])
        return grey[:, :, None].repeat(1, 1, 3)
