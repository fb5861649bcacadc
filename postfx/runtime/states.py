"""States and arguments: a network or kernel made ready to run, its declared bindings, and the
tensors bound to them."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cache, cached_property, partial
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple, Protocol

import numpy as np

from postfx.compiled.calls import bind_rows
from postfx.compiled.library import Rows
from postfx.errors import BindingError, ModelError
from postfx.runtime.convolutions import HALF, Convolutions, Gpu, Head, Layer, give_heads
from postfx.runtime.model_file import Product
from postfx.runtime.session import FirstRun, Session, TableSession
from postfx.runtime.tensor import Allocation, Tensor, TensorDevice, Transient

if TYPE_CHECKING:
    from postfx.kernels import Kernel
    from postfx.runtime.cuda import CudaMemory


class Binding(NamedTuple):
    """One argument of a network or kernel; `access` is 'read', 'write' or 'read-write', `shape`
    None if a kernel leaves it open; it may hold symbols ('height', '2*width') in kernels only."""

    name: str
    access: str
    shape: tuple[int | str, ...] | None
    dtype: str

    @property
    def reads(self) -> bool:
        """Whether its content is read."""
        return self.access != "write"

    @property
    def writes(self) -> bool:
        """Whether it gets new content."""
        return self.access != "read"


class StateDevice(TensorDevice, Protocol):
    """What states need of their device."""

    @property
    def threads(self) -> int: ...

    @property
    def runs_rows(self) -> bool: ...

    @property
    def gpu(self) -> CudaMemory | None: ...

    def divided(self, rows: Callable[[int, int], None], first: int,
                last: int) -> Callable[[], None]: ...

    def compute_state(self, kernel: Kernel) -> State: ...

    def make_ready(self, *kernels: Kernel) -> None: ...


class State(Protocol):
    """What an argument table is made for and an encoder dispatches; `model` is a network's file,
    `capturable` whether it may become part of a CUDA graph, `threads` how many of the device's it
    takes, `narrow` whether not all, `stream` its own stream on a GPU, 0 for the device's."""

    device: StateDevice
    name: str
    command: str
    stage: str
    capturable: bool
    bindings: tuple[Binding, ...]

    @property
    def threads(self) -> int: ...

    @property
    def narrow(self) -> bool: ...

    @property
    def stream(self) -> int: ...

    @property
    def model(self) -> Path | None: ...

    def prepare(self, tensors: Sequence[Tensor]) -> Callable[[], None]:
        """A function that runs the state on tensors given in the order of `bindings`; nothing is
        copied."""
        ...


class LoadedNetwork(NamedTuple):
    """A network of a library, as it is loaded.

    Attributes:
        name: in the library.
        path: of its file.
        dims: its free dimensions that have a name -> their sizes.
        session: runs it.
        constants: names of outputs that depend on no input.
    """

    name: str
    path: Path
    dims: dict[str, int]
    session: Session | TableSession
    constants: Sequence[str]


