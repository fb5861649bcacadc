"""What runs for one window of a frame: a network and the kernels around it, or the classical filter."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from itertools import zip_longest

import numpy as np

from postfx.caching import LRUCache
from postfx.kernels import Kernel
from postfx.kernels.denoise import FEATURES, FINE, GUIDES, IN_HALF, MIX, TRUST_CELL
from postfx.kernels.denoise.classic import ATROUS, GATHER, RESOLVE, STEPS
from postfx.kernels.denoise.features import FEATURE, GUIDE, STORED_FEATURE, TRUST
from postfx.kernels.denoise.history import HISTORY, KEEP
from postfx.kernels.denoise.network_io import (
    OPEN,
    OPEN_CODES,
    OPEN_FINE,
    OPEN_FINE_CODES,
    OPEN_FINE_PRODUCTS,
    OPEN_PHASED,
    OPEN_PRODUCTS,
    OPEN_SOME_PRODUCTS,
    PACK,
    SOME,
    STORE,
    STORE_RINGED,
    opened_shape,
)
from postfx.kernels.denoise.prepare import ACCUMULATE, DILATE, MEANS, means_size
from postfx.kernels.denoise.pyramid import FILTER, FILTER_CODES, MIX_LEVELS, POOL, REMODULATE, REMODULATE_BOTH
from postfx.kernels.denoise.upsample import (
    CODES_GUIDED,
    CODES_PLAIN,
    CODES_UNSCALED,
    UPSAMPLE,
    UPSAMPLE_GUIDED,
    UPSAMPLE_UNSCALED,
)
from postfx.kernels.vectors import FOURS
from postfx.passes.denoise.models import doubts_planes, load_network
from postfx.passes.denoise.tiling import LEVELS, Window
from postfx.runtime import ArgumentTable, CommandBuffer, ComputeEncoder, Device, ModelError, PipelineState, Tensor
from postfx.runtime.tensor import TensorHeap

PACKED, RAW = "packed_", "raw_"
"""Prefix of the names of inputs and outputs in half precision, channels last."""
PHASED_FINE = "phased_fine"
"""The fine head in float32 before its activations, with the four phases of each channel in a row."""
STORED, CODING = "stored_", "coding_"
"""Prefixes of the names of 8-bit inputs, channels last, and of the constants that tell how they are coded."""
PRODUCTS, SCALING = "products_", "scaling_"
"""Prefixes of the names of integer outputs, (C, h * w), and of the constants that scale them."""
CODES = "codes_"
"""Prefix of the names of 8-bit outputs, channels last, of which kernels make such products."""
RING = 1
"""Border in pixels around 8-bit inputs, for networks whose first convolution reads beyond the picture."""
MADE = (PACKED, RAW, PHASED_FINE, STORED, PRODUCTS, CODES)
CHANNELS = {"features": FEATURES, "guides": GUIDES}
FEATURE_PARTS = {"first_features": 32, "last_features": FEATURES - 32}
"""Feature channels that float32 networks read as inputs of their own: a CPU is fastest with few, or multiples of 16."""


def free_dimensions(size: tuple[int, int]) -> dict[str, int]:
    """Networks' names for height and width: of the features, and of features with a border of one pixel."""
    (h, w), ring = size, 2 * RING
    return {"height": h, "width": w, "ringed_height": h + ring, "ringed_width": w + ring}


