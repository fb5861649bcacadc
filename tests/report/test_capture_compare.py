"""Two captures compared: equal ones, the first difference, and captures that do not correspond."""

import json

import numpy as np
import pytest

from postfx.cli.capture_compare import text_of
from postfx.errors import CompareError
from postfx.runtime.capture import largest_error
from postfx.tools.report.capture_data import compare
from postfx.tools.report.page import write_capture
from tests.deep import LEVEL, capture_deep, make_deep


@pytest.fixture
def captured(make_capture, tmp_path):
    def make(folder, **options):
        folder = tmp_path / folder
        write_capture(make_capture(tensors="all", folder=folder, **options), folder, "toy")
        return folder

    return make


def test_equal_captures(captured):
    found = compare(captured("a"), captured("b"), tolerance=0.0)
    assert found.first is None
    rows = [(row.index, row.access, row.tensor, row.error) for row in found.differences]
    assert rows == [(0, "input", "a", 0), (0, "input", "b", 0), (0, "write", "total", 0),
                    (1, "write", "y", 0)]


def test_the_first_difference_is_named(captured):
    found = compare(captured("a", a=1.1), captured("b"))
    assert (found.first.access, found.first.tensor) == ("input", "a")
    assert found.first.error == pytest.approx(0.1, rel=1e-4)
    assert compare(captured("c", a=1.1), captured("d"), tolerance=0.2).first is None


def test_a_difference_inside(captured):
    a, b = captured("a"), captured("b")
    file, = a.glob("tensors/*/0001.0.y.npy")
    changed = np.load(file)
    changed[0, 2, 3] = np.nan
    np.save(file, changed)
    found = compare(a, b)
    assert (found.first.label, found.first.tensor, found.first.place) == ("toy/double", "y",
                                                                          (0, 2, 3))
    assert found.first.error == float("inf")
    assert json.loads(json.dumps(found.as_dict(), allow_nan=False))["first"]["error"] == "inf"


def test_captures_of_other_commands_or_tensors(captured, tmp_path):
    a, b = captured("a"), captured("b", name="other")
    with pytest.raises(CompareError, match="command 0 'toy/add' writes other tensors"):
        compare(a, b)
    data = json.loads((b / "capture.json").read_text())
    (b / "capture.json").write_text(json.dumps({**data, "commands": data["commands"][:1]}))
    with pytest.raises(CompareError, match="have 2 and 1 commands"):
        compare(a, b)


def test_captures_without_content(captured, make_capture, tmp_path):
    write_capture(make_capture(), tmp_path / "small", "toy")
    with pytest.raises(CompareError, match="no content of tensor 'total': make it with"):
        compare(captured("a"), tmp_path / "small")


@pytest.fixture
def looked_into(tmp_path):
    """Captures of the network 'deep' with its nodes."""

    def make(name, level=LEVEL, x=1.0, network=True):
        library = make_deep(tmp_path / f"models {name}", level)
        capture, _ = capture_deep(library, x, tensors="all", folder=tmp_path / name,
                                  network=network)
        write_capture(capture, tmp_path / name, "toy")
        return tmp_path / name

    return make


def test_the_first_node_that_differs_is_named(looked_into):
    found = compare(looked_into("a", level=0.6), looked_into("b"))
    assert (found.first.access, found.first.tensor, found.first.node) == ("node", "above",
                                                                          "node 3 Sub")
    rows = [(row.access, row.tensor, row.error > 0) for row in found.differences]
    assert (rows == [
        ("input", "picture", False), ("node", "conv", False), ("node", "relu", False),
        ("node", "above", True), ("node", "root", True), ("node", "y", True), ("write", "y", True),
    ])  # fmt: skip
    assert "written by node 3 Sub of command 0 'deep' (network 'deep')" in text_of(found)
    assert json.loads(json.dumps(found.as_dict()))["first"]["node"] == "node 3 Sub"


def test_without_nodes_in_both_the_command_is_named(looked_into):
    found = compare(looked_into("a", level=0.6), looked_into("b", network=False))
    assert (found.first.access, found.first.node) == ("write", None)


def test_captures_of_other_nodes(looked_into):
    a, b = looked_into("a"), looked_into("b")
    data = json.loads((b / "capture.json").read_text())
    data["commands"][0]["network"]["nodes"].pop()
    (b / "capture.json").write_text(json.dumps(data))
    with pytest.raises(CompareError, match="command 0 'deep' has other nodes in the other capture"):
        compare(a, b)


def test_the_measure():
    b = np.array([100.0, 0.0, 2.0, np.inf, np.nan])
    assert largest_error(b.copy(), b) == (0.0, (0,))
    a = np.array([100.0, 0.0, 3.0, np.inf, np.nan])
    assert largest_error(a, b) == (pytest.approx(1 / 34), (2,))
    assert largest_error(np.array([1.0, 0.0, 2.0, -np.inf, np.nan]), b) == (np.inf, (3,))
    assert largest_error(np.array([1e-9]), np.array([0.0])) == (np.inf, (0,))
    assert largest_error(np.array([1.001], np.float16), np.array([1.0], np.float32))[0] < 1.1e-3
