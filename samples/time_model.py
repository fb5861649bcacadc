"""Measure how a frame's time and memory grow with pixels, threads, unmasked share and parts; fit a
model, plot it, and simulate a farm with it.

python samples/time_model.py [--models m,s] [--runs 5] [--sizes 480x270,...] [--full 960x540] \\
    [--what work,threads,...]
    [--threads 1,2] [-o time_model.png]

Frames are denoised to twice their size and tone-mapped on the CPU, random planes in memory; those
with parts are not tone-mapped. Work is processor time in one thread, the least of all runs, as
other programs can only add to it; times of several threads are by the clock, medians of runs in
turn; memory is the peak of a process of its own. Sizes are those of frames before they are
enlarged: 427x240 makes 480p, 7680x4320 makes 16K.
"""
import argparse
import heapq
import itertools
import statistics
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from compare_speed import noisy_frames
from masked_speed import masked

import postfx
from postfx.passes.denoise.models import HALOS
from postfx.tools.bench.measure import peak_memory

SIZES = "427x240,640x360,960x540,1280x720,1920x1080"
SHARES = 100, 75, 50, 25, 10, 1
PARTS = 0, 1, 2, 4
KINDS = "work", "threads", "memory", "farm"
RUN_UP = 96
"""Frames that `--preroll auto` runs before a chunk at most."""
CHUNKS = 25, 50, 100, 200, 500, 1000
MOST_SECONDS = 60
"""Of runs at one size: large frames get fewer."""


def chain(model: str, threads: int | None, parts: int = 0,
          memory: str | None = None) -> postfx.Pipeline:
    denoiser = postfx.DenoiseUpscale(scale=2, model=model,
                                     parts=[f"part {i}" for i in range(parts)])
    toned = [] if parts else [postfx.ToneMap()]  # parts are light of the scene, and stay so
    return postfx.Pipeline([denoiser, *toned], postfx.Device("cpu", threads=threads, memory=memory))


def measure(chains: list[postfx.Pipeline], frames: list[postfx.Frame], runs: int,
            clock: Callable[[], float], middle: Callable[[list[float]], float]) -> list[float]:
    """Milliseconds of each chain, the middle of runs in turn; three runs before them do not
    count."""
    found: list[list[float]] = [[] for _ in chains]
    began = time.perf_counter()
    for run in range(runs + 3):
        if run > 4 and time.perf_counter() - began > MOST_SECONDS:
            break
        for times, way in zip(found, chains, strict=True):
            start = clock()
            way(frames[run % len(frames)])
            if run >= 3:
                times.append(1e3 * (clock() - start))
    return [middle(times) for times in found]


def work_of(model: str, frames: list[postfx.Frame], runs: int, parts: int = 0) -> float:
    """Milliseconds of processor time in one thread."""
    return measure([chain(model, 1, parts)], frames, runs, time.process_time, min)[0]


def with_parts(frame: postfx.Frame, count: int) -> postfx.Frame:
    """The frame with its colour in equal parts."""
    share = frame[postfx.Role.COLOUR] / np.float32(max(count, 1))
    return postfx.Frame(frame.planes, jitter=frame.jitter,
                        parts={f"part {i}": share.copy() for i in range(count)})


def fit(rows: list[list[float]], times: list[float]) -> tuple[np.ndarray, np.ndarray]:
    """Coefficients of columns with the least relative errors, none below 0, and these errors."""
    scaled = np.array(rows, float) / np.array(times)[:, None]
    used = list(range(scaled.shape[1]))
    while True:
        found, *_ = np.linalg.lstsq(scaled[:, used], np.ones(len(times)), rcond=None)
        if found.min() >= 0:
            break
        del used[int(found.argmin())]
    values = np.zeros(scaled.shape[1])
    values[used] = found
    return values, scaled @ values - 1


def windowed(share: float, height: int, model: str) -> float:
    """The share of a frame's rows that the network sees, halo included, if a share of them is not
    masked."""
    return 1.0 if share >= 1 else min(1.0, share + HALOS[model] / height)


