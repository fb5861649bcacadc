"""Shows pictures in even steps of time: rendered frames, and frames between them, each at its turn.

A picture that comes early waits; one that comes late is shown at once, left out or moved to a later
turn by one rule. What was shown when is measured. See docs/lab/interpolation.md.
"""

from __future__ import annotations

import math
import threading
import time
from collections import Counter, deque
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple, Protocol

from postfx.errors import PostfxError

__all__ = ["Clock", "Pacing", "Presenter", "Shown", "SystemClock"]

LATE = 0.25
"""Share of the interval by which a picture may be late and still be shown at its turn."""
BUCKET = 0.125
"""Width of a bucket of measured intervals, as a share of the interval."""
SPIN = 0.002
"""Seconds before a turn at which the clock stops sleeping and looks at the time: a system may sleep
so much longer."""
MOST_OVERSLEPT_TURNS = 3
"""Turns that a rendered frame waits for at most, where each wait ends late, before it is shown."""
MOST_WAITING_PICTURES = 4
"""Pictures that may wait for their turn before `submit` waits, too."""


class Clock(Protocol):
    """Tells the time in seconds, and waits for it. `time.monotonic` is none: its wait is
    `time.sleep`'s."""

    def now(self) -> float:
        """Seconds since any moment that stays the same."""

    def wait_until(self, moment: float) -> None:
        """Return at this moment, or at once if it has passed."""


class SystemClock:
    """The machine's clock: sleeps, and for the last two milliseconds only lets other threads
    run."""

    def now(self) -> float:
        """Seconds of `time.perf_counter`."""
        return time.perf_counter()

    def wait_until(self, moment: float) -> None:
        """See `Clock`."""
        while (rest := moment - time.perf_counter()) > 0:
            time.sleep(rest - SPIN if rest > SPIN else 0)


class Shown(NamedTuple):
    """When a picture was due, and when it was shown.

    Attributes:
        turn: number of the interval that it was for, from the first picture on.
        due: when that began, seconds of the clock.
        at: when it was shown; None if it was left out.
        between: whether it was a frame between rendered ones.
    """

    turn: int
    due: float
    at: float | None
    between: bool


@dataclass(frozen=True)
class Pacing:
    """When pictures were shown.

    Attributes:
        interval: seconds from picture to picture, as planned.
        shown: of every picture, in order.
    """

    interval: float
    shown: tuple[Shown, ...]

    @property
    def intervals(self) -> list[float]:
        """Measured seconds from each picture that was shown to the next."""
        times = [one.at for one in self.shown if one.at is not None]
        return [after - before for before, after in zip(times, times[1:], strict=False)]

    @property
    def histogram(self) -> dict[float, int]:
        """Intervals by buckets of an eighth of the planned one, around its multiples: middle in
        seconds -> how many. A sequence in time has one or two."""
        width = BUCKET * self.interval
        counted = Counter(round(measured / width) for measured in self.intervals)
        return {bucket * width: counted[bucket] for bucket in sorted(counted)}

    @property
    def dropped(self) -> int:
        """Pictures that were left out."""
        return sum(one.at is None for one in self.shown)

    @property
    def late(self) -> int:
        """Pictures that were shown later than a share of `LATE` of the interval after their turn
        began."""
        return sum(one.at is not None and one.at - one.due > LATE * self.interval
                   for one in self.shown)

    @property
    def missed(self) -> int:
        """Turns at which no new picture was shown."""
        turns = {one.turn for one in self.shown if one.at is not None}
        return max(turns) + 1 - len(turns) if turns else 0

    def __str__(self) -> str:
        measured = self.intervals
        if not measured:
            return f"{len(self.shown)} pictures, none after another"
        most = max(abs(one - self.interval) for one in measured)
        return (f"{len(measured) + 1} pictures every {1e3 * self.interval:.2f} ms, at most "
                f"{1e3 * most:.2f} ms off; {self.dropped} left out, {self.missed} turns without a "
                f"new one, {len(self.histogram)} buckets")

    def draw(self, path: str | Path) -> None:
        """Write a PNG of all intervals in order, and of their histogram. Raises WriteError."""
        from postfx.pacing_plot import draw_pacing

        draw_pacing(str(self), self.interval, self.intervals, self.histogram, BUCKET, Path(path))


