"""`postfx exposure`, `--exposure smooth` and POSTFX_EXPOSURE_TOOL, as people call them."""

from __future__ import annotations

import contextlib
import io
import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import OpenImageIO as oiio
import pytest

from postfx.cli.main import main
from tests.exposure.scenes import picture

EV = 1.0


@pytest.fixture
def grey(write_exr: Callable[..., Path]) -> Callable[..., None]:
    """Writes in/shot.####.exr: pictures that need these stops, with their exposure in the
    header."""

    def write(*needed: float, **header: object) -> None:
        for number, ev in enumerate(needed, 1):
            colour = picture(ev)
            planes = dict(zip("RGB", np.moveaxis(colour, -1, 0), strict=True))
            write_exr(f"in/shot.{number:04d}.exr", planes,
                      **{"postfx__exposure": 2.0**ev, **header})

    return write


def pixels(path: Path) -> np.ndarray:
    return oiio.ImageBuf(str(path)).get_pixels(oiio.FLOAT)


def test_a_right_exposure_is_called_right(postfx, grey) -> None:
    grey(EV, EV, EV)
    for mode in ("auto", "smooth", "metadata", str(EV)):
        done = postfx("exposure", "in/", "--exposure", mode)
        assert (done.code, "verdict  right" in done.out) == (0, True), done.out + done.err


@pytest.mark.parametrize(("error", "verdict"), [(-0.5, "too dark"), (0.25, "too bright")])
def test_a_wrong_exposure_is_named_with_its_size(postfx, grey, error: float, verdict: str) -> None:
    grey(EV, EV)
    done = postfx("exposure", "in/", "--exposure", str(EV + error), "--json")
    (shot,) = done.json["shots"]
    assert (done.code, done.json["verdict"], shot["verdict"]) == (1, verdict, verdict)
    assert (shot["mismatch_ev"] == pytest.approx(error, abs=0.05)
            and shot["right_ev"] == pytest.approx(EV, abs=0.05))
    assert [frame["number"] for frame in done.json["frames"]] == [1, 2]


def test_the_table_tells_what_is_likely_wrong(postfx, grey) -> None:
    grey(EV, EV, postfx__exposure=1.0)
    done = postfx("exposure", "in/", "--exposure", "metadata")
    assert done.code == 1 and " too dark\nlikely   the exposure is 1 (0 EV) throughout" in done.out


def test_beyond_white_a_bound_is_told(postfx, grey) -> None:
    grey(EV)
    assert "beyond +" in postfx("exposure", "in/", "--exposure", "9", "--no-tonemap").out


def test_errors_end_with_two(postfx, grey, write_exr) -> None:
    grey(EV)
    assert postfx("exposure", "in/", "--exposure", "right").code == 2
    assert postfx("exposure", "nothing.####.exr").code == 2


def test_pictures_are_written(postfx, grey, tmp_path: Path) -> None:
    grey(EV, EV)
    done = postfx("exposure", "in/", "--curve", "curves/a.png", "--views", "look")
    assert done.code == 0, done.err
    kinds = ("false_colour_log_c", "false_colour_display", "zebra")
    wanted = {f"{kind}.{number:04d}.png" for kind in kinds for number in (1, 2)} | {"curve.png"}
    assert {path.name for path in (tmp_path / "look").iterdir()} == wanted
    assert pixels(tmp_path / "curves/a.png").shape == (560, 1200, 3)
    middle = pixels(tmp_path / "look/false_colour_log_c.0001.png")[:54]  # above the key
    green = (abs(middle * 255 - (60, 180, 75)) < 1).all(axis=-1).mean(axis=0)
    assert green[48] > 0.9 and green[0] == 0  # 0.18, exposed, is in the middle of the picture


