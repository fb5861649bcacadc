"""ONNX Runtime sessions: shared arena, fixed dimensions, bindings on raw pointers, and optimised
networks on disk.

ONNX Runtime optimises a network for the machine whenever it makes a session. The result on the CPU
is cached in a file of the user, named by everything it depends on: the model's content, the sizes
of its dimensions, ONNX Runtime's version and the processor. It computes the same bits.
"""

from __future__ import annotations

import base64
import hashlib
import mmap
import os
import platform
import re
import threading
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cache, partial
from importlib import import_module
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from postfx.errors import DeviceError, ModelError
from postfx.files import atomic_file, parse_json
from postfx.runtime.model_file import read_tables
from postfx.runtime.own_convolutions import has_own_convolutions, operators_library
from postfx.runtime.tensor import Tensor, element_type
from postfx.system import held_bytes, private_folder, return_free_memory, usable_memory
from postfx.workers import finished_before_the_end

__all__ = ["CPU", "FirstRun", "Placement", "Provider", "Session", "TableSession", "find_provider",
           "first_line", "has_networks", "ort", "parse_provider", "providers_of", "session_options"]


class _Missing:
    """Stands for ONNX Runtime where it cannot be imported: kernels run, networks are an error."""

    __version__ = "missing"

    def __getattr__(self, name: str) -> Any:
        raise DeviceError("networks need the package onnxruntime: install it, or do without: "
                          "--model classic filters, and the looks aces2, agx and pbr_neutral are "
                          "tables")

    def get_available_providers(self) -> list[str]:
        return []


try:
    import onnxruntime as ort

    with suppress(AttributeError, RuntimeError):
        ort.disable_telemetry_events()  # of one that the program had loaded before postfx
except ImportError:
    ort = _Missing()


def has_networks() -> bool:
    """Whether ONNX Runtime is there, which runs networks."""
    return not isinstance(ort, _Missing)


CONSTANTS = "postfx.constants"
"""Key of a model's metadata under which `training.export` puts outputs that no node makes, which
some execution providers cannot have: {name: {"shape": [...], "float32": "base64"}}."""
_ELEMENT_TYPES = {"float": "float32", "double": "float64"}
_BFLOAT16 = 16
"""ONNX's number of the type, which NumPy does not have."""
OPTIMISED_FOLDER = "networks"
MOST_CACHE_BYTES = 256 << 20
"""Total bytes of cached files; the least recently used are removed first."""
LARGEST_MODEL = 2 << 20
"""Largest model that is cached: reading and checking a larger one takes as long as optimising it
again."""
HASH_BYTES = hashlib.sha256().digest_size
"""Length of the hash at the start of a file."""
EXTERNAL_WEIGHTS = b"location"
"""Occurs in every model with weights in other files, so its content does not identify it."""
LEAST_GROWTH = 1 << 18
"""Bytes: less is what the run itself and other threads took."""
PROCESSOR = ("model name", "flags", "Features")


CPU = "CPUExecutionProvider"


class Provider(NamedTuple):
    """An execution provider of ONNX Runtime that networks run on, with tensors in the host's
    memory.

    Attributes:
        name: ONNX Runtime's name; its end 'ExecutionProvider' may be left out.
        options: name -> value, the provider's own.
        library: file, or name of the installed package, of a provider that is no part of this
            onnxruntime but a plug-in for it.
    """

    name: str
    options: tuple[tuple[str, str], ...] = ()
    library: str | None = None

    def __str__(self) -> str:
        parts = [self.name, *(f"{key}={value}" for key, value in self.options)]
        return ",".join(parts + [f"library={self.library}"] * (self.library is not None))


def parse_provider(text: str) -> Provider:
    """A provider from 'NAME[,option=value...][,library=FILE|PACKAGE]'. Raises DeviceError where
    that cannot be read."""
    name, *rest = re.split(r",(?=\w+=)", text.strip())
    options = dict(part.partition("=")[::2] for part in rest)
    if not re.fullmatch(r"\w+", name):
        raise DeviceError(f"provider '{text}' cannot be read: write NAME,option=value,..., as in "
                          "OpenVINO,device_type=CPU")
    library = options.pop("library", None)
    return Provider(name, tuple(options.items()), library)


