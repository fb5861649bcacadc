"""Kernels of small fully connected networks: all layers of a point in one pass, forwards, backwards, and Adam.

A point's inputs are followed by sin(2^k pi x) and cos(2^k pi x) of the first `encoded` ones (Fourier features, Tancik
2020), for k < `bands`; then come 1 to 5 layers of at most 128 outputs, with an activation after each but the last.

- `FORWARD`: network, parameters (count,), points (points, inputs) -> values (points, outputs).
- `GRADIENTS`: the same and targets (points, outputs) -> partials (groups, count + 2). A group has equally many points,
  to one; its row holds its part of the gradient of the squared error over all points, of that error, and the share of
  all points that it learns. A point with a target that is not finite is not learnt and adds nothing. What sums over
  groups divided by the sum of shares is the mean over the points that are learnt: `ADAM` and `GRID_STEP` divide.
  pulls (points, inputs) get that error's derivatives by the inputs; with another number of rows they are left alone.
- `ADAM`: the sum of the partials by groups, and one step of Adam (Kingma 2015): hyper (4,) is the step size, the two
  decays and epsilon. parameters (count,) and moments (count, 3), whose last number counts steps, change in place.

network (12,) holds numbers of layers, inputs, encoded inputs, bands, the activation, and the sizes from what the first
layer reads to the last layer's outputs. Parameters are of each layer the weights (outputs, inputs) and the biases, as
torch orders them. Sums have a fixed order: results do not depend on threads.

A hash grid (Mueller 2022) makes the numbers that a network reads of a point in [0, 1]^dims. On each level the point
lies in a cell of a regular grid; the numbers at its corners, which are entries of a table, are interpolated.

- `GRID`: grid (20,), table (levels, entries * numbers), points (points, dims + others) -> rows (points, levels *
  numbers + others). grid holds dims, numbers, entries (a power of two), levels, and each level's cells along an axis.
- `GRID_PULL`: grid, points and pulls as above -> sums (levels, entries * numbers), the derivatives by the table in
  units of 1 / UNITS: whole numbers, whose sum is the same in any order.
- `GRID_STEP`: one step of Adam, with the partials of the network, for entries that a point reached; table and moments
  (levels, entries * numbers, 3) change in place.
"""

from __future__ import annotations

import numpy as np

from postfx.kernels import Blocks, Kernel
from postfx.kernels.numeric import Real, compiled, exp, fused, fused_inline, summed
from postfx.kernels.vectors import LANES, STRIP, combine, correlate, count_blocks, open_blocks

MOST_LAYERS, MOST_WIDTH = 5, 128
LAYERS, INPUTS, ENCODED, BANDS, ACTIVATION, SIZES = range(6)
FACTS = SIZES + MOST_LAYERS + 1
ACTIVATIONS = ("relu", "gelu", "sine")
RELU, GELU, SINE = range(3)
STRIPS = 8
"""Strips whose layers are kept until their gradients are summed: few enough for a core's cache."""
THREADS = 256
"""Of a block on a GPU."""
MOST_LEVELS = 16
DIMS, NUMBERS, ENTRIES, LEVELS, SIDES = range(5)
PRIMES = (1, 2654435761, 805459861)
UNITS = np.float64(2**44)
ZERO, HALF, ONE, PI = np.float32(0), np.float32(0.5), np.float32(1), np.float32(np.pi)


@fused_inline
def sine_cosine(whole: Real, rest: Real) -> tuple[Real, Real]:
    """Sine and cosine of whole pi + rest, for rest in [-pi/2, pi/2]; Taylor series, absolute error below 2e-7."""
    square = rest * rest
    odd = whole * HALF
    sign = ONE - np.float32(4) * (odd - np.floor(odd))
    sine = np.float32(-1 / 39916800)
    sine = sine * square + np.float32(1 / 362880)
    sine = sine * square + np.float32(-1 / 5040)
    sine = sine * square + np.float32(1 / 120)
    sine = sine * square + np.float32(-1 / 6)
    cosine = np.float32(1 / 479001600)
    cosine = cosine * square + np.float32(-1 / 3628800)
    cosine = cosine * square + np.float32(1 / 40320)
    cosine = cosine * square + np.float32(-1 / 720)
    cosine = cosine * square + np.float32(1 / 24)
    cosine = cosine * square + np.float32(-0.5)
    return sign * (sine * square * rest + rest), sign * (cosine * square + ONE)


