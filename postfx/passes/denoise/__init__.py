"""Neural denoised upscaler: noisy planes in, clean colour at the same size or a larger one out,
steady over time."""

from __future__ import annotations

import os
import warnings
from collections.abc import Hashable, Iterable, Mapping, Sequence
from dataclasses import replace
from functools import lru_cache, partial
from pathlib import Path
from typing import ClassVar, Never

import numpy as np

from postfx.caching import LRUCache
from postfx.errors import DeviceError, FrameError, PassOptionError
from postfx.frame import GUIDE_ROLES, FrameSpec, Part, Role
from postfx.passes import MOST_SIZES, Pass, Reflection, ResidentFrame
from postfx.passes.denoise.activity import active_cells, grown, whole_tiles
from postfx.passes.denoise.first_stage import DENOISED_SHARE
from postfx.passes.denoise.frame import Ready, ReadyNetwork, Wishes
from postfx.passes.denoise.geometry import CELL, Band, Size, Sizes
from postfx.passes.denoise.history import FILTERED_PICTURE, History, PartHistory
from postfx.passes.denoise.models import (
    CLASSIC,
    GUIDED,
    TWO_STAGES_COST,
    UNSCALED,
    Ladder,
    cost,
    denoises_first,
    enlarging_remarks,
    family,
    filter_model,
    gives_picture,
    halo_of,
    has_model,
    mixture_model,
    model_of,
    name_models,
    predicts_error,
    reads_mirrored,
    runs_classic,
    short_tag,
    unscaled_remarks,
    validate_tag,
)
from postfx.passes.denoise.options import output_size, parse_reactive, validate_scale, validate_size
from postfx.passes.denoise.parts import Layers, checked_parts
from postfx.passes.denoise.planes import ABSENT, MIRRORED_ROLES, passthrough_roles
from postfx.passes.denoise.primaries import widen_history
from postfx.passes.denoise.reflections import Cameras, can_follow
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
from postfx.passes.denoise.window import Work
from postfx.pixel_filter import find_stddev, parse_stddev
from postfx.repeats import ONE_SEED, Alike, FrameMemory, RepeatDetector
from postfx.runtime import CommandBuffer, Device, Library, Tensor, has_networks

READ_PLANES = tuple(ABSENT)
NO_NETWORKS = ("the package onnxruntime is missing, so the classical filter stands in for the "
               "network, and more noise stays: install it, or accept that by the model classic")
NO_HISTORY_REMARK = "no motion vectors, so every frame is denoised alone and may flicker"
"""A remark, before what helps."""
SHARPENING = Role.DIFFUSE_ALBEDO, Role.NORMAL, Role.DEPTH
"""Planes without which results are 0.2 dB worse or more; the others are worth less than a line."""
PART_FILTERS = "picture", "own"
"""Values of the option `part_filters`: whose filters parts get."""
NETWORK_PREFIX = "network "
"""In a history, the name of the network's entry ends in the network's tag."""
LARGEST_TAG = "xl"
"""Tag of the largest network that comes with postfx."""
FIRST_STAGE = "first stage "
"""In a history, names of what denoises frames before they are enlarged begin so."""
WIDER = "wider primaries"
"""In a history, whether its light is in wider primaries than the frames'."""
FOUND_STDDEV = "pixel filter"
"""In a history, the standard deviation in pixels of the filter that a shot's first frame told."""
REPEATS = "repeats "
"""In a history, names of what noise that repeats is found by begin so."""


@lru_cache  # a run asks with every frame
def network_name(tag: str, model: str) -> str:
    """The users' name for the network that runs for their short tag: the tag, with its size
    replaced where a model of another size stands in."""
    asked, dot, precision = tag.partition(".")
    size = short_tag(model).partition(".")[0]
    return tag if size == asked else f"{size}{dot}{precision}"


