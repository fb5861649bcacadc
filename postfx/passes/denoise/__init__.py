"""The denoiser: noisy planes in, clean colour out, at the same size or larger, steady over time.

`DenoiseUpscale` is the pass. Which networks run is decided in `choice`; the work on a frame is in
`frame`, and all of its steps are the tables of `graph`.
"""

from __future__ import annotations

import os
import warnings
from collections.abc import Hashable, Iterable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import ClassVar, Never

import numpy as np

from postfx.caching import LRUCache
from postfx.errors import DeviceError, FrameError, PassOptionError
from postfx.frame import GUIDE_ROLES, FrameSpec, Part, Role
from postfx.passes import MOST_SIZES, Pass, Reflection, ResidentFrame
from postfx.passes.denoise.activity import active_cells, grown, whole_tiles
from postfx.passes.denoise.choice import NetworkChoice
from postfx.passes.denoise.first_stage import DENOISED_SHARE
from postfx.passes.denoise.frame import Ready, ReadyNetwork, Wishes
from postfx.passes.denoise.geometry import CELL, Band, Size, Sizes
from postfx.passes.denoise.history import FILTERED_PICTURE, History, PartHistory
from postfx.passes.denoise.ladder import TWO_STAGES_COST, Ladder, cost, family
from postfx.passes.denoise.models import (
    CLASSIC,
    GUIDED,
    UNSCALED,
    halo_of,
    mixture_model,
    model_of,
    name_models,
    network_name,
    runs_classic,
    validate_tag,
)
from postfx.passes.denoise.options import parse_reactive, validate_scale, validate_size
from postfx.passes.denoise.parts import Layers, checked_parts
from postfx.passes.denoise.planes import ABSENT, MIRRORED_ROLES, passthrough_roles
from postfx.passes.denoise.primaries import widen_history
from postfx.passes.denoise.reflections import Cameras, can_follow
from postfx.passes.denoise.remarks import (
    note_filters,
    note_network,
    remark_on_guides,
    remark_on_networks,
    remark_on_planes,
)
from postfx.passes.denoise.savings import (
    JITTERED,
    NO_HISTORY,
    NOTHING_MOVES,
    REPEATED_NOISE,
    UNFOLLOWED_REFLECTIONS,
    Amount,
    Reason,
    Savings,
)
from postfx.passes.denoise.unfiltered import SPREAD_MARGIN_PX
from postfx.passes.denoise.window import FrameWork
from postfx.pixel_filter import find_stddev, parse_stddev
from postfx.repeats import ONE_SEED, Alike, FrameMemory, RepeatDetector
from postfx.runtime import CommandBuffer, Device, Library, Tensor, has_networks

READ_PLANES = tuple(ABSENT)
"""Planes that every network reads; constants stand in for those that a frame lacks."""
NO_NETWORKS = ("the package onnxruntime is missing, so the classical filter stands in for the "
               "network, and more noise stays: install it, or accept that by the model classic")
PART_FILTERS = "picture", "own"
"""Values of the option `part_filters`: whose filters parts get."""
# Names of entries in a history, see `DenoiseUpscale.history`.
NETWORK_PREFIX = "network "
"""The network's tag follows."""
FIRST_STAGE = "first stage "
"""The first stage's own entry follows."""
WIDER = "wider primaries"
"""Whether the history's light is in wider primaries than the frames'."""
FOUND_STDDEV = "pixel filter"
"""Standard deviation, in pixels, of the filter that was found in the shot's first frame."""
REPEATS = "repeats "
"""The entry of what finds repeated noise follows."""


