"""Locks of an output folder, claims to files in it, and the processes that hold them, across
machines."""

from __future__ import annotations

import json
import os
import socket
import stat
import tempfile
import threading
import time
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

from postfx.errors import RunError
from postfx.files import create_whole, is_process_alive, parse_json, read_text, remove, write_text


class Process(NamedTuple):
    """A process.

    Attributes:
        host: name of its machine.
        space: its PID namespace; containers on one machine have their own.
        pid: its number in that namespace.
        begun: its start time in the kernel's ticks since boot; unlike `pid` it is not reused.
    """

    host: str
    space: str
    pid: int
    begun: int

    @classmethod
    def me(cls) -> Process:
        """This process."""
        return cls(socket.gethostname(), _space(), os.getpid(), _begun(os.getpid()))

    @classmethod
    def of(cls, facts: Any) -> Process:
        """The process that `as_dict` described; missing facts become unknown."""
        facts = facts if isinstance(facts, dict) else {}
        return cls(str(facts.get("host", "")), str(facts.get("space", "")),
                   _number(facts.get("pid")), _number(facts.get("begun")))

    def as_dict(self) -> dict[str, Any]:
        """The process in plain types."""
        return self._asdict()

    def is_alive(self) -> bool | None:
        """Whether it still runs; None if this machine or container cannot tell."""
        if (self.host, self.space) != (socket.gethostname(), _space()):
            return None
        return is_process_alive(self.pid) and _begun(self.pid) == self.begun

    def __str__(self) -> str:
        return f"process {self.pid} on {self.host or 'an unknown machine'}"


def age_of(path: Path) -> float:
    """Seconds since a file was written or touched, by the file server's clock; 0 if it does not
    exist."""
    with tempfile.NamedTemporaryFile(dir=path.parent, prefix=".clock.") as probe:
        try:
            return max(0.0, os.stat(probe.name).st_mtime - path.stat().st_mtime)
        except FileNotFoundError:
            return 0.0


def _space() -> str:
    try:
        return os.readlink("/proc/self/ns/pid")
    except OSError:
        return ""


def _begun(pid: int) -> int:
    """Start time of a process (field 22 of /proc/PID/stat, elsewhere hundredths of a second); 0 if
    unknown."""
    try:
        text = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8", errors="replace")
    except OSError:
        import psutil  # only where there is no /proc, or no such process

        try:
            return int(psutil.Process(pid).create_time() * 100)
        except (psutil.Error, OverflowError, ValueError):
            return 0
    return int(text.rpartition(")")[2].split()[19])


def _number(value: Any) -> int:
    return value if isinstance(value, int) else 0


LOCK_TIMEOUT_SECONDS = 30.0
"""Seconds to wait for a lock; others hold it for milliseconds only."""
OLD = 60.0
"""Seconds after which a lock counts as abandoned if its holder cannot be checked from here."""
EMPTY = 5.0
"""Seconds after which a lock counts as abandoned that does not name its holder: it is empty for
milliseconds, on file systems without links."""
LOCK_PAUSE_SECONDS = 0.02


class FolderLock:
    """A lock on a folder, as a context manager around a few reads and writes.

    The file names host and process from its first moment on. A lock whose process has ended is
    taken over, and so is what names no process, such as a pipe. Raises RunError if the lock cannot
    be acquired in time.
    """

    def __init__(self, path: Path, patience: float = LOCK_TIMEOUT_SECONDS) -> None:
        self._path, self._patience = path, patience

    def __enter__(self) -> FolderLock:
        end = time.monotonic() + self._patience
        while not _create(self._path):
            if _is_left(self._path):
                self._break()
            elif time.monotonic() > end:
                holder = _holder(self._path)
                raise RunError(f"{self._path}: held by {holder}: delete the file if that process "
                               "has ended")
            else:
                time.sleep(LOCK_PAUSE_SECONDS)
        return self

    def __exit__(self, *_: object) -> None:
        if _holder(self._path) == Process.me():  # another process may have taken it for abandoned
            remove(self._path)

    def _break(self) -> None:
        """Remove an abandoned lock. Only one process at a time may do so, so that none removes a
        new lock."""
        breaking = self._path.with_name(f"{self._path.name}.breaking")
        if not _create(breaking):
            if _is_left(breaking):
                remove(breaking)
            time.sleep(LOCK_PAUSE_SECONDS)
            return
        try:
            if _is_left(self._path):
                remove(self._path)
        except IsADirectoryError as error:
            raise RunError(f"{self._path}: is a folder, where a file has to be: delete "
                           "it") from error
        finally:
            remove(breaking)


