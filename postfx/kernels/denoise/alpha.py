"""Kernels of alpha: means of its samples over the frames, and filtered alpha that is brought nearer to them.

The picture's filters blur hairs that are thinner than a pixel, where alpha itself has no noise but that of which
samples hit. So beside filtered alpha there is a mean of the frames' own alpha, by quarter-pixels: where things move by
parts of a pixel, frames add up to more than one frame shows (Irani and Peleg 1991, "Improving resolution by image
registration"). It is a Kalman filter: ``samples`` (2h, 2w, 1) are moved to where things are now, a frame's alpha says
what their means over pixels lack, and ``doubt`` (h, w, 1) is the variance of these in units of alpha (1 - alpha).
Filtered alpha has a variance, too, that of its blur. Both are mixed as their variances say, as far as filtered alpha
has structure: on soft edges, what differs is noise.
"""

import numpy as np

from postfx.kernels.denoise import kernel
from postfx.kernels.denoise.history import cubic
from postfx.kernels.numeric import (
    Four,
    Real,
    add_eight,
    centre,
    clamp,
    compiled,
    fused,
    inline,
    load_eight,
)

ZERO, QUARTER, HALF, ONE = np.float32(0), np.float32(0.25), np.float32(0.5), np.float32(1)
SIX, NINE = np.float32(6), np.float32(9)
KEEP, VARIANCE, DRIFT, LEAST = range(4)
"""Of ``rates``: whether there is a past; then variances in units of alpha (1 - alpha): of a frame's alpha, and what a
move adds to that of the mean; and the smallest share that a frame's alpha has in the mean."""
EXACT, NOISE, SHARPER = range(3)
"""Of ``gain``: variance of filtered alpha in those units, 0 where samples count for nothing; of its structure that is
as likely noise; and how much of what differs from the pixels around is added."""
LEAST_MOTION, FAINTEST = np.float32(1 / 64), np.float32(1e-6)
"""Render pixels that count as motion, and the smallest variance that is structure."""
PLANE, SLOPED = np.float32(2 / 3), np.float32(1 / 8)
"""Variance in 3x3 pixels of a plane that rises by 1 a pixel, and how much of it counts as structure."""
LIMIT_OFF, LEAST_OFF = np.float32(9), np.float32(4e-4)
"""Squares: standard deviations, and alpha, by which 3x3 pixels may differ from what was there before."""
SIDE, MIDDLE = np.float32(0.27406862), np.float32(0.45186276)
"""Weights of three pixels by a Gaussian of one pixel."""
QUARTERS = ("2*h", "2*w", 1)


@fused
def quarters(start: int, line: int, wx: Four, wy: Four, flat: np.ndarray) -> Four:
    """The four quarter-pixels of a pixel, bicubic, from 5x5 numbers of a flat picture from a place on; three more are
    read in each row."""
    zeros = (ZERO, ZERO, ZERO, ZERO, ZERO, ZERO, ZERO, ZERO)
    (x0, x1, x2, x3), (y0, y1, y2, y3) = wx, wy
    first, second = load_eight(flat, start), load_eight(flat, start + line)
    third, fourth = load_eight(flat, start + line + line), load_eight(flat, start + line + line + line)
    upper = add_eight(add_eight(add_eight(add_eight(zeros, first, y0), second, y1), third, y2), fourth, y3)
    last = load_eight(flat, start + line + line + line + line)
    lower = add_eight(add_eight(add_eight(add_eight(zeros, second, y0), third, y1), fourth, y2), last, y3)
    a, b, c, d, e, _, _, _ = upper
    f, g, h, i, j, _, _, _ = lower
    return (a * x0 + b * x1 + c * x2 + d * x3, b * x0 + c * x1 + d * x2 + e * x3,
            f * x0 + g * x1 + h * x2 + i * x3, g * x0 + h * x1 + i * x2 + j * x3)


