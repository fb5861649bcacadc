"""Pictures for the stress tests: the sample and a small scene with exact motion; pipelines of the
denoiser; devices."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from postfx.frame import Frame, Role
from postfx.io.sequence import read_sequence
from postfx.passes.denoise import DenoiseUpscale
from postfx.pipeline import Pipeline
from postfx.runtime import Device
from tests.passes.denoise_frames import flat

ROOM = Path(__file__).resolve().parent.parent.parent / "samples/room"
PROVIDERS = ("cpu", pytest.param("gpu", marks=pytest.mark.gpu))
"""Fixtures of devices."""
SIZES = ((1, 1), (1, 40), (40, 1), (2, 3), (13, 17), (31, 29), (3, 257), (199, 2))
"""Heights and widths: single pixels and rows, odd and prime sides, extreme aspects."""


def pipeline(model: str, device: Device, exposure: str | float = 0.0,
             **options: Any) -> Pipeline:
    """The denoiser alone, to twice the size by default; cuts are only where the test says so."""
    return Pipeline([DenoiseUpscale(model=model, **{"scale": 2, **options})], device, exposure,
                    cuts="none")


@cache
def _held(model: str, device: Device, exposure: str | float) -> Pipeline:
    return pipeline(model, device, exposure)


def held(model: str, device: Device, exposure: str | float = "auto") -> Pipeline:
    """One pipeline for all tests of a process, which has forgotten all frames."""
    chain = _held(model, device, exposure)
    chain.reset()
    return chain


def colours(frames: list[Frame], model: str, device: Device,
            stops: float = 0.0) -> list[np.ndarray]:
    """What a pipeline that begins with these frames makes of them. Runs of frames of one spec have
    one session, so that they are to be compared: on a GPU two sessions may use different
    algorithms."""
    chain = held(model, device, "metadata")
    return [chain(replace(frame, exposure=stops))[Role.COLOUR] for frame in frames]


def on(
    cpu: tuple[str, ...] = ("s.fp32", "m.int8"), gpu: tuple[str, ...] = ("s.fp32", "s.fp16")
) -> pytest.MarkDecorator:
    """Runs a test with models on the device that they are made for."""
    runs = [pytest.param("cpu", model) for model in cpu]
    runs += [pytest.param("gpu", model, marks=pytest.mark.gpu) for model in gpu]
    return pytest.mark.parametrize(("device", "model"), runs, indirect=["device"])


@cache
def portable(device: Device) -> Device:
    """The same device with kernels by their portable definitions."""
    return Device(device.name, threads=2, compiled_kernels=False)


def way(kind: str, device: Device) -> tuple[str, Device]:
    """Model and device of 's.fp32' or 's.fp32, portable'."""
    model, _, by_definitions = kind.partition(", ")
    return model, portable(device) if by_definitions else device


def room() -> list[Frame]:
    """A part of the sample sequence, eight frames of 96x160."""
    cut = slice(40, 136), slice(60, 220)
    return [replace(frame, planes={role: np.ascontiguousarray(plane[cut])
                                   for role, plane in frame.planes.items()})
            for frame in read_sequence(ROOM / "noisy.####.exr")]


def sliding(number: int, speed: int, noise: float = 0.0, height: int = 32,
            width: int = 48) -> Frame:
    """A smooth texture that slides right by `speed` pixels a frame and comes in again at the left.

    noise: variance over squared mean of the light, gamma-distributed and new in every frame.
    """
    random = np.random.default_rng(5)
    light, albedo = 2 * _smooth(random, height, width), 0.2 + 0.6 * _smooth(random, height, width)
    frame = flat(number, 0.0, height, width)
    colour = np.roll(light * albedo, speed * number, axis=1)
    if noise:
        colour = colour * np.random.default_rng([9, number]).gamma(1 / noise, noise,
                                                                   (height, width, 1))
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
