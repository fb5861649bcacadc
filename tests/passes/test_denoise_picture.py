"""A network that gives the picture alone: alpha and parts take another one."""

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


def test_opaque_alpha_changes_nothing() -> None:
    alone, opaque = denoised("l", shot()), denoised("l", shot(np.ones((*SIZE, 1), np.float32)))
    for first, second in zip(alone, opaque, strict=True):
        np.testing.assert_array_equal(first[Role.COLOUR], second[Role.COLOUR])
        assert (second[Role.ALPHA] == 1).all()


def test_noisy_alpha_takes_the_network_with_filters_and_says_so_once() -> None:
    alpha = np.random.default_rng(1).choice(np.float32([0, 0.5, 1]), (*SIZE, 1))
    step = DenoiseUpscale(scale=1, model="l")
    chain = Pipeline([step], Device("cpu", threads=2))
    expected = denoised("m", shot(alpha))
    told = []
    for frame, wanted in zip(shot(alpha), expected, strict=True):
        found = chain(frame)
        told.append(chain.noticed)
        np.testing.assert_array_equal(found[Role.COLOUR], wanted[Role.COLOUR])
        np.testing.assert_array_equal(found[Role.ALPHA], wanted[Role.ALPHA])
    assert any("its alpha is noisy, so model 'm" in line for line in told[0])
    assert not told[1]


def test_alpha_that_is_kept_as_it_is_keeps_the_network() -> None:
    alpha = np.random.default_rng(1).choice(np.float32([0, 0.5, 1]), (*SIZE, 1))
    alone, kept = denoised("l", shot()), denoised("l", shot(alpha), alpha=False)
    for first, second in zip(alone, kept, strict=True):
        np.testing.assert_array_equal(first[Role.COLOUR], second[Role.COLOUR])
        np.testing.assert_array_equal(second[Role.ALPHA], alpha)


def test_parts_take_the_network_with_filters_and_the_plan_says_so() -> None:
    parts = [Part("key", group="lights"), Part("fill", group="lights")]
    step = DenoiseUpscale(scale=1, model="l", parts=parts)
    frames = shot(parts=True)
    notes = step.remarks(frames[0].spec)
    assert any("'l' filters the picture alone: 'm' runs" in note for note in notes)
    ours, expected = (denoised(model, frames, parts=parts) for model in ("l", "m"))
    for found, wanted in zip(ours, expected, strict=True):
        np.testing.assert_array_equal(found[Role.COLOUR], wanted[Role.COLOUR])


@pytest.mark.parametrize("strength", [0.5, 1.0])
def test_a_first_frame_differs_from_the_stand_in(strength: float) -> None:
    """The network at the render's size is one of its own."""
    (ours, _), (other, _) = (denoised(model, shot(), strength=strength) for model in ("l", "m"))
    assert np.abs(ours[Role.COLOUR] - other[Role.COLOUR]).max() > 1e-3
