"""`postfx bench`: run time against error."""

from __future__ import annotations

import argparse
import json

from postfx.cli.options import parse_positive
from postfx.errors import BenchError
from postfx.version import pip_install

DESCRIPTION = f"""\
Measure run time against error: this project's networks, Open Image Denoise, accumulation and plain
enlargement, side by side on noisy frames with references. Needs the extra 'bench':
{pip_install('bench')}

The scale follows from the sizes of the frames and of the references. Every method runs in a process
of its own, so its peak of memory is its own; reading, writing and scoring are not timed. Times are
medians of several runs.

PSNR, SSIM and FLIP are of what is seen (exposure, x / (1 + x), sRGB), relMSE of linear light.
Flicker is 1000 times the mean absolute error of the change from frame to frame along the motion.
'late' is the second half.

Methods are the networks by tag, as 'm', with '-int8', '-fp16' and '-guides' where there are such
models. '-alone' drops the history at every frame, '-run-up' begins as 'postfx run' does, and
'-both-ways' is its --both-ways. OIDN runs at the render size and is then enlarged: oidn-fast,
oidn-balanced, oidn-high. It takes albedo and normal as if they were clean. With
oidn-high-prefiltered it denoises them first. With oidn-high-raw it takes them as noisy, and with
oidn-high-colour it gets none. For oidn-high-accumulated the best of these is accumulated along the
motion at output size. Others are accumulation and bicubic. The families ours, oidn and plain name
all of theirs. --ablations adds 'm-without-roughness' and so on for each AOV beside the colour, and
'm-without-all'.
"""
EXAMPLES = """\
examples:
  postfx bench shot/noisy.####.exr --reference shot/reference.####.exr -o out/bench
  postfx bench shot/noisy.####.exr --reference shot/reference.####.exr -o out/bench \\
    --methods ours,oidn-high --models m
  postfx bench shot/noisy.####.exr --guides shot/guides.####.exr \\
    --reference shot/reference.####.exr -o out/bench
  postfx bench shot/noisy.####.exr --reference shot/reference.####.exr -o out/bench \\
    --threads 1 --runs 5 --json
  postfx bench shot/noisy.####.exr --frames 1-3 --stress

OUT then holds bench.csv (a line a method), bench.json (everything, frame by frame),
pareto_psnr.png, pareto_flicker.png, crops.png (details where methods differ most) and the results
under OUT/frames/METHOD/. Where OIDN is ahead, crops_worst.png shows the details.
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this verb's arguments."""
    parser.add_argument("input", metavar="NOISY",
                        help="noisy frames: a pattern, a folder or a file")
    parser.add_argument("--reference", metavar="REF", help="references, numbered like the frames")
    parser.add_argument("-o", "--output", metavar="OUT",
                        help="folder for tables, plots and results")
    parser.add_argument("--stress", action="store_true",
                        help="measure nothing: write values into frames that no renderer should "
                        "(NaN, 40 stops, motion of 1e6 pixels), and check what the networks output")
    parser.add_argument("--guides", metavar="GUIDES",
                        help="AOVs at output size, numbered like the frames")
    parser.add_argument("--frames", metavar="RANGE", help="frames to measure, e.g. 1-8")
    parser.add_argument("--profile", metavar="NAME|FILE",
                        help="renderer profile of NOISY (default: found)")
    parser.add_argument("--methods", metavar="LIST",
                        help="names or families, comma-separated (default: all)")
    parser.add_argument("--models", metavar="LIST",
                        help="tags of networks, e.g. s,m,l (default: all there are)")
    parser.add_argument("--ablations", action="store_true",
                        help="also measure networks without some AOVs")
    parser.add_argument("--runs", type=parse_positive, default=3, metavar="N",
                        help="runs a method (default: 3)")
    parser.add_argument("--device", default="auto", choices=("auto", "cpu", "cuda"),
                        help="where to run")
    parser.add_argument("--threads", type=parse_positive, metavar="N",
                        help="CPU threads (default: all usable cores)")
    parser.add_argument("--json", action="store_true",
                        help="print one JSON object in place of the table")


def execute(arguments: argparse.Namespace) -> int:
    """Measure; returns the exit code."""
    if arguments.stress:
        return _stress(arguments)
    if not (arguments.reference and arguments.output):
        raise BenchError("bench needs --reference and -o, or --stress: see postfx bench --help")
    from pathlib import Path

    from postfx.tools.bench.job import (  # loads the runtime, which --help must not wait for
        Bench,
        Request,
    )
    from postfx.tools.bench.measure import Sources
    from postfx.tools.bench.report import print_table

    sources = Sources(arguments.input, arguments.reference, arguments.guides, arguments.frames,
                      arguments.profile)
    wish = Request(Path(arguments.output), arguments.methods, arguments.models, arguments.runs,
                arguments.device, arguments.threads, arguments.ablations)
    facts = Bench(sources, wish).run()
    if arguments.json:
        print(json.dumps(facts))
    else:
        print_table(facts)
        pictures = ", ".join(sorted(path.name for path in wish.output.glob("*.png")))
        print(f"wrote {wish.output}: bench.csv, bench.json, {pictures}, frames/")
    return 0


def _stress(arguments: argparse.Namespace) -> int:
    from postfx.io.sequence import read_sequence
    from postfx.runtime import Device
    from postfx.tools.bench.stress import as_dict, as_text, stress

    frames = list(read_sequence(arguments.input, arguments.frames, arguments.profile))
    models = arguments.models.split(",") if arguments.models else None
    found = list(stress(frames, Device(arguments.device, arguments.threads), models))
    print(json.dumps(as_dict(found)) if arguments.json else as_text(found))
    return 0 if all(one.well for one in found) else 1
