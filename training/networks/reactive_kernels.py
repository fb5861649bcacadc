"""The kernels of the reactive mask as torch modules: see ``postfx.kernels.denoise_reactive``."""
import torch
import torch.nn.functional as F
from torch import Tensor, nn

from postfx.kernels.denoise_layout import MAX_FLOAT
from postfx.kernels.denoise_reactive import SPREAD
from training.networks import ops
from training.networks.window import part, to_image, to_picture


def seen(colour: Tensor, exposure: Tensor) -> Tensor:
    """Exposed light as a display shows it, 0 to 1."""
    light = (ops.sanitise(colour, 0, MAX_FLOAT) * exposure).clamp(max=ops.MAX_COLOUR)
    return torch.sqrt(light / (1 + light))


class Reactive(nn.Module):
    """colour, opaque_colour (h, w, 3), difference (3,): exposure, scale, threshold -> reactive (h, w, 1)."""

    def forward(self, colour: Tensor, opaque_colour: Tensor, difference: Tensor) -> Tensor:
        exposure, scale, threshold = difference.unbind()
        most = (seen(colour, exposure) - seen(opaque_colour, exposure)).abs().amax(-1, keepdim=True)
        return torch.where(most >= threshold, (most * scale).clamp(max=1), torch.zeros_like(most))


class Spread(nn.Module):
    """reactive (h, w, 1) -> next_reactive (h, w, 1)."""

    def forward(self, reactive: Tensor) -> Tensor:
        return to_picture(F.max_pool2d(to_image(ops.sanitise(reactive, 0, 1)), 2 * SPREAD + 1, 1, SPREAD))


class Keep(nn.Module):
    """reactive, last_reactive (h, w, 1), moved (th, tw, 2), part_rows (th,), part_columns (tw,) -> keep (th, tw, 1)."""

    def forward(self, reactive: Tensor, last_reactive: Tensor, moved: Tensor, rows: Tensor, columns: Tensor) -> Tensor:
        place = rows.long(), columns.long()
        before = ops.warp_nearest(to_image(last_reactive), to_image(moved), place)
        return to_picture(1 - torch.maximum(ops.sanitise(part(reactive, *place), 0, 1), before))
