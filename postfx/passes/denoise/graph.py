"""What runs for one window of a frame: networks and the kernels around them, for layers beside the picture, too, or
the classical filter."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np

from postfx.caching import LRUCache
from postfx.kernels import Kernel
from postfx.kernels.denoise import FINE, IN_HALF, MIX, TRUST_CELL
from postfx.kernels.denoise.classic import ATROUS, GATHER, RESOLVE, STEPS
from postfx.kernels.denoise.features import FEATURE, GUIDE, MIRROR, TRUST
from postfx.kernels.denoise.history import HISTORY, KEEP
from postfx.kernels.denoise.network_io import OPEN_ERROR, SOME
from postfx.kernels.denoise.parts import ACCUMULATE_PART, REFLECT, UPSAMPLE_LIGHT
from postfx.kernels.denoise.prepare import ACCUMULATE, DILATE, MEANS, means_size
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
from postfx.passes.denoise.models import doubts_planes, load_network
from postfx.passes.denoise.network import (
    CONTROLS,
    ERROR,
    PICTURE,
    PRODUCTS,
    Network,
    alike_heads,
    check_bindings,
    codes_features,
    free_dimensions,
    heads_of,
    is_half,
    seen_by,
    upload,
)
from postfx.passes.denoise.tiling import LEVELS, Window
from postfx.runtime import ArgumentTable, CommandBuffer, ComputeEncoder, Device, PipelineState, Tensor

PLAIN, GUIDED, UNSCALED, GIVEN = "plain", "guided", "unscaled", "given"
ENDS = {PLAIN: (REMODULATE, UPSAMPLE), GUIDED: (REMODULATE_BOTH, UPSAMPLE_GUIDED),
        UNSCALED: (REMODULATE_BOTH, UPSAMPLE_UNSCALED)}
"""Kernels that put the reflectance back and enlarge: before, with that of guides, or after, at the render size. A
picture that is given needs none of them."""
WHOLE, HALF, CODED = range(3)
"""Forms of the fine head: in float32, in half precision beside such a network on a GPU, and made row by row in the
kernels that read it, which leaves its last channels alone in memory."""
IN_CODES = {"filter 0": FILTER_CODES, f"upsample {PLAIN}": CODES_PLAIN, f"upsample {GUIDED}": CODES_GUIDED,
            f"upsample {UNSCALED}": CODES_UNSCALED}
"""Kernels that take the place of those in these tables where the fine head is made of codes."""
MOST_PLACES = 64
"""Windows of one size whose positions stay on the device."""
Tables = dict[int, dict[str, ArgumentTable]]
"""Argument tables by name, for each form of the fine head."""
OWN = ("reflectance", "accumulate", "remodulate")
"""Kernels that run on each layer by itself."""
TOGETHER = 3
"""Layers that are filtered at once: of each further one the weights are not read from memory again, but its
intermediate results take memory."""


class Graph:
    """Pipeline states, tensors and argument tables for windows of one size.

    A guided graph's models also read guides, and colour gets the guides' reflectance at output size, as far as it is
    trusted. A reactive graph can use masks of how much history counts. Models that doubt planes also read their mean,
    and some read planes that follow mirrors and glass, or say how far off each pixel is expected to be.
    Where layers are filtered, too, the `whole` fine head is kept for them.
    """

    def __init__(self, device: Device, window: Window, models: Sequence[str], guided: bool = False,
                 reactive: bool = False, whole: bool = False) -> None:
        self._device, self._window, self._guided, self._reactive = device, window, guided, reactive
        dims = free_dimensions(window.padded_size)
        networks = {model: load_network(device, model, dims) for model in models}
        for state in networks.values():
            check_bindings(state)
        self._forms = {model: HALF if is_half(state) else CODED if state.products and not whole else WHOLE
                       for model, state in networks.items()}
        self._tables = self._new_tables()
        self._places: LRUCache[Window, dict[str, dict[str, Tensor]]] = LRUCache(MOST_PLACES)
        between = cache(self._new)  # of several networks only one runs in a frame
        self._heads = {model: self._heads_of(state, self._forms[model], between) for model, state in networks.items()}
        self._doubting = {model for model in models if doubts_planes(model)}
        self._ends = {model: self._end_of(model) for model in models}
        self._reads = {model: seen_by(state) for model, state in networks.items()}
        self._make_tensors()
        self._seen |= {name: between(name, state.shapes[name], "float16") for model, state in networks.items()
                       for name in IN_HALF[FEATURE].writes if self._forms[model] == HALF and name in state.shapes}
        self._make_tables(all(map(codes_features, networks.values())))
        self._networks = {model: Network(state, self._seen, self._heads[model], between)
                          for model, state in networks.items()}

    def encode(self, commands: CommandBuffer, window: Window, model: str, tensors: Mapping[str, Tensor],
               moves: bool, masked: bool) -> None:
        """Record the work on a window of this graph's size.

        Args:
            tensors: the frame's planes, its history, whatever exists once a frame, and the outputs, by the kernels'
                names.
            moves: whether the last output has to be warped to this frame. If not, it is read as it is, in a window of
                the whole frame, because it is in place already or does not matter.
            masked: whether the reactive masks of this frame and the last say how much of the history each pixel keeps.
                If not, one number says it for all.

        The expected error is written where `tensors` has a place for it.
        """
        warped = self._made["warped"] if moves else tensors["history"]
        end, doubts = self._ends[model], model in self._doubting
        known = {"warped": warped, "keep": self._keep(tensors, masked), "fine": self._heads[model]["fine"],
                 "means": self._means if doubts else self._no_means, **self._networks[model].coded}
        tables = self._tables[self._forms[model]] | self._networks[model].looks
        if ERROR in tensors:
            known |= {"log_error": self._heads[model][ERROR]}
        if end == GIVEN:
            known |= {name: self._heads[model][name] for name in (PICTURE, CONTROLS)}
        self._bind(tables, {**self._made, **tensors, **known}, self._place(window), self._heads[model])
        with commands.compute_encoder("prepare") as encoder:
            self._run(encoder, tables, "dilate", *("means",) * doubts)
            self._run(encoder, tables, *("history",) * moves, *("keep",) * masked, *self._looks)
            self._run(encoder, tables, *("mirrored",) * ("mirrored" in self._reads[model]))
        self._networks[model].encode(commands)
        with commands.compute_encoder("filter") as encoder:
            self._run(encoder, tables, *self._order_of(end, tables))
        with commands.compute_encoder("upsample") as encoder:
            self._run(encoder, tables, f"upsample {end}", *(ERROR,) * (ERROR in tensors))

    def _order_of(self, end: str, tables: Mapping[str, ArgumentTable]) -> tuple[str, ...]:
        """Tables between the network and the enlargement."""
        if end == GIVEN:
            return ("accumulate",)
        *order, last = self._filter_order
        shaded = f"{last} {end}"
        return (*order, *((shaded,) if shaded in tables else (last, f"remodulate {end}")))

    def _keep(self, tensors: Mapping[str, Tensor], masked: bool) -> Tensor:
        """How much of the history counts, pixel by pixel or in one number."""
        return self._made["keep"] if masked else tensors["keep"]

    def _end_of(self, model: str) -> str:
        frame = self._window.frame
        unscaled = (frame.h, frame.w) == (frame.height, frame.width)
        if PICTURE in self._heads[model]:
            return GIVEN
        return GUIDED if self._guided else UNSCALED if unscaled and model in self._doubting else PLAIN

    def _new(self, name: str, shape: tuple[int, ...], dtype: str = "float32") -> Tensor:
        return self._device.heap.transient(name, shape, dtype)

    def _heads_of(self, network: PipelineState, form: int, between: Callable[..., Tensor]) -> dict[str, Tensor]:
        """The heads that the filters read, by name; for levels that the network does not compute, their constants."""
        shapes, products = heads_of(network), f"{PRODUCTS}fine"
        dtype = "float16" if form == HALF else "float32"
        if form == CODED:
            shapes["fine"] = (1, FINE - MIX, *shapes["fine"][2:])
        heads = {name: between(name, shape, dtype) for name, shape in shapes.items()}
        if products in network.shapes and self._device.runs_rows:
            behind = SOME * math.prod(shapes["fine"][2:])
            both = between("fine and its products", (behind + math.prod(shapes["fine"]),))
            heads |= {"fine": both.view("fine", shapes["fine"]),
                      products: both.view(products, network.shapes[products], behind, "int32")}
        if PICTURE in heads:
            heads["fine"] = heads[CONTROLS]
        for name, values in alike_heads(network).items():
            size = (1, values.shape[1], *self._window.level(int(name[-1])))
            heads[name] = upload(self._device.heap, name, np.broadcast_to(values, size).astype(dtype), dtype)
        return heads

    def _make_tensors(self) -> None:
        rows, columns, out = self._window.rows, self._window.columns, self._window.out
        self._made = {"moved": self._new("moved", (rows, columns, 2)), "past": self._new("past", (rows, columns, 4)),
                      "warped": self._new("warped", (out.rows, out.columns, 3)),
                      "factor": self._new("factor", (rows, columns, 3))}
        self._no_means = upload(self._device.heap, "no means", np.zeros((1, 1, 3), np.float32))
        self._means = self._new("means", (*means_size(rows, columns), 3)) if self._doubting else self._no_means
        if self._guided:
            cells = (-(-side // TRUST_CELL) for side in (rows, columns))
            self._made["trust"] = self._new("trust", (*cells, 1))
        if self._reactive:
            self._made["keep"] = self._new("keep", (rows, columns, 1))
        seen = {name: shape for reads in self._reads.values() for name, shape in reads.items()}
        self._seen = {name: self._new(name, shape) for name, shape in seen.items()}

    def _new_tables(self) -> Tables:
        return {form: {} for form in self._forms.values()}

    def _make_tables(self, coded: bool) -> None:
        level = self._window.level
        accumulated = self._new("level 0", (4, *level(0)))
        self._importance = [accumulated.view("importance 0", (1, *level(0)), 3 * math.prod(level(0)))]
        self._importance += [self._new(f"importance {i}", (1, *level(i))) for i in range(1, LEVELS + 1)]
        size = self._window.rows + 2, self._window.columns + 2
        self._radiance = {end: self._new(f"radiance {end}", (3 if end == PLAIN else 6, *size))
                          for end in set(self._ends.values()) - {GIVEN}}
        made = self._made | self._seen | {"level": accumulated}
        if self._radiance:
            light = accumulated.view("light 0", (3, *level(0)))
            filtered, self._filter_order = self._make_pyramid(self._tables, light, self._radiance.get(PLAIN))
            made["filtered"] = filtered
        self._looks = ("features", "guides", "trust") if self._guided else ("features",)
        kernels = (("dilate", DILATE), ("history", HISTORY), ("accumulate", ACCUMULATE), ("features", FEATURE))
        for name, kernel in kernels[:3] if coded else kernels:
            self._table(self._tables, name, kernel, **made)
        for end, radiance in self._radiance.items():
            for name, kernel in zip(("remodulate", "upsample"), ENDS[end], strict=True):
                self._table(self._tables, f"{name} {end}", kernel, **made, radiance=radiance)
        if GIVEN in self._ends.values():
            self._table(self._tables, f"upsample {GIVEN}", BLEND_PICTURE, **made)
        if self._doubting:
            self._table(self._tables, "means", MEANS, means=self._means)
        if self._reactive:
            self._table(self._tables, "keep", KEEP, **made)
        if "mirrored" in self._seen:
            self._table(self._tables, "mirrored", MIRROR, **made)
        if any(ERROR in heads for heads in self._heads.values()):
            self._table(self._tables, ERROR, OPEN_ERROR)
        if self._guided:
            self._table(self._tables, "guides", GUIDE, **made)
            self._table(self._tables, "trust", TRUST, **made)

    def _make_pyramid(self, tables: Tables, light: Tensor, radiance: Tensor | None = None) -> tuple[Tensor, list[str]]:
        """Make the tables of the filters, for light (3 n, hp, wp) of the picture or of n parts; returns the filtered
        light, and the tables' order behind 'accumulate'. On a GPU a filter of radiance takes the place of the last."""
        def new(name: str, i: int) -> Tensor:
            return self._new(f"{name} {i}", (light.shape[0], *self._window.level(i)))

        levels, order = [light, *(new("level", i) for i in range(1, LEVELS + 1))], ["accumulate"]
        if self._device.gpu:
            both = {"level": levels, "importance": self._importance}
            named = {f"{name}{i}": some[i] for name, some in both.items() for i in range(1, LEVELS + 1)}
            self._table(tables, "pools", POOLS, finer=light, finer_importance=self._importance[0], **named)
            order.append("pools")
        for i in range(1, 1 if self._device.gpu else LEVELS + 1):
            self._table(tables, f"pool {i}", POOL, finer=levels[i - 1], finer_importance=self._importance[i - 1],
                        level=levels[i], importance=self._importance[i])
            order.append(f"pool {i}")
        filtered = [new("filtered", i) for i in range(LEVELS + 1)]
        for i in range(LEVELS, -1, -1):
            order.append(f"filter {i}")
            if i < LEVELS and self._device.gpu:
                mixes = {"coarse": filtered[i + 1], "level": levels[i]}
                self._table(tables, f"filter {i}", FILTER_MIXED, **mixes, filtered=filtered[i])
                if i == 0 and radiance:
                    self._table(tables, f"filter 0 {PLAIN}", FILTER_SHADED, **mixes, factor=self._made["factor"],
                                radiance=radiance)
                continue
            mixed = levels[i] if i == LEVELS else new("mixed", i)
            self._table(tables, f"filter {i}", FILTER, mixed=mixed, filtered=filtered[i])
            if i < LEVELS:
                self._table(tables, f"mix {i}", MIX_LEVELS, coarse=filtered[i + 1], level=levels[i], mixed=mixed)
                order.insert(-1, f"mix {i}")
        return filtered[0], order

    def _table(self, tables: Tables, name: str, kernel: Kernel, **tensors: Tensor) -> None:
        """Make the argument tables of a kernel, with the tensors that the kernel names."""
        for form, named in tables.items():
            taken = IN_HALF.get(kernel, kernel) if form == HALF else kernel
            taken = IN_CODES.get(name, taken) if form == CODED else taken
            named[name] = ArgumentTable(self._device.compute_state(taken))
            for binding in taken.reads + taken.writes:
                if binding in tensors:
                    named[name][binding] = tensors[binding]

    def _place(self, window: Window) -> dict[str, dict[str, Tensor]]:
        """Tensors that describe a window to the kernels, by table and binding: see `Window.places_of_tables`."""
        return self._places.get_or_make(window, lambda: {
            table: {name: upload(self._device.heap, name, array) for name, array in values.items()}
            for table, values in window.places_of_tables().items()})

    def _bind(self, tables: Mapping[str, ArgumentTable], tensors: Mapping[str, Tensor],
              places: Mapping[str, Mapping[str, Tensor]], heads: Mapping[str, Tensor]) -> None:
        """Bind what changes from window to window, from frame to frame and from layer to layer."""
        for name, table in tables.items():
            step = " ".join(name.split()[:2])
            known = {**tensors, **places.get(step, places[""])}
            if step.startswith(("filter ", "mix ")):
                head = "fine" if step[-1] == "0" else f"level{step[-1]}"
                if head not in heads:  # of another model's filters
                    continue
                known["heads"] = heads[head]
            for binding in table.state.bindings:
                if binding.name in known:
                    table[binding.name] = known[binding.name]

    def _run(self, encoder: ComputeEncoder, tables: Mapping[str, ArgumentTable], *names: str) -> None:
        for name in names:
            encoder.dispatch(tables[name].state, tables[name])


