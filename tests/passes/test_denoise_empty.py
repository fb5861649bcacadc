"""Black frames: nothing runs for them, and they are what the network would make of them."""

import numpy as np
import pytest

from postfx import Device, Frame, Pipeline, Role
from postfx.frame import FrameSpec
from postfx.passes.denoise import DenoiseUpscale
from postfx.passes.denoise.frame import ReadyNetwork
from postfx.testing import make_frame

ROLES = (Role.COLOUR, Role.DEPTH, Role.NORMAL, Role.MOTION, Role.DIFFUSE_ALBEDO, Role.SPECULAR_ALBEDO, Role.ROUGHNESS)
BLACK = (1, 2, 4)
"""Frames without light: at the start, where no history is, and after a lit one."""
ALL_BLACK = "all is black"


def frames(alpha: bool) -> list[Frame]:
    roles = (*ROLES, Role.ALPHA) if alpha else ROLES
    made = [make_frame(FrameSpec(44, 36, roles), number, reset=number == 1) for number in range(1, 6)]
    for frame in made:
        if frame.number in BLACK:
            for role in {Role.COLOUR, Role.ALPHA} & frame.planes.keys():
                frame.planes[role][...] = 0
    return made


def run(device: Device, given: list[Frame], **options: object) -> tuple[list[Frame], dict[str, str]]:
    instance = DenoiseUpscale(**options)
    way = Pipeline([instance], device, exposure=1.0)
    return [way(frame) for frame in given], {why.split(";")[0]: what for what, why in instance.savings()}


@pytest.fixture(scope="module")
def device() -> Device:
    return Device("cpu", threads=2)


@pytest.mark.parametrize("alpha", [False, True])
@pytest.mark.parametrize(("model", "scale"), [("s", 1), ("s", 2), ("m", 2), ("m.fp32", 1), ("classic", 2)])
def test_a_black_frame_is_what_the_network_makes_of_it(
    device: Device, model: str, scale: int, alpha: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    skipped, why = run(device, frames(alpha), model=model, scale=scale)
    monkeypatch.setattr(ReadyNetwork, "is_empty", lambda *_: False)
    whole, none = run(device, frames(alpha), model=model, scale=scale)
    assert why[ALL_BLACK] == "network for 2 frames" and ALL_BLACK not in none
    for one, other in list(zip(skipped, whole, strict=True))[:2]:
        assert one.planes.keys() == other.planes.keys()
        for role in one.planes:
            np.testing.assert_array_equal(one[role], other[role])
        assert not one[Role.COLOUR].any()


def test_the_frame_after_it_begins_anew(device: Device) -> None:
    """A history of no light would only darken it."""
    after, _ = run(device, frames(False)[:3], model="s")
    alone, _ = run(device, frames(False)[2:3], model="s")
    np.testing.assert_array_equal(after[2][Role.COLOUR], alone[0][Role.COLOUR])


def test_a_single_lit_pixel_or_alpha_alone_is_no_empty_frame(device: Device) -> None:
    lit, covered = frames(True)[:1], frames(True)[:1]
    lit[0].planes[Role.COLOUR][20, 20] = 1e-6
    covered[0].planes[Role.ALPHA][20, 20] = 0.5
    assert ALL_BLACK not in run(device, lit, model="s")[1]
    assert ALL_BLACK not in run(device, covered, model="s")[1]
