"""The OpenEXR format. Here: headers, read and written attribute by attribute.

Layout of the file: https://openexr.com/en/latest/OpenEXRFileLayout.html
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any, BinaryIO, NamedTuple

from postfx.errors import ReadError
from postfx.io.windows import Window

EXR_MAGIC = 20000630
EXR_VERSION = 2
_FILE_START = struct.Struct("<iI")
"""The magic number, and the version with its flags."""
TILED = 0x200
LONG_NAMES = 0x400
DEEP = 0x800
MULTI_PART = 0x1000
SHORT_NAME = 31
MAX_NAME = 255
_HEADER_BLOCK_BYTES = 1 << 13
MAX_HEADERS = 64 << 20
"""Bytes that all headers of a file may have together."""
MAX_PARTS = 4096
MAX_CHANNELS = 16384
SCANLINE_IMAGE = "scanlineimage"
TILED_IMAGE = "tiledimage"
DEEP_SCANLINES = "deepscanline"
DEEP_TILES = "deeptile"
PART_TYPES = (SCANLINE_IMAGE, TILED_IMAGE, DEEP_SCANLINES, DEEP_TILES)
SAMPLE_BYTES = (4, 2, 4)
"""Bytes of a sample by the pixel type of its channel: uint, half, float."""
SAMPLE_TYPES = ("<u4", "<f2", "<f4")
"""The same as NumPy names them."""


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
    """Attributes of one part by name, in the order of the file. Reading one that is not there
    raises ReadError."""

    attributes: dict[str, Attribute] = field(default_factory=dict)

    @property
    def part_type(self) -> str:
        """One of `PART_TYPES`, as the attribute `type` says; tiles tell it in old files."""
        if "type" in self.attributes:
            return text(self.attributes["type"].value)
        return TILED_IMAGE if "tiles" in self.attributes else SCANLINE_IMAGE

    @property
    def name(self) -> str:
        """Name of the part, '' without one."""
        return text(self.attributes["name"].value) if "name" in self.attributes else ""

    @property
    def compression(self) -> int:
        """OpenEXR's number of the compression."""
        return self._unpack("compression", "<B")[0]

    @property
    def dwa_level(self) -> float | None:
        """How much DWA compression loses, where the header says so."""
        value = self.attributes.get("dwaCompressionLevel")
        return (float(struct.unpack("<f", value.value)[0]) if value and len(value.value) == 4
                else None)

    @property
    def data(self) -> Window:
        """Data window."""
        return Window(*self._unpack("dataWindow", "<4i"))

    @property
    def display(self) -> Window:
        """Display window."""
        return Window(*self._unpack("displayWindow", "<4i"))

    @property
    def tiles(self) -> tuple[int, int, int]:
        """Width and height of tiles, and the mode: levels in the low four bits, rounding in the
        high ones."""
        width, height, mode = self._unpack("tiles", "<IIB")
        return width, height, mode

    @property
    def channels(self) -> list[ChannelInfo]:
        """Channels in the order of the file, which is that of their names."""
        stored = self._value("channels")
        found: list[ChannelInfo] = []
        at = 0
        while stored[at : at + 1] not in (b"\0", b""):
            end = stored.find(b"\0", at)
            if len(found) >= MAX_CHANNELS:
                raise ReadError(f"a part has more than {MAX_CHANNELS} channels")
            if end < 0 or end + 17 > len(stored):
                raise ReadError("its list of channels ends early")
            kind, linear, x, y = struct.unpack_from("<iB3x2i", stored, end + 1)
            if kind not in (0, 1, 2) or x < 1 or y < 1:
                raise ReadError("one of its channels has an unknown type")
            found.append(ChannelInfo(text(stored[at:end]), kind, linear, x, y))
            at = end + 17
        return found

    def set(self, name: str, kind: str, value: bytes) -> None:
        """Replace or add an attribute."""
        self.attributes[name] = Attribute(kind, value)

    def set_text(self, name: str, value: str) -> None:
        """Replace or add an attribute of type string."""
        self.set(name, "string", raw(value))

    def _value(self, name: str) -> bytes:
        if name not in self.attributes:
            raise ReadError(f"its header has no {name}")
        return self.attributes[name].value

    def _unpack(self, name: str, layout: str) -> tuple[int, ...]:
        value = self._value(name)
        if len(value) != struct.calcsize(layout):
            raise ReadError(f"its header has a broken {name}")
        return struct.unpack(layout, value)


_AS_TEXT = ("utf-8", "surrogateescape")
"""Encoding of names, and what becomes of other bytes."""


def text(stored: bytes) -> str:
    """Stored bytes as text from which `raw` makes the same bytes."""
    return str(stored, *_AS_TEXT)


def raw(name: str) -> bytes:
    """Inverse of `text`."""
    return name.encode(*_AS_TEXT)


_LETTERS = {"chromaticities": "f", "double": "d", "float": "f", "floatvector": "f", "int": "i",
            "m33f": "f", "m44f": "f", "timecode": "I", "v2f": "f", "v2i": "i", "v3f": "f"}
"""Types of attributes that are numbers, and how `struct` writes each number."""


def pack_value(kind: str, value: Any) -> bytes | None:
    """A text, a number or several as an attribute of a type stores them; None for other types."""
    if kind == "string":
        return raw(value) if isinstance(value, str) else None
    numbers = value if isinstance(value, tuple) else (value,)
    try:
        return struct.pack(f"<{len(numbers)}{_LETTERS[kind]}", *numbers)
    except (KeyError, struct.error, OverflowError):
        return None


