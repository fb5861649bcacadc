"""The upscaler's network and its operations."""

from __future__ import annotations

from dataclasses import fields, replace

import pytest

torch = pytest.importorskip("torch")

from tests.training.small_denoiser import SMALL, small_model  # noqa: E402
from training import ops  # noqa: E402
from training.denoise.model import (  # noqa: E402
    FEATURES,
    FINE,
    HIDDEN,
    Inputs,
    State,
    Trunk,
    empty_state,
    mirror_to_multiple,
)

SIZES = {1: (18, 30), 1.5: (27, 45), 2: (36, 60), 2.7: (49, 81), 3: (54, 90)}


def frame(seed: int, n: int = 2, h: int = 18, w: int = 30) -> Inputs:
    torch.manual_seed(seed)
    return Inputs(
        torch.rand(n, 3, h, w) ** 4 * 30, torch.rand(n, 3, h, w), torch.rand(n, 3, h, w) * 0.3,
        torch.randn(n, 3, h, w), torch.rand(n, 1, h, w), torch.rand(n, 1, h, w) * 5 + 1,
        torch.randn(n, 2, h, w) * 3, torch.rand(n, 2) - 0.5,
    )


def random_state(inputs: Inputs, height: int, width: int) -> State:
    empty = empty_state(inputs, height, width)
    values = {f.name: torch.rand_like(getattr(empty, f.name)) * 5 + 0.1 for f in fields(State)}
    return State(**{**values, "fresh": torch.ones_like(empty.fresh)})


def test_trunk_gives_kernels_of_all_levels() -> None:
    heads = Trunk(SMALL)(torch.rand(2, FEATURES, 32, 48))
    assert [tuple(head.shape) for head in heads] == [
        (2, FINE, 32, 48), (2, 26, 16, 24), (2, 26, 8, 12), (2, 26, 4, 6), (2, 25, 2, 3)]
    assert all((head[:, :25] > 0).all() for head in heads)
    assert heads[0][:, -HIDDEN:].abs().max() < 1


def test_what_lies_beyond_the_edge_is_the_mirrored_picture() -> None:
    image = torch.rand(1, 2, 27, 35)
    padded = mirror_to_multiple(image)
    assert padded.shape[-2:] == (32, 48)
    torch.testing.assert_close(padded[..., :27, :35], image, rtol=0, atol=0)
    torch.testing.assert_close(padded[..., 27:, :35], image[..., 21:26, :].flip(-2), rtol=0, atol=0)
    torch.testing.assert_close(padded[..., :27, 35:], image[..., 21:34].flip(-1), rtol=0, atol=0)
    assert mirror_to_multiple(image[..., :1, :3]).shape[-2:] == (16, 16)


@pytest.mark.parametrize("scale", SIZES)
def test_the_network_gives_every_output_size(scale: float) -> None:
    inputs = frame(1)
    with torch.no_grad():
        output, state, reprojected = small_model()(inputs, empty_state(inputs, *SIZES[scale]))
    assert output.shape == state.output.shape == reprojected.shape == (2, 3, *SIZES[scale])
    assert torch.isfinite(output).all() and output.min() >= 0
    assert state.hidden.shape == (2, HIDDEN, 18, 30)


def test_history_counts_until_it_is_dropped() -> None:
    model, inputs = small_model(), frame(1)
    state = random_state(inputs, 36, 60)
    keep = torch.tensor([1.0, 0.0])[:, None, None, None]
    with torch.no_grad():
        first = model(inputs, empty_state(inputs, 36, 60))[0]
        later = model(inputs, state.drop(keep))[0]
    assert (later[0] - first[0]).abs().max() > 1e-2
    torch.testing.assert_close(later[1], first[1], rtol=0, atol=0)


def test_a_static_flat_picture_stays_as_it_is_when_the_exposure_changes() -> None:
    model, inputs = small_model(), frame(1)
    still = replace(inputs, motion=torch.zeros_like(inputs.motion),
                    colour=torch.full_like(inputs.colour, 0.4),
                    diffuse_albedo=torch.full_like(inputs.diffuse_albedo, 0.5),
                    specular_albedo=torch.zeros_like(inputs.specular_albedo))
    brighter = replace(still, colour=still.colour * 3, gain=torch.full((2, 1, 1, 1), 3.0))
    with torch.no_grad():
        _, state, _ = model(still, empty_state(still, 36, 60))
        output, _, _ = model(brighter, state)
    torch.testing.assert_close(output, torch.full_like(output, 1.2), rtol=1e-4, atol=0)


def test_gain_of_one_is_no_gain() -> None:
    model, inputs = small_model(), frame(1)
    state = random_state(inputs, 36, 60)
    with torch.no_grad():
        with_gain = model(replace(inputs, gain=torch.ones(2, 1, 1, 1)), state)[0]
        torch.testing.assert_close(with_gain, model(inputs, state)[0], rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("bad", [float("nan"), float("inf"), -float("inf"), -1.0], ids=str)
def test_bad_planes_give_a_finite_picture(bad: float) -> None:
    inputs = frame(1)
    state = random_state(inputs, 36, 60)
    for name in ("colour", "diffuse_albedo", "specular_albedo", "normal", "roughness", "depth",
                 "motion"):
        getattr(inputs, name)[..., 4:6, 4:9] = bad
    with torch.no_grad():
        output, after, _ = small_model()(inputs, state)
    assert torch.isfinite(output).all() and torch.isfinite(after.accumulated).all()


@pytest.mark.parametrize("size", [(7, 9), (16, 20)])
def test_general_upsampling_equals_the_short_cut_at_scale_2(size: tuple[int, int]) -> None:
    torch.manual_seed(0)
    h, w = size
    radiance = torch.rand(2, 3, h, w)
    weights = torch.rand(2, 9, 4, h, w) + 0.1
    jitter = torch.rand(2, 2) - 0.5
    general = ops.upsample_any(radiance, weights, jitter, 2 * h, 2 * w)
    torch.testing.assert_close(general, ops.upsample_double(radiance, weights, jitter))
    controls = ops.interpolate_any(weights, 2 * h, 2 * w)
    torch.testing.assert_close(controls, ops.interpolate_phases(weights, 2 * h, 2 * w))


@pytest.mark.parametrize("scale", SIZES)
def test_box_mean_is_adaptive_average_pooling(scale: float) -> None:
    image = torch.rand(2, 3, *SIZES[scale])
    torch.testing.assert_close(ops.box_mean(image, 18, 30),
                               torch.nn.functional.adaptive_avg_pool2d(image, (18, 30)))


def test_motion_of_a_nearer_neighbour_wins() -> None:
    depth, motion = torch.full((1, 1, 5, 5), 4.0), torch.zeros(1, 2, 5, 5)
    depth[..., 2, 2], motion[..., 2, 2] = 1.0, 7.0
    moved = ops.dilate_motion(motion, depth)
    assert (moved[..., 1:4, 1:4] == 7).all() and moved.sum() == 2 * 9 * 7


def test_nearest_warp_takes_the_pixel_under_the_rounded_position() -> None:
    image = torch.arange(20.0).reshape(1, 1, 4, 5)
    motion = torch.zeros(1, 2, 4, 5)
    motion[:, 0], motion[:, 1] = 1.4, -0.6
    warped = ops.warp_nearest(image, motion)[0, 0]
    assert warped[2, 1] == image[0, 0, 1, 2]
    assert warped[0, 4] == image[0, 0, 0, 4]  # the edge repeats
