"""Where the points of two frames are at a time between them. Pixels are those of the plane of motion here, which may be
coarser than the picture.

A path is a curve from a point's place in the frame before (time 0) to that in the frame after (time 1). Every pixel of
both frames has one: of the frame after by its motion, of the frame before by that motion turned round, or, where the
frame after hides the point, by going on as it came. With a frame further back, or one further ahead, paths are bent:
Lagrange's polynomial through three or four places.

`splat_paths` brings them to a time: of all paths that arrive at a pixel the nearest ones count, and their mean is kept.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from postfx.caching import filled_array, new_array
from postfx.frame import DEPTH_MISS
from postfx.io.convert import centre_positions, fit_camera
from postfx.kernels.numeric import Real, add_eight, compiled, divide_eight, inline, load_eight, store_eight, uncounted
from postfx.system import in_bands
from postfx.temporal import reverse_motion
from postfx.temporal.reverse_motion import LOST

FAR = np.float32(1e30)
"""Stands for an unknown depth or a larger one."""
ALIKE = np.float32(0.04)
"""Relative difference in depth of paths that arrive at a pixel as one surface."""
SIMILAR = reverse_motion.ALIKE
"""The same of neighbours from whose motion a crack is filled where motion is inverted."""
SEEN = np.float32(1)
"""Pixels by which motion to the other frame and back may miss."""
SURE = np.float32(0.7)
"""Share of the paths that arrive at a cell that must be seen by the other frame: a sample of it has cells around."""
COVERS = np.float32(0.9)
"""Share of a depth below which what is seen is something else, in front."""
POINTS, LEAST_POINTS, FITTING = 2000, 64, 0.4
"""Points that the fit of a camera takes, the least that it needs, and the least share that it must explain."""
SPRUNG = np.float32(0.5)
"""Bend, as a share of the motion, from which a path is no curve but a jump and is taken as straight."""
ROUND = np.float32(0.7)
"""Relative difference of the bends before and after up to which a path is a curve in any case: what turns by 70 degrees
a frame, or swings."""

EXACT = np.float32(0.05)
"""Pixels by which motion may differ from one pixel to the next, and there and back, before it matters."""
ROUNDLY = np.float32(0.1)
"""Share of the motion by which that of the frame before or after may miss what it is if a thing turns evenly."""
LEAST_COSINE = np.float32(0.2)
"""Cosine of the angle by which a thing turns from frame to frame, at least."""


@dataclass
class Paths:
    """Paths of one frame's pixels.

    Attributes:
        ends: (h, w, 4) float32: from the pixel to the point's place in the frame before (x, y) and in the one after.
        bend: (h, w, 2): half the second difference of the places, in pixels.
        depth: (h, w, 1): what decides between paths that meet; the smaller one is in front.
        seen: (h, w): 1 where the other frame shows the point as well, else 0.
    """

    ends: np.ndarray
    bend: np.ndarray
    depth: np.ndarray
    seen: np.ndarray


def paths_of(motion: np.ndarray, ahead: np.ndarray, depth_before: np.ndarray, depth_after: np.ndarray,
             came: np.ndarray | None, goes: np.ndarray | None = None) -> tuple[Paths, Paths]:
    """Paths of the pixels of the frame before, and of those of the frame after.

    Args:
        motion: (h, w, 2) of the frame after: previous place minus this one, in pixels.
        ahead: likewise of the frame before, to the frame after; LOST where that hides a point.
        depth_before, depth_after: (h, w, 1), without NaN.
        came: motion of the frame before, from a frame further back; None without.
        goes: motion from the frame after to one further ahead, LOST where that hides a point; None without.
    """
    h, w = motion.shape[:2]
    first, last = (Paths(new_array((h, w, 4)), filled_array((h, w, 2), 0), depth, new_array((h, w)))
                   for depth in (depth_before, depth_after))
    none = np.zeros((0, 0, 2), np.float32)
    came, goes = none if came is None else came, none if goes is None else goes
    in_bands(h, lead_back, motion, ahead, depth_before, depth_after, came, goes, last.ends, last.bend, last.seen)
    in_bands(h, lead_ahead, ahead, motion, depth_before, depth_after, came, last.bend, first.ends, first.bend,
             first.seen)
    return first, last


def splat_paths(paths: Paths, t: float) -> tuple[np.ndarray, np.ndarray]:
    """What arrives at each pixel at time t: the nearest surface's mean path (h, w, 8), as `close_cracks` leaves it,
    NaN where there is none, and its depth (h, w), FAR where nothing arrives."""
    h, w = paths.seen.shape
    nearest, found, depth = filled_array((h, w), FAR), filled_array((h, w, 8), 0), new_array((h, w))
    splat_nearest(paths.ends, paths.bend, paths.depth, t, nearest)
    splat_means(paths.ends, paths.bend, paths.depth, paths.seen, t, nearest, found.reshape(-1))
    close_cracks(nearest, found, depth)
    return found, depth


@inline
def gather_cell(upper: np.ndarray, lower: np.ndarray, moved: np.ndarray, moved_below: np.ndarray, left: int, right: int,
                scale: Real, most: Real, x: int, cells: np.ndarray, depths: np.ndarray) -> None:
    """One cell: of pixels `left` and `right` of two rows, which may be the same. Without branches, so that the compiler
    makes several at a time."""
    miss, one, zero = np.float32(DEPTH_MISS), np.float32(1), np.float32(0)
    p, q, r, s = upper[left], upper[right], lower[left], lower[right]
    p, q, r, s = p if p < miss else miss, q if q < miss else miss, r if r < miss else miss, s if s < miss else miss
    first, last = p if p < q else q, r if r < s else s
    nearest = first if first < last else last
    nearest = nearest if nearest > np.float32(1e-6) else np.float32(1e-6)
    beyond = nearest * (1 + ALIKE)
    pu, pv, qu, qv = moved[2 * left], moved[2 * left + 1], moved[2 * right], moved[2 * right + 1]
    ru, rv, su, sv = (moved_below[2 * left], moved_below[2 * left + 1], moved_below[2 * right],
                      moved_below[2 * right + 1])
    a, b = (abs(pu) <= most) & (abs(pv) <= most) & (p <= beyond), (abs(qu) <= most) & (abs(qv) <= most) & (q <= beyond)
    c, d = (abs(ru) <= most) & (abs(rv) <= most) & (r <= beyond), (abs(su) <= most) & (abs(sv) <= most) & (s <= beyond)
    u = (pu if a else zero) + (qu if b else zero) + (ru if c else zero) + (su if d else zero)
    v = (pv if a else zero) + (qv if b else zero) + (rv if c else zero) + (sv if d else zero)
    count = (one if a else zero) + (one if b else zero) + (one if c else zero) + (one if d else zero)
    size = 1 / np.float64(count * scale)  # of none, motion is 0 times infinity, NaN
    depths[x] = nearest
    cells[2 * x], cells[2 * x + 1] = u * size, v * size


@uncounted
def gather_row(upper: np.ndarray, lower: np.ndarray, moved: np.ndarray, moved_below: np.ndarray, scale: int, most: Real,
               cells: np.ndarray, depths: np.ndarray) -> None:
    """A row of cells, flat, of two rows of pixels."""
    pairs, size = upper.size // 2 if scale == 2 else 0, np.float32(scale)
    for x in range(pairs):
        gather_cell(upper, lower, moved, moved_below, 2 * x, 2 * x + 1, size, most, x, cells, depths)
    for x in range(pairs, depths.size):
        gather_cell(upper, lower, moved, moved_below, scale * x, scale * x, size, most, x, cells, depths)


@uncounted
def gather_cells(motion: np.ndarray, depth: np.ndarray, scale: int, most: Real, cell_motion: np.ndarray,
                 cell_depth: np.ndarray) -> None:
    """Motion (rows, columns, 2), in cells, and depth (rows, columns, 1) of cells of one pixel or 2x2: means of those of
    the nearest surface. Either plane may have one row, which stands for all. Motion beyond `most` pixels, out of any
    picture, becomes NaN; depth lies between 0 and a miss."""
    h, w = max(motion.shape[0], depth.shape[0]), depth.shape[1]
    rows, columns = cell_depth.shape[:2]
    moved, far, cells, depths = motion.reshape(-1), depth.reshape(-1), cell_motion.reshape(-1), cell_depth.reshape(-1)
    for row in range(rows):
        top, low = row * scale, min(row * scale + scale - 1, h - 1)
        p, q = (top * w, low * w) if depth.shape[0] > 1 else (0, 0)
        r, s = (2 * top * w, 2 * low * w) if motion.shape[0] > 1 else (0, 0)
        gather_row(far[p:p + w], far[q:q + w], moved[r:r + 2 * w], moved[s:s + 2 * w], scale, most,
                   cells[2 * row * columns:2 * (row + 1) * columns], depths[row * columns:(row + 1) * columns])


@uncounted
def rank_paths(one: np.ndarray, other: np.ndarray, motion: np.ndarray, rank: np.ndarray) -> None:
    """What stands for depth where there is none (rows, columns, 1): 1 plus the difference of a grey picture to another
    one where its motion leads, or 2. A path that fits both pictures is in front of one that does not."""
    h, w = one.shape
    half = np.float32(0.5)
    for y in range(h):
        for x in range(w):
            u, v = x + half + motion[y, x, 0], y + half + motion[y, x, 1]
            inside = 0 <= u < w and 0 <= v < h
            rank[y, x, 0] = 1 + (abs(one[y, x] - other[int(v), int(u)]) if inside else np.float32(1))


def motion_of_reflections(motion: np.ndarray, depth: np.ndarray, length: np.ndarray, fov_x: float | None) -> np.ndarray:
    """Motion (h, w, 2) of what flat mirrors show; NaN where there is no mirror, all of it where no camera is found.

    A mirror's image lies along the view ray, as far behind the mirror as the reflected point is from it, and moves like
    any point at rest: as the camera that fits the motion of surfaces (`convert.fit_camera`).

    Args:
        motion, depth: (h, w, 2) and (h, w, 1).
        length: (h, w, 1) from a surface to what it reflects; 0 or less where there is nothing.
        fov_x: horizontal field of view in degrees, by which depth is told from distance; None if unknown.
    """
    h, w = depth.shape[:2]
    found = np.full((h, w, 2), np.nan, np.float32)
    is_mirror = (length[..., 0] > 0) & (depth[..., 0] < DEPTH_MISS)
    some = np.zeros((h, w), bool)
    step = max(1, round(math.sqrt(depth.size / POINTS)))
    some[::step, ::step] = True
    rows, columns = np.nonzero(some & (depth[..., 0] < DEPTH_MISS) & np.isfinite(motion[..., 0]))
    if not is_mirror.any() or rows.size < LEAST_POINTS:
        return found
    median = float(np.median(depth[rows, columns]))
    now = centre_positions(rows, columns, h, w)
    camera, _, _, share = fit_camera(now, now[:, :2] + motion[rows, columns].astype(float) / w,
                                     median / depth[rows, columns, 0].astype(float), 1 / w)
    if share < FITTING:
        return found
    rows, columns = np.nonzero(is_mirror)
    now = centre_positions(rows, columns, h, w)
    ahead = np.ones(rows.size) if not fov_x else 1 / np.hypot(1, np.hypot(now[:, 0], now[:, 1])
                                                              * 2 * math.tan(math.radians(fov_x) / 2))
    beyond = depth[rows, columns, 0] + length[rows, columns, 0].astype(float) * ahead
    place = np.append(camera[:8], 1).reshape(3, 3) @ now.T + camera[8:, None] * (median / beyond)
    found[rows, columns] = ((place[:2] / place[2]).T - now[:, :2]) * w
    return found


@inline
def is_touched(back: np.ndarray, depth: np.ndarray, v: Real, u: Real, fx: Real, fy: Real, z: Real) -> bool:
    """Whether one of the four pixels around a place, where a motion led, shows something nearer that does not lead
    back."""
    h, w = depth.shape[:2]
    j, i = int(np.floor(v)), int(np.floor(u))
    before = COVERS * z
    for b, a in ((j, i), (j, i + 1), (j + 1, i), (j + 1, i + 1)):
        if (np.uint64(b) < np.uint64(h)) & (np.uint64(a) < np.uint64(w)) and depth[b, a, 0] < before:
            if not (abs(back[b, a, 0] + fx) <= SEEN and abs(back[b, a, 1] + fy) <= SEEN):
                return True
    return False


@inline
def is_sloping(motion: np.ndarray, v: Real, u: Real) -> bool:
    """Whether motion around a place changes from pixel to pixel by so much that it matters where it is taken."""
    h, w = motion.shape[:2]
    if not ((u >= 0) & (v >= 0) & (u < np.float32(w - 1)) & (v < np.float32(h - 1))):
        return False
    j, i = int(v), int(u)
    return bool(max(abs(motion[j, i, 0] - motion[j + 1, i + 1, 0]), abs(motion[j, i, 1] - motion[j + 1, i + 1, 1]))
                > EXACT or max(abs(motion[j, i + 1, 0] - motion[j + 1, i, 0]),
                               abs(motion[j, i + 1, 1] - motion[j + 1, i, 1])) > EXACT)


@inline
def sample_two(motion: np.ndarray, v: Real, u: Real) -> tuple[bool, Real, Real, Real, Real, Real, Real]:
    """Whether motion goes on evenly between the four pixels around a place, the motion there, and its slopes: of x and
    of y to the right, of x and of y down."""
    h, w = motion.shape[:2]
    zero, one = np.float32(0), np.float32(1)
    if not ((u >= zero) & (v >= zero) & (u < np.float32(w - 1)) & (v < np.float32(h - 1))):
        return False, zero, zero, zero, zero, zero, zero
    j, i = int(v), int(u)
    y, x = np.float32(v - j), np.float32(u - i)
    p, q, r, s = motion[j, i, 0], motion[j, i + 1, 0], motion[j + 1, i, 0], motion[j + 1, i + 1, 0]
    a, b, c, d = motion[j, i, 1], motion[j, i + 1, 1], motion[j + 1, i, 1], motion[j + 1, i + 1, 1]
    most = max(max(max(abs(q - p), abs(s - r)), max(abs(r - p), abs(s - q))),
               max(max(abs(b - a), abs(d - c)), max(abs(c - a), abs(d - b))))
    right, across = q - p + y * (s - r - q + p), b - a + y * (d - c - b + a)
    down, under = r - p + x * (s - r - q + p), c - a + x * (d - c - b + a)
    return most <= one, p + x * (q - p) + y * down, a + x * (b - a) + y * under, right, across, down, under


@uncounted
def refine(y0: int, y1: int, motion: np.ndarray, inverse: np.ndarray) -> None:
    """Lead motion that was inverted for whole pixels to the places between them whose motion leads back: one step of
    Newton's method, where motion goes on evenly."""
    h, w = inverse.shape[:2]
    one = np.float32(1)
    for y in range(y0, y1):
        for x in range(w):
            fx, fy = inverse[y, x, 0], inverse[y, x, 1]
            if not is_sloping(motion, y + fy, x + fx):
                continue
            is_even, mx, my, right, across, down, under = sample_two(motion, y + fy, x + fx)
            dx, dy = fx + mx, fy + my
            if is_even and EXACT < max(abs(dx), abs(dy)) <= one:
                a, d = one + right, one + under
                area = a * d - down * across
                if abs(area) > np.float32(0.2):
                    inverse[y, x, 0] = fx - (d * dx - down * dy) / area
                    inverse[y, x, 1] = fy - (a * dy - across * dx) / area


