"""Procedural scenes: interiors, rooms, product shots and outdoor places, each with a way to draw
sensible views."""

from __future__ import annotations

import numpy as np
from scipy import ndimage

from training.datagen.scenes import foliage, furniture, lights, meshes, textures
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
from training.datagen.scenes.interior import interior
from training.datagen.scenes.lights import Environments
from training.datagen.scenes.materials import Material
from training.datagen.scenes.motion import object_path, random_bend
from training.datagen.scenes.room import room


def product(rng: np.random.Generator, maps: Environments) -> Draft:
    """A few objects on a floor under an environment, soft boxes or both; often metals that turn."""
    d = Description("product")
    metals = rng.random() < 0.45
    glass = 0.12 if rng.random() < 0.3 else 0.0
    pool = Pool(d, rng, int(rng.integers(4, 8)), gloss=0.4, metal=0.7 if metals else 0.15,
                glass=glass)
    calm = metals or glass > 0
    floor = d.material(surface(rng, 0.5))
    size = rng.uniform(3, 12)
    d.add(meshes.quad([-size, 0, size], [2 * size, 0, 0], [0, 0, -2 * size])
          .scaled_uvs(rng.uniform(0.3, 2)), floor)
    if rng.random() < 0.5:
        lights.set_environment(d, rng, maps, calm)
    else:
        if rng.random() < 0.5:
            lights.set_environment(d, rng, maps, calm, gain=0.1)
        for _ in range(int(rng.integers(1, 3))):
            centre = np.array([rng.uniform(-2, 2), rng.uniform(2, 4), rng.uniform(-2, 2)])
            mover = None
            if rng.random() < 0.3:
                d.movers.append(object_path(centre, rng.normal(0, 0.1, 3) * [1, 0.2, 1],
                                            np.array([0, 1.0, 0]), 0.0))
                mover, centre = len(d.movers) - 1, np.zeros(3)
            lights.panel(d, rng, centre, float(rng.choice([0.5, 1.5, 3.0])), rng.uniform(10, 60),
                         mover)
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
        add_glowing(d, rng, np.array([rng.normal(0, 0.8), 0, rng.normal(0, 0.8)]),
                    rng.uniform(0.5, 5))

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
        y = heights[int(np.clip((z + 12) / 24 * n, 0, n - 1)),
                    int(np.clip((x + 12) / 24 * n, 0, n - 1))]
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


# Detail finer than a pixel ------------------------------------------------------------------------

PIXEL = 0.009  # metres: about a pixel of 128 at a metre


def fur(rng: np.random.Generator, maps: Environments) -> Draft:
    """Tufts, coats and brushes of hairs thinner than a pixel over fine patterns, mostly out of
    focus, with small bright lamps behind."""
    d = Description("fur")
    d.lens = (float(rng.uniform(0.008, 0.05)) if rng.random() < 0.85 else 0.0,
              float(rng.uniform(0.8, 1.2)))
    floor = d.material(_pattern(rng))
    d.add(meshes.quad([-9, 0, 9], [18, 0, 0], [0, 0, -18]).scaled_uvs(rng.uniform(0.2, 2.0)), floor)
    for side in range(int(rng.integers(0, 3))):
        turn = meshes.rotation(furniture.Y, rng.uniform(-0.7, 0.7) + np.pi * side)
        wall = meshes.quad([-9, -0.5, -rng.uniform(1.2, 4)], [18, 0, 0],
                           [0, 6, 0]).scaled_uvs(rng.uniform(0.2, 2.0))
        d.add(wall.transform(turn), d.material(_pattern(rng)))
    for _ in range(int(rng.integers(1, 5))):
        size, home = rng.uniform(0.25, 0.7), np.array([rng.normal(0, 0.5), 0, rng.normal(0, 0.5)])
        skin = d.material(Material("diffuse", np.full((1, 1, 3), textures.colour(rng), np.float32)))
        body, root, out = _body(rng, size)
        d.add(body.transform(meshes.translation(*home)), skin)
        for _ in range(int(rng.integers(1, 3))):
            kept = rng.random(len(root)) < rng.uniform(0.2, 1.0)
            coat = d.material(Material("diffuse",
                                       np.full((1, 1, 3), textures.colour(rng), np.float32)))
            d.add(_hairs(rng, root[kept] + home, out[kept], size * rng.uniform(0.15, 1.4)), coat)
    pool = Pool(d, rng, 3, gloss=0.4, metal=0.15)
    for _ in range(int(rng.integers(0, 5))):
        thing = furniture.resize(draft_thing(rng), rng.uniform(0.3, 1.0))
        home = meshes.translation(rng.normal(0, 1.5), 0, rng.normal(0, 1.5))
        place(d, thing, pool.slots(), home, rng.uniform(0.5, 4))
    lights.set_environment(d, rng, maps, True, gain=float(rng.choice([0.15, 0.5, 1.0])))
    if rng.random() < 0.6:
        lights.panel(d, rng, np.array([rng.uniform(-2, 2), rng.uniform(2, 4), rng.uniform(-2, 2)]),
                     rng.uniform(0.4, 1.5), rng.uniform(5, 40))
    if rng.random() < 0.8:
        _lamps(d, rng)

    def view(rng: np.random.Generator) -> View:
        angle, distance = rng.uniform(0, 6.3), rng.uniform(1.0, 2.6)
        eye = np.array([distance * np.cos(angle), rng.uniform(0.25, 1.3), distance * np.sin(angle)])
        return eye, rng.normal(0, 0.15, 3) + [0, 0.4, 0]

    return Draft(d, view, near=0.1)


