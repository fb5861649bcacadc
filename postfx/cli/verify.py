"""`postfx verify`: are all files of a run there, and as they were written."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import TYPE_CHECKING

from postfx.streams import make_printable

if TYPE_CHECKING:
    from collections.abc import Sequence

    from postfx.runs.manifest import Verification

DESCRIPTION = """\
Check the files of a folder against postfx.manifest.json, which 'postfx run' keeps beside the
frames: each must exist and have the SHA-256 that it was written with. It also lists files that a
run should have written but did not, and files with names like a run's that no run wrote. Nothing is
changed.
"""
EXAMPLES = """\
examples:
  postfx verify out/
  postfx verify out/ --json
  postfx verify out/ --frames 1-200
  postfx verify node1/ node2/ --frames 1-200
  postfx verify out/ || postfx run shot/noisy.####.exr -o out/clean.####.exr --skip-existing

exit codes: 0 all files are complete and unaltered; 1 files are altered, missing, unfinished or
unknown, or with --frames their runs had differing settings; 2 there is no manifest, or it cannot be
read
"""
MOST_LISTED_FILES = 10
MEANINGS = {
    "altered": "not as it was written",
    "missing": "was written and is gone",
    "unfinished": "was to be written and was not",
    "unknown": "no run wrote it",
    "differing": "its run had other settings or versions than the first",
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this verb's arguments."""
    parser.add_argument("folder", metavar="OUT", nargs="+",
                        help="folder that 'postfx run' wrote to")
    parser.add_argument("--frames", metavar="RANGE", help="frames that must be there, e.g. 1-200")
    parser.add_argument("--json", action="store_true",
                        help="print one JSON object: lists of file names")


def execute(arguments: argparse.Namespace) -> int:
    """Check folders; returns the exit code."""
    from postfx.errors import OptionError
    from postfx.io.pattern import parse_frames
    from postfx.runs.manifest import verify, verify_together

    folders = [Path(folder) for folder in arguments.folder]
    if arguments.frames is None and len(folders) > 1:
        raise OptionError("several folders are checked together: give --frames, the frames that "
                          "they hold, e.g. 1-200")
    found = (verify(folders[0]) if arguments.frames is None
             else verify_together(folders, parse_frames(arguments.frames)))
    kinds = [kind for kind in MEANINGS if kind != "differing" or arguments.frames is not None]
    print(json.dumps(found.as_dict()) if arguments.json
          else "\n".join(map(make_printable, _lines(found, kinds))))
    return 0 if found.is_well else 1


def _lines(found: Verification, kinds: Sequence[str]) -> list[str]:
    """The result for people, of the kinds of faults that were looked for."""
    lines = []
    for kind in kinds:
        names = getattr(found, kind)
        lines += [f"{kind:<11}{name}: {MEANINGS[kind]}" for name in names[:MOST_LISTED_FILES]]
        lines += ([f"{kind:<11}{len(names) - MOST_LISTED_FILES} more"]
                  if len(names) > MOST_LISTED_FILES else [])
    ended = [f"run {run} was {state}" for run, state in found.runs.items() if state != "finished"]
    counts = ", ".join(f"{len(getattr(found, kind))} {kind}" for kind in ("whole", *kinds))
    return [*lines, *ended, counts]
