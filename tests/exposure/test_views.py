"""False colour by the published bands, and zebra."""

import numpy as np
import pytest

from postfx.colour.views import FALSE_COLOUR_BANDS, false_colour, log_c, zebra
from postfx.tools.exposure.plot import add_key

COLOURS = {band.meaning: band.colour for band in FALSE_COLOUR_BANDS}


def shade(signal: float) -> tuple[int, ...]:
    return tuple(int(value) for value in false_colour(np.full((1, 1), signal, np.float32))[0, 0])


def test_bands_are_those_of_the_manual():
    levels = {band.meaning: (band.low, band.high) for band in FALSE_COLOUR_BANDS}
    assert (levels == {
        "black clipping": (0, 0.025), "just above black": (0.025, 0.04),
        "18 % mid grey": (0.38, 0.42), "a stop over grey": (0.52, 0.56),
        "just below white": (0.97, 0.99), "white clipping": (0.99, 1.0),
    })


@pytest.mark.parametrize(("signal", "meaning"), [
    (-0.1, "black clipping"), (0.01, "black clipping"), (0.03, "just above black"),
    (0.4, "18 % mid grey"), (0.54, "a stop over grey"), (0.98, "just below white"),
    (0.995, "white clipping"), (7.0, "white clipping"),
])  # fmt: skip
def test_a_signal_in_a_band_has_its_colour(signal, meaning):
    assert shade(signal) == COLOURS[meaning]


@pytest.mark.parametrize("signal", (0.05, 0.3, 0.45, 0.6, 0.9))
def test_between_the_bands_it_is_grey(signal):
    assert len(set(shade(signal))) == 1 and shade(signal)[0] == pytest.approx(255 * signal, abs=1)


def test_mid_grey_is_green_in_log_c():
    """By the manual it is at 400 of 1023."""
    signal = float(log_c(np.array([0.18]))[0])
    assert (signal == pytest.approx(400 / 1023, abs=5e-4)
            and shade(signal) == COLOURS["18 % mid grey"])


def test_log_c_is_that_of_another_implementation():
    encode = pytest.importorskip("colour").models.log_encoding_ARRILogC3
    linear = np.concatenate([np.linspace(0, 0.02, 50), np.geomspace(0.02, 50, 50)])
    np.testing.assert_allclose(log_c(linear), encode(linear), atol=1e-5)


def test_what_is_not_a_number_is_black():
    assert shade(float("nan")) == COLOURS["black clipping"]
    assert zebra(np.full((2, 2, 3), np.nan)).max() == 0


def test_zebra_strikes_the_highlights_and_nothing_else():
    display = np.full((40, 80, 3), 0.5)
    display[:, 40:] = 0.97
    found = zebra(display)
    assert (found[:, :40] == 128).all()
    struck = (found[:, 40:] == 0).all(axis=-1)
    assert 0.4 < struck.mean() < 0.6 and (found[:, 40:][~struck] == 247).all()


@pytest.mark.parametrize("width", (64, 640, 1920))
def test_the_key_stands_below_the_picture(width):
    picture = np.full((30, width, 3), 7, np.uint8)
    found = add_key(picture)
    assert found.shape[1] == width and np.array_equal(found[:30], picture)
    assert all((found[30:] == band.colour).all(axis=-1).any()
               for band in FALSE_COLOUR_BANDS[: max(width // 210, 1)])
