"""Several command buffers in flight: order of waiting, failures in the middle, time-outs."""

import threading

import numpy as np
import pytest

from postfx.kernels import Kernel
from postfx.runtime import ArgumentTable, CommandError, CommandTimeout, HazardError

AFTER_ALL = {"after": ("compute", "machine-learning"), "before": ("compute", "machine-learning")}


class Line:
    """Buffers that each run a kernel b = a + 1; the queue stands still until `gate` is set."""

    def __init__(self, device):
        self.device = device
        self.started, self.gate = threading.Event(), threading.Event()
        self.gate.set()
        self.add = device.compute_state(Kernel("add one", ("a",), ("b",), self._rows, ("b", 0)))
        self.fail = device.compute_state(Kernel("fail", ("a",), ("b",), self._fail, ("b", 0)))

    def tensor(self, name, value=None):
        tensor = self.device.heap.tensor(name, (3,))
        if value is not None:
            tensor.fill(value)
        return tensor

    def commit(self, number, a, b, state=None, **barrier):
        commands = self.device.command_buffer(f"frame {number}")
        with commands.compute_encoder(f"step {number}") as encoder:
            if barrier:
                encoder.barrier(**barrier)
            state = state or self.add
            encoder.dispatch(state, ArgumentTable(state, {"a": a, "b": b}))
        commands.commit()
        return commands

    def _rows(self, y0, y1, a, b):
        self.started.set()
        self.gate.wait(10)
        b[y0:y1] = a[y0:y1] + 1

    def _fail(self, y0, y1, a, b):
        self.gate.wait(10)
        raise ArithmeticError("nothing to divide by\nsecond line")


@pytest.fixture
def line(device):
    line = Line(device)
    yield line
    line.gate.set()


def commit_chain(line, count):
    """Buffers of which each reads what the one before wrote; all committed while the first one
    runs."""
    line.gate.clear()
    tensors = [line.tensor("t 0", 0.0), *(line.tensor(f"t {i + 1}") for i in range(count))]
    buffers = [line.commit(i, tensors[i], tensors[i + 1], **AFTER_ALL) for i in range(count)]
    return tensors, buffers


@pytest.mark.parametrize("order", [range(6), range(5, -1, -1), (3, 0, 5, 1, 4, 2)])
def test_waiting_in_any_order(line, order):
    tensors, buffers = commit_chain(line, 6)
    assert not any(commands.is_done() for commands in buffers)
    line.gate.set()
    for i in order:
        buffers[i].wait(10)
        assert np.array_equal(tensors[i + 1].array, [i + 1] * 3)


def test_waiting_for_one_retires_those_before_it_and_no_other(line):
    tensors, buffers = commit_chain(line, 4)
    line.gate.set()
    buffers[1].wait(10)
    assert buffers[3].is_done(10)
    assert [tensor.state.kind for tensor in tensors] == ["defined", "defined", "being read",
                                                         *["being written"] * 2]
    assert line.device.hazards.in_flight() == buffers[2:]
    tensors[0].fill(0.0)
    with pytest.raises(HazardError, match=r"wait\(\) for 'frame 2' first"):
        tensors[2].fill(0.0)
    line.device.wait_idle(10)
    tensors[2].fill(0.0)


def test_a_ring_of_buffers_with_two_frames_in_flight(line):
    """Frame n is uploaded and committed while frame n - 1 runs; each slot has tensors of its
    own."""
    slots = [(line.tensor(f"in {i}", 0.0), line.tensor(f"out {i}")) for i in range(2)]
    ring = [line.device.command_buffer(f"slot {i}") for i in range(2)]
    for commands, (a, b) in zip(ring, slots, strict=True):
        with commands.compute_encoder("step") as encoder:
            encoder.dispatch(line.add, ArgumentTable(line.add, {"a": a, "b": b}))
    results = []
    for number in range(10):
        commands, (a, b) = ring[number % 2], slots[number % 2]
        if number >= 2:
            commands.wait(10)
            results.append(b.array[0])
            a.fill(number)
            commands.label = f"frame {number}"
        else:
            with pytest.raises(HazardError, match="upload to another tensor before recording"):
                a.fill(number)
        commands.commit()
    line.device.wait_idle(10)
    assert results == [1, 1, 3, 4, 5, 6, 7, 8]