def find_provider(asked: Provider) -> Provider:
    """The provider by its full name; a plug-in's library is loaded.

    Raises DeviceError that lists what there is when it is none of this onnxruntime's, the library
    cannot be loaded, or the machine has no device for it.
    """
    if asked.library is not None:
        _register(asked.library)
    there = ({device.ep_name for device in _plug_in_devices()} if asked.library
             else set(ort.get_available_providers()))
    names = {name.removesuffix("ExecutionProvider").lower(): name for name in there}
    name = names.get(asked.name.removesuffix("ExecutionProvider").lower())
    if name is None:
        known = ", ".join(sorted(there)) or "none"
        if asked.library:
            raise DeviceError(f"provider '{asked.name}' has no device on this machine, although "
                              f"'{asked.library}' is loaded: those with one are {known}")
        raise DeviceError(f"no provider '{asked.name}' in onnxruntime {ort.__version__}, which has "
                          f"{known}: install one that has it, in an environment of its own, or "
                          "give a plug-in as library=FILE|PACKAGE")
    return asked._replace(name=name)


@cache
def _register(library: str) -> None:
    """Load a plug-in's library, once a process."""
    try:
        path = library if os.path.isfile(library) else import_module(library).get_library_path()
        ort.register_execution_provider_library(f"postfx {library}", str(Path(path).absolute()))
    except (ImportError, AttributeError, TypeError) as error:
        raise DeviceError(f"library '{library}' of a provider is neither a file nor a package that "
                          f"has one ({first_line(error)}), or onnxruntime {ort.__version__} is too "
                          "old for plug-ins") from error
    except Exception as error:
        raise DeviceError(f"library '{library}' of a provider cannot be loaded: "
                          f"{first_line(error)}") from error


def _plug_in_devices() -> list[Any]:
    return list(ort.get_ep_devices()) if hasattr(ort, "get_ep_devices") else []


@dataclass(frozen=True)
class Placement:
    """Where sessions run: ONNX Runtime's names for the provider and the memory, the CPU threads, a
    GPU's stream, and what the user asked for of a provider."""

    provider: str
    memory: str
    index: int
    threads: int
    stream: int = 0
    asked: Provider | None = None

    def __str__(self) -> str:
        return str(self.asked or self.provider)


class Value(NamedTuple):
    """An input or output of a session; dimensions that are not fixed are symbols or None."""

    name: str
    shape: tuple[int | str | None, ...]
    dtype: str

    @property
    def fixed(self) -> tuple[int, ...]:
        """The shape of a value whose dimensions are all fixed."""
        return tuple(size for size in self.shape if isinstance(size, int))


