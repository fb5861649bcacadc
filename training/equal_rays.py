"""The same number of light paths both ways: 4 samples a pixel at half size, or 1 at full size. Two commands.

python -m training.equal_rays render OUT --scenes 6 [--variant cuda_ad_rgb]     needs Mitsuba
python -m training.equal_rays compare OUT -o RESULTS [--models m]               needs postfx[bench]

`render` makes OUT/NAME.SEED/ for each held-out scene: reference.####.exr at full size and, for both sampling styles
(realtime: all samples of a frame at one jittered position; box: spread over the pixel), STYLE.half.####.exr,
STYLE.full.####.exr and STYLE.guides.####.exr, planes at full size. Scenes that are there already are kept.
`compare` runs what `postfx bench` runs on each and writes RESULTS/equal_rays.json and equal_rays.csv.
"""

from __future__ import annotations

import argparse
import csv
import json
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

from training.clips import HALF_MAX

STYLES = ("realtime", "box")
HALF_SPP, FULL_SPP, LEAST_SPP = 4, 1, 64
FIGURES = ("psnr", "ssim", "flip", "flicker")


def arguments(argv: list[str] | None = None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(dest="command", required=True)
    render = commands.add_parser("render", help="render scenes both ways")
    render.add_argument("out", type=Path)
    render.add_argument("--scenes", type=int, default=6)
    render.add_argument("--seed", type=int, default=9000, help="of the first scene; the next ones follow")
    render.add_argument("--variant", default="cuda_ad_rgb", help="Mitsuba variant")
    render.add_argument("--width", type=int, default=320, help="of the half-size frames")
    render.add_argument("--height", type=int, default=180)
    render.add_argument("--frames", type=int, default=8)
    render.add_argument("--reference-error", type=float, default=0.006, help="of references after x/(1+x)")
    render.add_argument("--most-spp", type=int, default=8192, help="views that need more for it are passed over")
    compare = commands.add_parser("compare", help="measure both ways")
    compare.add_argument("out", type=Path, help="folder that 'render' filled")
    compare.add_argument("-o", "--results", type=Path, required=True)
    compare.add_argument("--methods", help="as 'postfx bench' takes them (default: all)")
    compare.add_argument("--models", help="tags of networks (default: all)")
    compare.add_argument("--runs", type=int, default=1)
    compare.add_argument("--device", default="auto")
    return parser.parse_args(argv)


def render(args: argparse.Namespace) -> None:
    """Render all scenes that are not there yet."""
    import mitsuba as mi

    mi.set_variant(args.variant)
    from training.held_out import held_out_view  # these import Mitsuba types, so only after the variant is set
    from training.tracing import Tracer

    tracer = Tracer()
    for seed in range(args.seed, args.seed + args.scenes):
        if list(args.out.glob(f"*.{seed}/done")):
            continue
        began = time.perf_counter()
        view = held_out_view(tracer, seed, args.width, args.reference_error, args.most_spp)
        folder = args.out / f"{view.name}.{seed}"
        folder.mkdir(parents=True, exist_ok=True)
        _render_scene(tracer, view, folder, args)
        (folder / "done").touch()
        print(f"{folder} {time.perf_counter() - began:.1f} s", file=sys.stderr, flush=True)


def _render_scene(tracer: Any, view: Any, folder: Path, args: argparse.Namespace) -> None:
    from training.sampling import filter_table, radical_inverse
    from training.to_exr import exposure_of, write_exr

    full, table, spp = (2 * args.width, 2 * args.height), filter_table("box"), max(LEAST_SPP, int(view.samples))
    halton = [[radical_inverse(t + 1, 2), radical_inverse(t + 1, 3)] for t in range(args.frames)]
    jitter = {"realtime": np.array(halton, np.float32) - 0.5, "box": np.zeros((args.frames, 2), np.float32)}
    references, made = [], []
    for t in range(args.frames):
        view.built.move(t, t - 1)
        seed = int(view.rng.integers(1 << 31))
        light = tracer.reference(view.built.scene, view.path.at(t), full, table, spp, seed)
        references.append(np.minimum(view.gain * light, HALF_MAX))
        made.append(_noisy_frames(tracer, view, t, (args.width, args.height), jitter))
    exposure = exposure_of(np.stack(references))
    for t, reference in enumerate(references):
        header = {"postfx:exposure": exposure, "postfx:spp": spp}
        write_exr(folder / f"reference.{t + 1:04d}.exr", {"colour": reference}, header)
        for name, planes in made[t].items():
            header = _header(view, name, t, jitter[name.split(".")[0]][t], exposure)
            write_exr(folder / f"{name}.{t + 1:04d}.exr", planes, header)


def _noisy_frames(tracer: Any, view: Any, t: int, half: tuple[int, int],
                  jitter: dict[str, np.ndarray]) -> dict[str, dict[str, np.ndarray]]:
    """One frame in both styles and both ways, with guides: file name -> planes."""
    from training.factory import guide_frame, noisy_frame
    from training.sampling import Style

    full, cameras, made = (2 * half[0], 2 * half[1]), (view.path.at(t), view.path.at(t - 1)), {}
    for style, offset in jitter.items():
        for way, size, spp in (("half", half, HALF_SPP), ("full", full, FULL_SPP)):
            sampled = Style(style, spp, offset)
            frame = noisy_frame(tracer, view.built, cameras, size, sampled, t, view.gain, view.rng)
            made[f"{style}.{way}"] = frame | {"colour": np.minimum(frame["colour"], HALF_MAX)}
        sampled = Style(style, 1 if style == "realtime" else HALF_SPP, offset)
        made[f"{style}.guides"] = guide_frame(tracer, view.built, cameras, full, sampled, t, view.rng)
    return made


def _header(view: Any, name: str, frame: int, jitter: np.ndarray, exposure: float) -> dict:
    from training.to_exr import frame_header

    if name.endswith("guides"):
        return {"postfx:jitter": jitter.astype(float)}
    camera, spp = view.path.at(frame), HALF_SPP if name.endswith("half") else FULL_SPP
    return frame_header(camera.to_world, camera.fov, jitter, spp, exposure, frame == 0)


def compare(args: argparse.Namespace) -> None:
    """Measure every scene both ways, and print means over scenes and styles."""
    from postfx.bench.job import Bench, Wish
    from postfx.bench.material import Sources

    rows: list[dict[str, Any]] = []
    folders = sorted(path.parent for path in args.out.glob("*/done"))
    if not folders:
        raise SystemExit(f"error: {args.out} holds no rendered scene: run 'render {args.out}' first")
    for folder in folders:
        for style in STYLES:
            for way in ("half", "full"):
                guides = str(folder / f"{style}.guides.####.exr") if way == "half" else None
                sources = Sources(str(folder / f"{style}.{way}.####.exr"), str(folder / "reference.####.exr"), guides)
                output = args.results / folder.name / f"{style}.{way}"
                wish = Wish(output, args.methods, args.models, args.runs, args.device)
                rows += [_row(folder.name, style, way, method) for method in Bench(sources, wish).run()["methods"]]
    _report(args.results, rows)


def _row(scene: str, style: str, way: str, method: dict[str, Any]) -> dict[str, Any]:
    figures = {key: method["scores"][key] for name in FIGURES for key in (name, f"{name}_late")}
    return {"scene": scene, "style": style, "way": way, "method": method["name"], **method["time"], **figures}


def _report(folder: Path, rows: list[dict[str, Any]]) -> None:
    means = []
    for way, method in dict.fromkeys((row["way"], row["method"]) for row in rows):
        same = [row for row in rows if (row["way"], row["method"]) == (way, method)]
        keys = ("wall_ms", "psnr_late", "ssim_late", "flip_late", "flicker_late")
        means.append({"way": way, "method": method, "sequences": len(same),
                      **{key: _mean([row[key] for row in same]) for key in keys}})
    (folder / "equal_rays.json").write_text(json.dumps({"means": means, "rows": rows}, indent=1) + "\n")
    with (folder / "equal_rays.csv").open("w", newline="") as file:
        writer = csv.DictWriter(file, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)
    print(f"{'rendered':<10}{'method':<24}{'ms':>8}{'PSNR':>8}{'SSIM':>8}{'FLIP':>8}{'flicker':>9}")
    for row in means:
        flicker = "-" if row["flicker_late"] is None else f"{row['flicker_late']:.2f}"
        figures = f"{row['psnr_late']:>8.2f}{row['ssim_late']:>8.4f}{row['flip_late']:>8.4f}{flicker:>9}"
        print(f"{row['way']:<10}{row['method']:<24}{row['wall_ms']:>8.1f}{figures}")


def _mean(values: list[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return float(np.mean(known)) if known else None


if __name__ == "__main__":
    parsed = arguments()
    {"render": render, "compare": compare}[parsed.command](parsed)
