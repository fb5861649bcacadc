"""Vector instructions for kernels whose loops Numba's compiler does not turn into them: functions of vectors, for loops
that jump from place to place, and products of small matrices.

    @in_lanes(8)
    def sum_of_differences(v, one, other, at):      # two flat float32 arrays, an index
        return (v.load(one, at) - v.load(other, at)).magnitude().total()

is a function that kernels call. Its body runs once, when the kernel is compiled, and writes LLVM's instructions. Its
arguments are arrays, integers and float32 numbers, as the call has them; it returns a number or a tuple of them. No
bounds are checked.

`combine` and `correlate` keep a block of sums in registers while they read along the factors of a product. Their arrays
are flat and float32; places and steps count their elements. Sums have one fixed order, so equal inputs give equal bits.
`multiply_codes` does the same with numbers of 8 bits, whose sums are exact.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Sequence
from functools import reduce
from typing import Any

import numpy as np

from postfx.kernels.native import adds_byte_products, cgutils, intrinsic, ir, types, wide_vectors
from postfx.kernels.numeric import compiled

_FLAGS = ("contract",)


class Vector:
    """Numbers that instructions treat together. Operators take vectors and single numbers."""

    def __init__(self, builder: Any, value: Any) -> None:
        self.builder, self.value = builder, value

    def __add__(self, other: Any) -> Vector:
        return Vector(self.builder, self.builder.fadd(self.value, self._same(other), flags=_FLAGS))

    def __sub__(self, other: Any) -> Vector:
        return Vector(self.builder, self.builder.fsub(self.value, self._same(other), flags=_FLAGS))

    def __mul__(self, other: Any) -> Vector:
        return Vector(self.builder, self.builder.fmul(self.value, self._same(other), flags=_FLAGS))

    def to(self, other: Vector, share: Any) -> Vector:
        """This vector where the share is 0, the other one where it is 1."""
        found: Vector = self + (other - self) * share
        return found

    def magnitude(self) -> Vector:
        """Without signs."""
        name, kind = f"llvm.fabs.v{self.value.type.count}f32", self.value.type
        function = self.builder.module.declare_intrinsic(name, (), ir.FunctionType(kind, [kind]))
        return Vector(self.builder, self.builder.call(function, [self.value]))

    def least(self, other: Vector) -> Vector:
        """The smaller of both, number by number."""
        smaller = self.builder.fcmp_ordered("<", self.value, other.value)
        return Vector(self.builder, self.builder.select(smaller, self.value, other.value))

    def largest(self, other: Vector) -> Vector:
        """The larger of both, number by number."""
        larger = self.builder.fcmp_ordered(">", self.value, other.value)
        return Vector(self.builder, self.builder.select(larger, self.value, other.value))

    def pick(self, places: Sequence[int]) -> Vector:
        """Numbers at places of it."""
        order = ir.Constant(_whole(len(places)), list(places))
        return Vector(self.builder, self.builder.shuffle_vector(self.value, self.value, order))

    def part(self, first: int, count: int) -> Vector:
        """Some of the numbers, from one on."""
        return self.pick(range(first, first + count))

    def number(self, at: int) -> Any:
        """One number of it, as a result."""
        return self.builder.extract_element(self.value, ir.Constant(ir.IntType(32), at))

    def total(self) -> Any:
        """The sum, as a result; the count of numbers is a power of two."""
        found, count = self, self.value.type.count
        while count > 1:
            count //= 2
            found = found.part(0, count) + found.part(count, count)
        return found.number(0)

    def _same(self, other: Any) -> Any:
        if isinstance(other, Vector):
            return other.value
        count = self.value.type.count
        if isinstance(other, float | Sequence):
            numbers = [other] * count if isinstance(other, float) else other
            return ir.Constant(self.value.type, [ir.Constant(ir.FloatType(), float(number)) for number in numbers])
        return _repeat(self.builder, other, count)


class Lanes:
    """What the body of a function of vectors is written with; its arguments are LLVM's values."""

    def __init__(self, count: int, context: Any, builder: Any, arrays: dict[int, Any]) -> None:
        self.count, self.context, self.builder, self.arrays = count, context, builder, arrays

    def load(self, array: Any, at: Any) -> Vector:
        """Numbers of an array from an index on."""
        data = _data(self.context, self.builder, self.arrays[id(array)], array)
        return Vector(self.builder, _load(self.builder, data, at, ir.VectorType(ir.FloatType(), self.count)))

    def store(self, array: Any, at: Any, vector: Vector) -> None:
        """Put a vector's numbers into an array, from an index on."""
        _store(self.builder, vector.value, _data(self.context, self.builder, self.arrays[id(array)], array), at)

    def repeat(self, array: Any, at: int) -> Vector:
        """A number of an array, as often as there are lanes."""
        return Vector(self.builder, _repeat(self.builder, self.numbers(array, _index(at), 1)[0], self.count))

    def numbers(self, array: Any, at: Any, count: int) -> list[Any]:
        """Numbers of an array from an index on, one by one."""
        data = _data(self.context, self.builder, self.arrays[id(array)], array)
        return [self.builder.load(self.builder.gep(data, [self.step(at, k)])) for k in range(count)]

    def join(self, *numbers: Any) -> Vector:
        """A vector of numbers."""
        found = ir.Constant(ir.VectorType(ir.FloatType(), len(numbers)), ir.Undefined)
        for place, number in enumerate(numbers):
            found = self.builder.insert_element(found, number, ir.Constant(ir.IntType(32), place))
        return Vector(self.builder, found)

    def corners(self, start: Vector, way: Vector, last: Vector) -> tuple[Vector, Vector]:
        """What is whole (int32) of start + way, held between 0 and the last, and the rest: by double precision."""
        builder, kind = self.builder, ir.VectorType(ir.DoubleType(), way.value.type.count)
        one, other, most = (Vector(builder, builder.fpext(vector.value, kind)) for vector in (start, way, last))
        place = (one + other).largest(Vector(builder, ir.Constant(kind, [0.0] * kind.count))).least(most)
        whole = builder.fptosi(place.value, _whole(kind.count))
        rest = place - Vector(builder, builder.sitofp(whole, kind))
        return Vector(builder, whole), Vector(builder, builder.fptrunc(rest.value, way.value.type))

    def constant(self, numbers: Sequence[float]) -> Vector:
        """Numbers that are known, as many as there are."""
        constants = [ir.Constant(ir.FloatType(), float(number)) for number in numbers]
        return Vector(self.builder, ir.Constant(ir.VectorType(ir.FloatType(), len(constants)), constants))

    def step(self, at: Any, stride: Any, times: int = 1) -> Any:
        """An index, moved on by a multiple of a stride, which may be an int."""
        by = _index(stride * times) if isinstance(stride, int) else \
            self.builder.mul(stride, _index(times))
        return self.builder.add(at, by)

    def between(self, array: Any, at: Any, across: Any) -> Vector:
        """Numbers of an array from between two indices on."""
        return self.load(array, at).to(self.load(array, self.step(at, 1)), across)

    def rows(self, array: Any, at: Any, stride: Any, across: Any, down: Any, count: int) -> list[Vector]:
        """Rows of a picture from a place between four pixels on."""
        lines = [self.between(array, self.step(at, stride, row), across) for row in range(count + 1)]
        return [upper.to(lower, down) for upper, lower in zip(lines, lines[1:], strict=False)]

    def sum(self, vectors: Sequence[Vector]) -> Vector:
        """Sum of vectors, number by number."""
        return reduce(Vector.__add__, vectors)


