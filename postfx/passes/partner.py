"""Passes that run another denoiser beside the project's own and mix both results.

`Partner` runs before the upscaler and adds the other denoiser's picture as the plane `partner`. The
upscaler brings that plane to the output's size. `MixPartner` runs after the upscaler and mixes.
"""

from __future__ import annotations

from collections import ChainMap
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import ClassVar, Never

import numpy as np

from postfx.errors import FrameError, PassOptionError
from postfx.frame import FrameSpec, Part, Role
from postfx.kernels.partner import MIX_PARTNER
from postfx.passes import Pass, Reflection, ResidentFrame
from postfx.passes.composite import PartShares
from postfx.passes.denoise.models import UNSCALED, denoises_first, gives_picture, model_of
from postfx.passes.registry import BUILT_IN, load, make_asked, parse_pass, plug_ins
from postfx.runtime import CommandBuffer, Device

LASTING = 0.3
"""How much the partner counts in the mean of logarithms at the render's size, however long the
history is."""
WITHOUT_HISTORY = 0.5
"""How much more it counts in a frame without a history; with n frames, itself included, an nth of
that."""
SHARE_BESIDE_A_PICTURE = 0.75
"""How much it counts beside a network that gives the picture itself, of what it counts beside
others. On thirteen kinds the best share is about 0.55, but then the mixture is below Open Image
Denoise in moving water."""
SHARE_BESIDE_TWO_STAGES = 0.2
"""How much it counts beside a network that enlarges what another one denoised. On thirteen kinds it
gains in moving water alone, by less than a tenth of a dB, and costs as little in the mean; 0.6
costs 0.2 dB."""
ENLARGEMENT_POWER = 0.75
"""Its weight falls with this power of the enlargement, as it is enlarged without knowing edges."""
BACKWARD_FRAMES = 2
"""Frames of history that a run in both directions has where one direction has none."""
MIXTURE_REACH_SHARE = 0.3
"""How far the last mixture may lie from that mean, as a share of the way to the nearer picture.
More is steadier, but keeps what the partner counted when there was no history. On thirteen kinds at
1x, 0.15 has 30.02 dB and flicker 24.9, 0.3 has 30.01 and 24.6, 0.5 has 29.96 and 24.3."""
MIXING_PLANES = (Role.MOTION, Role.STRENGTH)
"""Planes that the mixture uses where the frame has them."""


