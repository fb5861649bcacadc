"""Argument tables check what is bound, at once; encoders check what is recorded."""

import numpy as np
import pytest

from postfx.kernels import Kernel
from postfx.runtime import ArgumentTable, BindingError, Device, EncodingError, HazardError
from postfx.runtime.states import could_match, solve
from tests import toys


def test_good_table(bench):
    x, y = bench.tensor("x"), bench.tensor("y")
    table = ArgumentTable(bench.network)
    table["x"], table["y"] = x, y
    assert table["x"] is x and list(table) == ["x", "y"]


def test_wrong_name(bench):
    with pytest.raises(BindingError, match="network 'double' has no binding 'z': it has 'x', 'y'"):
        ArgumentTable(bench.network)["z"] = bench.tensor("t")


def test_wrong_shape(bench, device):
    for shape in ((1, 5, 4), (4, 5), (2, 4, 5)):
        with pytest.raises(BindingError,
                           match=r"binding 'x': tensor 't' is .*, it must be \(1, 4, 5\)"):
            ArgumentTable(bench.network)["x"] = device.heap.tensor("t", shape)


def test_wrong_dtype(bench, device):
    with pytest.raises(BindingError, match="tensor 't' is float16, it must be float32"):
        ArgumentTable(bench.network)["x"] = device.heap.tensor("t", (1, 4, 5), "float16")


def test_not_a_tensor(bench, ones):
    with pytest.raises(BindingError, match="ndarray is not a tensor: use device.wrap"):
        ArgumentTable(bench.network)["x"] = ones


def test_other_device(bench):
    with pytest.raises(BindingError,
                       match="binding 'x': tensor 't' belongs to another device: make it on this "
                       "one"):
        ArgumentTable(bench.network)["x"] = Device("cpu").heap.tensor("t", (1, 4, 5))


def test_a_released_tensor_cannot_be_bound(bench):
    x = bench.tensor("x")
    x.release()
    with pytest.raises(BindingError, match="binding 'x': tensor 'x' was released: bind a new one"):
        ArgumentTable(bench.network)["x"] = x


def test_read_only_memory_is_not_written(bench, ones):
    ones.flags.writeable = False
    tensor = bench.device.wrap("ones", ones)
    table = ArgumentTable(bench.network)
    table["x"] = tensor
    message = ("binding 'y' is written, but tensor 'ones' wraps a read-only array: wrap a writable "
               "one")
    with pytest.raises(BindingError, match=message):
        table["y"] = tensor


def test_unbound_is_named_at_dispatch(bench):
    table = ArgumentTable(bench.network, {"x": bench.tensor("x")})
    with pytest.raises(BindingError, match="network 'double': nothing is bound to 'y'"):
        table["y"]
    commands = bench.device.command_buffer("frame")
    with commands.machine_learning_encoder("denoise") as encoder:
        message = (r"'denoise': network 'double': nothing is bound to 'y': set table\['name'\] = "
                   r"tensor")
        with pytest.raises(BindingError, match=message):
            encoder.dispatch_network(bench.network, table)


def test_sizes_of_a_kernel_must_fit_together(bench, device):
    a, b, total = (device.heap.tensor(name, shape) for name, shape in
                   (("a", (1, 4, 5)), ("b", (1, 4, 5)), ("total", (1, 4, 6))))
    with pytest.raises(BindingError,
                       match=r"'add': 'a' \(1, 4, 5\) and 'total' \(1, 4, 6\) do not fit together"):
        ArgumentTable(bench.kernel, {"a": a, "b": b, "total": total}).arguments()
    commands = bench.device.command_buffer("frame")
    with commands.compute_encoder("prepare") as encoder:
        with pytest.raises(BindingError,
                           match="'prepare': kernel 'add': 'a' .* do not fit together: 'channels' "
                           "is 5"):
            encoder.dispatch(*bench.add(a, b, total))


