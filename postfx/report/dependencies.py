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
    left, writers = Ranges((tuple(address),) if address[0] < address[1] else ()), []
    for command in reversed(earlier):
        for tensor in command["writes"]:
            if left.touches(Ranges((tuple(tensor["address"]),))):
                left.remove(*tensor["address"])
                writers.append(command["index"])
    return writers + ([None] if left.spans else [])
