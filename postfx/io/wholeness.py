"""Whether a written file is whole: encoders of JPEG, PNG and TIFF do not tell when a disk is
full."""

from __future__ import annotations

import os
import struct
from pathlib import Path
from typing import Any, BinaryIO

from postfx.errors import ReadError
from postfx.io.exr.container import ExrContainer
from postfx.io.jpeg import JPEG_END, JPEG_SUFFIXES
from postfx.io.png import PNG_END

ENDS = {".png": PNG_END, **dict.fromkeys(JPEG_SUFFIXES, JPEG_END)}
"""Last bytes of a file by its suffix."""
TIFF_LAYOUTS = {
    b"II*\0": ("<", "H", "I"),
    b"MM\0*": (">", "H", "I"),
    b"II+\0": ("<", "Q", "Q"),
    b"MM\0+": (">", "Q", "Q"),
}
"""First bytes of a TIFF -> byte order, and how a directory's count of entries and offsets are
stored."""
OFFSET_TAGS = (273, 324)
"""Where strips and tiles begin."""
COUNT_TAGS = (279, 325)
"""How many bytes they have."""
WHOLE_NUMBERS = {3: "H", 4: "I", 16: "Q"}
"""Types of an entry -> how a number of it is stored."""
MOST_ENTRIES = 4096
"""Of a directory that are looked at."""
MOST_NUMBERS = 1 << 20
"""Of an entry that are looked at."""


def has_end(path: Path, suffix: str) -> bool:
    """Whether a file of the format of a suffix ends well: PNG's and JPEG's last bytes are there,
    TIFF's directory and all that it leads to, all chunks of all parts of an OpenEXR file."""
    suffix = suffix.lower()
    if suffix == ".exr":
        return _is_whole_exr(path)
    with path.open("rb") as file:
        if suffix in ENDS:
            end = ENDS[suffix]
            size = file.seek(0, os.SEEK_END)
            file.seek(max(0, size - len(end)))
            return file.read() == end
        return _is_whole_tiff(file, path.stat().st_size)


def _is_whole_tiff(file: BinaryIO, size: int) -> bool:
    """Whether the directory and the strips or tiles lie within the file (TIFF 6.0, section 2)."""
    layout = TIFF_LAYOUTS.get(file.read(4))
    try:
        return layout is not None and _last_byte(file, layout) <= size
    except (struct.error, KeyError):
        return False


def _last_byte(file: BinaryIO, layout: tuple[str, str, str]) -> int:
    order, kind, offset = layout
    wide = struct.calcsize(order + offset)
    file.seek(wide)  # behind the first four bytes, or eight
    file.seek(*_unpack(file, order + offset))
    (count,) = _unpack(file, order + kind)
    entries = [_unpack(file, f"{order}HH{offset}{wide}s") for _ in range(min(count, MOST_ENTRIES))]
    found = {
        tag: _numbers(file, order, wide, *rest)
        for tag, *rest in entries
        if tag in OFFSET_TAGS + COUNT_TAGS
    }
    starts, counts = (
        [found[tag] for tag in tags if tag in found] for tags in (OFFSET_TAGS, COUNT_TAGS)
    )
    if not starts or not counts or not all(starts[0]):
        raise KeyError("strips")
    return max(map(sum, zip(starts[0], counts[0], strict=False)))


def _numbers(
    file: BinaryIO, order: str, wide: int, kind: int, count: int, value: bytes
) -> tuple[int, ...]:
    """Values of an entry: its own bytes, or those that they lead to."""
    form = f"{order}{min(count, MOST_NUMBERS)}{WHOLE_NUMBERS[kind]}"
    if struct.calcsize(form) <= wide:
        return struct.unpack_from(form, value)
    file.seek(*struct.unpack(order + ("I" if wide == 4 else "Q"), value))
    return _unpack(file, form)


def _unpack(file: BinaryIO, form: str) -> tuple[Any, ...]:
    return struct.unpack(form, file.read(struct.calcsize(form)))


def _is_whole_exr(path: Path) -> bool:
    try:
        with ExrContainer(path) as file:
            file.check_whole()
    except ReadError:
        return False
    return True
