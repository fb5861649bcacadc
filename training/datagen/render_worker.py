"""Render training clips in one process.

    python -m training.datagen.render_worker --out DIR --clips N [--start K --stride M] ...

Clip n depends only on --seed and n, and existing files are skipped, so any number of processes can
share the work: give all the same --clips and --stride, and each its own --start.
`training.datagen.render` does that for all GPUs of a machine.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np


def add_options(parser: argparse.ArgumentParser) -> list[str]:
    """Add the options of a clip; returns their names, for those who hand them on."""
    before = {action.dest for action in parser._actions}
    parser.add_argument("--variant", default="cuda_ad_rgb", help="Mitsuba variant")
    parser.add_argument("--real", type=Path, help="folder of converted scenes and environments/")
    parser.add_argument("--real-share", type=float, default=0.25,
                        help="part of the clips from real scenes")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--width", type=int, default=128, help="noisy width")
    parser.add_argument("--height", type=int, default=128, help="noisy height")
    parser.add_argument("--frames", type=int, default=8)
    parser.add_argument("--variants", type=int, metavar="N",
                        help="noisy renders of the same frames (default: 3; with Cycles 2, beside "
                             "half of the reference)")
    parser.add_argument("--reference-spp", type=int, default=128,
                        help="takes half to four times as many, by noise")
    parser.add_argument("--reference-error", type=float, default=0.015,
                        help="wanted error after x/(1+x)")
    parser.add_argument("--even-spp", type=int, metavar="N",
                        help="samples a pixel of noisy renders are drawn evenly in stops from 1 to "
                        "N (default: mostly 1 to 8)")
    parser.add_argument("--scale", type=float, help="one scale for all clips (default: drawn)")
    parser.add_argument("--families", metavar="A,B",
                        help="kinds of procedural scenes with detail finer than a pixel: fur, "
                        "sunlit (default: other kinds, drawn)")
    parser.add_argument("--blender", type=Path,
                        help="render with Cycles: a Python that has Blender's module bpy")
    parser.add_argument("--half-samples", type=int, default=256,
                        help="Cycles: samples a render pixel in each half of a reference")
    parser.add_argument("--kind", help="Cycles: one kind of scene for all clips (default: drawn)")
    return [action.dest for action in parser._actions if action.dest not in before]


def arguments(argv: list[str] | None = None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    add_share(parser)
    add_options(parser)
    return parser.parse_args(argv)


def add_share(parser: argparse.ArgumentParser) -> None:
    """Add the options that say which clips this process makes; `work` reads them."""
    parser.add_argument("--out", type=Path, required=True, help="folder for clip.NNNNN.npz")
    parser.add_argument("--clips", type=int, required=True, help="clips of the whole job")
    parser.add_argument("--start", type=int, default=0, help="first clip of this process")
    parser.add_argument("--stride", type=int, default=1,
                        help="step between the clips of this process")
    parser.add_argument("--minutes", type=float, default=1e9, help="stop after this time")
    parser.add_argument("--listen", action="store_true",
                        help="take clip numbers from standard input, one a line")


def clip_path(folder: Path, index: int) -> Path:
    return folder / f"clip.{index:05d}.npz"


def light_paths(reference: np.ndarray, variants: list[dict[str, Any]],
                facts: dict[str, Any]) -> int:
    """Camera samples that a clip took."""
    count = reference[..., 0].size * facts["meta"]["reference_spp"]
    return int(count + sum(v["colour"][..., 0].size * v["spp"] for v in variants))


def maker(args: argparse.Namespace) -> Callable[[int], tuple[Any, ...]]:
    """A function from a clip's number to the arguments of `save_clip`."""
    if args.blender:
        return cycles_maker(args)
    from training.datagen.variant import use_variant

    use_variant(args.variant)
    # these import Mitsuba types, so only after the variant is set
    from training.datagen.clip import (
        ClipOptions,
        make_clip,
    )
    from training.datagen.scenes.convert import RealScenes
    from training.datagen.scenes.lights import Environments
    from training.datagen.scenes.procedural import FINE
    from training.datagen.tracing import Tracer

    families = tuple(args.families.split(",")) if args.families else ()
    if unknown := [name for name in families if name not in FINE]:
        sys.exit(f"--families: no kind '{unknown[0]}': there are {', '.join(FINE)}")
    fixed: dict[str, Any] = {}
    if args.scale is not None:
        fixed = {"scales": (args.scale,), "scale_chances": (1.0,)}
    options = ClipOptions(args.width, args.height, args.frames,
                          args.variants or ClipOptions.variants, args.reference_spp,
                          args.reference_error, real_share=args.real_share, even_spp=args.even_spp,
                          families=families, **fixed)
    maps, real = Environments(args.real and args.real / "environments"), RealScenes(args.real)
    tracer = Tracer()
    return lambda index: make_clip(tracer, options, maps, real, args.seed, index)


def cycles_maker(args: argparse.Namespace) -> Callable[[int], tuple[Any, ...]]:
    """A function that renders a clip by its number with Cycles; `--real` is the folder of glTF
    scenes, panoramas and pages."""
    from training.datagen.cycles.clips import Blender, CyclesOptions, make_clip

    fixed: dict[str, Any] = {}
    if args.scale is not None:
        fixed = {"scales": (args.scale,), "scale_chances": (1.0,)}
    options = CyclesOptions(args.width, args.height, args.frames,
                            args.even_spp or CyclesOptions.most_spp,
                            args.half_samples, args.variants or CyclesOptions.renders,
                            kind=args.kind, **fixed)
    blender = Blender(args.blender, args.real)
    return lambda index: make_clip(blender, options, args.seed, index)


def numbers(args: argparse.Namespace) -> Iterator[int]:
    """Numbers of the clips that this process has yet to make."""
    if args.listen:
        yield from (int(line) for line in iter(sys.stdin.readline, ""))
        return
    began = time.perf_counter()
    for index in range(args.start, args.clips, args.stride):
        if time.perf_counter() - began > 60 * args.minutes:
            return
        if not clip_path(args.out, index).exists():
            yield index


def work(args: argparse.Namespace, make: Callable[[int], tuple[str, int]]) -> int:
    """Make the clips of this process. `make` writes one and returns its description and its count
    of camera samples."""
    args.out.mkdir(parents=True, exist_ok=True)
    if args.listen:
        print(json.dumps({"ready": True}), flush=True)
    began, made = time.perf_counter(), 0
    for index in numbers(args):
        what, samples = make(index)
        made += 1
        rate = made / (time.perf_counter() - began)
        print(f"clip.{index:05d} {what} {rate:.3f} clips/s", file=sys.stderr, flush=True)
        if args.listen:
            print(json.dumps({"clip": index, "samples": samples}), flush=True)
    return 0


def main(argv: list[str] | None = None) -> int:
    args = arguments(argv)
    make = maker(args)
    from training.datagen.clip_file import save_clip

    def write(index: int) -> tuple[str, int]:
        reference, variants, facts = make(index)
        save_clip(clip_path(args.out, index), reference, variants, facts)
        return f"{facts['scene']} x{facts['scale']:g}", light_paths(reference, variants, facts)

    return work(args, write)


if __name__ == "__main__":
    sys.exit(main())
