"""Render training clips: python -m training.render --out DIR --clips N [--start K --stride M] [--real FOLDER] ...

Clip number n depends on --seed and n only, existing files are skipped, so any number of processes can share the work:
give each the same --clips and --stride, and its own --start.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

import mitsuba as mi


def arguments(argv: list[str] | None = None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True, help="folder for clip.NNNNN.npz")
    parser.add_argument("--clips", type=int, required=True, help="clips of the whole job")
    parser.add_argument("--start", type=int, default=0, help="first clip of this process")
    parser.add_argument("--stride", type=int, default=1, help="step between the clips of this process")
    parser.add_argument("--variant", default="cuda_ad_rgb", help="Mitsuba variant")
    parser.add_argument("--real", type=Path, help="folder of converted scenes and environments/")
    parser.add_argument("--real-share", type=float, default=0.25, help="part of the clips from real scenes")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--width", type=int, default=128, help="noisy width")
    parser.add_argument("--height", type=int, default=128, help="noisy height")
    parser.add_argument("--frames", type=int, default=8)
    parser.add_argument("--variants", type=int, default=3, help="noisy renders of the same frames")
    parser.add_argument("--reference-spp", type=int, default=128, help="half to four times of it are taken, by noise")
    parser.add_argument("--reference-error", type=float, default=0.015, help="wanted error after x/(1+x)")
    parser.add_argument("--scale", type=float, help="one scale for all clips (default: drawn)")
    parser.add_argument("--minutes", type=float, default=1e9, help="stop after this time")
    return parser.parse_args(argv)


def main(argv: list[str] | None = None) -> int:
    args = arguments(argv)
    mi.set_variant(args.variant)
    from training.clips import save_clip  # these import Mitsuba types, so only after the variant is set
    from training.factory import ClipOptions, make_clip
    from training.scenes.lights import Environments
    from training.scenes.real import RealScenes
    from training.tracing import Tracer

    fixed = {} if args.scale is None else {"scales": (args.scale,), "scale_chances": (1.0,)}
    options = ClipOptions(args.width, args.height, args.frames, args.variants, args.reference_spp,
                          args.reference_error, real_share=args.real_share, **fixed)
    maps, real = Environments(args.real and args.real / "environments"), RealScenes(args.real)
    args.out.mkdir(parents=True, exist_ok=True)
    tracer, began, made = Tracer(), time.perf_counter(), 0
    for index in range(args.start, args.clips, args.stride):
        path = args.out / f"clip.{index:05d}.npz"
        if path.exists():
            continue
        if time.perf_counter() - began > 60 * args.minutes:
            break
        reference, variants, facts = make_clip(tracer, options, maps, real, args.seed, index)
        save_clip(path, reference, variants, facts)
        made += 1
        rate = made / (time.perf_counter() - began)
        print(f"{path.name} {facts['scene']} x{facts['scale']:g} {rate:.3f} clips/s", file=sys.stderr, flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
