"""OpenEXR files as containers: chunks copied without decoding them, and pixels in and out of ZIP.

ZIP-compressed scanlines are as OpenEXR's ImfZip.cpp defines them: bytes in even places before those
in odd ones, then differences of neighbours, then DEFLATE; a chunk that does not shrink is stored as
it is.
"""

from __future__ import annotations

import os
import struct
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from functools import cache, lru_cache, partial
from itertools import islice
from pathlib import Path
from typing import BinaryIO, NamedTuple

import numpy as np
import OpenImageIO as oiio

from postfx.errors import ReadError
from postfx.files import file_threads, memory_file, run_in_order
from postfx.io.exr import (
    DEEP_SCANLINES,
    DEEP_TILES,
    MULTI_PART,
    PART_TYPES,
    SAMPLE_BYTES,
    SAMPLE_TYPES,
    SCANLINE_IMAGE,
    TILED_IMAGE,
    Attribute,
    Header,
    pack_headers,
    read_headers,
)
from postfx.io.windows import Window

MAX_SIDE = 1 << 24
"""Largest width and height that is taken for an image's."""


LINES = {0: 1, 1: 1, 2: 1, 3: 16, 4: 32, 5: 16, 6: 32, 7: 32, 8: 32, 9: 256, 10: 256, 11: 32,
         12: 256, 13: 1}
"""Lines of a chunk by compression: none, RLE, ZIPS, ZIP, PIZ, PXR24, B44, B44A, DWAA, DWAB, HTJ2K
of 256 and of 32, LJ2K, ZSTD."""


class Chunk(NamedTuple):
    """One chunk in a file: where its coordinates and sizes begin, their bytes, and those of the
    data that follow."""

    at: int
    head: int
    size: int


STORAGE_ATTRIBUTES = ("type", "tiles", "compression", "channels", "dataWindow", "displayWindow")
"""Of a header: those that say how the pixels of its part are stored."""


@dataclass(frozen=True, eq=False)
class Storage:
    """How the pixels of a part are stored: found once for all headers that say the same.

    Attributes:
        count: chunks.
        coordinates: bytes of a chunk's coordinates.
        sizes: the numbers after them, as `struct` writes it.
        least_bytes: of a file whose part has so many pixels.
        window, display: data window and display window.
        width, height: of the data window.
        is_display_possible: whether the display window is of a size that files have.
        lines: rows of a chunk of scanlines.
        compression: OpenEXR's number of it.
        line_bytes: of a row.
        channels: of a part whose scanlines are as they are or compressed by ZIP, kind of each
            channel and place of its first word of two bytes in a row; else none.
    """

    count: int
    coordinates: int
    sizes: str
    least_bytes: int
    window: Window
    display: Window
    width: int
    height: int
    is_display_possible: bool
    lines: int
    compression: int
    line_bytes: int
    channels: Mapping[str, tuple[int, int]]

    def columns(self, names: Sequence[str]) -> np.ndarray | None:
        """Kinds and places of channels, (channels, 2), for `read_rows`; None where it cannot read
        them: it reads half floats and floats."""
        found = [self.channels.get(name) for name in names]
        if any(place is None or place[0] not in (HALF_KIND, FLOAT_KIND) for place in found):
            return None
        return np.array(found)


def storage_of(header: Header) -> Storage:
    """How a part with this header is stored. Raises ReadError where it claims something
    impossible."""
    return _find_storage(*map(header.attributes.get, STORAGE_ATTRIBUTES))


@lru_cache(256)
def _find_storage(*stored: Attribute | None) -> Storage:
    named = zip(STORAGE_ATTRIBUTES, stored, strict=True)
    header = Header({name: attribute for name, attribute in named if attribute is not None})
    count = _count_chunks(header)
    coordinates, sizes = _HEADS[header.part_type]
    data, display = header.data, header.display
    return Storage(
        count=count,
        coordinates=coordinates,
        sizes=sizes,
        least_bytes=_find_least_bytes(header),
        window=data,
        display=display,
        width=data.width,
        height=data.height,
        is_display_possible=_is_display_possible(display, data),
        lines=LINES[header.compression],
        compression=header.compression,
        line_bytes=data.width * sum(SAMPLE_BYTES[channel.kind] for channel in header.channels),
        channels=_find_plain_channels(header),
    )


