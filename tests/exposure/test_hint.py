"""The exposure is a hint: it tells what the eye will see, and never changes how bright the output
is."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

import postfx
from postfx import DenoiseUpscale, Frame, Pipeline, Role, ToneMap
from postfx.passes.display import Display
from postfx.runtime import Device

SEQUENCE = Path(__file__).resolve().parents[2] / "samples" / "room" / "noisy.####.exr"
EXPOSURE = 1.7278


@pytest.fixture(scope="module")
def device() -> Device:
    return Device("cpu", threads=2)


@pytest.fixture(scope="module")
def frames() -> list[Frame]:
    """A part of the sample, 96x160: each network runs over it a dozen times."""
    cut = np.s_[40:136, 60:220]
    return [dataclasses.replace(frame,
                                planes={role: plane[cut] for role, plane in frame.planes.items()})
            for frame in postfx.read_sequence(SEQUENCE, frames="1-3")]


def outputs(frames: list[Frame], passes: list, device: Device, light: float = 1.0,
            hint: float | None = None):
    """Colour of each frame after the passes, where the input is `light` times as bright; hint None:
    auto."""
    pipeline = Pipeline(passes, device, "auto" if hint is None else "metadata")
    planes = ({**frame.planes, Role.COLOUR: np.float32(light) * frame[Role.COLOUR]}
              for frame in frames)
    stops = None if hint is None else np.log2(hint)
    given = (dataclasses.replace(frame, planes=p, exposure=stops)
             for frame, p in zip(frames, planes, strict=True))
    return np.stack([pipeline(frame)[Role.COLOUR] for frame in given])


@pytest.mark.parametrize("view", [[], [ToneMap], [Display]], ids=["linear", "tonemap", "display"])
def test_half_the_light_at_twice_the_exposure_is_the_same_picture(view, frames,
                                                                  device: Device) -> None:
    def run(light: float, hint: float) -> np.ndarray:
        shown = outputs(frames, [DenoiseUpscale(), *(made() for made in view)], device, light, hint)
        return shown if view else shown * hint  # scene-linear output keeps the light of the input

    wanted = run(1.0, EXPOSURE)
    assert wanted.std() > 0.1
    for factor in (2.0, 16.0):
        np.testing.assert_allclose(run(1 / factor, EXPOSURE * factor), wanted, atol=1e-3, rtol=1e-3)


@pytest.mark.parametrize("model", ["s.int8", "s.fp32", "m.fp32", "l.int8"])
def test_doubling_changes_no_pixel_in_any_precision(model: str, frames, device: Device) -> None:
    def run(factor: float) -> np.ndarray:
        return outputs(frames[:2], [DenoiseUpscale(model=model)], device, 1 / factor,
                       EXPOSURE * factor) * factor

    np.testing.assert_array_equal(run(2.0), run(1.0))


def test_a_factor_of_three_is_the_same_to_a_thousandth_with_a_network_of_floats(
    frames, device: Device
) -> None:
    """Integers round: a few pixels at a rounding edge differ, the picture does not."""
    def run(model: str, factor: float) -> np.ndarray:
        return outputs(frames, [DenoiseUpscale(model=model), ToneMap()], device, 1 / factor,
                       EXPOSURE * factor)

    np.testing.assert_allclose(run("m.fp32", 3.0), run("m.fp32", 1.0), atol=1e-3)
    assert abs(run("m.int8", 3.0) - run("m.int8", 1.0)).mean() < 1e-3


def test_auto_exposure_makes_the_same_picture_of_any_light(frames, device: Device) -> None:
    wanted = outputs(frames, [DenoiseUpscale(), ToneMap()], device)
    np.testing.assert_allclose(outputs(frames, [DenoiseUpscale(), ToneMap()], device, 0.5), wanted,
                               atol=1e-3)


@pytest.mark.parametrize("factor", (3e-7, 1e-6, 1e-3, 1e5))
def test_auto_exposure_makes_the_same_light_of_dim_and_bright_frames(factor: float, frames,
                                                                     device: Device) -> None:
    """It stopped at 16 stops before, so that light of 1e-6 came out 2.3 % darker than light of
    3e-7."""
    wanted = outputs(frames[:2], [DenoiseUpscale(model="m.fp32")], device)
    found = outputs(frames[:2], [DenoiseUpscale(model="m.fp32")], device,
                    factor) / np.float32(factor)
    assert found.mean() == pytest.approx(wanted.mean(), rel=1e-4)
    np.testing.assert_allclose(found, wanted, atol=2e-3 * wanted.max())


@pytest.mark.parametrize("factor", (0.5, 2.0))
def test_the_hint_alone_does_not_change_the_brightness(factor: float, frames,
                                                       device: Device) -> None:
    wanted = outputs(frames, [DenoiseUpscale()], device, hint=EXPOSURE)
    found = outputs(frames, [DenoiseUpscale()], device, hint=EXPOSURE * factor)
    assert not np.array_equal(found, wanted)  # it does decide in which tones detail is kept
    np.testing.assert_allclose(found.mean(axis=(1, 2, 3)), wanted.mean(axis=(1, 2, 3)), rtol=0.01)


def test_the_tone_mapper_exposes_by_it(frames, device: Device) -> None:
    """Behind the tone mapper it is no hint any more: there it is the exposure."""
    wanted = outputs(frames, [ToneMap()], device, hint=EXPOSURE)
    assert outputs(frames, [ToneMap()], device, hint=2 * EXPOSURE).mean() > 1.1 * wanted.mean()
