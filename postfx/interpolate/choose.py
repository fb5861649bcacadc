"""Which path shows what is at a cell between two frames.

Cells are squares of pixels. `choose_paths` compares what a path shows in both frames, over 8x6 pixels of toned grey
pictures around a cell. A cell keeps the path that arrived at it unless a neighbour's, or the flow's,
agrees much better: edges of planes are coarse, averaged over samples or noisy. A path that only one frame shows cannot
be compared; it counts as a fair match, for it is there by geometry.

Fields of paths are (rows, columns, 6) float32: in pixels of the pictures from the cell to its place in the frame before
(x, y) and in the one after (x, y), and whether each of the two shows the point, 0 or 1. NaN: no path.
"""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np

from postfx.interpolate.paths import ALIKE, FAR, SURE
from postfx.kernels.numeric import Real, compiled, inline, load_eight, store_eight, uncounted
from postfx.kernels.vectors import in_lanes

Path: TypeAlias = tuple[Real, Real, Real, Real, Real, Real]
"""A path of a field."""
MARGIN = 8
"""Pixels around a picture whose paths are compared: its edges, repeated."""
ROWS = 6
"""Rows of eight pixels that are compared."""
OTHER = np.float32(0.3)
"""Pixels by which paths must differ to be worth a comparison."""
BETTER = np.float32(1.5)
"""How many times as well another path must fit to be taken; one of a cell beside, by the misfit of noise more."""
SAME = np.float32(0.5)
"""Pixels by which a flow must differ from the whole way of a cell's path: what is known of that way's curve is better
than a line."""
EXPLAINED = np.float32(2)
"""How many times the misfit of a flow and the noise what leads elsewhere from the flow's ends may have."""
ELSE = np.float32(0.5)
"""Share of a depth below which something is another thing, in front. What stands for depth where there is none never
differs by more."""
STILL, BETTER_STILL = np.float32(0.01), np.float32(4)
"""Pixels below which a path stands still, and how much better another one must fit than that: it is compared between
pixels, where noise is averaged."""
UNSEEN, UNSEEN_NOISE = np.float32(0.12), np.float32(2)
"""What stands for the misfit of a path that cannot be compared: a part that is fixed, and a multiple of the noise's."""
TRUSTED = np.float32(0.5)
"""Share of that misfit below which a path that was thought unseen is seen after all."""
TWIST, EVEN = np.float32(0.15), np.float32(0.5)
"""Change of the way from frame to frame along a pixel from which windows show different things, and pixels by which it
may be uneven from cell to cell."""
BEFORE = np.float32(0.85)
"""Share of the depth of what lies behind a thing that keeps its cell if both frames show it there."""
ONE_THING = np.float32(0.7)
"""Share of the difference to what lies behind it up to which a thing in front may differ from frame to frame."""
MOSTLY = np.float32(0.4)
"""Share of detail from which what stands still is left as it is."""
APART = np.float32(0.15)
"""Misfit from which what stands still must be something else."""
JOINED = np.float32(0.6)
"""Pixels by which paths of cells beside each other may differ for there to be others between them."""
TURNING, SMOOTH = np.float32(3), np.float32(0.25)
"""The same where paths change evenly from cell to cell, and how much that change itself may change."""
RED, GREEN, BLUE = np.float32(0.2126), np.float32(0.7152), np.float32(0.0722)
LUMINANCE = np.array([RED, GREEN, BLUE])
"""Shares of channels in how bright a colour is (BT.709)."""
ZERO, ONE = np.float32(0), np.float32(1)
STEPS = np.array([(0, 0), (0, 1), (1, 0), (0, -1), (-1, 0)])
"""Neighbours whose paths are tried."""
TAPER = (0.25, 0.75, 1.0, 1.0, 1.0, 1.0, 0.75, 0.25)
"""Weights of the eight pixels of a row."""
SLOPES, MOST_NOISE = np.float32((2 * ROWS - 1) * sum(TAPER)), np.float32(4)
"""Slopes that are summed up in a window, and the square of a slope that noise makes at most, in squares of the noise:
even noise of Gauss makes pi between pixels. What differs by more is no noise."""
COUNT = np.float32(ROWS * sum(TAPER))


