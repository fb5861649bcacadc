"""What state a tensor is in, and that the host may touch it only where that state allows it."""

import gc

import numpy as np
import pytest

from postfx.runtime import BindingError, CommandError, HazardError
from tests.runtime.test_hazards import BOTH, record


class Steps:
    """'scale' (a network) reads x and writes y in 'frame 7'."""

    def __init__(self, bench):
        self.bench = bench
        self.x, self.y = bench.tensor("x", True), bench.tensor("y")
        self.commands = record(bench, ("scale", bench.double(self.x, self.y)))


@pytest.fixture
def steps(bench):
    return Steps(bench)


def test_undefined_until_uploaded(bench, ones):
    x = bench.tensor("x")
    assert (x.state.kind, x.state.defined) == ("undefined", False)
    x.upload(ones)
    assert (x.state.kind, x.state.defined, str(x.state)) == ("defined", True, "defined")


def test_partly_uploaded_is_undefined(bench):
    whole = bench.device.heap.tensor("whole", (2, 4, 5))
    upper = whole.view("upper", (1, 4, 5))
    upper.fill(1.0)
    assert (upper.state.kind, whole.state.kind) == ("defined", "undefined")


def test_recorded_changes_nothing_but_is_told(steps):
    assert (steps.x.state.kind, steps.y.state.kind) == ("defined", "undefined")
    assert steps.y.state.recorded == ("scale", "network 'double'", "frame 7")
    steps.commands.discard()
    assert steps.y.state.recorded is None


def test_committed_until_waited_for_whatever_the_timing(steps):
    steps.commands.commit()
    assert steps.commands.is_done(10)
    read, written = steps.x.state, steps.y.state
    assert (read.kind, read.reader, read.writer) == ("being read",
                                                     ("scale", "network 'double'", "frame 7"), None)
    assert (written.kind, written.writer, written.reader) == ("being written", read.reader, None)
    assert written.defined and read.defined
    assert str(written) == "being written by 'scale' (network 'double') of 'frame 7'"
    steps.commands.wait(10)
    assert (steps.x.state.kind, steps.y.state.kind) == ("defined", "defined")


def test_the_last_writer_is_named(steps):
    steps.commands.commit()
    later = steps.bench.device.command_buffer("frame 8")
    with later.machine_learning_encoder("again") as encoder:
        encoder.barrier(after="machine-learning", before="machine-learning")
        encoder.dispatch_network(*steps.bench.double(steps.x, steps.y))
    later.commit()
    assert steps.y.state.writer.buffer == "frame 8"
    steps.commands.wait(10)
    assert steps.y.state.writer.label == "again"
    later.wait(10)
    assert steps.y.state.writer is None


def test_views_and_neighbours(bench):
    whole = bench.device.heap.tensor("whole", (60,))
    whole.fill(1.0)
    first, second, third = (whole.view(name, (1, 4, 5), 20 * i)
                            for i, name in enumerate(("1st", "2nd", "3rd")))
    commands = record(bench, ("scale", bench.double(first, second)))
    commands.commit()
    assert [t.state.kind for t in (first, second, third)] == ["being read", "being written",
                                                              "defined"]
    assert whole.state.kind == "being written"
    commands.wait(10)


def test_a_released_tensor_cannot_be_read(bench):
    x = bench.tensor("x", True)
    x.release()
    assert (x.state.kind, str(x.state)) == ("released", "released")
    with pytest.raises(HazardError, match="tensor 'x' was released: make a new one"):
        x.download()


def test_failed_command_leaves_undefined_until_something_writes(device, failing):
    commands, picked = device.command_buffer("frame"), failing.picked
    with commands.machine_learning_encoder("look up") as encoder:
        encoder.dispatch_network(*failing.dispatch)
    commands.commit()
    with pytest.raises(CommandError):
        commands.wait(10)
    assert (picked.state.kind, picked.state.defined,
            picked.state.failed.label) == ("undefined", False, "look up")
    picked.fill(1.0)
    assert (picked.state.kind, picked.state.failed) == ("defined", None)


def test_host_must_wait_before_it_reads_or_writes(steps, ones):
    x, y = steps.x, steps.y
    steps.commands.commit()
    message = (r"the host {} while 'scale' \(network 'double'\) of 'frame 7' {} it: wait\(\) for "
               r"'frame 7' first")
    for touch, text in (
        (y.download, message.format("reads 'y'", "writes")),
        (lambda: y.array, message.format("reads 'y'", "writes")),
        (lambda: y.upload(ones), message.format("writes 'y'", "writes")),
        (lambda: x.upload(ones), message.format("writes 'x'", "reads")),
    ):
        with pytest.raises(HazardError, match=text) as caught:
            touch()
        assert (caught.value.kind, caught.value.first, caught.value.second) == ("host access",
                                                                                "scale", "host")
    assert np.array_equal(x.array, ones)  # both only read it
    steps.commands.wait(10)
    assert np.array_equal(y.download(), 2 * ones)
    x.upload(3 * ones)


def test_upload_after_recording_would_change_what_was_recorded(steps, ones):
    message = ("while 'scale' .* of 'frame 7' uses it: .*, so upload to another tensor before "
               "recording")
    with pytest.raises(HazardError, match=message):
        steps.x.upload(ones)
    steps.commands.discard()
    steps.x.upload(ones)


def test_upload_to_what_one_of_many_commands_uses(bench, ones):
    x, y, z = bench.tensor("x", True), bench.tensor("y"), bench.tensor("z")
    commands = record(bench, ("scale", bench.double(x, y)), ("again", bench.double(y, z)),
                      barrier=(BOTH, BOTH))
    with pytest.raises(HazardError, match="while 'scale' .* uses it"):
        x.upload(ones)
    commands.discard()
    x.upload(ones)


def test_buffers_that_are_dropped_do_not_block_uploads(steps, ones):
    steps.commands = None
    gc.collect()
    steps.x.upload(ones)


def test_host_reads_of_undefined_memory(bench):
    with pytest.raises(HazardError,
                       match="'empty' is read by the host, but no command wrote it and nothing "
                       "was"):
        bench.tensor("empty").download()


def test_host_writes_of_read_only_arrays(bench, ones):
    ones.flags.writeable = False
    with pytest.raises(BindingError, match="'fixed' wraps a read-only array: it cannot be written"):
        bench.device.wrap("fixed", ones).fill(1.0)
