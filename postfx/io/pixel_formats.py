"""Pixels as files hold them: half floats, 8 bits with dither, bytes as PNG and OpenEXR compress
them.

On the host: one walk over the picture where NumPy makes several. Arrays that are written must have
no gaps.
"""

from __future__ import annotations

import deflate
import numpy as np
from isal import isal_zlib

from postfx.compiled.calls import whole
from postfx.compiled.library import Rows

halve_pixels = Rows("halve_pixels")
"""output (channels, n) uint16 = bits of the half floats nearest to values (n * channels,) float32,
ties to even, cut to +-65504; the rows are n. NaN stays NaN. Arrays: values, output."""
look_up = Rows("look_up")
"""output (n,) float32 = a table between its entries, which lie evenly over codes (n,) float32 from
0 to 1 and end with the last one twice; inside (1,) bool tells whether all codes lie there. Arrays:
codes, table, output, inside."""
widen_rows = Rows("widen_rows")
"""pixels (rows, n, count) float32 = values in rows of words (rows, m) uint16; channels (count, 2)
int64: of each its kind, 1 for half floats and 2 for floats, and the column where it begins. Arrays:
words, channels, pixels."""
predict_bytes = Rows("predict_bytes")
"""differences (n,) uint8 = bytes of plain (n,) uint8, n even, as OpenEXR compresses them
(ImfZip.cpp): those in even places before those in odd ones, each less the one before it, plus 128.
One row. Arrays: plain, differences."""
unpredict_bytes = Rows("unpredict_bytes")
"""words (n,) uint16 = those whose bytes, the lower ones first, `predict_bytes` made into
differences (2 n,). One row. Arrays: differences, words."""
_dither_rows = Rows("dither_rows")
_filter_rows = Rows("filter_rows")


def dither_rows(codes: np.ndarray, top: float | np.floating, thresholds: np.ndarray,
                output: np.ndarray) -> None:
    """output (height, values) uint8 = the whole part of top * codes, cut to 0..1, plus a threshold.

    codes: (height, values) float32, NaN counts as 0; thresholds (rows, columns) float32 in (0, 1),
    repeated.
    """
    _dither_rows(0, len(codes), codes, np.array([top], np.float32), thresholds, output)


def paeth(rows: np.ndarray, above: np.ndarray, step: int, output: np.ndarray) -> None:
    """output (h, n + 1) uint8 = rows (h, n) uint8 by PNG's filter 4, after its number (ISO/IEC
    15948, 9.4).

    `above` (n,) is the row before, zeros for the first; `step` the bytes of a pixel.
    """
    _filter_rows(0, len(rows), whole(rows, np.uint8), whole(above, np.uint8), np.array([step]),
                 output)


# A chunk of OpenEXR's ZIP

_LEVEL = 1  # of ISA-L: a fifth of the time of OpenEXR's level 4 for 6 % more bytes


def compress_rows(lines: np.ndarray) -> bytes:
    """The data of a chunk of rows (rows, bytes) uint8."""
    plain = lines.reshape(-1)
    differences = np.empty_like(plain)
    predict_bytes(0, 1, plain, differences)
    packed = isal_zlib.compress(differences, _LEVEL)
    return packed if len(packed) < plain.size else plain.tobytes()


def decompress_rows(stored: bytes | memoryview, words: np.ndarray) -> bool:
    """Fill `words` (n,) uint16 with those of a chunk; whether it is not broken."""
    if len(stored) == 2 * words.size:
        words[:] = np.frombuffer(stored, np.uint16)
        return True
    try:
        differences = deflate.zlib_decompress(stored, 2 * words.size)
    except deflate.DeflateError:
        return False
    if len(differences) != 2 * words.size:
        return False
    unpredict_bytes(0, 1, np.frombuffer(differences, np.uint8), words)
    return True
