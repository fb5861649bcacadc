"""A network inside of a kernel gives what the network gives: in C++, by its CUDA source, in
Python."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from postfx import Device
from postfx.compiled import library
from postfx.compiled.library import Rows
from postfx.kernels import Kernel
from postfx.kernels.mlp import STRIP, mlp, mlp_features, mlp_space
from postfx.neural import Learner, Network
from postfx.runtime import ArgumentTable
from postfx.runtime.device import cuda_fault
from tests.kernels import host_cuda

NETWORKS = (Network(3, (20, 7), 2, "gelu"), Network(5, (), 3), Network(2, (33,), 1, "sine"),
            Network(9, (64, 64), 3), Network(4, (72,), 2))
POINTS = 77
HEIGHT = 3
HEADER = """
static void @NAME@_rows(Long first, Long last, View<const float, 1> parameters,
                        View<const float, 2> points, View<float, 2> values) {
    across(first, last, EACH(F, Long p) {
        F features[@INPUTS@], found[@OUTPUTS@];
        int places[Of<F>::COUNT];
        for (int i = 0; i < Of<F>::COUNT; i++) places[i] = int(p) + i;
        for (int k = 0; k < @INPUTS@; k++) {
            const F value = gather<F, @INPUTS@>(points.at + k, places);
            features[k] = value * value;
        }
        @CALL@
        for (int j = 0; j < @OUTPUTS@; j++) spread<@OUTPUTS@, F>(values(p) + j, found[j] + 1.0f);
    });
}
EXPORT(@NAME@, @NAME@_rows)

static void @NAME@_of_pixels_rows(Long first, Long last, View<const float, 1> parameters,
                                  View<const float, 3> points, View<float, 3> values) {
    const Long width = values.size[1], count = width * values.size[0];
    @NAME@_rows(first * width, last * width, parameters, {points.at, {count, @INPUTS@}},
                {values.at, {count, @OUTPUTS@}});
}
EXPORT(@NAME@_of_pixels, @NAME@_of_pixels_rows)
"""
CUDA = """
extern "C" __global__ void @NAME@_of_pixels(View parameters, View points, View values) {
    PIXEL(values.size[1], values.size[0]);
    const size_t at = size_t(y) * values.size[1] + x;
    float features[@INPUTS@], found[@OUTPUTS@];
    for (int k = 0; k < @INPUTS@; k++) {
        const float value = points.at[at * @INPUTS@ + k];
        features[k] = value * value;
    }
    @CALL@
    for (int j = 0; j < @OUTPUTS@; j++) values.at[at * @OUTPUTS@ + j] = found[j] + 1.0f;
}

extern "C" __global__ void @NAME@(View parameters, View points, View values) {
    PIXEL(@OUTPUTS@, values.size[0]);
    float features[@INPUTS@], found[@OUTPUTS@];
    for (int k = 0; k < @INPUTS@; k++) {
        const float value = points.at[size_t(y) * @INPUTS@ + k];
        features[k] = value * value;
    }
    @CALL@
    values.at[size_t(y) * @OUTPUTS@ + x] = found[x] + 1.0f;
}
"""


def square_rows(y0: int, y1: int, network: np.ndarray, parameters: np.ndarray, points: np.ndarray,
                values: np.ndarray) -> None:
    """The network of the points' squares, plus one: something before and something after it."""
    space = mlp_space(network)
    features = mlp_features(space)
    for first in range(y0, y1, STRIP):
        count = min(STRIP, y1 - first)
        features[:, :count] = points[first:first + count].T ** 2
        values[first:first + count] = mlp(network, parameters, space)[:, :count].T + 1


class Case(NamedTuple):
    """A kernel, one whose threads make pixels, the network in both, what they read, and the values
    that are right."""

    kernel: Kernel
    pixels: Kernel
    network: Network
    inputs: dict[str, np.ndarray]
    wanted: np.ndarray


