"""The denoiser's frame as tables, to be read from top to bottom: which kernels run, when, on what.

    planes.py      brings planes and guides to the sizes that are read, makes the reactive mask;
                   history.py finds the motion of reflections
    FRAME_NEEDS    runs once a frame
    WINDOW_STEPS   take the picture of a window through a network; CLASSIC_STEPS do so without one
    LAYER_STEPS    filter what lies beside the picture in the same window, and so does ALPHA
    frame.py       puts windows together
    planes.py      gives detail back, blends with the input by strength, corrects alpha, resamples
                   what passes through
    parts.py       makes light add up to the picture

A step runs where all of its words hold, and none of those behind `unless`:

    moves      the last output is warped to this frame
    masked     each pixel keeps another share of the history
    guided     the frame has guides, planes of the output's size
    mirrored   the network reads planes that follow mirrors and glass
    doubts     the network says how far planes are trusted
    stored     the network reads features in 8 bits, which their kernel makes
    coded      the fine head is made of 8-bit codes by the kernels that read it
    error      the expected error is asked for
    reactive   the frame has a mask of where the history is not used
    gpu        a GPU fuses some filters
    shaded     it fuses the last filter and the reflectance, too
    plain, guides, unscaled, given
               what ends the window: colour is enlarged with its reflectance, or gets that of
               guides, or stays at the render size, or the network gives the picture itself
    filtered   a layer has light of its own to filter, unlike the whole picture beside parts
    divided    a layer is divided by its own reflectance
"""

from __future__ import annotations

import math
from collections import ChainMap
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from postfx.caching import LRUCache
from postfx.kernels import Kernel
from postfx.kernels.denoise import FINE, IN_HALF, MIX, TRUST_CELL
from postfx.kernels.denoise.classic import ATROUS, GATHER, RESOLVE, STEPS
from postfx.kernels.denoise.features import FEATURE, GUIDE, MIRROR, STORED_FEATURE, TRUST
from postfx.kernels.denoise.history import HISTORY, KEEP, SPREAD_MASK
from postfx.kernels.denoise.network_io import OPEN_ERROR, SOME
from postfx.kernels.denoise.parts import ACCUMULATE_PART, REFLECT, UPSAMPLE_LIGHT
from postfx.kernels.denoise.prepare import ACCUMULATE, DILATE, MEANS, SCALE, means_size
from postfx.kernels.denoise.pyramid import (
    ENLARGE_ALPHA,
    FILTER,
    FILTER_CODES,
    FILTER_MIXED,
    FILTER_SHADED,
    LEVEL,
    MIX_LEVELS,
    POOL,
    POOLS,
    REMODULATE,
    REMODULATE_BOTH,
)
from postfx.kernels.denoise.upsample import (
    BLEND_PICTURE,
    CODES_GUIDED,
    CODES_PLAIN,
    CODES_UNSCALED,
    UPSAMPLE,
    UPSAMPLE_GUIDED,
    UPSAMPLE_UNSCALED,
)
from postfx.passes.denoise.history import ALPHA_LAYER, alone, one_of, some_of
from postfx.passes.denoise.models import CLASSIC as CLASSIC_MODEL
from postfx.passes.denoise.models import doubts_planes, load_network
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
from postfx.passes.denoise.tiling import PYRAMID_LEVELS, Window
from postfx.runtime import CommandBuffer, Device, PipelineState, Tensor

PLAIN, GUIDES_KIND, UNSCALED_KIND, GIVEN = "plain", "guides", "unscaled", "given"


class Step(NamedTuple):
    """A kernel, and where it runs.

    Attributes:
        when, unless: words of this module's description that must hold, and must not.
        each: whether it runs on each layer by itself.
        buffers: names of the buffers of those bindings whose buffers have other names.
    """

    kernel: Kernel
    when: frozenset[str]
    unless: frozenset[str]
    each: bool
    buffers: Mapping[str, str]


Steps = tuple[Step, ...]


def step(kernel: Kernel, when: str = "", unless: str = "", **buffers: str) -> Step:
    """A step, with its words in one text."""
    return Step(kernel, frozenset(when.split()), frozenset(unless.split()), False, buffers)


def each(kernel: Kernel, when: str, **buffers: str) -> Step:
    """A step that runs on each layer by itself."""
    return step(kernel, when, **buffers)._replace(each=True)


