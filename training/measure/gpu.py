"""What a GPU makes of frames, and what it needs for it.

    python -m training.measure.gpu same [--size 640x360] [--frames 6] [--only 'xl 1x;l 1x']
    python -m training.measure.gpu memory [--models xl] [--sizes 1920x1080,3840x2160]
    python -m training.measure.gpu calls [--models s,m,xl] [--scale 1]
    python -m training.measure.gpu sharing
    python -m training.measure.gpu between
    python -m training.measure.gpu card
    python -m training.measure.gpu kernels [--models xl] [--scale 1]

`same` compares frames of the sample room with the CPU's by the same network in float32: PSNR and
the largest difference after x / (1 + x), and frames from a CUDA graph with those launched command
by command. `memory` is what a process takes of the GPU, each size in a process of its own. `calls`
are whole calls on planes of PyTorch, by the host's clock, beside the GPU's own time. `sharing` is
the host's time to take five planes and hand over one. `between` times frames between frames.
`card` measures copies, products and empty kernels of the GPU, `kernels` lists those of one frame.
`sharing`, `calls`, `card` and `kernels` need PyTorch with CUDA. Where one case fails, it says so
and goes on.
"""

from __future__ import annotations

import argparse
import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

import postfx
from postfx import Device, DeviceInterpolator, Frame, Pipeline, Role
from postfx.cli.options import parse_size
from postfx.passes.denoise.models import CLASSIC

ROOM = Path(__file__).resolve().parents[2] / "samples/room/noisy.####.exr"
THREADS = 8
"""Threads of the CPU that frames are compared with."""
ROLES = (Role.COLOUR, Role.DEPTH, Role.MOTION, Role.NORMAL, Role.DIFFUSE_ALBEDO)
"""Planes of `calls`, `sharing` and `kernels`."""
FRAMES_OF_MEMORY = 6
"""From the fourth on they are launched as a graph."""


class Chain(NamedTuple):
    """A pipeline to compare: the GPU's network, the CPU's, and options of the denoiser."""

    name: str
    on_gpu: str
    on_cpu: str
    scale: float
    kind: str = ""


CHAINS = (
    Chain("xl 1x", "xl", "xl", 1), Chain("l 1x", "l", "l.fp32", 1),
    Chain("m.fp32 1x", "m.fp32", "m.fp32", 1), Chain("s.fp32 1x", "s.fp32", "s.fp32", 1),
    Chain("m 1x", "m", "m.fp32", 1), Chain("s 1x", "s", "s.fp32", 1),
    Chain("classic 1x", CLASSIC, CLASSIC, 1), Chain("classic 1.5x", CLASSIC, CLASSIC, 1.5),
    Chain("classic 2x", CLASSIC, CLASSIC, 2),
    Chain("xl 1x, alpha", "xl", "xl", 1, "alpha"),
    Chain("xl 1x, a mask of strength", "xl", "xl", 1, "strength"),
    Chain("xl 1x, tone-mapped", "xl", "xl", 1, "toned"),
    Chain("m.fp32 1x, alpha", "m.fp32", "m.fp32", 1, "alpha"),
    Chain("m.fp32 2x, alpha", "m.fp32", "m.fp32", 2, "alpha"),
    Chain("m.fp32 2x, alpha by colours", "m.fp32", "m.fp32", 2, "alpha of samples"),
    Chain("classic 2x, alpha", CLASSIC, CLASSIC, 2, "alpha"),
    Chain("m.fp32 2x", "m.fp32", "m.fp32", 2), Chain("m 2x", "m", "m.fp32", 2),
    Chain("s 2x", "s", "s.fp32", 2), Chain("l 2x", "l", "l.fp32", 2),
    Chain("m.fp32 2x, parts", "m.fp32", "m.fp32", 2, "parts"),
    Chain("xl 1x, parts", "xl", "xl", 1, "parts"),
    Chain("xl 1x, a look that exposes", "xl", "xl", 1, "auto"),
)


