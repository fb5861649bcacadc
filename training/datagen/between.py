"""Render the eight sequences by which frames between frames are judged: what is hard about them,
and nothing else.

    python -m training.datagen.between --out DIR [--only NAME,NAME] [--variant llvm_ad_rgb] \\
        [--samples 144] [--frames 9]

Each becomes a folder that samples/between_frames.py reads: reference.####.exr, the pictures, and
noisy.####.exr, the same pictures with motion, depth, normals and hit distances of one ray a pixel.
Planes are of solid surfaces; what moves in a way that renderers have no vectors for (shadows,
reflections, sparks, what glass shows) has none here.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np

from postfx.frame import DEPTH_MISS, Frame, Role
from postfx.integrate import rigid_previous_positions, write_planes
from training.datagen.variant import use_variant

WIDTH = 320
HEIGHT = 180
FOV = 55.0
"""Horizontal field of view in degrees."""
LIGHT_SAMPLES = 8
"""Samples of emitters at each shading point."""
Thing = tuple[dict[str, Any], np.ndarray]
"""A shape's description without its place, and its transform to the world (4, 4), column
vectors."""


@dataclass
class Moment:
    """A scene at a time.

    Attributes:
        eye, target: of the camera.
        things: by name; those whose name ends in '*' are not in the planes.
        lights: emitters, by name.
    """

    eye: np.ndarray
    target: np.ndarray
    things: dict[str, Thing]
    lights: dict[str, dict[str, Any]] = field(default_factory=dict)


# Things -------------------------------------------------------------------------------------------


def place(*at: float, scale: tuple[float, ...] = (1, 1, 1), axis: tuple[float, ...] = (0, 1, 0),
          turn: float = 0) -> np.ndarray:
    """Scaled, turned by degrees about an axis, and put somewhere."""
    x, y, z = np.array(axis, float) / np.linalg.norm(axis)
    cross, angle = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]]), np.radians(turn)
    matrix = np.eye(4)
    matrix[:3, :3] = ((np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross)
                      @ np.diag(scale))
    matrix[:3, 3] = at
    return matrix


def spotted(seed: int, size: int = 256, tint: tuple[float, ...] = (1, 1, 1)) -> dict[str, Any]:
    """A rough surface with detail of all sizes."""
    rng = np.random.default_rng(seed)
    levels = [np.kron(rng.random((2**k, 2**k, 3)), np.ones((size >> k, size >> k, 1)))
              for k in range(2, 8)]
    picture = np.mean(levels, 0)
    picture = ((picture - picture.min()) / np.ptp(picture)) ** 1.5 * tint
    return {"type": "diffuse", "reflectance": {"type": "bitmap",
                                               "bitmap": mi.Bitmap(picture.astype(np.float32)),
                                               "raw": True, "filter_type": "bilinear"}}


def plain(*colour: float) -> dict[str, Any]:
    return {"type": "diffuse", "reflectance": {"type": "rgb", "value": list(colour)}}


MIRROR = {"type": "conductor", "material": "Al"}


def shape(kind: str, material: dict[str, Any], **more: Any) -> dict[str, Any]:
    return {"type": kind, "bsdf": material if material["type"] == "thindielectric" else
            {"type": "twosided", "bsdf": material}, **more}


def room(seed: int = 1) -> dict[str, Thing]:
    """A floor and a wall behind it."""
    return {"floor": (shape("rectangle", spotted(seed, tint=(0.9, 0.7, 0.5))),
                      place(0, 0, 0, scale=(8, 8, 1), axis=(1, 0, 0), turn=-90)),
            "wall": (shape("rectangle", spotted(seed + 1, tint=(0.6, 0.8, 0.9))),
                     place(0, 3, -4, scale=(8, 4, 1)))}


SKY = {"sky": {"type": "constant", "radiance": {"type": "rgb", "value": [0.7, 0.8, 1.0]}}}


def sun(x: float = 3.0, y: float = 6.0, z: float = 4.0) -> dict[str, Any]:
    """A ball of light that casts shadows with soft edges."""
    return {"sun": {"type": "sphere", "center": [x, y, z], "radius": 0.4, "emitter": {
        "type": "area", "radiance": {"type": "rgb", "value": [90, 80, 65]}}}}


EYE, TARGET = np.array([0, 1.6, 5.0]), np.array([0, 1.2, 0])


# Sequences ----------------------------------------------------------------------------------------


def spin(t: float) -> Moment:
    """Fast rotation: a wheel that turns by 24 degrees a frame, a box by 18."""
    wheel = shape("disk", spotted(5))
    return Moment(EYE, TARGET, room() | {
        "wheel": (wheel, place(-1.3, 1.4, 0.5, scale=(1.2, 1.2, 1), axis=(0, 0, 1), turn=24 * t)),
        "box": (shape("cube", spotted(7)), place(1.5, 1.2, 0, scale=(0.6, 0.6, 0.6),
                                                 axis=(1, 2, 0.5), turn=18 * t))}, SKY | sun())


def wires(t: float) -> Moment:
    """Thin things: bars of one to two pixels in front of a wall, from a camera that moves
    sideways."""
    move = np.array([0.16 * t, 0, 0])
    bars = {f"bar{k}": (shape("cylinder", plain(0.1, 0.1, 0.12), radius=0.012 + 0.004 * (k % 3),
                              p0=[0, 0, 0], p1=[0, 3, 0]),
                        place(-3 + 0.35 * k, 0, 1.0 + 0.3 * (k % 2), axis=(0, 0, 1),
                              turn=4 * (k % 5) - 8))
            for k in range(18)}
    return Moment(EYE + move, TARGET + move, room(11) | bars, SKY | sun())


def foliage(t: float) -> Moment:
    """Some 160 leaves that sway, each by itself."""
    rng, leaves = np.random.default_rng(21), {}
    for k in range(160):
        at = rng.uniform((-2.2, 0.3, -1), (2.2, 2.6, 1.6))
        turn = rng.uniform(0, 360)
        phase = rng.uniform(0, 6.3)
        green = plain(*(rng.uniform(0.5, 1) * np.array([0.15, 0.45, 0.08])))
        sway = at + 0.05 * np.array([np.sin(0.9 * t + phase), 0.3 * np.cos(1.1 * t + phase), 0])
        leaves[f"leaf{k}"] = (shape("disk", green),
                              place(*sway, scale=(0.09, 0.2, 1), axis=tuple(rng.normal(size=3)),
                                    turn=turn + 14 * np.sin(0.8 * t + phase)))
    move = np.array([0.05 * t, 0, 0])
    return Moment(EYE + move, TARGET, room(23) | leaves, SKY | sun())


def mirror(t: float) -> Moment:
    """A mirror wall and a metal ball, from a moving camera; what moves before them is seen in
    them."""
    move = np.array([0.14 * t - 0.5, 0.03 * t, 0])
    return Moment(EYE + move, TARGET, room(31) | {
        "mirror": (shape("rectangle", MIRROR),
                   place(-0.6, 1.6, -2.5, scale=(2.2, 1.4, 1), turn=14)),
        "ball": (shape("sphere", MIRROR), place(1.7, 0.8, 0.2, scale=(0.8, 0.8, 0.8))),
        "red": (shape("cube", spotted(35, tint=(1, 0.3, 0.2))),
                place(-1.8 + 0.14 * t, 0.5, 1.2, scale=(0.35, 0.35, 0.35), turn=6 * t)),
        "behind": (shape("rectangle", spotted(37)), place(0, 3, 8, scale=(8, 4, 1), turn=180))},
                  SKY)


def sparks(t: float) -> Moment:
    """Glowing particles without vectors, in an arc over the scene."""
    rng, glow = np.random.default_rng(41), {}
    for k in range(60):
        age, speed = t - rng.uniform(-9, 9), rng.uniform((-0.1, 0.05, -0.05), (0.1, 0.15, 0.05))
        at = np.array([0, 1.0, 0.8]) + speed * age - np.array([0, 0.005 * age * age, 0])
        light = {"type": "area", "radiance": {"type": "rgb", "value": [60, 25, 6]},
                 "sampling_weight": 0}
        glow[f"spark{k}*"] = (shape("sphere", plain(0, 0, 0), emitter=light),
                              place(*at, scale=(0.025,) * 3))
    return Moment(EYE, TARGET, room(43) | glow, SKY)


def shake(t: float) -> Moment:
    """A camera held by a hand that shakes, some eight times in three seconds, in a room with things
    in it."""
    rng = np.random.default_rng(51)
    swings = np.sin(2 * np.pi * t / rng.uniform(6, 12, (3, 6)) + rng.uniform(0, 6.3, (3, 6))).sum(0)
    jolts = swings * (0.04, 0.04, 0.02, 0.08, 0.08, 0.05)
    things = {f"box{k}": (shape("cube", spotted(53 + k)),
                          place(-2 + 1.3 * k, 0.4, 0.8 * (k % 2), scale=(0.4,) * 3, turn=20 * k))
              for k in range(4)}
    return Moment(EYE + jolts[:3], TARGET + jolts[3:], room(59) | things, SKY | sun())


def crossing(t: float) -> Moment:
    """Balls that pass each other, by up to 18 pixels a frame: much is hidden and shown again."""
    balls = {}
    for k, side in enumerate((1, -1, 1, -1)):
        at = side * (0.22 + 0.05 * k) * (t - 4), 0.5 + 0.55 * k, 1.4 - 0.5 * k
        balls[f"ball{k}"] = shape("sphere", spotted(61 + k)), place(*at, scale=(0.45,) * 3,
                                                                    turn=5 * t * side)
    return Moment(EYE, TARGET, room(67) | balls, SKY | sun())


def shadows(t: float) -> Moment:
    """A light that moves, shadows that move with it, and a pane of glass; nothing else does."""
    posts = {f"post{k}": (shape("cylinder", spotted(71 + k), radius=0.12, p0=[0, 0, 0],
                                p1=[0, 1.8, 0]),
                          place(-2 + 0.9 * k, 0, 0.6 - 0.5 * (k % 2))) for k in range(5)}
    pane = {"pane": (shape("rectangle", {"type": "thindielectric"}),
                     place(0.9, 1.2, 2.2, scale=(0.9, 0.9, 1), turn=20))}
    return Moment(EYE, TARGET, room(79) | posts | pane, {"sky": {"type": "constant", "radiance": {
        "type": "rgb", "value": [0.1, 0.12, 0.15]}}} | sun(-3 + 0.45 * t, 4, 3))


SEQUENCES: dict[str, Callable[[float], Moment]] = {one.__name__: one for one in (
    spin, wires, foliage, mirror, sparks, shake, crossing, shadows)}


# Frames -------------------------------------------------------------------------------------------


def camera(moment: Moment) -> np.ndarray:
    """Camera to world (4, 4), column vectors: x to the left, y up, z ahead, as Mitsuba has it."""
    return np.array(mi.ScalarTransform4f().look_at(list(moment.eye), list(moment.target), [0, 1, 0])
                    .matrix, float)


def shows_others(moment: Moment) -> bool:
    """Whether there are mirrors or panes of glass, which take longer paths and more samples."""
    return (any(thing["bsdf"]["type"] == "thindielectric" for thing, _ in moment.things.values()) or
        bool(mirrors_of(moment)))


def mirrors_of(moment: Moment) -> set[str]:
    """Names of things that are mirrors."""
    return {name
            for name, (thing, _) in moment.things.items() if thing["bsdf"].get("bsdf") is MIRROR}


def load(moment: Moment, in_planes: bool) -> tuple[Any, list[str]]:
    """Mitsuba's scene, and the names of its things in the order of their ids."""
    things = {name.rstrip("*"): thing for name, thing in moment.things.items()
              if not (in_planes and name.endswith("*"))}
    shapes = {name: {**description, "to_world": mi.ScalarTransform4f(matrix)}
              for name, (description, matrix) in things.items()}
    sensor = {"type": "perspective", "fov": FOV, "fov_axis": "x",
              "to_world": mi.ScalarTransform4f(camera(moment)),
              "film": {"type": "hdrfilm", "width": WIDTH, "height": HEIGHT,
                       "rfilter": {"type": "box"},
                       "pixel_format": "rgb", "component_format": "float32"},
              "sampler": {"type": "multijitter"}}  # even over a pixel: a hundredth of the noise
    # direct light alone has little noise; mirrors and glass show more than that
    integrator = {"type": "path", "max_depth": 3} if shows_others(moment) else \
        {"type": "direct", "emitter_samples": LIGHT_SAMPLES, "bsdf_samples": 0}
    return mi.load_dict({"type": "scene", "integrator": integrator, "sensor": sensor, **shapes,
                         **moment.lights}), list(things)


