"""Measure time and peak memory of `postfx run` against the size of the picture, with and without a memory budget.

python samples/measure_memory.py [--sizes 2048,4096] [--memory 4G] [--model m] [--folder TMP]

Frames are the first one of samples/room, repeated to half of each size, with all its planes; outputs are squares.
Prints peak memory of the process (resident, without the system's cache of files) and seconds of the whole command.
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


def write_frame(path: Path, side: int) -> None:
    """The sample, repeated to side x side pixels."""
    source = oiio.ImageBuf(str(SAMPLE))
    spec = oiio.ImageSpec(source.spec())
    width, height = spec.width, spec.height
    spec.width = spec.height = spec.full_width = spec.full_height = side
    pixels = source.get_pixels(oiio.HALF)
    output = oiio.ImageOutput.create(str(path))
    output.open(str(path), spec)
    for first in range(0, side, ROWS):
        rows = [row % height for row in range(first, min(side, first + ROWS))]
        columns = [column % width for column in range(side)]
        output.write_scanlines(first, first + len(rows), 0, pixels[rows][:, columns].copy())
    output.close()


def run(frame: Path, options: list[str]) -> tuple[float, float]:
    """Peak memory in MB and seconds of one command."""
    code = ("import resource, sys; from postfx.cli.main import main; code = main(sys.argv[1:]); "
            "print('peak', resource.getrusage(resource.RUSAGE_SELF).ru_maxrss); sys.exit(code)")
    began = time.perf_counter()
    command = [sys.executable, "-c", code, "run", str(frame), "-o", str(frame.with_name("out.exr")), "--overwrite"]
    result = subprocess.run([*command, "--device", "cpu", *options], capture_output=True, text=True)
    if result.returncode:
        raise SystemExit(result.stderr)
    return int(re.search(r"peak (\d+)", result.stdout)[1]) / 1024, time.perf_counter() - began


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sizes", default="2048,4096", help="sides of outputs, comma-separated")
    parser.add_argument("--memory", default="4G", help="budgets, comma-separated; 'none' is without one")
    parser.add_argument("--model", default="m")
    parser.add_argument("--folder", help="where temporary files go, some of them large")
    args = parser.parse_args()
    with tempfile.TemporaryDirectory(dir=args.folder) as folder:
        for size in map(int, args.sizes.split(",")):
            frame = Path(folder) / f"noisy.{size}.exr"
            write_frame(frame, size // 2)
            for memory in args.memory.split(","):
                budget = [] if memory == "none" else ["--memory", memory]
                peak, seconds = run(frame, ["--model", args.model, *budget])
                print(f"{size}x{size} model {args.model} budget {memory}: {peak:.0f} MB, {seconds:.1f} s", flush=True)
            frame.unlink()


if __name__ == "__main__":
    main()
