"""Denoised alpha: composites over three backgrounds with alpha resampled, denoised and true.

python -m training.measure.alpha [--model m] [--scales 1,2]
python -m training.measure.alpha --cost [--model m]   what alpha takes of a frame's time, one thread

Fur and a translucent disc, drawn by formula: 128x128 at 4 samples a pixel, six frames, still and
moving, light with exponential noise; the truth has 256 samples a pixel (128 at 2x). Prints PSNR of
the last frame's composites as sRGB.
"""

from __future__ import annotations

import argparse
from typing import NamedTuple

import numpy as np

from postfx.colour.displays import srgb_encode
from postfx.frame import Frame, Role
from postfx.passes.denoise import DenoiseUpscale
from postfx.pipeline import Pipeline
from postfx.runtime import Device
from postfx.tools.bench.metrics import psnr
from training.measure.parts import busy

SIDE, HAIRS, FRAMES, SAMPLES = 128, 140, 6, 4
GREYS = {"black": 0.0, "grey": 0.18, "white": 1.0}
MOVES = {"still": (0.0, 0.0), "moving": (1.3, 0.4)}
"""Pixels a frame, right and down."""


class Hairs(NamedTuple):
    """Root, way to the tip, half width at the root and colour of each hair, in pixels of the
    render."""

    root: np.ndarray
    way: np.ndarray
    width: np.ndarray
    colour: np.ndarray

    @classmethod
    def grown(cls) -> Hairs:
        """Hairs at random, alike in every call."""
        random = np.random.default_rng(5)
        root = np.stack([random.uniform(10, SIDE - 10, HAIRS), random.uniform(60, SIDE - 3, HAIRS)],
                        1)
        angle, length = random.normal(-np.pi / 2, 0.5, HAIRS), random.uniform(25, 60, HAIRS)
        way = length[:, None] * np.stack([np.cos(angle), np.sin(angle)], 1)
        return cls(root, way, random.uniform(0.25, 0.9, HAIRS),
                   random.uniform(0.15, 0.8, (HAIRS, 3)))

    def hit(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Index of the front hair at each position, -1 for none."""
        found = np.full(x.shape, -1)
        for i, (root, way, width) in enumerate(zip(self.root, self.way, self.width, strict=True)):
            along = np.clip(((x - root[0]) * way[0] + (y - root[1]) * way[1]) / (way @ way), 0, 1)
            apart = np.hypot(x - root[0] - along * way[0], y - root[1] - along * way[1])
            found = np.where(apart < width * (1 - 0.7 * along), i, found)
        return found


def draw(hairs: Hairs, seed: int, samples: int, scale: int, noisy: bool,
         moved: np.ndarray) -> dict[Role, np.ndarray]:
    """Premultiplied colour, alpha and albedo, means over the given samples a pixel; all `moved` by
    so many pixels."""
    random, side = np.random.default_rng(seed), SIDE * scale
    rows, columns = np.mgrid[:side, :side]
    sums = {role: np.zeros((side, side, count)) for role, count in
            ((Role.COLOUR, 3), (Role.ALPHA, 1), (Role.DIFFUSE_ALBEDO, 3))}
    for _ in range(samples):
        x, y = ((places + random.random((side, side))) / scale - shift
                for places, shift in zip((columns, rows), moved, strict=True))
        hair = hairs.hit(x, y)
        disc = ((random.random((side, side)) < np.clip(1 - np.hypot(x - 64, y - 28) / 20, 0, 1))
                & (hair < 0))
        albedo = np.where((hair >= 0)[..., None], hairs.colour[np.maximum(hair, 0)],
                          0.6 * disc[..., None])
        light = random.exponential(1, (side, side, 1)) if noisy else 1.0
        for role, value in ((Role.COLOUR, 0.8 * albedo * light),
                            (Role.ALPHA, ((hair >= 0) | disc)[..., None]),
                            (Role.DIFFUSE_ALBEDO, albedo)):
            sums[role] += value
    return {role: (total / samples).astype(np.float32) for role, total in sums.items()}


def measure(model: str, scale: int, name: str, truth: int = 256) -> dict[str, list[float]]:
    """For each background, PSNR with alpha resampled, denoised and true; the truth has so many
    samples at 1x."""
    hairs, device, way = Hairs.grown(), Device("cpu"), np.array(MOVES[name])
    true = draw(hairs, 99, truth // scale, scale, False, (FRAMES - 1) * way)
    passes = [Pipeline([DenoiseUpscale(scale=scale, model=model, alpha=alpha)], device)
              for alpha in (False, True)]
    for i in range(FRAMES):
        planes = draw(hairs, i, SAMPLES, 1, True, i * way)
        planes[Role.MOTION] = np.broadcast_to(-way, (SIDE, SIDE, 2)).astype(np.float32)
        planes[Role.DEPTH] = np.where(planes[Role.ALPHA] > 0, 5, 1e10).astype(np.float32)
        results = [run(Frame(dict(planes), number=i, samples=SAMPLES)) for run in passes]
    rows = {}
    for background, grey in GREYS.items():
        wanted = srgb_encode(np.clip(true[Role.COLOUR] + (1 - true[Role.ALPHA]) * grey, 0, 1))
        picture = results[0][Role.COLOUR]
        rows[background] = [
            psnr(srgb_encode(np.clip(picture + (1 - alpha) * grey, 0, 1)), wanted)
            for alpha in (*(result[Role.ALPHA] for result in results), true[Role.ALPHA])]
    return rows


def cost(model: str) -> None:
    """Print alpha's share of a frame's time for figures with a noisy rim, and where all of alpha is
    noisy."""
    random, device = np.random.default_rng(0), Device("cpu", threads=1)
    colour = random.random((540, 960, 3), np.float32)
    planes = {Role.COLOUR: colour, Role.DIFFUSE_ALBEDO: colour, Role.NORMAL: colour,
              Role.DEPTH: 1 + colour[..., :1].copy(), Role.MOTION: 0.5 * colour[..., :2].copy()}
    rows, columns = np.mgrid[:540, :960]
    frames = {"no alpha": Frame(planes),
              "all of it": Frame({**planes, Role.ALPHA: colour[..., :1].copy()})}
    for radius in (120, 200, 260):
        covered = np.clip(0.5 - (np.hypot(0.9 * (columns - 480), rows - 270) - radius) / 12, 0, 1)
        alpha = (random.random((540, 960, SAMPLES)) < covered[..., None]).mean(-1, keepdims=True)
        frames[f"a rim {2 * radius} high"] = Frame({**planes, Role.ALPHA: alpha.astype(np.float32)})
    runs = {name: Pipeline([DenoiseUpscale(scale=2, model=model)], device, exposure=0.0)
            for name in frames}
    times: dict[str, list[float]] = {name: [] for name in frames}
    for _ in range(10):
        for name, frame in frames.items():
            before = busy()
            runs[name](frame)
            times[name].append(busy() - before)
    alone, *others = (float(np.median(found[3:])) for found in times.values())
    for name, time in zip(list(frames)[1:], others, strict=True):
        print(f"{model}, noisy: {name}: {(time - alone) / alone:.1%} of {alone:.0f} ms")


def main() -> None:
    """Measure as the command line says."""
    parser = argparse.ArgumentParser(description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--model", default="m")
    parser.add_argument("--scales", default="1,2")
    parser.add_argument("--cost", action="store_true")
    arguments = parser.parse_args()
    if arguments.cost:
        cost(arguments.model)
        return
    print("| | background | alpha resampled | denoised | true alpha |")
    for scale in arguments.scales.split(","):
        for name in MOVES:
            for background, row in measure(arguments.model, int(scale), name).items():
                print(f"| {scale}x, {name} | {background} "
                      "| " + " | ".join(f"{value:.2f}" for value in row) + " |")


if __name__ == "__main__":
    main()
