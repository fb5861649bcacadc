"""Runs CUDA kernels on the host: their sources compiled as C++, one thread a block, blocks in turn.

What a GPU does with them (memory, synchronisation between threads) is not seen here; the arithmetic is.
"""

from __future__ import annotations

import ctypes
import hashlib
import os
import re
import shutil
import subprocess
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from postfx.kernels import Kernel
from postfx.runtime.cuda import find_source, read_source
from postfx.system import private_folder

COMPILER = shutil.which("g++")
OPTIONS = ("-O1", "-std=c++17", "-shared", "-fPIC", "-Wno-unknown-pragmas")
KERNEL = re.compile(r'extern "C" __global__ void (?:__launch_bounds__\(\w+\) )?(\w+)\(([^)]*)\)')
SHIM = """
#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <cstring>
#define __global__
#define __device__
#define __shared__ static
#define __launch_bounds__(...)
using std::min;
using std::max;
using std::abs;
struct Index { int x, y, z; };
static Index blockIdx, threadIdx, blockDim = {1, 1, 1}, gridDim = {1, 1, 1};
static inline void __syncthreads() {}
template <class T> static inline T __ldg(const T* at) { return *at; }
static inline float __int_as_float(int bits) { float value; std::memcpy(&value, &bits, 4); return value; }
// Macros of the standard library that the GPU's compiler does not know.
#undef INFINITY
#undef NAN
#undef HUGE_VALF
"""


class View(ctypes.Structure):
    """A tensor as the kernels take it: with the lengths of its first four axes."""

    _fields_ = (("at", ctypes.c_void_p), ("size", ctypes.c_int * 4))


def view(array: np.ndarray) -> View:
    return View(array.ctypes.data, (ctypes.c_int * 4)(*array.shape[:4]))


def run(kernel: Kernel, arrays: Mapping[str, np.ndarray]) -> None:
    """Run a kernel on arrays by binding name; those that it writes are changed."""
    name, axis = kernel.row_axis
    shape = arrays[name].shape
    rows, columns = shape[axis], shape[axis + 1] if axis + 1 < len(shape) else 1
    function = getattr(_library(find_source(kernel)), f"run_{kernel.name}")
    function.argtypes = [ctypes.c_int, ctypes.c_int, *[View] * len(kernel.reads + kernel.writes)]
    function(columns, rows, *(view(arrays[binding]) for binding in kernel.reads + kernel.writes))


@cache
def _library(family: Path) -> ctypes.CDLL:
    """For each kernel of a family, a function (columns, rows, views ...) that calls it for every pixel.

    Compiled once for all processes: what is compiled lies beside the compiled kernels, by a digest of its source.
    """
    source = SHIM + read_source(family)
    source += "".join(_loop(name, views.count("View")) for name, views in KERNEL.findall(source))
    digest = hashlib.sha256(" ".join((source, COMPILER, *OPTIONS)).encode()).hexdigest()[:32]
    with TemporaryDirectory(dir=private_folder("tests")) as folder:
        library, made = Path(folder).parent / f"{family.stem}-{digest}.so", Path(folder) / "made.so"
        if not library.exists():
            (Path(folder) / "source.cpp").write_text(source)
            subprocess.run([COMPILER, *OPTIONS, Path(folder) / "source.cpp", "-o", made], check=True)
            os.replace(made, library)
        return ctypes.CDLL(str(library))


def _loop(name: str, count: int) -> str:
    views = [f"v{i}" for i in range(count)]
    return (f'extern "C" void run_{name}(int columns, int rows, {", ".join(f"View {view}" for view in views)}) {{\n'
            "    gridDim = {columns, rows, 1};\n"
            "    for (blockIdx.y = 0; blockIdx.y < rows; blockIdx.y++)\n"
            f"        for (blockIdx.x = 0; blockIdx.x < columns; blockIdx.x++) {name}({', '.join(views)});\n}}\n")
