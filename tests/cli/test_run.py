"""`postfx run` without networks: files, options, reports and failures."""

import json

import numpy as np
import OpenImageIO as oiio
import pytest

from postfx.cli.main import main
from postfx.colour.displays import srgb_encode

COPY = ("run", "in/shot.####.exr", "-o", "out/shot.####.exr", "--no-denoise")
"""A run that changes no pixel."""


def outputs(folder):
    """Names of the frames in a folder."""
    books = ("postfx.manifest.json", ".postfx")
    return (sorted(path.name for path in folder.iterdir() if path.name not in books)
            if folder.is_dir() else [])


def pixels_of(path):
    """The picture of a file: R, G, B, and A where it is there, not what is kept beside it."""
    image = oiio.ImageInput.open(str(path))
    pixels = image.read_image(0, 0, 0, 4 if "A" in image.spec().channelnames else 3, oiio.FLOAT)
    image.close()
    return pixels


def test_as_many_frames_out_as_in(postfx, shot, tmp_path):
    shot(1, 2, 3)
    done = postfx(*COPY)
    assert (done.code, done.out) == (0, "")
    assert outputs(tmp_path / "out") == ["shot.0001.exr", "shot.0002.exr", "shot.0003.exr"]
    assert "3 of 3 frames" in done.err
    assert "denoise_upscale: --no-denoise" in done.err
    np.testing.assert_allclose(pixels_of(tmp_path / "out/shot.0002.exr")[:, :, 0].mean(), 2.5,
                               atol=0.1)


def test_json_report(postfx, shot):
    shot(1, 2, 3, 4)
    done = postfx(*COPY, "--frames", "1-4x2", "--json")
    report = done.json
    assert set(report) == {"frames", "seconds", "ms_per_frame", "passes", "skipped", "warnings",
                           "outputs", "guides",
                           "chosen", "cuts", "broken", "run_up", "prepared", "exposure",
                           "pixel_filter"}
    assert report["frames"] == 2
    assert report["outputs"] == ["out/shot.0001.exr", "out/shot.0003.exr"]
    assert set(report["ms_per_frame"]) == {"median", "min", "max"}
    assert {"what": "AOV 'depth'", "why": "no pass reads it"} in report["skipped"]
    assert {"what": "denoise_upscale", "why": "--no-denoise"} in report["skipped"]
    assert any("the history begins anew" in warning for warning in report["warnings"])


def test_display_output_without_tone_mapping_is_clipped_and_encoded(postfx, write_exr, tmp_path):
    write_exr("still.exr", {name: np.full((8, 8), value)
                            for name, value in zip("RGB", (0.18, 1, 5), strict=True)})
    done = postfx("run", "still.exr", "-o", "still.png", "--no-denoise", "--no-tonemap",
                  "--exposure", "0")
    assert done.code == 0
    np.testing.assert_allclose(pixels_of(tmp_path / "still.png")[0, 0], [0.4614, 1, 1], atol=0.003)


def test_display_output_is_tone_mapped(postfx, shot, tmp_path):
    shot(1, 2)
    done = postfx("run", "in/shot.####.exr", "-o", "out/", "--no-denoise", "--tonemap", "--json")
    assert list(done.json["passes"]) == ["tonemap"]
    done = postfx("run", "in/shot.####.exr", "-o", "out/shot.####.png", "--no-denoise", "--json")
    assert list(done.json["passes"]) == ["tonemap"]
    linear = pixels_of(tmp_path / "out/shot.0002.exr")
    encoded = pixels_of(tmp_path / "out/shot.0002.png")
    assert 0 < encoded.min() < encoded.max() <= 1
    np.testing.assert_allclose(srgb_encode(linear), encoded, atol=0.004)


def test_explain_writes_nothing(postfx, shot, tmp_path):
    shot(1)
    done = postfx(*COPY, "--explain")
    assert done.code == 0
    assert "skips   AOV 'depth': no pass reads it" in done.out
    assert "tonemap: EXR output stays scene-linear" in done.out
    assert json.loads(postfx(*COPY, "--explain", "--json").out)["frames"] == 1
    assert outputs(tmp_path / "out") == []


