"""How far guides are trusted to say the reflectance at output size.

Their mean over a render pixel should be what the planes of the render size hold. Where it is not, by as much as the
guides vary, they are noise: one sample a pixel of a texture finer than that, or another surface than the planes show.
"""
import torch
import torch.nn.functional as F
from torch import Tensor

from postfx.kernels.denoise_layout import DOUBT, FAINT, TRUST_CELL
from training.networks import ops
from training.networks.phases import Centres


def trust(own: Tensor, guides: Tensor, at: ops.Place, h: int | Tensor, w: int | Tensor, valid: Tensor) -> Tensor:
    """(N, 1, cells, cells): 1 - DOUBT * apart / spread of cells of 8x8 render pixels, 1 where nothing is ``valid``.

    ``own`` (N, 3, h, w) is the reflectance of the render pixels ``at`` rows and columns of a frame of ``h`` by ``w``,
    ``guides`` (N, 3, H, W) that of the whole frame at output size, ``valid`` (N, 1, h, w) 1 where pixels count, else 0.
    """
    mean, spread = _differences(own, guides, *(ops.span(index, size, full) for index, size, full in zip(
        at, (h, w), guides.shape[-2:], strict=True)))
    apart = mean.square().sum(1, keepdim=True)
    cells = F.avg_pool2d(torch.cat((apart, spread, 3 * torch.ones_like(spread)), 1) * valid, TRUST_CELL, ceil_mode=True)
    apart, spread, count = cells.split(1, 1)
    return 1 - float(DOUBT) * apart / (spread + float(FAINT) * count).clamp(min=ops.TINY)


def trust_at(cells: Tensor, at: Centres, h: int | Tensor, w: int | Tensor) -> Tensor:
    """Trust at output pixels (N, 1, H, W), linear between the centres of cells; ``h`` by ``w`` render pixels of these
    count."""
    across = _between(cells, at.columns + at.x, w, -1)
    return _between(across, at.rows + at.y, h, -2)


def _differences(own: Tensor, guides: Tensor, rows: tuple[Tensor, Tensor],
                 columns: tuple[Tensor, Tensor]) -> tuple[Tensor, Tensor]:
    """Mean relative difference (N, 3, h, w) of the guides from their render pixel, and mean square of it over the
    pixels that this touches, summed over the channels (N, 1, h, w)."""
    mean = spread = torch.zeros((), device=own.device)
    height, width = guides.shape[-2:]
    for k in range(ops.MAX_SPAN):
        down = (rows[0] + k < rows[1]).to(own.dtype) / (rows[1] - rows[0])
        for i in range(ops.MAX_SPAN):
            share = down[:, None] * ((columns[0] + i < columns[1]).to(own.dtype) / (columns[1] - columns[0]))
            found = ops.pick(guides, (rows[0] + k).clamp(max=height - 1), (columns[0] + i).clamp(max=width - 1))
            apart = found / own - 1
            mean, spread = mean + share * apart, spread + share * apart.square().sum(1, keepdim=True)
    return mean, spread


def _between(cells: Tensor, at: Tensor, size: int | Tensor, axis: int) -> Tensor:
    """Values at places in render pixels along an axis."""
    last = (size - 1) // TRUST_CELL
    place = ((at + 0.5) / TRUST_CELL - 0.5).clamp(min=0)
    place = (place - last).clamp(max=0) + last
    before = place.floor()
    after = (before + 1).clamp(max=cells.shape[axis] - 1)
    share = (place - before).to(cells.dtype).unflatten(0, (-1, *[1] * (-1 - axis)))
    return torch.lerp(cells.index_select(axis, before.long()), cells.index_select(axis, after.long()), share)
