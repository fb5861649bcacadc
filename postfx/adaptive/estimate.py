"""The expected squared error of denoised pixels, in display code values: read from files, or estimated.

A network that predicts it writes a plane `error`. Without one it is estimated from the second differences of the
pixels, before and after denoising, in code values (exposed, x / (1 + x), sRGB), squared and averaged around each pixel.
Before, they show noise and detail together; after, the detail that the denoiser found. Where there is much of both it
errs most. The error of a tile is near SHARE before^BEFORE_POWER after^AFTER_POWER. The constants are fitted to tiles of
scenes with references; docs/howto/render_more.md says what such estimates are worth.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from postfx.colour.views import to_codes
from postfx.errors import FrameError
from postfx.frame import Frame, Role
from postfx.io.channels import ChannelIndex, read_channels
from postfx.io.image_file import ImageFile
from postfx.sampling import local_mean

PLANE = "error"
"""Layer of the predicted error in files."""
RADIUS = 8
"""Of the squares that differences are averaged over, in pixels."""
SHARE, BEFORE_POWER, AFTER_POWER = 0.66, 0.714, 0.287
LEAST = 1e-7
"""Mean square of differences that counts as flat."""


def read_error(path: Path) -> np.ndarray | None:
    """The plane `error` of a file (height, width), the mean of its channels; None where it has none."""
    with ImageFile(path) as file:
        channels = ChannelIndex({"": file.parts}).matching(PLANE)
        if not channels:
            return None
        pixels = read_channels({"": file}, dict.fromkeys(channels, 0.0))
        found: np.ndarray = np.mean([pixels[channel] for channel in channels], axis=0)
    return found


def estimate_error(noisy: Frame, denoised: np.ndarray, exposure_factor: float) -> np.ndarray:
    """Expected squared error of each pixel (height, width) of a denoised colour (height, width, 3) of a frame's size.

    Raises FrameError where sizes differ.
    """
    colour = noisy[Role.COLOUR]
    if colour.shape != denoised.shape:
        raise FrameError(f"{noisy.source or noisy.number}: is {colour.shape[1]}x{colour.shape[0]}, its denoised frame "
                         f"{denoised.shape[1]}x{denoised.shape[0]}: denoise it at the render's size")
    before, after = (_busyness(to_codes(light, exposure_factor)) for light in (colour, denoised))
    found = SHARE * before**BEFORE_POWER * after**AFTER_POWER
    error: np.ndarray = found[:, :, 0].astype(np.float32)
    return error


def _busyness(codes: np.ndarray) -> np.ndarray:
    """Second differences along both axes, squared, mean of the channels and the pixels around: (height, width, 1); of
    white noise its variance (Immerkaer 1996, "Fast noise variance estimation")."""
    padded = np.pad(codes, ((1, 1), (1, 1), (0, 0)), mode="edge")
    rows = padded[:-2] - 2 * padded[1:-1] + padded[2:]
    found = np.square(rows[:, :-2] - 2 * rows[:, 1:-1] + rows[:, 2:]) / 36
    mean: np.ndarray = np.maximum(local_mean(found.mean(axis=2, keepdims=True), RADIUS), LEAST)
    return mean
