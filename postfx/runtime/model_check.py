"""Refuses ONNX files that are damaged or not what their card says, before ONNX Runtime sees them.

Models whose card has a sha256 are known by it. What a file claims is checked for all of them, so that a model without a
card, which is the user's own, reads no file outside its folder, runs no code but ONNX Runtime's own, and claims no more
memory than it fills.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from postfx.errors import ModelError
from postfx.files import make_printable
from postfx.runtime.model_file import Declared, ModelFile, Weights, parse_model
from postfx.runtime.wire import WireError
from postfx.system import is_plain_name

MOST_BYTES = 1 << 30
"""Of a model's file."""
MOST_ELEMENTS = 1 << 31
"""Of a value whose shape the file fixes."""
MOST_DIMENSIONS = 16
MOST_SHOWN = 300
"""Letters of a reason, which may name what a stranger named."""

DOMAINS = ("", "ai.onnx")
OPERATORS = frozenset("""
    Abs Acos Acosh Add And ArgMax ArgMin Asin Asinh Atan Atanh AveragePool BatchNormalization BitShift BitwiseAnd
    BitwiseNot BitwiseOr BitwiseXor Cast CastLike Ceil Celu CenterCropPad Clip Concat Constant ConstantOfShape Conv
    ConvInteger ConvTranspose Cos Cosh CumSum DeformConv DepthToSpace DequantizeLinear Div Dropout
    DynamicQuantizeLinear Einsum Elu Equal Erf Exp Expand EyeLike Flatten Floor Gather GatherElements GatherND Gelu Gemm
    GlobalAveragePool GlobalMaxPool Greater GreaterOrEqual GridSample GroupNormalization HardSigmoid HardSwish Hardmax
    Identity InstanceNormalization IsInf IsNaN LRN LayerNormalization LeakyRelu Less LessOrEqual Log LogSoftmax MatMul
    MatMulInteger Max MaxPool Mean MeanVarianceNormalization Min Mish Mod Mul Neg NonZero Not OneHot Or PRelu Pad Pow
    QLinearConv QLinearMatMul QuantizeLinear Range Reciprocal ReduceL1 ReduceL2 ReduceLogSum ReduceLogSumExp ReduceMax
    ReduceMean ReduceMin ReduceProd ReduceSum ReduceSumSquare Relu Reshape Resize Round ScatterElements ScatterND Selu
    Shape Shrink Sigmoid Sign Sin Sinh Size Slice Softmax Softplus Softsign SpaceToDepth Split Sqrt Squeeze Sub Sum Tan
    Tanh ThresholdedRelu Tile TopK Transpose Trilu Unsqueeze Where Xor
""".split())
"""Of ONNX's own, those that compute with tensors: no control flow, which may never end, no chance, no strings."""

SIZED_BY = {"ConstantOfShape": 0, "Expand": 1, "Reshape": 1, "Tile": 1, "Resize": 3}
"""Operators whose output is as large as one of their inputs says -> which."""

_BITS = {1: 32, 2: 8, 3: 8, 4: 16, 5: 16, 6: 32, 7: 64, 9: 8, 10: 16, 11: 64, 12: 32, 13: 64, 16: 16, 17: 8, 18: 8,
         19: 8, 20: 8, 21: 4, 22: 4}
"""Element types that tensors of a model may have, by ONNX's number -> bits; no strings, no complex numbers."""


def check_model(path: Path, content: bytes, card: Mapping[str, Any]) -> None:
    """Raises ModelError with the reason when a model's file is not to be loaded."""
    try:
        model = parse_model(content)
        if model.graphs != 1 or not model.outputs:
            raise WireError("it holds no graph")
    except WireError as error:
        raise ModelError(f"model '{path}' is damaged or no ONNX file ({error}): get it again") from error
    for reason in _reasons(model, path, card):
        raise ModelError(f"model '{path}' is refused: {make_printable(reason[:MOST_SHOWN])}")


def _reasons(model: ModelFile, path: Path, card: Mapping[str, Any]) -> Iterator[str]:
    yield from (f"it holds {extra}" for extra in sorted(model.extras))
    yield from (f"operators of the domain '{name}' are not known" for name in model.domains if name not in DOMAINS)
    for node in model.nodes:
        if node.domain not in DOMAINS or node.operator not in OPERATORS:
            name = f"{node.domain}.{node.operator}" if node.domain else node.operator
            yield f"the operator '{name}' is not known"
        if node.has_graph:
            yield f"a node '{node.operator}' holds a graph of its own"
    for weights in (*model.weights, *(inner for node in model.nodes for inner in node.weights)):
        yield from _wrong_weights(weights, path, card)
    for value in (*model.inputs, *model.outputs, *model.inner):
        fixed = [size for size in value.shape or () if isinstance(size, int)]
        if _is_huge(fixed) or len(value.shape or ()) > MOST_DIMENSIONS:
            yield f"'{value.name}' is too large: {_text(value.shape)}"
    yield from _wrong_sizes(model)
    yield from _differences("input", model.inputs, card)
    yield from _differences("output", model.outputs, card)


