"""Samples that `postfx loop` spends, beside uniform ones and the renderer's own adaptive sampling,
at the same error.

    python -m training.measure.render_more WORK --cycles water,leaves --mitsuba box,room \\
        --blender PYTHON

Each scene is one frame. WORK/SCENE gets independent renders of 4, 4, 8, 16, 32 and 64 samples a
pixel, which are the uniform ones, and merged for 128 and for predictions; a reference; renders with
Cycles' adaptive sampling, and loops that start at 8 samples and whose budget doubles them until
there are 64: one for each way in --error, where the error comes from. All are denoised by --model,
as single frames. What exists is not rendered again.

Prints for each scene and each number of samples: PSNR, mean FLIP and the FLIP that nine of ten
tiles stay below, of uniform sampling. For the loops and for adaptive sampling: their samples as a
share of the uniform ones with the same figure, by interpolation; and the same of the best spread of
samples over the tiles, had their FLIP been known. Then the share of tiles whose error was predicted
within a quarter and within a factor of two: by the network, from two halves, from the error of one
half alone, which falls with the root of the samples, and from the noise.

References have noise of their own, which would hide small errors. FLIP compares with the denoised
reference. Squared errors are those to the reference without its noise, which its distance from the
largest uniform render tells. Tiles where it is more than a third of the error do not count for
predictions, nor do those that are right within 60 dB.

PYTHON is an interpreter with the module bpy. Cycles' scenes are those of
training/measure/validation, Mitsuba's are mitsuba_NAME.py there, or files of others: NAME.xml,
whose film should be as small.
"""

from __future__ import annotations

import argparse
import itertools
import json
import shlex
import shutil
import subprocess
import sys
from collections.abc import Sequence
from contextlib import redirect_stdout
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from postfx import DenoiseUpscale, Device, Frame, Pipeline, read_sequence
from postfx.cli.main import main as postfx
from postfx.colour.views import to_codes
from postfx.frame import Role
from postfx.io.exr.merge import merge_renders
from postfx.masks.noise import count_unit
from postfx.passes.denoise.models import UNSCALED, model_of, predicts_error
from postfx.tools.adaptive.estimate import error_of_half, estimate_error, estimate_from_halves
from postfx.tools.adaptive.plan import SLOPE, tile_sums
from postfx.tools.bench.metrics import grey_factor

ROOT = Path(__file__).resolve().parents[2]
SCENES = ROOT / "training/measure/validation"
BLOCKS = (4, 4, 8, 16, 32, 64)
"""Samples a pixel of independent renders; the sums of the first ones are the uniform counts."""
SEED = 9000
START = 8
"""Samples a pixel that a loop starts with."""
ROUNDS = {16: 1, 32: 2, 64: 3}
"""Samples a pixel in the mean -> rounds that double them to that."""
QUALITY = "flip=0.005"
"""Below what any tile reaches, so that the budget decides."""
WORST = 90
"""Percentile of the tiles' FLIP."""
MOST_NOISE_RATIO = 3
"""Times the reference's noise that a tile's error to it must be, to count for predictions."""
DONE = 1e-6
"""Squared error, 60 dB, below which a tile needs no prediction."""
NEAR, FAR = 1.25, 2.0
"""Factors between predicted and measured errors."""
SPREAD_STEPS = 41
"""Counts of samples that the best spread chooses from."""


@dataclass(frozen=True)
class Figures:
    """A denoised picture against the reference. `tiles`: the FLIP that nine of ten tiles stay
    below; `of_tiles`: each one's."""

    samples: float
    decibels: float
    flip: float
    tiles: float
    of_tiles: np.ndarray


