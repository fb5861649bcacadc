"""Pixels as files hold them: half floats, 8 bits with dither, bytes as PNG and OpenEXR compress them.

On the host: one walk over the picture where NumPy makes several.
"""

from __future__ import annotations

import struct
from typing import TypeAlias

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

# DEFLATE of bytes without repetitions (RFC 1950, 1951) ---------------------------------------------------------------

LONGEST = 14
"""Bits of a code at most: two of them fit beside 31 bits that are not yet written."""
END, STORED = 256, 65535
"""The symbol that ends a block, and bytes that a block without codes may have."""
HEAD_BITS = 17 + 3 * 19 + 4 * (END + 1 + 2)
"""Before a block's codes: its kind, the lengths of the codes for lengths of codes, and these of 257 symbols and two
distances that it does not use. Lengths from 0 to 15 have a code of four bits each, repetitions of them none."""
FIVE, WORD, CODE = np.uint64(5), np.uint64(16), np.uint64(0xFFFF)
Bits: TypeAlias = tuple[Real, Real, Real]
"""Where words go on, the bits that are not yet written, and how many."""


@compiled
def count_bytes(data: np.ndarray, counts: np.ndarray) -> None:
    """counts (257,) int64 = how often each byte is in data (n,) uint8, and once the end of a block."""
    some = np.zeros((4, END), np.uint32)  # neighbours are often alike, and a sum waits for the last one in its place
    fours = data.size // 4
    for i in range(fours):
        for k in range(4):
            some[k, data[4 * i + k]] += np.uint32(1)
    for i in range(4 * fours, data.size):
        some[0, data[i]] += np.uint32(1)
    for symbol in range(END):
        counts[symbol] = np.int64(some[0, symbol]) + some[1, symbol] + some[2, symbol] + some[3, symbol]
    counts[END] = 1


@compiled
def sort(keys: np.ndarray) -> None:
    """Sort some hundred keys in their place (Shell, "A high-speed sorting procedure", 1959): NumPy's sort makes lists,
    which kernels that come compiled cannot."""
    for gap in (57, 23, 10, 4, 1):
        for i in range(gap, keys.size):
            key, place = keys[i], i
            while place >= gap and keys[place - gap] > key:
                keys[place] = keys[place - gap]
                place -= gap
            keys[place] = key


@compiled
def find_lengths(counts: np.ndarray, lengths: np.ndarray) -> int:
    """lengths (n,) int64 = bits of the Huffman codes of symbols that occur `counts` (n,) int64 times, 0 for those that
    do not; at least two must. Returns the bits of all together.

    Moffat and Katajainen, "In-place calculation of minimum-redundancy codes", 1995. Where codes would be longer than
    LONGEST, others become longer in their place.
    """
    keys, count = np.empty(counts.size, np.int64), 0
    for symbol in range(counts.size):
        if counts[symbol] > 0:
            keys[count] = counts[symbol] << 9 | symbol
            count += 1
    keys = keys[:count]
    sort(keys)
    nodes, leaf, root = keys >> 9, 0, 0
    for i in range(count - 1):  # an inner node of the two that are the rarest so far
        weight = 0
        for _ in range(2):
            if leaf == count or (root < i and nodes[root] < nodes[leaf]):
                weight += nodes[root]
                nodes[root] = i
                root += 1
            else:
                weight += nodes[leaf]
                leaf += 1
        nodes[i] = weight
    nodes[count - 2] = 0
    for i in range(count - 3, -1, -1):
        nodes[i] = nodes[nodes[i]] + 1
    numbers = np.zeros(LONGEST + 1, np.int64)  # of codes by their length
    inner, free, depth = count - 2, 1, 0
    while free > 0:
        used = 0
        while inner >= 0 and nodes[inner] == depth:
            used += 1
            inner -= 1
        numbers[min(depth, LONGEST)] += free - used
        free = 2 * used
        depth += 1
    excess = -(1 << LONGEST)
    for length in range(1, LONGEST + 1):
        excess += numbers[length] << (LONGEST - length)
    for _ in range(excess):
        length = LONGEST - 1
        while numbers[length] == 0:
            length -= 1
        numbers[length] -= 1
        numbers[length + 1] += 2
        numbers[LONGEST] -= 1
    total = 0
    lengths[:] = 0
    for length in range(1, LONGEST + 1):
        for _ in range(numbers[length]):
            count -= 1
            lengths[keys[count] & 0x1FF] = length
            total += length * (keys[count] >> 9)
    return total


