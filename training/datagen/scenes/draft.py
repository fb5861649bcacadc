"""Drafts of scenes: the parts that procedural scenes share, such as a pool of materials, placed and
moving things; and the choice of a view that shows something, of its brightness and of the camera's
speed.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import mitsuba as mi
import numpy as np

from training.datagen.scenes import foliage, furniture, lights, meshes, textures
from training.datagen.scenes.build import BuiltScene, Description
from training.datagen.scenes.materials import Material, polished_metal, random_material
from training.datagen.scenes.motion import (
    Camera,
    CameraPath,
    object_path,
    random_bend,
    target_speed,
)
from training.datagen.tracing import MISS_DEPTH, Film, Tracer

View = tuple[np.ndarray, np.ndarray]


@dataclass
class Draft:
    """A scene and how to draw a view of it: (eye, target)."""

    description: Description
    view: Callable[[np.random.Generator], View]
    near: float = 0.3


class Pool:
    """A few materials shared by many things, so that a scene stays a few shapes."""

    def __init__(self, d: Description, rng: np.random.Generator, count: int,
                 **chances: float) -> None:
        self.indices = [d.material(random_material(rng, **chances)) for _ in range(count)]
        self.rng = rng

    def slots(self) -> dict[str, int]:
        names = ("main", "second", "third", "leaf")
        return {name: int(self.rng.choice(self.indices)) for name in names}


def draft_thing(rng: np.random.Generator,
                kinds: tuple[Any, ...] = furniture.OBJECTS) -> furniture.Thing:
    """Mostly one of `kinds`, at times a plant of many leaves or something thin."""
    pick = rng.random()
    return furniture.pick(rng,
                          foliage.FOLIAGE if pick < 0.1 else foliage.THIN if pick < 0.2 else kinds)


def place(d: Description, thing: furniture.Thing, slots: dict[str, int], matrix: np.ndarray,
          uv: float, bend: int | None = None) -> None:
    for mesh, slot in thing:
        d.add(mesh.transform(matrix).scaled_uvs(uv), slots[slot], bend=bend)


def fine(thing: furniture.Thing) -> bool:
    """Whether a thing has enough vertices to bend."""
    return sum(len(mesh.vertices) for mesh, _ in thing) > 300


def moving_thing(d: Description, rng: np.random.Generator, thing: furniture.Thing,
                 slots: dict[str, int], home: np.ndarray, uv: float, metre: float = 1.0) -> None:
    """Add a thing that slides, turns or tumbles, and may bend; some are of polished metal.

    Speeds are from slow to fast, in metres and radians a frame.
    """
    height = max(mesh.vertices[:, 1].max() for mesh, _ in thing)
    kind = rng.choice(["slide", "turn", "tumble", "both"])
    if rng.random() < 0.2:
        shiny, kind = d.material(polished_metal(rng)), rng.choice(["turn", "tumble"])
        slots = {name: shiny for name in slots}
    speed = 0.02 * metre * np.exp(rng.normal(0, 0.9)) * (kind in ("slide", "both", "tumble"))
    spin = float(np.clip(rng.normal(0, 0.12), -0.4, 0.4)) * (kind != "slide")
    heading = rng.uniform(0, 2 * np.pi)
    velocity = speed * np.array([np.cos(heading), 0, np.sin(heading)])
    axis = rng.normal(0, 1, 3) if kind == "tumble" else np.array([0.0, 1, 0])
    lift = 0.5 * height
    raised = home + np.array([0, lift + (0.5 * height if kind == "tumble" else 0.0), 0])
    d.movers.append(object_path(raised, velocity, axis, spin))
    mover, bend = len(d.movers) - 1, None
    if fine(thing) and rng.random() < 0.35:
        d.bends.append(random_bend(rng, np.array([0, -lift, 0]), height,
                                   any(slot == "leaf" for _, slot in thing)))
        bend = len(d.bends) - 1
    for mesh, slot in thing:
        d.add(mesh.transform(meshes.translation(0, -lift, 0)).scaled_uvs(uv), slots[slot], mover,
              bend)


def add_glowing(d: Description, rng: np.random.Generator, home: np.ndarray, power: float) -> None:
    """Add a thing that gives light, like a neon sign or a paper lamp; at times it moves."""
    things = (furniture.ball, furniture.ring, furniture.ring, furniture.lump, furniture.pillar)
    thing = furniture.resize(furniture.pick(rng, things), rng.uniform(0.2, 0.7))
    mesh = meshes.merge([mesh for mesh, _ in thing])
    mover, matrix = None, meshes.translation(*home)
    if rng.random() < 0.4:
        d.movers.append(object_path(home, rng.normal(0, 0.03, 3) * [1, 0.3, 1], rng.normal(0, 1, 3),
                                    0.1))
        mover, matrix = len(d.movers) - 1, np.eye(4)
    d.emit(mesh.transform(matrix), lights.tint(rng, 0.6) * power, mover)


def add_moving(d: Description, rng: np.random.Generator, home: np.ndarray, metre: float) -> None:
    """Add a random moving thing with materials of its own; `metre` is the length of a metre in the
    scene's units."""
    pool = Pool(d, rng, 2, gloss=0.4, metal=0.3)
    thing = furniture.resize(furniture.pick(rng), metre * rng.uniform(0.3, 0.9))
    moving_thing(d, rng, thing, pool.slots(), home, float(rng.choice([1, 3])) / metre, metre)


