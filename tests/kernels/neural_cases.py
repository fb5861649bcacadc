"""Random arguments for the kernels of small networks and hash grids."""

from __future__ import annotations

import numpy as np

from postfx.compiled.library import Rows
from postfx.kernels import Kernel
from postfx.kernels.neural import ADAM, FORWARD, GRADIENTS, GRID, GRID_PULL, GRID_STEP, UNITS
from postfx.neural import DECAYS, EPSILON, Grid, Network

KERNELS = (FORWARD, GRADIENTS, ADAM, GRID, GRID_PULL, GRID_STEP)
NETWORKS = (Network(3, (4, 4), 3), Network(3, (16, 16), 3, "gelu"),
            Network(9, (64, 64, 64), 3, bands=4, encoded=3),
            Network(2, (128, 127, 5, 33), 7, "sine", bands=3), Network(5, (), 2))
TIMED = Network(9, (64, 64, 64), 3, "gelu", bands=4, encoded=3)
HYPER = np.array([0.01, *DECAYS, EPSILON], np.float32)
GROUPS = 3


def arguments(kernel: Kernel, network: Network = TIMED, points: int = 16384,
              dims: int = 3) -> dict[str, np.ndarray]:
    """What a kernel reads, and places for what it writes alone; a grid of so many dims fills two
    thirds of the network's inputs, where there are as many."""
    random = np.random.default_rng(points)
    levels = max(1, network.inputs // 3)
    grid = Grid(dims, levels=levels, numbers=2, entries=1 << 12, sides=(4, 100))
    table = (levels, grid.entries * grid.numbers)
    places = random.uniform(-0.1, 1.1,
                            (points, dims + network.inputs - grid.width)).astype(np.float32)
    targets = random.normal(size=(points, network.outputs)).astype(np.float32)
    targets[::7, 0] = np.nan
    partials = random.normal(size=(GROUPS, network.count + 2)).astype(np.float32)
    partials[:, -1] = 0.25, 0, 0.25
    sums = (random.normal(size=table) * UNITS).astype(np.int64) * (random.random(table) < 0.7)
    is_grid = kernel in (GRID, GRID_PULL, GRID_STEP)
    values = {
        "network": network.facts(), "grid": grid.facts(), "hyper": HYPER, "partials": partials,
        "sums": sums,
        "parameters": network.initial(2) + random.normal(0, 0.02, network.count).astype(np.float32),
        "points": places if is_grid
                  else random.uniform(-1, 1, (points, network.inputs)).astype(np.float32),
        "targets": targets, "table": random.normal(size=table).astype(np.float32),
        "pulls": random.normal(size=(points, network.inputs)).astype(np.float32),
        "moments": random.uniform(0, 1, ((*table, 3) if is_grid else (network.count, 3)))
                   .astype(np.float32)}
    values["moments"][..., 2] = random.integers(0, 3, table) if is_grid else 4
    made = {"values": (points, network.outputs), "rows": (points, network.inputs), "sums": table,
            "partials": (GROUPS, network.count + 2), "pulls": (points, network.inputs)}
    written = {name: np.zeros(made[name], kernel.types.get(name, "float32"))
               for name in kernel.writes if name not in kernel.reads}
    return {name: values[name] for name in kernel.reads} | written


def shading(height: int, width: int) -> dict[str, np.ndarray]:
    """Arguments of the sample of a network in a kernel, and the network's facts."""
    random, network = np.random.default_rng(0), Network(5, (32, 32), 3, "gelu")
    normal, albedo = random.uniform(-1, 1, (2, height, width, 3)).astype(np.float32)
    return {"network": network.facts(), "parameters": network.initial(), "normal": normal,
            "albedo": np.abs(albedo), "shaded": np.zeros_like(normal)}


def rows_of(kernel: Kernel, given: dict[str, np.ndarray]) -> int:
    """How many rows a kernel has."""
    name, axis = kernel.row_axis
    return given[name].shape[axis]


def run(kernel: Kernel, given: dict[str, np.ndarray],
        level: str | None = None) -> dict[str, np.ndarray]:
    """What a kernel writes, at a level of the processor."""
    arrays = {name: array.copy() if name in kernel.writes else array
              for name, array in given.items()}
    assert isinstance(kernel.rows, Rows)
    Rows(kernel.rows.name, level=level)(0, rows_of(kernel, given), *arrays.values())
    return {name: arrays[name] for name in kernel.writes}
