"""Whether picture files end as their formats want it: their encoders and decoders take shortened ones for whole."""

from __future__ import annotations

import os
import struct
from pathlib import Path

from postfx.errors import ReadError
from postfx.io.container.chunks import ExrContainer

JPEG = (".jpg", ".jpeg")
_ENDS = {".png": b"\0\0\0\0IEND\xaeB`\x82", ".jpg": b"\xff\xd9", ".jpeg": b"\xff\xd9"}
_TIFF = {b"II*\0": "<I", b"MM\0*": ">I", b"II+\0": "<4xQ", b"MM\0+": ">4xQ"}
# First bytes -> where the offset of the directory, which is written last, follows.


def has_end(path: Path, suffix: str) -> bool:
    """Whether a file of the format of a suffix ends well: PNG's and JPEG's last bytes are there, TIFF's directory, all
    chunks of all parts of an OpenEXR file."""
    suffix = suffix.lower()
    if suffix == ".exr":
        return _is_whole_exr(path)
    with path.open("rb") as file:
        if suffix in _ENDS:
            end = _ENDS[suffix]
            size = file.seek(0, os.SEEK_END)
            file.seek(max(0, size - len(end)))
            return file.read() == end
        return _has_directory(file.read(16), path.stat().st_size)


def _has_directory(start: bytes, size: int) -> bool:
    layout = _TIFF.get(start[:4])
    if layout is None or len(start) < 16:
        return False
    (offset,) = struct.unpack_from(layout, start, 4)
    return 8 <= offset < size - 6


def _is_whole_exr(path: Path) -> bool:
    try:
        with ExrContainer(path) as file:
            file.check_whole()
    except ReadError:
        return False
    return True
