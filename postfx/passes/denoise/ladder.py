"""Which of several networks fits a time budget, by the times of the frames so far.

Networks of one family are the rungs of a ladder, fastest first. After two frames over the budget a
faster rung is taken. A slower one is taken once enough frames in a row allow it, and more must
allow it each time that it turns out too slow.
"""

from __future__ import annotations

from collections.abc import Sequence

from postfx.passes.denoise.models import CLASSIC, FILE, find_model

FAMILY = {CLASSIC: 0.5, "s": 1.0, "m": 3.5, "l": 5.0, "xl": 14.0}
"""The classical filter and networks by size, fastest first, and about how many times as long as 's'
each takes in float32. `xl` beside `s` in integers: 1962 ms on a CPU, 136."""

FAST = {CLASSIC: 0.5, "s": 1.0, "m": 2.1, "l": 2.8, "xl": 19.0}
"""As `FAMILY`, in integers or half precision. `xl` takes 7.69 ms on a GPU, `s` 0.41."""

TWO_STAGES_COST = 23.0
"""As `FAMILY`, for both networks of `xl` where frames are enlarged: 2575 ms on a CPU, `s` 112."""

ROOM = 0.85
"""Share of the budget that a slower network may be expected to take; the rest keeps it from going
back at once."""

WEIGHT = 0.3
"""Weight of the last frame in the running mean of a network's time."""

PATIENCE = 2
"""Frames in a row that must allow a slower network before it is taken, at first."""
MOST_PATIENCE = 256
"""The same, at most: after it was too slow again and again."""

STEADY = 64
"""Frames on a slower rung after which its being too slow before is forgotten."""

TOO_LONG = 2
"""Frames in a row over the budget before a faster network is taken: one may be another program's
fault."""


def family(tag: str) -> tuple[str, ...]:
    """Tags up to this one, fastest first, of its precision: 'm.int8' -> 'classic', 's.int8',
    'm.int8'. Other tags stand alone, and so do those of other libraries."""
    folder, slash, word = tag.rpartition("/")
    size, dot, precision = word.partition(".")
    if size not in FAMILY or tag.endswith(FILE) or tag == CLASSIC:
        return (tag,)
    sizes = list(FAMILY)[: list(FAMILY).index(size) + 1]
    return tuple(one if one == CLASSIC else f"{folder}{slash}{one}{dot}{precision}"
                 for one in sizes)


def cost(model: str) -> float:
    """About how long a model 'denoise_upscale.m.int8' takes against the others of its family."""
    if model == CLASSIC:
        return FAST[CLASSIC]
    _, size, *rest = f"{find_model(model)[1]}..".split(".")
    known = FAST if {"int8", "fp16"} & set(rest) else FAMILY
    return known.get(size, 1.0)


class Ladder:
    """Chooses a rung by the times of the frames so far.

    Args:
        costs: about how long each rung takes, in any unit, fastest first; only their ratios count.
        budget: milliseconds that a frame may take.
        first: the rung to start at.
        most_patience: frames in a row at most that must allow a slower rung which was too slow
            before.

    Attributes:
        rung: what to run next.
    """

    def __init__(self, costs: Sequence[float], budget: float, first: int = 0,
                 most_patience: int = MOST_PATIENCE) -> None:
        self.rung, self._most_patience = first, most_patience
        self._costs, self._budget = tuple(costs), budget
        self._patience = PATIENCE
        self._time = 0.0
        self._frames = self._over = self._fits = 0
        self._go(first)

    def note_time(self, milliseconds: float) -> None:
        """Tell how long the last frame took; a rung's first frame is not counted, since it prepares
        what later ones find ready."""
        self._frames += 1
        if self._frames > 1:
            before = self._time or milliseconds
            self._time = before + WEIGHT * (milliseconds - before)
            self._over = self._over + 1 if milliseconds > self._budget else 0
            self._fits = (self._fits + 1
                          if self._best(ROOM * self._budget) > self.rung and not self._over else 0)
            self._decide(milliseconds)

    def note_resize(self, ratio: float) -> None:
        """Tell by what factor the next frame has more pixels than the last one."""
        self._time *= ratio

    def _decide(self, milliseconds: float) -> None:
        if self._over >= TOO_LONG and self.rung:
            self._time = milliseconds
            self._patience = min(2 * self._patience, self._most_patience)
            self._go(min(self.rung - 1, self._best(self._budget)))
        elif self._fits >= self._patience:
            self._go(self._best(ROOM * self._budget))
        elif self._climbed and self._frames == STEADY:
            self._patience = PATIENCE

    def _best(self, limit: float) -> int:
        """The slowest rung that is expected to stay within a limit."""
        unit = self._time / self._costs[self.rung]
        return max((rung for rung, cost in enumerate(self._costs) if unit * cost <= limit),
                   default=0)

    def _go(self, rung: int) -> None:
        self._climbed = rung > self.rung
        self.rung, self._time, self._frames, self._over, self._fits = rung, 0.0, 0, 0, 0
