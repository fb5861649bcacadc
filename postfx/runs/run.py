"""One run's records: which frames to run, which files stay, what was written, and what it takes to go on."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from postfx.errors import Interrupted, ReadError, WriteError
from postfx.files import hash_file
from postfx.frame import Frame
from postfx.io.sequence import Sequence
from postfx.io.writer import Existing, OutputFiles, is_complete
from postfx.pipeline import Pipeline
from postfx.plan import Plan, Skipped
from postfx.runs.checkpoint import load_checkpoint
from postfx.runs.events import Log, now
from postfx.runs.folder import RunFolder
from postfx.runs.locks import Process
from postfx.runs.manifest import Output
from postfx.runs.provenance import Provenance


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


def facts_of(paths: list[Path]) -> dict[str, tuple[int, int]]:
    """Size and time of change of files, by path; without those that are not there."""
    found = {str(path): path.stat() for path in paths if path.is_file()}
    return {path: (status.st_size, status.st_mtime_ns) for path, status in found.items()}


def _changed(before: Inputs, now: Inputs) -> bool:
    """Whether a file that is there under the same name is another one; files that are gone are not missed."""
    return any(path in before and before[path] != facts for path, facts in now.items())


MANY = 32
"""Frames run again for one, from which on the user is told how to have fewer."""


@dataclass(frozen=True)
class Options:
    """What the user says about a run's books.

    Attributes:
        log: file for JSON lines, or None.
        checkpoint: seconds of work between two checkpoints; None for none.
        rerun: frames to run again for the history of one to be written; None for as many as it takes.
        preroll: frames before the first one of the sequence.
    """

    log: str | None = None
    checkpoint: float | None = 30.0
    rerun: int | None = None
    preroll: int = 0


class Run:
    """Use as a context manager around the frames of a run.

    Raises RunError when another run writes the same files, WriteError when the folder cannot be written.

    Attributes:
        works: frames to run, in order.
        left_out: frames that need no work, and why.
        warnings: what is odd about files that are there.
    """

    def __init__(self, outputs: OutputFiles, sequence: Sequence, pipeline: Pipeline, plan: Plan,
                 provenance: Provenance, options: Options) -> None:
        self.works: list[Work] = []
        self.left_out: list[Skipped] = []
        self.warnings: list[str] = []
        self._outputs, self._sequence, self._pipeline, self._plan = outputs, sequence, pipeline, plan
        self._provenance, self._options = provenance, options
        self._id = f"{time.strftime('%Y%m%dT%H%M%SZ', time.gmtime())}-{os.urandom(4).hex()}"
        self._log = Log(options.log, self._id)
        self._pattern = outputs.pattern
        self._checkpointed = time.monotonic()
        self._written = 0

    def __enter__(self) -> Run:
        first = self._outputs.path(self._sequence.numbers[0])
        names = {self._outputs.path(number).name: number for number in self._sequence.numbers}
        try:
            self._folder = RunFolder(first.parent, self._id, names)
        except OSError as error:
            self._log.close()
            remedy = "check the folder's rights and free space"
            raise WriteError(f"{first}: cannot be written: {error.strerror}; {remedy}") from error
        try:
            self._begin(names)
        except BaseException:
            self._folder.release()
            raise
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, _: object) -> None:
        status = "finished" if kind is None else "stopped" if issubclass(kind, KeyboardInterrupt) else "failed"
        finished = self._sequence.numbers if kind is None else ()
        try:
            self._folder.close({"status": status, "ended": now()}, finished, self._pattern)
        except WriteError:
            if kind is None:  # else what ended the run is the better reason
                raise
        finally:
            code = 0 if error is None else error.exit_code if isinstance(error, Interrupted) else 2
            self._log("end", status=status, written=self._written, exit_code=code, error=str(error) if error else None)
            self._log.close()

    def recall(self, work: Work, frame: Frame) -> None:
        """Let the passes go on as they did after a work's checkpoint was made."""
        assert work.checkpoint is not None, "only work with a checkpoint is recalled"
        self._pipeline.recall(frame, load_checkpoint(work.checkpoint))
        self._log("recall", frame=work.number)

    def wrote(self, number: int, path: Path, frame: Frame, **facts: Any) -> None:
        """Note a file that was written; `frame` is what came out, `facts` are for the log."""
        height, width = next(iter(frame.planes.values())).shape[:2]
        width, height = self._sequence.shown_size(width, height)
        output = self._folder.wrote(
            path, {"models": dict(self._pipeline.device.models)}, frame=number, width=width, height=height,
            inputs=self._inputs(number), starts=frame.reset)
        self._written += 1
        self._log("frame", frame=number, file=str(path), bytes=output.bytes, sha256=output.sha256, **facts)

    def failed(self, number: int, error: ReadError) -> None:
        """Note a read that failed and is tried again."""
        self._log("retry", frame=number, error=str(error))

    def ran(self, number: int, finish: Callable[[], None], is_last: bool) -> None:
        """A frame is done: keep what the passes remember if it is time, or the run ends here before its last frame.

        `finish` waits until all files are written: a checkpoint beyond a file that is not there, or not in the
        manifest, is of no use.
        """
        seconds = self._options.checkpoint
        if seconds is None or not (is_last or time.monotonic() - self._checkpointed >= seconds):
            return
        history = self._pipeline.history()
        if history:
            finish()
            self._folder.flush()
            self._save(number, history)
        self._checkpointed = time.monotonic()

    def _save(self, number: int, history: Mapping[str, np.ndarray]) -> None:
        begin = time.monotonic()
        try:
            size = self._folder.save(self._pattern, self._provenance.fingerprint, number, history,
                                     self._pipeline.device.memory.relax)
            self._log("checkpoint", frame=number, bytes=size, ms=round(1000 * (time.monotonic() - begin), 1))
        except OSError as error:  # the frames are worth more than going on sooner
            text = f"no checkpoint could be written: {error.strerror}"
            self.warnings += [] if text in self.warnings else [text]
            self._log("warning", text=text)

    def header(self) -> dict[str, str]:
        """Attributes for the headers of images."""
        return self._provenance.header(self._pipeline.device.models)

    def _begin(self, names: dict[str, int]) -> None:
        self.warnings = self._folder.warnings
        wanted = self._chosen(names)
        pending = {name: Output(self._id, number) for name, number in names.items() if number in wanted}
        facts = {**self._provenance.as_dict(), "command": sys.argv, "process": Process.me().as_dict(),
                 "input": str(self._sequence.pattern), "output": self._pattern, "began": now()}
        self._folder.note({**facts, "status": "running"}, pending)
        self.works = self._scheduled(wanted)
        self._log("begin", **facts, frames=len(names), wanted=len(wanted))
        for item in self.left_out:
            self._log("skip", what=item.what, why=item.why)
        for text in self.warnings:
            self._log("warning", text=text)

    def _chosen(self, names: dict[str, int]) -> set[int]:
        """Frames to write: all, or those whose file is not there as it should be."""
        if self._outputs.existing is not Existing.SKIP:
            return set(names.values())
        size = self._sequence.shown_size(self._plan.output.width, self._plan.output.height)
        before, wanted = self._folder.before, set()
        others = []
        for name, number in names.items():
            path, known = self._outputs.path(number), before.outputs.get(name)
            found = judge(path, known, size, self._inputs(number))
            if not found.kept:
                wanted.add(number)
                continue
            self.left_out.append(Skipped(f"frame {number}", f"{path} is there and complete"))
            self.warnings += [f"{path} {found.why}"] if found.why else []
            others += [number] if known and not self._is_alike(known) else []
        if others:
            self.warnings.append(f"{len(others)} kept frames, {others[0]} the first, were made with other settings, "
                                 "models or versions: --overwrite makes them anew")
        return wanted

    def _scheduled(self, wanted: set[int]) -> list[Work]:
        numbers, options = self._sequence.numbers, self._options
        if not self._pipeline.remembers(self._plan):
            return [Work(number, True) for number in numbers if number in wanted]
        works = schedule(numbers, wanted, self._known(), options.rerun, self._sequence.holds)
        again = sum(not work.write for work in works)
        if again > MANY and options.rerun is None:
            self.warnings.append(f"{again} finished frames are run again, for the history of those that are not: "
                                 "--resume 8 takes fewer, and gives nearly the same")
        if works and works[0].number == numbers[0] and not works[0].checkpoint:
            works = [Work(number, False) for number in self._sequence.before(numbers[0], options.preroll)] + works
        return works

    def _known(self) -> Known:
        """What earlier runs of the same settings found out."""
        if self._outputs.existing is not Existing.SKIP:
            return Known()
        starts = {output.frame for output in self._folder.before.outputs.values()
                  if output.starts and output.sha256 and self._is_alike(output)}
        return Known(starts, self._folder.checkpoints(self._pattern, self._provenance.fingerprint))

    def _is_alike(self, output: Output) -> bool:
        run = self._folder.before.runs.get(output.run, {})
        return run.get("fingerprint") == self._provenance.fingerprint

    def _inputs(self, number: int) -> dict[str, tuple[int, int]]:
        if not self._sequence.holds(number):
            return {}
        files = {**self._sequence.files(number), **{f"guides {k}": v for k, v in
                                                    (self._sequence.guide_files(number) or {}).items()}}
        return facts_of(list(files.values()))
