"""Networks as people have them: operators beyond convolutions, sizes without names, states, other
types and layouts."""

import numpy as np
import pytest
from onnx import TensorProto, helper, numpy_helper

from postfx.kernels import Kernel
from postfx.runtime import BindingError, Device, HazardError, Library, ModelError
from tests import toys
from tests.runtime.conftest import run_once


def save(folder, name, nodes, inputs, outputs, weights=(), opset=24):
    constants = [numpy_helper.from_array(array, key) for key, array in dict(weights).items()]
    graph = helper.make_graph(nodes, name, inputs, outputs, constants)
    opsets = [helper.make_opsetid("", opset), helper.make_opsetid("com.microsoft", 1)]
    (folder / f"{name}.onnx").write_bytes(
        helper.make_model(graph, opset_imports=opsets, ir_version=11).SerializeToString())
    return Library(folder)


def arrays(*shapes):
    random = np.random.default_rng(1)
    return [random.standard_normal(shape, np.float32) for shape in shapes]


def softmax(x):
    e = np.exp(x - x.max(-1, keepdims=True))
    return e / e.sum(-1, keepdims=True)


def sigmoid(x):
    return 1 / (1 + np.exp(-x))


def gru(x, w, r):
    """ONNX's GRU with gates z, r, h and zero biases."""
    h, out, n = np.zeros((x.shape[1], r.shape[1]), np.float32), [], r.shape[1]
    for row in x:
        z, reset = (sigmoid(row @ w[i * n:(i + 1) * n].T + h @ r[i * n:(i + 1) * n].T)
                    for i in range(2))
        h = (1 - z) * np.tanh(row @ w[2 * n:].T + (reset * h) @ r[2 * n:].T) + z * h
        out.append(h)
    return np.stack(out)[:, None]


def lstm(x, w, r):
    """ONNX's LSTM with gates i, o, f, c and zero biases."""
    n = r.shape[1]
    h = c = np.zeros((x.shape[1], n), np.float32)
    out = []
    for row in x:
        i, o, f, g = np.split(row @ w.T + h @ r.T, 4, axis=1)
        c = sigmoid(f) * c + sigmoid(i) * np.tanh(g)
        h = sigmoid(o) * np.tanh(c)
        out.append(h)
    return np.stack(out)[:, None]


def attention(q, k, v):
    return softmax(q @ k.swapaxes(-1, -2) / np.sqrt(q.shape[-1])) @ v


def rms(x, scale):
    return x / np.sqrt((x * x).mean(-1, keepdims=True) + 1e-5) * scale


STEPS, HEADS = (5, 2, 3), (1, 2, 4, 8)
CASES = {
    "GRU": (gru, ("", {"hidden_size": 4, "linear_before_reset": 0}), (STEPS, (12, 3), (12, 4)),
            (5, 1, 2, 4), (1, 2)),
    "LSTM": (lstm, ("", {"hidden_size": 4}), (STEPS, (16, 3), (16, 4)), (5, 1, 2, 4), (1, 2)),
    "Attention": (attention, ("", {}), (HEADS, HEADS, HEADS), HEADS, ()),
    "RMSNormalization": (rms, ("", {"axis": -1}), ((2, 6), (6,)), (2, 6), ()),
    "FusedMatMul": (lambda a, b: 2 * a @ b.T, ("com.microsoft", {"transB": 1, "alpha": 2.0}),
                    ((3, 4), (5, 4)), (3, 5), ()),
}


@pytest.mark.parametrize("operator", CASES)
def test_operators_of_other_networks_compute(operator, device, tmp_path):
    expected, (domain, attributes), shapes, result, directions = CASES[operator]
    given = arrays(*shapes)
    names = [f"x{i}" for i in range(len(given))]
    # weights of one direction
    stored = [array[None] if i in directions else array for i, array in enumerate(given)]
    node = helper.make_node(operator, names, ["y"], domain=domain, **attributes)
    inputs = [toys.value(name, array.shape) for name, array in zip(names, stored, strict=True)]
    state = device.pipeline_state(save(tmp_path, "own", [node], inputs, [toys.value("y", result)]),
                                  "own")
    y = device.heap.tensor("y", result)
    run_once(state,
             {name: device.wrap(name, array) for name, array in zip(names, stored, strict=True)}
             | {"y": y})
    assert np.allclose(y.array, expected(*given), atol=1e-5)


