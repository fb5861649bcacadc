"""Captures in plain types, as in capture.json; edges between commands that share data; differences
of two captures."""

from __future__ import annotations

import math
import os
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from postfx.errors import CompareError, ReadError
from postfx.files import parse_json, read_text
from postfx.runtime.capture import Capture, largest_error
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

CAPTURE_FORMAT = "postfx capture 1"
CAPTURE_FILE = "capture.json"


def as_dict(capture: Capture) -> dict[str, Any]:
    """The capture in JSON's types, without pictures; numbers that are not finite become text.

    'commands' are all dispatches in order; 'buffers' have the order of dispatches and barriers;
    'edges' say which command wrote the data that another one reads (see `edges`). Times are
    milliseconds, memory bytes.
    """
    commands = [
        _command(dispatch, number) for number, buffer in enumerate(capture.buffers)
        for dispatch in buffer.dispatches
    ]
    return {
        "format": CAPTURE_FORMAT,
        "postfx": __version__,
        "device": {"name": capture.device.name, "threads": capture.device.threads},
        "tensors": capture.tensors,
        "buffers": [_buffer(buffer) for buffer in capture.buffers],
        "commands": commands,
        "edges": edges(commands),
    }


def read(path: str | Path) -> tuple[dict[str, Any], Path]:
    """Read a capture.json, given as a file or its folder; returns it and the folder. Raises
    ReadError."""
    file = Path(path)
    file = file / CAPTURE_FILE if os.path.isdir(file) else file
    try:
        data = parse_json(read_text(file))
    except (OSError, ValueError) as error:
        why = getattr(error, "strerror", None) or error
        raise ReadError(f"capture '{file}' cannot be read: {why}: give a folder that "
                        "postfx run --capture wrote") from error
    if not isinstance(data, dict) or data.get("format") != CAPTURE_FORMAT:
        raise ReadError(f"'{file}' is not a capture by this version of postfx: make one with "
                        "postfx run --capture")
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
    return {"difference": finite_or_text(network.difference),
            "nodes": [_node(node) for node in network.nodes]}


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
    plain = {"name": tensor.name, "shape": list(tensor.shape), "dtype": tensor.dtype,
             "bytes": tensor.nbytes}
    if tensor.snapshot is None:
        return plain
    figures = {name: finite_or_text(value)
               for name, value in asdict(tensor.snapshot.statistics).items()}
    known = tensor.snapshot.values
    values = None if known is None else [finite_or_text(value) for value in known]
    kept = {"statistics": figures, "channels": tensor.snapshot.channels, "values": values}
    return {**plain, **kept, "file": tensor.snapshot.file}


def _buffer(buffer: CapturedBuffer) -> dict[str, Any]:
    heap = {"used": buffer.heap_used, "peak": buffer.heap_peak, "size": buffer.heap_size}
    return {"label": buffer.label, "heap": heap,
            "records": [_record(record) for record in buffer.records]}


def _record(record: CapturedDispatch | CapturedBarrier) -> dict[str, Any]:
    if isinstance(record, CapturedDispatch):
        return {"dispatch": record.index}
    masks = {"after": list(record.after), "before": list(record.before)}
    return {"barrier": record.form, "encoder": record.encoder, **masks}


