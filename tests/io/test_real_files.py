"""Files that other software wrote: one convention after reading, or one clear line."""

from pathlib import Path

import numpy as np
import OpenImageIO as oiio
import pytest

from postfx.errors import PostfxError, ReadError
from postfx.frame import DEPTH_MISS, Frame, Role
from postfx.io.frame_reader import FrameFiles
from postfx.io.sequence import read_sequence

REFUSED = {"representativeDeepImage.exr": "deep data",
           "XYZ_YC.exr": r"[Ss]ubsampled[^;]*[^.;]; save it as RGB"}


def warp(plane: np.ndarray, motion: np.ndarray) -> np.ndarray:
    """Value at the nearest pixel of the previous frame."""
    height, width = plane.shape[:2]
    rows, columns = np.mgrid[0:height, 0:width]
    columns = np.rint(columns + motion[:, :, 0]).astype(int).clip(0, width - 1)
    rows = np.rint(rows + motion[:, :, 1]).astype(int).clip(0, height - 1)
    return plane[rows, columns]


def mean_error(before: Frame, now: Frame, role: Role, motion: np.ndarray) -> float:
    return float(np.abs(warp(before[role], motion) - now[role]).mean())


@pytest.mark.parametrize("name", ["garage", "living_room", "staircase"])
@pytest.mark.parametrize("role", [Role.DIFFUSE_ALBEDO, Role.NORMAL])
def test_motion_leads_to_the_previous_frame(shared_dir: Path, name: str, role: Role):
    before, now = read_sequence(shared_dir / f"sequences/{name}/noisy.####.exr", frames="3-4")
    motion = now[Role.MOTION]
    right = mean_error(before, now, role, motion)
    assert right < 0.6 * mean_error(before, now, role, np.zeros_like(motion))
    for flip in ([-1, 1], [1, -1], [-1, -1]):
        assert right < mean_error(before, now, role, motion * np.float32(flip))


@pytest.mark.parametrize("name", ["garage", "living_room", "staircase"])
def test_normals_and_depth_are_plausible(shared_dir: Path, name: str):
    (frame,) = read_sequence(shared_dir / f"sequences/{name}/noisy.####.exr", frames="2")
    length = np.linalg.norm(frame[Role.NORMAL], axis=2)
    assert np.median(length) == pytest.approx(1, abs=1e-3)
    hit = frame[Role.DEPTH] < DEPTH_MISS
    assert hit.mean() > 0.7
    assert frame[Role.DEPTH][hit].min() > 0


def test_garage_needs_no_option(shared_dir: Path):
    parts = next(iter(read_sequence(shared_dir / "sequences/garage/noisy.####.exr")))
    single = next(iter(read_sequence(shared_dir / "sequences/garage/interleaved.0001.exr")))
    expected = {Role.COLOUR, Role.ALPHA, Role.DEPTH, Role.MOTION, Role.NORMAL}
    expected |= {Role.DIFFUSE_ALBEDO, Role.SPECULAR_ALBEDO, Role.DENOISING_ALBEDO,
                 Role.DENOISING_NORMAL}
    assert set(parts.planes) == set(single.planes) == expected
    assert parts.samples == 4
    np.testing.assert_array_equal(parts[Role.DEPTH], single[Role.DEPTH])


def test_generic_headers(shared_dir: Path):
    frame = next(iter(read_sequence(shared_dir / "sequences/living_room/noisy.####.exr")))
    assert frame.jitter == pytest.approx((0, -1 / 6), abs=1e-4)
    assert (frame.samples, frame.reset, frame.fov_x) == (2, True, 90)
    assert frame.exposure_factor == pytest.approx(1.10767, abs=1e-5)


def test_stereo_planes_come_from_one_view(shared_dir: Path):
    with FrameFiles({"": shared_dir / "exr/beachball/multipart.0001.exr"}) as files:
        views = {channel.part.view for match in files.layout.planes.values()
                 for channel in match.channels}
        frame = files.read(1)
    assert views == {"right"}
    assert (frame.spec.width, frame.spec.height) == (2048, 1556)


def test_every_collected_file_is_read_or_refused_in_one_line(shared_dir: Path):
    paths = sorted(shared_dir.glob("exr/*/*.exr"))
    assert paths
    for path in paths:
        try:
            with FrameFiles({"": path}) as files:
                frame = files.read(1)
            assert frame[Role.COLOUR].shape[2] == 3
        except PostfxError as error:
            assert path.name in REFUSED, error
            assert "\n" not in str(error)


def test_v_ray_planes(shared_dir: Path):
    """Of a scene without light: what the surfaces reflect is there all the same, and no light is in
    it."""
    with FrameFiles({"": shared_dir
                         / "exr/cryptomatte/cornellBox_CryptoWildcard.0001.exr"}) as files:
        frame = files.read(1)
    assert files.layout.profile.name == "v-ray"
    assert frame.fov_x == pytest.approx(54.43222, abs=1e-4)
    assert frame[Role.COLOUR].max() == 0
    assert np.unique(frame[Role.DIFFUSE_ALBEDO].round(2)).tolist()[-1] == 0.5
    assert Role.NORMAL not in frame  # in screen space


@pytest.mark.parametrize("name", REFUSED)
def test_refusals_say_why(shared_dir: Path, name: str):
    (path,) = shared_dir.glob(f"exr/*/{name}")
    if name == "XYZ_YC.exr" and oiio.VERSION < 30200:
        pytest.skip(f"OpenImageIO {oiio.__version__} makes colours of luminance and chroma")
    with pytest.raises(ReadError, match=rf"{name}: .*{REFUSED[name]}"):
        FrameFiles({"": path})
