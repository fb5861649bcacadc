"""Which frames a run processes, and which files of earlier runs stay."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from pathlib import Path
from typing import NamedTuple

from postfx.files import hash_file
from postfx.io.writer import is_complete
from postfx.runs.manifest import Output


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
    numbers: tuple[int, ...] | list[int], wanted: Collection[int], known: Known, most: int | None,
    is_readable: Callable[[int], bool],
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
    numbers: tuple[int, ...] | list[int], begin: int, at: int, known: Known, is_readable: Callable[[int], bool]
) -> int:
    """Index of the frame, from `begin` on, with which the history of frame `at` begins."""
    holes = [index + 1 for index in range(begin, at) if not is_readable(numbers[index])]
    starts = [index for index in range(begin, at + 1) if numbers[index] in known.starts]
    return max([begin, *holes, *starts])


Inputs = Mapping[str, tuple[int, int]]


class Judgement(NamedTuple):
    """Whether a file is kept; why it is not, or what is odd about keeping it."""

    kept: bool
    why: str = ""


def judge(path: Path, known: Output | None, size: tuple[int, int], inputs: Inputs) -> Judgement:
    """Whether a file may stay.

    Args:
        known: what the manifest has about it.
        size: width and height that it must have.
        inputs: what its frame would be read from now.

    A file that the manifest does not know, or that was altered since, stays if it can be decoded to its last pixel: it
    may be someone's work. One whose run did not get to it is left from before that run, and does not stay.
    """
    if not path.is_file():
        return Judgement(False, "is not there")
    if known is None:
        return Judgement(True) if is_complete(path, *size) else Judgement(False, "is not complete")
    if known.sha256 is None:
        return Judgement(False, "is older than the run that was to write it")
    if (known.width, known.height) != size:
        return Judgement(False, f"is {known.width}x{known.height}, not {size[0]}x{size[1]}")
    if _changed(known.inputs, inputs):
        return Judgement(False, "was made of an input that has changed since")
    if path.stat().st_size == known.bytes and hash_file(path) == known.sha256:
        return Judgement(True)
    if is_complete(path, *size):
        return Judgement(True, "was altered since it was written: kept; delete it to make it anew")
    return Judgement(False, "is damaged")


def _changed(before: Inputs, now: Inputs) -> bool:
    """Whether a file that is there under the same name is another one; files that are gone are not missed."""
    return any(path in before and before[path] != facts for path, facts in now.items())