def surface(rng: np.random.Generator, gloss: float) -> Material:
    """A wall or floor: textured, never metal."""
    albedo = textures.wood(rng) if rng.random() < 0.3 else textures.texture(rng, flat=0.3)
    if rng.random() < gloss:
        return Material("roughplastic", albedo, float(rng.uniform(0.2, 0.6) ** 2))
    return Material("diffuse", albedo)


# The choice of a view.

GRID, PROBE_SPP = 24, 16
LUMINANCE = np.array([0.2126, 0.7152, 0.0722])


@dataclass(frozen=True)
class Probe:
    """A coarse look: mean luminance and its variance a sample, depth, albedo, normal and hit points
    (G*G, ...)."""

    luminance: np.ndarray
    variance: np.ndarray
    depth: np.ndarray
    albedo: np.ndarray
    normal: np.ndarray
    points: np.ndarray

    @property
    def hits(self) -> np.ndarray:
        return self.depth < MISS_DEPTH / 2

    def problem(self, near: float) -> str | None:
        """Why the view is unusable, or None."""
        if self.hits.mean() < 0.4:
            return "mostly sky"
        if np.percentile(self.depth, 4) < near:
            return "too near a surface"
        mean = self.luminance.mean()
        if not np.isfinite(mean) or mean <= 1e-9:
            return "black"
        if (self.luminance < 0.003 * mean).mean() > 0.5:
            return "mostly black"
        return "nothing to see" if self.edges() < 0.08 else None

    def edges(self) -> float:
        """Part of the grid's neighbours that differ by 15 % in depth or by 37 degrees in normal."""
        depth, normal = self.depth.reshape(GRID, GRID), self.normal.reshape(GRID, GRID, 3)
        total = 0.0
        for axis in (0, 1):
            near, far = (np.take(depth, range(k, GRID - 1 + k), axis) for k in (0, 1))
            bend = (np.take(normal, range(GRID - 1), axis)
                    * np.take(normal, range(1, GRID), axis)).sum(-1)
            bent = (bend < 0.8) & (near < MISS_DEPTH / 2)
            total += np.mean((np.abs(near - far) > 0.15 * np.minimum(near, far)) | bent)
        return float(total / 2)

    def level(self) -> float:
        """Geometric mean of the luminance, raised to a thousandth of its mean at least; without a
        black background."""
        seen = self.luminance[self.hits | (self.luminance > 0)]
        return float(np.exp(np.log(np.maximum(seen, 1e-3 * seen.mean() + 1e-12)).mean()))

    def gain(self, rng: np.random.Generator) -> float:
        """Factor that brings `level` to a random one: median 0.2, mostly 0.07 to 0.6."""
        return float(0.2 * np.exp(rng.normal(0, 0.6)) / self.level())

    def samples_for(self, error: float, gain: float) -> float:
        """Samples a pixel for a root mean square error of `error` after the gain and x/(1+x), 0..1.

        Variance is carried through the curve by its slope, gain / (1 + gain x)^2.
        """
        slope = gain / (1 + gain * self.luminance) ** 2
        return float(np.minimum(self.variance * slope**2, 4.0).mean() / error**2)


