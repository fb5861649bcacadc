"""The tone mapper's networks: HDRNet (Gharbi et al. 2017, "Deep Bilateral Learning for Real-Time
Image Enhancement") between a shaper and a cube, and a learnt exposure before a cube.

The grid of colour matrices handles what depends on position and picture, the cube what depends on
colour alone. The network also sees the picture's histogram: exposure is a function of it, and
convolutions are slow to learn that. Input is scene-linear Rec.709, output sRGB-encoded in [0, 1].
Layout of all tensors here: (N, C, H, W). `slice_apply` and `lowres` are the definitions of the
compute kernels of the same names in `postfx.kernels`.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
import torch.nn.functional as F
from torch import nn

from postfx.colour import LUMA_REC2020, REC709, REC2020, matrix_between
from postfx.kernels.tonemap import BROKEN, JUMP, LAG, MOST, MOST_STOPS, RELEASE
from postfx.system import models_dir

# Cubes --------------------------------------------------------------------------------------------
# The shaper and the colour cube of the tone mapper, in torch: (N,3,H,W) colour, cubes
# (size,size,size,3) red first.
#
# `shape` and `look_up` define kernels of `postfx.kernels.colour`.

MID_GREY = 0.18
BLACK = 2.0**-16  # added to luminance before its logarithm
CUBE = 33  # corners along an axis
TOE = 2.0**-8
"""Scene-linear value below which the shaper is about linear."""
WHITE = 2.0**8
"""Scene-linear value at which the shaper reaches 1."""
SHAPER = (TOE, 1.0 / math.log2(1.0 + WHITE / TOE))
"""Toe and scale of `shape`."""


LARGEST = 1e10  # stands for infinity
TO_WORKING = matrix_between(REC709, REC2020)


class Shaper(NamedTuple):
    """The kernels' arguments: params (3,): exposure, toe, scale; matrix (9,), row-major, from
    Rec.709."""

    params: torch.Tensor
    matrix: torch.Tensor


def default_shaper(device: torch.device | str = "cpu", exposure: float = 1.0) -> Shaper:
    """The shaper that the tone mapper is trained with."""
    numbers = (exposure, *SHAPER), TO_WORKING.ravel()
    return Shaper(*(torch.tensor(x, dtype=torch.float32, device=device) for x in numbers))


def shape(colour: torch.Tensor, params: torch.Tensor, matrix: torch.Tensor) -> torch.Tensor:
    """log2(1 + exposure * x / toe) * scale in [0, 1] of x, colour in other primaries; params:
    (exposure, toe, scale).

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
    red, green, blue = (torch.full_like(r, value, dtype=torch.long)
                        for value in (size * size, size, 1))
    step = torch.where((r >= g) & (r >= b), red, torch.where(g >= b, green, blue))
    last = torch.where((r >= b) & (g >= b), blue, torch.where(r >= g, green, red))
    i, j, k = corner.long().unbind(1)
    first = i * red + j * green + k
    fourth = first + (size * size + size + 1)
    corners = (first, first + step, fourth - last, fourth)
    weights = (1.0 - high, high - middle, middle - low, low)
    flat = cube.reshape(-1, 3)
    total = sum(F.embedding(index, flat) * weight[..., None]
                for index, weight in zip(corners, weights, strict=True))
    return total.permute(0, 3, 1, 2)


def lattice(size: int = CUBE) -> np.ndarray:
    """Exposed linear Rec.709 (size,size,size,3) that the shaper maps to the cube's corners;
    float32.

    Corners outside Rec.709 are negative in one or two channels.
    """
    toe, scale = SHAPER
    axis = toe * (np.exp2(np.linspace(0.0, 1.0 / scale, size)) - 1.0)
    light = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), -1)
    return (light @ np.linalg.inv(TO_WORKING).T).astype(np.float32)


# The network --------------------------------------------------------------------------------------