def edges(commands: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Edges {'from', 'to', 'tensor'}: command `from` was the last to write memory that command `to`
    reads.

    Args:
        commands: in the order of commit, as in `postfx.tools.report.capture_data`.

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


Tensor = dict[str, Any]
"""A tensor's entry in capture.json."""


@dataclass(frozen=True)
class Difference:
    """A tensor in both captures.

    Attributes:
        index, label, command: the command's, as in the first capture.
        access: 'input' for a tensor from outside, 'node' for the output of a network's node,
            'write' for the output of the command.
        node: "node 12 Conv 'name'"; None except for nodes.
        error: the largest relative error, see `compare`; infinite if one value is finite and the
            other is not.
        place: index of the element with that error; () for a tensor of one element.
    """

    index: int
    label: str
    command: str
    access: str
    tensor: str
    error: float
    place: tuple[int, ...]
    node: str | None = None


@dataclass(frozen=True)
class Comparison:
    """All tensors in the order in which commands used them; `first` is the first one over the
    tolerance, or None."""

    tolerance: float
    differences: list[Difference]
    first: Difference | None

    def as_dict(self) -> dict[str, Any]:
        """In plain types; an infinite error is the text 'inf'."""
        rows = [_plain(difference) for difference in self.differences]
        return {"tolerance": self.tolerance, "first": _plain(self.first) if self.first else None,
                "tensors": rows}


def compare(a: str | Path, b: str | Path, tolerance: float = 1e-3) -> Comparison:
    """Compare two captures that kept all of their tensors (tensors='all'), command by command in
    order.

    If both captured nodes of a network (network=True), its nodes come before the output of the
    command.

    The relative error of an element is |a - b| / max(|b|, mean of |b| over the tensor): b is the
    reference, and elements near 0 are compared with the tensor's mean size. NaN equals NaN, and
    infinities of one sign are equal.

    Args:
        a, b: capture.json files or their folders.

    Raises CompareError when commands or tensors do not correspond or content was not kept,
    ReadError when a file cannot be read.
    """
    (first, first_folder), (second, second_folder) = read(a), read(b)
    if len(first["commands"]) != len(second["commands"]):
        counts = f"{len(first['commands'])} and {len(second['commands'])}"
        raise CompareError(f"the captures have {counts} commands: capture the same passes, options "
                           "and frame")
    differences = []
    for one, other in zip(first["commands"], second["commands"], strict=True):
        for access, node, left, right in _pairs(one, other):
            arrays = _load(first_folder, left), _load(second_folder, right)
            names = one["index"], one["label"], one["command"], access, left["name"]
            differences.append(Difference(*names, *largest_error(*arrays), node))
    over = (difference for difference in differences if difference.error > tolerance)
    return Comparison(tolerance, differences, next(over, None))


def _pairs(one: dict[str, Any],
           other: dict[str, Any]) -> Iterator[tuple[str, str | None, Tensor, Tensor]]:
    """Tensors to compare: inputs whose content both captures have, nodes if both have them, and all
    outputs."""
    where = f"command {one['index']} '{one['label']}'"
    if (one["label"], one["stage"]) != (other["label"], other["stage"]):
        raise CompareError(f"{where} is '{other['label']}' in the other capture: capture the same "
                           "passes and options")
    for access, key in (("input", "reads"), ("write", "writes")):
        mine, theirs = one[key], other[key]
        if [_shape(tensor) for tensor in mine] != [_shape(tensor) for tensor in theirs]:
            remedy = "compare frames of one size and one model"
            raise CompareError(f"{where} {key} other tensors in the other capture: {remedy}")
        for left, right in zip(mine, theirs, strict=True):
            if left["bytes"] and (access == "write" or (left.get("file") and right.get("file"))):
                yield access, None, left, right
        if access == "input" and one["network"] and other["network"]:
            yield from _node_pairs(where, one["network"]["nodes"], other["network"]["nodes"])


def _node_pairs(
    where: str, mine: list[dict[str, Any]], theirs: list[dict[str, Any]]
) -> Iterator[tuple[str, str, Tensor, Tensor]]:
    """Outputs of nodes, except constants, up to the first node that failed in either capture."""
    failed = any(node["error"] for node in (*mine, *theirs))
    pairs = [pair for pair in zip(mine, theirs, strict=False)
             if not (pair[0]["error"] or pair[1]["error"])]
    if (any(_kind(one) != _kind(other) for one, other in pairs)
        or (len(mine) != len(theirs) and not failed)):
        raise CompareError(f"{where} has other nodes in the other capture: compare frames of one "
                           "size and one network")
    for one, other in pairs:
        name = f"node {one['index']} {one['op']}" + (f" '{one['name']}'" if one["name"] else "")
        for left, right in zip(one["outputs"], other["outputs"], strict=True):
            if left["bytes"] and not one["constant"]:
                yield "node", name, left, right


def _kind(node: dict[str, Any]) -> tuple[str, list[tuple[str, list[int]]]]:
    return node["op"], [_shape(value) for value in node["outputs"]]


def _shape(tensor: dict[str, Any]) -> tuple[str, list[int]]:
    return tensor["name"], tensor["shape"]


def _load(folder: Path, tensor: dict[str, Any]) -> np.ndarray:
    """The content of a captured tensor. CompareError where it was not kept, ReadError for a file
    that does not fit."""
    if not tensor.get("file"):
        command = "postfx run --capture DIR --capture-tensors all"
        raise CompareError(f"capture in '{folder}' has no content of tensor '{tensor['name']}': "
                           f"make it with {command}")
    try:
        array: np.ndarray = np.load(folder / tensor["file"], mmap_mode="r", allow_pickle=False)
    except (OSError, ValueError) as error:
        raise ReadError(f"tensor file '{folder / tensor['file']}' cannot be read: "
                        f"{error}") from error
    if list(array.shape) != tensor["shape"]:
        raise ReadError(f"tensor file '{folder / tensor['file']}' is {array.shape}, not "
                        f"{tuple(tensor['shape'])}")
    return array


def _plain(difference: Difference) -> dict[str, Any]:
    error = difference.error if math.isfinite(difference.error) else "inf"
    return {**asdict(difference), "error": error, "place": list(difference.place)}
