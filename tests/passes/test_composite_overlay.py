"""Transparency overlays: enlarged, held to their coverage, and composited, against float64
references."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from postfx.frame import Frame, Role
from postfx.passes.composite import Overlay
from postfx.passes.denoise import DenoiseUpscale
from postfx.passes.display import Display
from postfx.passes.exposure_tool import ExposureTool
from postfx.pipeline import Pipeline
from postfx.runtime import Device
from tests.passes.overlay_reference import (
    disc,
    gathered,
    gaussian,
    image,
    over,
    particles,
    reference,
)

TOLERANCE = 1e-4
JITTERS = [(0.0, 0.0), (0.31, -0.44), (-0.5, 0.125)]


@pytest.fixture(scope="module")
def device() -> Device:
    return Device("cpu", threads=2)


def covered(colour: float | np.ndarray, overlay: np.ndarray, **kept) -> Frame:
    """A frame of one colour, or of these pixels, under an overlay (h, w, 4)."""
    plane = np.broadcast_to(np.asarray(colour, np.float32), (*overlay.shape[:2], 3)).copy()
    return Frame({Role.COLOUR: plane, Role.OVERLAY: overlay.astype(np.float32)}, **kept)


def enlarged(overlay: np.ndarray, device: Device, scale: float = 2, **kept) -> np.ndarray:
    """The overlay as the upscaler leaves it; no network runs."""
    passes = Pipeline([DenoiseUpscale(scale=scale, strength=0)], device, exposure=0.0)
    return passes(covered(0.5, overlay, **kept))[Role.OVERLAY]


def composited(frame: Frame, device: Device, scale: float = 2) -> Frame:
    return Pipeline([DenoiseUpscale(scale=scale, strength=0), Overlay()], device,
                    exposure=0.0)(frame)


@pytest.mark.parametrize("jitter", JITTERS)
@pytest.mark.parametrize("scale", [1, 1.5, 2, 3])
def test_a_soft_overlay_comes_out_as_its_formula_says(scale: float, jitter, device: Device) -> None:
    """The Gaussian's own values at the output's pixel centres, whatever the jitter."""
    found = enlarged(image(360, gaussian, jitter), device, scale, jitter=jitter)
    np.testing.assert_allclose(found, image(360, gaussian, scale=scale), atol=TOLERANCE, rtol=0)


def test_without_its_jitter_it_would_be_elsewhere(device: Device) -> None:
    wrong = enlarged(image(360, gaussian, JITTERS[1]), device, 2)
    assert np.abs(wrong - image(360, gaussian, scale=2)).max() > 50 * TOLERANCE


def test_a_ramp_stays_a_ramp(device: Device) -> None:
    found = enlarged(image(40, lambda x, y: x), device, 2)
    np.testing.assert_allclose(found[:, 3:-3], image(40, lambda x, y: x, scale=2)[:, 3:-3],
                               atol=TOLERANCE, rtol=0)


def test_a_step_is_two_pixels_wide_and_does_not_ring(device: Device) -> None:
    """At 1/4 and 3/4 between the samples Keys' weights of the right two come to 13/64 and 51/64."""
    found = enlarged(image(16, lambda x, y: (x > 0.5) * np.ones_like(y), colour=(4.0, 0.5, 0.0)),
                     device)
    wanted = np.concatenate([np.zeros(15), [13 / 64, 51 / 64], np.ones(15)])
    for c, colour in enumerate((4.0, 0.5, 0.0, 1.0)):
        np.testing.assert_allclose(found[:, :, c], np.tile(colour * wanted, (32, 1)), atol=1e-6,
                                   rtol=0)


@pytest.mark.parametrize("jitter", JITTERS)
@pytest.mark.parametrize("scale", [1, 1.5, 2, 2.9])
@pytest.mark.parametrize("overlay", [particles(31), particles(31, 1) * np.float32([6, 6, 6, 1]),
                                     image(31, disc)],
                         ids=["any", "bright", "disc"])
def test_enlarging_is_the_formula_in_double_precision(overlay, scale, jitter,
                                                      device: Device) -> None:
    size = (round(31 * scale),) * 2
    found = enlarged(overlay, device, scale, jitter=jitter)
    np.testing.assert_allclose(found, reference(overlay.astype(np.float32), size, jitter),
                               atol=TOLERANCE, rtol=0)


@pytest.mark.parametrize("background", [0.0, 0.02, 1.0, 500.0])
def test_no_halo_at_a_hard_edge(background: float, device: Device) -> None:
    """Every pixel is between what covers and what is behind; the same kernel without limits is
    not."""
    overlay = image(40, disc)
    found = composited(covered(background, overlay), device)[Role.COLOUR]
    pixels, weights = gathered(overlay, (80, 80), (0.0, 0.0))
    ringing = over((pixels * weights).sum((0, 1)), np.full((80, 80, 3), background))
    for c, colour in enumerate((0.9, 0.5, 0.2)):
        low, high = sorted((background, colour))
        least = TOLERANCE * max(1, background)
        assert found[..., c].min() >= low - least and found[..., c].max() <= high + least
        assert (min(ringing[..., c].min() - low, high - ringing[..., c].max()) < -10 * least
                or background == colour)