def _pool(i: int) -> Step:
    """Halves the size of light, weighted by importance."""
    return step(POOL, unless="gpu given",
                finer=f"pool {i - 1}", finer_importance=f"importance {i - 1}",
                finer_rows=f"finer_rows {i}", finer_columns=f"finer_columns {i}",
                level=f"pool {i}", importance=f"importance {i}")


def _filtering(i: int) -> Steps:
    """Filters one level of the pyramid, mixed with the filtered level below it."""
    head, area = f"head level{i}" if i else "head fine", f"area {i}"
    buffers = {"heads": head, "area": area, "filtered": f"filtered {i}"}
    if i == PYRAMID_LEVELS:
        return (step(FILTER, unless="given", mixed=f"pool {i}", **buffers),)
    buffers |= {"mixed": f"mixed {i}", "level": f"pool {i}", "coarse": f"filtered {i + 1}",
                "coarse_rows": f"coarse_rows {i}", "coarse_columns": f"coarse_columns {i}"}
    if i > 0:
        return (
            step(MIX_LEVELS, "", "gpu given", **buffers),
            step(FILTER, "", "gpu given", **buffers),
            step(FILTER_MIXED, "gpu", "given", **buffers))
    return (
        step(MIX_LEVELS, "", "gpu given", **buffers),
        step(FILTER, "", "gpu given coded", **buffers),
        step(FILTER_CODES, "coded", "given", **buffers),
        step(FILTER_MIXED, "gpu", "given shaded", **buffers),
        step(FILTER_SHADED, "gpu shaded", radiance="radiance plain", **buffers))


_POOLS = step(POOLS, "gpu", "given", finer="pool 0", finer_importance="importance 0",
              level1="pool 1", level2="pool 2", level3="pool 3", level4="pool 4",
              importance1="importance 1", importance2="importance 2",
              importance3="importance 3", importance4="importance 4")
PYRAMID: Steps = (_POOLS, *map(_pool, range(1, PYRAMID_LEVELS + 1)),
                  *(one for i in range(PYRAMID_LEVELS, -1, -1) for one in _filtering(i)))
"""Filters 'pool 0' into 'filtered 0'."""

PREPARE: Steps = (
    step(DILATE),
    step(MEANS, "doubts"),
    step(HISTORY, "moves"),
    step(KEEP, "masked"),
    step(FEATURE, unless="stored"),
    step(STORED_FEATURE, "stored"),
    step(GUIDE, "guided"),
    step(TRUST, "guided"),
    step(MIRROR, "mirrored"))
ACCUMULATE_AND_FILTER: Steps = (
    step(ACCUMULATE, level="level 0"),
    *PYRAMID,
    step(REMODULATE, "plain", "shaded", filtered="filtered 0", radiance="radiance plain"),
    step(REMODULATE_BOTH, "guides", filtered="filtered 0", radiance="radiance guides"),
    step(REMODULATE_BOTH, "unscaled", filtered="filtered 0", radiance="radiance unscaled"))
ENLARGE: Steps = (
    step(UPSAMPLE, "plain", "coded", radiance="radiance plain"),
    step(CODES_PLAIN, "plain coded", radiance="radiance plain"),
    step(UPSAMPLE_GUIDED, "guides", "coded", radiance="radiance guides"),
    step(CODES_GUIDED, "guides coded", radiance="radiance guides"),
    step(UPSAMPLE_UNSCALED, "unscaled", "coded", radiance="radiance unscaled"),
    step(CODES_UNSCALED, "unscaled coded", radiance="radiance unscaled"),
    step(BLEND_PICTURE, "given", picture=f"head {PICTURE}", controls=f"head {CONTROLS_NAME}"),
    step(OPEN_ERROR, "error", log_error=f"head {ERROR}"))
FRAME_NEEDS: dict[str, Steps] = {"scale": (step(SCALE), step(SPREAD_MASK, "reactive"))}
"""What windows need of the whole frame, by the labels of encoders."""
NETWORK_LABEL = "network"
SOMETIMES = frozenset({"moves", "masked", ERROR})
"""Words that hold in some frames of a window and not in others."""
WINDOW_STEPS: dict[str, Steps] = {
    "prepare": PREPARE,
    NETWORK_LABEL: (),
    "filter": ACCUMULATE_AND_FILTER,
    "upsample": ENLARGE}
