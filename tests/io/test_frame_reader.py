"""Planes by profile: names, detection, conversions and the errors for what is not there."""

from pathlib import Path

import numpy as np
import pytest

from postfx.errors import MissingPlaneError, ProfileError, ReadError
from postfx.frame import DEPTH_MISS, Role
from postfx.io.frame_reader import FrameFiles
from postfx.io.profile import load_profile, profile_names
from postfx.io.read_options import ReadOptions
from postfx.io.read_plan import Settled
from postfx.io.sequence import read_sequence
from postfx.system import Scratch

TURN = np.array([[0, 0, 1, 0], [0, 1, 0, 0], [-1, 0, 0, 0], [1, 2, 3, 1]], np.float32)
"""A world-to-camera matrix for row vectors: a quarter turn about y and a shift."""


def open_files(path: Path, profile: str | None = None) -> FrameFiles:
    return FrameFiles({"": path}, ReadOptions(profile=profile))


def blender_channels(ramp, layer: str = "ViewLayer") -> dict[str, np.ndarray]:
    names = ["Combined.R", "Combined.G", "Combined.B", "Combined.A", "Depth.Z", "Vector.X",
             "Vector.Y"]
    return ramp(*[f"{layer}.{name}" for name in names])


@pytest.mark.parametrize("name", profile_names())
def test_built_in_profiles_load(name):
    profile = load_profile(name)
    assert profile.name == name
    assert profile.rules(Role.COLOUR)


def test_generic_planes_and_headers(write_exr, ramp):
    channels = ramp("R", "G", "B", "albedo.R", "albedo.G", "albedo.B", "motion.X", "motion.Y",
                    "depth.Z")
    header = {"postfx__exposure": 2.5, "postfx__spp": 4, "postfx__reset": 1,
              "worldToCamera": TURN.ravel()}
    with open_files(write_exr("a.exr", channels, **header)) as files:
        frame = files.read(7)
    assert files.layout.profile.name == "generic"
    np.testing.assert_array_equal(frame[Role.MOTION][:, :, 1], channels["motion.Y"])
    np.testing.assert_array_equal(frame[Role.DIFFUSE_ALBEDO][:, :, 2], channels["albedo.B"])
    assert (frame.number, frame.samples, frame.reset) == (7, 4, True)
    assert frame.exposure == pytest.approx(np.log2(2.5))  # versions before wrote a factor
    np.testing.assert_array_equal(frame.world_to_camera, TURN)


def test_parts_named_after_planes_are_found(write_parts, ramp):
    parts = {"rgba": ramp("R", "G", "B", "A"), "depth": ramp("Z"), "albedo": ramp("R", "G", "B")}
    with open_files(write_parts("a.exr", parts)) as files:
        frame = files.read(1)
    np.testing.assert_array_equal(frame[Role.COLOUR][:, :, 1], parts["rgba"]["G"])
    np.testing.assert_array_equal(frame[Role.DIFFUSE_ALBEDO][:, :, 1], parts["albedo"]["G"])


def test_only_the_wanted_planes_are_read(write_exr, ramp):
    path = write_exr("a.exr", ramp("R", "G", "B", "depth.Z"))
    with open_files(path) as files:
        assert set(files.read(1, [Role.DEPTH]).planes) == {Role.DEPTH}


def test_blender_multi_part(write_parts, ramp):
    channels = blender_channels(ramp)
    parts: dict[str, dict[str, np.ndarray]] = {}
    for name, pixels in channels.items():
        parts.setdefault(name.rpartition(".")[0], {})[name] = pixels
    path = write_parts("a.exr", parts,
                       **{"Software": "Blender 5.0.1", "cycles.ViewLayer.samples": "16"})
    with open_files(path) as files:
        frame = files.read(1)
    assert files.layout.profile.name == "cycles-5"
    assert frame.samples == 16
    np.testing.assert_array_equal(frame[Role.MOTION][:, :, 0], channels["ViewLayer.Vector.X"])
    np.testing.assert_array_equal(frame[Role.MOTION][:, :, 1], -channels["ViewLayer.Vector.Y"])


def test_a_layer_combined_is_not_blenders_by_itself(write_exr, ramp):
    layers = {"combined": "RGB", "albedo": "RGB", "motion": "XY", "normal": "XYZ"}
    channels = {f"{layer}.{key}": pixels for layer, keys in layers.items()
                for key, pixels in ramp(*keys).items()}
    with open_files(write_exr("a.exr", channels)) as files:
        frame = files.read(1)
    assert files.layout.profile.name == "generic"
    assert set(frame.planes) == {Role.COLOUR, Role.DIFFUSE_ALBEDO, Role.MOTION, Role.NORMAL}
    colour = ramp("Combined.R", "Combined.G", "Combined.B")
    with open_files(write_exr("b.exr", colour, Software="Blender 5.0.1")) as files:
        assert files.layout.profile.name == "cycles-5"


