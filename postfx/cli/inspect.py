"""`postfx inspect`: what a sequence holds and how postfx understands it."""

from __future__ import annotations

import argparse
import json

HELP = "show which planes a sequence holds"
DESCRIPTION = """\
Show how postfx understands a sequence: the renderer profile, sizes, every plane with its channels and values, what is
missing, planes at output size, and the camera. Reads one frame: the first, or the first of --frames.
"""
EXAMPLES = """\
examples:
  postfx inspect shot/noisy.####.exr
  postfx inspect shot/ --profile studio.toml --frames 12
  postfx inspect shot/noisy.####.exr --guides shot/guides.####.exr
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this verb's arguments."""
    parser.add_argument("input", metavar="INPUT", help="pattern, folder or file, as for 'postfx run'")
    parser.add_argument("--guides", metavar="GUIDES", help="files of planes at output size, as for 'postfx run'")
    parser.add_argument("--frames", metavar="RANGE", help="frames of interest, e.g. 12 or 1-100")
    parser.add_argument("--profile", metavar="NAME|FILE", help="renderer profile (default: found from the file)")
    parser.add_argument("--json", action="store_true", help="print one JSON object")


def execute(arguments: argparse.Namespace) -> int:
    """Inspect a sequence; returns the exit code."""
    from postfx.cli.inspection import inspect, text_of  # loads NumPy and OpenImageIO, which --help must not wait for

    found = inspect(arguments.input, arguments.frames, arguments.profile, arguments.guides)
    print(json.dumps(found) if arguments.json else text_of(found))
    return 0
