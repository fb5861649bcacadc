"""From render size to output size: kernels and controls at the four quarter-pixel corners of a render pixel, NCHW.

The corners are where output centres lie at scale 2; at other scales what was predicted there is interpolated.
"""
from typing import NamedTuple

import torch
import torch.nn.functional as F
from torch import Tensor

from training.networks.ops import TINY, nearest_index, pick, shifted

PHASE_TAPS = 3
SAMPLE_SIGMA = 0.5  # render pixels: a sample says little about what lies farther away
BLUR_SIGMA = 1.0  # what sharpening is measured against


class Centres(NamedTuple):
    """Render pixels that hold the centres of output rows and columns, and the centres' offsets from theirs."""

    rows: Tensor
    y: Tensor
    columns: Tensor
    x: Tensor


def centres(h: int, w: int, height: int, width: int, device: torch.device) -> Centres:
    """Of a whole picture."""
    return Centres(*nearest_index(h, height, device), *nearest_index(w, width, device))


def corner_index(size: int, out_size: int, device: torch.device) -> Tensor:
    """For each of ``size`` pixels the output pixels that hold its points at 1/4 and 3/4: (2, size)."""
    quarters = 4 * torch.arange(size, device=device) + torch.tensor([[1], [3]], device=device)
    return quarters * out_size // (4 * size)


def tap_offsets(device: torch.device) -> Tensor:
    """(9, 2) offsets x, y of the 3x3 neighbourhood, rows first."""
    line = torch.arange(-1.0, 2.0, device=device)
    y, x = torch.meshgrid(line, line, indexing="ij")
    return torch.stack((x, y), -1).reshape(-1, 2)


def sample_prior(jitter: Tensor, x: Tensor, y: Tensor, sigma: float = SAMPLE_SIGMA) -> Tensor:
    """Gaussian weight of each 3x3 tap by the distance from its sample to the output pixel.

    ``jitter`` (N, 2) in render pixels; ``x`` and ``y`` are offsets of output centres from their render pixel's
    centre. Returns (N, 9, len(y), len(x)).
    """
    sample = tap_offsets(jitter.device)[None] + jitter[:, None]
    gx = torch.exp(-((sample[..., 0:1] - x) ** 2) / (2 * sigma**2))
    gy = torch.exp(-((sample[..., 1:2] - y) ** 2) / (2 * sigma**2))
    return gy[..., :, None] * gx[..., None, :]


def interpolate_phases(phases: Tensor, height: int, width: int) -> Tensor:
    """(N, C, 4, h, w), one value at each quarter-pixel corner (rows first), to output size (N, C, H, W).

    Between the corners values are linear, beyond them constant. At scale 2 output centres are the corners.
    """
    n, c, _, h, w = phases.shape
    if (height, width) == (2 * h, 2 * w):
        return F.pixel_shuffle(phases.reshape(n, c * 4, h, w), 2)
    return interpolate_any(phases, height, width)


def interpolate_any(phases: Tensor, height: int, width: int) -> Tensor:
    """The same without the short cut of scale 2."""
    return interpolate_at(phases, centres(*phases.shape[-2:], height, width, phases.device))


def interpolate_at(phases: Tensor, at: Centres) -> Tensor:
    """The same at some rows and columns."""
    ty, tx = (2 * at.y + 0.5).clamp(0, 1)[:, None], (2 * at.x + 0.5).clamp(0, 1)
    at = pick(phases, at.rows, at.columns)
    top = at[:, :, 0] * (1 - tx) + at[:, :, 1] * tx
    bottom = at[:, :, 2] * (1 - tx) + at[:, :, 3] * tx
    return top * (1 - ty) + bottom * ty


def upsample(radiance: Tensor, weights: Tensor, jitter: Tensor, height: int, width: int) -> tuple[Tensor, Tensor]:
    """Radiance at output size, twice: by predicted 3x3 weights (N, 9, 4, h, w) times the prior of ``sample_prior``,
    and softened by a wide Gaussian, against which the first can be sharpened."""
    h, w = radiance.shape[-2:]
    if (height, width) == (2 * h, 2 * w):
        return upsample_double(radiance, weights, jitter)
    return upsample_any(radiance, weights, jitter, height, width)


def upsample_double(radiance: Tensor, weights: Tensor, jitter: Tensor) -> tuple[Tensor, Tensor]:
    """Scale 2, where the four output pixels of a render pixel lie at its corners: all work at render size."""
    n, channels, h, w = radiance.shape
    taps = shifted(radiance, PHASE_TAPS, "replicate")
    corners = torch.arange(2, device=radiance.device) * 0.5 - 0.25
    blend = weights * sample_prior(jitter, corners, corners).reshape(-1, 9, 4, 1, 1)
    wide = sample_prior(jitter, corners, corners, BLUR_SIGMA).reshape(-1, 9, 4, 1, 1)
    return tuple(F.pixel_shuffle(torch.stack([weighted_mean(taps, x[:, :, p]) for p in range(4)], 2)
                                 .reshape(n, 4 * channels, h, w), 2) for x in (blend, wide))


def upsample_any(radiance: Tensor, weights: Tensor, jitter: Tensor, height: int, width: int) -> tuple[Tensor, Tensor]:
    """Any scale."""
    return upsample_at(radiance, weights, jitter, centres(*radiance.shape[-2:], height, width, radiance.device))


def upsample_at(radiance: Tensor, weights: Tensor, jitter: Tensor, at: Centres) -> tuple[Tensor, Tensor]:
    """The same at some rows and columns."""
    blend = interpolate_at(weights, at) * sample_prior(jitter, at.x, at.y)
    taps = pick(shifted(radiance, PHASE_TAPS, "replicate"), at.rows, at.columns)
    return weighted_mean(taps, blend), weighted_mean(taps, sample_prior(jitter, at.x, at.y, BLUR_SIGMA))


def weighted_mean(taps: Tensor, weights: Tensor) -> Tensor:
    """Mean over the taps of (N, C, K, h, w) by weights (N, K, h, w), or (N, K, 1, 1)."""
    return (taps * weights[:, None]).sum(2) / weights.sum(1)[:, None].clamp(min=TINY)
