"""Furnishing of interiors: things along walls, in the middle, hanging and moving, none
overlapping."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from training.datagen.scenes import (
    clutter,
    fittings,
    fixtures,
    foliage,
    meshes,
    movables,
    solids,
    textures,
)
from training.datagen.scenes.draft import draft_thing, moving_thing
from training.datagen.scenes.furniture import Thing, Y
from training.datagen.scenes.joinery import Opening, between
from training.datagen.scenes.materials import METALS, Material
from training.datagen.scenes.meshes import rotation, translation
from training.datagen.scenes.shell import House, Side

Maker = Callable[[np.random.Generator], Thing]


@dataclass(frozen=True)
class Kind:
    """Furniture of a kind of room: things along the walls and in the middle, and how many of
    each."""

    walls: tuple[Maker, ...]
    middle: tuple[Maker, ...]
    height: tuple[float, float] = (2.3, 3.2)
    tiled: float = 0.0


def brick_wall(house: House) -> None:
    """One wall of painted bricks or stone blocks."""
    side = house.sides[int(house.rng.integers(4))]
    for a, b in between(side.width, side.holes, 0.15, side.height - 0.2, 0.12):
        made = fittings.tiles(house.rng, a, 0.12, b, side.height - 0.02, 0.004)
        house.put([(mesh, "wall") for mesh, _ in made], side.matrix)


def tile_walls(house: House) -> None:
    """All walls tiled alike, up to some height."""
    high, seed = house.rng.uniform(1.2, house.size[1]), int(house.rng.integers(1 << 30))
    for side in house.sides:
        for a, b in between(side.width, side.holes, 0.15, high, 0.12):
            house.put(fittings.tiles(np.random.default_rng(seed), a, 0.12, b, high, 0.012),
                      side.matrix)


def _footprint(thing: Thing, matrix: np.ndarray) -> tuple[Any, ...]:
    points = np.concatenate([mesh.vertices for mesh, _ in thing]) @ matrix[:3, :3].T + matrix[:3, 3]
    low, high = points.min(0), points.max(0)
    return low[0], high[0], low[2], high[2], high[1]


def _fits(house: House, box: tuple[Any, ...], low: float) -> bool:
    """Whether a footprint lies in the room, under its ceiling, apart from others (a rug may lie
    under them)."""
    x0, x1, z0, z1, top = box
    w, _, depth = house.size
    inside = (x0 > -w / 2 - 1e-3 and x1 < w / 2 + 1e-3 and z0 > -depth / 2 - 1e-3
              and z1 < depth / 2 + 1e-3)
    under = top < min(house.headroom(x0), house.headroom(x1)) - 0.05
    apart = low or not any(x0 < b and x1 > a and z0 < d and z1 > c for a, b, c, d, _ in house.taken)
    return bool(inside and under and apart)


def _clear(house: House, spot: np.ndarray, reach: float, height: float) -> bool:
    """Whether nothing on the floor is as high as `height` within `reach` of a place."""
    return not any(a - reach < spot[0] < b + reach and c - reach < spot[2] < d + reach
                   and top > height for a, b, c, d, top in house.taken)


def _place(house: House, thing: Thing, matrix: np.ndarray) -> bool:
    box = _footprint(thing, matrix)
    flat = box[4] < 0.06
    if not _fits(house, box, flat):
        return False
    house.put(thing, matrix)
    if not flat:
        house.taken.append(box)
    sight = np.array([(box[0] + box[1]) / 2, 0.7 * box[4], (box[2] + box[3]) / 2])
    house.sights += (2 if any(role == "leaf" for _, role in thing) else 1) * [sight]
    return True


PLACING_TRIES = 10
"""Places that are tried for a thing before it is left out."""


def furnish(house: House, kind: Kind) -> None:
    """Put things of a kind of room along the walls, into the middle and below windows."""
    rng = house.rng
    for index in rng.permutation(len(kind.walls))[: int(rng.integers(4, 11))]:
        _place_at_wall(house, kind.walls[index](rng))
    for index in rng.permutation(len(kind.middle))[: int(rng.integers(2, 6))]:
        _place_in_middle(house, kind.middle[index](rng))
    for side in house.sides[:4]:
        windows = [hole for hole in side.holes if hole.kind == "window"]
        for hole in windows:
            if hole.y0 > 0.65 and rng.random() < 0.35:
                middle = (hole.x0 + hole.x1) / 2
                _place(house, fixtures.radiator(rng), side.matrix @ translation(middle, 0, 0.0))
        for hole in windows:
            if hole.y0 > 0.2 and rng.random() < 0.4:
                house.put(_sill(house, hole), side.matrix)


def _place_at_wall(house: House, thing: Thing) -> None:
    """Place a thing before a wall, away from its openings, if there is room."""
    for _ in range(PLACING_TRIES):
        side = house.sides[int(house.rng.integers(4))]
        x = house.rng.uniform(0.3, side.width - 0.3)
        if _blocked(side, thing, x):
            continue
        if _place(house, thing, side.matrix @ translation(x, 0, 0.04)):
            return


def _place_in_middle(house: House, thing: Thing) -> None:
    """Place a thing away from the walls, about parallel to them, if there is room."""
    rng, (w, _, depth) = house.rng, house.size
    for _ in range(PLACING_TRIES):
        spot = translation(rng.uniform(-0.35, 0.35) * w, 0, rng.uniform(-0.35, 0.35) * depth)
        turn = rotation(Y, float(rng.choice(4)) * np.pi / 2 + rng.normal(0, 0.08))
        if _place(house, thing, spot @ turn):
            return


def _sill(house: House, hole: Opening) -> Thing:
    """Plants and small things on a window sill, where it is deep enough."""
    kinds = (foliage.trailing, foliage.trailing, clutter.vase, clutter.bottle, clutter.jar,
             clutter.tumbler)
    back, count = -house.style.thick + 0.07, int(house.rng.integers(1, 6))
    return clutter.arrange(house.rng, hole.x0 + 0.03, hole.x1 - 0.03, back, 0.02, hole.y0 + 0.004,
                           count, kinds, 0.5)


def _blocked(side: Side, thing: Thing, x: float) -> bool:
    """Whether a thing at x would stand before a door, or before a window higher than its sill."""
    points = np.concatenate([mesh.vertices for mesh, _ in thing])
    a, b, top = x + points[:, 0].min() - 0.08, x + points[:, 0].max() + 0.08, points[:, 1].max()
    return any(h.x0 < b and h.x1 > a and (h.y0 < 0.1 or top > h.y0 + 0.15) for h in side.holes)


def stairs(house: House) -> None:
    """A flight along a wall, where one is long enough and free."""
    rng, steps = house.rng, int(house.rng.integers(7, 16))
    flight = fixtures.stairs(rng, min(0.18 * steps, house.size[1] - 0.2), steps,
                             rng.uniform(0.75, 1.1))
    for index in rng.permutation(4):
        side, x = house.sides[index], rng.uniform(0.1, 0.5)
        if not _blocked(side, flight, x) and _place(house, flight,
                                                    side.matrix @ translation(x, 0, 0.03)):
            break


def hang(house: House) -> None:
    """Pictures and mirrors on the walls, lamps and beams under the ceiling."""
    rng, (w, h, depth) = house.rng, house.size
    for side in house.sides[:4]:
        for a, b in between(side.width, side.holes, 1.2, 2.0, 0.2):
            if b - a > 0.7 and h > 2.1 and rng.random() < 0.6:
                _pictures(house, side, a, b)
    if house.pitch or rng.random() < 0.2:
        return _beams(house)
    if rng.random() < 0.35:
        lamp = movables.pendant(rng)
        house.put(lamp, translation(rng.uniform(-0.2, 0.2) * w, h - 0.002,
                                    rng.uniform(-0.2, 0.2) * depth))
    return None


def _pictures(house: House, side: Side, a: float, b: float) -> None:
    rng, y = house.rng, house.rng.uniform(1.4, 1.6)
    if rng.random() < 0.15:
        eta, k = METALS["silver"]
        house.roles.add("art", Material("conductor", eta=eta, k=k))
    else:
        house.roles.add("art", Material("diffuse", textures.picture(rng) if rng.random() < 0.6 else
                                        textures.texture(rng, flat=0)))
    count = int(rng.integers(1, 4)) if b - a > 1.5 else 1
    size = np.minimum(rng.uniform(0.25, 0.8, 2), [(b - a) / count - 0.1, 0.85])
    for x in a + (np.arange(count) + 0.5) * (b - a) / count:
        picture = clutter.picture_frame(rng, size[0], size[1], "art")
        spot = side.matrix @ translation(x, y, 0.02)
        if _clear(house, spot[:3, 3], 0.5 * size[0], y - 0.5 * size[1]):
            house.put(picture, spot)
    house.sights.append((side.matrix @ np.array([(a + b) / 2, y, 0, 1]))[:3])


def _beams(house: House) -> None:
    """Beams across the ceiling, or rafters and collar beams under a roof."""
    rng, (w, h, depth) = house.rng, house.size
    size, made = rng.uniform(0.05, 0.1), []
    y = h if not house.pitch else h + house.pitch * w / 2 * rng.uniform(0.5, 0.75)
    reach = w / 2 if not house.pitch else w / 2 - (y - h) / house.pitch
    for z in np.arange(-depth / 2 + 0.4, depth / 2 - 0.2, rng.uniform(0.6, 1.4)):
        made.append(solids.rounded_box([-reach, y - 2.2 * size, z - size],
                                       [reach, y - 0.001, z + size], 0.01))
    house.put([(meshes.merge(made), str(rng.choice(["wood", "trim"])))], np.eye(4))


def add_moving_thing(house: House) -> None:
    """Let a thing move in some rooms."""
    rng, (w, _, depth) = house.rng, house.size
    for _ in range(int(rng.choice([0, 1, 2], p=[0.6, 0.28, 0.12]))):
        roles = rng.choice(["gloss", "accent", "pattern", "metal", "leaf", "lacquer"], 4)
        slots = dict(zip(("main", "second", "third", "leaf"), (house.roles[role] for role in roles),
                         strict=True))
        homes = rng.uniform(-0.35, 0.35, (12, 3)) * [w, 0, depth] + [0, rng.choice([0.0, 0.5]), 0]
        home = next((spot for spot in homes if _clear(house, spot, 0.4, 0.0)), homes[0])
        moving_thing(house.d, rng, draft_thing(rng), slots, home, 1.0)
