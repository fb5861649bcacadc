"""Model packages and pipeline states."""

import json
import shutil

import numpy as np
import onnx
import onnxruntime
import pytest
from onnx import TensorProto, helper

from postfx.runtime import ArgumentTable, Binding, Library, ModelError
from postfx.runtime.capture import constant_nodes
from postfx.runtime.session import CONSTANTS
from tests import toys


def test_names_and_cards(library):
    assert library.names() == ("double", "pair", "pick")
    assert library.card("double")["name"] == "double" and library.card("pair") == {}


def test_unknown_model_lists_those_there_are(library):
    with pytest.raises(ModelError, match="no model 'tripple' in .*: there are double, pair, pick"):
        library.path("tripple")


def test_a_folder_without_models(tmp_path):
    with pytest.raises(ModelError, match=r"no model 'double' in .*: no \*\.onnx is there"):
        Library(tmp_path).load("double")


def test_missing_folder(tmp_path):
    with pytest.raises(ModelError, match="nowhere' does not exist"):
        Library(tmp_path / "nowhere")


def test_first_folder_wins(library, tmp_path):
    shutil.copy(library.path("pair"), tmp_path / "double.onnx")
    assert Library(tmp_path, *library.folders).path("double").parent == tmp_path
    assert "pick" in Library(tmp_path, *library.folders).names()


@pytest.mark.parametrize("text", ["{", "[1]"])
def test_broken_card(library, tmp_path, text):
    shutil.copy(library.path("double"), tmp_path)
    (tmp_path / "double.json").write_text(text)
    with pytest.raises(ModelError, match="card '.*double.json'"):
        Library(tmp_path).load("double")


def test_file_that_is_not_the_cards_is_refused(library, device, tmp_path):
    shutil.copy(library.path("pair"), tmp_path / "double.onnx")
    shutil.copy(library.path("double").with_suffix(".json"), tmp_path)
    with pytest.raises(ModelError, match="double.onnx' is not the file that its card describes"):
        device.pipeline_state(Library(tmp_path), "double", {"height": 4, "width": 4})


def test_card_without_hash_is_not_checked(library, tmp_path):
    shutil.copy(library.path("double"), tmp_path)
    (tmp_path / "double.json").write_text(json.dumps({"tag": "m"}))
    assert Library(tmp_path).load("double") == library.load("double")


def test_reflection_of_fixed_dimensions(device, library):
    state = device.pipeline_state(library, "double", {"height": 4, "width": 6})
    assert state.bindings == (Binding("x", "read", (1, 4, 6), "float32"),
                              Binding("y", "write", (1, 4, 6), "float32"))
    assert device.pipeline_state(library, "pick").bindings[0] == Binding("index", "read", (1,),
                                                                         "int64")


def test_outputs_follow_the_inputs(device, kernels):
    state = device.pipeline_state(kernels, "twice_as_large",
                                  {"height": 2, "width": 3, "channels": 4})
    assert state.bindings[1] == Binding("fine", "write", (4, 6, 4), "float32")


def test_dimension_left_free_is_named(device, library):
    with pytest.raises(ModelError,
                       match="network 'double' leaves width of 'x' free: dims were height=4"):
        device.pipeline_state(library, "double", {"height": 4})
    with pytest.raises(ModelError, match="leaves height, width of 'x' free: dims were none"):
        device.pipeline_state(library, "double")


def test_size_that_depends_on_data_is_refused(device, tmp_path):
    x, found = toys.value("x", (4,)), toys.value("found", (1, None), TensorProto.INT64)
    toys.save_model(tmp_path / "find.onnx", [helper.make_node("NonZero", ["x"], ["found"])], [x],
                    [found])
    with pytest.raises(ModelError, match="of 'found' free"):
        device.pipeline_state(Library(tmp_path), "find")


def test_damaged_file(device, tmp_path):
    (tmp_path / "bad.onnx").write_bytes(b"not a model")
    with pytest.raises(ModelError, match="bad.onnx' is damaged or no ONNX file"):
        device.pipeline_state(Library(tmp_path), "bad")