def test_what_depends_on_a_failed_buffer_names_the_first_cause_and_the_rest_runs(line):
    line.gate.clear()
    x, lost, more, most, fine = line.tensor("x", 0.0), *(line.tensor(n)
                                                         for n in ("lost", "more", "most", "fine"))
    failing = line.commit(1, x, lost, line.fail)
    dependent = line.commit(2, lost, more, after="compute", before="compute")
    indirect = line.commit(3, more, most, after="compute", before="compute")
    independent = line.commit(4, x, fine)
    line.gate.set()
    independent.wait(10)
    assert np.array_equal(fine.array, [1] * 3)
    cause = "'step 1' (kernel 'fail') of 'frame 1' failed: nothing to divide by"
    for commands, text in (
        (failing, cause),
        (indirect,
         f"'step 3' (kernel 'add one') of 'frame 3' did not run: it reads 'more', but {cause}"),
        (dependent,
         f"'step 2' (kernel 'add one') of 'frame 2' did not run: it reads 'lost', but {cause}"),
    ):
        with pytest.raises(CommandError) as caught:
            commands.wait(10)
        assert str(caught.value) == text
    assert isinstance(caught.value.__cause__, CommandError)
    assert isinstance(caught.value.__cause__.__cause__, ArithmeticError)
    assert [tensor.state.kind for tensor in (lost, more, most)] == ["undefined"] * 3


def test_what_was_lost_and_is_written_again_in_flight_can_be_used(line):
    line.gate.clear()
    x, y, z = line.tensor("x", 4.0), line.tensor("y"), line.tensor("z")
    failing = line.commit(1, x, y, line.fail)
    line.commit(2, x, y, **AFTER_ALL)
    line.gate.set()
    assert failing.is_done(10)
    with pytest.raises(CommandError):
        failing.wait(10)
    last = line.commit(3, y, z, **AFTER_ALL)
    last.wait(10)
    assert np.array_equal(z.array, [6] * 3)


def test_commands_that_read_what_was_lost_are_refused_once_that_is_known(line):
    x, lost = line.tensor("x", 0.0), line.tensor("lost")
    with pytest.raises(CommandError):
        line.commit(1, x, lost, line.fail).wait(10)
    with pytest.raises(HazardError) as caught:
        line.commit(2, lost, line.tensor("y"))
    assert (str(caught.value) == (
        "read before write: 'step 2' (kernel 'add one') reads 'lost', but 'step 1' (kernel 'fail') "
        "of 'frame 1' failed: nothing to divide by: commit that again, or upload to 'lost'"
    ))


def test_wait_times_out_and_can_be_repeated(line):
    tensors, (first, *_) = commit_chain(line, 1)
    assert line.started.wait(10)
    with pytest.raises(CommandTimeout) as caught:
        first.wait(timeout=0.05)
    text = ("'frame 0' was not done after 0.05 s: 'step 0' (kernel 'add one') of 'frame 0' is "
            "running")
    assert (str(caught.value), caught.value.running, caught.value.waiting) == (text, "step 0", ())
    line.gate.set()
    first.wait(10)
    assert np.array_equal(tensors[1].array, [1] * 3)


def test_time_out_names_what_runs_and_what_waits_behind_it(line):
    _, buffers = commit_chain(line, 7)
    assert line.started.wait(10)
    running = "'step 0' (kernel 'add one') of 'frame 0' is running"
    behind = "behind it wait 'frame 1', 'frame 2', 'frame 3', 'frame 4' and 2 more"
    with pytest.raises(CommandTimeout) as caught:
        buffers[2].wait(timeout=0)
    assert str(caught.value) == f"'frame 2' was not done after 0 s: {running}; {behind}"
    assert (caught.value.running, caught.value.waiting) == ("step 0", tuple(f"frame {i}"
                                                                            for i in range(1, 7)))
    with pytest.raises(CommandTimeout) as caught:
        line.device.wait_idle(timeout=0.01)
    assert (str(caught.value) == f"Device('cpu', threads=2) was not idle after 0.01 s: {running}; "
            f"{behind}")
    line.gate.set()
    line.device.wait_idle(10)


def test_wait_idle_counts_as_waiting_for_everything(line):
    tensors, buffers = commit_chain(line, 3)
    line.gate.set()
    line.device.wait_idle()
    assert line.device.hazards.in_flight() == []
    tensors[0].fill(5.0)
    for commands in buffers:
        commands.commit()
    line.device.wait_idle(10)
    assert np.array_equal(tensors[3].array, [8] * 3)


def test_wait_idle_raises_the_first_error_after_all_is_done(line):
    line.gate.clear()
    x, fine = line.tensor("x", 0.0), line.tensor("fine")
    buffers = [line.commit(i, x, line.tensor(f"lost {i}"), line.fail) for i in range(2)]
    buffers.append(line.commit(2, x, fine))
    line.gate.set()
    with pytest.raises(CommandError, match="'step 0' .* of 'frame 0' failed"):
        line.device.wait_idle(10)
    assert np.array_equal(fine.array, [1] * 3)
    line.device.wait_idle(10)
    with pytest.raises(CommandError, match="'step 1' .* of 'frame 1' failed"):
        buffers[1].wait(10)


def test_wait_idle_with_nothing_committed(device):
    device.wait_idle(0)
