"""What the tables of a profile may hold, so that a mistake in one is told before anything is made of it."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

from postfx.errors import ProfileError


class Kind(NamedTuple):
    """A kind of value: in words, and whether something is one."""

    words: str
    fits: Callable[[Any], bool]


def _is_number(value: Any) -> bool:
    return type(value) in (int, float) and math.isfinite(value) and abs(value) <= 1e30


def _is_pattern(value: Any) -> bool:
    try:
        re.compile(value)
    except (re.error, RecursionError, OverflowError, TypeError):
        return False
    return True


def _list_of(kind: Kind, words: str) -> Kind:
    return Kind(words, lambda value: isinstance(value, list) and all(map(kind.fits, value)))


TEXT = Kind("a text", lambda value: isinstance(value, str))
YES_NO = Kind("true or false", lambda value: isinstance(value, bool))
NUMBER = Kind("a number", _is_number)
DISTANCE = Kind("a number or inf", lambda value: _is_number(value) or value == math.inf)
TABLE = Kind("a table", lambda value: isinstance(value, dict))
TABLES = _list_of(TABLE, "tables in double brackets")
TEXTS = _list_of(TEXT, "a list of texts")
NUMBERS = _list_of(NUMBER, "a list of numbers")
RANGE = Kind("two numbers, the lower first", lambda value: NUMBERS.fits(value) and len(value) == 2
             and value[0] <= value[1])
LETTERS = Kind("a list of texts or of lists of texts",
               lambda value: isinstance(value, list) and all(TEXT.fits(item) or TEXTS.fits(item) for item in value))
PATTERNS = Kind("a table of regular expressions",
                lambda value: isinstance(value, dict) and all(map(_is_pattern, value.values())))

PROFILE = {"name": TEXT, "title": TEXT, "extends": TEXT, "marker": TEXT, "detect": TABLES, "header": TABLE,
           "camera": TABLE, "plane": TABLES}
CAMERA = {"fov_x": NUMBER, "near": NUMBER, "far": DISTANCE, "column_vectors": YES_NO}
DETECT = {"header": PATTERNS, "channels": TEXTS}
PLANE = {"role": TEXT, "names": TEXTS, "channels": LETTERS, "scale": NUMBERS, "offset": NUMBERS, "unit": TEXT,
         "space": TEXT, "kind": TEXT, "reversed": YES_NO, "miss": NUMBER, "clamp": RANGE, "enable": TEXT}


def check(table: Mapping[str, Any], kinds: Mapping[str, Kind], path: Path, where: str = "profile") -> None:
    """ProfileError for a key that is not known, and for a value of another kind than its key has."""
    for key in sorted(table):
        if key not in kinds:
            raise ProfileError(f"{path}: {where}: unknown key '{key}': use {', '.join(kinds)}")
        if not kinds[key].fits(table[key]):
            raise ProfileError(f"{path}: {where}: {key} must be {kinds[key].words}")