@inline
def side_path(side: np.ndarray, is_last: int, scale: Real, y: int, x: int) -> Path:
    """A path of one frame's side, in pixels: that frame shows it, the other one if most paths that arrived are seen."""
    seen = np.float32(side[y, x, 4] >= SURE)
    return (scale * side[y, x, 0], scale * side[y, x, 1], scale * side[y, x, 2], scale * side[y, x, 3],
            seen if is_last else ONE, ONE if is_last else seen)


@uncounted
def merge_sides(y0: int, y1: int, first: np.ndarray, first_depth: np.ndarray, last: np.ndarray, last_depth: np.ndarray,
                scale: Real, own: np.ndarray) -> None:
    """The nearer path of both sides at each cell, or their mean where they are alike; NaN without.

    first, last: (rows, columns, 8) in cells, as `paths.close_cracks` leaves them; depths: (rows, columns), FAR where no
    path arrived. scale: pixels of a cell.
    """
    w = first_depth.shape[1]
    half = np.float32(0.5)
    for y in range(y0, y1):
        for x in range(w):
            a, b = first_depth[y, x], last_depth[y, x]
            one, other = side_path(first, 0, scale, y, x), side_path(last, 1, scale, y, x)
            if a < FAR and b < FAR and abs(a - b) <= np.float32(1.5) * ALIKE * min(a, b):
                # each side is sure of its own frame, and asked about the other one
                before, after = (other[4], one[5]) if other[4] + one[5] > 0 else (ONE, ONE)
                one = (half * (one[0] + other[0]), half * (one[1] + other[1]), half * (one[2] + other[2]),
                       half * (one[3] + other[3]), before, after)
            elif not a < b:
                one = other
            for c in range(6):
                own[y, x, c] = one[c]


@inline
def is_within(known: np.ndarray, y: Real, x: Real) -> bool:
    """Whether a place is in the picture, at a pixel that is known."""
    h, w, half = known.shape[0], known.shape[1], np.float32(0.5)
    if not ((x > -half) & (y > -half) & (x < np.float32(w) - half) & (y < np.float32(h) - half)):
        return False
    return bool(known[min(np.uint32(y + half), np.uint32(h - 1)), min(np.uint32(x + half), np.uint32(w - 1))])


@in_lanes(8)
def window_difference(v: Any, before: Any, at: Any, across: Any, down: Any, after: Any, there: Any, across_after: Any,
                      down_after: Any, stride: Any) -> Any:
    """Weighted sum of the differences of two windows."""
    one = v.rows(before, at, stride, across, down, ROWS)
    other = v.rows(after, there, stride, across_after, down_after, ROWS)
    return (v.sum([(a - b).magnitude() for a, b in zip(one, other, strict=True)]) * TAPER).total()


@in_lanes(8, results=2)
def window_detail(v: Any, before: Any, at: Any, across: Any, down: Any, after: Any, there: Any, across_after: Any,
                  down_after: Any, stride: Any) -> Any:
    """Sums of squares of the slopes, across and down: of the difference of two windows, and of their sum."""
    one, right = (v.rows(before, v.step(at, k), stride, across, down, ROWS) for k in (0, 1))
    other, beside = (v.rows(after, v.step(there, k), stride, across_after, down_after, ROWS) for k in (0, 1))
    found = []
    for sign in (-1.0, 1.0):
        rows, next_rows = ([a + b * sign for a, b in zip(some, others, strict=True)]
                           for some, others in ((one, other), (right, beside)))
        slopes = [b - a for a, b in (*zip(rows, rows[1:], strict=False), *zip(rows, next_rows, strict=True))]
        found.append((v.sum([slope * slope for slope in slopes]) * TAPER).total())
    return tuple(found)


@inline
def window_at(y: Real, x: Real, stride: int) -> tuple[int, Real, Real]:
    """Index of the window around a place, and the window's share of a pixel, across and down."""
    v, u = y - np.float32(0.5 * (ROWS - 1)), x - np.float32(3.5)
    j, i = int(np.floor(v)), int(np.floor(u))
    return (j + MARGIN) * stride + i + MARGIN, np.float32(u - i), np.float32(v - j)


