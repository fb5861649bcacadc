"""The compute kernels of the mixture with another denoiser as torch modules with the kernels' own
bindings, for export to ONNX. `postfx.kernels.partner` explains them.
"""

import torch
from torch import Tensor, nn

from postfx.kernels.partner import MOST_LIGHT, MOST_MOVED
from training import ops


def encode(light: Tensor) -> Tensor:
    """Logarithm of exposed light, with its sign."""
    known = torch.where(light == light, light, torch.zeros_like(light))
    return torch.sign(known) * torch.log1p(known.abs().clamp(max=float(MOST_LIGHT)))


def decode(coded: Tensor) -> Tensor:
    """The inverse of `encode`."""
    return torch.sign(coded) * torch.expm1(coded.abs())


class MixPartner(nn.Module):
    """colour, partner, history (H, W, 3), motion (H, W, 2), weight, strength (H, W, 1), settings
    (4,) -> output (H, W, 3); motion, weight and strength may have one pixel."""

    def forward(self, colour: Tensor, partner: Tensor, history: Tensor, motion: Tensor,
                weight: Tensor, strength: Tensor, settings: Tensor) -> Tensor:
        exposure = settings[0]
        acting = ops.sanitise(settings[3], 0, 1) * ops.sanitise(strength, 0, 1)
        share = acting * ops.sanitise(weight, 0, 1)
        most = settings[1] * torch.minimum(share, acting - share)
        own = encode(exposure * colour)
        apart = encode(exposure * partner) - own
        mean = own + share * apart
        before, known = self._before(history, motion)
        reach = most * apart.abs()
        held = torch.minimum(torch.maximum(encode(exposure * before), mean - reach), mean + reach)
        mixed = decode(torch.where(known & (settings[2] > 0), held, mean)) / exposure
        same = ((share == 0) | (apart == 0)) & (colour.abs() < torch.inf)
        return torch.where(same, colour, mixed)

    def _before(self, history: Tensor, motion: Tensor) -> tuple[Tensor, Tensor]:
        """The history at the places where pixels were, and whether these lie in the picture."""
        height, width = history.shape[:2]
        rows = torch.arange(height, dtype=torch.float32)[:, None]
        columns = torch.arange(width, dtype=torch.float32)[None]
        possible = (motion.abs() < float(MOST_MOVED)).all(-1)
        moved = torch.where(possible[..., None], motion, torch.zeros_like(motion))
        y, x = rows + moved[..., 1], columns + moved[..., 0]
        known = possible & (y >= 0) & (y <= height - 1) & (x >= 0) & (x <= width - 1)
        y = torch.where(known, y, torch.zeros_like(y))
        x = torch.where(known, x, torch.zeros_like(x))
        top, left = y.floor(), x.floor()
        v, u = (y - top)[..., None], (x - left)[..., None]
        above, first = top.long(), left.long()
        under, last = (above + 1).clamp(max=height - 1), (first + 1).clamp(max=width - 1)
        upper = history[above, first] + u * (history[above, last] - history[above, first])
        lower = history[under, first] + u * (history[under, last] - history[under, first])
        return upper + v * (lower - upper), known[..., None]


class EnlargeMotion(nn.Module):
    """motion (h, w, 2), rows (H,) and columns (W,), positions in it, ratio (2,) -> enlarged (H, W,
    2)."""

    def forward(self, motion: Tensor, rows: Tensor, columns: Tensor, ratio: Tensor) -> Tensor:
        down = rows.round().long().clamp(0, motion.shape[0] - 1)
        across = columns.round().long().clamp(0, motion.shape[1] - 1)
        moved = motion.index_select(0, down).index_select(1, across)
        possible = moved.abs() < float(MOST_MOVED)
        return torch.where(possible, moved * ratio, torch.full_like(moved, float(MOST_MOVED)))
