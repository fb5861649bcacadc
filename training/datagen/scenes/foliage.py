"""Leaves, grass and other thin things: many depth edges, most of them narrower than a pixel. Things as in furniture."""

from __future__ import annotations

import numpy as np

from training.datagen.scenes import meshes
from training.datagen.scenes.meshes import Mesh

BLADE = np.array([[-1, 0], [1, 0], [0.8, 0.5], [-0.8, 0.5], [0, 1]], float)  # x across, y along, 0..1
LEAF = np.array([[0, 0], [0.8, 0.35], [0.7, 0.65], [0, 1], [-0.7, 0.65], [-0.8, 0.35]], float)


def cards(outline: np.ndarray, faces: np.ndarray, root: np.ndarray, across: np.ndarray, along: np.ndarray,
          bend: np.ndarray) -> Mesh:
    """One flat outline (K, 2) for each of N places: `root`, `across`, `along` and `bend` are (N, 3).

    `bend` moves a point by its square along the card, so that blades hang over.
    """
    x, y = outline[:, :1], outline[:, 1:]
    vertices = root[:, None] + x * across[:, None] + y * along[:, None] + y**2 * bend[:, None]
    tangent = along[:, None] + 2 * y * bend[:, None]
    normals = np.cross(across[:, None], tangent)
    normals /= np.maximum(np.linalg.norm(normals, axis=-1, keepdims=True), 1e-12)
    length = np.linalg.norm(along, axis=1)[:, None, None]
    uvs = outline * length + np.random.default_rng(len(root)).random((len(root), 1, 2))
    index = faces[None] + len(outline) * np.arange(len(root))[:, None, None]
    return Mesh(vertices.reshape(-1, 3), normals.reshape(-1, 3), uvs.reshape(-1, 2),
                index.reshape(-1, 3).astype(np.uint32))


def blades(rng: np.random.Generator, root: np.ndarray, length: float, width: float, lean: float) -> Mesh:
    """Upright blades of grass at the roots (N, 3)."""
    n = len(root)
    angle, tall = rng.uniform(0, 2 * np.pi, n), length * rng.uniform(0.5, 1.2, n)[:, None]
    across = width * np.stack([np.cos(angle), np.zeros(n), np.sin(angle)], 1)
    heading = rng.normal(0, 1, (n, 3)) * [1, 0, 1]
    along = tall * (np.array([0.0, 1, 0]) + 0.3 * lean * heading)
    bend = tall * (lean * 0.5 * heading - [0, 0.25 * lean, 0])
    faces = np.array([[0, 1, 2], [0, 2, 3], [3, 2, 4]])
    return cards(BLADE, faces, root, across, along, bend)


def leaves(rng: np.random.Generator, root: np.ndarray, size: float, droop: float = 0.3) -> Mesh:
    """Pointed leaves at the roots (N, 3), turned at random."""
    n = len(root)
    along = rng.normal(0, 1, (n, 3))
    along *= size * rng.uniform(0.6, 1.3, (n, 1)) / np.linalg.norm(along, axis=1, keepdims=True)
    across = np.cross(along, rng.normal(0, 1, (n, 3)))
    across *= 0.3 * np.linalg.norm(along, axis=1, keepdims=True) / np.linalg.norm(across, axis=1, keepdims=True)
    faces = np.array([[0, 1, 2], [0, 2, 3], [0, 3, 4], [0, 4, 5]])
    return cards(LEAF, faces, root, across, along, np.tile([0.0, -droop * size, 0.0], (n, 1)))


def tube(points: np.ndarray, radius: float, sides: int = 6) -> Mesh:
    """A wire of the given radius through points (P, 3)."""
    tangent = np.gradient(points, axis=0)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    helper = np.where(np.abs(tangent[:, 1:2]) < 0.9, [[0.0, 1, 0]], [[1.0, 0, 0]])
    side = np.cross(tangent, helper)
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    up = np.cross(side, tangent)
    angle = np.linspace(0, 2 * np.pi, sides + 1)[:, None]
    normals = np.cos(angle) * side[:, None] + np.sin(angle) * up[:, None]
    vertices = points[:, None] + radius * normals
    length = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    uvs = np.stack(np.broadcast_arrays(radius * angle[None, :, 0], length[:, None]), -1)
    faces = meshes.grid_faces(len(points) - 1, sides)
    return Mesh(vertices.reshape(-1, 3), normals.reshape(-1, 3), uvs.reshape(-1, 2), faces)


def grass(rng: np.random.Generator) -> list:
    """A tuft of grass."""
    n, reach = int(rng.integers(80, 500)), rng.uniform(0.15, 0.5)
    root = rng.normal(0, reach, (n, 3)) * [1, 0, 1]
    length = rng.uniform(0.2, 0.9)
    return [(blades(rng, root, length, rng.uniform(0.003, 0.012), rng.uniform(0.1, 1.0)), "leaf")]


def bush(rng: np.random.Generator) -> list:
    """A ball of leaves on a few twigs."""
    n, radius = int(rng.integers(200, 1200)), rng.uniform(0.3, 0.6)
    shell = rng.normal(0, 1, (n, 3))
    shell *= radius * rng.uniform(0.6, 1.0, (n, 1)) / np.linalg.norm(shell, axis=1, keepdims=True)
    centre = np.array([0, radius + rng.uniform(0.05, 0.5), 0])
    parts = [(leaves(rng, shell * [1, rng.uniform(0.7, 1.3), 1] + centre, rng.uniform(0.03, 0.12)), "leaf")]
    return parts + [(_twig(rng, centre + 0.5 * radius * rng.normal(0, 1, 3)), "second") for _ in range(5)]


