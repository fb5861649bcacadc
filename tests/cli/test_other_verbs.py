"""Help, version, `postfx inspect` and `postfx models`."""

import json
import subprocess
import sys

import numpy as np

import postfx as library
from postfx.cli.main import main


def test_help_has_examples_for_every_verb(capsys):
    for verb in ("run", "inspect", "exposure", "models", "capture-compare"):
        try:
            main([verb, "--help"])
        except SystemExit as exit:
            assert exit.code == 0
        assert "examples:\n  postfx " + verb in capsys.readouterr().out


def test_help_loads_nothing_heavy():
    code = ("import sys, postfx.cli.main as m; m.make_parser(); print([n for n in sys.modules if n "
            "in HEAVY])")
    heavy = "HEAVY = ('numpy', 'onnxruntime', 'OpenImageIO', 'rich', 'torch')\n"
    done = subprocess.run([sys.executable, "-c", heavy + code], capture_output=True, text=True,
                          check=True)
    assert done.stdout.strip() == "[]"


def test_a_reader_that_has_enough_is_no_error():
    command = [sys.executable, "-m", "postfx", "models"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
                          text=True) as process:
        process.stdout.close()
        assert process.stderr.read() == ""
    assert process.returncode == 0


def test_version(postfx):
    assert postfx("--version").out.strip() == f"postfx {library.__version__}"


def test_inspect_shows_planes_missing_and_values(postfx, shot):
    shot(1, 2, 4)
    done = postfx("inspect", "in/shot.####.exr")
    assert done.code == 1  # planes are missing
    assert "in/shot.####.exr: 4 frames, 1 to 4" in done.out
    assert "profile generic (Generic names), 48x32" in done.out
    assert any(line.split() == ["depth", "depth.Z", "3", "..", "3"]
               for line in done.out.splitlines())
    assert "missing  normal" in done.out
    assert "later" not in done.out  # no renderer makes it
    assert "frames without a file: 3" in done.out


def test_inspect_counts_what_is_not_finite(postfx, write_exr):
    red = np.ones((4, 4), np.float32)
    red[0, 0], red[1, 1] = np.nan, np.inf
    write_exr("a.exr", {"R": red, "G": np.zeros((4, 4)), "B": np.zeros((4, 4)),
                        "depth.Z": np.full((4, 4), 1e10)})
    planes = {plane["role"]: plane
              for plane in json.loads(postfx("inspect", "a.exr", "--json").out)["planes"]}
    assert (planes["colour"]["non_finite"], planes["colour"]["max"]) == (2, 1)
    assert (planes["depth"]["misses"], planes["depth"]["max"]) == (16, None)


def test_inspect_of_nothing(postfx):
    done = postfx("inspect", "nothing.exr")
    assert done.code == 2
    assert done.err == "error: nothing.exr: no such file: check the folder and the frame pattern\n"


def test_a_mistyped_name_is_told_what_there_is(postfx, write_exr):
    write_exr("shot.0001.exr", {name: np.ones((4, 4)) for name in "RGB"})
    assert postfx("inspect", "shto.####.exr").err == (
        "error: shto.####.exr: no such file: its folder holds shot.####.exr\n")
    assert postfx("inspect", "there/shot.####.exr").err == (
        "error: there/shot.####.exr: no such file: there is no folder 'there'\n")
    write_exr("both/shot.0001.exr", {name: np.ones((4, 4)) for name in "RGB"})
    write_exr("both/clean.0001.exr", {name: np.ones((4, 4)) for name in "RGB"})
    assert postfx("inspect", "both").err == (
        "error: both: holds 2 sequences (clean.####.exr, shot.####.exr): name one of them\n")


def test_models_lists_every_model_with_its_card(postfx):
    done = postfx("models", "--json")
    assert done.code == 0
    assert set(done.json) == {path.stem for path in library.models_dir().glob("*.onnx")}


def test_verify_of_a_folder_that_is_not_there(postfx, tmp_path):
    (tmp_path / "there").mkdir()
    for folder, told in (("gone", "no such folder"), ("there", "has no postfx.manifest.json")):
        done = postfx("verify", folder)
        assert done.code == 2 and f"{folder}: {told}" in done.err
