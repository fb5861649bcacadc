"""Errors of a benchmark that a user can mend."""

from __future__ import annotations

from importlib.util import find_spec

from postfx.errors import PostfxError


class BenchError(PostfxError):
    """A benchmark cannot be made: frames do not fit together, a method is unknown, or a library is not installed."""


def require(module: str, package: str, use: str) -> None:
    """Raise BenchError when a library of the extra 'bench' is not installed."""
    if find_spec(module) is None:
        raise BenchError(f"{package} is not installed, which {use}: pip install 'postfx[bench]'")
