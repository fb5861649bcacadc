"""TIFF and PFM of floats are read like OpenEXR where they are named."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import OpenImageIO as oiio
import pytest

from postfx.cli.main import main
from postfx.errors import ReadError
from postfx.frame import Frame, Role
from postfx.io.sequence import read_sequence
from postfx.io.writer import write_frame

LIGHT = np.random.default_rng(3).random((40, 56, 3), np.float32) * 8


def write_tiff(path: Path, pixels: np.ndarray, kind: str, compression: str = "zip") -> None:
    spec = oiio.ImageSpec(pixels.shape[1], pixels.shape[0], pixels.shape[2], kind)
    spec.attribute("compression", compression)
    output = oiio.ImageOutput.create(str(path))
    assert output.open(str(path), spec) and output.write_image(pixels) and output.close()


def write_pfm(path: Path, pixels: np.ndarray) -> None:
    """By Debevec's description: rows from the bottom, little-endian for a negative scale."""
    height, width, _ = pixels.shape
    path.write_bytes(f"PF\n{width} {height}\n"
                     "-1.0\n".encode() + pixels[::-1].astype("<f4").tobytes())


@pytest.mark.parametrize("compression", ["none", "lzw", "zip"])
@pytest.mark.parametrize("kind", ["half", "float"])
def test_tiff_of_floats_is_scene_linear_light(tmp_path, kind, compression):
    write_tiff(tmp_path / "a.tif", LIGHT, kind, compression)
    (frame,) = read_sequence(tmp_path / "a.tif")
    np.testing.assert_allclose(frame[Role.COLOUR], LIGHT, rtol=0 if kind == "float" else 1e-3)


def test_tiff_has_alpha(tmp_path):
    alpha = np.linspace(0, 1, 40 * 56, dtype=np.float32).reshape(40, 56, 1)
    write_tiff(tmp_path / "a.tiff", np.dstack([LIGHT * alpha, alpha]), "float")
    (frame,) = read_sequence(tmp_path / "a.tiff")
    np.testing.assert_array_equal(frame[Role.ALPHA], alpha)
    np.testing.assert_allclose(frame[Role.COLOUR], LIGHT * alpha, rtol=1e-6)


def test_pfm_stands_upright(tmp_path):
    write_pfm(tmp_path / "a.pfm", LIGHT)
    (frame,) = read_sequence(tmp_path / "a.pfm")
    np.testing.assert_array_equal(frame[Role.COLOUR], LIGHT)


def test_the_command_denoises_them(tmp_path, capsys):
    write_pfm(tmp_path / "a.pfm", LIGHT)
    write_tiff(tmp_path / "a.tif", LIGHT, "float")
    for name in ("a.pfm", "a.tif"):
        assert main(["run", str(tmp_path / name), "-o", str(tmp_path / f"{name}.exr"), "--model",
                     "s"]) == 0
    one, other = (next(iter(read_sequence(tmp_path / f"{name}.exr")))[Role.COLOUR]
                  for name in ("a.pfm", "a.tif"))
    np.testing.assert_array_equal(one, other)
    assert one.std() < 0.7 * LIGHT.std()
    told = capsys.readouterr().err
    assert "results are blurrier" in told and "may flicker" not in told  # a still cannot


@pytest.mark.parametrize("source", ["", "a.####.pfm", "a.*.pfm", "a.000?.pfm", "*"])
def test_a_sequence_of_them_is_found(tmp_path, source):
    """By a pattern, by wildcards, and in a folder that holds nothing else."""
    for number in (1, 2, 3):
        write_pfm(tmp_path / f"a.{number:04d}.pfm", LIGHT * number)
    frames = list(read_sequence(str(tmp_path / source)))
    assert [frame.number for frame in frames] == [1, 2, 3]
    np.testing.assert_array_equal(frames[2][Role.COLOUR], LIGHT * 3)


def test_renders_in_exr_come_before_pictures_beside_them(tmp_path):
    write_frame(tmp_path / "b.0001.exr", Frame({Role.COLOUR: LIGHT}))
    write_tiff(tmp_path / "a.0001.tif", LIGHT / 8, "uint8")
    for source in (tmp_path, tmp_path / "*"):
        assert str(read_sequence(str(source)).pattern).endswith("b.####.exr")


def test_a_picture_for_a_display_is_no_light(tmp_path):
    write_tiff(tmp_path / "a.tif", LIGHT / 8, "uint16")
    with pytest.raises(ReadError, match=r"a\.tif: holds whole numbers, code values of a picture"):
        list(read_sequence(tmp_path / "a.tif"))


def test_a_file_that_claims_too_much_is_refused(tmp_path):
    (tmp_path / "a.pfm").write_bytes(b"PF\n9000 9000\n-1.0\n" + bytes(3000))
    with pytest.raises(ReadError,
                       match=r"a\.pfm: broken file: its header claims 9000x9000 pixels in 3\d* "
                       r"bytes"):
        list(read_sequence(tmp_path / "a.pfm"))


def test_a_cut_file_is_told(tmp_path):
    write_pfm(tmp_path / "a.pfm", LIGHT)
    (tmp_path / "a.pfm").write_bytes((tmp_path / "a.pfm").read_bytes()[:-400])
    with pytest.raises(ReadError, match=r"a\.pfm: "):
        list(read_sequence(tmp_path / "a.pfm"))


def test_pictures_beside_a_render_do_not_make_its_folder_two_sequences(tmp_path):
    write_frame(tmp_path / "shot.0001.exr",
                next(iter(read_sequence("samples/room/noisy.0001.exr"))))
    write_tiff(tmp_path / "preview.0001.tif", LIGHT, "float")
    assert len(list(read_sequence(tmp_path))) == 1
