"""Model packages: folders of ONNX files with JSON cards, and the checks before ONNX Runtime loads
one."""

from __future__ import annotations

import hashlib
import math
import os
from collections.abc import Iterator, Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any

from postfx.errors import ModelError, suggest
from postfx.files import parse_json, read_text
from postfx.runtime.model_file import Declaration, ModelFile, Weights, WireError, parse_model
from postfx.system import is_plain_name, models_dir

_CARD_PARTS = {"inputs": dict, "outputs": dict, "weights": str}
_KIND_WORDS = {dict: "objects", str: "texts"}
_MOST_CARD = 1 << 20  # bytes
_CARDS = 64
"""Cards that are remembered: a plan asks for the same ones dozens of times."""


class Library:
    """The models of one or more folders: `<name>.onnx`, each with an optional card `<name>.json`.

    Where two folders hold a model of the same name, the folder given first wins. Without a folder,
    the models that come with postfx. Raises ModelError when a folder does not exist.

    Args:
        trust: load models of any operators and domains, with control flow and functions of their
            own, because you know where they come from. Hashes, sizes, and what cards say are
            checked all the same.
    """

    def __init__(self, *folders: str | Path, trust: bool = False) -> None:
        self.trust = trust
        self.folders = tuple(Path(folder) for folder in folders) or (models_dir(),)
        for folder in self.folders:
            if not os.path.isdir(folder):
                raise ModelError(f"model folder '{folder}' does not exist: check the path and its "
                                 "rights")

    def __repr__(self) -> str:
        folders = [repr(str(folder)) for folder in self.folders]
        return f"Library({', '.join(folders + ['trust=True'] * self.trust)})"

    def names(self) -> tuple[str, ...]:
        """Names of all models, sorted."""
        return tuple(sorted({path.stem for folder in self.folders
                             for path in folder.glob("*.onnx")}))

    def __contains__(self, name: str) -> bool:
        """Whether there is a model of this name, which costs less than to list all."""
        return any(os.path.isfile(folder / f"{name}.onnx") for folder in self.folders)

    def path(self, name: str) -> Path:
        """The model's file. Raises ModelError that lists the models there are."""
        for folder in self.folders:
            if os.path.isfile(folder / f"{name}.onnx"):
                return folder / f"{name}.onnx"
        where = ", ".join(str(folder) for folder in self.folders)
        known = self.names()
        if not known:
            raise ModelError(f"no model '{name}' in {where}: no *.onnx is there")
        alike = [other for other in known if other.split(".")[0] == name.split(".")[0]] or known
        tags = {other.partition(".")[2] for other in alike}
        tags |= {tag.partition(".")[0] for tag in tags}  # a tag may have models of its kinds alone
        meant = suggest(name.partition(".")[2], tags) if name.split(".")[0] in alike[0] else ""
        raise ModelError(f"no model '{name}' in {where}{meant or ':'} there are {', '.join(alike)}")

    def card(self, name: str) -> dict[str, Any]:
        """The model's card, empty when it has none. Raises ModelError when the card is not a JSON
        object."""
        path = self.path(name).with_name(f"{name}.json")
        if not os.path.exists(path):
            return {}
        try:
            facts = path.stat()
            return dict(_read_card(path, (facts.st_ino, facts.st_mtime_ns, facts.st_size)))
        except (OSError, ValueError) as error:
            raise ModelError(f"card '{path}' cannot be read: {error}") from error

    def constants(self, name: str) -> tuple[str, ...]:
        """Outputs that the card marks as `"constant": true`: they depend on no input."""
        return tuple(output for output, facts in self.card(name).get("outputs", {}).items()
                     if facts.get("constant"))

    def sha256(self, name: str) -> str:
        """The model's hash: the card's, which `load` checks, or the file's own if the card has
        none."""
        return (self.card(name).get("sha256")
                or hashlib.sha256(_content(self.path(name))).hexdigest())

    def load(self, name: str) -> bytes:
        """The model's content. Raises ModelError when it, or a file beside it that it has weights
        in, is not the one whose `sha256` the card gives, and when it is refused by
        `check_model`."""
        path, card = self.path(name), self.card(name)
        for file, expected in card.get("weights", {}).items():
            if not is_plain_name(file):
                raise ModelError(f"card of '{path}' has weights in '{file}': name a file of the "
                                 "same folder")
            _read_checked(path.with_name(file), expected)
        content = _read_checked(path, card.get("sha256"))
        check_model(path, content, card, self.trust)
        return content


