"""From filtered radiance at render size to the output: enlarged, given the guides' reflectance, sharpened, and blended
with the history."""
from dataclasses import dataclass

import torch
from torch import Tensor

from training.networks import guide_trust, ops, phases
from training.networks.trunk import BLEND, KERNEL, MIX

MOST_LOG = 20.0  # beyond what is ever kept, as is NaN


@dataclass(frozen=True)
class Reflectance:
    """What guides say of it at output size, (N, 3, H, W), and how far they are trusted, (N, 1, H, W)."""

    factor: Tensor
    trust: Tensor


def resolve(radiance: Tensor, fine: Tensor, jitter: Tensor, warped: Tensor, inside: Tensor,
            guided: Reflectance | None, at: phases.Centres | None = None) -> Tensor:
    """Upsample radiance, sharpen it, and blend it with the reprojected history ``warped``, which is log-encoded, as is
    the result. ``guided`` radiance (N, 6, h, w) is without reflectance and with that of the render size: the first is
    multiplied by the guides' and counts as far as these are trusted. ``at`` says where the output's pixels lie; None:
    they fill the same area. What is broken, NaN or beyond what is ever kept, counts as nothing."""
    n, _, h, w = radiance.shape
    height, width = warped.shape[-2:]
    weights = fine[:, KERNEL:BLEND].reshape(n, 9, 4, h, w)
    controls = fine[:, BLEND:MIX].reshape(n, 2, 4, h, w)
    if at is None:
        controls = phases.interpolate_phases(controls, height, width)
        pictures = phases.upsample(radiance, weights, jitter, height, width)
    else:
        controls = phases.interpolate_at(controls, at)
        pictures = phases.upsample_at(radiance, weights, jitter, at)
    blend, sharpen = controls[:, :, None].unbind(1)
    if guided is not None:
        pictures = (torch.lerp(plain, exact * guided.factor, guided.trust)
                    for exact, plain in (picture.chunk(2, 1) for picture in pictures))
    detail, soft = (ops.log_encode(x) for x in pictures)
    current = (detail + sharpen * (detail - soft)).clamp(min=0)
    current = torch.where(current <= MOST_LOG, current, 0)
    mixed = current + inside * (1 - blend) * (warped - current)  # what is infinite stays so, whatever the share
    return torch.where(mixed <= MOST_LOG, mixed.clamp(min=0), current)  # rounding makes no light negative


def reflectance(factor: Tensor, own: Tensor) -> Reflectance:
    """The guides' ``factor`` (N, 3, H, W), trusted as far as the planes' ``own`` (N, 3, h, w) bears it out."""
    h, w = own.shape[-2:]
    whole = torch.arange(h, device=own.device), torch.arange(w, device=own.device)
    cells = guide_trust.trust(own, factor, whole, h, w, torch.ones_like(own[:, :1]))
    return Reflectance(factor, guide_trust.trust_at(cells, phases.centres(h, w, *factor.shape[-2:], own.device), h, w))