def seen_at(points: np.ndarray, moment: Moment) -> np.ndarray:
    """Places (..., 2) in the picture, in pixels, of points (..., 4) in the world or directions,
    whose last is 0."""
    x, y, z = np.moveaxis(points @ np.linalg.inv(camera(moment)).T, -1, 0)[:3]
    far = WIDTH / 2 / np.tan(np.radians(FOV / 2))
    z = np.maximum(z, 1e-3)
    return np.stack([WIDTH / 2 - far * x / z, HEIGHT / 2 - far * y / z], -1)


def planes_of(moment: Moment, before: Moment) -> dict[Role, np.ndarray]:
    """Motion, depth, normals and the distance to what a mirror shows, through the middles of
    pixels."""
    import drjit as dr

    scene, names = load(moment, in_planes=True)
    y, x = np.indices((HEIGHT, WIDTH))
    ray, _ = scene.sensors()[0].sample_ray(0, 0, mi.Point2f((x.ravel() + 0.5) / WIDTH,
                                                            (y.ravel() + 0.5) / HEIGHT),
                                           mi.Point2f(0.5))
    si = scene.ray_intersect(ray)
    hit = np.array(si.is_valid()).reshape(HEIGHT, WIDTH)
    first = [int(np.array(dr.reinterpret_array(mi.UInt32, mi.ShapePtr(one)))[0])
             for one in scene.shapes()]
    known = {number: one.id() for number, one in zip(first, scene.shapes(), strict=True)}
    ids = np.array(dr.reinterpret_array(mi.UInt32, si.shape)).reshape(HEIGHT, WIDTH)
    points = np.array(si.p, float).T.reshape(HEIGHT, WIDTH, 3)
    rays = np.array(ray.d, float).T.reshape(HEIGHT, WIDTH, 3)
    now, then = ({number: one.things[name][1].T for number, name in known.items() if name in names}
                 for one in (moment, before))
    earlier = rigid_previous_positions(points, np.where(hit, ids, -1), now, then)
    previous = np.concatenate([np.where(hit[..., None], earlier, rays), hit[..., None]], -1)
    here = np.stack([x + 0.5, y + 0.5], -1)
    ahead = camera(moment)[:3, 2]
    depth = np.where(hit, (points - moment.eye) @ ahead, DEPTH_MISS)[..., None]
    normal = np.array(si.sh_frame.n, float).T.reshape(HEIGHT, WIDTH, 3) * hit[..., None]
    normal *= np.where((normal * rays).sum(-1, keepdims=True) > 0, -1, 1)
    planes = {Role.MOTION: seen_at(previous, before) - here, Role.DEPTH: depth, Role.NORMAL: normal}
    mirrors = [number for number, name in known.items() if name in mirrors_of(moment)]
    if mirrors:
        onward = rays - 2 * (rays * normal).sum(-1, keepdims=True) * normal
        start = points + 1e-3 * normal
        seen = scene.ray_intersect(mi.Ray3f(mi.Point3f(*np.moveaxis(start, -1, 0).reshape(3, -1)),
                                            mi.Vector3f(*np.moveaxis(onward, -1, 0)
                                                        .reshape(3, -1))))
        length = np.where(np.array(seen.is_valid()), np.array(seen.t),
                          DEPTH_MISS).reshape(HEIGHT, WIDTH)
        planes[Role.SPECULAR_HIT_DISTANCE] = np.where(np.isin(ids, mirrors) & hit, length,
                                                      0)[..., None]
    return {role: plane.astype(np.float32) for role, plane in planes.items()}