class Session:
    """One model ready to run, specialised for `dims` (free dimension name -> size); `folder` has
    files it refers to.

    An `exclusive` session runs on its provider alone; no node may fall back to the CPU. One with an
    arena `of_its_own` shares no memory with others.
    """

    @finished_before_the_end()
    def __init__(
        self, model: bytes, name: str, placement: Placement, dims: Mapping[str, int],
        folder: Path | None = None, exclusive: bool = False, of_its_own: bool = False,
    ) -> None:
        def options() -> ort.SessionOptions:
            found = session_options(placement, dims, not of_its_own)
            if has_own_convolutions(model):
                found.register_custom_ops_library(str(operators_library()))
            if exclusive:
                found.add_session_config_entry("session.disable_cpu_ep_fallback", "1")
            if folder is not None:
                found.add_session_config_entry(
                    "session.model_external_initializers_file_folder_path", str(folder)
                )
            return found

        try:
            if placement.provider == CPU and not placement.asked:
                self._session = make_session(model, dims, options)
            elif placement.asked and placement.asked.library:
                self._session = _plug_in_session(model, options(), placement.asked)
            else:
                self._session = ort.InferenceSession(model, options(),
                                                     providers=providers_of(placement, exclusive),
                                                     enable_fallback=not placement.asked)
            self.inputs = [_value(item) for item in self._session.get_inputs()]
            self.outputs = [_value(item) for item in self._session.get_outputs()]
        except Exception as error:
            raise ModelError(f"model '{name}' cannot be made ready: {first_line(error)}") from error
        if self._session.get_providers()[0] != placement.provider:
            raise ModelError(f"model '{name}' cannot run on {placement.provider}: see ONNX "
                             "Runtime's warning above")
        self.stream = placement.stream
        self._name = name
        self._placement = placement

    @finished_before_the_end()
    def bind(self, inputs: Mapping[str, Tensor],
             outputs: Mapping[str, Tensor]) -> Callable[[], None]:
        """A function that runs the model on these tensors in place."""
        binding = self._session.io_binding()
        binding.session = self._session  # which has to outlive it
        memory, index = self._placement.memory, self._placement.index
        given = [(name, memory, index, _element_type(tensor), tensor.shape, tensor.start)
                 for name, tensor in inputs.items()]

        def bind_inputs() -> None:
            for arguments in given:
                binding.bind_input(*arguments)

        bind_inputs()
        for name, tensor in outputs.items():
            binding.bind_output(name, memory, index, _element_type(tensor), tensor.shape,
                                tensor.start)
        options = ort.RunOptions()
        if self._placement.stream:  # the command buffer waits once, at its end
            options.add_run_config_entry("disable_synchronize_execution_providers", "1")
        run = partial(self._session.run_with_iobinding, binding, options)
        if not self._placement.asked:
            return run

        def run_elsewhere() -> None:
            # binding copies an input to a provider that has its own memory, running does not
            bind_inputs()
            run()

        return run_elsewhere

    @finished_before_the_end()
    def intermediates(self) -> int | None:
        """Bytes that the first run takes beside inputs and outputs, measured with zeros; None where
        the system does not tell. The session must have an arena of its own, in which nothing ran.

        Raises ModelError if the model cannot be run.
        """
        binding = self._session.io_binding()
        arrays = [np.full(value.fixed, 0, element_type(value.dtype))  # all pages are there before
                  for value in (*self.inputs, *self.outputs)]
        binds = [binding.bind_input] * len(self.inputs) + [binding.bind_output] * len(self.outputs)
        for bind, value, array in zip(binds, (*self.inputs, *self.outputs), arrays, strict=True):
            element = _BFLOAT16 if value.dtype == "bfloat16" else array.dtype.type
            bind(value.name, "cpu", 0, element, array.shape, array.ctypes.data)
        grown: list[int] = []
        return_free_memory()
        try:
            FirstRun(partial(self._session.run_with_iobinding, binding), grown.append)()
        except Exception as error:
            raise ModelError(f"model '{self._name}' cannot be run: {first_line(error)}") from error
        return grown[0] if grown else None

    @finished_before_the_end()
    def constants(self, names: Sequence[str]) -> dict[str, np.ndarray]:
        """Outputs that depend on no input: all that the model's metadata holds, and these outputs,
        from one run on zeros.

        Raises ModelError if the model lacks them, or if they cannot be computed, for lack of memory
        for example.
        """
        stored = self._stored_constants()
        computed = [name for name in names if name not in stored]
        if not computed:
            return stored
        zeros = {value.name: np.zeros(value.fixed, element_type(value.dtype))
                 for value in self.inputs}
        options = ort.RunOptions()
        options.only_execute_path_to_fetches = True
        try:
            return stored | dict(zip(computed, self._session.run(computed, zeros, options),
                                     strict=True))
        except Exception as error:
            raise ModelError(f"model '{self._name}' cannot be run: {first_line(error)}") from error

    def _stored_constants(self) -> dict[str, np.ndarray]:
        """Constants in the model's metadata, by name."""
        text = self._session.get_modelmeta().custom_metadata_map.get(CONSTANTS, "{}")
        try:
            return {str(name): np.frombuffer(
                base64.b64decode(told["float32"], validate=True), "<f4"
            ).reshape(told["shape"]).astype(np.float32) for name, told in parse_json(text).items()}
        except (ValueError, TypeError, KeyError, AttributeError, OverflowError) as error:
            raise ModelError(f"model '{self._name}': '{CONSTANTS}' of its metadata is damaged: "
                             f"{first_line(error)}") from error

    @finished_before_the_end()
    def copy_bytes(self, source: tuple[str, int, int], target: tuple[str, int, int],
                   nbytes: int) -> None:
        """Run a copying model from one (memory, index, pointer) to another."""
        binding = self._session.io_binding()
        binding.bind_input(self.inputs[0].name, *source[:2], np.uint8, (nbytes,), source[2])
        binding.bind_output(self.outputs[0].name, *target[:2], np.uint8, (nbytes,), target[2])
        self._session.run_with_iobinding(binding)


