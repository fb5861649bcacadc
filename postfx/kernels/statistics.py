"""What the host looks at in a frame's planes before it is uploaded: whether all numbers are finite, the light of blocks
of pixels, on which exposure is metered, a coarse grid's cells, by which cuts are found, where alpha differs, whether
depth is noise, and how much light lies outside the gamut.

Loops over rows become vector instructions. Sums keep their order, so that a multiplier does not depend on them, nor on
the threads that a pipeline lends for the largest of these.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar

import numpy as np

from postfx.colour import WIDER
from postfx.kernels.native import bind_rows
from postfx.kernels.numeric import Real, add, compiled, inline, summed, vectorised

INFINITY_BITS = np.uint32(0x7F800000)
"""The bits of an infinite float32; those of NaN, without the sign, are larger."""
PIECE = 1 << 12
"""Numbers that are looked at before one looks whether more is needed."""
WORTH = 1 << 20
"""Bytes to look at or to copy that are worth another thread."""

Divide = Callable[[Callable[[int, int], None], int], None]
_lent: ContextVar[Divide | None] = ContextVar("divide", default=None)


@contextmanager
def lend(divide: Divide | None) -> Iterator[None]:
    """Let `share` divide work by `divide(rows, count)`, which runs `rows(first, last)` in several threads."""
    token = _lent.set(divide)
    try:
        yield
    finally:
        _lent.reset(token)


def share(rows: Callable[..., None], count: int, *arrays: np.ndarray) -> None:
    """Run compiled `rows(first, last, *arrays)` over rows 0 to count - 1, on the threads that are lent if it is worth
    that. The first array is by far the largest."""
    divide = _lent.get()
    if divide is None or arrays[0].nbytes < 2 * WORTH:
        rows(0, count, *arrays)
    else:
        divide(bind_rows(rows, arrays), count)


@compiled
def copy(source: np.ndarray, target: np.ndarray) -> None:
    for i in range(target.size):
        target[i] = source[i]


@compiled
def copy_pieces(first: int, last: int, source: np.ndarray, target: np.ndarray) -> None:
    """Copy pieces of `WORTH` bytes of flat uint32, the last of which may be smaller."""
    begin, end = first * (WORTH // 4), min(last * (WORTH // 4), target.size)
    copy(source[begin:end], target[begin:end])


@compiled
def largest_bits(flat: np.ndarray) -> Real:
    """The largest of flat (count,) uint32, which are bits of float32 numbers, without their signs."""
    largest = np.uint32(0)
    for i in range(flat.size):
        largest = max(largest, flat[i] & np.uint32(0x7FFFFFFF))
    return largest


@compiled
def largest_bits_of_rows(first: int, last: int, rows: np.ndarray, largest: np.ndarray) -> None:
    """The same of each of some rows (count, n) uint32 -> (count,)."""
    for y in range(first, last):
        largest[y] = largest_bits(rows[y])


def largest_bits_of(plane: np.ndarray) -> int:
    """The same of a plane (height, width, channels) of float32, on the threads that are lent if it is worth that."""
    bits = plane.view(np.uint32)
    if bits.nbytes < 2 * WORTH:
        return int(largest_bits(bits.reshape(-1)))
    largest = np.empty(len(bits), np.uint32)
    share(largest_bits_of_rows, len(bits), bits.reshape(len(bits), -1), largest)
    return int(largest.max())


@compiled
def light_of_row(row: np.ndarray, light: np.ndarray) -> Real:
    """Luminance (w,) of a flat row of Rec.709 (3 w,), 0 where it is negative or not finite; returns how often the
    latter."""
    unknown = 0
    for x in range(light.size):
        value = 0.2126 * row[3 * x] + 0.7152 * row[3 * x + 1] + 0.0722 * row[3 * x + 2]
        known = abs(value) < np.inf  # false for NaN too
        unknown += not known
        light[x] = value if known and value > 0.0 else 0.0
    return unknown


@compiled
def add_blocks(light: np.ndarray, block: int, total: np.ndarray, brightest: np.ndarray) -> None:
    """Add a row of light (w,) to the sums of its blocks, and find the brightest pixel of each."""
    for i in range(total.size):
        so_far, most = total[i], brightest[i]
        for x in range(i * block, min((i + 1) * block, light.size)):
            so_far += light[x]
            most = max(most, light[x])
        total[i], brightest[i] = so_far, most


@compiled
def leave_out(row: np.ndarray, block: int, count: np.ndarray) -> None:
    """Take the pixels of a flat row (3 w,) that are not finite from the counts of their blocks."""
    for x in range(row.size // 3):
        if not abs(0.2126 * row[3 * x] + 0.7152 * row[3 * x + 1] + 0.0722 * row[3 * x + 2]) < np.inf:
            count[x // block] -= 1


@compiled
def block_means(first: int, last: int, colour: np.ndarray, side: np.ndarray, means: np.ndarray) -> None:
    """Mean luminance of each block of `side` (1,) x side pixels without the brightest, in some rows; colour (h, w, 3)
    -> means (rows, columns).

    Non-finite pixels are left out, negative ones count as 0. Averaging keeps the noise of one sample a pixel out of
    the logarithm that follows, which would read it as darkness; without the brightest pixel a firefly is no light.
    """
    height, width, columns, block = colour.shape[0], colour.shape[1], means.shape[1], side[0]
    light, total, brightest = np.empty(width), np.empty(columns), np.empty(columns)
    count = np.empty(columns, np.int64)
    for j in range(first, last):
        begin, end = j * block, min((j + 1) * block, height)
        total[:], brightest[:] = 0.0, 0.0
        for i in range(columns):
            count[i] = (end - begin) * (min((i + 1) * block, width) - i * block)
        for y in range(begin, end):
            row = colour[y].reshape(3 * width)
            if light_of_row(row, light):
                leave_out(row, block, count)
            add_blocks(light, block, total, brightest)
        for i in range(columns):
            means[j, i] = (total[i] - brightest[i]) / (count[i] - 1) if count[i] > 1 else total[i]


@compiled
def half_means(first: int, last: int, colour: np.ndarray, side: np.ndarray, means: np.ndarray) -> None:
    """Mean luminance of the two halves of each whole block of `side` (1,) x side pixels in some rows; colour (h, w, 3)
    -> means (2, rows, columns).

    The halves are the even and the odd rows, so they show the same with other noise. The brightest pixel of each is
    left out, as by `block_means`; pixels that are not finite and negative ones count as 0.
    """
    width, columns, block = colour.shape[1], means.shape[2], side[0]
    light, total, brightest = np.empty(width), np.empty((2, columns)), np.empty((2, columns))
    for j in range(first, last):
        total[:], brightest[:] = 0.0, 0.0
        for row in range(block):
            light_of_row(colour[j * block + row].reshape(3 * width), light)
            add_blocks(light, block, total[row % 2], brightest[row % 2])
        for half in range(2):
            count = (block + 1 - half) // 2 * block
            for i in range(columns):
                means[half, j, i] = (total[half, i] - brightest[half, i]) / (count - 1)


@compiled
def pair_means(plane: np.ndarray, block: int, means: np.ndarray) -> None:
    """Means of two pairs of pixels of each whole block; plane (h, w, C) -> means (rows, columns, 2, C).

    Each pair lies on a diagonal, a quarter of the block from its corners. Means that are not finite become 0.
    """
    near = block // 4
    far = block - 1 - near
    for j in range(means.shape[0]):
        for i in range(means.shape[1]):
            for c in range(means.shape[3]):
                for pair in range(2):
                    left, right = (near, far) if pair == 0 else (far, near)
                    first = np.float64(plane[j * block + near, i * block + left, c])
                    mean = (first + np.float64(plane[j * block + far, i * block + right, c])) / 2
                    means[j, i, pair, c] = mean if abs(mean) < np.inf else 0.0


@compiled
def limit_depths(depth: np.ndarray, beyond: Real, least: Real) -> None:
    """Put flat depths from `beyond` on, and what is no number, at twice the farthest of the others; none is less than
    `least`."""
    farthest = least
    for i in range(depth.size):
        farthest = max(farthest, depth[i]) if depth[i] < beyond else farthest
    for i in range(depth.size):
        depth[i] = max(depth[i], least) if depth[i] < beyond else 2 * farthest


@compiled
def box_row(flat: np.ndarray, y: int, width: int, channels: int, line: np.ndarray, means: np.ndarray) -> None:
    """Mean over width x width cells around each cell of a row, edges repeated; flat rows (rows, columns * channels)."""
    rows, near, share = flat.shape[0], width // 2, 1.0 / (width * width)
    columns = means.size // channels
    inner = line[near * channels:(near + columns) * channels]
    inner[:] = 0.0
    for v in range(y - near, y + near + 1):
        add(flat[min(max(v, 0), rows - 1)], inner)
    for i in range(near * channels):
        line[i] = inner[i % channels]
        line[(near + columns) * channels + i] = inner[(columns - 1) * channels + i % channels]
    means[:] = 0.0
    for u in range(width):
        add(line[u * channels:], means)
    for i in range(means.size):
        means[i] *= share


@compiled
def band_of(planes: np.ndarray, narrow: int, wide: int, band: np.ndarray) -> None:
    """Mean over narrow x narrow cells less that over wide x wide ones, both odd; planes (rows, columns, channels) to
    the same."""
    rows, columns, channels = planes.shape
    flat, written = planes.reshape(rows, columns * channels), band.reshape(rows, columns * channels)
    line, means = np.empty((columns + wide) * channels), np.empty(columns * channels)
    for y in range(rows):
        box_row(flat, y, narrow, channels, line, written[y])
        box_row(flat, y, wide, channels, line, means)
        for i in range(means.size):
            written[y, i] -= means[i]


@vectorised
def products(a: np.ndarray, b: np.ndarray, mean_a: Real, mean_b: Real) -> tuple[Real, Real, Real]:
    """Sums of squares and of products of two channels without their means."""
    square_a = square_b = both = 0.0
    for i in range(a.size):
        x, y = a[i] - mean_a, b[i] - mean_b
        square_a, square_b, both = square_a + x * x, square_b + y * y, both + x * y
    return square_a, square_b, both


@compiled
def moments(a: np.ndarray, b: np.ndarray) -> tuple[Real, Real, Real]:
    """Mean square of two sets of cells (cells, channels) without the means of their channels, and mean product."""
    cells, channels = a.shape
    square_a = square_b = both = 0.0
    for c in range(channels):
        of_a, of_b = np.ascontiguousarray(a[:, c]), np.ascontiguousarray(b[:, c])
        found = products(of_a, of_b, of_a.sum() / cells, of_b.sum() / cells)
        square_a, square_b, both = square_a + found[0], square_b + found[1], both + found[2]
    count = cells * channels
    return square_a / count, square_b / count, both / count


@compiled
def mark_positive(plane: np.ndarray, side: int, cells: np.ndarray) -> None:
    """Set cells of side x side pixels in which a plane (h, w, 1) is positive anywhere."""
    for y in range(plane.shape[0]):
        for x in range(plane.shape[1]):
            if plane[y, x, 0] > 0:
                cells[y // side, x // side] = True


@compiled
def places_inside(motion: np.ndarray, x: np.ndarray, y: np.ndarray, cells: np.ndarray) -> int:
    """Cells (rows, columns) whose motion (rows, columns, 2) leads to a place between the outermost cells' centres.

    Returns how many; their places are put into x and y (rows * columns,), their numbers into `cells`.
    """
    rows, columns, count = motion.shape[0], motion.shape[1], 0
    for j in range(rows):
        for i in range(columns):
            across, down = i + motion[j, i, 0], j + motion[j, i, 1]
            if across >= 0 and across <= columns - 1 and down >= 0 and down <= rows - 1:
                x[count], y[count], cells[count] = across, down, j * columns + i
                count += 1
    return count


@compiled
def mix_places(plane: np.ndarray, x: np.ndarray, y: np.ndarray, mixed: np.ndarray) -> None:
    """Bilinear values (count, n) of a plane (rows, columns, n) at places inside."""
    rows, columns = plane.shape[:2]
    for p in range(x.size):
        left, top = min(int(x[p]), max(columns - 2, 0)), min(int(y[p]), max(rows - 2, 0))
        right, bottom = min(left + 1, columns - 1), min(top + 1, rows - 1)
        u, v = x[p] - left, y[p] - top
        for k in range(mixed.shape[1]):
            upper = plane[top, left, k] * (1 - u) + plane[top, right, k] * u
            lower = plane[bottom, left, k] * (1 - u) + plane[bottom, right, k] * u
            mixed[p, k] = upper * (1 - v) + lower * v


@compiled
def correlate(a: np.ndarray, b: np.ndarray, least_spread: Real) -> Real:
    """Pearson's correlation of (cells, channels), all channels together; NaN where one of the two hardly varies."""
    square_a, square_b, both = moments(a, b)
    spread_a, spread_b = np.sqrt(square_a), np.sqrt(square_b)
    return both / (spread_a * spread_b) if min(spread_a, spread_b) > least_spread else np.nan