def _wrong_weights(weights: Weights, path: Path, card: Mapping[str, Any]) -> Iterator[str]:
    name = f"tensor '{weights.name}'"
    if weights.kind not in _BITS:
        yield f"{name} is of a type that is not known ({weights.kind})"
        return
    if _is_huge(weights.dims):
        yield f"{name} is too large: {_text(weights.dims)}"
        return
    count = math.prod(weights.dims)
    nbytes = -(-count * _BITS[weights.kind] // 8)
    if weights.external is not None:
        yield from (f"{name} {reason}" for reason in _wrong_place(weights.external, nbytes, path, card))
    elif nbytes != weights.held if weights.raw else count > weights.held:
        yield f"{name} says that it is {_text(weights.dims)} and holds {weights.held} bytes"


def _wrong_place(external: Mapping[str, str], nbytes: int, path: Path, card: Mapping[str, Any]) -> Iterator[str]:
    """What speaks against weights in another file: it has to lie in the model's folder, by a plain name."""
    location = external.get("location", "")
    if not is_plain_name(location):
        yield f"is in '{location}': weights may lie in the model's own folder only"
        return
    file, folder = path.with_name(location), path.parent.resolve()
    if file.resolve().parent != folder:
        yield f"is in '{location}', a link that leads out of the model's folder"
    elif not file.is_file():
        yield f"is in '{location}', which is not there"
    elif card.get("sha256") and location not in card.get("weights", {}):
        yield f"is in '{location}', whose hash the card does not give"
    else:
        offset, length = (external.get(key, default) for key, default in (("offset", "0"), ("length", str(nbytes))))
        if not (offset.isdecimal() and length.isdecimal() and int(length) == nbytes):
            yield f"needs {nbytes} bytes, not {length} from {offset} on"
        elif int(offset) + nbytes > file.stat().st_size:
            yield f"lies beyond the end of '{location}'"


def _wrong_sizes(model: ModelFile) -> Iterator[str]:
    """Nodes that make much of little: their size is a constant beyond all reason."""
    constants = {weights.name: weights.values for weights in model.weights}
    for node in model.nodes:
        if node.operator == "Constant" and node.outputs and node.weights:
            constants[node.outputs[0]] = node.weights[0].values
    for node in model.nodes:
        index = SIZED_BY.get(node.operator)
        size = constants.get(node.inputs[index], ()) if index is not None and index < len(node.inputs) else ()
        if math.prod(max(1, abs(side)) for side in size) > MOST_ELEMENTS:
            yield f"a node '{node.operator}' makes {_text(size)} elements"


def _differences(kind: str, found: list[Declared], card: Mapping[str, Any]) -> Iterator[str]:
    declared = card.get(f"{kind}s")
    if declared is None:
        return
    shapes = {value.name: value.shape for value in found}
    if set(shapes) != set(declared):
        yield f"it has the {kind}s {', '.join(sorted(shapes))}, its card has {', '.join(sorted(declared))}"
        return
    for name, facts in declared.items():
        wanted, shape = facts.get("shape"), shapes[name]
        if wanted is not None and shape is not None and not _agree(shape, wanted):
            yield f"its {kind} '{name}' is {_text(shape)}, its card says {_text(wanted)}"


def _agree(shape: tuple[int | str, ...], wanted: list[int | str]) -> bool:
    """Whether shapes are the same: numbers where both have one, and symbols where the file names one."""
    if len(shape) != len(wanted):
        return False
    return all(one == other if isinstance(one, int) == isinstance(other, int) else isinstance(one, str) and one == ""
               for one, other in zip(shape, wanted, strict=True) if one != "")


def _is_huge(sizes: tuple[int, ...] | list[int]) -> bool:
    return len(sizes) > MOST_DIMENSIONS or any(size < 0 for size in sizes) or math.prod(sizes) > MOST_ELEMENTS


def _text(sizes: tuple[int | str, ...] | list[int | str] | None) -> str:
    return "x".join(str(size) if size != "" else "?" for size in sizes or ()) or "one number"
