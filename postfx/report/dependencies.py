"""Who wrote what a command reads, by the addresses in a capture."""

from __future__ import annotations

from typing import Any

from postfx.runtime.memory import Ranges


def edges(commands: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Edges {'from', 'to', 'tensor'}: command `from` was the last to write memory that command `to` reads.

    Args:
        commands: in the order of commit, as in `postfx.report.capture_data`.

    `from` is None where something that is read was written by no command before: an input, or history.
    """
    found = []
    for number, command in enumerate(commands):
        for tensor in command["reads"]:
            for writer in _writers(tensor["address"], commands[:number]):
                found.append({"from": writer, "to": command["index"], "tensor": tensor["name"]})
    return found


def _writers(address: list[int], earlier: list[dict[str, Any]]) -> list[int | None]:
    """Commands that wrote the bytes last, latest first."""
    start, end = address
    left, writers = Ranges(((start, end),) if start < end else ()), []
    for command in reversed(earlier):
        for tensor in command["writes"]:
            start, end = tensor["address"]
            if left.touches(Ranges(((start, end),))):
                left.remove(start, end)
                writers.append(command["index"])
    return writers + ([None] if left.spans else [])
