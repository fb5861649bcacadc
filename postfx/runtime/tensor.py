"""Named tensors on a device, the allocations behind them, and their state: what may be done with
them now."""

from __future__ import annotations

import math
import weakref
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any, NamedTuple, Protocol

import numpy as np

from postfx.errors import BindingError, CommandError, DeviceError, HazardError
from postfx.runtime.memory import (
    CUDA,
    MappedChunk,
    Memory,
    Ranges,
    address,
    is_as_lent,
    lend,
    view_at,
)
from postfx.system import Scratch


class Use(NamedTuple):
    """A command that uses a tensor: the labels of its encoder and command buffer, and its name."""

    label: str
    command: str
    buffer: str

    def __str__(self) -> str:
        return f"'{self.label}' ({self.command}) of '{self.buffer}'"


@dataclass(frozen=True)
class TensorState:
    """The state of a tensor, from `Tensor.state`. A command is in flight from commit until the host
    has waited for it.

    Attributes:
        released: whether its memory was returned.
        defined: every byte holds data, or will once the committed commands have run.
        writer: the last command in flight that writes it.
        reader: the last command in flight that reads it.
        recorded: the first uncommitted command that uses it.
        failed: the error of the command whose failure left it undefined.
        lost: why a transient tensor lost its content, as a clause.
    """

    released: bool
    defined: bool
    writer: Use | None
    reader: Use | None
    recorded: Use | None
    failed: CommandError | None
    lost: str | None = None

    @property
    def kind(self) -> str:
        """'released', 'being written', 'being read', 'defined' or 'undefined': the first that
        holds."""
        if self.released:
            return "released"
        if self.writer or self.reader:
            return "being written" if self.writer else "being read"
        return "defined" if self.defined else "undefined"

    def __str__(self) -> str:
        user = self.writer or self.reader
        return f"{self.kind} by {user}" if user and not self.released else self.kind


def refuse_host_read(name: str, state: TensorState) -> None:
    """Raises HazardError if the tensor was released, a command in flight writes it, or it has no
    data."""
    _check_alive(name, state)
    if state.lost:
        message = f"transient '{name}' is read by the host, but {state.lost}"
        raise HazardError(message, "read before write", name, None, "host")
    if state.writer:
        raise _in_use(name, "reads", state.writer, "writes")
    if state.failed:
        message = (f"'{name}' is read by the host, but {state.failed}: commit that again, or "
                   f"upload to '{name}'")
        raise HazardError(message, "read before write", name, state.failed.label, "host")
    if not state.defined:
        message = (f"'{name}' is read by the host, but no command wrote it and nothing was "
                   "uploaded to it")
        raise HazardError(message, "read before write", name, None, "host")


def refuse_host_write(tensor: Tensor, state: TensorState) -> None:
    """Raises BindingError if only commands may write the tensor, or nothing may; HazardError if it
    was released, or a recorded command or one in flight uses it."""
    name = tensor.name
    if tensor.allocation.transient:
        raise BindingError(f"tensor '{name}' is transient, so only commands write it: use "
                           "heap.tensor for one that the host writes")
    if not tensor.allocation.writable:
        raise BindingError(f"tensor '{name}' wraps a read-only array: it cannot be written")
    _check_alive(name, state)
    if state.writer:
        raise _in_use(name, "writes", state.writer, "writes")
    if state.reader:
        raise _in_use(name, "writes", state.reader, "reads")
    if state.recorded:
        fix = ("it runs after commit and would see the new values, so upload to another tensor "
               "before recording")
        message = f"the host writes '{name}' while {state.recorded} uses it: {fix}"
        raise HazardError(message, "host access", name, state.recorded.label, "host")


def _check_alive(name: str, state: TensorState) -> None:
    if state.released:
        raise HazardError(f"tensor '{name}' was released: make a new one", "released", name, None,
                          "host")


def _in_use(name: str, verb: str, use: Use, does: str) -> HazardError:
    message = f"the host {verb} '{name}' while {use} {does} it: wait() for '{use.buffer}' first"
    return HazardError(message, "host access", name, use.label, "host")


class TensorDevice(Protocol):
    """What a tensor needs of the device that holds it."""

    @property
    def name(self) -> str: ...

    @property
    def memory(self) -> Memory: ...

    @property
    def scratch(self) -> Scratch | None: ...

    @property
    def hazards(self) -> ContentStates: ...

    @property
    def heap(self) -> TensorHeap: ...