@inline
def misfit(before: np.ndarray, after: np.ndarray, known_before: np.ndarray, known_after: np.ndarray, y: Real, x: Real,
           path: Path) -> Real:
    """Mean difference of two toned pictures around the places that a path leads to; -1 where one is not in its picture.

    before, after: flat, with margins.
    """
    ay, ax, by, bx = y + path[1], x + path[0], y + path[3], x + path[2]
    if not (is_within(known_before, ay, ax) and is_within(known_after, by, bx)):
        return -ONE
    stride = known_before.shape[1] + 2 * MARGIN
    at, across, down = window_at(ay, ax, stride)
    there, across_after, down_after = window_at(by, bx, stride)
    return window_difference(before, at, across, down, after, there, across_after, down_after, stride) / COUNT


@inline
def is_still(path: Path) -> bool:
    """Whether a path stands still."""
    return bool(max(max(abs(path[0]), abs(path[1])), max(abs(path[2]), abs(path[3]))) < STILL)


@inline
def sharpness(before: np.ndarray, after: np.ndarray, known: np.ndarray, y: Real, x: Real, path: Path, noise: Real
              ) -> Real:
    """Share of what two pictures show around the places of a path that both show, 0 to 1: the rest is noise (Wiener).
    noise: misfit of paths that are right.

    It is 1 where a path leads out of a picture or only one shows it, as nothing is known, and where most of what stands
    still is detail, as pixels meet pixels there.
    """
    ay, ax, by, bx = y + path[1], x + path[0], y + path[3], x + path[2]
    if path[4] + path[5] < 2 or not (is_within(known, ay, ax) and is_within(known, by, bx)):
        return ONE
    stride = known.shape[1] + 2 * MARGIN
    at, across, down = window_at(ay, ax, stride)
    there, across_after, down_after = window_at(by, bx, stride)
    apart, common = window_detail(before, at, across, down, after, there, across_after, down_after, stride)
    apart = min(apart, MOST_NOISE * noise * noise * SLOPES)
    share = max(ONE - apart / common, ZERO) if common > 0 else ONE
    return ONE if share > MOSTLY and is_still(path) else share


@inline
def turned_sharpness(before: np.ndarray, after: np.ndarray, known: np.ndarray, y: Real, x: Real, cells: np.ndarray,
                     row: int, column: int, scale: int, noise: Real, above: np.ndarray) -> Real:
    """The same over 8x6 places whose paths change from place to place as from a cell to the next ones. above (8, 2) is
    written to."""
    size, flat = ONE / np.float32(scale), cells.reshape(-1)
    stride = 8 * cells.shape[1]
    at = row * stride + 8 * column
    apart, common, stands = ZERO, ZERO, MOST_NOISE * noise * noise * SLOPES
    for j in range(ROWS + 1):
        left, left_after = ZERO, ZERO
        for i in range(8):
            down, across = np.float32(j - 0.5 * ROWS), np.float32(i - 3.5)
            v, u = y + down, x + across
            down, across = down * size, across * size
            ax = flat[at] + across * (flat[at + 8] - flat[at]) + down * (flat[at + stride] - flat[at])
            ay = flat[at + 1] + across * (flat[at + 9] - flat[at + 1]) + down * (flat[at + stride + 1] - flat[at + 1])
            bx = flat[at + 2] + across * (flat[at + 10] - flat[at + 2]) + down * (flat[at + stride + 2] - flat[at + 2])
            by = flat[at + 3] + across * (flat[at + 11] - flat[at + 3]) + down * (flat[at + stride + 3] - flat[at + 3])
            one, other = value_at(before, known, v + ay, u + ax), value_at(after, known, v + by, u + bx)
            if i and j:
                right, right_after, under, under_after = one - left, other - left_after, one - above[i, 0], \
                    other - above[i, 1]
                apart += (right - right_after) ** 2 + (under - under_after) ** 2
                common += (right + right_after) ** 2 + (under + under_after) ** 2
            left, left_after, above[i, 0], above[i, 1] = one, other, one, other
    apart = min(apart, stands)
    return max(ONE - apart / common, ZERO) if common > 0 else ONE


