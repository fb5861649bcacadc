"""What the denoised upscaler runs for one window of a frame: tensors, argument tables and the order of the commands."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import cache

import numpy as np

from postfx.kernels import (
    denoise_features,
    denoise_filter,
    denoise_guides,
    denoise_history,
    denoise_layout,
    denoise_prepare,
    denoise_reactive,
    denoise_upsample,
)
from postfx.kernels.kernel import Kernel
from postfx.passes._denoise_network import Network, alike_heads, free_dimensions, heads_of, seen_by
from postfx.passes._denoise_window import Window
from postfx.runtime import ArgumentTable, CommandBuffer, ComputeEncoder, Device, Library, PipelineState, Tensor

LEVELS = 4
ENDS = {False: (denoise_filter.REMODULATE, denoise_upsample.UPSAMPLE),
        True: (denoise_filter.REMODULATE_GUIDED, denoise_upsample.UPSAMPLE_GUIDED)}
"""Kernels that put the reflectance back and enlarge, without guides and with them."""
MOST_PLACES = 64
"""Windows of a graph's size whose places are kept on the device."""


def has_model(model: str) -> bool:
    """Whether a model comes with postfx."""
    return model in Library().names()


def grid_of(models: Iterable[str]) -> int:
    """Pixels of the render size in a place of the coarsest level that one of some models computes: what the sides of
    its input are multiples of."""
    return max(_grid(Library().card(model).get("outputs", {}) if has_model(model) else {}) for model in models)


def _grid(outputs: Mapping[str, Mapping]) -> int:
    levels = [int(name[-1]) for name, facts in outputs.items() if "level" in name and not facts.get("constant")]
    return 2 ** max(levels, default=LEVELS)


def name_models(device: Device, models: Iterable[str]) -> None:
    """Name those of some models that come with postfx, which may run later."""
    library = Library()
    for model in set(models) & set(library.names()):
        device.name_model(library, model)


