"""What the frames after a frame make of it: the denoiser run over the sequence in reverse order, part by part."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from functools import cached_property, partial
from typing import Any, NamedTuple

import numpy as np
from postfx.backwards.run_up import FRAMES as RUN_UP
from postfx.backwards.turned import MOST, Followed, turned
from postfx.kernels.turning import shared, weighted

from postfx.errors import PostfxError
from postfx.exposure import ExposureMeter, SmoothExposure
from postfx.frame import Frame, FrameSpec, GuideSpec, Role
from postfx.io.prefetch import read_ahead, read_patiently
from postfx.io.sequence import Sequence
from postfx.passes.denoise_upscale import DenoiseUpscale
from postfx.pipeline import Pipeline
from postfx.plan import Plan
from postfx.runtime import Device

PART = 32
"""Frames that are looked at backwards at once; their results are kept until they are asked for."""

LARGEST = np.float32(65504)
"""What half precision holds."""


class Result(NamedTuple):
    """Of a frame in reverse order: its exposed colour (H, W, 3) in half precision, how far ahead its pixels are known,
    and the exposure, without which bright light would not fit."""

    colour: np.ndarray
    count: np.ndarray
    exposure: float


class Backwards:
    """Call it with the frames of a sequence in order: they come back with the plane `later`, for the pass `both_ways`.

        shot = postfx.read_sequence("shot/noisy.####.exr")
        later = postfx.Backwards(shot, device)
        passes = postfx.Pipeline([postfx.DenoiseUpscale(), postfx.BothWays()], device)
        for frame in shot:
            postfx.write_frame(f"out/clean.{frame.number:04d}.exr", passes(later(frame)))

    Args:
        sequence: the frames; they are read once more by a copy, so who iterates it is not disturbed.
        device: where to run; default: that of pipelines without one.
        exposure, cuts: as for a `Pipeline`.
        prepare: what is done to the frames that are read before they are run, as to those in order.
        options: of `DenoiseUpscale`, the same as for the frames in order.

    The sequence is run in parts of PART frames, each from its last one to its first, beginning a run-up after it, also
    where the sequence ends and there are more frames on the disk. Frames that cannot be read are no error here.

    Attributes:
        milliseconds: what the last frame took on the device in reverse order; None where that was not needed.
    """

    def __init__(self, sequence: Sequence, device: Device | None = None,
                 exposure: str | float | ExposureMeter | SmoothExposure = "auto", cuts: str = "auto",
                 prepare: Callable[[Frame], Frame] = lambda frame: frame, **options: Any) -> None:
        after = sequence.after(sequence.numbers[-1], RUN_UP) if sequence.numbers else ()
        self._given, self._numbers, self._asked = sequence, (*sequence.numbers, *after), len(sequence)
        self._at = {number: index for index, number in enumerate(sequence.numbers)}
        self._pass = DenoiseUpscale(**options)
        self._pipeline = Pipeline([self._pass], device, exposure, cuts)
        self._prepare = prepare
        self._ahead, self._last = Followed(find_cuts=cuts == "auto"), -1
        self._plan: Plan | None = None
        self._found: dict[int, Result] = {}
        self._took: dict[int, float] = {}
        self.milliseconds: float | None = None

    def spec(self, spec: FrameSpec) -> FrameSpec:
        """What frames of a spec become."""
        output, guides = self._pass.reflect(spec).output, spec.guide_roles
        source = spec.guides.source if spec.guides else None
        return dataclasses.replace(spec, guides=GuideSpec(output.width, output.height, (*guides, Role.LATER), source))

    def reset(self) -> None:
        """Forget all that was found: the next frame may be any."""
        self._ahead.reset()
        self._last, self._found = -1, {}

    def part(self, number: int) -> tuple[int, int] | None:
        """First and last number of the frames that have to be run before this one; None where it is there already."""
        if number in self._found or number not in self._at:
            return None
        return number, self._numbers[self._ends(self._at[number])[1] - 1]

    def __call__(self, frame: Frame, wanted: bool = True, check: Callable[[], None] = lambda: None) -> Frame:
        """The frame with the plane `later` among its guides: 0 everywhere where it is not `wanted`, so that it is only
        followed. `check` is called between two frames in reverse order, and may raise."""
        output = self.spec(frame.spec).guides
        later = np.zeros((output.height, output.width, 4), np.float32)
        self.milliseconds = None
        if frame.number in self._at:
            ahead = self._known_ahead(frame)
            result = self._result(frame.number, check) if wanted else None
            if result and result.count.shape == ahead.shape and result.colour.shape[:2] == later.shape[:2]:
                share = np.empty(ahead.shape, np.float32)
                shared(ahead, result.count, share)
                weighted(share, result.colour.astype(np.float32) / np.float32(result.exposure), later)
        return dataclasses.replace(frame, guides={**frame.guides, Role.LATER: later})

    def _known_ahead(self, frame: Frame) -> np.ndarray:
        """How many frames up to this one show its pixels; those before are read again where they were not seen."""
        index = self._at[frame.number]
        if index != self._last + 1:
            self._ahead.reset()
            for earlier in range(max(0, index - MOST), index):
                self._follow(self._read(earlier))
        self._last = index
        return self._ahead(frame)

    @cached_property
    def _sequence(self) -> Sequence:
        """A reader, made when frames in order are read: by then it is known how, and of which area."""
        return self._given.reader()

    def _follow(self, frame: Frame | None) -> None:
        if frame is None:
            self._ahead.reset()
        else:
            self._ahead(frame)

    def _result(self, number: int, check: Callable[[], None]) -> Result | None:
        if number not in self._found:
            self._run(self._at[number], check)
        self.milliseconds = self._took.pop(number, None)
        return self._found.pop(number, None)

    def _ends(self, index: int) -> tuple[int, int]:
        """Where a frame's part ends, and where its run begins."""
        end = min((index // PART + 1) * PART, self._asked)
        return end, min(end + RUN_UP, len(self._numbers))

    def _run(self, first: int, check: Callable[[], None]) -> None:
        """Run a part from behind, down to a frame."""
        end, begin = self._ends(first)
        self._found, self._took, back, after = {}, {}, Followed(), None
        self._pipeline.reset()
        for index, frame in read_ahead(range(begin - 1, first - 1, -1), self._read):
            check()
            if frame is not None:
                reverse = turned(frame, after)
                colour = self._colour(reverse)
                count = back(dataclasses.replace(reverse, reset=reverse.reset or self._pipeline.cut))
                if index < end and colour is not None:
                    self._found[frame.number] = Result(colour, count, self._pipeline.exposure)
                    self._took[frame.number] = sum(self._pipeline.timings.values())
            after = frame

    def _colour(self, frame: Frame) -> np.ndarray | None:
        try:
            colour = self._pipeline(frame)[Role.COLOUR]
        except PostfxError:
            return None
        return np.clip(colour * np.float32(self._pipeline.exposure), -LARGEST, LARGEST).astype(np.float16)

    def _explained(self, number: int) -> Plan:
        with self._sequence.open(number) as files:
            return self._pipeline.explain(files.spec())

    def _read(self, index: int) -> Frame | None:
        """A frame, marked where it does not follow the one before it; None where it cannot be read."""
        number = self._numbers[index]
        try:
            self._plan = self._plan or self._explained(number)
            self._sequence.rewind()
            read = partial(self._sequence.read, number, self._plan.planes, self._plan.guides)
            frame = self._prepare(read_patiently(read))
        except PostfxError:
            return None
        follows = index > 0 and self._sequence.before(number, 1) == [self._numbers[index - 1]]
        frame.reset = frame.reset or not follows
        return frame