@inline
def path_of(field: np.ndarray, y: int, x: int) -> Path:
    """A cell's path in numbers: a view of the array would cost more than all else."""
    return field[y, x, 0], field[y, x, 1], field[y, x, 2], field[y, x, 3], field[y, x, 4], field[y, x, 5]


@inline
def path_by(flow: np.ndarray, y: int, x: int, back: Real, on: Real) -> Path:
    """The path of a flow, by shares of it that lead to the frame before and to the one after."""
    u, v = flow[y, x, 0], flow[y, x, 1]
    return back * u, back * v, on * u, on * v, ONE, ONE


@in_lanes(4)
def most_apart(v: Any, side: Any, at: Any, own: Any, place: Any, scale: Any) -> Any:
    """The largest difference of a path of a side, in cells, to one of a field."""
    apart = (v.load(side, at) * scale - v.load(own, place)).magnitude()
    pair = apart.part(0, 2).largest(apart.part(2, 2))
    return pair.part(0, 1).largest(pair.part(1, 1)).number(0)


@in_lanes(4)
def most_changed(v: Any, field: Any, at: Any, beside: Any, below: Any) -> Any:
    """The largest difference of a path of a field to those of the next cells."""
    here = v.load(field, at)
    apart = (here - v.load(field, beside)).magnitude().largest((here - v.load(field, below)).magnitude())
    pair = apart.part(0, 2).largest(apart.part(2, 2))
    return pair.part(0, 1).largest(pair.part(1, 1)).number(0)


@uncounted
def measure_change(y0: int, y1: int, first: np.ndarray, last: np.ndarray, scale: Real, own: np.ndarray) -> None:
    """How much both sides' paths differ from a cell's own one, and that from those to the right and below, in pixels:
    its last two numbers."""
    h, w = own.shape[:2]
    flat, flat_first, flat_last = own.reshape(-1), first.reshape(-1), last.reshape(-1)
    for y in range(y0, y1):
        low = 0 if y == h - 1 else 8 * w
        for x in range(w):
            at = 8 * (y * w + x)
            apart, other = most_apart(flat_first, at, flat, at, scale), most_apart(flat_last, at, flat, at, scale)
            apart = apart if flat_first[at] == flat_first[at] else ZERO  # where there is no path
            own[y, x, 6] = max(apart, other) if flat_last[at] == flat_last[at] else apart
            own[y, x, 7] = most_changed(flat, at, at if x == w - 1 else at + 8, at + low)


@inline
def is_alone(own: np.ndarray, y: int, x: int) -> bool:
    """Whether no path of both sides at a cell and at the four beside it differs from its own: known by their changes
    from cell to cell."""
    most, left, up = np.float32(0.99) * OTHER, max(x - 1, 0), max(y - 1, 0)
    right, low = min(x + 1, own.shape[1] - 1), min(y + 1, own.shape[0] - 1)
    beside = max(own[y, right, 6], own[low, x, 6]) + own[y, x, 7]
    return bool(max(own[y, x, 6], beside) <= most and own[y, left, 6] + own[y, left, 7] <= most
                and own[up, x, 6] + own[up, x, 7] <= most)


@inline
def differ(one: Path, other: Path) -> bool:
    """Whether two paths lead to other places."""
    return bool(abs(one[0] - other[0]) > OTHER or abs(one[1] - other[1]) > OTHER or abs(one[2] - other[2]) > OTHER
                or abs(one[3] - other[3]) > OTHER)


@inline
def depth_at(depth: np.ndarray, y: Real, x: Real, size: Real) -> Real:
    """Depth (rows, columns, 1) that a frame shows at a pixel."""
    half = np.float32(0.5)
    j = min(max(int((y + half) / size), 0), depth.shape[0] - 1)
    return depth[j, min(max(int((x + half) / size), 0), depth.shape[1] - 1), 0]


