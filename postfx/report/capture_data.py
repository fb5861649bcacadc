"""A capture in plain types, as in capture.json, and the edges between commands that share data."""

from __future__ import annotations

import math
from dataclasses import asdict
from pathlib import Path
from typing import Any

from postfx.errors import ReadError
from postfx.files import parse_json, read_text
from postfx.runtime.capture import Capture
from postfx.runtime.memory import Ranges
from postfx.runtime.snapshot import (
    CapturedBarrier,
    CapturedBuffer,
    CapturedDispatch,
    CapturedNetwork,
    CapturedNode,
    CapturedTensor,
    CapturedValue,
)
from postfx.version import __version__

FORMAT = "postfx capture 1"
FILE = "capture.json"


def as_dict(capture: Capture) -> dict[str, Any]:
    """The capture in JSON's types, without pictures; non-finite numbers are text.

    'commands' are all dispatches in order; 'buffers' have the order of dispatches and barriers; 'edges' say which
    command wrote the data that another one reads (see `edges`). Times are milliseconds, memory bytes.
    """
    commands = [
        _command(dispatch, number) for number, buffer in enumerate(capture.buffers) for dispatch in buffer.dispatches
    ]
    return {
        "format": FORMAT,
        "postfx": __version__,
        "device": {"name": capture.device.name, "threads": capture.device.threads},
        "tensors": capture.tensors,
        "buffers": [_buffer(buffer) for buffer in capture.buffers],
        "commands": commands,
        "edges": edges(commands),
    }


def read(path: str | Path) -> tuple[dict[str, Any], Path]:
    """Read a capture.json, given as a file or its folder; returns it and the folder. Raises ReadError."""
    file = Path(path)
    file = file / FILE if file.is_dir() else file
    try:
        data = parse_json(read_text(file))
    except (OSError, ValueError) as error:
        raise ReadError(f"capture '{file}' cannot be read: {error}") from error
    if not isinstance(data, dict) or data.get("format") != FORMAT:
        raise ReadError(f"'{file}' is not a capture by this version of postfx: make one with postfx run --capture")
    return data, file.parent


def _command(dispatch: CapturedDispatch, buffer: int) -> dict[str, Any]:
    return {
        "index": dispatch.index,
        "buffer": buffer,
        "label": dispatch.label,
        "command": dispatch.command,
        "stage": dispatch.stage,
        "encoder": dispatch.encoder,
        "ms": dispatch.milliseconds,
        "error": dispatch.error,
        "model": str(dispatch.model) if dispatch.model else None,
        "dims": dispatch.dims,
        "reads": [_tensor(tensor) for tensor in dispatch.reads],
        "writes": [_tensor(tensor) for tensor in dispatch.writes],
        "network": _network(dispatch.network) if dispatch.network else None,
    }


def _network(network: CapturedNetwork) -> dict[str, Any]:
    return {"difference": finite_or_text(network.difference), "nodes": [_node(node) for node in network.nodes]}


def _node(node: CapturedNode) -> dict[str, Any]:
    return {
        "index": node.index,
        "op": node.op,
        "name": node.name,
        "constant": node.constant,
        "ms": node.milliseconds,
        "error": node.error,
        "outputs": [_value(value) for value in node.outputs],
    }


def _tensor(tensor: CapturedTensor) -> dict[str, Any]:
    return {**_value(tensor), "address": [tensor.start, tensor.end]}


def _value(tensor: CapturedValue) -> dict[str, Any]:
    plain = {"name": tensor.name, "shape": list(tensor.shape), "dtype": tensor.dtype, "bytes": tensor.nbytes}
    if tensor.snapshot is None:
        return plain
    figures = {name: finite_or_text(value) for name, value in asdict(tensor.snapshot.statistics).items()}
    known = tensor.snapshot.values
    values = None if known is None else [finite_or_text(value) for value in known]
    kept = {"statistics": figures, "channels": tensor.snapshot.channels, "values": values}
    return {**plain, **kept, "file": tensor.snapshot.file}


def _buffer(buffer: CapturedBuffer) -> dict[str, Any]:
    heap = {"used": buffer.heap_used, "peak": buffer.heap_peak, "size": buffer.heap_size}
    return {"label": buffer.label, "heap": heap, "records": [_record(record) for record in buffer.records]}


def _record(record: CapturedDispatch | CapturedBarrier) -> dict[str, Any]:
    if isinstance(record, CapturedDispatch):
        return {"dispatch": record.index}
    masks = {"after": list(record.after), "before": list(record.before)}
    return {"barrier": record.form, "encoder": record.encoder, **masks}


def edges(commands: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Edges {'from', 'to', 'tensor'}: command `from` was the last to write memory that command `to` reads.

    Args:
        commands: in the order of commit, as in `postfx.report.capture_data`.

    `from` is None if no earlier command wrote the data: an input, or history.
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


def finite_or_text(value: float | int | None) -> float | int | str | None:
    """The number; NaN and infinities, which JSON lacks, as text."""
    return str(value) if isinstance(value, float) and not math.isfinite(value) else value
