"""Kernels that apply the picture's filters to its parts, such as light groups, and keep their sum that of the picture.

A part is accumulated with the picture's weights, filtered and enlarged with the picture's kernels, all of it linear in
light and without exposure, so what adds up in the input adds up in the output. ``coding`` (3,) is what is taken off a
part's values before they are filtered, what the rest is multiplied by, 0 and 1 for light, and their limit.
``last_part`` (h, w, 3) and ``next_part`` (th, tw, 3) are the accumulated values without reflectance, 0 where ``state``
knows nothing. Several parts are filtered and enlarged at once, so that the weights are read from memory once for them.
"""

import numpy as np

from postfx.kernels.denoise.layout import (
    BLEND,
    DISTRUST,
    EXPOSURE,
    HEIGHT,
    JITTER_X,
    JITTER_Y,
    LEFT,
    MAX_FLOAT,
    OUT_HEIGHT,
    OUT_LEFT,
    OUT_WIDTH,
    REFLECTANCE,
    TAP_WEIGHTS,
    TINY,
    TOP,
    WIDTH,
    kernel,
)
from postfx.kernels.denoise.prepare import steps, warp_row
from postfx.kernels.denoise.reactive import kept_row
from postfx.kernels.denoise.upsample import (
    TAPS,
    between,
    control_row,
    gauss,
    is_doubled,
    lean,
    lean_on,
    pixel_of,
    place,
    scale_row,
    trust_picked,
    trust_side,
)
from postfx.kernels.numeric import (
    Real,
    add,
    centre,
    clamp,
    compiled,
    demodulation,
    divide,
    fused,
    inline,
    vectorised,
)

ZERO, HALF, ONE, DARKEST = np.float32(0), np.float32(0.5), np.float32(1), np.float32(1e-30)
OFFSET, FACTOR, MOST = range(3)
"""Of ``coding``."""
SCALE, SHIFT, LOW, HIGH, KIND = range(5)
"""Of ``decoding``: what a filtered value is multiplied by, what is added, its bounds, and its kind: above 0
vectors, which get length 1, below 0 distances, of which the reciprocal and the share of the pixel that has one were
filtered; ``SHIFT`` then stands for none."""

MOVING, STILL, NOISE = range(3)
"""Of ``gain``: how much of what alpha lacks it gets in a frame, where things move and where not, and the variance of a
pixel's samples over alpha (1 - alpha)."""
LEAST_MOTION, FAINTEST = np.float32(1 / 64), np.float32(1e-6)
"""Render pixels that count as motion, and the smallest variance that is structure."""


@inline
def encode_part(value: Real, coding: np.ndarray) -> Real:
    """A value coded for the filters, at least 0; NaN counts as 0, infinity as the largest number."""
    known = clamp(value, -MAX_FLOAT, MAX_FLOAT)
    return max(known - coding[OFFSET], ZERO) * coding[FACTOR]


@compiled
def recall(last: np.ndarray, px: Real, py: Real, found: np.ndarray) -> None:
    """The last frame's part at a place in it, bilinear, edge repeated."""
    h, w = last.shape[:2]
    x, y = min(max(px, ZERO), np.float32(w - 1)), min(max(py, ZERO), np.float32(h - 1))
    left, upper = int(x), int(y)
    right, lower = min(left + 1, w - 1), min(upper + 1, h - 1)
    tx, ty = x - np.float32(left), y - np.float32(upper)
    for c in range(3):
        top = last[upper, left, c] + (last[upper, right, c] - last[upper, left, c]) * tx
        bottom = last[lower, left, c] + (last[lower, right, c] - last[lower, left, c]) * tx
        found[c] = top + (bottom - top) * ty


@compiled
def accumulate_rows(y0: int, y1: int, part: np.ndarray, coding: np.ndarray, factor: np.ndarray, past: np.ndarray,
                    moved: np.ndarray, last_part: np.ndarray, fine: np.ndarray, window: np.ndarray,
                    next_state: np.ndarray, next_part: np.ndarray, part_level: np.ndarray) -> None:
    """Running mean of a part by the picture's weights, and the same planar, zero beyond the frame."""
    h, w = part.shape[:2]
    th, tw = next_part.shape[:2]
    top, left = int(window[TOP]), int(window[LEFT])
    rows, columns = min(th, h - top), min(tw, w - left)
    before = np.zeros(3, np.float32)
    for y in range(y0, y1):
        first = columns if y < rows else 0
        part_level[:, y, first:] = ZERO
        if y < th:
            next_part[y, first:] = ZERO
        for x in range(first):
            v, u = top + y, left + x
            share = ONE / (max(past[y, x, 3], ZERO) + ONE)
            alpha = share + (ONE - share) * fine[0, DISTRUST, y, x]
            held = past[y, x, 3] > ZERO
            if held:
                recall(last_part, np.float32(u) + moved[y, x, 0], np.float32(v) + moved[y, x, 1], before)
            known = next_state[y, x, 3] > ZERO
            for c in range(3):
                now = min(encode_part(part[v, u, c], coding) / factor[y, x, c], coding[MOST])
                mean = before[c] + (now - before[c]) * alpha if held else now
                mean = mean if mean <= np.float32(MAX_FLOAT) else now
                part_level[c, y, x] = mean
                next_part[y, x, c] = mean if known else ZERO


