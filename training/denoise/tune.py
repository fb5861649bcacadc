"""Adapt a network to a shot, from a few clean frames or from two independent renders: see
`postfx tune --help`.

    python -m training.denoise.tune SHOT --references REF -o shot.onnx --minutes 10
    python -m training.denoise.tune SHOT --halves OTHER -o shot.onnx

It trains at the render's size on windows of a few frames, whose history the recurrent step makes as
in the product; the last frame's target is a reference, or the other render. Noise of a target
averages out, as in Noise2Noise (Lehtinen et al., 2018), where errors of linear light are squared.
They are weighed by the slope of the display curve at the result, so that they are errors of what is
seen. From two renders, each window takes every pixel of one of them at random, and the target takes
it of the other: so a network never sees the same noise twice, and hardly learns it by heart.

References may hold tiles only: with a plane of sample counts, pixels with less than half of the
most samples do not count. Where such tiles are small, windows are smaller, and there are more of
them.

A quarter is held back: frames where four or more have a target, else the right quarter of the
pixels that count. Now and then a mixture of old and new weights is measured there, and the best one
counts. If it does not gain, nothing is written.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import sys
import time
from contextlib import redirect_stdout
from dataclasses import dataclass, field, replace
from io import StringIO
from itertools import pairwise
from pathlib import Path
from warnings import catch_warnings, simplefilter

import numpy as np
import torch
from torch import Tensor

from postfx.cli.options import Parser
from postfx.cli.tune import DESCRIPTION, TUNE
from postfx.errors import FrameError, OptionError, PostfxError
from postfx.exposure import ExposureMeter
from postfx.frame import ROLES, Frame, Role
from postfx.io.sequence import Sequence, read_sequence
from postfx.other_shots import is_other_picture, squares_of
from postfx.passes.denoise.planes import shows_volume
from postfx.pixel_filter import find_stddev
from postfx.repeats import is_same_render
from postfx.system import usable_cores
from training.denoise.checkpoint import PREFIX, load_weights
from training.denoise.dataset import ABSENT
from training.denoise.export import card, export_trunk, load_trunk
from training.denoise.loss import ERROR, LIGHT, display, error_loss, frame_loss, light_loss
from training.denoise.model import DenoiseUpscale, Inputs, Step, empty_state
from training.denoise.picture import PictureDenoiser
from training.export import MODELS, write_card

Denoiser = DenoiseUpscale | PictureDenoiser

FROZEN = ("judge", "controls", "gate", "error")
"""Layers of a network that gives the picture that stay as they are: they say how much of the
history counts, and a few frames say too little about that."""
RATE = 3e-4
"""Highest learning rate."""
WARM_STEPS = 10
"""Over which the learning rate rises."""
FRAMES_BEFORE = 2
"""Frames of history that an example has, where the shot has them."""
FRAMES_WITH_GRADIENT = 2
"""Last frames of an example through which gradients flow."""
MOST_READ_PX = 64e6
"""Pixels of the frames that are held of a sequence, each some 100 bytes, where that leaves as many
targets as are split by frames."""
WINDOW_PX = 128
BATCH = 4
"""Windows a step."""
SPARSE = 0.25
"""Share of the pixels that count below which windows have half the side, and there are four times
as many."""
LOOKS = 20
"""Times that a training is measured on what was held back, at most."""
LOOKING_SHARE = 0.1
"""Of the time that measuring may take."""
HELD_WINDOWS = {"cuda": 48, "cpu": 12}
"""Windows on which it is measured, by device."""
SHARES = (0.5, 0.25)
"""Of the new weights in the mixtures with the old ones that are tried; the first one is measured
during the training. New weights alone fit the noise of what they learn from."""
LEAST_SHARE = 0.05
"""Of an error that is taken as the network's own, where noise of targets seems to be all of it."""
LEAST_SURE = 1.0
"""Standard errors by which a gain must be above 0 for a network to be written."""
KEPT = 4
"""One frame, or one column of a picture, in so many is held back."""
BRIGHTEST = 1e4
"""Exposed light that is cut."""
DARKEST = 1e-3
"""Exposed light from which the slope of the display curve is as there."""


