"""The loop over the frames of a run: the next is read and the last written while one is
processed."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable
from contextlib import nullcontext
from functools import cached_property, partial
from math import log2
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from postfx.cli.interruptions import OnError, Stop, check_sizes
from postfx.cli.run_record import RunRecord
from postfx.cli.run_setup import RunSetup
from postfx.cli.summary import (
    FrameProgress,
    FrameResult,
    Preparation,
    describe_between,
    describe_preroll,
)
from postfx.compiled.library import CompileWatch
from postfx.cuts import CutDetector
from postfx.errors import PostfxError
from postfx.exposure import APPLIED, USED_EXPOSURE_ATTRIBUTE, measure
from postfx.files import WriteBehind, read_ahead, read_patiently
from postfx.frame import Frame, Role
from postfx.io.pattern import format_frames
from postfx.runs.run import Run
from postfx.runs.schedule import Work
from postfx.temporal.reverse_order import Backwards

if TYPE_CHECKING:
    from postfx.cli.report import RunReport
    from postfx.doctor.first_frames import FirstFrames
    from postfx.tools.report.live import LiveViewer
    from postfx.tools.report.page import FrameCapture


class Observers(NamedTuple):
    """What looks at the frames of a run; None for what nobody asked for.

    Attributes:
        capture: keeps all that was computed for some frames.
        viewer: shows frames while they are made.
        page: the page of the whole run.
        looker: looks for plain mistakes in the first frames.
    """

    capture: FrameCapture | None
    viewer: LiveViewer | None
    page: RunReport | None
    looker: FirstFrames | None


class FrameLoop:
    """Processes the frames of a run in order.

    Args:
        setup: what is read, runs and is written.
        record: gets what happens.
        observers: look at the frames.
        progress: tells how far the run is.
        watch: counts the seconds in which kernels are compiled.
    """

    def __init__(self, setup: RunSetup, record: RunRecord, observers: Observers,
                 progress: FrameProgress, watch: CompileWatch) -> None:
        self._setup = setup
        self._record = record
        self._observers = observers
        self._progress = progress
        self._watch = watch

    def announce(self, run: Run, headline: str) -> None:
        """Print what will be made, which frames are missing, and what delays the first frame.

        MissingFrameError where missing frames stop the run: before the first one, not hours later.
        """
        setup, note = self._setup, self._progress.note
        note(headline)
        if setup.arguments.verbose:
            for line in str(setup.plan).splitlines():
                note(line)
        wanted = [work.number for work in run.works if work.write]
        listed = setup.sequence.numbers
        others = [work.number for work in run.works if work.number not in listed]
        before = [number for number in others if number < listed[0]]
        between = [number for number in others if number > listed[0]]
        if before:
            note(f"{describe_preroll(before)} for the history of frame {listed[0]} "
                 "(--preroll 0 leaves it out)")
        if between:
            note(describe_between(between))
        if setup.arguments.on_error == OnError.STOP:
            setup.sequence.refuse_holes(wanted)
        elif missing := [number for number in wanted if not setup.sequence.holds(number)]:
            are = "is" if len(missing) == 1 else "are"
            note(f"{len(missing)} of {len(wanted)} frames {are} missing, --on-error "
                 f"{setup.arguments.on_error} goes on without: {format_frames(missing)}")
        for text in self._record.noticed:
            note(f"warning  {text}")
        if setup.is_smooth:
            note("metering all frames first, for --exposure smooth")

    def prepare(self) -> None:
        """Load networks and compile kernels before the clock starts. It pauses for the few that are
        known only once a frame runs."""
        setup, begin = self._setup, time.perf_counter()
        if setup.plan.steps:
            setup.pipeline.compile(setup.plan.input, setup.sequence.views)
        if self._watch.count:
            self._warm_up()
        self._record.preparation = Preparation(time.perf_counter() - begin, self._watch.seconds,
                                               self._watch.count)

    def _warm_up(self) -> None:
        """Compile what no pass compiles ahead: metering, the search for cuts, the files'
        encoding."""
        frame = Frame({Role.COLOUR: np.ones((32, 32, 3), np.float32),
                       Role.MOTION: np.zeros((32, 32, 2), np.float32)})
        measure(frame[Role.COLOUR])
        detector = CutDetector()
        for _ in range(2):
            detector(frame)
        suffix = self._setup.files.path(self._setup.first).suffix
        with tempfile.TemporaryDirectory(prefix="postfx-") as folder:
            self._setup.write(Path(folder) / f"any{suffix}", frame)

    def count_unwritten(self, works: list[Work]) -> int:
        """Frames that run and are not written, as far as they are known before the first one: in a
        run-up, for the history, and in reverse order."""
        setup = self._setup
        ran = [work for work in works if not work.checkpoint]
        count = sum(not work.write for work in ran)
        if works and setup.run_up and not works[0].checkpoint and setup.plan.accumulating_steps():
            views = 1 + len(setup.sequence.views)
            count += len(setup.run_up.after(works[0].number)) * views
        if setup.backwards:
            count += setup.backwards.count([work.number for work in ran if work.write])
        return count

    def process_all(self, run: Run, stop: Stop) -> None:
        """Process a run's frames: they are read ahead, and written behind."""
        setup, observers = self._setup, self._observers
        if setup.run_up:
            setup.run_up.on_frame = announce_run_up(stop.check, self._progress.note)
        if observers.capture:
            observers.capture.choose([work.number for work in run.works])
        if observers.page:
            observers.page.choose([work.number for work in run.works if work.write])
        capturing = observers.capture.around if observers.capture else nullcontext
        # whether the passes have not seen the frame before, as it could not be read, or as looking
        # ahead of it failed
        is_unseen = False
        with WriteBehind() as behind:
            for work, frame in read_ahead(run.works, partial(self._read, run)):
                if frame is not None:
                    frame.reset = frame.reset or is_unseen
                is_unseen = frame is None
                if work.checkpoint:
                    if frame is not None:  # else the next one begins without a history
                        run.recall(work, frame)
                    continue
                if frame is not None:
                    self._look(frame)
                    if setup.backwards:
                        ahead = partial(self._look_ahead, setup.backwards, frame, work.write, stop)
                        frame = setup.faults.attempt(work.number, work.write, ahead)
                        is_unseen = frame is None
                with capturing(work.number):
                    done = None if frame is None else self._process(work, frame)
                if done is None and work.write:
                    done = setup.faults.substitute(work.number)
                if work.write and done:
                    if observers.page:
                        observers.page.add(done)
                    behind.put(partial(self._write, run, done))
                run.end_frame(work.number, behind.wait, is_last=stop.signal is not None)
                stop.check()

    def _read(self, run: Run, work: Work) -> Frame | None:
        """A frame; None if it cannot be read and the run goes on."""
        read = partial(self._read_checked, run, work.number)
        if work.number in self._setup.sequence.numbers:
            return self._setup.faults.attempt(work.number, work.write, read)
        try:
            return read()
        except PostfxError as error:  # of a frame that nobody asked for
            self._record.warnings.append(f"the history begins after frame {work.number}: {error}")
            return None

    def _read_checked(self, run: Run, number: int) -> Frame:
        setup = self._setup
        read = partial(setup.sequence.read, number, setup.plan.planes, setup.guides,
                       self._holds_rows)
        frame = read_patiently(read, partial(run.note_retry, number))
        check_sizes(frame, setup.plan.input, bool(setup.arguments.size))
        return frame

    @cached_property
    def _holds_rows(self) -> bool:
        """Whether frames hold what was unpacked of their files: where outputs keep channels of them
        bit for bit, and nothing limits memory or keeps frames for longer."""
        setup = self._setup
        sizes = [(spec.width, spec.height) for spec in (setup.plan.available, setup.plan.output)]
        keeps = (setup.outputs is not None and not setup.outputs.display
                 and setup.format["keep"] is not False and sizes[0] == sizes[1])
        return keeps and not (setup.pipeline.device.scratch or self._observers.page)

    def _look(self, frame: Frame) -> None:
        """Tell of plain mistakes in the first frames at once, not after a night."""
        looker = self._observers.looker
        if looker and not looker.is_done:
            self._record.tell(looker.look(frame, self._setup.is_still), self._progress.note)

    def _look_ahead(self, backwards: Backwards, frame: Frame, write: bool, stop: Stop) -> Frame:
        """The frame with what those after it make of it, for --both-ways."""
        part = backwards.part(frame.number) if write else None
        if part and part[0] != part[1]:  # may take long
            self._progress.note(f"frames {part[1]} to {part[0]} first, in reverse order")
        begin = time.perf_counter()
        found = backwards(frame, write, stop.check)
        if part:
            self._progress.pass_by(backwards.count([frame.number]), time.perf_counter() - begin)
        return found

    def _process(self, work: Work, frame: Frame) -> FrameResult | None:
        """A frame after the passes; None if they failed and the run goes on."""
        setup, record = self._setup, self._record
        begin, passes, compiling = time.perf_counter(), setup.pipeline, self._watch.seconds
        result = setup.faults.attempt(work.number, work.write, partial(passes, frame))
        if result is None:
            return None
        record.ahead_ms += passes.ahead
        if passes.cut:
            record.cuts.append(work.number)
        record.tell([f"frame {work.number}: {text}" for text in passes.noticed],
                    self._progress.note)
        milliseconds = (time.perf_counter() - begin - (self._watch.seconds - compiling)) * 1000
        milliseconds -= passes.run_up_ms
        self._progress.pass_by(len(passes.ahead), passes.run_up_ms / 1000)
        if not work.write:
            self._progress.pass_by(1, milliseconds / 1000)
        backwards_ms = setup.backwards.milliseconds if setup.backwards else None
        milliseconds += backwards_ms or 0.0
        done = FrameResult(frame, result, passes.exposure_factor, passes.cut, milliseconds,
                           passes.timings, passes.bad_pixels)
        if work.write:
            record.note_processed(done, setup.plan, milliseconds, backwards_ms)
        return done

    def _write(self, run: Run, done: FrameResult) -> None:
        """Write a frame's files, and note what was written."""
        setup = self._setup
        number, used = done.source.number, done.exposure_factor
        told = ({} if used is None
                else {APPLIED if setup.is_exposed else USED_EXPOSURE_ATTRIBUTE: log2(used)})
        facts, paths = done.facts(), []
        for path, picture in setup.files.split(done.result):
            provenance: dict[str, str | float] = {
                **run.provenance.header(setup.pipeline.device.models), **told
            }
            write = partial(setup.write, path, picture, provenance)
            if setup.faults.attempt(number, True, write) is None:
                return
            run.note_output(number, path, picture, **facts)
            show(self._observers.viewer, path, picture, self._record, self._progress.note)
            facts = {}  # those of a frame are told once
            paths.append(str(path))
        self._record.note_written(done, paths)
        self._progress.advance(" ".join(paths), self._watch.seconds
                               - self._record.preparation.compile_seconds)
        if setup.arguments.verbose:
            spent = [f"{name} {elapsed:.1f} ms" for name, elapsed in done.passes.items()]
            stops = [] if used is None else [f"exposure {log2(used):+.2f} EV"]
            self._progress.note(f"frame {number}: "
                                f"{', '.join([*spent, *stops]) or 'only its picture, enlarged'}")


def show(viewer: LiveViewer | None, path: Path, picture: Frame, record: RunRecord,
         tell: Callable[[str], None]) -> None:
    """Show a picture in a viewer, if there is one, and tell what it notices."""
    if viewer:
        viewer.show(str(path), picture)
        record.tell(filter(None, [viewer.notice()]), tell)


def announce_run_up(check: Callable[[], None],
                    tell: Callable[[str], None]) -> Callable[[int, int], None]:
    """A function to call before each frame of a run-up, with the number of the frame that it leads
    to and its own.

    `check` may raise to end the run; `tell` gets a line before the first frame, as a run-up may
    take long.
    """
    told: int | None = None

    def before_frame(first: int, other: int) -> None:
        nonlocal told
        check()
        if first != told:
            tell(f"frames {other} back to {first} first, unwritten, so that frame {first} is as "
                 "clean as the others (--run-up 0 leaves them out)")
        told = first

    return before_frame