@compiled
def make_codes(lengths: np.ndarray, codes: np.ndarray) -> None:
    """codes (n,) uint64 = the symbols' codes by their lengths (RFC 1951, 3.2.2), the first bit lowest, and from bit 16
    on their lengths."""
    following = np.zeros(LONGEST + 2, np.int64)
    for length in lengths:
        following[length + 1] += length > 0
    for length in range(1, LONGEST + 1):
        following[length] = (following[length] + following[length - 1]) << 1
    for symbol in range(lengths.size):
        length = lengths[symbol]
        code, turned = following[length], np.uint64(0)
        following[length] += 1
        for k in range(length):
            turned |= np.uint64((code >> k) & 1) << np.uint64(length - 1 - k)
        codes[symbol] = turned | np.uint64(length) << WORD


@compiled
def put(words: np.ndarray, at: Real, held: Real, count: Real, bits: Real, more: Real) -> Bits:
    """Write `more` bits, at most 32, behind the `count` that are held, of which those are written that fill a word."""
    held |= np.uint64(bits) << count
    count += np.uint64(more)
    words[at] = np.uint32(held)
    full = count >> FIVE
    return at + np.int64(full), held >> (full << FIVE), count - (full << FIVE)


@compiled
def put_coded(words: np.ndarray, at: Real, held: Real, count: Real, data: np.ndarray, lengths: np.ndarray, last: int
              ) -> Bits:
    """Write a block of bytes `data` as codes of these lengths."""
    codes = np.empty(lengths.size, np.uint64)
    make_codes(lengths, codes)
    at, held, count = put(words, at, held, count, last | 0b1111_00001_00000_10 << 1, 17)
    for k in range(19):  # those of repetitions are the first
        at, held, count = put(words, at, held, count, 4 * (k > 2), 3)
    for k in range(lengths.size + 2):
        length = lengths[k] if k < lengths.size else 1
        turned = (length & 1) << 3 | (length & 2) << 1 | (length & 4) >> 1 | length >> 3
        at, held, count = put(words, at, held, count, turned, 4)
    for i in range(data.size // 2):
        one, other = codes[data[2 * i]], codes[data[2 * i + 1]]
        both = (one & CODE) | (other & CODE) << (one >> WORD)
        at, held, count = put(words, at, held, count, both, (one >> WORD) + (other >> WORD))
    if data.size % 2:
        code = codes[data[data.size - 1]]
        at, held, count = put(words, at, held, count, code & CODE, code >> WORD)
    end: Bits = put(words, at, held, count, codes[END] & CODE, codes[END] >> WORD)
    return end


@compiled
def put_stored(words: np.ndarray, at: Real, held: Real, count: Real, data: np.ndarray, last: int) -> Bits:
    """Write bytes `data` as they are, in blocks."""
    for first in range(0, data.size, STORED):
        some = data[first : first + STORED]
        at, held, count = put(words, at, held, count, last * (first + STORED >= data.size), 3)
        at, held, count = put(words, at, held, count, 0, -count & np.uint64(7))
        at, held, count = put(words, at, held, count, some.size | (some.size ^ STORED) << 16, 32)
        words[at], place = np.uint32(held), 4 * at + np.int64(count >> np.uint64(3))
        words.view(np.uint8)[place : place + some.size] = some
        place += some.size
        at, count = place // 4, np.uint64(8 * (place % 4))
        held = np.uint64(words[at]) & ((np.uint64(1) << count) - np.uint64(1))
    return at, held, count


@compiled
def pack_bytes(plain: np.ndarray, check: int, words: np.ndarray) -> int:
    """words (m,) uint32 = bytes `plain` (n,) uint8 as a stream of zlib's, without a search for repetitions: each half
    as codes of its own, or as it is where that is not longer. Returns its bytes.

    check: Adler-32 of the bytes; m: at least n / 4 + n / 32768 + 62.
    """
    counts, lengths = np.empty(END + 1, np.int64), np.empty(END + 1, np.int64)
    at, held, count = put(words, 0, np.uint64(0), np.uint64(0), 0x0178, 16)
    middle = plain.size // 2
    for last in range(2):
        half = plain[middle:] if last else plain[:middle]
        count_bytes(half, counts)
        if find_lengths(counts, lengths) + HEAD_BITS < 8 * half.size:
            at, held, count = put_coded(words, at, held, count, half, lengths, last)
        else:
            at, held, count = put_stored(words, at, held, count, half, last)
    at, held, count = put(words, at, held, count, 0, -count & np.uint64(7))
    turned = (check & 0xFF) << 24 | (check & 0xFF00) << 8 | (check >> 8) & 0xFF00 | check >> 24
    at, held, count = put(words, at, held, count, turned, 32)
    words[at] = np.uint32(held)
    size: int = 4 * at + np.int64(count >> np.uint64(3))
    return size


@compiled
def count_coded(data: np.ndarray) -> int:
    """Bytes that the codes of bytes `data` (n,) uint8 take together."""
    counts, lengths = np.empty(END + 1, np.int64), np.empty(END + 1, np.int64)
    count_bytes(data, counts)
    size: int = find_lengths(counts, lengths) // 8
    return size


# A chunk of OpenEXR's ZIP --------------------------------------------------------------------------------------------

_LEVEL = 1  # of ISA-L: a fifth of the time of OpenEXR's level 4 for 6 % more bytes
_STEP, _BESIDE = 1 << 15, 64  # words that a stream may need beside those of its bytes: one for so many, and these
_SMALL = 1 << 16  # bytes of a chunk of which a sample would take too long
_RUN, _RUNS = 64, 8  # bytes of a sample that lie side by side, and about how many such runs are of a row's half
_APART, _GAIN, _OFF = 2, 0.98, 0.08
_SMOOTH, _RANDOM = 0.3, 0.97  # where codes make so little of bytes, there are repetitions; so much, none


def compress_rows(lines: np.ndarray, top: int) -> bytes | memoryview:
    """A chunk of rows (rows, bytes) uint8, the first of which has the number `top`.

    ISA-L compresses it, unless codes of bytes alone make it smaller: so it is with light that has noise or grain, and
    they take half the time.
    """
    plain = lines.reshape(-1)
    differences = np.empty_like(plain)
    predict_bytes(plain, differences)
    if guess := _guess_coded(differences, len(lines)):
        words = np.empty(plain.size // 4 + plain.size // _STEP + _BESIDE, np.uint32)
        size = pack_bytes(differences, isal_zlib.adler32(differences), words[2:])
        if size < plain.size and abs(size - guess) < _OFF * guess:  # else the sample does not speak for the chunk
            words[:2].view(np.int32)[:] = top, size
            return words.data.cast("B")[: 8 + size]
    packed = isal_zlib.compress(differences, _LEVEL)
    stored = packed if len(packed) < plain.size else plain.tobytes()
    return struct.pack("<2i", top, len(stored)) + stored


def _guess_coded(differences: np.ndarray, rows: int) -> int:
    """About how many bytes codes of bytes alone make of a chunk, as a sample tells: some places of every other row, of
    the lower and of the upper bytes; 0 where a search for repetitions makes fewer."""
    if differences.size < _SMALL:
        return 0
    coded = searched = size = 0
    for half in differences.reshape(2, rows, -1)[::-1, ::_APART]:  # the upper ones first
        runs = half[:, : half.shape[1] // _RUN * _RUN].reshape(len(half), -1, _RUN)
        step = max(1, runs.shape[1] // _RUNS)
        sample = runs[:, step // 2 :: step].reshape(-1)
        found = count_coded(sample)
        coded, size = coded + found, size + sample.size
        if coded < _SMOOTH * size:
            return 0
        is_random = found > _RANDOM * sample.size
        searched += found if is_random else len(isal_zlib.compress(sample, _LEVEL))
    return coded * differences.size // size if coded < _GAIN * searched else 0


def decompress_rows(stored: bytes | memoryview, count: int) -> np.ndarray | None:
    """A chunk's words, uint16 (count,); None if it is broken."""
    if len(stored) == 2 * count:
        return np.frombuffer(stored, np.uint16).copy()  # Numba compiles once more for what cannot be written
    try:
        differences = deflate.zlib_decompress(stored, 2 * count)
    except deflate.DeflateError:
        return None
    if len(differences) != 2 * count:
        return None
    words = np.empty(count, np.uint16)
    unpredict_bytes(np.frombuffer(differences, np.uint8), words)
    return words
