"""Overlays, and what is to become of them, in float64."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from postfx.kernels.image import positions


def over(front: np.ndarray, behind: np.ndarray) -> np.ndarray:
    """Porter and Duff 1984 in float64: front (h, w, 4) over behind (h, w, C), C 3, or 1 for
    alpha."""
    front, behind = front.astype(np.float64), behind.astype(np.float64)
    return ((front[..., :3] if behind.shape[2] == 3 else front[..., 3:])
            + (1 - front[..., 3:]) * behind)


def keys(t: np.ndarray) -> np.ndarray:
    """Weights (4, n) of the cubic convolution of Keys 1981, a = -0.5, by its piecewise formula."""
    x = np.abs(t - np.arange(-1, 3)[:, None])
    near, far = 1.5 * x**3 - 2.5 * x**2 + 1, -0.5 * x**3 + 2.5 * x**2 - 4 * x + 2
    return np.where(x <= 1, near, np.where(x < 2, far, 0))


def gathered(overlay: np.ndarray, size: tuple[int, int],
             jitter: tuple[float, float]) -> tuple[np.ndarray, np.ndarray]:
    """The 4x4 pixels around each output pixel, (4, 4, H, W, 4) in float64, and their weights (4, 4,
    H, W, 1)."""
    taps, weights = [], []
    for axis in range(2):
        at = positions(overlay.shape[axis], size[axis], jitter[1 - axis]).astype(np.float64)
        first = np.floor(at)
        taps.append(np.clip(first + np.arange(-1, 3)[:, None], 0, overlay.shape[axis] - 1)
                    .astype(int))
        weights.append(keys(at - first))
    pixels = overlay.astype(np.float64)[taps[0][:, None, :, None], taps[1][None, :, None, :]]
    return pixels, (weights[0][:, None, :, None] * weights[1][None, :, None, :])[..., None]


def reference(overlay: np.ndarray, size: tuple[int, int],
              jitter: tuple[float, float] = (0.0, 0.0)) -> np.ndarray:
    """Cubic, within the four nearest pixels, and colours within their straight colours times the
    coverage."""
    pixels, weights = gathered(overlay, size, jitter)
    nearest = pixels[1:3, 1:3].reshape(4, *size, 4)
    result = np.clip((pixels * weights).sum((0, 1)), nearest.min(0), nearest.max(0))
    alpha, light, coverage = result[..., 3:], nearest[..., :3], nearest[..., 3:]
    empty = (coverage == 0) & (light == 0)
    with np.errstate(divide="ignore", invalid="ignore"):
        low = np.where(empty, np.inf, light / coverage).min(0) * alpha
        high = np.where(empty, -np.inf, light / coverage).max(0) * alpha
    low, high = np.where(np.isfinite(low), low, -np.inf), np.where(np.isfinite(high), high, np.inf)
    return np.concatenate([np.clip(result[..., :3], low, high), alpha], 2)


def image(size: int, shape: Callable[[np.ndarray, np.ndarray], np.ndarray],
          jitter: tuple[float, float] = (0.0, 0.0), scale: float = 1.0,
          colour: tuple[float, float, float] = (0.9, 0.5, 0.2)) -> np.ndarray:
    """A premultiplied picture of coverage shape(x, y), sampled at pixel centres plus jitter, in
    units of `size`."""
    side = round(size * scale)
    at = (np.arange(side) + 0.5) / side
    alpha = np.broadcast_to(shape(at[None] + jitter[0] / side, at[:, None] + jitter[1] / side),
                            (side, side))[..., None]
    return np.concatenate([alpha * np.array(colour), alpha], 2)


def gaussian(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    return 0.8 * np.exp(-((x - 0.53) ** 2 + (y - 0.46) ** 2) / (2 * 0.11**2))


def disc(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    return ((x - 0.52) ** 2 + (y - 0.47) ** 2 < 0.31**2).astype(np.float64)


def particles(size: int, seed: int = 0) -> np.ndarray:
    """Pixels of any colour and coverage in any order: the worst there can be. Some are empty, some
    only shine."""
    random = np.random.default_rng(seed)
    alpha = random.choice([0, 0.05, 0.5, 1], (size, size, 1)) * random.random((size, size, 1))
    light = random.random((size, size, 3)) * alpha
    return np.concatenate([light, alpha], 2).astype(np.float32)
