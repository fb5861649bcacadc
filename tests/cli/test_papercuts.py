"""Small things that cost trust: each message says what is wrong, and nothing stops frames from
being written."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from postfx.cli.main import main
from postfx.cli.summary import FrameProgress

RUN = ("run", "in/shot.####.exr", "-o", "out/shot.####.exr", "--device", "cpu")
QUICK = ("--no-denoise", "--tonemap")


@pytest.fixture
def here(shot, tmp_path, monkeypatch) -> Path:
    shot(1, 2, 3)
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.parametrize(("words", "said"), [
    (("--model", "x"), "give s, m, l, xl, classic or FILE.onnx; 'postfx models' lists all"),
    (("--memory", "4"), "memory budget '4' has no unit: give 4G for gigabytes"),
    (("--scale", "9"), "scale 9: give a number from 1 to 3"),
    (("--frames", "100-200"),
     "there are frames 1-3, none of 100-200: give --frames that are there"),
    (("--model", "XL"), "did you mean xl? give s, m, l"),
    (("--model", "large"), "did you mean l? give s, m, l"),
    (("--model", "x"), "no network 'x': did you mean xl?"),
    (("--with", "optix"), "--with optix: give oidn, auto, none or a pass of your own"),
    (("--with", "oidm"), "--with oidm: did you mean oidn? give oidn"),
    (("--live", "viewer"), "--live 'viewer': give tev, tev:HOST or tev:HOST:PORT"),
    (("--report", "in/shot.0001.exr/report.html"), "cannot be written"),
    (("--strength", "2"), "strength 2: give a number from 0 to 1"),
    (("--compression", "zip9"), "--compression zip9: did you mean zip? use one of none, rle"),
    (("--bits", "8"), "cannot have 8 bits: EXR has 16 or 32"),
])
def test_a_wrong_value_is_told_before_files_that_are_there(here, capsys, words, said):
    assert main([*RUN, *QUICK]) == 0
    capsys.readouterr()
    assert main([*RUN, *words]) == 2
    told = capsys.readouterr().err
    assert (said in told and "already there" not in told and told.count("\n") == 1
            and len(told) < 250)


def test_frames_of_another_network_are_told_before_the_work(here, capsys):
    assert main([*RUN, "--model", "s", "--frames", "1-2"]) == 0
    capsys.readouterr()
    assert main([*RUN, "--model", "m", "--skip-existing"]) == 0
    told = capsys.readouterr().err
    line = ("warning  kept, though made with other settings, models or versions: frames 1-2; "
            "--overwrite makes them again\n")
    assert told.count(line) == 1 and told.index(line) < told.index("out/shot.0003.exr (")


@pytest.mark.parametrize(("words", "said"), [
    (("denoise", "in/", "-o", "out/"), "did you mean postfx run?"),
    (("upscale", "in/"), "did you mean postfx run with --scale 2?"),
    (("check", "in/"), "did you mean postfx inspect?"),
    (("help",), "did you mean postfx --help?"),
    (("rum", "in/"), "there is no command 'rum': did you mean run? ('postfx --help' shows all)"),
    (("version",), "did you mean postfx --version?"),
    ((*RUN, "--gpu"), "did you mean --device cuda?"),
    ((*RUN, "--look", "agx"), "did you mean --tonemap?"),
    (("inspect", "in/", "--upscale", "2"), "unrecognized arguments: --upscale 2 ("),
    ((*RUN, "--scale", "2x"), "'2x' is not a number like 2 or 1.5"),
])
def test_words_of_other_programs_are_understood(here, capsys, words, said):
    with pytest.raises(SystemExit) as ended:
        main(words)
    told = capsys.readouterr().err
    assert ended.value.code == 2 and said in told and told.count("\n") == 1


@pytest.mark.parametrize(("words", "said"), [
    (("run", "in/shot.####.exr", "out/shot.####.exr"), "takes the output behind -o"),
    (("run", "in/shot.####.exr", "\u2013o", "out/"), "begins with a long dash: type - or --"),
    (("run", "in/", "-o", "out/shot.*.exr"), "write # for each digit of the frame's number"),
    (("run", "in/shot.0001.exr", "-o", "out/shot.?.exr"), "'?' finds files, it names none"),
    (("run", "in/", "-o", "-"), "not to standard output: write it like out/clean.####.exr"),
    (("capture-compare", "a", "b"), "capture 'a' cannot be read: No such file or directory: give"),
])
def test_a_slip_is_told_with_the_way_out(here, capsys, words, said):
    assert main(words) == 2
    told = capsys.readouterr().err
    assert said in told and told.count("\n") == 1 and not (here / "out").exists()


def test_the_command_alone_shows_its_help(capsys):
    assert main([]) == 2
    assert "'postfx COMMAND --help' explains a command" in capsys.readouterr().err


def test_what_one_frame_took_leaves_out_the_frames_before_it(here, write_exr, capsys):
    picture = {name: np.full((180, 320), 0.5) for name in ("R", "G", "B")}
    still = {f"motion.{axis}": np.zeros((180, 320)) for axis in "XY"}
    for number in range(1, 9):
        write_exr(f"in/still.{number:04d}.exr", {**picture, **still})
    assert main(["run", "in/still.0001.exr", "-o", "out/a.exr", "--device", "cpu", "--json",
                 "--model", "m"]) == 0
    report = json.loads(capsys.readouterr().out)
    ahead = report["run_up"]
    assert ahead["frames"] == 7
    assert report["ms_per_frame"]["max"] < ahead["frames"] * ahead["ms_per_frame"]["median"]


@pytest.mark.parametrize("frames", ["0", "4", "9-12"])
@pytest.mark.parametrize("more", [(), ("--explain",), ("--dry-run",), ("--on-error", "skip")])
def test_frames_that_are_not_there_are_told_which_are(here, capsys, frames, more):
    assert main([*RUN, "--frames", frames, *more]) == 2
    assert f"there are frames 1-3, none of {frames}: give" in capsys.readouterr().err


@pytest.mark.parametrize(("numbers", "said"),
                         [("2", "1 of 1 frame in "), ("2-3", "2 of 2 frames in ")])
def test_frames_are_counted_in_words(here, capsys, numbers, said):
    assert main([*RUN, *QUICK, "--frames", numbers]) == 0
    assert said in capsys.readouterr().err


@pytest.mark.parametrize(("channels", "said"), [
    (("Z",), "no diffuse albedo or normal: results are blurrier"),
    ((), "no diffuse albedo, normal or depth: results are blurrier"),
])
def test_missing_aovs_are_listed_as_one_writes_them(here, write_exr, capsys, channels, said):
    write_exr("in/a.exr", {name: np.full((32, 48), 0.5) for name in (*"RGB", *channels)})
    assert main(["run", "in/a.exr", "-o", "out/a.exr", "--device", "cpu"]) == 0
    assert said in capsys.readouterr().err


@pytest.mark.parametrize("verb", [RUN, ("interpolate", "in/", "-o", "out/shot.####.exr")])
@pytest.mark.parametrize("name", ["DWAA:60", "Zip"])
def test_a_compression_is_known_however_it_is_written(here, verb, name):
    import OpenImageIO as oiio

    assert main([*verb, *(QUICK[:1] if verb == RUN else ()), "--compression", name]) == 0
    found = oiio.ImageBuf("out/shot.0001.exr").spec().get_string_attribute("compression")
    assert found.startswith(name[:3].lower())


@pytest.mark.parametrize("verb", ["chunks", "watch"])
def test_options_of_run_go_behind_two_dashes(here, capsys, verb):
    with pytest.raises(SystemExit):
        main([verb, "in/", "-o", "out/", "--model", "s"])
    told = capsys.readouterr().err
    assert f"options of 'postfx run' go after --, as in: postfx {verb} ... -- --model s (" in told


def test_chunks_check_the_options_behind_the_dashes(here, capsys):
    for words, said in ((("--model", "x"), "give s, m, l"),
                        (("--scale", "9"), "give a number from 1 to 3")):
        assert main(["chunks", "in/", "-o", "out/", "--", *words]) == 2
        assert said in capsys.readouterr().err


@pytest.mark.parametrize("folder", ["nowhere", "nowhere.v2", "nowhere/", "nowhere/shot.####.exr"])
def test_a_folder_that_is_not_there_is_not_watched(here, capsys, folder):
    assert main(["watch", folder, "-o", "out/"]) == 2
    assert f"{folder}: there is no such folder" in capsys.readouterr().err


def test_interpolation_counts_its_frames(here, capsys):
    assert main(["interpolate", "in/", "-o", "between/"]) == 0
    told = capsys.readouterr().err
    assert "1/5 between/shot.0001.exr (" in told and "5/5 " in told and "frames/s)" in told


def test_one_of_a_thing_is_told_as_one(here, capsys):
    assert main(["interpolate", "in/", "-o", "between/", "--frames", "2-3"]) == 0
    assert "0.5 (2 times)" in capsys.readouterr().out
    (here / "in/shot.0002.exr").unlink()
    assert main(["interpolate", "in/", "-o", "holed/", "--frames", "1-3"]) == 3
    told = capsys.readouterr().out
    assert "2 (1 time)" in told and "left out 3 frames" in told


def test_frames_that_are_kept_stand_together(here, shot, capsys):
    shot(*range(1, 7))
    for frames in ("1-5", "1-6"):
        capsys.readouterr()
        assert main([*RUN, "--no-denoise", "--skip-existing", "--frames", frames]) == 0
    told = capsys.readouterr().err.splitlines()
    likewise = told.index("skipped  2 frames more: likewise")
    assert told[likewise - 1] == "skipped  frame 3: out/shot.0003.exr exists and is complete"
    assert told[likewise + 1].startswith("skipped  AOVs ")


@pytest.mark.parametrize("words", [RUN, ("interpolate", "in/", "-o", "out/")])
def test_what_writing_loses_is_said_once(here, write_exr, capsys, words):
    for number in (1, 2, 3):
        write_exr(f"in/shot.{number:04d}.exr",
                  {name: np.full((32, 48), 1e5 * number) for name in "RGB"})
    assert main([*words, *(("--no-denoise",) if words == RUN else ())]) == 0
    told = capsys.readouterr().err.splitlines()
    said = [line for line in told if "light above 65504 is cut there" in line]
    assert len(set(said)) == 1 and "out/shot.0001.exr" in said[0]


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
@pytest.mark.parametrize("where", ["full", "closed"])
def test_who_does_not_listen_stops_no_frame(here, where):
    command = [sys.executable, "-m", "postfx", *RUN, *QUICK, "--json"]
    if where == "full":
        with open("/dev/full", "w") as full:
            subprocess.run(command, stdout=full, stderr=full, timeout=120)
    else:
        process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
        process.stdout.close()
        process.stderr.close()
        process.wait(120)
    assert len(list((here / "out").glob("shot.*.exr"))) == 3


def test_the_rate_while_frames_are_made_leaves_compiling_out_as_the_last_one_does(capsys,
                                                                                  monkeypatch):
    now = [0.0]
    monkeypatch.setattr("postfx.cli.summary.time.perf_counter", lambda: now[0])
    with FrameProgress(4) as progress:
        progress.start(0)
        now[0] = 12.0
        progress.advance("a.exr", 10.0)
        now[0] = 14.0
        progress.advance("b.exr", 10.0)
    told = capsys.readouterr().err
    assert "1/4 a.exr (0.50 frames/s, 0:00:06 left)" in told
    assert "2/4 b.exr (0.50 frames/s, 0:00:04 left)" in told


def test_the_time_left_is_that_of_frames_alike(capsys, monkeypatch):
    now = [0.0]
    monkeypatch.setattr("postfx.cli.summary.time.perf_counter", lambda: now[0])
    with FrameProgress(3) as progress:
        progress.start(0, others=9)
        now[0] = 10.0
        progress.pass_by(8, 8.0)  # a run-up, once
        progress.advance("a.exr")
        now[0] = 13.0
        progress.pass_by(1, 1.0)
        progress.advance("b.exr")
        now[0] = 15.0
        progress.advance("c.exr")
    told = capsys.readouterr().err
    assert "1/3 a.exr (0.10 frames/s, 0:00:05 left)" in told
    assert "2/3 b.exr (0.15 frames/s, 0:00:02 left)" in told
    assert "3/3 c.exr (0.20 frames/s)" in told