@fused_inline
def gelu(z: Real) -> tuple[Real, Real]:
    """z times the normal distribution's share below z, and its slope; error of that share below 1e-7
    (Abramowitz and Stegun 7.1.26)."""
    size = abs(z) * np.float32(0.7071067811865476)
    bell = exp(max(-size * size, np.float32(-80)))
    t = ONE / (ONE + np.float32(0.3275911) * size)
    tail = np.float32(1.061405429) * t + np.float32(-1.453152027)
    tail = tail * t + np.float32(1.421413741)
    tail = tail * t + np.float32(-0.284496736)
    tail = (tail * t + np.float32(0.254829592)) * t * bell * HALF
    share = ONE - tail if z > ZERO else tail
    return z * share, share + z * bell * np.float32(0.3989422804014327)


@compiled
def apply_relu(values: np.ndarray, slopes: np.ndarray) -> None:
    for k in range(values.size):
        slopes[k] = ONE if values[k] > ZERO else ZERO
        values[k] = max(values[k], ZERO)


@fused
def apply_gelu(values: np.ndarray, slopes: np.ndarray) -> None:
    for k in range(values.size):
        values[k], slopes[k] = gelu(values[k])


@fused
def apply_sine(values: np.ndarray, slopes: np.ndarray) -> None:
    for k in range(values.size):
        z = values[k]
        whole = np.floor(z * np.float32(1 / np.pi) + HALF)
        rest = z - whole * np.float32(3.140625)  # pi in three parts, the first two of few bits
        rest = rest - whole * np.float32(9.67502593994e-4)
        rest = rest - whole * np.float32(1.50995799e-7)
        values[k], slopes[k] = sine_cosine(whole, rest)


@compiled
def activate(kind: int, values: np.ndarray, slopes: np.ndarray) -> None:
    """Replace values by the activation of them; `slopes` get its derivatives."""
    if kind == RELU:
        apply_relu(values, slopes)
    elif kind == GELU:
        apply_gelu(values, slopes)
    else:
        apply_sine(values, slopes)


@fused
def encode_row(row: np.ndarray, factor: Real, sines: np.ndarray, cosines: np.ndarray) -> None:
    """Sine and cosine of pi times `factor`, a power of two, times a row."""
    for p in range(row.size):
        turns = row[p] * factor
        whole = np.floor(turns + HALF)
        sines[p], cosines[p] = sine_cosine(whole, (turns - whole) * PI)


@compiled
def encode(network: np.ndarray, points: np.ndarray, first: int, count: int, rows: np.ndarray) -> None:
    """What the first layer reads, in rows of a strip, of `count` points; 0 beside them."""
    inputs, encoded, bands = int(network[INPUTS]), int(network[ENCODED]), int(network[BANDS])
    for k in range(inputs):
        for p in range(count):
            rows[k * STRIP + p] = points[first + p, k]
        for p in range(count, STRIP):
            rows[k * STRIP + p] = ZERO
    at, factor = inputs * STRIP, ONE
    for _ in range(bands):
        for k in range(encoded):
            encode_row(rows[k * STRIP:(k + 1) * STRIP], factor, rows[at:at + STRIP], rows[at + STRIP:at + 2 * STRIP])
            at += 2 * STRIP
        factor *= np.float32(2)


@compiled
def run_layers(network: np.ndarray, parameters: np.ndarray, layers: np.ndarray, slopes: np.ndarray, strip: int) -> None:
    """All layers of a strip: row l of `layers` holds what layer l reads, strip after strip."""
    count, start = int(network[LAYERS]), 0
    for layer in range(count):
        reads, makes = int(network[SIZES + layer]), int(network[SIZES + layer + 1])
        biases, size = start + reads * makes, makes * STRIP
        source, target = layers[layer], layers[layer + 1][strip * size:(strip + 1) * size]
        for j in range(makes):
            target[j * STRIP:(j + 1) * STRIP] = parameters[biases + j]
        combine(parameters, start, reads, 1, source, strip * reads * STRIP, reads, target, 0, makes)
        if layer < count - 1:
            activate(int(network[ACTIVATION]), target, slopes[layer + 1][strip * size:(strip + 1) * size])
        start = biases + makes


@compiled
def widest(network: np.ndarray) -> int:
    size = 0
    for layer in range(int(network[LAYERS]) + 1):
        size = max(size, int(network[SIZES + layer]))
    return size


