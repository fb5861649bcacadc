"""What frames were spared, and the time that it saved: as measured, on frames that were not spared it."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from statistics import median

WARM_UP = 1
"""Frames of a kind whose time does not count: they prepare what later ones find ready."""


@dataclass
class Kind:
    """Frames that were worked on alike: how many, what share of them was worked on, and milliseconds of the later."""

    frames: int = 0
    share: float = 0.0
    times: list[float] = field(default_factory=list)


class Spared:
    """Counts frames by what was done with them, in the order: `begin`, `took`."""

    def __init__(self) -> None:
        self._kinds = {"whole": Kind(), "tiles": Kind(), "nothing": Kind()}
        self._alone = self._still = self._resized = self._known = self._full = 0
        self._now = "whole"
        self._unfollowed: Counter[str] = Counter()

    def begin(self, share: float, has_history: bool, is_still: bool) -> None:
        """A frame begins, of which a share is worked on by the network."""
        self._now = "whole" if share == 1 else "tiles" if share else "nothing"
        kind = self._kinds[self._now]
        kind.frames += 1
        kind.share += share
        self._alone += share > 0 and not has_history
        self._still += is_still and share == 1

    def unblended(self) -> None:
        """This frame is denoised fully, though it has a plane that could say otherwise."""
        self._full += 1

    def resized(self, known: bool) -> None:
        """The next frame has another size; `known` tells whether what it needs is ready."""
        self._resized += 1
        self._known += known

    def unfollowed(self, why: str) -> None:
        """This frame's reflections move with their surfaces."""
        self._unfollowed[why] += 1

    def took(self, milliseconds: float) -> None:
        """The frame's time on the device."""
        kind = self._kinds[self._now]
        if kind.frames > WARM_UP:
            kind.times = [*kind.times[-63:], milliseconds]

    def lines(self) -> tuple[tuple[str, str], ...]:
        """What was left out, and why and what it saved."""
        found = []
        tiles, nothing = self._kinds["tiles"], self._kinds["nothing"]
        if tiles.frames:
            part = 100 * tiles.share / tiles.frames
            found.append((f"network outside of {part:.0f} % of {_count(tiles.frames)}",
                          f"strength is 0 there; {self._saved(tiles)}"))
        if nothing.frames:
            found.append((f"network for {_count(nothing.frames)}", f"strength is 0 everywhere; {self._saved(nothing)}"))
        if self._full:
            found.append((f"blend with the input for {_count(self._full)}", "strength is 1 everywhere"))
        if self._alone:
            found.append((f"history for {_count(self._alone)}", "first frame, cut, or no motion plane"))
        if self._still:
            found.append((f"reprojection of the last output for {_count(self._still)}", "nothing moves"))
        found += [(f"motion of reflections for {_count(frames)}", why) for why, frames in self._unfollowed.items()]
        if self._resized:
            found.append((f"preparation at {self._known} of {_count(self._resized, 'change')} of size",
                          "frames of these sizes were there before"))
        return tuple(found)

    def _saved(self, kind: Kind) -> str:
        whole = self._kinds["whole"].times
        if not kind.times:
            return "time not measured yet"
        if not whole:
            return f"{median(kind.times):.0f} ms a frame; no whole frame was run to compare with"
        return f"{median(kind.times):.0f} ms a frame instead of {median(whole):.0f} ms"


def _count(number: int, what: str = "frame") -> str:
    return f"{number} {what}{'s' * (number > 1)}"