def in_lanes(count: int, results: int = 1) -> Callable[[Callable[..., Any]], Any]:
    """Decorator of a function of vectors of this many numbers, which gives one result, a tuple of several, or none (0)
    and stores what it computes."""
    made_with = tuple(one for kind in (Vector, Lanes) for one in vars(kind).values() if callable(one))

    def decorate(function: Callable[..., Any]) -> Any:
        def call(typingctx: Any, *arguments: Any) -> Any:
            assert made_with, "is part of what compiled code is cached by"
            kinds = [kind if isinstance(kind, types.Array) else types.int64 if isinstance(kind, types.Integer)
                     else types.float32 for kind in arguments]
            number = types.float32
            result = types.none if not results else number if results == 1 else types.UniTuple(number, results)

            def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
                arrays = {id(value): kind for value, kind in zip(values, signature.args, strict=True)}
                found = function(Lanes(count, context, builder, arrays), *values)
                if not results:
                    return context.get_dummy_value()
                return context.make_tuple(builder, result, found) if isinstance(found, tuple) else found

            return result(*kinds), generate

        call.__signature__ = inspect.signature(function)  # type: ignore[attr-defined]  # Numba takes no *arguments
        return intrinsic(call)

    return decorate


def _vector() -> Any:
    return ir.VectorType(ir.FloatType(), LANES)


