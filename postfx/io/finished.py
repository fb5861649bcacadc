"""Files that appear under their name only when they are complete and on the disk."""

from __future__ import annotations

import os
import socket
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from itertools import count
from pathlib import Path

from postfx.errors import WriteError

PARTIAL = ".part"
"""Suffix of files that are being written; no frame pattern matches it."""
_NAME_BYTES = 120  # of the final name within the temporary one, so that file systems take it
_numbers = count()


@contextmanager
def finished_file(path: Path) -> Iterator[Path]:
    """A path beside `path` to write a file to, which then becomes `path` at once, or vanishes when an error is raised.

    Folders are made; the content is on the disk before the name is. What a killed process of this machine left behind
    for the same path is removed. Raises WriteError where the file system refuses.
    """
    temporary = path.with_name(f"{_prefix(path)}{os.getpid()}-{next(_numbers)}{PARTIAL}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        _remove_left_over(path)
        yield temporary
        _sync(temporary, os.O_RDWR)
        os.replace(temporary, path)
        with suppress(OSError):  # not all file systems can
            _sync(path.parent, os.O_RDONLY | os.O_DIRECTORY)
    except OSError as error:
        reason = (error.strerror or str(error)).replace(str(temporary), str(path))
        raise WriteError(f"{path}: cannot be written: {reason}; check the folder's rights and free space") from error
    finally:
        with suppress(OSError):
            temporary.unlink()


def _prefix(path: Path) -> str:
    name = os.fsencode(path.name)[:_NAME_BYTES].decode("utf-8", "ignore")
    return f".{name}.{socket.gethostname()[:60]}-"


def _remove_left_over(path: Path) -> None:
    prefix = _prefix(path)
    for entry in os.scandir(path.parent):
        if entry.name.startswith(prefix) and entry.name.endswith(PARTIAL):
            process = entry.name[len(prefix) :].partition("-")[0]
            if process.isdigit() and not _is_running(int(process)):
                with suppress(OSError):
                    os.unlink(entry.path)


def _is_running(process: int) -> bool:
    try:
        os.kill(process, 0)
    except (ProcessLookupError, OverflowError):
        return False
    except PermissionError:
        return True
    return True


def _sync(path: Path, flags: int) -> None:
    descriptor = os.open(path, flags)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
