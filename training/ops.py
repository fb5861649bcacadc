"""Differentiable image operations of the denoised upscaler, NCHW, float32.

They define the compute kernels in ``postfx/kernels``: the portable ONNX kernels are exported from
here, and parity tests compare the compiled kernels with them. Pixel centres lie at integer
coordinates.
"""

from collections.abc import Callable
from typing import NamedTuple

import torch
import torch.nn.functional as F
from torch import Tensor

from postfx.kernels import denoise as layout
from postfx.kernels.denoise import DOUBT, FAINT, MAX_COLOUR, TRUST_CELL

TAPS = 5
TINY = float(layout.TINY)
LEAST_IMPORTANCE = float(layout.LEAST_IMPORTANCE)
EMITTER, LEAST_TINT, ADDED = float(layout.EMITTER), float(layout.LEAST_TINT), float(layout.ADDED)
MAX_SPAN = 4  # pixels along a line that one pixel of a picture up to 3 times smaller touches


def sanitise(values: Tensor, low: float, high: float) -> Tensor:
    """Values within [low, high], which holds 0 or lies above it; a NaN becomes the value nearest
    to 0."""
    return torch.where(values == values, values, torch.zeros_like(values)).clamp(float(low),
                                                                                 float(high))


def without_bias(curve: Callable[[Tensor], Tensor], first: Tensor, second: Tensor) -> Tensor:
    """What a curve makes of the mean of two noisy pictures, without most of the bias of their
    noise.

    A curve that bends maps a noisy mean too low, in the mean. It maps halves lower by twice as
    much, which tells how much (Quenouille, 1956).
    """
    return 2 * curve((first + second) / 2) - (curve(first) + curve(second)) / 2


def demodulation(diffuse_albedo: Tensor, specular_albedo: Tensor) -> Tensor:
    """Factor (N, 3, h, w) that colour is divided by before filtering: reflectance without
    dark-channel tints.

    A floor, a share of the largest channel, keeps saturated surfaces from amplifying noise in their
    dark channels; where nothing reflects (emitters, misses) the factor is 1.
    """
    total = sanitise(diffuse_albedo + specular_albedo, 0, float(layout.MOST_REFLECTANCE))
    peak = total.amax(1, keepdim=True)
    return torch.where(peak < EMITTER, torch.ones_like(total),
                       torch.maximum(total, LEAST_TINT * peak) + ADDED)