SIDE = 256  # side of the copy that the coefficients are computed on
CELLS = 16
"""Cells of the grid along either axis of the picture."""
DEPTH = 8
"""Guide levels of a cell."""
COEFFICIENTS = 12  # 3x4 affine colour matrix, row-major
KNOTS = 16
BINS = 32  # of the histogram
FOURTH = 4  # the copy is reduced by this factor to count the guide levels of a cell
TRUST = 0.2
"""Share of a cell's pixels that weighs as much as all neighbours."""
NONE = 1e-4
"""Added to the share of each level, as some have no pixel."""
GUIDE_PARTS = {"matrix": 9, "bias": 3, "shifts": 3 * KNOTS, "slopes": 3 * KNOTS, "mix": 3,
               "mix_bias": 1}


def area_weights(out_size: int, in_size: int, device: torch.device | None = None) -> torch.Tensor:
    """(out_size, in_size) matrix of exact area averaging: overlap of each output cell with each
    input pixel."""
    left = torch.arange(in_size, device=device).to(torch.float32)
    # from a tensor, so that the exported graph keeps the size free
    scale = (left[-1] + 1) / out_size
    start = torch.arange(out_size, device=device).to(torch.float32)[:, None] * scale
    overlap = torch.minimum(left + 1, start + scale) - torch.maximum(left, start)
    return overlap.clamp_min(0.0) / scale


def lowres(colour: torch.Tensor, shaper: Shaper) -> torch.Tensor:
    """Shaped colour (N,3,H,W) averaged by area to (N,3,256,256): a log average, which fireflies
    barely move."""
    h, w = colour.shape[-2:]
    rows, columns = area_weights(SIDE, h, colour.device), area_weights(SIDE, w, colour.device)
    return rows @ (shape(colour, *shaper) @ columns.T)


def guide_map(shaped: torch.Tensor, guide: torch.Tensor) -> torch.Tensor:
    """Guide (N,1,H,W) in [0,1] from shaped colour: 3x3 matrix, a 16-knot curve a channel, mix,
    clip."""
    matrix, bias, shifts, slopes, mix, mix_bias = guide.split(list(GUIDE_PARTS.values()))
    shifts, slopes = shifts.view(3, KNOTS), slopes.view(3, KNOTS)
    mapped = F.conv2d(shaped, matrix.view(3, 3, 1, 1), bias)
    curves = torch.zeros_like(mapped)
    for k in range(KNOTS):
        curves = curves + slopes[:, k].view(1, 3, 1, 1) * F.relu(mapped
                                                                 - shifts[:, k].view(1, 3, 1, 1))
    total = (curves * mix.view(1, 3, 1, 1)).sum(1, keepdim=True) + mix_bias
    return total.clamp(0.0, 1.0)


def level_weights(level: torch.Tensor) -> torch.Tensor:
    """Weights (N,8,H,W) of the guide levels for pixels with a guide (N,1,H,W): two neighbouring
    levels share 1."""
    z = (level * DEPTH - 0.5).clamp(0.0, DEPTH - 1.0)
    levels = torch.arange(DEPTH, device=z.device).view(1, DEPTH, 1, 1)
    return (1 - (z - levels).abs()).clamp_min(0.0)


