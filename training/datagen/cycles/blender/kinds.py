"""Content of a clip: a setting (room, street, wood, studio, a whole glTF scene), things in it,
light, air and lens.

`build` draws a scene of one of the kinds that results are judged by. A kind fixes what must be in
the scene; the generator draws everything else, so fog, depth of field, motion blur and lamps also
occur together.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import bpy
import numpy as np
from mathutils import Matrix, Vector

from training.datagen.held_back import for_training

from . import mitsuba_scene
from . import scene as parts
from .scene import Rng

KINDS = {  # how often each is drawn for training
    "fog": 0.07,
    "indirect": 0.07,
    "foliage": 0.07,
    "fur": 0.06,
    "glass": 0.07,
    "dof": 0.06,
    "motion_blur": 0.10,
    "interior": 0.08,
    "outdoor": 0.05,
    "product": 0.05,
    "text": 0.07,
    "water": 0.10,
    "snow": 0.03,
    "lamps": 0.04,
    "fire": 0.04,
    "cloth": 0.04,
}


HALFTONES = 0.4  # share of pages that are printed in dots
BLURRED = 0.06  # share of the other kinds' scenes in which motion is blurred

# The library: things that were modelled by others


class Library:
    """A folder of glTF scenes with their descriptions, panoramas and pages of text, without what is
    held back."""

    def __init__(self, root: Path | None):
        self.root = root
        found = (for_training(path.parent for path in sorted(root.glob("*/about.json"))) if root
                 else [])
        self.about = {folder.name: json.loads((folder / "about.json").read_text())
                      for folder in found if (folder / "scene.gltf").exists()}
        self.rooms = [folder for folder in found if (folder / "scene.xml").exists()]
        self.panoramas = sorted((root / "environments").glob("*.hdr")) if root else []
        self.pages = sorted((root / "pages").glob("*.png")) if root else []

    def names(self, *kinds: str) -> list[str]:
        return [name for name, about in self.about.items() if about["kind"] in kinds]

    def load(self, name: str, rng: Rng,
             pick: int | None = None) -> tuple[list[bpy.types.Object], np.ndarray, np.ndarray]:
        """Import a file; of a set keep ``pick`` pieces. Root objects and the bounds (3,), (3,) of
        its meshes."""
        assert self.root is not None, "a library of things has a folder"
        before = set(bpy.data.objects)
        bpy.ops.import_scene.gltf(filepath=str(self.root / name / "scene.gltf"))
        made = [o for o in bpy.data.objects if o not in before]
        for item in [o for o in made if o.type in ("CAMERA", "LIGHT")]:
            bpy.data.objects.remove(item, do_unlink=True)
            made.remove(item)
        roots = [o for o in made if o.parent is None]
        if pick is not None and len(roots) == 1 and len(roots[0].children) > pick:
            roots = list(roots[0].children)
            for item in roots:
                world = item.matrix_world.copy()
                item.matrix_parent_inverse = Matrix()
                item.parent = None
                item.matrix_world = world
        if pick is not None and len(roots) > pick:
            kept = {roots[i] for i in rng.choice(len(roots), pick, replace=False)}
            for item in [o for o in made if root_of(o) not in kept]:
                bpy.data.objects.remove(item, do_unlink=True)
            roots = list(kept)
        bpy.context.view_layer.update()
        return roots, *bounds(roots)


def root_of(item: bpy.types.Object) -> bpy.types.Object:
    while item.parent is not None:
        item = item.parent
    return item


def family(roots: Sequence[bpy.types.Object]) -> list[bpy.types.Object]:
    return [o for root in roots for o in (root, *root.children_recursive)]


def bounds(roots: Sequence[bpy.types.Object]) -> tuple[np.ndarray, np.ndarray]:
    """Lowest and highest corner of the meshes below some objects."""
    corners = [np.array(o.matrix_world @ Vector(c)) for o in family(roots) if o.type == "MESH"
               for c in o.bound_box]
    return (np.min(corners, 0), np.max(corners, 0)) if corners else (np.zeros(3), np.zeros(3))


def stand(roots: Sequence[bpy.types.Object], at: Sequence[float], size: float,
          turn: float) -> bpy.types.Object:
    """Scale a loaded thing to ``size``, its largest side, and stand it on a place; returns the
    parent of its parts."""
    low, high = bounds(roots)
    scale = size / max(float((high - low).max()), 1e-6)
    middle = np.array([(low[0] + high[0]) / 2, (low[1] + high[1]) / 2, low[2]])
    handle = parts.link("handle", None)
    for root in roots:
        root.parent = handle
    handle.matrix_world = (Matrix.Translation(Vector(at)) @ Matrix.Rotation(turn, 4, "Z")
                           @ Matrix.Scale(scale, 4) @ Matrix.Translation(-Vector(middle)))
    bpy.context.view_layer.update()
    return handle


# Scenes


@dataclass
class Shot:
    """A scene that is ready to be rendered; ``facts`` go into the clip's file."""

    target: np.ndarray
    size: float  # of the subject, metres
    facts: dict[str, Any] = field(default_factory=dict)


