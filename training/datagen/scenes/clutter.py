"""Small things of interiors: books, bottles, lamps, bowls, frames, screens. Things as in furniture,
on y = 0."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from training.datagen.scenes import meshes, solids
from training.datagen.scenes.furniture import Thing, Y
from training.datagen.scenes.meshes import Mesh, rotation, translation

BOOKS = ("book1", "book2", "book3", "book4", "paper")


def place_at(thing: Thing, x: float, y: float, z: float, turn: float = 0.0) -> Thing:
    matrix = translation(x, y, z) @ rotation(Y, turn)
    return [(mesh.transform(matrix), slot) for mesh, slot in thing]


def smooth_lathe(profile: Sequence[Sequence[float]] | np.ndarray, segments: int = 28) -> Mesh:
    """A smooth lathe through a few (radius, height) points, finely interpolated; sharp where points
    repeat."""
    runs, start = [], 0
    points = np.asarray(profile, float)
    same = np.flatnonzero(np.abs(np.diff(points, axis=0)).sum(1) < 1e-9)
    for stop in [*(same + 1), len(points)]:
        run = points[start:stop]
        t = np.linspace(0, len(run) - 1, 4 * (len(run) - 1) + 1)
        fine = np.stack([np.interp(t, np.arange(len(run)), run[:, k]) for k in (0, 1)], 1)
        if len(run) > 3:
            fine[1:-1] = (fine[:-2] + 2 * fine[1:-1] + fine[2:]) / 4
        runs.append(meshes.lathe(np.maximum(fine[:, 0], 1e-4), fine[:, 1], segments))
        start = stop
    return meshes.merge(runs)


def book_row(rng: np.random.Generator, width: float, room: float, depth: float) -> Thing:
    """Upright books from x = 0 to at most `width` on y = 0, spines at z = 0, gaps between them; a
    few lean."""
    low, high, slot = [], [], []
    x, parts = 0.0, []
    while x < width - 0.07:
        if rng.random() < 0.04:
            x += rng.uniform(0.05, 0.3)
            continue
        thick, tall = rng.uniform(0.012, 0.05), rng.uniform(0.55, 0.93) * room
        deep = rng.uniform(0.7, 0.95) * depth
        inset = rng.uniform(0, 0.02)
        name = int(rng.integers(len(BOOKS)))
        if rng.random() < 0.05 and x < width - 0.16:
            lean = rotation(np.array([0, 0, 1.0]), rng.uniform(0.1, 0.3))
            book = solids.boxes([-thick, 0, -deep], [0, 0.9 * tall, -inset]).transform(lean)
            parts.append((book.transform(translation(x - book.vertices[:, 0].min(),
                                                     -book.vertices[:, 1].min(), 0)),
                          BOOKS[name]))
            x += np.ptp(book.vertices[:, 0]) + 0.002
            continue
        low.append([x, 0, -deep])
        high.append([x + thick, tall, -inset])
        slot.append(name)
        x += thick + 0.0015
    slots = np.array(slot, int)
    for name in np.unique(slots):
        parts.append((solids.boxes(np.array(low)[slots == name], np.array(high)[slots == name]),
                      BOOKS[name]))
    return parts


def book_pile(rng: np.random.Generator) -> Thing:
    parts, y = [], 0.0
    for _ in range(int(rng.integers(1, 7))):
        w, d, thick = rng.uniform(0.08, 0.14), rng.uniform(0.1, 0.17), rng.uniform(0.01, 0.04)
        turn = rotation(Y, rng.normal(0, 0.15))
        cover = solids.boxes([[-w, y, -d], [-w, y + thick - 0.003, -d]],
                             [[w, y + 0.003, d], [w, y + thick, d]])
        pages = solids.boxes([-w + 0.004, y + 0.003, -d + 0.004],
                             [w - 0.003, y + thick - 0.003, d - 0.004])
        parts += [(cover.transform(turn), str(rng.choice(BOOKS[:4]))),
                  (pages.transform(turn), "paper")]
        y += thick
    return parts


def bottle(rng: np.random.Generator) -> Thing:
    r, h = rng.uniform(0.025, 0.05), rng.uniform(0.15, 0.33)
    neck, shoulder = rng.uniform(0.25, 0.5) * r, rng.uniform(0.5, 0.75)
    body = smooth_lathe([[0, 0], [0.9 * r, 0], [0.9 * r, 0], [r, 0.01], [r, shoulder * h],
                         [0.8 * r, (shoulder + 0.08) * h], [neck, (shoulder + 0.2) * h], [neck, h],
                         [neck, h], [0, h]])
    return [(body, str(rng.choice(["glass", "ceramic", "gloss"])))]


def tumbler(rng: np.random.Generator) -> Thing:
    """A drinking glass or cup with a wall, an inside and, at times, a stem."""
    r, h, wall = rng.uniform(0.025, 0.04), rng.uniform(0.07, 0.12), 0.003
    foot = rng.uniform(0.04, 0.09) if rng.random() < 0.4 else 0.0
    base: list[list[float]]
    base = ([[0, 0], [0.8 * r, 0], [0.8 * r, 0], [0.7 * r, 0.004], [0.005, 0.008], [0.005, foot]]
            if foot else [[0, 0]])
    cup: list[list[float]]
    cup = [[0.85 * r, foot + 0.002], [r, foot + 0.6 * h], [r, foot + h], [r, foot + h],
           [r - wall, foot + h], [r - wall, foot + h], [r - wall, foot + 0.6 * h],
           [0.8 * r, foot + 0.01], [0, foot + 0.008]]
    return [(smooth_lathe(base + cup), str(rng.choice(["glass", "ceramic", "metal"])))]


def bowl(rng: np.random.Generator) -> Thing:
    r, h = rng.uniform(0.08, 0.17), rng.uniform(0.03, 0.11)
    shape = smooth_lathe([[0, 0], [0.4 * r, 0], [0.4 * r, 0], [0.75 * r, 0.35 * h], [r, h], [r, h],
                    [r - 0.006, h], [0.72 * r, 0.4 * h], [0.4 * r, 0.01], [0, 0.008]])
    made: Thing = [(shape, str(rng.choice(["ceramic", "gloss", "wood"])))]
    for _ in range(int(rng.choice([0, 0, 3, 6]))):
        size = rng.uniform(0.03, 0.04)
        fruit = meshes.sphere(size,
                              20).transform(translation(*rng.normal(0, 0.3 * r, 3) * [1, 0, 1]))
        made.append((fruit.transform(translation(0, 0.5 * h + size, 0)),
                     str(rng.choice(["leaf", "accent"]))))
    return made


def vase(rng: np.random.Generator) -> Thing:
    r, h = rng.uniform(0.05, 0.11), rng.uniform(0.12, 0.4)
    radii = r * (0.75 + 0.35
                 * np.sin(np.linspace(0.3, rng.uniform(2.5, 5.5), 9) + rng.uniform(-0.4, 0.4)))
    line = np.stack([radii, np.linspace(0, h, 9)], 1)
    inside = np.stack([np.maximum(radii[::-1] - 0.005, 0.003), np.linspace(h, 0.02, 9)], 1)
    body = smooth_lathe([[0, 0], line[0], *line, line[-1], inside[0], *inside])
    made: Thing = [(body, str(rng.choice(["ceramic", "gloss"])))]
    if rng.random() < 0.5:
        for _ in range(int(rng.integers(3, 12))):
            lean = rotation(rng.normal(0, 1, 3) * [1, 0, 1] + [0, 0, 1e-3], rng.uniform(0, 0.4))
            tall = rng.uniform(0.2, 0.5)
            stem = meshes.cylinder(0.0025, tall, 5).transform(lean)
            bloom = meshes.sphere(rng.uniform(0.012, 0.03), 12)
            made.append((stem.transform(translation(0, 0.8 * h, 0)), "leaf"))
            tip = (lean @ np.array([0, tall, 0, 1]))[:3] + [0, 0.8 * h, 0]
            made.append((bloom.transform(translation(*tip)), str(rng.choice(["accent", "paper"]))))
    return made


def lamp(rng: np.random.Generator, floor: bool = False) -> Thing:
    """A lamp with a cloth shade on a turned or thin stem; unlit."""
    tall = rng.uniform(1.2, 1.6) if floor else rng.uniform(0.2, 0.45)
    r, h = rng.uniform(0.1, 0.22), rng.uniform(0.14, 0.28)
    top = r * rng.uniform(0.4, 1.0)
    shade = [meshes.lathe(np.array([r - k, top - k]), np.array([0, h]), 36) for k in (0.0, 0.004)]
    rims = [meshes.torus(size, 0.004, 36, 6).transform(translation(0, y, 0))
            for size, y in ((r, 0), (top, h))]
    base = smooth_lathe([[0, 0], [0.5 * r, 0], [0.5 * r, 0], [0.5 * r, 0.015], [0.02, 0.03],
                         [0.008, 0.06], [0.008, tall]])
    if not floor and rng.random() < 0.6:
        radii = rng.uniform(0.02, 0.09, 6)
        body = np.stack([radii, np.linspace(0, 0.85 * tall, 6)], 1)
        base = smooth_lathe([[0, 0], *body, [0.006, 0.9 * tall], [0.006, tall]])
    lift = translation(0, tall - 0.3 * h, 0)
    return [(base, str(rng.choice(["metal", "ceramic", "wood"]))),
            (meshes.merge([*shade, *rims]).transform(lift), "shade")]


def screen(rng: np.random.Generator) -> Thing:
    """A monitor or television on a foot, facing +z."""
    w = rng.uniform(0.25, 0.5)
    h = 0.6 * w
    body = solids.rounded_box([-w, 0.1, -0.015], [w, 0.1 + 2 * h, 0.015], 0.008)
    foot = solids.boxes([[-0.02, 0, -0.04], [-0.12, 0, -0.1]],
                        [[0.02, 0.14, -0.015], [0.12, 0.01, 0.08]])
    glass = solids.face(-w + 0.01, 0.11, w - 0.01, 0.09 + 2 * h, 0.0155)
    return [(meshes.merge([body, foot]), "dark"), (glass, "gloss_dark")]


def jar(rng: np.random.Generator) -> Thing:
    r, h = rng.uniform(0.035, 0.07), rng.uniform(0.08, 0.22)
    lid = smooth_lathe([[r, h], [1.05 * r, h], [1.05 * r, h], [1.05 * r, h + 0.015],
                        [0.3 * r, h + 0.025], [0.01, h + 0.05]])
    body = smooth_lathe([[0, 0], [r, 0], [r, 0], [r, h], [r, h], [0, h]])
    return [(body, str(rng.choice(["ceramic", "gloss", "book2"]))), (lid, "wood")]


def tray(rng: np.random.Generator) -> Thing:
    return [(solids.folded_stack(rng, rng.uniform(0.2, 0.4), rng.uniform(0.2, 0.3),
                                 int(rng.integers(1, 5))), "cloth")]


def plates(rng: np.random.Generator) -> Thing:
    r, made = rng.uniform(0.09, 0.14), []
    for k in range(int(rng.integers(1, 7))):
        plate = smooth_lathe([[0, 0], [0.6 * r, 0.001], [r, 0.018], [r, 0.018], [r - 0.004, 0.021],
                        [0.6 * r, 0.006], [0, 0.005]])
        made.append((plate.transform(translation(0, 0.008 * k, 0)), "ceramic"))
    return made


SMALL = (book_pile, book_pile, bottle, bottle, tumbler, tumbler, bowl, vase, lamp, jar, jar, tray,
         plates)


def arrange(rng: np.random.Generator, x0: float, x1: float, z0: float, z1: float, y: float,
            count: int, kinds: tuple[Any, ...] = SMALL, most: float = 1.0) -> Thing:
    """Up to `count` small things on a surface, apart from one another; none higher than `most`
    metres."""
    made: Thing = []
    taken: list[Any] = []
    for _ in range(count):
        thing = kinds[int(rng.integers(len(kinds)))](rng)
        points = np.concatenate([mesh.vertices for mesh, _ in thing])
        reach = float(np.hypot(points[:, 0], points[:, 2]).max())
        if points[:, 1].max() > most:
            continue
        for _ in range(6):
            spot = rng.uniform([x0, z0], [x1, z1])
            inside = np.all(spot - 0.7 * reach > [x0, z0]) and np.all(spot + 0.7 * reach < [x1, z1])
            if inside and all(np.hypot(*(spot - other)) > reach + size for other, size in taken):
                taken.append((spot, reach))
                made += place_at(thing, spot[0], y + 5e-4, spot[1], rng.uniform(-0.4, 0.4))
                break
    return made


def picture_frame(rng: np.random.Generator, width: float, height: float, slot: str) -> Thing:
    """A picture in a moulded frame about the origin, on the plane z = 0; `slot`'s texture covers
    the picture once."""
    rim = solids.frame_profile(rng, rng.uniform(0.02, 0.08), rng.uniform(0.015, 0.05))
    corners = solids.rectangle(-width / 2, -height / 2, width / 2, height / 2)
    inner = width / 2 - 0.005, height / 2 - 0.005
    art = solids.face(-inner[0], -inner[1], inner[0], inner[1], 0.006)
    uvs = (art.vertices[:, :2] / [width, height]) + 0.5
    wood = solids.moulding(corners[[0, 3, 2, 1]], rim, closed=True)
    made: Thing = [(wood, str(rng.choice(["wood", "trim", "metal"]))),
                   (Mesh(art.vertices, art.normals, uvs, art.faces), slot)]
    if rng.random() < 0.4:
        mat = np.array([[0, 0], [0, 0.011], [0.15 * min(width, height), 0.009],
                        [0.15 * min(width, height), 0.0]])
        made.append((solids.moulding(corners, mat, closed=True), "paper"))
    return made
