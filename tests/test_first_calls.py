"""What a programmer meets first: what objects say of themselves, and slips that are told in one
line."""

from __future__ import annotations

import re
import subprocess
import sys
import warnings
from pathlib import Path

import numpy as np
import pytest

import postfx
from postfx import integrate
from postfx.cli.main import main
from postfx.errors import DeviceError, FrameError, PassOptionError, SequenceError, WriteError

PICTURE = np.zeros((8, 8, 3), np.float32)


def test_objects_say_what_they_are(write_exr, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_exr("shot.0001.exr", {name: np.zeros((8, 8)) for name in "RGB"})
    write_exr("shot.0002.exr", {name: np.zeros((8, 8)) for name in "RGB"})
    denoise = postfx.DenoiseUpscale(model="s")
    assert repr(denoise) == "DenoiseUpscale(model='s')" and repr(postfx.ToneMap()) == "ToneMap()"
    device = postfx.Device("cpu", threads=1)
    pipeline = postfx.Pipeline([denoise, postfx.ToneMap(look="agx")], device=device)
    passes = "DenoiseUpscale(model='s'), ToneMap(look='agx')"
    assert repr(pipeline) == f"Pipeline([{passes}], device=Device('cpu', threads=1))"
    assert repr(postfx.read_sequence("shot.####.exr")) == "Sequence('shot.####.exr', frames='1-2')"


@pytest.mark.parametrize(("passes", "said"), [
    (PICTURE, "a pipeline takes passes, not numpy.ndarray: give a list"),
    (postfx.DenoiseUpscale(model="s"), r"Pipeline\(\[DenoiseUpscale\(model='s'\)\]\)"),
    (["denoise"], "a pipeline takes passes, not str: give a list"),
    (None, "a pipeline takes passes, not NoneType: give a list"),
])
def test_a_pipeline_of_something_else_is_refused_in_one_line(passes, said):
    with pytest.raises(PassOptionError, match=said):
        postfx.Pipeline(passes)


@pytest.mark.parametrize(("options", "said"), [
    ({"scale": [2]}, r"scale \[2\]: give a number from 1 to 3"), ({"model": ["m"]}, "no network"),
    ({"strength": np.ones(2)}, "give a number"), ({"exposure": None}, "exposure 'None': use auto"),
    ({"exposure": [1]}, r"exposure '\[1\]': use auto"), ({"device": False}, "no device 'False'"),
    ({"device": ["cpu"]}, "no device")])
def test_options_of_other_types_are_refused_in_one_line(options, said):
    with pytest.raises(postfx.PostfxError, match=said):
        postfx.denoise(PICTURE, **options)


@pytest.mark.parametrize("device", [0, False, ["cpu"]])
def test_a_pipeline_runs_on_a_device(device):
    with pytest.raises(DeviceError, match="runs on a device, not on .*: give its name"):
        postfx.Pipeline([postfx.ToneMap()], device)


@pytest.mark.parametrize("kind", [postfx.RunUp, postfx.Backwards])
def test_what_looks_ahead_takes_a_sequence(kind):
    with pytest.raises(SequenceError, match="takes a postfx.Sequence, not str: give read_sequ"):
        kind("shot.####.exr")


def test_a_word_that_is_no_role_is_told_with_the_one_that_is_meant(write_exr, tmp_path):
    write_exr("shot.0001.exr", {name: np.zeros((8, 8)) for name in "RGB"})
    shot = postfx.read_sequence(str(tmp_path / "shot.####.exr"))
    for call in (lambda: shot.read(1, ["colur"]), lambda: shot.read(1, guides=["colur"]),
                 lambda: postfx.FrameSpec(8, 8, ["colur"]),
                 lambda: postfx.Frame({"colur": PICTURE}),
                 lambda: postfx.read_sequence(str(tmp_path), without=["colur"])):
        with pytest.raises(FrameError, match="'colur'.* has no meaning here: did you mean colour"):
            call()


def test_a_pipeline_is_called_with_a_frame():
    pipeline = postfx.Pipeline([postfx.ToneMap()])
    with pytest.raises(FrameError,
                       match=r"takes a postfx.Frame, not numpy.ndarray: give Frame\(\{'colour': "
                       r"array\}\)"):
        pipeline(PICTURE)
    assert pipeline(postfx.Frame({"color": PICTURE}))["colour"].shape == PICTURE.shape


@pytest.mark.parametrize(("given", "kind"), [
    (("out.exr", PICTURE), "ndarray"),
    ((postfx.Frame({"color": PICTURE}), "out.exr"), "str"),
])
def test_what_is_written_is_a_frame(given, kind):
    with pytest.raises(FrameError, match=f"takes a path and a postfx.Frame, not {kind}: "):
        postfx.write_frame(*given)


def test_a_picture_without_a_look_is_told_once_with_the_way_to_one(tmp_path):
    dark = postfx.Frame({"color": np.full((8, 8, 3), 0.02, np.float32)})
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("default")
        for number in range(3):
            postfx.write_frame(tmp_path / f"dark.{number}.png", dark)
    text = str(told[0].message)
    assert len(told) == 1 and told[0].filename == __file__ and "\n" not in text
    assert "postfx.Pipeline([postfx.ToneMap()])" in text and "encoding='display-linear'" in text


def test_a_picture_with_a_look_or_of_a_display_and_light_in_exr_are_not_told_of(tmp_path):
    dark = postfx.Frame({"color": np.full((8, 8, 3), 0.02, np.float32)})
    shown = postfx.Pipeline([postfx.ToneMap()], "cpu")(dark)
    meant = postfx.Frame(dark.planes, encoding="display-linear")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for name, frame in {"a.png": shown, "b.png": meant, "c.jpg": meant, "d.exr": dark}.items():
            postfx.write_frame(tmp_path / name, frame)
    with pytest.warns(RuntimeWarning, match="without exposure and look"):
        postfx.write_frame(tmp_path / "e.png", dark)
    same, as_before, mapped = ((tmp_path / name).read_bytes()
                               for name in ("b.png", "e.png", "a.png"))
    assert same == as_before != mapped


def test_one_frame_and_a_device_go_by_their_plain_names(write_exr, tmp_path):
    for number in (1, 2):
        write_exr(f"shot.{number:04d}.exr", {name: np.zeros((8, 8)) for name in "RGB"})
    shot = postfx.read_sequence(tmp_path / "shot.####.exr", frames=2)
    assert shot.numbers == (2,)
    by_name = postfx.Pipeline([postfx.ToneMap()], "cpu")
    assert by_name.device.name == "cpu" and by_name(shot.read(2))["color"].shape == (8, 8, 3)
    with pytest.raises(postfx.PostfxError, match="no device 'gpu': use auto, cpu"):
        postfx.Pipeline([postfx.ToneMap()], "gpu")
    with pytest.raises(PassOptionError, match="no option 'sacle': did you mean scale[?] its"):
        postfx.DenoiseUpscale(sacle=2)


def test_a_misspelt_choice_is_told_with_the_one_that_is_meant(write_exr, tmp_path):
    shot = write_exr("shot.0001.exr", {name: np.zeros((8, 8)) for name in "RGB"})
    own = tmp_path / "own.toml"
    own.write_text('[[plane]]\nrole = "norml"\nchannels = ["XYZ"]\n')
    frame = postfx.Frame({"color": PICTURE})
    for meant, call in {
        "generic": lambda: postfx.read_sequence(shot, profile="genric").read(1),
        "normal": lambda: postfx.read_sequence(shot, profile=str(own)).read(1),
        "acescg": lambda: postfx.read_sequence(shot, colourspace="acesgc"),
        "estimate": lambda: postfx.read_sequence(shot, motion="estimat").read(1),
        "reversed": lambda: postfx.read_sequence(shot, depth="revresed").read(1),
        "rec2020": lambda: postfx.Frame({"color": PICTURE}, encoding="rec202").spec,
        "piz": lambda: postfx.write_frame(tmp_path / "out.exr", frame, compression="pizz"),
        ".png": lambda: postfx.write_frame(tmp_path / "out.pgn", frame),
        "static": lambda: postfx.write_frame(tmp_path / "out.png", frame, dither="statik"),
        "difference": lambda: postfx.DenoiseUpscale(reactive="diference"),
    }.items():
        with pytest.raises(postfx.PostfxError, match=f": did you mean {re.escape(meant)}[?] "):
            call()


def test_a_file_in_the_place_of_an_array_is_told_who_reads_it():
    with pytest.raises(FrameError, match="color is str: .*; postfx.read_sequence reads files"):
        postfx.denoise("shot.0001.exr")
    with pytest.raises(PassOptionError, match="scale .xl.: give a number .*; a network is"):
        postfx.DenoiseUpscale("xl")


def test_a_name_that_is_nearly_there_is_hinted_at():
    program = "import postfx\npostfx.read_sequences"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert "has no attribute 'read_sequences'. Did you mean: 'read_sequence'?" in done.stderr


def test_colour_has_either_spelling_everywhere(write_exr, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_exr("shot.0001.exr", {name: np.full((8, 8), 0.1 * k) for k, name in enumerate("BGR", 1)})
    first, second = (postfx.read_sequence("shot.####.exr", **{name: "acescg"}).read(1)["colour"]
                     for name in ("colorspace", "colourspace"))
    plain = postfx.read_sequence("shot.####.exr").read(1)["color"]
    assert np.array_equal(first, second) and not np.array_equal(first, plain)
    base = np.full((2, 2, 3), 0.5)
    for make in (integrate.diffuse_albedo, integrate.f0_of):
        one, other = (make(metallic=np.zeros((2, 2)), **{name: base})
                      for name in ("base_color", "base_colour"))
        assert np.array_equal(one, other)
    assert integrate.exposure_hint(color=base) == integrate.exposure_hint(base)
    with pytest.raises(TypeError, match="colorspace is given in both spellings"):
        postfx.read_sequence("shot.####.exr", colorspace="acescg", colourspace="acescg")
    for flag in ("--colorspace=acescg", "--colourspace=acescg"):
        assert main(["run", "shot.####.exr", "-o", f"{flag[2:8]}.exr", "--no-denoise", flag]) == 0
    assert Path("colors.exr").read_bytes() == Path("colour.exr").read_bytes()


def test_an_argument_that_is_unknown_is_told_with_the_one_that_is_meant():
    with pytest.raises(TypeError, match="read_sequence has no argument 'frame': did you mean fram"):
        postfx.read_sequence("shot.####.exr", frame=1)


@pytest.mark.parametrize("name", ["out/####.exr", "out/clean.%04d.exr"])
def test_a_pattern_is_no_name_of_a_file(tmp_path, name):
    with pytest.raises(WriteError, match="is a pattern, and write_frame writes one file"):
        postfx.write_frame(tmp_path / name, postfx.Frame({"color": PICTURE}))
    assert not (tmp_path / "out").exists()
