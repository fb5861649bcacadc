"""Passes that mix a plane into the colour, in scene-linear light, after denoising and before tone
mapping.

`Overlay` puts a transparency overlay over the picture; `BothWays` mixes in what the frames after
made of it. `PartShares` keeps parts adding up to a picture that was mixed.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from statistics import median
from typing import ClassVar, Never

from postfx.frame import FrameSpec, Part, Role
from postfx.kernels.denoise.parts import BALANCE
from postfx.kernels.image import OVER, OVER_ALPHA
from postfx.passes import Pass, Reflection, ResidentFrame
from postfx.passes.signed_light import SignedLight, negative_layer
from postfx.planes import has_negative_light
from postfx.runtime import CommandBuffer, Device, Tensor

LATEST = 64
"""Number of last frames whose times count."""
NO_OVERLAY = "there is no overlay"
"""The usual reason for compositing nothing."""


class Overlay(Pass):
    """Composites the plane `overlay`, premultiplied linear RGBA, over colour and alpha, in
    scene-linear light.

    colour = overlay + (1 - coverage) * colour, and so alpha, where the frame has one (Porter and
    Duff 1984). The overlay is then removed. Without this pass the frame keeps it, at the colour's
    size, as a separate layer. No options. Frames whose overlay is 0 everywhere do not change by a
    bit.
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
        return ("the overlay has the output's size, and nothing enlarges the colour" if larger
                else NO_OVERLAY)

    def compile(self, device: Device, spec: FrameSpec) -> None:
        self._over = {Role.COLOUR: OVER} | ({Role.ALPHA: OVER_ALPHA} if spec.has(Role.ALPHA)
                                            else {})
        self._outputs = {role: device.heap.transient(f"{role} under the overlay",
                                                     (spec.height, spec.width, spec.channels(role)))
                         for role in self._over}
        device.make_ready(*self._over.values())
        self._blank, self._recorded = 0, False
        self._times: list[float] = []
        super().compile(device, spec)

    def encode(self, commands: CommandBuffer, frame: ResidentFrame) -> None:
        super().encode(commands, frame)
        self._recorded = not frame.is_blank(Role.OVERLAY)
        self._blank += not self._recorded
        if not self._recorded:
            return
        for role, kernel in self._over.items():
            planes = {"overlay": frame[Role.OVERLAY], str(role): frame[role],
                      "output": self._outputs[role]}
            commands.run(kernel, "over", **planes)
            frame.set(role, self._outputs[role])

    def note_time(self, milliseconds: float) -> None:
        if self._recorded:
            self._times = [*self._times[1 - LATEST:], milliseconds]

    def savings(self) -> tuple[tuple[str, str], ...]:
        if not self._blank:
            return ()
        saved = (f"which takes {median(self._times):.1f} ms a frame" if self._times
                 else "time not measured yet")
        return ((f"compositing for {self._blank} frame{'s' * (self._blank > 1)}",
                 f"the overlay is 0 there; {saved}"),)


