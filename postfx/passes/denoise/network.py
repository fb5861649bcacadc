"""A network of the denoiser: the names of its inputs and outputs, and the forms that they have.

Networks in float32 read and write planes. Networks in half precision have channels last, and so
have 8-bit networks, whose outputs may be integer products. The names of inputs and outputs begin
with the form that they have; kernels bring planes into it, and back.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping

import numpy as np

from postfx.kernels.denoise import FEATURES, FINE, GUIDES, MIRRORED
from postfx.kernels.denoise.network_io import FOURS, SOME, opened_shape
from postfx.passes.denoise.graph import Each
from postfx.runtime import ModelError, PipelineState, Tensor
from postfx.runtime.tensor import TensorHeap

PACKED = "packed_"
"""Prefix of the names of inputs in half precision, channels last."""
RAW = "raw_"
"""Prefix of the names of outputs in half precision, channels last."""
PHASED_FINE = "phased_fine"
"""The fine head in float32 before its activations, with the four phases of each channel in a
row."""
FINE_HEAD = "fine"
"""The fine head as filters read it, of a network whose last level has the render size."""
ERROR = "error"
"""The logarithm of each pixel's expected squared error."""
PICTURE = "picture"
"""Output of a network that gives the picture itself: log(1 + exposed light)."""
CONTROLS_NAME = "controls"
"""Output of such a network that controls the picture and the history."""
STORED = "stored_"
"""Prefix of the names of 8-bit inputs, channels last."""
CODING = "coding_"
"""Prefix of the names of the constants that tell how 8-bit inputs are coded."""
PRODUCTS = "products_"
"""Prefix of the names of integer outputs, (C, h * w)."""
SCALING = "scaling_"
"""Prefix of the names of the constants that scale integer outputs."""
CODES_NAME = "codes_"
"""Prefix of the names of 8-bit outputs, channels last, of which kernels make such products."""
RING = 1
"""Border in pixels around 8-bit inputs, for networks whose first convolution reads beyond the
picture."""
OUTPUT_WORDS = {PHASED_FINE: "phased", RAW: "raw", PRODUCTS: "sums"}
"""Beginning of an output's name -> word of `graph` for the kernel that opens it."""
MADE = (PACKED, RAW, PHASED_FINE, STORED, PRODUCTS, CODES_NAME)
CHANNELS = {"features": FEATURES, "guides": GUIDES, "mirrored": MIRRORED}
FEATURE_PARTS = {"first_features": 32, "last_features": FEATURES - 32}
"""Feature channels that float32 networks read as inputs of their own: a CPU is fastest with few, or
multiples of 16."""


def free_dimensions(size: tuple[int, int]) -> dict[str, int]:
    """Sizes of the dimensions that networks leave free: height and width of the features, and of
    features with a border."""
    (h, w), ring = size, 2 * RING
    return {"height": h, "width": w, "ringed_height": h + ring, "ringed_width": w + ring}


