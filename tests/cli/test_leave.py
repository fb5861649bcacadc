"""`postfx run --leave`: what it says before and after, and what the files hold."""

import json

import numpy as np
import OpenEXR
import OpenImageIO as oiio
import pytest

from postfx.masks import id_of_name

RUN = ("run", "in/shot.####.exr", "--device", "cpu", "--model", "s")


@pytest.fixture
def ids(tmp_path):
    """Writes in/shot.####.exr: noise; the left third is a logo, by Cryptomatte, the upper half
    misses of one colour."""
    random = np.random.default_rng(2)
    (tmp_path / "in").mkdir()
    logo = np.array([id_of_name("logo")], np.uint32).view(np.float32)[0]
    for number in (1, 2):
        colour = random.random((64, 96, 3), np.float32)
        colour[:32] = 0.5
        planes = {name: np.ascontiguousarray(colour[..., i]) for i, name in enumerate("RGB")}
        planes["depth.Z"] = np.repeat(np.float32([[1e10], [3]]), 32, 0).repeat(96, 1)
        planes |= {f"CryptoObject00.{letter}": np.zeros((64, 96), np.float32) for letter in "RGBA"}
        planes["CryptoObject00.R"][:, :32], planes["CryptoObject00.G"][:, :32] = logo, 1
        about = {"name": "CryptoObject",
                 "manifest": json.dumps({"logo": f"{id_of_name('logo'):08x}"})}
        header = {f"cryptomatte/0123456/{field}": text for field, text in about.items()}
        path = tmp_path / "in" / f"shot.{number:04d}.exr"
        OpenEXR.File({"type": OpenEXR.scanlineimage, **header}, planes).write(str(path))


def pixels_of(path):
    return oiio.ImageBuf(str(path)).get_pixels(oiio.FLOAT)


def test_explain_and_summary_tell_the_share(postfx, ids, tmp_path):
    told = postfx(*RUN, "--leave", "logo,auto", "--explain")
    (line,) = (line for line in told.out.splitlines() if line.startswith("masks "))
    assert line == ("masks   of frame 1: 60.4 % of the pixels are not denoised at all: logo covers "
                    "33.3 %, auto covers 43.8 %, 50.0 % are misses, of which edges and noisy ones "
                    "are denoised")
    plan = postfx(*RUN, "--leave", "logo,auto", "--explain", "--json").json
    assert plan["left_alone"] == {"frames": 1, "share": 0.6042,
                                  "covered": {"logo": 0.3333, "auto": 0.4375}, "misses": 0.5}
    done = postfx(*RUN, "--leave", "logo,auto", "-o", "out/", "--json")
    assert done.code == 0 and done.json["left_alone"] == {**plan["left_alone"], "frames": 2}
    assert line.replace("masks   of frame 1:", "masks   ") in done.err.splitlines()
    assert "left_alone" not in postfx(*RUN, "--explain", "--json").json


def test_what_is_left_alone_is_the_enlarged_input(postfx, ids, tmp_path):
    larger = (*RUN, "--scale", "2")
    assert postfx(*larger, "--leave", "logo", "-o", "some/").code == 0
    assert postfx(*larger, "--strength", "0", "-o", "none/").code == 0
    assert postfx(*larger, "-o", "all/").code == 0
    some, none, everything = (pixels_of(tmp_path / folder / "shot.0002.exr")
                              for folder in ("some", "none", "all"))
    np.testing.assert_array_equal(some[:, :60], none[:, :60])
    np.testing.assert_array_equal(some[:, 68:], everything[:, 68:])
    assert np.abs(none - everything)[70:].mean() > 0.05


def test_what_has_converged_is_told_with_its_reason(postfx, tmp_path):
    """Noise, and a plane of variance that is 0 in the upper half."""
    (tmp_path / "in").mkdir()
    for number in (1, 2):
        planes = {name: np.random.default_rng(number).random((64, 96), np.float32)
                  for name in "RGB"}
        planes |= {f"mse.{name}": np.repeat(np.float32([0, 1]), 32)[:, None].repeat(96, 1)
                   for name in "RGB"}
        OpenEXR.File({"type": OpenEXR.scanlineimage},
                     planes).write(str(tmp_path / "in" / f"shot.{number:04d}.exr"))
    told = postfx(*RUN, "--leave", "converged:0.01", "--explain")
    (line,) = (line for line in told.out.splitlines() if line.startswith("masks "))
    assert line == ("masks   of frame 1: 40.6 % of the pixels are not denoised at all: "
                    "converged:0.01 covers 43.8 % by AOV 'variance_of_mean'")
    done = postfx(*RUN, "--leave", "converged:0.01", "-o", "out/", "--json")
    assert (done.code == 0
            and done.json["left_alone"]["basis"] == {"converged:0.01": "AOV 'variance_of_mean'"})
    assert line.replace("masks   of frame 1:", "masks   ") in done.err.splitlines()
    seen = postfx("inspect", "in/shot.####.exr", "--json").json
    assert seen["roles"]["variance_of_mean"]["planes"] == ["mse.R", "mse.G", "mse.B"]
    wrong = postfx(*RUN, "--leave", "converged:64spp", "-o", "other/")
    assert (wrong.code == 2 and "'converged:64spp': the number of samples is unknown: render the "
            "AOV" in wrong.err)


def test_errors_come_before_the_first_frame(postfx, ids, tmp_path):
    for leave, message in ((
        "lgo", "in/shot.0001.exr: no 'lgo' in Cryptomatte CryptoObject: nearest: 'logo'"
    ), ("logo=2", "leave 'logo=2': strength 2 of 'logo': give 0 (as it is) to 1 (fully)")):
        done = postfx(*RUN, "-o", "out/", "--leave", leave)
        assert (done.code, done.err.strip()) == (2, f"error: {message}")
    both = postfx(*RUN[:2], "-o", "out/", "--leave", "logo", "--no-denoise")
    assert "--leave is for the denoiser, which --no-denoise leaves out" in both.err
    assert not (tmp_path / "out").exists()