class Presenter:
    """Shows pictures one interval apart.

    The first picture begins the first turn. Every later one is for the next turn and waits for it.
    If it is late by more than a quarter of the interval, or the wait for it ended so late:

    - a frame between is left out: the rendered frame after it is newer, and is due next;
    - a rendered frame is shown at the beginning of the next turn, so that steps stay whole
      intervals, and the pictures after it follow from there.

    Args:
        show: shows a picture, such as by swapping buffers. It may return when the picture was seen,
            in seconds of the clock, if the system tells; else the time of the call counts.
        interval: seconds from picture to picture: half of a rendered frame's, with one frame
            between.
        clock: tells the time; default the machine's.

    `present` shows a picture at its turn and returns then. `submit` hands it to a thread that does,
    and so the next frame can be made meanwhile; leave `with presenter:` or call `close` to wait for
    the last one. Use one of the two.
    """

    def __init__(self, show: Callable[[Any], float | None], interval: float,
                 clock: Clock | None = None) -> None:
        if not 0 < interval < math.inf:
            raise PostfxError(f"an interval of {interval} s: give the seconds from picture to "
                              "picture, above 0")
        self.interval = float(interval)
        self._show, self._clock = show, clock or SystemClock()
        self._begin, self._next = 0.0, 0
        self._shown: list[Shown] = []
        self._queue: deque[tuple[Any, bool]] = deque()
        self._changed = threading.Condition()
        self._thread: threading.Thread | None = None
        self._closed = False
        self._failed: BaseException | None = None

    def present(self, picture: Any, between: bool = False) -> Shown:
        """Show a picture at its turn, and return then; at once if it is left out.

        Args:
            between: whether it is a frame between rendered ones, which may be left out.
        """
        if not self._shown:
            self._begin = self._clock.now()
        turn = self._next
        at = self._wait_for(turn)
        for _ in range(MOST_OVERSLEPT_TURNS):
            if not self._is_late(at, turn):
                break
            if between:
                return self._note(Shown(turn, self._due(turn), None, between))
            turn = math.ceil((at - self._begin) / self.interval - 1e-9)
            at = self._wait_for(turn)
        seen = self._show(picture)
        return self._note(Shown(turn, self._due(turn), at if seen is None else float(seen),
                                between))

    def _wait_for(self, turn: int) -> float:
        """The time when the wait for a turn ended."""
        self._clock.wait_until(self._due(turn))
        return self._clock.now()

    def _is_late(self, at: float, turn: int) -> bool:
        return at - self._due(turn) > LATE * self.interval

    def _due(self, turn: int) -> float:
        return self._begin + turn * self.interval

    def _note(self, shown: Shown) -> Shown:
        self._next = shown.turn + 1
        self._shown.append(shown)
        return shown

    def submit(self, picture: Any, between: bool = False) -> None:
        """Hand a picture over to be shown at its turn. Waits while several wait already.

        Raises what `show` raised for an earlier picture, PostfxError after `close`.
        """
        with self._changed:
            if self._closed:
                raise PostfxError("the presenter is closed: make a new one")
            if self._thread is None:
                self._thread = threading.Thread(target=self._run, name="postfx presenter",
                                                daemon=True)
                self._thread.start()
            self._changed.wait_for(lambda: len(self._queue) < MOST_WAITING_PICTURES or self._failed)
            self._raise()
            self._queue.append((picture, between))
            self._changed.notify_all()

    def close(self) -> None:
        """Wait until all pictures were shown. Raises what `show` raised."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()
        if self._thread is not None:
            self._thread.join()
        self._raise()

    def __enter__(self) -> Presenter:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def pacing(self) -> Pacing:
        """The pictures that were shown so far, and when."""
        return Pacing(self.interval, tuple(self._shown))

    def _run(self) -> None:
        """Present queued pictures, until the presenter is closed."""
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._queue or self._closed)
                if not self._queue:
                    return
                picture, between = self._queue.popleft()
                self._changed.notify_all()
            try:
                self.present(picture, between)
            except BaseException as error:
                with self._changed:
                    self._failed = error
                    self._queue.clear()
                    self._changed.notify_all()
                return

    def _raise(self) -> None:
        if self._failed is not None:
            raise self._failed
