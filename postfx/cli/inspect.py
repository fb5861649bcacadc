"""`postfx inspect`: what a sequence holds, how postfx understands it, and what is wrong with it."""

from __future__ import annotations

import argparse
import json
import sys
from typing import TYPE_CHECKING, Any

from postfx.cli.run_options import DEPTH_OPTION, FILES, INPUT, refuse_several_views

if TYPE_CHECKING:
    from rich.text import Text

DESCRIPTION = """\
Find what is wrong with a sequence. Up to eight consecutive frames are read, from the first one or
the first of --frames. Albedos, normals, roughness, depth, motion, jitter, cuts, exposure and noise
are checked. Motion vectors are tried in all common conventions (signs, axes, units, with jitter),
and the one that fits best is named. Each finding says what was measured, the likely cause and the
fix.

After the findings come the renderer's profile, sizes, every AOV with its channels and values, what
is missing, guides and the camera.
"""
EXAMPLES = """\
examples:
  postfx inspect shot/noisy.####.exr
  postfx inspect shot/noisy.####.exr --pictures look/       # one PNG for each AOV
  postfx inspect shot/noisy.####.exr --report shot.html     # everything on one page
  postfx inspect shot/ --profile studio.toml --frames 12-20
  postfx inspect shot/noisy.####.exr --guides shot/guides.####.exr
  postfx inspect shot/noisy.####.exr --depth reversed,near=0.1    # is that what the AOV holds?
  postfx inspect shot/noisy.####.exr --json | python -m json.tool

exit codes: 0 fine; 1 warnings only; 2 at least one error; 130 interrupted. Wrong arguments and a
first frame that cannot be read also give 2, with one line on standard error and nothing on standard
output.
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this verb's arguments."""
    INPUT.add_to(parser)
    parser.add_argument("--guides", metavar="GUIDES",
                        help="AOVs at output size, as for 'postfx run'")
    parser.add_argument("--frames", metavar="RANGE",
                        help="frames to check, e.g. 12 or 1-100: the first eight of them")
    parser.add_argument("--profile", metavar="NAME|FILE",
                        help="renderer profile (default: found from the file)")
    DEPTH_OPTION.add_to(parser)
    FILES.add_to(parser)
    parser.add_argument("--pictures", metavar="DIR",
                        help="write a picture of every AOV of the first frame to this folder")
    parser.add_argument(
        "--report", metavar="HTML",
        help="write an HTML page that needs no network: frames with an exposure slider, curves, "
        "findings and a picture of every AOV",
    )
    parser.add_argument("--json", action="store_true", help="print one JSON object")


def execute(arguments: argparse.Namespace) -> int:
    """Inspect a sequence; returns the exit code."""
    # loads NumPy and OpenImageIO, which --help must not wait for
    from postfx.cli.report import write_inspection
    from postfx.doctor.inspection import Inspection

    refuse_several_views(arguments, "inspect")
    inspection = Inspection(arguments.input, arguments.frames, arguments.profile, arguments.guides,
                            arguments.depth, arguments.colourspace, arguments.layer, arguments.view)
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


STYLES = {"error": "bold red", "warning": "yellow", "info": "cyan"}
VERDICTS = {0: "nothing wrong was found", 1: "there are warnings", 2: "there are errors"}
LINE_INDENT = " " * 9
MOST_LISTED_LINES = 12
"""Layers that the line of unread ones names."""


def print_text(facts: dict[str, Any], exit_code: int) -> None:
    """Print facts as lines; findings are coloured on a terminal."""
    from rich.console import Console

    from postfx.streams import make_printable, styled

    console = Console(file=styled(sys.stdout), highlight=False, soft_wrap=True, markup=False,
                      emoji=False)
    for line in _lines(facts, exit_code):
        if isinstance(line, str):
            console.print(make_printable(line))
        else:
            line.plain = make_printable(line.plain)
            console.print(line)