@compiled
def forward_rows(y0: int, y1: int, network: np.ndarray, parameters: np.ndarray, points: np.ndarray,
                 values: np.ndarray) -> None:
    size = widest(network) * STRIP
    layers, slopes = np.empty((MOST_LAYERS + 1, size), np.float32), np.empty((MOST_LAYERS + 1, size), np.float32)
    result = layers[int(network[LAYERS])]
    for first in range(y0, y1, STRIP):
        count = min(STRIP, y1 - first)
        encode(network, points, first, count, layers[0])
        run_layers(network, parameters, layers, slopes, 0)
        for p in range(count):
            for j in range(values.shape[1]):
                values[first + p, j] = result[j * STRIP + p]


@compiled
def compare(values: np.ndarray, targets: np.ndarray, first: int, count: int, share: Real,
            deltas: np.ndarray) -> tuple[float, int]:
    """Sum of squared differences of a strip's points from their targets, and how many of them are learnt; the
    derivatives times `share`."""
    outputs, total, learnt = targets.shape[1], 0.0, 0
    deltas[:] = ZERO
    for p in range(count):
        known = True
        for j in range(outputs):
            known = known and np.isfinite(targets[first + p, j])
        if known:
            learnt += 1
            for j in range(outputs):
                difference = values[j * STRIP + p] - targets[first + p, j]
                total += difference * difference
                deltas[j * STRIP + p] = np.float32(2) * share * difference
    return total, learnt


@compiled
def multiply(row: np.ndarray, target: np.ndarray) -> None:
    for k in range(target.size):
        target[k] *= row[k]


@compiled
def pull_back(network: np.ndarray, parameters: np.ndarray, deltas: np.ndarray, strip: int, spare: np.ndarray) -> None:
    """Derivatives of every layer's result before its activation, in the place of the activation's slopes."""
    start = 0
    for layer in range(int(network[LAYERS])):
        start += (int(network[SIZES + layer]) + 1) * int(network[SIZES + layer + 1])
    for layer in range(int(network[LAYERS]) - 1, 0, -1):
        reads, makes = int(network[SIZES + layer]), int(network[SIZES + layer + 1])
        start -= (reads + 1) * makes
        size = reads * STRIP
        spare[:size] = ZERO
        combine(parameters, start, 1, reads, deltas[layer + 1], strip * makes * STRIP, makes, spare, 0, reads)
        multiply(spare[:size], deltas[layer][strip * size:(strip + 1) * size])


@compiled
def pull_inputs(network: np.ndarray, parameters: np.ndarray, deltas: np.ndarray, strip: int, spare: np.ndarray,
                pulls: np.ndarray) -> None:
    """Derivatives by the inputs of a strip's points, one in a row of `pulls`."""
    reads, makes = int(network[SIZES]), int(network[SIZES + 1])
    spare[:reads * STRIP] = ZERO
    combine(parameters, 0, 1, reads, deltas[1], strip * makes * STRIP, makes, spare, 0, reads)
    for p in range(pulls.shape[0]):
        for k in range(pulls.shape[1]):
            pulls[p, k] = spare[k * STRIP + p]


@summed
def sum_of(row: np.ndarray) -> Real:
    total = ZERO
    for k in range(row.size):
        total += row[k]
    return total


@compiled
def add_gradients(network: np.ndarray, layers: np.ndarray, deltas: np.ndarray, strips: int, blocks: np.ndarray,
                  gradients: np.ndarray) -> None:
    """Add what the strips' points ask: of weights to the blocks, of biases to the gradients."""
    start, block = 0, 0
    for layer in range(int(network[LAYERS])):
        reads, makes = int(network[SIZES + layer]), int(network[SIZES + layer + 1])
        correlate(deltas[layer + 1], makes, layers[layer], reads, strips, blocks, block)
        block += count_blocks(makes, reads)
        start += reads * makes
        for strip in range(strips):
            for j in range(makes):
                at = (strip * makes + j) * STRIP
                gradients[start + j] += sum_of(deltas[layer + 1][at:at + STRIP])
        start += makes


@compiled
def put_weights(network: np.ndarray, blocks: np.ndarray, gradients: np.ndarray) -> None:
    """The gradients of all weights from their blocks."""
    start, block = 0, 0
    for layer in range(int(network[LAYERS])):
        reads, makes = int(network[SIZES + layer]), int(network[SIZES + layer + 1])
        open_blocks(blocks, block, makes, reads, gradients[start:])
        block += count_blocks(makes, reads)
        start += (reads + 1) * makes


