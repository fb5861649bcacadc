"""`postfx capture-compare`: where two captures begin to differ."""

from __future__ import annotations

import argparse
import json
from typing import TYPE_CHECKING

from postfx.cli.options import parse_from_zero

if TYPE_CHECKING:
    from postfx.tools.report.capture_data import Comparison

DESCRIPTION = """\
Compare two captures of the same passes, options and frame, command by command: the first tensor
whose largest relative error exceeds the tolerance, and a table of all. Both have to be made with
--capture-tensors all; where both also have --capture-network, the first node inside a network is
found. B is the reference: an element's error is |a - b| over |b| or, if that is larger, over the
mean of |b|.
"""
EXAMPLES = """\
examples:
  postfx capture-compare after/ before/ --tolerance 1e-4

where the captures come from:
  postfx run shot/noisy.####.exr -o out/a.####.exr --frames 1-2 --capture before/ \\
    --capture-tensors all
  postfx run shot/noisy.####.exr -o out/b.####.exr --frames 1-2 --capture after/ \\
    --capture-tensors all --device cuda

exit codes: 0 equal within the tolerance; 1 not; 2 an error whose message says how to fix it
"""
EXIT_DIFFERENT = 1
"""Exit code where captures differ."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this verb's arguments."""
    parser.add_argument("a", metavar="A", help="capture.json or its folder")
    parser.add_argument("b", metavar="B", help="the reference, likewise")
    parser.add_argument(
        "--tolerance", type=parse_from_zero, default=1e-3, metavar="X",
        help="largest relative error allowed (default: 1e-3)",
    )
    parser.add_argument("--json", action="store_true", help="print one JSON object")


def execute(arguments: argparse.Namespace) -> int:
    """Compare; returns the exit code."""
    # loads the runtime, which --help must not wait for
    from postfx.tools.report.capture_data import compare

    found = compare(arguments.a, arguments.b, arguments.tolerance)
    print(json.dumps(found.as_dict()) if arguments.json else text_of(found))
    return EXIT_DIFFERENT if found.first else 0


def text_of(found: Comparison) -> str:
    """The comparison for people."""
    lines = [f"{'':2}{'#':>4} {'error':>9}  {'':6}{'tensor':<24} command"]
    for row in found.differences:
        mark = ">" if row is found.first else "!" if row.error > found.tolerance else ""
        head = f"{mark:<2}{row.index:>4} {row.error:9.2e}  {row.access:<6}"
        lines.append(f"{head}{row.tensor:<24} {row.label}: {row.node or row.command}")
    return "\n".join([*lines, _verdict(found)])


def _verdict(found: Comparison) -> str:
    if found.first is None:
        return f"equal: no tensor differs by more than {found.tolerance:g}"
    first = found.first
    what = "read from outside by" if first.access == "input" else "written by"
    what += f" {first.node} of" if first.node else ""
    where = f"{what} command {first.index} '{first.label}' ({first.command})"
    return (f"first difference over {found.tolerance:g}: '{first.tensor}' {where}, "
            f"{first.error:.3g} at {first.place}")
