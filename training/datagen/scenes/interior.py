"""Interiors lit by their windows: living rooms, bedrooms, kitchens, bathrooms, offices, halls,
shops, attics."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from training.datagen.scenes import (
    fittings,
    fixtures,
    foliage,
    furnishing,
    lights,
    meshes,
    movables,
    shell,
    solids,
)
from training.datagen.scenes.build import Description
from training.datagen.scenes.draft import Draft, View
from training.datagen.scenes.furnishing import Kind
from training.datagen.scenes.furniture import Y
from training.datagen.scenes.joinery import Joinery, Opening
from training.datagen.scenes.lights import Environments
from training.datagen.scenes.meshes import Mesh, rotation, translation
from training.datagen.scenes.roles import Roles
from training.datagen.scenes.shell import House, Side

PLANT = foliage.PLANTS
KINDS = {
    "living": Kind((movables.sofa, movables.sofa, fittings.bookcase, fittings.sideboard,
                    fixtures.fireplace, *PLANT),
                   (movables.sofa, movables.armchair, movables.coffee, movables.coffee,
                    movables.rug, *PLANT)),
    "bedroom": Kind((movables.bed, movables.bed, fittings.wardrobe, fittings.sideboard,
                     movables.armchair, *PLANT),
                    (movables.rug, movables.bed, movables.stool, movables.armchair)),
    "kitchen": Kind((fittings.kitchen, fittings.kitchen, fittings.sideboard, fixtures.rack,
                     foliage.broad),
                    (movables.dining, movables.dining, movables.stool, movables.rug)),
    "bathroom": Kind((fixtures.bath, fixtures.basin, fixtures.toilet, fittings.towel_rail,
                      fittings.towel_rail, *PLANT),
                     (movables.stool, movables.rug, foliage.rosette), (2.2, 2.8), 0.85),
    "office": Kind((fittings.desk, fittings.desk, fittings.bookcase, fittings.bookcase,
                    fittings.cabinet, *PLANT),
                   (fittings.desk, movables.dining, movables.chair, *PLANT), (2.4, 3.4)),
    "hall": Kind((fittings.sideboard, movables.stool, fixtures.radiator, fittings.wardrobe, *PLANT),
                 (movables.rug, movables.coffee, foliage.bushy), (2.6, 4.2)),
    "shop": Kind((*5 * (fixtures.rack,), fittings.cabinet, foliage.broad),
                 (fixtures.rack, fixtures.rack, movables.dining, *PLANT), (2.7, 4.0)),
    "dining": Kind((fittings.sideboard, fixtures.fireplace, fittings.bookcase, *PLANT),
                   (movables.dining, movables.dining, movables.rug), (2.4, 3.4)),
    "attic": Kind((
        movables.bed, fixtures.boxes_pile, fixtures.boxes_pile, fittings.bookcase, movables.armchair
    ), (fixtures.boxes_pile, movables.sofa, movables.coffee, movables.dining, movables.rug),
                  (0.7, 1.4)),
}
CHANCES = dict(zip(KINDS, (0.22, 0.16, 0.12, 0.12, 0.1, 0.08, 0.06, 0.08, 0.06), strict=True))


def interior(rng: np.random.Generator, maps: Environments) -> Draft:
    """A furnished room whose light comes through its windows, and views of it."""
    name = str(rng.choice(list(KINDS), p=list(CHANCES.values())))
    kind, d = KINDS[name], Description("interior")
    size = (rng.uniform(2.2, 3.6), 0.0, rng.uniform(2.2, 3.6)) if name == "bathroom" else (
        rng.uniform(3.0, 6.5), 0.0, rng.uniform(3.0, 7.0))
    size = (size[0], float(rng.uniform(*kind.height)), size[2])
    house = House(d, rng, Roles(d, rng), Joinery.draw(rng), size, rng.random() < 0.4)
    if name == "attic":
        house.pitch = float(np.tan(np.radians(rng.uniform(32, 50))))
    _openings(house)
    if rng.random() < kind.tiled:
        house.style = replace(house.style, panels="none")
        furnishing.tile_walls(house)
    elif rng.random() < 0.12:
        house.style = replace(house.style, panels="none")
        furnishing.brick_wall(house)
    shell.build(house)
    shell.dress(house)
    if name in ("hall", "living") and rng.random() < (0.7 if name == "hall" else 0.12):
        furnishing.stairs(house)
    furnishing.furnish(house, kind)
    furnishing.hang(house)
    furnishing.add_moving_thing(house)
    light(house, maps, calm=rng.random() < 0.5)
    return Draft(d, lambda r: _view(house, r), 0.25)


def _openings(house: House) -> None:
    """Large windows in one or two walls, at times roof windows, doors in the others."""
    rng, (w, h, depth) = house.rng, house.size
    walls = shell.frames(w, depth)
    count = 1 if rng.random() < (0.35 if house.sky else 0.65) else 2
    lit = rng.permutation(4)[:count]
    chances = [0.4, 0.5, 0.1] if house.sky else [0.2, 0.3, 0.5]
    sill = float(rng.choice([0.02, rng.uniform(0.3, 0.6), rng.uniform(0.7, 1.0)], p=chances))
    share = rng.uniform(0.7, 0.9) if house.sky else rng.uniform(0.45, 0.8)
    for index, (matrix, width) in enumerate(walls):
        holes = []
        if index in lit and not house.pitch:
            holes = _windows(rng, share * width, width, sill, h - rng.uniform(0.15, 0.5))
        elif rng.random() < 0.55 and h > 2.2:
            at, wide = rng.uniform(0.25, width - 1.25), rng.uniform(0.72, 0.95)
            holes = [Opening(at, 0.0, at + wide, rng.uniform(1.95, 2.15),
                             "door" if rng.random() < 0.75 else "arch")]
        house.sides.append(Side(matrix, width, h, holes))
    if house.pitch:
        for index in (1, 3):
            matrix, width, high = shell.slope_frame(house, index)
            holes = _windows(rng, share * width, width, 0.25 * high, rng.uniform(0.6, 0.85) * high)
            shut = index == 3 and rng.random() < 0.5
            house.sides.append(Side(matrix, width, high, [] if shut else holes, True))


def _windows(rng: np.random.Generator, glazed: float, width: float, sill: float,
             top: float) -> list[Opening]:
    """One to four windows that take `glazed` metres of a wall's width."""
    count = max(1, min(4, round(width / rng.uniform(1.2, 3.5))))
    share = glazed / count
    middle = (np.arange(count) + 0.5) * width / count
    return [Opening(x - share / 2, sill, x + share / 2, max(top, sill + 0.7)) for x in middle]