def check_card_beside(path: Path) -> None:
    """ModelError where a model's file has lost its card, without which a pass would guess."""
    if not path.with_suffix(".json").is_file():
        raise ModelError(f"model '{path}': its card {path.stem}.json is not beside it: copy both "
                         "files")


@lru_cache(_CARDS)
def _read_card(path: Path, version: tuple[int, int, int]) -> dict[str, Any]:
    """A card of a version of its file. Raises ModelError, OSError, ValueError."""
    card = parse_json(read_text(path, _MOST_CARD))
    if not isinstance(card, dict):
        raise ModelError(f"card '{path}' is not a JSON object")
    for key, kind in _CARD_PARTS.items():
        held = card.get(key, {})
        if not isinstance(held, dict) or not all(type(value) is kind for value in held.values()):
            raise ModelError(f"card '{path}': '{key}' must be an object of {_KIND_WORDS[kind]}")
    for facts in (*card.get("inputs", {}).values(), *card.get("outputs", {}).values()):
        if not isinstance(facts.get("shape", []), list):
            raise ModelError(f"card '{path}': a 'shape' must be a list of numbers and names")
    return card


def _read_checked(path: Path, sha256: str | None) -> bytes:
    content = _content(path)
    if sha256 is not None and hashlib.sha256(content).hexdigest() != sha256:
        raise ModelError(f"model '{path}' is not the file that its card describes (sha256 "
                         "differs): get it again")
    return content


def _content(path: Path) -> bytes:
    """A file's bytes. Refuses files that are too large, and devices and pipes, which may never
    end."""
    try:
        if not path.is_file():
            raise ModelError(f"model '{path}' is not a file")
        if path.stat().st_size > MOST_MODEL_BYTES:
            size = f"{path.stat().st_size >> 20} MB"
            raise ModelError(f"model '{path}' is refused: it has {size}, more than "
                             f"{MOST_MODEL_BYTES >> 20} MB")
        return path.read_bytes()
    except OSError as error:
        raise ModelError(f"model '{path}' cannot be read: {error}") from error


MOST_MODEL_BYTES = 1 << 30
"""Size of a model's file, at most."""
MOST_ELEMENTS = 1 << 31
"""Elements of a value whose shape the file fixes, at most."""
MOST_DIMENSIONS = 16
"""Axes of a value, at most."""
MOST_SHOWN = 300
"""Characters of a reason that are shown, for it may quote the file."""

OPERATORS = frozenset("""
    Abs Acos Acosh Add AffineGrid And ArgMax ArgMin Asin Asinh Atan Atanh Attention AveragePool
    BatchNormalization BitCast BitShift BitwiseAnd BitwiseNot BitwiseOr BitwiseXor BlackmanWindow
    Cast CastLike CausalConvWithState Ceil Celu CenterCropPad Clip Col2Im Compress Concat Constant
    ConstantOfShape Conv ConvInteger ConvTranspose Cos Cosh CumProd CumSum DFT DeformConv
    DepthToSpace DequantizeLinear Det Div Dropout DynamicQuantizeLinear Einsum Elu Equal Erf Exp
    Expand EyeLike Flatten Floor GRU Gather GatherElements GatherND Gelu Gemm GlobalAveragePool
    GlobalLpPool GlobalMaxPool Greater GreaterOrEqual GridSample GroupNormalization HammingWindow
    HannWindow HardSigmoid HardSwish Hardmax Identity InstanceNormalization IsInf IsNaN LRN LSTM
    LayerNormalization LeakyRelu Less LessOrEqual LinearAttention Log LogSoftmax LpNormalization
    LpPool MatMul MatMulInteger Max MaxPool MaxRoiPool MaxUnpool Mean MeanVarianceNormalization
    MelWeightMatrix Min Mish Mod Mul Neg NonMaxSuppression NonZero Not OneHot Or PRelu Pad Pow
    QLinearConv QLinearMatMul QuantizeLinear RMSNormalization RNN Range Reciprocal ReduceL1 ReduceL2
    ReduceLogSum ReduceLogSumExp ReduceMax ReduceMean ReduceMin ReduceProd ReduceSum ReduceSumSquare
    Relu Reshape Resize ReverseSequence RoiAlign RotaryEmbedding Round STFT Scatter ScatterElements
    ScatterND Selu Shape Shrink Sigmoid Sign SimplifiedLayerNormalization Sin Sinh Size Slice
    Softmax Softplus Softsign SpaceToDepth Split Sqrt Squeeze Sub Sum SwiGLU Swish Tan Tanh
    TensorScatter ThresholdedRelu Tile TopK Transpose Trilu Unique Unsqueeze Upsample Where Xor
""".split())
"""ONNX operators that only compute with tensors: no control flow (it may never end), no randomness,
no strings."""

