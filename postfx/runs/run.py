"""One run: its log, its provenance, its records of written files, and checkpoints to resume
from."""

from __future__ import annotations

import errno
import hashlib
import json
import os
import platform
import sys
import time
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import cached_property
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy
import numpy as np
import OpenImageIO

from postfx.errors import Interrupted, MissingFrameError, ReadError, WriteError
from postfx.files import refusal
from postfx.frame import Frame
from postfx.io.pattern import format_frames
from postfx.io.sequence import Sequence
from postfx.io.writer import ExistingFiles, OutputFiles
from postfx.passes.registry import BUILT_IN, plug_ins
from postfx.pipeline import Pipeline
from postfx.plan import Plan, Skip
from postfx.runs.folder import RunFolder, load_checkpoint
from postfx.runs.locks import Process
from postfx.runs.manifest import Output
from postfx.runs.schedule import (
    AUTO_PREROLL,
    EarlierRuns,
    Work,
    fill_gaps,
    find_preroll,
    judge,
    schedule,
)
from postfx.runtime import Device, Library
from postfx.version import __version__

_AT_ONCE = getattr(os, "O_NONBLOCK", 0)
"""Refuses a pipe that nobody reads instead of waiting for a reader; 0 on Windows."""


class Log:
    """Appends events to a file as lines of JSON; without a file it does nothing.

    One system call writes a line, so lines of several runs that share a file do not mix.
    docs/lab/reliability.md lists the events. Raises WriteError if the file cannot be written.
    """

    def __init__(self, path: str | None, run: str) -> None:
        self._run, self._path, self._file = run, path, -1
        if path is not None:
            try:
                Path(path).parent.mkdir(parents=True, exist_ok=True)
                self._file = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND | _AT_ONCE, 0o644)
                if _AT_ONCE:
                    os.set_blocking(self._file, True)
            except OSError as error:
                reason = "nobody reads this pipe" if error.errno == errno.ENXIO else error.strerror
                raise WriteError(f"{path}: cannot be written: {reason}: give --log another "
                                 "file") from error

    def __call__(self, event: str, **facts: Any) -> None:
        """Write one event."""
        if self._file >= 0:
            line = json.dumps({"time": now(), "run": self._run, "event": event, **facts},
                              default=str)
            try:
                os.write(self._file, f"{line}\n".encode())
            except OSError as error:
                raise WriteError(f"{self._path}: cannot be written: {error.strerror}") from error

    def close(self) -> None:
        """Close the file."""
        if self._file >= 0:
            os.close(self._file)
            self._file = -1


