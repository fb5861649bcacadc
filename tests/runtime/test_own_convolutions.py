"""Convolutions of 3x3 pixels that a CPU computes by tiles, against ONNX Runtime's own."""

from __future__ import annotations

from collections.abc import Callable
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
    """The output of a network that reads one image."""
    (found,) = run_all(model, {"image": image}, level, threads)
    return found


def run_all(model: bytes, inputs: dict[str, np.ndarray], level: str | None = None,
            threads: int = 2) -> list[np.ndarray]:
    """The outputs of a network, by our operators for a level of the processor."""
    options = ort.SessionOptions()
    options.intra_op_num_threads = threads
    if has_own_convolutions(model):
        library = open_library(REGISTER, None, level)._name if level else operators_library()
        options.register_custom_ops_library(str(library))
    session = ort.InferenceSession(model, options, providers=["CPUExecutionProvider"])
    found: list[np.ndarray] = session.run(None, inputs)
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


class Drawing:
    """A network that is put together node by node, of random weights."""

    def __init__(self) -> None:
        self.random = np.random.default_rng(5)
        self.nodes: list[Any] = []
        self.weights: list[Any] = []
        self.inputs: dict[str, np.ndarray] = {}

    def picture(self, name: str, channels: int, height: int, width: int) -> str:
        self.inputs[name] = self.random.normal(size=(1, channels, height, width)).astype("f4")
        return name

    def weight(self, name: str, values: np.ndarray) -> str:
        self.weights.append(numpy_helper.from_array(values.astype(np.float32), name))
        return name

    def node(self, operator: str, *reads: str, **attributes: Any) -> str:
        name = f"{operator}{len(self.nodes)}"
        self.nodes.append(helper.make_node(operator, reads, [name], **attributes))
        return name

    def convolved(self, name: str, channels: int, results: int, bias: bool = True) -> str:
        number = len(self.nodes)
        draw = self.random.normal(0, 1 / (3 * channels**0.5), (results, channels, 3, 3))
        reads = [name, self.weight(f"weight{number}", draw)]
        if bias:
            reads.append(self.weight(f"bias{number}", self.random.normal(size=results)))
        return self.node("Conv", *reads, kernel_shape=[3, 3], pads=[1, 1, 1, 1])

    def enlarged(self, name: str, times: float = 2, nearest: str = "floor") -> str:
        scales = self.weight(f"scales{len(self.nodes)}", np.array([1, 1, times, times]))
        return self.node("Resize", name, "", scales, mode="nearest", nearest_mode=nearest,
                         coordinate_transformation_mode="asymmetric")

    def model(self, *results: str) -> bytes:
        shapes = [helper.make_tensor_value_info(name, TensorProto.FLOAT, array.shape)
                  for name, array in self.inputs.items()]
        outs = [helper.make_tensor_value_info(name, TensorProto.FLOAT, None) for name in results]
        graph = helper.make_graph(self.nodes, "drawn", shapes, outs, self.weights)
        made = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
        return bytes(made.SerializeToString())


def of_several_pictures(drawing: Drawing, height: int, width: int) -> str:
    pictures = [drawing.picture(f"p{count}", count, height, width) for count in (3, 1, 5)]
    joined = drawing.node("Concat", *pictures, axis=1)
    return drawing.node("Relu", drawing.convolved(joined, 9, 7))


def of_a_smaller_picture(drawing: Drawing, height: int, width: int) -> str:
    small = drawing.picture("small", 4, height, width)
    large = drawing.picture("large", 3, 2 * height, 2 * width)
    joined = drawing.node("Concat", drawing.enlarged(small), large, axis=1)
    return drawing.convolved(joined, 7, 9)


def of_added_convolutions(drawing: Drawing, height: int, width: int) -> str:
    small = drawing.picture("small", 4, height, width)
    one, two = (drawing.picture(name, count, 2 * height, 2 * width)
                for name, count in (("one", 2), ("two", 6)))
    first = drawing.node("Add", drawing.convolved(one, 2, 5),
                         drawing.convolved(drawing.enlarged(small), 4, 5, bias=False))
    return drawing.node("Relu", drawing.node("Add", first, drawing.convolved(two, 6, 5)))


