"""A kernel of the denoiser at every level of this processor, from one pixel function in C++.

python samples/one_source.py [--width 960] [--height 544] [--runs 25]

`postfx/kernels/denoise/pyramid.h` has the 5x5 filter as a function of F, which is one float or a
vector of 4, 8 or 16. Prints the median time of each level on one thread, runs in turn, and how far
its pixels are from those of the highest.
"""
import argparse
import statistics
import time

import numpy as np

from postfx.compiled import library
from postfx.compiled.library import Rows
from postfx.kernels.denoise import KERNEL
from postfx.kernels.denoise.pyramid import FILTER


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--width", type=int, default=960)
    parser.add_argument("--height", type=int, default=544)
    parser.add_argument("--runs", type=int, default=25)
    args = parser.parse_args()
    random, shape = np.random.default_rng(0), (args.height, args.width)
    mixed = random.random((3, *shape), np.float32)
    heads = random.random((1, KERNEL + 1, *shape), np.float32)
    filtered = {level: np.empty_like(mixed) for level in library.levels()}
    rows = {level: Rows(FILTER.name, level=level).bind((mixed, heads, np.float32(shape), out))
            for level, out in filtered.items()}
    times: dict[str, list[float]] = {level: [] for level in rows}
    for _ in range(args.runs + 1):
        for level, make in rows.items():
            began = time.perf_counter()
            make(0, args.height)
            times[level].append(1e3 * (time.perf_counter() - began))
    for level, found in filtered.items():
        difference = np.abs(found - filtered[library.levels()[-1]]).max()
        print(f"{level:>10} {statistics.median(times[level][1:]):9.3f} ms  difference "
              f"{difference:.1e}")


if __name__ == "__main__":
    main()