@cache
def room(size: tuple[int, int]) -> tuple[Frame, ...]:
    """Frames of the sample room at a (width, height), by its nearest pixels."""
    frames = []
    for frame in postfx.read_sequence(ROOM):
        height, width = frame[Role.COLOUR].shape[:2]
        rows = np.arange(size[1]) * height // size[1]
        columns = np.arange(size[0]) * width // size[0]
        planes = {role: np.ascontiguousarray(plane[rows][:, columns])
                  for role, plane in frame.planes.items()}
        planes[Role.MOTION] = planes[Role.MOTION] * np.array(
            [size[0] / width, size[1] / height], np.float32)
        frames.append(replace(frame, planes=planes))
    return tuple(frames)


def with_more(frame: Frame, kind: str) -> Frame:
    """The frame with the planes that a chain's kind needs."""
    height, width = frame[Role.COLOUR].shape[:2]
    y, x = np.indices((height, width), np.float32)
    if kind == "strength":
        strength = ((x > width / 4) & (y > height / 3))[..., None].astype(np.float32)
        return replace(frame, planes={**frame.planes, Role.STRENGTH: strength})
    if kind.startswith("alpha"):
        soft = np.clip((x - width / 3) / (width / 8), 0, 1)[..., None]
        if kind == "alpha of samples":
            noise = np.random.default_rng(frame.number).random((height, width, 1))
            soft = (soft > noise).astype(np.float32)
        colour = frame[Role.COLOUR] * soft
        return replace(frame, planes={**frame.planes, Role.COLOUR: colour.astype(np.float32),
                                      Role.ALPHA: soft.astype(np.float32)})
    if kind == "parts":
        share = (0.3 * frame[Role.COLOUR]).astype(np.float32)
        return replace(frame, parts={"key": share, "rest": frame[Role.COLOUR] - share})
    return frame


def pictures(chain: Chain, model: str, frames: list[Frame],
             device: Device) -> list[dict[str, np.ndarray]]:
    """All that a chain gives for each frame."""
    options: dict[str, Any] = {"parts": ("key", "rest")} if chain.kind == "parts" else {}
    passes: list[Any] = [postfx.DenoiseUpscale(model=model, scale=chain.scale, **options)]
    if chain.kind == "toned":
        passes.append(postfx.ToneMap())
    if chain.kind == "auto":
        passes.append(postfx.ToneMap(look="auto"))
    pipeline = Pipeline(passes, device, exposure=0.0, cuts="none")
    found = []
    for frame in frames:
        result = pipeline(with_more(frame, chain.kind))
        planes = {str(role): result[role].copy() for role in (Role.COLOUR, Role.ALPHA)
                  if role in result.planes}
        planes.update({name: part.copy() for name, part in result.parts.items()})
        found.append(planes)
    return found


def shown(light: np.ndarray) -> np.ndarray:
    light = np.maximum(light.astype(np.float64), 0)
    return light / (1 + light)


def psnr(found: np.ndarray, wanted: np.ndarray) -> float:
    error = float(np.mean((shown(found) - shown(wanted)) ** 2))
    return 999.0 if error == 0 else -10 * float(np.log10(error))


def each(names: list[str], work: Callable[[str], str]) -> None:
    """Print what work says of each; a failure is a line, too."""
    for name in names:
        try:
            print(f"{name:30} {work(name)}", flush=True)
        except Exception as error:
            print(f"{name:30} failed: {type(error).__name__}: {error}"[:600], flush=True)


