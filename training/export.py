"""Shared parts of all exports to ONNX: one clean file a model, a card beside it, and a check
against torch."""

from __future__ import annotations

import argparse
import base64
import hashlib
import json
import logging
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import onnxruntime
import torch
from torch import nn
from torch.export import Dim

from postfx.kernels import Kernel
from postfx.runtime.session import CONSTANTS
from postfx.runtime.states import parse

# it warns of optional packages at every export
logging.getLogger("torch.onnx").setLevel(logging.ERROR)

OPSET = 20  # the first with 5-D GridSample
MODELS = Path(__file__).resolve().parent.parent / "models"
LARGE = 1024  # smaller weights are not worth a cast
PARITY = 1e-3  # largest accepted difference to torch, relative to the largest value


class ParityError(RuntimeError):
    """An exported model does not compute what torch computes."""


Axes = Mapping[int, Any] | None
"""Axes of free size."""


def export(
    module: nn.Module,
    examples: Sequence[torch.Tensor],
    reads: Sequence[str],
    writes: Sequence[str],
    path: Path,
    free: Sequence[Axes | tuple[Axes, ...]] | None = None,
    names: Mapping[str, tuple[int | str, ...]] | None = None,
) -> onnx.ModelProto:
    """Write one ONNX file without traces of the machine it was made on.

    Args:
        free: for each example its axes of free size, as in `torch.export`'s `dynamic_shapes`; those
            of a module that takes them as *examples are one tuple.
        names: input or output -> shape to declare, if the exporter's own names of free sizes do not
            suit; shape inference finds a size of '?'.
    """
    program = torch.onnx.export(
        module.eval(),
        tuple(examples),
        input_names=list(reads),
        output_names=list(writes),
        opset_version=OPSET,
        dynamo=True,
        dynamic_shapes=None if free is None else tuple(free),
        verbose=False,
    )
    model = program.model_proto
    strip(model)
    store_half(model.graph)
    for value in (*model.graph.input, *model.graph.output):
        declare(value, (names or {}).get(value.name))
    onnx.checker.check_model(model)
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(model.SerializeToString(deterministic=True))
    print(f"{path}: {len(model.graph.node)} nodes, {path.stat().st_size} bytes")
    return model


def export_kernel(kernel: Kernel, module: nn.Module, sizes: Mapping[str, int],
                  folder: Path) -> None:
    """Write a kernel's portable definition, free in every size that the kernel names by a symbol.

    Args:
        module: takes the kernel's reads and returns its writes, both in the kernel's order.
        sizes: values of the symbols to trace with; sizes that need not be equal should differ.
    """
    shapes = [[parse(size) for size in kernel.shapes[name]] for name in kernel.reads]
    random = torch.Generator().manual_seed(0)
    examples = [torch.rand(*[d.factor * (sizes.get(d.symbol, 1) if d.symbol else 1)
                          for d in dims], generator=random)
                .to(getattr(torch, kernel.types.get(name, "float32")))
                for name, dims in zip(kernel.reads, shapes, strict=True)]
    free = [{axis: Dim.DYNAMIC for axis, d in enumerate(dims) if d.symbol is not None}
            for dims in shapes]
    names = {name: tuple(size if isinstance(size, int) else "?" for size in kernel.shapes[name])
             for name in kernel.reads + kernel.writes}
    export(module, examples, kernel.reads, kernel.writes, folder / f"{kernel.name}.onnx", free,
           names)


def strip(model: onnx.ModelProto) -> None:
    """Remove the exporter's stack traces and notes."""
    del model.metadata_props[:]
    del model.graph.metadata_props[:]
    del model.graph.value_info[:]
    for item in [*model.graph.node, *model.graph.input, *model.graph.output,
                 *model.graph.initializer]:
        del item.metadata_props[:]
        item.doc_string = ""


def store_half(graph: onnx.GraphProto) -> None:
    """Store weights in half precision if it holds them exactly: half the file. A session casts them
    on loading."""
    casts = []
    for weight in graph.initializer:
        values = onnx.numpy_helper.to_array(weight)
        if values.dtype != np.float32 or values.size < LARGE:
            continue
        half = values.astype(np.float16)
        if np.array_equal(half.astype(np.float32), values):
            name = weight.name
            weight.CopyFrom(onnx.numpy_helper.from_array(half, f"{name}_half"))
            casts.append(onnx.helper.make_node("Cast", [f"{name}_half"], [name],
                                               to=onnx.TensorProto.FLOAT))
    nodes = [*casts, *graph.node]
    del graph.node[:]
    graph.node.extend(nodes)


