"""Parts of the picture, such as light groups, and alpha: they get the picture's filters."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from postfx.errors import FrameError
from postfx.frame import ALBEDOS, FrameSpec, Part, Role
from postfx.kernels.denoise import EXPOSURE, GAIN, JITTER_X, MAX_COLOUR
from postfx.passes import ResidentFrame
from postfx.passes.denoise.alpha import Alpha
from postfx.passes.denoise.graph import BALANCED, DECODED, run_steps
from postfx.passes.denoise.history import (
    ALPHA_LAYER,
    WHOLE,
    LayerHistory,
    PartHistory,
    alone,
    make_zeros,
    one_of,
    places_of,
    some_of,
)
from postfx.passes.denoise.kinds import KINDS, LIGHT_KIND, Kind
from postfx.passes.denoise.options import Size
from postfx.passes.denoise.output import Restore, Strength
from postfx.passes.denoise.planes import ABSENT, Resampler, absent_plane
from postfx.passes.denoise.tiling import Rows
from postfx.passes.denoise.window import THE_PICTURE, Layer, Work
from postfx.passes.signed_light import SignedLight, below, lies_below
from postfx.planes import LARGEST_FLOAT
from postfx.runtime import CommandBuffer, Device, Tensor
from postfx.sampling import three_by_three

PART_SUM_TOLERANCE = 2e-3
"""Parts are all of the picture if their sum differs by less than this share of its light."""
BEYOND = 1.5
"""How many times that share they must be brighter than it in places to be no parts of it: halves
are rounded."""
SAMPLED_ROW_STEP = 8
"""One row in so many is looked at for that."""
# Shares of lit pixels around lit ones from which a part counts as a surface's and not as sparse
# light.
DENSE = 0.6
DENSER = 0.8
FARTHEST_DISTANCE = 1e9
"""Distances from here on stand for none."""
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


@dataclass
class Group:
    """Parts that add up to the picture or to some of it, and where they are in the stack."""

    first: int
    names: list[str] = field(default_factory=list)


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

    Every frame goes through `begin`, the windows' kernels, and `finish`; or through `resample`.
    """

    def __init__(self, device: Device, spec: FrameSpec, output: Size, parts: Sequence[Part],
                 alpha: bool, history: PartHistory) -> None:
        self._device, self._spec, self._output, self._history = device, spec, output, history
        self._parts = {part.name: part for part in parts}
        if alpha:
            self._parts[ALPHA_LAYER] = Part(ALPHA_LAYER, "mist")
        self._channels = dict(spec.parts)
        self._render = Size(spec.height, spec.width)
        self._groups = _groups_of(parts)
        self._places = places_of(parts)
        new = device.heap.tensor
        self._params = new("part params", (4,))
        self._exposed = new("whole params", (4,))
        self._exposure = 1.0
        self._nothing = make_zeros(device, "no reflectance",
                                   (*self._render, 3) if self._parts else (1,))
        self._made: dict[str, Tensor] = {}
        self._signed = SignedLight(device, self._render, output)
        self._below = {below(part.name): part.name for part in parts if part.is_light}
        self._codings = {name: new(f"coding {name}", (3,))
                         for name in (*self._parts, *self._below)}
        self._decodings = {name: new(f"decoding {name}", (5,))
                           for name, part in self._parts.items() if not part.is_light}
        self._complete = {group.first: new("complete", (1,)) for group in self._groups}
        self._everywhere = {group.first: new("everywhere", (len(group.names), 1, 1))
                            for group in self._groups}
        for tensor in self._everywhere.values():
            tensor.fill(1)
        self._reached = dict(self._everywhere)
        self._plain, self._plain_alpha = (Resampler(
            device, f"plain {name}", role, self._render, output
        ) for name, role in (("part", Role.COLOUR), ("alpha", Role.ALPHA)))
        self._copies: dict[str, Tensor] = {}
        self._identity = new("as it is", (5,))
        self._identity.upload([1.0, 0.0, -LARGEST_FLOAT, LARGEST_FLOAT, 0.0])
        self._runs: list[str] = []
        self._raw: dict[str, Tensor] = {}
        self._by_sign: dict[str, Tensor] = {}
        self._alpha = Alpha(device, spec, output) if alpha else None

    def begin(self, commands: CommandBuffer, frame: ResidentFrame, planes: Mapping[str, Tensor],
              work: Work) -> tuple[list[Layer], dict[str, dict[str, Tensor]]]:
        """The layers of a frame, and the targets that windows write, with the picture's output if
        there is light."""
        for plain in (self._plain, self._plain_alpha):
            plain.aim(frame.jitter)
        self._exposure = float(work.params[EXPOSURE])
        self._params.upload([1.0, *work.params[JITTER_X:GAIN], 1.0])
        self._exposed.upload([*work.params[:GAIN], 1.0])
        self._history.turn()
        self._by_sign = self._take_apart(commands, frame)
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
                runs.append(Layer(name, {"params": self._params, **tensors}, True, enlarged,
                                  enlarged, 0))
                continue
            last, stack, place = self._stacks_of(name, history)
            targets[name] = {"light": one_of(stack, place)}
            tensors = {"params": self._exposed}
            if name != WHOLE:
                targets[name]["next_part"] = history.next["last_part"]
                tensors = {"params": self._params, "last_part": history.last["last_part"],
                           **self._inputs(name, frame, planes)}
            is_first = not (fresh and self._kind(name).stays)
            runs.append(Layer(name, tensors, is_first, last, stack, place))
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
                 work: Work) -> Iterator[OwnRun]:
        """The runs of the network on parts, in this frame."""
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
        """Record the work that makes the frame's parts and alpha from the kernels' outputs.

        Args:
            pictures: those of the frame; blended with the input in `rows`.
            restore, strength: what made the last one; None where nothing was to be done.
        """
        filtered, denoised, picture = pictures
        for group in self._groups:
            whole = one_of(self._stack("blended"), 0) if WHOLE in self._runs else filtered
            under = self._under(group, {name: self._history.layer(name).output
                                        for name in self._below if name in self._runs})
            self._balance(commands, group, self._stack("blended"), (whole, filtered),
                          self._history.stacks[1], under)
            if filtered is not denoised:
                self._balance(commands, group, self._history.stacks[1], (filtered, denoised),
                              self._stack("brought"), under)
        values = {name: self._finish_layer(commands, frame, name, pictures, rows, restore, strength)
                  for name in self._runs if name != WHOLE}
        values |= {name: self._resampled(commands, frame, name)
                   for name in self._parts if not self._kind(name).is_filtered}
        self._leave_all(commands, frame, values, picture, bool(restore or strength))

    def _finish_layer(self, commands: CommandBuffer, frame: ResidentFrame, name: str,
                      pictures: Pictures, rows: Rows, restore: Restore | None,
                      strength: Strength | None) -> Tensor:
        """Record what becomes of one layer behind the windows, as of the picture; returns it."""
        kind = self._kind(name)
        value = self._history.layer(name).output
        raw = self._raw.get(name)
        plain = self._plain
        if name == ALPHA_LAYER and self._alpha:
            raw, plain = frame[Role.ALPHA], self._plain_alpha
            value = self._alpha.correct(commands, pictures.filtered)
        elif name in self._decodings and not kind.are_distances:
            value = self._decoded(commands, name, value)
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
        """Record the work that only resamples the parts to output size, as for a picture that is
        only resampled."""
        for group in self._groups:
            self._complete[group.first].upload([_completeness(frame, group.names)])
        self._reached = dict(self._everywhere)
        self._plain.aim(frame.jitter)
        self._by_sign = self._take_apart(commands, frame)
        layers = dict.fromkeys((*self._parts, *self._by_sign))
        values = {name: self._resampled(commands, frame, name)
                  for name in layers if name != ALPHA_LAYER}
        self._leave_all(commands, frame, values, picture, True)

    def _resampled(self, commands: CommandBuffer, frame: ResidentFrame, name: str) -> Tensor:
        return self._plain.resample(commands, self._input(name, frame), self._finished(name))

    def _leave_all(self, commands: CommandBuffer, frame: ResidentFrame,
                   values: Mapping[str, Tensor], picture: Tensor, changed: bool) -> None:
        """Put layers into the frame, light so that it adds up to a picture that was `changed` once
        more."""
        for group in self._groups if changed else ():
            self._balance(commands, group, self._stack("finished"), (picture, picture),
                          self._stack("balanced"), self._under(group, values))
        for name, value in values.items():
            if name in self._below:
                continue
            if changed and self._is_light(name):
                value = one_of(self._stack("balanced"), self._places[name])
            if below(name) in values:
                value = self._signed.join(commands, name, value, values[below(name)])
            self._leave(commands, frame, name, value)

    def _take_apart(self, commands: CommandBuffer, frame: ResidentFrame) -> dict[str, Tensor]:
        """The layers of parts with light below 0, by name. A part that had some in the frame before
        keeps both, as its history does."""
        found: dict[str, Tensor] = {}
        for layer, name in self._below.items():
            before = self._history.layers.get(layer)
            if (before and before.frames) or lies_below(
                frame.host_parts[name], frame.host_planes[Role.COLOUR]):
                found |= self._signed.split(commands, name, self._three(name, frame))
        return found

    def _under(self, group: Group, values: Mapping[str, Tensor]) -> list[Tensor]:
        """Light below 0 of the parts of a group, by the names of their layers."""
        return [values[below(name)] for name in group.names if below(name) in values]

    def _needed(self, frame: ResidentFrame) -> list[str]:
        """The layers of this frame: alpha only where it is neither 0 nor 1, the whole picture only
        beside parts that are not all of it."""
        found = []
        for group in self._groups:
            complete = _completeness(frame, group.names)
            self._complete[group.first].upload([complete])
            found += [] if complete > 0 or WHOLE in found else [WHOLE]
            self._note_reach(frame, group)
        found += [name for name in self._parts
                  if name != ALPHA_LAYER and self._kind(name).is_filtered]
        found += [layer for layer in self._below if layer in self._by_sign]
        return found + ([ALPHA_LAYER] if ALPHA_LAYER in self._parts and has_noisy_alpha(frame)
                        else [])

    def _note_reach(self, frame: ResidentFrame, group: Group) -> None:
        """Where the parts of a group have light in this frame: what is seen by a colour, lamps, and
        reflections."""
        self._reached[group.first] = self._everywhere[group.first]
        planes = [self._parts[name].factor or (name if self._kind(name).is_seen else "")
                  for name in group.names]
        if not any(planes):
            return
        name = f"reached by {group.first}"
        if name not in self._copies:
            self._copies[name] = self._device.heap.tensor(name, (len(group.names), *self._render))
        reached = np.ones((len(group.names), *self._render), np.float32)
        for i, plane in enumerate(planes):
            if plane in frame.host_parts:
                reached[i] = coverage(frame.host_parts[plane].max(axis=2) > 0,
                                      self._kind(plane).is_sparse)
        self._copies[name].upload(reached)
        self._reached[group.first] = self._copies[name]

    def _inputs(self, name: str, frame: ResidentFrame,
                planes: Mapping[str, Tensor]) -> dict[str, Tensor]:
        self._raw[name], kind = self._input(name, frame), self._kind(name)
        low, high = kind.span or _range_of(frame.host_parts[name])
        scale = 1.0 if (low, high) == (0.0, 1.0) else 1 / max(high - low, 1e-30)
        most = LARGEST_FLOAT if kind.are_distances else MAX_COLOUR / self._exposure
        self._codings[name].upload([low, scale, most])
        if name in self._decodings and not kind.are_distances:
            decoding = [1 / scale, low, *kind.bounds, float(kind.are_vectors)]
            self._decodings[name].upload(decoding)
        found = {"part": self._raw[name], "coding": self._codings[name]}
        if kind.is_like_picture:
            return found
        return found | {str(role): planes[str(role)] if role in kind.divided else self._nothing
                        for role in ALBEDOS}

    def _own_reflectance(self, name: str, planes: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """Planes, at both sizes, in place of those that a part has nothing to do with: reflectance
        that it is not divided by, and for fog, which has no surface, all of them. Light through
        glass, which files divide by a colour, has one."""
        kind = self._kind(name)
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
        return self._by_sign.get(name) or self._three(name, frame)

    def _three(self, name: str, frame: ResidentFrame) -> Tensor:
        """A layer's values with three channels, as the kernels need them."""
        are_distances = self._kind(name).are_distances
        if self._channels[name] == 3 and not are_distances:
            return frame.parts[name]
        given = frame.host_parts[name]
        if are_distances:
            given, decoding = encode_depth(given)
            self._decodings[name].upload(decoding)
        if name not in self._copies:
            self._copies[name] = self._device.heap.tensor(f"{name}, three times",
                                                          (*self._render, 3))
        self._copies[name].upload(given if given.shape[2] == 3 else np.repeat(given, 3, axis=2))
        return self._copies[name]

    def _balance(self, commands: CommandBuffer, group: Group, stack: Tensor,
                 pictures: tuple[Tensor, Tensor], balanced: Tensor,
                 under: Sequence[Tensor]) -> None:
        """Bring a group's parts of a stack to a picture: `pictures` are the whole as it was
        filtered, and that; `under` is what the parts have below 0, which both lack."""
        count = len(group.names)
        whole, picture = (
            self._signed.lift(commands, f"{what} above 0 of {group.first}", light, under)
            for what, light in zip(("whole", "picture"), pictures, strict=True))
        run_steps(commands, BALANCED, {
            "parts": some_of(stack, group.first, count), "whole": whole,
            "picture": picture, "reached": self._reached[group.first],
            "complete": self._complete[group.first],
            "balanced": some_of(balanced, group.first, count)})

    def _stack(self, name: str) -> Tensor:
        """Pictures of the whole and of all light within a frame, in the places that they have in
        the history."""
        if name not in self._made:
            shape = (1 + sum(len(group.names) for group in self._groups), *self._output, 3)
            self._made[name] = self._device.heap.transient(f"{name} parts", shape)
        return self._made[name]

    def _decoded(self, commands: CommandBuffer, name: str, filtered: Tensor) -> Tensor:
        output = self._between(f"decoded {name}", 3)
        run_steps(commands, DECODED, {"filtered": filtered, "decoding": self._decodings[name],
                                      "plane": output})
        return output

    def _leave(self, commands: CommandBuffer, frame: ResidentFrame, name: str,
               value: Tensor) -> None:
        """Put a layer into the frame."""
        if name == ALPHA_LAYER:
            frame.set(Role.ALPHA, value)
            return
        channels, are_distances = self._channels[name], self._kind(name).are_distances
        if channels == value.shape[2] and not are_distances:
            frame.parts[name] = value
            return
        output = self._between(f"output {name}", channels)
        decoding = self._decodings[name] if are_distances else self._identity
        run_steps(commands, DECODED, {"filtered": value, "decoding": decoding, "plane": output},
                  frozenset({"single"} if channels == 1 else ()))
        frame.parts[name] = output

    def _finished(self, name: str) -> Tensor:
        """The tensor for a layer that is given detail back, or blended with the input."""
        if self._is_light(name):
            return one_of(self._stack("finished"), self._places[name])
        return self._between(f"finished {name}", 1 if name == ALPHA_LAYER else 3)

    def _between(self, name: str, channels: int) -> Tensor:
        """A picture within a frame."""
        if name not in self._made:
            self._made[name] = self._device.heap.transient(name, (*self._output, channels))
        return self._made[name]

    def _is_light(self, name: str) -> bool:
        return name == WHOLE or (name in self._parts and self._parts[name].is_light)

    def _kind(self, name: str) -> Kind:
        name = self._below.get(name, name)
        return KINDS[self._parts[name].kind] if name in self._parts else LIGHT_KIND


def _groups_of(parts: Sequence[Part]) -> list[Group]:
    groups: dict[str, Group] = {}
    for i, part in enumerate(part for part in parts if part.is_light):
        groups.setdefault(part.group, Group(i + 1)).names.append(part.name)
    return list(groups.values())


def coverage(lit: np.ndarray, may_be_sparse: bool) -> np.ndarray:
    """How far render pixels (h, w) have light of a part: 1 where there is some, else the share of
    3x3 pixels.

    Light that `may_be_sparse` misses pixels by chance, so all pixels have it unless lit ones lie
    together.
    """
    seen = lit.astype(np.float32)
    share = three_by_three(seen, 1, np.add) / np.float32(9)
    unlit = (1 - seen) * (1 - share)
    if may_be_sparse:
        around, together = (three_by_three(plane, 3, np.add) for plane in (
            share, three_by_three(seen * share, 1, np.add) / np.float32(9)))
        dense = np.clip((together / np.maximum(around, 1e-6) - DENSE) / (DENSER - DENSE), 0, 1)
        unlit *= np.where(around > 1e-6, three_by_three(dense, 3, np.maximum), 1)
    return 1 - unlit


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
    """log2 of the mean light of every eighth row; None without any. By a mean of logarithms, sparse
    light, most of whose pixels are dark, would be overexposed."""
    rows = light[::SAMPLED_ROW_STEP]
    seen = rows[np.isfinite(rows)]
    total = float(seen.sum(dtype=np.float64))
    return float(np.log2(total / seen.size)) if total > 0 else None


def _range_of(values: np.ndarray) -> tuple[float, float]:
    """The least and largest finite value."""
    finite = values[np.isfinite(values)]
    return (float(finite.min()), float(finite.max())) if finite.size else (0.0, 1.0)


def _completeness(frame: ResidentFrame, names: Sequence[str]) -> float:
    """1 where parts add up to the picture, 0 where they are some of it, and -1 where they are
    brighter than it, so that it does not hold them; by every eighth row."""
    colour = frame.host_planes.get(Role.COLOUR)
    if colour is None:
        return 0.0
    seen = colour[::SAMPLED_ROW_STEP]
    total = sum((frame.host_parts[name][::SAMPLED_ROW_STEP] for name in names), np.zeros_like(seen))
    with np.errstate(invalid="ignore", over="ignore"):
        apart, light = total - seen, np.abs(seen)
    valid = np.isfinite(apart)
    apart, least = apart[valid], PART_SUM_TOLERANCE * light[valid].sum(dtype=np.float64)
    if np.abs(apart).sum(dtype=np.float64) <= least:
        return 1.0
    return -1.0 if np.maximum(apart, 0).sum(dtype=np.float64) > BEYOND * least else 0.0


def encode_depth(depth: np.ndarray) -> tuple[np.ndarray, list[float]]:
    """A plane of distances (height, width, n), coded for the filters; its first channel counts.

    Returns (height, width, 3): 1 / distance, whether the pixel has a distance (0, 1e9 and NaN are
    none), and the latter again. Then the ``decoding`` that reverses it: sign, the value that stands
    for none, the smallest and largest distance, -1.
    """
    depth = depth[..., 0]
    with np.errstate(invalid="ignore"):
        there = (np.abs(depth) < FARTHEST_DISTANCE) & (depth != 0)
    # some renderers look along the negative axis
    sign = (-1.0 if 2 * (depth[there] < 0).sum() > there.sum() else 1.0)
    there[there] = sign * depth[there] > 0
    distances, none = np.abs(depth[there]), depth[~there]
    near, far = ((float(distances.min()), float(distances.max())) if distances.size
                 else (0.0, LARGEST_FLOAT))
    nothing = float(none[0]) if none.size and not np.isnan(none[0]) else sign * LARGEST_FLOAT
    inverse = np.zeros_like(depth)
    inverse[there] = 1 / distances
    return np.stack([inverse, there, there], axis=-1, dtype=np.float32), [sign, nothing, near, far,
                                                                          -1.0]


def has_noisy_alpha(frame: ResidentFrame) -> bool:
    """Whether alpha has noise to filter: values between 0 and 1, or the holes and specks of one
    sample a pixel."""
    alpha = frame.host_planes.get(Role.ALPHA)
    if alpha is None:
        return False
    return bool(((alpha > 0) & (alpha < 1)).any()) or is_speckled(alpha[..., 0] > 0)


SPECKLED = 0.02
"""Share of the pixels at edges that are alone among others, both covered and not, from which that
is noise."""


def is_speckled(covered: np.ndarray) -> bool:
    """Whether a mask (h, w) has lone pixels of both kinds: wires are lone covered ones, and gaps
    lone empty ones."""
    around = three_by_three(covered.astype(np.float32), 1, np.add)
    edges = np.count_nonzero((around > 0) & (around < 9))
    specks = np.count_nonzero(covered & (around <= 3))
    holes = np.count_nonzero(~covered & (around >= 6))
    return bool(edges > 0 and min(specks, holes) > SPECKLED * edges)
