"""Runs the convolutions of a network on the host: their CUDA source compiled as C++, see
`host_cuda`."""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Sequence
from functools import cache

from postfx.kernels import convolution_source
from postfx.runtime import Tensor
from postfx.runtime.convolutions import ARGUMENTS, GROUP_THREADS, Launch, Options
from tests.kernels.host_cuda import SHIM, View, compile_source

# A warp's matrices and products in half precision, as `add_product` of the shim has them in single
# precision.
HALVES = r"""
static void copy_eight(char* to, const char* from, bool there) {
    if (there) std::memcpy(to, from, 16);
    else std::memset(to, 0, 16);
}
static void wait_for_copies() {}
static int at_group[4], group_meetings[4];
static void meet_group(int group) {
    const int now = group_meetings[group];
    if (++at_group[group] == 128) at_group[group] = 0, group_meetings[group]++;
    while (group_meetings[group] == now) give_way();
}
static int at_turn[4];
static void give_turn(int group) { at_turn[group + 1]++; }
static void take_turn(int group) {
    const int all = at_turn[group]++ / 256 * 256 + 256;
    while (at_turn[group] < all) give_way();
}
struct alignas(16) Slot { unsigned long long filled; int through; };
static void empty(Slot& slot) { slot = {0, 0}; }
static void fill_slot(Slot& slot, char* to, const char* from, int bytes) {
    std::memcpy(to, from, bytes);
    slot.filled++;
}
static void wait_for_slot(Slot& slot, int times) {
    while (slot.filled <= times) give_way();
}
static bool leave_slot(Slot& slot, int warps) { return ++slot.through % warps == 0; }
static unsigned from_lane(unsigned value, int mask) { return __shfl_xor_sync(~0u, value, mask); }
static const char* rows_at[16][32];
static void load_matrices(unsigned (&to)[4], const char* row) {
    const int warp = threadIdx.x / 32, lane = threadIdx.x % 32;
    rows_at[warp][lane] = row;
    meet();
    for (int k = 0; k < 4; k++)
        std::memcpy(&to[k], rows_at[warp][8 * k + lane / 4] + 4 * (lane % 4), 4);
    meet();
}
static float number(unsigned both, int k) {
    return float(__builtin_bit_cast(_Float16, (unsigned short)(both >> 16 * k)));
}
static float saturated(float x) { return std::min(std::max(x, 0.0f), 1.0f); }
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
static float half_left[16][16][16], half_right[16][16][8];
static void add_product(float* sums, const unsigned (&left)[4], unsigned upper, unsigned lower) {
    const int warp = threadIdx.x / 32, lane = threadIdx.x % 32, g = lane / 4, q = lane % 4;
    for (int i = 0; i < 2; i++) {
        for (int k = 0; k < 4; k++)
            half_left[warp][g + k % 2 * 8][2 * q + i + k / 2 * 8] = number(left[k], i);
        half_right[warp][2 * q + i][g] = number(upper, i);
        half_right[warp][2 * q + i + 8][g] = number(lower, i);
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


# Products of warpgroups: each thread finds its own numbers where the factors lie.
TOGETHER = r"""
struct Matrices {
    const char* at;
    int along, across;
};
static Matrices matrices(const char* at, int along, int across) { return {at, along, across}; }
static float factor(const Matrices& m, int row, int k) {
    const char* const at = m.at + k / 8 * m.along + row / 8 * m.across + row % 8 * 16 + k % 8 * 2;
    return float(*reinterpret_cast<const _Float16*>(at));
}
static float own_left[16][16][16];
template <int COUNT>
static void multiply(float (&sums)[COUNT], const unsigned (&left)[4], Matrices right) {
    const int warp = threadIdx.x / 32, lane = threadIdx.x % 32, g = lane / 4, q = lane % 4;
    for (int k = 0; k < 4; k++)
        for (int i = 0; i < 2; i++)
            own_left[warp][g + k % 2 * 8][2 * q + i + k / 2 * 8] = number(left[k], i);
    meet();
    for (int i = 0; i < COUNT; i++) {
        double total = sums[i];
        for (int k = 0; k < 16; k++)
            total += double(own_left[warp][g + i / 2 % 2 * 8][k])
                * factor(right, i / 4 * 8 + 2 * q + i % 2, k);
        sums[i] = float(total);
    }
    meet();
}
static void begin_products() {}
template <int STEPS> static void end_products_before(unsigned (&)[STEPS][4]) {}
template <int COUNT, int STEPS>
static void end_products(float (&)[COUNT], unsigned (&)[STEPS][4]) {}
static void show_to_products() {}
"""


class HostGpu:
    """As `CudaMemory`, for tensors in the host's memory: a GPU whose few processors hold one block
    of threads each."""

    convolves = True

    def __init__(self, warpgroups: bool, processors: int = 132,
                 most_shared: int = 227 << 10) -> None:
        self.warpgroups, self.processors, self.most_shared = warpgroups, processors, most_shared

    def convolution(self, launch: Launch, kernels: str, tensors: Sequence[Tensor | None],
                    options: Options) -> Callable[[], None]:
        views = [View()
                 if tensor is None else View(tensor.start, (ctypes.c_int * 4)(*tensor.shape[:4]))
                 for tensor in tensors]
        function = getattr(_library(kernels, self.warpgroups), f"run_{launch.name}")
        given = (View * len(views))(*views)
        blocks = min(-(-launch.squares // launch.groups),
                     -(-self.processors // launch.tiles)) * launch.tiles
        return lambda: function(blocks, launch.groups * GROUP_THREADS, given, ctypes.byref(options))


@cache
def _library(kernels: str, warpgroups: bool) -> ctypes.CDLL:
    kernels = kernels[kernels.index('\nextern "C"'):]  # without products in the GPU's language
    source = SHIM + HALVES + TOGETHER * warpgroups + convolution_source(warpgroups) + kernels
    views = ", ".join(f"given[{i}]" for i in range(len(ARGUMENTS)))
    names = [line.split("(")[-2].split()[-1]
             for line in kernels.splitlines() if line.startswith("extern")]
    for name in names:
        source += (f'extern "C" void run_{name}(int blocks, int threads, View* views, Options* '
                   'told) {\n' "    static View* given;\n    static Options* options;\n"
                   "    given = views, options = told;\n    blockDim.x = threads, gridDim.x = "
                   f"blocks, body = [] {{ {name}({views}, *options); }};\n    for (blockIdx.x = 0; "
                   "blockIdx.x < blocks; blockIdx.x++) run_block(threads);\n}\n")
    return compile_source(source, "convolutions")
