"""The picture that the paths make, of planes of both frames.

Each pixel is taken from both frames, by time, or from the one that shows its point. Where the four cells around it
follow one path, that is interpolated between them; else the pixel is the mean over their paths (overlapped block motion
compensation; Orchard and Sullivan 1994). Pictures are sampled by the cubics of Mitchell and Netravali (1988, B = 1 - k,
C = k / 2) within the range of the four pixels around a place: Catmull and Rom's where both frames show the same detail,
and B-splines, which average over noise, where they do not.

Cells are (rows, columns, 8) float32: a path as in `choose`, the share k of its detail that both frames show, and 0.
"""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np

from postfx.interpolate.choose import JOINED, SMOOTH, TURNING, differ, is_within
from postfx.interpolate.choose import OTHER as OTHER
from postfx.kernels.numeric import Real, compiled, inline, load_eight, mix_eight, store_eight, uncounted
from postfx.kernels.vectors import in_lanes

ZERO, ONE = np.float32(0), np.float32(1)
NOTHING = (ZERO, ZERO, ZERO)
LEAST = np.float32(1e-4)
"""Weight of a frame that does not show a point, so that something is there where none does."""
LITTLE = np.float32(1e-3)
"""Weight below which a frame does not count."""
ALIKE, UNSURE, TINY = np.float32(0.05**2), np.float32(0.2), np.float32(1e-6)
"""Relative difference of both frames, squared, from which a path counts less beside others; what stands for it where
only one frame shows a point; light below which nothing counts."""
NEARER, HIDDEN = np.float32(0.1), np.float32(0.35)
"""Relative difference in depth of two surfaces, and what is left of the share of a path that is hidden by another."""
CRISP = np.float32(0.97)
"""Share of detail that both frames show from which a cell keeps all of it, up to the middles of those beside: light
does not leak over an edge."""
ELSE, DARK = np.float32(100), np.float32(0.05)
"""How many times as bright as in the other frame something is that only one of them shows, and the share of the middle
light, summed over channels, that counts as dark there."""
Cell: TypeAlias = tuple[Real, Real, Real, Real, Real, Real, Real]
"""A path of a cell, and how sharp the pictures are there."""
Taps: TypeAlias = tuple[Real, Real, Real, Real]
Three: TypeAlias = tuple[Real, Real, Real]

CUBIC = ((0.0, 1.0, 0.0, 0.0), (-0.5, 0.0, 0.5, 0.0), (1.0, -2.5, 2.0, -0.5), (-0.5, 1.5, -1.5, 0.5))
SPLINE = ((1 / 6, 2 / 3, 1 / 6, 0.0), (-0.5, 0.0, 0.5, 0.0), (0.5, -1.0, 0.5, 0.0), (-1 / 6, 0.5, -0.5, 1 / 6))
"""Weights of four taps around a place after the second one: of its powers from 0 to 3."""


def weights_at(v: Any, t: Any, sharp: Any, places: int = 1) -> Any:
    """Weights of four taps around places in [0, 1) after the second one: sharp times CUBIC, and SPLINE."""
    ones, first, squares, cubes = (v.constant(places * soft).to(v.constant(places * cubic), sharp)
                                   for soft, cubic in zip(SPLINE, CUBIC, strict=True))
    return ((cubes * t + squares) * t + first) * t + ones


@in_lanes(4, results=4)
def taps_at(v: Any, t: Any, sharp: Any) -> Any:
    """The same in numbers."""
    weights = weights_at(v, t, sharp)
    return tuple(weights.number(k) for k in range(4))


def weigh_taps(v: Any, flat: Any, at: Any, stride: Any, down: list[Any], across: list[Any]) -> tuple[Any, ...]:
    """Weighted sum of 4x4 pixels of three numbers, within the range of the middle four. Reads a third of a pixel on."""
    rows = [v.load(flat, v.step(at, stride, j)) for j in range(4)]
    column = v.sum([row * weight for row, weight in zip(rows, down, strict=True)])
    value = v.sum([column.part(3 * i, 4) * weight for i, weight in enumerate(across)])
    p, q, r, s = (row.part(3 * i, 4) for row in rows[1:3] for i in (1, 2))
    low, high = p.least(q).least(r.least(s)), p.largest(q).largest(r.largest(s))
    value = value.largest(low).least(high)
    return tuple(value.number(k) for k in range(3))