@inline
def value_at(toned: np.ndarray, known: np.ndarray, y: Real, x: Real) -> Real:
    """A toned picture between four pixels."""
    stride = known.shape[1] + 2 * MARGIN
    y, x = min(max(y, -ONE), np.float32(known.shape[0])), min(max(x, -ONE), np.float32(known.shape[1]))
    j, i = int(np.floor(y)), int(np.floor(x))
    at, down, across = (j + MARGIN) * stride + i + MARGIN, np.float32(y - j), np.float32(x - i)
    upper = toned[at] + across * (toned[at + 1] - toned[at])
    lower = toned[at + stride] + across * (toned[at + stride + 1] - toned[at + stride])
    return upper + down * (lower - upper)


@inline
def difference(before: np.ndarray, after: np.ndarray, known: np.ndarray, y: Real, x: Real, path: Path) -> Real:
    """Difference of two toned pictures where a path leads to."""
    return abs(value_at(before, known, y + path[1], x + path[0]) - value_at(after, known, y + path[3], x + path[2]))


@inline
def contrast(before: np.ndarray, after: np.ndarray, known: np.ndarray, y: Real, x: Real, path: Path, other: Path
             ) -> Real:
    """Difference of what two paths show, in the frame where it is less."""
    one = value_at(before, known, y + path[1], x + path[0]) - value_at(before, known, y + other[1], x + other[0])
    return min(abs(one), abs(value_at(after, known, y + path[3], x + path[2])
                             - value_at(after, known, y + other[3], x + other[2])))


@inline
def is_turning(own: np.ndarray, y: int, x: int, size: Real) -> bool:
    """Whether around a cell one frame is turned or stretched evenly against the other one, by much."""
    if not (1 <= y < own.shape[0] - 1 and 1 <= x < own.shape[1] - 1):
        return False
    if max(own[y - 1, x, 7], own[y, x - 1, 7]) + own[y, x, 7] < np.float32(0.99) * TWIST * size:
        return False
    most, uneven = ZERO, ZERO
    for c in range(2):
        for j, i in ((0, 1), (1, 0)):
            one, other = own[y - j, x - i, c], own[y + j, x + i, c]
            after, other_after = own[y - j, x - i, c + 2], own[y + j, x + i, c + 2]
            most = max(most, abs(other_after - after - other + one))
            bend, bend_after = one + other - 2 * own[y, x, c], after + other_after - 2 * own[y, x, c + 2]
            uneven = max(uneven, max(abs(bend), abs(bend_after)))
    return bool(2 * TWIST * size < most and uneven < EVEN)


@inline
def end_misfit(before: np.ndarray, after: np.ndarray, known_before: np.ndarray, known_after: np.ndarray,
               ends: np.ndarray, seen: np.ndarray, y: Real, x: Real, size: Real) -> Real:
    """Misfit of the path that a frame's planes give what it shows at a pixel; -1 where the other frame hides it."""
    half = np.float32(0.5)
    j = min(max(int((y + half) / size), 0), seen.shape[0] - 1)
    i = min(max(int((x + half) / size), 0), seen.shape[1] - 1)
    path = size * ends[j, i, 0], size * ends[j, i, 1], size * ends[j, i, 2], size * ends[j, i, 3], ONE, ONE
    return misfit(before, after, known_before, known_after, y, x, path) if seen[j, i] > 0 else -ONE


@uncounted
def is_explained(before: np.ndarray, after: np.ndarray, known_before: np.ndarray, known_after: np.ndarray,
                 first_ends: np.ndarray, first_seen: np.ndarray, last_ends: np.ndarray, last_seen: np.ndarray,
                 y: Real, x: Real, path: Path, size: Real, most: Real) -> bool:
    """Whether what a flow shows in one of the frames goes elsewhere by its planes, with a misfit of `most` or less: the
    flow then leads from one thing to another."""
    one = end_misfit(before, after, known_before, known_after, first_ends, first_seen, y + path[1], x + path[0], size)
    if 0 <= one <= most:
        return True
    other = end_misfit(before, after, known_before, known_after, last_ends, last_seen, y + path[3], x + path[2], size)
    return bool(0 <= other <= most)


