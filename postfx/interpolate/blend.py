"""Which path shows what is at a pixel between two frames, and the picture that the paths make.

`choose_paths` compares what a path shows in both frames, over 5x5 pixels of toned pictures. A pixel keeps the path that
arrived at it unless a neighbour's, or the flow's, agrees much better: edges of planes are coarse, averaged over samples
or noisy. A path that only one frame shows cannot be compared; it counts as a fair match, for it is there by geometry.
`compose` then takes each pixel from both frames, by time, or from the one that shows its point. Where neighbours follow
other paths, the pixel is the mean of all of them (overlapped block motion compensation; Orchard and Sullivan 1994).

Fields of paths are (h, w, 6) float32: from the pixel to its place in the frame before (x, y), in the one after (x, y),
and whether each of the two shows the point, 0 or 1. NaN: no path.
"""

from __future__ import annotations

from typing import TypeAlias

import numpy as np

from postfx.interpolate.paths import ALIKE, FAR
from postfx.kernels.image import catmull_rom
from postfx.kernels.numeric import Real, compiled, inline

Path: TypeAlias = tuple[Real, Real, Real, Real, Real, Real]
"""A path of a field."""
REACH, SIDE = 2, 5
"""Pixels around a pixel that are compared, and along the side of their square."""
OTHER = np.float32(0.3)
"""Pixels by which paths must differ to be worth a comparison."""
BETTER = np.float32(1.5)
"""How many times as well another path must fit to be taken."""
UNSEEN, UNSEEN_NOISE = np.float32(0.12), np.float32(2)
"""What stands for the misfit of a path that cannot be compared: a part that is fixed, and a multiple of the noise's."""
TRUSTED = np.float32(0.5)
"""Share of that misfit below which a path that was thought unseen is seen after all."""
SURE = np.float32(0.7)
"""Share of the paths that arrive at a pixel that must be seen by the other frame: a sample of it has pixels around."""
ZERO, ONE = np.float32(0), np.float32(1)
STEPS = np.array([(0, 0), *((d * y, d * x) for d in (1, 2) for y, x in ((0, 1), (1, 0), (0, -1), (-1, 0)))])
"""Neighbours whose paths are tried."""
LEAST = np.float32(1e-4)
"""Weight of a frame that does not show a point, so that something is there where none does."""


@compiled
def merge_sides(first: np.ndarray, first_depth: np.ndarray, last: np.ndarray, last_depth: np.ndarray,
                fields: np.ndarray) -> None:
    """Fields of three: of both sides as the nearer one, of the frame before, and of the frame after.

    first, last: (h, w, 6) as `paths.close_cracks` leaves them; depths: (h, w), FAR where no path arrived.
    """
    h, w = first_depth.shape
    half = np.float32(0.5)
    for y in range(h):
        for x in range(w):
            a, b = first_depth[y, x], last_depth[y, x]
            for c in range(6):
                fields[1, y, x, c] = first[y, x, c] if a < FAR else np.float32(np.nan)
                fields[2, y, x, c] = last[y, x, c] if b < FAR else np.float32(np.nan)
            if a < FAR:
                fields[1, y, x, 4], fields[1, y, x, 5] = ONE, np.float32(first[y, x, 4] >= SURE)
            if b < FAR:
                fields[2, y, x, 4], fields[2, y, x, 5] = np.float32(last[y, x, 4] >= SURE), ONE
            both = a < FAR and b < FAR and abs(a - b) <= np.float32(1.5) * ALIKE * min(a, b)
            for c in range(4):
                nearer = fields[1, y, x, c] if a < b else fields[2, y, x, c]
                fields[0, y, x, c] = half * (first[y, x, c] + last[y, x, c]) if both else nearer
            if both:  # each side is sure of its own frame, and asked about the other one
                one, other = fields[2, y, x, 4], fields[1, y, x, 5]
                fields[0, y, x, 4], fields[0, y, x, 5] = (one, other) if one + other > 0 else (ONE, ONE)
            else:
                for c in range(4, 6):
                    fields[0, y, x, c] = fields[1, y, x, c] if a < b else fields[2, y, x, c]


