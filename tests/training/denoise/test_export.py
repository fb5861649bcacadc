"""Export of the denoised upscaler: what is written is what was trained."""

from __future__ import annotations

import hashlib
import json
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from postfx.kernels.denoise.network_io import OPEN_PHASED
from postfx.passes.denoise.network import FINE_HEAD, PHASED_FINE
from postfx.runtime import Device, Library, ModelError
from postfx.system import models_dir

torch = pytest.importorskip("torch")

import onnx  # noqa: E402
import onnxruntime  # noqa: E402

from postfx.kernels.denoise.prepare import ACCUMULATE  # noqa: E402
from postfx.runtime.states import parse  # noqa: E402
from training.denoise import export as denoise_export  # noqa: E402
from training.denoise.checkpoint import pack, weights_of  # noqa: E402
from training.denoise.model import FEATURES, FINE, GUIDES, DenoiseUpscale, Trunk, TrunkConfig  # noqa: E402
from training.denoise.picture import LARGE, PictureConfig, layout_from  # noqa: E402
from training.denoise.residual import ResidualConfig, ResidualTrunk  # noqa: E402
from training.export import PARITY, ParityError, lower_constants, parity, relative_error  # noqa: E402

EXACT = sorted(path for path in models_dir().glob("denoise_upscale.*.onnx")
               if not {"int8", "fp16"} & {*path.stem.split(".")})
TINY = TrunkConfig((16, 16, 16, 16), 1)
CONFIGS = {"tiny.guides": replace(TINY, guides=True), "quad": replace(TINY, stem=24, reach=2),
           "low": TrunkConfig((16, 16), 2),
          "residual": ResidualConfig((16, 16, 16, 16, 16), (1, 1, 1, 1, 2), (1, 1, 1, 1))}


@pytest.fixture(scope="module", params=["tiny.guides", "residual", *(
    pytest.param(name, marks=pytest.mark.soak) for name in ("quad", "low"))])
def checkpoint(request: pytest.FixtureRequest) -> dict:
    """A checkpoint of a small network, as train.py writes them."""
    torch.manual_seed(0)
    config = CONFIGS[request.param]
    model = DenoiseUpscale(trunk=(ResidualTrunk if request.param == "residual" else Trunk)(config))
    weights = {key: value + 0.05 * torch.randn_like(value)
               for key, value in model.state_dict().items()}
    return {"config": model.config.as_dict(), "weights": weights, "notes": {"steps": 7}}


@pytest.fixture(scope="module")
def tag(checkpoint: dict) -> str:
    return next(tag for tag, config in CONFIGS.items() if config.as_dict() == checkpoint["config"])


@pytest.fixture(scope="module")
def name(tag: str) -> str:
    return f"denoise_upscale.{tag}"


