"""The graph of an ONNX file in plain types."""

import json
import sys

import numpy as np
import pytest
from onnx import helper

from postfx.runtime.capture import MISSING
from postfx.tools.report.networks import describe
from tests import toys
from tests.deep import make_deep

DIMS = {"height": 4, "width": 5}


@pytest.fixture
def deep(tmp_path):
    return make_deep(tmp_path).path("deep")


def test_nodes_have_attributes_weights_and_blocks(deep):
    found = describe(deep, DIMS)
    assert (found["name"], found["note"], found["dims"]) == ("deep", None, DIMS)
    assert (found["inputs"], found["outputs"]) == (["x"], ["y"])
    assert found["blocks"] == [[0, 1, 2], [3, 4], [5]]
    cast, conv, _, below, *_ = found["nodes"]
    assert (cast["op"], cast["constant"], cast["attributes"]) == ("Cast", True, {"to": 1})
    assert (conv == {
        "op": "Conv", "domain": "", "name": "first",
        "attributes": {"kernel_shape": [3, 3], "pads": [1, 1, 1, 1]},
        "inputs": ["x", "stem.weight"], "outputs": ["conv"], "constant": False,
        "weights": ["stem.weight_half"],
    })  # fmt: skip
    assert below["weights"] == ["level"]
    json.dumps(found, allow_nan=False)


def test_shapes_follow_from_the_dimensions(deep):
    values = describe(deep, DIMS)["values"]
    assert {name: values[name]["shape"] for name in ("x", "conv", "y")} == {
        "x": [1, 2, 4, 5], "conv": [1, 4, 4, 5], "y": [1, 4, 4, 5],
    }  # fmt: skip
    assert values["root"]["dtype"] == "float32"


def test_weights_have_type_shape_bytes_and_range(tmp_path):
    weight = np.linspace(-1, 2, 24, dtype=np.float32)
    weight[3] = np.nan
    add = helper.make_node("Add", ["x", "w"], ["y"])
    toys.save_model(tmp_path / "add.onnx", [add], [toys.value("x", (24,))],
                    [toys.value("y", (24,))], {"w": weight})
    (found,) = describe(tmp_path / "add.onnx", {})["weights"].values()
    assert (found["dtype"], found["shape"], found["bytes"]) == ("float32", [24], 96)
    assert (found["statistics"]["minimum"], found["statistics"]["maximum"],
            found["statistics"]["nans"]) == (-1, 2, 1)
    assert "values" not in found
    level = describe(make_deep(tmp_path).path("deep"), DIMS)["weights"]["level"]
    assert (level["shape"], level["values"]) == ([1], [0.5])


def test_what_cannot_be_described_says_why(deep, tmp_path, monkeypatch):
    (tmp_path / "bad.onnx").write_bytes(b"\x08no model")
    found = describe(tmp_path / "bad.onnx", {})
    assert "cannot be read" in found["note"] and found["nodes"] == []
    monkeypatch.setitem(sys.modules, "onnx", None)
    assert describe(deep, DIMS)["note"] == MISSING
