"""Any frame is processed or refused in a line: frames, pipelines, one picture and frames between,
by Hypothesis."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import postfx
from postfx.errors import PostfxError
from postfx.frame import ROLES, Frame, Role
from postfx.interpolate import Interpolator
from postfx.passes.denoise import DenoiseUpscale
from postfx.passes.tonemap import ToneMap
from postfx.pipeline import Pipeline
from postfx.runtime import Device

QUICK, MANY = 4, 500
READ = (Role.ALPHA, Role.DEPTH, Role.MOTION, Role.NORMAL, Role.DIFFUSE_ALBEDO, Role.ROUGHNESS)
VALUES = (0.0, 1.0, -1.0, 0.18, 1e-30, 65504.0, 1e10, -1e10, 3e38, np.nan, np.inf, -np.inf)
"""What planes may hold beside noise."""
SIDES = st.integers(1, 40)


@st.composite
def planes(draw: st.DrawFn, size: tuple[int, int]) -> dict[Role, np.ndarray]:
    """Planes of a size: noise of any brightness, or one value, with single pixels of others."""
    random = np.random.default_rng(draw(st.integers(0, 1 << 16)))
    found = {}
    for role in (Role.COLOUR, *draw(st.lists(st.sampled_from(READ), unique=True, max_size=3))):
        shape = *size, ROLES[role].channels
        plane = random.standard_normal(shape) * 2.0 ** draw(st.integers(-20, 20))
        plane = np.abs(plane) if role is not Role.MOTION and draw(st.booleans()) else plane
        if draw(st.integers(0, 4)) == 0:
            plane = np.full(shape, draw(st.sampled_from(VALUES)))
        for value in draw(st.lists(st.sampled_from(VALUES), max_size=3)):
            plane[random.integers(size[0]), random.integers(size[1])] = value
        found[role] = plane.astype(np.float32)
    return found


@st.composite
def shots(draw: st.DrawFn) -> list[Frame]:
    """One to three frames, mostly of one size."""
    size = draw(st.tuples(SIDES, SIDES))
    count = draw(st.integers(1, 3))
    sizes = [size if draw(st.integers(0, 9)) else draw(st.tuples(SIDES, SIDES))
             for _ in range(count)]
    return [Frame(draw(planes(one)), number=number, reset=draw(st.booleans()))
            for number, one in enumerate(sizes)]


def examples(check: Callable[[list[Frame]], None], count: int) -> None:
    """Try a check with so many shots."""
    every = tuple(HealthCheck)
    settings(max_examples=count, deadline=None, derandomize=True,
             suppress_health_check=every)(given(shots())(check))()


def in_a_line(call: Callable[[], Frame | np.ndarray | None]) -> None:
    """What comes out is finite, or the error is a line."""
    try:
        found = call()
    except PostfxError as error:
        assert str(error).strip() and "\n" not in str(error)
        return
    colour = found[Role.COLOUR] if isinstance(found, Frame) else found
    assert colour is None or np.isfinite(colour).all()
    assert not isinstance(found, Frame) or all(np.isfinite(part).all()
                                               for part in found.parts.values())


def by_pipeline(shot: list[Frame]) -> None:
    run = Pipeline([DenoiseUpscale(model="s", scale=1), ToneMap()], device=DEVICE)
    for frame in shot:
        before = {role: plane.copy() for role, plane in frame.planes.items()}
        in_a_line(partial(run, frame))
        for role, plane in before.items():
            np.testing.assert_array_equal(frame[role], plane, "the given frame stays")


def by_denoise(shot: list[Frame]) -> None:
    names = {Role.DIFFUSE_ALBEDO: "albedo", Role.NORMAL: "normal"}
    frame = shot[0]
    more = {names[role]: plane for role, plane in frame.planes.items() if role in names}
    in_a_line(lambda: postfx.denoise(frame[Role.COLOUR], model="s", device="cpu", **more))


def with_light_groups(frame: Frame) -> Frame:
    """The frame with two parts that add up to it, and one of its own."""
    colour = frame[Role.COLOUR]
    with np.errstate(all="ignore"):
        key = np.float32(0.25) * colour
        return replace(frame, parts={"key": key, "fill": colour - key, "own": colour[..., :1]})


def by_interpolator(shot: list[Frame]) -> None:
    between = Interpolator()
    for frame in shot:
        in_a_line(partial(between.push, with_light_groups(frame)))
        if between.ready and between.reason is None:  # else the nearer frame is given as it is
            in_a_line(partial(between.frame, 0.5))


def by_frame(shot: list[Frame]) -> None:
    for frame in shot:
        assert frame == frame.copy_with() and repr(frame)
        assert Role.COLOUR in frame.spec.roles
        wrong = {**frame.planes,
                 Role.DEPTH: np.zeros((frame.spec.height + 1, frame.spec.width, 1), np.float32)}
        with pytest.raises(PostfxError):
            Frame(wrong).copy_with(check=True)


DEVICE = Device("cpu", threads=1)
CHECKS = {"frame": by_frame, "pipeline": by_pipeline, "denoise": by_denoise,
          "interpolator": by_interpolator}


@pytest.mark.parametrize("name", CHECKS)
def test_any_shot_passes_each_check(name: str) -> None:
    examples(CHECKS[name], QUICK)


def test_frames_between_hold_light_near_the_end_of_floats() -> None:
    """Sums of its squares are infinite: pixels between it and black were NaN."""
    bright = np.array([[[0.1, -0.1, 0.6]], [[3e38] * 3], [[1.3, 0.9, -0.7]]], np.float32)
    first = Frame({Role.COLOUR: bright, Role.ALPHA: np.zeros((3, 1, 1), np.float32)}, number=0)
    last = Frame({Role.COLOUR: 0 * bright, Role.MOTION: np.zeros((3, 1, 2), np.float32)}, number=1)
    by_interpolator([first, last])
    wide = [Frame({role: np.tile(plane, (24, 64, 1)) for role, plane in frame.planes.items()},
                  number=frame.number)
            for frame in (first, last)]
    by_interpolator(wide)


@pytest.mark.soak
@pytest.mark.parametrize("name", CHECKS)
def test_many_shots(name: str) -> None:
    examples(CHECKS[name], MANY)
