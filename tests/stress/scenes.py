"""Pictures for the stress tests: the sample and a small scene with exact motion; and pipelines of the denoiser."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from postfx.frame import Frame, Role
from postfx.io.sequence import read_sequence
from postfx.passes.denoise_upscale import DenoiseUpscale
from postfx.pipeline import Pipeline
from postfx.runtime import Device
from tests.passes.denoise_frames import flat

ROOM = Path(__file__).resolve().parent.parent.parent / "samples/room"
MODELS = ("s.fp32", "m.int8")


SIZES = ((1, 1), (1, 40), (40, 1), (2, 3), (13, 17), (31, 29), (3, 257), (199, 2))
"""Heights and widths: single pixels and rows, odd and prime sides, extreme aspects."""


def pipeline(model: str, device: Device, exposure: str | float = 0.0, **options) -> Pipeline:
    """The denoiser alone; cuts are only where the test says so."""
    return Pipeline([DenoiseUpscale(model=model, **options)], device, exposure, cuts="none")


def colours(frames: list[Frame], model: str, device: Device, exposure: str | float = 0.0) -> list[np.ndarray]:
    """What a pipeline that begins with these frames makes of them."""
    chain = pipeline(model, device, exposure)
    return [chain(frame)[Role.COLOUR] for frame in frames]


def room() -> list[Frame]:
    """A part of the sample sequence, eight frames of 96x160."""
    cut = slice(40, 136), slice(60, 220)
    return [replace(frame, planes={role: np.ascontiguousarray(plane[cut]) for role, plane in frame.planes.items()})
            for frame in read_sequence(ROOM / "noisy.####.exr")]


def sliding(number: int, speed: int, noise: float = 0.0, height: int = 32, width: int = 48) -> Frame:
    """A smooth texture that slides right by `speed` pixels a frame and comes in again at the left.

    noise: variance over squared mean of the light, gamma-distributed and new in every frame.
    """
    random = np.random.default_rng(5)
    light, albedo = 2 * _smooth(random, height, width), 0.2 + 0.6 * _smooth(random, height, width)
    frame = flat(number, 0.0, height, width)
    colour = np.roll(light * albedo, speed * number, axis=1)
    if noise:
        colour = colour * np.random.default_rng([9, number]).gamma(1 / noise, noise, (height, width, 1))
    frame.planes[Role.COLOUR] = colour.astype(np.float32)
    frame.planes[Role.DIFFUSE_ALBEDO] = np.roll(albedo, speed * number, axis=1).astype(np.float32)
    frame.planes[Role.MOTION][..., 0] = -speed
    return frame


def _smooth(random: np.random.Generator, height: int, width: int) -> np.ndarray:
    """(height, width, 3) in 0..1, periodic, without fine detail."""
    spectrum = np.fft.fft2(random.normal(size=(height, width, 3)), axes=(0, 1))
    squares = np.fft.fftfreq(height)[:, None, None] ** 2 + np.fft.fftfreq(width)[None, :, None] ** 2
    picture = np.fft.ifft2(spectrum * np.exp(-0.5 * squares / 0.05**2), axes=(0, 1)).real
    return (picture - picture.min()) / np.ptp(picture)


def display_psnr(found: np.ndarray, wanted: np.ndarray, exposure: float = 1.0) -> float:
    """PSNR in dB of exposed light compressed by x / (1 + x), at most 160."""
    shown = [exposure * light.astype(np.float64) / (1 + exposure * light.astype(np.float64))
             for light in (found, wanted)]
    return float(-10 * np.log10(np.mean((shown[0] - shown[1]) ** 2) + 1e-16))
