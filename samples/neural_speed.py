"""Time of small networks beside torch, eager and compiled, on the same threads or GPU: a run, and a
step that learns.

python samples/neural_speed.py [--widths 16 32 64] [--threads 1 2] [--points 65536] [--runs 9] \\
    [--eager]
python samples/neural_speed.py --device cuda [--tf32] [--graph]

The network has 3 inputs with 4 bands of Fourier features, 3 hidden layers of ReLU and 3 outputs. A
step is the mean squared error, its gradient, and Adam (fused in torch). Runs are in turn; prints
medians of milliseconds and how many times longer torch takes. `--eager` leaves compiled torch out.
On a GPU times are of `--repeats` runs or steps between two waits, by the host's clock, and by the
card's from the first of them to the end of the last (rows `by card`); `--tf32` lets torch round
factors to 11 bits, `--graph` has compiled torch use CUDA graphs. Needs torch.
"""
import argparse
import time
from collections.abc import Callable

import numpy as np
import torch

from postfx import Device
from postfx.neural import Learner, Network
from postfx.runtime import CommandBuffer

Form = Callable[[], float]
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


class Ours:
    """A run and a step, each as a command buffer that is committed again and again; on a GPU it
    holds many of them."""

    def __init__(self, device: Device, network: Network, points: np.ndarray, targets: np.ndarray,
                 repeats: int) -> None:
        self.values = device.heap.tensor("values", targets.shape)
        self._run, self._learn = (self._record(device, network, points, targets, repeats, learns)
                                  for learns in (False, True))

    def _record(self, device: Device, network: Network, points: np.ndarray, targets: np.ndarray,
                repeats: int, learns: bool) -> CommandBuffer:
        learner = Learner(device, network, 1e-3)
        places, wanted = device.wrap("points", points), device.wrap("targets", targets)
        commands = device.command_buffer("network", captured=False)
        with commands.compute_encoder("network") as encoder:
            for _ in range(repeats):
                if learns:
                    learner.learn(encoder, places, wanted)
                else:
                    learner.run(encoder, places, self.values)
                    encoder.barrier()
        return commands

    def run(self) -> float:
        return self._do(self._run)

    def learn(self) -> float:
        return self._do(self._learn)

    def _do(self, commands: CommandBuffer) -> float:
        """Milliseconds by the device's clock."""
        commands.commit()
        commands.wait()
        return sum(taken for _, taken in commands.timings)


class Torch:
    """The same by torch, eager or compiled."""

    def __init__(self, device: str, network: Network, points: np.ndarray, targets: np.ndarray,
                 repeats: int, mode: str | None) -> None:
        self._module = Module(network, network.initial()).to(device)
        self._adam = torch.optim.Adam(self._module.parameters(), 1e-3, fused=True)
        self._call = torch.compile(self._module, mode=mode) if mode else self._module
        self._places = torch.from_numpy(points).to(device)
        self._targets = torch.from_numpy(targets).to(device)
        self._repeats, self._is_gpu = repeats, device == "cuda"

    def run(self) -> float:
        with torch.no_grad():
            return self._do(self._run)

    def learn(self) -> float:
        return self._do(self._learn)

    def _run(self) -> None:
        self.values = self._call(self._places)

    def _learn(self) -> None:
        self._adam.zero_grad()
        torch.nn.functional.mse_loss(self._call(self._places), self._targets).backward()
        self._adam.step()

    def _do(self, once: Callable[[], None]) -> float:
        """Milliseconds by the GPU's clock, 0 without one."""
        marks = [torch.cuda.Event(enable_timing=True) for _ in range(2)] if self._is_gpu else []
        for mark in marks[:1]:
            mark.record()
        for _ in range(self._repeats):
            once()
        for mark in marks[1:]:
            mark.record()
            torch.cuda.synchronize()
        return float(marks[0].elapsed_time(marks[1])) if marks else 0.0


def milliseconds(form: Form) -> tuple[float, float]:
    """By the host's clock, and by the device's."""
    begin = time.perf_counter()
    device = form()
    return 1000 * (time.perf_counter() - begin), device


parser = argparse.ArgumentParser(description=__doc__.partition("\n\n")[0])
parser.add_argument("--widths", type=int, nargs="+", default=[16, 32, 64])
parser.add_argument("--threads", type=int, nargs="+", default=[1, 2])
parser.add_argument("--points", type=int, default=65536)
parser.add_argument("--runs", type=int, default=9)
parser.add_argument("--eager", action="store_true")
parser.add_argument("--device", choices=["cpu", "cuda"], default="cpu")
parser.add_argument("--tf32", action="store_true")
parser.add_argument("--graph", action="store_true")
parser.add_argument("--repeats", type=int, default=20)
chosen = parser.parse_args()

random = np.random.default_rng(0)
points = random.uniform(-1, 1, (chosen.points, 3)).astype(np.float32)
targets = random.normal(size=(chosen.points, 3)).astype(np.float32)
modes = [None] if chosen.eager else [None, "reduce-overhead" if chosen.graph else "default"]
repeats = chosen.repeats if chosen.device == "cuda" else 1
torch.set_float32_matmul_precision("high" if chosen.tf32 else "highest")
print(f"{'threads':>7} {'width':>5} {'what':<7} {'ours ms':>8} {'eager ms':>9} "
      f"{'compiled ms':>11}  torch is slower")
for threads in chosen.threads if chosen.device == "cpu" else [1]:
    torch.set_num_threads(threads)
    for width in chosen.widths:
        network = Network(3, (width,) * 3, 3, bands=BANDS)
        device = Device(chosen.device, threads=threads)
        ours = Ours(device, network, points, targets, repeats)
        twins = [Torch(chosen.device, network, points, targets, repeats, mode) for mode in modes]
        for what in ("run", "learn"):
            forms = [getattr(form, what) for form in (ours, *twins)]
            # compiles; CUDA graphs are captured the second time
            for _ in range(3 if chosen.device == "cuda" else 1):
                for form in forms:
                    form()
            if what == "run":
                values, bound = ours.values.download(), 1e-2 if chosen.tf32 else 1e-4
                if max(np.abs(values - other.values.cpu().numpy()).max()
                       for other in twins) > bound:
                    raise SystemExit("the forms do not agree")
            times = (np.array([[milliseconds(form) for form in forms] for _ in range(chosen.runs)])
                     / repeats)
            for clock, shown in enumerate((what, "by card")[:1 if chosen.device == "cpu" else 2]):
                own, *rest = np.median(times[..., clock], axis=0)
                ratios = " and ".join(f"{other / own:.1f}x" for other in rest)
                digits = 3 if chosen.device == "cuda" else 1
                others = " ".join(f"{other:>{size}.{digits}f}"
                                  for other, size in zip(rest, (9, 11), strict=False))
                print(f"{threads:>7} {width:>5} {shown:<7} {own:>8.{digits}f} {others}  {ratios}",
                      flush=True)
