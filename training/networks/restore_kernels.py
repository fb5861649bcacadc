"""The kernels of ``postfx.kernels.denoise_restore`` as torch modules: what is exported to ONNX. Pictures (H, W, C)."""
import math

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from postfx.kernels.denoise_restore import (
    CLEAN,
    COUNT,
    DARK,
    FAINT,
    FILTERED,
    FIRST,
    HELD,
    LAGS,
    LIMIT,
    NEAR,
    POWER,
    SPREAD_NOISE,
    STRUCTURE,
    TILE,
)
from training.networks import ops
from training.networks.denoise_upscale import MAX_FLOAT

TINY = 1e-12


class Judge(nn.Module):
    """colour, denoised (h, w, 3), params -> sums (tiles_high, tiles_wide, 11): pixels, power, held power, products."""

    def forward(self, colour: Tensor, denoised: Tensor, params: Tensor) -> Tensor:
        clean = light(denoised, params)
        seen = clean.clamp(min=DARK)
        slope = 0.5 / (torch.sqrt(seen * (1 + seen)) * (1 + seen))
        removed = ((light(colour, params) - clean) * slope).clamp(-1, 1)
        tile, count = tiles(removed), tiles(torch.ones_like(removed)).sum((1, 3))
        power = tile.square().sum((1, 3))
        limit = (LIMIT * torch.sqrt(power / count))[:, None, :, None]
        held = torch.minimum(torch.maximum(tile, -limit), limit)
        products = []
        for dy, dx in LAGS:
            here = held[:, :TILE - dy, :, max(0, -dx):TILE - max(0, dx)]
            there = held[:, dy:, :, max(0, dx):TILE + min(0, dx)]
            products.append((here * there).sum((1, 3)) * (TILE**2 / ((TILE - dy) * (TILE - abs(dx)))))
        return torch.stack((count, power, held.square().sum((1, 3)), *products), -1)


class Detail(nn.Module):
    """sums (tiles_high, tiles_wide, 11), evidence (1,) -> detail (tiles_high, tiles_wide, 1).

    It is the share to give back.
    """

    def forward(self, sums: Tensor, evidence: Tensor) -> Tensor:
        spread = binomial(binomial(sums, 0), 1)
        power = spread[..., POWER] / spread[..., COUNT]
        weight = torch.sqrt(power) * sums[..., COUNT]
        total = weight.sum().clamp(min=TINY)
        found = spread[..., FIRST:] / (spread[..., HELD:FIRST] + TINY)
        common = F.pad((found * weight[..., None]).sum((0, 1))[:NEAR].clamp(min=0) / total, (0, len(LAGS) - NEAR))
        mean = sums[..., POWER].sum() / sums[..., COUNT].sum()
        filtered = ramp(torch.log(mean + TINY), math.log(FILTERED[0]), math.log(FILTERED[1]))
        structure = (found - filtered * common).square().sum(-1) - SPREAD_NOISE * len(LAGS) / spread[..., COUNT]
        faint = ramp(-torch.log(power + TINY), -math.log(FAINT[1]), -math.log(FAINT[0]))
        own = torch.maximum(ramp(torch.sqrt(structure.clamp(min=0)), *STRUCTURE), faint) * evidence.clamp(max=1)
        clean = ramp((own * weight).sum() / total * evidence, *CLEAN)
        return (own + (1 - own) * clean)[..., None]


class Restore(nn.Module):
    """colour, denoised (h, w, 3), detail (tiles_high, tiles_wide, 1) -> output (h, w, 3)."""

    def forward(self, colour: Tensor, denoised: Tensor, detail: Tensor) -> Tensor:
        share = between(between(detail, colour.shape[0], 0), colour.shape[1], 1)
        noisy = ops.sanitise(colour, 0, MAX_FLOAT)
        return torch.where(share == 1, noisy, denoised + (noisy - denoised) * share)


def light(colour: Tensor, params: Tensor) -> Tensor:
    """Exposed luminance (h, w), within what the network sees."""
    exposed = (ops.sanitise(colour, 0, MAX_FLOAT) * params[0]).clamp(max=ops.MAX_COLOUR)
    return 0.2126 * exposed[..., 0] + 0.7152 * exposed[..., 1] + 0.0722 * exposed[..., 2]


def tiles(image: Tensor) -> Tensor:
    """(h, w) -> (tiles_high, TILE, tiles_wide, TILE), zero beyond the picture."""
    h, w = image.shape
    padded = F.pad(image[None], (0, -w % TILE, 0, -h % TILE))[0]
    return padded.unflatten(0, (-1, TILE)).unflatten(2, (-1, TILE))


def binomial(sums: Tensor, axis: int) -> Tensor:
    """Weighted by 1 2 1 along an axis; nothing lies beyond the border."""
    nothing = torch.zeros_like(sums.narrow(axis, 0, 1))
    size = sums.shape[axis]
    padded = torch.cat((nothing, sums, nothing), axis)
    return padded.narrow(axis, 0, size) + 2 * sums + padded.narrow(axis, 2, size)


def ramp(value: Tensor, low: float, high: float) -> Tensor:
    return ((value - low) / (high - low)).clamp(0, 1)


def between(values: Tensor, size: int, axis: int) -> Tensor:
    """Values of tiles at the pixels of an axis, linear between the tiles' centres."""
    last = values.shape[axis] - 1
    at = ((torch.arange(size) + 0.5) / TILE - 0.5).clamp(0, last)
    first = at.floor().long()
    part = (at - first).unflatten(0, (-1, *[1] * (values.ndim - 1 - axis)))
    one, other = values.index_select(axis, first), values.index_select(axis, (first + 1).clamp(max=last))
    return one + (other - one) * part
