"""Which network runs for a tag."""

from __future__ import annotations

import re
import shutil
from importlib import import_module
from pathlib import Path
from pkgutil import iter_modules

import numpy as np
import pytest

from postfx.errors import ModelError, PassOptionError, PostfxError
from postfx.frame import FrameSpec, Role
from postfx.kernels import Kernel
from postfx.kernels import denoise as kernels
from postfx.passes.denoise import DenoiseUpscale, graph
from postfx.passes.denoise.graph import WINDOW_STEPS, KernelStep, kernels_of, shapes_of
from postfx.passes.denoise.ladder import family
from postfx.passes.denoise.models import (
    CLASSIC,
    GUIDED,
    exact,
    model_of,
    split_ending,
    validate_tag,
)
from postfx.pipeline import Pipeline
from postfx.runs.run import provenance_of
from postfx.runtime import Device, Library
from postfx.system import models_dir
from tests import toys
from tests.passes.denoise_frames import noisy

CPU = Device("cpu", threads=2)


class Remote:
    """Memory that the host does not see."""

    host_visible = False


@pytest.mark.parametrize(("tag", "ending", "model"), [
    ("m", "", "denoise_upscale.m.int8"),
    ("m", GUIDED, "denoise_upscale.m.int8.guides"),
    ("m.fp32", "", "denoise_upscale.m"),
    ("m.fp32", GUIDED, "denoise_upscale.m.guides"),
    ("s.int8", "", "denoise_upscale.s.int8"),
    ("mine", "", "denoise_upscale.mine"),
])
def test_a_cpu_runs_integers_unless_asked_otherwise(tag: str, ending: str, model: str) -> None:
    assert model_of(tag, ending, CPU) == model


def test_a_gpu_runs_half_precision_unless_asked_otherwise(monkeypatch: pytest.MonkeyPatch) -> None:
    device = Device("cpu", threads=1)
    monkeypatch.setattr(device, "memory", Remote())
    assert model_of("m", "", device) == "denoise_upscale.m.fp16"
    assert model_of("m.fp32", "", device) == "denoise_upscale.m"


def test_a_network_without_another_precision_runs_as_it_is(small_models: Path) -> None:
    assert model_of("small", "", CPU) == model_of("small") == "denoise_upscale.small"


def test_tags_of_the_float_network() -> None:
    assert [exact(tag) for tag in ("m", "m.int8", "m.fp32")] == ["m.fp32", "m.int8", "m.fp32"]


def test_endings_of_networks_that_are_taken_by_themselves() -> None:
    found = [split_ending(name)
             for name in ("m", "m.int8.1x", "denoise_upscale.m.fp16.guides", "m.fp32")]
    assert found == [("m", ""), ("m.int8", ".1x"), ("denoise_upscale.m.fp16", ".guides"),
                     ("m.fp32", "")]


def test_both_precisions_give_nearly_the_same() -> None:
    frame = noisy(1)
    results = [Pipeline([DenoiseUpscale(scale=2, model=tag)], CPU, exposure=0.0)(frame)[Role.COLOUR]
               for tag in ("s", "s.int8", "s.fp32")]
    np.testing.assert_array_equal(results[0], results[1])
    error = np.abs(results[0] - results[2]).mean() / np.abs(results[2]).mean()
    assert 0 < error < 0.1


def colour_of(**options: object) -> np.ndarray:
    return Pipeline([DenoiseUpscale(**{"scale": 2, **options})], CPU,
                    exposure=0.0)(noisy(1))[Role.COLOUR]


@pytest.fixture
def nets(tmp_path: Path) -> Path:
    """A folder of networks: s as 'mine.onnx', with its variant for the render size; s and m as
    those of a library."""
    ours = models_dir()
    for name, other in (("s", "mine"), ("s.1x", "mine.1x"), ("s", "denoise_upscale.s"),
                        ("m", "denoise_upscale.m"), ("s.int8", "denoise_upscale.s.int8")):
        for suffix in (".onnx", ".json"):
            shutil.copy(ours / f"denoise_upscale.{name}{suffix}", tmp_path / f"{other}{suffix}")
    return tmp_path