def build(kind: str, library: Library, frames: int, width: int, rng: Rng) -> Shot:
    """A scene of ``kind`` with its camera's path; ``width`` in pixels sets how fast the camera may
    be."""
    parts.clear()
    shot = SETTINGS[kind](library, frames, rng)
    shot.facts["kind"] = kind
    camera = bpy.context.scene.camera
    shot.facts["camera"] = parts.move_camera(camera, shot.target, frames, width, rng)
    if kind == "dof" or (kind not in ("motion_blur", "text") and rng.random() < 0.08):
        focus(camera, shot, rng, strong=kind == "dof")
    blur = kind == "motion_blur" or rng.random() < BLURRED
    bpy.context.scene.render.use_motion_blur = blur
    bpy.context.scene.render.motion_blur_shutter = rng.uniform(0.3, 1.0)
    shot.facts["blur"] = blur
    return shot


def focus(camera: bpy.types.Object, shot: Shot, rng: Rng, strong: bool) -> None:
    """Depth of field: on the thing or behind it."""
    lens = camera.data.dof
    distance = float(np.linalg.norm(np.array(camera.matrix_world.translation) - shot.target))
    lens.use_dof = True
    lens.focus_distance = distance * float(rng.choice([1.0, 0.7, 1.6, 0.4],
                                                      p=[0.6, 0.15, 0.15, 0.1]))
    blur = 2 ** rng.uniform(-6.5, -3.5) * (2.0 if strong else 0.7)  # the aperture over the distance
    lens.aperture_fstop = camera.data.lens / 1000 / (blur * distance)
    lens.aperture_blades = int(rng.choice([0, 5, 6, 8]))
    shot.facts["dof"] = True


# Settings


def room(library: Library, frames: int, rng: Rng, dark: bool = False) -> Shot:
    """A furnished box lit by a window, a door ajar, lamps or strips; ``dark``: no light reaches
    most of it directly."""
    w, d, h = rng.uniform(3, 7), rng.uniform(3, 8), rng.uniform(2.3, 3.4)
    wall = parts.material(rng, "rough")
    floor = parts.material(rng)
    ceiling = parts.material(rng, "rough")
    if rng.random() < 0.6:
        wall.node_tree.nodes["Principled BSDF"].inputs["Base Color"].default_value = (*[
            rng.uniform(0.5, 0.85)
        ] * 3, 1)
    parts.quad((0, 0, 0), (w / 2, 0, 0), (0, d / 2, 0), floor)
    parts.quad((0, 0, h), (-w / 2, 0, 0), (0, d / 2, 0), ceiling)
    for x in (-1, 1):
        parts.quad((x * w / 2, 0, h / 2), (0, -x * d / 2, 0), (0, 0, h / 2), wall)
    parts.quad((0, -d / 2, h / 2), (-w / 2, 0, 0), (0, 0, h / 2), wall)
    opening = str(rng.choice(["window", "none", "door"],
                             p=[0.25, 0.1, 0.65] if dark else [0.6, 0.25, 0.15]))
    wall_with_opening(w, d, h, opening, wall, rng)
    light_room(library, w, d, h, opening, dark, rng)
    things = furnish(library, w, d, rng)
    move_some(things, frames, rng, 0.5)
    eye = np.array([rng.uniform(-0.35, 0.35) * w, -0.42 * d, rng.uniform(0.8, 1.8)])
    target = np.array([rng.uniform(-0.3, 0.3) * w, rng.uniform(0, 0.3) * d, rng.uniform(0.3, 1.2)])
    if opening == "door" and dark:  # beside the light, not into it
        target[0] = -0.35 * w
    parts.camera_at(eye, target, rng.uniform(40, 85))
    return Shot(target, 1.0, {"setting": "room", "opening": opening})


def wall_with_opening(w: float, d: float, h: float, opening: str, wall: bpy.types.Material,
                      rng: Rng) -> None:
    """The far wall, as four boxes around a hole."""
    y = d / 2
    if opening == "none":
        parts.quad((0, y, h / 2), (w / 2, 0, 0), (0, 0, h / 2), wall)
        return
    wide = rng.uniform(0.8, 1.0) if opening == "door" else rng.uniform(0.6, 0.6 * w)
    left = rng.uniform(-w / 2 + 0.2, w / 2 - wide - 0.2)
    low, high = ((0.0, 2.05) if opening == "door"
                 else (rng.uniform(0.3, 1.0), rng.uniform(1.8, h - 0.15)))
    for a, b in (((-w / 2, y, 0), (left, y + 0.15, h)), ((left + wide, y, 0), (w / 2, y + 0.15, h)),
                 ((left, y, 0), (left + wide, y + 0.15, low)),
                 ((left, y, high), (left + wide, y + 0.15, h))):
        if b[0] - a[0] > 1e-3 and b[2] - a[2] > 1e-3:
            parts.box(a, b, wall)
    if opening == "door":
        leaf = parts.box((0, -0.02, 0), (wide, 0.02, 2.0), parts.material(rng))
        angle = rng.uniform(0.08, 0.6)
        leaf.matrix_world = (Matrix.Translation((left, y, 0)) @ Matrix.Rotation(angle, 4, "Z")
                             @ Matrix.Translation((wide / 2, 0, 1.0)))


