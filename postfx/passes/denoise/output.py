"""What is done to the picture after the windows, and to its parts: detail that was lost comes back,
and strength blends the result with the input."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial

import numpy as np

from postfx.frame import ALBEDOS, FrameSpec, Role
from postfx.kernels.denoise.output import SUMS, TILE
from postfx.kernels.image import positions
from postfx.passes import ResidentFrame
from postfx.passes.denoise.activity import full_rows, tiles_with
from postfx.passes.denoise.geometry import Rows, Size, rows_of
from postfx.passes.denoise.graph import BLENDED, NO_WORDS, RESTORED, Each, kernels_of, run_steps
from postfx.passes.denoise.planes import Resampler
from postfx.runtime import CommandBuffer, Device, Tensor

NO_DETAIL_SAMPLES = 16
"""Samples a pixel up to which no detail is looked for."""
FULL_EVIDENCE_SAMPLES = 64
"""Samples a pixel whose evidence for detail counts as 1; more samples count more."""
MOST_EVIDENCE_SAMPLES = 96
"""Samples a pixel that count at most."""
PER_PIXEL = ("colour", "denoised", "output")
"""Buffers of `Restore` that have the frame's rows."""
PER_TILE = ("judged", "sums", "known", "detail")
"""Buffers of `Restore` that have rows of tiles."""
LEAST_REFLECTANCE = 0.02
"""Sum of a pixel's albedos below which they do not explain its colour."""
EVEN_LIGHT = 2e-3
"""Root mean square of diagonal differences of light in a tile, relative to its mean, up to which it
has no noise: twice that of colour and albedo in half precision, and a tenth of that of renders with
a thousand samples."""


