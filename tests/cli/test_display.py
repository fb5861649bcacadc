"""Displays, views, dither, colour spaces and look-up tables on the command line."""

import numpy as np
import OpenImageIO as oiio
import pytest

RUN = ("run", "in/shot.####.exr", "--no-denoise", "--exposure", "0")


def codes_of(path, kind=oiio.FLOAT):
    image = oiio.ImageInput.open(str(path))
    pixels = image.read_image(kind)
    image.close()
    return pixels


def test_views_for_displays(postfx, shot, tmp_path):
    shot(1)
    done = postfx(*RUN, "-o", "out/hdr.####.png", "--tonemap", "ocio:", "--display", "pq,peak=500",
                  "--json")
    assert (done.code, list(done.json["passes"])) == (0, ["view"])
    assert done.json["chosen"] == {"view": {"ACES 2.0 - HDR 500 nits (P3 D65), Rec.2100-PQ - "
                                            "Display": 1}}
    # PQ of 500 nits
    assert codes_of(tmp_path / "out/hdr.0001.png", oiio.UINT16).max() < 0.68 * 65535
    done = postfx(*RUN, "-o", "out/p3.####.tif", "--tonemap", "neutral", "--display", "p3",
                  "--json")
    assert list(done.json["passes"]) == ["view", "display"]


def test_networks_for_hdr_displays_are_not_called_hdr(postfx, shot):
    shot(1)
    done = postfx(*RUN, "-o", "out/a.####.png", "--display", "hlg", "--json")
    assert list(done.json["passes"]) == ["tonemap", "display"]
    assert any("its white is shown at 203 nits, nothing is brighter" in warning
               for warning in done.json["warnings"])


def test_exr_of_a_display(postfx, shot, tmp_path):
    shot(1)
    assert postfx(*RUN, "-o", "out/a.####.exr", "--no-tonemap", "--display", "rec2020").code == 0
    header = oiio.ImageInput.open(str(tmp_path / "out/a.0001.exr")).spec()
    assert header.getattribute("chromaticities")[0] == pytest.approx(0.708)
    assert postfx(*RUN, "-o", "out/b.####.exr").code == 0
    assert codes_of(tmp_path / "out/b.0001.exr").max() > 1.5  # stays scene-linear


def test_dither_moves_or_stands_still_or_is_left_out(postfx, write_exr, tmp_path):
    write_exr("in/shot.0001.exr", {name: np.full((64, 64), 0.3337) for name in "RGB"})
    write_exr("in/shot.0002.exr", {name: np.full((64, 64), 0.3337) for name in "RGB"})
    pictures = {}
    for how in ("moving", "static", "none"):
        assert postfx(*RUN, "-o", f"{how}/a.####.png", "--no-tonemap", "--dither", how).code == 0
        pictures[how] = [codes_of(tmp_path / f"{how}/a.{number:04d}.png", oiio.UINT8)
                         for number in (1, 2)]
    assert [len(np.unique(pictures[how][0])) for how in pictures] == [2, 2, 1]
    assert (pictures["moving"][0] != pictures["moving"][1]).any()
    np.testing.assert_array_equal(*pictures["static"])


def test_colour_spaces(postfx, write_exr, tmp_path):
    write_exr("in/shot.0001.exr",
              {name: np.full((8, 8), value) for name, value in zip("RGB", (1, 0, 0), strict=True)})
    done = postfx(*RUN, "-o", "out/a.####.png", "--no-tonemap", "--display", "p3", "--colourspace",
                  "p3", "--json")
    assert done.json["warnings"] == ["colours are p3: turned to linear Rec.709"]
    np.testing.assert_allclose(codes_of(tmp_path / "out/a.0001.png")[0, 0], [1, 0, 0], atol=0.005)
    done = postfx(*RUN, "-o", "out/a.####.exr", "--colourspace", "acescg", "--json")
    assert done.json["warnings"] == ["colours are acescg: kept as they are"]
    np.testing.assert_array_equal(codes_of(tmp_path / "out/a.0001.exr")[0, 0], [1, 0, 0])
    header = oiio.ImageInput.open(str(tmp_path / "out/a.0001.exr")).spec()
    assert header.getattribute("chromaticities")[0] == pytest.approx(0.713)


@pytest.mark.parametrize(("arguments", "message"), [
    (("--display", "crt"), "unknown display 'crt'"),
    (("--tonemap", "ocio:kodak"), "no view 'kodak'"),
    (("--tonemap", "film.cube,input=ACEScct"), "film.cube: no such look-up table"),
    (("--colourspace", "xyz"), "unknown colour space 'xyz'"),
])
def test_what_there_is_not(postfx, shot, arguments, message):
    shot(1)
    done = postfx(*RUN, "-o", "out/a.####.png", *arguments)
    assert done.code == 2 and message in done.err and done.err.count("\n") == 1


def test_hdr_does_not_fit_into_jpeg(postfx, shot):
    shot(1)
    done = postfx(*RUN, "-o", "out/a.####.jpg", "--display", "pq")
    assert done.code == 2 and "JPEG has too few bits" in done.err
    assert done.err.count("\n") == 1  # before any frame


def test_a_look_becomes_a_table_and_the_table_a_look(postfx, shot, tmp_path):
    shot(1, 2)
    done = postfx("lut", "in/shot.####.exr", "-o", "look.cube", "--tonemap", "reinhard", "--size",
                  "17", "--json")
    facts = done.json
    assert (facts["size"], facts["frames"], facts["measured_on"], facts["display"]) == (17, 1, 1,
                                                                                        "srgb")
    text = (tmp_path / "look.cube").read_text()
    assert f"PSNR {facts['psnr']:.2f} dB, Delta E ITP {facts['delta_e_itp']:.2f}" in text
    assert "# postfx: input=ACEScct, output=srgb" in text
    done = postfx(*RUN, "-o", "out/a.####.png", "--tonemap", "look.cube", "--json")
    assert done.json["chosen"] == {"view": {"look.cube, takes ACEScct": 2}}
    assert postfx("lut", "in/shot.####.exr", "-o", "look.txt").code == 2
    assert "name it by --tonemap agx" in postfx("lut", "agx", "-o", "agx.cube").err