class PartShares:
    """Brings parts to a picture that takes the place of another one: each keeps its share, so that
    light adds up to the new picture.

    Args:
        parts: those of the denoiser. Those that are light of three channels are brought.
    """

    def __init__(self, parts: Sequence[Part | str]) -> None:
        named = [Part(part) if isinstance(part, str) else part for part in parts]
        self._groups = {part.name: part.group for part in named if part.is_light}
        self._balanced: dict[str, Tensor] = {}

    def read_of(self, spec: FrameSpec) -> tuple[str, ...]:
        """Names of the parts that are read of frames of a spec."""
        return tuple(name for name in self._groups if name in spec.part_names)

    def compile(self, device: Device, spec: FrameSpec) -> None:
        """Get ready for frames of a spec."""
        size = spec.height, spec.width
        self._signed = SignedLight(device, size, size)
        self._balanced = {name: device.heap.transient(f"{name} of the mixture", (1, *size, 3))
                          for name in self._groups}
        if not self._groups:
            return
        self._none, self._everywhere = (device.heap.tensor(name, shape) for name, shape in (
            ("not all of it", (1,)), ("everywhere", (1, 1, 1))))
        self._none.fill(0)
        self._everywhere.fill(1)
        device.make_ready(BALANCE)

    def encode(self, commands: CommandBuffer, frame: ResidentFrame, before: Tensor,
               after: Tensor) -> None:
        """Record the work on a frame whose picture `before` is replaced by the one `after`."""
        parts = {name: part for name in self._groups
                 if (part := frame.parts.get(name)) is not None and part.shape[2] == 3}
        by_sign: dict[str, Tensor] = {}
        for name in parts:
            if (name in frame.host_parts
                and has_negative_light(frame.host_parts[name],
                                       frame.host_planes.get(Role.COLOUR))):
                by_sign |= self._signed.split(commands, name, parts[name])
        for group in dict.fromkeys(self._groups[name] for name in parts):
            of_group = [name for name in parts if self._groups[name] == group]
            layers = map(negative_layer, of_group)
            negatives = [by_sign[layer] for layer in layers if layer in by_sign]
            pictures = {what: self._signed.sum_of_positive(commands, f"{what} above 0 of {group}",
                                                           light, negatives)
                        for what, light in (("whole", before), ("picture", after))}
            for name in of_group:
                self._scale(commands, frame, name, by_sign.get(name, parts[name]), pictures)
                if name in by_sign:
                    frame.parts[name] = self._signed.join(commands, name, frame.parts[name],
                                                          by_sign[negative_layer(name)])

    def _scale(self, commands: CommandBuffer, frame: ResidentFrame, name: str, part: Tensor,
               pictures: Mapping[str, Tensor]) -> None:
        """Bring a part without negative light from the `whole` to the `picture`."""
        commands.run(BALANCE, "mix", parts=part.view(name, (1, *part.shape), 0), **pictures,
                     complete=self._none, reached=self._everywhere, balanced=self._balanced[name])
        frame.parts[name] = self._balanced[name].view(name, part.shape, 0)


class BothWays(Pass):
    """Mixes the plane `later` into the colour: later + (1 - weight) * colour, in scene-linear
    light.

    `postfx.Backwards` makes the plane, of the upscaler's output size. Its weight is how much the
    later frames know about a pixel compared with the earlier ones: one half in the middle of a
    shot, 1 where only later frames show it well. The plane is then removed.

    Options:
        parts: those of the denoiser, which only knows the earlier frames. Light of three channels
            is brought to the mixed picture: each part keeps its share, so that parts add up to it.
    """

    name: ClassVar[str] = "both_ways"

    def __init__(self, *, parts: Sequence[Part | str] = (), **unknown: Never) -> None:
        super().__init__(parts=parts, **unknown)

    def reflect(self, spec: FrameSpec) -> Reflection:
        kept = tuple(plane for plane in spec.planes if plane[0] is not Role.LATER)
        return Reflection(reads=(Role.COLOUR, Role.LATER), writes=(Role.COLOUR,),
                          output=replace(spec, planes=kept),
                          parts=PartShares(self.options["parts"]).read_of(spec))

    def skip(self, spec: FrameSpec) -> str | None:
        if spec.encoding != "scene-linear":
            return f"colour is {spec.encoding}, and both directions are mixed in scene-linear light"
        return None if spec.has(Role.LATER) else "later frames were not processed"

    def compile(self, device: Device, spec: FrameSpec) -> None:
        self._output = device.heap.transient("colour of both directions",
                                             (spec.height, spec.width, 3))
        device.make_ready(OVER)
        # not in common with copies, which other views get
        self._parts = PartShares(self.options["parts"])
        self._parts.compile(device, spec)
        super().compile(device, spec)

    def encode(self, commands: CommandBuffer, frame: ResidentFrame) -> None:
        super().encode(commands, frame)
        commands.run(OVER, "mix", overlay=frame[Role.LATER], colour=frame[Role.COLOUR],
                     output=self._output)
        self._parts.encode(commands, frame, frame[Role.COLOUR], self._output)
        frame.set(Role.COLOUR, self._output)