@compiled
def edge_quarter(top: int, left: int, wx: Four, wy: Four, samples: np.ndarray) -> Real:
    """One quarter-pixel near the picture's edge, which is repeated."""
    height, width = samples.shape[:2]
    total = ZERO
    for j in range(4):
        row, line = min(max(top + j, 0), height - 1), ZERO
        for i in range(4):
            line += samples[row, min(max(left + i, 0), width - 1), 0] * wx[i]
        total += line * wy[j]
    return total


@fused
def predict_row(y: int, part: np.ndarray, moved: np.ndarray, samples: np.ndarray, doubt: np.ndarray,
                rates: np.ndarray, predicted: np.ndarray, off: np.ndarray, variance: np.ndarray) -> None:
    """What a row's samples were before, by quarter-pixels (w, 4), what the frame's alpha adds to their means (w,), and
    the variance of these (w,), -1 where they are not known."""
    (h, w), (height, width) = part.shape[:2], samples.shape[:2]
    flat, line, known = samples.reshape(samples.size), np.uint64(width), rates[KEEP] > ZERO
    right, bottom, drift = np.float32(w) - HALF, np.float32(h) - HALF, rates[DRIFT]
    for x in range(w):
        own = clamp(part[y, x, 0], ZERO, ONE)
        across, down = moved[y, x, 0], moved[y, x, 1]
        at_x, at_y = np.float32(x) + across, np.float32(y) + down
        if not (known and -HALF <= at_x <= right and -HALF <= at_y <= bottom):
            off[x], variance[x] = ZERO, -ONE
            predicted[x, 0] = predicted[x, 1] = predicted[x, 2] = predicted[x, 3] = own
            continue
        near_x = min(max(np.int32(np.floor(at_x + HALF)), 0), w - 1)
        near_y = min(max(np.int32(np.floor(at_y + HALF)), 0), h - 1)
        variance[x] = doubt[near_y, near_x, 0]
        far_x, far_y = np.floor(across + across), np.floor(down + down)
        wx, wy = cubic(across + across - far_x), cubic(down + down - far_y)
        left, top = 2 * x + np.int32(far_x) - 1, 2 * y + np.int32(far_y) - 1
        if 0 <= left <= width - 8 and 0 <= top <= height - 5:
            a, b, c, d = quarters(np.uint64(top * width + left), line, wx, wy, flat)
        else:
            a, b = edge_quarter(top, left, wx, wy, samples), edge_quarter(top, left + 1, wx, wy, samples)
            c, d = edge_quarter(top + 1, left, wx, wy, samples), edge_quarter(top + 1, left + 1, wx, wy, samples)
        predicted[x, 0], predicted[x, 1], predicted[x, 2], predicted[x, 3] = a, b, c, d
        variance[x] += drift if abs(across) >= LEAST_MOTION or abs(down) >= LEAST_MOTION else ZERO
        off[x] = own - (a + b + c + d) * QUARTER


@fused
def three_sums(above: np.ndarray, here: np.ndarray, below: np.ndarray, sums: np.ndarray) -> None:
    """Sums of 3x3 pixels along a row, edge repeated."""
    w = sums.size
    for x in range(w):
        sums[x] = above[x] + here[x] + below[x]
    left = sums[0]
    for x in range(w):
        middle, right = sums[x], sums[min(x + 1, w - 1)]
        sums[x] = left + middle + right
        left = middle


