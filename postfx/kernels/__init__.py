"""Small compute kernels: named tensor arguments, a function that computes rows of the output on the
CPU, and where the other forms are: a portable one in ONNX, and a source for CUDA.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from postfx.compiled.library import Rows
from postfx.system import models_dir

_PACKAGE = Path(__file__).resolve().parent.parent

BRIGHTEST = np.float32(1e10)
"""Light beyond counts as this much where colours are looked up, so that infinity times zero is no
NaN."""


@dataclass(frozen=True)
class Blocks:
    """How a GPU runs a kernel whose threads work together.

    Attributes:
        rows: of the kernel's work that a block makes; 0 if `most` blocks share all of it.
        threads: of a block, in one axis.
        shared: bytes of dynamic shared memory, or as many as the GPU has.
        most: blocks at most; with fewer than there are rows for, each takes every so many rows.
        columns: of its rows that a block makes; 0 for all of them.
        between: numbers in memory that blocks share, 0 before the first run and left to the next
            one; the CUDA function's last argument.
    """

    rows: int
    threads: int
    shared: int = 0
    most: int = 65535
    columns: int = 0
    between: int = 0

    def grid(self, rows: int, columns: int) -> tuple[int, int]:
        """How many there are for a kernel of such an extent, across and down."""
        across = -(-columns // self.columns) if self.columns else 1
        return across, min(-(-rows // self.rows), self.most) if self.rows else self.most


@dataclass(frozen=True)
class Kernel:
    """One small compute kernel, over float32 tensors unless `types` says otherwise.

    On the CPU `Device.compute_state(kernel)` runs `rows`, split into bands over the device's
    threads. On a GPU it runs the kernel's CUDA source. Where there is none, it runs the portable
    definition, an ONNX file whose inputs and outputs carry the names given here.

    The kernels that come with postfx have their portable definitions in `models/kernels`. Those of
    a plug-in are found in the folder of the module that defines `rows`, or in `folder`:
    `<name>.onnx`, and CUDA functions of the kernel's name in any file `*.cu`. A kernel of a plug-in
    never gets a form of ours, whatever its name.

    Attributes:
        name: the kernel's and its portable file's name, for example 'slice_apply'.
        reads: names of the arguments that are read, in argument order; scalars are small vectors
            such as 'params'.
        writes: names of the arguments that are written, in argument order. One that is also read is
            changed in place: it is one argument, among those that are read, and one output
            '<name>_out' of the portable definition.
        rows: `rows(y0, y1, *reads, *writes)` computes rows y0 to y1 - 1 of every written argument
            and nothing else. `postfx.compiled.library.Rows` names one in C++. Any function of these
            arguments will do, which the device's threads call for bands of rows at once.
        row_axis: the written binding and its axis that count the rows, for example ('output', 0).
        shapes: binding name -> dimensions, each a number or a symbol such as 'height'; a symbol has
            one value within one dispatch, and 'k*symbol' with a whole number k is allowed
            ('2*height'). Compiled rows do not check bounds, so shapes given here are checked for
            them; they also let the device compile `rows` before the first frame.
        types: binding name -> element type, if not float32.
        blocks: of threads on a GPU; by default each thread makes some pixels.
        pixels: how many of them, down and across.
        folder: where a plug-in keeps the other forms, if not beside the module of `rows`.
    """

    name: str
    reads: tuple[str, ...]
    writes: tuple[str, ...]
    rows: Callable[..., None]
    row_axis: tuple[str, int]
    shapes: Mapping[str, tuple[int | str, ...]] = field(default_factory=dict, hash=False)
    types: Mapping[str, str] = field(default_factory=dict, hash=False)
    blocks: Blocks | None = None
    pixels: tuple[int, int] = (1, 1)
    folder: Path | None = None

    def __post_init__(self) -> None:
        names = self.reads + self.writes
        if len(set(self.reads)) + len(set(self.writes)) != len(names):
            raise ValueError(f"kernel '{self.name}' names a binding twice: {', '.join(names)}")
        if self.row_axis[0] not in self.writes:
            raise ValueError(f"kernel '{self.name}' counts rows of '{self.row_axis[0]}', which it "
                             "does not write")
        unknown = {*self.shapes, *self.types} - set(names)
        if unknown:
            raise ValueError(f"kernel '{self.name}' gives shapes or types of unknown bindings: "
                             f"{', '.join(sorted(unknown))}")

    @property
    def in_place(self) -> dict[str, str]:
        """Arguments that are changed in place, with the name of the portable definition's
        output."""
        return {name: f"{name}_out" for name in self.reads if name in self.writes}

    def fixed_shape(self, name: str) -> tuple[int, ...]:
        """The shape of a binding without symbols; ValueError if it has some."""
        return tuple(int(size) for size in self.shapes[name])

    @property
    def home(self) -> Path | None:
        """Folder of a plug-in's other forms; None for a kernel that comes with postfx."""
        if self.folder is not None:
            return self.folder
        if isinstance(self.rows, Rows):
            return self.rows.header and self.rows.header.resolve().parent
        # a compiler of Python keeps the function's source in `py_func`
        code = getattr(getattr(self.rows, "py_func", self.rows), "__code__", None)
        folder = Path(code.co_filename).resolve().parent if code else Path(os.devnull)
        return None if folder.is_relative_to(_PACKAGE) else folder

    @property
    def portable(self) -> Path:
        """The file of the portable definition, which may not exist."""
        return (self.home or models_dir() / "kernels") / f"{self.name}.onnx"


# Sources of kernels