class Scene:
    """A scene of one renderer, and its files."""

    def __init__(self, folder: Path, render: Sequence[str], number: int) -> None:
        self.folder, self.render, self.number = folder, render, number
        folder.mkdir(parents=True, exist_ok=True)

    def block(self, index: int) -> Path:
        """One of the independent renders."""
        return self.folder / f"block.{index}.exr"

    def uniform(self, index: int) -> Path:
        """The first renders up to this one, merged."""
        return self.folder / f"cum.{index}.exr" if index else self.block(0)

    @property
    def reference(self) -> Path:
        return self.folder / "reference.exr"

    def make(self, samples: int) -> None:
        """Render what is missing."""
        wanted = [(self.block(index), count, SEED + index) for index, count in enumerate(BLOCKS)]
        wanted.append((self.reference, samples, SEED - 1))
        jobs = [{"frame": self.number, "region": None, "samples": count, "seed": seed,
                 "output": str(path)}
                for path, count, seed in wanted if not path.exists()]
        if jobs:
            (self.folder / "jobs.json").write_text(json.dumps({"jobs": jobs}))
            call([*self.render, str(self.folder / "jobs.json")])
        for index in range(1, len(BLOCKS)):
            if not self.uniform(index).exists():
                merge_renders([self.uniform(index - 1), self.block(index)], self.uniform(index))

    def loop(self, samples: int, way: str, given: argparse.Namespace) -> Path:
        """The denoised frame of a loop that was given so many samples; way: where its error comes
        from. The render lies beside it."""
        kept = self.folder / f"loop.{way}.{samples}.exr"
        if kept.exists():
            return kept
        output = self.folder / f"loop.{way}"
        render = shlex.join([*self.render, "{jobs}"])
        words = ["loop", "--render", render, "-o", f"{output}/####.exr", "--frames",
                 str(self.number),
                 "--samples", str(START), "--quality", QUALITY, "--tile", str(given.tile),
                 "--json", "--budget", str(samples - START), "--rounds", str(ROUNDS[samples]),
                 "--error", way, "--", "--model", given.model]
        with redirect_stdout(sys.stderr):
            if postfx(words):
                raise SystemExit(f"{shlex.join(words)}: failed")
        shutil.copy(output / "loop/merged" / f"{self.number:04}.exr",
                    kept.with_suffix(".render.exr"))
        return Path(shutil.copy(output / f"{self.number:04}.exr", kept))


class Judge:
    """Compares denoised pictures of a scene with its reference."""

    def __init__(self, scene: Scene, given: argparse.Namespace) -> None:
        self._tile = given.tile
        self.predicts = predicts_error(model_of(given.model, UNSCALED))
        denoise = DenoiseUpscale(scale=1.0, model=given.model, error=self.predicts)
        self._pipeline = Pipeline([denoise], Device("cpu"))
        reference, largest = read(scene.reference), read(scene.uniform(len(BLOCKS) - 1))
        self.exposure = grey_factor(reference[Role.COLOUR])
        self._clean = self._codes_of(self.denoise(reference))
        self._codes = self._codes_of(reference[Role.COLOUR])
        share = mean_samples(largest) / (mean_samples(largest) + mean_samples(reference))
        self._noise = (share * np.square(self._codes - self._codes_of(largest[Role.COLOUR]))
                       .mean(axis=2))

    def denoise(self, frame: Frame) -> np.ndarray:
        """The colour of a frame alone, denoised."""
        return self.run(frame)[Role.COLOUR]

    def run(self, frame: Frame) -> Frame:
        """A frame alone, denoised, with the plane of its error if the network predicts it."""
        self._pipeline.reset()
        return self._pipeline(frame)

    def figures(self, colour: np.ndarray, samples: float) -> Figures:
        """A denoised colour's figures."""
        import flip_evaluator

        errors, mean, _ = flip_evaluator.evaluate(self._clean, self._codes_of(colour), "LDR",
                                                  applyMagma=False)
        of_tiles = self.tiles(errors[:, :, 0])
        return Figures(samples, float(-10 * np.log10(self.error(colour).mean())), float(mean),
                       float(np.percentile(of_tiles, WORST)), of_tiles)

    def error(self, colour: np.ndarray) -> np.ndarray:
        """Squared error of a denoised colour's pixels, in the mean without the reference's
        noise."""
        squared = np.square(self._codes_of(colour) - self._codes).mean(axis=2)
        return np.asarray(squared - self._noise)

    def _codes_of(self, colour: np.ndarray) -> np.ndarray:
        return np.asarray(to_codes(colour, self.exposure), np.float32)

    def tiles(self, plane: np.ndarray) -> np.ndarray:
        """Means of a plane's tiles."""
        sums, pixels = (tile_sums(one, self._tile) for one in (plane, np.ones_like(plane)))
        return np.asarray(sums / pixels).ravel()

    def predicted(self, scene: Scene, index: int) -> dict[str, np.ndarray]:
        """Way to predict -> the predicted error of the tiles over what was measured."""
        halves = [read(scene.uniform(index - 1)), read(scene.block(index))]
        whole = read(scene.uniform(index))
        result = self.run(whole)
        colour = result[Role.COLOUR].copy()
        planes = {"network": result[Role.ERROR][:, :, 0].copy()} if self.predicts else {}
        error, noise = self.tiles(self.error(colour)), self.tiles(self._noise)
        is_clear = (error > noise * (MOST_NOISE_RATIO - 1)) & (error > DONE)
        colours = halves[0][Role.COLOUR], halves[1][Role.COLOUR]
        clean = self.denoise(halves[0]), self.denoise(halves[1])
        both = estimate_from_halves(colours, (*clean, colour), self.exposure, self._tile)
        half = error_of_half(colours, clean, self.exposure, self._tile).ravel() / 2**SLOPE
        found = {name: self.tiles(plane) for name, plane in planes.items()}
        found |= {"halves": self.tiles(both), "one half": half,
                 "noise": self.tiles(estimate_error(whole, colour, self.exposure))}
        return {name: made[is_clear] / error[is_clear] for name, made in found.items()}