@inline
def swing_of(cosine: Real) -> Real:
    """How many times as far as a polynomial through four places what swings or turns leaves the chord: by the cosine of
    its angle from frame to frame."""
    half = np.sqrt(np.float32(0.5) + np.float32(0.5) * min(max(cosine, LEAST_COSINE), np.float32(1)))
    return 2 / ((1 + half) * half)


@inline
def go_round(motion: np.ndarray, y: int, x: int, cx: Real, cy: Real, gx: Real, gy: Real
             ) -> tuple[int, Real, Real, Real, Real]:
    """How many sides are known, and motion on both: to the frame further back and to the one further ahead, of which
    one is given. Where it is what this motion becomes if all goes round one point, so is the other one."""
    mx, my = motion[y, x, 0], motion[y, x, 1]
    is_even, _, _, right, across, down, under = sample_two(motion, np.float32(y), np.float32(x))
    a, d = 1 + right, 1 + under
    area = a * d - down * across
    if is_even and area > np.float32(0.5):
        px, py = a * mx + down * my, across * mx + d * my
        qx, qy = (down * my - d * mx) / area, (across * mx - a * my) / area
        miss = max(abs(cx - px), abs(cy - py)) if cx > -LOST else max(abs(gx - qx), abs(gy - qy))
        if miss <= ROUNDLY * max(abs(mx), abs(my)):
            return 2, px, py, qx, qy
    return 1, cx, cy, gx, gy


