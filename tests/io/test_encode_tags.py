"""What files say about their colours, read back by Pillow with LittleCMS, by the OpenEXR package
and chunk by chunk."""

from __future__ import annotations

import io
import struct
from pathlib import Path

import numpy as np
import pytest

from postfx.colour import REC2020
from postfx.colour.displays import DISPLAY_KINDS, parse_display
from postfx.errors import WriteError
from postfx.frame import Frame, Role
from postfx.io.icc import make_profile
from postfx.io.writer import write_frame

Image = pytest.importorskip("PIL.Image")
ImageCms = pytest.importorskip("PIL.ImageCms")
colour = pytest.importorskip("colour")

RELATIVE = ImageCms.Intent.RELATIVE_COLORIMETRIC
CICP = {"p3": (12, 13, 0, 1), "pq": (9, 16, 0, 1), "hlg": (9, 18, 0, 1)}
SPACES = {"srgb": "sRGB", "p3": "Display P3", "rec709": "ITU-R BT.709", "rec2020": "ITU-R BT.2020"}


def frame(encoding: str) -> Frame:
    codes = np.random.default_rng(3).random((32, 32, 3), np.float32)
    return Frame({Role.COLOUR: codes}, encoding=encoding)


def chunks(path: Path) -> dict[str, bytes]:
    """PNG chunks before the pixels, in order."""
    data, at, found = path.read_bytes(), 8, {}
    while data[at + 4:at + 8] != b"IDAT":
        (size,) = struct.unpack(">I", data[at:at + 4])
        found[data[at + 4:at + 8].decode()] = data[at + 8:at + 8 + size]
        at += 12 + size
    return found


@pytest.mark.parametrize("name", DISPLAY_KINDS)
def test_png_chunks(name: str, tmp_path: Path) -> None:
    found = chunks(write_frame(tmp_path / "a.png", frame(name)))
    assert found["IHDR"][8] == (16 if name in ("pq", "hlg") else 8)
    assert ("sRGB" in found) == (name == "srgb")
    assert ("iCCP" in found) == (name != "srgb")
    assert tuple(found.get("cICP", ())) == CICP.get(name, ())
    assert found.keys() <= {"IHDR", "cICP", "iCCP", "sRGB", "gAMA", "cHRM", "eXIf", "oFFs"}


@pytest.mark.parametrize("suffix", [".png", ".tif", ".jpg"])
@pytest.mark.parametrize("name", DISPLAY_KINDS)
def test_icc_profiles_are_in_the_files(name: str, suffix: str, tmp_path: Path) -> None:
    if name in ("pq", "hlg") and suffix == ".jpg":
        with pytest.raises(WriteError, match="JPEG has too few bits for Rec.2100"):
            write_frame(tmp_path / "a.jpg", frame(name))
        return
    with Image.open(write_frame(tmp_path / f"a{suffix}", frame(name))) as image:
        found = image.info.get("icc_profile")
    assert found == (None if (name, suffix) == ("srgb", ".png")
                     else make_profile(parse_display(name)))


@pytest.mark.parametrize("name", SPACES)
def test_icc_profiles_mean_the_display(name: str) -> None:
    """LittleCMS turns code values by the profile into Lab as colour-science does by the
    standard."""
    own = ImageCms.ImageCmsProfile(io.BytesIO(make_profile(parse_display(name))))
    codes = np.random.default_rng(5).integers(0, 256, (64, 1, 3)).astype(np.uint8)
    transform = ImageCms.buildTransform(own, ImageCms.createProfile("LAB"), "RGB", "LAB", RELATIVE)
    found = np.asarray(ImageCms.applyTransform(Image.fromarray(codes), transform)).astype(np.int16)
    found = np.stack([found[..., 0] * 100 / 255,
                      *(((found[..., i] + 128) % 256) - 128 for i in (1, 2))], -1)
    light = parse_display(name).decode(codes / 255)
    white = colour.CCS_ILLUMINANTS["CIE 1931 2 Degree Standard Observer"]["ICC D50"]
    lab = colour.XYZ_to_Lab(colour.RGB_to_XYZ(light, SPACES[name], white, "Bradford"), white)
    inside = (np.abs(lab[..., 1:]) < 126).all(-1)
    assert inside.sum() > 40
    np.testing.assert_allclose(found[inside], lab[inside], atol=1.2)  # LAB of 8 bits


def test_profiles_are_the_same_bytes_every_time() -> None:
    assert make_profile(parse_display("p3")) == make_profile.__wrapped__(parse_display("p3"))
    assert (len(make_profile(parse_display("p3")))
            == struct.unpack(">I", make_profile(parse_display("p3"))[:4])[0])


def test_hdr_profiles_end_at_diffuse_white() -> None:
    """Software without HDR shows what is up to 203 nits as it is, and lights beyond as white."""
    own = ImageCms.ImageCmsProfile(io.BytesIO(make_profile(parse_display("pq"))))
    transform = ImageCms.buildTransform(own, ImageCms.createProfile("sRGB"), "RGB", "RGB", RELATIVE)
    codes = parse_display("pq").encode(np.array([0.0, 0.18, 1.0, 4.0])[:, None, None].repeat(3, 2))
    shown = ImageCms.applyTransform(Image.fromarray(np.rint(codes * 255).astype(np.uint8)),
                                    transform)
    np.testing.assert_allclose(np.asarray(shown)[:, 0, 1], [0, 118, 255, 255], atol=3)


def test_exr_of_a_display_picture_is_light_with_its_primaries(tmp_path: Path) -> None:
    openexr = pytest.importorskip("OpenEXR")
    light = np.random.default_rng(3).uniform(0, 4, (8, 8, 3))
    display = parse_display("pq,peak=2000")
    codes = np.ascontiguousarray(display.encode(light), np.float32)
    made = Frame({Role.COLOUR: codes}, encoding=str(display),
                 metadata={"colorInteropID": "lin_ap1_scene"})
    file = openexr.File(str(write_frame(tmp_path / "a.exr", made, bits=32)))
    header, pixels = file.header(), file.channels()["RGB"].pixels
    np.testing.assert_allclose(header["chromaticities"], REC2020, atol=1e-6)
    assert header["whiteLuminance"] == 203
    assert "colorInteropID" not in header
    np.testing.assert_allclose(pixels, light, rtol=1e-4, atol=1e-4)
