"""Light as files store it: half floats and displays' light, against NumPy and the curves
themselves."""

import numpy as np
import pytest

from postfx.colour.displays import DISPLAY_KINDS, parse_display
from postfx.io.exr.picture import light_of, to_halves

LEAST_NORMAL = 2.0**-14


def bits_of(values: np.ndarray) -> np.ndarray:
    return np.where(np.isnan(values), np.uint16(0x7E00), values.view(np.uint16))


def by_numpy(light: np.ndarray) -> np.ndarray:
    return np.clip(light, -65504, 65504).astype(np.float16)


def test_every_half_float_is_kept_and_so_is_what_lies_beside_it() -> None:
    half = np.arange(1 << 16, dtype=np.uint16).view(np.float16).astype(np.float32)
    numbers = half[np.isfinite(half)]
    between = (numbers[:-1] + numbers[1:]) / 2  # ties, which go to the even one
    beside = [np.nextafter(between, np.float32(side)) for side in (-np.inf, np.inf)]
    for values in (half, between, *beside):
        np.testing.assert_array_equal(bits_of(to_halves(values)), bits_of(by_numpy(values)))


def test_any_float_becomes_what_numpy_makes_of_it() -> None:
    random = np.random.default_rng(0)
    values = random.integers(0, 1 << 32, 1 << 20, np.uint32).view(np.float32)
    np.testing.assert_array_equal(bits_of(to_halves(values)), bits_of(by_numpy(values)))
    shape = (7, 5, 4)
    strided = random.normal(size=(14, 5, 4)).astype(np.float32)[::2]
    assert to_halves(strided).shape == shape and to_halves(strided).dtype == np.float16
    np.testing.assert_array_equal(to_halves(strided), by_numpy(strided))
    assert to_halves(np.zeros((0, 3))).shape == (0, 3)


@pytest.mark.parametrize("name", DISPLAY_KINDS)
def test_light_of_a_display_is_that_of_its_curve(name: str) -> None:
    display = parse_display(name)
    codes = np.float32(np.random.default_rng(1).random((500, 400, 3)) ** 2)
    exact, found = display.decode(codes.astype(np.float64)), light_of(codes, display)
    assert found.dtype == np.float32 and found.shape == codes.shape
    stored = np.abs(exact) >= LEAST_NORMAL
    assert stored.mean() > 0.5
    np.testing.assert_allclose(found[stored], exact[stored], rtol=2e-6)
    np.testing.assert_allclose(found[~stored], exact[~stored], atol=1e-8)
    for ends in ([[0, 0, 0], [1, 1, 1]], [[-0.1, 0.5, 1.1]], [[np.nan, 0, 1]]):
        np.testing.assert_allclose(light_of(np.float32(ends), display),
                                   display.decode(np.float32(ends)), atol=1e-7)
