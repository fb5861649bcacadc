"""Measure how the time of a frame falls with the share of it that is masked.

python samples/masked_speed.py [--width 960] [--height 540] [--runs 5] [--model m] [--scale 2] \\
    [--guides] [--centred]
                               [--shares 0,90] [--threads 1] [-o masked.png]

The upper part of the picture has strength 0, as a sky would; the rest is denoised. Prints medians
of runs in turn, for the denoised upscaler alone and with tone mapping, over those of a frame
without a mask; the picture is of the same. Each run has other noise than the one before, as frames
of a shot do: so all but the first go on from a history.
"""
import argparse
import statistics
from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
from compare_speed import noisy_frames

import postfx
from postfx.frame import GUIDE_ROLES

SHARES = (0, 25, 50, 75, 90, 99)


def masked(frame: postfx.Frame, percent: int) -> postfx.Frame:
    """The frame with no strength in its upper part."""
    height, width = frame[postfx.Role.COLOUR].shape[:2]
    strength = np.ones((height, width, 1), np.float32)
    strength[:round(height * percent / 100)] = 0
    return replace(frame, planes={**frame.planes, postfx.Role.STRENGTH: strength})


def guided(frames: list[postfx.Frame], times: int) -> list[postfx.Frame]:
    """The frames with guides of so many times their size."""
    sharp = np.ones((times, times, 1), np.float32)
    return [replace(frame, guides={role: np.kron(frame[role], sharp)
                                   for role in GUIDE_ROLES if role in frame.planes})
            for frame in frames]


def measure(frames: list[postfx.Frame], model: str, scale: float, runs: int,
            shares: Iterable[int] = SHARES,
            threads: int | None = None) -> Iterator[tuple[int, dict[str, float], dict[str, float]]]:
    """For each share of masked pixels the milliseconds of each pass, and those without a mask, in
    turn with them."""
    device = postfx.Device("cpu", threads=threads) if threads else None
    whole = chain(model, scale, device)
    for percent in shares:
        ways = {whole: frames,
                chain(model, scale, device): [masked(frame, percent) for frame in frames]}
        times: dict[postfx.Pipeline, list[dict[str, float]]] = {}
        for run in range(runs + 2):
            for way, seen in ways.items():
                way(seen[run % len(seen)])
                if run >= 2:
                    times.setdefault(way, []).append(way.timings)
        without, found = ({name: statistics.median(one[name] for one in some) for name in some[0]}
                          for some in times.values())
        yield percent, found, without


def chain(model: str, scale: float, device: postfx.Device | None) -> postfx.Pipeline:
    return postfx.Pipeline([postfx.DenoiseUpscale(scale=scale, model=model), postfx.ToneMap()],
                           device)


def plot(ratios: list[tuple[int, float, float]], title: str, path: Path) -> None:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(6, 4.2), dpi=110, layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots()
    shares, alone, toned = zip(*ratios, strict=True)
    axes.plot(shares, alone, "o-", label="denoised upscaler")
    axes.plot(shares, toned, "o-", label="with tone mapping")
    axes.plot([0, 100], [1, 0], "--", color="#999999", label="in proportion")
    axes.set(xlabel="masked, %", ylabel="time over that without a mask", title=title,
             ylim=(0, None))
    axes.grid(True, color="#dddddd")
    axes.legend()
    figure.savefig(path)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--width", type=int, default=960)
    parser.add_argument("--height", type=int, default=540)
    parser.add_argument("--runs", type=int, default=5)
    parser.add_argument("--model", default="m")
    parser.add_argument("--scale", type=int, default=2)
    parser.add_argument("--guides", action="store_true",
                        help="give frames guides of the output's size")
    parser.add_argument("--centred", action="store_true",
                        help="samples lie at the centres of pixels: frames have no jitter")
    parser.add_argument("--shares", default=",".join(map(str, SHARES)),
                        help="masked, %% (default: %(default)s)")
    parser.add_argument("--threads", type=int,
                        help="of the CPU; beside other work one is steadiest")
    parser.add_argument("-o", "--output", type=Path, help="picture to write")
    args = parser.parse_args()
    ratios = []
    frames = noisy_frames(args.width, args.height, args.centred)
    frames = guided(frames, args.scale) if args.guides else frames
    shares = map(int, args.shares.split(","))
    for share, found, whole in measure(frames, args.model, args.scale, args.runs, shares,
                                       args.threads):
        alone, toned = found["denoise_upscale"], sum(found.values())
        ratios.append((share, alone / whole["denoise_upscale"], toned / sum(whole.values())))
        _, ratio, toned_ratio = ratios[-1]
        print(f"{share:3} % masked: denoised upscaler {alone:5.0f} of "
              f"{whole['denoise_upscale']:5.0f} ms, {ratio:.2f}; with tone mapping {toned:5.0f} of "
              f"{sum(whole.values()):5.0f} ms, {toned_ratio:.2f}", flush=True)
    if args.output:
        plot(ratios,
             f"{args.width}x{args.height} to {args.scale} times the size, model {args.model}",
             args.output)


if __name__ == "__main__":
    main()