@pytest.mark.parametrize("seed", range(4))
def test_colour_stays_within_what_coverage_allows(seed: int, device: Device) -> None:
    """No colour was brighter than 1 before premultiplication, so none is afterwards, at no edge
    between colours."""
    overlay = particles(50, seed)
    found = enlarged(overlay, device, 2, jitter=(0.2, -0.3))
    alpha, colour = found[..., 3:], found[..., :3]
    assert alpha.min() >= 0 and alpha.max() <= 1 and colour.min() >= 0
    assert (colour <= alpha * (1 + 1e-5) + 1e-7).all()
    plain = Pipeline([DenoiseUpscale(scale=2, strength=0)], device, exposure=0.0)
    light = plain(Frame({Role.COLOUR: overlay[..., :3].copy()}, jitter=(0.2, -0.3)))[Role.COLOUR]
    # channel by channel, as other planes are enlarged, is not enough
    assert (light - alpha).max() > 0.01


def test_light_without_coverage_is_kept(device: Device) -> None:
    """A glow adds light and hides nothing."""
    glow = image(360, gaussian)
    glow[..., 3] = 0
    found = composited(covered(0.3, glow), device)[Role.COLOUR]
    wanted = image(360, gaussian, scale=2)[..., :3] + 0.3
    np.testing.assert_allclose(found, wanted, atol=TOLERANCE, rtol=0)


def test_compositing_is_the_formula_in_double_precision(device: Device) -> None:
    random = np.random.default_rng(0)
    overlay = particles(33) * np.float32([9, 9, 9, 1])
    planes = {Role.COLOUR: 50 * random.random((33, 33, 3), np.float32) ** 3,
              Role.ALPHA: random.random((33, 33, 1), np.float32), Role.OVERLAY: overlay}
    found = Pipeline([Overlay()], device)(Frame(planes))
    for role in (Role.COLOUR, Role.ALPHA):
        np.testing.assert_allclose(found[role], over(overlay, planes[role]), atol=TOLERANCE,
                                   rtol=1e-6)
    assert Role.OVERLAY not in found


def test_the_layer_is_kept_for_compositing_elsewhere(device: Device) -> None:
    """Without the pass the overlay comes out at the output's size, and gives the same picture when
    composited."""
    random = np.random.default_rng(1)
    frame = covered(random.random((20, 30, 3)), particles(30)[:20], jitter=(0.1, 0.4))
    frame = replace(frame,
                    planes={**frame.planes, Role.ALPHA: random.random((20, 30, 1), np.float32)})
    apart = Pipeline([DenoiseUpscale(scale=1.5, strength=0)], device, exposure=0.0)(frame)
    together, bare = composited(frame, device, 1.5), replace(frame, planes=dict(frame.planes))
    del bare.planes[Role.OVERLAY]
    assert apart[Role.OVERLAY].shape == (30, 45, 4)
    for role in (Role.COLOUR, Role.ALPHA):
        np.testing.assert_array_equal(apart[role], composited(bare, device, 1.5)[role])
        np.testing.assert_allclose(together[role], over(apart[Role.OVERLAY], apart[role]),
                                   atol=1e-6)


@pytest.mark.parametrize("scale", [1, 2])
def test_an_empty_overlay_changes_no_bit(scale: int, device: Device) -> None:
    frame = covered(np.random.default_rng(2).random((24, 40, 3)), np.zeros((24, 40, 4)))
    bare = replace(frame, planes={Role.COLOUR: frame[Role.COLOUR]})
    pipeline, other = (Pipeline([DenoiseUpscale(model="s", scale=scale), Overlay()], device,
                                exposure=0.0)
                       for _ in range(2))
    found, wanted = (run(each)[Role.COLOUR].view(np.uint32)
                     for run, each in ((pipeline, frame), (other, bare)))
    np.testing.assert_array_equal(found, wanted)
    assert pipeline.timings["overlay"] == 0
    assert "compositing for 1 frame in overlay: the overlay is 0 there" in str(pipeline.explain())


def test_only_what_is_covered_changes(device: Device) -> None:
    """Also where colours are negative or very bright."""
    behind = np.random.default_rng(3).normal(0, 1e3, (48, 48, 3)).astype(np.float32)
    corner = np.zeros((48, 48, 4), np.float32)
    corner[:10, :10] = (0.2, 0.1, 0.0, 0.5)
    found = Pipeline([Overlay()], device)(covered(behind, corner))[Role.COLOUR]
    np.testing.assert_array_equal(found[10:].view(np.uint32), behind[10:].view(np.uint32))
    assert (found[:10, :10] != behind[:10, :10]).all()


