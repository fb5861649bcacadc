"""Light outside the gamut, which is negative: a shot that has enough of it is denoised in wider
primaries."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from postfx.colour import TO_WIDER_PRIMARIES
from postfx.doctor.first_frames import FirstFrames
from postfx.frame import GUIDE_ROLES, Frame, Role
from postfx.kernels.statistics import OUTSIDE, light_outside
from postfx.passes.denoise import DenoiseUpscale
from postfx.passes.denoise import frame as denoise_frame
from postfx.pipeline import Pipeline
from postfx.runtime import Device
from tests.passes.denoise_frames import flat, guided
from tests.stress.scenes import portable

LAMPS = np.array([[6.0, -0.9, -0.3], [-1.5, 4.0, -0.4], [0.0, 0.0, 0.0]], np.float32)
"""A red and a green lamp beyond Rec.709, and a pixel whose path met none."""
GREYS = np.array([[4.0, 4.0, 4.0], [2.0, 2.0, 2.0], [0.0, 0.0, 0.0]], np.float32)

ORANGE = np.array([[2.0, 1.0, 0.3]], np.float32)


@pytest.fixture(scope="module")
def device() -> Device:
    return Device("cpu", threads=2)


def lit(number: int, lamps: np.ndarray = LAMPS, **kept) -> Frame:
    """A wall that reflects half, 48x64: each pixel has met one of three lamps by chance."""
    frame = flat(number, 0.0, 48, 64, **kept)
    met = np.random.default_rng(number).integers(0, len(lamps), (48, 64))
    frame.planes[Role.COLOUR] = (lamps / 2)[met]
    return frame


def upscaler(device: Device, **options) -> Pipeline:
    return Pipeline([DenoiseUpscale(**{"model": "s.fp32", "scale": 1, **options})], device,
                    exposure=0.0)


def error_of_mean(frame: Frame, lamps: np.ndarray = LAMPS) -> float:
    """How far the mean colour is from the wall's, by the largest channel."""
    wanted = lamps.mean(0) / 2
    return float(np.abs(frame[Role.COLOUR].mean((0, 1), dtype=np.float64) - wanted)
                 .max() / wanted.max())


def is_wider(pipeline: Pipeline) -> bool:
    return bool(pipeline.history()["pass denoise_upscale/wider primaries"])


def test_what_lies_outside() -> None:
    """Light counts by its brightness up to that of the usual pixel; here all is as bright as
    that."""
    grey = np.full((60, 70, 3), 1.0, np.float32)
    assert light_outside(grey) == 0
    assert light_outside(-grey) == 0, "below 0, but grey: no primaries hold it"
    assert light_outside(grey * (-1.0, -0.5, -0.1)) == 0, "no pixel has light"
    assert light_outside(np.zeros_like(grey)) == light_outside(grey[:0]) == 0
    beyond = grey.copy()
    beyond[:, :7] = 1.0, -0.5, -0.1
    gained = 0.6 + np.minimum(TO_WIDER_PRIMARIES @ beyond[0, 0], 0).sum()
    assert light_outside(beyond) == pytest.approx(gained * 7 / (1.6 * 7 + 3 * 63))
    beyond[5, 50], beyond[6, 50] = np.nan, np.inf
    assert light_outside(beyond) == pytest.approx(gained * 7 / (1.6 * 7 + 3 * 63), rel=0.01)


def test_a_firefly_and_a_pixel_filter_decide_nothing() -> None:
    """Of a bright white point, a sharp filter leaves rings below 0; a red firefly of 1e6 is one
    pixel."""
    random = np.random.default_rng(4)
    picture = np.exp(random.normal(0, 1, (90, 120, 3))).astype(np.float32)
    picture[30, 40] = 1e6, -2e5, -1e5
    assert 0 < light_outside(picture) < OUTSIDE / 5
    points = np.where(random.random((90, 120, 1)) < 0.02, 50.0, 0.3) * (1.0, 0.9, 0.7)
    ringing = sum(weight * np.roll(points, shift, axis) for weight, shift, axis in (
        (1.4, 0, 0), (-0.1, 1, 0), (-0.1, -1, 0), (-0.1, 1, 1), (-0.1, -1, 1)))
    assert (ringing < 0).mean() > 0.05 and light_outside(ringing.astype(np.float32)) < OUTSIDE