def lift_constants(model: onnx.ModelProto) -> None:
    """Move outputs that no node makes into the metadata, from which `postfx.runtime.session` reads
    them: some execution providers do not support such outputs."""
    graph = model.graph
    weights = {one.name: one for one in graph.initializer}
    used = {name for node in graph.node for name in node.input}
    lifted = {one.name: onnx.numpy_helper.to_array(weights[one.name])
              for one in graph.output if one.name in weights}
    if not lifted:
        return
    text = json.dumps({name: {"shape": array.shape,
                              "float32": base64.b64encode(array.astype("<f4").tobytes()).decode()}
                       for name, array in lifted.items()})
    onnx.helper.set_model_props(model, {CONSTANTS: text})
    for name in lifted:
        graph.output.remove(next(one for one in graph.output if one.name == name))
        if name not in used:
            graph.initializer.remove(weights[name])


def lower_constants(model: onnx.ModelProto) -> onnx.ModelProto:
    """Give a model its constant outputs again, to convert it or to look at them; the same model."""
    for text in [one.value for one in model.metadata_props if one.key == CONSTANTS]:
        for name, told in json.loads(text).items():
            array = np.frombuffer(base64.b64decode(told["float32"]), "<f4").reshape(told["shape"])
            if name not in {one.name for one in model.graph.initializer}:
                model.graph.initializer.append(onnx.numpy_helper.from_array(array, name))
            model.graph.output.append(onnx.helper.make_tensor_value_info(
                name, onnx.TensorProto.FLOAT, told["shape"]
            ))
    del model.metadata_props[:]
    return model


def write_model(model: onnx.ModelProto, path: Path) -> None:
    """Write a model file with its constants in the metadata."""
    lift_constants(model)
    path.write_bytes(model.SerializeToString(deterministic=True))


def declare(value: onnx.ValueInfoProto, shape: tuple[int | str, ...] | None) -> None:
    """Give an input or output another declared shape; None leaves it as it is."""
    for size, dimension in zip(shape or (), value.type.tensor_type.shape.dim, strict=bool(shape)):
        dimension.Clear()
        if isinstance(size, int):
            dimension.dim_value = size
        elif size != "?":
            dimension.dim_param = size


def parity(
    module: nn.Module, path: Path, examples: Sequence[torch.Tensor],
    dims: Mapping[str, int] | None = None
) -> float:
    """Largest difference of an exported model to torch, relative to the largest value of the same
    output.

    `dims` fixes free sizes by name, as the run-time does. Raises ParityError above `PARITY`.
    """
    options = onnxruntime.SessionOptions()
    for name, size in (dims or {}).items():
        options.add_free_dimension_override_by_name(name, size)
    whole = lower_constants(onnx.load(path)).SerializeToString()
    session = onnxruntime.InferenceSession(whole, options, providers=["CPUExecutionProvider"])
    names = [value.name for value in session.get_inputs()]
    found = session.run(None, {name: x.numpy() for name, x in zip(names, examples, strict=True)})
    with torch.no_grad():
        wanted = module.eval()(*examples)
    wanted = wanted if isinstance(wanted, tuple) else (wanted,)
    worst = max(relative_error(a, b.numpy()) for a, b in zip(found, wanted, strict=True))
    if not worst <= PARITY:
        raise ParityError(f"{path} differs from torch by {worst:.2g} of the largest value: the "
                          f"limit is {PARITY:g}")
    return worst


def relative_error(found: np.ndarray, wanted: np.ndarray) -> float:
    """Largest absolute difference over the largest wanted value; infinite when shapes differ."""
    if found.shape != wanted.shape:
        return float("inf")
    return float(np.abs(found - wanted).max() / max(np.abs(wanted).max(), 1e-12))


def write_card(path: Path, card: Mapping[str, Any]) -> None:
    """Write the card of a model file beside it, with the file's hash."""
    complete = {**card, "sha256": hashlib.sha256(path.read_bytes()).hexdigest(), "opset": OPSET}
    first = ("name", "pass", "tag", "summary", "sha256", "opset")
    ordered = {key: complete[key] for key in (*first, *complete) if key in complete}
    path.with_suffix(".json").write_text(json.dumps(ordered, indent=2) + "\n")


