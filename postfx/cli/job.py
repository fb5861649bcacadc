"""One `postfx run`: its plan, the run itself, and the report on it."""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

from postfx.cli.frame_loop import FrameLoop, Observers, show
from postfx.cli.interruptions import Stop, check_sizes
from postfx.cli.later_frames import FirstFrame, later_frames
from postfx.cli.run_options import RUN
from postfx.cli.run_record import RunRecord
from postfx.cli.run_setup import RunSetup
from postfx.cli.summary import (
    Explanation,
    ExposureUsed,
    FrameProgress,
    Preparation,
    Report,
    describe_frames,
    describe_outputs,
    describe_sizes,
    describe_views,
    guides_in,
    warn_of_budget,
)
from postfx.cli.told import Told
from postfx.compiled.library import CompileWatch
from postfx.errors import PostfxError
from postfx.exposure import ExposureMeter
from postfx.frame import Role
from postfx.passes.denoise.remarks import NO_HISTORY_REMARK
from postfx.passes.partner import Partner
from postfx.runs.run import Options, Run, provenance_of
from postfx.runs.schedule import fill_gaps, find_preroll

if TYPE_CHECKING:
    from postfx.cli.report import RunReport
    from postfx.doctor.first_frames import FirstFrames
    from postfx.doctor.inspection import Inspection
    from postfx.tools.report.live import LiveViewer
    from postfx.tools.report.page import FrameCapture


