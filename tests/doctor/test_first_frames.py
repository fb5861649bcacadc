"""What a run says of its first frames: nothing of good ones, a line and the fix of bad ones."""

import logging
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import postfx
from postfx.doctor.first_frames import MOST_SEEN, FirstFrames
from postfx.frame import Frame, Role
from tests.doctor.breakages import filtered

ROOM = Path(__file__).parents[2] / "samples/room/noisy.####.exr"


@pytest.fixture(scope="module")
def room() -> list[Frame]:
    return list(postfx.read_sequence(ROOM, "1-4"))


def said(frames: list[Frame], **options) -> list[str]:
    looker = FirstFrames(**options)
    return [line for frame in frames for line in looker.look(frame)]


def with_motion(frames: list[Frame], change: Callable[[np.ndarray], np.ndarray]) -> list[Frame]:
    return [replace(one,
                    planes={**one.planes, Role.MOTION: change(one[Role.MOTION]).astype(np.float32)})
            for one in frames]


def test_nothing_is_said_of_good_frames(room):
    assert said(room) == []


def test_a_wrong_sign_and_a_wrong_unit_are_told_with_the_fix(room):
    (line,) = said(with_motion(room, np.negative), channels={Role.MOTION: "vector.XY"})
    assert (line.startswith("AOV motion (vector.XY), frame 3: ") and "fix: in a profile scale = "
            "[-1, -1]" in line and "misfit" not in line)  # figures are for `inspect`
    assert line.endswith("; 'postfx inspect' prints that profile") and "\n" not in line
    height, width = room[0][Role.COLOUR].shape[:2]
    (line,) = said(with_motion(room, lambda motion: motion / np.float32((width, height))))
    assert 'fix: in a profile unit = "uv"' in line and "\n" not in line


def test_the_unit_of_a_large_picture_is_that_of_all_of_it(room, monkeypatch):
    """Only a window of it is compared."""
    monkeypatch.setattr("postfx.doctor.first_frames.COMPARED_WINDOW_PX", (240, 140))
    height, width = room[0][Role.COLOUR].shape[:2]
    (line,) = said(with_motion(room, lambda motion: motion / np.float32((width, height))))
    assert 'unit = "uv"' in line
    assert said(room) == []


def test_noise_that_a_pixel_filter_spreads_is_told_where_it_stays(room):
    """Else a run undoes the filter and says so at its end."""
    spread = {Role.COLOUR: filtered(room[0][Role.COLOUR], room[0])}
    frames = [replace(room[0], planes={**room[0].planes, **spread})]
    assert said(frames) == said(room[:1], leaves_filters=True) == []
    (line,) = said(frames, leaves_filters=True)
    assert "as a gaussian pixel filter" in line and "none needed with xl, l and oidn" in line


def test_one_seed_is_told(room):
    """Where the picture moves; the denoiser tells of it where it stands still."""
    moving = {**room[1].planes, Role.MOTION: np.full_like(room[1][Role.MOTION], 3)}
    same = [replace(room[1], planes=moving, number=number) for number in (1, 2, 3)]
    assert any("the same random seed in every frame" in line for line in said(same))
    still = {**room[1].planes, Role.MOTION: np.zeros_like(room[1][Role.MOTION])}
    assert said([replace(room[1], planes=still, number=number) for number in (1, 2, 3)]) == []


def test_planes_that_the_renderer_could_write_are_told_and_cheap_ones_are_not(room):
    bare = [replace(room[0], planes={role: plane for role, plane in room[0].planes.items()
                                     if role not in (Role.NORMAL, Role.ROUGHNESS)})]
    enable = {Role.NORMAL: "Data > Normal", Role.ROUGHNESS: "Shader AOV"}
    (line,) = said(bare, enable=enable)
    assert "AOV normal: " in line and "fix: switch it on: Data > Normal" in line
    assert said(bare) == []  # as nobody knows where


def test_black_frames_are_told_but_not_those_before_a_shot_fades_in(room):
    black = [replace(one, planes={**one.planes, Role.COLOUR: 0 * one[Role.COLOUR]})
             for one in room]
    (line,) = said(black)
    assert line.startswith("AOV colour, frame 3: black in all 3 frames") and "beauty pass" in line
    assert said([*black[:2], room[2]]) == [] and said(black[:1]) == []
    (line,) = FirstFrames().look(black[0], is_alone=True)
    assert line.startswith("AOV colour, frame 1: black in the frame; ")


def test_it_ends_by_itself(room):
    looker = FirstFrames()
    for number in range(MOST_SEEN + 1):
        looker.look(replace(room[0], number=number, reset=True))
    assert looker.is_done


def test_a_pipeline_tells_the_log(room, caplog):
    passes = postfx.Pipeline([postfx.DenoiseUpscale(model="s")], postfx.Device("cpu"))
    buffers = {role: np.empty_like(plane) for role, plane in room[0].planes.items()}
    with caplog.at_level(logging.WARNING, "postfx"):
        for frame in with_motion(room, np.negative):
            for role, plane in frame.planes.items():
                buffers[role][...] = plane  # a renderer writes all frames into the same arrays
            passes(replace(frame, planes=buffers))
    (line,) = [record.message for record in caplog.records if "likely" in record.message]
    assert "scale = [-1, -1]" in line
    caplog.clear()
    passes = postfx.Pipeline([postfx.DenoiseUpscale(model="s")], postfx.Device("cpu"), checks=False)
    for frame in with_motion(room, np.negative):
        passes(frame)
    assert "likely" not in caplog.text


