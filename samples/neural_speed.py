"""Time of small networks beside torch, eager and compiled, on the same threads: a run, and a step that learns.

python samples/neural_speed.py [--widths 16 32 64] [--threads 1 2] [--points 65536] [--runs 9] [--eager]

The network has 3 inputs with 4 bands of Fourier features, 3 hidden layers of ReLU and 3 outputs. A step is the mean
squared error, its gradient, and Adam (fused in torch). Runs are in turn; prints medians of
milliseconds and how many times longer torch takes. `--eager` leaves compiled torch out. Needs torch.
"""
import argparse
import statistics
import time
from collections.abc import Callable

import numpy as np
import torch

from postfx import Device
from postfx.neural import Learner, Network

Form = Callable[[], object]
BANDS = 4


class Module(torch.nn.Module):
    """The network in torch."""

    def __init__(self, network: Network, parameters: np.ndarray) -> None:
        super().__init__()
        self.layers = torch.nn.ModuleList()
        for weights, biases in network.layers(parameters.copy()):
            layer = torch.nn.Linear(weights.shape[1], weights.shape[0])
            layer.weight.data, layer.bias.data = torch.from_numpy(weights), torch.from_numpy(biases)
            self.layers.append(layer)
        self.register_buffer("factors", 2.0 ** torch.arange(BANDS) * np.pi)

    def forward(self, points: torch.Tensor) -> torch.Tensor:
        angles = points[:, None] * self.factors[:, None]
        row = torch.cat([points, torch.stack([angles.sin(), angles.cos()], -1).flatten(1)], 1)
        for layer in self.layers[:-1]:
            row = torch.relu(layer(row))
        return self.layers[-1](row)


def ours(network: Network, threads: int, points: np.ndarray, targets: np.ndarray) -> tuple[Form, Form]:
    """A run and a step, each a command buffer."""
    device = Device("cpu", threads=threads)
    learner = Learner(device, network, 1e-3)
    places, wanted = device.wrap("points", points), device.wrap("targets", targets)
    values = device.heap.tensor("values", targets.shape)

    def commit(learns: bool) -> np.ndarray:
        commands = device.command_buffer("network", captured=False)
        with commands.compute_encoder("network") as encoder:
            if learns:
                learner.learn(encoder, places, wanted)
            else:
                learner.run(encoder, places, values)
        commands.commit()
        commands.wait()
        return values.array

    return lambda: commit(False), lambda: commit(True)


def by_torch(network: Network, points: np.ndarray, targets: np.ndarray, compiled: bool) -> tuple[Form, Form]:
    """A run and a step."""
    module = Module(network, network.initial())
    adam = torch.optim.Adam(module.parameters(), 1e-3, fused=True)
    call = torch.compile(module) if compiled else module
    places, wanted = torch.from_numpy(points), torch.from_numpy(targets)

    def run() -> np.ndarray:
        with torch.no_grad():
            return call(places).numpy()

    def step() -> None:
        adam.zero_grad()
        torch.nn.functional.mse_loss(call(places), wanted).backward()
        adam.step()

    return run, step


def milliseconds(form: Form) -> float:
    begin = time.perf_counter()
    form()
    return 1000 * (time.perf_counter() - begin)


parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
parser.add_argument("--widths", type=int, nargs="+", default=[16, 32, 64])
parser.add_argument("--threads", type=int, nargs="+", default=[1, 2])
parser.add_argument("--points", type=int, default=65536)
parser.add_argument("--runs", type=int, default=9)
parser.add_argument("--eager", action="store_true")
chosen = parser.parse_args()

random = np.random.default_rng(0)
points = random.uniform(-1, 1, (chosen.points, 3)).astype(np.float32)
targets = random.normal(size=(chosen.points, 3)).astype(np.float32)
print(f"{'threads':>7} {'width':>5} {'what':<5} {'ours ms':>8} {'eager ms':>9} {'compiled ms':>11}  torch is slower")
for threads in chosen.threads:
    torch.set_num_threads(threads)
    for width in chosen.widths:
        network = Network(3, (width,) * 3, 3, bands=BANDS)
        makers = [by_torch(network, points, targets, compiled) for compiled in (False, True)[:1 if chosen.eager else 2]]
        makers.insert(0, ours(network, threads, points, targets))
        for what, forms in zip(("run", "learn"), zip(*makers, strict=True), strict=True):
            results = [form() for form in forms]  # compiles
            if what == "run" and max(np.abs(results[0] - result).max() for result in results) > 1e-4:
                raise SystemExit("the forms do not agree")
            times = [[milliseconds(form) for form in forms] for _ in range(chosen.runs)]
            own, *others = (statistics.median(column) for column in zip(*times, strict=True))
            ratios = " and ".join(f"{other / own:.1f}x" for other in others)
            shown = " ".join(f"{other:>{size}.1f}" for other, size in zip(others, (9, 11), strict=False))
            print(f"{threads:>7} {width:>5} {what:<5} {own:>8.1f} {shown}  {ratios}", flush=True)