def neighbourhoods(image: Tensor, size: int, mode: str = "constant") -> Tensor:
    """The ``size`` x ``size`` neighbourhood of every pixel, (N, C, size^2, h, w), rows first."""
    h, w = image.shape[-2:]
    padded = F.pad(image, (size // 2,) * 4, mode=mode)
    return torch.stack([padded[..., y:y + h, x:x + w] for y in range(size) for x in range(size)], 2)


def dilate_motion(motion: Tensor, depth: Tensor) -> Tensor:
    """Motion of a clearly nearer neighbour in 3x3, else the pixel's own: edges move with the
    surface in front.

    Impossible motion (NaN, infinity) becomes 0; a NaN is never nearer.
    """
    near, moved = 0.9 * depth, motion
    depths, motions = (neighbourhoods(plane, 3, "replicate").unbind(2) for plane in (depth, motion))
    for neighbour, its_motion in zip(depths, motions, strict=True):
        closer = neighbour < near
        near, moved = torch.where(closer, neighbour, near), torch.where(closer, its_motion, moved)
    return torch.where(moved.abs() < 1e5, moved, torch.zeros_like(moved))


def depth_scale(depth: Tensor) -> Tensor:
    """Harmonic mean depth of all hits, (N, 1, 1, 1); 1 if there are none."""
    hit = (depth > 0) & (depth < float(layout.FARTHEST))
    near = torch.where(hit, 1 / depth.clamp(min=1e-6),
                       torch.zeros_like(depth)).sum((1, 2, 3), keepdim=True)
    hits = hit.to(depth.dtype).sum((1, 2, 3), keepdim=True)
    return torch.where(near > 0, hits / near.clamp(min=1e-12), torch.ones_like(near))


Place = tuple[Tensor, Tensor]  # rows and columns of a frame, whole numbers


def positions(motion: Tensor, place: Place | None = None) -> tuple[Tensor, Tensor]:
    """Where each pixel was in the previous frame: x and y in pixels, (N, h, w). The pixels are all
    of the frame, or those at a ``place`` in it."""
    h, w = motion.shape[-2:]
    rows, columns = place or (torch.arange(h, device=motion.device),
                              torch.arange(w, device=motion.device))
    return columns.to(motion.dtype) + motion[:, 0], rows.to(motion.dtype)[:, None] + motion[:, 1]


def inside(motion: Tensor, place: Place | None = None,
           size: tuple[int, int] | None = None) -> Tensor:
    """1 where the previous position lies in the frame, else 0; (N, 1, h, w). The frame's ``size``
    is the motion's."""
    h, w = size or motion.shape[-2:]
    x, y = positions(motion, place)
    return ((x >= -0.5) & (x <= w - 0.5) & (y >= -0.5) & (y <= h - 0.5)).to(motion.dtype)[:, None]


def warp(image: Tensor, motion: Tensor, mode: str = "bilinear",
         place: Place | None = None) -> Tensor:
    """``image`` of the previous frame seen from the current one; beyond the border its edge
    repeats."""
    h, w = image.shape[-2:]
    x, y = positions(motion, place)
    grid = torch.stack(((2 * x + 1) / w - 1, (2 * y + 1) / h - 1), -1)
    return F.grid_sample(image, grid, mode=mode, padding_mode="border", align_corners=False)


def warp_nearest(image: Tensor, motion: Tensor, place: Place | None = None) -> Tensor:
    """The nearest pixel of the previous frame; by index, so that no rounding of normalised
    positions picks another."""
    n, c, h, w = image.shape
    x, y = (p.round() for p in positions(motion, place))
    index = y.clamp(0, h - 1).long() * w + x.clamp(0, w - 1).long()
    return (image.flatten(2).gather(2, index.flatten(1)[:, None].expand(n, c, -1))
            .reshape(n, c, *motion.shape[-2:]))


def nearest_index(size: int, out_size: int, device: torch.device) -> tuple[Tensor, Tensor]:
    """For every output pixel the input pixel that holds its centre, and the centre's offset from
    that pixel's."""
    return nearest_of(torch.arange(out_size, device=device), size, out_size)


def nearest_of(at: Tensor, size: int | Tensor, out_size: int | Tensor) -> tuple[Tensor, Tensor]:
    """`nearest_index` of the output pixels ``at``."""
    centre = (2 * at + 1) * size  # in units of 1 / (2 out_size): exact
    index = centre // (2 * out_size)
    return index, (centre - index * (2 * out_size)) / (2 * out_size) - 0.5


def pick(image: Tensor, rows: Tensor, columns: Tensor) -> Tensor:
    """Rows and columns of an image by index."""
    return image.index_select(-2, rows).index_select(-1, columns)


def mirror_index(size: int, padded: int, device: torch.device) -> Tensor:
    """Index (padded,) that continues a row beyond its end as in a mirror, at most back to its
    start. Noise stays noise; a repeated edge would be a streak."""
    last = size - 1
    return (last - (torch.arange(padded, device=device) - last).abs()).clamp(min=0)


def enlarge(image: Tensor, height: int, width: int) -> Tensor:
    """Nearest-neighbour resampling to output size."""
    h, w = image.shape[-2:]
    if (height, width) == (h, w):
        return image
    return pick(image, nearest_index(h, height, image.device)[0],
                nearest_index(w, width, image.device)[0])


def box_mean(image: Tensor, h: int, w: int) -> Tensor:
    """Mean of the pixels that each pixel of a picture (h, w) touches, which may be 1 to 3 times as
    small."""
    if image.shape[-2:] == (2 * h, 2 * w):
        return F.avg_pool2d(image, 2)
    return span_mean(span_mean(image, h, -2), w, -1)


def span_mean(image: Tensor, size: int, axis: int) -> Tensor:
    """Mean, along one axis, of the pixels that each of ``size`` pixels touches."""
    full = image.shape[axis]
    index = torch.arange(size, device=image.device)
    return spans_mean(image, *span(index, size, full), axis)


def span(index: Tensor, size: int | Tensor, full: int | Tensor) -> tuple[Tensor, Tensor]:
    """The first of ``full`` pixels along a line that each pixel ``index`` of ``size`` touches, and
    the one after the last."""
    return index * full // size, ((index + 1) * full + size - 1) // size


def spans_mean(image: Tensor, start: Tensor, end: Tensor, axis: int) -> Tensor:
    """Mean of the pixels from each ``start`` up to, not including, its ``end`` along one axis."""
    full = image.shape[axis]
    total = torch.zeros((), device=image.device)
    for k in range(MAX_SPAN):
        share = ((start + k < end) / (end - start)).unflatten(0, (-1, *[1] * (-1 - axis)))
        total = total + image.index_select(axis, (start + k).clamp(max=full - 1)) * share
    return total


def enlarge_motion(motion: Tensor, height: int, width: int) -> Tensor:
    """Motion at output size, in output pixels."""
    h, w = motion.shape[-2:]
    return enlarge(torch.cat((motion[:, :1] * (width / w), motion[:, 1:] * (height / h)), 1),
                   height, width)


def valid_area(like: Tensor, height: int, width: int) -> Tensor:
    """1 inside the picture's ``height`` x ``width``, 0 in the padding right and below; (1, 1, h,
    w)."""
    h, w = like.shape[-2:]
    rows = torch.arange(h, device=like.device)[:, None] < height
    columns = torch.arange(w, device=like.device) < width
    return (rows & columns).to(like.dtype)[None, None]


def pool(colour: Tensor, weight: Tensor) -> tuple[Tensor, Tensor]:
    """Weighted mean over 2x2 pixels, and the mean weight."""
    total = F.avg_pool2d(weight, 2)
    return F.avg_pool2d(colour * weight, 2) / total.clamp(min=LEAST_IMPORTANCE), total


def filter_kernels(image: Tensor, kernels: Tensor, valid: Tensor) -> Tensor:
    """Apply a normalised 5x5 kernel of its own to every pixel; taps outside ``valid`` do not
    count."""
    weights = kernels * neighbourhoods(valid, TAPS)[:, 0]
    return ((neighbourhoods(image, TAPS) * weights[:, None]).sum(2) / weights.sum(1, keepdim=True)
            .clamp(min=TINY))


def resample(image: Tensor, rows: Tensor, columns: Tensor) -> Tensor:
    """Cubic interpolation (Keys 1981, a = -0.5) of (N, C, h, w) at positions rows (H,) and columns
    (W,).

    Values stay within those of the four nearest samples, so that edges do not ring. Values that are
    not finite count as 0.
    """
    image = torch.where(image.abs() < torch.inf, image, torch.zeros_like(image))
    value = low = high = image
    for axis, positions in ((-1, columns), (-2, rows)):
        first, size = positions.floor(), image.shape[axis]
        index = [(first + k).clamp(0, size - 1).long() for k in range(-1, 3)]
        weights = [x.unflatten(0, (-1, *[1] * (-1 - axis))) for x in catmull_rom(positions - first)]
        value = sum(value.index_select(axis, i) * k for i, k in zip(index, weights, strict=True))
        low = torch.minimum(low.index_select(axis, index[1]), low.index_select(axis, index[2]))
        high = torch.maximum(high.index_select(axis, index[1]), high.index_select(axis, index[2]))
    return torch.minimum(torch.maximum(value, low), high)


def catmull_rom(t: Tensor) -> tuple[Tensor, ...]:
    """Weights of the four taps around a position ``t`` in [0, 1) after the second one."""
    return (((-0.5 * t + 1) * t - 0.5) * t, (1.5 * t - 2.5) * t * t + 1,
            ((-1.5 * t + 2) * t + 0.5) * t, (0.5 * t - 0.5) * t * t)


def log_encode(exposed: Tensor) -> Tensor:
    """log(1 + x) of a colour in [0, 1e4]."""
    return torch.log1p(exposed.clamp(0.0, MAX_COLOUR))


# From render size to output size ------------------------------------------------------------------
# The network predicts kernels and controls at the four quarter-pixel corners of a render pixel. At
# scale 2 the centres of output pixels lie there; at other scales the predictions are interpolated.

PHASE_TAPS = 3
SAMPLE_SIGMA = 0.5  # render pixels: a sample says little about what lies farther away
BLUR_SIGMA = 1.0  # what sharpening is measured against


class Centres(NamedTuple):
    """Render pixels that hold the centres of output rows and columns, and the centres' offsets from
    theirs."""

    rows: Tensor
    y: Tensor
    columns: Tensor
    x: Tensor


def centres(h: int, w: int, height: int, width: int, device: torch.device) -> Centres:
    """Centres of all output pixels of a picture."""
    return Centres(*nearest_index(h, height, device), *nearest_index(w, width, device))


def corner_index(size: int, out_size: int, device: torch.device) -> Tensor:
    """For each of ``size`` pixels the output pixels that hold its points at 1/4 and 3/4: (2,
    size)."""
    quarters = 4 * torch.arange(size, device=device) + torch.tensor([[1], [3]], device=device)
    return quarters * out_size // (4 * size)


def tap_offsets(device: torch.device) -> Tensor:
    """(9, 2) offsets x, y of the 3x3 neighbourhood, rows first."""
    line = torch.arange(-1.0, 2.0, device=device)
    y, x = torch.meshgrid(line, line, indexing="ij")
    return torch.stack((x, y), -1).reshape(-1, 2)


def sample_prior(jitter: Tensor, x: Tensor, y: Tensor, sigma: float = SAMPLE_SIGMA) -> Tensor:
    """Gaussian weight of each 3x3 tap by the distance from its sample to the output pixel.

    ``jitter`` (N, 2) in render pixels; ``x`` and ``y`` are offsets of output centres from their
    render pixel's centre. Returns (N, 9, len(y), len(x)).
    """
    sample = tap_offsets(jitter.device)[None] + jitter[:, None]
    gx = torch.exp(-((sample[..., 0:1] - x) ** 2) / (2 * sigma**2))
    gy = torch.exp(-((sample[..., 1:2] - y) ** 2) / (2 * sigma**2))
    return gy[..., :, None] * gx[..., None, :]


def interpolate_phases(phases: Tensor, height: int, width: int) -> Tensor:
    """(N, C, 4, h, w), one value at each quarter-pixel corner (rows first), to output size (N, C,
    H, W).

    Between the corners values are linear, beyond them constant. At scale 2 output centres are the
    corners.
    """
    n, c, _, h, w = phases.shape
    if (height, width) == (2 * h, 2 * w):
        return F.pixel_shuffle(phases.reshape(n, c * 4, h, w), 2)
    return interpolate_any(phases, height, width)


def interpolate_any(phases: Tensor, height: int, width: int) -> Tensor:
    """`interpolate_phases` without the short cut for scale 2."""
    h, w = phases.shape[-2:]
    return interpolate_at(phases, centres(h, w, height, width, phases.device))


def interpolate_at(phases: Tensor, at: Centres) -> Tensor:
    """`interpolate_phases` at some rows and columns."""
    ty, tx = (2 * at.y + 0.5).clamp(0, 1)[:, None], (2 * at.x + 0.5).clamp(0, 1)
    here = pick(phases, at.rows, at.columns)
    top = here[:, :, 0] * (1 - tx) + here[:, :, 1] * tx
    bottom = here[:, :, 2] * (1 - tx) + here[:, :, 3] * tx
    return top * (1 - ty) + bottom * ty


def upsample(radiance: Tensor, weights: Tensor, jitter: Tensor, height: int,
             width: int) -> tuple[Tensor, Tensor]:
    """Radiance at output size, twice: by predicted 3x3 weights (N, 9, 4, h, w) times the prior of
    ``sample_prior``, and softened by a wide Gaussian, against which the first can be sharpened."""
    h, w = radiance.shape[-2:]
    if (height, width) == (2 * h, 2 * w):
        return upsample_double(radiance, weights, jitter)
    return upsample_any(radiance, weights, jitter, height, width)


def upsample_double(radiance: Tensor, weights: Tensor, jitter: Tensor) -> tuple[Tensor, Tensor]:
    """Scale 2, where the four output pixels of a render pixel lie at its corners: all work at
    render size."""
    n, channels, h, w = radiance.shape
    taps = neighbourhoods(radiance, PHASE_TAPS, "replicate")
    corners = torch.arange(2, device=radiance.device) * 0.5 - 0.25
    blend = weights * sample_prior(jitter, corners, corners).reshape(-1, 9, 4, 1, 1)
    wide = sample_prior(jitter, corners, corners, BLUR_SIGMA).reshape(-1, 9, 4, 1, 1)
    return tuple(F.pixel_shuffle(torch.stack([weighted_mean(taps, x[:, :, p]) for p in range(4)], 2)
                                 .reshape(n, 4 * channels, h, w), 2) for x in (blend, wide))


def upsample_any(radiance: Tensor, weights: Tensor, jitter: Tensor, height: int,
                 width: int) -> tuple[Tensor, Tensor]:
    """`upsample` at any scale."""
    h, w = radiance.shape[-2:]
    return upsample_at(radiance, weights, jitter, centres(h, w, height, width, radiance.device))


def upsample_at(radiance: Tensor, weights: Tensor, jitter: Tensor,
                at: Centres) -> tuple[Tensor, Tensor]:
    """`upsample` at some rows and columns."""
    blend = interpolate_at(weights, at) * sample_prior(jitter, at.x, at.y)
    taps = pick(neighbourhoods(radiance, PHASE_TAPS, "replicate"), at.rows, at.columns)
    return weighted_mean(taps, blend), weighted_mean(taps,
                                                     sample_prior(jitter, at.x, at.y, BLUR_SIGMA))


def weighted_mean(taps: Tensor, weights: Tensor) -> Tensor:
    """Mean over the taps of (N, C, K, h, w) by weights (N, K, h, w), or (N, K, 1, 1)."""
    return (taps * weights[:, None]).sum(2) / weights.sum(1)[:, None].clamp(min=TINY)


# Trust in guides ----------------------------------------------------------------------------------
# How far the guides are trusted as reflectance at output size.
#
# The mean of the guides over a render pixel should equal the planes of the render size. Where the
# two differ by as much as the guides vary, the guides are noise: one sample a pixel of a finer
# texture, or another surface.

def trust(own: Tensor, guides: Tensor, at: Place, h: int | Tensor, w: int | Tensor,
          valid: Tensor) -> Tensor:
    """(N, 1, cells, cells): 1 - DOUBT * apart / spread of cells of 8x8 render pixels, 1 where
    nothing is ``valid``.

    ``own`` (N, 3, h, w) is the reflectance of the render pixels ``at`` rows and columns of a frame
    of ``h`` by ``w``, ``guides`` (N, 3, H, W) the reflectance of the whole frame at output size,
    ``valid`` (N, 1, h, w) 1 for pixels that count, else 0.
    """
    mean, spread = _differences(own, guides, *(span(index, size, full) for index, size, full in zip(
        at, (h, w), guides.shape[-2:], strict=True)))
    apart = mean.square().sum(1, keepdim=True)
    cells = F.avg_pool2d(torch.cat((apart, spread, 3 * torch.ones_like(spread)), 1) * valid,
                         TRUST_CELL, ceil_mode=True)
    apart, spread, count = cells.split(1, 1)
    return 1 - float(DOUBT) * apart / (spread + float(FAINT) * count).clamp(min=TINY)


def trust_at(cells: Tensor, at: Centres, h: int | Tensor, w: int | Tensor) -> Tensor:
    """Trust at output pixels (N, 1, H, W), linear between the centres of cells; ``h`` by ``w``
    render pixels of these count."""
    return between(between(cells, at.columns + at.x, w, -1), at.rows + at.y, h, -2)


def _differences(own: Tensor, guides: Tensor, rows: tuple[Tensor, Tensor],
                 columns: tuple[Tensor, Tensor]) -> tuple[Tensor, Tensor]:
    """Mean relative difference (N, 3, h, w) of the guides from their render pixel, and its mean
    square over the guide pixels that the render pixel touches, summed over the channels (N, 1, h,
    w)."""
    mean = spread = torch.zeros((), device=own.device)
    height, width = guides.shape[-2:]
    for k in range(MAX_SPAN):
        down = (rows[0] + k < rows[1]).to(own.dtype) / (rows[1] - rows[0])
        for i in range(MAX_SPAN):
            share = down[:, None] * ((columns[0] + i < columns[1])
                                     .to(own.dtype) / (columns[1] - columns[0]))
            found = pick(guides, (rows[0] + k).clamp(max=height - 1),
                         (columns[0] + i).clamp(max=width - 1))
            apart = found / own - 1
            mean = mean + share * apart
            spread = spread + share * apart.square().sum(1, keepdim=True)
    return mean, spread


def between(cells: Tensor, at: Tensor, size: int | Tensor, axis: int,
            first: int | Tensor = 0) -> Tensor:
    """Values at places in render pixels along an axis, linear between the centres of cells;
    ``cells`` holds those from the ``first`` on."""
    last = (size - 1) // TRUST_CELL
    place = ((at + 0.5) / TRUST_CELL - 0.5).clamp(min=0)
    place = (place - last).clamp(max=0) + last
    before = place.floor()
    share = (place - before).to(cells.dtype).unflatten(0, (-1, *[1] * (-1 - axis)))
    here, there = ((index - first).long().clamp(max=cells.shape[axis] - 1)
                   for index in (before, before + 1))
    return torch.lerp(cells.index_select(axis, here), cells.index_select(axis, there), share)
