"""Which frames to run in which order, so that those to be written come out as in an unbroken run."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple


class Work(NamedTuple):
    """A frame to process, and whether its result is written or only fills the history.

    With a checkpoint, the frame is not processed: the passes go on as they did after it.
    """

    number: int
    write: bool
    checkpoint: Path | None = None


class Known(NamedTuple):
    """What is known of earlier runs.

    Attributes:
        starts: frames that begin a shot, so that nothing before them counts.
        checkpoints: frame number -> checkpoint that was made after it.
    """

    starts: Collection[int] = ()
    checkpoints: Mapping[int, Path] = {}


def schedule(
    numbers: Sequence[int], wanted: Collection[int], known: Known, most: int | None, is_readable: Callable[[int], bool]
) -> list[Work]:
    """Frames to run, in order.

    Args:
        numbers: all frames of the sequence, in the order of an unbroken run.
        wanted: those to be written.
        most: frames to run again for the history of each wanted one; None for as many as it takes.
        is_readable: whether a frame's input is there; what leads to a frame ends at a hole.

    Before each wanted frame its history comes from the nearest of: the frame that ran before it in this run, a
    checkpoint, the first frame of its shot.
    """
    works: list[Work] = []
    last = -1  # index of the frame that ran last
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
    numbers: Sequence[int], begin: int, at: int, known: Known, is_readable: Callable[[int], bool]
) -> int:
    """Index of the frame, from `begin` on, with which the history of frame `at` begins."""
    holes = [index + 1 for index in range(begin, at) if not is_readable(numbers[index])]
    starts = [index for index in range(begin, at + 1) if numbers[index] in known.starts]
    return max([begin, *holes, *starts])
