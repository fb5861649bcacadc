"""Whether an output file that is there already is what an earlier run made of the same input."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

from postfx.files import hash_file
from postfx.io.writer import is_complete
from postfx.runs.manifest import Output

Inputs = Mapping[str, tuple[int, int]]


class Existing(NamedTuple):
    """Whether a file is kept; why it is not, or what is odd about keeping it."""

    kept: bool
    why: str = ""


def judge(path: Path, known: Output | None, size: tuple[int, int], inputs: Inputs) -> Existing:
    """Whether a file may stay.

    Args:
        known: what the manifest has about it.
        size: width and height that it must have.
        inputs: what its frame would be read from now.

    A file that the manifest does not know, or that was altered since, stays if it can be decoded to its last pixel: it
    may be someone's work. One whose run did not get to it is left from before that run, and does not stay.
    """
    if not path.is_file():
        return Existing(False, "is not there")
    if known is None:
        return Existing(True) if is_complete(path, *size) else Existing(False, "is not complete")
    if known.sha256 is None:
        return Existing(False, "is older than the run that was to write it")
    if (known.width, known.height) != size:
        return Existing(False, f"is {known.width}x{known.height}, not {size[0]}x{size[1]}")
    if _changed(known.inputs, inputs):
        return Existing(False, "was made of an input that has changed since")
    if path.stat().st_size == known.bytes and hash_file(path) == known.sha256:
        return Existing(True)
    if is_complete(path, *size):
        return Existing(True, "was altered since it was written: kept; delete it to make it anew")
    return Existing(False, "is damaged")


def facts_of(paths: list[Path]) -> dict[str, tuple[int, int]]:
    """Size and time of change of files, by path; without those that are not there."""
    found = {str(path): path.stat() for path in paths if path.is_file()}
    return {path: (status.st_size, status.st_mtime_ns) for path, status in found.items()}


def _changed(before: Inputs, now: Inputs) -> bool:
    """Whether a file that is there under the same name is another one; files that are gone are not missed."""
    return any(path in before and before[path] != facts for path, facts in now.items())