@compiled
def reflectance_rows(y0: int, y1: int, diffuse_albedo: np.ndarray, specular_albedo: np.ndarray, part_rows: np.ndarray,
                     part_columns: np.ndarray, factor: np.ndarray) -> None:
    """Reflectance (th, tw, 3) of a part whose reflectance is not the picture's."""
    for y in range(y0, y1):
        for x in range(factor.shape[1]):
            factor[y, x, 0], factor[y, x, 1], factor[y, x, 2] = demodulation(
                diffuse_albedo, specular_albedo, int(part_rows[y]), int(part_columns[x]))


@fused
def add_three(taps: np.ndarray, row: np.ndarray, total: np.ndarray) -> None:
    """total += three taps times three neighbours of a row, from each place on."""
    a, b, c = taps[0], taps[1], taps[2]
    for x in range(total.size):
        total[x] = total[x] + a[x] * row[x] + b[x] * row[x + 1] + c[x] * row[x + 2]


@fused
def add_three_picked(taps: np.ndarray, row: np.ndarray, index: np.ndarray, total: np.ndarray) -> None:
    """The same, from the places in ``index`` on."""
    a, b, c = taps[0], taps[1], taps[2]
    for x in range(total.size):
        at = index[x]
        total[x] = total[x] + a[x] * row[at] + b[x] * row[at + 1] + c[x] * row[at + 2]


@vectorised
def interleave(rows: np.ndarray, flat: np.ndarray) -> None:
    """Rows of the red, green and blue of even pixels, then of odd ones, as one row of pixels."""
    a, b, c, d, e, f = rows[0], rows[1], rows[2], rows[3], rows[4], rows[5]
    for x in range(a.size):
        flat[6 * x], flat[6 * x + 1], flat[6 * x + 2] = a[x], b[x], c[x]
        flat[6 * x + 3], flat[6 * x + 4], flat[6 * x + 5] = d[x], e[x], f[x]


@fused
def blend_light(current: np.ndarray, warped: np.ndarray, trust: np.ndarray, darken: Real, light: np.ndarray) -> None:
    """Blend light with the reprojected history, neither of which is encoded: a sum of parts blends as the parts do.
    Rounding and cubic interpolation never make light negative, and broken values count as 0."""
    for i in range(light.size):
        now = current[i] * darken if current[i] <= MAX_FLOAT else ZERO
        mixed = now + (max(warped[i], ZERO) - now) * trust[i]
        light[i] = max(mixed, ZERO) if mixed <= MAX_FLOAT else now


@compiled
def double_taps(lower: int, fine: np.ndarray, iy: int, gauss_x: np.ndarray, gauss_y: np.ndarray, taps: np.ndarray,
                total: np.ndarray) -> None:
    """Weights of the samples for a row at scale 2: taps (2, 9, w) of its even and odd pixels, and their sums."""
    for side in range(2):
        total[side] = TINY
        for tap in range(TAPS):
            j, i = tap // 3, tap % 3
            scale_row(fine[0, TAP_WEIGHTS + 4 * tap + 2 * lower + side, iy], gauss_y[j] * gauss_x[i, side],
                      taps[side, tap])
            add(taps[side, tap], total[side])


@compiled
def any_taps(ty: Real, fine: np.ndarray, iy: int, gauss_x: np.ndarray, gauss_y: np.ndarray, index: np.ndarray,
             leans: np.ndarray, corners: np.ndarray, taps: np.ndarray, total: np.ndarray) -> None:
    """The same for a row at any scale: taps (1, 9, width)."""
    total[0] = TINY
    for tap in range(TAPS):
        j, i = tap // 3, tap % 3
        for side in range(2):
            corner = TAP_WEIGHTS + 4 * tap + side
            between(fine[0, corner, iy], fine[0, corner + 2, iy], ty, gauss_y[j], corners[side])
        lean_on(corners, index, leans, taps[0, tap])
        taps[0, tap] *= gauss_x[i]
        add(taps[0, tap], total[0])


