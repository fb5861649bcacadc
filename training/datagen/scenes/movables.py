"""Movable furniture: sofas, armchairs, beds, stools, rugs, tables with things on them and chairs,
hanging lamps.

Things as in furniture. Seats and beds have their backs at z = 0 and look along +z.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from training.datagen.scenes import furniture, meshes, solids
from training.datagen.scenes.clutter import arrange, place_at, smooth_lathe
from training.datagen.scenes.furniture import Thing, Y
from training.datagen.scenes.meshes import Mesh, rotation, translation

X = np.array([1.0, 0, 0])


def _feet(rng: np.random.Generator, x: float, z0: float, z1: float, height: float) -> Mesh:
    r = rng.uniform(0.012, 0.03)
    foot = smooth_lathe([[0, 0], [0.6 * r, 0], [0.6 * r, 0], [r, height], [r, height], [0, height]],
                        16)
    return meshes.merge([foot.transform(translation(a, 0, b)) for a in (-x, x) for b in (z0, z1)])


def sofa(rng: np.random.Generator, seats: int | None = None) -> Thing:
    """Base, arms, back, seat and back cushions, loose cushions, at times a throw over an arm."""
    seats = seats or int(rng.integers(2, 4))
    pitch, depth, high = rng.uniform(0.58, 0.75), rng.uniform(0.8, 1.0), rng.uniform(0.08, 0.18)
    arm, seat, top = rng.uniform(0.1, 0.24), rng.uniform(0.38, 0.46), rng.uniform(0.7, 0.95)
    w, soft = seats * pitch / 2, rng.uniform(0.03, 0.07)
    hull = [solids.rounded_box([-w - arm, high, 0.0], [w + arm, seat - 0.14, depth - 0.03], 0.02),
            solids.rounded_box([-w, high, 0.0], [w, top - 0.08, 0.22], soft)]
    rest = seat + rng.uniform(0.12, 0.25)
    hull += [solids.rounded_box([side - arm / 2, high, 0.0], [side + arm / 2, rest, depth], soft, 5)
             for side in (-w - arm / 2, w + arm / 2)]
    made: Thing = [(meshes.merge(hull), "fabric"),
                   (_feet(rng, w + arm - 0.06, 0.06, depth - 0.08, high + 0.01), "wood")]
    for k in range(seats):
        x = -w + (k + 0.5) * pitch
        made.append((_stuffed(rng, pitch, depth - 0.2, 0.17,
                              (x, seat - 0.06, 0.22 + (depth - 0.2) / 2)), "fabric"))
        back = solids.cushion(rng, pitch * 0.98, 0.52, 0.2).transform(rotation(X, np.pi / 2 - 0.2))
        made.append((back.transform(translation(x, seat + 0.28, 0.3)), "fabric"))
    for _ in range(int(rng.integers(0, seats + 2))):
        made.append((_loose(rng, rng.uniform(-w + 0.2, w - 0.2), seat + 0.02, 0.44),
                     str(rng.choice(CUSHIONS))))
    if rng.random() < 0.4:
        throw = solids.drape(rng, arm + 0.04, 0.35, rng.uniform(0.15, 0.4), 0.0, 0.006)
        made.append((throw.transform(translation(w + arm / 2, rest + 0.004, 0.55 * depth)),
                     "cloth"))
    return made


CUSHIONS = ("fabric2", "cloth", "accent", "fabric", "pattern")


def _stuffed(rng: np.random.Generator, width: float, depth: float, thick: float,
             centre: tuple[Any, ...]) -> Mesh:
    """A box cushion: round edges, a crown and a few soft creases."""
    half = np.array([width / 2 - 0.004, thick / 2, depth / 2])
    mesh = solids.rounded_box(-half, half, 0.05, 6)
    v = mesh.vertices
    crown = (1 - (v[:, 0] / half[0]) ** 2) * (1 - (v[:, 2] / half[2]) ** 2)
    lift = 0.03 * crown + 0.004 * solids.waves(rng, v[:, 0], v[:, 2], 0.25)
    puffed = v + np.stack([0 * lift, np.sign(v[:, 1]) * lift, 0 * lift], 1) + np.array(centre)
    return meshes.smooth(Mesh(puffed, mesh.normals, mesh.uvs, mesh.faces))


def _loose(rng: np.random.Generator, x: float, y: float, z: float) -> Mesh:
    """A cushion that leans on a back at z."""
    size = rng.uniform(0.35, 0.5)
    mesh = solids.cushion(rng, size, size * rng.uniform(0.7, 1.0), rng.uniform(0.1, 0.18))
    tilt = rotation(Y, rng.normal(0, 0.25)) @ rotation(X, np.pi / 2 - rng.uniform(0.15, 0.5))
    mesh = mesh.transform(tilt @ rotation(Y, rng.normal(0, 0.12)))
    return mesh.transform(translation(x, y - mesh.vertices[:, 1].min(), z))


def armchair(rng: np.random.Generator) -> Thing:
    return sofa(rng, 1)


def bed(rng: np.random.Generator) -> Thing:
    """Head board, mattress, a duvet with folds, pillows, at times a folded blanket at the foot."""
    w, length, top = rng.uniform(0.5, 0.95), rng.uniform(1.95, 2.1), rng.uniform(0.42, 0.6)
    made: Thing = [(
        solids.rounded_box([-w, 0.15, 0.08], [w, top - 0.2, length + 0.05], 0.02), "wood"
    ), (solids.rounded_box([-w + 0.01, top - 0.21, 0.1], [w - 0.01, top, length + 0.03], 0.06, 4),
        "cloth"),
                   (_feet(rng, w - 0.06, 0.15, length - 0.06, 0.16), "wood")]
    made += _head_board(rng, w, top)
    start = rng.uniform(0.45, 0.8)
    duvet = solids.drape(rng, 2 * w + 0.04, length - start, rng.uniform(0.1, 0.32), 0.05,
                         rng.uniform(0.008, 0.035))
    made.append((duvet.transform(translation(0, top + 0.03, start + 0.1 + (length - start) / 2)),
                 "bedding"))
    for x in ((-0.5 * w, 0.5 * w) if w > 0.65 else (0.0,)):
        for layer in range(int(rng.integers(1, 3))):
            tilt = rotation(Y, rng.normal(0, 0.1)) @ rotation(X, -0.3 - 0.5 * layer)
            pillow = solids.cushion(rng, min(0.85 * w, 0.72), 0.45,
                                    rng.uniform(0.14, 0.2)).transform(tilt)
            spot = translation(x + rng.normal(0, 0.02), top + 0.08 + 0.1 * layer,
                               0.33 + 0.03 * layer)
            made.append((pillow.transform(spot),
                         str(rng.choice(["bedding", "bedding", "pattern", "fabric2"]))))
    if rng.random() < 0.5:
        blanket = solids.drape(rng, 2 * w + 0.08, 0.5, rng.uniform(0.1, 0.4), 0.0, 0.012)
        made.append((blanket.transform(translation(0, top + 0.075, length - 0.3)), "fabric2"))
    return made


def _head_board(rng: np.random.Generator, w: float, top: float) -> Thing:
    high = top + rng.uniform(0.3, 0.7)
    if rng.random() < 0.4:
        bars = [meshes.cylinder(0.01, high - 0.2, 10).transform(translation(x, 0.2, 0.04))
                for x in np.linspace(-w, w, int(rng.integers(7, 16)))]
        rail = solids.rounded_box([-w - 0.02, high, 0.02], [w + 0.02, high + 0.04, 0.06], 0.015)
        return [(meshes.merge([*bars, rail]), "metal")]
    if rng.random() < 0.5:
        return [(solids.rounded_box([-w - 0.02, 0.1, 0.0], [w + 0.02, high, 0.08], 0.025), "wood")]
    count = int(rng.integers(3, 8))
    x = np.linspace(-w, w, count + 1)
    pads = [solids.rounded_box([a, 0.3, 0.0], [b, high, 0.11], 0.045, 5)
            for a, b in zip(x[:-1], x[1:], strict=True)]
    return [(meshes.merge(pads), "fabric")]


def stool(rng: np.random.Generator) -> Thing:
    r, h = rng.uniform(0.16, 0.3), rng.uniform(0.35, 0.75)
    seat = smooth_lathe([[0, h], [r, h], [1.05 * r, h + 0.03], [r, h + 0.08], [0.6 * r, h + 0.1],
                         [0, h + 0.1]], 40)
    leg, legs = meshes.cylinder(0.014, h / np.cos(0.15), 12), []
    for a in np.arange(4) * np.pi / 2 + 0.78:
        lean = rotation(np.array([np.sin(a), 0, -np.cos(a)]), -0.15)
        legs.append(leg.transform(translation(0.95 * r * np.cos(a), 0, r + 0.95 * r * np.sin(a))
                                  @ lean))
    slot = str(rng.choice(["wood", "metal"]))
    return [(seat.transform(translation(0, 0, r)), "fabric2"), (meshes.merge(legs), slot)]


def rug(rng: np.random.Generator) -> Thing:
    """A thin slab with a rounded rim, a few ripples and fringes at two ends."""
    w, d = rng.uniform(0.7, 1.4), rng.uniform(0.5, 1.0)
    x, z = np.meshgrid(np.linspace(-w, w, 60), np.linspace(-d, d, 40), indexing="ij")
    rim = np.clip(6 * np.minimum(1 - np.abs(x / w), 1 - np.abs(z / d)) * min(w, d) / 0.1, 0, 1)
    y = (0.012 * np.sqrt(rim) + 0.006 * rim * np.clip(solids.waves(rng, x, z, 0.7) - 0.8, 0, None)
         + 0.002)
    made: Thing = [(solids.sheet(np.stack([x, y, z], -1).transpose(1, 0, 2)), "pattern")]
    if rng.random() < 0.5:
        at = np.arange(-d, d, 0.012)
        ends = [solids.boxes(np.stack([0 * at + min(e, e * 1.05), 0 * at, at], 1),
                             np.stack([0 * at + max(e, e * 1.05), 0 * at + 0.006, at + 0.007], 1))
                for e in (-w, w)]
        made.append((meshes.merge(ends), "cloth"))
    return place_at(made, 0, 0.001, d)


# Tables -------------------------------------------------------------------------------------------

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
    made: Thing = [(solids.rounded_box([-w, h - t, -d], [w, h, d], rng.uniform(0.003, 0.4 * t)),
                    slot),
                   (under, str(rng.choice([slot, "wood", "trim"])))]
    return made + arrange(rng, -w, w, -d, d, h, things)


def round_table(rng: np.random.Generator, h: float, r: float, things: int) -> Thing:
    top = smooth_lathe([[0, h - 0.03], [r - 0.01, h - 0.03], [r, h - 0.015], [r - 0.01, h],
                        [r - 0.01, h], [0, h]], 56)
    foot = smooth_lathe([[0, 0], [0.5 * r, 0], [0.5 * r, 0.02], [0.06, 0.06], [0.035, 0.4 * h],
                   [0.05, 0.7 * h], [0.1, h - 0.03]])
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
    slots = {"main": str(rng.choice(["wood", "trim", "fabric"])),
             "second": str(rng.choice(["wood", "metal"]))}
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
            made += place_at(kind, x + rng.normal(0, 0.04), 0, z + rng.normal(0, 0.05),
                             turn + rng.normal(0, 0.15))
    low = min(mesh.vertices[:, 2].min() for mesh, _ in made)
    return place_at(made, 0, 0, -low)


def pendant(rng: np.random.Generator) -> Thing:
    """A lamp that hangs from the origin: a cord and a shade of metal, cloth or china; unlit."""
    drop, r = rng.uniform(0.4, 1.1), rng.uniform(0.12, 0.28)
    h = r * rng.uniform(0.5, 1.3)
    line = (np.array([[r, 0], [0.95 * r, 0.3 * h], [0.6 * r, 0.8 * h], [0.03, h], [0.02, h + 0.05]])
            - [0, drop])
    if rng.random() < 0.3:
        t = np.linspace(-0.5 * np.pi, 0.5 * np.pi, 9)
        line = np.stack([0.7 * r * np.cos(t) + 1e-4, 0.7 * r * np.sin(t) - drop + h], 1)
    shade = smooth_lathe(line, 40)
    cord = meshes.cylinder(0.003, drop - h, 6).transform(translation(0, h - drop, 0))
    rose = smooth_lathe([[0, -0.03], [0.05, -0.03], [0.06, 0]], 24)
    return [(meshes.merge([cord, rose]), "metal"),
            (shade, str(rng.choice(["metal", "shade", "ceramic", "gloss"])))]
