"""`postfx run --memory`, and what a run says of the frames' masked parts."""

import numpy as np
import OpenImageIO as oiio

RUN = ("run", "in/shot.####.exr", "--device", "cpu", "--model", "s", "--overwrite")


def pixels_of(path):
    return oiio.ImageBuf(str(path)).get_pixels(oiio.FLOAT)


def test_a_run_within_a_budget_gives_the_same_files(postfx, shot, tmp_path):
    shot(1, 2, alpha=True)
    assert postfx(*RUN, "-o", "whole/").code == 0
    assert postfx(*RUN, "-o", "parts/", "--memory", "500M").code == 0
    for name in ("shot.0001.exr", "shot.0002.exr"):
        np.testing.assert_array_equal(pixels_of(tmp_path / "parts" / name),
                                      pixels_of(tmp_path / "whole" / name))


def test_budgets_that_cannot_be(postfx, shot, write_exr, tmp_path):
    shot(1)
    unknown = postfx(*RUN, "-o", "out/", "--memory", "much")
    assert (unknown.code, unknown.err.splitlines()[-1]) == (
        2,
        "error: memory budget 'much' is not a size: give bytes, or a number with K, M, G or T: 4G")
    write_exr("large.0001.exr", {name: np.ones((320, 400)) for name in "RGB"})
    small = postfx("run", "large.0001.exr", "--device", "cpu", "--model", "s", "-o", "out/",
                   "--memory", "310M")
    assert small.code == 2
    assert "400x320 cannot be denoised within 310M: give a memory budget of " in small.err
    assert not list((tmp_path / "out").glob("*"))


def test_what_a_mask_spared_is_told_with_its_time(postfx, write_exr):
    for number in range(1, 5):
        planes = ({name: np.full((256, 320), 0.3 + 0.01 * number) for name in "RGB"}
                  | {"strength.Y": np.zeros((256, 320))})
        planes["strength.Y"][230:] = 1
        write_exr(f"in/shot.{number:04d}.exr", planes)
    done = postfx(*RUN, "-o", "out/", "--scale", "2")
    line = next(line for line in done.err.splitlines() if "network outside of" in line)
    assert line.startswith("skipped  network outside of 38 % of 4 frames in denoise_upscale: "
                           "strength is 0 there; ")
    assert line.endswith(" ms a frame")


def test_a_frame_that_no_memory_holds_is_refused_before_it_runs(postfx, shot, monkeypatch):
    shot(1)
    monkeypatch.setattr("postfx.cli.interruptions.usable_memory", lambda: 1 << 14)
    refused = postfx(*RUN, "-o", "out/")
    assert refused.code == 2 and refused.err.count("\n") == 1
    assert ("in/shot.####.exr: to denoise " in refused.err and "give --memory 1G, which works in "
            "tiles" in refused.err)
    for more in (["--memory", "500M"], ["--model", "classic"]):
        assert postfx(*RUN, "-o", "out/", *more).code == 0
