"""Progress on standard error: a bar in a terminal, one line a frame elsewhere."""

from __future__ import annotations

import time

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn


class FrameProgress:
    """Counts finished frames. Use as a context manager.

    In a terminal: a bar with frames per second and time left. In a log: one line for each finished frame.
    """

    def __init__(self, total: int) -> None:
        self._console = Console(stderr=True, markup=False, emoji=False)
        self._total, self._done, self._fresh = total, 0, 0
        self._begin = time.perf_counter()
        self._bar = Progress(
            TextColumn("frames"),
            BarColumn(),
            MofNCompleteColumn(),
            TextColumn("{task.fields[rate]}"),
            TimeRemainingColumn(compact=True),
            TextColumn("left"),
            console=self._console,
            transient=True,
            disable=not self._console.is_terminal,
        )
        self._task = self._bar.add_task("frames", total=total, rate="")

    def __enter__(self) -> FrameProgress:
        self._bar.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._bar.stop()

    def note(self, text: str) -> None:
        """Print a line above the bar."""
        self._console.print(text, highlight=False, soft_wrap=True)

    def skip(self) -> None:
        """Count a frame that needs no work."""
        self._done += 1
        self._bar.advance(self._task)

    def advance(self, path: str) -> None:
        """Count a frame that was written to `path`."""
        self._done, self._fresh = self._done + 1, self._fresh + 1
        rate = f"{self._fresh / (time.perf_counter() - self._begin):.2f} frames/s"
        self._bar.update(self._task, advance=1, rate=rate)
        if not self._console.is_terminal:
            self._console.print(f"{self._done}/{self._total} {path} ({rate})", highlight=False, soft_wrap=True)
