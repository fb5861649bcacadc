"""A CUDA GPU beside ONNX Runtime: its streams, its memory, kernels compiled from source when
needed, and CUDA graphs.

Commands that ran before on the same tensors are launched as one graph. Each family of kernels is a
source file; the constants of Python and code that all families share are compiled before it. A
plug-in's kernels come from files in its own folder, and share only the declaration of arguments
with ours.
"""

from __future__ import annotations

import ctypes
import itertools
import sys
import threading
from collections.abc import Callable, Hashable, Iterator, Sequence
from contextlib import contextmanager
from functools import cache, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from postfx.caching import LRUCache
from postfx.errors import DeviceError, ModelError
from postfx.frame import LOG
from postfx.kernels import Blocks, convolution_source, read_source
from postfx.runtime.convolutions import GROUP_THREADS, Launch, Options
from postfx.runtime.memory import CUDA, address
from postfx.version import pip_install

if TYPE_CHECKING:
    from postfx.runtime.tensor import Tensor

Made = TypeVar("Made")
SMALL_WRITE_BYTES = 1 << 14
"""Bytes of arrays, such as parameters, that are written without waiting."""

# Threads of a block (columns, rows): for kernels with one thread per pixel, and for those of a
# single block.
PIXELS = (32, 8)
ONE_BLOCK = (32, 32)


class View(ctypes.Structure):
    """A tensor in the layout that kernels expect: see postfx/kernels/view.cuh."""

    _fields_ = (("at", ctypes.c_void_p), ("size", ctypes.c_int * 4))


class CudaChunk:
    """A chunk of a GPU's memory."""

    def __init__(self, buffer: Any, nbytes: int) -> None:
        self._buffer = buffer
        self.pointer = int(buffer.handle)
        self.nbytes = nbytes