@fused
def update_row(own: np.ndarray, apart: np.ndarray, level: np.ndarray, predicted: np.ndarray, off: np.ndarray,
               variance: np.ndarray, rates: np.ndarray, upper: np.ndarray, lower: np.ndarray,
               doubt: np.ndarray) -> None:
    """A row of next samples, in two rows of quarter-pixels, and of next doubt; ``apart`` and ``level`` are sums over
    3x3 pixels of ``off`` and of alpha."""
    frame, least = rates[VARIANCE], rates[LEAST]
    for x in range(own.size):
        known, differs = variance[x], apart[x] / NINE
        mean = clamp((level[x] - HALF * apart[x]) / NINE, ZERO, ONE)
        chance = mean * (ONE - mean) * (frame + min(known, ONE)) / NINE
        lost = known < ZERO or differs * differs > LIMIT_OFF * chance + LEAST_OFF
        share = max(known / (known + frame), least)
        step = off[x] * share
        upper[2 * x] = own[x] if lost else clamp(predicted[x, 0] + step, ZERO, ONE)
        upper[2 * x + 1] = own[x] if lost else clamp(predicted[x, 1] + step, ZERO, ONE)
        lower[2 * x] = own[x] if lost else clamp(predicted[x, 2] + step, ZERO, ONE)
        lower[2 * x + 1] = own[x] if lost else clamp(predicted[x, 3] + step, ZERO, ONE)
        doubt[x] = frame if lost else min((ONE - share) * known, frame)


@compiled
def gather_rows(y0: int, y1: int, part: np.ndarray, moved: np.ndarray, samples: np.ndarray, doubt: np.ndarray,
                rates: np.ndarray, next_samples: np.ndarray, next_doubt: np.ndarray) -> None:
    """Means of alpha by quarter-pixels over all frames, and their variance: a Kalman filter of the frames' means over
    pixels. It begins anew where 3x3 pixels differ by more than chance would have it."""
    h, w = part.shape[:2]
    predicted, planes = np.empty((3, w, 4), np.float32), np.empty((3, 3, w), np.float32)
    apart, level = np.empty(w, np.float32), np.empty(w, np.float32)
    for y in range(y0 - 1, y1 + 1):
        at, row = y % 3, min(max(y, 0), h - 1)
        for x in range(w):
            planes[0, at, x] = clamp(part[row, x, 0], ZERO, ONE)
        predict_row(row, part, moved, samples, doubt, rates, predicted[at], planes[1, at], planes[2, at])
        if y <= y0:
            continue
        before, at = (y - 2) % 3, (y - 1) % 3
        three_sums(planes[1, before], planes[1, at], planes[1, y % 3], apart)
        three_sums(planes[0, before], planes[0, at], planes[0, y % 3], level)
        update_row(planes[0, at], apart, level, predicted[at], planes[1, at], planes[2, at], rates,
                   next_samples[2 * (y - 1), :, 0], next_samples[2 * (y - 1) + 1, :, 0], next_doubt[y - 1, :, 0])


@inline
def first_within(at: int, size: int, out: int) -> int:
    """The first of ``out`` pixels whose centre lies in pixel ``at`` of ``size``."""
    return (2 * out * at + size - 1) // (2 * size)


@compiled
def mean_within(filtered: np.ndarray, at: int, first: np.ndarray, mean: np.ndarray) -> None:
    """Mean of the output's pixels in each render pixel of a row, edge repeated; ``first`` (2, n) are the rows and
    columns where render pixels begin."""
    top, bottom = first[0, at], first[0, at + 1]
    for x in range(mean.size - 2):
        total, left, right = ZERO, first[1, x], first[1, x + 1]
        for row in range(top, bottom):
            for column in range(left, right):
                total += filtered[row, column, 0]
        mean[x + 1] = total / np.float32((bottom - top) * (right - left))
    mean[0], mean[-1] = mean[1], mean[-2]