class FirstRun:
    """Runs a session; the first time it tells how much memory ONNX Runtime took for it.

    ONNX Runtime tells nobody what its arena holds, and the arena takes more from the system than
    networks touch. So the pages that the process has touched are counted before and after. What
    other threads touch meanwhile is counted, too.

    Args:
        tell: gets the bytes.
        results: arrays that the run writes, whose pages are no part of it.
    """

    _ALONE = threading.Lock()

    def __init__(self, run: Callable[[], None], tell: Callable[[int], None],
                 results: Sequence[np.ndarray] = ()) -> None:
        self._run = run
        self._tell: Callable[[int], None] | None = tell
        self._results = results

    def __call__(self) -> None:
        """Run it."""
        if self._tell is None:
            self._run()
            return
        with self._ALONE:
            tell, self._tell = self._tell, None
            for array in self._results:
                array.reshape(-1).view(np.uint8)[::mmap.PAGESIZE] = 0  # they are written as a whole
            self._results = ()
            before = held_bytes()
            try:
                self._run()
            finally:
                after = held_bytes()
                if tell is not None and before is not None and after is not None:
                    grown = after - before
                    tell(grown if grown >= LEAST_GROWTH else 0)


class TableSession:
    """Stands for a `Session` of a model without inputs where ONNX Runtime is missing: its outputs
    are read from the file. There is nothing to run."""

    stream = 0

    def __init__(self, content: bytes) -> None:
        self._tables = read_tables(content)
        self.inputs: list[Value] = []
        self.outputs = [Value(name, table.shape, "float32") for name, table in self._tables.items()]

    def bind(self, inputs: Mapping[str, Tensor],
             outputs: Mapping[str, Tensor]) -> Callable[[], None]:
        """See `Session`."""
        raise DeviceError("a table is looked up and not run")

    def constants(self, names: Sequence[str]) -> dict[str, np.ndarray]:
        """See `Session`."""
        return {name: self._tables[name] for name in names}


def first_line(error: BaseException) -> str:
    """An error's first line, or its type when it has no text."""
    return next(iter(str(error).strip().splitlines()), type(error).__name__)


@cache
def _register_shared_arena() -> None:
    """One allocator for all sessions of the process; private arenas would each keep their peak
    forever. It is limited to the machine's memory: a model that needs more fails, instead of the
    system killing the process."""
    info = ort.OrtMemoryInfo("Cpu", ort.OrtAllocatorType.ORT_ARENA_ALLOCATOR, 0,
                             ort.OrtMemType.DEFAULT)
    ort.create_and_register_allocator(info, ort.OrtArenaCfg(usable_memory(), -1, -1, -1))


def session_options(placement: Placement, dims: Mapping[str, int],
                    shared: bool = True) -> ort.SessionOptions:
    """Threads of the device, memory of the arena that all sessions share or of one of its own, free
    dimensions fixed."""
    _register_shared_arena()
    options = ort.SessionOptions()
    options.intra_op_num_threads = placement.threads
    options.log_severity_level = 3
    # The memory pattern's block is allocated on top of the first run's memory; docs/lab/runtime.md
    # has figures.
    options.enable_mem_pattern = False
    # Threads spin between nodes, longer than most take, but not on and on where a thread that they
    # wait for lost its core to others, and not between runs, when other sessions and kernels need
    # the cores.
    options.add_session_config_entry("session.intra_op.allow_spinning", "1")
    options.add_session_config_entry("session.intra_op.spin_duration_us", "200")
    options.add_session_config_entry("session.force_spinning_stop", "1")
    options.add_session_config_entry("session.use_env_allocators", "1" if shared else "0")
    for name, size in dims.items():
        options.add_free_dimension_override_by_name(name, size)
    return options