def _lines(facts: dict[str, Any], exit_code: int) -> list[str | Text]:
    from postfx.io.profile import NAME_SOURCES

    profile, examined = facts["profile"], len(facts["examined"])
    absent = facts["absent_frames"]
    looked = f", {len(absent)} of them without a file" if absent else ""
    looked += f", {examined} examined" if facts["frames"]["count"] > 1 else ""
    looked += f", ranges from {len(facts['measured'])}" if len(facts["measured"]) > examined else ""
    return [
        f"{facts['source']}: {_frames_text(facts['frames'])}{looked}: {VERDICTS[exit_code]}",
        f"profile {profile['name']} ({profile['title'] or 'own'}), "
        f"{facts['width']}x{facts['height']}",
        *([f"names are {NAME_SOURCES[profile['source']]}"] if profile["source"] else []),
        "",
        *(line for finding in facts["findings"] for line in _finding_lines(finding)),
        *([""] if facts["findings"] else []),
        *(_plane_line(plane, profile["source"]) for plane in facts["planes"]),
        "",
        *_guide_lines(facts["guides"]),
        *_missing_lines(facts["missing"]),
        *_unread_lines(facts["unread"]),
        *(f"header   {name}: {value}" for name, value in facts["header"].items()),
        *(f"warning  {warning}" for warning in facts["warnings"]),
        *_absent_lines(facts["absent_frames"]),
        *([f"wrote    {len(facts['pictures'])} pictures: {facts['pictures'][0]} ..."]
          if facts["pictures"] else []),
    ]


def _missing_lines(missing: list[dict[str, str]]) -> list[str]:
    """AOVs that are needed or improve any result, a line each, and in one line those that few
    frames need."""
    from postfx.doctor.plane_checks import COSTS

    wanted = [item for item in missing if item["role"] in ("colour", *COSTS)]
    others = [item["role"] for item in missing if item not in wanted]
    lines = [f"missing  {item['role']}{': ' + item['fix'] if item['fix'] else ''}"
             for item in wanted]
    return lines + ([f"optional {', '.join(others)}: not in the file"] if others else [])


def _unread_lines(layers: list[str]) -> list[str]:
    """What the file holds beside the planes, in one line."""
    more = (f" and {len(layers) - MOST_LISTED_LINES} more, see --json"
            if len(layers) > MOST_LISTED_LINES else "")
    return [f"unread   {'; '.join(layers[:MOST_LISTED_LINES])}{more}"] if layers else []


def _finding_lines(finding: dict[str, str]) -> list[str | Text]:
    from rich.text import Text

    level = finding["level"]
    head = Text.assemble((f"{level:<9}", STYLES[level]), (finding["code"], "bold"),
                         f" ({finding['role']}): {finding['evidence']}")
    fix, *lines = finding["fix"].splitlines()
    return [head, f"{LINE_INDENT}likely: {finding['cause']}", f"{LINE_INDENT}fix:    {fix}",
            *(LINE_INDENT + line for line in lines)]


def _frames_text(frames: dict[str, int]) -> str:
    return (f"{frames['count']} frames, {frames['first']} to {frames['last']}"
            if frames["count"] > 1 else "1 frame")


def _guide_lines(guides: dict[str, Any] | None) -> list[str]:
    if guides is None:
        return []
    jitter = f", jitter {guides['jitter']}" if guides["jitter"] else ""
    head = f"guides {guides['width']}x{guides['height']} in {guides['source']}{jitter}"
    return [head, "", *map(_plane_line, guides["planes"]), ""]


def _plane_line(plane: dict[str, Any], source: str = "") -> str:
    """One line; it says where the plane's names are from if that is neither `source` nor the user's
    own profile."""
    from postfx.io.profile import NAME_SOURCES

    values = "no value" if plane["min"] is None else f"{plane['min']:.4g} .. {plane['max']:.4g}"
    signed = plane["role"] in ("motion", "normal", "denoising_normal")
    counts = (("misses", "misses"), ("non_finite", "not finite"),
              *(() if signed else (("negative", "negative"),)))
    odd = [f"{plane[key]} {words}" for key, words in counts if plane[key]]
    odd += [f"noise {plane['noise']:.2g}"] if (plane["noise"] or 0) >= 1e-3 else []
    odd += [f"name {NAME_SOURCES[plane['source']]}"] if plane["source"] not in ("", source) else []
    text = f"{plane['role']:<22}{plane['channels']:<38}{values}"
    return f"{text} ({', '.join(odd)})" if odd else text


def _absent_lines(numbers: list[int]) -> list[str]:
    return ([f"warning  frames without a file: {', '.join(map(str, numbers[:10]))}"] if numbers
            else [])
