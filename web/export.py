"""The page's models: everything that a first frame goes through, as one ONNX file for each size and
look.

python web/export.py FOLDER

`denoise.s.1x.onnx`, `denoise.m.2x.onnx` and so on hold a network and the portable kernels around
it, in the order of `postfx.passes.denoise.network`. They read the planes of a frame without a
history and give its clean colour; any ONNX Runtime runs them, for frames of any size.
`look.NAME.onnx` is a look that depends on colour alone.
"""

from __future__ import annotations

import itertools
import sys
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

from postfx.kernels.denoise import FEATURES, HIDDEN
from postfx.passes.denoise.geometry import PYRAMID_LEVELS
from postfx.passes.denoise.models import (
    UNSCALED,
    doubts_planes,
    exact,
    grid_of,
    load_network,
    model_of,
)
from postfx.passes.denoise.network import FEATURE_PARTS, alike_heads, free_dimensions
from postfx.passes.tonemap import find_tone_mapper, shaper
from postfx.runtime import Device
from postfx.system import models_dir

PLANES = {"colour": 3, "diffuse_albedo": 3, "specular_albedo": 3, "normal": 3, "roughness": 1,
          "depth": 1, "motion": 2}
"""Inputs of a denoiser, (h, w, channels)."""
LOOKS = ("aces2", "agx", "pbr_neutral")
NETWORKS = ("s", "m")
SCALES = (1, 2)
OPSET = 20


class Graph:
    """An ONNX graph that is put together from operators and from whole models, by the names of
    their tensors."""

    def __init__(self) -> None:
        self._nodes: list[onnx.NodeProto] = []
        self._constants: dict[str, onnx.TensorProto] = {}
        self._count = 0

    def op(self, kind: str, *inputs: str, outputs: int = 1, **attributes: object) -> str:
        """Add an operator; returns its first output."""
        self._count += 1
        names = [f"{kind}_{self._count}_{i}" for i in range(outputs)]
        self._nodes.append(helper.make_node(kind, inputs, names, **attributes))
        return names[0]

    def constant(self, values: object, dtype: type = np.int64) -> str:
        """A constant array."""
        array = np.array(values, dtype)
        name = f"constant {dtype.__name__} {array.tolist()}"  # one for each value
        self._constants[name] = numpy_helper.from_array(array, name)
        return name

    def call(self, path: Path, **inputs: str) -> dict[str, str]:
        """Add a model, its inputs bound by name; returns its outputs by name. Inputs that it does
        not have are left."""
        model = onnx.load(path)
        assert not model.functions
        self._count += 1
        rename = {value.name: inputs[value.name]
                  for value in model.graph.input if value.name in inputs}

        def name_of(name: str) -> str:
            return rename.setdefault(name, f"{path.stem}_{self._count}/{name}") if name else ""

        for tensor in model.graph.initializer:
            copy = onnx.TensorProto()
            copy.CopyFrom(tensor)
            copy.name = name_of(tensor.name)
            self._constants[copy.name] = copy
        for node in model.graph.node:
            copy = onnx.NodeProto()
            copy.CopyFrom(node)
            for graph in (attribute for attribute in copy.attribute
                          if attribute.type == onnx.AttributeProto.GRAPH):
                raise ValueError(f"{path}: {graph.name}: graphs in attributes are not handled")
            copy.name = ""
            copy.input[:], copy.output[:] = map(name_of, node.input), map(name_of, node.output)
            self._nodes.append(copy)
        return {value.name: rename[value.name] for value in model.graph.output}

    def save(self, path: Path, inputs: Mapping[str, list[int | str]], output: str,
             shape: list[int | str]) -> None:
        """Write the model; its output is called 'output'."""
        self._nodes.append(helper.make_node("Identity", [output], ["output"]))
        values = [helper.make_tensor_value_info(name, TensorProto.FLOAT, size)
                  for name, size in inputs.items()]
        result = helper.make_tensor_value_info("output", TensorProto.FLOAT, shape)
        graph = helper.make_graph(self._nodes, path.stem, values, [result],
                                  [*self._constants.values()])
        model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", OPSET)],
                                  ir_version=10)
        onnx.checker.check_model(model)
        onnx.save(model, path)