def sunlit(rng: np.random.Generator, maps: Environments) -> Draft:
    """Poles, fences, wires and lattices of about a pixel and less before a sky with a small sun of
    any strength."""
    d = Description("sunlit")
    if rng.random() < 0.2:
        d.lens = (float(rng.uniform(0.004, 0.02)), float(rng.uniform(0.7, 1.3)))
    ground = d.material(_pattern(rng) if rng.random() < 0.7 else surface(rng, 0.1))
    d.add(meshes.quad([-40, 0, 40], [80, 0, 0], [0, 0, -80]).scaled_uvs(rng.uniform(0.15, 1.2)),
          ground)
    lights.set_environment(d, rng, maps, True)
    if rng.random() < 0.5:
        d.environment = np.broadcast_to(lights.tint(rng) * [1, 1, 1], (4, 8, 3)).astype(np.float32)
    bearing, height, far = rng.uniform(0, 6.3), rng.uniform(0.08, 0.9), rng.uniform(6, 20)
    sun = far * np.array([np.cos(bearing) * np.cos(height), np.sin(height),
                          np.sin(bearing) * np.cos(height)])
    radius = far * np.radians(rng.uniform(0.25, 1.2))
    strength = np.exp(rng.uniform(np.log(300), np.log(2e5)))
    d.emit(meshes.sphere(radius, 16).transform(meshes.translation(*sun)),
           lights.tint(rng, 0.05) * strength)
    pool = Pool(d, rng, int(rng.integers(4, 8)), gloss=0.3, metal=0.08)
    for _ in range(int(rng.integers(2, 6))):
        d.add(_thin(rng).transform(meshes.translation(rng.normal(0, 1.0), 0, rng.normal(0, 1.0))
                                   @ meshes.rotation(furniture.Y, rng.uniform(0, 6.3))),
              int(rng.choice(pool.indices)))
    for _ in range(int(rng.integers(0, 6))):
        thing = furniture.resize(draft_thing(rng), rng.uniform(0.5, 1.6))
        home = meshes.translation(rng.normal(0, 1.5), 0, rng.normal(0, 1.5))
        place(d, thing, pool.slots(), home, rng.uniform(0.5, 4))

    def view(rng: np.random.Generator) -> View:
        angle = bearing + np.pi + rng.normal(0, 0.35 if rng.random() < 0.7 else 2.0)
        distance = rng.uniform(2.0, 6.0)
        eye = np.array([distance * np.cos(angle), rng.uniform(0.4, 1.8), distance * np.sin(angle)])
        return eye, rng.normal(0, 0.4, 3) + [0, rng.uniform(0.4, 1.1), 0]

    return Draft(d, view)


def _pattern(rng: np.random.Generator) -> Material:
    """Checks, text, stripes, gravel: never one colour."""
    return Material("diffuse", textures.texture(rng, flat=0.0))


def _body(rng: np.random.Generator, size: float) -> tuple[meshes.Mesh, np.ndarray, np.ndarray]:
    """A body that hairs grow on, and many roots (N, 3) with their directions (N, 3): a head, a roll
    or a mat."""
    count = int(np.exp(rng.uniform(np.log(300), np.log(5000))))
    kind = str(rng.choice(["head", "roll", "mat", "tuft"]))
    if kind == "head":
        body = meshes.blob(0.5 * size, rng, 0.2).transform(meshes.translation(0, 0.5 * size, 0))
        pick = rng.integers(len(body.vertices), size=count)
        return (body, body.vertices[pick] + rng.normal(0, 0.02 * size, (count, 3)),
                body.normals[pick])
    if kind == "roll":
        body = meshes.cylinder(0.15 * size, 1.5 * size)
        turn = rng.uniform(0, 6.3, count)
        out = np.stack([np.cos(turn), rng.normal(0, 0.3, count), np.sin(turn)], 1)
        return (body,
                0.15 * size * out * [1, 0, 1] + [0, 1, 0] * rng.uniform(0, 1.5 * size, (count, 1)),
                out)
    wide = size * (1.0 if kind == "mat" else 0.3)
    body = meshes.box([-wide, 0, -wide], [wide, 0.04, wide])
    root = rng.uniform(-wide, wide, (count, 3)) * [1, 0, 1] + [0, 0.04, 0]
    lean = root * [1, 0, 1] / wide if kind == "tuft" else 0 * root
    return body, root, np.array([0.0, 1, 0]) + 0.5 * lean + rng.normal(0, 0.15, (count, 3))