def light_room(library: Library, w: float, d: float, h: float, opening: str, dark: bool,
               rng: Rng) -> None:
    white = np.array([1, rng.uniform(0.7, 1), rng.uniform(0.5, 1)])
    if opening != "none":
        pick = rng.random()
        if pick < 0.4 and not (dark and opening == "door"):
            parts.sky(rng.uniform(0.3, 1), rng.uniform(0.05, 1.2), rng.uniform(0, 6.3),
                      rng.random() < 0.6)
        elif pick < 0.6 and library.panoramas:
            panorama(library, rng)
        else:
            pose = Matrix.Translation((rng.uniform(-w / 2, w / 2), d / 2 + rng.uniform(0.6, 2),
                                       h / 2))
            parts.lamp("AREA", pose @ Matrix.Rotation(math.pi / 2, 4, "X"), 2 ** rng.uniform(5, 9),
                       rng.uniform(0.5, 2.5), tuple(white))
    if opening == "none" or rng.random() < (0.1 if dark else 0.3):
        for _ in range(int(rng.integers(1, 5))):
            place = rng.uniform((-0.4 * w, -0.4 * d, 0.5 * h), (0.4 * w, 0.4 * d, 0.95 * h))
            at = Matrix.Translation(place)
            kind = str(rng.choice(["POINT", "AREA", "SPOT"]))
            if dark:  # light thrown at the ceiling from behind a shelf
                parts.box(place - (0.3, 0.3, 0.06), place + (0.3, 0.3, -0.02),
                          parts.material(rng, "rough"))
                at, kind = at @ Matrix.Rotation(math.pi, 4, "X"), "AREA"
            parts.lamp(kind, at, 2 ** rng.uniform(3, 7), rng.uniform(0.02, 0.5), tuple(white),
                       rng.uniform(0.4, 1.5))


def furnish(library: Library, w: float, d: float, rng: Rng) -> list[bpy.types.Object]:
    """Boxes, bodies and loaded props on the floor and on each other."""
    things = []
    for _ in range(int(rng.integers(1, 4))):  # tables, chests
        size = rng.uniform(0.3, 1.1, 3) * (1, 1, 0.8)
        at = np.array([rng.uniform(-0.4, 0.4) * w, rng.uniform(-0.1, 0.42) * d, 0])
        parts.box(at - (size[0] / 2, size[1] / 2, 0), at + (size[0] / 2, size[1] / 2, size[2]),
                  parts.material(rng))
        for _ in range(int(rng.integers(0, 4))):
            top = at + (rng.uniform(-0.4, 0.4) * size[0], rng.uniform(-0.4, 0.4) * size[1], size[2])
            things.append(parts.solid(rng, top, rng.uniform(0.1, 0.4), parts.material(rng)))
    for _ in range(int(rng.integers(0, 4))):
        at = np.array((rng.uniform(-0.4, 0.4) * w, rng.uniform(-0.1, 0.4) * d, 0))
        things.append(parts.solid(rng, at, rng.uniform(0.2, 0.8), parts.material(rng)))
    things += props(library, rng, int(rng.integers(0, 4)), 0.4 * w, 0.35 * d, (0.3, 1.5))
    return things


def props(library: Library, rng: Rng, count: int, x: float, y: float,
          sizes: tuple[float, float]) -> list[bpy.types.Object]:
    """Things of the library, stood on the floor within x and y."""
    things = []
    for _ in range(count):
        names = library.names("asset", "set", "character", "vehicle")
        if not names:
            break
        name = str(names[rng.integers(len(names))])
        roots, _, _ = library.load(name, rng, int(rng.integers(1, 4))
                                   if library.about[name]["kind"] == "set" else None)
        at = (rng.uniform(-x, x), rng.uniform(-0.2 * y, y), 0)
        things.append(stand(roots, at, rng.uniform(*sizes), rng.uniform(0, 6.3)))
    return things


def move_some(things: list[bpy.types.Object], frames: int, rng: Rng, chance: float) -> None:
    for item in things:
        if rng.random() < chance / max(len(things), 1) ** 0.5:
            low, high = bounds([item])
            parts.move_thing(item, max(float((high - low).max()), 0.1), frames, rng)


def middle_of(things: list[bpy.types.Object], rng: Rng) -> np.ndarray:
    """The middle of one of the things, picked at random."""
    low, high = bounds([things[rng.integers(len(things))]])
    return (low + high) / 2