class Places:
    """What the kernels read beside the planes: sizes, and which pixels a row or column means, made
    in the graph."""

    def __init__(self, graph: Graph, colour: str, scale: int, grid: int) -> None:
        self._graph = graph
        size = graph.op("Shape", colour)
        sides = [graph.op("Gather", size, graph.constant(axis)) for axis in (0, 1)]
        self.sides = sides
        self.outputs = [graph.op("Mul", side, graph.constant(scale)) for side in sides]
        self.padded = [graph.op("Mul", self._divided(side, grid), graph.constant(grid))
                       for side in sides]

    def counted(self, side: str, times: int = 1, over: int = 1) -> str:
        """0, 1, ... before `side`, in floats, times a number or divided by one and rounded down."""
        graph = self._graph
        numbers = graph.op("Range", graph.constant(0), side, graph.constant(1))
        numbers = graph.op("Div", graph.op("Mul", numbers, graph.constant(times)),
                           graph.constant(over))
        return graph.op("Cast", numbers, to=TensorProto.FLOAT)

    def mirrored(self, axis: int) -> str:
        """Rows or columns of the padded frame: beyond the frame they go on as in a mirror."""
        graph, one = self._graph, self._graph.constant(1.0, np.float32)
        last = graph.op("Sub", graph.op("Cast", self.sides[axis], to=TensorProto.FLOAT), one)
        beyond = graph.op("Abs", graph.op("Sub", self.counted(self.padded[axis]), last))
        return graph.op("Max", graph.op("Sub", last, beyond), graph.constant(0.0, np.float32))

    def level(self, axis: int, i: int) -> str:
        """Side of a pyramid level. Those that a network does not compute may end in half a cell."""
        return self._divided(self.padded[axis], 2**i)

    def area(self, i: int) -> str:
        """Rows and columns of a pyramid level that lie in the frame."""
        return self.floats(self._divided(side, 2**i) for side in self.sides)

    def alike(self, values: np.ndarray, i: int) -> str:
        """A head of one value for all pixels, (1, channels, 1, 1), at each pixel of a pyramid
        level."""
        graph, axis = self._graph, self._graph.constant([0])
        sides = [graph.op("Unsqueeze", self.level(axis_of, i), axis) for axis_of in (0, 1)]
        shape = graph.op("Concat", graph.constant(values.shape[:2]), *sides, axis=0)
        return graph.op("Expand", graph.constant(values, np.float32), shape)

    def _divided(self, side: str, by: int) -> str:
        """A side divided by a number, rounded up."""
        graph = self._graph
        return graph.op("Div", graph.op("Add", side, graph.constant(by - 1)), graph.constant(by))

    def window(self) -> str:
        """The whole frame, as the kernels' `window`."""
        nothing = [self._graph.constant(0)] * 2
        return self.floats([*nothing, *self.sides, *nothing, *self.outputs])

    def floats(self, numbers: object) -> str:
        """Scalars as an array of floats."""
        graph, axis = self._graph, self._graph.constant([0])
        rows = [graph.op("Unsqueeze", number, axis) for number in numbers]  # type: ignore[attr-defined]
        return graph.op("Cast", graph.op("Concat", *rows, axis=0), to=TensorProto.FLOAT)

    def zeros(self, sides: list[str], channels: int) -> str:
        """(rows, columns, channels) of 0."""
        graph, axis = self._graph, self._graph.constant([0])
        shape = [graph.op("Unsqueeze", side, axis) for side in sides]
        shape = graph.op("Concat", *shape, graph.constant([channels]), axis=0)
        return graph.op("ConstantOfShape", shape,
                        value=helper.make_tensor("", TensorProto.FLOAT, [1], [0.0]))