def measure_work(model: str, sizes: list[tuple[int, int]], full: tuple[int, int],
                 runs: int) -> dict[str, float]:
    """Print and fit the work; the model's coefficients by name."""
    rows, times, names = [], [], []

    def note(name: str, size: tuple[int, int], share: float, parts: int,
             frames: list[postfx.Frame]) -> None:
        pixels = size[0] * size[1] / 1e6
        rows.append([1, pixels, pixels * windowed(share, size[1], model), pixels * (parts > 0),
                     pixels * parts])
        times.append(work_of(model, frames, runs, parts))
        names.append(name)

    for size in sizes:
        note("{}x{}".format(*size), size, 1, 0, noisy_frames(*size))
    whole = noisy_frames(*full)
    for share in SHARES[1:]:
        note(f"{share} % not masked", full, share / 100, 0,
             [masked(frame, 100 - share) for frame in whole])
    for count in PARTS[1:]:
        note(f"{count} parts", full, 1, count, [with_parts(frame, count) for frame in whole])
    # Without masks the second and the third column cannot be told apart, and masks have one size.
    values, errors = fit(rows, times)
    print(f"{model}: work of P million render pixels, a share w of which the network sees, in n "
          "parts: {:.1f} + P ({:.0f} + {:.0f} w + {:.0f} (n > 0) + {:.0f} n) "
          "ms".format(*values))
    for name, taken, error in zip(names, times, errors, strict=True):
        print(f"{model}: {name}: {taken:.0f} ms, the model is {100 * error:+.1f} % off")
    return {"base": values[0], "pixel": values[1] + values[2],
            **{name: taken for name, taken in zip(names, times, strict=True)}}


def measure_threads(model: str, full: tuple[int, int], counts: list[int], runs: int) -> list[float]:
    """Print and fit times by the clock: Amdahl's a + b / n."""
    times = measure([chain(model, count) for count in counts], noisy_frames(*full), runs,
                    time.perf_counter, statistics.median)
    (alone, shared), errors = fit([[1, 1 / count] for count in counts], times)
    print("{}: {}x{} by the clock in n threads: {:.1f} + {:.0f} / n "
          "ms".format(model, *full, alone, shared))
    for count, taken, error in zip(counts, times, errors, strict=True):
        print(f"{model}: {count} threads: {taken:.1f} ms, {times[0] / taken:.2f} times as fast as "
              f"{counts[0]}, the model is {100 * error:+.1f} % off")
    return times


def measure_memory(model: str, sizes: list[tuple[int, int]], budgets: list[str]) -> None:
    """Print the peak memory of a process that runs three frames, and its seconds by the clock for
    the last one."""
    for size, budget in itertools.product(sizes, budgets):
        command = [sys.executable, __file__, "--one", "{}x{}".format(*size), "--models", model,
                   "--budgets", budget]
        done = subprocess.run(command, capture_output=True, text=True)
        print(f"{model}: {size[0]}x{size[1]}, budget {budget}: "
              + (done.stdout.strip() or done.stderr.strip().rpartition("\n")[2]), flush=True)


def run_alone(model: str, size: tuple[int, int], budget: str) -> None:
    frames = noisy_frames(*size)
    way = chain(model, None, memory=None if budget == "none" else budget)
    for run in range(3):
        began = time.perf_counter()
        way(frames[run % len(frames)])
        taken = time.perf_counter() - began
    peak = peak_memory() * 1e6 / 2**20
    planes = sum(plane.nbytes for plane in frames[0].planes.values()) / 2**20
    print(f"{peak:.0f} MiB, {planes:.0f} of them the planes; {1e3 * taken:.0f} ms")