@compiled
def fill_holes(field: np.ndarray, depth: np.ndarray) -> None:
    """Give pixels without a path that of the farthest of the next ones to the left, to the right, above and below: what
    is uncovered is background. Without any, the pixel stands still."""
    h, w = depth.shape
    best = np.full((h, w), -ONE, np.float32)
    filled = np.zeros((h, w, 6), np.float32)
    for turn in range(4):
        lines, length = (h, w) if turn < 2 else (w, h)
        for line in range(lines):
            j, i, known = 0, 0, False
            for k in range(length):
                at = k if turn % 2 == 0 else length - 1 - k
                y, x = (line, at) if turn < 2 else (at, line)
                if field[y, x, 0] == field[y, x, 0]:
                    j, i, known = y, x, True
                elif known and depth[j, i] > best[y, x]:
                    best[y, x] = depth[j, i]
                    filled[y, x] = field[j, i]
    for y in range(h):
        for x in range(w):
            if field[y, x, 0] != field[y, x, 0]:
                field[y, x] = filled[y, x]
                if best[y, x] < 0:
                    field[y, x, 4], field[y, x, 5] = ONE, ONE


@inline
def lerp(picture: np.ndarray, top: int, low: int, left: int, right: int, down: Real, across: Real, c: int) -> Real:
    """Value between four pixels."""
    upper = picture[top, left, c] + (picture[top, right, c] - picture[top, left, c]) * across
    return upper + (picture[low, left, c] + (picture[low, right, c] - picture[low, left, c]) * across - upper) * down


@inline
def is_within(known: np.ndarray, y: Real, x: Real) -> bool:
    """Whether a place is in the picture, at a pixel that is known."""
    h, w = known.shape
    if not (-0.5 < x < w - 0.5 and -0.5 < y < h - 0.5):
        return False
    return bool(known[min(int(y + np.float32(0.5)), h - 1), min(int(x + np.float32(0.5)), w - 1)])


@compiled
def misfit(before: np.ndarray, after: np.ndarray, known_before: np.ndarray, known_after: np.ndarray, y: int, x: int,
           path: Path, most: Real) -> Real:
    """Mean difference of two toned pictures around the places that a path leads to; -1 where one is not in its picture.

    It is not added up further than to `most`.
    """
    h, w = known_before.shape
    ax, ay, bx, by = x + path[0], y + path[1], x + path[2], y + path[3]
    if not (is_within(known_before, ay, ax) and is_within(known_after, by, bx)):
        return -ONE
    i, j, k, m = int(np.floor(ax)), int(np.floor(ay)), int(np.floor(bx)), int(np.floor(by))
    across, down, across_after, down_after = ax - i, ay - j, bx - k, by - m
    i, j, k, m = i - REACH, j - REACH, k - REACH, m - REACH
    channels = before.shape[2]
    total, most = ZERO, most * np.float32(channels * SIDE * SIDE)
    inside = min(i, j, k, m) >= 0 and max(i, k) < w - SIDE and max(j, m) < h - SIDE
    for row in range(SIDE):
        for column in range(SIDE):
            if inside:
                for c in range(channels):
                    total += abs(lerp(before, j + row, j + row + 1, i + column, i + column + 1, down, across, c)
                                 - lerp(after, m + row, m + row + 1, k + column, k + column + 1, down_after,
                                        across_after, c))
                continue
            top, low = min(max(j + row, 0), h - 1), min(max(j + row + 1, 0), h - 1)
            left, right = min(max(i + column, 0), w - 1), min(max(i + column + 1, 0), w - 1)
            up, under = min(max(m + row, 0), h - 1), min(max(m + row + 1, 0), h - 1)
            near, far = min(max(k + column, 0), w - 1), min(max(k + column + 1, 0), w - 1)
            for c in range(channels):
                total += abs(lerp(before, top, low, left, right, down, across, c)
                             - lerp(after, up, under, near, far, down_after, across_after, c))
        if total > most:
            break
    return total / np.float32(channels * SIDE * SIDE)


