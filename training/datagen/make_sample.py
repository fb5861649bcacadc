"""Render the room of samples/room: its sequence with references, or views from all over it for
networks of one scene.

python -m training.datagen.make_sample frames OUT_FOLDER [--reference 1-8 [--reference-spp 192]] \\
    [--spp 4] [--orbit 2]
python -m training.datagen.make_sample views OUT_FOLDER [--views 1500] [--held-out 8] [--part 0/4]
    both [--variant llvm_ad_rgb | cuda_ad_rgb] [--width 320] [--height 180]

Real-time style: every sample of a frame goes through one jittered position (Halton 2,3), so planes
are point samples. References spread their samples over the pixel (box filter). Those of `frames`
have twice the size and the noisy frames' exposure.

`views` writes view.NNNN.npz to learn from and held.NNNN.npz to measure on, one a camera, each of
FRAMES moments while the camera and the wheel move: planes (FRAMES, H, W, C) of one sample a pixel,
and `camera` (FRAMES, 16), see `camera_vector`. Of the last moment there are `colour` (COLOURS, H,
W, 3), independent renders of one sample a pixel, and `reference_a`, `reference_b` (H, W, 3), the
halves of a reference. Held-out ones have more samples, planes and camera through PASSES further
positions in the pixel as `pass_` and their names, and some of them have `means` (P, H, W, 3) of the
first `counts` (P,) of a stack of independent one-sample images. Existing files are kept, and
several processes can share the work.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from fileseq.frameset import FrameSet

from postfx.colour.views import to_codes
from postfx.tools.bench.metrics import psnr
from training.datagen.variant import use_variant

if TYPE_CHECKING:
    from training.datagen.scenes.build import BuiltScene
    from training.datagen.scenes.motion import Camera
    from training.datagen.tracing import Tracer

# lossy, 47 dB PSNR: an error far below the noise; zip takes 2.7 times as much space
PACKED = "dwab:80"
FRAMES, COLOURS, PASSES = 4, 8, 4
HELD_OUT = 100_000  # seed of the first held-out view
FOV = 66.0
TOGETHER = 16  # one-sample images that are rendered in one go
CLOSEST = 0.4  # metres: views of which more than 4 % are closer are drawn anew


def main(argv: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(required=True)
    frames = commands.add_parser("frames", help="the sequence of samples/room")
    frames.add_argument("--spp", type=int, default=4)
    frames.add_argument("--frames", type=int, default=8)
    frames.add_argument("--reference", type=FrameSet, default=(), metavar="FRAMES",
                        help="such as 1-8 or 1,7,8")
    frames.add_argument("--reference-spp", type=int, default=192)
    frames.add_argument("--times", type=int, default=2,
                        help="size of the references over that of the frames")
    frames.add_argument("--orbit", type=float, default=0.0,
                        help="degrees a frame around the table; nothing else moves")
    frames.add_argument("--first", type=float, default=-40.0,
                        help="angle of the orbit's first frame")
    views = commands.add_parser("views", help="views from all over the room")
    views.add_argument("--views", type=int, default=1500, help="to learn from")
    views.add_argument("--spp", type=int, default=48, help="samples a pixel of their references")
    views.add_argument("--held-out", type=int, default=8)
    views.add_argument("--held-spp", type=int, default=2048)
    views.add_argument("--stacks", type=int, default=4,
                       help="held-out views with a stack of one-sample images")
    views.add_argument("--stack", type=int, default=1024,
                       help=f"images of a stack, a multiple of {TOGETHER}")
    views.add_argument("--part", default="0/1",
                       help="this process's part of the views, such as 0/4")
    views.add_argument("--seconds", type=float, default=1e9, help="begin no view after this time")
    for command, size, act in ((frames, (320, 180), make_frames), (views, (256, 144), make_views)):
        command.add_argument("out", type=Path)
        command.add_argument("--variant", default="llvm_ad_rgb", help="Mitsuba variant")
        command.add_argument("--width", type=int, default=size[0])
        command.add_argument("--height", type=int, default=size[1])
        command.set_defaults(act=act)
    args = parser.parse_args(argv)
    use_variant(args.variant)  # what is imported from here on uses Mitsuba's types
    args.out.mkdir(parents=True, exist_ok=True)
    args.act(args)


def make_frames(args: argparse.Namespace) -> None:
    """Write noisy.NNNN.exr and reference.NNNN.exr."""
    from training.datagen.clip import Style, filter_table, noisy_frame, radical_inverse
    from training.datagen.clip_file import CHANNELS, exposure_of, frame_header, write_exr
    from training.datagen.scenes.build import BuiltScene
    from training.datagen.scenes.room import orbiting_camera, sample_camera, sample_room
    from training.datagen.tracing import Tracer

    def camera_at(t: int) -> Camera:
        return orbiting_camera(args.first + t * args.orbit) if args.orbit else sample_camera(t)

    def moments(t: int) -> tuple[int, int]:
        return (0, 0) if args.orbit else (t, t - 1)

    tracer, built, rng = Tracer(), BuiltScene(sample_room()), np.random.default_rng(1)
    halton = [[radical_inverse(t + 1, 2), radical_inverse(t + 1, 3)] for t in range(args.frames)]
    style = Style("realtime", args.spp, np.array(halton, np.float32) - 0.5)
    size, frames = (args.width, args.height), []
    for t in range(args.frames):
        built.move(*moments(t))
        frames.append(noisy_frame(tracer, built, (camera_at(t), camera_at(t - 1)), size, style, t,
                                  1.0, rng))
    exposure = exposure_of(np.stack([frame["colour"] for frame in frames]))
    for t, frame in enumerate(frames):
        camera = camera_at(t)
        header = frame_header(camera.to_world, camera.fov, style.jitter[t], args.spp, exposure,
                              t == 0)
        write_exr(args.out / f"noisy.{t + 1:04d}.exr", {name: frame[name] for name in CHANNELS},
                  header)
    large = args.times * args.width, args.times * args.height
    table, half = filter_table("box"), (args.reference_spp + 1) // 2
    facts = {"postfx:exposure": exposure, "postfx:spp": 2 * half, "compression": PACKED}
    for t in (number - 1 for number in args.reference):
        built.move(*moments(t))

        def render(k: int, t: int = t) -> np.ndarray:
            return tracer.reference(built.scene, camera_at(t), large, table, half, 2 * t + k)

        halves = of_halves(render, exposure)
        write_exr(args.out / f"reference.{t + 1:04d}.exr", {"colour": (halves[0] + halves[1]) / 2},
                  facts)


def of_halves(render: Callable[[int], np.ndarray],
              exposure: float) -> tuple[np.ndarray, np.ndarray]:
    """The independent renders 0 and 1, (H, W, 3). Prints the noise of their mean, half their
    difference, as PSNR."""
    first, second = render(0), render(1)
    noise = psnr(to_codes(first, exposure), to_codes(second, exposure)) + 20 * np.log10(2)
    print(f"reference with noise of {noise:.1f} dB PSNR", flush=True)
    return first, second


def make_views(args: argparse.Namespace) -> None:
    """Write held.NNNN.npz and view.NNNN.npz, in this order."""
    from training.datagen.scenes.build import BuiltScene
    from training.datagen.scenes.room import sample_room
    from training.datagen.tracing import Tracer

    tracer, built, began = Tracer(), BuiltScene(sample_room()), time.monotonic()
    part, parts = (int(word) for word in args.part.split("/"))
    every = [(f"held.{k:04d}.npz", HELD_OUT + k, args.held_spp,
              args.stack if k < args.stacks else 0)
             for k in range(args.held_out)]
    every += [(f"view.{k:04d}.npz", k, args.spp, 0) for k in range(args.views)]
    for name, seed, spp, stack in every[part::parts]:
        path = args.out / name
        if not path.exists() and time.monotonic() - began < args.seconds:
            found: dict[str, Any] = make_view(tracer, built, (args.width, args.height), seed, spp,
                                              stack, PASSES * (seed >= HELD_OUT))
            np.savez(path.with_suffix(".partial.npz"), **found)
            path.with_suffix(".partial.npz").replace(path)
            print(f"{path.name}: {time.monotonic() - began:.0f} s", flush=True)


def make_view(tracer: Tracer, built: BuiltScene, size: tuple[int, int], seed: int, spp: int,
              stack: int, passes: int) -> dict[str, np.ndarray]:
    """The arrays of a view's file."""
    from training.datagen.clip import Style, film_of, filter_table, plane_images, radical_inverse
    from training.datagen.clip_file import to_half
    from training.datagen.scenes.motion import Camera, look_at
    from training.measure.equivalent_samples import prefix_counts

    rng = np.random.default_rng(seed)
    frames: list[dict[str, np.ndarray]] = []
    (width, height), pixels, table = size, size[0] * size[1], filter_table("box")
    while not frames or np.percentile(frames[-1]["depth"], 4) < CLOSEST:
        pose, step = draw_pose(rng)
        cameras = [Camera(look_at(*(pose + k * step)), FOV) for k in range(-1, FRAMES)]
        start, now = int(rng.integers(64)), float(rng.uniform(0, 8))
        frames = []
        jitter = [[radical_inverse(start + k, 2), radical_inverse(start + k, 3)]
                  for k in range(FRAMES + passes)]
        style = Style("realtime", 1, np.array(jitter, np.float32) - 0.5)
        for k in range(FRAMES):
            built.move(now + k, now + k - 1)
            film = film_of(size, style.offsets(k, pixels, rng))
            frames.append(plane_images(tracer, built, (cameras[k + 1], cameras[k]), size, style,
                                       film))

    def planes(k: int) -> dict[str, np.ndarray]:
        """Planes of the last moment, through jitter `k`."""
        film = film_of(size, style.offsets(k, pixels, rng))
        found = plane_images(tracer, built, (cameras[-1], cameras[-2]), size, style, film)
        found = {name: image.reshape(height, width, -1) for name, image in found.items()}
        return found | {"camera": camera_vector(cameras[-1].to_world, FOV, width / height,
                                                style.jitter[k])}

    def singles(count: int, offsets: np.ndarray) -> np.ndarray:
        """Independent one-sample images (count, H, W, 3)."""
        film, seed = film_of(size, offsets), int(rng.integers(1 << 31))
        light = tracer.noisy(built.scene, cameras[-1], width / height, film, 1, seed)
        return np.moveaxis(light.reshape(height, width, count, 3), 2, 0)

    made = {name: to_half(np.stack([frame[name].reshape(height, width, -1) for frame in frames]))
            for name in frames[0]}
    made["depth"] = np.stack([frame["depth"].reshape(height, width, 1) for frame in frames])
    made["camera"] = np.stack([camera_vector(camera.to_world, FOV, width / height, style.jitter[k])
                               for k, camera in enumerate(cameras[1:])])
    made["colour"] = to_half(singles(COLOURS, np.tile(0.5 + style.jitter[-1], (pixels, COLOURS, 1))
                                     .astype(np.float32)))
    made["reference_a"], made["reference_b"] = of_halves(
        lambda _: tracer.reference(built.scene, cameras[-1], size, table, spp // 2,
                                   int(rng.integers(1 << 31))), 1.0)
    counts, means, total = prefix_counts(stack) if stack else [], [], np.zeros((height, width, 3))
    for first in range(0, stack, TOGETHER):
        for n, image in enumerate(singles(TOGETHER, rng.random((pixels, TOGETHER, 2), np.float32)),
                                  first + 1):
            total += image
            means += [total / n] if n in counts else []
    further = [planes(FRAMES + k) for k in range(passes)]
    made |= {f"pass_{name}": np.array([one[name] for one in further], np.float32)
             for name in (further[0] if further else ())}
    if stack:
        made |= {"counts": np.array(counts), "means": np.array(means, np.float32)}
    return made


def draw_pose(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Eye and target of a camera in the room, and how both move in a frame; each (2, 3)."""
    eye = rng.uniform((-2.3, 0.5, -2.2), (2.3, 2.3, 2.8))
    target = rng.uniform((-2.0, 0.1, -2.9), (2.0, 1.9, 2.0))
    while np.linalg.norm(target - eye) < 1.2:
        target = rng.uniform((-2.0, 0.1, -2.9), (2.0, 1.9, 2.0))
    return np.stack([eye, target]), rng.normal(0, (0.02, 0.008, 0.02), (2, 3))


def camera_vector(to_world: np.ndarray, fov: float, aspect: float,
                  jitter: np.ndarray) -> np.ndarray:
    """A camera as networks of one scene read it, (16,): its axes to the left, up and forwards and
    its place in the world, the tangents of half the field of view across and down, and the jitter
    in pixels."""
    tangent = np.tan(np.radians(fov) / 2)
    return np.array([*to_world[:3, :4].T.ravel(), tangent, tangent / aspect, *jitter], np.float32)


if __name__ == "__main__":
    main()
