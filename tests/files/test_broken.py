"""Files that are broken, made to deceive, or no images: one clear line that names the file, in
little memory."""

from __future__ import annotations

import os
import resource
import struct
import time
from collections.abc import Callable, Iterator
from itertools import product
from pathlib import Path

import numpy as np
import OpenImageIO as oiio
import pytest

from postfx.errors import MissingFrameError, ReadError, SequenceError
from postfx.io.exr import SAMPLE_BYTES, Header
from postfx.io.exr.container import (
    LINES,
    MAX_SIDE,
    ExrContainer,
    NewPart,
    storage_of,
    write_container,
)
from postfx.io.sequence import read_sequence
from tests.files.exr_files import write_deep, write_mixed, write_studio

ROOM = 1 << 30


@pytest.fixture(autouse=True)
def little_room() -> Iterator[None]:
    """At most 1 GiB of address space more than now: what claims more fails to allocate."""
    limits = resource.getrlimit(resource.RLIMIT_AS)
    used = int(Path("/proc/self/statm").read_text().split()[0]) * os.sysconf("SC_PAGE_SIZE")
    resource.setrlimit(resource.RLIMIT_AS, (used + ROOM, limits[1]))
    yield
    resource.setrlimit(resource.RLIMIT_AS, limits)


def with_header(path: Path, change: Callable[[Header], None], keep_chunks: bool = True) -> None:
    """Write a file again with another header."""
    with ExrContainer(path) as file:
        header, chunks = file.headers[0], list(file.copy_chunks(0)) if keep_chunks else []
    change(header)
    write_container(path, [NewPart(header, len(chunks), chunks)])


def window(*bounds: int) -> bytes:
    return struct.pack("<4i", *bounds)


def claim(name: str, kind: str, value: bytes) -> Callable[[Path], None]:
    return lambda path: with_header(path, lambda header: header.set(name, kind, value))


def with_channel(kind: int, sampling: int) -> Callable[[Path], None]:
    """Changes what the header says of the first channel."""
    def change(path: Path) -> None:
        content = bytearray(path.read_bytes())
        at = content.index(b"\0", content.index(b"chlist\0") + 11) + 1
        content[at:at + 16] = struct.pack("<iB3x2i", kind, 0, sampling, 1)
        path.write_bytes(content)

    return change


def cut_at(part: float) -> Callable[[Path], None]:
    def cut(path: Path) -> None:
        whole = path.read_bytes()
        path.write_bytes(whole[: int(len(whole) * part)])

    return cut


def patched(at: int, value: bytes) -> Callable[[Path], None]:
    def patch(path: Path) -> None:
        whole = bytearray(path.read_bytes())
        whole[at : at + len(value)] = value
        path.write_bytes(whole)

    return patch


def patched_after(mark: bytes, value: bytes) -> Callable[[Path], None]:
    return lambda path: patched(path.read_bytes().index(mark) + len(mark), value)(path)


def lose_chunk(path: Path) -> None:
    """As of a render that was ended before its last lines: their place in the table is 0."""
    with ExrContainer(path) as file:
        chunks = file.chunks(0)
    patched(chunks[0].at - 8, bytes(8))(path)
    path.write_bytes(path.read_bytes()[: chunks[-1].at])


def as_picture(suffix: str) -> Callable[[Path], None]:
    def write(path: Path) -> None:
        assert oiio.ImageBuf(np.ones((4, 4, 3), np.float32)).write(str(path.with_suffix(suffix)))
        path.with_suffix(suffix).rename(path)

    return write


def fill(content: bytes) -> Callable[[Path], None]:
    return lambda path: path.write_bytes(content) and None


