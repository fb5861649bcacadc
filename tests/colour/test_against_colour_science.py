"""Primaries, transfer functions and displays against colour-science."""

from __future__ import annotations

import numpy as np
import pytest

from postfx import colour as primaries
from postfx.colour import displays
from postfx.colour.displays import parse_display
from postfx.colour.views import neutral, reinhard
from postfx.errors import ColourError

colour = pytest.importorskip("colour")

SPACES = {"rec709": "sRGB", "p3": "Display P3", "rec2020": "ITU-R BT.2020", "acescg": "ACEScg",
          "aces2065-1": "ACES2065-1"}
CODES = np.linspace(0, 1, 2001)


@pytest.mark.parametrize("source", SPACES)
@pytest.mark.parametrize("target", SPACES)
def test_matrices_between_spaces_are_those_of_colour_science(source: str, target: str) -> None:
    found = primaries.matrix_between(primaries.LINEAR_SPACES[source],
                                     primaries.LINEAR_SPACES[target])
    np.testing.assert_allclose(found,
                               colour.matrix_RGB_to_RGB(SPACES[source], SPACES[target], "Bradford"),
                               atol=3e-4)
    np.testing.assert_allclose(found @ np.ones(3), 1, atol=1e-12)


def test_luminance_weights_of_rec2020() -> None:
    np.testing.assert_allclose(primaries.LUMA_REC2020, primaries.to_xyz(primaries.REC2020)[1],
                               atol=1e-4)


@pytest.mark.parametrize(("curve", "decode"), [
    (displays.SRGB, colour.models.eotf_sRGB),
    (displays.BT1886, lambda codes: colour.models.eotf_BT1886(codes)),
    (displays.PQ, lambda codes: colour.models.eotf_ST2084(codes) / 10000),
    (displays.HLG, lambda codes: colour.models.oetf_inverse_BT2100_HLG(codes)),
], ids=["srgb", "bt1886", "pq", "hlg"])
def test_display_curves_are_those_of_colour_science(curve: displays.Curve, decode) -> None:
    np.testing.assert_allclose(curve.decode(CODES), decode(CODES), atol=2e-7)
    np.testing.assert_allclose(curve.encode(curve.decode(CODES)), CODES, atol=1e-6)
    assert np.isfinite(curve.encode(np.array([-1, np.nan, np.inf]))).all()


@pytest.mark.parametrize("peak", [400, 1000, 2000])
def test_hlg_display_is_that_of_bt2100(peak: int) -> None:
    display = parse_display(f"hlg,peak={peak}")
    codes = np.random.default_rng(0).random((500, 3))
    light = display.decode(codes)
    wanted = colour.models.eotf_BT2100_HLG(codes, L_B=0, L_W=peak, gamma=display.system_gamma)
    np.testing.assert_allclose(light * display.white, wanted, rtol=2e-3, atol=1e-3)
    np.testing.assert_allclose(display.encode(light), codes, atol=1e-6)


def test_pq_display_puts_white_at_203_nits_and_cuts_at_its_peak() -> None:
    display = parse_display("pq,peak=600")
    np.testing.assert_allclose(display.encode(np.ones(3)), colour.models.eotf_inverse_ST2084(203.0),
                               atol=1e-7)
    np.testing.assert_allclose(display.encode(np.full(3, 50.0)),
                               colour.models.eotf_inverse_ST2084(600.0), atol=1e-7)
    assert str(display) == "pq,peak=600,white=203"


@pytest.mark.parametrize(("text", "message"), [
    ("crt", "unknown display 'crt': use srgb, p3"),
    ("srgb,peak=200", "peak and white are for pq and hlg"),
    ("pq,peak=lots", "'peak=lots' is neither peak=NITS nor white=NITS"),
    ("pq,peak=100", "0 < white <= peak"),
    ("hlg,peak=4000", "400 to 2000"),
])
def test_displays_that_cannot_be(text: str, message: str) -> None:
    with pytest.raises(ColourError, match=message):
        parse_display(text)


def test_neutral_is_the_published_shader() -> None:
    """The reference is the GLSL of the specification, line by line for one colour."""
    light = np.exp2(np.random.default_rng(1).uniform(-10, 8, (400, 3)))
    np.testing.assert_allclose(neutral(light), [_neutral_glsl(rgb) for rgb in light], rtol=1e-9)
    assert neutral(np.full((1, 3), 1e9)).max() <= 1


def _neutral_glsl(rgb: np.ndarray) -> np.ndarray:
    x = min(rgb)
    rgb = rgb - (x - 6.25 * x * x if x < 0.08 else 0.04)
    peak = max(rgb)
    if peak < 0.76:
        return rgb
    d = 1 - 0.76
    new_peak = 1 - d * d / (peak + d - 0.76)
    rgb = rgb * new_peak / peak
    g = 1 - 1 / (0.15 * (peak - new_peak) + 1)
    return rgb * (1 - g) + new_peak * g


def test_reinhard_is_equation_3_of_the_paper() -> None:
    light = np.exp2(np.random.default_rng(2).uniform(-10, 8, (400, 3)))
    luminance = colour.RGB_luminance(light, primaries.REC709[:6], primaries.D65)
    found = colour.RGB_luminance(reinhard(light), primaries.REC709[:6], primaries.D65)
    np.testing.assert_allclose(found, luminance / (1 + luminance), rtol=1e-4)
    np.testing.assert_allclose(reinhard(light, most=4.9).max(-1) / light.max(-1),
                               1 / (1 + luminance / 4.9), rtol=1e-4)
