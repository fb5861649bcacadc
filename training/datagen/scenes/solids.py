"""Solids of joinery and upholstery: many boxes at once, rounded boxes, mitred mouldings and their profiles, smooth
sheets; in metres."""

from __future__ import annotations

import numpy as np

from training.datagen.scenes import meshes
from training.datagen.scenes.meshes import Mesh

_UNIT = meshes.box([0, 0, 0], [1, 1, 1])
_U_AXIS, _V_AXIS = np.repeat([2, 1, 0, 2, 1, 0], 4), np.repeat([1, 2, 2, 0, 0, 1], 4)
QUAD = np.array([[0, 1, 2], [0, 2, 3]])


def many(vertices: np.ndarray, normals: np.ndarray, uvs: np.ndarray, faces: np.ndarray) -> Mesh:
    """One mesh of N copies of a topology: (N, K, 3), (N, K, 3), (N, K, 2) and triangles (M, 3) of one copy."""
    count, size = vertices.shape[:2]
    index = faces[None] + size * np.arange(count)[:, None, None]
    return Mesh(vertices.reshape(-1, 3), np.broadcast_to(normals, vertices.shape).reshape(-1, 3), uvs.reshape(-1, 2),
                index.reshape(-1, 3).astype(np.uint32))


def boxes(low: np.ndarray, high: np.ndarray) -> Mesh:
    """Axis-aligned boxes between corners (N, 3) or (3,)."""
    low, high = np.broadcast_arrays(np.atleast_2d(np.asarray(low, float)), np.asarray(high, float))
    size = high - low
    vertices = low[:, None] + size[:, None] * _UNIT.vertices
    uvs = np.stack([size[:, _U_AXIS] * _UNIT.uvs[:, 0], size[:, _V_AXIS] * _UNIT.uvs[:, 1]], -1)
    return many(vertices, _UNIT.normals, uvs + low[:, :1, None], _UNIT.faces)


def rounded(low: np.ndarray, high: np.ndarray, radius: float, steps: int = 3) -> Mesh:
    """A box with round edges and corners; at most half as round as it is thin."""
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


def moulding(path: np.ndarray, profile: np.ndarray, closed: bool = False) -> Mesh:
    """A profile (K, 2) swept along a polyline (P, 2) in the plane z = 0, mitred at its corners.

    Profile points are (to the left of the path, off the plane); the solid lies to the right of the profile's way.
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
        corners.append(np.concatenate([flat, np.broadcast_to(part[None, :, 1:], (*flat.shape[:2], 1))], -1))
        normal = (first, last)[second]
        turned = normal[None, :, :1] * left[:, None]
        normals.append(np.concatenate([turned, np.broadcast_to(normal[None, :, 1:], (*turned.shape[:2], 1))], -1))
        places = uv_along[ahead: len(points) - 1 + ahead, None], uv_across[None, second: len(profile) - 1 + second]
        uvs.append(np.stack(np.broadcast_arrays(*places), -1))
    stacked = [np.stack(values, 2).reshape(-1, 4, values[0].shape[-1]) for values in (corners, normals, uvs)]
    return many(*stacked, QUAD)


def _edge_normals(profile: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Normals (K-1, 2) at both ends of a profile's edges."""
    edge = np.diff(profile, axis=0)
    normal = np.stack([-edge[:, 1], edge[:, 0]], 1) / np.maximum(np.linalg.norm(edge, axis=1, keepdims=True), 1e-9)
    first, last = normal.copy(), normal.copy()
    smooth = (normal[1:] * normal[:-1]).sum(1) > 0.8
    mean = normal[1:] + normal[:-1]
    mean /= np.maximum(np.linalg.norm(mean, axis=1, keepdims=True), 1e-9)
    first[1:][smooth], last[:-1][smooth] = mean[smooth], mean[smooth]
    return first, last


def sheet(points: np.ndarray) -> Mesh:
    """A smooth surface through a grid of points (R, C, 3); its normal is (down the rows) x (along the columns)."""
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


# Profiles of mouldings --------------------------------------------------------------------------------------------
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


def _run(rng: np.random.Generator, start: np.ndarray, end: np.ndarray, count: int) -> list[np.ndarray]:
    """A stair of `count` elements from `start` to `end`."""
    cuts = np.sort(rng.uniform(0.1, 0.9, (2, count - 1)), 1).T
    stops = [start, *(start + cut * (end - start) for cut in cuts), end]
    return [_element(str(rng.choice(PROFILE_PARTS)), a, b) for a, b in zip(stops[:-1], stops[1:], strict=True)]


def frame_profile(rng: np.random.Generator, width: float, height: float) -> np.ndarray:
    """Both edges on the surface: for architraves, picture frames and panels."""
    low, crest = rng.uniform(0.2, 0.6) * height, np.sort(rng.uniform(0.25, 0.85, 2)) * width
    if rng.random() < 0.2:
        return np.array([[0, 0], [0, height], [width, height], [width, 0]])
    parts = [np.array([[0, 0], [0, low]]), *_run(rng, np.array([0, low]), np.array([crest[0], height]), 2),
             np.array([[crest[1], height]])]
    parts += _run(rng, np.array([crest[1], height]), np.array([width, 0.4 * low]), int(rng.integers(1, 3)))
    return np.concatenate([*parts, np.array([[width, 0.0]])])


def edge_profile(rng: np.random.Generator, width: float, height: float) -> np.ndarray:
    """Thick at the start, thin at the end: skirtings, from the floor at 0 up to `width` on the wall."""
    top = rng.uniform(0.5, 0.85) * width
    if rng.random() < 0.3:
        return np.array([[0, 0], [0, height], [width - 0.3 * height, height], [width, 0.7 * height], [width, 0.0]])
    parts = [np.array([[0, 0], [0, height], [top, height]])]
    parts += _run(rng, np.array([top, height]), np.array([width, 0.2 * height]), int(rng.integers(1, 3)))
    return np.concatenate([*parts, np.array([[width, 0.0]])])


def cornice_profile(rng: np.random.Generator, width: float, height: float) -> np.ndarray:
    """From the wall, `height` below the ceiling, to the ceiling, `width` from the wall."""
    inset = 0.15 * np.array([width, height]) * rng.random()
    start, end = np.array([inset[0], height]), np.array([width, inset[1]])
    parts = [np.array([[0, height], [inset[0], height]]), *_run(rng, start, end, int(rng.integers(1, 5)))]
    return np.concatenate([*parts, np.array([[width, 0.0]])])
