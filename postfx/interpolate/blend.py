"""The picture that the paths make, of planes of both frames.

Each pixel is taken from both frames, by time, or from the one that shows its point. Where the four cells around it
follow one path, that is interpolated between them; else the pixel is the mean over their paths (overlapped block motion
compensation; Orchard and Sullivan 1994). The cubics by which pictures are sampled (`postfx.sampling`) keep detail where
both frames show the same, and average over noise where they do not.

Cells are (rows, columns, 8) float32: a path as in `choose`, the share k of its detail that both frames show, and 0.
"""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np

from postfx.frame import Role
from postfx.interpolate.choose import JOINED, OTHER, SMOOTH, TURNING, is_within
from postfx.kernels.numeric import Real, compiled, inline, load_eight, mix_eight, store_eight, uncounted
from postfx.kernels.vectors import in_lanes
from postfx.sampling import aim_row, colour_at, corner_of, cubic_one, cubic_pair, has_taps, taps_at

ZERO, ONE = np.float32(0), np.float32(1)
NOTHING = (ZERO, ZERO, ZERO)
LEAST = np.float32(1e-4)
"""Weight of a frame that does not show a point, so that something is there where none does."""
LITTLE = np.float32(1e-3)
"""Weight below which a frame does not count."""
ALIKE, UNSURE, TINY = np.float32(0.05**2), np.float32(0.2), np.float32(1e-6)
"""Relative difference of both frames, squared, from which a path counts less beside others; what stands for it where
only one frame shows a point; light below which nothing counts."""
NEARER, HIDDEN = np.float32(0.1), np.float32(0.2)
"""Relative difference in depth of two surfaces, and what is left of the share of a path that is hidden by another."""
CRISP = np.float32(0.97)
"""Share of detail that both frames show from which a cell keeps all of it, up to the middles of those beside: light
does not leak over an edge."""
ELSE, DARK = np.float32(100), np.float32(0.05)
"""How many times as bright as in the other frame something is that only one of them shows, and the share of the middle
light, summed over channels, that counts as dark there."""
Pair: TypeAlias = tuple[np.ndarray, np.ndarray]
"""A plane of both frames."""
Cell: TypeAlias = tuple[Real, Real, Real, Real, Real, Real, Real]
"""A path of a cell, and how sharp the pictures are there."""


def stack_planes(planes: list[np.ndarray], size: tuple[int, ...]) -> np.ndarray:
    """All channels (h, w, n) of planes of this size, of which there may be none."""
    if len(planes) == 1:
        return np.ascontiguousarray(planes[0], np.float32)
    return np.concatenate(planes, -1, dtype=np.float32) if planes else np.empty((*size, 0), np.float32)


def split_planes(stack: np.ndarray, group: dict[Role | str, Pair]) -> dict[Role | str, np.ndarray]:
    """The planes in a stack of them."""
    ends = np.cumsum([pair[0].shape[2] for pair in group.values()])
    return {key: stack[..., end - pair[0].shape[2]:end] for (key, pair), end in zip(group.items(), ends, strict=True)}


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
def widen_row(cells: np.ndarray, row: int, columns: int, places: np.ndarray, across: np.ndarray, wide: np.ndarray
              ) -> None:
    """A row of cells between which the pixels of a row lie (w, 8), flat; the last number is the larger share of detail
    of both. cells: flat. places, across: as `place_row` leaves them."""
    eight, six = np.uint64(8), np.uint64(6)
    first, last = np.uint64(row * columns) * eight, np.uint64(columns - 1) * eight
    for x in range(places.size):
        p, q = first + places[x], first + min(places[x] + eight, last)
        store_eight(wide, 8 * x, mix_eight(load_eight(cells, p), load_eight(cells, q), across[x]))
        wide[8 * x + 7] = max(cells[p + six], cells[q + six])