def panorama(library: Library, rng: Rng) -> None:
    """One of the library's panoramas as the world."""
    path = library.panoramas[rng.integers(len(library.panoramas))]
    parts.environment(path, rng.uniform(0.3, 2.5), rng.uniform(0, 6))


def daylight(library: Library, rng: Rng) -> None:
    """Sky, panorama or an overcast world."""
    pick = rng.random()
    if pick < 0.5:
        parts.sky(rng.uniform(0.2, 1), rng.uniform(0.03, 1.4), rng.uniform(0, 6.3),
                  rng.random() < 0.75)
    elif pick < 0.85 and library.panoramas:
        panorama(library, rng)
    else:
        parts.plain_world(tuple(rng.uniform(0.3, 1, 3)), rng.uniform(0.3, 2))


def night(rng: Rng, spread: float) -> None:
    """Stars and a few lamps."""
    parts.starry_world(rng)
    for _ in range(int(rng.integers(2, 9))):
        at = (rng.uniform(-spread, spread), rng.uniform(-spread, spread),
              rng.uniform(0.3, 1) * spread * 0.4)
        parts.lamp("POINT", Matrix.Translation(at), 2 ** rng.uniform(3, 7) * spread**2 / 9,
                   0.03 * spread, tuple(rng.uniform(0.4, 1, 3)))


def outdoor(library: Library, frames: int, rng: Rng) -> Shot:
    """A whole exterior or a ground with houses, vehicles and bodies on it."""
    wholes = library.names("exterior")
    if wholes and rng.random() < 0.45:
        roots, _, _ = library.load(str(wholes[rng.integers(len(wholes))]), rng)
        stand(roots, (0, 0, 0), 20.0, rng.uniform(0, 6.3))
        things, spread = [], 7.0
        if rng.random() < 0.5:
            parts.quad((0, 0, -0.02), (200, 0, 0), (0, 200, 0), parts.material(rng, "rough"))
    else:
        ground = parts.material(rng, "rough" if rng.random() < 0.7 else None)
        if rng.random() < 0.5:
            parts.quad((0, 0, 0), (300, 0, 0), (0, 300, 0), ground)
        else:
            parts.terrain(rng, 120, rng.uniform(0.2, 2), ground)
        spread = 5.0
        things = props(library, rng, int(rng.integers(1, 7)), spread, spread, (0.8, 6))
        things += [parts.solid(rng, (*rng.uniform(-spread, spread, 2), 0), rng.uniform(0.5, 3),
                               parts.material(rng))
                   for _ in range(int(rng.integers(1, 6)))]
        move_some(things, frames, rng, 0.8)
    night(rng, spread) if rng.random() < 0.2 else daylight(library, rng)
    angle = rng.uniform(0, 6.3)
    away, height = rng.uniform(1.2, 2.5) * spread, rng.uniform(0.5, 0.8 * spread)
    eye = np.array([away * math.cos(angle), away * math.sin(angle), height])
    target = np.array([*rng.normal(0, 0.2 * spread, 2), rng.uniform(0.3, 0.3 * spread)])
    if things and rng.random() < 0.8:
        target = middle_of(things, rng)
    parts.camera_at(eye, target, rng.uniform(25, 65))
    return Shot(target, spread, {"setting": "outdoor"})


def foliage(library: Library, frames: int, rng: Rng) -> Shot:
    """Trees, bushes and grass under a sky."""
    soil = parts.material(rng, "rough")
    parts.terrain(rng, 60, rng.uniform(0.1, 1.2), soil)
    for _ in range(int(rng.integers(1, 6))):
        at = np.array([*rng.uniform(-6, 6, 2), 0])
        parts.tree_crown(rng, at, rng.uniform(2, 7), parts.leaf_material(rng),
                         parts.material(rng, "rough"))
    for _ in range(int(rng.integers(1, 7))):
        centre, size = np.array([*rng.uniform(-5, 5, 2), 0.4]), rng.uniform(0.3, 1.2)
        count = int(rng.integers(800, 4000))
        ball = rng.normal(size=(count, 3))
        ball *= size * rng.random((count, 1)) ** 0.4 / np.linalg.norm(ball, axis=1, keepdims=True)
        length = rng.uniform(0.03, 0.2)
        parts.leaves(rng, centre + ball, length, length * rng.uniform(0.2, 0.7),
                     parts.leaf_material(rng))
    if rng.random() < 0.75:
        blades = np.column_stack([rng.uniform(-7, 7, (int(rng.integers(8000, 40000)), 2)), ])
        centres = np.column_stack([blades, np.zeros(len(blades))])
        parts.leaves(rng, centres, rng.uniform(0.1, 0.5), rng.uniform(0.005, 0.03),
                     parts.leaf_material(rng), 0.8)
    things = props(library, rng, int(rng.integers(0, 3)), 3, 3, (0.5, 2))
    move_some(things, frames, rng, 0.6)
    daylight(library, rng)
    angle = rng.uniform(0, 6.3)
    eye = (np.array([math.cos(angle), math.sin(angle), 0]) * rng.uniform(3, 11)
           + (0, 0, rng.uniform(0.6, 2.5)))
    target = np.array([*rng.normal(0, 1.5, 2), rng.uniform(0.4, 2.5)])
    parts.camera_at(eye, target, rng.uniform(25, 70))
    return Shot(target, 3.0, {"setting": "foliage"})


