"""A network of the denoiser, with the kernels that pack its inputs and open its outputs."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from itertools import zip_longest

import numpy as np

from postfx.kernels import Kernel
from postfx.kernels.denoise import FEATURES, FINE, GUIDES, IN_HALF, MIRRORED
from postfx.kernels.denoise.network_io import (
    FOURS,
    OPEN,
    OPEN_CODES,
    OPEN_FINE,
    OPEN_FINE_CODES,
    OPEN_FINE_PRODUCTS,
    OPEN_LOGITS,
    OPEN_PHASED,
    OPEN_PRODUCTS,
    OPEN_SOME_PRODUCTS,
    PACK,
    SOME,
    STORE,
    STORE_RINGED,
    opened_shape,
)
from postfx.runtime import CommandBuffer, ModelError, PipelineState, Tensor
from postfx.runtime.tensor import TensorHeap

PACKED, RAW = "packed_", "raw_"
"""Prefix of the names of inputs and outputs in half precision, channels last."""
PHASED_FINE = "phased_fine"
"""The fine head in float32 before its activations, with the four phases of each channel in a
row."""
FINE_LOGITS = "fine_logits"
"""The fine head in float32 before its activations, of a network whose last level has the render
size."""
ERROR = "error"
"""The logarithm of each pixel's expected squared error."""
PICTURE, CONTROLS_NAME = "picture", "controls"
"""Outputs of a network that gives the picture itself, log(1 + exposed light), and controls it and
the history."""
STORED, CODING = "stored_", "coding_"
"""Prefixes of the names of 8-bit inputs, channels last, and of the constants that tell how they are
coded."""
PRODUCTS, SCALING = "products_", "scaling_"
"""Prefixes of the names of integer outputs, (C, h * w), and of the constants that scale them."""
CODES_NAME = "codes_"
"""Prefix of the names of 8-bit outputs, channels last, of which kernels make such products."""
RING = 1
"""Border in pixels around 8-bit inputs, for networks whose first convolution reads beyond the
picture."""
MADE = (PACKED, RAW, PHASED_FINE, FINE_LOGITS, STORED, PRODUCTS, CODES_NAME)
CHANNELS = {"features": FEATURES, "guides": GUIDES, "mirrored": MIRRORED}
FEATURE_PARTS = {"first_features": 32, "last_features": FEATURES - 32}
"""Feature channels that float32 networks read as inputs of their own: a CPU is fastest with few, or
multiples of 16."""


Run = tuple[Kernel, dict[str, Tensor]]
"""A kernel, and its tensors by binding."""


def free_dimensions(size: tuple[int, int]) -> dict[str, int]:
    """Networks' names for height and width: of the features, and of features with a border of one
    pixel."""
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
        heads[name] = ((1, FINE, *seen) if name == "fine"
                       else (1, count, *(side >> int(name[-1]) for side in seen)))
    for binding in state.bindings:
        name, size = binding.name.removeprefix(RAW), state.shapes[binding.name]
        if binding.name == PHASED_FINE:
            heads["fine"] = opened_shape("fine", *size[2:])
        elif binding.name == FINE_LOGITS:
            heads["fine"] = size
        elif binding.access == "write" and not binding.name.startswith((PRODUCTS, CODES_NAME)):
            heads[name] = size if name == binding.name else opened_shape(name, *size[1:3])
    return heads


def check_bindings(state: PipelineState) -> None:
    """ModelError for a network that is not a denoiser. Kernels prepare its inputs and take its
    outputs by name."""
    coded = re.compile(f"^({PACKED}|{RAW}|{STORED}|{PRODUCTS}|{CODES_NAME})")
    plain = {binding.name: coded.sub("", binding.name) for binding in state.bindings}
    reads = {b.name for b in state.bindings if b.access == "read"}
    strange = [name for name in reads if plain[name] not in (*CHANNELS, *FEATURE_PARTS)]
    gives = {plain[b.name] for b in state.bindings if b.access == "write"} | set(state.constants)
    if (strange or "features" not in seen_by(state)
        or not {"fine", PHASED_FINE, FINE_LOGITS, PICTURE} & gives):
        raise ModelError(f"model '{state.name}' is not a denoiser: it reads "
                         f"{', '.join(sorted(reads)) or 'nothing'} and gives "
                         f"{', '.join(sorted(gives)) or 'nothing'}; training.denoise.export makes "
                         "one")


def alike_heads(state: PipelineState) -> dict[str, np.ndarray]:
    """Heads of the levels that a network does not compute, (1, C, 1, 1) by name: one value for all
    pixels."""
    return {name: array
            for name, array in state.constants.items() if not name.startswith((CODING, SCALING))}