@uncounted
def find_row(cells: np.ndarray, row: int, columns: int, down: Real, places: np.ndarray, upper: np.ndarray,
             lower: np.ndarray, paths: np.ndarray) -> None:
    """Paths (w, 8) of a row of pixels between two rows of cells, from `row` on, as `widen_row` leaves them. The last
    number is 0 where four cells are not joined, and the others are left. cells: flat."""
    first, seven, flat = np.uint64(8 * row * columns), np.uint64(7), paths.reshape(-1)
    for x in range(paths.shape[0]):
        joined = cells[first + places[x] + seven]
        if joined > 0:
            store_eight(flat, 8 * x, mix_eight(load_eight(upper, 8 * x), load_eight(lower, 8 * x), down))
            most = max(upper[8 * x + 7], lower[8 * x + 7])
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
def sample_row(before: np.ndarray, after: np.ndarray, h: int, paths: np.ndarray, pixels: np.ndarray, taps: np.ndarray,
               masked: bool, t: Real, shares: np.ndarray, dim: Real, row: np.ndarray) -> None:
    """Colours (w, 3) of a row of pixels where cells are joined and no edge is near, and weights (w, 2) of both frames,
    unless something is masked; NaN elsewhere. before, after: flat. pixels, taps: as `aim_row` leaves them."""
    w = row.shape[0]
    both, rest = shares_of(ONE, ONE, t)
    for x in range(w):
        row[x, 0] = np.nan
        if paths[x, 7] == 0:
            continue
        i, j, n, m = pixels[x, 0], pixels[x, 1], pixels[x, 2], pixels[x, 3]
        if not has_taps(i, j, n, m, h, w):
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


@inline
def cell_of(flat: np.ndarray, at: int) -> Cell:
    """The path of a cell."""
    return flat[at], flat[at + 1], flat[at + 2], flat[at + 3], flat[at + 4], flat[at + 5], flat[at + 6]


@in_lanes(4)
def path_apart(v: Any, cells: Any, at: Any, other: Any) -> Any:
    """The largest difference of two cells' paths."""
    apart = (v.load(cells, at) - v.load(cells, other)).magnitude()
    pair = apart.part(0, 2).largest(apart.part(2, 2))
    return pair.part(0, 1).largest(pair.part(1, 1)).number(0)


@inline
def are_alike(cells: np.ndarray, at: int, other: int) -> bool:
    """Whether two cells follow one path. cells: flat."""
    return bool((cells[at + 4] == cells[other + 4]) & (cells[at + 5] == cells[other + 5])
                and path_apart(cells, at, other) <= OTHER)


@uncounted
def list_row(cells: np.ndarray, rows: int, wide: int, size: Real, y: int, places: np.ndarray, across: np.ndarray,
             paths: np.ndarray, row: np.ndarray, mixture: np.ndarray, columns: np.ndarray, listed: np.ndarray) -> int:
    """How many paths there are at those pixels of a row that are NaN: one between joined cells, or those of the four
    cells around, whose shares of the pixel by its place between them are written to `mixture` (w, 4). Of cells that
    follow one path one has it all. The paths (n, 8), flat, and their columns (n,) are listed. cells: flat."""
    count, left, eight, last = 0, -1, np.uint64(8), np.uint64(8 * (wide - 1))
    top, low, down = between_cells(y, size, rows)
    upper_row, lower_row = np.uint64(8 * top * wide), np.uint64(8 * low * wide)
    flat = paths.reshape(-1)
    p, q, r, s = upper_row, upper_row, lower_row, lower_row
    q_is_p, r_is_p, r_is_q, s_is_p, s_is_q, s_is_r = False, False, False, False, False, False
    for x in range(row.shape[0]):
        if row[x, 0] == row[x, 0]:
            continue
        if paths[x, 7] > 0:
            store_eight(listed, 8 * count, load_eight(flat, 8 * x))
            columns[count] = x
            count += 1
            continue
        if places[x] != left:
            left = places[x]
            beside = min(left + eight, last)
            p, q, r, s = upper_row + left, upper_row + beside, lower_row + left, lower_row + beside
            q_is_p, r_is_p, r_is_q = are_alike(cells, q, p), are_alike(cells, r, p), are_alike(cells, r, q)
            s_is_p, s_is_q, s_is_r = are_alike(cells, s, p), are_alike(cells, s, q), are_alike(cells, s, r)
        share = across[x]
        a, b, c, d = ((ONE - down) * (ONE - share), (ONE - down) * share, down * (ONE - share), down * share)
        if (a > 0) & q_is_p:
            a, b = a + b, ZERO
        if (a > 0) & r_is_p:
            a, c = a + c, ZERO
        elif (b > 0) & r_is_q:
            b, c = b + c, ZERO
        if (a > 0) & s_is_p:
            a, d = a + d, ZERO
        elif (b > 0) & s_is_q:
            b, d = b + d, ZERO
        elif (c > 0) & s_is_r:
            c, d = c + d, ZERO
        mixture[x, 0], mixture[x, 1], mixture[x, 2], mixture[x, 3] = a, b, c, d
        for k in range(4):
            if mixture[x, k] > 0:
                store_eight(listed, 8 * count, load_eight(cells, p if k == 0 else q if k == 1 else r if k == 2 else s))
                columns[count] = x
                count += 1
    return count


