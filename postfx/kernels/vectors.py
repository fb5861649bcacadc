"""Vector instructions for kernels whose loops Numba's compiler does not turn into them: functions of vectors, for loops
that jump from place to place.

    @in_lanes(8)
    def sum_of_differences(v, one, other, at):      # two flat float32 arrays, an index
        return (v.load(one, at) - v.load(other, at)).magnitude().total()

is a function that kernels call. Its body runs once, when the kernel is compiled, and writes LLVM's instructions. Its
arguments are arrays, integers and float32 numbers, as the call has them; it returns a number or a tuple of them. No
bounds are checked.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Sequence
from functools import reduce
from typing import Any

from postfx.kernels.native import intrinsic, ir, types

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


def _data(context: Any, builder: Any, kind: Any, array: Any) -> Any:
    return context.make_array(kind)(context, builder, array).data


def _load(builder: Any, data: Any, at: Any, kind: Any) -> Any:
    return builder.load(builder.bitcast(builder.gep(data, [at]), kind.as_pointer()), align=4)


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


def _whole(count: int, bits: int = 32) -> Any:
    return ir.VectorType(ir.IntType(bits), count)