@fused
def lacking_row(above: np.ndarray, here: np.ndarray, below: np.ndarray, own: np.ndarray, doubt: np.ndarray,
                gain: np.ndarray, sums: np.ndarray, found: np.ndarray) -> None:
    """Along a row: how much of the variance of filtered alpha is structure, how much the samples' mean counts beside
    it, and what alpha lacks of that, also times the weight: ``found`` (4, w). Three rows of filtered alpha (w + 2,),
    edge repeated; ``own`` is the samples' mean; ``sums`` (3, w + 2)."""
    total, squares, steps = sums[0], sums[1], sums[2]
    exact, noise = gain[EXACT], gain[NOISE]
    for x in range(total.size):
        a, b, c = above[x], here[x], below[x]
        total[x], squares[x], steps[x] = a + b + c, a * a + b * b + c * c, c - a
    for x in range(own.size):
        across, down = (total[x + 2] - total[x]) / SIX, (steps[x] + steps[x + 1] + steps[x + 2]) / SIX
        mean = (total[x] + total[x + 1] + total[x + 2]) / NINE
        sloped = (ONE - SLOPED) * PLANE * (across * across + down * down)
        varied = max((squares[x] + squares[x + 1] + squares[x + 2]) / NINE - mean * mean - sloped, ZERO)
        structure = varied / (varied + noise * max(mean * (ONE - mean), ZERO) + FAINTEST)
        weight, lack = structure * exact / (exact + doubt[x] + FAINTEST), own[x] - here[x + 1]
        found[0, x], found[1, x], found[2, x], found[3, x] = structure, weight, lack, weight * lack


@inline
def beside(position: int, size: int, out: int) -> tuple[int, int, Real]:
    """The two of ``size`` pixels between whose centres one of ``out`` has its own, and the second one's share."""
    at, offset = centre(position, size, out)
    first = at - 1 if offset < ZERO else at
    share = offset + ONE if offset < ZERO else offset
    return max(first, 0), min(first + 1, size - 1), np.float32(share)


@fused
def soft_row(above: np.ndarray, here: np.ndarray, below: np.ndarray, line: np.ndarray, soft: np.ndarray) -> None:
    """A row softened by a Gaussian; all but ``soft`` with the edge repeated."""
    for x in range(line.size):
        line[x] = SIDE * (above[x] + below[x]) + MIDDLE * here[x]
    for x in range(soft.size):
        soft[x] = SIDE * (line[x] + line[x + 2]) + MIDDLE * line[x + 1]


@compiled
def planar_row(filtered: np.ndarray, row: np.ndarray) -> None:
    """The first channel of a row, edge repeated."""
    for x in range(filtered.shape[0]):
        row[x + 1] = filtered[x, 0]
    row[0], row[-1] = row[1], row[-2]


@fused
def mix_rows(upper: np.ndarray, lower: np.ndarray, share: Real, mixed: np.ndarray) -> None:
    for x in range(mixed.size):
        mixed[x] = upper[x] + (lower[x] - upper[x]) * share


@fused
def mix_beside(row: np.ndarray, places: np.ndarray, share: np.ndarray, mixed: np.ndarray) -> None:
    """A row at other places: between ``places`` (2, n)."""
    for x in range(mixed.size):
        first = row[places[0, x]]
        mixed[x] = first + (row[places[1, x]] - first) * share[x]


@fused
def correct_row(here: np.ndarray, soft: np.ndarray, found: np.ndarray, owner: np.ndarray, lack: np.ndarray,
                inside: np.ndarray, sharper: Real, corrected: np.ndarray) -> None:
    """A row of corrected alpha; ``owner`` says which of the render pixels of ``found`` (5, w) an output pixel is in."""
    for x in range(owner.size):
        value, own = here[x + 1], owner[x]
        inner = found[4, own] * (inside[x] - value - found[2, own])
        result = clamp(value + lack[x] + inner + sharper * found[0, own] * (value - soft[x]), ZERO, ONE)
        corrected[x, 0] = corrected[x, 1] = corrected[x, 2] = result


