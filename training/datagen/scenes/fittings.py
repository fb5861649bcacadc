"""Furniture and fittings along walls: bookcases, cabinets, desks, fireplaces, radiators, baths.

Things as in furniture, with their backs at z = 0, centred on x = 0; they look along +z.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from training.datagen.scenes import clutter, foliage, meshes, solids
from training.datagen.scenes.clutter import arrange, book_row, place_at
from training.datagen.scenes.furniture import Thing, Y
from training.datagen.scenes.joinery import panel_grid
from training.datagen.scenes.meshes import rotation, translation

X = np.array([1.0, 0, 0])


def bookcase(rng: np.random.Generator) -> Thing:
    """Shelves full of books, boxes and small things; with or without a back."""
    w = rng.uniform(0.35, 1.1)
    d = rng.uniform(0.22, 0.36)
    h = rng.uniform(0.8, 2.3)
    levels = int(rng.integers(2, 7))
    slot, t = str(rng.choice(["trim", "wood", "wood", "lacquer"])), rng.uniform(0.015, 0.03)
    heights = np.linspace(0.06, h - t, levels + 1)
    low = [[-w, 0, 0], [w - t, 0, 0], [-w + t, 0.06, 0], *[[-w + t, y, 0.006] for y in heights]]
    high = [[-w + t, h, d], [w, h, d], [w - t, h, 0.006],
            *[[w - t, y + t, d - 0.005] for y in heights]]
    made: Thing = [(solids.boxes(low, high), slot)]
    gap = heights[1] - heights[0] - t
    for y in heights[:-1]:
        kind = rng.random()
        if kind < 0.65:
            books = book_row(rng, (2 * w - 2 * t) * rng.uniform(0.5, 1), gap, d - 0.03)
            made += place_at(books, -w + t, y + t, d - 0.02)
        elif kind < 0.92:
            made += arrange(rng, -w + t, w - t, 0.02, d, y + t, 8, most=gap)
    return made + arrange(rng, -w, w, 0.02, d, h, int(rng.integers(0, 4)), most=0.5)


def cabinet(rng: np.random.Generator, width: float | None = None, height: float | None = None,
            depth: float | None = None, slot: str | None = None, plinth: float = 0.08) -> Thing:
    """A chest, sideboard or wardrobe: panelled doors or drawers with handles."""
    w = (width or rng.uniform(0.7, 2.0)) / 2
    h, d = height or rng.uniform(0.5, 1.0), depth or rng.uniform(0.38, 0.55)
    slot = slot or str(rng.choice(["trim", "lacquer", "wood"]))
    columns = max(1, round(2 * w / rng.uniform(0.4, 0.65)))
    drawers = int(rng.integers(2, 5)) if h < 1.2 else 1
    rows = [drawers if rng.random() < 0.45 else 1 for _ in range(columns)]
    profile = solids.frame_profile(rng, rng.uniform(0.02, 0.05), rng.uniform(0.004, 0.014))
    plain, knob = rng.random() < 0.35, rng.random() < 0.5
    parts = [solids.boxes([[-w, plinth, 0], [-w + 0.03, 0, 0]],
                          [[w, h, d], [w - 0.03, plinth, d - 0.05]])]
    handles = []
    for k, count in enumerate(rows):
        x0 = -w + 2 * w * k / columns
        for door in panel_grid(x0 + 0.002, plinth + 0.004, x0 + 2 * w / columns - 0.002, h - 0.004,
                               1, count, 0.004):
            (a, b), (c, e) = door[0], door[2]
            parts.append(solids.rounded_box([a, b, d - 0.002], [c, e, d + 0.018], 0.003, 2))
            if not plain and min(c - a, e - b) > 0.14:
                ring = solids.moulding(solids.rectangle(a + 0.04, b + 0.03, c - 0.04, e - 0.03),
                                       profile, closed=True)
                parts.append(ring.transform(translation(0, 0, d + 0.018)))
            grip = (np.array([(a + c) / 2, (b + e) / 2]) if count > 1 else
                    np.array([c - 0.035 if k % 2 == 0 else a + 0.035,
                              e - 0.12 if plinth < 0.5 else b + 0.12]))
            handles += _handle(knob, count > 1, grip, d + 0.018)
    return [(meshes.merge(parts), slot), (meshes.merge(handles), "metal")]


def _handle(knob: bool, flat: bool, grip: np.ndarray, z: float) -> list[Any]:
    if knob:
        return [meshes.sphere(0.013, 16).transform(translation(grip[0], grip[1], z + 0.02)),
                meshes.cylinder(0.005, 0.02, 8)
                .transform(translation(grip[0], grip[1], z) @ rotation(X, np.pi / 2))]
    turn = rotation(np.array([0, 0, 1.0]), 0.0 if flat else np.pi / 2)
    arc = np.array([[-6, 0, 0], [-6, 0, 2.5], [-5, 0, 3], [5, 0, 3], [6, 0, 2.5], [6, 0, 0]]) / 100
    return [foliage.tube(arc, 0.0045, 8).transform(translation(grip[0], grip[1], z) @ turn)]


def sideboard(rng: np.random.Generator) -> Thing:
    """A chest with things on it."""
    w, h, d = rng.uniform(0.8, 1.8), rng.uniform(0.45, 1.0), rng.uniform(0.35, 0.5)
    made = cabinet(rng, w, h, d)
    top = solids.rounded_box([-w / 2 - 0.015, h, 0], [w / 2 + 0.015, h + 0.025, d + 0.03], 0.008)
    return [*made, (top, "wood"),
            *arrange(rng, -w / 2, w / 2, 0.03, d, h + 0.025, int(rng.integers(2, 7)))]


def wardrobe(rng: np.random.Generator) -> Thing:
    w, h, d = rng.uniform(0.8, 2.0), rng.uniform(1.8, 2.2), rng.uniform(0.5, 0.62)
    crown = solids.cornice_profile(rng, 0.06, 0.08)[:, ::-1]
    made = cabinet(rng, w, h, d)
    rim = solids.moulding([[-w / 2, h - 0.05], [w / 2, h - 0.05]],
                          crown[::-1]).transform(translation(0, 0, d))
    return [*made, (rim, made[0][1])]


def kitchen(rng: np.random.Generator) -> Thing:
    """Cabinets under a counter, a tiled splashback, cabinets or shelves above, a tap and
    clutter."""
    w, h, d = rng.uniform(1.8, 3.4), 0.88, 0.6
    slot = str(rng.choice(["trim", "lacquer", "wood"]))
    made = cabinet(rng, w, h, d - 0.03, slot, 0.1)
    made.append((solids.rounded_box([-w / 2, h, 0], [w / 2, h + 0.04, d + 0.02], 0.006), "counter"))
    made += tiles(rng, -w / 2, h + 0.04, w / 2, h + 0.6)
    made += arrange(rng, -w / 2, w / 2, 0.06, d - 0.05, h + 0.04, int(rng.integers(4, 12)),
                    most=0.5)
    x = rng.uniform(-0.3, 0.3) * w
    spout = [[x, h + 0.04, 0.1], [x, h + 0.3, 0.1], [x, h + 0.36, 0.15], [x, h + 0.36, 0.22],
             [x, h + 0.3, 0.25]]
    made.append((foliage.tube(np.array(spout), 0.011, 12), "metal"))
    half = w * rng.uniform(0.3, 0.5)
    if rng.random() < 0.5:
        made += place_at(cabinet(rng, half, 0.7, 0.33, slot, 0.0), half / 2 - w / 2, h + 0.6, 0)
    for y in (h + 0.65, h + 1.0):
        x0 = half - w / 2 + 0.05
        made.append((solids.rounded_box([x0, y, 0.0], [w / 2, y + 0.03, 0.25], 0.004), "wood"))
        made += arrange(rng, x0, w / 2, 0.02, 0.25, y + 0.03, 9,
                        (clutter.jar, clutter.plates, clutter.tumbler,
                         clutter.bottle, clutter.bowl), 0.3)
    return made


def tiles(rng: np.random.Generator, x0: float, y0: float, x1: float, y1: float,
          z: float = 0.0) -> Thing:
    """Tiles on a wall with grout between them: flat ones with a bevel, each leaning a little."""
    w = rng.uniform(0.06, 0.3)
    h = w * float(rng.choice([1.0, 0.5, 0.33]))
    grout, bond = rng.uniform(0.002, 0.006), 0.5 * (rng.random() < 0.5)
    columns, rows = max(1, round((x1 - x0) / w)), max(1, round((y1 - y0) / h))
    w, h = (x1 - x0) / columns, (y1 - y0) / rows
    i, j = (g.ravel() for g in np.meshgrid(np.arange(-1, columns), np.arange(rows)))
    left = x0 + w * (i + np.where(j % 2 > 0, bond, 0.0) + (0 if bond else 0))
    low, high = np.maximum(left, x0), np.minimum(left + w, x1)
    keep = high - low > 3 * grout
    low, high, j = low[keep], high[keep], j[keep]
    corners = np.stack([low + grout / 2, high - grout / 2, y0 + h * j + grout / 2,
                        y0 + h * (j + 1) - grout / 2], 1)
    return [(_bevelled(rng, corners, z), "tile"), (solids.face(x0, y0, x1, y1, z + 0.001), "grout")]


def _bevelled(rng: np.random.Generator, corners: np.ndarray, z: float) -> meshes.Mesh:
    """Tiles (N, 4) of x0, x1, y0, y1 as frusta 6 mm thick; normals of their faces lean by up to a
    degree."""
    x0, x1, y0, y1 = corners.T
    b, n = 0.003, len(corners)
    lean = rng.normal(0, 0.008, (n, 2))

    def ring(inset: float, height: float) -> np.ndarray:
        plan = [(x0 + inset, y0 + inset), (x1 - inset, y0 + inset), (x1 - inset, y1 - inset),
                (x0 + inset, y1 - inset)]
        return np.stack([np.stack([x, y, np.full(n, z + height)], -1) for x, y in plan], 1)

    low, top = ring(0.0, 0.001), ring(b, 0.006)
    parts = [(top, np.concatenate([lean, np.ones((n, 1))], 1))]
    for k, facing in enumerate(([0, -0.8, 0.6], [0.8, 0, 0.6], [0, 0.8, 0.6], [-0.8, 0, 0.6])):
        m = (k + 1) % 4
        parts.append((np.stack([low[:, k], low[:, m], top[:, m], top[:, k]], 1),
                      np.tile(facing, (n, 1))))
    made = []
    for vertices, normal in parts:
        unit = normal / np.linalg.norm(normal, axis=1, keepdims=True)
        uvs = vertices[..., :2]
        made.append(solids.many(vertices, unit[:, None], uvs, solids.QUAD))
    return meshes.merge(made)


def desk(rng: np.random.Generator) -> Thing:
    """A table with a screen, papers and a lamp, and drawers at one side."""
    w, d, h = rng.uniform(1.1, 1.8), rng.uniform(0.6, 0.8), rng.uniform(0.7, 0.76)
    made: Thing = [(solids.rounded_box([-w / 2, h - 0.03, 0.02], [w / 2, h, d], 0.006), "wood")]
    feet = np.array([[x, 0, z] for x in (-w / 2 + 0.02, w / 2 - 0.06) for z in (0.05, d - 0.07)])
    made.append((solids.boxes(feet, feet + [0.04, h - 0.03, 0.04]),
                 str(rng.choice(["metal", "trim", "wood"]))))
    made += place_at(cabinet(rng, 0.4, h - 0.05, d - 0.15), w / 2 - 0.3, 0, 0.05)
    if rng.random() < 0.7:
        made += place_at(clutter.screen(rng), rng.uniform(-0.3, 0) * w, h, 0.22,
                         rng.normal(0, 0.15))
        made += _keyboard(rng, -0.1 * w, h, 0.55 * d)
    return made + arrange(rng, 0, w / 2, 0.05, d, h, 3) + arrange(rng, -w / 2, -0.2 * w, 0.3, d, h,
                                                                  3)


def _keyboard(rng: np.random.Generator, x: float, y: float, z: float) -> Thing:
    i, j = (g.ravel() for g in np.meshgrid(np.arange(14), np.arange(5)))
    low = np.stack([x + 0.0315 * i - 0.22, 0 * i + y + 0.012, z + 0.025 * j], 1)
    keys = solids.boxes(low, low + [0.027, 0.006, 0.021])
    return [(solids.rounded_box([x - 0.23, y + 0.001, z - 0.01], [x + 0.23, y + 0.013, z + 0.135],
                                0.005), "dark"),
            (keys, str(rng.choice(["dark", "paper"])))]


def towel_rail(rng: np.random.Generator) -> Thing:
    """A rail with towels over it."""
    w, y, z = rng.uniform(0.4, 0.8), rng.uniform(0.9, 1.4), 0.08
    lying = rotation(np.array([0, 0, 1.0]), -np.pi / 2)
    bar = meshes.cylinder(0.009, w, 12).transform(translation(-w / 2, y, z) @ lying)
    ends = solids.boxes([[-w / 2, y - 0.01, 0], [w / 2 - 0.01, y - 0.01, 0]],
                        [[-w / 2 + 0.01, y + 0.01, z], [w / 2, y + 0.01, z]])
    made: Thing = [(meshes.merge([bar, ends]), "metal")]
    towel = solids.drape(rng, 0.04, 0.6 * w, rng.uniform(0.25, 0.55), 0.0, 0.003)
    made.append((towel.transform(translation(0, y + 0.012, z) @ rotation(Y, np.pi / 2)), "cloth"))
    return made
