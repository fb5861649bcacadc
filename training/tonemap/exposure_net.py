"""A learnt exposure in front of a cube: how many stops to add, from how a picture's light is spread.

What is learnt is how far from mid grey a scene belongs. It is a function of the levels that shares of the pixels are
below, counted from the geometric mean, which goes to mid grey before: so an exposure that is off is put right by
construction, and one number exposes all of a picture.
"""

from __future__ import annotations

import math

import torch
import torch.nn.functional as F
from torch import nn

from postfx.colour.primaries import LUMA_REC2020
from training.tonemap.looks import BLACK, MID_GREY
from training.tonemap.model import SHAPER, SIDE, Shaper, look_up, lowres, shape

SHARES = (0.001, 0.01, 0.1, 0.5, 0.9, 0.99, 0.999)  # of the pixels, which are below a level
WIDTH = 64
TYPICAL = 4.0  # stops: levels are given to the network in units of it
FARTHEST = 8.0  # stops that are added or taken; what is black stays black


def levels(low: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Of shaped colour (N,3,256,256), its every second row and column: the mean of the log2 of the luminance (N,1), and
    the levels of SHARES (N,7) in stops from it."""
    toe, scale = SHAPER
    light = (torch.exp2(low[..., ::2, ::2] / scale) - 1) * toe
    luminance = (light * low.new_tensor(LUMA_REC2020).view(1, 3, 1, 1)).sum(1)
    log = torch.log2(luminance.clamp_min(0) + BLACK)
    mean, pixels = log.mean(2).mean(1, keepdim=True), (SIDE // 2) ** 2  # row by row: less is lost of a float32
    ranks = torch.tensor([round(share * (pixels - 1)) for share in SHARES], device=low.device)
    return mean, log.flatten(1).sort(1).values.index_select(1, ranks) - mean  # Gather: GatherND does not replay on GPUs


class Exposure(nn.Module):
    """4,737 parameters and a cube (size,size,size,3). `forward` is what is exported: lowres -> (stops (N,1), cube)."""

    def __init__(self, cube: torch.Tensor) -> None:
        super().__init__()
        sizes = (len(SHARES), WIDTH, WIDTH, 1)
        self.dense = nn.ModuleList([nn.Linear(*pair) for pair in zip(sizes, sizes[1:], strict=False)])
        self.cube = nn.Parameter(cube, requires_grad=False)

    def key(self, levels: torch.Tensor) -> torch.Tensor:
        """Stops (...,1) from mid grey at which the mean of (...,7) levels belongs."""
        x = levels / TYPICAL
        for layer in self.dense[:-1]:
            x = F.relu(layer(x))
        return self.dense[-1](x)

    def stops(self, mean: torch.Tensor, levels: torch.Tensor) -> torch.Tensor:
        """Stops (...,1) to add where the luminance has this mean (...,1) and these levels (...,7)."""
        return math.log2(MID_GREY) - mean + self.key(levels)

    def forward(self, low: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        return self.stops(*levels(low)).clamp(-FARTHEST, FARTHEST), self.cube

    def render(self, colour: torch.Tensor, shaper: Shaper) -> torch.Tensor:
        """Scene-linear (N,3,H,W) -> display (N,3,H,W) in [0,1], as the run-time does it."""
        stops, cube = self(lowres(colour, shaper))
        return look_up(shape(colour * torch.exp2(stops)[..., None, None], *shaper), cube)