@uncounted
def choose_paths(y0: int, y1: int, before: np.ndarray, after: np.ndarray, known_before: np.ndarray,
                 known_after: np.ndarray, own: np.ndarray, first: np.ndarray, last: np.ndarray, ahead: np.ndarray,
                 back: np.ndarray, mirrored: np.ndarray, first_ends: np.ndarray, first_seen: np.ndarray,
                 last_ends: np.ndarray, last_seen: np.ndarray, first_depth: np.ndarray, last_depth: np.ndarray,
                 near: np.ndarray, far: np.ndarray, t: Real, scale: int, noise: Real, cells: np.ndarray) -> None:
    """The path of each cell (rows, columns, 8): its own, or another one around it or of the flow that fits much better;
    the last two numbers are left.

    before, after: toned, flat, with margins. known: (h, w), False under overlays. own: (rows, columns, 8), as
    `measure_change` leaves it.
    first, last: both sides, whose paths around a cell are tried. ahead, back: (rows, columns, 2) flow of both frames to
    the other one, in pixels, or empty. mirrored: likewise of what the frame after reflects, to the one before.
    first_ends, first_seen, last_ends, last_seen: of `paths.Paths`, for flows.
    first_depth, last_depth: (rows, columns) of what arrived of each side. near, far: (rows, columns, 1) depth of both
    frames. scale: pixels of a cell. noise: misfit of paths that are right.
    """
    h, w = own.shape[:2]
    unseen = UNSEEN + UNSEEN_NOISE * noise
    steps, middle, time = STEPS.shape[0], np.float32(0.5 * (scale - 1)), np.float32(t)
    around, size = 2 * steps, np.float32(scale)
    flowing = around + 2 if ahead.size else around
    count = flowing + 1 if mirrored.size else flowing
    flat_own, flat_first, flat_last, flat = own.reshape(-1), first.reshape(-1), last.reshape(-1), cells.reshape(-1)
    for y in range(y0, y1):
        for x in range(w):
            alone, at = is_alone(own, y, x), 8 * (y * w + x)
            mine, v, u = path_of(own, y, x), scale * y + middle, scale * x + middle
            has_flow = ahead.size and (ahead[y, x, 0] == ahead[y, x, 0] or back[y, x, 0] == back[y, x, 0])
            if (alone and not (has_flow or mirrored.size)) or (mine[4] + mine[5] == 2 and is_turning(own, y, x, size)):
                store_eight(flat, at, load_eight(flat_own, at))  # around what turns, no window that is moved alone fits
                continue
            taken, tried, is_seen, margin = mine, mine, False, ZERO
            depth = min(first_depth[y, x], last_depth[y, x])
            better = BETTER_STILL if is_still(mine) else BETTER
            best = np.float32(-2)  # not looked at yet: many cells have no other path around them
            for k in range(around if alone else 0, count):
                if k < around:
                    step = k if k < steps else k - steps
                    j, i = y + STEPS[step, 0], x + STEPS[step, 1]
                    if not (0 <= j < h and 0 <= i < w):
                        continue
                    side = flat_first if k < steps else flat_last
                    if not most_apart(side, 8 * (j * w + i), flat_own, at, size) > OTHER:
                        continue
                    path = side_path(first if k < steps else last, int(k >= steps), size, j, i)
                elif k == flowing:
                    path = path_by(mirrored, y, x, time, time - ONE)
                    if path[0] == path[0]:  # there, the motion is that of the place to which the path leads
                        j = min(max(int(y + path[3] / size + np.float32(0.5)), 0), h - 1)
                        i = min(max(int(x + path[2] / size + np.float32(0.5)), 0), w - 1)
                        path = path_by(mirrored, j, i, time, time - ONE)
                elif k == around:
                    path = path_by(ahead, y, x, -time, ONE - time)
                else:
                    path = path_by(back, y, x, time, time - ONE)
                if path[0] != path[0] or not (differ(path, taken) and differ(path, tried)):
                    continue
                tried = path
                beyond = depth
                if k < around:
                    beyond = first_depth[j, i] if k < steps else last_depth[j, i]
                elif k < flowing:
                    if max(abs(path[2] - path[0] - mine[2] + mine[0]),
                           abs(path[3] - path[1] - mine[3] + mine[1])) < SAME:
                        continue
                    one = depth_at(near, v + path[1], u + path[0], size)
                    other = depth_at(far, v + path[3], u + path[2], size)
                    if max(one, other) < ELSE * beyond and beyond < FAR:  # two bars that look alike are not one
                        continue
                    beyond = min(one, other)
                if depth < BEFORE * beyond and mine[4] + mine[5] == 2:  # the wall fits around a thin bar, not at it
                    allowed = difference(before, after, known_before, v, u, path) + noise \
                        + ONE_THING * contrast(before, after, known_before, v, u, mine, path)
                    if difference(before, after, known_before, v, u, mine) <= allowed:
                        continue
                margin = noise if k < around else margin
                if best < -ONE:
                    best = misfit(before, after, known_before, known_after, v, u, mine)
                    fits = 0 <= best < TRUSTED * unseen
                    is_seen = fits and k < around
                    if not fits and (best < 0 or mine[4] + mine[5] < 2):
                        best = unseen
                if best <= noise:
                    break
                fit = misfit(before, after, known_before, known_after, v, u, path)
                fits = 0 <= fit < TRUSTED * unseen
                if not fits and (fit < 0 or path[4] + path[5] < 2):
                    fit = unseen
                if not (better if best < APART else BETTER) * fit + margin < best:
                    continue
                if around <= k < flowing and fits and mine[4] + mine[5] < 2:
                    if is_explained(before, after, known_before, known_after, first_ends, first_seen, last_ends,
                                    last_seen, v, u, path, size, EXPLAINED * (fit + noise)):
                        continue
                best, taken, is_seen = fit, path, fits
            if is_seen:
                taken = taken[0], taken[1], taken[2], taken[3], ONE, ONE
            for c in range(6):
                cells[y, x, c] = taken[c]


