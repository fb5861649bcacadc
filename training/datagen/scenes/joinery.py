"""Walls of interiors and their joinery: windows with bars, doors, skirtings, panels, blinds.

Everything is made in a wall's own frame: x along the wall from 0 to its width, y up, z into the
room with the wall's face at 0. Things as in furniture: lists of (mesh, slot).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from training.datagen.scenes import meshes, solids
from training.datagen.scenes.meshes import Mesh, rotation, translation

X, Y = np.array([1.0, 0, 0]), np.array([0.0, 1, 0])
Thing = list[tuple[Mesh, str]]


@dataclass(frozen=True)
class Opening:
    """A hole in a wall, metres: 'window', 'door' (a leaf), or 'arch' (nothing in it)."""

    x0: float
    y0: float
    x1: float
    y1: float
    kind: str = "window"

    @property
    def width(self) -> float:
        return self.x1 - self.x0

    @property
    def height(self) -> float:
        return self.y1 - self.y0


@dataclass(frozen=True)
class Joinery:
    """Style shared by all walls of a house: profiles (K, 2), wall thickness, pattern of the
    windows' bars."""

    skirting: np.ndarray
    architrave: np.ndarray
    cornice: np.ndarray | None
    panel: np.ndarray
    thick: float
    columns: int
    rows: int
    bar: float
    stile: float
    wainscot: float
    panels: str

    @classmethod
    def draw(cls, rng: np.random.Generator) -> Joinery:
        plain = rng.random() < 0.3
        columns, rows = ((int(rng.integers(1, 3)), 1) if plain
                         else (int(rng.integers(1, 5)), int(rng.integers(1, 6))))
        return cls(
            solids.edge_profile(rng, rng.uniform(0.06, 0.22), rng.uniform(0.01, 0.03)),
            solids.frame_profile(rng, rng.uniform(0.05, 0.14), rng.uniform(0.012, 0.035)), None
            if rng.random() < 0.25 else solids.cornice_profile(rng, *rng.uniform(0.05, 0.22, 2)),
            solids.frame_profile(rng, rng.uniform(0.02, 0.06), rng.uniform(0.008, 0.025)),
            rng.uniform(0.1, 0.45), columns, rows, rng.uniform(0.008, 0.022),
            rng.uniform(0.025, 0.05),
            rng.uniform(0.75, 1.25), str(rng.choice(["none", "wainscot", "tall", "both", "boards"],
                                                    p=[0.3, 0.2, 0.15, 0.2, 0.15])))


def faces(width: float, height: float, holes: list[Opening], slot: str) -> Thing:
    """The wall itself without its holes."""
    parts, x = [], 0.0
    for hole in sorted(holes, key=lambda h: h.x0):
        parts += [(x, 0, hole.x0, height), (hole.x0, 0, hole.x1, hole.y0),
                  (hole.x0, hole.y1, hole.x1, height)]
        x = hole.x1
    parts.append((x, 0, width, height))
    return [(solids.face(*part), slot)
            for part in parts if part[2] - part[0] > 1e-3 and part[3] - part[1] > 1e-3]


def reveal(hole: Opening, depth: float, slot: str) -> Thing:
    """The four sides of a hole through the wall, `depth` metres."""
    back, w, h = [0, 0, -depth], [hole.width, 0, 0], [0, hole.height, 0]
    low = np.array([hole.x0, hole.y0, 0.0])
    sides = [(low, back, h), (low + w, h, back), (low, w, back), (low + h, back, w)]
    return [(meshes.merge([meshes.quad(*side) for side in sides]), slot)]


def window(rng: np.random.Generator, hole: Opening, style: Joinery, slot: str = "trim") -> Thing:
    """Frame, sashes and glazing bars near the outer face of the wall, and a sill board inside."""
    z, s, deep = -style.thick + 0.01, style.stile, style.stile + 0.015
    parts = [_frame_boxes(hole.x0, hole.y0, hole.x1, hole.y1, s, z, deep)]
    count = max(1, round(hole.width / rng.uniform(0.5, 1.0)))
    transom = hole.y0 + rng.uniform(0.6, 0.75) * hole.height if rng.random() < 0.35 else None
    inner = hole.width - 2 * s
    for k in range(count):
        x0, x1 = (hole.x0 + s + inner * (k + m) / count for m in (0, 1))
        for low, high in [(hole.y0 + s, hole.y1 - s)] if transom is None else [
                (hole.y0 + s, transom), (transom + s, hole.y1 - s)]:
            parts.append(_sash(x0, low, x1, high, style, z + 0.008,
                               transom is not None and low > transom))
    if transom is not None:
        parts.append(solids.boxes([hole.x0, transom, z], [hole.x1, transom + s, z + deep + 0.01]))
    made: Thing = [(meshes.merge(parts), slot)]
    handle = solids.rounded_box([-0.01, -0.06, 0], [0.01, 0.06, 0.035], 0.009)
    place = (hole.x0 + s + inner / count - 0.02, hole.y0 + 0.45 * hole.height, z + deep)
    made.append((handle.transform(translation(*place)), "metal"))
    if rng.random() < 0.7 and hole.y0 > 0.2:
        nose = rng.uniform(0.02, 0.09)
        board = solids.rounded_box([hole.x0 - 0.05, hole.y0 - 0.035, -style.thick + 0.02],
                               [hole.x1 + 0.05, hole.y0 + 0.004, nose], 0.015)
        made.append((board, slot))
    return made