def same(size: tuple[int, int], count: int, only: list[str], device_name: str) -> None:
    frames = list(room(size)[:count])
    host = Device("cpu", threads=THREADS)
    graphed, single = Device(device_name), Device(device_name, graphs=False)
    chains = {chain.name: chain for chain in CHAINS}

    def compare(name: str) -> str:
        chain = chains[name]
        wanted = pictures(chain, chain.on_cpu, frames, host)
        found = pictures(chain, chain.on_gpu, frames, graphed)
        once = pictures(chain, chain.on_gpu, frames, single)
        assert all(made.keys() == right.keys()
                   for made, right in zip(found, wanted, strict=True)), "other planes"
        words = []
        for plane in wanted[0]:
            values = [psnr(made[plane], right[plane])
                      for made, right in zip(found, wanted, strict=True)]
            largest = max(float(np.abs(shown(made[plane]) - shown(right[plane])).max())
                          for made, right in zip(found, wanted, strict=True))
            graphs = max(float(np.abs(made[plane] - other[plane]).max())
                         for made, other in zip(found, once, strict=True))
            words.append(f"{plane} {min(values):.1f} to {max(values):.1f} dB, largest difference "
                         f"{largest:.1e}, of a graph {graphs:.1e}")
        return "; ".join(words)

    each(only or list(chains), compare)


def noise(size: tuple[int, int], number: int) -> dict[Role, np.ndarray]:
    """Random planes (height, width, channels) of sensible ranges."""
    random = np.random.default_rng(number)
    planes = {role: random.random((size[1], size[0], postfx.ROLES[role].channels), np.float32)
              for role in ROLES}
    planes[Role.DEPTH] += 1
    return planes


def memory_of(model: str, size: tuple[int, int], device_name: str) -> None:
    """Print what a process takes of the GPU for frames of a size."""
    device = Device(device_name)
    free = device.gpu.free_bytes if device.gpu else lambda: 0
    before = free()
    pipeline = Pipeline([postfx.DenoiseUpscale(model=model, scale=1)], device, exposure=0.0,
                        cuts="none")
    least, times = before, []
    for number in range(FRAMES_OF_MEMORY):
        pipeline(Frame(noise(size, number), number=number + 1))
        times.append(sum(pipeline.timings.values()))
        least = min(least, free())
    pixels = size[0] * size[1]
    print(f"{(before - least) / 1e6:.0f} MB, {(before - least) / pixels:.0f} bytes a pixel, frames "
          f"of {', '.join(f'{one:.2f}' for one in times)} ms")


def memory(models: list[str], sizes: list[str], device_name: str) -> None:
    def one(name: str) -> str:
        model, size = name.split(" ")
        command = [sys.executable, "-m", "training.measure.gpu", "memory of one", "--models", model,
                   "--sizes", size, "--device", device_name]
        done = subprocess.run(command, capture_output=True, text=True, timeout=120)
        return done.stdout.strip() or f"failed: {done.stderr.strip()[-400:]}"

    each([f"{model} {size}" for model in models for size in sizes], one)


def middle(times: list[float]) -> str:
    """Median, least and most."""
    return f"{statistics.median(times):.3f} ms ({min(times):.3f} to {max(times):.3f})"


def host_times(work: Callable[[], object], runs: int) -> list[float]:
    """Milliseconds of calls by the host's clock."""
    found = []
    for _ in range(runs):
        began = time.perf_counter()
        work()
        found.append(1e3 * (time.perf_counter() - began))
    return found


def on_card(size: tuple[int, int], model: str, scale: float,
            device: Device) -> tuple[Pipeline, Iterator[dict[Role | str, Any]]]:
    """A pipeline, and planes of PyTorch to give it in turn."""
    import torch

    pipeline = Pipeline([postfx.DenoiseUpscale(model=model, scale=scale), postfx.ToneMap()], device)
    where = "cuda" if device.gpu else "cpu"
    both: list[dict[Role | str, Any]] = [
        {role: torch.from_numpy(plane).to(where) for role, plane in noise(size, number).items()}
            for number in (1, 2)]

    def in_turn() -> Iterator[dict[Role | str, Any]]:
        while True:
            yield from both

    return pipeline, in_turn()