class CudaMemory:
    """One GPU: memory for tensors, the stream that all work runs on, others for what may run beside
    it, and compiled kernels.

    Raises DeviceError if there is no GPU or no library to drive it.
    """

    host_visible = False
    relax: Callable[[], None] | None = None

    def __init__(self, index: int, graphs: bool = True) -> None:
        try:
            from cuda.core import Device
        except ImportError:
            raise DeviceError("CUDA needs the package cuda-core: install it by "
                              f"{pip_install('cuda')}") from None
        self._device = Device(index)
        self.place = CUDA, index
        self._thread = threading.local()
        self._enter()
        self._stream = self._device.create_stream()
        self.stream = int(self._stream.handle)
        self.replays = graphs
        self._graphs = CudaGraphs(self.stream)
        self._lock = threading.RLock()
        self._beside: list[Any] = []
        self._producer: Event | None = None
        self._next = itertools.count()

    def free_bytes(self) -> int:
        """Bytes of the GPU's memory that no program holds now."""
        self._enter()
        free, _ = check_result(driver().cuMemGetInfo())
        return int(free)

    def stream_beside(self) -> int:
        """A stream for commands that run beside others; a few are used in turn."""
        with self._hold():
            place = next(self._next) % MOST_BESIDE
            if place == len(self._beside):
                self._beside.append(self._device.create_stream())
            return int(self._beside[place].handle)

    def fork(self, streams: Sequence[int], before: Sequence[int]) -> Fork | None:
        """Commands on streams of their own, see `Fork`; None if all are on the device's."""
        self._enter()
        return Fork(self.stream, streams, before, self._graphs.mark) if any(streams) else None

    def allocate(self, nbytes: int) -> CudaChunk:
        """A new chunk."""
        with self._hold():
            return CudaChunk(self._device.allocate(nbytes, stream=self._stream), nbytes)

    def write(self, pointer: int, array: np.ndarray) -> None:
        """Copy a C-contiguous host array to `pointer` once the stream's earlier work is done.
        Nothing waits for a small one: the driver keeps what it is given from pageable memory, as a
        new array's is."""
        with self._hold():
            small = array.nbytes <= SMALL_WRITE_BYTES
            given = array.copy() if small else array
            check_result(driver().cuMemcpyHtoDAsync(pointer, address(given), array.nbytes,
                                                    self.stream))
            if not small:
                self._stream.sync()

    def read(self, pointer: int, array: np.ndarray) -> None:
        """Copy from `pointer` into a C-contiguous host array once the stream's earlier work is
        done."""
        with self._hold():
            check_result(driver().cuMemcpyDtoHAsync(address(array), pointer, array.nbytes,
                                                    self.stream))
            self._stream.sync()

    def copy(self, target: int, source: int, nbytes: int) -> None:
        """Put a copy within the GPU's memory on the stream."""
        self._enter()
        check_result(driver().cuMemcpyDtoDAsync(target, source, nbytes, self.stream))

    def follow(self, stream: int | None) -> int:
        """Let what comes on the stream wait for the work that a producer's stream has now; the
        number of ours."""
        if stream is not None and stream != self.stream:
            with self._hold():
                if self._producer is None:
                    self._producer = Event(stream, False)
                else:  # as a wait is for what was recorded before it, one event serves all
                    self._producer.record(stream)
                _let_wait(self.stream, self._producer)
        return self.stream

    def mark(self) -> Event:
        """An event at this point of the stream."""
        self._enter()
        return self._graphs.mark(self.stream)

    def milliseconds(self, begin: Event, end: Event) -> float:
        """Time between two events that have both happened."""
        return begin.until(end)

    def replay(self, key: Hashable, kept: object, enqueue: Callable[[], Made]) -> Made | None:
        """Launch commands as one CUDA graph, see `CudaGraphs.replay`."""
        with self._hold():
            result: Made | None = self._graphs.replay(key, kept, enqueue)
            return result

    def synchronise(self) -> None:
        """Wait until the stream has nothing left to do."""
        self._enter()
        self._stream.sync()

    def launcher(
        self, name: str, source: Path, extent: tuple[int, int], blocks: Blocks | None,
        tensors: Sequence[Tensor]
    ) -> Callable[[], None]:
        """A function that puts a kernel of a source file on the stream.

        Args:
            extent: rows and columns of threads; there is one block if there are no columns.
            blocks: what there is instead.

        Raises ModelError when it cannot be compiled.
        """
        self._enter()
        kernel = _compile(name, read_source(source), self._device.arch, source.name)
        handle, shared = driver().CUfunction(int(kernel.handle)), 0
        rows, columns = extent
        block = PIXELS if columns else ONE_BLOCK
        grid = (-(-columns // block[0]), -(-rows // block[1])) if columns else (1, 1)
        views, between = [_view(tensor) for tensor in tensors], None
        if blocks:
            block, grid = (blocks.threads, 1), blocks.grid(rows, columns)
            handle, shared = _allow_shared(kernel.handle, blocks.shared, self.place[1])
        if blocks and blocks.between:
            zeros = np.zeros(blocks.between, np.float32)
            between = self.allocate(zeros.nbytes)
            self.write(between.pointer, zeros)
            views.append(View(between.pointer, (ctypes.c_int * 4)(blocks.between)))
        return self._launcher(name, (kernel, between), handle, grid, block, shared, views)

    @property
    def convolves(self) -> bool:
        """Whether it has what the kernels of `postfx.runtime.convolutions` need: they were written
        for GPUs of compute capability 8.0 and newer."""
        return bool(self._device.compute_capability >= (8, 0))

    @property
    def warpgroups(self) -> bool:
        """Whether groups of four warps multiply together, which is of this capability alone."""
        return bool(self._device.compute_capability == (9, 0))

    @property
    def processors(self) -> int:
        """How many processors run blocks of threads at once."""
        return int(self._device.properties.multiprocessor_count)

    @property
    def most_shared(self) -> int:
        """Bytes of shared memory that a block of threads may have."""
        return _most_shared(self.place[1])

    def convolution(self, launch: Launch, kernels: str, tensors: Sequence[Tensor | None],
                    options: Options) -> Callable[[], None]:
        """A function that puts a network's layer on the stream.

        Args:
            kernels: source of the kernels of all layers.
            tensors: by the order of the kernel's arguments, None for those that this layer has not.

        Raises ModelError when they cannot be compiled.
        """
        self._enter()
        arch = f"{self._device.arch}{'a' * self.warpgroups}"
        kernel = _compile(launch.name, convolution_source(self.warpgroups) + kernels, arch,
                          "convolution.cuh")
        handle, shared = _allow_shared(kernel.handle, launch.shared, self.place[1])
        threads, tiles = launch.groups * GROUP_THREADS, launch.tiles
        held = driver().cuOccupancyMaxActiveBlocksPerMultiprocessor(handle, threads, shared)
        # blocks that run at once go on to the other pixels
        at_once = max(1, int(check_result(held)) * self.processors // tiles)
        blocks = min(at_once, -(-launch.squares // launch.groups)) * tiles
        views = [View() if tensor is None else _view(tensor) for tensor in tensors]
        return self._launcher(launch.name, kernel, handle, (blocks, 1), (threads, 1), shared,
                              [*views, options])

    def _launcher(self, name: str, kept: Any, handle: Any, grid: tuple[int, int],
                  block: tuple[int, int], shared: int,
                  given: Sequence[ctypes.Structure]) -> Callable[[], None]:
        """A function that launches a kernel. kept: what must live as long as it does."""
        arguments = (ctypes.c_void_p * len(given))(*map(ctypes.addressof, given))
        launch = partial(driver().cuLaunchKernel, handle, *grid, 1, *block, 1, shared, self.stream)

        # keeps the arguments' memory alive
        def run(held: tuple[object, ...] = (kept, given)) -> None:
            self._enter()
            (status,) = launch(ctypes.addressof(arguments), 0)
            if int(status):
                raise DeviceError(f"CUDA: {status.name} for kernel '{name}' with a grid of {grid}, "
                                  f"blocks of {block} threads and {shared} bytes of shared memory")

        return run

    @contextmanager
    def _hold(self) -> Iterator[None]:
        """Hold the stream alone: work that other threads add during a capture would become part of
        the graph."""
        with self._lock:
            self._enter()
            yield

    def _enter(self) -> None:
        """Make this GPU the current one of this thread."""
        if not hasattr(self._thread, "entered"):
            self._device.set_current()
            self._thread.entered = True


def _allow_shared(kernel: Any, wanted: int, index: int) -> tuple[Any, int]:
    """A kernel's function in the current context, and how many bytes of dynamic shared memory a
    launch takes: those that are wanted, or as many as the GPU has. That many are allowed, as other
    launches of it may take more."""
    attributes = driver().CUfunction_attribute
    is_function = isinstance(kernel, driver().CUfunction)
    function = kernel if is_function else check_result(driver().cuKernelGetFunction(int(kernel)))
    fixed = check_result(driver().cuFuncGetAttribute(attributes.CU_FUNC_ATTRIBUTE_SHARED_SIZE_BYTES,
                                                     function))
    most = _most_shared(index) - int(fixed)
    allowed = attributes.CU_FUNC_ATTRIBUTE_MAX_DYNAMIC_SHARED_SIZE_BYTES
    check_result(driver().cuFuncSetAttribute(function, allowed, most))
    return function, min(wanted, most)


def _most_shared(index: int) -> int:
    most = driver().CUdevice_attribute.CU_DEVICE_ATTRIBUTE_MAX_SHARED_MEMORY_PER_BLOCK_OPTIN
    return int(check_result(driver()
                            .cuDeviceGetAttribute(most, check_result(driver().cuDeviceGet(index)))))


def _view(tensor: Tensor) -> View:
    return View(tensor.start, (ctypes.c_int * 4)(*tensor.shape[:4]))


@cache
def _compile(name: str, source: str, arch: str, file: str) -> Any:
    try:
        return _compile_family(source, arch).get_kernel(name)
    except Exception as error:
        raise ModelError(f"kernel '{name}' of {file} cannot be compiled for sm_{arch}: "
                         f"{error}") from error


@cache
def _compile_family(source: str, arch: str) -> Any:
    """All kernels of a source, compiled together to save time."""
    from cuda.core import Program, ProgramOptions

    return Program(source, "c++", ProgramOptions(arch=f"sm_{arch}", std="c++17")).compile("cubin")


MOST_BESIDE = 4
"""Streams beside the device's own. Networks that share one run one after the other."""


class Fork:
    """Commands on several streams: each waits for those that barriers put before it, and no others.

    The streams begin after what the device's stream holds now. At the end of a `with` block that
    one waits for all of them, so whatever comes later does not have to know of them. It may become
    part of a graph that is being captured.

    Args:
        own: the device's stream.
        streams: of each command, 0 for the device's.
        before: the commands before each one, as a bit mask of indices.
        mark: makes an event at this point of a stream, see `CudaGraphs.mark`.
    """

    def __init__(self, own: int, streams: Sequence[int], before: Sequence[int],
                 mark: Callable[[int], Event]) -> None:
        self._own, self._streams = own, [stream or own for stream in streams]
        self._before, self._mark = before, mark
        self._begun = Event(own, False)
        self._last: dict[int, Event] = {}
        self._ends: dict[int, Event] = {}

    def run(self, index: int, execute: Callable[[], None]) -> tuple[Event, Event]:
        """Put a command on its stream; the marks around it."""
        stream = self._streams[index]
        if stream not in self._last:
            _let_wait(stream, self._begun)
        before = [other for other in self._ends if self._before[index] >> other & 1]
        # the last one of each
        for event in {self._streams[other]: self._ends[other] for other in before}.values():
            _let_wait(stream, event)
        begin = self._mark(stream)
        execute()
        end = self._mark(stream)
        self._last[stream] = self._ends[index] = Event(stream, False)
        return begin, end

    def __enter__(self) -> None:
        """Nothing: the streams begin with the first command."""

    def __exit__(self, *exception: object) -> None:
        """Let the device's stream wait for all others."""
        for stream, event in self._last.items():
            if stream != self._own:
                _let_wait(self._own, event)


def _let_wait(stream: int, event: Event) -> None:
    check_result(driver().cuStreamWaitEvent(stream, event.handle, 0))


MOST_CAPTURED_GRAPHS = 16
"""Graphs that are kept. A pipeline needs two, because its history alternates between two sets of
tensors."""


class Event:
    """A point in a stream's work; becomes part of a graph that is being captured."""

    def __init__(self, stream: int, captured: bool) -> None:
        self.handle = check_result(driver().cuEventCreate(0))
        self.record(stream, captured)

    def record(self, stream: int, captured: bool = False) -> None:
        """Be what a stream has to do now, from now on."""
        external = driver().CUevent_record_flags.CU_EVENT_RECORD_EXTERNAL if captured else 0
        check_result(driver().cuEventRecordWithFlags(self.handle, stream, int(external)))

    def until(self, end: Event) -> float:
        """Milliseconds from this event to another. Both must have happened."""
        return float(check_result(driver().cuEventElapsedTime(self.handle, end.handle)))

    def __del__(self) -> None:
        if hasattr(self, "handle") and not sys.is_finalizing():
            driver().cuEventDestroy(self.handle)


class Graph:
    """A captured graph, the capturing function's result, and the objects that must live as long as
    the graph."""

    def __init__(self, captured: Any, result: Any, kept: Any) -> None:
        self.result = result
        self._kept = kept
        try:
            self._executable = check_result(driver().cuGraphInstantiate(captured, 0))
        finally:
            driver().cuGraphDestroy(captured)

    def launch(self, stream: int) -> None:
        """Put the graph on a stream."""
        check_result(driver().cuGraphLaunch(self._executable, stream))

    def __del__(self) -> None:
        if hasattr(self, "_executable") and not sys.is_finalizing():
            driver().cuGraphExecDestroy(self._executable)


class CudaGraphs:
    """Graphs of one stream, by a key that identifies their commands.

    Commands run one by one the first time, when libraries choose algorithms and allocate memory,
    and are captured the second time. Commands that cannot be captured always run one by one.
    """

    def __init__(self, stream: int) -> None:
        self._stream = stream
        # None: ran, but was not captured
        self._known: LRUCache[Hashable, Graph | None] = LRUCache(MOST_CAPTURED_GRAPHS)
        self._refused: LRUCache[Hashable, None] = LRUCache(MOST_CAPTURED_GRAPHS)
        self._captured_events: list[Event] = []
        self.capturing = False

    def mark(self, stream: int) -> Event:
        """An event at this point of a stream. A graph that is being captured keeps it: the driver
        crashes where a graph is made executable after one of its events is gone."""
        event = Event(stream, self.capturing)
        if self.capturing:
            self._captured_events.append(event)
        return event

    def replay(self, key: Hashable, kept: Any, enqueue: Callable[[], Any]) -> Any:
        """Launch the work of `enqueue` as a graph and return its result; None if it has to run
        command by command."""
        if key in self._refused:
            return None
        if key not in self._known:
            self._known[key] = None
            return None
        graph = self._known[key] or self._capture(enqueue, kept)
        if graph is None:
            self._refused[key] = None
            return None
        self._known[key] = graph
        graph.launch(self._stream)
        return graph.result

    def _capture(self, enqueue: Callable[[], Any], kept: Any) -> Graph | None:
        """The graph of the commands that are enqueued; None where they cannot be captured."""
        mode = driver().CUstreamCaptureMode.CU_STREAM_CAPTURE_MODE_RELAXED
        check_result(driver().cuStreamBeginCapture(self._stream, mode))
        self.capturing, self._captured_events, result = True, [], None
        try:
            result = enqueue()
        except Exception:  # not capturable: it runs one by one, which raises its errors
            LOG.debug("commands cannot be captured as a CUDA graph", exc_info=True)
        finally:
            self.capturing = False
            status, captured = driver().cuStreamEndCapture(self._stream)
        if int(status):
            LOG.debug("commands cannot be one CUDA graph: %s", status)
            return None
        if result is None:  # what was captured before the error is a part
            driver().cuGraphDestroy(captured)
            return None
        if _calls_host(captured):
            LOG.debug("commands call the host once they are done: no CUDA graph")
            driver().cuGraphDestroy(captured)
            return None
        return Graph(captured, result, (kept, self._captured_events))


def _calls_host(graph: Any) -> bool:
    """Whether a captured graph has functions of the host. ONNX Runtime puts one on a stream to free
    memory after a copy from the host, once: a graph that is replayed would free it again."""
    _, count = check_result(driver().cuGraphGetNodes(graph))
    nodes, _ = check_result(driver().cuGraphGetNodes(graph, count)) if count else ((), 0)
    host = driver().CUgraphNodeType.CU_GRAPH_NODE_TYPE_HOST
    return any(int(check_result(driver().cuGraphNodeGetType(node))) == int(host) for node in nodes)


@cache
def driver() -> Any:
    """Module of the driver's functions, each of which returns its status first."""
    from cuda.bindings import driver as module

    return module


def check_result(result: tuple[Any, ...]) -> Any:
    """The result of a driver function without its status. Raises DeviceError if the status is a
    failure."""
    if int(result[0]):
        raise DeviceError(f"CUDA: {result[0].name}")
    return result[1] if len(result) == 2 else result[1:] or None
