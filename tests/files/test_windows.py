"""Data and display windows, overscan and pixel aspect: read as they lie, processed together, and
scaled on writing."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path

import numpy as np
import OpenEXR
import OpenImageIO as oiio
import pytest

from postfx.depth import depth_from_ray
from postfx.frame import Frame, Role
from postfx.io.frame_reader import FrameFiles
from postfx.io.sequence import read_sequence
from postfx.io.windows import Window, output_windows
from postfx.io.writer import is_complete, write_frame

GREY = dict.fromkeys("RGB", np.full((6, 8), 0.5, np.float32))


def enlarged(frame: Frame, scale: float) -> Frame:
    """The frame at another size, by repeating pixels."""
    spec = frame.spec
    rows = (np.arange(round(spec.height * scale)) / scale).astype(int)
    columns = (np.arange(round(spec.width * scale)) / scale).astype(int)
    return dataclasses.replace(frame, planes={role: plane[rows][:, columns]
                                              for role, plane in frame.planes.items()})


def windows_of(path: Path) -> tuple[tuple[int, ...], tuple[int, ...]]:
    """x, y, width and height of the data and of the display window."""
    spec = oiio.ImageInput.open(str(path)).spec()
    return ((spec.x, spec.y, spec.width, spec.height),
            (spec.full_x, spec.full_y, spec.full_width, spec.full_height))


CASES = {
    # name: (origin of 8x6 pixels of data, display window), scale -> (data, display)
    "the same": ((0, 0), (0, 0, 8, 6), 2, ((0, 0, 16, 12), (0, 0, 16, 12))),
    "an origin": ((10, 20), (10, 20, 8, 6), 2, ((20, 40, 16, 12), (20, 40, 16, 12))),
    "a negative origin": ((-10, -21), (-10, -21, 8, 6), 1.5,
                          ((-15, -32, 12, 9), (-15, -32, 12, 9))),
    "data within the display window": ((2, 1), (0, 0, 12, 9), 2, ((4, 2, 16, 12), (0, 0, 24, 18))),
    "the same as it was": ((2, 1), (0, 0, 12, 9), 1, ((2, 1, 8, 6), (0, 0, 12, 9))),
    "data within, rounded outwards": ((3, 3), (0, 0, 12, 10), 1.5,
                                      ((4, 4, 13, 10), (0, 0, 18, 15))),
    "overscan": ((-2, -1), (0, 0, 4, 4), 2, ((-4, -2, 16, 12), (0, 0, 8, 8))),
    "overscan as it was": ((-2, -1), (0, 0, 4, 4), 1, ((-2, -1, 8, 6), (0, 0, 4, 4))),
    "overscan on one side": ((-3, 1), (0, 0, 12, 9), 2, ((-6, 2, 16, 12), (0, 0, 24, 18))),
    "data beside the display window": ((20, 20), (0, 0, 4, 4), 2, ((40, 40, 16, 12), (0, 0, 8, 8))),
}


@pytest.mark.parametrize("keep", [True, False], ids=["keep", "alone"])
@pytest.mark.parametrize("case", CASES)
def test_windows_scale_with_the_picture(write_exr, tmp_path: Path, case: str, keep: bool) -> None:
    origin, display, scale, expected = CASES[case]
    source = write_exr("in.exr", GREY | {"id": np.ones((6, 8))}, origin=origin, display=display,
                       pixelAspectRatio=2.0)
    frame = enlarged(next(iter(read_sequence(source))), scale)
    out = write_frame(tmp_path / "out.exr", frame, keep=keep)
    assert windows_of(out) == expected
    assert oiio.ImageInput.open(str(out)).spec().get_float_attribute("PixelAspectRatio") == 2
    assert is_complete(out, *expected[1][2:]) and not is_complete(out, 1, 1)
    again = next(iter(read_sequence(out)))
    np.testing.assert_array_equal(again[Role.COLOUR], frame[Role.COLOUR])


def ramp(*names: str) -> dict[str, np.ndarray]:
    return {name: np.arange(48, dtype=np.float32).reshape(6, 8) + index
            for index, name in enumerate(names)}


def test_overscan_is_read_with_the_picture(write_exr) -> None:
    channels = ramp("R", "G", "B")
    frame = next(iter(read_sequence(write_exr("in.exr", channels, origin=(-2, -1),
                                              display=(0, 0, 4, 4)))))
    np.testing.assert_array_equal(frame[Role.COLOUR],
                                  np.stack([channels[name] for name in "RGB"], axis=-1))
    assert output_windows(frame) == ((-2, -1, 5, 4), (0, 0, 3, 3), (-2, -1, 5, 4))


@pytest.mark.parametrize("suffix", [".png", ".jpg", ".tif"])
def test_pictures_show_the_display_window_only(write_exr, tmp_path: Path, suffix: str) -> None:
    values = np.zeros((6, 8), np.float32)
    values[1:5, 2:6] = 1
    frame = next(iter(read_sequence(write_exr("in.exr", dict.fromkeys("RGB", values),
                                              origin=(-2, -1), display=(0, 0, 4, 4)))))
    out = write_frame(tmp_path / f"out{suffix}", frame)
    pixels = oiio.ImageBuf(str(out)).get_pixels(oiio.FLOAT)
    assert pixels.shape == (4, 4, 3) and pixels.min() > 0.98


def test_all_frames_have_the_area_of_the_first(write_exr) -> None:
    display = (0, 0, 10, 10)
    for number, origin in ((1, (-2, 0)), (2, (0, 0)), (3, (-3, 0)), (4, (4, 4))):
        path = write_exr(f"in/a.{number:04d}.exr", ramp("R", "G", "B"), origin=origin,
                         display=display)
    sequence = read_sequence(path.parent)
    sizes = {(frame.spec.width, frame.spec.height) for frame in sequence}
    assert sizes == {(12, 10)}
    assert sequence.warnings == ["overscan beyond that of the first frame is cut off"]


def test_planes_of_other_data_windows_lie_where_they_belong(tmp_path: Path) -> None:
    """Colour with overscan, depth within the display window: filled with misses around."""
    parts = {"rgba": (GREY, (-2, -1, 5, 4)),
             "depth": ({"Z": np.ones((2, 3), np.float32)}, (1, 1, 3, 2))}
    box = lambda bounds: (np.int32(bounds[:2]), np.int32(bounds[2:]))  # noqa: E731
    OpenEXR.File([OpenEXR.Part({"type": OpenEXR.scanlineimage, "dataWindow": box(data),
                                "displayWindow": box((0, 0, 3, 3))}, dict(channels), name)
                  for name, (channels, data) in parts.items()]).write(str(tmp_path / "a.exr"))
    frame = next(iter(read_sequence(tmp_path / "a.exr")))
    assert frame[Role.DEPTH].shape == (6, 8, 1)
    inside = np.zeros((6, 8), bool)
    inside[2:4, 3:6] = True
    np.testing.assert_array_equal(frame[Role.DEPTH][:, :, 0] == 1, inside)


@pytest.mark.parametrize("origin", [(-2, -1), (-3, 0), (0, -2)])
def test_distance_and_motion_refer_to_the_display_window(write_exr, tmp_path: Path,
                                                         origin: tuple[int, int]) -> None:
    """Overscan adds pixels around a camera whose field of view is the display window's, wherever it
    is added."""
    profile = tmp_path / "ray.toml"
    profile.write_text('extends = "generic"\n[camera]\nfov_x = 60\n[[plane]]\nrole = "depth"\n'
                       'names = ["depth"]\nchannels = ["Z"]\nkind = "ray"\n[[plane]]\nrole = '
                       '"motion"\nnames = ["motion"]\nchannels = ["XY"]\nunit = "uv"\n')
    display = (0, 0, 5, 4)
    planes = GREY | {"depth.Z": np.full((6, 8), 3.0), "motion.X": np.ones((6, 8)),
                     "motion.Y": np.ones((6, 8))}
    frame = next(iter(read_sequence(write_exr("a.exr", planes, origin=origin, display=display),
                                    profile=str(profile))))
    alone = depth_from_ray(np.full((4, 5), 3.0), 60)
    shown = frame[Role.DEPTH][-origin[1] : 4 - origin[1], -origin[0] : 5 - origin[0], 0]
    np.testing.assert_allclose(shown, alone, rtol=1e-6)
    assert frame[Role.MOTION][0, 0].tolist() == [5, 4]
    assert (math.tan(math.radians(frame.fov_x) / 2) / frame.spec.width
            == pytest.approx(math.tan(math.pi / 6) / 5))


def test_real_overscan_goes_through_and_comes_back(shared_dir: Path, tmp_path: Path) -> None:
    frame = next(iter(read_sequence(shared_dir / "exr/oiio/grid-overscan.exr")))
    assert (frame.spec.width, frame.spec.height) == (1500, 1500)
    out = write_frame(tmp_path / "out.exr", enlarged(frame, 2), keep=True)
    assert windows_of(out) == ((-500, -500, 3000, 3000), (0, 0, 2000, 2000))
    with FrameFiles({"": out}) as files:
        assert files.area == (Window(0, 0, 1999, 1999), Window(-500, -500, 2499, 2499))


def test_moving_data_windows_keep_their_place(shared_dir: Path, tmp_path: Path) -> None:
    found = [windows_of(write_frame(tmp_path / f"{frame.number}.exr", enlarged(frame, 1.5)))
             for frame in read_sequence(shared_dir / "exr/beachball/multipart.####.exr",
                                        planes=[Role.COLOUR])]
    assert found == [((981, 367, 1316, 1315), (0, 0, 3072, 2334)),
                     ((1138, 550, 1318, 1333), (0, 0, 3072, 2334))]


@pytest.mark.parametrize("suffix", [".exr", ".png"])
def test_finished_frames_with_overscan_are_skipped(postfx, write_exr, tmp_path: Path,
                                                   suffix: str) -> None:
    write_exr("in/a.0001.exr", GREY, origin=(-2, -1), display=(0, 0, 4, 4))
    arguments = ("in/", "-o", f"out/a.####{suffix}", "--no-tonemap", "--skip-existing")
    assert postfx(*arguments).code == 0
    before = (tmp_path / f"out/a.0001{suffix}").stat().st_mtime_ns
    done = postfx(*arguments)
    assert (done.code == 0
            and (tmp_path / f"out/a.0001{suffix}").stat().st_mtime_ns == before), done.err


def test_windows_side_by_side_have_nothing_in_common() -> None:
    left = Window(0, 0, 3, 3)
    assert left.common(Window(3, 2, 7, 7)) == Window(3, 2, 3, 3)
    assert left.common(Window(4, 0, 7, 3)) is None
    assert left.common(Window(0, 4, 3, 7)) is None
