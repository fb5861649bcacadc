"""Devices and models for the runtime's tests."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pytest

import postfx.runtime.device as device_module
from postfx.runtime import ArgumentTable, Device, Library, PipelineState, Tensor
from postfx.runtime.device import ProviderMemory
from postfx.runtime.session import Placement
from tests import toys
from tests.runtime.chain import Chain


@pytest.fixture(scope="session")
def library(tmp_path_factory: pytest.TempPathFactory) -> Library:
    return toys.make_library(tmp_path_factory.mktemp("models"))


@pytest.fixture(scope="session")
def kernels(tmp_path_factory: pytest.TempPathFactory) -> Library:
    return toys.make_kernels(tmp_path_factory.mktemp("kernels"))


@pytest.fixture
def device() -> Device:
    """Commands are ordered by what tests record."""
    return Device("cpu", threads=2, explicit_barriers=True)


@pytest.fixture
def remote(monkeypatch, kernels):
    """A device whose memory the host cannot look at: the same path as on a GPU, on the CPU
    provider."""
    placement = Placement("CPUExecutionProvider", "cpu", 0, 2)
    monkeypatch.setattr(device_module, "choose",
                        lambda *rest: (placement, ProviderMemory(placement)))
    return Device("auto", kernels=kernels, explicit_barriers=True)


@pytest.fixture
def double(device: Device, library: Library) -> PipelineState:
    return device.pipeline_state(library, "double", {"height": 4, "width": 5})


def run_once(state, tensors: dict, stage: str = "machine_learning") -> None:
    """Run a state on tensors, from commit to wait."""
    commands = state.device.command_buffer("once")
    with getattr(commands, f"{stage}_encoder")("once") as encoder:
        dispatch = encoder.dispatch_network if stage == "machine_learning" else encoder.dispatch
        dispatch(state, ArgumentTable(state, tensors))
    commands.commit()
    commands.wait(60)


class Bench:
    """A device with a network 'double' and a kernel 'add' on tensors of one size, to record short
    graphs with."""

    def __init__(self, device: Device, library: Library) -> None:
        self.device = device
        self.network = device.pipeline_state(library, "double", {"height": 4, "width": 5})
        self.kernel = device.compute_state(toys.ADD)

    def tensor(self, name: str, filled: bool = False):
        tensor = self.device.heap.tensor(name, (1, 4, 5))
        if filled:
            tensor.fill(1.0)
        return tensor

    def double(self, x, y) -> tuple[PipelineState, ArgumentTable]:
        return self.network, ArgumentTable(self.network, {"x": x, "y": y})

    def add(self, a, b, total):
        return self.kernel, ArgumentTable(self.kernel, {"a": a, "b": b, "total": total})


@pytest.fixture
def bench(device: Device, library: Library) -> Bench:
    return Bench(device, library)


class Failing(NamedTuple):
    """A dispatch of the network 'pick' that fails until `index` is at most 2, and its tensors."""

    dispatch: tuple[PipelineState, ArgumentTable]
    index: Tensor
    picked: Tensor


@pytest.fixture
def failing(device: Device, library: Library) -> Failing:
    state = device.pipeline_state(library, "pick")
    index, picked = device.heap.tensor("index", (1,), "int64"), device.heap.tensor("picked", (1,))
    index.upload([7])
    return Failing((state, ArgumentTable(state, {"index": index, "picked": picked})), index, picked)


@pytest.fixture
def ones() -> np.ndarray:
    return np.ones((1, 4, 5), np.float32)


@pytest.fixture
def chain(device, library):
    return Chain(device, library)


@pytest.fixture(params=["host", "remote"])
def any_chain(request, library):
    return Chain(request.getfixturevalue("device" if request.param == "host" else "remote"),
                 library)