def _view(house: House, rng: np.random.Generator) -> View:
    """A view from a free place at eye height: across the room, or close to something."""
    w, _, depth = house.size
    reach = rng.uniform(0.7, 2.5)
    for _ in range(40):
        x, z = rng.uniform(-0.46, 0.46, 2) * [w, depth]
        eye = np.array([x, rng.uniform(0.6, 1.8), z])
        clear = (eye[1] < house.headroom(x) - 0.2 and not any(
            a - 0.2 < x < b + 0.2 and c - 0.2 < z < d + 0.2 and eye[1] < top + 0.15
            for a, b, c, d, top in house.taken))
        target = np.array([rng.uniform(-0.45, 0.45) * w, rng.uniform(0.3, 1.7),
                           rng.uniform(-0.45, 0.45) * depth])
        if house.sights and rng.random() < 0.6:
            target = house.sights[int(rng.integers(len(house.sights)))] + rng.normal(0, 0.2, 3)
        if clear and np.linalg.norm(target - eye) > min(reach, 0.4 * (w + depth)):
            return eye, target
    return eye, target


# Daylight: bright sheets outside the windows, or an environment that shines in --------------------

def light(house: House, maps: Environments, calm: bool) -> None:
    """Light a house through its windows; a few get lamps as well."""
    rng = house.rng
    lit = [side for side in house.sides if any(hole.kind == "window" for hole in side.holes)]
    every = [*lit, *house.far_windows]
    gap = float(rng.uniform(0.15, 0.8))
    if house.sky:
        lights.set_environment(house.d, rng, maps, calm, float(rng.uniform(2, 8)),
                               rng.random() < 0.25)
        assert house.d.environment is not None, "it was set"
        outward = np.stack([-side.matrix[:3, 2] for side in every])
        house.d.environment = outside_only(house.d.environment, house.d.environment_turn, outward)
        gap = 2.0
    else:
        _sheets(house, every, gap)
    for side in lit:
        if not side.slope and rng.random() < 0.3:
            _before_windows(house, side, gap)
    if rng.random() < 0.12:
        w, h, depth = house.size
        centre = np.array([rng.uniform(-0.3, 0.3) * w, h - 0.06, rng.uniform(-0.3, 0.3) * depth])
        lights.panel(house.d, rng, centre, 0.6, rng.uniform(1, 8))