@pytest.mark.parametrize("size", [(1, 1), (2, 3), (19, 65), (5, 131)])
@pytest.mark.parametrize("draw", [of_several_pictures, of_a_smaller_picture,
                                  of_added_convolutions])
def test_one_convolution_joins_enlarges_and_adds(
    draw: Callable[[Drawing, int, int], str], size: tuple[int, int]
) -> None:
    drawing = Drawing()
    model = drawing.model(draw(drawing, *size))
    own = with_own_convolutions(model)
    assert len(onnx.load_from_string(own).graph.node) == 1
    (wanted,), (found,) = (run_all(one, drawing.inputs) for one in (model, own))
    np.testing.assert_allclose(found, wanted, atol=2e-5 * max(np.abs(wanted).max(), 1))


@pytest.mark.parametrize("size", [(1, 1), (3, 5), (2, 40), (40, 2), (37, 130)])
@pytest.mark.parametrize("window", [(1, 3), (3, 1), (1, 15), (15, 1)])
def test_means_of_windows_are_those_of_the_network(size: tuple[int, int],
                                                   window: tuple[int, int]) -> None:
    drawing = Drawing()
    picture = drawing.picture("picture", 3, *size)
    model = drawing.model(averaged(drawing, picture, window),
                          drawing.convolved(picture, 3, 2))
    own = with_own_convolutions(model)
    assert {node.op_type for node in onnx.load_from_string(own).graph.node} == {"WindowMean",
                                                                                "Convolve3x3"}
    for wanted, found in zip(run_all(model, drawing.inputs), run_all(own, drawing.inputs),
                             strict=True):
        np.testing.assert_allclose(found, wanted, atol=1e-5)