def now() -> str:
    """The current time in ISO 8601, UTC, to the millisecond."""
    return datetime.now(UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")


@dataclass(frozen=True)
class Provenance:
    """How the frames of a run are made.

    Attributes:
        settings: option -> value, given or default.
        passes: name -> options, of the active passes.
        versions: of postfx and the libraries it uses.
        device: where it runs.
        fingerprint: hash of all these, of the installed models, and of everything else that affects
            pixels.
        files: names of settings that are files; headers hold them without their folder.
    """

    settings: Mapping[str, Any]
    passes: Mapping[str, Mapping[str, Any]]
    versions: Mapping[str, str]
    device: Mapping[str, Any]
    fingerprint: str
    files: Collection[str] = ()

    def as_dict(self) -> dict[str, Any]:
        """In plain types."""
        return {"settings": dict(self.settings), "passes": dict(self.passes),
                "versions": dict(self.versions),
                "device": dict(self.device), "fingerprint": self.fingerprint}

    def header(self, models: Mapping[str, str]) -> dict[str, str]:
        """Attributes for an image's header. models: name -> SHA-256 of the networks that ran."""
        return {
            "postfx:version": self.versions["postfx"],
            "postfx:models": ", ".join(f"{name} sha256:{digest}"
                                       for name, digest in sorted(models.items())),
            "postfx:settings": self._settings_text,
        }

    @cached_property
    def _settings_text(self) -> str:
        settings = {name: Path(str(value)).name if name in self.files and value else value
                    for name, value in self.settings.items()}
        return json.dumps({"settings": settings, "passes": dict(self.passes)}, default=str)


def provenance_of(settings: Mapping[str, Any], plan: Plan, device: Device, also: Iterable[Any] = (),
                  files: Collection[str] = ()) -> Provenance:
    """Provenance of a run.

    settings: name -> value, of the options that change pixels; `files`: names of those that are
    files. also: values that affect pixels but are not recorded.
    """
    settings = {name: _plain(settings[name]) for name in sorted(settings)}
    passes = {step.name: {key: _plain(value) for key, value in step.instance.options.items()}
              for step in plan.steps}
    place = {"name": device.name, "provider": str(device.placement), "threads": device.threads}
    library = Library()
    models = {name: library.sha256(name) for name in library.names()}
    foreign = {step.instance.name for step in plan.steps if step.instance.name not in BUILT_IN}
    # looking through all installed packages takes milliseconds
    packages = (plug_ins() if foreign else {})
    used = versions() | {f"pass {name}": packages[name]
                         for name in sorted(foreign & packages.keys())}
    for step in plan.steps:
        used |= step.instance.packages()
    own = [_hashes_of(value) for step in plan.steps for value in step.instance.options.values()]
    # pixels are the same by any number
    where = {key: value for key, value in place.items() if key != "threads"}
    decisive = [settings, passes, used, where, plan.as_dict(), models, own, *also]
    text = json.dumps(decisive, sort_keys=True, default=str)
    return Provenance(settings, passes, used, place, hashlib.sha256(text.encode()).hexdigest(),
                      files)


def _hashes_of(option: Any) -> dict[str, str]:
    """Hashes of the models that an option of a pass names, with those that lie beside them: by
    name."""
    path = Path(os.path.expanduser(option)) if isinstance(option, str | Path) else Path()
    if isinstance(option, str) and path.suffix == ".onnx" and os.path.isfile(path):
        option = Library(path.parent)
    if isinstance(option, Path) and os.path.isdir(path):
        option = Library(path)
    return ({name: option.sha256(name) for name in option.names()} if isinstance(option, Library)
            else {})


def versions() -> dict[str, str]:
    """Versions of postfx and of the libraries that affect its pixels."""
    installed = {name: _find_version(name) for name in ("onnxruntime", "onnxruntime-gpu")}
    return {"postfx": __version__, "python": platform.python_version(), "numpy": numpy.__version__,
            "OpenImageIO": OpenImageIO.VERSION_STRING,
            **{name: version for name, version in installed.items() if version}}


def _find_version(name: str) -> str | None:
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return None


def _plain(value: Any) -> Any:
    return value if isinstance(value, str | int | float | bool | None) else str(value)


MANY_RERUN_FRAMES = 32
"""Number of frames run again from which a warning says how to run fewer."""


@dataclass(frozen=True)
class Options:
    """The user's options for a run's log, checkpoints and resuming.

    Attributes:
        log: file for JSON lines, or None.
        checkpoint: seconds of work between two checkpoints; None for none.
        rerun: finished frames to run again for the history of an unfinished one; None for as many
            as needed.
        preroll: frames to run before the first one of the sequence, and before each that does
            not follow the one before it; 'auto' for those that `find_preroll` finds.
    """

    log: str | None = None
    checkpoint: float | None = 30.0
    rerun: int | None = None
    preroll: int | str = AUTO_PREROLL


class Run:
    """A run, as a context manager around its frames.

    Raises RunError if another run writes the same files, WriteError if the folder cannot be
    written.

    Attributes:
        works: the frames to run, in order.
        skips: frames that need no work, and why.
        warnings: oddities of existing files.
        provenance: how its frames come about.
    """

    def __init__(self, outputs: OutputFiles, sequence: Sequence, pipeline: Pipeline, plan: Plan,
                 provenance: Provenance, options: Options) -> None:
        self.works: list[Work] = []
        self.skips: list[Skip] = []
        self.warnings: list[str] = []
        self._outputs = outputs
        self._sequence = sequence
        self._pipeline = pipeline
        self._plan = plan
        self.provenance, self._options = provenance, options
        self._id = f"{time.strftime('%Y%m%dT%H%M%SZ', time.gmtime())}-{os.urandom(4).hex()}"
        self._log = Log(options.log, self._id)
        self._pattern = outputs.pattern
        self._checkpointed = time.monotonic()
        self._written = 0

    def __enter__(self) -> Run:
        first = self._outputs.path(self._sequence.numbers[0])
        names = {path.name: number for number in self._sequence.numbers
                 for path in self._outputs.paths(number)}
        try:
            self._folder = RunFolder(first.parent, self._id, names)
        except OSError as error:
            self._log.close()
            raise refusal(first, error.strerror or str(error)) from error
        try:
            self._begin(names)
        except BaseException:
            self._folder.release()
            raise
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None,
                 _: object) -> None:
        status = ("finished" if kind is None else "stopped" if issubclass(kind, KeyboardInterrupt)
                  else "failed")
        finished = self._sequence.numbers if kind is None else ()
        try:
            self._folder.close({"status": status, "ended": now()}, finished, self._pattern)
        except WriteError:
            if kind is None:  # otherwise the error that ended the run matters more
                raise
        finally:
            code = 0 if error is None else error.exit_code if isinstance(error, Interrupted) else 2
            self._log("end", status=status, written=self._written, exit_code=code,
                      error=str(error) if error else None)
            self._log.close()

    def recall(self, work: Work, frame: Frame) -> None:
        """Restore the passes' history from a work's checkpoint."""
        assert work.checkpoint is not None, "recall needs a checkpoint"
        self._pipeline.recall(frame, load_checkpoint(work.checkpoint))
        self._log("recall", frame=work.number)

    def note_output(self, number: int, path: Path, frame: Frame, **facts: Any) -> None:
        """Record a file that was written; `frame` is the result, `facts` go to the log."""
        width, height = self._output_size
        output = self._folder.add_output(
            path, {"models": dict(self._pipeline.device.models)}, frame=number, width=width,
            height=height, inputs=self._inputs(number), starts=frame.reset)
        self._written += 1
        self._log("frame", frame=number, file=str(path), bytes=output.bytes, sha256=output.sha256,
                  **facts)

    def note_retry(self, number: int, error: ReadError) -> None:
        """Log a failed read that is tried again."""
        self._log("retry", frame=number, error=str(error))

    def end_frame(self, number: int, finish: Callable[[], None], is_last: bool) -> None:
        """End a frame; save a checkpoint if one is due, or if the run stops here before its last
        frame.

        `finish` waits until all files are written: a checkpoint is useless if the manifest lacks a
        file before it.
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
            size = self._folder.save(self._pattern, self.provenance.fingerprint, number, history,
                                     self._pipeline.device.memory.relax)
            self._log("checkpoint", frame=number, bytes=size,
                      ms=round(1000 * (time.monotonic() - begin), 1))
        except OSError as error:  # frames matter more than a checkpoint
            text = f"no checkpoint could be written: {error.strerror}"
            self.warnings += [] if text in self.warnings else [text]
            self._log("warning", text=text)

    def _begin(self, names: dict[str, int]) -> None:
        self.warnings = self._folder.warnings
        wanted = self._choose(names)
        pending = {name: Output(self._id, number)
                   for name, number in names.items() if number in wanted}
        facts = {**self.provenance.as_dict(), "command": sys.argv,
                 "process": Process.me().as_dict(),
                 "input": str(self._sequence.pattern), "output": self._pattern, "began": now()}
        self._folder.note({**facts, "status": "running"}, pending)
        self.works = self._schedule(wanted)
        self._log("begin", **facts, frames=len(names), wanted=len(wanted))
        for item in self.skips:
            self._log("skip", what=item.what, why=item.why)
        for text in self.warnings:
            self._log("warning", text=text)

    @cached_property
    def _output_size(self) -> tuple[int, int]:
        """Width and height of all files, as they are shown."""
        return self._sequence.shown_size(self._plan.output.width, self._plan.output.height)

    def _choose(self, names: dict[str, int]) -> set[int]:
        """Frames to write: all, or those whose file is missing or not as it should be."""
        if self._outputs.existing is not ExistingFiles.SKIP:
            return set(names.values())
        size = self._output_size
        before, wanted = self._folder.before, set()
        others = []
        for number in dict.fromkeys(names.values()):
            paths, inputs = self._outputs.paths(number), self._inputs(number)
            known = [before.outputs.get(path.name) for path in paths]
            found = [judge(path, one, size, inputs) for path, one in zip(paths, known, strict=True)]
            if not all(one.kept for one in found):
                wanted.add(number)
                continue
            there = (f"{paths[0]} exists and is" if len(paths) == 1
                     else " and ".join(map(str, paths)) + " exist and are")
            self.skips.append(Skip(f"frame {number}", f"{there} complete"))
            self.warnings += [f"{path} {one.why}"
                              for path, one in zip(paths, found, strict=True) if one.why]
            others += [number] if any(one and not self._is_alike(one) for one in known) else []
        if others:
            self.warnings.append("kept, though made with other settings, models or versions: "
                                 f"frames {format_frames(others)}; --overwrite makes them again")
        return wanted

    def _schedule(self, wanted: set[int]) -> list[Work]:
        """The frames to run in order: those that are wanted, and those before them that they need
        for their history."""
        numbers, options = self._sequence.numbers, self._options
        if not self._pipeline.remembers(self._plan):
            return [Work(number, True) for number in numbers if number in wanted]
        filled = fill_gaps(self._sequence, numbers, options.preroll)
        works = schedule(filled, wanted, self._known(), options.rerun, self._sequence.holds)
        again = sum(not work.write and work.number in numbers for work in works)
        if again > MANY_RERUN_FRAMES and options.rerun is None:
            self.warnings.append(f"{again} finished frames are run again, for the history "
                                 "of unfinished ones: --resume 8 runs fewer and gives nearly the "
                                 "same")
        if works and works[0].number == numbers[0] and not works[0].checkpoint:
            before = find_preroll(self._sequence, numbers[0], options.preroll)
            works = [Work(number, False) for number in before] + works
        return works

    def _known(self) -> EarlierRuns:
        """Shot starts and checkpoints of earlier runs with the same settings."""
        if self._outputs.existing is not ExistingFiles.SKIP:
            return EarlierRuns()
        starts = {output.frame for output in self._folder.before.outputs.values()
                  if output.starts and output.sha256 and self._is_alike(output)}
        return EarlierRuns(starts,
                           self._folder.checkpoints(self._pattern, self.provenance.fingerprint))

    def _is_alike(self, output: Output) -> bool:
        run = self._folder.before.runs.get(output.run, {})
        return run.get("fingerprint") == self.provenance.fingerprint

    def _inputs(self, number: int) -> dict[str, tuple[int, int]]:
        """Size and modification time of the files of a frame that exist, by path."""
        try:
            paths = self._sequence.inputs(number)
        except MissingFrameError:
            return {}
        found = {str(path): path.stat() for path in paths if os.path.isfile(path)}
        return {path: (status.st_size, status.st_mtime_ns) for path, status in found.items()}
