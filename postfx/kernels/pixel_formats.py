"""Pixels as files hold them: half floats, 8 bits with dither, bytes as PNG and OpenEXR compress them.

On the host: one walk over the picture where NumPy makes several.
"""

from __future__ import annotations

import deflate
import numpy as np
from isal import isal_zlib

from postfx.kernels.numeric import Real, compiled, inline

ZERO, ONE = np.float32(0), np.float32(1)
LARGEST = np.int32(0x477FE000)
"""Bits in float32 of 65504, the largest half float."""
INFINITY, LEAST_NORMAL = np.int32(0x7F800000), np.int32(0x38800000)
REBIAS, ROUND = np.int32(0x38000000), np.int32(0xFFF)
SUBNORMALS = np.float32(2**24)
"""Half floats below the least normal one are whole numbers over this."""
BYTE = np.uint32(128)
"""What is added to differences of bytes."""
EIGHT, SIXTEEN, THIRTY_TWO, LAST = np.uint64(8), np.uint64(16), np.uint64(32), np.uint64(48)
TOPS, BYTES, LANES = np.uint64(0x8080808080808080), np.uint64(0x00FF00FF00FF00FF), np.uint64(0x0001000100010001)
LANE, HALF, LOW = np.uint64(0xFFFF), np.uint64(0xFFFFFFFF), np.uint64(0xFF)
"""Places and masks of the bytes and of the lanes of 16 bits in a number of 64."""
PIECE = 512


@compiled
def halve(values: np.ndarray, output: np.ndarray) -> None:
    """output (channels, n) uint16 = bits of the half floats nearest to `values` (n * channels,), bits of float32 as
    int32, ties to even, cut to +-65504. NaN stays NaN."""
    count, size = output.shape
    apart = np.empty((count, PIECE), np.int32)
    lights = apart.view(np.float32)
    for first in range(0, size, PIECE):
        pixels = min(PIECE, size - first)
        some = values[first * count : (first + pixels) * count]
        if count == 3:  # a number that the compiler knows
            red, green, blue = apart[0], apart[1], apart[2]
            for i in range(pixels):
                red[i], green[i], blue[i] = some[3 * i], some[3 * i + 1], some[3 * i + 2]
        else:
            for k in range(count):
                for i in range(pixels):
                    apart[k, i] = some[count * i + k]
        for k in range(count):
            bits, light, found = apart[k], lights[k], output[k, first : first + pixels]
            for i in range(pixels):
                whole = bits[i] & np.int32(0x7FFFFFFF)
                cut = min(whole, LARGEST)
                normal = (cut + ROUND + ((cut >> np.int32(13)) & np.int32(1)) - REBIAS) >> np.int32(13)
                small = np.int32(np.rint(min(abs(light[i]), ONE) * SUBNORMALS))
                half = normal if cut >= LEAST_NORMAL else small
                half = half if whole <= INFINITY else np.int32(0x7E00)
                found[i] = np.uint16(half | ((bits[i] >> np.int32(16)) & np.int32(0x8000)))


@compiled
def look_up(codes: np.ndarray, table: np.ndarray, output: np.ndarray) -> bool:
    """output (n,) float32 = `table` between its entries, which lie evenly over codes (n,) float32 from 0 to 1 and end
    with the last one twice. Returns whether all codes lie there."""
    last = np.float32(table.size - 2)
    beside = False
    for i in range(codes.size):
        code = codes[i] if codes[i] > ZERO else ZERO  # NaN, too
        code = code if code < ONE else ONE
        beside |= code != codes[i]
        place = code * last
        whole = np.int32(place)
        entry = np.uint32(whole)  # an index that may be negative is looked at once more: three times as long
        low = table[entry]
        output[i] = low + (place - np.float32(whole)) * (table[entry + np.uint32(1)] - low)
    return not beside


