"""Networks and Open Image Denoise by kind of content, on clips of the generator that also makes
training clips.

No network was trained on these clips, but on others of the same making: they show whether a network
has become worse, and flatter it beside Open Image Denoise. `training.measure.table` is the
yardstick.

    python -m training.measure.kinds score CLIPS [--models m,s] [--json FILE]     a table by kind
    python -m training.measure.kinds score CLIPS --log training/runs.jsonl --run NAME [--models m]
    python -m training.measure.kinds pack CLIPS FOLDER                         a small set for tests

CLIPS holds .npz files of `training.datagen.render --blender ...`, drawn with seeds from 9000 on.
Pictures are compared after exposure, x/(1+x) and the sRGB curve, in the second half of the frames.
The squared error is the mean of the product of the differences from two independent halves of the
reference, so the reference's own noise does not count. --log adds the mean gains by kind to a
training run (`training.measure.runs`).
"""

from __future__ import annotations

import argparse
import json
import sys
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from postfx import DenoiseUpscale, Device, Frame, Pipeline
from postfx.colour.views import to_codes
from postfx.frame import Role
from postfx.tools.bench.baselines import HostKernels, Oidn
from postfx.tools.bench.metrics import grey_factor
from training.datagen.clip_file import load_clip
from training.measure.runs import record_kinds

PLANES = ("colour", "diffuse_albedo", "specular_albedo", "normal", "depth", "motion")
PACKED_FRAMES, PACKED_SIDE = 4, 64  # of the small set: render pixels in the middle of a clip
Method = Callable[[Frame], np.ndarray]


def frames_of(clip: Mapping[str, np.ndarray], variant: int, exposure: float) -> Iterator[Frame]:
    """The frames of one noisy render. In a clip without motion, each frame drops the history."""
    for t in range(len(clip["reference"])):
        planes = {Role(name): clip[f"v{variant}_{name}"][t].astype(np.float32) for name in PLANES}
        planes[Role.DEPTH] = planes[Role.DEPTH][..., None]
        yield Frame(planes, number=t, exposure=float(np.log2(exposure)),
                    reset=bool(clip["reset"][t]))


def halves(clip: Mapping[str, np.ndarray], variant: int) -> tuple[np.ndarray, np.ndarray]:
    """Two independent references (T, H, W, 3); only the second for a render that was made from the
    first."""
    second = clip["half"].astype(np.float32)
    first = (second if clip[f"v{variant}_half"]
             else 2 * clip["reference"].astype(np.float32) - second)
    return first, second


def oidn_method(size: tuple[int, int], planes: str = "clean") -> Method:
    """Open Image Denoise, high quality with albedo and normal, as rendered or prefiltered, enlarged
    by cubic interpolation."""
    oidn, kernels = Oidn("high", "cpu", 2, planes), HostKernels(Device())
    return lambda frame: kernels.enlarge(oidn(frame), *size, (0.0, 0.0))


def network_method(model: str, scale: float) -> Method:
    passes = Pipeline([DenoiseUpscale(scale=scale, model=model)])
    return lambda frame: passes(frame).planes[Role.COLOUR]


