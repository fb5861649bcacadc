"""`postfx run --both-ways`."""

import numpy as np
import OpenImageIO as oiio
import pytest

RUN = ("run", "in/shot.####.exr", "--model", "s", "--both-ways")


def pixels(path):
    return oiio.ImageBuf(str(path)).get_pixels(oiio.FLOAT)[..., :3]


def spread(path):
    return pixels(path).std()


def test_first_frames_are_as_clean_as_later_ones(postfx, noise):
    assert postfx("run", "in/shot.####.exr", "--model", "s", "--run-up", "0", "-o",
                  "one/a.####.exr").code == 0
    done = postfx(*RUN, "-o", "both/a.####.exr", "--json")
    assert done.code == 0, done.err
    assert set(done.json["passes"]) == {"denoise_upscale backwards", "denoise_upscale", "both_ways"}
    assert done.json["guides"] is None
    assert "frames 6 to 1 first, in reverse order" in done.err
    assert spread(noise / "both/a.0001.exr") < 0.8 * spread(noise / "one/a.0001.exr")


def test_pictures_are_tone_mapped_after_mixing(postfx, noise):
    explained = postfx(*RUN, "-o", "out/a.####.png", "--explain").out
    assert explained.index("both_ways: reads colour, later") < explained.index("tonemap: reads")
    assert "guides" not in explained
    assert postfx(*RUN, "-o", "out/a.####.png").code == 0


def test_frames_that_were_missing_come_out_as_in_an_unbroken_run(postfx, noise):
    assert postfx(*RUN, "-o", "out/a.####.exr").code == 0
    whole = {number: (noise / f"out/a.{number:04d}.exr").read_bytes() for number in (2, 5)}
    for number in whole:
        (noise / f"out/a.{number:04d}.exr").unlink()
    done = postfx(*RUN, "-o", "out/a.####.exr", "--skip-existing", "--json")
    assert done.json["frames"] == 2
    for number, content in whole.items():
        np.testing.assert_array_equal(pixels(noise / f"out/a.{number:04d}.exr"),
                                      read(noise, content))


def read(folder, content):
    path = folder / "before.exr"
    path.write_bytes(content)
    return pixels(path)


def test_a_frame_that_cannot_be_read_is_skipped_or_named(postfx, noise):
    (noise / "in/shot.0004.exr").write_bytes(b"no picture")
    done = postfx(*RUN, "-o", "out/a.####.exr", "--on-error", "skip", "--json")
    assert (done.code, done.json["frames"]) == (3, 5)
    stopped = postfx(*RUN, "-o", "stop/a.####.exr")
    assert stopped.code == 2
    assert "shot.0004.exr" in stopped.err
    assert len(list((noise / "stop").glob("*.exr"))) == 3


def test_a_frame_of_another_aspect_is_skipped(postfx, noise, write_exr):
    """With a size for all, frames may have others, but not that."""
    planes = {name: np.ones((40, 20)) for name in (*"RGB", "depth.Z", "motion.X", "motion.Y")}
    write_exr("in/shot.0003.exr", planes)
    done = postfx(*RUN, "--size", "96x64", "-o", "out/a.####.exr", "--on-error", "skip", "--json")
    assert (done.code, done.json["frames"]) == (3, 5)
    assert [fault["frame"] for fault in done.json["faults"]] == [3]


@pytest.mark.parametrize(("option", "why"), [
    (("--no-denoise",),
     "--both-ways is for the denoiser, which --no-denoise leaves out: give one of them"),
    (("--memory", "4G"),
     "--both-ways keeps results of 32 frames, --memory keeps to a size: give one of them"),
    (("--pass", "exposure_tool,before=denoise_upscale"),
     "--both-ways denoises frames as they are in their files"),
    (("--budget", "50"),
     "--both-ways runs every frame twice, --budget keeps to a time: give one of them"),
])
def test_options_that_do_not_go_together(postfx, noise, option, why):
    arguments = [word
                 for word in RUN if not (option[0] == "--no-denoise" and word in ("--model", "s"))]
    done = postfx(*arguments, *option, "-o", "out/a.####.exr")
    assert done.code == 2
    assert why in done.err