@compiled
def blocks_of(network: np.ndarray) -> int:
    total = 0
    for layer in range(int(network[LAYERS])):
        total += count_blocks(int(network[SIZES + layer + 1]), int(network[SIZES + layer]))
    return total


@compiled
def gradient_rows(y0: int, y1: int, network: np.ndarray, parameters: np.ndarray, points: np.ndarray,
                  targets: np.ndarray, partials: np.ndarray, pulls: np.ndarray) -> None:
    total, groups, last = points.shape[0], partials.shape[0], int(network[LAYERS])
    outputs, wide = targets.shape[1], widest(network) * STRIP
    share = np.float32(1 / (total * outputs))
    layers = np.empty((MOST_LAYERS + 1, STRIPS * wide), np.float32)
    deltas, spare = np.empty_like(layers), np.empty(wide, np.float32)
    blocks = np.empty(blocks_of(network) * LANES, np.float32)
    for group in range(y0, y1):
        gradients, error, learnt = partials[group], 0.0, 0
        gradients[:] = ZERO
        blocks[:] = ZERO
        first, end = group * total // groups, (group + 1) * total // groups
        while first < end:
            strips = 0
            while strips < STRIPS and first < end:
                count, size = min(STRIP, end - first), outputs * STRIP
                begin = int(network[SIZES]) * STRIP * strips
                encode(network, points, first, count, layers[0][begin:])
                run_layers(network, parameters, layers, deltas, strips)
                here = slice(strips * size, (strips + 1) * size)
                off, known = compare(layers[last][here], targets, first, count, share, deltas[last][here])
                error += off
                learnt += known
                pull_back(network, parameters, deltas, strips, spare)
                if pulls.shape[0] == total:
                    pull_inputs(network, parameters, deltas, strips, spare, pulls[first:first + count])
                first += count
                strips += 1
            add_gradients(network, layers, deltas, strips, blocks, gradients)
        put_weights(network, blocks, gradients)
        gradients[-2] = np.float32(error / (total * outputs))
        gradients[-1] = np.float32(learnt / total)


@compiled
def scale_of(partials: np.ndarray) -> Real:
    """What makes the sum of groups a mean over the points that are learnt; 0 if there are none."""
    share = ZERO
    for group in range(partials.shape[0]):
        share += partials[group, partials.shape[1] - 1]
    return ONE / share if share > ZERO else ZERO


@compiled
def adam_rows(y0: int, y1: int, partials: np.ndarray, hyper: np.ndarray, parameters: np.ndarray,
              moments: np.ndarray) -> None:
    rate, slow, slower, epsilon = hyper[0], hyper[1], hyper[2], hyper[3]
    gradients = np.zeros(y1 - y0, np.float32)
    for group in range(partials.shape[0]):
        for k in range(gradients.size):
            gradients[k] += partials[group, y0 + k]
    learnt = scale_of(partials)
    step = np.float64(moments[y0, 2]) + 1
    size = np.float32(rate / (1 - np.float64(slow) ** step))
    scale = np.float32(1 / np.sqrt(1 - np.float64(slower) ** step))
    for k in range(gradients.size):
        gradient, row = gradients[k] * learnt, moments[y0 + k]
        row[0] = slow * row[0] + (ONE - slow) * gradient
        row[1] = slower * row[1] + (ONE - slower) * gradient * gradient
        row[2] = np.float32(step)
        parameters[y0 + k] -= size * row[0] / (np.sqrt(row[1]) * scale + epsilon)


@compiled
def corner_of(grid: np.ndarray, level: int, point: np.ndarray, corner: int) -> tuple[int, Real]:
    """The entry of a corner of the cell that a point lies in, and its share."""
    entries, side = int(grid[ENTRIES]), int(grid[SIDES + level])
    is_dense = (side + 1) ** int(grid[DIMS]) <= entries
    index, step, share = 0, 1, ONE
    for axis in range(int(grid[DIMS])):
        place = min(point[axis], ONE) * np.float32(side) if point[axis] > ZERO else ZERO
        cell = min(int(place), side - 1)
        rest, bit = place - np.float32(cell), corner >> axis & 1
        share *= rest if bit else ONE - rest
        if is_dense:
            index += (cell + bit) * step
            step *= side + 1
        else:
            index ^= (cell + bit) * PRIMES[axis]
    return index & (entries - 1), share