class DenoiseUpscale(Pass):
    """Denoises, and enlarges where asked, reusing earlier frames along their motion.

    It needs only colour, and reads the other planes that a frame has.

    Options:
        scale: output size over render size, 1 to 3. None: the size of the frame's guides, or 1
            without guides.
        size: width and height of the output, in place of a scale; frames may change their size, and
            the history goes on.
        model: tag of the network, 's', 'm', 'l' or 'xl', which runs in the device's fast precision,
            or with one: 'm.fp32', 'm.int8' for the CPU, 'm.fp16' for CUDA; or the file of your own
            network, 'nets/mine.onnx', with its card beside it, and mine.guides.onnx and
            mine.1x.onnx if they exist; or 'classic', a filter without a network, on a CPU and for
            frames without parts. The default here is 'm'. `postfx run` and `postfx.denoise` take
            'xl' by themselves for frames that fit into memory, but not for larger ones with guides:
            it is cleaner, and on a CPU takes ten times as long. Where frames are enlarged 'xl'
            denoises them at their own size first, and a second network enlarges a mixture of that
            and the noisy picture. With jitter or guides in place of planes 'l' enlarges the noisy
            picture instead. Beside 'xl', and 'l' at the render's size, 'm' filters parts
            and noisy alpha.
        library: the `postfx.Library`, or folder, in which `denoise_upscale.<model>` and its
            variants are; None for the networks that come with postfx.
        budget: milliseconds that a frame may take on the device, None for no limit. Where `model`
            is too slow, smaller networks of its precision run ('s' below 'm', 's' and 'm' below
            'l'), or 'classic'; the history goes on.
        strength: 0 returns the input, only resampled, and runs no network; 1 denoises fully. The
            plane `strength` sets it pixel by pixel, and both are multiplied; no network runs where
            it is 0.
        pixel_filter: what to do where the renderer adds each sample to several pixels, so that
            noise looks like detail: 'auto', find the filter by the noise of a shot's first frame;
            or the standard deviation of its gaussian, 0.2 to 0.75 pixels: networks that give the
            picture itself, 'xl' and 'l' at the render's size, then see planes without it, and it is
            applied to their picture; 'none', nothing.
        parts: names of the frames' parts that are denoised with the picture, or `postfx.frame.Part`
            for those that are not light. Light of one group keeps its sum.
        part_filters: 'picture' filters parts like the picture; 'own' runs the network on each part
            that is light, which takes as long as the picture for each.
        alpha: whether alpha is denoised with the picture, where it is neither 0 nor 1; else it is
            only resampled.
        error: whether to add the plane `error`: the squared error that the network expects of each
            pixel of the denoised colour, in code values of a display (x / (1 + x) of exposed light,
            sRGB); 0 where no network ran.
        reactive: where the history is not used, for things that move without motion vectors, such
            as particles: 'plane', the plane `reactive`; 'difference', where colour differs from the
            plane `opaque_colour`; 'auto', the first of the two that the frame has; 'none'. scale=
            and threshold= may follow, as in 'auto,scale=4,threshold=0.05'.

    Where a shot has light outside the gamut, which is negative in the frames' primaries, it is
    denoised in wider ones and converted back. On a GPU negative light counts as 0.

    A transparency overlay is only resampled; the pass `overlay` composites. The plane `later` is
    handed on to the pass `both_ways`, and the plane `partner`, resampled, to the pass
    `mix_partner`.

    A frame's guides, planes at output size, make edges exact: ``denoise_upscale.<tag>.guides``
    reads them. At render size ``denoise_upscale.<tag>.1x`` runs if it exists. Without a motion
    plane every frame stands alone. So does one whose noise is that of the frame before, as with one
    seed for all: a history would take the noise for detail.

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
        self._parts_with_own_filters = [part.name
                     for part in self._parts if part.is_light and part_filters == PART_FILTERS[1]]
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

    def _falls_back(self, tag: str) -> bool:
        """Whether the classical filter stands in for a network, because nothing runs networks
        here."""
        return not has_networks() and "/" not in tag and CLASSIC in family(tag) and not self._parts

    def reflect(self, spec: FrameSpec) -> Reflection:
        if spec.encoding != "scene-linear":
            raise FrameError(f"{spec.source or 'frame'}: colour is {spec.encoding}, and the "
                             "denoiser takes scene-linear light: let it run before tone mapping")
        self._check_error(spec)
        self._check_enlargement(spec)
        carried = passthrough_roles(spec)
        written = (Role.COLOUR, *carried, *(Role.ERROR,) * self._error)
        size = self._output_size(spec)
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
        planes = (*READ_PLANES, Role.STRENGTH, *self._reactive_planes(spec))
        if self._reads_mirrored(spec):
            planes += tuple(MIRRORED_ROLES)
        if can_follow(spec):
            planes += (Role.SPECULAR_HIT_DISTANCE,)
        return planes

    def _seen_guides(self, spec: FrameSpec) -> tuple[Role, ...]:
        """Guides that a network reads, or else those that stand in for planes that are missing."""
        if self._reads_guides(spec):
            return GUIDE_ROLES
        return tuple(role for role in GUIDE_ROLES if not spec.has(role))

    def remarks(self, spec: FrameSpec) -> tuple[str, ...]:
        if not self.strength:
            return ("strength 0: the input is only resampled",)
        seen = {*spec.roles, *spec.guide_roles}
        lost = [str(role).replace("_", " ") for role in SHARPENING if role not in seen]
        can_be_estimated = any(map(spec.has, (Role.DIFFUSE_ALBEDO, Role.NORMAL)))
        remedy = ("--motion auto estimates them" if can_be_estimated
                  else "render them, or albedo to estimate them from")
        alone = f"{NO_HISTORY_REMARK}: {remedy}"
        found = [NO_NETWORKS] if self._is_fallback else []
        found += [] if spec.has(Role.MOTION) else [alone]
        listed = " or ".join(filter(None, (", ".join(lost[:-1]), *lost[-1:])))
        found += [f"no {listed}: results are blurrier"] if lost else []
        if self._is_render_size(spec):
            found += unscaled_remarks(self._tag)
        else:
            found += enlarging_remarks(self._tag)
            found += self._one_stage_remarks(spec)
        if self._given_stddev and not self.undone_stddev(spec):
            found.append(f"a pixel filter of {self._given_stddev:.2f} px stays in the noise: "
                         "network xl undoes it, and l at the render's size")
        return (*found, *self._guide_remarks(spec), *self._mask.remarks(spec))

    def accumulates(self, spec: FrameSpec) -> bool:
        return self.strength > 0 and spec.has(Role.MOTION)

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
            models, size = self._models(spec), self._output_size(spec)
            self._tags, costs = tuple(models), list(map(cost, models.values()))
            costs[-1] = TWO_STAGES_COST if self._has_first_stage(spec) else costs[-1]
            first = int(len(models) > 1 and self._tags[0] == CLASSIC)
            self._ladder = Ladder(costs, self.budget, first) if self.budget else None
            if self.size:  # so that files of a frame are the same wherever a run begins
                endings = ("", UNSCALED, GUIDED)[:2 if spec.guides is None else 3]
                tags = self._tags_for(spec, runs_classic(device))
                name_models(device, (find(tag, ending, device) for tag in tags
                                     for ending in endings for find in (model_of, mixture_model)))
            reactive = self._mask.role(spec) is not None
            sizes = Sizes(Size(spec.height, spec.width), size)
            self._history = History(device, sizes, reactive)
            beside = (FILTERED_PICTURE,) if self._filter_model(spec, models) else ()
            alone = (*self._parts_with_own_filters, *beside)
            own = {name: History(device, sizes, reactive) for name in alone}
            self._part_history = PartHistory(device, size, self._parts, own)
        self._sizes: LRUCache[FrameSpec, Ready] = LRUCache(MOST_SIZES)
        self._ready = self._sizes.get_or_make(spec, partial(self._made_ready, spec))
        super().compile(device, spec)

    def resize(self, spec: FrameSpec) -> bool:
        before = self._spec
        if before is None:
            return False
        # at 1x fewer guides are read
        alike = replace(before, width=spec.width, height=spec.height, guides=spec.guides)
        if not self.size or spec != alike or self.reflect(spec).output != self._output:
            return False
        if self.strength and tuple(self._models(spec)) != self._tags:
            return False
        if self.strength:
            self._savings.note_resize(spec in self._sizes)
            if self._ladder:
                self._ladder.note_resize(spec.width * spec.height / (before.width * before.height))
        self._ready = self._sizes.get_or_make(spec, partial(self._made_ready, spec))
        self._spec = spec
        if isinstance(self._ready, ReadyNetwork) and self._ready.first:
            self._ready.first.reset()
        return True

    def _made_ready(self, spec: FrameSpec) -> Ready:
        """What frames of a spec need: networks, tensors and commands."""
        size = self._output_size(spec)
        if not self.strength:
            none = PartHistory(self._device, size, ())
            layers = (Layers(self._device, spec, size, self._parts, False, none) if self._parts
                      else None)
            return Ready(self._device, spec, size, layers)
        models, guided = self._models(spec), self._is_guided(spec)
        filters = self._filter_model(spec, models)
        alone = self._alone_model(spec, models) if self._has_first_stage(spec) else {}
        models |= alone
        first = self._first_stage(models.values()) if alone else None
        wishes = Wishes(self.strength, self._mask, self._parts, self._alpha, filters, self._error,
                        first, next(iter(alone), ""), self._spared_halo_px)
        return ReadyNetwork(self._device, spec, size, models, guided, wishes, self._history,
                            self._part_history)

    def _first_stage(self, models: Iterable[str]) -> DenoiseUpscale:
        """The denoiser that runs before these networks enlarge frames, and mixes its result with
        the noisy frame. Its strength is 1 in the halo of these networks, too, as little of it comes
        to the result there: so both share one halo."""
        stage = DenoiseUpscale(1, strength=DENOISED_SHARE, alpha=False, pixel_filter="none",
                               **{name: self.options[name]
                                  for name in ("model", "reactive", "library")})
        stage._spared_halo_px = halo_of(models) + CELL
        return stage

    def _has_first_stage(self, spec: FrameSpec) -> bool:
        """Whether frames of a spec are denoised at their own size before they are enlarged."""
        may = bool(self.strength) and not self._is_render_size(spec) and denoises_first(self._tag)
        return may and not _guides_stand_in(spec)

    def _one_stage_remarks(self, spec: FrameSpec) -> list[str]:
        """What a plan says of frames that are enlarged as they are by a model of two stages."""
        if not (_guides_stand_in(spec) and denoises_first(self._tag)):
            return []
        asked, other = short_tag(self._tag), short_tag(model_of(self._tag))
        return [f"'{asked}' does not denoise at the render's size first, '{other}' alone runs: "
                "guides stand in for planes of the render's size"]

    def _tags_for(self, spec: FrameSpec, has_classic: bool = True) -> tuple[str, ...]:
        """Tags to choose from for frames of a spec, fastest first; one without a budget."""
        smaller = family(self._tag)[:-1] if self.budget else ()
        if self._parts or self._error or not has_classic:  # it filters no parts
            smaller = tuple(tag for tag in smaller if tag != CLASSIC)
        return (*(tag for tag in smaller if has_model(model_of(tag, self._ending(spec)))),
                self._tag)

    def _ending(self, spec: FrameSpec) -> str:
        return UNSCALED if self._is_render_size(spec) else GUIDED * self._is_guided(spec)

    def _models(self, spec: FrameSpec) -> dict[str, str]:
        """The networks to choose from for frames of a spec, by their short tags."""
        tags, ending = self._tags_for(spec, runs_classic(self._device)), self._ending(spec)
        found = {short_tag(tag): model_of(tag, ending, self._device) for tag in tags}
        if self._has_first_stage(spec):
            found[short_tag(self._tag)] = mixture_model(self._tag, ending, self._device)
        return found

    def _filter_model(self, spec: FrameSpec, models: Mapping[str, str]) -> str | None:
        """The network that filters parts and noisy alpha, where one of the ``models`` gives the
        picture alone, or sees one that was denoised."""
        is_beside = self._has_first_stage(spec) or any(map(gives_picture, models.values()))
        if not is_beside or not (self._parts or (self._alpha and spec.has(Role.ALPHA))):
            return None
        return filter_model(self._tag, self._ending(spec), self._device)

    def _alone_model(self, spec: FrameSpec, models: Mapping[str, str]) -> dict[str, str]:
        """The network of frames that are not denoised first, by its tag: one of the ``models``, or
        one more."""
        model = model_of(self._tag, self._ending(spec), self._device)
        known = (tag for tag, one in models.items() if one == model)
        return {next(known, network_name(short_tag(self._tag), model)): model}

    def note_time(self, milliseconds: float) -> None:
        if self.strength:
            self._savings.note_time(milliseconds)
            if self._ladder:
                self._ladder.note_time(milliseconds)

    def savings(self) -> tuple[tuple[str, str], ...]:
        return self._savings.lines() if self.strength else ()

    def reset(self) -> None:
        self._has_history = self._is_wider = False
        self._exposure = 1.0
        self._found_stddev: float | None = None
        self._cameras.reset()
        self._repeats.reset()
        self._last_inputs.forget()

    def history(self) -> dict[str, np.ndarray]:
        if not (self.strength and self._has_history):
            return {}
        known = {"exposure": np.array(self._exposure, np.float64),
                 f"{NETWORK_PREFIX}{self._last_tag}": np.array(1, np.int64),
                 WIDER: np.array(self._is_wider, np.int64)}
        if self._found_stddev is not None:
            known[FOUND_STDDEV] = np.array(self._found_stddev, np.float64)
        known |= {f"{REPEATS}{name}": array for name, array in self._repeats.history().items()}
        if isinstance(self._ready, ReadyNetwork) and self._ready.first:
            known |= {f"{FIRST_STAGE}{name}": array
                      for name, array in self._ready.first.history().items()}
        return (known | self._cameras.snapshot() | self._history.snapshot()
                | self._part_history.snapshot())

    def recall(self, history: Mapping[str, np.ndarray]) -> None:
        self._has_history = bool(history)
        self._last_inputs.forget()
        if self._has_history:
            self._exposure = float(history["exposure"])
            self._is_wider = bool(history.get(WIDER, False))
            if not isinstance(self._ready, ReadyNetwork):
                raise KeyError(f"pass '{self.name}' has no history at strength 0")
            self._last_tag = next(iter(key.removeprefix(NETWORK_PREFIX)
                                   for key in history if key.startswith(NETWORK_PREFIX)), "")
            if FOUND_STDDEV in history:
                self._found_stddev = float(history[FOUND_STDDEV])
            self._history.use(self._ready.models[self._last_tag])
            self._history.recall(history)
            self._part_history.recall(history)
            self._cameras.recall(history)
            self._repeats.recall({name.removeprefix(REPEATS): array
                                  for name, array in history.items() if name.startswith(REPEATS)})
            if self._ready.first:
                self._ready.first.recall({name.removeprefix(FIRST_STAGE): array
                                          for name, array in history.items()
                                          if name.startswith(FIRST_STAGE)})

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
        self._has_history, self._exposure = not frame.unusable, frame.exposure_factor
        if alike is not Alike.OTHER:
            self._keep_result(commands, colour)
        if work.still and amount is Amount.WHOLE:
            reasons.append(NOTHING_MOVES)
        savings.note_frame(amount, 1.0 if work.band is None else work.band.share, reasons)
        return colour

    def _plan_work(self, frame: ResidentFrame, ready: ReadyNetwork, keep: bool,
                   cells: np.ndarray | None) -> tuple[Work, Amount, list[Reason]]:
        """The work on a frame, how much of the frame it is, and why it saves less.

        keep: whether the history goes on. cells: those that are denoised at all, None for all.
        """
        self._last_tag = self._choose(frame, ready)
        stddev = self._stddev(frame) if ready.sees_noise_alone(self._last_tag) else 0.0
        if stddev and cells is not None:
            cells = grown(cells, SPREAD_MARGIN_PX)
        lit = ready.lit_cells(frame) if cells is None and Role.MOTION not in frame else None
        band = None
        if cells is not None or lit is not None:
            band, cells = self._band(frame, ready, cells, lit)
        gain = frame.exposure_factor / self._exposure if keep else 1.0
        if not self._is_wider and ready.is_outside(frame):
            self._widen(keep)
        still = keep and gain == 1 and frame.is_blank(Role.MOTION)
        camera, reasons = None, list[Reason]()
        if ready.first and ready.first.is_jittered:
            reasons.append(JITTERED)
        if ready.reflections:
            camera, why = self._cameras.step(frame, keep and not still)
            reasons += [(UNFOLLOWED_REFLECTIONS, why)] if why else []
        params = np.array([frame.exposure_factor, *frame.jitter, gain], np.float32)
        model = ready.models[self._last_tag]
        work = Work(model, params, keep, still, cells, band, self._is_wider, camera, stddev)
        amount = Amount.WHOLE
        if band is not None and band.share != 1:
            amount = Amount.TILES if lit is None else Amount.LIT
        return work, amount, reasons

    def _band(self, frame: ResidentFrame, ready: ReadyNetwork, cells: np.ndarray | None,
              lit: np.ndarray | None) -> tuple[Band | None, np.ndarray | None]:
        """The tiles that the network runs on, None for all of the frame; and the active cells,
        grown to whole tiles where these are judged as a whole.

        One of the two is given: `cells`, those that are denoised, or `lit`, those that show light.
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
        """The tag of a frame's network: by the budget; another one for what is enlarged as it
        is."""
        tag = self._tags[self._ladder.rung if self._ladder else 0]
        is_last = tag == self._tags[-1]
        if ready.first and not ready.first.look(frame, is_last) and is_last:
            tag = ready.alone_tag

        self.choice = name = network_name(tag, ready.models[tag])
        if ready.first and ready.first.runs:
            self.choice = f"{name} in two stages" if name == tag else f"{tag} then {name}"
        return tag

    def _stddev(self, frame: ResidentFrame) -> float:
        """The standard deviation in pixels of the filter that spread a frame's noise, 0 for none:
        the option's, or what the shot's first frame tells that is looked at."""
        if self._given_stddev is not None:
            return self._given_stddev
        if self._found_stddev is None:
            colour = frame.host_planes.get(Role.COLOUR)
            found = None if colour is None else find_stddev(colour, frame.host_planes)
            self._found_stddev = found or 0.0
        return self._found_stddev

    def _likeness(self, frame: ResidentFrame, ready: ReadyNetwork, keep: bool) -> Alike:
        """Whether a frame is a copy of the one before. Only a frame that is denoised alone, from
        planes in the host's memory, has a result that depends on nothing else."""
        depends_on_more = (keep or self.budget or frame.is_away or frame.unusable or ready.layers
                           or ready.error or ready.reflections)
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
        """Record a copy of a frame's picture, for frames that are the same."""
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
        if frame.is_away or not {Role.COLOUR, Role.MOTION} <= planes.keys():
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

    def _check_error(self, spec: FrameSpec) -> None:
        """Raise PassOptionError where the error is asked for, and a network for frames of this spec
        does not predict it."""
        if not self._error:
            return
        if not self.strength:
            raise PassOptionError("strength 0 runs no network, so none predicts the error: leave "
                                  "one of the two out")
        for tag in self._tags_for(spec):
            if predicts_error(model_of(tag, self._ending(spec))):
                continue
            raise PassOptionError(f"model '{short_tag(tag)}' does not predict its error at this "
                                  f"size: {self._error_remedy()}")

    def _check_enlargement(self, spec: FrameSpec) -> None:
        """Raise PassOptionError where frames of this spec are to be enlarged by a network that
        gives the picture itself."""
        if not self.strength or self._is_render_size(spec):
            return
        for tag in self._tags_for(spec):
            if gives_picture(model_of(tag, self._ending(spec))):
                raise PassOptionError(f"model '{short_tag(tag)}' denoises at the render's size and "
                                      "does not enlarge: give scale 1, or another model")

    def _error_remedy(self) -> str:
        """The remedy where no network predicts the error: one that does at the render size, if one
        comes with postfx."""
        able = [tag for tag in family(LARGEST_TAG) if predicts_error(model_of(tag, UNSCALED))]
        return (f"give model '{able[-1]}' and scale 1, or leave the error out" if able
                else "leave the error out")

    def _reads_mirrored(self, spec: FrameSpec) -> bool:
        """Whether a network reads the planes that follow mirrors and glass; where frames may change
        their size, for any of their sizes."""
        both = self.size or self._has_first_stage(spec)
        endings = ("", UNSCALED) if both else (self._ending(spec),)
        return any(reads_mirrored(model_of(tag, ending)) for tag in self._tags_for(spec)
                   for ending in endings)

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
        notes = [self._network_note(spec)] if self.strength else []
        notes += self._filter_notes(spec) if self.strength and self._parts else []
        notes += [f"stays {self.size} where frames change their size"] if self.size else []
        notes += self._pixel_filter_notes(spec)
        alone = ", ".join(self._parts_with_own_filters)
        notes += [f"own filters: {alone}"] if self.strength and alone else []
        notes += (["smooth reflections move by their hit distance"]
                  if self.strength and can_follow(spec) else [])
        return tuple(notes)

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
        return self.strength > 0 and (self._has_first_stage(spec)
                                      or gives_picture(model_of(self._tag, self._ending(spec))))

    def _pixel_filter_notes(self, spec: FrameSpec) -> list[str]:
        """A note that a pixel filter of known width is undone; none if it is not."""
        stddev = self.undone_stddev(spec)
        return ([f"a pixel filter of {stddev:.2f} px is undone before it and applied again"]
                if stddev else [])

    def _filter_notes(self, spec: FrameSpec) -> list[str]:
        """Which other network filters the parts of frames of a spec."""
        ending = self._ending(spec)
        if not (self._has_first_stage(spec) or gives_picture(model_of(self._tag, ending))):
            return []
        model = filter_model(self._tag, ending).removesuffix(UNSCALED)
        return [f"network {network_name(short_tag(self._tag), model)} filters parts"]

    def _network_note(self, spec: FrameSpec) -> str:
        """Which network runs for frames of a spec."""
        if self._tag == CLASSIC:
            return "the classical filter, no network"
        faster = ", or a faster one to keep the budget" if self.budget else ""
        model = model_of(self._tag, self._ending(spec))
        name = network_name(short_tag(self._tag), model)
        if self._has_first_stage(spec):
            asked = short_tag(self._tag)
            second = network_name(asked, mixture_model(self._tag, self._ending(spec)))
            return (f"network {asked} at the render's size first, then {second} enlarges; {name} "
                    f"alone where frames have jitter{faster}")
        return f"network {name}{faster}"

    def _output_size(self, spec: FrameSpec) -> Size:
        return output_size(spec, self.scale, self.size)

    def _reactive_planes(self, spec: FrameSpec) -> tuple[Role, ...]:
        role = self._mask.role(spec)
        return (role,) if role else ()

    def _reads_guides(self, spec: FrameSpec) -> bool:
        """Whether a network does; at render size it is better with the planes, which have the
        samples of the colour."""
        return self._has_guided_model() and not self._is_render_size(spec)

    def _is_guided(self, spec: FrameSpec) -> bool:
        return bool(set(spec.guide_roles) & set(GUIDE_ROLES)) and self._reads_guides(spec)

    def _has_guided_model(self) -> bool:
        return self._tag != CLASSIC and has_model(model_of(self._tag, GUIDED))

    def _is_render_size(self, spec: FrameSpec) -> bool:
        return self._output_size(spec) == (spec.height, spec.width)

    def _guide_remarks(self, spec: FrameSpec) -> list[str]:
        if (spec.guides is None
            or (spec.guide_roles and not set(spec.guide_roles) & set(GUIDE_ROLES))):
            return []
        if not self._has_guided_model():
            return [f"model '{short_tag(self._tag)}' does not read guides: they only stand in for "
                    "missing planes"]
        if self._is_render_size(spec):
            return ["guides of the render size only stand in for missing planes"]
        rough = [str(role)
                 for role in GUIDE_ROLES if spec.has(role) and role not in spec.guide_roles]
        return [f"edges are less exact without the guides {', '.join(rough)}"] if rough else []


def _guides_stand_in(spec: FrameSpec) -> bool:
    """Whether frames of a spec have guides in place of planes of the render's size."""
    return any(role in spec.guide_roles and not spec.has(role) for role in GUIDE_ROLES)
