"""Progress of a benchmark on standard error: a bar in a terminal, a line a method everywhere."""

from __future__ import annotations

from typing import Any

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn


class BenchProgress:
    """Counts finished methods and runs. Use as a context manager."""

    def __init__(self, methods: list[str], runs: int) -> None:
        self._console = Console(stderr=True)
        self._methods, self._runs, self._count = methods, runs, 0
        self._bar = Progress(
            TextColumn("{task.fields[doing]}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(),
            console=self._console, transient=True, disable=not self._console.is_terminal,
        )
        self._task = self._bar.add_task("methods", total=len(methods) * (runs + 1), doing="")

    def __enter__(self) -> BenchProgress:
        self._bar.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._bar.stop()

    def begin(self, method: str) -> None:
        """A method is about to be measured."""
        self._count += 1
        self._bar.update(self._task, doing=f"{method}: warming up", completed=(self._count - 1) * (self._runs + 1))

    def ran(self, runs: int) -> None:
        """So many of its runs are done."""
        method = self._methods[self._count - 1]
        self._bar.update(self._task, doing=f"{method}: {runs} of {self._runs} runs", advance=1)

    def scoring(self) -> None:
        """Its results are being scored."""
        self._bar.update(self._task, doing=f"{self._methods[self._count - 1]}: scoring")

    def done(self, time: dict[str, Any], scores: dict[str, Any]) -> None:
        """It is finished."""
        text = f"{time['wall_ms']:.1f} ms a frame, PSNR {scores['psnr']:.2f} dB"
        self._print(self._methods[self._count - 1], text)

    def failed(self, method: str, reason: str) -> None:
        """It could not be measured."""
        self._print(method, f"failed: {reason}")

    def _print(self, method: str, text: str) -> None:
        self._bar.update(self._task, completed=self._count * (self._runs + 1))
        line = f"{self._count}/{len(self._methods)} {method}: {text}"
        self._console.print(line, highlight=False, soft_wrap=True, markup=False)
