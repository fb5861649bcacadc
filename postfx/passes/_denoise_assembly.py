"""Puts what was computed in windows together: the frame's output, and what it leaves to the next."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from postfx.kernels import denoise_layout
from postfx.kernels.denoise_assemble import ASSEMBLE
from postfx.passes._denoise_layout import Band, Tile
from postfx.passes._denoise_window import Rows, Sizes, rows_of
from postfx.runtime import ArgumentTable, CommandBuffer, Device, Tensor

MOST_PLACES = 64
OUT = ("output", "next_history")
"""What has output size; the rest has render size."""
CHANNELS = {"output": 3, "next_history": 3, "next_state": 4 + denoise_layout.HIDDEN, "next_depth": 1}


class Assembly:
    """Room for what the tiles of a band write, and the kernels that bring it to its place."""

    def __init__(self, device: Device, frame: Sizes) -> None:
        self._device, self._frame = device, frame
        self._stacks: dict[str, Tensor] = {}
        self._made: tuple[int, int, int] | None = None
        self._slots: list[dict[str, Tensor]] = []
        self._places: dict[tuple[Band, Rows, bool], dict[str, Tensor]] = {}
        self._tables = {name: ArgumentTable(device.compute_state(ASSEMBLE)) for name in CHANNELS}

    def slots(self, tiles: Sequence[Tile]) -> list[dict[str, Tensor]]:
        """Where each of a band's tiles writes, by the kernels' names."""
        window, slots = tiles[0].window, [{} for _ in tiles]
        key = len(tiles), window.rows, window.columns
        if key == self._made:
            return self._slots
        for name, channels in CHANNELS.items():
            size = (window.out.rows, window.out.columns) if name in OUT else (window.rows, window.columns)
            one = size[0] * size[1] * channels
            stack = self._stacks.get(name)
            if stack is None or stack.shape[0] < len(tiles) * one:
                self._stacks.pop(name, None)
                stack = self._stacks[name] = self._device.heap.tensor(f"{name} of tiles", (len(tiles) * one,))
            self._tables[name]["tiles"] = stack.view(f"{name} of tiles", (len(tiles), *size, channels))
            for i, slot in enumerate(slots):
                slot[name] = stack.view(f"{name} of tile {i}", (*size, channels), i * one)
        self._made, self._slots = key, slots
        return slots

    def direct(self, band: Band, targets: Mapping[str, Tensor], kept: Rows) -> dict[str, Tensor] | None:
        """Where a band's only tile writes, by the kernels' names, if its rows are all that is written: in their places,
        so that nothing is copied. Else None."""
        window, out, frame = band.tiles[0].window, band.tiles[0].window.out, self._frame
        rows, out_rows = (window.top, window.top + window.rows), (out.top, out.top + out.rows)
        exact = all(row * frame.height == at * frame.h for row, at in zip(rows, out_rows, strict=True))
        if len(band.tiles) > 1 or window.columns < frame.w or rows != kept or not exact:
            return None
        return {name: rows_of(targets[name], out_rows if name in OUT else rows) for name in CHANNELS}

    def encode(self, commands: CommandBuffer, band: Band, targets: dict[str, Tensor], kept: Rows) -> None:
        """Record the work that puts a band's tiles into the frame's tensors: its own rows into the output, the rows
        `kept` into what the next frame reads."""
        with commands.compute_encoder("assemble") as encoder:
            encoder.barrier(after="compute", before="compute")
            for name, table in self._tables.items():
                rows = band.own if name == "output" else kept
                for binding, tensor in self._place(band, rows, name in OUT).items():
                    table[binding] = tensor
                table["picture"] = rows_of(targets[name], self._sized(rows, name in OUT))
                encoder.dispatch(table.state, table)

    def _place(self, band: Band, rows: Rows, out: bool) -> dict[str, Tensor]:
        key = band, rows, out
        if key not in self._places:
            if len(self._places) == MOST_PLACES:
                self._places.clear()
            place = self._out_place if out else self._render_place
            values = {"places": [place(tile) for tile in band.tiles], "frame_rows": np.arange(*self._sized(rows, out)),
                      "frame_columns": np.arange(self._frame.width if out else self._frame.w)}
            arrays = {name: np.asarray(value, np.float32) for name, value in values.items()}
            self._places[key] = {name: self._device.heap.tensor(name, array.shape) for name, array in arrays.items()}
            for name, tensor in self._places[key].items():
                tensor.upload(arrays[name])
        return self._places[key]

    def _sized(self, rows: Rows, out: bool) -> Rows:
        return self._frame.enlarged(rows) if out else rows

    def _render_place(self, tile: Tile) -> list[int]:
        """Beside the origin: what the history is known of, less a pixel at the seam to nothing, since what is read of
        the output around a known pixel must be known, too; and what the tile is for."""
        window, inner, frame = tile.window, tile.inner, self._frame
        bottom, right = window.top + window.rows, window.left + window.columns
        held = [window.top + (window.top > 0), window.left + (window.left > 0),
                frame.h if bottom >= frame.h else bottom - 1, frame.w if right >= frame.w else right - 1]
        return [window.top, window.left, *held, inner.top, inner.left, inner.top + inner.rows,
                inner.left + inner.columns]

    def _out_place(self, tile: Tile) -> list[int]:
        window, inner = tile.window, tile.inner
        corners = ((window.top, window.left), (window.top + window.rows, window.left + window.columns))
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
        return row * self._frame.height // self._frame.h, column * self._frame.width // self._frame.w