def borrow(grid: torch.Tensor, low: torch.Tensor, guide: torch.Tensor) -> torch.Tensor:
    """The grid (N,96,16,16) in which cells with few pixels of (N,3,256,256) at a level take that
    level's matrix from neighbouring cells.

    Beside an edge, a dark pixel's matrix is interpolated from cells without dark pixels, and a
    bright one's from cells without bright pixels: such matrices would be arbitrary, and
    interpolation would make a halo. Formula: normalised convolution, Knutsson and Westin 1993, over
    3x3 cells.
    """
    share = F.avg_pool2d(level_weights(guide_of_copy(F.avg_pool2d(low, FOURTH), guide)),
                         SIDE // FOURTH // CELLS)
    share = (share + NONE).repeat_interleave(COEFFICIENTS, 1)
    around = F.avg_pool2d(share * grid, 3, 1, 1) / F.avg_pool2d(share, 3, 1, 1)
    return around + share / (share + TRUST) * (grid - around)


def guide_of_copy(shaped: torch.Tensor, guide: torch.Tensor) -> torch.Tensor:
    """`guide_map` by two convolutions with all 48 pieces of the curves between them: few steps for
    a small picture."""
    matrix, bias, shifts, slopes, mix, mix_bias = guide.split(list(GUIDE_PARTS.values()))
    weight = matrix.view(3, 3, 1, 1).repeat_interleave(KNOTS, 0)
    pieces = F.relu(F.conv2d(shaped, weight, bias.repeat_interleave(KNOTS) - shifts))
    return F.conv2d(pieces, (slopes * mix.repeat_interleave(KNOTS)).view(1, -1, 1, 1),
                    mix_bias).clamp(0.0, 1.0)


def affine(coefficients: torch.Tensor, shaped: torch.Tensor) -> torch.Tensor:
    """Apply (N,12,H,W) affine colour matrices to (N,3,H,W)."""
    n, _, h, w = shaped.shape
    m = coefficients.view(n, 3, 4, h, w)
    return (m[:, :, :3] * shaped[:, None]).sum(2) + m[:, :, 3]


def slice_apply(
    colour: torch.Tensor, shaper: Shaper, guide: torch.Tensor, grid: torch.Tensor,
    cube: torch.Tensor
) -> torch.Tensor:
    """Display colour (N,3,H,W) in [0,1]: trilinear look-up of grid (N,16,16,8,12), affine, look-up
    of the cube.

    Grid axes: y, x, guide level, coefficient.
    """
    return look_up(slice_grid(shape(colour, *shaper), guide, grid), cube)


def slice_grid(shaped: torch.Tensor, guide: torch.Tensor, grid: torch.Tensor) -> torch.Tensor:
    """Shaped colour (N,3,H,W) through the matrices of the grid; not clipped."""
    n, _, h, w = shaped.shape
    z = guide_map(shaped, guide)[:, 0] * 2 - 1
    x = ((torch.arange(w, device=z.device, dtype=z.dtype) + 0.5) * (2.0 / w) - 1).expand(n, h, w)
    y = ((torch.arange(h, device=z.device, dtype=z.dtype) + 0.5) * (2.0 / h)
         - 1)[:, None].expand(n, h, w)
    where = torch.stack([x, y, z], -1)[:, None]
    volume = grid.permute(0, 4, 3, 1, 2)
    coefficients = F.grid_sample(volume, where, mode="bilinear", padding_mode="border",
                                 align_corners=False)
    return affine(coefficients[:, :, 0], shaped)


def keep_greys(grid: torch.Tensor) -> torch.Tensor:
    """The nearest matrices (..., 12) that keep greys grey: all rows have the same sum and the same
    offset.

    Tints belong to the cube, which sees only colour.
    """
    matrices = grid.unflatten(-1, (3, 4))
    sums = matrices[..., :3].sum(-1, keepdim=True)
    turned = matrices[..., :3] + (sums.mean(-2, keepdim=True) - sums) / 3
    offsets = matrices[..., 3:].mean(-2, keepdim=True).expand_as(sums)
    return torch.cat([turned, offsets], -1).flatten(-2)


def linear_weights(out_size: int, cells: int, device: torch.device) -> torch.Tensor:
    """(out_size, cells) matrix of linear interpolation between cell centres, clamped at the
    border."""
    x = ((torch.arange(out_size, device=device, dtype=torch.float32) + 0.5) * (cells / out_size)
         - 0.5)
    x = x.clamp(0.0, cells - 1.0)[:, None]
    return (1 - (x - torch.arange(cells, device=device)).abs()).clamp_min(0.0)


def slice_grid_dense(shaped: torch.Tensor, guide: torch.Tensor, grid: torch.Tensor) -> torch.Tensor:
    """`slice_grid` by matrix products.

    On a GPU the gradients of a gather and of `F.interpolate` are many atomic adds, as all pixels
    add to few cells.
    """
    n, _, h, w = shaped.shape
    weights = level_weights(guide_map(shaped, guide))
    homogeneous = torch.cat([shaped, torch.ones_like(shaped[:, :1])], 1)
    weighted = (weights[:, :, None] * homogeneous[:, None]).flatten(1, 2)
    rows, columns = linear_weights(h, CELLS, shaped.device), linear_weights(w, CELLS, shaped.device)
    matrices = grid.reshape(n, CELLS, CELLS, DEPTH, 3, 4).permute(0, 4, 3, 5, 1, 2)
    maps = (rows @ (matrices @ columns.T)).view(n, 3, DEPTH * 4, h, w)
    return (maps * weighted[:, None]).sum(2)


def _conv(cin: int, cout: int, stride: int = 1, bias: bool = True) -> nn.Conv2d:
    return nn.Conv2d(cin, cout, 3, stride, 1, bias=bias)


def histogram(low: torch.Tensor) -> torch.Tensor:
    """Histogram (N,BINS) of the mean channel of (N,3,H,W) in [0,1], over every second row and
    column, times BINS: 1 on average.

    A pixel between the centres of two bins counts for both, so that the histogram changes smoothly.
    """
    level = low.mean(1, keepdim=True)[..., ::2, ::2] * (BINS - 1.0)
    bins = torch.arange(BINS, device=low.device, dtype=low.dtype).view(1, BINS, 1, 1)
    return F.relu(1 - (level - bins).abs()).mean((2, 3)) * BINS


class Coefficients(nn.Module):
    """(N,3,256,256) shaped low-resolution colour -> (N,96,16,16): 8 guide levels of 3x4 affine
    colour matrices."""

    def __init__(self) -> None:
        super().__init__()
        self.splat = nn.ModuleList([_conv(3, 8, 2), _conv(8, 16, 2), _conv(16, 32, 2),
                                    _conv(32, 64, 2)])
        self.global_conv = nn.ModuleList([_conv(64, 64, 2), _conv(64, 64, 2)])
        self.global_dense = nn.ModuleList([nn.Linear(1024, 256), nn.Linear(256, 128),
                                           nn.Linear(128, 64)])
        self.histogram_dense = nn.ModuleList([nn.Linear(BINS, 64), nn.Linear(64, 64)])
        self.local = nn.ModuleList([_conv(64, 64), _conv(64, 64, bias=False)])
        self.head = nn.Conv2d(64, DEPTH * COEFFICIENTS, 1)
        self._initialise()

    def _initialise(self) -> None:
        """He initialisation; the head starts at the identity matrix, so that the network starts at
        its cube's view."""
        for module in self.modules():
            if isinstance(module, nn.Conv2d | nn.Linear):
                nn.init.kaiming_normal_(module.weight, nonlinearity="relu")
                if module.bias is not None:
                    nn.init.zeros_(module.bias)
        nn.init.zeros_(self.head.weight)
        identity = torch.eye(3, 4).flatten()
        self.head.bias.data.copy_(identity.repeat(DEPTH))

    def forward(self, low: torch.Tensor) -> torch.Tensor:
        x = low
        for layer in self.splat:
            x = F.relu(layer(x))
        g = x
        for layer in self.global_conv:
            g = F.relu(layer(g))
        g = g.flatten(1)
        for i, layer in enumerate(self.global_dense):
            g = layer(g) if i == 2 else F.relu(layer(g))
        g = g + self.histogram_dense[1](F.relu(self.histogram_dense[0](histogram(low))))
        local = self.local[1](F.relu(self.local[0](x)))
        return self.head(F.relu(local + g[:, :, None, None]))


class Guide(nn.Module):
    """The guide's learned numbers as one flat vector: matrix 9, bias 3, shifts 48, slopes 48, mix
    3, mix bias 1."""

    def __init__(self) -> None:
        super().__init__()
        self.matrix = nn.Parameter(torch.eye(3) + 1e-4 * torch.randn(3, 3))
        self.bias = nn.Parameter(torch.zeros(3))
        self.shifts = nn.Parameter(torch.linspace(0, 1, KNOTS + 1)[:-1].repeat(3, 1))
        slopes = torch.zeros(3, KNOTS)
        slopes[:, 0] = 1.0
        self.slopes = nn.Parameter(slopes)
        self.mix = nn.Parameter(torch.full((3,), 1 / 3))
        self.mix_bias = nn.Parameter(torch.zeros(1))

    def forward(self) -> torch.Tensor:
        return torch.cat([getattr(self, name).flatten() for name in GUIDE_PARTS])


class HDRNet(nn.Module):
    """488,352 parameters and a cube (size,size,size,3), which is not trained by default.

    `forward` is what is exported: lowres -> (grid, guide, cube); the kernels do the rest.
    """

    def __init__(self, cube: torch.Tensor) -> None:
        super().__init__()
        self.coefficients = Coefficients()
        self.guide = Guide()
        self.cube = nn.Parameter(cube, requires_grad=False)

    def forward(self, low: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        guide = self.guide()
        grid = borrow(self.coefficients(low), low,
                      guide).unflatten(1, (DEPTH, COEFFICIENTS)).permute(0, 3, 4, 1, 2)
        return keep_greys(grid), guide, self.cube

    def render(self, colour: torch.Tensor, shaper: Shaper) -> torch.Tensor:
        """Scene-linear (N,3,H,W) -> display (N,3,H,W) in [0,1], as the run-time does it."""
        grid, guide, cube = self(lowres(colour, shaper))
        return slice_apply(colour, shaper, guide, grid, cube)


# Light that follows the last frame ----------------------------------------------------------------
# How the tone mapper follows the light: definitions of the kernels `light`, `follow`, `smooth` and
# `expose`.

def light(low: torch.Tensor) -> torch.Tensor:
    """Means (256,3) of the rows of (1,3,256,256)."""
    return low.double().mean(3)[0].T.to(low.dtype)


def follow(light: torch.Tensor, params: torch.Tensor, before: torch.Tensor) -> torch.Tensor:
    """(256,3), (4,) and (1,4) -> (1,4), as `postfx.kernels.tonemap` says."""
    keep, most, past, scale = params.double().unbind()
    _, made_for, last, share = before.double()[0].unbind()
    now = light.double().mean() / scale
    lag, jump = (made_for - now).abs(), (last - now).abs()
    known = (past > 0) & (lag <= MOST) & (jump <= MOST) & (share.abs() <= 1)
    change = (torch.maximum(lag / LAG, jump / JUMP) - 1).clamp(0, 1)
    share = torch.maximum(torch.maximum(most * change, float(RELEASE) * share), 1 - keep)
    kept, none = 1 - share, torch.zeros_like(now)
    followed = torch.stack([kept, now + kept * (made_for - now), now, share])
    return torch.where(known, followed, torch.stack([none, now, now, none]))[None].to(light.dtype)


def smooth(previous: torch.Tensor, current: torch.Tensor, keep: torch.Tensor) -> torch.Tensor:
    """Exponential smoothing of the grid over time: keep[0,0] of the previous grid, except broken
    values."""
    change = previous - current
    return current + keep[0, 0] * torch.where(change.abs() <= float(BROKEN), change, 0)


def expose(previous: torch.Tensor, current: torch.Tensor, keep: torch.Tensor,
           params: torch.Tensor) -> torch.Tensor:
    """(3,), (1,1), (1,4) and (3,) -> (3,), as `postfx.kernels.tonemap` says."""
    stops, kept = current.double()[0, 0], keep.double()[0, 0]
    change = torch.log2(previous.double()[0]) - stops
    stops = stops + torch.where((kept > 0) & (change.abs() <= MOST_STOPS), kept * change, 0)
    exposure, toe, scale = params.unbind()
    return torch.stack([torch.exp2(stops).to(params.dtype), toe / exposure, scale])


# A learnt exposure --------------------------------------------------------------------------------
# The stops to add before a cube, from the distribution of a picture's light.
#
# The network learns how far from mid grey a scene belongs, as a function of percentiles relative to
# the geometric mean, which is moved to mid grey first. So a wrong exposure is corrected by
# construction, and one number exposes the whole picture.

SHARES = (0.001, 0.01, 0.1, 0.5, 0.9, 0.99, 0.999)  # of the pixels that are below a level
WIDTH = 64
TYPICAL = 4.0  # stops: unit of the network's input
FARTHEST = 8.0  # most stops that are added or subtracted; black stays black


def levels(low: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Mean of log2 luminance (N,1) over every second row and column of shaped colour (N,3,256,256),
    and the levels of SHARES (N,7) in stops from that mean."""
    toe, scale = SHAPER
    light = (torch.exp2(low[..., ::2, ::2] / scale) - 1) * toe
    luminance = (light * low.new_tensor(LUMA_REC2020).view(1, 3, 1, 1)).sum(1)
    log = torch.log2(luminance.clamp_min(0) + BLACK)
    # row by row: less is lost of a float32
    mean, pixels = log.mean(2).mean(1, keepdim=True), (SIDE // 2) ** 2
    ranks = torch.tensor([round(share * (pixels - 1)) for share in SHARES], device=low.device)
    # Gather: GatherND does not replay on GPUs
    return mean, log.flatten(1).sort(1).values.index_select(1, ranks) - mean


class Exposure(nn.Module):
    """4,737 parameters and a cube (size,size,size,3). `forward` is what is exported: lowres ->
    (stops (N,1), cube)."""

    def __init__(self, cube: torch.Tensor) -> None:
        super().__init__()
        sizes = (len(SHARES), WIDTH, WIDTH, 1)
        self.dense = nn.ModuleList([nn.Linear(*pair)
                                    for pair in zip(sizes, sizes[1:], strict=False)])
        self.cube = nn.Parameter(cube, requires_grad=False)

    def key(self, levels: torch.Tensor) -> torch.Tensor:
        """Stops (...,1) from mid grey at which the mean belongs, by its levels (...,7)."""
        x = levels / TYPICAL
        for layer in self.dense[:-1]:
            x = F.relu(layer(x))
        return self.dense[-1](x)

    def stops(self, mean: torch.Tensor, levels: torch.Tensor) -> torch.Tensor:
        """Stops (...,1) to add to luminance with this mean (...,1) and these levels (...,7)."""
        return math.log2(MID_GREY) - mean + self.key(levels)

    def forward(self, low: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        return self.stops(*levels(low)).clamp(-FARTHEST, FARTHEST), self.cube

    def render(self, colour: torch.Tensor, shaper: Shaper) -> torch.Tensor:
        """Scene-linear (N,3,H,W) -> display (N,3,H,W) in [0,1], as the run-time does it."""
        stops, cube = self(lowres(colour, shaper))
        return look_up(shape(colour * torch.exp2(stops)[..., None, None], *shaper), cube)


# Weights of exported models -----------------------------------------------------------------------

STATE = dict[str, torch.Tensor]


def find_start_model(start: str) -> Path:
    """A model file by its own name, or by the tag of a shipped look."""
    path = Path(start) if start.endswith(".onnx") else models_dir() / f"tonemap.{start}.onnx"
    if not path.is_file():
        raise SystemExit(f"{path}: no such model to start from: name another with --start, or "
                         "'none'")
    return path


def shipped_cubes() -> dict[str, torch.Tensor]:
    """Cubes of all shipped looks, by tag."""
    found = {path.name.split(".")[1]: _initializers(path)
             for path in sorted(models_dir().glob("tonemap.*.onnx"))}
    return {tag: torch.from_numpy(values["cube"].copy()) for tag, values in found.items()}


def weights_of(path: Path, like: STATE) -> STATE:
    """Weights of an exported network; weights that the exporter left out as zero stay as in
    `like`."""
    found = _initializers(path)
    if "guide" not in found:
        raise SystemExit(f"{path}: not a look with a grid: start from another, or from 'none'")
    parts = np.split(found["guide"], np.cumsum(list(GUIDE_PARTS.values()))[:-1])
    found |= {f"guide.{name}": part for name, part in zip(GUIDE_PARTS, parts, strict=True)}
    return {name: torch.from_numpy(found[name].copy()).reshape(value.shape)
            if name in found else value for name, value in like.items()}


def _initializers(path: Path) -> dict[str, np.ndarray]:
    """All constants of a model, float32."""
    import onnx  # a machine that starts from nothing may lack it

    return {item.name.removesuffix("_half"): onnx.numpy_helper.to_array(item).astype(np.float32)
            for item in onnx.load(path).graph.initializer}
