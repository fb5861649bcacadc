"""Kernels that apply the picture's filters to its parts, such as light groups, and keep their sum that of the picture.

A part is accumulated with the picture's weights, filtered and enlarged with the picture's kernels, all of it linear in
light and without exposure, so what adds up in the input adds up in the output. ``coding`` (3,) is what is taken off a
part's values before they are filtered, what the rest is multiplied by, 0 and 1 for light, and their limit.
``last_part`` (h, w, 3) and ``next_part`` (th, tw, 3) are the accumulated values without reflectance, 0 where ``state``
knows nothing.
"""

import numpy as np

from postfx.kernels.denoise.layout import (
    DISTRUST,
    LEFT,
    MAX_FLOAT,
    REFLECTANCE,
    TOP,
    kernel,
)
from postfx.kernels.numeric import Real, add, clamp, compiled, demodulation, inline, vectorised

ZERO, HALF, ONE, DARKEST = np.float32(0), np.float32(0.5), np.float32(1), np.float32(1e-30)
OFFSET, FACTOR, MOST = range(3)
"""Of ``coding``."""
SCALE, SHIFT, LOW, HIGH, KIND = range(5)
"""Of ``decoding``: what a filtered value is multiplied by, what is added, its bounds, and its kind: above 0
vectors, which get length 1, below 0 distances, of which the reciprocal and the share of the pixel that has one were
filtered; ``SHIFT`` then stands for none."""


@inline
def coded(value: Real, coding: np.ndarray) -> Real:
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
                    next_state: np.ndarray, level: np.ndarray, next_part: np.ndarray, part_level: np.ndarray) -> None:
    """Running mean of a part by the picture's weights; ``part_level`` (4, hp, wp) is it with the importance of the
    picture's ``level``."""
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
            part_level[3, y, x] = level[3, y, x]
            for c in range(3):
                now = min(coded(part[v, u, c], coding) / factor[y, x, c], coding[MOST])
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


STACK = ("parts", "rows", "columns", 3)
IMAGE = ("rows", "columns", 3)
REFLECT = kernel("reflectance", (*REFLECTANCE, "part_rows", "part_columns"), ("factor",), reflectance_rows,
                 ("factor", 0))
ACCUMULATE_PART = kernel(
    "accumulate_part", ("part", "coding", "factor", "past", "moved", "last_part", "fine", "window",
                        "next_state", "level"),
    ("next_part", "part_level"), accumulate_rows, ("part_level", 1), part=("h", "w", 3), coding=(3,),
    last_part=("h", "w", 3), next_part=("th", "tw", 3), part_level=(4, "hp", "wp"))
BALANCE = kernel("balance", ("parts", "reached", "whole", "picture", "complete"), ("balanced",), balance_rows,
                 ("balanced", 1), parts=STACK, reached=("parts", "reached_h", "reached_w"), whole=IMAGE, picture=IMAGE,
                 complete=(1,), balanced=STACK)
DECODE = kernel("decode", ("filtered", "decoding"), ("plane",), decode_rows, ("plane", 0), filtered=IMAGE,
                decoding=(5,), plane=IMAGE)
DECODE_ONE = kernel("decode_one", ("filtered", "decoding"), ("plane",), decode_rows, ("plane", 0), filtered=IMAGE,
                    decoding=(5,), plane=("rows", "columns", 1))
"""The same for planes of one channel, which were filtered as three."""
