"""Passes that mix a plane with alpha into the colour, in scene-linear light, after denoising and before tone mapping.

`Overlay` puts a transparency overlay over the picture; `BothWays` mixes in the result of the later frames.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from statistics import median
from typing import ClassVar, Never

from postfx.frame import FrameSpec, Part, Role
from postfx.kernels.denoise.parts import BALANCE
from postfx.kernels.image import OVER, OVER_ALPHA
from postfx.passes import Pass, Reflection, ResidentFrame
from postfx.runtime import ArgumentTable, CommandBuffer, ComputeEncoder, Device, Tensor

LATEST = 64
"""How many of the last frames' times count."""


class Overlay(Pass):
    """Composites the plane `overlay`, premultiplied linear RGBA, over colour and alpha, in scene-linear light.

    colour = overlay + (1 - coverage) * colour, and so alpha, where the frame has one (Porter and Duff 1984). The
    overlay is then removed. Without this pass the frame keeps it, at the colour's size, as a separate layer. No
    options. Frames whose overlay is 0 everywhere do not change by a bit.
    """

    name: ClassVar[str] = "overlay"

    def __init__(self, **unknown: Never) -> None:
        super().__init__(**unknown)

    def reflect(self, spec: FrameSpec) -> Reflection:
        kept = tuple(plane for plane in spec.planes if plane[0] is not Role.OVERLAY)
        covered = tuple(role for role in (Role.COLOUR, Role.ALPHA) if spec.has(role))
        return Reflection(reads=(Role.COLOUR, Role.OVERLAY), may_read=(Role.ALPHA,), writes=covered,
                          output=replace(spec, planes=kept))

    def skip(self, spec: FrameSpec) -> str | None:
        if spec.encoding != "scene-linear":
            return f"colour is {spec.encoding}, and overlays are composited in scene-linear light"
        if spec.has(Role.OVERLAY):
            return None
        larger = Role.OVERLAY in spec.guide_roles
        return "the overlay has the output's size, and nothing enlarges the colour" if larger else "there is no overlay"

    def compile(self, device: Device, spec: FrameSpec) -> None:
        self._tables = {Role.COLOUR: self._table(device, spec, Role.COLOUR)}
        if spec.has(Role.ALPHA):
            self._tables[Role.ALPHA] = self._table(device, spec, Role.ALPHA)
        self._blank, self._recorded = 0, False
        self._times: list[float] = []
        super().compile(device, spec)

    def encode(self, commands: CommandBuffer, frame: ResidentFrame) -> None:
        super().encode(commands, frame)
        self._recorded = not frame.is_blank(Role.OVERLAY)
        self._blank += not self._recorded
        if not self._recorded:
            return
        with commands.compute_encoder("over") as encoder:
            for role, table in self._tables.items():
                table["overlay"], table[str(role)] = frame[Role.OVERLAY], frame[role]
                encoder.dispatch(table.state, table)
                frame.set(role, table["output"])

    def note_time(self, milliseconds: float) -> None:
        if self._recorded:
            self._times = [*self._times[1 - LATEST:], milliseconds]

    def savings(self) -> tuple[tuple[str, str], ...]:
        if not self._blank:
            return ()
        saved = f"which takes {median(self._times):.1f} ms a frame" if self._times else "time not measured yet"
        return ((f"compositing for {self._blank} frame{'s' * (self._blank > 1)}", f"the overlay is 0 there; {saved}"),)

    def _table(self, device: Device, spec: FrameSpec, role: Role) -> ArgumentTable:
        output = device.heap.transient(f"{role} under the overlay", (spec.height, spec.width, spec.channels(role)))
        return ArgumentTable(device.compute_state(OVER if role is Role.COLOUR else OVER_ALPHA), {"output": output})