class DenoiseUpscale(Pass):
    """Denoises, and enlarges where asked, reusing earlier frames along their motion.

    It needs only colour, and reads the other planes that a frame has.

    Options:
        scale: output size over render size, 1 to 3. None: the size of the frame's guides, or 1
            without guides.
        size: width and height of the output, in place of a scale. The render's size may then change
            from frame to frame, and the history goes on.
        model: tag of the network: 's', 'm', 'l' or 'xl', which runs in the device's fast precision;
            or with one: 'm.fp32', 'm.int8' for the CPU, 'm.fp16' for CUDA. Or the file of your own
            network, 'nets/mine.onnx', with its card beside it, and mine.guides.onnx and
            mine.1x.onnx if they exist. Or 'classic', a filter without a network, for frames without
            parts. The default here is 'm'. `postfx run` and `postfx.denoise` take 'xl' if frames
            fit into memory, except for larger frames with guides: it is cleaner, and takes ten
            times as long on a CPU. To enlarge, 'xl' denoises frames at their own size first, and a
            second network enlarges a mixture of the result and the noisy picture; frames with
            jitter, or with guides in place of planes, are enlarged by 'l' alone. Beside 'xl', and
            'l' at the render's size, 'm' filters parts and noisy alpha.
        library: the `postfx.Library`, or folder, in which `denoise_upscale.<model>` and its
            variants are; None for the networks that come with postfx.
        budget: milliseconds that a frame may take on the device, None for no limit. If `model` is
            too slow, smaller networks of its precision run ('s' below 'm', 's' and 'm' below 'l'),
            or 'classic'; the history goes on.
        strength: 1 denoises fully, 0 only resamples the input and runs no network. The plane
            `strength` sets it pixel by pixel, and both are multiplied; no network runs where it is
            0.
        pixel_filter: what to do if the renderer adds each sample to several pixels, so that noise
            looks like detail. 'auto': find the filter by the noise of a shot's first frame. A
            number, 0.2 to 0.75: the standard deviation of its gaussian in pixels. Networks that
            give the picture itself ('xl', and 'l' at the render's size) then get planes without the
            filter, and it is applied to their picture. 'none': nothing.
        parts: names of the frames' parts that are denoised with the picture, or `postfx.frame.Part`
            for those that are not light. Light of one group keeps its sum.
        part_filters: 'picture' filters parts like the picture; 'own' runs the network on each part
            that is light, which takes as long as the picture for each.
        alpha: whether alpha is denoised with the picture, where it is between 0 and 1; else it is
            only resampled.
        error: whether to add the plane `error`: the squared error that the network expects of each
            pixel of the denoised colour, in code values of a display (x / (1 + x) of exposed light,
            sRGB); 0 where no network ran.
        reactive: where the history is not used, for things that move without motion vectors, such
            as particles. 'plane': where the plane `reactive` says so. 'difference': where colour
            differs from the plane `opaque_colour`. 'auto': by the first of the two that the frame
            has. 'none': nowhere. scale= and threshold= may follow, as in
            'auto,scale=4,threshold=0.05'.

    A frame's guides, planes at output size, make edges exact; ``denoise_upscale.<tag>.guides``
    reads them. At the render's size ``denoise_upscale.<tag>.1x`` runs if it exists.

    A frame without a motion plane is denoised alone. So is one with the same noise as the frame
    before, as with one seed for all: a history would take that noise for detail.

    If a shot has light outside the gamut, which is negative in the frames' primaries, it is
    denoised in wider primaries and converted back. On a GPU negative light counts as 0.

    A transparency overlay is only resampled; the pass `overlay` composites it. The plane `later` is
    handed on to the pass `both_ways`, and the plane `partner`, resampled, to the pass
    `mix_partner`.

    Raises PassOptionError for a scale outside 1 to 3, a scale beside a size, a strength outside 0
    to 1, a budget that is not above 0, a model that is chosen automatically and an error that no
    network predicts, FrameError for a frame whose output would not be 1 to 3 times as large or
    whose colour is not scene-linear, GuideError for guides of another size than the output's.
    """

    name: ClassVar[str] = "denoise_upscale"

    def __init__(self, scale: float | None = None, *, size: Sequence[int] | None = None,
                 model: str = "m",
                 strength: float = 1.0, pixel_filter: float | str = "auto",
                 budget: float | None = None, reactive: str = "auto",
                 parts: Sequence[Part | str] = (), part_filters: str = "picture",
                 alpha: bool = True, error: bool = False,
                 library: Library | str | Path | None = None, **unknown: Never) -> None:
        super().__init__(scale=scale, size=size, model=model, strength=strength,
                         pixel_filter=pixel_filter, budget=budget, reactive=reactive, parts=parts,
                         part_filters=part_filters, alpha=alpha, error=error, library=library,
                         **unknown)
        self.scale = validate_scale(scale)
        self.size = validate_size(size, self.scale)
        self.strength = self._number("strength", strength)
        if not 0 <= self.strength <= 1:
            raise PassOptionError(f"strength {self.strength:g}: give a number from 0 to 1")
        self._given_stddev = parse_stddev(pixel_filter)
        self.budget = None if budget is None else self._number("budget", budget)
        if self.budget is not None and not self.budget > 0:
            raise PassOptionError(f"pass '{self.name}' cannot work in {self.budget:g} ms: give a "
                                  "budget above 0")
        self._mask = parse_reactive(str(reactive))
        self._parts, self._alpha, self._error = checked_parts(parts), bool(alpha), bool(error)
        if part_filters not in PART_FILTERS:
            raise PassOptionError(f"pass '{self.name}' has no part filters '{part_filters}': give "
                                  f"{' or '.join(PART_FILTERS)}")
        self._parts_with_own_filters = [
            part.name for part in self._parts
            if part.is_light and part_filters == PART_FILTERS[1]]
        self._last_tag: str | None = None  # of the network that ran last
        self._cameras, self._repeats = Cameras(), RepeatDetector()
        self._last_inputs = FrameMemory()
        self._has_told_of_one_seed = False
        self._spared_halo_px = 0  # of a first stage, whose frames have the second one's halo
        own = Library(os.path.expanduser(library)) if isinstance(library, str | Path) else library
        asked = validate_tag(str(model), own)
        self._tag = CLASSIC if self._falls_back(asked) else asked
        self._is_fallback = self._tag != asked
        if self._is_fallback:
            warnings.warn(NO_NETWORKS, RuntimeWarning, stacklevel=2)
        if self._tag == CLASSIC and self._parts:
            raise PassOptionError("model 'classic' filters no parts: give a network, or no parts")
        self._networks = NetworkChoice(
            self._tag, self.scale, self.size, self.strength, has_budget=self.budget is not None,
            has_parts=bool(self._parts), filters_alpha=self._alpha, adds_error=self._error)

    def _falls_back(self, tag: str) -> bool:
        """Whether the classical filter stands in for a network, because nothing runs networks
        here."""
        return not has_networks() and "/" not in tag and CLASSIC in family(tag) and not self._parts

    # What frames of a spec need, and what a plan says of them

    def reflect(self, spec: FrameSpec) -> Reflection:
        if spec.encoding != "scene-linear":
            raise FrameError(f"{spec.source or 'frame'}: colour is {spec.encoding}, and the "
                             "denoiser takes scene-linear light: let it run before tone mapping")
        self._networks.check(spec)
        carried = passthrough_roles(spec)
        written = (Role.COLOUR, *carried, *(Role.ERROR,) * self._error)
        size = self._networks.output_size(spec)
        planes = [role for role in carried if role not in spec.guide_roles]
        guides = [role for role in carried if role in spec.guide_roles]
        demanded: tuple[Role, ...] = ()
        if self.strength:
            demanded = self._mask.demands()
            planes = [*self._seen_planes(spec), *planes]
            guides = [*self._seen_guides(spec), *guides]
        return Reflection(reads=(Role.COLOUR, *demanded), may_read=tuple(dict.fromkeys(planes)),
                          writes=written, output=FrameSpec(size.width, size.height, written),
                          may_read_guides=tuple(guides), notes=self._notes(spec),
                          parts=self._read_parts(spec))

    def _seen_planes(self, spec: FrameSpec) -> tuple[Role, ...]:
        """Planes that the network, and what follows reflections, may read of frames of a spec."""
        planes = (*READ_PLANES, Role.STRENGTH, *self._mask_planes(spec))
        if self._networks.reads_mirrored(spec):
            planes += tuple(MIRRORED_ROLES)
        if can_follow(spec):
            planes += (Role.SPECULAR_HIT_DISTANCE,)
        return planes

    def _seen_guides(self, spec: FrameSpec) -> tuple[Role, ...]:
        """Guides that a network reads, or else those that stand in for planes that are missing."""
        if self._networks.reads_guides(spec):
            return GUIDE_ROLES
        return tuple(role for role in GUIDE_ROLES if not spec.has(role))

    def _mask_planes(self, spec: FrameSpec) -> tuple[Role, ...]:
        role = self._mask.role(spec)
        return (role,) if role else ()

    def _read_parts(self, spec: FrameSpec) -> tuple[str, ...]:
        """Names of the parts that are denoised; FrameError for one that the frame lacks."""
        names = tuple(part.name for part in self._parts)
        for name in names:
            if name not in spec.part_names:
                held = ", ".join(spec.part_names) or "none"
                raise FrameError(f"{spec.source or 'frame'}: no part '{name}': its parts are "
                                 f"{held}")
        return names

    def _notes(self, spec: FrameSpec) -> tuple[str, ...]:
        """Short clauses on the work, for the plan."""
        notes = [note_network(self._networks, spec)] if self.strength else []
        notes += note_filters(self._networks, spec) if self.strength and self._parts else []
        notes += [f"stays {self.size} where frames change their size"] if self.size else []
        stddev = self.undone_stddev(spec)
        notes += ([f"a pixel filter of {stddev:.2f} px is undone before it and applied again"]
                  if stddev else [])
        alone = ", ".join(self._parts_with_own_filters)
        notes += [f"own filters: {alone}"] if self.strength and alone else []
        notes += (["smooth reflections move by their hit distance"]
                  if self.strength and can_follow(spec) else [])
        return tuple(notes)

    def remarks(self, spec: FrameSpec) -> tuple[str, ...]:
        if not self.strength:
            return ("strength 0: the input is only resampled",)
        found = [NO_NETWORKS] if self._is_fallback else []
        found += remark_on_planes(spec)
        found += remark_on_networks(self._networks, spec)
        if self._given_stddev and not self.undone_stddev(spec):
            found.append(f"a pixel filter of {self._given_stddev:.2f} px stays in the noise: "
                         "network xl undoes it, and l at the render's size")
        found += remark_on_guides(self._networks, spec)
        return (*found, *self._mask.remarks(spec))

    def undone_stddev(self, spec: FrameSpec) -> float:
        """The standard deviation, in pixels, of the pixel filter that is undone in frames of a
        spec, as far as the option tells; 0 for none."""
        return self._given_stddev or 0.0 if self._undoes_filters(spec) else 0.0

    def leaves_filters(self, spec: FrameSpec) -> bool:
        """Whether frames of a spec are denoised with what a pixel filter did to their noise, though
        no option says so."""
        return (self._given_stddev is None and self.strength > 0
                and not self._undoes_filters(spec))

    def _undoes_filters(self, spec: FrameSpec) -> bool:
        return self.strength > 0 and self._networks.gives_picture(spec)

    def accumulates(self, spec: FrameSpec) -> bool:
        return self.strength > 0 and spec.has(Role.MOTION)

    # What is made ready for frames of a spec

    def compile(self, device: Device, spec: FrameSpec) -> None:
        if self._tag == CLASSIC and self.strength and not runs_classic(device):
            raise DeviceError(f"model 'classic' has no kernels for this device, '{device.name}': "
                              "give the device cpu with compiled kernels, the device cuda, or a "
                              "network")
        self._device, self._output = device, self.reflect(spec).output
        self._savings = Savings()
        self._last_inputs.forget()
        self._result: Tensor | None = None
        if self.strength:
            models = self._networks.models(spec, device)
            self._tags = tuple(models)
            self._ladder = self._make_ladder(spec, models) if self.budget else None
            if self.size:
                self._name_models_of_all_sizes(spec)
            self._make_histories(spec, models)
        self._sizes: LRUCache[FrameSpec, Ready] = LRUCache(MOST_SIZES)
        self._ready = self._sizes.get_or_make(spec, partial(self._made_ready, spec))
        super().compile(device, spec)

    def _make_ladder(self, spec: FrameSpec, models: Mapping[str, str]) -> Ladder:
        """Chooses one of these models by its time. It begins with the fastest network, not with
        the classical filter."""
        assert self.budget is not None  # without one there is nothing to choose
        costs = list(map(cost, models.values()))
        if self._networks.has_first_stage(spec):
            costs[-1] = TWO_STAGES_COST
        return Ladder(costs, self.budget, int(len(models) > 1 and self._tags[0] == CLASSIC))

    def _name_models_of_all_sizes(self, spec: FrameSpec) -> None:
        """Tell the device which models may run once frames change their size. Headers of files
        name them, so that a frame's file is the same wherever a run begins."""
        endings = ("", UNSCALED, GUIDED)[:2 if spec.guides is None else 3]
        tags = self._networks.tags(spec, runs_classic(self._device))
        name_models(self._device, (find(tag, ending, self._device) for tag in tags
                                   for ending in endings for find in (model_of, mixture_model)))

    def _make_histories(self, spec: FrameSpec, models: Mapping[str, str]) -> None:
        """Make the histories of the picture and its parts. Networks that run beside these models,
        on single parts or for all of them, have histories of their own."""
        reactive, size = self._mask.role(spec) is not None, self._networks.output_size(spec)
        sizes = Sizes(Size(spec.height, spec.width), size)
        self._history = History(self._device, sizes, reactive)
        filters = self._networks.filter_model(spec, models, self._device)
        alone = (*self._parts_with_own_filters, *((FILTERED_PICTURE,) if filters else ()))
        own = {name: History(self._device, sizes, reactive) for name in alone}
        self._part_history = PartHistory(self._device, size, self._parts, own)

    def resize(self, spec: FrameSpec) -> bool:
        before = self._spec
        if before is None:
            return False
        # at 1x fewer guides are read
        alike = replace(before, width=spec.width, height=spec.height, guides=spec.guides)
        if not self.size or spec != alike or self.reflect(spec).output != self._output:
            return False
        if self.strength and tuple(self._networks.models(spec, self._device)) != self._tags:
            return False
        if self.strength:
            self._savings.note_resize(spec in self._sizes)
            if self._ladder:
                self._ladder.note_resize(spec.width * spec.height / (before.width * before.height))
        self._ready = self._sizes.get_or_make(spec, partial(self._made_ready, spec))
        self._spec = spec
        if isinstance(self._ready, ReadyNetwork) and self._ready.first_stage:
            self._ready.first_stage.reset()
        return True

    def _made_ready(self, spec: FrameSpec) -> Ready:
        """What frames of a spec need: networks, tensors and commands."""
        size = self._networks.output_size(spec)
        if not self.strength:
            none = PartHistory(self._device, size, ())
            layers = (Layers(self._device, spec, size, self._parts, False, none) if self._parts
                      else None)
            return Ready(self._device, spec, size, layers)
        models = self._networks.models(spec, self._device)
        filters = self._networks.filter_model(spec, models, self._device)
        first, single = None, dict[str, str]()
        if self._networks.has_first_stage(spec):
            single = self._networks.single_stage_model(spec, models, self._device)
            models |= single
            first = self._first_stage(models.values())
        wishes = Wishes(self.strength, self._mask, self._parts, self._alpha, filters, self._error,
                        first, next(iter(single), ""), self._spared_halo_px)
        return ReadyNetwork(self._device, spec, size, models, self._networks.is_guided(spec),
                            wishes, self._history, self._part_history)

    def _first_stage(self, models: Iterable[str]) -> DenoiseUpscale:
        """The denoiser that runs before these networks enlarge frames, and mixes its result with
        the noisy frame.

        It is active in the halo of these networks, too. Little of that border reaches the result,
        so the two denoisers share one halo.
        """
        stage = DenoiseUpscale(1, strength=DENOISED_SHARE, alpha=False, pixel_filter="none",
                               **{name: self.options[name]
                                  for name in ("model", "reactive", "library")})
        stage._spared_halo_px = halo_of(models) + CELL
        return stage

    # Times and savings, for the budget and the summary

    def note_time(self, milliseconds: float) -> None:
        if self.strength:
            self._savings.note_time(milliseconds)
            if self._ladder:
                self._ladder.note_time(milliseconds)

    def savings(self) -> tuple[tuple[str, str], ...]:
        return self._savings.lines() if self.strength else ()

    # What a frame leaves to the next

    def reset(self) -> None:
        self._has_history = self._is_wider = False
        self._exposure_factor = 1.0
        self._found_stddev: float | None = None
        self._cameras.reset()
        self._repeats.reset()
        self._last_inputs.forget()

    def history(self) -> dict[str, np.ndarray]:
        if not (self.strength and self._has_history):
            return {}
        known = {"exposure": np.array(self._exposure_factor, np.float64),
                 f"{NETWORK_PREFIX}{self._last_tag}": np.array(1, np.int64),
                 WIDER: np.array(self._is_wider, np.int64)}
        if self._found_stddev is not None:
            known[FOUND_STDDEV] = np.array(self._found_stddev, np.float64)
        known |= {f"{REPEATS}{name}": array for name, array in self._repeats.history().items()}
        if isinstance(self._ready, ReadyNetwork) and self._ready.first_stage:
            known |= {f"{FIRST_STAGE}{name}": array
                      for name, array in self._ready.first_stage.history().items()}
        return (known | self._cameras.snapshot() | self._history.snapshot()
                | self._part_history.snapshot())

    def recall(self, history: Mapping[str, np.ndarray]) -> None:
        self._has_history = bool(history)
        self._last_inputs.forget()
        if self._has_history:
            self._exposure_factor = float(history["exposure"])
            self._is_wider = bool(history.get(WIDER, False))
            if not isinstance(self._ready, ReadyNetwork):
                raise KeyError(f"pass '{self.name}' has no history at strength 0")
            self._last_tag = next(iter(_entries_under(NETWORK_PREFIX, history)), "")
            if FOUND_STDDEV in history:
                self._found_stddev = float(history[FOUND_STDDEV])
            self._history.use(self._ready.models[self._last_tag])
            self._history.recall(history)
            self._part_history.recall(history)
            self._cameras.recall(history)
            self._repeats.recall(_entries_under(REPEATS, history))
            if self._ready.first_stage:
                self._ready.first_stage.recall(_entries_under(FIRST_STAGE, history))

    # One frame

    def encode(self, commands: CommandBuffer, frame: ResidentFrame) -> None:
        super().encode(commands, frame)
        ready = self._ready
        colour = (self._denoise(commands, frame, ready) if isinstance(ready, ReadyNetwork)
                  else ready.encode_input(commands, frame))
        frame.set(Role.COLOUR, colour)
        if ready.error:
            frame.set(Role.ERROR, ready.error.encode(commands, frame))
        if ready.passthrough:
            ready.passthrough.encode(commands, frame)
        for role in (*READ_PLANES, *MIRRORED_ROLES, Role.STRENGTH, Role.REACTIVE,
                     Role.OPAQUE_COLOUR, Role.SPECULAR_HIT_DISTANCE):
            if role not in self._output.roles:
                frame.tensors.pop(role, None)
        frame.guides.clear()
        frame.spec, frame.jitter = self._output, (0.0, 0.0)

    def _denoise(self, commands: CommandBuffer, frame: ResidentFrame,
                 ready: ReadyNetwork) -> Tensor:
        """The denoised colour, by as much work as the frame needs."""
        savings = Savings() if frame.history_only else self._savings
        strength = frame.host_planes.get(Role.STRENGTH)
        cells = None if strength is None else active_cells(strength)
        if ready.error and cells is not None:
            ready.error.forget()
        if cells is not None and not cells.any():
            savings.note_frame(Amount.NOTHING, 0.0)
            self._has_history = False
            return ready.encode_input(commands, frame)
        repeats = self._is_repeated(frame)
        keep = self._has_history and not (frame.reset or repeats) and Role.MOTION in frame
        if not keep and ready.is_empty(frame):
            savings.note_frame(Amount.EMPTY, 0.0)
            self._has_history = False
            return ready.encode_empty(frame)
        reasons = [REPEATED_NOISE] if repeats else [] if keep else [NO_HISTORY]
        alike = self._likeness(frame, ready, keep)
        if alike is Alike.SAME and self._has_history and self._result:
            savings.note_frame(Amount.SAME, 0.0, [REPEATED_NOISE] if repeats else [])
            return self._result

        work, amount, more_reasons = self._plan_work(frame, ready, keep, cells)
        reasons += more_reasons
        colour = ready.encode(commands, frame, work, reasons)
        self._has_history, self._exposure_factor = not frame.unusable, frame.exposure_factor
        if alike is not Alike.OTHER:
            self._keep_result(commands, colour)
        if work.still and amount is Amount.WHOLE:
            reasons.append(NOTHING_MOVES)
        savings.note_frame(amount, 1.0 if work.band is None else work.band.share, reasons)
        return colour

    def _plan_work(self, frame: ResidentFrame, ready: ReadyNetwork, keep: bool,
                   cells: np.ndarray | None) -> tuple[FrameWork, Amount, list[Reason]]:
        """The work on a frame, how much of the frame it is, and what else is left out of it.

        keep: whether the history goes on. cells: the active ones, None for all.
        """
        self._last_tag = self._choose(frame, ready)
        stddev = self._stddev(frame) if ready.sees_noise_alone(self._last_tag) else 0.0
        if stddev and cells is not None:
            cells = grown(cells, SPREAD_MARGIN_PX)
        lit = ready.lit_cells(frame) if cells is None and Role.MOTION not in frame else None
        band = None
        if cells is not None or lit is not None:
            band, cells = self._band(frame, ready, cells, lit)
        gain = frame.exposure_factor / self._exposure_factor if keep else 1.0
        if not self._is_wider and ready.is_outside(frame):
            self._widen(keep)
        still = keep and gain == 1 and frame.is_blank(Role.MOTION)
        camera, reasons = None, list[Reason]()
        if ready.first_stage and ready.first_stage.is_jittered:
            reasons.append(JITTERED)
        if ready.reflections:
            camera, why = self._cameras.step(frame, keep and not still)
            reasons += [(UNFOLLOWED_REFLECTIONS, why)] if why else []
        params = np.array([frame.exposure_factor, *frame.jitter, gain], np.float32)
        model = ready.models[self._last_tag]
        work = FrameWork(model, params, keep, still, cells, band, self._is_wider, camera, stddev)
        amount = Amount.WHOLE
        if band is not None and band.share != 1:
            amount = Amount.TILES if lit is None else Amount.LIT
        return work, amount, reasons

    def _band(self, frame: ResidentFrame, ready: ReadyNetwork, cells: np.ndarray | None,
              lit: np.ndarray | None) -> tuple[Band | None, np.ndarray | None]:
        """The tiles that the network runs on, None for all of the frame; and the active cells,
        grown to whole tiles of 16 pixels where these are judged as a whole.

        Either `cells` is given, those that have strength, or `lit`, those that show light.
        """
        if cells is None:
            assert lit is not None, "one of them is given"
            band = ready.networks.layout(lit)
            # cells without light are written, too
            return band and band.over(frame.spec.height), None
        judged = ready.may_restore(frame)
        band = ready.networks.layout(cells, judged)
        return band, whole_tiles(cells) if judged else cells

    def _choose(self, frame: ResidentFrame, ready: ReadyNetwork) -> str:
        """The tag of a frame's network. The budget chooses it, and a frame that is not denoised
        before it is enlarged has one of its own."""
        tag = self._tags[self._ladder.rung if self._ladder else 0]
        is_last = tag == self._tags[-1]
        if ready.first_stage and not ready.first_stage.look(frame, is_last) and is_last:
            tag = ready.single_stage_tag

        self.choice = name = network_name(tag, ready.models[tag])
        if ready.first_stage and ready.first_stage.runs:
            self.choice = f"{name} in two stages" if name == tag else f"{tag} then {name}"
        return tag

    def _stddev(self, frame: ResidentFrame) -> float:
        """The standard deviation, in pixels, of the pixel filter that spread a frame's noise; 0 for
        none. The option gives it, or else the noise of the shot's first frame on the host."""
        if self._given_stddev is not None:
            return self._given_stddev
        if self._found_stddev is None:
            colour = frame.host_planes.get(Role.COLOUR)
            found = None if colour is None else find_stddev(colour, frame.host_planes)
            self._found_stddev = found or 0.0
        return self._found_stddev

    def _likeness(self, frame: ResidentFrame, ready: ReadyNetwork, keep: bool) -> Alike:
        """Whether a frame is a copy of the one before, so that its result is the same.

        Only looked at for frames that are denoised alone, from planes in the host's memory: the
        results of others depend on more than their planes.
        """
        depends_on_more = (keep or self.budget or frame.came_on_device or frame.unusable
                           or ready.layers or ready.error or ready.reflections)
        if depends_on_more or frame.tensors.keys() != frame.host_planes.keys():
            self._last_inputs.forget()
            return Alike.OTHER
        planes: dict[Hashable, np.ndarray] = {Role.COLOUR: frame.host_planes[Role.COLOUR]}
        planes |= {str(role): plane for role, plane in frame.host_planes.items()}
        planes |= {f"guide {role}": plane for role, plane in frame.host_guides.items()}
        jitters = frame.jitter, frame.guide_jitter
        facts = (frame.exposure_factor, jitters, frame.spec, self._is_wider)
        return self._last_inputs.look(facts, planes)

    def _keep_result(self, commands: CommandBuffer, colour: Tensor) -> None:
        """Record a copy of a frame's picture, to give it again for frames that are the same."""
        if self._result is None or self._result.shape != colour.shape:
            self._result = self._device.heap.tensor("picture of the same frames", colour.shape)
            self._copier = self._device.host_state("keep", ("colour",), ("output",),
                                                   lambda seen, kept: np.copyto(kept, seen))
        commands.repeat((self, "keep", colour, self._result),
                        partial(commands.run, self._copier, "keep", colour=colour,
                                output=self._result))

    def _widen(self, keep: bool) -> None:
        """Go on in wider primaries to the end of the shot, with the history that is kept."""
        if keep:
            self.recall(widen_history(self.history(), self._parts))
        self._is_wider = True

    def _is_repeated(self, frame: ResidentFrame) -> bool:
        """Whether a frame's noise is that of the frame before. Not looked for where frames come on
        a GPU."""
        planes = frame.host_planes
        if frame.came_on_device or not {Role.COLOUR, Role.MOTION} <= planes.keys():
            return False
        if frame.reset:
            self._repeats.reset()
        repeats = self._repeats(planes) and self._has_history
        if repeats and not self._has_told_of_one_seed:
            cause, fix = ONE_SEED
            self.notices += ("it has the noise of the frame next to it, so it is denoised alone; "
                             f"likely: {cause}; fix: {fix}",)
            self._has_told_of_one_seed = True
        return repeats


def _entries_under(prefix: str, history: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """The entries of a history whose names begin with a prefix, without it."""
    return {name.removeprefix(prefix): array
            for name, array in history.items() if name.startswith(prefix)}
