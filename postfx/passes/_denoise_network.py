"""How one network of the denoised upscaler is dispatched: with kernels of its own behind it, and before it where it
computes in half precision."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping

from postfx.kernels import denoise_half, denoise_layout
from postfx.kernels.denoise_open import OPEN_PHASED
from postfx.kernels.kernel import Kernel
from postfx.runtime import ArgumentTable, CommandBuffer, PipelineState, Tensor

PACKED, RAW = "packed_", "raw_"
"""Begin the names of inputs and outputs that are in half precision, channels last."""
PHASED_FINE = "phased_fine"
"""The fine head in float32 without its activations, the phases of each channel one after the other."""
CHANNELS = {"features": denoise_layout.FEATURES, "guides": denoise_layout.GUIDES}
FEATURE_PARTS = {"first_features": 32, "last_features": denoise_layout.FEATURES - 32}
"""Channels of the features that networks in float32 read apart: a CPU is quickest with multiples of 16 and with few."""


def seen_by(state: PipelineState) -> dict[str, tuple[int, ...]]:
    """Shapes of what kernels prepare for a network, by name."""
    seen = {}
    for binding in state.bindings:
        name, size = binding.name.removeprefix(PACKED), binding.shape
        if name in FEATURE_PARTS:
            seen["features"] = (1, CHANNELS["features"], *size[2:])
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
    heads = {}
    for binding in state.bindings:
        name, size = binding.name.removeprefix(RAW), binding.shape
        if binding.name == PHASED_FINE:
            heads["fine"] = denoise_half.opened("fine", *size[2:])
        elif binding.access == "write":
            heads[name] = size if name == binding.name else denoise_half.opened(name, *size[1:3])
    return heads


class Network:
    """A network that reads `seen` and writes `heads`, both by name; `new` makes what lies between it and them."""

    def __init__(self, state: PipelineState, seen: Mapping[str, Tensor], heads: Mapping[str, Tensor],
                 new: Callable[[str, tuple[int, ...], str], Tensor]) -> None:
        made = {b.name: new(b.name, b.shape, b.dtype) for b in state.bindings
                if b.name.startswith((PACKED, RAW, PHASED_FINE))}
        known = {**parts_of(seen["features"]), **seen, **heads, **made}
        self._table = ArgumentTable(state, {binding.name: known[binding.name] for binding in state.bindings})
        packed = [name for name in made if name.startswith(PACKED)]
        closed = [name for name in made if name.startswith((RAW, PHASED_FINE))]
        self._before = [_table(state, denoise_half.PACK, planes=seen[name.removeprefix(PACKED)], packed=made[name])
                        for name in packed]
        self._after = [_opener(state, made[name], heads) for name in closed]

    def encode(self, commands: CommandBuffer) -> None:
        """Record the network's run, which waits for the kernels before it."""
        if self._before:
            _dispatch(commands, "pack", self._before, ("compute", "machine-learning"))
        with commands.machine_learning_encoder("network") as encoder:
            encoder.barrier(after="compute", before="machine-learning")
            encoder.dispatch_network(self._table.state, self._table)
        if self._after:
            _dispatch(commands, "open", self._after, ("compute", "machine-learning"))


def _opener(state: PipelineState, closed: Tensor, heads: Mapping[str, Tensor]) -> ArgumentTable:
    if closed.name == PHASED_FINE:
        return _table(state, OPEN_PHASED, phased_fine=closed, fine=heads["fine"])
    if closed.name == f"{RAW}fine":
        return _table(state, denoise_half.OPEN_FINE, raw_fine=closed, fine=heads["fine"])
    return _table(state, denoise_half.OPEN, raw=closed, heads=heads[closed.name.removeprefix(RAW)])


def _table(state: PipelineState, kernel: Kernel, **tensors: Tensor) -> ArgumentTable:
    return ArgumentTable(state.device.compute_state(kernel), tensors)


def _dispatch(commands: CommandBuffer, label: str, tables: list[ArgumentTable], after: tuple[str, ...]) -> None:
    with commands.compute_encoder(label) as encoder:
        encoder.barrier(after=after, before="compute")
        for table in tables:
            encoder.dispatch(table.state, table)
