"""What two pictures show that their planes do not tell: motion, for frames without vectors and for what does not move
along with its surface, and overlays, which lie over the scene and do not move as it does.

Dense inverse search (Kroeger, Timofte, Dai and Van Gool 2016, "Fast Optical Flow using Dense Inverse Search"): from
coarse to fine, patches on a grid take over a neighbour's motion where it fits better, are moved by Gauss-Newton steps,
and every pixel gets the mean of the patches over it, weighted by how well they fit there. Patches are compared without
their means, so that a change of light does not count.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from postfx.caching import filled_array, new_array
from postfx.interpolate.choose import LUMINANCE, SAME
from postfx.kernels.numeric import Real, compiled, inline, uncounted, vectorised
from postfx.kernels.vectors import in_lanes
from postfx.sampling import local_sum

PATCH, STRIDE = 8, 4
"""Pixels along a patch's side, and from one patch to the next."""
MARGIN = PATCH + 2
"""Pixels around a picture that is searched: its edges, repeated."""
STEPS = 8
"""Gauss-Newton steps of a patch."""
COARSEST = 20
"""Pixels along the shorter side of the smallest picture that is searched."""
AGREE = np.float32(0.5)
"""Pixels by which the way there and back may miss."""
BESIDE, OTHERWISE = 3, np.float32(2)
"""Cells to what is beside a cell in a patch, and by how many cells that must move differently to matter."""
COVERED = 0.98
"""Coverage from which an overlay hides the picture."""
FINEST = 1
"""Halvings after which pictures are not searched finer: motion is interpolated from there."""