@compiled
def predict_bytes(plain: np.ndarray, differences: np.ndarray) -> None:
    """differences (n,) uint8 = bytes of `plain` (n,) uint8, n even, as OpenEXR compresses them (ImfZip.cpp): those in
    even places before those in odd ones, each less the one before it, plus 128."""
    half = plain.size // 2
    differences[0] = plain[0]
    for i in range(1, half):
        differences[i] = plain[2 * i] - plain[2 * i - 2] + 128
    differences[half] = plain[1] - plain[2 * half - 2] + 128
    for i in range(1, half):
        differences[half + i] = plain[2 * i + 1] - plain[2 * i - 1] + 128


@inline
def spread(two: Real) -> Real:
    """Two lanes of 16 bits with a gap behind each."""
    return (two & LANE) | ((two & (LANE << SIXTEEN)) << SIXTEEN)


@compiled
def add_up(differences: np.ndarray, before: Real, sums: np.ndarray, odds: np.ndarray) -> Real:
    """Running sums of bytes that 128 was added to, eight of them a number, from `before` on: `sums` has those of odd
    places in lanes of 16 bits, with bits above, and `odds` is what those of even places are less. Returns the last sum.

    A product with ones adds up the lanes of each number. Only what comes before each number is added one by one.
    """
    for i in range(differences.size):
        eight = differences[i] ^ TOPS
        odds[i] = (eight >> EIGHT) & BYTES
        sums[i] = ((eight & BYTES) + odds[i]) * LANES
    for i in range(differences.size):
        last = before + (sums[i] >> LAST)
        sums[i] += before * LANES
        before = last & LOW
    return before


@compiled
def unpredict_eights(differences: np.ndarray, words: np.ndarray, low: Real, high: Real) -> None:
    """What `unpredict_bytes` does, eight bytes at a time, in pieces that stay in the cache."""
    count = words.size // 2
    scratch = np.empty((4, PIECE), np.uint64)
    for first in range(0, count, PIECE):
        size = min(PIECE, count - first)
        sums, odds, high_sums, high_odds = scratch[0, :size], scratch[1, :size], scratch[2, :size], scratch[3, :size]
        low = add_up(differences[first : first + size], low, sums, odds)
        high = add_up(differences[count + first : count + first + size], high, high_sums, high_odds)
        found = words[2 * first :]
        for i in range(size):
            even = ((sums[i] - odds[i]) & BYTES) | ((high_sums[i] - high_odds[i]) & BYTES) << EIGHT
            odd = (sums[i] & BYTES) | (high_sums[i] & BYTES) << EIGHT
            found[2 * i] = spread(even & HALF) | (spread(odd & HALF) << SIXTEEN)
            found[2 * i + 1] = spread(even >> THIRTY_TWO) | (spread(odd >> THIRTY_TWO) << SIXTEEN)


@compiled
def unpredict_bytes(differences: np.ndarray, words: np.ndarray) -> None:
    """words (n,) uint16 = those whose bytes, the lower ones first, `predict_bytes` made into differences (2 n,)."""
    half, done = words.size, 0
    low, high = np.uint32(0), np.uint32(0)
    for i in range(half):
        high += np.uint32(differences[i]) - BYTE
    low, high = BYTE, high + BYTE
    if half % 8 == 0:
        unpredict_eights(differences.view(np.uint64), words.view(np.uint64), np.uint64(low),
                         np.uint64(high & np.uint32(0xFF)))
        done = half
    for i in range(done, half):
        low += np.uint32(differences[i]) - BYTE
        high += np.uint32(differences[half + i]) - BYTE
        words[i] = np.uint16(low & np.uint32(0xFF) | (high & np.uint32(0xFF)) << np.uint32(8))


