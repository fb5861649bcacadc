"""CUDA graphs: when commands are captured and launched. The driver is played, so this runs without
a GPU."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from postfx.runtime import DeviceError, cuda
from postfx.runtime.cuda import MOST_CAPTURED_GRAPHS, CudaGraphs, CudaMemory, Event, Fork
from postfx.runtime.memory import Memory

STREAM = 77


class Driver:
    """The few functions of the driver that graphs take, and what was asked of them."""

    CUstreamCaptureMode = SimpleNamespace(CU_STREAM_CAPTURE_MODE_RELAXED=2)
    CUevent_record_flags = SimpleNamespace(CU_EVENT_RECORD_EXTERNAL=1)
    CUgraphNodeType = SimpleNamespace(CU_GRAPH_NODE_TYPE_KERNEL=0, CU_GRAPH_NODE_TYPE_HOST=3)

    def __init__(self) -> None:
        self.calls: list[tuple] = []
        self.made = 0
        self.end_status = 0
        self.nodes = [0, 0]

    def __getattr__(self, name: str):
        def call(*arguments: object) -> tuple:
            self.calls.append((name, *arguments))
            self.made += 1
            if name == "cuGraphGetNodes":
                return 0, [*range(len(self.nodes))] if arguments[1:] else [], len(self.nodes)
            if name == "cuGraphNodeGetType":
                return 0, self.nodes[arguments[0]]
            if name == "cuStreamEndCapture":
                return self.end_status, self.made
            return ((0, self.made) if name
                    in ("cuGraphInstantiate", "cuEventCreate", "cuEventElapsedTime") else (0,))

        return call

    def count(self, name: str) -> int:
        return sum(call[0] == name for call in self.calls)


@pytest.fixture
def driver(monkeypatch: pytest.MonkeyPatch) -> Driver:
    played = Driver()
    monkeypatch.setattr(cuda, "driver", lambda: played)
    return played


def test_captured_the_second_time_and_launched_from_then_on(driver: Driver) -> None:
    graphs, runs = CudaGraphs(STREAM), []

    def replay() -> object:
        return graphs.replay(
            "frame", "states", lambda: runs.append(graphs.capturing) or len(runs))

    assert replay() is None and not runs and not driver.calls
    assert replay() == 1 and runs == [True]
    assert replay() == 1 and replay() == 1
    assert runs == [True], "what was captured is not recorded again"
    assert driver.count("cuGraphLaunch") == 3 and driver.count("cuStreamBeginCapture") == 1
    assert not graphs.capturing


def test_each_set_of_commands_has_its_own(driver: Driver) -> None:
    graphs = CudaGraphs(STREAM)
    for _ in range(3):
        for key in ("even", "odd"):
            graphs.replay(key, None, lambda key=key: key)
    assert [graphs.replay(key, None, list) for key in ("even", "odd")] == ["even", "odd"]
    assert driver.count("cuGraphInstantiate") == 2


def test_what_cannot_be_captured_runs_one_by_one(driver: Driver) -> None:
    graphs = CudaGraphs(STREAM)

    def enqueue() -> None:
        mark = graphs.mark(STREAM)
        raise RuntimeError(f"operation not permitted when stream is capturing, after {mark}")

    assert [graphs.replay("frame", None, enqueue) for _ in range(4)] == [None] * 4
    assert driver.count("cuStreamBeginCapture") == 1 and driver.count("cuGraphLaunch") == 0
    assert driver.count("cuStreamEndCapture") == 1, "the stream has to leave its capture"
    assert driver.count("cuGraphInstantiate") == 0 and driver.count("cuGraphDestroy") == 1
    assert not graphs.capturing


def test_a_graph_keeps_events_that_nobody_else_keeps(driver: Driver) -> None:
    """The driver crashes where it makes a graph executable whose event is gone."""
    graphs = CudaGraphs(STREAM)

    def enqueue() -> list[object]:
        graphs.mark(STREAM)
        return []

    for _ in range(3):
        graphs.replay("frame", None, enqueue)
    assert driver.count("cuEventCreate") == 1 and driver.count("cuGraphLaunch") == 2
    assert driver.count("cuEventDestroy") == 0
    graphs = None
    assert driver.count("cuEventDestroy") == 1


def test_a_capture_that_the_driver_gave_up(driver: Driver) -> None:
    graphs, driver.end_status = CudaGraphs(STREAM), 901
    assert [graphs.replay("frame", None, lambda: "done") for _ in range(3)] == [None] * 3
    assert driver.count("cuGraphInstantiate") == 0


def test_what_calls_the_host_runs_one_by_one(driver: Driver) -> None:
    """Memory that such a call frees would be freed at every launch of the graph."""
    graphs, driver.nodes = CudaGraphs(STREAM), [0, 3, 0]
    assert [graphs.replay("frame", None, lambda: "done") for _ in range(3)] == [None] * 3
    assert driver.count("cuStreamBeginCapture") == 1 and driver.count("cuGraphInstantiate") == 0
    assert driver.count("cuGraphDestroy") == 1


def test_graphs_of_long_ago_are_dropped_and_made_anew(driver: Driver) -> None:
    graphs = CudaGraphs(STREAM)
    for key in range(MOST_CAPTURED_GRAPHS + 1):
        graphs.replay(key, None, lambda: True)
        graphs.replay(key, None, lambda: True)
    assert driver.count("cuGraphExecDestroy") == 1
    assert graphs.replay(1, None, list) is True
    assert graphs.replay(0, None, lambda: True) is None


def test_events_are_part_of_a_graph_while_one_is_captured(driver: Driver) -> None:
    first, second = Event(STREAM, captured=False), Event(STREAM, captured=True)
    flags = [call[3] for call in driver.calls if call[0] == "cuEventRecordWithFlags"]
    assert flags == [0, 1]
    assert first.until(second) > 0
    del first, second
    assert driver.count("cuEventDestroy") == 2


def test_errors_of_the_driver_are_named(driver: Driver, monkeypatch: pytest.MonkeyPatch) -> None:
    class Status(int):
        name = "CUDA_ERROR_OUT_OF_MEMORY"

    graphs = CudaGraphs(STREAM)
    graphs.replay("frame", None, list)
    monkeypatch.setattr(driver, "cuStreamBeginCapture", lambda *rest: (Status(2),), raising=False)
    with pytest.raises(DeviceError, match="CUDA: CUDA_ERROR_OUT_OF_MEMORY"):
        graphs.replay("frame", None, list)


class Streams(Driver):
    """Streams and events as CUDA orders them: for each stream, what is done before the next command
    on it."""

    def __init__(self) -> None:
        super().__init__()
        self.done: dict[int, set[object]] = {}
        self.events: dict[int, set[object]] = {}
        self.at: dict[int, set[object]] = {}

    def cuEventRecordWithFlags(self, event: int, stream: int, flags: int) -> tuple:  # noqa: N802
        if not flags:
            self.events[event] = set(self.done.setdefault(stream, set()))
        return (0,)

    def cuStreamWaitEvent(self, stream: int, event: int, flags: int) -> tuple:  # noqa: N802
        self.done.setdefault(stream, set()).update(self.events[event])
        return (0,)

    def command(self, number: int, stream: int):
        def execute() -> None:
            self.at[number] = set(self.done.setdefault(stream, set()))
            self.done[stream].add(number)

        return execute


@pytest.mark.parametrize("captured", [False, True])
def test_streams_wait_for_what_barriers_put_before(monkeypatch: pytest.MonkeyPatch,
                                                   captured: bool) -> None:
    """Commands 1 and 2 come after 0, 4 after all before it, 3 and 5 after none."""
    played, a, b = Streams(), 5, 6
    monkeypatch.setattr(cuda, "driver", lambda: played)
    played.done[STREAM] = {"earlier"}
    streams = [0, a, b, a, 0, b]
    fork = Fork(STREAM, streams, [0, 0b1, 0b1, 0, 0b1111, 0],
                lambda stream: Event(stream, captured))
    with fork:
        for number, stream in enumerate(streams):
            fork.run(number, played.command(number, stream or STREAM))
    order = {number: done - {"earlier"} for number, done in played.at.items()}
    assert order == {0: set(), 1: {0}, 2: {0}, 3: {0, 1}, 4: {0, 1, 2, 3},
                     5: {0, 2}}, "3 and 5 follow on their streams"
    assert all("earlier" in done for done in played.at.values())
    assert played.done[STREAM] == {"earlier", *range(6)}, "what comes later waits for all"


def test_memory_of_a_gpu_does_all_that_devices_ask_of_memory() -> None:
    wanted = {name for name in vars(Memory) if not name.startswith("_")}
    assert wanted >= {"allocate", "replay", "synchronise"}
    assert not wanted - set(dir(CudaMemory))


class Launches(Driver):
    """A GPU with 1000 bytes of shared memory that launches what it was allowed to, by kernel."""

    CUfunction = int
    CUfunction_attribute = SimpleNamespace(CU_FUNC_ATTRIBUTE_SHARED_SIZE_BYTES=1,
                                           CU_FUNC_ATTRIBUTE_MAX_DYNAMIC_SHARED_SIZE_BYTES=2)

    def __init__(self) -> None:
        super().__init__()
        self.allowed: dict[int, int] = {}

    def cuFuncGetAttribute(self, attribute: int, kernel: int) -> tuple:  # noqa: N802
        return 0, 100

    def cuFuncSetAttribute(self, kernel: int, attribute: int, value: int) -> tuple:  # noqa: N802
        self.allowed[kernel] = value
        return (0,)

    def cuLaunchKernel(self, kernel: int, *rest: int) -> tuple:  # noqa: N802
        class Status(int):
            name = "CUDA_ERROR_INVALID_VALUE"

        return (Status(rest[6] > self.allowed[kernel] or not rest[0]),)


def test_launches_of_a_kernel_with_less_and_more_shared_memory(
    monkeypatch: pytest.MonkeyPatch
) -> None:
    """A launch made later does not take away what an earlier one may have; one that is refused is
    described."""
    monkeypatch.setattr(cuda, "driver", lambda played=Launches(): played)  # noqa: B008
    monkeypatch.setattr(cuda, "_most_shared", lambda index: 1000)
    memory = CudaMemory.__new__(CudaMemory)
    memory._thread, memory.stream = SimpleNamespace(entered=True), STREAM
    runs = []
    for wanted, grid in ((800, (4, 1)), (300, (4, 1)), (5000, (4, 1)), (300, (0, 1))):
        function, shared = cuda._allow_shared(11, wanted, 0)
        runs.append(memory._launcher("convolve", None, function, grid, (256, 1), shared, []))
    for run in runs[:3]:
        run()
    with pytest.raises(DeviceError,
                       match=r"INVALID_VALUE for kernel 'convolve' with a grid of \(0, 1\), .* 300 "
                       r"bytes"):
        runs[3]()
