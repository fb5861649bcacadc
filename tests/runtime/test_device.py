"""Devices: choice, kernels in bands and by their portable definitions, steady state, memory out of
the host's sight."""

import dataclasses
import gc
import threading
import time
from contextlib import nullcontext
from pathlib import Path

import numpy as np
import onnxruntime
import pytest

from postfx.kernels import Kernel, find_source, read_source
from postfx.kernels.denoise.prepare import SCALE
from postfx.kernels.image import RESAMPLE
from postfx.runtime import (
    ArgumentTable,
    CommandError,
    CompiledComputeState,
    Device,
    DeviceError,
    ModelError,
    PortableComputeState,
)
from postfx.runtime import device as device_module
from postfx.runtime.states import CudaComputeState
from tests import toys


def run(device, state, arrays, output):
    """Run a kernel on arrays of its reads; returns what it wrote."""
    tensors = {name: device.wrap(name, array) for name, array in arrays.items()}
    tensors |= {name: device.heap.tensor(name, shape) for name, shape in output.items()}
    commands = device.command_buffer("test")
    with commands.compute_encoder("kernel") as encoder:
        encoder.dispatch(state, ArgumentTable(state, tensors))
    commands.commit()
    commands.wait(30)
    return {name: tensors[name].download() for name in output}


def test_default_threads_are_the_usable_cores():
    assert Device("cpu").threads >= 1 and Device("cpu", threads=3).threads == 3


def test_no_threads():
    with pytest.raises(DeviceError, match="at least 1 thread"):
        Device("cpu", threads=0)


@pytest.mark.parametrize("name", ["gpu", "cpu:1", "cuda:x", ""])
def test_unknown_device(name):
    with pytest.raises(DeviceError, match=f"no device '{name}': use auto, cpu, cuda or cuda:N"):
        Device(name)


@pytest.mark.parametrize(("name", "index"),
                         [("cuda", 0), ("cuda:0", 0), ("cuda:3", 3), ("auto", 0)])
def test_number_of_a_cuda_device(name, index, monkeypatch):
    asked = []
    monkeypatch.setattr(device_module, "cuda_fault",
                        lambda number: asked.append(number) or "it is not there")
    with nullcontext() if name == "auto" else pytest.raises(DeviceError, match=f"'{name}' is not "
                                                            "available: it is not"):
        assert Device(name).name == "cpu"
    assert asked == [index]


@pytest.mark.skipif("CUDAExecutionProvider" in onnxruntime.get_available_providers(),
                    reason="ONNX Runtime has CUDA")
def test_cuda_where_there_is_none():
    with pytest.raises(DeviceError, match=r"'cuda' is not available: .* pip install '\.\[cuda\]'"):
        Device("cuda")
    assert Device("auto").name == "cpu"


@pytest.mark.parametrize("rows", [1, 2, 7, 64, 1001])
@pytest.mark.parametrize("threads", [1, 2, 5])
def test_bands_cover_every_row_once(rows, threads):
    device = Device("cpu", threads=threads)
    seen = []

    def count(y0, y1, a, b):
        seen.append((y0, y1))
        b[y0:y1] = a[y0:y1] + 1

    state = device.compute_state(Kernel("count", ("a",), ("b",), count, ("b", 0)))
    a = np.arange(rows, dtype=np.float32)
    assert np.array_equal(run(device, state, {"a": a}, {"b": (rows,)})["b"], a + 1)
    edges = sorted(seen)
    assert edges[0][0] == 0 and edges[-1][1] == rows and len(edges) <= threads
    assert all(one[1] == other[0] for one, other in zip(edges, edges[1:], strict=False))


def test_rows_may_lie_along_any_axis(device):
    def double(y0, y1, a, b):
        b[:, :, y0:y1] = 2 * a[:, :, y0:y1]

    state = device.compute_state(Kernel("double", ("a",), ("b",), double, ("b", 2)))
    a = np.random.default_rng(0).random((1, 3, 20, 4), np.float32)
    assert np.array_equal(run(device, state, {"a": a}, {"b": a.shape})["b"], 2 * a)