def _around(side: Side, gap: float) -> tuple[float, float, float, float]:
    """x0, x1, y0, y1 of a rectangle about all windows of a wall."""
    holes, m = [hole for hole in side.holes if hole.kind == "window"], 0.4 * gap
    return (min(h.x0 for h in holes) - m, max(h.x1 for h in holes) + m,
            min(h.y0 for h in holes) - m, max(h.y1 for h in holes) + m)


def _ground(side: Side, thick: float, gap: float) -> Mesh:
    """The floor of the box outside, lit by its other sides."""
    x0, x1, y0, _ = _around(side, gap)
    return meshes.quad([x0, y0, -thick], [x1 - x0, 0, 0], [0, 0, -gap])


def _sheets(house: House, sides: list[Side], gap: float) -> None:
    """Shallow boxes outside the windows of each wall, open towards them, that shine inwards; half
    of them are darker below a horizon."""
    rng = house.rng
    bright = lights.tint(rng, 0.03) * rng.uniform(4, 12)
    cut = rng.uniform(0.2, 0.6) if rng.random() < 0.5 else 0.0
    dim = bright * rng.uniform(0.15, 0.7) * lights.tint(rng, 0.03)
    for start, end, radiance in ((0.0, cut, dim), (cut, 1.0, bright)):
        if end > start:
            made = [mesh.transform(side.matrix) for side in sides
                    for mesh in _sheet(side, house.style.thick, gap, start, end)]
            house.d.emit(meshes.merge(made), radiance)
    for side in sides:
        house.put([(_ground(side, house.style.thick, gap), "ground")], side.matrix)


def _sheet(side: Side, thick: float, gap: float, start: float, end: float) -> list[Mesh]:
    """The back and the sides of a box between two parts of its height, and its top if `end`
    is 1."""
    x0, x1, low, high = _around(side, gap)
    y0, y1 = low + start * (high - low), low + end * (high - low)
    z, back, up = -thick, -thick - gap, [0, y1 - y0, 0]
    made = [solids.face(x0, y0, x1, y1, back), meshes.quad([x0, y0, back], up, [0, 0, gap]),
            meshes.quad([x1, y0, z], up, [0, 0, -gap])]
    return made if end < 1 else [*made, meshes.quad([x0, y1, back], [x1 - x0, 0, 0], [0, 0, gap])]


def _before_windows(house: House, side: Side, gap: float) -> None:
    """A balcony's railing or plants outside, dark against the light."""
    rng, z = house.rng, -house.style.thick - 0.06
    holes = [hole for hole in side.holes if hole.kind == "window"]
    for hole in holes:
        if rng.random() < 0.5 and gap > 0.2:
            high = rng.uniform(0.3, 0.6)
            left, right = (np.array([x, hole.y0 + 0.02, z])
                           for x in (hole.x0 + 0.01, hole.x1 - 0.01))
            bars = fixtures.rail_between(rng, left, right, meshes.cylinder(0.008, high, 8), high,
                                         0.11)
            house.put([(meshes.merge(bars), "metal")], side.matrix)
        elif gap > 0.4:
            plant = foliage.bushy(rng)
            spot = translation(rng.uniform(hole.x0, hole.x1), hole.y0 - 0.5, z - 0.3)
            house.put(plant, side.matrix @ spot @ rotation(Y, rng.uniform(0, 6.3)))


def outside_only(image: np.ndarray, turn: float, outward: np.ndarray) -> np.ndarray:
    """An environment (H, W, 3), black where no window sees it, so that no samples are wasted there.

    `turn` is its turn about y in degrees, `outward` (N, 3) are the normals of the windows' outer
    sides. A margin of about two texels stays.
    """
    height, width = image.shape[:2]
    v, u = np.mgrid[0:height, 0:width]
    theta, phi = np.pi * (v + 0.5) / height, 2 * np.pi * (u + 0.5) / width
    direction = np.stack([np.sin(phi) * np.sin(theta), np.cos(theta), -np.cos(phi) * np.sin(theta)],
                         -1)
    world = direction @ rotation(Y, np.radians(turn))[:3, :3].T
    seen = (world @ outward.T).max(-1) > -2 * np.pi * 2 / width
    return np.where(seen[..., None], image, 0).astype(np.float32)