def _create(path: Path) -> bool:
    try:
        return create_whole(path, json.dumps(Process.me().as_dict()).encode())
    except PermissionError:
        if os.name != "nt":  # where it also means that the file is about to be removed
            raise
        return False


def _holder(path: Path) -> Process:
    """The process that made a lock; unknown if the file is missing or still empty."""
    try:
        return Process.of(parse_json(read_text(path)))
    except (OSError, ValueError):
        return Process.of(None)


def _is_left(path: Path) -> bool:
    """Whether nobody holds a lock: its process has ended, or it is nothing that a process of postfx
    would leave."""
    try:
        if not stat.S_ISREG(path.lstat().st_mode):
            return True
    except OSError:
        return False
    holder = _holder(path)
    alive = holder.is_alive()
    return alive is False or (alive is None and age_of(path) > (OLD if holder.pid else EMPTY))


BEAT = 10.0
"""Seconds between two heartbeats."""
SILENT_SECONDS = 120.0
"""Seconds without one after which a run on another machine counts as ended."""
CLAIM_SUFFIX = ".claim"


class Claim:
    """Reserves files of a folder for one run. Make it while holding the folder's lock.

    A thread touches the claim's file as a heartbeat. Claims of runs that have ended are removed,
    and so are claims that a killed run had begun to write. Raises RunError if a run that has not
    ended claims one of the files.
    """

    def __init__(self, folder: Path, run: str, names: Iterable[str]) -> None:
        wanted = set(names)
        # who writes a claim holds the lock: these are of killed runs
        for partial in folder.glob(f".*{CLAIM_SUFFIX}.*"):
            remove(partial)
        for other in folder.glob(f"*{CLAIM_SUFFIX}"):
            _refuse_shared(other, wanted)
        self.path = folder / f"{run}{CLAIM_SUFFIX}"
        facts = {"process": Process.me().as_dict(), "files": sorted(wanted)}
        write_text(self.path, json.dumps(facts))
        self._over = threading.Event()
        threading.Thread(target=self._beat, name="postfx claim", daemon=True).start()

    def release(self) -> None:
        """Release the files to other runs."""
        self._over.set()
        remove(self.path)

    def _beat(self) -> None:
        while not self._over.wait(BEAT):
            with suppress(OSError):
                os.utime(self.path)


def is_alive(folder: Path, run: str) -> bool:
    """Whether a run has a claim and has not ended."""
    path = folder / f"{run}{CLAIM_SUFFIX}"
    return path.exists() and not _is_gone(path, _process(path)[0])


def _refuse_shared(path: Path, wanted: set[str]) -> None:
    process, files = _process(path)
    if _is_gone(path, process):
        remove(path)
        return
    shared = sorted(wanted & files)
    if shared:
        raise RunError(f"{path.parent.parent / shared[0]}: is being written by {process}: wait for "
                       "it, or choose other frames or another folder (if it has ended, delete "
                       f"{path})")


def _process(path: Path) -> tuple[Process, set[str]]:
    """The process and the files of a claim; unknown and none if it cannot be read."""
    try:
        facts = parse_json(read_text(path))
        return Process.of(facts.get("process")), set(facts.get("files", ()))
    except (OSError, ValueError, AttributeError, TypeError):
        return Process.of(None), set()


def _is_gone(path: Path, process: Process) -> bool:
    alive = process.is_alive()
    return alive is False or (alive is None and age_of(path) > SILENT_SECONDS)
