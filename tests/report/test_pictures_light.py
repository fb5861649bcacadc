"""Codes of light: fine enough for a screen at every exposure, and what is not finite stays
visible."""

import numpy as np
import pytest

from postfx.colour.displays import srgb_encode
from postfx.colour.views import to_codes
from postfx.tools.report.pictures import HIGHEST_CODE, TOE_LIGHT, encode_light, pack_codes


def light_of(codes, highest):
    return TOE_LIGHT * ((1 + highest / TOE_LIGHT) ** (codes / HIGHEST_CODE) - 1)


@pytest.mark.parametrize("stops", [-6, -2, 0, 2, 4])
def test_scene_light_differs_by_less_than_a_step_of_the_screen(stops):
    light = np.float32(np.geomspace(2**-8, 60, 3000).reshape(10, 100, 3))
    decoded = light_of(encode_light(light, 64.0), 64.0)
    difference = np.abs(to_codes(np.float32(decoded), 2.0**stops) - to_codes(light, 2.0**stops))
    assert difference.max() < 1 / 255


def test_light_of_a_display_likewise():
    light = np.float32(np.linspace(0, 1, 3000).reshape(10, 100, 3))
    difference = np.abs(srgb_encode(light_of(encode_light(light, 1.0), 1.0)) - srgb_encode(light))
    assert difference.max() < 1 / 255


def test_what_is_out_of_range_is_clipped_and_what_is_not_finite_is_magenta():
    light = np.float32([[[-1, 0, 1e9], [np.nan, 1, 1], [1, np.inf, 1]]])
    codes = encode_light(light, 64.0)
    assert codes.dtype == np.uint16
    assert codes[0].tolist() == [[0, 0, HIGHEST_CODE], [HIGHEST_CODE, 0, HIGHEST_CODE],
                                 [HIGHEST_CODE, 0, HIGHEST_CODE]]


def test_smooth_light_is_packed_small():
    light = np.float32(np.linspace(0, 2, 64 * 48 * 3).reshape(48, 64, 3))
    facts = pack_codes(encode_light(light, 64.0), 64.0)
    assert (facts["width"], facts["height"], facts["highest"]) == (64, 48, 64.0)
    assert len(facts["data"]) < 0.2 * light.size
