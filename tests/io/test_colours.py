"""Colours of files in other primaries than Rec.709."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import OpenImageIO as oiio
import pytest

from postfx.colour import ACES2065_1, ACESCG, REC709
from postfx.errors import ColourError
from postfx.frame import Frame, Role
from postfx.io.colours import InputColours
from postfx.io.sequence import read_sequence
from postfx.io.writer import write_frame

colour = pytest.importorskip("colour")

NAMES = ("R", "G", "B", "albedo.R", "albedo.G", "albedo.B", "depth.Z")


@pytest.fixture
def stored() -> np.ndarray:
    """Light of all colours of AP1, reflectances and depth."""
    pixels = np.random.default_rng(1).random((6, 8, 7), np.float32)
    pixels[..., :3] *= 8
    pixels[0, 0, :3], pixels[0, 1, :3] = (1, 0, 0), np.inf
    return pixels


@pytest.fixture
def write(stored: np.ndarray, tmp_path: Path):
    def with_header(**header) -> Path:
        spec = oiio.ImageSpec(8, 6, 7, "float")
        spec.channelnames = NAMES
        for name, value in header.items():
            kind = (oiio.TypeDesc("float[8]") if name == "chromaticities"
                    else oiio.TypeDesc("string"))
            spec.attribute(name, kind, value)
        output = oiio.ImageOutput.create(str(tmp_path / "a.exr"))
        assert output.open(str(tmp_path / "a.exr"), spec) and output.write_image(stored)
        output.close()
        return tmp_path / "a.exr"

    return with_header


def in_rec709(light: np.ndarray) -> np.ndarray:
    return light @ colour.matrix_RGB_to_RGB("ACEScg", "sRGB", "Bradford").T


def assert_turned(frame: Frame, stored: np.ndarray) -> None:
    finite = np.isfinite(stored[..., 0])
    np.testing.assert_allclose(frame[Role.COLOUR][finite], in_rec709(stored[finite][:, :3]),
                               atol=5e-3)
    np.testing.assert_allclose(frame[Role.DIFFUSE_ALBEDO],
                               np.maximum(in_rec709(stored[..., 3:6]), 0), atol=1e-3)
    np.testing.assert_array_equal(frame[Role.DEPTH][..., 0], stored[..., 6])
    assert frame.metadata["chromaticities"] == REC709


@pytest.mark.parametrize("white", [0.0, 1 / 3])
def test_chromaticities_of_zeros_say_nothing(write, stored, white) -> None:
    sequence = read_sequence(write(chromaticities=(*(0.0,) * 6, white, white)))
    (frame,) = sequence
    np.testing.assert_array_equal(frame[Role.COLOUR], stored[..., :3])
    assert sequence.warnings == [] and "chromaticities" not in frame.metadata


def test_chromaticities_say_it(write, stored) -> None:
    sequence = read_sequence(write(chromaticities=ACESCG))
    frame = next(iter(sequence))
    assert_turned(frame, stored)
    assert sequence.warnings == ["colours are acescg: turned to linear Rec.709"]
    assert frame[Role.COLOUR][0, 0, 1] < -0.1  # red of AP1 is outside Rec.709
    assert (frame[Role.COLOUR][0, 1] > 1e29).all()


def test_the_color_interop_id_says_it(write, stored) -> None:
    frame = next(iter(read_sequence(write(colorInteropID="lin_ap1_scene"))))
    assert_turned(frame, stored)
    assert frame.metadata["colorInteropID"] == "lin_rec709_scene"


def test_encoded_colours_are_made_linear(write, stored, tmp_path) -> None:
    """Also where they stay in their own primaries."""
    light = colour.models.eotf_sRGB(stored[1:, :, :3])
    for identifier, own in (("srgb_rec709_scene", light), ("srgb_ap1_scene", in_rec709(light))):
        sequence = read_sequence(write(colorInteropID=identifier))
        np.testing.assert_allclose(next(iter(sequence))[Role.COLOUR][1:], own, rtol=2e-3, atol=3e-2)
        assert sequence.warnings == [f"colours are {identifier}: turned to linear Rec.709"]
    sequence = read_sequence(write(colorInteropID="srgb_ap1_scene"), colourspace="native")
    (frame,) = sequence
    np.testing.assert_allclose(frame[Role.COLOUR][1:], light, rtol=1e-4)
    assert sequence.warnings == ["colours are srgb_ap1_scene: made linear"]
    header = oiio.ImageBuf(str(write_frame(tmp_path / "b.exr", frame, keep=True))).spec()
    assert header.getattribute("colorInteropID") == "lin_ap1_scene"
    np.testing.assert_allclose(header.getattribute("chromaticities"), ACESCG, atol=1e-6)


def test_the_identifier_counts_more_than_chromaticities(write, stored) -> None:
    frame = next(iter(read_sequence(write(chromaticities=REC709, colorInteropID="lin_ap1_scene"))))
    assert_turned(frame, stored)
    silent = next(iter(read_sequence(write(chromaticities=ACESCG, colorInteropID="unknown"))))
    assert_turned(silent, stored)


def test_aces_files_say_it_by_their_flag(write_parts, ramp, tmp_path) -> None:
    """The flag is for uncompressed halves only, so what is written names the primaries instead."""
    path = write_parts("a.exr", {"rgb": ramp("R", "G", "B")}, acesImageContainerFlag=1)
    (frame,), (native,) = read_sequence(path), read_sequence(path, colourspace="native")
    matrix = colour.matrix_RGB_to_RGB("ACES2065-1", "sRGB", "Bradford")
    np.testing.assert_allclose(frame[Role.COLOUR], native[Role.COLOUR] @ matrix.T, atol=2e-3)
    header = oiio.ImageBuf(str(write_frame(tmp_path / "b.exr", native, keep=True))).spec()
    np.testing.assert_allclose(header.getattribute("chromaticities"), ACES2065_1, atol=1e-6)
    assert header.getattribute("acesImageContainerFlag") is None


def test_headers_of_another_type_say_nothing() -> None:
    for header in ({"colorInteropID": np.ones(3)}, {"colorInteropID": 7},
                   {"acesImageContainerFlag": np.ones(2)}, {"chromaticities": ("a",) * 8},
                   {"chromaticities": (1.0,) * 7}, {"chromaticities": "long"}):
        assert InputColours().space(header).is_rec709


def test_the_colours_part_says_it(write_parts, ramp) -> None:
    """A part of data beside it says nothing about colours; a part without an identifier has the
    others'."""
    channels = {"CryptoObject00": ramp("R", "G", "B", "A"), "beauty": ramp("R", "G", "B")}
    path = write_parts("a.exr", channels, colorInteropID="data")
    with read_sequence(path).open(1) as files:
        assert "colorInteropID" not in files.layout.attributes
    path = write_parts("b.exr", dict(reversed(channels.items())), colorInteropID="lin_ap1_scene")
    sequence = read_sequence(path)
    next(iter(sequence))
    assert sequence.warnings == ["colours are acescg: turned to linear Rec.709"]