class Partner(Pass):
    """Runs another denoiser and keeps its picture as the plane `partner`, for the pass
    `mix_partner`.

    Options:
        of: the other pass and its options, as in 'oidn' or 'oidn,quality=fast': any pass that
            leaves a picture of the frame's size, in scene-linear light.
        pixel_filter: as for `postfx.DenoiseUpscale`; for a pass that has this option, too, unless
            its own words name one.

    All other planes stay as they are. Frames that only give a history are left out where the other
    pass has none. Raises OptionError for words that name no pass, FrameError for a pass that
    changes the size.
    """

    name: ClassVar[str] = "partner"

    def __init__(self, *, of: str = "oidn", pixel_filter: float | str = "auto",
                 **unknown: Never) -> None:
        super().__init__(of=of, pixel_filter=pixel_filter, **unknown)
        asked = parse_pass(of, "--with")
        if asked.before or asked.after:
            raise PassOptionError(f"partner '{of}' runs before the upscaler: leave before= and "
                                  "after= out")
        own = load(asked.name).defaults
        if own.get("alpha") is True:
            asked.options.setdefault("alpha", "false")  # the upscaler denoises it
        if "pixel_filter" in own:
            asked.options.setdefault("pixel_filter", str(pixel_filter))
        self._own = make_asked(asked)

    def __copy__(self) -> Partner:
        return Partner(**self.options)

    def reflect(self, spec: FrameSpec) -> Reflection:
        own = self._own.reflect(spec)
        if ((own.output.width, own.output.height) != (spec.width, spec.height)
            or Role.COLOUR not in own.writes):
            raise FrameError(f"{spec.source or 'frame'}: pass '{self._own.name}' cannot be a "
                             "partner: it does not make a picture of the frame's size")
        kept = tuple(plane for plane in spec.planes if plane[0] is not Role.PARTNER)
        output = replace(spec, planes=(*kept, (Role.PARTNER, 3)))
        return Reflection(reads=own.reads, may_read=own.may_read, writes=(Role.PARTNER,),
                          output=output, may_read_guides=own.may_read_guides,
                          notes=(f"runs {self.described()}", *own.notes))

    def skip(self, spec: FrameSpec) -> str | None:
        return self._own.skip(spec)

    def remarks(self, spec: FrameSpec) -> tuple[str, ...]:
        return self._own.remarks(replace(spec, parts=()))

    def described(self) -> str:
        """The other pass, and the packages that its pixels depend on."""
        return " ".join([self._own.name,
                         *(f"({name} {version})" for name, version in self.packages().items())])

    def packages(self) -> Mapping[str, str]:
        found = ({} if self._own.name in BUILT_IN
                 else {f"pass {self._own.name}": plug_ins().get(self._own.name, "")})
        return {**found, **self._own.packages()}

    def accumulates(self, spec: FrameSpec) -> bool:
        return self._own.accumulates(spec)

    def compile(self, device: Device, spec: FrameSpec) -> None:
        self._own.compile(device, spec)
        super().compile(device, spec)

    def encode(self, commands: CommandBuffer, frame: ResidentFrame) -> None:
        super().encode(commands, frame)
        if frame.history_only and type(self._own).reset is Pass.reset:
            frame.set(Role.PARTNER, frame[Role.COLOUR])
            return
        other = replace(frame, tensors=dict(frame.tensors), guides=dict(frame.guides),
                        parts=dict(frame.parts),
                        host_planes=ChainMap({}, frame.host_planes), blank=set(frame.blank))
        self._own.encode(commands, other)
        frame.set(Role.PARTNER, other[Role.COLOUR])

    def note_time(self, milliseconds: float) -> None:
        self._own.note_time(milliseconds)

    def savings(self) -> tuple[tuple[str, str], ...]:
        return self._own.savings()

    def reset(self) -> None:
        self._own.reset()

    def history(self) -> dict[str, np.ndarray] | None:
        return self._own.history()

    def recall(self, history: Mapping[str, np.ndarray]) -> None:
        self._own.recall(history)


def partner_weight(frames: int, scale: float = 1.0) -> float:
    """How much a partner that knows one frame alone counts beside a denoiser with a history of so
    many ``frames``, the present one included, where the picture is enlarged by ``scale``.

    On thirteen kinds of content the best weight at the render's size was 0.75 to 0.8 in the first
    frame and 0.6 to 0.7 in the third; on five longer sequences 0.75, 0.4, and 0.25 in the eighth;
    at 2x 0.5, 0.25 to 0.4, and 0.25.
    """
    weight: float = (LASTING + WITHOUT_HISTORY / frames) / scale**ENLARGEMENT_POWER
    return weight


