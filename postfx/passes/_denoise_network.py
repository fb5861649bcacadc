"""How one network of the denoised upscaler is dispatched: with kernels of its own behind it, and before it where it
computes in half precision or in integers."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping

import numpy as np

from postfx.kernels import denoise_half, denoise_layout
from postfx.kernels.denoise_open import OPEN_PHASED
from postfx.kernels.denoise_products import OPEN_FINE_PRODUCTS, OPEN_PRODUCTS
from postfx.kernels.denoise_store import STORE, STORE_RINGED
from postfx.kernels.kernel import Kernel
from postfx.runtime import ArgumentTable, CommandBuffer, ModelError, PipelineState, Tensor

PACKED, RAW = "packed_", "raw_"
"""Begin the names of inputs and outputs that are in half precision, channels last."""
PHASED_FINE = "phased_fine"
"""The fine head in float32 without its activations, the phases of each channel one after the other."""
STORED, CODING = "stored_", "coding_"
"""Begin the names of inputs in 8 bits, channels last, and of the constants that say how they are coded."""
PRODUCTS, SCALING = "products_", "scaling_"
"""Begin the names of outputs in integers, (C, h * w), and of the constants that they are scaled by."""
RING = 1
"""Pixels around a picture in 8 bits, of networks whose first convolution reads beyond its border."""
MADE = (PACKED, RAW, PHASED_FINE, STORED, PRODUCTS)
CHANNELS = {"features": denoise_layout.FEATURES, "guides": denoise_layout.GUIDES}
FEATURE_PARTS = {"first_features": 32, "last_features": denoise_layout.FEATURES - 32}
"""Channels of the features that networks in float32 read apart: a CPU is quickest with multiples of 16 and with few."""


def free_dimensions(size: tuple[int, int]) -> dict[str, int]:
    """What networks call their sides: those of the features, and of features with a ring of pixels around them."""
    (h, w), ring = size, 2 * RING
    return {"height": h, "width": w, "ringed_height": h + ring, "ringed_width": w + ring}


def stored_channels(name: str) -> int:
    """Channels that 'features' or 'guides' have in 8 bits."""
    return -(-CHANNELS[name] // 4) * 4


def seen_by(state: PipelineState) -> dict[str, tuple[int, ...]]:
    """Shapes of what kernels prepare for a network, by name."""
    seen = {}
    for binding in state.bindings:
        name, size = binding.name.removeprefix(PACKED), binding.shape
        if name in FEATURE_PARTS:
            seen["features"] = (1, CHANNELS["features"], *size[2:])
        elif name.startswith(STORED):  # with a ring of pixels around it, or without
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
    """Shapes of the activated heads that a network gives, by name."""
    heads, seen = {}, seen_by(state)["features"][2:]
    for binding in state.bindings:
        name, size = binding.name.removeprefix(RAW), binding.shape
        if binding.name == PHASED_FINE:
            heads["fine"] = denoise_half.opened("fine", *size[2:])
        elif binding.name.startswith(PRODUCTS):
            name = name.removeprefix(PRODUCTS)
            heads[name] = (1, denoise_layout.FINE, *seen) if name == "fine" else (
                1, size[0], *(side >> int(name[-1]) for side in seen))
        elif binding.access == "write":
            heads[name] = size if name == binding.name else denoise_half.opened(name, *size[1:3])
    return heads


def alike_heads(state: PipelineState) -> dict[str, np.ndarray]:
    """Heads of levels that a network does not compute, (1, C, 1, 1) by name: they are the same at all pixels."""
    return {name: array for name, array in state.constants.items() if not name.startswith((CODING, SCALING))}


class Network:
    """A network that reads `seen` and writes `heads`, both by name; `new` makes what lies between it and them."""

    def __init__(self, state: PipelineState, seen: Mapping[str, Tensor], heads: Mapping[str, Tensor],
                 new: Callable[[str, tuple[int, ...], str], Tensor]) -> None:
        unmarked = [binding.name for binding in state.bindings if binding.name.startswith((CODING, SCALING))]
        if unmarked:
            raise ModelError(f"network '{state.name}': no card beside it marks {', '.join(unmarked)} as constant; take "
                             "the card that it was made with, or make both again with training.denoise.quantise")
        made = {b.name: new(b.name, b.shape, b.dtype) for b in state.bindings if b.name.startswith(MADE)}
        constants = {name: _kept(state, name, array) for name, array in state.constants.items()
                     if name.startswith((CODING, SCALING))}
        known = {**parts_of(seen["features"]), **seen, **heads, **made}
        self._table = ArgumentTable(state, {binding.name: known[binding.name] for binding in state.bindings})
        packed = [name for name in made if name.startswith((PACKED, STORED))]
        closed = [name for name in made if name.startswith((RAW, PHASED_FINE, PRODUCTS))]
        self._before = [_packer(state, made[name], constants, seen) for name in packed]
        self._after = [_opener(state, made[name], constants, heads) for name in closed]

    def encode(self, commands: CommandBuffer) -> None:
        """Record the network's run, which waits for the kernels before it."""
        if self._before:
            _dispatch(commands, "pack", self._before, ("compute", "machine-learning"))
        with commands.machine_learning_encoder("network") as encoder:
            encoder.barrier(after="compute", before="machine-learning")
            encoder.dispatch_network(self._table.state, self._table)
        if self._after:
            _dispatch(commands, "open", self._after, ("compute", "machine-learning"))


