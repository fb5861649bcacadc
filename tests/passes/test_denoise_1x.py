"""Networks of their own for outputs of the render size."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from postfx.errors import PassOptionError
from postfx.frame import Frame, Role
from postfx.passes.denoise import DenoiseUpscale
from postfx.passes.denoise import models as model_names
from postfx.passes.denoise.models import UNSCALED, halo_of, model_of, seamless
from postfx.pipeline import Pipeline
from postfx.runtime import Device, Library
from postfx.system import models_dir
from tests.passes.denoise_frames import guided, noisy, watch_histories

FILES = {"s": "s", "s.1x": "s.int8", "m": "s.int8", "m.1x": "s", "m.guides": "m.guides", "l": "s",
         "own": "s"}
"""Tag -> the shipped network that stands in for it: another one at 1x."""
SHIPPED = {f"denoise_upscale.{tag}" for tag in (
    "m", "m.int8", "m.fp16", "m.guides", "m.1x", "m.int8.1x", "m.fp16.1x", "l", "l.int8", "l.fp16",
    "mine", "mine.1x", "own")}
OUTPUT = 96, 64
SIZES = {1: (64, 96), 1.5: (43, 64), 2: (32, 48)}
"""Scale -> height and width of frames."""


class Named:
    """A library of which only the names matter."""

    def __contains__(self, name: str) -> bool:
        return name in SHIPPED


class Remote:
    """Memory that the host does not see."""

    host_visible = False


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = tmp_path_factory.mktemp("models")
    for tag, shipped in FILES.items():
        for ending in ("onnx", "json"):
            shutil.copy(models_dir() / f"denoise_upscale.{shipped}.{ending}",
                        made / f"denoise_upscale.{tag}.{ending}")
    return made


@pytest.fixture
def models(folder: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """The upscaler finds these models only."""
    monkeypatch.setattr(model_names, "Library", lambda: Library(folder))
    return folder


def chain(**options) -> Pipeline:
    return Pipeline([DenoiseUpscale(**options)], Device("cpu", threads=2), exposure=0.0,
                    cuts="none")


def ran(pipeline: Pipeline) -> set[str]:
    """Tags of the networks that were made ready."""
    return {name.removeprefix("denoise_upscale.") for name in pipeline.device.models}


@pytest.mark.usefixtures("models")
def test_a_plan_tells_that_another_network_stands_in_at_1x() -> None:
    spec = noisy(1).spec
    (remark,) = DenoiseUpscale(model="l", scale=1).remarks(spec)
    assert "model 'l' has no network for 1x: 'm' stands in" in remark
    assert (DenoiseUpscale(model="m", scale=1).remarks(spec) == DenoiseUpscale(model="l", scale=2)
            .remarks(spec) == ())


def test_a_plan_tells_that_a_precision_is_missing() -> None:
    (remark,) = DenoiseUpscale(model="xl.int8", scale=1).remarks(noisy(1).spec)
    assert remark == ("model 'xl.int8' has no network in int8: 'm.int8' stands in; give model 'xl' "
                      "for the better picture")
    assert DenoiseUpscale(model="xl", scale=1).remarks(noisy(1).spec) == ()


@pytest.mark.usefixtures("models")
def test_a_plan_tells_that_another_network_enlarges_instead_of_one_for_1x_alone() -> None:
    spec = noisy(1).spec
    assert DenoiseUpscale(model="xl", scale=2).remarks(spec) == (
        "model 'xl' does not enlarge: 'l' stands in",)


@pytest.mark.usefixtures("models")
@pytest.mark.parametrize(("model", "scale", "tag"), [
    ("m", 1, "m.1x"), ("m", 1.5, "m"), ("m", 2, "m"), ("m.fp32", 1, "m.1x"), ("s", 1, "s.1x"),
    ("l", 1, "m.1x"), ("l", 2, "l"), ("xl", 2, "l"), ("own", 1, "own"),
])
def test_it_runs_where_the_output_has_the_render_size(model: str, scale: float, tag: str) -> None:
    pipeline = chain(model=model, scale=scale)
    assert np.isfinite(pipeline(noisy(1))[Role.COLOUR]).all() and ran(pipeline) == {tag}


@pytest.mark.usefixtures("models")
def test_guides_of_the_render_size_change_nothing() -> None:
    pipeline = chain()
    colour = pipeline(guided(noisy(1), 37, 50))[Role.COLOUR]
    assert ran(pipeline) == {"m.1x"}
    np.testing.assert_array_equal(colour, chain(scale=1)(noisy(1))[Role.COLOUR])


@pytest.mark.parametrize(("tag", "host", "model"), [
    ("m", True, "m.int8.1x"), ("m", False, "m.fp16.1x"), ("m.fp32", True, "m.1x"),
    ("m.int8", True, "m.int8.1x"), ("m.fp16", False, "m.fp16.1x"), ("l", True, "m.int8.1x"),
    ("l", False, "m.fp16.1x"), ("l.fp32", True, "m.1x"),
    ("l.int8", True, "m.int8.1x"), ("mine", True, "mine.1x"), ("own", True, "own"),
])
def test_it_has_the_precision_of_the_tag(tag: str, host: bool, model: str,
                                         monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(model_names, "Library", Named)
    device = Device("cpu", threads=1)
    if not host:
        monkeypatch.setattr(device, "memory", Remote())
    assert model_of(tag, UNSCALED, device) == f"denoise_upscale.{model}"


@pytest.mark.parametrize("plain", ["m", "m.int8"])
def test_it_is_not_chosen_by_name(plain: str) -> None:
    message = (f"model '{plain}.1x' runs where the output has the render size: give the model "
               f"'{plain}'")
    with pytest.raises(PassOptionError, match=message):
        DenoiseUpscale(model=f"{plain}.1x")


@pytest.mark.usefixtures("models")
def test_a_budget_chooses_among_them() -> None:
    pipeline = chain(budget=1000, scale=1)
    upscaler, chosen = pipeline.passes[0], []
    for number in range(1, 7):
        pipeline(noisy(number))
        chosen.append(upscaler.choice)
    assert chosen[0] == "s" and chosen[-1] == "m" and ran(pipeline) == {"s.1x", "m.1x"}


def test_windows_have_the_halo_of_the_plain_network() -> None:
    for size in ("s", "m.int8"):
        plain, unscaled = [f"denoise_upscale.{size}"], [f"denoise_upscale.{size}.1x"]
        assert halo_of(plain) == halo_of(unscaled) and seamless(plain) == seamless(unscaled)


def sized(number: int, scale: float, **kept) -> Frame:
    return noisy(number, *SIZES[scale], **kept)


def changing() -> list[Frame]:
    return [sized(number, scale) for number, scale in enumerate((2, 2, 1, 1, 2, 1.5, 1))]


@pytest.mark.usefixtures("models")
def test_the_history_goes_on_to_the_render_size_and_back(monkeypatch: pytest.MonkeyPatch) -> None:
    """All but the hidden state, which another network could not read."""
    pipeline, kept = chain(size=OUTPUT), watch_histories(monkeypatch)
    for frame in changing():
        begun = chain(size=OUTPUT)(frame)[Role.COLOUR]
        assert np.array_equal(pipeline(frame)[Role.COLOUR], begun) == (frame.number == 0)
    kept = kept[1::2]  # the others are of pipelines that begin with the frame
    ends = [model.removeprefix("denoise_upscale.") for model, _, _ in kept]
    assert ends == ["m", "m", "m.1x", "m.1x", "m", "m", "m.1x"]
    for number, (_, before, after) in enumerate(kept):
        np.testing.assert_array_equal(after[..., :4], before[..., :4])
        assert after[..., 4:].any() == (number > 0 and ends[number] == ends[number - 1])


@pytest.mark.usefixtures("models")
def test_a_network_for_all_sizes_keeps_its_hidden_state() -> None:
    pipeline = chain(size=OUTPUT, model="own")
    for frame in changing():
        pipeline(frame)
    assert ran(pipeline) == {"own"}


@pytest.mark.usefixtures("models")
def test_the_history_goes_on_from_guided_frames_and_back() -> None:
    pipeline = chain(size=OUTPUT)
    for frame in changing():
        frame = guided(frame, *OUTPUT[::-1])
        begun = chain(size=OUTPUT)(frame)[Role.COLOUR]
        assert np.array_equal(pipeline(frame)[Role.COLOUR], begun) == (frame.number == 0)
        network = "m.1x" if frame.spec.width == OUTPUT[0] else "m.guides"
        assert pipeline.passes[0]._ready.models == {"m": f"denoise_upscale.{network}"}


@pytest.mark.usefixtures("models")
@pytest.mark.parametrize("with_guides", [False, True])
def test_a_recalled_history_gives_the_same_bits(with_guides: bool) -> None:
    whole, frames = chain(size=OUTPUT), changing()
    frames = [guided(frame, *OUTPUT[::-1]) for frame in frames] if with_guides else frames
    wanted, kept = [], []
    for frame in frames:
        wanted.append(whole(frame)[Role.COLOUR])
        kept.append({name: np.array(value) for name, value in whole.history().items()})
    for at, frame in enumerate(frames[:-1]):
        again = chain(size=OUTPUT)
        again.recall(frame, kept[at])
        for number in range(at + 1, len(frames)):
            np.testing.assert_array_equal(again(frames[number])[Role.COLOUR], wanted[number])


@pytest.mark.usefixtures("models")
def test_a_recalled_history_of_a_budget_is_of_the_same_network() -> None:
    whole = chain(size=OUTPUT, budget=1000)
    for number in range(6):
        whole(sized(number, 1))
    assert whole.passes[0].choice == "m"
    again = chain(size=OUTPUT, budget=1000)
    again.recall(sized(5, 1), {name: np.array(value) for name, value in whole.history().items()})
    assert again.passes[0]._history.model == "denoise_upscale.m.1x"


@pytest.mark.usefixtures("models")
@pytest.mark.parametrize("first", SIZES)
def test_headers_name_all_networks_of_a_size_that_stays(first: float) -> None:
    """So a frame's file does not depend on where a run began."""
    pipeline = chain(size=OUTPUT)
    pipeline(sized(0, first))
    assert ran(pipeline) == {"m", "m.1x"}


@pytest.mark.usefixtures("models")
def test_frames_with_other_planes_begin_anew() -> None:
    pipeline, fewer = chain(size=OUTPUT, model="s"), sized(1, 1)
    pipeline(sized(0, 2))
    fewer = replace(fewer, planes={role: plane
                                   for role, plane in fewer.planes.items() if role != Role.NORMAL})
    np.testing.assert_array_equal(pipeline(fewer)[Role.COLOUR],
                                  chain(size=OUTPUT, model="s")(fewer)[Role.COLOUR])


@pytest.mark.usefixtures("models")
def test_under_a_mask_the_network_sees_a_window_and_the_rest_stays() -> None:
    pipeline, frame = chain(scale=1), noisy(1, 96, 96, jitter=(0.0, 0.0))
    frame.planes[Role.STRENGTH] = np.zeros((96, 96, 1), np.float32)
    frame.planes[Role.STRENGTH][:8, :8] = 1
    colour = pipeline(frame)[Role.COLOUR]
    assert ran(pipeline) == {"m.1x"} and any("network" in line.what for line in pipeline.savings())
    np.testing.assert_array_equal(colour[32:], frame[Role.COLOUR][32:])