"""The picture of a window, by the labels of encoders. In between its network runs, with what packs
and opens."""
LAYER_STEPS: dict[str, Steps] = {"parts": (
    each(REFLECT, "filtered divided"),
    each(ACCUMULATE_PART, "filtered"),
    *(one._replace(when=one.when | {"filtered"}) for one in PYRAMID),
    each(REMODULATE, "filtered", filtered="filtered 0"),
    step(UPSAMPLE_LIGHT))}
"""Layers of one stack, by the picture's filters."""
ALPHA: dict[str, Steps] = {"alpha": (
    step(LEVEL, level="pool 0"),
    *PYRAMID,
    step(ENLARGE_ALPHA, filtered="filtered 0"))}
CLASSIC_STEPS: dict[str, Steps] = {
    "prepare": (step(DILATE), step(KEEP, "masked"), step(GATHER, light="smooth 0")),
    "filter": tuple(
        step(ATROUS, light=f"smooth {k % 2}", smooth=f"smooth {1 - k % 2}", step=f"step {far}")
        for k, far in enumerate(STEPS)),
    "upsample": (step(RESOLVE, light=f"smooth {len(STEPS) % 2}"),)}

Buffers = Mapping[str, Tensor]
WHOLE_FORM, HALF_FORM, CODED_FORM = range(3)
"""Forms of the fine head: in float32, in half precision beside such a network on a GPU, and made
row by row in the kernels that read it, which leaves its last channels alone in memory."""
MOST_PLACES = 64
"""Windows of one size whose positions stay on the device."""
TOGETHER = 3
"""Layers that are filtered at once: of each further one the weights are not read from memory again,
but its intermediate results take memory."""


class Each(NamedTuple):
    """One layer among those that are filtered at once: its own words and buffers."""

    words: frozenset[str] = frozenset()
    buffers: Buffers = MappingProxyType({})


ONCE = (Each(),)


def run_steps(commands: CommandBuffer, table: Mapping[str, Steps], words: frozenset[str],
              buffers: Buffers, half: bool = False, each: Sequence[Each] = ONCE) -> None:
    """Record the steps of a table that run where these words hold, on these buffers; in `half`
    precision where a kernel has that form."""
    for label, steps in table.items():
        for one in steps:
            kernel = IN_HALF.get(one.kernel, one.kernel) if half else one.kernel
            for layer in each if one.each else ONCE:
                held = words | layer.words
                if one.when <= held and not one.unless & held:
                    names = {binding: one.buffers.get(binding, binding)
                             for binding in kernel.reads + kernel.writes}
                    commands.run(kernel, label, **{
                        binding: layer.buffers[name] if name in layer.buffers else buffers[name]
                        for binding, name in names.items()})


def kernels_of(table: Mapping[str, Steps], words: frozenset[str],
               half: bool = False) -> list[Kernel]:
    """The kernels that may run where no more than these words hold."""
    found = [one.kernel for steps in table.values() for one in steps
             if one.when <= words and not one.unless & words - SOMETIMES]
    return [IN_HALF.get(kernel, kernel) if half else kernel for kernel in found]


@dataclass
class Layer:
    """A layer beside the picture that a window's filters run on.

    Attributes:
        name: the filters write 'light NAME', and 'next_part NAME' unless the layer is the picture
            itself.
        tensors: what the filters read of this frame, by binding. Without a 'part' the picture's
            radiance is enlarged once more; without albedos the part has the picture's reflectance.
        alone: whether it has no history in this frame, though the picture may have one.
        last: the stack (n, height, width, 3) that holds its last output.
        stack: the stack that its output goes to, where a window is the whole frame.
        place: its place in both.
    """

    name: str
    tensors: dict[str, Tensor]
    alone: bool
    last: Tensor
    stack: Tensor
    place: int

    def follows(self, other: Layer) -> bool:
        """Whether it can be filtered together with another one, behind it."""
        alike = self.alone == other.alone and "part" in self.tensors and "part" in other.tensors
        return alike and self.stack is other.stack and self.place == other.place + 1