HUGE = window(0, 0, 2**24, 2**24)
FAULTS: dict[str, tuple[Callable[[Path], None], str]] = {
    "of zero bytes": (fill(b""), "is empty"),
    "three bytes": (fill(b"v/1"), "its header ends early"),
    "text": (fill(b"not an image at all"), "it is not an OpenEXR file"),
    "zeros": (fill(bytes(4096)), "it is not an OpenEXR file"),
    "a PNG by another name": (as_picture(".png"), "it is not an OpenEXR file"),
    "a JPEG by another name": (as_picture(".jpg"), "it is not an OpenEXR file"),
    "a TIFF by another name": (as_picture(".tif"), "it is not an OpenEXR file"),
    "cut in the header": (cut_at(0.01), "its header ends early"),
    "cut in the table": (patched(0, b""), ""),
    "cut in the middle": (cut_at(0.5), "it ends early"),
    "cut before its last byte": (lambda path: path.write_bytes(path.read_bytes()[:-1]) and None,
                                 ""),
    "a chunk missing": (lose_chunk, "some of its pixels are missing"),
    "chunks of noise": (patched(1500, bytes(range(256)) * 8), ""),
    "of another version": (patched(4, b"\x07"), "it is not an OpenEXR file"),
    "a data window of 2^24 a side": (claim("dataWindow", "box2i", HUGE),
                                     "its header claims 16777217x16777217 pixels"),
    "a data window of 2^20 lines": (claim("dataWindow", "box2i", window(0, 0, 9, 2**20)),
                                    "claims 65537 chunks in"),
    "lines of 2^23 pixels": (claim("dataWindow", "box2i", window(0, 0, 2**23, 40)),
                             "its header claims 8388609x41"),
    "a data window inside out": (claim("dataWindow", "box2i", window(9, 9, 0, 0)),
                                 "its header claims -8x-8 pixels"),
    "a data window over the limits of integers": (
        claim("dataWindow", "box2i", window(-(2**31), 0, 2**31 - 1, 40)),
        "its header claims 4294967296x41 pixels"),
    "a display window of 2^30 a side": (
        claim("displayWindow", "box2i", window(0, 0, 2**30, 2**30)),
        "display window of 1073741825x1073741825"),
    "a display window inside out": (claim("displayWindow", "box2i", window(9, 9, 0, 0)),
                                    "display window of -8x-8"),
    "no data window": (lambda path: with_header(
        path, lambda header: header.attributes.pop("dataWindow"), False
    ), "its header has no dataWindow"),
    "no channels": (lambda path: with_header(
        path, lambda header: header.set("channels", "chlist", b"\0"), False
    ), ""),
    "a list of channels that ends early": (patched_after(b"chlist\0", b"\xff\0\0\0R\0\1\0\0"), ""),
    "a channel of an unknown type": (with_channel(7, 1), "one of its channels has an unknown type"),
    "a channel of no pixels": (with_channel(1, 0), "one of its channels has an unknown type"),
    "a compression that does not exist": (claim("compression", "compression", b"\x63"),
                                          "compression 99 is not known"),
    "a part of an unknown type": (claim("type", "string", b"hologram"),
                                  "a part has the unknown type 'hologram'"),
    "an attribute of 2 GB": (patched(8, b"a\0b\0\xff\xff\xff\x7f"),
                             "its header claims 2147483647 bytes for 'a'"),
    "an attribute of less than nothing": (patched(8, b"a\0b\0\xff\xff\xff\xff"),
                                          "its header claims -1 bytes for 'a'"),
    "a name without an end": (fill(struct.pack("<iI", 20000630, 2) + b"a" * 5000),
                              "a name in its header is too long"),
}


@pytest.fixture
def source(tmp_path: Path) -> Path:
    """A file that is all right, until a test changes it."""
    return write_mixed(tmp_path / "shot.0001.exr")


@pytest.mark.parametrize("fault", FAULTS)
def test_broken_files_get_one_clear_line(source: Path, fault: str) -> None:
    breaks, message = FAULTS[fault]
    if fault == "cut in the table":
        with ExrContainer(source) as file:
            breaks = cut_at((file.chunks(0)[0].at - 4) / file.size)
    breaks(source)
    with pytest.raises(ReadError) as caught:
        list(read_sequence(source))
    line = str(caught.value)
    assert line.startswith(f"{source}: ") and message in line and "\n" not in line


def test_an_image_that_claims_little_and_is_all_right_is_read(source: Path) -> None:
    assert next(iter(read_sequence(source))).spec.height == 41


def test_a_million_channels_are_refused_at_once(source: Path) -> None:
    """The list was copied for each of them: a file of 17 MB took minutes."""
    listed = b"".join(b"c%06d\0" % number + struct.pack("<iB3x2i", 1, 0, 1, 1)
                      for number in range(1_000_000))
    whole = source.read_bytes()
    at = whole.index(b"chlist\0") + 7
    end = at + 4 + struct.unpack_from("<i", whole, at)[0]
    source.write_bytes(whole[:at] + struct.pack("<i", len(listed) + 1) + listed + b"\0"
                       + whole[end:])
    begin = time.process_time()
    with pytest.raises(ReadError, match="a part has more than 16384 channels"):
        list(read_sequence(source))
    assert time.process_time() - begin < 5


