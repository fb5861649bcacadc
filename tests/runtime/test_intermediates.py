"""What networks compute between their inputs and outputs: its size, memory that networks share,
what the heap tells."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper, numpy_helper

from postfx.runtime import ArgumentTable, BindingError, Device, HazardError, Library
from postfx.system import held_bytes
from tests.kernels import host_cuda
from tests.kernels.host_convolutions import HostGpu
from tests.kernels.test_convolutions import make_network

COUNTED = pytest.mark.skipif(held_bytes() is None, reason="only Linux tells what was touched")
MODELS = Path(__file__).parent.parent.parent / "models"
MIB = 1 << 20
CHANNELS, SIDE = 32, 512
PLANE = CHANNELS * SIDE * SIDE * 4
TRIES = 4
"""Measurements of which one must be right: other threads of the process may touch pages, too."""


def save_wide(folder: Path) -> Library:
    """A network 'wide' of one channel that is 32 channels in between, by a convolution of two
    layers."""
    random = np.random.default_rng(1)
    weights = [numpy_helper.from_array(random.standard_normal(shape, np.float32), name)
               for name, shape in (("a", (CHANNELS, 1, 1, 1)), ("b", (1, CHANNELS, 1, 1)))]
    nodes = [helper.make_node("Conv", ["x", "a"], ["between"]),
             helper.make_node("Sin", ["between"], ["bent"]),
             helper.make_node("Conv", ["bent", "b"], ["y"])]
    values = [helper.make_tensor_value_info(name, TensorProto.FLOAT, [1, 1, "height", "width"])
              for name in "xy"]
    graph = helper.make_graph(nodes, "wide", values[:1], values[1:], weights)
    opsets = [helper.make_opsetid("", 20)]
    onnx.save(helper.make_model(graph, opset_imports=opsets, ir_version=10), folder / "wide.onnx")
    return Library(folder)


GROWTH = """
import sys
from pathlib import Path
from postfx.runtime import ArgumentTable, Device, Library
from postfx.system import held_bytes

_, model, side, what = sys.argv
side, path, device = int(side), Path(model), Device("cpu", threads=1)
state = device.pipeline_state(Library(path.parent), path.name, {"height": side, "width": side})
if what == "asked":
    print(state.intermediates_size)
    sys.exit()
given = {}
for binding in state.bindings:
    given[binding.name] = device.heap.tensor(binding.name, state.shapes[binding.name],
                                             binding.dtype)
    given[binding.name].fill(0)
first = device.command_buffer("first")  # the device's thread, whose stack is mapped, begins here
first.commit()
first.wait(60)
peak, before = device.heap.peak, held_bytes()
with device.capture(tensors="none") as capture:
    commands = device.command_buffer("one")
    with commands.machine_learning_encoder("network") as encoder:
        encoder.dispatch_network(state, ArgumentTable(state, given))
    commands.commit()
    commands.wait(60)
print(held_bytes() - before, device.heap.peak - peak, device.heap.networks,
      capture.buffers[0].heap_peak - peak)
