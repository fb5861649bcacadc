"""Waiting with a time-out, and what is said when it is over."""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import TYPE_CHECKING

from postfx.errors import CommandError, CommandTimeout

if TYPE_CHECKING:
    from postfx.runtime.commands import CommandBuffer

NAMED = 4
"""Most waiting command buffers that a message names."""


def wait_for_all(name: str, flying: Sequence[CommandBuffer], timeout: float | None) -> None:
    """Wait for all buffers, in order; when some failed, the first one's error is raised in the end.

    Args:
        name: what was to become idle, for the message.
        timeout: seconds for all together; None waits without limit.
    """
    deadline = None if timeout is None else time.monotonic() + timeout
    first: CommandError | None = None
    for commands in flying:
        left = None if deadline is None else max(0.0, deadline - time.monotonic())
        if not commands.finished(left):
            raise timed_out(f"{name} was not idle after {timeout:g} s", flying)
        try:
            commands.wait()
        except CommandError as error:
            first = first or error
    if first is not None:
        raise first


def timed_out(what: str, flying: Sequence[CommandBuffer]) -> CommandTimeout:
    """An error that names the command that runs now and the buffers that wait behind it."""
    buffers = [commands for commands in flying if not commands.finished()]
    if not buffers:
        return CommandTimeout(f"{what}, but it is done now", None, ())
    dispatch, labels = buffers[0].running, tuple(commands.label for commands in buffers[1:])
    running = f"{dispatch} of '{buffers[0].label}' is running" if dispatch else f"'{buffers[0].label}' is about to run"
    return CommandTimeout(f"{what}: {running}{_behind(labels)}", dispatch.label if dispatch else None, labels)


def _behind(labels: tuple[str, ...]) -> str:
    if not labels:
        return ""
    named = ", ".join(f"'{label}'" for label in labels[:NAMED])
    more = f" and {len(labels) - NAMED} more" if len(labels) > NAMED else ""
    return f"; behind it wait {named}{more}"
