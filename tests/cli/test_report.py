"""`--report` of `postfx run` and `postfx inspect`."""

import json
import re
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

from postfx.errors import ReportError
from postfx.tools.report import frame_log
from postfx.tools.report.frame_log import References

ROOM = Path(__file__).resolve().parents[2] / "samples" / "room"
RUN = ("run", "in/shot.####.exr", "-o", "out/shot.####.exr", "--no-denoise", "--device", "cpu",
       "--overwrite")


def embedded(path):
    text = path.read_text()
    return json.loads(re.search(r'<script type="application/json" id="data">(.*?)</script>', text,
                                re.DOTALL)[1])


def test_a_run_says_where_its_report_is_and_writes_the_same_frames(postfx, shot, tmp_path):
    shot(1, 2, 3)
    assert postfx(*RUN).code == 0
    plain = [(tmp_path / f"out/shot.000{n}.exr").read_bytes() for n in (1, 2, 3)]
    done = postfx(*RUN, "--report", "look/report.html", "--json")
    assert (done.code == 0 and done.json["report"] == "look/report.html" and "report   "
            "look/report.html" in done.err)
    assert plain == [(tmp_path / f"out/shot.000{n}.exr").read_bytes() for n in (1, 2, 3)]
    data = embedded(tmp_path / "look/report.html")
    assert data["numbers"] == [1, 2, 3] and data["run"]["frames"] == 3 and not data["display"]
    assert {"what": "denoise_upscale", "why": "--no-denoise"} in data["run"]["skipped"]
    assert "\nframe   48x32" in data["run"]["plan"]
    # no motion is read
    assert [chart["title"] for chart in data["charts"]] == ["Exposure, EV", "Milliseconds a frame"]
    assert {finding["code"] for finding in data["facts"]["findings"]} >= {"missing-normal"}


def test_tone_mapped_output_is_compared_with_tone_mapped_input(postfx, shot, tmp_path):
    shot(1, 2)
    done = postfx(*RUN, "--tonemap", "--report", "report.html")
    assert done.code == 0, done.err
    data = embedded(tmp_path / "report.html")
    assert data["display"] is True
    assert all(frame["pictures"]["before"] == frame["pictures"]["after"]
               for frame in data["frames"])
    assert data["frames"][0]["pictures"]["after"]["highest"] == 1


def test_frames_that_were_left_out_break_the_curve(postfx, shot, tmp_path):
    shot(*range(1, 7))
    assert postfx(*RUN, "--frames", "3").code == 0
    arguments = [argument for argument in RUN if argument != "--overwrite"]
    assert postfx(*arguments, "--skip-existing", "--preroll", "1", "--report",
                  "report.html").code == 0
    data = embedded(tmp_path / "report.html")
    assert data["numbers"] == [1, 2, 4, 5, 6] and data["cuts"] == [1, 4]


def test_a_run_that_fails_reports_what_it_did(postfx, shot, tmp_path):
    shot(1, 2, 3)
    (tmp_path / "in/shot.0003.exr").write_bytes(b"v/1\x01nothing")
    done = postfx(*RUN, "--report", "report.html")
    assert done.code == 2
    data = embedded(tmp_path / "report.html")
    assert data["numbers"] == [1, 2] and "shot.0003.exr" in data["run"]["error"]


def test_inspect_reports_findings_and_input(postfx, shot, tmp_path):
    shot(1, 2)
    done = postfx("inspect", "in/", "--report", "report.html")
    assert done.code == 1
    data = embedded(tmp_path / "report.html")
    assert (data["run"] is None
            and [list(frame["pictures"]) for frame in data["frames"]] == [["input"]] * 2)
    assert [picture["name"] for picture in data["sheet"]] == ["colour", "depth", "motion"]


def test_values_that_are_not_finite_are_reported(postfx, write_exr, tmp_path):
    planes = {name: np.full((32, 48), np.nan) for name in "RGB"}
    write_exr("in/bad.0001.exr", planes)
    assert postfx("inspect", "in/", "--report", "report.html").code >= 1
    assert postfx("run", "in/", "-o", "out/", "--no-denoise", "--report", "run.html").code == 0
    assert (len(embedded(tmp_path / "report.html")["frames"])
            == len(embedded(tmp_path / "run.html")["frames"]) == 1)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--reference", "in/"), "--reference is for --report FILE.html: give both"),
        (("--report", "file/report.html"), "report folder 'file' cannot be written"),
        (("--report", "in"), "--report in: is a folder: give a file, e.g. in/report.html"),
        (("--report", "r.html", "--memory", "2G"),
         "--report keeps whole frames in memory: leave --memory out"),
        pytest.param(("--report", "r.html", "--reference", "nothing.####.exr"),
                     "nothing.####.exr: no such file",
                     marks=pytest.mark.skipif(find_spec("flip_evaluator") is None,
                                              reason="needs the extra 'bench'")),
    ],
)
def test_errors_before_anything_runs(postfx, shot, tmp_path, arguments, message):
    shot(1)
    (tmp_path / "file").write_text("in the way")
    done = postfx(*RUN, *arguments)
    assert done.code == 2 and message in done.err and done.err.count("\n") == 1
    assert not (tmp_path / "out").exists()


def test_references_must_have_the_output_s_size():
    pytest.importorskip("flip_evaluator")
    with pytest.raises(ReportError,
                       match="references are 640x360, the output 320x180: give them at the size"):
        References(str(ROOM / "reference.####.exr"), (320, 180))
    assert References(str(ROOM / "reference.####.exr"), (640, 360)).colour(99) is None


def test_a_library_that_is_missing_is_named(monkeypatch):
    monkeypatch.setattr(frame_log, "find_spec", lambda name: None)
    with pytest.raises(ReportError,
                       match=r"flip-evaluator is not installed, .* pip install '\.\[bench\]'"):
        References(str(ROOM / "reference.####.exr"), (640, 360))


def test_explain_writes_no_report(postfx, shot, tmp_path):
    shot(1)
    assert postfx(*RUN, "--explain", "--report", "look/report.html").code == 0
    assert not (tmp_path / "look").exists()
