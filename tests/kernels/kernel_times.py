"""Time of kernels as a share of what they took in an earlier commit, and how far their results
differ.

    python -m tests.kernels.kernel_times COMMIT MODULE:KERNEL ... [--level v3 vnni]

such as `denoise.alpha:FIT` or `samples.mlp_in_kernel:ONE`, at levels of the processor: those of
`build.py`. Both commits run the same random arguments of 960x544, enlarged to twice that size, or
16384 points of a network, in processes of one thread that take turns in one run. It prints the
medians of processor time, their ratio, and the largest difference in units of the largest value.
"""

from __future__ import annotations

import argparse
import os
import statistics
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from postfx.compiled.build import X86_64
from postfx.kernels import Kernel
from tests.kernels import denoise_cases, neural_cases, tonemap_cases

ROOT = Path(__file__).resolve().parents[2]
HEIGHT, WIDTH = 544, 960
SECONDS = 2.0
"""Of processor time that each commit gets a kernel and level, about."""
LEAST_TURNS, MOST_TURNS = 7, 101
WORKER = """
import sys, time
from importlib import import_module
import numpy as np
module, name, folder, level = sys.argv[1:]
from postfx.compiled.calls import bind_rows
kernel = getattr(import_module(module), name)
rows = kernel.rows
if type(rows).__name__ == "Rows":
    rows = type(rows)(rows.name, rows.header, level)
given = np.load(folder + "/given.npz")
names = dict.fromkeys((*kernel.reads, *kernel.writes))
arrays, count = [given[name] for name in names], int(given["number of rows"])
rows(0, count, *arrays)
written = (array for name, array in zip(names, arrays) if name in kernel.writes)
np.savez(sys.stdin.readline().strip(), *written)
print("ready", flush=True)
run = bind_rows(rows, arrays)
for line in sys.stdin:
    times = int(line)
    begin = time.thread_time()
    for _ in range(times):
        run(0, count)
    print((time.thread_time() - begin) / times, flush=True)
"""


class Side:
    """A process that runs a kernel of a commit; `results` are what it wrote the first time."""

    worker = WORKER

    def __init__(self, tree: Path, kernel: str, folder: Path, level: str) -> None:
        self._begin(tree, [*kernel.split(":"), str(folder)], level)
        kept = folder / f"{tree.name}.npz"
        self._say(str(kept))
        found = np.load(kept)
        self.results = [found[name] for name in found.files]

    def _begin(self, tree: Path, words: Sequence[str], level: str) -> None:
        environment = os.environ | {"PYTHONPATH": str(tree)}
        self._process = subprocess.Popen([sys.executable, "-c", self.worker, *words, level],
                                         cwd=tree, env=environment,
                                         stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)

    def _say(self, line: str) -> str:
        assert self._process.stdin and self._process.stdout
        self._process.stdin.write(line + "\n")
        self._process.stdin.flush()
        answer = self._process.stdout.readline()
        if not answer:
            sys.exit("a kernel could not be run: see above")
        return answer

    def seconds(self, times: int = 1) -> float:
        """Mean processor time of some more runs."""
        return float(self._say(f"{times}"))

    def end(self) -> None:
        self._process.communicate()


def arguments(module: str, kernel: Kernel) -> tuple[dict[str, np.ndarray], int]:
    """What a kernel reads and writes, and how many rows it has."""
    if module == "samples.mlp_in_kernel":
        return neural_cases.shading(HEIGHT, WIDTH), HEIGHT
    if kernel in neural_cases.KERNELS:
        given = neural_cases.arguments(kernel)
        return given, neural_cases.rows_of(kernel, given)
    if module.startswith("denoise.") or kernel in (*denoise_cases.KERNELS,
                                                   *denoise_cases.IN_ROWS_ALONE):
        case = denoise_cases.Case(HEIGHT, WIDTH, 2 * HEIGHT, 2 * WIDTH)
        given = denoise_cases.arguments(kernel, case)
        sizes = {name: denoise_cases.shape(kernel, name, case) for name in kernel.writes}
    else:
        given = tonemap_cases.arguments(kernel, HEIGHT, WIDTH)
        known = {"height": HEIGHT, "width": WIDTH}
        sizes = {name: tuple(size if isinstance(size, int) else known[size]
                             for size in kernel.shapes[name])
                 for name in kernel.writes}
    written = {name: np.zeros(size, kernel.types.get(name, "float32"))
               for name, size in sizes.items()}
    name, axis = kernel.row_axis
    return given | written, written[name].shape[axis]


def compare(before: Path, kernel: str, level: str) -> str:
    """A line of a kernel at a level."""
    module, _, name = kernel.partition(":")
    place = module if module.startswith("samples.") else f"postfx.kernels.{module}"
    given, rows = arguments(module, getattr(import_module(place), name))
    with tempfile.TemporaryDirectory() as folder:
        kept: dict[str, Any] = {**given, "number of rows": rows}
        np.savez(Path(folder) / "given.npz", **kept)
        sides = [Side(tree, f"{place}:{name}", Path(folder), level) for tree in (before, ROOT)]
        return f"{kernel} {level}: {in_turn(sides)}"


def in_turn(sides: Sequence[Side]) -> str:
    """What two processes take in turn, and how far their results differ."""
    once = max(sides[0].seconds(), 1e-6)
    turns = min(max(int(SECONDS / once), LEAST_TURNS), MOST_TURNS)
    each = max(int(SECONDS / MOST_TURNS / once), 1)
    times = [[side.seconds(each) for side in sides] for _ in range(turns)]
    for side in sides:
        side.end()
    off = max(difference(*pair) for pair in zip(*(side.results for side in sides), strict=True))
    old, new = (statistics.median(column) for column in zip(*times, strict=True))
    ratios = statistics.median(after / earlier for earlier, after in times)
    return (f"{1e3 * old:.3g} ms before, {1e3 * new:.3g} ms now, ratio {ratios:.2f}, difference "
            f"{off:.0e}")


def difference(one: np.ndarray, other: np.ndarray) -> float:
    """The largest one between numbers that are finite in both, in units of the largest; infinite if
    NaN and infinity are at other places."""
    finite = np.isfinite(one)
    if not np.array_equal(one[~finite], other[~finite], equal_nan=True):
        return float("inf")
    apart = np.abs(one[finite].astype(float) - other[finite])
    return float(apart.max(initial=0) / max(np.abs(one[finite]).max(initial=0), 1e-30))


def unpack(commit: str, folder: Path) -> Path:
    """The sources of a commit, in a folder of their own."""
    tree = folder / "before"
    tree.mkdir()
    packed = subprocess.run(["git", "archive", commit, "postfx", "samples"], cwd=ROOT, check=True,
                            capture_output=True).stdout
    subprocess.run(["tar", "-x"], cwd=tree, input=packed, check=True)
    (tree / "models").symlink_to(ROOT / "models")
    return tree


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("commit")
    parser.add_argument("kernels", nargs="+", metavar="MODULE:KERNEL")
    parser.add_argument("--level", nargs="+", default=["v3", "vnni"], choices=X86_64)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        before = unpack(options.commit, Path(folder))
        for kernel in options.kernels:
            for level in options.level:
                print(compare(before, kernel, level), flush=True)


if __name__ == "__main__":
    main()