@uncounted
def lead_back(y0: int, y1: int, motion: np.ndarray, ahead: np.ndarray, depth_before: np.ndarray,
              depth_after: np.ndarray, came: np.ndarray, goes: np.ndarray, ends: np.ndarray, bend: np.ndarray,
              seen: np.ndarray) -> None:
    """Paths of the frame after: by its motion; bent by what the frames beside tell of the same points."""
    h, w = seen.shape
    half = np.float32(0.5)
    for y in range(y0, y1):
        for x in range(w):
            mx, my = motion[y, x, 0], motion[y, x, 1]
            ends[y, x, 0], ends[y, x, 1], ends[y, x, 2], ends[y, x, 3] = mx, my, 0, 0
            seen[y, x] = 0
            u, v = x + mx + half, y + my + half
            if not (0 <= u < w and 0 <= v < h):
                continue
            i, j = int(u), int(v)
            same = abs(ahead[j, i, 0] + mx) <= SEEN and abs(ahead[j, i, 1] + my) <= SEEN
            if same and not is_touched(ahead, depth_before, v - half, u - half, mx, my, depth_after[y, x, 0]):
                seen[y, x] = 1
            cx, cy, gx, gy, count = -LOST, -LOST, LOST, LOST, 0
            if came.size and same:
                cx, cy, count = came[j, i, 0], came[j, i, 1], 1
                if is_sloping(came, v - half, u - half):
                    is_even, cu, cv, _, _, _, _ = sample_two(came, v - half, u - half)
                    cx, cy = (cu, cv) if is_even else (cx, cy)
            if goes.size and goes[y, x, 0] < LOST:
                gx, gy, count = goes[y, x, 0], goes[y, x, 1], count + 1
            if count == 1:
                count, cx, cy, gx, gy = go_round(motion, y, x, cx, cy, gx, gy)
            bx, by, ax, ay = np.float32(0), np.float32(0), np.float32(0), np.float32(0)
            if cx > -LOST:
                bx, by = cx - mx, cy - my
            if gx < LOST:
                ax, ay = gx + mx - bx, gy + my - by
                bx, by = bx + gx + mx, by + gy + my
            size, length = abs(bx) + abs(by), mx * mx + my * my
            is_round = count == 2 and abs(ax) + abs(ay) <= ROUND * size  # on both sides it bends the same way
            if count and (is_round or size <= SPRUNG * (abs(mx) + abs(my)) * count):
                share = half / count
                if count == 2 and length > 1:  # x'' = -w w x: both neighbours' sum is 2 cos w times the motion
                    share *= swing_of(1 - (ax * mx + ay * my) / (2 * length))
                bend[y, x, 0], bend[y, x, 1] = share * bx, share * by


