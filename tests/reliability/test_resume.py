"""A run that was killed anywhere goes on to the very files of an unbroken one."""

import json
import os
import shutil
import socket
from pathlib import Path

import pytest

from postfx.runs.manifest import MANIFEST_NAME
from tests.reliability.conftest import FRAMES, Runs, write_frame
from tests.reliability.faulty import WRITE

RESUME = ("--skip-existing",)
DENOISE = ("--model", "s", "--threads", "1")

PLACES = {
    "before the first frame": ("postfx.cli.frame_loop.FrameLoop.process_all", 1, "before"),
    "while a frame is processed": ("postfx.flow.Flow._run", 4, "before"),
    "before a frame is written": (WRITE, 4, "before"),
    "between writing a frame and naming it": ("postfx.io.writer.write_exr", 4, "after"),
    "between naming a frame and entering it into the manifest": (
        WRITE, 4, "after"),
    "while the manifest is written": ("postfx.runs.manifest.write_atomically", 2, "before"),
    "after the manifest was written": ("postfx.runs.folder.update_manifest", 2, "after"),
    "between writing a checkpoint and naming it": ("os.replace", 3, "before", ".checkpoint"),
    "after a checkpoint was written": ("postfx.runs.folder.save_checkpoint", 3, "after"),
    "after the last frame": ("postfx.runs.folder.RunFolder.close", 1, "before"),
}


@pytest.mark.parametrize("place", PLACES)
def test_killed_and_resumed(runs, unbroken, place):
    at, call, when, *of = PLACES[place]
    runs.killed(at, call, when, *of, more=("--checkpoint", "0"))
    assert all(unbroken[name] == content for name, content in runs.files().items())
    code, said = runs(*RESUME)
    assert code == 0, said
    assert runs.files() == unbroken
    assert runs.verify()[0] == 0
    assert sorted(path.name for path in runs.folder.iterdir()) == [*unbroken, MANIFEST_NAME]


@pytest.mark.parametrize("seconds", ["0", "none"])
def test_killed_and_resumed_with_the_denoiser(runs, seconds):
    whole = Runs(runs.shot, runs.folder.parent / "whole", runs._capsys)
    assert whole(passes=DENOISE)[0] == 0
    runs.killed(WRITE, 6, passes=DENOISE, more=("--checkpoint", seconds))
    assert runs(*RESUME, passes=DENOISE)[0] == 0
    assert runs.files() == whole.files()
    assert len(runs.events("recall")) == (seconds == "0")


@pytest.mark.parametrize("sizes", [((32, 48), (24, 36), (32, 48), (16, 24)),
                                   ((48, 72), (24, 36), (32, 48), (24, 36)),
                                   ((24, 36), (48, 72), (24, 36), (32, 48))],
                         ids=["enlarged", "1x last", "1x next"])
@pytest.mark.parametrize("seconds", ["0", "none"])
def test_killed_and_resumed_across_changing_sizes(tmp_path, capsys, seconds, sizes):
    """The frame where it goes on is of another size than those before and after it."""
    for number in range(1, FRAMES + 1):
        write_frame(tmp_path / f"in.{number:04d}.exr", number, size=sizes[number % 4])
    shot, passes = str(tmp_path / "in.####.exr"), (*DENOISE, "--size", "72x48")
    whole, runs = Runs(shot, tmp_path / "whole", capsys), Runs(shot, tmp_path / "out", capsys)
    assert whole(passes=passes)[0] == 0
    runs.killed(WRITE, 6, passes=passes, more=("--checkpoint", seconds))
    assert runs(*RESUME, passes=passes)[0] == 0
    assert runs.files() == whole.files()
    assert len(runs.events("recall")) == (seconds == "0")


def test_killed_again_and_again(runs, unbroken):
    for call in (2, 1, 3, 2):
        runs.killed(WRITE, call, more=("--checkpoint", "0", *RESUME))
    assert runs(*RESUME)[0] == 0
    assert runs.files() == unbroken


def test_resuming_runs_no_frame_again_after_a_checkpoint(runs, unbroken):
    runs.killed(WRITE, 6, more=("--checkpoint", "0"))
    read = len(runs.files())
    assert runs(*RESUME)[0] == 0
    assert [item["frame"] for item in runs.events("recall")] == [read]
    assert runs.files() == unbroken