def save_denoiser(path: Path, tag: str, scale: int) -> None:
    """Write a denoiser for first frames, of 1x or 2x their size."""
    graph, models = Graph(), models_dir()
    network = model_of(exact(tag), UNSCALED if scale == 1 else "")
    grid = grid_of([network])
    places = Places(graph, "colour", scale, grid)
    rows, columns = (places.counted(side) for side in places.sides)
    common = {name: name for name in (*PLANES, "params")} | {
        "window": places.window(), "part_rows": rows, "part_columns": columns,
        "seen_rows": places.mirrored(0),
        "seen_columns": places.mirrored(1), "keep": places.zeros([graph.constant(1)] * 2, 1),
        "means": places.zeros([graph.constant(1)] * 2, 3),
        "state": places.zeros(places.sides, 4 + HIDDEN),
        "last_depth": places.zeros(places.sides, 1), "warped": places.zeros(places.outputs, 3)}

    def kernel(name: str, **inputs: str) -> dict[str, str]:
        return graph.call(models / "kernels" / f"denoise_{name}.onnx", **{**common, **inputs})

    def channels(tensor: str, first: int, end: int, axis: int) -> str:
        return graph.op("Slice", tensor, graph.constant([first]), graph.constant([end]),
                        graph.constant([axis]))

    common |= kernel("scale")
    common |= kernel("dilate")
    common |= kernel("features")
    ends = np.cumsum([0, *FEATURE_PARTS.values()])
    assert ends[-1] == FEATURES
    parts = {name: channels(common["features"], first, end, 1)
             for name, first, end in zip(FEATURE_PARTS, ends, ends[1:], strict=False)}
    heads = graph.call(models / f"{network}.onnx", **parts)
    state = load_network(Device("cpu"), network, free_dimensions((grid, grid)))
    for name, values in alike_heads(state).items():
        heads[name] = places.alike(values, int(name[-1]))
    doubts = doubts_planes(network)
    if doubts:
        common |= kernel("means")
    common |= kernel("open_phased", phased_fine=heads["phased_fine"])
    common |= (found := kernel("accumulate"))
    levels, importance = [channels(found["level"], 0, 3, 0)], channels(found["level"], 3, 4, 0)
    for i in range(1, PYRAMID_LEVELS + 1):
        finer = [places.counted(places.level(axis, i), times=2) for axis in (0, 1)]
        found = kernel("pool", finer=levels[-1], finer_importance=importance, finer_rows=finer[0],
                       finer_columns=finer[1])
        levels.append(found["level"])
        importance = found["importance"]
    filtered = ""
    for i in range(PYRAMID_LEVELS, -1, -1):
        head = common["fine"] if i == 0 else heads[f"level{i}"]
        mixed = levels[i]
        if i < PYRAMID_LEVELS:
            coarse = [places.counted(places.level(axis, i), over=2) for axis in (0, 1)]
            mixed = kernel("mix", coarse=filtered, level=levels[i], heads=head,
                           coarse_rows=coarse[0], coarse_columns=coarse[1])["mixed"]
        filtered = kernel("filter", mixed=mixed, heads=head, area=places.area(i))["filtered"]
    last = (("remodulate_both", "upsample_unscaled") if doubts and scale == 1
            else ("remodulate", "upsample"))
    output = kernel(last[1], **kernel(last[0], filtered=filtered))["output"]
    inputs: dict[str, list[int | str]] = {name: ["height", "width", count]
                                          for name, count in PLANES.items()}
    graph.save(path, inputs | {"params": [4]}, output, ["output_height", "output_width", 3])


def save_look(path: Path, tag: str) -> None:
    """Write a look: scene-linear colour (h, w, 3) and an exposure (1,) in, sRGB code values from 0
    to 1 out."""
    graph, (library, model) = Graph(), find_tone_mapper(tag)
    cube = graph.call(models_dir() / f"{model}.onnx")["cube"]
    shape = shaper(library, model)
    params = graph.op("Concat", "exposure", graph.constant([shape.toe, shape.scale], np.float32),
                      axis=0)
    matrix = graph.constant(shape.matrix, np.float32)
    shown = graph.call(models_dir() / "kernels" / "apply_cube.onnx", colour="colour", params=params,
                       matrix=matrix, cube=cube)["output"]
    size: list[int | str] = ["height", "width", 3]
    graph.save(path, {"colour": size, "exposure": [1]}, shown, size)


def main(folder: Path) -> None:
    """Write all models of the page."""
    folder.mkdir(parents=True, exist_ok=True)
    for tag, scale in itertools.product(NETWORKS, SCALES):
        save_denoiser(folder / f"denoise.{tag}.{scale}x.onnx", tag, scale)
    for tag in LOOKS:
        save_look(folder / f"look.{tag}.onnx", tag)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
