"""Kernels of ambient occlusion from normals and depth: a classical estimate, and what a network reads to improve it.

All work on `surface` (h, w, 4): the normal in camera space (x to the right, y up, z to the camera; 0 where there is no
surface) and depth along the camera's axis, in radii. `camera` (12,) holds the turn from the world to camera space
(3, 3) for row vectors, the radius in scene units, and the tangents of half the field of view across and down. Results
are visibility (h, w): the share of a cosine-weighted hemisphere in which nothing is nearer than the radius.

- `SURFACE`: normal (h, w, 3) of the world, depth (h, w, 1) -> surface.
- `HORIZONS`: GTAO (Jimenez 2016, "Practical Realtime Strategies for Accurate Indirect Occlusion"): in `SLICES` planes
  through the view ray, turned from pixel to pixel in a 4x4 pattern, the highest surface to both sides is searched in
  `STEPS` steps, and the visible arc between is integrated. Surfaces count less from `fade` radii on, and are passed
  behind after `thin`: settings (2,).
- `LOOKS`: what a network reads of each pixel of some rows: points (rows * w, `LOOK`). In `WAYS` directions on the
  screen, the first of which is that of the normal, at `REACHES` of the radius: the cosine between the way to the
  surface seen there and the normal, and how near it is, both 0 from 1.25 radii on. Then how the surface lies, the
  radius in pixels, and the classical estimate, raw and smooth. `first` (1,) is the first row.
- `SMOOTH`: mean over the pattern's 4x4 pixels, of those on the same surface.
"""

import numpy as np

from postfx.kernels import Kernel
from postfx.kernels.numeric import Real, compiled, inline

RADIUS, TANGENTS, CAMERA = 9, 10, 12
SLICES, STEPS = 4, 8
WAYS, REACHES = 8, (0.04, 0.1, 0.2, 0.4, 0.65, 1.0)
LOOK = 2 * WAYS * len(REACHES) + 5
MOST_REACH = np.float32(0.5)
"""Share of the picture's height that the radius may cover on the screen."""
FAR = np.float32(1e5)
"""Depth in radii from which on a pixel counts as empty."""
ZERO, HALF, ONE, TWO = np.float32(0), np.float32(0.5), np.float32(1), np.float32(2)
PI, QUARTER = np.float32(np.pi), np.float32(np.pi / 2)


@compiled
def surface_rows(y0: int, y1: int, normal: np.ndarray, depth: np.ndarray, camera: np.ndarray,
                 surface: np.ndarray) -> None:
    """Normals turned into camera space, of length 1, and depth in radii; pixels without a surface are empty."""
    for y in range(y0, y1):
        for x in range(depth.shape[1]):
            a, b, c, z = normal[y, x, 0], normal[y, x, 1], normal[y, x, 2], depth[y, x, 0] / camera[RADIUS]
            length = np.sqrt(a * a + b * b + c * c)
            if not (length > np.float32(0.1) and length < np.float32(1e6) and z > ZERO and z < FAR):
                surface[y, x, 0], surface[y, x, 1], surface[y, x, 2], surface[y, x, 3] = ZERO, ZERO, ZERO, FAR
                continue
            a, b, c = a / length, b / length, c / length
            for k in range(3):
                surface[y, x, k] = a * camera[k] + b * camera[3 + k] + c * camera[6 + k]
            surface[y, x, 3] = z


@inline
def place(camera: np.ndarray, h: int, w: int, y: int, x: int, z: Real) -> tuple[Real, Real, Real]:
    """A pixel's surface in camera space, in radii."""
    return (((np.float32(x) + HALF) / np.float32(w) * TWO - ONE) * camera[TANGENTS] * z,
            (ONE - (np.float32(y) + HALF) / np.float32(h) * TWO) * camera[TANGENTS + 1] * z, -z)


@inline
def reach_at(camera: np.ndarray, h: int, w: int, z: Real) -> Real:
    """The radius on the screen at a depth, in pixels."""
    return min(np.float32(w) / (TWO * camera[TANGENTS] * z), MOST_REACH * np.float32(h))


@inline
def arc(horizon: Real, normal: Real) -> Real:
    """Visible part of a slice from the view ray to a horizon, weighted by the cosine to the normal (eq. 7)."""
    return (np.cos(normal) + TWO * horizon * np.sin(normal) - np.cos(TWO * horizon - normal)) / np.float32(4)


