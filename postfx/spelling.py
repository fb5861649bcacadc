"""The American spelling of colour in names of arguments and options."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import wraps
from typing import Any, ParamSpec, TypeVar

Given = ParamSpec("Given")
Made = TypeVar("Made")


def in_our_spelling(named: Mapping[str, Any]) -> dict[str, Any]:
    """Named arguments with 'colour' where 'color' was written. TypeError if one is given in both
    spellings."""
    renamed = {name.replace("color", "colour"): value for name, value in named.items()}
    if len(renamed) < len(named):
        both = next(name for name in named if name.replace("color", "colour") in named
                    and "color" in name)
        raise TypeError(f"{both} is given in both spellings: give it once")
    return renamed


def takes_both_spellings(function: Callable[Given, Made]) -> Callable[Given, Made]:
    """A function that also takes its arguments' names with 'color'."""

    @wraps(function)
    def call(*given: Given.args, **named: Given.kwargs) -> Made:
        return function(*given, **in_our_spelling(named))

    return call
