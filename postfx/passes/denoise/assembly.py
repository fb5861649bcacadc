"""The networks for frames of one size: they run on the frame as a whole, or on tiles whose results
are put together."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import copy
from functools import partial
from types import MappingProxyType

import numpy as np

from postfx.caching import LRUCache
from postfx.passes.denoise.activity import TILE_SIDE_PX, active_rows
from postfx.passes.denoise.geometry import (
    CELL,
    Band,
    Rows,
    Shape,
    Sizes,
    Tile,
    Window,
    rows_of,
    whole_steps,
)
from postfx.passes.denoise.graph import ASSEMBLED, FRAME_NEEDS, kernels_of, run_steps
from postfx.passes.denoise.history import History
from postfx.passes.denoise.models import CLASSIC, halo_of, seamless
from postfx.passes.denoise.tiling import (
    GPU_WINDOW_COST_PX,
    WINDOW_COST_PX,
    WORTH_TIME_SHARE,
    around,
    band_of,
    bands_within,
    can_serve,
    limited_to,
    window_cost,
)
from postfx.passes.denoise.window import THE_PICTURE, FilteredLayer, FrameWork, Targets, WindowGraph
from postfx.runtime import CommandBuffer, Device, Tensor

MOST_WINDOW_PLACES = 64
"""Positions of bands that stay on the device."""
OUTPUT_SIZED = ("output", "next_history", "light")
"""What windows write at the output's size; the rest has the render's."""


class Assembly:
    """Memory for what a band's tiles write, and the work that puts it together."""

    def __init__(self, device: Device, frame: Sizes) -> None:
        self._device, self._frame = device, frame
        self._stacks: dict[tuple[str, str], Tensor] = {}
        self._made: tuple[int, int, int, tuple[tuple[str, str], ...]] | None = None
        self._slots: list[dict[str, dict[str, Tensor]]] = []
        self._places: dict[tuple[Band, Rows, bool], dict[str, Tensor]] = {}
        self._tiles: dict[tuple[str, str], Tensor] = {}
        device.make_ready(*kernels_of(ASSEMBLED))

    def slots(self, tiles: Sequence[Tile], targets: Targets) -> Sequence[Targets]:
        """For each of a band's tiles, the tensors that it writes in place of the frame's
        targets."""
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
        """The targets' own rows for a band's only tile to write, so that nothing is copied; None
        unless the tile's rows are exactly the rows that are `kept`."""
        window, out, frame = band.tiles[0].window, band.tiles[0].window.out, self._frame
        rows, out_rows = (window.top, window.top + window.rows), (out.top, out.top + out.rows)
        if band.top < rows[0] or band.own[1] > rows[1]:
            return None
        exact = all(row * frame.output.height == at * frame.render.height
                    for row, at in zip(rows, out_rows, strict=True))
        if len(band.tiles) > 1 or window.columns < frame.render.width or rows != kept or not exact:
            return None
        return {layer: {name: rows_of(target, out_rows if name in OUTPUT_SIZED else rows)
                        for name, target in written.items()}
                for layer, written in targets.items()}

    def encode(self, commands: CommandBuffer, band: Band, targets: Targets, kept: Rows) -> None:
        """Record the work that copies a band's tiles into the frame's targets.

        The band's own rows go to the output, and the rows `kept` to the next frame's history. With
        layers, which read the output, all rows `kept` go to both.
        """
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
            size = self._frame.output if out else self._frame.render
            values = {"places": [place(tile) for tile in band.tiles],
                      "frame_rows": np.arange(*self._sized(rows, out)),
                      "frame_columns": np.arange(size.width)}
            arrays = {name: np.asarray(value, np.float32) for name, value in values.items()}
            self._places[key] = {name: self._device.heap.tensor(name, array.shape)
                                 for name, array in arrays.items()}
            for name, tensor in self._places[key].items():
                tensor.upload(arrays[name])
        return self._places[key]

    def _sized(self, rows: Rows, out: bool) -> Rows:
        return self._frame.output_rows(rows) if out else rows

    def _render_place(self, tile: Tile) -> list[int]:
        """A tile's first row and column, the area in which it leaves a history, and its inner part,
        each as first row and column, end row and column.

        The first area ends a pixel before the window does, except at the frame's edges: the output
        pixels that are read around a known one must be known, too.
        """
        window, inner, (height, width) = tile.window, tile.inner, self._frame.render
        bottom, right = window.top + window.rows, window.left + window.columns
        held = [window.top + (window.top > 0), window.left + (window.left > 0),
                height if bottom >= height else bottom - 1,
                width if right >= width else right - 1]
        return [window.top, window.left, *held, inner.top, inner.left, inner.top + inner.rows,
                inner.left + inner.columns]

    def _out_place(self, tile: Tile) -> list[int]:
        """`_render_place` in output pixels."""
        window, inner = tile.window, tile.inner
        corners = ((window.top, window.left),
                   (window.top + window.rows, window.left + window.columns))
        (top, left), (bottom, right) = (self._enlarged(*corner) for corner in corners)
        render, output = self._frame.render, self._frame.output
        top += -(window.top * output.height) % render.height > 0
        left += -(window.left * output.width) % render.width > 0
        held = [top, left, min(bottom, output.height), min(right, output.width)]
        own = [*self._enlarged(inner.top, inner.left),
               *self._enlarged(inner.top + inner.rows, inner.left + inner.columns)]
        return [window.out.top, window.out.left, *held, *own]

    def _enlarged(self, row: int, column: int = 0) -> tuple[int, int]:
        """Output pixels before a render pixel."""
        render, output = self._frame.render, self._frame.output
        return row * output.height // render.height, column * output.width // render.width