@pytest.mark.parametrize("across", [True, False])
def test_sides_are_taken_up_to_the_limit(source: Path, across: bool) -> None:
    with ExrContainer(source) as file:
        header = file.headers[0]
    for side in (1, MAX_SIDE):
        header.set("dataWindow", "box2i",
                   window(0, 0, *((side - 1, 0) if across else (0, side - 1))))
        chunks = 1 if across else -(-side // LINES[header.compression])
        assert storage_of(header).count == chunks
    for side in (0, MAX_SIDE + 1):
        header.set("dataWindow", "box2i",
                   window(0, 0, *((side - 1, 0) if across else (0, side - 1))))
        with pytest.raises(ReadError,
                           match=f"claims {f'{side}x1' if across else f'1x{side}'} pixels"):
            storage_of(header)


@pytest.mark.parametrize(("compression", "most"), [(0, 1), (3, 1100)])
def test_pixels_are_taken_up_to_what_a_file_can_hold(source: Path, compression: int,
                                                     most: int) -> None:
    """Its bytes times the most that the compression leaves out, and a megabyte."""
    with ExrContainer(source) as file:
        header = file.headers[0]
    pixel = sum(SAMPLE_BYTES[channel.kind] for channel in header.channels)
    size = next(size for size in range(4096, 8192) if (most * size + (1 << 20)) % pixel == 0)
    bounds = window(0, 0, (most * size + (1 << 20)) // pixel - 1, 0)

    def change(header: Header) -> None:
        header.set("compression", "compression", bytes([compression]))
        header.set("dataWindow", "box2i", bounds)
        header.set("displayWindow", "box2i", bounds)

    with_header(source, change)
    content = source.read_bytes().ljust(size, b"\0")
    source.write_bytes(content[:size])
    with ExrContainer(source) as file:
        assert file.counts == [1]
    source.write_bytes(content[:size - 1])
    with pytest.raises(ReadError, match=f"its header claims .* pixels in {size - 1} bytes"):
        ExrContainer(source)


HDR = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n"
HDR_FAULTS = {
    "no size": HDR,
    "pixels that are not there": HDR + b"-Y 4000000 +X 4000000\n",
    "the end missing": HDR + b"-Y 100 +X 100\n" + b"\2\2\0\x64" * 300,
}


@pytest.mark.parametrize("fault", HDR_FAULTS)
def test_broken_hdr_files_get_one_clear_line(tmp_path: Path, fault: str) -> None:
    (tmp_path / "a.hdr").write_bytes(HDR_FAULTS[fault])
    with pytest.raises(ReadError, match=r"a\.hdr: "):
        list(read_sequence(tmp_path / "a.hdr"))


def test_deep_files_are_refused_where_nothing_else_is_there(tmp_path: Path) -> None:
    with pytest.raises(ReadError, match=r"deep\.exr: deep data is not supported: flatten it first"):
        list(read_sequence(write_deep(tmp_path / "deep.exr")))
    assert next(iter(read_sequence(write_studio(tmp_path)))).spec.height == 41


@pytest.mark.parametrize("attribute", ["pixelAspectRatio", "worldToCamera", "postfx:exposure",
                                       "postfx:jitter", "postfx:spp", "postfx:near",
                                       "chromaticities", "framesPerSecond", "timeCode"])
def test_attributes_of_any_bytes_do_no_harm(source: Path, attribute: str) -> None:
    """The frame is read, or refused in one line."""
    whole = source.read_bytes()
    for kind, value in product(("float", "string", "m44f", "rational", "studioType"),
                               (b"", b"\xff" * 4, b"\0" * 4, b"nonsense",
                                b"\xff\xff\xff\x7f" * 16)):
        source.write_bytes(whole)
        claim(attribute, kind, value)(source)
        try:
            (frame,) = read_sequence(source)
            assert frame.spec.height == 41, (kind, value)
        except ReadError as error:
            assert str(source) in str(error), (kind, value)


def test_special_files_and_loops_of_links_are_no_frames(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.0001.exr")
    (tmp_path / "null.0001.exr").symlink_to("/dev/null")
    (tmp_path / "loop.0001.exr").symlink_to("loop.0001.exr")
    (tmp_path / "folder.0001.exr").mkdir()
    for name in ("pipe", "null", "loop", "folder"):
        with pytest.raises((MissingFrameError, SequenceError),
                           match=f"{name}.*no such file|holds no OpenEXR"):
            list(read_sequence(tmp_path / f"{name}.0001.exr"))
    with pytest.raises(SequenceError, match="holds no OpenEXR file"):
        read_sequence(tmp_path)
