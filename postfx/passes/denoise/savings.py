"""Counts frames by the work that they needed: what was left out, why, and what that saved."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from statistics import median

Reason = tuple[str, str]
"""What is left out, before 'for 3 frames' or with its own preposition, and why."""

WHOLE, TILES, LIT, NOTHING, EMPTY, SAME = "whole", "tiles", "lit", "nothing", "empty", "same"
"""Kinds of frames."""
KINDS = {
    TILES: "strength is 0 there",
    LIT: "all is black there",
    NOTHING: "strength is 0 everywhere",
    EMPTY: "all is black",
    SAME: "all is as in the frame before"}
"""Why the network left out some of a frame, or all of it, by the frame's kind."""
SOME = (TILES, LIT)
"""Kinds of which the network processes some."""

FULL: Reason = ("blend with the input for", "strength is 1 everywhere")
ALONE: Reason = ("history for", "first frame, cut, or no motion vectors")
REPEATED: Reason = ("history for", "noise is that of the frame before")
STILL: Reason = ("reprojection of the last output for", "nothing moves")
HAZY: Reason = ("depth and albedo of", "depth is noise, as in fog")
UNFOLLOWED = "motion of reflections for"
"""What is left out where reflections move with their surfaces, for several reasons."""
REASONS = (FULL, ALONE, REPEATED, STILL, HAZY)
"""In the order in which they are told; others come last."""

WARM_UP = 1
"""First frames of a kind, whose time does not count: they prepare things for later ones."""
KEPT_TIMES = 64
"""Times of last frames of a kind that its median is of."""


@dataclass
class Kind:
    """Frames of one kind: how many, the share of pixels that the network processed, and
    milliseconds of later ones."""

    frames: int = 0
    share: float = 0.0
    times: list[float] = field(default_factory=list)


class Savings:
    """For each frame, call `note_frame`, then `note_time`."""

    def __init__(self) -> None:
        self._kinds = {name: Kind() for name in (WHOLE, *KINDS)}
        self._reasons: Counter[Reason] = Counter()
        self._resized = self._known = 0
        self._now = WHOLE

    def note_frame(self, kind: str, share: float, reasons: Sequence[Reason] = ()) -> None:
        """A frame of a kind, of which the network processes this share, and what else is left out
        of it."""
        self._now = kind
        self._kinds[kind].frames += 1
        self._kinds[kind].share += share
        self._reasons.update(reasons)

    def note_resize(self, known: bool) -> None:
        """The next frame has another size; `known`: whether it is already prepared."""
        self._resized += 1
        self._known += known

    def note_time(self, milliseconds: float) -> None:
        """The frame's time on the device."""
        kind = self._kinds[self._now]
        if kind.frames > WARM_UP:
            kind.times = [*kind.times[1 - KEPT_TIMES:], milliseconds]

    def lines(self) -> tuple[tuple[str, str], ...]:
        """Work left out, each with the reason and the time saved."""
        found = []
        for name, why in KINDS.items():
            kind = self._kinds[name]
            if kind.frames:
                some = f"outside of {100 * kind.share / kind.frames:.0f} % of"
                found.append((f"network {some if name in SOME else 'for'} {_count(kind.frames)}",
                              f"{why}; {self._saved(kind)}"))
        others = [reason for reason in self._reasons if reason not in REASONS]
        found += [(f"{what} {_count(self._reasons[what, why])}", why)
                  for what, why in (*REASONS, *others) if self._reasons[what, why]]
        if self._resized:
            found.append((f"preparation at {self._known} of {_count(self._resized, 'change')} of "
                          "size", "frames of these sizes were there before"))
        return tuple(found)

    def _saved(self, kind: Kind) -> str:
        whole = self._kinds[WHOLE].times
        if not kind.times:
            return "time not measured yet"
        if not whole:
            return f"{median(kind.times):.0f} ms a frame; no whole frame was run to compare with"
        return f"{median(kind.times):.0f} ms a frame instead of {median(whole):.0f} ms"


def _count(number: int, what: str = "frame") -> str:
    return f"{number} {what}{'s' * (number > 1)}"
