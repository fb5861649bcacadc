"""`postfx run --run-up`."""

import json
import signal

import numpy as np
import OpenImageIO as oiio
import pytest

from postfx.cli.frame_loop import announce_run_up
from postfx.errors import Interrupted
from postfx.io.sequence import Sequence
from postfx.temporal.reverse_order import RunUp

RUN_UP_OF_1 = ("frames 6 back to 1 first, unwritten, so that frame 1 is as clean as the others "
               "(--run-up 0 leaves them out)")
RUN = ("run", "in/shot.####.exr", "--model", "s")


def pixels(path):
    return oiio.ImageBuf(str(path)).get_pixels(oiio.FLOAT)[..., :3]


def test_first_frames_have_a_history(postfx, noise):
    done = postfx(*RUN, "-o", "with/a.####.exr", "--json")
    assert done.json["run_up"]["frames"] == 5
    assert RUN_UP_OF_1 in done.err.splitlines()
    assert "5 frames first, in reverse order, for the first frames' history" in done.err
    done = postfx(*RUN, "-o", "without/a.####.exr", "--run-up", "0", "--json")
    assert done.json["run_up"] == {"frames": 0, "ms_per_frame": None}
    assert "reverse" not in done.err
    assert (pixels(noise / "with/a.0001.exr").std() < 0.8 * pixels(noise / "without/a.0001.exr")
            .std())


def test_explain_names_the_frames(postfx, noise):
    explained = postfx(*RUN, "--run-up", "3", "--explain")
    assert ("run-up  of each shot: frames 4, 3, 2 before frame 1 (--run-up 0 for "
            "none)" in explained.out)
    assert postfx(*RUN, "--explain", "--json").json["ahead"] == [6, 5, 4, 3, 2]
    assert postfx(*RUN, "--explain", "--json", "--run-up", "0").json["ahead"] == []
    assert "run-up" not in postfx(*RUN, "--strength", "0", "--explain").out
    part = postfx(*RUN, "--frames", "3-4", "--run-up", "3", "--explain").out
    assert "history frames 1 to 2 first, unwritten, for frame 3 (--preroll 0 leaves it out)" in part
    assert "frames 4, 3, 2 before frame 1 (" in part
    part = postfx(*RUN, "--frames", "3-4", "--run-up", "3", "--preroll", "0", "--explain").out
    assert "history" not in part and "frame 3 (" in part


def test_a_capture_is_of_the_frame_alone(postfx, noise):
    assert postfx(*RUN, "-o", "out/a.####.exr", "--capture", "look", "--capture-frame",
                  "1").code == 0
    (buffer,) = json.loads((noise / "look/capture.json").read_text())["buffers"]
    assert buffer["label"] == "frame 1"


def test_it_ends_when_the_run_is_to_stop(noise):
    def check() -> None:
        if len(found) == 2:
            raise Interrupted(signal.SIGINT)

    sequence, found, told = Sequence(noise / "in/shot.####.exr"), [], []
    run_up = RunUp(sequence)
    run_up.on_frame = announce_run_up(check, told.append)
    with pytest.raises(Interrupted):
        run_up(next(iter(sequence)), found.append)
    assert [frame.number for frame in found] == [6, 5]
    assert told == [RUN_UP_OF_1]


def test_cuts_that_are_known_have_one_each(postfx, noise):
    done = postfx(*RUN, "-o", "out/a.####.exr", "--cuts", "1,4", "--json")
    assert done.json["run_up"]["frames"] == 4


@pytest.mark.parametrize("options", [(), ("--both-ways",)])
def test_frames_apart_are_denoised_as_in_the_whole_shot(postfx, noise, options):
    postfx(*RUN, "-o", "whole/a.####.exr", *options)
    postfx(*RUN, "-o", "apart/a.####.exr", "--frames", "1-6x2", *options)
    for number in (1, 3, 5):
        np.testing.assert_array_equal(pixels(noise / f"apart/a.{number:04d}.exr"),
                                      pixels(noise / f"whole/a.{number:04d}.exr"))


def test_frames_apart_that_run_alone_have_no_run_up(postfx, noise):
    done = postfx(*RUN, "-o", "out/a.####.exr", "--frames", "1-6x2", "--preroll", "0", "--json")
    assert done.json["run_up"]["frames"] == 0


def test_a_range_with_what_is_before_it_runs_up_to_that(postfx, noise):
    done = postfx(*RUN, "-o", "out/a.####.exr", "--frames", "3-6", "--preroll", "2", "--json")
    assert done.json["run_up"]["frames"] == 5
    whole = postfx(*RUN, "-o", "whole/a.####.exr", "--json")
    assert whole.code == 0
    assert postfx(*RUN, "-o", "one/a.####.exr", "--frames", "1").code == 0
    np.testing.assert_array_equal(pixels(noise / "one/a.0001.exr"),
                                  pixels(noise / "whole/a.0001.exr"))
    for number in range(3, 7):
        np.testing.assert_array_equal(*(pixels(noise / f"{name}/a.{number:04d}.exr")
                                        for name in ("out", "whole")))


@pytest.mark.parametrize("option", [("--both-ways",), ("--budget", "1000")])
def test_there_is_none_beside_other_options(postfx, noise, option):
    done = postfx(*RUN, "-o", "out/a.####.exr", *option, "--json")
    assert (done.code, done.json["run_up"]["frames"]) == (0, 0)


@pytest.mark.parametrize(("option", "why"), [
    (("--no-denoise",),
     "--run-up runs frames more than once, --no-denoise has no denoiser to run up: give one of"),
    (("--budget", "50"),
     "--run-up runs frames more than once, --budget keeps to a time: give one of them"),
    (("--both-ways",),
     "--both-ways knows the frames after the first ones anyway: give one of them"),
])
def test_options_that_do_not_go_together(postfx, noise, option, why):
    done = postfx("run", "in/shot.####.exr", "--run-up", "2", *option, "-o", "out/a.####.exr")
    assert done.code == 2
    assert why in done.err


def test_a_count_is_needed(postfx, noise):
    done = postfx(*RUN, "-o", "out/a.####.exr", "--run-up", "all")
    assert done.code == 2
    assert "'all' is not a whole number from 0" in done.err