@compiled
def horizon_of(surface: np.ndarray, camera: np.ndarray, settings: np.ndarray, x: Real, y: Real, across: Real,
               down: Real, noise: Real, at: tuple[Real, Real, Real], view: tuple[Real, Real, Real],
               axis: tuple[Real, Real, Real], low: Real) -> Real:
    """Cosine of the angle from the view ray to the highest surface on one side, within the radius.

    ``across`` and ``down`` are the way in pixels at the radius; ``low`` is the cosine at the plane of the surface.
    Pixels do not lie on the slice, so their ways are projected along its ``axis``.
    """
    h, w = surface.shape[:2]
    best = low
    for step in range(STEPS):
        share = (np.float32(step) + noise) / np.float32(STEPS)
        share = share * share
        length = max(abs(across), abs(down))
        share = max(share, ONE / max(length, ONE) * (np.float32(step) * np.float32(0.5) + ONE))
        i, j = int(np.floor(x + HALF + across * share)), int(np.floor(y + HALF + down * share))
        if i < 0 or j < 0 or i >= w or j >= h:
            break
        z = surface[j, i, 3]
        if z >= FAR:
            continue
        px, py, pz = place(camera, h, w, j, i, z)
        dx, dy, dz = px - at[0], py - at[1], pz - at[2]
        distance = np.sqrt(dx * dx + dy * dy + dz * dz)
        if distance < np.float32(1e-6):
            continue
        off = dx * axis[0] + dy * axis[1] + dz * axis[2]
        inside = np.sqrt(max(distance * distance - off * off, np.float32(1e-12)))
        cosine = (dx * view[0] + dy * view[1] + dz * view[2]) / inside
        weight = min(max((ONE - distance) / (ONE - settings[0]), ZERO), ONE)
        cosine = low + weight * (cosine - low)
        best = max(best, cosine) if cosine >= best else best + settings[1] * weight * (max(cosine, low) - best)
    return best


@compiled
def horizon_rows(y0: int, y1: int, surface: np.ndarray, camera: np.ndarray, settings: np.ndarray,
                 visible: np.ndarray) -> None:
    """Visibility by the two horizons of each slice through the view ray."""
    h, w = surface.shape[:2]
    for y in range(y0, y1):
        for x in range(w):
            z = surface[y, x, 3]
            if z >= FAR:
                visible[y, x] = ONE
                continue
            px, py, pz = place(camera, h, w, y, x, z)
            length = np.sqrt(px * px + py * py + z * z)
            vx, vy, vz = -px / length, -py / length, z / length
            nx, ny, nz = surface[y, x, 0], surface[y, x, 1], surface[y, x, 2]
            reach = reach_at(camera, h, w, z)
            total, weights = ZERO, ZERO
            for k in range(SLICES):
                turn = (np.float32(k) + np.float32((x % 4) * 4 + y % 4) / np.float32(16)) * PI / np.float32(SLICES)
                noise = np.float32((x * 5 + y * 7 + k * 3) % 4 + HALF) / np.float32(4)
                c, s = np.cos(turn), np.sin(turn)
                # the slice's axis is the direction on the screen times the view ray
                ax, ay, az = s * vz, -c * vz, c * vy - s * vx
                size = np.sqrt(ax * ax + ay * ay + az * az)
                ax, ay, az = ax / size, ay / size, az / size
                off = nx * ax + ny * ay + nz * az
                mx, my, mz = nx - ax * off, ny - ay * off, nz - az * off
                shadow = max(np.sqrt(mx * mx + my * my + mz * mz), np.float32(1e-6))
                along = c * vx + s * vy
                ox, oy, oz = c - along * vx, s - along * vy, -along * vz
                side = ox * mx + oy * my + oz * mz
                cosine = min(max((mx * vx + my * vy + mz * vz) / shadow, ZERO), ONE)
                angle = np.arccos(cosine) if side > ZERO else -np.arccos(cosine)
                first = horizon_of(surface, camera, settings, np.float32(x), np.float32(y), c * reach, -s * reach,
                                   noise, (px, py, pz), (vx, vy, vz), (ax, ay, az), np.cos(angle + QUARTER))
                last = horizon_of(surface, camera, settings, np.float32(x), np.float32(y), -c * reach, s * reach,
                                  noise, (px, py, pz), (vx, vy, vz), (ax, ay, az), np.cos(angle - QUARTER))
                up = min(np.arccos(min(max(first, -ONE), ONE)), angle + QUARTER)
                down = max(-np.arccos(min(max(last, -ONE), ONE)), angle - QUARTER)
                weight = ONE / max(ox * ox + oy * oy + oz * oz, np.float32(1e-6))  # even around the view ray
                total += weight * shadow * (arc(up, angle) + arc(down, angle))
                weights += weight
            visible[y, x] = min(max(total / weights, ZERO), ONE)