@compiled
def any_of(row: np.ndarray) -> bool:
    """Whether any number is not 0."""
    for x in range(row.size):
        if row[x] != ZERO:
            return True
    return False


@compiled
def light_rows(y0: int, y1: int, radiance: np.ndarray, fine: np.ndarray, moved: np.ndarray, past: np.ndarray,
               last: np.ndarray, params: np.ndarray, window: np.ndarray, keep: np.ndarray, out_rows: np.ndarray,
               out_columns: np.ndarray, light: np.ndarray) -> None:
    """Enlarge parts (3 n, ...), with their reflectance, and blend them with the ``last`` outputs (n, height, width, 3)
    where their pixels are now: linear means of samples, now and before. The weights of a row are read once for all
    parts; rows that keep nothing, or where nothing moves, need no reprojection."""
    (h, w), (count, _, width, _) = moved.shape[:2], light.shape
    left, size = int(window[OUT_LEFT]), (int(window[OUT_WIDTH]), int(window[OUT_HEIGHT]))
    scale = np.float32(size[0] / int(window[WIDTH])), np.float32(size[1] / int(window[HEIGHT]))
    index, leans = np.empty(width, np.int64), np.empty(width, np.float32)
    gauss_x, gauss_y = np.empty((3, width), np.float32), np.empty(3, np.float32)
    columns, before = out_columns.astype(np.int64), np.empty(3 * width + 1, np.float32)
    shift_x, shift_y = np.empty(w, np.int32), np.empty(w, np.int32)
    cubic_x, cubic_y = np.empty((4, w), np.float32), np.empty((4, w), np.float32)
    for x in range(width):
        index[x], offset = pixel_of(x, LEFT, window, w)
        leans[x] = lean(offset)
        for i in range(3):
            gauss_x[i, x] = gauss(i - 1 + params[JITTER_X] - offset)
    sides, count_x = (2, w) if is_doubled(window) else (1, width)
    taps, total = np.empty((sides, TAPS, count_x), np.float32), np.empty((sides, count_x), np.float32)
    rows, current = np.empty((3 * sides, count_x), np.float32), np.empty(3 * width, np.float32)
    corners, share = np.empty((2, w), np.float32), np.empty(w, np.float32)
    blend, trust = np.empty(count_x, np.float32), np.empty(3 * width, np.float32)
    for row in range(y0, y1):
        y = int(out_rows[row])
        iy, offset = pixel_of(row, TOP, window, h)
        kept_row(keep, iy, share)
        for j in range(3):
            gauss_y[j] = gauss(j - 1 + params[JITTER_Y] - offset)
        if sides == 2:
            double_taps(y % 2, fine, iy, gauss_x, gauss_y, taps, total)
            for side in range(2):
                blend[:] = fine[0, BLEND + 2 * (y % 2) + side, iy, :w]
                trust_side(left + side, np.float32(y), size, moved[iy], past[iy], scale, share, blend)
                for c in range(3):
                    place(blend, 3 * side + c, 6, trust)
        else:
            any_taps(lean(offset), fine, iy, gauss_x, gauss_y, index, leans, corners, taps, total)
            control_row(BLEND, iy, lean(offset), fine, index, leans, corners, blend)
            trust_picked(left, np.float32(y), size, moved[iy], past[iy], scale, share, index, blend, trust)
        keeps, moves = any_of(trust), left + width > size[0] or any_of(moved[iy].reshape(2 * w))
        if keeps and moves:
            steps(moved[iy], 0, scale[0], shift_x, cubic_x)
            steps(moved[iy], 1, scale[1], shift_y, cubic_y)
        for k in range(count):
            for line in range(3 * sides):
                side, c = line // 3, line % 3
                rows[line] = ZERO
                for j in range(3):
                    samples = radiance[3 * k + c, iy + j]
                    if sides == 2:
                        add_three(taps[side, 3 * j:3 * j + 3], samples, rows[line])
                    else:
                        add_three_picked(taps[0, 3 * j:3 * j + 3], samples, index, rows[line])
                divide(rows[line], total[side])
                if sides == 1:
                    place(rows[line], c, 3, current)
            if sides == 2:
                interleave(rows, current)
            if keeps and moves:
                warp_row(y, columns, last[k], index, shift_x, shift_y, cubic_x, cubic_y, before)
            elif keeps:
                before[:3 * width] = last[k, y, left:left + width].reshape(3 * width)
            else:
                before[:] = ZERO
            blend_light(current, before, trust, ONE / params[EXPOSURE], light[k, row].reshape(3 * width))


