"""Does the result converge? Errors of the input and of results as the samples of a frame rise.

python -m training.measure.convergence VIEW.npz -o RESULTS [--model s,m] [--scales 1,2]

VIEW.npz comes from training.measure.equivalent_samples. The input of n samples a pixel is the mean
of its first n images, and so are its planes, as long as the view holds enough (beyond, its `mean_`
planes). At scale 1 the reference is the view's. At scale 2 the input is the mean of every 2x2
pixels, with 4 n samples a pixel, and the reference is the same. Each input is the first frame of a
sequence. PSNR compares displayed pictures, without the reference's own noise (see
equivalent_samples). Writes RESULTS/convergence.csv, .json and .png, and prints the PSNR of each
input and result, then the least gain of each method over its own input, and its gain with the most
samples.
"""

from __future__ import annotations

import argparse
import csv
import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from training.measure.equivalent_samples import COLOURS, PLANES, Errors, load_view

INPUT = "input"
FIELDS = ("scale", "samples", "method", "psnr", "gain")


class Step(NamedTuple):
    """Planes (h, w, C) of a frame and their samples a pixel."""

    samples: int
    planes: dict[str, np.ndarray]


def arguments(argv: list[str] | None = None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("view", type=Path,
                        help="file that 'training.measure.equivalent_samples render' wrote")
    parser.add_argument("-o", "--results", type=Path, required=True)
    parser.add_argument("--model", default="m", help="tags of networks, comma-separated")
    parser.add_argument("--scales", default="1,2", help="1, 2 or both")
    parser.add_argument("--hide-samples", action="store_true",
                        help="do not tell the passes how many samples there are")
    parser.add_argument("--no-oidn", action="store_true", help="leave Open Image Denoise out")
    parser.add_argument("--device", default="auto")
    return parser.parse_args(argv)


def steps(view: dict[str, np.ndarray], scale: int) -> Iterator[Step]:
    """Inputs of 1, 2, 4, 8, ... samples a pixel, as many as the view has, `scale` times smaller
    than its reference."""
    for count, mean in zip(view["counts"], view["means"], strict=True):
        if count & (count - 1):
            continue
        planes = {name: _averaged(view, name, count) for name in PLANES} | {"colour": mean}
        small = {name: shrunk(plane, scale).astype(np.float32) for name, plane in planes.items()}
        yield Step(int(count) * scale**2, small | {"motion": small["motion"] / np.float32(scale)})


def _averaged(view: dict[str, np.ndarray], name: str, count: int) -> np.ndarray:
    """A plane averaged over the given samples a pixel, or the mean of all if the view holds
    fewer."""
    known = f"mean_{name}" in view and count > len(view[name])
    return view[f"mean_{name}"] if known else view[name][:count].mean(0, dtype=np.float64)


def shrunk(plane: np.ndarray, factor: int) -> np.ndarray:
    """Mean over factor x factor pixels of (H, W, C); incomplete rows and columns are cut."""
    h, w = plane.shape[0] // factor, plane.shape[1] // factor
    return plane[: h * factor, : w * factor].reshape(h, factor, w, factor, -1).mean((1, 3))


def methods(args: argparse.Namespace, scale: int,
            size: tuple[int, int]) -> dict[str, Callable[[Any], np.ndarray]]:
    """Method -> function from a frame to a picture of `size` (height, width); the input itself
    comes first."""
    import postfx
    from postfx.tools.bench.methods import OTHERS, Method, make

    device = postfx.Device(args.device)
    wanted = {INPUT: "bicubic"} | ({} if args.no_oidn else {"OIDN high": "oidn-high"})
    found = {title: next(item for item in OTHERS if item.name == name)
             for title, name in wanted.items()}
    found |= {tag: Method(tag, tag, "ours", tag, alone=True) for tag in args.model.split(",")}
    return {title: make(item, device, scale, size) for title, item in found.items()}


def measure(view: dict[str, np.ndarray], args: argparse.Namespace) -> list[dict[str, Any]]:
    """A row for each scale, sample count and method; `gain` is its PSNR above its input's."""
    import postfx
    from postfx.tools.bench.metrics import grey_factor

    rows = []
    for scale in map(int, args.scales.split(",")):
        height, width = (side // scale * scale for side in view["reference_a"].shape[:2])
        halves = [view[name][:height, :width] for name in ("reference_a", "reference_b")]
        errors = Errors(halves[0], halves[1], grey_factor((halves[0] + halves[1]) / 2))
        ways = methods(args, scale, (height, width))
        for step in steps(view, scale):
            planes = {postfx.Role(name): plane for name, plane in step.planes.items()}
            frame = postfx.Frame(planes, samples=None if args.hide_samples else step.samples)
            scores = {name: -10 * np.log10(errors(way(frame))["seen"])
                      for name, way in ways.items()}
            rows += [dict(zip(FIELDS, (scale, step.samples, name, score, score - scores[INPUT]),
                              strict=True))
                     for name, score in scores.items()]
    return rows


def scores(rows: list[dict[str, Any]]) -> Iterator[str]:
    """A line for each scale and sample count: PSNR of the input and of each method."""
    for scale, samples in dict.fromkeys((row["scale"], row["samples"]) for row in rows):
        own = [row for row in rows if (row["scale"], row["samples"]) == (scale, samples)]
        found = ", ".join(f"{row['method']} {row['psnr']:.2f}" for row in own)
        yield f"{scale}x, {samples} samples: {found}"


def worst(rows: list[dict[str, Any]]) -> Iterator[str]:
    """A line for each scale and method: its least gain over the input, and the last one."""
    for scale, method in dict.fromkeys((row["scale"], row["method"])
                                       for row in rows if row["method"] != INPUT):
        own = [row for row in rows if (row["scale"], row["method"]) == (scale, method)]
        low = min(own, key=lambda row: row["gain"])
        yield (f"{method} at {scale}x: at least {low['gain']:+.2f} dB over its input (at "
               f"{low['samples']} samples), {own[-1]['gain']:+.2f} dB at {own[-1]['samples']}")


def plot(rows: list[dict[str, Any]], title: str, path: Path) -> None:
    """PSNR over samples a pixel, a panel for each scale; a PNG."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    scales, names = (list(dict.fromkeys(row[key] for row in rows)) for key in ("scale", "method"))
    figure = Figure(figsize=(6 * len(scales), 5.2), dpi=110, layout="constrained")
    FigureCanvasAgg(figure)
    for axes, scale in zip(figure.subplots(1, len(scales), squeeze=False)[0], scales, strict=True):
        for name, colour in zip(names, ("#333333", *COLOURS), strict=False):
            points = [(row["samples"], row["psnr"])
                      for row in rows if (row["scale"], row["method"]) == (scale, name)]
            axes.semilogx(*zip(*points, strict=True), ".-", base=2, color=colour, label=name)
        axes.set_title(f"{scale}x", fontsize=10)
        axes.set_xlabel("samples a pixel")
        axes.set_ylabel("PSNR, dB")
        axes.grid(True, which="major", color="#dddddd")
        axes.legend(fontsize=9, loc="upper left")
    figure.suptitle(title)
    figure.savefig(path)


def main(argv: list[str] | None = None) -> None:
    args = arguments(argv)
    view = load_view(args.view)
    rows, facts = measure(view, args), json.loads(str(view["facts"]))
    args.results.mkdir(parents=True, exist_ok=True)
    (args.results / "convergence.json").write_text(json.dumps(
        {"view": facts, "rows": rows}, indent=1
    ) + "\n")
    with (args.results / "convergence.csv").open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, FIELDS)
        writer.writeheader()
        writer.writerows(rows)
    plot(rows, f"{facts['scene']}, seed {facts['seed']}: one frame, no history",
         args.results / "convergence.png")
    print("\n".join([*scores(rows), *worst(rows)]))


if __name__ == "__main__":
    main()