def test_multiples_of_a_symbol(device):
    state = device.compute_state(toys.TWICE_AS_LARGE)
    coarse = device.heap.tensor("coarse", (2, 3, 1))
    ArgumentTable(state,
                  {"coarse": coarse, "fine": device.heap.tensor("fine", (4, 6, 1))}).arguments()
    with pytest.raises(BindingError, match="'width' is 3 in the first and 4 in the second"):
        ArgumentTable(state,
                      {"coarse": coarse, "fine": device.heap.tensor("fine", (4, 8, 1))}).arguments()
    with pytest.raises(BindingError, match=r"it must be \(2\*height, 2\*width, channels\)"):
        ArgumentTable(state)["fine"] = device.heap.tensor("fine", (5, 6, 1))


@pytest.mark.parametrize("bad", ["height*2", "0*height", "height-1", "", "2 height"])
def test_dimension_that_cannot_be_read(bad):
    with pytest.raises(BindingError, match="is not a number, a symbol or"):
        could_match((4,), (bad,))


def test_solved_symbols():
    shapes = {"a": (4, 6), "b": (2, 3)}
    assert solve(shapes, {"a": ("2*h", "2*w"), "b": ("h", "w")}) == {"h": 2, "w": 3}


def test_dispatch_takes_what_is_bound_at_that_moment(bench):
    x, y, z = bench.tensor("x", True), bench.tensor("y"), bench.tensor("z")
    table = ArgumentTable(bench.network, {"x": x, "y": y})
    commands = bench.device.command_buffer("frame")
    with commands.machine_learning_encoder("twice") as encoder:
        encoder.dispatch_network(bench.network, table)
        encoder.barrier()
        table["x"], table["y"] = y, z
        encoder.dispatch_network(bench.network, table)
    commands.commit()
    commands.wait(10)
    assert np.all(y.array == 2) and np.all(z.array == 4)


def test_rebinding_the_same_tensor_keeps_what_was_prepared(bench):
    x, y = bench.tensor("x"), bench.tensor("y")
    table = ArgumentTable(bench.network, {"x": x, "y": y})
    prepared = table.arguments()
    table["x"] = x
    assert table.arguments() is prepared
    table["x"] = bench.tensor("other")
    assert table.arguments() is not prepared


def test_table_of_another_state(bench):
    table = ArgumentTable(bench.kernel)
    commands = bench.device.command_buffer("frame")
    with commands.machine_learning_encoder("denoise") as encoder:
        message = ("'denoise': the argument table was made for kernel 'add': make one for network "
                   "'double'")
        with pytest.raises(BindingError, match=message):
            encoder.dispatch_network(bench.network, table)


def test_state_of_another_stage_or_device(bench, library):
    commands = bench.device.command_buffer("frame")
    with commands.compute_encoder("prepare") as encoder:
        message = (r"'prepare' takes compute work, but network 'double' is .*: use "
                   r"commands.machine_learning_encoder\(\)")
        with pytest.raises(EncodingError, match=message):
            encoder.dispatch(bench.network, ArgumentTable(bench.network))
    other = Device("cpu").compute_state(toys.ADD)
    with commands.compute_encoder("prepare") as encoder:
        with pytest.raises(EncodingError, match="kernel 'add' was made for another device"):
            encoder.dispatch(other, ArgumentTable(other))


def test_failed_dispatch_records_nothing(bench):
    x = bench.tensor("x", True)
    commands = bench.device.command_buffer("frame")
    with commands.machine_learning_encoder("denoise") as encoder:
        with pytest.raises(HazardError):
            encoder.dispatch_network(*bench.double(x, x))
    assert commands.records == []


@pytest.mark.parametrize("fields", [
    {"reads": ("a", "a")}, {"row_axis": ("a", 0)}, {"shapes": {"c": (1,)}},
])
def test_kernel_that_makes_no_sense(fields):
    good = {"name": "k", "reads": ("a",), "writes": ("b",), "rows": print, "row_axis": ("b", 0)}
    Kernel(**good)
    with pytest.raises(ValueError, match="kernel 'k'"):
        Kernel(**{**good, **fields})
