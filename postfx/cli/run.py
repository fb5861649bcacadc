"""`postfx run`: process a sequence."""

from __future__ import annotations

import argparse
import json
import sys

from postfx.cli import books, looks
from postfx.cli.arguments import add_depth, add_report, count
from postfx.cli.both_ways import add_argument as add_both_ways
from postfx.cli.run_up import add_argument as add_run_up
from postfx.errors import PostfxError

HELP = "denoise, upscale and tone-map a sequence"
DESCRIPTION = """\
Denoise, upscale and tone-map a rendered sequence.

EXR output stays scene-linear unless --tonemap or --display is given. PNG, JPEG and TIFF output is tone-mapped and
encoded for a display, sRGB if not told otherwise.
INPUT is a file name with ####, %04d, @@@@ or $F4 for the frame number, a folder that holds one sequence, or a single
file. Where every plane has a file of its own, put {plane} where their names differ: shot_{plane}.####.exr

Albedo, normal, roughness and depth may come at output size as guides, which make edges exact: in files of their own
(--guides), or as planes larger than the colour in INPUT. The output then has their size.
"""
EXAMPLES = """\
examples:
  postfx run shot/noisy.####.exr -o out/clean.####.exr
  postfx run shot/noisy.%04d.exr -o out/picture.%04d.png --frames 1-100x2
  postfx run shot/ -o out/ --skip-existing --scale 1.5
  postfx run shot/dynamic.####.exr -o out/clean.####.exr --size 1920x1080
  postfx run shot/noisy.####.exr --guides shot/guides.####.exr -o out/clean.####.exr
  postfx run shot/noisy.####.exr -o out/clean.####.exr --both-ways
  postfx run shot/noisy.####.exr -o out/clean.####.exr --run-up 16
  postfx run shot/noisy.####.exr -o out/picture.####.png --model l --budget 500
  postfx run shot/noisy.####.exr -o out/clean.####.exr --leave 'auto,logo,glass_*=0.5'
  postfx run shot/adaptive.####.exr -o out/clean.####.exr --leave converged:0.01
  postfx run shot/noisy.####.exr -o out/clean.####.exr --scale 1 --on-error copy
  postfx run poster.exr -o out/ --memory 4G
  postfx run shot/noisy.####.exr -o out/layers.####.exr --overlay separate
  postfx run shot/noisy.####.exr --explain
  postfx run shot/noisy.####.exr -o out/clean.####.exr --capture look/ --capture-frame 5
  postfx run shot/noisy.####.exr -o out/clean.####.exr --capture look/ --capture-network
  postfx run shot/noisy.####.exr -o out/picture.####.png --exposure smooth
  postfx run shot/noisy.####.exr -o out/clean.####.exr --report out/report.html
  postfx run shot/noisy.####.exr -o out/clean.####.exr --report out/report.html --reference shot/clean.####.exr
  postfx run shot/noisy.####.exr -o out/hdr.####.png --tonemap ocio: --display pq,peak=1000
  postfx run shot/noisy.####.exr -o out/p3.####.tif --tonemap neutral --display p3 --colourspace acescg
  postfx run shot/noisy.####.exr -o out/film.####.png --tonemap film.cube,input=ACEScct
  POSTFX_EXPOSURE_TOOL=1 postfx run shot/noisy.####.exr -o out/grey.####.exr

POSTFX_EXPOSURE_TOOL=1 covers every frame with a grey checkerboard, see 'postfx exposure --help'.

Beside the frames lies postfx.manifest.json: how they were made, and the hash of each ('postfx verify' checks it).
Ctrl-C and SIGTERM end a run after the frame in work; --skip-existing goes on with the same pixels.

exit codes: 0 done; 2 an error that its message says how to mend (finished frames are kept); 3 done, but frames failed
(--on-error skip or copy); 130 interrupted by Ctrl-C; 143 ended by SIGTERM
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this verb's arguments."""
    parser.add_argument("input", metavar="INPUT", help="frames to read")
    parser.add_argument("-o", "--output", metavar="OUTPUT", help="files to write: a pattern, a folder or one file")
    parser.add_argument(
        "--guides", metavar="GUIDES", help="frames of planes at output size, named like INPUT and numbered alike"
    )
    parser.add_argument("--frames", metavar="RANGE", help="frames to process, e.g. 1-100, 1-100x2 or "
                        "1,5,8-12; from below 0 as --frames=-10-20")
    existing = parser.add_mutually_exclusive_group()
    existing.add_argument("--overwrite", action="store_true", help="replace output files that are there")
    existing.add_argument(
        "--skip-existing", action="store_true",
        help="keep output files that are whole, by the manifest's hash or decoded to the last pixel; go on from there",
    )
    parser.add_argument(
        "--preroll",
        metavar="N",
        type=count,
        help="frames to process without writing, before the first one of the range, so that the passes have their "
        "history (default: 0)",
    )
    parser.add_argument(
        "--keep", default="all", choices=("all", "none"), help="EXR: what the input holds beside the picture goes "
        "into the output bit for bit (channels at render size, parts, header), or not at all (default: all)",
    )
    parser.add_argument(
        "--on-error", default="stop", choices=("stop", "skip", "copy"), help="a frame that cannot be read or processed "
        "ends the run; has no output; or its picture is enlarged without denoising. The run goes on after the last two "
        "and exits with 3 (default: stop)",
    )
    books.add_arguments(parser.add_argument_group("logs and resuming"))
    _add_passes(parser.add_argument_group("passes"))
    _add_reading(parser.add_argument_group("reading and running"))
    reports = parser.add_argument_group("reports")
    reports.add_argument("--explain", action="store_true", help="show what would run and what is skipped, then stop")
    reports.add_argument("--json", action="store_true", help="print one JSON object on standard output at the end")
    add_report(reports, "before and after with an exposure slider, curves over the frames, times, what was skipped")
    reports.add_argument(
        "--reference", metavar="FRAMES", help="noise-free frames at output size, numbered like INPUT: the report "
        "compares with them, by PSNR and FLIP (needs the extra 'bench')",
    )
    _add_capture(parser.add_argument_group("capture"))


