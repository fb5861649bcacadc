"""Arguments that several verbs have."""

from __future__ import annotations

import argparse


def from_zero(text: str) -> float:
    """A number from 0, as argparse's `type`."""
    try:
        number = float(text)
    except ValueError:
        number = -1.0
    if not number >= 0:
        raise argparse.ArgumentTypeError(f"'{text}' is not a number from 0")
    return number


def count(text: str) -> int:
    """A whole number from 0, as argparse's `type`."""
    if not text.isdigit():
        raise argparse.ArgumentTypeError(f"'{text}' is not a whole number from 0")
    return int(text)


def add_depth(parser: argparse._ActionsContainer) -> None:
    """Add --depth, the text for `postfx.io.convert.parse_depth`."""
    parser.add_argument(
        "--depth", metavar="KIND[,NAME=NUMBER]", help="what the depth plane holds: planar, ray, device, reversed, "
        "normalised or normalised-reversed, and near, far, fov, miss, scale; e.g. reversed,near=0.1 (default: by the "
        "profile)",
    )


def add_report(parser: argparse._ActionsContainer, what: str) -> None:
    """Add --report, the path of a page; `what` it shows besides findings and planes."""
    parser.add_argument(
        "--report", metavar="HTML", help=f"write a page that opens from the disk and needs no network: {what}, "
        "findings and a picture of every plane",
    )
