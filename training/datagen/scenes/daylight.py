"""Light of interiors: bright sheets outside their windows, or an environment that shines in."""

from __future__ import annotations

import numpy as np

from training.datagen.scenes import fixtures, foliage, lights, meshes, solids
from training.datagen.scenes.furniture import Y
from training.datagen.scenes.lights import Environments
from training.datagen.scenes.meshes import Mesh, rotation, translation
from training.datagen.scenes.shell import House, Side


def light(house: House, maps: Environments, calm: bool) -> None:
    """Light a house through its windows; a few get lamps as well."""
    rng = house.rng
    lit = [side for side in house.sides if any(hole.kind == "window" for hole in side.holes)]
    every = [*lit, *house.far_windows]
    gap = float(rng.uniform(0.15, 0.8))
    if house.sky:
        lights.set_environment(house.d, rng, maps, calm, float(rng.uniform(2, 8)), rng.random() < 0.25)
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
    """Shallow boxes outside the windows of each wall, open towards them, that shine inwards; half of them are darker
    below a horizon."""
    rng = house.rng
    bright, cut = lights.tint(rng, 0.03) * rng.uniform(4, 12), rng.uniform(0.2, 0.6) if rng.random() < 0.5 else 0.0
    dim = bright * rng.uniform(0.15, 0.7) * lights.tint(rng, 0.03)
    for start, end, radiance in ((0.0, cut, dim), (cut, 1.0, bright)):
        if end > start:
            made = [mesh.transform(side.matrix) for side in sides
                    for mesh in _sheet(side, house.style.thick, gap, start, end)]
            house.d.emit(meshes.merge(made), radiance)
    for side in sides:
        house.put([(_ground(side, house.style.thick, gap), "ground")], side.matrix)


def _sheet(side: Side, thick: float, gap: float, start: float, end: float) -> list[Mesh]:
    """The back and the sides of a box between two parts of its height, and its top if `end` is 1."""
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
            ends = [np.array([x, hole.y0 + 0.02, z]) for x in (hole.x0 + 0.01, hole.x1 - 0.01)]
            bars = fixtures.rail_between(rng, *ends, meshes.cylinder(0.008, high, 8), high, 0.11)
            house.put([(meshes.merge(bars), "metal")], side.matrix)
        elif gap > 0.4:
            plant = foliage.bushy(rng)
            spot = translation(rng.uniform(hole.x0, hole.x1), hole.y0 - 0.5, z - 0.3)
            house.put(plant, side.matrix @ spot @ rotation(Y, rng.uniform(0, 6.3)))


def outside_only(image: np.ndarray, turn: float, outward: np.ndarray) -> np.ndarray:
    """An environment (H, W, 3), black where no window sees it, so that no samples are wasted there.

    `turn` is its turn about y in degrees, `outward` (N, 3) are the normals of the windows' outer sides. A margin of
    about two texels stays.
    """
    height, width = image.shape[:2]
    v, u = np.mgrid[0:height, 0:width]
    theta, phi = np.pi * (v + 0.5) / height, 2 * np.pi * (u + 0.5) / width
    direction = np.stack([np.sin(phi) * np.sin(theta), np.cos(theta), -np.cos(phi) * np.sin(theta)], -1)
    world = direction @ rotation(Y, np.radians(turn))[:3, :3].T
    seen = (world @ outward.T).max(-1) > -2 * np.pi * 2 / width
    return np.where(seen[..., None], image, 0).astype(np.float32)
