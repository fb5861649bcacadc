"""How kernels are compiled, and the small functions that they inline."""

from collections.abc import Callable
from typing import Any, TypeAlias

import numpy as np
from numba import njit

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
