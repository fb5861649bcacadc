"""Pot plants with curved, smooth leaves: broad, narrow, hanging. Things as in furniture, standing on y = 0."""

from __future__ import annotations

import numpy as np

from training.datagen.scenes import foliage, meshes, solids
from training.datagen.scenes.clutter import turned
from training.datagen.scenes.furniture import Thing
from training.datagen.scenes.meshes import Mesh

ROWS, COLUMNS = 9, 5


def curved_leaves(root: np.ndarray, heading: np.ndarray, length: np.ndarray, width: float, droop: float,
                  fold: float, blunt: float = 0.8) -> Mesh:
    """Leaves at `root` (N, 3) that start along `heading` (N, 3, unit), hang over by `droop` and fold along the middle.

    `length` (N,) in metres, `width` as a part of it; `blunt` below 1 puts the widest place nearer to the tip.
    """
    side = np.cross(heading, [0.0, 1, 0])
    side /= np.maximum(np.linalg.norm(side, axis=1, keepdims=True), 1e-6)
    up = np.cross(side, heading)
    t, s = np.linspace(0, 1, ROWS), np.linspace(-1, 1, COLUMNS)
    outline = width * np.sin(np.pi * np.clip(t, 0.015, 0.99) ** blunt)
    spine = t[:, None, None] * heading[:, None, None] - (droop * t**2)[:, None, None] * [0, 1.0, 0]
    across = (outline[:, None] * s)[..., None]
    lift = (fold * outline[:, None] * np.abs(s) + 0.15 * outline[:, None] * np.sin(6 * t)[:, None] * s**2)[..., None]
    points = spine + across * side[:, None, None] + lift * up[:, None, None]
    points = root[:, None, None] + length[:, None, None, None] * points
    along, over = np.gradient(points, axis=1), np.gradient(points, axis=2)
    normals = np.cross(along, over)
    normals /= np.maximum(np.linalg.norm(normals, axis=-1, keepdims=True), 1e-12)
    uvs = np.stack(np.broadcast_arrays(0.5 + across[..., 0], t[:, None]), -1)
    uvs = np.broadcast_to(uvs, (*points.shape[:3], 2))
    count = len(root)
    return solids.many(points.reshape(count, -1, 3), normals.reshape(count, -1, 3), uvs.reshape(count, -1, 2),
                       meshes.grid_faces(ROWS - 1, COLUMNS - 1))


def _pot(rng: np.random.Generator, radius: float) -> tuple[Thing, float]:
    h = radius * rng.uniform(1.2, 2.2)
    low = rng.uniform(0.6, 1.0) * radius
    wall = turned([[0, 0], [low, 0], [low, 0], [radius, h], [radius, h], [0.9 * radius, h], [0.9 * radius, h],
                   [0.88 * radius, 0.88 * h]], 40)
    soil = turned([[0.9 * radius, 0.9 * h], [0.4 * radius, 0.92 * h], [0, 0.92 * h]], 24)
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
    upright, most = rng.random() < 0.4, (top + stem - 0.05) / (1.1 * length)  # leaves end above the floor
    heading = _directions(rng, count, *((1.1, 1.5) if upright else (0.1, 1.4)))
    root = heading * [0.04, 0, 0.04] + [0, top + stem, 0]
    leaves = curved_leaves(root, heading, length * rng.uniform(0.7, 1.1, count), rng.uniform(0.04, 0.09),
                           0.0 if upright else min(rng.uniform(0.2, 0.7), most), rng.uniform(0, 0.5))
    if stem:
        made.append((meshes.cylinder(0.02, stem, 14).transformed(meshes.translation(0, top - 0.02, 0)), "wood"))
    return [*made, (leaves, "leaf")]


