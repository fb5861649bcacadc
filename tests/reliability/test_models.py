"""Model files that are damaged or mean harm are refused in one line, before ONNX Runtime sees them."""

import hashlib
import json
import os
import random
import struct

import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper, numpy_helper

from postfx.paths import models_dir
from postfx.runtime import Device, Library, ModelError
from postfx.runtime import session as session_module
from postfx.runtime.model_check import MOST_BYTES, OPERATORS, check_model
from postfx.runtime.model_file import MOST_PARTS
from tests import toys

X, Y = toys.value("x", (1, "height")), toys.value("y", (1, "height"))


def graph_of(nodes, weights=(), inputs=(X,), outputs=(Y,)):
    return helper.make_graph(list(nodes), "g", list(inputs), list(outputs), list(weights))


def model_of(*nodes, weights=(), **kept):
    nodes = nodes or [helper.make_node("Add", ["x", "w" if weights else "x"], ["y"])]
    opsets = [helper.make_opsetid("", 20), *kept.pop("opsets", [])]
    return helper.make_model(graph_of(nodes, weights, **kept), opset_imports=opsets, ir_version=10)


def weights_of(dims, content=b"", name="w", kind=TensorProto.FLOAT):
    return TensorProto(name=name, dims=dims, data_type=kind, raw_data=content)


def outside(location, **entries):
    """Weights of four floats in another file."""
    tensor = TensorProto(name="w", dims=[4], data_type=TensorProto.FLOAT, data_location=TensorProto.EXTERNAL)
    for key, value in {"location": location, **entries}.items():
        tensor.external_data.add(key=key, value=str(value))
    return tensor


@pytest.fixture
def refused(tmp_path, monkeypatch):
    """Loads a model without a card, or with one, and gives the one line with which it is refused."""
    def touched(*_, **__):
        raise AssertionError("ONNX Runtime was handed the model")

    def load(model, card=None):
        content = model if isinstance(model, bytes) else model.SerializeToString()
        (tmp_path / "models").mkdir(exist_ok=True)
        (tmp_path / "models/bad.onnx").write_bytes(content)
        if card is not None:
            (tmp_path / "models/bad.json").write_text(json.dumps(card))
        monkeypatch.setattr(session_module.ort, "InferenceSession", touched)
        with pytest.raises(ModelError) as caught:
            Device("cpu").pipeline_state(Library(tmp_path / "models"), "bad", {"height": 4})
        assert "models/" in str(caught.value) and "\n" not in str(caught.value) and len(str(caught.value)) < 500
        return str(caught.value)

    return load


def test_what_is_well_is_loaded(tmp_path, device):
    (tmp_path / "good.onnx").write_bytes(model_of(weights=[numpy_helper.from_array(np.ones(1, "f4"), "w")])
                                         .SerializeToString())
    assert device.pipeline_state(Library(tmp_path), "good", {"height": 4}).bindings[0].name == "x"


@pytest.fixture(scope="module")
def device():
    return Device("cpu")


def test_every_shipped_model_is_let_through():
    for library in (Library(), Library(models_dir() / "kernels")):
        for name in library.names():
            assert library.load(name)


def test_every_shipped_model_has_a_hash_and_declares_its_inputs():
    library = Library()
    for name in library.names():
        card = library.card(name)
        assert len(card["sha256"]) == 64 and card["outputs"], name
        assert card["inputs"] or set(library.constants(name)) == set(card["outputs"]), name


def test_external_data_absolute_path(refused):
    assert "weights may lie in the model's own folder only" in refused(model_of(weights=[outside("/etc/passwd")]))


def test_external_data_parent_folder(refused, tmp_path):
    (tmp_path / "secret.bin").write_bytes(bytes(16))
    assert "weights may lie in the model's own folder only" in refused(model_of(weights=[outside("../secret.bin")]))


def test_external_data_link_out_of_the_folder(refused, tmp_path):
    (tmp_path / "secret.bin").write_bytes(bytes(16))
    (tmp_path / "models").mkdir()
    os.symlink("../secret.bin", tmp_path / "models/w.bin")
    assert "a link that leads out of the model's folder" in refused(model_of(weights=[outside("w.bin")]))