def _packer(state: PipelineState, packed: Tensor, constants: Mapping[str, Tensor],
            seen: Mapping[str, Tensor]) -> ArgumentTable:
    if packed.name.startswith(PACKED):
        return _table(state, denoise_half.PACK, planes=seen[packed.name.removeprefix(PACKED)], packed=packed)
    name = packed.name.removeprefix(STORED)
    kernel = STORE if packed.shape[1] == seen[name].shape[2] else STORE_RINGED
    return _table(state, kernel, planes=seen[name], coding=constants[f"{CODING}{name}"], stored=packed)


def _kept(state: PipelineState, name: str, array: np.ndarray) -> Tensor:
    tensor = state.device.heap.tensor(name, array.shape)
    tensor.upload(array)
    return tensor


def _opener(state: PipelineState, closed: Tensor, constants: Mapping[str, Tensor],
            heads: Mapping[str, Tensor]) -> ArgumentTable:
    if closed.name == PHASED_FINE:
        return _table(state, OPEN_PHASED, phased_fine=closed, fine=heads["fine"])
    if closed.name == f"{RAW}fine":
        return _table(state, denoise_half.OPEN_FINE, raw_fine=closed, fine=heads["fine"])
    if closed.name.startswith(RAW):
        return _table(state, denoise_half.OPEN, raw=closed, heads=heads[closed.name.removeprefix(RAW)])
    name = closed.name.removeprefix(PRODUCTS)
    head, scaling, (rows, columns) = heads[name], constants[f"{SCALING}{name}"], heads[name].shape[2:]
    if name != "fine":
        products = closed.view(closed.name, head.shape)
        return _table(state, OPEN_PRODUCTS, products=products, scaling=scaling, heads=head)
    products = closed.view(closed.name, (1, closed.shape[0], rows // 2, columns // 2))
    return _table(state, OPEN_FINE_PRODUCTS, products=products, scaling=scaling, fine=head)


def _table(state: PipelineState, kernel: Kernel, **tensors: Tensor) -> ArgumentTable:
    return ArgumentTable(state.device.compute_state(kernel), tensors)


def _dispatch(commands: CommandBuffer, label: str, tables: list[ArgumentTable], after: tuple[str, ...]) -> None:
    with commands.compute_encoder(label) as encoder:
        encoder.barrier(after=after, before="compute")
        for table in tables:
            encoder.dispatch(table.state, table)
