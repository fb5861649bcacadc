"""Planes at output size: in files of their own, and among a frame's files."""

from pathlib import Path

import numpy as np
import pytest

from postfx.errors import (
    FrameError,
    GuideError,
    MissingFrameError,
    MissingPlaneError,
    SequenceError,
)
from postfx.frame import GUIDE_ROLES, GuideSpec, Role
from postfx.io.sequence import Sequence, read_sequence

ALBEDO = tuple(f"albedo.{c}" for c in "RGB")
LARGE = {"height": 12, "width": 16}


@pytest.fixture
def shot(write_exr, ramp, tmp_path: Path):
    """Writes noisy.####.exr (8x6) and guides.####.exr (16x12), which also hold a colour that nobody
    wants."""

    def write(*numbers: int, guides: tuple[int, ...] | None = None) -> tuple[str, str]:
        for number in numbers:
            write_exr(f"noisy.{number:04d}.exr", ramp("R", "G", "B", "depth.Z"),
                      postfx__jitter=(0.25, -0.5))
        for number in numbers if guides is None else guides:
            planes = ramp("R", "G", "B", *ALBEDO, "depth.Z", **LARGE)
            write_exr(f"guides.{number:04d}.exr", planes, postfx__jitter=(0.125, 0.375))
        return f"{tmp_path}/noisy.####.exr", f"{tmp_path}/guides.####.exr"

    return write


def test_guides_in_files_of_their_own(shot, ramp):
    noisy, guides = shot(1, 2)
    frames = list(read_sequence(noisy, guides=guides))
    assert [frame.number for frame in frames] == [1, 2]
    for frame in frames:
        assert set(frame.planes) == {Role.COLOUR, Role.DEPTH}
        assert set(frame.guides) == {Role.DIFFUSE_ALBEDO, Role.DEPTH}
        assert (frame.jitter, frame.guide_jitter) == ((0.25, -0.5), (0.125, 0.375))
        assert frame.guide_source.endswith(f"guides.{frame.number:04d}.exr")
    stored = ramp("R", "G", "B", *ALBEDO, "depth.Z", **LARGE)
    np.testing.assert_array_equal(frames[0].guides[Role.DIFFUSE_ALBEDO][:, :, 1],
                                  stored["albedo.G"])


def test_guides_are_found_by_folder_pattern_and_first_file(shot, tmp_path):
    noisy, guides = shot(1, 2)
    (tmp_path / "large").mkdir()
    for number in (1, 2):
        (tmp_path / f"guides.{number:04d}.exr").rename(tmp_path / f"large/guides.{number:04d}.exr")
    for source in (tmp_path / "large", tmp_path / "large/guides.0001.exr",
                   f"{tmp_path}/large/guides.%04d.exr"):
        assert [frame.guide_size for frame in read_sequence(noisy, guides=source)] == [(16, 12),
                                                                                       (16, 12)]


def test_spec_tells_of_guides_without_reading_them(shot):
    noisy, guides = shot(1)
    with read_sequence(noisy, guides=guides).open(1) as files:
        assert files.spec().guides == GuideSpec(16, 12, (Role.DIFFUSE_ALBEDO, Role.DEPTH))
        unread = files.read(1, (Role.COLOUR,), ())
    assert unread.guides == {} and unread.spec.guides == GuideSpec(16, 12, ())


@pytest.mark.parametrize(("planes", "guides"), [
    ((Role.COLOUR,), set()), ((Role.COLOUR, Role.DEPTH), {Role.DEPTH}),
    ((Role.COLOUR, Role.DIFFUSE_ALBEDO), {Role.DIFFUSE_ALBEDO}),
])
def test_wanted_planes_are_read_at_whatever_size_they_are_there(shot, planes, guides):
    noisy, pattern = shot(1)
    (frame,) = read_sequence(noisy, planes=planes, guides=pattern)
    assert set(frame.guides) == guides
    assert set(frame.planes) == set(planes) & {Role.COLOUR, Role.DEPTH}


def test_a_missing_frame_of_guides_is_one_clear_line(shot):
    noisy, guides = shot(1, 2, 3, guides=(1, 3))
    frames = iter(read_sequence(noisy, guides=guides))
    assert next(frames).number == 1
    with pytest.raises(MissingFrameError,
                       match=r"guides\.0002\.exr: guides of frame 2 are missing: render them or"):
        next(frames)


