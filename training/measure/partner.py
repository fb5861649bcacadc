"""The project's network, Open Image Denoise and their mixture on clips, at the render's size or
enlarged.

    python -m training.measure.partner CLIPS [--scale 1] [--model m] [--weight W]

CLIPS holds .npz files as `training.datagen` makes them, with references at the render's size or
twice that size. References are averaged down to the render's size at 1x. Figures are those of
`postfx.tools.bench.metrics`, of the second half of the frames: PSNR in dB, FLIP and flicker.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

import numpy as np

from postfx import DenoiseUpscale, Device, Frame, MixPartner, Partner, Pipeline
from postfx.frame import Role
from postfx.passes.partner import partner_weight
from postfx.tools.bench.baselines import HostKernels, Oidn
from postfx.tools.bench.metrics import SequenceScore
from training.datagen.clip_file import exposure_of, load_clip

PLANES = ("colour", "diffuse_albedo", "specular_albedo", "normal", "roughness", "depth", "motion")
SHOWN = ("psnr", "flip", "flicker")
Way = Callable[[Frame], np.ndarray]


def frames_of(clip: Mapping[str, np.ndarray], variant: int, exposure: float) -> Iterator[Frame]:
    """The frames of one noisy render."""
    for t in range(len(clip["reference"])):
        planes = {Role(name): np.atleast_3d(clip[f"v{variant}_{name}"][t].astype(np.float32))
                  for name in PLANES}
        x, y = clip[f"v{variant}_jitter"][t].tolist()
        yield Frame(planes, number=t + 1, jitter=(x, y), exposure=float(np.log2(exposure)),
                    reset=bool(clip["reset"][t]), samples=int(clip[f"v{variant}_spp"]))


def reference_of(clip: Mapping[str, np.ndarray], height: int) -> np.ndarray:
    """References (T, H, W, 3) of this height, which divides their own."""
    full = clip["reference"].astype(np.float32)
    factor = full.shape[1] // height
    frames, rows, columns, channels = full.shape
    parted = full.reshape(frames, rows // factor, factor, columns // factor, factor, channels)
    return parted.mean((2, 4))


def ways_of(model: str, scale: float, size: tuple[int, int], weight: float | None,
            exposure: float) -> dict[str, Way]:
    """The pictures that are compared, by name. The mean is that of the first two, by `weight` or by
    the product's for each frame."""
    device = Device("cpu")
    oidn = Oidn("high", "cpu", device.threads, "prefiltered")
    kernels = HostKernels(device)
    stops = float(np.log2(exposure))
    alone = Pipeline([DenoiseUpscale(scale=scale, model=model)], device, stops, "none")
    passes = [Partner(of="oidn"), DenoiseUpscale(scale=scale, model=model), MixPartner()]
    both = Pipeline(passes, device, stops, "none")

    def partner(frame: Frame) -> np.ndarray:
        return kernels.enlarge(oidn(frame), *size, frame.jitter)

    def mean(frame: Frame) -> np.ndarray:
        own, other = (np.log1p(exposure * picture.clip(0))
                      for picture in (results["own"], results["oidn"]))
        share = partner_weight(frame.number, scale) if weight is None else weight
        return np.expm1((1 - share) * own + share * other) / exposure

    results: dict[str, np.ndarray] = {}

    def kept(name: str, way: Way) -> Way:
        def run(frame: Frame) -> np.ndarray:
            results[name] = way(frame)
            return results[name]
        return run

    return {"own": kept("own", lambda frame: alone(frame)[Role.COLOUR]),
            "oidn": kept("oidn", partner),
            "mean": mean, "mixture": lambda frame: both(frame)[Role.COLOUR]}


def score(clip: Mapping[str, np.ndarray], variant: int, scale: int, model: str,
          weight: float | None) -> dict[str, tuple[float, ...]]:
    """Way -> the figures of the second half of the frames; NaN where one cannot be measured."""
    exposure = exposure_of(clip["reference"].astype(np.float32))
    height, width = (side * scale for side in clip[f"v{variant}_colour"].shape[1:3])
    wanted = reference_of(clip, height)
    ways = ways_of(model, scale, (height, width), weight, exposure)
    scores = {name: SequenceScore() for name in ways}
    for frame, colour in zip(frames_of(clip, variant, exposure), wanted, strict=True):
        for name, way in ways.items():
            scores[name].add(way(frame),
                             Frame({Role.COLOUR: colour}, exposure=float(np.log2(exposure))), frame)
    found = {name: made.summary() for name, made in scores.items()}
    return {name: tuple(float(figures[f"{figure}_late"] or np.nan) for figure in SHOWN)
            for name, figures in found.items()}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("clips", type=Path, help="folder of .npz files")
    parser.add_argument("--scale", type=int, choices=(1, 2), default=1)
    parser.add_argument("--model", default="m")
    parser.add_argument("--weight", type=float,
                        help="of OIDN in the mean (default: the product's, by frame)")
    given = parser.parse_args()
    rows: list[dict[str, tuple[float, ...]]] = []
    for path in sorted(given.clips.glob("*.npz")):
        clip = load_clip(path)
        for variant in range(clip["variants"]):
            rows.append(score(clip, variant, given.scale, given.model, given.weight))
            print(f"{path.stem} {variant}", *map(describe, rows[-1].items()), flush=True)
    for name in rows[0]:
        print("mean", describe((name, np.nanmean([row[name] for row in rows], axis=0))))


def describe(row: tuple[str, tuple[float, ...]]) -> str:
    """A way and its figures."""
    name, (decibels, unlike, unsteady) = row
    return f"{name} {decibels:.2f} {unlike:.4f} {unsteady:.1f};"


if __name__ == "__main__":
    main()