@pytest.fixture
def unnamed(tmp_path):
    """y = -x of two axes without names, and one named 'n'."""
    x, y = (toys.value(name, (None, "n", None)) for name in "xy")
    return save(tmp_path, "unnamed", [helper.make_node("Neg", ["x"], ["y"])], [x], [y])


def test_dimensions_by_input_and_axis(unnamed, device):
    state = device.pipeline_state(unnamed, "unnamed", {("x", 0): 2, "n": 3, ("x", 2): 300})
    assert [binding.shape for binding in state.bindings] == [(2, 3, 300)] * 2
    x, y = device.wrap("x", arrays((2, 3, 300))[0]), device.heap.tensor("y", (2, 3, 300))
    run_once(state, {"x": x, "y": y})
    assert np.array_equal(y.array, -x.array)


@pytest.mark.parametrize("dims, reason", [
    ({("z", 0): 1}, "no input or output 'z' has a shape: 'x', 'y' have one"),
    ({("x", 3): 1}, "'x' has 3 axes, counted from 0, and no axis 3"),
    ({("x", 0): 0}, "axis 0 of 'x' is free, it cannot be 0"),
    ({("x", 0): 1, "n": 2}, r"leaves axis 2 of 'x' free: dims were x\[0\]=1, n=2"),
])
def test_dimensions_that_cannot_be(unnamed, device, dims, reason):
    with pytest.raises(ModelError, match=reason):
        device.pipeline_state(unnamed, "unnamed", dims)


def test_a_network_may_read_and_write_bfloat16(device, tmp_path):
    x, y = toys.value("x", (4,), TensorProto.BFLOAT16), toys.value("y", (4,), TensorProto.BFLOAT16)
    nodes = [helper.make_node("Cast", ["x"], ["f"], to=TensorProto.FLOAT),
             helper.make_node("Neg", ["f"], ["g"]),
             helper.make_node("Cast", ["g"], ["y"], to=TensorProto.BFLOAT16)]
    state = device.pipeline_state(save(tmp_path, "half", nodes, [x], [y]), "half")
    x, y = (device.heap.tensor(name, (4,), "bfloat16") for name in "xy")
    assert x.nbytes == 8 and state.bindings[0].dtype == "bfloat16"
    x.upload(np.float32([1, -2, 3.14159, 0.5]))
    run_once(state, {"x": x, "y": y})
    assert y.array.astype(np.float32).tolist() == [-1, 2, -3.140625, -0.5]  # 8 bits of mantissa
    assert np.array_equal(device.wrap("again", y.download()).array, y.array)


def test_strided_arrays_are_read_and_written_where_they_lie(device, library):
    picture = np.arange(2 * 9 * 12, dtype=np.float32).reshape(9, 12, 2)
    before, target = picture.copy(), np.zeros((5, 8, 1), np.float32)
    crop = picture[6:2:-1, 1:11:2, :1].transpose(2, 0, 1)
    turned = target[:4, 7:2:-1].transpose(2, 0, 1)
    x, y = device.wrap("x", crop), device.wrap("y", turned)
    run_once(device.pipeline_state(library, "double", {"height": 4, "width": 5}), {"x": x, "y": y})
    assert np.array_equal(turned, 2 * crop) and np.array_equal(picture, before)
    assert (np.count_nonzero(target) <= 20 and np.array_equal(y.download(), y.array)
            and y.array.base is not None)
    y.fill(7.0)
    assert (np.all(target[:4, 3:8] == 7.0) and np.all(target[4] == 0.0)
            and np.all(target[:, :3] == 0.0))


