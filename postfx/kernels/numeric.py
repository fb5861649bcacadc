"""How kernels are compiled, and the small functions that they inline."""

from collections.abc import Callable
from typing import Any, TypeAlias

import numpy as np
from llvmlite import ir
from numba import njit, types
from numba.extending import intrinsic

from postfx.kernels.compile_cache import KernelCache
from postfx.kernels.denoise.layout import MAX_COLOUR

Real: TypeAlias = Any
"""A number or truth value in a kernel: Numba compiles a function for the types that it is called with."""


def kernel_jit(**options: Any) -> Callable[[Callable[..., Any]], Any]:
    """Numba's decorator for kernels: no lock held, compiled code kept between runs."""

    def decorate(function: Callable[..., Any]) -> Any:
        dispatcher = njit(nogil=True, error_model="numpy", **options)(function)
        dispatcher._cache = KernelCache(dispatcher)
        return dispatcher

    return decorate


inline = kernel_jit(inline="always")
fast_inline = kernel_jit(inline="always", fastmath=True)
compiled = kernel_jit()
# a * b + c in one instruction; NaN and infinity keep their meaning.
fused, fused_inline = kernel_jit(fastmath={"contract"}), kernel_jit(fastmath={"contract"}, inline="always")
# Sums in any order, which may be in vector instructions; NaN and infinity keep their meaning.
summed = kernel_jit(fastmath={"contract", "reassoc"})
# Reassociation lets the compiler use vector instructions; never for code that must see NaN or infinity.
vectorised = kernel_jit(fastmath=True)


@inline
def clamp(value: Real, low: Real, high: Real) -> Real:
    """``value`` within [low, high], which holds 0 or lies above it; a NaN becomes the value nearest to 0."""
    known = value if value == value else np.float32(0)
    return min(max(np.float32(low), known), np.float32(high))


@inline
def centre(position: int, size: int, out_size: int) -> tuple[int, Real]:
    """The render pixel that holds an output pixel's centre, and the centre's offset from it in [-0.5, 0.5)."""
    at = (2 * position + 1) * size  # in units of 1 / (2 out_size): exact
    index = at // (2 * out_size)
    return index, np.float32((at - index * (2 * out_size)) / (2 * out_size) - 0.5)


@fast_inline
def log(x: Real) -> Real:
    """log(x) of a normal x > 0, absolute error below 3e-7; mantissa polynomial of Cephes ``logf`` (Moshier)."""
    bits = np.float32(x).view(np.int32)
    exponent = (bits - np.int32(0x3F3504F3)) >> np.int32(23)
    m = np.int32(bits - (exponent << np.int32(23))).view(np.float32) - np.float32(1)
    p = np.float32(7.0376836292e-2)
    p = p * m + np.float32(-1.1514610310e-1)
    p = p * m + np.float32(1.1676998740e-1)
    p = p * m + np.float32(-1.2420140846e-1)
    p = p * m + np.float32(1.4249322787e-1)
    p = p * m + np.float32(-1.6668057665e-1)
    p = p * m + np.float32(2.0000714765e-1)
    p = p * m + np.float32(-2.4999993993e-1)
    p = p * m + np.float32(3.3333331174e-1)
    return p * m * m * m - np.float32(0.5) * m * m + m + np.float32(exponent) * np.float32(0.6931471805599453)


@fast_inline
def log1p(x: Real) -> Real:
    """log(1 + x) for x >= 0, relative error below 3e-6; branch-free, so that loops of it become vector code.

    A series below 0.03, where 1 + x would round.
    """
    fifth, quarter, third = np.float32(0.2), np.float32(0.25), np.float32(1 / 3)
    small = x * (np.float32(1) - x * (np.float32(0.5) - x * (third - x * (quarter - x * fifth))))
    return small if x < np.float32(0.03) else log(np.float32(1) + x)


@fast_inline
def exp_parts(x: Real) -> tuple[Real, Real]:
    """m and 2^n with exp(x) = (1 + m) 2^n, for -80 <= x <= 80; polynomial of Cephes ``expf`` (Moshier)."""
    whole = np.floor(x * np.float32(1.4426950408889634) + np.float32(0.5))
    r = (x - whole * np.float32(0.693359375)) + whole * np.float32(2.12194440e-4)
    p = np.float32(1.9875691500e-4)
    p = p * r + np.float32(1.3981999507e-3)
    p = p * r + np.float32(8.3334519073e-3)
    p = p * r + np.float32(4.1665795894e-2)
    p = p * r + np.float32(1.6666665459e-1)
    p = p * r + np.float32(5.0000001201e-1)
    return p * r * r + r, np.int32((np.int32(whole) + np.int32(127)) << np.int32(23)).view(np.float32)


@fast_inline
def exp(x: Real) -> Real:
    """exp(x) for -80 <= x <= 80, relative error below 2e-7."""
    more, power = exp_parts(x)
    return (more + np.float32(1)) * power


