"""One `postfx run`: what to read, run and write, and the loop over the frames."""

from __future__ import annotations

import argparse
import dataclasses
import time
from collections import Counter
from functools import partial
from typing import Any

from postfx.cli.books import options_of
from postfx.cli.both_ways import BothWays
from postfx.cli.capture import FrameCapture
from postfx.cli.cuts import known_cuts
from postfx.cli.looks import display_passes
from postfx.cli.on_error import Faults, OnError, Standin, check_sizes, first_readable, without_denoising
from postfx.cli.overlay import left_out_for, refuse_layer, unread
from postfx.cli.report import RunReport
from postfx.cli.run_up import run_up_of
from postfx.cli.summary import Explanation, FrameProgress, Report, guides_in
from postfx.errors import PassOptionError, WriteError
from postfx.exposure import SMOOTH, ExposureMeter, SmoothExposure, colours_of
from postfx.frame import Frame
from postfx.io.output import Existing, OutputFiles
from postfx.io.prefetch import WriteBehind, read_ahead, read_patiently
from postfx.io.sequence import Sequence
from postfx.io.writer import write_frame
from postfx.kernels.compile_cache import is_first_run
from postfx.passes.base import Pass
from postfx.passes.registry import create
from postfx.pipeline import Pipeline
from postfx.plan import Skipped, from_files
from postfx.runs.provenance import provenance_of
from postfx.runs.run import Run
from postfx.runs.schedule import Work
from postfx.runs.stop import Stop
from postfx.runtime import Device
from postfx.temporal import Backwards

DENOISE_OPTIONS = ("scale", "size", "model", "strength", "budget", "reactive")


