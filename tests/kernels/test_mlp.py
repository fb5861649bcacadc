"""A small network inside of a kernel of one's own gives what the network gives, on the CPU and by its CUDA source."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from postfx import Device
from postfx.kernels import Kernel
from postfx.kernels.mlp import STRIP, mlp, mlp_features, mlp_space
from postfx.kernels.numeric import compiled
from postfx.neural import Learner, Network
from postfx.runtime import ArgumentTable
from tests.kernels import host_cuda

NETWORKS = (Network(3, (20, 7), 2, "gelu"), Network(5, (), 3), Network(2, (33,), 1, "sine"), Network(9, (64, 64), 3))


@compiled
def square_rows(y0: int, y1: int, network: np.ndarray, parameters: np.ndarray, points: np.ndarray,
                values: np.ndarray) -> None:
    """The network of the points' squares, plus one: something before and something after it."""
    space = mlp_space(network)
    features = mlp_features(space)
    for first in range(y0, y1, STRIP):
        count = min(STRIP, y1 - first)
        for p in range(count):
            for k in range(points.shape[1]):
                features[k, p] = points[first + p, k] * points[first + p, k]
        found = mlp(network, parameters, space)
        for p in range(count):
            for j in range(values.shape[1]):
                values[first + p, j] = found[j, p] + np.float32(1)


def kernel_of(network: Network, folder: Path) -> Kernel:
    """The kernel, and its CUDA source in a folder."""
    sizes = ", ".join(map(str, network.sizes))
    (folder / "squares.cu").write_text(f"""#include <postfx/mlp.cuh>
extern "C" __global__ void squares(View network, View parameters, View points, View values) {{
    PIXEL({network.outputs}, values.size[0]);
    float features[{network.inputs}], found[{network.outputs}];
    for (int k = 0; k < {network.inputs}; k++) {{
        const float value = points.at[size_t(y) * {network.inputs} + k];
        features[k] = value * value;
    }}
    mlp<{network.activation.upper()}, {sizes}>(parameters.at, features, found);
    values.at[size_t(y) * {network.outputs} + x] = found[x] + 1.0f;
}}
""")
    shapes: dict[str, tuple[Any, ...]] = {
        "network": network.facts().shape, "parameters": (network.count,), "points": ("points", network.inputs),
        "values": ("points", network.outputs)}
    return Kernel("squares", ("network", "parameters", "points"), ("values",), square_rows, ("values", 0), shapes,
                  folder=folder)


@pytest.fixture(params=NETWORKS, ids=lambda network: "-".join(map(str, network.sizes)))
def case(request: pytest.FixtureRequest, tmp_path: Path) -> SimpleNamespace:
    network, random = request.param, np.random.default_rng(0)
    points = random.normal(size=(77, network.inputs)).astype(np.float32)
    device = Device("cpu", threads=2)
    learner = Learner(device, network)
    given, made = device.wrap("squared", points * points), device.heap.tensor("values", (77, network.outputs))
    commands = device.command_buffer("network")
    with commands.compute_encoder("network") as encoder:
        learner.run(encoder, given, made)
    commands.commit()
    commands.wait()
    return SimpleNamespace(kernel=kernel_of(network, tmp_path), wanted=made.download() + 1, inputs={
        "network": network.facts(), "parameters": learner.parameters.download(), "points": points})


def test_on_the_cpu(case: SimpleNamespace) -> None:
    device = Device("cpu", threads=2)
    state, values = device.compute_state(case.kernel), device.heap.tensor("values", case.wanted.shape)
    table = ArgumentTable(state, {name: device.wrap(name, array) for name, array in case.inputs.items()}
                          | {"values": values})
    commands = device.command_buffer("own")
    with commands.compute_encoder("own") as encoder:
        encoder.dispatch(state, table)
    commands.commit()
    commands.wait()
    np.testing.assert_allclose(values.download(), case.wanted, atol=1e-5)


@pytest.mark.skipif(host_cuda.COMPILER is None, reason="no g++")
def test_by_the_cuda_source(case: SimpleNamespace) -> None:
    found = np.zeros_like(case.wanted)
    host_cuda.run(case.kernel, case.inputs | {"values": found})
    np.testing.assert_allclose(found, case.wanted, atol=1e-5)