@pytest.mark.parametrize("scale", [2, 1])
def test_a_network_in_a_file(nets: Path, scale: int) -> None:
    passes = DenoiseUpscale(model=str(nets / "mine.onnx"), scale=scale)
    pipeline = Pipeline([passes], CPU, exposure=0.0)
    found = pipeline(noisy(1))[Role.COLOUR]
    np.testing.assert_array_equal(found, colour_of(model="s.fp32", scale=scale))
    assert ([key for key in pipeline.history() if "network" in key]
            == ["pass denoise_upscale/network mine"])


def test_networks_of_a_library(nets: Path) -> None:
    for library in (nets, str(nets), Library(nets), Library(nets, models_dir())):
        np.testing.assert_array_equal(colour_of(model="s.fp32", library=library),
                                      colour_of(model="s.fp32"))
    # int8, as ours
    np.testing.assert_array_equal(colour_of(model="s", library=nets), colour_of(model="s"))
    assert family(validate_tag("m", Library(nets))) == (CLASSIC, f"{nets}/s", f"{nets}/m")
    with pytest.raises(PassOptionError, match="takes no networks on trust"):
        DenoiseUpscale(model="m", library=Library(nets, trust=True))


@pytest.mark.parametrize("options",
                         [{"model": "mine.onnx"}, {"model": "~/mine.onnx"}, {"library": Path()}])
def test_its_models_are_part_of_a_runs_settings(nets: Path, options: dict,
                                                monkeypatch: pytest.MonkeyPatch) -> None:
    """Any byte of them: a checkpoint of other weights is none of this run."""
    monkeypatch.chdir(nets)
    monkeypatch.setenv("HOME", str(nets))
    network = nets / ("mine.onnx" if "model" in options else "denoise_upscale.s.onnx")
    network.with_suffix(".json").write_text("{}")

    def fingerprint() -> str:
        plan = Pipeline([DenoiseUpscale(**{"model": "s.fp32", **options})], CPU).explain(
            FrameSpec(8, 8, (Role.COLOUR,)))
        return provenance_of({}, plan, CPU).fingerprint

    before = fingerprint()
    assert fingerprint() == before
    network.write_bytes(network.read_bytes() + b"\x32\x01x")  # field 6 of a model: a note
    assert fingerprint() != before


def test_the_number_of_threads_is_no_part_of_a_fingerprint() -> None:
    """Pixels do not depend on it, so a run goes on with another."""
    plan = Pipeline([DenoiseUpscale(model="s.fp32")], CPU).explain(FrameSpec(8, 8, (Role.COLOUR,)))
    one, other = (provenance_of({}, plan, Device("cpu", threads=count)) for count in (1, 2))
    assert one.fingerprint == other.fingerprint and one.device["threads"] != other.device["threads"]


@pytest.mark.parametrize(("model", "library", "message"), [
    ("none.onnx", None, "model '.*none.onnx': no such file"),
    ("mine.1x.onnx", None,
     "model '.*mine.1x.onnx' runs where the output has the render size: give .*/mine.onnx'"),
    ("mine.onnx", ".", "model '.*mine.onnx' is a file, which needs no library: leave library out"),
    ("l", ".",
     "no model 'denoise_upscale.l' in .*: there are denoise_upscale.m, denoise_upscale.s"),
    ("s", "nowhere", "model folder '.*nowhere' does not exist"),
])
def test_networks_that_cannot_be(nets: Path, model: str, library: str | None, message: str) -> None:
    model = str(nets / model) if model.endswith(".onnx") else model
    with pytest.raises(PostfxError, match=message):
        DenoiseUpscale(model=model, library=nets / library if library else None)


def test_a_network_in_a_file_needs_its_card(nets: Path, tmp_path: Path) -> None:
    alone = shutil.copy(next(nets.glob("*.onnx")), tmp_path / "alone.onnx")
    with pytest.raises(ModelError, match="its card alone.json is not beside it: copy both files"):
        DenoiseUpscale(model=str(alone))


