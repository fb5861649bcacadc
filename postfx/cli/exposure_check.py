"""What `postfx exposure` does: measure, tell, and write pictures."""

from __future__ import annotations

import argparse
import dataclasses
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from postfx.cli.run_options import FILES
from postfx.colour.views import false_colour, log_c, luma, zebra
from postfx.exposure import colours_of
from postfx.exposure.debugger import DRIFTING, RIGHT, Report, Shot, debug, debug_graded, judge_view
from postfx.exposure.response import OWN_CURVE, GradedBoards, read_response
from postfx.frame import Frame, Role
from postfx.io.sequence import Sequence
from postfx.passes import Pass
from postfx.passes.registry import create
from postfx.pipeline import Pipeline
from postfx.report.charts import add_key, draw_exposure, save_png
from postfx.runtime import Device

SIGNALS = ("log_c", "display")


class ExposureCheck:
    """The measured exposure of a sequence, as the arguments of `postfx exposure` ask for it. Raises PostfxError."""

    def __init__(self, arguments: argparse.Namespace) -> None:
        self._arguments = arguments
        self._sequence = Sequence(arguments.input, arguments.frames, arguments.profile,
                                  **FILES.values_for("sequence", arguments)).first_view()
        self._device = Device(arguments.device)
        self._report = self._measure()

    def _measure(self) -> Report:
        """By the view, or by what another chain made of boards."""
        given, frames = self._arguments, colours_of(self._sequence)
        if not given.graded:
            return debug(frames, self._view(), given.exposure, given.reference, device=self._device)
        boards = GradedBoards(given.graded)
        judged = read_response(given.response) if given.response else judge_view(self._view(), self._device)
        return debug_graded(frames, boards.level, judged, given.exposure, given.reference)

    @property
    def is_right(self) -> bool:
        """Whether every shot is exposed right."""
        return self._report.verdict == RIGHT

    def as_dict(self) -> dict[str, Any]:
        """What was measured, in plain types; EV are stops, levels parts of the signal."""
        report = self._report
        return {
            "source": str(self._sequence.pattern),
            "exposure": self._arguments.exposure,
            "reference": self._arguments.reference,
            "graded": self._arguments.graded,
            "read_by": report.curve,
            "verdict": report.verdict,
            "level_right": round(report.grey, 5),
            "measurable_ev": report.limits_ev,
            "shots": [_round(dataclasses.asdict(shot)) for shot in report.shots],
            "frames": [_round(reading._asdict()) for reading in report.readings],
        }

    def text(self) -> str:
        """The same for people."""
        report = self._report
        lines = [
            f"{self._sequence.pattern}: {len(report.readings)} frames, exposure {self._arguments.exposure}, "
            f"right is {self._arguments.reference}",
            f"verdict  {report.verdict}; mid grey is right at {report.grey:.1%} of the signal",
            *self._read_by(),
            f"{'frames':<12}{'level':>8}{'mismatch':>17}{'drift':>10}  right exposure",
        ]
        for shot in report.shots:
            lines.append(_row(shot, report))
            lines += [f"likely   {shot.cause}"] if shot.cause else []
        return "\n".join(lines)

    def _read_by(self) -> list[str]:
        """By which curve levels of graded frames were read, and what remains uncertain."""
        given, curve = self._arguments, self._report.curve
        if not given.graded:
            return []
        if not given.response:
            return [f"read by  the curve of --tonemap {given.tonemap or 'aces2'}: if your chain has another one, give "
                    "--response (--chart writes what it needs)"]
        by = "the curve in" if curve == OWN_CURVE else f"{curve}, whose curve is that of"
        return [f"read by  {by} {given.response}"]

    def write_pictures(self) -> Iterator[Path]:
        """Write what --curve and --views ask for; each path when it is there."""
        views = self._arguments.views and Path(self._arguments.views)
        curves = [self._arguments.curve, views and views / "curve.png"]
        name = Path(str(self._sequence.pattern)).name
        for path in map(Path, filter(None, curves)):
            draw_exposure(self._report, f"{name}: exposure {self._arguments.exposure}, {self._report.verdict}", path)
            yield path
        if views:
            yield from self._write_views(views)

    def _write_views(self, folder: Path) -> Iterator[Path]:
        """The whole chain runs here: noise would be in every view."""
        denoise = Pipeline([create("denoise_upscale")], self._device, "metadata")
        view = Pipeline(self._view(), self._device, "metadata")
        with self._sequence.open(self._sequence.numbers[0]) as files:
            plan = denoise.explain(files.spec())
        self._sequence.rewind()
        for reading in self._report.readings:
            frame = self._sequence.read(reading.number, plan.planes, plan.guides)
            exposure = 2.0**reading.exposure_ev
            clean = dataclasses.replace(denoise(dataclasses.replace(frame, exposure=exposure)), exposure=exposure)
            for name, pixels in _views(clean, view(clean)[Role.COLOUR], exposure):
                path = folder / f"{name}.{reading.number:04d}.png"
                save_png(path, pixels)
                yield path

    def _view(self) -> list[Pass]:
        if self._arguments.no_tonemap:
            return [create("display")]
        tag = self._arguments.tonemap
        return [create("tonemap", **({"tag": tag} if tag else {}))]


def _views(clean: Frame, display: np.ndarray, exposure: float) -> Iterator[tuple[str, np.ndarray]]:
    signals = log_c(luma(clean[Role.COLOUR]) * exposure), luma(display)
    for name, signal in zip(SIGNALS, signals, strict=True):
        yield f"false_colour_{name}", add_key(false_colour(signal))
    yield "zebra", zebra(display)


def _row(shot: Shot, report: Report) -> str:
    frames = str(shot.first) if shot.first == shot.last else f"{shot.first}-{shot.last}"
    low, high = report.limits_ev  # black and white: beyond them nothing can be measured
    bound = "over " if shot.mismatch_ev <= low else "under " if shot.mismatch_ev >= high else ""
    mismatch = f"{'beyond ' * bool(bound)}{shot.mismatch_ev:+.2f} EV"
    right = f"{bound}{shot.right_ev:+.2f} EV (x {2**shot.right_ev:.3g})"
    row = f"{frames:<12}{shot.level:>8.1%}{mismatch:>17}{shot.drift_ev:>7.2f} EV  {right:<24}{shot.verdict}"
    return row + (f" by {shot.drift_ev:.2f} EV" if shot.verdict == DRIFTING else "")


def _round(values: dict[str, Any]) -> dict[str, Any]:
    return {name: round(value, 5) if isinstance(value, float) else value for name, value in values.items()}
