"""Kernels that apply the picture's filters to its parts, such as light groups, and keep their sum that of the picture.

A part is accumulated with the picture's weights, filtered and enlarged with the picture's kernels, all of it linear in
light and without exposure, so what adds up in the input adds up in the output. ``coding`` (3,) is what is taken off a
part's values before they are filtered, what the rest is multiplied by, 0 and 1 for light, and their limit.
``last_part`` (h, w, 3) and ``next_part`` (th, tw, 3) are the accumulated values without reflectance; ``past`` tells
where they are not used. Several parts are filtered and enlarged at once, so that the weights are read from memory once
for them.
"""

from dataclasses import replace

import numpy as np

from postfx.kernels.denoise import (
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
    in_half,
    kernel,
)
from postfx.kernels.denoise.history import find_starts, kept_row, runs_of, steps, warp_row
from postfx.kernels.denoise.upsample import (
    TAPS,
    control_row,
    gauss,
    is_doubled,
    lean,
    lean_on,
    pixel_of,
    trust_picked,
    trust_side,
)
from postfx.kernels.numeric import (
    Real,
    add,
    add_eight,
    add_four,
    add_products_of_eight,
    between,
    compiled,
    demodulation,
    divide,
    divide_eight,
    fused,
    interleave,
    largest_eight,
    load_eight,
    load_four,
    place,
    store_eight,
    store_four,
    vectorised,
)

ZERO, HALF, ONE, DARKEST = np.float32(0), np.float32(0.5), np.float32(1), np.float32(1e-30)
OFFSET, FACTOR, MOST = range(3)
"""Of ``coding``."""
SCALE, SHIFT, LOW, HIGH, KIND = range(5)
"""Of ``decoding``: what a filtered value is multiplied by, what is added, its bounds, and its kind: above 0
vectors, which get length 1, below 0 distances, of which the reciprocal and the share of the pixel that has one were
filtered; ``SHIFT`` then stands for none."""