@inline
def path_at(field: np.ndarray, y: int, x: int) -> Path:
    """A pixel's path in numbers: a view of the array would cost more than all else."""
    return field[y, x, 0], field[y, x, 1], field[y, x, 2], field[y, x, 3], field[y, x, 4], field[y, x, 5]


@inline
def path_of(fields: np.ndarray, k: int, y: int, x: int) -> Path:
    """Likewise, of one of several fields."""
    return (fields[k, y, x, 0], fields[k, y, x, 1], fields[k, y, x, 2], fields[k, y, x, 3], fields[k, y, x, 4],
            fields[k, y, x, 5])


@inline
def differ(one: Path, other: Path) -> bool:
    """Whether two paths lead to other places."""
    return bool(abs(one[0] - other[0]) > OTHER or abs(one[1] - other[1]) > OTHER or abs(one[2] - other[2]) > OTHER
                or abs(one[3] - other[3]) > OTHER)


@compiled
def choose_paths(y0: int, y1: int, before: np.ndarray, after: np.ndarray, known_before: np.ndarray,
                 known_after: np.ndarray, own: np.ndarray, fields: np.ndarray, flows: np.ndarray, noise: Real,
                 chosen: np.ndarray) -> None:
    """The path of each pixel: its own, or another one around it or of the flow that fits much better.

    before, after: (h, w, 3) toned. known: (h, w), False under overlays. own: (h, w, 6). fields: (k, h, w, 6), whose
    paths around a pixel are tried. flows: (m, h, w, 6), whose path of the pixel is. noise: misfit of paths that are
    right.
    """
    h, w = own.shape[:2]
    unseen = UNSEEN + UNSEEN_NOISE * noise
    steps, channels = STEPS.shape[0], chosen.shape[2]
    around = fields.shape[0] * steps
    for y in range(y0, y1):
        for x in range(w):
            mine = path_at(own, y, x)
            taken, is_seen = mine, False
            best = np.float32(-2)  # not looked at yet: many pixels have no other path around them
            for k in range(around + flows.shape[0]):
                j, i = y, x
                if k < around:
                    j, i = y + STEPS[k % steps, 0], x + STEPS[k % steps, 1]
                    if not (0 <= j < h and 0 <= i < w):
                        continue
                path = path_of(fields, k // steps, j, i) if k < around else path_of(flows, k - around, j, i)
                if path[0] != path[0] or not differ(path, taken):
                    continue
                if best < -ONE:
                    best = misfit(before, after, known_before, known_after, y, x, mine, ONE)
                    is_seen = 0 <= best < TRUSTED * unseen
                    if not is_seen and (best < 0 or mine[4] + mine[5] < 2):
                        best = unseen
                if best <= noise:
                    break
                fit = misfit(before, after, known_before, known_after, y, x, path, best)
                fits = 0 <= fit < TRUSTED * unseen
                if not fits and (fit < 0 or path[4] + path[5] < 2):
                    fit = unseen
                if BETTER * fit + noise < best:
                    best, taken, is_seen = fit, path, fits
            for c in range(channels):
                chosen[y, x, c] = ONE if is_seen and c > 3 else taken[c]


@compiled
def add_cubic(picture: np.ndarray, v: Real, u: Real, weight: Real, light: np.ndarray, y: int, x: int) -> None:
    """Add the values at a place (v, u) to a pixel (y, x): cubics within the range of the 4x4 pixels around it."""
    h, w, count = picture.shape
    u, v = min(max(u, ZERO), np.float32(w - 1)), min(max(v, ZERO), np.float32(h - 1))
    i, j = int(u), int(v)
    if u == i and v == j:
        for c in range(count):
            light[y, x, c] += weight * picture[j, i, c]
        return
    across, down = catmull_rom(u - i), catmull_rom(v - j)
    first, second, third, fourth = max(i - 1, 0), i, min(i + 1, w - 1), min(i + 2, w - 1)
    for c in range(count):
        least, most, value = np.float32(np.inf), np.float32(-np.inf), ZERO
        for b in range(4):
            row = min(max(j - 1 + b, 0), h - 1)
            one, two, three, four = (picture[row, first, c], picture[row, second, c], picture[row, third, c],
                                     picture[row, fourth, c])
            least = min(min(min(least, one), min(two, three)), four)
            most = max(max(max(most, one), max(two, three)), four)
            value += down[b] * (across[0] * one + across[1] * two + across[2] * three + across[3] * four)
        light[y, x, c] += weight * min(max(value, least), most)


@inline
def weights_of(path: Path, known_before: np.ndarray, known_after: np.ndarray, y: int, x: int, t: Real
               ) -> tuple[Real, Real]:
    """Weights of the two frames, 1 together."""
    first, last = path[4], path[5]
    if not is_within(known_before, y + path[1], x + path[0]):
        first = ZERO
    if not is_within(known_after, y + path[3], x + path[2]):
        last = ZERO
    one, other = (ONE - t) * (first + LEAST), t * (last + LEAST)
    return one / (one + other), other / (one + other)


@compiled
def add_place(light_before: np.ndarray, light_after: np.ndarray, known_before: np.ndarray, known_after: np.ndarray,
              y: int, x: int, path: Path, t: Real, share: Real, light: np.ndarray) -> Real:
    """Add what a path shows at a pixel, times a share; returns the weight that was added."""
    one, other = weights_of(path, known_before, known_after, y, x, t)
    whole = ZERO
    if one > LEAST:
        add_cubic(light_before, y + path[1], x + path[0], share * one, light, y, x)
        whole += share * one
    if other > LEAST:
        add_cubic(light_after, y + path[3], x + path[2], share * other, light, y, x)
        whole += share * other
    return whole


@compiled
def compose(y0: int, y1: int, light_before: np.ndarray, light_after: np.ndarray, data_before: np.ndarray,
            data_after: np.ndarray, known_before: np.ndarray, known_after: np.ndarray, paths: np.ndarray,
            t: float, light: np.ndarray, data: np.ndarray) -> None:
    """The planes between: light is mixed, data is that of the nearest pixel in the frame that counts more.

    light: (h, w, n) colour, alpha, reflectances. data: (h, w, m) depth, normals, ids.
    """
    h, w, count = light.shape
    half, at = np.float32(0.5), np.float32(t)
    for y in range(y0, y1):
        for x in range(w):
            own = path_at(paths, y, x)
            whole, mine = ZERO, ZERO
            for c in range(count):
                light[y, x, c] = ZERO
            for j in range(max(0, y - 1), min(h, y + 2)):
                for i in range(max(0, x - 1), min(w, x + 2)):
                    share, path = np.float32((2 - abs(j - y)) * (2 - abs(i - x))), path_at(paths, j, i)
                    if differ(path, own):
                        whole += add_place(light_before, light_after, known_before, known_after, y, x, path, at, share,
                                           light)
                    else:
                        mine += share
            whole += add_place(light_before, light_after, known_before, known_after, y, x, own, at, mine, light)
            for c in range(count):
                light[y, x, c] /= whole
            one, other = weights_of(own, known_before, known_after, y, x, at)
            is_first = one >= other
            v, u = y + (own[1] if is_first else own[3]) + half, x + (own[0] if is_first else own[2]) + half
            j, i = int(min(max(v, ZERO), np.float32(h - 1))), int(min(max(u, ZERO), np.float32(w - 1)))
            for c in range(data.shape[2]):
                data[y, x, c] = data_before[j, i, c] if is_first else data_after[j, i, c]


@compiled
def misfits(before: np.ndarray, after: np.ndarray, known_before: np.ndarray, known_after: np.ndarray, ends: np.ndarray,
            seen: np.ndarray, found: np.ndarray) -> None:
    """Misfit at the middle of each 8x8 pixels of the frame after that the frame before shows too; -1 elsewhere."""
    for row in range(found.shape[0]):
        for column in range(found.shape[1]):
            y, x = 8 * row + 4, 8 * column + 4
            path = ends[y, x, 0], ends[y, x, 1], ends[y, x, 2], ends[y, x, 3], ONE, ONE
            fit = misfit(before, after, known_before, known_after, y, x, path, ONE)
            found[row, column] = fit if seen[y, x] else -ONE


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
