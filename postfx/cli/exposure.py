"""`postfx exposure`: is the exposure of a sequence right, steady, and applied as told?"""

from __future__ import annotations

import argparse
import json
import sys

from postfx.cli.options import Option, Options, Section
from postfx.cli.run_options import FILES, INPUT, refuse_several_views

DESCRIPTION = """\
Measure the exposure of a sequence at the end of the chain: a grey checkerboard, divided by the right exposure, goes
through the tone mapper with the exposure that the run uses. If the exposure is right, the board comes out as a steady
mid grey. Its level shows by how many stops the exposure is off, frame by frame and shot by shot (from cut to cut). It
also shows whether the exposure drifts, which one is right, and which mistake fits: exposure already in the colour, not
passed on, inverted, in stops, late or feeding back.

The board covers the picture, so the denoiser does not run: a frame takes the time to read its colour.

For a tone mapper or a grade outside postfx, 'POSTFX_EXPOSURE_TOOL=1 postfx run ...' writes frames that hold the
checkerboard, divided by each frame's exposure, which is in the headers (postfx:exposureUsed). Take them through your
chain and give the results to --graded. A chart (--chart) that goes through your tone mapper at 0 EV shows its curve
(--response); without it, levels are compared with the curve of --tonemap.
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
    EXPOSURE.add_to(parser)


def execute(arguments: argparse.Namespace) -> int:
    """Measure a sequence; returns the exit code."""
    from postfx.cli.exposure_check import ExposureCheck  # loads the runtime, which --help must not wait for
    from postfx.exposure.response import write_chart

    EXPOSURE.refuse_conflicts(arguments)
    refuse_several_views(arguments, "exposure")
    if arguments.chart:
        print(f"wrote    {write_chart(arguments.chart)}", file=sys.stderr)
        return 0
    check = ExposureCheck(arguments)
    print(json.dumps(check.as_dict()) if arguments.json else check.text())
    for path in check.write_pictures():
        print(f"wrote    {path}", file=sys.stderr)
    return 0 if check.is_right else 1


MODES = "auto|smooth|lit|metadata|EV"

EXPOSURE = Options(Section("", (
    INPUT,
    Option(flag="--frames", metavar="RANGE", help="frames to measure, e.g. 1-100"),
    Option(flag="--exposure", metavar=MODES, default="auto",
           help="what is under test, as for 'postfx run' (default: auto)"),
    Option(flag="--reference", metavar=MODES, default="smooth",
           help="what would be right (default: smooth, metered on the pictures); give an EV or metadata where the "
           "exposure is an author's choice"),
    Option(flag="--tonemap", metavar="TAG", either="look", help="look of the tone mapper (default: as 'postfx run')"),
    Option(flag="--no-tonemap", either="look", help="only expose, clip and encode"),
    Option(flag="--graded", metavar="FRAMES",
           help="what became of the boards of 'POSTFX_EXPOSURE_TOOL=1 postfx run' of INPUT with the same --exposure, "
           "numbered alike: PNG, TIFF, JPEG or EXR"),
    Option(flag="--response", metavar="FILE", help="what your tone mapper made of the chart: with --graded",
           needs={"--graded": "--response tells how --graded frames are read: give both"}),
    Option(flag="--chart", metavar="EXR",
           help="write a chart of greys, from 8 stops below mid grey to 8 above, for your tone mapper at 0 EV, and "
           "stop"),
    Option(flag="--curve", metavar="PNG", help="write a picture of the exposure over the sequence"),
    Option(flag="--views", metavar="DIR",
           help="write curve.png, and of each frame ARRI false colour of the Log C signal (log_c) and of the display's "
           "(display), and zebra at 95 %%. Frames are denoised and exposed first, which takes the time of a run"),
    Option(flag="--profile", metavar="NAME|FILE", help="renderer profile (default: found from the file)"),
    *FILES,
    Option(flag="--device", choices=("auto", "cpu", "cuda"), default="auto", help="where to run"),
    Option(flag="--json", help="print one JSON object"),
)))