class Job:
    """Everything that the arguments of `postfx run` ask for.

    Raises PostfxError when the arguments, the first frame or the outputs do not fit together.
    """

    def __init__(self, arguments: argparse.Namespace) -> None:
        device = Device(arguments.device, arguments.threads, memory=arguments.memory)
        self.sequence = Sequence(
            arguments.input, arguments.frames, arguments.profile, guides=arguments.guides, scratch=device.scratch,
            depth=arguments.depth, cuts=known_cuts(arguments.cuts), leave=arguments.leave,
            colourspace=arguments.colourspace, without=unread(arguments),
        )
        self._relax = device.memory.relax
        self.outputs = _outputs(arguments, self.sequence)
        refuse_layer(arguments, self.outputs)
        if self.outputs and not arguments.explain:
            self.outputs.check(self.sequence.numbers)
        self.left_out: list[Skipped] = []
        self._smooth = arguments.exposure == SMOOTH
        policy = OnError(arguments.on_error)
        exposure = SmoothExposure(colours_of(self.sequence, policy is not OnError.STOP)) if self._smooth \
            else ExposureMeter(arguments.exposure)
        cuts = "auto" if arguments.cuts == "auto" else "none"
        self._both = BothWays(arguments, lambda: Backwards(
            self.sequence, device, exposure if self._smooth else arguments.exposure, cuts, **_denoising(arguments)))
        self._run_up = run_up_of(arguments, self.sequence, cuts)
        self.pipeline = Pipeline(self._passes(arguments), device, exposure, cuts, self._run_up)
        with self.sequence.open(first_readable(self.sequence, policy)) as files:
            self.left_out += left_out_for(arguments, files)
            self.plan = self.pipeline.explain(self._both.spec(files.spec()))
        if self.outputs:
            self.outputs.refuse_few_bits(self.plan.output.encoding)
        said = len(self.left_out)
        plain = self._passes(without_denoising(arguments, self.plan)) if policy is OnError.COPY else None
        del self.left_out[said:]
        self._faults = Faults(policy, Standin(self.sequence, plain, device, exposure) if plain is not None else None)
        self._arguments = arguments
        self._warnings: list[str] = []
        self._capture = FrameCapture(arguments, device)
        self._page = RunReport(arguments, self.sequence, self.pipeline, self.plan)
        self._seconds = 0.0
        self._frame_ms: list[float] = []
        self._ahead_ms: list[float] = []
        self._pass_ms: dict[str, list[float]] = {}
        self._chosen: dict[str, Counter[str]] = {}
        self._cuts: list[int] = []
        self._broken: dict[str, dict[str, int]] = {}
        self._written: list[str] = []

    def explained(self) -> Explanation:
        """What would run."""
        return Explanation(self.plan, self.sequence, self.left_out, self._run_up)

    def run(self) -> None:
        """Process all frames; the next is read and the last written meanwhile, and stays when a later one fails."""
        begin = time.perf_counter()
        try:
            with FrameProgress(len(self.sequence)) as progress, Stop(progress.note) as stop, self._books() as run:
                self._warnings = run.warnings
                self.left_out += run.left_out
                for _ in run.left_out:
                    progress.skip()
                self._announce(progress)
                self._process_all(run, stop, progress)
        finally:
            self._seconds = time.perf_counter() - begin

    def report(self, failure: BaseException | None = None) -> Report:
        """What happened so far; writes the page that --report asks for."""
        return self._page.written(Report(
            frames=len(self._written),
            wanted=len(self.sequence),
            seconds=self._seconds,
            frame_ms=self._frame_ms,
            pass_ms=self._pass_ms,
            ahead_ms=self._ahead_ms,
            skipped=[*self.plan.skipped, *self.left_out, *self.pipeline.left_out()],
            warnings=[*self.plan.remarks, *self.sequence.warnings, *self._warnings],
            chosen={name: dict(counts) for name, counts in self._chosen.items()},
            outputs=self._written,
            guides=guides_in(self.plan, bool(self._arguments.scale or self._arguments.size)),
            cuts=self._cuts,
            left_alone=self.sequence.left_alone,
            broken=self._broken,
            capture=self._capture.page,
            faults=self._faults.found,
            error=str(failure) or "interrupted" if failure is not None else None,
        ), lambda: str(self.explained()))

    def _books(self) -> Run:
        provenance = provenance_of(self._arguments, self.plan, self.pipeline.device, self.sequence.numbers)
        options = options_of(self._arguments)
        return Run(self.outputs, self.sequence, self.pipeline, self.plan, provenance, options)

    def _announce(self, progress: FrameProgress) -> None:
        """Say what takes its time before the first frame."""
        if self.plan.steps and is_first_run():
            progress.note("compiling kernels for this processor: some ten seconds, on the first run only")
        if self._smooth:
            progress.note("metering all frames first, for --exposure smooth")

    def _process_all(self, run: Run, stop: Stop, progress: FrameProgress) -> None:
        if self._run_up:
            self._run_up.watch(stop.check, progress.note)
        self._capture.choose([work.number for work in run.works])
        self._page.choose([work.number for work in run.works if work.write])
        with WriteBehind() as behind:
            for work, frame in read_ahead(run.works, partial(self._read, run)):
                if work.checkpoint:
                    run.recall(work, frame)
                    continue
                both = partial(self._both, frame, work.write, stop.check, progress.note)
                frame = frame and self._faults.attempt(work.number, work.write, both)
                with self._capture.around(work.number):
                    result = self._process(work, frame)
                if work.write and result:
                    self._page.add(frame, result)
                    behind.put(partial(self._write, run, work.number, result, self._facts(), progress))
                run.ran(work.number, behind.wait, stop.asked)
                stop.check()

    def _read(self, run: Run, work: Work) -> Frame | None:
        return self._faults.read(work.number, work.write, partial(self._checked, run, work.number))

    def _checked(self, run: Run, number: int) -> Frame:
        read = partial(self.sequence.read, number, self.plan.planes, from_files(self.plan.guides))
        frame = read_patiently(read, partial(run.failed, number))
        check_sizes(frame, self.plan.input, bool(self._arguments.size))
        return frame

    def _process(self, work: Work, frame: Frame | None) -> Frame | None:
        """The result of a frame, or of what stands in for one that failed; None where there is neither."""
        begin = time.perf_counter()
        result = frame and self._faults.attempt(work.number, work.write, partial(self.pipeline, frame))
        if result is None:
            return self._faults.instead(work.number) if work.write else None
        self._ahead_ms += self.pipeline.ahead
        if self.pipeline.cut:
            self._cuts.append(work.number)
        if work.write:
            self._note((time.perf_counter() - begin) * 1000)
        return result

    def _note(self, milliseconds: float) -> None:
        """Keep what the last frame took and what was chosen for it."""
        self._frame_ms.append(milliseconds + sum(self._both.took().values()))
        for name, elapsed in {**self._both.took(), **self.pipeline.timings}.items():
            self._pass_ms.setdefault(name, []).append(elapsed)
        for role, pixels in self.pipeline.broken.items():
            found = self._broken.setdefault(str(role), {"pixels": 0, "frames": 0})
            found["pixels"], found["frames"] = found["pixels"] + pixels, found["frames"] + 1
        for step in self.plan.steps:
            if choice := step.instance.chosen():
                self._chosen.setdefault(step.name, Counter())[choice] += 1

    def _facts(self) -> dict[str, Any]:
        """About the last frame, for the log."""
        passes = {name: round(elapsed, 3) for name, elapsed in self.pipeline.timings.items()}
        took = round(self._frame_ms[-1], 3) if self._frame_ms else None
        return {"ms": took, "passes": passes, "exposure": self.pipeline.exposure, "cut": self.pipeline.cut,
                "broken": self.pipeline.broken}

    def _write(self, run: Run, number: int, result: Frame, facts: dict[str, Any], progress: FrameProgress) -> None:
        write = partial(write_frame, self.outputs.path(number), result, relax=self._relax,
                        dither=self._arguments.dither, provenance=run.header(), keep=self._arguments.keep == "all")
        if path := self._faults.attempt(number, True, write):
            run.wrote(number, path, result, **facts)
            self._written.append(str(path))
            progress.advance(str(path))

    def _passes(self, arguments: argparse.Namespace) -> list[Pass]:
        passes = []
        if arguments.no_denoise:
            self._refuse_denoise_options(arguments)
            self.left_out.append(Skipped("denoise_upscale", "--no-denoise"))
        else:
            passes += [create("denoise_upscale", **_denoising(arguments)), *map(create, self._both.passes)]
        passes += [create("overlay")] if arguments.overlay == "composite" else []
        shown, left_out = display_passes(arguments, self.outputs is not None and self.outputs.display)
        self.left_out += left_out
        self.sequence.colours = dataclasses.replace(self.sequence.colours, native=not shown)
        return passes + shown

    def _refuse_denoise_options(self, arguments: argparse.Namespace) -> None:
        for name in (*DENOISE_OPTIONS, "leave"):
            option, value = f"--{name}", getattr(arguments, name)
            if value is not None:
                raise PassOptionError(f"{option} is for the denoiser, which --no-denoise leaves out: give one of them")


def _outputs(arguments: argparse.Namespace, sequence: Sequence) -> OutputFiles | None:
    existing = Existing.OVERWRITE if arguments.overwrite else Existing.REFUSE
    existing = Existing.SKIP if arguments.skip_existing else existing
    if not arguments.output and not arguments.explain:
        raise WriteError("nowhere to write: give -o OUTPUT, e.g. -o out/clean.####.exr")
    return OutputFiles(arguments.output, sequence, existing) if arguments.output else None


def _denoising(arguments: argparse.Namespace) -> dict[str, Any]:
    """The denoiser's options that are given."""
    options = {name: getattr(arguments, name) for name in DENOISE_OPTIONS}
    return {name: value for name, value in options.items() if value is not None}