@inline
def depth_along(near: np.ndarray, far: np.ndarray, one: int, other: int, path: Cell) -> tuple[Real, Real]:
    """Depth of the surface that a path shows, 0 where it leads to another one, and that depth again if both frames show
    the surface, else infinity. one, other: the nearest pixels, in flat planes of depth."""
    before, after = near[one], far[other]
    if path[4] == 0 or path[5] == 0:
        return after if path[4] == 0 else before, np.float32(np.inf)
    is_one = abs(before - after) <= NEARER * min(before, after)
    depth = np.float32(0.5) * (before + after) * is_one
    return depth, depth if is_one else np.float32(np.inf)


@uncounted
def sample_listed(before: np.ndarray, after: np.ndarray, known_before: np.ndarray, known_after: np.ndarray,
                  near: np.ndarray, far: np.ndarray, y: int, t: Real, count: int, columns: np.ndarray,
                  listed: np.ndarray, pixels: np.ndarray, taps: np.ndarray, found: np.ndarray) -> None:
    """What listed paths show (n, 10): colours of both frames, 0 of one without weight; weights of both; and depths of
    `depth_along`. near, far: flat, or empty."""
    h, w = before.shape[:2]
    flat_before, flat_after = before.reshape(-1), after.reshape(-1)
    for n in range(count):
        x, path = int(columns[n]), cell_of(listed, 8 * n)
        first, last = weights_of(path, known_before, known_after, y, x, t)
        found[n, 6], found[n, 7] = first, last
        a, b, c = NOTHING
        p, q, r = NOTHING
        i, j, k, m = pixels[n, 0], pixels[n, 1], pixels[n, 2], pixels[n, 3]
        if (first > 0) & (last > 0) & has_taps(i, j, k, m, h, w):
            a, b, c, p, q, r = cubic_pair(flat_before, ((j - 1) * w + i - 1) * 3, flat_after,
                                          ((m - 1) * w + k - 1) * 3, 3 * w, taps, 16 * n)
        else:
            if first > 0:
                a, b, c = colour_at(before, flat_before, y + path[1], x + path[0], path[6])
            if last > 0:
                p, q, r = colour_at(after, flat_after, y + path[3], x + path[2], path[6])
        found[n, 0], found[n, 1], found[n, 2], found[n, 3], found[n, 4], found[n, 5] = a, b, c, p, q, r
        if near.size:
            found[n, 8], found[n, 9] = depth_along(near, far, pixels[n, 5] * w + pixels[n, 4],
                                                   pixels[n, 7] * w + pixels[n, 6], path)


