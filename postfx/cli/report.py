"""`--report`: one page on a run or an inspection."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from postfx.cli.summary import FrameResult, Report
from postfx.colour.displays import srgb_decode
from postfx.doctor.inspection import Inspection, contact_sheet
from postfx.errors import ReportError
from postfx.exposure import ExposureMeter, measure
from postfx.frame import Frame, Role
from postfx.io.writer import check_folder
from postfx.kernels.image import resample
from postfx.passes.composite import NO_OVERLAY
from postfx.pipeline import Pipeline
from postfx.tools.report.frame_log import Comparison, FrameLog, Look, References, measure_errors
from postfx.tools.report.page import write_report

if TYPE_CHECKING:
    from postfx.io.sequence import Sequence
    from postfx.plan import Plan


class RunReport:
    """What --report asks for: it looks at every frame that is written, and writes the page at the
    end.

    Args:
        inspect: looks at a view of the input from the first of these frames on that can be read,
            for the page's findings and pictures of planes.
        path: the page.
        reference: noise-free frames at output size.
        check: whether the page's folder must be one that can be written.

    Raises ReportError when references do not fit, WriteError when the page's folder cannot be
    written.
    """

    def __init__(self, sequence: Sequence, pipeline: Pipeline, plan: Plan,
                 inspect: Callable[[list[int], str | None], Inspection], path: str,
                 reference: str | None = None, check: bool = True) -> None:
        self._sequence = sequence
        self._pipeline = pipeline
        self._plan = plan
        self._inspect = inspect
        self._path = Path(path)
        output = plan.output
        size = output.width, output.height
        self._views = (sequence.view or "", *sequence.views) if sequence.views else ()
        self._references = References(reference, size, self._views) if reference else None
        self._look = Look(output.encoding != "scene-linear")
        self._displays: dict[str, Pipeline] = {}
        self._log = FrameLog([], self._look, "after")
        if check:
            _check(self._path)

    def choose(self, numbers: list[int]) -> None:
        """Say which frames will be written, in order."""
        self._log = FrameLog(numbers, self._look,
                             f"after {self._views[0]}" if self._views else "after")

    def add(self, done: FrameResult) -> None:
        """Add a frame that was just processed."""
        frame = done.source
        cut = done.cut or frame.reset or not self._follows(frame.number)
        metered = measure(frame[Role.COLOUR])
        factor = done.exposure_factor or 2.0 ** (metered or 0.0)
        readings = {"exposure used": float(np.log2(factor)), "exposure metered": metered}
        timed = {"ms passes": done.milliseconds} if self._log.rows else {}  # the first one compiles
        pictures: dict[str, np.ndarray] = {}
        motions: dict[str, np.ndarray | None] = {}
        maps: dict[str, np.ndarray] = {}
        sources = (frame, *frame.views.values())
        results = (done.result, *done.result.views.values())
        for view, source, result in zip(self._views or (None,), sources, results, strict=True):
            own = self._pictures(view, source, result, factor, cut)
            found = self._compare(own, factor)
            pictures |= {_label(name, view): light for name, light in own.items()}
            motions |= {_label(name, view): source.planes.get(Role.MOTION) for name in own}
            if found:
                readings |= {_label(name, view): value for name, value in found.figures.items()}
                maps[_label("FLIP", view)] = found.flip
        self._log.add(frame.number, pictures, factor, motions, cut, readings | timed, maps)

    def write(self, report: Report, plan: str) -> Report:
        """Write the page on the frames seen, with the text of the `plan`; returns the report with
        the page's path."""
        if not self._log.rows:
            return report
        numbers = [row.number for row in self._log.rows]
        inspected = {view or "": self._inspect(numbers, view) for view in self._views or (None,)}
        report = dataclasses.replace(report, page=str(self._path))
        name = Path(str(self._sequence.pattern)).name
        skips = [skip for skip in report.skips if skip.why != NO_OVERLAY]
        told = dataclasses.replace(report, skips=skips).as_dict()
        write_report(self._path, f"postfx report: {name}", self._log,
                     {view: one.facts() for view, one in inspected.items()},
                     {view: contact_sheet(one.frames[0]) for view, one in inspected.items()},
                     {**told, "plan": plan})
        return report

    def _follows(self, number: int) -> bool:
        """Whether the frame looked at last is the one before, and not one before frames that were
        left out."""
        return (bool(self._log.rows)
                and self._sequence.before(number, 1) == [self._log.rows[-1].number])

    def _pictures(
        self, view: str | None, frame: Frame, result: Frame, exposure_factor: float, cut: bool
    ) -> dict[str, np.ndarray]:
        """Pictures of one size, shown in the same way: a view before, after and, if there is one,
        its reference."""
        after = result[Role.COLOUR]
        height, width = after.shape[:2]
        before = resample(frame[Role.COLOUR], height, width, frame.jitter)
        scene = {"before": before}
        reference = self._references.colour(frame.number, view) if self._references else None
        scene |= ({"reference": reference}
                  if reference is not None and reference.shape == after.shape else {})
        shown = {name: self._display(_label(name, view), light, frame, exposure_factor, cut)
                 for name, light in scene.items()}
        return {"before": shown.pop("before"), "after": _light_of(result), **shown}

    def _display(self, name: str, light: np.ndarray, frame: Frame, exposure_factor: float,
                 cut: bool) -> np.ndarray:
        """Scene-linear light through the passes that made the output a display's, each picture with
        its own history."""
        if not self._look.display:
            return light
        if name not in self._displays:
            shown = [step for step in self._plan.steps
                     if step.reflection.output.encoding != step.input.encoding]
            passes = [type(step.instance)(**step.instance.options) for step in shown]
            self._displays[name] = Pipeline(passes, self._pipeline.device, "metadata", cuts="none")
        stops = float(np.log2(exposure_factor))
        one = Frame({Role.COLOUR: light}, frame.number, exposure=stops, reset=cut,
                    metadata=frame.metadata)
        return _light_of(self._displays[name](one))

    def _compare(self, pictures: dict[str, np.ndarray],
                 exposure_factor: float) -> Comparison | None:
        if "reference" not in pictures:
            return None
        return measure_errors({name: self._look.codes(light, exposure_factor)
                               for name, light in pictures.items()})