def _data(context: Any, builder: Any, kind: Any, array: Any) -> Any:
    return context.make_array(kind)(context, builder, array).data


def _load(builder: Any, data: Any, at: Any, kind: Any = None) -> Any:
    return builder.load(builder.bitcast(builder.gep(data, [at]), (kind or _vector()).as_pointer()), align=4)


def _store(builder: Any, vector: Any, data: Any, at: Any) -> None:
    builder.store(vector, builder.bitcast(builder.gep(data, [at]), vector.type.as_pointer()), align=4)


def _repeat(builder: Any, number: Any, count: int) -> Any:
    """A vector of one number."""
    undefined = ir.Constant(ir.VectorType(ir.FloatType(), count), ir.Undefined)
    places = ir.VectorType(ir.IntType(32), count)
    first = builder.insert_element(undefined, number, ir.Constant(ir.IntType(32), 0))
    return builder.shuffle_vector(first, undefined, ir.Constant(places, [0] * count))


def _index(value: int) -> Any:
    return ir.Constant(ir.IntType(64), value)


# Products of small matrices.

LANES = 16 if wide_vectors() else 8
"""Numbers of a vector instruction."""
STRIP = 2 * LANES
"""Columns of all matrices but the weights: rows of two vectors lie one after the other."""
ROWS = LANES // 2
"""Rows of a block of `combine`: with two vectors a row they fill half of the registers."""
DOWN, ACROSS = 4, LANES // 4
"""Rows and columns of a block of `correlate`: as many sums as a vector has numbers."""


@compiled
def combine(
    weights: np.ndarray, first: int, row_step: int, step: int, source: np.ndarray, source_at: int, count: int,
    target: np.ndarray, target_at: int, rows: int,
) -> None:
    """target[j, p] += sum over i < count of weights[first + j row_step + i step] * source[i, p], for all j < rows.

    Args:
        source, target: rows of `STRIP` numbers from `source_at` and `target_at` on.
    """
    j = 0
    while j + ROWS <= rows:
        _block(weights, first + j * row_step, row_step, step, source, source_at, count, target,
               target_at + j * STRIP)
        j += ROWS
    while j < rows:
        _row(weights, first + j * row_step, row_step, step, source, source_at, count, target,
             target_at + j * STRIP)
        j += 1


