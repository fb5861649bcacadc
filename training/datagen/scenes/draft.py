"""Parts shared by procedural scenes: a draft with its views, a pool of materials, placed and moving things."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from training.datagen.scenes import foliage, furniture, lights, meshes, textures
from training.datagen.scenes.build import Description
from training.datagen.scenes.materials import Material, polished_metal, random_material
from training.datagen.scenes.motion import object_path, random_bend

View = tuple[np.ndarray, np.ndarray]


@dataclass
class Draft:
    """A scene and how to draw a view of it: (eye, target)."""

    description: Description
    view: Callable[[np.random.Generator], View]
    near: float = 0.3


class Pool:
    """A few materials shared by many things, so that a scene stays a few shapes."""

    def __init__(self, d: Description, rng: np.random.Generator, count: int, **chances: float) -> None:
        self.indices = [d.material(random_material(rng, **chances)) for _ in range(count)]
        self.rng = rng

    def slots(self) -> dict[str, int]:
        names = ("main", "second", "third", "leaf")
        return {name: int(self.rng.choice(self.indices)) for name in names}


def draft_thing(rng: np.random.Generator, kinds: tuple = furniture.OBJECTS) -> furniture.Thing:
    """Mostly one of `kinds`, at times a plant of many leaves or something thin."""
    pick = rng.random()
    return furniture.pick(rng, foliage.FOLIAGE if pick < 0.1 else foliage.THIN if pick < 0.2 else kinds)


def place(d: Description, thing: furniture.Thing, slots: dict[str, int], matrix: np.ndarray, uv: float,
          bend: int | None = None) -> None:
    for mesh, slot in thing:
        d.add(mesh.transform(matrix).scaled_uvs(uv), slots[slot], bend=bend)


def fine(thing: furniture.Thing) -> bool:
    """Whether a thing has enough vertices to bend."""
    return sum(len(mesh.vertices) for mesh, _ in thing) > 300


def moving_thing(d: Description, rng: np.random.Generator, thing: furniture.Thing, slots: dict[str, int],
                 home: np.ndarray, uv: float, metre: float = 1.0) -> None:
    """Add a thing that slides, turns or tumbles, and may bend; some are of polished metal.

    Speeds are from slow to fast, in metres and radians a frame.
    """
    height = max(mesh.vertices[:, 1].max() for mesh, _ in thing)
    kind = rng.choice(["slide", "turn", "tumble", "both"])
    if rng.random() < 0.2:
        shiny, kind = d.material(polished_metal(rng)), rng.choice(["turn", "tumble"])
        slots = {name: shiny for name in slots}
    speed = 0.02 * metre * np.exp(rng.normal(0, 0.9)) * (kind in ("slide", "both", "tumble"))
    spin = float(np.clip(rng.normal(0, 0.12), -0.4, 0.4)) * (kind != "slide")
    heading = rng.uniform(0, 2 * np.pi)
    velocity = speed * np.array([np.cos(heading), 0, np.sin(heading)])
    axis = rng.normal(0, 1, 3) if kind == "tumble" else np.array([0.0, 1, 0])
    lift = 0.5 * height
    raised = home + np.array([0, lift + (0.5 * height if kind == "tumble" else 0.0), 0])
    d.movers.append(object_path(raised, velocity, axis, spin))
    mover, bend = len(d.movers) - 1, None
    if fine(thing) and rng.random() < 0.35:
        d.bends.append(random_bend(rng, np.array([0, -lift, 0]), height, any(slot == "leaf" for _, slot in thing)))
        bend = len(d.bends) - 1
    for mesh, slot in thing:
        d.add(mesh.transform(meshes.translation(0, -lift, 0)).scaled_uvs(uv), slots[slot], mover, bend)


def add_glowing(d: Description, rng: np.random.Generator, home: np.ndarray, power: float) -> None:
    """Add a thing that gives light, like a neon sign or a paper lamp; at times it moves."""
    things = (furniture.ball, furniture.ring, furniture.ring, furniture.lump, furniture.pillar)
    thing = furniture.resize(furniture.pick(rng, things), rng.uniform(0.2, 0.7))
    mesh = meshes.merge([mesh for mesh, _ in thing])
    mover, matrix = None, meshes.translation(*home)
    if rng.random() < 0.4:
        d.movers.append(object_path(home, rng.normal(0, 0.03, 3) * [1, 0.3, 1], rng.normal(0, 1, 3), 0.1))
        mover, matrix = len(d.movers) - 1, np.eye(4)
    d.emit(mesh.transform(matrix), lights.tint(rng, 0.6) * power, mover)


def add_moving(d: Description, rng: np.random.Generator, home: np.ndarray, metre: float) -> None:
    """Add a random moving thing with materials of its own; `metre` is the length of a metre in the scene's units."""
    pool = Pool(d, rng, 2, gloss=0.4, metal=0.3)
    thing = furniture.resize(furniture.pick(rng), metre * rng.uniform(0.3, 0.9))
    moving_thing(d, rng, thing, pool.slots(), home, float(rng.choice([1, 3])) / metre, metre)


def surface(rng: np.random.Generator, gloss: float) -> Material:
    """A wall or floor: textured, never metal."""
    albedo = textures.wood(rng) if rng.random() < 0.3 else textures.texture(rng, flat=0.3)
    if rng.random() < gloss:
        return Material("roughplastic", albedo, float(rng.uniform(0.2, 0.6) ** 2))
    return Material("diffuse", albedo)