@compiled
def reliability(halves: np.ndarray) -> Real:
    """Share of the variance of the mean of two halves (cells, 2, channels) that is not noise (Spearman-Brown)."""
    between = correlate(halves[:, 0], halves[:, 1], 0.0)
    return max(2 * between / (1 + between), 0.0) if between == between else 0.0


@compiled
def true_correlation(before: np.ndarray, now: np.ndarray, least_spread: Real, least_reliability: Real) -> Real:
    """Correlation of (cells, 2 halves, channels) as it would be without noise; NaN where there is little else."""
    raw = correlate((before[:, 0] + before[:, 1]) / 2, (now[:, 0] + now[:, 1]) / 2, least_spread)
    first, second = reliability(before), reliability(now)
    if not raw == raw or min(first, second) < least_reliability:
        return np.nan
    return raw / np.sqrt(first * second)


@compiled
def bounds_of_cells(plane: np.ndarray, side: int, low: np.ndarray, high: np.ndarray) -> None:
    """The lowest and highest value, 0 to 1, of a plane (h, w) in each cell of so many pixels along a side."""
    (h, w), (_, wide) = plane.shape, low.shape
    low[:], high[:] = np.float32(1), np.float32(0)
    for y in range(h):
        row, least, most = plane[y], low[y // side], high[y // side]
        for k in range(wide):
            for x in range(k * side, min((k + 1) * side, w)):
                least[k], most[k] = min(least[k], row[x]), max(most[k], row[x])


@inline
def is_hit(depth: Real, farthest: Real) -> Real:
    """1 for a depth above 0 and below the farthest, else 0."""
    return np.int32((depth > 0) & (depth < farthest))


@compiled
def coverage_noise(depth: np.ndarray, farthest: Real) -> Real:
    """Share of the pixels of depth (h, w) that are a hit where at least three of four neighbours are misses, or the
    other way round. Surfaces have next to none; of white noise it is up to 5/16. Every second row is looked at."""
    (h, w), noisy = depth.shape, 0
    for y in range(1, h - 1, 2):
        above, row, below = depth[y - 1], depth[y], depth[y + 1]
        for x in range(1, w - 1):
            around = (is_hit(above[x], farthest) + is_hit(below[x], farthest)
                      + is_hit(row[x - 1], farthest) + is_hit(row[x + 1], farthest))
            noisy += around <= 1 if is_hit(row[x], farthest) else around >= 3
    return noisy / max((h - 1) // 2 * (w - 2), 1)


LOOKED_AT = 128
"""Pixels along a side that are looked at for light outside the gamut, up to twice as many."""
OUTSIDE = 0.006
"""From this share of light outside the gamut on, it is worth denoising in wider primaries: they gained 0.7 dB at 0.008.
Below it are pixel filters with negative lobes, up to 0.005 by Lanczos, where they neither gain nor lose."""


def light_outside(colour: np.ndarray) -> float:
    """Share of the light of a picture (h, w, 3) that is negative and that wider primaries turn positive.

    Pixels count by their brightness up to that of the usual pixel, brighter ones no more, so that a few fireflies
    decide nothing. Grey light below 0, as pixel filters leave it beside bright edges, does not count, nor do pixels
    without any positive number.
    """
    down, right = (max(1, side // LOOKED_AT) for side in colour.shape[:2])
    pixels = colour[::down, ::right].reshape(-1, 3)
    if not (pixels < 0).any():
        return 0.0
    pixels = pixels[np.isfinite(pixels).all(1)].astype(np.float64)
    brightest = np.abs(pixels).max(1, initial=0.0)
    lit = brightest > 0
    seen = pixels[lit] / (np.exp(np.log(brightest[lit]).mean()) + brightest[lit])[:, None] if lit.any() else pixels
    mixed = seen[seen.max(1, initial=-1.0) > 0]
    gained = np.minimum(mixed @ WIDER.T, 0).sum() - np.minimum(mixed, 0).sum()
    return float(gained / max(np.abs(seen).sum(), 1e-12))


@summed
def sum_of_nothing(flat: np.ndarray) -> Real:
    """0, or NaN if a number is not finite."""
    total = np.float32(0)
    for i in range(flat.size):
        total += flat[i] * np.float32(0)
    return total


@compiled
def is_finite(flat: np.ndarray) -> bool:
    """Whether all numbers are finite."""
    return bool(sum_of_nothing(flat) == 0)


@compiled
def is_blank(bits: np.ndarray) -> bool:
    """Whether all numbers of float32 with these bits, flat uint32, are 0."""
    found = np.uint32(0)
    for first in range(0, bits.size, PIECE):
        for i in range(first, min(first + PIECE, bits.size)):
            found |= bits[i] & np.uint32(0x7FFFFFFF)
        if found:
            return False
    return True


@compiled
def is_same_plane(one: np.ndarray, other: np.ndarray) -> bool:
    """Whether all numbers are the same, or NaN in both."""
    for i in range(one.size):
        if one[i] != other[i] and (one[i] == one[i] or other[i] == other[i]):
            return False
    return True
