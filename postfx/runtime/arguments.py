"""Argument tables: which tensor a state's binding uses."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping

from postfx.errors import BindingError
from postfx.runtime.shapes import could_match, solve
from postfx.runtime.states import Binding, State
from postfx.runtime.tensor import Allocation, Tensor

_BIND = "set table['name'] = tensor"


class Arguments:
    """A complete, unchanging set of tensors for a state.

    Attributes:
        reads, writes: the tensors by what is done to them.
        transients: allocations of the transient ones that have no memory yet.
        execute: runs the state on them; None while some have no memory.
    """

    def __init__(self, state: State, tensors: tuple[Tensor, ...]) -> None:
        pairs = list(zip(state.bindings, tensors, strict=True))
        self.state = state
        self.reads = tuple(tensor for binding, tensor in pairs if binding.access == "read")
        self.writes = tuple(tensor for binding, tensor in pairs if binding.access == "write")
        self.transients = tuple(dict.fromkeys(t.allocation for t in tensors if t.allocation.unplaced))
        self.execute: Callable[[], None] | None = None if self.transients else state.prepare(tensors)
        self._tensors = tensors
        self._placed: tuple[tuple[Allocation | None, ...], Arguments] | None = None

    def placed(self) -> Arguments:
        """The same on the memory that transient tensors have now; made anew only when that has changed."""
        places = tuple([transient.placed for transient in self.transients])
        if self._placed is None or self._placed[0] != places:
            self._placed = places, Arguments(self.state, tuple(tensor.resident() for tensor in self._tensors))
        return self._placed[1]


class ArgumentTable:
    """Tensors by binding name, checked when they are set. A dispatch takes the tensors that are set at that moment.

    `table["name"] = tensor` raises BindingError for an unknown name, a wrong shape or data type, another device's
    tensor, a released tensor, or a read-only one where the state writes.
    """

    def __init__(self, state: State, tensors: Mapping[str, Tensor] | None = None) -> None:
        self.state = state
        self._bindings: dict[str, Binding] = {binding.name: binding for binding in state.bindings}
        self._tensors: dict[str, Tensor] = {}
        self._arguments: Arguments | None = None
        for name, tensor in (tensors or {}).items():
            self[name] = tensor

    def __setitem__(self, name: str, tensor: Tensor) -> None:
        if self._tensors.get(name) is tensor and not tensor.released:
            return
        self._check(self._binding(name), tensor)
        self._tensors[name] = tensor
        self._arguments = None

    def __getitem__(self, name: str) -> Tensor:
        """The tensor bound to a name. Raises BindingError when the name is unknown or has no tensor."""
        self._binding(name)
        if name not in self._tensors:
            raise BindingError(f"{self.state.command}: nothing is bound to '{name}': {_BIND}")
        return self._tensors[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._tensors)

    def arguments(self) -> Arguments:
        """The complete set of tensors. Raises BindingError when some are unbound or their sizes do not fit together."""
        if self._arguments is None:
            unbound = [name for name in self._bindings if name not in self._tensors]
            if unbound:
                raise BindingError(f"{self.state.command}: nothing is bound to {_quoted(unbound)}: {_BIND}")
            self._check_together()
            self._arguments = Arguments(self.state, tuple(self._tensors[name] for name in self._bindings))
        return self._arguments

    def _binding(self, name: str) -> Binding:
        if name not in self._bindings:
            raise BindingError(f"{self.state.command} has no binding '{name}': it has {_quoted(self._bindings)}")
        return self._bindings[name]

    def _check(self, binding: Binding, tensor: Tensor) -> None:
        where = f"{self.state.command}, binding '{binding.name}'"
        if not isinstance(tensor, Tensor):
            kind = type(tensor).__name__
            raise BindingError(f"{where}: {kind} is no tensor: use device.wrap or device.heap.tensor")
        if tensor.device is not self.state.device:
            raise BindingError(f"{where}: tensor '{tensor.name}' belongs to another device: make it on this one")
        if tensor.released:
            raise BindingError(f"{where}: tensor '{tensor.name}' was released: bind a new one")
        if tensor.dtype != binding.dtype:
            raise BindingError(f"{where}: tensor '{tensor.name}' is {tensor.dtype}, it must be {binding.dtype}")
        if binding.shape is not None and not could_match(tensor.shape, binding.shape):
            raise BindingError(f"{where}: tensor '{tensor.name}' is {tensor.shape}, it must be {_text(binding.shape)}")
        if binding.access == "write" and not tensor.allocation.writable:
            mend = "wrap one that may be written"
            raise BindingError(f"{where} is written, but tensor '{tensor.name}' wraps a read-only array: {mend}")

    def _check_together(self) -> None:
        declared = {name: binding.shape for name, binding in self._bindings.items() if binding.shape is not None}
        try:
            solve({name: tensor.shape for name, tensor in self._tensors.items()}, declared)
        except BindingError as error:
            raise BindingError(f"{self.state.command}: {error}") from None


def _quoted(names: Mapping[str, object] | list[str]) -> str:
    return ", ".join(f"'{name}'" for name in names)


def _text(shape: tuple[int | str, ...]) -> str:
    return f"({', '.join(str(size) for size in shape)})"
