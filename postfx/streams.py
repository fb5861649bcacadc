"""Standard output and error of a command: they never stop its work, and nothing in a name controls
the terminal."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Any, TextIO

_STREAMS = (0, 1, 2)
_KEPT = "\n\t"


def make_printable(text: str, kept: str = "") -> str:
    """Replace characters that would break a line or control a terminal by question marks, but for
    those that are to be kept."""
    if text.isprintable():
        return text
    return "".join(letter if letter.isprintable() or letter in kept else "?" for letter in text)


class SafeStream:
    """A text stream that loses what cannot be written: its file is closed or full, or its reader
    has gone away.

    Characters that would control a terminal become question marks, as they may come from names of
    files, layers and headers. What is styled on purpose goes into `styled`, which takes all.
    """

    def __init__(self, stream: TextIO, filters: bool = True) -> None:
        self._stream, self._filters = stream, filters
        self.styled = SafeStream(stream, filters=False) if filters else self

    def write(self, text: str) -> int:
        """Write as much as can be written."""
        shown = make_printable(text, _KEPT) if self._filters else text
        try:
            self._stream.write(shown)
        except UnicodeEncodeError:
            encoding = self._stream.encoding or "ascii"
            self.write(shown.encode(encoding, "replace").decode(encoding))
        except (OSError, ValueError):
            self._give_up()
        return len(text)

    def writelines(self, lines: list[str]) -> None:
        """Write several texts."""
        for line in lines:
            self.write(line)

    def flush(self) -> None:
        """Write what waits."""
        try:
            self._stream.flush()
        except (OSError, ValueError):
            self._give_up()

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

    def _give_up(self) -> None:
        """Let what waits, and what comes, go nowhere: the interpreter flushes the stream once more
        as it ends."""
        if self._stream in (sys.__stdout__, sys.__stderr__):
            with suppress(OSError, ValueError):
                nowhere = os.open(os.devnull, os.O_WRONLY)
                os.dup2(nowhere, self._stream.fileno())
                os.close(nowhere)
                self._stream.flush()


def styled(stream: TextIO) -> TextIO:
    """A stream for text that is styled for a terminal, whose author has made the rest of it
    printable."""
    return stream.styled if isinstance(stream, SafeStream) else stream  # type: ignore[return-value]


@contextmanager
def safe_streams() -> Iterator[None]:
    """Make this process's standard streams safe while a command runs. Those that are closed lead
    nowhere, so that no file that is opened takes their place and gets what is written to them."""
    for number in _STREAMS:
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # which takes the lowest free number
    before = sys.stdout, sys.stderr
    opened = [stream or open(os.devnull, "w", encoding="utf-8") for stream in before]
    sys.stdout, sys.stderr = map(SafeStream, opened)
    try:
        yield
    finally:
        for stream in (sys.stdout, sys.stderr):
            if isinstance(stream, SafeStream):
                stream.flush()
        sys.stdout, sys.stderr = before
