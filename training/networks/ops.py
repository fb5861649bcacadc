"""Differentiable image operations of the denoised upscaler, NCHW, float32.

They are the source of truth for the compute kernels in ``postfx/kernels``: the portable ONNX kernels are exported
from here and the compiled ones are held to them by parity tests. Pixel centres lie at integer coordinates.
"""
import torch
import torch.nn.functional as F
from torch import Tensor

TAPS = 5
PHASE_TAPS = 3
SAMPLE_SIGMA = 0.5
MAX_COLOUR = 1e4


def demodulation(diffuse_albedo: Tensor, specular_albedo: Tensor) -> Tensor:
    """Factor (N, 3, h, w) that colour is divided by before filtering: reflectance without dark-channel tints.

    A floor of 0.15 of the largest channel keeps saturated surfaces from amplifying noise in their dark channels;
    where nothing reflects (emitters, misses) the factor is 1.
    """
    total = (diffuse_albedo + specular_albedo).clamp(0, 4)
    peak = total.amax(1, keepdim=True)
    return torch.where(peak < 0.005, torch.ones_like(total), torch.maximum(total, 0.15 * peak) + 0.01)


def shifted(image: Tensor, size: int, mode: str = "constant") -> Tensor:
    """The ``size`` x ``size`` neighbourhood of every pixel, (N, C, size^2, h, w), rows first."""
    h, w = image.shape[-2:]
    padded = F.pad(image, (size // 2,) * 4, mode=mode)
    return torch.stack([padded[..., y:y + h, x:x + w] for y in range(size) for x in range(size)], 2)


def dilate_motion(motion: Tensor, depth: Tensor) -> Tensor:
    """Motion of a clearly nearer neighbour in 3x3, else the pixel's own: edges move with the surface in front."""
    near, index = shifted(depth, 3, "replicate")[:, 0].min(1, keepdim=True)
    around = shifted(motion, 3, "replicate")
    nearer = around.gather(2, index[:, None].expand(-1, 2, -1, -1, -1))[:, :, 0]
    return torch.where(near < 0.9 * depth, nearer, motion)


def depth_scale(depth: Tensor) -> Tensor:
    """Harmonic mean depth of what was hit, (N, 1, 1, 1); 1 where nothing was."""
    hit = ((depth > 0) & (depth < 1e9)).to(depth.dtype)
    near = (hit / depth.clamp(min=1e-6)).sum((1, 2, 3), keepdim=True)
    return torch.where(near > 0, hit.sum((1, 2, 3), keepdim=True) / near.clamp(min=1e-12), torch.ones_like(near))


def positions(motion: Tensor) -> tuple[Tensor, Tensor]:
    """Where each pixel was in the previous frame: x and y in pixels, (N, h, w)."""
    h, w = motion.shape[-2:]
    x = torch.arange(w, device=motion.device, dtype=motion.dtype) + motion[:, 0]
    y = torch.arange(h, device=motion.device, dtype=motion.dtype)[:, None] + motion[:, 1]
    return x, y


def inside(motion: Tensor) -> Tensor:
    """1 where the previous position lies in the frame, else 0; (N, 1, h, w)."""
    h, w = motion.shape[-2:]
    x, y = positions(motion)
    return ((x >= -0.5) & (x <= w - 0.5) & (y >= -0.5) & (y <= h - 0.5)).to(motion.dtype)[:, None]


def warp(image: Tensor, motion: Tensor, mode: str = "bilinear") -> Tensor:
    """``image`` of the previous frame seen from the current one; beyond the border its edge repeats."""
    h, w = image.shape[-2:]
    x, y = positions(motion)
    grid = torch.stack(((2 * x + 1) / w - 1, (2 * y + 1) / h - 1), -1)
    return F.grid_sample(image, grid, mode=mode, padding_mode="border", align_corners=False)


def nearest_index(size: int, out_size: int, device: torch.device) -> tuple[Tensor, Tensor]:
    """For every output pixel the input pixel that holds its centre, and the centre's offset from that pixel's."""
    centre = (torch.arange(out_size, device=device) + 0.5) * (size / out_size)
    index = centre.floor().clamp(max=size - 1)
    return index.long(), centre - index - 0.5


def enlarge(image: Tensor, height: int, width: int) -> Tensor:
    """Nearest-neighbour resampling to output size."""
    h, w = image.shape[-2:]
    if (height, width) == (h, w):
        return image
    rows, _ = nearest_index(h, height, image.device)
    columns, _ = nearest_index(w, width, image.device)
    return image[..., rows, :][..., columns]


def valid_area(like: Tensor, height: int, width: int) -> Tensor:
    """1 inside the picture's ``height`` x ``width``, 0 in the padding right and below; (1, 1, h, w)."""
    h, w = like.shape[-2:]
    rows = torch.arange(h, device=like.device)[:, None] < height
    columns = torch.arange(w, device=like.device) < width
    return (rows & columns).to(like.dtype)[None, None]


def pool(colour: Tensor, weight: Tensor) -> tuple[Tensor, Tensor]:
    """Weighted mean over 2x2 pixels, and the mean weight."""
    total = F.avg_pool2d(weight, 2)
    return F.avg_pool2d(colour * weight, 2) / (total + 1e-8), total


def filter_kernels(image: Tensor, kernels: Tensor, valid: Tensor) -> Tensor:
    """Apply a normalised 5x5 kernel of its own to every pixel; taps outside ``valid`` do not count."""
    weights = kernels * shifted(valid, TAPS)[:, 0]
    return (shifted(image, TAPS) * weights[:, None]).sum(2) / (weights.sum(1, keepdim=True) + 1e-8)


def tap_offsets(device: torch.device) -> Tensor:
    """(9, 2) offsets x, y of the 3x3 neighbourhood, rows first."""
    line = torch.arange(-1.0, 2.0, device=device)
    y, x = torch.meshgrid(line, line, indexing="ij")
    return torch.stack((x, y), -1).reshape(-1, 2)


def sample_prior(jitter: Tensor, x: Tensor, y: Tensor) -> Tensor:
    """Gaussian weight of each 3x3 tap by the distance from its sample to the output pixel.

    ``jitter`` (N, 2) in render pixels; ``x`` and ``y`` are offsets of output centres from their render pixel's
    centre. Returns (N, 9, len(y), len(x)).
    """
    sample = tap_offsets(jitter.device)[None] + jitter[:, None]
    gx = torch.exp(-((sample[..., 0:1] - x) ** 2) / (2 * SAMPLE_SIGMA**2))
    gy = torch.exp(-((sample[..., 1:2] - y) ** 2) / (2 * SAMPLE_SIGMA**2))
    return gy[..., :, None] * gx[..., None, :]


def interpolate_phases(phases: Tensor, height: int, width: int) -> Tensor:
    """(N, C, 4, h, w), one value at each quarter-pixel corner (rows first), to output size (N, C, H, W).

    Between the corners values are linear, beyond them constant. At scale 2 output centres are the corners.
    """
    n, c, _, h, w = phases.shape
    if (height, width) == (2 * h, 2 * w):
        return F.pixel_shuffle(phases.reshape(n, c * 4, h, w), 2)
    rows, y = nearest_index(h, height, phases.device)
    columns, x = nearest_index(w, width, phases.device)
    ty, tx = (2 * y + 0.5).clamp(0, 1)[:, None], (2 * x + 0.5).clamp(0, 1)
    at = phases[..., rows, :][..., columns]
    top = at[:, :, 0] * (1 - tx) + at[:, :, 1] * tx
    bottom = at[:, :, 2] * (1 - tx) + at[:, :, 3] * tx
    return top * (1 - ty) + bottom * ty


def upsample(radiance: Tensor, weights: Tensor, jitter: Tensor, height: int, width: int) -> Tensor:
    """Radiance at output size: predicted 3x3 weights (N, 9, 4, h, w) times the prior of ``sample_prior``."""
    h, w = radiance.shape[-2:]
    taps = shifted(radiance, PHASE_TAPS, "replicate")
    if (height, width) == (2 * h, 2 * w):
        corners = torch.tensor([-0.25, 0.25], device=radiance.device)
        blend = weights * sample_prior(jitter, corners, corners).reshape(-1, 9, 4, 1, 1)
        phases = torch.stack([(taps * blend[:, None, :, p]).sum(2) for p in range(4)], 2)
        return F.pixel_shuffle((phases / (blend.sum(1)[:, None] + 1e-8)).reshape(len(radiance), 12, h, w), 2)
    _, y = nearest_index(h, height, radiance.device)
    _, x = nearest_index(w, width, radiance.device)
    blend = interpolate_phases(weights, height, width) * sample_prior(jitter, x, y)
    return (enlarge(taps, height, width) * blend[:, None]).sum(2) / (blend.sum(1, keepdim=True) + 1e-8)


def display(exposed: Tensor) -> Tensor:
    """Exposed linear colour to the sRGB-encoded curve x / (1 + x) that quality is scored on."""
    x = exposed.clamp(min=0)
    x = x / (1 + x)
    return torch.where(x <= 0.0031308, 12.92 * x, 1.055 * x.clamp(min=1e-6) ** (1 / 2.4) - 0.055)


def log_encode(exposed: Tensor) -> Tensor:
    """log(1 + x) of a colour in [0, 1e4]."""
    return torch.log1p(exposed.clamp(0, MAX_COLOUR))

