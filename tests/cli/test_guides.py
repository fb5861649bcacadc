"""Planes at output size on the command line."""

from __future__ import annotations

import json

import numpy as np
import pytest

GUIDES = ("--guides", "in/guides.####.exr")
RUN = ("run", "in/shot.####.exr", "-o", "out/shot.####.exr")


@pytest.fixture
def guides(write_exr):
    """Writes in/guides.####.exr of a size (height, width): an albedo and normals."""

    def write(*numbers: int, size: tuple[int, int] = (48, 72)) -> None:
        random = np.random.default_rng(1)
        for number in numbers:
            planes = {f"albedo.{c}": random.random(size) for c in "RGB"}
            planes |= {f"normal.{c}": np.full(size, float(c == "Z")) for c in "XYZ"}
            write_exr(f"in/guides.{number:04d}.exr", planes)

    return write


def test_output_has_the_size_of_the_guides_and_the_summary_says_so(postfx, shot, guides):
    shot(1, 2)
    guides(1, 2)
    done = postfx(*RUN, *GUIDES, "--json")
    assert done.code == 0
    used = {"width": 72, "height": 48, "used": ["normal", "diffuse_albedo"], "output_follows": True}
    assert done.json["guides"] == used and done.json["frames"] == 2
    assert "guides   72x48, used: normal, diffuse_albedo; the output has their size" in done.err
    assert "profile generic (Generic names), 72x48" in postfx("inspect", "out/shot.####.exr").out


def test_explain_says_whether_guides_are_used(postfx, shot, guides):
    shot(1)
    guides(1)
    assert "guides  72x48, used: normal, diffuse_albedo" in postfx(*RUN, *GUIDES, "--explain").out
    unused = postfx(*RUN, *GUIDES, "--explain", "--no-denoise")
    assert ("guides  72x48, not used" in unused.out and "skips   guides: no pass reads "
            "them" in unused.out)
    document = json.loads(postfx(*RUN, *GUIDES, "--explain", "--json").out)
    assert document["guides"] == ["normal", "diffuse_albedo"]
    assert document["output"]["width"] == 72


def test_larger_files_of_one_file_a_plane_are_guides(postfx, write_exr):
    write_exr("in/beauty.0001.exr", {c: np.ones((32, 48)) for c in "RGB"})
    write_exr("in/albedo.0001.exr", {c: np.full((96, 144), 0.5) for c in "RGB"})
    done = postfx("run", "in/", "-o", "out/x.####.exr", "--json")
    assert done.code == 0
    assert done.json["guides"]["used"] == ["diffuse_albedo"] and done.json["guides"]["width"] == 144


def test_the_render_s_size_leaves_guides_out(postfx, shot, guides, write_exr):
    shot(1)
    guides(1)
    done = postfx(*RUN, *GUIDES, "--denoise-only", "--json")
    assert done.code == 0 and done.json["guides"] is None
    assert "guides.####.exr: guides are not read, as frames keep their own size" in done.err
    assert "profile generic (Generic names), 48x32" in postfx("inspect", "out/shot.####.exr").out
    write_exr("two/beauty.0001.exr", {c: np.ones((32, 48)) for c in "RGB"})
    write_exr("two/albedo.0001.exr", {c: np.full((96, 144), 0.5) for c in "RGB"})
    done = postfx("run", "two/", "-o", "own/x.####.exr", "--denoise-only")
    assert done.code == 0 and "48x32, not enlarged" in done.err
    assert "AOVs diffuse_albedo are larger than the colour: not read" in done.err


def test_a_scale_that_fits_is_taken_and_another_is_refused(postfx, shot, guides):
    shot(1)
    guides(1)
    done = postfx(*RUN, *GUIDES, "--scale", "1.5", "--json")
    assert done.code == 0 and not done.json["guides"]["output_follows"]
    done = postfx(*RUN, *GUIDES, "--scale", "2", "--overwrite")
    message = ("error: in/guides.0001.exr: guides are 72x48, the colour is 48x32: leave the scale "
               "out, or render them at")
    assert done.code == 2 and message in done.err


def test_missing_guides_are_named_before_the_first_frame(postfx, shot, guides, tmp_path):
    shot(1, 2, 3)
    guides(1, 3)
    done = postfx(*RUN, *GUIDES)
    assert done.code == 2
    assert ([line for line in done.err.splitlines() if line.startswith("error: ")] == [
        "error: in/guides.0002.exr: guides of frame 2 are missing: render them or leave the frame "
        "out with --frames"
    ])
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("options", [(), ("--no-denoise",)], ids=["read", "unread"])
def test_guides_that_change_their_size_are_named(postfx, shot, guides, options):
    shot(1, 2)
    guides(1)
    guides(2, size=(64, 96))
    done = postfx(*RUN, *GUIDES, *options)
    assert done.code == 2
    assert ("error: in/guides.0002.exr: guides are 96x64, those of the first frame 72x48: render "
            "them at one" in done.err)


def test_guides_are_inputs_that_are_not_written_over(postfx, shot, guides):
    shot(1)
    guides(1)
    done = postfx("run", "in/shot.####.exr", *GUIDES, "-o", "in/guides.####.exr", "--overwrite")
    assert done.code == 2 and "error: in/guides.0001.exr: is an input" in done.err


def test_inspect_shows_guides(postfx, shot, guides):
    shot(1)
    guides(1)
    done = postfx("inspect", "in/shot.####.exr", *GUIDES)
    assert "guides 72x48 in in/guides.0001.exr" in done.out
    assert any(line.split()[:2] == ["diffuse_albedo", "albedo.R,G,B"]
               for line in done.out.splitlines())
    found = postfx("inspect", "in/shot.####.exr", *GUIDES, "--json").json
    assert [plane["role"] for plane in found["guides"]["planes"]] == ["normal", "diffuse_albedo"]
    assert found["guides"]["width"] == 72 and found["width"] == 48
    assert postfx("inspect", "in/shot.####.exr", "--json").json["guides"] is None
