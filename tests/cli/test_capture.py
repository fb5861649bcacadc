"""`postfx run --capture` and `postfx capture-compare`."""

import json

import pytest

from postfx.runtime import CommandError, Device
from postfx.tools.report.page import FrameCapture

RUN = ("run", "in/shot.####.exr", "-o", "out/shot.####.exr", "--no-denoise", "--tonemap", "local",
       "--device", "cpu")


def commands_of(folder):
    return json.loads((folder / "capture.json").read_text())["commands"]


def test_the_second_frame_is_captured_and_the_output_is_the_same(postfx, shot, tmp_path):
    shot(1, 2, 3)
    done = postfx(*RUN, "--capture", "look", "--json")
    assert done.code == 0 and done.json["capture"] == "look/capture.html"
    assert "capture  look/capture.html" in done.err
    assert "<title>postfx capture: frame 2</title>" in (tmp_path / "look/capture.html").read_text()
    assert [command["label"] for command in commands_of(tmp_path / "look")][0] == "tonemap/lowres"
    written = [(tmp_path / f"out/shot.000{n}.exr").read_bytes() for n in (1, 2, 3)]
    again = postfx(*RUN, "--overwrite", "--json")
    assert "capture" not in again.json
    assert written == [(tmp_path / f"out/shot.000{n}.exr").read_bytes() for n in (1, 2, 3)]


def test_the_only_frame_and_a_chosen_one(postfx, shot, tmp_path):
    shot(7, 8, 9)
    assert postfx(*RUN, "--frames", "8", "--capture", "one").code == 0
    assert "frame 8" in (tmp_path / "one/capture.html").read_text()
    assert postfx(*RUN, "--overwrite", "--capture", "two", "--capture-frame", "9").code == 0
    assert "capture: frame 9<" in (tmp_path / "two/capture.html").read_text()


def test_errors_before_anything_runs(postfx, shot, tmp_path):
    shot(1, 2)
    (tmp_path / "file").write_text("in the way")
    done = postfx(*RUN, "--capture", "file")
    assert done.code == 2 and "error: capture folder 'file' cannot be written" in done.err
    done = postfx(*RUN, "--capture", "look", "--capture-frame", "5")
    assert done.code == 2 and "error: frame 5 of --capture-frame is not processed" in done.err
    done = postfx(*RUN, "--capture-frame", "1")
    assert done.code == 2 and "need --capture DIR" in done.err
    done = postfx(*RUN, "--capture", "look", "--capture-network", "--capture-tensors", "none")
    assert (done.code == 2 and "error: a capture of networks (network=True, --capture-network) "
            "cannot keep" in done.err)
    assert not (tmp_path / "out").exists() or not list((tmp_path / "out").iterdir())


def test_networks_are_looked_into_on_request(postfx, shot, tmp_path):
    shot(1)
    assert postfx(*RUN, "--capture", "look", "--capture-network").code == 0
    (network,) = [command["network"]
                  for command in commands_of(tmp_path / "look") if command["network"]]
    assert len(network["nodes"]) > 50 and network["difference"] < 1e-3
    assert all(node["ms"] > 0 and node["outputs"][0]["statistics"] for node in network["nodes"])
    assert postfx(*RUN, "--overwrite", "--capture", "plain").code == 0
    assert not any(command["network"] for command in commands_of(tmp_path / "plain"))


def test_explain_captures_nothing(postfx, shot, tmp_path):
    shot(1)
    assert postfx(*RUN, "--capture", "look", "--explain").code == 0
    assert not (tmp_path / "look").exists()


def test_a_frame_that_fails_is_captured_too(tmp_path):
    capture = FrameCapture(Device("cpu"), str(tmp_path))
    capture.choose([4, 5, 6])
    with capture.around(4):
        pass
    assert capture.page is None
    with pytest.raises(CommandError), capture.around(5):
        raise CommandError("it failed", "label")
    assert capture.page == str(tmp_path / "capture.html") and commands_of(tmp_path) == []


@pytest.fixture
def captures(postfx, shot):
    shot(1, 2)
    for folder, exposure in (("a", "0"), ("b", "0"), ("c", "1")):
        options = ("--capture", folder, "--capture-tensors", "all", "--exposure", exposure,
                   "--overwrite")
        assert postfx(*RUN, *options).code == 0


def test_compare_names_the_first_tensor_that_differs(postfx, captures):
    same = postfx("capture-compare", "a", "b/capture.json", "--tolerance", "0")
    assert same.code == 0 and "equal: no tensor differs by more than 0" in same.out
    other = postfx("capture-compare", "c", "a")
    assert other.code == 1
    assert ("first difference over 0.001: 'tonemap params' read from outside by command 0 "
            "'tonemap/lowres'" in other.out)
    found = postfx("capture-compare", "c", "a", "--json")
    assert found.code == 1 and found.json["first"]["tensor"] == "tonemap params"
    assert found.json["first"]["error"] == pytest.approx(1.0)


def test_compare_needs_captures_with_content(postfx, captures, tmp_path):
    done = postfx("capture-compare", "a", "missing")
    assert done.code == 2 and "error: capture 'missing' cannot be read" in done.err
    assert postfx(*RUN, "--capture", "small", "--overwrite").code == 0
    done = postfx("capture-compare", "a", "small")
    assert done.code == 2 and "--capture-tensors all" in done.err
    done = postfx("capture-compare", "a", "b", "--tolerance", "-1")
    assert done.code == 2 and "is not a number from 0" in done.err
