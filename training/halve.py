"""Make the float16 variant of a denoised upscaler, for GPUs: a small file that shares the weights of the float32 one.

    python -m training.halve denoise_upscale.m
    python -m training.halve denoise_upscale.m.guides
    python -m training.halve denoise_upscale.m.1x

The exported network keeps its weights in half precision and casts them; here the arithmetic is in half precision, too,
and the weights are references into the other file (ONNX external data), which therefore has to lie beside this one.
Its inputs are packed and its heads raw (`training.half_graph`); all that touches colour stays float32. On a CPU nothing
is gained.
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
from onnx import TensorProto

from postfx.kernels import denoise_half
from postfx.kernels.denoise_open import OPEN_PHASED
from postfx.passes._denoise_network import FEATURE_PARTS, PACKED, PHASED_FINE, RAW
from postfx.runtime import Library
from training.export import MODELS, ParityError, relative_error, write_card
from training.half_graph import computed_levels, halve
from training.quantise import variant_name

PRECISION = "fp16"
SHARED = 1024
"""Bytes from which on weights are worth a reference."""
TOLERANCE = 0.01
"""Largest difference to the float32 network, relative to the largest value of an output."""


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
    align = 2 ** computed_levels(model.graph)
    alike = {output: told for output, told in card.get("outputs", {}).items() if told.get("constant")}
    card |= {"inputs": _listed(model.graph.input, align), "outputs": _listed(model.graph.output, align) | alike}
    card.pop("quality", None)  # was measured in float32
    write_card(path, card)
    return card


def _listed(values: Iterable[onnx.ValueInfoProto], align: int) -> dict[str, Any]:
    meaning = f"float16, channels last, see postfx/kernels/denoise_half.py; height and width multiples of {align}"
    sizes = {value.name: [dim.dim_value or dim.dim_param or "?" for dim in value.type.tensor_type.shape.dim]
             for value in values}
    return {name: {"shape": size, "meaning": meaning} for name, size in sizes.items()}


def difference(model: onnx.ModelProto, wanted: onnx.ModelProto, size: tuple[int, int] = (64, 96)) -> float:
    """Largest difference of two networks' heads relative to the largest value; raises ParityError above TOLERANCE.

    On the CPU, which computes half precision in float32: rounding inside the network is not part of it.
    """
    random = np.random.default_rng(0)
    reads = {value.name: random.random((1, value.type.tensor_type.shape.dim[1].dim_value, *size), np.float32) * 2 - 0.5
             for value in wanted.graph.input}
    whole = {"features": np.concatenate([reads[part] for part in FEATURE_PARTS], 1), **reads}
    packed = {f"{PACKED}{name}": pack(value) for name, value in whole.items() if name not in FEATURE_PARTS}
    found = [opened(name.removeprefix(RAW), head) if name.startswith(RAW) else head
             for name, head in _run(model, packed).items()]
    exact = [opened_phases(head) if name == PHASED_FINE else head for name, head in _run(wanted, reads).items()]
    worst = max(relative_error(mine[:, :value.shape[1]], value) for mine, value in zip(found, exact, strict=True))
    if not worst <= TOLERANCE:
        raise ParityError(f"half precision differs by {worst:.2g} of the largest value: the limit is {TOLERANCE:g}")
    return worst


def pack(planes: np.ndarray) -> np.ndarray:
    """What a network in half precision reads for planes (1, channels, height, width)."""
    _, channels, height, columns = planes.shape
    packed = np.empty((1, height, columns, denoise_half.width(channels)), np.float16)
    denoise_half.PACK.rows(0, height, planes, packed)
    return packed


def opened(name: str, raw: np.ndarray) -> np.ndarray:
    """A head from a raw one."""
    heads = np.empty(denoise_half.opened(name, *raw.shape[1:3]), np.float32)
    kernel = denoise_half.OPEN_FINE if name == "fine" else denoise_half.OPEN
    kernel.rows(0, heads.shape[2], raw, heads)
    return heads


def opened_phases(phased: np.ndarray) -> np.ndarray:
    """The fine head in float32 from its phases."""
    fine = np.empty(denoise_half.opened("fine", *phased.shape[2:]), np.float32)
    OPEN_PHASED.rows(0, fine.shape[2], phased, fine)
    return fine


def _run(model: onnx.ModelProto, reads: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    session = onnxruntime.InferenceSession(model.SerializeToString(), providers=["CPUExecutionProvider"])
    names = [value.name for value in session.get_outputs()]
    return dict(zip(names, session.run(names, dict(reads)), strict=True))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("name", help="model of the folder, as denoise_upscale.m or denoise_upscale.m.1x")
    parser.add_argument("--models", type=Path, default=MODELS, metavar="FOLDER", help="where it is, and to write to")
    args = parser.parse_args()
    card = make_fp16(args.name, args.models)
    path = args.models / f"{card['name']}.onnx"
    error = card["parity"]["max_relative_error"]
    print(f"{path}: {path.stat().st_size} bytes; largest relative error to float32: {error}")


if __name__ == "__main__":
    main()