def test_a_plug_in_may_compile_rows_by_numba():
    """Numba's functions are called as Python's are; the kernel's other forms lie beside what was
    compiled."""
    numba = pytest.importorskip("numba")

    def twice(y0, y1, a, b):
        for y in range(y0, y1):
            b[y] = 2 * a[y]

    device, a = Device("cpu", threads=2), np.random.default_rng(0).random((64, 3), np.float32)
    rows = numba.njit(nogil=True)(twice)
    rows(0, 0, a, a)  # compiles it
    kernel = Kernel("twice", ("a",), ("b",), rows, ("b", 0), {"a": ("h", "w"), "b": ("h", "w")})
    assert kernel.home == Path(__file__).resolve().parent
    found = run(device, device.compute_state(kernel), {"a": a}, {"b": a.shape})["b"]
    assert np.array_equal(found, 2 * a)


@pytest.mark.parametrize("kernel", [toys.ADD, toys.TWICE_AS_LARGE])
def test_compiled_and_portable_kernels_agree(kernel, kernels):
    random = np.random.default_rng(1)
    arrays = {name: random.random((5, 7, 3), np.float32) for name in kernel.reads}
    output = {name: (10, 14, 3) if name == "fine" else (5, 7, 3) for name in kernel.writes}
    compiled = Device("cpu", threads=2)
    portable = Device("cpu", threads=2, compiled_kernels=False, kernels=kernels)
    states = compiled.compute_state(kernel), portable.compute_state(kernel)
    assert (isinstance(states[0], CompiledComputeState)
            and isinstance(states[1], PortableComputeState))
    assert states[0].bindings == states[1].bindings
    first = run(compiled, states[0], arrays, output)
    second = run(portable, states[1], arrays, output)
    assert all(np.array_equal(first[name], second[name]) for name in output)


def test_missing_portable_definition(kernels):
    device = Device("cpu", compiled_kernels=False, kernels=kernels)
    with pytest.raises(ModelError, match="kernel 'blur' has no form that runs on Device.'cpu'"):
        device.compute_state(Kernel("blur", ("a",), ("b",), print, ("b", 0)))


def test_portable_definition_with_other_bindings(kernels):
    device = Device("cpu", compiled_kernels=False, kernels=kernels)
    with pytest.raises(ModelError,
                       match="has the inputs a float32, b float32: they must be a float32, c "
                       "float32"):
        device.compute_state(Kernel("add", ("a", "c"), ("total",), print, ("total", 0)))


def test_host_cannot_look_at_remote_memory(remote, ones):
    tensor = remote.wrap("ones", ones)
    ones[:] = 0.0
    assert np.all(tensor.download() == 1.0)
    with pytest.raises(DeviceError, match=r"use download\(\)"):
        tensor.array.sum()


def test_kernels_of_a_gpu_without_a_source_run_by_their_portable_definitions(remote):
    assert isinstance(remote.compute_state(toys.ADD), PortableComputeState)


def test_remote_tensors_take_part_of_a_chunk(remote):
    first, second = remote.heap.tensor("first", (3, 5)), remote.heap.tensor("second", (3, 5))
    first.fill(1.0)
    second.upload(np.arange(15.0).reshape(3, 5))
    row = second.view("row", (5,), offset=5)
    row.upload(np.full(5, -1.0))
    assert np.all(first.download() == 1.0)
    assert np.array_equal(second.download(), [[0, 1, 2, 3, 4], [-1] * 5, [10, 11, 12, 13, 14]])


def test_kernels_and_networks_on_remote_memory(remote, library):
    random = np.random.default_rng(2)
    a, b = random.random((2, 1, 4, 5), np.float32)
    kernel = remote.compute_state(toys.ADD)
    network = remote.pipeline_state(library, "double", {"height": 4, "width": 5})
    total, y = remote.heap.tensor("total", (1, 4, 5)), remote.heap.tensor("y", (1, 4, 5))
    commands = remote.command_buffer("frame")
    with commands.compute_encoder("add") as encoder:
        arguments = {"a": remote.wrap("a", a), "b": remote.wrap("b", b), "total": total}
        encoder.dispatch(kernel, ArgumentTable(kernel, arguments))
    with commands.machine_learning_encoder("double") as encoder:
        encoder.barrier(after="compute", before="machine-learning")
        encoder.dispatch_network(network, ArgumentTable(network, {"x": total, "y": y}))
    commands.commit()
    commands.wait(10)
    assert np.array_equal(y.download(), (a + b) * 2)


def test_networks_read_and_write_tensors_where_they_lie(bench, ones):
    result = np.zeros_like(ones)
    commands = bench.device.command_buffer("frame")
    with commands.machine_learning_encoder("double") as encoder:
        encoder.dispatch_network(*bench.double(bench.device.wrap("x", ones),
                                               bench.device.wrap("y", result)))
    commands.commit()
    commands.wait(10)
    assert np.all(result == 2)


