"""The CUDA driver's functions, and their errors."""

from __future__ import annotations

from functools import cache
from typing import Any

from postfx.errors import DeviceError


@cache
def driver() -> Any:
    """Module of the driver's functions, each of which returns its status first."""
    from cuda.bindings import driver as module

    return module


def checked(result: tuple) -> Any:
    """What a function of the driver returned beside its status. Raises DeviceError where that tells of a failure."""
    if int(result[0]):
        raise DeviceError(f"CUDA: {result[0].name}")
    return result[1] if len(result) == 2 else None