def test_sessions_share_one_arena_and_spin_only_while_they_run(device, library):
    state = device.pipeline_state(library, "double", {"height": 4, "width": 4})
    options = state._session._session.get_session_options()
    assert options.get_session_config_entry("session.use_env_allocators") == "1"
    assert options.get_session_config_entry("session.intra_op.allow_spinning") == "1"
    assert options.get_session_config_entry("session.force_spinning_stop") == "1"
    assert options.intra_op_num_threads == device.threads and not options.enable_mem_pattern


def test_copy_model_is_one_identity_node():
    from postfx.runtime.device import _COPY

    session = onnxruntime.InferenceSession(_COPY.read_bytes(), providers=["CPUExecutionProvider"])
    sent = np.arange(10, dtype=np.uint8)
    assert np.array_equal(session.run(None, {"source": sent})[0], sent)
    assert _COPY.stat().st_size < 1000


def test_constants_are_computed_once_and_not_bound(tmp_path, device):
    scale = {"scale": np.array([3.0], np.float32)}
    nodes = [helper.make_node("Mul", ["x", "scale"], ["y"]),
             helper.make_node("Add", ["scale", "scale"], ["six"])]
    shapes = [toys.value("x", (2,)), toys.value("y", (2,)), toys.value("six", (1,)),
              toys.value("scale", (1,))]
    toys.save_model(tmp_path / "parts.onnx", nodes, shapes[:1], shapes[1:], scale)
    card = {"outputs": {"y": {}, "six": {"constant": True}, "scale": {"constant": True}}}
    (tmp_path / "parts.json").write_text(json.dumps(card))
    state = device.pipeline_state(Library(tmp_path), "parts")
    assert [binding.name for binding in state.bindings] == ["x", "y"]
    assert {name: array.tolist() for name, array in state.constants.items()} == {"six": [6],
                                                                                 "scale": [3]}
    y = device.heap.tensor("y", (2,))
    commands = device.command_buffer("test")
    with commands.machine_learning_encoder("network") as encoder:
        x = device.wrap("x", np.array([1, 2], np.float32))
        encoder.dispatch_network(state, ArgumentTable(state, {"x": x, "y": y}))
    commands.commit()
    commands.wait(30)
    assert y.download().tolist() == [3, 6]


def test_constants_are_taken_from_the_metadata(tmp_path, device):
    def make(text: str) -> Library:
        toys.save_model(tmp_path / "twice.onnx", [toys.helper.make_node("Add", ["x", "x"], ["y"])],
                        [toys.value("x", (2,))], [toys.value("y", (2,))])
        model = onnx.load(tmp_path / "twice.onnx")
        onnx.helper.set_model_props(model, {CONSTANTS: text})
        onnx.save(model, tmp_path / "twice.onnx")
        (tmp_path / "twice.json").write_text(json.dumps({"outputs": {"y": {},
                                                                     "six": {"constant": True}}}))
        return Library(tmp_path)

    told = '{"six": {"shape": [1, 1], "float32": "AADAQA=="}}'
    assert device.pipeline_state(make(told), "twice").constants["six"].tolist() == [[6]]
    for damaged in ("{", "[]", '{"six": 6}', told.replace("[1, 1]", "[2]"),
                    told.replace("AADAQA==", "AAD?")):
        with pytest.raises(ModelError, match="'postfx.constants' of its metadata is damaged"):
            device.pipeline_state(make(damaged), "twice")
    with pytest.raises(ModelError, match="model 'twice' cannot be run"):
        device.pipeline_state(make("{}"), "twice")


@pytest.mark.parametrize("name", Library().names())
def test_shipped_cards_mark_constants(name):
    library = Library()
    model = onnx.load(library.path(name), load_external_data=False)
    constant = {item.name for item in model.graph.initializer}
    constant |= {output for index in constant_nodes(model)
                 for output in model.graph.node[index].output}
    outputs = {item.name for item in model.graph.output}
    lifted = {name for item in model.metadata_props if item.key == CONSTANTS
              for name in json.loads(item.value)}
    assert set(library.constants(name)) == outputs & constant | lifted
    if name.startswith("denoise_upscale"):  # execution providers other than ours cannot have them
        assert not outputs & {item.name for item in model.graph.initializer}
