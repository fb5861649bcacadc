"""The denoised upscaler with guides, planes at output size."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from postfx.errors import GuideError, PassOptionError
from postfx.frame import ALBEDOS, GUIDE_ROLES, Frame, Role
from postfx.passes.denoise import DenoiseUpscale, models
from postfx.pipeline import Pipeline
from postfx.runtime import Device, Library
from tests.passes.denoise_frames import flat, guided, noisy

pytestmark = pytest.mark.usefixtures("small_models")


def pipeline(**options) -> Pipeline:
    return Pipeline([DenoiseUpscale(**{"model": "small", **options})], Device("cpu", threads=2),
                    exposure=0.0)


def demodulation(diffuse: np.ndarray, specular: np.ndarray) -> np.ndarray:
    """What colour is divided by: see ``training.ops.demodulation``."""
    total = diffuse + specular
    return np.maximum(total, 0.15 * total.max(2, keepdims=True)) + 0.01


def lit(number: int, size: tuple[int, int] = (48, 80)) -> Frame:
    """White light of 2 on the albedos of random guides, rendered at half the size."""
    frame = guided(flat(number, 0.3), *size)
    reflectance = demodulation(*(frame[role] for role in ALBEDOS))
    return replace(frame, planes={**frame.planes, Role.COLOUR: 2 * reflectance})


def test_output_size_follows_from_the_guides() -> None:
    chain = pipeline()
    assert chain(guided(noisy(1), 56, 75))[Role.COLOUR].shape == (56, 75, 3)
    assert chain(noisy(1))[Role.COLOUR].shape == (37, 50, 3)
    assert chain(guided(noisy(1), 110, 149))[Role.COLOUR].shape == (110, 149, 3)
    assert chain(replace(noisy(1), guide_size=(75, 56)))[Role.COLOUR].shape == (56, 75, 3)


def test_a_scale_that_leads_to_another_size_is_an_error() -> None:
    message = ("guides.exr: guides are 75x56, the colour is 50x37: leave the scale out, or render "
               "them at 100x74")
    with pytest.raises(GuideError, match=message):
        pipeline(scale=2)(guided(noisy(1), 56, 75))
    for size in ((55, 75), (56, 75)):  # 55.5 rows, cut and rounded
        assert pipeline(scale=1.5)(guided(noisy(1), *size))[Role.COLOUR].shape == (*size, 3)


@pytest.mark.parametrize("size", [(30, 50), (74, 75), (37 * 4, 50 * 4)])
def test_guides_that_no_scale_leads_to_are_an_error(size: tuple[int, int]) -> None:
    with pytest.raises(GuideError, match="render them 1 to 3 times as large"):
        pipeline()(guided(noisy(1), *size))


def grey(frame: Frame, planes: np.ndarray, guides: np.ndarray) -> Frame:
    """White light of 2 on grey albedos (h, w) of the planes, with those (H, W) of the guides."""
    inner, outer = (np.repeat(albedo[..., None], 3, 2).astype(np.float32)
                    for albedo in (planes, guides))
    black = {role: np.zeros_like(inner) for role in ALBEDOS[1:]}
    return replace(frame, planes={**frame.planes, ALBEDOS[0]: inner, **black,
                                  Role.COLOUR: 2 * (inner + 0.01)},
                   guides={**frame.guides, ALBEDOS[0]: outer, ALBEDOS[1]: np.zeros_like(outer)})


def test_reflectance_of_the_guides_is_in_the_output_pixel_by_pixel() -> None:
    """Whatever a network predicts, even light stays even, and textures are those of the guides, if
    the planes are their means."""
    detail = np.random.default_rng(1).uniform(0.1, 0.9, (48, 80))
    frame = grey(lit(1), detail.reshape(24, 2, 40, 2).mean((1, 3)), detail)
    chain = pipeline()
    for _ in range(3):
        np.testing.assert_allclose(chain(frame)[Role.COLOUR][..., 1], 2 * (detail + 0.01),
                                   rtol=1e-4)


@pytest.mark.parametrize("scale", [1.5, 2, 3])
def test_guides_that_show_another_surface_count_less(scale: float) -> None:
    """As glass does in planes of what is seen in it: 0.3 of what is apart by as much as there is
    detail."""
    size = (round(24 * scale), round(40 * scale))
    frame = grey(lit(1, size), np.full((24, 40), 0.49), np.full(size, 0.99))
    wanted = 2 * (0.5 + 0.3 * (1 - 0.5))
    np.testing.assert_allclose(pipeline()(frame)[Role.COLOUR], wanted, rtol=1e-3)


def test_guides_of_one_sample_count_less_where_they_are_noise() -> None:
    """On the left the planes are the guides' means, on the right those of what both are samples
    of."""
    random = np.random.default_rng(1)
    detail = random.choice([0.1, 0.7], (48, 80))
    planes = detail.reshape(24, 2, 40, 2).mean((1, 3))
    planes[:, 20:] = random.choice([0.1, 0.7], (4, 24, 20)).mean(0)
    error = np.abs(pipeline()(grey(lit(1), planes, detail))[Role.COLOUR][..., 1]
                   - 2 * (detail + 0.01))
    assert error[:, :24].max() < 1e-3
    assert np.median(error[:, 56:]) > 0.05


def test_all_guides_matter() -> None:
    frame = guided(noisy(1), 74, 100)
    wanted = pipeline()(frame)[Role.COLOUR]
    for role in GUIDE_ROLES:
        other = {**frame.guides, role: np.ascontiguousarray(frame.guides[role][::-1])}
        changed = pipeline()(replace(frame, guides=other))[Role.COLOUR]
        assert np.abs(changed - wanted).max() > 1e-3, role


@pytest.mark.parametrize("scale", [1, 1.5, 2])
@pytest.mark.parametrize("role", GUIDE_ROLES)
def test_a_guide_stands_in_for_a_missing_plane_and_the_other_way_round(role: Role,
                                                                       scale: float) -> None:
    """With planes of one value it makes no difference at which size they are there."""
    frame = flat(1, 0.3)
    size = (round(24 * scale), round(40 * scale))
    guides = {guide: plane
              for guide, plane in flat(1, 0.3, *size).planes.items() if guide in GUIDE_ROLES}
    frame = replace(frame, guides=guides)
    wanted = pipeline()(frame)[Role.COLOUR]
    for lacking in ("planes", "guides"):
        planes = {held: plane for held, plane in getattr(frame, lacking).items() if held != role}
        np.testing.assert_allclose(pipeline()(replace(frame, **{lacking: planes}))[Role.COLOUR],
                                   wanted, rtol=1e-5)


def test_reduced_guides_are_those_of_the_render_pixels() -> None:
    """Colour alone at render size and albedos at output size: light that is even stays so."""
    frame = lit(1)
    fine = np.repeat(np.repeat(frame[Role.DIFFUSE_ALBEDO] * np.linspace(0.2, 1, 24)[:, None, None],
                               2, 0), 2, 1)
    guides = {Role.DIFFUSE_ALBEDO: fine.astype(np.float32),
              Role.SPECULAR_ALBEDO: np.zeros_like(fine, np.float32)}
    colour = (2 * demodulation(fine, 0 * fine)[::2, ::2]).astype(np.float32)
    result = pipeline()(Frame({Role.COLOUR: colour}, guides=guides))[Role.COLOUR]
    wanted = 2 * demodulation(fine, 0 * fine)
    np.testing.assert_allclose(result[4:-4], wanted[4:-4], rtol=0.05)


def test_what_is_missing_at_both_sizes_is_neutral() -> None:
    frame = guided(noisy(1, planes=(Role.COLOUR,)), 74, 100, (Role.NORMAL,))
    assert np.isfinite(pipeline()(frame)[Role.COLOUR]).all()


def test_history_continues_with_guides() -> None:
    first, second = guided(noisy(1), 74, 100), guided(noisy(2), 74, 100)
    chain = pipeline()
    chain(first)
    assert np.abs(chain(second)[Role.COLOUR] - pipeline()(second)[Role.COLOUR]).max() > 1e-3


def check_that_guides_stand_in(chain: Pipeline, frame: Frame, shape: tuple[int, ...]) -> None:
    """Without a normal plane the pipeline reads the guides' normals, and these alone."""
    lacking = replace(frame,
                      planes={role: p for role, p in frame.planes.items() if role != Role.NORMAL})
    assert chain(lacking)[Role.COLOUR].shape == shape
    assert chain.plan.guides == (Role.NORMAL,)


