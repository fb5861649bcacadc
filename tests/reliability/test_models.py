"""Models that mean harm, or are not what their card says, are refused in one line, before ONNX
Runtime sees them."""

import hashlib
import os

import numpy as np
import pytest
from onnx import TensorProto, helper, numpy_helper
from onnxruntime.capi import onnxruntime_pybind11_state as onnxruntime_state

from postfx.runtime import Device, Library, ModelError
from postfx.runtime.models import MICROSOFT_OPERATORS, OPERATORS
from postfx.system import models_dir
from tests import toys
from tests.reliability.model_files import graph_of, model_of, outside, weights_of


def test_what_is_well_is_loaded(tmp_path, device):
    (tmp_path / "good.onnx").write_bytes(model_of(
        weights=[numpy_helper.from_array(np.ones(1, "f4"), "w")]
    ).SerializeToString())
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
    assert ("weights may lie in the model's own folder "
            "only" in refused(model_of(weights=[outside("/etc/passwd")])))


def test_external_data_parent_folder(refused, tmp_path):
    (tmp_path / "secret.bin").write_bytes(bytes(16))
    assert ("weights may lie in the model's own folder "
            "only" in refused(model_of(weights=[outside("../secret.bin")])))


def test_external_data_link_out_of_the_folder(refused, tmp_path):
    (tmp_path / "secret.bin").write_bytes(bytes(16))
    (tmp_path / "models").mkdir()
    os.symlink("../secret.bin", tmp_path / "models/w.bin")
    assert ("a link that leads out of the model's "
            "folder" in refused(model_of(weights=[outside("w.bin")])))


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
    card = {"sha256": hashlib.sha256(model.SerializeToString()).hexdigest(),
            "weights": {"w.bin": "0" * 64}}
    assert "sha256 differs" in refused(model, card)


def test_card_that_names_weights_elsewhere(refused):
    assert "name a file of the same folder" in refused(model_of(),
                                                       {"weights": {"../w.bin": "0" * 64}})


def test_altered_model(refused):
    assert "sha256 differs" in refused(model_of(), {"sha256": "0" * 64})


@pytest.mark.parametrize("part", [{"inputs": [1]}, {"outputs": {"y": 3}}, {"weights": {"w": 3}}])
def test_malformed_card(refused, part):
    assert "must be an object of" in refused(model_of(), part)


def test_input_that_is_not_the_cards(refused):
    assert "it has the inputs x, its card has features" in refused(model_of(),
                                                                   {"inputs": {"features": {}}})


@pytest.mark.parametrize("shape", [[1, 35], [2, "height"], [1, "width"], [1, "height", 1]])
def test_input_shape_that_is_not_the_cards(refused, shape):
    assert ("its input 'x' is 1xheight, its card "
            "says" in refused(model_of(), {"inputs": {"x": {"shape": shape}}}))


def test_output_that_is_not_the_cards(refused):
    assert "it has the outputs y, its card has z" in refused(model_of(), {"outputs": {"z": {}}})


def test_unknown_domain(refused):
    node = helper.make_node("Evil", ["x"], ["y"], domain="com.evil")
    model = model_of(node, opsets=[helper.make_opsetid("com.evil", 1)])
    assert "the operator 'com.evil.Evil' is not known" in refused(model)


def test_domain_that_no_node_uses_is_no_harm(tmp_path):
    model = model_of(opsets=[helper.make_opsetid("ai.onnx.ml", 3),
                             helper.make_opsetid("com.microsoft", 1)])
    (tmp_path / "optimised.onnx").write_bytes(model.SerializeToString())
    assert Library(tmp_path).load("optimised")


def test_every_known_operator_is_one_of_onnx_runtime():
    schemas = {(item.domain, item.name) for item in onnxruntime_state.get_all_operator_schema()}
    assert {("", name) for name in OPERATORS} <= schemas
    assert {("com.microsoft", name) for name in MICROSOFT_OPERATORS} <= schemas


@pytest.mark.parametrize("operator", ["BeamSearch", "EPContext", "Sampling", "Snpe", "Tokenizer"])
def test_operators_of_onnx_runtime_that_do_more_than_compute(refused, operator):
    node = helper.make_node(operator, ["x"], ["y"], domain="com.microsoft")
    reason = refused(model_of(node, opsets=[helper.make_opsetid("com.microsoft", 1)]))
    assert (f"the operator 'com.microsoft.{operator}' is not "
            "known" in reason and "trust=True" in reason)


def test_trust_overrides_what_nodes_do_and_nothing_else(tmp_path, device):
    taken = graph_of([helper.make_node("Neg", ["x"], ["z"])], inputs=(),
                     outputs=[toys.value("z", (1, "height"))])
    chosen = helper.make_node("If", ["yes"], ["y"], then_branch=taken, else_branch=taken)
    path = tmp_path / "branch.onnx"
    path.write_bytes(model_of(chosen, weights=[numpy_helper.from_array(np.array(True), "yes")])
                     .SerializeToString())
    with pytest.raises(ModelError,
                       match=r"operator 'If' is not known; .* Library\(folder, trust=True\) loads "
                       r"it"):
        Library(tmp_path).load("branch")
    trusting = Library(tmp_path, trust=True)
    assert device.pipeline_state(trusting, "branch", {"height": 4}).bindings[1].shape == (1, 4)
    path.with_suffix(".json").write_text('{"outputs": {"z": {}}}')
    with pytest.raises(ModelError, match="it has the outputs y, its card has z"):
        trusting.load("branch")


def test_operator_of_an_undeclared_domain(refused):
    node = helper.make_node("Evil", ["x"], ["y"], domain="com.evil")
    assert "the operator 'com.evil.Evil' is not known" in refused(model_of(node))


@pytest.mark.parametrize("operator", ["Evil", "Loop", "If", "Scan", "StringConcat", "RandomNormal"])
def test_unknown_operator(refused, operator):
    assert (f"the operator '{operator}' is not "
            "known" in refused(model_of(helper.make_node(operator, ["x"], ["y"]))))


def test_graph_inside_a_node(refused):
    inner = graph_of([helper.make_node("Identity", ["x"], ["y"])])
    assert ("holds a graph of its "
            "own" in refused(model_of(helper.make_node("Identity", ["x"], ["y"], body=inner))))


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
    assert ("of a type that is not known "
            "(8)" in refused(model_of(weights=[weights_of([1], b"x", kind=8)])))


def test_huge_input(refused):
    assert "'x' is too large" in refused(model_of(inputs=[toys.value("x", (1 << 20, 1 << 20))]))


@pytest.mark.parametrize(("operator", "at"),
                         [("ConstantOfShape", 0), ("Expand", 1), ("Tile", 1), ("Resize", 3)])
@pytest.mark.parametrize("constant", [False, True])
@pytest.mark.parametrize("typed", [False, True])
def test_little_that_makes_much(refused, operator, at, constant, typed):
    """A shape may be stored as bytes or as numbers."""
    sides = [1 << 20, 1 << 20]
    size = (helper.make_tensor("size", TensorProto.INT64, [2], sides) if typed
            else numpy_helper.from_array(np.array(sides, np.int64), "size"))
    node = helper.make_node(operator, [*["x"] * at, "size"], ["y"])
    maker = [helper.make_node("Constant", [], ["size"], value=size)] if constant else []
    assert f"a node '{operator}' makes 1048576x1048576 elements" in refused(
        model_of(*maker, node, weights=[] if constant else [size]))
