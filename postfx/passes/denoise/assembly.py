"""The networks for frames of one size: over the frame as a whole, or in windows that are put
together."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import copy
from functools import partial
from types import MappingProxyType

import numpy as np

from postfx.caching import LRUCache
from postfx.passes.denoise.graph import ASSEMBLED, FRAME_NEEDS, kernels_of, run_steps
from postfx.passes.denoise.history import History
from postfx.passes.denoise.models import CLASSIC, halo_of, seamless
from postfx.passes.denoise.tiling import (
    CELL,
    FIXED,
    GPU_FIXED,
    TILE_SIDE,
    WORTH_TIME_SHARE,
    Band,
    Rows,
    Shape,
    Sizes,
    Tile,
    Window,
    active_rows,
    around,
    band_of,
    bands_within,
    can_serve,
    cost,
    rows_of,
    whole_sides,
    whole_steps,
)
from postfx.passes.denoise.window import THE_PICTURE, Layer, Targets, WindowGraph, Work
from postfx.runtime import CommandBuffer, Device, Tensor

MOST_WINDOW_PLACES = 64
OUTPUT_SIZED = ("output", "next_history", "light")
"""What windows write at the output's size; the rest has the render's."""


class Assembly:
    """Memory for the outputs of a band's tiles, and what puts them together."""

    def __init__(self, device: Device, frame: Sizes) -> None:
        self._device, self._frame = device, frame
        self._stacks: dict[tuple[str, str], Tensor] = {}
        self._made: tuple[int, int, int, tuple[tuple[str, str], ...]] | None = None
        self._slots: list[dict[str, dict[str, Tensor]]] = []
        self._places: dict[tuple[Band, Rows, bool], dict[str, Tensor]] = {}
        self._tiles: dict[tuple[str, str], Tensor] = {}
        device.make_ready(*kernels_of(ASSEMBLED))

    def slots(self, tiles: Sequence[Tile], targets: Targets) -> Sequence[Targets]:
        """Where each of a band's tiles writes its share of the frame's targets."""
        window = tiles[0].window
        names = [(layer, name) for layer, written in targets.items() for name in written]
        key = len(tiles), window.rows, window.columns, tuple(names)
        if key == self._made:
            return self._slots
        self._tiles = {}
        slots: list[dict[str, dict[str, Tensor]]] = [{layer: {} for layer in targets}
                                                     for _ in tiles]
        for layer, name in names:
            channels = targets[layer][name].shape[2]
            size = ((window.out.rows, window.out.columns) if name in OUTPUT_SIZED
                    else (window.rows, window.columns))
            one = size[0] * size[1] * channels
            stack = self._stacks.get((layer, name))
            if stack is None or stack.shape[0] < len(tiles) * one:
                self._stacks.pop((layer, name), None)
                stack = self._device.heap.tensor(f"{name} of tiles", (len(tiles) * one,))
                self._stacks[layer, name] = stack
            self._tiles[layer, name] = stack.view(f"{name} of tiles",
                                                  (len(tiles), *size, channels))
            for i, slot in enumerate(slots):
                slot[layer][name] = stack.view(f"{name} of tile {i}", (*size, channels), i * one)
        self._made, self._slots = key, slots
        return slots

    def direct(self, band: Band, targets: Targets, kept: Rows) -> Targets | None:
        """Where a band's only tile writes: straight into the targets, if its rows are all that is
        written, so that nothing is copied. Else None."""
        window, out, frame = band.tiles[0].window, band.tiles[0].window.out, self._frame
        rows, out_rows = (window.top, window.top + window.rows), (out.top, out.top + out.rows)
        if band.top < rows[0] or band.own[1] > rows[1]:
            return None
        exact = all(row * frame.height == at * frame.h
                    for row, at in zip(rows, out_rows, strict=True))
        if len(band.tiles) > 1 or window.columns < frame.w or rows != kept or not exact:
            return None
        return {layer: {name: rows_of(target, out_rows if name in OUTPUT_SIZED else rows)
                        for name, target in written.items()}
                for layer, written in targets.items()}

    def encode(self, commands: CommandBuffer, band: Band, targets: Targets, kept: Rows) -> None:
        """Record the work that copies a band's tiles into the frame's tensors: its own rows into
        the output, and the rows `kept` into the next frame's history. If there are layers, which
        read them, these rows go into the output, too."""
        layered = len(targets) > 1
        for (layer, name), tiles in self._tiles.items():
            rows = band.own if name == "output" and not layered else kept
            out = name in OUTPUT_SIZED
            picture = rows_of(targets[layer][name], self._sized(rows, out))
            run_steps(commands, ASSEMBLED, {"tiles": tiles, "picture": picture,
                                            **self._place(band, rows, out)})

    def _place(self, band: Band, rows: Rows, out: bool) -> dict[str, Tensor]:
        key = band, rows, out
        if key not in self._places:
            if len(self._places) == MOST_WINDOW_PLACES:
                self._places.clear()
            place = self._out_place if out else self._render_place
            values = {"places": [place(tile) for tile in band.tiles],
                      "frame_rows": np.arange(*self._sized(rows, out)),
                      "frame_columns": np.arange(self._frame.width if out else self._frame.w)}
            arrays = {name: np.asarray(value, np.float32) for name, value in values.items()}
            self._places[key] = {name: self._device.heap.tensor(name, array.shape)
                                 for name, array in arrays.items()}
            for name, tensor in self._places[key].items():
                tensor.upload(arrays[name])
        return self._places[key]

    def _sized(self, rows: Rows, out: bool) -> Rows:
        return self._frame.output_rows(rows) if out else rows

    def _render_place(self, tile: Tile) -> list[int]:
        """After the origin: the area where the history is known, and the area that the tile is for.
        At a seam to nothing the first is a pixel smaller, because the output's pixels that are read
        around a known one must be known, too."""
        window, inner, frame = tile.window, tile.inner, self._frame
        bottom, right = window.top + window.rows, window.left + window.columns
        held = [window.top + (window.top > 0), window.left + (window.left > 0),
                frame.h if bottom >= frame.h else bottom - 1,
                frame.w if right >= frame.w else right - 1]
        return [window.top, window.left, *held, inner.top, inner.left, inner.top + inner.rows,
                inner.left + inner.columns]

    def _out_place(self, tile: Tile) -> list[int]:
        window, inner = tile.window, tile.inner
        corners = ((window.top, window.left),
                   (window.top + window.rows, window.left + window.columns))
        (top, left), (bottom, right) = (self._enlarged(*corner) for corner in corners)
        frame = self._frame
        top += -(window.top * frame.height) % frame.h > 0
        left += -(window.left * frame.width) % frame.w > 0
        held = [top, left, min(bottom, frame.height), min(right, frame.width)]
        own = [*self._enlarged(inner.top, inner.left),
               *self._enlarged(inner.top + inner.rows, inner.left + inner.columns)]
        return [window.out.top, window.out.left, *held, *own]

    def _enlarged(self, row: int, column: int = 0) -> tuple[int, int]:
        """Output pixels before a render pixel."""
        return (row * self._frame.height // self._frame.h,
                column * self._frame.width // self._frame.w)


MOST_GRAPHS = 4
"""Most window sizes, beside the whole frame's, that are kept ready."""
CLOSE = 1.15
"""A window that is ready is taken if it takes at most this many times as long as the best one."""
WINDOW_SIDE_PARTS = 8
"""Sides of further windows are multiples of this part of the frame's, so that masks that move soon
find one ready."""


class Frames:
    """The networks for frames of one size. The history can continue at another size.

    Of several models each frame names its own. Guided models read guides.
    Reactive frames have a mask that tells where the history is not used. Layered ones may have
    layers beside the picture. `spared`: render pixels that the halo is smaller, as what is active
    has so many that nobody sees.
    """

    def __init__(self, device: Device, sizes: Sizes, models: Sequence[str], history: History,
                 guided: bool = False, reactive: bool = False, layered: bool = False,
                 spared: int = 0) -> None:
        self._device, self._sizes, self._models = device, sizes, tuple(models)
        self._guided, self._reactive, self._layered = guided, reactive, layered
        self._halo = max(0, halo_of(models) - spared)
        self._fixed = GPU_FIXED if device.gpu else FIXED
        self._graphs: LRUCache[Shape, WindowGraph] = LRUCache(MOST_GRAPHS)
        self._bands = bands_within(device.scratch, sizes, seamless(models))
        self._whole = None if self._bands else self._graph_of((sizes.h, sizes.w))
        self._window = Window.whole(sizes)
        if self._bands:
            self._make(self._band_shape)
        self._history = history
        new, between = device.heap.tensor, device.heap.transient
        self._common = {"params": new("params", (4,)), "keep": new("keep", (1, 1, 1)),
                        "depth_scale": between("depth scale", (1,))}
        self._kept: bool | None = None  # what the tensor 'keep' holds
        self._output = between("output", (sizes.height, sizes.width, 3))
        self._assembly = Assembly(device, sizes)
        device.make_ready(*kernels_of(FRAME_NEEDS, frozenset({"reactive"} if reactive else ())))

    def beside(self, history: History) -> Frames:
        """These networks for other frames of this size, which have this history."""
        other, new = copy(self), self._device.heap.tensor
        other._history, other._kept = history, None
        other._common = {**self._common, "params": new("params", (4,)),
                         "keep": new("keep", (1, 1, 1))}
        return other

    def layout(self, cells: np.ndarray, judged: bool = False) -> Band | None:
        """The tiles for a frame's active cells, at least one; None if the whole frame is as fast.
        Makes the networks ready that the tiles need. `judged`: the result is wanted in all of each
        16x16 pixels that have some.
        """
        time = partial(cost, fixed=self._fixed)
        halo = max(self._halo, TILE_SIDE - CELL) if judged else self._halo
        boxes, shape = around(self._sizes, cells, halo, self._fixed)
        if self._bands:
            fits = shape[0] <= self._band_shape[0] and shape[1] <= self._band_shape[1]
            return band_of(self._sizes, boxes, self._band_shape, halo, judged) if fits else None
        count, least = len(boxes), time(shape, len(boxes))
        if least > WORTH_TIME_SHARE * time((self._sizes.h, self._sizes.w), 1):
            return None
        ready = [one for one in self._graphs
                 if can_serve(self._sizes, shape, one) and time(one, count) <= CLOSE * least]
        shape = min(ready, key=lambda one: time(one, count)) if ready else self._make(shape)
        return band_of(self._sizes, boxes, shape, halo, judged)

    def encode(self, commands: CommandBuffer, planes: Mapping[str, Tensor], work: Work,
               layers: Sequence[Layer] = (),
               written: Targets = MappingProxyType({})) -> Tensor:
        """Record one frame, or some tiles of it; returns the output colour tensor, which is
        undefined outside the tiles' rows. After another model the history continues, without the
        hidden state.

        Args:
            layers: parts and alpha that are filtered beside the picture.
            written: where they are written, and perhaps the output.
        """
        keep, band = work.keep, work.band
        apart = (bool(work.still or band or self._bands or layers or self._reactive)
                 or work.model == CLASSIC)
        rows = band.rows_held if band and not layers else (0, self._sizes.h)
        size = self._sizes.h, self._sizes.w
        if self._history.model != work.model:
            self._history.use(work.model)
        last, left, kept = self._history.turn(commands, size, keep, apart, rows)
        self._common["params"].put(work.params)
        if keep != self._kept:
            self._common["keep"].fill(keep)
            self._kept = keep
        seen = {**planes, **self._common, **last}
        if self._reactive:
            seen["next_reactive"] = left.pop("next_reactive")
        picture = {"output": self._output, **left, **written.get(THE_PICTURE, {})}
        targets = {**written, THE_PICTURE: picture}
        # the last output is warped to other memory where it is replaced, even if nothing of it
        # counts
        moves = keep and not work.still or last["history"] is left["next_history"]
        masked = keep and self._reactive
        now = frozenset({"moves"} if moves else ()) | frozenset({"masked"} if masked else ())
        record = partial(self._record, commands, seen, targets, now, work, kept, layers)
        if layers:  # whose tensors are many
            record()
        else:
            commands.repeat((self, work.model, now, band, kept, *seen.values(),
                             *picture.values()), record)
        return picture["output"]

    def _record(self, commands: CommandBuffer, seen: Mapping[str, Tensor], targets: Targets,
                now: frozenset[str], work: Work, kept: Rows, layers: Sequence[Layer]) -> None:
        words = frozenset({"reactive"} if self._reactive else ())
        run_steps(commands, FRAME_NEEDS, seen, words)
        if work.band is None and self._whole:
            self._whole.encode(commands, self._window, work.model, seen, targets, now, layers)
        for band in [work.band] if work.band else self._bands:
            rows = kept if work.band else band.own
            self._encode_tiles(commands, work.model, band, seen, targets, now | {"moves"}, rows,
                               layers)

    def rows(self, band: Band | None, cells: np.ndarray | None) -> Rows:
        """The rows of the output that are written by a frame, or by some tiles of it, as far as
        cells are active."""
        active = (0, self._sizes.h) if cells is None else active_rows(cells, self._sizes.h)
        return self._sizes.output_rows(band.own if band else active)

    @property
    def _band_shape(self) -> Shape:
        window = self._bands[0].tiles[0].window
        return window.rows, window.columns

    def _encode_tiles(self, commands: CommandBuffer, model: str, band: Band,
                      seen: Mapping[str, Tensor], targets: Targets, now: frozenset[str],
                      kept: Rows,
                      layers: Sequence[Layer]) -> None:
        window = band.tiles[0].window
        graph, direct = (self._graphs[window.rows, window.columns],
                         self._assembly.direct(band, targets, kept))
        slots = [direct] if direct else self._assembly.slots(band.tiles, targets)
        for tile, slot in zip(band.tiles, slots, strict=True):
            lasting = None if self._bands or layers else tile.lasting
            graph.encode(commands, tile.window, model, seen, slot, now, layers, lasting)
        if not direct:
            self._assembly.encode(commands, band, targets, kept)

    def _make(self, shape: Shape) -> Shape:
        """Make a graph ready for windows of a size, or somewhat larger ones if there were others
        before."""
        if self._graphs:
            grid = self._sizes.grid
            rows, columns = (max(1, side // WINDOW_SIDE_PARTS // grid) * grid
                             for side in (self._sizes.h, self._sizes.w))
            shape = whole_sides(self._sizes,
                                (whole_steps(shape[0], rows), whole_steps(shape[1], columns)))
        self._graphs.get_or_make(shape, partial(self._graph_of, shape))
        return shape

    def _graph_of(self, shape: Shape) -> WindowGraph:
        return WindowGraph(self._device, Window(self._sizes, 0, 0, *shape), self._models,
                           self._guided, self._reactive, self._layered)
