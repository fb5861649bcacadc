"""Make the float16 variant of a denoised upscaler, for GPUs: a small file that shares the weights
of the float32 one.

    python -m training.denoise.fp16 denoise_upscale.m
    python -m training.denoise.fp16 denoise_upscale.m.guides
    python -m training.denoise.fp16 denoise_upscale.m.1x
    python -m training.denoise.fp16 denoise_upscale.xl.1x

The exported network stores its weights in half precision and casts them. Here the arithmetic is in
half precision, too, and weights are references into that file (ONNX external data), which must lie
beside this one. Inputs are packed and heads raw (see below); all work on colour stays float32. A
network that gives the picture keeps its inputs and outputs (`fp16_picture.py`). It is not faster on
a CPU.
"""

from __future__ import annotations

import argparse
import hashlib
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import onnxruntime
from onnx import GraphProto, NodeProto, TensorProto, helper, numpy_helper

from postfx.kernels.denoise.network_io import (
    OPEN,
    OPEN_FINE,
    OPEN_PHASED,
    PACK,
    opened_shape,
    width,
)
from postfx.passes.denoise.network import (
    CHANNELS,
    FEATURE_PARTS,
    PACKED,
    PHASED_FINE,
    PICTURE,
    RAW,
)
from postfx.runtime import Library
from training.denoise.fp16_picture import halve_picture
from training.denoise.quantise import variant_name
from training.export import (
    MODELS,
    ParityError,
    drop_unused,
    known_recipe,
    lower_constants,
    relative_error,
    write_card,
    write_model,
)

# The graph ----------------------------------------------------------------------------------------
# The graph of a denoised upscaler in half precision.
#
# Tensor cores need the channels of a pixel together and their number a multiple of 8. So the
# network begins with packed inputs and ends with raw heads (`postfx.kernels.denoise.network_io` has
# the kernels); ONNX Runtime then has nothing to transpose, pad or cast between its convolutions.

CHANNELS_FIRST, CHANNELS_LAST = (0, 3, 1, 2), (0, 2, 3, 1)


def halve(model: onnx.ModelProto) -> onnx.ModelProto:
    """The GPU form of a network as `export` writes it, with weights in half precision and a
    cast."""
    model = onnx.ModelProto.FromString(model.SerializeToString())
    graph = model.graph
    alike = alike_of(graph)
    _use_stored_weights(graph)
    _narrow(graph, alike)
    _join_features(graph)
    heads = [value if value.name in alike else _leave_raw(graph, value.name)
             for value in graph.output]
    reads = [name for name in CHANNELS if any(name in node.input for node in graph.node)]
    inputs = [_take_packed(graph, name, CHANNELS[name]) for name in reads]
    del graph.output[:], graph.input[:]
    graph.output.extend(heads)
    graph.input.extend(inputs)
    drop_unused(graph)
    onnx.checker.check_model(model)
    return model


def alike_of(graph: GraphProto) -> set[str]:
    """Names of constant outputs: heads that are the same at all pixels. They stay float32."""
    return {value.name for value in graph.output} & {weight.name for weight in graph.initializer}


def computed_levels(graph: GraphProto) -> int:
    """Levels of the pyramid whose heads a network computes."""
    return sum("level" in value.name for value in graph.output) - len(alike_of(graph))


def _use_stored_weights(graph: GraphProto) -> None:
    """Let nodes read weights as they are stored, without casts."""
    weights = {weight.name for weight in graph.initializer}
    casts = [node for node in graph.node if node.op_type == "Cast" and node.input[0] in weights]
    renamed = {cast.output[0]: cast.input[0] for cast in casts}
    for node in casts:
        graph.node.remove(node)
    for node in graph.node:
        node.input[:] = [renamed.get(name, name) for name in node.input]


def _narrow(graph: GraphProto, kept: set[str]) -> None:
    """Store the remaining float32 weights in half precision, except some and the scales of a
    Resize."""
    kept = kept | {name for node in graph.node if node.op_type == "Resize"
                   for name in node.input[1:]}
    for weight in graph.initializer:
        if weight.data_type == TensorProto.FLOAT and weight.name not in kept:
            weight.CopyFrom(numpy_helper.from_array(_array(weight).astype(np.float16), weight.name))


def _join_features(graph: GraphProto) -> None:
    """Replace the convolutions of the features' two parts and their sum by one convolution."""
    first, last = (next(node for node in graph.node if part in node.input)
                   for part in FEATURE_PARTS)
    total = next(node for node in graph.node if {*first.output, *last.output} == {*node.input})
    weights = [_array(_weight(graph, node.input[1])) for node in (first, last)]
    _add_weight(graph, "stem.weight", np.concatenate(weights, 1))
    first.input[:2] = ["features", "stem.weight"]
    first.output[:] = total.output
    graph.node.remove(last)
    graph.node.remove(total)


