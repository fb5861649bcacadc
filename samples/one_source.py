"""The 5x5 filter of the denoiser as one Python function for CPU and GPU, beside its two hand-written forms.

python samples/one_source.py [--width 960] [--height 544] [--runs 25] [--device cpu|cuda]

The one source is a function of a pixel that Numba compiles for both processors (for CUDA with the package numba-cuda).
The shipped forms are rows for the CPU and CUDA C++ for the GPU. Prints the largest difference of their results and the
median time of each, runs in turn.
"""
import argparse
import statistics
import time
from collections.abc import Callable

import numba
import numpy as np

from postfx import Device
from postfx.kernels.denoise import KERNEL, TINY
from postfx.kernels.denoise.pyramid import FILTER
from postfx.runtime import ArgumentTable

SIDE, REACH = 5, 2
Form = Callable[[], np.ndarray]
"""Runs the kernel a number of times and returns its result on the host."""


def filter_pixel(x: int, y: int, mixed: np.ndarray, weights: np.ndarray, filtered: np.ndarray) -> None:
    """The normalised 5x5 kernel of a pixel; taps beyond the picture do not count."""
    height, width = mixed.shape[1:]
    total = TINY
    red = green = blue = np.float32(0)
    for j in range(SIDE):
        v = y + j - REACH
        if v < 0 or v >= height:
            continue
        for i in range(SIDE):
            u = x + i - REACH
            if u < 0 or u >= width:
                continue
            weight = weights[SIDE * j + i, y, x]
            total += weight
            red += weight * mixed[0, v, u]
            green += weight * mixed[1, v, u]
            blue += weight * mixed[2, v, u]
    filtered[0, y, x], filtered[1, y, x], filtered[2, y, x] = red / total, green / total, blue / total


def shipped(device: Device, planes: dict[str, np.ndarray], launches: int) -> Form:
    """The form that ships for this device."""
    state = device.compute_state(FILTER)
    tensors = {name: device.wrap(name, plane) for name, plane in planes.items()}
    tensors["filtered"] = device.wrap("filtered", np.empty_like(planes["mixed"]))
    table = ArgumentTable(state, tensors)

    def run() -> np.ndarray:
        commands = device.command_buffer("filter", captured=False)
        with commands.compute_encoder("filter") as encoder:
            for _ in range(launches):
                encoder.dispatch(state, table)
                encoder.barrier()
        commands.commit()
        commands.wait()
        return tensors["filtered"].download()

    return run


def on_cpu(planes: dict[str, np.ndarray], launches: int) -> Form:
    """The one source on a thread of the CPU."""
    pixel = numba.njit(error_model="numpy")(filter_pixel)
    filtered = np.empty_like(planes["mixed"])

    @numba.njit(error_model="numpy")
    def pixels(mixed: np.ndarray, weights: np.ndarray, filtered: np.ndarray) -> None:
        for y in range(mixed.shape[1]):
            for x in range(mixed.shape[2]):
                pixel(x, y, mixed, weights, filtered)

    def run() -> np.ndarray:
        for _ in range(launches):
            pixels(planes["mixed"], planes["heads"][0], filtered)
        return filtered

    return run


def on_gpu(planes: dict[str, np.ndarray], launches: int) -> Form:
    """The one source on the GPU."""
    from numba import cuda

    pixel = cuda.jit(device=True)(filter_pixel)

    @cuda.jit
    def pixels(mixed: np.ndarray, weights: np.ndarray, filtered: np.ndarray) -> None:
        x, y = cuda.grid(2)
        if x < mixed.shape[2] and y < mixed.shape[1]:
            pixel(x, y, mixed, weights, filtered)

    mixed, weights = cuda.to_device(planes["mixed"]), cuda.to_device(planes["heads"][0])
    filtered = cuda.device_array_like(planes["mixed"])
    block = 32, 8
    grid = tuple(-(-size // side) for size, side in zip(planes["mixed"].shape[:0:-1], block, strict=True))

    def run() -> np.ndarray:
        for _ in range(launches):
            pixels[grid, block](mixed, weights, filtered)
        return filtered.copy_to_host()

    return run


def measure(forms: dict[str, Form], runs: int) -> dict[str, float]:
    """Median milliseconds of each form, runs in turn."""
    times: dict[str, list[float]] = {name: [] for name in forms}
    for _ in range(runs + 2):
        for name, form in forms.items():
            began = time.perf_counter()
            form()
            times[name].append(1e3 * (time.perf_counter() - began))
    return {name: statistics.median(some[2:]) for name, some in times.items()}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--width", type=int, default=960)
    parser.add_argument("--height", type=int, default=544)
    parser.add_argument("--runs", type=int, default=25)
    parser.add_argument("--launches", type=int, nargs=2, default=(1, 101), metavar=("FEW", "MANY"),
                        help="times are those of MANY launches less those of FEW, by launch (default: %(default)s)")
    parser.add_argument("--device", choices=("cpu", "cuda"), default="cpu")
    args = parser.parse_args()
    random, (few, many) = np.random.default_rng(0), args.launches
    planes = {"mixed": random.random((3, args.height, args.width), np.float32),
              "heads": random.random((1, KERNEL + 1, args.height, args.width), np.float32),
              "area": np.float32([args.height, args.width])}
    device, one_source = Device(args.device, threads=1), on_cpu if args.device == "cpu" else on_gpu
    forms = {f"{name}, {launches}": make(launches) for launches in (few, many) for name, make in (
        ("one source", lambda n: one_source(planes, n)), ("shipped", lambda n: shipped(device, planes, n)))}
    print("largest difference", np.abs(forms[f"one source, {few}"]() - forms[f"shipped, {few}"]()).max())
    times = measure(forms, args.runs)
    for name in ("one source", "shipped"):
        print(f"{name:>12} {(times[f'{name}, {many}'] - times[f'{name}, {few}']) / (many - few):9.4f} ms")


if __name__ == "__main__":
    main()
