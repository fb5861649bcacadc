"""Networks that give the picture, with convolutions in half precision."""

from __future__ import annotations

from functools import cache

import numpy as np
import onnx
import onnxruntime
import pytest
from onnx import TensorProto, helper, numpy_helper

torch = pytest.importorskip("torch")

from postfx.system import models_dir  # noqa: E402
from training.denoise import fp16  # noqa: E402
from training.denoise.fp16_picture import (  # noqa: E402
    CHANNEL_STEP,
    halve_picture,
    transposed_weight,
)
from training.export import lower_constants  # noqa: E402

SHIPPED = ("l.1x", "xl.1x")


@cache
def whole(tag: str) -> onnx.ModelProto:
    return lower_constants(onnx.load(models_dir() / f"denoise_upscale.{tag}.onnx"))


@cache
def half(tag: str) -> onnx.ModelProto:
    return halve_picture(whole(tag))


@pytest.mark.parametrize("tag", SHIPPED)
def test_it_is_the_same_network(tag: str) -> None:
    """As far as a CPU can tell, which computes in float32 and rounds what lies between nodes."""
    assert 0 < fp16.difference(half(tag), whole(tag)) < fp16.TOLERANCE


@pytest.mark.parametrize("tag", SHIPPED)
def test_inputs_and_outputs_stay(tag: str) -> None:
    for name in ("input", "output"):
        assert list(getattr(half(tag).graph, name)) == list(getattr(whole(tag).graph, name))


@pytest.mark.parametrize("tag", SHIPPED)
def test_convolutions_fit_tensor_cores(tag: str) -> None:
    graph = half(tag).graph
    weights = {weight.name: weight for weight in graph.initializer}
    found = [weights[node.input[1]] for node in graph.node
             if node.op_type in ("Conv", "ConvTranspose")]
    assert {weight.data_type for weight in found} == {TensorProto.FLOAT16}
    assert not [weight.name for weight in found
                if weight.dims[0] % CHANNEL_STEP or weight.dims[1] % CHANNEL_STEP]
    assert "ConvTranspose" in {node.op_type for node in graph.node}


@pytest.mark.parametrize("tag", SHIPPED)
def test_most_weights_are_those_of_the_float_network(tag: str) -> None:
    """So the variant's file refers to them."""
    known = {bytes(weight.raw_data) for weight in whole(tag).graph.initializer}
    sizes = {True: 0, False: 0}
    for weight in half(tag).graph.initializer:
        sizes[bytes(weight.raw_data) in known] += len(weight.raw_data)
    assert sizes[True] > 0.4 * sum(sizes.values())


def test_a_transposed_convolution_reads_what_was_not_enlarged() -> None:
    torch.manual_seed(1)
    coarse, weight = torch.randn(1, 3, 5, 6), torch.randn(4, 3, 3, 3)
    enlarged = torch.nn.functional.interpolate(coarse, scale_factor=2.0, mode="nearest")
    wanted = torch.nn.functional.conv2d(enlarged, weight, padding=1)
    transposed = torch.from_numpy(transposed_weight(weight.numpy()))
    found = torch.nn.functional.conv_transpose2d(coarse, transposed, stride=2, padding=1)
    torch.testing.assert_close(found, wanted, rtol=1e-5, atol=1e-5)


def planes(name: str, channels: int) -> onnx.ValueInfoProto:
    return helper.make_tensor_value_info(name, TensorProto.FLOAT, [1, channels, 16, 16])


def model_of(nodes: list[onnx.NodeProto], channels: int, **weights: np.ndarray) -> onnx.ModelProto:
    """A network of 3 planes and so many of the picture."""
    graph = helper.make_graph(nodes, "small", [planes("first_features", 3)],
                              [planes("picture", channels)],
                              [numpy_helper.from_array(weight.astype(np.float32), name)
                               for name, weight in weights.items()])
    return helper.make_model(graph, opset_imports=[helper.make_opsetid("", 20)], ir_version=10)


def run(model: onnx.ModelProto, reads: dict[str, np.ndarray]) -> np.ndarray:
    session = onnxruntime.InferenceSession(model.SerializeToString(),
                                           providers=["CPUExecutionProvider"])
    return session.run(["picture"], reads)[0]


def test_what_else_is_added_to_a_convolution_stays() -> None:
    """A sum with planes is no sum of convolutions."""
    random = np.random.default_rng(3)
    nodes = [
        helper.make_node("Conv", ["first_features", "weight"], ["seen"], pads=[1] * 4),
        helper.make_node("Add", ["first_features", "seen"], ["picture"]),
    ]
    model = model_of(nodes, 3, weight=random.random((3, 3, 3, 3)) - 0.5)
    made = halve_picture(model)
    assert "Add" in {node.op_type for node in made.graph.node}
    reads = {"first_features": random.random((1, 3, 16, 16), np.float32)}
    found, wanted = (run(one, reads) for one in (made, model))
    np.testing.assert_allclose(found, wanted, atol=3e-3)


def test_narrow_convolutions_of_the_same_planes_are_one() -> None:
    random = np.random.default_rng(4)
    nodes = [
        helper.make_node("Conv", ["first_features", f"weight{k}"], [f"seen{k}"], pads=[1] * 4)
        for k in (1, 2)]
    nodes.append(helper.make_node("Mul", ["seen1", "seen2"], ["picture"]))
    model = model_of(nodes, 2, weight1=random.random((2, 3, 3, 3)),
                     weight2=random.random((2, 3, 3, 3)))
    made = halve_picture(model)
    assert [node.op_type for node in made.graph.node].count("Conv") == 1
    reads = {"first_features": random.random((1, 3, 16, 16), np.float32)}
    found, wanted = (run(one, reads) for one in (made, model))
    np.testing.assert_allclose(found, wanted, rtol=5e-3)