def _frame_boxes(x0: float, y0: float, x1: float, y1: float, s: float, z: float,
                 deep: float) -> Mesh:
    low = [[x0, y0, z], [x1 - s, y0, z], [x0 + s, y0, z], [x0 + s, y1 - s, z]]
    high = [[x0 + s, y1, z + deep], [x1, y1, z + deep], [x1 - s, y0 + s, z + deep],
            [x1 - s, y1, z + deep]]
    return solids.boxes(low, high)


def _sash(x0: float, y0: float, x1: float, y1: float, style: Joinery, z: float, bare: bool) -> Mesh:
    """A sash: a frame with a bevel about the glass, and bars."""
    s, b, deep = 0.8 * style.stile, style.bar, style.stile
    parts = [_frame_boxes(x0, y0, x1, y1, s, z, deep)]
    columns, rows = (style.columns, 1) if bare else (style.columns, style.rows)
    xs, ys = np.linspace(x0 + s, x1 - s, columns + 1), np.linspace(y0 + s, y1 - s, rows + 1)
    low = [[x - b, y0 + s, z + 0.008] for x in xs[1:-1]] + [[x0 + s, y - b, z + 0.009]
                                                            for y in ys[1:-1]]
    high = ([[x + b, y1 - s, z + deep - 0.008] for x in xs[1:-1]]
            + [[x1 - s, y + b, z + deep - 0.009] for y in ys[1:-1]])
    if low:
        parts.append(solids.boxes(low, high))
    bevel = np.array([[0, deep], [0.6 * b, 0.6 * deep], [0.6 * b, 0.3 * deep]])
    rims = [solids.moulding(solids.rectangle(*corner), bevel, closed=True)
            .transform(translation(0, 0, z)) for corner in ((x0 + s, y0 + s, x1 - s, y1 - s),)]
    return meshes.merge(parts + rims)


def blind(rng: np.random.Generator, hole: Opening, z: float) -> Thing:
    """Slats before a window, drawn up to some height, with cords."""
    pitch = rng.uniform(0.025, 0.09)
    low = hole.y0 + hole.height * float(rng.choice([0.02, 0.3, 0.6]))
    heights = np.arange(low, hole.y1 - 0.05, pitch)
    half = np.array([hole.width / 2 - 0.02, 0.0015, 0.5 * pitch])
    slat = solids.boxes(-half, half).transform(rotation(X, rng.uniform(-1.1, 0.9)))
    middle = (hole.x0 + hole.x1) / 2
    slats = [slat.transform(translation(middle, y, z)) for y in heights]
    cords = [meshes.cylinder(0.002, hole.y1 - low, 6)
             .transform(translation(hole.x0 + f * hole.width, low, z)) for f in (0.2, 0.8)]
    rail = solids.boxes([
        [hole.x0 + 0.01, hole.y1 - 0.05, z - 0.03], [hole.x0 + 0.015, low - 0.03, z - 0.015]
    ], [[hole.x1 - 0.01, hole.y1, z + 0.03], [hole.x1 - 0.015, low - 0.01, z + 0.015]])
    return [(meshes.merge([*slats, rail]), "blind"), (meshes.merge(cords), "trim")]


