"""One `postfx run`: what to read, run and write, and the loop over the frames."""

from __future__ import annotations

import argparse
import dataclasses
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterable
from contextlib import ExitStack, nullcontext
from functools import cached_property, partial
from math import log2
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from postfx.cli.interruptions import (
    Faults,
    OnError,
    Standin,
    Stop,
    check_memory,
    check_sizes,
    first_readable,
)
from postfx.cli.run_options import (
    RUN,
    explain_kept,
    explain_overlay,
    find_partner,
    make_run_up,
    refuse_layer,
    refuse_views,
)
from postfx.cli.summary import (
    Explanation,
    ExposureUsed,
    FrameProgress,
    FrameResult,
    Preparation,
    Report,
    describe_between,
    describe_frames,
    describe_outputs,
    describe_preroll,
    describe_sizes,
    describe_views,
    guides_in,
    warn_of_budget,
)
from postfx.cli.told import Told
from postfx.cli.usual_network import choose_network, choose_pixel_filter, is_chosen
from postfx.compiled.library import CompileWatch
from postfx.cuts import CutDetector
from postfx.errors import OptionError, PostfxError, WriteError
from postfx.exposure import (
    APPLIED,
    SMOOTH_MODE,
    USED_EXPOSURE_ATTRIBUTE,
    ExposureMeter,
    SmoothExposure,
    colours_of,
    measure,
)
from postfx.files import WriteBehind, read_ahead, read_patiently
from postfx.frame import Frame, FrameSpec, Part, Role
from postfx.io.parts import group_parts
from postfx.io.pattern import format_frames
from postfx.io.read_options import ESTIMATED_MOTION
from postfx.io.sequence import Sequence, read_sequence
from postfx.io.writer import ExistingFiles, OutputFiles, write_frame
from postfx.passes import Pass
from postfx.passes.denoise import DenoiseUpscale
from postfx.passes.denoise.default_network import USUAL_NETWORK
from postfx.passes.denoise.options import enlargement
from postfx.passes.denoise.remarks import NO_HISTORY_REMARK
from postfx.passes.display import is_shown, make_display_passes
from postfx.passes.exposure_tool import asked_form
from postfx.passes.partner import Partner
from postfx.passes.registry import create, insert_passes, parse_pass
from postfx.pipeline import Pipeline
from postfx.plan import Skip, from_files
from postfx.runs.run import Options, Run, provenance_of
from postfx.runs.schedule import Work, fill_gaps, find_preroll
from postfx.runtime import Device
from postfx.temporal.plain_albedo import is_plain
from postfx.temporal.reverse_order import Backwards
from postfx.wrap import WRAP_AROUND, WRAP_AUTO, WRAP_NONE, is_panorama

if TYPE_CHECKING:
    from postfx.cli.report import RunReport
    from postfx.doctor.first_frames import FirstFrames
    from postfx.doctor.inspection import Inspection
    from postfx.tools.report.live import LiveViewer
    from postfx.tools.report.page import FrameCapture

NOWHERE = "nowhere to write: give -o OUTPUT, e.g. -o out/clean.####.exr"
BACKWARDS = "denoise_upscale backwards"
"""Name of the run in reverse order, in the summary."""


