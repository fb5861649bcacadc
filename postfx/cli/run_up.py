"""`--run-up`: the first frames of a shot get a history, too."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from typing import TYPE_CHECKING

from postfx.cli.arguments import count

if TYPE_CHECKING:
    from postfx.frame import Frame
    from postfx.io.sequence import Sequence
    from postfx.temporal import RunUp

NOT_WITH = {"no_denoise": "has no denoiser to run up", "both_ways": "knows the frames after the first ones anyway",
            "budget": "keeps to a time"}
"""Argument -> why there is no run-up beside it."""


def add_argument(group: argparse._ActionsContainer) -> None:
    """Add the argument."""
    group.add_argument(
        "--run-up", type=count, metavar="N", help="frames after the first one of each shot that are run before it, in "
        "reverse order, so that it has a history and is as clean as the others; 0 for none (default: 8; none with "
        "--both-ways or --budget)",
    )


class WatchedRunUp:
    """A run-up that says what it does, as it may take long, and ends when the run is to stop."""

    def __init__(self, run_up: RunUp) -> None:
        self.after = run_up.after
        self._run_up = run_up
        self._check: Callable[[], None] = lambda: None
        self._tell: Callable[[str], None] = lambda line: None

    def watch(self, check: Callable[[], None], tell: Callable[[str], None]) -> None:
        """From now on call `check`, which may raise, before each frame, and `tell` with a line before the first."""
        self._check, self._tell = check, tell

    def __call__(self, frame: Frame, run: Callable[[Frame], None]) -> Frame:
        told = False

        def run_watched(other: Frame) -> None:
            nonlocal told
            self._check()
            if not told:
                self._tell(f"before frame {frame.number}: a run-up from frame {other.number}")
            told = True
            run(other)

        return self._run_up(frame, run_watched)


def run_up_of(arguments: argparse.Namespace, sequence: Sequence, cuts: str) -> WatchedRunUp | None:
    """What the arguments ask for. Raises PassOptionError beside arguments that it cannot go with."""
    from postfx.errors import PassOptionError
    from postfx.temporal.run_up import FRAMES, RunUp  # loads what --help must not wait for

    given = next((name for name in NOT_WITH if getattr(arguments, name)), None)
    if given and arguments.run_up:
        option = f"--{given.replace('_', '-')}"
        raise PassOptionError(f"--run-up runs frames more than once, {option} {NOT_WITH[given]}: give one of them")
    frames = FRAMES if arguments.run_up is None else arguments.run_up
    return WatchedRunUp(RunUp(sequence, frames, cuts)) if frames and not given else None