@pytest.fixture(scope="module")
def folder(checkpoint: dict, tag: str, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What the command line leaves, without the kernels, which it would write as well."""
    folder = tmp_path_factory.mktemp("models")
    torch.save(checkpoint, folder / "checkpoint.pt")
    (folder / "quality.json").write_text('{"room": {"psnr": 30.5}}')
    arguments = ["export_denoise", "checkpoint.pt", "--tag", tag, "--quality", "quality.json",
                 "--models", "."]
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        patch.setattr(sys, "argv", arguments)
        patch.setattr(denoise_export, "KERNELS", {})
        denoise_export.main()
    return folder


def test_file_runs_as_the_network_at_any_size(checkpoint: dict, folder: Path, name: str) -> None:
    trunk = denoise_export.load_trunk(checkpoint)
    path = folder / f"{name}.onnx"
    for height, width in ((16, 16), (80, 32)):
        examples = denoise_export.example(trunk, height, width)
        exported = denoise_export.exported(trunk)
        assert parity(exported, path, examples, {"height": height, "width": width}) <= PARITY


def test_the_fine_head_is_opened_as_the_network_does(checkpoint: dict, folder: Path,
                                                     name: str) -> None:
    trunk = denoise_export.load_trunk(checkpoint)
    examples = denoise_export.example(trunk, 48, 32)
    session = onnxruntime.InferenceSession(folder / f"{name}.onnx",
                                           providers=["CPUExecutionProvider"])
    reads = {value.name: example.numpy()
             for value, example in zip(session.get_inputs(), examples, strict=True)}
    if name.endswith("residual"):
        fine = session.run([FINE_HEAD], reads)[0]
    else:
        fine = np.empty((1, FINE, 48, 32), np.float32)
        OPEN_PHASED.rows(0, 48, session.run([PHASED_FINE], reads)[0], fine)
    with torch.no_grad():
        assert relative_error(fine,
                              trunk(torch.cat(examples[:2], 1), *examples[2:])[0].numpy()) <= PARITY


def test_a_different_network_is_found_out(checkpoint: dict, folder: Path, name: str) -> None:
    trunk = denoise_export.load_trunk(checkpoint)
    with torch.no_grad():
        trunk.stem.weight *= 1.1
    with pytest.raises(ParityError, match="differs from torch by"):
        parity(denoise_export.exported(trunk), folder / f"{name}.onnx",
               denoise_export.example(trunk, 32, 32))


def test_sizes_are_fixed_by_name(checkpoint: dict, folder: Path, name: str) -> None:
    device = Device("cpu")
    state = device.pipeline_state(Library(folder), name, {"height": 48, "width": 80})
    shapes = {binding.name: binding.shape for binding in state.bindings}
    assert (shapes["first_features"], shapes["last_features"]) == ((1, 32, 48, 80),
                                                                   (1, FEATURES - 32, 48, 80))
    assert shapes.get("guides") == ((1, GUIDES, 48, 80) if checkpoint["config"]["guides"] else None)
    computed, alike = {3: (6, 10), 4: (3, 5)}, {"level3": (1, 26, 1, 1), "level4": (1, 25, 1, 1)}
    computed, alike = ({}, alike) if name.endswith(".low") else (computed, {})
    assert shapes.get("mirrored") == ((1, 6, 48, 80) if checkpoint["config"].get("mirrored")
                                      else None)
    assert {i: shapes[f"level{i}"][2:] for i in (1, 2, *computed)} == {1: (24, 40), 2: (12, 20),
                                                                       **computed}
    assert {name: array.shape for name, array in state.constants.items()} == alike
    with pytest.raises(ModelError, match="width"):
        device.pipeline_state(Library(folder), name, {"height": 48})


def test_file_is_one_and_tells_nothing_of_the_machine(folder: Path, name: str) -> None:
    path = folder / f"{name}.onnx"
    model = onnx.load(path, load_external_data=False)
    assert not any(tensor.data_location == onnx.TensorProto.EXTERNAL
                   for tensor in model.graph.initializer)
    assert not any(node.metadata_props or node.doc_string for node in model.graph.node)
    assert str(Path(__file__).parents[3]).encode() not in path.read_bytes()


def test_card_says_what_the_file_is(checkpoint: dict, folder: Path, name: str) -> None:
    card = json.loads((folder / f"{name}.json").read_text())
    content = (folder / f"{name}.onnx").read_bytes()
    assert card["sha256"] == hashlib.sha256(content).hexdigest()
    assert card["name"] == name and card["pass"] == "denoise_upscale"
    assert card["parameters"] == sum(weight.numel() for weight in checkpoint["weights"].values())
    assert card["training"]["steps"] == 7
    assert card["quality"] == {"room": {"psnr": 30.5}}
    assert card["parity"]["max_relative_error"] <= PARITY
    graph = onnx.load_from_string(content).graph
    assert set(card["inputs"]) == {value.name for value in graph.input}
    assert {value for value, told in card["outputs"].items() if not told.get("constant")} == {
        value.name for value in graph.output}
    whole = lower_constants(onnx.load_from_string(content)).graph
    assert set(card["outputs"]) == {value.name for value in whole.output}


@pytest.mark.parametrize("path", EXACT, ids=lambda path: path.stem)
def test_shipped_model_is_the_one_on_its_card(path: Path) -> None:
    card = json.loads(path.with_suffix(".json").read_text())
    assert hashlib.sha256(path.read_bytes()).hexdigest() == card["sha256"]
    assert card["name"] == path.stem == f"denoise_upscale.{card['tag']}"
    assert card["parity"]["max_relative_error"] <= PARITY


@pytest.mark.parametrize("path", [path for path in EXACT if path.stem.endswith(".1x")],
                         ids=lambda path: path.stem)
def test_shipped_model_for_1x_is_the_plain_one_with_other_weights(path: Path) -> None:
    card = json.loads(path.with_suffix(".json").read_text())
    if "picture" in card["outputs"]:  # a layout of its own
        made = layout_from(card["config"])
        parts = ("gated", "detailed", "deep", "averaged", "filtered", "guarded")
        added = dict.fromkeys(parts, False)
        made = replace(made, **added, error_slope=1.0, error_bias=0.0)
        assert made in (PictureConfig(), replace(LARGE, **added))
        assert card["training"]["start"].startswith("Open Image Denoise")
        return
    plain = json.loads(path.with_name(f"{path.stem.removesuffix('.1x')}.json").read_text())
    assert card["sha256"] != plain["sha256"]
    assert all(card[part] == plain[part] for part in ("parameters", "inputs", "outputs"))
    assert TrunkConfig.from_dict(card["config"]) == TrunkConfig.from_dict(plain["config"])


def test_summary_says_what_a_network_is_for(checkpoint: dict) -> None:
    found = [denoise_export.card(checkpoint, tag, 0.0, {})["summary"]
             for tag in ("m", "m.1x", "m.guides")]
    assert [text.removeprefix("recurrent denoised upscaler, ") for text in found] == [
        "1x to 3x", "for 1x", "1x to 3x, guides at output size"]


RUN = {"step": 7, "seconds": 1.0, "seed": 0, "commit": "none", "arguments": {}}


def test_a_packed_state_is_the_same_network(checkpoint: dict) -> None:
    packed = pack(checkpoint | RUN | {"live": checkpoint["weights"]})
    trunk, wanted = (denoise_export.load_trunk(each) for each in (packed, checkpoint))
    assert type(trunk) is type(wanted) and trunk.config == wanted.config
    for (name, weight), (other, expected) in zip(trunk.state_dict().items(),
                                                 wanted.state_dict().items(), strict=True):
        assert name == other and torch.equal(weight, expected), name


@pytest.mark.soak
def test_a_packed_state_is_exported_alike(checkpoint: dict, folder: Path, name: str) -> None:
    packed = pack(checkpoint | RUN | {"live": checkpoint["weights"]})
    path = folder / "packed.onnx"
    denoise_export.export_trunk(denoise_export.load_trunk(packed), path)
    assert path.read_bytes() == (folder / f"{name}.onnx").read_bytes()
    assert denoise_export.card(packed, "packed", 0.0, {})["parameters"] == sum(
        weight.numel() for weight in checkpoint["weights"].values())


def test_a_card_says_how_far_a_residual_network_sees() -> None:
    config = ResidualConfig((8, 8, 8, 8, 8), (1, 1, 1, 1, 1), (1, 1, 1, 1))
    trunk = ResidualTrunk(config).eval()
    planes = [torch.zeros(1, 35, 16, 512), torch.zeros(1, 6, 16, 512)]
    changed = [planes[0].index_fill(3, torch.tensor([256]), 1), planes[1]]
    with torch.no_grad():
        differ = (trunk(*planes)[0] != trunk(*changed)[0]).any(1).nonzero()[:, 2]
    assert (256 - config.reach - 16 <= int(differ.min())
            and int(differ.max()) <= 256 + config.reach + 16)
    small = replace(config, down=(0,) * 5, up=(0,) * 4)
    for layout, halo in ((config, denoise_export.HALO), (small, small.sees)):
        bare = {"config": layout.as_dict(), "weights": {}, "notes": {}}
        assert denoise_export.card(bare, "l.1x", 0.0, {})["halo"] == halo


def test_relative_error() -> None:
    assert relative_error(np.array([1.0, 2.2]), np.array([1.0, 2.0])) == pytest.approx(0.1)
    assert relative_error(np.zeros(2), np.zeros(3)) == float("inf")


def test_training_goes_on_from_the_exported_network(folder: Path, name: str,
                                                    checkpoint: dict) -> None:
    weights = weights_of(folder / f"{name}.onnx")
    assert weights.keys() == checkpoint["weights"].keys()
    for key, value in checkpoint["weights"].items():
        torch.testing.assert_close(weights[key], value, rtol=1e-3, atol=1e-6)


def test_every_free_size_of_a_kernel_has_a_value_to_trace_with() -> None:
    """One without would be traced as 1, which says nothing of larger sizes."""
    for kernel in denoise_export.KERNELS:
        sizes = [parse(size) for name in kernel.reads for size in kernel.shapes[name]]
        assert {size.symbol for size in sizes if size.symbol} <= set(denoise_export.SIZES), kernel


@pytest.mark.filterwarnings("ignore::FutureWarning")
@pytest.mark.soak
def test_a_kernel_whose_channels_are_free_is_exported(tmp_path: Path) -> None:
    kernel = ACCUMULATE
    denoise_export.export_kernel(kernel, denoise_export.KERNELS[kernel](), denoise_export.SIZES,
                                 tmp_path)
    assert (tmp_path / f"{kernel.name}.onnx").stat().st_size > 1000
