"""Runs frames in reverse order: before the first frame of a shot (`RunUp`), or over all of it
(`Backwards`)."""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import takewhile
from typing import Any

import numpy as np

from postfx.cuts import CutDetector
from postfx.errors import PostfxError, SequenceError
from postfx.exposure import ExposureMeter, SmoothExposure
from postfx.files import read_ahead, read_patiently
from postfx.frame import Frame, FrameSpec, GuideSpec, Role
from postfx.io.sequence import Sequence
from postfx.passes.denoise import DenoiseUpscale
from postfx.pipeline import Pipeline
from postfx.plan import Plan
from postfx.planes import LARGEST_HALF
from postfx.runtime import Device
from postfx.temporal.mirrored import mirror, mirror_plane
from postfx.temporal.reverse_motion import (
    LONGEST_HISTORY_FRAMES,
    HistoryLength,
    premultiply,
    reverse_motion,
    share_by_length,
)

RUN_UP = 8
"""Frames of a run-up. With half as many, some frames after the first come out worse than without a
run-up."""
PART_FRAMES = 32
"""Frames of a part, which run in reverse order together; their results are kept until they are
needed."""


class RunUp:
    """Gives a `Pipeline` a history at the first frame of each shot, which would be the noisiest
    without it.

        shot = postfx.read_sequence("shot/noisy.####.exr")
        passes = postfx.Pipeline([postfx.DenoiseUpscale()], run_up=postfx.RunUp(shot))
        for frame in shot:
            postfx.write_frame(f"out/clean.{frame.number:04d}.exr", passes(frame))

    Args:
        sequence: the frames. A separate reader reads them again, so iterating the sequence is not
            disturbed.
        frames: how many frames after the first one to run, the last of them first. Fewer run if a
            gap, a broken file or another shot comes sooner; none if `sequence.numbers` skips the
            next frame, unless `over_gaps`.
        cuts: as for the `Pipeline`.
        prepare: applied to frames after reading, as for the frames in order.
        view: of stereo files, the view whose frames run; None for the first.
        over_gaps: whether frames that `sequence.numbers` skips run, too, as they do where a run
            leads over gaps.

    Frames that cannot be read or run are skipped without an error; the frames between them and the
    first one still run.

    Attributes:
        on_frame: called before each frame of the run-up, with the number of the shot's first frame
            and its own; it may raise to end the run-up.
    """

    def __init__(self, sequence: Sequence, frames: int = RUN_UP, cuts: str = "auto",
                 prepare: Callable[[Frame], Frame] = lambda frame: frame,
                 view: str | None = None, over_gaps: bool = False) -> None:
        _check_is_sequence(sequence, "RunUp")
        self._over_gaps = over_gaps
        self._view = view
        self._sequence = sequence
        self._frames = frames
        self._find_cuts = cuts == "auto"
        self._prepare = prepare
        self.on_frame: Callable[[int, int], None] = lambda first, number: None
        is_one = len(sequence.numbers) == 1  # which skips none
        self._next = ({} if is_one
                      else dict(zip(sequence.numbers, (*sequence.numbers[1:], None), strict=True)))

    def of_view(self, view: str) -> RunUp:
        """This run-up for another view of the sequence."""
        found = copy.copy(self)
        found._view = view
        found.on_frame = lambda first, number: self.on_frame(first, number)
        return found

    def after(self, number: int) -> list[int]:
        """Numbers of the frames to run before this one, in sequence order, according to their
        headers."""
        found = self._sequence.after(number, self._frames)
        # frames before the range lead to it
        follows = found and (self._over_gaps or self._next.get(number, found[0]) == found[0])
        return (list(takewhile(partial(_continues_shot, self._sequence.reader(self._view)), found))
                if follows else [])

    def __call__(self, frame: Frame, run: Callable[[Frame], None]) -> Frame:
        """Run the frames after a first one in reverse order. Returns the first frame, ready to run
        after them."""
        numbers = self.after(frame.number)
        if not numbers:
            return frame
        detector = CutDetector() if self._find_cuts else None
        later: Frame | None = None
        for _, other in read_ahead(reversed(numbers),
                                   partial(self._read, self._sequence.reader(self._view), frame)):
            if other is not None:
                self.on_frame(frame.number, other.number)
            has_run = (other is not None
                       and _try_run(_mark_cut(reverse_motion(other, later), detector), run))
            later = other if has_run else None
        return _mark_cut(reverse_motion(frame, later), detector)

    def _read(self, sequence: Sequence, first: Frame, number: int) -> Frame | None:
        """A frame with the planes of the first one; None if it lacks them or cannot be read."""
        try:
            sequence.rewind()
            frame = self._prepare(read_patiently(partial(sequence.read, number, first.planes,
                                                         first.guides)))
        except PostfxError:
            return None
        return frame if frame.spec == first.spec else None