def render(folder: Path, sequence: Callable[[float], Moment], frames: int, samples: int) -> None:
    """Write the frames that are not there yet."""
    folder.mkdir(parents=True, exist_ok=True)
    for number in range(1, frames + 1):
        if (folder / f"noisy.{number:04d}.exr").exists():
            continue
        moment, before = sequence(float(number)), sequence(float(number - 1))
        scene, _ = load(moment, in_planes=False)
        count = 4 * samples if shows_others(moment) else samples
        colour = np.array(mi.render(scene, spp=count, seed=number), np.float32)
        planes = planes_of(moment, before)
        write_planes(folder / f"reference.{number:04d}.exr",
                     Frame({Role.COLOUR: colour}, number=number))
        write_planes(folder / f"noisy.{number:04d}.exr",
                     Frame({Role.COLOUR: colour, **planes}, number=number, fov_x=FOV))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True,
                        help="folder for a folder of each sequence")
    parser.add_argument("--only", help="these sequences, comma-separated")
    parser.add_argument("--variant", default="llvm_ad_rgb", help="Mitsuba variant")
    parser.add_argument("--samples", type=int, default=144,
                        help="a pixel; four times as many with mirrors or glass")
    parser.add_argument("--frames", type=int, default=9)
    arguments = parser.parse_args()
    use_variant(arguments.variant)
    for name in arguments.only.split(",") if arguments.only else SEQUENCES:
        render(arguments.out / name, SEQUENCES[name], arguments.frames, arguments.samples)


if __name__ == "__main__":
    main()
