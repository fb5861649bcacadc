"""What a network learns from one shot: frames with targets, and windows of them. Some are trained
on, the others are held back.

References may hold tiles only: with a plane of sample counts, pixels with less than half of the
most samples do not count. If few pixels count, windows are smaller, and there are more of them.

From two renders, each window takes every pixel of one of them at random, and the target takes it of
the other. So a network never sees the same noise twice, and hardly learns it by heart.

A quarter is held back: frames if four or more have a target, else the right quarter of the pixels
that count.
"""

from __future__ import annotations

import argparse
import random
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np
import torch
from torch import Tensor

from postfx.cli.tune import TUNE
from postfx.errors import FrameError, OptionError
from postfx.exposure import ExposureMeter
from postfx.frame import ROLES, Frame, Role
from postfx.io.sequence import Sequence, read_sequence
from postfx.other_shots import is_other_picture, squares_of
from postfx.passes.denoise.planes import shows_volume
from postfx.pixel_filter import find_stddev
from postfx.repeats import is_same_render
from training.denoise.clips import ABSENT
from training.denoise.model import Inputs

FRAMES_BEFORE = 2
"""Frames of history that an example has, if the shot has them."""
MOST_READ_PX = 64e6
"""Pixels of all frames that are read of a sequence, at most; each takes some 100 bytes. At least
`KEPT` frames are read in any case."""
WINDOW_PX = 128
"""Side of a window."""
BATCH = 4
"""Windows a step."""
SPARSE = 0.25
"""Share of the pixels that count, below which windows have half the side and there are four times
as many."""
HELD_WINDOWS = {"cuda": 48, "cpu": 12}
"""Windows on which a network is measured, by device."""
KEPT = 4
"""One frame, or one column of a picture, in so many is held back."""
BRIGHTEST = 1e4
"""Exposed light above this is cut to it."""


@dataclass
class Example:
    """A frame with a target, and the frames before it.

    Attributes:
        number: of the frame.
        frames: the oldest first, with light as rendered; batches of one.
        follows: for each frame, whether the history goes on there.
        exposure: factor of the light of all frames.
        target: (1, 3, height, width), exposed light.
        known: (1, 1, height, width), 1 where the target counts, else 0.
        twins: the same frames of the other render, the last of which is the target; empty if
            pixels cannot be swapped.
    """

    number: int
    frames: list[Inputs]
    follows: list[bool]
    exposure: float
    target: Tensor
    known: Tensor
    twins: list[Inputs] = field(default_factory=list)


@dataclass
class Windows:
    """A batch of N windows.

    Attributes:
        frames: the oldest first, with light exposed.
        follows: for each frame, (N, 1, 1, 1), 1 where the history goes on, else 0.
        target: (N, 3, side, side), exposed light.
        known: (N, 1, side, side), 1 where the target counts, else 0.
    """

    frames: list[Inputs]
    follows: list[Tensor]
    target: Tensor
    known: Tensor


def inputs_of(frame: Frame, blanks_volumes: bool, device: torch.device) -> Inputs:
    """A frame as the product gives it to the network, with light not yet exposed.

    blanks_volumes: whether depth and albedo are hidden where they are noise.
    """
    height, width = frame[Role.COLOUR].shape[:2]
    hides = blanks_volumes and Role.DEPTH in frame and shows_volume(frame[Role.DEPTH])
    missing = {"depth", "diffuse_albedo", "specular_albedo"} if hides else set()
    planes = {}
    for name, value in ABSENT.items():
        role = Role(name)
        held = role in frame and name not in missing
        plane = frame[role] if held else np.full((height, width, ROLES[role].channels), value,
                                                 np.float32)
        planes[name] = as_planes(plane, device)
    return Inputs(colour=as_planes(frame[Role.COLOUR], device), **planes,
                  jitter=torch.tensor([frame.jitter], dtype=torch.float32, device=device))


def as_planes(plane: np.ndarray, device: torch.device) -> Tensor:
    """(height, width, C) -> (1, C, height, width) on a device."""
    return torch.from_numpy(np.ascontiguousarray(plane)).permute(2, 0, 1)[None].to(device)