def estimate_motion(after: np.ndarray, before: np.ndarray, finest: int = FINEST) -> np.ndarray:
    """Motion (h, w, 2) of the later picture: previous place minus this one, in pixels; x right, y down.

    after, before: (h, w) float32, of a range like that of a display, without NaN. Smaller ones than 16 pixels stand
    still. finest: halvings of the pictures that are searched last.
    """
    if min(after.shape) < 2 * PATCH:
        return np.zeros((*after.shape, 2), np.float32)
    levels = [(after, before)]
    while min(levels[-1][0].shape) >= 2 * COARSEST:
        levels.append((halve(levels[-1][0]), halve(levels[-1][1])))
    levels = levels[min(finest, len(levels) - 1):]
    flow = np.zeros((*levels[-1][0].shape, 2), np.float32)
    for one, other in reversed(levels):
        h, w = one.shape
        padded, searched = np.pad(one, MARGIN, "edge"), np.pad(other, MARGIN, "edge")
        moved = np.zeros((max(h - PATCH, 0) // STRIDE + 1, max(w - PATCH, 0) // STRIDE + 1, 3), np.float32)
        search(padded.ravel(), searched.ravel(), h, w, flow, moved)
        flow = new_array((h, w, 2))
        spread(padded.ravel(), searched.ravel(), h, w, moved, flow)
    return enlarge_motion(flow, *after.shape)


def middle_light(pictures: tuple[np.ndarray, np.ndarray]) -> np.float32:
    """Light that is toned to about the middle: four times the geometric mean of both pictures."""
    some = 4 if min(pictures[0].shape[:2]) >= 256 else 1  # of the pixels along a side tell how bright a picture is
    light = [np.maximum(picture[::some, ::some] @ LUMINANCE, 0) for picture in pictures]
    mean = float(np.mean(light)) + 1e-12
    return np.float32(4 * math.exp(float(np.mean(np.log(np.stack(light) + np.float32(1e-3 * mean))))))


@vectorised
def tone_numbers(numbers: np.ndarray, level: Real, toned: np.ndarray) -> None:
    for i in range(numbers.size):
        bright = max(numbers[i], np.float32(0))
        toned[i] = np.sqrt(bright / (bright + level))


@vectorised
def mean_of_threes(numbers: np.ndarray, means: np.ndarray) -> None:
    for x in range(means.size):
        means[x] = (numbers[3 * x] + numbers[3 * x + 1] + numbers[3 * x + 2]) * np.float32(1 / 3)


@compiled
def tone_rows(y0: int, y1: int, picture: np.ndarray, level: Real, margin: int, toned: np.ndarray) -> None:
    """Grey (h + 2 margin, w + 2 margin) of the range 0 to 1, in which differences are about as visible in the dark as
    in the light. Rows above and below the picture are left as they are."""
    h, w = picture.shape[:2]
    numbers, flat = np.empty(3 * w, np.float32), picture.reshape(h, 3 * w)
    for y in range(y0, y1):
        row = toned[y + margin]
        tone_numbers(flat[y], level, numbers)
        mean_of_threes(numbers, row[margin:margin + w])
        for beside in range(margin):
            row[beside], row[w + margin + beside] = row[margin], row[w + margin - 1]


def halve(picture: np.ndarray, margin: int = 0) -> np.ndarray:
    """Means of 2x2 pixels of a picture within margins; an odd last row or column is averaged with the margin, or left
    out where there is none."""
    means = new_array(tuple((side - 2 * margin + (margin > 0)) // 2 for side in picture.shape))
    average_fours(picture, margin, means)
    return means


@compiled
def average_fours(picture: np.ndarray, margin: int, means: np.ndarray) -> None:
    for y in range(means.shape[0]):
        upper, lower, row = picture[2 * y + margin, margin:], picture[2 * y + margin + 1, margin:], means[y]
        for x in range(row.size):
            row[x] = np.float32(0.25) * (upper[2 * x] + lower[2 * x] + upper[2 * x + 1] + lower[2 * x + 1])


def enlarge_motion(flow: np.ndarray, height: int, width: int) -> np.ndarray:
    """Motion in pixels of a picture of this size, interpolated between centres."""
    if flow.shape[:2] == (height, width):
        return flow
    larger = new_array((height, width, 2))
    enlarge(flow, larger)
    return larger


@inline
def centre_between(position: int, count: int, size: int) -> tuple[int, int, Real]:
    """The centres before and after that of a pixel of a larger row, and how far it is from the first to the second."""
    at = min(max(np.float32((position + 0.5) * count / size - 0.5), np.float32(0)), np.float32(count - 1))
    first = min(int(at), max(count - 2, 0))
    return first, min(first + 1, count - 1), at - first


@inline
def motion_between(flow: np.ndarray, c: int, j: int, low: int, fy: Real, i: int, right: int, fx: Real) -> Real:
    """Motion between four centres."""
    upper = flow[j, i, c] * (1 - fx) + flow[j, right, c] * fx
    lower = flow[low, i, c] * (1 - fx) + flow[low, right, c] * fx
    return upper * (1 - fy) + lower * fy


@inline
def enlarged_at(flow: np.ndarray, height: int, width: int, y: int, x: int) -> tuple[Real, Real]:
    """Motion at a pixel of a larger picture, in its pixels: linear interpolation between centres."""
    h, w = flow.shape[:2]
    j, low, fy = centre_between(y, h, height)
    i, right, fx = centre_between(x, w, width)
    return (motion_between(flow, 0, j, low, fy, i, right, fx) * np.float32(width / w),
            motion_between(flow, 1, j, low, fy, i, right, fx) * np.float32(height / h))


@compiled
def enlarge(flow: np.ndarray, larger: np.ndarray) -> None:
    """Linear interpolation between centres, in pixels of the larger picture."""
    h, w = flow.shape[:2]
    height, width = larger.shape[:2]
    wide, tall = np.float32(width / w), np.float32(height / h)
    places, shares = np.empty((width, 2), np.int64), np.empty(width, np.float32)
    for x in range(width):
        places[x, 0], places[x, 1], shares[x] = centre_between(x, w, width)
    for y in range(height):
        j, low, fy = centre_between(y, h, height)
        for x in range(width):
            i, right, fx = places[x, 0], places[x, 1], shares[x]
            larger[y, x, 0] = motion_between(flow, 0, j, low, fy, i, right, fx) * wide
            larger[y, x, 1] = motion_between(flow, 1, j, low, fy, i, right, fx) * tall


@inline
def value_at(picture: np.ndarray, y: Real, x: Real) -> Real:
    """Value between four pixels; edges are repeated."""
    h, w = picture.shape
    x, y = min(max(x, np.float32(0)), np.float32(w - 1.001)), min(max(y, np.float32(0)), np.float32(h - 1.001))
    i, j = int(x), int(y)
    fx, fy = x - i, y - j
    upper = picture[j, i] * (1 - fx) + picture[j, i + 1] * fx
    return upper * (1 - fy) + (picture[j + 1, i] * (1 - fx) + picture[j + 1, i + 1] * fx) * fy


@inline
def motion_at(flow: np.ndarray, y: Real, x: Real) -> tuple[Real, Real]:
    """Motion between four pixels, likewise."""
    h, w = flow.shape[:2]
    x, y = min(max(x, np.float32(0)), np.float32(w - 1.001)), min(max(y, np.float32(0)), np.float32(h - 1.001))
    i, j = int(x), int(y)
    fx, fy = x - i, y - j
    return (motion_between(flow, 0, j, j + 1, fy, i, i + 1, fx), motion_between(flow, 1, j, j + 1, fy, i, i + 1, fx))


@in_lanes(PATCH, results=2)
def patch_difference(v: Any, one: Any, at: Any, other: Any, there: Any, stride: Any, across: Any, down: Any) -> Any:
    """Sums of the difference of two patches, and of its square."""
    rows = v.rows(other, there, stride, across, down, PATCH)
    apart = [row - v.load(one, v.step(at, stride, j)) for j, row in enumerate(rows)]
    return v.sum(apart).total(), v.sum([row * row for row in apart]).total()


@in_lanes(PATCH, results=5)
def patch_slopes(v: Any, one: Any, at: Any, stride: Any) -> Any:
    """Sums of products of a patch's slopes, (right, right), (right, down) and (down, down), and of both slopes."""
    right, down = slopes_of(v, one, at, stride)
    return (v.sum([dx * dx for dx in right]).total(),
            v.sum([dx * dy for dx, dy in zip(right, down, strict=True)]).total(),
            v.sum([dy * dy for dy in down]).total(), v.sum(right).total(), v.sum(down).total())


@in_lanes(PATCH, results=3)
def patch_pull(v: Any, one: Any, at: Any, other: Any, there: Any, stride: Any, across: Any, down: Any) -> Any:
    """Sums of the difference of two patches, and of its products with the first one's slopes."""
    rows = v.rows(other, there, stride, across, down, PATCH)
    apart = [row - v.load(one, v.step(at, stride, j)) for j, row in enumerate(rows)]
    along, under = slopes_of(v, one, at, stride)
    return (v.sum(apart).total(), v.sum([dx * d for dx, d in zip(along, apart, strict=True)]).total(),
            v.sum([dy * d for dy, d in zip(under, apart, strict=True)]).total())


def slopes_of(v: Any, one: Any, at: Any, stride: Any) -> tuple[list[Any], list[Any]]:
    """Slopes of a patch's rows, to the right and down."""
    rows = [v.step(at, stride, j) for j in range(-1, PATCH + 1)]
    right = [(v.load(one, v.step(row, 1)) - v.load(one, v.step(row, -1))) * 0.5 for row in rows[1:-1]]
    down = [(v.load(one, below) - v.load(one, above)) * 0.5 for above, below in zip(rows, rows[2:], strict=False)]
    return right, down


@in_lanes(STRIDE, results=STRIDE)
def four_weights(v: Any, one: Any, at: Any, other: Any, there: Any, stride: Any, across: Any, down: Any) -> Any:
    """Differences of four pixels of a row."""
    (row,) = v.rows(other, there, stride, across, down, 1)
    apart = (row - v.load(one, at)).magnitude()
    return tuple(apart.number(k) for k in range(STRIDE))


@inline
def place_of(y: Real, x: Real, h: int, w: int) -> tuple[int, Real, Real]:
    """Index of a place in a picture with margins, and the place's share of a pixel, across and down. Places that are
    further out show the same, the edge."""
    y = min(max(y, np.float32(-PATCH - 1)), np.float32(h))
    x = min(max(x, np.float32(-PATCH - 1)), np.float32(w))
    j, i = int(np.floor(y)), int(np.floor(x))
    return (j + MARGIN) * (w + 2 * MARGIN) + i + MARGIN, np.float32(x - i), np.float32(y - j)


@inline
def misfit(one: np.ndarray, other: np.ndarray, h: int, w: int, top: int, left: int, u: Real, v: Real) -> Real:
    """Mean square of a patch's difference to where it would have been, without the mean difference."""
    there, across, down = place_of(np.float32(top + v), np.float32(left + u), h, w)
    stride = w + 2 * MARGIN
    total, square = patch_difference(one, (top + MARGIN) * stride + left + MARGIN, other, there, stride, across, down)
    count = np.float32(PATCH * PATCH)
    return square / count - (total / count) ** 2


@compiled
def search(one: np.ndarray, other: np.ndarray, h: int, w: int, flow: np.ndarray, moved: np.ndarray) -> None:
    """Motion of each patch and its misfit (rows, columns, 3), from the coarser level's.

    one, other: flat pictures of h x w pixels with margins.
    """
    rows, columns = moved.shape[:2]
    half = PATCH // 2
    for turn in range(2):  # down and right, then up and left, so that motion spreads in both directions
        for k in range(rows * columns):
            at = k if turn == 0 else rows * columns - 1 - k
            row, column = at // columns, at % columns
            top, left = row * STRIDE, column * STRIDE
            if turn == 0:
                u, v = enlarged_at(flow, h, w, min(top + half, h - 1), min(left + half, w - 1))
                best = misfit(one, other, h, w, top, left, u, v)
            else:
                u, v, best = moved[row, column, 0], moved[row, column, 1], moved[row, column, 2]
            step, began = (-1 if turn == 0 else 1), best
            for b, a in ((row + step, column), (row, column + step)):
                if 0 <= b < rows and 0 <= a < columns:
                    fit = misfit(one, other, h, w, top, left, moved[b, a, 0], moved[b, a, 1])
                    if fit < best:
                        u, v, best = moved[b, a, 0], moved[b, a, 1], fit
            if turn == 0 or best < began:
                u, v, best = descend(one, other, h, w, top, left, u, v, best)
            moved[row, column, 0], moved[row, column, 1], moved[row, column, 2] = u, v, best


@compiled
def descend(one: np.ndarray, other: np.ndarray, h: int, w: int, top: int, left: int, u: Real, v: Real, best: Real
            ) -> tuple[Real, Real, Real]:
    """Gauss-Newton steps from a motion to one that fits better (inverse compositional; Baker and Matthews 2004)."""
    stride = w + 2 * MARGIN
    at, count = (top + MARGIN) * stride + left + MARGIN, np.float32(PATCH * PATCH)
    xx, xy, yy, sx, sy = patch_slopes(one, at, stride)
    xx, xy, yy = xx - sx * sx / count, xy - sx * sy / count, yy - sy * sy / count
    damped = np.float32(1e-4) * count
    xx, yy = xx + damped, yy + damped
    area = xx * yy - xy * xy
    p, q = u, v
    for _ in range(STEPS):
        there, across, down = place_of(np.float32(top + q), np.float32(left + p), h, w)
        total, gx, gy = patch_pull(one, at, other, there, stride, across, down)
        gx, gy = gx - total * sx / count, gy - total * sy / count
        du, dv = (yy * gx - xy * gy) / area, (xx * gy - xy * gx) / area
        p, q = p - du, q - dv
        if abs(p - u) > PATCH or abs(q - v) > PATCH:
            break
        if abs(du) + abs(dv) < np.float32(0.01):
            break
    fit = misfit(one, other, h, w, top, left, p, q) if abs(p - u) <= PATCH and abs(q - v) <= PATCH else best
    return (p, q, fit) if fit < best else (u, v, best)


@compiled
def spread(one: np.ndarray, other: np.ndarray, h: int, w: int, moved: np.ndarray, flow: np.ndarray) -> None:
    """Motion of each pixel: the mean of the patches over it, by how well they fit there."""
    rows, columns = moved.shape[:2]
    least, zero, stride, reach = np.float32(2e-3), np.float32(0), w + 2 * MARGIN, PATCH // STRIDE - 1
    for y in range(h):
        last_row = min(y // STRIDE, rows - 1)
        for x in range(0, w, STRIDE):
            last_column = min(x // STRIDE, columns - 1)
            t0, t1, t2, t3 = zero, zero, zero, zero
            u0, u1, u2, u3 = zero, zero, zero, zero
            v0, v1, v2, v3 = zero, zero, zero, zero
            for row in range(max(last_row - reach, 0), last_row + 1):
                for column in range(max(last_column - reach, 0), last_column + 1):
                    p, q = moved[row, column, 0], moved[row, column, 1]
                    there, across, down = place_of(np.float32(y + q), np.float32(x + p), h, w)
                    d0, d1, d2, d3 = four_weights(one, (y + MARGIN) * stride + x + MARGIN, other, there, stride, across,
                                                  down)
                    d0, d1, d2, d3 = 1 / (least + d0), 1 / (least + d1), 1 / (least + d2), 1 / (least + d3)
                    t0, t1, t2, t3 = t0 + d0, t1 + d1, t2 + d2, t3 + d3
                    u0, u1, u2, u3 = u0 + d0 * p, u1 + d1 * p, u2 + d2 * p, u3 + d3 * p
                    v0, v1, v2, v3 = v0 + d0 * q, v1 + d1 * q, v2 + d2 * q, v3 + d3 * q
            us, vs = (u0 / t0, u1 / t1, u2 / t2, u3 / t3), (v0 / t0, v1 / t1, v2 / t2, v3 / t3)
            for k in range(min(STRIDE, w - x)):
                flow[y, x + k, 0], flow[y, x + k, 1] = us[k], vs[k]


def consistent_motion(ahead: np.ndarray, back: np.ndarray, scale: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """Motion of two pictures to each other, NaN where the way there and back does not end where it began.

    scale: pixels of a picture `scale` times as large are what counts, and what the result is in.
    """
    found = new_array(ahead.shape), new_array(back.shape)
    for one, other, kept in ((ahead, back, found[0]), (back, ahead, found[1])):
        keep_consistent(one, other, np.float32(scale), kept)
    return found


@compiled
def keep_consistent(one: np.ndarray, other: np.ndarray, scale: Real, kept: np.ndarray) -> None:
    """NaN where a motion leads out of the picture, or to where the other one does not lead back."""
    h, w = one.shape[:2]
    most = AGREE / scale
    for y in range(h):
        for x in range(w):
            kept[y, x, 0], kept[y, x, 1] = np.nan, np.nan
            u, v = x + one[y, x, 0], y + one[y, x, 1]
            if -0.5 < u < w - 0.5 and -0.5 < v < h - 0.5:
                back_u, back_v = motion_at(other, v, u)
                if abs(back_u + one[y, x, 0]) <= most and abs(back_v + one[y, x, 1]) <= most:
                    kept[y, x, 0], kept[y, x, 1] = scale * one[y, x, 0], scale * one[y, x, 1]


def bring_to_time(flow: np.ndarray, known: np.ndarray, one: np.ndarray, other: np.ndarray, scale: int, share: float
                  ) -> np.ndarray:
    """Flow (rows, columns, 2) of cells after a share of its way, in pixels: a thing's flow is where the thing is then.

    What planes tell, too, is left out (NaN). The rest is moved, away from edges between things that move differently.
    Where several arrive, that counts whose ends look most alike; where none does, flow stays as it is.

    known: likewise, in cells, motion by planes; NaN where there is none. one, other: grey pictures (rows, columns) of
    this frame and of the one that flow leads to. scale: pixels of a cell.
    """
    brought = new_array(flow.shape)
    brought[:] = flow
    if flow.size:
        move_flow(flow, known, one, other, np.float32(1 / scale), np.float32(share), filled_array(one.shape, 2),
                  brought)
    return brought


@inline
def is_edge(motion: np.ndarray, y: int, x: int) -> bool:
    """Whether what is beside a cell moves otherwise: patches there show both, and their flow is of neither."""
    up, low = max(y - BESIDE, 0), min(y + BESIDE, motion.shape[0] - 1)
    left, right, most = max(x - BESIDE, 0), min(x + BESIDE, motion.shape[1] - 1), np.float32(0)
    for c in range(2):
        here = motion[y, x, c]
        most = max(most, max(max(abs(motion[up, x, c] - here), abs(motion[low, x, c] - here)),
                             max(abs(motion[y, left, c] - here), abs(motion[y, right, c] - here))))
    return bool(most > OTHERWISE)


@uncounted
def move_flow(flow: np.ndarray, known: np.ndarray, one: np.ndarray, other: np.ndarray, size: Real, share: Real,
              least: np.ndarray, brought: np.ndarray) -> None:
    """The same. size: cells of a pixel. least: (rows, columns), more than pictures differ."""
    h, w = least.shape
    half = np.float32(0.5)
    for y in range(h):
        for x in range(w):
            u, v = size * flow[y, x, 0], size * flow[y, x, 1]
            if u != u:
                continue
            if max(abs(u - known[y, x, 0]), abs(v - known[y, x, 1])) < SAME * size:
                if least[y, x] > 1:
                    brought[y, x, 0] = np.float32(np.nan)
                continue
            if is_edge(known, y, x):
                continue
            j, i = y + v + half, x + u + half
            if not ((j >= 0) & (i >= 0) & (j < np.float32(h)) & (i < np.float32(w))):
                continue
            apart = abs(one[y, x] - other[int(j), int(i)])
            top, left = int(np.floor(y + share * v)), int(np.floor(x + share * u))
            for b, a in ((top, left), (top, left + 1), (top + 1, left), (top + 1, left + 1)):
                if (np.uint64(b) < np.uint64(h)) & (np.uint64(a) < np.uint64(w)) and apart < least[b, a]:
                    least[b, a], brought[b, a, 0], brought[b, a, 1] = apart, flow[y, x, 0], flow[y, x, 1]


# Overlays: found in pictures, taken out, and told from pictures without them.


@compiled
def find_overlay(before: np.ndarray, after: np.ndarray, motion: np.ndarray, reach: int, known: np.ndarray) -> None:
    """Mark as unknown what is drawn over both pictures and stands still while the scene behind it moves.

    Such pixels have the same bits in both frames and an edge beside them that has, too, and their motion is half a
    pixel or more; `reach` pixels with the same bits around them belong to them.
    """
    h, w = known.shape
    steps = np.full((h, w), -1, np.int32)
    queue = np.empty((h * w, 2), np.int64)
    head, tail = 0, 0
    for y in range(h):
        for x in range(w):
            if not (is_same(before, after, y, x) and abs(motion[y, x, 0]) + abs(motion[y, x, 1]) >= 0.5):
                continue
            for j, i in ((y, x + 1), (y + 1, x), (y, x - 1), (y - 1, x)):
                if 0 <= j < h and 0 <= i < w and is_same(before, after, j, i) and steps[y, x] < 0:
                    edge = False
                    for c in range(3):
                        size = abs(before[y, x, c]) + abs(before[j, i, c])
                        edge = edge or abs(before[y, x, c] - before[j, i, c]) > np.float32(0.02) * size
                    if edge:
                        steps[y, x] = 0
                        queue[tail, 0], queue[tail, 1] = y, x
                        tail += 1
    while head < tail:
        y, x = queue[head, 0], queue[head, 1]
        head += 1
        known[y, x] = False
        if steps[y, x] >= reach:
            continue
        for j, i in ((y, x + 1), (y + 1, x), (y, x - 1), (y - 1, x)):
            if 0 <= j < h and 0 <= i < w and steps[j, i] < 0 and is_same(before, after, j, i):
                steps[j, i] = steps[y, x] + 1
                queue[tail, 0], queue[tail, 1] = j, i
                tail += 1


@inline
def is_same(before: np.ndarray, after: np.ndarray, y: int, x: int) -> bool:
    """Whether a pixel has the same colour in both frames."""
    return bool(before[y, x, 0] == after[y, x, 0] and before[y, x, 1] == after[y, x, 1]
                and before[y, x, 2] == after[y, x, 2])


def remove_overlay(colour: np.ndarray, overlay: np.ndarray) -> np.ndarray:
    """The picture under an overlay that was composited over it; black where nothing of it is left."""
    clear = 1 - overlay[..., 3:]
    picture = np.zeros_like(colour)
    np.divide(colour - overlay[..., :3], clear, out=picture, where=clear > 1 - COVERED)
    return picture


def measure_clearness(one: np.ndarray, other: np.ndarray, below: np.ndarray, below_other: np.ndarray) -> np.ndarray:
    """How much of the picture an overlay lets through (h, w, 1), 0 to 1, by the difference of two frames with and
    without it: least squares of colour = overlay + clearness * picture over 5x5 pixels, for an overlay that stands
    still. 1 where the picture does not change, as it makes no difference there."""
    change, seen = below_other - below, other - one
    product, square = (local_sum((change * by).sum(-1), 2) for by in (seen, change))
    clear = np.divide(product, square, out=np.ones_like(square), where=square > 0).clip(0, 1)
    still = (seen == 0).all(-1) & (change != 0).any(-1)
    clear[still] = 0  # to the pixel, where nothing comes through
    found: np.ndarray = clear[..., None]
    return found
