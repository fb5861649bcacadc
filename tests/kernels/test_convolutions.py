"""Networks as a list of our own kernels: what is read from a file, and what the kernels compute on
the host."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper, numpy_helper

from postfx.runtime import ArgumentTable, Device, Library
from postfx.runtime.convolutions import Convolutions, Head, Unfit, choices, read_layers
from postfx.runtime.cuda import CudaMemory
from postfx.runtime.device import cuda_fault
from tests.kernels import host_cuda
from tests.kernels.host_convolutions import HostGpu

RANDOM = np.random.default_rng(0)


def node(operator: str, inputs: str, output: str, **attributes: object) -> onnx.NodeProto:
    return helper.make_node(operator, inputs.split(), [output], **attributes)


def enlarge(source: str, output: str, mode: str = "nearest") -> onnx.NodeProto:
    return helper.make_node("Resize", [source, "", "twice"], [output], mode=mode,
                            nearest_mode="floor", coordinate_transformation_mode="asymmetric")


def make_network(change: Callable[[onnx.GraphProto], None] = lambda graph: None) -> bytes:
    """A network of every kind of layer: two levels, heads of each, one that a constant is added
    to."""
    def convolve(inputs: str, output: str, out: int, channels: int, side: int = 3,
                 stride: int = 1) -> onnx.NodeProto:
        weight = RANDOM.normal(0, (channels * side**2) ** -0.5,
                               (out, channels, side, side)).astype(np.float16)
        weights.extend((numpy_helper.from_array(weight, f"{output} weight"),
                        numpy_helper.from_array(RANDOM.normal(0, 0.1, out).astype(np.float16),
                                                f"{output} bias")))
        pad = (side - stride) // 2
        return helper.make_node("Conv", [inputs, f"{output} weight", f"{output} bias"], [output],
                                pads=[pad] * 4, strides=[stride] * 2)

    weights = [numpy_helper.from_array(np.float32([1, 1, 2, 2]), "twice"),
               numpy_helper.from_array(RANDOM.random((1, 64, 1, 1)).astype(np.float16), "rest")]
    nodes = [
        node("Transpose", "packed", "first", perm=[0, 3, 1, 2]),
        convolve("first", "stem", 32, 8, 4, 2), node("Relu", "stem", "x"),
        node("MaxPool", "x", "pooled", kernel_shape=[2, 2], strides=[2, 2]),
        convolve("pooled", "down", 64, 32), node("Relu", "down", "y"), node("Add", "y rest", "z"),
        convolve("z", "lift", 32, 64, 1), enlarge("lift", "wide"), node("Add", "x wide", "both"),
        convolve("both", "up", 32, 32), node("Relu", "up", "end"),
        convolve("end", "fine first", 64, 32, 1),
        helper.make_node("Transpose", ["fine first"], ["fine"], perm=[0, 2, 3, 1]),
        convolve("z", "level first", 32, 64, 1),
        helper.make_node("Transpose", ["level first"], ["level"], perm=[0, 2, 3, 1])]
    given = [helper.make_tensor_value_info("packed", TensorProto.FLOAT16,
                                           [1, "height", "width", 8])]
    made = [helper.make_tensor_value_info(name, TensorProto.FLOAT16, [1, *shape])
            for name, *shape in (("fine", "h", "w", 64), ("level", "h2", "w2", 32))]
    graph = helper.make_graph(nodes, "toy", given, made, weights)
    change(graph)
    return helper.make_model(graph, opset_imports=[helper.make_opsetid("", 20)],
                             ir_version=10).SerializeToString()


@pytest.mark.skipif(host_cuda.COMPILER is None, reason="no g++")
@pytest.mark.parametrize("stem", [2, 4])
@pytest.mark.parametrize("gpu", [HostGpu(warpgroups=False, processors=7),
                                 HostGpu(warpgroups=True, processors=3),
                                 HostGpu(warpgroups=True, processors=2, most_shared=24 << 10)],
                         ids=["warps", "warpgroups", "weights in parts"])
def test_the_kernels_compute_what_onnx_runtime_does(
    tmp_path: Path, gpu: HostGpu, stem: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Squares at the sides are not whole. The stem looks at one cell of 2x2 pixels, or at four."""
    def shorten(graph: onnx.GraphProto) -> None:
        found = next(weights for weights in graph.initializer if weights.name == "stem weight")
        found.CopyFrom(numpy_helper.from_array(numpy_helper.to_array(found)[:, :, 1:3, 1:3],
                                               found.name))
        (pads,) = (one for one in graph.node[1].attribute if one.name == "pads")
        pads.ints[:] = [0] * 4

    (tmp_path / "toy.onnx").write_bytes(make_network(shorten if stem == 2 else lambda graph: None))
    device, library = Device("cpu", threads=1), Library(tmp_path)
    state = device.pipeline_state(library, "toy", {"height": 40, "width": 56})
    tensors = {binding.name: device.heap.tensor(binding.name, state.shapes[binding.name],
                                                binding.dtype)
               for binding in state.bindings}
    tensors["packed"].upload(RANDOM.random(state.shapes["packed"]).astype(np.float16))
    state.prepare(list(tensors.values()))()
    wanted = {name: np.array(tensors[name].host_view(), np.float32) for name in ("fine", "level")}
    for name, value in wanted.items():
        tensors[name].upload(np.full(value.shape, np.nan, np.float16))
    layers = read_layers(library.load("toy"), tmp_path)
    assert [layer.output for layer in layers] == ["x", "z", "level", "end", "fine"]
    Convolutions(layers, device, gpu, state.shapes).bind(tensors)()
    for name, value in wanted.items():
        assert np.abs(tensors[name].host_view() - value).max() < 4e-3 * np.abs(value).max()

    heads = {"fine": Head("opened", 16, 8, 12, side=2), "level": Head("opened level", 26, 25, 26)}
    monkeypatch.setattr(Device, "gpu", gpu)
    state = device.pipeline_state(library, "toy", {"height": 40, "width": 56}, heads=heads)
    assert [binding.name for binding in state.bindings] == ["packed", "opened", "opened level"]
    opened = {name: device.heap.tensor(name, state.shapes[name], "float16")
              for name in ("opened", "opened level")}
    state.prepare([{**tensors, **opened}[binding.name] for binding in state.bindings])()
    parts = wanted["fine"].reshape(1, 20, 28, 2, 2,
                                   16).transpose(0, 5, 1, 3, 2, 4).reshape(1, 16, 40, 56)
    for name, logits, (shares, states) in (("opened", parts, (8, 12)), (
        "opened level", wanted["level"].transpose(0, 3, 1, 2)[:, :26], (25, 26)
    )):
        value = np.concatenate((np.exp(logits[:, :shares]),
                                1 / (1 + np.exp(-logits[:, shares:states])),
                                np.tanh(logits[:, states:])), 1)
        np.testing.assert_allclose(opened[name].host_view(), value, rtol=0.02, atol=2e-3)