@uncounted
def lead_ahead(y0: int, y1: int, ahead: np.ndarray, motion: np.ndarray, depth_before: np.ndarray,
               depth_after: np.ndarray, came: np.ndarray, bend_after: np.ndarray, ends: np.ndarray, bend: np.ndarray,
               seen: np.ndarray) -> None:
    """Paths of the frame before: to where the frame after shows the point, or straight on."""
    h, w = seen.shape
    half = np.float32(0.5)
    for y in range(y0, y1):
        for x in range(w):
            fx, fy = ahead[y, x, 0], ahead[y, x, 1]
            seen[y, x] = 0
            if fx < LOST:
                i, j = min(max(int(x + fx + half), 0), w - 1), min(max(int(y + fy + half), 0), h - 1)
                if abs(motion[j, i, 0] + fx) <= SEEN and abs(motion[j, i, 1] + fy) <= SEEN:  # else a filled crack
                    bend[y, x, 0], bend[y, x, 1] = bend_after[j, i, 0], bend_after[j, i, 1]
                    if is_sloping(bend_after, y + fy, x + fx):
                        is_even, bx, by, _, _, _, _ = sample_two(bend_after, y + fy, x + fx)
                        if is_even:
                            bend[y, x, 0], bend[y, x, 1] = bx, by
                    if not is_touched(motion, depth_after, y + fy, x + fx, fx, fy, depth_before[y, x, 0]):
                        seen[y, x] = 1
            else:
                fx, fy = (-came[y, x, 0], -came[y, x, 1]) if came.size else (np.float32(np.nan), np.float32(np.nan))
            ends[y, x, 0], ends[y, x, 1], ends[y, x, 2], ends[y, x, 3] = 0, 0, fx, fy