def test_damaged_checkpoint(runs, unbroken):
    runs.killed(WRITE, 6, more=("--checkpoint", "0"))
    (checkpoint,) = (runs.folder / ".postfx").glob("*.checkpoint")
    content = bytearray(checkpoint.read_bytes())
    content[len(content) // 2] ^= 1
    checkpoint.write_bytes(content)
    code, said = runs(*RESUME)
    assert code == 0 and "is damaged: not used" in said
    assert runs.files() == unbroken and not runs.events("recall")


def test_truncated_checkpoint(runs, unbroken):
    runs.killed(WRITE, 6, more=("--checkpoint", "0"))
    (checkpoint,) = (runs.folder / ".postfx").glob("*.checkpoint")
    checkpoint.write_bytes(checkpoint.read_bytes()[:-100])
    assert runs(*RESUME)[0] == 0
    assert runs.files() == unbroken and not runs.events("recall")


def test_checkpoint_of_other_settings_is_not_used(runs):
    runs.killed(WRITE, 6,
                more=("--checkpoint", "0", "--exposure", "auto", "--cuts", "none"))
    code, said = runs(*RESUME)
    assert code == 0 and not runs.events("recall")
    warning = "warning  kept, though made with other settings, models or versions: frames "
    assert said.count(warning) == 1
    assert said.index(warning) < said.index("/8 "), "before the work"


def test_a_frame_lost_in_the_middle(runs, unbroken):
    assert runs()[0] == 0
    (runs.folder / "out.0005.exr").unlink()
    assert runs(*RESUME)[0] == 0
    assert runs.files() == unbroken


def test_at_most_so_many_frames_are_run_again(runs, unbroken):
    assert runs()[0] == 0
    (runs.folder / "out.0007.exr").unlink()
    assert runs(*RESUME, "--resume", "1")[0] == 0
    differing = [name for name, content in runs.files().items() if content != unbroken[name]]
    assert differing == ["out.0007.exr"] and runs.verify()[0] == 0


def test_what_lies_before_a_cut_is_not_run_again(tmp_path, capsys):
    for number in range(1, FRAMES + 1):
        write_frame(tmp_path / f"in.{number:04d}.exr", number, reset=number == 5)
    runs = Runs(str(tmp_path / "in.####.exr"), tmp_path / "out", capsys)
    assert runs()[0] == 0
    whole = runs.files()
    (runs.folder / "out.0007.exr").unlink()
    (tmp_path / "in.0004.exr").unlink()
    assert runs(*RESUME, "--frames", "1-3,5-8")[0] == 0
    assert runs.files() == whole


def test_black_frames_at_a_cut_forget_the_shot_before(tmp_path, capsys):
    for number in range(1, FRAMES + 1):
        write_frame(tmp_path / f"in.{number:04d}.exr", number, number == 5, float(number != 5))
    runs = Runs(str(tmp_path / "in.####.exr"), tmp_path / "out", capsys)
    assert runs()[0] == 0
    whole = runs.files()
    (runs.folder / "out.0006.exr").unlink()
    assert runs(*RESUME)[0] == 0
    assert runs.files() == whole


def test_frame_that_was_rendered_again(shot, tmp_path, capsys):
    shutil.copytree(Path(shot).parent, tmp_path / "in")
    runs = Runs(str(tmp_path / "in/in.####.exr"), tmp_path / "out", capsys)
    assert runs()[0] == 0
    before = runs.files()
    write_frame(tmp_path / "in/in.0003.exr", 99)
    assert runs(*RESUME)[0] == 0
    changed = [name for name, content in runs.files().items() if content != before[name]]
    assert changed == ["out.0003.exr"] and runs.verify()[0] == 0


def test_file_that_someone_altered_is_kept(runs, unbroken):
    assert runs()[0] == 0
    shutil.copy(runs.folder / "out.0002.exr", runs.folder / "out.0003.exr")
    code, said = runs(*RESUME)
    assert (code == 0 and "out.0003.exr was altered since it was written: kept; delete it to make "
            "it again" in said)
    assert runs.files()["out.0003.exr"] == unbroken["out.0002.exr"]


@pytest.mark.parametrize("how", ["truncated", "empty", "zeros"])
def test_damaged_file_is_made_anew(runs, unbroken, how):
    assert runs()[0] == 0
    path = runs.folder / "out.0004.exr"
    content = path.read_bytes()
    half = len(content) // 2
    path.write_bytes({"truncated": content[:half], "empty": b"",
                      "zeros": content[:half] + bytes(half)}[how])
    assert runs.verify()[1]["altered"] == ["out.0004.exr"]
    assert runs(*RESUME)[0] == 0
    assert runs.files() == unbroken and runs.verify()[0] == 0


def test_old_files_of_a_run_that_was_killed_while_overwriting(runs, unbroken):
    assert runs("--exposure", "3")[0] == 0  # whole files, of other settings
    old = runs.files()
    runs.killed(WRITE, 4, more=("--overwrite",))
    assert runs.files()["out.0008.exr"] == old["out.0008.exr"]
    assert runs(*RESUME)[0] == 0
    assert runs.files() == unbroken


def test_without_a_manifest_files_are_decoded(runs, unbroken):
    assert runs()[0] == 0
    (runs.folder / MANIFEST_NAME).unlink()
    (runs.folder / "out.0006.exr").write_bytes(unbroken["out.0006.exr"][:700])
    assert runs(*RESUME)[0] == 0
    assert runs.files() == unbroken


def test_damaged_manifest_is_put_aside(runs, unbroken):
    assert runs()[0] == 0
    (runs.folder / MANIFEST_NAME).write_text((runs.folder / MANIFEST_NAME).read_text()[:500])
    (runs.folder / "out.0006.exr").unlink()
    code, said = runs(*RESUME)
    assert code == 0 and f"renamed to {MANIFEST_NAME}.damaged, a new one is started" in said
    assert runs.files() == unbroken and (runs.folder / f"{MANIFEST_NAME}.damaged").exists()


def test_leftovers_of_a_killed_writer_are_removed(runs):
    runs.killed("postfx.io.writer.write_exr", 3, "after")
    assert [path.name for path in runs.folder.glob(".out.*")] != []
    foreign = runs.folder / ".other.0001.77.exr"
    foreign.write_text("of someone else")
    assert runs(*RESUME)[0] == 0
    assert [path.name for path in runs.folder.glob(".o*")] == [foreign.name]


def test_leftovers_of_machines_that_are_gone_are_removed(runs):
    """As of containers, which have another name each time."""
    runs.folder.mkdir()
    gone, foreign, living = (runs.folder / name for name in
                             (".out.0003.exr.0f3a-7-0.part", ".other.0003.exr.0f3a-7-0.part",
                              f".out.0003.exr.{socket.gethostname()}-{os.getpid()}-99.part"))
    for path in (gone, foreign, living):
        path.write_text("half a frame")
    assert runs()[0] == 0
    assert not gone.exists() and foreign.exists() and living.exists()


def test_resumed_with_more_frames_than_before(shot, tmp_path, capsys, unbroken):
    (tmp_path / "in").mkdir()
    sources = sorted(Path(shot).parent.glob("*.exr"))
    for source in sources[:5]:
        shutil.copy2(source, tmp_path / "in")
    runs = Runs(str(tmp_path / "in/in.####.exr"), tmp_path / "out", capsys)
    assert runs()[0] == 0
    for source in sources[5:]:
        shutil.copy2(source, tmp_path / "in")
    assert runs(*RESUME)[0] == 0
    assert list(runs.files().values()) == list(unbroken.values())


def test_manifest_tells_how_frames_were_made(runs):
    assert runs()[0] == 0
    manifest = json.loads((runs.folder / MANIFEST_NAME).read_text())
    (run,) = manifest["runs"].values()
    assert run["settings"]["exposure"] == "auto" and run["passes"]["tonemap"]["look"] == "aces2"
    assert {"postfx", "python", "numpy", "OpenImageIO", "onnxruntime"} <= set(run["versions"])
    assert (len(run["models"]["tonemap.aces2"]) == 64 and run["device"]["name"] == "cpu"
            and run["status"] == "finished")
    entry = manifest["outputs"]["out.0003.exr"]
    assert (entry["frame"] == 3 and (entry["width"], entry["height"]) == (48, 32)
            and len(entry["sha256"]) == 64)
    ((source, (size, changed)),) = entry["inputs"].items()
    assert Path(source).stat().st_size == size and Path(source).stat().st_mtime_ns == changed
