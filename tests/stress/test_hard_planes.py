"""Planes that only some frames have, broken in every way, and providers other than the compiled
rows."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from postfx.frame import GUIDE_ROLES, Frame, Role
from postfx.passes.exposure_tool import GREYS, ExposureTool
from postfx.pipeline import Pipeline
from postfx.runtime import Device
from postfx.tools.bench.stress import BRIGHTEST_OUTPUT, HARD, LIGHT_CHANGES
from tests.passes import mirror_scene
from tests.passes.denoise_frames import guided, noisy
from tests.stress.scenes import held, on, pipeline, way

VALUES = (0.0, 1e-42, -1.0, 65504.0, 1e10, 3.4e38, np.nan, np.inf, -np.inf)
SIZE = (24, 32)


def with_plane(frame: Frame, role: Role, values: np.ndarray | float) -> Frame:
    channels = {Role.OPAQUE_COLOUR: 3}.get(role, 1)
    plane = np.broadcast_to(values, (*frame[Role.COLOUR].shape[:2], channels)).astype(np.float32)
    return replace(frame, planes={**frame.planes, role: plane})


def assert_light(chain: Pipeline, frames: list[Frame], what: object) -> None:
    """Finite and in range, frame after frame from the first on; a clean one comes last."""
    chain.reset()
    for frame in frames:
        colour = chain(frame)[Role.COLOUR]
        assert np.isfinite(colour).all() and colour.min() >= 0, what
        assert colour.max() * chain.exposure_factor <= BRIGHTEST_OUTPUT, what


@on(cpu=("s.fp32, portable", "s.fp16", "l.int8"),
    gpu=("s.fp32, portable", "s.fp16, portable", "m.fp16", "l.fp16"))
def test_other_providers_and_precisions(model: str, device: Device) -> None:
    for name, change in HARD.items():
        assert_light(held(*way(model, device)), [change(noisy(1, *SIZE)), noisy(2, *SIZE)], name)


@pytest.mark.parametrize("role", [Role.REACTIVE, Role.STRENGTH, Role.OPAQUE_COLOUR], ids=str)
def test_masks_of_any_values(role: Role, device: Device) -> None:
    """All of a frame, and every third row beside what is usual."""
    chain = pipeline("s.fp32", device, "auto")
    for value in VALUES:
        rows = np.full((SIZE[0], 1, 1), 0.5)
        rows[::3] = value
        planes = enumerate((value, rows, 0.5), 1)
        assert_light(chain,
                     [with_plane(noisy(number, *SIZE), role, values) for number, values in planes],
                     value)


@on(cpu=("s.fp32", "s.fp32, portable"), gpu=("s.fp32", "s.fp32, portable"))
def test_hit_distances_of_any_values(model: str, device: Device) -> None:
    """A polished floor seen by a camera that moves."""
    chain = pipeline(*way(model, device), "auto")
    for value in VALUES:
        frames = [mirror_scene.frame(number, *SIZE[::-1]) for number in (3, 4, 5)]
        for frame in frames[:2]:
            frame[Role.SPECULAR_HIT_DISTANCE][::2] = value
        assert_light(chain, frames, value)


@on(cpu=("m.fp32", "m.int8"), gpu=("m.fp32", "m.fp16"))
def test_guides_of_any_values(model: str, device: Device) -> None:
    """All guides at once, every second row, then all over."""
    size, chain = (2 * SIZE[0], 2 * SIZE[1]), pipeline(model, device, "auto")
    for value in VALUES:
        frames = [guided(noisy(number, *SIZE), *size) for number in (1, 2, 3)]
        for frame, rows in zip(frames, (np.s_[::2], np.s_[:]), strict=False):
            for role in GUIDE_ROLES:
                frame.guides[role][rows] = value
        assert_light(chain, frames, value)


def test_the_exposure_tool_is_visible_on_any_light(device: Device) -> None:
    chain = Pipeline([ExposureTool()], device, cuts="none")
    for change in LIGHT_CHANGES.values():
        exposed = chain(change(noisy(1, *SIZE)))[Role.COLOUR] * chain.exposure_factor
        np.testing.assert_allclose((exposed.min(), exposed.max()), GREYS, rtol=1e-6)