def test_smooth_exposure_of_a_part_is_that_of_the_whole(postfx, grey, tmp_path: Path) -> None:
    grey(0.0, 0.5, 1.5, 0.5)
    arguments = ("run", "in/", "-o", "out/p.####.png", "--no-denoise", "--no-tonemap", "--exposure",
                 "smooth")
    assert postfx(*arguments).code == 0
    whole = pixels(tmp_path / "out/p.0003.png")
    (tmp_path / "out/p.0003.png").unlink()
    assert postfx(*arguments, "--skip-existing").code == 0
    assert np.array_equal(pixels(tmp_path / "out/p.0003.png"), whole)
    assert postfx("run", "in/", "-o", "late/p.####.png", *arguments[4:-1], "auto").code == 0
    assert abs(pixels(tmp_path / "late/p.0003.png") - whole).mean() > 0.02


@pytest.fixture
def told(grey, tmp_path: Path, monkeypatch, capsys) -> Callable[..., tuple[dict, str]]:
    """Runs `postfx run in/ ARGUMENTS --json` on two night shots, six stops below mid grey; its JSON
    and its text."""

    def run(*arguments: str, exposure: float | None = None) -> tuple[dict, str]:
        monkeypatch.chdir(tmp_path)
        grey(6.0, 6.0, **{"postfx__exposure": exposure if exposure else 1.0})
        words = ["run", "in/shot.####.exr", "--no-denoise", "--no-tonemap", "--device", "cpu",
                 "--overwrite"]
        assert main([*words, *arguments, "--json"]) == 0
        found = capsys.readouterr()
        return json.loads(found.out), found.err

    return run


def test_metering_is_told_and_a_night_shot_is_no_day_in_silence(told, tmp_path: Path) -> None:
    report, text = told("-o", "out/a.####.png")
    assert "exposure +6.0 EV, metered (as it was lit: +0.0 EV, with --exposure lit)" in text
    assert ("warning  metering shows this 6.0 EV brighter than it was lit: a night shot comes out "
            "as day" in text)
    used = report["exposure"]
    assert (used["mode"], used["metered"], used["applied"]) == ("auto", True, True)
    assert used["ev"] == pytest.approx([6, 6], abs=0.05) and set(used["multipliers"]) == {"1", "2"}
    night, text = told("-o", "night/a.####.png", "--exposure", "lit")
    assert "exposure +0.0 EV, as it was lit\n" in text and "night shot" not in text
    assert night["exposure"]["ev"] == [0, 0] and not night["exposure"]["metered"]
    assert (pixels(tmp_path / "night/a.0001.png")
            .mean() < 0.1 < 0.4 < pixels(tmp_path / "out/a.0001.png").mean())
    lit, text = told("-o", "out/a.####.png", exposure=2.0**5)
    assert ("(as it was lit: +5.0 EV, by the header, with --exposure lit)" in text and "night "
            "shot" not in text)


def test_the_plan_says_how_pictures_are_exposed(told) -> None:
    for mode, line in (("auto", "exposes frame 1 by +6.0 EV, metered (as it was lit: +0.0 EV, with "
                        "--exposure lit)"),
                       ("lit", "exposes frame 1 by +0.0 EV, as it was lit"),
                       ("1.5", "exposes frame 1 by +1.5 EV, as given"),
                       ("smooth", "exposes all frames by what metering them gives")):
        plan, _ = told("-o", "out/a.####.png", "--exposure", mode, "--explain")
        assert plan["exposure"]["mode"] == mode and plan["exposure"]["applied"]
        (one,) = [text for text in explained(mode).splitlines() if text.startswith("exposes")]
        assert one.startswith(line)


def explained(mode: str) -> str:
    """What --explain prints."""
    with contextlib.redirect_stdout(io.StringIO()) as found:
        main(["run", "in/", "-o", "out/a.####.png", "--no-denoise", "--no-tonemap", "--exposure",
              mode, "--explain", "--device", "cpu"])
    return found.getvalue()


def test_an_exposure_in_the_pixels_is_called_so_in_the_header(told, tmp_path: Path) -> None:
    used, _ = told("-o", "out/a.####.exr", "--display", "srgb")
    header = oiio.ImageBuf(str(tmp_path / "out/a.0001.exr")).spec()
    applied = header.getattribute("postfx:exposureAppliedEV")
    assert 2.0**applied == pytest.approx(used["exposure"]["multipliers"]["1"])
    assert not header.getattribute("postfx:exposureUsedEV")