@compiled
def measure_detail(y0: int, y1: int, before: np.ndarray, after: np.ndarray, known: np.ndarray, scale: int,
                   noise: Real, cells: np.ndarray) -> None:
    """How sharp the pictures are at cells, measured once for two by two that follow one path, around their middle. y0
    is even. Cells are joined."""
    rows, columns = cells.shape[:2]
    above = np.empty((8, 2), np.float32)
    middle = np.float32(0.5 * (scale - 1))
    for y in range(y0, y1):
        for x in range(columns):
            path, j, i = path_of(cells, y, x), y - y % 2, x - x % 2
            if (j, i) != (y, x):
                one = path_of(cells, j, i)
                if not differ(path, one) and path[4] + path[5] == one[4] + one[5]:
                    cells[y, x, 6] = cells[j, i, 6]
                    continue
            if cells[y, x, 7] > 1 and y < rows - 1 and x < columns - 1:
                cells[y, x, 6] = ONE if path[4] + path[5] < 2 else turned_sharpness(
                    before, after, known, scale * y + middle, scale * x + middle, cells, y, x, scale, noise, above)
                continue
            at = np.float32(scale - 0.5) if (j, i) == (y, x) else middle
            cells[y, x, 6] = sharpness(before, after, known, scale * y + at, scale * x + at, path, noise)


@uncounted
def misfits(before: np.ndarray, after: np.ndarray, known_before: np.ndarray, known_after: np.ndarray, ends: np.ndarray,
            seen: np.ndarray, scale: int, found: np.ndarray) -> None:
    """Misfit of one of 4x4 cells of the frame after that the frame before shows too; -1 elsewhere."""
    middle, size = np.float32(0.5 * (scale - 1)), np.float32(scale)
    for row in range(found.shape[0]):
        for column in range(found.shape[1]):
            y, x = 4 * row + 2, 4 * column + 2
            path = size * ends[y, x, 0], size * ends[y, x, 1], size * ends[y, x, 2], size * ends[y, x, 3], ONE, ONE
            fit = misfit(before, after, known_before, known_after, size * y + middle, size * x + middle, path)
            found[row, column] = fit if seen[y, x] else -ONE
