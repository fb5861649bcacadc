"""Time of the kernels of frames between frames as a share of what the Numba forms of an earlier commit took, and how
their results differ.

    python -m tests.kernels.between_times COMMIT [--level vnni | --tree FOLDER]

The earlier commit makes frames between four of 270x480, and keeps what its kernels are called with. Both run the same
calls in processes of one thread that take turns. With a folder that holds the commit and has run before, nothing is
compiled again, and only this processor's own level is measured. It prints the medians of processor time, their ratio,
and the largest difference in units of the largest value.
"""

from __future__ import annotations

import argparse
import os
import pickle
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from postfx.interpolate import choose, flow
from postfx.kernels import native
from postfx.kernels.library import Rows, levels
from tests.kernels.kernel_times import NUMBAS, difference, unpack

TURNS = 9
PASSES = 5
"""Runs of a kernel that are timed at once."""
WORKER = r"""
import copy, pickle, sys, threading, time
import numpy as np
import postfx.interpolate as between
from postfx.frame import Frame, Role
from postfx.interpolate import blend, choose, flow, paths, timing
from postfx.io import estimated_motion
from postfx.temporal import reverse_motion
modules = [between, flow, paths, timing, choose, blend, reverse_motion, estimated_motion]


def scene(height, width, count):
    rng = np.random.default_rng(0)
    phases, waves = rng.uniform(0, 6, (6, 3)), rng.normal(0, 0.25, (6, 2))
    y, x = np.indices((height, width)).astype(float)
    spots = rng.uniform(0, 1, (12, 2)) * (height, width)

    def wall(x, y):
        shades = [sum(np.sin(x * a + y * b + phase[k]) for (a, b), phase in zip(waves, phases)) for k in range(3)]
        return np.exp(0.5 * np.stack(shades, -1))

    for n in range(count):
        colour, motion = wall(x + 3.3 * n, y - 1.6 * n), np.broadcast_to((3.3, -1.6), (height, width, 2)).copy()
        there = (np.abs(x - 190 - 7 * n) < 65) & (np.abs(y - 135 - 2 * n) < 55)
        colour[there], motion[there] = (3 * wall(2 * x - 14 * n, 2 * y - 4 * n))[there], (-7, -2)
        still = y > 230
        colour[still], motion[still] = (wall(x, y) * (1 + 0.3 * n))[still], 0
        for down, right in spots:
            colour[np.hypot(y - down - 3 * n, x - right + 5 * n) < 1.3] = 2000
        colour *= 1 + 0.02 * rng.normal(size=colour.shape)
        motion[rng.random((height, width)) < 0.01] = 1e10
        depth = np.where(there, 2.0, 9.0)[..., None]
        planes = {Role.COLOUR: colour, Role.MOTION: motion, Role.DEPTH: depth, Role.ALPHA: there[..., None] * 1.0,
                  Role.NORMAL: np.clip(colour, 0, 1), Role.DIFFUSE_ALBEDO: np.clip(colour / 4, 0, 1)}
        yield Frame({role: np.ascontiguousarray(plane, np.float32) for role, plane in planes.items()}, number=n + 1)


def make():
    frames = list(scene(270, 480, 4))
    first = between.Between(*frames[:3])
    first.frame(0.25)
    between.Between(*frames[1:], last=first).frame(0.6)
    flowing = [Frame({Role.COLOUR: frame[Role.COLOUR]}) for frame in frames[:2]]
    between.Between(*flowing).frame(0.4)
    lengths = reverse_motion.HistoryLength()
    one, other = [lengths(frame) for frame in frames[:2]]
    share = np.empty(one.shape, np.float32)
    reverse_motion.share_by_length(one, other, share)
    reverse_motion.premultiply(share, frames[0][Role.COLOUR], np.empty((*share.shape, 4), np.float32))
    estimated_motion.motion_of(frames[1], frames[0])


make()
known, kept, lock = {}, {}, threading.Lock()


def watch(name, function):
    def call(*arguments):
        before = copy.deepcopy(arguments)
        function(*arguments)
        size = sum(one.size for one in arguments if isinstance(one, np.ndarray))
        with lock:
            if size > kept.get(name, (0,))[0]:
                kept[name], known[name] = (size, before, copy.deepcopy(arguments)), function

    return call


for module in modules:
    for name, function in list(vars(module).items()):
        if hasattr(function, "py_func"):
            setattr(module, name, watch(name, function))
for module in modules:
    if hasattr(module, "in_bands"):
        module.in_bands = lambda height, kernel, *arguments: kernel(0, height, *arguments)
make()
with open(sys.argv[1], "wb") as file:
    pickle.dump({name: call[1:] for name, call in kept.items()}, file)
print("ready", flush=True)
for line in sys.stdin:
    name, times = line.split()
    total = 0.0
    for _ in range(int(times)):
        arguments = copy.deepcopy(kept[name][1])
        begin = time.thread_time()
        known[name](*arguments)
        total += time.thread_time() - begin
    print(total / int(times), flush=True)
"""
FORMS: dict[str, tuple[str, str]] = {
    "splat": ("reverse_splat", "0 1 2 3"),
    "fill_cracks": ("reverse_fill_cracks", "0 1 2 3"),
    "extend_history": ("reverse_extend_history", "0 1 2 3 (4) 5"),
    "share_by_length": ("reverse_share_by_length", "0 1 2"),
    "premultiply": ("reverse_premultiply", "0 1 2"),
    "shade": ("estimate_shade", "0 1 (2) 3"),
    "smooth": ("estimate_smooth", "0 1"),
    "differ": ("estimate_differ", "0 1 2 3"),
    "average_rows": ("estimate_average", "0 1 @0"),
    "move": ("estimate_move", "(0,1,3,4,5) 2 6"),
    "put": ("estimate_put", "0 1 (2,3,4) 5"),
    "average_fours": ("average_fours", "0 (1) 2"),
    "enlarge": ("enlarge_flow", "0 1"),
    "keep_consistent": ("keep_consistent", "0 1 (2) 3"),
    "move_flow": ("move_flow", "0 1 2 3 (4,5) 6 7"),
    "find_overlay": ("find_overlay", "0 1 2 (3) 4"),
    "gather_cells": ("gather_cells", "0 1 (2,3) 4 5"),
    "rank_paths": ("rank_paths", "0 1 2 3"),
    "close_cracks": ("close_cracks", "0 1 2"),
    "fill_holes": ("fill_holes", "1 0"),
    "grow_marks": ("grow_marks", "0"),
    "tone_rows": ("tone_rows", "2 (3,4) 5"),
    "refine": ("refine_inverse", "2 3"),
    "lead_back": ("lead_back", "2 3 4 5 6 7 8 9 10"),
    "lead_ahead": ("lead_ahead", "3 2 4 5 6 7 8 9 10"),
    "merge_sides": ("merge_sides", "2 4 3 5 (6) 7"),
    "measure_change": ("measure_change", "2 3 (4) 5"),
    "join_cells": ("join_cells", "2"),
    "curve_rows": ("curve_light", "2 3 4 5 6 7 8 9 10 11 12 (13,14) 15"),
    "brightest_rows": ("brightest_cells", "2 (3) 4"),
    "mark_sparks": ("mark_sparks", "2 (3,4) 5"),
    "search": ("search_flow", "m0 m1 4 5"),
    "spread": ("spread_flow", "m0 m1 4 5 @5"),
    "splat_nearest": ("splat_nearest", "0 1 2 t3 4"),
    "splat_means": ("splat_means", "0 1 2 3 t4 5 c6 @5"),
    "choose_paths": ("choose_paths", "m2 m3 4 5 6 7 8 16 17 9 10 11 12 14 13 15 c18 c19 (20,21,22) 23"),
    "measure_detail": ("measure_detail", "m2 m3 4 4 (0,5,6) 7"),
    "misfits": ("measure_misfits", "m0 m1 2 3 4 5 (6) 7"),
    "compose": ("compose", "2 4 5 6 7 8 9 14 15 17 18 n 13 16 19 22 @13"),
}
"""Kernels in C++ by the name of the former function, and their arrays, by the places of its arguments: a number is an
array, (numbers) are numbers in one, m is a flat picture with margins, t a time with its share of bends, c a plane of
another shape, n what `compose` mixes by; after @ stands the array that has as many rows as there are. Those that take
rows had the first and the last one in front."""
IN_ROWS = {"tone_rows", "refine", "lead_back", "lead_ahead", "merge_sides", "measure_change", "join_cells",
           "curve_rows", "brightest_rows", "mark_sparks", "choose_paths", "measure_detail", "compose"}