@pytest.mark.parametrize("header", [
    {"chromaticities": (0.3,) * 8},
    {"chromaticities": (0.1, 0.1, 0.2, 0.2, 0.3, 0.3, 0.3127, 0.329)},
    {"colorInteropID": "lin_foo_scene"}, {"colorInteropID": "srgb_rec709_display"},
])
def test_colours_that_cannot_be_known_are_refused_by_name_and_may_be_declared(write,
                                                                              header) -> None:
    path = write(**header)
    with pytest.raises(ColourError,
                       match=r"a\.exr: (chromaticities|colorInteropID) .*--colourspace"):
        next(iter(read_sequence(path)))
    next(iter(read_sequence(path, colourspace="acescg")))


def test_the_user_says_it(write, stored) -> None:
    assert_turned(next(iter(read_sequence(write(), colourspace="acescg"))), stored)
    wrong = next(iter(read_sequence(write(chromaticities=ACESCG), colourspace="rec709")))
    np.testing.assert_array_equal(wrong[Role.COLOUR], stored[..., :3])


def test_other_primaries_without_a_name(write) -> None:
    odd = (0.66, 0.32, 0.28, 0.65, 0.15, 0.05, 0.3127, 0.329)
    sequence = read_sequence(write(chromaticities=odd))
    frame = next(iter(sequence))
    assert sequence.warnings == ["colours are of primaries without a name: turned to linear "
                                 "Rec.709"]
    own = colour.RGB_Colourspace("odd", np.reshape(odd[:6], (3, 2)), odd[6:])
    wanted = colour.matrix_RGB_to_RGB(own, colour.RGB_COLOURSPACES["sRGB"], "Bradford")[:, 0]
    np.testing.assert_allclose(frame[Role.COLOUR][0, 0], wanted, atol=1e-3)


@pytest.mark.parametrize("header",
                         [{}, {"chromaticities": REC709}, {"colorInteropID": "lin_rec709_scene"}])
def test_rec709_is_left_alone(write, stored, header) -> None:
    sequence = read_sequence(write(**header))
    np.testing.assert_array_equal(next(iter(sequence))[Role.COLOUR], stored[..., :3])
    assert sequence.warnings == []


def test_native_colours_are_written_as_they_came_with_their_primaries(write, stored,
                                                                      tmp_path) -> None:
    frame = next(iter(read_sequence(write(chromaticities=ACESCG), colourspace="native")))
    again = oiio.ImageBuf(str(write_frame(tmp_path / "b.exr", frame, bits=32)))
    np.testing.assert_array_equal(again.get_pixels("float")[1:, :, :3], stored[1:, :, :3])
    np.testing.assert_allclose(again.spec().getattribute("chromaticities"), ACESCG, atol=1e-6)


def test_unknown_names(write) -> None:
    with pytest.raises(ColourError, match="unknown colour space 'xyz': use one of rec709, p3"):
        read_sequence(write(), colourspace="xyz")


def test_colour_before_transparents_is_turned_like_colour(write_exr) -> None:
    """Their difference says where history is not used."""
    light = {name: np.full((4, 6), value, np.float32)
             for name, value in zip("RGB", (0.9, 0.2, 0.1), strict=True)}
    channels = light | {f"opaque_colour.{name}": plane for name, plane in light.items()}
    (frame,) = read_sequence(write_exr("a.exr", channels), colourspace="acescg",
                             without=[Role.OVERLAY])
    np.testing.assert_array_equal(frame[Role.OPAQUE_COLOUR], frame[Role.COLOUR])