def calls(models: list[str], scale: float, sizes: list[str], runs: int, device_name: str) -> None:
    def one(name: str) -> str:
        model, size = name.split(" ")
        pipeline, planes = on_card(parse_size(size), model, scale, Device(device_name))
        device_times: list[float] = []

        def call() -> None:
            pipeline.on_device(next(planes), exposure=0.0)
            device_times.append(sum(pipeline.timings.values()))

        host_times(call, 8)
        device_times.clear()
        whole = host_times(call, runs)
        return f"device {middle(device_times)}, call {middle(whole)}"

    each([f"{model} {size}" for model in models for size in sizes], one)


class Interface:
    """A tensor of ours as an array of a library that knows CUDA's interface alone."""

    def __init__(self, tensor: Any) -> None:
        self.__cuda_array_interface__ = tensor.__cuda_array_interface__


class Capsule:
    """A tensor of ours as an array of a library that knows DLPack alone."""

    def __init__(self, tensor: Any) -> None:
        self._tensor = tensor

    def __dlpack__(self, **given: Any) -> Any:
        return self._tensor.__dlpack__(**given)

    def __dlpack_device__(self) -> Any:
        return self._tensor.__dlpack_device__()


def sharing(device_name: str) -> None:
    import torch

    device = Device(device_name)
    planes = noise((960, 540), 1)
    ours = [device.heap.tensor(str(role), plane.shape) for role, plane in planes.items()]
    for tensor, plane in zip(ours, planes.values(), strict=True):
        tensor.upload(plane)
    result = device.heap.tensor("result", (1080, 1920, 3))
    result.fill(0.5)
    theirs = [torch.from_numpy(plane).to("cuda" if device.gpu else "cpu")
              for plane in planes.values()]

    def by(kind: type) -> list[float]:
        lent = [kind(tensor) for tensor in ours]
        back = kind(result)

        def work() -> None:
            for one in lent:
                device.wrap("plane", one)
            device.wrap("result", back)

        return host_times(work, 200)

    def torch_planes() -> None:
        for one in theirs:
            device.wrap("plane", one)
        torch.from_dlpack(result)

    def torch_dlpack() -> None:
        for one in theirs:
            device.wrap("plane", Capsule(one))
        torch.from_dlpack(result)

    ways = {"DLPack": lambda: by(Capsule), "CUDA's interface": lambda: by(Interface),
            "PyTorch, read directly": lambda: host_times(torch_planes, 200),
            "PyTorch by its DLPack": lambda: host_times(torch_dlpack, 200)}
    each(list(ways), lambda name: middle(ways[name]()))


def between(size: tuple[int, int], runs: int, device_name: str) -> None:
    device = Device(device_name)
    stream = DeviceInterpolator(device)
    held = []
    for frame in room(size):
        planes: dict[Role | str, Any] = {}
        for role in (Role.COLOUR, Role.DEPTH, Role.MOTION):
            planes[role] = device.heap.tensor(f"{role} {frame.number}", frame[role].shape)
            planes[role].upload(np.ascontiguousarray(frame[role], np.float32))
        held.append(planes)
    found: dict[str, list[float]] = {}
    for run in range(runs + 4):
        parts = {}
        began = time.perf_counter()
        stream.push(held[run % len(held)], reset=run % len(held) == 0)
        parts["push"] = stream.milliseconds["push"]
        if not stream.ready:
            continue
        stream.frame(0.4)
        parts["both, call"] = 1e3 * (time.perf_counter() - began)
        parts["first frame"] = stream.milliseconds["frame"]
        stream.frame(0.6, 0.4)
        parts["further frame"] = stream.milliseconds["frame"]
        parts["push and first frame"] = parts["push"] + parts["first frame"]
        if run >= 4:
            for name, taken in parts.items():
                found.setdefault(name, []).append(taken)
    each(list(found), lambda name: middle(found[name]))


