"""Reads the structure of an ONNX file without ONNX Runtime and without the package `onnx`.

The package would take 26 MB and 50 ms of every start; this reader takes 3 ms a model, and refuses a
file of a million empty parts before it fills the memory. Field numbers come from onnx.proto (ONNX
1.17), the format from https://protobuf.dev/programming-guides/encoding. Weights are not copied.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from itertools import count
from typing import NamedTuple

import numpy as np

Dimension = int | str
Field = int | memoryview
_MOST_SHAPE_SIZES = 16
"""Sizes that a shape may have: larger tensors of weights are none."""
MOST_PARTS = 1_000_000
"""Fields of a file, and members of fields of integers, at most."""


# Numbers of the fields that are read, by onnx.proto's messages and names.


class _ModelField:
    GRAPH = 7
    OPSET_IMPORT = 8
    TRAINING_INFO = 20
    FUNCTIONS = 25


class _GraphField:
    NODE = 1
    INITIALIZER = 5
    INPUT = 11
    OUTPUT = 12
    VALUE_INFO = 13
    SPARSE_INITIALIZER = 15


class _NodeField:
    INPUT = 1
    OUTPUT = 2
    OP_TYPE = 4
    ATTRIBUTE = 5
    DOMAIN = 7


class _AttributeField:
    NAME = 1
    INTEGER = 3
    TEXT = 4
    TENSOR = 5
    GRAPH = 6
    INTEGERS = 8
    TENSORS = 10
    GRAPHS = 11
    TYPE = 20
    SPARSE_TENSOR = 22
    SPARSE_TENSORS = 23


class _TensorField:
    DIMS = 1
    DATA_TYPE = 2
    INT64_DATA = 7
    NAME = 8
    RAW_DATA = 9
    EXTERNAL_DATA = 13
    DATA_LOCATION = 14


_TYPED_DATA = (4, 5, _TensorField.INT64_DATA, 10, 11)
"""Fields of a tensor: float_data, int32_data, int64_data, double_data, uint64_data."""


class _ValueField:
    """Of a declared input, output or value, and of what its type holds."""

    NAME = 1
    TYPE = 2
    TENSOR_TYPE = 1
    SHAPE = 2
    DIMENSION = 1
    SIZE = 1
    SYMBOL = 2


_DIMENSION_PATH = (_ValueField.TYPE, _ValueField.TENSOR_TYPE, _ValueField.SHAPE,
                   _ValueField.DIMENSION)
"""Fields from a declared value to its dimensions."""


class _ElementType:
    FLOAT = 1
    UINT8 = 2
    INT8 = 3
    INT64 = 7
    FLOAT16 = 10


FLOAT = _ElementType.FLOAT
"""ONNX's number of the element type float32."""
_INTEGER = 2
"""Type of an attribute that holds an integer."""
_INTEGERS = 7
"""Type of an attribute that holds several integers."""


@dataclass
class Weights:
    """A tensor in the file, or in another file that it names.

    Attributes:
        kind: ONNX's number of the element type.
        held: bytes of its content here.
        raw: whether the content is stored as it lies in memory, so that its size is known.
        content: what is stored so, if it is here.
        external: location, offset and length of content in another file.
        values: of a small tensor of int64, which may be a shape.
    """

    name: str = ""
    dims: tuple[int, ...] = ()
    kind: int = 0
    held: int = 0
    raw: bool = False
    external: dict[str, str] | None = None
    values: tuple[int, ...] = ()
    content: memoryview = field(default=memoryview(b""), repr=False)


@dataclass(frozen=True)
class Declaration:
    """An input or output: a name and its dimensions, None where no tensor shape is given. '' is a
    free dimension."""

    name: str
    shape: tuple[Dimension, ...] | None


@dataclass
class Node:
    """One operator.

    Attributes:
        integers, words: attributes that are integers, one or several, or a text.
    """

    operator: str = ""
    domain: str = ""
    inputs: list[str] = field(default_factory=list)
    outputs: list[str] = field(default_factory=list)
    weights: list[Weights] = field(default_factory=list)
    has_graph: bool = False
    integers: dict[str, tuple[int, ...]] = field(default_factory=dict)
    words: dict[str, str] = field(default_factory=dict)


