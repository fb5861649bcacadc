"""Kernel that gives smooth surfaces the motion of their reflections.

A mirror's image lies along the view ray, as far behind the mirror as the reflected point is from it. This virtual point
moves through the picture like any other (virtual motion in Zhdan 2021, "ReBLUR: A Hierarchical Recurrent Denoiser", Ray
Tracing Gems II, ch. 49). Convex mirrors bring it nearer, by the mirror equation 1 / image = 1 / distance + 2 curvature;
rough ones, too, by the dominant direction of their lobe, (1 - r) (sqrt(1 - r) + r) with roughness r (Lagarde and de
Rousiers 2014, "Moving Frostbite to Physically Based Rendering", on the dominant specular direction).

``camera`` is float32 (27,), in the picture's axes, x right, y down, z along the view axis: focal length in pixels now
(x, y) and then, jitter, the turn (3, 3) and shift (3) from now to then for row vectors, and (3, 3) from the world to
the axes now for normals.
"""

import numpy as np

from postfx.kernels.denoise import kernel
from postfx.kernels.denoise.prepare import finite
from postfx.kernels.numeric import Real, clamp, compiled, inline

FOCAL, FOCAL_THEN, JITTER, TURN, SHIFT, WORLD, CAMERA = 0, 2, 4, 6, 15, 18, 27
ROUGHEST = np.float32(0.3)
"""Roughness up to which a surface shows an image that is worth following: docs/concepts/denoiser.md."""
STEP, BEND = np.float32(0.1), np.float32(0.9)
"""Most relative difference in depth of neighbours on one surface, and least cosine between their normals."""
STILL, PART = np.float32(0.25), np.float32(0.05)
"""Pixels, and share of the motion, by which the motion of a surface at rest may differ from the camera's."""
ZERO, ONE, FAR, NEAR = np.float32(0), np.float32(1), np.float32(1e9), np.float32(1e-6)


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
    ahead = max(qz, NEAR)
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
                total += ONE / max(distance, NEAR)
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
            if not (hit_distance[y, x, 0] > ZERO and ZERO < z < FAR
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
