"""Kernels of what a frame takes from the one before: at another render size, where its pixels are now, where what they
reflect was, and how much of it each pixel may use.

The last output is warped by the motion of its pixels (`HISTORY`); a state at another render size is resized (`RESIZE`).

Smooth surfaces get the motion of their reflections (`REFLECTIONS`). A mirror's image lies along the view ray, as far
behind the mirror as the reflected point is from it. This virtual point moves through the picture like any other
(virtual motion in Zhdan 2021, "ReBLUR: A Hierarchical Recurrent Denoiser", Ray Tracing Gems II, ch. 49). Convex mirrors
bring it nearer, by the mirror equation 1 / image = 1 / distance + 2 curvature; rough ones, too, by the dominant
direction of their lobe, (1 - r) (sqrt(1 - r) + r) with roughness r (Lagarde and de Rousiers 2014, "Moving Frostbite to
Physically Based Rendering", on the dominant specular direction). ``camera`` is float32 (27,), in the picture's axes, x
right, y down, z along the view axis: focal length in pixels now (x, y) and then, jitter, the turn (3, 3) and shift (3)
from now to then for row vectors, and (3, 3) from the world to the axes now for normals.

The reactive mask is the share of the history that each pixel must not use, from 0 (none) to 1 (all). What a reactive
pixel leaves to the next frame does not move with the surface seen there. So a pixel is limited by its own mask and by
the mask at the place where it was in the last frame; the larger of both counts. ``last_reactive`` is the last frame's
mask, spread by a pixel because the history is interpolated between pixels.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from postfx.kernels.denoise import (
    FARTHEST,
    MAX_COLOUR,
    MAX_FLOAT,
    NEAREST,
    STATE,
    kernel,
)
from postfx.kernels.denoise.prepare import finite
from postfx.kernels.numeric import (
    Eight,
    Four,
    Real,
    add_four,
    add_sixteen,
    centre,
    clamp,
    compiled,
    fused,
    fused_inline,
    inline,
    largest_eight,
    load_four,
    load_sixteen,
    store_eight,
    vectorised,
    weigh_pixels,
)

ZERO, HALF, ONE = np.float32(0), np.float32(0.5), np.float32(1)


@compiled
def resize_rows(y0: int, y1: int, state: np.ndarray, last_depth: np.ndarray, at_rows: np.ndarray,
                at_columns: np.ndarray, resized: np.ndarray, resized_depth: np.ndarray) -> None:
    """Bilinear at ``at_rows`` (height,) and ``at_columns`` (width,), edge repeated; depth of the nearest pixel.

    Pixels whose count is 0 are unknown and have no weight. Where they would have half of it, the result is unknown.
    """
    h, w = state.shape[:2]
    share = np.empty(4, np.float32)
    for y in range(y0, y1):
        top = int(np.floor(at_rows[y]))
        ty = at_rows[y] - np.float32(top)
        upper, lower = min(max(top, 0), h - 1), min(max(top + 1, 0), h - 1)
        near_y = min(max(int(np.rint(at_rows[y])), 0), h - 1)
        for x in range(resized.shape[1]):
            first = int(np.floor(at_columns[x]))
            tx = at_columns[x] - np.float32(first)
            left, right = min(max(first, 0), w - 1), min(max(first + 1, 0), w - 1)
            resized_depth[y, x, 0] = last_depth[near_y, min(max(int(np.rint(at_columns[x])), 0), w - 1), 0]
            a, b, c, d = state[upper, left], state[upper, right], state[lower, left], state[lower, right]
            share[0] = (ONE - ty) * (ONE - tx) if a[3] > ZERO else ZERO
            share[1] = (ONE - ty) * tx if b[3] > ZERO else ZERO
            share[2] = ty * (ONE - tx) if c[3] > ZERO else ZERO
            share[3] = ty * tx if d[3] > ZERO else ZERO
            total = share[0] + share[1] + share[2] + share[3]
            scale = ONE / total if total > HALF else ZERO
            for k in range(STATE):
                value = share[0] * a[k] + share[1] * b[k] + share[2] * c[k] + share[3] * d[k]
                resized[y, x, k] = value * scale


RESIZE = kernel("resize", ("state", "last_depth", "at_rows", "at_columns"), ("resized", "resized_depth"),
                resize_rows, ("resized", 0), at_rows=("height",), at_columns=("width",),
                resized=("height", "width", STATE), resized_depth=("height", "width", 1))


@fused_inline
def cubic(t: Real) -> tuple[Real, Real, Real, Real]:
    """The four weights of cubic convolution with a = -0.75, the ONNX GridSample and OpenCV default."""
    a = np.float32(-0.75)
    u, v, s = t + ONE, ONE - t, np.float32(2) - t
    return (((a * u - 5 * a) * u + 8 * a) * u - 4 * a, ((a + 2) * t - (a + 3)) * t * t + ONE,
            ((a + 2) * v - (a + 3)) * v * v + ONE, ((a * s - 5 * a) * s + 8 * a) * s - 4 * a)


@vectorised
def steps(moved: np.ndarray, scale: tuple[Real, Real], shift: np.ndarray, weights: np.ndarray) -> None:
    """Motion of a row (w, 2) in whole output pixels (2, w), and the weights (2, 4, w) of the cubic taps for the rest of
    it, both across and down.

    All output pixels in a render pixel share them, for they share its motion.
    """
    flat, across, down, right, lower = moved.reshape(moved.size), shift[0], shift[1], weights[0, 0], weights[1, 0]
    for x in range(across.size):
        px, py = flat[2 * x] * scale[0], flat[2 * x + 1] * scale[1]
        left, top = np.floor(px), np.floor(py)
        across[x], down[x], right[x], lower[x] = np.int32(left), np.int32(top), px - left, py - top
    for axis in range(2):
        taps(weights[axis, 0], weights[axis, 1], weights[axis, 2], weights[axis, 3])


@vectorised
def taps(a: np.ndarray, b: np.ndarray, c: np.ndarray, d: np.ndarray) -> None:
    """Weights of the cubic taps of a row; the first row has the offsets that they are for."""
    for x in range(a.size):
        a[x], b[x], c[x], d[x] = cubic(a[x])


@fused_inline
def weigh(a: Four, b: Four, c: Four, d: Four, u: Real, v: Real, w: Real, z: Real) -> Four:
    """u a + v b + w c + z d."""
    zero = np.float32(0)
    return add_four(add_four(add_four(add_four((zero, zero, zero, zero), b, v), a, u), c, w), d, z)


@fused_inline
def down(flat: np.ndarray, start: int, line: int, d0: Real, d1: Real, d2: Real, d3: Real) -> Four:
    """Weighted sum of four pixels below one another in a flat picture, and of the number behind each; unsigned places
    need no check for below 0."""
    second, third = start + line, start + line + line
    return weigh(load_four(flat, start), load_four(flat, second), load_four(flat, third),
                 load_four(flat, third + line), d0, d1, d2, d3)


@fused_inline
def down_last(flat: np.ndarray, start: int, line: int, d0: Real, d1: Real, d2: Real, d3: Real) -> Four:
    """The same of pixels behind which there may be nothing."""
    _, r, g, b = down(flat, start - np.uint64(1), line, d0, d1, d2, d3)
    return r, g, b, b


@fused_inline
def columns_of(flat: np.ndarray, start: int, line: int, d0: Real, d1: Real, d2: Real,
               d3: Real) -> tuple[Four, Four, Four, Four]:
    """Weighted sums down four columns of pixels, from a place on."""
    step = np.uint64(3)
    return (down(flat, start, line, d0, d1, d2, d3), down(flat, start + step, line, d0, d1, d2, d3),
            down(flat, start + step + step, line, d0, d1, d2, d3),
            down_last(flat, start + step + step + step, line, d0, d1, d2, d3))


@fused
def edge_pixel(left: int, top: int, history: np.ndarray, at: int, wx: np.ndarray, wy: np.ndarray,
               pixel: np.ndarray) -> None:
    """One pixel near the picture's edge, which is repeated."""
    height, width = history.shape[:2]
    pixel[:] = ZERO
    for j in range(4):
        for i in range(4):
            weight = wy[j, at] * wx[i, at]
            found = history[min(max(top + j, 0), height - 1), min(max(left + i, 0), width - 1)]
            for c in range(3):
                pixel[c] += weight * found[c]


