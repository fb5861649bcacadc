"""Frames and specs: what they hold and what they refuse."""

import numpy as np
import pytest

from postfx import Frame, FrameSpec, Role
from postfx.errors import FrameError, GuideError
from postfx.frame import OUTPUT_SIZE_ROLES, ROLES, GuideSpec


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
    with pytest.raises(FrameError, match="unknown colour encoding 'crt': use scene-linear, display-linear;"):
        FrameSpec(1, 1, ["colour"], "crt")


def test_encodings_compare_by_meaning():
    assert FrameSpec(1, 1, ["colour"], "pq").encoding == "pq,peak=1000,white=203"
    assert FrameSpec(1, 1, ["colour"], "pq") == FrameSpec(1, 1, ["colour"], "pq,white=203,peak=1e3")


def test_asking_for_what_is_not_there():
    frame = Frame({Role.COLOUR: plane(Role.COLOUR)}, number=12)
    with pytest.raises(FrameError, match="frame 12 has no plane 'depth': it has colour"):
        frame[Role.DEPTH]
    with pytest.raises(FrameError, match="no plane 'depth'"):
        frame.spec.channels(Role.DEPTH)


def guided(*roles: Role, **kept) -> Frame:
    return Frame({"colour": plane(Role.COLOUR)}, guides={role: plane(role, 8, 10) for role in roles}, **kept)


def test_guides_are_planes_of_another_size():
    frame = guided(Role.DEPTH, Role.DIFFUSE_ALBEDO, guide_source="guides.0001.exr")
    guides = GuideSpec(10, 8, (Role.DEPTH, Role.DIFFUSE_ALBEDO))
    assert frame.spec == FrameSpec(5, 4, ["colour"], guides=guides)
    assert frame.spec.guide_roles == (Role.DEPTH, Role.DIFFUSE_ALBEDO)
    assert frame.spec.guides.source == "guides.0001.exr"
    assert guided().spec.guides is None and guided().spec.guide_roles == ()


def test_specs_with_guides_compare_and_hash_by_meaning():
    one, other = GuideSpec(4, 2, ["normal", "depth"], "a.exr"), GuideSpec(4, 2, (Role.DEPTH, Role.NORMAL), "b.exr")
    specs = {FrameSpec(2, 1, ["colour"], guides=guides) for guides in (one, other, GuideSpec(4, 2, ["depth"]), None)}
    assert len(specs) == 3


def test_scalar_guides_may_come_without_channel_axis():
    frame = Frame({"colour": plane(Role.COLOUR)}, guides={"depth": np.ones((8, 10), np.float64)})
    assert frame.guides[Role.DEPTH].shape == (8, 10, 1) and frame.guides[Role.DEPTH].dtype == np.float32


@pytest.mark.parametrize("role", [role for role in Role if role not in OUTPUT_SIZE_ROLES])
def test_other_planes_cannot_be_guides(role):
    with pytest.raises(GuideError, match=f"plane '{role}'.* cannot be a guide: "):
        guided(role)
    with pytest.raises(GuideError, match=f"plane '{role}' cannot be a guide: "):
        GuideSpec(10, 8, (role,))


def test_guides_of_several_sizes_are_refused():
    guides = {Role.DEPTH: plane(Role.DEPTH, 8, 10), Role.NORMAL: plane(Role.NORMAL, 9, 10)}
    message = r"guides of frame 3 \(g.exr\) differ in size: depth 10x8, normal 10x9"
    with pytest.raises(FrameError, match=message):
        Frame({"colour": plane(Role.COLOUR)}, 3, guides=guides, guide_source="g.exr")


def test_guides_of_a_wrong_shape_are_refused():
    with pytest.raises(FrameError, match="guide 'normal' of frame 1 has shape"):
        Frame({"colour": plane(Role.COLOUR)}, guides={"normal": np.zeros((8, 10, 2), np.float32)})
