"""Networks of every precision against float64 references of their own arithmetic, as ONNX defines
it."""

from __future__ import annotations

import re

import numpy as np
import onnxruntime
import pytest

from postfx.kernels.denoise.network_io import STORE
from postfx.passes.denoise.network import CODING, PACKED, PRODUCTS, RING, SCALING, STORED
from postfx.runtime import Device
from postfx.system import models_dir
from tests.stress.test_kernel_bounds import PAGE

onnx = pytest.importorskip("onnx")
pytest.importorskip("torch")

from onnx import TensorProto, numpy_helper  # noqa: E402
from onnx.reference import ReferenceEvaluator  # noqa: E402

from training.denoise.fp16 import pack  # noqa: E402
from training.export import constant_value, lower_constants  # noqa: E402

BOUNDS = {"fp32": (2e-5, 5e-6), "fp16": (1e-3, 5e-4), "int8": (0.05, 5e-3), "tone": (1e-6, 1e-6)}
"""Precision -> largest and root mean square error of an output, by those of its values. In int8 a
value between two steps may be rounded to either, and one such moves what follows it by steps; in
fp16 what comes out is rounded, and a CPU computes in float32."""
WIDER = {("denoise_upscale.s.1x", "greatest"): (5e-5, 2e-5),
         ("denoise_upscale.l", "greatest"): (2e-4, 2e-5)}
"""Network and VALUES -> the same, where sums are largest: all features at their greatest at once,
as in no frame. What rounding makes of them depends on the order in which a processor sums, too:
without AVX-512, a number of l is off by 1.4e-4."""
WIDER |= {(f"denoise_upscale.{tag}.fp16.1x", values): (5e-3, 1e-3)
          for tag in ("l", "xl") for values in ("greatest", "fireflies")}
"""Their planes are rounded between convolutions, too, where those of others are on a GPU alone."""
GPU_WIDER = {"denoise_upscale.xl": 2}
"""Network -> factor on its bounds on a GPU: its second filter's logits are larger than others'."""
GPU_BOUNDS = {"fp32": (5e-3, 4e-3), "fp16": (5e-3, 4e-3), "tone": (5e-4, 2e-4)}
"""The same on a GPU, which multiplies in TensorFloat-32 where a CPU does in float32, and in halves
in fp16, on random features; LOUDER times as much on others, which make logits large."""
LOUDER = 4
LEAST = {"picture": 0.01}
"""Output -> what its errors count against at least. A picture is made of light between 0 and 10, so
that one of 1e-5 in all is as exact as float32 is at 1."""
DENOISERS = sorted(path.stem for path in models_dir().glob("denoise_upscale.*.onnx"))
SOME = tuple(f"denoise_upscale.{tag}"
             for tag in ("s", "m.guides", "l", "m.fp16.guides", "s.int8", "m.int8.guides"))
"""Those of each precision, small and large, with guides and without; -m soak runs all."""
TONE_MAPPERS = ("tonemap.auto", "tonemap.local")
SIZE = (16, 32)
NARROW = {TensorProto.FLOAT, TensorProto.FLOAT16}
LOUD, FAST = np.log1p(1e4), np.log1p(1.4e5) / 4
"""What the most light that is kept and the longest motion come to."""
SEEN = [*6 * [(0, 2)], *3 * [(-1, 1)], (0, 1), (0, 1)]
"""Least and greatest of both albedos, normal, roughness and depth, as a network reads them."""
FEATURES = np.array([*9 * [(0, LOUD)], *SEEN, (-1, 1), (0, 1), (0, 1), *2 * [(-0.5, 0.5)],
                     (0, FAST), (0, 1), *8 * [(-1, 1)]])
RANGES = {"features": FEATURES, "first_features": FEATURES[:32], "last_features": FEATURES[32:],
          "guides": np.array(4 * SEEN), "mirrored": np.array([*3 * [(0, 1)], *3 * [(-1, 1)]]),
          "lowres": np.array(3 * [(0, 1)])}
"""Input -> least and greatest of each of its channels: what the kernels make of a frame, whatever
that holds."""
VALUES = ("random", "denormal", "greatest", "fireflies")
ROW = re.compile(r"^\| networks: (?P<kind>\w+)[^|]*\| (?P<most>\S+), (?P<rms>\S+) ", re.MULTILINE)


def widened(model: onnx.ModelProto) -> onnx.ModelProto:
    """The same graph and numbers with float64 in place of all narrower floats."""
    for value in (*model.graph.input, *model.graph.output):
        if value.type.tensor_type.elem_type in NARROW:
            value.type.tensor_type.elem_type = TensorProto.DOUBLE
    for weight in model.graph.initializer:
        _widen(weight)
    for node in model.graph.node:
        for attribute in node.attribute:
            _widen(attribute.t)
            if node.op_type == "Cast" and attribute.i in NARROW:
                attribute.i = TensorProto.DOUBLE
    return model


def _widen(tensor: onnx.TensorProto) -> None:
    if tensor.data_type in NARROW:
        tensor.CopyFrom(numpy_helper.from_array(numpy_helper.to_array(tensor).astype(np.float64),
                                                tensor.name))


