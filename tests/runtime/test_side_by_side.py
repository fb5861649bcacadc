"""Commands that no barrier orders run side by side where they leave each other threads; handlers
are told the end."""

import logging
import statistics
import threading
import time

import numpy as np
import pytest

from postfx.runtime import ArgumentTable, CommandError, CommandTimeout, Device, DeviceError
from postfx.runtime import device as device_module
from postfx.runtime.device import ProviderMemory, cuda_fault
from postfx.runtime.session import Placement
from tests import toys

WAIT = 20
"""Seconds until a test gives up."""


class Meeting:
    """A stand-in for what a network runs: waits until `count` of them run at once."""

    def __init__(self, count):
        self.barrier = threading.Barrier(count)
        self.most = 0
        self.now = 0
        self.lock = threading.Lock()

    def __call__(self, run):
        def met():
            with self.lock:
                self.now += 1
                self.most = max(self.most, self.now)
            try:
                if self.barrier.parties > 1:
                    self.barrier.wait(WAIT)
                run()
            finally:
                with self.lock:
                    self.now -= 1

        return met


@pytest.fixture
def record(library, monkeypatch):
    """Records three networks, the third after both others or, without barriers, beside them."""

    def make(device, threads, meeting, barrier=False, networks=3):
        state = device.pipeline_state(library, "double", {"height": 4, "width": 5}, threads=threads)
        prepare = state.prepare
        monkeypatch.setattr(state, "prepare", lambda tensors: meeting(prepare(tensors)))
        x = device.wrap("x", np.ones((1, 4, 5), np.float32))
        results = [device.heap.tensor(f"y{i}", (1, 4, 5)) for i in range(networks)]
        commands = device.command_buffer("frame")
        with commands.machine_learning_encoder("networks") as encoder:
            for result in results:
                encoder.dispatch_network(state, ArgumentTable(state, {"x": x, "y": result}))
                if barrier:
                    encoder.barrier()
        return commands, results

    return make


def test_as_many_as_there_are_threads_for(record):
    meeting = Meeting(3)  # it would wait in vain if fewer ran at once
    commands, results = record(Device("cpu", threads=3), 1, meeting)
    commands.commit()
    commands.wait(WAIT)
    assert meeting.most == 3 and all(np.all(y.array == 2.0) for y in results)
    assert [label for label, _ in commands.timings] == ["networks"]


@pytest.mark.parametrize("threads, taken, barrier", [(3, 3, False), (3, 2, False), (3, 1, True)])
def test_no_more_than_fit_and_none_before_a_barrier(record, threads, taken, barrier):
    meeting = Meeting(1)
    commands, results = record(Device("cpu", threads=threads), taken, meeting, barrier)
    commands.commit()
    commands.wait(WAIT)
    assert meeting.most == 1 and all(np.all(y.array == 2.0) for y in results)


def test_a_failure_ends_what_has_not_begun(device, library):
    pick, state = device.pipeline_state(library, "pick", threads=1), device.compute_state(toys.ADD)
    good, bad = (device.wrap("index", np.array([i])) for i in (1, 7))
    picked = [device.heap.tensor(f"picked {i}", (1,)) for i in range(2)]
    total = device.heap.tensor("total", (1, 4, 5))
    ones = device.wrap("ones", np.ones((1, 4, 5), np.float32))
    commands = device.command_buffer("frame")
    with commands.machine_learning_encoder("pick") as encoder:
        for index, result in zip((good, bad), picked, strict=True):
            encoder.dispatch_network(pick, ArgumentTable(pick, {"index": index, "picked": result}))
    with commands.compute_encoder("after") as encoder:
        encoder.barrier(after="machine-learning", before="compute")
        encoder.dispatch(state, ArgumentTable(state, {"a": ones, "b": ones, "total": total}))
    commands.commit()
    with pytest.raises(CommandError, match="'pick' .*of 'frame' failed"):
        commands.wait(WAIT)
    assert picked[0].array.tolist() == [20] and total.state.failed and picked[1].state.failed


def two_buffers(device, library, monkeypatch, meeting, barrier):
    """A buffer each that doubles x, the second perhaps behind a barrier."""
    state = device.pipeline_state(library, "double", {"height": 4, "width": 5}, threads=1)
    prepare = state.prepare
    monkeypatch.setattr(state, "prepare", lambda tensors: meeting(prepare(tensors)))
    x, buffers, results = device.wrap("x", np.ones((1, 4, 5), np.float32)), [], []
    for number in range(2):
        results.append(device.heap.tensor(f"y{number}", (1, 4, 5)))
        commands = device.command_buffer(f"frame {number}")
        with commands.machine_learning_encoder("double") as encoder:
            if barrier:
                encoder.barrier(after="machine-learning", before="machine-learning")
            encoder.dispatch_network(state, ArgumentTable(state, {"x": x, "y": results[-1]}))
        buffers.append(commands)
    return buffers, results


