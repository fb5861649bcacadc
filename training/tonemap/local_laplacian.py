"""Local tone operator of the built-in looks: a fast local Laplacian filter on log luminance.

Formula: Paris, Hasinoff and Kautz 2011 ("Local Laplacian Filters"), sampled in intensity as in Aubry et al. 2014.
Edges above `sigma` stops are compressed by `beta`, smaller detail is kept or changed by `alpha`; no halos by design.
"""

from __future__ import annotations

import math

import torch
import torch.nn.functional as F

LUMINANCE = (0.2126, 0.7152, 0.0722)
MID_GREY = 0.18
FLOOR = 2.0**-8  # added to luminance before the logarithm, so that noise in black is not stretched


def _blur(x: torch.Tensor) -> torch.Tensor:
    """Binomial 5x5 blur of (N,C,H,W), replicated border."""
    k = torch.tensor([1.0, 4.0, 6.0, 4.0, 1.0], dtype=x.dtype, device=x.device) / 16
    c = x.shape[1]
    x = F.conv2d(F.pad(x, (2, 2, 0, 0), mode="replicate"), k.view(1, 1, 1, 5).expand(c, 1, 1, 5), groups=c)
    return F.conv2d(F.pad(x, (0, 0, 2, 2), mode="replicate"), k.view(1, 1, 5, 1).expand(c, 1, 5, 1), groups=c)


def _down(x: torch.Tensor) -> torch.Tensor:
    """Half size, sampled where `_up` puts it back: any shift between the two would smear to one side at every level."""
    size = [-(-side // 2) for side in x.shape[-2:]]
    return F.interpolate(_blur(x), size=size, mode="bilinear", align_corners=False)


def _up(x: torch.Tensor, size: tuple[int, int]) -> torch.Tensor:
    return F.interpolate(x, size=size, mode="bilinear", align_corners=False)


def _gaussian_pyramid(x: torch.Tensor, levels: int) -> list[torch.Tensor]:
    out = [x]
    for _ in range(levels - 1):
        out.append(_down(out[-1]))
    return out


def _remap(x: torch.Tensor, centre: torch.Tensor, sigma: float, alpha: float, beta: float) -> torch.Tensor:
    """Point-wise curve around `centre`: detail (<= sigma) to the power alpha, edges (> sigma) scaled by beta."""
    d = x - centre
    a = d.abs()
    detail = sigma * (a / sigma).clamp_min(1e-6) ** alpha
    edge = beta * (a - sigma) + sigma
    return centre + d.sign() * torch.where(a <= sigma, detail, edge)


def local_laplacian(x: torch.Tensor, sigma: float, alpha: float, beta: float, step: float = 1.0) -> torch.Tensor:
    """Filter log2 luminance `x` (N,1,H,W) in stops; the coarsest level is compressed by beta around mid grey."""
    levels = max(2, int(min(x.shape[-2:])).bit_length() - 1)
    low, high = float(x.min()), float(x.max())
    count = max(2, int((high - low) / step) + 2)
    centres = torch.linspace(low, high, count, dtype=x.dtype, device=x.device)
    spacing = float(centres[1] - centres[0])
    gauss = _gaussian_pyramid(x, levels)
    centres = centres.view(1, -1, 1, 1)
    remapped = _gaussian_pyramid(_remap(x, centres, sigma, alpha, beta), levels)
    out = []
    for i in range(levels - 1):
        bands = remapped[i] - _up(remapped[i + 1], remapped[i].shape[-2:])
        weights = (1 - (gauss[i] - centres).abs() / spacing).clamp_min(0)
        out.append((bands * weights).sum(1, keepdim=True))
    grey = math.log2(MID_GREY + FLOOR)
    result = grey + beta * (gauss[-1] - grey)
    for i in range(levels - 2, -1, -1):
        result = _up(result, out[i].shape[-2:]) + out[i]
    return result


def compress(rgb: torch.Tensor, sigma: float, alpha: float, beta: float) -> torch.Tensor:
    """Local range compression of exposed scene-linear RGB (N,3,H,W); hue and saturation ratios are kept."""
    weights = torch.tensor(LUMINANCE, dtype=rgb.dtype, device=rgb.device).view(1, 3, 1, 1)
    log = torch.log2((rgb * weights).sum(1, keepdim=True).clamp_min(0) + FLOOR)
    return rgb * torch.exp2(local_laplacian(log, sigma, alpha, beta) - log)