class Job:
    """Everything that the arguments of `postfx run` ask for.

    Raises PostfxError when the arguments, the first frame or the outputs do not fit together.
    """

    def __init__(self, arguments: argparse.Namespace) -> None:
        RUN.refuse_conflicts(arguments)
        self._arguments = arguments
        device = Device(**self._values("device"))
        self._relax = device.memory.relax
        self.skips: list[Skip] = []
        if arguments.yielded:
            self.skips.append(Skip(f"{' '.join(arguments.yielded)} of --preset {arguments.preset}",
                                   "other options that are given do not go with it"))
        policy = OnError(arguments.on_error)

        # What is read and written.
        self.sequence = read_sequence(arguments.input, arguments.frames, scratch=device.scratch,
                                      **self._values("sequence"))
        self.outputs = _outputs(arguments, self.sequence)
        refuse_layer(arguments, self.outputs)
        self._refuse_error_in_pictures()
        if policy is OnError.STOP and not (arguments.explain or arguments.skip_existing):
            self.sequence.refuse_holes(self.sequence.numbers)
        self._smooth = arguments.exposure == SMOOTH_MODE
        exposure = (SmoothExposure(colours_of(self.sequence, policy is not OnError.STOP))
                    if self._smooth else ExposureMeter(arguments.exposure))
        # before any file is opened, which tells of it
        native = not is_shown(self._is_picture, **self._values("look"))
        self.sequence.colours = dataclasses.replace(self.sequence.colours, native=native)
        self.first = first_readable(self.sequence, OnError.SKIP if arguments.explain else policy)

        # What runs.
        cuts = "auto" if arguments.cuts == "auto" else "none"
        denoising = None if arguments.no_denoise else self._denoiser_options(device)
        is_covered = asked_form() == "whole"  # by a checkerboard, under which nothing is denoised
        both_ways = self._goes_both_ways() and not is_covered
        wrap = self._find_wrap()
        self._backwards = (Backwards(self.sequence, device,
                                     exposure if self._smooth else arguments.exposure, cuts,
                                     wrap=wrap, **denoising | {"error": False})
                           if denoising is not None and both_ways else None)
        self._run_up = None if is_covered else make_run_up(arguments, self.sequence, cuts)
        self._parts = self._find_parts()
        partner = None if is_covered else self._find_partner(denoising)
        passes, skips = self._passes(denoising, self._backwards is not None, partner)
        self.skips += skips
        # without checks, as `_looker` does them, which knows the files
        self.pipeline = Pipeline(passes, device, exposure, cuts, self._run_up, checks=False,
                                 wrap=wrap)
        refuse_views(self.sequence, self.outputs)
        self._explain_first_frame()
        if (not arguments.explain and arguments.model != "classic" and device.memory.host_visible
            and not device.scratch):
            check_memory(self.plan, self.sequence)
        self._guides = from_files(self.plan.guides)
        self._format = self._values("writer")
        standin = None
        if policy is OnError.COPY:
            plain, _ = self._passes(None if denoising is None else self._resample_options())
            standin = Standin(self.sequence, plain, device, exposure)
        self._faults = Faults(policy, standin)

        # What looks at it.
        self._noticed = self._planes_of_later_frames(self._later_frames())
        self._has_compared = False
        self._capture = self._make_capture(device) if arguments.capture else None
        self._viewer = self._find_viewer()
        self._page = self._make_page() if arguments.report else None
        if self.outputs:
            self.outputs.check_storage(self.plan.output.encoding, arguments.bits,
                                       arguments.compression)
            if not arguments.explain:  # after all options, whose mistakes matter more
                self.outputs.check(self.sequence.numbers)

        # What a run has told and taken so far.
        self._warnings: list[str] = []
        self._seconds = 0.0
        self._preparation = Preparation()
        self._exposure = ExposureUsed(str(arguments.exposure), self._is_exposed)
        self._frame_ms: list[float] = []
        self._ahead_ms: list[float] = []
        self._pass_ms: dict[str, list[float]] = {}
        self._choices: dict[str, Counter[str]] = {}
        self._cuts: list[int] = []
        self._bad_pixels: dict[str, dict[str, int]] = {}
        self._written: list[str] = []
        self._frames = 0  # written

    @property
    def _is_picture(self) -> bool:
        """Whether the output is a picture for a display."""
        return self.outputs is not None and self.outputs.display

    def _refuse_error_in_pictures(self) -> None:
        """OptionError where the AOV 'error' is asked for, and the output cannot hold it."""
        if self._arguments.no_denoise or not self._is_picture:
            return
        if self._values("denoiser").get("error"):
            raise OptionError(f"{self._arguments.output}: pictures for a display hold no AOV "
                              "'error': write EXR, or leave error out of --aov")

    def _goes_both_ways(self) -> bool:
        """Whether the denoiser is to run in both directions: not if albedo shows no textures, which
        is noted."""
        if self._arguments.both_ways and self._has_plain_albedo():
            self._arguments.both_ways = False
            self.skips.append(Skip("both_ways", "albedo shows no textures, so that more history in "
                                                "one order shows more of them"))
        return bool(self._arguments.both_ways) and self._arguments.strength != 0

    def _find_partner(self, denoising: dict[str, Any] | None) -> str | None:
        """The other denoiser that runs beside ours, None for none. denoising: options of ours, None
        where it does not run."""
        if denoising is None or self._arguments.strength == 0:
            return None
        enlarges = enlargement(self._first_spec, denoising) > 1
        partner, lack = find_partner(getattr(self._arguments, "with"), enlarges)
        self.skips += [Skip("Open Image Denoise", lack)] if lack else []
        return partner

    def _explain_first_frame(self) -> None:
        """Make the plan by the first frame's files, and settle what of them is written again."""
        with ExitStack() as stack:
            files = stack.enter_context(self.sequence.open(self.first))
            self.skips += explain_overlay(self._arguments, files)
            self._channels = {role: match.names for role, match in files.layout.planes.items()}
            self._enable = files.layout.hints()
            if self.sequence.options.motion == ESTIMATED_MOTION:  # which is no fault of the files
                self._enable.pop(Role.MOTION, None)
            spec = files.spec()
            self.plan = self.pipeline.explain(self._backwards.spec(spec) if self._backwards
                                              else spec)
            others = [stack.enter_context(self.sequence.reader(view).open(self.first))
                      for view in self.sequence.views]
            size = self.plan.output.width, self.plan.output.height
            self.kept, skips = explain_kept(self._arguments, files, size, others)
            self.skips += skips

    def _values(self, part: str) -> dict[str, Any]:
        return RUN.values_for(part, self._arguments)

    def _denoiser_options(self, device: Device) -> dict[str, Any]:
        """The denoiser's options. They name the pixel filter that is undone, and without --model
        the network that is best, unless time or memory is bounded."""
        given = self._values("denoiser")
        if not is_chosen(self._arguments, given):
            choice = choose_network(self._first_spec, given, device)
            if choice.lack:
                self.skips.append(Skip("the best network", choice.lack))
            given["model"] = choice.network
        elif "model" not in given:
            bound = "--memory" if self._arguments.budget is None else "--budget"
            self.skips.append(Skip("the best network", f"{bound} takes {USUAL_NETWORK} unless "
                                                       "--model names another"))
        return {**given, "pixel_filter": choose_pixel_filter(self.sequence, self.first, given)}

    def _has_plain_albedo(self) -> bool:
        """Whether the first frame's diffuse albedo shows none of the textures: a default, an
        override material, or one colour for each object."""
        with self.sequence.open(self.first) as files:
            if not files.spec().has(Role.DIFFUSE_ALBEDO):
                return False
            planes = files.read(self.first, [Role.DIFFUSE_ALBEDO, Role.COLOUR], []).planes
        return {Role.DIFFUSE_ALBEDO, Role.COLOUR} <= planes.keys() and is_plain(
            planes[Role.DIFFUSE_ALBEDO], planes[Role.COLOUR])

    def _find_wrap(self) -> str:
        """Whether frames are panoramas, by the option or the first frame's header, as the pipeline
        names it."""
        if self._arguments.wrap != WRAP_AUTO:
            return str(self._arguments.wrap)
        with self.sequence.open(self.first) as files:
            return WRAP_AROUND if is_panorama(files.layout.attributes) else WRAP_NONE

    def _make_capture(self, device: Device) -> FrameCapture:
        # It loads pages, which other runs need not wait for.
        from postfx.tools.report.page import FrameCapture

        return FrameCapture(device, check=not self._arguments.explain, **self._values("capture"))

    def _find_viewer(self) -> LiveViewer | None:
        if self._arguments.live is None or self._arguments.explain:
            return None
        # It loads sockets, which other runs need not wait for.
        from postfx.tools.report.live import LiveViewer

        return LiveViewer(self._arguments.live)

    def _make_page(self) -> RunReport:
        # It loads the doctor and charts, which other runs need not wait for.
        from postfx.cli.report import RunReport

        return RunReport(self.sequence, self.pipeline, self.plan, self._inspect,
                         check=not self._arguments.explain, **self._values("page"))

    def explain(self) -> Explanation:
        """What would run."""
        exposure = self._exposure if self._exposure.multipliers else self._exposure_of_first()
        preroll = Options(**self._values("run")).preroll
        before, between = [], []
        if self.pipeline.remembers(self.plan):
            before = find_preroll(self.sequence, self.first, preroll)
            listed = self.sequence.numbers
            between = [number for number in fill_gaps(self.sequence, listed, preroll)
                       if number not in listed]
        return Explanation(self.plan, self.sequence, self.first, self.skips, self._run_up, exposure,
                           before, between)

    def _exposure_of_first(self) -> ExposureUsed:
        """What --exposure says of the first frame, by its colour alone."""
        mode, own = str(self._arguments.exposure), self.sequence.reader()
        own.rewind()
        if self._smooth or not self._is_exposed:
            return ExposureUsed(mode, self._is_exposed)
        frame = own.read(self.first, (Role.COLOUR,), ())
        used = {self.first: ExposureMeter(mode)(frame)}
        return ExposureUsed(mode, True, used, {self.first: frame.exposure or 0.0})

    @property
    def _is_exposed(self) -> bool:
        """Whether the exposure is in the pixels that are written."""
        return self.plan.output.encoding != self.plan.input.encoding

    def dry_run(self) -> tuple[list[Path], str]:
        """Files that a run would write, and a line on them."""
        paths = [path for number in self.sequence.numbers for path in self._files().paths(number)]
        return paths, describe_outputs(paths, self._arguments.overwrite)

    def headline(self) -> str:
        """Input, output and sizes, in a line."""
        to = (f" to {self.outputs.path(self.first).with_name(self.outputs.pattern)}" if self.outputs
              else "")
        sizes, views = describe_sizes(self.plan, self.sequence), describe_views(self.sequence)
        partner = "".join(f", with {step.instance.described()}" for step in self.plan.steps
                          if isinstance(step.instance, Partner))
        return (f"{self.sequence.pattern}{to}: {describe_frames(self.sequence)}, "
                f"{sizes}{views}{partner}")

    def run(self) -> None:
        """Process all frames; the next is read and the last written meanwhile, and stays when a
        later one fails."""
        begin = None
        progress = FrameProgress(len(self.sequence), self._arguments.quiet)
        self._watch = CompileWatch(progress.note_compilation)
        try:
            with progress, self._watch, Stop(progress.note) as stop, self._open_run() as run, \
                    Told(lambda text: self._tell([text], progress.note)):
                self._warnings = run.warnings
                self.skips += run.skips
                self._announce(run, progress)
                if run.works:
                    self._prepare()
                begin = progress.start(len(run.skips), self._count_unwritten(run.works))
                self._process_all(run, stop, progress)
        finally:
            if self._viewer:
                self._viewer.close()
                self._tell(filter(None, [self._viewer.notice()]), progress.note)
            later = self._watch.seconds - self._preparation.compile_seconds
            self._seconds = time.perf_counter() - begin - later if begin else 0.0
            self._preparation = Preparation(self._preparation.seconds + later, self._watch.seconds,
                                            self._watch.count)

    def preview(self, number: int, step: int, tell: Callable[[str], None]) -> Path:
        """Read, process and write one frame without an entry in the manifest; returns the file. The
        frame has the history of those that were previewed before. step: from one frame to the next.
        Raises PostfxError."""
        self.sequence.look_again(step)
        if number == self.first:
            self._tell([*self.plan.remarks, *self.sequence.warnings], tell)
        elif not self._has_compared:
            self._has_compared = True
            self._tell(self._planes_of_later_frames([number]), tell)
        frame = self.sequence.read(number, self.plan.planes, self._guides)
        check_sizes(frame, self.plan.input, bool(self._arguments.size))
        if self._looker and not self._looker.is_done:
            self._tell(self._looker.look(frame), tell)
        result = self.pipeline(frame)
        for text in self.pipeline.noticed:
            self._tell([f"frame {number}: {text}"], tell)
        for path, picture in self._files().split(result):
            write_frame(path, picture, relax=self._relax, **self._format)
            if self._viewer:
                self._viewer.show(str(path), picture)
                self._tell(filter(None, [self._viewer.notice()]), tell)
        return self._files().path(number)

    def _undone_stddev(self) -> float:
        """The standard deviation in pixels of the pixel filter that the denoiser undoes; 0 for
        none."""
        return max((step.instance.undone_stddev(self.plan.input) for step in self.plan.steps
                    if isinstance(step.instance, DenoiseUpscale)), default=0.0)

    def report(self, failure: BaseException | None = None) -> Report:
        """What happened so far."""
        return Report(
            frames=self._frames,
            total=len(self.sequence),
            seconds=self._seconds,
            preparation=self._preparation,
            frame_ms=self._frame_ms,
            pass_ms=self._pass_ms,
            ahead_ms=self._ahead_ms,
            skips=[*self.plan.skips, *self.skips, *self.pipeline.savings()],
            warnings=[*self._remarks(), *self.sequence.warnings, *self._warnings, *self._noticed,
                      *(self._capture.warnings if self._capture else ()),
                      *self._exposure.warnings(),
                      *warn_of_budget(self._arguments.budget, self._pass_ms, self._choices)],
            choices={name: dict(counts) for name, counts in self._choices.items()},
            pixel_filter=self._undone_stddev(),
            outputs=self._written,
            told=self._noticed,
            guides=guides_in(self.plan, {"scale", "size"} & {*self._values("denoiser")} != set()),
            exposure=self._exposure,
            cuts=self._cuts,
            coverage=self.sequence.coverage,
            fireflies=self.sequence.fireflies,
            bad_pixels=self._bad_pixels,
            capture=self._capture.page if self._capture else None,
            faults=self._faults.found,
            error=str(failure) or "interrupted" if failure is not None else None,
        )

    def write_page(self, report: Report) -> Report:
        """Write the page that --report asks for; the report with its path."""
        return self._page.write(report, str(self.explain())) if self._page else report

    def _open_run(self) -> Run:
        # smooth exposure depends on which frames there are
        frames = sorted(self.sequence.numbers) if self._smooth else None
        settings = RUN.settings(self._arguments)
        if not isinstance(self._arguments.input, str):  # files one by one
            settings["input"] = str(self.sequence.pattern)
        provenance = provenance_of(
            settings, self.plan, self.pipeline.device,
            [frames, *RUN.settings(self._arguments, "rounding").values()],
            [one.name for one in RUN if one.is_file])
        return Run(self._files(), self.sequence, self.pipeline, self.plan, provenance,
                   Options(**self._values("run")))

    def _files(self) -> OutputFiles:
        if self.outputs is None:
            raise WriteError(NOWHERE)
        return self.outputs

    def _announce(self, run: Run, progress: FrameProgress) -> None:
        """Print what will be made, which frames are missing, and what delays the first frame.

        MissingFrameError where missing frames stop the run: before the first one, not hours later.
        """
        progress.note(self.headline())
        if self._arguments.verbose:
            for line in str(self.plan).splitlines():
                progress.note(line)
        wanted = [work.number for work in run.works if work.write]
        listed = self.sequence.numbers
        others = [work.number for work in run.works if work.number not in listed]
        before = [number for number in others if number < listed[0]]
        between = [number for number in others if number > listed[0]]
        if before:
            progress.note(f"{describe_preroll(before)} for the history of frame {listed[0]} "
                          "(--preroll 0 leaves it out)")
        if between:
            progress.note(describe_between(between))
        if self._arguments.on_error == OnError.STOP:
            self.sequence.refuse_holes(wanted)
        elif missing := [number for number in wanted if not self.sequence.holds(number)]:
            are = "is" if len(missing) == 1 else "are"
            progress.note(f"{len(missing)} of {len(wanted)} frames {are} missing, --on-error "
                          f"{self._arguments.on_error} goes on without: {format_frames(missing)}")
        for text in self._noticed:
            progress.note(f"warning  {text}")
        if self._smooth:
            progress.note("metering all frames first, for --exposure smooth")

    def _prepare(self) -> None:
        """Load networks and compile kernels before the clock starts. It pauses for the few that are
        known only once a frame runs."""
        begin = time.perf_counter()
        if self.plan.steps:
            self.pipeline.compile(self.plan.input, self.sequence.views)
        if self._watch.count:
            self._warm_up()
        self._preparation = Preparation(time.perf_counter() - begin, self._watch.seconds,
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
        with tempfile.TemporaryDirectory(prefix="postfx-") as folder:
            write_frame(Path(folder) / f"any{self._files().path(self.first).suffix}", frame,
                        **self._format)

    def _count_unwritten(self, works: list[Work]) -> int:
        """Frames that run and are not written, as far as they are known before the first one: in a
        run-up, for the history, and in reverse order."""
        ran = [work for work in works if not work.checkpoint]
        count = sum(not work.write for work in ran)
        if works and self._run_up and not works[0].checkpoint and self.plan.accumulating_steps():
            count += len(self._run_up.after(works[0].number)) * (1 + len(self.sequence.views))
        if self._backwards:
            count += self._backwards.count([work.number for work in ran if work.write])
        return count

    def _process_all(self, run: Run, stop: Stop, progress: FrameProgress) -> None:
        """Process a run's frames in order: they are read ahead, and written behind."""
        if self._run_up:
            self._run_up.on_frame = announce_run_up(stop.check, progress.note)
        if self._capture:
            self._capture.choose([work.number for work in run.works])
        if self._page:
            self._page.choose([work.number for work in run.works if work.write])
        capturing = self._capture.around if self._capture else nullcontext
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
                    if self._looker and not self._looker.is_done:  # at once, not after a night
                        self._tell(self._looker.look(frame, self._is_still), progress.note)
                    if self._backwards:
                        ahead = partial(self._look_ahead, self._backwards, frame, work.write, stop,
                                        progress)
                        frame = self._faults.attempt(work.number, work.write, ahead)
                        is_unseen = frame is None
                with capturing(work.number):
                    done = None if frame is None else self._process(work, frame, progress)
                if done is None and work.write:
                    done = self._faults.substitute(work.number)
                if work.write and done:
                    if self._page:
                        self._page.add(done)
                    behind.put(partial(self._write, run, done, progress))
                run.end_frame(work.number, behind.wait, is_last=stop.signal is not None)
                stop.check()

    def _remarks(self) -> list[str]:
        """What the passes remark; a still cannot flicker."""
        return [remark for remark in self.plan.remarks
                if not (self._is_still and NO_HISTORY_REMARK in remark)]

    @cached_property
    def _is_still(self) -> bool:
        """Whether there is one picture, which is no part of a shot."""
        return len(self.sequence.present()) == 1 and not self.sequence.before(self.first, 1)

    def _later_frames(self) -> list[int]:
        """The second, the middle and the last frame."""
        others = [number for number in self.sequence.numbers
                  if number > self.first and self.sequence.holds(number)]
        if not others:
            return []
        return list(dict.fromkeys([others[0], others[len(others) // 2], others[-1]]))

    def _planes_of_later_frames(self, numbers: list[int]) -> list[str]:
        """A warning for another size, for planes that the first frame has and these lack, or else
        the reverse: the plan is made for the first."""
        spare: list[str] = []
        for number in numbers:
            try:
                with self.sequence.reader().open(number) as files:
                    spec = files.spec()
                    if other := self._other_size(number, spec):
                        return [other]
                    planes = {*self.pipeline.explain(spec).planes}
                    has_motion = Role.MOTION in files.layout.planes
            except PostfxError:  # which is told where the frame's turn comes
                continue
            # a plan may hold motion that is estimated, so files tell of that
            more = planes - {*self.plan.planes, Role.MOTION}
            if has_motion and Role.MOTION not in self._channels:
                more.add(Role.MOTION)
            fewer = {role for role in self.plan.planes if role in self._channels} - planes
            fewer.discard(Role.MOTION)
            if fewer:
                names = ", ".join(sorted(map(str, fewer)))
                return [f"frame {number} has no {names}, but frame {self.first} has: frame "
                        f"{number} cannot be denoised; render it again, or choose other frames "
                        "(--frames)"]
            if more and not spare:
                names = ", ".join(sorted(map(str, more)))
                spare = [f"frame {self.first} has no {names}, but frame {number} has: no frame "
                         "uses what is not in all; render it for every frame, or choose frames "
                         "that have it (--frames)"]
        return spare

    def _other_size(self, number: int, spec: FrameSpec) -> str:
        """A warning where a frame has not the first one's size; '' where it has, or any may."""
        first = self.plan.input
        if self._arguments.size or (spec.width, spec.height) == (first.width, first.height):
            return ""
        return (f"frame {number} is {spec.width}x{spec.height}, frame {self.first} "
                f"{first.width}x{first.height}: the run ends there; render it at one size, or give "
                "the output's with --size")

    @cached_property
    def _looker(self) -> FirstFrames | None:
        """Looks for plain mistakes in the first frames; None where AOVs are not read, so that none
        is missing."""
        if (self._arguments.no_denoise or self._arguments.strength == 0
            or self.pipeline.device.scratch):
            return None
        # It loads the doctor, which other verbs need not wait for.
        from postfx.doctor.first_frames import FirstFrames

        leaves_filters = any(isinstance(step.instance, DenoiseUpscale)
                             and step.instance.leaves_filters(self.plan.input)
                             for step in self.plan.steps)
        return FirstFrames(self._channels, self._enable,
                           not self.pipeline.device.memory.host_visible,
                           leaves_filters=leaves_filters)

    def _tell(self, texts: Iterable[str], tell: Callable[[str], None]) -> None:
        """Tell at once what is to be mended, and again at the end of a long run."""
        for text in texts:
            self._noticed.append(text)
            tell(f"warning  {text}")

    def _look_ahead(self, backwards: Backwards, frame: Frame, write: bool, stop: Stop,
                    progress: FrameProgress) -> Frame:
        """The frame with what those after it make of it, for --both-ways."""
        part = backwards.part(frame.number) if write else None
        if part and part[0] != part[1]:
            progress.note(f"frames {part[1]} to {part[0]} first, in reverse order")  # may take long
        begin = time.perf_counter()
        found = backwards(frame, write, stop.check)
        if part:
            progress.pass_by(backwards.count([frame.number]), time.perf_counter() - begin)
        return found

    def _read(self, run: Run, work: Work) -> Frame | None:
        read = partial(self._read_checked, run, work.number)
        if work.number in self.sequence.numbers:
            return self._faults.attempt(work.number, work.write, read)
        try:
            return read()
        except PostfxError as error:  # of a frame that nobody asked for
            self._warnings.append(f"the history begins after frame {work.number}: {error}")
            return None

    @cached_property
    def _holds_rows(self) -> bool:
        """Whether frames hold what was unpacked of their files: where outputs keep channels of them
        bit for bit, and nothing limits memory or keeps frames for longer."""
        sizes = [(spec.width, spec.height) for spec in (self.plan.available, self.plan.output)]
        keeps = (self.outputs is not None and not self.outputs.display
                 and self._format["keep"] is not False and sizes[0] == sizes[1])
        return keeps and not (self.pipeline.device.scratch or self._page)

    def _read_checked(self, run: Run, number: int) -> Frame:
        read = partial(self.sequence.read, number, self.plan.planes, self._guides, self._holds_rows)
        frame = read_patiently(read, partial(run.note_retry, number))
        check_sizes(frame, self.plan.input, bool(self._arguments.size))
        return frame

    def _process(self, work: Work, frame: Frame, progress: FrameProgress) -> FrameResult | None:
        """A frame after the passes; None if they failed and the run goes on."""
        begin, passes, compiling = time.perf_counter(), self.pipeline, self._watch.seconds
        result = self._faults.attempt(work.number, work.write, partial(passes, frame))
        if result is None:
            return None
        self._ahead_ms += passes.ahead
        if passes.cut:
            self._cuts.append(work.number)
        for text in passes.noticed:
            self._tell([f"frame {work.number}: {text}"], progress.note)
        milliseconds = (time.perf_counter() - begin - (self._watch.seconds - compiling)) * 1000
        milliseconds -= passes.run_up_ms
        progress.pass_by(len(passes.ahead), passes.run_up_ms / 1000)
        if not work.write:
            progress.pass_by(1, milliseconds / 1000)
        if self._backwards:
            milliseconds += self._backwards.milliseconds or 0.0
        done = FrameResult(frame, result, passes.exposure_factor, passes.cut, milliseconds,
                           passes.timings, passes.bad_pixels)
        if work.write:
            self._note(done, milliseconds)
        return done

    def _note(self, done: FrameResult, milliseconds: float) -> None:
        """Keep what a frame took and what was chosen for it."""
        self._frame_ms.append(milliseconds)
        backwards = self._backwards.milliseconds if self._backwards else None
        for name, elapsed in {**({} if backwards is None else {BACKWARDS: backwards}),
                              **done.passes}.items():
            self._pass_ms.setdefault(name, []).append(elapsed)
        for role, pixels in done.bad_pixels.items():
            found = self._bad_pixels.setdefault(str(role), {"pixels": 0, "frames": 0})
            found["pixels"], found["frames"] = found["pixels"] + pixels, found["frames"] + 1
        for step in self.plan.steps:
            if step.instance.choice:
                self._choices.setdefault(step.name, Counter())[step.instance.choice] += 1

    def _write(self, run: Run, done: FrameResult, progress: FrameProgress) -> None:
        """Write a frame's files, and note what was written."""
        number, result, used = done.source.number, done.result, done.exposure_factor
        told = ({} if used is None
                else {APPLIED if self._exposure.is_applied
                      else USED_EXPOSURE_ATTRIBUTE: log2(used)})
        facts, paths = done.facts(), []
        assert self.outputs is not None, "a run has them"
        for path, picture in self.outputs.split(result):
            provenance: dict[str, str | float] = {
                **run.provenance.header(self.pipeline.device.models), **told
            }
            write = partial(write_frame, path, picture, relax=self._relax, provenance=provenance,
                            **self._format)
            if self._faults.attempt(number, True, write) is None:
                return
            run.note_output(number, path, picture, **facts)
            if self._viewer:
                self._viewer.show(str(path), picture)
                self._tell(filter(None, [self._viewer.notice()]), progress.note)
            facts = {}  # those of a frame are told once
            paths.append(str(path))
        if used is not None:
            self._exposure.multipliers[number] = used
            self._exposure.lit_ev[number] = done.source.exposure or 0.0
        self._written, self._frames = self._written + paths, self._frames + 1
        progress.advance(" ".join(paths), self._watch.seconds - self._preparation.compile_seconds)
        if self._arguments.verbose:
            spent = [f"{name} {elapsed:.1f} ms" for name, elapsed in done.passes.items()]
            stops = [] if used is None else [f"exposure {log2(used):+.2f} EV"]
            progress.note(f"frame {number}: "
                          f"{', '.join([*spent, *stops]) or 'only its picture, enlarged'}")

    def _passes(self, denoising: dict[str, Any] | None, both_ways: bool = False,
                partner: str | None = None) -> tuple[list[Pass], list[Skip]]:
        """The passes, the denoiser with these options, or without one if they are None; and what is
        left out."""
        passes, skips, parts = [], [], {"parts": self._parts} if self._parts else {}
        if denoising is None:
            skips.append(Skip("denoise_upscale", "--no-denoise"))
        else:
            if partner:
                passes.append(create("partner", of=partner,
                                     pixel_filter=denoising.get("pixel_filter", "auto")))
            passes.append(create("denoise_upscale", **denoising, **parts))
        passes += [create("both_ways", **parts)] if both_ways else []
        if denoising is not None and partner:
            strength = denoising.get("strength")
            passes.append(create("mix_partner", strength=1.0 if strength is None else strength,
                                 scale=enlargement(self._first_spec, denoising),
                                 model=denoising.get("model", "m"), both_ways=both_ways, **parts))
        passes += [create("overlay")] if self._arguments.overlay == "composite" else []
        shown, not_shown = make_display_passes(self._is_picture, **self._values("look"))
        asked = map(parse_pass, getattr(self._arguments, "pass") or ())
        chain = insert_passes([*passes, *shown], tuple(asked), len(passes))
        if both_ways and chain[0].name not in ("denoise_upscale", "partner"):
            raise OptionError("--both-ways denoises frames as they are in their files, before "
                              f"pass '{chain[0].name}': let the pass run after=denoise_upscale, or "
                              "leave --both-ways out")
        return chain, skips + not_shown

    @cached_property
    def _first_spec(self) -> FrameSpec:
        """The first frame's spec, before it is known what is left out of it: for its sizes."""
        with self.sequence.open(self.first) as files:
            return files.spec()

    def _find_parts(self) -> tuple[Part, ...]:
        """Parts of the picture that --aov and --aov-denoise ask for; none where the output cannot
        hold them."""
        if self.sequence.options.parts is None:
            return ()
        if is_shown(self._is_picture, **self._values("look")):
            self.skips.append(Skip("light groups and passes",
                                   "they are scene-linear, the output is not"))
            self.sequence.options = self.sequence.options.without_parts()
            return ()
        with self.sequence.open(self.first) as files:
            parts = tuple(found.part for found in files.parts.values())
            if not any(part.is_light for part in parts):
                return parts
            frame = files.read(self.first, [Role.COLOUR], [])
        grouped, notes = group_parts(parts, frame[Role.COLOUR], frame.parts)
        for note in notes:
            self.sequence.warn(note)
        return grouped

    def _resample_options(self) -> dict[str, Any]:
        """Options of a denoiser that only resamples, to the plan's size."""
        size = self._arguments.size
        return {"strength": 0.0, **({"size": size} if size
                                    else {"scale": self.plan.output.width / self.plan.input.width})}

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


def _outputs(arguments: argparse.Namespace, sequence: Sequence) -> OutputFiles | None:
    existing = ExistingFiles.OVERWRITE if arguments.overwrite else ExistingFiles.REFUSE
    existing = ExistingFiles.SKIP if arguments.skip_existing else existing
    if not arguments.output and not arguments.explain:
        raise WriteError(NOWHERE)
    return OutputFiles(arguments.output, sequence, existing) if arguments.output else None
