"""A file is there whole or not at all: full disks, limits, kills in the middle of writing, things
in the way."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from postfx import files as postfx_files
from postfx.cli.main import main
from postfx.errors import WriteError
from postfx.files import PARTIAL, output_file
from postfx.frame import Frame, Role
from postfx.io.sequence import read_sequence
from postfx.io.writer import is_complete, write_frame
from tests.files.conftest import names

REPOSITORY = Path(__file__).resolve().parents[2]
SUFFIXES = (".exr", ".png", ".tif", ".jpg")


def noise(width: int = 300, height: int = 300) -> Frame:
    return Frame({Role.COLOUR: np.random.default_rng(0).random((height, width, 3), np.float32)})


LIMITED = """
import resource, sys
import numpy as np
from pathlib import Path
from postfx.errors import PostfxError
from postfx.frame import Frame, Role
from postfx.io.writer import write_frame
keep = sys.argv[1]
resource.setrlimit(resource.RLIMIT_FSIZE, (40000, 40000))
for path, side in zip(sys.argv[2::2], map(int, sys.argv[3::2]), strict=True):
    colour = np.random.default_rng(0).random((side, side, 3), np.float32)
    frame = Frame({Role.COLOUR: colour}, source=keep or None)
    try:
        print(write_frame(Path(path), frame, keep=bool(keep)))
    except PostfxError as error:
        print(type(error).__name__, error)
