"""The manifest, the log, the header, and what happens when they or the frames cannot be read or
written."""

import json
import os
import shutil
import signal
import subprocess
import time
from pathlib import Path

import OpenImageIO as oiio
import pytest

from postfx import __version__
from postfx.cli.main import main
from postfx.errors import ManifestError
from postfx.runs.manifest import MANIFEST_NAME, MANIFEST_VERSION, Manifest
from tests.reliability.faulty import WRITE

READ = "postfx.io.sequence.Sequence.read"


def test_verify_finds_what_is_wrong(runs):
    assert runs()[0] == 0
    assert runs.verify() == (0, {"well": True, "whole": list(runs.files()), "altered": [],
                                 "missing": [], "unfinished": [], "unknown": [], "differing": [],
                                 "runs": {next(iter(runs.verify()[1]["runs"])): "finished"}})
    (runs.folder / "out.0001.exr").unlink()
    with (runs.folder / "out.0002.exr").open("r+b") as file:
        file.seek(1000)
        file.write(b"\x55")
    shutil.copy(runs.folder / "out.0003.exr", runs.folder / "out.0099.exr")
    (runs.folder / "notes.txt").write_text("not of a run")
    code, found = runs.verify()
    assert code == 1 and not found["well"] and len(found["whole"]) == 6
    assert (found["missing"], found["altered"],
            found["unknown"]) == (["out.0001.exr"], ["out.0002.exr"], ["out.0099.exr"])


def test_verify_in_words(runs, capsys):
    assert runs()[0] == 0
    (runs.folder / "out.0001.exr").unlink()
    assert main(["verify", str(runs.folder)]) == 1
    said = capsys.readouterr().out
    assert "missing    out.0001.exr: was written and is gone" in said
    assert "7 whole, 0 altered, 1 missing, 0 unfinished, 0 unknown" in said


def test_verify_tells_a_killed_run(runs):
    runs.killed(WRITE, 3)
    code, found = runs.verify()
    assert (code == 1 and list(found["runs"].values()) == ["killed"]
            and len(found["unfinished"]) >= 6)


def test_verify_tells_a_run_that_runs(runs):
    process = runs.start([{"at": WRITE, "do": "sleep", "seconds": 0.3}])
    runs.wait_for(process, "frame", 2)
    assert list(runs.verify()[1]["runs"].values()) == ["running"]
    assert process.wait(60) == 0


def test_names_in_a_manifest_do_not_steer_the_terminal(tmp_path, capsys):
    outputs = {"a\n\x1b[31m.exr": {"run": "r", "frame": 1, "sha256": "x"},
               "\udcff.exr": {"run": "r", "frame": 2}}
    (tmp_path / MANIFEST_NAME).write_text(json.dumps({"format": "postfx manifest",
                                                      "version": MANIFEST_VERSION,
                                                      "runs": {"r": {"status": "x\ry"}},
                                                      "outputs": outputs}))
    assert main(["verify", str(tmp_path)]) == 1
    said = capsys.readouterr().out
    assert "missing    a??[31m.exr: was written and is gone" in said and "unfinished ?.exr" in said
    assert "run r was x?y" in said and said.count("\n") == 4


@pytest.mark.parametrize("verb", ["run", "verify"])
def test_manifest_that_cannot_be_read_for_now(runs, capsys, monkeypatch, verb):
    assert runs()[0] == 0
    before = (runs.folder / MANIFEST_NAME).read_bytes()

    def fail(*_):
        raise OSError(5, "Input/output error")

    monkeypatch.setattr("postfx.runs.manifest.read_text", fail)
    assert main(runs.arguments("--skip-existing") if verb == "run"
                else ["verify", str(runs.folder)]) == 2
    assert (f"{MANIFEST_NAME}: cannot be read: Input/output error; check its "
            "rights" in capsys.readouterr().err)
    assert (runs.folder / MANIFEST_NAME).read_bytes() == before
    assert sorted(path.suffix for path in runs.folder.iterdir()) == [".exr"] * 8 + [".json"]


def test_verify_without_a_manifest(tmp_path, capsys):
    assert main(["verify", str(tmp_path)]) == 2
    assert (f"has no {MANIFEST_NAME}: give the folder that 'postfx run' wrote "
            "to" in capsys.readouterr().err)


@pytest.mark.parametrize("content",
                         ["", "{", "[]", "null", "[" * 100_000, "\x00\x01",
                          '{"format": "other", "version": 1}',
                          '{"format": "postfx manifest", "version": 1, "runs": [], "outputs": {}}'])
def test_verify_of_a_damaged_manifest(tmp_path, capsys, content):
    (tmp_path / MANIFEST_NAME).write_text(content)
    assert main(["verify", str(tmp_path)]) == 2
    said = capsys.readouterr().err
    assert said.startswith("error: ") and said.count("\n") == 1 and "delete it" in said


