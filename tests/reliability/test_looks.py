"""Looks of the user's own (`--tonemap FILE.onnx`) that are damaged or mean harm: one line, and no
memory touched."""

import json

import numpy as np
import pytest
from onnx import TensorProto, helper, numpy_helper

from postfx.frame import FrameSpec, Role
from postfx.passes.tonemap import ToneMap
from postfx.runtime import Device, ModelError
from tests.toys import value

SPEC = FrameSpec(8, 6, [Role.COLOUR])
SHAPER = {"toe": 0.01, "scale": 0.1, "matrix": [1, 0, 0, 0, 1, 0, 0, 0, 1]}
GRID = (1, 16, 16, 8, 12)


@pytest.fixture(scope="module")
def device():
    return Device("cpu", threads=1)


@pytest.fixture
def refused(tmp_path, device):
    """Compiles the pass with a model and gives the one line with which it is refused."""
    def load(nodes, weights, inputs=(), outputs=("cube",), card=None, constant=("cube", "guide")):
        declared = [value(name,
                          (3, 3, 3, 3) if name == "cube" else GRID if name == "grid" else (112,))
                    for name in outputs]
        for item in declared:
            item.type.tensor_type.ClearField("shape")
        graph = helper.make_graph(nodes, "look", list(inputs), declared,
                                  [numpy_helper.from_array(array, name)
                                   for name, array in weights.items()])
        model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 20)], ir_version=10)
        (tmp_path / "bad.onnx").write_bytes(model.SerializeToString())
        marked = {name: {"constant": name in constant} for name in outputs}
        (tmp_path / "bad.json").write_text(json.dumps({"shaper": SHAPER, "outputs": marked,
                                                       **(card or {})}))
        with pytest.raises(ModelError) as caught:
            ToneMap(look=str(tmp_path / "bad.onnx")).compile(device, SPEC)
        assert "\n" not in str(caught.value) and "bad" in str(caught.value)
        return str(caught.value)

    return load


def cube(shape=(3, 3, 3, 3), content=0.5):
    return {"w": np.full(shape, content, np.float32)}


COPY = [helper.make_node("Identity", ["w"], ["cube"])]


@pytest.mark.parametrize("shape", [(0, 0, 0, 3), (1, 1, 1, 3), (1,), (3, 3), ()])
def test_cube_that_is_too_small(refused, shape):
    """Kernels look up without checking bounds, and take four corners of a cube."""
    assert "its cube is" in refused(COPY, cube(shape))


@pytest.mark.parametrize("content", [np.nan, np.inf, -np.inf, 1e30])
def test_cube_of_numbers_that_cannot_be(refused, content):
    assert "NaN or numbers beyond 1e+06" in refused(COPY, cube(content=content))


def test_outputs_that_no_look_has(refused):
    node = helper.make_node("Identity", ["w"], ["other"])
    assert "marks other as constant, not cube" in refused([node], cube(), outputs=("other",),
                                                          constant=("other",))
    assert "marks no output as constant, not cube" in refused(COPY, cube(), constant=())


@pytest.mark.parametrize(("name", "content"), [
    ("toe", "abc"), ("toe", None), ("toe", [1]), ("toe", 0), ("toe", -1), ("toe", float("nan")),
    ("scale", float("inf")), ("matrix", "x"), ("matrix", [1] * 8),
    ("matrix", [[1], [2, 3]]), ("matrix", [1e400] * 9), ("matrix", {"a": 1}),
    ("matrix", [None] * 9)])
def test_card_with_a_shaper_that_cannot_be(refused, name, content):
    assert "toe and scale above 0, and a matrix of 9 numbers" in refused(
        COPY, cube(), card={"shaper": {**SHAPER, name: content}})


@pytest.mark.parametrize("shaper", [None, [], 7, {}])
def test_card_without_a_shaper(refused, shaper):
    assert "gives no shaper" in refused(COPY, cube(), card={"shaper": shaper})


@pytest.mark.parametrize("keep", [1, -0.1, float("nan"), "x", None, True])
def test_card_that_keeps_what_cannot_be(refused, keep):
    assert "of the last grid, not 0 to below 1" in refused(COPY, cube(),
                                                           card={"shaper": SHAPER, "keep": keep})


@pytest.mark.parametrize("follow", [1.1, -0.1, float("nan"), "x", None, True])
def test_card_that_follows_what_cannot_be(refused, follow):
    card = {"shaper": SHAPER, "follow": follow}
    assert "of a change of light, not 0 to 1" in refused(COPY, cube(), card=card)


def sized_by(operator):
    """Nodes that make 2^40 elements and more of a few, step by step or by an operator's own
    arithmetic."""
    if operator == "Concat":
        start = helper.make_node("ReduceMax", ["lowres"], ["s0"])
        return [start, *(helper.make_node("Concat", [f"s{i}"] * 4096, [f"s{i + 1}"], axis=0)
                         for i in range(3))], "s3"
    attributes = {"strides": [1 << 15, 1 << 15]} if operator == "ConvTranspose" else {}
    return [helper.make_node(operator, MAKERS[operator], ["big"], **attributes)], "big"


MAKERS = {"Pad": ["lowres", "pads"], "Range": ["zero", "huge", "one"],
          "OneHot": ["indices", "huge", "pair"],
          "CenterCropPad": ["lowres", "shape"], "ConvTranspose": ["lowres", "kernel"],
          "Resize": ["lowres", "", "scales"]}
INGREDIENTS = {
    "pads": np.array([0, 0, 0, 0, 0, 0, 1 << 20, 1 << 20]), "zero": np.array(0), "one": np.array(1),
    "huge": np.array(1 << 40), "indices": np.arange(4), "pair": np.float32([0, 1]),
    "shape": np.array([1, 3, 1 << 20, 1 << 20]), "kernel": np.ones((3, 1, 1, 1), np.float32),
    "scales": np.float32([1, 1, 5000, 5000]),
}


@pytest.mark.parametrize("operator", [*MAKERS, "Concat"])
def test_little_that_makes_more_than_the_machine_has(refused, operator):
    """What no look at the file tells: ONNX Runtime gets no more memory than the machine has, and
    says so."""
    nodes, big = sized_by(operator)
    nodes += [helper.make_node("Cast", [big], ["floats"], to=TensorProto.FLOAT),
              helper.make_node("ReduceMax", ["floats"], ["one number"], keepdims=0),
              helper.make_node("Mul", ["one number", "w"], ["cube"])]
    used = {name: INGREDIENTS[name] for name in MAKERS.get(operator, ()) if name in INGREDIENTS}
    told = refused(nodes, cube() | used, inputs=[value("lowres", (1, 3, 256, 256))])
    assert "model 'bad' cannot be" in told


def test_a_look_that_has_lost_its_card(tmp_path):
    (tmp_path / "mine.onnx").write_bytes(b"")
    with pytest.raises(ModelError, match="its card mine.json is not beside it: copy both files"):
        ToneMap(look=str(tmp_path / "mine.onnx"))
