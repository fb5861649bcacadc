"""Calls of kernels as frames make them: what each was given, by a pipeline, between frames, and by
small networks.

The calls are taken where Python enters the library, as no public name tells them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np
import pytest

import postfx
from postfx.compiled.calls import BoundRows
from postfx.compiled.library import Rows
from postfx.frame import Frame, Role
from postfx.interpolate import Between
from postfx.neural import Grid, Learner, Network
from postfx.runtime import Device
from postfx.runtime.threads import Helpers
from tests.kernels.foreign import Call

SIZE = (48, 64)
MOST_BYTES = 1 << 22
"""Of a call's arrays."""


def of_frames() -> list[Call]:
    """The first call of each kernel, by two noisy frames that are denoised, enlarged and shown, and
    by a frame between them."""
    random = np.random.default_rng(0)
    first, second = (_frame(random, number) for number in (1, 2))
    with _recording() as calls:
        for passes in ([postfx.DenoiseUpscale(model="s", scale=2), postfx.ToneMap("local")],
                       [postfx.DenoiseUpscale(model="classic"), postfx.ToneMap("aces2")]):
            pipeline = postfx.Pipeline(passes)
            for frame in (first, second):
                pipeline(frame)
        Between(first, second).frame(0.5)
        _learn(random)
    return calls


def _learn(random: np.random.Generator) -> None:
    """A small network behind a grid learns for one step."""
    device = Device("cpu", 1)
    grid = Grid(2)
    learner = Learner(device, Network(inputs=grid.width, hidden=(32, 32), outputs=1), grid=grid)
    places = random.uniform(0, 1, (256, 2)).astype(np.float32)
    learner.fit(places, places[:, :1], steps=1, rate=1e-2)
    points, values = device.wrap("points", places), device.heap.tensor("values", (256, 1))
    commands = device.command_buffer("network")
    with commands.compute_encoder("network") as encoder:
        learner.run(encoder, points, values)
    commands.commit()
    commands.wait()


def _frame(random: np.random.Generator, number: int) -> Frame:
    """A wall that moves to the right, with stripes and noise."""
    y, x = np.mgrid[:SIZE[0], :SIZE[1]]
    stripes = (0.5 + 0.4 * np.sin((x - 3 * number) / 4 + y / 9))[..., None]
    noise = random.gamma(2, 0.5, (*SIZE, 3))
    planes = {Role.COLOUR: (stripes * noise).astype(np.float32),
              Role.DIFFUSE_ALBEDO: np.repeat(stripes.astype(np.float32), 3, axis=2),
              Role.DEPTH: (4 + x / 50)[..., None].astype(np.float32),
              Role.NORMAL: np.full((*SIZE, 3), (0, 0, 1), np.float32),
              Role.MOTION: np.full((*SIZE, 2), (-3, 0), np.float32)}
    return Frame(planes, number=number)


@contextmanager
def _recording() -> Iterator[list[Call]]:
    calls: dict[str, Call] = {}

    def keep(name: str, first: int, last: int, arrays: Sequence[np.ndarray]) -> None:
        if name not in calls and sum(array.nbytes for array in arrays) <= MOST_BYTES:
            calls[name] = Call(name, (first, last), [array.copy() for array in arrays])

    enter_rows: Callable[..., None] = Rows.__call__
    enter_bound: Callable[..., None] = BoundRows.__call__
    run: Callable[..., None] = Helpers.run

    def rows(self: Any, first: int, last: int, *arrays: np.ndarray) -> None:
        keep(self.name, first, last, arrays)
        enter_rows(self, first, last, *arrays)

    def bound(self: Any, first: int, last: int) -> None:
        keep(self._name, first, last, self._arrays)
        enter_bound(self, first, last)

    def of_threads(self: Any, rows: Any, blocks: np.ndarray) -> None:
        keep(rows._name, blocks[0, 0].item(), blocks[-1, 1].item(), rows._arrays)
        run(self, rows, blocks)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Rows, "__call__", rows)
        patch.setattr(BoundRows, "__call__", bound)
        patch.setattr(Helpers, "run", of_threads)
        found: list[Call] = []
        yield found
        found += calls.values()