def test_blender_4_by_its_header_or_its_names(write_exr, ramp):
    with open_files(write_exr("a.exr", blender_channels(ramp, "View Layer"),
                              Software="Blender 4.5.3")) as files:
        assert files.layout.profile.name == "cycles-4"
    albedo = ramp("View Layer.DiffCol.R", "View Layer.DiffCol.G", "View Layer.DiffCol.B")
    with open_files(write_exr("b.exr", blender_channels(ramp, "View Layer") | albedo)) as files:
        assert files.layout.profile.name == "cycles-4"
        assert Role.DIFFUSE_ALBEDO in files.layout.planes
    # What was found for these names does not hold where the header says something else.
    with open_files(write_exr("c.exr", blender_channels(ramp, "View Layer"),
                              Software="Blender 5.0.1")) as files:
        assert files.layout.profile.name == "cycles-5"


def test_headers_of_many_blocks_are_read_whole(write_exr, ramp):
    facts = {f"note{number}": chr(65 + number % 26) * 997 for number in range(60)}
    with open_files(write_exr("a.exr", ramp("R", "G", "B"), **facts)) as files:
        assert {name: files.layout.attributes[name] for name in facts} == facts
        assert files.read(1)[Role.COLOUR].shape[2] == 3


def test_the_colour_before_blenders_denoiser_is_preferred(write_exr, ramp):
    noisy = ramp("ViewLayer.Noisy Image.R", "ViewLayer.Noisy Image.G", "ViewLayer.Noisy Image.B")
    with open_files(write_exr("a.exr", blender_channels(ramp) | noisy)) as files:
        frame = files.read(1)
    np.testing.assert_array_equal(frame[Role.COLOUR][:, :, 0], noisy["ViewLayer.Noisy Image.R"])
    assert Role.ALPHA in frame


def test_mitsuba_ray_distance_becomes_planar_depth(write_exr, tmp_path, ramp):
    channels = ramp("R", "G", "B") | {"dd.T": np.full((6, 8), 10, np.float32)}
    channels["dd.T"][0, 0] = 0
    path = write_exr("a.exr", channels, generatedBy="Mitsuba version 3.9.1")
    profile = tmp_path / "lens.toml"
    profile.write_text('extends = "mitsuba-3"\n[camera]\nfov_x = 90\n')
    with open_files(path, str(profile)) as files:
        depth = files.read(1)[Role.DEPTH][:, :, 0]
    assert files.layout.warnings == []
    assert depth[0, 0] == DEPTH_MISS
    x, y = (3.5 + 4 - 4) / 4, (0.5 - 3) / 4
    assert depth[0, 7] == pytest.approx(10 / np.sqrt(1 + x * x + y * y), rel=1e-6)


def test_mitsuba_without_field_of_view_warns(write_exr, ramp):
    path = write_exr("a.exr", ramp("R", "G", "B", "dd.T"), generatedBy="Mitsuba version 3.9.1")
    with open_files(path) as files:
        assert files.layout.profile.name == "mitsuba-3"
        assert "distance from the eye" in files.layout.warnings[0]


def test_pbrt_camera_normals_become_world_normals(write_exr, ramp):
    channels = ramp("R", "G", "B", "Albedo.R", "Albedo.G", "Albedo.B", "Ns.X", "Ns.Y", "Ns.Z",
                    "P.Z", "dzdx")
    world = np.stack([channels[f"Ns.{axis}"] for axis in "XYZ"], axis=-1)
    camera = world @ TURN[:3, :3]
    channels |= {f"Ns.{axis}": camera[:, :, index] for index, axis in enumerate("XYZ")}
    with open_files(write_exr("a.exr", channels, worldToCamera=TURN.T.ravel())) as files:
        frame = files.read(1)
    assert files.layout.profile.name == "pbrt-4"
    np.testing.assert_allclose(frame[Role.NORMAL], world, atol=1e-6)


def test_camera_normals_without_a_matrix_are_left_out_with_a_warning(write_exr, ramp):
    names = ["R", "G", "B", "Albedo.R", "Ns.X", "Ns.Y", "Ns.Z", "P.Z", "dzdx"]
    with open_files(write_exr("a.exr", ramp(*names))) as files:
        assert Role.NORMAL not in files.layout.planes
        assert "no worldToCamera" in files.layout.warnings[0]


def test_user_profile_declares_units_offset_and_names(write_exr, tmp_path, ramp):
    profile = tmp_path / "studio.toml"
    profile.write_text(
        'extends = "generic"\n[[plane]]\nrole = "motion"\nnames = ["mv"]\nchannels = ["UV"]\n'
        'offset = [-0.5, -0.5]\nscale = [1, -1]\nunit = "uv"\n'
    )
    channels = ramp("R", "G", "B") | {"mv.U": np.full((6, 8), 0.75), "mv.V": np.full((6, 8), 0.25)}
    with open_files(write_exr("a.exr", channels), str(profile)) as files:
        motion = files.read(1)[Role.MOTION]
    np.testing.assert_allclose(motion[2, 3], [0.25 * 8, 0.25 * 6])


