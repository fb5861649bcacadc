"""A lock for a moment, also on networked folders: a file that only one process can create."""

from __future__ import annotations

import json
import os
import time
from contextlib import suppress
from pathlib import Path

from postfx.errors import RunError
from postfx.files import parse_json, read_text
from postfx.runs.process import Process, age_of

PATIENCE = 30.0
"""Seconds to wait for a lock, which others hold for milliseconds."""
OLD = 60.0
"""Seconds after which a lock counts as left behind when its holder cannot be seen from here."""
PAUSE = 0.02


class FolderLock:
    """Use as a context manager around a few reads and writes.

    The file is created with O_EXCL, which is atomic on NFS since version 3, and holds host and process. A lock whose
    process is gone is taken over. Raises RunError when the lock is not to be had in time.
    """

    def __init__(self, path: Path, patience: float = PATIENCE) -> None:
        self._path, self._patience = path, patience

    def __enter__(self) -> FolderLock:
        end = time.monotonic() + self._patience
        while not _create(self._path):
            if _is_left(self._path):
                self._break()
            elif time.monotonic() > end:
                holder = _holder(self._path)
                raise RunError(f"{self._path}: held by {holder}: delete the file if that process is gone")
            else:
                time.sleep(PAUSE)
        return self

    def __exit__(self, *_: object) -> None:
        if _holder(self._path) == Process.me():  # it may have been taken for one that was left behind
            with suppress(FileNotFoundError):
                self._path.unlink()

    def _break(self) -> None:
        """Remove a lock that was left behind. Only one process at a time may, so that none removes a fresh one."""
        breaking = self._path.with_name(f"{self._path.name}.breaking")
        if not _create(breaking):
            if _is_left(breaking):
                with suppress(FileNotFoundError):
                    breaking.unlink()
            time.sleep(PAUSE)
            return
        try:
            if _is_left(self._path):
                self._path.unlink(missing_ok=True)
        finally:
            breaking.unlink(missing_ok=True)


def _create(path: Path) -> bool:
    try:
        handle = os.open(path, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o644)
    except FileExistsError:
        return False
    with os.fdopen(handle, "w", encoding="utf-8") as file:
        json.dump(Process.me().as_dict(), file)
    return True


def _holder(path: Path) -> Process:
    """Who made a lock; an unknown process where it is gone, or made and not yet written."""
    try:
        return Process.of(parse_json(read_text(path)))
    except (OSError, ValueError):
        return Process.of(None)


def _is_left(path: Path) -> bool:
    alive = _holder(path).is_alive()
    return alive is False or (alive is None and age_of(path) > OLD)
