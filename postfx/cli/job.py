"""One `postfx run`: what to read, run and write, and the loop over the frames."""

from __future__ import annotations

import argparse
import dataclasses
import time
from collections import Counter
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

from postfx.cli.capture import FrameCapture
from postfx.cli.cuts import known_cuts
from postfx.cli.faults import Faults, OnError, Standin, check_sizes, first_spec, without_denoising
from postfx.cli.progress import FrameProgress
from postfx.cli.summary import Report
from postfx.errors import WriteError
from postfx.exposure import SMOOTH, ExposureMeter, SmoothExposure, colours_of
from postfx.frame import Frame, Role
from postfx.io.ahead import WriteBehind, read_ahead
from postfx.io.output import Existing, OutputFiles
from postfx.io.sequence import Sequence
from postfx.io.writer import write_frame
from postfx.kernels.numeric import is_first_run
from postfx.passes.base import Pass, PassOptionError
from postfx.passes.registry import create
from postfx.pipeline import Pipeline
from postfx.plan import Skipped
from postfx.runtime import Device
from postfx.strength.shares import Shares

RESUME_PREROLL = 8
DENOISE_OPTIONS = ("scale", "model", "strength", "budget")


class Work(NamedTuple):
    """A frame to process, and whether its result is written or only fills the history."""

    number: int
    write: bool