def test_frames_that_fill_the_history_have_guides(shot):
    noisy, guides = shot(1, 2, 3, 4, 5, guides=(1, 3, 4, 5))
    assert read_sequence(noisy, guides=guides).before(5, 8) == [3, 4]
    assert Sequence(noisy).before(5, 8) == [1, 2, 3, 4]


def test_no_guides_there(shot, tmp_path):
    noisy, _ = shot(1)
    with pytest.raises(SequenceError, match="nothing.####.exr: no such file"):
        read_sequence(noisy, guides=f"{tmp_path}/nothing.####.exr")


def test_a_file_without_a_plane_that_guides(shot, write_exr, ramp):
    noisy, _ = shot(1)
    with pytest.raises(MissingPlaneError,
                       match="beauty.0001.exr: holds none of the AOVs that guide .*depth"):
        list(read_sequence(noisy,
                           guides=write_exr("beauty.0001.exr", ramp("R", "G", "B", **LARGE))))


def test_one_unnumbered_file_serves_one_frame(shot, write_exr, ramp):
    noisy, _ = shot(7, 8)
    still = write_exr("still.exr", ramp("depth.Z", **LARGE))
    (frame,) = read_sequence(noisy, frames="8", guides=still)
    assert set(frame.guides) == {Role.DEPTH}
    with pytest.raises(SequenceError,
                       match="still.exr: one file of guides for 2 frames: name them like"):
        read_sequence(noisy, guides=still)


def test_larger_files_of_a_set_with_one_file_a_plane_are_guides(write_exr, ramp, tmp_path):
    """The guide's file comes first by name; the frame's jitter is still that of the colour's
    file."""
    for number in (1, 2):
        write_exr(f"albedo.{number:04d}.exr", ramp("R", "G", "B", **LARGE),
                  postfx__jitter=(0.5, 0.25))
        write_exr(f"beauty.{number:04d}.exr", ramp("R", "G", "B"), postfx__jitter=(-0.25, 0.125))
        write_exr(f"normal.{number:04d}.exr", ramp("X", "Y", "Z"))
    for source in (tmp_path, f"{tmp_path}/{{plane}}.####.exr"):
        frames = list(read_sequence(source))
        assert len(frames) == 2
        for frame in frames:
            assert (set(frame.planes) == {Role.COLOUR, Role.NORMAL}
                    and set(frame.guides) == {Role.DIFFUSE_ALBEDO})
            assert (frame.jitter, frame.guide_jitter) == ((-0.25, 0.125), (0.5, 0.25))
            assert frame.spec.guides == GuideSpec(16, 12, (Role.DIFFUSE_ALBEDO,))
            assert "albedo.000" in frame.guide_source


@pytest.mark.parametrize("size", [(8, 6), (16, 12)],
                         ids=["window of the colour", "window of the guides"])
def test_larger_parts_of_a_file_are_guides(write_parts, ramp, size):
    parts = {"albedo": ramp("R", "G", "B", **LARGE), "beauty": ramp("R", "G", "B"),
             "depth": ramp("Z", **LARGE)}
    sequence = read_sequence(write_parts("shot.0001.exr", parts, size))
    (frame,) = sequence
    assert sequence.warnings == []
    assert (set(frame.planes) == {Role.COLOUR}
            and set(frame.guides) == {Role.DIFFUSE_ALBEDO, Role.DEPTH})
    np.testing.assert_array_equal(frame[Role.COLOUR][:, :, 0], parts["beauty"]["R"])
    np.testing.assert_array_equal(frame.guides[Role.DEPTH][:, :, 0], parts["depth"]["Z"])


@pytest.mark.parametrize("shape", [(9, 8), (12, 24), (24, 32)],
                         ids=["one way", "stretched", "too large"])
def test_parts_that_are_no_picture_enlarged_have_overscan(write_parts, ramp, shape):
    larger = ramp("R", "G", "B", height=shape[0], width=shape[1])
    (frame,) = read_sequence(write_parts("shot.0001.exr",
                                         {"beauty": ramp("R", "G", "B"), "albedo": larger}, (8, 6)))
    assert frame.guides == {}
    np.testing.assert_array_equal(frame[Role.DIFFUSE_ALBEDO][:, :, 0], larger["R"][:6, :8])