@pytest.mark.parametrize("options", [{}, {"scale": 2, "model": "s"}, {"model": "classic"}], ids=str)
def test_saturated_light_keeps_its_colour(options: dict[str, object], device: Device,
                                          monkeypatch: pytest.MonkeyPatch) -> None:
    frames = list(map(lit, (1, 2, 3)))
    pipeline = upscaler(device, **options)
    assert error_of_mean([pipeline(frame) for frame in frames][-1]) < 0.1
    assert is_wider(pipeline)
    monkeypatch.setattr(denoise_frame, "OUTSIDE", 1.0)
    cut = upscaler(device, **options)
    assert error_of_mean([cut(frame)
                          for frame in frames][-1]) > 0.3, "each pixel's negative light is cut"


def test_the_portable_kernels_give_the_same(device: Device) -> None:
    found, wanted = (upscaler(one)(lit(1))[Role.COLOUR] for one in (portable(device), device))
    np.testing.assert_allclose(found, wanted, atol=1e-3)


def test_ordinary_frames_stay_as_they_are(device: Device, monkeypatch: pytest.MonkeyPatch) -> None:
    """Also with one negative pixel."""
    frames = [lit(number, GREYS) for number in (1, 2, 3)]
    frames[1][Role.COLOUR][20, 30] = 3.0, -2.0, 0.0
    pipeline = upscaler(device)
    found = [pipeline(frame)[Role.COLOUR] for frame in frames]
    assert not is_wider(pipeline)
    monkeypatch.setattr(denoise_frame, "OUTSIDE", 1.0)
    never = upscaler(device)
    for one, frame in zip(found, frames, strict=True):
        np.testing.assert_array_equal(one, never(frame)[Role.COLOUR])


def test_a_light_comes_on_in_the_middle_of_a_shot(device: Device,
                                                  monkeypatch: pytest.MonkeyPatch) -> None:
    """From then on to the end of the shot; the history goes on, as if the shot had begun in wider
    primaries."""
    frames = [lit(1, ORANGE), lit(2, ORANGE), lit(3), lit(4, ORANGE)]
    pipeline, states, found = upscaler(device), [], []
    for frame in frames:
        found.append(pipeline(frame)[Role.COLOUR])
        states.append(is_wider(pipeline))
    assert states == [False, False, True, True]
    pipeline(replace(frames[0], reset=True))
    assert not is_wider(pipeline)
    monkeypatch.setattr(denoise_frame, "OUTSIDE", -1.0)
    always = upscaler(device)
    for one, frame in zip(found, frames, strict=True):
        assert np.sqrt(np.mean((one - always(frame)[Role.COLOUR]) ** 2)) < 0.002, "0.018 without"


def test_a_run_goes_on_in_wider_primaries(device: Device) -> None:
    first, second = upscaler(device), upscaler(device)
    first(lit(1))
    second.recall(lit(1), first.history())
    grey = lit(2, GREYS)
    np.testing.assert_array_equal(second(grey)[Role.COLOUR], first(grey)[Role.COLOUR])
    assert is_wider(second)


@pytest.mark.parametrize("options", [{}, {"part_filters": "own"}, {"strength": 0.5}], ids=str)
def test_parts_of_saturated_light_add_up(options: dict[str, object], device: Device) -> None:
    pipeline = upscaler(device, parts=("left", "right"), scale=2, **options)
    for number in (1, 2):
        frame = lit(number, GREYS if number == 1 else LAMPS)
        share = np.linspace(0, 1, 64, dtype=np.float32)[:, None]
        frame.parts = {"left": frame[Role.COLOUR] * (1 - share),
                       "right": frame[Role.COLOUR] * share}
        found = pipeline(frame)
        np.testing.assert_allclose(found.parts["left"] + found.parts["right"], found[Role.COLOUR],
                                   rtol=1e-4, atol=1e-4)
    assert is_wider(pipeline)
    left = found.parts["left"].mean((0, 1))
    assert np.abs(left - frame.parts["left"].mean((0, 1))).max() < 0.1 * left.max() and left[2] < 0


def test_guides_are_converted_too(device: Device) -> None:
    frame = guided(lit(1), 96, 128, roles=GUIDE_ROLES)
    frame.guides[Role.DIFFUSE_ALBEDO][:] = 0.7, 0.4, 0.1
    found = upscaler(device, scale=2, model="m.fp32")(frame)
    assert np.isfinite(found[Role.COLOUR]).all() and error_of_mean(found) < 0.15


def test_the_user_is_warned_where_it_is_cut() -> None:
    told = FirstFrames(on_gpu=True).look(lit(1))
    assert any("outside the gamut" in text for text in told)
    assert [text for text in told if "gamut" not in text] == FirstFrames().look(lit(1))
    assert not any("gamut" in text for text in FirstFrames(on_gpu=True).look(lit(1, GREYS)))
