"""Files that are small and claim, or become, very much: each is refused in a line, or read within
the memory that is allowed."""

from __future__ import annotations

import os
import struct
import zlib
from collections.abc import Callable

import numpy as np

from postfx.cli.config import DEFAULTS_VARIABLE, read_defaults
from postfx.cli.run_options import RUN
from postfx.colour.ocio import file_transform
from postfx.io.exr import Header
from postfx.io.exr.container import ExrContainer, NewPart, write_container
from postfx.io.pattern import parse_frames
from postfx.io.profile import load_profile
from postfx.io.sequence import Sequence
from postfx.runs.manifest import Manifest
from tests.files.exr_files import write_mixed
from tests.fuzz import targets

EIGHT_K = 15360, 8640
CHANNELS, PARTS, DEPTH = 1_000_000, 60_000, 100_000


def _exr(change: Callable[[Header], None]) -> None:
    """Read a file whose header was changed."""
    path = write_mixed(targets.FOLDER / "bomb.exr", size=targets.SIZE)
    with ExrContainer(path) as file:
        header, chunks = file.headers[0], list(file.copy_chunks(0))
    change(header)
    write_container(path, [NewPart(header, len(chunks), chunks)])
    next(iter(Sequence(path)))


def _window(name: str, *bounds: int) -> Callable[[], None]:
    return lambda: _exr(lambda header: header.set(name, "box2i", struct.pack("<4i", *bounds)))


def _attribute(name: bytes, kind: bytes, value: bytes) -> bytes:
    return name + b"\0" + kind + b"\0" + struct.pack("<i", len(value)) + value


def _channels(names: Callable[[int], bytes], count: int = CHANNELS) -> Callable[[], None]:
    """A list of channels in place of the file's own: put together from bytes, as our writer refuses
    it."""
    def read_it() -> None:
        path = write_mixed(targets.FOLDER / "bomb.exr", size=targets.SIZE)
        content, rest = path.read_bytes(), struct.pack("<iiii", 1, 0, 1, 1)
        at = content.index(b"channels\0chlist\0")
        size, = struct.unpack_from("<i", content, at + 16)
        channels = b"".join([names(number) + b"\0" + rest for number in range(count)]) + b"\0"
        path.write_bytes(content[:at] + _attribute(b"channels", b"chlist", channels)
                         + content[at + 20 + size:])
        next(iter(Sequence(path)))
    return read_it


def _parts() -> None:
    """Headers of many parts of one pixel, and nothing behind them."""
    box, number = struct.pack("<4i", 0, 0, 0, 0), struct.pack("<i", 1)
    same = b"".join([
        _attribute(b"channels", b"chlist", b"Y\0" + struct.pack("<iiii", 1, 0, 1, 1) + b"\0"),
        _attribute(b"chunkCount", b"int", number),
        _attribute(b"compression", b"compression", b"\0"),
        _attribute(b"dataWindow", b"box2i", box), _attribute(b"displayWindow", b"box2i", box),
        _attribute(b"lineOrder", b"lineOrder", b"\0"),
        _attribute(b"pixelAspectRatio", b"float", bytes(4)),
        _attribute(b"screenWindowCenter", b"v2f", bytes(8)),
        _attribute(b"screenWindowWidth", b"float", bytes(4)),
        _attribute(b"type", b"string", b"scanlineimage")]) + b"\0"
    headers = b"".join([_attribute(b"name", b"string", b"part %d" % part) + same
                        for part in range(PARTS)])
    _written("bomb.exr",
             struct.pack("<iI", 20000630, 2 | 0x1000) + headers + b"\0" + bytes(8 * PARTS))()


def _written(name: str, content: bytes) -> Callable[[], None]:
    def read_it() -> None:
        path = targets.FOLDER / name
        path.write_bytes(content)
        next(iter(Sequence(path)))
    return read_it


def _png() -> None:
    """Two thousand million pixels of black, which a few megabytes would hold."""
    def chunk(kind: bytes, content: bytes) -> bytes:
        return (struct.pack(">I", len(content)) + kind + content
                + struct.pack(">I", zlib.crc32(kind + content)))

    head = chunk(b"IHDR", struct.pack(">IIBBBBB", 2**31 - 1, 2**31 - 1, 16, 2, 0, 0, 0))
    _written("bomb.png",
             b"\x89PNG\r\n\x1a\n" + head + chunk(b"IDAT", zlib.compress(bytes(1 << 20))) +
             chunk(b"IEND", b""))()