@inline
def widen(halves: np.ndarray, bits: np.ndarray) -> None:
    """bits (n,) uint32 = those of the float32 that equal half floats (n,) uint16."""
    for i in range(halves.size):
        half = np.uint32(halves[i])
        size = half & np.uint32(0x7FFF)
        normal = (size << np.uint32(13)) + np.uint32(REBIAS)
        small = np.float32(np.float32(np.int32(size)) / SUBNORMALS).view(np.uint32)
        found = normal if size >= np.uint32(0x400) else small
        found = found if size < np.uint32(0x7C00) else (size << np.uint32(13)) | np.uint32(INFINITY)
        bits[i] = found | (half & np.uint32(0x8000)) << np.uint32(16)


@compiled
def widen_rows(words: np.ndarray, channels: np.ndarray, bits: np.ndarray) -> None:
    """bits (rows, n, count) uint32 = those of the float32 that equal values in rows of `words` (rows, m) uint16.

    channels (count, 2) int64: of each its kind, 1 for half floats and 2 for floats, and the column where it begins.
    """
    count, size = channels.shape[0], bits.shape[1]
    apart = np.empty((count, size), np.uint32)
    for y in range(bits.shape[0]):
        for k in range(count):
            kind, start = channels[k]
            some, row = words[y, start : start + kind * size], apart[k]
            if kind == 1:
                widen(some, row)
            else:
                for i in range(size):
                    row[i] = np.uint32(some[2 * i]) | np.uint32(some[2 * i + 1]) << np.uint32(16)
        found = bits[y].reshape(size * count)
        if count == 3:  # a number that the compiler knows: a tenth of the time
            first, second, third = apart[0], apart[1], apart[2]
            for i in range(size):
                found[3 * i], found[3 * i + 1], found[3 * i + 2] = first[i], second[i], third[i]
        else:
            for k in range(count):
                for i in range(size):
                    found[count * i + k] = apart[k, i]


@compiled
def paeth(rows: np.ndarray, above: np.ndarray, step: int, output: np.ndarray) -> None:
    """output (h, n + 1) uint8 = rows (h, n) uint8 by PNG's filter 4, after its number (ISO/IEC 15948, 9.4).

    `above` (n,) is the row before, zeros for the first; `step` the bytes of a pixel.
    """
    for y in range(rows.shape[0]):
        row, output[y, 0] = rows[y], 4
        for i in range(step):
            output[y, 1 + i] = row[i] - above[i]
        for i in range(step, row.size):
            left, up, corner = np.int32(row[i - step]), np.int32(above[i]), np.int32(above[i - step])
            guess = left + up - corner
            to_left, to_up, to_corner = abs(guess - left), abs(guess - up), abs(guess - corner)
            nearer = up if to_up <= to_corner else corner
            output[y, 1 + i] = row[i] - (left if to_left <= min(to_up, to_corner) else nearer)
        above = row




@compiled
def dither_rows(codes: np.ndarray, top: Real, thresholds: np.ndarray, output: np.ndarray) -> None:
    """output (height, values) uint8 = the whole part of top * codes, cut to 0..1, plus a threshold.

    codes: (height, values) float32, NaN counts as 0; thresholds (rows, columns) float32 in (0, 1), repeated.
    """
    height, values = codes.shape
    rows, columns = thresholds.shape
    for y in range(height):
        row = thresholds[y % rows]
        for start in range(0, values, columns):
            # pieces with an index from 0: otherwise the compiler finds no vector instructions for them
            some, found = codes[y, start : start + columns], output[y, start : start + columns]
            for i in range(some.size):
                value = some[i] if some[i] > ZERO else ZERO  # NaN, too
                value = value if value < ONE else ONE
                found[i] = np.uint8(np.int32(value * top + row[i]))


# A chunk of OpenEXR's ZIP --------------------------------------------------------------------------------------------

_LEVEL = 1  # of ISA-L: a fifth of the time of OpenEXR's level 4 for 6 % more bytes


def compress_rows(lines: np.ndarray) -> bytes:
    """The data of a chunk of rows (rows, bytes) uint8."""
    plain = lines.reshape(-1)
    differences = np.empty_like(plain)
    predict_bytes(plain, differences)
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
    unpredict_bytes(np.frombuffer(differences, np.uint8), words)
    return True
