"""Rooms: windows, lamps, hidden light; furniture, pictures, moving things."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from training.datagen.scenes import furniture, lights, meshes, textures
from training.datagen.scenes.build import Description
from training.datagen.scenes.draft import (
    Draft,
    Pool,
    View,
    add_glowing,
    draft_thing,
    moving_thing,
    place,
    surface,
)
from training.datagen.scenes.lights import Environments, sky
from training.datagen.scenes.materials import METALS, Material
from training.datagen.scenes.meshes import rotation, translation
from training.datagen.scenes.motion import Camera, look_at, object_path

LIGHTS = {"windows": 0.25, "small": 0.15, "ceiling": 0.2, "lamps": 0.15, "cove": 0.1, "both": 0.15}


def wall(low: np.ndarray, edge: np.ndarray, height: float,
         holes: list[tuple[float, float, float, float]]) -> list[Any]:
    """Quads of an upright wall from `low` along `edge`, leaving out holes (from, to as fractions;
    sill, top in m)."""
    up, parts, x = np.array([0, height, 0]), [], 0.0
    for start, end, sill, top in sorted(holes):
        parts.append(meshes.quad(low + x * edge, (start - x) * edge, up))
        parts.append(meshes.quad(low + start * edge, (end - start) * edge, np.array([0, sill, 0])))
        parts.append(meshes.quad(low + start * edge + [0, top, 0], (end - start) * edge,
                                 [0, height - top, 0]))
        x = end
    parts.append(meshes.quad(low + x * edge, (1 - x) * edge, up))
    return parts


def _windows(rng: np.random.Generator, height: float,
             small: bool) -> list[tuple[float, float, float, float]]:
    count = 1 if small else int(rng.integers(1, 4))
    width = rng.uniform(0.12, 0.25) if small else rng.uniform(0.5, 0.85) / count
    sill, top = rng.uniform(0.2, 1.1), height - rng.uniform(0.2, 0.7)
    return [((k + 0.5) / count - width / 2, (k + 0.5) / count + width / 2, sill, top)
            for k in range(count)]


def bars(low: np.ndarray, edge: np.ndarray, hole: tuple[float, float, float, float],
         count: int) -> list[Any]:
    """Window bars, upright and across."""
    start, end, sill, top = hole
    a, span = low + start * edge, (end - start) * edge
    half = np.array([0.02, 0.02, 0.02])
    made = []
    for k in range(count + 1):
        foot = a + span * k / count
        made.append(meshes.box(foot + [0, sill, 0] - half, foot + [0, top, 0] + half))
        y = sill + (top - sill) * k / count
        ends = np.stack([a + [0, y, 0], a + span + [0, y, 0]])
        made.append(meshes.box(ends.min(0) - half, ends.max(0) + half))
    return made


def room(rng: np.random.Generator, maps: Environments) -> Draft:
    """A room of random size and furniture, with one kind of light."""
    d = Description("room")
    w, h, depth = rng.uniform(3, 8), rng.uniform(2.3, 4), rng.uniform(3, 9)
    calm = rng.random() < 0.3
    pool = Pool(d, rng, int(rng.integers(5, 9)), gloss=0.4, metal=0.2, glass=0.1 if calm else 0.0)
    floor, walls = d.material(surface(rng, 0.5)), d.material(surface(rng, 0.1))
    pale = d.material(Material("diffuse", np.full((1, 1, 3), rng.uniform(0.5, 0.9), np.float32)))
    other = walls if rng.random() < 0.5 else d.material(surface(rng, 0.2))
    plain = pale if rng.random() < 0.6 else walls
    d.add(meshes.quad([-w / 2, 0, depth / 2], [w, 0, 0], [0, 0, -depth])
          .scaled_uvs(rng.uniform(0.3, 1.2)), floor)
    d.add(meshes.quad([-w / 2, h, -depth / 2], [w, 0, 0], [0, 0, depth]), plain)
    light = str(rng.choice(list(LIGHTS), p=list(LIGHTS.values())))
    outside = _add_walls(d, rng, (w, h, depth), light, (plain, other, walls, walls), pale)
    if outside and rng.random() < 0.5:
        d.emit(meshes.merge(outside), lights.tint(rng) * rng.uniform(4, 12))
    elif outside:
        lights.set_environment(d, rng, maps, calm, gain=float(rng.uniform(2, 8)))
    _light_room(d, rng, light, (w, h, depth))
    _furnish(d, rng, pool, (w, h, depth))
    if rng.random() < 0.12:
        home = np.array([rng.uniform(-0.4, 0.4) * w, rng.uniform(0, 1.5),
                         rng.uniform(-0.4, 0.4) * depth])
        add_glowing(d, rng, home, rng.uniform(2, 20))
    if rng.random() < 0.22:
        mirror = d.material(Material("conductor"))
        d.add(meshes.quad([w / 2 - 0.01, 0.5, -0.5], [0, 0, 1], [0, 1.5, 0]), mirror)

    def view(rng: np.random.Generator) -> View:
        x, z = rng.uniform(-0.45, 0.45, 2) * [w, depth]
        eye = np.array([x, rng.uniform(0.5, min(h - 0.3, 2.2)), z])
        target = np.array([rng.uniform(-0.3, 0.3) * w, rng.uniform(0.2, 1.4),
                           rng.uniform(-0.3, 0.3) * depth])
        return eye, target

    return Draft(d, view)


def _add_walls(d: Description, rng: np.random.Generator, size: tuple[float, float, float],
               light: str, materials: Sequence[int], bar_material: int) -> list[meshes.Mesh]:
    """Add four walls, some of them with windows if these light the room; returns sheets outside the
    windows. size: width, height and depth; materials: of each wall."""
    w, h, depth = size
    corners = np.array([[-w / 2, 0, -depth / 2], [w / 2, 0, -depth / 2], [w / 2, 0, depth / 2],
                        [-w / 2, 0, depth / 2]])
    if light not in ("windows", "small", "both"):
        opened_sides = 0
    elif light == "small":
        opened_sides = 1
    else:
        opened_sides = int(rng.integers(1, 3))
    opened = set(rng.choice(4, opened_sides, replace=False))
    uv_scale = rng.uniform(0.3, 1.2)
    outside = []
    for side in range(4):
        low = corners[side]
        edge = corners[(side + 1) % 4] - low
        holes = _windows(rng, h, light == "small") if side in opened else []
        for part in wall(low, edge, h, holes):
            d.add(part.scaled_uvs(uv_scale), materials[side])
        outside += [_outside(low, edge, hole) for hole in holes]
        panes = int(rng.choice([0, 1, 2, 3]))
        for hole in holes if panes else []:
            for bar in bars(low, edge, hole, panes):
                d.add(bar, bar_material)
    return outside


def _outside(low: np.ndarray, edge: np.ndarray,
             hole: tuple[float, float, float, float]) -> meshes.Mesh:
    """A sheet just outside a window: a bright sky that is sampled much better than an
    environment."""
    start, end, sill, top = hole
    out = 0.3 * np.array([edge[2], 0, -edge[0]]) / np.linalg.norm(edge)
    corner = low + (start - 0.05) * edge + out + [0, sill - 0.3, 0]
    return meshes.quad(corner, (end - start + 0.1) * edge, np.array([0, top - sill + 0.6, 0]))


def _light_room(d: Description, rng: np.random.Generator, light: str,
                size: tuple[float, float, float]) -> None:
    w, h, depth = size
    if light in ("ceiling", "both"):
        for _ in range(int(rng.integers(1, 3))):
            x, z = rng.uniform(-0.35, 0.35) * w, rng.uniform(-0.35, 0.35) * depth
            lights.panel(d, rng, np.array([x, h - 0.01, z]), float(rng.choice([0.3, 0.8, 2.0])),
                         rng.uniform(2, 20))
    if light == "lamps":
        for _ in range(int(rng.integers(1, 4))):
            centre = np.array([rng.uniform(-0.4, 0.4) * w, rng.uniform(0.6, h - 0.4),
                               rng.uniform(-0.4, 0.4) * depth])
            mover = None
            if rng.random() < 0.4:
                d.movers.append(object_path(centre, rng.normal(0, 0.05, 3) * [1, 0.3, 1],
                                            np.array([0, 1.0, 0]), 0.0))
                mover, centre = len(d.movers) - 1, np.zeros(3)
            lights.bulb(d, rng, centre, rng.uniform(0.05, 0.25), rng.uniform(5, 30), mover)
    if light == "cove":
        shade = d.material(Material("diffuse", np.full((1, 1, 3), 0.6, np.float32)))
        y = h - rng.uniform(0.3, 0.6)
        d.add(meshes.box([-w / 2, y, -depth / 2], [w / 2, y + 0.03, -depth / 2 + 0.5]), shade)
        strip = meshes.quad([-w / 2, y + 0.05, -depth / 2 + 0.3], [0, 0, 0.15], [w, 0, 0])
        d.emit(strip, lights.tint(rng) * rng.uniform(5, 20))


def _furnish(d: Description, rng: np.random.Generator, pool: Pool,
             size: tuple[float, float, float]) -> None:
    w, h, depth = size
    moving = int(rng.choice([0, 1, 2, 3], p=[0.35, 0.35, 0.2, 0.1]))
    for index in range(int(rng.integers(5, 14))):
        thing = draft_thing(rng, furniture.FURNITURE if rng.random() < 0.6 else furniture.OBJECTS)
        home = np.array([rng.uniform(-0.42, 0.42) * w, 0, rng.uniform(-0.42, 0.42) * depth])
        uv = float(rng.choice([0.5, 1, 2, 4]))
        if index < moving:
            moving_thing(d, rng, thing, pool.slots(), home, uv)
        else:
            turn = meshes.rotation(furniture.Y, float(rng.choice([0, 1, 2, 3]) * np.pi / 2
                                                      + rng.normal(0, 0.15)))
            place(d, thing, pool.slots(), meshes.translation(*home) @ turn, uv)
    frame = d.material(Material("roughplastic", textures.wood(rng), 0.1))
    for _ in range(int(rng.integers(0, 4))):
        image = textures.picture(rng) if rng.random() < 0.6 else textures.texture(rng, flat=0)
        art = d.material(Material("diffuse", image))
        a, b = rng.uniform(0.3, 0.8), rng.uniform(0.3, 0.8)
        x, y = rng.uniform(-0.35, 0.35) * w, rng.uniform(1.0, h - 0.8)
        corner = np.array([a / 2 + 0.04, b / 2 + 0.04, 0])
        centre = np.array([x, y, -depth / 2])
        d.add(meshes.box(centre - corner, centre + corner + [0, 0, 0.03]), frame)
        picture = meshes.quad([x - a / 2, y - b / 2, -depth / 2 + 0.032], [a, 0, 0], [0, b, 0])
        d.add(meshes.Mesh(picture.vertices, picture.normals, picture.uvs / [a, b], picture.faces),
              art)


# The room of samples/room -------------------------------------------------------------------------
# Composed by hand; clips are not drawn from it.

SAMPLE_SIZE = (5.2, 2.8, 6.0)


def flat(*rgb: float) -> np.ndarray:
    return np.full((1, 1, 3), rgb, np.float32)


def sample_room() -> Description:
    """A window-lit living room with a lamp and a turning copper wheel."""
    rng = np.random.default_rng(20)
    d = Description("sample-room")
    w, h, depth = SAMPLE_SIZE
    floor = d.material(Material("roughplastic", textures.wood(rng, 512), 0.06))
    white = d.material(Material("diffuse", flat(0.75, 0.73, 0.7)))
    blue = d.material(Material("diffuse", flat(0.12, 0.22, 0.3)))
    d.add(meshes.quad([-w / 2, 0, depth / 2], [w, 0, 0], [0, 0, -depth]).scaled_uvs(0.5), floor)
    d.add(meshes.quad([-w / 2, h, -depth / 2], [w, 0, 0], [0, 0, depth]), white)
    corners = np.array([[-w / 2, 0, -depth / 2], [w / 2, 0, -depth / 2], [w / 2, 0, depth / 2],
                        [-w / 2, 0, depth / 2]])
    window = (0.25, 0.75, 0.7, 2.3)
    for side, material in enumerate((blue, white, white, white)):
        low, edge = corners[side], corners[(side + 1) % 4] - corners[side]
        for part in wall(low, edge, h, [window] if side in (1, 3) else []):
            d.add(part, material)
        for bar in bars(low, edge, window, 3) if side in (1, 3) else []:
            d.add(bar, white)
    d.environment = sky(np.random.default_rng(5))
    d.environment_turn = 200.0
    d.environment_gain = 12.0
    _furnish_sample(d, rng, white, blue)
    return d


def _furnish_sample(d: Description, rng: np.random.Generator, white: int, blue: int) -> None:
    wood = d.material(Material("roughplastic", textures.wood(rng), 0.09))
    red = d.material(Material("roughplastic", flat(0.5, 0.06, 0.04), 0.04))
    weave = d.material(Material("diffuse", textures.texture(np.random.default_rng(11), flat=0)))
    leaf = d.material(Material("diffuse", flat(0.1, 0.28, 0.06)))
    pot = d.material(Material("roughplastic", flat(0.8, 0.8, 0.78), 0.02))
    black = d.material(Material("roughplastic", flat(0.03, 0.03, 0.035), 0.05))
    eta, k = METALS["copper"]
    copper = d.material(Material("roughconductor", alpha=0.06, eta=eta, k=k))
    table = furniture.table(rng)
    top = max(mesh.vertices[:, 1].max() for mesh, _ in table)
    things: list[tuple[Callable[[np.random.Generator], Any], tuple[float, float, float], float,
                       dict[str, int]]] = [
        (lambda _: table, (0.1, 0, -0.9), 0.0, dict(main=wood, second=black)),
        (furniture.chair, (-0.9, 0, -0.5), 0.9, dict(main=wood, second=black)),
        (furniture.chair, (1.3, 0, -1.3), -2.2, dict(main=red, second=black)),
        (furniture.shelf, (-1.5, 0, -2.75), 0.0,
         dict(main=white, second=red, third=weave, leaf=blue)),
        (furniture.plant, (1.9, 0, -2.2), 0.3, dict(second=pot, leaf=leaf, third=wood)),
        (furniture.crate, (-2.1, 0, 0.2), 0.2, dict(main=weave)),
        (furniture.stack, (-1.15, 0, 0.35), 0.4, dict(main=wood, second=red, third=weave)),
    ]
    for make, home, turn, slots in things:
        for mesh, slot in make(rng):
            d.add(mesh.transform(translation(*home) @ rotation(furniture.Y, turn)), slots[slot])
    for mesh, _ in furniture.vase(np.random.default_rng(2)):
        d.add(mesh.transform(translation(0.35, top, -0.95)), pot)
    lamp = meshes.sphere(0.11, 24).transform(translation(-0.3, top + 0.12, -1.0))
    d.emit(lamp, np.array([60.0, 44.0, 24.0]))
    d.movers.append(object_path(np.array([0.85, 0.42, 0.2]), np.array([0.012, 0, 0.0]),
                                np.array([0, 0.2, 1.0]), -0.06))
    wheel = furniture.wheel(np.random.default_rng(1))
    hub = 0.5 * max(mesh.vertices[:, 1].max() for mesh, _ in wheel)
    for mesh, slot in wheel:
        d.add(mesh.transform(translation(0, -hub, 0)), copper if slot == "main" else black, 0)
    for x, seed in ((0.2, 3), (1.1, 8)):
        art = d.material(Material("diffuse", textures.picture(np.random.default_rng(seed))))
        d.add(meshes.box([x - 0.36, 1.2, -3.0], [x + 0.36, 2.0, -2.97]), black)
        canvas = meshes.quad([x - 0.31, 1.25, -2.965], [0.62, 0, 0], [0, 0.7, 0])
        d.add(meshes.Mesh(canvas.vertices, canvas.normals, canvas.uvs / [0.62, 0.7], canvas.faces),
              art)


def sample_camera(frame: float) -> Camera:
    """A slow truck to the right with a slight turn."""
    eye = np.array([-0.5 + 0.03 * frame, 1.35, 2.75 - 0.01 * frame])
    return Camera(look_at(eye, np.array([0.1 + 0.012 * frame, 0.8, -1.0])), 66.0)


def orbiting_camera(degrees: float) -> Camera:
    """A camera on a circle around the table, at this angle from where the slow one stands, to the
    right."""
    turn = np.radians(degrees)
    eye = np.array([0.1 + 2.2 * np.sin(turn), 1.4, -0.4 + 2.2 * np.cos(turn)])
    return Camera(look_at(eye, np.array([0.1, 0.8, -0.4])), 66.0)
