"""Equivalent sample count: the samples a pixel that reach the error of a network with one sample.
Two commands.

python -m training.measure.equivalent_samples render VIEW.npz [--variant cuda_ad_rgb]
python -m training.measure.equivalent_samples measure VIEW.npz -o RESULTS [--model m]

`render` needs Mitsuba, `measure` the extra 'bench'.

`render` makes independent images of one sample a pixel of a held-out view, the means of the first
1, 2, 3, ... of them, and a reference of two independent halves. `measure` measures the error of
those means, the true convergence of this view (no form is assumed), runs the network at its own
size, as a first frame without history, on several of the single images, and finds where the curve
crosses the network's error. The reference's own noise, known from its halves, is taken out of every
error. Errors are mean squares of displayed pictures (exposed, x/(1+x), sRGB), and relMSE of linear
light without the worst 0.1 % of the pixels. Writes RESULTS/equivalent_samples.json and .png.

VIEW.npz: `reference_a`, `reference_b` (H, W, 3), the halves; `counts` (P,) and `means` (P, H, W,
3); `colour`, `diffuse_albedo`, `specular_albedo`, `normal`, `roughness`, `depth`, `motion` (K, H,
W, C), float32, of the K single images that the network sees; `mean_diffuse_albedo` and so on (H, W,
C), averages over `--samples` samples a pixel; `facts`, JSON.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import Any

import numpy as np

PLANES = ("colour", "diffuse_albedo", "specular_albedo", "normal", "roughness", "depth", "motion")
MEASURES = {"seen": "mean square error of what is seen", "relmse": "relMSE"}
COLOURS = ("#0b62b8", "#c8500a", "#2a7d2a", "#8a3fb0")
TRIMMED = 0.999
AT_ONCE = 32  # samples a pixel whose planes are traced together


def arguments(argv: list[str] | None = None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(dest="command", required=True)
    render = commands.add_parser("render", help="render a view")
    render.add_argument("view", type=Path, help="file to write")
    render.add_argument("--variant", default="cuda_ad_rgb", help="Mitsuba variant")
    render.add_argument("--seed", type=int, default=9000)
    render.add_argument("--family", default="room", help="interior, room, product or outdoor")
    render.add_argument("--width", type=int, default=480)
    render.add_argument("--height", type=int, default=270)
    render.add_argument("--samples", type=int, default=2048, help="images of one sample a pixel")
    render.add_argument("--inputs", type=int, default=8,
                        help="how many of them the network will see")
    render.add_argument("--half-spp", type=int, default=8192,
                        help="samples a pixel of each half of the reference")
    render.add_argument("--reference-error", type=float, default=0.006,
                        help="largest error of the reference")
    measure = commands.add_parser("measure", help="find the equivalent sample count")
    measure.add_argument("view", type=Path, help="file that 'render' wrote")
    measure.add_argument("-o", "--results", type=Path, required=True)
    measure.add_argument("--model", default="m", help="tags of networks, comma-separated")
    measure.add_argument("--no-oidn", action="store_true", help="leave Open Image Denoise out")
    measure.add_argument("--device", default="auto")
    return parser.parse_args(argv)


def render(args: argparse.Namespace) -> None:
    """Write the view's file."""
    from training.datagen.variant import use_variant

    use_variant(args.variant)
    from training.datagen.clip import (
        Style,
        filter_table,
        noisy_frame,  # these import Mitsuba types, so only after the variant is set
    )
    from training.datagen.held_out import Kind, held_out_view
    from training.datagen.tracing import Tracer

    tracer, size = Tracer(), (args.width, args.height)
    view = held_out_view(tracer, args.seed, args.width, args.reference_error, 2 * args.half_spp,
                         Kind(args.family))
    view.built.move(0, 0)
    camera, table = view.path.at(0), filter_table("box")
    style = Style("box", 1, np.zeros((1, 2), np.float32))

    def light(spp: int) -> np.ndarray:
        return view.gain * tracer.reference(view.built.scene, camera, size, table, spp,
                                            int(view.rng.integers(1 << 31)))

    singles = [noisy_frame(tracer, view.built, (camera, camera), size, style, 0, view.gain,
                           view.rng)
               for _ in range(args.inputs)]
    total, means, counts = np.zeros((args.height, args.width, 3)), [], prefix_counts(args.samples)
    for n in range(1, args.samples + 1):
        total += singles[n - 1]["colour"] if n <= len(singles) else light(1)
        means += [np.float32(total / n)] if n in counts else []
        if n % 256 == 0:
            print(f"{n} of {args.samples} images", file=sys.stderr, flush=True)
    planes = {name: np.stack([single[name].reshape(args.height, args.width, -1)
                              for single in singles])
              for name in PLANES}
    averaged = {f"mean_{name}": plane
                for name, plane in many_planes(tracer, view, camera, size, args.samples).items()}
    facts = {"scene": view.name, "seed": args.seed, "half_spp": args.half_spp, "gain": view.gain,
             "fov": camera.fov}
    args.view.parent.mkdir(parents=True, exist_ok=True)
    arrays: dict[str, Any] = {
        "reference_a": light(args.half_spp), "reference_b": light(args.half_spp),
        "means": np.stack(means), "counts": np.array(counts), "facts": np.str_(json.dumps(facts)),
        **planes, **averaged}
    np.savez(args.view, **arrays)