class MixPartner(Pass):
    """Mixes the plane `partner` into the colour, pixel by pixel, so that the mixture is steady over
    time.

    Both pictures are compared in logarithms of exposed light. The last mixture is moved along the
    motion and held near the weighted mean of both, between the two pictures. Without a motion
    plane, and in a shot's first frame, it is the mean. There the partner counts most, and less with
    each frame of history (`partner_weight`).
    The plane is then removed, and so are `motion` and `strength`.

    Options:
        scale: by how much the denoiser enlarges.
        model: the denoiser's network: beside one that gives the picture itself, as 'xl' does, the
            partner counts less, and least where that enlarges.
        both_ways: whether the denoised picture knows later frames, too.
        strength: as the denoiser's; the plane `strength` counts, too.
        parts: those of the denoiser. Light of three channels is brought to the mixed picture: each
            part keeps its share, so that parts add up to it.
    """

    name: ClassVar[str] = "mix_partner"

    def __init__(self, *, strength: float = 1.0, scale: float = 1.0, model: str = "m",
                 both_ways: bool = False, parts: Sequence[Part | str] = (),
                 **unknown: Never) -> None:
        super().__init__(strength=strength, scale=scale, model=model, both_ways=both_ways,
                         parts=parts, **unknown)
        self._frames = 0
        self._scale = max(self._number("scale", scale), 1.0)
        self._share = 1.0
        if self._scale > 1 and denoises_first(model):
            self._share = SHARE_BESIDE_TWO_STAGES
        elif self._scale == 1 and gives_picture(model_of(model, UNSCALED)):
            self._share = SHARE_BESIDE_A_PICTURE
        self._more = BACKWARD_FRAMES if both_ways else 0
        self._strength = self._number("strength", strength)
        if not 0 <= self._strength <= 1:
            raise PassOptionError(f"strength {self._strength:g}: give a number from 0 to 1")

    def reflect(self, spec: FrameSpec) -> Reflection:
        kept = tuple(plane
                     for plane in spec.planes if plane[0] not in (Role.PARTNER, *MIXING_PLANES))
        return Reflection(reads=(Role.COLOUR, Role.PARTNER), may_read=MIXING_PLANES,
                          writes=(Role.COLOUR,), output=replace(spec, planes=kept),
                          parts=PartShares(self.options["parts"]).read_of(spec))

    def skip(self, spec: FrameSpec) -> str | None:
        if spec.encoding != "scene-linear":
            return f"colour is {spec.encoding}, and both pictures are mixed in scene-linear light"
        return None if spec.has(Role.PARTNER) else "there is no partner's picture"

    def compile(self, device: Device, spec: FrameSpec) -> None:
        size = spec.height, spec.width
        self._outputs = [device.heap.tensor("mixture", (*size, 3)) for _ in range(2)]
        for output in self._outputs:
            output.fill(0)
        self._settings = device.heap.tensor("settings of the mixture", (4,))
        self._weight = device.heap.tensor("weight of the partner", (1, 1, 1))
        self._absent = {Role.STRENGTH: device.wrap("strength of the mixture",
                                                   np.ones((1, 1, 1), np.float32)),
                        Role.MOTION: device.wrap("no motion", np.zeros((1, 1, 2), np.float32))}
        device.make_ready(MIX_PARTNER)
        # not in common with copies, which other views get
        self._parts = PartShares(self.options["parts"])
        self._parts.compile(device, spec)
        super().compile(device, spec)

    def encode(self, commands: CommandBuffer, frame: ResidentFrame) -> None:
        super().encode(commands, frame)
        keep = self._frames > 0 and not frame.reset and Role.MOTION in frame
        seen = self._frames + 1 if keep else 1
        self._frames = 0 if frame.unusable else seen
        self._outputs.reverse()
        self._settings.put(np.array([frame.exposure_factor, MIXTURE_REACH_SHARE, keep,
                                     self._strength], np.float32))
        weight = self._share * partner_weight(seen + self._more, self._scale)
        self._weight.put(np.full((1, 1, 1), weight, np.float32))
        whole = frame[Role.COLOUR]
        history, output = self._outputs
        commands.run(MIX_PARTNER, "mix", colour=whole, partner=frame[Role.PARTNER], history=history,
                     output=output, settings=self._settings, weight=self._weight,
                     **{str(role): frame[role] if role in frame else self._absent[role]
                        for role in MIXING_PLANES})
        self._parts.encode(commands, frame, whole, output)
        frame.set(Role.COLOUR, self._outputs[1])

    def reset(self) -> None:
        self._frames = 0

    def history(self) -> dict[str, np.ndarray]:
        if not self._frames:
            return {}
        return {"mixture": self._outputs[1].content(), "frames": np.array([self._frames], np.int32)}

    def recall(self, history: Mapping[str, np.ndarray]) -> None:
        self._frames = int(history["frames"][0]) if history else 0
        if history:
            self._outputs[1].upload(history["mixture"])
