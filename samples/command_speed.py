"""Time the whole command, files read and written, against its passes alone, in turn.

python samples/command_speed.py [--width 960] [--height 540] [--frames 40] [--runs 5] \\
    [--model m] [--ways 4]

The frames are those of the sample, enlarged, with two kinds of noise in turn, as half floats in
ZIP, one file each. A frame of the command is what 2 + `frames` of them take beyond 2; a frame of
the passes is the median of calls with planes that are in memory, measured just before. Prints
medians and ranges of seconds and of the ratio.
"""
import argparse
import itertools
import os
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import OpenImageIO as oiio

import postfx

SAMPLE = Path(__file__).parent / "room/noisy.0002.exr"
WAYS = {
    "EXR with all other channels": ("exr", "--keep", "all"),
    "EXR": ("exr", "--keep", "none"),
    "tone-mapped EXR with all other channels": ("exr", "--keep", "all", "--tonemap"),
    "tone-mapped PNG": ("png",),
}
WARM = 2
KINDS = 2


def write_frames(folder: Path, width: int, height: int, count: int) -> None:
    """The sample at another size with two kinds of noise in turn, under many names: frames that
    repeat the one before are not denoised again."""
    enlarged = oiio.ImageBufAlgo.resample(oiio.ImageBuf(str(SAMPLE)),
                                          roi=oiio.ROI(0, width, 0, height))
    pixels = enlarged.get_pixels(oiio.FLOAT)
    spec = oiio.ImageSpec(enlarged.spec())
    colour = [spec.channelnames.index(name) for name in "RGB"]
    for kind in range(KINDS):
        noisy = pixels.copy()
        noisy[..., colour] *= np.random.default_rng(kind).gamma(4, 0.25, (height, width, 3))
        image = oiio.ImageBuf(spec)
        image.set_pixels(oiio.ROI(0, width, 0, height), noisy)
        if not image.write(str(folder / f"frame.{kind + 1:04}.exr"), oiio.HALF):
            raise SystemExit(image.geterror())
    for number in range(KINDS + 1, count + 1):
        os.link(folder / f"frame.{(number - 1) % KINDS + 1:04}.exr",
                folder / f"frame.{number:04}.exr")


def command_seconds(folder: Path, way: tuple[str, ...], model: str,
                    last: int) -> tuple[float, float]:
    """Time of a run over frames 1 to `last`, and its processor time."""
    ending, *options = way
    command = [sys.executable, "-m", "postfx", "run", str(folder / "frame.####.exr"), "-o",
               str(folder / f"out.####.{ending}"), "--scale", "2", "--model", model, "--frames",
               f"1-{last}", "--overwrite", *options]
    before, began = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    subprocess.run(command, check=True, capture_output=True)
    spent, after = time.perf_counter() - began, resource.getrusage(resource.RUSAGE_CHILDREN)
    return spent, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def further_frame(folder: Path, way: tuple[str, ...], model: str,
                  count: int) -> tuple[float, float]:
    """Seconds and processor seconds of a frame after the first ones."""
    few, many = (command_seconds(folder, way, model, last) for last in (WARM, WARM + count))
    return (many[0] - few[0]) / count, (many[1] - few[1]) / count


def passes_alone(folder: Path, model: str, toned: bool) -> float:
    """Seconds of a call."""
    passes = [postfx.DenoiseUpscale(scale=2, model=model), *[postfx.ToneMap()] * toned]
    chain, times = postfx.Pipeline(passes), []
    frames = list(itertools.islice(postfx.read_sequence(folder / "frame.####.exr"), KINDS))
    for run in range(WARM + 10):
        began = time.perf_counter()
        chain(frames[run % KINDS])
        times.append(time.perf_counter() - began)
    return statistics.median(times[WARM:])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--width", type=int, default=960)
    parser.add_argument("--height", type=int, default=540)
    parser.add_argument("--frames", type=int, default=40)
    parser.add_argument("--runs", type=int, default=5)
    parser.add_argument("--model", default="m")
    parser.add_argument("--ways", type=int, default=len(WAYS),
                        help="time the first so many kinds of output")
    args = parser.parse_args()
    ways = dict(list(WAYS.items())[:args.ways])
    found = {name: [] for name in ways}
    with tempfile.TemporaryDirectory(prefix="postfx-command-") as folder:
        write_frames(Path(folder), args.width, args.height, WARM + args.frames)
        for _ in range(args.runs):
            for name, way in ways.items():
                alone = passes_alone(Path(folder), args.model, "tone" in name)
                found[name].append((*further_frame(Path(folder), way, args.model, args.frames),
                                    alone))
    for name, times in found.items():
        walls, spent, alone = (sorted(some) for some in zip(*times, strict=True))
        ratios = sorted(wall / passes for wall, _, passes in times)
        print(f"{name}: {shown(walls)} s, of processors {statistics.median(spent):.3f} s; "
              f"passes alone {shown(alone)} s; ratio {shown(ratios)}")


def shown(numbers: list[float]) -> str:
    """Median and range of sorted numbers."""
    return f"{statistics.median(numbers):.3f} ({numbers[0]:.3f} to {numbers[-1]:.3f})"


if __name__ == "__main__":
    main()