@dataclass
class Layer:
    """A layer beside the picture that a window's filters run on.

    Attributes:
        name: the filters write 'light NAME', and 'next_part NAME' unless the layer is the picture itself.
        tensors: what the filters read of this frame, by binding. Without a 'part' the picture's radiance is enlarged
            once more; without albedos the part has the picture's reflectance.
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


class LayerGraph(Graph):
    """A graph that also filters layers, several at once.

    Their tensors and tables are made when as many layers are first filtered at once.
    """

    _nothing: Mapping[str, Tensor] | None = None

    def encode_layers(self, commands: CommandBuffer, window: Window, model: str, tensors: Mapping[str, Tensor],
                      masked: bool, layers: Sequence[Layer]) -> None:
        """Record the work on layers, after the picture's; the arguments are the same."""
        if self._nothing is None:
            nothing = {"past": np.zeros(self._made["past"].shape, np.float32), "keep": np.zeros((1, 1, 1), np.float32)}
            self._nothing = {name: upload(self._device.heap, f"no {name}", array) for name, array in nothing.items()}
            self._stacks: dict[int, dict[str, Tensor]] = {}
            self._layer_tables: dict[int, Tables] = {}
            self._alpha_order: list[str] = []
        whole = window == Window.whole(window.frame)
        for some in _together(layers, TOGETHER if whole and not self._device.scratch else 1):
            past = {"past": self._made["past"], "keep": self._keep(tensors, masked)}
            seen = {**tensors, **(self._nothing if some[0].alone else past)}
            if some[0].name == ALPHA_LAYER:
                self._encode_alpha(commands, some[0], window, model, tensors)
                continue
            self._encode_some(commands, some, window, model, seen)

    def _encode_some(self, commands: CommandBuffer, layers: Sequence[Layer], window: Window, model: str,
                     tensors: Mapping[str, Tensor]) -> None:
        first, count = layers[0], len(layers)
        if count not in self._layer_tables:
            self._make_layer_tables(count)
        tables, stacks = self._layer_tables[count][self._forms[model]], self._stacks[count]
        accumulates, heads = "part" in first.tensors, self._heads[model]
        self._bind(tables, {**tensors, **first.tensors, "fine": heads["fine"]}, self._place(window), heads)
        light, end = tensors[f"light {first.name}"], tables["upsample"]
        end["last"] = some_of(first.last, first.place, count)
        end["radiance"] = stacks["radiance"] if accumulates else self._shaded(model)
        end["light"] = some_of(first.stack, first.place, count) if count > 1 else alone(light)
        each = [self._share(layer, i, stacks, tensors) for i, layer in enumerate(layers)] if accumulates else []
        with commands.compute_encoder("parts") as encoder:
            for name in ("reflectance", *self._filter_order, "remodulate") if accumulates else ():
                for own in each if name in OWN else ({},):
                    if name != "reflectance" or "diffuse_albedo" in own:
                        self._run_with(encoder, tables[name], own)
            self._run_with(encoder, end, {})

    def _encode_alpha(self, commands: CommandBuffer, layer: Layer, window: Window, model: str,
                      tensors: Mapping[str, Tensor]) -> None:
        """Filter and enlarge the mean of alpha's samples."""
        if not self._alpha_order:
            self._alpha_tables, level = self._new_tables(), self._new("level of alpha", (1, *self._window.level(0)))
            filtered, self._alpha_order = self._make_pyramid(self._alpha_tables, level)
            self._table(self._alpha_tables, "level", LEVEL, level=level)
            self._table(self._alpha_tables, "enlarge", ENLARGE_ALPHA, filtered=filtered)
        tables, heads = self._alpha_tables[self._forms[model]], self._heads[model]
        self._bind(tables, {**tensors, **layer.tensors, "fine": heads["fine"]}, self._place(window), heads)
        tables["enlarge"]["enlarged"] = tensors[f"light {layer.name}"]
        with commands.compute_encoder("alpha") as encoder:
            self._run(encoder, tables, "level", *self._alpha_order[1:], "enlarge")

    def _share(self, layer: Layer, i: int, stacks: Mapping[str, Tensor],
               tensors: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """What kernels of one layer read and write, the `i`-th of some."""
        own = layer.tensors
        return own | {"part_level": some_of(stacks["level"], 3 * i, 3), "next_part": tensors[f"next_part {layer.name}"],
                      **{name: some_of(stacks[name], 3 * i, 3) for name in ("filtered", "radiance")},
                      "factor": one_of(stacks["factor"], i) if "diffuse_albedo" in own else self._made["factor"]}

    def _run_with(self, encoder: ComputeEncoder, table: ArgumentTable, own: Mapping[str, Tensor]) -> None:
        """Record a kernel, with one layer's own tensors in its table."""
        for binding in table.state.bindings:
            if binding.name in own:
                table[binding.name] = own[binding.name]
        encoder.dispatch(table.state, table)

    def _shaded(self, model: str) -> Tensor:
        """The picture's radiance with the reflectance of the render size."""
        end = self._ends[model]
        radiance = self._radiance[end]
        size = (3, *radiance.shape[1:])
        return radiance if end == PLAIN else radiance.view("radiance", size, math.prod(size))

    def _make_layer_tables(self, count: int) -> None:
        """Make tensors and tables for as many layers."""
        rows, columns = self._window.rows, self._window.columns
        stacks = self._stacks[count] = {
            "level": self._new("level of parts", (3 * count, *self._window.level(0))),
            "radiance": self._new("radiance of parts", (3 * count, rows + 2, columns + 2)),
            "factor": self._new("factors of parts", (count, rows, columns, 3))}
        tables = self._layer_tables[count] = self._new_tables()
        for name, kernel in (("reflectance", REFLECT), ("accumulate", ACCUMULATE_PART), ("remodulate", REMODULATE),
                             ("upsample", UPSAMPLE_LIGHT)):
            self._table(tables, name, kernel, moved=self._made["moved"])
        stacks["filtered"], _ = self._make_pyramid(tables, stacks["level"])


def _together(layers: Sequence[Layer], most: int) -> list[list[Layer]]:
    """Layers that are filtered at once, neighbours in a stack."""
    found: list[list[Layer]] = []
    for layer in layers:
        if found and len(found[-1]) < most and layer.follows(found[-1][-1]):
            found[-1].append(layer)
        else:
            found.append([layer])
    return found


class ClassicGraph:
    """Tensors and argument tables of the classical filter for windows of one size, used like a `Graph` of networks.

    It reads and writes the same history, but filters no layers and reads no guides.
    """

    def __init__(self, device: Device, window: Window, reactive: bool = False) -> None:
        self._device = device
        rows, columns = window.rows, window.columns
        new = device.heap.transient
        made = {"moved": new("moved", (rows, columns, 2)),
                "factor": new("factor", (rows, columns, 3)), "surface": new("surface", (6, rows, columns)),
                **({"keep": new("keep", (rows, columns, 1))} if reactive else {})}
        lights = [new(f"light {k}", (4, rows, columns)) for k in range(2)]
        self._made = made
        kernels = {"dilate": DILATE, **({"keep": KEEP} if reactive else {}), "gather": GATHER, "resolve": RESOLVE}
        self._tables = {name: ArgumentTable(device.compute_state(kernel)) for name, kernel in kernels.items()}
        self._order: list[str] = []
        for k, step in enumerate(STEPS):
            name = f"a-trous {step}"
            self._order.append(name)
            far = upload(device.heap, "step", np.full(1, step, np.float32))
            self._tables[name] = ArgumentTable(device.compute_state(ATROUS), {
                "light": lights[k % 2], "smooth": lights[1 - k % 2], "step": far})
        self._ends = {"gather": lights[0], "resolve": lights[len(STEPS) % 2]}
        self._places: LRUCache[Window, dict[str, Tensor]] = LRUCache(MOST_PLACES)

    def encode(self, commands: CommandBuffer, window: Window, tensors: Mapping[str, Tensor], masked: bool) -> None:
        """Record the work on a window; the arguments are those of `Graph.encode`."""
        kept = self._made["keep"] if masked else tensors["keep"]
        known = {**tensors, **self._made, **self._place(window), "keep": kept}
        for name, table in self._tables.items():
            seen = {**known, "light": self._ends[name]} if name in self._ends else known
            fixed = ("light", "smooth", "step") if name in self._order else ()
            if name == "keep" and not masked:
                continue
            for binding in table.state.bindings:
                if binding.name not in fixed:
                    table[binding.name] = seen[binding.name]
        steps = {"prepare": ["dilate", *["keep"] * masked, "gather"], "filter": self._order, "upsample": ["resolve"]}
        for label, names in steps.items():
            with commands.compute_encoder(label) as encoder:
                for name in names:
                    encoder.dispatch(self._tables[name].state, self._tables[name])

    def _place(self, window: Window) -> dict[str, Tensor]:
        """Tensors that describe a window to the kernels, by binding."""
        return self._places.get_or_make(window, lambda: {
            name: upload(self._device.heap, name, array) for name, array in window.places().items()})
