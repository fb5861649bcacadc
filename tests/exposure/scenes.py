"""Small scenes of known brightness."""

from __future__ import annotations

from collections.abc import Container, Iterable, Iterator
from typing import Any

import numpy as np

from postfx.frame import Frame, Role

WIDTH, HEIGHT = 96, 54


def picture(ev: float = 0.0, height: int = HEIGHT, width: int = WIDTH) -> np.ndarray:
    """A smooth scene that `ev` stops bring to mid grey, four stops from dark to bright."""
    ramp = np.exp2(np.linspace(-2, 2, width) - ev) * 0.18
    return np.ascontiguousarray(np.broadcast_to(ramp[None, :, None], (height, width, 3)),
                                np.float32)


def scene(
    needed: Iterable[float], given: Iterable[float] | None = None, cuts: Container[int] = (),
    **values: Any
) -> Iterator[Frame]:
    """Frames 1, 2, ... whose pictures need these stops; `given`: stops that their headers give."""
    needed = list(needed)
    headers: list[float | None]
    headers = [None] * len(needed) if given is None else list(given)
    for index, (ev, header) in enumerate(zip(needed, headers, strict=True)):
        yield Frame(
            {Role.COLOUR: picture(ev)}, number=index + 1, exposure=header,
            reset=index == 0 or index in cuts, **values
        )