def _hairs(rng: np.random.Generator, root: np.ndarray, out: np.ndarray,
           length: float) -> meshes.Mesh:
    """Tapering three-sided tubes that grow along `out` and then hang or curl."""
    n, steps = len(root), 6
    radius = PIXEL * np.exp(rng.uniform(np.log(0.08), np.log(0.5)))
    tall = length * rng.uniform(0.5, 1.2, (n, 1, 1))
    along = np.linspace(0, 1, steps)[:, None]
    sag, wave = rng.uniform(0, 0.8), rng.uniform(0, 0.12)
    phase = rng.uniform(0, 6.3, (n, 1, 3))
    path = root[:, None] + tall * (along * out[:, None]
                                   + along**2 * (rng.normal(0, 0.25, (n, 1, 3)) - [0, sag, 0]))
    path = path + tall * wave * along * np.sin(phase + along * rng.uniform(3, 15))
    path[..., 1] = np.abs(path[..., 1]) + radius
    turn = np.arange(4) * 2 * np.pi / 3
    side = np.cross(out, rng.normal(0, 1, (n, 3)))
    side /= np.maximum(np.linalg.norm(side, axis=1, keepdims=True), 1e-9)
    other = np.cross(side, out / np.maximum(np.linalg.norm(out, axis=1, keepdims=True), 1e-9))
    normals = (np.cos(turn)[:, None] * side[:, None, None]
               + np.sin(turn)[:, None] * other[:, None, None])
    normals = np.broadcast_to(normals, (n, steps, 4, 3))
    vertices = path[:, :, None] + radius * (1 - 0.6 * along[None, :, None]) * normals
    faces = (meshes.grid_faces(steps - 1,
                               3)[None] + 4 * steps * np.arange(n)[:, None, None]).reshape(-1, 3)
    count = n * steps * 4
    return meshes.Mesh(vertices.reshape(-1, 3), normals.reshape(-1, 3), np.zeros((count, 2)),
                       faces.astype(np.uint32))


def _lamps(d: Description, rng: np.random.Generator) -> None:
    """Small bright lamps all around, of a few colours, which a lens blurs to discs."""
    for _ in range(int(rng.integers(1, 4))):
        count, size = int(rng.integers(3, 12)), rng.uniform(0.008, 0.04)
        turn, far = rng.uniform(0, 6.3, count), rng.uniform(2.0, 4.5, count)
        homes = np.stack([far * np.cos(turn), rng.uniform(0.2, 2.0, count), far * np.sin(turn)], 1)
        balls = meshes.merge([meshes.sphere(size, 8).transform(meshes.translation(*home))
                              for home in homes])
        d.emit(balls, lights.tint(rng, 0.5) * np.exp(rng.uniform(np.log(8), np.log(150))))


def _thin(rng: np.random.Generator) -> meshes.Mesh:
    """A row of poles, a fence of wires, a lattice or sagging wires, about 3 m long, of a tenth of a
    pixel to two."""
    radius = 3.5 * PIXEL * np.exp(rng.uniform(np.log(0.06), np.log(1.0)))
    height, wide, count = rng.uniform(0.5, 2.2), rng.uniform(0.6, 3.0), int(rng.integers(4, 24))
    across = np.linspace(-0.5 * wide, 0.5 * wide, count)
    kind = str(rng.choice(["poles", "fence", "mesh", "wires"]))
    lines = [] if kind == "wires" else [[[x, 0, 0], [x + rng.normal(0, 0.02), height, 0]]
                                        for x in across]
    if kind == "fence":
        lines += [[[across[0], y, 0], [across[-1], y, 0]]
                  for y in height * np.linspace(0.2, 0.95, 3)]
    if kind == "mesh":
        lines = [[[x, 0, 0], [x + side * height, height, 0]] for x in across
                 for side in (-0.5, 0.5)]
    if kind == "wires":
        bow = np.linspace(-1, 1, 9)
        for y in rng.uniform(0.4, 1.2, int(rng.integers(2, 7))) * height:
            lines.append(np.stack([2 * wide * bow, y + 0.15 * bow**2, 0 * bow + rng.normal(0, 0.1)],
                                  1).tolist())
    return meshes.merge([foliage.tube(np.asarray(line, float), radius * rng.uniform(0.7, 1.4))
                         for line in lines])


FAMILIES = ((interior, 0.48), (room, 0.2), (product, 0.18), (outdoor, 0.14))
FINE = {"fur": fur, "sunlit": sunlit}


def draft(rng: np.random.Generator, maps: Environments, families: tuple[str, ...] = ()) -> Draft:
    """A scene of a random kind, or of one of FINE by name."""
    if families:
        return FINE[families[int(rng.integers(len(families)))]](rng, maps)
    chosen = int(rng.choice(len(FAMILIES), p=[weight for _, weight in FAMILIES]))
    return FAMILIES[chosen][0](rng, maps)
