"""Kernels of small fully connected networks: all layers of a point in one pass, forwards,
backwards, and Adam.

A point's inputs are followed by sin(2^k pi x) and cos(2^k pi x) of the first `encoded` ones
(Fourier features, Tancik 2020), for k < `bands`; then come 1 to 5 layers of at most 128 outputs,
with an activation after each but the last.

- `FORWARD`: network, parameters (count,), points (points, inputs) -> values (points, outputs).
- `GRADIENTS`: the same and targets (points, outputs) -> partials (groups, count + 2). A group has
  equally many points, to one; its row holds its part of the gradient of the squared error over all
  points, of that error, and the share of all points that it learns. A point with a target that is
  not finite is not learnt and adds nothing. What sums over groups divided by the sum of shares is
  the mean over the points that are learnt: `ADAM` and `GRID_STEP` divide. pulls (points, inputs)
  get that error's derivatives by the inputs; with another number of rows they are left alone.
- `ADAM`: the sum of the partials by groups, and one step of Adam (Kingma 2015): hyper (4,) is the
  step size, the two decays and epsilon. parameters (count,) and moments (count, 3), whose last
  number counts steps, change in place.

network (12,) holds numbers of layers, inputs, encoded inputs, bands, the activation, and the sizes
from what the first layer reads to the last layer's outputs. Parameters are of each layer the
weights (outputs, inputs) and the biases, as torch orders them. Sums have a fixed order: results do
not depend on threads.

A hash grid (Mueller 2022) makes the numbers that a network reads of a point in [0, 1]^dims. On each
level the point lies in a cell of a regular grid; the numbers at its corners, which are entries of a
table, are interpolated.

- `GRID`: grid (20,), table (levels, entries * numbers), points (points, dims + others) -> rows
  (points, levels * numbers + others). grid holds dims, numbers, entries (a power of two), levels,
  and each level's cells along an axis.
- `GRID_PULL`: grid, points and pulls as above -> sums (levels, entries * numbers), the derivatives
  by the table in units of 1 / UNITS: whole numbers, whose sum is the same in any order.
- `GRID_STEP`: one step of Adam, with the partials of the network, for entries that a point reached;
  table and moments (levels, entries * numbers, 3) change in place.
"""

from __future__ import annotations

import numpy as np

from postfx.compiled.library import Rows
from postfx.kernels import Blocks, Kernel

MOST_LAYERS = 5
MOST_WIDTH = 128
LAYERS, INPUTS, ENCODED, BANDS, ACTIVATION, SIZES = range(6)
FACTS = SIZES + MOST_LAYERS + 1
ACTIVATIONS = ("relu", "gelu", "sine")
RELU, GELU, SINE = range(3)
THREADS = 256
"""Threads of a block on a GPU."""
MOST_LEVELS = 16
DIMS, NUMBERS, ENTRIES, LEVELS, SIDES = range(5)
PI = np.float32(np.pi)
UNITS = np.float64(2**44)
MOST_PULL = 2.0**17
"""The largest derivative that `GRID_PULL` adds to an entry; NaN adds nothing."""

_NETWORK_SHAPES: dict[str, tuple[int | str, ...]] = {
    "network": (FACTS,), "parameters": ("count",), "points": ("points", "inputs")}
FORWARD = Kernel(
    "neural_forward", ("network", "parameters", "points"), ("values",), Rows("neural_forward"),
    ("values", 0), {**_NETWORK_SHAPES, "values": ("points", "outputs")},
    blocks=Blocks(64, THREADS, 224 << 10, 132))
GRADIENTS = Kernel(
    "neural_gradients", ("network", "parameters", "points", "targets"), ("partials", "pulls"),
    Rows("neural_gradients"), ("partials", 0), {**_NETWORK_SHAPES, "targets": ("points", "outputs"),
                                                "partials": ("groups", "sums"),
                                                "pulls": ("pulled", "inputs")},
    blocks=Blocks(1, THREADS, 224 << 10))
ADAM = Kernel(
    "neural_adam", ("partials", "hyper", "parameters", "moments"), ("parameters", "moments"),
    Rows("neural_adam"), ("moments", 0), {"partials": ("groups", "sums"), "hyper": (4,),
                                          "parameters": ("count",), "moments": ("count", 3)},
    blocks=Blocks(8, THREADS))
_GRID: dict[str, tuple[int | str, ...]] = {
    "grid": (SIDES + MOST_LEVELS,), "table": ("levels", "entries"), "points": ("points", "axes"),
    "sums": ("levels", "entries"), "partials": ("groups", "parts"),
    "moments": ("levels", "entries", 3), "hyper": (4,)}
GRID = Kernel(
    "neural_grid", ("grid", "table", "points"), ("rows",), Rows("neural_grid"), ("rows", 0),
    {**{name: _GRID[name] for name in ("grid", "table", "points")}, "rows": ("points", "inputs")})
GRID_PULL = Kernel(
    "neural_grid_pull", ("grid", "points", "pulls"), ("sums",), Rows("neural_grid_pull"),
    ("sums", 0),
    {**{name: _GRID[name] for name in ("grid", "points", "sums")}, "pulls": ("points", "inputs")},
    {"sums": "int64"}, blocks=Blocks(1, THREADS))
GRID_STEP = Kernel(
    "neural_grid_step", ("sums", "partials", "hyper", "table", "moments"), ("table", "moments"),
    Rows("neural_grid_step"), ("table", 0),
    {name: _GRID[name] for name in ("sums", "partials", "hyper", "table", "moments")},
    {"sums": "int64"})
