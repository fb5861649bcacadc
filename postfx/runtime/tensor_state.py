"""What may be done with a tensor now: the one source of the checks when the host touches it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

from postfx.errors import CommandError, HazardError


class Use(NamedTuple):
    """A command that uses a tensor: labels of its encoder and command buffer, and what it runs."""

    label: str
    command: str
    buffer: str

    def __str__(self) -> str:
        return f"'{self.label}' ({self.command}) of '{self.buffer}'"


@dataclass(frozen=True)
class TensorState:
    """The state of a tensor, from `Tensor.state`. A command is in flight from commit until the host waited for it.

    Attributes:
        released: its memory was given back.
        defined: every byte holds data, or will once the committed commands have run.
        writer: the last command in flight that writes it.
        reader: the last command in flight that reads it.
        recorded: the first command that uses it and is recorded, but not committed.
        failed: the error of the command whose failure left it undefined.
        gone: why a transient tensor's content is no longer there, as a clause.
    """

    released: bool
    defined: bool
    writer: Use | None
    reader: Use | None
    recorded: Use | None
    failed: CommandError | None
    gone: str | None = None

    @property
    def kind(self) -> str:
        """'released', 'being written', 'being read', 'defined' or 'undefined': the first that holds."""
        if self.released:
            return "released"
        if self.writer or self.reader:
            return "being written" if self.writer else "being read"
        return "defined" if self.defined else "undefined"

    def __str__(self) -> str:
        user = self.writer or self.reader
        return f"{self.kind} by {user}" if user and not self.released else self.kind


def check_host_read(name: str, state: TensorState) -> None:
    """HazardError when the tensor was released, a command in flight writes it, or it holds no data (any more)."""
    _check_alive(name, state)
    if state.gone:
        message = f"transient '{name}' is read by the host, but {state.gone}"
        raise HazardError(message, "read before write", name, None, "host")
    if state.writer:
        raise _in_use(name, "reads", state.writer, "writes")
    if state.failed:
        message = f"'{name}' is read by the host, but {state.failed}: commit that again, or upload to '{name}'"
        raise HazardError(message, "read before write", name, state.failed.label, "host")
    if not state.defined:
        message = f"'{name}' is read by the host, but no command wrote it and nothing was uploaded to it"
        raise HazardError(message, "read before write", name, None, "host")


def check_host_write(name: str, state: TensorState) -> None:
    """HazardError when the tensor was released, or a command in flight or recorded uses it."""
    _check_alive(name, state)
    if state.writer:
        raise _in_use(name, "writes", state.writer, "writes")
    if state.reader:
        raise _in_use(name, "writes", state.reader, "reads")
    if state.recorded:
        mend = "it runs after commit and would see the new values, so upload before recording, to a tensor of its own"
        message = f"the host writes '{name}' while {state.recorded} uses it: {mend}"
        raise HazardError(message, "host access", name, state.recorded.label, "host")


def _check_alive(name: str, state: TensorState) -> None:
    if state.released:
        raise HazardError(f"tensor '{name}' was released: make a new one", "released", name, None, "host")


def _in_use(name: str, verb: str, use: Use, does: str) -> HazardError:
    message = f"the host {verb} '{name}' while {use} {does} it: wait() for '{use.buffer}' first"
    return HazardError(message, "host access", name, use.label, "host")
