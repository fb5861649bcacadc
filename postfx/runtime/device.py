"""The device: memory, threads, queue, and the states that run on it; how a name picks provider and
memory."""

from __future__ import annotations

import contextlib
import itertools
import os
import re
import threading
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import cache, cached_property, partial
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from postfx.compiled.calls import BoundRows
from postfx.compiled.library import has_byte_products
from postfx.errors import BindingError, DeviceError, ModelError, PostfxError
from postfx.frame import LOG
from postfx.kernels import find_source
from postfx.runtime.capture import Capture
from postfx.runtime.commands import CommandBuffer
from postfx.runtime.convolutions import Head, read_layers
from postfx.runtime.cuda import CudaMemory
from postfx.runtime.encoders import Recordings
from postfx.runtime.hazards import Hazards
from postfx.runtime.heap import Heap
from postfx.runtime.memory import (
    CUDA,
    HOST,
    HOST_KINDS,
    HostMemory,
    Immediate,
    Memory,
    address,
    borrow,
    byte_span,
)
from postfx.runtime.model_file import Product, fix_dimensions, take_products
from postfx.runtime.models import Library
from postfx.runtime.own_convolutions import with_own_convolutions
from postfx.runtime.session import (
    CPU,
    Placement,
    Provider,
    Session,
    TableSession,
    find_provider,
    first_line,
    has_networks,
    ort,
    parse_provider,
)
from postfx.runtime.states import (
    CompiledComputeState,
    CudaComputeState,
    HostState,
    Intermediates,
    LoadedNetwork,
    PipelineState,
    PortableComputeState,
    State,
)
from postfx.runtime.tensor import DTYPES, Allocation, Tensor, name_of, size_in_bytes
from postfx.runtime.threads import Band, CommandQueue, Helpers, Slots, wait_for_all
from postfx.system import Scratch, usable_cores
from postfx.version import pip_install
from postfx.workers import Workers

if TYPE_CHECKING:
    from postfx.kernels import Kernel

MINIMUM_ROWS = 4
"""Least rows of a kernel's band: fewer are not worth another thread."""
Dims = Mapping[str, int] | Mapping[tuple[str, int], int] | Mapping[str | tuple[str, int], int]
"""Sizes of free dimensions: by name, or by input or output and axis."""


