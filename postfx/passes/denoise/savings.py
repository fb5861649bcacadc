"""What was left out of frames, why, and how much time that saved: lines for the summary."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import Enum
from statistics import median

Reason = tuple[str, str]
"""What is left out, as it stands before '3 frames', and why."""


class Amount(Enum):
    """How much of a frame the network processes, or why none of it."""

    WHOLE = "whole"
    TILES = "tiles"
    LIT = "lit"
    NOTHING = "nothing"
    EMPTY = "empty"
    SAME = "same"


WHY_LESS = {
    Amount.TILES: "strength is 0 there",
    Amount.LIT: "all is black there",
    Amount.NOTHING: "strength is 0 everywhere",
    Amount.EMPTY: "all is black",
    Amount.SAME: "all is as in the frame before"}
"""Why the network left out some of a frame, or all of it."""
PARTIAL_AMOUNTS = (Amount.TILES, Amount.LIT)
"""Amounts that are some of a frame."""

FULL_STRENGTH: Reason = ("blend with the input for", "strength is 1 everywhere")
NO_HISTORY: Reason = ("history for", "first frame, cut, or no motion vectors")
REPEATED_NOISE: Reason = ("history for", "noise is that of the frame before")
NOTHING_MOVES: Reason = ("reprojection of the last output for", "nothing moves")
JITTERED: Reason = ("the first of two stages for", "samples are jittered, where one is better")
HAZY_DEPTH: Reason = ("depth and albedo of", "depth is noise, as in fog")
UNFOLLOWED_REFLECTIONS = "motion of reflections for"
"""What is left out where reflections move with their surfaces, for several reasons."""
REASONS = (FULL_STRENGTH, NO_HISTORY, REPEATED_NOISE, NOTHING_MOVES, JITTERED, HAZY_DEPTH)
"""In the order in which they are told; others come last."""

WARM_UP = 1
"""First frames of an amount, whose time does not count: they prepare things for later ones."""
KEPT_TIMES = 64
"""Times of last frames of an amount that its median is of."""


@dataclass
class Tally:
    """Frames of one amount: how many, the share of pixels that the network processed, and
    milliseconds of later ones."""

    frames: int = 0
    share: float = 0.0
    times: list[float] = field(default_factory=list)


class Savings:
    """For each frame, call `note_frame`, then `note_time`."""

    def __init__(self) -> None:
        self._tallies = {amount: Tally() for amount in Amount}
        self._reasons: Counter[Reason] = Counter()
        self._resized = self._known = 0
        self._now = Amount.WHOLE

    def note_frame(self, amount: Amount, share: float, reasons: Sequence[Reason] = ()) -> None:
        """Count a frame: the share of its pixels that the network processes, and what else is left
        out of it."""
        self._now = amount
        self._tallies[amount].frames += 1
        self._tallies[amount].share += share
        self._reasons.update(reasons)

    def note_resize(self, known: bool) -> None:
        """The next frame has another size; `known`: whether it is already prepared."""
        self._resized += 1
        self._known += known

    def note_time(self, milliseconds: float) -> None:
        """The frame's time on the device."""
        tally = self._tallies[self._now]
        if tally.frames > WARM_UP:
            tally.times = [*tally.times[1 - KEPT_TIMES:], milliseconds]

    def lines(self) -> tuple[tuple[str, str], ...]:
        """Work left out, each with the reason and the time saved."""
        found = []
        for amount, why in WHY_LESS.items():
            tally = self._tallies[amount]
            if tally.frames:
                some = f"outside of {100 * tally.share / tally.frames:.0f} % of"
                found.append((f"network {some if amount in PARTIAL_AMOUNTS else 'for'} "
                              f"{_count(tally.frames)}", f"{why}; {self._saved(tally)}"))
        others = [reason for reason in self._reasons if reason not in REASONS]
        found += [(f"{what} {_count(self._reasons[what, why])}", why)
                  for what, why in (*REASONS, *others) if self._reasons[what, why]]
        if self._resized:
            found.append((f"preparation at {self._known} of {_count(self._resized, 'change')} of "
                          "size", "frames of these sizes were there before"))
        return tuple(found)

    def _saved(self, tally: Tally) -> str:
        whole = self._tallies[Amount.WHOLE].times
        if not tally.times:
            return "time not measured yet"
        if not whole:
            return f"{median(tally.times):.0f} ms a frame"
        return f"{median(tally.times):.0f} ms a frame instead of {median(whole):.0f} ms"


def _count(number: int, what: str = "frame") -> str:
    return f"{number} {what}{'s' * (number > 1)}"
