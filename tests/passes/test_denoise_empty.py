"""Black frames, and black parts of stills: no network runs there, and they are what it would make
of them."""

from pathlib import Path

import numpy as np
import onnx
import pytest

from postfx import Device, Frame, Pipeline, Role
from postfx.frame import FrameSpec
from postfx.passes.denoise import DenoiseUpscale
from postfx.passes.denoise.frame import ReadyNetwork
from postfx.passes.denoise.models import reach_of
from postfx.testing import make_frame

ROLES = (Role.COLOUR, Role.DEPTH, Role.NORMAL, Role.MOTION, Role.DIFFUSE_ALBEDO,
         Role.SPECULAR_ALBEDO, Role.ROUGHNESS)
BLACK = (1, 2, 4)
"""Frames without light: at the start, where no history is, and after a lit one."""
ALL_BLACK = "all is black"
BLACK_THERE = "all is black there"
LIT = 24
"""Pixels along a side of what is lit in a corner of a still."""
WIDE, HIGH = 330, 300
MODELS = Path(__file__).parent.parent.parent / "models"


def frames(alpha: bool) -> list[Frame]:
    roles = (*ROLES, Role.ALPHA) if alpha else ROLES
    made = [make_frame(FrameSpec(44, 36, roles), number, reset=number == 1)
            for number in range(1, 6)]
    for frame in made:
        if frame.number in BLACK:
            for role in {Role.COLOUR, Role.ALPHA} & frame.planes.keys():
                frame.planes[role][...] = 0
    return made


def run(device: Device, given: list[Frame],
        **options: object) -> tuple[list[Frame], dict[str, str]]:
    instance = DenoiseUpscale(**options)
    way = Pipeline([instance], device, exposure=1.0)
    return [way(frame) for frame in given], {why.split(";")[0]: what
                                             for what, why in instance.savings()}


@pytest.fixture(scope="module")
def device() -> Device:
    return Device("cpu", threads=2)


@pytest.mark.parametrize("alpha", [False, True])
@pytest.mark.parametrize(("model", "scale"),
                         [("s", 1), ("s", 2), ("m", 2), ("m.fp32", 1), ("classic", 2)])
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


SAME = "all is as in the frame before"
OTHER = 30.0
"""Light of a pixel, brighter than all others."""


@pytest.mark.parametrize(("scale", "roles"), [(1, ROLES), (2, ROLES), (2, ROLES[:3])])
def test_frames_that_are_the_one_before_are_not_denoised_again(
    device: Device, scale: int, roles: tuple[Role, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The third alike one is the first that is known to be the same. What follows goes on as if it
    had run."""
    monkeypatch.setattr("postfx.passes.denoise.RepeatDetector.__call__",
                        lambda _, planes: bool(planes[Role.COLOUR][40, 40, 0] < OTHER))

    def shot() -> list[Frame]:
        made = [make_frame(FrameSpec(64, 48, roles), 1) for _ in range(6)]
        made[5].planes[Role.COLOUR][40, 40] = OTHER  # has a history, if there is motion
        for number, frame in enumerate(made, 1):
            frame.number = number
        return made

    skipped, why = run(device, shot(), model="s", scale=scale)
    monkeypatch.setattr("postfx.repeats.FrameMemory._is_same", lambda *_: False)
    whole, none = run(device, shot(), model="s", scale=scale)
    assert why[SAME] == "network for 3 frames" and SAME not in none
    for one, other in zip(skipped, whole, strict=True):
        np.testing.assert_array_equal(one[Role.COLOUR], other[Role.COLOUR])
    assert (whole[5][Role.COLOUR] != whole[4][Role.COLOUR]).any()


def test_what_goes_on_from_a_history_is_never_the_same(device: Device,
                                                       monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("postfx.passes.denoise.RepeatDetector.__call__", lambda *_: False)
    clean = [make_frame(FrameSpec(64, 48, ROLES), 1) for _ in range(4)]
    assert SAME not in run(device, clean, model="s")[1]


def still(alpha: bool, lit: int = LIT, roles: tuple[Role, ...] = ROLES[:3] + ROLES[4:]) -> Frame:
    """A frame without motion, lit in its last rows and first columns only."""
    made = make_frame(FrameSpec(WIDE, HIGH, (*roles, Role.ALPHA) if alpha else roles))
    for role in {Role.COLOUR, Role.ALPHA} & made.planes.keys():
        made.planes[role][:HIGH - lit] = 0
        made.planes[role][:, lit:] = 0
    return made


@pytest.mark.parametrize(("model", "scale", "alpha"), [
    ("s", 2, False), ("s.fp32", 1, True), ("m", 2, True), ("m", 1.5, False), ("m.fp32", 1, False),
    ("classic", 2, False)])
def test_what_is_black_in_a_still_is_skipped_and_the_rest_stays(
    device: Device, model: str, scale: float, alpha: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """To the bit, but for networks in float32: their convolutions' tiles begin where a window
    does."""
    skipped, why = run(device, [still(alpha)], model=model, scale=scale)
    monkeypatch.setattr(ReadyNetwork, "lit_cells", lambda *_: None)
    whole, none = run(device, [still(alpha)], model=model, scale=scale)
    assert BLACK_THERE in why and BLACK_THERE not in none
    for role in whole[0].planes:
        if "fp32" in model:
            np.testing.assert_allclose(skipped[0][role], whole[0][role], rtol=0, atol=5e-5)
        else:
            np.testing.assert_array_equal(skipped[0][role], whole[0][role])
    assert whole[0][Role.COLOUR].any()


def test_black_parts_are_not_skipped_where_a_history_would_miss_them_or_little_is_black(
    device: Device
) -> None:
    for frame in (still(False, roles=ROLES), still(False, lit=HIGH)):
        assert BLACK_THERE not in run(device, [frame], model="m")[1]


def reach_in(path: Path) -> int:
    """Input pixels that an output of a network sees to one side at most."""
    graph = onnx.load(path).graph
    seen = {one.name: (1, 0) for one in graph.input}  # input pixels of a step, and reach
    for node in graph.node:
        known = [seen[name] for name in node.input if name in seen]
        step = max(one[0] for one in known) if known else 1
        reach = max((one[1] for one in known), default=0)
        facts = {fact.name: onnx.helper.get_attribute_value(fact) for fact in node.attribute}
        side, stride = facts.get("kernel_shape", [1])[0], facts.get("strides", [1])[0]
        if node.op_type == "Conv":
            reach += step * (side // 2 + stride - 1)
        elif node.op_type == "MaxPool":
            reach += step * (side - 1)
        elif node.op_type == "Resize":
            reach, stride = reach + step, 0.5
        for name in node.output:
            seen[name] = int(step * stride), reach
    return max(seen[one.name][1] for one in graph.output)


@pytest.mark.parametrize("model", ["s", "s.1x", "m", "m.1x", "m.guides", "l"])
def test_networks_see_no_farther_than_is_said(model: str) -> None:
    name = f"denoise_upscale.{model}"
    said = reach_of([name])
    assert said / 3 < reach_in(MODELS / f"{name}.onnx") <= said
    assert reach_of([name, "denoise_upscale.other"]) == 0
