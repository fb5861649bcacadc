"""Kernels of alpha: means of its samples over the frames, and filtered alpha that is brought nearer to them.

The picture's filters blur hairs that are thinner than a pixel, where alpha itself has no noise but that of which
samples hit. So beside filtered alpha there is a mean of the frames' own alpha, by quarter-pixels: where things move by
parts of a pixel, frames add up to more than one frame shows (Irani and Peleg 1991, "Improving resolution by image
registration"). It is a Kalman filter: ``samples`` (2h, 2w, 1) are moved to where things are now, a frame's alpha says
what their means over pixels lack, and ``doubt`` (h, w, 1) is the variance of these in units of alpha (1 - alpha).
Filtered alpha has a variance, too, that of its blur. Both are mixed as their variances say, as far as filtered alpha
has structure: on soft edges, what differs is noise. At last alpha comes nearer to what the picture's colours say of it:
the mean of samples fitted by colours in 3x3 pixels, applied to the output's colours (He, Sun and Tang 2010, "Guided
image filtering"), so that alpha has the edges that colours have.

Where alpha is 0 or 1 all around, nothing of this is needed: ``near`` (cells, cells) is 2 in cells of render pixels that
are worked on, 1 in those around them, which these read, and 0 elsewhere.
"""

import numpy as np

from postfx.kernels.denoise import NEAR_CELL, kernel
from postfx.kernels.numeric import (
    Four,
    Real,
    add_eight,
    centre,
    clamp,
    compiled,
    fused,
    fused_inline,
    inline,
    load_eight,
)

ZERO, QUARTER, HALF, ONE, TWO = np.float32(0), np.float32(0.25), np.float32(0.5), np.float32(1), np.float32(2)
SIX, NINE, NINTH, LARGE = np.float32(6), np.float32(9), np.float32(1 / 9), np.float32(1e30)
KEEP, VARIANCE, DRIFT, LEAST = range(4)
"""Of ``rates``: whether there is a past; then variances in units of alpha (1 - alpha): of a frame's alpha, and what a
move adds to that of the mean; and the smallest share that a frame's alpha has in the mean."""
EXACT, NOISE, SHARPER, FITTED = range(4)
"""Of ``gain``: variance of filtered alpha in those units, 0 where samples count for nothing; of its structure that is
as likely noise; how much of what differs from the pixels around is added; and how much alpha by colours counts."""
ALIKE, DARK = np.float32(3e-5), np.float32(1e-20)
"""Variance that colours are taken to have in any direction, as a share of their mean square, and beside it."""
LEAST_MOTION, FAINTEST = np.float32(1 / 64), np.float32(1e-6)
"""Render pixels that count as motion, and the smallest variance that is structure."""
PLANE, SLOPED = np.float32(2 / 3), np.float32(1 / 8)
"""Variance in 3x3 pixels of a plane that rises by 1 a pixel, and how much of it counts as structure."""
LIMIT_OFF, LEAST_OFF = np.float32(9), np.float32(4e-4)
"""Squares: standard deviations, and alpha, by which 3x3 pixels may differ from what was there before."""
SIDE, MIDDLE = np.float32(0.27406862), np.float32(0.45186276)
"""Weights of three pixels by a Gaussian of one pixel."""
QUARTERS, NEAR = ("2*h", "2*w", 1), ("near_h", "near_w")


@fused_inline
def cubic(t: Real) -> tuple[Real, Real, Real, Real]:
    """The four weights of cubic convolution with a = -0.75, the ONNX GridSample and OpenCV default."""
    a = np.float32(-0.75)
    u, v, s = t + ONE, ONE - t, np.float32(2) - t
    return (((a * u - 5 * a) * u + 8 * a) * u - 4 * a, ((a + 2) * t - (a + 3)) * t * t + ONE,
            ((a + 2) * v - (a + 3)) * v * v + ONE, ((a * s - 5 * a) * s + 8 * a) * s - 4 * a)


@compiled
def spans_of(cells: np.ndarray, w: int, least: Real, found: np.ndarray) -> int:
    """Runs of pixels along a row whose cells are at least so near: first pixels and ends ``found`` (n, 2), and how
    many; the last cell goes on to the end of the row."""
    count, before = 0, False
    for k in range(cells.size):
        if cells[k] >= least:
            count += 0 if before else 1
            if not before:
                found[count - 1, 0] = k * NEAR_CELL
            found[count - 1, 1] = w if k + 1 == cells.size else min((k + 1) * NEAR_CELL, w)
        before = cells[k] >= least
    return count