def studio(library: Library, frames: int, rng: Rng, kind: str | None = None) -> Shot:
    """Things on a bench or a sweep under soft boxes, a panorama or both."""
    parts.quad((0, 0, 0), (8, 0, 0), (0, 8, 0),
               parts.material(rng, None if rng.random() < 0.5 else "rough"))
    if rng.random() < 0.6:
        parts.quad((0, 5, 4), (8, 0, 0), (0, 0, 4), parts.material(rng, "rough"))
    things = []
    for _ in range(int(rng.integers(1, 7))):
        made = parts.material(rng, kind if kind and rng.random() < 0.7 else None)
        things.append(parts.solid(rng, (*rng.normal(0, 0.5, 2), 0), rng.uniform(0.3, 1.2), made))
    if rng.random() < 0.6:
        things += props(library, rng, int(rng.integers(1, 4)), 1.0, 1.0, (0.4, 1.6))
    move_some(things, frames, rng, 0.7)
    if rng.random() < 0.6 and library.panoramas:
        panorama(library, rng)
    else:
        parts.plain_world((1, 1, 1), rng.uniform(0, 0.3))
    for _ in range(int(rng.integers(1, 4))):
        at = Vector((*rng.normal(0, 3, 2), rng.uniform(2, 5)))
        parts.lamp("AREA", parts.look(at, (0, 0, 0.4)), 2 ** rng.uniform(5, 9.5),
                   rng.uniform(0.1, 2.5), tuple(rng.uniform(0.7, 1, 3)))
    angle = rng.uniform(-2.6, -0.5)
    eye = (np.array([math.cos(angle), math.sin(angle), 0]) * rng.uniform(1.8, 4.5)
           + (0, 0, rng.uniform(0.3, 2.2)))
    target = (middle_of(things, rng) if rng.random() < 0.8
              else np.array([*rng.normal(0, 0.2, 2), rng.uniform(0.2, 0.6)]))
    parts.camera_at(eye, target, rng.uniform(20, 55))
    return Shot(target, 0.8, {"setting": "studio"})


def fur(library: Library, frames: int, rng: Rng) -> Shot:
    """Hair and fur on bodies, rugs and grass-like carpets, in a studio or outdoors."""
    shot = studio(library, frames, rng) if rng.random() < 0.7 else outdoor(library, frames, rng)
    size = shot.size
    for _ in range(int(rng.integers(1, 4))):
        at = shot.target * (1, 1, 0) + (*rng.normal(0, 0.6 * size, 2), 0)
        body = parts.solid(rng, at, size * rng.uniform(0.6, 1.4), parts.material(rng, "rough"))
        parts.fur(rng, body, int(rng.integers(800, 4000)), size * 2 ** rng.uniform(-5, -1.5))
    if rng.random() < 0.3:
        rug = parts.quad((*shot.target[:2], 0.01), (1.5 * size, 0, 0), (0, 1.5 * size, 0),
                         parts.material(rng, "rough"))
        parts.fur(rng, rug, 4000, size * rng.uniform(0.03, 0.15))
    return shot


def fog(library: Library, frames: int, rng: Rng) -> Shot:
    """Mist, smoke or lit dust all over a setting, or a cloud in it."""
    setting = str(rng.choice(["room", "outdoor", "studio", "foliage", "dark"],
                             p=[0.3, 0.3, 0.15, 0.1, 0.15]))
    settings: dict[str, Callable[[Library, int, Rng], Shot]] = {
        "room": room, "outdoor": outdoor, "studio": studio, "foliage": foliage,
        "dark": partial(room, dark=True)}
    shot = settings[setting](library, frames, rng)
    reach = {"room": 5, "dark": 5, "studio": 4}.get(setting, 5 * shot.size)
    density = 2 ** rng.uniform(-3.5, 1.5) / reach
    whole = rng.random() < 0.7
    wisps = rng.uniform(0.5, 6) / shot.size if rng.random() < (0.25 if whole else 0.9) else 0.0
    made = parts.volume_material(rng, density if whole else density * 6, wisps)
    if whole:
        parts.box((-1.6 * reach, -1.6 * reach, -0.5 * reach), (1.6 * reach, 1.6 * reach, reach),
                  made)
    else:
        half = shot.size * rng.uniform(0.5, 1.2)
        parts.box(shot.target - half, shot.target + half, made)
    for _ in range(int(rng.integers(0, 3))):  # beams
        at = shot.target + (*rng.normal(0, 0.5 * reach, 2), rng.uniform(0.3, 0.8) * reach)
        parts.lamp("SPOT", parts.look(at, shot.target + rng.normal(0, 0.3, 3)),
                   2 ** rng.uniform(5, 9) * reach**2 / 9,
                   0.02 * reach, tuple(rng.uniform(0.5, 1, 3)), rng.uniform(0.2, 0.9))
    if rng.random() < 0.3:
        lit = parts.glow(tuple(rng.uniform(0.3, 1, 3)), 2 ** rng.uniform(2, 6))
        ball = parts.solid(rng, shot.target, 0.2 * shot.size, lit)
        parts.move_thing(ball, shot.size, frames, rng)
    shot.facts |= {"setting": setting, "density": density}
    return shot


