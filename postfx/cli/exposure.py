"""`postfx exposure`: is the exposure of a sequence right, steady, and applied as told?"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from postfx.cli.options import Option, Options, Section
from postfx.cli.run_options import FILES, INPUT, refuse_several_views

if TYPE_CHECKING:  # what measuring needs is loaded by then: --help must not wait for it
    import numpy as np

    from postfx.frame import Frame
    from postfx.passes import Pass
    from postfx.tools.exposure.debugger import Report, Shot

DESCRIPTION = """\
Measure the exposure of a sequence at the end of the chain: a grey checkerboard, divided by the
right exposure, goes through the tone mapper with the exposure that the run uses. If the exposure is
right, the board comes out as a steady mid grey. Its level shows by how many stops the exposure is
off, frame by frame and shot by shot (from cut to cut). It also shows whether the exposure drifts,
which one is right, and which mistake fits: exposure already in the colour, not passed on, inverted,
in stops, late or feeding back.

The board covers the picture, so the denoiser does not run: a frame takes the time to read its
colour.

For a tone mapper or a grade outside postfx, 'POSTFX_EXPOSURE_TOOL=1 postfx run ...' writes frames
that hold the checkerboard, divided by each frame's exposure, which is in the headers
(postfx:exposureUsedEV). Take them through your chain and give the results to --graded. A chart
(--chart) that goes through your tone mapper at 0 EV shows its curve (--response); without it,
levels are compared with the curve of --tonemap.
"""
EXAMPLES = """\
examples:
  postfx exposure shot/noisy.####.exr
  postfx exposure shot/noisy.####.exr --exposure metadata --curve curve.png
  postfx exposure shot/noisy.####.exr --exposure 1.5 --reference metadata
  postfx exposure shot/noisy.####.exr --views look/
  postfx exposure shot/noisy.####.exr --exposure auto --json
  postfx exposure shot/noisy.####.exr --chart chart.exr
  postfx exposure shot/noisy.####.exr --graded graded/shot.####.png --response chart.png

exit codes: 0 right; 1 too dark, too bright or drifting; 2 an error whose message says how to fix it
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this verb's arguments."""
    EXPOSURE_OPTIONS.add_to(parser)


def execute(arguments: argparse.Namespace) -> int:
    """Measure a sequence; returns the exit code."""
    from postfx.tools.exposure.response import write_chart

    EXPOSURE_OPTIONS.refuse_conflicts(arguments)
    refuse_several_views(arguments, "exposure")
    if arguments.chart:
        print(f"wrote    {write_chart(arguments.chart)}", file=sys.stderr)
        return 0
    check = ExposureCheck(arguments)
    print(json.dumps(check.as_dict()) if arguments.json else check.text())
    for path in check.write_pictures():
        print(f"wrote    {path}", file=sys.stderr)
    return 0 if check.is_right else 1


MODE_METAVAR = "auto|smooth|lit|metadata|EV"

