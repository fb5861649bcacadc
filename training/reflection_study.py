"""What is the hit distance of reflections worth? A camera that passes by polished things, with it and without.

python -m training.reflection_study [--floor chrome|black|wood] [--wall] [--model s,m]
python -m training.reflection_study --drafted 5 --judged 1 2 3 4 5 6 7

Renders the room of samples/room with another floor or wall, or a scene as clips for training are drafted, by its seed,
with whatever it holds: 8 frames of 240x135, 2 samples a pixel through one jittered position, and references of some of
them at twice the size; minutes on a CPU. Prints PSNR and flicker of the floor, or of what is smooth and reflects more
than it scatters, and PSNR of the rest: with the plane `specular_hit_distance`, without it, and with the history dropped
at every frame. Flicker is that of frames whose predecessor is judged, too.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import TYPE_CHECKING

import drjit as dr
import mitsuba as mi
import numpy as np

from postfx.frame import Frame, Role

if TYPE_CHECKING:
    from training.scenes.build import BuiltScene
    from training.scenes.motion import Camera
    from training.tracing import Tracer

Pictures = dict[int, np.ndarray]
FOV, WALL = 70.0, 2
FAR = 1e10
FLOOR = 1e-2
"""Height below which a first hit is on the floor, metres."""


def arguments(argv: list[str] | None = None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--floor", default="chrome", choices=("chrome", "black", "wood"))
    parser.add_argument("--wall", action="store_true", help="the material is that of the wall ahead, not of the floor")
    parser.add_argument("--roughness", type=float, default=0.1, help="of the floor or wall")
    parser.add_argument("--drafted", type=int, metavar="SEED", help="a drafted scene in place of the room")
    parser.add_argument("--model", default="s,m", help="tags of networks, comma-separated")
    parser.add_argument("--size", type=lambda text: tuple(map(int, text.split("x"))), default=(240, 135))
    parser.add_argument("--frames", type=int, default=8)
    parser.add_argument("--judged", type=int, nargs="+", default=[5, 7], help="frames that are compared, from 0")
    parser.add_argument("--spp", type=int, default=2)
    parser.add_argument("--reference-spp", type=int, default=48)
    parser.add_argument("--variant", default="llvm_ad_rgb", help="Mitsuba variant")
    return parser.parse_args(argv)


class Shot:
    """A scene, its camera and how it is sampled."""

    def __init__(self, args: argparse.Namespace) -> None:
        from training.sampling import Style, radical_inverse
        from training.tracing import Tracer

        halton = [[radical_inverse(t + 1, base) for base in (2, 3)] for t in range(args.frames)]
        self.style, self.size = Style("realtime", args.spp, np.array(halton, np.float32) - 0.5), args.size
        self._tracer, self._rng = Tracer(4), np.random.default_rng(1)
        self._built, self.camera = _room(args) if args.drafted is None else _drafted(args, self._tracer)
        self.judges = self.on_floor if args.drafted is None and not args.wall else reflecting

    def frame(self, t: int) -> Frame:
        """A noisy frame with its hit distances."""
        from training.factory import noisy_frame
        from training.to_exr import frame_header

        self._built.move(t, t - 1)
        camera = self.camera(t)
        values = noisy_frame(self._tracer, self._built, (camera, self.camera(t - 1)), self.size, self.style, t, 1.0,
                             self._rng)
        planes = {Role(name): np.asarray(plane) for name, plane in values.items()}
        planes[Role.SPECULAR_HIT_DISTANCE] = self._hit_distance(t)
        header = frame_header(camera.to_world, camera.fov, self.style.jitter[t], self.style.spp, 1.0, t == 0)
        return Frame(planes, t, tuple(self.style.jitter[t]), reset=t == 0, samples=self.style.spp, fov_x=camera.fov,
                     world_to_camera=header["worldToCamera"])

    def reference(self, t: int, spp: int) -> np.ndarray:
        """(2 h, 2 w, 3) without noise, or with little."""
        from training.sampling import filter_table

        self._built.move(t, t - 1)
        size = 2 * self.size[0], 2 * self.size[1]
        return self._tracer.reference(self._built.scene, self.camera(t), size, filter_table("box"), spp, 7 + t, 1 << 22)

    def on_floor(self, frame: Frame) -> np.ndarray:
        """(h, w): whether the first hit is on the floor."""
        from postfx.integrate import perspective, positions_from_depth

        lens = perspective(FOV, *self.size, right="-x", forward="+z")
        points = positions_from_depth(frame[Role.DEPTH], frame.world_to_camera @ lens, frame.jitter)
        return np.abs(points[..., 1]) < FLOOR

    def _hit_distance(self, t: int) -> np.ndarray:
        """(h, w, 1): harmonic mean of the way along one reflected ray a sample, its microfacet drawn from GGX."""
        from training.factory import film_of
        from training.tracing import _properties, _rays

        (width, height), spp, random = self.size, self.style.spp, np.random.default_rng(100 + t)
        film = film_of(self.size, self.style.offsets(t, width * height, random))
        ray = _rays(self.camera(t), width / height, film)
        si = self._built.scene.ray_intersect(ray)
        hit = si.is_valid()
        row = dr.select(hit, dr.reinterpret_array(mi.UInt32, si.shape), 0)
        alpha = dr.maximum(dr.square(_properties(self._built.properties, row, hit)[3]), 1e-4)
        normal = dr.select(dr.dot(si.sh_frame.n, ray.d) > 0, -si.sh_frame.n, si.sh_frame.n)
        drawn, turn = (mi.Float(random.random(width * height * spp, np.float32)) for _ in range(2))
        cosine = dr.sqrt((1 - drawn) / (1 + (alpha * alpha - 1) * drawn))
        sine = dr.sqrt(dr.maximum(0, 1 - cosine * cosine))
        facet = mi.Vector3f(sine * dr.cos(2 * dr.pi * turn), sine * dr.sin(2 * dr.pi * turn), cosine)
        facet = mi.Frame3f(normal).to_world(facet)
        way = ray.d - 2 * dr.dot(ray.d, facet) * facet
        seen = self._built.scene.ray_intersect(si.spawn_ray(way))
        near = dr.select(seen.is_valid(), dr.rcp(dr.maximum(seen.t, 1e-3)), 1 / FAR)
        used = hit & (dr.dot(way, normal) > 0)
        near, count = (np.array(each).reshape(height, width, spp).sum(-1)
                       for each in (dr.select(used, near, 0), dr.select(used, 1.0, 0.0)))
        return np.where(count > 0, count / np.maximum(near, 1 / FAR), 0)[..., None].astype(np.float32)


def _room(args: argparse.Namespace) -> tuple[BuiltScene, Callable[[int], Camera]]:
    """The room of samples/room with the floor or wall that was asked for, and a camera that passes by it."""
    from training.scenes.build import BuiltScene
    from training.scenes.materials import METALS, Material
    from training.scenes.motion import Camera, look_at
    from training.scenes.sample_room import sample_room

    room, (eta, k), alpha = sample_room(), METALS["chrome"], args.roughness**2
    room.materials[WALL if args.wall else 0] = {
        "chrome": Material("roughconductor", alpha=alpha, eta=eta, k=k),
        "black": Material("roughplastic", np.full((1, 1, 3), 0.015, np.float32), alpha),
        "wood": replace(room.materials[0], alpha=alpha)}[args.floor]

    height, rise = (1.7, 0.05) if args.wall else (0.75, -0.32)

    def camera(t: int) -> Camera:
        eye = np.array([-0.9 + 0.05 * t, height, 2.4])
        return Camera(look_at(eye, eye + np.array([0.15, rise, -1.0])), FOV)

    return BuiltScene(room), camera


def _drafted(args: argparse.Namespace, tracer: Tracer) -> tuple[BuiltScene, Callable[[int], Camera]]:
    """A scene and a camera path as clips for training have them; ValueError where the seed gives no view of use."""
    from training.scenes.build import BuiltScene
    from training.scenes.lights import Environments
    from training.scenes.procedural import draft
    from training.scenes.views import choose_path

    rng = np.random.default_rng(args.drafted)
    drafted = draft(rng, Environments(None))
    built = BuiltScene(drafted.description)
    built.move(3.5, 2.5)
    chosen = choose_path(tracer, built, drafted.view, rng, args.size[0], drafted.near)
    if chosen is None:
        raise ValueError(f"seed {args.drafted} gives no view of use")
    return built, chosen[0].at


def reflecting(frame: Frame) -> np.ndarray:
    """(h, w): whether a pixel is smooth, has a hit distance and reflects more than it scatters."""
    share = (frame[Role.SPECULAR_ALBEDO] - frame[Role.DIFFUSE_ALBEDO]).sum(-1)
    return (share > 0) & (frame[Role.ROUGHNESS][..., 0] <= 0.3) & (frame[Role.SPECULAR_HIT_DISTANCE][..., 0] > 0)


def results(frames: list[Frame], model: str, exposure: float) -> Iterator[tuple[str, list[np.ndarray]]]:
    """Pictures of all frames by method."""
    import postfx

    bare = [replace(frame, planes={role: plane for role, plane in frame.planes.items()
                                   if role is not Role.SPECULAR_HIT_DISTANCE}) for frame in frames]
    alone = [replace(frame, reset=True) for frame in bare]
    for name, some in (("hit distance", frames), ("without", bare), ("no history", alone)):
        pipeline = postfx.Pipeline([postfx.DenoiseUpscale(scale=2, model=model)], exposure=math.log2(exposure),
                                   cuts="none")
        yield name, [pipeline(frame)[Role.COLOUR] for frame in some]


def main(argv: list[str] | None = None) -> None:
    args = arguments(argv)
    mi.set_variant(args.variant)
    from postfx.bench.metrics import shown
    from training.clips import exposure_of

    shot = Shot(args)
    frames = [shot.frame(t) for t in range(args.frames)]
    exposure = exposure_of(np.stack([frame[Role.COLOUR] for frame in frames]))
    wanted = {t: shown(shot.reference(t, args.reference_spp), exposure) for t in args.judged}
    chosen = {t: shot.judges(frames[t]).repeat(2, 0).repeat(2, 1) for t in args.judged}
    print(f"{np.mean([*chosen.values()]):.1%} of the picture is judged")
    for model in args.model.split(","):
        for name, pictures in results(frames, model, exposure):
            made = {t: shown(pictures[t], exposure) for t in args.judged}
            there, rest = (_psnr(made, wanted, {t: mask == side for t, mask in chosen.items()}) for side in (1, 0))
            change = _flicker(made, wanted, chosen, frames)
            print(f"{model:3} {name:13} there {there:.2f} dB, flicker {change:.2f}; rest {rest:.2f} dB", flush=True)


def _psnr(made: Pictures, wanted: Pictures, masks: Pictures) -> float:
    return -10 * math.log10(np.mean([np.square(made[t] - wanted[t])[masks[t]].mean() for t in made]))


def _flicker(made: Pictures, wanted: Pictures, masks: Pictures, frames: list[Frame]) -> float:
    """1000 times the mean error of the change from frame to frame where masks are true, followed by the motion."""
    from postfx.bench.metrics import moved

    changes = []
    for t in sorted(made):
        if t - 1 in made:
            motion = 2 * frames[t][Role.MOTION].repeat(2, 0).repeat(2, 1)
            before = moved(made[t - 1] - wanted[t - 1], motion)
            changes.append(np.abs(made[t] - wanted[t] - before)[masks[t]].mean())
    return 1000 * float(np.mean(changes)) if changes else math.nan


if __name__ == "__main__":
    main()
