"""OpenEXR files as containers: headers read and written attribute by attribute, chunks copied without decoding them.

Own pixels become ZIP-compressed scanlines, as OpenEXR's ImfZip.cpp defines them: bytes in even places before those in
odd ones, then differences of neighbours, then DEFLATE (ISA-L's); a chunk that does not shrink is stored as it is.

Layout of the file: https://openexr.com/en/latest/OpenEXRFileLayout.html
"""

from __future__ import annotations

import os
import struct
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from typing import BinaryIO, NamedTuple

import numpy as np
import OpenImageIO as oiio
from isal import isal_zlib

from postfx.errors import ReadError
from postfx.io.windows import Window
from postfx.kernels.pixel_formats import predict_bytes

MAGIC = 20000630
VERSION = 2
TILED, LONG_NAMES, DEEP, MULTI_PART = 0x200, 0x400, 0x800, 0x1000
SHORT_NAME = 31
MAX_NAME = 255
MAX_HEADERS = 64 << 20
"""Bytes that all headers of a file may have together."""
MAX_PARTS = 4096
SCANLINES, TILES, DEEP_SCANLINES, DEEP_TILES = "scanlineimage", "tiledimage", "deepscanline", "deeptile"
PART_TYPES = (SCANLINES, TILES, DEEP_SCANLINES, DEEP_TILES)
PIXEL_BYTES = (4, 2, 4)
"""Bytes of a sample by the pixel type of its channel: uint, half, float."""


class Attribute(NamedTuple):
    """Type and stored bytes of one header attribute."""

    kind: str
    value: bytes


class ChannelInfo(NamedTuple):
    """One channel of a part, as the header lists it; `kind` 0 is uint, 1 half, 2 float."""

    name: str
    kind: int
    linear: int
    x_sampling: int
    y_sampling: int


@dataclass
class Header:
    """Attributes of one part by name, in the order of the file. Reading one that is not there raises ReadError."""

    attributes: dict[str, Attribute] = field(default_factory=dict)

    @property
    def part_type(self) -> str:
        """One of `PART_TYPES`, as the attribute `type` says; tiles tell it in old files."""
        if "type" in self.attributes:
            return text(self.attributes["type"].value)
        return TILES if "tiles" in self.attributes else SCANLINES

    @property
    def name(self) -> str:
        """Name of the part, '' without one."""
        return text(self.attributes["name"].value) if "name" in self.attributes else ""

    @property
    def compression(self) -> int:
        """OpenEXR's number of the compression."""
        return self._unpacked("compression", "<B")[0]

    @property
    def data(self) -> Window:
        """Data window."""
        return Window(*self._unpacked("dataWindow", "<4i"))

    @property
    def display(self) -> Window:
        """Display window."""
        return Window(*self._unpacked("displayWindow", "<4i"))

    @property
    def tiles(self) -> tuple[int, int, int]:
        """Width and height of tiles, and the mode: levels in the low four bits, rounding in the high ones."""
        width, height, mode = self._unpacked("tiles", "<IIB")
        return width, height, mode

    @property
    def channels(self) -> list[ChannelInfo]:
        """Channels in the order of the file, which is that of their names."""
        stored, found, at = self._value("channels"), [], 0
        while stored[at : at + 1] not in (b"\0", b""):
            end = stored.index(b"\0", at) if b"\0" in stored[at:] else len(stored)
            if end + 17 > len(stored):
                raise ReadError("its list of channels ends early")
            kind, linear, x, y = struct.unpack_from("<iB3x2i", stored, end + 1)
            if kind not in (0, 1, 2) or x < 1 or y < 1:
                raise ReadError("a channel of it has an unknown type")
            found.append(ChannelInfo(text(stored[at:end]), kind, linear, x, y))
            at = end + 17
        return found

    def set(self, name: str, kind: str, value: bytes) -> None:
        """Replace or add an attribute."""
        self.attributes[name] = Attribute(kind, value)

    def set_text(self, name: str, value: str) -> None:
        """Replace or add an attribute of type string."""
        self.set(name, "string", raw(value))

    def pack(self) -> bytes:
        """The header as a file holds it."""
        entries = [raw(name) + b"\0" + raw(kind) + b"\0" + struct.pack("<i", len(value)) + value
                   for name, (kind, value) in self.attributes.items()]
        return b"".join(entries) + b"\0"

    def has_long_names(self) -> bool:
        """Whether a name in it needs the flag for names of more than 31 bytes."""
        names = [raw(name) for name in (*self.attributes, *(kind for kind, _ in self.attributes.values()))]
        return any(len(name) > SHORT_NAME for name in names + [raw(channel.name) for channel in self.channels])

    def _value(self, name: str) -> bytes:
        if name not in self.attributes:
            raise ReadError(f"its header has no {name}")
        return self.attributes[name].value

    def _unpacked(self, name: str, layout: str) -> tuple[int, ...]:
        value = self._value(name)
        if len(value) != struct.calcsize(layout):
            raise ReadError(f"its header has a broken {name}")
        return struct.unpack(layout, value)


