"""Files and windows: what `ImageFile` reads, and how it says no."""

import multiprocessing
import zlib
from pathlib import Path

import numpy as np
import OpenEXR
import OpenImageIO as oiio
import pytest

from postfx.errors import MissingFrameError, ReadError
from postfx.io.exr import container
from postfx.io.exr.container import ExrContainer, read_rows
from postfx.io.image_file import ImageFile
from postfx.io.pixel_formats import (
    compress_rows,
    decompress_rows,
    predict_bytes,
    unpredict_bytes,
    widen_rows,
)


def test_reads_only_the_named_channels(write_exr, ramp):
    channels = ramp("R", "G", "B", "Z")
    with ImageFile(write_exr("a.exr", channels)) as file:
        read = file.read(file.parts[0], {"Z": 0.0, "G": 0.0})
    assert list(read) == ["Z", "G"]
    np.testing.assert_array_equal(read["Z"], channels["Z"])
    np.testing.assert_array_equal(read["G"], channels["G"])


@pytest.mark.parametrize("rows", [None, (1, 3)])
def test_whole_numbers_are_read_as_they_are(tmp_path: Path, rows):
    """Not in parts of 2^32, beside halves, in any order, with what stands for none around the data
    window."""
    light = np.arange(24, dtype=np.float16).reshape(4, 6)
    counts = np.arange(24, dtype=np.uint32).reshape(4, 6) * 1000
    header = {"type": OpenEXR.scanlineimage, "dataWindow": ((1, 0), (6, 3)),
              "displayWindow": ((0, 0), (7, 3))}
    OpenEXR.File(header, {"G": light, "R": counts}).write(str(tmp_path / "a.exr"))
    with ImageFile(tmp_path / "a.exr") as file:
        found = file.read(file.parts[0], {"R": 7.0, "G": 0.0}, rows)
    assert list(found) == ["R", "G"] and found["R"].dtype == np.float32
    np.testing.assert_array_equal(found["R"][:, 1:7], counts[slice(*rows or (None,))])
    np.testing.assert_array_equal(found["G"][:, 1:7], light[slice(*rows or (None,))])
    assert (found["R"][:, [0, 7]] == 7).all()


def test_multi_part_keeps_part_names(write_parts, ramp):
    path = write_parts("a.exr", {"beauty": ramp("R", "G", "B"), "depth": ramp("Z")})
    with ImageFile(path) as file:
        assert [part.name for part in file.parts] == ["beauty", "depth"]
        assert file.read(file.parts[1], {"Z": 0.0})["Z"].shape == (6, 8)


def test_pixels_outside_the_data_window_get_the_fill_value(write_exr, ramp):
    channels = ramp("Z")
    path = write_exr("a.exr", channels, origin=(2, 1), display=(0, 0, 12, 9))
    with ImageFile(path) as file:
        depth = file.read(file.parts[0], {"Z": 7.0})["Z"]
    assert depth.shape == (9, 12)
    np.testing.assert_array_equal(depth[1:7, 2:10], channels["Z"])
    assert depth[0, 0] == depth[8, 11] == 7.0


def test_overscan_is_cut_off(write_exr, ramp):
    channels = ramp("R")
    path = write_exr("a.exr", channels, origin=(-2, -1), display=(0, 0, 4, 3))
    with ImageFile(path) as file:
        read = file.read(file.parts[0], {"R": 0.0})["R"]
    np.testing.assert_array_equal(read, channels["R"][1:4, 2:6])


def test_missing_file_is_named(tmp_path: Path):
    with pytest.raises(MissingFrameError, match=r"nothing\.exr: no such file"):
        ImageFile(tmp_path / "nothing.exr")


def test_broken_header_is_named(tmp_path: Path):
    (tmp_path / "broken.exr").write_bytes(b"not an image at all")
    with pytest.raises(ReadError, match=r"broken\.exr: broken file: it is not an OpenEXR file"):
        ImageFile(tmp_path / "broken.exr")


def test_shortened_file_is_named(write_exr, ramp):
    path = write_exr("short.exr", ramp("R", "G", "B", height=64, width=64))
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    with pytest.raises(ReadError, match=r"short\.exr: "), ImageFile(path) as file:
        file.read(file.parts[0], {"R": 0.0})