EXPOSURE_OPTIONS = Options(Section("", (
    INPUT,
    Option(flag="--frames", metavar="RANGE", help="frames to measure, e.g. 1-100"),
    Option(flag="--exposure", metavar=MODE_METAVAR, default="auto",
           help="exposure to test, as for 'postfx run' (default: auto)"),
    Option(flag="--reference", metavar=MODE_METAVAR, default="smooth",
           help="the right exposure (default: smooth, metered on the pictures); give an EV or "
           "metadata if the exposure is an artist's choice"),
    Option(flag="--tonemap", metavar="TAG", either="look",
           help="look of the tone mapper (default: as 'postfx run')"),
    Option(flag="--no-tonemap", either="look", help="only expose, clip and encode"),
    Option(flag="--graded", metavar="FRAMES",
           help="the boards of 'POSTFX_EXPOSURE_TOOL=1 postfx run' on INPUT with the same "
           "--exposure, after your chain, numbered alike: PNG, TIFF, JPEG or EXR"),
    Option(flag="--response", metavar="FILE",
           help="the chart after your tone mapper; needs --graded",
           needs={"--graded": "--response tells how --graded frames are read: give both"}),
    Option(flag="--chart", metavar="EXR",
           help="write a chart of greys, from 8 stops below mid grey to 8 above, for your tone "
           "mapper at 0 EV, and stop"),
    Option(flag="--curve", metavar="PNG", help="write a picture of the exposure over the sequence"),
    Option(flag="--views", metavar="DIR",
           help="write curve.png, and of each frame ARRI false colour of the Log C signal (log_c) "
           "and of the display's (display), and zebra at 95 %%. Frames are denoised and exposed "
           "first, which takes the time of a run"),
    Option(flag="--profile", metavar="NAME|FILE",
           help="renderer profile (default: found from the file)"),
    *FILES,
    Option(flag="--device", choices=("auto", "cpu", "cuda"), default="auto", help="where to run"),
    Option(flag="--json", help="print one JSON object"),
)))


class ExposureCheck:
    """The measured exposure of a sequence, as the arguments of `postfx exposure` ask for it. Raises
    PostfxError."""

    def __init__(self, arguments: argparse.Namespace) -> None:
        from postfx.io.sequence import read_sequence
        from postfx.runtime import Device

        self._arguments = arguments
        values = FILES.values_for("sequence", arguments)
        self._sequence = read_sequence(arguments.input, arguments.frames, arguments.profile,
                                       **values).first_view()
        self._device = Device(arguments.device)
        self._report = self._measure()

    def _measure(self) -> Report:
        """The report by the view, or by pictures that another chain made of boards."""
        from postfx.exposure import colours_of
        from postfx.tools.exposure.debugger import debug, debug_graded, judge_view
        from postfx.tools.exposure.response import GradedBoards, read_response

        given, frames = self._arguments, colours_of(self._sequence)
        if not given.graded:
            return debug(frames, self._view(), given.exposure, given.reference, device=self._device)
        boards = GradedBoards(given.graded)
        judged = (read_response(given.response) if given.response
                  else judge_view(self._view(), self._device))
        return debug_graded(frames, boards.level, judged, given.exposure, given.reference)

    @property
    def is_right(self) -> bool:
        """Whether every shot is exposed right."""
        from postfx.tools.exposure.debugger import RIGHT_VERDICT

        return self._report.verdict == RIGHT_VERDICT

    def as_dict(self) -> dict[str, Any]:
        """What was measured, in plain types; EV are stops, levels parts of the signal."""
        from dataclasses import asdict

        report = self._report
        return {
            "source": str(self._sequence.pattern),
            "exposure": self._arguments.exposure,
            "reference": self._arguments.reference,
            "graded": self._arguments.graded,
            "read_by": report.curve,
            "remark": report.remark,
            "verdict": report.verdict,
            "level_right": round(report.grey, 5),
            "measurable_ev": report.limits_ev,
            "shots": [_round(asdict(shot)) for shot in report.shots],
            "frames": [_round(reading._asdict()) for reading in report.readings],
        }

    def text(self) -> str:
        """The report as lines for people."""
        report = self._report
        lines = [
            f"{self._sequence.pattern}: {len(report.readings)} frames, exposure "
            f"{self._arguments.exposure}, right is {self._arguments.reference}",
            f"verdict  {report.verdict}; mid grey is right at {report.grey:.1%} of the signal",
            *self._read_by(),
            f"{'frames':<12}{'level':>8}{'mismatch':>17}{'drift':>10}  right exposure",
        ]
        for shot in report.shots:
            lines.append(_row(shot, report))
            lines += [f"likely   {shot.cause}"] if shot.cause else []
        return "\n".join(lines)

    def _read_by(self) -> list[str]:
        """Lines on the curve that levels of graded frames were read by, and on what remains
        uncertain."""
        given = self._arguments
        if not given.graded:
            return []
        if not given.response:
            return [f"read by  the curve of --tonemap {given.tonemap or 'aces2'}: if your chain "
                    "has another one, give --response (--chart writes what it needs)"]
        remark = self._report.remark
        return [f"read by  the curve in {given.response}",
                *([f"remark   {remark}"] if remark else [])]

    def write_pictures(self) -> Iterator[Path]:
        """Write what --curve and --views ask for; each path when it is there."""
        from postfx.tools.exposure.plot import draw_exposure

        views = self._arguments.views and Path(self._arguments.views)
        curves = [self._arguments.curve, views and views / "curve.png"]
        name = Path(str(self._sequence.pattern)).name
        for path in map(Path, filter(None, curves)):
            draw_exposure(self._report,
                          f"{name}: exposure {self._arguments.exposure}, {self._report.verdict}",
                          path)
            yield path
        if views:
            yield from self._write_views(views)

    def _write_views(self, folder: Path) -> Iterator[Path]:
        """The whole chain runs here: noise would be in every view."""
        from dataclasses import replace

        from postfx.canvas import save_png
        from postfx.frame import Role
        from postfx.passes.registry import create
        from postfx.pipeline import Pipeline

        denoise = Pipeline([create("denoise_upscale")], self._device, "metadata")
        view = Pipeline(self._view(), self._device, "metadata")
        with self._sequence.open(self._sequence.numbers[0]) as files:
            plan = denoise.explain(files.spec())
        self._sequence.rewind()
        for reading in self._report.readings:
            frame = self._sequence.read(reading.number, plan.planes, plan.guides)
            stops = reading.exposure_ev
            clean = replace(denoise(replace(frame, exposure=stops)), exposure=stops)
            for name, pixels in _views(clean, view(clean)[Role.COLOUR], 2.0**stops):
                path = folder / f"{name}.{reading.number:04d}.png"
                save_png(path, pixels)
                yield path

    def _view(self) -> list[Pass]:
        from postfx.passes.registry import create

        if self._arguments.no_tonemap:
            return [create("display")]
        tag = self._arguments.tonemap
        return [create("tonemap", **({"tag": tag} if tag else {}))]


