"""PNG files are those of OpenImageIO, whoever compresses them."""

import struct
import zlib
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import OpenImageIO as oiio
import pytest

from postfx.colour.displays import DISPLAY_KINDS
from postfx.frame import Frame, Role
from postfx.io import encoder, writer
from postfx.io.writer import write_frame

SIZES = (1, 1), (1, 9), (9, 1), (45, 37)


def picture(encoding: str, size: tuple[int, int], smooth: bool = False) -> Frame:
    codes = np.random.default_rng(0).random((*size, 3), np.float32)
    return Frame({Role.COLOUR: np.full_like(codes, 0.7) if smooth else codes}, encoding=encoding)


def by_openimageio(path: Path, frame: Frame, monkeypatch: pytest.MonkeyPatch) -> Path:
    with monkeypatch.context() as patched:
        patched.setattr(writer, "OWN_CHANNELS", None)
        return write_frame(path, frame)


def chunks(path: Path) -> Iterator[tuple[bytes, bytes]]:
    """Those of a file, whose checksums are looked at."""
    content, at = path.read_bytes(), 8
    assert content[:8] == b"\x89PNG\r\n\x1a\n"
    while at < len(content):
        (length,) = struct.unpack_from(">I", content, at)
        end = at + 8 + length
        assert struct.unpack_from(">I", content, end) == (zlib.crc32(content[at + 4:end]),)
        yield content[at + 4:at + 8], content[at + 8:end]
        at = end + 4


@pytest.mark.parametrize("encoding", DISPLAY_KINDS)
@pytest.mark.parametrize("size", SIZES, ids=str)
def test_all_that_is_said_and_all_pixels(
    encoding: str, size: tuple[int, int], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    frame = picture(encoding, size)
    theirs = by_openimageio(tmp_path / "theirs.png", frame, monkeypatch)
    ours = write_frame(tmp_path / "ours.png", frame)
    said, wanted = ([chunk for chunk in chunks(path) if chunk[0] != b"IDAT"]
                    for path in (ours, theirs))
    assert said == wanted and len(said) > 2
    assert all(content for kind, content in chunks(ours) if kind == b"IDAT")
    pixels, expected = (oiio.ImageBuf(str(path)).get_pixels(oiio.UINT16) for path in (ours, theirs))
    np.testing.assert_array_equal(pixels, expected)
    assert pixels.shape == (*size, 3)


@pytest.mark.parametrize("encoding", ["srgb", "pq"])
@pytest.mark.parametrize("smooth", [False, True])
def test_pieces_are_one_stream(encoding: str, smooth: bool, tmp_path: Path,
                               monkeypatch: pytest.MonkeyPatch) -> None:
    frame = picture(encoding, (70, 33), smooth)
    whole = write_frame(tmp_path / "whole.png", frame)
    monkeypatch.setattr(encoder, "PIECE_BYTES", 1)
    pieces = write_frame(tmp_path / "pieces.png", frame)
    one, other = (b"".join(content for kind, content in chunks(path) if kind == b"IDAT")
                  for path in (whole, pieces))
    assert zlib.decompress(one) == zlib.decompress(other)
    assert len(zlib.decompress(one)) == 70 * (1 + 33 * 3 * (2 if encoding == "pq" else 1))


def test_pillow_reads_them(tmp_path: Path) -> None:
    image = pytest.importorskip("PIL.Image")
    with image.open(write_frame(tmp_path / "a.png", picture("srgb", (45, 37)))) as opened:
        opened.verify()
    with image.open(tmp_path / "a.png") as opened:
        found = np.asarray(opened)
    np.testing.assert_array_equal(found,
                                  oiio.ImageBuf(str(tmp_path / "a.png")).get_pixels(oiio.UINT8))


def test_smooth_pictures_become_small(tmp_path: Path) -> None:
    """240 kB and a profile of 2.5 kB."""
    assert write_frame(tmp_path / "a.png",
                       picture("pq", (200, 200), smooth=True)).stat().st_size < 4000