def array_of(name: str, word: str, given: Sequence[Any]) -> np.ndarray:
    """An array that a kernel takes, by its word in `FORMS`."""
    if word[0] == "(":
        return np.hstack([given[int(place)] for place in word[1:-1].split(",")]).astype(np.float32)
    if word == "n":
        time, scale, masked, level, *back = (given[place] for place in (11, 3, 10, 12, 20, 21))
        return np.array((time, scale, np.float32(0.05) * np.float32(level), masked, *back), np.float32)
    place = int(word.lstrip("mtc"))
    if word[0] == "t":
        return np.array((given[place], given[place] * (given[place] - 1)), np.float32)
    array: np.ndarray = given[place]
    if word[0] == "m":
        height, width = given[2:4] if name in ("search", "spread") else next(
            one.shape for one in given if isinstance(one, np.ndarray) and one.dtype == bool)
        margin = flow.MARGIN if name in ("search", "spread") else choose.MARGIN
        return array.reshape(height + 2 * margin, width + 2 * margin)
    if word[0] == "c":
        return array.reshape(*given[5].shape, 8) if name == "splat_means" else array[..., 0]
    return array


def measure(name: str, ask: Callable[[str], float], given: Sequence[Any], wanted: Sequence[Any], level: str) -> str:
    """A line of a kernel."""
    kernel, text = FORMS[name]
    words = [word for word in text.split() if word[0] != "@"]
    arrays = [np.ascontiguousarray(array_of(name, word, given)) for word in words]
    rows = Rows(kernel, level=level)
    last = len(given[int(text.partition("@")[2])]) if "@" in text else len(arrays[-1])
    first, last = given[:2] if name in IN_ROWS else (0, last)
    copies = [array.copy() for array in arrays]
    rows(first, last, *copies)
    off = max(difference(np.ascontiguousarray(array_of(name, word, wanted)), found)
              for word, found in zip(words, copies, strict=True) if found.size)
    times = []
    for _ in range(TURNS):
        total = 0.0
        for _ in range(PASSES):
            run = rows.bind([array.copy() for array in arrays])
            begin = time.thread_time()
            run(first, last)
            total += time.thread_time() - begin
        times.append((ask(f"{name} {PASSES}"), total / PASSES))
    old, new = (statistics.median(column) for column in zip(*times, strict=True))
    ratio = statistics.median(after / before for before, after in times)
    return f"{name} {level}: {1e3 * old:.3g} ms before, {1e3 * new:.3g} ms now, ratio {ratio:.2f}, difference {off:.0e}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("commit")
    parser.add_argument("--level", nargs="+", default=["v3", "vnni"], choices=NUMBAS)
    parser.add_argument("--tree", type=Path)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        before = options.tree or unpack(options.commit, Path(folder))
        for level in [levels()[-1]] if options.tree else options.level:
            calls = Path(folder) / "calls"
            target = {} if options.tree else native.target_of(NUMBAS[level])
            environment = os.environ | target | {"PYTHONPATH": str(before)}
            with subprocess.Popen([sys.executable, "-c", WORKER, str(calls)], cwd=before, env=environment, text=True,
                                  stdin=subprocess.PIPE, stdout=subprocess.PIPE) as worker:
                source, target = worker.stdout, worker.stdin
                assert source and target
                source.readline()

                def ask(line: str, source: Any = source, target: Any = target) -> float:
                    target.write(line + "\n")
                    target.flush()
                    return float(source.readline())

                for name, (given, wanted) in sorted(pickle.loads(calls.read_bytes()).items()):
                    if name in FORMS:
                        print(measure(name, ask, given, wanted, level), flush=True)
                target.close()


if __name__ == "__main__":
    main()
