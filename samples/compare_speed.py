"""Time the whole pass chain against Open Image Denoise, in turn, in one run.

    python samples/compare_speed.py [--width 960] [--height 540] [--runs 5] [--models m,s]
        [--centred]
    python samples/compare_speed.py --device cuda --runs 50 --models s,m

It needs pip install '.[bench]', on a GPU also PyTorch with CUDA. postfx turns noisy frames of the
given size into twice as large, tone-mapped ones, or by --scale 1 into ones of the same size. OIDN
(clean albedo and normal) denoises a frame of the same size, and one of the output's size, and one
whose albedo and normal it filters first, as Blender has it. Prints medians, spread and ratios. On
the CPU times are those of whole calls, but for the copies of the three filters. On a GPU they are
the device's own, between its first and last command: all planes lie there for both, and nothing is
copied.

Frames have jitter, as a game's do; without it (--centred) 'xl' enlarges in two stages.
"""
import argparse
import resource
import statistics
import time
from dataclasses import replace
from functools import cache, partial

import numpy as np

import postfx
from postfx.frame import ROLES
from postfx.oidn import OpenImageDenoise
from postfx.passes import Pass
from postfx.passes.registry import create
from postfx.runtime import Device
from postfx.system import usable_cores

PLANES = ("colour", "depth", "motion", "normal", "diffuse_albedo", "specular_albedo", "roughness")


def noisy_frame(width: int, height: int) -> postfx.Frame:
    """Random planes of sensible ranges: the time does not depend on what is in the picture."""
    rng = np.random.default_rng(1)
    planes = {role: rng.random((height, width, ROLES[postfx.Role(role)].channels), np.float32)
              for role in PLANES}
    planes["depth"] += 1
    return postfx.Frame({postfx.Role(role): plane for role, plane in planes.items()},
                        jitter=(0.25, -0.25))


def noisy_frames(width: int, height: int, centred: bool = False) -> list[postfx.Frame]:
    """Two frames with other noise, to take in turn: one that repeats the frame before it, bit for
    bit, is not denoised again. `centred`: without jitter."""
    random = np.random.default_rng(2)
    frames = [noisy_frame(width, height) for _ in range(2)]
    for plane in frames[1].planes.values():
        random.shuffle(plane)  # rows: the same values at other places
    return [replace(frame, jitter=(0.0, 0.0)) for frame in frames] if centred else frames


def oidn_on_cpu(frame: postfx.Frame, scale: int, quality: str) -> float:
    """Milliseconds of a call."""
    import pyoidn

    planes = oidn_planes(frame, scale)
    began = time.perf_counter()
    pyoidn.denoise(planes[0], albedo=planes[1], normal=planes[2], hdr=True, clean_aux=True,
                   quality=quality)
    return 1e3 * (time.perf_counter() - began)


def prefiltered_oidn(frame: postfx.Frame, quality: str, device: str) -> float:
    """Milliseconds of its three filters, without copies: albedo and normal each alone, then
    colour."""
    colour, albedo, normal = oidn_planes(frame, 1)
    filters = three_filters(quality, device)
    before = filters.milliseconds
    filters(colour, {"albedo": albedo, "normal": normal}, np.empty_like(colour))
    return filters.milliseconds - before


@cache
def three_filters(quality: str, device: str) -> OpenImageDenoise:
    return OpenImageDenoise(quality, device, threads=usable_cores())


def oidn_on_gpu(frame: postfx.Frame, scale: int, quality: str) -> float:
    """Milliseconds on the current stream."""
    import pyoidn
    import torch

    planes = [torch.from_numpy(plane).cuda() for plane in oidn_planes(frame, scale)]
    begin, end = (torch.cuda.Event(enable_timing=True) for _ in range(2))
    for _ in range(2):  # the first call at another size makes the filter anew
        begin.record()
        pyoidn.denoise(planes[0], albedo=planes[1], normal=planes[2], hdr=True, clean_aux=True,
                       quality=quality)
        end.record()
    torch.cuda.synchronize()
    return begin.elapsed_time(end)


