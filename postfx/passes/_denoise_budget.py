"""Which of several networks to run, so that a frame takes no longer than it may."""

from __future__ import annotations

from collections.abc import Sequence

FAMILY = {"s": 1.0, "m": 3.5, "l": 5.0}
"""Networks by size, fastest first, and about how many times as long as the first each takes in float32."""

FAST = {"s": 1.0, "m": 2.1, "l": 2.8}
"""The same in integers or half precision."""

ROOM = 0.85
"""Share of the budget that a slower network may be expected to take; the rest keeps it from going back at once."""

WEIGHT = 0.3
"""Of the last frame in the running mean of a network's time."""

PATIENCE, MOST_PATIENCE = 2, 256
"""Frames in a row that must allow a slower network: at first, and at most after it was too slow again and again."""

STEADY = 64
"""Frames on a slower rung after which its being too slow before is forgotten."""

TOO_LONG = 2
"""Frames in a row over the budget before a faster network is taken: one may be another program's fault."""


def family(model: str) -> tuple[str, ...]:
    """Tags up to `model`, fastest first, of its precision: 'm.int8' -> 's.int8', 'm.int8'. Other tags stand alone."""
    size, dot, precision = model.partition(".")
    if size not in FAMILY:
        return (model,)
    sizes = list(FAMILY)[: list(FAMILY).index(size) + 1]
    return tuple(f"{smaller}{dot}{precision}" for smaller in sizes)


def cost(model: str) -> float:
    """About how long a model 'denoise_upscale.m.int8' takes against the others of its family."""
    _, size, *rest = model.split(".")
    known = FAST if {"int8", "fp16"} & set(rest) else FAMILY
    return known.get(size, 1.0)


class Ladder:
    """Chooses a rung by the times of the frames so far.

    Args:
        costs: about how long each rung takes, in any unit, fastest first; only their ratios count.
        budget: milliseconds that a frame may take.

    Attributes:
        rung: what to run next. It starts at the fastest.
    """

    def __init__(self, costs: Sequence[float], budget: float) -> None:
        self.rung = 0
        self._costs, self._budget = tuple(costs), budget
        self._patience = PATIENCE
        self._go(0)

    def took(self, milliseconds: float) -> None:
        """Tell how long the last frame took; a rung's first frame is not counted, since it prepares what later ones
        find ready."""
        if self._frames:
            before = self._time or milliseconds
            self._time = before + WEIGHT * (milliseconds - before)
            self._over = self._over + 1 if milliseconds > self._budget else 0
            self._fits = self._fits + 1 if self._best(ROOM * self._budget) > self.rung and not self._over else 0
            self._decide(milliseconds)
        self._frames += 1

    def resized(self, ratio: float) -> None:
        """Tell that the next frame has so many times the pixels of the last one."""
        self._time *= ratio

    def _decide(self, milliseconds: float) -> None:
        if self._over >= TOO_LONG and self.rung:
            self._time = milliseconds
            self._patience = min(2 * self._patience, MOST_PATIENCE)
            self._go(min(self.rung - 1, self._best(self._budget)))
        elif self._fits >= self._patience:
            self._go(self._best(ROOM * self._budget))
        elif self._climbed and self._frames == STEADY:
            self._patience = PATIENCE

    def _best(self, limit: float) -> int:
        """The slowest rung that is expected to stay within a limit."""
        unit = self._time / self._costs[self.rung]
        return max((rung for rung, cost in enumerate(self._costs) if unit * cost <= limit), default=0)

    def _go(self, rung: int) -> None:
        self._climbed = rung > self.rung
        self.rung, self._time, self._frames, self._over, self._fits = rung, 0.0, 0, 0, 0
