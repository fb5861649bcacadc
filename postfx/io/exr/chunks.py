"""Chunks of OpenEXR files: how many a part has, where each belongs, and how to find them without the file's table."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from typing import BinaryIO, NamedTuple

from postfx.errors import ReadError
from postfx.io.exr.header import DEEP_SCANLINES, PART_TYPES, SCANLINES, TILES, Header

MAX_SIDE = 1 << 24
"""Largest width and height that is taken for an image's."""


LINES = {0: 1, 1: 1, 2: 1, 3: 16, 4: 32, 5: 16, 6: 32, 7: 32, 8: 32, 9: 256, 10: 256, 11: 32, 12: 256, 13: 1}
"""Lines of a chunk by compression: none, RLE, ZIPS, ZIP, PIZ, PXR24, B44, B44A, DWAA, DWAB, HTJ2K of 256 and of 32,
LJ2K, ZSTD."""

class Chunk(NamedTuple):
    """One chunk in a file: where its coordinates and sizes begin, their bytes, and those of the data that follow."""

    at: int
    head: int
    size: int


def head_layout(part_type: str) -> tuple[int, str]:
    """Bytes of a chunk's coordinates, and the sizes that follow them."""
    return {SCANLINES: (4, "<i"), TILES: (16, "<i"), DEEP_SCANLINES: (4, "<3q")}.get(part_type, (16, "<3q"))


def count_chunks(header: Header) -> int:
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
    """Part, place in its table and offset of every chunk that lies between `first` and the file's `size`, one after
    another; it ends where what follows is no chunk."""
    levels = [_tile_levels(header) if header.part_type not in (SCANLINES, DEEP_SCANLINES) else {} for header in headers]
    offset, part = first, 0
    while offset < size:
        file.seek(offset)
        if several:
            (part,) = struct.unpack("<i", file.read(4).ljust(4, b"\xff"))
            if not 0 <= part < len(headers):
                return
        coordinates, sizes = head_layout(headers[part].part_type)
        head = file.read(coordinates + struct.calcsize(sizes))
        if len(head) < coordinates + struct.calcsize(sizes):
            return
        place = _place(headers[part], levels[part], struct.unpack(f"<{coordinates // 4}i", head[:coordinates]))
        found = struct.unpack(sizes, head[coordinates:])
        end = offset + 4 * several + len(head) + sum(found[:2])
        if place is None or min(found) < 0 or end > size:
            return
        yield part, place, offset
        offset = end


def _place(
    header: Header, levels: dict[tuple[int, int], tuple[int, int]], coordinates: tuple[int, ...]
) -> int | None:
    """Place in the table of a chunk with these coordinates; None where there is none."""
    if not levels:
        place, beyond = divmod(coordinates[0] - header.data.y0, LINES[header.compression])
        return place if not beyond and 0 <= place < count_chunks(header) else None
    x, y, *level = coordinates
    before = 0
    for own, (across, down) in levels.items():
        if own == tuple(level):
            return before + y * across + x if 0 <= x < across and 0 <= y < down else None
        before += across * down
    return None
