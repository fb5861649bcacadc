"""Runs the convolutions of a network on the host: their CUDA source compiled as C++, see `host_cuda`."""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Sequence
from functools import cache

from postfx.runtime import Tensor
from postfx.runtime.convolutions import ARGUMENTS, THREADS, Launch, Options
from postfx.runtime.cuda import convolution_source
from tests.kernels.host_cuda import SHIM, View, compile_source

# A warp's matrices and products in half precision, as `add_product` of the shim has them in single precision.
HALVES = r"""
static void copy_eight(char* to, const char* from, bool there) {
    if (there) std::memcpy(to, from, 16);
    else std::memset(to, 0, 16);
}
static void end_batch() {}
template <int MOST> static void wait_for_batches() {}
static const char* rows_at[8][32];
static void load_matrices(unsigned (&to)[4], const char* row) {
    const int warp = threadIdx.x / 32, lane = threadIdx.x % 32;
    rows_at[warp][lane] = row;
    meet();
    for (int k = 0; k < 4; k++) std::memcpy(&to[k], rows_at[warp][8 * k + lane / 4] + 4 * (lane % 4), 4);
    meet();
}
static float number(unsigned both, int k) {
    return float(__builtin_bit_cast(_Float16, (unsigned short)(both >> 16 * k)));
}
static unsigned rounded(float first, float second) {
    return __builtin_bit_cast(unsigned short, _Float16(first))
        | unsigned(__builtin_bit_cast(unsigned short, _Float16(second))) << 16;
}
static unsigned sum(unsigned a, unsigned b) {
    return rounded(number(a, 0) + number(b, 0), number(a, 1) + number(b, 1));
}
static unsigned larger(unsigned a, unsigned b) {
    return rounded(std::max(number(a, 0), number(b, 0)), std::max(number(a, 1), number(b, 1)));
}
static float half_left[8][16][16], half_right[8][16][8];
static void add_product(float (&sums)[4], const unsigned (&left)[4], unsigned upper, unsigned lower) {
    const int warp = threadIdx.x / 32, lane = threadIdx.x % 32, g = lane / 4, q = lane % 4;
    for (int i = 0; i < 2; i++) {
        for (int k = 0; k < 4; k++) half_left[warp][g + k % 2 * 8][2 * q + i + k / 2 * 8] = number(left[k], i);
        half_right[warp][2 * q + i][g] = number(upper, i), half_right[warp][2 * q + i + 8][g] = number(lower, i);
    }
    meet();
    for (int k = 0; k < 4; k++) {
        double total = sums[k];
        for (int i = 0; i < 16; i++)
            total += double(half_left[warp][g + k / 2 * 8][i]) * half_right[warp][i][2 * q + k % 2];
        sums[k] = float(total);
    }
    meet();
}
alignas(128) static char all_shared[1 << 18];
#define SHARED_MEMORY char* const shared = all_shared
"""


class HostGpu:
    """As `CudaMemory`, for tensors in the host's memory."""

    most_shared = 227 << 10

    def convolution(self, launch: Launch, kernels: str, tensors: Sequence[Tensor | None],
                    options: Options) -> Callable[[], None]:
        views = [View() if tensor is None else View(tensor.start, (ctypes.c_int * 4)(*tensor.shape[:4]))
                 for tensor in tensors]
        function, given = getattr(_library(kernels), f"run_{launch.name}"), (View * len(views))(*views)
        return lambda: function(launch.blocks, given, ctypes.byref(options))


@cache
def _library(kernels: str) -> ctypes.CDLL:
    source = SHIM + HALVES + convolution_source() + kernels
    views = ", ".join(f"given[{i}]" for i in range(len(ARGUMENTS)))
    names = [line.split("(")[-2].split()[-1] for line in kernels.splitlines() if line.startswith("extern")]
    for name in names:
        source += (f'extern "C" void run_{name}(int blocks, View* views, Options* told) {{\n'
                   f"    static View* given;\n    static Options* options;\n    given = views, options = told;\n"
                   f"    blockDim.x = {THREADS}, body = [] {{ {name}({views}, *options); }};\n"
                   f"    for (blockIdx.x = 0; blockIdx.x < blocks; blockIdx.x++) run_block({THREADS});\n}}\n")
    return compile_source(source, "convolutions")