def indirect(library: Library, frames: int, rng: Rng) -> Shot:
    return room(library, frames, rng, dark=True)


def interior(library: Library, frames: int, rng: Rng) -> Shot:
    """A whole interior of the library, from a place inside it, or a room."""
    if library.rooms and rng.random() < 0.5:
        return furnished(library, frames, rng)
    names = library.names("interior")
    if not names or rng.random() < 0.5:
        return room(library, frames, rng)
    name = str(names[rng.integers(len(names))])
    roots, low, high = library.load(name, rng)
    span = high - low
    parts.sky(rng.uniform(0.5, 1.5), rng.uniform(0.2, 1.2), rng.uniform(0, 6.3), True)
    middle = (low + high) / 2
    for _ in range(int(rng.integers(1, 5))):
        at = low + span * rng.uniform(0.2, 0.8, 3)
        power = 2 ** rng.uniform(0, 3) * float(span[:2].max()) ** 2
        parts.lamp("POINT", Matrix.Translation(at), power, 0.02 * float(span.max()))
    eye = low + span * (*rng.uniform(0.2, 0.8, 2), rng.uniform(0.35, 0.7))
    target = middle + span * (*rng.uniform(-0.3, 0.3, 2), rng.uniform(-0.2, 0.1))
    parts.camera_at(eye, target, rng.uniform(50, 85))
    return Shot(target, float(span.max()) / 8, {"setting": name})


def furnished(library: Library, frames: int, rng: Rng) -> Shot:
    """A room that others furnished, near one of its cameras."""
    folder = library.rooms[rng.integers(len(library.rooms))]
    objects, cameras = mitsuba_scene.load(folder)
    eye, target, fov = cameras[rng.integers(len(cameras))]
    span = float(np.linalg.norm(target - eye))
    eye = eye + rng.normal(0, 0.05 * span, 3)
    target = target + rng.normal(0, 0.15 * span, 3) * (1, 1, 0.5)
    if rng.random() < 0.6:
        daylight(library, rng)
    else:
        parts.plain_world((1, 1, 1), 2 ** rng.uniform(-6, 0))
    if rng.random() < 0.4:  # a lamp on the way
        at = eye + (target - eye) * rng.uniform(0.2, 0.9) + (0, 0, 0.1 * span)
        parts.lamp("POINT", Matrix.Translation(Vector(at)), 2 ** rng.uniform(0, 5) * span**2,
                   0.02 * span, tuple(rng.uniform(0.6, 1, 3)))
    if rng.random() < 0.5:
        made = parts.material(rng)
        ball = parts.solid(rng, eye + (target - eye) * rng.uniform(0.4, 0.8) - (0, 0, 0.1 * span),
                           0.1 * span, made)
        parts.move_thing(ball, 0.2 * span, frames, rng)
    parts.camera_at(eye, target, float(np.clip(fov * rng.uniform(0.6, 1.1), 25, 85)))
    return Shot(target, span / 4, {"setting": folder.name, "objects": len(objects)})


def glass(library: Library, frames: int, rng: Rng) -> Shot:
    return studio(library, frames, rng,
                  str(rng.choice(["glass", "frosted", "metal"], p=[0.45, 0.3, 0.25])))


def fast_things(library: Library, frames: int, rng: Rng) -> Shot:
    """Any setting with fast things in it."""
    shot = [studio, outdoor, room][rng.integers(3)](library, frames, rng)
    for _ in range(int(rng.integers(1, 4))):
        at = shot.target * (1, 1, 0.5) + rng.normal(0, 0.4 * shot.size, 3) * (1, 1, 0.3)
        body = parts.solid(rng, at, shot.size * rng.uniform(0.2, 0.7), parts.material(rng))
        parts.move_thing(body, shot.size * rng.uniform(1, 4), frames, rng)
    return shot