def test_existing_outputs_stop_the_run_before_it_starts(postfx, shot, tmp_path):
    shot(1, 2)
    (tmp_path / "out").mkdir()
    (tmp_path / "out/shot.0002.exr").write_text("mine")
    done = postfx(*COPY)
    assert done.code == 2
    assert ("error: out/shot.0002.exr: is already there: give --overwrite or "
            "--skip-existing" in done.err)
    assert outputs(tmp_path / "out") == ["shot.0002.exr"]


def test_resume_keeps_complete_files_and_mends_broken_ones(postfx, shot, tmp_path):
    shot(1, 2, 3)
    assert postfx(*COPY).code == 0
    kept, broken = tmp_path / "out/shot.0001.exr", tmp_path / "out/shot.0002.exr"
    (tmp_path / "out/shot.0003.exr").unlink()
    whole = broken.read_bytes()
    broken.write_bytes(whole[: len(whole) // 2])
    before = kept.stat().st_mtime_ns
    report = postfx(*COPY, "--skip-existing", "--json").json
    assert report["outputs"] == ["out/shot.0002.exr", "out/shot.0003.exr"]
    assert {"what": "frame 1",
            "why": "out/shot.0001.exr exists and is complete"} in report["skipped"]
    assert kept.stat().st_mtime_ns == before
    assert len(broken.read_bytes()) == len(whole)


def test_overwrite_replaces_an_older_file(postfx, shot, tmp_path):
    shot(1)
    (tmp_path / "out").mkdir()
    (tmp_path / "out/shot.0001.exr").write_text("old")
    assert postfx(*COPY, "--overwrite").code == 0
    assert pixels_of(tmp_path / "out/shot.0001.exr").shape == (32, 48, 3)


def test_missing_frames_are_named_before_the_first_one(shot, tmp_path, capsys, monkeypatch):
    shot(1, 2, 4)
    monkeypatch.chdir(tmp_path)
    run = ["run", *COPY[1:], "--device", "cpu", "--exposure", "0"]
    assert main(run) == 2
    assert ("error: in/shot.0003.exr: frame 3 is missing: render it or leave it "
            "out" in capsys.readouterr().err)
    assert main([*run, "--frames", "1-9"]) == 2
    holes = ("in/shot.####.exr: 6 of 9 frames are missing: 3,5-9: render them, leave them out with "
             "--frames, or give ")
    assert holes in capsys.readouterr().err and not (tmp_path / "out").exists()
    assert main([*run, "--frames", "1-5", "--explain"]) == 0
    assert "input   in/shot.####.exr: 5 frames (1-5, 2 missing: 3,5)\n" in capsys.readouterr().out
    assert main([*run, "--frames", "1-5", "--on-error", "skip"]) == 3
    first, second = capsys.readouterr().err.splitlines()[:2]
    assert (first == "in/shot.####.exr to out/shot.####.exr: 5 frames (1-5, 2 missing: 3,5), "
            "48x32, not enlarged")
    assert second == "2 of 5 frames are missing, --on-error skip goes on without: 3,5"
    assert main([*run, "--frames", "1-3", "--skip-existing"]) == 2
    assert "error: in/shot.0003.exr: frame 3 is missing" in capsys.readouterr().err


def test_broken_file_in_the_middle_keeps_the_finished(postfx, shot, tmp_path):
    third = shot(1, 2, 3) / "shot.0003.exr"
    third.write_bytes(third.read_bytes()[:900])
    done = postfx(*COPY)
    assert done.code == 2
    assert "error: in/shot.0003.exr: " in done.err
    assert outputs(tmp_path / "out") == ["shot.0001.exr", "shot.0002.exr"]


def test_plane_that_ends_in_the_middle_is_named(postfx, shot, write_exr):
    shot(1, 2, alpha=True)
    write_exr("in/shot.0002.exr", {name: np.ones((32, 48)) for name in "RGB"})
    done = postfx(*COPY)
    assert done.code == 2
    assert "error: in/shot.0002.exr: no AOV 'alpha'" in done.err


def test_input_without_colour(postfx, write_exr):
    write_exr("in/shot.0001.exr", {"depth.Z": np.ones((4, 4))})
    done = postfx(*COPY)
    assert done.code == 2
    assert "error: in/shot.0001.exr: no AOV 'colour': profile generic looks for R, G, B" in done.err


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--profile", "maya"), "unknown profile 'maya': use one of"),
        (("--profile", "none.toml"), "none.toml: profile cannot be read"),
        (("--frames", "1-"), "--frames 1-: not a frame range"),
        (("--exposure", "bright"), "exposure 'bright'"),
        (("--tonemap", "sepia"), "no look 'sepia': there are aces2"),
        (("--tonemap", "reinhart"), "no look 'reinhart': did you mean reinhard? there are"),
        (("--scale", "2"), "--scale is for the denoiser, which --no-denoise leaves out"),
        (("--strength", "0.5"), "--strength is for the denoiser, which --no-denoise leaves out"),
        (("-o", "out/shot.exr", "--frames", "2-1"),
         "one file for 2 frames, 1-2: write it like shot.####.exr"),
        (("-o", "out/shot.####.bmp"), "unknown format '.bmp': use .exr"),
        (("-o", "out/shot.mp4"),
         "write 'out/shot.####.png', then run ffmpeg -framerate 24 -i out/shot.%04d.png"),
        (("-o", "in/"), "in/shot.0001.exr: is an input"),
        (("-o", "in/shot.0001.exr/x.####.exr"), "x.0001.exr: cannot be written"),
    ],
)
def test_mistakes_get_one_clear_line(postfx, shot, arguments, message):
    shot(1, 2)
    done = postfx(*COPY, *arguments)
    assert done.code == 2
    assert done.err.startswith("error: ") and done.err.count("\n") == 1, "no results of no frame"
    assert message in done.err