def test_steady_state_takes_no_memory(bench):
    x, y, z = bench.tensor("x", True), bench.tensor("y"), bench.tensor("z")
    network, kernel = bench.double(x, y), bench.add(x, y, z)

    def frame():
        commands = bench.device.command_buffer("frame")
        with commands.machine_learning_encoder("double") as encoder:
            encoder.dispatch_network(*network)
        with commands.compute_encoder("add") as encoder:
            encoder.barrier(after="machine-learning", before="compute")
            encoder.dispatch(*kernel)
        commands.commit()
        commands.wait(10)

    frame()
    before = bench.device.heap.used, bench.device.heap.peak, bench.device.heap.size
    prepared = network[1].arguments(), kernel[1].arguments()
    for _ in range(50):
        frame()
    assert (bench.device.heap.used, bench.device.heap.peak, bench.device.heap.size) == before
    assert prepared[0] is network[1].arguments() and prepared[1] is kernel[1].arguments()


def test_portable_kernels_do_not_write_past_a_tensor(kernels):
    device = Device("cpu", compiled_kernels=False, kernels=kernels)
    undeclared = Kernel("twice_as_large", ("coarse",), ("fine",), print, ("fine", 0))
    coarse = np.ones((4, 4, 3), np.float32)
    assert run(device, device.compute_state(undeclared), {"coarse": coarse},
               {"fine": (8, 8, 3)})["fine"].min() == 1
    with pytest.raises(CommandError, match="kernel 'twice_as_large'"):
        run(device, device.compute_state(undeclared), {"coarse": coarse}, {"fine": (7, 8, 3)})


def test_threads_end_with_the_device():
    def use():
        device = Device("cpu", threads=3)
        state = device.compute_state(toys.ADD)
        a = np.ones((30, 2, 3), np.float32)
        assert np.all(run(device, state, {"a": a, "b": a}, {"total": a.shape})["total"] == 2)

    use()
    gc.collect()
    before = threading.active_count()
    for _ in range(5):
        use()
    gc.collect()
    deadline = time.monotonic() + 60
    while threading.active_count() > before and time.monotonic() < deadline:
        time.sleep(0.01)
    assert threading.active_count() <= before


def test_a_foreign_kernel_never_gets_a_form_of_ours(tmp_path, kernels):
    """It has the name of a kernel of ours, and brings its own forms, or none."""
    binding = ("image", "rows", "columns"), ("output",)
    foreign = Kernel("resample", *binding, print, ("output", 0), folder=tmp_path)
    assert find_source(RESAMPLE) and find_source(foreign) is None and RESAMPLE.home is None
    with pytest.raises(ModelError,
                       match=f"no form that runs on .*: there is no '{tmp_path}/resample.onnx'"):
        Device("cpu", compiled_kernels=False).compute_state(foreign)
    other = tmp_path / "other"
    other.mkdir()
    (other / "own.cu").write_text('extern "C" __global__ void resample(View image, View output) '
                                  '{}\n')
    own = dataclasses.replace(foreign, folder=other)
    assert (find_source(own) == other / "own.cu"
            and "MOST_REFLECTANCE" not in read_source(other / "own.cu"))
    assert ("struct View" in read_source(other / "own.cu")
            and "MOST_REFLECTANCE" in read_source(find_source(RESAMPLE)))
    assert toys.ADD.home == Path(toys.__file__).parent


def test_a_foreign_kernel_runs_by_the_portable_form_beside_it(tmp_path):
    toys.make_kernels(tmp_path)
    foreign = dataclasses.replace(toys.ADD, folder=tmp_path)
    assert isinstance(Device("cpu", compiled_kernels=False).compute_state(foreign),
                      PortableComputeState)


def test_a_gpu_runs_kernels_by_their_cuda_sources_and_others_portably(monkeypatch):
    device, gpu = Device("cpu"), object()
    monkeypatch.setattr(Device, "gpu", gpu)
    state = device.compute_state(SCALE)
    assert (isinstance(state, CudaComputeState) and state._memory is gpu
            and state._source.name == "prepare.cu")
    # the CPU's, as it is no GPU really
    assert isinstance(device.compute_state(toys.ADD), CompiledComputeState)
