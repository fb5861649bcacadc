"""Irradiance under a sky by three techniques: Monte Carlo, a network that learns while frames run,
and an offline one.

python samples/irradiance_network.py [PICTURE] [--samples 1 4 16 64] [--frames 1 4 16 64 256] \\
    [--runs 5]

The networks are 3-16-16-3, from a normal to the logarithm of irradiance. Online, a step learns from
512 samples of Monte Carlo (32 normals of 16), 4 steps a frame, in the command buffer that runs it.
Offline, it has learnt from 256 samples a normal before, and runs as an ONNX model by the
machine-learning encoder. Pixels without a surface are left out. Prints the time of a frame (median
of runs) and relMSE against 65536 samples, and draws the frame by each technique. Needs matplotlib
and onnx.
"""
import argparse
import statistics
import tempfile
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from sky import IRRADIANCE, rel_mse, scene, shown, sky_of, sun_at

from postfx import Device, Library
from postfx.neural import Learner, Network
from postfx.runtime import ArgumentTable, CommandBuffer, Tensor

NORMALS, EACH, STEPS = 32, 16, 4

parser = argparse.ArgumentParser(description=__doc__.partition("\n\n")[0])
parser.add_argument("picture", nargs="?", type=Path,
                    default=Path(tempfile.gettempdir()) / "irradiance_network.png")
parser.add_argument("--samples", type=int, nargs="+", default=[1, 4, 16, 64])
parser.add_argument("--frames", type=int, nargs="+", default=[1, 4, 16, 64, 256],
                    help="after which it is measured")
parser.add_argument("--offline", type=int, default=1000, help="steps of the offline network")
parser.add_argument("--reference", type=int, default=65536, help="samples a pixel")
parser.add_argument("--checked", type=int, default=500,
                    help="pixels that are compared with the reference")
parser.add_argument("--width", type=int, default=480)
parser.add_argument("--runs", type=int, default=5)
parser.add_argument("--threads", type=int, default=2)
chosen = parser.parse_args()

device, random = Device("cpu", threads=chosen.threads), np.random.default_rng(0)
network = Network(3, (16, 16), 3, "gelu")
normals, albedo = scene(chosen.width, chosen.width * 9 // 16)[1:]
covered = normals.any(-1)
surfaces = np.ascontiguousarray(normals[covered])
sky = sky_of(sun_at(25, 40))
sky_tensor, points = device.wrap("sky", sky), device.wrap("normals", surfaces)
state = device.compute_state(IRRADIANCE)


def sampled(where: np.ndarray, samples: int, seed: int) -> np.ndarray:
    """log(irradiance) of normals, at once."""
    logs = np.empty_like(where)
    IRRADIANCE.rows(0, len(where), sky, where, np.float32([samples, seed]), logs)
    return logs


def monte_carlo(where: Tensor, samples: int, seed: int, logs: Tensor) -> ArgumentTable:
    params = device.wrap("params", np.float32([samples, seed]))
    return ArgumentTable(state,
                         {"sky": sky_tensor, "normals": where, "params": params, "logs": logs})


def committed(commands: CommandBuffer) -> float:
    """Milliseconds that the commands took."""
    commands.commit()
    commands.wait()
    return sum(taken for _, taken in commands.timings)


checked = random.choice(len(surfaces), min(chosen.checked, len(surfaces)), replace=False)
wanted = np.exp(sampled(surfaces[checked], chosen.reference, 12345).astype(np.float64))
pictures = {}


def tell(name: str, times: list[float], logs: np.ndarray) -> None:
    """One row, and the frame lit so."""
    light = np.exp(logs.astype(np.float64))
    print(f"{name:<24} {statistics.median(times):>8.2f} {rel_mse(light[checked], wanted):>10.2e}",
          flush=True)
    picture = np.full(normals.shape, np.nan)
    picture[covered] = shown(albedo[covered] / np.pi * light)
    pictures[name] = picture


print(f"{len(surfaces)} of {covered.size} pixels have a surface; {network.count} parameters")
print(f"{'technique':<24} {'ms':>8} {'relMSE':>10}")
for samples in chosen.samples:
    logs, times = device.heap.tensor("logs", surfaces.shape), []
    for run in range(chosen.runs):
        commands = device.command_buffer("Monte Carlo")
        with commands.compute_encoder("Monte Carlo") as encoder:
            encoder.dispatch(state, monte_carlo(points, samples, run, logs))
        times.append(committed(commands))
    tell(f"Monte Carlo, {samples} samples", times, logs.array)

online = Learner(device, network, 1e-2, seed=1)
values, times = device.heap.tensor("values", surfaces.shape), []
for frame in range(1, max(chosen.frames) + 1):
    commands = device.command_buffer("online")
    batches = [(device.wrap("where", surfaces[random.integers(len(surfaces), size=NORMALS)]),
                device.heap.tensor("targets", (NORMALS, 3))) for _ in range(STEPS)]
    with commands.compute_encoder("Monte Carlo") as encoder:
        for step, (where, targets) in enumerate(batches):
            encoder.dispatch(state, monte_carlo(where, EACH, frame * STEPS + step, targets))
    with commands.compute_encoder("network") as encoder:
        encoder.barrier(after="compute", before="compute")
        for where, targets in batches:
            online.learn(encoder, where, targets)
        online.run(encoder, points, values)
    times.append(committed(commands))
    if frame in chosen.frames:
        tell(f"online, frame {frame}", times[-chosen.runs:], values.array)

offline = Learner(device, network, 1e-2, seed=1)
for step in range(chosen.offline):
    offline.set_rate(1e-2 * 0.01 ** (step / chosen.offline))
    where = surfaces[random.integers(len(surfaces), size=64)]
    commands = device.command_buffer("offline")
    with commands.compute_encoder("learn") as encoder:
        offline.learn(encoder, device.wrap("where", where),
                      device.wrap("targets", sampled(where, 256, step)))
    committed(commands)
with tempfile.TemporaryDirectory() as folder:
    network.save_onnx(Path(folder) / "irradiance.onnx", offline.parameters.download())
    twin = device.pipeline_state(Library(folder), "irradiance", {"points": len(surfaces)})
times = []
for _ in range(chosen.runs):
    commands = device.command_buffer("offline")
    with commands.machine_learning_encoder("network") as encoder:
        encoder.dispatch_network(twin, ArgumentTable(twin, {"points": points, "values": values}))
    times.append(committed(commands))
tell("offline, ONNX", times, values.array)

figure = Figure((12, 5), layout="constrained")
panels = figure.subplots(2, 2).ravel()
shown_names = [f"Monte Carlo, {chosen.samples[0]} samples", *(f"online, frame {frame}" for frame in
               (min(chosen.frames), max(chosen.frames))), "offline, ONNX"]
for panel, name in zip(panels, shown_names, strict=True):
    panel.imshow(pictures[name])
    panel.set_title(name)
    panel.axis("off")
figure.savefig(chosen.picture, dpi=80)
print(f"wrote {chosen.picture}")