@pytest.mark.parametrize("compression", ["zip", "zips", "none"])
def test_plain_lines_are_read_without_openimageio_and_the_same(tmp_path: Path, monkeypatch,
                                                               compression):
    halves = np.arange(1 << 16, dtype=np.uint16)  # all: subnormal numbers, infinities, NaN
    # does not shrink
    noise = np.random.default_rng(0).integers(0, 1 << 16, (70, 1031)).astype(np.uint16)
    pixels = {"B": np.resize(halves, noise.shape).view(np.float16), "G": noise.view(np.float16),
              "Z": noise.astype(np.float32) / 3, "id": noise.astype(np.uint32)}
    header = {"compression": {"zip": OpenEXR.ZIP_COMPRESSION, "zips": OpenEXR.ZIPS_COMPRESSION,
                              "none": OpenEXR.NO_COMPRESSION}[compression],
              "type": OpenEXR.scanlineimage, "dataWindow": ((5, -3), (1035, 66)),
              "displayWindow": ((0, 0), (1023, 63))}
    path = tmp_path / "a.exr"
    OpenEXR.File(header, pixels).write(str(path))
    wanted = {"Z": 0.0, "B": 0.0, "G": 0.0}

    def found() -> list[np.ndarray]:
        with ImageFile(path) as file:
            whole, some = (file.read(file.parts[0], wanted, rows) for rows in (None, (21, 39)))
            return [*whole.values(), *some.values(),
                    *file.read(file.parts[0], {"id": 0.0}).values()]

    with monkeypatch.context() as patch:
        patch.setattr(ImageFile, "_read_rows", None)
        with ImageFile(path) as file:
            assert file.read(file.parts[0], wanted, (21, 39))["Z"].shape == (18, 1024)
    own = found()
    monkeypatch.setattr(ImageFile, "_read_plain", lambda *_: None)
    for one, other in zip(own, found(), strict=True):
        np.testing.assert_array_equal(one, other)