def text(stored: bytes) -> str:
    """Stored bytes as text from which `raw` makes the same bytes."""
    return stored.decode("utf-8", "surrogateescape")


def raw(name: str) -> bytes:
    """Inverse of `text`."""
    return name.encode("utf-8", "surrogateescape")


def pack_channels(channels: list[ChannelInfo]) -> bytes:
    """The attribute `channels` (type chlist) of channels in any order."""
    entries = [raw(name) + b"\0" + struct.pack("<iB3x2i", kind, linear, x, y)
               for name, kind, linear, x, y in sorted(channels, key=lambda channel: raw(channel.name))]
    return b"".join(entries) + b"\0"


def read_headers(file: BinaryIO) -> tuple[int, list[Header]]:
    """Version flags and the headers of all parts; the file is left where the chunks' table begins.

    ReadError, whose message names no file, for what is no OpenEXR file, and for headers that end early or are larger
    than `MAX_HEADERS`.
    """
    magic, version = _take(file, "<iI")
    if magic != MAGIC or version & 0xFF != VERSION:
        raise ReadError("it is no OpenEXR file")
    headers, several = [], bool(version & MULTI_PART)
    while header := _header(file, several):
        headers.append(header)
        if not several:
            break
        if len(headers) > MAX_PARTS:
            raise ReadError(f"it has more than {MAX_PARTS} parts")
    if not headers:
        raise ReadError("it holds no image")
    return version, headers


def _header(file: BinaryIO, may_end: bool) -> Header | None:
    """The next header; None for the empty one that ends the headers of a multi-part file."""
    attributes: dict[str, Attribute] = {}
    while name := _name(file):
        kind = _name(file)
        (size,) = _take(file, "<i")
        if size < 0 or file.tell() + size > MAX_HEADERS:
            raise ReadError(f"its header claims {size} bytes for '{text(name)}'")
        attributes[text(name)] = Attribute(text(kind), _exactly(file, size))
    if not attributes and may_end:
        return None
    return Header(attributes)


def _name(file: BinaryIO) -> bytes:
    stored = bytearray()
    while (byte := _exactly(file, 1)) != b"\0":
        stored += byte
        if len(stored) > MAX_NAME:
            raise ReadError("a name in its header is too long")
    return bytes(stored)


def _take(file: BinaryIO, layout: str) -> tuple[int, ...]:
    return struct.unpack(layout, _exactly(file, struct.calcsize(layout)))


def _exactly(file: BinaryIO, count: int) -> bytes:
    stored = file.read(count)
    if len(stored) < count:
        raise ReadError("its header ends early")
    return stored


