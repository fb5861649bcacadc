"""How kernels are compiled, and the small functions that they inline."""

from collections.abc import Callable
from typing import Any, TypeAlias

import numpy as np

from postfx.kernels.native import KernelFunction, functions, intrinsic, ir, types

BRIGHTEST = np.float32(1e10)
"""Light beyond counts as this much where colours are looked up, so that infinity times zero is no NaN."""

Real: TypeAlias = Any
"""A number or truth value in a kernel: Numba compiles a function for the types that it is called with."""


def kernel_jit(**options: Any) -> Callable[[Callable[..., Any]], Any]:
    """Decorator for kernels, with Numba's options: they come compiled, or Numba compiles them when they are called."""

    def decorate(function: Callable[..., Any]) -> Any:
        def compile_it() -> Any:
            from postfx.kernels.compile_cache import make_dispatcher

            return make_dispatcher(function, options)

        shipped = functions()
        name = f"{function.__module__}.{function.__qualname__}"
        return KernelFunction(function, compile_it, shipped.get(name, {})) if shipped else compile_it()

    return decorate


inline = kernel_jit(inline="always")
fast_inline = kernel_jit(inline="always", fastmath=True)
compiled = kernel_jit()
# Without counts of who uses an array: threads that change the same counts wait for each other. Makes no arrays.
uncounted = kernel_jit(_nrt=False)
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


@vectorised
def add(row: np.ndarray, total: np.ndarray) -> None:
    """total += row, over the length of ``total``. Loops over this few arrays become vector code."""
    for x in range(total.size):
        total[x] += row[x]


# Four or eight numbers in one instruction, which Numba's compiler does not find by itself where code jumps from pixel
# to pixel, or where loops are over many arrays.

Four: TypeAlias = Any
"""A tuple of four numbers."""
Eight: TypeAlias = Any
"""A tuple of eight numbers."""


@inline
def load_eight(flat: np.ndarray, at: int) -> Eight:
    """Eight numbers of a flat array, from a place on."""
    return _load_eight(flat, at)


@inline
def store_eight(flat: np.ndarray, at: int, eight: Eight) -> None:
    """Put eight numbers into a flat array, from a place on."""
    _store_eight(flat, at, eight)


@inline
def add_eight(total: Eight, eight: Eight, weight: Real) -> Eight:
    """total + eight * weight."""
    return _add_eight(total, eight, weight)


@inline
def mix_eight(some: Eight, others: Eight, share: Real) -> Eight:
    """some + (others - some) * share."""
    return _mix_eight(some, others, share)


@inline
def divide_eight(some: Eight, others: Eight) -> Eight:
    """some / others, number by number."""
    return _divide_eight(some, others)


def _loader(count: int) -> Any:
    @intrinsic
    def load(typingctx: Any, flat: Any, at: Any) -> Any:
        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            vector = builder.load(_place_of(count, context, builder, signature, arguments), align=4)
            return _as_tuple(builder, vector)

        return _tuple_of(count)(flat, at), generate

    return load


def _storer(count: int) -> Any:
    @intrinsic
    def store(typingctx: Any, flat: Any, at: Any, some: Any) -> Any:
        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            place = _place_of(count, context, builder, signature, arguments)
            builder.store(_as_vector(count, builder, arguments[2]), place, align=4)
            return context.get_dummy_value()

        return types.void(flat, at, some), generate

    return store


def _multiply_add(count: int, builder: Any, some: Any, factors: Any, sums: Any) -> Any:
    """some * factors + sums, vectors of float32."""
    kind, name = _vector_of(count), f"llvm.fmuladd.v{count}f32"
    function = builder.module.declare_intrinsic(name, (), ir.FunctionType(kind, [kind] * 3))
    return builder.call(function, [some, factors, sums])


def _adder(count: int, many_weights: bool) -> Any:
    @intrinsic
    def add(typingctx: Any, total: Any, some: Any, weight: Any) -> Any:
        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            sums, values = (_as_vector(count, builder, some) for some in arguments[:2])
            weights = (_as_vector(count, builder, arguments[2]) if many_weights else
                       _pack(builder, [arguments[2]] * count))
            return _as_tuple(builder, _multiply_add(count, builder, values, weights, sums))

        own = _tuple_of(count)
        return own(total, some, own if many_weights else types.float32), generate

    return add


def _mixer(count: int) -> Any:
    @intrinsic
    def mix(typingctx: Any, some: Any, others: Any, share: Any) -> Any:
        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            first, second = (_as_vector(count, builder, some) for some in arguments[:2])
            shares = _pack(builder, [arguments[2]] * count)
            return _as_tuple(builder, _multiply_add(count, builder, builder.fsub(second, first), shares, first))

        return _tuple_of(count)(some, others, types.float32), generate

    return mix


@intrinsic
def _divide_eight(typingctx: Any, some: Any, others: Any) -> Any:
    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return _as_tuple(builder, builder.fdiv(*(_as_vector(8, builder, vector) for vector in arguments)))

    return _tuple_of(8)(some, others), generate


def _tuple_of(count: int) -> Any:
    return types.UniTuple(types.float32, count)


def _vector_of(count: int) -> Any:
    return ir.VectorType(ir.FloatType(), count)


def _place_of(count: int, context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
    flat = context.make_array(signature.args[0])(context, builder, arguments[0])
    return builder.bitcast(builder.gep(flat.data, [arguments[1]]), _vector_of(count).as_pointer())


def _as_vector(count: int, builder: Any, some: Any) -> Any:
    return _pack(builder, [builder.extract_value(some, i) for i in range(count)])


def _pack(builder: Any, numbers: Any) -> Any:
    vector = ir.Constant(_vector_of(len(numbers)), ir.Undefined)
    for i, number in enumerate(numbers):
        vector = builder.insert_element(vector, number, ir.Constant(ir.IntType(32), i))
    return vector


def _as_tuple(builder: Any, vector: Any) -> Any:
    count = vector.type.count
    found = ir.Constant(ir.ArrayType(ir.FloatType(), count), ir.Undefined)
    for i in range(count):
        found = builder.insert_value(found, builder.extract_element(vector, ir.Constant(ir.IntType(32), i)), i)
    return found


_load_eight, _store_eight, _add_eight, _mix_eight = _loader(8), _storer(8), _adder(8, False), _mixer(8)
