"""The pass `display` against colour-science."""

from __future__ import annotations

import numpy as np
import pytest

from postfx.colour.displays import parse_display
from postfx.errors import PassOptionError
from postfx.frame import Frame, FrameSpec, Role
from postfx.passes.display import Display
from postfx.pipeline import Pipeline
from postfx.runtime import Device

colour = pytest.importorskip("colour")

SPACES = {"srgb": "sRGB", "p3": "Display P3", "rec709": "ITU-R BT.709", "rec2020": "ITU-R BT.2020",
          "pq": "ITU-R BT.2020", "hlg": "ITU-R BT.2020"}
CURVES = {"srgb": colour.models.eotf_inverse_sRGB, "p3": colour.models.eotf_inverse_sRGB,
          "rec709": colour.models.eotf_inverse_BT1886, "rec2020": colour.models.eotf_inverse_BT1886}
BOUND = {"srgb": 1e-6, "p3": 1e-6, "rec709": 2e-6, "rec2020": 2e-6, "pq": 5e-6, "hlg": 1e-5}
"""Largest difference of code values; a code of 16 bits is 1.5e-5."""


@pytest.fixture(scope="module")
def device() -> Device:
    return Device("cpu", threads=2)


def shown(
    light: np.ndarray, display: str, device: Device, encoding: str = "scene-linear", ev: float = 0.0
) -> np.ndarray:
    frame = Frame({Role.COLOUR: light.astype(np.float32)}, encoding=encoding)
    result = Pipeline([Display(display=display)], device, exposure=ev)(frame)
    assert result.encoding == str(parse_display(display))
    return result[Role.COLOUR].astype(np.float64)


def by_colour_science(light: np.ndarray, display: str) -> np.ndarray:
    """Code values of linear Rec.709 by colour-science, with matrices out of the primaries (its own
    are rounded)."""
    target = parse_display(display)
    space = colour.RGB_COLOURSPACES[SPACES[target.name]].copy()
    space.use_derived_matrix_RGB_to_XYZ = space.use_derived_matrix_XYZ_to_RGB = True
    source = colour.RGB_COLOURSPACES["sRGB"].copy()
    source.use_derived_matrix_RGB_to_XYZ = source.use_derived_matrix_XYZ_to_RGB = True
    light = np.clip(colour.RGB_to_RGB(light, source, space, "Bradford"), 0, target.most)
    if target.name == "pq":
        return colour.models.eotf_inverse_ST2084(light * target.white)
    if target.name == "hlg":
        nits = light * target.white
        nits = np.maximum(nits, 1e-13)  # it divides by their sum
        return colour.models.eotf_inverse_BT2100_HLG(nits, L_B=0, L_W=target.peak,
                                                     gamma=target.system_gamma).clip(0, 1)
    return CURVES[target.name](light)


@pytest.mark.parametrize("display", ["srgb", "p3", "rec709", "rec2020", "pq,peak=600",
                                     "pq,peak=4000,white=100", "hlg", "hlg,peak=2000"])
def test_light_is_encoded_as_colour_science_does(display: str, device: Device) -> None:
    random = np.random.default_rng(4)
    light = np.exp2(random.uniform(-14, 5, (64, 64, 3))) * random.choice([1, 1, 1, 0.01],
                                                                         (64, 64, 3))
    light[0, :4], light[0, 4] = [[1, 0, 0], [0, 1, 0], [0, 0, 1], [0, 0, 0]], [0.2, -0.05, 0.1]
    found = shown(light / 4, display, device, ev=2.0)
    np.testing.assert_allclose(found, by_colour_science(light, display),
                               atol=BOUND[display.partition(",")[0]])


@pytest.mark.parametrize("display", ["p3", "rec709", "rec2020", "pq", "hlg"])
def test_srgb_pictures_keep_their_colours(display: str, device: Device) -> None:
    codes = np.random.default_rng(5).random((32, 32, 3)).astype(np.float32)
    codes[0, 0], codes[0, 1] = 1, 0
    light = colour.models.eotf_sRGB(codes.astype(np.float64))
    found = shown(codes, display, device, "srgb")
    np.testing.assert_allclose(found, by_colour_science(light, display), atol=BOUND[display] + 2e-6)
    assert parse_display(display).decode(found).max() < 1 + 1e-4


def test_there_and_back(device: Device) -> None:
    codes = np.random.default_rng(5).uniform(0.02, 1, (16, 16, 3))
    for display in ("p3", "rec709", "rec2020"):
        there = shown(codes, display, device, "srgb")
        np.testing.assert_allclose(shown(there, "srgb", device, display), codes, atol=5e-6)


def test_diffuse_white_is_203_nits_and_the_plan_says_what_is_no_hdr(device: Device) -> None:
    white = shown(np.ones((2, 2, 3)), "hlg", device)
    np.testing.assert_allclose(white, 0.75, atol=3e-3)  # ITU-R BT.2408-7, table 1
    (remark,) = Pipeline([Display(display="pq")],
                         device).explain(FrameSpec(2, 2, [Role.COLOUR], "srgb")).remarks
    assert (remark == "display: the picture was made for srgb: its white is shown at 203 nits, "
            "nothing is brighter")
    assert Pipeline([Display(display="pq")],
                    device).explain(FrameSpec(2, 2, [Role.COLOUR])).remarks == ()


def test_bad_pixels(device: Device) -> None:
    light = np.ones((1, 3, 3), np.float32)
    light[0, 0, 1], light[0, 1], light[0, 2, 0] = np.nan, np.inf, -np.inf
    for display in ("srgb", "p3", "pq", "hlg"):
        found = shown(light, display, device)
        assert np.isfinite(found).all()
        np.testing.assert_allclose(found[0, 1], found.max(), atol=1e-5)


def test_pictures_for_hdr_are_not_turned_into_others(device: Device) -> None:
    with pytest.raises(PassOptionError,
                       match="cannot turn pq,peak=1000,white=203 into srgb: tone-map for"):
        shown(np.ones((2, 2, 3)), "srgb", device, "pq")
