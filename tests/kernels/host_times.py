"""Time of what the host looks at in a frame's planes as a share of that in an earlier commit, and
how answers differ.

    python -m tests.kernels.host_times COMMIT [--calls exposure cuts] [--level v3 vnni]

Both commits call the same functions with the same random planes of 1920x1080, in processes of one
thread that take turns in one run. It prints the medians of processor time, their ratio, and the
largest difference in units of the largest value.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Sequence
from pathlib import Path

from postfx.compiled.build import X86_64
from tests.kernels.kernel_times import ROOT, Side, in_turn, unpack

CALLS = {
    "exposure": "measure(colour)",
    "cuts": "relate(colour)",
    "cells of alpha": "near_cells(alpha)",
    "noise of depth": "shows_volume(depth[..., None])",
    "active cells": "active_cells(strength)",
    "bad pixels": "repair_nonfinite(Frame({Role.COLOUR: colour}), (Role.COLOUR,))[1] == {}",
    "copy": "copy(colour, kept)",
    "interpolation: finite": "pictures.finite(colour) is colour",
    "half floats": "to_halves(colour)",
    "8 bits with dither": "quantise(colour, 8, Dither.STATIC)",
    "PNG's filter": "filtered(quantise(colour, 8, Dither.NONE))",
    "chunk of ZIP, there and back": "packed(to_halves(colour[:16]))",
    "channels put together": "widened(words)",
}
WORKER = """
import sys, time
import numpy as np
from postfx.interpolate import pictures
from postfx.cuts import CutDetector
from postfx.exposure import measure
from postfx.frame import Frame, Role
from postfx.io.exr.picture import to_halves
from postfx.io.quantisation import Dither, quantise
from postfx.compiled import library
from postfx.io import pixel_formats
from postfx.kernels.denoise.alpha import near_cells
from postfx.passes.denoise.planes import shows_volume
from postfx.passes.denoise.activity import active_cells
from postfx.repair import repair_nonfinite
from postfx.runtime.memory import HostMemory
call, level = sys.argv[1:]
library.levels = lambda: ("baseline", level)
random = np.random.default_rng(1)
shown = np.kron(random.normal(-2, 2, (27, 48, 1)), np.ones((40, 40, 3)))
colour = np.exp2(shown + random.normal(0, 1, shown.shape)).astype(np.float32)
normal = np.clip(shown / 8 + random.normal(0, 0.1, shown.shape), -1, 1).astype(np.float32)
depth = np.where(random.random((1080, 1920)) < 0.2, np.float32(1e10), colour[..., 0])
alpha = np.clip(normal[..., 0], 0, 1)
strength = np.where(random.random((1080, 1920, 1)) < 0.001, np.float32(1), np.float32(0))
motion = random.normal(0, 3, (1080, 1920, 2)).astype(np.float32)
planes = {Role.COLOUR: colour, Role.NORMAL: normal, Role.DEPTH: depth[..., None],
          Role.MOTION: motion}
frames = [Frame(dict(planes)), Frame(planes | {Role.COLOUR: colour + colour[:, ::-1] / 2})]
kept = np.zeros_like(colour)


def relate(colour):
    detector = CutDetector()
    for frame in frames:
        detector(frame)
    return detector.relation


def copy(source, target):
    HostMemory().copy(target.ctypes.data, source.ctypes.data, source.nbytes)
    return target[::100]


words = random.integers(0, 1 << 16, (1080, 3 * 1920)).astype(np.uint16)


def filtered(codes):
    rows = codes.reshape(1080, -1)
    found = np.empty((1080, rows.shape[1] + 1), np.uint8)
    pixel_formats.paeth(rows, np.zeros_like(rows[0]), 3, found)
    return found


def packed(halves):
    lines = np.ascontiguousarray(halves).view(np.uint8).reshape(16, -1)
    found = np.empty(lines.size // 2, np.uint16)
    pixel_formats.decompress_rows(pixel_formats.compress_rows(lines), found)
    return found


def widened(words):
    found = np.empty((1080, 1920, 3), np.float32)
    channels = np.array([(1, 0), (1, 1920), (1, 3840)])
    library.Rows("widen_rows")(0, len(words), words, channels, found)
    return found


call = compile(call, "call", "eval")
np.savez(sys.stdin.readline().strip(), eval(call))
print("ready", flush=True)
for line in sys.stdin:
    times = int(line)
    begin = time.thread_time()
    for _ in range(times):
        eval(call)
    print((time.thread_time() - begin) / times, flush=True)
"""


class Call(Side):
    """A process that calls one of these functions; `results` are what it answered the first
    time."""

    worker = WORKER

    def _begin(self, tree: Path, words: Sequence[str], level: str) -> None:
        super()._begin(tree, [":".join(words[:-1])], level)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("commit")
    parser.add_argument("--calls", nargs="+", default=[*CALLS], choices=CALLS)
    parser.add_argument("--level", nargs="+", default=["v3", "vnni"], choices=X86_64)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        before = unpack(options.commit, Path(folder))
        for name in options.calls:
            for level in options.level:
                sides = [Call(tree, CALLS[name], Path(folder), level) for tree in (before, ROOT)]
                print(f"{name} {level}: {in_turn(sides)}", flush=True)


if __name__ == "__main__":
    main()