@dataclass
class Example:
    """A frame with a target, and the frames before it.

    frames: the oldest first, light as rendered, one picture each.
    follows: of each, whether the history goes on there.
    exposure: factor of the light of all frames; the target is exposed.
    known: 1 where the target counts, else 0, (1, 1, height, width).
    twins: the same frames of the other render, the last of which is the target; empty where pixels
        cannot be swapped.
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
    """A batch of windows: frames, the oldest first, with light exposed; where the history goes on,
    (N, 1, 1, 1) each; targets and what of them counts."""

    frames: list[Inputs]
    follows: list[Tensor]
    target: Tensor
    known: Tensor


def inputs_of(frame: Frame, blanks_volumes: bool, device: torch.device) -> Inputs:
    """A frame as the product gives it to the network, but for the exposure of its light.

    blanks_volumes: whether it hides depth and albedo where these are noise.
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
        """A frame and those before it, the oldest first: all examples have as many frames, so the
        oldest one again where the shot lacks some."""
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
        own = colour[0].permute(1, 2, 0).cpu().numpy()
        if is_same_render(held[Role.COLOUR], own):
            raise FrameError(f"{held.source}: is the same render as its frame of {shot.pattern}, "
                             "noise included: give another render of it")
        if (held[Role.COLOUR].shape == own.shape
            and is_other_picture(squares_of(held[Role.COLOUR]), squares_of(own))):
            raise FrameError(f"{held.source}: shows another picture than its frame of "
                             f"{shot.pattern}: give renders of the same shot, numbered alike")
        device = colour.device
        light = as_planes(held[Role.COLOUR], device)
        known = as_planes(known_pixels(held)[..., None], device)
        found.append(reader.example(number, light, known))
    if not found:
        raise OptionError(f"{target.pattern}: has none of the frames {shot.pattern}: number them "
                          "alike")
    return found


def choose_targets(numbers: list[int], pixels: int) -> list[int]:
    """Frames of so many pixels, evenly over the shot, that fit into memory with their history."""
    count = max(round(MOST_READ_PX / (pixels * (FRAMES_BEFORE + 1))), KEPT)
    if len(numbers) <= count:
        return numbers
    places = np.linspace(0, len(numbers) - 1, count).round().astype(int)
    return [numbers[place] for place in places]


def read_examples(arguments: argparse.Namespace, blanks_volumes: bool,
                  device: torch.device) -> list[Example]:
    """The examples of a shot; with another render, also those of that one."""
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
    """Give examples of one render the same frames of the other one, where that has all of them.
    Then a pixel counts where it is finite in both."""
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


def run(model: Denoiser, windows: Windows) -> Step:
    """The last frames of windows, with what came before them as the history."""
    first = windows.frames[0]
    state = empty_state(first, *first.colour.shape[-2:])
    pairs = list(zip(windows.frames, windows.follows, strict=True))
    with torch.no_grad():
        for inputs, follows in pairs[:-FRAMES_WITH_GRADIENT]:
            state = model.step(inputs, state.drop(follows)).state
    for inputs, follows in pairs[-FRAMES_WITH_GRADIENT:]:
        step = model.step(inputs, state.drop(follows))
        state = step.state
    return step


def loss_of(step: Step, target: Tensor, known: Tensor, is_noisy: bool) -> Tensor:
    """The loss of a batch, as if all of it were known."""
    share = known.mean().clamp(min=1e-3)
    result = step.output
    if is_noisy:
        return (seen_error(result, target, result.detach()) * known).mean() / share
    target = torch.where(known > 0, target, result.detach())
    ones = torch.ones(len(result), 1, 1, 1, device=result.device)
    found = (frame_loss(display(result), display(target), ones)
             + LIGHT[0] * light_loss(result, target, LIGHT[1]))
    if step.error is not None:
        predicted = torch.where(known > 0, step.error, step.error.detach())
        found = found + ERROR * error_loss(predicted, display(result), display(target))
    return found / share


def seen_error(result: Tensor, target: Tensor, at: Tensor) -> Tensor:
    """Squared error of light times the squared slope of the display curve ``at`` some light: the
    squared error of what is seen, whose mean does not change with a target's noise."""
    return ((result - target) * display_slope(at)).square()


def display_slope(light: Tensor) -> Tensor:
    """The derivative of `display`: of x / (1 + x), and of the sRGB curve (IEC 61966-2-1)."""
    light = light.clamp(min=DARKEST)
    shown = light / (1 + light)
    coded = torch.where(shown <= 0.0031308, 12.92, 1.055 / 2.4 * shown ** (1 / 2.4 - 1))
    return coded / (1 + light).square()


