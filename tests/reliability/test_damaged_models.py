"""Model files that are damaged, or no such files, are refused in one line, before ONNX Runtime sees
them."""

import json
import os
import random
import struct

import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper, numpy_helper

from postfx.runtime import Library, ModelError
from postfx.runtime.model_file import MOST_PARTS, parse_model
from postfx.runtime.models import MOST_MODEL_BYTES, OPERATORS, check_model
from postfx.system import models_dir
from tests.reliability.model_files import model_of, outside


@pytest.mark.parametrize("part", [0, 1, 7, 0.5, 0.99])
def test_truncated_model(refused, part):
    content = model_of(weights=[numpy_helper.from_array(np.ones(64, "f4"),
                                                        "w")]).SerializeToString()
    assert ("is damaged or no ONNX "
            "file" in refused(content[: int(part * len(content)) if part < 1 else part]))


@pytest.mark.parametrize("content", [b"", b"not a model", b"\xff" * 50, b"PK\x03\x04" + bytes(60),
                                     b"\x0b" * 9])
def test_file_that_is_no_model(refused, content):
    assert "is damaged or no ONNX file" in refused(content)


def test_model_of_too_many_parts(refused, monkeypatch):
    assert MOST_PARTS == 1_000_000  # which take seconds
    monkeypatch.setattr("postfx.runtime.model_file.MOST_PARTS", 10_000)
    node = b"\x0a\x00"  # an empty node
    graph = node * 10_001
    length = bytearray()
    size = len(graph)
    while size:
        length.append(size & 0x7F | (0x80 if size > 0x7F else 0))
        size >>= 7
    assert "it has too many parts" in refused(b"\x3a" + bytes(length) + graph)


def test_oversize_model(tmp_path):
    with (tmp_path / "bad.onnx").open("wb") as file:
        file.truncate(MOST_MODEL_BYTES + 1)  # takes no room on the disk
    with pytest.raises(ModelError,
                       match=r"bad.onnx' is refused: it has 1024 MB, more than 1024 MB"):
        Library(tmp_path).load("bad")


def test_model_that_is_no_file(tmp_path):
    (tmp_path / "w.json").write_text("{}")
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "m.onnx").write_bytes(model_of().SerializeToString())
    (tmp_path / "m.json").write_text(json.dumps({"weights": {"pipe": "0" * 64}}))
    with pytest.raises(ModelError, match="pipe' is not a file"):
        Library(tmp_path).load("m")


def test_names_that_would_break_the_line(refused):
    node = helper.make_node("Evil\n\x1b[31m" + "x" * 5000, ["x"], ["y"])
    assert "the operator 'Evil??[31mxxx" in refused(model_of(node))


def test_operators_are_onnx_own():
    known = {schema.name for schema in onnx.defs.get_all_schemas() if schema.domain == ""}
    # ONNX Runtime has it in ONNX's domain
    assert OPERATORS - known == {"SimplifiedLayerNormalization"}


def test_our_reader_agrees_with_the_package(tmp_path):
    for path in sorted(models_dir().rglob("*.onnx")):
        ours = parse_model(path.read_bytes())
        theirs = onnx.load(path, load_external_data=False).graph
        assert [(n.operator, n.inputs, n.outputs) for n in ours.nodes] == [
            (n.op_type, list(n.input), list(n.output)) for n in theirs.node]
        assert [(w.name, w.dims) for w in ours.weights] == [(w.name, tuple(w.dims))
                                                            for w in theirs.initializer]
        assert [v.name for v in ours.inputs] == [v.name for v in theirs.input]


def test_mutated_models_are_refused_or_well_formed(tmp_path):
    """3000 random changes of small models: nothing but ModelError comes out, and nothing takes
    long."""
    chance = random.Random(7)
    seeds = [model_of(weights=[numpy_helper.from_array(np.ones(3, "f4"), "w")]).SerializeToString(),
             model_of(weights=[outside("w.bin", offset=4)]).SerializeToString(),
             (models_dir() / "kernels/smooth.onnx").read_bytes()]
    let_through = 0
    for _ in range(3000):
        content = bytearray(chance.choice(seeds))
        for _ in range(chance.randint(1, 6)):
            at = chance.randrange(len(content))
            kind = chance.randrange(4)
            if kind == 0:
                content[at] = chance.randrange(256)
            elif kind == 1:
                del content[at : at + chance.randint(1, 9)]
            elif kind == 2:
                content[at:at] = struct.pack("<Q", chance.getrandbits(64))[: chance.randint(1, 8)]
            else:
                content[at:at] = content[chance.randrange(len(content)) :][: chance.randint(1, 40)]
            content = content or bytearray(b"\x00")
        try:
            check_model(tmp_path / "m.onnx", bytes(content), {})
            let_through += 1
        except ModelError as error:
            assert "\n" not in str(error)
    assert 0 < let_through < 1500


def test_shapes_are_read_as_the_package_reads_them():
    """Bytes or numbers, with every sign; not what is too long to be a shape."""
    values = [-1, 0, 16, (1 << 62) + 1, -(1 << 63), (1 << 63) - 1]
    typed = helper.make_tensor("typed", TensorProto.INT64, [6], values)
    packed = np.array(values, np.int64)
    weights = [typed, numpy_helper.from_array(packed, "raw"),
               numpy_helper.from_array(np.arange(16), "longest"),
               numpy_helper.from_array(np.arange(17), "too long")]
    found = parse_model(model_of(weights=weights).SerializeToString()).weights
    assert [one.values for one in found] == [tuple(values), tuple(values), tuple(range(16)), ()]
    assert [one.held for one in found[1:]] == [48, 128, 136]


def sparse_graph(model):
    model.graph.sparse_initializer.add(dims=[4])


def sparse_node(model):
    model.graph.node[0].attribute.add(name="value").sparse_tensor.dims.append(4)


def sparse_nodes(model):
    model.graph.node[0].attribute.add(name="values").sparse_tensors.add(dims=[4])


@pytest.mark.parametrize(("change", "told"), [
    (lambda model: model.training_info.add(), "training"), (sparse_graph, "sparse weights"),
    (sparse_node, "sparse weights in a node"), (sparse_nodes, "sparse weights in a node")])
def test_what_no_network_needs(refused, change, told):
    model = model_of()
    change(model)
    assert told in refused(model)


def test_name_that_is_no_text(refused):
    content = (model_of(helper.make_node("Evil", ["x"], ["y"])).SerializeToString()
               .replace(b"Evil", b"Ev\xffl"))
    assert "a name that is not UTF-8" in refused(content)
