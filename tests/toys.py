"""Tiny networks, kernels and passes to test the runtime and the pipeline with."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

from postfx.frame import GUIDE_ROLES, Frame, FrameSpec, Role
from postfx.kernels import Kernel
from postfx.passes import Pass, Reflection, ResidentFrame
from postfx.runtime import ArgumentTable, CommandBuffer, Device, Library

IMAGE = ("height", "width", "channels")


def value(name: str, shape: tuple[Any, ...], kind: int = TensorProto.FLOAT) -> onnx.ValueInfoProto:
    """A graph input or output."""
    return helper.make_tensor_value_info(name, kind, shape)


def save_model(path: Path, nodes: list[Any], inputs: list[Any], outputs: list[Any],
               constants: dict[str, Any] | None = None) -> None:
    """Write an ONNX file of a few nodes."""
    initializers = [numpy_helper.from_array(array, name)
                    for name, array in (constants or {}).items()]
    graph = helper.make_graph(nodes, path.stem, inputs, outputs, initializers)
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    onnx.checker.check_model(model, full_check=True)
    path.write_bytes(model.SerializeToString())


def make_library(folder: Path) -> Library:
    """Networks 'double' (y = 2 x, with a card), 'pair' (total = a + b) and 'pick', which fails on
    an index over 2."""
    rows = (1, "height", "width")
    x, y = value("x", rows), value("y", rows)
    save_model(folder / "double.onnx", [helper.make_node("Add", ["x", "x"], ["y"])], [x], [y])
    card = {"name": "double",
            "sha256": hashlib.sha256((folder / "double.onnx").read_bytes()).hexdigest()}
    (folder / "double.json").write_text(json.dumps(card))
    a, b, total = value("a", rows), value("b", rows), value("total", rows)
    save_model(folder / "pair.onnx", [helper.make_node("Add", ["a", "b"], ["total"])], [a, b],
               [total])
    index, picked = value("index", (1,), TensorProto.INT64), value("picked", (1,))
    table = {"table": np.array([10, 20, 30], np.float32)}
    gather = helper.make_node("Gather", ["table", "index"], ["picked"])
    save_model(folder / "pick.onnx", [gather], [index], [picked], table)
    return Library(folder)


def make_deep(folder: Path, depth: int = 40) -> Library:
    """The networks of `make_library`, and 'deep', which takes long for its few pixels: x and y (1,
    512, 256)."""
    weights = np.random.default_rng(0).normal(0, 0.06, (32, 32, 3, 3)).astype(np.float32)
    nodes = [helper.make_node("Reshape", ["x", "image"], ["at 0"])]
    for i in range(depth):
        nodes += [helper.make_node("Conv", [f"at {i}", "weights"], [f"sum {i}"], pads=[1] * 4),
                  helper.make_node("Tanh", [f"sum {i}"], [f"at {i + 1}"])]
    nodes.append(helper.make_node("Reshape", [f"at {depth}", "plane"], ["y"]))
    shapes = {"image": np.array([1, 32, 64, 64]), "plane": np.array([1, 512, 256])}
    library = make_library(folder)
    save_model(folder / "deep.onnx", nodes, [value("x", (1, 512, 256))],
               [value("y", (1, 512, 256))], {"weights": weights, **shapes})
    return library


def make_kernels(folder: Path) -> Library:
    """Portable definitions of `ADD` and `TWICE_AS_LARGE`."""
    image, fine = value("a", IMAGE), value("fine", (None, None, None))
    nodes = [helper.make_node("Add", ["a", "b"], ["total"])]
    save_model(folder / "add.onnx", nodes, [image, value("b", IMAGE)], [value("total", IMAGE)])
    scales = {"scales": np.array([2, 2, 1], np.float32)}
    resize = helper.make_node(
        "Resize", ["coarse", "", "scales"], ["fine"], mode="nearest", nearest_mode="floor",
        coordinate_transformation_mode="asymmetric",
    )
    save_model(folder / "twice_as_large.onnx", [resize], [value("coarse", IMAGE)], [fine], scales)
    return Library(folder)


def add_rows(y0: int, y1: int, a: np.ndarray, b: np.ndarray, total: np.ndarray) -> None:
    """total = a + b."""
    np.add(a[y0:y1], b[y0:y1], out=total[y0:y1])


def large_rows(y0: int, y1: int, coarse: np.ndarray, fine: np.ndarray) -> None:
    """Every pixel four times."""
    fine[y0:y1] = coarse[np.arange(y0, y1)[:, None] // 2, np.arange(fine.shape[1]) // 2]


ADD = Kernel("add", ("a", "b"), ("total",), add_rows, ("total", 0),
             {"a": IMAGE, "b": IMAGE, "total": IMAGE})
TWICE_AS_LARGE = Kernel(
    "twice_as_large", ("coarse",), ("fine",), large_rows, ("fine", 0),
    {"coarse": IMAGE, "fine": ("2*height", "2*width", "channels")},
)


class Double(Pass):
    """Doubles colour by a network of the `library`, `times` times over."""

    name = "double"
    defaults = {"library": None, "times": 1}

    def reflect(self, spec: FrameSpec) -> Reflection:
        return Reflection(reads=(Role.COLOUR,), writes=(Role.COLOUR,), output=spec)

    def skip(self, spec: FrameSpec) -> str | None:
        return "times is 0" if self.options["times"] == 0 else None

    def compile(self, device: Device, spec: FrameSpec) -> None:
        super().compile(device, spec)
        dims = {"height": spec.height, "width": 3 * spec.width}
        self._state = device.pipeline_state(self.options["library"], "double", dims)
        shape = (spec.height, spec.width, 3)
        self._results = [device.heap.tensor(f"doubled {i}", shape)
                         for i in range(self.options["times"])]

    def encode(self, commands: CommandBuffer, frame: ResidentFrame) -> None:
        super().encode(commands, frame)
        flat = (1, frame.spec.height, 3 * frame.spec.width)
        with commands.machine_learning_encoder("network") as encoder:
            encoder.barrier(after=("compute", "machine-learning"), before="machine-learning")
            for result in self._results:
                tensors = {"x": frame[Role.COLOUR].view("x", flat), "y": result.view("y", flat)}
                encoder.dispatch_network(self._state, ArgumentTable(self._state, tensors))
                encoder.barrier()
                frame.set(Role.COLOUR, result)


class Sum(Pass):
    """Adds up colour over all frames since the last reset: a pass with history."""

    name = "sum"

    def reflect(self, spec: FrameSpec) -> Reflection:
        return Reflection(reads=(Role.COLOUR,), writes=(Role.COLOUR,), output=spec,
                          may_read=(Role.REACTIVE,))

    def reset(self) -> None:
        self._fresh = True

    def compile(self, device: Device, spec: FrameSpec) -> None:
        super().compile(device, spec)
        self._state = device.compute_state(ADD)
        self._sums = [device.heap.tensor(f"sum {i}", (spec.height, spec.width, 3))
                      for i in range(2)]

    def encode(self, commands: CommandBuffer, frame: ResidentFrame) -> None:
        super().encode(commands, frame)
        old, new = self._sums
        if self._fresh:
            old.fill(0.0)
        table = ArgumentTable(self._state, {"a": frame[Role.COLOUR], "b": old, "total": new})
        with commands.compute_encoder("add") as encoder:
            encoder.barrier(after=("compute", "machine-learning"), before="compute")
            encoder.dispatch(self._state, table)
        frame.set(Role.COLOUR, new)
        self._sums, self._fresh = [new, old], False


class Enlarge(Pass):
    """Twice the size by repetition; only colour exists afterwards."""

    name = "enlarge"

    def reflect(self, spec: FrameSpec) -> Reflection:
        output = FrameSpec(2 * spec.width, 2 * spec.height, (Role.COLOUR,), spec.encoding)
        return Reflection(reads=(Role.COLOUR, Role.DEPTH), writes=(Role.COLOUR,), output=output)

    def compile(self, device: Device, spec: FrameSpec) -> None:
        super().compile(device, spec)
        self._state = device.compute_state(TWICE_AS_LARGE)
        self._fine = device.heap.tensor("fine", (2 * spec.height, 2 * spec.width, 3))

    def encode(self, commands: CommandBuffer, frame: ResidentFrame) -> None:
        super().encode(commands, frame)
        with commands.compute_encoder("repeat") as encoder:
            encoder.barrier(after=("compute", "machine-learning"), before="compute")
            table = ArgumentTable(self._state, {"coarse": frame[Role.COLOUR], "fine": self._fine})
            encoder.dispatch(self._state, table)
        frame.set(Role.COLOUR, self._fine)
        frame.jitter = (0.0, 0.0)


class AddGuide(Enlarge):
    """Twice the size by repetition, plus the guides' albedo where there is one."""

    name = "add_guide"

    def reflect(self, spec: FrameSpec) -> Reflection:
        output = FrameSpec(2 * spec.width, 2 * spec.height, (Role.COLOUR,), spec.encoding)
        guides = (Role.DIFFUSE_ALBEDO,)
        return Reflection(reads=(Role.COLOUR,), writes=(Role.COLOUR,), output=output,
                          may_read_guides=guides)

    def compile(self, device: Device, spec: FrameSpec) -> None:
        super().compile(device, spec)
        self._add = device.compute_state(ADD)
        self._sum = device.heap.tensor("sum", self._fine.shape)

    def encode(self, commands: CommandBuffer, frame: ResidentFrame) -> None:
        super().encode(commands, frame)
        if Role.DIFFUSE_ALBEDO in frame.guides:
            tensors = {"a": self._fine, "b": frame.guides[Role.DIFFUSE_ALBEDO], "total": self._sum}
            with commands.compute_encoder("add") as encoder:
                encoder.barrier(after="compute", before="compute")
                encoder.dispatch(self._add, ArgumentTable(self._add, tensors))
            frame.set(Role.COLOUR, self._sum)


def make_frame(number: int = 1, size: tuple[int, int] = (24, 40),
               roles: tuple[Role, ...] = (Role.COLOUR,), **kept: Any) -> Frame:
    """A frame of random planes; size is (width, height)."""
    width, height = size
    spec = FrameSpec(width, height, roles)
    random = np.random.default_rng(number)
    planes = {role: random.random((height, width, channels), np.float32)
              for role, channels in spec.planes}
    return Frame(planes, number=number, **kept)


def make_guides(size: tuple[int, int],
                roles: tuple[Role, ...] = GUIDE_ROLES) -> dict[Role, np.ndarray]:
    """Random guides; size is (width, height)."""
    return make_frame(100, size, roles).planes
