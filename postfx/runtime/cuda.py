"""A CUDA GPU beside ONNX Runtime: its stream, its memory, and kernels that are compiled from source when needed."""

from __future__ import annotations

import ctypes
import threading
from collections.abc import Callable, Hashable, Iterator, Sequence
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from postfx.errors import DeviceError, ModelError
from postfx.runtime.cuda_driver import checked, driver
from postfx.runtime.cuda_graphs import CudaGraphs, Event
from postfx.runtime.memory import address

if TYPE_CHECKING:
    from postfx.runtime.tensor import Tensor

T = TypeVar("T")
SOURCES = Path(__file__).parents[1] / "kernels" / "cuda"
PIXELS, ONE_BLOCK = (32, 8), (32, 32)
"""Threads of a block, columns and rows: of kernels with a thread a pixel, and of those that are one block."""


class View(ctypes.Structure):
    """A tensor as kernels take it: see postfx/kernels/cuda/common.cuh."""

    _fields_ = (("at", ctypes.c_void_p), ("size", ctypes.c_int * 4))


class CudaChunk:
    """A chunk of a GPU's memory."""

    def __init__(self, buffer: Any, nbytes: int) -> None:
        self._buffer = buffer
        self.pointer = int(buffer.handle)
        self.nbytes = nbytes


class CudaMemory:
    """One GPU: memory that tensors live in, the stream that all its work is on, and its kernels.

    Raises DeviceError where there is no GPU, or no library to talk to it.
    """

    host_visible = False

    def __init__(self, index: int, graphs: bool = True) -> None:
        try:
            from cuda.core import Device
        except ImportError:
            raise DeviceError("CUDA needs the package cuda-core: install it by pip install 'postfx[cuda]'") from None
        self._device = Device(index)
        self._thread = threading.local()
        self._enter()
        self._stream = self._device.create_stream()
        self.stream = int(self._stream.handle)
        self.replays = graphs
        self._graphs = CudaGraphs(self.stream)
        self._lock = threading.RLock()

    def allocate(self, nbytes: int) -> CudaChunk:
        """A new chunk."""
        with self._entered():
            return CudaChunk(self._device.allocate(nbytes, stream=self._stream), nbytes)

    def write(self, pointer: int, array: np.ndarray) -> None:
        """Copy a C-contiguous host array to `pointer`, after what the stream has to do."""
        with self._entered():
            checked(driver().cuMemcpyHtoDAsync(pointer, address(array), array.nbytes, self.stream))
            self._stream.sync()

    def read(self, pointer: int, array: np.ndarray) -> None:
        """Copy from `pointer` into a C-contiguous host array, after what the stream has to do."""
        with self._entered():
            checked(driver().cuMemcpyDtoHAsync(address(array), pointer, array.nbytes, self.stream))
            self._stream.sync()

    def relax(self) -> None:
        """All is kept: nothing lies in files."""

    def mark(self) -> Event:
        """This moment on the stream."""
        self._enter()
        return Event(self.stream, self._graphs.capturing)

    def milliseconds(self, begin: Event, end: Event) -> float:
        """From one moment to another that have both passed."""
        return begin.until(end)

    def replay(self, key: Hashable, kept: object, enqueue: Callable[[], T]) -> T | None:
        """Launch commands as one CUDA graph, see `CudaGraphs.replay`."""
        with self._entered():
            return self._graphs.replay(key, kept, enqueue)

    def synchronise(self) -> None:
        """Wait until the stream has nothing left to do."""
        self._enter()
        self._stream.sync()

    def launcher(self, name: str, columns: int, rows: int, tensors: Sequence[Tensor]) -> Callable[[], None]:
        """A function that puts a kernel on the stream, with a thread for each pixel, or in one block without columns.

        Raises ModelError when it cannot be compiled.
        """
        self._enter()
        kernel = _compiled(name, self._device.arch)
        block = PIXELS if columns else ONE_BLOCK
        grid = (-(-columns // block[0]), -(-rows // block[1])) if columns else (1, 1)
        views = [View(tensor.start, (ctypes.c_int * 4)(*tensor.shape[:4])) for tensor in tensors]
        arguments = (ctypes.c_void_p * len(views))(*map(ctypes.addressof, views))
        launch, handle, stream = driver().cuLaunchKernel, driver().CUfunction(int(kernel.handle)), self.stream

        def run(held: tuple = (kernel, views)) -> None:  # what the arguments point at lives as long as the function
            self._enter()
            checked(launch(handle, *grid, 1, *block, 1, 0, stream, ctypes.addressof(arguments), 0))

        return run

    @contextmanager
    def _entered(self) -> Iterator[None]:
        """Alone on the stream: what others put there while a graph is captured would become a part of it."""
        with self._lock:
            self._enter()
            yield

    def _enter(self) -> None:
        """Make the GPU the one that this thread talks to."""
        if not hasattr(self._thread, "entered"):
            self._device.set_current()
            self._thread.entered = True


@cache
def has_source(name: str) -> bool:
    """Whether a kernel is written for CUDA."""
    return (SOURCES / f"{name}.cu").exists()


@cache
def _compiled(name: str, arch: str) -> Any:
    from cuda.core import Program, ProgramOptions

    source = (SOURCES / "common.cuh").read_text() + (SOURCES / f"{name}.cu").read_text()
    try:
        code = Program(source, "c++", ProgramOptions(arch=f"sm_{arch}", std="c++17")).compile("cubin")
    except Exception as error:
        raise ModelError(f"kernel '{name}' cannot be compiled for sm_{arch}: {error}") from error
    return code.get_kernel(name)
