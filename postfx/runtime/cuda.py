"""A CUDA GPU beside ONNX Runtime: its stream, its memory, and kernels that are compiled from source when needed."""

from __future__ import annotations

import ctypes
import threading
from collections.abc import Callable, Sequence
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from postfx.runtime.errors import DeviceError, ModelError
from postfx.runtime.memory import address

if TYPE_CHECKING:
    from postfx.runtime.tensor import Tensor

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

    def __init__(self, index: int) -> None:
        try:
            from cuda.core import Device
        except ImportError:
            raise DeviceError("CUDA needs the package cuda-core: install it by pip install 'postfx[cuda]'") from None
        self._device = Device(index)
        self._thread = threading.local()
        self._enter()
        self._stream = self._device.create_stream()
        self.stream = int(self._stream.handle)

    def allocate(self, nbytes: int) -> CudaChunk:
        """A new chunk."""
        self._enter()
        return CudaChunk(self._device.allocate(nbytes, stream=self._stream), nbytes)

    def write(self, pointer: int, array: np.ndarray) -> None:
        """Copy a C-contiguous host array to `pointer`, after what the stream has to do."""
        self._enter()
        _checked(_driver().cuMemcpyHtoDAsync(pointer, address(array), array.nbytes, self.stream))
        self._stream.sync()

    def read(self, pointer: int, array: np.ndarray) -> None:
        """Copy from `pointer` into a C-contiguous host array, after what the stream has to do."""
        self._enter()
        _checked(_driver().cuMemcpyDtoHAsync(address(array), pointer, array.nbytes, self.stream))
        self._stream.sync()

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
        launch, handle, stream = _driver().cuLaunchKernel, _driver().CUfunction(int(kernel.handle)), self.stream

        def run(held: tuple = (kernel, views)) -> None:  # what the arguments point at lives as long as the function
            self._enter()
            _checked(launch(handle, *grid, 1, *block, 1, 0, stream, ctypes.addressof(arguments), 0))

        return run

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
def _driver() -> Any:
    from cuda.bindings import driver

    return driver


def _checked(result: tuple) -> None:
    if int(result[0]):
        raise DeviceError(f"CUDA: {result[0].name}")


@cache
def _compiled(name: str, arch: str) -> Any:
    from cuda.core import Program, ProgramOptions

    source = (SOURCES / "common.cuh").read_text() + (SOURCES / f"{name}.cu").read_text()
    try:
        code = Program(source, "c++", ProgramOptions(arch=f"sm_{arch}", std="c++17")).compile("cubin")
    except Exception as error:
        raise ModelError(f"kernel '{name}' cannot be compiled for sm_{arch}: {error}") from error
    return code.get_kernel(name)