class Split:
    """Examples: what is trained on, and what is held back."""

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
        """What is known of the pixels that are held back, or of the others."""
        if self._by_frame:
            return example.known
        columns = torch.arange(example.known.shape[-1], device=example.known.device)
        return example.known * ((columns >= limit) == held)

    def draw(self, generator: random.Random) -> Windows:
        """Windows around random pixels that count."""
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
    """A window of each example around one of its places (P, 2), to the left of a column.

    swaps: whether pixels are swapped between the two renders, where all examples have both.
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
    """Frames with each pixel of one of two renders at random, all of its planes together; and the
    light of what the last frame has of neither."""
    mixed = []
    for own, other in zip(frames, twins, strict=True):
        kept = torch.rand_like(own.colour[:, :1]) < 0.5
        planes = {name: torch.where(kept, getattr(own, name), getattr(other, name))
                  for name in ("colour", *ABSENT)}
        mixed.append(Inputs(**planes, jitter=own.jitter))
    return mixed, torch.where(kept, other.colour, own.colour)


@dataclass(frozen=True)
class Score:
    """A network's error in pixels that are held back, without the noise of targets.

    gain_db: over the network that training began with.
    sure: the gain in squared error over its standard error.
    """

    gain_db: float
    sure: float


class Measure:
    """Compares networks with the first one, by squared errors of what is seen, in windows that are
    held back."""

    def __init__(self, split: Split, model: Denoiser, is_noisy: bool) -> None:
        self._windows, self._is_noisy = split.held_windows(), is_noisy
        self._at = self._results(model)
        self._first = self._errors(self._at)
        first = float(self._first.mean())
        self._before = max(first - self._noise(), LEAST_SHARE * first)

    def __call__(self, model: Denoiser) -> Score:
        change = self._first - self._errors(self._results(model))
        spread = float(change.std(ddof=1)) / len(change) ** 0.5 if len(change) > 1 else np.inf
        mean = float(change.mean())
        gain = -10 * np.log10(max(1 - mean / self._before, LEAST_SHARE))
        return Score(float(gain), mean / max(spread, 1e-12))

    @torch.no_grad()
    def _results(self, model: Denoiser) -> list[Tensor]:
        """What a network makes of each window."""
        return [run(model, one).output for one in self._windows]

    def _errors(self, results: list[Tensor]) -> np.ndarray:
        """The error of each window's result."""
        errors = []
        for one, light, result in zip(self._windows, self._at, results, strict=True):
            squared = (seen_error(result, one.target, light) if self._is_noisy
                       else (display(result) - display(one.target)).square())
            errors.append(_mean(squared, one.known))
        return np.array(errors)

    def _noise(self) -> float:
        """The squared error of noisy targets: half of their squared difference from the frames,
        which have as much noise of their own."""
        if not self._is_noisy:
            return 0.0
        return float(np.mean([
            _mean(0.5 * seen_error(one.frames[-1].colour, one.target, light), one.known)
            for one, light in zip(self._windows, self._at, strict=True)]))


def _mean(squared: Tensor, known: Tensor) -> float:
    """The mean of what counts."""
    return float((squared.mean(1, keepdim=True) * known).sum() / known.sum().clamp(min=1))


class Clock:
    """How much of a training is over: by steps, or by minutes."""

    def __init__(self, minutes: float, steps: int | None) -> None:
        self._minutes, self._steps = minutes, steps
        self._began = time.monotonic()

    def seconds(self) -> float:
        return time.monotonic() - self._began

    def passed(self, step: int) -> float:
        """From 0 to 1 and above."""
        return step / self._steps if self._steps else self.seconds() / 60 / self._minutes


@dataclass(frozen=True)
class Trained:
    """What a training gave: the new weights that were best on what was held back, in a mixture with
    the old ones, and its steps and minutes."""

    weights: dict[str, Tensor]
    steps: int
    minutes: float


def train(model: Denoiser, split: Split, measure: Measure,
          arguments: argparse.Namespace) -> Trained:
    """Train; now and then a mixture of old and new weights is measured."""
    generator = random.Random(arguments.seed)
    start = weights_of(model)
    device = next(model.parameters()).device
    learnt = [weight for weight in model.parameters() if weight.requires_grad]
    optimiser = torch.optim.AdamW(learnt, lr=0.0, betas=(0.9, 0.99), weight_decay=1e-4)
    clock, step = Clock(arguments.minutes, arguments.steps), 0
    best, best_gain = start, -np.inf
    next_look, looking = 1 / LOOKS, 0.0
    while (passed := clock.passed(step)) < 1:
        for rates in optimiser.param_groups:
            rise = min((step + 1) / WARM_STEPS, 1)
            rates["lr"] = RATE * rise * 0.5 * (1 + np.cos(np.pi * passed))
        windows = split.draw(generator)
        with torch.autocast(device.type, torch.bfloat16, enabled=device.type == "cuda"):
            done = run(model, windows)
        loss = loss_of(done, windows.target, windows.known, bool(arguments.halves))
        optimiser.zero_grad()
        loss.backward()
        norm = torch.nn.utils.clip_grad_norm_(learnt, 1.0)
        if torch.isfinite(norm):
            optimiser.step()
        step += 1
        passed = clock.passed(step)
        if passed < 1 and (passed < next_look or looking > LOOKING_SHARE * clock.seconds()):
            continue
        began = clock.seconds()
        now = weights_of(model)
        model.load_state_dict(mixture(start, now, SHARES[0]))
        gain = measure(model).gain_db
        model.load_state_dict(now)
        looking += clock.seconds() - began
        next_look = passed + 1 / LOOKS
        if gain > best_gain:
            best, best_gain = now, gain
        print(f"step {step}, {clock.seconds():.0f} s, loss {loss.item():.4f}, held back "
              f"{gain:+.2f} dB", file=sys.stderr, flush=True)
    return Trained(best, step, clock.seconds() / 60)


