"""Functions of vectors, for kernels whose loops Numba does not turn into vector code: those that jump from place to
place.

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

from llvmlite import ir
from numba import types
from numba.extending import intrinsic

_FLOAT, _INDEX = ir.FloatType(), ir.IntType(64)
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

    def part(self, first: int, count: int) -> Vector:
        """Some of the numbers, from one on."""
        return Vector(self.builder, self.builder.shuffle_vector(self.value, self.value, _places(first, count)))

    def number(self, at: int) -> Any:
        """One number of it, as a result."""
        return self.builder.extract_element(self.value, ir.Constant(ir.IntType(32), at))

    def spread(self, at: int, count: int) -> Vector:
        """One number of it, this many times."""
        places = ir.Constant(ir.VectorType(ir.IntType(32), count), [at] * count)
        return Vector(self.builder, self.builder.shuffle_vector(self.value, self.value, places))

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
            return ir.Constant(self.value.type, [ir.Constant(_FLOAT, float(number)) for number in numbers])
        first = self.builder.insert_element(ir.Constant(self.value.type, ir.Undefined), other,
                                            ir.Constant(ir.IntType(32), 0))
        return self.builder.shuffle_vector(first, first, ir.Constant(ir.VectorType(ir.IntType(32), count), [0] * count))


class Lanes:
    """What the body of a function of vectors is written with; its arguments are LLVM's values."""

    def __init__(self, count: int, context: Any, builder: Any, arrays: dict[int, Any]) -> None:
        self.count, self.context, self.builder, self.arrays = count, context, builder, arrays

    def load(self, array: Any, at: Any) -> Vector:
        """Numbers of an array from an index on."""
        data = self.context.make_array(self.arrays[id(array)])(self.context, self.builder, array).data
        place = self.builder.bitcast(self.builder.gep(data, [at]), ir.VectorType(_FLOAT, self.count).as_pointer())
        return Vector(self.builder, self.builder.load(place, align=4))

    def constant(self, numbers: Sequence[float]) -> Vector:
        """Numbers that are known, as many as there are."""
        kind = ir.VectorType(_FLOAT, len(numbers))
        return Vector(self.builder, ir.Constant(kind, [ir.Constant(_FLOAT, float(number)) for number in numbers]))

    def step(self, at: Any, stride: Any, times: int = 1) -> Any:
        """An index, moved on by a multiple of a stride, which may be an int."""
        by = ir.Constant(_INDEX, stride * times) if isinstance(stride, int) else \
            self.builder.mul(stride, ir.Constant(_INDEX, times))
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
    """Decorator of a function of vectors of this many numbers, which gives one result or a tuple of several."""
    made_with = tuple(one for kind in (Vector, Lanes) for one in vars(kind).values() if callable(one))

    def decorate(function: Callable[..., Any]) -> Any:
        def call(typingctx: Any, *arguments: Any) -> Any:
            assert made_with, "is part of what compiled code is cached by"
            kinds = [kind if isinstance(kind, types.Array) else types.int64 if isinstance(kind, types.Integer)
                     else types.float32 for kind in arguments]
            numbers: Any = types.UniTuple
            result = types.float32 if results == 1 else numbers(types.float32, results)

            def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
                arrays = {id(value): kind for value, kind in zip(values, signature.args, strict=True)}
                found = function(Lanes(count, context, builder, arrays), *values)
                return context.make_tuple(builder, result, found) if isinstance(found, tuple) else found

            return result(*kinds), generate

        call.__signature__ = inspect.signature(function)  # type: ignore[attr-defined]  # Numba takes no *arguments
        return intrinsic(call)

    return decorate


def _places(first: int, count: int) -> Any:
    return ir.Constant(ir.VectorType(ir.IntType(32), count), list(range(first, first + count)))