"""


def limited(*squares: tuple[Path, int], keep: str = "") -> list[str]:
    """What writing squares of noise says in a process whose files may have 40000 bytes."""
    words = [str(word) for square in squares for word in square]
    done = subprocess.run([sys.executable, "-c", LIMITED, keep, *words], capture_output=True,
                          text=True, env={**os.environ, "PYTHONPATH": str(REPOSITORY)}, timeout=120,
                          check=True)
    return done.stdout.splitlines()


def test_files_over_the_limit_of_the_system(tmp_path: Path) -> None:
    squares = [(tmp_path / f"{name}{suffix}", side) for suffix in SUFFIXES
               for name, side in (("a", 300), ("b", 40))]
    told = limited(*squares)
    assert len(told) == len(squares)
    for suffix, (large, small) in zip(SUFFIXES, zip(told[::2], told[1::2], strict=True),
                                      strict=True):
        assert large.startswith(f"WriteError {tmp_path}/a{suffix}: cannot be written: ")
        assert small == f"{tmp_path}/b{suffix}"
    assert names(tmp_path) == sorted(f"b{suffix}" for suffix in SUFFIXES)


def test_what_is_kept_over_the_limit(tmp_path: Path) -> None:
    source = write_frame(tmp_path / "in.exr", noise())
    (told,) = limited((tmp_path / "out.exr", 40), keep=str(source))
    assert told.startswith(f"WriteError {tmp_path}/out.exr: cannot be written: File too large")
    assert names(tmp_path) == ["in.exr"]


@pytest.fixture
def small_disk(tmp_path: Path):
    """A file system of 64 KiB; skips where mounting is not allowed."""
    (tmp_path / "disk").mkdir()
    mount = subprocess.run(["mount", "-t", "tmpfs", "-o", "size=64k", "tmpfs", tmp_path / "disk"],
                           check=False, capture_output=True)
    if mount.returncode:
        pytest.skip("mounting a small file system is not allowed here")
    yield tmp_path / "disk"
    subprocess.run(["umount", "-l", tmp_path / "disk"], check=True)


@pytest.mark.parametrize("side", [145, 150, 160, 300])
@pytest.mark.parametrize("suffix", SUFFIXES)
def test_a_full_disk(small_disk: Path, suffix: str, side: int) -> None:
    """Also just before the end, where encoders of PNG and TIFF say that all is well, and libjpeg
    ends the process."""
    (small_disk / "before.txt").write_text("finished")
    path = small_disk / f"a{suffix}"
    try:
        write_frame(path, noise(side, side))
    except WriteError as error:
        assert f"a{suffix}: cannot be written: " in str(error) and "free space" in str(error)
        assert names(small_disk) == ["before.txt"]
    else:
        assert is_complete(path, side, side)
    assert (small_disk / "before.txt").read_text() == "finished"


@pytest.mark.parametrize("page", ["--report", "--capture"])
def test_pages_on_a_full_disk_stay_what_they_were(small_disk: Path, tmp_path: Path, page: str
                                                  ) -> None:
    """A capture has a small file that would fit beside its page, which does not."""
    before = {name: f"the old {name}" for name in ("shot.html", "capture.html", "capture.json")}
    for name, text in before.items():
        (small_disk / name).write_text(text)
    source, target = write_frame(tmp_path / "in.exr", noise(64, 64)), tmp_path / "out.exr"
    place = small_disk / "shot.html" if page == "--report" else small_disk
    assert main(["run", str(source), "-o", str(target), "--no-denoise", "--tonemap", page,
                 str(place)]) == 2
    assert {name: (small_disk / name).read_text() for name in names(small_disk)} == before


def test_all_tensors_on_a_full_disk_leave_the_older_capture(small_disk: Path, tmp_path: Path,
                                                            capsys: pytest.CaptureFixture[str]
                                                            ) -> None:
    """Tensors are many files, some of which fit; before, they took the place of older ones."""
    before = {"capture.html": "the old page", "capture.json": "the old list",
              "tensors/0000.0.colour.npy": "an old tensor"}
    (small_disk / "tensors").mkdir()
    for name, text in before.items():
        (small_disk / name).write_text(text)
    source, target = write_frame(tmp_path / "in.exr", noise(128, 128)), tmp_path / "out.exr"
    assert main(["run", str(source), "-o", str(target), "--no-denoise", "--tonemap", "--capture",
                 str(small_disk), "--capture-tensors", "all"]) == 2
    assert "No space left on device" in capsys.readouterr().err
    found = {str(path.relative_to(small_disk)): path.read_text()
             for path in small_disk.rglob("*") if path.is_file()}
    assert found == before and len(list((small_disk / "tensors").iterdir())) == 1


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_a_disk_that_fails_late(tmp_path: Path, suffix: str,
                                monkeypatch: pytest.MonkeyPatch) -> None:
    """As network file systems do, which take all bytes and tell when they are to be kept."""
    def fail(_: int) -> None:
        raise OSError(28, "No space left on device")

    whole = write_frame(tmp_path / f"a{suffix}", noise())
    before = whole.read_bytes()
    monkeypatch.setattr(postfx_files.os, "fsync", fail)
    with pytest.raises(
        WriteError,
        match=rf"a\{suffix}: cannot be written: No space left on device; check the folder"
    ):
        write_frame(whole, noise(20, 20))
    assert whole.read_bytes() == before and names(tmp_path) == [f"a{suffix}"]


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_an_encoder_that_says_all_is_well_is_not_believed(
    tmp_path: Path, suffix: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    from postfx.io import writer
    from postfx.io.exr import picture

    own = {".exr": (picture, "write_container"), ".png": (writer, "write_png")}
    home, name = own.get(suffix, (writer, "encode_all"))
    encode = getattr(home, name)

    def lose_the_end(path: Path, *rest: object) -> object:
        said = encode(path, *rest)
        os.truncate(path, os.path.getsize(path) - 20)
        return said

    monkeypatch.setattr(home, name, lose_the_end)
    with pytest.raises(WriteError, match="cannot be written"):
        write_frame(tmp_path / f"a{suffix}", noise())
    assert names(tmp_path) == []


KILLED = """
import sys
import numpy as np
from pathlib import Path
from postfx.frame import Frame, Role
from postfx.io.sequence import read_sequence
from postfx.io.writer import write_frame
import dataclasses
(frame,) = read_sequence(sys.argv[1])
print("ready", flush=True)
number = 0
while True:
    number += 1
    write_frame(Path(sys.argv[2]) / f"a.{number % 3:04d}.exr", frame, keep=True)