def test_no_strength_resamples(postfx, shot, tmp_path):
    shot(1)
    done = postfx("run", "in/shot.####.exr", "-o", "out/", "--strength", "0", "--scale", "1",
                  "--exposure", "0")
    assert done.code == 0 and "strength 0: the input is only resampled" in done.err, done.err
    given, found = (pixels_of(tmp_path / folder / "shot.0001.exr") for folder in ("in", "out"))
    np.testing.assert_array_equal(found, given[..., :3].astype(np.float16))
    assert "strength 2: give a number from 0 to 1" in postfx("run", "in/shot.####.exr", "-o", "o/",
                                                   "--strength", "2").err


def test_a_budget_takes_the_fastest_network_first_and_tells(postfx, shot):
    shot(1, 2)
    done = postfx("run", "in/shot.####.exr", "-o", "out/", "--budget", "0.001", "--json")
    assert done.code == 0 and done.json["chosen"] == {"denoise_upscale": {"s": 2}}, done.err
    assert "chose    denoise_upscale: s for 2 frames" in done.err
    nothing = postfx("run", "in/shot.####.exr", "-o", "o/", "--budget", "0")
    assert "cannot work in 0 ms: give a budget above 0" in nothing.err
    refused = postfx("run", "in/shot.####.exr", "-o", "o/", "--budget", "9", "--no-denoise")
    assert "--budget is for the denoiser, which --no-denoise leaves out" in refused.err


def test_missing_input_and_output(postfx, shot):
    assert ("error: nothing.####.exr: no such "
            "file" in postfx("run", "nothing.####.exr", "-o", "out/").err)
    shot(1)
    assert "error: nowhere to write: give -o OUTPUT" in postfx("run", "in/shot.####.exr").err


def test_unwritable_folder(postfx, shot, tmp_path):
    shot(1)
    (tmp_path / "out").write_text("a file where the folder should be")
    done = postfx(*COPY)
    assert done.code == 2
    assert "error: out/shot.0001.exr: cannot be written" in done.err
