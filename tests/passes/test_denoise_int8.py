"""Variants in int8: they run in integers, and their pictures are those of the float network."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import onnxruntime
import pytest

import postfx
from postfx.frame import Role
from postfx.kernels.denoise.network_io import STORE_RINGED
from postfx.runtime import Library, ModelError
from postfx.system import models_dir

torch = pytest.importorskip("torch")

import onnx  # noqa: E402
from onnx import numpy_helper  # noqa: E402

from tests.passes.denoise_frames import guided, noisy  # noqa: E402
from training.datagen.clip_file import GUIDES, PLANES, save_clip  # noqa: E402
from training.denoise import quantise  # noqa: E402
from training.denoise.int8 import (  # noqa: E402
    LIMIT,
    LIMITS,
    Coding,
    Moments,
    Range,
    activations,
    convolutions,
    round_compensated,
    show,
    unfold_half,
)
from training.denoise.int8 import quantise as quantised  # noqa: E402
from training.denoise.quantise import best_range  # noqa: E402
from training.export import constant_value, lower_constants  # noqa: E402

NAMES = ("denoise_upscale.small", "denoise_upscale.small.guides", "denoise_upscale.low")
ROOM = Path(__file__).parents[2] / "samples/room/noisy.####.exr"


@pytest.fixture(scope="module")
def clips(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of two short clips of random planes, one with guides."""
    folder = tmp_path_factory.mktemp("clips")
    for name, with_guides in (("plain", False), ("guided", True)):
        frames = [guided(noisy(t, 40, 56), 80, 112) for t in (1, 2, 3)]
        variant = {plane: np.stack([f[Role(plane)].squeeze() for f in frames]) for plane in PLANES}
        variant |= {"jitter": [f.jitter for f in frames], "spp": 1, "style": "realtime"}
        facts = {"scale": 2.0, "seed": 1, "scene": "random", "meta": {}}
        if with_guides:
            held = {plane: np.stack([f.guides[Role(plane)].squeeze() for f in frames])
                    for plane in GUIDES}
            facts["guides"] = held | {"jitter": np.zeros((3, 2))}
        save_clip(folder / f"{name}.npz", np.zeros((3, 80, 112, 3)), [variant], facts)
    return folder


def integer_convolutions(path: Path, tmp_path: Path) -> int:
    """How many convolutions ONNX Runtime runs in integers."""
    options = onnxruntime.SessionOptions()
    options.optimized_model_filepath = str(tmp_path / "optimised.onnx")
    options.log_severity_level = 3
    onnxruntime.InferenceSession(str(path), options, providers=["CPUExecutionProvider"])
    nodes = onnx.load(tmp_path / "optimised.onnx").graph.node
    return sum(node.op_type == "QLinearConv" for node in nodes)


@pytest.mark.parametrize("name", [
    pytest.param(name, marks=[] if "guides" in name else pytest.mark.soak) for name in NAMES])
def test_variant_runs_in_integers_and_shows_the_same(
    name: str, small_models: Path, clips: Path, tmp_path: Path
) -> None:
    card = quantise.make_int8(name, Library(small_models), str(clips), tmp_path)
    assert card["name"] == quantise.variant_name(name, "int8")
    path = tmp_path / f"{card['name']}.onnx"
    assert integer_convolutions(path, tmp_path) == card["int8_layers"] == (6 if "low" in name
                                                                           else 11)
    assert card["difference"]["frames"] == (3 if "guides" in name else 6)
    assert card["difference"]["worst_psnr_db"] > 40
    assert path.stat().st_size < Library(small_models).path(name).stat().st_size
    assert Library(tmp_path).load(card["name"])  # holds the hash against the card's
    assert json.loads(path.with_suffix(".json").read_text())["precision"] == "int8"


def test_a_variant_without_its_card(tmp_path: Path) -> None:
    """Its metadata holds the constants by which kernels code what the network reads; where they are
    outputs, as in older files, it is the card that says which these are."""
    path = Path(shutil.copy(models_dir() / "denoise_upscale.s.int8.onnx", tmp_path))
    shots = [quantise.Shot(2.0, [noisy(1, 40, 56)])]
    found, wanted = (quantise.pictures(shots, Library(folder), path.stem)
                     for folder in (tmp_path, models_dir()))
    np.testing.assert_array_equal(found, wanted)
    path.write_bytes(lower_constants(onnx.load(path)).SerializeToString())
    with pytest.raises(
        ModelError,
        match="'denoise_upscale.s.int8'.*card.*coding_features.*training.denoise.quantise"
    ):
        quantise.pictures(shots, Library(tmp_path), "denoise_upscale.s.int8")