def out_of_focus(library: Library, frames: int, rng: Rng) -> Shot:
    """Depth of field, often with small lamps behind."""
    shot = [studio, outdoor, foliage,
            room][rng.choice(4, p=[0.4, 0.25, 0.15, 0.2])](library, frames, rng)
    if rng.random() < 0.6:
        eye = np.array(bpy.context.scene.camera.matrix_world.translation)
        way = (shot.target - eye) / np.linalg.norm(shot.target - eye)
        distance = float(np.linalg.norm(shot.target - eye))
        for _ in range(int(rng.integers(3, 25))):
            at = (eye + way * distance * rng.uniform(1.2, 3)
                  + rng.normal(0, 0.5 * distance, 3) * (1, 1, 0.5))
            lit = parts.glow(tuple(rng.uniform(0.2, 1, 3)), 2 ** rng.uniform(4, 11))
            at[2] = abs(at[2]) + 0.05
            parts.solid(rng, at, distance * 2 ** rng.uniform(-8, -5), lit)
    return shot


def text(library: Library, frames: int, rng: Rng) -> Shot:
    """Printed and glowing pages, labels and screens."""
    shot = studio(library, frames, rng)
    for _ in range(int(rng.integers(1, 5)) if library.pages else 0):
        page = library.pages[rng.integers(len(library.pages))]
        dark = rng.random() < 0.3
        ink, paper = parts.colour_of(rng), tuple(rng.uniform(0.5, 0.9, 3))
        if rng.random() < HALFTONES:
            made = parts.halftone_material(rng)
        else:
            made = parts.page_material(page, paper if dark else ink, ink if dark else paper,
                                       2 ** rng.uniform(-1, 4) if rng.random() < 0.3 else 0.0)
        at = shot.target + (*rng.normal(0, 0.7, 2), rng.uniform(0.1, 0.5))
        half, turn, lean = rng.uniform(0.3, 0.9), rng.uniform(-0.5, 0.5), rng.uniform(-1.2, 0.3)
        pose = (Matrix.Translation(at) @ Matrix.Rotation(turn, 4, "Z")
                @ Matrix.Rotation(math.pi / 2 + lean, 4, "X"))
        item = parts.quad((0, 0, 0), (half, 0, 0), (0, half, 0), made)
        item.matrix_world = pose
    return shot


def water(library: Library, frames: int, rng: Rng) -> Shot:
    """A pool, a lake or a puddle whose waves move, over a textured ground, with things in it and
    around."""
    deep = rng.uniform(0.15, 1.5)
    ground = parts.material(rng, "rough")
    parts.quad((0, 0, -deep), (30, 0, 0), (0, 30, 0), ground)
    surface = parts.waves(rng, 24.0, frames)
    surface.data.materials.append(parts.water_material(rng))
    things = [parts.solid(rng, (*rng.uniform(-2.5, 2.5, 2), rng.uniform(-0.8, 0.1)),
                          rng.uniform(0.3, 1.4), parts.material(rng))
              for _ in range(int(rng.integers(2, 7)))]
    things += props(library, rng, int(rng.integers(0, 3)), 2.0, 2.0, (0.5, 2))
    move_some(things, frames, rng, 0.6)
    night(rng, 5.0) if rng.random() < 0.12 else daylight(library, rng)
    angle = rng.uniform(0, 6.3)
    eye = (np.array([math.cos(angle), math.sin(angle), 0]) * rng.uniform(2.5, 7)
           + (0, 0, rng.uniform(0.5, 3)))
    target = np.array([*rng.normal(0, 0.7, 2), rng.uniform(-0.3, 0.4)])
    parts.camera_at(eye, target, rng.uniform(30, 65))
    return Shot(target, 2.0, {"setting": "water"})


def snow(library: Library, frames: int, rng: Rng) -> Shot:
    """Flakes, drops or sparks that fall through a setting, many of them smaller than a pixel."""
    shot = [outdoor, foliage, room,
            studio][rng.choice(4, p=[0.45, 0.25, 0.15, 0.15])](library, frames, rng)
    eye = np.array(bpy.context.scene.camera.matrix_world.translation)
    reach = float(np.linalg.norm(shot.target - eye))
    for _ in range(int(rng.integers(1, 4))):
        made = (parts.glow(tuple(rng.uniform(0.3, 1, 3)), 2 ** rng.uniform(1, 6))
                if rng.random() < 0.25 else (
            parts.material(rng, "rough")))
        count, size = int(rng.integers(200, 6000)), reach * 2 ** rng.uniform(-10, -7)
        centres = (eye + (shot.target - eye) * rng.uniform(0.1, 1.6, (count, 1))
                   + rng.normal(0, 0.4 * reach, (count, 3)))
        flakes = parts.flakes(rng, centres, size, made)
        fall = np.array([rng.normal(0, 0.1), rng.normal(0, 0.1), -rng.uniform(0.02, 0.6)]) * reach
        parts.keyframe(flakes, Matrix(), Matrix.Translation(Vector(fall)), frames)
    return shot