def pack_channels(channels: list[ChannelInfo]) -> bytes:
    """The attribute `channels` (type chlist) of channels in any order."""
    entries = [raw(name) + b"\0" + struct.pack("<iB3x2i", kind, linear, x, y)
               for name, kind, linear, x, y in sorted(channels,
                                                      key=lambda channel: raw(channel.name))]
    return b"".join(entries) + b"\0"


def pack_headers(headers: Sequence[Header]) -> bytes:
    """What `read_headers` reads: version, flags, and the headers of all parts."""
    several = len(headers) > 1
    kinds = {header.part_type for header in headers}
    flags = MULTI_PART * several | DEEP * bool(kinds & {DEEP_SCANLINES, DEEP_TILES})
    flags |= TILED * (not several and TILED_IMAGE in kinds)
    found = []
    for header in headers:
        types = [attribute.kind for attribute in header.attributes.values()]
        if _holds_long((*header.attributes, *types), header.attributes["channels"]):
            flags |= LONG_NAMES
        found += [f"{name}\0{kind}\0".encode(*_AS_TEXT) + struct.pack("<i", len(value)) + value
                  for name, (kind, value) in header.attributes.items()]
        found.append(b"\0")
    end = b"\0" * several
    return _FILE_START.pack(EXR_MAGIC, EXR_VERSION | flags) + b"".join(found) + end


@lru_cache(64)
def _holds_long(names: tuple[str, ...], channels: Attribute) -> bool:
    """Whether one of these names, or of those of channels, needs the flag for names of more than 31
    bytes."""
    listed = [channel.name for channel in Header({"channels": channels}).channels]
    return any(len(raw(name)) > SHORT_NAME for name in (*names, *listed))


def read_headers(file: BinaryIO) -> tuple[int, list[Header]]:
    """Version flags and the headers of all parts; the file is left where the chunks' table begins.

    ReadError, whose message names no file, for a file that is not OpenEXR, and for headers that end
    early or are larger than `MAX_HEADERS`.
    """
    start = _Start(file)
    version = start.version
    several = bool(version & MULTI_PART)
    headers = [Header(start.attributes())]
    while several and (attributes := start.attributes()):  # an empty one ends the headers
        headers.append(Header(attributes))
        if len(headers) > MAX_PARTS:
            raise ReadError(f"it has more than {MAX_PARTS} parts")
    if several and not headers[0].attributes:
        raise ReadError("it holds no image")
    if not several and not version & DEEP:
        # the file's flags tell how a lone part is stored, whatever its type says
        stored, other = TILED_IMAGE, SCANLINE_IMAGE
        if not version & TILED:
            stored, other = other, stored
        if headers[0].part_type == other:
            headers[0].set_text("type", stored)
    file.seek(start.at)
    return version, headers


class _Start:
    """The start of a file, read in blocks: its version, then its headers. Raises ReadError where it
    is not OpenEXR, or ends.

    Attributes:
        version: with the file's flags.
        at: bytes that were taken.
    """

    def __init__(self, file: BinaryIO) -> None:
        self._file, self._held = file, file.read(_HEADER_BLOCK_BYTES)
        self.at = _FILE_START.size
        if len(self._held) < self.at:
            raise ReadError("its header ends early")
        magic, self.version = _FILE_START.unpack_from(self._held)
        if magic != EXR_MAGIC or self.version & 0xFF != EXR_VERSION:
            raise ReadError("it is not an OpenEXR file")

    def _take(self, count: int) -> bytes:
        """The next bytes."""
        begin, self.at = self.at, self.at + count
        if self.at > len(self._held):
            self._hold(self.at)
            if self.at > len(self._held):
                raise ReadError("its header ends early")
        return self._held[begin : self.at]

    def _name(self) -> bytes:
        """The bytes before the next zero, which is taken too."""
        most = self.at + MAX_NAME + 1
        if len(self._held) < most:
            self._hold(most)
        end = self._held.find(b"\0", self.at, most)
        if end < 0:
            raise ReadError("its header ends early" if len(self._held) < most
                            else "a name in its header is too long")
        begin, self.at = self.at, end + 1
        return self._held[begin:end]

    def attributes(self) -> dict[str, Attribute]:
        """The attributes of the next header by name; none where its end comes at once.

        An attribute that is held whole, as nearly all are, is taken at once.
        """
        found: dict[str, Attribute] = {}
        while True:
            held, begin = self._held, self.at
            name_end = held.find(b"\0", begin, begin + MAX_NAME + 1)
            kind_end = held.find(b"\0", name_end + 1, name_end + MAX_NAME + 2)
            value_begin = kind_end + 5
            value_end = -1
            if begin < name_end < kind_end and value_begin <= len(held):
                (size,) = struct.unpack_from("<i", held, kind_end + 1)
                value_end = value_begin + size
            if name_end == begin:
                name = b""
                self.at += 1
            elif value_begin <= value_end <= min(len(held), MAX_HEADERS):
                name, kind = held[begin:name_end], held[name_end + 1 : kind_end]
                value = held[value_begin:value_end]
                self.at = value_end
            else:
                name, kind, value = self._attribute_in_pieces()
            if not name:
                return found
            found[str(name, *_AS_TEXT)] = Attribute(str(kind, *_AS_TEXT), value)

    def _attribute_in_pieces(self) -> tuple[bytes, bytes, bytes]:
        """Name, type and value of the next attribute; no name where the zero comes that ends a
        header."""
        name = self._name()
        if not name:
            return name, b"", b""
        kind = self._name()
        (size,) = struct.unpack("<i", self._take(4))
        if size < 0 or self.at + size > MAX_HEADERS:
            raise ReadError(f"its header claims {size} bytes for {ascii(text(name))}")
        return name, kind, self._take(size)

    def _hold(self, end: int) -> None:
        # twice as much each time
        self._held += self._file.read(max(end - len(self._held), len(self._held)))