def test_without_strength_there_is_nothing_to_do(postfx, noise):
    done = postfx(*RUN, "--strength", "0", "-o", "out/a.####.exr", "--json")
    assert done.code == 0
    assert "both_ways" not in done.json["passes"]


def write_panning(write_exr, albedo: np.ndarray, amplitude: float = 0.3) -> None:
    """A texture that pans, at four samples a pixel, with an albedo that does not show it."""
    random, (height, width) = np.random.default_rng(11), albedo.shape
    y, x = np.mgrid[:height, :width]
    for number in range(1, 5):
        light = 0.5 + amplitude * np.sin(0.8 * (x + 3 * number)) * np.sin(0.5 * y)
        planes = {name: light * random.gamma(4, 0.25, (height, width)) for name in "RGB"}
        planes |= {f"albedo.{name}": albedo for name in "RGB"}
        write_exr(f"flat/s.{number:04d}.exr", planes | {"motion.X": np.full((height, width), 3.0),
                                                        "motion.Y": np.zeros((height, width))})


ONE_GREY, OBJECTS, NOISY = (np.full((48, 80), 0.5) for _ in range(3))
OBJECTS[:, 40:] = 0.2
NOISY *= 1 + 0.002 * np.random.default_rng(1).standard_normal(NOISY.shape)


@pytest.mark.parametrize("albedo", [ONE_GREY, OBJECTS, NOISY])
def test_albedo_without_the_textures_leaves_it_out(postfx, write_exr, tmp_path, albedo):
    """More history in one order shows more of the textures then: 2 dB more, by a run-up, than both
    ways without."""
    write_panning(write_exr, albedo)
    run = ("run", "flat/s.####.exr", "--model", "s")
    done = postfx(*run, "--both-ways", "-o", "both/s.####.exr")
    assert done.code == 0, done.err
    assert "skipped  both_ways: albedo shows no textures" in done.out + done.err
    assert postfx(*run, "-o", "one/s.####.exr").code == 0
    for number in range(1, 5):
        np.testing.assert_array_equal(pixels(tmp_path / f"both/s.{number:04d}.exr"),
                                      pixels(tmp_path / f"one/s.{number:04d}.exr"))


@pytest.mark.parametrize(("albedo", "amplitude"), [
    (OBJECTS, 0.0), (0.5 + 0.2 * np.random.default_rng(2).random((48, 80)), 0.3),
    (np.zeros((48, 80)), 0.3)])
def test_other_albedo_keeps_it(postfx, write_exr, albedo, amplitude):
    """Objects of one colour in smooth light; albedo with textures of its own; none."""
    write_panning(write_exr, albedo, amplitude)
    done = postfx("run", "flat/s.####.exr", "--model", "s", "--both-ways", "-o",
                  "both/s.####.exr", "--json")
    assert done.code == 0, done.err
    assert "both_ways" in done.json["passes"]


def test_colours_of_a_wide_gamut_stay_what_they_are(postfx, write_exr, tmp_path):
    """Scene-linear files keep their primaries, in both directions."""
    light = {"R": 0.9, "G": 0.4, "B": 0.1}
    for number in range(1, 5):
        planes = {name: np.full((32, 48), value) for name, value in light.items()}
        planes |= {"depth.Z": np.full((32, 48), 3.0), "motion.X": np.zeros((32, 48)),
                   "motion.Y": np.zeros((32, 48))}
        write_exr(f"in/shot.{number:04d}.exr", planes, colorInteropID="lin_ap1_scene")
    for way in ("--both-ways", "--run-up=3"):
        assert postfx("run", "in/shot.####.exr", "--model", "s", way, "-o", "out/a.####.exr",
                      "--overwrite").code == 0
        found = [pixels(tmp_path / f"out/a.{number:04d}.exr").mean((0, 1)) for number in (1, 2, 4)]
        np.testing.assert_allclose(found, [list(light.values())] * 3, rtol=0.02, err_msg=way)