MICROSOFT_OPERATORS = frozenset("""
    Attention BiasAdd BiasGelu BiasSoftmax BiasSplitGelu CDist CausalConvWithState ComplexMul
    ComplexMulConj ConvTransposeWithDynamicPads CropAndResize DecoderMaskedMultiHeadAttention
    DequantizeLinear DynamicQuantizeLSTM DynamicQuantizeMatMul EmbedLayerNormalization ExpandDims
    FastGelu FusedConv FusedGemm FusedMatMul FusedMatMulActivation GatedRelativePositionBias
    GatherBlockQuantized GatherND Gelu GemmFastGelu GridSample GroupNorm GroupQueryAttention Inverse
    Irfft LinearAttention LongformerAttention MatMulBnb4 MatMulFpQ4 MatMulInteger16
    MatMulIntegerToFloat MatMulNBits MaxpoolWithMask MulInteger MultiHeadAttention NhwcConv
    NhwcFusedConv NhwcMaxPool PackedAttention PackedMultiHeadAttention Pad QAttention
    QEmbedLayerNormalization QGemm QLinearAdd QLinearAveragePool QLinearConcat QLinearConv
    QLinearGlobalAveragePool QLinearLeakyRelu QLinearMul QLinearReduceMean QLinearSigmoid
    QLinearSoftmax QLinearWhere QuantizeLinear QuickGelu Range ReduceSumInteger RelativePositionBias
    Rfft RotaryEmbedding ScaledSiLU SkipGroupNorm SkipLayerNormalization
    SkipSimplifiedLayerNormalization SparseAttention SparseToDenseMatMul SwiGLU TransposeMatMul
    Trilu Unique
""".split())
"""ONNX Runtime's own operators of that kind. Others of its domain search with graphs of their own,
draw random numbers, take strings apart or load programs (`EPContext`, `Snpe`)."""

KNOWN_OPERATORS = {"": OPERATORS, "ai.onnx": OPERATORS, "com.microsoft": MICROSOFT_OPERATORS}
"""Operators by domain."""

SIZED_BY = {"AffineGrid": 1, "BlackmanWindow": 0, "Col2Im": 1, "ConstantOfShape": 0, "Expand": 1,
            "HammingWindow": 0,
            "HannWindow": 0, "MaxUnpool": 2, "Reshape": 1, "Resize": 3, "Tile": 1}
"""Operators whose output size is the value of an input -> the index of that input."""

_ELEMENT_BITS = {1: 32, 2: 8, 3: 8, 4: 16, 5: 16, 6: 32, 7: 64, 9: 8, 10: 16, 11: 64, 12: 32,
                 13: 64, 16: 16, 17: 8, 18: 8, 19: 8, 20: 8, 21: 4, 22: 4}
"""Element types that tensors of a model may have, by ONNX's number -> bits; no strings, no complex
numbers."""


def check_model(path: Path, content: bytes, card: Mapping[str, Any], trust: bool = False) -> None:
    """Raises ModelError with the reason when a model's file is not to be loaded; with `trust`, what
    its nodes do is no reason."""
    try:
        model = parse_model(content)
        if model.graphs != 1 or not model.outputs:
            raise WireError("it holds no graph")
    except WireError as error:
        raise ModelError(f"model '{path}' is damaged or no ONNX file ({error}): get it "
                         "again") from error
    for reason in () if trust else _unknown_work(model):
        raise ModelError(f"model '{path}' is refused: {reason[:MOST_SHOWN]}; if "
                         "you know where it comes from, Library(folder, trust=True) loads it")
    for reason in _reasons(model, path, card):
        raise ModelError(f"model '{path}' is refused: {reason[:MOST_SHOWN]}")


