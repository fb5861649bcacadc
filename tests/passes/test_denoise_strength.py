"""Strength of the denoised upscaler: from the resampled input to the denoised picture."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from postfx.errors import PassOptionError
from postfx.frame import Frame, Role
from postfx.kernels.image import RESAMPLE, positions
from postfx.passes.denoise import DenoiseUpscale
from postfx.passes.denoise.frame import ReadyNetwork
from postfx.pipeline import Pipeline
from postfx.runtime import Device
from tests.passes.denoise_frames import guided, noisy

SIZES = [((37, 50), 2), ((17, 5), 1.5), ((16, 24), 1), ((9, 13), 3)]


@pytest.fixture(scope="module")
def device() -> Device:
    return Device("cpu", threads=2)


def run(frames: list[Frame], device: Device, **options) -> list[np.ndarray]:
    pipeline = Pipeline([DenoiseUpscale(**{"scale": 2, **options})], device, exposure=0.0)
    return [pipeline(frame)[Role.COLOUR] for frame in frames]


def masked(frame: Frame, strength: np.ndarray | float) -> Frame:
    """The frame with a plane of strength."""
    height, width = frame[Role.COLOUR].shape[:2]
    plane = np.broadcast_to(np.asarray(strength, np.float32), (height, width))[..., None]
    return replace(frame, planes={**frame.planes, Role.STRENGTH: plane.copy()})


def resampled(frame: Frame, role: Role, scale: float) -> np.ndarray:
    """A plane at output size, sampled at pixel centres."""
    image = frame[role]
    size = tuple(round(side * scale) for side in image.shape[:2])
    rows, columns = (positions(image.shape[i], size[i], frame.jitter[1 - i]) for i in range(2))
    output = np.empty((*size, image.shape[2]), np.float32)
    RESAMPLE.rows(0, size[0], image, rows, columns, output)
    return output


@pytest.mark.parametrize(("size", "scale"), SIZES)
def test_no_strength_is_the_resampled_input(size: tuple[int, int], scale: float,
                                            device: Device) -> None:
    frames = [noisy(number, *size) for number in (1, 2)]
    wanted = [resampled(frame, Role.COLOUR, scale) for frame in frames]
    assert frames[0].jitter != (0.0, 0.0) and min(picture.min() for picture in wanted) >= 0
    for found in (run(frames, device, scale=scale, strength=0),
                  run([masked(frame, 0) for frame in frames], device, scale=scale)):
        np.testing.assert_array_equal(found, wanted)


@pytest.mark.parametrize(("size", "scale"), SIZES)
def test_between_is_linear_and_both_strengths_multiply(size: tuple[int, int], scale: float,
                                                       device: Device) -> None:
    frame = noisy(1, *size)
    mask = masked(frame, np.random.default_rng(0).random(size))
    share = 0.5 * resampled(mask, Role.STRENGTH, scale)
    (full,), plain = run([frame], device, scale=scale), resampled(frame, Role.COLOUR, scale)
    found = run([mask], device, scale=scale, strength=0.5)[0]
    np.testing.assert_allclose(found, plain + (full - plain) * share, rtol=1e-5, atol=1e-5)
    uniform = run([frame], device, scale=scale, strength=0.25)[0]
    np.testing.assert_allclose(uniform, plain + (full - plain) * 0.25, rtol=1e-5, atol=1e-5)


def test_full_strength_is_the_denoised_picture_where_the_plane_says_so(device: Device) -> None:
    frame = noisy(1, 24, 40)
    half = np.repeat([[0.0, 1.0]], 24, 0).repeat(20, 1)
    (full,), (found,) = run([frame], device), run([masked(frame, half)], device)
    np.testing.assert_array_equal(found[:, 44:], full[:, 44:])
    np.testing.assert_array_equal(found[:, :36], resampled(frame, Role.COLOUR, 2)[:, :36])


@pytest.mark.parametrize(("size", "scale"), [((37, 50), 2), ((40, 5), 1.5), ((29, 13), 3)])
def test_rows_of_full_strength_are_denoised_and_those_beside_them_blended(
    size: tuple[int, int], scale: float, device: Device
) -> None:
    """To the bit where the strength is 0 or 1: with the longest run of such rows in the middle, at
    an end, or cut by a single pixel."""
    frame, pipeline = noisy(1, *size), Pipeline([DenoiseUpscale(scale=scale)], device, exposure=0.0)
    (full,), plain = run([frame], device, scale=scale), resampled(frame, Role.COLOUR, scale)
    for first, end, hole in ((0, size[0] - 3, None), (6, size[0], None), (4, size[0] - 5, 7),
                             (5, size[0] - 1, None)):
        strength = np.zeros(size, np.float32)
        strength[first:end], strength[first - 1:first] = 1.0 if first < 5 else 1.5, 0.4
        if hole is not None:
            strength[hole, 2] = 0.99
        pipeline.reset()
        found, share = (make(masked(frame, strength)) for make in (
            lambda one: pipeline(one)[Role.COLOUR],
            lambda one: np.clip(resampled(one, Role.STRENGTH, scale), 0, 1)))
        mixed = plain + (full - plain) * share  # rounded once more than by the kernel
        np.testing.assert_allclose(found, mixed, rtol=2e-6, atol=1e-6)
        ends = np.broadcast_to((share == 0) | (share == 1), found.shape)
        np.testing.assert_array_equal(found[ends], np.where(share == 1, full, plain)[ends])
        assert (share == 1).all((1, 2)).mean() > 0.5


@pytest.mark.parametrize(("size", "scale"), SIZES)
def test_strength_1_everywhere_is_not_blended(size: tuple[int, int], scale: float,
                                              device: Device) -> None:
    frames = [noisy(number, *size) for number in (1, 2, 3)]
    pipeline = Pipeline([DenoiseUpscale(scale=scale)], device, exposure=0.0)
    strengths = (1, np.pad([[0.5]], ((0, size[0] - 1), (0, size[1] - 1)), constant_values=1), 2)
    found = [pipeline(masked(frame, value))[Role.COLOUR]
             for frame, value in zip(frames, strengths, strict=True)]
    wanted = run(frames, device, scale=scale)
    assert [np.array_equal(one, other)
            for one, other in zip(found, wanted, strict=True)] == [True, False, True]
    told = {item.what: item.why for item in pipeline.explain().skips}
    assert (told["blend with the input for 2 frames in denoise_upscale"] == "strength is 1 "
            "everywhere")


def test_noise_that_is_left_in_does_not_reach_the_next_frame(device: Device) -> None:
    strengths = (0.1, 0.3, 1)
    frames = [noisy(number) for number in (1, 2, 3)]
    found = run([masked(frame, value) for frame, value in zip(frames, strengths, strict=True)],
                device)
    wanted = run([masked(frame, 1) for frame in frames], device)
    assert np.abs(found[1] - wanted[1]).max() > 1e-2
    np.testing.assert_array_equal(found[2], wanted[2])


def test_a_mask_that_no_file_should_hold(device: Device) -> None:
    frame = noisy(1, 24, 40)
    mask = masked(frame, 1.0)
    mask[Role.STRENGTH][5:8] = np.array([np.nan, -7.0, 9.0])[:, None, None]
    found, full = run([mask], device)[0], run([frame], device)[0]
    assert np.isfinite(found).all() and found.min() >= 0
    np.testing.assert_array_equal(found[:6], full[:6])


def test_nothing_is_read_or_run_for_nothing() -> None:
    spec = masked(guided(noisy(1), 74, 100), 1).spec
    bare = Pipeline([DenoiseUpscale(strength=0)]).explain(spec)
    assert (bare.planes, bare.guides) == ((Role.COLOUR,), ())
    assert bare.remarks == ("denoise_upscale: strength 0: the input is only resampled",)
    assert Role.STRENGTH in Pipeline([DenoiseUpscale()]).explain(spec).planes
    alone = DenoiseUpscale(scale=2, strength=0)
    assert (Pipeline([alone])(noisy(1))[Role.COLOUR].shape == (74, 100, 3)
            and not isinstance(alone._ready, ReadyNetwork))


def test_strength_in_the_portable_kernels(device: Device) -> None:
    portable = Device("cpu", threads=2, compiled_kernels=False)
    mask = masked(noisy(1, 17, 21), np.linspace(-0.2, 1.2, 21))
    one, other = (run([mask], place, scale=1.5, strength=0.9)[0] for place in (device, portable))
    np.testing.assert_allclose(one, other, rtol=1e-3, atol=1e-3)


@pytest.mark.parametrize("strength", [-0.1, 1.1, float("nan")])
def test_a_strength_out_of_range_is_an_error(strength: float) -> None:
    with pytest.raises(PassOptionError, match="strength .*: give a number from 0 to 1"):
        DenoiseUpscale(strength=strength)
