"""Memory of a device: chunks to carve tensors from, copies between a chunk and the host, and sets
of byte ranges."""

from __future__ import annotations

import ctypes
import math
import mmap
import sys
import time
import weakref
from collections.abc import Callable, Hashable, Sequence
from functools import cache, lru_cache
from typing import Any, NamedTuple, Protocol, TypeVar

import numpy as np

from postfx.planes import WORTH, copy_pieces, share
from postfx.system import Scratch

T = TypeVar("T")
TENSOR_BUDGET_SHARE = 0.4
"""Share of the memory budget for tensors; the rest is for networks."""
ALIGNMENT = 256
"""Byte alignment of every tensor: a multiple of the cache line and of efficient GPU copies."""


# DLPack's numbers: the host's memory as kind and number of a device, and the kind of CUDA's.
HOST = (1, 0)
CUDA = 2

HOST_KINDS = (1, 3)
"""Kinds that are the host's memory: plain, and pinned by CUDA."""


class Chunk(Protocol):
    """One piece of device memory of `nbytes` bytes, at `pointer` in the device's address space."""

    pointer: int
    nbytes: int


class Fork(Protocol):
    """Commands on several streams of a GPU. Whatever comes behind the `with` block waits for all of
    them."""

    def __enter__(self) -> object: ...

    def __exit__(self, *exception: object) -> None: ...

    def run(self, index: int, execute: Callable[[], None]) -> tuple[Any, Any]:
        """Put a command on its stream, behind those that come before it; the marks around it."""
        ...


class Memory(Protocol):
    """Where a device's tensors live. `host_visible`: NumPy can access it without a copy; `replays`:
    `replay` can run commands as one CUDA graph; `relax`: called after a dispatch where pages need
    not stay in memory; `place`: kind and number of the device in DLPack."""

    host_visible: bool
    replays: bool
    relax: Callable[[], None] | None
    place: tuple[int, int]

    def follow(self, stream: int | None) -> int | None:
        """Let commands run after the work of a producer's stream; the stream that they run on, None
        without one."""
        ...

    def stream_beside(self) -> int:
        """A stream for commands that run beside others, 0 where there is none."""
        ...

    def fork(self, streams: Sequence[int], before: Sequence[int]) -> Fork | None:
        """Commands on these streams, 0 for the device's own; None if that is all there is. `before`
        has the commands that come before each one, as a bit mask of indices."""
        ...

    def allocate(self, nbytes: int) -> Chunk:
        """A new chunk of at least `nbytes` bytes, aligned to `ALIGNMENT` on the host."""
        ...

    def write(self, pointer: int, array: np.ndarray) -> None:
        """Copy a C-contiguous host array to `pointer`."""
        ...

    def read(self, pointer: int, array: np.ndarray) -> None:
        """Copy from `pointer` into a C-contiguous host array."""
        ...

    def copy(self, target: int, source: int, nbytes: int) -> None:
        """Copy within the device's memory, in the order of its commands."""
        ...

    def synchronise(self) -> None:
        """Wait until all started work is done."""
        ...

    def mark(self) -> Any:
        """A mark at this point of the device's work."""
        ...

    def milliseconds(self, begin: Any, end: Any) -> float:
        """Time between two marks; call it after `synchronise`."""
        ...

    def replay(self, key: Hashable, kept: object, enqueue: Callable[[], T]) -> T | None:
        """Run the work of `enqueue` again as one graph and return its result.

        None if it has to run command by command; nothing has run then. `key` identifies unchanged
        work; `kept` is kept alive as long as the graph.
        """
        ...


