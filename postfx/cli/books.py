"""What `postfx run` says about logs, checkpoints and resuming."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

from postfx.cli.arguments import from_zero

if TYPE_CHECKING:
    from postfx.runs.run import Options

EXACT = "exact"
SECONDS = 30.0


def add_arguments(group: argparse._ArgumentGroup) -> None:
    """Add the arguments."""
    group.add_argument(
        "--log", metavar="FILE", help="append one JSON object a line for each frame and event (docs/reliability.md)"
    )
    group.add_argument(
        "--checkpoint", metavar="SECONDS", type=_seconds, default=SECONDS,
        help="keep what the passes remember in OUTPUT's folder after so many seconds of work, and when the run is "
        "stopped, so that --skip-existing goes on from there; 0 after every frame, none for never (default: 30)",
    )
    group.add_argument(
        "--resume", metavar="exact|N", type=_rerun, default=EXACT,
        help="with --skip-existing: run as many finished frames again, without writing them, as it takes for the "
        "pixels of an unbroken run, or at most N (default: exact)",
    )


def options_of(arguments: argparse.Namespace) -> Options:
    """What the arguments say."""
    from postfx.runs.run import Options  # loads the runtime, which --help must not wait for

    rerun = None if arguments.resume == EXACT else arguments.resume
    return Options(arguments.log, arguments.checkpoint, rerun, arguments.preroll or 0)


def _seconds(text: str) -> float | None:
    return None if text == "none" else from_zero(text)


def _rerun(text: str) -> str | int:
    if text != EXACT and not text.isdigit():
        raise argparse.ArgumentTypeError(f"'{text}' is no number of frames: give one, or exact")
    return text if text == EXACT else int(text)