def write_inspection(inspection: Inspection, path: str) -> None:
    """Write the page of an inspection: the input's own frames, as many as the doctor looked at.
    Raises WriteError."""
    frames = inspection.frames
    log = FrameLog([frame.number for frame in frames], Look(False), "input")
    meter = ExposureMeter("auto")
    for before, frame in zip([frames[0], *frames], frames, strict=False):
        motion = frame.planes.get(Role.MOTION)
        if motion is not None:  # leads from sample to sample here, not from centre to centre
            motion = motion + (np.asarray(frame.jitter, np.float32)
                               - np.asarray(before.jitter, np.float32))
        readings = {"exposure metered": measure(frame[Role.COLOUR])}
        log.add(frame.number, {"input": frame[Role.COLOUR]}, meter(frame), motion, frame.reset,
                readings)
    _check(Path(path))
    name = Path(str(inspection.sequence.pattern)).name
    write_report(Path(path), f"postfx inspect: {name}", log, {"": inspection.facts()},
                 {"": contact_sheet(inspection.frames[0])})


def _label(name: str, view: str | None) -> str:
    """The name of a picture or a figure, with its view where there are several."""
    return f"{name} {view}" if view else name


def _check(path: Path) -> None:
    if path.is_dir():
        raise ReportError(f"--report {path}: is a folder: give a file, e.g. {path / 'report.html'}")
    check_folder(path.parent, "report")


def _light_of(frame: Frame) -> np.ndarray:
    colour = frame[Role.COLOUR]
    return srgb_decode(colour) if frame.encoding == "srgb" else colour