def broad(rng: np.random.Generator) -> Thing:
    """Broad leaves on bowed stalks: rubber plant, monstera, calathea."""
    made, top = _pot(rng, rng.uniform(0.1, 0.2))
    count, tall = int(rng.integers(10, 40)), rng.uniform(0.3, 1.0)
    heading = _directions(rng, count, 0.5, 1.4)
    reach = tall * rng.uniform(0.5, 1.0, count)[:, None] * heading
    base = np.array([0, top, 0])
    bow = np.stack([base + 0 * reach, base + reach * [0.3, 0.6, 0.3], base + reach], 1)
    stalks = [foliage.tube(line, 0.004, 6) for line in bow]
    flat = heading * [1, 0.25, 1] + rng.normal(0, 0.15, (count, 3))
    flat /= np.linalg.norm(flat, axis=1, keepdims=True)
    leaves = curved_leaves(bow[:, -1], flat, rng.uniform(0.12, 0.3) * rng.uniform(0.7, 1.2, count),
                           rng.uniform(0.22, 0.42), rng.uniform(0.1, 0.6), rng.uniform(0.1, 0.4), rng.uniform(0.6, 0.9))
    return [*made, (meshes.merge(stalks), "leaf2"), (leaves, "leaf")]


def bushy(rng: np.random.Generator) -> Thing:
    """A small tree: many small glossy leaves on twigs."""
    made, top = _pot(rng, rng.uniform(0.12, 0.22))
    tall, spread = rng.uniform(0.5, 1.4), rng.uniform(0.2, 0.4)
    trunk = np.array([[0, top - 0.05, 0], [0.02, top + 0.4 * tall, 0.01], [0, top + tall, 0.0]])
    made.append((foliage.tube(trunk, rng.uniform(0.01, 0.025), 10), "wood"))
    twigs, roots = [], []
    for _ in range(int(rng.integers(8, 18))):
        foot = np.array([0, top + tall * rng.uniform(0.45, 1.0), 0])
        end = foot + rng.normal(0, spread, 3) * [1, 0.5, 1] + [0, 0.15, 0]
        twigs.append(foliage.tube(np.linspace(foot, end, 4), 0.004, 6))
        roots.append(foot + (end - foot) * rng.uniform(0.3, 1.0, (int(rng.integers(8, 22)), 1)))
    root = np.concatenate(roots)
    heading = rng.normal(0, 1, root.shape) + [0, 0.3, 0]
    heading /= np.linalg.norm(heading, axis=1, keepdims=True)
    leaves = curved_leaves(root, heading, rng.uniform(0.06, 0.13) * rng.uniform(0.7, 1.2, len(root)),
                           rng.uniform(0.2, 0.35), 0.3, rng.uniform(0.1, 0.4))
    return [*made, (meshes.merge(twigs), "wood"), (leaves, "leaf")]


def trailing(rng: np.random.Generator) -> Thing:
    """Vines that hang over the rim, for shelves and tables."""
    made, top = _pot(rng, rng.uniform(0.06, 0.1))
    roots, vines = [], []
    for turn in rng.uniform(0, 2 * np.pi, int(rng.integers(8, 20))):
        t, out = np.linspace(0, 1, 14)[:, None], np.array([np.cos(turn), 0, np.sin(turn)])
        reach, rise = rng.uniform(0.1, 0.25), rng.uniform(0.02, 0.14)
        line = t * reach * out + [0, top, 0] + (rise * np.sin(np.pi * t) - rng.uniform(0, 0.5) * top * t**2) * [0, 1, 0]
        vines.append(foliage.tube(line, 0.002, 5))
        roots.append(line[2:])
    root = np.concatenate(roots)
    heading = rng.normal(0, 1, root.shape) * [1, 0.5, 1] + [0, 0.4, 0]
    heading /= np.linalg.norm(heading, axis=1, keepdims=True)
    leaves = curved_leaves(root, heading, rng.uniform(0.03, 0.07) * rng.uniform(0.7, 1.2, len(root)), 0.35, 0.4, 0.2)
    return [*made, (meshes.merge(vines), "leaf2"), (leaves, "leaf")]


PLANTS = (rosette, broad, broad, bushy)