class Immediate:
    """Memory whose commands are done when their call returns."""

    replays = False
    relax: Callable[[], None] | None = None

    def follow(self, stream: int | None) -> int | None:
        """None: commands are on no stream."""
        return None

    def stream_beside(self) -> int:
        """0: commands are on no stream."""
        return 0

    def fork(self, streams: Sequence[int], before: Sequence[int]) -> Fork | None:
        """None: commands are on no stream."""
        return None

    def synchronise(self) -> None:
        """Does nothing: no work is pending."""

    mark = staticmethod(time.perf_counter)

    def milliseconds(self, begin: float, end: float) -> float:
        """Time between two marks."""
        return 1e3 * (end - begin)

    def replay(self, key: Hashable, kept: object, enqueue: Callable[[], T]) -> T | None:
        """None: commands always run one by one."""
        return None


class HostChunk:
    """A chunk of host memory; pages that are never touched cost nothing."""

    def __init__(self, nbytes: int) -> None:
        self._storage = np.empty(nbytes + ALIGNMENT, np.uint8)
        start = -address(self._storage) % ALIGNMENT
        self.pointer = address(self._storage) + start
        self.nbytes = nbytes


class MappedChunk:
    """A chunk in a temporary file."""

    def __init__(self, scratch: Scratch, nbytes: int) -> None:
        self._map = scratch.map_file(nbytes)
        self._storage = np.frombuffer(self._map, np.uint8)
        self.pointer = address(self._storage)
        self.nbytes = nbytes

    def clear(self, pointer: int, nbytes: int) -> bool:
        """Make bytes 0 by giving their pages back to the disk, so that nothing is written; False,
        and nothing is done, where the system or the file system cannot."""
        start = pointer - self.pointer
        first, last = -(-start // mmap.PAGESIZE), (start + nbytes) // mmap.PAGESIZE
        advises = hasattr(mmap, "MADV_REMOVE") and hasattr(self._map, "madvise")
        if not advises or first >= last:
            return False
        try:
            self._map.madvise(mmap.MADV_REMOVE, first * mmap.PAGESIZE,
                              (last - first) * mmap.PAGESIZE)
        except OSError:
            return False
        self._storage[start:first * mmap.PAGESIZE] = 0
        self._storage[last * mmap.PAGESIZE:start + nbytes] = 0
        return True


class HostMemory(Immediate):
    """Memory that NumPy, compiled kernels and CPU sessions share. With a budget, large chunks
    beyond its share for tensors lie in temporary files."""

    host_visible = True
    place = HOST

    def __init__(self, scratch: Scratch | None = None) -> None:
        self._scratch = scratch
        self.relax = scratch.relax if scratch else None
        self._held: weakref.WeakSet[HostChunk] = weakref.WeakSet()

    def allocate(self, nbytes: int) -> HostChunk | MappedChunk:
        """A new chunk of host memory."""
        if self._scratch is not None:
            held = sum(chunk.nbytes for chunk in self._held)
            if held + nbytes > TENSOR_BUDGET_SHARE * self._scratch.left:
                return MappedChunk(self._scratch, nbytes)
        chunk = HostChunk(nbytes)
        self._held.add(chunk)
        return chunk

    def write(self, pointer: int, array: np.ndarray) -> None:
        """Copy a C-contiguous array to `pointer`."""
        ctypes.memmove(pointer, address(array), array.nbytes)

    def read(self, pointer: int, array: np.ndarray) -> None:
        """Copy from `pointer` into a C-contiguous array."""
        self.copy(address(array), pointer, array.nbytes)

    def copy(self, target: int, source: int, nbytes: int) -> None:
        """Copy bytes that do not overlap."""
        if nbytes < 2 * WORTH or nbytes % 4:
            ctypes.memmove(target, source, nbytes)
            return
        views = (view_at(pointer, (nbytes // 4,), np.dtype(np.uint32), None)
                 for pointer in (source, target))
        share(copy_pieces, math.ceil(nbytes / WORTH), *views)


def address(array: np.ndarray) -> int:
    """Address of an array's first element."""
    return int(array.__array_interface__["data"][0])


def byte_span(array: np.ndarray) -> tuple[int, int]:
    """Addresses of an array's first byte and of the one after its last, whatever its strides."""
    reach = [(size - 1) * stride
             for size, stride in zip(array.shape, array.strides, strict=True) if array.size]
    first, last = (address(array) + sum(pick(0, step) for step in reach) for pick in (min, max))
    return first, last + array.itemsize * bool(array.size)


def view_at(pointer: int, shape: tuple[int, ...], dtype: np.dtype[Any],
            owner: object) -> np.ndarray:
    """A writable array over host memory; it keeps `owner`, which holds the memory, alive."""
    nbytes = math.prod(shape) * dtype.itemsize
    buffer: Any = (ctypes.c_char * nbytes).from_address(pointer)
    buffer.owner = owner
    view: np.ndarray = np.frombuffer(buffer, dtype)
    return view.reshape(shape)


class Ranges:
    """A set of half-open byte ranges [start, end), kept sorted and merged."""

    def __init__(self, spans: tuple[tuple[int, int], ...] = ()) -> None:
        self.spans = spans

    def copy(self) -> Ranges:
        """An independent copy."""
        return Ranges(self.spans)

    def add(self, start: int, end: int) -> None:
        """Include [start, end)."""
        if not self.spans:
            self.spans = ((start, end),)
            return
        if self.covers(start, end):
            return
        apart = [span for span in self.spans if span[1] < start or span[0] > end]
        joined = [span for span in self.spans if not (span[1] < start or span[0] > end)]
        merged = (min([start, *(s for s, _ in joined)]), max([end, *(e for _, e in joined)]))
        self.spans = tuple(sorted([*apart, merged]))

    def remove(self, start: int, end: int) -> None:
        """Exclude [start, end)."""
        left = [(s, min(e, start)) for s, e in self.spans if s < start]
        right = [(max(s, end), e) for s, e in self.spans if e > end]
        self.spans = tuple(sorted({*left, *right}))

    def subtract(self, other: Ranges) -> None:
        """Exclude all of another set."""
        for span in other.spans:
            self.remove(*span)

    def covers(self, start: int, end: int) -> bool:
        """Whether every byte of [start, end) is included."""
        for first, last in self.spans:  # a loop, as this is asked a hundred times a frame
            if first <= start and end <= last:
                return True
        return False

    def includes(self, other: Ranges) -> bool:
        """Whether every byte of another set is included."""
        return self.spans == other.spans or all([self.covers(*span) for span in other.spans])

    def touches(self, other: Ranges) -> bool:
        """Whether any byte of another set is included."""
        return any(s < end and start < e for s, e in self.spans for start, end in other.spans)


# Arrays of other libraries, by DLPack (https://dmlc.github.io/dlpack) and by
# `__cuda_array_interface__`, version 3


class _Managed(ctypes.Structure):
    """DLPack's `DLManagedTensor`, with the `DLTensor` in it."""

    _fields_ = (("data", ctypes.c_void_p), ("kind", ctypes.c_int32), ("index", ctypes.c_int32),
                ("ndim", ctypes.c_int32), ("code", ctypes.c_uint8), ("bits", ctypes.c_uint8),
                ("lanes", ctypes.c_uint16), ("shape", ctypes.POINTER(ctypes.c_int64)),
                ("strides", ctypes.POINTER(ctypes.c_int64)), ("offset", ctypes.c_uint64),
                ("context", ctypes.c_void_p), ("deleter", ctypes.c_void_p))


_FRESH = b"dltensor"
"""Name of a capsule that nobody opened yet."""
_CODES = {"int": 0, "uint": 1, "float": 2, "bfloat": 4, "bool": 6}
_CODE_WORDS = {code: word for word, code in _CODES.items()}
_python = ctypes.pythonapi
_new_capsule = ctypes.PYFUNCTYPE(ctypes.py_object, ctypes.c_void_p, ctypes.c_char_p,
                                 ctypes.c_void_p)(
    ("PyCapsule_New", _python))
_open_capsule = ctypes.PYFUNCTYPE(ctypes.c_void_p, ctypes.py_object,
                                  ctypes.c_char_p)(("PyCapsule_GetPointer", _python))
_is_fresh = ctypes.PYFUNCTYPE(ctypes.c_int, ctypes.c_void_p,
                              ctypes.c_char_p)(("PyCapsule_IsValid", _python))
_peek_capsule = ctypes.PYFUNCTYPE(ctypes.c_void_p, ctypes.c_void_p, ctypes.c_char_p)(
    ("PyCapsule_GetPointer", _python))
_lent: dict[int, tuple[object, ...]] = {}
"""What other libraries read now, by the address of its description."""


def _take_back(managed: int) -> None:
    _lent.pop(managed, None)


def _drop_capsule(capsule: int) -> None:
    """Take back what is in a capsule, unless somebody opened it and has it now."""
    if _is_fresh(capsule, _FRESH):
        _take_back(_peek_capsule(capsule, _FRESH))


_deleter = ctypes.CFUNCTYPE(None, ctypes.c_void_p)(_take_back)
_destructor = ctypes.PYFUNCTYPE(None, ctypes.c_void_p)(_drop_capsule)
_DELETER = ctypes.cast(_deleter, ctypes.c_void_p).value
_DESTRUCTOR = ctypes.cast(_destructor, ctypes.c_void_p).value


def lend(pointer: int, shape: tuple[int, ...], dtype: str, place: tuple[int, int],
         owner: object) -> object:
    """A DLPack capsule of a contiguous tensor; `owner` lives until the last array on it is gone."""
    sizes = _sizes_of(shape)
    managed = _Managed(pointer, *place, len(shape), *_number_of(dtype), 1, sizes, None, 0, None,
                       _DELETER)
    address_of = ctypes.addressof(managed)
    _lent[address_of] = managed, sizes, owner
    return _new_capsule(address_of, _FRESH, _DESTRUCTOR)


@lru_cache(256)
def _sizes_of(shape: tuple[int, ...]) -> ctypes.Array[ctypes.c_int64]:
    """A shape as DLPack has it, which nobody may write."""
    return (ctypes.c_int64 * len(shape))(*shape)


@cache
def _number_of(dtype: str) -> tuple[int, int]:
    """DLPack's number and bits of a type."""
    word = dtype.rstrip("0123456789")
    return _CODES[word], int(dtype.removeprefix(word) or 8)


@lru_cache(256)
def _name_of(code: int, bits: int) -> str:
    """The type that DLPack's numbers mean."""
    word = _CODE_WORDS.get(code, f"DLPack's type {code} of ")
    return "bool" if word == "bool" else f"{word}{bits}"


class BorrowedArray(NamedTuple):
    """An array of another library in the device's memory; `owner` keeps it there."""

    pointer: int
    shape: tuple[int, ...]
    dtype: str
    is_read_only: bool
    owner: object


def borrow(array: Any, memory: Memory, place: tuple[int, int] | None) -> BorrowedArray:
    """An array in this memory, by `__cuda_array_interface__` if that is CUDA's and says what stream
    to wait for; else by DLPack, whose producer sees to it that our stream waits. PyTorch does that
    slowly, so its tensors are looked at.

    Args:
        place: what `array.__dlpack_device__()` says; None without one, when it can only be in
            CUDA's memory.

    Raises ValueError with the reason when it lies elsewhere, has strides, or does not describe
    itself well.
    """
    place = place or (CUDA, memory.place[1])
    if place != memory.place:
        where = _name((int(place[0]), int(place[1])))
        raise ValueError(f"it is in the memory of {where}, the device is {_name(memory.place)}")
    torch = sys.modules.get("torch")
    if torch and memory.place[0] == CUDA and isinstance(array, torch.Tensor):
        return _from_torch(torch, array, memory)
    told = getattr(array, "__cuda_array_interface__", None) if memory.place[0] == CUDA else None
    if told is not None and ("stream" in told or not hasattr(array, "__dlpack__")):
        return _from_interface(array, told, memory)
    return _from_capsule(array, memory)


def _name(place: tuple[int, int]) -> str:
    return {1: "the host", 3: "the host", CUDA: f"cuda:{place[1]}"}.get(place[0],
                                                                        f"DLPack's device {place}")


def _from_interface(array: Any, told: Any, memory: Memory) -> BorrowedArray:
    try:
        (pointer, is_read_only), shape = told["data"], tuple(map(int, told["shape"]))
        dtype, size = _native_type(told["typestr"])
        strides = told.get("strides")
        stream = told.get("stream")
    except (KeyError, TypeError, ValueError) as error:
        raise ValueError(f"its __cuda_array_interface__ cannot be read ({error!r})") from error
    if not dtype:
        raise ValueError("it has the byte order of other machines")
    if strides is not None:
        _require_contiguous(shape, [step // size for step in strides])
    memory.follow(stream)
    return BorrowedArray(int(pointer or 0), shape, dtype, bool(is_read_only), array)


def is_as_lent(array: Any, pointer: int, shape: tuple[int, ...], dtype: str) -> bool:
    """Whether an array that was borrowed is a tensor of PyTorch, which can be changed in place, and
    still the same."""
    torch = sys.modules.get("torch")
    if torch is None or not isinstance(array, torch.Tensor):
        return False
    is_there = array.data_ptr() == pointer and array.shape == shape and array.is_contiguous()
    return bool(is_there and not array.requires_grad and str(array.dtype) == f"torch.{dtype}")


def follow_torch(memory: Memory) -> None:
    """Let commands run after what PyTorch's current stream has to do now."""
    memory.follow(sys.modules["torch"].cuda.current_stream(memory.place[1]).cuda_stream)


def _from_torch(torch: Any, array: Any, memory: Memory) -> BorrowedArray:
    """A tensor of PyTorch, after what its current stream has to do now."""
    if array.requires_grad or array.is_conj() or array.is_neg() or array.layout != torch.strided:
        raise ValueError("it needs a gradient, is a conjugate or negative view, or is sparse: give "
                         "detach(), resolve_conj(), resolve_neg() or to_dense() of it")
    shape = tuple(array.shape)
    if not array.is_contiguous():
        _require_contiguous(shape, array.stride())
    follow_torch(memory)
    return BorrowedArray(array.data_ptr(), shape, str(array.dtype).removeprefix("torch."), False,
                         array)


@cache
def _native_type(typestr: str) -> tuple[str, int]:
    """NumPy's name of a type, empty in the byte order of other machines, and its bytes."""
    dtype = np.dtype(typestr)
    return dtype.name if dtype.isnative else "", dtype.itemsize


def _from_capsule(array: Any, memory: Memory) -> BorrowedArray:
    stream = memory.follow(None)
    capsule = array.__dlpack__() if stream is None else array.__dlpack__(stream=stream)
    managed = _Managed.from_address(_open_capsule(capsule, _FRESH))
    shape = tuple(managed.shape[: managed.ndim])
    if managed.strides:
        _require_contiguous(shape, managed.strides[: managed.ndim])
    # The capsule is left unused: it returns the array when it goes.
    return BorrowedArray((managed.data or 0) + managed.offset, shape,
                    _name_of(managed.code, managed.bits), False, capsule)


def _require_contiguous(shape: tuple[int, ...], steps: Sequence[int]) -> None:
    """Raises ValueError unless elements lie in order; `steps` from one to the next of an axis."""
    expected = 1
    for size, step in zip(reversed(shape), reversed(steps), strict=False):
        if size > 1 and step != expected:
            raise ValueError(f"its elements do not lie in order (strides {tuple(steps)} of "
                             f"{shape}): make it contiguous")
        expected *= size
