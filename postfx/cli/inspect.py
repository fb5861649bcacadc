"""`postfx inspect`: what a sequence holds, how postfx understands it, and what is wrong with it."""

from __future__ import annotations

import argparse
import json

from postfx.cli.run_options import DEPTH, FILES, INPUT, refuse_several_views

DESCRIPTION = """\
Find what is wrong with a sequence: reads up to eight consecutive frames from the first one (or the first of --frames),
and checks albedos, normals, roughness, depth, motion, jitter, cuts, exposure and noise. Motion is tried in all common
variants (signs, axes, units, with jitter) by warping, and the best one is named. Each finding says what was measured,
the likely cause and the fix. What --depth says is taken as true and then checked like everything else.
After the findings: the renderer profile, sizes, every plane with its channels and values, what is missing, planes at
output size, and the camera.
"""
EXAMPLES = """\
examples:
  postfx inspect shot/noisy.####.exr
  postfx inspect shot/noisy.####.exr --pictures look/       # one PNG a plane
  postfx inspect shot/noisy.####.exr --report shot.html     # everything on one page
  postfx inspect shot/ --profile studio.toml --frames 12-20
  postfx inspect shot/noisy.####.exr --guides shot/guides.####.exr
  postfx inspect shot/noisy.####.exr --depth reversed,near=0.1    # is that what the plane holds?
  postfx inspect shot/noisy.####.exr --json | python -m json.tool

exit codes: 0 fine; 1 warnings only; 2 at least one error; 130 interrupted. Wrong arguments and a first frame that
cannot be read also give 2, with one line on standard error and nothing on standard output.
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this verb's arguments."""
    INPUT.add_to(parser)
    parser.add_argument("--guides", metavar="GUIDES", help="files of planes at output size, as for 'postfx run'")
    parser.add_argument("--frames", metavar="RANGE", help="frames of interest, e.g. 12 or 1-100")
    parser.add_argument("--profile", metavar="NAME|FILE", help="renderer profile (default: found from the file)")
    DEPTH.add_to(parser)
    FILES.add_to(parser)
    parser.add_argument("--pictures", metavar="DIR", help="write a picture of every plane of the first frame there")
    parser.add_argument(
        "--report", metavar="HTML", help="write a page that opens from the disk and needs no network: frames with an "
        "exposure slider, curves, findings and a picture of every plane",
    )
    parser.add_argument("--json", action="store_true", help="print one JSON object")


def execute(arguments: argparse.Namespace) -> int:
    """Inspect a sequence; returns the exit code."""
    from postfx.cli.inspection import Inspection, print_text  # loads NumPy and OpenImageIO: --help must not wait
    from postfx.cli.report import write_inspection

    refuse_several_views(arguments, "inspect")
    inspection = Inspection(arguments.input, arguments.frames, arguments.profile, arguments.guides, arguments.depth,
                            arguments.colourspace, arguments.layer, arguments.view)
    if arguments.pictures:
        inspection.write_pictures(arguments.pictures)
    if arguments.report:
        write_inspection(inspection, arguments.report)
    facts = inspection.facts()
    if arguments.json:
        print(json.dumps(facts))
    else:
        print_text(facts, inspection.exit_code)
    return inspection.exit_code
