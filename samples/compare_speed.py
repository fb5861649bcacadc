"""Time the whole pass chain against Open Image Denoise, in turn, in one run.

python samples/compare_speed.py [--width 960] [--height 540] [--runs 5]     needs: pip install 'postfx[bench]'

postfx turns noisy frames of the given size into twice as large, tone-mapped ones. OIDN (high quality, clean albedo
and normal) denoises a frame of the same size and one of the output's size. Prints medians, spread and ratios.
"""
import argparse
import resource
import statistics
import time

import numpy as np

import postfx
from postfx.frame import ROLES

PLANES = ("colour", "depth", "motion", "normal", "diffuse_albedo", "specular_albedo", "roughness")


def noisy_frame(width: int, height: int) -> postfx.Frame:
    """Random planes of sensible ranges: the time does not depend on what is in the picture."""
    rng = np.random.default_rng(1)
    planes = {role: rng.random((height, width, ROLES[postfx.Role(role)].channels), np.float32) for role in PLANES}
    planes["depth"] += 1
    return postfx.Frame({postfx.Role(role): plane for role, plane in planes.items()}, jitter=(0.25, -0.25))


def oidn(frame: postfx.Frame, scale: int) -> float:
    import pyoidn

    planes = [np.ascontiguousarray(np.tile(frame[role], (scale, scale, 1)))
              for role in (postfx.Role.COLOUR, postfx.Role.DIFFUSE_ALBEDO, postfx.Role.NORMAL)]
    began = time.perf_counter()
    pyoidn.denoise(planes[0], albedo=planes[1], normal=planes[2], hdr=True, clean_aux=True, quality="high")
    return time.perf_counter() - began


def timed(chain: postfx.Pipeline, frame: postfx.Frame) -> float:
    began = time.perf_counter()
    chain(frame)
    return time.perf_counter() - began


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--width", type=int, default=960)
    parser.add_argument("--height", type=int, default=540)
    parser.add_argument("--runs", type=int, default=5)
    args = parser.parse_args()
    frame = noisy_frame(args.width, args.height)
    chain = postfx.Pipeline([postfx.DenoiseUpscale(scale=2), postfx.ToneMap()])
    for _ in range(2):
        timed(chain, frame)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    rows = {"postfx": [], "OIDN high, render size": [], "OIDN high, output size": []}
    for _ in range(args.runs):
        rows["postfx"].append(timed(chain, frame))
        rows["OIDN high, render size"].append(oidn(frame, 1))
        rows["OIDN high, output size"].append(oidn(frame, 2))
    ours = statistics.median(rows["postfx"])
    for name, seconds in rows.items():
        middle = statistics.median(seconds)
        print(f"{name:24} median {1000 * middle:7.0f} ms  ({1000 * min(seconds):.0f} to {1000 * max(seconds):.0f})  "
              f"postfx takes {ours / middle:.2f}x")
    print("passes", {name: f"{ms:.0f} ms" for name, ms in chain.timings.items()})
    print(f"peak memory of postfx {peak:.0f} MB")


if __name__ == "__main__":
    main()
