"""Whether picture files end as their formats want it: their encoders and decoders take shortened ones for whole."""

from __future__ import annotations

import os
import struct
from pathlib import Path
from typing import BinaryIO

from postfx.errors import ReadError
from postfx.io.exr.container import ExrContainer

_ENDS = {".png": b"\0\0\0\0IEND\xaeB`\x82", ".jpg": b"\xff\xd9", ".jpeg": b"\xff\xd9"}
_TIFF = {b"II*\0": "<HI", b"MM\0*": ">HI", b"II+\0": "<QQ", b"MM\0+": ">QQ"}
# First bytes -> how a directory's count of entries and offsets are stored.
_WHERE, _HOW_MANY = (273, 324), (279, 325)  # tags of strips and of tiles: offsets, and counts of bytes
_WHOLE = {3: "H", 4: "I", 16: "Q"}



def has_end(path: Path, suffix: str) -> bool:
    """Whether a file of the format of a suffix ends well: PNG's and JPEG's last bytes are there, TIFF's directory and
    all that it leads to, all chunks of all parts of an OpenEXR file."""
    suffix = suffix.lower()
    if suffix == ".exr":
        return _is_whole_exr(path)
    with path.open("rb") as file:
        if suffix in _ENDS:
            end = _ENDS[suffix]
            size = file.seek(0, os.SEEK_END)
            file.seek(max(0, size - len(end)))
            return file.read() == end
        return _is_whole_tiff(file, path.stat().st_size)


def _is_whole_tiff(file: BinaryIO, size: int) -> bool:
    """Whether the directory and the strips or tiles lie within the file (TIFF 6.0, section 2)."""
    layout = _TIFF.get(file.read(4))
    try:
        return layout is not None and _last_byte(file, layout) <= size
    except (struct.error, KeyError):
        return False


def _last_byte(file: BinaryIO, layout: str) -> int:
    order, kind, offset = layout
    wide = struct.calcsize(order + offset)
    file.seek(wide)  # behind the first four bytes, or eight
    file.seek(*_unpacked(file, order + offset))
    (count,) = _unpacked(file, order + kind)
    entries = [_unpacked(file, f"{order}HH{offset}{wide}s") for _ in range(min(count, 4096))]
    found = {tag: _numbers(file, order, wide, *rest) for tag, *rest in entries if tag in _WHERE + _HOW_MANY}
    starts, counts = ([found[tag] for tag in tags if tag in found] for tags in (_WHERE, _HOW_MANY))
    if not starts or not counts or not all(starts[0]):
        raise KeyError("strips")
    return max(map(sum, zip(starts[0], counts[0], strict=False)))


def _numbers(file: BinaryIO, order: str, wide: int, kind: int, count: int, value: bytes) -> tuple[int, ...]:
    """Values of an entry: its own bytes, or those that they lead to."""
    form = f"{order}{min(count, 1 << 20)}{_WHOLE[kind]}"
    if struct.calcsize(form) <= wide:
        return struct.unpack_from(form, value)
    file.seek(*struct.unpack(order + ("I" if wide == 4 else "Q"), value))
    return _unpacked(file, form)


def _unpacked(file: BinaryIO, form: str) -> tuple:
    return struct.unpack(form, file.read(struct.calcsize(form)))


def _is_whole_exr(path: Path) -> bool:
    try:
        with ExrContainer(path) as file:
            file.check_whole()
    except ReadError:
        return False
    return True
