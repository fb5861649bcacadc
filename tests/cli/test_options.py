"""Options of `postfx run`: each is declared once, and everything else follows from that."""

from __future__ import annotations

import argparse
import inspect
import json
from pathlib import Path

import pytest

from postfx.cli.main import main, make_parser
from postfx.cli.options import Option, Section
from postfx.cli.report import RunReport
from postfx.cli.run_options import RUN
from postfx.cli.summary import warn_of_budget
from postfx.errors import ModelError
from postfx.io.read_options import ReadOptions
from postfx.io.writer import write_frame
from postfx.passes.denoise import DenoiseUpscale
from postfx.passes.display import make_display_passes
from postfx.runs.run import Options
from postfx.runtime import Device, Library
from postfx.tools.report.page import FrameCapture

ROOM = Path(__file__).resolve().parents[2] / "samples" / "room"
PARTS = {"device": Device, "sequence": ReadOptions, "look": make_display_passes,
         "writer": write_frame, "run": Options, "page": RunReport, "capture": FrameCapture}


def parse(*words: str) -> argparse.Namespace:
    return make_parser().parse_args(["run", "in/", "-o", "out/", *words])


@pytest.fixture
def sharpen(monkeypatch) -> Option:
    """An option that is declared and nothing else."""
    option = Option(
        flag="--sharpen", metavar="S", type=float, sets="denoiser.strength",
        convert=lambda sharpen: 1 - sharpen,
        excludes={"--no-denoise": "{flag} is for the denoiser: leave --no-denoise out",
                  "--keep=none": "keep it"},
        help="how sharp",
    )
    monkeypatch.setattr(RUN, "sections", (*RUN.sections, Section("more", (option,))))
    return option


def test_an_option_declared_in_one_place_is_in_the_help(sharpen, capsys):
    with pytest.raises(SystemExit):
        main(["run", "--help-all"])
    assert capsys.readouterr().out.count("more:\n  --sharpen S  ") == 1


def test_an_option_declared_in_one_place_reaches_its_pass_and_the_files(sharpen, shot, tmp_path,
                                                                        monkeypatch, capsys):
    shot(1)
    monkeypatch.chdir(tmp_path)
    run = ["run", "in/", "-o", "out/", "--device", "cpu", "--exposure", "0"]
    assert main([*run, "--sharpen", "1"]) == 0
    (facts,) = json.loads((tmp_path / "out/postfx.manifest.json").read_text())["runs"].values()
    assert (facts["settings"]["sharpen"] == 1.0
            and facts["passes"]["denoise_upscale"]["strength"] == 0.0)
    assert main([*run, "--sharpen", "1", "--skip-existing"]) == 0
    assert "other settings" not in capsys.readouterr().err
    assert main([*run, "--skip-existing"]) == 0
    assert ("kept, though made with other settings, models or versions: frames 1; --overwrite"
            in capsys.readouterr().err)


@pytest.mark.parametrize(("words", "message"), [
    (("--sharpen", "1", "--no-denoise"), "--sharpen is for the denoiser: leave --no-denoise out"),
    (("--sharpen", "1", "--keep", "none"), "keep it"),
])
def test_an_option_declared_in_one_place_is_refused_beside_others(sharpen, capsys, words, message):
    assert main(["run", "in/", "-o", "out/", *words]) == 2
    assert capsys.readouterr().err == f"error: {message}\n"


def test_settings_are_those_that_change_pixels():
    given = parse("--run-up", "3", "--memory", "4G", "--preroll", "2", "--log", "log")
    settings = RUN.settings(given)
    assert (settings["run_up"] == 3 and settings["input"] == "in/"
            and settings["overlay"] == "composite")
    assert (not {"output", "memory", "preroll", "log", "execute", "capture", "on_error"}
            & set(settings))
    assert RUN.settings(given, "rounding") == {"memory": "4G", "provider": None}
    assert len(RUN.settings(given)) + len(RUN.settings(given, "nothing")) + 2 == len(list(RUN))


