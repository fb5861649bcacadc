"""Runs the denoised upscaler over a frame, as a whole or in windows that are then assembled, and in
wider primaries where the frame's own do not hold its light.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, MutableMapping, Sequence
from copy import copy
from functools import cached_property, partial
from types import MappingProxyType
from typing import Any

import numpy as np

from postfx.caching import LRUCache
from postfx.colour import TO_WIDER_PRIMARIES
from postfx.frame import FrameSpec, Part, Role
from postfx.kernels.colour import CONVERT_PRIMARIES
from postfx.kernels.denoise import HIDDEN
from postfx.kernels.denoise.output import ASSEMBLE
from postfx.kernels.statistics import OUTSIDE, light_outside, lit_cells
from postfx.passes import ResidentFrame
from postfx.passes.denoise.graph import FRAME_NEEDS, Layer, WindowGraph, kernels_of, run_steps
from postfx.passes.denoise.history import WHOLE, History, PartHistory, Reflections, can_follow
from postfx.passes.denoise.models import (
    CLASSIC,
    blanks_volumes,
    gives_picture,
    grid_of,
    halo_of,
    reach_of,
    reads_mirrored,
    seamless,
)
from postfx.passes.denoise.options import ReactiveOption, Size
from postfx.passes.denoise.parts import Layers
from postfx.passes.denoise.planes import (
    ExpectedError,
    Passthrough,
    Plain,
    Planes,
    Reactive,
    Restore,
    Strength,
)
from postfx.passes.denoise.tiling import (
    CELL,
    FIXED,
    GPU_FIXED,
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
    grown,
    rows_of,
    whole_sides,
    whole_steps,
)
from postfx.planes import sampled
from postfx.runtime import CommandBuffer, Device, Tensor

MOST_WINDOW_PLACES = 64
OUTPUT_PREFIXES = ("output", "next_history", "light")
"""Names of outputs at output size begin so; the rest has render size."""
ERROR_NAME = "error"
"""Name of what the network expects to be off, where it is asked for."""
OUTPUT_CHANNELS = {"output": 3, "next_history": 3, "next_state": 4 + HIDDEN, "next_depth": 1}


class Assembly:
    """Memory for the outputs of a band's tiles, and the kernels that assemble them."""

    def __init__(self, device: Device, frame: Sizes) -> None:
        self._device, self._frame = device, frame
        self._stacks: dict[str, Tensor] = {}
        self._made: tuple[int, int, int, tuple[str, ...]] | None = None
        self._slots: list[dict[str, Tensor]] = []
        self._places: dict[tuple[Band, Rows, bool], dict[str, Tensor]] = {}
        self._tiles: dict[str, Tensor] = {}
        device.make_ready(ASSEMBLE)

    def slots(self, tiles: Sequence[Tile],
              targets: Mapping[str, Tensor]) -> list[dict[str, Tensor]]:
        """Where each of a band's tiles writes its share of the frame's targets, by the kernels'
        names."""
        window = tiles[0].window
        slots: list[dict[str, Tensor]] = [{} for _ in tiles]
        names = _put_together(targets)
        key = len(tiles), window.rows, window.columns, names
        if key == self._made:
            return self._slots
        self._tiles = {}
        for name in names:
            channels = targets[name].shape[2]
            size = ((window.out.rows, window.out.columns) if name.startswith(OUTPUT_PREFIXES)
                    else (window.rows, window.columns))
            one = size[0] * size[1] * channels
            stack = self._stacks.get(name)
            if stack is None or stack.shape[0] < len(tiles) * one:
                self._stacks.pop(name, None)
                stack = self._stacks[name] = self._device.heap.tensor(f"{name} of tiles",
                                                                      (len(tiles) * one,))
            self._tiles[name] = stack.view(f"{name} of tiles", (len(tiles), *size, channels))
            for i, slot in enumerate(slots):
                slot[name] = stack.view(f"{name} of tile {i}", (*size, channels), i * one)
        self._made, self._slots = key, slots
        return slots

    def direct(self, band: Band, targets: Mapping[str, Tensor],
               kept: Rows) -> dict[str, Tensor] | None:
        """Where a band's only tile writes, by the kernels' names: straight into the targets, if its
        rows are all that is written, so that nothing is copied. Else None."""
        window, out, frame = band.tiles[0].window, band.tiles[0].window.out, self._frame
        rows, out_rows = (window.top, window.top + window.rows), (out.top, out.top + out.rows)
        if band.top < rows[0] or band.own[1] > rows[1]:
            return None
        exact = all(row * frame.height == at * frame.h
                    for row, at in zip(rows, out_rows, strict=True))
        if len(band.tiles) > 1 or window.columns < frame.w or rows != kept or not exact:
            return None
        return {name: rows_of(targets[name], out_rows if name.startswith(OUTPUT_PREFIXES) else rows)
                for name in _put_together(targets)}

    def encode(self, commands: CommandBuffer, band: Band, targets: dict[str, Tensor],
               kept: Rows) -> None:
        """Record the work that copies a band's tiles into the frame's tensors: its own rows into
        the output, and the rows `kept` into the next frame's history. If there are layers, which
        read them, these rows go into the output, too."""
        layered = any(name.startswith("light") for name in self._tiles)
        for name, tiles in self._tiles.items():
            rows, out = (band.own if name == "output" and not layered else kept,
                         name.startswith(OUTPUT_PREFIXES))
            picture = rows_of(targets[name], self._sized(rows, out))
            commands.run(ASSEMBLE, "assemble", tiles=tiles, picture=picture,
                         **self._place(band, rows, out))

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