"""


def in_a_process(model: Path, side: int, what: str) -> list[int]:
    """Figures of a process in which no other network ran."""
    done = subprocess.run([sys.executable, "-c", GROWTH, str(model), str(side), what],
                          capture_output=True, text=True, check=True,
                          env=os.environ | {"MALLOC_ARENA_MAX": "1"})
    return [int(word) for word in done.stdout.split()]


@COUNTED
@pytest.mark.parametrize(("name", "side", "least"), [
    ("wide", SIDE, PLANE), ("denoise_upscale.s.1x", 512, 16 * MIB),
    ("denoise_upscale.xl.1x", 256, 64 * MIB)])
def test_the_heap_and_captures_know_what_a_network_takes(name: str, side: int, least: int,
                                                         tmp_path: Path) -> None:
    """What it touches, and not what the arena has taken from the system for later."""
    save_wide(tmp_path)
    model = (tmp_path if name == "wide" else MODELS) / name
    grown, peak, networks, captured = in_a_process(model, side, "run")
    assert grown > least
    assert peak == networks == captured == pytest.approx(grown, rel=0.05)
    # in another process: the system gives pages of 2 MiB where it likes
    assert in_a_process(model, side, "asked") == [pytest.approx(grown, rel=0.2)]


@COUNTED
def test_intermediates_grow_with_the_picture_and_are_measured_again(tmp_path: Path) -> None:
    """Also where the C library keeps pages that were touched and freed before."""
    library = save_wide(tmp_path)
    kept = [np.ones(MIB // 4, np.uint8) for _ in range(4 * SIDE)]
    del kept[:-1]
    for _ in range(TRIES):
        device = Device("cpu", threads=1)
        sizes = [device.pipeline_state(library, "wide", {"height": side, "width": side})
                 .intermediates_size for side in (SIDE, 2 * SIDE, SIDE)]
        if sizes[0] == pytest.approx(sizes[2], rel=0.05):
            break
    assert sizes[0] == pytest.approx(sizes[2], rel=0.05) and sizes[1] > 3 * sizes[0] > 3 * PLANE


@COUNTED
def test_a_second_network_runs_in_the_arena_of_the_first(tmp_path: Path) -> None:
    """Another device's, too: the arena is the process's."""
    device, library = Device("cpu", threads=1), save_wide(tmp_path)

    def run(side: int) -> int:
        state = device.pipeline_state(library, "wide", {"height": side, "width": side})
        x, y = (device.heap.tensor(name, (1, 1, side, side)) for name in "xy")
        x.fill(1.0)
        commands, before = device.command_buffer("one"), device.heap.networks
        with commands.machine_learning_encoder("wide") as encoder:
            encoder.dispatch_network(state, ArgumentTable(state, {"x": x, "y": y}),
                                     device.intermediates(state))
        commands.commit()
        commands.wait(60)
        return device.heap.networks - before

    run(2 * SIDE)
    # other threads of this process may touch a page of 2 MiB meanwhile
    assert run(SIDE) < PLANE / 4 and run(2 * SIDE) < PLANE / 4
    assert device.heap.size >= device.heap.used + device.heap.networks


@COUNTED
def test_too_little_memory_is_refused(tmp_path: Path) -> None:
    device, library = Device("cpu", threads=1), save_wide(tmp_path)
    state = device.pipeline_state(library, "wide", {"height": SIDE, "width": SIDE})
    x, y = (device.heap.tensor(name, (1, 1, SIDE, SIDE)) for name in "xy")
    commands = device.command_buffer("one")
    with commands.machine_learning_encoder("wide") as encoder:
        with pytest.raises(BindingError,
                           match=r"'wide' needs [\d,]+ bytes .* has 1,000: give "
                           r"device.intermediates"):
            encoder.dispatch_network(state, ArgumentTable(state, {"x": x, "y": y}),
                                     heap=device.intermediates(1000))
        with pytest.raises(BindingError, match="different devices"):
            encoder.dispatch_network(state, ArgumentTable(state, {"x": x, "y": y}),
                                     heap=Device("cpu").intermediates(1 << 40))
    commands.discard()


@pytest.mark.skipif(host_cuda.COMPILER is None, reason="no g++")
def test_our_own_networks_share_memory_of_the_heap(tmp_path: Path,
                                                   monkeypatch: pytest.MonkeyPatch) -> None:
    """Two sizes of a network, once each in its own memory and once both in one; without a barrier
    that is a hazard."""
    (tmp_path / "toy.onnx").write_bytes(make_network(lambda graph: None))
    monkeypatch.setattr(Device, "gpu", HostGpu(warpgroups=False, processors=7))
    device = Device("cpu", threads=1, explicit_barriers=True)
    library, random = Library(tmp_path), np.random.default_rng(1)
    states = [device.pipeline_state(library, "toy", {"height": rows, "width": 56})
              for rows in (40, 24)]
    tables = []
    for state in states:
        tensors = {binding.name: device.heap.tensor(binding.name, state.shapes[binding.name],
                                                    binding.dtype)
                   for binding in state.bindings}
        tensors["packed"].upload(random.random(state.shapes["packed"]).astype(np.float16))
        tables.append(ArgumentTable(state, tensors))
    heap = device.intermediates(*states)
    assert heap.size == states[0].intermediates_size > states[1].intermediates_size > 0

    def run(memory: object, barrier: bool = True) -> list[np.ndarray]:
        commands = device.command_buffer("both")
        with commands.machine_learning_encoder("both") as encoder:
            for state, table in zip(states, tables, strict=True):
                encoder.dispatch_network(state, table, memory)
                if barrier:
                    encoder.barrier()
        commands.commit()
        commands.wait(60)
        return [table["fine"].download() for table in tables]

    before = device.heap.used
    shared = run(heap)
    assert device.heap.used - before == pytest.approx(heap.size, rel=0.05)
    for one, other in zip(shared, run(None), strict=True):
        np.testing.assert_array_equal(one, other)
    assert device.heap.used - before == pytest.approx(heap.size + sum(
        state.intermediates_size for state in states
    ), rel=0.05)
    with pytest.raises(HazardError, match="intermediates"):
        run(heap, barrier=False)