def read(path: Path) -> Frame:
    """The frame of a file."""
    sequence = read_sequence(path)
    return sequence.read(sequence.numbers[0])


def mean_samples(frame: Frame) -> float:
    """Samples a pixel of a render, in the mean."""
    counts = frame[Role.SAMPLE_COUNT]
    return float(counts.mean() * count_unit(counts, frame.samples))


def call(words: Sequence[str]) -> None:
    """Run a renderer, whose output matters only if it fails."""
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    if done.returncode:
        said = f"{done.stdout[-2000:]}{done.stderr[-2000:]}"
        raise SystemExit(f"{shlex.join(words)}: exit code {done.returncode}\n{said}")


def equivalent(counts: Sequence[float], values: Sequence[float], value: float) -> float:
    """Samples at which a curve that falls has a value, by interpolation of logarithms; NaN beyond
    its ends."""
    falling = np.minimum.accumulate(np.log(values))
    if not falling[-1] <= np.log(value) <= falling[0]:
        return float("nan")
    return float(np.exp(np.interp(-np.log(value), -falling, np.log(counts))))


def shares(curve: Sequence[Figures], figures: Figures) -> list[float]:
    """Samples as a share of the uniform ones with the same FLIP, squared error and FLIP of the
    tiles."""
    counts = [one.samples for one in curve]
    pairs = [([one.flip for one in curve], figures.flip),
             ([10 ** (-one.decibels / 10) for one in curve], 10 ** (-figures.decibels / 10)),
             ([one.tiles for one in curve], figures.tiles)]
    return [figures.samples / equivalent(counts, values, value) for values, value in pairs]


def best_spread(curves: np.ndarray, counts: Sequence[float], samples: float) -> float:
    """Samples of the best spread over tiles as a share of the uniform ones, where the mean of the
    figure is the same.

    curves: the figure of each tile (counts, tiles), by samples a pixel, which fall with them;
    between those, and from `START` on, their logarithms are interpolated. Each further sample goes
    where it lowers the figure most, until there are ``samples`` in the mean.
    """
    steps = np.exp(np.linspace(np.log(START), np.log(counts[-1]), SPREAD_STEPS))
    falling = np.log(np.maximum(np.minimum.accumulate(curves), DONE))
    figures = np.exp([np.interp(np.log(steps), np.log(counts), tile) for tile in falling.T])
    low, high = 1e-12, 1e3
    for _ in range(80):
        price = np.sqrt(low * high)
        chosen = (figures + price * steps).argmin(axis=1)
        low, high = (price, high) if steps[chosen].mean() > samples else (low, price)
    chosen = (figures + high * steps).argmin(axis=1)
    reached = np.take_along_axis(figures, chosen[:, None], 1).mean()
    whole = np.exp(falling).mean(axis=1)
    return float(steps[chosen].mean()) / equivalent(counts, list(whole), float(reached))


def within(ratios: np.ndarray, factor: float) -> float:
    """Share of ratios that lie within a factor of 1."""
    return float((np.abs(np.log(ratios)) <= np.log(factor)).mean()) if len(ratios) else float("nan")


def row(name: str, figures: Figures, ratios: Sequence[float] = ()) -> str:
    """A line of the table."""
    told = "".join(f" {ratio:6.2f}" for ratio in ratios)
    return (f"{name:28} {figures.samples:6.1f} {figures.decibels:6.2f} {figures.flip:.4f} "
            f"{figures.tiles:.4f}{told}")


