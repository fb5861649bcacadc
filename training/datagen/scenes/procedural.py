"""Procedural scenes: interiors, rooms, product shots and outdoor places, each with a way to draw sensible views."""

from __future__ import annotations

import numpy as np
from scipy import ndimage

from training.datagen.scenes import foliage, furniture, lights, meshes, textures
from training.datagen.scenes.build import Description
from training.datagen.scenes.draft import Draft, Pool, View, add_glowing, draft_thing, moving_thing, place, surface
from training.datagen.scenes.interior import interior
from training.datagen.scenes.lights import Environments
from training.datagen.scenes.motion import object_path, random_bend
from training.datagen.scenes.room import room


def product(rng: np.random.Generator, maps: Environments) -> Draft:
    """A few objects on a floor under an environment, soft boxes or both; often metals that turn."""
    d = Description("product")
    metals = rng.random() < 0.45
    glass = 0.12 if rng.random() < 0.3 else 0.0
    pool = Pool(d, rng, int(rng.integers(4, 8)), gloss=0.4, metal=0.7 if metals else 0.15, glass=glass)
    calm = metals or glass > 0
    floor = d.material(surface(rng, 0.5))
    size = rng.uniform(3, 12)
    d.add(meshes.quad([-size, 0, size], [2 * size, 0, 0], [0, 0, -2 * size]).scaled_uvs(rng.uniform(0.3, 2)), floor)
    if rng.random() < 0.5:
        lights.set_environment(d, rng, maps, calm)
    else:
        if rng.random() < 0.5:
            lights.set_environment(d, rng, maps, calm, gain=0.1)
        for _ in range(int(rng.integers(1, 3))):
            centre = np.array([rng.uniform(-2, 2), rng.uniform(2, 4), rng.uniform(-2, 2)])
            mover = None
            if rng.random() < 0.3:
                d.movers.append(object_path(centre, rng.normal(0, 0.1, 3) * [1, 0.2, 1], np.array([0, 1.0, 0]), 0.0))
                mover, centre = len(d.movers) - 1, np.zeros(3)
            lights.panel(d, rng, centre, float(rng.choice([0.5, 1.5, 3.0])), rng.uniform(10, 60), mover)
    moving = int(rng.choice([0, 1, 2, 4], p=[0.3, 0.3, 0.25, 0.15]))
    for index in range(int(rng.integers(4, 13))):
        thing = furniture.resize(draft_thing(rng), rng.uniform(0.5, 1.3))
        home = np.array([rng.normal(0, 0.8), 0, rng.normal(0, 0.8)])
        uv = float(rng.choice([0.5, 1, 2, 5]))
        if index < moving:
            moving_thing(d, rng, thing, pool.slots(), home, uv)
        else:
            turn = meshes.rotation(furniture.Y, rng.uniform(0, 6.3))
            place(d, thing, pool.slots(), meshes.translation(*home) @ turn, uv)

    if rng.random() < 0.12:
        add_glowing(d, rng, np.array([rng.normal(0, 0.8), 0, rng.normal(0, 0.8)]), rng.uniform(0.5, 5))

    def view(rng: np.random.Generator) -> View:
        angle, distance, height = rng.uniform(0, 6.3), rng.uniform(1.5, 4), rng.uniform(0.3, 2.2)
        eye = np.array([distance * np.cos(angle), height, distance * np.sin(angle)])
        return eye, rng.normal(0, 0.3, 3) + [0, 0.4, 0]

    return Draft(d, view)


def outdoor(rng: np.random.Generator, maps: Environments) -> Draft:
    """Ground, trees, blocks and fences under a sky."""
    d = Description("outdoor")
    pool = Pool(d, rng, int(rng.integers(5, 9)), gloss=0.3, metal=0.08)
    ground = d.material(surface(rng, 0.1))
    n = 48
    heights = (textures.noise(n, 4, rng) - 0.5) * rng.choice([0.0, 0.4, 1.2])
    d.add(meshes.height_field(24, heights).scaled_uvs(rng.uniform(0.3, 2)), ground)
    lights.set_environment(d, rng, maps, False, sunny=rng.random() < 0.5)
    green = rng.choice([0.15, 0.5, 0.85])
    moving = int(rng.choice([0, 1, 2, 3], p=[0.35, 0.3, 0.2, 0.15]))
    wind = None
    if rng.random() < 0.4:
        d.bends.append(random_bend(rng, np.array([0, heights.min(), 0]), 1.5, True))
        wind = len(d.bends) - 1
    if rng.random() < 0.3:
        _meadow(d, rng, pool, heights, wind)
    for index in range(int(rng.integers(10, 26))):
        x, z = rng.normal(0, 2.5, 2)
        y = heights[int(np.clip((z + 12) / 24 * n, 0, n - 1)), int(np.clip((x + 12) / 24 * n, 0, n - 1))]
        thing = _outdoor_thing(rng, green)
        thing = furniture.resize(thing, rng.uniform(0.5, 1.8))
        uv = float(rng.choice([0.5, 1, 2, 4]))
        if index < moving:
            moving_thing(d, rng, thing, pool.slots(), np.array([0.5 * x, y, 0.5 * z]), uv)
        else:
            turn = meshes.rotation(furniture.Y, rng.uniform(0, 6.3))
            sways = wind if any(slot == "leaf" for _, slot in thing) else None
            place(d, thing, pool.slots(), meshes.translation(x, y, z) @ turn, uv, sways)

    def view(rng: np.random.Generator) -> View:
        angle, distance = rng.uniform(0, 6.3), rng.uniform(2, 7)
        eye = np.array([distance * np.cos(angle), rng.uniform(0.6, 3.0), distance * np.sin(angle)])
        return eye, rng.normal(0, 0.8, 3) + [0, 0.7, 0]

    return Draft(d, view)


def _outdoor_thing(rng: np.random.Generator, green: float) -> furniture.Thing:
    if rng.random() < green:
        return furniture.pick(rng, (*foliage.FOLIAGE, furniture.tree))
    return furniture.pick(rng, foliage.THIN if rng.random() < 0.25 else furniture.OBJECTS)


def _meadow(d: Description, rng: np.random.Generator, pool: Pool, heights: np.ndarray,
            wind: int | None) -> None:
    """Grass all over the inner part of the ground."""
    n, count = len(heights), int(rng.integers(1500, 6000))
    place = rng.uniform(-4, 4, (count, 2))
    cell = np.clip((place + 12) / 24 * (n - 1), 0, n - 1)
    y = ndimage.map_coordinates(heights, [cell[:, 1], cell[:, 0]], order=1)
    root = np.stack([place[:, 0], y, place[:, 1]], 1)
    length = rng.uniform(0.1, 0.5)
    blades = foliage.blades(rng, root, length, rng.uniform(0.004, 0.015), rng.uniform(0.1, 0.8))
    d.add(blades, pool.slots()["leaf"], bend=wind)


FAMILIES = ((interior, 0.48), (room, 0.2), (product, 0.18), (outdoor, 0.14))


def draft(rng: np.random.Generator, maps: Environments) -> Draft:
    makers, weights = zip(*FAMILIES, strict=True)
    return makers[int(rng.choice(len(makers), p=weights))](rng, maps)