@pytest.mark.parametrize("name", ["../other.exr", "/etc/passwd", "a/b.exr", "..", ""])
def test_manifest_that_names_files_elsewhere(name):
    text = json.dumps({"format": "postfx manifest", "version": MANIFEST_VERSION, "runs": {},
                       "outputs": {
        name: {"run": "r", "frame": 1}}})
    with pytest.raises(ManifestError, match="it names a file outside of its folder"):
        Manifest.from_json(text)
    with pytest.raises(ManifestError, match="it names a file outside of its folder"):
        Manifest.from_json(json.dumps({"format": "postfx manifest", "version": MANIFEST_VERSION,
                                       "runs": {name: {}}, "outputs": {}}))


@pytest.mark.parametrize("entry", [{}, {"run": 1, "frame": 1}, {"run": "r", "frame": "1"},
                                   {"run": "r", "frame": 1, "sha256": 5},
                                   {"run": "r", "frame": 1, "other": 2}, 7,
                                   {"run": "r", "frame": 1, "inputs": {"a": 1}},
                                   {"run": "r", "frame": 1, "inputs": {"a": [float("inf"), 1]}}])
def test_manifest_with_a_malformed_entry(entry):
    text = json.dumps({"format": "postfx manifest", "version": MANIFEST_VERSION, "runs": {},
                       "outputs": {"a.exr": entry}})
    with pytest.raises(ManifestError, match="it is damaged"):
        Manifest.from_json(text)


def test_header_tells_how_a_frame_was_made(runs):
    assert runs()[0] == 0
    image = oiio.ImageInput.open(str(runs.folder / "out.0002.exr"))
    header = {item.name: item.value for item in image.spec().extra_attribs}
    image.close()
    assert header["postfx:version"] == __version__
    assert header["postfx:models"].startswith("tonemap.aces2 sha256:")
    settings = json.loads(header["postfx:settings"])
    assert (settings["settings"]["input"] == "in.####.exr"
            and settings["passes"]["tonemap"]["look"] == "aces2")


def test_header_of_a_processed_frame_is_not_handed_on(runs, tmp_path):
    assert runs()[0] == 0
    again = str(tmp_path / "again.####.exr")
    assert main(["run", str(runs.folder / "out.####.exr"), "-o", again, "--no-denoise", "--frames",
                 "1"]) == 0
    spec = oiio.ImageInput.open(again.replace("####", "0001")).spec()
    assert not spec.getattribute("postfx:models")
    assert json.loads(spec.getattribute("postfx:settings"))["passes"] == {}


def test_log_has_an_object_for_each_event(runs):
    assert runs()[0] == 0
    events = runs.events()
    assert [item["event"] for item in events] == ["begin", *["frame"] * 8, "end"]
    assert (len({item["run"] for item in events}) == 1
            and all(item["time"].endswith("Z") for item in events))
    frames = runs.events("frame")
    assert [item["frame"] for item in frames] == list(range(1, 9))
    manifest = json.loads((runs.folder / MANIFEST_NAME).read_text())["outputs"]
    assert all(manifest[os.path.basename(item["file"])]["sha256"] == item["sha256"]
               for item in frames)
    assert set(frames[0]) == {"time", "run", "event", "frame", "file", "bytes", "sha256", "ms",
                              "passes", "exposure_ev", "cut", "broken"}
    assert events[-1]["written"] == 8 and events[-1]["exit_code"] == 0


def test_log_tells_what_was_skipped_and_why_a_run_failed(runs):
    assert runs("--frames", "1-4")[0] == 0
    assert runs.fail({"at": READ, "do": "fail", "of": " 6 "}, more=("--skip-existing",))[0] == 2
    assert len(runs.events("skip")) == 4 and len(runs.events("retry")) == 2
    end = runs.events("end")[-1]
    assert ((end["status"], end["exit_code"]) == ("failed", 2) and end["error"] == "a read that "
            "failed for once")


def test_log_that_cannot_be_written(runs, tmp_path):
    (tmp_path / "file").write_text("")
    code, said = runs("--log", str(tmp_path / "file/log.jsonl"))
    assert code == 2 and "log.jsonl: cannot be written" in said and "Traceback" not in said
    assert runs.files() == {}


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="this system has no pipes with names")
def test_a_log_that_is_a_pipe(runs, tmp_path):
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    code, said = runs("--log", str(pipe))
    assert code == 2 and "pipe: cannot be written: nobody reads this pipe: give --log" in said
    with subprocess.Popen(["cat", pipe], stdout=subprocess.PIPE) as reader:
        try:
            held = open_once_read(pipe)
            code, said = runs("--log", str(pipe))
            os.close(held)
            assert code == 0, said
            assert '"event": "end"' in reader.communicate(timeout=60)[0].decode()
        finally:
            reader.kill()  # it waits for ever where no run opens the pipe


def open_once_read(pipe: Path) -> int:
    """The pipe open for writing, as soon as somebody reads it."""
    end = time.monotonic() + 60
    while True:
        try:
            return os.open(pipe, os.O_WRONLY | os.O_NONBLOCK)
        except OSError:
            assert time.monotonic() < end, "nobody reads the pipe"
            time.sleep(0.01)


def test_reads_that_fail_and_recover(runs, unbroken):
    code, said = runs.fail({"at": READ, "do": "fail", "calls": [2, 5, 6]})
    assert code == 0, said
    assert runs.files() == unbroken and len(runs.events("retry")) == 3


