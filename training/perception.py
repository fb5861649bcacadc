"""How different two pictures look, differentiable: the colour part of FLIP (Andersson et al. 2020).

Both are filtered as the eye does at a distance, brought to Lab with less chroma where it is dark (Hunt), and
compared by HyAB; an exponent of 0.7 lets small differences count.
"""
import math

import numpy as np
import torch
from torch import Tensor

DENSITY = 67.0  # pixels a degree
# Bands of the contrast sensitivity of lightness, red-green and blue-yellow, in degrees^2; the last one is the mean by
# weight of two Gaussians.
BANDS = (0.0047, 0.0053, (34.1 * 0.04 + 13.5 * 0.025) / (34.1 + 13.5))
TO_XYZ = ((0.4123908, 0.3575843, 0.1804808), (0.2126390, 0.7151687, 0.0721923), (0.0193308, 0.1191948, 0.9505322))
EXPONENT, SCALE = 0.7, 0.95 / (0.4 * 41.2760)  # 41.276: what green and blue, the farthest colours, differ by
SOFT = 1.0  # Lab units; no kink at 0, where noise of the reference would hold the result at its median
KNEE = 6 / 29
_MATRIX = np.array(TO_XYZ) / np.sum(TO_XYZ, 1, keepdims=True)
FORTH, BACK = _MATRIX.tolist(), np.linalg.inv(_MATRIX).tolist()  # linear RGB -> XYZ over that of white, and back


def turned(matrix: list[list[float]], image: Tensor) -> Tensor:
    """``matrix`` (3, 3) times each pixel of (N, 3, H, W)."""
    x, y, z = image.unbind(1)
    return torch.stack([row[0] * x + row[1] * y + row[2] * z for row in matrix], 1)


def filters(size: int, device: torch.device) -> Tensor:
    """(3, size, size): what a line of pixels is multiplied by to pass each band of the contrast sensitivity, a
    Gaussian; its edge pixels repeat."""
    lines = []
    for band in BANDS:
        sigma = math.sqrt(band / 2) / math.pi * DENSITY
        radius = math.ceil(3 * sigma)
        step = torch.arange(-radius, radius + 1, device=device)
        weights = torch.exp(-step.square() / (2 * sigma**2))
        reached = (torch.arange(size, device=device)[:, None] + step).clamp(0, size - 1)
        line = torch.zeros(size, size, device=device)
        lines.append(line.scatter_add(1, reached, (weights / weights.sum()).expand(size, -1)))
    return torch.stack(lines)


def seen(display: Tensor) -> Tensor:
    """sRGB code values (N, 3, H, W) in [0, 1] -> filtered Lab, chroma by the hundredth of the lightness."""
    linear = torch.where(display <= 0.04045, display / 12.92, ((display.clamp(min=0.04045) + 0.055) / 1.055) ** 2.4)
    x, y, z = turned(FORTH, linear).unbind(1)
    opponent, (height, width) = torch.stack((y, x - y, y - z), 1), display.shape[-2:]
    with torch.autocast(display.device.type, enabled=False):  # eight bits are too few
        passed = filters(height, display.device) @ opponent @ filters(width, display.device).mT
    y, red, blue = passed.unbind(1)
    linear = turned(BACK, torch.stack((red + y, y, y - blue), 1)).clamp(0, 1)
    value = turned(FORTH, linear)
    root = torch.where(value > KNEE**3, value.clamp(min=KNEE**3) ** (1 / 3), value / (3 * KNEE**2) + 4 / 29)
    x, y, z = root.unbind(1)
    lightness = 116 * y - 16
    share = lightness / 100
    return torch.stack((lightness, 500 * share * (x - y), 200 * share * (y - z)), 1)


def difference(output: Tensor, reference: Tensor) -> Tensor:
    """Mean FLIP of two pictures of sRGB code values (N, 3, H, W), without its attention to edges."""
    change = seen(output) - seen(reference)
    chroma = (change[:, 1:].square().sum(1) + 1e-6).sqrt()
    distance = change[:, 0].abs() + chroma
    return SCALE * (distance.square() + SOFT**2).pow(EXPONENT / 2).mean()