def averaged(drawing: Drawing, name: str, window: tuple[int, int], **others: Any) -> str:
    height, width = window
    pads = [height // 2, width // 2, height // 2, width // 2]
    return drawing.node("AveragePool", name, **{
        "kernel_shape": window, "pads": pads, "strides": [1, 1], "count_include_pad": 0, **others})


@pytest.mark.parametrize(("window", "others"), [
    ((1, 4), {"pads": [0, 2, 0, 1]}), ((3, 3), {}), ((1, 3), {"count_include_pad": 1}),
    ((1, 3), {"strides": [1, 2]}), ((3, 1), {"pads": [0, 0, 0, 0]})])
def test_other_means_stay_as_they_are(window: tuple[int, int], others: dict[str, Any]) -> None:
    drawing = Drawing()
    picture = drawing.picture("picture", 3, 12, 10)
    model = drawing.model(averaged(drawing, picture, window, **others),
                          drawing.convolved(picture, 3, 2))
    own = onnx.load_from_string(with_own_convolutions(model))
    assert [node.op_type for node in own.graph.node] == ["AveragePool", "Convolve3x3"]


def test_means_along_one_axis_alone_stay_as_they_are() -> None:
    """Those of a signal, which has no columns."""
    drawing = Drawing()
    drawing.inputs["signal"] = drawing.random.normal(size=(1, 3, 20)).astype("f4")
    mean = drawing.node("AveragePool", "signal", kernel_shape=[3], pads=[1, 1])
    model = drawing.model(mean, drawing.convolved(drawing.picture("picture", 3, 6, 8), 3, 2))
    own = onnx.load_from_string(with_own_convolutions(model))
    assert [node.op_type for node in own.graph.node] == ["AveragePool", "Convolve3x3"]


def with_a_joined_picture_that_others_read(drawing: Drawing) -> list[str]:
    joined = drawing.node("Concat", drawing.picture("a", 2, 6, 8), drawing.picture("b", 3, 6, 8),
                          axis=1)
    return [drawing.convolved(joined, 5, 4), drawing.node("Abs", joined)]


def with_an_enlarged_picture_alone(drawing: Drawing) -> list[str]:
    return [drawing.convolved(drawing.enlarged(drawing.picture("a", 2, 6, 8)), 2, 4)]


def with_a_picture_of_a_third(drawing: Drawing) -> list[str]:
    large = drawing.picture("large", 3, 18, 24)
    small = drawing.enlarged(drawing.picture("small", 2, 6, 8), times=3)
    return [drawing.convolved(drawing.node("Concat", small, large, axis=1), 5, 4)]


def with_a_sum_that_others_read(drawing: Drawing) -> list[str]:
    first = drawing.convolved(drawing.picture("a", 2, 6, 8), 2, 4)
    return [drawing.node("Add", first, drawing.convolved(drawing.picture("b", 3, 6, 8), 3, 4)),
            drawing.node("Relu", first)]


def with_sums_of_other_numbers_of_channels(drawing: Drawing) -> list[str]:
    three, one = (drawing.convolved(drawing.picture(name, 2, 6, 8), 2, count)
                  for name, count in (("a", 3), ("b", 1)))
    return [drawing.node("Add", three, one)]


def with_pictures_joined_along_rows(drawing: Drawing) -> list[str]:
    joined = drawing.node("Concat", drawing.picture("a", 2, 6, 8), drawing.picture("b", 2, 6, 8),
                          axis=2)
    return [drawing.convolved(joined, 2, 4)]


def with_more_convolutions_than_one_adds(drawing: Drawing) -> list[str]:
    result = drawing.convolved(drawing.picture("p0", 1, 6, 8), 1, 4)
    for number in range(1, 5):
        next_one = drawing.convolved(drawing.picture(f"p{number}", 1, 6, 8), 1, 4)
        result = drawing.node("Add", result, next_one)
    return [result]


def with_more_pictures_than_one_reads(drawing: Drawing) -> list[str]:
    pictures = [drawing.picture(f"p{number}", 1, 6, 8) for number in range(6)]
    return [drawing.convolved(drawing.node("Concat", *pictures, axis=1), 6, 4)]


@pytest.mark.parametrize("draw", [
    with_a_joined_picture_that_others_read, with_an_enlarged_picture_alone,
    with_a_picture_of_a_third, with_a_sum_that_others_read, with_pictures_joined_along_rows,
    with_sums_of_other_numbers_of_channels,
    with_more_convolutions_than_one_adds, with_more_pictures_than_one_reads])
def test_results_stay_where_less_can_be_joined(draw: Callable[[Drawing], list[str]]) -> None:
    drawing = Drawing()
    model = drawing.model(*draw(drawing))
    own = with_own_convolutions(model)
    assert has_own_convolutions(own)
    for wanted, found in zip(run_all(model, drawing.inputs), run_all(own, drawing.inputs),
                             strict=True):
        np.testing.assert_allclose(found, wanted, atol=2e-5 * np.abs(wanted).max())


def test_levels_with_fused_products_give_the_same_bits() -> None:
    """Those that have them all add products in the same order."""
    own, image = with_own_convolutions(network(33, 25)), picture(33, 37, 130)
    first, *others = (run(own, image, level) for level in levels() if level != "baseline")
    for other in others:
        np.testing.assert_array_equal(first, other)


def test_levels_with_fused_products_join_and_add_the_same_bits() -> None:
    drawing = Drawing()
    sums = of_added_convolutions(drawing, 19, 65)
    mean = averaged(drawing, "one", (1, 15))
    own = with_own_convolutions(drawing.model(sums, mean))
    first, *others = (run_all(own, drawing.inputs, level) for level in levels()
                      if level != "baseline")
    for other in others:
        for wanted, found in zip(first, other, strict=True):
            np.testing.assert_array_equal(wanted, found)


@pytest.mark.parametrize("relu", [False, True])
@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_results_that_are_not_finite_are_none_of_ours_either(bad: float, relu: bool) -> None:
    """All results of a tile may be NaN then."""
    model, image = network(4, 7, relu=relu), picture(4, 19, 23)
    image[0, 2, 9, 11] = bad
    wanted, found = (run(one, image) for one in (model, with_own_convolutions(model)))
    lost = ~np.isfinite(wanted)
    assert lost.any() and not np.isfinite(found[lost]).any()


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
