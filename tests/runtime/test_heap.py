"""The arena: carving, reuse, release, accounting, views and copies."""

import gc
import random
import weakref

import numpy as np
import pytest

from postfx.runtime import BindingError, Device, HazardError
from postfx.runtime.memory import ALIGNMENT

MIB = 1 << 20


def megabytes(device, name, count):
    return device.heap.tensor(name, (count, MIB), "uint8")


def test_release_makes_memory_free_for_the_next_tensor(device):
    first = megabytes(device, "first", 3)
    start = first.start
    first.release()
    assert megabytes(device, "second", 2).start == start
    assert device.heap.peak == 3 * MIB and device.heap.used == 0  # nothing refers to the second one


def test_dropping_the_last_reference_releases(device):
    tensor = megabytes(device, "dropped", 4)
    view = tensor.view("part", (MIB,))
    del tensor
    gc.collect()
    assert device.heap.used == 4 * MIB
    del view
    gc.collect()
    assert device.heap.used == 0


def test_report_names_what_lives(device):
    small, large = megabytes(device, "small", 1), megabytes(device, "large", 2)
    assert device.heap.tensors() == [("large", 2 * MIB), ("small", MIB)]
    large.release()
    assert device.heap.tensors() == [("small", MIB)]
    assert (device.heap.used, device.heap.peak) == (MIB, 3 * MIB)
    assert device.heap.size >= device.heap.peak
    assert small.nbytes == MIB


def test_tensors_never_overlap_and_everything_comes_back(device):
    rng, live = random.Random(5), []
    for _ in range(400):
        if live and rng.random() < 0.5:
            live.pop(rng.randrange(len(live))).release()
        else:
            live.append(device.heap.tensor("t", (rng.randint(1, 40) * 100_000,), "uint8"))
        spans = sorted((tensor.start, tensor.end) for tensor in live)
        assert all(one[1] <= other[0] for one, other in zip(spans, spans[1:], strict=False))
        assert all(start % ALIGNMENT == 0 for start, _ in spans)
    for tensor in live:
        tensor.release()
    size = device.heap.size
    assert device.heap.used == 0
    whole = device.heap.tensor("whole", (64 * MIB,), "uint8")
    assert whole.nbytes == 64 * MIB and device.heap.size <= size


def test_chunks_that_became_too_small_are_given_up(device):
    small = megabytes(device, "small", 64)
    small.release()
    large = megabytes(device, "large", 100)
    assert device.heap.size == large.nbytes


def test_a_view_on_the_host_keeps_its_chunk(device):
    tensor = megabytes(device, "kept", 64)
    tensor.fill(7)
    kept, chunk = tensor.array, weakref.ref(tensor.allocation.owner)
    tensor.release()
    del tensor
    huge = megabytes(device, "huge", 128)  # makes the heap give up the first chunk
    gc.collect()
    assert huge.nbytes and kept[-1, -1] == 7
    del kept
    gc.collect()
    assert chunk() is None


@pytest.mark.parametrize("dtype", ["float32", "float16", "int64", "uint8", "bool"])
def test_upload_download(device, dtype):
    values = np.arange(24).reshape(2, 3, 4).astype(dtype)
    tensor = device.heap.tensor("t", (2, 3, 4), dtype)
    tensor.upload(values)
    assert np.array_equal(tensor.array, values) and np.array_equal(tensor.download(), values)
    assert tensor.download().dtype == dtype


def test_upload_takes_lists_and_strided_arrays_and_scalars(device):
    params = device.heap.tensor("params", (3,))
    params.upload([1, 2.5, 3])
    assert np.array_equal(params.array, [1, 2.5, 3])
    square = device.heap.tensor("square", (3, 2))
    square.upload(np.arange(6.0).reshape(2, 3).T)
    assert np.array_equal(square.array, [[0, 3], [1, 4], [2, 5]])
    scalar = device.heap.tensor("scalar", ())
    scalar.upload(4.0)
    assert scalar.array == 4.0


def test_upload_of_wrong_shape_or_kind_is_refused(device):
    tensor = device.heap.tensor("t", (2, 3), "int32")
    with pytest.raises(BindingError,
                       match=r"upload of \(3, 2\) int64 to 't': the tensor is \(2, 3\) int32"):
        tensor.upload(np.zeros((3, 2), np.int64))
    with pytest.raises(BindingError, match="float64"):
        tensor.upload(np.zeros((2, 3)))


def test_array_is_for_reading(device):
    tensor = device.heap.tensor("t", (4,))
    tensor.fill(1.0)
    with pytest.raises(ValueError, match="read-only"):
        tensor.array[0] = 2.0


def test_unknown_type_is_refused(device):
    with pytest.raises(BindingError, match="cannot be of type complex64"):
        device.heap.tensor("t", (4,), "complex64")


def test_view_must_fit(device):
    tensor = device.heap.tensor("t", (10,))
    for shape, offset in (((11,), 0), ((5,), 6), ((2,), -1)):
        with pytest.raises(BindingError, match="does not fit into 't'"):
            tensor.view("v", shape, offset)


def test_released_tensors_are_unusable(device):
    tensor = device.heap.tensor("t", (4,))
    view = tensor.view("v", (2,))
    tensor.fill(1.0)
    tensor.release()
    tensor.release()
    for use in (tensor.download, lambda: tensor.fill(0.0), lambda: view.array):
        with pytest.raises(HazardError, match="was released"):
            use()


def test_wrap_shares_memory_and_counts_as_written(device, ones):
    tensor = device.wrap("ones", ones)
    ones[0, 0, 0] = 5.0
    assert tensor.array[0, 0, 0] == 5.0 and device.heap.used == 0
    tensor.fill(2.0)
    assert np.all(ones == 2.0)


def test_wrap_needs_arrays_of_this_machines_byte_order(device):
    with pytest.raises(BindingError,
                       match="has the byte order of other machines: pass it as float32"):
        device.wrap("x", np.ones(3, ">f4"))


def test_wrapped_read_only_arrays_cannot_be_written(device, ones):
    ones.flags.writeable = False
    with pytest.raises(BindingError, match="read-only"):
        device.wrap("ones", ones).fill(0.0)


def test_device_lives_as_long_as_its_tensors():
    tensor = Device("cpu").heap.tensor("t", (2,))
    gc.collect()
    tensor.fill(3.0)
    assert np.all(tensor.download() == 3.0)
