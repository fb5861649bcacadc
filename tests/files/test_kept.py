"""Everything beside the picture goes into the output bit for bit: files with all that a pipeline may put into them."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import OpenEXR
import OpenImageIO as oiio
import pytest

from postfx.errors import ReadError, WriteError
from postfx.frame import Frame, Role
from postfx.io.exr.container import ExrContainer
from postfx.io.sequence import read_sequence
from postfx.io.writer import is_complete, write_frame
from tests.files.exr_files import (
    COMPRESSIONS,
    HEIGHT,
    WIDTH,
    channel_hashes,
    chunk_hashes,
    headers_of,
    picture,
    write_mixed,
    write_studio,
)

PICTURE = ("R", "G", "B", "A")


def processed(path: Path, scale: int = 1) -> Frame:
    """The file's picture, enlarged and darker."""
    frame = next(iter(read_sequence(path, planes=[Role.COLOUR, Role.ALPHA])))
    planes = {role: np.repeat(np.repeat(plane, scale, 0), scale, 1) * np.float32(0.5)
              for role, plane in frame.planes.items()}
    return dataclasses.replace(frame, planes=planes)


def keep(path: Path, scale: int = 1) -> tuple[Path, Frame]:
    frame = processed(path, scale)
    return write_frame(path.with_name("out.exr"), frame, keep=True), frame


def untouched(hashes: dict[tuple[str, str], str]) -> dict[str, str]:
    return {name: bits for (_, name), bits in hashes.items() if name not in PICTURE}


@pytest.mark.parametrize("tiled", [False, True], ids=["scanlines", "tiles"])
@pytest.mark.parametrize("compression", COMPRESSIONS)
def test_channels_of_the_pictures_part_stay_in_place(tmp_path: Path, compression: str, tiled: bool) -> None:
    source = write_mixed(tmp_path / "in.exr", compression, tiled)
    before = channel_hashes(source)
    out, frame = keep(source)
    after = channel_hashes(out)
    assert untouched(after) == untouched(before) and len(untouched(before)) == 7
    assert set(after) == set(before)
    again = next(iter(read_sequence(out, planes=[Role.COLOUR, Role.ALPHA])))
    np.testing.assert_array_equal(again[Role.COLOUR], frame[Role.COLOUR].astype(np.float16))
    np.testing.assert_array_equal(again[Role.ALPHA], frame[Role.ALPHA].astype(np.float16))


@pytest.mark.parametrize("compression", COMPRESSIONS)
def test_a_larger_picture_has_a_part_of_its_own(tmp_path: Path, compression: str) -> None:
    source = write_mixed(tmp_path / "in.exr", compression)
    before = channel_hashes(source)
    out, frame = keep(source, 2)
    after = channel_hashes(out)
    assert {name: bits for (part, name), bits in after.items() if part == "render"} == \
        {name: bits for (_, name), bits in before.items()}
    assert {name for part, name in after if part == "rgba"} == set(PICTURE)
    assert chunk_hashes(out)["render"] == chunk_hashes(source)[""]
    with ExrContainer(out) as file:
        sizes = {header.name: (header.data.width, header.data.height) for header in file.headers}
    assert sizes == {"rgba": (2 * WIDTH, 2 * HEIGHT), "render": (WIDTH, HEIGHT)}


@pytest.mark.parametrize("scale", [1, 2])
def test_every_attribute_keeps_its_bytes(tmp_path: Path, scale: int) -> None:
    source = write_studio(tmp_path)
    before, (out, _) = headers_of(source), keep(source, scale)
    after = headers_of(out)
    fresh = {"channels", "compression", "dataWindow", "displayWindow", "lineOrder", "chunkCount", "name", "type"}
    for part in before:
        own = after[part]
        moved = {"displayWindow"} if scale > 1 else {"compression", "chunkCount"} if part == "beauty" else set()
        assert {name: value for name, value in before[part].items() if own.get(name) != value}.keys() <= moved
    shown = after["beauty" if scale == 1 else "rgba"]
    assert {name for name, value in before["beauty"].items() if shown.get(name) != value} <= fresh
    if scale > 1:
        assert after["beauty"]["render:displayWindow"] == before["beauty"]["displayWindow"]


@pytest.mark.parametrize("scale", [1, 2])
def test_deep_and_mip_mapped_parts_are_copied_as_they_are_stored(tmp_path: Path, scale: int) -> None:
    source = write_studio(tmp_path)
    before, (out, _) = chunk_hashes(source), keep(source, scale)
    after = chunk_hashes(out)
    assert {part: after[part] for part in ("deep", "mip")} == {part: before[part] for part in ("deep", "mip")}
    file = oiio.ImageInput.open(str(out))
    deep, mip = (1, 2) if scale == 1 else (2, 3)
    samples = file.read_native_deep_image(deep, 0)
    assert [samples.samples(pixel) for pixel in range(8)] == [0, 1, 2, 3, 0, 1, 2, 3]
    assert samples.deep_value(7, 1, 2) == 7.25
    assert file.seek_subimage(mip, 6) and file.read_image(mip, 6, 0, 1, oiio.FLOAT).item() == 6
    file.close()


