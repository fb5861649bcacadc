"""Convolutions of 3x3 pixels that a CPU computes by tiles, against ONNX Runtime's own."""

from __future__ import annotations

from typing import Any

import numpy as np
import onnxruntime as ort
import pytest

onnx = pytest.importorskip("onnx")

from onnx import TensorProto, helper, numpy_helper  # noqa: E402

from postfx.compiled.library import levels, open_library  # noqa: E402
from postfx.runtime import Device, Library, own_convolutions  # noqa: E402
from postfx.runtime.own_convolutions import (  # noqa: E402
    REGISTER,
    has_own_convolutions,
    operators_library,
    with_own_convolutions,
)
from tests.runtime.test_products import results  # noqa: E402

SIZES = ((1, 1), (3, 5), (4, 4), (37, 130), (9, 263))
"""Of pictures: below a tile, whole tiles, several strips, and ends within a tile."""
CHANNELS = ((1, 1), (3, 13), (16, 6), (33, 25))


def network(channels: int, results: int, bias: bool = True, relu: bool = False,
            half: bool = False, **attributes: Any) -> bytes:
    """A network of one convolution of random weights, and perhaps an activation."""
    random = np.random.default_rng(channels)
    weight = random.normal(0, 1 / (3 * channels**0.5), (results, channels, 3, 3))
    stored = weight.astype(np.float16 if half else np.float32)
    weights = [numpy_helper.from_array(stored, "stored" if half else "weight")]
    nodes = [helper.make_node("Cast", ["stored"], ["weight"], to=TensorProto.FLOAT)] * half
    reads = ["image", "weight"]
    if bias:
        reads.append("bias")
        weights.append(numpy_helper.from_array(random.normal(size=results).astype(np.float32),
                                               "bias"))
    given = {"kernel_shape": [3, 3], "pads": [1, 1, 1, 1], **attributes}
    nodes.append(helper.make_node("Conv", reads, ["sums" if relu else "out"], **given))
    if relu:
        nodes.append(helper.make_node("Relu", ["sums"], ["out"]))
    shapes = [helper.make_tensor_value_info(name, TensorProto.FLOAT, [1, count, "h", "w"])
              for name, count in (("image", channels), ("out", results))]
    graph = helper.make_graph(nodes, "one", shapes[:1], shapes[1:], weights)
    made = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    return bytes(made.SerializeToString())


def run(model: bytes, image: np.ndarray, level: str | None = None, threads: int = 2) -> np.ndarray:
    """The output of a network, by our operators for a level of the processor."""
    options = ort.SessionOptions()
    options.intra_op_num_threads = threads
    if has_own_convolutions(model):
        library = open_library(REGISTER, None, level)._name if level else operators_library()
        options.register_custom_ops_library(str(library))
    session = ort.InferenceSession(model, options, providers=["CPUExecutionProvider"])
    found: np.ndarray = session.run(["out"], {"image": image})[0]
    return found


def picture(channels: int, height: int, width: int) -> np.ndarray:
    return np.random.default_rng(7).normal(size=(1, channels, height, width)).astype(np.float32)


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize(("channels", "results"), CHANNELS)
@pytest.mark.parametrize("kind", [{}, {"bias": False}, {"relu": True}, {"half": True}])
def test_sums_by_tiles_are_those_of_the_convolution(size: tuple[int, int], channels: int,
                                                    results: int, kind: dict[str, bool]) -> None:
    model, image = network(channels, results, **kind), picture(channels, *size)
    own = with_own_convolutions(model)
    assert own != model and has_own_convolutions(own)
    wanted = run(model, image)
    np.testing.assert_allclose(run(own, image), wanted, atol=2e-5 * max(np.abs(wanted).max(), 1))
    assert (wanted < 0).any() != kind.get("relu", False) or wanted.size < 9


def test_levels_with_fused_products_give_the_same_bits() -> None:
    """Those that have them all add products in the same order."""
    own, image = with_own_convolutions(network(33, 25)), picture(33, 37, 130)
    first, *others = (run(own, image, level) for level in levels() if level != "baseline")
    for other in others:
        np.testing.assert_array_equal(first, other)


def test_threads_give_the_same_bits() -> None:
    own, image = with_own_convolutions(network(33, 25)), picture(33, 37, 130)
    one, *others = (run(own, image, threads=threads) for threads in (1, 2, 3))
    for other in others:
        np.testing.assert_array_equal(one, other)


def test_the_lowest_level_gives_nearly_the_same() -> None:
    own, image = with_own_convolutions(network(33, 25)), picture(33, 37, 130)
    np.testing.assert_allclose(run(own, image, levels()[0]), run(own, image), atol=5e-5)


@pytest.mark.parametrize("other", [
    {"strides": [2, 2]}, {"pads": [0, 0, 0, 0]}, {"dilations": [2, 2], "pads": [2, 2, 2, 2]},
    {"auto_pad": "SAME_UPPER", "pads": [1, 1, 1, 1]}])
def test_other_convolutions_stay_as_they_are(other: dict[str, Any]) -> None:
    model = network(8, 8, **other)
    assert with_own_convolutions(model) == model


def test_several_images_are_refused() -> None:
    """The denoiser's networks read one; the others would stay as memory was."""
    model = onnx.load_from_string(network(3, 4))
    for value in (*model.graph.input, *model.graph.output):
        value.type.tensor_type.shape.dim[0].dim_param = "images"
    image = picture(3, 8, 8).repeat(2, axis=0)
    assert run(model.SerializeToString(), image).shape == (2, 4, 8, 8)
    with pytest.raises(Exception, match="a convolution of several images"):
        run(with_own_convolutions(model.SerializeToString()), image)


def test_networks_in_integers_stay_as_they_are() -> None:
    model = onnx.load_from_string(network(8, 8))
    model.graph.node.insert(0, helper.make_node("DequantizeLinear", ["codes", "step"], ["light"]))
    content = model.SerializeToString()
    assert with_own_convolutions(content) == content


def test_a_result_that_others_read_is_not_rectified() -> None:
    """The activation is joined only where nobody reads what is before it."""
    model = onnx.load_from_string(network(8, 8, relu=True))
    model.graph.output.append(helper.make_tensor_value_info("sums", TensorProto.FLOAT, None))
    own = onnx.load_from_string(with_own_convolutions(model.SerializeToString()))
    assert [node.op_type for node in own.graph.node] == ["Convolve3x3", "Relu"]


def test_without_a_library_networks_stay_as_they_are(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(own_convolutions, "operators_library", lambda: None)
    model = network(8, 8)
    assert with_own_convolutions(model) == model


def test_the_default_gives_the_same_picture_either_way() -> None:
    """To 1e-4 of the largest number."""
    device = Device("cpu", threads=2)
    wanted, found = (results(device.pipeline_state(
        Library(), "denoise_upscale.xl.1x", {"height": 64, "width": 96}, own_kernels=own
    ), draw_light) for own in (False, True))
    for name, numbers in wanted.items():
        np.testing.assert_allclose(found[name], numbers, atol=1e-4 * np.abs(numbers).max())
        assert not np.array_equal(found[name], numbers)


def draw_light(random: np.random.Generator, shape: tuple[int, ...]) -> np.ndarray:
    return random.random(shape, np.float32)
