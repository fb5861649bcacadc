"""Larger fixtures: fireplaces, radiators, baths, basins, stairs with railings, racks of goods.

Things as in furniture, with their backs at z = 0, centred on x = 0; they look along +z.
"""

from __future__ import annotations

import numpy as np

from training.datagen.scenes import clutter, foliage, meshes, solids
from training.datagen.scenes.clutter import arrange, place_at, smooth_lathe
from training.datagen.scenes.fittings import cabinet
from training.datagen.scenes.furniture import Thing, Y
from training.datagen.scenes.meshes import Mesh, rotation, translation

Z = np.array([0.0, 0, 1])


def fireplace(rng: np.random.Generator) -> Thing:
    """A chimney breast with a mantel of mouldings about a deep dark opening, a hearth, things on
    the mantel."""
    w, h, d = rng.uniform(0.65, 0.95), rng.uniform(1.0, 1.3), rng.uniform(0.12, 0.35)
    a, b = w * rng.uniform(0.5, 0.65), h * rng.uniform(0.6, 0.75)
    body = solids.boxes([[-w, 0, 0], [a, 0, 0], [-a, b, 0]], [[-a, h, d], [w, h, d], [a, h, d]])
    surround = solids.moulding([[-a, 0], [-a, b], [a, b], [a, 0]],
                               solids.frame_profile(rng, 0.6 * (w - a), rng.uniform(0.02, 0.05)))
    pilasters = [solids.moulding(solids.rectangle(x - 0.3 * (w - a), 0.12, x + 0.02, b - 0.02),
                                 solids.frame_profile(rng, 0.02, 0.012), closed=True)
                 for x in (-a - 0.12, w - 0.05)]
    crown = solids.moulding([[-w, h - 0.14], [w, h - 0.14]],
                            solids.cornice_profile(rng, 0.12, 0.1)[::-1, ::-1])
    front = meshes.merge([surround, *pilasters, crown]).transform(translation(0, 0, d))
    shelf = solids.rounded_box([-w - 0.08, h, 0], [w + 0.08, h + 0.045, d + 0.14], 0.012)
    made: Thing = [(meshes.merge([body, front, shelf]),
                    str(rng.choice(["trim", "panel", "counter"])))]
    made.append((solids.face(-a, 0, a, b, 0.004), "soot"))
    made.append((solids.rounded_box([-w - 0.1, 0, d], [w + 0.1, 0.03, d + 0.35], 0.008), "counter"))
    grate = [foliage.tube(np.array([[x, 0.03, d - 0.02], [x, 0.45 * b, d + 0.02]]), 0.006, 8)
             for x in np.linspace(-0.8 * a, 0.8 * a, 11)]
    rail = foliage.tube(np.array([[-0.85 * a, 0.45 * b, d + 0.02], [0.85 * a, 0.45 * b, d + 0.02]]),
                        0.009, 8)
    made.append((meshes.merge([*grate, rail]), "metal"))
    return made + arrange(rng, -w, w, 0.02, d + 0.1, h + 0.045, int(rng.integers(2, 7)))


def radiator(rng: np.random.Generator) -> Thing:
    """Ribs on two pipes."""
    count, h, pitch = int(rng.integers(8, 26)), rng.uniform(0.4, 0.8), rng.uniform(0.045, 0.08)
    thick, x = pitch * rng.uniform(0.5, 0.9), pitch * (np.arange(count) - (count - 1) / 2)
    ribs = [solids.rounded_box([a - thick / 2, 0.12, 0.04], [a + thick / 2, 0.12 + h, 0.14],
                               0.45 * thick) for a in x]
    pipes = [meshes.cylinder(0.018, pitch * count, 14).transform(
        translation(-pitch * count / 2, y, 0.09) @ rotation(Z, -np.pi / 2))
             for y in (0.17, 0.07 + h)]
    valve = meshes.cylinder(0.012, 0.18, 12).transform(translation(pitch * count / 2 + 0.01, 0,
                                                                   0.09))
    return [(meshes.merge([*ribs, *pipes, valve]), str(rng.choice(["trim", "trim", "metal"])))]


def _shell(outer: np.ndarray, squash: float) -> Mesh:
    """A turned vessel stretched along x."""
    return smooth_lathe(outer, 48).transform(np.diag([squash, 1, 1, 1.0]))


