"""How the denoised upscaler goes over a frame, and what it keeps from frame to frame."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial

import numpy as np

from postfx.caching import LRUCache
from postfx.kernels import denoise_prepare, denoise_reactive
from postfx.passes._denoise_assembly import Assembly
from postfx.passes._denoise_graph import Graph
from postfx.passes._denoise_history import History
from postfx.passes._denoise_layout import GAIN, Band, Shape, around, band_of, cost, halo_of, whole_sides
from postfx.passes._denoise_memory import bands_within
from postfx.passes._denoise_window import Rows, Sizes, Window, whole_steps
from postfx.runtime import ArgumentTable, CommandBuffer, Device, Tensor

MOST_GRAPHS = 4
"""Sizes of windows, beside the whole frame, that are kept ready."""
CLOSE = 1.15
"""A window that is ready is taken if it takes at most so many times as long as the best one."""
STEPS = 8
"""Sides of further windows are multiples of this part of the frame's, so that masks that move soon find one ready."""


class Frames:
    """The networks for frames of one size; their history may go on with those of another.

    Of several models the first is in use until `use` takes another. Guided models read guides. Reactive frames have a
    mask of where the history is not used.
    """

    def __init__(self, device: Device, sizes: Sizes, models: Sequence[str], history: History,
                 guided: bool = False, reactive: bool = False) -> None:
        self._device, self._sizes, self._models = device, sizes, tuple(models)
        self._guided, self._reactive = guided, reactive
        self._halo = halo_of(models)
        self._graphs: LRUCache[Shape, Graph] = LRUCache(MOST_GRAPHS)
        self._bands = bands_within(device.scratch, sizes, models)
        self._whole = None if self._bands else self._graph_of((sizes.h, sizes.w))
        if self._bands:
            self._make(self._band_shape)
        self._history = history
        new, between = device.heap.tensor, device.heap.transient
        self._common = {"params": new("params", (4,)), "keep": new("keep", (1, 1, 1)),
                        "depth_scale": between("depth scale", (1,))}
        self._output = between("output", (sizes.height, sizes.width, 3))
        self._assembly = Assembly(device, sizes)
        self._scale = ArgumentTable(device.compute_state(denoise_prepare.SCALE),
                                    {"depth_scale": self._common["depth_scale"]})
        self._spread = ArgumentTable(device.compute_state(denoise_reactive.SPREAD_MASK)) if reactive else None
        self.model = models[0]

    def use(self, model: str) -> None:
        """Take another model from the next frame on. The history goes on, but for the hidden state."""
        self.model = model
        self._history.use(model)

    def layout(self, cells: np.ndarray) -> Band | None:
        """The tiles for a frame's active cells, of which there is one at least; None where the whole frame is as fast.

        Makes the networks ready that they need.
        """
        boxes, shape = around(self._sizes, cells, self._halo)
        if self._bands:
            fits = shape[0] <= self._band_shape[0] and shape[1] <= self._band_shape[1]
            return band_of(self._sizes, boxes, self._band_shape, self._halo) if fits else None
        count, least = len(boxes), cost(shape, len(boxes))
        if least > GAIN * cost((self._sizes.h, self._sizes.w), 1):
            return None
        ready = [one for one in self._graphs if one[0] >= shape[0] and one[1] >= shape[1]
                 and cost(one, count) <= CLOSE * least]
        shape = min(ready, key=lambda one: cost(one, count)) if ready else self._make(shape)
        return band_of(self._sizes, boxes, shape, self._halo)

    def encode(self, commands: CommandBuffer, planes: Mapping[str, Tensor], params: np.ndarray, keep: bool,
               still: bool, band: Band | None = None) -> Tensor:
        """Record one frame, or the tiles of one, outside of whose rows the output is undefined; returns the output
        colour tensor.

        Args:
            keep: whether the frame has a history.
            still: whether it shows what the last one showed, where it did.
        """
        self._history.turn(commands, (self._sizes.h, self._sizes.w), keep)
        self._common["params"].upload(params)
        self._common["keep"].fill(keep)
        self._scale["depth"] = planes["depth"]
        with commands.compute_encoder("scale") as encoder:
            encoder.barrier(after=("compute", "machine-learning"), before="compute")
            encoder.dispatch(self._scale.state, self._scale)
            if self._spread:
                self._spread["reactive"] = planes["reactive"]
                self._spread["next_reactive"] = self._history.next["next_reactive"]
                encoder.dispatch(self._spread.state, self._spread)
        seen = {**planes, **self._common, **self._history.last}
        targets = {"output": self._output, **self._history.next}
        masked = keep and self._reactive
        kept = self._history.cover(band.held if band else (0, self._sizes.h))
        if band is None and self._whole:
            self._whole.encode(commands, Window.whole(self._sizes), self.model, seen | targets, keep and not still,
                               masked)
        for some in [band] if band else self._bands:
            self._encode_tiles(commands, some, seen, targets, masked, kept if band else some.own)
        return self._output

    def rows(self, band: Band | None) -> Rows:
        """The rows of the output that hold something, of a frame or the tiles of one."""
        return self._sizes.enlarged(band.own if band else (0, self._sizes.h))

    @property
    def _band_shape(self) -> Shape:
        window = self._bands[0].tiles[0].window
        return window.rows, window.columns

    def _encode_tiles(self, commands: CommandBuffer, band: Band, seen: Mapping[str, Tensor],
                      targets: dict[str, Tensor], masked: bool, kept: Rows) -> None:
        window = band.tiles[0].window
        graph, direct = self._graphs[window.rows, window.columns], self._assembly.direct(band, targets, kept)
        if direct:
            graph.encode(commands, window, self.model, {**seen, **direct}, True, masked)
            return
        for tile, slot in zip(band.tiles, self._assembly.slots(band.tiles), strict=True):
            graph.encode(commands, tile.window, self.model, {**seen, **slot}, True, masked)
        self._assembly.encode(commands, band, targets, kept)

    def _make(self, shape: Shape) -> Shape:
        """Make a graph ready for windows of a size, or somewhat larger ones if there were others before."""
        if self._graphs:
            grid = self._sizes.grid
            steps = (max(1, side // STEPS // grid) * grid for side in (self._sizes.h, self._sizes.w))
            shape = whole_sides(self._sizes, tuple(map(whole_steps, shape, steps)))
        self._graphs.get_or_make(shape, partial(self._graph_of, shape))
        return shape

    def _graph_of(self, shape: Shape) -> Graph:
        return Graph(self._device, Window(self._sizes, 0, 0, *shape), self._models, self._guided, self._reactive)