class WindowGraph:
    """The networks, and the buffers of the tables' steps, for windows of one size.

    A guided one's models also read guides. A reactive one can use masks of how much history counts.
    Models that doubt planes also read their mean. Where layers are filtered, too, the `whole` fine
    head is kept for them.
    """

    def __init__(self, device: Device, window: Window, models: Sequence[str], guided: bool = False,
                 reactive: bool = False, whole: bool = False) -> None:
        self._device, self._window, self._guided = device, window, guided
        dims = free_dimensions(window.padded_size)
        states = {model: load_network(device, model, dims) for model in models
                  if model != CLASSIC_MODEL}
        for state in states.values():
            check_bindings(state)
        self._forms = {
            model: HALF_FORM if is_half(state) else CODED_FORM
            if state.products and not whole else WHOLE_FORM for model, state in states.items()}
        self._places: LRUCache[Window, dict[str, Tensor]] = LRUCache(MOST_PLACES)
        between = cache(self._new)  # of several networks only one runs in a frame
        self._heads = {model: self._heads_of(state, self._forms[model], between)
                       for model, state in states.items()}
        self._doubting = {model for model in states if doubts_planes(model)}
        self._ends = {model: self._end_of(model) for model in states}
        self._made = self._classic_buffers() if CLASSIC_MODEL in models else {}
        self._made |= self._common_buffers(reactive)
        seen = {name: shape for state in states.values() for name, shape in seen_by(state).items()}
        read = {name: self._new(name, shape) for name, shape in seen.items()}
        read |= {name: between(name, state.shapes[name], "float16")
                 for model, state in states.items() if self._forms[model] == HALF_FORM
                 for name in IN_HALF[FEATURE].writes if name in state.shapes}
        if states:
            self._made |= read | self._pyramid_buffers(self._new("level 0", (4, *window.level(0))))
        self._networks = {model: Network(state, read, self._heads[model], between)
                          for model, state in states.items()}
        self._words = {model: self._words_of(model, state) for model, state in states.items()}
        may = SOMETIMES - (frozenset() if reactive else {"masked"})
        for model, words in self._words.items():
            some = may if ERROR in self._heads[model] else may - {ERROR}
            device.make_ready(*kernels_of(WINDOW_STEPS, words | some,
                                          self._forms[model] == HALF_FORM))
        if CLASSIC_MODEL in models:
            device.make_ready(*kernels_of(CLASSIC_STEPS, may))
        self._layer_buffers: dict[int, dict[str, Tensor]] = {}

    def encode(self, commands: CommandBuffer, window: Window, model: str, tensors: Buffers,
               moves: bool, masked: bool, layers: Sequence[Layer] = ()) -> None:
        """Record the work on a window of this graph's size.

        Args:
            tensors: the frame's planes, its history, whatever exists once a frame, and the outputs,
                by the kernels' names.
            moves: whether the last output has to be warped to this frame. If not, it is read as it
                is, in a window of the whole frame, because it is in place already or does not
                matter.
            masked: whether the reactive masks of this frame and the last say how much of the
                history each pixel keeps. If not, one number says it for all.
            layers: what is filtered beside the picture.

        The expected error is written where `tensors` has a place for it.
        """
        now = {"moves": moves, "masked": masked, ERROR: ERROR in tensors}
        words = frozenset(word for word, holds in now.items() if holds)
        own = {"keep": self._made["keep"] if masked else tensors["keep"]}
        if model == CLASSIC_MODEL:
            buffers = ChainMap(own, self._place(window), dict(tensors), self._made)
            run_steps(commands, CLASSIC_STEPS, words, buffers)
            return
        network, heads = self._networks[model], self._heads[model]
        own |= {"warped": self._made["warped"] if moves else tensors["history"],
                "means": self._made["means" if model in self._doubting else "no means"],
                "fine": heads["fine"], **{f"head {name}": head for name, head in heads.items()},
                **network.coded, **network.stored}
        buffers = ChainMap(own, self._place(window), dict(tensors), self._made)
        words, half = words | self._words[model], self._forms[model] == HALF_FORM
        for label, steps in WINDOW_STEPS.items():
            if label == NETWORK_LABEL:
                network.encode(commands)
            run_steps(commands, {label: steps}, words, buffers, half)
        at_once = window == Window.whole(window.frame) and not self._device.scratch
        for some in _together(layers, TOGETHER if at_once else 1):
            self._encode_layers(commands, some, model, buffers, half)

    def _encode_layers(self, commands: CommandBuffer, layers: Sequence[Layer], model: str,
                       buffers: ChainMap[str, Tensor], half: bool) -> None:
        """Record the work on layers that are filtered at once, after the picture's."""
        first, words = layers[0], self._words[model] & {"gpu"}
        seen = buffers.new_child({**(self._nothing if first.alone else {}), **first.tensors})
        if first.name == ALPHA_LAYER:
            own = self._layers_of(1, 1) | {"enlarged": buffers[f"light {first.name}"]}
            run_steps(commands, ALPHA, words, seen.new_child(own), half)
            return
        own = dict(self._layers_of(len(layers), 3))
        filtered, light = "part" in first.tensors, buffers[f"light {first.name}"]
        shares = [self._share(layer, i, own, buffers) for i, layer in enumerate(layers) if filtered]
        own["last"] = some_of(first.last, first.place, len(layers))
        own["light"] = alone(light)
        if len(layers) > 1:
            own["light"] = some_of(first.stack, first.place, len(layers))
        if filtered:
            words |= {"filtered"}
        else:
            own["radiance"] = self._shaded(model)
        run_steps(commands, LAYER_STEPS, words, seen.new_child(own), half, shares)

    def _share(self, layer: Layer, i: int, stacks: Buffers, buffers: Buffers) -> Each:
        """What kernels of one layer read and write, the `i`-th of some."""
        divided = "diffuse_albedo" in layer.tensors
        own = {**layer.tensors, "part_level": some_of(stacks["pool 0"], 3 * i, 3),
               "next_part": buffers[f"next_part {layer.name}"],
               **{name: some_of(stacks[name], 3 * i, 3) for name in ("filtered 0", "radiance")},
               "factor": one_of(stacks["factor"], i) if divided else self._made["factor"]}
        return Each(frozenset({"divided"} if divided else ()), own)

    def _words_of(self, model: str, state: PipelineState) -> frozenset[str]:
        """The words that hold for a model in every frame."""
        end, network = self._ends[model], self._networks[model]
        holding = {end: True, "guided": self._guided, "mirrored": "mirrored" in seen_by(state),
                   "doubts": model in self._doubting, "stored": bool(network.stored),
                   "coded": self._forms[model] == CODED_FORM, "gpu": bool(self._device.gpu),
                   "shaded": bool(self._device.gpu) and end == PLAIN}
        return frozenset(word for word, holds in holding.items() if holds)

    def _end_of(self, model: str) -> str:
        frame = self._window.frame
        unscaled = (frame.h, frame.w) == (frame.height, frame.width)
        if PICTURE in self._heads[model]:
            return GIVEN
        return (GUIDES_KIND if self._guided else UNSCALED_KIND
                if unscaled and model in self._doubting else PLAIN)

    def _new(self, name: str, shape: tuple[int, ...], dtype: str = "float32") -> Tensor:
        return self._device.heap.transient(name, shape, dtype)

    def _heads_of(self, network: PipelineState, form: int,
                  between: Callable[..., Tensor]) -> dict[str, Tensor]:
        """The heads that the filters read, by name; for levels that the network does not compute,
        their constants."""
        shapes, products = heads_of(network), f"{PRODUCTS}fine"
        dtype = "float16" if form == HALF_FORM else "float32"
        if form == CODED_FORM:
            shapes["fine"] = (1, FINE - MIX, *shapes["fine"][2:])
        heads = {name: between(name, shape, dtype) for name, shape in shapes.items()}
        if products in network.shapes and self._device.runs_rows:
            behind = SOME * math.prod(shapes["fine"][2:])
            both = between("fine and its products", (behind + math.prod(shapes["fine"]),))
            heads |= {"fine": both.view("fine", shapes["fine"]),
                      products: both.view(products, network.shapes[products], behind, "int32")}
        if PICTURE in heads:
            heads["fine"] = heads[CONTROLS_NAME]
        for name, values in alike_heads(network).items():
            size = (1, values.shape[1], *self._window.level(int(name[-1])))
            heads[name] = upload(self._device.heap, name,
                                 np.broadcast_to(values, size).astype(dtype), dtype)
        return heads

    def _common_buffers(self, reactive: bool) -> dict[str, Tensor]:
        """Buffers that the steps before the network write, and constants in their place."""
        rows, columns, out = self._window.rows, self._window.columns, self._window.out
        cells = (-(-side // TRUST_CELL) for side in (rows, columns))
        shapes: dict[str, tuple[int, ...]] = {
            "moved": (rows, columns, 2), "past": (rows, columns, 4),
            "warped": (out.rows, out.columns, 3), "factor": (rows, columns, 3)}
        shapes |= {"means": (*means_size(rows, columns), 3)} if self._doubting else {}
        shapes |= {"trust": (*cells, 1)} if self._guided else {}
        shapes |= {"keep": (rows, columns, 1)} if reactive else {}
        made = {name: self._new(name, shape) for name, shape in shapes.items()}
        return made | {"no means": upload(self._device.heap, "no means",
                                          np.zeros((1, 1, 3), np.float32))}

    def _pyramid_buffers(self, accumulated: Tensor) -> dict[str, Tensor]:
        """Buffers of the steps behind the network."""
        level, size = self._window.level, (self._window.rows + 2, self._window.columns + 2)
        made = {"level 0": accumulated, "pool 0": accumulated.view("light 0", (3, *level(0))),
                "importance 0": accumulated.view("importance 0", (1, *level(0)),
                                                 3 * math.prod(level(0)))}
        made |= {f"importance {i}": self._new(f"importance {i}", (1, *level(i)))
                 for i in range(1, PYRAMID_LEVELS + 1)}
        made |= {f"radiance {end}": self._new(f"radiance {end}", (3 if end == PLAIN else 6, *size))
                 for end in set(self._ends.values()) - {GIVEN}}
        return made | self._levels(3)

    def _levels(self, channels: int) -> dict[str, Tensor]:
        """Levels of the pyramid above the first, mixed and filtered ones."""
        counts = {"pool": range(1, PYRAMID_LEVELS + 1), "mixed": range(PYRAMID_LEVELS),
                  "filtered": range(PYRAMID_LEVELS + 1)}
        return {f"{name} {i}": self._new(f"{name} {i}", (channels, *self._window.level(i)))
                for name, levels in counts.items() for i in levels}

    def _layers_of(self, count: int, channels: int) -> dict[str, Tensor]:
        """Buffers for as many layers, made when as many are first filtered at once: of alpha, with
        one channel, or of light."""
        if count * channels not in self._layer_buffers:
            rows, columns = self._window.rows, self._window.columns
            made = self._layer_buffers[count * channels] = {
                "pool 0": self._new("level of layers", (count * channels, *self._window.level(0))),
                **self._levels(count * channels)}
            if channels == 3:
                made["radiance"] = self._new("radiance of parts",
                                             (3 * count, rows + 2, columns + 2))
                made["factor"] = self._new("factors of parts", (count, rows, columns, 3))
        return self._layer_buffers[count * channels]

    def _classic_buffers(self) -> dict[str, Tensor]:
        rows, columns = self._window.rows, self._window.columns
        distances = {f"step {far}": upload(self._device.heap, "step", np.full(1, far, np.float32))
                     for far in STEPS}
        return {"surface": self._new("surface", (6, rows, columns)), **distances,
                **{f"smooth {k}": self._new(f"light {k}", (4, rows, columns)) for k in range(2)}}

    @cached_property
    def _nothing(self) -> dict[str, Tensor]:
        """In place of a history, for layers without one."""
        arrays = {"past": np.zeros(self._made["past"].shape, np.float32),
                  "keep": np.zeros((1, 1, 1), np.float32)}
        return {name: upload(self._device.heap, f"no {name}", array)
                for name, array in arrays.items()}

    def _shaded(self, model: str) -> Tensor:
        """The picture's radiance with the reflectance of the render size."""
        end = self._ends[model]
        radiance = self._made[f"radiance {end}"]
        size = (3, *radiance.shape[1:])
        return radiance if end == PLAIN else radiance.view("radiance", size, math.prod(size))

    def _place(self, window: Window) -> dict[str, Tensor]:
        """Tensors that describe a window to the kernels, by buffer: see `Window.places`."""
        return self._places.get_or_make(window, lambda: {
            name: upload(self._device.heap, name, array)
            for name, array in window.places().items()})


def _together(layers: Sequence[Layer], most: int) -> list[list[Layer]]:
    """Layers that are filtered at once, neighbours in a stack."""
    found: list[list[Layer]] = []
    for layer in layers:
        if found and len(found[-1]) < most and layer.follows(found[-1][-1]):
            found[-1].append(layer)
        else:
            found.append([layer])
    return found
