"""Depth as files hold it: buffers, ray distance, misses; by option, profile or header, and what is
missing for them."""

import numpy as np
import pytest

from postfx import Role, read_sequence
from postfx.errors import DepthOptionError, ProfileError
from postfx.io.convert import parse_depth

DEPTH = np.array([[0.5, 2.0, 7.0, 30.0], [1.0, 4.0, 90.0, 1e10]])
HIT = DEPTH < 1e10
NEAR, FAR, FOV = 0.25, 100.0, 70.0


def ray_lengths() -> np.ndarray:
    """Distance over depth of each pixel of a 4x2 picture."""
    focal = 2 / np.tan(np.radians(FOV) / 2)
    y, x = np.mgrid[-0.5:0.5:2j, -1.5:1.5:4j]
    return np.sqrt(1 + (x / focal) ** 2 + (y / focal) ** 2)


STORED = {
    "planar": DEPTH,
    "planar,miss=0": np.where(HIT, DEPTH, 0),
    "planar,scale=-1,miss=1": np.where(HIT, -DEPTH, 1),
    "planar,scale=0.01": np.where(HIT, DEPTH * 100, np.inf),
    f"ray,fov={FOV}": np.where(HIT, DEPTH * ray_lengths(), 1e10),
    f"ray,fov={FOV},miss=0": np.where(HIT, DEPTH * ray_lengths(), 0),
    f"reversed,near={NEAR}": np.where(HIT, NEAR / DEPTH, 0),
    f"device,near={NEAR}": np.where(HIT, 1 - NEAR / DEPTH, 1),
    f"device,near={NEAR},far={FAR}": np.where(HIT, FAR / (FAR - NEAR) * (1 - NEAR / DEPTH), 1),
    f"reversed,near={NEAR},far={FAR}": np.where(HIT, NEAR / (FAR - NEAR) * (FAR / DEPTH - 1), 0),
    f"normalised,near={NEAR},far={FAR}": np.where(HIT, (DEPTH - NEAR) / (FAR - NEAR), 1),
    f"normalised-reversed,near={NEAR},far={FAR}": np.where(HIT, (FAR - DEPTH) / (FAR - NEAR), 0),
}


@pytest.fixture
def write_depth(write_exr):
    """Writes shot.0001.exr with a stored depth; gives its path."""

    def write(stored, **header):
        grey = np.ones(DEPTH.shape)
        return write_exr("shot.0001.exr", {"R": grey, "G": grey, "B": grey, "depth.Z": stored},
                         **header)

    return write


def depth_of(sequence) -> np.ndarray:
    (frame,) = sequence
    return frame[Role.DEPTH][..., 0]


@pytest.mark.parametrize("option", STORED)
def test_every_kind_by_option(write_depth, option):
    np.testing.assert_allclose(depth_of(read_sequence(write_depth(STORED[option]), depth=option)),
                               DEPTH, rtol=1e-4)


@pytest.mark.parametrize("option", [None, "planar", f"ray,fov={FOV}"])
def test_a_depth_of_0_is_a_miss_without_being_told(write_depth, option):
    stored = np.where(HIT, DEPTH * (ray_lengths() if option and "ray" in option else 1), 0)
    np.testing.assert_allclose(depth_of(read_sequence(write_depth(stored), depth=option)), DEPTH,
                               rtol=1e-4)


def test_profile_and_header(write_depth, tmp_path):
    profile = tmp_path / "own.toml"
    text = ('extends = "generic"\n[[plane]]\nrole = "depth"\nnames = ["depth"]\nchannels = '
            '["Z"]\nkind = "device"\n')
    profile.write_text(text + f"reversed = true\n[camera]\nnear = {NEAR}\nfar = inf\n")
    stored = STORED[f"reversed,near={NEAR}"]
    np.testing.assert_allclose(depth_of(read_sequence(write_depth(stored), profile=str(profile))),
                               DEPTH, rtol=1e-5)
    headed = write_depth(STORED[f"device,near={NEAR},far={FAR}"], postfx__near=NEAR,
                         postfx__far=FAR)
    np.testing.assert_allclose(depth_of(read_sequence(headed, depth="device")), DEPTH, rtol=1e-4)


def test_outside_the_data_window_nothing_was_hit(write_exr):
    ones = np.full((2, 4), 0.5)
    channels = {"R": ones, "G": ones, "B": ones, "depth.Z": ones}
    for option in ("reversed,near=1", "device,near=1", "ray,fov=60", "planar,scale=-1"):
        path = write_exr("a.exr", channels, origin=(1, 0), display=(0, 0, 5, 2))
        assert (depth_of(read_sequence(path, depth=option))[:, 0] == 1e10).all()


@pytest.mark.parametrize(
    ("option", "message"),
    [
        ("reversed", r"AOV 'depth' \(depth\.Z\) is a depth buffer and its near plane is not known: "
         r"give near= after"),
        ("normalised,near=1", "is normalised and its far plane is not known: give far= after"),
        ("ray", "is distance from the eye and its horizontal field of view is not known: give fov= "
         ".*header .*fovX"),
    ],
)
def test_what_is_missing_is_named(write_depth, option, message):
    with pytest.raises(ProfileError, match=rf"shot\.0001\.exr: .*{message}"):
        list(read_sequence(write_depth(DEPTH), depth=option))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("inverse", "begin with planar, ray, device, reversed"),
        ("ray,fov", "'fov' is not a number after near=, far=, fov=, miss=, scale="),
        ("ray,zoom=2", "unknown 'zoom': use near, far, fov, miss, scale"),
        ("device,near=1,near=2", "near is given twice: give it once"),
        ("planar,scale=0", "scale cannot be 0"),
        ("ray,fov=0", "depth 'ray,fov=0': fov cannot be 0: give degrees between 0 and 180"),
        ("ray,fov=180", "fov cannot be 180"),
        ("planar,miss=nan", "miss cannot be nan"),
        ("device,near=inf", "near cannot be inf"),
    ],
)
def test_options_that_cannot_be_understood(text, message):
    with pytest.raises(DepthOptionError, match=message):
        parse_depth(text)