class Reader:
    """The frames of a sequence as the network reads them, each read once."""

    def __init__(self, sequence: Sequence, blanks_volumes: bool, device: torch.device) -> None:
        self.sequence = sequence
        self._blanks, self._device = blanks_volumes, device
        self._meter = ExposureMeter()
        self._inputs: dict[int, Inputs] = {}
        self._exposures: dict[int, float] = {}
        self._continues: dict[int, bool] = {}

    def inputs(self, number: int) -> Inputs:
        """A frame."""
        if number not in self._inputs:
            frame = self.sequence.read(number)
            self._inputs[number] = inputs_of(frame, self._blanks, self._device)
            self._exposures[number] = float(self._meter(frame))
            self._continues[number] = Role.MOTION in frame and not frame.reset
        return self._inputs[number]

    def pixels(self) -> int:
        """Pixels of the first frame."""
        return self.inputs(self.sequence.numbers[0]).colour[0, 0].numel()

    def continues(self, number: int) -> bool:
        """Whether a frame goes on from the one before it."""
        self.inputs(number)
        return self._continues[number]

    def example(self, number: int, light: Tensor, known: Tensor) -> Example:
        """A frame whose target has this light, as rendered."""
        numbers = self.history(number)
        frames = [self.inputs(one) for one in numbers]
        if light.shape != frames[-1].colour.shape:
            size, other = (f"{plane.shape[-1]}x{plane.shape[-2]}"
                           for plane in (frames[-1].colour, light))
            raise FrameError(f"{self.sequence.pattern}: frame {number} has {size} pixels, its "
                             f"target {other}: render both at the same size")
        follows = [one != before and self.continues(one)
                   for before, one in pairwise([numbers[0], *numbers])]
        exposure = self._exposures[number]
        return Example(number, frames, follows, exposure, exposed(light, exposure), known)

    def history(self, number: int) -> list[int]:
        """Numbers of a frame and of those before it, the oldest first. All examples have equally
        many: the oldest one is repeated where the shot begins."""
        numbers = [*self.sequence.before(number, FRAMES_BEFORE), number]
        return numbers[:1] * (FRAMES_BEFORE + 1 - len(numbers)) + numbers


def exposed(light: Tensor, exposure: float) -> Tensor:
    """Light as networks read it."""
    return (torch.nan_to_num(light).clamp(min=0) * exposure).clamp(max=BRIGHTEST)


def targets_of(reader: Reader, target: Sequence) -> list[Example]:
    """Examples whose targets are another sequence's frames of the same numbers."""
    shot, found = reader.sequence, []
    numbers = [one for one in shot.numbers if target.holds(one)]
    for number in choose_targets(numbers, reader.pixels()):
        with target.open(number) as files:
            has_counts = Role.SAMPLE_COUNT in files.layout.planes
        held = target.read(number, [Role.COLOUR, *[Role.SAMPLE_COUNT] * has_counts])
        colour = reader.inputs(number).colour
        own, known = colour[0].permute(1, 2, 0).cpu().numpy(), known_pixels(held)
        if is_same_render(held[Role.COLOUR], own):
            raise FrameError(f"{held.source}: is the same render as its frame of {shot.pattern}, "
                             "noise included: give another render of it")
        if (held[Role.COLOUR].shape == own.shape
            and is_other_picture(squares_of(held[Role.COLOUR], known > 0), squares_of(own))):
            raise FrameError(f"{held.source}: shows another picture than its frame of "
                             f"{shot.pattern}: give renders of the same shot, numbered alike")
        device = colour.device
        light = as_planes(held[Role.COLOUR], device)
        known = as_planes(known[..., None], device)
        found.append(reader.example(number, light, known))
    if not found:
        raise OptionError(f"{target.pattern}: has none of the frames {shot.pattern}: number them "
                          "alike")
    return found


def choose_targets(numbers: list[int], pixels: int) -> list[int]:
    """As many frames as fit into memory with their history, evenly over the shot. pixels: of a
    frame."""
    count = max(round(MOST_READ_PX / (pixels * (FRAMES_BEFORE + 1))), KEPT)
    if len(numbers) <= count:
        return numbers
    places = np.linspace(0, len(numbers) - 1, count).round().astype(int)
    return [numbers[place] for place in places]


