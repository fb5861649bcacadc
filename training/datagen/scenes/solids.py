"""Meshes of joinery and upholstery in metres: many boxes at once, rounded boxes, mitred mouldings
and their profiles, smooth sheets, cloth."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from training.datagen.scenes import meshes
from training.datagen.scenes.meshes import Mesh

_UNIT = meshes.box([0, 0, 0], [1, 1, 1])
_U_AXIS, _V_AXIS = np.repeat([2, 1, 0, 2, 1, 0], 4), np.repeat([1, 2, 2, 0, 0, 1], 4)
QUAD = np.array([[0, 1, 2], [0, 2, 3]])


def many(vertices: np.ndarray, normals: np.ndarray, uvs: np.ndarray, faces: np.ndarray) -> Mesh:
    """One mesh of N copies of a topology: (N, K, 3), (N, K, 3), (N, K, 2) and triangles (M, 3) of
    one copy."""
    count, size = vertices.shape[:2]
    index = faces[None] + size * np.arange(count)[:, None, None]
    return Mesh(vertices.reshape(-1, 3), np.broadcast_to(normals, vertices.shape).reshape(-1, 3),
                uvs.reshape(-1, 2), index.reshape(-1, 3).astype(np.uint32))


def boxes(low: ArrayLike, high: ArrayLike) -> Mesh:
    """Axis-aligned boxes between corners (N, 3) or (3,)."""
    low, high = np.broadcast_arrays(np.atleast_2d(np.asarray(low, float)), np.asarray(high, float))
    size = high - low
    vertices = low[:, None] + size[:, None] * _UNIT.vertices
    uvs = np.stack([size[:, _U_AXIS] * _UNIT.uvs[:, 0], size[:, _V_AXIS] * _UNIT.uvs[:, 1]], -1)
    return many(vertices, _UNIT.normals, uvs + low[:, :1, None], _UNIT.faces)


def rounded_box(low: ArrayLike, high: ArrayLike, radius: float, steps: int = 3) -> Mesh:
    """A box with round edges and corners; their radius is at most half of its thinnest side."""
    low, high = np.asarray(low, float), np.asarray(high, float)
    half, centre = (high - low) / 2, (high + low) / 2
    radius = min(radius, 0.98 * half.min())
    tangent = np.tan(np.linspace(0, np.pi / 4, steps + 1))
    slope = np.concatenate([-tangent[::-1], tangent])
    end = np.repeat([-1.0, 1.0], steps + 1)
    p, q = np.meshgrid(slope, slope, indexing="ij")
    ends = np.stack([np.ones_like(p), *np.meshgrid(end, end, indexing="ij")], -1)
    parts = []
    for axis in range(3):
        direction = np.stack([np.ones_like(p), p, q], -1) / np.sqrt(1 + p**2 + q**2)[..., None]
        place = np.roll(ends, axis, -1) * (half - radius) + radius * np.roll(direction, axis, -1)
        normal, across = np.roll(direction, axis, -1), [(axis + 1) % 3, (axis + 2) % 3]
        faces = meshes.grid_faces(len(slope) - 1, len(slope) - 1)
        for sign in (1, -1):
            flip = np.ones(3)
            flip[axis] = sign
            points = (place * flip).reshape(-1, 3)
            parts.append(Mesh(points + centre, (normal * flip).reshape(-1, 3), points[:, across],
                              faces[:, ::sign]))
    return meshes.merge(parts)


def moulding(path: ArrayLike, profile: ArrayLike, closed: bool = False) -> Mesh:
    """A profile (K, 2) swept along a polyline (P, 2) in the plane z = 0, mitred at its corners.

    Profile points are (to the left of the path, off the plane); the solid lies to the right as one
    goes along the profile.
    Curves of the profile are shaded smooth, corners of more than 37 degrees stay sharp.
    """
    path, profile = np.asarray(path, float), np.asarray(profile, float)
    points = np.concatenate([path, path[:1]]) if closed else path
    along = np.diff(points, axis=0)
    length = np.linalg.norm(along, axis=1)
    along /= length[:, None]
    left = np.stack([-along[:, 1], along[:, 0]], 1)
    before = np.roll(left, 1, 0) if closed else np.concatenate([left[:1], left[:-1]])
    after = np.roll(left, -1, 0) if closed else np.concatenate([left[1:], left[-1:]])
    start, end = (left + other for other in (before, after))
    start, end = (m / np.maximum((m * left).sum(1, keepdims=True), 0.2) for m in (start, end))
    first, last = _edge_normals(profile)
    uv_across = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(profile, axis=0), axis=1))])
    uv_along = np.concatenate([[0], np.cumsum(length)])
    corners, normals, uvs = [], [], []
    for ahead, second in ((0, 0), (1, 0), (1, 1), (0, 1)):
        part, bend = profile[second: len(profile) - 1 + second], (start, end)[ahead]
        foot = points[ahead: len(points) - 1 + ahead]
        flat = foot[:, None] + part[None, :, :1] * bend[:, None]
        corners.append(np.concatenate(
            [flat, np.broadcast_to(part[None, :, 1:], (*flat.shape[:2], 1))], -1
        ))
        normal = (first, last)[second]
        turned = normal[None, :, :1] * left[:, None]
        normals.append(np.concatenate(
            [turned, np.broadcast_to(normal[None, :, 1:], (*turned.shape[:2], 1))], -1
        ))
        places = (uv_along[ahead: len(points) - 1 + ahead, None],
                  uv_across[None, second: len(profile) - 1 + second])
        uvs.append(np.stack(np.broadcast_arrays(*places), -1))
    vertices, turned, places_on = (np.stack(values, 2).reshape(-1, 4, values[0].shape[-1])
                                   for values in (corners, normals, uvs))
    return many(vertices, turned, places_on, QUAD)


def _edge_normals(profile: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Normals (K-1, 2) at both ends of a profile's edges."""
    edge = np.diff(profile, axis=0)
    normal = np.stack([-edge[:, 1], edge[:, 0]],
                      1) / np.maximum(np.linalg.norm(edge, axis=1, keepdims=True), 1e-9)
    first, last = normal.copy(), normal.copy()
    smooth = (normal[1:] * normal[:-1]).sum(1) > 0.8
    mean = normal[1:] + normal[:-1]
    mean /= np.maximum(np.linalg.norm(mean, axis=1, keepdims=True), 1e-9)
    first[1:][smooth], last[:-1][smooth] = mean[smooth], mean[smooth]
    return first, last


