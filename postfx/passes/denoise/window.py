"""One window of a frame: the networks for windows of one size, and the buffers between the steps of
`graph` that run on a window."""

from __future__ import annotations

import math
from collections import ChainMap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache, cached_property, partial
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from postfx.caching import LRUCache
from postfx.kernels.denoise import FINE, IN_HALF, MIX, TRUST_CELL
from postfx.kernels.denoise.classic import STEPS
from postfx.kernels.denoise.features import FEATURE
from postfx.kernels.denoise.network_io import SOME
from postfx.kernels.denoise.prepare import means_size
from postfx.passes.denoise.geometry import PYRAMID_LEVELS, Band, Rows, Window, rows_of
from postfx.passes.denoise.graph import (
    ALPHA,
    BEFORE_ENLARGING,
    CLASSIC_STEPS,
    ENLARGING,
    LAYER_STEPS,
    NO_WORDS,
    OVER_NOTHING,
    PYRAMID,
    SOMETIMES,
    WINDOW_STEPS,
    Each,
    Over,
    Table,
    kernels_of,
    run_steps,
    shapes_of,
)
from postfx.passes.denoise.history import ALPHA_LAYER, alone, one_of, some_of
from postfx.passes.denoise.models import CLASSIC, doubts_planes, load_network
from postfx.passes.denoise.network import (
    CONTROLS_NAME,
    ERROR,
    PICTURE,
    PRODUCTS,
    Network,
    alike_heads,
    check_bindings,
    free_dimensions,
    heads_of,
    is_half,
    seen_by,
    upload,
)
from postfx.runtime import CommandBuffer, Device, PipelineState, Tensor

# Words for what ends a window.
PLAIN = "plain"
GUIDES_KIND = "guides"
UNSCALED_KIND = "unscaled"
GIVEN = "given"
MOST_PLACES = 64
"""Windows of one size whose positions stay on the device."""
TOGETHER = 3
"""Layers that are filtered at once. Filter weights are then read from memory once for all of them,
but the intermediate results of each take memory."""
THE_PICTURE = ""
"""In `Targets`, in place of a layer's name."""

Targets = Mapping[str, Mapping[str, Tensor]]
"""What windows write: by layer, and by binding."""


class FrameWork(NamedTuple):
    """The work that one frame needs.

    Attributes:
        model: name of the network that runs.
        params: exposure, jitter and gain, float32 (4,), see `postfx.kernels.denoise`.
        keep: whether the history goes on.
        still: whether everything is where it was in the last frame.
        cells: active cells, (rows, columns) of bool; None for all.
        band: the windows that are worked on; None for the whole frame.
        wider: whether light is converted to wider primaries.
        camera: parameters for the motion of reflections, float32 (27,); None if reflections move
            with their surfaces.
        filter_stddev: standard deviation, in pixels, of the pixel filter that is undone; 0 for
            none.
    """

    model: str
    params: np.ndarray
    keep: bool
    still: bool
    cells: np.ndarray | None
    band: Band | None
    wider: bool
    camera: np.ndarray | None
    filter_stddev: float = 0.0


@dataclass
class FilteredLayer:
    """A layer beside the picture that a window's filters run on.

    Attributes:
        name: of the layer. The filters write its 'light', and its 'next_part' unless it is the
            picture itself.
        tensors: what the filters read of this frame, by binding. Without a 'part' they enlarge the
            picture's radiance once more; without albedos the part has the picture's reflectance.
        alone: whether it has no history in this frame, even if the picture has one.
        last: the stack (n, height, width, 3) that holds its last output.
        stack: the stack that its output goes to, if the window is the whole frame.
        place: its place in both stacks.
    """

    name: str
    tensors: dict[str, Tensor]
    alone: bool
    last: Tensor
    stack: Tensor
    place: int

    def follows(self, other: FilteredLayer) -> bool:
        """Whether it can be filtered together with another layer, as the next one in a stack."""
        alike = self.alone == other.alone and "part" in self.tensors and "part" in other.tensors
        return alike and self.stack is other.stack and self.place == other.place + 1


class Way(NamedTuple):
    """How one model makes pictures of windows: by a network, or by the classical filter.

    Attributes:
        steps: the table of steps.
        words: words of `graph` that hold in every frame.
        may: words that hold in some frames.
        half: whether heads and features are in half precision.
        buffers: tensors between the steps, by name; the network's heads as 'head NAME'.
        over: the things that steps run over.
    """

    steps: Table
    words: frozenset[str] = NO_WORDS
    may: frozenset[str] = NO_WORDS
    half: bool = False
    buffers: Mapping[str, Tensor] = MappingProxyType({})
    over: Over = OVER_NOTHING


