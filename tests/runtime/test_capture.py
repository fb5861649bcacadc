"""Captures: what is recorded of committed buffers, and that recording changes nothing."""

import numpy as np
import pytest

from postfx.pipeline import Pipeline
from postfx.runtime import ArgumentTable, CaptureError, CommandError, Device
from postfx.runtime.snapshot import PICTURE_WIDTH, CapturedBarrier, as_planes, statistics
from tests import toys


def record_two(bench, label="frame 7"):
    """total = a + b by a kernel, y = 2 total by a network."""
    a, b = bench.tensor("a", filled=True), bench.tensor("b", filled=True)
    total, y = bench.tensor("total"), bench.tensor("y")
    commands = bench.device.command_buffer(label)
    with commands.group("toy"), commands.compute_encoder("add") as encoder:
        encoder.dispatch(*bench.add(a, b, total))
    with commands.machine_learning_encoder("double") as encoder:
        encoder.barrier(after="compute", before="machine-learning")
        encoder.dispatch_network(*bench.double(total, y))
    return commands, y


def run(commands):
    commands.commit()
    commands.wait(10)


def test_commands_barriers_tensors_and_memory_are_recorded(bench, library):
    commands, y = record_two(bench)
    with bench.device.capture() as capture:
        run(commands)
    (buffer,) = capture.buffers
    assert buffer.label == "frame 7"
    add, barrier, double = buffer.records
    assert barrier == CapturedBarrier("consumer", double.encoder, ("compute",),
                                      ("machine-learning",))
    assert (add.index, add.label, add.command, add.stage) == (0, "toy/add", "kernel 'add'",
                                                              "compute")
    assert (double.index, double.label, double.command) == (1, "double", "network 'double'")
    assert add.model is None and double.model == library.path("double")
    assert (add.milliseconds > 0
            and [add.milliseconds] == [ms for label, ms in commands.timings if label == "toy/add"])
    assert [(t.name, t.shape, t.dtype, t.nbytes) for t in double.writes] == [("y", (1, 4, 5),
                                                                              "float32", 80)]
    assert (double.writes[0].start, double.writes[0].end) == (y.start, y.end)
    assert buffer.heap_used == bench.device.heap.used and buffer.heap_peak >= buffer.heap_used > 0


def test_outputs_are_looked_at_when_written_and_inputs_when_first_read(bench):
    with bench.device.capture() as capture:
        run(record_two(bench)[0])
    add, double = capture.buffers[0].dispatches
    assert [t.snapshot.statistics.mean for t in add.reads] == [1.0, 1.0]
    assert add.writes[0].snapshot.statistics.mean == 2.0
    assert double.reads[0].snapshot is None
    assert double.writes[0].snapshot.values == [4.0] * 20
    (picture,) = double.writes[0].snapshot.pictures
    assert picture.shape == (4, 5) and (picture == 4.0).all()


def test_only_buffers_committed_meanwhile(bench):
    first, second, third = (record_two(bench, name)[0] for name in ("before", "within", "after"))
    run(first)
    with bench.device.capture("none") as capture:
        second.commit()
    run(third)
    second.wait(10)
    assert [buffer.label for buffer in capture.buffers] == ["within"]
    assert all(dispatch.milliseconds is not None for dispatch in capture.buffers[0].dispatches)
    assert capture.buffers[0].dispatches[0].writes[0].snapshot is None


def test_a_buffer_committed_again_is_recorded_again(bench):
    commands, _ = record_two(bench)
    with bench.device.capture() as capture:
        run(commands)
        run(commands)
    assert [d.index for buffer in capture.buffers for d in buffer.dispatches] == [0, 1, 2, 3]


def test_all_keeps_arrays_in_files(bench, tmp_path):
    with bench.device.capture("all", tmp_path) as capture:
        run(record_two(bench)[0])
    add, double = capture.buffers[0].dispatches
    assert (np.load(tmp_path / double.writes[0].snapshot.file) == 4.0).all()
    assert (np.load(tmp_path / add.reads[1].snapshot.file) == 1.0).all()
    assert len(list((tmp_path / "tensors").glob("*/*.npy"))) == 4


def test_a_capture_changes_no_bit(library, tmp_path):
    frames = [toys.make_frame(number) for number in (1, 2)]
    plain, captured = (Pipeline([toys.Double(library=library, times=2), toys.Sum()], Device("cpu"))
                       for _ in range(2))
    for frame in frames:
        expected = plain(frame)["colour"]
        with captured.device.capture("all", tmp_path) as capture:
            assert np.array_equal(captured(frame)["colour"], expected)
        assert len(capture.buffers[0].dispatches) == 3


