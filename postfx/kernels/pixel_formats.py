"""Pixels as files hold them: half precision and 8 bits with dither.

Pixels as files store them, on the host: one walk over the picture where NumPy makes several.

Code values to eight bits by thresholds, on the host: one walk over the picture where NumPy makes eight.
"""

from __future__ import annotations

import numpy as np

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
def halve(values: np.ndarray, bits: np.ndarray, output: np.ndarray) -> None:
    """output (n,) uint16 = bits of the half floats nearest to `values` (n,) float32, ties to even, cut to +-65504.

    `bits` are those of `values`, as int32. NaN stays NaN.
    """
    for i in range(values.size):
        size = bits[i] & np.int32(0x7FFFFFFF)
        cut = min(size, LARGEST)
        normal = (cut + ROUND + ((cut >> np.int32(13)) & np.int32(1)) - REBIAS) >> np.int32(13)
        small = np.int32(np.rint(min(abs(values[i]), ONE) * SUBNORMALS))
        half = normal if cut >= LEAST_NORMAL else small
        half = half if size <= INFINITY else np.int32(0x7E00)
        output[i] = np.uint16(half | ((bits[i] >> np.int32(16)) & np.int32(0x8000)))


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
        found = words[2 * first : 2 * (first + size)]
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


@compiled
def interleave(first: np.ndarray, second: np.ndarray, third: np.ndarray, output: np.ndarray) -> None:
    """output (rows, columns, 3) = three channels (rows, columns) side by side: all float32, rows without gaps."""
    for y in range(output.shape[0]):
        a, b, c, row = first[y], second[y], third[y], output[y].reshape(3 * first.shape[1])
        for x in range(a.size):
            row[3 * x], row[3 * x + 1], row[3 * x + 2] = a[x], b[x], c[x]


@compiled
def widen_rows(words: np.ndarray, start: int, bits: np.ndarray) -> None:
    """bits (rows, n) uint32 = those of the float32 that equal the half floats in rows of `words` (rows, m) uint16, from
    column `start` on."""
    for y in range(bits.shape[0]):
        halves, row = words[y, start : start + bits.shape[1]], bits[y]
        for i in range(row.size):
            half = np.uint32(halves[i])
            size = half & np.uint32(0x7FFF)
            normal = (size << np.uint32(13)) + np.uint32(REBIAS)
            small = np.float32(np.float32(np.int32(size)) / SUBNORMALS).view(np.uint32)
            found = normal if size >= np.uint32(0x400) else small
            found = found if size < np.uint32(0x7C00) else (size << np.uint32(13)) | np.uint32(INFINITY)
            row[i] = found | (half & np.uint32(0x8000)) << np.uint32(16)


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
