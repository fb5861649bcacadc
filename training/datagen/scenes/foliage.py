"""Plants: leaves, grass and other things that are mostly narrower than a pixel, and pot plants with
curved, smooth leaves. Things as in furniture, standing on y = 0."""

from __future__ import annotations

from typing import Any

import numpy as np

from training.datagen.scenes import meshes, solids
from training.datagen.scenes.clutter import smooth_lathe
from training.datagen.scenes.furniture import Thing
from training.datagen.scenes.meshes import Mesh

# x across, y along, 0..1
BLADE = np.array([[-1, 0], [1, 0], [0.8, 0.5], [-0.8, 0.5], [0, 1]], float)
LEAF = np.array([[0, 0], [0.8, 0.35], [0.7, 0.65], [0, 1], [-0.7, 0.65], [-0.8, 0.35]], float)


def cards(outline: np.ndarray, faces: np.ndarray, root: np.ndarray, across: np.ndarray,
          along: np.ndarray, bend: np.ndarray) -> Mesh:
    """One flat outline (K, 2) for each of N places: `root`, `across`, `along` and `bend` are (N,
    3).

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


def blades(rng: np.random.Generator, root: np.ndarray, length: float, width: float,
           lean: float) -> Mesh:
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
    across *= 0.3 * np.linalg.norm(along, axis=1, keepdims=True) / np.linalg.norm(across, axis=1,
                                                                                  keepdims=True)
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


def grass(rng: np.random.Generator) -> list[Any]:
    """A tuft of grass."""
    n, reach = int(rng.integers(80, 500)), rng.uniform(0.15, 0.5)
    root = rng.normal(0, reach, (n, 3)) * [1, 0, 1]
    length = rng.uniform(0.2, 0.9)
    return [(blades(rng, root, length, rng.uniform(0.003, 0.012), rng.uniform(0.1, 1.0)), "leaf")]


def bush(rng: np.random.Generator) -> list[Any]:
    """A ball of leaves on a few twigs."""
    n, radius = int(rng.integers(200, 1200)), rng.uniform(0.3, 0.6)
    shell = rng.normal(0, 1, (n, 3))
    shell *= radius * rng.uniform(0.6, 1.0, (n, 1)) / np.linalg.norm(shell, axis=1, keepdims=True)
    centre = np.array([0, radius + rng.uniform(0.05, 0.5), 0])
    parts = [(leaves(rng, shell * [1, rng.uniform(0.7, 1.3), 1] + centre, rng.uniform(0.03, 0.12)),
              "leaf")]
    return parts + [(_twig(rng, centre + 0.5 * radius * rng.normal(0, 1, 3)), "second")
                    for _ in range(5)]


def _twig(rng: np.random.Generator, end: np.ndarray) -> Mesh:
    t = np.linspace(0, 1, 6)[:, None]
    sway = 0.08 * rng.normal(0, 1, 3) * [1, 0, 1]
    return tube(t * end + np.sin(np.pi * t) * sway, rng.uniform(0.004, 0.012))


def fern(rng: np.random.Generator) -> list[Any]:
    """Arching fronds with leaflets on both sides."""
    parts = []
    for turn in rng.uniform(0, 2 * np.pi, int(rng.integers(6, 14))):
        t = np.linspace(0, 1, 18)[:, None]
        reach = rng.uniform(0.3, 0.6)
        tall = rng.uniform(0.4, 0.9)
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


def leafy_tree(rng: np.random.Generator) -> list[Any]:
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
    parts.append((leaves(rng, root + rng.normal(0, 0.12, root.shape), rng.uniform(0.05, 0.15)),
                  "leaf"))
    return parts


def wires(rng: np.random.Generator) -> list[Any]:
    """Hanging cables between two poles."""
    span, tall = rng.uniform(0.6, 1.5), rng.uniform(0.8, 1.8)
    parts = [(meshes.cylinder(0.02, tall, 8).transform(meshes.translation(x, 0, 0)), "second")
             for x in (-span, span)]
    for _ in range(int(rng.integers(3, 12))):
        t, sag, y = np.linspace(-1, 1, 20), rng.uniform(0, 0.4), rng.uniform(0.4, 1.0) * tall
        line = np.stack([span * t, y - sag * (1 - t**2), np.full(20, rng.normal(0, 0.05))], 1)
        parts.append((tube(line, rng.uniform(0.002, 0.008), 5), "main"))
    return parts


def lattice(rng: np.random.Generator) -> list[Any]:
    """Wire mesh in a frame: upright or diagonal, fine or coarse."""
    w, h, pitch = rng.uniform(0.3, 0.9), rng.uniform(0.5, 1.4), rng.uniform(0.03, 0.15)
    radius, parts = rng.uniform(0.002, 0.006), []
    lines: list[tuple[tuple[float, float], tuple[float, float]]] = []
    if rng.random() < 0.5:
        lines += [((x, 0), (x, h)) for x in np.arange(-w, w, pitch)]
        lines += [((-w, y), (w, y)) for y in np.arange(0, h, pitch)]
    else:
        for start in np.arange(-w - h, w, 1.5 * pitch):
            low, high = max(start, -w), min(start + h, w)
            lines += [((low, low - start), (high, high - start)),
                      ((-low, low - start), (-high, high - start))]
    wire = [tube(np.array([[*a, 0.0], [*b, 0.0]]), radius, 5) for a, b in lines if a != b]
    parts.append((meshes.merge(wire), "main"))
    for x in (-w, w):
        parts.append((meshes.box([x - 0.015, 0, -0.015], [x + 0.015, h, 0.015]), "second"))
    for y in (0.0, h):
        parts.append((meshes.box([-w, y - 0.015, -0.015], [w, y + 0.015, 0.015]), "second"))
    return parts


def railing(rng: np.random.Generator) -> list[Any]:
    """Upright bars under a rail, straight or round."""
    count, h, radius = int(rng.integers(10, 40)), rng.uniform(0.5, 1.1), rng.uniform(0.004, 0.015)
    t = np.linspace(-1, 1, count)
    curve = rng.uniform(0, 1.5) * (rng.random() < 0.5)
    x = rng.uniform(0.5, 1.3) * (np.sin(curve * t) / curve if curve else t)
    z = 0.6 * np.cos(curve * t) - 0.6
    top = np.stack([x, np.full(count, h), z], 1)
    bars = [tube(np.stack([p * [1, 0, 1], p]), radius, 6) for p in top]
    return [(meshes.merge(bars), "main"), (tube(top, 2.5 * radius + 0.008, 8), "second"),
            (tube(top * [1, 0.08, 1], radius + 0.004, 8), "second")]


FOLIAGE = (grass, grass, bush, fern, leafy_tree)
THIN = (wires, lattice, lattice, railing)


# Pot plants ---------------------------------------------------------------------------------------

ROWS, COLUMNS = 9, 5


def curved_leaves(root: np.ndarray, heading: np.ndarray, length: np.ndarray, width: float,
                  droop: float, fold: float, blunt: float = 0.8) -> Mesh:
    """Leaves at `root` (N, 3) that start along `heading` (N, 3, unit), hang over by `droop` and
    fold along the middle.

    `length` (N,) in metres, `width` as a part of it; `blunt` below 1 puts the widest place nearer
    to the tip.
    """
    side = np.cross(heading, [0.0, 1, 0])
    side /= np.maximum(np.linalg.norm(side, axis=1, keepdims=True), 1e-6)
    up = np.cross(side, heading)
    t, s = np.linspace(0, 1, ROWS), np.linspace(-1, 1, COLUMNS)
    outline = width * np.sin(np.pi * np.clip(t, 0.015, 0.99) ** blunt)
    spine = t[:, None, None] * heading[:, None, None] - (droop * t**2)[:, None, None] * [0, 1.0, 0]
    across = (outline[:, None] * s)[..., None]
    lift = (fold * outline[:, None] * np.abs(s)
            + 0.15 * outline[:, None] * np.sin(6 * t)[:, None] * s**2)[..., None]
    points = spine + across * side[:, None, None] + lift * up[:, None, None]
    points = root[:, None, None] + length[:, None, None, None] * points
    along, over = np.gradient(points, axis=1), np.gradient(points, axis=2)
    normals = np.cross(along, over)
    normals /= np.maximum(np.linalg.norm(normals, axis=-1, keepdims=True), 1e-12)
    uvs = np.stack(np.broadcast_arrays(0.5 + across[..., 0], t[:, None]), -1)
    uvs = np.broadcast_to(uvs, (*points.shape[:3], 2))
    count = len(root)
    return solids.many(points.reshape(count, -1, 3), normals.reshape(count, -1, 3),
                       uvs.reshape(count, -1, 2), meshes.grid_faces(ROWS - 1, COLUMNS - 1))


def _pot(rng: np.random.Generator, radius: float) -> tuple[Thing, float]:
    h = radius * rng.uniform(1.2, 2.2)
    low = rng.uniform(0.6, 1.0) * radius
    wall = smooth_lathe([[0, 0], [low, 0], [low, 0], [radius, h], [radius, h], [0.9 * radius, h],
                   [0.9 * radius, h], [0.88 * radius, 0.88 * h]], 40)
    soil = smooth_lathe([[0.9 * radius, 0.9 * h], [0.4 * radius, 0.92 * h], [0, 0.92 * h]], 24)
    return [(wall, str(rng.choice(["ceramic", "pot", "gloss"]))), (soil, "soil")], 0.9 * h


def _directions(rng: np.random.Generator, count: int, low: float, high: float) -> np.ndarray:
    """Unit vectors (count, 3), elevations in radians; around in golden angles."""
    turn = 2.4 * np.arange(count) + rng.normal(0, 0.2, count)
    up = rng.uniform(low, high, count)
    return np.stack([np.cos(turn) * np.cos(up), np.sin(up), np.sin(turn) * np.cos(up)], 1)


def rosette(rng: np.random.Generator) -> Thing:
    """Long narrow leaves from the middle: dracaena, snake plant, agave."""
    made, top = _pot(rng, rng.uniform(0.1, 0.18))
    count, length = int(rng.integers(10, 45)), rng.uniform(0.3, 0.8)
    stem = rng.uniform(0.2, 0.8) if rng.random() < 0.4 else 0.0
    # leaves end above the floor
    upright, most = rng.random() < 0.4, (top + stem - 0.05) / (1.1 * length)
    heading = _directions(rng, count, *((1.1, 1.5) if upright else (0.1, 1.4)))
    root = heading * [0.04, 0, 0.04] + [0, top + stem, 0]
    leaves = curved_leaves(root, heading, length * rng.uniform(0.7, 1.1, count),
                           rng.uniform(0.04, 0.09),
                           0.0 if upright else min(rng.uniform(0.2, 0.7), most),
                           rng.uniform(0, 0.5))
    if stem:
        made.append((meshes.cylinder(0.02, stem, 14)
                     .transform(meshes.translation(0, top - 0.02, 0)), "wood"))
    return [*made, (leaves, "leaf")]


def broad(rng: np.random.Generator) -> Thing:
    """Broad leaves on bowed stalks: rubber plant, monstera, calathea."""
    made, top = _pot(rng, rng.uniform(0.1, 0.2))
    count, tall = int(rng.integers(10, 40)), rng.uniform(0.3, 1.0)
    heading = _directions(rng, count, 0.5, 1.4)
    reach = tall * rng.uniform(0.5, 1.0, count)[:, None] * heading
    base = np.array([0, top, 0])
    bow = np.stack([base + 0 * reach, base + reach * [0.3, 0.6, 0.3], base + reach], 1)
    stalks = [tube(line, 0.004, 6) for line in bow]
    flat = heading * [1, 0.25, 1] + rng.normal(0, 0.15, (count, 3))
    flat /= np.linalg.norm(flat, axis=1, keepdims=True)
    leaves = curved_leaves(bow[:, -1], flat, rng.uniform(0.12, 0.3) * rng.uniform(0.7, 1.2, count),
                           rng.uniform(0.22, 0.42), rng.uniform(0.1, 0.6), rng.uniform(0.1, 0.4),
                           rng.uniform(0.6, 0.9))
    return [*made, (meshes.merge(stalks), "leaf2"), (leaves, "leaf")]


def bushy(rng: np.random.Generator) -> Thing:
    """A small tree: many small glossy leaves on twigs."""
    made, top = _pot(rng, rng.uniform(0.12, 0.22))
    tall, spread = rng.uniform(0.5, 1.4), rng.uniform(0.2, 0.4)
    trunk = np.array([[0, top - 0.05, 0], [0.02, top + 0.4 * tall, 0.01], [0, top + tall, 0.0]])
    made.append((tube(trunk, rng.uniform(0.01, 0.025), 10), "wood"))
    twigs, roots = [], []
    for _ in range(int(rng.integers(8, 18))):
        foot = np.array([0, top + tall * rng.uniform(0.45, 1.0), 0])
        end = foot + rng.normal(0, spread, 3) * [1, 0.5, 1] + [0, 0.15, 0]
        twigs.append(tube(np.linspace(foot, end, 4), 0.004, 6))
        roots.append(foot + (end - foot) * rng.uniform(0.3, 1.0, (int(rng.integers(8, 22)), 1)))
    root = np.concatenate(roots)
    heading = rng.normal(0, 1, root.shape) + [0, 0.3, 0]
    heading /= np.linalg.norm(heading, axis=1, keepdims=True)
    leaves = curved_leaves(root, heading,
                           rng.uniform(0.06, 0.13) * rng.uniform(0.7, 1.2, len(root)),
                           rng.uniform(0.2, 0.35), 0.3, rng.uniform(0.1, 0.4))
    return [*made, (meshes.merge(twigs), "wood"), (leaves, "leaf")]


def trailing(rng: np.random.Generator) -> Thing:
    """Vines that hang over the rim, for shelves and tables."""
    made, top = _pot(rng, rng.uniform(0.06, 0.1))
    roots, vines = [], []
    for turn in rng.uniform(0, 2 * np.pi, int(rng.integers(8, 20))):
        t, out = np.linspace(0, 1, 14)[:, None], np.array([np.cos(turn), 0, np.sin(turn)])
        reach, rise = rng.uniform(0.1, 0.25), rng.uniform(0.02, 0.14)
        line = (t * reach * out + [0, top, 0]
                + (rise * np.sin(np.pi * t) - rng.uniform(0, 0.5) * top * t**2) * [0, 1, 0])
        vines.append(tube(line, 0.002, 5))
        roots.append(line[2:])
    root = np.concatenate(roots)
    heading = rng.normal(0, 1, root.shape) * [1, 0.5, 1] + [0, 0.4, 0]
    heading /= np.linalg.norm(heading, axis=1, keepdims=True)
    leaves = curved_leaves(root, heading,
                           rng.uniform(0.03, 0.07) * rng.uniform(0.7, 1.2, len(root)), 0.35, 0.4,
                           0.2)
    return [*made, (meshes.merge(vines), "leaf2"), (leaves, "leaf")]


PLANTS = (rosette, broad, broad, bushy)