def test_remote_memory_is_downloaded(remote):
    a, b = remote.wrap("a", np.full((1, 4, 5), 3.0, np.float32)), remote.heap.tensor("b", (1, 4, 5))
    state = remote.compute_state(toys.ADD)
    commands = remote.command_buffer("frame")
    with commands.compute_encoder("add") as encoder:
        encoder.dispatch(state, ArgumentTable(state, {"a": a, "b": a, "total": b}))
    with remote.capture() as capture:
        run(commands)
    assert capture.buffers[0].dispatches[0].writes[0].snapshot.values == [6.0] * 20


def test_a_failed_command_is_named_and_the_rest_did_not_run(device, failing):
    commands = device.command_buffer("frame")
    with commands.machine_learning_encoder("pick") as encoder:
        for _ in range(2):
            encoder.dispatch_network(*failing.dispatch)
            encoder.barrier()
    with device.capture() as capture:
        commands.commit()
        with pytest.raises(CommandError):
            commands.wait(10)
    first, second = capture.buffers[0].dispatches
    assert "'pick' (network 'pick') of 'frame' failed" in first.error and first.milliseconds is None
    assert (second.error, second.milliseconds) == (None, None)


def test_files_that_cannot_be_written_are_an_error_and_the_commands_still_run(bench, tmp_path):
    (tmp_path / "tensors").write_text("in the way")
    commands, y = record_two(bench)
    with pytest.raises(CaptureError,
                       match="the capture is not complete"), bench.device.capture("all", tmp_path):
        run(commands)
    assert (y.array == 4.0).all()


def test_options_and_nesting_are_checked(device):
    with pytest.raises(CaptureError,
                       match="cannot keep 'some' of tensors: use one of thumbnails, none, all"):
        device.capture("some")
    with pytest.raises(CaptureError, match="needs a folder="):
        device.capture("all")
    with device.capture(), pytest.raises(CaptureError,
                                         match="being captured already"), device.capture():
        pass
    with device.capture() as capture:
        assert capture.buffers == []


def test_statistics():
    array = np.array([[0.0, np.nan, 2.0], [np.inf, -np.inf, 4.0]], np.float16)
    found = statistics(array)
    assert (found.minimum, found.maximum, found.mean) == (0.0, 4.0, 2.0)
    assert (found.zeros, found.nans, found.infinities) == (1 / 6, 1, 2)
    empty = statistics(np.full(3, np.nan))
    assert (empty.minimum, empty.maximum, empty.mean, empty.nans) == (None, None, None, 3)
    large = np.arange(1 << 21, dtype=np.float32)
    assert statistics(large).mean == np.arange(1 << 21).mean()


@pytest.mark.parametrize(
    "shape, planes",
    [
        ((8, 9), (1, 8, 9)),
        ((8, 9, 3), (3, 8, 9)),
        ((3, 8, 9), (3, 8, 9)),
        ((1, 44, 8, 9), (44, 8, 9)),
        ((1, 8, 9, 3), (3, 8, 9)),
        ((1, 2, 3, 8, 9), (6, 8, 9)),
        ((2, 2, 8, 9), (4, 8, 9)),
    ],
)
def test_arrays_of_any_layout_become_planes(shape, planes):
    array = np.arange(np.prod(shape)).reshape(shape)
    found = as_planes(array)
    assert found.shape == planes
    assert as_planes(np.zeros(5)) is None
    if shape == (8, 9, 3):
        assert (found[1] == array[..., 1]).all()


def test_pictures_are_small(device):
    a = device.wrap("a", np.ones((30, 1000, 5), np.float32))
    b = device.heap.tensor("b", (30, 1000, 5))
    state = device.compute_state(toys.ADD)
    commands = device.command_buffer("frame")
    with commands.compute_encoder("add") as encoder:
        encoder.dispatch(state, ArgumentTable(state, {"a": a, "b": a, "total": b}))
    with device.capture() as capture:
        run(commands)
    snapshot = capture.buffers[0].dispatches[0].writes[0].snapshot
    assert snapshot.channels == 5 and len(snapshot.pictures) == 3
    assert snapshot.pictures[0].shape[1] <= PICTURE_WIDTH and snapshot.values is None
