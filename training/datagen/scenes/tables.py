"""Tables with things on them and chairs around them, hanging lamps. Things as in furniture."""

from __future__ import annotations

import numpy as np

from training.datagen.scenes import furniture, meshes, solids
from training.datagen.scenes.clutter import arrange, place_at, smooth_lathe
from training.datagen.scenes.furniture import Thing
from training.datagen.scenes.meshes import Mesh, translation


def _legs(rng: np.random.Generator, w: float, d: float, h: float) -> Mesh:
    """Four legs: tapered, turned or square."""
    if rng.random() < 0.4:
        r = rng.uniform(0.02, 0.035)
        post = solids.boxes([-r, 0, -r], [r, h, r])
    else:
        radii = np.linspace(0.015, 0.03, 8) if rng.random() < 0.5 else rng.uniform(0.015, 0.045, 8)
        post = smooth_lathe(np.stack([radii, np.linspace(0, h, 8)], 1), 18)
    return meshes.merge([post.transform(translation(x, 0, z)) for x in (-w, w) for z in (-d, d)])


def table(rng: np.random.Generator, h: float, w: float, d: float, things: int) -> Thing:
    """A rectangular table about the origin, half sizes w and d, with things on it."""
    t = rng.uniform(0.018, 0.045)
    slot = str(rng.choice(["wood", "wood", "trim", "counter"]))
    apron = solids.boxes([[-w + .05, h - .1, -d + .05], [-w + .05, h - .1, d - .07]],
                         [[w - .05, h - t, -d + .07], [w - .05, h - t, d - .05]])
    under = meshes.merge([_legs(rng, w - 0.06, d - 0.06, h - t), apron])
    made: Thing = [(solids.rounded_box([-w, h - t, -d], [w, h, d], rng.uniform(0.003, 0.4 * t)), slot),
                   (under, str(rng.choice([slot, "wood", "trim"])))]
    return made + arrange(rng, -w, w, -d, d, h, things)


def round_table(rng: np.random.Generator, h: float, r: float, things: int) -> Thing:
    top = smooth_lathe([[0, h - 0.03], [r - 0.01, h - 0.03], [r, h - 0.015], [r - 0.01, h], [r - 0.01, h], [0, h]], 56)
    foot = smooth_lathe([[0, 0], [0.5 * r, 0], [0.5 * r, 0.02], [0.06, 0.06], [0.035, 0.4 * h], [0.05, 0.7 * h],
                   [0.1, h - 0.03]])
    half = r / np.sqrt(2)
    return [(meshes.merge([top, foot]), str(rng.choice(["wood", "trim", "counter"]))),
            *arrange(rng, -half, half, -half, half, h, things)]


def coffee(rng: np.random.Generator) -> Thing:
    h, count = rng.uniform(0.3, 0.45), int(rng.integers(2, 7))
    if rng.random() < 0.4:
        r = rng.uniform(0.3, 0.5)
        return place_at(round_table(rng, h, r, count), 0, 0, r)
    d = rng.uniform(0.25, 0.4)
    return place_at(table(rng, h, rng.uniform(0.4, 0.7), d, count), 0, 0, d)


def chair(rng: np.random.Generator) -> Thing:
    """A chair that looks along +z: slats, or a bowed shell on four legs."""
    slots = {"main": str(rng.choice(["wood", "trim", "fabric"])), "second": str(rng.choice(["wood", "metal"]))}
    if rng.random() < 0.45:
        return [(mesh, slots[slot]) for mesh, slot in furniture.chair(rng)]
    u, v = np.meshgrid(np.linspace(-1, 1, 20), np.linspace(0, 1, 24))
    bend = np.clip((v - 0.5) / 0.12, 0, 1)
    flat, high = 0.44 * np.minimum(v / 0.56, 1), 0.42 * np.clip((v - 0.56) / 0.44, 0, 1)
    x = 0.23 * u * (1 - 0.15 * v)
    y = 0.44 + high + 0.03 * u**2 * (1 - bend) - 0.02 * np.sin(np.pi * v / 0.56) * (v < 0.56)
    z = 0.22 - flat + 0.05 * u**2 * bend - 0.12 * high
    shell = solids.sheet(np.stack([x, y, z], -1))
    return [(shell, slots["main"]), (_legs(rng, 0.17, 0.17, 0.44), slots["second"])]


def dining(rng: np.random.Generator) -> Thing:
    """A table with chairs drawn up to it."""
    h, count = rng.uniform(0.72, 0.76), int(rng.integers(2, 9))
    kind = chair(rng)
    if rng.random() < 0.35:
        r = rng.uniform(0.45, 0.65)
        made, reach = round_table(rng, h, r, count), r + 0.12
        turns = np.arange(4) * np.pi / 2 + rng.uniform(0, 1.5)
        places = [(reach * np.sin(a), reach * np.cos(a), a + np.pi) for a in turns]
    else:
        w, d = rng.uniform(0.6, 1.1), rng.uniform(0.38, 0.5)
        made = table(rng, h, w, d, count)
        along = np.linspace(-0.55 * w, 0.55 * w, round(2 * w / 0.65))
        places = [(x, side * (d + 0.1), np.pi * (side > 0)) for x in along for side in (-1, 1)]
    for x, z, turn in places:
        if rng.random() < 0.85:
            made += place_at(kind, x + rng.normal(0, 0.04), 0, z + rng.normal(0, 0.05), turn + rng.normal(0, 0.15))
    low = min(mesh.vertices[:, 2].min() for mesh, _ in made)
    return place_at(made, 0, 0, -low)


def pendant(rng: np.random.Generator) -> Thing:
    """A lamp that hangs from the origin: a cord and a shade of metal, cloth or china; unlit."""
    drop, r = rng.uniform(0.4, 1.1), rng.uniform(0.12, 0.28)
    h = r * rng.uniform(0.5, 1.3)
    line = np.array([[r, 0], [0.95 * r, 0.3 * h], [0.6 * r, 0.8 * h], [0.03, h], [0.02, h + 0.05]]) - [0, drop]
    if rng.random() < 0.3:
        t = np.linspace(-0.5 * np.pi, 0.5 * np.pi, 9)
        line = np.stack([0.7 * r * np.cos(t) + 1e-4, 0.7 * r * np.sin(t) - drop + h], 1)
    shade = smooth_lathe(line, 40)
    cord = meshes.cylinder(0.003, drop - h, 6).transform(translation(0, h - drop, 0))
    rose = smooth_lathe([[0, -0.03], [0.05, -0.03], [0.06, 0]], 24)
    return [(meshes.merge([cord, rose]), "metal"), (shade, str(rng.choice(["metal", "shade", "ceramic", "gloss"])))]
