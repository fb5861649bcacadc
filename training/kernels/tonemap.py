"""The tone mapper's compute kernels as torch modules with the kernels' own bindings, for export to
ONNX."""

from __future__ import annotations

import torch
from torch import nn

from postfx.colour import LUMA_REC2020
from postfx.kernels.colour import BRIGHTEST, DARK, STEPS
from training.tonemap import model as network
from training.tonemap.model import Shaper, look_up, shape


def to_image(colour: torch.Tensor) -> torch.Tensor:
    """(H,W,3) -> (1,3,H,W)."""
    return colour.permute(2, 0, 1)[None]


def make_finite(colour: torch.Tensor) -> torch.Tensor:
    """NaN becomes 0, infinities finite."""
    return torch.where(colour == colour, colour, torch.zeros_like(colour)).clamp(-float(BRIGHTEST),
                                                                                 float(BRIGHTEST))


def look_up_code(table: torch.Tensor, share: torch.Tensor) -> torch.Tensor:
    """A table between its entries, at a share of it in [0, 1]."""
    place = share * STEPS
    index = place.long()
    low = table[index]
    return low + (place - index) * (table[index + 1] - low)


class SliceApply(nn.Module):
    """colour (H,W,3), params (3,), matrix (9,), guide (112,), grid (1,16,16,8,12), cube
    (S,S,S,3) -> output (H,W,3)."""

    def forward(
        self,
        colour: torch.Tensor,
        params: torch.Tensor,
        matrix: torch.Tensor,
        guide: torch.Tensor,
        grid: torch.Tensor,
        cube: torch.Tensor,
    ) -> torch.Tensor:
        return network.slice_apply(to_image(colour), Shaper(params, matrix), guide, grid,
                                   cube)[0].permute(1, 2, 0)


class ApplyCube(nn.Module):
    """colour (H,W,3), params (3,), matrix (9,), cube (S,S,S,3) -> output (H,W,3), tetrahedral
    between the corners."""

    def forward(
        self, colour: torch.Tensor, params: torch.Tensor, matrix: torch.Tensor, cube: torch.Tensor
    ) -> torch.Tensor:
        return look_up(shape(to_image(colour), params, matrix), cube)[0].permute(1, 2, 0)


class ConvertPrimaries(nn.Module):
    """colour (H,W,3), matrix (9,) -> output (H,W,3)."""

    def forward(self, colour: torch.Tensor, matrix: torch.Tensor) -> torch.Tensor:
        # A matrix product would be rounded to TF32 on a GPU.
        return (colour[:, :, None, :] * matrix.view(3, 3)).sum(-1)


class Lowres(nn.Module):
    """colour (H,W,3), params (3,), matrix (9,) -> lowres (1,3,256,256)."""

    def forward(self, colour: torch.Tensor, params: torch.Tensor,
                matrix: torch.Tensor) -> torch.Tensor:
        return network.lowres(to_image(colour), Shaper(params, matrix))


class Light(nn.Module):
    """lowres (1,3,256,256) -> light (256,3)."""

    def forward(self, lowres: torch.Tensor) -> torch.Tensor:
        return network.light(lowres)


class Follow(nn.Module):
    """light (256,3), params (4,), before (1,4) -> after (1,4)."""

    def forward(self, light: torch.Tensor, params: torch.Tensor,
                before: torch.Tensor) -> torch.Tensor:
        return network.follow(light, params, before)


class Smooth(nn.Module):
    """previous, current (1,16,16,8,12), keep (1,4) -> result (1,16,16,8,12)."""

    def forward(self, previous: torch.Tensor, current: torch.Tensor,
                keep: torch.Tensor) -> torch.Tensor:
        return network.smooth(previous, current, keep)


class Expose(nn.Module):
    """previous (3,), current (1,1), keep (1,4), params (3,) -> result (3,)."""

    def forward(
        self, previous: torch.Tensor, current: torch.Tensor, keep: torch.Tensor,
        params: torch.Tensor
    ) -> torch.Tensor:
        return network.expose(previous, current, keep, params)


class EncodeDisplay(nn.Module):
    """colour (H,W,3), params (12,), decode (4098,), encode (4098,) -> output (H,W,3), code values
    of a display."""

    def forward(
        self, colour: torch.Tensor, params: torch.Tensor, decode: torch.Tensor, encode: torch.Tensor
    ) -> torch.Tensor:
        x = make_finite(colour)
        x = torch.where(params[9] > 0, look_up_code(decode, x.clamp(0, 1)), x)
        light = (x @ params[:9].reshape(3, 3).T).clamp_min(0).minimum(params[10])
        luminance = (light * light.new_tensor(LUMA_REC2020)).sum(-1, keepdim=True)
        light = (light * luminance.clamp_min(DARK) ** params[11]).clamp_max(1)
        return look_up_code(encode, light.sqrt().sqrt().sqrt())


class Checkerboard(nn.Module):
    """rows (H,), columns (W,), greys (2,) -> output (H,W,3): the first grey where row and column
    are the same."""

    def forward(self, rows: torch.Tensor, columns: torch.Tensor,
                greys: torch.Tensor) -> torch.Tensor:
        grey = torch.where(rows[:, None] == columns[None, :], greys[0], greys[1])
        return grey[:, :, None].repeat(1, 1, 3)