def test_read_that_keeps_failing(runs, unbroken):
    code, said = runs.fail({"at": READ, "do": "fail", "of": " 4 "})
    assert code == 2 and "error: a read that failed for once" in said and "Traceback" not in said
    assert list(runs.files()) == list(unbroken)[:3]
    assert runs("--skip-existing")[0] == 0 and runs.files() == unbroken


def test_a_process_that_never_gets_there_ends_the_wait(runs):
    process = runs.start([], "--frames", "1-2")
    with pytest.raises(AssertionError, match="event 3 of 'frame' did not come, exit code 0: "):
        runs.wait_for(process, "frame", 3)
    stuck = runs.start([{"at": READ, "do": "sleep", "seconds": 1000}], "--overwrite")
    with pytest.raises(AssertionError, match="event 3 of 'frame' did not come, exit code None"):
        runs.wait_for(stuck, "frame", 3, seconds=0.1)
    with pytest.raises(AssertionError, match=r"it does not end within 0\.1 s"):
        stuck.wait(0.1)
    assert stuck.returncode == -signal.SIGKILL


def test_a_slow_disk_changes_no_file(runs, unbroken):
    slow = [{"at": at, "do": "sleep", "seconds": 0.05}
            for at in (READ, WRITE)]
    assert runs.fail(*slow)[0] == 0
    assert runs.files() == unbroken


def test_full_disk_while_a_frame_is_written(runs, unbroken):
    code, said = runs.fail({"at": "postfx.io.writer.write_exr", "do": "full", "calls": [4]})
    assert (code == 2 and "out.0004.exr: cannot be written: No space left on "
            "device" in said and "Traceback" not in said)
    assert list(runs.files()) == list(unbroken)[:3] and not list(runs.folder.glob(".out*"))
    assert runs("--skip-existing")[0] == 0 and runs.files() == unbroken


def test_full_disk_while_the_manifest_is_written(runs, unbroken):
    code, said = runs.fail({"at": "postfx.runs.manifest.write_atomically", "do": "full",
                            "calls": [2]},
                           more=("--checkpoint", "0"))
    assert (code == 2 and f"{MANIFEST_NAME}: cannot be written: No space left on "
            "device" in said and "Traceback" not in said)
    assert runs("--skip-existing")[0] == 0 and runs.files() == unbroken and runs.verify()[0] == 0


def test_full_disk_while_a_checkpoint_is_written(runs, unbroken):
    code, said = runs.fail({"at": "postfx.runs.folder.write_atomically", "do": "full"},
                           more=("--checkpoint", "0"))
    assert code == 0 and "no checkpoint could be written: No space left on device" in said
    assert runs.files() == unbroken


def test_run_that_fails_before_its_first_frame(runs, unbroken):
    failing = {"at": READ, "do": "fail"}
    code, said = runs.fail(failing)
    assert code == 2 and said.splitlines()[-1] == "error: a read that failed for once"
    assert " of 8 frames" not in said and "skipped" not in said, "no results of no frame"
    assert list(runs.folder.iterdir()) == []
    assert runs()[0] == 0
    assert runs.fail(failing, more=("--overwrite",))[0] == 2
    assert runs.files() == unbroken and runs.verify()[0] == 0


@pytest.fixture
def forbidden(runs):
    """The runs' folder, empty and not to be written; for root, who may write everywhere, a disk
    that is read only."""
    runs.folder.mkdir(mode=0o500)
    if os.getuid():
        yield "Permission denied"
        return
    mount = ["mount", "-t", "tmpfs", "-o", "ro", "tmpfs", runs.folder]
    if subprocess.run(mount, check=False, capture_output=True).returncode:
        pytest.skip("root may write everywhere, and mounting a disk is not allowed here")
    yield "Read-only file system"
    subprocess.run(["umount", "-l", runs.folder], check=True)


def test_folder_that_may_not_be_written(runs, forbidden):
    code, said = runs()
    assert (code == 2 and "out.0001.exr: cannot be written: "
            f"{forbidden}" in said and "Traceback" not in said)


def test_file_where_the_run_folder_should_be(runs):
    runs.folder.mkdir()
    (runs.folder / ".postfx").write_text("a file where the folder should be")
    code, said = runs()
    assert code == 2 and "/.postfx: is no folder" in said and "Traceback" not in said
    assert runs.files() == {}


def test_frames_of_two_patterns_in_one_folder(runs, unbroken):
    assert runs()[0] == 0
    pictures = str(runs.folder / "picture.####.png")
    assert main(["run", runs.shot, "-o", pictures, "--no-denoise", "--no-tonemap"]) == 0
    code, found = runs.verify()
    assert (code == 0 and len(found["whole"]) == 16 and len(found["runs"]) == 2
            and runs.files() == unbroken)


@pytest.mark.parametrize("arguments", [("--checkpoint", "often"), ("--checkpoint", "-1"),
                                       ("--resume", "some"), ("--resume", "-1")])
def test_mistakes_in_options(runs, arguments):
    with pytest.raises(SystemExit) as caught:
        runs(*arguments)
    assert caught.value.code == 2