def _put_together(targets: Mapping[str, Tensor]) -> tuple[str, ...]:
    """Names of the tensors that tiles write."""
    return (*OUTPUT_CHANNELS, *(name for name in targets
                                if name.startswith(("light ", "next_part ")) or name == ERROR_NAME))


MOST_GRAPHS = 4
"""Most window sizes, beside the whole frame's, that are kept ready."""
CLOSE = 1.15
"""A window that is ready is taken if it takes at most this many times as long as the best one."""
WINDOW_SIDE_PARTS = 8
"""Sides of further windows are multiples of this part of the frame's, so that masks that move soon
find one ready."""


class Frames:
    """The networks for frames of one size. The history can continue at another size.

    The first of several models is in use until `use` takes another. Guided models read guides.
    Reactive frames have a mask that tells where the history is not used. Layered ones may have
    layers beside the picture.
    """

    def __init__(self, device: Device, sizes: Sizes, models: Sequence[str], history: History,
                 guided: bool = False, reactive: bool = False, layered: bool = False) -> None:
        self._device, self._sizes, self._models = device, sizes, tuple(models)
        self._guided, self._reactive, self._layered = guided, reactive, layered
        self._halo, self._fixed = halo_of(models), GPU_FIXED if device.gpu else FIXED
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
        self.model = models[0]

    def use(self, model: str) -> None:
        """Switch models from the next frame on. The history continues, without the hidden state."""
        self.model = model
        self._history.use(model)

    def beside(self, history: History) -> Frames:
        """The same networks for other frames of the same size, which have this history."""
        other, new = copy(self), self._device.heap.tensor
        other._history, other._kept = history, None
        other._common = {**self._common, "params": new("params", (4,)),
                         "keep": new("keep", (1, 1, 1))}
        return other

    def layout(self, cells: np.ndarray) -> Band | None:
        """The tiles for a frame's active cells, at least one; None if the whole frame is as fast.
        Makes the networks ready that the tiles need.
        """
        time = partial(cost, fixed=self._fixed)
        boxes, shape = around(self._sizes, cells, self._halo, self._fixed)
        if self._bands:
            fits = shape[0] <= self._band_shape[0] and shape[1] <= self._band_shape[1]
            return band_of(self._sizes, boxes, self._band_shape, self._halo) if fits else None
        count, least = len(boxes), time(shape, len(boxes))
        if least > WORTH_TIME_SHARE * time((self._sizes.h, self._sizes.w), 1):
            return None
        ready = [one for one in self._graphs
                 if can_serve(self._sizes, shape, one) and time(one, count) <= CLOSE * least]
        shape = min(ready, key=lambda one: time(one, count)) if ready else self._make(shape)
        return band_of(self._sizes, boxes, shape, self._halo)

    def encode(self, commands: CommandBuffer, planes: Mapping[str, Tensor], params: np.ndarray,
               keep: bool, still: bool, band: Band | None = None, layers: Sequence[Layer] = (),
               written: Mapping[str, Tensor] = MappingProxyType({})) -> Tensor:
        """Record one frame, or some tiles of it; returns the output colour tensor, which is
        undefined outside the tiles' rows.

        Args:
            keep: whether the frame has a history.
            still: whether everything is where it was in the last frame.
            layers: parts and alpha that are filtered beside the picture.
            written: where they are written, by the kernels' names, and perhaps the output.
        """
        apart = (bool(still or band or self._bands or layers or self._reactive)
                 or self.model == CLASSIC)
        self._history.turn(commands, (self._sizes.h, self._sizes.w), keep, apart)
        self._common["params"].put(params)
        if keep != self._kept:
            self._common["keep"].fill(keep)
            self._kept = keep
        seen = {**planes, **self._common, **self._history.last}
        targets = {"output": self._output, **self._history.next, **written}
        # the last output is warped to other memory where it is replaced, even if nothing of it
        # counts
        moves, masked = keep and not still or self._history.is_replaced, keep and self._reactive
        kept = self._history.cover(band.rows_held if band and not layers else (0, self._sizes.h))
        record = partial(self._record, commands, seen, targets, moves, masked, band, kept, layers)
        if layers:  # whose tensors are many
            record()
        else:
            commands.repeat((self, self.model, moves, masked, band, kept, *seen.values(),
                             *targets.values()), record)
        return targets["output"]

    def _record(self, commands: CommandBuffer, seen: Mapping[str, Tensor],
                targets: dict[str, Tensor], moves: bool,
                masked: bool, band: Band | None, kept: Rows, layers: Sequence[Layer]) -> None:
        words = frozenset({"reactive"} if self._reactive else ())
        run_steps(commands, FRAME_NEEDS, words, {**seen, **targets})
        if band is None and self._whole:
            self._whole.encode(commands, self._window, self.model, {**seen, **targets}, moves,
                               masked, layers)
        for some in [band] if band else self._bands:
            self._encode_tiles(commands, some, seen, targets, masked, kept if band else some.own,
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

    def _encode_tiles(self, commands: CommandBuffer, band: Band, seen: Mapping[str, Tensor],
                      targets: dict[str, Tensor], masked: bool, kept: Rows,
                      layers: Sequence[Layer]) -> None:
        window = band.tiles[0].window
        graph, direct = (self._graphs[window.rows, window.columns],
                         self._assembly.direct(band, targets, kept))
        if direct:
            graph.encode(commands, window, self.model, {**seen, **direct}, True, masked, layers)
            return
        for tile, slot in zip(band.tiles, self._assembly.slots(band.tiles, targets), strict=True):
            graph.encode(commands, tile.window, self.model, {**seen, **slot}, True, masked, layers)
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


COLOURS = (Role.COLOUR, Role.OPAQUE_COLOUR, Role.DIFFUSE_ALBEDO, Role.SPECULAR_ALBEDO)
"""Light, and what is compared with it or multiplied by it."""

LOGARITHMIC_LIGHT, PLAIN_LIGHT = "next_history", ("next_state", "history", "last_part")
"""In a history, light by its logarithm, log(1 + light), and light as it is, in the first three
channels."""


class WiderPrimaries:
    """Colours of a frame in wider primaries, where all light is positive: each noisy pixel's
    negative light would count as 0, and the mean would rise."""

    def __init__(self, device: Device, parts: Sequence[Part]) -> None:
        self._device = device
        self._lights = [part.name for part in parts if part.is_light]
        self._matrices: dict[bool, Tensor] = {}
        self._made: dict[str, Tensor] = {}

    def help(self, frame: ResidentFrame) -> bool:
        """Whether so much of a frame's light lies outside its gamut. Not looked for on a GPU."""
        colour = frame.host_planes.get(Role.COLOUR) if self._device.memory.host_visible else None
        return colour is not None and light_outside(colour) > OUTSIDE

    def widen(self, commands: CommandBuffer, frame: ResidentFrame) -> None:
        """Record the conversion of a frame's planes, guides and parts, which are replaced."""
        self._convert_all(commands, "plane", frame.tensors, COLOURS, True)
        self._convert_all(commands, "guide", frame.guides, COLOURS, True)
        self._convert_all(commands, "part", frame.parts, self._lights, True)

    def narrow(self, commands: CommandBuffer, frame: ResidentFrame, colour: Tensor) -> Tensor:
        """Record the conversion back of the frame's parts, which are replaced, and of a colour,
        which is returned."""
        self._convert_all(commands, "part", frame.parts, self._lights, False)
        return self._convert(commands, "picture", colour, False)

    def _convert_all(self, commands: CommandBuffer, kind: str, held: MutableMapping[Any, Tensor],
                     names: Iterable[str], wider: bool) -> None:
        for name in names:
            if name in held and held[name].shape[2] == 3:  # a light of one channel is grey
                held[name] = self._convert(commands, f"{kind} {name}", held[name], wider)

    def _convert(self, commands: CommandBuffer, name: str, colour: Tensor, wider: bool) -> Tensor:
        name = f"{name} in {'wider' if wider else 'its'} primaries"
        if wider not in self._matrices:
            self._matrices[wider] = self._device.heap.tensor("primaries", (9,))
            self._matrices[wider].upload((TO_WIDER_PRIMARIES if wider
                                          else np.linalg.inv(TO_WIDER_PRIMARIES)).ravel())
        if name not in self._made:
            self._made[name] = self._device.heap.transient(name, colour.shape)
        commands.run(CONVERT_PRIMARIES, "primaries", colour=colour, matrix=self._matrices[wider],
                     output=self._made[name])
        return self._made[name]


def widen_history(history: Mapping[str, np.ndarray],
                  parts: Sequence[Part]) -> dict[str, np.ndarray]:
    """A history of the pass in wider primaries.

    The last output is exact. What is accumulated was divided by reflectance, and is converted as if
    that were grey.
    """
    lights, found = {"", WHOLE, *(part.name for part in parts if part.is_light)}, dict(history)
    for key, array in history.items():
        kind, _, name = key.removeprefix("part ").partition(" of ")
        if kind in (LOGARITHMIC_LIGHT, *PLAIN_LIGHT) and name in lights:
            light = np.expm1(array[..., :3]) if kind == LOGARITHMIC_LIGHT else array[..., :3]
            wider = np.maximum(light @ TO_WIDER_PRIMARIES.T.astype(np.float32), 0)
            found[key] = np.concatenate([np.log1p(wider) if kind == LOGARITHMIC_LIGHT else wider,
                                         array[..., 3:]], -1)
    return found


def _lit_part(plane: np.ndarray) -> float:
    """The share of a plane's pixels that are not 0, by a few of them."""
    some = sampled(plane, LIT_PIXEL_STEP, LIT_PIXEL_STEP, LIT_PIXEL_STEP // 2).any(axis=2)
    return float(some.mean()) if some.size else 1.0


class Ready:
    """Pipeline states, tensors and argument tables for frames of one spec.

    Attributes:
        passthrough: planes that are only resampled.
    """

    def __init__(self, device: Device, spec: FrameSpec, output: Size) -> None:
        self.passthrough = Passthrough(device, spec, output)


LIGHT_REACH = 80
"""Render pixels that the light of one can come to in the result: 62 by filters of five levels, 16
by the cells of the last one, 2 by enlarging."""
# every so many pixels of a row and of a column tell how much of a picture is lit
LIT_PIXEL_STEP = 16
MOST_LIT = 0.75  # of these pixels


class ReadyPlain(Ready):
    """A spec for which no network runs.

    Attributes:
        plain: the input, resampled.
        layers: parts of the picture; None if it has none.
    """

    def __init__(self, device: Device, spec: FrameSpec, output: Size,
                 parts: Sequence[Part]) -> None:
        super().__init__(device, spec, output)
        self.layers = (Layers(device, spec, output, parts, False, PartHistory(device, output, ()))
                       if parts else None)
        self.plain = Plain(device, spec, output)


class ReadyNetwork(Ready):
    """A spec for which a network runs.

    Attributes:
        planes: the input of its kernels.
        models: the networks of this size by tag; each frame takes one.
        blanking: those that do without depth and albedo in volumes.
        pictures: those that give the picture itself, and no filters.
        frames: runs the models.
        reactive: the mask where the history is not used.
        reflections: None if frames lack the planes for it.
        restore: at render size only, else None.
        strength: None where all of the picture is fully denoised.
        layers: parts of the picture, and alpha; None without both.
        own: runs the models on parts that have filters of their own, by name.
        wider: for light that the frame's primaries do not hold.
        error: the plane of expected errors; None if it is not asked for.
        alpha_tag: the largest network that filters noisy alpha, where others give the picture
            alone.
    """

    def __init__(self, device: Device, spec: FrameSpec, output: Size, models: Mapping[str, str],
                 history: History, guided: bool, strength: float, mask: ReactiveOption,
                 parts: Sequence[Part], alpha: bool,
                 part_history: PartHistory, error: bool = False) -> None:
        super().__init__(device, spec, output)
        sizes = Sizes(spec.height, spec.width, *output, grid_of(models.values()))
        self.models = models
        self.blanking = {model for model in models.values() if blanks_volumes(model)}
        self.pictures = {model for model in models.values() if gives_picture(model)}
        filtering = [tag for tag, model in models.items() if model not in self.pictures]
        self.planes = Planes(device, spec, output, guided,
                             any(map(reads_mirrored, models.values())))
        self.reflections = Reflections(device, spec) if can_follow(spec) else None
        self.reactive = Reactive(device, spec, mask)
        alpha = alpha and spec.has(Role.ALPHA)
        self.alpha_tag = filtering[-1] if alpha and self.pictures and filtering else None
        self.frames = Frames(device, sizes, list(models.values()), history, guided,
                             mask.role(spec) is not None, alpha or bool(parts))
        self.restore = Restore(device, output) if output == (spec.height, spec.width) else None
        full = strength == 1 and not spec.has(Role.STRENGTH)
        self.strength = None if full else Strength(device, spec, output, strength)
        self.layers = (Layers(device, spec, output, parts, alpha, part_history) if parts or alpha
                       else None)
        self.own = {name: self.frames.beside(own) for name, own in part_history.own.items()}
        self.wider = WiderPrimaries(device, parts)
        self.error = ExpectedError(device, spec, output) if error else None
        self._device, self._output, self._parts = device, output, parts
        reach, halo = reach_of(models.values()), halo_of(models.values())
        # beside which windows have their halo
        self._reach = (reach and LIGHT_REACH + max(0, reach - halo))

    @cached_property
    def _only_weighs(self) -> bool:
        """Whether all that is made of a frame are weighed means of its pixels."""
        return not (self._parts or self.error or self.pictures)

    def lit_cells(self, frame: ResidentFrame) -> np.ndarray | None:
        """The squares of 4 pixels whose result the picture's light decides; None if that is not
        looked for, or they are most of the picture. The filters, which weigh pixels, can give
        nothing but 0 to all others.

        It is looked for where frames leave no history behind: there the rest has the same bits as
        the whole frame's.
        """
        alike = self._only_weighs and self._reach and Role.MOTION not in frame and not frame.is_away
        colour = frame.host_planes.get(Role.COLOUR) if alike else None
        if colour is None or _lit_part(colour) > MOST_LIT:
            return None
        planes = [colour]
        if self.layers:
            if Role.ALPHA not in frame.host_planes:
                return None
            planes.append(frame.host_planes[Role.ALPHA])
        cells = np.logical_or.reduce([lit_cells(plane, CELL) for plane in planes])
        return grown(cells, self._reach) if cells.any() else None

    def is_empty(self, frame: ResidentFrame) -> bool:
        """Whether the picture is black everywhere, alpha too if it is filtered. Without a history
        the filters, which weigh pixels, can then give nothing but 0."""
        if not self._only_weighs or not frame.is_blank(Role.COLOUR):
            return False
        return self.layers is None or frame.is_blank(Role.ALPHA)

    def encode_empty(self, frame: ResidentFrame) -> Tensor:
        """The result of an empty frame; nothing is recorded."""
        if self.layers:
            frame.set(Role.ALPHA, self._nothing[1], blank=True)
        return self._nothing[0]

    @cached_property
    def _nothing(self) -> tuple[Tensor, Tensor]:
        """Colour and alpha of an empty frame."""
        made = tuple(self._device.heap.tensor(f"no {name}", (*self._output, channels))
                     for name, channels in (("colour", 3), ("alpha", 1)))
        for tensor in made:
            tensor.fill(0)
        return made[0], made[1]