def test_what_is_not_given_is_left_to_the_part():
    assert RUN.values_for("denoiser", parse()) == {}
    assert RUN.values_for("denoiser", parse("--scale", "1.5", "--model", "s")) == {"scale": 1.5,
                                                                                   "model": "s"}
    for names, layers, error in (("key,error", "key", True), ("error", None, True),
                                 ("auto", "auto", False)):
        given = parse("--aov", names)
        assert RUN.values_for("sequence", given)["aov"] == layers
        assert RUN.values_for("denoiser", given) == {"error": error}
    assert RUN.values_for("run", parse("--checkpoint", "none")) == {"checkpoint": None,
                                                                    "rerun": None}
    assert RUN.values_for("run", parse("--resume", "4")) == {"checkpoint": 30.0, "rerun": 4}


@pytest.mark.parametrize("option", list(RUN), ids=lambda option: option.name)
def test_options_name_what_there_is(option):
    for sets in (option.sets, *option.also):
        part, _, parameter = sets.partition(".")
        if part == "denoiser":
            assert parameter in DenoiseUpscale().options
        elif part:
            assert parameter in inspect.signature(PARTS[part]).parameters
    flags = {each.flag for each in RUN}
    assert {key.partition("=")[0] for key in (*option.excludes, *option.needs)} <= flags


@pytest.mark.parametrize(("words", "told"), [
    (["run", "in/", "--exposre", "1"],
     "unrecognized arguments: --exposre 1: did you mean --exposure?"),
    (["run", "in/", "--no-denoize"], "did you mean --no-denoise?"),
    (["exposure", "in/", "--refrence=0"], "did you mean --reference?"),
    (["rnu", "in/"], "did you mean run?"), (["shot/a.exr"], "did you mean postfx run shot/a.exr?"),
    (["run", "in/", "--qqq"],
     "error: unrecognized arguments: --qqq ('postfx run --help-all' shows all)\n"),
    (["run", "in/", "--frames", "-10-20"],
     "expected one argument; a value that begins with a dash is given as --frames=VALUE"),
    (["run", "in/", "--on-error", "skp"],
     "--on-error: no choice 'skp': did you mean skip? give stop, skip, copy"),
    (["run", "in/", "--preset", "finall"],
     "--preset: no choice 'finall': did you mean final? give preview, final, animation"),
    (["run", "in/", "--preset", "qqq"], "no choice 'qqq': give preview, final, animation"),
    (["lut", "in.exr", "--size", "34"], "--size: no choice '34': give 17, 33, 65"),
])
def test_mistyped_options_and_verbs(words, told, capsys):
    with pytest.raises(SystemExit) as ended:
        main(words)
    shown = capsys.readouterr().err
    assert ended.value.code == 2 and told in shown and shown.count("\n") == 1


@pytest.mark.parametrize(("name", "meant"), [("denoise_upscale.smal", "s"),
                                             ("denoise_upscale.m.fp3", "m.fp16"),
                                             ("tonemap.acse2", "aces2"), ("tonemap.aces", "aces2")])
def test_mistyped_models(name, meant):
    with pytest.raises(ModelError, match=f"did you mean {meant}? there are".replace("?", r"\?")):
        Library().path(name)


def test_a_mistyped_model_is_told_before_anything_is_done(tmp_path, capsys):
    for words, told in (["--model", "mm"], "did you mean m?"), (["--tonemap", "acess"],
                                                                "did you mean aces2?"):
        assert main(["run", str(ROOM / "noisy.####.exr"), "-o",
                     str(tmp_path / "out" / "a.####.png"), *words]) == 2
        shown = capsys.readouterr().err
        assert told in shown and shown.count("\n") == 1 and not (tmp_path / "out").exists()


def test_denoising_only_is_one_flag():
    for words in (["--denoise-only"], ["--denoise"], ["--scale", "1"]):
        assert RUN.values_for("denoiser", parse(*words))["scale"] == 1.0
    assert "scale" not in RUN.values_for("denoiser", parse())
    with pytest.raises(SystemExit):
        parse("--denoise-only", "--scale", "2")


def test_a_budget_that_is_missed_is_told():
    times = {"denoise_upscale": [120.0, 80.0, 131.0]}
    (told,) = warn_of_budget(90, times, {"denoise_upscale": {"s": 3}})
    assert told == ("--budget 90 was missed by 2 of 3 frames: denoising took 120 ms a frame with "
                    "s: take a smaller --model or output, or allow 140")
    assert warn_of_budget(125, times,
                          {}) == warn_of_budget(None, times, {}) == warn_of_budget(1, {}, {}) == []