def test_a_model_that_reads_no_guides_says_so_and_uses_them_for_missing_planes_only(
    small_models: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shutil.copy(small_models / "denoise_upscale.small.onnx", tmp_path)
    monkeypatch.setattr(models, "Library", lambda: Library(tmp_path))
    frame = guided(noisy(1), 74, 100)
    chain = pipeline()
    alone = pipeline(scale=2)(replace(frame, guides={}, guide_size=None))[Role.COLOUR]
    np.testing.assert_array_equal(chain(frame)[Role.COLOUR], alone)
    assert chain.plan.guides == ()
    assert any("model 'small' does not read guides" in remark for remark in chain.plan.remarks)
    check_that_guides_stand_in(chain, frame, alone.shape)


def test_guides_of_the_render_size_stand_in_for_missing_planes_only() -> None:
    frame = guided(noisy(1), 37, 50)
    chain = pipeline()
    alone = pipeline(scale=1)(replace(frame, guides={}, guide_size=None))[Role.COLOUR]
    np.testing.assert_array_equal(chain(frame)[Role.COLOUR], alone)
    assert chain.plan.guides == ()
    assert any("guides of the render size only stand in" in remark for remark in chain.plan.remarks)
    check_that_guides_stand_in(chain, frame, alone.shape)


def test_the_variant_for_guides_is_not_chosen_by_name() -> None:
    with pytest.raises(PassOptionError,
                       match="runs when a frame has guides: give the model 'small'"):
        DenoiseUpscale(model="small.guides")


def test_lost_guides_are_remarked() -> None:
    spec = guided(noisy(1), 74, 100, (Role.NORMAL, Role.DEPTH)).spec
    (remark,) = DenoiseUpscale(model="small").remarks(spec)
    assert (remark == "edges are less exact without the guides diffuse_albedo, specular_albedo, "
            "roughness")
    assert DenoiseUpscale(model="small").remarks(guided(noisy(1), 74, 100).spec) == ()