def execute(arguments: argparse.Namespace) -> int:
    """Process the sequence; returns the exit code."""
    from postfx.cli.job import Job  # loads the runtime, which --help must not wait for
    from postfx.cli.keeping import keeps
    from postfx.cli.on_error import EXIT_FAULTS

    job = Job(arguments)
    if arguments.explain:
        explained = job.explained()
        if arguments.json:
            print(json.dumps(explained.as_dict(), indent=2))
        else:
            print("\n".join([str(explained), *keeps(arguments, job.sequence)]))
        return 0
    failure = None
    try:
        job.run()
    except (PostfxError, KeyboardInterrupt) as error:
        failure = error
    report = job.report(failure)
    print(report.summary(), file=sys.stderr)
    if arguments.json:
        print(json.dumps(report.as_dict()))
    if failure:
        raise failure
    return EXIT_FAULTS if report.faults else 0


def _add_passes(group: argparse._ArgumentGroup) -> None:
    size = group.add_mutually_exclusive_group()
    size.add_argument(
        "--scale",
        type=float,
        metavar="S",
        help="output size over render size, 1 to 3 (default: the size of the guides, or 2 without guides)",
    )
    size.add_argument(
        "--size", type=_size, metavar="WxH",
        help="size of the output with all overscan, e.g. 1920x1080: frames may change their size between it and a "
        "third of it",
    )
    group.add_argument("--no-denoise", action="store_true", help="leave denoising and upscaling out")
    group.add_argument("--model", metavar="TAG", help="denoiser: s, m (default) or l in the device's fast "
                       "precision, or with one, e.g. m.fp32; 'postfx models' lists them")
    group.add_argument(
        "--budget", type=float, metavar="MS",
        help="milliseconds that denoising a frame may take: networks smaller than --model take turns with it",
    )
    add_both_ways(group)
    add_run_up(group)
    group.add_argument(
        "--strength", type=float, metavar="S",
        help="of denoising, 0 (only resample) to 1 (fully), times the plane 'strength' if there is one (default: 1)",
    )
    group.add_argument(
        "--leave", metavar="NAMES",
        help="what to leave as it is: objects or materials of a Cryptomatte, ids of a plane, 'auto' for sky and "
        "misses that are free of noise, and 'converged:0.01' for what its variance says to have at most 1 %% of error, "
        "or 'converged:256spp'; with a strength of their own after =, e.g. auto,sky_*,logo=0.5,7-9@id",
    )
    looks.add_arguments(group)
    group.add_argument(
        "--overlay", default="composite", choices=("composite", "separate", "ignore"), help="transparency overlay: "
        "over the denoised picture and its alpha, as an EXR layer of the same size beside the picture without it, or "
        "unread (default: composite)",
    )
    group.add_argument(
        "--reactive", metavar="KIND[,NAME=NUMBER]",
        help="where the history is not used, for particles and the like: plane (the plane 'reactive'), difference "
        "(colour against the plane 'opaque_colour'), auto (the first of these that is there, default) or none; with "
        "scale= and threshold= of the difference, e.g. auto,scale=8",
    )
    group.add_argument(
        "--exposure",
        default="auto",
        metavar="auto|smooth|metadata|EV",
        help="metered on the pictures so far, on the whole sequence in a pass before (steadier), from the header "
        "(postfx:exposure), or a number of stops (default: auto)",
    )