def test_a_pipeline_tells_once_of_planes_that_come_and_go(room, caplog):
    passes = postfx.Pipeline([postfx.DenoiseUpscale(model="s")], postfx.Device("cpu"))
    bare = [replace(one, planes={role: plane
                                 for role, plane in one.planes.items() if role != Role.NORMAL})
            for one in room]

    def told(frames: list[Frame]) -> list[str]:
        caplog.clear()
        for frame in frames:
            passes(frame)
        return [record.message for record in caplog.records if "begins anew" in record.message]

    with caplog.at_level(logging.WARNING, "postfx"):
        assert told([bare[0], room[1], bare[2], room[3]]) == [
            "frame 2 has normal, which the frame before had not: its history begins anew; "
            "give it in all frames of a shot or in none"]
        passes.reset()
        assert told(room[:2]) == []
        assert told([replace(bare[2], reset=True)]) == []  # a shot of its own
        passes = postfx.Pipeline([postfx.DenoiseUpscale(model="s")], postfx.Device("cpu"))
        (line,) = told([room[0], bare[1]])
        assert line.startswith("frame 2 lacks normal, which the frame before had: ")


def test_a_run_tells_of_planes_that_come_later(write_exr, tmp_path, capsys):
    from postfx.cli.main import main

    random = np.random.default_rng(3)
    for number in (1, 2, 3):
        planes = {name: random.random((24, 32), np.float32) for name in "RGB"}
        planes |= {f"albedo.{name}": np.full((24, 32), 0.5) for name in "RGB"} if number > 1 else {}
        write_exr(f"in/shot.{number:04d}.exr", planes)
    run = ["run", str(tmp_path / "in"), "-o", str(tmp_path / "out/"), "--model", "s", "--device",
           "cpu"]
    assert main(run) == 0
    line = "frame 1 has no diffuse_albedo, but frame 2 has: no frame uses what is not in all"
    assert line in capsys.readouterr().err
    watch = ["watch", str(tmp_path / "in/"), "-o", str(tmp_path / "preview/"), "--until", "3",
             "--settle", "0"]
    assert main([*watch, "--", "--model", "s", "--device", "cpu"]) == 0
    told = capsys.readouterr().err
    assert told.count(line) == 1 and "warning  denoise_upscale: no motion vectors" in told
    assert main([*run, "--frames", "2-3", "--preroll", "0", "--overwrite"]) == 0
    assert "no diffuse_albedo" not in capsys.readouterr().err


def test_a_run_tells_at_once_of_planes_that_later_frames_lack(write_exr, tmp_path, capsys):
    """And not after a night, when the frame's turn comes."""
    from postfx.cli.main import main

    random = np.random.default_rng(3)
    for number in range(1, 6):
        planes = {name: random.random((24, 32), np.float32) for name in "RGB"}
        planes |= {f"albedo.{name}": random.random((24, 32), np.float32)
                   for name in ("RGB" if number < 5 else "")}
        write_exr(f"in/shot.{number:04d}.exr", planes)
    run = ["run", str(tmp_path / "in"), "-o", str(tmp_path / "out/"), "--model", "s", "--device",
           "cpu"]
    assert main(run) == 2
    told = capsys.readouterr().err
    line = "frame 5 has no diffuse_albedo, but frame 1 has: frame 5 cannot be denoised"
    assert 0 < told.find(line) < told.find("1/5 ") and "shot.0005.exr: no AOV '" in told
    assert main([*run, "--frames", "1-4", "--overwrite"]) == 0
    assert "has no diffuse_albedo" not in capsys.readouterr().err


def test_a_plane_that_a_frame_lacks_matters_more_than_one_that_it_has(write_exr, tmp_path, capsys):
    from postfx.cli.main import main

    random = np.random.default_rng(3)
    for number in (1, 2, 3):
        planes = {name: random.random((24, 32), np.float32) for name in "RGB"}
        own = "depth.Z" if number == 1 else "roughness.Y"
        write_exr(f"in/shot.{number:04d}.exr", planes | {own: random.random((24, 32), np.float32)})
    assert main(["run", str(tmp_path / "in"), "-o", str(tmp_path / "out/"), "--model", "s",
                 "--device", "cpu"]) == 2
    told = capsys.readouterr().err
    assert "frame 2 has no depth, but frame 1 has: frame 2 cannot be denoised" in told


def test_a_still_needs_no_motion_and_hears_each_warning_once(write_exr, tmp_path, capsys):
    from postfx.cli.main import main

    random = np.random.default_rng(3)
    for number in (1, 2):
        planes = {f"albedo.{name}": random.random((24, 32), np.float32) for name in "RGB"}
        planes |= {name: random.random((24, 32), np.float32) for name in "RGB"}
        planes["depth.Z"] = np.full((24, 32), 4, np.float32)
        write_exr(f"in/shot.{number:04d}.exr", planes)

    def told(source: str, *options: str) -> list[str]:
        run = ["run", str(tmp_path / source), "-o", f"{tmp_path}/out/", "--model", "s", "--device",
               "cpu", "--overwrite", *options]
        assert main(run) == 0
        return [line for line in capsys.readouterr().err.splitlines() if line.startswith("warning")]

    (tmp_path / "alone").mkdir()
    (tmp_path / "in/shot.0001.exr").rename(tmp_path / "alone/still.exr")
    alone = told("alone/still.exr")
    assert [line for line in alone if "4 everywhere" in line and "depth" in line]
    assert len(set(alone)) == len(alone) and not [line for line in alone if "motion" in line]
    assert not [line for line in told("in/shot.0002.exr") if "motion" in line]
    (tmp_path / "alone/still.exr").rename(tmp_path / "in/shot.0001.exr")
    assert [line for line in told("in/shot.####.exr", "--frames", "2") if "motion" in line]