MOST_GRAPHS = 4
"""Most window sizes, beside the whole frame's, that are kept ready."""
CLOSE = 1.15
"""A window that is ready is taken if it takes at most this many times as long as the best one."""
WINDOW_SIDE_PARTS = 8
"""Sides of further windows are multiples of this part of the frame's, so that masks that move soon
find one ready."""


class FrameNetworks:
    """Runs networks on frames of one size. The history may go on at another size.

    Args:
        sizes: of the frames.
        models: names of the networks; each frame takes one of them.
        history: what frames leave to the next.
        guided: whether the networks read guides.
        reactive: whether frames have a mask of where the history is not used.
        layered: whether layers beside the picture may be filtered with it.
        spared_px: render pixels by which the halo may be smaller, because the active cells already
            have a border of that width which nobody sees.
    """

    def __init__(self, device: Device, sizes: Sizes, models: Sequence[str], history: History, *,
                 guided: bool = False, reactive: bool = False, layered: bool = False,
                 spared_px: int = 0) -> None:
        self._device, self._sizes, self._models = device, sizes, tuple(models)
        self._guided, self._reactive, self._layered = guided, reactive, layered
        self._halo = max(0, halo_of(models) - spared_px)
        self._overhead = GPU_WINDOW_COST_PX if device.gpu else WINDOW_COST_PX
        self._graphs: LRUCache[Shape, WindowGraph] = LRUCache(MOST_GRAPHS)
        self._bands = bands_within(device.scratch, sizes, seamless(models))
        self._whole = None if self._bands else self._graph_of(sizes.render)
        self._window = Window.whole(sizes)
        if self._bands:
            self._make(self._band_shape)
        self._history = history
        new, between = device.heap.tensor, device.heap.transient
        self._common = {"params": new("params", (4,)), "keep": new("keep", (1, 1, 1)),
                        "depth_scale": between("depth scale", (1,))}
        self._kept: bool | None = None  # what the tensor 'keep' holds
        self._output = between("output", (*sizes.output, 3))
        self._assembly = Assembly(device, sizes)
        device.make_ready(*kernels_of(FRAME_NEEDS, frozenset({"reactive"} if reactive else ())))

    def beside(self, history: History) -> FrameNetworks:
        """The same networks for other frames of this size, which have a history of their own."""
        other, new = copy(self), self._device.heap.tensor
        other._history, other._kept = history, None
        other._common = {**self._common, "params": new("params", (4,)),
                         "keep": new("keep", (1, 1, 1))}
        return other

    def layout(self, cells: np.ndarray, judged: bool = False) -> Band | None:
        """The tiles for a frame's active cells; None if the whole frame is as fast.

        Makes the networks ready that the tiles need.

        Args:
            cells: (rows, columns) of bool, of which at least one is set.
            judged: whether the result is judged in tiles of 16x16 pixels, and so is needed in all
                of each tile that has an active cell.
        """
        time = partial(window_cost, overhead=self._overhead)
        halo = max(self._halo, TILE_SIDE_PX - CELL) if judged else self._halo
        boxes, shape = around(self._sizes, cells, halo, self._overhead)
        if self._bands:
            fits = shape[0] <= self._band_shape[0] and shape[1] <= self._band_shape[1]
            return band_of(self._sizes, boxes, self._band_shape, halo, judged) if fits else None
        count, least = len(boxes), time(shape, len(boxes))
        if least > WORTH_TIME_SHARE * time(self._sizes.render, 1):
            return None
        ready = [one for one in self._graphs
                 if can_serve(self._sizes, shape, one) and time(one, count) <= CLOSE * least]
        shape = min(ready, key=lambda one: time(one, count)) if ready else self._make(shape)
        return band_of(self._sizes, boxes, shape, halo, judged)

    def encode(self, commands: CommandBuffer, planes: Mapping[str, Tensor], work: FrameWork,
               layers: Sequence[FilteredLayer] = (),
               written: Targets = MappingProxyType({})) -> Tensor:
        """Record the work on one frame, or on some tiles of it; returns the colour, which is
        undefined outside the tiles' rows.

        When the model changes the history goes on, but without the hidden state.

        Args:
            planes: the frame's planes, by the kernels' names.
            layers: parts and alpha that are filtered beside the picture.
            written: tensors to write the layers to, and the colour if it is among them.
        """
        keep, band = work.keep, work.band
        apart = (bool(work.still or band or self._bands or layers or self._reactive)
                 or work.model == CLASSIC)
        rows = band.rows_held if band and not layers else (0, self._sizes.render.height)
        if self._history.model != work.model:
            self._history.use(work.model)
        last, left, kept = self._history.turn(commands, self._sizes.render, keep, apart, rows)
        self._common["params"].put(work.params)
        if keep != self._kept:
            self._common["keep"].fill(keep)
            self._kept = keep
        seen = {**planes, **self._common, **last}
        if self._reactive:
            seen["next_reactive"] = left.pop("next_reactive")
        picture = {"output": self._output, **left, **written.get(THE_PICTURE, {})}
        targets = {**written, THE_PICTURE: picture}
        # Where the last output is replaced in its own memory, it is warped to other memory first,
        # even if none of it counts.
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
                now: frozenset[str], work: FrameWork, kept: Rows,
                layers: Sequence[FilteredLayer]) -> None:
        words = frozenset({"reactive"} if self._reactive else ())
        run_steps(commands, FRAME_NEEDS, seen, words)
        if work.band is None and self._whole:
            self._whole.encode(commands, self._window, work.model, seen, targets, now, layers)
        for band in [work.band] if work.band else self._bands:
            rows = kept if work.band else band.own
            self._encode_tiles(commands, work.model, band, seen, targets, now | {"moves"}, rows,
                               layers)

    def rows(self, band: Band | None, cells: np.ndarray | None) -> Rows:
        """The output rows that a frame writes: those of its band, or else of its active cells."""
        height = self._sizes.render.height
        active = (0, height) if cells is None else active_rows(cells, height)
        return self._sizes.output_rows(band.own if band else active)

    @property
    def _band_shape(self) -> Shape:
        window = self._bands[0].tiles[0].window
        return window.rows, window.columns

    def _encode_tiles(self, commands: CommandBuffer, model: str, band: Band,
                      seen: Mapping[str, Tensor], targets: Targets, now: frozenset[str],
                      kept: Rows,
                      layers: Sequence[FilteredLayer]) -> None:
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
        """Make a graph ready for windows of a size; returns the size. After the first one it is
        rounded up, so that masks that move soon find a window that is ready."""
        if self._graphs:
            grid = self._sizes.grid
            rows, columns = (max(1, side // WINDOW_SIDE_PARTS // grid) * grid
                             for side in self._sizes.render)
            shape = limited_to(self._sizes,
                                (whole_steps(shape[0], rows), whole_steps(shape[1], columns)))
        self._graphs.get_or_make(shape, partial(self._graph_of, shape))
        return shape

    def _graph_of(self, shape: Shape) -> WindowGraph:
        return WindowGraph(self._device, Window(self._sizes, 0, 0, *shape), self._models,
                           self._guided, self._reactive, self._layered)
