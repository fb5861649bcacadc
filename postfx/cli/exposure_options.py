"""The options of `postfx exposure`: each is declared here, once, as those of `postfx run` are in `run_options`."""

from __future__ import annotations

from postfx.cli.options import Option, Options, Section
from postfx.cli.run_options import FILES, INPUT

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
           help="write curve.png and, of each frame, denoised and exposed as under test: ARRI false colour of the Log "
           "C signal (log_c) and of the display's (display), and zebra at 95 %%; takes the time of a run"),
    Option(flag="--profile", metavar="NAME|FILE", help="renderer profile (default: found from the file)"),
    *FILES,
    Option(flag="--device", choices=("auto", "cpu", "cuda"), default="auto", help="where to run"),
    Option(flag="--json", help="print one JSON object"),
)))
