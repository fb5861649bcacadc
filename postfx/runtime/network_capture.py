"""What happened inside a network: its nodes run one by one on what the network read."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from postfx.runtime.captured import CapturedNetwork, CapturedNode, CapturedValue
from postfx.runtime.difference import largest_error
from postfx.runtime.nodes import NodeRun, run_nodes
from postfx.runtime.records import Dispatch
from postfx.runtime.session import Placement
from postfx.runtime.snapshot import Snapshot, content

Keep = Callable[[np.ndarray, str, bool], Snapshot | None]
"""Keeps what it is to of an array; given a name for files, and whether only figures are wanted."""


def look_inside(dispatch: Dispatch, placement: Placement, keep: Keep, ran: bool) -> CapturedNetwork:
    """Run the nodes of a dispatch's network; `ran` tells whether the network itself has written its outputs.

    Checks no hazards: the caller stands between two commands of the queue.
    """
    bindings = dispatch.state.bindings
    inputs = _named(bindings, "read", dispatch.reads)
    written = _named(bindings, "write", dispatch.writes) if ran else {}
    found, errors = CapturedNetwork(), []
    for node in run_nodes(dispatch.model, placement, inputs):
        found.nodes.append(_captured(node, keep))
        errors += [largest_error(written[n], array)[0] for n, array in node.outputs.items() if n in written]
    if errors and not any(node.error for node in found.nodes):
        found.difference = max(errors)
    return found


def _captured(node: NodeRun, keep: Keep) -> CapturedNode:
    values = [
        CapturedValue(name, array.shape, array.dtype.name, array.nbytes,
                      snapshot=keep(array, f"n{node.index:04d}.{name}", node.constant))
        for name, array in node.outputs.items()
    ]
    return CapturedNode(node.index, node.op, node.name, node.constant, node.milliseconds, node.error, values)


def _named(bindings: tuple, access: str, tensors: tuple) -> dict[str, np.ndarray]:
    names = [binding.name for binding in bindings if binding.access == access]
    return {name: content(tensor) for name, tensor in zip(names, tensors, strict=True) if tensor.nbytes}