@in_lanes(16, results=3)
def cubic_three(v: Any, flat: Any, at: Any, stride: Any, down: Any, across: Any, sharp: Any) -> Any:
    """The same at a place after the pixel of the second taps."""
    under, beside = weights_at(v, down, sharp), weights_at(v, across, sharp)
    return weigh_taps(v, flat, at, stride, *([side.number(k) for k in range(4)] for side in (under, beside)))


@in_lanes(16, results=6)
def cubic_pair(v: Any, before: Any, at: Any, after: Any, there: Any, stride: Any, taps: Any, first: Any) -> Any:
    """The same in both frames, by weights as `aim_row` leaves them."""
    across, down, beside, under = (v.numbers(taps, v.step(first, 4 * k), 4) for k in range(4))
    return weigh_taps(v, before, at, stride, down, across) + weigh_taps(v, after, there, stride, under, beside)


@in_lanes(4, results=0)
def aim(v: Any, paths: Any, at: Any, y: Any, x: Any, low: Any, right: Any, corners: Any, place: Any, taps: Any,
        first: Any) -> Any:
    """`corner_of` and weights of taps for both ends of a path."""
    pixels, offsets = v.corners(v.join(x, y, x, y), v.load(paths, at), v.join(right, low, right, low))
    v.store(corners, place, pixels)
    sharp, = v.numbers(paths, v.step(at, 6), 1)
    v.store(taps, first, weights_at(v, offsets.pick([k // 4 for k in range(16)]), sharp, 4))


@uncounted
def aim_row(y: int, h: int, paths: np.ndarray, corners: np.ndarray, taps: np.ndarray) -> None:
    """The same for a row of pixels: corners (w, 4), across and down in both frames, and taps of each, flat. Loads of
    pictures that wait for places in a loop of their own overlap more."""
    w, flat = paths.shape[0], paths.reshape(-1)
    v, low, right = np.float32(y), np.float32(h - 1), np.float32(w - 1)
    for x in range(w):
        aim(flat, 8 * x, v, np.float32(x), low, right, corners, 4 * x, taps, 16 * x)


@inline
def cubic_one(picture: np.ndarray, j: int, i: int, down: Taps, across: Taps, c: int) -> Real:
    """One channel at a place after a pixel: likewise, anywhere in the picture."""
    h, w = picture.shape[:2]
    first, third, fourth = max(i - 1, 0), min(i + 1, w - 1), min(i + 2, w - 1)
    value, low = ZERO, min(j + 1, h - 1)
    for b in range(4):
        row = min(max(j - 1 + b, 0), h - 1)
        value += down[b] * (across[0] * picture[row, first, c] + across[1] * picture[row, i, c]
                            + across[2] * picture[row, third, c] + across[3] * picture[row, fourth, c])
    p, q, r, s = picture[j, i, c], picture[j, third, c], picture[low, i, c], picture[low, third, c]
    return min(max(value, min(min(p, q), min(r, s))), max(max(p, q), max(r, s)))


@inline
def corner_of(y: Real, x: Real, h: int, w: int) -> tuple[int, int, Real, Real]:
    """The pixel before a place, which is held in the picture, and how far after it the place lies, down and across."""
    y, x = min(max(y, ZERO), np.float32(h - 1)), min(max(x, ZERO), np.float32(w - 1))
    j, i = int(y), int(x)
    return j, i, np.float32(y - j), np.float32(x - i)


@inline
def shares_of(first: Real, last: Real, t: Real) -> tuple[Real, Real]:
    """Weights of the two frames, 1 together, by whether they show a point."""
    one, other = (ONE - t) * (first + LEAST), t * (last + LEAST)
    share = one / (one + other)
    share = ZERO if share < LITTLE else ONE if share > ONE - LITTLE else share
    return share, ONE - share


@inline
def settle(one: Real, other: Real, first: Real, last: Real, dim: Real) -> tuple[Real, Real]:
    """Weights of the two frames: all for the nearer one where light differs that much that it is something else, such
    as a spark, which a mean would show twice. dim: light that counts as dark."""
    apart = (min(one, other) > 0) & (max(first, last) > ELSE * max(min(first, last), dim))
    nearer = np.float32(one >= other)
    return (nearer, ONE - nearer) if apart else (one, other)


@inline
def weights_of(path: Cell, known_before: np.ndarray, known_after: np.ndarray, y: int, x: int, t: Real
               ) -> tuple[Real, Real]:
    """Weights of the two frames for a path of a pixel."""
    first = path[4] if is_within(known_before, y + path[1], x + path[0]) else ZERO
    last = path[5] if is_within(known_after, y + path[3], x + path[2]) else ZERO
    shares: tuple[Real, Real] = shares_of(first, last, t)
    return shares


@inline
def is_line(cells: np.ndarray, y: int, x: int, j: int, i: int, c: int) -> bool:
    """Whether from a cell to the one (j, i) on the path changes about as much as to the next one, or from the last."""
    rows, columns = cells.shape[:2]
    step = cells[y + j, x + i, c] - cells[y, x, c]
    last = step - cells[y, x, c] + cells[max(y - j, 0), max(x - i, 0), c]
    coming = cells[min(y + 2 * j, rows - 1), min(x + 2 * i, columns - 1), c] - cells[y + j, x + i, c] - step
    return bool(min(abs(last), abs(coming)) <= SMOOTH)


@in_lanes(4)
def most_apart(v: Any, cells: Any, at: Any, beside: Any, below: Any, beyond: Any) -> Any:
    """The largest difference of a cell's path to those of three others."""
    here = v.load(cells, at)
    one, other, third = ((v.load(cells, place) - here).magnitude() for place in (beside, below, beyond))
    apart = one.largest(other).largest(third)
    pair = apart.part(0, 2).largest(apart.part(2, 2))
    return pair.part(0, 1).largest(pair.part(1, 1)).number(0)


@uncounted
def join_cells(y0: int, y1: int, cells: np.ndarray) -> None:
    """Mark cells that follow one path with those to the right and below by 1, and by 2 where it changes evenly, as on
    what turns."""
    rows, columns = cells.shape[:2]
    flat = cells.reshape(-1)
    for y in range(y0, y1):
        j = min(y + 1, rows - 1) - y
        for x in range(columns):
            i = min(x + 1, columns - 1) - x
            at = 8 * (y * columns + x)
            right, low = at + 8 * i, at + 8 * j * columns
            beyond = low + 8 * i
            is_one = (flat[at + 4] == flat[right + 4]) & (flat[at + 5] == flat[right + 5]) \
                & (flat[at + 4] == flat[low + 4]) & (flat[at + 5] == flat[low + 5]) \
                & (flat[at + 4] == flat[beyond + 4]) & (flat[at + 5] == flat[beyond + 5])
            apart = most_apart(flat, at, right, low, beyond)
            if is_one and apart <= JOINED:
                flat[at + 7] = ONE
                continue
            is_even = is_one and apart <= TURNING
            for c in range(4):
                one, beside, under = cells[y, x, c], cells[y, x + i, c], cells[y + j, x, c]
                across = cells[y + j, x + i, c]
                is_even = is_even and abs(one - beside - under + across) <= SMOOTH
            for c in range(4):
                is_even = is_even and is_line(cells, y, x, 0, i, c) and is_line(cells, y, x, j, 0, c) \
                    and is_line(cells, y + j, x, 0, i, c) and is_line(cells, y, x + i, j, 0, c)
            flat[at + 7] = 2 * ONE if is_even else ZERO


@inline
def between_cells(position: int, size: Real, count: int) -> tuple[int, int, Real]:
    """The cells before and after a pixel's middle, and how far it is from the first to the second one."""
    half = np.float32(0.5)
    at = min(max((position + half) * size - half, ZERO), np.float32(count - 1))
    first = int(at)
    return first, min(first + 1, count - 1), np.float32(at - first)


@uncounted
def place_row(columns: int, size: Real, places: np.ndarray, across: np.ndarray) -> None:
    """Places of the cells before the pixels of a row (w,) in a row of cells, and how far the pixels lie after them."""
    for x in range(places.size):
        left, _, across[x] = between_cells(x, size, columns)
        places[x] = 8 * left


@uncounted
def find_row(cells: np.ndarray, rows: int, columns: int, size: Real, y: int, places: np.ndarray, across: np.ndarray,
             paths: np.ndarray) -> None:
    """Paths (w, 8) of a row of pixels between four cells that are joined. The last number is 0 where they are not, and
    the others are left. cells: flat. size: cells of a pixel. places, across: as `place_row` leaves them."""
    top, low, down = between_cells(y, size, rows)
    flat, row, six, seven, eight = paths.reshape(-1), np.uint64(8 * columns), np.uint64(6), np.uint64(7), np.uint64(8)
    upper_row, lower_row, last = np.uint64(top) * row, np.uint64(low) * row, row - eight
    for x in range(paths.shape[0]):
        left, right, share = places[x], min(places[x] + eight, last), across[x]
        p, q, r, s = upper_row + left, upper_row + right, lower_row + left, lower_row + right
        joined = cells[p + seven]
        if joined > 0:
            upper = mix_eight(load_eight(cells, p), load_eight(cells, q), share)
            lower = mix_eight(load_eight(cells, r), load_eight(cells, s), share)
            store_eight(flat, 8 * x, mix_eight(upper, lower, down))
            most = max(max(cells[p + six], cells[q + six]), max(cells[r + six], cells[s + six]))
            if most > CRISP:
                paths[x, 6] = most
        paths[x, 7] = joined


@uncounted
def weigh_known_row(paths: np.ndarray, known_before: np.ndarray, known_after: np.ndarray, y: int, t: Real,
                    shares: np.ndarray) -> None:
    """Weights (w, 2) of both frames for a row of pixels, where something is not known."""
    for x in range(paths.shape[0]):
        path = paths[x, 0], paths[x, 1], paths[x, 2], paths[x, 3], paths[x, 4], paths[x, 5], paths[x, 6]
        shares[x, 0], shares[x, 1] = weights_of(path, known_before, known_after, y, x, t)


@uncounted
def sample_row(before: np.ndarray, after: np.ndarray, h: int, paths: np.ndarray, corners: np.ndarray, taps: np.ndarray,
               masked: bool, t: Real, shares: np.ndarray, dim: Real, row: np.ndarray) -> None:
    """Colours (w, 3) of a row of pixels where cells are joined and no edge is near, and weights (w, 2) of both frames,
    unless something is masked; NaN elsewhere. before, after: flat. corners, taps: as `aim_row` leaves them."""
    w = row.shape[0]
    both, rest = shares_of(ONE, ONE, t)
    for x in range(w):
        row[x, 0] = np.nan
        if paths[x, 7] == 0:
            continue
        i, j, n, m = corners[x, 0], corners[x, 1], corners[x, 2], corners[x, 3]
        if not ((min(j, m) >= 1) & (max(j, m) < h - 2) & (min(i, n) >= 1) & (max(i, n) < w - 4)):
            continue
        if masked:
            one, other = shares[x, 0], shares[x, 1]
        else:
            one, other = (both, rest) if min(paths[x, 4], paths[x, 5]) == 1 else shares_of(paths[x, 4], paths[x, 5], t)
            shares[x, 0], shares[x, 1] = one, other
        a, b, c, p, q, r = cubic_pair(before, ((j - 1) * w + i - 1) * 3, after, ((m - 1) * w + n - 1) * 3, 3 * w, taps,
                                      16 * x)
        one, other = settle(one, other, a + b + c, p + q + r, dim)
        row[x, 0], row[x, 1], row[x, 2] = one * a + other * p, one * b + other * q, one * c + other * r


@uncounted
def colour_beside(picture: np.ndarray, j: int, i: int, v: Real, u: Real, sharp: Real) -> Three:
    """Three channels at a place after a pixel, near the edge of the picture."""
    down, across = taps_at(v, sharp), taps_at(u, sharp)
    return (cubic_one(picture, j, i, down, across, 0), cubic_one(picture, j, i, down, across, 1),
            cubic_one(picture, j, i, down, across, 2))


@inline
def colour_at(picture: np.ndarray, flat: np.ndarray, y: Real, x: Real, sharp: Real) -> Three:
    """Three channels at a place."""
    h, w = picture.shape[:2]
    j, i, v, u = corner_of(y, x, h, w)
    if 1 <= j < h - 2 and 1 <= i < w - 4:
        inner: Three = cubic_three(flat, ((j - 1) * w + i - 1) * 3, 3 * w, v, u, sharp)
        return inner
    beside: Three = colour_beside(picture, j, i, v, u, sharp)
    return beside


@inline
def cell_of(flat: np.ndarray, at: int) -> Cell:
    """The path of a cell."""
    return flat[at], flat[at + 1], flat[at + 2], flat[at + 3], flat[at + 4], flat[at + 5], flat[at + 6]


@uncounted
def share_cells(flat: np.ndarray, p: int, q: int, r: int, s: int, across: Real, down: Real, mixture: np.ndarray
                ) -> None:
    """Shares (4,) of four cells in a pixel, by its place between them. Of cells that follow one path one has it all."""
    mixture[0], mixture[1] = (ONE - down) * (ONE - across), (ONE - down) * across
    mixture[2], mixture[3] = down * (ONE - across), down * across
    for k in range(1, 4):
        path = cell_of(flat, 8 * (q if k == 1 else r if k == 2 else s))
        for j in range(k):
            other = cell_of(flat, 8 * (p if j == 0 else q if j == 1 else r))
            if mixture[j] > 0 and not differ(path, other) and path[4] == other[4] and path[5] == other[5]:
                mixture[j], mixture[k] = mixture[j] + mixture[k], ZERO
                break


@inline
def depth_along(near: np.ndarray, far: np.ndarray, path: Cell, y: int, x: int) -> tuple[Real, bool]:
    """Depth of the surface that a path shows at a pixel, 0 where it leads to another one, and whether both frames show
    it."""
    h, w = near.shape[:2]
    half = np.float32(0.5)
    j, i, _, _ = corner_of(y + half + path[1], x + half + path[0], h, w)
    m, n, _, _ = corner_of(y + half + path[3], x + half + path[2], h, w)
    one, other = near[j, i, 0], far[m, n, 0]
    if path[4] == 0 or path[5] == 0:
        return other if path[4] == 0 else one, False
    is_one = abs(one - other) <= NEARER * min(one, other)
    return half * (one + other) * is_one, is_one


@uncounted
def hide_cells(flat: np.ndarray, near: np.ndarray, far: np.ndarray, p: int, q: int, r: int, s: int, y: int, x: int,
               mixture: np.ndarray) -> None:
    """Take its share (4,) of a pixel from a path whose surface lies behind one that both frames show there, by another
    one of four cells."""
    one, is_one = depth_along(near, far, cell_of(flat, 8 * p), y, x)
    two, is_two = depth_along(near, far, cell_of(flat, 8 * q), y, x)
    three, is_three = depth_along(near, far, cell_of(flat, 8 * r), y, x)
    four, is_four = depth_along(near, far, cell_of(flat, 8 * s), y, x)
    depths, shown = (one, two, three, four), (is_one, is_two, is_three, is_four)
    nearest = np.float32(np.inf)
    for k in range(4):
        if mixture[k] > 0 and shown[k]:
            nearest = min(nearest, depths[k])
    for k in range(4):
        if depths[k] > (ONE + NEARER) * nearest:
            mixture[k] *= HIDDEN


@uncounted
def mix_row(cells: np.ndarray, size: Real, before: np.ndarray, after: np.ndarray, known_before: np.ndarray,
            known_after: np.ndarray, near: np.ndarray, far: np.ndarray, y: int, t: Real, paths: np.ndarray,
            shares: np.ndarray, dim: Real, row: np.ndarray, mixture: np.ndarray) -> None:
    """Colours (w, 3) of those pixels of a row that are NaN: by their path between joined cells, or by those of the four
    cells around them, whose shares of the pixel (w, 4) are written to `mixture`."""
    h, w = before.shape[:2]
    flat, flat_before, flat_after = cells.reshape(-1), before.reshape(-1), after.reshape(-1)
    flat_paths, rows, columns = paths.reshape(-1), cells.shape[0], cells.shape[1]
    top, low, down = between_cells(y, size, rows)
    for x in range(w):
        if row[x, 0] == row[x, 0]:
            continue
        left, right, across = between_cells(x, size, columns)
        joined = paths[x, 7] > 0
        red, green, blue, whole, best = ZERO, ZERO, ZERO, ZERO, ZERO
        if not joined:
            share_cells(flat, top * columns + left, top * columns + right, low * columns + left, low * columns + right,
                        across, down, mixture[x])
            if near.size:
                hide_cells(flat, near, far, top * columns + left, top * columns + right, low * columns + left,
                           low * columns + right, y, x, mixture[x])
        for k in range(1 if joined else 4):
            share, path = ONE, cell_of(flat_paths, 8 * x)
            if not joined:
                share = mixture[x, k]
                if share == 0:
                    continue
                path = cell_of(flat, 8 * ((low if k > 1 else top) * columns + (right if k % 2 else left)))
            first, last = weights_of(path, known_before, known_after, y, x, t)
            if joined:
                shares[x, 0], shares[x, 1] = first, last
            a, b, c = NOTHING
            p, q, r = NOTHING
            if first > 0:
                a, b, c = colour_at(before, flat_before, y + path[1], x + path[0], path[6])
            if last > 0:
                p, q, r = colour_at(after, flat_after, y + path[3], x + path[2], path[6])
            if not joined:
                light = abs(a) + abs(b) + abs(c) + abs(p) + abs(q) + abs(r)
                apart = UNSURE if first == 0 or last == 0 else (abs(a - p) + abs(b - q) + abs(c - r)) / (light + TINY)
                share /= ALIKE + apart * apart
                mixture[x, k] = share
                if share > best:
                    best, shares[x, 0], shares[x, 1] = share, first, last
                    for z in range(7):
                        paths[x, z] = path[z]
            first, last = settle(first, last, a + b + c, p + q + r, dim)
            red, green, blue = (red + share * (first * a + last * p), green + share * (first * b + last * q),
                                blue + share * (first * c + last * r))
            whole += share
        row[x, 0], row[x, 1], row[x, 2] = red / whole, green / whole, blue / whole
        if not joined:
            for k in range(4):
                mixture[x, k] /= whole


@uncounted
def add_path(before: np.ndarray, after: np.ndarray, path: Cell, y: int, x: int, one: Real, other: Real,
             row: np.ndarray) -> None:
    """Add what a path shows at a pixel, by weights of the two frames, to its channels."""
    h, w, count = before.shape
    j, i, down, across = corner_of(y + path[1], x + path[0], h, w)
    m, n, under, beside = corner_of(y + path[3], x + path[2], h, w)
    first, second, third, fourth = (taps_at(down, path[6]), taps_at(across, path[6]), taps_at(under, path[6]),
                                    taps_at(beside, path[6]))
    for c in range(count):
        if one > 0:
            row[x, c] += one * cubic_one(before, j, i, first, second, c)
        if other > 0:
            row[x, c] += other * cubic_one(after, m, n, third, fourth, c)


@uncounted
def light_row(cells: np.ndarray, size: Real, before: np.ndarray, after: np.ndarray, known_before: np.ndarray,
              known_after: np.ndarray, y: int, t: Real, paths: np.ndarray, shares: np.ndarray, mixture: np.ndarray,
              row: np.ndarray) -> None:
    """Other light (w, n) of a row of pixels, of the same mixture as their colours."""
    flat, columns = cells.reshape(-1), cells.shape[1]
    top, low, _ = between_cells(y, size, cells.shape[0])
    for x in range(row.shape[0]):
        for c in range(row.shape[1]):
            row[x, c] = ZERO
        if paths[x, 7] > 0:
            add_path(before, after, cell_of(paths.reshape(-1), 8 * x), y, x, shares[x, 0], shares[x, 1], row)
            continue
        left, right, _ = between_cells(x, size, columns)
        for k in range(4):
            path = cell_of(flat, 8 * ((low if k > 1 else top) * columns + (right if k % 2 else left)))
            first, last = weights_of(path, known_before, known_after, y, x, t)
            add_path(before, after, path, y, x, mixture[x, k] * first, mixture[x, k] * last, row)


@uncounted
def take_row(before: np.ndarray, after: np.ndarray, y: int, paths: np.ndarray, shares: np.ndarray, row: np.ndarray
             ) -> None:
    """Data (w, m) of a row of pixels: that of the nearest pixel in the frame that counts more."""
    h, w = before.shape[:2]
    half = np.float32(0.5)
    for x in range(w):
        is_first = shares[x, 0] >= shares[x, 1]
        j, i, _, _ = corner_of(y + half + (paths[x, 1] if is_first else paths[x, 3]),
                               x + half + (paths[x, 0] if is_first else paths[x, 2]), h, w)
        for c in range(row.shape[1]):
            row[x, c] = before[j, i, c] if is_first else after[j, i, c]


@compiled
def compose(y0: int, y1: int, cells: np.ndarray, scale: int, before: np.ndarray, after: np.ndarray,
            known_before: np.ndarray, known_after: np.ndarray, near: np.ndarray, far: np.ndarray, masked: bool,
            t: Real, level: Real, colour: np.ndarray,
            light_before: np.ndarray, light_after: np.ndarray, light: np.ndarray, data_before: np.ndarray,
            data_after: np.ndarray, data: np.ndarray, by_first: Real, by_last: Real, motion: np.ndarray) -> None:
    """The planes between: light is mixed, data is that of the nearest pixel in the frame that counts more.

    before, after, colour: (h, w, 3). light: (h, w, n) alpha, reflectances. data: (h, w, m) depth, normals, ids. motion:
    (h, w, 2) of pixels, or empty: what leads to both frames, times by_first and by_last. scale: pixels of a cell.
    masked: whether anything is not known. level: light in the middle between dark and bright.
    """
    h, w = colour.shape[:2]
    time, size, dim = np.float32(t), np.float32(1 / scale), DARK * np.float32(level)
    flat_cells, flat_before, flat_after = cells.reshape(-1), before.reshape(-1), after.reshape(-1)
    paths, shares, mixture = np.zeros((w, 8), np.float32), np.empty((w, 2), np.float32), np.empty((w, 4), np.float32)
    places, across = np.empty(w, np.uint64), np.empty(w, np.float32)  # unsigned: without tests for those below 0
    corners, taps = np.empty((w, 4), np.int32), np.empty(16 * w, np.float32)
    place_row(cells.shape[1], size, places, across)
    for y in range(y0, y1):
        find_row(flat_cells, cells.shape[0], cells.shape[1], size, y, places, across, paths)
        if masked:
            weigh_known_row(paths, known_before, known_after, y, time, shares)
        aim_row(y, h, paths, corners.reshape(-1), taps)
        sample_row(flat_before, flat_after, h, paths, corners, taps, masked, time, shares, dim, colour[y])
        mix_row(cells, size, before, after, known_before, known_after, near, far, y, time, paths, shares, dim,
                colour[y], mixture)
        if light.shape[2]:
            light_row(cells, size, light_before, light_after, known_before, known_after, y, time, paths, shares,
                      mixture, light[y])
        if data.shape[2]:
            take_row(data_before, data_after, y, paths, shares, data[y])
        if motion.size:
            for x in range(w):
                motion[y, x, 0] = by_first * paths[x, 0] + by_last * paths[x, 2]
                motion[y, x, 1] = by_first * paths[x, 1] + by_last * paths[x, 3]