def _unknown_work(model: ModelFile) -> Iterator[str]:
    """Work of a model beyond computing with tensors. Domains that it only declares, as optimised
    ones do, are no harm."""
    yield from (f"it holds {extra}" for extra in sorted(model.extras))
    for node in model.nodes:
        if node.operator not in KNOWN_OPERATORS.get(node.domain, ()):
            name = f"{node.domain}.{node.operator}" if node.domain else node.operator
            yield f"the operator '{name}' is not known"
        if node.has_graph:
            yield f"a node '{node.operator}' holds a graph of its own"


def _reasons(model: ModelFile, path: Path, card: Mapping[str, Any]) -> Iterator[str]:
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
    """What is wrong with a model's weights, in words that follow the file's name."""
    name = f"tensor '{weights.name}'"
    if weights.kind not in _ELEMENT_BITS:
        yield f"{name} is of a type that is not known ({weights.kind})"
        return
    if _is_huge(weights.dims):
        yield f"{name} is too large: {_text(weights.dims)}"
        return
    count = math.prod(weights.dims)
    nbytes = -(-count * _ELEMENT_BITS[weights.kind] // 8)
    if weights.external is not None:
        yield from (f"{name} {reason}"
                    for reason in _wrong_place(weights.external, nbytes, path, card))
    elif nbytes != weights.held if weights.raw else count > weights.held:
        yield f"{name} says that it is {_text(weights.dims)} and holds {weights.held} bytes"


def _wrong_place(external: Mapping[str, str], nbytes: int, path: Path,
                 card: Mapping[str, Any]) -> Iterator[str]:
    """Why weights in another file are refused: they must be in the model's folder, under a plain
    name."""
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
        offset, length = (external.get(key, default)
                          for key, default in (("offset", "0"), ("length", str(nbytes))))
        if not (offset.isdecimal() and length.isdecimal() and int(length) == nbytes):
            yield f"needs {nbytes} bytes, not {length} from {offset} on"
        elif int(offset) + nbytes > file.stat().st_size:
            yield f"lies beyond the end of '{location}'"


def _wrong_sizes(model: ModelFile) -> Iterator[str]:
    """Nodes that blow up a small input: their output size is an absurd constant."""
    constants = {weights.name: weights.values for weights in model.weights}
    for node in model.nodes:
        if node.operator == "Constant" and node.outputs and node.weights:
            constants[node.outputs[0]] = node.weights[0].values
    for node in model.nodes:
        index = SIZED_BY.get(node.operator)
        size = (constants.get(node.inputs[index], ())
                if index is not None and index < len(node.inputs) else ())
        if math.prod(max(1, abs(side)) for side in size) > MOST_ELEMENTS:
            yield f"a node '{node.operator}' makes {_text(size)} elements"


def _differences(kind: str, found: list[Declaration], card: Mapping[str, Any]) -> Iterator[str]:
    """Where a model's inputs or outputs are not those of its card. kind: 'input' or 'output'."""
    declared = card.get(f"{kind}s")
    if declared is None:
        return
    shapes = {value.name: value.shape for value in found}
    declared = {name: facts for name, facts in declared.items()
                if name in shapes or not facts.get("constant")}  # else it is in the metadata
    if set(shapes) != set(declared):
        yield (f"it has the {kind}s {', '.join(sorted(shapes))}, its card has "
               f"{', '.join(sorted(declared))}")
        return
    for name, facts in declared.items():
        wanted, shape = facts.get("shape"), shapes[name]
        if wanted is not None and shape is not None and not _agree(shape, wanted):
            yield f"its {kind} '{name}' is {_text(shape)}, its card says {_text(wanted)}"


def _agree(shape: tuple[int | str, ...], wanted: list[int | str]) -> bool:
    """Whether shapes are the same: numbers where both have one, and symbols where the file names
    one."""
    if len(shape) != len(wanted):
        return False
    return all(one == other if isinstance(one, int) == isinstance(other, int)
               else isinstance(one, str) and one == ""
               for one, other in zip(shape, wanted, strict=True) if one != "")


def _is_huge(sizes: tuple[int, ...] | list[int]) -> bool:
    return (len(sizes) > MOST_DIMENSIONS or any(size < 0 for size in sizes)
            or math.prod(sizes) > MOST_ELEMENTS)


def _text(sizes: tuple[int | str, ...] | list[int | str] | None) -> str:
    return "x".join(str(size) if size != "" else "?" for size in sizes or ()) or "one number"