LINES = {0: 1, 1: 1, 2: 1, 3: 16, 4: 32, 5: 16, 6: 32, 7: 32, 8: 32, 9: 256, 10: 256, 11: 32, 12: 256, 13: 1}
"""Lines of a chunk by compression: none, RLE, ZIPS, ZIP, PIZ, PXR24, B44, B44A, DWAA, DWAB, HTJ2K of 256 and of 32,
LJ2K, ZSTD."""
_BOUNDED = {0: 1, 1: 128, 2: 1100, 3: 1100, 5: 1100, 6: 8, 7: 32}
_UNBOUNDED = 1 << 20
# Compressions -> how many times a chunk may grow: RLE 127 bytes out of 2, DEFLATE 1032:1, a flat block of B44A 32 bytes
# out of 3. One run of a Huffman code may stand for much more.
MAX_EMPTY = 1 << 28
"""Pixels that a display window may have with hardly any data in it: 16384x16384."""
MAX_SIDE = 1 << 24
"""Largest width and height that is taken for an image's."""


class Chunk(NamedTuple):
    """One chunk in a file: where its coordinates and sizes begin, their bytes, and those of the data that follow."""

    at: int
    head: int
    size: int


class ExrContainer:
    """An open OpenEXR file, its headers, and its chunks without decoding them. Use as a context manager.

    Raises ReadError, naming the file, when it is none, or when its headers claim what cannot be.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._file: BinaryIO = path.open("rb")
        try:
            self.size = os.fstat(self._file.fileno()).st_size
            self.version, self.headers = read_headers(self._file)
            self._table = self._file.tell()
            self.counts = [_count(header) for header in self.headers]
            self._check_sizes()
            self._check_table()
        except ReadError as error:
            self._file.close()
            raise ReadError(f"{path}: broken file: {error}; render or copy this frame again") from None
        except BaseException:
            self._file.close()
            raise

    def __enter__(self) -> ExrContainer:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Let go of the file."""
        self._file.close()

    @property
    def several(self) -> bool:
        """Whether the file is of several parts by its version, so that chunks tell theirs."""
        return bool(self.version & MULTI_PART)

    def chunks(self, part: int) -> list[Chunk]:
        """Chunks of a part in the order of its table. ReadError when one is missing or beyond the end of the file."""
        self._file.seek(self._table + 8 * sum(self.counts[:part]))
        offsets = struct.unpack(f"<{self.counts[part]}Q", self._file.read(8 * self.counts[part]))
        return [self._chunk(part, offset) for offset in offsets]

    def read(self, chunk: Chunk) -> bytes:
        """A chunk as it is stored, without the number of its part."""
        self._file.seek(chunk.at)
        stored = self._file.read(chunk.head + chunk.size)
        if len(stored) < chunk.head + chunk.size:
            raise self._broken("it ends early")
        return stored

    def copy_chunks(self, part: int) -> Iterator[tuple[int, bytes]]:
        """Place in the table and bytes of all chunks of a part, in the order of the file."""
        chunks = self.chunks(part)
        for place in sorted(range(len(chunks)), key=lambda place: chunks[place].at):
            yield place, self.read(chunks[place])

    def check_whole(self) -> None:
        """ReadError unless all chunks of all parts are there."""
        for part in range(len(self.headers)):
            self.chunks(part)

    def _chunk(self, part: int, offset: int) -> Chunk:
        at = offset + 4 * self.several
        coordinates, sizes = _head_layout(self.headers[part].part_type)
        head = coordinates + struct.calcsize(sizes)
        if at + head > self.size:
            raise self._broken("it ends early")
        self._file.seek(at + coordinates)
        found = struct.unpack(sizes, self._file.read(head - coordinates))
        size = sum(found[:2])  # the third is that of unpacked samples
        if min(found) < 0 or at + head + size > self.size:
            raise self._broken("it ends early")
        return Chunk(at, head, size)

    def _check_sizes(self) -> None:
        if 8 * sum(self.counts) > self.size - self._table:
            raise ReadError(f"its header claims {sum(self.counts)} chunks in {self.size} bytes")
        for header in self.headers:
            _check_claims(header, self.size)

    def _check_table(self) -> None:
        """ReadError where a chunk is missing, as in the file of a render that was ended, or beyond the end."""
        offsets = np.frombuffer(self._file.read(8 * sum(self.counts)), "<u8")
        if offsets.min() < self._table:
            raise ReadError("some of its pixels are missing")
        if offsets.max() >= self.size:
            raise ReadError("it ends early")

    def _broken(self, reason: str) -> ReadError:
        return ReadError(f"{self.path}: broken file: {reason}; render or copy this frame again")