@dataclass
class ModelFile:
    """A model: its nodes, weights and declared values."""

    nodes: list[Node] = field(default_factory=list)
    weights: list[Weights] = field(default_factory=list)
    inputs: list[Declaration] = field(default_factory=list)
    outputs: list[Declaration] = field(default_factory=list)
    inner: list[Declaration] = field(default_factory=list)
    graphs: int = 0
    extras: set[str] = field(default_factory=set)


def parse_model(content: bytes) -> ModelFile:
    """The model in a file; WireError if it is not an ONNX model, is truncated, or has more than a
    million parts."""
    return _Reader().model(memoryview(content))


class _Reader:
    def __init__(self) -> None:
        self._wire = Wire(MOST_PARTS)

    def model(self, content: memoryview) -> ModelFile:
        model = ModelFile()
        for number, value in self._wire.fields(content):
            if number == _ModelField.GRAPH:
                model.graphs += 1
                self._parse_graph(_message(value), model)
            elif number == _ModelField.TRAINING_INFO:
                model.extras.add("training")
            elif number == _ModelField.FUNCTIONS:
                model.extras.add("functions of its own")
        return model

    def _parse_graph(self, graph: memoryview, model: ModelFile) -> None:
        declared = {_GraphField.INPUT: model.inputs, _GraphField.OUTPUT: model.outputs,
                    _GraphField.VALUE_INFO: model.inner}
        for number, value in self._wire.fields(graph):
            if number == _GraphField.NODE:
                model.nodes.append(self._node(_message(value)))
            elif number == _GraphField.INITIALIZER:
                model.weights.append(self._weights(_message(value)))
            elif number in declared:
                declared[number].append(self._parse_declared(_message(value)))
            elif number == _GraphField.SPARSE_INITIALIZER:
                model.extras.add("sparse weights")

    def _node(self, message: memoryview) -> Node:
        node = Node()
        for number, value in self._wire.fields(message):
            if number == _NodeField.INPUT:
                node.inputs.append(text(value))
            elif number == _NodeField.OUTPUT:
                node.outputs.append(text(value))
            elif number == _NodeField.OP_TYPE:
                node.operator = text(value)
            elif number == _NodeField.DOMAIN:
                node.domain = text(value)
            elif number == _NodeField.ATTRIBUTE:
                self._parse_attribute(_message(value), node)
        return node

    def _parse_attribute(self, message: memoryview, node: Node) -> None:
        name, integers = "", list[int]()
        for number, value in self._wire.fields(message):
            if number == _AttributeField.NAME:
                name = text(value)
            elif number in (_AttributeField.INTEGER, _AttributeField.INTEGERS):
                integers += self._wire.integers(value)
            elif number == _AttributeField.TEXT:
                node.words[name] = bytes(_message(value)).decode(errors="replace")
            elif number in (_AttributeField.TENSOR, _AttributeField.TENSORS):
                node.weights.append(self._weights(_message(value)))
            elif number in (_AttributeField.GRAPH, _AttributeField.GRAPHS):
                node.has_graph = True
            elif number in (_AttributeField.SPARSE_TENSOR, _AttributeField.SPARSE_TENSORS):
                raise WireError("sparse weights in a node")
        if integers:
            node.integers[name] = tuple(integers)

    def _weights(self, message: memoryview) -> Weights:
        found = Weights()
        dims: list[int] = []
        data: list[tuple[int, Field]] = []
        for number, value in self._wire.fields(message):
            if number == _TensorField.DIMS:
                dims += self._wire.integers(value)
            elif number == _TensorField.DATA_TYPE:
                found.kind = self._number(value)
            elif number == _TensorField.NAME:
                found.name = text(value)
            elif number == _TensorField.RAW_DATA:
                found.content = _message(value)
                found.raw = True
                found.held = len(found.content)
                data.append((number, value))
            elif number in _TYPED_DATA:
                found.held += 1 if isinstance(value, int) else len(value)
                data.append((number, value))
            elif number == _TensorField.EXTERNAL_DATA:
                found.external = {**(found.external or {}), **self._entry(_message(value))}
            elif number == _TensorField.DATA_LOCATION and value != 0:  # in another file
                found.external = found.external or {}
        found.dims = tuple(dims)
        if found.kind == _ElementType.INT64 and found.held <= 8 * _MOST_SHAPE_SIZES:
            found.values = tuple(self._small(data))
        return found

    def _small(self, data: list[tuple[int, Field]]) -> Iterator[int]:
        """Elements of a small tensor of int64."""
        for number, value in data:
            if number == _TensorField.RAW_DATA and not isinstance(value, int):
                yield from struct.unpack(f"<{len(value) // 8}q", value[: len(value) // 8 * 8])
            elif number == _TensorField.INT64_DATA:
                yield from self._wire.integers(value)

    def _entry(self, message: memoryview) -> dict[str, str]:
        """Key and value of a message of two texts."""
        found = {number: text(value) for number, value in self._wire.fields(message)}
        return {found.get(1, ""): found.get(2, "")}

    def _parse_declared(self, message: memoryview) -> Declaration:
        name, shape = "", None
        for number, value in self._wire.fields(message):
            if number == _ValueField.NAME:
                name = text(value)
            elif number == _ValueField.TYPE:
                for kind, tensor in self._wire.fields(_message(value)):
                    if kind == _ValueField.TENSOR_TYPE:
                        shape = self._shape(_message(tensor))
        return Declaration(name, shape)

    def _shape(self, tensor: memoryview) -> tuple[Dimension, ...] | None:
        shape = None
        for number, value in self._wire.fields(tensor):
            if number == _ValueField.SHAPE:
                dims = (dim for key, dim in self._wire.fields(_message(value))
                        if key == _ValueField.DIMENSION)
                shape = tuple(self._dimension(_message(dim)) for dim in dims)
        return shape

    def _dimension(self, message: memoryview) -> Dimension:
        size: Dimension = ""
        for number, value in self._wire.fields(message):
            if number == _ValueField.SIZE:
                size = self._number(value)
            elif number == _ValueField.SYMBOL:
                size = text(value)
        return size

    def _number(self, value: Field) -> int:
        return next(self._wire.integers(value), 0)


def fix_dimensions(content: bytes, sizes: Mapping[tuple[str, int], int]) -> bytes:
    """A model's file with sizes in place of dimensions of its inputs and outputs, by name and axis.

    ONNX Runtime fixes dimensions by their symbols only, and some have none. Raises ValueError for a
    name or an axis that the model has not, and where it says another size.
    """
    model = parse_model(content)
    shapes = {value.name: value.shape for value in (*model.inputs, *model.outputs)}
    for (name, axis), size in sizes.items():
        shape = shapes.get(name)
        if shape is None:
            known = ", ".join(f"'{other}'" for other, there in shapes.items() if there is not None)
            raise ValueError(f"no input or output '{name}' has a shape: {known} have one")
        if not 0 <= axis < len(shape):
            raise ValueError(f"'{name}' has {len(shape)} axes, counted from 0, and no axis {axis}")
        if size < 1 or (isinstance(shape[axis], int) and shape[axis] != size):
            raise ValueError(f"axis {axis} of '{name}' is {shape[axis] or 'free'}, it cannot be "
                             f"{size}")

    def fix_value(message: memoryview) -> bytes:
        name = _name_of(message)
        axes = count()

        def fix_dimension(dimension: memoryview) -> bytes:
            size = sizes.get((name, next(axes)))
            if size is None:
                return bytes(dimension)
            return _as_number(_ValueField.SIZE, size)

        return _replace(message, _DIMENSION_PATH, fix_dimension)

    for values in (_GraphField.INPUT, _GraphField.OUTPUT):
        content = _replace(content, (_ModelField.GRAPH, values), fix_value)
    return content


_TABLE_TYPES = {_ElementType.FLOAT: "<f4", _ElementType.FLOAT16: "<f2"}
"""Element types that a table may have, and NumPy's names for them."""


def read_tables(content: bytes) -> dict[str, np.ndarray]:
    """Outputs of a model that reads nothing, float32: weights as they are stored, or converted to
    float32.

    Raises ValueError for a model that reads or computes something.
    """
    model = parse_model(content)
    stored = {one.name: one for one in model.weights}
    copies = [node for node in model.nodes if node.operator in ("Cast", "Identity")
              and len(node.outputs) == len(node.inputs) == 1]
    from_nodes = {node.outputs[0]: node.inputs[0] for node in copies}
    if model.inputs or len(from_nodes) < len(model.nodes):
        raise ValueError("it reads or computes something")
    found = {}
    for output in model.outputs:
        table = stored.get(from_nodes.get(output.name, output.name))
        if table is None or not table.raw or table.external or table.kind not in _TABLE_TYPES:
            raise ValueError(f"'{output.name}' is not stored in it")
        values: np.ndarray = np.frombuffer(table.content, np.dtype(_TABLE_TYPES[table.kind]))
        found[output.name] = values.reshape(table.dims).astype(np.float32)
    return found


class Product(NamedTuple):
    """An output that was a product of 8-bit integers: the output that has its codes now, (1, h, w,
    C) of uint8, and its factors (n, C), at most 64."""

    codes: str
    factors: np.ndarray


MOST_FACTOR = 64
"""Largest magnitude of a factor: a pair of its products with codes of 8 bits fits into 16 bits, in
which processors add them."""
CODE_SIGN = 128
"""The bit by which codes of uint8 and int8 differ."""
CODES_PREFIX = "codes_"
_BYTES = (_ElementType.UINT8, _ElementType.INT8)
_CODES_WAY = ("Cast", "BitwiseXor", "Reshape")
"""Operators from a product's codes back to the tensor that holds them."""


def take_products(content: bytes) -> tuple[bytes, dict[str, Product]]:
    """A model's file that leaves integer products to the caller, and these by the outputs that had
    them.

    Such an output is MatMulInteger(factors + z, code - 128), whose codes come from a tensor (1, C,
    h, w) in three nodes that flatten it and change its sign. Others stay as they are.
    """
    model = parse_model(content)
    if any(node.has_graph for node in model.nodes):
        return content, {}
    makers = {output: node for node in model.nodes for output in node.outputs}
    weights = {one.name: one for one in model.weights}
    taken: dict[str, Product] = {}
    sources: dict[str, str] = {}
    for output in model.outputs:
        if found := _product(output.name, makers, weights):
            source, factors = found
            sources.setdefault(source, f"{CODES_PREFIX}{output.name.rpartition('_')[2]}")
            taken[output.name] = Product(sources[source], factors)
    if not taken:
        return content, taken
    needed = {output.name for output in model.outputs} - taken.keys() | sources.keys()
    for node in reversed(model.nodes):
        if needed & {*node.outputs}:
            needed.update(node.inputs)
    nodes = iter(model.nodes)

    def change(graph: memoryview) -> bytes:
        parts: list[bytes | memoryview] = []
        for number, value, raw in _fields(graph):
            if number == _GraphField.NODE:
                is_kept = bool(needed & {*next(nodes).outputs})
            elif number == _GraphField.OUTPUT:
                is_kept = _name_of(_message(value)) not in taken
            else:
                is_kept = True
            parts += [raw] if is_kept else []
        for source, codes in sources.items():
            parts.append(_as_field(_GraphField.NODE, _channels_last(source, codes)))
            parts.append(_as_field(_GraphField.OUTPUT, _bytes_output(codes)))
        return b"".join(parts)

    return _replace(content, (_ModelField.GRAPH,), change), taken


def _product(output: str, makers: Mapping[str, Node],
             weights: Mapping[str, Weights]) -> tuple[str, np.ndarray] | None:
    """The tensor of an output's codes, and its factors; None if it is no product, or not of this
    kind."""
    node = makers.get(output)
    if node is None or node.operator != "MatMulInteger" or len(node.inputs) != 4:
        return None
    factors_name, codes_name, middle_name, zero_name = node.inputs
    way = []
    for operator in _CODES_WAY:
        step = makers.get(codes_name)
        if step is None or step.operator != operator or not step.inputs:
            return None
        way.append(step)
        codes_name = step.inputs[0]
    if len(way[1].inputs) != 2:
        return None
    names = factors_name, middle_name, zero_name, way[1].inputs[1]
    held = [weights.get(name, Weights()) for name in names]
    if not all(one.raw and one.kind in _BYTES for one in held) or len(held[0].dims) != 2:
        return None
    factors, middle, zero, sign = (np.frombuffer(one.content, np.uint8) for one in held)
    if [middle.size, *zero, *sign] != [1, CODE_SIGN, CODE_SIGN] or held[0].dims[1] % 4:
        return None
    found = factors.reshape(held[0].dims).astype(np.int16) - middle
    if np.abs(found).max(initial=0) > MOST_FACTOR:
        return None
    return codes_name, found.astype(np.int8)


def swap_nodes(content: bytes, swapped: Mapping[int, Node | None]) -> bytes:
    """A model's file in which other nodes stand in for some, by their places; None: nothing does.
    Their attributes are single integers."""
    def change(graph: memoryview) -> bytes:
        parts: list[bytes | memoryview] = []
        places = count()
        for number, _, raw in _fields(graph):
            place = next(places) if number == _GraphField.NODE else -1
            if place not in swapped:
                parts.append(raw)
            elif node := swapped[place]:
                parts.append(_as_field(_GraphField.NODE, _as_node(node)))
        return b"".join(parts)

    return _replace(content, (_ModelField.GRAPH,), change)


def import_operators(content: bytes, domain: str) -> bytes:
    """A model's file that may use the first version of a domain's operators."""
    name, version = 1, 2  # fields of OperatorSetIdProto
    imported = _as_field(name, domain.encode()) + _as_number(version, 1)
    return content + _as_field(_ModelField.OPSET_IMPORT, imported)


def _as_node(node: Node) -> bytes:
    """A node whose attributes are single integers."""
    texts = [*((_NodeField.INPUT, name) for name in node.inputs),
             *((_NodeField.OUTPUT, name) for name in node.outputs),
             (_NodeField.OP_TYPE, node.operator), (_NodeField.DOMAIN, node.domain)]
    attributes = [_as_field(_AttributeField.NAME, name.encode())
                  + _as_number(_AttributeField.INTEGER, value)
                  + _as_number(_AttributeField.TYPE, _INTEGER)
                  for name, (value,) in node.integers.items()]
    return b"".join([*(_as_field(number, words.encode()) for number, words in texts),
                     *(_as_field(_NodeField.ATTRIBUTE, one) for one in attributes)])


def _name_of(message: memoryview) -> str:
    """The name of a declared value."""
    return next((text(value) for number, value, _ in _fields(message)
                 if number == _ValueField.NAME), "")


def _as_number(field_number: int, value: int) -> bytes:
    """A field that holds an integer."""
    return _as_varint(field_number << 3 | VARINT) + _as_varint(value)


def _as_field(number: int, message: bytes) -> bytes:
    """A field that holds a message or a text."""
    return _as_varint(number << 3 | BYTES) + _as_varint(len(message)) + message


def _channels_last(source: str, result: str) -> bytes:
    """A node Transpose, (0, 1, 2, 3) -> (0, 2, 3, 1)."""
    axes = b"".join(_as_number(_AttributeField.INTEGERS, axis) for axis in (0, 2, 3, 1))
    order = (_as_field(_AttributeField.NAME, b"perm") + axes
             + _as_number(_AttributeField.TYPE, _INTEGERS))
    return b"".join((_as_field(_NodeField.INPUT, source.encode()),
                     _as_field(_NodeField.OUTPUT, result.encode()),
                     _as_field(_NodeField.OP_TYPE, b"Transpose"),
                     _as_field(_NodeField.ATTRIBUTE, order)))


def _bytes_output(name: str) -> bytes:
    """An output of uint8 with four axes, whose sizes follow from its node."""
    element_type = 1  # the field of a tensor's type that names its elements
    shape = _as_field(_ValueField.SHAPE, 4 * _as_field(_ValueField.DIMENSION, b""))
    tensor = _as_number(element_type, _ElementType.UINT8) + shape
    kind = _as_field(_ValueField.TENSOR_TYPE, tensor)
    return _as_field(_ValueField.NAME, name.encode()) + _as_field(_ValueField.TYPE, kind)


def _replace(message: bytes | memoryview, path: tuple[int, ...],
             change: Callable[[memoryview], bytes]) -> bytes:
    """A message with every inner one at a path of field numbers changed."""
    parts: list[bytes | memoryview] = []
    for number, value, raw in _fields(memoryview(message)):
        if number == path[0] and not isinstance(value, int):
            new = _replace(value, path[1:], change) if path[1:] else change(value)
            parts.append(_as_field(number, new))
        else:
            parts.append(raw)
    return b"".join(parts)


def _as_varint(value: int) -> bytes:
    result = bytearray()
    while value > 0x7F:
        result.append(value & 0x7F | 0x80)
        value >>= 7
    return bytes([*result, value])


def _message(value: Field) -> memoryview:
    if isinstance(value, int):
        raise WireError("a number where a message should be")
    return value


# How a field's value is written: the three lowest bits before it.
VARINT = 0
FIXED64 = 1
BYTES = 2
FIXED32 = 5
_WIDTHS = {FIXED64: 8, FIXED32: 4}
_MOST_VARINT = 10  # bytes that 64 bits take


class WireError(ValueError):
    """The bytes are not a valid message: they are truncated, or hold an unknown wire type."""


class Wire:
    """Reads messages of one file, whose fields and members of integer fields are at most `most`: a
    file of many empty ones would take far more memory than it has bytes."""

    def __init__(self, most: int) -> None:
        self._left = most

    def fields(self, message: memoryview) -> Iterator[tuple[int, int | memoryview]]:
        """Number and value of each field: an integer for varints, raw bytes for anything else.

        The format is defined at https://protobuf.dev/programming-guides/encoding. Groups are not
        read.
        """
        for number, value, _ in _fields(message):
            self._count()
            yield number, value

    def integers(self, value: int | memoryview) -> Iterator[int]:
        """Members of a repeated integer field, one of them or many packed, as signed 64 bits."""
        at = 0
        while not isinstance(value, int) and at < len(value):
            item, at = _varint(value, at)
            self._count()
            yield _as_signed(item)
        if isinstance(value, int):
            yield _as_signed(value)

    def _count(self) -> None:
        self._left -= 1
        if self._left < 0:
            raise WireError("it has too many parts")


def _fields(message: memoryview) -> Iterator[tuple[int, int | memoryview, memoryview]]:
    """Number and value of each field, and all of its bytes."""
    at = 0
    while at < len(message):
        start = at
        key, at = _varint(message, at)
        number, kind = key >> 3, key & 7
        if kind == VARINT:
            value, at = _varint(message, at)
            yield number, value, message[start:at]
            continue
        if kind == BYTES:
            length, at = _varint(message, at)
        elif kind in _WIDTHS:
            length = _WIDTHS[kind]
        else:
            raise WireError(f"wire type {kind}")
        if length > len(message) - at:
            raise WireError("it ends early")
        yield number, message[at : at + length], message[start : at + length]
        at += length


def text(value: int | memoryview) -> str:
    """A string field; WireError when it is none."""
    if isinstance(value, int):
        raise WireError("a number where a name should be")
    try:
        return str(value, "utf-8")
    except UnicodeDecodeError as error:
        raise WireError("a name that is not UTF-8") from error


def _as_signed(value: int) -> int:
    return value - (1 << 64) if value >> 63 else value


def _varint(message: memoryview, at: int) -> tuple[int, int]:
    value = 0
    for index, byte in enumerate(message[at : at + _MOST_VARINT]):
        value |= (byte & 0x7F) << (7 * index)
        if byte < 0x80:
            return value & 0xFFFFFFFFFFFFFFFF, at + index + 1
    raise WireError("it ends early" if len(message) - at < _MOST_VARINT
                    else "a number of more than 64 bits")
