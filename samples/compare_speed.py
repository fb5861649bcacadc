"""Time the whole pass chain against Open Image Denoise, in turn, in one run.

python samples/compare_speed.py [--width 960] [--height 540] [--runs 5] [--models m,s]

It needs pip install 'postfx[bench]'. postfx turns noisy frames of the given size into twice as large, tone-mapped ones.
OIDN (high quality, clean albedo and normal) denoises a frame of the same size and one of the output's size. Prints
medians, spread and ratios.
"""
import argparse
import resource
import statistics
import time

import numpy as np

import postfx
from postfx.frame import ROLES

PLANES = ("colour", "depth", "motion", "normal", "diffuse_albedo", "specular_albedo", "roughness")
OTHER = "OIDN high, render size"


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
    parser.add_argument("--models", default="m.fp32,m,s", help="tags of networks, comma-separated")
    args = parser.parse_args()
    frame = noisy_frame(args.width, args.height)
    chains = {f"postfx {tag}": postfx.Pipeline([postfx.DenoiseUpscale(scale=2, model=tag), postfx.ToneMap()])
              for tag in args.models.split(",")}
    for chain in 2 * list(chains.values()):
        timed(chain, frame)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    ways = {name: lambda chain=chain: timed(chain, frame) for name, chain in chains.items()}
    ways |= {OTHER: lambda: oidn(frame, 1), "OIDN high, output size": lambda: oidn(frame, 2)}
    seconds = {name: [] for name in ways}
    for _ in range(args.runs):
        for name, way in ways.items():
            seconds[name].append(way())
    other = statistics.median(seconds[OTHER])
    for name, found in seconds.items():
        middle = statistics.median(found)
        print(f"{name:24} median {1000 * middle:7.0f} ms  ({1000 * min(found):.0f} to {1000 * max(found):.0f})  "
              f"{middle / other:.2f}x of {OTHER}")
    for name, chain in chains.items():
        print(name, {part: f"{ms:.0f} ms" for part, ms in chain.timings.items()})
    print(f"peak memory of postfx, all of these models ready, {peak:.0f} MB")


if __name__ == "__main__":
    main()