def test_frames_without_guides_are_an_error_for_a_network_that_reads_them(clips: Path,
                                                                          tmp_path: Path) -> None:
    (tmp_path / "plain.npz").symlink_to(clips / "plain.npz")
    with pytest.raises(ValueError, match="no clip with guides"):
        list(quantise.shots(str(tmp_path), ".guides"))


def test_frames_for_a_network_for_1x_are_not_enlarged(small_models: Path, clips: Path,
                                                      tmp_path: Path) -> None:
    """Whatever scale their references have."""
    for source in (str(clips), str(ROOM)):
        assert {shot.scale for shot in quantise.shots(source, ".1x")} == {1}
    shutil.copy(small_models / f"{NAMES[0]}.onnx", tmp_path / "denoise_upscale.small.1x.onnx")
    card = quantise.make_int8("denoise_upscale.small.1x", Library(tmp_path), str(clips), tmp_path)
    assert (card["name"], card["tag"]) == ("denoise_upscale.small.int8.1x", "small.int8.1x")
    assert (card["made_from"]["name"] == "denoise_upscale.small.1x"
            and card["difference"]["worst_psnr_db"] > 40)
    (shot,) = [quantise.Shot(1, [noisy(1, 40, 56)])]
    assert quantise.pictures([shot], Library(tmp_path), card["name"])[0].shape == (40, 56, 3)


def test_zero_is_kept_exactly_and_ranges_ignore_what_is_rare() -> None:
    for low, high in ((-1.0, 2.0), (0.0, 3.0), (0.5, 1.0), (-2.0, -1.0)):
        kept = Range.of(low, high)
        assert kept.decode(np.zeros(1)) == 0
        ends = np.array([min(low, 0), max(high, 0)])
        np.testing.assert_allclose(kept.decode(ends), ends, atol=kept.scale)
    values = np.append(np.random.default_rng(0).random(1_000_000), 10)
    assert best_range(values).scale * 255 < 7


def test_rounding_makes_up_for_itself() -> None:
    """By the moments of inputs that depend on each other; without moments it is that of each weight
    alone."""
    random = np.random.default_rng(0)
    weights = random.normal(0, 1, (8, 36))
    reads = (random.normal(0, 1, (4000, 6)) @ random.normal(0, 1, (6, 36))
             + 0.1 * random.normal(0, 1, (4000, 36)))
    moments = reads.T @ reads / len(reads)
    error = {name: np.square(reads @ (kept.factors * kept.steps[:, None] - weights).T).mean()
             for name, kept in (("alone", round_compensated(weights, 0 * moments)),
                                ("together", round_compensated(weights, moments)))}
    assert error["together"] < 0.2 * error["alone"]
    kept = round_compensated(weights, 0 * moments)
    assert (kept.factors == np.rint(kept.factors)).all() and np.abs(kept.factors).max() == LIMIT
    assert (np.abs(kept.factors * kept.steps[:, None] - weights)
            <= 0.501 * kept.steps[:, None]).all()


@pytest.mark.parametrize("name", NAMES)
def test_channels_of_more_equal_ranges_are_the_same_network(name: str, small_models: Path) -> None:
    model = unfold_half(lower_constants(onnx.load(small_models / f"{name}.onnx")))
    shown = list(quantise.find_groups(model.graph))
    assert set(activations(model.graph, quantise.layers_of(model.graph, name))) <= set(shown)
    random = np.random.default_rng(0)
    reads = {value.name: random.random((1, value.type.tensor_type.shape.dim[1].dim_value, 32, 48),
                                       np.float32)
             for value in model.graph.input}

    def run(some: onnx.ModelProto) -> list[np.ndarray]:
        session = onnxruntime.InferenceSession(some.SerializeToString(),
                                               providers=["CPUExecutionProvider"])
        return session.run(None, reads)

    reach = {tensor: np.abs(found).max((0, 2, 3))
             for tensor, found in zip(shown, run(show(model, shown)), strict=True)}
    equal = quantise.equalise(model,
                              {tensor: found / found.max() for tensor, found in reach.items()})
    for found, wanted in zip(run(equal), run(model), strict=True):
        np.testing.assert_allclose(found, wanted, rtol=1e-4, atol=1e-4 * np.abs(wanted).max())
    after = {tensor: np.abs(found).max((0, 2, 3))
             for tensor, found in zip(shown, run(show(equal, shown)), strict=True)}
    uneven = [[np.median(some[t][some[t] > 0]) / some[t].max() for t in shown]
              for some in (reach, after)]
    assert np.mean(uneven[1]) > 1.2 * np.mean(uneven[0])


