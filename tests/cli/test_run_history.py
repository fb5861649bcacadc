"""`postfx run` with passes that remember: resuming, pre-roll, and the library frame by frame."""

import numpy as np
import OpenImageIO as oiio
import pytest

import postfx as library
from postfx.io.pattern import parse_frames


def pixels_of(path):
    image = oiio.ImageInput.open(str(path))
    pixels = image.read_image(oiio.UINT16)
    image.close()
    return pixels


@pytest.fixture
def brightening(write_exr, tmp_path):
    """Five frames, each brighter than the one before: metering and tone mapping depend on the
    past."""
    rng = np.random.default_rng(3)
    for number in range(1, 6):
        planes = {name: (2.0**number) * rng.random((40, 56), np.float32) for name in "RGB"}
        write_exr(f"in/shot.{number:04d}.exr", planes)
    return tmp_path


def run(postfx, *arguments):
    done = postfx("run", "in/shot.####.exr", "--no-denoise", "--json", *arguments)
    assert done.code == 0, done.err
    return done.json


def test_resumed_frames_equal_those_of_one_run(postfx, brightening):
    run(postfx, "-o", "out/####.tif")
    whole = pixels_of(brightening / "out/0005.tif")
    (brightening / "out/0005.tif").unlink()
    assert run(postfx, "-o", "out/####.tif", "--skip-existing")["frames"] == 1
    np.testing.assert_array_equal(pixels_of(brightening / "out/0005.tif"), whole)


def test_preroll_gives_a_chunk_its_history(postfx, brightening):
    run(postfx, "-o", "whole/####.tif")
    run(postfx, "-o", "chunk/####.tif", "--frames", "4-5")
    run(postfx, "-o", "cold/####.tif", "--frames", "4-5", "--preroll", "0")
    whole = pixels_of(brightening / "whole/0004.tif")
    np.testing.assert_array_equal(pixels_of(brightening / "chunk/0004.tif"), whole)
    assert (pixels_of(brightening / "cold/0004.tif") != whole).any()
    assert [path.name for path in sorted((brightening / "chunk").glob("*.tif"))] == ["0004.tif",
                                                                                     "0005.tif"]


def test_a_range_of_a_shot_says_which_frames_run_before_it(postfx, brightening):
    done = postfx("run", "in/shot.####.exr", "-o", "part/####.tif", "--no-denoise", "--frames",
                  "4-5")
    assert ("frames 1 to 3 first, unwritten, for the history of frame 4 (--preroll 0 leaves it "
            "out)" in done.err)
    assert "unwritten" not in postfx("run", "in/shot.####.exr", "-o", "all/####.tif",
                                     "--no-denoise").err


@pytest.mark.parametrize(("frames", "between"), [
    ("1-5x2", "frames 2,4 run"), ("2,4-5", "frame 3 runs"), ("1,5", "frames 2-4 run")])
def test_frames_apart_are_those_of_the_whole_shot(postfx, brightening, frames, between):
    run(postfx, "-o", "whole/####.tif")
    done = postfx("run", "in/shot.####.exr", "-o", "some/####.tif", "--no-denoise", "--frames",
                  frames)
    assert (f"{between}, too, unwritten, for the history of later ones (--preroll 0 leaves that "
            "out)") in done.err
    explained = postfx("run", "in/shot.####.exr", "-o", "none/####.tif", "--no-denoise", "--frames",
                       frames, "--explain")
    assert f"history {between}, too" in explained.out
    found = sorted((brightening / "some").glob("*.tif"))
    assert [path.stem for path in found] == [f"{one:04d}" for one in parse_frames(frames)]
    for path in found:
        np.testing.assert_array_equal(pixels_of(path), pixels_of(brightening / "whole" / path.name))


def test_frames_apart_can_be_run_alone(postfx, brightening):
    run(postfx, "-o", "whole/####.tif")
    done = postfx("run", "in/shot.####.exr", "-o", "alone/####.tif", "--no-denoise", "--frames",
                  "1-5x2", "--preroll", "0")
    assert "unwritten" not in done.err and "the history begins anew after each gap" in done.err
    assert (pixels_of(brightening / "alone/0003.tif")
            != pixels_of(brightening / "whole/0003.tif")).any()


def test_a_shot_of_which_every_second_frame_is_there_goes_on_with_the_others(postfx, brightening):
    run(postfx, "-o", "whole/####.tif")
    run(postfx, "-o", "steps/####.tif", "--frames", "1-5x2")
    assert run(postfx, "-o", "steps/####.tif", "--skip-existing")["frames"] == 2
    for number in range(1, 6):
        np.testing.assert_array_equal(pixels_of(brightening / f"steps/{number:04d}.tif"),
                                      pixels_of(brightening / f"whole/{number:04d}.tif"))


def test_a_frame_between_that_cannot_be_read_ends_the_history(postfx, brightening):
    (brightening / "in/shot.0004.exr").write_bytes(b"no EXR")
    done = postfx("run", "in/shot.####.exr", "-o", "some/####.tif", "--no-denoise", "--frames",
                  "3,5")
    assert done.code == 0, done.err
    assert "frames are not consecutive" in done.err


def test_frames_run_in_order_of_time(postfx, brightening):
    for folder, frames in (("there", "1-5"), ("back", "5-1"), ("mixed", "3,1,5,2,4")):
        run(postfx, "-o", f"{folder}/####.tif", "--frames", frames)
        for number in range(1, 6):
            same = (pixels_of(brightening / f"{one}/{number:04d}.tif") for one in ("there", folder))
            np.testing.assert_array_equal(*same)


def test_library_frame_by_frame_equals_one_run(postfx, brightening):
    run(postfx, "-o", "out/####.tif")
    passes = library.Pipeline([library.ToneMap()])
    for frame in library.read_sequence(brightening / "in/shot.####.exr"):
        path = library.write_frame(brightening / f"own/{frame.number:04d}.tif", passes(frame))
        np.testing.assert_array_equal(pixels_of(path), pixels_of(brightening / "out" / path.name))


def test_denoising_keeps_the_size_or_enlarges(postfx, shot, tmp_path):
    shot(1, 2, 3)
    done = postfx("run", "in/shot.####.exr", "-o", "out/shot.####.exr", "--json")
    assert done.code == 0, done.err
    assert list(done.json["passes"]) == ["denoise_upscale"]
    for number in (1, 2, 3):
        pixels = pixels_of(tmp_path / f"out/shot.{number:04d}.exr")
        assert pixels[..., :3].shape == (32, 48, 3)
    done = postfx("run", "in/shot.####.exr", "-o", "out/shot.####.png", "--scale", "1.5", "--json")
    assert list(done.json["passes"]) == ["denoise_upscale", "tonemap"]
    assert pixels_of(tmp_path / "out/shot.0003.png").shape == (48, 72, 3)
