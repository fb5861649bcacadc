"""Make the float16 variant of a denoised upscaler, for GPUs: a small file that shares the weights of the float32 one.

    python -m training.halve denoise_upscale.m
    python -m training.halve denoise_upscale.m.guides

The exported network keeps its weights in half precision and casts them; here the arithmetic is in half precision, too,
and the weights are references into the other file (ONNX external data), which therefore has to lie beside this one.
Inputs and outputs stay float32, and so does all that touches colour. On a CPU nothing is gained.
"""

from __future__ import annotations

import argparse
import hashlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import onnxruntime
from onnx import NodeProto, TensorProto, helper, numpy_helper

from postfx.runtime import Library
from training.export import MODELS, ParityError, relative_error, write_card
from training.quantise import variant_name

PRECISION = "fp16"
SHARED = 1024
"""Bytes from which on weights are worth a reference."""
TOLERANCE = 0.01
"""Largest difference to the float32 network, relative to the largest value of an output."""


def halve(model: onnx.ModelProto) -> onnx.ModelProto:
    """A network with weights in half precision and a cast, as `export` writes it, with arithmetic in half precision."""
    model = onnx.ModelProto.FromString(model.SerializeToString())
    graph = model.graph
    weights = {weight.name: weight for weight in graph.initializer}
    casts = [node for node in graph.node if node.op_type == "Cast" and node.input[0] in weights]
    renamed = {cast.output[0]: cast.input[0] for cast in casts} | {v.name: f"{v.name}_half" for v in graph.input}
    nodes = [_cast(value.name, f"{value.name}_half", TensorProto.FLOAT16) for value in graph.input]
    outputs = {value.name for value in graph.output}
    for node in (node for node in graph.node if node not in casts):
        node.input[:] = [renamed.get(name, name) for name in node.input]
        written = [name for name in node.output if name in outputs]
        node.output[:] = [f"{name}_half" if name in outputs else name for name in node.output]
        nodes += [node, *(_cast(f"{name}_half", name, TensorProto.FLOAT) for name in written)]
    scales = {name for node in nodes if node.op_type == "Resize" for name in node.input[1:]}
    for weight in weights.values():
        if weight.data_type == TensorProto.FLOAT and weight.name not in scales:
            weight.CopyFrom(numpy_helper.from_array(numpy_helper.to_array(weight).astype(np.float16), weight.name))
    del graph.node[:]
    graph.node.extend(nodes)
    onnx.checker.check_model(model)
    return model


def _cast(name: str, result: str, to: int) -> NodeProto:
    return helper.make_node("Cast", [name], [result], to=to)


def share_weights(model: onnx.ModelProto, file: Path) -> None:
    """Replace weights that a file beside the model's holds, byte for byte, by references to it."""
    content = file.read_bytes()
    for weight in model.graph.initializer:
        offset, length = content.find(weight.raw_data), len(weight.raw_data)
        if length >= SHARED and offset >= 0:
            weight.ClearField("raw_data")
            weight.data_location = TensorProto.EXTERNAL
            for key, value in (("location", file.name), ("offset", offset), ("length", length)):
                weight.external_data.add(key=key, value=str(value))


def make_fp16(name: str, folder: Path) -> dict[str, Any]:
    """Write the float16 variant of a folder's network and its card beside it; returns the card. Raises ParityError."""
    library = Library(folder)
    source, path = library.path(name), folder / f"{variant_name(name, PRECISION)}.onnx"
    model = halve(onnx.load(source))
    error = difference(model, onnx.load(source))
    share_weights(model, source)
    path.write_bytes(model.SerializeToString(deterministic=True))
    card = {**library.card(name), "name": path.stem, "tag": path.stem.split(".", 1)[1], "precision": PRECISION,
            "weights": {source.name: hashlib.sha256(source.read_bytes()).hexdigest()},
            "parity": {"max_relative_error": float(f"{error:.2g}"), "against": f"{name} in float32"}}
    card.pop("quality", None)  # was measured in float32
    write_card(path, card)
    return card


def difference(model: onnx.ModelProto, wanted: onnx.ModelProto, size: tuple[int, int] = (64, 96)) -> float:
    """Largest difference of two networks' outputs relative to the largest value; raises ParityError above TOLERANCE.

    On the CPU, which computes half precision in float32: rounding inside the network is not part of it.
    """
    random = np.random.default_rng(0)
    reads = {value.name: random.random((1, value.type.tensor_type.shape.dim[1].dim_value, *size), np.float32) * 2 - 0.5
             for value in model.graph.input}
    pairs = zip(_run(model, reads), _run(wanted, reads), strict=True)
    worst = max(relative_error(*pair) for pair in pairs)
    if not worst <= TOLERANCE:
        raise ParityError(f"half precision differs by {worst:.2g} of the largest value: the limit is {TOLERANCE:g}")
    return worst


def _run(model: onnx.ModelProto, reads: Mapping[str, np.ndarray]) -> list[np.ndarray]:
    session = onnxruntime.InferenceSession(model.SerializeToString(), providers=["CPUExecutionProvider"])
    return session.run(None, dict(reads))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("name", help="model of the folder, as denoise_upscale.m or denoise_upscale.m.guides")
    parser.add_argument("--models", type=Path, default=MODELS, metavar="FOLDER", help="where it is, and to write to")
    args = parser.parse_args()
    card = make_fp16(args.name, args.models)
    path = args.models / f"{card['name']}.onnx"
    error = card["parity"]["max_relative_error"]
    print(f"{path}: {path.stat().st_size} bytes; largest relative error to float32: {error}")


if __name__ == "__main__":
    main()