RECIPE = {"base": str, "steps": list, "differs": list, "not recorded": list, "scale": float}


def check_recipe(recipe: object) -> str | None:
    """The mistake in a card's recipe, or None; `training.remake` explains its keys."""
    if not isinstance(recipe, dict):
        return "no recipe: an object with 'steps' is expected"
    for key, value in recipe.items():
        if not isinstance(value, RECIPE.get(key, ())):
            return f"recipe: '{key}' is not one of {', '.join(RECIPE)}, or has a wrong type"
    steps = recipe.get("steps") or []
    if not steps or not all(map(_is_step, steps)):
        return ("recipe: 'steps' is a list of objects with 'run', a module and its arguments, and "
                "perhaps 'processes'")
    return None


def _is_step(step: object) -> bool:
    """Whether an entry of a recipe's steps has all that a step needs, and nothing else."""
    if not isinstance(step, dict) or not set(step) <= {"run", "processes"}:
        return False
    run = step.get("run")
    return isinstance(run, str) and bool(run.strip()) and isinstance(step.get("processes", 1), int)


def known_recipe(card: Path) -> dict[str, Any]:
    """{"recipe": ...} of a card that will be replaced, or {} if it has none."""
    recipe = json.loads(card.read_text()).get("recipe") if card.exists() else None
    return {"recipe": recipe} if recipe else {}


def read_quality(path: str | None) -> dict[str, Any]:
    """Measured quality to keep in a card, from a JSON file."""
    return json.loads(Path(path).read_text()) if path else {}


def parser(doc: str | None, tag: str) -> argparse.ArgumentParser:
    """Command line shared by all exports."""
    made = argparse.ArgumentParser(description=doc,
                                   formatter_class=argparse.RawDescriptionHelpFormatter)
    made.add_argument("checkpoint", type=Path, nargs="?",
                      help="without one, only the kernels are exported")
    made.add_argument("--tag", default=tag,
                      help=f"name of the model among its kind; default: {tag}")
    made.add_argument("--quality", help="JSON of measured quality, kept in the card")
    made.add_argument("--models", type=Path, default=MODELS, help="folder to write to")
    made.add_argument("--network-only", action="store_true", help="leave the kernels as they are")
    return made


# Steps that rewrite a graph -----------------------------------------------------------------------

def append_node(made: list[onnx.NodeProto], kind: str, inputs: list[str], output: str,
                **attributes: object) -> str:
    """Append a node with one output, whose name is returned."""
    made.append(onnx.helper.make_node(kind, inputs, [output], name=f"node_{output}", **attributes))
    return output


def add_constant(graph: onnx.GraphProto, name: str, array: np.ndarray) -> None:
    """Give a graph a constant, unless it has one of that name."""
    if all(weight.name != name for weight in graph.initializer):
        graph.initializer.append(onnx.numpy_helper.from_array(np.array(array, order="C"), name))


def constant_value(graph: onnx.GraphProto, name: str) -> np.ndarray:
    """Values of a constant, which may be stored in half precision with a cast."""
    cast = next((node for node in graph.node if node.op_type == "Cast" and node.output[0] == name),
                None)
    stored = cast.input[0] if cast else name
    return onnx.numpy_helper.to_array(next(weight for weight in graph.initializer
                                           if weight.name == stored))


def drop_unused(graph: onnx.GraphProto) -> None:
    """Keep only nodes and weights that outputs need."""
    needed, nodes = {value.name for value in graph.output}, []
    for one in reversed(graph.node):
        if needed & set(one.output):
            nodes.append(one)
            needed |= set(one.input)
    replace_nodes(graph, nodes[::-1])
    weights = [weight for weight in graph.initializer if weight.name in needed]
    del graph.initializer[:]
    graph.initializer.extend(weights)


def replace_nodes(graph: onnx.GraphProto, nodes: list[onnx.NodeProto]) -> None:
    """Replace all nodes of a graph; some of the new ones may be its own."""
    nodes = [onnx.NodeProto.FromString(one.SerializeToString()) for one in nodes]
    del graph.node[:]
    graph.node.extend(nodes)
