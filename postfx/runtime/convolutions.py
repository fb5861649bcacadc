"""Networks of convolutions in half precision as a list of our own CUDA kernels, in place of ONNX
Runtime.

ONNX Runtime runs such a network as one library call a node, with copies between layouts. Here a
convolution is one kernel (postfx/kernels/convolution.cuh) with all that follows it: bias, ReLU, a
constant, the largest of 2x2 pixels. What is enlarged and added comes with its input. Two that read
the same may be one kernel: the heads of a level, and what the next finer level gets.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import accumulate
from math import prod
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple, Protocol

import numpy as np

from postfx.runtime.memory import ALIGNMENT
from postfx.runtime.model_file import ModelFile, Node, Weights, parse_model

if TYPE_CHECKING:
    from postfx.runtime.tensor import Tensor, TensorDevice

# As in the kernels: rows and columns of the pixels that a group of threads takes.
GROUP_PIXELS = (8, 8)
HEAD_GROUP_PIXELS = (2, 32)
GROUP_THREADS = 128

TILES = (160, 128, 96, 80, 64, 40, 32, 16)
"""Channels that a block of threads can make."""
CHANNEL_STEP = 32
"""All channels are multiples of it."""

GROUP_COUNTS = (4, 3, 2, 1)
"""Groups that a block may have."""
MOST_GROUPS = 12
"""Groups that are enough for a processor."""
WEIGHT_PARTS = (4, 3)
"""Parts of its weights that a block may hold at once, where it cannot hold all."""

# A GPU's memory, as CUDA says: shared memory that a block takes beside its own, registers of a
# processor, and those of a thread beside one for every two channels of its tile.
BLOCK_OVERHEAD_BYTES = 1024
PROCESSOR_REGISTERS = 65536
THREAD_REGISTERS = 48

# Times of a group on an H100: cycles that it waits for pixels, and that it writes a channel in;
# bytes that come in a cycle.
WAIT_CYCLES = 4700
CHANNEL_WRITE_CYCLES = 5.6
CYCLE_WEIGHT_BYTES = 134
CYCLE_PIXEL_BYTES = 13

ARGUMENTS = ("input", "coarse", "weights", "bias", "added", "output", "second")
"""Tensors of every kernel."""
HALF = np.dtype(np.float16)
_FLOAT = 1
_FLOAT16 = 10
_NEAREST = {"mode": "nearest", "nearest_mode": "floor",
            "coordinate_transformation_mode": "asymmetric"}


class Head(NamedTuple):
    """How an output is given after its activations, as planes in half precision.

    Attributes:
        name: of the output that it becomes.
        planes: how many there are, of all channels of a pixel or of each part.
        shares, states: the first planes of these, behind the weights of filters.
        side: pixels of a side that a pixel of the network stands for, 1 or 2; then its four parts
            are one after the other, top left first.
    """

    name: str
    planes: int
    shares: int
    states: int
    side: int = 1


class Options(ctypes.Structure):
    """Further arguments of a kernel: see postfx/kernels/convolution.cuh."""

    _fields_ = tuple((name, ctypes.c_int)
                     for name in ("height", "width", "tiles", "split", "positive"))


@dataclass
class Layer:
    """A convolution and what follows it.

    Attributes:
        source: name of what it reads, (1, h, w, C).
        weight: (channels, C, k, k) in half precision; with `cells` the stride is 2.
        bias: (channels,).
        output: name of its result.
        cells: whether it reads cells of 2x2 pixels.
        coarse: what is enlarged and added to the source, '' for nothing.
        positive: whether nothing of it is less than 0.
        added: (channels,) that are added at last.
        pooled: name of the largest of 2x2 pixels of the result, '' for none.
        others: name of what holds the channels from the `split`-th on; '' if the result holds all
            of them.
        head: how the result is given, if not as it is.
    """

    source: str
    weight: np.ndarray
    bias: np.ndarray
    output: str
    cells: bool = False
    coarse: str = ""
    positive: bool = False
    added: np.ndarray | None = None
    pooled: str = ""
    others: str = ""
    split: int = 0
    head: Head | None = None

    @property
    def taps(self) -> int:
        """Pixels, or cells, along a side that it looks at."""
        return int(self.weight.shape[2]) // (1 + self.cells)

    @property
    def channels(self) -> int:
        """Channels that it makes."""
        return int(self.weight.shape[0])

    @property
    def read(self) -> int:
        """Channels of a pixel, or of a cell, that it reads."""
        return int(self.weight.shape[1]) * (1 + 3 * self.cells)

    @property
    def tiles(self) -> tuple[int, ...]:
        """Numbers of channels that a block of threads may make, the largest first."""
        # all planes of the two pixels of a row, or half of them
        if self.head and self.head.side == 2:
            return tuple(tile for tile in TILES
                         if tile in (2 * self.head.planes, self.head.planes) and tile % 16 == 0)
        least = self.head.planes if self.head else 0  # they are in the first tile
        return tuple(tile for tile in TILES if self.channels % tile == 0 and tile >= least)

    def give(self, head: Head) -> bool:
        """Give the result in this form; whether the kernels can."""
        if self.positive or self.added is not None:
            return False
        if head.side == 2:
            of_a_row = 2 * head.planes
            can = (self.channels == 2 * of_a_row and of_a_row in TILES
                   and of_a_row % CHANNEL_STEP == 0)
        else:
            can = head.planes <= self.channels
        if can:
            self.head = head
        return can

    def factors(self, tile: int) -> tuple[np.ndarray, np.ndarray]:
        """The weights and the bias in the order of the kernels: (tiles, steps, 4, tile, 8), tap by
        tap; (channels,)."""
        count, side, order = self.channels, self.taps, np.arange(self.channels)
        # rows, and of the planes of their two pixels a tile's half
        if self.head and self.head.side == 2:
            order = order.reshape(2, 2, -1, tile // 2).transpose(0, 2, 1, 3).reshape(-1)
        weight = self.weight[order]
        if self.cells:  # the channels of a cell: its rows, their pixels, their channels
            parts = weight.reshape(count, -1, side, 2, side, 2).transpose(2, 4, 3, 5, 1, 0)
        else:
            parts = weight.transpose(2, 3, 1, 0)
        steps = parts.reshape(-1, CHANNEL_STEP // 8, 8, count // tile, tile)
        return np.ascontiguousarray(steps.transpose(3, 0, 1, 4, 2), HALF), self.bias[order]


class Unfit(ValueError):
    """The network has something that the kernels do not compute."""


def read_layers(content: bytes, folder: Path) -> list[Layer]:
    """The layers of a network in the order in which they run. Raises Unfit where it is not made of
    such layers only.

    Args:
        content: of the model, which has been checked.
        folder: where files are that it has weights in.
    """
    return _join(_Reader(parse_model(content), folder).layers())


class _Reader:
    """Follows the nodes of a model: what is not part of a layer yet waits under the name of its
    result."""

    def __init__(self, model: ModelFile, folder: Path) -> None:
        self._model, self._folder = model, folder
        self._weights = {weights.name: weights for weights in model.weights}
        self._uses: dict[str, int] = {}
        for node in model.nodes:
            for name in node.inputs:
                self._uses[name] = self._uses.get(name, 0) + 1
        self._layers: dict[str, Layer] = {}  # by their result's name so far
        self._same: dict[str, str] = {}  # inputs by their name with channels first
        self._given: set[str] = set()  # outputs with channels last
        self._enlarged: dict[str, str] = {}
        self._sums: dict[str, tuple[str, str]] = {}

    def layers(self) -> list[Layer]:
        """All layers of the model; Unfit where one of its nodes is no part of a layer."""
        steps: dict[str, Callable[[Node], None]] = {
            "Transpose": self._transpose, "Conv": self._convolve, "Relu": self._bound,
            "MaxPool": self._pool, "Resize": self._enlarge, "Add": self._add}
        for node in self._model.nodes:
            if node.domain or node.operator not in steps or len(node.outputs) != 1:
                raise Unfit(f"it has {node.operator}")
            steps[node.operator](node)
        if any(layer.channels % CHANNEL_STEP or layer.read % CHANNEL_STEP
               for layer in self._layers.values()):
            raise Unfit(f"it has channels that are no multiples of {CHANNEL_STEP}")
        found = list(self._layers.values())
        if {value.name for value in self._model.outputs} != self._given:
            raise Unfit("it has outputs that no convolution makes, or channels first")
        known = ({name for layer in found for name in (layer.output, layer.pooled)}
                 | set(self._same.values()))
        if not {name for layer in found for name in (layer.source, layer.coarse)} <= known | {""}:
            raise Unfit("it reads channels first, or what comes before an activation")
        return found

    def _transpose(self, node: Node) -> None:
        source, result, order = node.inputs[0], node.outputs[0], node.integers.get("perm")
        if order == (0, 2, 3, 1) and source in self._layers and self._uses[source] == 1:
            self._rename(source, result)
            self._given.add(result)
        elif order == (0, 3, 1, 2) and source in {value.name for value in self._model.inputs}:
            self._same[result] = source
        else:
            raise Unfit("it moves axes")

    def _convolve(self, node: Node) -> None:
        """Begin a layer."""
        weight, ints = self._array(node.inputs[1]), node.integers
        if weight.ndim != 4:
            raise Unfit("it has convolutions along one axis, or three")
        side = weight.shape[2]
        shape = (ints.get("strides", (1, 1))[0], ints.get("pads", (0,) * 4)[0])
        known = {(1, 1, 0): False, (3, 1, 1): False, (2, 2, 0): True, (4, 2, 1): True}
        plain = (ints.get("group", (1,)), set(ints.get("dilations", (1,))),
                 len(set(ints.get("pads", (0,)))), len(set(ints.get("strides", (1,)))),
                 weight.shape[3], node.words.get("auto_pad", "NOTSET"))
        if ((side, *shape) not in known or plain != ((1,), {1}, 1, 1, side, "NOTSET")
            or len(node.inputs) != 3):
            raise Unfit("it has other convolutions")
        source, coarse = self._sums.get(node.inputs[0], (node.inputs[0], ""))
        layer = Layer(self._same.get(source, source), weight,
                      self._array(node.inputs[2]).astype(np.float32),
                      node.outputs[0], known[side, *shape], coarse)
        if coarse and layer.cells:
            raise Unfit("it adds to an input")
        self._layers[layer.output] = layer

    def _bound(self, node: Node) -> None:
        layer = self._last(node)
        if layer.positive or layer.added is not None:
            raise Unfit("it has two activations")
        layer.positive = True
        self._rename(node.inputs[0], node.outputs[0])

    def _pool(self, node: Node) -> None:
        layer, ints = self._layers.get(node.inputs[0]), node.integers
        shape = tuple(ints.get(name, (standard,)) for name, standard in
                      (("kernel_shape", 1), ("strides", 1), ("dilations", 1), ("pads", 0),
                       ("ceil_mode", 0)))
        if (layer is None or layer.pooled
            or [set(part) for part in shape] != [{2}, {2}, {1}, {0}, {0}]):
            raise Unfit("it pools otherwise")
        layer.pooled = node.outputs[0]

    def _enlarge(self, node: Node) -> None:
        scale = self._array(node.inputs[2], _FLOAT) if len(node.inputs) > 2 else np.empty(0)
        if (scale.tolist() != [1, 1, 2, 2]
            or {name: node.words.get(name) for name in _NEAREST} != _NEAREST):
            raise Unfit("it resizes otherwise")
        self._enlarged[node.outputs[0]] = node.inputs[0]

    def _add(self, node: Node) -> None:
        """Add constants to a layer's result, or the enlarged result of a coarser one."""
        first, second = node.inputs
        if second in self._weights and first in self._layers and self._uses[first] == 1:
            layer = self._layers[first]
            if layer.added is not None or layer.pooled:
                raise Unfit("it adds otherwise")
            layer.added = self._array(second).astype(np.float32).reshape(-1)
            if len(layer.added) != layer.channels:
                raise Unfit("it adds other constants")
            self._rename(first, node.outputs[0])
        elif second in self._enlarged and first in self._layers:
            self._sums[node.outputs[0]] = first, self._enlarged[second]
        else:
            raise Unfit("it adds otherwise")

    def _last(self, node: Node) -> Layer:
        """The layer that a node goes on with."""
        layer = self._layers.get(node.inputs[0])
        if layer is None or layer.pooled or self._uses[node.inputs[0]] != 1:
            raise Unfit(f"its {node.operator} follows no convolution")
        return layer

    def _rename(self, old: str, new: str) -> None:
        layer = self._layers.pop(old)
        layer.output = new
        self._layers[new] = layer

    def _array(self, name: str, kind_number: int = _FLOAT16) -> np.ndarray:
        weights = self._weights.get(name)
        if weights is None or weights.kind != kind_number or not (weights.raw or weights.external):
            raise Unfit("its weights are not in half precision")
        kind = HALF if kind_number == _FLOAT16 else np.dtype(np.float32)
        return np.frombuffer(self._bytes(weights, kind), kind).reshape(weights.dims)

    def _bytes(self, weights: Weights, kind: np.dtype) -> bytes | memoryview:
        if weights.external is None:
            return weights.content
        with (self._folder / weights.external["location"]).open("rb") as file:
            file.seek(int(weights.external.get("offset", 0)))
            return file.read(int(np.prod(weights.dims)) * kind.itemsize)