def bath(rng: np.random.Generator) -> Thing:
    """A free-standing tub with a rolled rim, a tap and a towel."""
    r, h, stretch = rng.uniform(0.34, 0.42), rng.uniform(0.5, 0.62), rng.uniform(1.9, 2.3)
    line = [[0, 0.04], [0.6 * r, 0.04], [0.8 * r, 0.1], [0.95 * r, 0.6 * h], [1.02 * r, h - 0.01],
            [1.04 * r, h], [r, h + 0.012], [0.93 * r, h - 0.01], [0.85 * r, 0.6 * h],
            [0.7 * r, 0.18], [0.5 * r, 0.13], [0, 0.12]]
    tub = _shell(np.array(line), stretch).transform(translation(0, 0, 1.1 * r))
    foot = solids.rounded_box([-0.9 * r, 0, 0.5 * r], [0.9 * r, 0.06, 1.7 * r], 0.01)
    spout = np.array([[0, 0, 0.05], [0, h + 0.25, 0.05], [0, h + 0.3, 0.1], [0, h + 0.28, 0.2],
                      [0, h + 0.22, 0.22]])
    cloth_on = clutter.place_at(clutter.tray(rng), -0.9 * r * stretch / 1.3, h + 0.01, 1.1 * r)
    return [(meshes.merge([tub, foot]), "porcelain"), (foliage.tube(spout, 0.013, 12), "metal"),
            *(cloth_on if rng.random() < 0.2 else [])]


def basin(rng: np.random.Generator) -> Thing:
    """A wash basin on a stand, a tap, bottles."""
    w, h, d = rng.uniform(0.6, 1.3), rng.uniform(0.78, 0.88), rng.uniform(0.45, 0.55)
    r = 0.4 * d
    line = [[0, 0], [0.4 * r, 0], [0.85 * r, 0.06], [r, 0.13], [r, 0.14], [0.96 * r, 0.14],
            [0.8 * r, 0.06], [0, 0.02]]
    made = cabinet(rng, w, h, d, plinth=float(rng.choice([0.1, 0.35])))
    made.append((solids.rounded_box([-w / 2 - 0.01, h, 0], [w / 2 + 0.01, h + 0.025, d + 0.03],
                                    0.008), "counter"))
    made.append((_shell(np.array(line), 1.25).transform(translation(0, h + 0.025, 0.55 * d)),
                 "porcelain"))
    spout = np.array([[0, h + 0.02, 0.04], [0, h + 0.24, 0.04], [0, h + 0.28, 0.08],
                      [0, h + 0.26, 0.18]])
    made.append((foliage.tube(spout, 0.011, 12), "metal"))
    side = (-w / 2, -1.4 * r) if rng.random() < 0.5 else (1.4 * r, w / 2)
    kinds = (clutter.bottle, clutter.jar, clutter.tumbler, clutter.tray)
    return made + arrange(rng, *side, 0.03, d, h + 0.025, 4, kinds)


def toilet(rng: np.random.Generator) -> Thing:
    line = [[0, 0], [0.13, 0], [0.12, 0.15], [0.17, 0.33], [0.19, 0.39], [0.19, 0.41],
            [0.05, 0.425], [0, 0.425]]
    bowl = _shell(np.array(line), 1.0).transform(translation(0, 0, 0.45)
                                                 @ np.diag([1, 1, 1.3, 1.0]))
    tank = solids.rounded_box([-0.19, 0.4, 0.0], [0.19, 0.78, 0.17], 0.03, 4)
    lid = solids.rounded_box([-0.2, 0.78, -0.0], [0.2, 0.81, 0.18], 0.012)
    neck = solids.rounded_box([-0.1, 0.0, 0.02], [0.1, 0.4, 0.4], 0.04, 4)
    return [(meshes.merge([bowl, tank, lid, neck]), "porcelain")]


def baluster(rng: np.random.Generator, height: float) -> Mesh:
    """Turned, square or round, on y = 0."""
    kind = rng.random()
    if kind < 0.35:
        r = rng.uniform(0.009, 0.018)
        return solids.boxes([-r, 0, -r], [r, height, r])
    if kind < 0.55:
        return meshes.cylinder(rng.uniform(0.006, 0.015), height, 10)
    y = np.linspace(0, height, 9)
    radii = rng.uniform(0.008, 0.026, 9)
    radii[[0, 1, -2, -1]] = 0.018
    return smooth_lathe(np.stack([radii, y], 1), 14)


def rail_between(rng: np.random.Generator, foot: np.ndarray, end: np.ndarray, post: Mesh,
                 height: float, pitch: float) -> list[Mesh]:
    """Balusters every `pitch` metres from `foot` to `end` under a rail, `height` above."""
    count = max(2, round(float(np.linalg.norm((end - foot)[[0, 2]])) / pitch))
    places = foot + (end - foot) * ((np.arange(count) + 0.5) / count)[:, None]
    rail = foliage.tube(np.array([foot, (foot + end) / 2, end]) + [0, height, 0],
                        rng.uniform(0.02, 0.032), 14)
    return [*(post.transform(translation(*place)) for place in places), rail]