def probe(tracer: Tracer, built: BuiltScene, camera: Camera, seed: int) -> Probe:
    centres = (np.arange(GRID) + 0.5) / GRID
    u, v = (g.ravel().astype(np.float32) for g in np.meshgrid(centres, centres))
    planes = tracer.planes(built, camera, camera, (GRID, GRID), Film(mi.Float(u), mi.Float(v)))
    film = Film(mi.Float(np.repeat(u, PROBE_SPP)), mi.Float(np.repeat(v, PROBE_SPP)))
    colour = tracer.radiance(built.scene, camera, 1.0, film, seed).numpy().T
    samples = (colour @ LUMINANCE).reshape(-1, PROBE_SPP)
    tangent = np.tan(np.radians(camera.fov) / 2)
    local = np.stack([(1 - 2 * u) * tangent, (1 - 2 * v) * tangent, np.ones_like(u)],
                     1) * planes["depth"][:, None]
    points = local @ camera.to_world[:3, :3].T + camera.to_world[:3, 3]
    albedo = planes["diffuse_albedo"] + planes["specular_albedo"]
    return Probe(samples.mean(1), samples.var(1, ddof=1), planes["depth"], albedo, planes["normal"],
                 points)


def image_speed(path: CameraPath, points: np.ndarray, width: int) -> float:
    """Median motion of world points on a square image of `width` pixels, pixels a frame, over three
    steps."""
    steps = []
    for frame in (1, 3, 5):
        now, later = (path.at(frame + k).project(points, width, width) for k in (0, 1))
        steps.append(np.nanmedian(np.linalg.norm(later - now, axis=1)))
    return float(np.nanmean(steps))


def choose_path(tracer: Tracer, built: BuiltScene, view: Callable[..., Any],
                rng: np.random.Generator, width: int,
                near: float = 0.3, attempts: int = 8) -> tuple[CameraPath, float, Probe] | None:
    """A camera path, the gain for its frames and a probe from it, or None if no drawn view is
    usable."""
    for _ in range(attempts):
        eye, target = view(rng)
        movers = built.description.movers
        if movers and rng.random() < 0.6:
            target = movers[int(rng.integers(len(movers)))](3.5)[:3, 3]
        fov = float(rng.uniform(35, 80))
        kind, direction = str(rng.choice(CameraPath.KINDS)), rng.uniform(-1, 1, 3)
        path = CameraPath(eye, target, fov, kind, 0.0, direction, int(rng.integers(1 << 30)))
        distance = float(np.linalg.norm(target - eye))
        path = replace(path, aperture=built.description.lens[0] * distance,
                       focus=built.description.lens[1] * distance)
        if np.linalg.norm((target - eye)[[0, 2]]) < 0.3:
            continue
        look = probe(tracer, built, path.at(0), int(rng.integers(1 << 31)))
        if look.problem(near):
            continue
        if rng.random() < 0.15:
            return path, look.gain(rng), look
        speed = image_speed(replace(path, amplitude=1.0), look.points[look.hits], width)
        moving = replace(path,
                         amplitude=float(np.clip(target_speed(rng) / max(speed, 1e-3), 0.01, 25.0)))
        ends = [probe(tracer, built, moving.at(frame), int(rng.integers(1 << 31)))
                for frame in (0, 7)]
        steady = all(0.1 < end.level() / look.level() < 10 for end in ends)
        if steady and not any(end.problem(0.5 * near) for end in ends):
            return moving, look.gain(rng), look
    return None