class ContentStates(Protocol):
    """Knows which tensors hold data, and which commands use them."""

    def state(self, tensor: Tensor) -> TensorState: ...

    def check_host_read(self, tensor: Tensor) -> None: ...

    def check_host_write(self, tensor: Tensor) -> None: ...

    def mark_written(self, tensor: Tensor) -> None: ...


class TensorHeap(Protocol):
    """Where tensors get their memory."""

    def tensor(self, name: str, shape: tuple[int, ...], dtype: str = "float32") -> Tensor: ...

    def trim(self) -> None: ...

    def note_arena(self, nbytes: int) -> None: ...

    def explain_loss(self, transient: Transient) -> str | None: ...


DTYPES = ("float32", "float16", "bfloat16", "float64", "int64", "int32", "int16", "int8", "uint64",
          "uint32", "uint16", "uint8", "bool")
"""Element types a tensor may have."""


@cache
def element_type(dtype: str) -> np.dtype[Any]:
    """NumPy's type of a tensor's elements. Raises BindingError for bfloat16 without the package
    ml_dtypes."""
    if dtype != "bfloat16":
        return np.dtype(dtype)
    try:
        from ml_dtypes import bfloat16
    except ImportError:
        fix = "pip install ml_dtypes"
        raise BindingError("tensors of bfloat16, which NumPy has not, need the package ml_dtypes: "
                           f"{fix}") from None
    found: np.dtype[Any] = np.dtype(bfloat16)
    return found


@cache
def name_of(dtype: np.dtype[Any]) -> str:
    """The name of NumPy's type, which it makes anew each time."""
    return dtype.name


def size_in_bytes(shape: tuple[int, ...], dtype: str) -> int:
    """Bytes of a contiguous tensor."""
    return math.prod(shape) * element_type(dtype).itemsize


class Allocation:
    """A stretch of device memory that one tensor and its views share.

    Attributes:
        written: bytes that hold data once every committed command has run.
        lost: bytes among them that a command failed to write, with its error; usually empty.
        transient: whether it holds data within one command buffer only, see `Heap.transient`.
        place: the memory of a `Transient` in the last buffer that used it.
        borrowed: whether the memory is another owner's, such as a wrapped array.
    """

    def __init__(
        self, name: str, pointer: int, nbytes: int, owner: object, writable: bool = True,
        transient: bool = False
    ) -> None:
        self.name = name
        self.pointer = pointer
        self.nbytes = nbytes
        self.owner = owner
        self.writable = writable
        self.transient = transient
        self.borrowed = not transient
        self.place: Allocation | None = None
        self.released = False
        self.written = Ranges()
        self.lost: list[tuple[Ranges, CommandError]] = []
        self._finalizer: weakref.finalize[..., Allocation] | None = None

    def on_release(self, action: Callable[..., None], *args: Any) -> None:
        """Call `action(*args)` once: on release, or when nothing refers to the allocation any
        more."""
        self.borrowed = False
        self._finalizer = weakref.finalize(self, action, *args)
        self._finalizer.atexit = False

    def release(self) -> None:
        """Return the memory; every tensor on it becomes unusable."""
        self.released = True
        if self._finalizer is not None:
            self._finalizer()


class Transient(Allocation):
    """The allocation of a transient tensor, which gets memory when a buffer that uses it is
    committed.

    Attributes:
        place: its memory in the last such buffer.
        successor: name of the tensor that took the memory later in that buffer, or None.
        turn: number of that placement in the arena.
        needs: bytes of the largest plan that placed it.
    """

    def __init__(self, name: str, pointer: int, nbytes: int) -> None:
        super().__init__(name, pointer, nbytes, owner=None, transient=True)
        self.successor: str | None = None
        self.turn = self.needs = 0

    def at(self, memory: Tensor, offset: int) -> Allocation:
        """Its allocation at this place; the same object as last time if the place has not
        changed."""
        pointer = memory.start + offset
        if self.place is None or self.place.owner is not memory or self.place.pointer != pointer:
            return Allocation(self.name, pointer, self.nbytes, owner=memory, transient=True)
        return self.place