@inline
def cell_of(y: int, near: np.ndarray) -> int:
    """The row of cells that a row of render pixels is in."""
    return int(min(max(y, 0) // NEAR_CELL, near.shape[0] - 1))


@compiled
def spans_around(y: int, w: int, near: np.ndarray, found: np.ndarray) -> int:
    """The same for pixels that rows above, at and below row y read."""
    above, here, below = near[cell_of(y - 1, near)], near[cell_of(y, near)], near[cell_of(y + 1, near)]
    return int(spans_of(np.maximum(np.maximum(above, here), below), w, ONE, found))


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
def predict_row(y: int, x0: int, x1: int, alpha: np.ndarray, moved: np.ndarray, samples: np.ndarray, doubt: np.ndarray,
                rates: np.ndarray, predicted: np.ndarray, off: np.ndarray, variance: np.ndarray) -> None:
    """What samples in a span of a row were before, by quarter-pixels (w, 4), what the frame's alpha adds to their means
    (w,), and the variance of these (w,), -1 where they are not known."""
    (h, w), (height, width) = alpha.shape[:2], samples.shape[:2]
    flat, line, known = samples.reshape(samples.size), np.uint64(width), rates[KEEP] > ZERO
    right, bottom, drift = np.float32(w) - HALF, np.float32(h) - HALF, rates[DRIFT]
    for x in range(x0, x1):
        own = clamp(alpha[y, x, 0], ZERO, ONE)
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
def update_row(x0: int, x1: int, own: np.ndarray, apart: np.ndarray, level: np.ndarray, predicted: np.ndarray,
               off: np.ndarray, variance: np.ndarray, rates: np.ndarray, upper: np.ndarray, lower: np.ndarray,
               doubt: np.ndarray) -> None:
    """A span of a row of next samples, in two rows of quarter-pixels, and of next doubt; ``apart`` and ``level`` are
    sums over 3x3 pixels of ``off`` and of alpha."""
    frame, least = rates[VARIANCE], rates[LEAST]
    for x in range(x0, x1):
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


@fused
def begin_row(own: np.ndarray, frame: Real, upper: np.ndarray, lower: np.ndarray, doubt: np.ndarray) -> None:
    """A row of next samples and next doubt of which nothing is known but this frame's alpha."""
    for x in range(own.size):
        upper[2 * x] = upper[2 * x + 1] = lower[2 * x] = lower[2 * x + 1] = own[x]
        doubt[x] = frame


@compiled
def gather_rows(y0: int, y1: int, alpha: np.ndarray, moved: np.ndarray, samples: np.ndarray, doubt: np.ndarray,
                near: np.ndarray, rates: np.ndarray, next_samples: np.ndarray, next_doubt: np.ndarray) -> None:
    """Means of alpha by quarter-pixels over all frames, and their variance: a Kalman filter of the frames' means over
    pixels. It begins anew where 3x3 pixels differ by more than chance would have it."""
    h, w = alpha.shape[:2]
    predicted, planes = np.empty((3, w, 4), np.float32), np.empty((3, 3, w), np.float32)
    apart, level, spans = np.empty(w, np.float32), np.empty(w, np.float32), np.empty((near.shape[1], 2), np.int64)
    for y in range(y0 - 1, y1 + 1):
        at, row = y % 3, min(max(y, 0), h - 1)
        planes[1, at], planes[2, at] = ZERO, -ONE
        for x in range(w):
            planes[0, at, x] = clamp(alpha[row, x, 0], ZERO, ONE)
        for k in range(spans_of(near[cell_of(row, near)], w, ONE, spans)):
            predict_row(row, spans[k, 0], spans[k, 1], alpha, moved, samples, doubt, rates, predicted[at],
                        planes[1, at], planes[2, at])
        if y <= y0:
            continue
        before, at, to = (y - 2) % 3, (y - 1) % 3, 2 * (y - 1)
        begin_row(planes[0, at], rates[VARIANCE], next_samples[to, :, 0], next_samples[to + 1, :, 0],
                  next_doubt[y - 1, :, 0])
        count = spans_of(near[cell_of(y - 1, near)], w, ONE, spans)
        if count:
            three_sums(planes[1, before], planes[1, at], planes[1, y % 3], apart)
            three_sums(planes[0, before], planes[0, at], planes[0, y % 3], level)
        for k in range(count):
            update_row(spans[k, 0], spans[k, 1], planes[0, at], apart, level, predicted[at], planes[1, at],
                       planes[2, at], rates, next_samples[to, :, 0], next_samples[to + 1, :, 0],
                       next_doubt[y - 1, :, 0])


@inline
def pixel_mean(at: int, x: int, samples: np.ndarray) -> Real:
    """Mean of a pixel's samples."""
    return QUARTER * (samples[2 * at, 2 * x, 0] + samples[2 * at, 2 * x + 1, 0]
                      + samples[2 * at + 1, 2 * x, 0] + samples[2 * at + 1, 2 * x + 1, 0])


@inline
def first_within(at: int, size: int, out: int) -> int:
    """The first of ``out`` pixels whose centre lies in pixel ``at`` of ``size``."""
    return (2 * out * at + size - 1) // (2 * size)


@compiled
def mean_within(filtered: np.ndarray, channel: int, at: int, x0: int, x1: int, first: np.ndarray,
                mean: np.ndarray) -> None:
    """Mean of the output's pixels in each render pixel of a span of a row and beside it, edge repeated; ``first``
    (2, n) are the rows and columns where render pixels begin."""
    top, bottom = first[0, at], first[0, at + 1]
    for x in range(max(x0 - 1, 0), min(x1 + 1, mean.size - 2)):
        total, left, right = ZERO, first[1, x], first[1, x + 1]
        for row in range(top, bottom):
            for column in range(left, right):
                total += filtered[row, column, channel]
        mean[x + 1] = total / np.float32((bottom - top) * (right - left))
    mean[0], mean[-1] = mean[1], mean[-2]


@inline
def first_places(size: tuple[int, int], out: tuple[int, int]) -> np.ndarray:
    """The rows and columns of the output where render pixels begin, behind the last one the output's size."""
    starts = np.empty((2, max(size) + 1), np.int64)
    for axis in range(2):
        for at in range(size[axis] + 1):
            starts[axis, at] = first_within(at, size[axis], out[axis])
    return starts


@fused
def mean_row(x0: int, x1: int, rows: np.ndarray, sums: np.ndarray) -> None:
    """Means of 3x3 pixels in a span of three rows (3, 4, w + 2), edge repeated; the rows' order does not matter."""
    for c in range(4):
        a, b, d = rows[0, c], rows[1, c], rows[2, c]
        for x in range(x0, x1):
            upper, middle = a[x] + a[x + 1] + a[x + 2], b[x] + b[x + 1] + b[x + 2]
            sums[c, x] = (upper + middle + d[x] + d[x + 1] + d[x + 2]) / NINE


@fused
def joint_row(x0: int, x1: int, row: np.ndarray, sums: np.ndarray) -> None:
    """Adds, for three pixels of a row each, products of what colours and alpha differ from the means: ``sums`` (13, w)
    are the four means, rr, rg, rb, gg, gb, bb, and ra, ga, ba."""
    for x in range(x0, x1):
        red, green, blue, alpha = sums[0, x], sums[1, x], sums[2, x], sums[3, x]
        rr = rg = rb = gg = gb = bb = ra = ga = ba = ZERO
        for i in range(3):
            r, g, b, a = row[0, x + i] - red, row[1, x + i] - green, row[2, x + i] - blue, row[3, x + i] - alpha
            rr, rg, rb, ra = rr + r * r, rg + r * g, rb + r * b, ra + r * a
            gg, gb, ga, bb, ba = gg + g * g, gb + g * b, ga + g * a, bb + b * b, ba + b * a
        sums[4, x], sums[5, x], sums[6, x] = sums[4, x] + rr, sums[5, x] + rg, sums[6, x] + rb
        sums[7, x], sums[8, x], sums[9, x] = sums[7, x] + gg, sums[8, x] + gb, sums[9, x] + bb
        sums[10, x], sums[11, x], sums[12, x] = sums[10, x] + ra, sums[11, x] + ga, sums[12, x] + ba


@fused
def fit_row(x0: int, x1: int, sums: np.ndarray, red: np.ndarray, green: np.ndarray, blue: np.ndarray,
            rest: np.ndarray) -> None:
    """In a span of a row, the factors of red, green and blue and the rest that give alpha by least squares, from those
    sums. By Cholesky's way, with no variance below the least."""
    for x in range(x0, x1):
        r, g, b, rr, gg, bb = sums[0, x], sums[1, x], sums[2, x], sums[4, x], sums[7, x], sums[9, x]
        rg, rb, gb, ra = sums[5, x], sums[6, x], sums[8, x], sums[10, x]
        least = ALIKE * (rr + gg + bb + NINE * (r * r + g * g + b * b)) + DARK
        first = rr + least
        by_green, by_blue = rg / first, rb / first
        second = max(gg + least - by_green * rg, least)
        left = gb - by_green * rb
        third = max(bb + least - by_blue * rb - left / second * left, least)
        rest_green = sums[11, x] - by_green * ra
        to_blue = (sums[12, x] - by_blue * ra - left / second * rest_green) / third
        to_green = (rest_green - left * to_blue) / second
        to_red = ra / first - by_green * to_green - by_blue * to_blue
        known = abs(to_red) + abs(to_green) + abs(to_blue) < LARGE
        red[x], green[x], blue[x] = to_red if known else ZERO, to_green if known else ZERO, to_blue if known else ZERO
        rest[x] = sums[3, x] - (to_red * r + to_green * g + to_blue * b if known else ZERO)


@compiled
def fit_rows(y0: int, y1: int, picture: np.ndarray, next_samples: np.ndarray, near: np.ndarray,
             fit: np.ndarray) -> None:
    """Alpha by colours: the factors of red, green and blue and the rest, ``fit`` (4, h, w), in 3x3 pixels; 0 where
    there is nothing near."""
    (h, w), (height, width) = fit.shape[1:], picture.shape[:2]
    rows, starts = np.zeros((3, 4, w + 2), np.float32), first_places((h, w), (height, width))
    spans, sums = np.empty((near.shape[1], 2), np.int64), np.empty((13, w), np.float32)
    for y in range(y0 - 1, y1 + 1):
        at, row = min(max(y, 0), h - 1), rows[y % 3]
        for k in range(spans_around(y, w, near, spans)):
            x0, x1 = spans[k]
            for c in range(3):
                mean_within(picture, c, at, x0, x1, starts, row[c])
            for x in range(max(x0 - 1, 0), min(x1 + 1, w)):
                row[3, x + 1] = pixel_mean(at, x, next_samples)
        row[3, 0], row[3, -1] = row[3, 1], row[3, -2]
        if y > y0:
            to = y - 1
            fit[:, to] = ZERO
            for k in range(spans_of(near[cell_of(to, near)], w, ONE, spans)):
                x0, x1 = spans[k]
                mean_row(x0, x1, rows, sums)
                sums[4:, x0:x1] = ZERO
                for j in range(3):
                    joint_row(x0, x1, rows[j], sums)
                fit_row(x0, x1, sums, fit[0, to], fit[1, to], fit[2, to], fit[3, to])


@fused
def lacking_row(x0: int, x1: int, above: np.ndarray, here: np.ndarray, below: np.ndarray, own: np.ndarray,
                doubt: np.ndarray, gain: np.ndarray, sums: np.ndarray, found: np.ndarray) -> None:
    """In a span of a row: how much of the variance of filtered alpha is structure, how much the samples' mean counts
    beside it, and what alpha lacks of that, also times the weight: ``found`` (4, w). Three rows of filtered alpha
    (w + 2,), edge repeated; ``own`` is the samples' mean; ``sums`` (3, w + 2)."""
    total, squares, steps = sums[0], sums[1], sums[2]
    exact, noise = gain[EXACT], gain[NOISE]
    for x in range(x0, x1 + 2):
        a, b, c = above[x], here[x], below[x]
        total[x], squares[x], steps[x] = a + b + c, a * a + b * b + c * c, c - a
    for x in range(x0, x1):
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
    """A row, edge repeated."""
    for x in range(filtered.shape[0]):
        row[x + 1] = filtered[x, 0]
    row[0], row[-1] = row[1], row[-2]


@fused
def mix_rows(upper: np.ndarray, lower: np.ndarray, share: Real, mixed: np.ndarray) -> None:
    for x in range(mixed.size):
        mixed[x] = upper[x] + (lower[x] - upper[x]) * share


@fused
def mix_beside(row: np.ndarray, left: np.ndarray, right: np.ndarray, share: np.ndarray, mixed: np.ndarray) -> None:
    """A row at other places, between those to their left and right."""
    for x in range(mixed.size):
        first = row[left[x]]
        mixed[x] = first + (row[right[x]] - first) * share[x]


@fused
def correct_row(here: np.ndarray, soft: np.ndarray, found: np.ndarray, owner: np.ndarray, lack: np.ndarray,
                inside: np.ndarray, gain: np.ndarray, corrected: np.ndarray) -> None:
    """A row of corrected alpha; ``owner`` says which of the render pixels of ``found`` (5, w) an output pixel is in."""
    sharper = gain[SHARPER]
    for x in range(owner.size):
        value, own = here[x + 1], owner[x]
        inner = found[4, own] * (inside[x] - value - found[2, own])
        corrected[x] = clamp(value + lack[x] + inner + sharper * found[0, own] * (value - soft[x]), ZERO, ONE)


@fused
def colour_row(corrected: np.ndarray, colours: np.ndarray, red: np.ndarray, green: np.ndarray, blue: np.ndarray,
               rest: np.ndarray, found: np.ndarray, owner: np.ndarray, fitted: Real, output: np.ndarray) -> None:
    """That row nearer to alpha by ``colours`` (n, 3), given their factors and what is added."""
    for x in range(owner.size):
        shades = red[x] * colours[x, 0] + green[x] * colours[x, 1] + blue[x] * colours[x, 2]
        by_colour = clamp(NINTH * (shades + rest[x]), ZERO, ONE)
        output[x, 0] = corrected[x] + fitted * found[0, owner[x]] * (by_colour - corrected[x])


@compiled
def keep_row(at: int, owner: np.ndarray, samples: np.ndarray, corrected: np.ndarray) -> None:
    """A row of alpha that is the samples' mean."""
    for x in range(owner.size):
        corrected[x, 0] = pixel_mean(at, owner[x], samples)


@compiled
def correct_rows(y0: int, y1: int, enlarged: np.ndarray, picture: np.ndarray, fit: np.ndarray,
                 next_samples: np.ndarray, next_doubt: np.ndarray, moved: np.ndarray, near: np.ndarray,
                 gain: np.ndarray, corrected: np.ndarray) -> None:
    """Alpha: filtered and enlarged, sharper, nearer to the mean of samples, and to alpha by colours. Where nothing
    moves samples know nothing of a pixel's inside. It is the samples' mean where nothing is near."""
    (h, w), (height, width) = next_doubt.shape[:2], corrected.shape[:2]
    means, sums = np.zeros((4, w + 2), np.float32), np.empty((3, w + 2), np.float32)
    lines, factors = np.empty((3, width + 2), np.float32), np.empty((4, width), np.float32)
    rows, held, done = np.zeros((2, 9, w), np.float32), np.full(4, -1, np.int64), np.full(2, -1, np.int64)
    owner, starts = np.empty(width, np.int32), first_places((h, w), (height, width))
    places, shares = np.empty((4, width), np.int32), np.empty((2, width), np.float32)
    line, own, lacks = np.empty(2 * w, np.float32), np.empty(w, np.float32), np.empty(w, np.float32)
    inside, lack, soft = np.empty(width, np.float32), np.empty(width, np.float32), np.empty(width, np.float32)
    softer, nearer = np.empty(width + 2, np.float32), np.empty(width, np.float32)
    spans, some = np.empty((near.shape[1], 2), np.int64), np.empty((near.shape[1], 2), np.int64)
    planar = np.full(3, -2, np.int64)
    for x in range(width):
        owner[x] = centre(x, w, width)[0]
        places[0, x], places[1, x], shares[0, x] = beside(x, w, width)
        places[2, x], places[3, x], shares[1, x] = beside(x, 2 * w, width)
    for y in range(y0, y1):
        owning, kept = centre(y, h, height)[0], 0
        count = spans_of(near[cell_of(owning, near)], w, TWO, spans)
        for row in range(y - 1, y + 2 if count else y - 1):
            if planar[row % 3] != row:
                planar_row(enlarged[min(max(row, 0), height - 1)], lines[row % 3])
                planar[row % 3] = row
        first, second, down = beside(y, h, height)
        for at in (first, second):
            if done[at % 2] == at or not count:
                continue
            above, below, found = max(at - 1, 0), min(at + 1, h - 1), rows[at % 2]
            for row in range(above, below + 1):
                if held[row % 4] == row:
                    continue
                for k in range(spans_around(row, w, near, some)):
                    mean_within(enlarged, 0, row, some[k, 0], some[k, 1], starts, means[row % 4])
                held[row % 4] = row
            for k in range(spans_of(near[cell_of(at, near)], w, ONE, some)):
                x0, x1 = some[k]
                for x in range(x0, x1):
                    own[x] = pixel_mean(at, x, next_samples)
                lacking_row(x0, x1, means[above % 4], means[at % 4], means[below % 4], own, next_doubt[at, :, 0], gain,
                            sums, found)
                for x in range(x0, x1):
                    moves = abs(moved[at, x, 0]) >= LEAST_MOTION or abs(moved[at, x, 1]) >= LEAST_MOTION
                    found[4, x] = found[1, x] if moves else ZERO
            for k in range(4):
                three_sums(fit[k, above], fit[k, at], fit[k, below], found[5 + k])
            done[at % 2] = at
        upper, lower, inner = beside(y, 2 * h, height)
        for k in range(count):
            x0, x1 = max(spans[k, 0] - 1, 0), min(spans[k, 1] + 1, w)
            a, b = starts[1, spans[k, 0]], starts[1, spans[k, 1]]
            keep_row(owning, owner[kept:a], next_samples, corrected[y, kept:a])
            kept = b
            for i in range(5):
                plane = 3 if i == 4 else 5 + i
                mix_rows(rows[first % 2, plane, x0:x1], rows[second % 2, plane, x0:x1], down, lacks[x0:x1])
                mix_beside(lacks, places[0, a:b], places[1, a:b], shares[0, a:b],
                           lack[a:b] if i == 4 else factors[i, a:b])
            mix_rows(next_samples[upper, 2 * x0:2 * x1, 0], next_samples[lower, 2 * x0:2 * x1, 0], inner,
                     line[2 * x0:2 * x1])
            mix_beside(line, places[2, a:b], places[3, a:b], shares[1, a:b], inside[a:b])
            soft_row(lines[(y - 1) % 3][a:b + 2], lines[y % 3][a:b + 2], lines[(y + 1) % 3][a:b + 2], softer[a:b + 2],
                     soft[a:b])
            correct_row(lines[y % 3][a:b + 2], soft[a:b], rows[owning % 2], owner[a:b], lack[a:b], inside[a:b], gain,
                        nearer[a:b])
            colour_row(nearer[a:b], picture[y, a:b], factors[0, a:b], factors[1, a:b], factors[2, a:b],
                       factors[3, a:b], rows[owning % 2], owner[a:b], gain[FITTED], corrected[y, a:b])
        keep_row(owning, owner[kept:], next_samples, corrected[y, kept:])


GATHER = kernel("gather", ("alpha", "moved", "samples", "doubt", "near", "rates"), ("next_samples", "next_doubt"),
                gather_rows, ("next_doubt", 0), alpha=("h", "w", 1), moved=("h", "w", 2), samples=QUARTERS,
                doubt=("h", "w", 1), near=NEAR, rates=(4,), next_samples=QUARTERS, next_doubt=("h", "w", 1))
FIT = kernel("fit", ("picture", "next_samples", "near"), ("fit",), fit_rows, ("fit", 1), picture=("height", "width", 3),
             next_samples=QUARTERS, near=NEAR, fit=(4, "h", "w"))
CORRECT = kernel("correct", ("enlarged", "picture", "fit", "next_samples", "next_doubt", "moved", "near", "gain"),
                 ("corrected",), correct_rows, ("corrected", 0), enlarged=("height", "width", 1),
                 picture=("height", "width", 3), fit=(4, "h", "w"), next_samples=QUARTERS, next_doubt=("h", "w", 1),
                 moved=("h", "w", 2), near=NEAR, gain=(4,), corrected=("height", "width", 1))
