"""Matching of tensor shapes against declared ones with symbols: (1, 3, 'height', '2*width')."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import NamedTuple

from postfx.errors import BindingError

_SCALED = re.compile(r"(?:(\d+) *\* *)?([A-Za-z_]\w*)")


class Dimension(NamedTuple):
    """`factor` times the value of `symbol`, or just `factor` when the symbol is None."""

    factor: int
    symbol: str | None


def parse(dimension: int | str) -> Dimension:
    """A declared dimension: a number, 'symbol' or 'k*symbol' with a whole number k of at least 1."""
    if isinstance(dimension, int):
        return Dimension(dimension, None)
    match = _SCALED.fullmatch(dimension.strip())
    if match is None or match[1] == "0":
        raise BindingError(f"dimension '{dimension}' is not a number, a symbol or 'k*symbol'")
    return Dimension(int(match[1] or 1), match[2])


def could_match(shape: tuple[int, ...], declared: tuple[int | str, ...]) -> bool:
    """Whether a shape has the declared rank and fixed sizes, whatever the symbols' values are elsewhere."""
    if len(shape) != len(declared):
        return False
    dimensions = [parse(item) for item in declared]
    return all(
        size == dim.factor if dim.symbol is None else size % dim.factor == 0
        for size, dim in zip(shape, dimensions, strict=True)
    )


def solve(shapes: Mapping[str, tuple[int, ...]], declared: Mapping[str, tuple[int | str, ...]]) -> dict[str, int]:
    """Values of the symbols that make every shape its declared one; BindingError naming two bindings that disagree."""
    values: dict[str, int] = {}
    origin: dict[str, str] = {}
    for name, dimensions in declared.items():
        for size, dimension in zip(shapes[name], dimensions, strict=True):
            factor, symbol = parse(dimension)
            if symbol is None:
                continue
            value = size // factor
            if values.setdefault(symbol, value) != value:
                raise BindingError(
                    f"'{origin[symbol]}' {shapes[origin[symbol]]} and '{name}' {shapes[name]} do not fit together: "
                    f"'{symbol}' is {values[symbol]} in the first and {value} in the second"
                )
            origin.setdefault(symbol, name)
    return values