def test_files_of_their_own_count_before_larger_planes(shot, write_parts, ramp):
    _, guides = shot(1)
    parts = {"beauty": ramp("R", "G", "B"), "normal": ramp("X", "Y", "Z", **LARGE)}
    source = write_parts("shot.0001.exr", parts, (8, 6))
    sequence = read_sequence(source, guides=guides)
    (frame,) = sequence
    assert set(frame.guides) == {Role.DIFFUSE_ALBEDO, Role.DEPTH} and Role.NORMAL not in frame
    assert sequence.warnings == ["AOVs normal are larger than the colour: not read beside the "
                                 "guides given"]


def test_guides_of_several_sizes_are_refused_by_name(write_exr, ramp, tmp_path):
    write_exr("beauty.0001.exr", ramp("R", "G", "B"))
    write_exr("albedo.0001.exr", ramp("R", "G", "B", **LARGE))
    write_exr("depth.0001.exr", ramp("Z", height=18, width=24))
    message = (r"0001\.exr: guides differ in size: diffuse_albedo 16x12, depth 24x18: render them "
               r"at one size")
    with pytest.raises(GuideError, match=message):
        list(read_sequence(tmp_path))


@pytest.mark.parametrize(("name", "size"),
                         [("motion", (12, 16)), ("albedo", (3, 4)), ("albedo", (12, 4))])
def test_other_planes_of_another_size_are_no_guides(write_exr, ramp, tmp_path, name, size):
    write_exr("beauty.0001.exr", ramp("R", "G", "B"))
    write_exr(f"{name}.0001.exr",
              ramp(*("XY" if name == "motion" else "RGB"), height=size[0], width=size[1]))
    with pytest.raises(FrameError, match=r"planes of frame 1 \(.*0001\.exr\) differ in size"):
        list(read_sequence(tmp_path))


def test_a_plane_that_is_no_longer_larger_is_named(write_parts, ramp):
    parts = {"beauty": ramp("R", "G", "B"), "albedo": ramp("R", "G", "B")}
    sequence = Sequence(write_parts("shot.0001.exr", parts))
    with pytest.raises(MissingPlaneError,
                       match=r"shot\.0001\.exr: no AOV 'diffuse_albedo' at output size"):
        sequence.read(1, (Role.COLOUR,), (Role.DIFFUSE_ALBEDO,))


def test_guides_of_renderer_profiles_follow_the_convention(shot, write_exr, ramp, tmp_path):
    """Guides are brought to the convention by their own header: here depth from distance, normals
    from the camera's."""
    (tmp_path / "own.toml").write_text(
        'extends = "generic"\n[camera]\nfov_x = 90.0\n[[plane]]\nrole = "depth"\nnames = '
        '["depth"]\nchannels = ["Z"]\nkind = "ray"\n'
    )
    noisy, _ = shot(1)
    depth = write_exr("distance.0001.exr", {"depth.Z": np.full((12, 16), 2.0)},
                      postfx__jitter=(0.0, 0.0))
    (frame,) = read_sequence(noisy, guides=depth, profile=str(tmp_path / "own.toml"))
    guide = frame.guides[Role.DEPTH][:, :, 0]
    x, y = np.meshgrid((np.arange(16) + 0.5 - 8) / 8, (np.arange(12) + 0.5 - 6) / 8)
    np.testing.assert_allclose(guide, 2 / np.sqrt(1 + x**2 + y**2), rtol=1e-5)


@pytest.mark.parametrize("name", ["living_room", "staircase"])
def test_real_guides(shared_dir, name):
    folder = shared_dir / "sequences" / name
    for frame in read_sequence(folder / "noisy.####.exr", frames="1-2",
                               guides=folder / "guides.####.exr"):
        assert set(frame.guides) == set(GUIDE_ROLES) and frame.guide_size == (640, 360)
        for role, guide in frame.guides.items():
            small = guide.reshape(180, 2, 320, 2, -1).mean((1, 3))
            alike = np.isclose(small, frame[role], atol=0.05 * max(1.0, np.median(frame[role])))
            assert alike.mean() > 0.7, role