def test_buffers_that_nothing_orders_run_side_by_side(library, monkeypatch):
    device, meeting = Device("cpu", threads=2), Meeting(2)
    buffers, results = two_buffers(device, library, monkeypatch, meeting, barrier=False)
    for _ in range(3):
        for commands in buffers:
            commands.commit()
        for commands in reversed(buffers):  # waiting for the second says nothing of the first
            commands.wait(WAIT)
        assert all(np.all(y.array == 2.0) for y in results)
    assert meeting.most == 2 and not device.hazards.in_flight()


@pytest.mark.parametrize("threads, barrier", [(2, True), (1, False)])
def test_buffers_that_a_barrier_orders_or_there_is_no_thread_for(library, monkeypatch, threads,
                                                                 barrier):
    device, meeting = Device("cpu", threads=threads), Meeting(1)
    buffers, results = two_buffers(device, library, monkeypatch, meeting, barrier)
    for commands in buffers:
        commands.commit()
    device.wait_idle(WAIT)
    assert meeting.most == 1 and all(np.all(y.array == 2.0) for y in results)


def test_what_comes_after_both_waits_for_both(library, monkeypatch):
    device, gate, order = Device("cpu", threads=2), threading.Event(), []

    def slow(run):
        def late():
            gate.wait(WAIT)
            run()
            order.append("network")

        return late

    buffers, results = two_buffers(device, library, monkeypatch, slow, barrier=False)
    add, total = device.compute_state(toys.ADD), device.heap.tensor("total", (1, 4, 5))
    last = device.command_buffer("last")
    with last.compute_encoder("add") as encoder:
        encoder.barrier(after="machine-learning", before="compute")
        encoder.dispatch(add,
                         ArgumentTable(add, {"a": results[0], "b": results[1], "total": total}))
    last.add_completed_handler(lambda _: order.append("last"))
    for commands in (*buffers, last):
        commands.commit()
    assert not last.is_done(0.05) and not order
    gate.set()
    device.wait_idle(WAIT)
    assert np.all(total.array == 4.0) and order[:2] == ["network"] * 2


class Forks(ProviderMemory):
    """Memory of a device with streams, on which commands run at once."""

    def __init__(self, placement):
        super().__init__(placement)
        self.streams, self.before, self.ran, self.joined = [], [], [], 0

    def stream_beside(self):
        self.streams.append(len(self.streams) + 1)
        return self.streams[-1]

    def fork(self, streams, before):
        self.ran = []
        self.before = [(stream, mask) for stream, mask in zip(streams, before, strict=True)]
        return self if any(streams) else None

    def __enter__(self):
        assert not self.ran

    def __exit__(self, *exception):
        self.joined += 1

    def run(self, index, execute):
        begin = self.mark()
        execute()
        self.ran.append(index)
        return begin, self.mark()


def sum_of_two(device, library, name="double", **dims):
    """Two networks that may run side by side, and the sum of their results; the networks' states, x
    and the sum."""
    states = [device.pipeline_state(library, name, dims, threads=1) for _ in range(2)]
    shape = states[0].shapes["x"]
    x, total = device.heap.tensor("x", shape), device.heap.tensor("total", shape)
    x.upload(np.ones(shape, np.float32))
    results = [device.heap.transient(f"y{i}", shape) for i in range(2)]
    pair = device.pipeline_state(library, "pair", {"height": shape[1], "width": shape[2]})
    commands = device.command_buffer("frame")
    with commands.machine_learning_encoder("networks") as encoder:
        for state, y in zip(states, results, strict=True):
            encoder.dispatch_network(state, ArgumentTable(state, {"x": x, "y": y}))
    with commands.machine_learning_encoder("sum") as encoder:
        encoder.barrier(after="machine-learning", before="machine-learning")
        encoder.dispatch_network(pair, ArgumentTable(pair, {"a": results[0], "b": results[1],
                                                            "total": total}))
    return states, x, total, commands


