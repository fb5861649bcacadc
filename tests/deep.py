"""A network with constants, a skip connection and a node that makes NaN, and one of any length."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from onnx import TensorProto, helper

from postfx.runtime import ArgumentTable, Capture, Device, Library
from tests.toys import save_model, value

LEVEL = 0.5


def make_deep(folder: Path, level: float = LEVEL) -> Library:
    """Network 'deep': relu = max(0, sum of x over 3x3 and both channels), y = relu + sqrt(relu -
    level)."""
    nodes = [
        helper.make_node("Cast", ["stem.weight_half"], ["stem.weight"], to=TensorProto.FLOAT),
        helper.make_node("Conv", ["x", "stem.weight"], ["conv"], "first", kernel_shape=[3, 3],
                         pads=[1, 1, 1, 1]),
        helper.make_node("Relu", ["conv"], ["relu"]),
        helper.make_node("Sub", ["relu", "level"], ["above"]),
        helper.make_node("Sqrt", ["above"], ["root"]),
        helper.make_node("Add", ["relu", "root"], ["y"]),
    ]
    weights = {"stem.weight_half": np.ones((4, 2, 3, 3), np.float16),
               "level": np.array([level], np.float32)}
    shapes = (1, 2, "height", "width"), (1, 4, "height", "width")
    folder.mkdir(parents=True, exist_ok=True)
    save_model(folder / "deep.onnx", nodes, [value("x", shapes[0])], [value("y", shapes[1])],
               weights)
    return Library(folder)


def make_long(folder: Path, count: int) -> Library:
    """Network 'long' of `count` nodes, with a skip connection over every ten of them."""
    nodes, kept = [], "x"
    for n in range(count):
        last = "x" if n == 0 else f"v{n - 1}"
        skips = n % 10 == 9
        nodes.append(helper.make_node("Add" if skips else "Neg", [last, kept] if skips else [last],
                                      [f"v{n}"], f"n{n}"))
        kept = f"v{n}" if skips else kept
    folder.mkdir(parents=True, exist_ok=True)
    save_model(folder / "long.onnx", nodes, [value("x", (4,))], [value(f"v{count - 1}", (4,))])
    return Library(folder)


def capture_deep(library: Library, x: np.ndarray | float = 1.0,
                 **options: Any) -> tuple[Capture, np.ndarray]:
    """A capture of 'deep' on x (1, 2, 4, 5), and y."""
    device = Device("cpu", threads=1)
    state = device.pipeline_state(library, "deep", {"height": 4, "width": 5})
    source = device.wrap("picture", np.full((1, 2, 4, 5), x, np.float32))
    y = device.heap.tensor("y", (1, 4, 4, 5))
    commands = device.command_buffer("frame 1")
    with commands.machine_learning_encoder("deep") as encoder:
        encoder.dispatch_network(state, ArgumentTable(state, {"x": source, "y": y}))
    with device.capture(**options) as capture:
        commands.commit()
        commands.wait(10)
    return capture, y.array.copy()