class PipelineState:
    """A network with fixed dimensions. Made by `Device.pipeline_state`.

    Attributes:
        bindings: the tensors that a dispatch reads and writes.
        shapes: name -> shape of each binding.
        constants: name -> array, of outputs that depend on no input. They are not bound: on a GPU,
            ONNX Runtime would copy them outside the stream, too early or too late.
        products: name -> integer product that the file has as an output and that is left to the
            caller; its codes are bound in its place.
        intermediates_size: bytes that it takes between its inputs and outputs. Of a network that
            ONNX Runtime runs, what its arena grows by when nothing is in it, measured by one run
            when it is asked for; None on a GPU and where the system does not tell.
    """

    stage = "machine-learning"
    capturable = True

    def __init__(self, device: StateDevice, network: LoadedNetwork,
                 in_place: Mapping[str, str] | None = None,
                 threads: int | None = None, products: Mapping[str, Product] | None = None,
                 measure: Callable[[], int | None] = lambda: 0) -> None:
        session = network.session
        self.device = device
        self.products = products or {}
        self.threads = threads or device.threads
        self.narrow = self.threads < device.threads
        self.stream = session.stream if self.narrow else 0
        self.name = network.name
        self.dims = network.dims
        self.model = network.path
        self.command = f"network '{network.name}'"
        self._in_place = dict(in_place or {})
        self.bindings = _session_bindings(network, self._in_place)
        self.shapes = {value.name: value.fixed for value in (*session.inputs, *session.outputs)}
        self.constants = session.constants(network.constants)
        self._session = session
        self._measure = measure
        self._convolutions: Convolutions | None = None

    def convolve(self, layers: Sequence[Layer], gpu: Gpu, heads: Mapping[str, Head]) -> None:
        """Run as our own kernels from now on, with these layers; `heads` are outputs to give as
        planes then.

        Raises Unfit where the GPU cannot run a layer.
        """
        shapes, names = give_heads(layers, self.shapes, heads)
        self._convolutions, self.shapes = Convolutions(layers, self.device, gpu, shapes), shapes
        self.bindings = tuple(binding._replace(name=name, shape=shapes[name])
                              for binding in self.bindings
                              for name in [names.get(binding.name, binding.name)])

    @cached_property
    def intermediates_size(self) -> int | None:
        """See the class."""
        return (self._measure() if self._convolutions is None
                else self._convolutions.intermediates_size)

    @property
    def takes_memory(self) -> bool:
        """Whether it runs in the memory that a dispatch gives it."""
        return self._convolutions is not None

    def prepare(self, tensors: Sequence[Tensor],
                memory: Tensor | None = None) -> Callable[[], None]:
        """A function that runs the network on bound tensors, and in this memory if it
        `takes_memory`."""
        if self._convolutions is not None:
            named = {binding.name: tensor
                     for binding, tensor in zip(self.bindings, tensors, strict=True)}
            return self._convolutions.bind(named, memory)
        return _bind_session(self._session, self.bindings, tensors, self._in_place)


class ComputeState:
    """A kernel made ready to run on a device. Made by `Device.compute_state`."""

    stage = "compute"
    narrow = False
    stream = 0
    model: Path | None = None
    capturable = True

    def __init__(self, device: StateDevice, kernel: Kernel) -> None:
        self.device = device
        self.name = kernel.name
        self.command = f"kernel '{kernel.name}'"
        self.bindings = kernel_bindings(kernel)
        self.threads = device.threads
        self._row_axis = kernel.row_axis

    def _extent(self, tensors: Sequence[Tensor]) -> tuple[int, ...]:
        """Rows of the kernel's work, and the axes after them."""
        name, axis = self._row_axis
        (written,) = (tensor for binding, tensor in zip(self.bindings, tensors, strict=True)
                      if binding.name == name)
        return written.shape[axis:]


class PortableComputeState(ComputeState):
    """A kernel that runs by its portable ONNX definition, some of whose operators wait for the
    GPU."""

    capturable = False

    def __init__(self, device: StateDevice, kernel: Kernel, session: Session) -> None:
        super().__init__(device, kernel)
        self._session = session
        self._in_place = kernel.in_place

    def prepare(self, tensors: Sequence[Tensor]) -> Callable[[], None]:
        """A function that runs the portable definition on bound tensors."""
        return _bind_session(self._session, self.bindings, tensors, self._in_place)


class CompiledComputeState(ComputeState):
    """A kernel that runs by its compiled rows, in bands over the device's threads."""

    def __init__(self, device: StateDevice, kernel: Kernel) -> None:
        super().__init__(device, kernel)
        self._rows = kernel.rows
        _prepare_rows(kernel, self.bindings)

    def prepare(self, tensors: Sequence[Tensor]) -> Callable[[], None]:
        """A function that runs the rows on bound tensors."""
        rows = bind_rows(self._rows, [tensor.host_view() for tensor in tensors])
        count, scratch = self._extent(tensors)[0], self.device.scratch
        if scratch is None:
            return self.device.divided(rows, 0, count)
        row_bytes = sum(tensor.nbytes for tensor in tensors) // max(1, count)

        def run_in_pieces() -> None:
            for first, last in scratch.pieces(count, row_bytes):
                self.device.divided(rows, first, last)()

        return run_in_pieces


