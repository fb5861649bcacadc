"""Measure how a frame's time grows with pixels, threads, unmasked share and parts; fit a model and plot it.

python samples/time_model.py [--models m,s] [--runs 5] [--sizes 480x270,...] [--full 960x540] [-o time_model.png]

Frames are denoised to twice their size and tone-mapped on the CPU, random planes in memory. Work is processor time in
one thread, the least of all runs, as other programs can only add to it; times of several threads are by the clock,
medians of runs in turn. Then a farm is simulated with the model's time of a frame: machines take chunks as they become
free, each chunk starts a process and runs frames before its first one.
"""
import argparse
import heapq
import statistics
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from compare_speed import noisy_frame
from masked_speed import masked

import postfx

SIZES = "480x270,640x360,960x540,1280x720,1920x1080"
SHARES = 100, 75, 50, 25, 10, 1
PARTS = 0, 1, 2, 4
RUN_UP, START = 96, 1.5
"""Frames that `--preroll auto` runs before a chunk at most, and seconds of a process before its first frame."""


def chain(model: str, threads: int, parts: int = 0) -> postfx.Pipeline:
    denoiser = postfx.DenoiseUpscale(scale=2, model=model, parts=[f"part {i}" for i in range(parts)])
    toned = [] if parts else [postfx.ToneMap()]  # parts are light of the scene, and stay so
    return postfx.Pipeline([denoiser, *toned], postfx.Device("cpu", threads=threads))


def measure(chains: list[postfx.Pipeline], frame: postfx.Frame, runs: int, clock: Callable[[], float],
            middle: Callable[[list[float]], float]) -> list[float]:
    """Milliseconds of each chain, the middle of runs in turn; three runs before them do not count."""
    found: list[list[float]] = [[] for _ in chains]
    for run in range(runs + 3):
        for times, way in zip(found, chains, strict=True):
            began = clock()
            way(frame)
            if run >= 3:
                times.append(1e3 * (clock() - began))
    return [middle(times) for times in found]


def work_of(model: str, frame: postfx.Frame, runs: int, parts: int = 0) -> float:
    """Milliseconds of processor time in one thread."""
    return measure([chain(model, 1, parts)], frame, runs, time.process_time, min)[0]


def fit_line(x: list[float], y: list[float]) -> tuple[float, float, float]:
    """a and b of y = a + b x with the least relative errors, and the largest of these."""
    columns = np.stack([np.ones(len(x)), x], axis=1) / np.array(y)[:, None]
    (a, b), *_ = np.linalg.lstsq(columns, np.ones(len(y)), rcond=None)
    return a, b, max(abs(a + b * at - value) / value for at, value in zip(x, y, strict=True))


def with_parts(frame: postfx.Frame, count: int) -> postfx.Frame:
    """The frame with its colour in equal parts."""
    share = frame[postfx.Role.COLOUR] / np.float32(max(count, 1))
    return postfx.Frame(frame.planes, jitter=frame.jitter, parts={f"part {i}": share.copy() for i in range(count)})


def simulate_farm(frames: int, machines: int, chunk: int, seconds: float, seed: int = 0) -> float:
    """Hours until all frames are done, by machines whose speeds differ (log-normal, 15 %)."""
    slowness = np.exp(np.random.default_rng(seed).normal(0, 0.15, machines))
    free = [(0.0, machine) for machine in range(machines)]
    end = 0.0
    for first in range(0, frames, chunk):
        at, machine = heapq.heappop(free)
        count = min(chunk, frames - first) + min(RUN_UP, first)
        at += slowness[machine] * (START + count * seconds)
        end = max(end, at)
        heapq.heappush(free, (at, machine))
    return end / 3600


def parse_size(text: str) -> tuple[int, int]:
    width, _, height = text.partition("x")
    return int(width), int(height)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--models", default="m,s", help="tags of networks, comma-separated")
    parser.add_argument("--runs", type=int, default=5)
    parser.add_argument("--sizes", default=SIZES, help="of frames before they are enlarged, comma-separated")
    parser.add_argument("--full", default="960x540", help="the size at which masks, parts and threads are measured")
    parser.add_argument("--threads", default="1,2", help="comma-separated")
    parser.add_argument("-o", "--output", type=Path, help="picture to write")
    args = parser.parse_args()
    sizes = [parse_size(size) for size in args.sizes.split(",")]
    size = width, height = parse_size(args.full)
    full, megapixels = noisy_frame(*size), width * height / 1e6
    pixels = [width * height / 1e6 for width, height in sizes]
    drawn: dict[str, dict[str, tuple[list[float], list[float]]]] = {}
    for model in args.models.split(","):
        work = [work_of(model, noisy_frame(*size), args.runs) for size in sizes]
        a, b, worst = fit_line(pixels, work)
        table = ", ".join(f"{width}x{height} {ms:.0f}" for (width, height), ms in zip(sizes, work, strict=True))
        print(f"{model}: work in ms: {table}; {a:.1f} + {b:.0f} ms a megapixel, at most {100 * worst:.0f} % off")
        shares = [work_of(model, masked(full, 100 - share) if share < 100 else full, args.runs) for share in SHARES]
        print(f"{model}: work over that without a mask: "
              + ", ".join(f"{share} % left {ms / shares[0]:.2f}" for share, ms in zip(SHARES, shares, strict=True)))
        parts = [work_of(model, with_parts(full, count), args.runs, count) for count in PARTS]
        _, each, _ = fit_line(list(PARTS[1:]), parts[1:])
        print(f"{model}: work with parts: " + ", ".join(f"{count}: {ms:.0f} ms" for count, ms
                                                        in zip(PARTS, parts, strict=True))
              + f"; each part beyond the first {each / parts[0]:.3f} of the picture")
        counts = list(map(int, args.threads.split(",")))
        clocked = measure([chain(model, count) for count in counts], full, args.runs, time.perf_counter,
                          statistics.median)
        print(f"{model}: by the clock: "
              + ", ".join(f"{count} threads {ms:.0f} ms" for count, ms in zip(counts, clocked, strict=True)))
        drawn[model] = {"megapixels": (pixels, work), "share not masked, %": (list(SHARES), shares),
                        "parts": (list(PARTS), parts)}
        seconds = (a + b * megapixels) / 1e3
        hours = {chunk: simulate_farm(10**6, 1000, chunk, seconds) for chunk in (50, 100, 200, 500, 1000)}
        print(f"{model}: 10^6 frames by 1,000 machines of a core each: "
              + ", ".join(f"chunks of {chunk} {value:.2f} h" for chunk, value in hours.items())
              + f"; without start-up and run-up {1e6 * seconds / 1000 / 3600:.2f} h")
    if args.output:
        plot(drawn, args.full, args.output)


def plot(drawn: dict[str, dict[str, tuple[list[float], list[float]]]], full: str, path: Path) -> None:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11, 3.6), dpi=100, layout="constrained")
    FigureCanvasAgg(figure)
    all_axes = figure.subplots(1, 3)
    for model, curves in drawn.items():
        for axes, (name, (x, y)) in zip(all_axes, curves.items(), strict=True):
            axes.plot(x, y, "o-", label=model)
            axes.set(xlabel=name, ylabel="ms", ylim=(0, None), xlim=(0, None))
            axes.grid(True, color="#dddddd")
    all_axes[0].legend()
    figure.suptitle(f"Processor time of a frame; masks and parts at {full}")
    figure.savefig(path)


if __name__ == "__main__":
    main()
