"""Files whose size changes from frame to frame, by the command line."""

import numpy as np
import pytest

from postfx.frame import Role
from postfx.io.sequence import read_sequence

RUN = ("run", "in/shot.####.exr", "-o", "out/clean.####.exr", "--model", "s")


@pytest.fixture
def dynamic(write_exr):
    """Writes in/shot.####.exr of changing size, grey 0.5, with still motion."""
    sizes = (48, 32), (36, 24), (48, 32), (24, 16)
    for number, (width, height) in enumerate(sizes, 1):
        planes = dict.fromkeys("RGB", np.full((height, width), 0.5)) | dict.fromkeys(
            ("motion.X", "motion.Y"), np.zeros((height, width)))
        write_exr(f"in/shot.{number:04d}.exr", planes, postfx__reset=int(number == 1))


def test_the_output_keeps_its_size_and_the_history_goes_on(postfx, dynamic, tmp_path):
    done = postfx(*RUN, "--size", "72x48", "--json")
    assert done.code == 0, done.err
    assert ("preparation at 1 of 3 changes of size in denoise_upscale: frames of these sizes were "
            "there before" in done.err)
    assert "history for 1 frame in denoise_upscale: first frame" in done.err
    frames = list(read_sequence(tmp_path / "out" / "clean.####.exr"))
    assert [frame[Role.COLOUR].shape for frame in frames] == [(48, 72, 3)] * 4
    assert all(np.allclose(frame[Role.COLOUR], 0.5, rtol=2e-3) for frame in frames)
    again = postfx(*RUN, "--size", "72x48", "--skip-existing")
    assert (again.code == 0 and "0 of 4 frames" in again.err and "exists and is "
            "complete" in again.err)


@pytest.mark.parametrize("lost", [2, 3, 4])
def test_a_lost_frame_is_made_anew_to_the_bit(lost, postfx, dynamic, tmp_path):
    """Its history is that of frames of other sizes, which run again."""
    assert postfx(*RUN, "--size", "72x48").code == 0
    frame = tmp_path / "out" / f"clean.{lost:04d}.exr"
    whole = frame.read_bytes()
    frame.unlink()
    again = postfx(*RUN, "--size", "72x48", "--skip-existing")
    assert again.code == 0 and "1 of 4 frames" in again.err, again.err
    assert frame.read_bytes() == whole


def test_another_size_is_told_before_the_first_frame(postfx, dynamic):
    done = postfx(*RUN)
    told = "warning  frame 2 is 36x24, frame 1 48x32: the run ends there"
    assert done.code == 2 and done.err.index(told) < done.err.index("1/4 out/"), done.err
    assert "the run ends there" not in postfx(*RUN, "--size", "72x48", "--overwrite").err


def test_explain_tells(postfx, dynamic):
    told = postfx(*RUN[:2], "--size", "72x48", "--explain").out
    assert "48x32 -> 72x48; network m; stays 72x48 where frames change their size" in told


def test_inspect_tells(postfx, dynamic):
    assert "sizes-change" in postfx("inspect", "in/shot.####.exr").out


@pytest.mark.parametrize(("options", "message"), [
    (("--size", "72x40"),
     "error: in/shot.0001.exr: 48x32 does not have the proportions of 72x40, overscan "
     "included: give a size like 72x48, or render at 48x27"),
    (("--size", "80x54"),
     "error: in/shot.0004.exr: 24x16 cannot become 80x54: frames are enlarged up to 3"),
    (("--size", "72"), "argument --size: '72' is not a size like 1920x1080"),
    (("--size", "72x48", "--scale", "2"), "argument --scale: not allowed with argument --size"),
    (("--size", "72x48", "--no-denoise"),
     "error: --size is for the denoiser, which --no-denoise leaves out"),
])
def test_mistakes_get_one_clear_line(postfx, dynamic, options, message):
    done = postfx("run", "in/shot.####.exr", "-o", "out/", *options)
    assert done.code == 2 and message in done.err and "Traceback" not in done.err, done.err
