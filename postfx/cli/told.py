"""What the library tells on the way, for the user of a command."""

from __future__ import annotations

import logging
from collections.abc import Callable
from types import TracebackType
from typing import Self

from postfx.frame import TOLD


class Told(logging.Handler):
    """While it is entered, passes on what `TOLD` gets, each kind once: with the first file or frame
    that it is about."""

    def __init__(self, tell: Callable[[str], None]) -> None:
        super().__init__(logging.WARNING)
        self._tell, self._kinds = tell, set[tuple[object, ...]]()

    def emit(self, record: logging.LogRecord) -> None:
        """Pass a record on. Its first argument is what it is about."""
        kind = ((record.msg, *(record.args or ())[1:]) if isinstance(record.args, tuple)
                else (record.msg,))
        if kind not in self._kinds:
            self._kinds.add(kind)
            self._tell(record.getMessage())

    def __enter__(self) -> Self:
        TOLD.addHandler(self)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None,
        trace: TracebackType | None
    ) -> None:
        TOLD.removeHandler(self)
