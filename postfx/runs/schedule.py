"""Which frames a run processes, which existing files it keeps, and how a sequence is cut into
chunks for several runs.

A chunk's first frame has no history of its own, so the frames before it run first, without being
written. Those that are further away than `PREROLL` frames no longer matter: the seam differs from
an unbroken run by less than its noise.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

from postfx.errors import PostfxError
from postfx.files import hash_file
from postfx.io.pattern import format_frames
from postfx.io.sequence import Sequence
from postfx.io.writer import is_complete
from postfx.runs.manifest import Output


class Work(NamedTuple):
    """A frame to process; its result is written or only fills the history.

    With a checkpoint, the frame is not processed: the passes' history is restored instead.
    """

    number: int
    write: bool
    checkpoint: Path | None = None


class EarlierRuns(NamedTuple):
    """Facts from earlier runs.

    Attributes:
        starts: frames that begin a shot, so that earlier frames do not affect them.
        checkpoints: frame number -> checkpoint made after that frame.
    """

    starts: Collection[int] = ()
    checkpoints: Mapping[int, Path] = {}


def schedule(
    numbers: tuple[int, ...] | list[int], wanted: Collection[int], known: EarlierRuns,
    most: int | None, is_readable: Callable[[int], bool],
) -> list[Work]:
    """Frames to run, in order.

    Args:
        numbers: all frames of the sequence, in the order of an unbroken run.
        wanted: the frames to write.
        most: frames to run again for the history of each wanted one; None for as many as needed.
        is_readable: whether a frame's input exists; a gap ends the history.

    The history of a wanted frame starts at the nearest of: the last frame that this run processed,
    a checkpoint, the first frame of the shot.
    """
    works: list[Work] = []
    last = -1  # index of the last frame to run
    for at, number in enumerate(numbers):
        if number not in wanted:
            continue
        first = _first(numbers, last + 1, at, known, is_readable)
        first = first if most is None else max(first, at - most)
        saved = [index for index in range(max(first - 1, last + 1), at)
                 if numbers[index] in known.checkpoints and is_readable(numbers[index])]
        if saved:
            works.append(Work(numbers[saved[-1]], False, known.checkpoints[numbers[saved[-1]]]))
            first = saved[-1] + 1
        works += [Work(each, False) for each in numbers[first:at]]
        works.append(Work(number, True))
        last = at
    return works


def _first(
    numbers: tuple[int, ...] | list[int], begin: int, at: int, known: EarlierRuns,
    is_readable: Callable[[int], bool]
) -> int:
    """Index, from `begin` on, at which the history of frame `at` starts."""
    holes = [index + 1 for index in range(begin, at) if not is_readable(numbers[index])]
    starts = [index for index in range(begin, at + 1) if numbers[index] in known.starts]
    return max([begin, *holes, *starts])


Inputs = Mapping[str, tuple[int, int]]


class Judgement(NamedTuple):
    """Whether a file is kept; why not, or an oddity to warn about."""

    kept: bool
    why: str = ""


def judge(path: Path, known: Output | None, size: tuple[int, int], inputs: Inputs) -> Judgement:
    """Whether to keep an existing file.

    Args:
        known: its entry in the manifest.
        size: required width and height.
        inputs: the files from which its frame would be read now.

    A file that is not in the manifest, or was altered since, is kept if it decodes to its last
    pixel: it may be someone's work. A file that its run never reached is older than that run, and
    is not kept.
    """
    if not os.path.isfile(path):
        return Judgement(False, "does not exist")
    if known is None:
        return Judgement(True) if is_complete(path, *size) else Judgement(False, "is not complete")
    if known.sha256 is None:
        return Judgement(False, "is older than the run that should have written it")
    if (known.width, known.height) != size:
        return Judgement(False, f"is {known.width}x{known.height}, not {size[0]}x{size[1]}")
    if _has_changed(known.inputs, inputs):
        return Judgement(False, "was made of an input that has changed since")
    if path.stat().st_size == known.bytes and hash_file(path) == known.sha256:
        return Judgement(True)
    if is_complete(path, *size):
        return Judgement(True, "was altered since it was written: kept; delete it to make it again")
    return Judgement(False, "is damaged")


def _has_changed(before: Inputs, now: Inputs) -> bool:
    """Whether an input was replaced by a file of the same name; missing inputs do not count."""
    return any(path in before and before[path] != facts for path, facts in now.items())


# Chunks

AUTO_PREROLL = "auto"
"""As many frames before the first one as its shot has."""
PREROLL = 96
"""Most frames that run before a chunk: on five sequences the first and the third frame after a seam
were then at 57 dB or more against an unbroken run (docs/howto/farm.md)."""


@dataclass(frozen=True)
class Chunk:
    """Frames that one machine processes.

    Attributes:
        frames: numbers of the frames to write.
        preroll: of those that run before, without being written.
        ahead: of those that may be read after the last one, where a shot begins near the end.
        before: of the one before all of them, where motion is estimated from it.
        between: of those that run between the frames, without being written.
    """

    frames: tuple[int, ...]
    preroll: tuple[int, ...] = ()
    ahead: tuple[int, ...] = ()
    before: tuple[int, ...] = ()
    between: tuple[int, ...] = ()

    @property
    def reads(self) -> tuple[int, ...]:
        """Numbers of all frames whose files must be there."""
        return tuple(sorted({*self.before, *self.preroll, *self.frames, *self.between,
                             *self.ahead}))

    def as_dict(self) -> dict[str, Any]:
        """In plain types."""
        return {"frames": format_frames(self.frames), "count": len(self.frames),
                "preroll": format_frames(self.preroll), "reads": format_frames(self.reads)}


def find_preroll(sequence: Sequence, number: int, preroll: int | str = AUTO_PREROLL) -> list[int]:
    """Frames to run before one that has no history: so many, or by 'auto' those of its shot that
    lead to it without a hole, at most `PREROLL`.

    Headers and the sequence's cuts say where the shot begins; a frame that cannot be opened ends
    the search.
    """
    if preroll != AUTO_PREROLL:
        return sequence.before(number, int(preroll))
    found: list[int] = []
    reader, current = sequence.reader(), number
    with suppress(PostfxError):
        while len(found) < PREROLL and not reader.begins_shot(current):
            before = sequence.before(current, 1)
            if not before:
                break
            current = before[0]
            found.append(current)
    return found[::-1]


def find_between(sequence: Sequence, number: int, last: int,
                 preroll: int | str = AUTO_PREROLL) -> list[int]:
    """Frames to run between two that are wanted, `last` and `number`, where those that lead to the
    second are on the disk though nobody asked for them: as many as before the first of all."""
    if sequence.before(number, 1) == [last]:
        return []
    return [one for one in find_preroll(sequence, number, preroll) if one > last]


def fill_gaps(sequence: Sequence, numbers: tuple[int, ...],
              preroll: int | str = AUTO_PREROLL) -> list[int]:
    """Frames of a sequence, and between them those that lead over their gaps, in order.

    Pixels of a frame are then the same whichever others are asked for.
    """
    filled = list(numbers[:1])
    for last, number in pairwise(numbers):
        filled += [*find_between(sequence, number, last, preroll), number]
    return filled


def make_chunks(sequence: Sequence, size: int, ahead: int = 0) -> Iterator[Chunk]:
    """The chunks of a sequence's frames, in order.

    Args:
        size: frames of each chunk but the last.
        ahead: frames after a shot's first one that are read for its sake.
    """
    for first in range(0, len(sequence.numbers), size):
        frames = sequence.numbers[first : first + size]
        preroll = find_preroll(sequence, frames[0])
        between = sorted({*fill_gaps(sequence, frames)} - {*frames})
        before = sequence.read_for_motion((preroll or frames)[0])
        yield Chunk(tuple(frames), tuple(preroll), tuple(sequence.after(frames[-1], ahead)),
                    tuple(before), tuple(between))