def _leave_raw(graph: GraphProto, head: str) -> onnx.ValueInfoProto:
    """Add the output of a head's convolution, channels last, without activation; returns the new
    output."""
    made = {name: node for node in graph.node for name in node.output}
    fine = head == PHASED_FINE
    inputs, weight, bias = (_phases if fine else _last_convolution)(graph, head, made)
    raw, missing = f"{RAW}{'fine' if fine else head}", width(len(bias)) - len(bias)
    _add_weight(graph, f"{raw}_weight", np.pad(weight, [(0, missing), (0, 0), (0, 0), (0, 0)]))
    _add_weight(graph, f"{raw}_bias", np.pad(bias, (0, missing)))
    graph.node.append(helper.make_node("Conv", [inputs, f"{raw}_weight", f"{raw}_bias"],
                                       [f"{raw}_first"]))
    graph.node.append(helper.make_node("Transpose", [f"{raw}_first"], [raw], perm=CHANNELS_LAST))
    return helper.make_tensor_value_info(raw, TensorProto.FLOAT16,
                                         [1, None, None, width(len(bias))])


def _last_convolution(graph: GraphProto, head: str,
                      made: dict[str, NodeProto]) -> tuple[str, np.ndarray, np.ndarray]:
    """Input, weight and bias of the 1x1 convolution that makes a head."""
    node = made[head]
    while node.op_type != "Conv":
        node = made[node.input[0]]
    return (node.input[0], _array(_weight(graph, node.input[1])),
            _array(_weight(graph, node.input[2])))


def _phases(graph: GraphProto, head: str,
            made: dict[str, NodeProto]) -> tuple[str, np.ndarray, np.ndarray]:
    """Input, weight and bias of the 1x1 convolution that makes the fine head, whose channels are
    grouped by phase."""
    inputs, weight, bias = _last_convolution(graph, head, made)
    rows = np.arange(len(bias)).reshape(-1, 4).T.ravel()
    return inputs, weight[rows], bias[rows]


def _take_packed(graph: GraphProto, name: str, channels: int) -> onnx.ValueInfoProto:
    """Let convolutions of an input read it channels last and filled up with zeros; returns the new
    input."""
    packed, wide = f"{PACKED}{name}", width(channels)
    for node in (node for node in graph.node if name in node.input):
        filled = np.pad(_array(_weight(graph, node.input[1])),
                        [(0, 0), (0, wide - channels), (0, 0), (0, 0)])
        _add_weight(graph, f"{node.input[1]}_filled", filled)
        node.input[:2] = [f"{packed}_first", f"{node.input[1]}_filled"]
    graph.node.insert(0, helper.make_node("Transpose", [packed], [f"{packed}_first"],
                                          perm=CHANNELS_FIRST))
    return helper.make_tensor_value_info(packed, TensorProto.FLOAT16, [1, "height", "width", wide])


def _add_weight(graph: GraphProto, name: str, value: np.ndarray) -> None:
    graph.initializer.append(numpy_helper.from_array(np.ascontiguousarray(value, np.float16), name))


def _weight(graph: GraphProto, name: str) -> TensorProto:
    return next(weight for weight in graph.initializer if weight.name == name)


def _array(weight: TensorProto) -> np.ndarray:
    return numpy_helper.to_array(weight)


# The command --------------------------------------------------------------------------------------

PRECISION = "fp16"
SHARED = 1024
"""Weights of at least so many bytes become references."""
TOLERANCE = 0.01
"""Largest difference to the float32 network, relative to the largest value of an output."""


def share_weights(model: onnx.ModelProto, file: Path) -> None:
    """Replace weights by references to a file beside the model's that holds the same bytes."""
    content = file.read_bytes()
    for weight in model.graph.initializer:
        offset, length = content.find(weight.raw_data), len(weight.raw_data)
        if length >= SHARED and offset >= 0:
            weight.ClearField("raw_data")
            weight.data_location = TensorProto.EXTERNAL
            for key, value in (("location", file.name), ("offset", offset), ("length", length)):
                weight.external_data.add(key=key, value=str(value))