class Restore:
    """Gives back the detail that the network removed with the noise, in results of the render's
    size. Tiles of 16x16 pixels are judged by whether what was removed is detail."""

    def __init__(self, device: Device, size: Size) -> None:
        self._device = device
        new, between = device.heap.tensor, device.heap.transient
        tiles = -(-size.height // TILE), -(-size.width // TILE)
        self._params, self._evidence = new("restore params", (4,)), new("evidence", (1,))
        self._output = between("restored", (*size, 3))
        self._judged, self._tiles = new("judged", (*tiles, 1)), tiles
        self._known_detail = new("known detail", (*tiles, 1))
        self._known_detail.upload(np.zeros((*tiles, 1), np.float32))
        self._has_known_detail = False
        self._rows, self._known = (0, size.height), np.zeros(tiles, bool)  # what 'judged' holds
        self._tensors = {"params": self._params, "evidence": self._evidence,
                         "sums": between("sums", (*tiles, SUMS)), "judged": self._judged,
                         "known": self._known_detail,
                         "detail": between("detail", (*tiles, 1)), "output": self._output}
        device.make_ready(*kernels_of(RESTORED))

    def encode(self, commands: CommandBuffer, frame: ResidentFrame, denoised: Tensor, rows: Rows,
               cells: np.ndarray | None = None, by_planes: bool = False) -> Tensor:
        """Record the work on a frame; returns the colour.

        Args:
            denoised: the denoised colour, to compare with the frame's own.
            rows: those to work on.
            cells: the active ones; only tiles with any are judged. None for all.
            by_planes: whether tiles whose colour is their albedo in even light get it back, too.
        """
        self._rows = rows
        self._know(tiles_of_even_light(frame.host_planes) if by_planes else None)
        self._judge_only(np.ones(self._tiles, bool) if cells is None else tiles_with(cells))
        self._params.upload([frame.exposure_factor, 0.0, 0.0, 0.0])
        self._evidence.upload([min(frame.samples or FULL_EVIDENCE_SAMPLES, MOST_EVIDENCE_SAMPLES)
                               / FULL_EVIDENCE_SAMPLES])
        planes = {**self._tensors, "colour": frame[Role.COLOUR], "denoised": denoised}
        run_steps(commands, RESTORED, self._in_rows(planes))
        return self._output

    def encode_part(self, commands: CommandBuffer, noisy: Tensor, denoised: Tensor,
                    output: Tensor) -> Tensor:
        """Record the work on a part of the picture, after the picture itself: the part gets back
        the same share of what was removed."""
        planes = {**self._tensors, "colour": noisy, "denoised": denoised, "output": output}
        run_steps(commands, RESTORED, self._in_rows(planes), frozenset({"part"}))
        return output

    def _know(self, tiles: np.ndarray | None) -> None:
        """Tell the kernels which tiles are known to be detail; None for none."""
        if tiles is not None or self._has_known_detail:
            known = np.zeros(self._tiles, bool) if tiles is None else tiles
            self._known_detail.upload(known[..., None].astype(np.float32))
        self._has_known_detail = tiles is not None

    def _judge_only(self, tiles: np.ndarray) -> None:
        if not np.array_equal(tiles, self._known):
            self._known = tiles
            self._judged.upload(tiles[..., None].astype(np.float32))

    def _in_rows(self, tensors: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """The rows of tensors to work on: the frame's, or the rows of tiles that hold them."""
        first, end = self._rows
        tiles = first // TILE, -(-end // TILE)
        return {name: rows_of(tensor, self._rows) if name in PER_PIXEL
                else rows_of(tensor, tiles) if name in PER_TILE else tensor
                for name, tensor in tensors.items()}


def tiles_of_even_light(planes: Mapping[Role, np.ndarray]) -> np.ndarray | None:
    """Which tiles of 16x16 pixels show albedo in light without noise: (rows, columns) of booleans;
    None if none does, or the frame has no albedo.

    A texture of random single pixels looks like noise to a network, in the planes, too. But where
    colour over albedo is even, there is no noise to remove.
    """
    albedos = [planes[role] for role in ALBEDOS if role in planes]
    if not albedos or Role.COLOUR not in planes:
        return None
    even: np.ndarray | None = None
    for channel in (1, 0, 2):  # green has the most light
        reflectance = np.sum([albedo[..., channel] for albedo in albedos], axis=0)
        found = _even_tiles(planes[Role.COLOUR][..., channel], reflectance)
        even = found if even is None else even & found
        if not even.any():
            return None
    return even


def _even_tiles(colour: np.ndarray, reflectance: np.ndarray) -> np.ndarray:
    """Tiles in which a channel's light (rows, columns) over its reflectance has no noise."""
    with np.errstate(invalid="ignore", over="ignore"):
        light = colour / np.maximum(reflectance, LEAST_REFLECTANCE)
        right = light[:, 1:] - light[:, :-1]
        differences = np.zeros_like(light)
        differences[:-1, :-1] = np.square(right[1:] - right[:-1])
        allowed = EVEN_LIGHT * _means_of_tiles(light)
        even = _means_of_tiles(differences) <= np.square(allowed)
        known = _means_of_tiles(reflectance < LEAST_REFLECTANCE) == 0
        found: np.ndarray = even & known & (allowed > 0)
    return found


def _means_of_tiles(plane: np.ndarray) -> np.ndarray:
    """Means over tiles of a plane (rows, columns); those at the end may be smaller."""
    for axis in (0, 1):
        starts = np.arange(0, plane.shape[axis], TILE)
        sizes = np.diff(np.append(starts, plane.shape[axis]))
        sums = np.add.reduceat(plane, starts, axis=axis, dtype=np.float32)
        plane = sums / np.expand_dims(sizes.astype(np.float32), 1 - axis)
    return plane


class Strength:
    """Blends from the input to the result by strength.

    Args:
        amount: strength of all pixels, times the plane `strength` if frames have one.
        plain: resamples the input.
    """

    def __init__(self, device: Device, spec: FrameSpec, output: Size, amount: float,
                 plain: Resampler) -> None:
        render, held = Size(spec.height, spec.width), spec.has(Role.STRENGTH)
        self._plain = plain
        self._in_place = device.runs_rows
        self._output, self._copy = (device.heap.transient(name, (*output, 3))
                                    for name in ("blend", "denoised rows"))
        self._is_whole = amount == 1
        self._amount = device.wrap("amount", np.full(1, amount, np.float32))
        device.make_ready(*kernels_of(BLENDED, over={"rows": [Each(frozenset({"mixed"}))]}))
        self._plane = Resampler(device, "strength", Role.STRENGTH, render, output) if held else None
        self._strength = self._plane.output if self._plane else device.wrap(
            "full strength", np.ones((*output, 1), np.float32))

    def begin(self, frame: ResidentFrame, rows: Rows) -> dict[str, Tensor]:
        """Begin a frame: {'output': tensor} for the network to write to, if most of `rows` have
        full strength, so that these need neither be blended nor copied; else empty."""
        plane = frame.host_planes.get(Role.STRENGTH) if self._is_whole and self._in_place else None
        if plane is None:
            return {}
        first, end = self._full = full_rows(plane, positions(len(plane), self._output.shape[0],
                                                             frame.jitter[1]), rows)
        return {"output": self._output} if 2 * (end - first) > rows[1] - rows[0] else {}

    def encode(self, commands: CommandBuffer, frame: ResidentFrame, denoised: Tensor,
               rows: Rows) -> Tensor:
        """Record the blend of the frame's own colour with the denoised one; returns the colour.

        rows: those that have strength. Not for frames whose strength `is_full`.
        """
        colour, strength = frame[Role.COLOUR], frame[Role.STRENGTH] if self._plane else None
        full = self._full if denoised is self._output else (rows[1], rows[1])
        self._plain.aim(frame.jitter)
        if self._plane:
            self._plane.aim(frame.jitter)
        commands.repeat((self, colour, strength, denoised, rows, full),
                        partial(self._record, commands, colour, strength, denoised, rows, full))
        return self._output

    def _record(self, commands: CommandBuffer, colour: Tensor, strength: Tensor | None,
                denoised: Tensor, rows: Rows, full: Rows) -> None:
        words = {"mixed"}
        pictures = {"denoised": denoised, "output": self._output}
        if denoised is self._output:
            words |= {"in_place"}
            pictures |= {"denoised": self._copy, "result": denoised}
        if self._plane and strength:
            words |= {"varied"}
            pictures["strength_rows"] = self._plane.rows
            given = {"strength_plane": strength, "strength_columns": self._plane.columns}
        else:
            given = {}
        self._blend(commands, self._plain, {**given, "colour": colour}, pictures,
                    [(rows[0], full[0]), (full[1], rows[1])], rows, frozenset(words))

    def encode_part(self, commands: CommandBuffer, noisy: Tensor, denoised: Tensor,
                    rows: Rows, plain: Resampler, output: Tensor) -> Tensor:
        """Record the blend of a part of the picture, after the picture itself; `plain` resamples
        parts."""
        self._blend(commands, plain, {"colour": noisy}, {"denoised": denoised, "output": output},
                    [rows], rows, frozenset({"mixed"}))
        return output

    def _blend(self, commands: CommandBuffer, plain: Resampler, given: Mapping[str, Tensor],
               pictures: Mapping[str, Tensor], mixed: Sequence[Rows], rows: Rows,
               words: frozenset[str]) -> None:
        """Record the blend of some rows; outside of `rows` the result is the input alone.

        Args:
            plain: resamples the input.
            given: the input, and a plane `strength`, by the kernels' names.
            pictures: the denoised picture and the result, by the kernels' names.
            mixed: ranges of rows to blend, within `rows`.
            words: those of `graph` for the blended rows.
        """
        output = pictures["output"]
        between = {**pictures, "plain": plain.output, "plain_rows": plain.rows,
                   "strength": self._strength}
        alone = {"plain": output, "plain_rows": plain.rows}
        over = [Each(kind, {name: rows_of(tensor, some) for name, tensor in tensors.items()})
                for kind, tensors, ranges in (
                    (words, between, mixed),
                    (NO_WORDS, alone, [(0, rows[0]), (rows[1], output.shape[0])]))
                for some in ranges if some[0] < some[1]]
        run_steps(commands, BLENDED, {**given, "plain_columns": plain.columns,
                                      "amount": self._amount}, over={"rows": over})

    def is_full(self, frame: ResidentFrame) -> bool:
        """Whether a frame has a plane `strength` that is 1 everywhere."""
        strength = frame.host_planes.get(Role.STRENGTH) if self._is_whole else None
        return strength is not None and bool((strength >= 1).all())
