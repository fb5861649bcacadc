"""Colour spaces of files against OpenColorIO and colour-science."""

from __future__ import annotations

import numpy as np
import pytest

from postfx.colour import LINEAR_SPACES, REC709, is_degenerate, round_to_known
from postfx.errors import ColourError
from postfx.io.colours import InputColours, space_by_id, space_by_primaries

FORUM = ("lin_ap1_scene", "lin_ap0_scene", "lin_rec709_scene", "lin_p3d65_scene",
         "lin_rec2020_scene", "lin_adobergb_scene", "lin_ciexyzd65_scene", "srgb_rec709_scene",
         "g22_rec709_scene", "g18_rec709_scene", "srgb_ap1_scene", "g22_ap1_scene",
         "srgb_p3d65_scene", "g22_adobergb_scene", "ocio:g24_rec709_scene")
CONFIG = "studio-config-v4.0.0_aces-v2.0_ocio-v2.5"


def to_rec709(identifier: str, colours: np.ndarray) -> np.ndarray:
    space = space_by_id(identifier)
    light = space.decode(colours) if space.decode else colours
    return light @ space.matrix.T


def assert_like_opencolorio(identifier: str, colours: np.ndarray) -> None:
    ocio = pytest.importorskip("PyOpenColorIO")
    config = ocio.Config.CreateFromBuiltinConfig(CONFIG)
    processor = config.getProcessor(identifier, "Linear Rec.709 (sRGB)")
    wanted = np.ascontiguousarray(colours, np.float32)
    processor.getOptimizedCPUProcessor(ocio.OPTIMIZATION_NONE).applyRGB(wanted)
    np.testing.assert_allclose(to_rec709(identifier, colours), wanted, rtol=1e-4, atol=1e-4,
                               err_msg=identifier)


def test_every_identifier_of_the_forum_is_what_opencolorio_makes_of_it() -> None:
    colours = np.random.default_rng(0).uniform(-0.2, 4, (200, 3))
    for identifier in FORUM:
        assert_like_opencolorio(identifier, colours)
    codes = np.random.default_rng(1).random((9, 3))
    np.testing.assert_allclose(to_rec709("g24_rec709_scene", codes),
                               to_rec709("ocio:g24_rec709_scene", codes))


def test_every_identifier_that_opencolorio_added() -> None:
    ocio = pytest.importorskip("PyOpenColorIO")
    config = ocio.Config.CreateFromBuiltinConfig(CONFIG)
    added = [space.getInteropID()
             for space in config.getColorSpaces() if space.getInteropID().startswith("ocio:")]
    assert len(added) > 30
    for identifier in added:
        assert_like_opencolorio(identifier, np.random.default_rng(2).uniform(0.1, 0.6, (50, 3)))


def test_chromaticities_of_every_colour_space_that_colour_science_knows() -> None:
    colour = pytest.importorskip("colour")
    target = colour.RGB_Colourspace("own", np.reshape(REC709[:6], (3, 2)), REC709[6:])
    spaces = {name: (*np.ravel(own.primaries), *own.whitepoint)
              for name, own in colour.RGB_COLOURSPACES.items()}
    assert len(spaces) > 60
    spaces["XYZ"] = (1, 0, 0, 1, 0, 0, 1 / 3, 1 / 3)
    for name, primaries in spaces.items():
        stored = tuple(float(np.float32(number)) for number in primaries)  # as a header has them
        own = colour.RGB_Colourspace("own", np.reshape(primaries[:6], (3, 2)), primaries[6:])
        wanted = colour.matrix_RGB_to_RGB(own, target, "Bradford")
        found = InputColours().space({"chromaticities": stored}).matrix
        np.testing.assert_allclose(found, wanted, rtol=1e-4, atol=1e-4, err_msg=name)


def test_rounded_headers_stand_for_the_spaces_that_they_round() -> None:
    for primaries in LINEAR_SPACES.values():
        assert (round_to_known(tuple(round(float(np.float32(number)), 5) for number in primaries))
                == primaries)
    near = (*REC709[:7], 0.3291)
    assert round_to_known(near) == near


@pytest.mark.parametrize("primaries", [
    (0.0,) * 8, (0.1, 0.1, 0.2, 0.2, 0.3, 0.3, 1 / 3, 1 / 3), (*REC709[:6], 0.3, 0.0),
    (*REC709[:7], np.nan),
    (*REC709[:4], *REC709[:2], *REC709[6:]), (*REC709[:6], *REC709[:2]), (*REC709[:7], np.inf),
])
def test_primaries_that_span_no_colours_are_refused(primaries: tuple[float, ...]) -> None:
    assert is_degenerate(primaries)
    with pytest.raises(ColourError,
                       match=r"chromaticities \(.*\) span no colours: say what .* --colourspace "
                       r"\(rec709"):
        space_by_primaries(primaries)


@pytest.mark.parametrize(("identifier", "message"), [
    ("lin_foo_scene", "'lin_foo_scene' is not known: say what the colours are with --colourspace"),
    ("g24_rec2020_scene", "is not known"),
    ("ocio:nothing_scene", "is not known"),
    ("studio:plate", "is not known"),
    ("srgb_rec709_display", "is a picture for a display"),
    ("ocio:lin_ciexyzd65_display", "is a picture for a display"),
])
def test_other_identifiers_are_refused(identifier: str, message: str) -> None:
    with pytest.raises(ColourError, match=message):
        space_by_id(identifier)
