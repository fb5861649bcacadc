"""Networks run node by node: the same results, by every node; constants, graphs inside nodes,
failures."""

import numpy as np
import pytest
from onnx import TensorProto, helper

from postfx.runtime import Device, Library
from postfx.runtime.capture import run_nodes
from postfx.runtime.session import Placement
from postfx.system import models_dir
from tests import toys
from tests.deep import LEVEL, make_deep, make_long

CPU = Placement("CPUExecutionProvider", "cpu", 0, 2)


def test_every_node_writes_what_it_should(tmp_path):
    x = np.random.default_rng(1).random((1, 2, 4, 5), np.float32) + 1
    runs = list(run_nodes(make_deep(tmp_path).path("deep"), CPU, {"x": x}))
    assert ([(run.index, run.op, run.constant) for run in runs] == [
        (0, "Cast", True), (1, "Conv", False), (2, "Relu", False), (3, "Sub", False),
        (4, "Sqrt", False), (5, "Add", False),
    ])  # fmt: skip
    assert runs[1].name == "first" and all(run.milliseconds > 0 and run.error is None
                                           for run in runs)
    values = {name: array for run in runs for name, array in run.outputs.items()}
    padded = np.pad(x.sum(1), ((0, 0), (1, 1), (1, 1)))
    sums = sum(padded[:, i : i + 4, j : j + 5] for i in range(3) for j in range(3))
    np.testing.assert_allclose(values["relu"], np.repeat(sums[:, None], 4, 1), rtol=1e-6)
    np.testing.assert_allclose(values["y"], values["relu"] + np.sqrt(values["relu"] - LEVEL),
                               rtol=1e-6)


def test_a_failing_node_ends_it(library):
    (run,) = run_nodes(library.path("pick"), CPU, {"index": np.array([7])})
    assert (run.op, run.outputs, run.milliseconds) == ("Gather", {}, None) and "Gather" in run.error


def test_a_graph_inside_a_node_reads_values_around_it(tmp_path):
    branch = [
        helper.make_graph([helper.make_node(op, ["twice", "one"], [op])], op, [],
                          [toys.value(op, (3,))])
        for op in ("Add", "Sub")
    ]
    nodes = [
        helper.make_node("Add", ["x", "x"], ["twice"]),
        helper.make_node("If", ["more"], ["y"], then_branch=branch[0], else_branch=branch[1]),
    ]
    inputs = [toys.value("x", (3,)), toys.value("more", (), TensorProto.BOOL)]
    weights = {"one": np.ones(3, np.float32)}
    toys.save_model(tmp_path / "choose.onnx", nodes, inputs, [toys.value("y", (3,))], weights)
    x = np.arange(3, dtype=np.float32)
    for more, expected in ((True, 2 * x + 1), (False, 2 * x - 1)):
        *_, last = run_nodes(tmp_path / "choose.onnx", CPU, {"x": x, "more": np.array(more)})
        assert last.error is None and np.array_equal(last.outputs["y"], expected)


def test_what_is_not_read_again_is_let_go(tmp_path):
    """The skip connection is kept, the values between are not."""
    runs = run_nodes(make_long(tmp_path, 12).path("long"), CPU, {"x": np.ones(4, np.float32)})
    for run in runs:
        held = runs.gi_frame.f_locals["values"]
        assert len(held) <= 3, f"after node {run.index}: {sorted(held)}"


@pytest.mark.parametrize(
    "tag, tolerance", [("s", 1e-4), ("s.int8", 0.05), ("s.fp16", 0.02)],
    ids=["float32", "int8", "float16"]
)
def test_the_networks_of_each_precision(tag, tolerance):
    """Against ONNX Runtime's run of the whole, which fuses and optimises."""
    name = f"denoise_upscale.{tag}"
    state = Device("cpu", threads=2).pipeline_state(Library(), name, {"height": 32, "width": 48})
    random = np.random.default_rng(1)
    inputs = {source.name: random.random(source.shape).astype(source.dtype)
              for source in state.bindings if source.access == "read"}
    runs = list(run_nodes(models_dir() / f"{name}.onnx", CPU, inputs))
    assert all(run.error is None for run in runs)
    values = {key: array for run in runs for key, array in run.outputs.items()}
    names = [binding.name for binding in state.bindings if binding.access == "write"]
    for key, expected in zip(names, state._session._session.run(names, inputs), strict=True):
        assert values[key].dtype == expected.dtype
        difference = np.abs(values[key].astype(np.float64) - expected).mean()
        assert difference <= tolerance * np.abs(expected.astype(np.float64)).mean(), key
