"""The shaper and the colour cube of the tone mapper, in torch: (N,3,H,W) colour, cubes (size,size,size,3) red first.

`shape` and `look_up` are the definitions of `postfx.kernels.shaper` and `postfx.kernels.cube`.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import torch
import torch.nn.functional as F

from postfx.colour.primaries import REC709, REC2020, matrix_between

CUBE = 33  # corners along an axis
TOE, WHITE = 2.0**-8, 2.0**8
SHAPER = (TOE, 1.0 / math.log2(1.0 + WHITE / TOE))  # scene-linear values; 1.0 is reached at WHITE


LARGEST = 1e10  # stands for infinity
TO_WORKING = matrix_between(REC709, REC2020)


class Shaper(NamedTuple):
    """params (3,): exposure, toe, scale; matrix (9,) row-major, from Rec.709: as the kernels take them."""

    params: torch.Tensor
    matrix: torch.Tensor


def default_shaper(device: torch.device | str = "cpu", exposure: float = 1.0) -> Shaper:
    """The shaper that the tone mapper is trained with."""
    numbers = (exposure, *SHAPER), TO_WORKING.ravel()
    return Shaper(*(torch.tensor(x, dtype=torch.float32, device=device) for x in numbers))


def shape(colour: torch.Tensor, params: torch.Tensor, matrix: torch.Tensor) -> torch.Tensor:
    """log2(1 + exposure * x / toe) * scale in [0, 1] of x, colour in other primaries; params: (exposure, toe, scale).

    NaN becomes 0; light above the range is scaled down to it, all channels alike.
    """
    clean = torch.where(colour == colour, colour, torch.zeros_like(colour)).clamp(-LARGEST, LARGEST)
    light = F.conv2d(clean, matrix.view(3, 3, 1, 1)).clamp_min(0.0) * (params[0] / params[1])
    most = torch.exp2(1.0 / params[2]) - 1.0
    fit = most / torch.maximum(light.amax(1, keepdim=True), most)
    return (torch.log2(1.0 + light * fit) * params[2]).clamp_max(1.0)


def look_up(shaped: torch.Tensor, cube: torch.Tensor) -> torch.Tensor:
    """Tetrahedral look-up of (N,3,H,W), clipped to [0, 1]."""
    size = cube.shape[0]
    at = shaped.clamp(0.0, 1.0) * (size - 1.0)
    corner = at.detach().floor().clamp_max(size - 2.0)
    r, g, b = (at - corner).unbind(1)
    high, low = torch.maximum(torch.maximum(r, g), b), torch.minimum(torch.minimum(r, g), b)
    middle = torch.maximum(torch.minimum(r, g), torch.minimum(torch.maximum(r, g), b))
    red, green, blue = (torch.full_like(r, value, dtype=torch.long) for value in (size * size, size, 1))
    step = torch.where((r >= g) & (r >= b), red, torch.where(g >= b, green, blue))
    last = torch.where((r >= b) & (g >= b), blue, torch.where(r >= g, green, red))
    i, j, k = corner.long().unbind(1)
    first = i * red + j * green + k
    fourth = first + (size * size + size + 1)
    corners, weights = (first, first + step, fourth - last, fourth), (1.0 - high, high - middle, middle - low, low)
    flat = cube.reshape(-1, 3)
    total = sum(F.embedding(index, flat) * weight[..., None] for index, weight in zip(corners, weights, strict=True))
    return total.permute(0, 3, 1, 2)


def lattice(size: int = CUBE) -> np.ndarray:
    """Exposed linear Rec.709 (size,size,size,3) that the shaper takes to the cube's corners; float32.

    Corners outside Rec.709 are negative in one or two channels.
    """
    toe, scale = SHAPER
    axis = toe * (np.exp2(np.linspace(0.0, 1.0 / scale, size)) - 1.0)
    light = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), -1)
    return (light @ np.linalg.inv(TO_WORKING).T).astype(np.float32)