def test_external_data_that_is_not_there(refused):
    assert "which is not there" in refused(model_of(weights=[outside("w.bin")]))


@pytest.mark.parametrize("entries", [{"length": 8}, {"length": "-1"}, {"offset": "1e9"}])
def test_external_data_of_the_wrong_length(refused, tmp_path, entries):
    (tmp_path / "models").mkdir()
    (tmp_path / "models/w.bin").write_bytes(bytes(16))
    assert "needs 16 bytes" in refused(model_of(weights=[outside("w.bin", **entries)]))


def test_external_data_beyond_the_end(refused, tmp_path):
    (tmp_path / "models").mkdir()
    (tmp_path / "models/w.bin").write_bytes(bytes(16))
    assert "beyond the end" in refused(model_of(weights=[outside("w.bin", offset=4)]))


def test_external_data_without_a_hash_beside_a_model_with_one(refused, tmp_path):
    (tmp_path / "models").mkdir()
    (tmp_path / "models/w.bin").write_bytes(bytes(16))
    model = model_of(weights=[outside("w.bin")])
    card = {"sha256": hashlib.sha256(model.SerializeToString()).hexdigest()}
    assert "whose hash the card does not give" in refused(model, card)


def test_external_data_that_was_altered(refused, tmp_path):
    (tmp_path / "models").mkdir()
    (tmp_path / "models/w.bin").write_bytes(bytes(16))
    model = model_of(weights=[outside("w.bin")])
    card = {"sha256": hashlib.sha256(model.SerializeToString()).hexdigest(), "weights": {"w.bin": "0" * 64}}
    assert "sha256 differs" in refused(model, card)


def test_card_that_names_weights_elsewhere(refused):
    assert "name a file of the same folder" in refused(model_of(), {"weights": {"../w.bin": "0" * 64}})


def test_altered_model(refused):
    assert "sha256 differs" in refused(model_of(), {"sha256": "0" * 64})


@pytest.mark.parametrize("part", [{"inputs": [1]}, {"outputs": {"y": 3}}, {"weights": {"w": 3}}])
def test_malformed_card(refused, part):
    assert "must be an object of" in refused(model_of(), part)


def test_input_that_is_not_the_cards(refused):
    assert "it has the inputs x, its card has features" in refused(model_of(), {"inputs": {"features": {}}})


@pytest.mark.parametrize("shape", [[1, 35], [2, "height"], [1, "width"], [1, "height", 1]])
def test_input_shape_that_is_not_the_cards(refused, shape):
    assert "its input 'x' is 1xheight, its card says" in refused(model_of(), {"inputs": {"x": {"shape": shape}}})


def test_output_that_is_not_the_cards(refused):
    assert "it has the outputs y, its card has z" in refused(model_of(), {"outputs": {"z": {}}})


def test_unknown_domain(refused):
    node = helper.make_node("Evil", ["x"], ["y"], domain="com.evil")
    model = model_of(node, opsets=[helper.make_opsetid("com.evil", 1)])
    assert "operators of the domain 'com.evil' are not known" in refused(model)


def test_operator_of_an_undeclared_domain(refused):
    node = helper.make_node("Evil", ["x"], ["y"], domain="com.evil")
    assert "the operator 'com.evil.Evil' is not known" in refused(model_of(node))


@pytest.mark.parametrize("operator", ["Evil", "Loop", "If", "Scan", "StringConcat", "RandomNormal"])
def test_unknown_operator(refused, operator):
    assert f"the operator '{operator}' is not known" in refused(model_of(helper.make_node(operator, ["x"], ["y"])))


def test_graph_inside_a_node(refused):
    inner = graph_of([helper.make_node("Identity", ["x"], ["y"])])
    assert "holds a graph of its own" in refused(model_of(helper.make_node("Identity", ["x"], ["y"], body=inner)))