def read_examples(arguments: argparse.Namespace, blanks_volumes: bool,
                  device: torch.device) -> list[Example]:
    """The examples of a shot; of two renders, those of each with the other as the target."""
    values = TUNE.values_for("sequence", arguments)
    shot = read_sequence(
        arguments.input, arguments.frames, arguments.profile, motion="auto", **values).first_view()
    other = read_sequence(
        arguments.references or arguments.halves, profile=arguments.profile, motion="auto",
        **values)
    first = shot.read(shot.numbers[0])
    spread = find_stddev(first[Role.COLOUR], first.planes)
    if arguments.model == "xl" and spread:
        raise OptionError(f"{shot.pattern}: the renderer's pixel filter spreads noise over several "
                          "pixels, as xl never sees it: render with a box filter, or give "
                          "--model m")
    reader = Reader(shot, blanks_volumes, device)
    found = targets_of(reader, other)
    if arguments.halves:
        second = Reader(other.first_view(), blanks_volumes, device)
        opposite = targets_of(second, shot)
        if not spread:  # noise of neighbours that belongs together must stay together
            add_twins(found, reader, second)
            add_twins(opposite, second, reader)
        found += opposite
    return found


def add_twins(examples: list[Example], reader: Reader, other: Reader) -> None:
    """Give examples of one render the same frames of the other one, if that has all of them. A
    pixel then counts if it is finite in both."""
    for one in examples:
        numbers = other.history(one.number)
        if numbers == reader.history(one.number):
            one.twins = [other.inputs(number) for number in numbers]
            one.known = one.known * one.frames[-1].colour.isfinite().all(1, keepdim=True)


def known_pixels(target: Frame) -> np.ndarray:
    """1 where a target counts, else 0, (height, width) float32: finite, with at least half of the
    most samples."""
    known = np.isfinite(target[Role.COLOUR]).all(axis=2)
    if Role.SAMPLE_COUNT in target:
        counts = target[Role.SAMPLE_COUNT][:, :, 0]
        known &= (counts > 0) & (counts >= counts.max() / 2)
    return known.astype(np.float32)


def cut(inputs: Inputs, rows: slice, columns: slice, exposure: float) -> Inputs:
    """A window of a frame, exposed."""
    planes = {name: getattr(inputs, name)[..., rows, columns] for name in ABSENT}
    colour = exposed(inputs.colour[..., rows, columns], exposure)
    return Inputs(colour=colour, **planes, jitter=inputs.jitter)


def stack(frames: list[Inputs]) -> Inputs:
    """Windows of one size as a batch."""
    names = ("colour", *ABSENT, "jitter")
    return Inputs(**{name: torch.cat([getattr(one, name) for one in frames]) for name in names})


