"""Gives the first frame of a shot a history by running the frames after it first, in reverse order."""

from __future__ import annotations

import copy
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from itertools import takewhile

from postfx.cuts import CutDetector
from postfx.errors import PostfxError
from postfx.files import read_ahead, read_patiently
from postfx.frame import Frame
from postfx.io.sequence import Sequence
from postfx.temporal.reverse_motion import reverse_motion

FRAMES = 8
"""Frames of a run-up. With half as many, some frames after the first come out worse than without a run-up."""


class RunUp:
    """Gives a `Pipeline` a history at the first frame of each shot, which would be the noisiest without it.

        shot = postfx.read_sequence("shot/noisy.####.exr")
        passes = postfx.Pipeline([postfx.DenoiseUpscale()], run_up=postfx.RunUp(shot))
        for frame in shot:
            postfx.write_frame(f"out/clean.{frame.number:04d}.exr", passes(frame))

    Args:
        sequence: the frames. A separate reader reads them again, so iterating the sequence is not disturbed.
        frames: how many frames after the first one to run, the last of them first. Fewer run if a gap, a broken file or
            another shot comes sooner; none if `sequence.numbers` skips the next frame.
        cuts: as for the `Pipeline`.
        prepare: applied to frames after reading, as for the frames in order.

        view: of stereo files, the view whose frames run; None for the first.

    Frames that cannot be read or run are skipped without an error; the frames between them and the first one still run.

    Attributes:
        on_frame: called before each frame of the run-up, with the number of the shot's first frame and its own; it may
            raise to end the run-up.
    """

    def __init__(self, sequence: Sequence, frames: int = FRAMES, cuts: str = "auto",
                 prepare: Callable[[Frame], Frame] = lambda frame: frame, view: str | None = None) -> None:
        self._view = view
        self._sequence, self._frames, self._find_cuts, self._prepare = sequence, frames, cuts == "auto", prepare
        self.on_frame: Callable[[int, int], None] = lambda first, number: None
        self._next = dict(zip(sequence.numbers, (*sequence.numbers[1:], None), strict=True))

    def of_view(self, view: str) -> RunUp:
        """The same for another view of the sequence."""
        found = copy.copy(self)
        found._view = view
        found.on_frame = lambda first, number: self.on_frame(first, number)
        return found

    def after(self, number: int) -> list[int]:
        """Numbers of the frames to run before this one, in sequence order, according to their headers."""
        found = self._sequence.after(number, self._frames)
        follows = found and self._next.get(number, found[0]) == found[0]  # frames before the range lead to it
        return list(takewhile(partial(_continues_shot, self._sequence.reader(self._view)), found)) if follows else []

    def __call__(self, frame: Frame, run: Callable[[Frame], None]) -> Frame:
        """Run the frames after a first one in reverse order. Returns the first frame, ready to run after them."""
        numbers = self.after(frame.number)
        if not numbers:
            return frame
        detector = CutDetector() if self._find_cuts else None
        later: Frame | None = None
        for _, other in read_ahead(reversed(numbers), partial(self._read, self._sequence.reader(self._view), frame)):
            if other is not None:
                self.on_frame(frame.number, other.number)
            has_run = other is not None and _try_run(_mark_cut(reverse_motion(other, later), detector), run)
            later = other if has_run else None
        return _mark_cut(reverse_motion(frame, later), detector)

    def _read(self, sequence: Sequence, first: Frame, number: int) -> Frame | None:
        """A frame with the planes of the first one; None if it lacks them or cannot be read."""
        try:
            sequence.rewind()
            frame = self._prepare(read_patiently(partial(sequence.read, number, first.planes, first.guides)))
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