@pytest.mark.parametrize("tag", ["s.fp16", "m.fp16", "l.fp16", "xl.fp16", "s.fp16.1x", "m.fp16.1x"])
def test_networks_in_half_precision_are_read_whole(tag: str) -> None:
    library, name = Library(), f"denoise_upscale.{tag}"
    layers = read_layers(library.load(name), library.path(name).parent)
    assert {layer.output for layer in layers} > {"raw_fine", "raw_level1", "raw_level2"}
    for layer in layers:
        launch = choices(layer, 272, 480, HostGpu(warpgroups=True))[0]
        assert launch.groups * launch.held >= min(
            2, launch.squares // 132
        ), "one waits for pixels, another multiplies"
        assert launch.shared <= HostGpu(warpgroups=True).most_shared
        # of GPUs with less
        assert choices(layer, 136, 240, HostGpu(False, most_shared=99 << 10))[0].shared <= 99 << 10
    with pytest.raises(Unfit, match="shared memory"):
        choices(max(layers, key=lambda layer: layer.read * layer.taps), 136, 240,
                HostGpu(True, most_shared=16 << 10))


def _sigmoid(graph: onnx.GraphProto) -> None:
    graph.node[2].op_type = "Sigmoid"


def _linear(graph: onnx.GraphProto) -> None:
    graph.node[8].attribute[0].s = b"linear"


def _dilated(graph: onnx.GraphProto) -> None:
    graph.node[4].attribute.append(helper.make_attribute("dilations", [2, 2]))


def _odd(graph: onnx.GraphProto) -> None:
    for weights in graph.initializer:
        if weights.name.startswith("fine first"):
            weights.CopyFrom(numpy_helper.from_array(numpy_helper.to_array(weights)[:40],
                                                     weights.name))


def _channels_first(graph: onnx.GraphProto) -> None:
    """The head of the level keeps its channels first."""
    graph.node[-2].output[0] = "level"
    del graph.node[-1]


@pytest.mark.parametrize("change", [_sigmoid, _linear, _dilated, _odd, _channels_first])
def test_other_networks_stay_with_onnx_runtime(change: Callable[[onnx.GraphProto], None]) -> None:
    with pytest.raises(Unfit):
        read_layers(make_network(change), Path())


@pytest.mark.gpu
@pytest.mark.skipif(cuda_fault(0) is not None, reason="needs a GPU")
@pytest.mark.parametrize("tag", ["s.fp16", "m.fp16", "l.fp16", "xl.fp16"])
def test_a_gpu_computes_what_onnx_runtime_does_there(tag: str,
                                                     monkeypatch: pytest.MonkeyPatch) -> None:
    """At 960x544, where all blocks of threads are at work at once; prints both times."""
    packed, results, times = RANDOM.random((1, 544, 960, 40)).astype(np.float16), [], []
    for own in (False, True):
        monkeypatch.setattr(CudaMemory, "convolves", own)
        device = Device("cuda")
        state = device.pipeline_state(Library(), f"denoise_upscale.{tag}",
                                      {"height": 544, "width": 960})
        tensors = {binding.name: device.heap.tensor(binding.name, state.shapes[binding.name],
                                                    binding.dtype)
                   for binding in state.bindings}
        tensors["packed_features"].upload(packed)
        commands, took = device.command_buffer("network"), []
        with commands.machine_learning_encoder("network") as encoder:
            encoder.dispatch_network(state, ArgumentTable(state, tensors))
        for _ in range(30):
            commands.commit()
            commands.wait(timeout=60)
            took.append(commands.timings[0][1])
        times.append(sorted(took[5:])[12])
        results.append({name: tensor.download() for name, tensor in tensors.items()})
    print(f"{tag}: ONNX Runtime {times[0]:.3f} ms, own kernels {times[1]:.3f} ms")
    theirs, ours = results
    for name, value in ours.items():
        wanted = theirs[name].astype(np.float32)
        assert np.abs(value - wanted).max() < 0.01 * np.abs(wanted).max(), name