class Device:
    """Where passes run.

    Args:
        name: 'cpu', 'cuda', 'cuda:1', or 'auto': CUDA where ONNX Runtime can really use it, else
            the CPU.
        threads: CPU threads for kernels and networks; default: the cores that this process may use,
            by its affinity and its container's quota.
        compiled_kernels: use the kernels written for the device if there are any: compiled rows on
            the CPU, CUDA sources on a GPU. If False, use their portable ONNX definitions.
        memory: bytes of memory for the process, as a number or like '4G'. Tensors beyond it go to
            temporary files, and passes work in tiles. CPU only; 'auto' then means the CPU.
        kernels: library of portable definitions that go before those which come with the kernels.
        graphs: launch commands that ran before on the same tensors as one CUDA graph.
        provider: an execution provider of ONNX Runtime for the networks, as
            'OpenVINO,device_type=CPU': its name, options of its own, and library=, a plug-in's file
            or package. Kernels and tensors stay on the CPU, and so do nodes that it cannot run;
            'auto' then means the CPU.
        explicit_barriers: order commands by the barriers that encoders record and nothing else, as
            Metal 4 does: one that is missing is a HazardError. If False, what commands read and
            write orders them, too.

    Attributes:
        models: name -> SHA-256 of the networks that are loaded, or may be for frames of another
            size.
        results_lock: hold it from commit until the host has read transient results, if several
            threads commit.

    Raises DeviceError when the device is not available or an option does not fit it,
    MemoryBudgetError for a budget that cannot be read.
    """

    def __init__(
        self,
        name: str = "auto",
        threads: int | None = None,
        compiled_kernels: bool = True,
        kernels: Library | None = None,
        memory: str | int | None = None,
        graphs: bool = True,
        provider: str | Provider | None = None,
        explicit_barriers: bool = False,
    ) -> None:
        if threads is not None and not (isinstance(threads, int) and threads >= 1):
            raise DeviceError(f"a device needs at least 1 thread, not {threads!r}")
        self._arguments = (name, threads, compiled_kernels, kernels, memory, graphs, provider,
                           explicit_barriers)
        self.threads = threads or usable_cores()
        self.scratch = None if memory is None else Scratch(memory)
        name = "cpu" if (self.scratch or provider) and name == "auto" else name
        self.placement, self.memory = choose(name, self.threads, graphs)
        if provider is not None:
            self.placement = _run_by(self.placement, provider, name)
        if self.scratch:
            self.memory = _within(self.scratch, self.memory, name)
        self.name = name if name != "auto" else self.placement.memory
        self._compiled = compiled_kernels
        self._kernels = kernels
        self._compute_states: dict[Kernel, State] = {}
        self.models: dict[str, str] = {}
        self._process = os.getpid()
        self._encoders = itertools.count()
        self.commit_lock = threading.Lock()
        self.results_lock = threading.RLock()
        self.active_capture: Capture | None = None
        self.hazards = Hazards(explicit_barriers)
        self.heap = Heap(self, self.memory)

    def __repr__(self) -> str:
        return f"Device('{self.name}', threads={self.threads})"

    def __reduce__(self) -> tuple[type[Device], tuple[object, ...]]:
        """Pickles the arguments: the copy is a new device with empty memory."""
        return type(self), self._arguments

    @cached_property
    def queue(self) -> CommandQueue:
        """The queue that committed commands run on."""
        return CommandQueue(f"postfx {self.name}")

    @cached_property
    def lanes(self) -> Workers:
        """Threads for commands that run side by side."""
        return Workers(self.threads, thread_name_prefix="postfx lane")

    @cached_property
    def coordinators(self) -> Workers:
        """Threads that wait for the commands of buffers which run beside others."""
        return Workers(self.threads, thread_name_prefix="postfx buffer")

    @cached_property
    def slots(self) -> Slots:
        """The threads that commands share that run side by side."""
        return Slots(self.threads)

    @cached_property
    def _helpers(self) -> Helpers:
        return Helpers(max(1, self.threads - 1))

    def divided(self, rows: Callable[[int, int], None], first: int, last: int,
                least: int = MINIMUM_ROWS) -> Callable[[], None]:
        """A function that runs `rows(first, last)` in bands of at least `least` rows over the
        threads of this device."""
        count = min(self.threads, (last - first) // least)
        if count < 2:
            return partial(rows, first, last)
        edges = [first + (last - first) * band // count for band in range(count + 1)]
        if isinstance(rows, BoundRows):
            return partial(self._helpers.run, rows, rows.blocks(edges))
        return partial(self._helpers.work, [Band(rows, *edge) for edge in pairwise(edges)])

    def divide_planes(self, rows: Callable[[int, int], None], count: int, nbytes: int) -> None:
        """Divide the host's work on planes, see `postfx.planes.Divide`: among the threads, or
        within a memory budget into pieces, whose planes are let go of."""
        if self.scratch is None:
            self.divided(rows, 0, count, 1)()
            return
        for first, last in self.scratch.pieces(count, nbytes // count):
            rows(first, last)

    def wrap(self, name: str, array: Any, copy: Tensor | None = None) -> Tensor:
        """A tensor with an array's content: the same memory on the CPU, an upload elsewhere.

        The tensor counts as written. Do not change the array while commands use it. One with
        strides, such as a crop or a transposed array, is copied by every command that uses it on
        the CPU.

        Args:
            array: of NumPy, or of any library that has `__dlpack__` or `__cuda_array_interface__`;
                one in this GPU's memory stays there and is not copied, and its producer's work is
                waited for on the GPU.
            copy: a tensor of the same shape and type to upload to, where the device has its own
                memory.

        Raises BindingError when the array is of a type or byte order that tensors cannot have, or
        in the memory of another device.
        """
        if not isinstance(array, np.ndarray):
            borrowed = self._borrow(name, array)
            if isinstance(borrowed, Tensor):
                return borrowed
            array = borrowed
        if not array.dtype.isnative:
            raise BindingError(f"array '{name}' has the byte order of other machines: pass it as "
                               f"{array.dtype.name}")
        if not self.memory.host_visible:
            copy = copy or self.heap.tensor(name, array.shape, array.dtype.name)
            tensor = Tensor(self, name, copy.shape, copy.dtype,
                            Allocation(name, copy.start, copy.nbytes, owner=copy))
            tensor.upload(array)
            return tensor
        strided = None if array.flags.c_contiguous else array
        first, end = ((address(array), address(array) + array.nbytes) if strided is None
                      else byte_span(array))
        allocation = Allocation(name, first, end - first, owner=array,
                                writable=array.flags.writeable)
        tensor = Tensor(self, name, array.shape, name_of(array.dtype), allocation, strided=strided)
        self.hazards.mark_written(tensor)
        return tensor

    def _borrow(self, name: str, array: Any) -> Tensor | np.ndarray:
        """A tensor on an array of another library in this device's memory, or NumPy's view of one
        in the host's."""
        if not (hasattr(array, "__dlpack__") or hasattr(array, "__cuda_array_interface__")):
            kind = type(array).__name__
            raise BindingError(f"array '{name}' is {kind}: give a NumPy array, or one of a library "
                               "with DLPack")
        try:
            place = array.__dlpack_device__() if hasattr(array, "__dlpack_device__") else None
            if place and place[0] in HOST_KINDS:
                return np.asarray(np.from_dlpack(array))
            held = borrow(array, self.memory, place)
        except (ValueError, TypeError, BufferError, RuntimeError) as error:
            kind = type(array).__name__
            raise BindingError(f"array '{name}' cannot be read from {kind}: "
                               f"{first_line(error)}") from error
        nbytes = size_in_bytes(held.shape, held.dtype) if held.dtype in DTYPES else 0
        allocation = Allocation(name, held.pointer, nbytes, owner=held.owner,
                                writable=not held.is_read_only)
        tensor = Tensor(self, name, held.shape, held.dtype, allocation)
        self.hazards.mark_written(tensor)
        return tensor

    def pipeline_state(
        self, library: Library, name: str, dims: Dims | None = None,
        in_place: Mapping[str, str] | None = None, threads: int | None = None,
        heads: Mapping[str, Head] | None = None, own_kernels: bool = False,
    ) -> PipelineState:
        """A network of a library, with its free dimensions fixed.

        Args:
            dims: free dimension name -> size; a dimension without a name is given by (input or
                output, axis).
            in_place: input -> output that replaces its content: one binding of the access
                'read-write', by the input's name.
            threads: how many of the device's threads it takes, default all of them. Commands that
                no barrier orders and that take fewer run side by side; on a GPU, each on one of a
                few streams, unless it is `in_place`.
            heads: outputs that become others where our own kernels run the network. The state's
                bindings tell.
            own_kernels: whether a CPU runs parts of the network by kernels of ours: convolutions
                of 3x3 pixels in float32, and integer products at the end, which are left to the
                caller as the state's `products`.

        Raises ModelError when the model is missing, damaged or cannot run here, a dimension is left
        free, or two bindings cannot be one.
        """
        fixed = {key: int(size) for key, size in (dims or {}).items()}
        content = _load(library, name, fixed)
        named = {key: size for key, size in fixed.items() if isinstance(key, str)}
        taken = self.threads if threads is None else threads
        if not 1 <= taken <= self.threads:
            raise DeviceError(f"network '{name}' cannot take {taken} of the {self.threads} threads "
                              f"of {self!r}")
        narrow = taken < self.threads and not in_place
        if self.gpu and self.gpu.convolves and not (narrow or in_place):
            try:
                layers = read_layers(content, library.path(name).parent)
                host = Placement(CPU, "cpu", 0, taken)
                # runs nothing: it tells sizes and constants
                known = self._session(content, library, name, host, fixed)
                state = PipelineState(self, LoadedNetwork(name, library.path(name), named, known,
                                                          library.constants(name)))
                state.convolve(layers, self.gpu, heads or {})
                self.name_model(library, name)
                return state
            except (ValueError, LookupError) as reason:  # Unfit, or damaged, which a session tells
                LOG.debug("network '%s' runs by ONNX Runtime: %s", name, reason)
        stream = self.memory.stream_beside() if narrow else self.placement.stream
        placement = replace(self.placement, threads=taken, stream=stream)
        products: dict[str, Product] = {}
        runs_own = own_kernels and placement.provider == CPU
        if runs_own:
            content, products = _with_own_kernels(content)
        session = self._session(content, library, name, placement, fixed)
        self.name_model(library, name)

        def measure() -> int | None:
            """See `PipelineState.intermediates_size`."""
            if isinstance(session, TableSession):
                return 0
            if not self.memory.host_visible:
                return None
            again = _load(library, name, fixed)
            given = _with_own_kernels(again)[0] if runs_own else again
            return Session(given, name, replace(placement, stream=0), named,
                           library.path(name).parent, of_its_own=True).intermediates()

        network = LoadedNetwork(name, library.path(name), named, session, library.constants(name))
        return PipelineState(self, network, in_place, taken, products, measure)

    def intermediates(self, *needed: PipelineState | int) -> Intermediates:
        """Memory for the intermediates of networks that run one after the other: enough for the
        largest of these states, or bytes."""
        sizes = [item if isinstance(item, int) else item.intermediates_size or 0 for item in needed]
        return Intermediates(self, max(sizes, default=0))

    def _session(self, content: bytes, library: Library, name: str, placement: Placement,
                 fixed: Dims) -> Session | TableSession:
        """A network's session, all of whose dimensions are fixed; without ONNX Runtime its tables,
        if it is no more."""
        if not has_networks():
            with contextlib.suppress(ValueError):
                return TableSession(content)
        named = {key: size for key, size in fixed.items() if isinstance(key, str)}
        session = Session(content, name, placement, named, library.path(name).parent,
                          placement.provider != CPU and placement.stream != 0)
        for value in (*session.inputs, *session.outputs):
            free = [str(size or f"axis {axis}")
                    for axis, size in enumerate(value.shape) if not isinstance(size, int)]
            if free:
                raise ModelError(f"network '{name}' leaves {', '.join(free)} of '{value.name}' "
                                 f"free: dims were {_text_dims(fixed)}")
        return session

    def name_model(self, library: Library, name: str) -> None:
        """Add a network to `models` before it is loaded, because it may be needed later."""
        self.models[name] = library.sha256(name)

    def compute_state(self, kernel: Kernel) -> State:
        """A kernel made ready, once per device: compiled rows on the CPU, its CUDA source or its
        portable definition elsewhere.

        Raises ModelError when the portable definition is needed and missing, or its bindings are
        not the kernel's.
        """
        if kernel not in self._compute_states:
            self._compute_states[kernel] = self._make_state(kernel)
        return self._compute_states[kernel]

    def make_ready(self, *kernels: Kernel) -> None:
        """Make kernels ready, so that their first run is no slower than later ones."""
        for kernel in kernels:
            self.compute_state(kernel)

    def host_state(self, name: str, reads: Sequence[str], writes: Sequence[str],
                   work: Callable[..., None]) -> State:
        """Work of another library among the commands: `work` gets an array of the host for each of
        the names that it `reads` and then `writes`, float32 of any shape."""
        return HostState(self, name, reads, writes, work)

    @property
    def runs_rows(self) -> bool:
        """Whether kernels run as compiled rows, so that those without another form run, too."""
        return self._compiled and self.memory.host_visible

    @property
    def gpu(self) -> CudaMemory | None:
        """The GPU that kernels run on by their CUDA sources; None where they run otherwise."""
        return self.memory if self._compiled and isinstance(self.memory, CudaMemory) else None

    def command_buffer(self, label: str, captured: bool = True,
                       known: Recordings | None = None) -> CommandBuffer:
        """A new, empty command buffer. An active capture records it if `captured`; what it records
        is looked up among `known` recordings."""
        return CommandBuffer(self, label, captured, known)

    def capture(
        self, tensors: str = "thumbnails", folder: str | Path | None = None, network: bool = False
    ) -> Capture:
        """A capture, for a `with` block: it records the command buffers committed inside.

        Args:
            tensors: what to keep of each command's output: 'thumbnails' (figures and small
                pictures), 'none', or 'all' (its whole content too, in files).
            folder: where 'all' puts the files, in a folder `tensors`.
            network: also run every network once more, node by node, and keep each node's output and
                time. Takes several times the network's own time and needs the package `onnx`.

        Raises CaptureError if the options do not fit together, or another capture of this device is
        active.
        """
        return Capture(self, tensors, folder, network)

    def wait_idle(self, timeout: float | None = None) -> None:
        """Block until all committed buffers are done; none is in flight afterwards.

        Args:
            timeout: seconds; None waits without limit.

        Raises CommandTimeout if they are not done in time, else the first CommandError among them.
        """
        wait_for_all(repr(self), self.hazards.in_flight(), timeout)

    def require_process(self) -> None:
        """Raises DeviceError in a process forked after the device was made: a fork has none of its
        threads."""
        if self._process != os.getpid():
            raise DeviceError(f"{self!r} belongs to the process that this one was forked from: "
                              "make devices and pipelines here, or start processes by 'spawn'")

    def next_encoder(self) -> int:
        """A number for a new encoder; numbers rise in the order of recording."""
        return next(self._encoders)

    def _make_state(self, kernel: Kernel) -> State:
        if self.gpu and (source := find_source(kernel)):
            return CudaComputeState(self, kernel, self.gpu, source)
        if self.runs_rows:
            return CompiledComputeState(self, kernel)
        return self._portable_state(kernel)

    def _portable_state(self, kernel: Kernel) -> PortableComputeState:
        session = Session(self._portable_model(kernel), kernel.name, self.placement, {})
        _check_portable(kernel, session)
        return PortableComputeState(self, kernel, session)

    def _portable_model(self, kernel: Kernel) -> bytes:
        if self._kernels and kernel.name in self._kernels:
            return self._kernels.load(kernel.name)
        if not kernel.portable.is_file():
            raise ModelError(f"kernel '{kernel.name}' has no form that runs on {self!r}: there is "
                             f"no '{kernel.portable}' (docs/howto/passes.md says how to export it)")
        return Library(kernel.portable.parent).load(kernel.name)


def _run_by(placement: Placement, provider: str | Provider, name: str) -> Placement:
    """The CPU's placement, with networks on another provider."""
    if placement.provider != CPU:
        raise DeviceError(f"a provider works on the host's memory, not on '{name}': leave one of "
                          "them out")
    asked = find_provider(parse_provider(provider) if isinstance(provider, str) else provider)
    return replace(placement, provider=asked.name, asked=asked)


def _within(scratch: Scratch, memory: Memory, name: str) -> HostMemory:
    """Memory of a device with a budget."""
    if not memory.host_visible:
        raise DeviceError(f"a memory budget is for the CPU, not for '{name}': leave one of them "
                          "out")
    return HostMemory(scratch)


def _check_portable(kernel: Kernel, session: Session) -> None:
    for values, names, what in ((session.inputs, kernel.reads, "inputs"),
                                (session.outputs, kernel.writes, "outputs")):
        renamed = ({result: name for name, result in kernel.in_place.items()} if what == "outputs"
                   else {})
        found = sorted((renamed.get(value.name, value.name), value.dtype) for value in values)
        wanted = sorted((name, kernel.types.get(name, "float32")) for name in names)
        if found != wanted:
            raise ModelError(f"portable definition of kernel '{kernel.name}' has the {what} "
                             f"{_text(found)}: they must be {_text(wanted)}")


def _load(library: Library, name: str, fixed: Dims) -> bytes:
    """A network's file, with the dimensions fixed that have no name."""
    content = library.load(name)
    by_axis = {key: size for key, size in fixed.items() if not isinstance(key, str)}
    if not by_axis:
        return content
    try:
        return fix_dimensions(content, by_axis)
    except ValueError as error:
        raise ModelError(f"network '{name}' cannot have the dims {_text_dims(by_axis)}: "
                         f"{error}") from error


def _with_own_kernels(content: bytes) -> tuple[bytes, dict[str, Product]]:
    """A network's file that leaves to our kernels what a CPU computes by them, and the products at
    its end that are the caller's. Networks with such products convolve in integers."""
    products: dict[str, Product] = {}
    if has_byte_products():
        content, products = take_products(content)
    return (content if products else with_own_convolutions(content)), products


def _text_dims(dims: Dims) -> str:
    given = {key if isinstance(key, str) else f"{key[0]}[{key[1]}]": size
             for key, size in dims.items()}
    return ", ".join(f"{key}={size}" for key, size in given.items()) or "none"


def _text(values: list[tuple[str, str]]) -> str:
    return ", ".join(f"{name} {dtype}" for name, dtype in values)


_DEVICE_NAME = re.compile(r"(auto|cpu|cuda)(?::(\d+))?")


def choose(name: str, threads: int, graphs: bool = True) -> tuple[Placement, Memory]:
    """Placement and memory of 'cpu', 'cuda', 'cuda:1' or 'auto'. Raises DeviceError when it is not
    available."""
    match = _DEVICE_NAME.fullmatch(str(name))
    if match is None or (match[2] and match[1] != "cuda"):
        raise DeviceError(f"no device '{name}': use auto, cpu, cuda or cuda:N")
    index = int(match[2] or 0)
    fault = None if match[1] == "cpu" else cuda_fault(index)
    if match[1] == "cuda" and fault:
        raise DeviceError(f"device '{name}' is not available: {fault}")
    if match[1] == "cpu" or fault:
        return Placement(CPU, "cpu", 0, threads), HostMemory()
    try:
        memory = CudaMemory(index, graphs)
    except DeviceError:
        placement = Placement("CUDAExecutionProvider", "cuda", index, threads)
        return placement, ProviderMemory(placement)
    return Placement("CUDAExecutionProvider", "cuda", index, threads, memory.stream), memory


@cache
def cuda_fault(index: int) -> str | None:
    """Why CUDA device `index` cannot be used, or None when a copy to it and back works."""
    if "CUDAExecutionProvider" not in ort.get_available_providers():
        return f"this onnxruntime has no CUDA provider; install it by {pip_install('cuda')}"
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            # since 1.21: CUDA libraries that came by pip
            getattr(ort, "preload_dlls", lambda: None)()
            ProviderMemory(Placement("CUDAExecutionProvider", "cuda", index, 1)).check()
    except (PostfxError, RuntimeError, OSError) as error:
        return first_line(error)
    return None


_COPY = Path(__file__).with_name("copy.onnx")


class ProviderChunk:
    """A chunk that ONNX Runtime allocated on the provider's device."""

    def __init__(self, placement: Placement, nbytes: int) -> None:
        self._value = ort.OrtValue.ortvalue_from_shape_and_type([nbytes], np.uint8,
                                                                placement.memory, placement.index)
        self.pointer = self._value.data_ptr()
        self.nbytes = nbytes


class ProviderMemory(Immediate):
    """Memory of `placement`. ONNX Runtime copies between devices where a session's inputs and
    outputs are bound, and waits at the end of each run."""

    host_visible = False

    def __init__(self, placement: Placement) -> None:
        self._placement = placement
        self.place = (CUDA, placement.index) if placement.memory == "cuda" else HOST
        self._copy = Session(_COPY.read_bytes(), "copy", placement, {})

    def allocate(self, nbytes: int) -> ProviderChunk:
        """A new chunk on the device."""
        return ProviderChunk(self._placement, nbytes)

    def write(self, pointer: int, array: np.ndarray) -> None:
        """Copy a C-contiguous host array to the device."""
        self._copy.copy_bytes(("cpu", 0, address(array)), self._locate(pointer), array.nbytes)

    def read(self, pointer: int, array: np.ndarray) -> None:
        """Copy from the device into a C-contiguous host array."""
        self._copy.copy_bytes(self._locate(pointer), ("cpu", 0, address(array)), array.nbytes)

    def copy(self, target: int, source: int, nbytes: int) -> None:
        """Copy within the device's memory."""
        self._copy.copy_bytes(self._locate(source), self._locate(target), nbytes)

    def check(self) -> None:
        """Copy a few bytes to the device and back; DeviceError when they come back changed."""
        sent, received = np.arange(64, dtype=np.uint8), np.zeros(64, np.uint8)
        chunk = self.allocate(sent.nbytes)
        self.write(chunk.pointer, sent)
        self.read(chunk.pointer, received)
        if not np.array_equal(sent, received):
            raise DeviceError(f"a copy to {self._placement.memory} came back changed")

    def _locate(self, pointer: int) -> tuple[str, int, int]:
        return self._placement.memory, self._placement.index, pointer


def default_device() -> Device:
    """The device that is used where none is given: one for the process."""
    with _ONE_AT_A_TIME:
        return _device_of(os.getpid())


@cache
def _device_of(process: int) -> Device:
    return Device("auto")


_ONE_AT_A_TIME = threading.Lock()