KERNEL_SOURCES = _PACKAGE
"""Where our kernels lie, beside the modules that their constants come from."""
SHARED = KERNEL_SOURCES / "kernels"
_KERNEL = re.compile(r'extern "C" __global__ void (?:__launch_bounds__\([^)]*\)\s+)?(\w+)\(')
_IN_TWO_FORMS = re.compile(r"^template <class Number>\n__global__ void "
                           r"(__launch_bounds__\([^)]*\)\s+)?(\w+)\(([^)]*)\)", re.M)
_NAME = re.compile(r"\b[A-Z][A-Z\d_]+\b")
_INCLUDE = re.compile(r'^#include "(.+)"\n', re.M)
_CONSTANT = re.compile(r"^constexpr \w+ ([A-Z][A-Z\d_]*) = .*;.*\n", re.M)
_TYPES = {int: "int", np.float64: "double"}
"""Types of constants in CUDA, by their types in Python; all others are float."""


def find_source(kernel: Kernel) -> Path | None:
    """The file that holds a kernel; None where it is not written for CUDA."""
    return _families(kernel.home or KERNEL_SOURCES).get(kernel.name)


@cache
def read_source(family: Path) -> str:
    """The source that is compiled for a file of kernels: the declaration of arguments, for our own
    kernels also the constants and the code that all families share, then the header of the same
    name, if there is one, and the file. A plug-in's `#include <postfx/mlp.cuh>` becomes that
    header."""
    view = (SHARED / "view.cuh").read_text()
    files = [path for path in (family.with_suffix(".cuh"), family) if path.exists()]
    if not family.is_relative_to(KERNEL_SOURCES):
        own = "".join(path.read_text() for path in files)
        return view + own.replace("#include <postfx/mlp.cuh>", _expand([SHARED / "mlp.cuh"]), 1)
    return view + _with_constants(family, _in_two_forms(_expand([SHARED / "common.cuh", *files])))


def _in_two_forms(source: str) -> str:
    """A source whose kernels of a type `Number` are functions that two kernels call: `name` with
    numbers in single precision, `name_half` with bits of half precision."""
    kernels = ""
    for bounds, name, parameters in _IN_TWO_FORMS.findall(source):
        given = ", ".join(view.split()[-1] for view in parameters.split(","))
        for ending, number in (("", "float"), ("_half", "Half")):
            kernels += (f'extern "C" __global__ void {bounds}{name}{ending}({parameters}) {{\n'
                        f"    {name}_by<{number}>({given});\n}}\n")
    functions = _IN_TWO_FORMS.sub(r"template <class Number>\n__device__ inline void \2_by(\3)",
                                  source)
    return functions + kernels


_OF_A_CPU = {"number.h", "rows.h", "neural.h", "denoise.h"}
"""Headers whose place on a GPU number.cuh, view.cuh, mlp.cuh and Python's constants take."""


def _expand(files: Sequence[Path], known: set[Path] | None = None) -> str:
    """Files one after the other with our headers in the place of their includes, each header
    once."""
    known = set() if known is None else known
    text = ""
    for path in map(Path.resolve, files):
        if path.name in _OF_A_CPU or path in known:
            continue
        known.add(path)
        before, *rest = _INCLUDE.split(path.read_text().replace("#pragma once\n", ""))
        text += before
        for name, behind in zip(rest[::2], rest[1::2], strict=True):
            text += _expand([path.parent / name], known) + behind
    return text


def _with_constants(family: Path, source: str) -> str:
    """A source behind its constants, where those of Python take the place of a header's own."""
    constants = constants_of(family, source)

    def left(line: re.Match[str]) -> str:
        return "" if line[1] in constants else f"[[maybe_unused]] {line[0]}"

    return print_constants(constants) + _CONSTANT.sub(left, source)


@cache
def convolution_source(warpgroups: bool) -> str:
    """What is compiled before the kernels of a network's layers."""
    source = _expand([SHARED / name for name in ("common.cuh", "products.cuh", "convolution.cuh")])
    return ("#define WARPGROUPS\n" * warpgroups + (SHARED / "view.cuh").read_text()
            + _with_constants(SHARED / "denoise" / "network_io.cu", source))


def constants_of(family: Path, source: str) -> dict[str, Any]:
    """Numbers of Python that a source of ours names, by name: those of the module beside its file,
    if there is one, those that the upscaler's kernels share, and those of this module. A pair NAME
    of a low and a high number is NAME_LOW and NAME_HIGH."""
    modules = [__name__, "postfx.kernels.denoise"]
    if family.with_suffix(".py").exists():
        modules.append(".".join(("postfx",
                                 *family.relative_to(KERNEL_SOURCES).with_suffix("").parts)))
    known: dict[str, Any] = {}
    for module in modules:
        known |= vars(import_module(module))
    pairs = {f"{name}_{end}": value[at]
             for name, value in known.items() if isinstance(value, tuple) and len(value) == 2
             for at, end in enumerate(("LOW", "HIGH"))}
    found = {name: (known | pairs).get(name) for name in dict.fromkeys(_NAME.findall(source))}
    return {name: value
            for name, value in found.items() if isinstance(value, int | float | np.number)}


def print_constants(constants: Mapping[str, Any]) -> str:
    """The constants in CUDA."""
    lines = []
    for name, value in constants.items():
        kind = _TYPES.get(type(value), "float")
        # NumPy's own text depends on its print options
        digits = (int(value) if kind == "int" else float(value))
        lines.append(f"[[maybe_unused]] const {kind} {name} = "
                     f"{digits!r}{'f' if kind == 'float' else ''};\n")
    return "".join(lines)


@cache
def _families(folder: Path) -> dict[str, Path]:
    """Every kernel's file by the kernel's name: below our folder, or in a plug-in's."""
    sources = sorted(folder.rglob("*.cu") if folder == KERNEL_SOURCES else folder.glob("*.cu"))
    return {name: path for path in sources
            for name in _KERNEL.findall(_in_two_forms(path.read_text()))}
