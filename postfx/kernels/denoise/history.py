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
    MOST_MOTION,
    NEAREST,
    STATE,
    kernel,
)
from postfx.kernels.numeric import (
    Real,
    clamp,
    compiled,
    inline,
)

ZERO, HALF, ONE = np.float32(0), np.float32(0.5), np.float32(1)


@inline
def finite(value: Real) -> Real:
    """Motion of a pixel; impossible values (NaN, infinity) become 0."""
    return value if -MOST_MOTION < value < MOST_MOTION else ZERO


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


HISTORY = replace(kernel("history", ("history", "moved", "params", "window", "out_rows", "out_columns"), ("warped",),
                         None, ("warped", 0)), pixels=(2, 2))


FOCAL, FOCAL_THEN, JITTER, TURN, SHIFT, WORLD, CAMERA = 0, 2, 4, 6, 15, 18, 27
ROUGHEST = np.float32(0.3)
"""Roughness up to which a surface shows an image that is worth following: docs/concepts/denoiser.md."""
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