class Tensor:
    """A tensor on a device.

    Made by `device.heap.tensor` (undefined content), `device.heap.transient` (content within a
    command buffer) or `device.wrap` (content of a NumPy array).

    Attributes:
        device: that holds it.
        start, end: its addresses.
        span: its byte range inside its allocation.
        contiguous: whether its elements lie in order without gaps; if not, `strided` was given, the
            array that it wraps in the host's memory. What runs on it works on a contiguous copy,
            which costs a copy each time.
    """

    def __init__(
        self, device: TensorDevice, name: str, shape: tuple[int, ...], dtype: str,
        allocation: Allocation, offset: int = 0, strided: np.ndarray | None = None
    ) -> None:
        if dtype not in DTYPES:
            raise BindingError(f"tensor '{name}' cannot be of type {dtype}: use one of "
                               f"{', '.join(DTYPES)}")
        self.contiguous = strided is None
        self._put = b""
        self.device = device
        self.name = name
        self.shape = tuple(map(int, shape))
        self.dtype = dtype
        self.allocation = allocation
        self.nbytes = size_in_bytes(self.shape, dtype)
        self.start = allocation.pointer + offset
        self.end = self.start + (self.nbytes if self.contiguous else allocation.nbytes)
        self.span = offset, self.end - allocation.pointer
        self._host = strided
        self._resident: Tensor | None = None

    def __repr__(self) -> str:
        return f"Tensor('{self.name}', {self.shape}, {self.dtype})"

    @property
    def released(self) -> bool:
        """Whether the memory was given back."""
        return self.allocation.released

    @property
    def state(self) -> TensorState:
        """Whether the content is defined, and which committed or recorded commands use it now."""
        return self.device.hazards.state(self)

    @property
    def array(self) -> np.ndarray:
        """The tensor as a read-only NumPy view, without a copy; host memory only. Write by `upload`
        or `fill`.

        Raises DeviceError if the host cannot see the memory; HazardError if a command in flight
        writes it, if nothing has written it, or if it is transient and another tensor has its
        memory now.
        """
        self.device.hazards.check_host_read(self)
        view = self.resident().host_view().view()
        view.flags.writeable = False
        return view

    def content(self) -> np.ndarray:
        """The content, to read at once: `array` if the host can see the memory, else a copy."""
        return self.array if self.device.memory.host_visible else self.download()

    def download(self, empty: Callable[[tuple[int, ...],
                                        np.dtype[Any]], np.ndarray] = np.empty) -> np.ndarray:
        """A NumPy copy of the content, on memory that `empty` gives. Raises HazardError as `array`
        does."""
        self.device.hazards.check_host_read(self)
        scratch, here = self.device.scratch, self.resident()
        if not self.contiguous:
            return here.host_view().copy("C")
        if scratch is None:
            copy = empty(self.shape, element_type(self.dtype))
            if copy.nbytes:
                self.device.memory.read(here.start, copy)
            return copy
        copy, view = scratch.empty(self.shape, element_type(self.dtype)), here.host_view()
        if not copy.ndim:
            copy[...] = view
            return copy
        both = 2 * copy.nbytes  # source and copy are in memory together
        for first, last in scratch.pieces(len(copy), both // max(1, len(copy))):
            copy[first:last] = view[first:last]
        return copy

    def upload(self, values: Any) -> None:
        """Copy host values of exactly this shape into the tensor.

        Raises BindingError when they do not fit, or the tensor is read-only or transient. Raises
        HazardError while a recorded command or one in flight uses the memory, for it would see the
        new values.
        """
        source, kind = np.asarray(values), element_type(self.dtype)
        fits = source.dtype == kind
        if source.shape != self.shape or not (fits or np.can_cast(source.dtype, kind, "same_kind")):
            raise BindingError(f"upload of {source.shape} {source.dtype} to '{self.name}': the "
                               f"tensor is {self.shape} {self.dtype}")
        self.device.hazards.check_host_write(self)
        given = fits and source.flags.c_contiguous
        contiguous = source if given else np.ascontiguousarray(source, kind).reshape(self.shape)
        if not self.contiguous:
            self.host_view()[...] = contiguous
        elif contiguous.nbytes:
            self.device.memory.write(self.start, contiguous)
        self.device.hazards.mark_written(self)

    def put(self, values: np.ndarray) -> None:
        """`upload` values that no command writes over, unless they are those of the last `put`."""
        content = values.tobytes()
        if content != self._put:
            self.upload(values)
            self._put = content

    def fill(self, value: float) -> None:
        """Set every element to `value`. Raises HazardError as `upload` does."""
        scratch = self.device.scratch
        if scratch is None or not self.shape:
            self.upload(np.broadcast_to(np.asarray(value, element_type(self.dtype)), self.shape))
            return
        self.device.hazards.check_host_write(self)
        chunk = self.allocation.owner
        if value or not (isinstance(chunk, MappedChunk) and chunk.clear(self.start, self.nbytes)):
            for first, last in scratch.pieces(self.shape[0], self.nbytes // max(1, self.shape[0])):
                self.host_view()[first:last] = value
        self.device.hazards.mark_written(self)

    def __dlpack_device__(self) -> tuple[int, int]:
        """Kind and number of the device in DLPack."""
        return self.device.memory.place

    def __dlpack__(self, *, stream: Any = None, max_version: Any = None, dl_device: Any = None,
                   copy: bool | None = None) -> object:
        """The content for other libraries, without a copy: `torch.from_dlpack(tensor)`.

        The memory stays as long as their array, but is the heap's again after `release`. What wrote
        it was waited for, so no stream has to. Raises HazardError as `array` does, BufferError for
        strides and where a copy is asked for.
        """
        if (copy or (dl_device is not None and tuple(dl_device) != self.__dlpack_device__())
            or not self.contiguous):
            raise BufferError(f"tensor '{self.name}' is shared where and as it lies: use "
                              "download() for a copy")
        self.device.hazards.check_host_read(self)
        here = self.resident()
        return lend(here.start, self.shape, self.dtype, self.device.memory.place, here)

    @property
    def __cuda_array_interface__(self) -> dict[str, Any]:
        """The tensor for libraries that know CUDA's arrays; AttributeError in other memory."""
        if self.device.memory.place[0] != CUDA:
            raise AttributeError(f"tensor '{self.name}' is not in CUDA's memory")
        self.device.hazards.check_host_read(self)
        return {"shape": self.shape, "typestr": element_type(self.dtype).str, "strides": None,
                "version": 3,
                "data": (self.resident().start, not self.allocation.writable), "stream": None}

    def view(self, name: str, shape: tuple[int, ...], offset: int = 0,
             dtype: str | None = None) -> Tensor:
        """A tensor over part of the same memory: `shape` elements from element `offset` on, no
        copy. With a `dtype`, their bits are numbers of that type, which has the same size."""
        if not self.contiguous:
            raise BindingError(f"'{self.name}' is strided: take the view of the array, and wrap "
                               "that")
        if dtype and element_type(dtype).itemsize != element_type(self.dtype).itemsize:
            raise BindingError(f"view '{name}' of {dtype} needs elements of the size of "
                               f"{self.dtype}'s, '{self.name}'")
        skipped = offset * element_type(self.dtype).itemsize
        if offset < 0 or skipped + size_in_bytes(shape, self.dtype) > self.nbytes:
            raise BindingError(f"view '{name}' {tuple(shape)} at {offset} does not fit into "
                               f"'{self.name}' {self.shape}")
        inside = self.start - self.allocation.pointer + skipped
        return Tensor(self.device, name, shape, dtype or self.dtype, self.allocation, inside)

    def release(self) -> None:
        """Return the memory to the heap, or drop a wrapped array; this tensor and its views become
        unusable.

        Uncommitted commands that use it are refused at commit. Running ones are not affected, as
        long as later work uses the same device.
        """
        self.allocation.release()

    def resident(self) -> Tensor:
        """The tensor itself; for a transient one, its place in the last committed buffer that used
        it."""
        placed = self.allocation.place
        if placed is None:
            return self
        if self._resident is None or self._resident.allocation is not placed:
            inside = self.start - self.allocation.pointer
            self._resident = Tensor(self.device, self.name, self.shape, self.dtype, placed, inside)
        return self._resident

    def overlaps(self, other: Tensor) -> bool:
        """Whether the two tensors share memory."""
        return (self.start < other.end and other.start < self.end and self.nbytes > 0
                and other.nbytes > 0)

    def is_same_memory(self, other: Tensor) -> bool:
        """Whether this tensor, which must not be released, is all that the other is: the same
        elements in order."""
        return (not self.released and self.contiguous and other.contiguous
                and (self.start, self.shape, self.dtype) == (
            other.start, other.shape, other.dtype))

    def is_on(self, array: object) -> bool:
        """Whether this tensor, which must not be released, is a NumPy array of float32 in memory
        that both see, or the tensor of PyTorch that it was made of."""
        if self.released:
            return False
        if not isinstance(array, np.ndarray):
            return (array is self.allocation.owner
                    and is_as_lent(array, self.start, self.shape, self.dtype))
        return array.dtype == np.float32 and array.flags.c_contiguous \
            and (self.start, self.shape) == (address(array), array.shape)

    def host_view(self) -> np.ndarray:
        """Writable view for compiled kernels, made once; checks only that the host can see the
        memory."""
        if not self.device.memory.host_visible:
            raise DeviceError(f"tensor '{self.name}' lives on {self.device.name}: use download() "
                              "for a copy")
        if self._host is None:
            self._host = view_at(self.start, self.shape, element_type(self.dtype),
                                 self.allocation.owner)
        return self._host