def gpu_times(work: Callable[[], object], runs: int) -> list[float]:
    """Milliseconds between events of PyTorch around calls."""
    import torch

    for _ in range(3):
        work()
    found = []
    for _ in range(runs):
        begin, end = (torch.cuda.Event(enable_timing=True) for _ in range(2))
        begin.record()
        work()
        end.record()
        torch.cuda.synchronize()
        found.append(begin.elapsed_time(end))
    return found


def card() -> None:
    import torch

    def copies() -> str:
        source = torch.rand(1 << 30, device="cuda")
        target = torch.empty_like(source)
        taken = statistics.median(gpu_times(lambda: target.copy_(source), 20))
        return f"{2 * source.numel() * 4 / taken / 1e9:.2f} TB/s, read and written"

    def products() -> str:
        one, other = (torch.randn(8192, 8192, device="cuda", dtype=torch.float16)
                      for _ in range(2))
        taken = statistics.median(gpu_times(lambda: one @ other, 20))
        return f"{2 * 8192**3 / taken / 1e9:.0f} TFLOP/s"

    def empty() -> str:
        many, value = 1000, torch.zeros(1, device="cuda")
        value.add_(1)
        torch.cuda.synchronize()
        graph = torch.cuda.CUDAGraph()
        with torch.cuda.graph(graph):
            for _ in range(many):
                value.add_(1)
        return f"{1e3 * statistics.median(gpu_times(graph.replay, 20)) / many:.2f} us"

    ways = {"copies": copies, "products in half precision": products,
            "a kernel of one number": empty}
    each(list(ways), lambda name: ways[name]())


def kernels(models: list[str], scale: float, sizes: list[str], device_name: str) -> None:
    import torch
    from torch.profiler import ProfilerActivity, profile

    torch.zeros(1).cuda()
    for name in [f"{model} {size}" for model in models for size in sizes]:
        model, size = name.split(" ")
        pipeline, planes = on_card(parse_size(size), model, scale, Device(device_name))
        for _ in range(8):
            pipeline.on_device(next(planes), exposure=0.0)
        runs = 10
        with profile(activities=[ProfilerActivity.CUDA]) as profiled:
            for _ in range(runs):
                pipeline.on_device(next(planes), exposure=0.0)
            torch.cuda.synchronize()
        rows = [(event.self_device_time_total / runs, event.count / runs, event.key)
                for event in profiled.key_averages() if event.self_device_time_total]
        rows.sort(reverse=True)
        print(f"{name} at {scale:g}x: {sum(row[0] for row in rows):.0f} us in "
              f"{sum(row[1] for row in rows):.0f} launches")
        for taken, launches, key in rows[:30]:
            print(f"    {taken:8.1f} us {launches:5.1f} launches  {key[:100]}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what")
    parser.add_argument("--size", default="640x360")
    parser.add_argument("--sizes", default="960x540,1920x1080")
    parser.add_argument("--frames", type=int, default=6)
    parser.add_argument("--runs", type=int, default=40)
    parser.add_argument("--models", default="xl")
    parser.add_argument("--scale", type=float, default=1)
    parser.add_argument("--only", default="", help="names of chains, with ';' between them")
    parser.add_argument("--device", default="cuda")
    given = parser.parse_args()
    models, sizes = given.models.split(","), given.sizes.split(",")
    only = [name for name in given.only.split(";") if name]
    ways: dict[str, Callable[[], None]] = {
        "same": lambda: same(parse_size(given.size), given.frames, only, given.device),
        "memory": lambda: memory(models, sizes, given.device),
        "memory of one": lambda: memory_of(models[0], parse_size(sizes[0]), given.device),
        "calls": lambda: calls(models, given.scale, sizes, given.runs, given.device),
        "sharing": lambda: sharing(given.device),
        "between": lambda: between(parse_size(given.size), given.runs, given.device),
        "card": card,
        "kernels": lambda: kernels(models, given.scale, sizes, given.device),
    }
    if given.what not in ways:
        parser.error(f"no measurement '{given.what}': {', '.join(ways)}")
    ways[given.what]()


if __name__ == "__main__":
    main()
