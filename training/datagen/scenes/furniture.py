"""Things to put into scenes: each is a list of (mesh, slot), standing on y = 0 about the y axis,
roughly 1 m in size.

A slot names a role of the thing ('main', 'second', 'metal', 'leaf'); the scene gives each slot a
material.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from training.datagen.scenes import meshes
from training.datagen.scenes.meshes import Mesh, rotation, translation

Thing = list[tuple[Mesh, str]]
Y = np.array([0.0, 1.0, 0.0])


def _at(mesh: Mesh, x: float, y: float, z: float) -> Mesh:
    return mesh.transform(translation(x, y, z))


def table(rng: np.random.Generator) -> Thing:
    w = rng.uniform(0.5, 1.0)
    d = rng.uniform(0.35, 0.6)
    h = rng.uniform(0.4, 0.8)
    leg = rng.uniform(0.015, 0.05)
    parts: Thing = [(meshes.box([-w, h, -d], [w, h + 0.05, d]), "main")]
    for x in (-w + leg, w - leg):
        for z in (-d + leg, d - leg):
            parts.append((_at(meshes.cylinder(leg, h, 12), x, 0, z), "second"))
    return parts


def chair(rng: np.random.Generator) -> Thing:
    s, h, leg = 0.24, 0.45, rng.uniform(0.012, 0.03)
    parts: Thing = [(meshes.box([-s, h, -s], [s, h + 0.04, s]), "main")]
    for x in (-s + leg, s - leg):
        for z in (-s + leg, s - leg):
            top = 0.95 if z < 0 else h
            parts.append((meshes.box([x - leg, 0, z - leg], [x + leg, top, z + leg]), "second"))
    slats = int(rng.integers(2, 7))
    for y in np.linspace(0.55, 0.9, slats):
        parts.append((meshes.box([-s, y, -s], [s, y + 0.2 / slats, -s + 0.02]), "main"))
    return parts


def shelf(rng: np.random.Generator) -> Thing:
    w, d, h, levels = rng.uniform(0.4, 0.9), 0.16, rng.uniform(0.9, 2.0), int(rng.integers(3, 6))
    parts: Thing = [(meshes.box([x - 0.02, 0, -d], [x + 0.02, h, d]), "main") for x in (-w, w)]
    for level in range(levels):
        y = h * level / (levels - 1)
        parts.append((meshes.box([-w, y, -d], [w, y + 0.03, d]), "main"))
        x = -w + 0.05
        while level < levels - 1 and x < w - 0.15 and rng.random() < 0.93:
            thick, tall = rng.uniform(0.02, 0.07), rng.uniform(0.4, 0.85) * h / (levels - 1)
            slot = str(rng.choice(["second", "leaf", "third"]))
            parts.append((meshes.box([x, y + 0.03, -d + 0.02],
                                     [x + thick, y + 0.03 + tall, d - 0.03]), slot))
            x += thick + (0.002 if rng.random() < 0.85 else 0.15)
    return parts


def vase(rng: np.random.Generator) -> Thing:
    heights = np.linspace(0, rng.uniform(0.3, 0.9), 40)
    t = heights / heights[-1]
    radii = 0.14 + 0.07 * np.sin(2 * np.pi * (t * rng.uniform(0.5, 1.6) + rng.random())) - 0.05 * t
    return [(meshes.lathe(np.concatenate([[1e-4], radii]), np.concatenate([[0.0], heights]), 40),
             "main")]


def ball(rng: np.random.Generator) -> Thing:
    radius = rng.uniform(0.15, 0.5)
    return [(_at(meshes.sphere(radius), 0, radius, 0), "main")]


def crate(rng: np.random.Generator) -> Thing:
    w, h, d = rng.uniform(0.15, 0.5, 3)
    return [(meshes.box([-w, 0, -d], [w, 2 * h, d]), "main")]


def stack(rng: np.random.Generator) -> Thing:
    parts: Thing = []
    y = 0.0
    for _ in range(int(rng.integers(3, 8))):
        w, h, d = rng.uniform(0.1, 0.35), rng.uniform(0.03, 0.15), rng.uniform(0.1, 0.3)
        piece = meshes.box([-w, 0, -d], [w, h, d]).transform(rotation(Y, rng.uniform(-0.5, 0.5)))
        parts.append((_at(piece, 0, y, 0), str(rng.choice(["main", "second", "third"]))))
        y += h
    return parts


def ring(rng: np.random.Generator) -> Thing:
    major, tube = rng.uniform(0.2, 0.45), rng.uniform(0.03, 0.15)
    turned = meshes.torus(major, tube).transform(rotation(np.array([1.0, 0, 0.3]),
                                                          rng.uniform(0, 1.6)))
    return [(_at(turned, 0, -turned.vertices[:, 1].min(), 0), "main")]


def lump(rng: np.random.Generator) -> Thing:
    mesh = meshes.blob(rng.uniform(0.2, 0.45), rng, rng.uniform(0.1, 0.6))
    return [(_at(mesh, 0, -mesh.vertices[:, 1].min(), 0), "main")]


def pillar(rng: np.random.Generator) -> Thing:
    return [(meshes.cylinder(rng.uniform(0.05, 0.3), rng.uniform(0.3, 1.6)), "main")]


def spike(rng: np.random.Generator) -> Thing:
    return [(meshes.cone(rng.uniform(0.1, 0.4), rng.uniform(0.3, 1.1)), "main")]


def rods(rng: np.random.Generator) -> Thing:
    """Thin rods, leaning; the case that aliases."""
    parts: Thing = []
    for _ in range(int(rng.integers(6, 24))):
        rod = meshes.cylinder(rng.uniform(0.003, 0.015), rng.uniform(0.5, 1.4), 8)
        lean = rotation(np.array([rng.normal(), 0.01, rng.normal()]), rng.uniform(0, 0.5))
        parts.append((_at(rod.transform(lean), *(rng.uniform(-0.3, 0.3, 3) * [1, 0, 1])), "main"))
    return parts


def slats(rng: np.random.Generator) -> Thing:
    """A blind or fence: parallel slats with gaps."""
    count, w, h = int(rng.integers(8, 30)), rng.uniform(0.3, 1.0), rng.uniform(0.6, 1.6)
    parts: Thing = []
    tilt = rotation(np.array([1.0, 0, 0]), rng.uniform(0, 1.2))
    for y in np.linspace(0.03, h, count):
        piece = meshes.box([-w, -0.3 * h / count, -0.006],
                           [w, 0.3 * h / count, 0.006]).transform(tilt)
        parts.append((_at(piece, 0, y, 0), "main"))
    parts += [(meshes.box([x - 0.015, 0, -0.015], [x + 0.015, h, 0.015]), "second")
              for x in (-w, w)]
    upright = rng.random() < 0.4
    return [(m.transform(translation(0, w, 0) @ rotation(np.array([0, 0, 1.0]), np.pi / 2))
             if upright else m, s)
            for m, s in parts]


def plant(rng: np.random.Generator) -> Thing:
    """A pot with leaf quads on stems: overlapping depth edges."""
    parts: Thing = [(meshes.lathe(np.array([1e-4, 0.1, 0.15]), np.array([0, 0.0, 0.25]), 24),
                     "second")]
    leaves = []
    for _ in range(int(rng.integers(25, 120))):
        size, turn = rng.uniform(0.05, 0.14), rng.uniform(0, 6.3)
        leaf = meshes.quad([-0.4 * size, 0, 0], [0.8 * size, 0, 0], [0, 0.3 * size, size])
        leaf = leaf.transform(rotation(Y, turn) @ rotation(np.array([1.0, 0, 0.2]),
                                                           rng.uniform(-1.2, 0.6)))
        reach = rng.uniform(0.02, 0.3)
        leaves.append(_at(leaf, reach * np.sin(turn), rng.uniform(0.3, 0.9) - 0.5 * reach,
                          reach * np.cos(turn)))
    parts.append((meshes.merge(leaves), "leaf"))
    return parts + [(_at(meshes.cylinder(0.008, 0.6, 6), 0, 0.2, 0), "third")]


def tree(rng: np.random.Generator) -> Thing:
    trunk = meshes.cylinder(rng.uniform(0.04, 0.1), 1.2, 12)
    size = rng.uniform(0.04, 0.1)
    centres = rng.normal(0, 0.3, (int(rng.integers(150, 500)), 3)) * [1, 0.8, 1] + [0, 1.5, 0]
    leaves = [
        _at(meshes.quad([-size, -size, 0], [2 * size, 0, 0], [0, size, 0]).transform(
            rotation(rng.normal(0, 1, 3), rng.uniform(0, 3))), *centre) for centre in centres
    ]
    return [(trunk, "second"), (meshes.merge(leaves), "leaf")]


def wheel(rng: np.random.Generator) -> Thing:
    """A spoked wheel: turning it moves fine depth edges."""
    radius, count = rng.uniform(0.3, 0.5), int(rng.integers(5, 14))
    parts: Thing = [(meshes.torus(radius, 0.04), "main"), (meshes.sphere(0.07, 24), "second")]
    for angle in np.arange(count) * 2 * np.pi / count:
        spoke = meshes.cylinder(0.012, radius, 8).transform(rotation(np.array([0, 0, 1.0]),
                                                                     np.pi / 2))
        parts.append((spoke.transform(rotation(Y, angle)), "second"))
    stand = translation(0, radius + 0.04, 0) @ rotation(np.array([1.0, 0, 0]), np.pi / 2)
    return [(m.transform(stand), slot) for m, slot in parts]


FURNITURE: tuple[Callable[[np.random.Generator], Thing], ...] = (
    table, table, chair, chair, shelf, shelf, plant, slats, crate, pillar, stack, vase, rods)
OBJECTS: tuple[Callable[[np.random.Generator], Thing], ...] = (
    vase, ball, ball, crate, stack, ring, lump, lump, pillar, spike, rods, plant, wheel, slats,
    chair)


def pick(rng: np.random.Generator, kinds: tuple[Any, ...] = OBJECTS) -> Thing:
    return kinds[int(rng.integers(len(kinds)))](rng)


def resize(thing: Thing, factor: float) -> Thing:
    matrix = np.diag([factor, factor, factor, 1.0])
    return [(mesh.transform(matrix), slot) for mesh, slot in thing]
