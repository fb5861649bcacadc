"""Runs a window's filters on layers beside the picture: its parts, and alpha."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from postfx.kernels.denoise.parts import ACCUMULATE_PART, REFLECT, UPSAMPLE_LIGHT
from postfx.kernels.denoise.pyramid import ENLARGE_ALPHA, LEVEL, REMODULATE
from postfx.passes.denoise.history import ALPHA_LAYER, alone, one_of, some_of
from postfx.passes.denoise.network import PLAIN, Graph, Tables, upload
from postfx.passes.denoise.tiling import Window
from postfx.runtime import ArgumentTable, CommandBuffer, ComputeEncoder, Tensor

OWN = ("reflectance", "accumulate", "remodulate")
"""Kernels that run on each layer by itself."""
TOGETHER = 3
"""Layers that are filtered at once: of each further one the weights are not read from memory again, but its
intermediate results take memory."""


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
            encoder.barrier(after="compute", before="compute")
            for name in ("reflectance", *self._filter_order, "remodulate") if accumulates else ():
                for own in each if name in OWN else ({},):
                    if name != "reflectance" or "diffuse_albedo" in own:
                        self._run_with(encoder, tables[name], own)
                encoder.barrier()
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
            for i, name in enumerate(("level", *self._alpha_order[1:], "enlarge")):
                encoder.barrier(**{} if i else {"after": "compute", "before": "compute"})
                self._run(encoder, tables, name)

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