def _twig(rng: np.random.Generator, end: np.ndarray) -> Mesh:
    t = np.linspace(0, 1, 6)[:, None]
    sway = 0.08 * rng.normal(0, 1, 3) * [1, 0, 1]
    return tube(t * end + np.sin(np.pi * t) * sway, rng.uniform(0.004, 0.012))


def fern(rng: np.random.Generator) -> list:
    """Arching fronds with leaflets on both sides."""
    parts = []
    for turn in rng.uniform(0, 2 * np.pi, int(rng.integers(6, 14))):
        t, reach, tall = np.linspace(0, 1, 18)[:, None], rng.uniform(0.3, 0.6), rng.uniform(0.4, 0.9)
        out = np.array([np.cos(turn), 0, np.sin(turn)])
        spine = t * reach * out + (tall * np.sin(0.8 * np.pi * t)) * [0, 1, 0]
        side = np.cross(out, [0, 1, 0])
        size = 0.35 * reach * np.sin(np.pi * np.clip(t, 0.08, 0.97))
        root = np.concatenate([spine, spine])
        along = np.concatenate([size * (side + 0.4 * out), size * (0.4 * out - side)])
        across = 0.012 * np.tile(out, (len(root), 1))
        faces = np.array([[0, 1, 2], [0, 2, 3], [0, 3, 4], [0, 4, 5]])
        parts.append((cards(LEAF, faces, root, across, along, -0.2 * np.abs(along)), "leaf"))
        parts.append((tube(spine, 0.004), "second"))
    return parts


def leafy_tree(rng: np.random.Generator) -> list:
    """A trunk with branches and some hundreds of pointed leaves."""
    tall, parts, ends = rng.uniform(1.0, 1.6), [], []
    trunk = np.array([[0, 0, 0], [0.02, 0.5 * tall, 0.01], [0, tall, 0.0]])
    parts.append((tube(trunk, rng.uniform(0.03, 0.07), 10), "second"))
    for _ in range(int(rng.integers(6, 14))):
        foot = np.array([0, rng.uniform(0.5, 1.0) * tall, 0])
        end = foot + rng.normal(0, 0.35, 3) * [1, 0.4, 1] + [0, 0.35, 0]
        parts.append((tube(np.linspace(foot, end, 4), 0.012), "second"))
        ends.append(foot + (end - foot) * rng.uniform(0.3, 1.1, (int(rng.integers(30, 90)), 1)))
    root = np.concatenate(ends)
    parts.append((leaves(rng, root + rng.normal(0, 0.12, root.shape), rng.uniform(0.05, 0.15)), "leaf"))
    return parts


def wires(rng: np.random.Generator) -> list:
    """Hanging cables between two poles."""
    span, tall = rng.uniform(0.6, 1.5), rng.uniform(0.8, 1.8)
    parts = [(meshes.cylinder(0.02, tall, 8).transformed(meshes.translation(x, 0, 0)), "second") for x in (-span, span)]
    for _ in range(int(rng.integers(3, 12))):
        t, sag, y = np.linspace(-1, 1, 20), rng.uniform(0, 0.4), rng.uniform(0.4, 1.0) * tall
        line = np.stack([span * t, y - sag * (1 - t**2), np.full(20, rng.normal(0, 0.05))], 1)
        parts.append((tube(line, rng.uniform(0.002, 0.008), 5), "main"))
    return parts


def lattice(rng: np.random.Generator) -> list:
    """Wire mesh in a frame: upright or diagonal, fine or coarse."""
    w, h, pitch = rng.uniform(0.3, 0.9), rng.uniform(0.5, 1.4), rng.uniform(0.03, 0.15)
    radius, parts = rng.uniform(0.002, 0.006), []
    lines = []
    if rng.random() < 0.5:
        lines += [((x, 0), (x, h)) for x in np.arange(-w, w, pitch)]
        lines += [((-w, y), (w, y)) for y in np.arange(0, h, pitch)]
    else:
        for start in np.arange(-w - h, w, 1.5 * pitch):
            low, high = max(start, -w), min(start + h, w)
            lines += [((low, low - start), (high, high - start)), ((-low, low - start), (-high, high - start))]
    wire = [tube(np.array([[*a, 0.0], [*b, 0.0]]), radius, 5) for a, b in lines if a != b]
    parts.append((meshes.merge(wire), "main"))
    for x in (-w, w):
        parts.append((meshes.box([x - 0.015, 0, -0.015], [x + 0.015, h, 0.015]), "second"))
    for y in (0.0, h):
        parts.append((meshes.box([-w, y - 0.015, -0.015], [w, y + 0.015, 0.015]), "second"))
    return parts


def railing(rng: np.random.Generator) -> list:
    """Upright bars under a rail, straight or round."""
    count, h, radius = int(rng.integers(10, 40)), rng.uniform(0.5, 1.1), rng.uniform(0.004, 0.015)
    t = np.linspace(-1, 1, count)
    curve = rng.uniform(0, 1.5) * (rng.random() < 0.5)
    x, z = rng.uniform(0.5, 1.3) * (np.sin(curve * t) / curve if curve else t), 0.6 * np.cos(curve * t) - 0.6
    top = np.stack([x, np.full(count, h), z], 1)
    bars = [tube(np.stack([p * [1, 0, 1], p]), radius, 6) for p in top]
    return [(meshes.merge(bars), "main"), (tube(top, 2.5 * radius + 0.008, 8), "second"),
            (tube(top * [1, 0.08, 1], radius + 0.004, 8), "second")]


FOLIAGE = (grass, grass, bush, fern, leafy_tree)
THIN = (wires, lattice, lattice, railing)