@uncounted
def mix_row(listed: np.ndarray, pixels_listed: np.ndarray, found: np.ndarray, has_depth: bool, dim: Real,
            paths: np.ndarray, pixels: np.ndarray, shares: np.ndarray, mixture: np.ndarray, row: np.ndarray) -> None:
    """Colours (w, 3) of those pixels of a row that are NaN, by what their listed paths show. Shares in `mixture` become
    those of what is shown, and the path, its pixels and the weights of a pixel those that count most.

    A path whose surface lies behind one that both frames show there by another path keeps a part of its share.
    """
    n, flat, flat_pixels = 0, paths.reshape(-1), pixels.reshape(-1)
    for x in range(row.shape[0]):
        if row[x, 0] == row[x, 0]:
            continue
        if paths[x, 7] > 0:
            first, last = found[n, 6], found[n, 7]
            shares[x, 0], shares[x, 1] = first, last
            a, b, c, p, q, r = found[n, 0], found[n, 1], found[n, 2], found[n, 3], found[n, 4], found[n, 5]
            first, last = settle(first, last, a + b + c, p + q + r, dim)
            row[x, 0], row[x, 1], row[x, 2] = first * a + last * p, first * b + last * q, first * c + last * r
            n += 1
            continue
        red, green, blue, whole, best, taken = ZERO, ZERO, ZERO, ZERO, ZERO, n
        nearest, end = np.float32(np.inf), n
        for k in range(4):
            if mixture[x, k] > 0:
                nearest = min(nearest, found[end, 9])
                end += 1
        behind = (ONE + NEARER) * nearest if has_depth else np.float32(np.inf)
        for k in range(4):
            share = mixture[x, k]
            if share == 0:
                continue
            first, last = found[n, 6], found[n, 7]
            a, b, c, p, q, r = found[n, 0], found[n, 1], found[n, 2], found[n, 3], found[n, 4], found[n, 5]
            share = share * HIDDEN if has_depth and found[n, 8] > behind else share
            light = abs(a) + abs(b) + abs(c) + abs(p) + abs(q) + abs(r)
            apart = UNSURE if first == 0 or last == 0 else (abs(a - p) + abs(b - q) + abs(c - r)) / (light + TINY)
            share /= ALIKE + apart * apart
            mixture[x, k] = share
            if share > best:
                best, taken = share, n
            first, last = settle(first, last, a + b + c, p + q + r, dim)
            red, green, blue = (red + share * (first * a + last * p), green + share * (first * b + last * q),
                                blue + share * (first * c + last * r))
            whole += share
            n += 1
        row[x, 0], row[x, 1], row[x, 2] = red / whole, green / whole, blue / whole
        shares[x, 0], shares[x, 1] = found[taken, 6], found[taken, 7]
        for z in range(7):
            flat[8 * x + z] = listed[8 * taken + z]
        for z in range(4, 8):
            flat_pixels[8 * x + z] = pixels_listed[8 * taken + z]
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
def take_row(before: np.ndarray, after: np.ndarray, wide: int, pixels: np.ndarray, shares: np.ndarray, row: np.ndarray
             ) -> None:
    """Data (w, m) of a row of pixels: that of the nearest pixel in the frame that counts more. before, after: flat."""
    count, width = np.uint64(row.shape[1]), np.uint64(wide)
    for x in range(row.shape[0]):
        is_first = shares[x, 0] >= shares[x, 1]
        one = (np.uint64(pixels[x, 5]) * width + np.uint64(pixels[x, 4])) * count
        other = (np.uint64(pixels[x, 7]) * width + np.uint64(pixels[x, 6])) * count
        for c in range(count):
            row[x, c] = before[one + c] if is_first else after[other + c]


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
    columns, pixels, taps = np.arange(w).astype(np.float32), np.empty((w, 8), np.int32), np.empty(16 * w, np.float32)
    listed, found = np.empty(32 * w, np.float32), np.empty((4 * w, 10), np.float32)
    columns_listed, pixels_listed, taps_listed = (np.empty(4 * w, np.float32), np.empty((4 * w, 8), np.int32),
                                                  np.empty(64 * w, np.float32))
    rows, wide = cells.shape[:2]
    place_row(wide, size, places, across)
    upper, lower, top_known, low_known = np.empty(8 * w, np.float32), np.empty(8 * w, np.float32), -1, -1
    for y in range(y0, y1):
        top, low, down = between_cells(y, size, rows)
        if top != top_known:
            if top == low_known:
                upper, lower, low_known = lower, upper, -1
            else:
                widen_row(flat_cells, top, wide, places, across, upper)
            top_known = top
        if low != low_known:
            widen_row(flat_cells, low, wide, places, across, lower)
            low_known = low
        find_row(flat_cells, top, wide, down, places, upper, lower, paths)
        if masked:
            weigh_known_row(paths, known_before, known_after, y, time, shares)
        aim_row(y, h, w, columns, w, paths.reshape(-1), pixels.reshape(-1), taps)
        sample_row(flat_before, flat_after, h, paths, pixels, taps, masked, time, shares, dim, colour[y])
        count = list_row(flat_cells, rows, wide, size, y, places, across, paths, colour[y], mixture, columns_listed,
                         listed)
        if count:
            aim_row(y, h, w, columns_listed, count, listed, pixels_listed.reshape(-1), taps_listed)
            sample_listed(before, after, known_before, known_after, near.reshape(-1), far.reshape(-1), y, time, count,
                          columns_listed, listed, pixels_listed, taps_listed, found)
            mix_row(listed, pixels_listed.reshape(-1), found, near.size > 0, dim, paths, pixels, shares, mixture,
                    colour[y])
        if light.shape[2]:
            light_row(cells, size, light_before, light_after, known_before, known_after, y, time, paths, shares,
                      mixture, light[y])
        if data.shape[2]:
            take_row(data_before.reshape(-1), data_after.reshape(-1), w, pixels, shares, data[y])
        if motion.size:
            for x in range(w):
                motion[y, x, 0] = by_first * paths[x, 0] + by_last * paths[x, 2]
                motion[y, x, 1] = by_first * paths[x, 1] + by_last * paths[x, 3]