@compiled
def count_blocks(rows: int, columns: int) -> int:
    """Blocks of `correlate` that cover a matrix."""
    return -(-rows // DOWN) * -(-columns // ACROSS)


@compiled
def correlate(
    left: np.ndarray, rows: int, right: np.ndarray, columns: int, strips: int, blocks: np.ndarray, first: int,
) -> None:
    """Add to blocks of a matrix the sums over s and p of left[s, j, p] * right[s, i, p], for j < rows, i < columns.

    Args:
        left, right: strips one after the other, of `rows` and of `columns` rows of `STRIP` numbers.
        blocks: of `LANES` numbers each, from block `first` on; `open_blocks` reads them.
    """
    at = first * LANES
    for j in range(0, rows, DOWN):
        for i in range(0, columns, ACROSS):
            _correlate(left, j, rows, right, i, columns, strips, blocks, at)
            at += LANES


@compiled
def open_blocks(blocks: np.ndarray, first: int, rows: int, columns: int, target: np.ndarray) -> None:
    """The matrix (rows, columns), flat, whose blocks `correlate` has summed."""
    at = first * LANES
    for j in range(0, rows, DOWN):
        for i in range(0, columns, ACROSS):
            for v in range(min(DOWN, rows - j)):
                for u in range(min(ACROSS, columns - i)):
                    target[(j + v) * columns + i + u] = blocks[at + ACROSS * v + u]
            at += LANES


def _variable(builder: Any, value: Any) -> Any:
    """A place of the stack, which becomes a register."""
    return cgutils.alloca_once_value(builder, value)


def _multiply_add(builder: Any, a: Any, b: Any, c: Any) -> Any:
    name = f"llvm.fma.v{LANES}f32"
    function = builder.module.globals.get(name) or ir.Function(
        builder.module, ir.FunctionType(_vector(), [_vector()] * 3), name)
    return builder.call(function, [a, b, c])


def _combining(rows: int) -> Callable[..., Any]:
    """The product of `rows` rows of weights and two vectors of every source row, added to the target."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        weights, first, row_step, step, source, source_at, count, target, target_at = arguments
        kinds = signature.args
        weights, source, target = (_data(context, builder, kinds[k], value)
                                   for k, value in ((0, weights), (4, source), (7, target)))
        places = [builder.add(target_at, _index(j * STRIP + v)) for j in range(rows) for v in (0, LANES)]
        totals = [_variable(builder, _load(builder, target, place)) for place in places]
        with cgutils.for_range(builder, count) as loop:
            here = builder.add(source_at, builder.mul(loop.index, _index(STRIP)))
            values = [_load(builder, source, builder.add(here, _index(v))) for v in (0, LANES)]
            start = builder.add(first, builder.mul(loop.index, step))
            for j in range(rows):
                weight = builder.load(builder.gep(weights, [builder.add(start, builder.mul(_index(j), row_step))]))
                spread = _repeat(builder, weight, LANES)
                for v in range(2):
                    total = totals[2 * j + v]
                    builder.store(_multiply_add(builder, spread, values[v], builder.load(total)), total)
        for total, place in zip(totals, places, strict=True):
            _store(builder, builder.load(total), target, place)
        return context.get_dummy_value()

    def typed(typingctx: Any, weights: Any, first: Any, row_step: Any, step: Any, source: Any, source_at: Any,
              count: Any, target: Any, target_at: Any) -> Any:
        whole = types.int64
        return types.void(weights, whole, whole, whole, source, whole, whole, target, whole), generate

    return typed


_block, _row = intrinsic(_combining(ROWS)), intrinsic(_combining(1))


@intrinsic
def _correlate(typingctx: Any, left: Any, row: Any, rows: Any, right: Any, column: Any, columns: Any, strips: Any,
               blocks: Any, at: Any) -> Any:
    """Add to a block, whose rows and columns beyond the last repeat it."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        kinds = signature.args
        left, right, blocks = (_data(context, builder, kinds[k], arguments[k]) for k in (0, 3, 7))
        row, rows, column, columns, strips, at = (arguments[k] for k in (1, 2, 4, 5, 6, 8))

        def places(first: Any, size: Any, count: int) -> list[Any]:
            found = []
            for k in range(count):
                here, last = builder.add(first, _index(k)), builder.sub(size, _index(1))
                within = builder.select(builder.icmp_signed("<", here, last), here, last)
                found.append(builder.mul(within, _index(STRIP)))
            return found

        downs, across = places(row, rows, DOWN), places(column, columns, ACROSS)
        zero = ir.Constant(_vector(), [0.0] * LANES)
        totals = [_variable(builder, zero) for _ in range(DOWN * ACROSS)]
        with cgutils.for_range(builder, strips) as loop:
            here, there = (builder.mul(loop.index, builder.mul(size, _index(STRIP))) for size in (rows, columns))
            for p in (0, LANES):
                ones = [_load(builder, left, builder.add(builder.add(place, here), _index(p))) for place in downs]
                others = [_load(builder, right, builder.add(builder.add(place, there), _index(p))) for place in across]
                for v in range(DOWN):
                    for u in range(ACROSS):
                        total = totals[ACROSS * v + u]
                        builder.store(_multiply_add(builder, ones[v], others[u], builder.load(total)), total)
        vectors = [builder.load(total) for total in totals]
        while len(vectors) > 1:  # sums of neighbours, of two vectors in one
            vectors = [_add_neighbours(builder, *vectors[k:k + 2]) for k in range(0, len(vectors), 2)]
        _store(builder, builder.fadd(vectors[0], _load(builder, blocks, at)), blocks, at)
        return context.get_dummy_value()

    whole = types.int64
    return types.void(left, whole, whole, right, whole, whole, whole, blocks, whole), generate


def _add_neighbours(builder: Any, a: Any, b: Any) -> Any:
    mask = ir.VectorType(ir.IntType(32), LANES)
    even, odd = (builder.shuffle_vector(a, b, ir.Constant(mask, list(range(k, 2 * LANES, 2)))) for k in range(2))
    return builder.fadd(even, odd)


# Products of 8-bit numbers, four of which are one element of 32 bits.

FOURS = 4
"""Rows of factors that are multiplied at once."""
PIXELS = 4 * LANES if LANES == 16 else 2 * LANES
"""Columns of codes that are multiplied at once, so that the sums fill half of the registers."""
TURNED = 8
"""Rows and columns of a block that `turn_codes` transposes."""


@compiled
def wide_rows(columns: int) -> int:
    """Columns of whole blocks that hold so many."""
    return -(-columns // PIXELS) * PIXELS


@compiled
def turn_codes(codes: np.ndarray, turned: np.ndarray) -> None:
    """Put codes (w, C) of 8 bits into columns: (C / 4, at least w) of 32 bits. What blocks do not fill goes element by
    element."""
    w, groups, wide = codes.shape[0], turned.shape[0], turned.shape[1]
    flat, target = codes.reshape(codes.size).view(np.int32), turned.reshape(turned.size)
    whole, full = w // TURNED * TURNED, groups // TURNED * TURNED
    for k in range(0, full, TURNED):
        for x in range(0, whole, TURNED):
            _turn(flat, x * groups + k, groups, target, k * wide + x, wide)
    for x in range(w):
        for k in range(full if x < whole else 0, groups):
            turned[k, x] = flat[x * groups + k]


@compiled
def multiply_codes(turned: np.ndarray, factors: np.ndarray, first: int, sums: np.ndarray) -> None:
    """Sums (4, w) of the products of four rows of factors (n, C), from the `first` on, and codes (C / 4, w).

    Args:
        turned: unsigned codes as `turn_codes` leaves them; w is a multiple of `PIXELS`.
        factors: signed, at most 64: without VNNI, two products are added in 16 bits.
    """
    groups, wide = turned.shape
    codes, weights = turned.reshape(turned.size), factors.reshape(factors.size).view(np.int32)
    target = sums.reshape(sums.size)
    for x in range(0, wide, PIXELS):
        _multiply_codes(codes, x, wide, weights, first * groups, groups, target, x, wide)


def _whole(count: int, bits: int = 32) -> Any:
    return ir.VectorType(ir.IntType(bits), count)


def _add_codes(builder: Any, total: Any, codes: Any, factors: Any) -> Any:
    """The total plus four products in each of its numbers, by x86's instructions."""
    if adds_byte_products():
        return _call(builder, "llvm.x86.avx512.vpdpbusd.512", _whole(LANES), [total, codes, factors])
    wide = LANES == 16
    products, pairs = _whole(4 * LANES, 8), _whole(2 * LANES, 16)
    multiply = "llvm.x86.avx512.pmaddubs.w.512" if wide else "llvm.x86.avx2.pmadd.ub.sw"
    add = "llvm.x86.avx512.pmaddw.d.512" if wide else "llvm.x86.avx2.pmadd.wd"
    twos = _call(builder, multiply, pairs, [builder.bitcast(one, products) for one in (codes, factors)])
    return builder.add(total, _call(builder, add, _whole(LANES), [twos, ir.Constant(pairs, [1] * 2 * LANES)]))


def _call(builder: Any, name: str, result: Any, arguments: Sequence[Any]) -> Any:
    function = builder.module.globals.get(name) or ir.Function(
        builder.module, ir.FunctionType(result, [one.type for one in arguments]), name)
    return builder.call(function, arguments)


@intrinsic
def _multiply_codes(typingctx: Any, codes: Any, at: Any, apart: Any, factors: Any, first: Any, groups: Any, sums: Any,
                    place: Any, step: Any) -> Any:
    """Sums of `FOURS` rows and `PIXELS` columns."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        codes, at, apart, factors, first, groups, sums, place, step = arguments
        codes, factors, sums = (_data(context, builder, signature.args[k], value)
                                for k, value in ((0, codes), (3, factors), (6, sums)))
        across = range(0, PIXELS, LANES)
        zero, whole = ir.Constant(_whole(LANES), [0] * LANES), ir.Constant(_whole(LANES), ir.Undefined)
        totals = [_variable(builder, zero) for _ in range(FOURS) for _ in across]
        with cgutils.for_range(builder, groups) as loop:
            here = builder.add(at, builder.mul(loop.index, apart))
            seen = [_load(builder, codes, builder.add(here, _index(x)), _whole(LANES)) for x in across]
            for j in range(FOURS):
                row = builder.add(first, builder.add(loop.index, builder.mul(groups, _index(j))))
                one = builder.insert_element(whole, builder.load(builder.gep(factors, [row])), _index(0))
                spread = builder.shuffle_vector(one, whole, ir.Constant(_whole(LANES), [0] * LANES))
                for v, code in enumerate(seen):
                    total = totals[len(seen) * j + v]
                    builder.store(_add_codes(builder, builder.load(total), code, spread), total)
        for j in range(FOURS):
            for v, x in enumerate(across):
                there = builder.add(place, builder.add(builder.mul(step, _index(j)), _index(x)))
                _store(builder, builder.load(totals[len(across) * j + v]), sums, there)
        return context.get_dummy_value()

    whole = types.int64
    return types.void(codes, whole, whole, factors, whole, whole, sums, whole, whole), generate


@intrinsic
def _turn(typingctx: Any, source: Any, at: Any, step: Any, target: Any, place: Any, apart: Any) -> Any:
    """Transpose a block of 32-bit numbers: pairs of rows are interleaved by one number, by two, and by four."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        source, at, step, target, place, apart = arguments
        source, target = (_data(context, builder, signature.args[k], value) for k, value in ((0, source), (3, target)))
        rows = [_load(builder, source, builder.add(at, builder.mul(step, _index(j))), _whole(TURNED))
                for j in range(TURNED)]
        for run in (1, 2, 4):
            orders = [[half + k - k % (2 * run) + k % run + k // run % 2 * TURNED for k in range(TURNED)]
                      for half in (0, run)]
            for j in (j for j in range(TURNED) if j // run % 2 == 0):
                pair = rows[j], rows[j + run]
                rows[j], rows[j + run] = (builder.shuffle_vector(*pair, ir.Constant(_whole(TURNED), order))
                                          for order in orders)
        for j, row in enumerate(rows):
            _store(builder, row, target, builder.add(place, builder.mul(apart, _index(j))))
        return context.get_dummy_value()

    whole = types.int64
    return types.void(source, whole, whole, target, whole, whole), generate