def _views(clean: Frame, display: np.ndarray,
           exposure_factor: float) -> Iterator[tuple[str, np.ndarray]]:
    from postfx.colour.views import false_colour, log_c, luma, zebra
    from postfx.frame import Role
    from postfx.tools.exposure.plot import add_key

    signals = {"log_c": log_c(luma(clean[Role.COLOUR]) * exposure_factor), "display": luma(display)}
    for name, signal in signals.items():
        yield f"false_colour_{name}", add_key(false_colour(signal))
    yield "zebra", zebra(display)


def _row(shot: Shot, report: Report) -> str:
    from postfx.tools.exposure.debugger import DRIFTING_VERDICT

    frames = str(shot.first) if shot.first == shot.last else f"{shot.first}-{shot.last}"
    low, high = report.limits_ev  # black and white: beyond them nothing can be measured
    bound = "over " if shot.mismatch_ev <= low else "under " if shot.mismatch_ev >= high else ""
    mismatch = f"{'beyond ' * bool(bound)}{shot.mismatch_ev:+.2f} EV"
    right = f"{bound}{shot.right_ev:+.2f} EV (x {2**shot.right_ev:.3g})"
    row = (f"{frames:<12}{shot.level:>8.1%}{mismatch:>17}{shot.drift_ev:>7.2f} EV  "
           f"{right:<24}{shot.verdict}")
    return row + (f" by {shot.drift_ev:.2f} EV" if shot.verdict == DRIFTING_VERDICT else "")


def _round(values: dict[str, Any]) -> dict[str, Any]:
    return {name: round(value, 5) if isinstance(value, float) else value
            for name, value in values.items()}