class Graph:
    """Pipeline states, tensors and argument tables for windows of one size.

    A guided graph's models read guides beside the features, and colour gets their reflectance at output size, as far
    as they are trusted. A reactive one may work with masks of where the history is not used.
    """

    def __init__(self, device: Device, window: Window, models: Sequence[str], guided: bool = False,
                 reactive: bool = False) -> None:
        self._device, self._window, self._guided, self._reactive = device, window, guided, reactive
        dims = free_dimensions(window.padded)
        networks = {model: device.pipeline_state(Library(), model, dims) for model in models}
        self._tables: dict[str, ArgumentTable] = {}
        self._places: dict[Window, dict[str, Tensor]] = {}
        between = cache(self._new)  # of several networks only one runs in a frame
        self._heads = {model: self._heads_of(state, between) for model, state in networks.items()}
        self._make_tensors(networks[models[0]])
        self._make_tables(self._heads[models[0]]["fine"])
        self._networks = {model: Network(state, self._seen, self._heads[model], between)
                          for model, state in networks.items()}

    def encode(self, commands: CommandBuffer, window: Window, model: str, tensors: Mapping[str, Tensor],
               moves: bool, masked: bool) -> None:
        """Record the work on a window of this graph's size.

        Args:
            tensors: the frame's planes, history and what there is one of in a frame, and what is to be written, by the
                kernels' names.
            moves: whether the last output has to be brought to this frame; else it is read as it is, in a window of the
                whole frame: it is where it should be, or of no account.
            masked: whether the reactive masks of this frame and the last say how much of the history each pixel keeps;
                else one number does.
        """
        warped = self._made["warped"] if moves else tensors["history"]
        keep = self._made["keep"] if masked else tensors["keep"]
        self._bind({**tensors, "warped": warped, "keep": keep}, self._place(window), self._heads[model])
        with commands.compute_encoder("prepare") as encoder:
            encoder.barrier(after=("compute", "machine-learning"), before="compute")
            self._run(encoder, "dilate")
            for names in (("history",) * moves + ("keep",) * masked, self._looks):
                encoder.barrier()
                self._run(encoder, *names)
        self._networks[model].encode(commands)
        with commands.compute_encoder("filter") as encoder:
            encoder.barrier(after=("compute", "machine-learning"), before="compute")
            for i, name in enumerate(self._filter_order):
                if i:
                    encoder.barrier()
                self._run(encoder, name)
        with commands.compute_encoder("upsample") as encoder:
            encoder.barrier(after="compute", before="compute")
            self._run(encoder, "upsample")

    def _new(self, name: str, shape: tuple[int, ...], dtype: str = "float32") -> Tensor:
        return self._device.heap.transient(name, shape, dtype)

    def _kept(self, name: str, shape: tuple[int, ...]) -> Tensor:
        return self._device.heap.tensor(name, shape)

    def _heads_of(self, network: PipelineState, between: Callable[..., Tensor]) -> dict[str, Tensor]:
        """What the filters read of a network by name; of levels that it does not compute, what holds for all pixels."""
        heads = {name: between(name, shape) for name, shape in heads_of(network).items()}
        for name, values in alike_heads(network).items():
            heads[name] = self._kept(name, (1, values.shape[1], *self._window.level(int(name[-1]))))
            heads[name].upload(np.broadcast_to(values, heads[name].shape))
        return heads

    def _make_tensors(self, network: PipelineState) -> None:
        rows, columns, out = self._window.rows, self._window.columns, self._window.out
        self._made = {"moved": self._new("moved", (rows, columns, 2)), "past": self._new("past", (rows, columns, 4)),
                      "warped": self._new("warped", (out.rows, out.columns, 3)),
                      "radiance": self._new("radiance", (6 if self._guided else 3, rows + 2, columns + 2))}
        if self._guided:
            cells = (-(-side // denoise_layout.TRUST_CELL) for side in (rows, columns))
            self._made["trust"] = self._new("trust", (*cells, 1))
        if self._reactive:
            self._made["keep"] = self._new("keep", (rows, columns, 1))
        self._seen = {name: self._new(name, shape) for name, shape in seen_by(network).items()}

    def _make_tables(self, fine: Tensor) -> None:
        level = self._window.level
        levels = [self._new(f"level {i}", (4, *level(i))) for i in range(LEVELS + 1)]
        filtered = [self._new(f"filtered {i}", (3, *level(i))) for i in range(LEVELS + 1)]
        made = self._made | self._seen | {"fine": fine, "level": levels[0], "filtered": filtered[0]}
        remodulate, upsample = ENDS[self._guided]
        self._looks = ("features", "guides", "trust") if self._guided else ("features",)
        for name, kernel in (("dilate", denoise_prepare.DILATE), ("history", denoise_history.HISTORY),
                             ("features", denoise_features.FEATURE), ("accumulate", denoise_prepare.ACCUMULATE),
                             ("remodulate", remodulate), ("upsample", upsample)):
            self._table(name, kernel, **made)
        if self._reactive:
            self._table("keep", denoise_reactive.KEEP, **made)
        if self._guided:
            self._table("guides", denoise_guides.GUIDE, **made)
            self._table("trust", denoise_guides.TRUST, **made)
        self._filter_order = ["accumulate", *(f"pool {i}" for i in range(1, LEVELS + 1))]
        for i in range(1, LEVELS + 1):
            self._table(f"pool {i}", denoise_filter.POOL, finer=levels[i - 1], level=levels[i])
        for i in range(LEVELS, -1, -1):
            mixed = levels[i]
            if i < LEVELS:
                mixed = self._new(f"mixed {i}", (3, *level(i)))
                self._table(f"mix {i}", denoise_filter.MIX_LEVELS, coarse=filtered[i + 1], level=levels[i], mixed=mixed)
                self._filter_order.append(f"mix {i}")
            self._table(f"filter {i}", denoise_filter.FILTER, mixed=mixed, filtered=filtered[i])
            self._filter_order.append(f"filter {i}")
        self._filter_order.append("remodulate")

    def _table(self, name: str, kernel: Kernel, **tensors: Tensor) -> None:
        """An argument table for a kernel, with those of the tensors that it names."""
        table = ArgumentTable(self._device.compute_state(kernel))
        for binding in kernel.reads + kernel.writes:
            if binding in tensors:
                table[binding] = tensors[binding]
        self._tables[name] = table

    def _place(self, window: Window) -> dict[str, dict[str, Tensor]]:
        """What tells the kernels of a window: tensors by their bindings' names for each table of the pyramid, and
        under no name for all others."""
        if window not in self._places:
            if len(self._places) == MOST_PLACES:
                self._places.clear()
            self._places[window] = {table: {name: self._given(name, array) for name, array in values.items()}
                                    for table, values in _places(window).items()}
        return self._places[window]

    def _given(self, name: str, array: np.ndarray) -> Tensor:
        tensor = self._kept(name, array.shape)
        tensor.upload(array)
        return tensor

    def _bind(self, tensors: Mapping[str, Tensor], places: Mapping[str, Mapping[str, Tensor]],
              heads: Mapping[str, Tensor]) -> None:
        """Bind what changes from window to window and from frame to frame."""
        for name, table in self._tables.items():
            known = {**tensors, **places.get(name, places[""])}
            if name.startswith(("filter ", "mix ")):
                known["heads"] = heads["fine" if name[-1] == "0" else f"level{name[-1]}"]
            for binding in table.state.bindings:
                if binding.name in known:
                    table[binding.name] = known[binding.name]

    def _run(self, encoder: ComputeEncoder, *names: str) -> None:
        for name in names:
            encoder.dispatch(self._tables[name].state, self._tables[name])


def _places(window: Window) -> dict[str, dict[str, np.ndarray]]:
    """What tells the kernels of a window, for each table of the pyramid, and under no name for all others."""
    places = {"": window.places()}
    for i in range(LEVELS + 1):
        places[f"filter {i}"] = {"area": window.area(i)}
    for i in range(LEVELS):
        places[f"mix {i}"] = dict(zip(("coarse_rows", "coarse_columns"), window.coarser(i), strict=True))
        places[f"pool {i + 1}"] = dict(zip(("finer_rows", "finer_columns"), window.finer(i + 1), strict=True))
    return places
