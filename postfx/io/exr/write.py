"""Writing OpenEXR files out of headers and chunks."""

from __future__ import annotations

import struct
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

from postfx.io.exr.header import (
    DEEP,
    DEEP_SCANLINES,
    DEEP_TILES,
    LONG_NAMES,
    MAGIC,
    MULTI_PART,
    TILED,
    TILES,
    VERSION,
    Header,
)


@dataclass
class NewPart:
    """A part to write: its header, how many chunks it has, and these with their places in the table, in any order."""

    header: Header
    count: int
    chunks: Iterable[tuple[int, bytes]]


def write_container(path: Path, parts: list[NewPart]) -> None:
    """Write a file of these parts, each of which needs a name when there are several. OSError when that fails."""
    several = len(parts) > 1
    for part in parts:
        if several:
            part.header.set_text("type", part.header.part_type)
            part.header.set("chunkCount", "int", struct.pack("<i", part.count))
    with path.open("wb") as file:
        file.write(struct.pack("<iI", MAGIC, VERSION | _flags([part.header for part in parts])))
        file.write(b"".join(part.header.packed() for part in parts) + b"\0" * several)
        table = file.tell()
        file.write(bytes(8 * sum(part.count for part in parts)))
        for number, part in enumerate(parts):
            offsets = _write_chunks(file, part, struct.pack("<i", number) if several else b"")
            file.seek(table)
            file.write(struct.pack(f"<{part.count}Q", *offsets))
            table = file.tell()
            file.seek(0, 2)


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
