"""Integer products at the end of a network that are left to the caller."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from postfx.compiled.library import has_byte_products
from postfx.runtime import ArgumentTable, Device, Library, PipelineState
from postfx.runtime.model_file import take_products

onnx = pytest.importorskip("onnx")

from onnx import TensorProto, helper, numpy_helper  # noqa: E402

Draw = Callable[[np.random.Generator, tuple[int, ...]], np.ndarray]


def made(sign: int = 128, zero: int = -128, last: str = "Cast", channels: int = 8,
         wider: int = 0) -> bytes:
    """A model: the codes (1, C, h, w) of its input, and their products with 3 rows of factors."""
    factors = np.random.default_rng(0).integers(0, 128, (3, channels)).astype(np.uint8)
    factors[0, 0] += wider
    held = {"factors": factors, "middle": np.uint8(64), "zero": np.int8(zero),
            "sign": np.uint8(sign), "flat": np.array([channels, -1])}
    nodes = [helper.make_node("MaxPool", ["x"], ["codes"], kernel_shape=[1, 1]),
             helper.make_node("Reshape", ["codes", "flat"], ["line"]),
             helper.make_node("BitwiseXor", ["line", "sign"], ["turned"]),
             helper.make_node(last, ["turned"], ["signed"],
                              **({"to": TensorProto.INT8} if last == "Cast" else {})),
             helper.make_node("MatMulInteger", ["factors", "signed", "middle", "zero"],
                              ["products_fine"])]
    graph = helper.make_graph(
        nodes, "graph",
        [helper.make_tensor_value_info("x", TensorProto.UINT8, [1, channels, 2, 3])],
        [helper.make_tensor_value_info("products_fine", TensorProto.INT32, [3, 6])],
        [numpy_helper.from_array(np.asarray(value), name) for name, value in held.items()])
    content: bytes = (helper.make_model(graph, opset_imports=[helper.make_opsetid("", 20)])
                      .SerializeToString())
    return content


def test_a_product_becomes_its_codes_and_factors() -> None:
    content, products = take_products(made())
    onnx.checker.check_model(onnx.load_from_string(content), full_check=True)
    assert [value.name for value in onnx.load_from_string(content).graph.output] == ["codes_fine"]
    assert products["products_fine"].codes == "codes_fine"
    assert np.abs(products["products_fine"].factors).max() <= 64


@pytest.mark.parametrize("change", [
    {"sign": 64}, {"zero": 0}, {"last": "Identity"}, {"channels": 6}, {"wider": 255 - 127}])
def test_other_products_stay_as_they_are(change: dict[str, int | str]) -> None:
    """Codes whose zero is not 0, another way to them, channels that are not whole words, and
    factors that two of which could overflow 16 bits."""
    content = made(**change)  # type: ignore[arg-type]
    assert take_products(content) == (content, {})


@pytest.mark.skipif(not has_byte_products(), reason="needs an x86-64 processor")
@pytest.mark.parametrize("name", ["denoise_upscale.s.int8", "denoise_upscale.m.int8.guides"])
def test_codes_times_factors_are_the_networks_own_products(name: str) -> None:
    device = Device("cpu", threads=2)
    dims = {"height": 32, "width": 48, "ringed_height": 34, "ringed_width": 50}
    whole, split = (device.pipeline_state(Library(), name, dims, own_kernels=codes)
                    for codes in (False, True))
    wanted, found = results(whole), results(split)
    assert split.products.keys() == {key for key in wanted if key.startswith("products_")}
    for output, (codes, factors) in split.products.items():
        lines = found[codes].reshape(-1, factors.shape[1]).astype(np.int32)
        np.testing.assert_array_equal(factors.astype(np.int32) @ lines.T, wanted[output])


def draw_bytes(random: np.random.Generator, shape: tuple[int, ...]) -> np.ndarray:
    return random.integers(0, 256, shape, np.uint8)


def results(state: PipelineState, draw: Draw = draw_bytes) -> dict[str, np.ndarray]:
    """What a network writes for input that is drawn."""
    random, tensors = np.random.default_rng(1), {}
    for binding in state.bindings:
        tensors[binding.name] = state.device.heap.tensor(binding.name, state.shapes[binding.name],
                                                         binding.dtype)
        if binding.reads:
            tensors[binding.name].upload(draw(random, state.shapes[binding.name]))
    commands = state.device.command_buffer("run")
    with commands.machine_learning_encoder("run") as encoder:
        encoder.dispatch_network(state, ArgumentTable(state, tensors))
    commands.commit()
    commands.wait(timeout=60)
    return {binding.name: tensors[binding.name].download()
            for binding in state.bindings if binding.writes}