class Job:
    """Everything that the arguments of `postfx run` ask for.

    Raises PostfxError when the arguments, the first frame or the outputs do not fit together.
    """

    def __init__(self, arguments: argparse.Namespace) -> None:
        device = Device(arguments.device, arguments.threads, memory=arguments.memory)
        self.sequence = Sequence(
            arguments.input, arguments.frames, arguments.profile, guides=arguments.guides, scratch=device.scratch,
            depth=arguments.depth, cuts=known_cuts(arguments.cuts), leave=arguments.leave,
        )
        self._relax = device.memory.relax
        self.outputs = _outputs(arguments, self.sequence)
        if self.outputs and not arguments.explain:
            self.outputs.check(self.sequence.numbers)
        self.left_out: list[Skipped] = []
        self._smooth = arguments.exposure == SMOOTH
        policy = OnError(arguments.on_error)
        exposure = SmoothExposure(colours_of(self.sequence, policy is not OnError.STOP)) if self._smooth \
            else ExposureMeter(arguments.exposure)
        cuts = "auto" if arguments.cuts == "auto" else "none"
        self.pipeline = Pipeline(self._passes(arguments), device, exposure, cuts)
        self.plan = self.pipeline.explain(first_spec(self.sequence, policy))
        self._keep = arguments.keep == "all"
        said = len(self.left_out)
        plain = self._passes(without_denoising(arguments, self.plan)) if policy is OnError.COPY else None
        del self.left_out[said:]
        self._faults = Faults(policy, Standin(self.sequence, plain, device, exposure) if plain is not None else None)
        self._preroll, self._scale = arguments.preroll, arguments.scale
        self._capture = FrameCapture(arguments, device)
        self._seconds = 0.0
        self._frame_ms: list[float] = []
        self._pass_ms: dict[str, list[float]] = {}
        self._chosen: dict[str, Counter[str]] = {}
        self._cuts: list[int] = []
        self._written: list[str] = []

    def plan_dict(self) -> dict[str, Any]:
        """The plan in plain types."""
        plan = self.plan.as_dict()
        plan["skipped"] += [dataclasses.asdict(item) for item in self.left_out]
        if alone := self._first_alone():
            plan["left_alone"] = alone.as_dict()
        return {**plan, "frames": len(self.sequence), "warnings": self.sequence.warnings}

    def plan_text(self) -> str:
        """The plan for people."""
        lines = [str(self.plan)]
        lines += [f"skips   {item.what}: {item.why}" for item in self.left_out]
        if alone := self._first_alone():
            lines.append(f"leaves  of frame {self.sequence.numbers[0]}: {alone}")
        return "\n".join(lines + [f"warning {warning}" for warning in self.sequence.warnings])

    def run(self) -> None:
        """Process all frames: the next is read and the last written meanwhile. Frames that were written stay when a
        later one fails."""
        if self.outputs is None:
            raise WriteError("nowhere to write: give -o OUTPUT, e.g. -o out/clean.####.exr")
        begin = time.perf_counter()
        try:
            with FrameProgress(len(self.sequence)) as progress, WriteBehind() as behind:
                if self.plan.steps and is_first_run():
                    progress.note("compiling kernels for this processor: some ten seconds, on the first run only")
                if self._smooth:
                    progress.note("metering all frames first, for --exposure smooth")
                works = self._schedule(self.outputs, progress)
                self._capture.choose([work.number for work in works])
                for work, frame in read_ahead(works, self._read):
                    with self._capture.around(work.number):
                        result = self._process(work, frame)
                    if work.write and result:
                        behind.put(partial(self._write, self.outputs.path(work.number), result, progress))
        finally:
            self._seconds = time.perf_counter() - begin

    def report(self, failure: BaseException | None = None) -> Report:
        """What happened so far."""
        return Report(
            frames=len(self._written),
            wanted=len(self.sequence),
            seconds=self._seconds,
            frame_ms=self._frame_ms,
            pass_ms=self._pass_ms,
            skipped=[*self.plan.skipped, *self.left_out, *self.pipeline.left_out()],
            warnings=[*self.plan.remarks, *self.sequence.warnings],
            chosen={name: dict(counts) for name, counts in self._chosen.items()},
            outputs=self._written,
            guides=self._guides(),
            cuts=self._cuts,
            left_alone=self.sequence.left_alone,
            capture=self._capture.page,
            faults=self._faults.found,
            error=str(failure) or "interrupted" if failure is not None else None,
        )

    def _read(self, work: Work) -> Frame | None:
        return self._faults.read(work.number, work.write, partial(self._checked, work.number))

    def _checked(self, number: int) -> Frame:
        frame = self.sequence.read(number, self.plan.planes, self.plan.guides)
        check_sizes(frame, self.plan.input)
        return frame

    def _process(self, work: Work, frame: Frame | None) -> Frame | None:
        """The result of a frame, or of what stands in for one that failed; None where there is neither."""
        begin = time.perf_counter()
        result = frame and self._faults.attempt(work.number, work.write, partial(self.pipeline, frame))
        if result is None:
            return self._faults.instead(work.number) if work.write else None
        if self.pipeline.cut:
            self._cuts.append(work.number)
        if work.write:
            self._note((time.perf_counter() - begin) * 1000)
        return result

    def _note(self, milliseconds: float) -> None:
        """Keep what the last frame took and what was chosen for it."""
        self._frame_ms.append(milliseconds)
        for name, elapsed in self.pipeline.timings.items():
            self._pass_ms.setdefault(name, []).append(elapsed)
        for step in self.plan.steps:
            if choice := step.instance.chosen():
                self._chosen.setdefault(step.name, Counter())[choice] += 1

    def _write(self, path: Path, result: Frame, progress: FrameProgress) -> None:
        write = partial(write_frame, path, result, relax=self._relax, keep=self._keep)
        if written := self._faults.attempt(result.number, True, write):
            self._written.append(str(written))
            progress.advance(str(written))

    def _guides(self) -> dict[str, Any] | None:
        """Size of the guides, which of them are used, and whether the output's size follows from them."""
        guides = self.plan.available.guides
        if guides is None:
            return None
        output = self.plan.output
        follows = self._scale is None and (output.width, output.height) == (guides.width, guides.height)
        used = [str(role) for role in self.plan.guides]
        return {"width": guides.width, "height": guides.height, "used": used, "output_follows": follows}

    def _first_alone(self) -> Shares | None:
        """What the first frame leaves as it is, where that is asked for."""
        asked = self.sequence.leave and Role.STRENGTH in self.plan.planes
        return self.sequence.left_alone_of(self.sequence.numbers[0]) if asked else None

    def _schedule(self, target: OutputFiles, progress: FrameProgress) -> list[Work]:
        """Frames to process in order: those to write, and before each run of them those that fill the history."""
        output = self.plan.output
        works: list[Work] = []
        for number in self.sequence.numbers:
            if target.is_done(number, output.width, output.height):
                self.left_out.append(Skipped(f"frame {number}", f"{target.path(number)} is there and complete"))
                progress.skip()
                continue
            count = self._preroll_of(target)
            scheduled = {work.number for work in works[-count - 1 :]}
            leading = [before for before in self.sequence.before(number, count) if before not in scheduled]
            works += [Work(before, False) for before in leading]
            works.append(Work(number, True))
        return works

    def _preroll_of(self, target: OutputFiles) -> int:
        if self._preroll is not None:
            return self._preroll
        return RESUME_PREROLL if target.existing is Existing.SKIP and self.plan.steps else 0

    def _passes(self, arguments: argparse.Namespace) -> list[Pass]:
        passes = []
        if arguments.no_denoise:
            self._refuse_denoise_options(arguments)
            self.left_out.append(Skipped("denoise_upscale", "--no-denoise"))
        else:
            options = {name: getattr(arguments, name) for name in DENOISE_OPTIONS}
            passes.append(create("denoise_upscale", **_given(options)))
        reason = self._no_tonemap(arguments)
        if reason:
            self.left_out.append(Skipped("tonemap", reason))
        else:
            passes.append(create("tonemap", **_given({"tag": arguments.tonemap or None})))
        if reason and self.outputs and self.outputs.display:
            passes.append(create("display"))
        return passes

    def _no_tonemap(self, arguments: argparse.Namespace) -> str | None:
        if arguments.no_tonemap:
            return "--no-tonemap"
        if arguments.tonemap is None and not (self.outputs and self.outputs.display):
            return "EXR output stays scene-linear; --tonemap changes that"
        return None

    def _refuse_denoise_options(self, arguments: argparse.Namespace) -> None:
        for name in (*DENOISE_OPTIONS, "leave"):
            option, value = f"--{name}", getattr(arguments, name)
            if value is not None:
                raise PassOptionError(f"{option} is for the denoiser, which --no-denoise leaves out: give one of them")


def _outputs(arguments: argparse.Namespace, sequence: Sequence) -> OutputFiles | None:
    existing = Existing.OVERWRITE if arguments.overwrite else Existing.REFUSE
    existing = Existing.SKIP if arguments.skip_existing else existing
    if arguments.output is None and not arguments.explain:
        raise WriteError("nowhere to write: give -o OUTPUT, e.g. -o out/clean.####.exr")
    return OutputFiles(arguments.output, sequence, existing) if arguments.output else None


def _given(options: dict[str, Any]) -> dict[str, Any]:
    return {name: value for name, value in options.items() if value is not None}