def many_planes(tracer: Any, view: Any, camera: Any, size: tuple[int, int],
                samples: int) -> dict[str, np.ndarray]:
    """Planes (H, W, C) that renderers average over samples, here over at least the given number."""
    from training.datagen.clip import AVERAGED, Style, film_of, plane_images

    style = Style("box", min(samples, AT_ONCE), np.zeros((1, 2), np.float32))
    passes = -(-samples // AT_ONCE)
    total: dict[str, np.ndarray] = {
        name: np.zeros((size[1], size[0], 1), np.float32) for name in AVERAGED}
    for _ in range(passes):
        film = film_of(size, style.offsets(0, size[0] * size[1], view.rng))
        planes = plane_images(tracer, view.built, (camera, camera), size, style, film)
        total = {name: total[name] + planes[name].reshape(size[1], size[0], -1) / passes
                 for name in AVERAGED}
    return {name: plane.astype(np.float32) for name, plane in total.items()}


def prefix_counts(most: int) -> list[int]:
    """1 to `most`: every whole number up to 4, then about four in an octave."""
    steps = 2.0 ** (np.arange(0, 4 * np.log2(most) + 1) / 4)
    return sorted({min(most, round(step)) for step in steps} | {min(most, n) for n in (1, 2, 3, 4)}
                  | {most})


def load_view(path: Path) -> dict[str, np.ndarray]:
    """All arrays of a view's file, by name."""
    with np.load(path) as file:
        return {name: file[name] for name in file.files}


class Errors:
    """Errors against a reference of two independent halves, without its noise. Images are (H, W,
    3)."""

    def __init__(self, half_a: np.ndarray, half_b: np.ndarray, exposure: float) -> None:
        self._exposure, self._mean = exposure, (half_a + half_b) / 2
        self.noise = {name: self._square(name, half_a, half_b) / 4 for name in MEASURES}

    def __call__(self, image: np.ndarray) -> dict[str, float]:
        """Mean square errors by measure: against the reference's mean, minus the noise of that
        mean."""
        found = {name: self._square(name, image, self._mean) - self.noise[name]
                 for name in MEASURES}
        return {name: max(value, 1e-12) for name, value in found.items()}

    def _square(self, measure: str, one: np.ndarray, other: np.ndarray) -> float:
        from postfx.colour.views import to_codes

        if measure == "seen":
            return float(np.square(to_codes(one, self._exposure) - to_codes(other, self._exposure))
                         .mean())
        weight = 1 / (np.square(self._mean) + 1e-2 / self._exposure**2)
        pixels = np.sort((np.square(one.astype(np.float64) - other) * weight).mean(-1).ravel())
        return float(pixels[: int(pixels.size * TRIMMED)].mean())


def find_crossing(counts: np.ndarray, curve: np.ndarray, error: float) -> float | None:
    """Count at which a curve of errors first falls to `error`, interpolated in log-log; None if it
    never does.

    An error above the whole curve gives the first count.
    """
    below = np.flatnonzero(curve <= error)
    if below.size == 0:
        return None
    at = int(below[0])
    if at == 0:
        return float(counts[0])
    x, y = np.log(counts[at - 1 : at + 1]), np.log(curve[at - 1 : at + 1])
    return float(np.exp(x[0] + (np.log(error) - y[0]) * (x[1] - x[0]) / (y[1] - y[0])))


def measure(args: argparse.Namespace) -> None:
    """Write the counts and the plot."""
    from postfx.tools.bench.metrics import grey_factor

    view = load_view(args.view)
    exposure = grey_factor((view["reference_a"] + view["reference_b"]) / 2)
    errors = Errors(view["reference_a"], view["reference_b"], exposure)
    rows = [errors(mean) for mean in view["means"]]
    curves = {name: np.array([row[name] for row in rows]) for name in MEASURES}
    results: dict[str, dict[str, Any]] = {}
    for name, pictures in _pictures(view, args).items():
        found = [errors(picture) for picture in pictures]
        mean = {key: float(np.mean([entry[key] for entry in found])) for key in MEASURES}
        counts = {key: find_crossing(view["counts"], curves[key], mean[key]) for key in MEASURES}
        results[name] = {"error": mean, "equivalent_samples": counts, "images": len(pictures)}
    facts = {"view": str(args.view), **json.loads(str(view["facts"])), "exposure": exposure,
             "reference_noise": errors.noise, "counts": view["counts"].tolist(),
             "curve": {name: curve.tolist() for name, curve in curves.items()}, "results": results}
    args.results.mkdir(parents=True, exist_ok=True)
    (args.results / "equivalent_samples.json").write_text(json.dumps(facts, indent=1) + "\n")
    plot(facts, args.results / "equivalent_samples.png")
    for name, row in results.items():
        text = ", ".join(f"{key} {_text(row['equivalent_samples'][key], facts)}"
                         for key in MEASURES)
        print(f"{name}: one sample a pixel is worth {text} samples")


def _pictures(view: dict[str, np.ndarray], args: argparse.Namespace) -> dict[str, list[np.ndarray]]:
    """Method -> results for the single images, each as the first frame of a sequence."""
    import postfx
    from postfx.frame import Role
    from postfx.passes.denoise.models import exact
    from postfx.tools.bench.baselines import Oidn

    frames = [postfx.Frame({Role(name): view[name][k] for name in PLANES}, exposure=None, samples=1)
              for k in range(len(view["colour"]))]
    device = postfx.Device(args.device)
    found: dict[str, list[np.ndarray]] = {}
    for tag in args.model.split(","):
        pipeline = postfx.Pipeline([postfx.DenoiseUpscale(scale=1, model=exact(tag))], device)
        found[tag] = []
        for frame in frames:
            pipeline.reset()
            found[tag].append(pipeline(frame)[Role.COLOUR])
    if not args.no_oidn:
        oidn = Oidn("high", "cpu", device.threads)
        found["OIDN high"] = [oidn(frame) for frame in frames]
    return found


def plot(facts: dict[str, Any], path: Path) -> None:
    """Convergence curves, the errors of the methods, and their intersections; a PNG."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(12, 5.2), dpi=110, layout="constrained")
    FigureCanvasAgg(figure)
    for axes, (key, title) in zip(figure.subplots(1, 2), MEASURES.items(), strict=True):
        axes.loglog(facts["counts"], facts["curve"][key], ".-", color="#333333",
                    label="mean of that many images")
        for colour, (name, row) in zip(COLOURS, facts["results"].items(), strict=False):
            error, count = row["error"][key], row["equivalent_samples"][key]
            label = f"{name}, 1 sample a pixel: worth {_text(count, facts)}"
            axes.axhline(error, color=colour, linewidth=1.2, label=label)
            if count is not None:
                axes.plot([count], [error], "o", color=colour, markersize=9)
        axes.set_xlabel("samples a pixel")
        axes.set_ylabel(title)
        axes.grid(True, which="major", color="#dddddd")
        axes.legend(fontsize=9, loc="lower left")
    figure.suptitle(f"{facts['scene']}, seed {facts['seed']}: one frame at its own size, no "
                    "history")
    figure.savefig(path)


def _text(count: float | None, facts: dict[str, Any]) -> str:
    return f"over {facts['counts'][-1]}" if count is None else f"{count:.1f}"


if __name__ == "__main__":
    parsed = arguments()
    {"render": render, "measure": measure}[parsed.command](parsed)