@uncounted
def splat_nearest(ends: np.ndarray, bend: np.ndarray, depth: np.ndarray, t: float, nearest: np.ndarray) -> None:
    """Least depth of the paths that are nearest to each pixel at time t; FAR where there is none."""
    h, w = nearest.shape
    half, at, s = np.float32(0.5), np.float32(t), np.float32(t * (t - 1))
    for y in range(h):
        for x in range(w):
            u = x + half + ends[y, x, 0] + at * (ends[y, x, 2] - ends[y, x, 0]) + s * bend[y, x, 0]
            v = y + half + ends[y, x, 1] + at * (ends[y, x, 3] - ends[y, x, 1]) + s * bend[y, x, 1]
            if 0 <= u < w and 0 <= v < h:
                nearest[int(v), int(u)] = min(nearest[int(v), int(u)], depth[y, x, 0])


@uncounted
def splat_means(ends: np.ndarray, bend: np.ndarray, depth: np.ndarray, seen: np.ndarray, t: float,
                nearest: np.ndarray, found: np.ndarray) -> None:
    """Sums of the nearest surface's paths around each pixel: to both frames, seen, weight, and twice nothing. found:
    flat."""
    h, w = nearest.shape
    flat = nearest.reshape(-1)
    zero, one, at, s = np.float32(0), np.float32(1), np.float32(t), np.float32(t * (t - 1))
    for y in range(h):
        for x in range(w):
            dx = ends[y, x, 0] + at * (ends[y, x, 2] - ends[y, x, 0]) + s * bend[y, x, 0]
            dy = ends[y, x, 1] + at * (ends[y, x, 3] - ends[y, x, 1]) + s * bend[y, x, 1]
            u, v = x + dx, y + dy
            if not ((u > -one) & (v > -one) & (u < np.float32(w)) & (v < np.float32(h))):
                continue
            i, j = int(np.floor(u)), int(np.floor(v))
            z = depth[y, x, 0]
            path = (ends[y, x, 0] - dx, ends[y, x, 1] - dy, ends[y, x, 2] - dx, ends[y, x, 3] - dy, seen[y, x], one,
                    zero, zero)
            u, v = u - np.float32(i), v - np.float32(j)
            for b, a, weight in ((j, i, (one - u) * (one - v)), (j, i + 1, u * (one - v)), (j + 1, i, (one - u) * v),
                                 (j + 1, i + 1, u * v)):
                if (np.uint64(b) < np.uint64(h)) & (np.uint64(a) < np.uint64(w)) & (weight > 0):
                    front = flat[b * w + a]
                    if abs(z - front) <= ALIKE * front:
                        place = 8 * (b * w + a)
                        store_eight(found, place, add_eight(load_eight(found, place), path, weight))