def _large_black() -> None:
    """A true picture of 15360x8640 that a few hundred kilobytes hold."""
    width, height = EIGHT_K
    path = write_mixed(targets.FOLDER / "bomb.exr", size=targets.SIZE)
    with ExrContainer(path) as file:
        header = file.headers[0]
    header.set("channels", "chlist", b"Y\0" + struct.pack("<iiii", 1, 0, 1, 1) + b"\0")
    for name in ("dataWindow", "displayWindow"):
        header.set(name, "box2i", struct.pack("<4i", 0, 0, width - 1, height - 1))
    stored = zlib.compress(bytes(16 * 2 * width))
    chunks = [(0, struct.pack("<ii", 16 * row, len(stored)) + stored)
              for row in range(height // 16)]
    write_container(path, [NewPart(header, len(chunks), chunks)])
    next(iter(Sequence(path)))


def _table(name: str, content: bytes) -> Callable[[], None]:
    def read_it() -> None:
        path = targets.FOLDER / name
        path.write_bytes(content)
        file_transform(f"{path},input=ACEScct").apply(np.full((1, 1, 3), 0.18, np.float32))
    return read_it


def _settings(content: bytes) -> Callable[[], None]:
    def read_it() -> None:
        path = targets.FOLDER / "postfx.toml"
        path.write_bytes(content)
        os.environ[DEFAULTS_VARIABLE] = str(path)
        read_defaults(RUN)
    return read_it


def _profile(content: bytes) -> Callable[[], None]:
    def read_it() -> None:
        path = targets.FOLDER / "bomb.toml"
        path.write_bytes(content)
        load_profile.cache_clear()
        load_profile(str(path))
    return read_it


BOMBS: dict[str, Callable[[], object]] = {
    "a data window of 2^31 a side": _window("dataWindow", 0, 0, 2**31 - 1, 2**31 - 1),
    "a data window of 2^32 a side": _window("dataWindow", -(2**31), -(2**31), 2**31 - 1, 2**31 - 1),
    "a data window of 2^31 columns": _window("dataWindow", 0, 0, 2**31 - 1, 6),
    "a data window of 2^31 rows": _window("dataWindow", 0, 0, 8, 2**31 - 1),
    "a display window of 2^31 a side": _window("displayWindow", 0, 0, 2**31 - 1, 2**31 - 1),
    "a data window far away": _window("dataWindow", 2**30, 2**30, 2**30 + 8, 2**30 + 6),
    "tiles of 2^31": lambda: _exr(lambda header: header.set("tiles", "tiledesc", struct.pack(
        "<IIB", 2**31 - 1, 2**31 - 1, 0))),
    "a worldToCamera of 2^20 "
    "numbers": lambda: _exr(lambda header: header.set("worldToCamera", "m44f", bytes(1 << 22))),
    "a PNG of 2^31 a side": _png,
    "a Radiance file of 2^31 a side": _written(
        "bomb.hdr",
        b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 2147483647 +X 2147483647\n" + bytes(64)),
    "a Radiance file of one long run": _written(
        "bomb.hdr", b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 65536 +X 32767\n" + b"\2\2\x7f\xff"
        + b"\xff\0" * 999),
    "a PFM of 2^31 a side": _written("bomb.pfm", b"PF\n2147483647 2147483647\n-1.0\n" + bytes(64)),
    "a TIFF of 2^31 a side": _written("bomb.tif", b"II*\0\x08\0\0\0\x02\0" + struct.pack(
        "<HHIIHHIII", 256, 4, 1, 2**31 - 1, 257, 4, 1, 2**31 - 1, 0)),
    "a cube of 2^30 a side": _table("bomb.cube", b"LUT_3D_SIZE 1073741824\n0 0 0\n"),
    "a cube of -1 a side": _table("bomb.cube", b"LUT_3D_SIZE -1\n0 0 0\n"),
    "a table of 2^31 entries": _table("bomb.cube", b"LUT_1D_SIZE 2147483647\n0 0 0\n"),
    "an .spi3d of 2^20 a side": _table("bomb.spi3d",
                                       b"SPILUT 1.0\n3 3\n1048576 1048576 1048576\n0 0 0 0 0 0\n"),
    "a .csp of 2^20 a side": _table("bomb.csp",
                                    b"CSPLUTV100\n3D\n\n2\n0 1\n0 1\n2\n0 1\n0 1\n2\n0 1\n0 1\n\n"
                                    b"1048576 1048576 1048576\n0 0 0\n"),
    "settings nested 100,000 deep": _settings(b"a = " + b"[" * DEPTH + b"]" * DEPTH),
    "settings of 100,000 tables in one another": _settings(b"[" + b"a." * DEPTH + b"a]\n"),
    "a profile nested 100,000 deep": _profile(b"a = " + b"[" * DEPTH + b"]" * DEPTH),
    "a manifest nested 100,000 "
    "deep": lambda: Manifest.from_json("[" * DEPTH + "]" * DEPTH) and None,
    "10^18 frames": lambda: parse_frames("1-1000000000000000000") and None,
    "a million channels": _channels(lambda number: b"c%d" % number),
    "a million channels of one name": _channels(lambda _: b"R"),
    "16,000 layers of channels": _channels(lambda number: b"layer%d.R" % number, 16_000),
    "60,000 parts": _parts,
    "15360x8640 of black in some kilobytes": _large_black,
}


def names() -> list[bytes]:
    return [name.encode() for name in BOMBS]


def read(content: bytes) -> None:
    """Make the file of this name, and read it."""
    BOMBS[content.decode()]()
