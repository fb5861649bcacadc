"""One run: its log, how its frames came about, what it wrote, and what it takes to go on after a stop."""

from __future__ import annotations

import hashlib
import json
import os
import platform
import sys
import time
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib import metadata
from pathlib import Path
from typing import Any

import numba
import numpy
import numpy as np
import OpenImageIO

from postfx.errors import Interrupted, ReadError, WriteError
from postfx.frame import Frame
from postfx.io.sequence import Sequence
from postfx.io.writer import Existing, OutputFiles
from postfx.pipeline import Pipeline
from postfx.plan import Plan, Skipped
from postfx.runs.checkpoint import load_checkpoint
from postfx.runs.folder import RunFolder
from postfx.runs.locks import Process
from postfx.runs.manifest import Output
from postfx.runs.schedule import Known, Work, judge, schedule
from postfx.runtime import Device, Library
from postfx.version import __version__


class Log:
    """Appends events to a file; without a file it does nothing.

    Each line is written by one call, so lines of several runs that share a file do not mix. docs/reliability.md has the
    events. Raises WriteError when the file cannot be written.
    """

    def __init__(self, path: str | None, run: str) -> None:
        self._run, self._path, self._file = run, path, -1
        if path is not None:
            try:
                Path(path).parent.mkdir(parents=True, exist_ok=True)
                self._file = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o644)
            except OSError as error:
                raise WriteError(f"{path}: cannot be written: {error.strerror}: give --log another file") from error

    def __call__(self, event: str, **facts: Any) -> None:
        """Write one event."""
        if self._file >= 0:
            line = json.dumps({"time": now(), "run": self._run, "event": event, **facts}, default=str)
            try:
                os.write(self._file, f"{line}\n".encode())
            except OSError as error:
                raise WriteError(f"{self._path}: cannot be written: {error.strerror}") from error

    def close(self) -> None:
        """No more events."""
        if self._file >= 0:
            os.close(self._file)
            self._file = -1


def now() -> str:
    """The time as in ISO 8601, UTC, to the millisecond."""
    return datetime.now(UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")


@dataclass(frozen=True)
class Provenance:
    """How the frames of a run come about.

    Attributes:
        settings: argument -> value, of those given and those that have a default.
        passes: name -> options, of the passes that run.
        versions: of postfx and what it is built on.
        device: where it runs.
        fingerprint: of all of these, of the models that are installed, and of what else decides about pixels.
        files: names of settings that are files; headers hold their names without the folder.
    """

    settings: Mapping[str, Any]
    passes: Mapping[str, Mapping[str, Any]]
    versions: Mapping[str, str]
    device: Mapping[str, Any]
    fingerprint: str
    files: Collection[str] = ()

    def as_dict(self) -> dict[str, Any]:
        """In plain types."""
        return {"settings": dict(self.settings), "passes": dict(self.passes), "versions": dict(self.versions),
                "device": dict(self.device), "fingerprint": self.fingerprint}

    def header(self, models: Mapping[str, str]) -> dict[str, str]:
        """Attributes for an image's header. models: name -> SHA-256 of the networks that ran."""
        settings = {name: Path(str(value)).name if name in self.files and value else value
                    for name, value in self.settings.items()}
        return {
            "postfx:version": self.versions["postfx"],
            "postfx:models": ", ".join(f"{name} sha256:{digest}" for name, digest in sorted(models.items())),
            "postfx:settings": json.dumps({"settings": settings, "passes": dict(self.passes)}, default=str),
        }


def provenance_of(settings: Mapping[str, Any], plan: Plan, device: Device, also: Iterable[Any] = (),
                  files: Collection[str] = ()) -> Provenance:
    """Provenance of a run.

    settings: name -> value, of the options that change pixels; `files`: those of them that name files. also: what else
    decides about pixels, and is not recorded.
    """
    settings = {name: _plain(settings[name]) for name in sorted(settings)}
    passes = {step.name: {key: _plain(value) for key, value in step.instance.options.items()} for step in plan.steps}
    place = {"name": device.name, "provider": device.placement.provider, "threads": device.threads}
    library = Library()
    models = {name: library.sha256(name) for name in library.names()}
    decisive = [settings, passes, versions(), place, plan.as_dict(), models, *also]
    text = json.dumps(decisive, sort_keys=True, default=str)
    return Provenance(settings, passes, versions(), place, hashlib.sha256(text.encode()).hexdigest(), files)


def versions() -> dict[str, str]:
    """Versions of postfx and of what its pixels depend on."""
    runtimes = {name: _installed(name) for name in ("onnxruntime", "onnxruntime-gpu")}
    return {"postfx": __version__, "python": platform.python_version(), "numpy": numpy.__version__,
            "numba": numba.__version__, "OpenImageIO": OpenImageIO.VERSION_STRING,
            **{name: version for name, version in runtimes.items() if version}}


def _installed(name: str) -> str | None:
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return None


def _plain(value: Any) -> Any:
    return value if isinstance(value, str | int | float | bool | None) else str(value)


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
        return _states_of(list(files.values()))


def _states_of(paths: list[Path]) -> dict[str, tuple[int, int]]:
    """Size and modification time of the files that exist, by path."""
    found = {str(path): path.stat() for path in paths if path.is_file()}
    return {path: (status.st_size, status.st_mtime_ns) for path, status in found.items()}