def oidn_planes(frame: postfx.Frame, scale: int) -> list[np.ndarray]:
    return [np.ascontiguousarray(np.tile(frame[role], (scale, scale, 1)))
            for role in (postfx.Role.COLOUR, postfx.Role.DIFFUSE_ALBEDO, postfx.Role.NORMAL)]


def denoising_passes(tag: str, scale: int, partner: str) -> list[Pass]:
    """The passes of `postfx run --model TAG`, with `--with` if a partner is named."""
    denoiser = postfx.DenoiseUpscale(scale=scale, model=tag)
    if not partner:
        return [denoiser]
    return [create("partner", of=partner), denoiser,
            create("mix_partner", scale=scale, model=tag)]


def timed(chain: postfx.Pipeline, frame: postfx.Frame) -> float:
    """Milliseconds of a call on the CPU, of its commands on a GPU."""
    began = time.perf_counter()
    chain(frame)
    called = 1e3 * (time.perf_counter() - began)
    return called if chain.device.memory.host_visible else sum(chain.timings.values())


def shown(milliseconds: float) -> str:
    return f"{milliseconds:.0f}" if milliseconds >= 100 else f"{milliseconds:.2f}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--width", type=int, default=960)
    parser.add_argument("--height", type=int, default=540)
    parser.add_argument("--runs", type=int, default=5)
    parser.add_argument("--scale", type=int, default=2, choices=(1, 2),
                        help="of postfx's output (default: 2)")
    parser.add_argument("--models", default="m.fp32,m,s",
                        help="tags of networks, comma-separated; xl+oidn runs OIDN beside xl")
    parser.add_argument("--centred", action="store_true", help="frames without jitter")
    parser.add_argument("--device", default="cpu", help="cpu (default) or cuda")
    parser.add_argument("--quality", default="high",
                        help="of OIDN: high (default), balanced, fast, some, or ''")
    args = parser.parse_args()
    frames = noisy_frames(args.width, args.height, args.centred)
    device = Device(args.device)
    chains = {}
    for name in args.models.split(","):
        tag, _, partner = name.partition("+")
        passes = denoising_passes(tag, args.scale, partner)
        chains[f"postfx {name}"] = postfx.Pipeline([*passes, postfx.ToneMap()], device)
    for frame in 2 * frames:
        for chain in chains.values():
            timed(chain, frame)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    ways = {name: partial(timed, chain) for name, chain in chains.items()}
    oidn = oidn_on_cpu if device.memory.host_visible else oidn_on_gpu
    for quality in filter(None, args.quality.split(",")):
        for scale, size in ((1, "render size"), (2, "output size"))[:args.scale]:
            ways[f"OIDN {quality}, {size}"] = partial(oidn, scale=scale, quality=quality)
        ways[f"OIDN {quality}, planes filtered"] = partial(prefiltered_oidn, quality=quality,
                                                           device=args.device)
    for way in ways.values():
        way(frames[-1])  # the filters are made; the first run has the other frame
    found: dict[str, list[float]] = {name: [] for name in ways}
    for run in range(args.runs):
        for name, way in ways.items():
            found[name].append(way(frames[run % len(frames)]))
    first = next((name for name in ways if name.startswith("OIDN")), next(iter(ways)))
    other = statistics.median(found[first])
    for name, times in found.items():
        middle = statistics.median(times)
        print(f"{name:28} median {shown(middle):>7} ms  ({shown(min(times))} to "
              f"{shown(max(times))})  {middle / other:.2f}x of {first}")
    for name, chain in chains.items():
        print(name, {part: f"{shown(ms)} ms" for part, ms in chain.timings.items()})
    print(f"peak memory of postfx, all of these models ready, {peak:.0f} MB")


if __name__ == "__main__":
    main()
