"""Triangle meshes as numpy arrays: primitives in metres, y up, with smooth or flat normals and
texture coordinates."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike


@dataclass(frozen=True)
class Mesh:
    """Vertices and normals (N, 3), texture coordinates (N, 2), triangles (M, 3) uint32."""

    vertices: np.ndarray
    normals: np.ndarray
    uvs: np.ndarray
    faces: np.ndarray

    def transform(self, matrix: np.ndarray) -> Mesh:
        """The mesh moved by a 4x4 matrix; normals follow the inverse transpose."""
        linear = matrix[:3, :3]
        normals = self.normals @ np.linalg.inv(linear)
        normals = normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
        faces = self.faces if np.linalg.det(linear) > 0 else self.faces[:, ::-1]
        return Mesh(self.vertices @ linear.T + matrix[:3, 3], normals, self.uvs, faces)

    def scaled_uvs(self, factor: float) -> Mesh:
        return Mesh(self.vertices, self.normals, self.uvs * factor, self.faces)


def merge(meshes: list[Mesh]) -> Mesh:
    offsets = np.cumsum([0] + [len(m.vertices) for m in meshes[:-1]])
    return Mesh(
        np.concatenate([m.vertices for m in meshes]),
        np.concatenate([m.normals for m in meshes]),
        np.concatenate([m.uvs for m in meshes]),
        np.concatenate([m.faces + o for m, o in zip(meshes, offsets, strict=True)]),
    )


def grid_faces(rows: int, columns: int) -> np.ndarray:
    """Two triangles for each cell of a (rows+1) x (columns+1) vertex grid."""
    i, j = np.meshgrid(np.arange(rows), np.arange(columns), indexing="ij")
    a = (i * (columns + 1) + j).ravel()
    b, c, d = a + 1, a + columns + 1, a + columns + 2
    return np.concatenate([np.stack([a, c, b], 1), np.stack([b, c, d], 1)]).astype(np.uint32)


def quad(origin: ArrayLike, edge_u: ArrayLike, edge_v: ArrayLike) -> Mesh:
    """A parallelogram; its normal is edge_u x edge_v; texture coordinates are in metres."""
    origin, edge_u, edge_v = (np.asarray(x, float) for x in (origin, edge_u, edge_v))
    vertices = np.stack([origin, origin + edge_u, origin + edge_u + edge_v, origin + edge_v])
    normal = np.cross(edge_u, edge_v)
    normals = np.tile(normal / np.linalg.norm(normal), (4, 1))
    u, v = np.linalg.norm(edge_u), np.linalg.norm(edge_v)
    uvs = np.array([[0, 0], [u, 0], [u, v], [0, v]])
    return Mesh(vertices, normals, uvs, np.array([[0, 1, 2], [0, 2, 3]], np.uint32))


def box(low: ArrayLike, high: ArrayLike) -> Mesh:
    """An axis-aligned box between two corners."""
    low, high = np.asarray(low, float), np.asarray(high, float)
    x, y, z = np.diag(high - low)
    sides = [(low, z, y), (low + x, y, z), (low, x, z), (low + y, z, x), (low, y, x),
             (low + z, x, y)]
    return merge([quad(*side) for side in sides])


def lathe(radii: ArrayLike, heights: ArrayLike, segments: int = 32) -> Mesh:
    """A profile of (radius, height) pairs, bottom to top, turned about the y axis; smooth
    normals."""
    radii, heights = np.asarray(radii, float), np.asarray(heights, float)
    phi = np.linspace(0, 2 * np.pi, segments + 1)
    slope_r, slope_h = np.gradient(radii), np.gradient(heights)
    outward = np.stack([slope_h, -slope_r], 1)
    outward /= np.maximum(np.linalg.norm(outward, axis=1, keepdims=True), 1e-12)
    ring = np.stack([np.cos(phi), np.sin(phi)], 1)
    vertices = _turned(radii[:, None], heights[:, None], ring)
    normals = _turned(outward[:, :1], outward[:, 1:], ring)
    length = np.concatenate([[0], np.cumsum(np.hypot(np.diff(radii), np.diff(heights)))])
    around = np.maximum(radii.max(), 1e-3) * phi
    uvs = np.stack(np.broadcast_arrays(around[None, :], length[:, None]), -1)
    faces = grid_faces(len(radii) - 1, segments)
    return Mesh(vertices.reshape(-1, 3), normals.reshape(-1, 3), uvs.reshape(-1, 2), faces)


def _turned(radius: np.ndarray, height: np.ndarray, ring: np.ndarray) -> np.ndarray:
    return np.stack(np.broadcast_arrays(radius * ring[:, 0], height, radius * ring[:, 1]), -1)


def sphere(radius: float, segments: int = 48) -> Mesh:
    theta = np.linspace(0, np.pi, segments // 2 + 1)
    return lathe(radius * np.sin(theta), -radius * np.cos(theta), segments)


def cylinder(radius: float, height: float, segments: int = 24) -> Mesh:
    """A closed cylinder on y = 0; the caps have their own flat normals."""
    side = lathe(np.array([radius, radius]), np.array([0.0, height]), segments)
    cap = lathe(np.array([radius, 1e-4]), np.array([height, height]), segments)
    base = lathe(np.array([1e-4, radius]), np.array([0.0, 0.0]), segments)
    return merge([side, cap, base])


def cone(radius: float, height: float, segments: int = 32) -> Mesh:
    side = lathe(np.linspace(radius, 1e-3, 8), np.linspace(0, height, 8), segments)
    return merge([side, lathe(np.array([1e-4, radius]), np.array([0.0, 0.0]), segments)])


def torus(ring: float, tube: float, segments: int = 40, sides: int = 20) -> Mesh:
    """A torus about the y axis."""
    turns = (np.linspace(0, 2 * np.pi, count + 1) for count in (segments, sides))
    phi, theta = np.meshgrid(*turns, indexing="ij")
    normals = np.stack([np.cos(theta) * np.cos(phi), np.sin(theta), np.cos(theta) * np.sin(phi)],
                       -1)
    centre = np.stack([np.cos(phi), np.zeros_like(phi), np.sin(phi)], -1) * ring
    uvs = np.stack([ring * phi, tube * theta], -1)
    faces = grid_faces(segments, sides)[:, ::-1]
    return Mesh((centre + tube * normals).reshape(-1, 3), normals.reshape(-1, 3),
                uvs.reshape(-1, 2), faces)


def height_field(size: float, heights: np.ndarray) -> Mesh:
    """A square ground patch centred on the origin with the given (R, R) heights."""
    n = len(heights)
    axis = np.linspace(-size / 2, size / 2, n)
    z, x = np.meshgrid(axis, axis, indexing="ij")
    dz, dx = np.gradient(heights, axis, axis)
    normals = np.stack([-dx, np.ones_like(dx), -dz], -1)
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    vertices = np.stack([x, heights, z], -1).reshape(-1, 3)
    return Mesh(vertices, normals.reshape(-1, 3), np.stack([x, z], -1).reshape(-1, 2),
                grid_faces(n - 1, n - 1))


def blob(radius: float, rng: np.random.Generator, bumps: float = 0.25) -> Mesh:
    """A sphere displaced by a few random waves, with normals from its faces."""
    base = sphere(1.0, 56)
    waves = rng.normal(0, 3.0, (6, 3))
    offset = np.sin(base.vertices @ waves.T + rng.uniform(0, 6.3, 6)) @ (rng.uniform(0.3, 1.0, 6)
                                                                         * bumps / 3)
    return smooth(Mesh(base.vertices * (radius * (1 + offset))[:, None], base.normals,
                       base.uvs * radius, base.faces))


def smooth(mesh: Mesh) -> Mesh:
    """Area-weighted vertex normals; vertices at the same place share them."""
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    face = np.cross(b - a, c - a)
    _, place = np.unique(np.round(mesh.vertices, 5), axis=0, return_inverse=True)
    total = np.zeros((place.max() + 1, 3))
    for k in range(3):
        np.add.at(total, place.ravel()[mesh.faces[:, k]], face)
    normals = total[place.ravel()]
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    return Mesh(mesh.vertices, normals, mesh.uvs, mesh.faces)


def translation(x: float, y: float, z: float) -> np.ndarray:
    matrix = np.eye(4)
    matrix[:3, 3] = x, y, z
    return matrix


def rotation(axis: np.ndarray, angle: float) -> np.ndarray:
    """Rotation by `angle` radians about `axis` through the origin (Rodrigues)."""
    x, y, z = np.asarray(axis, float) / np.linalg.norm(axis)
    skew = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    matrix = np.eye(4)
    matrix[:3, :3] += np.sin(angle) * skew + (1 - np.cos(angle)) * skew @ skew
    return matrix