def weights_of(model: Denoiser) -> dict[str, Tensor]:
    """A copy of the weights."""
    return {name: value.detach().clone() for name, value in model.state_dict().items()}


def load_model(tag: str) -> tuple[Denoiser, dict[str, object]]:
    """A shipped network for the render's size, and its layout."""
    path = start_path(tag)
    config = json.loads(path.with_suffix(".json").read_text())["config"]
    trunk = load_trunk({"config": config, "weights": load_weights(path)}).train()
    model = PictureDenoiser(trunk) if config.get("picture") else DenoiseUpscale(trunk=trunk)
    for name, weight in model.named_parameters():
        weight.requires_grad_(not name.removeprefix(PREFIX).startswith(FROZEN))
    return model, config


def start_path(tag: str) -> Path:
    return MODELS / f"denoise_upscale.{tag}.1x.onnx"


def tune(arguments: argparse.Namespace) -> dict[str, object]:
    """Train and, where there is a gain, write; returns what became of it."""
    torch.manual_seed(arguments.seed)
    device = choose_device(arguments.device)
    # where cores are busy, threads that wait for each other take ten times as long
    free = int(usable_cores() - os.getloadavg()[0]) if device.type == "cpu" else 1
    torch.set_num_threads(max(1, free))
    model, config = load_model(arguments.model)
    model = model.to(device)
    split = Split(read_examples(arguments, not config.get("picture"), device))
    measure = Measure(split, model, bool(arguments.halves))
    start = weights_of(model)
    trained = train(model, split, measure, arguments)
    scores = {}
    for share in SHARES:
        model.load_state_dict(mixture(start, trained.weights, share))
        scores[share] = measure(model)
    share = max(scores, key=lambda one: scores[one].gain_db)
    score = scores[share]
    gains = score.sure >= LEAST_SURE
    facts: dict[str, object] = {
        "steps": trained.steps, "minutes": round(trained.minutes, 2), "device": device.type,
        "examples": len(split.seen), "held_back": len(split.held),
        "target": "halves" if arguments.halves else "references", "share": share,
        "gain_db": round(score.gain_db, 3), "sure": round(score.sure, 1),
        "start": start_path(arguments.model).stem, "written": arguments.output if gains else "",
    }
    if gains:
        mixed = mixture(start, trained.weights, share)
        weights = {name: value.cpu() for name, value in mixed.items()}
        write({"config": config, "weights": weights, "notes": facts}, Path(arguments.output))
    return facts


def choose_device(name: str) -> torch.device:
    """The device of --device. Raises OptionError where it is not there."""
    if name == "cuda" and not torch.cuda.is_available():
        raise OptionError("--device cuda: PyTorch finds no GPU here: take --device cpu, or install "
                          "a build of PyTorch for CUDA")
    uses_gpu = name == "cuda" or (name == "auto" and torch.cuda.is_available())
    return torch.device("cuda" if uses_gpu else "cpu")


def mixture(start: dict[str, Tensor], tuned: dict[str, Tensor], share: float) -> dict[str, Tensor]:
    """Weights between the old ones and the new ones."""
    return {name: torch.lerp(start[name], tuned[name], share) for name in start}


def write(checkpoint: dict[str, object], path: Path) -> None:
    """Write the network and its card."""
    path.parent.mkdir(parents=True, exist_ok=True)
    notes = {key: value for key, value in checkpoint["notes"].items() if key != "written"}  # type: ignore[attr-defined]
    with redirect_stdout(StringIO()), catch_warnings():  # PyTorch tells its own steps
        simplefilter("ignore", FutureWarning)
        difference = export_trunk(load_trunk(checkpoint), path)
    made = card({**checkpoint, "notes": notes}, path.stem, difference, {})
    made |= {"name": path.stem,
             "summary": "recurrent denoised upscaler, tuned to one shot, for its own size"}
    made["training"]["script"] = "training/denoise/tune.py"
    write_card(path, made)


def main() -> int:
    parser = Parser(prog="postfx tune", description=DESCRIPTION,
                    formatter_class=argparse.RawDescriptionHelpFormatter)
    TUNE.add_to(parser)
    arguments = parser.parse_args()
    try:
        facts = tune(arguments)
    except PostfxError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    gained = f"{facts['gain_db']:+.2f} dB on what was held back, after {facts['steps']} steps"
    words = (f"wrote    {arguments.output}: {gained}" if facts["written"]
             else f"no gain  {gained}: nothing is written")
    print(json.dumps(facts) if arguments.json else words)
    return 0 if facts["written"] else 1


if __name__ == "__main__":
    sys.exit(main())