def test_frames_with_and_without_content_take_turns(device: Device) -> None:
    frames = [covered(0.5, content * particles(24)) for content in (1, 0, 1)]
    pipeline = Pipeline([Overlay()], device)
    found = [pipeline(frame)[Role.COLOUR] for frame in frames]
    np.testing.assert_array_equal(found[0], found[2])
    np.testing.assert_array_equal(found[1], frames[1][Role.COLOUR])
    (skipped,) = pipeline.savings()
    assert "ms a frame" in skipped.why


@pytest.mark.parametrize("jitter", JITTERS)
def test_an_overlay_at_output_size_is_only_composited(jitter, device: Device) -> None:
    """It may be jittered, too, in its own pixels."""
    fine = image(360, gaussian, jitter).astype(np.float32)
    frame = Frame({Role.COLOUR: np.full((180, 180, 3), 0.4, np.float32)},
                  guides={Role.OVERLAY: fine}, guide_jitter=jitter, jitter=(0.3, 0.3))
    wanted = over(image(360, gaussian), np.full((360, 360, 3), 0.4))
    np.testing.assert_allclose(composited(frame, device)[Role.COLOUR], wanted, atol=TOLERANCE,
                               rtol=0)
    blank = replace(frame, guides={Role.OVERLAY: np.zeros_like(fine)})
    assert (composited(blank, device)[Role.COLOUR] == np.float32(0.4)).all()


def test_an_overlay_at_output_size_is_no_guide_for_edges() -> None:
    frame = Frame({Role.COLOUR: np.ones((20, 20, 3), np.float32)},
                  guides={Role.OVERLAY: np.zeros((30, 30, 4), np.float32)})
    pass_ = DenoiseUpscale()
    assert pass_.reflect(frame.spec).output.width == 30
    assert not pass_._networks.is_guided(frame.spec)
    plan = Pipeline([pass_, Overlay()]).explain(frame.spec)
    assert plan.guides == (Role.OVERLAY,) and "edges are less exact" not in str(plan)
    alone = Pipeline([Overlay()]).explain(frame.spec)
    assert ("overlay: the overlay has the output's size, and nothing enlarges the "
            "colour" in str(alone))


def test_it_is_exposed_with_the_picture(device: Device) -> None:
    """Composited in the scene's light, then exposed: as one picture."""
    frame = covered(0.02, particles(20))
    for exposure in (-2.0, 3.0):
        passes = [DenoiseUpscale(scale=2, strength=0), Overlay(), Display()]
        found = Pipeline(passes, device, exposure=exposure)(frame)[Role.COLOUR]
        wanted = Pipeline([Display()], device,
                          exposure=exposure)(composited(frame, device))[Role.COLOUR]
        np.testing.assert_array_equal(found, wanted)


def test_values_that_no_file_should_hold(device: Device) -> None:
    overlay = particles(30)
    overlay[::3, ::2] = np.nan
    overlay[1::5, 1::3, :3] = np.inf
    overlay[2::7, ::4, 3] = 7.0
    overlay[4::7, ::4, 3] = -7.0
    frame = covered(0.5, overlay)
    found = composited(frame, device)
    assert (all(np.isfinite(plane).all() for plane in found.planes.values())
            and found[Role.COLOUR].min() >= 0)
    assert np.isfinite(Pipeline([Overlay()], device)(frame)[Role.COLOUR]).all()


def test_tone_mapped_pictures_are_left_alone() -> None:
    frame = replace(covered(0.5, particles(8)), encoding="srgb")
    assert "colour is srgb" in Overlay().skip(frame.spec)
    assert (Overlay().skip(
        replace(frame, planes={Role.COLOUR: frame[Role.COLOUR]}, encoding="scene-linear").spec
    ) == (
        "there is no overlay"))


def test_an_overlay_that_is_forgotten_is_remarked() -> None:
    spec = covered(0.5, particles(8)).spec
    assert any("overlay is not composited" in remark
               for remark in Pipeline([Display()]).explain(spec).remarks)
    assert Pipeline([Overlay(), Display()]).explain(spec).remarks == ()


def test_the_exposure_tool_is_not_covered(device: Device) -> None:
    frame = covered(0.5, particles(40))
    found = Pipeline([ExposureTool(), Overlay()], device, exposure=0.0)(frame)
    np.testing.assert_array_equal(found[Role.COLOUR],
                                  Pipeline([ExposureTool()], device, exposure=0.0)(frame)[
        Role.COLOUR])
    assert Role.OVERLAY not in found


def test_a_memory_budget_changes_no_bit() -> None:
    random = np.random.default_rng(4)
    frames = [covered(random.random((320, 400, 3)), content * image(400, disc)[:320])
              for content in (1, 0)]
    results = []
    for memory in (None, "16M"):
        passes = [DenoiseUpscale(model="s", strength=0), Overlay()]
        pipeline = Pipeline(passes, Device("cpu", threads=2, memory=memory), exposure=0.0)
        results.append([pipeline(frame)[Role.COLOUR].copy() for frame in frames])
    np.testing.assert_array_equal(results[0], results[1])