def test_a_colour_in_layers_is_kept_and_the_picture_comes_first(tmp_path: Path) -> None:
    light = picture()
    layers = ("ViewLayer.Combined", "ViewLayer.Noisy Image")
    parts = [OpenEXR.Part({"type": OpenEXR.scanlineimage}, {f"{layer}.{name}": light[name] for name in "RGBA"}, layer)
             for layer in layers]
    OpenEXR.File(parts).write(str(tmp_path / "in.exr"))
    before, (out, frame) = channel_hashes(tmp_path / "in.exr"), keep(tmp_path / "in.exr")
    after = channel_hashes(out)
    assert {key: bits for key, bits in after.items() if key[0] != "rgba"} == before
    (again,) = read_sequence(out)
    np.testing.assert_array_equal(again[Role.COLOUR], frame[Role.COLOUR].astype(np.float16))


def test_a_finished_file_is_read_back_without_the_smaller_planes(tmp_path: Path) -> None:
    source = write_mixed(tmp_path / "in.exr", postfx_x=1.0)
    out, _ = keep(source, 2)
    sequence = read_sequence(out)
    (frame,) = sequence
    assert set(frame.planes) == {Role.COLOUR, Role.ALPHA} and frame.spec.width == 2 * WIDTH
    assert sequence.warnings == ["planes depth are of the render before it was enlarged: not read"]
    again = write_frame(tmp_path / "again.exr", frame, keep=True)
    assert untouched(channel_hashes(again)) == untouched(channel_hashes(source))


def test_what_is_no_longer_true_of_the_picture_is_kept_apart(tmp_path: Path) -> None:
    source = write_mixed(tmp_path / "in.exr", **{"postfx:jitter": np.float32([0.25, -0.25]), "postfx:spp": 4})
    out, _ = keep(source)
    header = headers_of(out)[""]
    before = headers_of(source)[""]
    for name in ("postfx:jitter", "postfx:spp"):
        assert name not in header and header[f"render:{name}"] == before[name]
    assert next(iter(read_sequence(out))).jitter == (0, 0)
    larger, _ = keep(source, 2)
    assert headers_of(larger)["render"]["postfx:jitter"] == before["postfx:jitter"]
    assert next(iter(read_sequence(larger))).jitter == (0, 0)


def test_a_changed_attribute_is_the_writers(tmp_path: Path) -> None:
    frame = processed(write_mixed(tmp_path / "in.exr"))
    frame.metadata |= {"owner": "me", "note": "new"}
    header = headers_of(write_frame(tmp_path / "out.exr", frame, keep=True))[""]
    assert (header["owner"][1], header["note"][1], header["render:owner"][1]) == (b"me", b"new", b"studio")


def test_without_keep_there_is_only_the_picture(tmp_path: Path) -> None:
    out = write_frame(tmp_path / "out.exr", processed(write_mixed(tmp_path / "in.exr")))
    assert {name for _, name in channel_hashes(out)} == set(PICTURE)


def test_a_source_that_lost_pixels_leaves_no_output(tmp_path: Path) -> None:
    source = write_studio(tmp_path)
    frame = processed(source)
    source.write_bytes(source.read_bytes()[:-40])
    with pytest.raises(ReadError, match=r"studio\.exr: broken file: it ends early; render or copy"):
        write_frame(tmp_path / "new/out.exr", frame, keep=True)
    assert list((tmp_path / "new").iterdir()) == []


@pytest.mark.parametrize("scale", [1, 2])
def test_a_file_with_a_damaged_kept_part_is_not_complete(tmp_path: Path, scale: int) -> None:
    out, frame = keep(write_studio(tmp_path), scale)
    size = frame.spec.width, frame.spec.height
    assert is_complete(out, *size)
    out.write_bytes(out.read_bytes()[:-10])
    assert not is_complete(out, *size)


def test_the_same_input_gives_the_same_bytes(tmp_path: Path) -> None:
    source = write_mixed(tmp_path / "in.exr")
    first, _ = keep(source)
    before = first.read_bytes()
    assert b"capDate" not in before
    assert keep(source)[0].read_bytes() == before


def test_the_command_line_keeps_all_or_none(postfx, shot, tmp_path: Path) -> None:
    source = shot(1) / "shot.0001.exr"
    told = postfx("in/", "-o", "out/", "--explain")
    assert "keeps   7 other channels bit for bit (--keep none leaves them out)" in told.out
    assert postfx("in/", "-o", "out/").code == 0
    assert untouched(channel_hashes(tmp_path / "out/shot.0001.exr")) == untouched(channel_hashes(source))
    told = postfx("in/", "-o", "none/", "--keep", "none", "--explain")
    assert "keeps" not in told.out and "keeps" not in postfx("in/", "-o", "a.####.png", "--explain").out
    assert postfx("in/", "-o", "none/", "--keep", "none").code == 0
    assert not untouched(channel_hashes(tmp_path / "none/shot.0001.exr"))


def test_what_stays_in_the_pictures_part_is_kept_by_zip_only(tmp_path: Path) -> None:
    frame = processed(write_mixed(tmp_path / "in.exr"))
    with pytest.raises(WriteError, match="bit for bit, with ZIP only: leave --compression dwaa out, or give --keep"):
        write_frame(tmp_path / "out.exr", frame, keep=True, compression="dwaa")
    assert write_frame(tmp_path / "out.exr", frame, compression="dwaa").is_file()
