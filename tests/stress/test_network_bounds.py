"""Networks of every precision against float64 references of their own arithmetic, as ONNX defines it."""

from __future__ import annotations

import re

import numpy as np
import onnxruntime
import pytest

from postfx.paths import models_dir
from postfx.runtime import Device
from tests.stress.test_kernel_bounds import PAGE

onnx = pytest.importorskip("onnx")
pytest.importorskip("torch")

from onnx import TensorProto, numpy_helper  # noqa: E402
from onnx.reference import ReferenceEvaluator  # noqa: E402

from training.halve import pack  # noqa: E402

BOUNDS = {"fp32": (1e-5, 5e-6), "fp16": (1e-3, 5e-4), "int8": (0.05, 1e-4), "tone": (1e-6, 1e-6)}
"""Precision -> largest and root mean square error of an output, by those of its values. In int8 a value between two
steps may be rounded to either; in fp16 what comes out is rounded, and a CPU computes in float32."""
GPU_BOUNDS = {"fp32": (5e-3, 4e-3), "fp16": (5e-3, 4e-3), "tone": (5e-4, 2e-4)}
"""The same on a GPU, which multiplies in TensorFloat-32 where a CPU does in float32, and in halves in fp16."""
DENOISERS = sorted(path.stem for path in models_dir().glob("denoise_upscale.*.onnx"))
TONE_MAPPERS = ("tonemap.auto", "tonemap.local")
SIZE = (16, 32)
NARROW = {TensorProto.FLOAT, TensorProto.FLOAT16}
ROW = re.compile(r"^\| networks: (?P<kind>\w+)[^|]*\| (?P<most>\S+), (?P<rms>\S+) ", re.MULTILINE)


def widened(model: onnx.ModelProto) -> onnx.ModelProto:
    """The same graph and numbers with float64 in place of all narrower floats."""
    for value in (*model.graph.input, *model.graph.output):
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
        tensor.CopyFrom(numpy_helper.from_array(numpy_helper.to_array(tensor).astype(np.float64), tensor.name))


def arguments(model: onnx.ModelProto) -> dict[str, np.ndarray]:
    """Random inputs with the ranges of real ones; packed for a network that reads halves."""
    random, found = np.random.default_rng(0), {}
    for value in model.graph.input:
        sizes = [dim.dim_value for dim in value.type.tensor_type.shape.dim]
        if value.type.tensor_type.elem_type == TensorProto.FLOAT16:
            found[value.name] = pack(random.uniform(-0.5, 1.5, (1, sizes[3], *SIZE)).astype(np.float32))
        elif value.name == "lowres":
            found[value.name] = random.random(sizes, np.float32)
        else:
            found[value.name] = random.uniform(-0.5, 1.5, (1, sizes[1], *SIZE)).astype(np.float32)
    return found


def kind(name: str) -> str:
    return "tone" if name in TONE_MAPPERS else next((end for end in ("fp16", "int8") if end in name), "fp32")


@pytest.mark.parametrize("name", [*DENOISERS, *TONE_MAPPERS])
def test_error_of_networks(name: str) -> None:
    check(name, BOUNDS[kind(name)], "CPUExecutionProvider")


@pytest.mark.gpu
@pytest.mark.parametrize("name", [name for name in (*DENOISERS, *TONE_MAPPERS) if kind(name) in GPU_BOUNDS])
def test_error_of_networks_on_a_gpu(name: str, gpu: Device) -> None:
    check(name, GPU_BOUNDS[kind(name)], gpu.placement.provider)


def check(name: str, bounds: tuple[float, float], provider: str) -> None:
    """Hold what a provider makes of a network's random inputs to largest and root mean square errors."""
    path, (most, mean) = models_dir() / f"{name}.onnx", bounds
    model = onnx.load(path)
    reads = arguments(model)
    session = onnxruntime.InferenceSession(path, providers=[provider])
    outputs = [value.name for value in session.get_outputs()]
    found = session.run(outputs, reads)
    wide = {key: value.astype(np.float64) for key, value in reads.items()}
    with np.errstate(invalid="ignore"):  # beyond int32, which int8 clips right after
        exact = ReferenceEvaluator(widened(model)).run(outputs, wide)
    for output, value, wanted in zip(outputs, found, exact, strict=True):
        assert wanted.dtype == np.float64 and np.isfinite(value).all()
        error = np.abs(value - wanted)
        largest, typical = error.max() / np.abs(wanted).max(), np.sqrt(np.mean(error**2) / np.mean(wanted**2))
        print(f"{provider} {name}: {largest:.2g}, {typical:.2g} of {output}")
        assert largest <= most and typical <= mean, f"{output} {largest:.2g}, {typical:.2g}"


def test_the_table_has_the_bounds_that_are_asserted() -> None:
    rows = ROW.finditer(PAGE.read_text(encoding="utf-8"))
    assert {row["kind"]: (float(row["most"]), float(row["rms"])) for row in rows} == BOUNDS