def cut(frames: int, size: int, shot: int) -> list[tuple[int, int]]:
    """Chunks as (frames to write, frames to run before them): shots of equal length, each cut into
    equal chunks of at most `size`."""
    chunks = []
    for first in range(0, frames, shot):
        long = min(shot, frames - first)
        count = -(-long // size)
        ends = [long * i // count for i in range(count + 1)]
        chunks += [(end - begin, min(RUN_UP, begin)) for begin, end in itertools.pairwise(ends)]
    return chunks


def simulate_farm(chunks: list[tuple[int, int]], seconds: float, start: float, machines: int = 1000,
                  between_failures: float = float("inf"), seed: int = 0) -> float:
    """Hours until all chunks are done.

    Machines take the longest chunk left as they become free. Their speeds differ (log-normal, 15
    %). One fails after a time (exponential, `between_failures` hours on average) and is back after
    ten minutes; the rest of its chunk then goes to the next free machine, which runs the frames
    before it again.
    """
    rng = np.random.default_rng(seed)
    slowness = np.exp(rng.normal(0, 0.15, machines))
    fails = rng.exponential(1, machines) * between_failures * 3600
    free = [(0.0, machine) for machine in range(machines)]
    left = sorted(chunks, key=sum)
    end = 0.0
    while left:
        write, before = left.pop()
        at, machine = heapq.heappop(free)
        pace = slowness[machine] * seconds
        done = at + slowness[machine] * start + (write + before) * pace
        if done > fails[machine]:
            written = int(max(0.0,
                              (fails[machine] - at - slowness[machine] * start) / pace - before))
            left.append((write - min(written, write - 1), min(RUN_UP, before + written)))
            done = fails[machine] = fails[machine] + 600.0
            fails[machine] += rng.exponential(1) * between_failures * 3600
        else:
            end = max(end, done)
        heapq.heappush(free, (done, machine))
    return end / 3600


def report_farm(model: str, seconds: float, start: float) -> None:
    """Print hours of a farm of 1,000 machines for 10^6 frames, in shots of 100 and of 1,000
    frames."""
    print(f"{model}: 10^6 frames by 1,000 machines, {1e3 * seconds:.0f} ms a frame and {start} s "
          f"to start; without starts and frames before chunks {1e3 * seconds / 3600:.3f} h")
    for shot, size in itertools.product((100, 1000), CHUNKS):
        if size <= shot:
            chunks = cut(10**6, size, shot)
            before = sum(count for _, count in chunks) / 1e6
            times = [simulate_farm(chunks, seconds, start, between_failures=hours)
                     for hours in (float("inf"), 24.0, 2.0)]
            print(f"{model}: shots of {shot}, chunks of {size}: {before:.2f} frames before each; "
                  "{:.3f} h, {:.3f} with a failure a day, {:.3f} with one in two "
                  "hours".format(*times), flush=True)


def parse_size(text: str) -> tuple[int, int]:
    width, _, height = text.partition("x")
    return int(width), int(height)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--models", default="m,s", help="tags of networks, comma-separated")
    parser.add_argument("--runs", type=int, default=5)
    parser.add_argument("--what", default=",".join(KINDS), help="what to measure, comma-separated")
    parser.add_argument("--sizes", default=SIZES,
                        help="of frames before they are enlarged, comma-separated")
    parser.add_argument("--full", default="960x540",
                        help="the size at which masks, parts and threads are measured")
    parser.add_argument("--threads", default="1,2", help="comma-separated")
    parser.add_argument("--budgets", default="none", help="of memory, such as none,4G")
    parser.add_argument("--start", type=float, default=1.5,
                        help="seconds of a process before its first frame")
    parser.add_argument("--frame", type=float,
                        help="milliseconds of a frame for the farm, in place of the work")
    parser.add_argument("--one", help=argparse.SUPPRESS)
    parser.add_argument("-o", "--output", type=Path, help="picture to write")
    args = parser.parse_args()
    if args.one:
        run_alone(args.models, parse_size(args.one), args.budgets)
        return
    sizes = [parse_size(size) for size in args.sizes.split(",")]
    full = parse_size(args.full)
    what = args.what
    counts, drawn = list(map(int, args.threads.split(","))), {}
    for model in args.models.split(","):
        seconds = (args.frame or 0) / 1e3
        if "work" in what:
            found = measure_work(model, sizes, full, args.runs)
            seconds = seconds or (found["base"] + found["pixel"] * full[0] * full[1] / 1e6) / 1e3
            drawn[model] = found
        if "threads" in what:
            measure_threads(model, full, counts, args.runs)
        if "memory" in what:
            measure_memory(model, sizes, args.budgets.split(","))
        if "farm" in what and seconds:
            report_farm(model, seconds, args.start)
    if args.output and drawn:
        plot(drawn, sizes, full, args.output)


def plot(drawn: dict[str, dict[str, float]], sizes: list[tuple[int, int]], full: tuple[int, int],
         path: Path) -> None:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11, 3.6), dpi=100, layout="constrained")
    FigureCanvasAgg(figure)
    over_pixels, over_share, over_parts = figure.subplots(1, 3)
    for model, found in drawn.items():
        pixels = [width * height / 1e6 for width, height in sizes]
        whole = found.get("{}x{}".format(*full))
        line = over_pixels.plot(pixels, [found["{}x{}".format(*size)] for size in sizes], "o",
                                label=model)[0]
        ends = np.geomspace(min(pixels), max(pixels), 50)
        over_pixels.plot(ends, found["base"] + found["pixel"] * ends, "-", color=line.get_color())
        shares = [(share, found[f"{share} % not masked"]) for share in SHARES[1:]]
        over_share.plot(*zip(*([(100, whole)] if whole else []) + shares, strict=True), "o-",
                        label=model)
        over_parts.plot(PARTS[1:], [found[f"{count} parts"] for count in PARTS[1:]], "o-",
                        label=model)
    over_pixels.set(xlabel="million pixels before enlarging", ylabel="ms", xscale="log",
                    yscale="log")
    over_share.set(xlabel="share not masked, %", ylabel="ms", xlim=(0, None), ylim=(0, None))
    over_parts.set(xlabel="parts", ylabel="ms", xlim=(0, None), ylim=(0, None))
    for axes in (over_pixels, over_share, over_parts):
        axes.grid(True, color="#dddddd")
    over_pixels.legend()
    figure.suptitle("Processor time of a frame, with the fitted line; masks and parts at "
                    "{}x{}".format(*full))
    figure.savefig(path)


if __name__ == "__main__":
    main()
