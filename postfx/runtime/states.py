"""States: a network or kernel made ready to run, with the bindings that it declares."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple, Protocol

from postfx.runtime.bands import Band
from postfx.runtime.session import Session
from postfx.runtime.tensor import Tensor

if TYPE_CHECKING:
    from postfx.kernels.kernel import Kernel
    from postfx.runtime.cuda import CudaMemory
    from postfx.runtime.device import Device

MINIMUM_ROWS = 4
"""Fewer rows than this are not worth a band of their own."""


class Binding(NamedTuple):
    """One argument of a network or kernel.

    `shape` is None where a kernel leaves it open, and may hold symbols ('height', '2*width') in kernels only.
    """

    name: str
    access: str
    shape: tuple[int | str, ...] | None
    dtype: str


class State(Protocol):
    """What an argument table is made for and an encoder dispatches; `model` is a network's file, `capturable` tells
    whether it may become part of a CUDA graph."""

    device: Device
    command: str
    stage: str
    model: Path | None
    capturable: bool
    bindings: tuple[Binding, ...]

    def prepare(self, tensors: Sequence[Tensor]) -> Callable[[], None]:
        """A function that runs the state on tensors given in the order of `bindings`; nothing is copied."""
        ...


class PipelineState:
    """A network with fixed dimensions. Made by `Device.pipeline_state`.

    Attributes:
        bindings: of what a dispatch reads and writes.
        constants: name -> array of outputs that no input changes. They are not bound: on a GPU, ONNX Runtime would copy
            them beside the stream that all other work is on, early or late.
    """

    stage = "machine-learning"
    capturable = True

    def __init__(self, device: Device, name: str, session: Session, dims: dict[str, int], model: Path,
                 constants: Sequence[str] = ()) -> None:
        self.device = device
        self.name = name
        self.dims = dims
        self.model = model
        self.command = f"network '{name}'"
        self.bindings = tuple(binding for binding in _session_bindings(session) if binding.name not in constants)
        self.constants = session.constants(constants)
        self._session = session

    def prepare(self, tensors: Sequence[Tensor]) -> Callable[[], None]:
        """A function that runs the network on bound tensors."""
        return _bind_session(self._session, self.bindings, tensors)


class ComputeState:
    """A kernel made ready to run on a device. Made by `Device.compute_state`."""

    stage = "compute"
    model = None
    capturable = True

    def __init__(self, device: Device, kernel: Kernel) -> None:
        self.device = device
        self.name = kernel.name
        self.command = f"kernel '{kernel.name}'"
        self.bindings = kernel_bindings(kernel)
        self._row_axis = kernel.row_axis

    def _extent(self, tensors: Sequence[Tensor]) -> tuple[int, ...]:
        """Rows of the kernel's work, and the axes after them."""
        name, axis = self._row_axis
        (written,) = (tensor for binding, tensor in zip(self.bindings, tensors, strict=True) if binding.name == name)
        return written.shape[axis:]


class PortableComputeState(ComputeState):
    """A kernel that runs by its portable ONNX definition, of which some operators wait for the GPU."""

    capturable = False

    def __init__(self, device: Device, kernel: Kernel, session: Session) -> None:
        super().__init__(device, kernel)
        self._session = session

    def prepare(self, tensors: Sequence[Tensor]) -> Callable[[], None]:
        """A function that runs the portable definition on bound tensors."""
        return _bind_session(self._session, self.bindings, tensors)


class CompiledComputeState(ComputeState):
    """A kernel that runs by its compiled rows, in bands over the device's threads."""

    def __init__(self, device: Device, kernel: Kernel) -> None:
        super().__init__(device, kernel)
        self._rows = kernel.rows
        _compile_rows(kernel, self.bindings)

    def prepare(self, tensors: Sequence[Tensor]) -> Callable[[], None]:
        """A function that runs the rows on bound tensors."""
        arrays = [tensor.host_view() for tensor in tensors]
        count, scratch = self._extent(tensors)[0], self.device.scratch
        if scratch is None:
            return lambda: self._run(0, count, arrays)
        row_bytes = sum(tensor.nbytes for tensor in tensors) // max(1, count)
        return lambda: [self._run(first, last, arrays) for first, last in scratch.pieces(count, row_bytes)]

    def _run(self, first: int, last: int, arrays: list) -> None:
        count = min(self.device.threads, (last - first) // MINIMUM_ROWS)
        if count < 2:
            self._rows(first, last, *arrays)
            return
        edges = [first + (last - first) * band // count for band in range(count + 1)]
        self.device.helpers.work([Band(self._rows, *edge, arrays) for edge in pairwise(edges)])


class CudaComputeState(ComputeState):
    """A kernel that runs by its CUDA source."""

    def __init__(self, device: Device, kernel: Kernel, memory: CudaMemory) -> None:
        super().__init__(device, kernel)
        self._memory = memory

    def prepare(self, tensors: Sequence[Tensor]) -> Callable[[], None]:
        """A function that puts the kernel on the GPU's stream."""
        rows, *columns = self._extent(tensors)
        return self._memory.launcher(self.name, columns[0] if columns else 0, rows, tensors)


def kernel_bindings(kernel: Kernel) -> tuple[Binding, ...]:
    """Bindings of a kernel in argument order."""
    named = [(name, "read") for name in kernel.reads] + [(name, "write") for name in kernel.writes]
    shapes = {name: tuple(shape) for name, shape in kernel.shapes.items()}
    return tuple(Binding(name, access, shapes.get(name), kernel.types.get(name, "float32")) for name, access in named)


def _compile_rows(kernel: Kernel, bindings: tuple[Binding, ...]) -> None:
    """Compile before the first frame when the ranks are known and `rows` is a Numba function."""
    compile_for = getattr(kernel.rows, "compile", None)
    if compile_for is None or any(binding.shape is None for binding in bindings):
        return
    from numba import types

    arrays = [types.Array(types.float32, len(binding.shape), "C") for binding in bindings]
    compile_for((types.int64, types.int64, *arrays))


def _session_bindings(session: Session) -> tuple[Binding, ...]:
    reads = [Binding(value.name, "read", value.shape, value.dtype) for value in session.inputs]
    writes = [Binding(value.name, "write", value.shape, value.dtype) for value in session.outputs]
    return tuple(reads + writes)


def _bind_session(session: Session, bindings: tuple[Binding, ...], tensors: Sequence[Tensor]) -> Callable[[], None]:
    bound = {binding.name: tensor for binding, tensor in zip(bindings, tensors, strict=True)}
    return session.bind(
        {binding.name: bound[binding.name] for binding in bindings if binding.access == "read"},
        {binding.name: bound[binding.name] for binding in bindings if binding.access == "write"},
    )