@uncounted
def close_cracks(nearest: np.ndarray, found: np.ndarray, depth: np.ndarray) -> None:
    """Means of the sums; pixels where nothing arrived get those of two neighbours on opposite sides."""
    h, w = nearest.shape
    flat, unit = found.reshape(-1), np.float32(1)
    for y in range(h):
        for x in range(w):
            depth[y, x] = nearest[y, x]
            if nearest[y, x] < FAR:
                at, weight = 8 * (y * w + x), found[y, x, 5]
                means = divide_eight(load_eight(flat, at), (weight, weight, weight, weight, weight, unit, unit, unit))
                store_eight(flat, at, means)
    for y in range(h):
        for x in range(w):
            if nearest[y, x] < FAR:
                continue
            best = FAR
            for j, i in ((0, 1), (1, 0), (1, 1), (1, -1)):
                if not (j <= y < h - j and abs(i) <= x < w - abs(i)):
                    continue
                one, other = nearest[y - j, x - i], nearest[y + j, x + i]
                if one < FAR and abs(one - other) <= ALIKE * one and one < best:
                    best = one
                    for c in range(5):
                        found[y, x, c] = np.float32(0.5) * (found[y - j, x - i, c] + found[y + j, x + i, c])
                    depth[y, x] = np.float32(0.5) * (one + other)
            if best == FAR:
                found[y, x, 0] = np.nan