class WindowGraph:
    """The networks, and the buffers between the steps, for windows of one size.

    Args:
        window: any window of the size.
        models: names of the networks.
        guided: whether they read guides.
        reactive: whether frames may have masks of how much of the history counts.
        whole: whether the fine head is kept as a whole, because layers are filtered with it, too.
    """

    def __init__(self, device: Device, window: Window, models: Sequence[str], guided: bool = False,
                 reactive: bool = False, whole: bool = False) -> None:
        self._device, self._window, self._guided, self._whole = device, window, guided, whole
        dims = free_dimensions(window.padded_size)
        states = {model: load_network(device, model, dims) for model in models if model != CLASSIC}
        for state in states.values():
            check_bindings(state)
        self._places: LRUCache[Window, dict[str, Tensor]] = LRUCache(MOST_PLACES)
        self._places_of_rows: LRUCache[tuple[Window, int], Tensor] = LRUCache(MOST_PLACES)
        self._clear = device.host_state("clear", (), ("state", "history", "output"), _clear)
        self._may = SOMETIMES - (NO_WORDS if reactive else {"masked"})
        new = device.heap.transient
        between = self._between = cache(new)  # of several networks only one runs in a frame
        seen = {name: shape for state in states.values() for name, shape in seen_by(state).items()}
        read = {name: new(name, shape) for name, shape in seen.items()}
        read |= {name: between(name, state.shapes[name], "float16")
                 for state in states.values() if is_half(state)
                 for name in IN_HALF[FEATURE].writes if name in state.shapes}
        self._ways = {model: self._way_of(state, doubts_planes(model), read)
                      for model, state in states.items()}
        if CLASSIC in models:
            self._ways[CLASSIC] = self._classic_way()
        for way in self._ways.values():
            device.make_ready(*kernels_of(way.steps, way.words | way.may, way.over, way.half))
        self._gpu_words = frozenset({"gpu"} if device.gpu else ())
        self._layer_buffers: dict[int, dict[str, Tensor]] = {}

    def encode(self, commands: CommandBuffer, window: Window, model: str,
               tensors: Mapping[str, Tensor], targets: Targets, now: frozenset[str],
               layers: Sequence[FilteredLayer] = (), lasting: Rows | None = None) -> None:
        """Record the work on a window of this graph's size.

        Args:
            tensors: the frame's planes, its history and whatever exists once a frame, by the
                kernels' names.
            targets: tensors to write. The expected error is written if it is among them.
            now: words that hold in this frame. 'moves': the last output is warped to this frame;
                without it, it is read as it is, because it is in place already or does not matter.
                'masked': the reactive masks of this frame and the last say how much of the history
                each pixel keeps; without it, one number says it for all.
            layers: what is filtered beside the picture.
            lasting: rows that leave a history; None for all. Where kernels run by rows, only these
                are enlarged. Networks that give the picture or read guides see farther, and enlarge
                all rows.
        """
        picture, way = targets[THE_PICTURE], self._ways[model]
        words = way.words | now | frozenset({ERROR} & picture.keys())
        own = {} if "masked" in now else {"keep": tensors["keep"]}
        own |= {} if "moves" in now else {"warped": tensors["history"]}
        buffers = ChainMap(own, self._place(window), dict(picture), dict(way.buffers),
                           dict(tensors))
        near = PLAIN in words or UNSCALED_KIND in words
        if near and self._device.runs_rows and lasting not in (None, (0, self._window.rows)):
            run_steps(commands, BEFORE_ENLARGING, buffers, words, way.over, way.half)
            some = buffers.new_child(self._of_rows(window, lasting, buffers))
            run_steps(commands, ENLARGING, some, words, way.over, way.half)
            self._clear_beside(commands, window, lasting, picture)
        else:
            run_steps(commands, way.steps, buffers, words, way.over, way.half)
        at_once = window == Window.whole(window.frame) and not self._device.scratch
        for group in _together(layers, TOGETHER if at_once else 1):
            self._encode_layers(commands, group, way, buffers, targets)

    def _of_rows(self, window: Window, rows: Rows,
                 buffers: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """Buffers to enlarge these rows alone: these rows of what has the output's size, and their
        place."""
        first, last = window.out_rows_of(rows)
        sized = {name: rows_of(buffers[name], (first, last))
                 for name in ("warped", "output", "next_history")}
        place = self._places_of_rows.get_or_make((window, first), lambda: upload(
            self._device.heap, "window", window.place(first)))
        return {**sized, "window": place}

    def _clear_beside(self, commands: CommandBuffer, window: Window, rows: Rows,
                      picture: Mapping[str, Tensor]) -> None:
        """Record the work that clears what a window would write beside some rows. The history
        begins a pixel within these rows: the output pixels around a known one must be known,
        too."""
        for first, last in ((0, rows[0]), (rows[1], self._window.rows)):
            if first < last:
                known = max(0, first - 1), min(self._window.rows, last + 1)
                out = window.out_rows_of((first, last))
                commands.run(self._clear, "upsample", state=rows_of(picture["next_state"], known),
                             history=rows_of(picture["next_history"], out),
                             output=rows_of(picture["output"], out))

    def _encode_layers(self, commands: CommandBuffer, layers: Sequence[FilteredLayer], way: Way,
                       buffers: ChainMap[str, Tensor], targets: Targets) -> None:
        """Record the work on layers that are filtered at once, after the picture's."""
        first, words = layers[0], self._gpu_words
        light = targets[first.name]["light"]
        seen = buffers.new_child({**(self._nothing if first.alone else {}), **first.tensors})
        if first.name == ALPHA_LAYER:
            own = self._layers_of(1, 1) | {"enlarged": light}
            run_steps(commands, ALPHA, seen.new_child(own), words, half=way.half)
            return
        own = dict(self._layers_of(len(layers), 3))
        own["last"] = some_of(first.last, first.place, len(layers))
        own["light"] = alone(light)
        if len(layers) > 1:
            own["light"] = some_of(first.stack, first.place, len(layers))
        shares = []
        if "part" in first.tensors:
            words |= {"filtered"}
            shares = [_share(layer, i, own, targets[layer.name]["next_part"],
                             way.buffers["factor"]) for i, layer in enumerate(layers)]
        else:
            own["radiance"] = _shaded(way.buffers["radiance"])
        run_steps(commands, LAYER_STEPS, seen.new_child(own), words, {"layers": shares}, way.half)

    def _way_of(self, state: PipelineState, doubts: bool, read: Mapping[str, Tensor]) -> Way:
        """The way through a network, which reads some tensors."""
        half = is_half(state)
        coded = bool(state.products) and not (half or self._whole)
        heads, end = self._heads_of(state, half, coded), self._end_of(state, doubts)
        network = Network(state, read, heads, self._between)
        holding = {end: True, "guided": self._guided, "mirrored": "mirrored" in seen_by(state),
                   "doubts": doubts, "stored": bool(network.stored), "coded": coded,
                   "gpu": bool(self._device.gpu),
                   "shaded": bool(self._device.gpu) and end == PLAIN}
        words = frozenset(word for word, holds in holding.items() if holds)
        may = self._may if ERROR in heads else self._may - {ERROR}
        accumulated = self._between("level 0", (4, *self._window.level(0)))
        size, light = accumulated.shape[1:], 3
        buffers = {"means": self._no_means, **self._written(WINDOW_STEPS, words | may), **read,
                   "level 0": accumulated,
                   "pool 0": accumulated.view("light 0", (light, *size)),
                   "importance 0": accumulated.view("importance 0", (1, *size),
                                                    light * math.prod(size)),
                   "fine": heads["fine"],
                   **{f"head {name}": head for name, head in heads.items()},
                   **network.coded, **network.stored}
        return Way(WINDOW_STEPS, words, may, half, buffers, network.over)

    def _classic_way(self) -> Way:
        """The way through the classical filter."""
        may = self._may - {ERROR}
        distances = {f"step {far}": upload(self._device.heap, "step", np.full(1, far, np.float32))
                     for far in STEPS}
        return Way(CLASSIC_STEPS, may=may,
                   buffers=distances | self._written(CLASSIC_STEPS, may))

    def _written(self, steps: Table, words: frozenset[str]) -> dict[str, Tensor]:
        """The buffers that steps write where at most these words hold. Some are the frame's own
        targets: those made here in their place are never used, and take no memory."""
        return {name: self._between(name, shape)
                for name, shape in shapes_of(steps, self._sizes, words).items()}

    def _sizes(self, level: int, planes: int = 3) -> dict[str, int]:
        """Values of the symbols in shapes of kernels, at a level of the pyramid."""
        window, out = self._window, self._window.out
        sides = {
            "t": (window.rows, window.columns),
            "out_t": (out.rows, out.columns),
            "padded_": (window.rows + 2, window.columns + 2),
            "cells_": [-(-side // TRUST_CELL) for side in (window.rows, window.columns)],
            "means_": means_size(window.rows, window.columns),
            **{f"level{i}_": window.level(i) for i in range(1, PYRAMID_LEVELS + 1)}}
        found = {f"{name}{side}": size for name, sizes in sides.items()
                 for side, size in zip("hw", sizes, strict=True)}
        rows, columns = window.level(level)
        return found | {"hp": rows, "wp": columns, "half_hp": rows // 2, "half_wp": columns // 2,
                        "planes": planes}

    def _end_of(self, state: PipelineState, doubts: bool) -> str:
        unscaled = self._window.frame.render == self._window.frame.output
        if PICTURE in heads_of(state):
            return GIVEN
        if self._guided:
            return GUIDES_KIND
        return UNSCALED_KIND if unscaled and doubts else PLAIN

    def _heads_of(self, network: PipelineState, half: bool,
                  coded: bool) -> dict[str, Tensor]:
        """The heads that the filters read, by name. Levels that the network does not compute have
        constant ones. A fine head that is `coded` is made row by row in the kernels that read it,
        so only its last channels lie in memory."""
        shapes, products = heads_of(network), f"{PRODUCTS}fine"
        dtype = "float16" if half else "float32"
        if coded:
            shapes["fine"] = (1, FINE - MIX, *shapes["fine"][2:])
        heads = {name: self._between(name, shape, dtype) for name, shape in shapes.items()}
        if products in network.shapes and self._device.runs_rows:
            behind = SOME * math.prod(shapes["fine"][2:])
            both = self._between("fine and its products", (behind + math.prod(shapes["fine"]),))
            heads |= {"fine": both.view("fine", shapes["fine"]),
                      products: both.view(products, network.shapes[products], behind, "int32")}
        if PICTURE in heads:
            heads["fine"] = heads[CONTROLS_NAME]
        for name, values in alike_heads(network).items():
            size = (1, values.shape[1], *self._window.level(int(name[-1])))
            heads[name] = upload(self._device.heap, name,
                                 np.broadcast_to(values, size).astype(dtype), dtype)
        return heads

    def _layers_of(self, count: int, channels: int) -> dict[str, Tensor]:
        """Buffers for so many layers of 1 channel (alpha) or 3 (light), made when so many are first
        filtered at once."""
        planes = count * channels
        if planes not in self._layer_buffers:
            new, sizes = self._device.heap.transient, partial(self._sizes, planes=planes)
            shapes = shapes_of({"pyramid": PYRAMID}, sizes, self._gpu_words)
            made = self._layer_buffers[planes] = {
                name: new(name, shape) for name, shape in shapes.items()
                if not name.startswith("importance")}  # which is the picture's
            made["pool 0"] = new("level of layers", (planes, *self._window.level(0)))
            if channels == 3:
                rows, columns = self._window.rows, self._window.columns
                made["radiance"] = new("radiance of parts", (planes, rows + 2, columns + 2))
                made["factor"] = new("factors of parts", (count, rows, columns, 3))
        return self._layer_buffers[planes]

    @cached_property
    def _nothing(self) -> dict[str, Tensor]:
        """Stands in for the history of layers that have none."""
        size = self._window.rows, self._window.columns
        arrays = {"past": np.zeros((*size, 4), np.float32),
                  "keep": np.zeros((1, 1, 1), np.float32)}
        return {name: upload(self._device.heap, f"no {name}", array)
                for name, array in arrays.items()}

    @cached_property
    def _no_means(self) -> Tensor:
        """Stands in for the mean reflectance, where planes are not doubted."""
        return upload(self._device.heap, "no means", np.zeros((1, 1, 3), np.float32))

    def _place(self, window: Window) -> dict[str, Tensor]:
        """Tensors that describe a window to the kernels, by buffer: see `Window.places`."""
        return self._places.get_or_make(window, lambda: {
            name: upload(self._device.heap, name, array)
            for name, array in window.places().items()})


def _share(layer: FilteredLayer, i: int, stacks: Mapping[str, Tensor], next_part: Tensor,
           factor: Tensor) -> Each:
    """Tensors that the kernels of the `i`-th layer read and write.

    Args:
        stacks: buffers of all layers that are filtered at once.
        next_part: where the layer's accumulated values go.
        factor: the picture's reflectance, for layers that are not divided by their own.
    """
    divided = "diffuse_albedo" in layer.tensors
    own = {**layer.tensors, "part_level": some_of(stacks["pool 0"], 3 * i, 3),
           "next_part": next_part,
           **{name: some_of(stacks[name], 3 * i, 3) for name in ("filtered 0", "radiance")},
           "factor": one_of(stacks["factor"], i) if divided else factor}
    return Each(frozenset({"divided"} if divided else ()), own)


def _clear(*arrays: np.ndarray) -> None:
    for values in arrays:
        values.fill(0)


def _shaded(radiance: Tensor) -> Tensor:
    """The picture's radiance with the reflectance of the render size: the last planes of it."""
    channels, *size = radiance.shape
    return radiance.view("radiance", (3, *size), (channels - 3) * math.prod(size))


def _together(layers: Sequence[FilteredLayer], most: int) -> list[list[FilteredLayer]]:
    """Layers that are filtered at once, neighbours in a stack."""
    found: list[list[FilteredLayer]] = []
    for layer in layers:
        if found and len(found[-1]) < most and layer.follows(found[-1][-1]):
            found[-1].append(layer)
        else:
            found.append([layer])
    return found