@compiled
def smooth_rows(y0: int, y1: int, surface: np.ndarray, noisy: np.ndarray, visible: np.ndarray) -> None:
    """Mean of each pixel and its 5x5 neighbours on the same surface; the outermost ones count by half."""
    h, w = surface.shape[:2]
    for y in range(y0, y1):
        for x in range(w):
            z = surface[y, x, 3]
            if z >= FAR:
                visible[y, x] = ONE
                continue
            total, weights = ZERO, ZERO
            for j in range(max(y - 2, 0), min(y + 3, h)):
                for i in range(max(x - 2, 0), min(x + 3, w)):
                    weight = HALF if j == y - 2 or j == y + 2 else ONE
                    weight = weight * HALF if i == x - 2 or i == x + 2 else weight
                    alike = (surface[j, i, 0] * surface[y, x, 0] + surface[j, i, 1] * surface[y, x, 1]
                             + surface[j, i, 2] * surface[y, x, 2])
                    if abs(surface[j, i, 3] - z) < np.float32(0.05) * z and alike > np.float32(0.9):
                        total += weight * noisy[j, i]
                        weights += weight
            visible[y, x] = total / weights if weights > ZERO else noisy[y, x]


@compiled
def look_rows(p0: int, p1: int, surface: np.ndarray, camera: np.ndarray, raw: np.ndarray, smooth: np.ndarray,
              first: np.ndarray, points: np.ndarray) -> None:
    """What the network reads of each pixel."""
    h, w = surface.shape[:2]
    for p in range(p0, p1):
        y, x = int(first[0]) + p // w, p % w
        row = points[p]
        row[:] = ZERO
        z = surface[y, x, 3]
        if z >= FAR:
            continue
        nx, ny, nz = surface[y, x, 0], surface[y, x, 1], surface[y, x, 2]
        px, py, pz = place(camera, h, w, y, x, z)
        flat = np.sqrt(nx * nx + ny * ny)
        c, s = (nx / flat, ny / flat) if flat > np.float32(1e-3) else (ONE, ZERO)
        reach = reach_at(camera, h, w, z)
        at = 0
        for k in range(WAYS):
            turn = TWO * PI * np.float32(k) / np.float32(WAYS)
            a, b = np.cos(turn), np.sin(turn)
            across, up = a * c - b * s, a * s + b * c
            for share in REACHES:
                far = max(np.float32(share) * reach, ONE)
                i = int(np.floor(np.float32(x) + HALF + across * far))
                j = int(np.floor(np.float32(y) + HALF - up * far))
                if 0 <= i < w and 0 <= j < h and surface[j, i, 3] < FAR:
                    qx, qy, qz = place(camera, h, w, j, i, surface[j, i, 3])
                    qx, qy, qz = qx - px, qy - py, qz - pz
                    distance = max(np.sqrt(qx * qx + qy * qy + qz * qz), np.float32(1e-6))
                    near = min(max(np.float32(1.25) - distance, ZERO), ONE)
                    row[at] = (qx * nx + qy * ny + qz * nz) / distance * near
                    row[at + 1] = near
                at += 2
        length = np.sqrt(px * px + py * py + pz * pz)
        row[at], row[at + 1] = flat, -(px * nx + py * ny + pz * nz) / length
        row[at + 2] = np.float32(0.2) * np.log2(max(reach, ONE)) - HALF
        row[at + 3], row[at + 4] = raw[y, x], smooth[y, x]


_SHAPES: dict[str, tuple[int | str, ...]] = {"surface": ("h", "w", 4), "camera": (CAMERA,)}
SURFACE = Kernel("occlusion_surface", ("normal", "depth", "camera"), ("surface",), surface_rows, ("surface", 0),
                 {**_SHAPES, "normal": ("h", "w", 3), "depth": ("h", "w", 1)})
HORIZONS = Kernel("occlusion_horizons", ("surface", "camera", "settings"), ("visible",), horizon_rows, ("visible", 0),
                  {**_SHAPES, "settings": (2,), "visible": ("h", "w")})
SMOOTH = Kernel("occlusion_smooth", ("surface", "noisy"), ("visible",), smooth_rows, ("visible", 0),
                {"surface": ("h", "w", 4), "noisy": ("h", "w"), "visible": ("h", "w")})
LOOKS = Kernel("occlusion_looks", ("surface", "camera", "raw", "smooth", "first"), ("points",), look_rows,
               ("points", 0), {**_SHAPES, "raw": ("h", "w"), "smooth": ("h", "w"), "first": (1,),
                               "points": ("points", LOOK)})