class Network:
    """A network that reads `seen` and writes `heads`, both by name; `new` makes the tensors in
    between.

    Attributes:
        stored: what a CPU's kernel for features writes in 8 bits, by its bindings; empty for other
            networks.
        coded: what other kernels make the fine head of, by their bindings, if the network leaves it
            to them.
    """

    def __init__(self, state: PipelineState, seen: Mapping[str, Tensor],
                 heads: Mapping[str, Tensor],
                 new: Callable[[str, tuple[int, ...], str], Tensor]) -> None:
        unmarked = [binding.name
                    for binding in state.bindings if binding.name.startswith((CODING, SCALING))]
        if unmarked:
            raise ModelError(f"network '{state.name}': no card beside it marks "
                             f"{', '.join(unmarked)} as constant; take the card that it was made "
                             "with, or make both again with training.denoise.quantise")
        made = {b.name: heads.get(b.name) or new(b.name, state.shapes[b.name], b.dtype)
                for b in state.bindings if b.name.startswith(MADE)}
        constants = {name: upload(state.device.heap, name, array)
                     for name, array in state.constants.items()
                     if name.startswith((CODING, SCALING))}
        known = {**parts_of(seen["features"]), **seen, **heads, **made}
        self._state, self._tensors = state, {binding.name: known[binding.name]
                                             for binding in state.bindings}
        packed = [name for name in made if name.startswith((PACKED, STORED)) and name not in seen]
        self.stored = dict[str, Tensor]()
        if codes_features(state):
            packed.remove(name := f"{STORED}features")
            self.stored = {"coding": constants[f"{CODING}features"], "stored": made[name]}
        closed = [name
                  for name in made if name.startswith((RAW, PHASED_FINE, FINE_LOGITS, PRODUCTS))]
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
        self._after = [run for step in zip_longest(*openers) for run in step if run]
        state.device.make_ready(*(kernel for kernel, _ in (*self._before, *self._after)))

    def encode(self, commands: CommandBuffer) -> None:
        """Record the network's run, which waits for the kernels before it."""
        for kernel, tensors in self._before:
            commands.run(kernel, "pack", **tensors)
        commands.run(self._state, "network", **self._tensors)
        for kernel, tensors in self._after:
            commands.run(kernel, "open", **tensors)


def _packer(state: PipelineState, packed: Tensor, constants: Mapping[str, Tensor],
            seen: Mapping[str, Tensor]) -> Run:
    if packed.name.startswith(PACKED):
        return _run(state, PACK, planes=seen[packed.name.removeprefix(PACKED)], packed=packed)
    name = packed.name.removeprefix(STORED)
    kernel = STORE if packed.shape[1] == seen[name].shape[2] else STORE_RINGED
    return _run(state, kernel, planes=seen[name], coding=constants[f"{CODING}{name}"],
                stored=packed)


def upload(heap: TensorHeap, name: str, array: np.ndarray, dtype: str = "float32") -> Tensor:
    """A tensor that holds an array from now on."""
    tensor = heap.tensor(name, array.shape, dtype)
    tensor.upload(array)
    return tensor


def _openers(state: PipelineState, closed: Tensor, constants: Mapping[str, Tensor],
             heads: Mapping[str, Tensor]) -> list[Run]:
    """Kernels to run in turn. Of products behind the fine head in one memory, some take the place
    of those before."""
    if closed.name not in heads:
        return [_opener(state, closed, constants, heads)]
    fine, (_, count, rows, columns), runs = heads["fine"], heads["fine"].shape, []
    for channel in range(0, count, SOME):
        some, at = min(SOME, count - channel), channel * rows * columns
        runs.append(_run(
            state, OPEN_SOME_PRODUCTS, scaling=constants[f"{SCALING}fine"],
            first=upload(state.device.heap, "first", np.full(1, channel, np.float32)),
            products=closed.view(closed.name, (1, 4 * some, rows // 2, columns // 2), at),
            fine=fine.view("fine", (1, some, rows, columns), at)))
    return runs


def _code_opener(state: PipelineState, head: Tensor, coded: Mapping[str, Tensor],
                 fine: bool) -> Run:
    if not fine:
        return _run(state, OPEN_CODES, **coded, heads=head)
    _, count, rows, columns = head.shape
    return _run(state, OPEN_FINE_CODES, **coded,
                fine=head.view("fine", (1, count, rows // 2, 2, columns)))


def _opener(state: PipelineState, closed: Tensor, constants: Mapping[str, Tensor],
            heads: Mapping[str, Tensor]) -> Run:
    if closed.name == PHASED_FINE:
        return _run(state, OPEN_PHASED, phased_fine=closed, fine=heads["fine"])
    if closed.name == FINE_LOGITS:
        return _run(state, OPEN_LOGITS, fine_logits=closed, fine=heads["fine"])
    if closed.name == f"{RAW}fine":
        return _run(state, OPEN_FINE, raw_fine=closed, fine=heads["fine"])
    if closed.name.startswith(RAW):
        return _run(state, OPEN, raw=closed, heads=heads[closed.name.removeprefix(RAW)])
    name = closed.name.removeprefix(PRODUCTS)
    head, scaling, (rows,
                    columns) = heads[name], constants[f"{SCALING}{name}"], heads[name].shape[2:]
    if name != "fine":
        products = closed.view(closed.name, head.shape)
        return _run(state, OPEN_PRODUCTS, products=products, scaling=scaling, heads=head)
    products = closed.view(closed.name, (1, closed.shape[0], rows // 2, columns // 2))
    return _run(state, OPEN_FINE_PRODUCTS, products=products, scaling=scaling, fine=head)


def _run(state: PipelineState, kernel: Kernel, **tensors: Tensor) -> Run:
    return IN_HALF.get(kernel, kernel) if is_half(state) else kernel, tensors


def is_half(state: PipelineState) -> bool:
    """Whether heads and features stay in half precision: beside such a network on a GPU."""
    return state.device.gpu is not None and f"{PACKED}features" in state.shapes


def codes_features(state: PipelineState) -> bool:
    """Whether the features are made in 8 bits: for such a network on a CPU."""
    return state.device.runs_rows and f"{STORED}features" in state.shapes
