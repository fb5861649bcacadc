"""Finds the first tensor in which two captures of the same commands differ."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from postfx.errors import CompareError, ReadError
from postfx.report.capture_data import read
from postfx.runtime.capture import largest_error

Tensor = dict[str, Any]
"""A tensor's entry in capture.json."""


@dataclass(frozen=True)
class Difference:
    """A tensor in both captures.

    Attributes:
        index, label, command: of the command, as in the first capture.
        access: 'input' for a tensor from outside, 'node' for the output of a network's node, 'write' for the output of
            the command.
        node: "node 12 Conv 'name'"; None except for nodes.
        error: the largest relative error, see `compare`; infinite if one value is finite and the other is not.
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
    """All tensors in the order in which commands used them; `first` is the first one over the tolerance, or None."""

    tolerance: float
    differences: list[Difference]
    first: Difference | None

    def as_dict(self) -> dict[str, Any]:
        """In plain types; an infinite error is the text 'inf'."""
        rows = [_plain(difference) for difference in self.differences]
        return {"tolerance": self.tolerance, "first": _plain(self.first) if self.first else None, "tensors": rows}


def compare(a: str | Path, b: str | Path, tolerance: float = 1e-3) -> Comparison:
    """Compare two captures that kept all of their tensors (tensors='all'), command by command in order.

    If both captured nodes of a network (network=True), its nodes come before the output of the command.

    The relative error of an element is |a - b| / max(|b|, mean of |b| over the tensor): b is the reference, and
    elements near 0 are compared with the tensor's mean size. NaN equals NaN, and infinities of one sign are equal.

    Args:
        a, b: capture.json files or their folders.

    Raises CompareError when commands or tensors do not correspond or content was not kept, ReadError when a file
    cannot be read.
    """
    (first, first_folder), (second, second_folder) = read(a), read(b)
    if len(first["commands"]) != len(second["commands"]):
        counts = f"{len(first['commands'])} and {len(second['commands'])}"
        raise CompareError(f"the captures have {counts} commands: capture the same passes, options and frame")
    differences = []
    for one, other in zip(first["commands"], second["commands"], strict=True):
        for access, node, left, right in _pairs(one, other):
            arrays = _load(first_folder, left), _load(second_folder, right)
            names = one["index"], one["label"], one["command"], access, left["name"]
            differences.append(Difference(*names, *largest_error(*arrays), node))
    over = (difference for difference in differences if difference.error > tolerance)
    return Comparison(tolerance, differences, next(over, None))


def _pairs(one: dict[str, Any], other: dict[str, Any]) -> Iterator[tuple[str, str | None, Tensor, Tensor]]:
    """Tensors to compare: inputs whose content both captures have, nodes if both have them, and all outputs."""
    where = f"command {one['index']} '{one['label']}'"
    if (one["label"], one["stage"]) != (other["label"], other["stage"]):
        raise CompareError(f"{where} is '{other['label']}' in the other capture: capture the same passes and options")
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
    pairs = [pair for pair in zip(mine, theirs, strict=False) if not (pair[0]["error"] or pair[1]["error"])]
    if any(_kind(one) != _kind(other) for one, other in pairs) or (len(mine) != len(theirs) and not failed):
        raise CompareError(f"{where} has other nodes in the other capture: compare frames of one size and one network")
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
    if not tensor.get("file"):
        command = "postfx run --capture DIR --capture-tensors all"
        raise CompareError(f"capture in '{folder}' has no content of tensor '{tensor['name']}': make it with {command}")
    try:
        array: np.ndarray = np.load(folder / tensor["file"], mmap_mode="r", allow_pickle=False)
    except (OSError, ValueError) as error:
        raise ReadError(f"tensor file '{folder / tensor['file']}' cannot be read: {error}") from error
    if list(array.shape) != tensor["shape"]:
        raise ReadError(f"tensor file '{folder / tensor['file']}' is {array.shape}, not {tuple(tensor['shape'])}")
    return array


def _plain(difference: Difference) -> dict[str, Any]:
    error = difference.error if math.isfinite(difference.error) else "inf"
    return {**asdict(difference), "error": error, "place": list(difference.place)}