def sheet(points: np.ndarray) -> Mesh:
    """A smooth surface through a grid of points (R, C, 3); its normal is (down the rows) x (along
    the columns)."""
    down, along = np.gradient(points, axis=0), np.gradient(points, axis=1)
    normals = np.cross(down, along)
    normals /= np.maximum(np.linalg.norm(normals, axis=-1, keepdims=True), 1e-12)
    steps = [np.linalg.norm(np.diff(points, axis=k), axis=-1).mean(1 - k) for k in (0, 1)]
    v, u = (np.concatenate([[0], np.cumsum(step)]) for step in steps)
    uvs = np.stack(np.meshgrid(u, v), -1)
    faces = meshes.grid_faces(points.shape[0] - 1, points.shape[1] - 1)
    return Mesh(points.reshape(-1, 3), normals.reshape(-1, 3), uvs.reshape(-1, 2), faces)


def rectangle(x0: float, y0: float, x1: float, y1: float) -> np.ndarray:
    """Corners of a rectangle (4, 2), counter-clockwise: its inside is to the left of the path."""
    return np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]])


def face(x0: float, y0: float, x1: float, y1: float, z: float = 0.0) -> Mesh:
    """An upright rectangle that looks along +z; texture coordinates are its x and y."""
    quad = meshes.quad([x0, y0, z], [x1 - x0, 0, 0], [0, y1 - y0, 0])
    return Mesh(quad.vertices, quad.normals, quad.vertices[:, :2].copy(), quad.faces)


# Profiles of mouldings ----------------------------------------------------------------------------
# (K, 2) points of (across, off the surface): skirtings, cornices, frames, panels.

PROFILE_PARTS = ("line", "ovolo", "cove", "ogee", "step", "step")