@vectorised
def inverse_of(total: np.ndarray, whole: np.ndarray, inverse: np.ndarray) -> None:
    """1 / light, which turns parts into shares; `total` becomes the light."""
    for i in range(total.size):
        total[i] = max(total[i], whole[i])
        inverse[i] = ONE / max(total[i], DARKEST)


@compiled
def cover_row(part: np.ndarray, reached: np.ndarray, covered: np.ndarray) -> None:
    """A row of a part (W, 3) where there is light of it: by the render pixel of ``reached`` (w,)."""
    width, w = part.shape[0], reached.size
    for x in range(width):
        cover = reached[x * w // width]
        for c in range(3):
            covered[x, c] = part[x, c] * cover


@compiled
def balance_rows(y0: int, y1: int, parts: np.ndarray, reached: np.ndarray, whole: np.ndarray, picture: np.ndarray,
                 complete: np.ndarray, balanced: np.ndarray) -> None:
    """Parts (n, H, W, 3) of the ``picture``, in the proportions that they were filtered in: to each other if they are
    ``complete``, else to the ``whole``, which was filtered like them. Complete parts without light get equal shares.

    ``reached`` (n, h, w) is 0 at render pixels where a part has no light; (n, 1, 1) where all have some everywhere.
    """
    count, height, width, _ = parts.shape
    total, inverse = np.empty(3 * width, np.float32), np.empty(3 * width, np.float32)
    everywhere = reached.shape[1] == 1
    for y in range(y0, y1):
        total[:] = ZERO
        for k in range(count):
            if everywhere:
                add(parts[k, y].reshape(3 * width), total)
            else:
                cover_row(parts[k, y], reached[k, y * reached.shape[1] // height], balanced[k, y])
                add(balanced[k, y].reshape(3 * width), total)
        alone = complete[0] > ZERO
        inverse_of(total, total if alone else whole[y].reshape(3 * width), inverse)
        line = picture[y].reshape(3 * width)
        equal = ONE / np.float32(count) if alone else ZERO
        for k in range(count):
            target = balanced[k, y].reshape(3 * width)
            source = parts[k, y].reshape(3 * width) if everywhere else target
            for i in range(3 * width):
                target[i] = (source[i] * inverse[i] if total[i] > DARKEST else equal) * line[i]


@compiled
def decode_rows(y0: int, y1: int, filtered: np.ndarray, decoding: np.ndarray, plane: np.ndarray) -> None:
    """Values of a plane from filtered ones, within bounds. Vectors get length 1 unless they are 0, and reciprocals
    become distances again."""
    channels = plane.shape[2]
    for y in range(y0, y1):
        for x in range(plane.shape[1]):
            square = ZERO
            for c in range(channels if decoding[KIND] < ZERO else 0):
                distance = filtered[y, x, 1] / max(filtered[y, x, 0], DARKEST)
                distance = min(max(distance, decoding[LOW]), decoding[HIGH]) * decoding[SCALE]
                plane[y, x, c] = distance if filtered[y, x, 1] >= HALF else decoding[SHIFT]
            for c in range(0 if decoding[KIND] < ZERO else channels):
                value = filtered[y, x, c] * decoding[SCALE] + decoding[SHIFT]
                plane[y, x, c] = min(max(value, decoding[LOW]), decoding[HIGH])
                square += plane[y, x, c] * plane[y, x, c]
            if decoding[KIND] > ZERO:
                scale = ONE / np.sqrt(square) if square > np.float32(1e-12) else ZERO
                for c in range(channels):
                    plane[y, x, c] *= scale


@inline
def first_within(at: int, size: int, out: int) -> int:
    """The first of ``out`` pixels whose centre lies in pixel ``at`` of ``size``."""
    return (2 * out * at + size - 1) // (2 * size)


@compiled
def mean_within(filtered: np.ndarray, at: int, h: int, mean: np.ndarray) -> None:
    """Mean of the output's pixels in each render pixel of a row."""
    (height, width), w = filtered.shape[:2], mean.size
    top, bottom = first_within(at, h, height), first_within(at + 1, h, height)
    for x in range(w):
        left, right = first_within(x, w, width), first_within(x + 1, w, width)
        total = ZERO
        for row in range(top, bottom):
            for column in range(left, right):
                total += filtered[row, column, 0]
        mean[x] = total / np.float32((bottom - top) * (right - left))


@compiled
def lacking_row(at: int, part: np.ndarray, motion: np.ndarray, means: np.ndarray, gain: np.ndarray,
                lack: np.ndarray) -> None:
    """What a row of alpha lacks, as far as its structure is more than the samples' noise; ``means`` are those of three
    rows around ``at``, the middle one at ``at % 3``."""
    w = lack.size
    for x in range(w):
        mean, square = ZERO, ZERO
        for i in range(-1, 2):
            column = min(max(x + i, 0), w - 1)
            for j in range(3):
                mean += means[j, column]
                square += means[j, column] * means[j, column]
        mean /= np.float32(9)
        structure = max(square / np.float32(9) - mean * mean, ZERO)
        noise = gain[NOISE] * max(mean * (ONE - mean), ZERO)
        still = abs(motion[at, x, 0]) < LEAST_MOTION and abs(motion[at, x, 1]) < LEAST_MOTION
        share = gain[STILL if still else MOVING] * structure / (structure + noise + FAINTEST)
        lack[x] = share * (clamp(part[at, x, 0], ZERO, ONE) - means[at % 3, x])


@compiled
def correct_rows(y0: int, y1: int, filtered: np.ndarray, part: np.ndarray, motion: np.ndarray, gain: np.ndarray,
                 corrected: np.ndarray) -> None:
    """Alpha, three times, whose means over render pixels are nearer to the frame's own alpha ``part``."""
    (h, w), (height, width) = part.shape[:2], corrected.shape[:2]
    means, lack = np.empty((3, w), np.float32), np.empty(w, np.float32)
    held, last = np.full(3, -1, np.int64), -1
    for y in range(y0, y1):
        at, _ = centre(y, h, height)
        if at != last:
            for row in range(at - 1, at + 2):
                within = min(max(row, 0), h - 1)
                if held[(row + 3) % 3] != within:
                    mean_within(filtered, within, h, means[(row + 3) % 3])
                    held[(row + 3) % 3] = within
            lacking_row(at, part, motion, means, gain, lack)
            last = at
        for x in range(width):
            value = filtered[y, x, 0] + lack[centre(x, w, width)[0]]
            corrected[y, x, 0] = corrected[y, x, 1] = corrected[y, x, 2] = clamp(value, ZERO, ONE)


STACK = ("parts", "rows", "columns", 3)
IMAGE, OUTPUT = ("rows", "columns", 3), ("height", "width", 3)
REFLECT = kernel("reflectance", (*REFLECTANCE, "part_rows", "part_columns"), ("factor",), reflectance_rows,
                 ("factor", 0))
ACCUMULATE_PART = kernel(
    "accumulate_part", ("part", "coding", "factor", "past", "moved", "last_part", "fine", "window", "next_state"),
    ("next_part", "part_level"), accumulate_rows, ("part_level", 1), part=("h", "w", 3), coding=(3,),
    last_part=("h", "w", 3), next_part=("th", "tw", 3), part_level=(3, "hp", "wp"))
UPSAMPLE_LIGHT = kernel("upsample_light", ("radiance", "fine", "moved", "past", "last", "params", "window", "keep",
                                           "out_rows", "out_columns"), ("light",), light_rows, ("light", 1),
                        radiance=("3*parts", "padded_h", "padded_w"), last=("parts", "height", "width", 3),
                        light=("parts", "out_th", "out_tw", 3))
BALANCE = kernel("balance", ("parts", "reached", "whole", "picture", "complete"), ("balanced",), balance_rows,
                 ("balanced", 1), parts=STACK, reached=("parts", "reached_h", "reached_w"), whole=IMAGE, picture=IMAGE,
                 complete=(1,), balanced=STACK)
CORRECT = kernel("correct", ("filtered", "part", "motion", "gain"), ("corrected",), correct_rows, ("corrected", 0),
                 filtered=OUTPUT, part=("h", "w", 3), gain=(3,), corrected=OUTPUT)
DECODE = kernel("decode", ("filtered", "decoding"), ("plane",), decode_rows, ("plane", 0), filtered=IMAGE,
                decoding=(5,), plane=IMAGE)
DECODE_ONE = kernel("decode_one", ("filtered", "decoding"), ("plane",), decode_rows, ("plane", 0), filtered=IMAGE,
                    decoding=(5,), plane=("rows", "columns", 1))
"""The same for planes of one channel, which were filtered as three."""
