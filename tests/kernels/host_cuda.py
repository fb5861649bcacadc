"""Runs CUDA kernels on the host: their sources compiled as C++, blocks in turn.

Threads of a block take turns at `__syncthreads` and wherever those of a warp have something in
common. What a GPU does with memory is not seen here; the arithmetic is.
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

from postfx.kernels import Kernel, find_source, read_source
from postfx.runtime.cuda import PIXELS
from postfx.system import private_folder

COMPILER = shutil.which("g++")
OPTIONS = ("-O1", "-std=c++17", "-shared", "-fPIC", "-Wno-unknown-pragmas", "-U_FORTIFY_SOURCE")
KERNEL = re.compile(r'extern "C" __global__ void '
                    r'(?:__launch_bounds__\([^)]*\)\s+)?(\w+)\(([^)]*)\)')
SHIM = """
#include <algorithm>
#include <cmath>
#include <csetjmp>
#include <cstdlib>
#include <cstring>
#include <ucontext.h>
#define __global__
#define __device__
#define __shared__ static
#define __launch_bounds__(...)
#define __noinline__
#define __threadfence()
using std::min;
using std::max;
using std::abs;
struct Index { int x, y, z; };
static Index blockIdx, threadIdx, blockDim = {1, 1, 1}, gridDim = {1, 1, 1};

// Threads of a block, each on a stack of its own, that the scheduler resumes one after the other.
// They live on for the
// next block. A jump takes no call of the system, as swapcontext does.
static jmp_buf scheduler, places[1024];
static char stacks[1024][1 << 16];
static bool begun[1024], ended[1024];
static int alive, arrived, turn, at_meeting[32][32], meetings[32][32];
static void (*body)();

static int own_number() { return threadIdx.y * blockDim.x + threadIdx.x; }

static void become(int own) { threadIdx.x = own % blockDim.x, threadIdx.y = own / blockDim.x; }

static void give_way() {
    const int own = own_number();
    if (!_setjmp(places[own])) _longjmp(scheduler, 1);
    become(own);
}

static void begin() {
    for (;;) {
        body();
        ended[own_number()] = true;
        if (--alive && arrived == alive) arrived = 0, turn++;
        give_way();
    }
}

static void __attribute__((noinline)) resume(int thread) {
    if (_setjmp(scheduler)) return;
    become(thread);
    if (begun[thread]) _longjmp(places[thread], 1);
    begun[thread] = true;
    ucontext_t context;
    getcontext(&context);
    context.uc_stack.ss_sp = stacks[thread], context.uc_stack.ss_size = sizeof stacks[thread];
    context.uc_link = nullptr;
    makecontext(&context, begin, 0);
    setcontext(&context);
}

static void __syncthreads() {
    if (blockDim.x == 1) return;
    const int now = turn;
    if (++arrived == alive) arrived = 0, turn++;
    while (turn == now) give_way();
}

static void run_block(int threads) {
    alive = threads, arrived = 0;
    for (int k = 0; k < threads; k++) ended[k] = false;
    while (alive) {
        for (int k = 0; k < threads; k++) {
            if (!ended[k]) resume(k);
        }
    }
    become(0);
}

// What kernels with tensor cores expect: shared memory, and a warp's product, whose factors lose
// their last bits.
static float memory[1 << 16];
static int shared_bytes;
static int shared_floats() { return shared_bytes / 4; }
static float all_left[8][16][8], all_right[8][8][8];
static long products;  // of warps that multiplied

static float shortened(unsigned bits) {
    float value;
    bits &= ~0x1fffu;
    std::memcpy(&value, &bits, 4);
    return value;
}

// Wait for the other lanes of a warp that a mask names.
static void meet(unsigned lanes = ~0u) {
    const int warp = own_number() / 32, group = __builtin_ctz(lanes), now = meetings[warp][group];
    if (++at_meeting[warp][group] == __builtin_popcount(lanes)) {
        at_meeting[warp][group] = 0;
        meetings[warp][group]++;
    }
    while (meetings[warp][group] == now) give_way();
}

static void __syncwarp(unsigned lanes = ~0u) {
    if (blockDim.x > 1) meet(lanes);
}

// Lanes of a warp that come here, of those that have not ended: a GPU may tell of fewer.
static unsigned come[32];

static unsigned __activemask() {
    if (blockDim.x == 1) return 1;
    const int warp = own_number() / 32, last = min(32 * warp + 32, blockDim.x * blockDim.y);
    come[warp] |= 1u << threadIdx.x % 32;
    for (int k = 32 * warp; k < last; k++) {
        while (!ended[k] && !(come[warp] >> k % 32 & 1)) give_way();
    }
    const unsigned found = come[warp];
    meet(found);
    come[warp] = 0;
    meet(found);
    return found;
}

template <class T> static T atomicMin(T* at, T other) {
    const T before = *at;
    *at = min(before, other);
    return before;
}

template <class T> static T atomicAdd(T* at, T more) {
    const T before = *at;
    *at += more;
    return before;
}

extern "C" long count_products() { return products; }

// What another lane holds; its own where that is none of its group of `width`.
static char exchanged[32][32][8];

template <class T> static T exchange(unsigned lanes, T value, int from, int width = 32) {
    const int warp = own_number() / 32, lane = threadIdx.x % 32;
    std::memcpy(exchanged[warp][lane], &value, sizeof value);
    meet(lanes);
    if (from >= 0 && from / width == lane / width)
        std::memcpy(&value, exchanged[warp][from], sizeof value);
    meet(lanes);
    return value;
}

