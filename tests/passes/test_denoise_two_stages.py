"""Frames that are denoised at their own size before they are enlarged."""

from __future__ import annotations

import shutil
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import postfx
from postfx.colour import TO_WIDER_PRIMARIES
from postfx.frame import GUIDE_ROLES, Frame, Role
from postfx.passes.denoise import DenoiseUpscale
from postfx.passes.denoise import models as model_names
from postfx.passes.denoise.first_stage import DENOISED_SHARE
from postfx.pipeline import Pipeline
from postfx.runtime import Device, Library
from postfx.system import models_dir
from tests.passes.denoise_frames import PLANES, flat, guided, noisy

SIZE = 32, 44
CENTRED = {"jitter": (0.0, 0.0)}
MASKED = 320
"""Side of frames with a small mask, which are worked on in tiles."""
STAGES = "network xl at the render's size first, then "
OWN = "denoise_upscale.xl"
"""Name of a network of xl that enlarges, which these tests do without."""


@pytest.fixture(scope="module")
def shipped(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("models")
    for path in models_dir().iterdir():
        if path.stem != OWN:
            (folder / path.name).symlink_to(path)
    return folder


@pytest.fixture(autouse=True)
def stand_in(shipped: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """`l` enlarges for `xl`, whatever networks are shipped."""
    monkeypatch.setattr(model_names, "Library", lambda *given: Library(*given or (shipped,)))
    yield


def chain(model: str = "xl", **options) -> Pipeline:
    options.setdefault("scale", None if "size" in options else 2)
    return Pipeline([DenoiseUpscale(model=model, **options)], Device("cpu", threads=2),
                    exposure=0.0, cuts="none")


def frames(count: int = 3, size: tuple[int, int] = SIZE, **kept) -> list[Frame]:
    return [noisy(number, *size, **{**CENTRED, **kept}) for number in range(1, count + 1)]


def pictures(pipeline: Pipeline, given: Sequence[Frame]) -> list[np.ndarray]:
    return [np.array(pipeline(frame)[Role.COLOUR]) for frame in given]


def with_planes(frame: Frame, **planes: np.ndarray) -> Frame:
    added = {Role(name): plane for name, plane in planes.items()}
    return replace(frame, planes={**frame.planes, **added})


def by_hand(given: Sequence[Frame], **options) -> list[np.ndarray]:
    """What two pipelines make of frames, one after the other."""
    first, then = chain(scale=1, strength=DENOISED_SHARE), chain("l", **options)
    return pictures(then, [with_planes(frame, colour=mixture)
                           for frame, mixture in zip(given, pictures(first, given), strict=True)])


def assert_same(found: Sequence[np.ndarray], wanted: Sequence[np.ndarray]) -> None:
    for one, right in zip(found, wanted, strict=True):
        np.testing.assert_array_equal(one, right)


@pytest.mark.parametrize("options", [{"scale": 2}, {"scale": 1.5}, {"size": (88, 64)}], ids=str)
def test_it_is_both_networks_one_after_the_other(options: dict) -> None:
    given = frames()
    found = pictures(chain(**options), given)
    assert_same(found, by_hand(given, **options))
    for one, alone in zip(found, pictures(chain("l", **options), given), strict=True):
        assert np.abs(one - alone).max() > 0.1


def test_both_have_a_history_that_a_reset_drops() -> None:
    given = frames(4)
    given[2] = replace(given[2], reset=True)
    pipeline = chain()
    found = pictures(pipeline, given)
    assert_same(found, by_hand(given))
    assert_same(found[2:], pictures(chain(), given[2:]))
    assert np.abs(found[1] - chain()(given[1])[Role.COLOUR]).max() > 0.01
    pipeline.reset()
    assert_same([pipeline(given[1])[Role.COLOUR]], [chain()(given[1])[Role.COLOUR]])


def test_a_still_takes_both() -> None:
    frame = frames(1)[0]
    color, albedo = frame[Role.COLOUR], frame[Role.DIFFUSE_ALBEDO]
    still = {"exposure": 0.0, "scale": 2, "device": "cpu"}
    found = postfx.denoise(color, albedo=albedo, model="xl", **still)
    mixture = postfx.denoise(color, albedo=albedo, model="xl", strength=DENOISED_SHARE,
                             **{**still, "scale": 1})
    np.testing.assert_array_equal(found, postfx.denoise(mixture, albedo=albedo, model="l", **still))


@pytest.mark.parametrize("sizes", [[SIZE] * 4, [SIZE, SIZE, (48, 66), SIZE]],
                         ids=["one size", "sizes that change"])
def test_a_recalled_history_gives_the_same_bits(sizes: list[tuple[int, int]]) -> None:
    given = [noisy(number, *size, **CENTRED) for number, size in enumerate(sizes)]
    whole, wanted, kept = chain(size=(88, 64)), [], []
    for frame in given:
        wanted += pictures(whole, [frame])
        kept.append({name: np.array(value) for name, value in whole.history().items()})
    assert any("first stage" in name for name in kept[0])
    for at in range(len(given) - 1):
        again = chain(size=(88, 64))
        again.recall(given[at], kept[at])
        assert_same(pictures(again, given[at + 1:]), wanted[at + 1:])


def test_a_frame_that_is_not_denoised_first_ends_its_history() -> None:
    given = frames(4)
    given[1] = replace(given[1], jitter=(0.25, -0.25))
    whole = chain()
    wanted = pictures(whole, given[:2])
    kept = {name: np.array(value) for name, value in whole.history().items()}
    assert not any("first stage" in name for name in kept)
    wanted += pictures(whole, given[2:])
    again = chain()
    again.recall(given[1], kept)
    assert_same(pictures(again, given[2:]), wanted[2:])


def test_frames_with_jitter_keep_what_it_tells_between_pixels() -> None:
    given = frames(2, jitter=(0.25, -0.125))
    pipeline = chain()
    assert_same(pictures(pipeline, given), pictures(chain("l"), given))
    assert pipeline.passes[0].choice == "l"
    assert pipeline.passes[0].reflect(given[0].spec).notes == (
        f"{STAGES}l enlarges; l alone where frames have jitter",)


def with_noisy_alpha(given: Sequence[Frame]) -> list[Frame]:
    random = np.random.default_rng(2)
    return [with_planes(frame, alpha=random.random((*SIZE, 1), np.float32)) for frame in given]


def test_noisy_alpha_is_filtered_beside_both_networks() -> None:
    """By `m`, which sees the noisy picture; the picture is that of frames without alpha."""
    given = with_noisy_alpha(frames())
    pipeline, other = chain(), chain("m")
    for frame, wanted in zip(given, by_hand(frames()), strict=True):
        found = pipeline(frame)
        assert not pipeline.noticed
        np.testing.assert_array_equal(found[Role.COLOUR], wanted)
        np.testing.assert_array_equal(found[Role.ALPHA], other(frame)[Role.ALPHA])
    opaque = with_planes(given[0], alpha=np.ones((*SIZE, 1), np.float32))
    found = chain()(opaque)
    assert_same([found[Role.COLOUR]], by_hand(given[:1]))
    assert (found[Role.ALPHA] == 1).all()


def test_alpha_beside_both_networks_goes_on_from_a_recalled_history() -> None:
    given = with_noisy_alpha(frames(4))
    given[1] = replace(given[1], jitter=(0.25, -0.25))
    whole, kept, wanted = chain(), [], []
    for frame in given:
        found = whole(frame)
        wanted.append((np.array(found[Role.COLOUR]), np.array(found[Role.ALPHA])))
        kept.append({name: np.array(value) for name, value in whole.history().items()})
    for at in range(3):
        again = chain()
        again.recall(given[at], kept[at])
        for frame, right in zip(given[at + 1:], wanted[at + 1:], strict=True):
            found = again(frame)
            assert_same((found[Role.COLOUR], found[Role.ALPHA]), right)


def test_a_budget_leaves_both_networks_to_frames_that_have_the_time() -> None:
    """It begins with the fastest, and comes to both where each frame may take any time."""
    given, pipeline, chosen = frames(8), chain(budget=1e6), []
    for frame in given:
        found = pipeline(frame)
        chosen.append(pipeline.passes[0].choice)
    assert chosen[0] == "s" and chosen[-1] == "xl then l"
    assert_same([chain(budget=1e6)(given[0])[Role.COLOUR]], pictures(chain("s"), given[:1]))
    jittered = replace(given[0], jitter=(0.25, -0.25))
    pipeline(jittered)
    assert pipeline.passes[0].choice == "l"
    assert np.isfinite(found[Role.COLOUR]).all()


def test_parts_beside_both_networks_add_up_to_their_picture() -> None:
    """By the share that `m` finds, which filters them from the noisy frame."""
    names = ["key", "fill"]
    given = [replace(frame, parts={"key": 0.25 * frame[Role.COLOUR],
                                   "fill": 0.75 * frame[Role.COLOUR]}) for frame in frames(2)]
    ours, other = (chain(model, parts=names) for model in ("xl", "m"))
    for frame, wanted in zip(given, by_hand(frames(2)), strict=True):
        found, filtered = ours(frame), other(frame)
        np.testing.assert_array_equal(found[Role.COLOUR], wanted)
        for name in names:
            np.testing.assert_allclose(found.parts[name] / found[Role.COLOUR],
                                       filtered.parts[name] / filtered[Role.COLOUR], rtol=1e-4)
        np.testing.assert_allclose(sum(found.parts.values()), wanted, rtol=1e-5)


def test_guides_in_place_of_planes_leave_the_first_stage_out() -> None:
    (frame,) = frames(1)
    sharp = guided(frame, 2 * SIZE[0], 2 * SIZE[1])
    without = replace(sharp, planes={Role.COLOUR: frame[Role.COLOUR]})
    assert_same(pictures(chain(), [without]), pictures(chain("l"), [without]))
    remarks = DenoiseUpscale(2, model="xl").remarks(without.spec)
    assert any(one.endswith("guides stand in for planes of the render's size") for one in remarks)
    assert {*GUIDE_ROLES} <= {*frame.planes}
    assert_same(pictures(chain(), [sharp]), by_hand([frame]))


def test_a_precision_that_has_no_first_network_enlarges_alone() -> None:
    (frame,) = frames(1)
    assert_same(pictures(chain("xl.int8"), [frame]), pictures(chain("l.int8"), [frame]))
    assert DenoiseUpscale(2, model="xl.int8").remarks(frame.spec) == (
        "model 'xl.int8' has no network in int8: 'l.int8' stands in; give model 'xl' for the "
        "better picture",)
    assert DenoiseUpscale(2, model="xl").remarks(frame.spec) == ()


def test_a_network_that_enlarges_of_its_own_comes_after_the_first(tmp_path: Path) -> None:
    for name, shipped in (("xl.1x", "xl.1x"), ("xl", "s")):
        for ending in ("onnx", "json"):
            shutil.copy(models_dir() / f"denoise_upscale.{shipped}.{ending}",
                        tmp_path / f"denoise_upscale.{name}.{ending}")
    (frame,) = frames(1)
    pipeline = chain(library=tmp_path)
    (found,) = pictures(pipeline, [frame])
    mixture = chain(scale=1, strength=DENOISED_SHARE)(frame)[Role.COLOUR]
    assert_same([found], pictures(chain("s.fp32"), [with_planes(frame, colour=mixture)]))
    assert pipeline.passes[0].choice == "xl in two stages"
    by_file = chain(str(tmp_path / "denoise_upscale.xl.onnx"))
    assert_same(pictures(by_file, [frame]), [found])


def test_a_shipped_network_for_mixtures_has_no_other_frames(
    shipped: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """`l` enlarges those that are not denoised first, also in between."""
    for path in shipped.iterdir():
        (tmp_path / path.name).symlink_to(path)
    for ending in ("onnx", "json"):
        (tmp_path / f"{OWN}.{ending}").symlink_to(models_dir() / f"denoise_upscale.l.{ending}")
    monkeypatch.setattr(model_names, "Library", lambda *given: Library(*given or (tmp_path,)))
    given = frames(4)
    mixture = chain(scale=1, strength=DENOISED_SHARE)(given[0])[Role.COLOUR]
    (by_own,) = pictures(chain("l.fp32"), [with_planes(given[0], colour=mixture)])
    jittered = replace(given[1], jitter=(0.25, -0.25))
    whole, chosen, kept, wanted = chain(), [], [], []
    for frame in (given[0], jittered, *given[2:]):
        wanted += pictures(whole, [frame])
        chosen.append(whole.passes[0].choice)
        kept.append({name: np.array(value) for name, value in (whole.history() or {}).items()})
    assert chosen == ["xl in two stages", "l", "xl in two stages", "xl in two stages"]
    assert ("the first of two stages for 1 frame in denoise_upscale" in
            [skip.what for skip in whole.savings()])
    assert_same(wanted[:1], [by_own])
    for at in (0, 1):
        again = chain()
        again.recall((given[0], jittered)[at], kept[at])
        assert_same(pictures(again, [jittered, *given[2:]][at:]), wanted[at + 1:])
    assert_same(pictures(chain(), [jittered]), pictures(chain("l"), [jittered]))
    assert whole.passes[0].reflect(given[0].spec).notes == (
        f"{STAGES}xl enlarges; l alone where frames have jitter",)


def test_strength_goes_from_the_input_to_the_whole_effect() -> None:
    given = frames(2)
    none, half, whole = (pictures(chain(strength=amount), given) for amount in (0, 0.5, 1))
    for plain, mixed, full in zip(none, half, whole, strict=True):
        np.testing.assert_allclose(mixed, (plain + full) / 2, rtol=1e-4, atol=1e-4)
    pipeline = chain(strength=0)
    pipeline(given[0])
    assert not pipeline.device.models


def test_masked_pixels_are_as_in_the_whole_frame() -> None:
    """In tiles, to which the first network gives all that the second sees."""
    (frame,) = frames(1, (MASKED, MASKED))
    strength = np.zeros((MASKED, MASKED, 1), np.float32)
    strength[100:124, 90:110] = 1
    pipeline = chain()
    (found,) = pictures(pipeline, [with_planes(frame, strength=strength)])
    assert any(line.startswith("network outside") for line, _ in pipeline.passes[0].savings())
    whole, plain = chain()(frame)[Role.COLOUR], chain(strength=0)(frame)[Role.COLOUR]
    inner, outside = np.s_[204:244, 184:216], np.s_[:190]
    np.testing.assert_allclose(found[inner] / (1 + found[inner]),
                               whole[inner] / (1 + whole[inner]), atol=2e-3)
    np.testing.assert_allclose(found[outside], plain[outside], atol=1e-6)
    nothing = with_planes(frame, strength=np.zeros_like(strength))
    assert_same(pictures(chain(), [nothing]), [plain])


def test_one_halo_is_enough_for_both_networks(monkeypatch: pytest.MonkeyPatch) -> None:
    """The first network sees around what is active what it sees where nothing is enlarged, and not
    the other one's halo, too."""
    frame = with_planes(*frames(1, (MASKED, 32)), strength=rows_from(MASKED - 16, MASKED))
    pipeline, alone = chain(), chain(scale=1)
    seen: dict[Pipeline, set[int]] = {pipeline: set(), alone: set()}
    for one, rows in seen.items():
        make = one.device.pipeline_state

        def noted(library: Library, name: str, dims: dict[str, int], *, make=make, rows=rows,
                  **named) -> object:
            rows |= {dims["height"]} if name.endswith("xl.1x") else set()
            return make(library, name, dims, **named)

        monkeypatch.setattr(one.device, "pipeline_state", noted)
        pictures(one, [frame])
    assert seen[pipeline] == seen[alone] and min(seen[alone]) < MASKED / 2


def rows_from(first: int, height: int) -> np.ndarray:
    """Strength in the last rows of a frame."""
    strength = np.zeros((height, 32, 1), np.float32)
    strength[first:] = 1
    return strength


def test_black_frames_stay_black_and_keep_their_neighbours() -> None:
    given = frames(3)
    given[1] = with_planes(given[1], colour=np.zeros((*SIZE, 3), np.float32))
    assert_same(pictures(chain(), given), by_hand(given))
    assert chain()(given[1])[Role.COLOUR].max() < 0.01


def test_light_outside_the_gamut_comes_through() -> None:
    """Both networks work in wider primaries."""
    orange = np.float32([8.0, 2.0, -0.4])
    given = [with_planes(frame, colour=frame[Role.COLOUR][..., :1] * orange)
             for frame in frames(2, (64, 64))]
    assert (orange @ TO_WIDER_PRIMARIES.T > 0).all()
    for picture, frame in zip(pictures(chain(), given), given, strict=True):
        ratio = picture.mean((0, 1)) / frame[Role.COLOUR].mean((0, 1))
        np.testing.assert_allclose(ratio, 1, atol=0.25)


def test_what_has_no_noise_stays_as_good() -> None:
    """A picture of many samples, whose detail both networks must leave alone."""
    y, x = np.indices((192, 192), np.float32)
    fine = 0.4 + 0.3 * np.sin(x / 9) * np.cos(y / 13) + 0.15 * (np.hypot(x - 90, y - 100) < 60)
    truth = np.stack([fine, 0.8 * fine, 0.6 * fine], -1).astype(np.float32)
    coarse = truth.reshape(96, 2, 96, 2, 3).mean((1, 3))
    frame = with_planes(flat(1, 0.5, 96, 96, samples=1024), colour=coarse)
    errors = [np.sqrt(np.mean((chain(model)(frame)[Role.COLOUR] - truth) ** 2))
              for model in ("xl", "l")]
    assert errors[0] < 1.15 * errors[1] and errors[0] < 0.03


def test_planes_that_follow_mirrors_are_read_by_the_first_network() -> None:
    (frame,) = frames(1)
    mirrored = with_planes(frame, **{"denoising_albedo": frame[Role.DIFFUSE_ALBEDO] / 2,
                                     "denoising_normal": -frame[Role.NORMAL]})
    read = DenoiseUpscale(2, model="xl").reflect(mirrored.spec).may_read
    assert {Role.DENOISING_ALBEDO, Role.DENOISING_NORMAL, *PLANES[1:]} <= {*read}
    assert_same(pictures(chain(), [mirrored]), by_hand([mirrored]))
    assert Role.DENOISING_ALBEDO not in DenoiseUpscale(2, model="l").reflect(mirrored.spec).may_read


def test_other_views_have_their_own_history() -> None:
    given = frames(2)
    pair = [replace(frame, views={"right": other})
            for frame, other in zip(given, frames(2, jitter=(0.0, 0.0))[::-1], strict=True)]
    pipeline = chain()
    found = [pipeline(frame) for frame in pair]
    assert_same([one[Role.COLOUR] for one in found], pictures(chain(), given))
    assert_same([one.views["right"][Role.COLOUR] for one in found],
                pictures(chain(), [frame.views["right"] for frame in pair]))


def test_planes_on_the_device_give_the_same() -> None:
    ways = chain(), chain()
    for frame in frames(2):
        there = ways[0].on_device(frame.planes, exposure=0.0, number=frame.number)
        np.testing.assert_array_equal(there[Role.COLOUR].download(), ways[1](frame)[Role.COLOUR])
