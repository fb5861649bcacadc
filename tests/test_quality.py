"""The shipped denoiser against sequences with references that it was not trained on."""

from pathlib import Path

import numpy as np
import pytest
from scipy.ndimage import map_coordinates

import postfx
from postfx.frame import Role
from postfx.io.srgb import srgb_encode

# Open Image Denoise 2.5.1 (high, albedo and normal) on the same frames, enlarged by cubic interpolation:
# PSNR in dB and flicker x1000, both over frames 5 to 8.
OIDN = {"living_room": (21.98, 49.07), "staircase": (31.12, 17.97), "garage": (32.59, 14.23)}


def shown(colour: np.ndarray, exposure: float) -> np.ndarray:
    exposed = np.maximum(colour * exposure, 0)
    return srgb_encode(exposed / (1 + exposed))


def grey_exposure(colour: np.ndarray) -> float:
    """Multiplier that brings the log-average luminance to 0.18."""
    luminance = colour @ np.array([0.2126, 0.7152, 0.0722])
    return float(0.18 / np.exp(np.mean(np.log(luminance + 1e-3 * luminance.mean()))))


def reprojected(image: np.ndarray, motion: np.ndarray) -> np.ndarray:
    """``image`` (H, W, 3) sampled where motion (H, W, 2) points to, bilinear, edge repeated."""
    height, width = image.shape[:2]
    y, x = np.mgrid[0:height, 0:width].astype(np.float32)
    place = [y + motion[..., 1], x + motion[..., 0]]
    return np.stack([map_coordinates(image[..., c], place, order=1, mode="nearest") for c in range(3)], -1)


def measured(folder: Path) -> tuple[float, float]:
    denoise = postfx.DenoiseUpscale(scale=2)
    quality, flicker, last, exposure = [], [], None, None
    references = iter(postfx.read_sequence(folder / "reference.####.exr", planes=[Role.COLOUR]))
    for frame, reference in zip(postfx.read_sequence(folder / "noisy.####.exr"), references, strict=True):
        clean = denoise(frame)[Role.COLOUR]
        assert np.isfinite(clean).all()
        exposure = exposure or reference.exposure or grey_exposure(reference[Role.COLOUR])
        now = shown(clean, exposure), shown(reference[Role.COLOUR], exposure)
        motion = 2 * frame[Role.MOTION].repeat(2, 0).repeat(2, 1)
        if last:
            before = [reprojected(image, motion) for image in last]
            followed = np.abs(before[1] - now[1]).max(-1) < 0.1
            flicker.append(np.abs((now[0] - before[0]) - (now[1] - before[1]))[followed].mean())
        quality.append(-10 * np.log10(np.square(now[0] - now[1]).mean()))
        last = now
    return float(np.mean(quality[4:])), 1000 * float(np.mean(flicker[3:]))


@pytest.mark.slow
@pytest.mark.parametrize("name", OIDN)
def test_better_and_steadier_than_oidn(shared_dir, name):
    quality, flicker = measured(shared_dir / "sequences" / name)
    assert quality >= OIDN[name][0]
    assert flicker <= 0.75 * OIDN[name][1]