@compiled
def grid_rows(y0: int, y1: int, grid: np.ndarray, table: np.ndarray, points: np.ndarray, rows: np.ndarray) -> None:
    dims, numbers, levels = int(grid[DIMS]), int(grid[NUMBERS]), int(grid[LEVELS])
    for p in range(y0, y1):
        rows[p, :levels * numbers] = ZERO
        for level in range(levels):
            for corner in range(1 << dims):
                index, share = corner_of(grid, level, points[p], corner)
                for k in range(numbers):
                    rows[p, level * numbers + k] += share * table[level, index * numbers + k]
        for k in range(dims, points.shape[1]):
            rows[p, levels * numbers + k - dims] = points[p, k]


@compiled
def grid_pull_rows(y0: int, y1: int, grid: np.ndarray, points: np.ndarray, pulls: np.ndarray, sums: np.ndarray) -> None:
    numbers = int(grid[NUMBERS])
    for level in range(y0, y1):
        sums[level] = 0
        for p in range(points.shape[0]):
            for corner in range(1 << int(grid[DIMS])):
                index, share = corner_of(grid, level, points[p], corner)
                for k in range(numbers):
                    pull = np.float64(share * pulls[p, level * numbers + k])
                    sums[level, index * numbers + k] += np.int64(np.rint(pull * UNITS))


@compiled
def grid_step_rows(y0: int, y1: int, sums: np.ndarray, partials: np.ndarray, hyper: np.ndarray, table: np.ndarray,
                   moments: np.ndarray) -> None:
    rate, slow, slower, epsilon = hyper[0], hyper[1], hyper[2], hyper[3]
    learnt = scale_of(partials)
    for level in range(y0, y1):
        for k in range(table.shape[1]):
            if sums[level, k] == 0:
                continue
            gradient, row = np.float32(sums[level, k] / UNITS) * learnt, moments[level, k]
            row[0] = slow * row[0] + (ONE - slow) * gradient
            row[1] = slower * row[1] + (ONE - slower) * gradient * gradient
            row[2] += ONE
            size = np.float32(rate / (1 - np.float64(slow) ** np.float64(row[2])))
            scale = np.float32(1 / np.sqrt(1 - np.float64(slower) ** np.float64(row[2])))
            table[level, k] -= size * row[0] / (np.sqrt(row[1]) * scale + epsilon)


_SHAPES: dict[str, tuple[int | str, ...]] = {
    "network": (FACTS,), "parameters": ("count",), "points": ("points", "inputs")}
FORWARD = Kernel(
    "neural_forward", ("network", "parameters", "points"), ("values",), forward_rows, ("values", 0),
    {**_SHAPES, "values": ("points", "outputs")}, blocks=Blocks(64, THREADS, 224 << 10, 132))
GRADIENTS = Kernel(
    "neural_gradients", ("network", "parameters", "points", "targets"), ("partials", "pulls"), gradient_rows,
    ("partials", 0),
    {**_SHAPES, "targets": ("points", "outputs"), "partials": ("groups", "sums"), "pulls": ("pulled", "inputs")},
    blocks=Blocks(1, THREADS, 224 << 10))
ADAM = Kernel(
    "neural_adam", ("partials", "hyper", "parameters", "moments"), ("parameters", "moments"), adam_rows,
    ("moments", 0),
    {"partials": ("groups", "sums"), "hyper": (4,), "parameters": ("count",), "moments": ("count", 3)},
    blocks=Blocks(8, THREADS))
_GRID: dict[str, tuple[int | str, ...]] = {
    "grid": (SIDES + MOST_LEVELS,), "table": ("levels", "entries"), "points": ("points", "axes"),
    "sums": ("levels", "entries"), "partials": ("groups", "parts"), "moments": ("levels", "entries", 3), "hyper": (4,)}
GRID = Kernel(
    "neural_grid", ("grid", "table", "points"), ("rows",), grid_rows, ("rows", 0),
    {**{name: _GRID[name] for name in ("grid", "table", "points")}, "rows": ("points", "inputs")})
GRID_PULL = Kernel(
    "neural_grid_pull", ("grid", "points", "pulls"), ("sums",), grid_pull_rows, ("sums", 0),
    {**{name: _GRID[name] for name in ("grid", "points", "sums")}, "pulls": ("points", "inputs")}, {"sums": "int64"},
    blocks=Blocks(1, THREADS))
GRID_STEP = Kernel(
    "neural_grid_step", ("sums", "partials", "hyper", "table", "moments"), ("table", "moments"), grid_step_rows,
    ("table", 0),
    {name: _GRID[name] for name in ("sums", "partials", "hyper", "table", "moments")}, {"sums": "int64"})