def leaf(rng: np.random.Generator, width: float, height: float, style: Joinery) -> Thing:
    """A door leaf, hinged at x = 0, z = 0, in the plane z = 0, panelled on both sides, with
    handles."""
    half, margin = 0.02, rng.uniform(0.08, 0.13)
    parts = [solids.boxes([0.003, 0.006, -half], [width - 0.003, height - 0.006, half])]
    columns, rows = int(rng.integers(1, 3)), int(rng.integers(1, 5))
    rims = [solids.moulding(rectangle, style.panel, closed=True)
            for rectangle in panel_grid(margin, margin, width - margin, height - margin, columns,
                                        rows, margin)]
    front = meshes.merge(rims).transform(translation(0, 0, half))
    back = meshes.merge(rims).transform(translation(width, 0, -half) @ rotation(Y, np.pi))
    grip = [meshes.sphere(0.027, 20).transform(translation(width - 0.06, 0.45 * height, z))
            for z in (-0.06, 0.06)]
    stem = meshes.cylinder(0.01, 0.12, 12).transform(translation(width - 0.06, 0.45 * height, -0.06)
                                                       @ rotation(X, np.pi / 2))
    return [(meshes.merge([*parts, front, back]), "trim"), (meshes.merge([*grip, stem]), "metal")]


def panel_grid(x0: float, y0: float, x1: float, y1: float, columns: int, rows: int,
               gap: float) -> list[np.ndarray]:
    """Rectangles (4, 2) in rows and columns, `gap` apart."""
    w, h = (x1 - x0 + gap) / columns, (y1 - y0 + gap) / rows
    return [solids.rectangle(x0 + i * w, y0 + j * h, x0 + (i + 1) * w - gap, y0 + (j + 1) * h - gap)
            for i in range(columns) for j in range(rows)]


def architrave(hole: Opening, profile: np.ndarray) -> Mesh:
    """A moulding round a hole on the wall's face; doors have it on three sides."""
    loop = solids.rectangle(hole.x0, hole.y0, hole.x1, hole.y1)[[0, 3, 2, 1]]
    if hole.kind == "window" and hole.y0 > 0.1:
        return solids.moulding(loop, profile, closed=True)
    return solids.moulding(loop, profile)


def between(width: float, holes: list[Opening], low: float, high: float,
            margin: float) -> list[tuple[float, float]]:
    """Stretches of a wall that no hole within the heights low..high cuts, with a margin about the
    holes."""
    spans, x = [], 0.0
    for hole in sorted((h for h in holes if h.y1 > low and h.y0 < high), key=lambda h: h.x0):
        spans.append((x, hole.x0 - margin))
        x = hole.x1 + margin
    return [(a, b) for a, b in [*spans, (x, width)] if b - a > 0.02]


def panelling(rng: np.random.Generator, width: float, height: float, holes: list[Opening],
              style: Joinery) -> Thing:
    """Frames on the wall below and above a dado rail, or boards with grooves."""
    made: list[Mesh] = []
    rim, foot = float(style.architrave[:, 0].max()) + 0.03, 0.25
    if style.panels == "boards":
        return _boards(rng, width, holes, style, rim)
    zones = {"wainscot": [(foot, style.wainscot)], "tall": [(foot, height - 0.3)], "none": [],
             "both": [(foot, style.wainscot), (style.wainscot + 0.15, height - 0.3)]}[style.panels]
    for low, high in zones:
        for a, b in between(width, holes, low, high, rim):
            columns = max(1, round((b - a) / rng.uniform(0.5, 1.3)))
            if b - a > 0.3:
                made += [solids.moulding(corners, style.panel, closed=True)
                         for corners in panel_grid(a + 0.1, low, b - 0.1, high, columns, 1, 0.12)]
    if style.panels in ("wainscot", "both"):
        rail = style.wainscot + 0.05
        made += [solids.moulding([[a, rail], [b, rail]], style.architrave * [0.6, 1.2])
                 for a, b in between(width, holes, rail, rail + 0.1, rim)]
    return [(meshes.merge(made), "panel")] if made else []


def _boards(rng: np.random.Generator, width: float, holes: list[Opening], style: Joinery,
            rim: float) -> Thing:
    """Tongue-and-groove boards up to the wainscot, with a cap."""
    pitch, made = rng.uniform(0.06, 0.2), []
    for a, b in between(width, holes, 0, style.wainscot, rim - 0.03):
        edges = np.linspace(a, b, max(2, round((b - a) / pitch) + 1))
        low = [[x + 0.002, 0, 0.0] for x in edges[:-1]]
        made.append(solids.boxes(low, [[x - 0.002, style.wainscot, 0.012] for x in edges[1:]]))
        made.append(solids.rounded_box([a, style.wainscot, 0], [b, style.wainscot + 0.03, 0.035],
                                       0.01))
    return [(meshes.merge(made), "panel")] if made else []


def skirting(width: float, holes: list[Opening], style: Joinery) -> Thing:
    rim = float(style.architrave[:, 0].max())
    made = [solids.moulding([[a, 0.0], [b, 0.0]], style.skirting)
            for a, b in between(width, holes, 0, 0.1, rim)]
    return [(meshes.merge(made), "trim")] if made else []