@pytest.mark.parametrize("name", sorted(LIMITS))
def test_codes_of_planes_are_those_of_the_kernel(name: str) -> None:
    coding, ring = Coding.of(name), 1
    random = np.random.default_rng(0)
    planes = random.normal(0, 2, (1, len(LIMITS[name]), 6, 10)).astype(np.float32)
    planes[:, :, 0, :4] = np.array([np.nan, np.inf, -np.inf, 0])
    wanted = np.nan_to_num(planes, nan=0, posinf=1e9, neginf=-1e9)
    stored = np.empty((1, 8, 12, len(coding.scale)), np.uint8)
    STORE_RINGED.rows(0, 8, planes, np.stack(coding), stored)
    found = stored - coding.zero
    assert (found[:, [0, -1]] == 0).all() and (found[:, :, [0, -1]] == 0).all(), "the ring is zero"
    np.testing.assert_array_equal(found[:, ring:-ring, ring:-ring].transpose(0, 3, 1, 2),
                                  coding.codes(wanted))
    low, high = LIMITS[name].T[..., None, None]
    step = 1 / coding.scale[:len(low), None, None]
    held = np.clip(wanted, low - (low < 0) * step, high)
    assert (np.abs(coding.codes(wanted)[:, :len(low)] * step - held) <= 0.51 * step).all()


def test_a_channel_of_bias_alone_keeps_its_value(small_models: Path) -> None:
    model = unfold_half(onnx.load(small_models / f"{NAMES[0]}.onnx"))
    node = convolutions(model.graph, quantise.LAYERS)[0]
    weights = {weight.name: weight for weight in model.graph.initializer}
    weight = numpy_helper.to_array(weights[node.input[1]]).copy()
    weight[0] = 0
    weights[node.input[1]].CopyFrom(numpy_helper.from_array(weight, node.input[1]))
    ranges = dict.fromkeys(activations(model.graph, quantise.LAYERS), Range.of(-1, 1))
    kept = {}
    for one in convolutions(model.graph, quantise.LAYERS):
        moments, held = Moments.of(one), constant_value(model.graph, one.input[1])
        moments.add(np.random.default_rng(0).random((1, held.shape[1], 16, 16), np.float32))
        kept[one.input[1]] = moments.round_weights(held)
    graph = quantised(model, quantise.LAYERS, ranges, kept).graph
    small = {w.name: numpy_helper.to_array(w) for w in graph.initializer}
    name = node.input[2]
    found = small[f"{name}_quantised"][0] * small[f"{name}_scale"][0]
    assert found == pytest.approx(numpy_helper.to_array(weights[name])[0], rel=1e-5)


@pytest.mark.parametrize("path", sorted(models_dir().glob("*.int8*.json")),
                         ids=lambda path: path.stem)
def test_shipped_variant_is_made_from_the_shipped_network(path: Path) -> None:
    made_from = json.loads(path.read_text())["made_from"]
    assert (made_from["sha256"] == Library()
            .card(made_from["name"])["sha256"]), "run training.denoise.quantise again"


def test_shipped_variant_shows_the_room_as_the_float_network_does() -> None:
    shots = [quantise.Shot(2.0, list(postfx.read_sequence(ROOM, frames="1-3")))]
    results = [quantise.pictures(shots, Library(), f"denoise_upscale.{tag}")
               for tag in ("m.int8", "m")]
    assert quantise.difference(*results)["worst_psnr_db"] > 45
