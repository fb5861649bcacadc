"""Captures that look into networks."""

import sys

import numpy as np
import pytest

from postfx.runtime import ArgumentTable, CaptureError, CommandError
from tests.deep import capture_deep, make_deep


@pytest.fixture
def deep(tmp_path):
    return make_deep(tmp_path / "models")


def test_nodes_have_figures_pictures_and_times(deep):
    capture, y = capture_deep(deep, network=True)
    (dispatch,) = capture.buffers[0].dispatches
    cast, conv, _, _, _, last = dispatch.network.nodes
    assert dispatch.dims == {"height": 4, "width": 5} and dispatch.network.difference < 1e-6
    assert (conv.index, conv.op, conv.name, conv.milliseconds > 0) == (1, "Conv", "first", True)
    (written,) = conv.outputs
    assert (written.name, written.shape, written.dtype, written.nbytes) == ("conv", (1, 4, 4, 5),
                                                                            "float32", 320)
    assert (written.snapshot.statistics.minimum, written.snapshot.statistics.maximum) == (8, 18)
    assert [picture.shape for picture in written.snapshot.pictures] == [(4, 5)] * 4
    assert cast.constant and cast.outputs[0].snapshot.pictures == []
    assert last.outputs[0].snapshot.statistics.mean == pytest.approx(y.mean(), rel=1e-6)


def test_one_sees_where_a_nan_begins(deep):
    capture, y = capture_deep(deep, x=0.0, network=True)
    nodes = capture.buffers[0].dispatches[0].network.nodes
    assert [node.outputs[0].snapshot.statistics.nans for node in nodes] == [0, 0, 0, 0, 80, 80]
    assert np.isnan(y).all()


def test_it_is_off_by_default_and_changes_no_bit(deep):
    plain, expected = capture_deep(deep, x=0.3)
    assert plain.buffers[0].dispatches[0].network is None
    _, y = capture_deep(deep, x=0.3, network=True)
    assert np.array_equal(y, expected)


def test_all_writes_what_nodes_wrote(deep, tmp_path):
    capture, y = capture_deep(deep, tensors="all", folder=tmp_path, network=True)
    cast, *_, last = capture.buffers[0].dispatches[0].network.nodes
    np.testing.assert_allclose(np.load(tmp_path / last.outputs[0].snapshot.file), y, rtol=1e-6)
    assert cast.outputs[0].snapshot.file is None


def test_the_node_that_failed_is_named(device, failing):
    commands = device.command_buffer("frame")
    with commands.machine_learning_encoder("pick") as encoder:
        encoder.dispatch_network(*failing.dispatch)
    with device.capture(network=True) as capture:
        commands.commit()
        with pytest.raises(CommandError):
            commands.wait(10)
    found = capture.buffers[0].dispatches[0].network
    assert [(node.op, node.outputs) for node in found.nodes] == [("Gather", [])]
    assert "Gather" in found.nodes[0].error and found.difference is None


def test_a_network_whose_input_was_lost_is_not_looked_into(device, library, failing):
    double = device.pipeline_state(library, "double", {"height": 1, "width": 1})
    y = device.heap.tensor("y", (1, 1, 1))
    first, second = device.command_buffer("first"), device.command_buffer("second")
    with first.machine_learning_encoder("pick") as encoder:
        encoder.dispatch_network(*failing.dispatch)
    with second.machine_learning_encoder("double") as encoder:
        encoder.barrier(after="machine-learning", before="machine-learning")
        table = ArgumentTable(double, {"x": failing.picked.view("x", (1, 1, 1)), "y": y})
        encoder.dispatch_network(double, table)
    with device.capture(network=True) as capture:
        first.commit()
        second.commit()
        for commands in (first, second):
            with pytest.raises(CommandError):
                commands.wait(10)
    lost = capture.buffers[1].dispatches[0]
    assert "did not run" in lost.error or "failed" in lost.error
    assert lost.network is None


def test_options_are_checked(device, monkeypatch):
    with pytest.raises(CaptureError, match="capture of networks .* cannot keep 'none'"):
        device.capture("none", network=True)
    monkeypatch.setitem(sys.modules, "onnx", None)
    with pytest.raises(CaptureError, match=r"need the package onnx: pip install '\.\[capture\]'"):
        device.capture(network=True)
