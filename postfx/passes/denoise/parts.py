"""Layers beside the picture, which get its filters: parts, such as light groups, and alpha.

A frame goes through `Layers.begin`, the kernels of the windows, and `Layers.finish`. How values of
parts are coded is in `part_values`, how their sums are kept in `part_sums`.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from postfx.errors import FrameError
from postfx.frame import ALBEDOS, FrameSpec, Part, Role
from postfx.kernels.denoise import EXPOSURE, GAIN, JITTER_X
from postfx.passes import ResidentFrame
from postfx.passes.denoise.alpha import Alpha, has_noisy_alpha
from postfx.passes.denoise.geometry import Rows, Size
from postfx.passes.denoise.history import (
    ALPHA_LAYER,
    WHOLE,
    LayerHistory,
    PartHistory,
    alone,
    make_zeros,
    one_of,
    places_of,
)
from postfx.passes.denoise.output import Restore, Strength
from postfx.passes.denoise.part_sums import SAMPLED_ROW_STEP, Group, PartSums, groups_of
from postfx.passes.denoise.part_values import PartValues
from postfx.passes.denoise.planes import ABSENT, Resampler, absent_plane
from postfx.passes.denoise.window import THE_PICTURE, FilteredLayer, FrameWork
from postfx.passes.signed_light import SignedLight, negative_layer
from postfx.planes import has_negative_light
from postfx.runtime import CommandBuffer, Device, Tensor

SURFACE = tuple(role for role in ABSENT if role is not Role.MOTION)
"""Planes that tell of the surface that is seen."""


def checked_parts(parts: Sequence[Part | str]) -> tuple[Part, ...]:
    """The option `parts`: names alone stand for light. FrameError for a name that is there
    twice."""
    found = tuple(Part(part) if isinstance(part, str) else part for part in parts)
    names = [part.name for part in found]
    twice = [name for name in names if names.count(name) > 1]
    if twice:
        raise FrameError(f"part '{twice[0]}' is named twice: a part is of one kind and one group")
    return tuple(sorted(found, key=lambda part: (not part.is_light, part.group)))


class OwnRun(NamedTuple):
    """One run of the network on a part: the part's planes and params, and the tensor for its
    output."""

    name: str
    planes: dict[str, Tensor]
    params: np.ndarray
    output: Tensor


class Pictures(NamedTuple):
    """A frame's picture on its way through the filters.

    Attributes:
        filtered: what was filtered with its parts.
        denoised: the network's: the same, or another network's.
        leaving: as it leaves the pass, with detail given back and blended with the input.
    """

    filtered: Tensor
    denoised: Tensor
    leaving: Tensor


class Layers:
    """All layers that are filtered beside the picture, for frames of one spec.

    Every frame goes through `begin`, the windows' kernels, and `finish`; or through `skip`, where
    no layer is filtered; or through `resample`, where the picture is not filtered either.

    Args:
        spec: of the frames.
        output: size of what leaves.
        parts: those to denoise.
        alpha: whether alpha is denoised, too.
        history: what layers leave to the next frame.
    """

    def __init__(self, device: Device, spec: FrameSpec, output: Size, parts: Sequence[Part],
                 alpha: bool, history: PartHistory) -> None:
        self._device, self._spec, self._output, self._history = device, spec, output, history
        self._parts = {part.name: part for part in parts}
        if alpha:
            self._parts[ALPHA_LAYER] = Part(ALPHA_LAYER, "mist")
        self._render = Size(spec.height, spec.width)
        self._groups = groups_of(parts)
        self._places = places_of(parts)
        new = device.heap.tensor
        self._params = new("part params", (4,))
        self._exposed = new("whole params", (4,))
        self._exposure_factor = 1.0
        self._nothing = make_zeros(device, "no reflectance",
                                   (*self._render, 3) if self._parts else (1,))
        self._made: dict[str, Tensor] = {}
        self._signed = SignedLight(device, self._render, output)
        self._negative_layers = {negative_layer(part.name): part.name
                                 for part in parts if part.is_light}
        self._values = PartValues(device, spec, output, self._parts, self._negative_layers)
        self._sums = PartSums(device, self._groups, self._parts, self._render, self._signed)
        self._plain, self._plain_alpha = (Resampler(
            device, f"plain {name}", role, self._render, output
        ) for name, role in (("part", Role.COLOUR), ("alpha", Role.ALPHA)))
        self._runs: list[str] = []
        self._raw: dict[str, Tensor] = {}
        self._by_sign: dict[str, Tensor] = {}
        self._alpha = Alpha(device, spec, output) if alpha else None

    def begin(self, commands: CommandBuffer, frame: ResidentFrame, planes: Mapping[str, Tensor],
              work: FrameWork) -> tuple[list[FilteredLayer], dict[str, dict[str, Tensor]]]:
        """Begin a frame: the layers that are filtered, and the tensors for windows to write, by
        layer and binding. The picture's output is among these where parts must add up to it.

        planes: of the network, by the kernels' names.
        """
        for plain in (self._plain, self._plain_alpha):
            plain.aim(frame.jitter)
        self._exposure_factor = float(work.params[EXPOSURE])
        self._params.upload([1.0, *work.params[JITTER_X:GAIN], 1.0])
        self._exposed.upload([*work.params[:GAIN], 1.0])
        self._history.turn()
        self._by_sign = self._split_by_sign(commands, frame)
        self._runs = self._needed(frame)
        runs = []
        targets: dict[str, dict[str, Tensor]] = {}
        for name in self._history.layers.keys() - {*self._runs}:
            self._history.layers[name].skip(shared=name in self._places)
        for name in self._runs:
            history = self._history.layer(name)
            if name in self._history.own:
                history.follow()
                continue
            fresh = history.turn(commands, self._render, work.keep)
            if name == ALPHA_LAYER and self._alpha:
                tensors = self._alpha.gather(commands, frame, planes, history, fresh)
                enlarged = self._alpha.enlarged
                targets[name] = {"light": enlarged}
                runs.append(FilteredLayer(name, {"params": self._params, **tensors}, True, enlarged,
                                  enlarged, 0))
                continue
            last, stack, place = self._stacks_of(name, history)
            targets[name] = {"light": one_of(stack, place)}
            tensors = {"params": self._exposed}
            if name != WHOLE:
                targets[name]["next_part"] = history.next["last_part"]
                tensors = {"params": self._params, "last_part": history.last["last_part"],
                           **self._inputs(name, frame, planes)}
            is_first = not (fresh and self._values.kind(name).stays)
            runs.append(FilteredLayer(name, tensors, is_first, last, stack, place))
        if self._groups:
            targets[THE_PICTURE] = {"output": one_of(self._history.stacks[1], 0)}
            whole = self._history.layers[WHOLE]
            whole.frames = max(whole.frames, 1)  # the picture is its history where it does not run
        return runs, targets

    def _stacks_of(self, name: str, history: LayerHistory) -> tuple[Tensor, Tensor, int]:
        """The stacks that hold a layer's last output and its new one, and its place in both."""
        if name not in self._places:
            return alone(history.last["history"]), alone(history.output), 0
        last, stack = self._history.stacks
        return last, self._stack("blended") if self._is_light(name) else stack, self._places[name]

    def skip(self) -> None:
        """Begin a frame in which no layer runs."""
        self._history.turn()
        for name, layer in self._history.layers.items():
            layer.skip(shared=name in self._places)

    def own_runs(self, frame: ResidentFrame, planes: Mapping[str, Tensor],
                 work: FrameWork) -> Iterator[OwnRun]:
        """The runs of the network on parts that have filters of their own, in this frame."""
        self._history.ran = tuple(name for name in self._history.own if name in self._runs)
        for name in self._history.ran:
            part = self._raw[name] = self._input(name, frame)
            before, stops = self._history.stops[name], self._history.stops
            stops[name] = _stops_above(frame, name, before)
            own = work.params.copy()
            own[EXPOSURE] *= 2.0 ** stops[name]
            own[GAIN] *= 2.0 ** (stops[name] - before) if work.keep else 1.0
            seen = {**planes, str(Role.COLOUR): part, **self._own_reflectance(name, planes)}
            yield OwnRun(name, seen, own, one_of(self._stack("blended"), self._places[name]))

    def finish(self, commands: CommandBuffer, frame: ResidentFrame, pictures: Pictures,
               rows: Rows, restore: Restore | None, strength: Strength | None) -> None:
        """Record the work that makes the frame's parts and alpha of what the windows wrote.

        Args:
            pictures: the frame's picture, as it was filtered and as it leaves.
            rows: of the output, in which the picture was blended with the input.
            restore: what gave the picture detail back; None if nothing did.
            strength: what blended it with the input; None if nothing did.
        """
        filtered, denoised, picture = pictures
        for group in self._groups:
            whole = one_of(self._stack("blended"), 0) if WHOLE in self._runs else filtered
            negatives = self._negatives(group, {name: self._history.layer(name).output
                                                for name in self._negative_layers
                                                if name in self._runs})
            self._sums.balance(commands, group, self._stack("blended"), (whole, filtered),
                               self._history.stacks[1], negatives)
            if filtered is not denoised:
                self._sums.balance(commands, group, self._history.stacks[1],
                                   (filtered, denoised), self._stack("brought"), negatives)
        values = {name: self._finish_layer(commands, frame, name, pictures, rows, restore, strength)
                  for name in self._runs if name != WHOLE}
        values |= {name: self._resampled(commands, frame, name)
                   for name in self._parts if not self._values.kind(name).is_filtered}
        self._leave_all(commands, frame, values, picture, bool(restore or strength))

    def _finish_layer(self, commands: CommandBuffer, frame: ResidentFrame, name: str,
                      pictures: Pictures, rows: Rows, restore: Restore | None,
                      strength: Strength | None) -> Tensor:
        """Record what is done to one layer after the windows, as it was to the picture; returns the
        layer."""
        kind = self._values.kind(name)
        value = self._history.layer(name).output
        raw = self._raw.get(name)
        plain = self._plain
        if name == ALPHA_LAYER and self._alpha:
            raw, plain = frame[Role.ALPHA], self._plain_alpha
            value = self._alpha.correct(commands, pictures.filtered)
        elif self._values.is_decoded(name):
            value = self._values.decode(commands, name, value)
        elif self._is_light(name) and pictures.filtered is not pictures.denoised:
            value = one_of(self._stack("brought"), self._places[name])
        assert raw is not None  # as the layer ran
        if restore and kind.is_detailed:
            place = (self._between(f"restored {name}", value.shape[2]) if strength
                     else self._finished(name))
            value = restore.encode_part(commands, raw, value, place)
        if strength:
            value = strength.encode_part(commands, raw, value, rows, plain, self._finished(name))
        return value

    def resample(self, commands: CommandBuffer, frame: ResidentFrame, picture: Tensor) -> None:
        """Record the work that resamples the parts to output size, for a picture that is only
        resampled."""
        self._sums.look_at_sums(frame)
        self._plain.aim(frame.jitter)
        self._by_sign = self._split_by_sign(commands, frame)
        layers = dict.fromkeys((*self._parts, *self._by_sign))
        values = {name: self._resampled(commands, frame, name)
                  for name in layers if name != ALPHA_LAYER}
        self._leave_all(commands, frame, values, picture, True)

    def _resampled(self, commands: CommandBuffer, frame: ResidentFrame, name: str) -> Tensor:
        return self._plain.resample(commands, self._input(name, frame), self._finished(name))

    def _leave_all(self, commands: CommandBuffer, frame: ResidentFrame,
                   values: Mapping[str, Tensor], picture: Tensor, changed: bool) -> None:
        """Put layers into the frame. If the picture was `changed` after they added up to it, light
        is brought to it once more."""
        for group in self._groups if changed else ():
            self._sums.balance(commands, group, self._stack("finished"), (picture, picture),
                               self._stack("balanced"), self._negatives(group, values))
        for name, value in values.items():
            if name in self._negative_layers:
                continue
            if changed and self._is_light(name):
                value = one_of(self._stack("balanced"), self._places[name])
            if negative_layer(name) in values:
                value = self._signed.join(commands, name, value, values[negative_layer(name)])
            self._values.leave(commands, frame, name, value)

    def _split_by_sign(self, commands: CommandBuffer, frame: ResidentFrame) -> dict[str, Tensor]:
        """The layers of parts with negative light, by name. A part that had some in the frame
        before is still split, as its history is."""
        found: dict[str, Tensor] = {}
        for layer, name in self._negative_layers.items():
            before = self._history.layers.get(layer)
            if (before and before.frames) or has_negative_light(
                frame.host_parts[name], frame.host_planes[Role.COLOUR]):
                light = self._values.three_channels(name, frame)
                found |= self._signed.split(commands, name, light)
        return found

    def _negatives(self, group: Group, values: Mapping[str, Tensor]) -> list[Tensor]:
        """The negative layers of the parts of a group, of those among `values`."""
        layers = map(negative_layer, group.names)
        return [values[layer] for layer in layers if layer in values]

    def _needed(self, frame: ResidentFrame) -> list[str]:
        """The layers of this frame: alpha only where it is neither 0 nor 1, the whole picture only
        beside parts that are not all of it."""
        found = [] if self._sums.look(frame) else [WHOLE]
        found += [name for name in self._parts
                  if name != ALPHA_LAYER and self._values.kind(name).is_filtered]
        found += [layer for layer in self._negative_layers if layer in self._by_sign]
        return found + ([ALPHA_LAYER] if ALPHA_LAYER in self._parts and has_noisy_alpha(frame)
                        else [])

    def _inputs(self, name: str, frame: ResidentFrame,
                planes: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """What the filters read of a part in this frame, by binding."""
        self._raw[name], kind = self._input(name, frame), self._values.kind(name)
        found = {"part": self._raw[name],
                 "coding": self._values.coding(name, frame, self._exposure_factor)}
        if kind.is_like_picture:
            return found
        return found | {str(role): planes[str(role)] if role in kind.divided else self._nothing
                        for role in ALBEDOS}

    def _own_reflectance(self, name: str, planes: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """Stand-ins, at both sizes, for planes that say nothing about a part: reflectance that it
        is not divided by; and for fog, which has no surface, all that tell of the surface. Light
        through glass, which files divide by a colour, has a surface."""
        kind = self._values.kind(name)
        lost = [role for role in ALBEDOS if role not in kind.divided]
        if not (kind.on_surface or self._parts[name].factor):
            lost = [*SURFACE]
        found = {str(role): self._absent(role, self._render) for role in lost}
        return found | {f"guide_{role}": self._absent(role, self._output)
                        for role in lost if f"guide_{role}" in planes}

    def _absent(self, role: Role, size: Size) -> Tensor:
        name = f"no {role} of {size}"
        if name not in self._made:
            self._made[name] = absent_plane(self._device, role, size)
        return self._made[name]

    def _input(self, name: str, frame: ResidentFrame) -> Tensor:
        """The tensor that a layer is filtered from: a part, or its light of one sign."""
        return self._by_sign.get(name) or self._values.three_channels(name, frame)

    def _stack(self, name: str) -> Tensor:
        """A stack of the whole picture and of all light, which lasts for a frame. Places in it are
        those of the history."""
        if name not in self._made:
            shape = (1 + sum(len(group.names) for group in self._groups), *self._output, 3)
            self._made[name] = self._device.heap.transient(f"{name} parts", shape)
        return self._made[name]

    def _finished(self, name: str) -> Tensor:
        """The tensor for a layer that is given detail back, or blended with the input."""
        if self._is_light(name):
            return one_of(self._stack("finished"), self._places[name])
        return self._between(f"finished {name}", 1 if name == ALPHA_LAYER else 3)

    def _between(self, name: str, channels: int) -> Tensor:
        """A picture of the output's size that lasts for a frame."""
        if name not in self._made:
            self._made[name] = self._device.heap.transient(name, (*self._output, channels))
        return self._made[name]

    def _is_light(self, name: str) -> bool:
        """Whether a layer is light of the picture: a part, or the whole of it."""
        return name == WHOLE or self._values.is_light(name)


def _stops_above(frame: ResidentFrame, name: str, before: float) -> float:
    """Stops by which a part is darker than the picture, 0 to 8: those of the last frame unless they
    are off by 1."""
    picture, part = (mean_stops(light)
                     for light in (frame.host_planes[Role.COLOUR], frame.host_parts[name]))
    if picture is None or part is None:
        return before
    stops = min(max(picture - part, 0.0), 8.0)
    return before if abs(stops - before) < 1 else float(round(stops))


def mean_stops(light: np.ndarray) -> float | None:
    """log2 of the mean light of every eighth row; None without any. A mean of logarithms would
    overexpose sparse light, most of whose pixels are dark."""
    rows = light[::SAMPLED_ROW_STEP]
    seen = rows[np.isfinite(rows)]
    total = float(seen.sum(dtype=np.float64))
    return float(np.log2(total / seen.size)) if total > 0 else None