def _join(layers: list[Layer]) -> list[Layer]:
    """Layers of one pixel that read the same become one, where one of them is enlarged afterwards:
    its result comes last."""
    coarse = {layer.coarse for layer in layers}
    plain = [layer for layer in layers
             if layer.taps == 1 and not (layer.cells or layer.positive)]
    enlarged = {layer.output for layer in plain if layer.output in coarse}
    partners = {layer.source: layer for layer in plain if layer.output not in coarse}
    joined = list[Layer]()
    for layer in layers:
        other = partners.get(layer.source) if layer.output in enlarged else None
        if other is not None:
            weight = np.concatenate((other.weight, layer.weight))
            bias = np.concatenate((other.bias, layer.bias))
            layer = Layer(layer.source, weight, bias, other.output, others=layer.output,
                          split=other.channels)
        joined.append(layer)
    taken = {layer.output for layer in joined if layer.others}
    return [layer for layer in joined if layer.others or layer.output not in taken]


def give_heads(layers: Sequence[Layer], shapes: Mapping[str, tuple[int, ...]],
               heads: Mapping[str, Head]) -> tuple[dict[str, tuple[int, ...]], dict[str, str]]:
    """Give results as these heads, by the names of outputs, where the kernels can: the shapes of
    inputs and outputs then, and the new names of those that have one."""
    found, names = dict(shapes), dict[str, str]()
    for layer in layers:
        if (head := heads.get(layer.output)) and layer.give(head):
            _, rows, columns, _ = found.pop(layer.output)
            found[head.name] = (1, head.planes, head.side * rows, head.side * columns)
            names[layer.output], layer.output = head.name, head.name
    return found, names


