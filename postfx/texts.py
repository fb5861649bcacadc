"""Texts that others wrote: files read within bounds, JSON without surprises, names that go on a line."""

from __future__ import annotations

import errno
import json
from pathlib import Path
from typing import Any

MOST_BYTES = 1 << 30


def read_text(path: Path, most: int = MOST_BYTES) -> str:
    """A file's text. OSError for what is no file, such as a pipe or a device that never ends, or has more than `most`
    bytes; ValueError for what is not UTF-8."""
    if path.exists() and not path.is_file():
        raise OSError(errno.EINVAL, "it is not a file", str(path))
    if path.stat().st_size > most:
        raise OSError(errno.EFBIG, f"it has more than {most} bytes", str(path))
    return path.read_text(encoding="utf-8")


def parse_json(text: str | bytes) -> Any:
    """What a text in JSON says; ValueError when it is none, or its values are nested without end."""
    try:
        return json.loads(text)
    except RecursionError:
        raise ValueError("its values are nested without end") from None


def is_utf8(name: str) -> bool:
    """Whether a file's name is text; names that are not come from the system as lone surrogates."""
    return not any("\ud800" <= letter <= "\udfff" for letter in name)


def printable(text: str) -> str:
    """A text on one line, without letters that a terminal would obey."""
    return "".join(letter if letter.isprintable() else "?" for letter in text)