def test_functions_of_its_own(refused):
    model = model_of()
    model.functions.add(name="Add", domain="local")
    assert "functions of its own" in refused(model)


def test_weights_that_claim_more_than_they_hold(refused):
    assert "says that it is 1000x1000 and holds 16 bytes" in refused(
        model_of(weights=[weights_of([1000, 1000], bytes(16))]))


def test_typed_weights_that_claim_more_than_they_hold(refused):
    tensor = TensorProto(name="w", dims=[1000], data_type=TensorProto.FLOAT, float_data=[1, 2])
    assert "says that it is 1000 and holds 8 bytes" in refused(model_of(weights=[tensor]))


@pytest.mark.parametrize("dims", [[1 << 40], [1 << 20, 1 << 20], [-1], [1] * 17, [1 << 62] * 9])
def test_huge_weights(refused, dims):
    assert "is too large" in refused(model_of(weights=[weights_of(dims)]))


def test_weights_of_an_unknown_type(refused):
    assert "of a type that is not known (8)" in refused(model_of(weights=[weights_of([1], b"x", kind=8)]))


def test_huge_input(refused):
    assert "'x' is too large" in refused(model_of(inputs=[toys.value("x", (1 << 20, 1 << 20))]))


@pytest.mark.parametrize(("operator", "at"), [("ConstantOfShape", 0), ("Expand", 1), ("Tile", 1), ("Resize", 3)])
@pytest.mark.parametrize("constant", [False, True])
def test_little_that_makes_much(refused, operator, at, constant):
    size = numpy_helper.from_array(np.array([1 << 20, 1 << 20], np.int64), "size")
    node = helper.make_node(operator, [*["x"] * at, "size"], ["y"])
    maker = [helper.make_node("Constant", [], ["size"], value=size)] if constant else []
    assert f"a node '{operator}' makes 1048576x1048576 elements" in refused(
        model_of(*maker, node, weights=[] if constant else [size]))


@pytest.mark.parametrize("part", [0, 1, 7, 0.5, 0.99])
def test_truncated_model(refused, part):
    content = model_of(weights=[numpy_helper.from_array(np.ones(64, "f4"), "w")]).SerializeToString()
    assert "is damaged or no ONNX file" in refused(content[: int(part * len(content)) if part < 1 else part])


@pytest.mark.parametrize("content", [b"", b"not a model", b"\xff" * 50, b"PK\x03\x04" + bytes(60), b"\x0b" * 9])
def test_file_that_is_no_model(refused, content):
    assert "is damaged or no ONNX file" in refused(content)


def test_model_of_too_many_parts(refused):
    node = b"\x0a\x00"  # an empty node
    graph = node * (MOST_PARTS + 1)
    length = bytearray()
    size = len(graph)
    while size:
        length.append(size & 0x7F | (0x80 if size > 0x7F else 0))
        size >>= 7
    assert "it has too many parts" in refused(b"\x3a" + bytes(length) + graph)


def test_oversize_model(tmp_path):
    with (tmp_path / "bad.onnx").open("wb") as file:
        file.truncate(MOST_BYTES + 1)  # takes no room on the disk
    with pytest.raises(ModelError, match=r"bad.onnx' is refused: it has 1024 MB, more than 1024 MB"):
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
    assert known >= OPERATORS


def test_our_reader_agrees_with_the_package(tmp_path):
    from postfx.runtime.model_file import parse_model

    for path in sorted(models_dir().rglob("*.onnx")):
        ours, theirs = parse_model(path.read_bytes()), onnx.load(path, load_external_data=False).graph
        assert [(n.operator, n.inputs, n.outputs) for n in ours.nodes] == [
            (n.op_type, list(n.input), list(n.output)) for n in theirs.node]
        assert [(w.name, w.dims) for w in ours.weights] == [(w.name, tuple(w.dims)) for w in theirs.initializer]
        assert [v.name for v in ours.inputs] == [v.name for v in theirs.input]


def test_mutated_models_are_refused_or_well_formed(tmp_path):
    """3000 random changes of small models: nothing but ModelError comes out, and nothing takes long."""
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
