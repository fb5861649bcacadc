"""What windows of the denoised upscaler take beside their pixels: postfx.passes.denoise.tiling
counts on it.

python samples/window_cost.py [--width 960] [--height 540] [--runs 5] [--model m]

Some squares of a frame have strength, so that windows of several sizes and numbers are worked on;
and the whole frame without a mask. Prints the processor time of each (medians of runs in turn), and
its least-squares fit by a part for each frame with windows, each window, and each render pixel in
them, in pixels of the whole frame.
"""
import argparse
import statistics
import time

import numpy as np
from compare_speed import noisy_frames

import postfx
from postfx import Role

SQUARES = ((1, 32), (1, 160), (1, 320), (2, 32), (2, 128), (4, 32), (4, 64))
"""How many, and their side in render pixels."""


def with_squares(frame: postfx.Frame, count: int, side: int) -> postfx.Frame:
    """The frame with strength in squares that are far from each other."""
    height, width = frame[Role.COLOUR].shape[:2]
    strength = np.zeros((height, width, 1), np.float32)
    for i in range(count):
        top, left = (height - side) * (i % 2), (width - side) * (i // 2 if count > 2 else i)
        strength[top:top + side, left:left + side] = 1
    return postfx.Frame({**frame.planes, Role.STRENGTH: strength}, jitter=frame.jitter)


Way = tuple[postfx.Pipeline, list[postfx.Frame]]
"""A chain, and frames to run in turn."""


def chain_of(frames: list[postfx.Frame], model: str) -> Way:
    return postfx.Pipeline([postfx.DenoiseUpscale(scale=2, model=model)]), frames


def measure(ways: list[Way], runs: int) -> list[float]:
    """Milliseconds of processor time of each, medians of runs in turn."""
    times: list[list[float]] = [[] for _ in ways]
    for run in range(runs + 2):
        for (chain, frames), some in zip(ways, times, strict=True):
            began = time.process_time()
            chain(frames[run % len(frames)])
            some.append(1e3 * (time.process_time() - began))
    return [statistics.median(some[2:]) for some in times]


def windows_of(chain: postfx.Pipeline, frames: list[postfx.Frame]) -> tuple[int, int]:
    """How many windows a frame was worked on in, and their render pixels."""
    from postfx.passes.denoise.activity import active_cells

    band = chain.passes[0]._ready.networks.layout(active_cells(frames[0][Role.STRENGTH]))
    pixels = sum(tile.window.rows * tile.window.columns for tile in band.tiles) if band else 0
    return (len(band.tiles) if band else 0), pixels


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--width", type=int, default=960)
    parser.add_argument("--height", type=int, default=540)
    parser.add_argument("--runs", type=int, default=5)
    parser.add_argument("--model", default="m")
    args = parser.parse_args()
    frames = noisy_frames(args.width, args.height)
    masked = [chain_of([with_squares(frame, *each) for frame in frames], args.model)
              for each in SQUARES]
    *times, whole = measure([*masked, chain_of(frames, args.model)], args.runs)
    found = [windows_of(*way) for way in masked]
    for (count, pixels), spent in zip(found, times, strict=True):
        print(f"{count} windows, {pixels:7} pixels: {spent:6.1f} ms")
    rows = [(1, count, pixels) for count, pixels in found if count]
    (frames, window, pixel), *_ = np.linalg.lstsq(
        np.array(rows, float),
        [spent for (count, _), spent in zip(found, times, strict=True) if count])
    one = whole / (args.width * args.height)
    print(f"whole frame: {whole:.0f} ms, {1e6 * one:.0f} ns a pixel; with windows "
          f"{1e6 * pixel:.0f} ns a pixel, {window:.1f} ms a window = {window / one:.0f} pixels, "
          f"{frames:.1f} ms a frame = {frames / one:.0f} pixels")


if __name__ == "__main__":
    main()
