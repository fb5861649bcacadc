"""What frames of one spec need, made once, and the work on a frame in its order: `encode` runs the
tables of `graph`, each on its buffers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import NamedTuple

import numpy as np

from postfx.frame import FrameSpec, Part, Role
from postfx.kernels.statistics import OUTSIDE, light_outside, lit_cells
from postfx.passes import Pass, ResidentFrame
from postfx.passes.denoise.activity import grown
from postfx.passes.denoise.assembly import FrameNetworks
from postfx.passes.denoise.filtered_picture import FilteredPicture, encode_own, own_networks
from postfx.passes.denoise.first_stage import FirstStage
from postfx.passes.denoise.geometry import CELL, Rows, Size, Sizes
from postfx.passes.denoise.history import History, PartHistory
from postfx.passes.denoise.models import (
    CLASSIC,
    blanks_volumes,
    gives_picture,
    grid_of,
    halo_of,
    reach_of,
    reads_mirrored,
)
from postfx.passes.denoise.options import ReactiveOption
from postfx.passes.denoise.output import (
    FULL_EVIDENCE_SAMPLES,
    NO_DETAIL_SAMPLES,
    Restore,
    Strength,
)
from postfx.passes.denoise.parts import Layers, Pictures
from postfx.passes.denoise.planes import (
    ExpectedError,
    Passthrough,
    Planes,
    Reactive,
    Resampler,
    passthrough_roles,
)
from postfx.passes.denoise.primaries import WiderPrimaries
from postfx.passes.denoise.reflections import Reflections, can_follow
from postfx.passes.denoise.savings import FULL_STRENGTH, HAZY_DEPTH, Reason
from postfx.passes.denoise.unfiltered import Unfiltered
from postfx.passes.denoise.window import THE_PICTURE, FrameWork
from postfx.planes import sampled
from postfx.runtime import CommandBuffer, Device, Tensor

LIGHT_REACH = 80
"""Render pixels that light can travel in the result: 62 by the filters of five levels, 16 by the
cells of the coarsest one, 2 by enlarging."""
LIT_PIXEL_STEP = 16
"""One pixel in so many, along rows and columns, tells how much of a picture is lit."""
MOST_LIT = 0.75
"""Share of these pixels that may be lit for the dark rest of a frame to be left out."""


class Ready:
    """Pipeline states, tensors and argument tables for frames of one spec.

    Attributes:
        layers: parts of the picture; None if it has none.
        passthrough: planes that are only resampled; None if frames have none.
        error: the plane of expected errors; None if it is not asked for.
    """

    def __init__(self, device: Device, spec: FrameSpec, output: Size,
                 layers: Layers | None) -> None:
        self._device, self._spec, self._output = device, spec, output
        self.layers = layers
        self.passthrough = Passthrough(device, spec, output) if passthrough_roles(spec) else None
        self.error: ExpectedError | None = None

    @cached_property
    def plain(self) -> Resampler:
        """Resamples the input to pixel centres of the output."""
        render = Size(self._spec.height, self._spec.width)
        return Resampler(self._device, "plain", Role.COLOUR, render, self._output)

    def encode_input(self, commands: CommandBuffer, frame: ResidentFrame) -> Tensor:
        """Record what resamples the input, in linear light, without overshooting its samples;
        returns the colour."""
        self.plain.aim(frame.jitter)
        colour = self.plain.resample(commands, frame[Role.COLOUR])
        if self.layers:
            self.layers.resample(commands, frame, colour)
        return colour


class Wishes(NamedTuple):
    """What the options of the pass ask for, for frames of one spec.

    Attributes:
        strength: 1 denoises fully.
        mask: how the mask is made of where the history is not used.
        parts: parts of the picture that are denoised with it.
        alpha: whether alpha is denoised, too.
        filter_model: the network that filters parts and alpha, where the picture's network cannot;
            None where it can, or nothing is to be filtered.
        error: whether the plane `error` is added.
        first_stage: the denoiser that runs before frames are enlarged; None for none.
        single_stage_tag: tag of the network for frames that the first stage leaves out.
        spared_px: as for `FrameNetworks`.
    """

    strength: float
    mask: ReactiveOption
    parts: Sequence[Part]
    alpha: bool
    filter_model: str | None
    error: bool
    first_stage: Pass | None
    single_stage_tag: str
    spared_px: int = 0


class NetworkInputs(NamedTuple):
    """What networks read of a frame.

    Attributes:
        planes: by the kernels' names, for the network of the picture.
        noisy: the same for a network that filters parts and alpha: with the light as rendered.
        given: planes of the frame from which a pixel filter was undone, as they came; empty if none
            was.
        undone_colour: the colour without that filter; None if there was none.
        is_mixture: whether the colour in `planes` was denoised in part before.
    """

    planes: dict[str, Tensor]
    noisy: dict[str, Tensor]
    given: dict[Role, Tensor]
    undone_colour: Tensor | None
    is_mixture: bool


class ReadyNetwork(Ready):
    """Pipeline states, tensors and argument tables for frames of one spec, for which a network
    runs.

    Attributes:
        models: the networks of this size by tag; each frame takes one.
        pictures: those that give the picture itself, and no filters.
        filtered: filters parts and noisy alpha where the picture's network has no filters, or none
            that fit the noisy picture; None where that is not needed.
        first_stage: denoises frames before they are enlarged; None for none.
        single_stage_tag: tag of the network for frames that the first stage leaves out.
        networks: what runs the models on frames of this size.
        reflections: None if frames lack the planes for it.
        restore: at render size only, else None.
        strength: None where all of the picture is fully denoised.
        layers: parts of the picture, and alpha; None without both.
        wider: for light that the frame's primaries do not hold.
        unfiltered: for noise that the renderer's pixel filter spread.
    """

    def __init__(self, device: Device, spec: FrameSpec, output: Size, models: Mapping[str, str],
                 guided: bool, wishes: Wishes, history: History,
                 part_history: PartHistory) -> None:
        parts, alpha = wishes.parts, wishes.alpha and spec.has(Role.ALPHA)
        layers = (Layers(device, spec, output, parts, alpha, part_history) if parts or alpha
                  else None)
        super().__init__(device, spec, output, layers)
        names = models.values()
        sizes = Sizes(Size(spec.height, spec.width), output, grid_of(names))
        self.models = models
        self.pictures = {model for model in names if gives_picture(model)}
        self._blanking = {model for model in names if blanks_volumes(model)}
        self._planes = Planes(device, spec, output, guided, any(map(reads_mirrored, names)))
        reactive = wishes.mask.role(spec) is not None
        self._mask = Reactive(device, spec, wishes.mask) if reactive else None
        self.reflections = Reflections(device, spec) if can_follow(spec) else None
        self.networks = FrameNetworks(device, sizes, list(names), history, guided=guided,
                                      reactive=reactive, layered=layers is not None,
                                      spared_px=wishes.spared_px)
        self.filtered = (FilteredPicture(device, sizes, wishes.filter_model, reactive, parts,
                                         layers, part_history)
                         if layers and wishes.filter_model else None)
        self._own = own_networks(self.networks, part_history)
        self.restore = Restore(device, output) if output == (spec.height, spec.width) else None
        full = wishes.strength == 1 and not spec.has(Role.STRENGTH)
        self.strength = (None if full
                         else Strength(device, spec, output, wishes.strength, self.plain))
        self.wider = WiderPrimaries(device, parts)
        self.unfiltered = Unfiltered(device, spec, output)
        self.error = ExpectedError(device, spec, output) if wishes.error else None
        self.single_stage_tag = wishes.single_stage_tag
        reach, halo = reach_of(names), halo_of(names)
        self.first_stage = (FirstStage(device, spec, wishes.first_stage, halo)
                            if wishes.first_stage else None)
        # render pixels around lit ones whose result the light may decide; windows add their halo
        self._reach = (reach and LIGHT_REACH + max(0, reach - halo))
        # whether everything that is made of a frame is a weighted mean of its pixels
        self._only_weighs = not (parts or self.error or self.pictures or self.first_stage)

    def encode(self, commands: CommandBuffer, frame: ResidentFrame, work: FrameWork,
               reasons: list[Reason]) -> Tensor:
        """Record all work on a frame, in the order of the tables of `graph`; returns the colour.

        What is left out of it is added to the `reasons`. The history stays fully denoised.
        """
        seen = self._prepare(commands, frame, work, reasons)

        # Layers get the filters of the picture's network, or those of a network beside it.
        has_filters = not (work.model in (CLASSIC, *self.pictures) or seen.is_mixture)
        beside = None if has_filters else self.filtered
        if beside and not beside.runs_on(frame):
            beside = None
        filtered = self.layers if has_filters or beside else None
        layers, targets = (filtered.begin(commands, frame, seen.planes, work)
                           if filtered and has_filters else ([], {}))
        filtered_picture = (beside.encode(commands, frame, seen.noisy, self._planes, work)
                            if beside else None)
        if self.layers and not filtered:  # alpha is only resampled
            self.layers.skip()

        # The windows. What follows them works on the rows that they write.
        restore = self.restore if self.may_restore(frame) else None
        finishes = filtered or restore or self.strength or seen.given
        rows = self.networks.rows(work.band, work.cells) if finishes else (0, 0)
        picture = targets.setdefault(THE_PICTURE, {})
        if self.strength and not (filtered or self.restore or seen.given):
            picture |= self.strength.begin(frame, rows)
        if self.error:
            picture |= self.error.written
        denoised = self.networks.encode(commands, seen.planes, work, layers, targets)
        if filtered and has_filters:
            encode_own(commands, self._own, filtered.own_runs(frame, seen.planes, work), work)

        # The picture after the windows, then its layers.
        colour = denoised
        if restore:
            colour = restore.encode(commands, frame, colour, rows, work.cells,
                                    by_planes=work.model in self.pictures)
        if seen.given:
            restored, colour = colour, self._spread(commands, seen, "spread picture", colour, rows)
            frame.tensors.update(seen.given)
            if restored is denoised or not filtered:
                denoised = colour
            else:
                denoised = self._spread(commands, seen, "spread without detail", denoised, rows)
        strength = self.strength
        if strength and strength.is_full(frame):
            reasons.append(FULL_STRENGTH)
            strength = None
        if strength:
            colour = strength.encode(commands, frame, colour, rows)
        if filtered:
            pictures = Pictures(filtered_picture or denoised, denoised, colour)
            filtered.finish(commands, frame, pictures, rows, restore, strength)
        return self.wider.narrow(commands, frame, colour) if work.wider else colour

    def _prepare(self, commands: CommandBuffer, frame: ResidentFrame, work: FrameWork,
                 reasons: list[Reason]) -> NetworkInputs:
        """Record the work that makes what the networks read of a frame. Until the windows are
        done, the frame's own planes may be replaced by others."""
        given = (self.unfiltered.undo(commands, frame, work.filter_stddev) if work.filter_stddev
                 else {})
        mixture = self.first_stage.encode(commands, frame, work) if self.first_stage else None
        if work.wider:
            self.wider.widen(commands, frame)
            self.wider.widen_planes(commands, "filtered", given)
        undone = {role: frame[role] for role in given}
        planes = self._planes.encode(commands, frame, work.model in self._blanking)
        if self._planes.hazy:
            reasons.append(HAZY_DEPTH)
        if self._mask:
            planes["reactive"] = self._mask.encode(commands, frame)
        if self.reflections and work.camera is not None:
            planes["motion"] = self.reflections.encode(commands, frame, work.camera, planes)
        noisy = {**planes, **{str(role): plane for role, plane in given.items()
                              if planes.get(str(role)) is undone[role]}}
        if mixture:
            planes = {**planes, "colour": self.wider.widen_light(commands, "mixture", mixture)
                      if work.wider else mixture}
        return NetworkInputs(planes, noisy, given, undone.get(Role.COLOUR), mixture is not None)

    def _spread(self, commands: CommandBuffer, seen: NetworkInputs, name: str, picture: Tensor,
                rows: Rows) -> Tensor:
        """Record the work that applies the pixel filter to a picture again; `name`: of the
        result."""
        assert seen.undone_colour  # as the filter was undone
        lights = seen.given[Role.COLOUR], seen.undone_colour
        return self.unfiltered.spread(commands, name, lights, picture, rows)

    def sees_noise_alone(self, tag: str) -> bool:
        """Whether the network of a tag, or the one before it, takes noise for detail if a pixel
        filter spread it over neighbouring pixels."""
        runs_first = self.first_stage is not None and self.first_stage.runs
        return runs_first or self.models[tag] in self.pictures

    def is_outside(self, frame: ResidentFrame) -> bool:
        """Whether enough of a frame's light lies outside its gamut to denoise it in wider
        primaries. Not looked for on a GPU."""
        colour = frame.host_planes.get(Role.COLOUR) if self._device.memory.host_visible else None
        return colour is not None and light_outside(colour) > OUTSIDE

    def may_restore(self, frame: ResidentFrame) -> bool:
        """Whether a frame may get detail back. One with at most 16 samples a pixel may not, nor one
        with jitter, whose samples do not lie where the result's pixels do."""
        enough = (frame.samples or FULL_EVIDENCE_SAMPLES) > NO_DETAIL_SAMPLES
        return self.restore is not None and frame.jitter == (0.0, 0.0) and enough

    def lit_cells(self, frame: ResidentFrame) -> np.ndarray | None:
        """The cells whose result the picture's light may decide; None if they are most of the
        picture, or are not looked for. All others become 0, as filters only weigh pixels.

        Only for frames that leave no history: then the result has the same bits as when the
        network runs on the whole frame.
        """
        alike = self._only_weighs and self._reach and not frame.came_on_device
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
        """Whether the picture is black everywhere, and alpha 0 if it is filtered. Without a history
        the result is then 0, as filters only weigh pixels."""
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


def _lit_part(plane: np.ndarray) -> float:
    """The share of a plane's pixels that are not 0, by a few of them."""
    some = sampled(plane, LIT_PIXEL_STEP, LIT_PIXEL_STEP, LIT_PIXEL_STEP // 2).any(axis=2)
    return float(some.mean()) if some.size else 1.0
