"""ZIP-compressed scanline chunks, made from channels in their stored formats.

The compression, as OpenEXR's ImfZip.cpp defines it: bytes in even places before those in odd ones, then differences of
neighbours, then DEFLATE; a chunk that does not get smaller is stored as it is. DEFLATE is ISA-L's.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import OpenImageIO as oiio
from isal import isal_zlib

from postfx.io.windows import Window
from postfx.kernels.storing import part

ZIP = 3
ZIP_LINES = 16
_LEVEL = 1  # of ISA-L: a fifth of the time of OpenEXR's level 4 for 6 % more bytes
_PIECE = 4 << 20  # bytes that are read and compressed at once
Rows = Callable[[int, int], list[np.ndarray]]


def zip_chunks(data: Window, pixel_bytes: int, read: Rows) -> Iterator[tuple[int, bytes]]:
    """Place in the table and bytes of the chunks of a part with this data window.

    `read(first, last)` gives the rows of all channels, counted from the window's top, last not included, in the order
    of the header: arrays (rows, width) of little-endian uint32, float16 or float32. `pixel_bytes` are those of all of a
    pixel's channels. Runs on as many threads as OpenImageIO reads and writes with.
    """
    step = max(1, _PIECE // (data.width * pixel_bytes * ZIP_LINES)) * ZIP_LINES
    with ThreadPoolExecutor(oiio.get_int_attribute("threads"), "postfx zip") as pool:
        for first in range(0, data.height, step):
            last = min(data.height, first + step)
            lines = _lines(read(first, last), data.width * pixel_bytes)
            blocks = [lines[top : top + ZIP_LINES] for top in range(0, last - first, ZIP_LINES)]
            for number, stored in enumerate(pool.map(_compressed, blocks)):
                row = first + number * ZIP_LINES
                yield row // ZIP_LINES, struct.pack("<2i", data.y0 + row, len(stored)) + stored


def _lines(channels: list[np.ndarray], line_bytes: int) -> np.ndarray:
    """Channels (rows, width) -> the bytes of each row, (rows, bytes)."""
    lines, at = np.empty((len(channels[0]), line_bytes), np.uint8), 0
    for channel in channels:
        end = at + channel.shape[1] * channel.itemsize
        lines[:, at:end].view(channel.dtype)[:] = channel
        at = end
    return lines


def _compressed(lines: np.ndarray) -> bytes:
    plain = lines.reshape(-1)
    differences = np.empty_like(plain)
    part(plain, differences)
    packed = isal_zlib.compress(differences, _LEVEL)
    return packed if len(packed) < len(plain) else plain.tobytes()
