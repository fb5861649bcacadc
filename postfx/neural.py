"""Small networks that run, and learn, within the commands of a frame. See docs/lab/networks.md."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from postfx.errors import BindingError, DeviceError, ModelError, offer
from postfx.files import write_atomically
from postfx.kernels.neural import (
    ACTIVATIONS,
    ADAM,
    FACTS,
    FORWARD,
    GRADIENTS,
    GRID,
    GRID_PULL,
    GRID_STEP,
    MOST_LAYERS,
    MOST_LEVELS,
    MOST_WIDTH,
    SIDES,
)
from postfx.runtime import ArgumentTable, ComputeEncoder, Device, Tensor
from postfx.version import pip_install

__all__ = ["Grid", "Learner", "Network"]

# Points of a group at least, and groups at most, on the CPU, where a thread sums a group, and on
# a GPU, where a block does.
CPU_GROUPS = (256, 64)
GPU_GROUPS = (64, 132)

# Adam's usual constants (Kingma and Ba 2014): decays of both means, and what keeps steps finite.
DECAYS = (0.9, 0.999)
EPSILON = 1e-8

LEAST_RATE = 1e-6
"""What `Learner.fit` ends with."""


@dataclass(frozen=True)
class Network:
    """A fully connected network of numbers in [-inf, inf], computed in float32.

    Attributes:
        inputs: numbers of a point.
        hidden: outputs of every layer but the last, each followed by the activation; up to four.
        outputs: of the last layer.
        activation: 'relu', 'gelu' (of the error function) or 'sine' (Sitzmann 2020; its frequency
            is in the weights).
        bands: sin(2^k pi x) and cos(2^k pi x) for k < bands follow the inputs (Fourier features,
            Tancik 2020).
        encoded: how many inputs, from the first on, have them; default all.

    Raises ModelError if a layer is wider than 128, or there are too many layers.
    """

    inputs: int
    hidden: tuple[int, ...]
    outputs: int
    activation: str = "relu"
    bands: int = 0
    encoded: int | None = None

    def __post_init__(self) -> None:
        if self.activation not in ACTIVATIONS:
            raise ModelError(f"no activation '{self.activation}'"
                             f"{offer(self.activation, ACTIVATIONS, 'there are')}")
        if len(self.hidden) >= MOST_LAYERS:
            raise ModelError(f"{len(self.hidden)} hidden layers: a small network has at most "
                             f"{MOST_LAYERS - 1}")
        if not 0 <= self.encoded_inputs <= self.inputs or not 0 <= self.bands <= 20:
            raise ModelError(f"{self.bands} bands of {self.encoded_inputs} inputs: there are "
                             f"{self.inputs} inputs, and at most 20 bands")
        if not all(1 <= size <= MOST_WIDTH for size in (self.inputs, *self.sizes)):
            raise ModelError(f"layers of {', '.join(map(str, self.sizes))} numbers: each must have "
                             f"1 to {MOST_WIDTH}")

    @property
    def encoded_inputs(self) -> int:
        """How many inputs, from the first on, have bands."""
        return self.inputs if self.encoded is None else self.encoded

    @property
    def sizes(self) -> tuple[int, ...]:
        """Numbers that the first layer reads, then the outputs of every layer."""
        return (self.inputs + 2 * self.bands * self.encoded_inputs, *self.hidden, self.outputs)

    @cached_property
    def shapes(self) -> tuple[tuple[int, int], ...]:
        """(outputs, inputs) of every layer."""
        return tuple(zip(self.sizes[1:], self.sizes[:-1], strict=True))

    @cached_property
    def count(self) -> int:
        """How many parameters there are: weights (outputs, inputs) and biases (outputs,), layer by
        layer."""
        return sum(makes * (reads + 1) for makes, reads in self.shapes)

    def facts(self) -> np.ndarray:
        """The argument `network` of the kernels."""
        facts = np.zeros(FACTS, np.float32)
        numbers = (len(self.shapes), self.inputs, self.encoded_inputs, self.bands,
                   ACTIVATIONS.index(self.activation))
        facts[:len(numbers) + len(self.sizes)] = (*numbers, *self.sizes)
        return facts

    def initial(self, seed: int = 0) -> np.ndarray:
        """Random parameters (count,): normal, of variance 2 / inputs (He 2015); biases are 0."""
        random, parts = np.random.default_rng(seed), []
        for makes, reads in self.shapes:
            parts += [random.normal(0, np.sqrt(2 / reads), makes * reads), np.zeros(makes)]
        return np.concatenate(parts).astype(np.float32)

    def layers(self, parameters: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
        """Views of the weights (outputs, inputs) and biases (outputs,) of every layer."""
        found, start = [], 0
        for makes, reads in self.shapes:
            middle, end = start + makes * reads, start + makes * (reads + 1)
            found.append((parameters[start:middle].reshape(makes, reads), parameters[middle:end]))
            start = end
        return found

    def onnx(self, parameters: np.ndarray | None = None) -> bytes:
        """The network as an ONNX model: points (points, inputs) -> values (points, outputs).

        Args:
            parameters: (count,), which the model then holds. Without them they are a second input,
                so that the model can read a tensor that a `Learner` writes in the same command
                buffer.

        Raises ModelError without the package `onnx`.
        """
        try:
            from postfx.neural_onnx import to_onnx
        except ImportError:
            raise ModelError("ONNX models are made with the package onnx: "
                             f"{pip_install('capture')}") from None
        return to_onnx(self.shapes, self.activation, self.bands, self.encoded_inputs, parameters)

    def save_onnx(self, path: str | Path, parameters: np.ndarray | None = None) -> None:
        """Write the ONNX model to a file, which a `Library` of its folder finds."""
        write_atomically(Path(path), lambda file: file.write(self.onnx(parameters)), durable=True)


@dataclass(frozen=True)
class Grid:
    """A hash grid (Mueller 2022): tables whose entries are learnt, and which a network reads
    interpolated at a point.

    Attributes:
        dims: how many numbers of a point, from the first on, are its place, in [0, 1]; 2 or 3.
            Places outside count as on the edge.
        levels: tables, at most 16.
        numbers: of an entry.
        entries: of a table, a power of two; where a level has more corners than that, some share an
            entry.
        sides: cells along an axis of the first level and of the last; the others lie between in
            equal ratios.

    Raises ModelError if these do not fit.
    """

    dims: int
    levels: int = 8
    numbers: int = 2
    entries: int = 1 << 14
    sides: tuple[int, int] = (16, 512)

    def __post_init__(self) -> None:
        if (self.dims not in (2, 3) or not 1 <= self.levels <= MOST_LEVELS
            or not 1 <= self.numbers <= 8):
            raise ModelError(f"a grid of {self.dims} dims, {self.levels} levels, {self.numbers} "
                             f"numbers: it has 2 or 3 dims, at most {MOST_LEVELS} levels and at "
                             "most 8 numbers")
        if (not 1 <= self.sides[0] <= self.sides[1] <= 1 << 16 or not 0 < self.entries <= 1 << 22 or
                self.entries & (self.entries - 1)):
            raise ModelError(f"a grid of {self.entries} entries and {self.sides[0]} to "
                             f"{self.sides[1]} cells: entries are a power of two up to 4194304, "
                             "cells at most 65536")

    @property
    def width(self) -> int:
        """How many numbers the network reads of it."""
        return self.levels * self.numbers

    def facts(self) -> np.ndarray:
        """The argument `grid` of the kernels."""
        facts = np.zeros(SIDES + MOST_LEVELS, np.float32)
        facts[:SIDES] = self.dims, self.numbers, self.entries, self.levels
        facts[SIDES:SIDES + self.levels] = np.geomspace(*self.sides, self.levels).round()
        return facts

    def initial(self, seed: int = 0) -> np.ndarray:
        """Random tables (levels, entries * numbers) in [-1e-4, 1e-4]."""
        random = np.random.default_rng(seed)
        return random.uniform(-1e-4, 1e-4,
                              (self.levels, self.entries * self.numbers)).astype(np.float32)


class _GridOnDevice:
    """A grid's tables, their moments, and the commands that read and change them."""

    def __init__(self, device: Device, grid: Grid) -> None:
        self.grid, self._device, self._rows = grid, device, dict[int, tuple[Tensor, Tensor]]()
        size = (grid.levels, grid.entries * grid.numbers)
        self.table = device.heap.tensor("neural grid", size)
        self._sums = device.heap.tensor("neural grid sums", size, "int64")
        self._moments = device.heap.tensor("neural grid moments", (*size, 3))
        self._facts = device.heap.tensor("neural grid facts", grid.facts().shape)
        self._facts.upload(grid.facts())
        self._read, self._pull, self._step = map(device.compute_state, (GRID, GRID_PULL, GRID_STEP))

    def restart(self, seed: int) -> None:
        self.table.upload(self.grid.initial(seed))
        self._moments.fill(0)

    def rows(self, points: int, inputs: int) -> tuple[Tensor, Tensor]:
        """Rows that hold the network's inputs of so many points, and the derivatives by them."""
        if points not in self._rows:
            one, other = (self._device.heap.tensor(f"neural {name}", (points, inputs))
                          for name in ("rows", "pulls"))
            self._rows[points] = one, other
        return self._rows[points]

    def read(self, encoder: ComputeEncoder, points: Tensor, rows: Tensor) -> None:
        encoder.dispatch(self._read, ArgumentTable(self._read, {
            "grid": self._facts, "table": self.table, "points": points, "rows": rows}))

    def learn(self, encoder: ComputeEncoder, points: Tensor, pulls: Tensor, partials: Tensor,
              hyper: Tensor) -> None:
        encoder.dispatch(self._pull, ArgumentTable(self._pull, {
            "grid": self._facts, "points": points, "pulls": pulls, "sums": self._sums}))
        encoder.dispatch(self._step, ArgumentTable(self._step, {
            "sums": self._sums, "partials": partials, "hyper": hyper, "table": self.table,
            "moments": self._moments}))


