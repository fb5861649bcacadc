"""The table by kind: what it compares, how it is sorted, and what it keeps."""

import json

import numpy as np
import pytest

from training.datagen.clip_file import write_exr
from training.measure import table
from training.measure.table import RAYS, compare, gains, main, parse_ways, report, shots

SIDE = 48


def scores(psnr, flip=0.1, flicker=10.0):
    return {"psnr": psnr, "flip": flip, "flicker": flicker}


def row(kind, size, samples, ours, oidn):
    return {"folder": f"/v/{kind}", "kind": kind, "size": size, "samples": samples, "stamp": [],
            "oidn": oidn, "ways": {"m": ours}}


def test_each_figure_is_compared_with_the_best_of_the_five():
    oidn = {"clean": scores(30, 0.2, 9), "prefiltered": scores(32, 0.1, 10),
            "accumulated": scores(31, 0.15, 5)}
    found = compare("fog", 4, scores(31.5, 0.12, 6), oidn)
    assert (found.best, found.psnr) == ("prefiltered", -0.5)
    assert found.flip == pytest.approx(1.2) and found.flicker == pytest.approx(1.2)


def test_frames_without_motion_have_no_flicker():
    found = compare("blur", 4, scores(31, 0.1, None), {"clean": scores(30, 0.1, None)})
    assert found.flicker is None and found.psnr == 1


def test_the_same_rays_compare_half_the_size_with_a_quarter_of_the_samples():
    rows = [row("fog", "1x", 4, scores(33), {"clean": scores(32)}),
            row("fog", "2x", 16, scores(30), {"clean": scores(29)}),
            row("fog", "2x", 4, scores(28), {"clean": scores(27)})]
    found = gains(rows, RAYS, "m")
    assert [(gain.samples, gain.psnr) for gain in found] == [(4, -2)]
    assert [gain.psnr for gain in gains(rows, "2x", "m")] == [1, 1]


def test_the_worst_kind_comes_first_and_the_mean_last():
    rows = [row("fog", "1x", 4, scores(33), {"clean": scores(32)}),
            row("smoke", "1x", 4, scores(29), {"raw": scores(32)}),
            row("smoke", "1x", 16, scores(34), {"none": scores(32)})]
    text = report(rows, ["m"])
    lines = [line for line in text.splitlines() if line.startswith("| ")]
    assert [line.split(" ")[1] for line in lines] == ["kind", "---", "smoke", "fog", "**mean**"]
    assert "| smoke | -3.00 | +2.00 |" in lines[2] and lines[2].endswith("| raw, none |")
    assert "| **mean** | -1.00 | +2.00 |" in lines[4]
    assert "Above on 2 of 3; worst: smoke at 4 samples, -3.00 dB." in text


def test_ways_are_names_and_options():
    assert parse_ways("m:;both:--both-ways --model m") == {"m": [],
                                                           "both": ["--both-ways", "--model", "m"]}


def picture(path, colour):
    height, width = colour.shape[:2]
    planes = {"colour": colour, "diffuse_albedo": np.full((height, width, 3), 0.5, np.float32),
              "normal": np.tile(np.float32([0, 0, 1]), (height, width, 1)),
              "depth": np.ones((height, width), np.float32),
              "motion": np.zeros((height, width, 2), np.float32)}
    write_exr(path, planes, {})


@pytest.fixture
def folder(tmp_path):
    """Two frames of a flat wall under noise, at full size, and half of it with twice the
    samples."""
    kind = tmp_path / "wall"
    kind.mkdir()
    random = np.random.default_rng(4)
    for number in (1, 2):
        picture(kind / f"reference.{number:04}.exr", np.full((SIDE, SIDE, 3), 0.3, np.float32))
        for name, side, noise in (("noisy.4", SIDE, 0.3), ("half.16", SIDE // 2, 0.15)):
            light = 0.3 + random.normal(0, noise, (side, side, 3))
            picture(kind / f"{name}.{number:04}.exr", light.clip(0).astype(np.float32))
    (tmp_path / "unfinished").mkdir()
    return tmp_path


def test_shots_are_what_has_references(folder):
    found = [(shot.kind, shot.size, shot.samples) for shot in shots(folder, [], ["1x", "2x"], [])]
    assert found == [("wall", "1x", 4), ("wall", "2x", 16)]
    assert (not list(shots(folder, ["fog"], ["1x"], []))
            and not list(shots(folder, [], ["1x"], [64])))


def test_one_command_measures_and_keeps_what_others_reach(folder, tmp_path, capsys, monkeypatch):
    pytest.importorskip("pyoidn")
    kept = tmp_path / "results" / "table.json"
    command = [str(folder), "--json", str(kept), "--ways", "small:--model s"]
    assert main(command) == 0
    text = capsys.readouterr().out
    for size in ("1x", "2x", RAYS):
        assert f"### {size}, `small` against" in text
    rows = json.loads(kept.read_text())
    assert {way for row in rows for way in row["oidn"]} == {"clean", "prefiltered", "raw", "none",
                                                            "accumulated"}
    assert all(row["oidn"][way]["psnr"] > 20 for row in rows for way in row["oidn"])

    def refuse(*_):
        raise AssertionError("measured again")
    monkeypatch.setattr(table, "five_ways", refuse)
    monkeypatch.setattr(table, "run_postfx", refuse)
    assert main(command) == 0
    assert capsys.readouterr().out == text


def test_first_frames_without_references_run_and_are_not_measured(folder):
    shot = next(shots(folder, [], ["1x"], []))
    (shot.folder / "reference.0001.exr").unlink()
    judge = table.Judge(shot)
    assert [frame.number for frame in judge.frames] == [1, 2]
    right = np.full((SIDE, SIDE, 3), 0.3, np.float32)
    wrong = judge.score([right, right + 0.1])
    assert judge.score([right + 0.1, right])["psnr"] > wrong["psnr"] + 20


def test_files_that_changed_are_measured_again(folder, tmp_path):
    shot = next(shots(folder, [], ["1x"], []))
    results = table.Results(tmp_path / "kept.json")
    results.add(shot, {"clean": scores(30)}, {"m": scores(31)})
    again = table.Results(tmp_path / "kept.json")
    assert again.known(shot) == {"clean": scores(30)}
    picture(shot.folder / "noisy.4.0002.exr", np.ones((SIDE, SIDE, 3), np.float32))
    assert again.known(shot) == {}
    assert again.add(shot, {"clean": scores(29)}, {})["ways"] == {}


@pytest.mark.parametrize(("arguments", "message"), [
    (["{folder}/none"], "is not a folder: render it by render_scenes.py"),
    (["{folder}", "--kinds", "fog"], "holds no KIND/noisy.SPP.####.exr with references"),
    (["{folder}", "--sizes", "3x"], "--sizes 3x: there are 1x, 2x")])
def test_bad_arguments_get_one_line(folder, capsys, arguments, message):
    with pytest.raises(SystemExit):
        main([argument.format(folder=folder) for argument in arguments])
    assert message in capsys.readouterr().err
