"""Measure time and peak memory of `postfx run` against the size of the picture, with and without a
memory budget.

python samples/measure_memory.py [--sizes 2048x2048,1920x1080] [--memory 4G] [--model m] \\
    [--frames N] [--folder TMP]

Frames are the first one of samples/room, repeated to half of each size, with all its planes. Prints
peak memory of the process (resident, without the system's cache of files) and seconds of the whole
command.
"""
import argparse
import re
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import OpenImageIO as oiio

SAMPLE = Path(__file__).parent / "room" / "noisy.0001.exr"
ROWS = 64


def write_frame(path: Path, width: int, height: int) -> None:
    """The sample, repeated to width x height pixels."""
    source = oiio.ImageBuf(str(SAMPLE))
    spec = oiio.ImageSpec(source.spec())
    spec.width, spec.height = spec.full_width, spec.full_height = width, height
    pixels = source.get_pixels(oiio.HALF)
    output = oiio.ImageOutput.create(str(path))
    output.open(str(path), spec)
    for first in range(0, height, ROWS):
        rows = [row % len(pixels) for row in range(first, min(height, first + ROWS))]
        columns = [column % pixels.shape[1] for column in range(width)]
        output.write_scanlines(first, first + len(rows), 0, pixels[rows][:, columns].copy())
    output.close()


def run(folder: Path, options: list[str]) -> tuple[float, float]:
    """Peak memory in MiB and seconds of one command."""
    code = ("import resource, sys; from postfx.cli.main import main; code = main(sys.argv[1:]); "
            "print('peak', resource.getrusage(resource.RUSAGE_SELF).ru_maxrss); sys.exit(code)")
    began = time.perf_counter()
    command = [sys.executable, "-c", code, "run", "in.####.exr", "-o", "out.####.exr",
               "--scale", "2", "--overwrite"]
    result = subprocess.run([*command, "--device", "cpu", *options], capture_output=True, text=True,
                            cwd=folder)
    if result.returncode:
        raise SystemExit(result.stderr)
    return int(re.search(r"peak (\d+)", result.stdout)[1]) / 1024, time.perf_counter() - began


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sizes", default="2048x2048,4096x4096",
                        help="sizes of outputs, comma-separated")
    parser.add_argument("--memory", default="4G",
                        help="budgets, comma-separated; 'none' is without one")
    parser.add_argument("--model", default="m")
    parser.add_argument("--frames", type=int, default=1)
    parser.add_argument("--folder", help="where temporary files go, some of them large")
    args = parser.parse_args()
    for size in args.sizes.split(","):
        width, height = (int(side) // 2 for side in size.split("x"))
        with tempfile.TemporaryDirectory(dir=args.folder) as folder:
            for number in range(1, args.frames + 1):
                write_frame(Path(folder) / f"in.{number:04d}.exr", width, height)
            for memory in args.memory.split(","):
                budget = [] if memory == "none" else ["--memory", memory]
                peak, seconds = run(Path(folder), ["--model", args.model, *budget])
                print(f"{size} model {args.model} budget {memory}: {peak:.0f} MiB, {seconds:.1f} s",
                      flush=True)


if __name__ == "__main__":
    main()