@compiled
def correct_rows(y0: int, y1: int, filtered: np.ndarray, next_samples: np.ndarray, next_doubt: np.ndarray,
                 moved: np.ndarray, gain: np.ndarray, corrected: np.ndarray) -> None:
    """Alpha, three times: filtered, sharper, and nearer to the mean of samples. Where nothing moves these know
    nothing of a pixel's inside."""
    (h, w), (height, width) = next_doubt.shape[:2], corrected.shape[:2]
    means, sums = np.empty((4, w + 2), np.float32), np.empty((3, w + 2), np.float32)
    lines = np.empty((3, width + 2), np.float32)
    rows, held, done = np.zeros((2, 5, w), np.float32), np.full(4, -1, np.int64), np.full(2, -1, np.int64)
    starts, owner = np.empty((2, max(h, w) + 1), np.int64), np.empty(width, np.int32)
    places, shares = np.empty((4, width), np.int32), np.empty((2, width), np.float32)
    line, own, lacks = np.empty(2 * w, np.float32), np.empty(w, np.float32), np.empty(w, np.float32)
    inside, lack, soft = np.empty(width, np.float32), np.empty(width, np.float32), np.empty(width, np.float32)
    softer = np.empty(width + 2, np.float32)
    for y in range(h + 1):
        starts[0, y] = first_within(y, h, height)
    for x in range(w + 1):
        starts[1, x] = first_within(x, w, width)
    for x in range(width):
        owner[x] = centre(x, w, width)[0]
        places[0, x], places[1, x], shares[0, x] = beside(x, w, width)
        places[2, x], places[3, x], shares[1, x] = beside(x, 2 * w, width)
    for y in range(y0, y1):
        for row in range(y - 1 if y == y0 else y + 1, y + 2):
            planar_row(filtered[min(max(row, 0), height - 1)], lines[row % 3])
        first, second, down = beside(y, h, height)
        for at in (first, second):
            if done[at % 2] == at:
                continue
            for row in range(max(at - 1, 0), min(at + 1, h - 1) + 1):
                if held[row % 4] != row:
                    mean_within(filtered, row, starts, means[row % 4])
                    held[row % 4] = row
            found = rows[at % 2]
            for x in range(w):
                own[x] = QUARTER * (next_samples[2 * at, 2 * x, 0] + next_samples[2 * at, 2 * x + 1, 0]
                                    + next_samples[2 * at + 1, 2 * x, 0] + next_samples[2 * at + 1, 2 * x + 1, 0])
            lacking_row(means[max(at - 1, 0) % 4], means[at % 4], means[min(at + 1, h - 1) % 4], own,
                        next_doubt[at, :, 0], gain, sums, found)
            for x in range(w):
                moves = abs(moved[at, x, 0]) >= LEAST_MOTION or abs(moved[at, x, 1]) >= LEAST_MOTION
                found[4, x] = found[1, x] if moves else ZERO
            done[at % 2] = at
        mix_rows(rows[first % 2, 3], rows[second % 2, 3], down, lacks)
        mix_beside(lacks, places[:2], shares[0], lack)
        upper, lower, down = beside(y, 2 * h, height)
        mix_rows(next_samples[upper, :, 0], next_samples[lower, :, 0], down, line)
        mix_beside(line, places[2:], shares[1], inside)
        soft_row(lines[(y - 1) % 3], lines[y % 3], lines[(y + 1) % 3], softer, soft)
        correct_row(lines[y % 3], soft, rows[centre(y, h, height)[0] % 2], owner, lack, inside, gain[SHARPER],
                    corrected[y])


GATHER = kernel("gather", ("part", "moved", "samples", "doubt", "rates"), ("next_samples", "next_doubt"), gather_rows,
                ("next_doubt", 0), part=("h", "w", 3), moved=("h", "w", 2), samples=QUARTERS, doubt=("h", "w", 1),
                rates=(4,), next_samples=QUARTERS, next_doubt=("h", "w", 1))
CORRECT = kernel("correct", ("filtered", "next_samples", "next_doubt", "moved", "gain"), ("corrected",), correct_rows,
                 ("corrected", 0), filtered=("height", "width", 3), next_samples=QUARTERS, next_doubt=("h", "w", 1),
                 moved=("h", "w", 2), gain=(3,), corrected=("height", "width", 3))
