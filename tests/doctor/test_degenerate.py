"""Inputs that say nothing: no crash, and nothing is claimed that cannot be known."""

from dataclasses import replace

import numpy as np
import pytest

from postfx.doctor import material as material_module
from postfx.doctor import plane_checks as planes
from postfx.doctor.alignment import compare_edges
from postfx.doctor.geometry import are_scaled, are_unit, motion_of_camera, smooth_points
from postfx.doctor.inspection import picture
from postfx.doctor.material import Material, read_material
from postfx.frame import DEPTH_MISS, ROLES, Frame, Role
from postfx.io.sequence import read_sequence
from tests.doctor.conftest import ROOM

SIZES = [(1, 1), (2, 3), (5, 400), (40, 48)]


def filled(value: float, size: tuple[int, int], number: int = 1, **facts) -> Frame:
    """A frame with all planes of one value."""
    planes = {role: np.full((*size, info.channels), value, np.float32)
              for role, info in ROLES.items()}
    return Frame(planes, number=number, fov_x=60.0, world_to_camera=np.eye(4), **facts)


def random(size: tuple[int, int], number: int) -> Frame:
    """A frame whose planes hold independent noise of plausible range."""
    rng = np.random.default_rng(number)
    planes = {role: rng.random((*size, info.channels), np.float32) for role, info in ROLES.items()}
    planes[Role.NORMAL] = 2 * planes[Role.NORMAL] - 1
    planes[Role.NORMAL] /= np.linalg.norm(planes[Role.NORMAL], axis=2, keepdims=True)
    planes[Role.DEPTH] += 1
    return Frame(planes, number=number, fov_x=60.0, world_to_camera=np.eye(4))


def codes(findings, level="error"):
    for finding in findings:
        assert "nan" not in finding.evidence.lower().replace(" nan,", ""), finding
    return {finding.code for finding in findings if finding.level == level}


def test_one_frame_says_so_and_nothing_of_what_shows_over_frames(room, diagnose):
    findings = diagnose(room[:1])
    assert codes(findings) == codes(findings, "warning") == set()
    assert "one-frame" in codes(findings, "info")


def test_frames_of_several_sizes_are_no_single_frame(diagnose):
    frames = [random(size, number) for number, size in enumerate([(40, 48), (20, 24)])]
    (found,) = [one for one in diagnose(frames) if one.code == "one-frame"]
    assert "2 frames" in found.evidence and "of one size" in found.fix


def test_a_hit_distance_that_cannot_be_used_is_named(diagnose):
    frames = [random((40, 48), number) for number in (1, 2)]
    assert "hit-distance-unused" not in codes(diagnose(frames), "info")
    for frame in frames:
        del frame.planes[Role.NORMAL]
        frame.fov_x = None
    (found,) = [finding for finding in diagnose(frames) if finding.code == "hit-distance-unused"]
    assert found.level == "info" and found.evidence == "no normal, postfx:fovX"


def test_what_lossy_compression_leaves_below_0_is_no_fault(room, diagnose):
    for level, below in (("info", 1e-5), ("error", 0.2)):
        frames = []
        for frame in room[:2]:
            albedo = frame[Role.DIFFUSE_ALBEDO].copy()
            albedo[::2] = -below
            albedo[1::8] = -below
            frames.append(replace(frame, planes=frame.planes | {Role.DIFFUSE_ALBEDO: albedo}))
        (found,) = [finding for finding in diagnose(frames) if finding.code == "negative"]
        assert found.level == level and found.role == Role.DIFFUSE_ALBEDO
        assert ("too little to be seen" in found.evidence) == (level == "info")


def test_frames_of_several_sizes_are_named(diagnose):
    findings = diagnose([random((40, 48), 1), random((30, 36), 2), random((40, 48), 3)])
    (found,) = [finding for finding in findings if finding.code == "sizes-change"]
    assert (found.level == "info" and found.evidence == "frames are 48x40, "
            "36x30" and "--size" in found.fix)


@pytest.mark.parametrize("size", SIZES)
def test_constant_planes(size, diagnose):
    for value in (0.0, 0.5, 1.0):
        found = codes(diagnose([filled(value, size, number) for number in (1, 2, 3)]))
        # all that constants allow: (v, v, v) is not of unit length
        assert found <= {"normal-length"}, value


@pytest.mark.parametrize("size", SIZES)
def test_nothing_but_misses(size, diagnose):
    frames = [filled(0.0, size, number) for number in (1, 2, 3)]
    for frame in frames:
        frame.planes[Role.DEPTH][:] = DEPTH_MISS
    assert codes(diagnose(frames)) == set()


@pytest.mark.parametrize("size", SIZES)
def test_nothing_finite(size, diagnose):
    for value in (np.nan, np.inf, -np.inf):
        found = codes(diagnose([filled(value, size, number) for number in (1, 2, 3)]))
        assert "not-finite" in found and found <= {"not-finite", "negative",
                                                   "depth-negative"}, value


@pytest.mark.parametrize("size", SIZES)
def test_pure_noise(size, diagnose):
    """Pictures of consecutive frames that have nothing in common: that may be said, and no variant
    be named."""
    assert codes(diagnose([random(size, number) for number in range(1, 5)])) <= {"motion-no-fit"}


def test_repeated_frame_without_motion(room, diagnose):
    still = [replace(room[1], planes={**room[1].planes,
                                      Role.MOTION: np.zeros_like(room[1][Role.MOTION])}, number=n)
             for n in (1, 2, 3)]
    assert codes(diagnose(still)) == {"samples-correlated"}


