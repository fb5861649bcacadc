"""A network inside of a kernel: features, network and shading of a pixel in one dispatch, against
three.

python samples/mlp_in_kernel.py [--width 960] [--runs 9] [--device cuda]

Both ways shade the same picture by a network of 5-32-32-3, which learnt the light of a ball. Prints
the largest difference and the median times of runs in turn.
"""
import argparse
import statistics
import time
from pathlib import Path

import numpy as np

from postfx import Device
from postfx.compiled.library import Rows
from postfx.kernels import Kernel
from postfx.neural import Learner, Network
from postfx.runtime import ArgumentTable

NETWORK = Network(5, (32, 32), 3, "gelu")
HEADER = Path(__file__).with_suffix(".h")
IMAGE = ("height", "width", 3)
ONE = Kernel("shade_by_network", ("parameters", "normal", "albedo"), ("shaded",),
             Rows("shade_by_network", HEADER), ("shaded", 0),
             {"parameters": (NETWORK.count,), "normal": IMAGE, "albedo": IMAGE, "shaded": IMAGE})
FEATURES = Kernel("features_of_pixels", ("normal",), ("points",),
                  Rows("features_of_pixels", HEADER), ("points", 0),
                  {"normal": IMAGE, "points": ("height", "width", 5)})
SHADE = Kernel("shade_by_values", ("albedo", "values"), ("shaded",),
               Rows("shade_by_values", HEADER), ("shaded", 0),
               {"albedo": IMAGE, "values": IMAGE, "shaded": IMAGE})


def ball(height, width):
    """Normals (H, W, 3) of a ball before a wall, and albedo."""
    y, x = np.mgrid[:height, :width].astype(np.float32)
    x, y = (2 * x + 1 - width) / height, (2 * y + 1 - height) / height
    inside = np.maximum(0.64 - x * x - y * y, 0)
    on_ball = np.stack([x, -y, np.sqrt(inside)], -1) / 0.8
    normal = np.where(inside[..., None] > 0, on_ball, np.float32([0, 0, 1])).astype(np.float32)
    albedo = np.where(inside[..., None] > 0, np.float32([0.8, 0.5, 0.3]),
                      np.float32(0.6)).astype(np.float32)
    return normal, albedo


def main():
    parser = argparse.ArgumentParser(description=__doc__.partition("\n\n")[0])
    parser.add_argument("--width", type=int, default=960)
    parser.add_argument("--runs", type=int, default=9)
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--threads", type=int, default=1)
    chosen = parser.parse_args()
    device = (Device("cpu", threads=chosen.threads) if chosen.device == "cpu"
              else Device(chosen.device))
    size = height, width = chosen.width * 9 // 16, chosen.width
    normal, albedo = ball(height, width)
    tensor = device.heap.tensor
    learner = Learner(device, NETWORK)
    points = tensor("points", (*size, 5))
    seen = np.concatenate([normal, *np.broadcast_arrays(
        (2 * np.arange(width, dtype=np.float32)[None, :, None] + 1) / width - 1,
        (2 * np.arange(height, dtype=np.float32)[:, None, None] + 1) / height - 1)],
                          -1).reshape(-1, 5)
    light = (np.maximum(
        seen[:, :3] @ np.float32([[0.5, 0.4, 0.1], [0.6, 0.5, 0.5], [0.4, 0.4, 0.6]]), 0
    ) + 0.1)
    learner.fit(seen, light.astype(np.float32), 200, 1e-2, 1024)
    planes = {name: tensor(name, (*size, 3))
              for name in ("normal", "albedo", "values", "one", "three")}
    planes["normal"].upload(normal)
    planes["albedo"].upload(albedo)
    states = {kernel: device.compute_state(kernel) for kernel in (ONE, FEATURES, SHADE)}
    one = ArgumentTable(states[ONE], {"parameters": learner.parameters, "shaded": planes["one"],
                                      "normal": planes["normal"], "albedo": planes["albedo"]})
    features = ArgumentTable(states[FEATURES], {"normal": planes["normal"], "points": points})
    shade = ArgumentTable(states[SHADE], {"albedo": planes["albedo"], "values": planes["values"],
                                          "shaded": planes["three"]})
    flat = (points.view("rows", (height * width, 5)),
            planes["values"].view("rows of values", (height * width, 3)))

    def in_one(encoder):
        encoder.dispatch(states[ONE], one)

    def in_three(encoder):
        encoder.dispatch(states[FEATURES], features)
        encoder.barrier()
        learner.run(encoder, *flat)
        encoder.barrier()
        encoder.dispatch(states[SHADE], shade)

    times = {"one dispatch": [], "three": []}
    for _ in range(chosen.runs + 1):
        for name, record in zip(times, (in_one, in_three), strict=True):
            commands = device.command_buffer(name)
            with commands.compute_encoder("shade") as encoder:
                record(encoder)
            began = time.perf_counter(), time.process_time()
            commands.commit()
            commands.wait()
            now = time.perf_counter(), time.process_time()
            times[name].append(now[chosen.device == "cpu"] - began[chosen.device == "cpu"])
    found = [planes[name].download() for name in ("one", "three")]
    print(f"largest difference {np.abs(found[0] - found[1]).max():.1e} of {found[1].max():.2f}")
    one_time, three_time = (1e3 * statistics.median(taken[1:]) for taken in times.values())
    print(f"{width}x{height}: one dispatch {one_time:.2f} ms, three {three_time:.2f} ms, "
          f"ratio {one_time / three_time:.2f}")


if __name__ == "__main__":
    main()