@dataclass(frozen=True)
class Launch:
    """A layer with a result of some size, and how blocks of threads share the work.

    Attributes:
        tile: channels of a block.
        groups: how many groups of threads a block has, each of which takes 64 pixels at a time.
        held: blocks that a processor holds at once.
        slots: parts of its weights that a block holds at once, half of a tap's each; 0 for all of
            them.
    """

    layer: Layer
    rows: int
    columns: int
    tile: int
    groups: int = 1
    held: int = 1
    slots: int = 0

    @property
    def squares(self) -> int:
        """How many squares of a group's pixels cover the result."""
        rows, columns = HEAD_GROUP_PIXELS if self.layer.head else GROUP_PIXELS
        return -(-self.rows // rows) * -(-self.columns // columns)

    @property
    def tiles(self) -> int:
        """Blocks that share the channels of a pixel."""
        return self.layer.channels // self.tile

    @property
    def given(self) -> tuple[int, ...]:
        """Numbers that the kernel is compiled for."""
        layer, head = self.layer, self.layer.head or Head("", 0, 0, 0, 0)
        return (layer.taps, int(layer.cells), int(bool(layer.coarse)), layer.read, self.tile,
                self.slots, head.side, *head[1:4])

    @property
    def name(self) -> str:
        """Name of the kernel."""
        return "_".join(map(str, ("convolve", self.groups, *self.given)))

    @property
    def source(self) -> str:
        """Source of the kernel, to follow postfx/kernels/convolution.cuh."""
        return (f'\nextern "C" __global__ void __launch_bounds__({self.groups * GROUP_THREADS}, '
                f'{self.held}) {self.name}({", ".join(f"View {name}" for name in ARGUMENTS)}, '
                'Options options) {\n'
                f'    convolve<{", ".join(map(str, self.given))}>({", ".join(ARGUMENTS)}, '
                'options);\n}\n')

    @property
    def factors(self) -> int:
        """Numbers that a result is a sum of products with."""
        return self.layer.taps**2 * self.layer.read

    @property
    def square(self) -> int:
        """Bytes of a square of the input with its border."""
        side = GROUP_PIXELS[0] + self.layer.taps - 1
        return self.layer.read * 2 * (side**2 + {1: 1, 2: 0, 3: 5}[self.layer.taps])

    @property
    def shared(self) -> int:
        """Bytes of shared memory of a block: weights, and for each group a square."""
        weights = (self.slots * (self.layer.read * self.tile + 16) if self.slots
                   else 2 * self.factors * self.tile)
        return weights + self.groups * self.square


class Gpu(Protocol):
    """The GPU that runs the kernels.

    Attributes:
        most_shared: bytes of shared memory that a block of threads may have.
        processors: how many run blocks at once.
        warpgroups: whether the warps of a group multiply together.
    """

    @property
    def most_shared(self) -> int: ...

    @property
    def processors(self) -> int: ...

    @property
    def warpgroups(self) -> bool: ...

    def convolution(self, launch: Launch, kernels: str, tensors: Sequence[Tensor | None],
                    options: Options) -> Callable[[], None]:
        """A function that launches one of the kernels on tensors, in the order of `ARGUMENTS`."""
        ...


def choices(layer: Layer, rows: int, columns: int, gpu: Gpu) -> list[Launch]:
    """How the work on a result of this size can be shared, the fastest first, by `_cycles`.

    Raises Unfit where all need more shared memory than there is.
    """
    tiles = [tile for tile in layer.tiles if gpu.warpgroups or tile % 16 == 0]
    parts = WEIGHT_PARTS if gpu.warpgroups and layer.taps > 1 else ()
    found = list[Launch]()
    for tile in tiles:
        launches = [*_launches(Launch(layer, rows, columns, tile), gpu)]
        if not launches:  # else all its weights can stay
            launches = [launch for slots in parts
                        for launch in _launches(Launch(layer, rows, columns, tile, slots=slots),
                                                gpu)]
        found += launches
    if not found:
        raise Unfit(f"a layer needs more than the {gpu.most_shared} bytes of shared memory that "
                    "there are")
    return sorted(found, key=lambda launch: _cycles(launch, gpu))


def _launches(launch: Launch, gpu: Gpu) -> Iterator[Launch]:
    """A launch with blocks of each count of groups that a processor can hold."""
    for groups in GROUP_COUNTS:
        tried = replace(launch, groups=groups)
        by_memory = ((gpu.most_shared + BLOCK_OVERHEAD_BYTES)
                     // (tried.shared + BLOCK_OVERHEAD_BYTES))
        registers = groups * GROUP_THREADS * (THREAD_REGISTERS + launch.tile // 2)
        held = min(by_memory, PROCESSOR_REGISTERS // registers, MOST_GROUPS // groups)
        # several blocks of one group would each hold the weights
        if held == 1 or (held and groups > 1):
            yield replace(tried, held=held)


def _cycles(launch: Launch, gpu: Gpu) -> float:
    """About how long a launch takes, fitted to what layers of these networks take on an H100, to 14
    %.

    Groups of a processor multiply one after the other: 64 pixels and 16 factors take half a cycle a
    channel, without warpgroups one and 16. Each round of groups waits for its first pixels. A
    block's weights come once, or in parts for each round.
    """
    tile, tasks = launch.tile, launch.squares * launch.tiles
    blocks = -(-launch.squares // launch.groups) * launch.tiles
    held = min(launch.held, -(-blocks // gpu.processors))  # blocks of a processor
    groups = held * launch.groups
    rounds = -(-tasks // (gpu.processors * groups))
    product = launch.factors // 16 * (tile / 2 if gpu.warpgroups else 16 + tile)
    writing = CHANNEL_WRITE_CYCLES * tile
    reading = launch.square / CYCLE_PIXEL_BYTES
    weights = held * 2 * launch.factors * tile / CYCLE_WEIGHT_BYTES
    if launch.slots:
        weights *= rounds
    return weights + rounds * (WAIT_CYCLES + groups * (product + writing + reading))


def multiply_source(tile: int) -> str:
    """Products of a warpgroup for so many channels, for postfx/kernels/convolution.cuh."""
    count = tile // 2
    sums = ", ".join(f'"+f"(sums[{i}])' for i in range(count))
    left = ", ".join(f'"r"(left[{i}])' for i in range(4))
    places = [f"%{i}" for i in range(count + 5)]
    given = (f'{{{", ".join(places[:count])}}}, {{{", ".join(places[count:-1])}}}, {places[-1]}, '
             '1, 1, 1, 0;')
    return (f"\ntemplate <> __device__ inline void multiply<{count}>("
            f"float (&sums)[{count}], const Two (&left)[4], Matrices right) {{\n"
            f'    asm volatile("wgmma.mma_async.sync.aligned.m64n{tile}k16.f32.f16.f16 {given}" '
            f': {sums} : {left}, '
            '"l"(right) : "memory");\n}\n')


def _whole(shape: tuple[int, ...]) -> int:
    """Bytes of values in half precision, up to where others may begin."""
    return -(-prod(shape) * HALF.itemsize // ALIGNMENT) * ALIGNMENT


class Convolutions:
    """A network's layers on a GPU, with their weights and intermediate results.

    Args:
        shapes: of the network's inputs and outputs, by name.

    Raises Unfit where the GPU has too little shared memory for a layer.
    """

    def __init__(self, layers: Sequence[Layer], device: TensorDevice, gpu: Gpu,
                 shapes: Mapping[str, tuple[int, ...]]) -> None:
        if any(len(shape) != 4 or shape[0] != 1 for shape in shapes.values()):
            raise Unfit("it works on several pictures at once")
        self._gpu = gpu
        self._device = device
        self._between: dict[str, tuple[int, ...]] = {}
        self._own: dict[str, Tensor] = {}
        sizes = {name: shape[1:3] for name, shape in shapes.items()}
        self._launches: list[Launch] = []
        for layer in layers:
            rows, columns = (side // (1 + layer.cells) for side in sizes[layer.source])
            sizes |= dict.fromkeys((layer.output, layer.others), (rows, columns))
            sizes[layer.pooled] = rows // 2, columns // 2
            for name, channels in ((layer.output, layer.split or layer.channels),
                                   (layer.pooled, layer.channels),
                                   (layer.others, layer.channels - layer.split)):
                if name and name not in shapes:
                    self._between[name] = 1, *sizes[name], channels
            self._launches.append(choices(layer, rows, columns, gpu)[0])
        tiles = sorted({launch.tile for launch in self._launches if gpu.warpgroups})
        products = "".join(map(multiply_source, tiles))
        self._source = products + "".join(dict.fromkeys(launch.source for launch in self._launches))
        self._given = [self._upload(device, launch) for launch in self._launches]

    def _upload(self, device: TensorDevice, launch: Launch) -> dict[str, Tensor]:
        layer = launch.layer
        arrays = dict(zip(("weights", "bias"), layer.factors(launch.tile), strict=True))
        if layer.added is not None:
            arrays["added"] = layer.added
        found = {}
        for name, array in arrays.items():
            found[name] = device.heap.tensor(name, array.shape, array.dtype.name)
            found[name].upload(array)
        return found

    @property
    def intermediates_size(self) -> int:
        """Bytes of what layers compute for later ones."""
        return sum(_whole(shape) for shape in self._between.values())

    def _intermediates(self, memory: Tensor | None) -> dict[str, Tensor]:
        """Tensors for them: in this memory, or of its own, which is kept."""
        if memory is not None:
            starts = accumulate(map(_whole, self._between.values()), initial=0)
            return {name: memory.view(name, shape, start // HALF.itemsize)
                    for (name, shape), start in zip(self._between.items(), starts, strict=False)}
        if not self._own:
            self._own = {name: self._device.heap.tensor(name, shape, "float16")
                         for name, shape in self._between.items()}
        return self._own

    def bind(self, tensors: Mapping[str, Tensor],
             memory: Tensor | None = None) -> Callable[[], None]:
        """A function that runs the network on these inputs and outputs, and in this memory in
        between."""
        known, runs = {**self._intermediates(memory), **tensors}, list[Callable[[], None]]()
        for launch, given in zip(self._launches, self._given, strict=True):
            layer = launch.layer
            named = {"input": layer.source, "coarse": layer.coarse, "output": layer.output,
                     "second": layer.others or layer.pooled}
            used = given | {name: known[other] for name, other in named.items() if other}
            options = Options(launch.rows, launch.columns, launch.tiles, layer.split,
                              layer.positive)
            runs.append(self._gpu.convolution(launch, self._source,
                                              [used.get(name) for name in ARGUMENTS], options))

        def run() -> None:
            for launch in runs:
                launch()

        return run
