"""A history for the first frame of a shot: the frames after it are run before it, in reverse order."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from itertools import takewhile

from postfx.backwards.turned import turned
from postfx.cuts import CutDetector
from postfx.errors import PostfxError
from postfx.frame import Frame
from postfx.io.ahead import read_ahead
from postfx.io.retry import read_patiently
from postfx.io.sequence import Sequence

FRAMES = 8
"""Frames that are run ahead: with half as many some of the frames after the first are worse than with none."""


class RunUp:
    """What a `Pipeline` asks at the first frame of each shot, which without it is the worst of all.

        shot = postfx.read_sequence("shot/noisy.####.exr")
        passes = postfx.Pipeline([postfx.DenoiseUpscale()], run_up=postfx.RunUp(shot))
        for frame in shot:
            postfx.write_frame(f"out/clean.{frame.number:04d}.exr", passes(frame))

    Args:
        sequence: the frames; they are read once more beside, so who iterates it is not disturbed.
        frames: how many of those after the first are run, from the last one on; as many of them as there are, where a
            hole, a broken file or another shot follows sooner. Only where the next frame of `sequence.numbers` follows
            the first one.
        cuts: as for the `Pipeline`.
        prepare: what is done to frames that are read before they are run, as to those in order.

    Frames that cannot be read or run are no error here: those between them and the first one count.
    """

    def __init__(self, sequence: Sequence, frames: int = FRAMES, cuts: str = "auto",
                 prepare: Callable[[Frame], Frame] = lambda frame: frame) -> None:
        self._sequence, self._frames, self._find_cuts, self._prepare = sequence, frames, cuts == "auto", prepare
        self._next = dict(zip(sequence.numbers, (*sequence.numbers[1:], None), strict=True))

    def after(self, number: int) -> list[int]:
        """Numbers of the frames that are run before this one, in the order of the sequence, by their headers."""
        found = self._sequence.after(number, self._frames)
        wanted = found and self._next.get(number, found[0]) == found[0]  # frames before the range lead to it
        return list(takewhile(partial(_goes_on, self._sequence.reader()), found)) if wanted else []

    def __call__(self, frame: Frame, run: Callable[[Frame], None]) -> Frame:
        """Run the frames after a first one in reverse order; returns as what it is run itself: the last of them."""
        numbers = self.after(frame.number)
        if not numbers:
            return frame
        detector, later = CutDetector() if self._find_cuts else None, None
        for _, other in read_ahead(reversed(numbers), partial(self._read, self._sequence.reader(), frame)):
            has_run = other is not None and _ran(_marked(turned(other, later), detector), run)
            later = other if has_run else None
        return _marked(turned(frame, later), detector)

    def _read(self, sequence: Sequence, first: Frame, number: int) -> Frame | None:
        """A frame with the planes of the first one; None where it has not those, or cannot be read."""
        try:
            sequence.rewind()
            frame = self._prepare(read_patiently(partial(sequence.read, number, first.planes, first.guides)))
        except PostfxError:
            return None
        return frame if frame.spec == first.spec else None


def _goes_on(sequence: Sequence, number: int) -> bool:
    """Whether a frame is there and does not begin a shot."""
    try:
        return not read_patiently(partial(sequence.begins_shot, number))
    except PostfxError:
        return False


def _marked(frame: Frame, detector: CutDetector | None) -> Frame:
    """The frame, as a first one where it is unrelated to the one before."""
    is_cut = detector is not None and frame.encoding == "scene-linear" and detector(frame)
    return replace(frame, reset=True) if is_cut else frame


def _ran(frame: Frame, run: Callable[[Frame], None]) -> bool:
    """Whether a frame could be run."""
    try:
        run(frame)
    except PostfxError:
        return False
    return True
