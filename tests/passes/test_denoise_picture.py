"""A network that gives the picture alone: another one filters its alpha and parts."""

from __future__ import annotations

import numpy as np
import pytest

from postfx import DenoiseUpscale, Device, Frame, Pipeline
from postfx.frame import Part, Role

SIZE = 48, 64


def shot(alpha: np.ndarray | None = None, parts: bool = False) -> list[Frame]:
    """Two noisy frames, still and with all planes of surfaces."""
    random = np.random.default_rng(8)
    frames = []
    for number in (1, 2):
        colour = random.gamma(2.0, 0.5, (*SIZE, 3)).astype(np.float32)
        planes = {
            Role.COLOUR: colour,
            Role.DIFFUSE_ALBEDO: np.full((*SIZE, 3), 0.5, np.float32),
            Role.NORMAL: np.tile(np.float32([0, 0, 1]), (*SIZE, 1)),
            Role.DEPTH: np.full((*SIZE, 1), 3, np.float32),
            Role.MOTION: np.zeros((*SIZE, 2), np.float32),
        }
        if alpha is not None:
            planes[Role.ALPHA] = alpha
        light = {"key": 0.25 * colour, "fill": 0.75 * colour} if parts else {}
        frames.append(Frame(planes, number=number, parts=light))
    return frames


def denoised(model: str, frames: list[Frame], **options: object) -> list[dict[Role, np.ndarray]]:
    chain = Pipeline([DenoiseUpscale(scale=1, model=model, **options)], Device("cpu", threads=2))
    results = map(chain, frames)
    return [{role: np.array(plane) for role, plane in found.planes.items()} for found in results]


@pytest.mark.parametrize("model", ["l", "xl"])
@pytest.mark.parametrize("albedo", [1.5, 3.0, 13.0])
def test_albedo_above_one_takes_no_light(model: str, albedo: float) -> None:
    """As of a backdrop whose texture is brighter than white: 13 once took half of the light."""
    (frame, _), (usual, _) = shot(), shot()
    frame.planes[Role.DIFFUSE_ALBEDO][:] = albedo
    found, wanted = (denoised(model, [one])[0][Role.COLOUR].mean() for one in (frame, usual))
    assert found == pytest.approx(wanted, rel=0.05)


def test_opaque_alpha_changes_nothing() -> None:
    alone, opaque = denoised("l", shot()), denoised("l", shot(np.ones((*SIZE, 1), np.float32)))
    for first, second in zip(alone, opaque, strict=True):
        np.testing.assert_array_equal(first[Role.COLOUR], second[Role.COLOUR])
        assert (second[Role.ALPHA] == 1).all()


def noisy_alpha() -> np.ndarray:
    return np.random.default_rng(1).choice(np.float32([0, 0.5, 1]), (*SIZE, 1))


def test_noisy_alpha_is_filtered_by_another_network_beside_a_picture_that_stays_as_it_is() -> None:
    step = DenoiseUpscale(scale=1, model="l")
    chain = Pipeline([step], Device("cpu", threads=2))
    expected, smooth = denoised("l", shot()), denoised("m", shot(noisy_alpha()))
    for frame, wanted, other in zip(shot(noisy_alpha()), expected, smooth, strict=True):
        found = chain(frame)
        assert not chain.noticed
        np.testing.assert_array_equal(found[Role.COLOUR], wanted[Role.COLOUR])
        np.testing.assert_array_equal(found[Role.ALPHA], other[Role.ALPHA])


def test_alpha_s_own_history_is_kept_for_a_run_that_goes_on() -> None:
    whole, frames = denoised("l", shot(noisy_alpha())), shot(noisy_alpha())
    before, after = (Pipeline([DenoiseUpscale(scale=1, model="l")], Device("cpu", threads=2))
                     for _ in range(2))
    before(frames[0])
    after.recall(frames[0], before.history())
    found = after(frames[1])
    for role in (Role.COLOUR, Role.ALPHA):
        np.testing.assert_array_equal(found[role], whole[1][role])


