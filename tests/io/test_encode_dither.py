"""Quantising code values, dithered and plain."""

from __future__ import annotations

import numpy as np
import pytest

from postfx.io.quantisation import NOISE_SIDE_PX, Dither, blue_noise, quantise

DITHERED = (Dither.MOVING, Dither.STATIC)


def flat(value: float, side: int = 2 * NOISE_SIDE_PX) -> np.ndarray:
    return np.full((side, side, 3), value / 255, np.float32)


def ramp(low: float, high: float, width: int = 4096) -> np.ndarray:
    """From one code value to another, 128 rows."""
    return np.broadcast_to((np.linspace(low, high, width, dtype=np.float32) / 255)[None, :, None],
                           (128, width, 3))


def test_each_threshold_is_there_once_and_low_frequencies_are_not() -> None:
    noise = blue_noise()
    assert (sorted((noise * NOISE_SIDE_PX**2 - 0.5).round().astype(int).ravel())
            == list(range(NOISE_SIDE_PX**2)))
    spectrum = np.abs(np.fft.fft2(noise - 0.5))
    radius = np.hypot(*np.meshgrid(*[np.fft.fftfreq(NOISE_SIDE_PX)] * 2))
    assert spectrum[(radius > 0) & (radius < 0.15)].mean() < 0.1 * spectrum[radius > 0.35].mean()


@pytest.mark.parametrize("dither", DITHERED)
@pytest.mark.parametrize("value", [0.001, 17.25, 100.5, 254.9])
def test_the_mean_of_an_area_is_kept(dither: Dither, value: float) -> None:
    assert quantise(flat(value), 8, dither,
                    number=7).mean((0, 1)) == pytest.approx([value] * 3, abs=2e-4)


@pytest.mark.parametrize("dither", DITHERED)
def test_the_error_is_below_one_code_value(dither: Dither) -> None:
    codes = np.random.default_rng(0).random((200, 300, 3), np.float32)
    for number in (1, 2, 1000):
        error = quantise(codes, 8, dither, number).astype(float) - codes * 255.0
        assert np.abs(error).max() < 1


@pytest.mark.parametrize("dither", Dither)
@pytest.mark.parametrize("bits", [8, 16])
def test_whole_numbers_stay_and_everything_else_is_in_range(dither: Dither, bits: int) -> None:
    top = 2**bits - 1
    whole = (np.arange(0, top + 1, top // 255, dtype=np.float64) / top).astype(np.float32)
    picture = np.ascontiguousarray(np.broadcast_to(whole[:, None, None], (whole.size, 70, 3)))
    found = quantise(picture, bits, dither, number=3)
    np.testing.assert_array_equal(found[:, 69, 2], np.arange(0, top + 1, top // 255))
    assert quantise(np.float32([[[np.nan, -np.inf, np.inf]]]), bits,
                    dither).tolist() == [[[0, 0, top]]]


def test_dither_leaves_no_bands_in_a_ramp() -> None:
    """A ramp over four code values: averaged over 32x32 pixels it is the ramp; undithered it is a
    staircase."""
    codes = ramp(60, 64)
    local = lambda picture: picture[:, :, 1].reshape(4, 32, 128, 32).mean((1, 3))  # noqa: E731
    wanted = local(codes * 255.0)
    assert np.abs(local(quantise(codes, 8, Dither.MOVING)) - wanted).max() < 0.03
    assert np.abs(local(quantise(codes, 8, Dither.NONE)) - wanted).max() > 0.4


def test_the_pattern_follows_frame_and_pixel_only() -> None:
    codes = ramp(60, 64, 300)
    moving = [quantise(codes, 8, Dither.MOVING, number) for number in (1, 2, 1)]
    np.testing.assert_array_equal(moving[0], moving[2])
    assert (moving[0] != moving[1]).any()
    np.testing.assert_array_equal(*(quantise(codes, 8, Dither.STATIC, number) for number in (1, 2)))
    pieces = [quantise(codes[rows], 8, Dither.MOVING, 1, rows.start)
              for rows in (slice(0, 50), slice(50, 128))]
    np.testing.assert_array_equal(np.concatenate(pieces), moving[0])


def test_16_bits_are_rounded() -> None:
    codes = ramp(60, 64, 300)
    rounded = np.rint(codes * np.float32(65535)).astype(np.uint16)
    np.testing.assert_array_equal(quantise(codes, 16, Dither.MOVING), rounded)