class Split:
    """Examples of a shot, split into those to train on and those that are held back.

    Attributes:
        seen: to train on.
        held: held back.
    """

    def __init__(self, examples: list[Example]) -> None:
        examples = [one for one in examples if one.known.any()]
        if not examples:
            raise FrameError("no pixel of the targets counts: all have no samples or are not "
                             "finite")
        numbers = sorted({one.number for one in examples})
        self._by_frame = len(numbers) >= KEPT
        back = set(numbers[KEPT // 2::KEPT]) if self._by_frame else set(numbers)
        # windows of what is trained on end where held columns begin
        limits = [one.known.shape[-1] if self._by_frame else _held_column(one)
                  for one in examples]
        pairs = list(zip(examples, limits, strict=True))
        self.held = [replace(one, known=self._part(one, limit, held=True))
                     for one, limit in pairs if one.number in back]
        seen = [pair for pair in pairs if not self._by_frame or pair[0].number not in back]
        self.seen = [replace(one, known=self._part(one, limit, held=False)) for one, limit in seen]
        if not any(one.known.any() for one in self.held):
            raise FrameError("the pixels of the targets that count are too few, or lie in too few "
                             "columns, to hold a quarter back: give more clean tiles or frames")
        self._limits = [limit for _, limit in seen]
        self._places = [torch.nonzero(one.known[0, 0]).cpu() for one in self.seen]
        is_sparse = sum(float(one.known.mean()) for one in self.seen) < SPARSE * len(self.seen)
        self._window, self._batch = ((WINDOW_PX // 2, BATCH * 4) if is_sparse
                                     else (WINDOW_PX, BATCH))

    def _part(self, example: Example, limit: int, held: bool) -> Tensor:
        """An example's `known`, for the pixels that are held back or for the others."""
        if self._by_frame:
            return example.known
        columns = torch.arange(example.known.shape[-1], device=example.known.device)
        return example.known * ((columns >= limit) == held)

    def draw(self, generator: random.Random) -> Windows:
        """A batch of windows to train on, around random pixels that count."""
        chosen = [generator.randrange(len(self.seen)) for _ in range(self._batch)]
        return windows_of([(self.seen[one], self._places[one], self._limits[one])
                           for one in chosen], self._window, generator, swaps=True)

    def held_windows(self) -> list[Windows]:
        """Windows around random pixels that are held back, the same in every call."""
        count = HELD_WINDOWS[self.held[0].target.device.type]
        generator = random.Random(0)
        places = [torch.nonzero(one.known[0, 0]).cpu() for one in self.held]
        return [windows_of([(self.held[one], places[one], self.held[one].known.shape[-1])],
                           self._window, generator)
                for one in (number % len(self.held) for number in range(count))
                if len(places[one])]


def _held_column(example: Example) -> int:
    """The first column that is held back, where columns are."""
    filled = torch.nonzero(example.known[0, 0])[:, 1].sort().values
    return int(filled[len(filled) - len(filled) // KEPT - 1]) + 1


def windows_of(sources: list[tuple[Example, Tensor, int]], most_side: int,
               generator: random.Random, swaps: bool = False) -> Windows:
    """A window of each example.

    Args:
        sources: examples, each with places (P, 2) and a column: the window lies around one of the
            places and to the left of the column.
        most_side: side of the windows, unless examples are smaller.
        swaps: whether pixels are swapped between the two renders, if all examples have both.
    """
    side = min(most_side, *(min(one.known.shape[-2], limit) for one, _, limit in sources))
    cuts: list[tuple[Example, slice, slice]] = []
    for one, places, limit in sources:
        spot = places[generator.randrange(len(places))].tolist()
        top, left = (min(max(at - generator.randrange(side), 0), most - side)
                     for at, most in zip(spot, (one.known.shape[-2], limit), strict=True))
        cuts.append((one, slice(top, top + side), slice(left, left + side)))
    device = sources[0][0].target.device
    times = range(FRAMES_BEFORE + 1)
    frames = [stack([cut(one.frames[time], rows, columns, one.exposure)
                     for one, rows, columns in cuts]) for time in times]
    follows = [torch.tensor([float(one.follows[time]) for one, _, _ in cuts],
                            device=device)[:, None, None, None] for time in times]
    target = torch.cat([one.target[..., rows, columns] for one, rows, columns in cuts])
    known = torch.cat([one.known[..., rows, columns] for one, rows, columns in cuts])
    if swaps and all(one.twins for one, _, _ in cuts):
        twins = [stack([cut(one.twins[time], rows, columns, one.exposure)
                        for one, rows, columns in cuts]) for time in times]
        frames, target = swap_pixels(frames, twins)
    return Windows(frames, follows, target, known)


def swap_pixels(frames: list[Inputs], twins: list[Inputs]) -> tuple[list[Inputs], Tensor]:
    """Frames that take each pixel, with all its planes, from either of two renders at random; and
    the light of the last frame's pixels that were not taken, which is the target."""
    mixed = []
    for own, other in zip(frames, twins, strict=True):
        kept = torch.rand_like(own.colour[:, :1]) < 0.5
        planes = {name: torch.where(kept, getattr(own, name), getattr(other, name))
                  for name in ("colour", *ABSENT)}
        mixed.append(Inputs(**planes, jitter=own.jitter))
    return mixed, torch.where(kept, other.colour, own.colour)