@fused
def recall_row(v: int, left: int, last: np.ndarray, moved: np.ndarray, past: np.ndarray, distrust: np.ndarray,
               before: np.ndarray, alpha: np.ndarray) -> None:
    """The last frame's part along a row, bilinear, edge repeated, and how much this frame counts, three times a pixel:
    all where nothing is known. ``before`` has one more number than pixels have."""
    h, w = last.shape[:2]
    flat = last.reshape(last.size)
    for x in range(alpha.size // 3):
        share = ONE / (max(past[x, 3], ZERO) + ONE)
        share = share + (ONE - share) * distrust[x] if past[x, 3] > ZERO else ONE
        alpha[3 * x] = alpha[3 * x + 1] = alpha[3 * x + 2] = share
        if past[x, 3] <= ZERO:
            before[3 * x] = before[3 * x + 1] = before[3 * x + 2] = ZERO
            continue
        px = min(max(np.float32(left + x) + moved[x, 0], ZERO), np.float32(w - 1))
        py = min(max(np.float32(v) + moved[x, 1], ZERO), np.float32(h - 1))
        at_x, at_y = min(int(px), max(w - 2, 0)), min(int(py), max(h - 2, 0))
        tx, ty = px - np.float32(at_x), py - np.float32(at_y)
        at = 3 * (at_y * w + at_x)
        right, below = at + 3 * min(1, w - 1), 3 * w * min(1, h - 1)
        if right + below + 4 <= last.size:
            zero = np.float32(0)
            top = add_four((zero, zero, zero, zero), load_four(flat, at), ONE - tx)
            top = add_four(top, load_four(flat, right), tx)
            bottom = add_four((zero, zero, zero, zero), load_four(flat, at + below), ONE - tx)
            bottom = add_four(bottom, load_four(flat, right + below), tx)
            store_four(before, 3 * x, add_four(add_four((zero, zero, zero, zero), top, ONE - ty), bottom, ty))
            continue
        for c in range(3):
            upper = flat[at + c] * (ONE - tx) + flat[right + c] * tx
            lower = flat[at + below + c] * (ONE - tx) + flat[right + below + c] * tx
            before[3 * x + c] = upper * (ONE - ty) + lower * ty


@fused
def mix_part(values: np.ndarray, coding: np.ndarray, factor: np.ndarray, alpha: np.ndarray, before: np.ndarray,
             mean: np.ndarray) -> None:
    """A row's values coded for the filters, at least 0, without reflectance, mixed with those before; NaN counts as 0,
    infinity as the largest number."""
    offset, scale, most = coding[OFFSET], coding[FACTOR], coding[MOST]
    for i in range(mean.size):
        value = values[i] if values[i] == values[i] else ZERO
        value = min(max(value, -MAX_FLOAT), MAX_FLOAT)
        now = min(max(value - offset, ZERO) * scale / factor[i], most)
        mixed = before[i] + (now - before[i]) * alpha[i]
        mean[i] = mixed if mixed <= MAX_FLOAT else now


@vectorised
def spread(flat: np.ndarray, first: int, row: np.ndarray) -> None:
    """One channel of an interleaved row."""
    for x in range(row.size):
        row[x] = flat[3 * x + first]


@compiled
def accumulate_rows(y0: int, y1: int, part: np.ndarray, coding: np.ndarray, factor: np.ndarray, past: np.ndarray,
                    moved: np.ndarray, last_part: np.ndarray, fine: np.ndarray, window: np.ndarray,
                    next_part: np.ndarray, part_level: np.ndarray) -> None:
    """Running mean of a part by the picture's weights, and the same planar, zero beyond the frame."""
    h, w = part.shape[:2]
    th, tw = next_part.shape[:2]
    top, left = int(window[TOP]), int(window[LEFT])
    rows, columns = min(th, h - top), min(tw, w - left)
    before, alpha = np.empty(3 * columns + 1, np.float32), np.empty(3 * columns, np.float32)
    for y in range(y0, y1):
        first = columns if y < rows else 0
        part_level[:, y, first:] = ZERO
        if y < th:
            next_part[y, first:] = ZERO
        if not first:
            continue
        recall_row(top + y, left, last_part, moved[y], past[y], fine[0, DISTRUST, y], before, alpha)
        mean = next_part[y, :columns].reshape(3 * columns)
        mix_part(part[top + y, left:left + columns].reshape(3 * columns), coding,
                 factor[y, :columns].reshape(3 * columns), alpha, before, mean)
        for c in range(3):
            spread(mean, c, part_level[c, y, :columns])


@compiled
def reflectance_rows(y0: int, y1: int, diffuse_albedo: np.ndarray, specular_albedo: np.ndarray, part_rows: np.ndarray,
                     part_columns: np.ndarray, factor: np.ndarray) -> None:
    """Reflectance (th, tw, 3) of a part whose reflectance is not the picture's."""
    for y in range(y0, y1):
        for x in range(factor.shape[1]):
            factor[y, x, 0], factor[y, x, 1], factor[y, x, 2] = demodulation(
                diffuse_albedo, specular_albedo, int(part_rows[y]), int(part_columns[x]))


@fused
def add_nine(taps: np.ndarray, total: np.ndarray, radiance: np.ndarray, part: int, iy: int, rows: np.ndarray) -> None:
    """Rows (6, w) of a part's red, green and blue at even pixels of a row at scale 2, then at odd ones: weighted means
    of 3x3 neighbours from row ``iy`` on. ``taps`` (2, 9, w), ``total`` (2, w); at least 8 pixels wide."""
    w, (_, tall, wide) = total.shape[1], radiance.shape
    weights, sums, found = taps.reshape(taps.size), total.reshape(total.size), rows.reshape(rows.size)
    samples, plane = radiance.reshape(radiance.size), tall * wide
    first = 3 * part * plane + iy * wide
    for block in range((w + 7) // 8):
        x = min(8 * block, w - 8)
        for side in range(2):
            red = green = blue = (ZERO, ZERO, ZERO, ZERO, ZERO, ZERO, ZERO, ZERO)
            for j in range(3):
                for i in range(3):
                    tap = load_eight(weights, (TAPS * side + 3 * j + i) * w + x)
                    at = first + j * wide + x + i
                    red = add_products_of_eight(red, tap, load_eight(samples, at))
                    green = add_products_of_eight(green, tap, load_eight(samples, at + plane))
                    blue = add_products_of_eight(blue, tap, load_eight(samples, at + 2 * plane))
            weight, to = load_eight(sums, side * w + x), 3 * side * w + x
            store_eight(found, to, divide_eight(red, weight))
            store_eight(found, to + w, divide_eight(green, weight))
            store_eight(found, to + 2 * w, divide_eight(blue, weight))


@fused
def add_three_picked(taps: np.ndarray, row: np.ndarray, index: np.ndarray, total: np.ndarray) -> None:
    """The same, from the places in ``index`` on."""
    a, b, c = taps[0], taps[1], taps[2]
    for x in range(total.size):
        at = index[x]
        total[x] = total[x] + a[x] * row[at] + b[x] * row[at + 1] + c[x] * row[at + 2]


@fused
def blend_light(current: np.ndarray, warped: np.ndarray, trust: np.ndarray, darken: Real, light: np.ndarray) -> None:
    """Blend light with the reprojected history, neither of which is encoded: a sum of parts blends as the parts do.
    Rounding and cubic interpolation never make light negative, and broken values count as 0."""
    for i in range(light.size):
        now = current[i] * darken if current[i] <= MAX_FLOAT else ZERO
        mixed = now + (max(warped[i], ZERO) - now) * trust[i]
        light[i] = max(mixed, ZERO) if mixed <= MAX_FLOAT else now


@fused
def double_taps(lower: int, fine: np.ndarray, iy: int, gauss_x: np.ndarray, gauss_y: np.ndarray, taps: np.ndarray,
                total: np.ndarray) -> None:
    """Weights of the samples for a row at scale 2: taps (2, 9, w) of its even and odd pixels, and their sums; at least
    8 pixels wide."""
    w, (_, _, hp, wp) = total.shape[1], fine.shape
    flat, found, sums = fine.reshape(fine.size), taps.reshape(taps.size), total.reshape(total.size)
    zero, tiny, one = np.float32(0), np.float32(TINY), np.float32(1)
    for side in range(2):
        for block in range((w + 7) // 8):
            x = min(8 * block, w - 8)
            whole = (tiny, tiny, tiny, tiny, tiny, tiny, tiny, tiny)
            for tap in range(TAPS):
                at = ((TAP_WEIGHTS + 4 * tap + 2 * lower + side) * hp + iy) * wp + x
                scale = gauss_y[tap // 3] * gauss_x[tap % 3, side]
                scaled = add_eight((zero, zero, zero, zero, zero, zero, zero, zero), load_eight(flat, at), scale)
                store_eight(found, (TAPS * side + tap) * w + x, scaled)
                whole = add_eight(whole, scaled, one)
            store_eight(sums, side * w + x, whole)


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
    columns, before = out_columns.astype(np.int64), np.zeros((count, 3 * width), np.float32)
    begin, first = runs_of(columns, int(window[WIDTH]), size[0], int(window[LEFT]), w)
    shift, cubic = np.empty((2, w), np.int32), np.empty((2, 4, w), np.float32)
    starts, others = np.empty(w, np.int32), np.empty(w, np.int64)
    for x in range(width):
        index[x], offset = pixel_of(x, LEFT, window, w)
        leans[x] = lean(offset)
        for i in range(3):
            gauss_x[i, x] = gauss(i - 1 + params[JITTER_X] - offset)
    sides, count_x = (2, w) if is_doubled(window) and w >= 8 else (1, width)
    taps, total = np.empty((sides, TAPS, count_x), np.float32), np.empty((sides, count_x), np.float32)
    rows, current = np.empty((3 * sides, count_x), np.float32), np.empty(3 * width, np.float32)
    corners, share = np.empty((2, w), np.float32), np.empty(w, np.float32)
    blend, trust = np.empty(count_x, np.float32), np.empty(3 * width, np.float32)
    stepped = -1
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
            if iy != stepped:
                steps(moved[iy], scale, shift, cubic)
                stepped = iy
            find_starts(y, last.shape[1], last.shape[2], first, shift, starts)
            for k in range(count):
                warp_row(y, columns, begin, starts, last[k], shift, cubic, others, before[k])
        for k in range(count):
            if sides == 2:
                add_nine(taps, total, radiance, k, iy, rows)
                interleave(rows[:3], rows[3:], current)
            else:
                for c in range(3):
                    rows[c] = ZERO
                    for j in range(3):
                        add_three_picked(taps[0, 3 * j:3 * j + 3], radiance[3 * k + c, iy + j], index, rows[c])
                    divide(rows[c], total[0])
                    place(rows[c], c, 3, current)
            if keeps and not moves:
                before[k] = last[k, y, left:left + width].reshape(3 * width)
            blend_light(current, before[k], trust, ONE / params[EXPOSURE], light[k, row].reshape(3 * width))


@compiled
def cover_row(part: np.ndarray, reached: np.ndarray, covered: np.ndarray) -> None:
    """A row of a part (W, 3) where there is light of it: by the render pixel of ``reached`` (w,)."""
    width, w = part.shape[0], reached.size
    for x in range(width):
        cover = reached[x * w // width]
        for c in range(3):
            covered[x, c] = part[x, c] * cover


@fused
def share_row(y: int, parts: np.ndarray, whole: np.ndarray, picture: np.ndarray, complete: bool,
              balanced: np.ndarray) -> None:
    """A row of parts (n, H, W, 3) in the proportions that they have to each other, or to the ``whole``. Where complete
    parts have no light, each counts as having the same."""
    count, height, width, _ = parts.shape
    light, found = parts.reshape(parts.size), balanced.reshape(balanced.size)
    wholes, pictures = whole.reshape(whole.size), picture.reshape(picture.size)
    n, plane = 3 * width, 3 * width * height
    zeros = (ZERO, ZERO, ZERO, ZERO, ZERO, ZERO, ZERO, ZERO)
    darkest = (DARKEST, DARKEST, DARKEST, DARKEST, DARKEST, DARKEST, DARKEST, DARKEST)
    for block in range(n // 8):
        i = y * n + 8 * block
        total, more = zeros, zeros
        for k in range(count):
            total = add_eight(total, load_eight(light, k * plane + i), ONE)
        if complete:
            more = largest_eight(add_eight(darkest, total, -ONE), zeros)
            total = add_eight(total, more, np.float32(count))
        else:
            total = largest_eight(largest_eight(total, load_eight(wholes, i)), darkest)
        ratio = divide_eight(load_eight(pictures, i), total)
        for k in range(count):
            part = add_eight(more, load_eight(light, k * plane + i), ONE)
            store_eight(found, k * plane + i, add_products_of_eight(zeros, part, ratio))
    for i in range(y * n + n // 8 * 8, y * n + n):
        summed = ZERO
        for k in range(count):
            summed += light[k * plane + i]
        rest = max(DARKEST - summed, ZERO) if complete else ZERO
        summed = summed + np.float32(count) * rest if complete else max(summed, wholes[i], DARKEST)
        for k in range(count):
            found[k * plane + i] = (light[k * plane + i] + rest) * (pictures[i] / summed)


@compiled
def balance_rows(y0: int, y1: int, parts: np.ndarray, reached: np.ndarray, whole: np.ndarray, picture: np.ndarray,
                 complete: np.ndarray, balanced: np.ndarray) -> None:
    """Parts (n, H, W, 3) of the ``picture``, in the proportions that they were filtered in: to each other if they are
    ``complete``, else to the ``whole``, which was filtered like them. Complete parts without light get equal shares.

    ``reached`` (n, h, w) is 0 at render pixels where a part has no light; (n, 1, 1) where all have some everywhere.
    """
    count, height = parts.shape[:2]
    alone, everywhere = complete[0] > ZERO, reached.shape[1] == 1
    for y in range(y0, y1):
        if everywhere:
            share_row(y, parts, whole, picture, alone, balanced)
            continue
        for k in range(count):
            cover_row(parts[k, y], reached[k, y * reached.shape[1] // height], balanced[k, y])
        share_row(y, balanced, whole, picture, alone, balanced)


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


STACK = ("parts", "rows", "columns", 3)
IMAGE = ("rows", "columns", 3)
REFLECT = kernel("reflectance", (*REFLECTANCE, "part_rows", "part_columns"), ("factor",), reflectance_rows,
                 ("factor", 0))
ACCUMULATE_PART = kernel(
    "accumulate_part", ("part", "coding", "factor", "past", "moved", "last_part", "fine", "window"),
    ("next_part", "part_level"), accumulate_rows, ("part_level", 1), part=("h", "w", 3), coding=(3,),
    last_part=("h", "w", 3), next_part=("th", "tw", 3), part_level=(3, "hp", "wp"))
UPSAMPLE_LIGHT = replace(
    kernel("upsample_light", ("radiance", "fine", "moved", "past", "last", "params", "window", "keep", "out_rows",
                              "out_columns"), ("light",), light_rows, ("light", 1),
           radiance=("3*parts", "padded_h", "padded_w"), last=("parts", "height", "width", 3),
           light=("parts", "out_th", "out_tw", 3)), pixels=(2, 2))
in_half(ACCUMULATE_PART, "fine")
in_half(UPSAMPLE_LIGHT, "fine")
BALANCE = kernel("balance", ("parts", "reached", "whole", "picture", "complete"), ("balanced",), balance_rows,
                 ("balanced", 1), parts=STACK, reached=("parts", "reached_h", "reached_w"), whole=IMAGE, picture=IMAGE,
                 complete=(1,), balanced=STACK)
DECODE = kernel("decode", ("filtered", "decoding"), ("plane",), decode_rows, ("plane", 0), filtered=IMAGE,
                decoding=(5,), plane=IMAGE)
DECODE_ONE = kernel("decode_one", ("filtered", "decoding"), ("plane",), decode_rows, ("plane", 0), filtered=IMAGE,
                    decoding=(5,), plane=("rows", "columns", 1))
"""The same for planes of one channel, which were filtered as three."""
