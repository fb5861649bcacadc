"""Properties that a denoiser must have, tested on content made by formula, whose truth is known
without noise.

    python -m training.measure.properties [--models m,s] [--cases wall,text] [--json FILE] \\
        [--sheet FILE.png]

Cases: `wall` and `floor`, remaining noise as samples double; `planes`, albedo of few samples;
`text` and `speckle`, texture of one pixel at 1x; `lamps` and `sign`, light that must be kept;
`ghost`, an object with the world's motion vectors. Open Image Denoise (high quality, albedo and
normal, enlarged by cubic interpolation) gets the same frames. Decibels compare displayed pictures:
exposure 1, x/(1+x) and the sRGB curve. --sheet draws the cases beside their truth.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from postfx import DenoiseUpscale, Device, Frame, Pipeline
from postfx.colour.views import to_codes
from postfx.frame import Role
from postfx.tools.bench.baselines import HostKernels, Oidn

SIDE = 96  # render pixels
SAMPLES = tuple(2**k for k in range(11))
FEW = (1, 2, 4, 8, 16, 64)
FLAT = 8  # render pixels at the border that are not judged
Picture = np.ndarray


@dataclass
class Case:
    """Frames of a shot and the `truth` (H, W, 3) of the last one at `scale` times the render size.

    `facts` name what varies within a series; `where` (H, W) masks the pixels to judge, None for
    all.
    """

    name: str
    scale: float
    frames: list[Frame]
    truth: Picture
    facts: dict[str, float] = field(default_factory=dict)
    where: Picture | None = None


# Pictures by formula ------------------------------------------------------------------------------

def grid(size: int) -> tuple[Picture, Picture]:
    """Columns and rows of pixel centres over a picture, each in [0, 1]."""
    line = (np.arange(size) + 0.5) / size
    return np.meshgrid(line, line)


def grey(plane: Picture) -> Picture:
    return np.repeat(np.asarray(plane, np.float32)[..., None], 3, -1)


def few_samples(random: np.random.Generator, light: Picture, samples: int) -> Picture:
    """The mean of `samples` samples of a pixel, whose standard deviation is the light itself."""
    return light * random.gamma(samples, 1 / samples, light.shape[:2])[..., None].astype(np.float32)


def fireflies(random: np.random.Generator, light: Picture, samples: int, chance: float = 0.02,
              share: float = 0.3) -> Picture:
    """The mean of samples, a few of which carry a share of the light."""
    hits = random.binomial(samples, chance, light.shape[:2]) / (samples * chance)
    return (few_samples(random, light, samples) * (1 - share)
            + light * share * hits[..., None].astype(np.float32))


def frame(colour: Picture, albedo: Picture, depth: Picture | None = None, number: int = 0) -> Frame:
    size = colour.shape[:2]
    planes = {Role.COLOUR: colour, Role.DIFFUSE_ALBEDO: albedo, Role.SPECULAR_ALBEDO: 0 * albedo,
              Role.NORMAL: np.broadcast_to(np.array([0, 0, 1], np.float32), (*size, 3)),
              Role.ROUGHNESS: np.ones((*size, 1)),
              Role.DEPTH: np.full((*size, 1), 5.0) if depth is None else depth,
              Role.MOTION: np.zeros((*size, 2))}
    return Frame({role: np.ascontiguousarray(plane, np.float32) for role, plane in planes.items()},
                 number=number, exposure=0.0, reset=number == 0)


def letters(size: int, random: np.random.Generator) -> Picture:
    """Strokes of one and two pixels in rows, like small text: 1 for ink."""
    ink = np.zeros((size, size), np.float32)
    for top in range(4, size - 10, 12):
        for left in range(4, size - 8, 7):
            for _ in range(3):
                across, at = random.integers(2), random.integers(5)
                if across:
                    ink[top + 2 * at - at // 4:top + 2 * at - at // 4 + 1, left:left + 5] = 1
                else:
                    ink[top:top + 9, left + at:left + at + 1] = 1
    return ink


# Cases --------------------------------------------------------------------------------------------

def smooth_wall(size: int) -> tuple[Picture, Picture]:
    """Light and albedo of a wall lit from one side."""
    x, y = grid(size)
    return grey(0.25 + 0.75 * x * (1 - 0.3 * y)), grey(0 * x + 0.6)


def white_floor(size: int) -> tuple[Picture, Picture]:
    """Light and albedo of a white floor with a soft shadow."""
    x, y = grid(size)
    shadow = 1 / (1 + np.exp(-(x + 0.4 * y - 0.7) * 9))
    return grey(0.3 + 0.9 * shadow * (0.6 + 0.4 * y)), grey(0 * x + 0.8)


def wall(scale: float) -> Iterator[Case]:
    yield from _series("wall", smooth_wall, few_samples, scale)


def floor(scale: float) -> Iterator[Case]:
    yield from _series("floor", white_floor, fireflies, scale)


def _series(name: str, surface: Callable[[int], tuple[Picture, Picture]],
            sampled: Callable[[np.random.Generator, Picture, int], Picture],
            scale: float) -> Iterator[Case]:
    light, albedo = surface(SIDE)
    truth = np.prod(surface(round(SIDE * scale)), axis=0)
    for samples in SAMPLES:
        random = np.random.default_rng(samples)
        colour = sampled(random, light, samples) * albedo
        yield Case(name, scale, [frame(colour, albedo)], truth, {"spp": samples},
                   inner(truth.shape[:2], scale))


def inner(size: tuple[int, int], scale: float) -> Picture:
    """Everything except the border."""
    edge, mask = round(FLAT * scale), np.zeros(size, bool)
    mask[edge:-edge, edge:-edge] = True
    return mask


def planes(scale: float) -> Iterator[Case]:
    """Texture out of focus: light of 64 samples, and albedo of a few, each at another point of the
    texture."""
    x, y = grid(SIDE)
    mean = 0.35 + 0.2 * np.sin(5 * x) * np.cos(4 * y)
    light, truth_x, truth_y = grey(0.5 + 0.4 * x), *grid(round(SIDE * scale))
    truth = grey(0.5 + 0.4 * truth_x) * grey(0.35 + 0.2 * np.sin(5 * truth_x) * np.cos(4 * truth_y))
    for samples in FEW:
        random = np.random.default_rng(samples)
        hits = random.binomial(samples, mean) / samples  # black and white texture
        albedo = grey(0.02 + 0.96 * hits)
        colour = few_samples(random, light, 64) * grey(0.02 + 0.96 * random.binomial(64, mean) / 64)
        where = inner(truth.shape[:2], scale)
        yield Case("planes", scale, [frame(colour, albedo)], truth, {"albedo spp": samples}, where)


def text(scale: float) -> Iterator[Case]:
    """Black strokes on white paper at the render size, with exact planes: without noise, and at
    four samples."""
    albedo = grey(0.85 - 0.8 * letters(SIDE, np.random.default_rng(1)))
    yield from _exact("text", albedo)


def speckle(scale: float) -> Iterator[Case]:
    albedo = grey(np.random.default_rng(2).choice([0.1, 0.45, 0.8], (SIDE, SIDE)))
    yield from _exact("speckle", albedo)


def _exact(name: str, albedo: Picture) -> Iterator[Case]:
    light = smooth_wall(SIDE)[0]
    random = np.random.default_rng(3)
    yield Case(name, 1, [frame(light * albedo, albedo)], light * albedo, {"spp": np.inf})
    yield Case(name, 1, [frame(few_samples(random, light, 4) * albedo, albedo)], light * albedo,
               {"spp": 4})


def lamps(scale: float) -> Iterator[Case]:
    """Discs of lamps out of focus, hit by few samples, over a dark street: eight identical
    views."""
    def light(size: int) -> Picture:
        x, y = grid(size)
        discs = np.zeros_like(x)
        for u, v, radius, value in ((0.25, 0.3, 0.07, 12.0), (0.6, 0.25, 0.1, 6.0),
                                    (0.45, 0.7, 0.08, 20.0), (0.8, 0.65, 0.05, 9.0)):
            discs = discs + np.clip((radius - np.hypot(x - u, y - v)) * size + 0.5, 0, 1) * value
        return grey(0.02 + discs) * np.array([1.0, 0.85, 0.6], np.float32)

    at_render, truth = light(SIDE), light(round(SIDE * scale))
    frames = []
    for number in range(8):
        random = np.random.default_rng(number)
        hits = random.binomial(16, 0.04, (SIDE, SIDE)) / (16 * 0.04)
        colour = 0.02 + (at_render - 0.02) * hits[..., None]
        frames.append(frame(colour, np.zeros_like(at_render), number=number))
    yield Case("lamps", scale, frames, truth)


def sign(scale: float) -> Iterator[Case]:
    """Thin bright strokes over a dark scene, without noise; the output must keep the render's
    light."""
    ink = letters(SIDE, np.random.default_rng(4))
    colour = grey(0.02 + 5 * ink)
    rows = (np.arange(round(SIDE * scale)) * SIDE // round(SIDE * scale))
    yield Case("sign", scale, [frame(colour, 0 * colour)], colour[rows][:, rows])


def ghost(scale: float) -> Iterator[Case]:
    """A box that moves six pixels a frame over a wall, with vectors that say it stands still; eight
    samples."""
    light, albedo = smooth_wall(SIDE)
    size, frames = round(SIDE * scale), []
    for number in range(6):
        box = np.zeros((SIDE, SIDE, 1), np.float32)
        box[30:60, 10 + 6 * number:34 + 6 * number] = 1
        own = albedo * (1 - box) + np.array([0.7, 0.12, 0.1], np.float32) * box
        noisy = few_samples(np.random.default_rng(number), light, 8) * own
        frames.append(frame(noisy, own, depth=5 - 3 * box, number=number))
    rows = np.arange(size) * SIDE // size
    truth = smooth_wall(size)[0] * own[rows][:, rows]
    trail = np.zeros((size, size), bool)
    trail[round(24 * scale):round(66 * scale), round(4 * scale):round(70 * scale)] = True
    yield Case("ghost", scale, frames, truth, where=trail)


CASES: dict[str, tuple[Callable[[float], Iterator[Case]], tuple[float, ...]]] = {
    "wall": (wall, (1, 1.5, 2, 3)), "floor": (floor, (1, 1.5, 2, 3)), "planes": (planes, (1, 2)),
    "text": (text, (1,)), "speckle": (speckle, (1,)), "lamps": (lamps, (1, 2)),
    "sign": (sign, (1, 2)), "ghost": (ghost, (1, 2)),
}
"""Name -> the function that makes its cases at a scale, and the scales."""


# Methods and measures -----------------------------------------------------------------------------

Method = Callable[[list[Frame], float], Picture]


def network(model: str, planes: bool = True) -> Method:
    """The last output of a shot, by a network, with planes or without."""
    def run(frames: list[Frame], scale: float) -> Picture:
        passes = Pipeline([DenoiseUpscale(scale=scale, model=model)], Device("cpu"),
                          exposure="metadata")
        return [passes(one if planes else _bare(one))[Role.COLOUR] for one in frames][-1]
    return run


def alone(method: Method) -> Method:
    """The last frame by itself."""
    return lambda frames, scale: method(frames[-1:], scale)


def oidn(frames: list[Frame], scale: float) -> Picture:
    size = round(SIDE * scale)
    return _kernels().enlarge(_oidn()(frames[-1]), size, size, (0.0, 0.0))


@cache
def _oidn() -> Oidn:
    return Oidn("high", "cpu", 2)


@cache
def _kernels() -> HostKernels:
    return HostKernels(Device("cpu"))


def _bare(one: Frame) -> Frame:
    return Frame({role: one[role] for role in (Role.COLOUR, Role.MOTION)}, number=one.number,
                 exposure=0.0, reset=one.reset)


def measure(case: Case, picture: Picture) -> dict[str, float]:
    """PSNR in dB over the judged pixels, deviation from the truth, and the share of light that is
    kept."""
    where = np.ones(picture.shape[:2], bool) if case.where is None else case.where
    error = (to_codes(picture, 1.0) - to_codes(case.truth, 1.0))[where]
    return {"psnr": float(-10 * np.log10(np.mean(error**2) + 1e-12)), "noise": float(np.std(error)),
            "light": float(picture[where].sum() / case.truth[where].sum())}


def methods_of(name: str, models: list[str]) -> dict[str, Method]:
    """The methods of a case: OIDN, each network, and networks without planes that should help
    them."""
    found: dict[str, Method] = {"oidn": oidn} | {model: network(model) for model in models}
    if name == "planes":
        found |= {f"{model} without planes": network(model, planes=False) for model in models}
    if name == "ghost":
        found |= {f"{model} alone": alone(network(model)) for model in models}
    return found


def score(names: list[str], models: list[str]) -> list[dict[str, Any]]:
    """A row for each case and method."""
    rows: list[dict[str, Any]] = []
    for name in names:
        make, scales = CASES[name]
        for scale in scales:
            for case in make(scale):
                for method, run in methods_of(name, models).items():
                    rows.append({"case": name, "scale": scale, **case.facts, "method": method,
                                 **measure(case, run(case.frames, scale))})
        print(f"{name}: {len(rows)} rows", file=sys.stderr, flush=True)
    return rows


def table(rows: list[dict[str, Any]]) -> str:
    """Markdown: a line for each case, PSNR and light of each method."""
    methods = list(dict.fromkeys(str(row["method"]) for row in rows))
    lines = ["| case | scale | | " + " | ".join(methods) + " |",
             "| --- | --- | --- |" + " --- |" * len(methods)]
    found: dict[tuple[str, float, str], dict[str, str]] = {}
    for row in rows:
        facts = ", ".join(f"{key} {row[key]:g}" for key in ("spp", "albedo spp") if key in row)
        cell = f"{row['psnr']:.2f}" + (f", light {row['light']:.2f}"
                                       if row["case"] in ("lamps", "sign") else "")
        found.setdefault((str(row["case"]), float(row["scale"]), facts),
                         {})[str(row["method"])] = cell
    lines += ["| " + " | ".join((case, f"{scale:g}x", facts, *(cells.get(m, "") for m in methods)))
              + " |" for (case, scale, facts), cells in found.items()]
    return "\n".join(lines)


def rises(rows: list[dict[str, Any]], method: str) -> list[str]:
    """Steps at which noise rises by more than 5 % or PSNR falls by more than 0.05 dB as samples
    double."""
    found = []
    for case in ("wall", "floor"):
        for scale in CASES[case][1]:
            mine = [row for row in rows
                    if (row["case"], row["scale"], row["method"]) == (case, scale, method)]
            series = sorted(mine, key=lambda row: row["spp"])
            for before, after in zip(series, series[1:], strict=False):
                if after["noise"] > 1.05 * before["noise"] or after["psnr"] < before["psnr"] - 0.05:
                    found.append(f"{case} {scale:g}x, {before['spp']} to {after['spp']} samples: "
                                 f"{before['psnr']:.2f} dB, then {after['psnr']:.2f}")
    return found


def draw(names: list[str], model: str, path: Path) -> None:
    """Rows of input, Open Image Denoise, the network and the truth, of the first and the last case
    of each name."""
    from PIL import Image

    lines = []
    for name in names:
        make, scales = CASES[name]
        cases = list(make(scales[-1]))
        for case in (cases[0], cases[-1]) if len(cases) > 1 else cases:
            size = round(SIDE * case.scale)
            rows = np.arange(size) * SIDE // size
            cells = [case.frames[-1][Role.COLOUR][rows][:, rows], oidn(case.frames, case.scale),
                     network(model)(case.frames, case.scale), case.truth]
            pictures = [np.asarray(Image.fromarray((255 * to_codes(cell, 1.0)).astype(np.uint8))
                                   .resize((256, 256), 0))
                        for cell in cells]
            lines.append(np.concatenate(pictures, 1))
    Image.fromarray(np.concatenate(lines)).save(path)


def main(argv: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--models", default="m", help="tags of networks, comma-separated")
    parser.add_argument("--cases", default=",".join(CASES), help="names of cases, comma-separated")
    parser.add_argument("--json", type=Path, help="write all rows there")
    parser.add_argument("--sheet", type=Path, metavar="PNG",
                        help="draw the cases by the first network")
    args = parser.parse_args(argv)
    names, models = args.cases.split(","), args.models.split(",")
    if unknown := set(names) - set(CASES):
        parser.error(f"no case '{', '.join(sorted(unknown))}': there are {', '.join(CASES)}")
    if args.sheet:
        draw(names, models[0], args.sheet)
    rows = score(names, models)
    if args.json:
        args.json.write_text(json.dumps(rows, indent=1))
    print(table(rows))
    for model in models:
        for line in rises(rows, model):
            print(f"{model} gets worse: {line}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