NOWHERE = np.int32(-(2**30))
"""Column of what is not made with others."""


@compiled
def runs_of(columns: np.ndarray, size: int, out_size: int, left: int, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Where the output pixels of each of a part's ``count`` render pixels begin in a row, and after the last one's end
    (count + 1,); and the first column of those that are made at once, else NOWHERE: of up to three beside each other,
    from which eight numbers lie in the row."""
    begin, first = np.zeros(count + 1, np.int64), np.full(count, NOWHERE, np.int32)
    for x in range(columns.size):
        at, _ = centre(columns[x], size, out_size)
        begin[min(max(at - left, 0), count - 1) + 1] += 1
    for at in range(count):
        begin[at + 1] += begin[at]
        x, last = begin[at], begin[at + 1] - 1
        if x <= last <= x + 2 and columns[last] - columns[x] == last - x and x + 2 < columns.size:
            first[at] = columns[x]
    return begin, first


@compiled
def find_starts(y: int, height: int, width: int, first: np.ndarray, shift: np.ndarray, starts: np.ndarray) -> None:
    """The first number of the taps of a row's pixels in a picture, -1 of those that are made one by one."""
    across, down, one, three = shift[0], shift[1], np.int32(1), np.int32(3)
    right, bottom, line, row = np.int32(width - 8), np.int32(height - 4), np.int32(3 * width), np.int32(y - 1)
    for x in range(starts.size):
        left, top = first[x] + across[x] - one, row + down[x]
        inside = (left >= 0) & (left <= right) & (top >= 0) & (top <= bottom)
        starts[x] = np.int32(top * line + left * three) if inside else -one


@fused_inline
def warp_two(flat: np.ndarray, line: int, start: int, weights: np.ndarray, at: int) -> Eight:
    """Two neighbours in the render pixel ``at``, whose motion they share, and two numbers: taps begin at ``start``."""
    eight, second, third = (ZERO, ZERO, ZERO, ZERO, ZERO, ZERO, ZERO, ZERO), start + line, start + line + line
    total = add_sixteen(eight + eight, load_sixteen(flat, second), weights[1, 1, at])
    total = add_sixteen(total, load_sixteen(flat, start), weights[1, 0, at])
    total = add_sixteen(total, load_sixteen(flat, third), weights[1, 2, at])
    total = add_sixteen(total, load_sixteen(flat, third + line), weights[1, 3, at])
    return largest_eight(eight, weigh_pixels(total, weights[0, 0, at], weights[0, 1, at], weights[0, 2, at],
                                             weights[0, 3, at]))


@fused
def warp_most(begin: np.ndarray, starts: np.ndarray, history: np.ndarray, weights: np.ndarray, row: np.ndarray,
              others: np.ndarray) -> int:
    """The pixels of a row that are not near the picture's edges; ``others`` are the render pixels of those that are
    left, and their count is the result. What is written behind a render pixel's own is written again."""
    flat, line, left, most = history.reshape(history.size), np.uint64(3 * history.shape[1]), 0, 0
    for at in range(starts.size):
        if starts[at] < 0:
            others[left] = at
            left += 1
            continue
        store_eight(row, np.uint64(begin[at]) * np.uint64(3), warp_two(flat, line, np.uint64(starts[at]), weights, at))
        most = max(most, begin[at + 1] - begin[at])
    for at in range(starts.size if most > 2 else 0):
        if starts[at] >= 0 and begin[at + 1] - begin[at] > 2:
            third = row[3 * begin[at] + 6:3 * begin[at] + 9]
            third[0], third[1], third[2], _, _, _, _, _ = warp_two(flat, line, np.uint64(starts[at] + 6), weights, at)
    return left


@fused
def warp_row(y: int, columns: np.ndarray, begin: np.ndarray, starts: np.ndarray, history: np.ndarray,
             shift: np.ndarray, weights: np.ndarray, others: np.ndarray, row: np.ndarray) -> None:
    """Row ``y`` of a picture (height, width, 3) moved, at ``columns``, flat; cubic interpolation never makes it
    negative."""
    height, width = history.shape[:2]
    flat, line, wx, wy = history.reshape(history.size), np.uint64(3 * width), weights[0], weights[1]
    for i in range(warp_most(begin, starts, history, weights, row, others)):
        at = others[i]
        for x in range(begin[at], begin[at + 1]):
            left, top, pixel = columns[x] + shift[0, at] - 1, y + shift[1, at] - 1, row[3 * x:3 * x + 3]
            if 0 <= left <= width - 4 and 0 <= top <= height - 4:
                a, b, c, d = columns_of(flat, np.uint64((top * width + left) * 3), line, wy[0, at], wy[1, at],
                                        wy[2, at], wy[3, at])
                pixel[0], pixel[1], pixel[2], _ = weigh(a, b, c, d, wx[0, at], wx[1, at], wx[2, at], wx[3, at])
            else:
                edge_pixel(left, top, history, at, wx, wy, pixel)
            for c in range(3):
                pixel[c] = max(pixel[c], ZERO)


HISTORY = replace(kernel("history", ("history", "moved", "params", "window", "out_rows", "out_columns"), ("warped",),
                         None, ("warped", 0)), pixels=(2, 2))


FOCAL, FOCAL_THEN, JITTER, TURN, SHIFT, WORLD, CAMERA = 0, 2, 4, 6, 15, 18, 27
ROUGHEST = np.float32(0.3)
"""Roughness up to which a surface shows an image that is worth following: docs/lab/denoising.md."""
STEP, BEND = np.float32(0.1), np.float32(0.9)
"""Most relative difference in depth of neighbours on one surface, and least cosine between their normals."""
STILL, PART = np.float32(0.25), np.float32(0.05)
"""Pixels, and share of the motion, by which the motion of a surface at rest may differ from the camera's."""


@inline
def reflects(diffuse_albedo: np.ndarray, specular_albedo: np.ndarray, roughness: np.ndarray, y: int, x: int) -> Real:
    """Whether a pixel is smooth, and reflects more than it scatters."""
    share = ZERO
    for c in range(3):
        share += clamp(specular_albedo[y, x, c], ZERO, ONE) - clamp(diffuse_albedo[y, x, c], ZERO, ONE)
    return share > ZERO and roughness[y, x, 0] <= ROUGHEST


@inline
def ray(camera: np.ndarray, height: int, width: int, y: int, x: int) -> tuple[Real, Real]:
    """Direction through a pixel's sample, 1 along the view axis."""
    px = np.float32(x) + np.float32(0.5) + camera[JITTER] - np.float32(0.5) * np.float32(width)
    py = np.float32(y) + np.float32(0.5) + camera[JITTER + 1] - np.float32(0.5) * np.float32(height)
    return px / camera[FOCAL], py / camera[FOCAL + 1]


@inline
def motion_at(camera: np.ndarray, rx: Real, ry: Real, nearness: Real) -> tuple[Real, Real, Real]:
    """Motion of a point at rest on a ray, at 1 / ``nearness`` along the view axis, and its z then over that now."""
    qx = rx * camera[TURN] + ry * camera[TURN + 3] + camera[TURN + 6] + camera[SHIFT] * nearness
    qy = rx * camera[TURN + 1] + ry * camera[TURN + 4] + camera[TURN + 7] + camera[SHIFT + 1] * nearness
    qz = rx * camera[TURN + 2] + ry * camera[TURN + 5] + camera[TURN + 8] + camera[SHIFT + 2] * nearness
    ahead = max(qz, NEAREST)
    return (qx / ahead * camera[FOCAL_THEN] - rx * camera[FOCAL],
            qy / ahead * camera[FOCAL_THEN + 1] - ry * camera[FOCAL + 1], qz)


@inline
def unit(normal: np.ndarray, y: int, x: int) -> tuple[Real, Real, Real]:
    """The normal with length 1; zero if it has none."""
    a, b, c = normal[y, x, 0], normal[y, x, 1], normal[y, x, 2]
    length = np.sqrt(a * a + b * b + c * c)
    scale = ONE / length if length > np.float32(0.1) else ZERO
    return a * scale, b * scale, c * scale


@compiled
def inverse_distance(hit_distance: np.ndarray, depth: np.ndarray, y: int, x: int) -> Real:
    """Mean of one over the hit distance, over the 3x3 pixels of about the same depth that have one; -1 without any."""
    total, count, z = ZERO, 0, depth[y, x, 0]
    for j in range(max(0, y - 1), min(depth.shape[0], y + 2)):
        for i in range(max(0, x - 1), min(depth.shape[1], x + 2)):
            distance = hit_distance[j, i, 0]
            if distance > ZERO and abs(depth[j, i, 0] - z) <= STEP * z:
                total += ONE / max(distance, NEAREST)
                count += 1
    return total / np.float32(count) if count else -ONE


@compiled
def bend_between(normal: np.ndarray, depth: np.ndarray, camera: np.ndarray, first: np.ndarray, last: np.ndarray,
                 z: Real, facing: np.ndarray) -> Real:
    """Change of the normal over that of the position between two pixels (y, x); NaN if an edge separates them.

    ``z`` and ``facing`` are depth and normal between them.
    """
    h, w = depth.shape[:2]
    a, b = unit(normal, first[0], first[1]), unit(normal, last[0], last[1])
    before, after = depth[first[0], first[1], 0], depth[last[0], last[1], 0]
    if not (abs(before - z) <= STEP * z and abs(after - z) <= STEP * z
            and a[0] * facing[0] + a[1] * facing[1] + a[2] * facing[2] >= BEND
            and b[0] * facing[0] + b[1] * facing[1] + b[2] * facing[2] >= BEND):
        return np.float32(np.nan)
    ax, ay = ray(camera, h, w, first[0], first[1])
    bx, by = ray(camera, h, w, last[0], last[1])
    px, py, pz = bx * after - ax * before, by * after - ay * before, after - before
    dx, dy, dz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    nx = dx * camera[WORLD] + dy * camera[WORLD + 3] + dz * camera[WORLD + 6]
    ny = dx * camera[WORLD + 1] + dy * camera[WORLD + 4] + dz * camera[WORLD + 7]
    nz = dx * camera[WORLD + 2] + dy * camera[WORLD + 5] + dz * camera[WORLD + 8]
    return (nx * px + ny * py + nz * pz) / max(px * px + py * py + pz * pz, np.float32(1e-20))


@compiled
def curvature(normal: np.ndarray, depth: np.ndarray, camera: np.ndarray, y: int, x: int) -> Real:
    """How much a surface bends outwards, 1 / scene units, at least 0; -1 at its edges. Mean of both axes."""
    h, w = depth.shape[:2]
    z, facing = depth[y, x, 0], unit(normal, y, x)
    down = bend_between(normal, depth, camera, (max(y - 1, 0), x), (min(y + 1, h - 1), x), z, facing)
    across = bend_between(normal, depth, camera, (y, max(x - 1, 0)), (y, min(x + 1, w - 1)), z, facing)
    bend = np.float32(0.5) * (down + across)
    return max(bend, ZERO) if bend == bend else -ONE


@compiled
def reflection_rows(y0: int, y1: int, motion: np.ndarray, depth: np.ndarray, normal: np.ndarray, roughness: np.ndarray,
                    diffuse_albedo: np.ndarray, specular_albedo: np.ndarray, hit_distance: np.ndarray,
                    camera: np.ndarray, reflected: np.ndarray) -> None:
    """The motion; for smooth, mostly reflecting surfaces at rest with a hit distance, the motion of the reflection."""
    h, w = depth.shape[:2]
    for y in range(y0, y1):
        for x in range(w):
            mx, my, z = finite(motion[y, x, 0]), finite(motion[y, x, 1]), depth[y, x, 0]
            reflected[y, x, 0], reflected[y, x, 1] = mx, my
            if not (hit_distance[y, x, 0] > ZERO and ZERO < z < FARTHEST
                    and reflects(diffuse_albedo, specular_albedo, roughness, y, x)):
                continue
            rx, ry = ray(camera, h, w, y, x)
            sx, sy, _ = motion_at(camera, rx, ry, ONE / z)
            most = STILL + PART * max(abs(mx), abs(my))
            if not (abs(sx - mx) <= most and abs(sy - my) <= most):
                continue
            bend = curvature(normal, depth, camera, y, x)
            inverse = inverse_distance(hit_distance, depth, y, x)
            if bend < ZERO or inverse < ZERO:
                continue
            smooth = ONE - clamp(roughness[y, x, 0], ZERO, ONE)
            inverse = inverse / (smooth * (np.sqrt(smooth) + ONE - smooth)) + np.float32(2) * bend
            stretched = inverse * np.sqrt(rx * rx + ry * ry + ONE)
            vx, vy, ahead = motion_at(camera, rx, ry, stretched / (ONE + stretched * z))
            if ahead > np.float32(1e-3):
                reflected[y, x, 0], reflected[y, x, 1] = vx, vy


REFLECTIONS = kernel(
    "reflections", ("motion", "depth", "normal", "roughness", "diffuse_albedo", "specular_albedo", "hit_distance",
                    "camera"),
    ("reflected",), reflection_rows, ("reflected", 0), hit_distance=("h", "w", 1), camera=(CAMERA,),
    reflected=("h", "w", 2))


SPREAD = 1  # render pixels


@compiled
def compress(light: Real) -> Real:
    """Exposed light as a display shows it, 0 to 1."""
    held = min(light, np.float32(MAX_COLOUR))
    return np.sqrt(held / (ONE + held))


@compiled
def reactive_rows(y0: int, y1: int, colour: np.ndarray, opaque_colour: np.ndarray, difference: np.ndarray,
                  reactive: np.ndarray) -> None:
    """The mask of what is in front of opaque things; ``difference`` is exposure, scale and threshold.

    The largest channel's difference of the two colours as seen, times the scale, at most 1; 0 below the threshold.
    """
    exposure, scale, threshold = difference
    for y in range(y0, y1):
        for x in range(reactive.shape[1]):
            most = ZERO
            for c in range(3):
                with_all = compress(clamp(colour[y, x, c], ZERO, MAX_FLOAT) * exposure)
                most = max(most, abs(with_all - compress(clamp(opaque_colour[y, x, c], ZERO, MAX_FLOAT) * exposure)))
            reactive[y, x, 0] = min(most * scale, ONE) if most >= threshold else ZERO


@compiled
def spread_rows(y0: int, y1: int, reactive: np.ndarray, next_reactive: np.ndarray) -> None:
    """The largest value around each pixel, within 0 and 1."""
    h, w = reactive.shape[:2]
    for y in range(y0, y1):
        for x in range(w):
            most = ZERO
            for j in range(max(0, y - SPREAD), min(h, y + SPREAD + 1)):
                for i in range(max(0, x - SPREAD), min(w, x + SPREAD + 1)):
                    most = max(most, clamp(reactive[j, i, 0], ZERO, ONE))
            next_reactive[y, x, 0] = most


@compiled
def keep_rows(y0: int, y1: int, reactive: np.ndarray, last_reactive: np.ndarray, moved: np.ndarray,
              part_rows: np.ndarray, part_columns: np.ndarray, keep: np.ndarray) -> None:
    """How much of the history each pixel of a part uses."""
    h, w = reactive.shape[:2]
    for row in range(y0, y1):
        y = int(part_rows[row])
        for column in range(keep.shape[1]):
            x = int(part_columns[column])
            from_y = min(max(int(np.rint(np.float32(y) + moved[row, column, 1])), 0), h - 1)
            from_x = min(max(int(np.rint(np.float32(x) + moved[row, column, 0])), 0), w - 1)
            keep[row, column, 0] = ONE - max(clamp(reactive[y, x, 0], ZERO, ONE), last_reactive[from_y, from_x, 0])


@compiled
def kept_row(keep: np.ndarray, y: int, share: np.ndarray) -> None:
    """A row of ``keep``, which has one value for all pixels or one for each."""
    row, last = keep[min(y, keep.shape[0] - 1)], keep.shape[1] - 1
    for x in range(share.size):
        share[x] = row[min(x, last), 0]


MASK = ("h", "w", 1)
REACTIVE = kernel("reactive", ("colour", "opaque_colour", "difference"), ("reactive",), reactive_rows,
                  ("reactive", 0), opaque_colour=("h", "w", 3), difference=(3,), reactive=MASK)
SPREAD_MASK = kernel("spread", ("reactive",), ("next_reactive",), spread_rows, ("next_reactive", 0), reactive=MASK,
                     next_reactive=MASK)
KEEP = kernel("keep", ("reactive", "last_reactive", "moved", "part_rows", "part_columns"), ("keep",), keep_rows,
              ("keep", 0), reactive=MASK, last_reactive=MASK, keep=("th", "tw", 1))