def test_albedo_above_one_is_cut_and_broken_motion_is_unknown(write_exr, ramp):
    channels = ramp("albedo.R", "albedo.G", "albedo.B", "motion.X", "motion.Y")
    channels["albedo.R"][0, 0], channels["motion.X"][0, 0] = 3.0, np.nan
    with open_files(write_exr("a.exr", channels)) as files:
        frame = files.read(1)
    assert frame[Role.DIFFUSE_ALBEDO].max() == 1
    assert np.isnan(frame[Role.MOTION][0, 0]).all()


@pytest.mark.parametrize("size", [{"height": 12}, {"height": 3}, {"width": 16}], ids=str)
@pytest.mark.parametrize("memory", [None, "1M"])
def test_a_plane_of_channels_of_two_sizes_is_refused(write_exr, ramp, tmp_path, size, memory):
    write_exr("beauty.0001.exr", ramp("R", "G", "B", "motion.X"))
    write_exr("motion.0001.exr", ramp("Y", **size))
    with pytest.raises(ReadError,
                       match=r"0001\.exr: channels motion\.X, Y differ in size; write them as one"):
        read_sequence(tmp_path, scratch=memory and Scratch(memory)).read(1)


def test_missing_plane_names_file_plane_and_mend(write_exr, ramp):
    with (
        open_files(write_exr("a.exr", blender_channels(ramp))) as files,
        pytest.raises(MissingPlaneError,
                      match=r"a\.exr: no AOV 'normal': .*Normal\.X.*Passes > Data > Normal"),
    ):
        files.read(1, [Role.NORMAL])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[[plane]]\nrole = 'velocity'\nchannels = ['XY']", "unknown role"),
        ("[[plane]]\nrole = 'motion'\nchannels = ['X']", "needs 2 channels"),
        ("[[plane]]\nrole = 'motion'\nchannels = ['XY']\nunits = 'uv'", "unknown key 'units'"),
        ("[[plane]]\nrole = 'motion'\nchannels = ['XY']\nunit = 'metres'",
         "use one of pixels, uv, ndc"),
        ("name = ", "not valid TOML"),
    ],
)
def test_malformed_profiles_are_explained(tmp_path, text, message):
    path = tmp_path / "bad.toml"
    path.write_text(text)
    with pytest.raises(ProfileError, match=rf"bad\.toml: .*{message}"):
        load_profile(str(path))


def test_the_documented_profiles_are_valid(tmp_path):
    page = Path(__file__).resolve().parents[2] / "docs" / "reference" / "renderers.md"
    profiles = []
    for block in page.read_text("utf-8").split("```toml")[1:]:
        (tmp_path / f"{len(profiles)}.toml").write_text(block.split("```")[0])
        profiles.append(load_profile(str(tmp_path / f"{len(profiles)}.toml")))
    (motion, *_) = profiles[-1].rules(Role.MOTION)
    assert (motion.unit, motion.candidates("")[0]) == ("uv", ("velocity.X", "velocity.Y"))


def test_unknown_profile_lists_the_known():
    with pytest.raises(ProfileError,
                       match="unknown profile 'maya': use one of .*cycles-5.*generic"):
        load_profile("maya")


def test_overscan_beyond_that_of_frames_before_warns(write_exr, ramp):
    first = write_exr("a.exr", ramp("R", "G", "B", height=5, width=5), origin=(-1, 0),
                      display=(0, 0, 4, 4))
    path = write_exr("b.exr", ramp("R", "G", "B"), origin=(-1, -1), display=(0, 0, 4, 4))
    with open_files(first) as files, FrameFiles({"": path},
                                                settled=Settled(area=files.area)) as later:
        assert files.layout.warnings == []
        assert later.layout.warnings == ["overscan beyond that of the first frame is cut off"]
        assert (later.spec().width,
                later.spec().height) == (files.spec().width, files.spec().height) == (5, 5)


def test_channel_names_are_shown_short(write_exr, ramp):
    with open_files(write_exr("a.exr",
                              ramp("R", "G", "B", "albedo.R", "albedo.G", "albedo.B"))) as files:
        shown = {role: match.names for role, match in files.layout.planes.items()}
    assert shown == {Role.COLOUR: "R,G,B", Role.DIFFUSE_ALBEDO: "albedo.R,G,B"}


@pytest.mark.parametrize("none", [np.nan, np.inf, 1e10, -65504.0, (np.nan, 3.0), 9999.0, -999.0])
def test_vectors_that_stand_for_none_are_unknown(write_exr, ramp, none):
    channels = ramp("R", "G", "B", "motion.X", "motion.Y")
    channels["motion.X"][1, 2], channels["motion.Y"][1, 2] = (none if isinstance(none, tuple)
                                                              else (none, none))
    (frame,) = read_sequence(write_exr("a.exr", channels))
    motion = frame[Role.MOTION]
    assert (np.isnan(motion[1, 2]).all()
            and np.isfinite(motion).all(axis=2).sum() == motion[..., 0].size - 1)