@pytest.fixture(scope="module")
def plug_in(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The header of a plug-in with a kernel of every network, beside its CUDA source."""
    folder = tmp_path_factory.mktemp("plug_in")
    texts = {"squares.h": '#include "mlp.h"\n#include "rows.h"\n',
             "squares.cu": "#include <postfx/mlp.cuh>\n"}
    for number, network in enumerate(NETWORKS):
        kind, sizes = network.activation.upper(), ", ".join(map(str, network.sizes))
        words = {"NAME": f"squares_{number}", "INPUTS": f"{network.inputs}",
                 "OUTPUTS": f"{network.outputs}",
                 "CALL": f"mlp<{kind}, {sizes}>(parameters.at, features, found);"}
        for (name, text), form in zip(texts.items(), (HEADER, CUDA), strict=True):
            for word, value in words.items():
                form = form.replace(f"@{word}@", value)
            texts[name] = text + form
    for name, text in texts.items():
        (folder / name).write_text(text)
    return folder / "squares.h"


@pytest.fixture(params=range(len(NETWORKS)),
                ids=["-".join(map(str, network.sizes)) for network in NETWORKS])
def case(request: pytest.FixtureRequest, plug_in: Path) -> Case:
    network = NETWORKS[request.param]
    random = np.random.default_rng(0)
    name = f"squares_{request.param}"
    kernel = Kernel(name, ("parameters", "points"), ("values",), Rows(name, plug_in), ("values", 0),
                    {
                        "parameters": (network.count,), "points": ("points", network.inputs),
                        "values": ("points", network.outputs)})
    of_pixels = f"{name}_of_pixels"
    pixels = Kernel(of_pixels, ("parameters", "points"), ("values",), Rows(of_pixels, plug_in),
                    ("values", 0), {"parameters": (network.count,),
                                    "points": ("height", "width", network.inputs),
                                    "values": ("height", "width", network.outputs)})
    points = random.normal(size=(POINTS, network.inputs)).astype(np.float32)
    device = Device("cpu", threads=2)
    learner = Learner(device, network)
    given = device.wrap("squared", points * points)
    made = device.heap.tensor("values", (POINTS, network.outputs))
    commands = device.command_buffer("network")
    with commands.compute_encoder("network") as encoder:
        learner.run(encoder, given, made)
    commands.commit()
    commands.wait()
    inputs = {"parameters": learner.parameters.download(), "points": points}
    return Case(kernel, pixels, network, inputs, made.download() + 1)


def test_on_the_cpu(case: Case) -> None:
    device = Device("cpu", threads=2)
    state = device.compute_state(case.kernel)
    values = device.heap.tensor("values", case.wanted.shape)
    table = ArgumentTable(state,
                          {name: device.wrap(name, array) for name, array in case.inputs.items()}
                          | {"values": values})
    commands = device.command_buffer("own")
    with commands.compute_encoder("own") as encoder:
        encoder.dispatch(state, table)
    commands.commit()
    commands.wait()
    np.testing.assert_allclose(values.download(), case.wanted, atol=1e-5)


def test_nan_stays_with_its_point(case: Case) -> None:
    points, found = case.inputs["points"].copy(), np.zeros_like(case.wanted)
    points[5, 0] = np.nan
    case.kernel.rows(0, POINTS, case.inputs["parameters"], points, found)
    assert np.isnan(found[5]).all() and np.isfinite(np.delete(found, 5, 0)).all()
    if host_cuda.COMPILER:
        on_gpu = np.zeros_like(found)
        host_cuda.run(case.kernel, case.inputs | {"points": points, "values": on_gpu})
        np.testing.assert_allclose(on_gpu, found, atol=1e-5)


@pytest.mark.skipif(host_cuda.COMPILER is None, reason="no g++")
def test_by_the_cuda_source(case: Case) -> None:
    found = np.zeros_like(case.wanted)
    host_cuda.run(case.kernel, case.inputs | {"values": found})
    np.testing.assert_allclose(found, case.wanted, atol=1e-5)


@pytest.mark.skipif(host_cuda.COMPILER is None, reason="no g++")
def test_warps_use_the_matrix_units(case: Case) -> None:
    """Where a row of pixels ends within a warp, each thread of that works alone. Both give the same
    to float32's precision, and NaN stays with its point."""
    height, width = HEIGHT, POINTS
    points = np.stack([np.roll(case.inputs["points"], row, 0) for row in range(height)])
    wanted = np.stack([np.roll(case.wanted, row, 0) for row in range(height)])
    points[1, 5, 0] = np.nan
    found, before = np.zeros_like(wanted), host_cuda.products(case.pixels)
    host_cuda.run(case.pixels, case.inputs | {"points": points, "values": found})
    assert np.isnan(found[1, 5]).all()
    found[1, 5] = wanted[1, 5]
    np.testing.assert_allclose(found, wanted, atol=1e-5)
    padded = [-(-size // 8) for size in case.network.sizes]
    each = 3 * 2 * sum(a * b for a, b in zip(padded, padded[1:], strict=False))
    fits = 16 <= max(case.network.sizes[1:-1], default=0) <= 64
    made = host_cuda.products(case.pixels) - before
    assert made == (each * height * (width // 32) if fits else 0)


@pytest.mark.gpu
@pytest.mark.skipif(cuda_fault(0) is not None, reason="needs a GPU")
def test_an_mlp_on_a_gpu_gives_the_cpus_values(case: Case) -> None:
    device = Device("cuda")
    points = np.stack([case.inputs["points"]] * HEIGHT)
    wanted = np.stack([case.wanted] * HEIGHT)
    tensors = {"parameters": case.inputs["parameters"], "points": points,
               "values": np.zeros_like(wanted)}
    held = {name: device.heap.tensor(name, array.shape) for name, array in tensors.items()}
    for name, array in tensors.items():
        held[name].upload(array)
    commands = device.command_buffer("pixels")
    commands.run(case.pixels, **held)
    commands.commit()
    commands.wait()
    np.testing.assert_allclose(held["values"].download(), wanted, atol=1e-5)


def test_by_rows_in_python(case: Case) -> None:
    found = np.zeros_like(case.wanted)
    square_rows(0, POINTS, case.network.facts(), *case.inputs.values(), found)
    np.testing.assert_allclose(found, case.wanted, atol=1e-6)


@pytest.mark.soak
def test_levels_give_the_same_bits(case: Case) -> None:
    found = {}
    for level in library.levels():
        found[level] = np.zeros_like(case.wanted)
        Rows(case.kernel.name, case.kernel.rows.header,
             level)(0, POINTS, *case.inputs.values(), found[level])
    lowest = found.pop("baseline", case.wanted)
    np.testing.assert_allclose(lowest, case.wanted, atol=1e-5)
    for values in found.values():
        np.testing.assert_array_equal(values, next(iter(found.values())))