"""


@pytest.mark.parametrize("moment", [
    0.02, *(pytest.param(moment, marks=pytest.mark.soak) for moment in (0.11, 0.23)), 0.37])
def test_a_killed_process_leaves_whole_files_only(tmp_path: Path, moment: float) -> None:
    source = write_frame(tmp_path / "in.exr", noise(700, 700))
    out = tmp_path / "out"
    process = subprocess.Popen([sys.executable, "-c", KILLED, str(source), str(out)],
                               stdout=subprocess.PIPE,
                               env={**os.environ, "PYTHONPATH": str(REPOSITORY)})
    assert process.stdout.readline() == b"ready\n"
    time.sleep(moment)
    process.send_signal(signal.SIGKILL)
    process.wait()
    process.stdout.close()
    there = names(out) if out.is_dir() else []
    frames = [name for name in there if not name.startswith(".")]
    assert all(name.endswith(PARTIAL) for name in there if name not in frames)
    assert all(is_complete(out / name, 700, 700) for name in frames)
    for number in range(3):
        write_frame(out / f"a.{number:04d}.exr", next(iter(read_sequence(source))))
    assert names(out) == [f"a.{number:04d}.exr" for number in range(3)]


def test_partial_files_of_a_dead_process_are_removed(tmp_path: Path) -> None:
    """Those that were dead when this process first wrote into the folder."""
    dead, out = subprocess.Popen(["true"]), tmp_path / "out"
    dead.wait()
    out.mkdir()
    with output_file(tmp_path / "a.exr") as own:
        left = out / own.name.replace(f"-{os.getpid()}-", f"-{dead.pid}-")
        own.write_text("mine")
    of_another = left.with_name(left.name.replace("a.exr", "b.exr"))
    for path in (left, left.with_name(left.name.replace(PARTIAL, f"9{PARTIAL}")), of_another):
        path.write_text("half a frame")
    for number in range(2):
        with output_file(out / f"{'ca'[number]}.exr") as own:
            own.write_text("mine")
    assert names(out) == [of_another.name, "a.exr", "c.exr"]


def test_a_folder_is_not_listed_for_every_output(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    listed: list[object] = []
    for name, lists in (("listdir", os.listdir), ("scandir", os.scandir)):
        monkeypatch.setattr(postfx_files.os, name,
                            lambda folder, lists=lists: listed.append(folder) or lists(folder))
    for number in range(5):
        with output_file(tmp_path / f"out.{number}.exr") as temporary:
            temporary.write_text("whole")
    assert len(listed) == 1


def test_files_of_processes_that_still_run_are_not_removed(tmp_path: Path) -> None:
    with output_file(tmp_path / "a.exr") as other:
        other.write_text("of another thread")
        with output_file(tmp_path / "a.exr") as own:
            own.write_text("mine")
        assert (tmp_path / "a.exr").read_text() == "mine" and other.is_file()
    assert (tmp_path / "a.exr").read_text() == "of another thread"


def test_an_interrupt_while_writing_leaves_nothing(tmp_path: Path) -> None:
    with pytest.raises(KeyboardInterrupt), output_file(tmp_path / "a.exr") as path:
        path.write_text("half of it")
        raise KeyboardInterrupt
    assert names(tmp_path) == []


def test_finished_files_have_the_rights_of_any_new_file(tmp_path: Path) -> None:
    write_frame(tmp_path / "a.exr", noise(20, 20))
    (tmp_path / "b").write_text("")
    assert (tmp_path / "a.exr").stat().st_mode == (tmp_path / "b").stat().st_mode


def test_a_pipe_is_read_while_its_writer_holds_the_interpreters_lock() -> None:
    """As OpenImageIO does where it ends a file: more comes than a pipe holds."""
    code = """
import ctypes, os, threading
from concurrent.futures import ThreadPoolExecutor
from postfx.files import read_to_end
reading, writing = os.pipe()
sent = os.urandom(1 << 20)
with ThreadPoolExecutor(1) as reader:
    content = reader.submit(read_to_end, reading, 1 << 21)
    while not content.running():
        pass
    threading.Event().wait(0.2)
    written = ctypes.PyDLL(None).write(writing, sent, len(sent))
    os.close(writing)
    assert written == len(sent) and bytes(content.result()) == sent
"""
    subprocess.run([sys.executable, "-c", code], check=True, timeout=300)
