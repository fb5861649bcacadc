"""Checkpoints: the history of all passes after a frame, in a file, so that a run can resume with the same pixels.

A file holds a line of text with the format, a line of JSON that describes the arrays, the raw arrays, and the SHA-256
of everything before it.
"""

from __future__ import annotations

import hashlib
import json
import math
import os
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from postfx.errors import CheckpointError
from postfx.files import PIECE, parse_json, write_atomically

SUFFIX = ".checkpoint"
MAGIC = b"postfx checkpoint 1\n"
_MOST_HEADER = 1 << 20
_KINDS = ("float32", "float64", "int64")
_DIGEST = 32  # bytes


@dataclass(frozen=True)
class About:
    """Describes a checkpoint.

    Attributes:
        run: id of the run.
        pattern: of the output files.
        frame: number of the frame after which it was made.
        fingerprint: of everything that affects pixels; a run with another fingerprint cannot use the checkpoint.
    """

    run: str
    pattern: str
    frame: int
    fingerprint: str


def save_checkpoint(
    path: Path, about: About, history: Mapping[str, np.ndarray], relax: Callable[[], None] | None = None
) -> int:
    """Write a checkpoint; returns its size in bytes. `relax` is called between pieces."""
    arrays = {name: np.ascontiguousarray(array).reshape(np.shape(array)) for name, array in history.items()}
    shapes = [[name, array.dtype.name, array.shape] for name, array in arrays.items()]
    header = MAGIC + json.dumps({**asdict(about), "arrays": shapes}).encode() + b"\n"

    def write(file: BinaryIO) -> None:
        digest = hashlib.sha256()
        contents: list[bytes | memoryview] = [header]
        contents += [array.reshape(-1).data.cast("B") for array in arrays.values()]
        for content in contents:
            for first in range(0, len(content), PIECE):
                piece = content[first : first + PIECE]
                digest.update(piece)
                file.write(piece)
                if relax:
                    relax()
        file.write(digest.digest())

    write_atomically(path, write)
    return path.stat().st_size


def read_about(path: Path) -> About:
    """Description of a checkpoint, without reading its arrays; CheckpointError if it cannot be read."""
    with _open(path) as file:
        header = _header(path, file)
    try:
        return About(str(header.get("run")), str(header.get("pattern")), int(header.get("frame", 0)),
                     str(header.get("fingerprint")))
    except (ValueError, TypeError, OverflowError) as error:
        raise CheckpointError(f"{path}: is damaged") from error


def load_checkpoint(path: Path) -> dict[str, np.ndarray]:
    """The history that a checkpoint holds, as read-only arrays; CheckpointError if it is damaged."""
    if _is_altered(path):
        raise CheckpointError(f"{path}: is damaged")
    with _open(path) as file:
        shapes = _header(path, file).get("arrays", [])
        at = file.tell()
    arrays: dict[str, np.ndarray] = {}
    try:
        for name, kind, shape in shapes:
            if kind not in _KINDS:
                raise ValueError(f"an array of {kind}")
            arrays[name] = _array(path, kind, at, tuple(shape))
            at += arrays[name].nbytes
    except (OSError, ValueError, TypeError, OverflowError) as error:
        raise CheckpointError(f"{path}: cannot be read: {error}") from error
    return arrays


def _array(path: Path, kind: str, at: int, shape: tuple[int, ...]) -> np.ndarray:
    """An array of a file: mapped, so that memory holds it only while it is used; read on Windows, where the next
    checkpoint could not replace a mapped file."""
    if os.name != "nt":
        return np.memmap(path, kind, "r", at, shape or (1,)).reshape(shape)
    found = np.fromfile(path, kind, math.prod(shape), offset=at).reshape(shape)
    found.flags.writeable = False
    return found


def _open(path: Path) -> BinaryIO:
    try:
        return path.open("rb")
    except OSError as error:
        raise CheckpointError(f"{path}: {error.strerror}") from error


def _header(path: Path, file: BinaryIO) -> dict[str, Any]:
    try:
        if file.readline(len(MAGIC)) != MAGIC:
            raise ValueError("not a checkpoint")
        return dict(parse_json(file.readline(_MOST_HEADER)))
    except (OSError, ValueError, TypeError) as error:
        raise CheckpointError(f"{path}: is damaged") from error


def _is_altered(path: Path) -> bool:
    digest, left = hashlib.sha256(), path.stat().st_size - _DIGEST
    with _open(path) as file:
        while left > 0:
            piece = file.read(min(left, PIECE))
            if not piece:
                return True
            digest.update(piece)
            left -= len(piece)
        return file.read() != digest.digest()
