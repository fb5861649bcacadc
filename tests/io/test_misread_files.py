"""Kinds of files that are easily misread: each as one of the collection in `shared/failing`, and as
one made here."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import OpenImageIO as oiio
import pytest

from postfx.cli.main import main
from postfx.colour import REC709
from postfx.errors import ColourError
from postfx.frame import Frame, Role
from postfx.io.sequence import read_sequence
from postfx.io.writer import is_complete, write_frame

COLUMNS, ROWS = np.meshgrid(np.linspace(0, 1, 64, dtype=np.float32),
                            np.linspace(0, 1, 40, dtype=np.float32))
PICTURE = np.stack([COLUMNS, ROWS, 1 - COLUMNS], axis=-1)
"""Stored colour of the collection's own files."""


@pytest.fixture
def collection(shared_dir: Path) -> Path:
    folder = shared_dir / "failing"
    if not folder.is_dir():
        pytest.skip(f"{folder} is not there")
    return folder


def read(path: Path, **options) -> Frame:
    (frame,) = read_sequence(path, **options)
    return frame


def test_chromaticities_of_cie_xyz(collection: Path) -> None:
    colour = pytest.importorskip("colour")
    own = colour.RGB_Colourspace("XYZ", np.eye(3)[:, :2], np.full(2, 1 / 3))
    target = colour.RGB_Colourspace("own", np.reshape(REC709[:6], (3, 2)), REC709[6:])
    light = PICTURE @ colour.matrix_RGB_to_RGB(own, target, "Bradford").T
    np.testing.assert_allclose(read(collection / "chromaticities_xyz.exr")[Role.COLOUR], light,
                               atol=1e-4)


def test_chromaticities_on_a_line(collection: Path, capsys) -> None:
    path = collection / "chromaticities_collinear.exr"
    with pytest.raises(ColourError,
                       match=r"collinear\.exr: chromaticities \(0\.1, 0\.1, .*\) span no colours: "
                       r"say"):
        read(path)
    assert main(["inspect", str(path)]) == 2
    shown = capsys.readouterr()
    assert shown.out == "" and shown.err.count("\n") == 1 and "span no colours" in shown.err
    assert main(["inspect", str(path), "--colourspace", "rec709"]) < 2


def test_inspect_says_that_chromaticities_cannot_be(write_parts, capsys) -> None:
    channels = {"rgb": {name: PICTURE[..., place] for place, name in enumerate("RGB")}}
    path = write_parts("equal.exr", channels, chromaticities=(0.3,) * 8)
    assert main(["inspect", str(path)]) == 2
    assert "equal.exr: chromaticities (0.3, 0.3, 0.3, 0.3" in (told := capsys.readouterr().err)
    assert "span no colours" in told


def test_encoded_colours(collection: Path) -> None:
    light = np.where(PICTURE <= 0.04045, PICTURE / 12.92, ((PICTURE + 0.055) / 1.055) ** 2.4)
    np.testing.assert_allclose(read(collection / "interop_srgb.exr")[Role.COLOUR], light, atol=1e-4)


def test_a_table_of_zeros(collection: Path, tmp_path: Path) -> None:
    path = collection / "zero_offset_table.exr"
    frame = read(path)
    np.testing.assert_array_equal(frame[Role.COLOUR], oiio.ImageBuf(str(path)).get_pixels("float"))
    out = write_frame(tmp_path / "out.exr", frame, bits=32, keep=True)
    np.testing.assert_array_equal(oiio.ImageBuf(str(out)).get_pixels("float"), frame[Role.COLOUR])


def test_a_tiled_file_that_says_it_is_of_lines(collection: Path, tmp_path: Path) -> None:
    path = collection / "tiled_flag_type_scanlineimage.exr"
    frame = read(path)
    shown = oiio.ImageBuf(str(path)).get_pixels("float")
    np.testing.assert_array_equal(np.dstack([frame[Role.COLOUR], frame[Role.ALPHA]]), shown)
    out = write_frame(tmp_path / "out.exr", frame, keep=True)
    assert is_complete(out, frame.spec.width, frame.spec.height)
    np.testing.assert_array_equal(oiio.ImageBuf(str(out)).get_pixels("float"), shown)


def test_a_radiance_picture_from_the_bottom(collection: Path) -> None:
    path = collection / "flip.hdr"
    stored = oiio.ImageInput.open(str(path)).read_image("float")
    np.testing.assert_array_equal(read(path)[Role.COLOUR], stored[::-1])


def assert_planes(frame: Frame, **wanted: tuple[float, ...]) -> None:
    """The collection's picture, opaque, and these planes of one value each."""
    np.testing.assert_allclose(frame[Role.COLOUR], PICTURE, atol=1e-6)
    assert set(map(str, frame.planes)) == {"colour", *wanted}
    for role, values in wanted.items():
        np.testing.assert_allclose(frame[Role(role)],
                                   np.broadcast_to(values, frame[Role(role)].shape), atol=1e-6)


def test_a_cryptomatte_beside_a_colour_without_alpha(collection: Path) -> None:
    assert_planes(read(collection / "parts_matte_as_alpha.exr"))


def test_a_position_before_the_depth(collection: Path) -> None:
    assert_planes(read(collection / "parts_position_as_depth.exr"), alpha=(1,), depth=(5,))


def test_parts_of_layer_and_view(collection: Path) -> None:
    path = collection / "nuke_parts_normal_is_depth.exr"
    assert_planes(read(path), alpha=(1,), depth=(4,), normal=(0, 0, 1))


def test_layers_with_words_for_letters(collection: Path) -> None:
    normal = (0.577,) * 3
    assert_planes(read(collection / "nuke_layers.exr"), alpha=(1,), depth=(4,), normal=normal,
                  diffuse_albedo=(0.5,) * 3)


def test_two_view_layers(collection: Path) -> None:
    path = collection / "blender_two_view_layers.exr"
    sequence = read_sequence(path)
    assert_planes(next(iter(sequence)), alpha=(1,), diffuse_albedo=(0.5,) * 3)
    assert sequence.warnings == [
        "view layer ViewLayer is read, as it has the most AOVs, not BG: --layer NAME chooses"]
    np.testing.assert_allclose(read(path, layer="BG")[Role.COLOUR], 0.1, atol=1e-6)