def _add_reading(group: argparse._ArgumentGroup) -> None:
    group.add_argument(
        "--profile", metavar="NAME|FILE", help="how the renderer names its planes (default: found from the file)"
    )
    add_depth(group)
    group.add_argument(
        "--colourspace", metavar="NAME", help="linear primaries of the colours: rec709, p3, rec2020, acescg or "
        "aces2065-1 (default: by the headers chromaticities or colorInteropID, else rec709)",
    )
    group.add_argument(
        "--cuts", default="auto", metavar="auto|none|FRAMES", help="where shots begin, so that the history is "
        "dropped: by headers and pictures, nowhere, or at these frames, e.g. 1,48,90 (default: auto)",
    )
    group.add_argument("--device", default="auto", choices=("auto", "cpu", "cuda"), help="where to run")
    group.add_argument(
        "--memory", metavar="SIZE",
        help="what the process may have in memory, e.g. 4G: frames are worked on in tiles, and what is too large lies "
        "in temporary files (TMPDIR); CPU only (default: no limit)",
    )
    group.add_argument("--threads", type=_positive, metavar="N", help="CPU threads (default: all usable cores)")


def _add_capture(group: argparse._ArgumentGroup) -> None:
    group.add_argument(
        "--capture",
        metavar="DIR",
        help="write DIR/capture.html, a page on one frame's commands: times, memory, dependencies, tensors, networks",
    )
    group.add_argument(
        "--capture-frame", metavar="N", type=count, help="frame to capture (default: the second, which has a history)"
    )
    group.add_argument(
        "--capture-tensors",
        choices=("thumbnails", "none", "all"),
        help="of each tensor keep figures and small pictures (default), nothing, or also all of it in DIR/tensors, "
        "for 'postfx capture-compare'",
    )
    group.add_argument(
        "--capture-network",
        action="store_true",
        help="also run the frame's networks once more, node by node: figures, pictures and time of each node",
    )


def _size(text: str) -> tuple[int, int]:
    width, _, height = text.partition("x")
    if not (width.isdigit() and height.isdigit()):
        raise argparse.ArgumentTypeError(f"'{text}' is not a size like 1920x1080")
    return int(width), int(height)


def _positive(text: str) -> int:
    if count(text) < 1:
        raise argparse.ArgumentTypeError("at least 1 is needed")
    return int(text)
