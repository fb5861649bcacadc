"""Frames that cannot be read or processed: `--on-error stop|skip|copy`, what is counted, and the
history after them."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import OpenEXR
import pytest

from postfx.cli.interruptions import EXIT_FAULTS, Faults, OnError
from postfx.cli.main import main
from postfx.errors import ReadError, WriteError
from postfx.frame import Frame, Role
from postfx.io.sequence import Sequence, read_sequence
from postfx.runs.manifest import load_manifest
from tests.files.conftest import names
from tests.files.exr_files import picture, write_studio

RUN = ("in/shot.####.exr", "-o", "out/", "--json")


def cut(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:900])


@pytest.fixture
def broken(shot) -> Path:
    """Four frames; the second is cut short, the third of another size."""
    folder = shot(1, 2, 4)
    cut(folder / "shot.0002.exr")
    OpenEXR.File({"type": OpenEXR.scanlineimage},
                 picture(20, 30)).write(str(folder / "shot.0003.exr"))
    return folder


def test_stop_is_the_default_and_keeps_what_is_finished(postfx, broken, tmp_path: Path) -> None:
    done = postfx(*RUN)
    assert done.code == 2 and "error: in/shot.0002.exr: broken file: " in done.err
    assert names(tmp_path / "out") == ["shot.0001.exr"]
    assert "faults" not in json.loads(done.out)


def test_skip_leaves_frames_out_and_counts_them(postfx, broken, tmp_path: Path) -> None:
    done = postfx(*RUN, "--on-error", "skip")
    report = json.loads(done.out)
    assert done.code == EXIT_FAULTS == 3
    assert names(tmp_path / "out") == ["shot.0001.exr", "shot.0004.exr"]
    assert [(fault["frame"], fault["instead"]) for fault in report["faults"]] == [(2, "left out"),
                                                                                  (3, "left out")]
    assert "failed   2 frames: 2 left out, 0 resampled instead" in done.err
    assert ("failed   frame 3, left out: in/shot.0003.exr: frame 3 is 20x30, the first one 37x41: "
            "render it" in done.err)
    assert report["frames"] == 2 and "error" not in report


def test_copy_writes_what_can_be_read(postfx, shot, tmp_path: Path) -> None:
    folder = shot(1, 2, 3)
    cut(folder / "shot.0002.exr")
    done = postfx(*RUN, "--on-error", "copy")
    assert (done.code == EXIT_FAULTS
            and names(tmp_path / "out") == ["shot.0001.exr", "shot.0003.exr"])
    assert json.loads(done.out)["faults"][0]["instead"] == "left out"


def test_frames_that_are_not_there_are_left_out_as_well(postfx, shot, tmp_path: Path) -> None:
    shot(1, 2, 4)
    assert postfx(*RUN, "--on-error", "skip").code == EXIT_FAULTS
    assert names(tmp_path / "out") == ["shot.0001.exr", "shot.0002.exr", "shot.0004.exr"]


def test_a_first_frame_that_cannot_be_read_is_left_out(postfx, shot, tmp_path: Path) -> None:
    folder = shot(1, 2)
    (folder / "shot.0001.exr").write_bytes(b"")
    assert postfx(*RUN, "--on-error", "skip").code == EXIT_FAULTS
    assert names(tmp_path / "out") == ["shot.0002.exr"]
    (folder / "shot.0002.exr").write_bytes(b"")
    done = postfx(*RUN, "--on-error", "skip", "--overwrite")
    assert done.code == 2 and "in/shot.0002.exr: is empty" in done.error


def test_what_cannot_be_kept_fails_its_frame_only(postfx, tmp_path: Path) -> None:
    """Pixels of a part that no pass reads are missing."""
    (tmp_path / "in").mkdir()
    whole = write_studio(tmp_path).read_bytes()
    for number in (1, 2, 3):
        (tmp_path / f"in/shot.{number:04d}.exr").write_bytes(whole if number != 2 else whole[:-1])
    done = postfx(*RUN, "--on-error", "skip")
    assert (done.code == EXIT_FAULTS
            and names(tmp_path / "out") == ["shot.0001.exr", "shot.0003.exr"])


def test_an_output_that_cannot_be_written_stops_the_run_all_the_same(postfx, shot,
                                                                     tmp_path: Path) -> None:
    shot(1, 2, 3)
    (tmp_path / "out/shot.0002.exr").mkdir(parents=True)
    done = postfx(*RUN, "--on-error", "skip", "--overwrite")
    assert done.code == 2 and "out/shot.0002.exr: cannot be written" in done.error


def test_smooth_exposure_leaves_broken_frames_out(postfx, shot, tmp_path: Path) -> None:
    cut(shot(1, 2, 3) / "shot.0002.exr")
    arguments = ["run", *RUN[:2], "out/a.####.png", "--exposure", "smooth", "--no-denoise",
                 "--device", "cpu"]
    assert main([*arguments, "--on-error", "skip"]) == EXIT_FAULTS
    assert names(tmp_path / "out") == ["a.0001.png", "a.0003.png"]
    assert main([*arguments, "--overwrite"]) == 2


def fail(error: Exception) -> Frame:
    raise error


def test_the_frame_after_a_failed_one_begins_without_a_history(postfx, broken, shot,
                                                               tmp_path: Path) -> None:
    """Frame 3 can be read, but not be processed: nothing but the run knows that it is none."""
    shot(5)
    assert postfx(*RUN, "--on-error", "skip").code == EXIT_FAULTS
    outputs = load_manifest(tmp_path / "out").outputs
    starts = {output.frame: output.starts for output in outputs.values() if output.sha256}
    assert starts == {1: False, 4: True, 5: False}


def test_frames_that_only_fill_the_history_are_not_counted() -> None:
    faults = Faults(OnError.SKIP)
    assert faults.attempt(1, False, lambda: fail(ReadError("broken"))) is None
    assert not faults.found


@pytest.mark.parametrize(("policy", "error"), [(OnError.STOP, ReadError("x")),
                                              (OnError.SKIP, WriteError("x")),
                                              (OnError.COPY, WriteError("x")),
                                              (OnError.SKIP, ZeroDivisionError())])
def test_what_is_not_let_pass(policy: OnError, error: Exception) -> None:
    with pytest.raises(type(error)):
        Faults(policy).attempt(1, True, lambda: fail(error))


def test_the_sequence_marks_the_frame_after_one_that_cannot_be_read(shot) -> None:
    folder = shot(1, 2, 3)
    cut(folder / "shot.0002.exr")
    sequence = Sequence(folder)
    sequence.read(1)
    with pytest.raises(ReadError):
        sequence.read(2)
    assert sequence.read(3).reset


def test_copy_enlarges_the_picture_of_a_frame_that_lacks_a_plane(tmp_path: Path, write_exr,
                                                                 monkeypatch) -> None:
    """The size is that of the others, the picture that of strength 0, the exposure goes on, and
    nothing is denoised."""
    random = np.random.default_rng(0)
    for number in (1, 2, 3):
        planes = {name: random.random((32, 48), np.float32) for name in "RGB"}
        planes |= ({"motion.X": np.zeros((32, 48)), "motion.Y": np.zeros((32, 48))} if number != 2
                   else {})
        write_exr(f"in/shot.{number:04d}.exr", planes)
    monkeypatch.chdir(tmp_path)
    common = ["--device", "cpu", "--model", "s", "--exposure", "0", "--scale", "2"]
    assert main(["run", *RUN[:3], *common, "--on-error", "copy"]) == EXIT_FAULTS
    assert main(["run", *RUN[:2], "plain/", "--strength", "0", *common[:2], *common[4:]]) == 0
    copied, plain = (next(iter(read_sequence(tmp_path / name / "shot.0002.exr")))[Role.COLOUR]
                     for name in ("out", "plain"))
    np.testing.assert_array_equal(copied, plain)
    assert names(tmp_path / "out") == ["shot.0001.exr", "shot.0002.exr", "shot.0003.exr"]
    alone = next(iter(read_sequence(tmp_path / "out/shot.0003.exr")))[Role.COLOUR]
    assert main(["run", *RUN[:2], "alone/", "--frames", "3", *common]) == 0
    np.testing.assert_array_equal(next(
        iter(read_sequence(tmp_path / "alone/shot.0003.exr"))
    )[Role.COLOUR], alone)
