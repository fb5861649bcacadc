"""What is the hit distance of reflections worth? A camera that passes over a polished floor, with it and without.

python -m training.reflection_study [--floor chrome|black|wood] [--roughness 0.1] [--model s,m]

Renders the room of samples/room with another floor: 8 frames of 240x135, 2 samples a pixel through one jittered
position, and references of two of them at twice the size; minutes on a CPU. Prints PSNR of the floor and of the rest:
with the plane `specular_hit_distance`, without it, and with the history dropped at every frame.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Iterator
from dataclasses import replace

import drjit as dr
import mitsuba as mi
import numpy as np

from postfx.frame import Frame, Role

FOV = 70.0
FAR = 1e10
FLOOR = 1e-2
"""Height below which a first hit is on the floor, metres."""


def arguments(argv: list[str] | None = None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--floor", default="chrome", choices=("chrome", "black", "wood"))
    parser.add_argument("--roughness", type=float, default=0.1)
    parser.add_argument("--model", default="s,m", help="tags of networks, comma-separated")
    parser.add_argument("--size", type=lambda text: tuple(map(int, text.split("x"))), default=(240, 135))
    parser.add_argument("--frames", type=int, default=8)
    parser.add_argument("--judged", type=int, nargs="+", default=[5, 7], help="frames that are compared, from 0")
    parser.add_argument("--spp", type=int, default=2)
    parser.add_argument("--reference-spp", type=int, default=48)
    parser.add_argument("--variant", default="llvm_ad_rgb", help="Mitsuba variant")
    return parser.parse_args(argv)


class Shot:
    """The room, its camera and how it is sampled."""

    def __init__(self, args: argparse.Namespace) -> None:
        from training.sampling import Style, radical_inverse
        from training.scenes.build import BuiltScene
        from training.scenes.materials import METALS, Material
        from training.scenes.sample_room import sample_room
        from training.tracing import Tracer

        room, (eta, k) = sample_room(), METALS["chrome"]
        alpha = args.roughness**2
        room.materials[0] = {
            "chrome": Material("roughconductor", alpha=alpha, eta=eta, k=k),
            "black": Material("roughplastic", np.full((1, 1, 3), 0.015, np.float32), alpha),
            "wood": replace(room.materials[0], alpha=alpha)}[args.floor]
        halton = [[radical_inverse(t + 1, base) for base in (2, 3)] for t in range(args.frames)]
        self.style, self.size = Style("realtime", args.spp, np.array(halton, np.float32) - 0.5), args.size
        self._tracer, self._built, self._rng = Tracer(4), BuiltScene(room), np.random.default_rng(1)

    def camera(self, t: int):
        from training.scenes.motion import Camera, look_at

        eye = np.array([-0.9 + 0.05 * t, 0.75, 2.4])
        return Camera(look_at(eye, eye + np.array([0.15, -0.32, -1.0])), FOV)

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
        header = frame_header(camera.to_world, FOV, self.style.jitter[t], self.style.spp, 1.0, t == 0)
        return Frame(planes, t, tuple(self.style.jitter[t]), reset=t == 0, samples=self.style.spp, fov_x=FOV,
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
        from training.factory import _film
        from training.tracing import _properties, _rays

        (width, height), spp, random = self.size, self.style.spp, np.random.default_rng(100 + t)
        film = _film(self.size, self.style.offsets(t, width * height, random))
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
    references = {t: shot.reference(t, args.reference_spp) for t in args.judged}
    exposure = exposure_of(np.stack([frame[Role.COLOUR] for frame in frames]))
    floor = {t: shot.on_floor(frames[t]).repeat(2, 0).repeat(2, 1) for t in args.judged}
    for model in args.model.split(","):
        for name, pictures in results(frames, model, exposure):
            squares = {t: (shown(pictures[t], exposure) - shown(references[t], exposure)) ** 2 for t in args.judged}
            there = np.mean([squares[t][floor[t]].mean() for t in args.judged])
            rest = np.mean([squares[t][~floor[t]].mean() for t in args.judged])
            print(f"{model:3} {name:13} floor {-10 * math.log10(there):.2f} dB, rest {-10 * math.log10(rest):.2f} dB")


if __name__ == "__main__":
    main()