def make_fp16(name: str, folder: Path) -> dict[str, Any]:
    """Write the float16 variant of a folder's network and its card beside it; returns the card.
    Raises ParityError."""
    library = Library(folder)
    source, path = library.path(name), folder / f"{variant_name(name, PRECISION)}.onnx"
    whole = lower_constants(onnx.load(source))
    model = halve_picture(whole) if is_picture(whole) else halve(whole)
    error = difference(model, whole)
    share_weights(model, source)
    write_model(model, path)
    card = {**library.card(name), "name": path.stem, "tag": path.stem.split(".", 1)[1],
            "precision": PRECISION,
            "weights": {source.name: hashlib.sha256(source.read_bytes()).hexdigest()},
            "parity": {"max_relative_error": float(f"{error:.2g}"),
                       "against": f"{name} in float32"}}
    if not is_picture(whole):
        align = 2 ** computed_levels(model.graph)
        alike = {output: told
                 for output, told in card.get("outputs", {}).items() if told.get("constant")}
        card |= {"inputs": _listed(model.graph.input, align),
                 "outputs": _listed(model.graph.output, align) | alike}
    for other in ("quality", "recipe"):  # measured in float32; of the float32 network
        card.pop(other, None)
    step = {"run": f"training.denoise.fp16 {name} --models {{models}}"}
    usual = {"recipe": {"base": name, "steps": [step]}}
    write_card(path, card | (known_recipe(path.with_suffix(".json")) or usual))
    return card


def is_picture(model: onnx.ModelProto) -> bool:
    """Whether a network gives the picture itself."""
    return any(value.name == PICTURE for value in model.graph.output)


def _listed(values: Iterable[onnx.ValueInfoProto], align: int) -> dict[str, Any]:
    meaning = ("float16, channels last, see postfx/kernels/denoise/network_io.py; height and "
               f"width multiples of {align}")
    sizes = {value.name: [dim.dim_value or dim.dim_param or "?"
                          for dim in value.type.tensor_type.shape.dim]
             for value in values}
    return {name: {"shape": size, "meaning": meaning} for name, size in sizes.items()}


def difference(model: onnx.ModelProto, wanted: onnx.ModelProto,
               size: tuple[int, int] = (64, 96)) -> float:
    """Largest difference of two networks' heads relative to the largest value; raises ParityError
    above TOLERANCE.

    Measured on the CPU, which computes half precision in float32: rounding inside the network is
    not included.
    """
    random = np.random.default_rng(0)
    reads = {value.name: random.random(
        (1, value.type.tensor_type.shape.dim[1].dim_value, *size), np.float32
    ) * 2 - 0.5 for value in wanted.graph.input}
    if is_picture(wanted):
        packed = reads
    else:
        whole = {"features": np.concatenate([reads[part] for part in FEATURE_PARTS], 1), **reads}
        packed = {f"{PACKED}{name}": pack(value)
                  for name, value in whole.items() if name not in FEATURE_PARTS}
    found = [open_head(name.removeprefix(RAW), head) if name.startswith(RAW) else head
             for name, head in _run(model, packed).items()]
    exact = [open_phases(head) if name == PHASED_FINE else head
             for name, head in _run(wanted, reads).items()]
    worst = max(relative_error(mine[:, :value.shape[1]], value)
                for mine, value in zip(found, exact, strict=True))
    if not worst <= TOLERANCE:
        raise ParityError(f"half precision differs by {worst:.2g} of the largest value: the limit "
                          f"is {TOLERANCE:g}")
    return worst


def pack(planes: np.ndarray) -> np.ndarray:
    """Planes (1, channels, height, width) in the layout that a network in half precision reads."""
    _, channels, height, columns = planes.shape
    packed = np.empty((1, height, columns, width(channels)), np.float16)
    PACK.rows(0, height, planes, packed)
    return packed


def open_head(name: str, raw: np.ndarray) -> np.ndarray:
    """A head from a raw one."""
    heads = np.empty(opened_shape(name, *raw.shape[1:3]), np.float32)
    kernel = OPEN_FINE if name == "fine" else OPEN
    kernel.rows(0, heads.shape[2], raw, heads)
    return heads


def open_phases(phased: np.ndarray) -> np.ndarray:
    """The fine head in float32 from its phases."""
    fine = np.empty(opened_shape("fine", *phased.shape[2:]), np.float32)
    OPEN_PHASED.rows(0, fine.shape[2], phased, fine)
    return fine


def _run(model: onnx.ModelProto, reads: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    session = onnxruntime.InferenceSession(model.SerializeToString(),
                                           providers=["CPUExecutionProvider"])
    names = [value.name for value in session.get_outputs()]
    return dict(zip(names, session.run(names, dict(reads)), strict=True))


def options() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("name",
                        help="model of the folder, as denoise_upscale.m or denoise_upscale.m.1x")
    parser.add_argument("--models", type=Path, default=MODELS, metavar="FOLDER",
                        help="where it is, and where to write")
    return parser


def main() -> None:
    args = options().parse_args()
    card = make_fp16(args.name, args.models)
    path = args.models / f"{card['name']}.onnx"
    error = card["parity"]["max_relative_error"]
    print(f"{path}: {path.stat().st_size} bytes; largest relative error to float32: {error}")


if __name__ == "__main__":
    main()