def arguments(model: onnx.ModelProto, values: str) -> dict[str, np.ndarray]:
    """Inputs of a network that hold the VALUES of that name; packed for one that reads halves,
    stored for one that reads 8 bits."""
    random, found = np.random.default_rng(0), {}
    for value in model.graph.input:
        ranges = RANGES[value.name.removeprefix(PACKED).removeprefix(STORED)]
        size = (256, 256) if value.name == "lowres" else SIZE
        planes = filled(values, random, ranges[:, :1, None], ranges[:, 1:, None],
                        (1, len(ranges), *size))
        if value.name.startswith(STORED):
            planes = stored(model, value, planes)
        found[value.name] = pack(planes) if value.name.startswith(PACKED) else planes
    return found


def stored(model: onnx.ModelProto, value: onnx.ValueInfoProto, planes: np.ndarray) -> np.ndarray:
    """Planes as a network reads them in 8 bits."""
    coding = constant_value(model.graph, CODING + value.name.removeprefix(STORED))
    dims, ring = value.type.tensor_type.shape.dim, 2 * RING
    around = ring if dims[1].dim_param.startswith("ringed") else 0
    found = np.empty((1, *(side + around for side in SIZE), dims[3].dim_value), np.uint8)
    STORE.rows(0, found.shape[1], planes, coding, found)
    return found


def filled(values: str, random: np.random.Generator, least: np.ndarray, most: np.ndarray,
           shape: tuple[int, ...]) -> np.ndarray:
    """Planes of ``shape`` that hold the VALUES of that name, each channel between its ``least`` and
    its ``most``."""
    usual = random.uniform(-0.5, 1.5, shape).clip(least, most)
    planes = {"random": usual, "denormal": 1e-42, "greatest": most,
              "fireflies": np.where(random.random(shape) < 1 / 35, most, usual)}[values]
    return np.broadcast_to(planes, shape).astype(np.float32)


def kind(name: str) -> str:
    return ("tone" if name in TONE_MAPPERS
            else next((end for end in ("fp16", "int8") if end in name), "fp32"))


@pytest.mark.parametrize("name", [
    pytest.param(name, marks=[] if name in (*SOME, *TONE_MAPPERS) else pytest.mark.soak)
    for name in (*DENOISERS, *TONE_MAPPERS)])
def test_error_of_networks(name: str) -> None:
    check(name, {values: WIDER.get((name, values), BOUNDS[kind(name)]) for values in VALUES},
          "CPUExecutionProvider")


@pytest.mark.gpu
@pytest.mark.parametrize("name",
                         [name for name in (*DENOISERS, *TONE_MAPPERS) if kind(name) in GPU_BOUNDS])
def test_error_of_networks_on_a_gpu(name: str, gpu: Device) -> None:
    most, mean = (bound * GPU_WIDER.get(name, 1) for bound in GPU_BOUNDS[kind(name)])
    louder = {values: 1 if values == "random" else LOUDER for values in VALUES}
    check(name, {values: (more * most, more * mean) for values, more in louder.items()},
          gpu.placement.provider)


def check(name: str, bounds: dict[str, tuple[float, float]], provider: str) -> None:
    """Hold what a provider makes of a network's inputs to largest and root mean square errors, by
    VALUES."""
    model = lower_constants(onnx.load(models_dir() / f"{name}.onnx"))
    session = onnxruntime.InferenceSession(model.SerializeToString(), providers=[provider])
    inputs = {values: arguments(model, values) for values in bounds}
    outputs = [value.name for value in session.get_outputs()]
    reference = ReferenceEvaluator(widened(model))
    for values, (most, mean) in bounds.items():
        reads = inputs[values]
        found = session.run(outputs, reads)
        wide = {key: value if value.dtype == np.uint8 else value.astype(np.float64)
                for key, value in reads.items()}
        with np.errstate(invalid="ignore"):  # beyond int32, which int8 clips right after
            exact = reference.run(outputs, wide)
        for output, value, wanted in zip(outputs, scaled(outputs, found), scaled(outputs, exact),
                                         strict=True):
            assert wanted.dtype == np.float64 and np.isfinite(value).all(), values
            error, least = np.abs(value - wanted), LEAST.get(output, 0.0)
            largest = error.max() / max(np.abs(wanted).max(), least)
            typical = np.sqrt(np.mean(error**2)) / max(np.sqrt(np.mean(wanted**2)), least)
            print(f"{provider} {name}, {values}: {largest:.2g}, {typical:.2g} of {output}")
            assert largest <= most and typical <= mean, (f"{values}: {output} {largest:.2g}, "
                                                         f"{typical:.2g}")


def scaled(outputs: list[str], values: list[np.ndarray]) -> list[np.ndarray]:
    """Outputs with the logits in place of the products that they are scaled from."""
    known = dict(zip(outputs, values, strict=True))
    for name in [name for name in outputs if name.startswith(PRODUCTS)]:
        scale, bias = known[SCALING + name.removeprefix(PRODUCTS)][..., None]
        known[name] = known[name] * scale + bias
    return list(known.values())


def test_the_table_has_the_bounds_that_are_asserted() -> None:
    rows = ROW.finditer(PAGE.read_text(encoding="utf-8"))
    assert {row["kind"]: (float(row["most"]), float(row["rms"])) for row in rows} == BOUNDS


@pytest.mark.parametrize("name", [*DENOISERS, *TONE_MAPPERS])
def test_a_gpu_can_replay_a_network(name: str) -> None:
    """GatherND copies what the call holds in host memory, and the others may wait for the GPU: none
    of it may be in a graph that is captured once and replayed."""
    found = {node.op_type for node in onnx.load(models_dir() / f"{name}.onnx").graph.node}
    assert not found & {"GatherND", "ScatterND", "NonZero", "If", "Loop", "Scan"}