def test_alpha_that_was_clean_in_between_begins_anew() -> None:
    clean = np.ones((*SIZE, 1), np.float32)
    first, second = shot(noisy_alpha()), shot(clean)
    mixed = [first[0], second[1], *first[2:]]
    found = denoised("l", mixed)
    assert (found[1][Role.ALPHA] == 1).all()
    for one, wanted in zip(found, denoised("l", shot()), strict=True):
        np.testing.assert_array_equal(one[Role.COLOUR], wanted[Role.COLOUR])


def test_alpha_that_is_kept_as_it_is_keeps_the_network() -> None:
    alpha = np.random.default_rng(1).choice(np.float32([0, 0.5, 1]), (*SIZE, 1))
    alone, kept = denoised("l", shot()), denoised("l", shot(alpha), alpha=False)
    for first, second in zip(alone, kept, strict=True):
        np.testing.assert_array_equal(first[Role.COLOUR], second[Role.COLOUR])
        np.testing.assert_array_equal(second[Role.ALPHA], alpha)


LIGHTS = [Part("key", group="lights"), Part("fill", group="lights")]


@pytest.mark.parametrize("strength", [0.5, 1.0])
@pytest.mark.parametrize("filters", ["picture", "own"])
def test_parts_add_up_to_the_picture_that_frames_without_them_have(
    filters: str, strength: float
) -> None:
    step = DenoiseUpscale(scale=1, model="l", parts=LIGHTS, part_filters=filters,
                          strength=strength)
    frames, chain = shot(parts=True), Pipeline([step], Device("cpu", threads=2))
    assert "network m filters parts" in step.reflect(frames[0].spec).notes
    for frame, wanted in zip(frames, denoised("l", shot(), strength=strength), strict=True):
        found = chain(frame)
        picture = found[Role.COLOUR]
        np.testing.assert_array_equal(picture, wanted[Role.COLOUR])
        np.testing.assert_allclose(found.parts["key"] + found.parts["fill"], picture, rtol=1e-5)


def test_parts_are_those_of_the_network_with_filters_with_their_share_of_the_picture() -> None:
    ours, other = (Pipeline([DenoiseUpscale(scale=1, model=model, parts=LIGHTS)],
                            Device("cpu", threads=2)) for model in ("l", "m"))
    for frame in shot(parts=True):
        found, wanted = ours(frame), other(frame)
        for part in ("key", "fill"):
            np.testing.assert_allclose(found.parts[part] / found[Role.COLOUR],
                                       wanted.parts[part] / wanted[Role.COLOUR], rtol=1e-4)


def test_parts_that_are_some_of_the_picture_follow_it() -> None:
    key = [Part("key", group="lights")]
    ours, other = (Pipeline([DenoiseUpscale(scale=1, model=model, parts=key)],
                            Device("cpu", threads=2)) for model in ("l", "m"))
    for frame in shot(parts=True):
        found, wanted = ours(frame), other(frame)
        np.testing.assert_allclose(found.parts["key"] / found[Role.COLOUR],
                                   wanted.parts["key"] / wanted[Role.COLOUR], rtol=1e-4)


def test_histories_of_parts_go_on_beside_the_picture() -> None:
    frames = shot(noisy_alpha(), parts=True)
    chains = [Pipeline([DenoiseUpscale(scale=1, model="l", parts=LIGHTS, part_filters="own")],
                       Device("cpu", threads=2)) for _ in range(2)]
    first = chains[0](frames[0])
    chains[1].recall(frames[0], {name: np.array(value)
                                 for name, value in chains[0].history().items()})
    whole, again = (chain(frames[1]) for chain in chains)
    assert np.abs(first.parts["key"] - whole.parts["key"]).max() > 1e-3
    for part in ("key", "fill"):
        np.testing.assert_array_equal(again.parts[part], whole.parts[part])
    np.testing.assert_array_equal(again[Role.ALPHA], whole[Role.ALPHA])


@pytest.mark.parametrize("strength", [0.5, 1.0])
def test_a_first_frame_differs_from_the_stand_in(strength: float) -> None:
    """The network at the render's size is one of its own."""
    (ours, _), (other, _) = (denoised(model, shot(), strength=strength) for model in ("l", "m"))
    assert np.abs(ours[Role.COLOUR] - other[Role.COLOUR]).max() > 1e-3