def test_a_second_run_takes_the_exposure_of_the_first(write_exr, tmp_path: Path, monkeypatch,
                                                      capsys) -> None:
    monkeypatch.chdir(tmp_path)
    for number in (1, 2):
        write_exr(f"in/shot.{number:04d}.exr",
                  dict(zip("RGB", np.moveaxis(picture(4.0), -1, 0), strict=True)))
    common = ["--device", "cpu", "--json", "--model", "s", "--run-up", "0"]
    assert main(["run", "in/", "-o", "clean/", "--scale", "1", *common]) == 0
    first = json.loads(capsys.readouterr().out)["exposure"]
    header = oiio.ImageBuf("clean/shot.0001.exr").spec()
    assert (header.getattribute("postfx:exposureUsedEV") == pytest.approx(4, abs=0.03)
            and not first["applied"])
    picture_run = ["run", "clean/", "-o", "p.####.png", "--no-denoise", "--no-tonemap",
                   "--overwrite", "--json"]
    assert main([*picture_run, "--exposure", "metadata"]) == 0
    assert json.loads(capsys.readouterr()
                      .out)["exposure"]["multipliers"] == pytest.approx(first["multipliers"])
    assert main([*picture_run, "--exposure", "lit"]) == 0
    assert json.loads(capsys.readouterr().out)["exposure"]["ev"] == [0, 0]


def test_the_environment_draws_the_checkerboard_in_a_run(postfx, grey, tmp_path: Path,
                                                         monkeypatch) -> None:
    monkeypatch.setenv("POSTFX_EXPOSURE_TOOL", "1")
    grey(EV, EV)
    done = postfx("run", "in/", "-o", "out/b.####.exr", "--exposure", "metadata", "--scale", "2")
    assert done.code == 0 and "a checkerboard covers the picture" in done.err
    board = pixels(tmp_path / "out/b.0002.exr")[..., :3]
    assert board.shape[:2] == (108, 192)  # at output size
    np.testing.assert_allclose(np.unique(board), 0.18 * 2.0 ** np.array([-0.25, 0.25]) / 2**EV,
                               rtol=1e-3)


def test_graded_frames_are_handed_back(grey, tmp_path: Path, monkeypatch, capsys) -> None:
    grey(EV, EV)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("POSTFX_EXPOSURE_TOOL", "1")
    boards = ["run", "in/", "-o", "boards/a.####.exr", "--no-denoise", "--device", "cpu",
              "--exposure", "lit"]
    assert main(boards) == 0
    monkeypatch.delenv("POSTFX_EXPOSURE_TOOL")
    assert main(["exposure", "in/", "--chart", "chart.exr"]) == 0
    # a curve of its own, a stop too bright
    for source in [*Path("boards").glob("*.exr"), Path("chart.exr")]:
        picture = oiio.ImageBuf(str(source))
        light = (picture.get_pixels(oiio.FLOAT)[..., :3] * 2.0 ** picture.spec()
                 .getattribute("postfx:exposureUsedEV"))
        codes = np.clip(np.log2(1 + light * (2 if source.stem != "chart" else 1) * 9) / 8, 0, 1)
        oiio.ImageBuf(codes.astype(np.float32)).write(f"{source.stem}.png", oiio.UINT8)
    capsys.readouterr()
    words = ["exposure", "in/", "--exposure", "lit", "--graded", "a.####.png", "--json", "--device",
             "cpu"]
    assert main([*words, "--response", "chart.png"]) == 1
    report = json.loads(capsys.readouterr().out)
    assert report["read_by"] == "its own" and report["graded"] == "a.####.png"
    assert report["shots"][0]["mismatch_ev"] == pytest.approx(1, abs=0.05)
    assert main([*words[:-3], "--frames", "1-2", "--response", "chart.png"]) == 1
    assert "read by  the curve in chart.png" in capsys.readouterr().out
    Path("a.0002.png").unlink()
    assert main(words) == 2 and "a.0002.png: frame 2 is missing" in capsys.readouterr().err
    assert main(["exposure", "in/", "--response", "chart.png"]) == 2