def test_strided_arrays_and_kernels(device):
    whole = np.ones((4, 6, 6), np.float32)
    a, b, total = (device.wrap(name, whole[:, :, i::3])
                   for i, name in enumerate(("a", "b", "total")))
    # by their first and last byte
    with pytest.raises(HazardError, match="'a' and 'total' on the same memory"):
        run_once(device.compute_state(toys.ADD), {"a": a, "b": b, "total": total}, "compute")
    result = np.zeros((4, 6, 4), np.float32)
    total = device.wrap("total", result[:, :, ::2])
    run_once(device.compute_state(toys.ADD), {"a": a, "b": b, "total": total}, "compute")
    assert np.all(result[:, :, ::2] == 2.0) and np.all(result[:, :, 1::2] == 0.0)
    with pytest.raises(BindingError, match="'total' is strided: take the view of the array"):
        total.view("part", (1,))


def test_strided_arrays_are_uploaded_where_memory_is_elsewhere(remote):
    picture = arrays((4, 6))[0]
    assert np.array_equal(remote.wrap("t", picture.T).download(), picture.T)


@pytest.fixture
def running_sum(tmp_path):
    """state_out = state + x, and what it was before."""
    shapes = [toys.value(name, (3,)) for name in ("x", "state", "state_out", "before")]
    nodes = [helper.make_node("Add", ["x", "state"], ["state_out"]),
             helper.make_node("Neg", ["state"], ["before"])]
    return save(tmp_path, "sum", nodes, shapes[:2], shapes[2:])


@pytest.mark.parametrize("where", ["device", "remote"])
def test_a_network_that_keeps_a_state(where, request, running_sum):
    device: Device = request.getfixturevalue(where)
    network = device.pipeline_state(running_sum, "sum", in_place={"state": "state_out"})
    assert [(b.name, b.access) for b in network.bindings] == [("x", "read"),
                                                              ("state", "read-write"),
                                                              ("before", "write")]
    x, before = device.wrap("x", np.float32([1, 2, 3])), device.heap.tensor("before", (3,))
    state = device.heap.tensor("state", (3,))
    with pytest.raises(HazardError, match="'state'"):  # it is read, and nothing wrote it yet
        run_once(network, {"x": x, "state": state, "before": before})
    state.fill(0.0)
    for _ in range(3):
        run_once(network, {"x": x, "state": state, "before": before})
    assert state.download().tolist() == [3, 6, 9] and before.download().tolist() == [-2, -4, -6]
    with pytest.raises(HazardError, match="aliasing|same memory"):
        run_once(network, {"x": state, "state": state, "before": before})


@pytest.mark.parametrize("pair, reason",
                         [({"state": "y"}, "it has the inputs 'x', 'state' and the outputs"),
                          ({"stat": "state_out"}, "cannot replace 'stat' by 'state_out'")])
def test_states_that_cannot_be_replaced(running_sum, device, pair, reason):
    with pytest.raises(ModelError, match=reason):
        device.pipeline_state(running_sum, "sum", in_place=pair)


def add_to_rows(y0, y1, amount, total):
    for y in range(y0, y1):
        total[y] += amount[0]


ADD_TO = Kernel("add_to", ("amount", "total"), ("total",), add_to_rows, ("total", 0),
                {"amount": (1,), "total": ("n",)})


@pytest.mark.parametrize("compiled", [True, False])
def test_a_kernel_that_works_in_place(tmp_path, compiled):
    shapes = [toys.value(name, shape)
              for name, shape in (("amount", (1,)), ("total", ("n",)), ("total_out", ("n",)))]
    portable = save(tmp_path, "add_to",
                    [helper.make_node("Add", ["amount", "total"], ["total_out"])], shapes[:2],
                    shapes[2:])
    device = Device("cpu", threads=2, compiled_kernels=compiled, kernels=portable)
    state = device.compute_state(ADD_TO)
    total = device.wrap("total", np.arange(9, dtype=np.float32))
    for _ in range(2):
        run_once(state, {"amount": device.wrap("amount", np.float32([5])), "total": total},
                 "compute")
    assert total.array.tolist() == list(range(10, 19))