def stored_channels(name: str) -> int:
    """Number of channels of 'features' or 'guides' in 8 bits."""
    return -(-CHANNELS[name] // 4) * 4


def seen_by(state: PipelineState) -> dict[str, tuple[int, ...]]:
    """Shapes of the planes that kernels prepare for a network, by name: 'features', 'guides' and
    'mirrored'."""
    seen = dict[str, tuple[int, ...]]()
    for binding in state.bindings:
        name, size = binding.name.removeprefix(PACKED), state.shapes[binding.name]
        if name in FEATURE_PARTS:
            seen["features"] = (1, CHANNELS["features"], *size[2:])
        elif name.startswith(STORED):  # with a border of one pixel, or without
            name = name.removeprefix(STORED)
            seen[name] = (1, CHANNELS[name], state.dims["height"], state.dims["width"])
        elif binding.access == "read":
            seen[name] = size if name == binding.name else (1, CHANNELS[name], *size[1:3])
    return seen


def parts_of(features: Tensor) -> dict[str, Tensor]:
    """Parts of the features by name, no copies."""
    parts, first, size = {}, 0, features.shape[2:]
    for name, count in FEATURE_PARTS.items():
        parts[name] = features.view(name, (1, count, *size), first * math.prod(size))
        first += count
    return parts


def heads_of(state: PipelineState) -> dict[str, tuple[int, ...]]:
    """Shapes of a network's heads after their activations, by name."""
    heads, seen = dict[str, tuple[int, ...]](), seen_by(state)["features"][2:]
    counts = {binding.name: state.shapes[binding.name][0] for binding in state.bindings
              if binding.name.startswith(PRODUCTS)}
    counts |= {output: len(product.factors) for output, product in state.products.items()}
    for output, count in counts.items():
        name = output.removeprefix(PRODUCTS)
        heads[name] = ((1, FINE, *seen) if name == "fine"
                       else (1, count, *(side >> int(name[-1]) for side in seen)))
    for binding in state.bindings:
        name, size = binding.name.removeprefix(RAW), state.shapes[binding.name]
        if binding.name == PHASED_FINE:
            heads["fine"] = opened_shape("fine", *size[2:])
        elif binding.access == "write" and not binding.name.startswith((PRODUCTS, CODES_NAME)):
            heads[name] = size if name == binding.name else opened_shape(name, *size[1:3])
    return heads


def check_bindings(state: PipelineState) -> None:
    """ModelError for a network that is not a denoiser. Kernels prepare its inputs and take its
    outputs by name."""
    coded = re.compile(f"^({PACKED}|{RAW}|{STORED}|{PRODUCTS}|{CODES_NAME})")
    plain = {binding.name: coded.sub("", binding.name) for binding in state.bindings}
    reads = {b.name for b in state.bindings if b.access == "read"}
    strange = [name for name in reads if plain[name] not in (*CHANNELS, *FEATURE_PARTS)]
    gives = {plain[b.name] for b in state.bindings if b.access == "write"} | set(state.constants)
    if (strange or "features" not in seen_by(state)
        or not {FINE_HEAD, PHASED_FINE, PICTURE} & gives):
        raise ModelError(f"model '{state.name}' is not a denoiser: it reads "
                         f"{', '.join(sorted(reads)) or 'nothing'} and gives "
                         f"{', '.join(sorted(gives)) or 'nothing'}; training.denoise.export makes "
                         "one")


def alike_heads(state: PipelineState) -> dict[str, np.ndarray]:
    """Heads of the levels that a network does not compute: (1, C, 1, 1) by name, the same for all
    pixels."""
    return {name: array
            for name, array in state.constants.items() if not name.startswith((CODING, SCALING))}


class Network:
    """A network with its tensors: what steps of `graph` run over.

    Args:
        state: the network.
        seen: the planes that it reads, by name.
        heads: the heads that it makes, by name.
        new: makes a tensor in between, of a name, shape and type.

    Attributes:
        stored: tensors of the kernel that makes features in 8 bits, by its bindings; empty for
            other networks.
        coded: tensors of the kernels that make the fine head themselves, by their bindings; empty
            if the network makes it.
        over: its inputs, itself and its outputs, by the names that `graph` gives them.
    """

    def __init__(self, state: PipelineState, seen: Mapping[str, Tensor],
                 heads: Mapping[str, Tensor],
                 new: Callable[[str, tuple[int, ...], str], Tensor]) -> None:
        self._refuse_unmarked(state)
        heap = state.device.heap
        made = {b.name: heads.get(b.name) or new(b.name, state.shapes[b.name], b.dtype)
                for b in state.bindings if b.name.startswith(MADE)}
        constants = {name: upload(heap, name, array) for name, array in state.constants.items()
                     if name.startswith((CODING, SCALING))}
        known = {**parts_of(seen["features"]), **seen, **heads, **made}
        packed = [name for name in made if name.startswith((PACKED, STORED)) and name not in seen]
        self.stored = dict[str, Tensor]()
        if codes_features(state):
            name = f"{STORED}features"
            packed.remove(name)
            self.stored = {"coding": constants[f"{CODING}features"], "stored": made[name]}
        outputs = [one for name, closed in made.items() if name.startswith((*OUTPUT_WORDS,))
                   for one in _outputs(closed, constants, heads)]
        self.coded: dict[str, Tensor] = {}
        for output, product in state.products.items():
            name = output.removeprefix(PRODUCTS)
            coded = {"codes": made[product.codes], "scaling": constants[f"{SCALING}{name}"],
                     "factors": upload(heap, f"factors {name}", _in_fours(product.factors),
                                       "int8")}
            outputs.append(_coded_output(name, coded, heads[name]))
            if name == "fine":
                self.coded = coded
        itself = Each(buffers={binding.name: known[binding.name] for binding in state.bindings},
                      network=state)
        self.over = {"inputs": [_input(made[name], constants, seen) for name in packed],
                     "network": [itself], "outputs": outputs}

    @staticmethod
    def _refuse_unmarked(state: PipelineState) -> None:
        """ModelError if constants of a network are among its outputs, because no card beside it
        marks them."""
        unmarked = [binding.name for binding in state.bindings
                    if binding.name.startswith((CODING, SCALING))]
        if unmarked:
            raise ModelError(f"network '{state.name}': no card beside it marks "
                             f"{', '.join(unmarked)} as constant; take the card that it was made "
                             "with, or make both again with training.denoise.quantise")


def _in_fours(factors: np.ndarray) -> np.ndarray:
    """Factors (n, C), with zeros added up to whole groups of four."""
    return np.pad(factors, ((0, -len(factors) % FOURS), (0, 0)))


def _input(closed: Tensor, constants: Mapping[str, Tensor], seen: Mapping[str, Tensor]) -> Each:
    """An input in the network's form, which a kernel makes of a plane."""
    if closed.name.startswith(PACKED):
        planes = seen[closed.name.removeprefix(PACKED)]
        return Each(frozenset({"halves"}), {"planes": planes, "closed": closed})
    name = closed.name.removeprefix(STORED)
    words = {"codes"} if closed.shape[1] == seen[name].shape[2] else {"codes", "ringed"}
    return Each(frozenset(words), {"planes": seen[name], "coding": constants[f"{CODING}{name}"],
                                   "closed": closed})


def _outputs(closed: Tensor, constants: Mapping[str, Tensor],
             heads: Mapping[str, Tensor]) -> list[Each]:
    """An output in the network's form, which a kernel makes a head of: one or several runs."""
    begin = next(begin for begin in OUTPUT_WORDS if closed.name.startswith(begin))
    name = closed.name.removeprefix(begin) or "fine"
    words, head = frozenset({OUTPUT_WORDS[begin]} | {"fine"} & {name}), heads[name]
    if begin != PRODUCTS:
        return [Each(words, {"closed": closed, "head": head})]
    scaling = constants[f"{SCALING}{name}"]
    if name != "fine":
        products = closed.view(closed.name, head.shape)
        return [Each(words, {"closed": products, "head": head, "scaling": scaling})]
    _, count, rows, columns = head.shape
    if closed.name not in heads:
        products = closed.view(closed.name, (1, closed.shape[0], rows // 2, columns // 2))
        return [Each(words, {"closed": products, "head": head, "scaling": scaling})]
    runs = []
    for channel in range(0, count, SOME):
        some, at = min(SOME, count - channel), channel * rows * columns
        first = upload(closed.device.heap, "first", np.full(1, channel, np.float32))
        products = closed.view(closed.name, (1, 4 * some, rows // 2, columns // 2), at)
        opened = head.view("fine", (1, some, rows, columns), at)
        runs.append(Each(words | {"behind"}, {"closed": products, "head": opened, "first": first,
                                              "scaling": scaling}))
    return runs


def _coded_output(name: str, coded: Mapping[str, Tensor], head: Tensor) -> Each:
    """A head that a kernel makes of an output in 8 bits."""
    _, count, rows, columns = head.shape
    opened = (head.view("fine", (1, count, rows // 2, 2, columns)) if name == "fine" else head)
    return Each(frozenset({"codes"} | {"fine"} & {name}),
                {**coded, "closed": coded["codes"], "head": opened})


def upload(heap: TensorHeap, name: str, array: np.ndarray, dtype: str = "float32") -> Tensor:
    """A tensor that holds an array from now on."""
    tensor = heap.tensor(name, array.shape, dtype)
    tensor.upload(array)
    return tensor


def is_half(state: PipelineState) -> bool:
    """Whether heads and features stay in half precision: beside such a network on a GPU."""
    return state.device.gpu is not None and f"{PACKED}features" in state.shapes


def codes_features(state: PipelineState) -> bool:
    """Whether the features are made in 8 bits: for such a network on a CPU."""
    return state.device.runs_rows and f"{STORED}features" in state.shapes