def test_a_file_that_is_no_denoiser(tmp_path: Path) -> None:
    toys.make_library(tmp_path)
    with pytest.raises(ModelError,
                       match="model 'double' is not a denoiser: it reads x and gives y"):
        colour_of(model=str(tmp_path / "double.onnx"))


@pytest.mark.parametrize(("words", "half", "kernels"), [
    ("plain moves", False,
     "dilate history features accumulate pool pool pool pool filter mix filter mix filter mix "
     "filter mix filter remodulate upsample"),
    ("plain coded stored", False,
     "dilate features_stored accumulate pool pool pool pool filter mix filter mix filter mix "
     "filter mix filter_codes remodulate upsample_codes"),
    ("plain gpu shaded", True, "dilate features_half accumulate_half pools filter_half "
     "filter_mixed_half filter_mixed_half filter_mixed_half filter_shaded_half upsample_half"),
    ("guides guided doubts masked gpu", False,
     "dilate means keep features guides trust accumulate pools filter filter_mixed filter_mixed "
     "filter_mixed filter_mixed remodulate_both upsample_guided"),
    ("unscaled mirrored doubts error", False,
     "dilate means features mirrored accumulate pool pool pool pool filter mix filter mix filter "
     "mix filter mix filter remodulate_both upsample_unscaled open_error"),
    ("given moves gpu", False, "dilate history features accumulate blend_picture"),
])
def test_words_choose_the_steps_of_a_window(words, half, kernels):
    """The orders of frames without guides and with them, in 8 bits, in half precision on a GPU, and
    of a picture."""
    found = kernels_of(WINDOW_STEPS, frozenset(words.split()), half=half)
    assert [kernel.name for kernel in found] == [f"denoise_{name}" for name in kernels.split()]


@pytest.mark.parametrize("end", ["plain", "plain coded", "plain gpu"])
def test_buffers_have_the_shapes_of_the_kernels_that_write_them(end):
    """By the size of the window, and of the pyramid's level."""
    def sizes(level):
        rows, columns = 48 >> level, 64 >> level
        return {"th": 40, "tw": 50, "hp": rows, "wp": columns, "half_hp": rows // 2,
                "half_wp": columns // 2, "planes": 3, "padded_h": 42, "padded_w": 52} | {
            f"level{i}_{side}": size >> i
            for i in range(1, 5) for side, size in (("h", 48), ("w", 64))}

    found = shapes_of(WINDOW_STEPS, sizes, frozenset(end.split()))
    assert found["moved"] == (40, 50, 2) and found["radiance"] == (3, 42, 52)
    assert found["level 0"] == (4, 48, 64) and found["filtered 0"] == (3, 48, 64)
    assert found["pool 2"] == (3, 12, 16) and found["importance 4"] == (1, 3, 4)
    assert "keep" not in found and "warped" not in found, "of frames that are masked, or move"


def steps_of_the_frame() -> list[KernelStep]:
    """All steps of the page."""
    tables = [held for held in vars(graph).values() if isinstance(held, dict)]
    return [one for table in tables for steps in table.values() if isinstance(steps, tuple)
            for one in steps if isinstance(one, KernelStep)]


def test_all_words_of_steps_are_explained():
    steps = steps_of_the_frame()
    words = {word for one in steps for word in (*one.when, *one.unless, one.over)} - {""}
    assert {"moves", "gpu", "divided", "outputs", "rows"} < words
    assert not words - set(re.findall(r"\w+", graph.__doc__))


def test_all_kernels_of_the_denoiser_stand_on_the_page():
    """So whoever reads it has seen the whole frame."""
    named = {one.kernel for one in steps_of_the_frame()} - {None}
    modules = [import_module(f"{kernels.__name__}.{found.name}")
               for found in iter_modules(kernels.__path__)]
    made = {held for module in modules for held in vars(module).values()
            if isinstance(held, Kernel)}
    assert len(made) > 40
    assert {kernel.name for kernel in made - named} == set()