def score_render(clip: Mapping[str, np.ndarray], variant: int, method: Method) -> float:
    """PSNR in dB of the second half of the frames."""
    exposure = grey_factor(clip["reference"][0].astype(np.float32).clip(0))
    first, second = halves(clip, variant)
    errors = []
    for t, frame in enumerate(frames_of(clip, variant, exposure)):
        found = to_codes(method(frame), exposure)
        errors.append(np.mean((found - to_codes(first[t], exposure)) * (found - to_codes(second[t],
        exposure))))
    return float(-10 * np.log10(max(np.mean(errors[len(errors) // 2:]), 1e-9)))


def score(paths: list[Path], models: list[str]) -> list[dict[str, Any]]:
    """A row for each clip and noisy render: kind, scale, samples a pixel, and PSNR by method. OIDN
    runs twice, with the planes as rendered and prefiltered."""
    rows = []
    for path in paths:
        clip = load_clip(path)
        scale, size = round(clip["scale"], 3), clip["reference"].shape[1:3]
        for variant in range(clip["variants"]):
            row = {"clip": path.stem, "kind": clip["meta"]["kind"], "scale": scale,
                   "spp": int(clip[f"v{variant}_spp"]),
                   "oidn": score_render(clip, variant, oidn_method(size)),
                   "oidn_prefiltered": score_render(clip, variant,
                                                    oidn_method(size, "prefiltered"))}
            rows.append(row | {m: score_render(clip, variant, network_method(m, scale))
                               for m in models})
            print(json.dumps({k: round(v, 2) if isinstance(v, float) else v
                              for k, v in rows[-1].items()}),
                  file=sys.stderr, flush=True)
    return rows


def group(rows: list[dict[str, Any]]) -> dict[str, list[dict[str, Any]]]:
    """Rows by kind."""
    by_kind = defaultdict(list)
    for row in rows:
        by_kind[row["kind"]].append(row)
    return by_kind


def free(row: dict[str, Any]) -> float:
    """PSNR in dB of the better OIDN."""
    return max(row["oidn"], row["oidn_prefiltered"])


def mean_gains(rows: list[dict[str, Any]], models: list[str]) -> dict[str, dict[str, float]]:
    """Kind -> network -> mean gain over the better Open Image Denoise in dB."""
    return {kind: {model: round(float(np.mean([row[model] - free(row) for row in found])), 2)
                   for model in models}
            for kind, found in group(rows).items()}


def table(rows: list[dict[str, Any]], models: list[str]) -> str:
    """Markdown: a row for each kind with the mean PSNR of both ways to run OIDN, and each network's
    mean and least gain over the better one."""
    lines = ["| kind | renders | OIDN high, dB | planes prefiltered, dB | " +
             " | ".join(f"{m}, dB more | least" for m in models) + " |",
             "| --- | --- | --- | --- |" + " --- | --- |" * len(models)]
    for kind, found in sorted(group(rows).items()):
        cells = [kind, str(len(found)), *(f"{np.mean([row[way] for row in found]):.2f}" for way in
                                          ("oidn", "oidn_prefiltered"))]
        for model in models:
            gains = [row[model] - free(row) for row in found]
            cells += [f"{np.mean(gains):+.2f}", f"{min(gains):+.2f}"]
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines)


def pack(paths: list[Path], folder: Path) -> None:
    """The middle of each clip, its noisiest render and both halves of its reference, compressed."""
    folder.mkdir(parents=True, exist_ok=True)
    for path in paths:
        with np.load(path) as file:
            clip = dict(file)
        noisiest = min(range(sum(name.endswith("_spp") for name in clip)),
                       key=lambda v: int(clip[f"v{v}_spp"]))
        kept = {}
        for name, values in clip.items():
            if name.startswith("v"):
                if not name.startswith(f"v{noisiest}_"):
                    continue
                name = f"v0_{name.split('_', 1)[1]}"
            kept[name] = middle(values,
                                float(clip["scale"]) if name in ("reference", "half") else 1.0)
        arrays: dict[str, Any] = kept
        np.savez_compressed(folder / path.name, **arrays)


def middle(values: np.ndarray, scale: float) -> np.ndarray:
    """The first frames of a picture (T, h, w, ...), its middle; other arrays as they are."""
    if values.ndim < 3:
        return values[:PACKED_FRAMES] if values.ndim else values
    side = min(round(PACKED_SIDE * scale), values.shape[1])
    first = (values.shape[1] - side) // 2
    return values[:PACKED_FRAMES, first:first + side, first:first + side]


def main(argv: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("command", choices=("score", "pack"))
    parser.add_argument("clips", type=Path)
    parser.add_argument("folder", type=Path, nargs="?", help="folder for the small set of pack")
    parser.add_argument("--models", default="m", help="tags of networks, comma-separated")
    parser.add_argument("--json", type=Path, help="write all rows there")
    parser.add_argument("--log", type=Path, metavar="FILE",
                        help="table of training runs that gets the mean gains")
    parser.add_argument("--run", metavar="NAME", help="the run of --log that made these networks")
    args = parser.parse_args(argv)
    if bool(args.log) != bool(args.run):
        parser.error("--log and --run go together: the table of runs, and the run's name in it")
    paths = sorted(args.clips.glob("*.npz"))
    if not paths:
        parser.error(f"{args.clips} holds no clips: name the folder of .npz files")
    if args.command == "pack":
        if args.folder is None:
            parser.error("pack needs a folder to write to")
        pack(paths, args.folder)
        return 0
    models = args.models.split(",")
    rows = score(paths, models)
    if args.json:
        args.json.write_text(json.dumps(rows, indent=1))
    print(table(rows, models))
    if args.log:
        try:
            record_kinds(args.log, args.run, mean_gains(rows, models))
        except (OSError, ValueError) as fault:
            parser.error(str(fault))
    return 0


if __name__ == "__main__":
    sys.exit(main())
