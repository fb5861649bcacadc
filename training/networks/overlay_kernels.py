"""The compute kernels of transparency overlays as torch modules with the kernels' own bindings: exported to ONNX.

Overlays are premultiplied RGBA, (h, w, 4).
"""
import torch
from torch import Tensor, nn

from training.networks import ops
from training.networks.window import to_image, to_picture


def known(values: Tensor) -> Tensor:
    """0 for what is not finite."""
    return torch.where(values.abs() < torch.inf, values, torch.zeros_like(values))


class Enlarge(nn.Module):
    """image (h, w, 4), rows (H,) and columns (W,), positions in the image -> output (H, W, 4)."""

    def forward(self, image: Tensor, rows: Tensor, columns: Tensor) -> Tensor:
        cubic = to_picture(ops.resample(to_image(image), rows, columns))
        alpha, colour = cubic[..., 3:].clamp(0, 1), cubic[..., :3]
        low, high = straight(known(image))
        for axis, positions in ((0, rows), (1, columns)):
            near = [(positions.floor() + k).clamp(0, image.shape[axis] - 1).long() for k in range(2)]
            low = torch.minimum(*(low.index_select(axis, index) for index in near))
            high = torch.maximum(*(high.index_select(axis, index) for index in near))
        colour = torch.where(high.abs() < torch.inf, torch.minimum(colour, high * alpha), colour)
        colour = torch.where(low.abs() < torch.inf, torch.maximum(colour, low * alpha), colour)
        return torch.cat((colour, alpha), -1)


def straight(image: Tensor) -> tuple[Tensor, Tensor]:
    """Colour of what covers a pixel, as least and as largest one: infinite where light comes from what covers nothing,
    an empty range where there is nothing at all."""
    light, alpha = image[..., :3], image[..., 3:]
    infinite = torch.full_like(light, torch.inf)
    own = torch.where(light > 0, infinite, -infinite)
    own = torch.where(alpha > 0, light / alpha, own)
    nothing = (alpha <= 0) & (light == 0)
    return torch.where(nothing, infinite, own), torch.where(nothing, -infinite, own)


class Over(nn.Module):
    """overlay (H, W, 4), colour (H, W, 3) -> output (H, W, 3)."""

    def forward(self, overlay: Tensor, colour: Tensor) -> Tensor:
        return over(known(overlay[..., :3]), ops.sanitise(overlay[..., 3:], 0, 1), known(colour))


class OverAlpha(nn.Module):
    """overlay (H, W, 4), alpha (H, W, 1) -> output (H, W, 1)."""

    def forward(self, overlay: Tensor, alpha: Tensor) -> Tensor:
        covered = ops.sanitise(overlay[..., 3:], 0, 1)
        return over(covered, covered, known(alpha))


def over(front: Tensor, alpha: Tensor, behind: Tensor) -> Tensor:
    """Porter and Duff 1984, premultiplied."""
    return front + (1 - alpha) * behind
