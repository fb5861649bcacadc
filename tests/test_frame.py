"""Frames and specs: what they hold and what they refuse."""

import numpy as np
import pytest

from postfx import Frame, FrameSpec, Role
from postfx.errors import FrameError
from postfx.frame import ROLES


def plane(role: Role, height: int = 4, width: int = 5) -> np.ndarray:
    return np.zeros((height, width, ROLES[role].channels), np.float32)


def test_every_role_has_a_convention():
    assert set(ROLES) == set(Role)
    assert all(all(map(str, info)) and 1 <= info.channels <= 4 for info in ROLES.values())


def test_spec_of_a_frame():
    frame = Frame({Role.DEPTH: plane(Role.DEPTH), Role.COLOUR: plane(Role.COLOUR)})
    assert frame.spec == FrameSpec(5, 4, {Role.COLOUR: 3, Role.DEPTH: 1})
    assert frame.spec.roles == (Role.COLOUR, Role.DEPTH)
    assert frame.spec.channels(Role.DEPTH) == 1


def test_specs_compare_and_hash_by_meaning():
    by_name, by_pairs = FrameSpec(2, 1, ["depth", "colour"]), FrameSpec(2, 1, ((Role.COLOUR, 3), (Role.DEPTH, 1)))
    assert {by_name: "same"}[by_pairs] == "same"
    assert by_name != FrameSpec(2, 1, ["colour"])


def test_scalar_planes_may_come_without_channel_axis_and_in_other_floats():
    frame = Frame({"depth": np.ones((4, 5), np.float64)})
    assert frame[Role.DEPTH].shape == (4, 5, 1)
    assert frame[Role.DEPTH].dtype == np.float32
    assert frame[Role.DEPTH].flags.c_contiguous


@pytest.mark.parametrize(
    ("planes", "message"),
    [
        ({}, "no planes"),
        ({"colour": np.zeros((4, 5, 4), np.float32)}, r"shape \(4, 5, 4\): it needs \(height, width, 3\)"),
        ({"colour": np.zeros((0, 5, 3), np.float32)}, "shape"),
        ({"colour": np.zeros((4, 5, 3), np.uint8)}, "uint8: give a NumPy array of floats"),
        ({"colour": [[[0.0, 0.0, 0.0]]]}, "list"),
        ({"colour": plane(Role.COLOUR), "depth": plane(Role.DEPTH, 8, 10)}, "colour 5x4, depth 10x8"),
    ],
)
def test_refused_planes(planes, message):
    with pytest.raises(FrameError, match=message):
        Frame(planes)


def test_unknown_encoding():
    with pytest.raises(FrameError, match="unknown colour encoding 'rec2020': use one of scene-linear"):
        FrameSpec(1, 1, ["colour"], "rec2020")


def test_asking_for_what_is_not_there():
    frame = Frame({Role.COLOUR: plane(Role.COLOUR)}, number=12)
    with pytest.raises(FrameError, match="frame 12 has no plane 'depth': it has colour"):
        frame[Role.DEPTH]
    with pytest.raises(FrameError, match="no plane 'depth'"):
        frame.spec.channels(Role.DEPTH)
