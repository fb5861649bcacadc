"""A small capture: a kernel, a barrier and a network; and a browser for the pages."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from postfx.runtime import ArgumentTable, Capture, Device
from tests import toys
from tests.report.browser import Tab, chromium

SHAPE = (1, 4, 5)


@pytest.fixture(scope="session")
def tab(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Tab]:
    """One tab for all pages: a browser takes longer to start than a page to draw. Skips where there
    is no Chromium."""
    with chromium(tmp_path_factory.mktemp("chromium")) as tab:
        yield tab


@pytest.fixture(scope="session")
def rendered(tab: Tab) -> Callable[..., str]:
    """The elements of a page after its scripts and one more: `rendered(page, script)`."""
    return tab.rendered


@pytest.fixture
def make_capture(tmp_path: Path) -> Callable[..., Capture]:
    """Captures total = a + b and then y = 2 total; `name` is the tensor total's."""
    (tmp_path / "models").mkdir()
    library = toys.make_library(tmp_path / "models")

    def make(a: float = 1.0, b: float = 2.0, name: str = "total", **options) -> Capture:
        device = Device("cpu", threads=1)
        kernel = device.compute_state(toys.ADD)
        network = device.pipeline_state(library, "double", {"height": 4, "width": 5})
        total, y = device.heap.tensor(name, SHAPE), device.heap.tensor("y", SHAPE)
        left = device.wrap("a", np.full(SHAPE, a, np.float32))
        right = device.wrap("b", np.full(SHAPE, b, np.float32))
        commands = device.command_buffer("frame 3")
        with commands.group("toy"), commands.compute_encoder("add") as encoder:
            encoder.dispatch(kernel, ArgumentTable(kernel, {"a": left, "b": right, "total": total}))
        with commands.group("toy"), commands.machine_learning_encoder("double") as encoder:
            encoder.barrier(after="compute", before="machine-learning")
            encoder.dispatch_network(network, ArgumentTable(network, {"x": total, "y": y}))
        with device.capture(**options) as capture:
            commands.commit()
            commands.wait(10)
        return capture

    return make
