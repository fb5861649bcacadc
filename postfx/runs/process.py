"""Which process holds something in a folder that several machines may see, and whether it is still there."""

from __future__ import annotations

import os
import socket
import tempfile
from pathlib import Path
from typing import Any, NamedTuple

from postfx.files import is_process_alive


class Process(NamedTuple):
    """A process.

    Attributes:
        host: name of its machine.
        space: which process numbers it lives among; containers on one machine have their own.
        pid: its number.
        begun: when it began, in the kernel's ticks since it was started; numbers are used again, this is not.
    """

    host: str
    space: str
    pid: int
    begun: int

    @classmethod
    def me(cls) -> Process:
        """The process that asks."""
        return cls(socket.gethostname(), _space(), os.getpid(), _begun(os.getpid()))

    @classmethod
    def of(cls, facts: Any) -> Process:
        """The process that `as_dict` told of; whatever is missing is unknown."""
        facts = facts if isinstance(facts, dict) else {}
        return cls(str(facts.get("host", "")), str(facts.get("space", "")), _number(facts.get("pid")),
                   _number(facts.get("begun")))

    def as_dict(self) -> dict[str, Any]:
        """The process in plain types."""
        return self._asdict()

    def is_alive(self) -> bool | None:
        """Whether it still runs; None where that cannot be seen from here."""
        if (self.host, self.space) != (socket.gethostname(), _space()):
            return None
        return is_process_alive(self.pid) and _begun(self.pid) == self.begun

    def __str__(self) -> str:
        return f"process {self.pid} on {self.host or 'an unknown machine'}"


def age_of(path: Path) -> float:
    """Seconds since a file was written or touched, by the clock of the machine that holds it; 0 when it is gone."""
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
    """When a process began (field 22 of /proc/PID/stat); 0 where that is not told."""
    try:
        text = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8", errors="replace")
    except OSError:
        return 0
    return int(text.rpartition(")")[2].split()[19])


def _number(value: Any) -> int:
    return value if isinstance(value, int) else 0