_HEADS = {SCANLINE_IMAGE: (4, "<i"), TILED_IMAGE: (16, "<i"), DEEP_SCANLINES: (4, "<3q"),
          DEEP_TILES: (16, "<3q")}
"""Bytes of a chunk's coordinates, and the sizes that follow them, by the type of the part."""


def _count_chunks(header: Header) -> int:
    """Chunks of a part, by its size and tiles."""
    data = header.data
    if header.part_type not in PART_TYPES:
        raise ReadError(f"a part has the unknown type '{header.part_type}'")
    if header.compression not in LINES:
        raise ReadError(f"its compression {header.compression} is not known")
    if not (1 <= data.width <= MAX_SIDE and 1 <= data.height <= MAX_SIDE):
        raise ReadError(f"its header claims {data.width}x{data.height} pixels")
    if header.part_type in (SCANLINE_IMAGE, DEEP_SCANLINES):
        return -(-data.height // LINES[header.compression])
    return _tile_count(header)


def _find_least_bytes(header: Header) -> int:
    """Bytes that a file must have for a picture of this size to come out of it."""
    if header.part_type not in (SCANLINE_IMAGE, TILED_IMAGE):
        return 0
    pixel = sum(SAMPLE_BYTES[channel.kind] for channel in header.channels)
    most = _BOUNDED.get(header.compression, _UNBOUNDED)
    return -(-(header.data.width * header.data.height * pixel - _FREE_BYTES) // most)


def _is_display_possible(display: Window, data: Window) -> bool:
    """Whether a display window is of a size that files have, for all that it holds of data."""
    return (1 <= display.width <= MAX_SIDE and 1 <= display.height <= MAX_SIDE
            and display.width * display.height <= MAX_EMPTY + 16 * data.width * data.height)


def _find_plain_channels(header: Header) -> dict[str, tuple[int, int]]:
    """Kind of each channel and place of its first word in a row; none where the part is stored in
    another way than as scanlines that are as they are or compressed by ZIP."""
    is_plain = header.part_type == SCANLINE_IMAGE and header.compression in OWN_COMPRESSIONS
    channels = header.channels if is_plain else []
    if any((channel.x_sampling, channel.y_sampling) != (1, 1) for channel in channels):
        return {}
    found: dict[str, tuple[int, int]] = {}
    words = 0
    for channel in channels:
        found[channel.name] = channel.kind, words
        words += header.data.width * SAMPLE_BYTES[channel.kind] // 2
    return found


def _tile_count(header: Header) -> int:
    return sum(across * down for across, down in _tile_levels(header).values())


def _tile_levels(header: Header) -> dict[tuple[int, int], tuple[int, int]]:
    """Level in x and y -> tiles across and down, in the order of the table."""
    width, height, mode = header.tiles
    if not (1 <= width <= MAX_SIDE and 1 <= height <= MAX_SIDE) or mode & 15 > 2:
        raise ReadError("its tiles are of an unknown kind")
    data, up = header.data, mode >> 4
    across = [-(-side // width) for side in _levels(data.width, up)]
    down = [-(-side // height) for side in _levels(data.height, up)]
    if mode & 15 == 0:
        return {(0, 0): (across[0], down[0])}
    if mode & 15 == 2:
        return {(x, y): (across[x], down[y]) for y in range(len(down)) for x in range(len(across))}
    levels = max(len(across), len(down))
    across += [1] * (levels - len(across))
    down += [1] * (levels - len(down))
    return {(level, level): (across[level], down[level]) for level in range(levels)}


def _levels(side: int, up: int) -> list[int]:
    """Sides of an image's levels, halved down to 1, rounded up or down."""
    sides = [side]
    while sides[-1] > 1:
        level = len(sides)
        sides.append(max(1, -(-side >> level) if up else side >> level))
    return sides


def walk_chunks(
    file: BinaryIO, first: int, size: int, headers: list[Header], several: bool
) -> Iterator[tuple[int, int, int]]:
    """Part, place in its table and offset of every chunk that lies between `first` and the file's
    `size`, one after another; it ends at the first bytes that are not a chunk."""
    levels = [_tile_levels(header) if header.part_type not in (SCANLINE_IMAGE, DEEP_SCANLINES)
              else {} for header in headers]
    offset, part = first, 0
    while offset < size:
        file.seek(offset)
        if several:
            (part,) = struct.unpack("<i", file.read(4).ljust(4, b"\xff"))
            if not 0 <= part < len(headers):
                return
        storage = storage_of(headers[part])
        head = file.read(storage.coordinates + struct.calcsize(storage.sizes))
        if len(head) < storage.coordinates + struct.calcsize(storage.sizes):
            return
        place = _place(headers[part], levels[part],
                       struct.unpack(f"<{storage.coordinates // 4}i", head[:storage.coordinates]))
        found = struct.unpack(storage.sizes, head[storage.coordinates:])
        end = offset + 4 * several + len(head) + sum(found[:2])
        if place is None or min(found) < 0 or end > size:
            return
        yield part, place, offset
        offset = end


def _place(
    header: Header, levels: dict[tuple[int, int], tuple[int, int]], coordinates: tuple[int, ...]
) -> int | None:
    """Place in the table of the chunk with these coordinates; None if there is no such chunk."""
    if not levels:
        place, beyond = divmod(coordinates[0] - header.data.y0, LINES[header.compression])
        return place if not beyond and 0 <= place < storage_of(header).count else None
    x, y, *level = coordinates
    before = 0
    for own, (across, down) in levels.items():
        if own == tuple(level):
            return before + y * across + x if 0 <= x < across and 0 <= y < down else None
        before += across * down
    return None


_BOUNDED = {0: 1, 1: 128, 2: 1100, 3: 1100, 5: 1100, 6: 8, 7: 32}
"""Compressions -> how many times a chunk may grow: RLE 127 bytes out of 2, DEFLATE 1032:1, a flat
block of B44A 32 bytes out of 3."""
_UNBOUNDED = 1 << 20
"""The same of others: one run of a Huffman code may stand for much."""
_FREE_BYTES = 1 << 20
"""Of pixels that may come out of a file of any size."""
MAX_EMPTY = 1 << 28
"""Pixels that a display window may have with hardly any data in it: 16384x16384."""


class ExrContainer(ExitStack):
    """An open OpenEXR file, its headers, and its chunks without decoding them. Use as a context
    manager.

    `file` is the open file at its beginning, if the caller has it. Raises ReadError, naming the
    file, when it is not OpenEXR, or when its headers claim something impossible.

    Attributes:
        headers: of all parts.
        storages: how each part is stored.
        counts: chunks of each part.
        several: whether the file is of several parts by its version, so that chunks tell theirs.
        identity: what tells the file from others, and from what it may become.
        unpacked: index of a part -> words of all its rows, (height, words) uint16: `read_rows`
            fills those that are there, `read_stored` takes them.
    """

    def __init__(self, path: Path, file: BinaryIO | None = None) -> None:
        super().__init__()
        self.path = path
        self._file = self.enter_context(file or path.open("rb"))
        self._lock = threading.Lock()  # of the place in the file
        try:
            status = os.fstat(self._file.fileno())
            self.size = status.st_size
            self.identity = status.st_dev, status.st_ino, status.st_size, status.st_mtime_ns
            self.unpacked: dict[int, np.ndarray] = {}
            self.version, self.headers = read_headers(self._file)
            self.several = bool(self.version & MULTI_PART)
            self.storages = [storage_of(header) for header in self.headers]
            self.counts = [storage.count for storage in self.storages]
            self._offsets = self._read_table()
        except ReadError as error:
            self.close()
            raise ReadError(f"{path}: broken file: {error}; render or copy this frame "
                            "again") from None
        except BaseException:
            self.close()
            raise

    def chunks(self, part: int) -> list[Chunk]:
        """Chunks of a part in the order of its table. ReadError when one is missing or beyond the
        end of the file."""
        return [self.chunk(part, place) for place in range(self.counts[part])]

    def read(self, chunk: Chunk) -> bytes:
        """A chunk as it is stored, without the number of its part."""
        return self._read_bytes(chunk.at, chunk.head + chunk.size)

    def _read_bytes(self, at: int, count: int) -> bytes:
        self._file.seek(at)
        stored = self._file.read(count)
        if len(stored) < count:
            raise self._broken_error("it ends early")
        return stored

    def read_chunks(self, part: int, first: int, last: int) -> list[memoryview]:
        """Chunks of a part of scanlines in places of the table, the last not included; for any
        thread."""
        with self._lock:
            offsets = [int(offset) + 4 * self.several for offset in self._offsets[part][first:last]]
            if offsets != sorted(offsets):  # as where lines are written from the bottom
                return [memoryview(self.read(self.chunk(part, place)))
                        for place in range(first, last)]
            final = self.chunk(part, last - 1)
            end = final.at + final.head + final.size
            block = memoryview(self._read_bytes(offsets[0], end - offsets[0]))  # all at once
        found = []
        for offset in offsets:
            at = offset - offsets[0]
            (size,) = struct.unpack_from("<i", block, at + 4)
            if size < 0 or at + 8 + size > len(block):
                raise self._broken_error("it ends early")
            found.append(block[at : at + 8 + size])
        return found

    def copy_chunks(self, part: int) -> Iterator[tuple[int, bytes]]:
        """Place in the table and bytes of all chunks of a part, in the order of the file."""
        chunks = self.chunks(part)
        for place in sorted(range(len(chunks)), key=lambda place: chunks[place].at):
            yield place, self.read(chunks[place])

    def hold_rows(self, part: int) -> None:
        """Let `read_rows` keep what it unpacks of a part."""
        storage = self.storages[part]
        self.unpacked[part] = np.empty((storage.height, storage.line_bytes // 2), np.uint16)

    def check_whole(self) -> None:
        """ReadError unless all chunks of all parts are there."""
        for part in range(len(self.headers)):
            self.chunks(part)

    def chunk(self, part: int, place: int) -> Chunk:
        """The chunk at a place of a part's table; ReadError as for `chunks`."""
        at = int(self._offsets[part][place]) + 4 * self.several
        storage = self.storages[part]
        head = storage.coordinates + struct.calcsize(storage.sizes)
        if at + head > self.size:
            raise self._broken_error("it ends early")
        self._file.seek(at + storage.coordinates)
        found = struct.unpack(storage.sizes, self._file.read(head - storage.coordinates))
        size = sum(found[:2])  # the third is the size of unpacked samples
        if min(found) < 0 or at + head + size > self.size:
            raise self._broken_error("it ends early")
        return Chunk(at, head, size)

    def _read_table(self) -> list[np.ndarray]:
        """Offsets of the chunks of each part. If the table was never written, walk the chunks to
        find them.

        ReadError where headers claim more than the file can hold, where a chunk is missing, as in
        the file of a render that was killed, or beyond the end.
        """
        begin, count = self._file.tell(), sum(self.counts)
        if 8 * count > self.size - begin:
            raise ReadError(f"its header claims {count} chunks in {self.size} bytes")
        for storage in self.storages:
            window, display = storage.window, storage.display
            if not storage.is_display_possible:
                raise ReadError("its header claims a display window of "
                                f"{display.width}x{display.height}")
            if self.size < storage.least_bytes:
                raise ReadError(f"its header claims {window.width}x{window.height} pixels in "
                                f"{self.size} bytes")
        offsets = np.frombuffer(self._file.read(8 * count), "<u8").astype(np.int64)
        firsts = np.cumsum([0, *self.counts])
        if offsets.min() < begin:
            chunks = walk_chunks(self._file, begin + 8 * count, self.size, self.headers,
                                 self.several)
            for part, place, offset in islice(chunks, count):
                offsets[firsts[part] + place] = offset
        if offsets.min() < begin:
            raise ReadError("some of its pixels are missing")
        if offsets.max() >= self.size:
            raise ReadError("it ends early")
        return np.split(offsets, firsts[1:-1])

    def _broken_error(self, reason: str) -> ReadError:
        return ReadError(f"{self.path}: broken file: {reason}; render or copy this frame again")


@dataclass
class NewPart:
    """A part to write: its header, how many chunks it has, and these with their places in the
    table, in any order."""

    header: Header
    count: int
    chunks: Iterable[tuple[int, bytes]]


def write_container(path: Path, parts: list[NewPart]) -> int:
    """Write a file of these parts, each of which needs a name when there are several; returns the
    file's bytes.

    Raises OSError when that fails, and whatever the parts raise while they make their chunks.
    """
    several = len(parts) > 1
    for part in parts:
        if several:
            part.header.set_text("type", part.header.part_type)
            part.header.set("chunkCount", "int", struct.pack("<i", part.count))
    with path.open("wb", 1 << 20) as file:  # chunks may be single lines
        file.write(pack_headers([part.header for part in parts]))
        table = file.tell()
        file.write(bytes(8 * sum(part.count for part in parts)))
        offsets: list[int] = []
        size = table + 8 * sum(part.count for part in parts)
        for number, part in enumerate(parts):
            prefix = struct.pack("<i", number) if several else b""
            places = [0] * part.count
            for place, stored in part.chunks:
                places[place] = size
                file.write(prefix)
                file.write(stored)
                size += len(prefix) + len(stored)
            offsets += places
        file.seek(table)
        file.write(struct.pack(f"<{len(offsets)}Q", *offsets))
    return size


ChannelPlanes = Sequence[tuple[np.ndarray, np.ndarray]]
"""Columns of channels, as `Storage.columns` gives them, and the planes (rows, width, channels)
float32 that they are read into."""


def read_rows(file: ExrContainer, part: int, planes: ChannelPlanes, first: int, last: int) -> bool:
    """Read rows of a part whose scanlines are as they are or compressed by ZIP, in half of
    OpenImageIO's time: those of the data window from `first` to `last`, not included, both counted
    from its top. False where the file is broken. Several threads may read at once."""
    from postfx.io.pixel_formats import widen_rows  # headers must not wait

    storage = file.storages[part]
    begin, end = first // storage.lines, -(-last // storage.lines)
    if not 0 <= first < last <= storage.height or end > file.counts[part]:
        return False
    stored = file.read_chunks(part, begin, end)
    held = file.unpacked.get(part)
    step = max(1, ZIP_LINES // storage.lines)
    for place in range(0, len(stored), step):
        top = (begin + place) * storage.lines
        words = _unpack(storage, stored[place : place + step], top, held)
        if words is None:
            return False
        wanted = words[max(first - top, 0):]
        for columns, plane in planes:
            target = plane[max(top - first, 0):][:len(wanted)]
            widen_rows(0, len(target), wanted[:len(target)], columns, target)
    return True


def read_stored(file: ExrContainer, part: int, names: Sequence[str], first: int,
                last: int) -> list[np.ndarray] | None:
    """The same rows as they are stored, bit for bit: of each channel uint32, float16 or float32
    (rows, width); None where the file is broken or the part is stored in another way."""
    storage = file.storages[part]
    if not {*names} <= storage.channels.keys():
        return None
    if part in file.unpacked:
        rows = file.unpacked[part][first:last]
    else:
        begin, end = first // storage.lines, -(-last // storage.lines)
        words = _unpack(storage, file.read_chunks(part, begin, end), begin * storage.lines)
        if words is None:
            return None
        rows = words[first - begin * storage.lines:][:last - first]
    found, width = [], storage.width
    for name in names:
        kind, column = storage.channels[name]
        end = column + width * SAMPLE_BYTES[kind] // 2
        found.append(rows[:, column:end].view(SAMPLE_TYPES[kind]))
    return found


def read_rows_by_threads(file: ExrContainer, part: int, planes: ChannelPlanes, first: int,
                         last: int) -> bool:
    """The same by as many threads as OpenImageIO has, of which the caller is none."""
    count = oiio.get_int_attribute("threads")
    step = rows_of_task(count)
    tasks = [partial(read_rows, file, part, [(columns, plane[row - first : row - first + step])
                                             for columns, plane in planes],
                     row, min(last, row + step)) for row in range(first, last, step)]
    return all(run_in_order(file_threads(count), tasks, 2 * count))


def _unpack(storage: Storage, stored: list[memoryview], top: int,
            held: np.ndarray | None = None) -> np.ndarray | None:
    """Rows (rows, words) uint16 of chunks that begin with the row `top`, in their place among all
    that are held; None where one is broken."""
    from postfx.io.pixel_formats import decompress_rows  # headers must not wait

    lines = storage.lines
    count = min(len(stored) * lines, storage.height - top)
    words = (np.empty((count, storage.line_bytes // 2), np.uint16) if held is None
             else held[top : top + count])
    for place, chunk in enumerate(stored):
        row = place * lines
        is_whole = decompress_rows(chunk[8:], words[row : row + lines].reshape(-1))
        if not is_whole or struct.unpack_from("<i", chunk)[0] != storage.window.y0 + top + row:
            return None
    return words


COMPRESSIONS = {0: "none", 1: "rle", 2: "zips", 3: "zip", 4: "piz", 5: "pxr24", 6: "b44", 7: "b44a",
                8: "dwaa", 9: "dwab", 10: "htj2k256", 11: "htj2k32", 12: "lj2k", 13: "zstd"}
"""OpenEXR's numbers of compressions."""
_NEW = 10
"""The first that OpenImageIO may not know, by the OpenEXR that it was made with; it writes ZIP in
their place."""
NO_COMPRESSION = 0
ZIPS = 2
ZIP = 3
OWN_COMPRESSIONS = NO_COMPRESSION, ZIPS, ZIP
"""Those that are read and written here."""

# Kinds of channels.
HALF_KIND = 1
FLOAT_KIND = 2

ZIP_LINES = 16
"""Rows of a chunk of ZIP."""
_OIIO_KINDS = (oiio.UINT, oiio.HALF, oiio.FLOAT)
_PIECE_BYTES = 4 << 20  # bytes that are read and packed at once


def _join_threads() -> None:
    """End the threads of OpenImageIO and OpenEXR before the process is forked: the copy has none of
    them, would wait for them for ever, and starts its own if they are known to be gone. OpenEXR
    hears of their number when OpenImageIO opens a file."""
    _threads.append([oiio.get_int_attribute(name) for name in _THREAD_POOLS])
    oiio.attribute("threads", 1)
    oiio.attribute("exr_threads", _NO_THREADS)
    with suppress(OSError), memory_file(".exr") as path:
        output = oiio.ImageOutput.create("openexr")
        if output and output.open(str(path), oiio.ImageSpec(1, 1, 1, "half")):
            output.write_image(np.zeros((1, 1, 1), np.float32))
            output.close()


def _allow_threads() -> None:
    for name, count in zip(_THREAD_POOLS, _threads.pop(), strict=True):
        oiio.attribute(name, count)


_THREAD_POOLS = ("threads", "exr_threads")
_NO_THREADS = -1  # of OpenEXR; 0 would be one for each core
_threads: list[list[int]] = []
if hasattr(os, "register_at_fork"):
    os.register_at_fork(before=_join_threads, after_in_parent=_allow_threads,
                        after_in_child=_allow_threads)


def rows_of_task(threads: int) -> int:
    """Rows that a thread packs or unpacks at once: whole chunks, in its cache, and with many
    threads some for each."""
    return 4 * ZIP_LINES if threads <= 4 else ZIP_LINES


Rows = Callable[[int, int], Sequence[np.ndarray]]
"""First row and last row, not included, both counted from the top of the data window -> all
channels of these rows in the order of the header: arrays (rows, width) of little-endian uint32,
float16 or float32."""


def picture_part(header: Header, read: Rows, apart: bool = False) -> NewPart:
    """A part with this header whose chunks are packed while the file is written, as its header
    says.

    ZIP, by far the fastest compression, ZIPS and none are packed by as many threads as OpenImageIO
    reads and writes with, which does all others: there the channels must be of one type. `apart`:
    these threads may call `read`, too.
    """
    storage = storage_of(header)
    chunks = (_plain_chunks(storage, read, apart) if storage.compression in OWN_COMPRESSIONS
              else _library_chunks(header, read))
    return NewPart(header, storage.count, chunks)


@cache
def can_compress(name: str) -> bool:
    """Whether OpenImageIO writes a compression of `COMPRESSIONS`."""
    number = next(number for number, known in COMPRESSIONS.items() if known == name)
    if number < _NEW:
        return True
    spec = oiio.ImageSpec(1, 1, 1, "half")
    spec.attribute("compression", name)
    with memory_file(".exr") as path:
        output = oiio.ImageOutput.create("exr")
        if output is None or not (output.open(str(path), spec)
                                  and output.write_image(np.zeros((1, 1, 1), np.float32))):
            return False
        output.close()
        with open(path, "rb") as file:
            _, (made,) = read_headers(file)
        return made.compression == number


def _library_chunks(header: Header, read: Rows) -> Iterator[tuple[int, bytes]]:
    """Place in the table and bytes of each chunk, from a file that OpenImageIO makes in memory."""
    data, kind = header.data, _OIIO_KINDS[header.channels[0].kind]
    spec = oiio.ImageSpec(data.width, data.height, len(header.channels), kind)
    spec.x, spec.y = data.x0, data.y0
    spec.channelnames = tuple(channel.name for channel in header.channels)
    level = f":{header.dwa_level:g}" if header.dwa_level else ""
    spec.attribute("compression", COMPRESSIONS[header.compression] + level)
    with memory_file(".exr") as path:
        output = oiio.ImageOutput.create("exr")
        if output is None or not output.open(str(path), spec):
            raise OSError(oiio.geterror())
        written = True
        # whole chunks
        step = (max(1, _PIECE_BYTES // (data.width * len(header.channels) * SAMPLE_BYTES[2] * 256))
                * 256)
        for first in range(0, data.height, step):
            last = min(data.height, first + step)
            pixels = np.stack([*read(first, last)], axis=2)
            written = written and output.write_scanlines(data.y0 + first, data.y0 + last, 0, pixels)
        if not (output.close() and written):
            raise OSError(output.geterror() or "unknown reason")
        with ExrContainer(path) as made:
            yield from made.copy_chunks(0)


def _plain_chunks(storage: Storage, read: Rows, apart: bool) -> Iterator[tuple[int, bytes]]:
    """The same from the top, packed here."""
    height, line_bytes = storage.height, storage.line_bytes
    count = oiio.get_int_attribute("threads")
    rows = rows_of_task(count)
    step = rows if apart else max(1, _PIECE_BYTES // (line_bytes * rows)) * rows

    def tasks() -> Iterator[Callable[[], list[bytes]]]:
        for first in range(0, height, step):
            last = min(height, first + step)
            channels = [] if apart else read(first, last)
            for top in range(first, last, rows):
                some = slice(top - first, top - first + rows)
                get = (partial(read, first, last) if apart
                       else partial(list, [channel[some] for channel in channels]))
                yield partial(_pack, get, storage, storage.window.y0 + top)

    packed = (chunk for chunks in run_in_order(file_threads(count), tasks(), 2 * count)
              for chunk in chunks)
    yield from enumerate(packed)


def _pack(get: Callable[[], Sequence[np.ndarray]], storage: Storage, top: int) -> list[bytes]:
    """Chunks of the channels (rows, width) that `get` gives; the number of their first row is
    `top`."""
    from postfx.io.pixel_formats import compress_rows  # reading must not wait

    channels, at = get(), 0
    stored = np.empty((len(channels[0]), storage.line_bytes), np.uint8)
    for channel in channels:
        end = at + channel.shape[1] * channel.itemsize
        stored[:, at:end].view(channel.dtype)[:] = channel
        at = end
    found = []
    for first in range(0, len(stored), storage.lines):
        lines = stored[first : first + storage.lines]
        chunk = (lines.tobytes() if storage.compression == NO_COMPRESSION
                 else compress_rows(lines))
        found.append(struct.pack("<2i", top + first, len(chunk)) + chunk)
    return found