class Learner:
    """A network on a device, perhaps behind a hash grid, with the state of Adam (Kingma 2015).

    Attributes:
        parameters: tensor (count,), which `learn` changes and `run` reads in the order in which
            they are recorded.
        moments: tensor (count, 3) of Adam: mean, mean square, and number of steps.
    """

    def __init__(self, device: Device, network: Network, rate: float = 1e-2,
                 parameters: np.ndarray | None = None,
                 seed: int = 0, grid: Grid | None = None) -> None:
        """
        Args:
            rate: step size of Adam.
            parameters: (count,) to begin with; default `network.initial(seed)`.
            grid: replaces a point's place by what its tables hold there: the network's inputs are
                those numbers and the rest of the point.

        Raises ModelError if the network has fewer inputs than the grid gives, or bands; DeviceError
        for a device with explicit barriers: several commands are recorded at once, and their order
        follows from what they read and write.
        """
        if device.hazards.explicit:
            raise DeviceError("a network learns by several commands, which the device must order: "
                              "make it without explicit_barriers")
        if grid and (network.bands or network.inputs < grid.width):
            raise ModelError(f"a network of {network.inputs} inputs and {network.bands} bands "
                             f"behind a grid: it needs at least {grid.width} inputs and no bands")
        self.device, self.network = device, network
        self.parameters = device.heap.tensor("neural parameters", (network.count,))
        self.moments = device.heap.tensor("neural moments", (network.count, 3))
        self._facts, self._hyper = (device.heap.tensor(name, shape) for name, shape in
                                    (("network", network.facts().shape), ("neural hyper", (4,))))
        self._facts.upload(network.facts())
        self._forward, self._gradients, self._adam = map(device.compute_state,
                                                         (FORWARD, GRADIENTS, ADAM))
        self._partials: dict[int, Tensor] = {}
        self._grid = _GridOnDevice(device, grid) if grid else None
        self._inputs = network.inputs - grid.width + grid.dims if grid else network.inputs
        self._no_pulls = device.heap.tensor("no pulls", (1, network.inputs))
        self._last: Tensor | None = None
        self.set_rate(rate)
        self.restart(network.initial(seed) if parameters is None else parameters, seed)

    @property
    def table(self) -> Tensor:
        """The grid's entries (levels, entries * numbers). Raises BindingError without a grid."""
        if self._grid is None:
            raise BindingError("this network has no grid")
        return self._grid.table

    def set_rate(self, rate: float) -> None:
        """Change Adam's step size. No command that learns may be in flight."""
        self._hyper.upload(np.array([rate, *DECAYS, EPSILON], np.float32))

    def restart(self, parameters: np.ndarray, seed: int = 0) -> None:
        """Begin anew with these parameters (count,), a grid with random entries. No command that
        uses the network may be in flight."""
        if parameters.shape != (self.network.count,):
            raise BindingError(f"parameters have the shape {parameters.shape}: this network has "
                               f"({self.network.count},)")
        self.parameters.upload(parameters.astype(np.float32))
        self.moments.fill(0)
        if self._grid:
            self._grid.restart(seed)

    def run(self, encoder: ComputeEncoder, points: Tensor, values: Tensor) -> None:
        """Record the network: points (points, inputs) -> values (points, outputs)."""
        self._check(points, self._inputs, points.shape[0])
        self._check(values, self.network.outputs, points.shape[0])
        rows, _ = self._read(encoder, points)
        encoder.dispatch(self._forward, ArgumentTable(self._forward, {
            "network": self._facts, "parameters": self.parameters, "points": rows,
            "values": values}))

    def learn(self, encoder: ComputeEncoder, points: Tensor, targets: Tensor) -> None:
        """Record one step of Adam on the mean squared error of the points that are learnt.

        Args:
            points: (points, inputs).
            targets: (points, outputs); a point with one that is not finite is not learnt: it counts
                neither in the error nor in the number of points.
        """
        self._check(points, self._inputs, points.shape[0])
        self._check(targets, self.network.outputs, points.shape[0])
        rows, pulls = self._read(encoder, points)
        least, most = CPU_GROUPS if self.device.memory.host_visible else GPU_GROUPS
        groups = min(most, -(-points.shape[0] // least))
        if groups not in self._partials:
            self._partials[groups] = self.device.heap.tensor("neural partials",
                                                             (groups, self.network.count + 2))
        partials = self._last = self._partials[groups]
        encoder.dispatch(self._gradients, ArgumentTable(self._gradients, {
            "network": self._facts, "parameters": self.parameters, "points": rows,
            "targets": targets, "partials": partials, "pulls": pulls}))
        encoder.dispatch(self._adam, ArgumentTable(self._adam, {
            "partials": partials, "hyper": self._hyper, "parameters": self.parameters,
            "moments": self.moments}))
        if self._grid:
            self._grid.learn(encoder, points, pulls, partials, self._hyper)

    def _read(self, encoder: ComputeEncoder, points: Tensor) -> tuple[Tensor, Tensor]:
        """What the network reads of points, and where the derivatives by it go."""
        if self._grid is None:
            return points, self._no_pulls
        rows, pulls = self._grid.rows(points.shape[0], self.network.inputs)
        self._grid.read(encoder, points, rows)
        return rows, pulls

    def fit(self, points: np.ndarray, targets: np.ndarray, steps: int, rate: float,
            batch: int = 8192, random: np.random.Generator | None = None) -> None:
        """Learn from batches that are drawn from known points, and wait for each.

        Args:
            points: (count, inputs) float32.
            targets: (count, outputs) float32; a point with one that is not finite is left out.
            rate: step size of the first batch; it falls to nearly 0 by half a cosine (Loshchilov
                and Hutter 2017).
            batch: points of a batch.
            random: draws the points; default `np.random.default_rng(0)`.
        """
        random = np.random.default_rng(0) if random is None else random
        drawn = [(self.device.heap.tensor(f"{name} of a batch", (batch, every.shape[1])), every)
                 for name, every in (("points", points), ("targets", targets))]
        for step in range(steps):
            self.set_rate(rate / 2 * (1 + np.cos(np.pi * step / steps)) + LEAST_RATE)
            picked = random.integers(len(points), size=batch)
            for tensor, every in drawn:
                tensor.upload(every[picked])
            commands = self.device.command_buffer("fit")
            with commands.compute_encoder("learn") as encoder:
                self.learn(encoder, *(tensor for tensor, _ in drawn))
            commands.commit()
            commands.wait()

    def error(self) -> float:
        """Mean squared error of the points that the last step learnt, before that step; NaN if it
        learnt none."""
        if self._last is None:
            raise BindingError("the network has not learned yet: record `learn` and wait for its "
                               "commands")
        off, learnt = self._last.content()[:, -2:].sum(0, dtype=np.float64)
        return float(off / learnt) if learnt else float("nan")

    def _check(self, tensor: Tensor, numbers: int, points: int) -> None:
        if tensor.shape != (points, numbers) or points < 1:
            raise BindingError(f"tensor '{tensor.name}' has the shape {tensor.shape}: this network "
                               f"takes ({max(points, 1)}, {numbers}) here")