template <class T> static T __shfl_xor_sync(unsigned lanes, T value, int mask) {
    return exchange(lanes, value, threadIdx.x % 32 ^ mask);
}

template <class T> static T __shfl_up_sync(unsigned lanes, T value, int by, int width = 32) {
    return exchange(lanes, value, threadIdx.x % 32 - by, width);
}

template <class T> static T __shfl_down_sync(unsigned lanes, T value, int by, int width = 32) {
    return exchange(lanes, value, threadIdx.x % 32 + by, width);
}

static void add_product(float (&sums)[4], const unsigned (&left)[4], const unsigned (&right)[2]) {
    const int warp = own_number() / 32, lane = threadIdx.x % 32, g = lane / 4, q = lane % 4;
    for (int k = 0; k < 4; k++) all_left[warp][g + k % 2 * 8][q + k / 2 * 4] = shortened(left[k]);
    for (int k = 0; k < 2; k++) all_right[warp][q + k * 4][g] = shortened(right[k]);
    products += lane == 0;
    meet();
    for (int k = 0; k < 4; k++) {
        double total = sums[k];
        const int row = g + k / 2 * 8, column = 2 * q + k % 2;
        for (int i = 0; i < 8; i++)
            total += double(all_left[warp][row][i]) * all_right[warp][i][column];
        sums[k] = float(total);
    }
    meet();
}

// What common.cuh has of single instructions.
static inline float from_half(unsigned short bits) { return __builtin_bit_cast(_Float16, bits); }
static inline unsigned short to_half(float value) {
    return __builtin_bit_cast(unsigned short, _Float16(value));
}
static inline float log2_of(float value) { return log2f(value); }
static inline float exp2_of(float value) { return exp2f(value); }
static inline float over_one(float value) { return 1.0f / value; }
template <class T> static inline const T* behind(const T* at, size_t count) { return at + count; }

template <class T> static inline T __ldg(const T* at) { return *at; }
static inline float __int_as_float(int bits) {
    float value;
    std::memcpy(&value, &bits, 4);
    return value;
}
static inline int __float_as_int(float value) {
    int bits;
    std::memcpy(&bits, &value, 4);
    return bits;
}
static inline unsigned __float_as_uint(float value) { return unsigned(__float_as_int(value)); }
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
    rows, *columns = arrays[name].shape[axis:]
    function = getattr(_library(find_source(kernel)), f"run_{kernel.name}")
    # what is changed in place is one of them
    bindings = dict.fromkeys(kernel.reads + kernel.writes)
    views = [view(arrays[binding]) for binding in bindings]
    blocks = kernel.blocks
    down, across = kernel.pixels
    wide, high = block = PIXELS if columns else (1, 1)
    grid = (-(-columns[0] // (across * wide)), -(-rows // (down * high))) if columns else (1, 1)
    if blocks:
        block, grid = (blocks.threads, 1), blocks.grid(rows, columns[0] if columns else 0)
    if blocks and blocks.between:
        between = np.zeros(blocks.between, np.float32)
        views.append(view(between))
    function.argtypes = [*[ctypes.c_int] * 5, *[View] * len(views)]
    function(*grid, *block, blocks.shared if blocks else 0, *views)


def products(kernel: Kernel) -> int:
    """How many products of matrix units warps have made so far, by kernels of the same source."""
    count = _library(find_source(kernel)).count_products
    count.restype = ctypes.c_long
    return int(count())


@cache
def _library(family: Path) -> ctypes.CDLL:
    """For each kernel of a family, a function (columns and rows of blocks, those of a block's
    threads, bytes of shared memory, views ...) that calls it for every block."""
    source = SHIM + read_source(family)
    source += "".join(_loop(name, views.count("View")) for name, views in KERNEL.findall(source))
    return compile_source(source, family.stem)


def compile_source(source: str, stem: str) -> ctypes.CDLL:
    """The library of a C++ source.

    Compiled once for all processes: what is compiled lies beside the compiled kernels, by a digest
    of its source.
    """
    assert COMPILER is not None, "who needs it is skipped without"
    digest = hashlib.sha256(" ".join((source, COMPILER, *OPTIONS)).encode()).hexdigest()[:32]
    with TemporaryDirectory(dir=private_folder("tests")) as folder:
        library, made = Path(folder).parent / f"{stem}-{digest}.so", Path(folder) / "made.so"
        if not library.exists():
            (Path(folder) / "source.cpp").write_text(source)
            subprocess.run([COMPILER, *OPTIONS, Path(folder) / "source.cpp", "-o", made],
                           check=True)
            os.replace(made, library)
        return ctypes.CDLL(str(library))


def _loop(name: str, count: int) -> str:
    views = [f"v{i}" for i in range(count)]
    given = ", ".join(f"View {view}" for view in views)
    return (f'extern "C" void run_{name}(int columns, int rows, int wide, int high, int shared, '
            f'{given}) {{\n'
            f"    static struct {{ View {', '.join(f'*{view}' for view in views)}; }} held;\n"
            f"    held = {{{', '.join(f'&{view}' for view in views)}}};\n    body = "
            f"[] {{ {name}({', '.join(f'*held.{view}' for view in views)}); }};\n    gridDim = "
            "{columns, rows, 1}, blockDim = {wide, high, 1}, shared_bytes = shared;\n    for "
            "(blockIdx.y = 0; blockIdx.y < rows; blockIdx.y++)\n        for (blockIdx.x = 0; "
            "blockIdx.x < columns; blockIdx.x++)\n            if (wide * high > 1) run_block(wide "
            "* high); else body();\n}\n")