def test_networks_get_streams_of_their_own_where_there_are_any(library, monkeypatch):
    placement = Placement("CPUExecutionProvider", "cpu", 0, 2)
    memory = Forks(placement)
    monkeypatch.setattr(device_module, "choose", lambda *rest: (placement, memory))
    device = Device("auto", threads=2)
    states, x, total, commands = sum_of_two(device, library, height=4, width=5)
    assert [state.stream for state in states] == [1, 2]
    assert device.pipeline_state(library, "double", {"height": 4, "width": 5}).stream == 0
    for times in (1, 2):
        commands.commit()
        commands.wait(WAIT)
        assert np.all(total.download() == 4 * times) and memory.joined == times
        x.upload(np.full((1, 4, 5), 2, np.float32))
        assert memory.before == [(1, 0), (2, 0), (0, 0b11)] and memory.ran == [0, 1, 2]
        assert [label for label, _ in commands.timings] == ["networks", "sum"]
    # where each command is looked at, they run one after the other
    with device.capture(tensors="none"):
        commands.commit()
        commands.wait(WAIT)
    assert memory.joined == 4 and memory.before == [(0, 0)] and np.all(total.download() == 8)
    monkeypatch.setattr(memory, "run", lambda *_: 1 / 0)
    commands.commit()
    with pytest.raises(CommandError, match="'frame' failed: division by zero"):
        commands.wait(WAIT)
    assert memory.joined == 5 and total.state.failed


@pytest.mark.gpu
@pytest.mark.skipif(cuda_fault(0) is not None, reason="needs a GPU")
def test_networks_side_by_side_on_a_gpu(tmp_path):
    """Two deep networks of few pixels each leave a GPU room for another one: as a graph they take
    less than one after the other. Command by command one thread of the host launches both, which
    takes longer than they do."""
    library, ratios = toys.make_deep(tmp_path), []
    for graphs in (True, False):
        device = Device("cuda", threads=2, graphs=graphs)
        states, x, total, commands = sum_of_two(device, library, "deep")
        assert len({0, *(state.stream for state in states)}) == 3
        alone = device.command_buffer("alone")
        y = device.heap.tensor("y", x.shape)
        with alone.machine_learning_encoder("network") as encoder:
            encoder.dispatch_network(states[0], ArgumentTable(states[0], {"x": x, "y": y}))

        def run(some):
            begin = time.perf_counter()
            some.commit()
            some.wait(WAIT)
            return time.perf_counter() - begin

        took = {alone: [], commands: []}
        for value in range(30):
            for some, times in took.items():
                times.append(run(some))
            assert np.allclose(total.download(), 2 * y.download(),
                               rtol=1e-5), "both are there when they are added"
            x.upload(np.full(x.shape, value, np.float32))
        one, both = (statistics.median(times[5:]) for times in took.values())
        print(f"graphs {graphs}: one network takes {1e3 * one:.2f} ms, two and their sum "
              f"{both / one:.2f} of that")
        ratios.append(both / one)
    assert ratios[0] < 1.8, ratios


def test_threads_that_a_network_cannot_take(device, library):
    with pytest.raises(DeviceError, match="cannot take 3 of the 2 threads"):
        device.pipeline_state(library, "double", {"height": 4, "width": 5}, threads=3)


def test_wait_returns_after_handlers_ran(bench):
    x, y, told, may_end = bench.tensor("x", filled=True), bench.tensor("y"), [], threading.Event()

    def tell(commands):
        may_end.wait(WAIT)
        told.append(commands.label)

    commands = bench.device.command_buffer("frame")
    commands.add_completed_handler(tell)
    with commands.machine_learning_encoder("double") as encoder:
        encoder.dispatch_network(*bench.double(x, y))
    commands.commit()
    assert commands.is_done(WAIT)
    with pytest.raises(CommandTimeout, match="a handler of 'frame' was not done after"):
        commands.wait(0.01)
    may_end.set()
    commands.wait(WAIT)
    assert told == ["frame"]


def test_handlers_are_called_at_every_end(bench, caplog):
    x, y, told = bench.tensor("x", filled=True), bench.tensor("y"), []
    called = threading.Semaphore(0)

    def tell(commands):
        commands.wait()
        told.append((commands.label, float(y.array[0, 0, 0])))
        called.release()

    def fail(commands):
        raise ValueError("no")

    commands = bench.device.command_buffer("frame")
    commands.add_completed_handler(fail)
    commands.add_completed_handler(tell)
    with commands.machine_learning_encoder("double") as encoder:
        encoder.dispatch_network(*bench.double(x, y))
    with caplog.at_level(logging.ERROR, "postfx"):
        for _ in range(2):
            commands.commit()
            assert called.acquire(timeout=WAIT)
    assert told == [("frame", 2.0)] * 2 and caplog.text.count("a handler of 'frame' failed") == 2
    commands.begin("next")
    commands.commit()
    commands.wait(WAIT)
    bench.device.wait_idle(WAIT)
    assert len(told) == 2
