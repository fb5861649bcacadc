"""Chunks of OpenEXR files: where they are, whether they are whole, and how to carry them to another file."""

from __future__ import annotations

import os
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO, NamedTuple

import numpy as np

from postfx.errors import ReadError
from postfx.io.exr.header import (
    DEEP_SCANLINES,
    MULTI_PART,
    PART_TYPES,
    PIXEL_BYTES,
    SCANLINES,
    TILES,
    Header,
    read_headers,
)

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

    def stored(self, part: int) -> Iterator[tuple[int, bytes]]:
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
