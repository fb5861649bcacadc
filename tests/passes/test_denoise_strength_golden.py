"""Strength against float64: Keys' cubic for what is left as it is, and a linear blend with the
denoised picture."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from postfx.frame import Frame, Role
from postfx.passes.denoise import DenoiseUpscale
from postfx.pipeline import Pipeline
from postfx.runtime import Device
from tests.passes.denoise_frames import guided, noisy
from tests.passes.test_denoise_strength import masked

EXACT = 1e-4
CASES = [(1, False), (1, True), (1.5, False), (1.5, True), (2, False), (2, True)]


@pytest.fixture(scope="module")
def device() -> Device:
    return Device("cpu", threads=2)


def frame_of(size: tuple[int, int], scale: float, with_guides: bool, number: int = 1) -> Frame:
    """Noise of values up to 1, jittered."""
    frame = noisy(number, *size)
    frame.planes[Role.COLOUR] /= 30
    return guided(frame, *enlarged(size, scale)) if with_guides else frame


def enlarged(size: tuple[int, int], scale: float) -> tuple[int, int]:
    return tuple(round(side * scale) for side in size)


def taps(size: int, out_size: int, jitter: float) -> tuple[np.ndarray, np.ndarray]:
    """Samples around each output pixel's centre, borders repeated, and their weights: (4, out_size)
    each.

    R. Keys, "Cubic convolution interpolation for digital image processing", 1981, equation 15: a =
    -1/2.
    """
    centre = (np.arange(out_size, dtype=np.float64) + 0.5) * size / out_size - 0.5 - jitter
    first = np.floor(centre)
    index = first[None] + np.arange(-1, 3)[:, None]
    away = np.abs(centre[None] - index)
    near, far = 1.5 * away**3 - 2.5 * away**2 + 1, -0.5 * away**3 + 2.5 * away**2 - 4 * away + 2
    return index.clip(0, size - 1).astype(int), np.where(away <= 1, near,
                                                         np.where(away < 2, far, 0))


def enlarged64(image: np.ndarray, out_size: tuple[int, int],
               jitter: tuple[float, float]) -> np.ndarray:
    """The input at output size: cubic both ways, within the least and the largest of the four
    samples around."""
    image = image.astype(np.float64)
    (rows, down), (columns,
                   across) = (taps(image.shape[i], out_size[i], jitter[1 - i]) for i in (0, 1))
    near = image[rows][:, :, columns]  # (4, height, 4, width, channels)
    cubic = np.einsum("jyixc,jy,ix->yxc", near, down, across)
    four = near[1:3][:, :, 1:3]
    return cubic.clip(four.min((0, 2)), four.max((0, 2)))


def run(frame: Frame, device: Device, scale: float, **options) -> np.ndarray:
    return Pipeline([DenoiseUpscale(scale=scale, **options)], device,
                    exposure=0.0)(frame)[Role.COLOUR]


def blended64(mask: Frame, full: np.ndarray, factor: float = 1.0) -> np.ndarray:
    """From the enlarged input to the denoised picture by the enlarged strength."""
    plain, share = (enlarged64(mask[role], full.shape[:2], mask.jitter)
                    for role in (Role.COLOUR, Role.STRENGTH))
    return plain + (full.astype(np.float64) - plain) * share.clip(0, 1) * factor


def ramp(size: tuple[int, int]) -> np.ndarray:
    """A strength that rises from 0 to 1 across the picture, 0 and 1 at its sides."""
    return np.broadcast_to(np.linspace(-0.5, 1.5, size[1]).clip(0, 1), size)


@pytest.mark.parametrize("samples", [4, 256])
@pytest.mark.parametrize(("scale", "with_guides"), CASES)
def test_strength_0_is_the_enlarged_input_to_the_bit(
    scale: float, with_guides: bool, samples: int, device: Device
) -> None:
    """Everywhere, or beside pixels that are denoised; at 256 samples the frame is judged for detail
    at scale 1."""
    frame = replace(frame_of((37, 50), scale, with_guides), samples=samples, jitter=(0.0, 0.0))
    nothing = run(frame, device, scale, strength=0)
    np.testing.assert_allclose(nothing,
                               enlarged64(frame[Role.COLOUR], nothing.shape[:2], frame.jitter),
                               atol=EXACT)
    np.testing.assert_array_equal(run(masked(frame, 0), device, scale), nothing)
    part = ramp((37, 50))
    mask = masked(frame, part)
    untouched = enlarged64(part[..., None], nothing.shape[:2], (0, 0))[..., 0] == 0
    found = run(mask, device, scale)
    assert 0.2 < untouched.mean() < 0.3
    np.testing.assert_array_equal(found[untouched], nothing[untouched])
    assert (found[~untouched] != nothing[~untouched]).mean() > 0.9


@pytest.mark.parametrize(("scale", "with_guides"), CASES)
def test_between_is_a_linear_blend(scale: float, with_guides: bool, device: Device) -> None:
    frame = frame_of((37, 50), scale, with_guides)
    full = run(masked(frame, 1), device, scale)
    for plane, factor in ((ramp((37, 50)), 1.0), (np.random.default_rng(3).random((37, 50)), 0.6)):
        found = run(masked(frame, plane), device, scale, strength=factor)
        np.testing.assert_allclose(found, blended64(masked(frame, plane), full, factor), atol=EXACT)
    np.testing.assert_array_equal(full, run(frame, device, scale))


@pytest.mark.parametrize("scale", [1.5, pytest.param(2, marks=pytest.mark.soak)])
def test_windows_and_tiles_blend_alike(scale: float) -> None:
    """A strip is denoised in a window, the ramp all over; in a budget both in tiles."""
    size = (320, 330)
    frame = frame_of(size, scale, False)
    strip = np.zeros(size, np.float32)
    strip[150:200, 100:180] = ramp((50, 80))
    whole, tiled = (Device("cpu", threads=2, memory=memory) for memory in (None, "560M"))
    full, nothing = (run(frame, whole, scale, model="s.fp32", strength=value) for value in (1, 0))
    for plane in (strip, ramp(size)):
        mask = masked(frame, plane)
        wanted = blended64(mask, full)
        untouched = enlarged64(mask[Role.STRENGTH], full.shape[:2], mask.jitter)[..., 0] == 0
        for place in (whole, tiled):
            found = run(mask, place, scale, model="s.fp32")
            np.testing.assert_allclose(found, wanted, atol=EXACT)
            np.testing.assert_array_equal(found[untouched], nothing[untouched])
