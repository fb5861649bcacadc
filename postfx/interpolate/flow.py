"""Motion estimated from two pictures, for frames without motion vectors and for what vectors do not tell.

Dense inverse search (Kroeger, Timofte, Dai and Van Gool 2016, "Fast Optical Flow using Dense Inverse Search"): from
coarse to fine, patches on a grid take over a neighbour's motion where it fits better, are moved by Gauss-Newton steps,
and every pixel gets the mean of the patches over it, weighted by how well they fit there. Patches are compared without
their means, so that a change of light does not count.
"""

from __future__ import annotations

import numpy as np

from postfx.kernels.numeric import Real, compiled, inline

PATCH, STRIDE = 8, 4
"""Pixels along a patch's side, and from one patch to the next."""
STEPS = 8
"""Gauss-Newton steps of a patch."""
COARSEST = 20
"""Pixels along the shorter side of the smallest picture that is searched."""
AGREE = np.float32(0.5)
"""Pixels by which the way there and back may miss."""
FINEST = 1
"""Halvings after which pictures are not searched finer: motion is interpolated from there."""


def estimate_motion(after: np.ndarray, before: np.ndarray) -> np.ndarray:
    """Motion (h, w, 2) of the later picture: previous place minus this one, in pixels; x right, y down.

    after, before: (h, w) float32, of a range like that of a display, without NaN. Smaller ones than 16 pixels stand
    still.
    """
    if min(after.shape) < 2 * PATCH:
        return np.zeros((*after.shape, 2), np.float32)
    levels = [(after, before)]
    while min(levels[-1][0].shape) >= 2 * COARSEST:
        levels.append((halve(levels[-1][0]), halve(levels[-1][1])))
    levels = levels[min(FINEST, len(levels) - 1):]
    flow = np.zeros((*levels[-1][0].shape, 2), np.float32)
    for one, other in reversed(levels):
        flow = enlarge_motion(flow, *one.shape)
        rows, columns = (max(side - PATCH, 0) // STRIDE + 1 for side in one.shape)
        moved = np.zeros((rows, columns, 3), np.float32)
        search(one, other, flow, moved)
        flow = np.empty_like(flow)
        spread(one, other, moved, flow)
    return enlarge_motion(flow, *after.shape)


def halve(picture: np.ndarray) -> np.ndarray:
    """Means of 2x2 pixels; an odd last row or column is left out."""
    h, w = (side // 2 for side in picture.shape)
    means: np.ndarray = picture[:2 * h, :2 * w].reshape(h, 2, w, 2).mean((1, 3), dtype=np.float32)
    return means


def enlarge_motion(flow: np.ndarray, height: int, width: int) -> np.ndarray:
    """Motion in pixels of a picture of this size, interpolated between centres."""
    if flow.shape[:2] == (height, width):
        return flow
    larger = np.empty((height, width, 2), np.float32)
    enlarge(flow, larger)
    return larger


@compiled
def enlarge(flow: np.ndarray, larger: np.ndarray) -> None:
    """Linear interpolation between centres, in pixels of the larger picture."""
    height, width = larger.shape[:2]
    h, w = flow.shape[:2]
    for y in range(height):
        v = min(max(np.float32((y + 0.5) * h / height - 0.5), np.float32(0)), np.float32(h - 1))
        for x in range(width):
            u = min(max(np.float32((x + 0.5) * w / width - 0.5), np.float32(0)), np.float32(w - 1))
            j, i = min(int(v), max(h - 2, 0)), min(int(u), max(w - 2, 0))
            low, right = min(j + 1, h - 1), min(i + 1, w - 1)
            fy, fx = v - j, u - i
            for c in range(2):
                upper = flow[j, i, c] * (1 - fx) + flow[j, right, c] * fx
                lower = flow[low, i, c] * (1 - fx) + flow[low, right, c] * fx
                larger[y, x, c] = (upper * (1 - fy) + lower * fy) * (np.float32(width / w) if c == 0
                                                                      else np.float32(height / h))


@inline
def value_at(picture: np.ndarray, y: Real, x: Real) -> Real:
    """Value between four pixels; edges are repeated."""
    h, w = picture.shape
    x, y = min(max(x, np.float32(0)), np.float32(w - 1.001)), min(max(y, np.float32(0)), np.float32(h - 1.001))
    i, j = int(x), int(y)
    fx, fy = x - i, y - j
    upper = picture[j, i] * (1 - fx) + picture[j, i + 1] * fx
    return upper * (1 - fy) + (picture[j + 1, i] * (1 - fx) + picture[j + 1, i + 1] * fx) * fy


@compiled
def misfit(one: np.ndarray, other: np.ndarray, top: int, left: int, u: Real, v: Real) -> Real:
    """Mean square of a patch's difference to where it would have been, without the mean difference."""
    total, square = np.float32(0), np.float32(0)
    for j in range(top, top + PATCH):
        for i in range(left, left + PATCH):
            difference = value_at(other, j + v, i + u) - one[j, i]
            total += difference
            square += difference * difference
    count = np.float32(PATCH * PATCH)
    return square / count - (total / count) ** 2


@compiled
def search(one: np.ndarray, other: np.ndarray, flow: np.ndarray, moved: np.ndarray) -> None:
    """Motion of each patch and its misfit (rows, columns, 3), from the coarser level's."""
    rows, columns = moved.shape[:2]
    half = PATCH // 2
    for turn in range(2):  # down and right, then up and left, so that motion spreads in both directions
        for k in range(rows * columns):
            at = k if turn == 0 else rows * columns - 1 - k
            row, column = at // columns, at % columns
            top, left = row * STRIDE, column * STRIDE
            y, x = min(top + half, one.shape[0] - 1), min(left + half, one.shape[1] - 1)
            if turn == 0:
                u, v = flow[y, x, 0], flow[y, x, 1]
                best = misfit(one, other, top, left, u, v)
            else:
                u, v, best = moved[row, column, 0], moved[row, column, 1], moved[row, column, 2]
            step, began = (-1 if turn == 0 else 1), best
            for b, a in ((row + step, column), (row, column + step)):
                if 0 <= b < rows and 0 <= a < columns:
                    fit = misfit(one, other, top, left, moved[b, a, 0], moved[b, a, 1])
                    if fit < best:
                        u, v, best = moved[b, a, 0], moved[b, a, 1], fit
            if turn == 0 or best < began:
                u, v, best = descend(one, other, top, left, u, v, best)
            moved[row, column, 0], moved[row, column, 1], moved[row, column, 2] = u, v, best


@compiled
def descend(one: np.ndarray, other: np.ndarray, top: int, left: int, u: Real, v: Real, best: Real
            ) -> tuple[Real, Real, Real]:
    """Gauss-Newton steps from a motion to one that fits better (inverse compositional; Baker and Matthews 2004)."""
    h, w = one.shape
    xx, xy, yy, sx, sy = np.float32(0), np.float32(0), np.float32(0), np.float32(0), np.float32(0)
    for j in range(top, top + PATCH):
        for i in range(left, left + PATCH):
            dx = np.float32(0.5) * (one[j, min(i + 1, w - 1)] - one[j, max(i - 1, 0)])
            dy = np.float32(0.5) * (one[min(j + 1, h - 1), i] - one[max(j - 1, 0), i])
            xx, xy, yy, sx, sy = xx + dx * dx, xy + dx * dy, yy + dy * dy, sx + dx, sy + dy
    count = np.float32(PATCH * PATCH)
    xx, xy, yy = xx - sx * sx / count, xy - sx * sy / count, yy - sy * sy / count
    damped = np.float32(1e-4) * count
    xx, yy = xx + damped, yy + damped
    area = xx * yy - xy * xy
    p, q = u, v
    for _ in range(STEPS):
        total, gx, gy = np.float32(0), np.float32(0), np.float32(0)
        for j in range(top, top + PATCH):
            for i in range(left, left + PATCH):
                dx = np.float32(0.5) * (one[j, min(i + 1, w - 1)] - one[j, max(i - 1, 0)])
                dy = np.float32(0.5) * (one[min(j + 1, h - 1), i] - one[max(j - 1, 0), i])
                difference = value_at(other, j + q, i + p) - one[j, i]
                total, gx, gy = total + difference, gx + dx * difference, gy + dy * difference
        gx, gy = gx - total * sx / count, gy - total * sy / count
        du, dv = (yy * gx - xy * gy) / area, (xx * gy - xy * gx) / area
        p, q = p - du, q - dv
        if abs(p - u) > PATCH or abs(q - v) > PATCH:
            break
        if abs(du) + abs(dv) < np.float32(0.01):
            break
    fit = misfit(one, other, top, left, p, q) if abs(p - u) <= PATCH and abs(q - v) <= PATCH else best
    return (p, q, fit) if fit < best else (u, v, best)


@compiled
def spread(one: np.ndarray, other: np.ndarray, moved: np.ndarray, flow: np.ndarray) -> None:
    """Motion of each pixel: the mean of the patches over it, by how well they fit there."""
    h, w = one.shape
    rows, columns = moved.shape[:2]
    least = np.float32(2e-3)
    for y in range(h):
        last_row = min(y // STRIDE, rows - 1)
        first_row = max(last_row - (PATCH // STRIDE - 1), 0)
        for x in range(w):
            last_column = min(x // STRIDE, columns - 1)
            total, u, v = np.float32(0), np.float32(0), np.float32(0)
            for row in range(first_row, last_row + 1):
                for column in range(max(last_column - (PATCH // STRIDE - 1), 0), last_column + 1):
                    p, q = moved[row, column, 0], moved[row, column, 1]
                    weight = 1 / (least + abs(value_at(other, y + q, x + p) - one[y, x]))
                    total, u, v = total + weight, u + weight * p, v + weight * q
            flow[y, x, 0], flow[y, x, 1] = u / total, v / total


def consistent_motion(ahead: np.ndarray, back: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Motion of two pictures to each other, NaN where the way there and back does not end where it began."""
    found = ahead.copy(), back.copy()
    for one, other, kept in ((ahead, back, found[0]), (back, ahead, found[1])):
        drop_inconsistent(one, other, kept)
    return found


@compiled
def drop_inconsistent(one: np.ndarray, other: np.ndarray, kept: np.ndarray) -> None:
    """NaN where a motion leads out of the picture, or to where the other one does not lead back."""
    h, w = one.shape[:2]
    for y in range(h):
        for x in range(w):
            u, v = x + one[y, x, 0], y + one[y, x, 1]
            if -0.5 < u < w - 0.5 and -0.5 < v < h - 0.5:
                back_u, back_v = value_at(other[:, :, 0], v, u), value_at(other[:, :, 1], v, u)
                if abs(back_u + one[y, x, 0]) <= AGREE and abs(back_v + one[y, x, 1]) <= AGREE:
                    continue
            kept[y, x, 0], kept[y, x, 1] = np.nan, np.nan
