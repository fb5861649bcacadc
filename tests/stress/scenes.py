"""Pictures for the stress tests: a small scene with exact motion, and values that no frame should hold."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from postfx.frame import Frame, Role
from postfx.io.sequence import read_sequence
from postfx.passes.denoise_upscale import DenoiseUpscale
from postfx.pipeline import Pipeline
from postfx.runtime import Device
from tests.passes.denoise_frames import flat, noisy

ROOM = Path(__file__).resolve().parent.parent.parent / "samples/room"
MODELS = ("s.fp32", "m.int8")


def _set(**planes: float | Callable[[np.ndarray], np.ndarray]) -> Callable[[Frame], Frame]:
    """Replaces whole planes by a value, or by a function of them."""

    def change(frame: Frame) -> Frame:
        changed = {}
        for name, value in planes.items():
            plane = frame[Role(name)]
            changed[Role(name)] = value(plane) if callable(value) else np.full_like(plane, value)
        return replace(frame, planes={**frame.planes, **changed})

    return change


def _fireflies(colour: np.ndarray) -> np.ndarray:
    spotted = colour.copy()
    spotted[::7, ::5] = 1e6
    return spotted


MISSES = dict(depth=1e10, normal=0, diffuse_albedo=0, specular_albedo=0, roughness=0, motion=0)
EXPOSURES = (-40, -20, 20, 40)
LIGHTS = {f"{ev:+d} EV": _set(colour=lambda c, ev=ev: np.float32(c * 2.0**ev)) for ev in EXPOSURES} | {
    "black": _set(colour=0), "denormal": _set(colour=1e-42), "constant": _set(colour=0.5),
    "largest half": _set(colour=65504), "1e10": _set(colour=1e10), "largest float": _set(colour=3.4e38),
    "negative": _set(colour=lambda c: -c), "NaN": _set(colour=np.nan), "infinite": _set(colour=np.inf),
    "minus infinite": _set(colour=-np.inf), "fireflies": _set(colour=_fireflies),
}
HARD = LIGHTS | {
    "normals 0": _set(normal=0), "normals NaN": _set(normal=np.nan),
    "albedos 0": _set(diffuse_albedo=0, specular_albedo=0),
    "albedos broken": _set(diffuse_albedo=np.nan, specular_albedo=np.inf),
    "roughness 0": _set(roughness=0), "roughness NaN": _set(roughness=np.nan),
    "depth 0": _set(depth=0), "depth infinite": _set(depth=np.inf), "depth NaN": _set(depth=np.nan),
    "depth denormal": _set(depth=1e-42), "depth negative": _set(depth=-1),
    "motion 1e6": _set(motion=1e6), "motion -1e6": _set(motion=-1e6), "motion 9e4": _set(motion=9e4),
    "motion NaN": _set(motion=np.nan), "motion infinite": _set(motion=np.inf),
    "misses": _set(**MISSES), "black misses": _set(colour=0, **MISSES),
    "everything NaN": _set(**dict.fromkeys(map(str, noisy(1, 2, 2).planes), np.nan)),
}
"""Name -> what it makes of a frame; of its colour alone in LIGHTS."""
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