class Job:
    """A run of `postfx run`.

    Raises PostfxError when the arguments, the first frame or the outputs do not fit together.

    Attributes:
        sequence: the input.
        kept: a line that says which channels of the input are written again.
    """

    def __init__(self, arguments: argparse.Namespace) -> None:
        self._arguments = arguments
        self._setup = setup = RunSetup(arguments)
        self.sequence, self.kept = setup.sequence, setup.kept
        self._record = RunRecord(ExposureUsed(str(arguments.exposure), setup.is_exposed))
        self._first = FirstFrame(setup.first, setup.plan, setup.channels, bool(arguments.size))
        self._record.noticed += self._compare(later_frames(setup.sequence, setup.first))
        self._has_compared = False
        self._capture = self._make_capture() if arguments.capture else None
        self._viewer = self._find_viewer()
        self._page = self._make_page() if arguments.report else None
        setup.check_outputs()  # after all options, whose mistakes matter more

    def explain(self) -> Explanation:
        """What would run."""
        setup, exposure = self._setup, self._record.exposure
        preroll = Options(**setup.values("run")).preroll
        before, between = [], []
        if setup.pipeline.remembers(setup.plan):
            before = find_preroll(self.sequence, setup.first, preroll)
            listed = self.sequence.numbers
            between = [number for number in fill_gaps(self.sequence, listed, preroll)
                       if number not in listed]
        return Explanation(setup.plan, self.sequence, setup.first, setup.skips, setup.run_up,
                           exposure if exposure.multipliers else self._exposure_of_first(), before,
                           between)

    def _exposure_of_first(self) -> ExposureUsed:
        """What --exposure says of the first frame, by its colour alone."""
        mode, own = str(self._arguments.exposure), self.sequence.reader()
        own.rewind()
        if self._setup.is_smooth or not self._setup.is_exposed:
            return ExposureUsed(mode, self._setup.is_exposed)
        first = self._setup.first
        frame = own.read(first, (Role.COLOUR,), ())
        used = {first: ExposureMeter(mode)(frame)}
        return ExposureUsed(mode, True, used, {first: frame.exposure or 0.0})

    def dry_run(self) -> tuple[list[Path], str]:
        """Files that a run would write, and a line on them."""
        files = self._setup.files
        paths = [path for number in self.sequence.numbers for path in files.paths(number)]
        return paths, describe_outputs(paths, self._arguments.overwrite)

    def headline(self) -> str:
        """Input, output and sizes, in a line."""
        outputs, plan = self._setup.outputs, self._setup.plan
        to = (f" to {outputs.path(self._setup.first).with_name(outputs.pattern)}" if outputs
              else "")
        sizes, views = describe_sizes(plan, self.sequence), describe_views(self.sequence)
        partner = "".join(f", with {step.instance.described()}" for step in plan.steps
                          if isinstance(step.instance, Partner))
        return (f"{self.sequence.pattern}{to}: {describe_frames(self.sequence)}, "
                f"{sizes}{views}{partner}")

    def run(self) -> None:
        """Process all frames; those that are written stay when a later one fails."""
        begin = None
        record = self._record
        progress = FrameProgress(len(self.sequence), self._arguments.quiet)
        watch = CompileWatch(progress.note_compilation)
        observers = Observers(self._capture, self._viewer, self._page, self._looker)
        loop = FrameLoop(self._setup, record, observers, progress, watch)
        try:
            with progress, watch, Stop(progress.note) as stop, self._open_run() as run, \
                    Told(lambda text: record.tell([text], progress.note)):
                record.noticed += run.warnings  # of files that are there: before the work
                run.warnings.clear()
                record.warnings = run.warnings
                self._setup.skips += run.skips
                loop.announce(run, self.headline())
                if run.works:
                    loop.prepare()
                begin = progress.start(len(run.skips), loop.count_unwritten(run.works))
                loop.process_all(run, stop)
        finally:
            if self._viewer:
                self._viewer.close()
                record.tell(filter(None, [self._viewer.notice()]), progress.note)
            prepared = record.preparation
            later = watch.seconds - prepared.compile_seconds
            record.seconds = time.perf_counter() - begin - later if begin else 0.0
            record.preparation = Preparation(prepared.seconds + later, watch.seconds, watch.count)

    def _open_run(self) -> Run:
        setup, arguments = self._setup, self._arguments
        # smooth exposure depends on which frames there are
        frames = sorted(self.sequence.numbers) if setup.is_smooth else None
        settings = RUN.settings(arguments)
        if not isinstance(arguments.input, str):  # files one by one
            settings["input"] = str(self.sequence.pattern)
        provenance = provenance_of(
            settings, setup.plan, setup.pipeline.device,
            [frames, *RUN.settings(arguments, "rounding").values()],
            [one.name for one in RUN if one.is_file])
        return Run(setup.files, self.sequence, setup.pipeline, setup.plan, provenance,
                   Options(**setup.values("run")))

    def preview(self, number: int, step: int, tell: Callable[[str], None]) -> Path:
        """Read, process and write one frame without an entry in the manifest; returns the file. The
        frame has the history of those that were previewed before. step: from one frame to the next.
        Raises PostfxError."""
        setup, record = self._setup, self._record
        self.sequence.look_again(step)
        if number == setup.first:
            record.tell([*setup.plan.remarks, *self.sequence.warnings], tell)
        elif not self._has_compared:
            self._has_compared = True
            record.tell(self._compare([number]), tell)
        frame = self.sequence.read(number, setup.plan.planes, setup.guides)
        check_sizes(frame, setup.plan.input, bool(self._arguments.size))
        if self._looker and not self._looker.is_done:
            record.tell(self._looker.look(frame), tell)
        result = setup.pipeline(frame)
        record.tell([f"frame {number}: {text}" for text in setup.pipeline.noticed], tell)
        for path, picture in setup.files.split(result):
            setup.write(path, picture)
            show(self._viewer, path, picture, record, tell)
        return setup.files.path(number)

    def report(self, failure: BaseException | None = None) -> Report:
        """What happened so far."""
        setup, record = self._setup, self._record
        return Report(
            frames=record.frames,
            total=len(self.sequence),
            seconds=record.seconds,
            preparation=record.preparation,
            frame_ms=record.frame_ms,
            pass_ms=record.pass_ms,
            ahead_ms=record.ahead_ms,
            skips=[*setup.plan.skips, *setup.skips, *setup.pipeline.savings()],
            warnings=[*self._remarks(), *self.sequence.warnings, *record.warnings, *record.noticed,
                      *(self._capture.warnings if self._capture else ()),
                      *record.exposure.warnings(),
                      *warn_of_budget(self._arguments.budget, record.pass_ms, record.choices)],
            choices={name: dict(counts) for name, counts in record.choices.items()},
            pixel_filter=setup.undone_stddev,
            outputs=record.written,
            told=record.noticed,
            guides=guides_in(setup.plan, {"scale", "size"} & {*setup.values("denoiser")} != set()),
            exposure=record.exposure,
            cuts=record.cuts,
            coverage=self.sequence.coverage,
            fireflies=self.sequence.fireflies,
            bad_pixels=record.bad_pixels,
            capture=self._capture.page if self._capture else None,
            faults=setup.faults.found,
            error=str(failure) or "interrupted" if failure is not None else None,
        )

    def write_page(self, report: Report) -> Report:
        """Write the page that --report asks for; the report with its path."""
        return self._page.write(report, str(self.explain())) if self._page else report

    def _remarks(self) -> list[str]:
        """What the passes remark; a still cannot flicker."""
        return [remark for remark in self._setup.plan.remarks
                if not (self._setup.is_still and NO_HISTORY_REMARK in remark)]

    def _compare(self, numbers: list[int]) -> list[str]:
        """Warnings where frames do not hold what the first one does."""
        return self._first.compare(self.sequence, self._setup.pipeline, numbers)

    # What looks at the frames. Each loads modules that other runs need not wait for.

    @cached_property
    def _looker(self) -> FirstFrames | None:
        """Looks for plain mistakes in the first frames; None where AOVs are not read, so that none
        is missing."""
        setup, device = self._setup, self._setup.pipeline.device
        if self._arguments.no_denoise or self._arguments.strength == 0 or device.scratch:
            return None
        from postfx.doctor.first_frames import FirstFrames

        return FirstFrames(setup.channels, setup.enable, not device.memory.host_visible,
                           leaves_filters=setup.leaves_filters)

    def _make_capture(self) -> FrameCapture:
        from postfx.tools.report.page import FrameCapture

        return FrameCapture(self._setup.pipeline.device, check=not self._arguments.explain,
                            **self._setup.values("capture"))

    def _find_viewer(self) -> LiveViewer | None:
        if self._arguments.live is None or self._arguments.explain:
            return None
        from postfx.tools.report.live import LiveViewer

        return LiveViewer(self._arguments.live)

    def _make_page(self) -> RunReport:
        from postfx.cli.report import RunReport

        return RunReport(self.sequence, self._setup.pipeline, self._setup.plan, self._inspect,
                         check=not self._arguments.explain, **self._setup.values("page"))

    def _inspect(self, numbers: list[int], view: str | None) -> Inspection:
        """What `postfx inspect` finds in a view of the input; from the first of these frames on
        that can be read whole, if the sequence's own first one cannot."""
        from postfx.doctor.inspection import Inspection

        given, listed = self._arguments, self.sequence.numbers
        for number in (listed[0], *numbers):
            frames = listed[listed.index(number):]
            try:
                return Inspection(given.input, frames, given.profile, given.guides, given.depth,
                                  given.colourspace, given.layer, view or self.sequence.view)
            except PostfxError:
                if number == numbers[-1]:
                    raise
        raise AssertionError("a page has a frame")
