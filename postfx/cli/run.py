"""`postfx run`: process a sequence."""

from __future__ import annotations

import argparse
import json
import sys
from contextlib import suppress
from typing import TYPE_CHECKING

from postfx.cli.config import complete
from postfx.cli.options import Parser
from postfx.cli.run_options import PRESETS, RUN
from postfx.errors import PostfxError

if TYPE_CHECKING:
    from postfx.cli.job import Job
    from postfx.cli.summary import Report

DESCRIPTION = """\
Denoise a rendered sequence at its own size; enlarge it with --scale, tone-map it with --tonemap.

INPUT is a pattern like shot.####.exr, a folder or a file. EXR output stays scene-linear unless
--tonemap is given. PNG, JPEG and TIFF output is tone-mapped and encoded for a display.
"""
MORE = """\
INPUT is a file name with ####, %04d, @@@@ or $F4 for the frame number, a name with wildcards
(quoted or not), a folder that holds one sequence, or files of one sequence. Where every AOV has a
file of its own, put {plane} where their names differ: shot_{plane}.####.exr. Where every view has,
put {view}, or %V as Nuke does, into INPUT and OUTPUT.

Albedo, normal, roughness and depth may come at output size as guides, which make edges exact. They
may lie in files of their own (--guides), or be AOVs of INPUT that are larger than the colour. The
output then has their size.
"""
EXAMPLES = """\
examples:
  postfx run shot/noisy.####.exr -o out/clean.####.exr                 # scene-linear light
  postfx run shot/noisy.####.exr -o out/picture.####.png               # tone-mapped pictures
  postfx run shot/noisy.####.exr -o out/large.####.exr --scale 2       # denoised and twice as large
  postfx run shot/noisy.####.exr -o out/clean.####.exr --preset final  # for delivery
  postfx run shot/ -o out/ --skip-existing                             # go on after a stop

PSNR in dB to the best of Open Image Denoise for the same rays, at 4, 16 and 64 samples a pixel:
  postfx run, the render's size                    +0.91, +0.86, +0.50
  postfx run --with oidn                           +0.93, +0.92, +0.67
  postfx run --model m, a third of the time        -1.04, -0.98, -1.15
  postfx run --scale 2, half size, 4x the samples  -1.80, -3.84: if it cannot be rendered larger

A video of the pictures: ffmpeg -framerate 24 -i out/picture.%04d.png -pix_fmt yuv420p shot.mp4
'postfx run --help-all' shows all options, 'postfx config' the defaults of your studio.
"""
MORE_EXAMPLES = """\
examples:
  postfx run shot/noisy.####.exr -o out/clean.####.exr
  postfx run shot/noisy.%04d.exr -o out/picture.%04d.png --frames 1-100x2
  postfx run shot/ -o out/ --skip-existing --scale 1.5
  postfx run '~/shot/noisy.*.exr' -o '~/out/' --scale 2
  postfx run shot/dynamic.####.exr -o out/clean.####.exr --size 1920x1080
  postfx run shot/noisy.####.exr --guides shot/guides.####.exr -o out/clean.####.exr
  postfx run shot/noisy.%V.####.exr -o out/clean.%V.####.exr
  postfx run shot/noisy.####.exr -o out/clean.####.exr --both-ways
  postfx run shot/noisy.####.exr -o out/clean.####.exr --run-up 16
  postfx run shot/noisy.####.exr -o out/picture.####.png --model l --budget 500
  postfx run shot/noisy.####.exr -o out/clean.####.exr --leave 'auto,logo,glass_*=0.5'
  postfx run shot/noisy.####.exr -o out/clean.####.exr --aov key,fill,rim
  postfx run shot/adaptive.####.exr -o out/clean.####.exr --leave converged:0.01
  postfx run shot/noisy.####.exr -o out/clean.####.exr --on-error copy
  postfx run poster.exr -o out/ --memory 4G
  postfx run shot/noisy.####.exr -o out/layers.####.exr --overlay separate
  postfx run shot/noisy.####.exr --explain
  postfx run shot/noisy.####.exr -o out/clean.####.exr --capture look/ --capture-frame 5
  postfx run shot/noisy.####.exr -o out/clean.####.exr --capture look/ --capture-network
  postfx run shot/noisy.####.exr -o out/picture.####.png --exposure smooth
  postfx run shot/noisy.####.exr -o out/clean.####.exr --report out/report.html
  postfx run shot/noisy.####.exr -o out/clean.####.exr --report out/report.html \\
    --reference shot/clean.####.exr
  postfx run shot/noisy.####.exr -o out/hdr.####.png --tonemap ocio: --display pq,peak=1000
  postfx run shot/noisy.####.exr -o out/p3.####.tif --tonemap neutral --display p3 \\
    --colourspace acescg
  postfx run shot/noisy.####.exr -o out/film.####.png --tonemap film.cube,input=ACEScct
  postfx run shot/noisy.####.exr -o out/clean.####.exr --pass vignette,amount=0.5
  postfx run shot/noisy.####.exr -o out/picture.####.png --pass grain,after=tonemap --explain
  postfx run shot/noisy.####.exr -o out/clean.####.exr --ray 10.0.0.1:6379,size=50
  postfx run --passes
  POSTFX_EXPOSURE_TOOL=1 postfx run shot/noisy.####.exr -o out/grey.####.exr

POSTFX_EXPOSURE_TOOL=1 covers every frame with a grey checkerboard, see 'postfx exposure --help'.

Beside the frames lies postfx.manifest.json: how they were made, and the hash of each ('postfx
verify' checks it). Ctrl-C and SIGTERM end a run after the current frame; --skip-existing
continues with the same pixels.

Defaults of a studio come from postfx.toml: see 'postfx config --help'.

exit codes: 0 done; 2 an error whose message says how to fix it (finished frames are kept); 3 done,
but frames failed (--on-error skip or copy); 130 interrupted by Ctrl-C; 143 ended by SIGTERM
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this verb's arguments."""
    RUN.add_to(parser)
    parser.usage = f"{parser.prog} INPUT... -o OUTPUT [OPTIONS]"
    if isinstance(parser, Parser):
        parser.declared, parser.complete = RUN, complete(RUN, PRESETS)


