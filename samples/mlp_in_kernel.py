"""A network inside of a kernel: features, network and shading of a pixel in one dispatch, against three.

python samples/mlp_in_kernel.py [--width 960] [--runs 9] [--device cuda]

Both ways shade the same picture by a network of 5-32-32-3, which learnt the light of a ball. Prints the largest
difference and the median times of runs in turn.
"""
import argparse
import statistics
import time

import numpy as np

from postfx import Device
from postfx.kernels import Kernel
from postfx.kernels.mlp import STRIP, mlp, mlp_features, mlp_space
from postfx.kernels.numeric import compiled
from postfx.neural import Learner, Network
from postfx.runtime import ArgumentTable

NETWORK = Network(5, (32, 32), 3, "gelu")


@compiled
def shade_rows(y0, y1, network, parameters, normal, albedo, shaded):
    height, width = shaded.shape[:2]
    space = mlp_space(network)
    features = mlp_features(space)
    for y in range(y0, y1):
        for first in range(0, width, STRIP):
            count = min(STRIP, width - first)
            for p in range(count):
                for c in range(3):
                    features[c, p] = normal[y, first + p, c]
                features[3, p] = np.float32((2 * (first + p) + 1) / width - 1)
                features[4, p] = np.float32((2 * y + 1) / height - 1)
            light = mlp(network, parameters, space)
            for p in range(count):
                for c in range(3):
                    shaded[y, first + p, c] = albedo[y, first + p, c] * max(light[c, p], np.float32(0))


@compiled
def feature_rows(y0, y1, normal, points):
    height, width = normal.shape[:2]
    for y in range(y0, y1):
        for x in range(width):
            for c in range(3):
                points[y, x, c] = normal[y, x, c]
            points[y, x, 3] = np.float32((2 * x + 1) / width - 1)
            points[y, x, 4] = np.float32((2 * y + 1) / height - 1)


@compiled
def value_rows(y0, y1, albedo, values, shaded):
    for y in range(y0, y1):
        for x in range(shaded.shape[1]):
            for c in range(3):
                shaded[y, x, c] = albedo[y, x, c] * max(values[y, x, c], np.float32(0))


IMAGE = ("height", "width", 3)
FACTS, COUNT = NETWORK.facts().shape, (NETWORK.count,)
ONE = Kernel("shade_by_network", ("network", "parameters", "normal", "albedo"), ("shaded",), shade_rows, ("shaded", 0),
             {"network": FACTS, "parameters": COUNT, "normal": IMAGE, "albedo": IMAGE, "shaded": IMAGE})
FEATURES = Kernel("features_of_pixels", ("normal",), ("points",), feature_rows, ("points", 0),
                  {"normal": IMAGE, "points": ("height", "width", 5)})
SHADE = Kernel("shade_by_values", ("albedo", "values"), ("shaded",), value_rows, ("shaded", 0),
               {"albedo": IMAGE, "values": IMAGE, "shaded": IMAGE})


def ball(height, width):
    """Normals (H, W, 3) of a ball before a wall, and albedo."""
    y, x = np.mgrid[:height, :width].astype(np.float32)
    x, y = (2 * x + 1 - width) / height, (2 * y + 1 - height) / height
    inside = np.maximum(0.64 - x * x - y * y, 0)
    on_ball = np.stack([x, -y, np.sqrt(inside)], -1) / 0.8
    normal = np.where(inside[..., None] > 0, on_ball, np.float32([0, 0, 1])).astype(np.float32)
    albedo = np.where(inside[..., None] > 0, np.float32([0.8, 0.5, 0.3]), np.float32(0.6)).astype(np.float32)
    return normal, albedo


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--width", type=int, default=960)
    parser.add_argument("--runs", type=int, default=9)
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--threads", type=int, default=1)
    chosen = parser.parse_args()
    device = Device("cpu", threads=chosen.threads) if chosen.device == "cpu" else Device(chosen.device)
    size = height, width = chosen.width * 9 // 16, chosen.width
    normal, albedo = ball(height, width)
    tensor = device.heap.tensor
    learner = Learner(device, NETWORK)
    points = tensor("points", (*size, 5))
    seen = np.concatenate([normal, *np.broadcast_arrays(
        (2 * np.arange(width, dtype=np.float32)[None, :, None] + 1) / width - 1,
        (2 * np.arange(height, dtype=np.float32)[:, None, None] + 1) / height - 1)], -1).reshape(-1, 5)
    light = np.maximum(seen[:, :3] @ np.float32([[0.5, 0.4, 0.1], [0.6, 0.5, 0.5], [0.4, 0.4, 0.6]]), 0) + 0.1
    learner.fit(seen, light.astype(np.float32), 200, 1e-2, 1024)
    planes = {name: tensor(name, (*size, 3)) for name in ("normal", "albedo", "values", "one", "three")}
    planes["normal"].upload(normal)
    planes["albedo"].upload(albedo)
    network = tensor("network", FACTS)
    network.upload(NETWORK.facts())
    states = {kernel: device.compute_state(kernel) for kernel in (ONE, FEATURES, SHADE)}
    one = ArgumentTable(states[ONE], {"network": network, "parameters": learner.parameters, "shaded": planes["one"],
                                      "normal": planes["normal"], "albedo": planes["albedo"]})
    features = ArgumentTable(states[FEATURES], {"normal": planes["normal"], "points": points})
    shade = ArgumentTable(states[SHADE], {"albedo": planes["albedo"], "values": planes["values"],
                                          "shaded": planes["three"]})
    flat = points.view("rows", (height * width, 5)), planes["values"].view("rows of values", (height * width, 3))

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
