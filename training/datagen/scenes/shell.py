"""The shell of an interior: floor, ceiling or roof, walls with deep openings, joinery, passages
behind doors."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from training.datagen.scenes import joinery, meshes, solids
from training.datagen.scenes.build import Description
from training.datagen.scenes.furniture import Thing, Y
from training.datagen.scenes.joinery import Joinery, Opening
from training.datagen.scenes.meshes import rotation, translation
from training.datagen.scenes.motion import hanging
from training.datagen.scenes.roles import Roles

# a plan's x, y, off -> x, z, down
DOWN = np.array([[1.0, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]])


@dataclass(frozen=True)
class Side:
    """A wall or a slope of the roof: its frame (x along it, y up, z inwards), its size, its
    openings."""

    matrix: np.ndarray
    width: float
    height: float
    holes: list[Opening]
    slope: bool = False


@dataclass
class House:
    """A room being furnished: `size` is width, height, depth; `taken` are boxes (x0, x1, z0, z1,
    top) on the floor.

    With `sky` an environment shines in, which needs large windows; else bright sheets stand
    outside. `sights` are points worth looking at, `far_windows` the ends of lit passages behind
    doors.
    """

    d: Description
    rng: np.random.Generator
    roles: Roles
    style: Joinery
    size: tuple[float, float, float]
    sky: bool = False
    sides: list[Side] = field(default_factory=list)
    pitch: float = 0.0
    taken: list[tuple[Any, ...]] = field(default_factory=list)
    sights: list[np.ndarray] = field(default_factory=list)
    far_windows: list[Side] = field(default_factory=list)

    def put(self, thing: Thing, matrix: np.ndarray, mover: int | None = None,
            bend: int | None = None) -> None:
        for mesh, role in thing:
            self.d.add(mesh.transform(matrix), self.roles[role], mover, bend)

    def headroom(self, x: float) -> float:
        """Height of the ceiling at x."""
        return self.size[1] + self.pitch * max(self.size[0] / 2 - abs(x), 0.0)


def frames(w: float, depth: float) -> list[tuple[np.ndarray, float]]:
    """Frames (4, 4) and widths of the four walls of a room about the origin; the first is the far
    one, at -z."""
    corners = np.array([[-w, 0, -depth], [w, 0, -depth], [w, 0, depth], [-w, 0, depth]]) / 2
    made = []
    for k, low in enumerate(corners):
        edge = corners[(k + 1) % 4] - low
        length = float(np.linalg.norm(edge))
        matrix = np.eye(4)
        matrix[:3, :3] = np.stack([edge / length, Y, np.cross(edge / length, Y)], 1)
        matrix[:3, 3] = low
        made.append((matrix, length))
    return made


def slope_frame(house: House, side: int) -> tuple[np.ndarray, float, float]:
    """Frame, width and height of the roof over wall `side` (1 or 3)."""
    w, knee, depth = house.size
    wall, angle = frames(w, depth)[side][0], np.arctan(house.pitch)
    lean = rotation(np.array([1.0, 0, 0]), np.pi / 2 - angle)
    return wall @ translation(0, knee, 0) @ lean, depth, w / 2 / np.cos(angle)


def build(house: House) -> None:
    """Build everything fixed, with the openings in `house.sides`."""
    w, h, depth = house.size
    floor = meshes.quad([-w / 2, 0, depth / 2], [w, 0, 0],
                        [0, 0, -depth]).scaled_uvs(house.rng.uniform(0.25, 0.7))
    house.put([(floor, "floor")], np.eye(4))
    if not house.pitch:
        house.put([(meshes.quad([-w / 2, h, -depth / 2], [w, 0, 0], [0, 0, depth]), "ceiling")],
                  np.eye(4))
        if house.style.cornice is not None:
            plan = solids.rectangle(-w / 2, -depth / 2, w / 2, depth / 2)
            loop = solids.moulding(plan, house.style.cornice, closed=True)
            house.put([(loop, str(house.rng.choice(["trim", "ceiling"])))],
                      translation(0, h, 0) @ DOWN)
        if house.rng.random() < 0.18:
            _coffers(house)
    for index, side in enumerate(house.sides):
        _wall(house, side, gable=bool(house.pitch) and index in (0, 2))


def _coffers(house: House) -> None:
    """Mouldings in fields on the ceiling."""
    rng, (w, h, depth) = house.rng, house.size
    pitch = rng.uniform(0.6, 1.6)
    rim = solids.frame_profile(rng, rng.uniform(0.03, 0.1), rng.uniform(0.01, 0.06))
    columns, rows = (max(1, round((size - 0.5) / pitch)) for size in (w, depth))
    fields = joinery.panel_grid(0.3 - w / 2, 0.3 - depth / 2, w / 2 - 0.3, depth / 2 - 0.3, columns,
                                rows, 0.12)
    made = [solids.moulding(corners, rim, closed=True) for corners in fields]
    house.put([(meshes.merge(made), "ceiling")], translation(0, h, 0) @ DOWN)


def _wall(house: House, side: Side, gable: bool) -> None:
    style, rng = house.style, house.rng
    plain = "ceiling" if side.slope else "wall"
    made = joinery.faces(side.width, side.height, side.holes, plain)
    if gable:
        ridge = house.pitch * side.width / 2
        corners = (np.array([[0, 0, 0], [side.width, 0, 0], [side.width / 2, ridge, 0]])
                   + [0, side.height, 0])
        normals, triangle = np.tile([0, 0, 1.0], (3, 1)), np.array([[0, 1, 2]], np.uint32)
        made.append((meshes.Mesh(corners, normals, corners[:, :2], triangle), "wall"))
    made = [(mesh.scaled_uvs(0.4), slot) for mesh, slot in made]
    if not side.slope:
        made += joinery.skirting(side.width, side.holes, style)
        if not house.pitch and rng.random() < 0.85:
            made += joinery.panelling(rng, side.width, side.height, side.holes, style)
    for hole in side.holes:
        made += joinery.reveal(hole, style.thick, str(rng.choice(["trim", plain])))
        if not side.slope or rng.random() < 0.5:
            made.append((joinery.architrave(hole, style.architrave), "trim"))
        if hole.kind == "window":
            made += joinery.window(rng, hole, style)
    house.put(made, side.matrix)
    for hole in side.holes:
        if hole.kind != "window":
            _behind(house, side, hole)
        if hole.kind == "door":
            _door(house, side, hole)


def dress(house: House) -> None:
    """Blinds and curtains: the same kind for all windows, some of them moving."""
    kind = str(house.rng.choice(["none", "blind", "curtain", "sheer"], p=[0.42, 0.18, 0.3, 0.1]))
    rng = house.rng
    for side in (s for s in house.sides if not s.slope):
        for hole in (h for h in side.holes if h.kind == "window"):
            if rng.random() < 0.4:
                house.sights.append(_world(side, (hole.x0, (hole.y0 + hole.y1) / 2, 0)))
            if kind == "blind" and rng.random() < 0.8:
                house.put(joinery.blind(rng, hole, -0.06 if house.style.thick > 0.25 else 0.05),
                          side.matrix)
            if kind in ("curtain", "sheer"):
                _curtains(house, side, hole)


def _curtains(house: House, side: Side, hole: Opening) -> None:
    rng = house.rng
    low = 0.02 if rng.random() < 0.75 else hole.y0 - 0.1
    top, reach = min(hole.y1 + 0.15, side.height - 0.05), rng.uniform(0.2, 0.35) * hole.width
    rail = meshes.cylinder(0.012, hole.width + 0.5, 14).transform(
        translation(hole.x0 - 0.25, top, 0.1) @ rotation(np.array([0, 0, 1.0]), -np.pi / 2))
    house.put([(rail, "metal")], side.matrix)
    for x in (hole.x0 - 0.2 + 0.3 * reach, hole.x1 + 0.2 - 0.3 * reach):
        if x - reach / 2 < 0.0 or x + reach / 2 > side.width:
            continue
        mesh = solids.curtain(rng, reach, top - low).transform(side.matrix
                                                               @ translation(x, low, 0.1))
        bend = None
        if rng.random() < 0.35:
            house.d.bends.append(hanging(rng, mesh.vertices[:, 1].max(), top - low,
                                         side.matrix[:3, 2]))
            bend = len(house.d.bends) - 1
        house.d.add(mesh, house.roles["curtain"], bend=bend)


def _door(house: House, side: Side, hole: Opening) -> None:
    """A leaf in the opening, flush with the wall, shut or ajar; some swing."""
    rng = house.rng
    leaf = [(mesh.transform(translation(0, -0.5 * hole.height, 0)), slot)
            for mesh, slot in joinery.leaf(rng, hole.width, hole.height, house.style)]
    hinge = side.matrix @ translation(hole.x0, 0.5 * hole.height, -0.02)
    angle = 0.0 if rng.random() < 0.5 else -float(rng.uniform(0.15, 1.7))
    if angle and rng.random() < 0.4:
        rate = float(np.clip(0.03 * np.exp(rng.normal(0, 0.7)), 0.005, 0.15)) * rng.choice([-1, 1])
        house.d.movers.append(lambda t: hinge @ rotation(Y, min(angle + rate * (t - 3.5), 0.0)))
        house.put(leaf, np.eye(4), len(house.d.movers) - 1)
    else:
        house.put(leaf, hinge @ rotation(Y, angle))
    reach = _world(side, (hole.x0 + hole.width * np.cos(angle), 0, -hole.width * np.sin(angle)))
    corners = np.stack([_world(side, (hole.x0, 0, 0)), _world(side, (hole.x1, 0, 0.6)), reach])
    house.taken.append((*corners[:, 0].min(keepdims=True), corners[:, 0].max(), corners[:, 2].min(),
                        corners[:, 2].max(), 2.0))


def _behind(house: House, side: Side, hole: Opening) -> None:
    """A passage behind a door or an arch; most have a window at their far end."""
    rng, z, top = house.rng, -house.style.thick, side.height
    length = 0.4 if hole.kind == "door" and rng.random() < 0.3 else rng.uniform(1.2, 3.0)
    a = max(hole.x0 - rng.uniform(0.05, 0.8), 0.0)
    b = min(hole.x1 + rng.uniform(0.05, 0.8), side.width)
    end = []
    if length > 1 and rng.random() < 0.65:
        end = [Opening(0.12, float(rng.choice([0.05, 0.9])), b - a - 0.12, min(2.1, top - 0.2))]
        far = Side(side.matrix @ translation(a, 0, z - length), b - a, top, end)
        house.far_windows.append(far)
        frame = joinery.window(rng, end[0], house.style)
        house.put(frame + joinery.reveal(end[0], house.style.thick, "wall"), far.matrix)
    front = joinery.faces(b - a, top, [Opening(hole.x0 - a, hole.y0, hole.x1 - a, hole.y1)], "wall")
    shell = [meshes.quad([a, 0, z], [b - a, 0, 0], [0, 0, -length]).scaled_uvs(0.4),
             meshes.quad([a, top, z], [0, 0, -length], [b - a, 0, 0]),
             meshes.quad([a, 0, z], [0, 0, -length], [0, top, 0]),
             meshes.quad([b, 0, z], [0, top, 0], [0, 0, -length])]
    flipped = translation(a, 0, z) @ np.diag([1.0, 1, -1, 1])
    house.put([(mesh.transform(flipped), slot) for mesh, slot in front], side.matrix)
    house.put(list(zip(shell, ["floor", "ceiling", "wall", "wall"], strict=True)), side.matrix)
    house.put(joinery.faces(b - a, top, end, "wall"), side.matrix @ translation(a, 0, z - length))


def _world(side: Side, point: tuple[Any, ...]) -> np.ndarray:
    return (side.matrix @ np.array([*point, 1.0]))[:3]
