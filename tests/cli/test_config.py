"""Presets and the defaults of a studio: what is given wins, then the preset, then postfx.toml."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from postfx.cli.main import main, make_parser
from postfx.cli.run_options import PRESETS
from postfx.errors import OptionError


@pytest.fixture
def places(tmp_path, monkeypatch) -> dict[str, Path]:
    """Folders of the three files, the weakest first; the current one is two below the last."""
    found = {name: tmp_path / name / ("postfx" * (name != "shots"))
             for name in ("machine", "user", "shots")}
    for folder in found.values():
        folder.mkdir(parents=True)
    (found["shots"] / "a" / "b").mkdir(parents=True)
    monkeypatch.delenv("POSTFX_CONFIG", raising=False)
    monkeypatch.setenv("XDG_CONFIG_DIRS", str(tmp_path / "machine"))
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "user"))
    monkeypatch.chdir(found["shots"] / "a" / "b")
    return found


def put(folder: Path, text: str) -> Path:
    path = folder / "postfx.toml"
    path.write_text(f"[run]\n{text}\n")
    return path


def parse(*words: str):
    return make_parser(["run"]).parse_args(["run", "in/", *words])


def test_a_preset_sets_what_is_not_given(places):
    assert (parse("--preset", "preview").model, parse("--preset", "preview").run_up) == ("s", 0)
    final = parse("--preset", "final", "--model", "m")
    assert (final.model, final.both_ways) == ("m", True)
    assert parse("--preset", "final").model == "xl"
    # its default, and given all the same
    steady = parse("--preset", "animation", "--exposure", "auto")
    assert (steady.both_ways, steady.exposure) == (True, "auto")


@pytest.mark.parametrize("words", [["--memory", "4G"], ["--budget", "9"], ["--run-up", "3"],
                                   ["--no-denoise"]])
def test_a_preset_gives_way_to_an_option_that_it_does_not_go_with(places, words):
    from postfx.cli.run_options import RUN

    given = parse("--preset", "final", *words)
    assert not given.both_ways
    RUN.refuse_conflicts(given)


def test_a_run_says_what_of_a_preset_gave_way(postfx, shot):
    shot(1)
    given = ("run", "in/shot.####.exr", "--preset", "final", "--explain")
    assert ("skips   --both-ways --with auto of --preset final: other options that are given do "
            "not go with it") in postfx(*given, "--memory", "4G").out
    assert "of --preset" not in postfx(*given, "--model", "m", "--with", "none").out


def test_files_are_weaker_the_farther_away_they_are(places):
    put(places["machine"], 'model = "s"\ncompression = "piz"\nbits = 32')
    put(places["user"], 'compression = "dwaa:45"\nbits = 16\noverwrite = true')
    put(places["shots"], 'bits = 32\nsize = "640x360"\npass = ["grain", "vignette,amount=0.5"]')
    given = parse()
    assert (given.model, given.compression, given.bits) == ("s", "dwaa:45", 32)
    assert (given.overwrite, given.size,
            getattr(given, "pass")) == (True, (640, 360), ["grain", "vignette,amount=0.5"])
    given = parse("--model", "l", "--skip-existing", "--scale", "1.5", "--pass", "mine")
    assert (given.model, given.skip_existing, given.overwrite) == ("l", True, False)
    assert (given.scale, given.size, getattr(given, "pass")) == (1.5, None, ["mine"])


def test_a_preset_on_the_command_line_is_stronger_than_a_file_and_one_in_a_file_weaker(places):
    put(places["shots"], 'model = "m"\npreset = "preview"')
    assert (parse().model, parse().run_up) == ("m", 0)
    assert parse("--preset", "preview").model == "s"


def test_the_variable_names_the_only_file(places, tmp_path, monkeypatch):
    put(places["shots"], 'model = "s"')
    monkeypatch.setenv("POSTFX_CONFIG", str(put(tmp_path, 'model = "l"')))
    assert parse().model == "l"
    monkeypatch.setenv("POSTFX_CONFIG", "")
    assert parse().model is None
    monkeypatch.setenv("POSTFX_CONFIG", str(tmp_path / "gone.toml"))
    with pytest.raises(OptionError,
                       match="gone.toml: POSTFX_CONFIG names this file, which is not there"):
        parse()


@pytest.mark.parametrize(("text", "told"), [
    ('modle = "s"', "modle is no option: did you mean model?"),
    ('output = "x"', "output belongs on the command line"),
    ('provider = "OpenVINO"', "provider belongs on the command line"),
    ('on-error = "skp"', "on-error: no choice 'skp': did you mean skip? give stop, skip, copy"),
    ('preset = "finall"', "preset: no choice 'finall': did you mean final? give preview, final"),
    ("bits = -1", "bits: '-1' is not a whole number from 1"),
    ('scale = "large"', "scale: 'large' is not a number"),
    ('both-ways = "yes"', "both-ways: 'yes' is neither true nor false"),
    ("threads = true", "threads: give one number or text"),
    ("model = ", "cannot be read: Invalid value"),
    ("[rum]\nmodel = 1", "no table 'rum': options of 'postfx run' stand below [run]"),
])
def test_what_a_file_must_not_hold_is_one_clear_line(places, capsys, text, told):
    path = put(places["shots"], text)
    assert main(["run", "in/", "-o", "out/"]) == 2
    said = capsys.readouterr().err
    assert said.startswith(f"error: {path}: {told}") and said.count("\n") == 1


def test_config_shows_every_default_and_where_it_is_from(places, capsys):
    assert main(["config"]) == 0
    assert str(places["user"] / "postfx.toml") in capsys.readouterr().out
    put(places["user"], 'compression = "piz"\ntonemap = true')
    near = put(places["shots"], 'compression = "zips"\nboth_ways = true')
    assert main(["config", "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)
    assert facts["files"] == [str(places["user"] / "postfx.toml"), str(near)]
    assert (facts["run"]["compression"] == {"value": "zips", "file": str(near)}
            and facts["presets"] == PRESETS)
    assert main(["config"]) == 0
    said = capsys.readouterr().out
    assert (f"default  --both-ways     from {near}" in said and "preset   preview: --model s "
            "--run-up 0" in said)


def test_chunks_carry_the_defaults_to_machines_that_do_not_have_them(places, shot, monkeypatch,
                                                                     capsys, tmp_path):
    shot(1, 2)
    monkeypatch.chdir(tmp_path)
    put(tmp_path, 'compression = "dwaa:45"\nboth-ways = true\npass = ["a", "b"]')
    assert (main(["chunks", "in/", "-o", "out/", "--size", "2", "--json", "--", "--memory", "4G"])
            == 0)
    (chunk,) = json.loads(capsys.readouterr().out)["chunks"]
    # without --both-ways, which excludes --memory
    defaults = ["--pass=a", "--pass=b", "--compression=dwaa:45"]
    assert chunk["command"] == ["postfx", "run", "in/", "-o", "out/", "--memory", "4G", *defaults,
                                "--preroll", "auto", "--skip-existing", "--frames=1-2"]


def test_a_preview_leaves_out_defaults_that_need_all_frames(places, shot, monkeypatch, capsys,
                                                            tmp_path):
    shot(1)
    monkeypatch.chdir(tmp_path)
    put(tmp_path, 'preset = "animation"\nbits = 32')
    watch = ["watch", "in/", "-o", "preview/", "--until", "1", "--settle", "0"]
    assert main(watch) == 0 and (tmp_path / "preview" / "shot.0001.exr").is_file()
    capsys.readouterr()
    assert main([*watch, "--", "--both-ways"]) == 2
    assert "--both-ways needs all frames" in capsys.readouterr().err


def test_a_dry_run_checks_all_and_writes_nothing(shot, tmp_path, monkeypatch, capsys):
    shot(1, 2, 3)
    monkeypatch.chdir(tmp_path)
    run = ["run", "in/", "-o", "out/p.####.png", "--device", "cpu", "--dry-run"]
    assert main(run) == 0
    said = capsys.readouterr().out
    assert ("writes  out/p.0001.png ... out/p.0003.png: 3 "
            "files\n" in said and not (tmp_path / "out").exists())
    (tmp_path / "out").mkdir()
    (tmp_path / "out/p.0002.png").touch()
    assert main(run) == 2 and "out/p.0002.png: is already there" in capsys.readouterr().err
    assert main([*run, "--overwrite", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["outputs"] == [f"out/p.000{number}.png"
                                                              for number in (1, 2, 3)]
    assert main([*run, "--skip-existing"]) == 0
    assert "3 files; 1 there already, kept if they are whole" in capsys.readouterr().out
    assert ((tmp_path / "out/p.0002.png").stat().st_size == 0
            and len(list((tmp_path / "out").iterdir())) == 1)


def test_quiet_prints_warnings_alone_and_verbose_each_pass(shot, tmp_path, monkeypatch, capsys):
    shot(1, 2)
    monkeypatch.chdir(tmp_path)
    run = ["run", "in/", "-o", "out/p.####.png", "--device", "cpu", "--exposure", "0",
           "--overwrite"]
    assert main([*run, "-q"]) == 0
    lines = capsys.readouterr().err.splitlines()
    assert lines and all(line.startswith("warning  ") for line in lines)
    (tmp_path / "in/shot.0002.exr").write_bytes(b"broken")
    assert main([*run, "-q", "--on-error", "skip"]) == 3
    said = capsys.readouterr().err
    assert said.startswith("failed   1 frame: 1 left out") and "frames/s" not in said
    assert main([*run, "-v", "--frames", "1"]) == 0
    said = capsys.readouterr().err
    assert ("\npass 1  denoise_upscale" in said and "frame 1: "
            "denoise_upscale " in said and "exposure +0.00 EV" in said)
    assert "?" not in said


def test_a_byte_order_mark_is_no_part_of_the_file(places):
    (places["shots"] / "postfx.toml").write_bytes(b'\xef\xbb\xbf[run]\r\nmodel = "s"\r\n')
    assert parse().model == "s"


@pytest.mark.parametrize("text", ["[" * 3000, "model = " + "[" * 3000, "a" + ".a" * 50000 + " = 1",
                                  "model = " + "{a=" * 3000])
def test_a_file_that_is_nested_without_end_is_refused_in_one_line(places, capsys, text):
    (places["shots"] / "postfx.toml").write_text(text)
    assert main(["config"]) == 2
    told = capsys.readouterr().err
    assert told.count("\n") == 1 and "postfx.toml: cannot be read: " in told


def test_a_run_says_which_defaults_it_takes_from_files(places, capsys):
    path = put(places["shots"], 'model = "s"')
    assert main(["run", "in/", "-o", "out/", "--dry-run"]) == 2  # there is no such input
    assert f"defaults --model=s from {path}" in capsys.readouterr().err