class CudaComputeState(ComputeState):
    """A kernel that runs by its CUDA source."""

    def __init__(self, device: StateDevice, kernel: Kernel, memory: CudaMemory,
                 source: Path) -> None:
        super().__init__(device, kernel)
        self._memory = memory
        self._source = source
        self._blocks = kernel.blocks
        self._pixels = kernel.pixels

    def prepare(self, tensors: Sequence[Tensor]) -> Callable[[], None]:
        """A function that puts the kernel on the GPU's stream."""
        rows, *columns = self._extent(tensors)
        down, across = self._pixels
        extent = (-(-rows // down), -(-columns[0] // across) if columns else 0)
        return self._memory.launcher(self.name, self._source, extent, self._blocks, tensors)


class HostState:
    """Work of another library on arrays of the host, done when its turn among the commands comes.
    Made by `Device.host_state`; on a GPU its arrays are copies, and it waits for the commands
    before it."""

    stage = "compute"
    narrow = False
    stream = 0
    model: Path | None = None
    capturable = False

    def __init__(self, device: StateDevice, name: str, reads: Sequence[str], writes: Sequence[str],
                 work: Callable[..., None]) -> None:
        self.device = device
        self.name = name
        self.command = f"work '{name}'"
        self.threads = device.threads
        self.bindings = tuple(Binding(binding, access, None, "float32")
                              for names, access in ((reads, "read"), (writes, "write"))
                              for binding in names)
        self._work = work

    def prepare(self, tensors: Sequence[Tensor]) -> Callable[[], None]:
        """A function that does the work on bound tensors."""
        if self.device.memory.host_visible:
            arrays = [tensor.host_view() for tensor in tensors]
            return partial(self._work, *arrays)
        return partial(self._work_on_copies, tensors)

    def _work_on_copies(self, tensors: Sequence[Tensor]) -> None:
        memory = self.device.memory
        arrays = [np.empty(tensor.shape, tensor.dtype) for tensor in tensors]
        bound = [*zip(self.bindings, tensors, arrays, strict=True)]
        for binding, tensor, array in bound:
            if binding.reads:
                memory.read(tensor.start, array)
        self._work(*arrays)
        for binding, tensor, array in bound:
            if binding.writes:
                memory.write(tensor.start, array)


def kernel_bindings(kernel: Kernel) -> tuple[Binding, ...]:
    """Bindings of a kernel in argument order."""
    changed = kernel.in_place
    named = [(name, "read-write" if name in changed else "read") for name in kernel.reads]
    named += [(name, "write") for name in kernel.writes if name not in changed]
    shapes = {name: tuple(shape) for name, shape in kernel.shapes.items()}
    return tuple(Binding(name, access, shapes.get(name), kernel.types.get(name, "float32"))
                 for name, access in named)


def _prepare_rows(kernel: Kernel, bindings: tuple[Binding, ...]) -> None:
    """Have rows in C++ ready before the first frame where the ranks are known."""
    shapes = [binding.shape for binding in bindings if binding.shape is not None]
    if isinstance(kernel.rows, Rows) and len(shapes) == len(bindings):
        kernel.rows.prepare(tuple(f"{np.dtype(binding.dtype).str}:{len(shape)}"
                                  for binding, shape in zip(bindings, shapes, strict=True)))


def _session_bindings(network: LoadedNetwork, in_place: Mapping[str, str]) -> tuple[Binding, ...]:
    """The bindings of a network's inputs and outputs. Raises ModelError where two that are to be
    one are not alike."""
    name, session = network.name, network.session
    reads = {value.name: Binding(value.name, "read", value.fixed, value.dtype)
             for value in session.inputs}
    writes = {value.name: Binding(value.name, "write", value.fixed, value.dtype)
              for value in session.outputs if value.name not in network.constants}
    for source, result in in_place.items():
        if source not in reads or result not in writes:
            raise ModelError(f"network '{name}' cannot replace '{source}' by '{result}': it has "
                             f"the inputs {_quote(reads)} and the outputs {_quote(writes)}")
        one, other = reads[source], writes.pop(result)
        if (one.shape, one.dtype) != (other.shape, other.dtype):
            raise ModelError(f"network '{name}' cannot replace '{source}', {one.shape} "
                             f"{one.dtype}, by '{result}', {other.shape} {other.dtype}: give two "
                             "that are alike")
        reads[source] = one._replace(access="read-write")
    return (*reads.values(), *writes.values())


def _bind_session(
    session: Session | TableSession, bindings: tuple[Binding, ...], tensors: Sequence[Tensor],
    in_place: Mapping[str, str],
) -> Callable[[], None]:
    """A function that runs a session. What it changes in place is written elsewhere first, as its
    nodes may read it to the end."""
    bound = {binding.name: tensor for binding, tensor in zip(bindings, tensors, strict=True)}
    inputs = {binding.name: bound[binding.name] for binding in bindings if binding.reads}
    outputs = {binding.name: bound[binding.name]
               for binding in bindings if binding.access == "write"}
    if not in_place:
        return _counted(session.bind(inputs, outputs), [*outputs.values()])
    replaced = [(bound[name],
                 bound[name].device.heap.tensor(result, bound[name].shape, bound[name].dtype))
                for name, result in in_place.items()]
    outputs |= {new.name: new for _, new in replaced}
    run = _counted(session.bind(inputs, outputs), [*outputs.values()])

    def run_in_place() -> None:
        run()
        for old, new in replaced:
            old.device.memory.copy(old.start, new.start, old.nbytes)

    return run_in_place


def _counted(run: Callable[[], None], outputs: Sequence[Tensor]) -> Callable[[], None]:
    """The run of a session, of whose memory the heap learns if it is the host's."""
    if not outputs or not outputs[0].device.memory.host_visible:
        return run
    return FirstRun(run, outputs[0].device.heap.note_arena,
                    [output.host_view() for output in outputs])


_BIND = "set table['name'] = tensor"


class Arguments:
    """A complete, unchanging set of tensors for a state.

    Attributes:
        reads, writes: the tensors that it reads and writes, the memory of its intermediates among
            the latter.
        transients: allocations of transient tensors without memory yet.
        execute: runs the state on them, if all have memory.
        aliases: two tensors on the same memory, the second of which is written; None if there are
            none.
    """

    def __init__(self, state: State, tensors: tuple[Tensor, ...],
                 memory: Tensor | None = None) -> None:
        pairs = list(zip(state.bindings, tensors, strict=True))
        changed = () if memory is None else (memory,)
        self.state = state
        self.reads = tuple([tensor for binding, tensor in pairs if binding.access != "write"])
        self.writes = (*[tensor for binding, tensor in pairs if binding.access != "read"], *changed)
        self.transients = tuple(dict.fromkeys(a for a in (t.allocation for t in tensors)
                                              if isinstance(a, Transient)))
        self.execute = _refuse if self.transients else _prepare(state, tensors, memory)
        self._tensors, self._memory = tensors, memory
        self.aliases = self._aliases()
        self._placed: tuple[tuple[Allocation | None, ...], Arguments] | None = None

    def _aliases(self) -> tuple[Tensor, Tensor] | None:
        """Two tensors on the same memory, of two bindings, the second of which is written; None if
        there are none."""
        for index, binding in enumerate(self.state.bindings):
            if binding.access == "read":
                continue
            written = self._tensors[index]
            for number, other in enumerate(self._tensors):
                is_later = number > index and self.state.bindings[number].access != "read"
                if number != index and not is_later and written.overlaps(other):
                    return other, written
        return None

    def forget_memory(self) -> None:
        """Let the memory go that transient tensors had."""
        self._placed = None

    def with_memory(self) -> Arguments:
        """These arguments on the memory that transient tensors have now; cached until that
        changes."""
        places = tuple([transient.place for transient in self.transients])
        if self._placed is None or self._placed[0] != places:
            resident = tuple(tensor.resident() for tensor in self._tensors)
            self._placed = places, Arguments(self.state, resident, self._memory)
        return self._placed[1]


def _refuse() -> None:
    """In place of a run on transient tensors that no commit has placed."""
    raise AssertionError("a commit gives transient tensors their memory first")


def _prepare(state: State, tensors: tuple[Tensor, ...],
             memory: Tensor | None) -> Callable[[], None]:
    """A function that runs a state. What has strides is gathered before and scattered after it."""
    if isinstance(state, PipelineState) and memory is not None:
        return state.prepare(tensors, memory)  # of a GPU, where nothing has strides
    if all([tensor.contiguous for tensor in tensors]):
        return state.prepare(tensors)
    packed = [tensor if tensor.contiguous
              else state.device.heap.tensor(tensor.name, tensor.shape, tensor.dtype)
              for tensor in tensors]
    run = state.prepare(packed)
    strided = [(binding, tensor, copy)
               for binding, tensor, copy in zip(state.bindings, tensors, packed, strict=True)
               if not tensor.contiguous]

    def run_packed() -> None:
        for binding, tensor, copy in strided:
            if binding.reads:
                copy.host_view()[...] = tensor.host_view()
        run()
        for binding, tensor, copy in strided:
            if binding.writes:
                tensor.host_view()[...] = copy.host_view()

    return run_packed


class Intermediates:
    """Memory for what networks compute between their inputs and outputs, made by
    `Device.intermediates`. Networks that some order puts one after the other share it.

    Our own networks on a GPU run in it. ONNX Runtime takes nobody's memory: its networks run in the
    arena that all of them share, which `Heap.size` and `Heap.peak` count.

    Attributes:
        size: bytes.
    """

    def __init__(self, device: TensorDevice, size: int) -> None:
        self.device = device
        self.size = size

    @cached_property
    def memory(self) -> Tensor:
        """The memory, taken from the device's heap when the first network needs it."""
        elements = -(-self.size // HALF.itemsize)
        return self.device.heap.tensor("intermediates", (max(1, elements),), "float16")

    def memory_for(self, state: PipelineState) -> Tensor | None:
        """The memory to give to a network, None if it takes none.

        Raises BindingError where there is too little, or the state is another device's.
        """
        if state.device is not self.device:
            raise BindingError(f"{state.command} and the memory of its intermediates belong to "
                               "different devices: make both on one")
        needed = state.intermediates_size or 0
        if needed > self.size:
            fix = "give device.intermediates the states of all networks that share it"
            raise BindingError(f"{state.command} needs {needed:,} bytes for its intermediates, but "
                               f"the memory given has {self.size:,}: {fix}")
        return self.memory if state.takes_memory else None


class ArgumentTable:
    """Tensors by binding name, checked when they are set. A dispatch uses the tensors that are set
    when it is recorded.

    `table["name"] = tensor` raises BindingError for an unknown name, a wrong shape or data type,
    another device's tensor, a released tensor, or a read-only one that the state would write.
    """

    def __init__(self, state: State, tensors: Mapping[str, Tensor] | None = None) -> None:
        self.state = state
        self._bindings: dict[str, Binding] = {binding.name: binding for binding in state.bindings}
        self._tensors: dict[str, Tensor] = {}
        self._arguments: Arguments | None = None
        self._memory: Tensor | None = None
        self._known: dict[tuple[Tensor, ...], Arguments] = {}
        for name, tensor in (tensors or {}).items():
            self[name] = tensor

    def __setitem__(self, name: str, tensor: Tensor) -> None:
        if self._tensors.get(name) is tensor and not tensor.released:
            return
        self._check(self._binding(name), tensor)
        self._tensors[name] = tensor
        self._arguments = None

    def bind(self, tensors: Mapping[str, Tensor]) -> None:
        """Set all tensors at once. Raises BindingError for one that is missing, too."""
        missing = [name for name in self._bindings if name not in tensors]
        if missing:
            raise BindingError(f"{self.state.command}: nothing is bound to {_quote(missing)}: give "
                               f"{missing[0]}=")
        for name, tensor in tensors.items():
            self[name] = tensor

    def __getitem__(self, name: str) -> Tensor:
        """The tensor bound to a name. Raises BindingError when the name is unknown or has no
        tensor."""
        self._binding(name)
        if name not in self._tensors:
            raise BindingError(f"{self.state.command}: nothing is bound to '{name}': {_BIND}")
        return self._tensors[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._tensors)

    def arguments(self, memory: Tensor | None = None) -> Arguments:
        """The complete set of tensors, with memory for intermediates. Raises BindingError when some
        are unbound or their sizes do not fit together."""
        if self._arguments is None or memory is not self._memory:
            unbound = [name for name in self._bindings if name not in self._tensors]
            if unbound:
                raise BindingError(f"{self.state.command}: nothing is bound to {_quote(unbound)}: "
                                   f"{_BIND}")
            tensors = tuple([self._tensors[name] for name in self._bindings])
            key, self._memory = (*tensors, *(() if memory is None else (memory,))), memory
            self._arguments = self._known.get(key) or self._make_arguments(key, tensors)
        return self._arguments

    def _make_arguments(self, named: tuple[Tensor, ...], tensors: tuple[Tensor, ...]) -> Arguments:
        """Arguments that are known again, beside the last ones before, as histories swap from frame
        to frame; unless these keep memory of others alive."""
        self._check_together()
        before = [*self._known.items()][-1:]
        for _, last in before:
            last.forget_memory()
        self._known = {key: last for key, last in before if not any(
            tensor.released or (tensor.allocation.borrowed and tensor not in tensors)
            for tensor in key)}
        made = self._known[named] = Arguments(self.state, tensors, self._memory)
        return made

    def _binding(self, name: str) -> Binding:
        if name not in self._bindings:
            raise BindingError(f"{self.state.command} has no binding '{name}': it has "
                               f"{_quote(self._bindings)}")
        return self._bindings[name]

    def _check(self, binding: Binding, tensor: Tensor) -> None:
        """Raise BindingError where a tensor does not fit a binding."""
        where = f"{self.state.command}, binding '{binding.name}'"
        if not isinstance(tensor, Tensor):
            kind = type(tensor).__name__
            raise BindingError(f"{where}: {kind} is not a tensor: use device.wrap or "
                               "device.heap.tensor")
        if tensor.device is not self.state.device:
            raise BindingError(f"{where}: tensor '{tensor.name}' belongs to another device: make "
                               "it on this one")
        if tensor.released:
            raise BindingError(f"{where}: tensor '{tensor.name}' was released: bind a new one")
        if tensor.dtype != binding.dtype:
            raise BindingError(f"{where}: tensor '{tensor.name}' is {tensor.dtype}, it must be "
                               f"{binding.dtype}")
        if binding.shape is not None and not could_match(tensor.shape, binding.shape):
            raise BindingError(f"{where}: tensor '{tensor.name}' is {tensor.shape}, it must be "
                               f"{_text(binding.shape)}")
        if binding.writes and not tensor.allocation.writable:
            fix = "wrap a writable one"
            raise BindingError(f"{where} is written, but tensor '{tensor.name}' wraps a read-only "
                               f"array: {fix}")

    def _check_together(self) -> None:
        declared = {name: binding.shape
                    for name, binding in self._bindings.items() if binding.shape is not None}
        try:
            solve({name: tensor.shape for name, tensor in self._tensors.items()}, declared)
        except BindingError as error:
            raise BindingError(f"{self.state.command}: {error}") from None


def _quote(names: Mapping[str, object] | list[str]) -> str:
    return ", ".join(f"'{name}'" for name in names)


def _text(shape: tuple[int | str, ...]) -> str:
    return f"({', '.join(str(size) for size in shape)})"


_SCALED = re.compile(r"(?:(\d+) *\* *)?([A-Za-z_]\w*)")


class Dimension(NamedTuple):
    """`factor` times the value of `symbol`, or just `factor` when the symbol is None."""

    factor: int
    symbol: str | None


@cache
def parse(dimension: int | str) -> Dimension:
    """A declared dimension: a number, 'symbol' or 'k*symbol' with a whole number k of at
    least 1."""
    if isinstance(dimension, int):
        return Dimension(dimension, None)
    match = _SCALED.fullmatch(dimension.strip())
    if match is None or match[1] == "0":
        raise BindingError(f"dimension '{dimension}' is not a number, a symbol or 'k*symbol'")
    return Dimension(int(match[1] or 1), match[2])


def could_match(shape: tuple[int, ...], declared: tuple[int | str, ...]) -> bool:
    """Whether a shape has the declared rank and fixed sizes, whatever the symbols' values are
    elsewhere."""
    if len(shape) != len(declared):
        return False
    dimensions = [parse(item) for item in declared]
    return all(
        size == dim.factor if dim.symbol is None else size % dim.factor == 0
        for size, dim in zip(shape, dimensions, strict=True)
    )


def solve(shapes: Mapping[str, tuple[int, ...]],
          declared: Mapping[str, tuple[int | str, ...]]) -> dict[str, int]:
    """Values of the symbols that make every shape its declared one; BindingError naming two
    bindings that disagree."""
    values: dict[str, int] = {}
    origin: dict[str, str] = {}
    for name, dimensions in declared.items():
        for size, dimension in zip(shapes[name], dimensions, strict=True):
            factor, symbol = parse(dimension)
            if symbol is None:
                continue
            value = size // factor
            if values.setdefault(symbol, value) != value:
                raise BindingError(
                    f"'{origin[symbol]}' {shapes[origin[symbol]]} and '{name}' {shapes[name]} do "
                    f"not fit together: '{symbol}' is {values[symbol]} in the first and {value} in "
                    "the second"
                )
            origin.setdefault(symbol, name)
    return values
