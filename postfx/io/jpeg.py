"""JPEG files, whose encoder ends the process where a disk is full."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

from postfx.files import memory_file, read_to_end
from postfx.workers import Workers, can_begin_threads

JPEG_SUFFIXES = (".jpg", ".jpeg")
JPEG_END = b"\xff\xd9"
"""Last bytes of a file."""
HEADERS_BYTES = 1 << 16
"""Room for all but the pixels."""


def write_jpeg(path: Path, image_bytes: int, encode: Callable[[Path], None]) -> None:
    """Encode through a pipe, as libjpeg ends the process where a disk is full or a file is larger
    than it may be.

    encode: writes the file under another name. image_bytes: of the pixels that it writes, which it
        has less of.
    """
    if not (Path("/dev/fd").is_dir() and can_begin_threads()):
        # on Windows, where pipes have no names, or with nobody to read: there must be room for any
        # JPEG
        with memory_file(JPEG_SUFFIXES[0], image_bytes) as made:
            encode(made)
            path.write_bytes(made.read_bytes())
        return
    reading, writing = os.pipe()
    with Workers(1) as reader:
        content = reader.submit(read_to_end, reading, 4 * image_bytes + HEADERS_BYTES)
        try:
            encode(Path(f"/dev/fd/{writing}"))
        finally:
            os.close(writing)
        path.write_bytes(content.result())
