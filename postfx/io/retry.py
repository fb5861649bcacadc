"""Trying again what may succeed a moment later, such as reads from a busy file server."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import TypeVar

from postfx.errors import ReadError

Result = TypeVar("Result")

PAUSES = (0.1, 0.4)
"""Seconds before the second and the third try."""


def read_patiently(read: Callable[[], Result], failed: Callable[[ReadError], None] = lambda error: None) -> Result:
    """What `read` gives. A ReadError is told to `failed` and `read` called again, twice at most; then it is raised."""
    for pause in PAUSES:
        try:
            return read()
        except ReadError as error:
            failed(error)
            time.sleep(pause)
    return read()