def stairs(rng: np.random.Generator, rise: float, steps: int, width: float) -> Thing:
    """A straight flight along +x from x = 0, at z = 0..width, with nosings, a stringer and a
    railing at its free side.

    It ends at height `rise`.
    """
    h, go = rise / steps, rng.uniform(0.24, 0.29)
    closed = rng.random() < 0.7
    k = np.arange(steps)
    zero = 0 * k
    nose = width + 0.02
    treads = [solids.rounded_box([go * i - 0.025, h * (i + 1) - 0.035, 0],
                                 [go * (i + 1), h * (i + 1), nose], 0.012)
              for i in k]
    made: Thing = [(meshes.merge(treads), "wood")]
    if closed:
        risers = solids.boxes(np.stack([go * k, zero, zero], 1),
                              np.stack([go * k + go, h * (k + 1) - 0.035, zero + width], 1))
        made.append((risers, "trim"))
    else:
        for z in (0.05, width - 0.09):
            line = np.array([[0, 0.0], [go * steps, rise - 0.04], [go * steps, rise - 0.3],
                             [0.3, -0.0]])
            made.append((_plate(line, z, z + 0.04), "trim"))
    foot = np.array([0.5 * go, h, width - 0.05])
    end = np.array([go * (steps - 0.5), rise, width - 0.05])
    high = rng.uniform(0.85, 0.95)
    bars = rail_between(rng, foot, end, baluster(rng, high), high, rng.uniform(0.09, 0.16))
    made.append((meshes.merge(bars[:-1]), str(rng.choice(["trim", "metal", "wood"]))))
    made.append((bars[-1], "wood"))
    newel = solids.rounded_box([-0.045, 0, -0.045], [0.045, high + 0.25, 0.045], 0.008)
    return [*made, (newel.transform(translation(0.3 * go, 0, width - 0.05)), "trim")]


def _plate(line: np.ndarray, z0: float, z1: float) -> Mesh:
    """A convex outline (4, 2) in x and y, counter-clockwise or not, as a plate between z0 and
    z1."""
    a, b = line[1] - line[0], line[2] - line[1]
    if a[0] * b[1] < a[1] * b[0]:
        line = line[::-1]
    front = np.concatenate([line, np.full((4, 1), z1)], 1)
    back = np.concatenate([line[::-1], np.full((4, 1), z0)], 1)
    ahead = zip(line, np.roll(line, -1, 0), strict=True)
    sides = [np.array([[*a, z0], [*b, z0], [*b, z1], [*a, z1]]) for a, b in ahead]
    made = []
    for corners in (front, back, *sides):
        normal = np.cross(corners[1] - corners[0], corners[2] - corners[0])
        made.append(solids.many(corners[None], normal[None, None] / np.linalg.norm(normal),
                                corners[None, :, :2], solids.QUAD))
    return meshes.merge(made)


def rack(rng: np.random.Generator) -> Thing:
    """A shop's shelves with rows of like goods."""
    w = rng.uniform(0.8, 1.6)
    d = rng.uniform(0.35, 0.5)
    h = rng.uniform(1.3, 2.1)
    levels = int(rng.integers(3, 6))
    heights = np.linspace(0.12, h, levels)
    low = [[-w, 0, 0.0], [w - 0.03, 0, 0.0], *[[-w, y - 0.025, 0.0] for y in heights]]
    high = [[-w + 0.03, h, d], [w, h, d], *[[w, y, d] for y in heights]]
    made: Thing = [(solids.boxes(low, high), str(rng.choice(["trim", "metal", "wood"])))]
    for y in heights[:-1]:
        room, x = heights[1] - heights[0] - 0.05, -w + 0.06
        while x < w - 0.2:
            kind = (clutter.bottle, clutter.jar, clutter.bowl, clutter.tray,
                    _carton)[int(rng.integers(5))](rng)
            points = np.concatenate([mesh.vertices for mesh, _ in kind])
            size = np.ptp(points[:, 0]) + 0.015
            for _ in range(int(rng.integers(1, 8))):
                if x + size > w - 0.05 or points[:, 1].max() > room:
                    break
                made += place_at(kind, x + size / 2, y + 5e-4, d - 0.17, rng.normal(0, 0.06))
                x += size
            x += rng.uniform(0.02, 0.1)
    return made


def _carton(rng: np.random.Generator) -> Thing:
    w, h, d = rng.uniform(0.04, 0.12), rng.uniform(0.08, 0.3), rng.uniform(0.04, 0.12)
    return [(solids.boxes([-w, 0, -d], [w, h, d]),
             str(rng.choice(["book1", "book2", "pattern", "paper"])))]


def boxes_pile(rng: np.random.Generator) -> Thing:
    """Cartons on top of one another, as in attics."""
    made, y, size = [], 0.0, rng.uniform(0.25, 0.4)
    for _ in range(int(rng.integers(1, 4))):
        w = size * rng.uniform(0.7, 1)
        h = size * rng.uniform(0.6, 1.2)
        d = size * rng.uniform(0.7, 1)
        turn = rotation(Y, rng.normal(0, 0.2))
        body = solids.boxes([-w, y, -d], [w, y + h, d]).transform(turn)
        flap = solids.boxes([-w, y + h, -d], [w, y + h + 0.004, -0.02]).transform(turn)
        made += [(body, "card"), (flap, "card")]
        y, size = y + h + 0.004, 0.85 * size
    return clutter.place_at(made, 0, 0, 0.5)