@compiled
def fill_holes(field: np.ndarray, depth: np.ndarray) -> None:
    """Give cells without a path that of the farthest of the next ones to the left, to the right, above and below: what
    is uncovered is background. Without any, the cell stands still."""
    h, w = depth.shape
    holes = 0
    for y in range(h):
        for x in range(w):
            holes += field[y, x, 0] != field[y, x, 0]
    place, source = np.empty((holes, 2), np.int64), np.full((holes, 2), -1)
    for turn in range(4):  # down, up; each row to the right, to the left
        above, k = np.full(w, -1), 0 if turn % 2 == 0 else holes
        for line in range(h):
            y, beside = line if turn % 2 == 0 else h - 1 - line, -1
            for column in range(w):
                x = column if turn % 2 == 0 else w - 1 - column
                if field[y, x, 0] == field[y, x, 0]:
                    above[x], beside = y, x
                    continue
                k -= turn % 2
                j, i = (above[x], x) if turn < 2 else (y, beside)
                is_known = j >= 0 and i >= 0
                if is_known and (source[k, 0] < 0 or depth[j, i] > depth[source[k, 0], source[k, 1]]):
                    source[k, 0], source[k, 1] = j, i
                place[k, 0], place[k, 1] = y, x
                k += 1 - turn % 2
    for k in range(holes):
        y, x = place[k, 0], place[k, 1]
        if source[k, 0] < 0:
            field[y, x, :4], field[y, x, 4:] = np.float32(0), np.float32(1)
        else:
            field[y, x] = field[source[k, 0], source[k, 1]]
