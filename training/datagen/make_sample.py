"""Render the sequence of samples/room, and its references at twice the size.

python -m training.datagen.make_sample OUT_FOLDER [--reference 1-8 [--reference-spp 192]] [--variant llvm_ad_rgb]
    [--spp 4]

Real-time style: every sample of a frame goes through one jittered position (Halton 2,3), so planes are point samples.
References spread their samples over the pixel (box filter) and have the noisy frames' exposure.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path

import mitsuba as mi
import numpy as np
from fileseq import FrameSet

from postfx.bench.metrics import psnr, to_codes

PACKED = "dwab:80"  # lossy, 47 dB PSNR: an error far below the noise; zip takes 2.7 times as much space


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    parser.add_argument("--variant", default="llvm_ad_rgb", help="Mitsuba variant")
    parser.add_argument("--spp", type=int, default=4)
    parser.add_argument("--frames", type=int, default=8)
    parser.add_argument("--width", type=int, default=320)
    parser.add_argument("--height", type=int, default=180)
    parser.add_argument("--reference", type=FrameSet, default=(), metavar="FRAMES", help="frames such as 1-8 or 1,7,8")
    parser.add_argument("--reference-spp", type=int, default=192)
    args = parser.parse_args()
    mi.set_variant(args.variant)
    from training.datagen.clip import (
        Style,
        filter_table,
        noisy_frame,  # these import Mitsuba types, so only after the variant is set
        radical_inverse,
    )
    from training.datagen.clip_export import CHANNELS, frame_header, write_exr
    from training.datagen.clip_file import exposure_of
    from training.datagen.scenes.build import BuiltScene
    from training.datagen.scenes.room import sample_camera, sample_room
    from training.datagen.tracing import Tracer

    tracer, built, rng = Tracer(), BuiltScene(sample_room()), np.random.default_rng(1)
    halton = [[radical_inverse(t + 1, 2), radical_inverse(t + 1, 3)] for t in range(args.frames)]
    style = Style("realtime", args.spp, np.array(halton, np.float32) - 0.5)
    args.out.mkdir(parents=True, exist_ok=True)
    size, frames = (args.width, args.height), []
    for t in range(args.frames):
        built.move(t, t - 1)
        frames.append(noisy_frame(tracer, built, (sample_camera(t), sample_camera(t - 1)), size, style, t, 1.0, rng))
    exposure = exposure_of(np.stack([frame["colour"] for frame in frames]))
    for t, frame in enumerate(frames):
        camera = sample_camera(t)
        header = frame_header(camera.to_world, camera.fov, style.jitter[t], args.spp, exposure, t == 0)
        write_exr(args.out / f"noisy.{t + 1:04d}.exr", {name: frame[name] for name in CHANNELS}, header)
    double, table, half = (2 * args.width, 2 * args.height), filter_table("box"), (args.reference_spp + 1) // 2
    facts = {"postfx:exposure": exposure, "postfx:spp": 2 * half, "compression": PACKED}
    for t in (number - 1 for number in args.reference):
        built.move(t, t - 1)
        colour = of_halves(
            lambda k, t=t: tracer.reference(built.scene, sample_camera(t), double, table, half, 2 * t + k), exposure)
        write_exr(args.out / f"reference.{t + 1:04d}.exr", {"colour": colour}, facts)


def of_halves(render: Callable[[int], np.ndarray], exposure: float) -> np.ndarray:
    """Mean (H, W, 3) of the independent renders 0 and 1. Prints its noise, half their difference, as PSNR."""
    first, second = render(0), render(1)
    noise = psnr(to_codes(first, exposure), to_codes(second, exposure)) + 20 * np.log10(2)
    print(f"reference with noise of {noise:.1f} dB PSNR", flush=True)
    return (first + second) / 2


if __name__ == "__main__":
    main()