def _continues_shot(sequence: Sequence, number: int) -> bool:
    """Whether a frame can be read and does not begin a shot."""
    try:
        return not read_patiently(partial(sequence.begins_shot, number))
    except PostfxError:
        return False


def _mark_cut(frame: Frame, detector: CutDetector | None) -> Frame:
    """The frame, marked as a first one if it is unrelated to the one before."""
    is_cut = detector is not None and frame.encoding == "scene-linear" and detector(frame)
    return replace(frame, reset=True) if is_cut else frame


def _try_run(frame: Frame, run: Callable[[Frame], None]) -> bool:
    """Run a frame and say whether that worked."""
    try:
        run(frame)
    except PostfxError:
        return False
    return True


@dataclass(frozen=True)
class Result:
    """The result of one frame in reverse order.

    Attributes:
        colour: (H, W, 3) in half precision, exposed, because bright light would not fit half
            precision otherwise.
        length: (h, w), history length of each pixel in reverse order.
        exposure_factor: what the colour was multiplied by.
    """

    colour: np.ndarray
    length: np.ndarray
    exposure_factor: float


class Backwards:
    """Adds the plane `later`, which the pass `both_ways` reads, to the frames of a sequence. Call
    it on them in order.

        shot = postfx.read_sequence("shot/noisy.####.exr")
        later = postfx.Backwards(shot, device)
        passes = postfx.Pipeline([postfx.DenoiseUpscale(), postfx.BothWays()], device)
        for frame in shot:
            postfx.write_frame(f"out/clean.{frame.number:04d}.exr", passes(later(frame)))

    Args:
        sequence: the frames. A separate reader reads them again, so iterating the sequence is not
            disturbed.
        device: where to run; default: the default device of pipelines.
        exposure, cuts: as for a `Pipeline`.
        prepare: applied to frames after reading, as for the frames in order.
        wrap: as for a `Pipeline`.
        options: of `DenoiseUpscale`, the same as for the frames in order.

    The sequence runs in parts of PART_FRAMES frames, each from its last frame to its first, after a
    run-up over the frames after it. Frames of the run-up may lie beyond the end of the sequence,
    and in gaps of its numbers, if their files exist. Frames that cannot be read are skipped without
    an error. They run mirrored: the network errs otherwise then, so less is left of its errors when
    both directions are mixed.

    Attributes:
        milliseconds: device time of the last frame in reverse order; None if it did not have to
            run.
    """

    def __init__(self, sequence: Sequence, device: Device | None = None,
                 exposure: str | float | ExposureMeter | SmoothExposure = "auto",
                 cuts: str = "auto", prepare: Callable[[Frame], Frame] = lambda frame: frame,
                 wrap: str = "auto", **options: Any) -> None:
        _check_is_sequence(sequence, "Backwards")
        self._of_view: Callable[[str], Backwards] = lambda view: Backwards(
            sequence.reader(view), device, exposure, cuts, prepare, wrap, **options)
        self._views: dict[str, Backwards] = {}
        self._given = sequence
        self._wanted = frozenset(sequence.numbers)
        self._numbers, self._asked = _with_run_ups(sequence)
        self._at = {number: index for index, number in enumerate(self._numbers[:self._asked])}
        self._pass = DenoiseUpscale(**options)
        self._pipeline = Pipeline([self._pass], device, exposure, cuts, checks=False, wrap=wrap)
        self._prepare = prepare
        self._ahead, self._last = HistoryLength(find_cuts=cuts == "auto"), -1
        self._plan: Plan | None = None
        self._results: dict[int, Result] = {}
        self._times: dict[int, float] = {}
        self.milliseconds: float | None = None

    def spec(self, spec: FrameSpec) -> FrameSpec:
        """Spec of the returned frames for input frames of this spec."""
        return replace(spec, guides=self._guides(spec))

    def reset(self) -> None:
        """Drop all results; the next frame may be any frame."""
        self._ahead.reset()
        self._last, self._results, self._views = -1, {}, {}

    def part(self, number: int) -> tuple[int, int] | None:
        """First and last frame that have to run before this one gets its result; None if it has one
        already."""
        if number in self._results or number not in self._at:
            return None
        return number, self._numbers[self._limits(self._at[number])[1] - 1]

    def count(self, numbers: Iterable[int]) -> int:
        """How many frames run in reverse order for the results of frames, which are in order."""
        firsts: dict[tuple[int, int], int] = {}
        for index in (self._at[number] for number in numbers):
            firsts.setdefault(self._limits(index), index)
        return sum(begin - first for (_, begin), first in firsts.items())

    def __call__(self, frame: Frame, wanted: bool = True,
                 check: Callable[[], None] = lambda: None) -> Frame:
        """The frame, and its other views, with the plane `later` among their guides.

        wanted: if False, the frame only updates the history and its plane is 0. check: called
        between two frames in reverse order; it may raise.
        """
        guides = self._guides(frame.spec)
        later = np.zeros((guides.height, guides.width, 4), np.float32)
        self.milliseconds = None
        if frame.number in self._at:
            ahead = self._length_ahead(frame)
            result = self._result(frame.number, check) if wanted else None
            if (result and result.length.shape == ahead.shape
                and result.colour.shape[:2] == later.shape[:2]):
                share = np.empty(ahead.shape, np.float32)
                share_by_length(ahead, result.length, share)
                premultiply(share,
                            result.colour.astype(np.float32) / np.float32(result.exposure_factor),
                            later)
        views = {name: self._add_later(name, view, wanted, check)
                 for name, view in frame.views.items()}
        return replace(frame, guides={**frame.guides, Role.LATER: later}, views=views)

    def _add_later(self, name: str, frame: Frame, wanted: bool, check: Callable[[], None]) -> Frame:
        if name not in self._views:
            self._views[name] = self._of_view(name)
        later = self._views[name]
        found = later(frame, wanted, check)
        self.milliseconds = ((self.milliseconds or 0) + later.milliseconds if later.milliseconds
                             else self.milliseconds)
        return found

    def _guides(self, spec: FrameSpec) -> GuideSpec:
        """Guides for a spec, with `later` at the size of the denoiser's output."""
        output = self._pass.reflect(spec).output
        source = spec.guides.source if spec.guides else None
        return GuideSpec(output.width, output.height, (*spec.guide_roles, Role.LATER), source)

    def _length_ahead(self, frame: Frame) -> np.ndarray:
        """History lengths in order up to this frame; reads earlier frames again if some were
        skipped."""
        index = self._at[frame.number]
        if index != self._last + 1:
            self._ahead.reset()
            for earlier in range(max(0, index - LONGEST_HISTORY_FRAMES), index):
                self._follow(self._read(earlier))
        self._last = index
        if not self._follows(index):
            self._ahead.reset()
        return self._ahead(frame)

    @cached_property
    def _sequence(self) -> Sequence:
        """A separate reader, made after the first read in order, which decides on layout and
        area."""
        found = self._given.reader()
        found.options = found.options.without_parts()  # only the picture is mixed
        return found

    def _follow(self, frame: Frame | None) -> None:
        if frame is None:
            self._ahead.reset()
        else:
            self._ahead(frame)

    def _result(self, number: int, check: Callable[[], None]) -> Result | None:
        if number not in self._results:
            self._run(self._at[number], check)
        self.milliseconds = self._times.pop(number, None)
        return self._results.pop(number, None)

    def _limits(self, index: int) -> tuple[int, int]:
        """Index after the last frame of a frame's part, and index after the last frame of its
        run-up."""
        end = min((index // PART_FRAMES + 1) * PART_FRAMES, self._asked)
        return end, min(end + RUN_UP, len(self._numbers))

    def _run(self, first: int, check: Callable[[], None]) -> None:
        """Run a part from its last frame down to the frame at index `first`."""
        end, begin = self._limits(first)
        self._results, self._times = {}, {}
        lengths, after = HistoryLength(), None
        self._pipeline.reset()
        for index, frame in read_ahead(range(begin - 1, first - 1, -1), self._read):
            check()
            if frame is not None:
                reverse = reverse_motion(frame, after)
                colour, factor = self._denoise(reverse)
                length = lengths(replace(reverse, reset=reverse.reset or self._pipeline.cut))
                if index < end and colour is not None and frame.number in self._wanted:
                    self._results[frame.number] = Result(colour, length, factor)
                    self._times[frame.number] = sum(self._pipeline.timings.values())
            after = frame

    def _denoise(self, frame: Frame) -> tuple[np.ndarray | None, float]:
        """Exposed colour in half precision, or None if the frame cannot run, and its factor."""
        try:
            colour = mirror_plane(self._pipeline(mirror(frame))[Role.COLOUR])
        except PostfxError:
            return None, 1.0
        factor = self._pipeline.exposure_factor or 1.0
        return np.clip(colour * np.float32(factor), -LARGEST_HALF,
                       LARGEST_HALF).astype(np.float16), factor

    def _plan_of(self, number: int) -> Plan:
        with self._sequence.open(number) as files:
            return self._pipeline.explain(files.spec())

    def _read(self, index: int) -> Frame | None:
        """A frame, marked if it does not follow the one before it; None if it cannot be read."""
        number = self._numbers[index]
        try:
            self._plan = self._plan or self._plan_of(number)
            self._sequence.rewind()
            read = partial(self._sequence.read, number, self._plan.planes, self._plan.guides)
            frame = self._prepare(read_patiently(read))
        except PostfxError:
            return None
        frame.reset = frame.reset or not self._follows(index)
        return frame

    def _follows(self, index: int) -> bool:
        """Whether the frame before one in the list is also the one before it in the shot."""
        number = self._numbers[index]
        return index > 0 and self._sequence.before(number, 1) == [self._numbers[index - 1]]


def _with_run_ups(sequence: Sequence) -> tuple[tuple[int, ...], int]:
    """A sequence's frames, each followed by those of a run-up that lie before the next one; and how
    many these are up to its last frame."""
    found: list[int] = []
    asked = 0
    for number, following in zip(sequence.numbers, (*sequence.numbers[1:], None), strict=True):
        found.append(number)
        asked = len(found)
        if following is None or sequence.before(following, 1) != [number]:
            found += [one for one in sequence.after(number, RUN_UP)
                      if following is None or one < following]
    return tuple(found), asked


def _check_is_sequence(given: object, name: str) -> None:
    """SequenceError where a class of this name is given what has no frames by their numbers."""
    if not (hasattr(given, "numbers") and hasattr(given, "read")):
        raise SequenceError(f"{name} takes a postfx.Sequence, not {type(given).__name__}: give "
                            "read_sequence('shot/noisy.####.exr')")