def _element(kind: str, start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """Points from `start` (left out) to `end` (kept)."""
    t = np.linspace(0, 1, 7)[1:]
    x, y = {
        "line": (t[-1:], t[-1:]),
        "ovolo": (1 - np.cos(t * np.pi / 2), np.sin(t * np.pi / 2)),
        "cove": (np.sin(t * np.pi / 2), 1 - np.cos(t * np.pi / 2)),
        "ogee": (t, 0.5 - 0.5 * np.cos(np.pi * t)),
        "step": (np.array([0.0, 1.0]), np.array([1.0, 1.0])),
    }[kind]
    return start + np.stack([x, y], 1) * (end - start)


def _run(rng: np.random.Generator, start: np.ndarray, end: np.ndarray,
         count: int) -> list[np.ndarray]:
    """A stair of `count` elements from `start` to `end`."""
    cuts = np.sort(rng.uniform(0.1, 0.9, (2, count - 1)), 1).T
    stops = [start, *(start + cut * (end - start) for cut in cuts), end]
    return [_element(str(rng.choice(PROFILE_PARTS)), a, b)
            for a, b in zip(stops[:-1], stops[1:], strict=True)]


def frame_profile(rng: np.random.Generator, width: float, height: float) -> np.ndarray:
    """Both edges on the surface: for architraves, picture frames and panels."""
    low, crest = rng.uniform(0.2, 0.6) * height, np.sort(rng.uniform(0.25, 0.85, 2)) * width
    if rng.random() < 0.2:
        return np.array([[0, 0], [0, height], [width, height], [width, 0]])
    parts = [np.array([[0, 0], [0, low]]),
             *_run(rng, np.array([0, low]), np.array([crest[0], height]), 2),
             np.array([[crest[1], height]])]
    parts += _run(rng, np.array([crest[1], height]), np.array([width, 0.4 * low]),
                  int(rng.integers(1, 3)))
    return np.concatenate([*parts, np.array([[width, 0.0]])])


def edge_profile(rng: np.random.Generator, width: float, height: float) -> np.ndarray:
    """Thick at the start, thin at the end: skirtings, from the floor at 0 up to `width` on the
    wall."""
    top = rng.uniform(0.5, 0.85) * width
    if rng.random() < 0.3:
        return np.array([[0, 0], [0, height], [width - 0.3 * height, height], [width, 0.7 * height],
                         [width, 0.0]])
    parts = [np.array([[0, 0], [0, height], [top, height]])]
    parts += _run(rng, np.array([top, height]), np.array([width, 0.2 * height]),
                  int(rng.integers(1, 3)))
    return np.concatenate([*parts, np.array([[width, 0.0]])])


def cornice_profile(rng: np.random.Generator, width: float, height: float) -> np.ndarray:
    """From the wall, `height` below the ceiling, to the ceiling, `width` from the wall."""
    inset = 0.15 * np.array([width, height]) * rng.random()
    start, end = np.array([inset[0], height]), np.array([width, inset[1]])
    parts = [np.array([[0, height], [inset[0], height]]),
             *_run(rng, start, end, int(rng.integers(1, 5)))]
    return np.concatenate([*parts, np.array([[width, 0.0]])])


# Cloth --------------------------------------------------------------------------------------------
# Cushions, curtains, bedding, throws and folded stacks, as smooth meshes, y up.

def waves(rng: np.random.Generator, x: np.ndarray, y: np.ndarray, size: float,
          count: int = 6) -> np.ndarray:
    """A sum of sine waves about as long as `size`, amplitude about 1: soft folds."""
    total = np.zeros(np.broadcast_shapes(x.shape, y.shape))
    for _ in range(count):
        heading, length = rng.uniform(0, 2 * np.pi), size * np.exp(rng.normal(0, 0.4))
        phase = (2 * np.pi * (np.cos(heading) * x + np.sin(heading) * y) / length
                 + rng.uniform(0, 2 * np.pi))
        total = total + np.sin(phase + 0.8 * np.sin(0.37 * phase))
    return total / np.sqrt(count)


def cushion(rng: np.random.Generator, width: float, depth: float, thick: float) -> Mesh:
    """A stuffed cushion that lies about the origin, thick along y, with creases that run into its
    seam."""
    t = np.sin(np.linspace(-1, 1, 26) * np.pi / 2)
    s, t = np.meshgrid(t, t, indexing="ij")
    pinch = rng.uniform(0.04, 0.14)
    x, z = 0.5 * width * s * (1 - pinch * (1 - t**2)), 0.5 * depth * t * (1 - pinch * (1 - s**2))
    full = np.clip((1 - s**2) * (1 - t**2), 0, 1) ** rng.uniform(0.3, 0.5)
    rim = 4 * full * (1 - full)
    crease = rng.uniform(0.02, 0.12)
    parts = []
    for side in (1, -1):
        folds = crease * thick * (rim * waves(rng, x, z, 0.35 * width)
                                  + 0.4 * full * waves(rng, x, z, 0.7 * width))
        y = side * (0.5 * thick * full + np.maximum(folds, -0.4 * thick * full))
        points = np.stack([x, y, z], -1)
        mesh = sheet(points if side < 0 else points.transpose(1, 0, 2))
        parts.append(mesh)
    return meshes.merge(parts)


def curtain(rng: np.random.Generator, width: float, height: float) -> Mesh:
    """A pleated curtain from y = 0 to `height`, about x = 0, in the plane z = 0; some are tied to
    one side."""
    pleats = max(3, int(width * rng.uniform(7, 14)))
    u, v = np.meshgrid(np.linspace(0, 1, 12 * pleats + 1), np.linspace(1, 0, 26))
    shift = (0.35 * np.sin(2 * np.pi * (u * rng.uniform(0.5, 2) + rng.random()))
             + 0.25 * (1 - v) * np.sin(3 * np.pi * u))
    wave = np.sin(2 * np.pi * (pleats * u + shift))
    depth = rng.uniform(0.02, 0.05) * (0.7 + 0.5 * (1 - v)
                                       + 0.3 * np.sin(2 * np.pi * (3 * u + rng.random())))
    tie = rng.uniform(0.3, 0.5) if rng.random() < 0.3 else 0.0
    waist = 1 - (1.6 * tie) * np.exp(-(((v - 0.4) / 0.25) ** 2))
    side = rng.choice([-1, 1])
    x = (u - 0.5) * width * waist + side * 0.5 * width * (1 - waist)
    x = x + 0.012 * np.cos(2 * np.pi * (pleats * u + shift))
    z = depth * wave + 0.01 * (1 - v) * np.sin(5 * u + 2)
    return sheet(np.stack([x, height * v, z], -1))


def _over_edge(s: np.ndarray, half: float, radius: float) -> tuple[np.ndarray, np.ndarray]:
    """Arc length along a cloth over a round edge at `half`: (how far out, how far down)."""
    over = np.maximum(np.abs(s) - (half - radius), 0.0)
    angle = np.clip(over / radius, 0, np.pi / 2)
    out = np.minimum(np.abs(s), half - radius) + radius * np.sin(angle)
    down = radius * (1 - np.cos(angle)) + np.maximum(over - radius * np.pi / 2, 0.0)
    return np.sign(s) * out, down


def drape(rng: np.random.Generator, width: float, depth: float, hang: float, hang_z: float,
          crease: float) -> Mesh:
    """A cloth that lies on a block of width x depth about the origin, top at y = 0, and hangs down
    its sides.

    `hang` and `hang_z` are the lengths over its x and z edges, `crease` the height of its folds in
    metres.
    """
    reach_x, reach_z = width / 2 + hang, depth / 2 + hang_z
    s, t = np.meshgrid(np.linspace(-reach_x, reach_x, 64), np.linspace(-reach_z, reach_z, 64),
                       indexing="ij")
    x, down_x = _over_edge(s, width / 2, min(0.05, 0.4 * width))
    z, down_z = _over_edge(t, depth / 2, min(0.05, 0.4 * depth))
    fold = waves(rng, s, t, rng.uniform(0.25, 0.8)) + 0.4 * waves(rng, s, t, 0.15)
    flat = 1 / (1 + 30 * (down_x + down_z))
    pleat_x = np.sin(2 * np.pi * t / 0.22 + 1.3 * np.sin(3 * t)) * np.minimum(down_x, 0.3) * 0.12
    pleat_z = np.sin(2 * np.pi * s / 0.22 + 1.3 * np.sin(3 * s)) * np.minimum(down_z, 0.3) * 0.12
    lift = crease * (fold + 1.2)
    y = lift * flat - down_x - down_z * (down_x < 0.02) + 0.002
    x = x + np.sign(s) * (np.abs(pleat_x) + 0.012 + lift * (1 - flat) * (down_x > 0))
    z = z + np.sign(t) * (np.abs(pleat_z) + 0.012 + lift * (1 - flat) * (down_z > 0))
    return sheet(np.stack([x, y, z], -1).transpose(1, 0, 2))


def folded_stack(rng: np.random.Generator, width: float, depth: float, layers: int) -> Mesh:
    """A pile of folded cloths on y = 0."""
    parts, y = [], 0.0
    for _ in range(layers):
        thick = rng.uniform(0.02, 0.06)
        slip, size = rng.normal(0, 0.01, 2), np.array([width, depth]) * rng.uniform(0.85, 1, 2) / 2
        parts.append(rounded_box([slip[0] - size[0], y, slip[1] - size[1]],
                                    [slip[0] + size[0], y + thick, slip[1] + size[1]],
                                    0.48 * thick))
        y += thick
    return meshes.merge(parts)
