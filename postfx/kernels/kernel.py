"""The compute kernel: named tensor arguments and a function that computes rows of its output."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field


@dataclass(frozen=True)
class Kernel:
    """One small compute kernel, over float32 tensors unless `types` says otherwise.

    On the CPU `Device.compute_state(kernel)` runs `rows`, split into bands over the device's threads. Elsewhere it
    runs the portable definition, `models/kernels/<name>.onnx`, whose inputs and outputs carry the names given here.

    Attributes:
        name: the kernel's and its portable file's name, for example 'slice_apply'.
        reads: names of the arguments that are read, in argument order; scalars are small vectors such as 'params'.
        writes: names of the arguments that are written, in argument order.
        rows: `rows(y0, y1, *reads, *writes)` computes rows y0 to y1 - 1 of every written argument and nothing else.
            Compile it with `kernel_jit` of `postfx.kernels.numeric`; `fastmath` only where parity with the portable
            definition holds; no `parallel=True`: the device owns the threads.
        row_axis: the written binding and its axis that count the rows, for example ('output', 0).
        shapes: binding name -> dimensions, each a number or a symbol such as 'height'; a symbol has one value
            within one dispatch, and 'k*symbol' with a whole number k is allowed ('2*height'). Compiled rows do not
            check bounds, so shapes given here are checked for them; they also let the device compile `rows` before
            the first frame.
        types: binding name -> element type, if not float32.
    """

    name: str
    reads: tuple[str, ...]
    writes: tuple[str, ...]
    rows: Callable[..., None]
    row_axis: tuple[str, int]
    shapes: Mapping[str, tuple[int | str, ...]] = field(default_factory=dict, hash=False)
    types: Mapping[str, str] = field(default_factory=dict, hash=False)

    def __post_init__(self) -> None:
        names = self.reads + self.writes
        if len(set(names)) != len(names):
            raise ValueError(f"kernel '{self.name}' names a binding twice: {', '.join(names)}")
        if self.row_axis[0] not in self.writes:
            raise ValueError(f"kernel '{self.name}' counts rows of '{self.row_axis[0]}', which it does not write")
        unknown = {*self.shapes, *self.types} - set(names)
        if unknown:
            raise ValueError(f"kernel '{self.name}' gives shapes or types of unknown bindings: "
                             f"{', '.join(sorted(unknown))}")

    def fixed_shape(self, name: str) -> tuple[int, ...]:
        """The shape of a binding without symbols; ValueError if it has some."""
        return tuple(int(size) for size in self.shapes[name])
