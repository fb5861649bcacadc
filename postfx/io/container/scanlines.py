"""Chunks of ZIP-compressed scanlines out of channels as they are stored.

The compression, as OpenEXR's ImfZip.cpp has it: bytes in even places before those in odd ones, then differences of
neighbours, then DEFLATE; a chunk that does not get smaller is stored as it is.
"""

from __future__ import annotations

import os
import struct
import zlib
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from postfx.io.part import Window

ZIP = 3
ZIP_LINES = 16
_LEVEL = 4  # of DEFLATE, OpenEXR's own
_PIECE = 16 << 20  # bytes that are read and compressed at once
Rows = Callable[[int, int], list[np.ndarray]]


def zip_chunks(data: Window, pixel_bytes: int, read: Rows) -> Iterator[tuple[int, bytes]]:
    """Place in the table and bytes of the chunks of a part with this data window.

    `read(first, last)` gives the rows of all channels, counted from the window's top, last not included, in the order
    of the header: arrays (rows, width) of little-endian uint32, float16 or float32. `pixel_bytes` are those of all of a
    pixel's channels.
    """
    step = max(1, _PIECE // (data.width * pixel_bytes * ZIP_LINES)) * ZIP_LINES
    with ThreadPoolExecutor(os.cpu_count(), "postfx zip") as pool:
        for first in range(0, data.height, step):
            last = min(data.height, first + step)
            lines = np.concatenate([_bytes_of(rows) for rows in read(first, last)], axis=1)
            blocks = [lines[top : top + ZIP_LINES] for top in range(0, last - first, ZIP_LINES)]
            for number, stored in enumerate(pool.map(_compressed, blocks)):
                row = first + number * ZIP_LINES
                yield row // ZIP_LINES, struct.pack("<2i", data.y0 + row, len(stored)) + stored


def _bytes_of(rows: np.ndarray) -> np.ndarray:
    """(rows, width) -> the bytes of each row."""
    return np.ascontiguousarray(rows).view(np.uint8).reshape(len(rows), -1)


def _compressed(lines: np.ndarray) -> bytes:
    plain = lines.reshape(-1)
    parted = np.concatenate([plain[0::2], plain[1::2]])
    differences = parted.copy()
    differences[1:] += 128 - parted[:-1]
    packed = zlib.compress(differences.tobytes(), _LEVEL)
    return packed if len(packed) < len(plain) else plain.tobytes()