@fast_inline
def expm1(x: Real) -> Real:
    """exp(x) - 1 for 0 <= x < 80, relative error below 2e-7."""
    more, power = exp_parts(x)
    return more * power + (power - np.float32(1))


@inline
def log_encode(exposed: Real) -> Real:
    """log(1 + x) of an exposed colour in [0, 1e4]."""
    return log1p(min(max(np.float32(0), exposed), np.float32(MAX_COLOUR)))


@inline
def demodulation(diffuse_albedo: np.ndarray, specular_albedo: np.ndarray, y: int, x: int) -> tuple[Real, Real, Real]:
    """Reflectance that colour is divided by at a pixel: see ``training.ops.demodulation``."""
    r = clamp(diffuse_albedo[y, x, 0] + specular_albedo[y, x, 0], np.float32(0), np.float32(4))
    g = clamp(diffuse_albedo[y, x, 1] + specular_albedo[y, x, 1], np.float32(0), np.float32(4))
    b = clamp(diffuse_albedo[y, x, 2] + specular_albedo[y, x, 2], np.float32(0), np.float32(4))
    peak = max(r, g, b)
    if peak < np.float32(0.005):
        return np.float32(1), np.float32(1), np.float32(1)
    floor = np.float32(0.15) * peak
    bias = np.float32(0.01)
    return max(r, floor) + bias, max(g, floor) + bias, max(b, floor) + bias


@vectorised
def add(row: np.ndarray, total: np.ndarray) -> None:
    """total += row, over the length of ``total``. Loops over this few arrays become vector code."""
    for x in range(total.size):
        total[x] += row[x]


@vectorised
def add_product(weights: np.ndarray, row: np.ndarray, total: np.ndarray) -> None:
    """total += weights * row, over the length of ``total``."""
    for x in range(total.size):
        total[x] += weights[x] * row[x]


@vectorised
def divide(row: np.ndarray, total: np.ndarray) -> None:
    """row /= total, over the length of ``total``."""
    for x in range(total.size):
        row[x] /= total[x]


# Four numbers in one instruction, which Numba's compiler does not find by itself where code jumps from pixel to pixel.

Four: TypeAlias = Any
"""A tuple of four numbers."""
FOUR = types.UniTuple(types.float32, 4)  # type: ignore[no-untyped-call]
VECTOR = ir.VectorType(ir.FloatType(), 4)


@inline
def load_four(flat: np.ndarray, at: int) -> Four:
    """Four numbers of a flat array, from a place on."""
    return _load_four(flat, at)  # type: ignore[call-arg]  # Numba gives the first argument


@inline
def store_four(flat: np.ndarray, at: int, four: Four) -> None:
    """Put four numbers into a flat array, from a place on."""
    _store_four(flat, at, four)  # type: ignore[call-arg]


@inline
def add_four(total: Four, four: Four, weight: Real) -> Four:
    """total + four * weight."""
    return _add_four(total, four, weight)  # type: ignore[call-arg]


@intrinsic
def _load_four(typingctx: Any, flat: Any, at: Any) -> Any:
    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        vector = builder.load(_place_of_four(context, builder, signature, arguments), align=4)
        return _as_tuple(builder, vector)

    return FOUR(flat, at), generate


@intrinsic
def _store_four(typingctx: Any, flat: Any, at: Any, four: Any) -> Any:
    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        place = _place_of_four(context, builder, signature, arguments)
        builder.store(_as_vector(builder, [builder.extract_value(arguments[2], i) for i in range(4)]), place, align=4)
        return context.get_dummy_value()

    return types.void(flat, at, four), generate


@intrinsic
def _add_four(typingctx: Any, total: Any, four: Any, weight: Any) -> Any:
    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        function = builder.module.declare_intrinsic("llvm.fmuladd.v4f32", (), ir.FunctionType(VECTOR, [VECTOR] * 3))
        sums, values = (_as_vector(builder, [builder.extract_value(four, i) for i in range(4)])
                        for four in arguments[:2])
        weights = _as_vector(builder, [arguments[2]] * 4)
        return _as_tuple(builder, builder.call(function, [values, weights, sums]))

    return FOUR(total, four, types.float32), generate


def _place_of_four(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
    flat = context.make_array(signature.args[0])(context, builder, arguments[0])
    return builder.bitcast(builder.gep(flat.data, [arguments[1]]), VECTOR.as_pointer())


def _as_vector(builder: Any, numbers: Any) -> Any:
    vector = ir.Constant(VECTOR, ir.Undefined)
    for i, number in enumerate(numbers):
        vector = builder.insert_element(vector, number, ir.Constant(ir.IntType(32), i))
    return vector


def _as_tuple(builder: Any, vector: Any) -> Any:
    four = ir.Constant(ir.ArrayType(ir.FloatType(), 4), ir.Undefined)
    for i in range(4):
        four = builder.insert_value(four, builder.extract_element(vector, ir.Constant(ir.IntType(32), i)), i)
    return four