def test_a_clean_still_is_not_called_a_repeated_seed(room, diagnose):
    """Flat colour that does not change has no noise to repeat."""
    colour = np.full_like(room[1][Role.COLOUR], 0.3)
    still = [replace(room[1], planes={Role.COLOUR: colour}, number=n) for n in (1, 2, 3)]
    assert codes(diagnose(still)) == set()


@pytest.mark.parametrize("value", [-0.01, 1.01])
def test_a_single_coverage_that_cannot_be_is_seen(value):
    overlay = np.zeros((40, 48, 4), np.float32)
    overlay[7, 9, 3] = value
    material = Material([Frame({Role.COLOUR: np.ones((40, 48, 3), np.float32),
                                Role.OVERLAY: overlay}, 1)])
    (found,) = planes.check_overlay_alpha(material)
    # 1 of 1920
    assert (found.code == "overlay-alpha" and found.evidence.startswith("0.0521 % of the pixels"))


def test_of_the_largest_pictures_two_are_compared(monkeypatch):
    sequence = read_sequence(ROOM / "noisy.####.exr")
    for pixels, numbers in ((1, [1, 2]), (3 * 320 * 180, [1, 2, 3])):
        monkeypatch.setattr(material_module, "MOST_HELD_PIXELS", pixels)
        assert [frame.number for frame in read_material(sequence).material.frames] == numbers


def test_a_far_plane_is_named_among_a_hundred_hits(diagnose):
    depth = np.ones((10, 10, 1), np.float32)
    depth[3, 4] = 1000
    frame = Frame({Role.COLOUR: np.full((10, 10, 3), 0.3, np.float32), Role.DEPTH: depth}, 1)
    assert "depth-miss-far" in codes(diagnose([frame]), "warning")
    depth[0, 0] = DEPTH_MISS
    assert "depth-miss-far" not in codes(diagnose([frame]), "warning")


def test_edges_are_compared_from_eight_rows_on():
    step = np.tile(np.float32([0, 0, 0, 1, 1, 1, 1, 1])[None, :, None], (8, 1, 3))
    planes = {Role.DIFFUSE_ALBEDO: step, Role.DEPTH: 1 + step[..., :1]}
    found = compare_edges([Frame(planes, 1)])
    assert found.keys() == planes.keys() and all(abs(one.own - 1) < 1e-3 for one in found.values())
    assert compare_edges([Frame({role: plane[:7] for role, plane in planes.items()}, 1)]) == {}


def test_no_normals_are_of_no_length(recwarn):
    nothing = np.zeros((0, 3), np.float32)
    assert not are_scaled(nothing) and not are_unit(nothing) and not recwarn.list


def test_frames_of_different_sizes(room, diagnose):
    small = [replace(frame, planes={r: p[:90, :160] for r, p in frame.planes.items()})
             for frame in room[2:4]]
    assert codes(diagnose(room[:2] + small)) == set()


def test_without_colour(diagnose):
    assert ("missing-colour"
            in codes(diagnose([Frame({Role.DEPTH: np.ones((20, 20, 1), np.float32)})])))


def test_motion_that_is_missing_is_estimated_meanwhile_where_it_can_be(diagnose):
    for kept, is_estimated in ((Role.NORMAL, True), (Role.DEPTH, False)):
        frames = [random((40, 48), number) for number in (1, 2)]
        for frame in frames:
            frame.planes = {role: frame.planes[role] for role in (Role.COLOUR, kept)}
        (found,) = [finding for finding in diagnose(frames) if finding.code == "missing-motion"]
        assert ("until then it is estimated" in found.fix) == is_estimated


@pytest.mark.parametrize("value", [0.0, 2.0, np.nan, np.inf, -1.0, DEPTH_MISS])
def test_pictures_of_anything(value):
    for role in Role:
        shown = picture(np.full((3, 4, ROLES[role].channels), value, np.float32), role)
        assert shown.shape == (3, 4, 3) and shown.dtype == np.uint8, role


def test_motion_of_the_camera_is_the_stored_motion_and_none_without_a_camera(room):
    before, now = room[1:3]
    points = smooth_points(now[Role.DEPTH])
    stored = now[Role.MOTION][points.rows, points.columns]
    assert np.quantile(np.abs(motion_of_camera(before, now) - stored).max(1), 0.75) < 0.02
    for no_camera in ({"world_to_camera": np.zeros((4, 4))}, {"fov_x": 200.0}, {"fov_x": None}):
        assert motion_of_camera(before, replace(now, **no_camera)) is None


@pytest.mark.parametrize("size", [(1, 1), (1, 40), (40, 1)])
def test_pictures_of_one_row_or_column_are_metered(diagnose, size):
    frames = [Frame({Role.COLOUR: np.full((*size, 3), 0.3, np.float32)}, number)
              for number in (1, 2)]
    assert "colour-black" not in codes(diagnose(frames), "warning")


def test_material_without_a_plane_keeps_all_else_that_is_known_of_it() -> None:
    known = Material([filled(0.5, (4, 6))], enable={Role.DEPTH: "Z"}, measured=[1, 7],
                     other_layers=["AO.R"], whole=(60, 40))
    left = known.without({Role.NORMAL})
    assert Role.NORMAL not in left.first and Role.DEPTH in left.first
    assert (left.enable, left.measured, left.other_layers, left.whole) == (
        known.enable, known.measured, known.other_layers, known.whole)