def _head_layout(part_type: str) -> tuple[int, str]:
    """Bytes of a chunk's coordinates, and the sizes that follow them."""
    return {SCANLINES: (4, "<i"), TILES: (16, "<i"), DEEP_SCANLINES: (4, "<3q")}.get(part_type, (16, "<3q"))


def _check_claims(header: Header, file_size: int) -> None:
    """ReadError for a picture that cannot come out of so small a file."""
    data, display = header.data, header.display
    if not (1 <= display.width <= MAX_SIDE and 1 <= display.height <= MAX_SIDE) or \
            display.width * display.height > MAX_EMPTY + 16 * data.width * data.height:
        raise ReadError(f"its header claims a display window of {display.width}x{display.height}")
    if header.part_type not in (SCANLINES, TILES):
        return
    pixel = sum(PIXEL_BYTES[channel.kind] for channel in header.channels)
    most = _BOUNDED.get(header.compression, _UNBOUNDED)
    if data.width * data.height * pixel > most * file_size + (1 << 20):
        raise ReadError(f"its header claims {data.width}x{data.height} pixels in {file_size} bytes")


def _count(header: Header) -> int:
    """Chunks of a part, by its size and tiles."""
    data = header.data
    if header.part_type not in PART_TYPES:
        raise ReadError(f"a part of it is of the unknown type '{header.part_type}'")
    if header.compression not in LINES:
        raise ReadError(f"its compression {header.compression} is not known")
    if not (1 <= data.width <= MAX_SIDE and 1 <= data.height <= MAX_SIDE):
        raise ReadError(f"its header claims {data.width}x{data.height} pixels")
    if header.part_type in (SCANLINES, DEEP_SCANLINES):
        return -(-data.height // LINES[header.compression])
    return _tile_count(header)


def _tile_count(header: Header) -> int:
    width, height, mode = header.tiles
    if not (1 <= width <= MAX_SIDE and 1 <= height <= MAX_SIDE) or mode & 15 > 2:
        raise ReadError("its tiles are of an unknown kind")
    data, up = header.data, mode >> 4
    across = [-(-side // width) for side in _levels(data.width, up)]
    down = [-(-side // height) for side in _levels(data.height, up)]
    if mode & 15 == 0:
        return across[0] * down[0]
    if mode & 15 == 2:
        return sum(across) * sum(down)
    levels = max(len(across), len(down))
    across += [1] * (levels - len(across))
    down += [1] * (levels - len(down))
    return sum(x * y for x, y in zip(across, down, strict=True))


def _levels(side: int, up: int) -> list[int]:
    """Sides of an image's levels, halved down to 1, rounded up or down."""
    sides = [side]
    while sides[-1] > 1:
        level = len(sides)
        sides.append(max(1, -(-side >> level) if up else side >> level))
    return sides


@dataclass
class NewPart:
    """A part to write: its header, how many chunks it has, and these with their places in the table, in any order."""

    header: Header
    count: int
    chunks: Iterable[tuple[int, bytes]]


def write_container(path: Path, parts: list[NewPart]) -> int:
    """Write a file of these parts, each of which needs a name when there are several; returns the file's bytes.

    Raises OSError when that fails, and whatever the parts raise while they make their chunks.
    """
    several = len(parts) > 1
    for part in parts:
        if several:
            part.header.set_text("type", part.header.part_type)
            part.header.set("chunkCount", "int", struct.pack("<i", part.count))
    with path.open("wb") as file:
        file.write(struct.pack("<iI", MAGIC, VERSION | _flags([part.header for part in parts])))
        file.write(b"".join(part.header.pack() for part in parts) + b"\0" * several)
        table = file.tell()
        file.write(bytes(8 * sum(part.count for part in parts)))
        offsets: list[int] = []
        for number, part in enumerate(parts):
            offsets += _write_chunks(file, part, struct.pack("<i", number) if several else b"")
        size = file.tell()
        file.seek(table)
        file.write(struct.pack(f"<{len(offsets)}Q", *offsets))
    return size


def _write_chunks(file: BinaryIO, part: NewPart, prefix: bytes) -> list[int]:
    offsets = [0] * part.count
    at = file.tell()
    for place, stored in part.chunks:
        offsets[place] = at
        file.write(prefix)
        file.write(stored)
        at += len(prefix) + len(stored)
    return offsets


def _flags(headers: list[Header]) -> int:
    kinds, several = {header.part_type for header in headers}, len(headers) > 1
    flags = MULTI_PART * several | DEEP * bool(kinds & {DEEP_SCANLINES, DEEP_TILES})
    flags |= TILED * (not several and TILES in kinds)
    return flags | LONG_NAMES * any(header.has_long_names() for header in headers)


ZIP = 3
"""OpenEXR's number of the compression."""
ZIP_LINES = 16
"""Rows of a chunk."""
_LEVEL = 1  # of ISA-L: a fifth of the time of OpenEXR's level 4 for 6 % more bytes
_PIECE = 4 << 20  # bytes that are read and compressed at once
Rows = Callable[[int, int], Sequence[np.ndarray]]
"""First row and last row, not included, both counted from the top of the data window -> all channels of these rows in
the order of the header: arrays (rows, width) of little-endian uint32, float16 or float32."""


def zip_part(header: Header, read: Rows) -> NewPart:
    """A part with this header whose chunks are compressed while the file is written.

    Runs on as many threads as OpenImageIO reads and writes with.
    """
    return NewPart(header, -(-header.data.height // ZIP_LINES), _zip_chunks(header, read))


def _zip_chunks(header: Header, read: Rows) -> Iterator[tuple[int, bytes]]:
    """Place in the table and bytes of each chunk, from the top."""
    data, line_bytes = header.data, header.data.width * sum(PIXEL_BYTES[channel.kind] for channel in header.channels)
    step = max(1, _PIECE // (line_bytes * ZIP_LINES)) * ZIP_LINES
    with ThreadPoolExecutor(oiio.get_int_attribute("threads"), "postfx zip") as pool:
        for first in range(0, data.height, step):
            last = min(data.height, first + step)
            lines = _lines(read(first, last), line_bytes)
            blocks = [lines[top : top + ZIP_LINES] for top in range(0, last - first, ZIP_LINES)]
            for number, stored in enumerate(pool.map(_compress, blocks)):
                row = first + number * ZIP_LINES
                yield row // ZIP_LINES, struct.pack("<2i", data.y0 + row, len(stored)) + stored


def _lines(channels: Sequence[np.ndarray], line_bytes: int) -> np.ndarray:
    """Channels (rows, width) -> the bytes of each row, (rows, bytes)."""
    lines, at = np.empty((len(channels[0]), line_bytes), np.uint8), 0
    for channel in channels:
        end = at + channel.shape[1] * channel.itemsize
        lines[:, at:end].view(channel.dtype)[:] = channel
        at = end
    return lines


def _compress(lines: np.ndarray) -> bytes:
    plain = lines.reshape(-1)
    differences = np.empty_like(plain)
    predict_bytes(plain, differences)
    packed = isal_zlib.compress(differences, _LEVEL)
    return packed if len(packed) < len(plain) else plain.tobytes()
