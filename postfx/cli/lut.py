"""`postfx lut`: a look as a .cube file for other software."""

from __future__ import annotations

import argparse
import json
from pathlib import Path

from postfx.cli.options import Options, Section
from postfx.cli.run_options import FILES, LOOK_OPTIONS

DESCRIPTION = """\
Write the global part of a look as a 3-D look-up table (.cube) that OpenColorIO, DaVinci Resolve,
Nuke and others read. It takes ACEScct and gives code values of --display. Apply the exposure before
it.

A network's look depends on the whole picture, so other pictures give another table. This one is the
mean over every other frame of INPUT. Its error is measured on the remaining frames (on the same one
if there is only one), printed and written into the file.
"""
EXAMPLES = """\
examples:
  postfx lut shot/clean.####.exr -o aces2.cube
  postfx lut still.exr -o neutral_p3.cube --tonemap neutral --display p3 --size 65
  postfx run shot/noisy.####.exr -o out/picture.####.png --tonemap aces2.cube
"""
_SIZES = (17, 33, 65)
_MOST_FRAMES = 16
"""Frames that a cube is made of unless others are given."""
_LOOK = Options(Section("", LOOK_OPTIONS))


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this verb's arguments."""
    parser.add_argument("input", metavar="INPUT",
                        help="frames that the look is for, as for 'postfx run'")
    parser.add_argument("-o", "--output", required=True, metavar="FILE.cube", help="file to write")
    _LOOK.add_to(parser)
    parser.add_argument("--size", type=int, default=33, choices=_SIZES,
                        help="colours along each side (default: 33)")
    parser.add_argument("--frames", metavar="RANGE",
                        help=f"frames to use (default: {_MOST_FRAMES} of them)")
    parser.add_argument(
        "--exposure", default="auto", metavar="auto|metadata|EV",
        help="as for 'postfx run' (default: auto)"
    )
    parser.add_argument("--profile", metavar="NAME|FILE",
                        help="renderer profile (default: found from the file)")
    FILES.add_to(parser)
    parser.add_argument("--device", default="auto", choices=("auto", "cpu", "cuda"),
                        help="where to run")
    parser.add_argument("--json", action="store_true", help="print one JSON object")


def execute(arguments: argparse.Namespace) -> int:
    """Make, measure and write a table; returns the exit code."""
    from postfx.colour.views import VIEWS
    from postfx.errors import OptionError, WriteError
    from postfx.exposure import ExposureMeter
    from postfx.frame import Role
    from postfx.io.sequence import read_sequence
    from postfx.passes.display import make_display_passes
    from postfx.passes.tonemap import looks_by_name
    from postfx.runtime import Device
    from postfx.tools.look_table import LookTable, expose_colour

    if arguments.input in (*looks_by_name(), *VIEWS) and not Path(arguments.input).exists():
        raise OptionError(f"{arguments.input}: is a look: give frames that it is for, and name it "
                          f"by --tonemap {arguments.input}")
    path = Path(arguments.output)
    if path.suffix.lower() != ".cube":
        raise WriteError(f"{path}: is not a .cube file: name it {path.with_suffix('.cube')}")
    passes, _ = make_display_passes(True, **_LOOK.values_for("look", arguments))
    values = FILES.values_for("sequence", arguments)
    sequence = read_sequence(arguments.input, arguments.frames, arguments.profile, [Role.COLOUR],
                             **values).first_view()
    numbers = (sequence.numbers if arguments.frames
               else sequence.numbers[:: -(-len(sequence) // _MOST_FRAMES)])
    meter = ExposureMeter(arguments.exposure)
    frames = [expose_colour(frame, meter(frame)) for frame in map(sequence.read, numbers)]
    others = frames[1::2] or frames
    table = LookTable(passes, frames[::2], Device(arguments.device), arguments.size)
    look = arguments.tonemap or ("no tone mapping" if arguments.no_tonemap
                                 else "the default network")
    made = f"Look '{look}' on {len(frames[::2])} of the frames {arguments.input}, made by postfx"
    table.write(path, [made])
    found = table.measure(path, others)
    measured = f"{len(others)} frame{'s' * (len(others) > 1)}"
    table.write(path, [made, f"Against the look itself, on {measured}: {found}"])
    facts = {"output": str(path), "size": arguments.size, "display": table.output,
             "frames": len(frames[::2]), "measured_on": len(others), "psnr": found.psnr,
             "delta_e_itp": found.mean, "delta_e_itp_99": found.most}
    lines = [f"wrote    {path}: {arguments.size}x{arguments.size}x{arguments.size}, ACEScct to "
             f"{table.output}",
             f"error    against the look itself, on {measured}: {found}"]
    print(json.dumps(facts) if arguments.json else "\n".join(lines))
    return 0