def measure(scene: Scene, given: argparse.Namespace) -> dict[str, list[list[float]]]:
    """Print a scene's table; returns its shares, and its predictions' ratios, by what they are
    of."""
    name, judge = scene.folder.name, Judge(scene, given)
    counts = np.cumsum(BLOCKS)
    paths = ([scene.block(index) for index in range(1, len(BLOCKS))]
             + [scene.uniform(len(BLOCKS) - 1)])
    curve = [judge.figures(judge.denoise(frame), mean_samples(frame)) for frame in map(read, paths)]
    for figures in curve:
        print(row(f"{name} uniform", figures), flush=True)
    found: dict[str, list[list[float]]] = {}
    for samples, way in itertools.product(given.samples, given.error):
        path = scene.loop(samples, way, given)
        render = read(path.with_suffix(".render.exr"))
        figures = judge.figures(read(path)[Role.COLOUR], mean_samples(render))
        found[f"loop {samples} {way}"] = [shares(curve, figures)]
        print(row(f"{name} loop {way}", figures, found[f"loop {samples} {way}"][0]), flush=True)
    for samples in given.samples:
        spread = best_spread(np.stack([one.of_tiles for one in curve]),
                             [one.samples for one in curve], samples)
        found[f"spread {samples}"] = [[spread]]
        print(f"{name} best spread of {samples}: {spread:.2f} for the same FLIP", flush=True)
    for path in sorted(scene.folder.glob("adaptive.*.exr")):
        render = read(path)
        # sampling ended early everywhere, and Cycles does not say with how many samples
        if np.ptp(render[Role.SAMPLE_COUNT]) == 0:
            continue
        figures = judge.figures(judge.denoise(render), mean_samples(render))
        found.setdefault("adaptive", []).append(shares(curve, figures))
        print(row(f"{name} {path.stem}", figures, found["adaptive"][-1]), flush=True)
    for index in range(1, len(BLOCKS)):
        ways = judge.predicted(scene, index)
        for key, ratios in ways.items():
            found.setdefault(key, []).append(ratios.tolist())
        told = ", ".join(f"{key} {within(ratios, NEAR):.0%} {within(ratios, FAR):.0%}"
                         for key, ratios in ways.items())
        print(f"{name} {counts[index]} samples, {len(ways['halves'])} tiles predicted within "
              f"{NEAR}, {FAR}: {told}", flush=True)
    return found


def scenes(given: argparse.Namespace) -> list[Scene]:
    """All scenes, rendered."""
    found = []
    for kind in filter(None, given.cycles.split(",")):
        blend = given.work / "scenes" / f"{kind}.blend"
        script = [given.blender, str(SCENES / "save_scenes.py")]
        call([*script, "--out", str(blend.parent), "save", "--kinds", kind, "--size", given.size])
        render = [given.blender, str(ROOT / "hosts/loop/render_blender.py"), str(blend)]
        found.append(Scene(given.work / kind, render, 2))
        found[-1].make(given.reference)
        call([*script, "--out", str(found[-1].folder), "adaptive", "--scene", str(blend),
              "--thresholds", given.thresholds])
    for name in filter(None, given.mitsuba.split(",")):
        file = Path(name) if name.endswith(".xml") else SCENES / f"mitsuba_{name}.py"
        render = [sys.executable, str(ROOT / "hosts/loop/render_mitsuba.py"), str(file)]
        found.append(Scene(given.work / file.stem, render, 1))
        found[-1].make(given.reference)
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("work", type=Path, help="folder of the renders")
    parser.add_argument("--cycles", default="", help="kinds of scenes")
    parser.add_argument("--mitsuba", default="", help="names of scenes, or XML files")
    parser.add_argument("--blender", default=sys.executable, help="Python with the module bpy")
    parser.add_argument("--size", default="160x96",
                        help="of Cycles' pictures (default: %(default)s)")
    parser.add_argument("--tile", type=int, default=16,
                        help="side of the tiles (default: %(default)s)")
    parser.add_argument("--samples", type=lambda text: [int(word) for word in text.split(",")],
                        default=[16, 64],
                        help=f"of the loop, of {', '.join(map(str, ROUNDS))} (default: 16,64)")
    parser.add_argument("--model", default="xl", help="network (default: %(default)s)")
    parser.add_argument("--error", type=lambda text: text.split(","),
                        default=["halves", "network"],
                        help="where loops have the error from (default: halves,network)")
    parser.add_argument("--reference", type=int, default=512,
                        help="samples a pixel of references (default: 512)")
    parser.add_argument("--thresholds", default="0.6,0.2,0.07", help="of Cycles' adaptive sampling")
    given = parser.parse_args()
    given.work = given.work.resolve()
    print(f"{'':28} samples PSNR   FLIP   tiles   samples over uniform ones: FLIP, PSNR, tiles")
    found = [measure(scene, given) for scene in scenes(given)]
    for key in (f"loop {samples} {way}" for samples in given.samples for way in given.error):
        print(f"mean of {key}:",
              *(f"{value:.2f}" for value in np.nanmean([one[key][0] for one in found], axis=0)))
    for key in ("network", "halves", "one half", "noise"):
        if key not in found[0]:
            continue
        ratios = np.concatenate([ratios for one in found for ratios in one[key]])
        print(f"tiles predicted from {key} within {NEAR}: {within(ratios, NEAR):.0%}, within "
              f"{FAR}: {within(ratios, FAR):.0%}; half of them within "
              f"{np.exp(np.median(np.abs(np.log(ratios)))):.2f}")


if __name__ == "__main__":
    main()
