"""Cloth: cushions, curtains, bedding, throws and folded stacks, as smooth meshes in metres, y up."""

from __future__ import annotations

import numpy as np

from training.datagen.scenes import meshes, solids
from training.datagen.scenes.meshes import Mesh


def waves(rng: np.random.Generator, x: np.ndarray, y: np.ndarray, size: float, count: int = 6) -> np.ndarray:
    """A sum of sine waves about as long as `size`, amplitude about 1: soft folds."""
    total = np.zeros(np.broadcast_shapes(x.shape, y.shape))
    for _ in range(count):
        heading, length = rng.uniform(0, 2 * np.pi), size * np.exp(rng.normal(0, 0.4))
        phase = 2 * np.pi * (np.cos(heading) * x + np.sin(heading) * y) / length + rng.uniform(0, 2 * np.pi)
        total = total + np.sin(phase + 0.8 * np.sin(0.37 * phase))
    return total / np.sqrt(count)


def cushion(rng: np.random.Generator, width: float, depth: float, thick: float) -> Mesh:
    """A stuffed cushion that lies about the origin, thick along y, with creases that run into its seam."""
    t = np.sin(np.linspace(-1, 1, 26) * np.pi / 2)
    s, t = np.meshgrid(t, t, indexing="ij")
    pinch = rng.uniform(0.04, 0.14)
    x, z = 0.5 * width * s * (1 - pinch * (1 - t**2)), 0.5 * depth * t * (1 - pinch * (1 - s**2))
    full = np.clip((1 - s**2) * (1 - t**2), 0, 1) ** rng.uniform(0.3, 0.5)
    rim = 4 * full * (1 - full)
    crease = rng.uniform(0.02, 0.12)
    parts = []
    for side in (1, -1):
        folds = crease * thick * (rim * waves(rng, x, z, 0.35 * width) + 0.4 * full * waves(rng, x, z, 0.7 * width))
        y = side * (0.5 * thick * full + np.maximum(folds, -0.4 * thick * full))
        points = np.stack([x, y, z], -1)
        mesh = solids.sheet(points if side < 0 else points.transpose(1, 0, 2))
        parts.append(mesh)
    return meshes.merge(parts)


def curtain(rng: np.random.Generator, width: float, height: float) -> Mesh:
    """A pleated curtain from y = 0 to `height`, about x = 0, in the plane z = 0; some are tied to one side."""
    pleats = max(3, int(width * rng.uniform(7, 14)))
    u, v = np.meshgrid(np.linspace(0, 1, 12 * pleats + 1), np.linspace(1, 0, 26))
    shift = 0.35 * np.sin(2 * np.pi * (u * rng.uniform(0.5, 2) + rng.random())) + 0.25 * (1 - v) * np.sin(3 * np.pi * u)
    wave = np.sin(2 * np.pi * (pleats * u + shift))
    depth = rng.uniform(0.02, 0.05) * (0.7 + 0.5 * (1 - v) + 0.3 * np.sin(2 * np.pi * (3 * u + rng.random())))
    tie = rng.uniform(0.3, 0.5) if rng.random() < 0.3 else 0.0
    waist = 1 - (1.6 * tie) * np.exp(-(((v - 0.4) / 0.25) ** 2))
    side = rng.choice([-1, 1])
    x = (u - 0.5) * width * waist + side * 0.5 * width * (1 - waist)
    x = x + 0.012 * np.cos(2 * np.pi * (pleats * u + shift))
    z = depth * wave + 0.01 * (1 - v) * np.sin(5 * u + 2)
    return solids.sheet(np.stack([x, height * v, z], -1))


def _over_edge(s: np.ndarray, half: float, radius: float) -> tuple[np.ndarray, np.ndarray]:
    """Arc length along a cloth over a round edge at `half`: (how far out, how far down)."""
    over = np.maximum(np.abs(s) - (half - radius), 0.0)
    angle = np.clip(over / radius, 0, np.pi / 2)
    out = np.minimum(np.abs(s), half - radius) + radius * np.sin(angle)
    down = radius * (1 - np.cos(angle)) + np.maximum(over - radius * np.pi / 2, 0.0)
    return np.sign(s) * out, down


def draped(rng: np.random.Generator, width: float, depth: float, hang: float, hang_z: float, crease: float) -> Mesh:
    """A cloth that lies on a block of width x depth about the origin, top at y = 0, and hangs down its sides.

    `hang` and `hang_z` are the lengths over its x and z edges, `crease` the height of its folds in metres.
    """
    reach_x, reach_z = width / 2 + hang, depth / 2 + hang_z
    s, t = np.meshgrid(np.linspace(-reach_x, reach_x, 64), np.linspace(-reach_z, reach_z, 64), indexing="ij")
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
    return solids.sheet(np.stack([x, y, z], -1).transpose(1, 0, 2))


def folded(rng: np.random.Generator, width: float, depth: float, layers: int) -> Mesh:
    """A pile of folded cloths on y = 0."""
    parts, y = [], 0.0
    for _ in range(layers):
        thick = rng.uniform(0.02, 0.06)
        slip, size = rng.normal(0, 0.01, 2), np.array([width, depth]) * rng.uniform(0.85, 1, 2) / 2
        parts.append(solids.rounded([slip[0] - size[0], y, slip[1] - size[1]],
                                    [slip[0] + size[0], y + thick, slip[1] + size[1]], 0.48 * thick))
        y += thick
    return meshes.merge(parts)
