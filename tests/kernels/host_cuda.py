"""Runs CUDA kernels on the host: their sources compiled as C++, one thread a block, blocks in turn.

What a GPU does with them (memory, synchronisation between threads) is not seen here; the arithmetic is.
"""

from __future__ import annotations

import ctypes
import shutil
import subprocess
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from postfx.kernels.cuda_source import family_of, read_source
from postfx.kernels.kernel import Kernel

COMPILER = shutil.which("g++")
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
    _compiled(kernel.name, len(kernel.reads + kernel.writes))(
        columns, rows, *(view(arrays[binding]) for binding in kernel.reads + kernel.writes))


@cache
def _compiled(name: str, count: int) -> ctypes._CFuncPtr:
    """A function (columns, rows, views ...) that calls the kernel for every pixel."""
    views = [f"v{i}" for i in range(count)]
    loop = (f'extern "C" void run(int columns, int rows, {", ".join(f"View {view}" for view in views)}) {{\n'
            "    gridDim = {columns, rows, 1};\n"
            "    for (blockIdx.y = 0; blockIdx.y < rows; blockIdx.y++)\n"
            f"        for (blockIdx.x = 0; blockIdx.x < columns; blockIdx.x++) {name}({', '.join(views)});\n}}\n")
    with TemporaryDirectory() as folder:
        source, library = Path(folder) / f"{name}.cpp", Path(folder) / f"{name}.so"
        source.write_text(SHIM + read_source(family_of(name)) + loop)
        options = ("-O1", "-std=c++17", "-shared", "-fPIC", "-Wno-unknown-pragmas")
        subprocess.run([COMPILER, *options, source, "-o", library], check=True)
        function = ctypes.CDLL(str(library)).run
    function.argtypes = [ctypes.c_int, ctypes.c_int, *[View] * count]
    return function