def execute(arguments: argparse.Namespace) -> int:
    """Process the sequence; returns the exit code."""
    is_plan = arguments.explain or arguments.dry_run
    if arguments.default_files and not arguments.quiet:
        from postfx.streams import make_printable

        shown = f"{' '.join(arguments.defaults)} from {', '.join(arguments.default_files)}"
        print(f"defaults {make_printable(shown)}", file=sys.stderr)
    if arguments.ray and not is_plan:
        from postfx.cli.chunks import run_on_ray

        return run_on_ray(arguments)
    from postfx.cli.interruptions import EXIT_FAULTS
    from postfx.cli.job import Job  # loads the runtime, which --help must not wait for

    job = Job(arguments)
    if is_plan:
        _print_plan(job, arguments)
        return 0
    failure: PostfxError | KeyboardInterrupt | None = None
    try:
        job.run()
    except (PostfxError, KeyboardInterrupt) as error:
        failure = error
    report = job.report(failure)
    try:
        report = job.write_page(report)
    except PostfxError as error:
        # the frames are written all the same, and the summary tells of them
        failure = failure or error
        report = job.report(failure)
    if told := _summarize(report, arguments.quiet):
        with suppress(OSError):  # the frames are there, whoever does not listen any more
            print(told, file=sys.stderr)
    if arguments.json:
        print(json.dumps(report.as_dict()))
    if failure:
        raise failure
    return EXIT_FAULTS if report.faults else 0


def _summarize(report: Report, quiet: bool) -> str:
    """What to print at the end. A run that ended before any frame has nothing but its error, which
    a table of zeros would hide."""
    if report.error and not report.has_run:
        return ""
    return report.problems() if quiet else report.summary()


def _print_plan(job: Job, arguments: argparse.Namespace) -> None:
    """Print what would run, and with --dry-run the files that it would write."""
    explained = job.explain()
    paths, line = job.dry_run() if arguments.dry_run else ([], "")
    if arguments.json:
        outputs = {"outputs": [str(path) for path in paths]} if paths else {}
        print(json.dumps(explained.as_dict() | outputs, indent=2))
    else:
        print("\n".join(filter(None, [str(explained), job.kept, line])))