def stored_channels(name: str) -> int:
    """Number of channels of 'features' or 'guides' in 8 bits."""
    return -(-CHANNELS[name] // 4) * 4


def seen_by(state: PipelineState) -> dict[str, tuple[int, ...]]:
    """Shapes of what kernels prepare for a network, by name."""
    seen = dict[str, tuple[int, ...]]()
    for binding in state.bindings:
        name, size = binding.name.removeprefix(PACKED), state.shapes[binding.name]
        if name in FEATURE_PARTS:
            seen["features"] = (1, CHANNELS["features"], *size[2:])
        elif name.startswith(STORED):  # with a border of one pixel, or without
            name = name.removeprefix(STORED)
            seen[name] = (1, CHANNELS[name], state.dims["height"], state.dims["width"])
        elif binding.access == "read":
            seen[name] = size if name == binding.name else (1, CHANNELS[name], *size[1:3])
    return seen


def parts_of(features: Tensor) -> dict[str, Tensor]:
    """Parts of the features by name, no copies."""
    parts, first, size = {}, 0, features.shape[2:]
    for name, count in FEATURE_PARTS.items():
        parts[name] = features.view(name, (1, count, *size), first * math.prod(size))
        first += count
    return parts


def heads_of(state: PipelineState) -> dict[str, tuple[int, ...]]:
    """Shapes of a network's heads after their activations, by name."""
    heads, seen = dict[str, tuple[int, ...]](), seen_by(state)["features"][2:]
    counts = {binding.name: state.shapes[binding.name][0] for binding in state.bindings
              if binding.name.startswith(PRODUCTS)}
    counts |= {output: len(product.factors) for output, product in state.products.items()}
    for output, count in counts.items():
        name = output.removeprefix(PRODUCTS)
        heads[name] = (1, FINE, *seen) if name == "fine" else (1, count, *(side >> int(name[-1]) for side in seen))
    for binding in state.bindings:
        name, size = binding.name.removeprefix(RAW), state.shapes[binding.name]
        if binding.name == PHASED_FINE:
            heads["fine"] = opened_shape("fine", *size[2:])
        elif binding.access == "write" and not binding.name.startswith((PRODUCTS, CODES)):
            heads[name] = size if name == binding.name else opened_shape(name, *size[1:3])
    return heads


def check_bindings(state: PipelineState) -> None:
    """ModelError for a network that is not a denoiser. Kernels prepare its inputs and take its outputs by name."""
    coded = re.compile(f"^({PACKED}|{RAW}|{STORED}|{PRODUCTS}|{CODES})")
    plain = {binding.name: coded.sub("", binding.name) for binding in state.bindings}
    reads = {b.name for b in state.bindings if b.access == "read"}
    strange = [name for name in reads if plain[name] not in (*CHANNELS, *FEATURE_PARTS)]
    gives = {plain[b.name] for b in state.bindings if b.access == "write"} | set(state.constants)
    if strange or "features" not in seen_by(state) or not {"fine", PHASED_FINE} & gives:
        raise ModelError(f"model '{state.name}' is not a denoiser: it reads {', '.join(sorted(reads)) or 'nothing'} "
                         f"and gives {', '.join(sorted(gives)) or 'nothing'}; training.denoise.export makes one")


def alike_heads(state: PipelineState) -> dict[str, np.ndarray]:
    """Heads of the levels that a network does not compute, (1, C, 1, 1) by name: one value for all pixels."""
    return {name: array for name, array in state.constants.items() if not name.startswith((CODING, SCALING))}


class Network:
    """A network that reads `seen` and writes `heads`, both by name; `new` makes the tensors in between. Its tables
    `looks` run in place of those of their names: on a CPU the kernel 'features' itself writes 8 bits. Other kernels
    make the fine head of what is `coded`, by their bindings, if the network leaves it to them."""

    def __init__(self, state: PipelineState, seen: Mapping[str, Tensor], heads: Mapping[str, Tensor],
                 new: Callable[[str, tuple[int, ...], str], Tensor]) -> None:
        unmarked = [binding.name for binding in state.bindings if binding.name.startswith((CODING, SCALING))]
        if unmarked:
            raise ModelError(f"network '{state.name}': no card beside it marks {', '.join(unmarked)} as constant; take "
                             "the card that it was made with, or make both again with training.denoise.quantise")
        made = {b.name: heads.get(b.name) or new(b.name, state.shapes[b.name], b.dtype)
                for b in state.bindings if b.name.startswith(MADE)}
        constants = {name: upload(state.device.heap, name, array) for name, array in state.constants.items()
                     if name.startswith((CODING, SCALING))}
        known = {**parts_of(seen["features"]), **seen, **heads, **made}
        self._table = ArgumentTable(state, {binding.name: known[binding.name] for binding in state.bindings})
        packed = [name for name in made if name.startswith((PACKED, STORED)) and name not in seen]
        self.looks, features = dict[str, ArgumentTable](), "features"
        if _codes_features(state):
            packed.remove(name := f"{STORED}{features}")
            self.looks[features] = _table(state, STORED_FEATURE, coding=constants[CODING + features], stored=made[name])
        closed = [name for name in made if name.startswith((RAW, PHASED_FINE, PRODUCTS))]
        self._before = [_packer(state, made[name], constants, seen) for name in packed]
        openers = [_openers(state, made[name], constants, heads) for name in closed]
        self.coded: dict[str, Tensor] = {}
        for output, product in state.products.items():
            name, factors = output.removeprefix(PRODUCTS), product.factors
            whole = np.pad(factors, ((0, -len(factors) % FOURS), (0, 0)))
            coded = {"codes": made[product.codes], "scaling": constants[f"{SCALING}{name}"],
                     "factors": upload(state.device.heap, f"factors {name}", whole, "int8")}
            openers.append([_code_opener(state, heads[name], coded, name == "fine")])
            self.coded = coded if name == "fine" else self.coded
        self._after = [[table for table in step if table] for step in zip_longest(*openers)]

    def encode(self, commands: CommandBuffer) -> None:
        """Record the network's run, which waits for the kernels before it."""
        if self._before:
            _dispatch(commands, "pack", [self._before], ("compute", "machine-learning"))
        with commands.machine_learning_encoder("network") as encoder:
            encoder.barrier(after="compute", before="machine-learning")
            encoder.dispatch_network(self._table.state, self._table)
        if self._after:
            _dispatch(commands, "open", self._after, ("compute", "machine-learning"))


def _packer(state: PipelineState, packed: Tensor, constants: Mapping[str, Tensor],
            seen: Mapping[str, Tensor]) -> ArgumentTable:
    if packed.name.startswith(PACKED):
        return _table(state, PACK, planes=seen[packed.name.removeprefix(PACKED)], packed=packed)
    name = packed.name.removeprefix(STORED)
    kernel = STORE if packed.shape[1] == seen[name].shape[2] else STORE_RINGED
    return _table(state, kernel, planes=seen[name], coding=constants[f"{CODING}{name}"], stored=packed)


def upload(heap: TensorHeap, name: str, array: np.ndarray, dtype: str = "float32") -> Tensor:
    """A tensor that holds an array from now on."""
    tensor = heap.tensor(name, array.shape, dtype)
    tensor.upload(array)
    return tensor


def _openers(state: PipelineState, closed: Tensor, constants: Mapping[str, Tensor],
             heads: Mapping[str, Tensor]) -> list[ArgumentTable]:
    """Tables to run in turn. Of products behind the fine head in one memory, some take the place of those before."""
    if closed.name not in heads:
        return [_opener(state, closed, constants, heads)]
    fine, (_, count, rows, columns), tables = heads["fine"], heads["fine"].shape, []
    for channel in range(0, count, SOME):
        some, at = min(SOME, count - channel), channel * rows * columns
        tables.append(_table(
            state, OPEN_SOME_PRODUCTS, scaling=constants[f"{SCALING}fine"],
            first=upload(state.device.heap, "first", np.full(1, channel, np.float32)),
            products=closed.view(closed.name, (1, 4 * some, rows // 2, columns // 2), at),
            fine=fine.view("fine", (1, some, rows, columns), at)))
    return tables


def _code_opener(state: PipelineState, head: Tensor, coded: Mapping[str, Tensor], fine: bool) -> ArgumentTable:
    if not fine:
        return _table(state, OPEN_CODES, **coded, heads=head)
    _, count, rows, columns = head.shape
    return _table(state, OPEN_FINE_CODES, **coded, fine=head.view("fine", (1, count, rows // 2, 2, columns)))


def _opener(state: PipelineState, closed: Tensor, constants: Mapping[str, Tensor],
            heads: Mapping[str, Tensor]) -> ArgumentTable:
    if closed.name == PHASED_FINE:
        return _table(state, OPEN_PHASED, phased_fine=closed, fine=heads["fine"])
    if closed.name == f"{RAW}fine":
        return _table(state, OPEN_FINE, raw_fine=closed, fine=heads["fine"])
    if closed.name.startswith(RAW):
        return _table(state, OPEN, raw=closed, heads=heads[closed.name.removeprefix(RAW)])
    name = closed.name.removeprefix(PRODUCTS)
    head, scaling, (rows, columns) = heads[name], constants[f"{SCALING}{name}"], heads[name].shape[2:]
    if name != "fine":
        products = closed.view(closed.name, head.shape)
        return _table(state, OPEN_PRODUCTS, products=products, scaling=scaling, heads=head)
    products = closed.view(closed.name, (1, closed.shape[0], rows // 2, columns // 2))
    return _table(state, OPEN_FINE_PRODUCTS, products=products, scaling=scaling, fine=head)


def _table(state: PipelineState, kernel: Kernel, **tensors: Tensor) -> ArgumentTable:
    taken = IN_HALF.get(kernel, kernel) if _is_half(state) else kernel
    return ArgumentTable(state.device.compute_state(taken), tensors)


def _is_half(state: PipelineState) -> bool:
    """Whether heads and features stay in half precision: beside such a network on a GPU."""
    return state.device.gpu is not None and f"{PACKED}features" in state.shapes


def _codes_features(state: PipelineState) -> bool:
    """Whether the features are made in 8 bits: for such a network on a CPU."""
    return state.device.runs_rows and f"{STORED}features" in state.shapes


def _dispatch(commands: CommandBuffer, label: str, steps: list[list[ArgumentTable]], after: tuple[str, ...]) -> None:
    with commands.compute_encoder(label) as encoder:
        encoder.barrier(after=after, before="compute")
        for number, tables in enumerate(steps):
            if number:
                encoder.barrier()
            for table in tables:
                encoder.dispatch(table.state, table)


PLAIN, GUIDED, UNSCALED = "plain", "guided", "unscaled"
ENDS = {PLAIN: (REMODULATE, UPSAMPLE), GUIDED: (REMODULATE_BOTH, UPSAMPLE_GUIDED),
        UNSCALED: (REMODULATE_BOTH, UPSAMPLE_UNSCALED)}
"""Kernels that put the reflectance back and enlarge: before, with that of guides, or after, at the render size."""
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


class Graph:
    """Pipeline states, tensors and argument tables for windows of one size.

    A guided graph's models also read guides, and colour gets the guides' reflectance at output size, as far as it is
    trusted. A reactive graph can use masks of how much history counts. Models that doubt planes also read their mean.
    Where layers are filtered, too, the `whole` fine head is kept for them.
    """

    def __init__(self, device: Device, window: Window, models: Sequence[str], guided: bool = False,
                 reactive: bool = False, whole: bool = False) -> None:
        self._device, self._window, self._guided, self._reactive = device, window, guided, reactive
        dims = free_dimensions(window.padded_size)
        networks = {model: load_network(device, model, dims) for model in models}
        for state in networks.values():
            check_bindings(state)
        self._forms = {model: HALF if _is_half(state) else CODED if state.products and not whole else WHOLE
                       for model, state in networks.items()}
        self._tables = self._new_tables()
        self._places: LRUCache[Window, dict[str, dict[str, Tensor]]] = LRUCache(MOST_PLACES)
        between = cache(self._new)  # of several networks only one runs in a frame
        self._heads = {model: self._heads_of(state, self._forms[model], between) for model, state in networks.items()}
        self._doubting = {model for model in models if doubts_planes(model)}
        self._ends = {model: self._end_of(model) for model in models}
        self._make_tensors(networks[models[0]])
        self._seen |= {name: between(name, state.shapes[name], "float16") for model, state in networks.items()
                       for name in IN_HALF[FEATURE].writes if self._forms[model] == HALF and name in state.shapes}
        self._make_tables(all(map(_codes_features, networks.values())))
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
        """
        warped = self._made["warped"] if moves else tensors["history"]
        end, doubts = self._ends[model], model in self._doubting
        known = {"warped": warped, "keep": self._keep(tensors, masked), "fine": self._heads[model]["fine"],
                 "means": self._means if doubts else self._no_means, **self._networks[model].coded}
        tables = self._tables[self._forms[model]] | self._networks[model].looks
        self._bind(tables, {**self._made, **tensors, **known}, self._place(window), self._heads[model])
        with commands.compute_encoder("prepare") as encoder:
            encoder.barrier(after=("compute", "machine-learning"), before="compute")
            self._run(encoder, tables, "dilate", *("means",) * doubts)
            for names in (("history",) * moves + ("keep",) * masked, self._looks):
                encoder.barrier()
                self._run(encoder, tables, *names)
        self._networks[model].encode(commands)
        with commands.compute_encoder("filter") as encoder:
            encoder.barrier(after=("compute", "machine-learning"), before="compute")
            for i, name in enumerate((*self._filter_order, f"remodulate {end}")):
                if i:
                    encoder.barrier()
                self._run(encoder, tables, name)
        with commands.compute_encoder("upsample") as encoder:
            encoder.barrier(after="compute", before="compute")
            self._run(encoder, tables, f"upsample {end}")

    def _keep(self, tensors: Mapping[str, Tensor], masked: bool) -> Tensor:
        """How much of the history counts, pixel by pixel or in one number."""
        return self._made["keep"] if masked else tensors["keep"]

    def _end_of(self, model: str) -> str:
        frame = self._window.frame
        unscaled = (frame.h, frame.w) == (frame.height, frame.width)
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
        for name, values in alike_heads(network).items():
            size = (1, values.shape[1], *self._window.level(int(name[-1])))
            heads[name] = upload(self._device.heap, name, np.broadcast_to(values, size).astype(dtype), dtype)
        return heads

    def _make_tensors(self, network: PipelineState) -> None:
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
        self._seen = {name: self._new(name, shape) for name, shape in seen_by(network).items()}

    def _new_tables(self) -> Tables:
        return {form: {} for form in self._forms.values()}

    def _make_tables(self, coded: bool) -> None:
        level = self._window.level
        accumulated = self._new("level 0", (4, *level(0)))
        self._importance = [accumulated.view("importance 0", (1, *level(0)), 3 * math.prod(level(0)))]
        self._importance += [self._new(f"importance {i}", (1, *level(i))) for i in range(1, LEVELS + 1)]
        self._radiance: dict[str, Tensor] = {}
        filtered, self._filter_order = self._make_pyramid(self._tables, accumulated.view("light 0", (3, *level(0))))
        made = self._made | self._seen | {"level": accumulated, "filtered": filtered}
        self._looks = ("features", "guides", "trust") if self._guided else ("features",)
        kernels = (("dilate", DILATE), ("history", HISTORY), ("accumulate", ACCUMULATE), ("features", FEATURE))
        for name, kernel in kernels[:3] if coded else kernels:
            self._table(self._tables, name, kernel, **made)
        for end in set(self._ends.values()):
            size = (3 if end == PLAIN else 6, self._window.rows + 2, self._window.columns + 2)
            radiance = self._radiance[end] = self._new(f"radiance {end}", size)
            for name, kernel in zip(("remodulate", "upsample"), ENDS[end], strict=True):
                self._table(self._tables, f"{name} {end}", kernel, **made, radiance=radiance)
        if self._doubting:
            self._table(self._tables, "means", MEANS, means=self._means)
        if self._reactive:
            self._table(self._tables, "keep", KEEP, **made)
        if self._guided:
            self._table(self._tables, "guides", GUIDE, **made)
            self._table(self._tables, "trust", TRUST, **made)

    def _make_pyramid(self, tables: Tables, light: Tensor) -> tuple[Tensor, list[str]]:
        """Make the tables of the filters, for light (3 n, hp, wp) of the picture or of n parts; returns the filtered
        light, and the tables' order behind 'accumulate'."""
        def new(name: str, i: int) -> Tensor:
            return self._new(f"{name} {i}", (light.shape[0], *self._window.level(i)))

        levels, order = [light, *(new("level", i) for i in range(1, LEVELS + 1))], ["accumulate"]
        for i in range(1, LEVELS + 1):
            self._table(tables, f"pool {i}", POOL, finer=levels[i - 1], finer_importance=self._importance[i - 1],
                        level=levels[i], importance=self._importance[i])
            order.append(f"pool {i}")
        filtered = [new("filtered", i) for i in range(LEVELS + 1)]
        for i in range(LEVELS, -1, -1):
            mixed = levels[i] if i == LEVELS else new("mixed", i)
            if i < LEVELS:
                self._table(tables, f"mix {i}", MIX_LEVELS, coarse=filtered[i + 1], level=levels[i], mixed=mixed)
                order.append(f"mix {i}")
            self._table(tables, f"filter {i}", FILTER, mixed=mixed, filtered=filtered[i])
            order.append(f"filter {i}")
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
        """Tensors that describe a window to the kernels, by binding: for each table of the pyramid, '' for others."""
        return self._places.get_or_make(window, lambda: {
            table: {name: upload(self._device.heap, name, array) for name, array in values.items()}
            for table, values in _places(window).items()})

    def _bind(self, tables: Mapping[str, ArgumentTable], tensors: Mapping[str, Tensor],
              places: Mapping[str, Mapping[str, Tensor]], heads: Mapping[str, Tensor]) -> None:
        """Bind what changes from window to window, from frame to frame and from layer to layer."""
        for name, table in tables.items():
            known = {**tensors, **places.get(name, places[""])}
            if name.startswith(("filter ", "mix ")):
                known["heads"] = heads["fine" if name[-1] == "0" else f"level{name[-1]}"]
            for binding in table.state.bindings:
                if binding.name in known:
                    table[binding.name] = known[binding.name]

    def _run(self, encoder: ComputeEncoder, tables: Mapping[str, ArgumentTable], *names: str) -> None:
        for name in names:
            encoder.dispatch(tables[name].state, tables[name])


def _places(window: Window) -> dict[str, dict[str, np.ndarray]]:
    """Arrays that describe a window to the kernels: for each table of the pyramid, and under '' for all other
    tables."""
    places = {"": window.places()}
    for i in range(LEVELS + 1):
        places[f"filter {i}"] = {"area": window.area(i)}
    for i in range(LEVELS):
        places[f"mix {i}"] = dict(zip(("coarse_rows", "coarse_columns"), window.coarser(i), strict=True))
        places[f"pool {i + 1}"] = dict(zip(("finer_rows", "finer_columns"), window.finer(i + 1), strict=True))
    return places


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
        stages = [("prepare", [["dilate"], ["keep"] * masked, ["gather"]]),
                  ("filter", [[name] for name in self._order]), ("upsample", [["resolve"]])]
        for label, steps in stages:
            with commands.compute_encoder(label) as encoder:
                encoder.barrier(after=("compute", "machine-learning"), before="compute")
                for k, names in enumerate(filter(None, steps)):
                    if k:
                        encoder.barrier()
                    for name in names:
                        encoder.dispatch(self._tables[name].state, self._tables[name])

    def _place(self, window: Window) -> dict[str, Tensor]:
        """Tensors that describe a window to the kernels, by binding."""
        return self._places.get_or_make(window, lambda: {
            name: upload(self._device.heap, name, array) for name, array in window.places().items()})