def test_zip_that_is_broken_is_named(tmp_path: Path):
    path = tmp_path / "a.exr"
    ramp = np.arange(64 * 64, dtype=np.float32).reshape(64, 64)
    OpenEXR.File({"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage},
                 {"R": ramp}).write(str(path))
    with path.open("r+b") as file:
        file.seek(-3, 2)  # within the checksum of the last chunk
        file.write(b"\0\0\0")
    with ImageFile(path) as file, pytest.raises(ReadError,
                                                match=r"a\.exr: broken file: .*; render or copy"):
        file.read(file.parts[0], {"R": 0.0})


def test_tiles_below_the_rows_that_are_read_are_not_touched(tmp_path: Path):
    path = tmp_path / "a.exr"
    values = np.float32(np.random.default_rng(0).integers(0, 9, (150, 64, 1)))
    spec = oiio.ImageSpec(64, 150, 1, "float")
    spec.channelnames, spec.tile_width, spec.tile_height, spec.y = ("R",), 32, 32, -7
    output = oiio.ImageOutput.create(str(path))
    assert output.open(str(path), spec) and output.write_image(values) and output.close()
    content = bytearray(path.read_bytes())
    content[-200:-100] = bytes(100)
    path.write_bytes(content)
    with ImageFile(path) as file:
        (stored,) = file.read_stored(file.parts[0], ["R"], 30, 128)
        np.testing.assert_array_equal(stored.view(np.float32), values[30:128, :, 0])
        with pytest.raises(ReadError, match=r"a\.exr: broken file"):
            file.read_stored(file.parts[0], ["R"], 30, 129)


def test_deep_data_is_refused(tmp_path: Path):
    path = str(tmp_path / "deep.exr")
    spec = oiio.ImageSpec(2, 2, 1, "float")
    spec.channelnames, spec.deep = ("Z",), True
    deep = oiio.DeepData()
    deep.init(spec)
    output = oiio.ImageOutput.create(path)
    assert output.open(path, spec)
    assert output.write_deep_image(deep)
    output.close()
    with pytest.raises(ReadError, match=r"deep\.exr: deep data is not supported: flatten"):
        ImageFile(Path(path))


def test_display_pictures_are_refused(tmp_path: Path):
    (tmp_path / "a.png").write_bytes(b"")
    with pytest.raises(ReadError, match=r"a\.png: not a scene-linear image"):
        ImageFile(tmp_path / "a.png")


def test_zip_leaves_rows_that_its_table_does_not_hold_to_openimageio(tmp_path: Path):
    path = tmp_path / "a.exr"
    OpenEXR.File({"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage},
                 {name: np.ones((40, 8), np.float32) for name in "RGB"}).write(str(path))
    with ExrContainer(path) as file:
        green, plane = file.storages[0].columns(["G"]), np.zeros((40, 8, 1), np.float32)
        assert read_rows(file, 0, [(green, plane)], 0, 40) and (plane == 1).all()
        assert not read_rows(file, 0, [(green, plane)], 0, 41)
        assert not read_rows(file, 0, [(green, plane)], -1, 8)
        file.counts[0] = 2  # as if the header told of fewer lines than OpenImageIO reads
        assert not read_rows(file, 0, [(green, plane)], 0, 40)
        assert read_rows(file, 0, [(green, plane[:32])], 0, 32)


@pytest.mark.skipif(not hasattr(container.os, "register_at_fork"),
                    reason="processes are not forked here")
def test_a_forked_process_unpacks_with_threads_of_its_own(write_exr, ramp):
    path = write_exr("a.exr", ramp("Z"))

    def read():
        with ImageFile(path) as file:
            file.read(file.parts[0], {"Z": 0.0})

    read()
    child = multiprocessing.get_context("fork").Process(target=read)
    child.start()
    child.join(30)
    alive = child.is_alive()
    child.kill()
    assert not alive and child.exitcode == 0


@pytest.mark.parametrize("count", [1, 7, 15, 16, 17, 31, 33, 63, 64, 65, 3 * 4096, 12345])
def test_bytes_that_were_predicted_come_back(count):
    """However many there are: those that fill vectors are summed another way; also the largest and
    the smallest."""
    rng = np.random.default_rng(count)
    for words in (rng.integers(0, 1 << 16, count), np.full(count, 65535),
                  np.arange(count) % 2 * 65535):
        words = words.astype(np.uint16)
        differences, found = np.empty(2 * count, np.uint8), np.empty(count, np.uint16)
        predict_bytes(0, 1, words.view(np.uint8), differences)
        unpredict_bytes(0, 1, differences, found)
        np.testing.assert_array_equal(found, words)


@pytest.mark.parametrize("count", [1, 2, 3, 4])
def test_channels_of_all_kinds_are_put_side_by_side(count):
    """Half floats and floats in one row, some of them twice, with every half float that there
    is."""
    halves = np.arange(1 << 16, dtype=np.uint16).reshape(2, -1).view(np.float16)
    floats = np.random.default_rng(count).random(halves.shape, np.float32)
    words = np.concatenate([halves.view(np.uint16), floats.view(np.uint16)], axis=1)
    places = [(1, 0), (2, halves.shape[1]), (1, 0), (2, halves.shape[1])][:count]
    columns = [halves, floats] * 2
    bits = np.empty((*halves.shape, count), np.float32)
    widen_rows(0, len(words), words, np.array(places), bits)
    wanted = np.stack(columns[:count], axis=-1).astype(np.float32)
    np.testing.assert_array_equal(bits, wanted)


@pytest.mark.parametrize("columns", [1, 7, 4096])
@pytest.mark.parametrize("kind", ["random", "alike"])
def test_chunks_are_streams_that_zlib_reads_or_the_rows_themselves(columns, kind):
    rng = np.random.default_rng(columns)
    lines = (rng.integers(0, 256, (15, 2 * columns)).astype(np.uint8) if kind == "random"
             else np.full(
        (15, 2 * columns), 7, np.uint8))
    stored = compress_rows(lines)
    if kind == "random":
        assert stored == lines.tobytes()
    else:
        differences = np.empty(lines.size, np.uint8)
        predict_bytes(0, 1, lines.reshape(-1), differences)
        assert len(stored) < lines.size and zlib.decompress(stored) == differences.tobytes()
    words = np.empty(lines.size // 2, np.uint16)
    assert decompress_rows(stored, words)
    np.testing.assert_array_equal(words, lines.reshape(-1).view(np.uint16))
