"""Neural denoised upscaler: noisy planes at render size in, clean colour at output size out, steady over time."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, ClassVar

import numpy as np

from postfx.errors import GuideError
from postfx.frame import GUIDE_ROLES, FrameSpec, Role
from postfx.passes._denoise_budget import Ladder, cost, family
from postfx.passes._denoise_carried import Carried, carried_roles
from postfx.passes._denoise_frame import Frames
from postfx.passes._denoise_graph import has_model
from postfx.passes._denoise_layout import active_cells
from postfx.passes._denoise_models import GUIDED, model_of
from postfx.passes._denoise_planes import ABSENT, Planes, Size
from postfx.passes._denoise_reactive import Reactive, parse_reactive
from postfx.passes._denoise_restore import Restore
from postfx.passes._denoise_spared import Spared
from postfx.passes._denoise_strength import Plain, Strength
from postfx.passes._denoise_window import Sizes
from postfx.passes.base import Pass, PassOptionError, Reflection, ResidentFrame
from postfx.runtime import CommandBuffer, Device, Tensor

PLANES = tuple(ABSENT)
LEAST, MOST, USUAL = 1.0, 3.0, 2.0


class DenoiseUpscale(Pass):
    """Denoise and enlarge, using the frames before by motion. Reads what planes there are, needs colour only.

    Options:
        scale: output size over render size, 1 to 3. None: the size of the frame's guides, or 2 without guides.
        model: tag of the network, 's', 'm' or 'l', which runs in the device's fast precision, or with one: 'm.fp32',
            'm.int8' for the CPU, 'm.fp16' for CUDA.
        budget: milliseconds that a frame may take on the device, None for no limit: networks smaller than `model`, of
            its precision ('s' below 'm', 's' and 'm' below 'l'), take turns with it; the history goes on.
        strength: 0 returns the input, only resampled, and runs no network; 1 denoises fully. The plane `strength`
            says the same pixel by pixel, and both are multiplied; where it is 0, no network runs.
        reactive: where the history is not used, for what moves without motion vectors, such as particles: 'plane', the
            plane `reactive`; 'difference', where colour differs from the plane `opaque_colour`; 'auto', the first of
            the two that the frame has; 'none'. Then perhaps scale= and threshold=, as in 'auto,scale=4,threshold=0.05'.

    Alpha and a transparency overlay are only resampled; the pass `overlay` composites.

    A frame's guides, planes at output size, make edges exact: ``denoise_upscale.<tag>.guides`` reads them. Without a
    motion plane every frame stands alone. Raises PassOptionError for a scale outside 1 to 3, a strength outside 0 to 1,
    a budget that is not above 0 and a model that is only for guides, GuideError for guides of another size than the
    output's.
    """

    name: ClassVar[str] = "denoise_upscale"
    defaults: ClassVar[Mapping[str, Any]] = MappingProxyType({"scale": None, "model": "m", "strength": 1.0,
                                                            "budget": None, "reactive": "auto"})

    def __init__(self, **options: Any) -> None:
        super().__init__(**options)
        given = self.options["scale"]
        self.scale = None if given is None else float(given)
        if self.scale is not None and not LEAST <= self.scale <= MOST:
            raise PassOptionError(f"pass '{self.name}' scales by 1 to 3, not {self.scale:g}: give a scale in between")
        self.strength = float(self.options["strength"])
        if not 0 <= self.strength <= 1:
            raise PassOptionError(f"pass '{self.name}' has strengths 0 to 1, not {self.strength:g}: give one of them")
        self.budget = None if self.options["budget"] is None else float(self.options["budget"])
        if self.budget is not None and not self.budget > 0:
            raise PassOptionError(f"pass '{self.name}' cannot work in {self.budget:g} ms: give a budget above 0")
        self._mask = parse_reactive(str(self.options["reactive"]))
        self._used: str | None = None
        plain = str(self.options["model"]).removesuffix(GUIDED)
        if plain != self.options["model"]:
            raise PassOptionError(f"model '{plain}{GUIDED}' runs when a frame has guides: give the model '{plain}'")

    def reflect(self, spec: FrameSpec) -> Reflection:
        carried = carried_roles(spec)
        size = self._output_size(spec)
        output = FrameSpec(size.width, size.height, (Role.COLOUR, *carried))
        lost = tuple(role for role in GUIDE_ROLES if not spec.has(role))
        guides = GUIDE_ROLES if self._reads_guides(spec) else lost
        planes = (*PLANES, Role.STRENGTH, *self._reactive_planes(spec)) if self.strength else ()
        demanded = self._mask.demanded() if self.strength else ()
        kept = [role for role in carried if role not in spec.guide_roles]
        guides = (*(guides if self.strength else ()), *(role for role in carried if role in spec.guide_roles))
        return Reflection(reads=(Role.COLOUR, *demanded), may_read=(*planes, *kept), writes=(Role.COLOUR, *carried),
                          output=output, may_read_guides=guides)

    def remarks(self, spec: FrameSpec) -> tuple[str, ...]:
        if not self.strength:
            return ("strength 0: the input is only resampled",)
        seen = {*spec.roles, *spec.guide_roles}
        lost = [str(role) for role in GUIDE_ROLES if role not in seen]
        found = [] if spec.has(Role.MOTION) else ["no motion plane, so every frame is denoised alone and may flicker"]
        found += [f"blurs more without the planes {', '.join(lost)}"] if lost else []
        return (*found, *self._guide_remarks(spec), *self._mask.remarks(spec))

    def compile(self, device: Device, spec: FrameSpec) -> None:
        self._output = self.reflect(spec).output
        size = Size(self._output.height, self._output.width)
        if self.strength:
            self._compile_network(device, spec, size)
        else:
            self._plain = Plain(device, spec, size)
        self._carried = Carried(device, spec, size)
        super().compile(device, spec)

    def _compile_network(self, device: Device, spec: FrameSpec, size: Size) -> None:
        guided = self._is_guided(spec)
        self._planes = Planes(device, spec, size, guided)
        tags = self._tags(guided)
        self._models = {tag: model_of(tag, guided, device) for tag in tags}
        self._ladder = Ladder(list(map(cost, self._models.values())), self.budget) if self.budget else None
        self._frames = Frames(device, Sizes(spec.height, spec.width, *size), list(self._models.values()), guided,
                              reactive=self._mask.role(spec) is not None)
        self._reactive = Reactive(device, spec, self._mask)
        self._restore = Restore(device, size) if size == (spec.height, spec.width) else None
        self._spared = Spared()
        full = self.strength == 1 and not spec.has(Role.STRENGTH)
        self._strength = None if full else Strength(device, spec, size, self.strength)

    def _tags(self, guided: bool) -> tuple[str, ...]:
        """Tags of the networks to choose from, fastest first; the one that was asked for without a budget."""
        model = self.options["model"]
        smaller = family(model)[:-1] if self.budget else ()
        return (*(tag for tag in smaller if has_model(model_of(tag, guided))), model)

    def ran(self, milliseconds: float) -> None:
        if self.strength:
            self._spared.took(milliseconds)
            if self._ladder:
                self._ladder.took(milliseconds)

    def left_out(self) -> tuple[tuple[str, str], ...]:
        return self._spared.lines() if self.strength else ()

    def chosen(self) -> str | None:
        return self._used if self.budget else None

    def reset(self) -> None:
        self._fresh = False
        self._exposure = 1.0

    def history(self) -> dict[str, np.ndarray]:
        if not (self.strength and self._fresh):
            return {}
        known = {"exposure": np.float64(self._exposure), "network": np.int64(list(self._models).index(self._used))}
        return known | self._frames.kept()

    def recall(self, history: Mapping[str, np.ndarray]) -> None:
        self._fresh = bool(history)
        if self._fresh:
            self._exposure, self._used = float(history["exposure"]), list(self._models)[int(history["network"])]
            self._frames.use(self._models[self._used])
            self._frames.recall(history)

    def encode(self, commands: CommandBuffer, frame: ResidentFrame) -> None:
        super().encode(commands, frame)
        encode = self._encode_network if self.strength else self._plain.encode
        colour = encode(commands, frame)
        frame.set(Role.COLOUR, colour)
        self._carried.encode(commands, frame)
        for role in (*PLANES, Role.STRENGTH, Role.REACTIVE, Role.OPAQUE_COLOUR):
            frame.tensors.pop(role, None)
        frame.guides.clear()
        frame.spec, frame.jitter = self._output, (0.0, 0.0)

    def _encode_network(self, commands: CommandBuffer, frame: ResidentFrame) -> Tensor:
        """The denoised colour, blended by strength; the history stays fully denoised."""
        cells = self._active(frame)
        if cells is not None and not cells.any():
            self._spared.begin(0.0, False, False)
            self._fresh = False
            return self._strength.plain(commands, frame)
        band = None if cells is None else self._frames.layout(cells)
        keep = self._fresh and not frame.reset and Role.MOTION in frame
        gain = frame.exposure / self._exposure if keep else 1.0
        params = np.array([frame.exposure, *frame.jitter, gain], np.float32)
        self._used = list(self._models)[self._ladder.rung if self._ladder else 0]
        self._frames.use(self._models[self._used])
        still = keep and gain == 1 and self._is_still(frame)
        self._spared.begin(1.0 if band is None else band.share, keep, still)
        planes = {**self._planes.encode(commands, frame), **self._reactive.encode(commands, frame)}
        colour = self._frames.encode(commands, planes, params, keep, still, band)
        self._fresh, self._exposure = True, frame.exposure
        colour = self._restore.encode(commands, frame, colour) if self._restore else colour
        return self._strength.encode(commands, frame, colour) if self._strength else colour

    def _active(self, frame: ResidentFrame) -> np.ndarray | None:
        """Where the frame's strength is not 0, as squares of 16 pixels; None where that is not known, or where the
        whole frame is judged."""
        if Role.STRENGTH not in frame.given or (self._restore and self._restore.acts_on(frame)):
            return None
        return active_cells(frame.given[Role.STRENGTH])

    def _is_still(self, frame: ResidentFrame) -> bool:
        return Role.MOTION in frame.given and not frame.given[Role.MOTION].any()

    def _output_size(self, spec: FrameSpec) -> Size:
        """The guides' size, if the scale leads there, rounded or cut; without guides the scaled size, rounded."""
        guides, scale = spec.guides, self.scale or USUAL
        size = Size(round(spec.height * scale), round(spec.width * scale))
        if guides is None:
            return size
        sides = ((guides.width, spec.width), (guides.height, spec.height))
        if self.scale is None:
            low = max(LEAST, *((outer - 0.5) / side for outer, side in sides))
            high = min(MOST, *((outer + 1) / side for outer, side in sides))
            mend = "render them 1 to 3 times as large as the colour, by the same factor both ways"
            fits = low <= high
        else:
            mend = f"leave the scale out, or render them at {size.width}x{size.height} for a scale of {scale:g}"
            fits = all(outer in (round(side * scale), int(side * scale)) for outer, side in sides)
        if not fits:
            found = f"guides are {guides.width}x{guides.height}, the colour is {spec.width}x{spec.height}"
            raise GuideError(f"{guides.source or 'frame'}: {found}: {mend}")
        return Size(guides.height, guides.width)

    def _reactive_planes(self, spec: FrameSpec) -> tuple[Role, ...]:
        role = self._mask.role(spec)
        return (role,) if role else ()

    def _reads_guides(self, spec: FrameSpec) -> bool:
        """Whether a network does; at render size it is better with the planes, which have the samples of the colour."""
        return self._has_guided_model() and not self._is_render_size(spec)

    def _is_guided(self, spec: FrameSpec) -> bool:
        return bool(set(spec.guide_roles) & set(GUIDE_ROLES)) and self._reads_guides(spec)

    def _has_guided_model(self) -> bool:
        return has_model(model_of(self.options["model"], guided=True))

    def _is_render_size(self, spec: FrameSpec) -> bool:
        return self._output_size(spec) == (spec.height, spec.width)

    def _guide_remarks(self, spec: FrameSpec) -> list[str]:
        if spec.guides is None or spec.guide_roles == (Role.OVERLAY,):
            return []
        if not self._has_guided_model():
            return [f"model '{self.options['model']}' does not read guides: they only stand in for missing planes"]
        if self._is_render_size(spec):
            return ["guides of the render size only stand in for missing planes"]
        rough = [str(role) for role in GUIDE_ROLES if spec.has(role) and role not in spec.guide_roles]
        return [f"edges are less exact without the guides {', '.join(rough)}"] if rough else []
