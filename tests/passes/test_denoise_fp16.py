"""Variants in float16: a small file with the float32 network's weights, in types that a GPU
runs."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from postfx.kernels import Kernel, find_source
from postfx.runtime import Device, Library, ModelError
from postfx.runtime.states import CompiledComputeState
from postfx.system import models_dir

torch = pytest.importorskip("torch")

import onnx  # noqa: E402
from onnx import TensorProto, shape_inference  # noqa: E402

from tests.passes.denoise_frames import guided, noisy  # noqa: E402
from training.denoise import fp16  # noqa: E402
from training.denoise.quantise import Shot, difference, pictures  # noqa: E402
from training.export import ParityError, write_card  # noqa: E402

NAMES = ("denoise_upscale.small", "denoise_upscale.small.guides", "denoise_upscale.low")


@pytest.fixture(scope="module")
def folder(exported_models: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of the small networks in both precisions."""
    folder = tmp_path_factory.mktemp("half")
    for name in NAMES:
        for path in exported_models.glob(f"{name}.[jo]*"):
            shutil.copy(path, folder)
        card = Library(folder).card(name) or {"name": name}
        write_card(folder / f"{name}.onnx", card | {"quality": {"measured": "in float32"}})
        fp16.make_fp16(name, folder)
    return folder


@pytest.mark.parametrize("name", NAMES)
def test_all_arithmetic_is_in_half_precision(folder: Path, name: str) -> None:
    model = onnx.load(folder / f"{fp16.variant_name(name, 'fp16')}.onnx", load_external_data=True)
    graph = shape_inference.infer_shapes(model).graph
    types = {value.name: value.type.tensor_type.elem_type
             for value in (*graph.value_info, *graph.input, *graph.output)}
    constants = {weight.name for weight in graph.initializer}
    assert {kind for name, kind in types.items() if name not in constants} == {TensorProto.FLOAT16}
    assert not any(node.op_type == "Cast" for node in graph.node)
    sizes = {value.name: [dim.dim_value for dim in value.type.tensor_type.shape.dim]
             for value in graph.input}
    assert all(name.startswith("packed_") and size[-1] % 8 == 0 for name, size in sizes.items())


@pytest.mark.parametrize("name", NAMES)
def test_small_file_gives_the_same_pictures(folder: Path, name: str, small_models: Path) -> None:
    """As far as a CPU can tell, which computes in float32."""
    half = fp16.variant_name(name, "fp16")
    assert (folder / f"{half}.onnx").stat().st_size < 0.6 * (folder / f"{name}.onnx").stat().st_size
    frames = [guided(noisy(t), 74, 100) if name.endswith("guides") else noisy(t) for t in (1, 2)]
    results = [pictures([Shot(2.0, frames)], Library(folder), variant) for variant in (half, name)]
    assert difference(*results)["worst_psnr_db"] > 60


@pytest.mark.parametrize(("name", "scale"), [
    ("denoise_upscale.small", 1.0), ("denoise_upscale.small", 2.0),
    ("denoise_upscale.small.guides", 2.0)])
def test_kernels_around_half_precision_on_a_gpu(
    name: str, scale: float, folder: Path, small_models: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Two frames, the second of which has a history. All kernels are written for CUDA: by its
    portable form ONNX Runtime takes ten times as long. Their rows stand for a GPU, and give the
    same pictures."""
    frames = [guided(noisy(t), 74, 100) if name.endswith("guides") else noisy(t) for t in (1, 2)]
    shots, tag = [Shot(scale, frames)], fp16.variant_name(name, "fp16")
    plain = pictures(shots, Library(folder), tag)
    kernels: list[Kernel] = []

    def make_state(device: Device, kernel: Kernel) -> CompiledComputeState:
        kernels.append(kernel)
        return CompiledComputeState(device, kernel)

    monkeypatch.setattr(Device, "gpu", SimpleNamespace(convolves=False))
    monkeypatch.setattr(Device, "_make_state", make_state)
    found = difference(pictures(shots, Library(folder), tag), plain)
    assert 80 < found["worst_psnr_db"] < 200, "close, yet other kernels"
    assert not [kernel.name for kernel in kernels if find_source(kernel) is None]
    assert {kernel.name for kernel in kernels} > {"denoise_open_half", "denoise_open_fine_half",
                                                  "denoise_pools"}


def test_a_network_for_1x_shares_the_weights_of_its_own(folder: Path, tmp_path: Path,
                                                        small_models: Path) -> None:
    name = "denoise_upscale.small.1x"
    shutil.copy(folder / f"{NAMES[0]}.onnx", tmp_path / f"{name}.onnx")
    card = fp16.make_fp16(name, tmp_path)
    assert (card["name"], list(card["weights"])) == ("denoise_upscale.small.fp16.1x",
                                                     [f"{name}.onnx"])
    assert Library(tmp_path).load(card["name"])
    results = [pictures([Shot(1, [noisy(1)])], Library(tmp_path), variant)
               for variant in (card["name"], name)]
    assert difference(*results)["worst_psnr_db"] > 60


def test_card_tells_the_precision_and_nothing_measured_in_another(folder: Path) -> None:
    card = json.loads((folder / "denoise_upscale.small.fp16.json").read_text())
    assert (card["precision"], card["tag"]) == ("fp16", "small.fp16")
    assert card["parity"]["max_relative_error"] <= fp16.TOLERANCE
    assert "quality" not in card


def test_weights_of_another_export_are_refused(folder: Path, tmp_path: Path) -> None:
    for path in folder.glob("denoise_upscale.small.*"):
        shutil.copy(path, tmp_path)
    with (tmp_path / "denoise_upscale.small.onnx").open("ab") as file:
        file.write(b"\0")
    with pytest.raises(ModelError, match="small.onnx' is not the file that its card describes"):
        Library(tmp_path).load("denoise_upscale.small.fp16")
    (tmp_path / "denoise_upscale.small.onnx").unlink()
    with pytest.raises(ModelError, match="small.onnx' is not a file"):
        Device("cpu").pipeline_state(Library(tmp_path), "denoise_upscale.small.fp16",
                                     {"height": 16, "width": 16})


def test_a_network_beyond_half_precision_is_found_out(folder: Path) -> None:
    model = onnx.load(folder / "denoise_upscale.small.onnx")
    half = fp16.halve(model)
    bias = next(weight for weight in half.graph.initializer if weight.name == "stems.0.bias")
    bias.CopyFrom(onnx.numpy_helper.from_array(np.full(16, np.inf, np.float16), bias.name))
    with pytest.raises(ParityError, match="half precision differs"):
        fp16.difference(half, model)


@pytest.mark.parametrize("path", sorted(models_dir().glob("*.fp16*.json")),
                         ids=lambda path: path.stem)
def test_shipped_variant_fits_the_shipped_weights(path: Path) -> None:
    assert Library().load(path.stem), "run training.denoise.fp16 again"