class PartShares:
    """Brings parts of a picture to one that took its place: each gets the same share of it as before, so that light
    adds up to it. `parts`: those of the denoiser, of which light of three channels counts."""

    def __init__(self, parts: Sequence[Part | str]) -> None:
        self._lights = [part if isinstance(part, str) else part.name for part in parts
                        if isinstance(part, str) or part.is_light]
        self._tables: dict[str, ArgumentTable] = {}

    def read_of(self, spec: FrameSpec) -> tuple[str, ...]:
        """Names of the parts that are read of frames of a spec."""
        return tuple(name for name in self._lights if name in spec.part_names)

    def compile(self, device: Device, spec: FrameSpec) -> None:
        """Get ready for frames of a spec."""
        self._tables = {}
        if not self._lights:
            return
        none, everywhere = device.heap.tensor("not all of it", (1,)), device.heap.tensor("everywhere", (1, 1, 1))
        none.fill(0)
        everywhere.fill(1)
        for name in self._lights:
            balanced = device.heap.transient(f"{name} of the mixture", (1, spec.height, spec.width, 3))
            self._tables[name] = ArgumentTable(device.compute_state(BALANCE), {
                "complete": none, "reached": everywhere, "balanced": balanced})

    def encode(self, encoder: ComputeEncoder, frame: ResidentFrame, before: Tensor, after: Tensor) -> None:
        """Record the work, once the picture `after` is there, which takes the place of the one `before`."""
        for name, table in self._tables.items():
            part = frame.parts.get(name)
            if part is None or part.shape[2] != 3:
                continue
            table["parts"], table["whole"] = part.view(name, (1, *part.shape), 0), before
            table["picture"] = after
            encoder.dispatch(table.state, table)
            frame.parts[name] = table["balanced"].view(name, part.shape, 0)


class BothWays(Pass):
    """Mixes the plane `later` into the colour: later + (1 - weight) * colour, in scene-linear light.

    `postfx.Backwards` makes the plane, of the upscaler's output size. Its weight is how much the later frames know
    about a pixel compared with the earlier ones: one half in the middle of a shot, 1 where only later frames show it
    well. The plane is then removed.

    Options:
        parts: those of the denoiser. They only know the earlier frames; light of three channels is brought to the mixed
            picture, of which it gets the same share as of the picture before, so that parts add up to it.
    """

    name: ClassVar[str] = "both_ways"

    def __init__(self, *, parts: Sequence[Part | str] = (), **unknown: Never) -> None:
        super().__init__(parts=parts, **unknown)

    def reflect(self, spec: FrameSpec) -> Reflection:
        kept = tuple(plane for plane in spec.planes if plane[0] is not Role.LATER)
        return Reflection(reads=(Role.COLOUR, Role.LATER), writes=(Role.COLOUR,), output=replace(spec, planes=kept),
                          parts=PartShares(self.options["parts"]).read_of(spec))

    def skip(self, spec: FrameSpec) -> str | None:
        if spec.encoding != "scene-linear":
            return f"colour is {spec.encoding}, and both directions are mixed in scene-linear light"
        return None if spec.has(Role.LATER) else "later frames were not processed"

    def compile(self, device: Device, spec: FrameSpec) -> None:
        output = device.heap.transient("colour of both directions", (spec.height, spec.width, 3))
        self._table = ArgumentTable(device.compute_state(OVER), {"output": output})
        self._parts = PartShares(self.options["parts"])  # not in common with copies, which other views get
        self._parts.compile(device, spec)
        super().compile(device, spec)

    def encode(self, commands: CommandBuffer, frame: ResidentFrame) -> None:
        super().encode(commands, frame)
        self._table["overlay"], self._table["colour"] = frame[Role.LATER], frame[Role.COLOUR]
        with commands.compute_encoder("mix") as encoder:
            encoder.dispatch(self._table.state, self._table)
            self._parts.encode(encoder, frame, frame[Role.COLOUR], self._table["output"])
        frame.set(Role.COLOUR, self._table["output"])