def providers_of(placement: Placement, exclusive: bool) -> list[Any]:
    """ONNX Runtime's list of providers; unless `exclusive`, the CPU runs nodes that the provider
    cannot."""
    if placement.asked:
        return ([(placement.provider, dict(placement.asked.options))]
                + [CPU] * (placement.provider != CPU))
    if placement.provider == CPU:
        return [CPU]
    options = {"prefer_nhwc": "1", "fuse_conv_bias": "1"}
    if placement.index:  # 0 is the default; since ONNX Runtime 1.26 naming it prints a warning
        options["device_id"] = str(placement.index)
    if placement.stream:
        options["user_compute_stream"] = str(placement.stream)
    return [(placement.provider, options)] + [CPU] * (not exclusive)


def _plug_in_session(model: bytes, options: ort.SessionOptions,
                     asked: Provider) -> ort.InferenceSession:
    """A session on all devices of a plug-in's provider, and for what that cannot run on the CPU."""
    devices = [device for device in _plug_in_devices() if device.ep_name == asked.name]
    options.add_provider_for_devices(devices, dict(asked.options))
    return ort.InferenceSession(model, options)


def _value(item: ort.NodeArg) -> Value:
    match = re.fullmatch(r"tensor\((\w+)\)", item.type)
    element = match[1] if match else item.type
    return Value(item.name, tuple(item.shape), _ELEMENT_TYPES.get(element, element))


def _element_type(tensor: Tensor) -> type | int:
    """ONNX Runtime's name for a tensor's elements: NumPy's type, or ONNX's number where NumPy has
    none."""
    return _BFLOAT16 if tensor.dtype == "bfloat16" else np.dtype(tensor.dtype).type


def make_session(model: bytes, dims: Mapping[str, int],
                 options: Callable[[], ort.SessionOptions]) -> ort.InferenceSession:
    """A session on the CPU, from the cached optimised model or the model itself. Raises ONNX
    Runtime's errors."""
    folder = (None if len(model) > LARGEST_MODEL or EXTERNAL_WEIGHTS in model
              else private_folder(OPTIMISED_FOLDER))
    if folder is None:
        return _session(model, options())
    path = folder / f"{_key(model, dims)}.onnx"
    return (_load_optimised(path, options()) or _optimise(path, model, options())
            or _session(model, options()))


def _session(model: bytes, options: ort.SessionOptions) -> ort.InferenceSession:
    return ort.InferenceSession(model, options, providers=[CPU])


def _load_optimised(path: Path, options: ort.SessionOptions) -> ort.InferenceSession | None:
    """A session from a cached file; None if it is missing or damaged."""
    try:
        if not path.is_file():  # to read a pipe may take for ever
            return None
        content = path.read_bytes()
        if hashlib.sha256(content[HASH_BYTES:]).digest() != content[:HASH_BYTES]:
            return None
        os.utime(path)
        options.graph_optimization_level = ort.GraphOptimizationLevel.ORT_DISABLE_ALL
        return _session(content[HASH_BYTES:], options)
    except Exception:  # if the model is at fault, loading it directly raises the error
        return None


def _optimise(path: Path, model: bytes, options: ort.SessionOptions) -> ort.InferenceSession | None:
    """A session of a model, whose optimised form is cached; None if that fails, for lack of space
    for example."""
    try:
        with atomic_file(path, durable=False) as part:
            options.optimized_model_filepath = str(part)
            session = _session(model, options)
            content = part.read_bytes()
            part.write_bytes(hashlib.sha256(content).digest() + content)
        _remove_oldest(path.parent)
        return session
    except Exception:  # as above
        return None


def _remove_oldest(folder: Path) -> None:
    facts = {file: file.stat() for file in folder.iterdir()}
    total = 0
    for file in sorted(facts, key=lambda file: facts[file].st_mtime, reverse=True):
        total += facts[file].st_size
        if total > MOST_CACHE_BYTES:
            file.unlink(missing_ok=True)


def _key(model: bytes, dims: Mapping[str, int]) -> str:
    known = hashlib.sha256(repr((ort.__version__, _processor(), sorted(dims.items()))).encode())
    known.update(model)
    return known.hexdigest()


@cache
def _processor() -> str:
    """Identifies the processor, for networks are optimised differently on different ones."""
    found = [platform.machine(), platform.processor()]
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        lines = []
    for name in PROCESSOR:
        found += [line for line in lines if line.startswith(name)][:1]
    return "\n".join(found)