def lamps(library: Library, frames: int, rng: Rng) -> Shot:
    """A street or a hall by night, lit by many small lamps and windows."""
    parts.quad((0, 0, 0), (80, 0, 0), (0, 80, 0),
               parts.material(rng, str(rng.choice(["rough", "coat", "plastic"]))))
    street, length = rng.uniform(3, 9), 40.0
    for side in (-1, 1):
        y = -length / 2
        while y < length / 2:
            w, d, h = rng.uniform(3, 9), rng.uniform(3, 8), rng.uniform(3, 16)
            low = np.array([side * street, y, 0.0])
            parts.box(np.minimum(low, low + (side * d, 0, 0)),
                      np.maximum(low + (0, w, h), low + (side * d, w, h)),
                      parts.material(rng, "rough"))
            lit = parts.glow(tuple(np.array([1, rng.uniform(0.5, 1), rng.uniform(0.2, 1)])),
                             2 ** rng.uniform(0, 4.5))
            for z in np.arange(1.2, h - 1, rng.uniform(1.4, 3)):
                for x in np.arange(0.6, w - 0.8, rng.uniform(1.0, 2.4)):
                    if rng.random() < 0.45:
                        parts.quad((side * (street - 0.02), y + x + 0.3, z), (0, 0.35, 0),
                                   (0, 0, 0.5), lit)
            y += w + rng.uniform(0, 2)
    for _ in range(int(rng.integers(1, 4))):  # strings of bulbs
        bulb = parts.glow(tuple(rng.uniform(0.2, 1, 3) ** 2 + 0.02), 2 ** rng.uniform(4, 9))
        line = np.linspace(0, 1, int(rng.integers(30, 160)))[:, None]
        a, b = rng.uniform((-street, -15, 2.5), (street, 15, 6), (2, 3))
        centres = a + (b - a) * line - np.array([0, 0, 1]) * 3 * line * (1 - line)
        parts.flakes(rng, centres, rng.uniform(0.02, 0.08), bulb)
    things = props(library, rng, int(rng.integers(1, 5)), street * 0.7, 6, (0.8, 3))
    move_some(things, frames, rng, 0.8)
    parts.starry_world(rng) if rng.random() < 0.5 else parts.plain_world((0.1, 0.15, 0.3),
                                                                         rng.uniform(0.005, 0.1))
    eye = np.array([rng.uniform(-0.5, 0.5) * street, -rng.uniform(6, 16), rng.uniform(1, 5)])
    target = np.array([rng.uniform(-0.6, 0.6) * street, rng.uniform(0, 8), rng.uniform(0.5, 3)])
    parts.camera_at(eye, target, rng.uniform(30, 70))
    return Shot(target, 3.0, {"setting": "street"})


def fire(library: Library, frames: int, rng: Rng) -> Shot:
    """Smoke and flames in a setting; both drift."""
    shot = [studio, outdoor, room][rng.choice(3, p=[0.4, 0.35, 0.25])](library, frames, rng)
    for _ in range(int(rng.integers(1, 3))):
        half = shot.size * rng.uniform(0.4, 1.1) * np.array([1, 1, rng.uniform(1, 1.8)])
        at = shot.target + (*rng.normal(0, 0.4 * shot.size, 2), 0.5 * half[2])
        heat = 2 ** rng.uniform(1, 6) if rng.random() < 0.65 else 0.0
        made = parts.smoke_material(rng, half, 2 ** rng.uniform(0.5, 4.5) / shot.size, heat, frames)
        parts.box(at - half, at + half, made)
        if heat:
            parts.lamp("POINT", Matrix.Translation(Vector(at)),
                       20 * heat * shot.size**2 * rng.uniform(0.1, 1),
                       0.3 * shot.size, (1, 0.55, 0.2))
    return shot


def cloth(library: Library, frames: int, rng: Rng) -> Shot:
    """Curtains and flags that let light through, before a window or the sun."""
    shot = [studio, outdoor, room][rng.choice(3, p=[0.3, 0.4, 0.3])](library, frames, rng)
    for _ in range(int(rng.integers(1, 4))):
        at = shot.target + rng.normal(0, 0.4 * shot.size, 3) + (0, 0, 0.4 * shot.size)
        sheet = parts.sheet(rng, shot.size * rng.uniform(0.5, 1.6), parts.thin_material(rng))
        sheet.matrix_world = (Matrix.Translation(Vector(at))
                              @ Matrix.Rotation(rng.uniform(0, 6.3), 4, "Z"))
        if rng.random() < 0.7:
            parts.move_thing(sheet, 0.3 * shot.size, frames, rng)
    if rng.random() < 0.6:
        parts.lamp("SUN",
                   Matrix.Rotation(rng.uniform(0.6, 1.4), 4, Vector((*rng.normal(size=2), 0))),
                   rng.uniform(1, 8), 0.02)
    return shot


SETTINGS = {
    "fog": fog, "indirect": indirect, "foliage": foliage, "fur": fur, "glass": glass,
    "dof": out_of_focus, "motion_blur": fast_things, "interior": interior, "outdoor": outdoor,
    "product": studio, "text": text,
    "water": water, "snow": snow, "lamps": lamps, "fire": fire, "cloth": cloth,
}
