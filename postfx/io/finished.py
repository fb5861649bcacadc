"""Files that appear under their name only when they are complete and on the disk."""

from __future__ import annotations

import os
import re
import socket
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from itertools import count
from pathlib import Path

from postfx.errors import WriteError

PARTIAL = ".part"
"""Suffix of files that are being written; no frame pattern matches it."""
_NAME_BYTES = 120  # of the final name within the temporary one, so that file systems take it
_LEFT = re.compile(
    rf"\.(?P<name>.+)\.(?P<host>[\w-]+)-(?P<process>\d{{1,9}})-\d+(-[a-z]+)?{re.escape(PARTIAL)}", re.DOTALL
)
_numbers = count()


@contextmanager
def finished_file(path: Path) -> Iterator[Path]:
    """A path beside `path` to write a file to, which then becomes `path` at once, or vanishes when an error is raised.

    Folders are made; the content is on the disk before the name is. What a killed process of this machine left behind
    for the same path is removed. Raises WriteError where the file system refuses.
    """
    temporary = path.with_name(f".{_shortened(path.name)}.{_host()}-{os.getpid()}-{next(_numbers)}{PARTIAL}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        remove_left_over(path.parent, [path.name])
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


def beside(temporary: Path, word: str) -> Path:
    """A second temporary name, for a writer of two steps; left behind, it is removed like the first."""
    return temporary.with_name(f"{temporary.name.removesuffix(PARTIAL)}-{word}{PARTIAL}")


def remove_left_over(folder: Path, names: Iterable[str], anyones: bool = False) -> None:
    """Remove what writers of some files of a folder left behind when they were killed on this machine; with `anyones`,
    also on others, which takes that nobody else may write these files now."""
    own, meant = _host(), set(map(_shortened, names))
    for entry in os.scandir(folder):
        found = entry.name.endswith(PARTIAL) and _LEFT.fullmatch(entry.name)
        if found and found["name"] in meant and (anyones if found["host"] != own else not _runs(int(found["process"]))):
            with suppress(OSError):
                os.unlink(entry.path)


def _host() -> str:
    """This machine's name, without what would hide where the file's ends."""
    return re.sub(r"[^\w-]", "_", socket.gethostname())[:60]


def _shortened(name: str) -> str:
    return os.fsencode(name)[:_NAME_BYTES].decode("utf-8", "ignore")


def _runs(process: int) -> bool:
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
