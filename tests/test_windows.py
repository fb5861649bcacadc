"""Files and the command line where POSIX is not: some of their tests, run again by
tests/windows/sitecustomize.py."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from postfx import files, system
from postfx.runs.folder import About, load_checkpoint, save_checkpoint

ROOT = Path(__file__).resolve().parent.parent
AGAIN = ("tests/files/test_paths.py", "tests/io/test_sequence.py", "tests/io/test_writer.py",
         "tests/test_files.py", "tests/cli/test_config.py", "tests/cli/test_memory.py",
         "tests/reliability/test_resume.py::test_killed_and_resumed_with_the_denoiser",
         "tests/reliability/test_locks.py::test_run_after_a_killed_one_takes_over")
"""What takes seconds of the whole: `make windows` runs all of it."""


def python(*words: str, folder: Path = ROOT) -> subprocess.CompletedProcess[str]:
    """Run Python as if on Windows."""
    environment = {**os.environ,
                   "PYTHONPATH": os.pathsep.join([str(ROOT / "tests/windows"), str(ROOT)])}
    return subprocess.run([sys.executable, *words], env=environment, cwd=folder,
                          capture_output=True, text=True)


@pytest.fixture(scope="module", autouse=True)
def kernels(tmp_path_factory):
    """The kernels of a frame, compiled before: as if on Windows, nothing can be compiled."""
    made = tmp_path_factory.mktemp("kernels")
    room = ROOT / "samples" / "room" / "noisy.####.exr"
    run = ["-m", "postfx", "run", str(room), "-o", str(made / "a.####.png"), "--frames", "1-2",
           "--model", "s", "--run-up", "0"]
    subprocess.run([sys.executable, *run], cwd=ROOT, check=True, capture_output=True)


@pytest.mark.soak
def test_the_tests_of_files_and_of_the_command_line_pass():
    done = python("-m", "pytest", "-q", "-x", "-p", "no:cacheprovider", *AGAIN)
    assert done.returncode == 0, done.stdout[-3000:]
    assert " passed" in done.stdout and "failed" not in done.stdout


def test_a_run_by_names_with_backslashes(tmp_path):
    (tmp_path / "room").symlink_to(ROOT / "samples" / "room")
    run = ["-m", "postfx", "run", "room\\noisy.####.exr", "-o", "out\\", "--frames", "1-2",
           "--model", "s",
           "--run-up", "0", "--checkpoint", "0", "--compression", "piz", "--threads", "1"]
    done = python(*run, folder=tmp_path)
    assert done.returncode == 0, done.stderr
    made = sorted(path.name for path in (tmp_path / "out").iterdir())
    assert made == ["noisy.0001.exr", "noisy.0002.exr", "postfx.manifest.json"]
    assert python("-m", "postfx", "verify", "out", folder=tmp_path).returncode == 0
    chunks = python("-m", "postfx", "chunks", "room\\noisy.####.exr", "--size", "4", "-o", "out\\",
                    folder=tmp_path)
    assert chunks.stdout.splitlines()[0].startswith("postfx run room\\noisy.####.exr -o out\\ "
                                                    "--preroll auto ")


SIMULATION = """
import os, pathlib, sys, tempfile
import postfx.files as files, postfx.system as system
assert files.os.name == "nt" and os.name == "posix"
assert not hasattr(files.os, "kill") and hasattr(os, "kill")
assert not hasattr(system.mmap, "MADV_DONTNEED") and not system.Path("/proc/self/cgroup").is_file()
try:
    from postfx.tools.bench import measure
    measure.peak_memory()
except ModuleNotFoundError as error:
    assert error.name == "resource"  # the last resort, where neither /proc nor psutil says it
with tempfile.TemporaryDirectory() as folder:
    place = pathlib.Path(folder) / "file"
    place.write_text("old")
    with place.open() as reader:
        try:
            files.write_atomically(files.Path(place), lambda file: file.write(b"new"))
        except PermissionError:
            print("refused")
    files.write_atomically(files.Path(place), lambda file: file.write(b"new"))
    print(place.read_text())
"""


def test_the_simulation_refuses_what_windows_does():
    """Else the tests above say nothing."""
    done = python("-c", SIMULATION)
    assert (done.stdout, done.stderr) == ("refused\nnew\n", "")


def test_a_checkpoint_is_read_where_a_mapped_file_cannot_be_replaced(tmp_path, monkeypatch):
    path = tmp_path / "a.checkpoint"
    history = {"mean": np.arange(12, dtype=np.float32).reshape(3, 4),
               "count": np.float64(3).reshape(())}
    save_checkpoint(path, About("run", "pattern", 4, "print"), history, lambda: None)
    mapped = load_checkpoint(path)
    monkeypatch.setattr("postfx.runs.folder.os", SimpleNamespace(name="nt"))
    found = load_checkpoint(path)
    assert (isinstance(mapped["mean"], np.memmap)
            and not any(isinstance(one, np.memmap) for one in found.values()))
    for name, array in history.items():
        np.testing.assert_array_equal(found[name], array)
        assert found[name].shape == array.shape and found[name].dtype == array.dtype
        assert not found[name].flags.writeable


def test_a_file_is_removed_as_soon_as_its_reader_is_done(monkeypatch):
    monkeypatch.setattr(files, "os", SimpleNamespace(name="nt"))
    waits, left = [], [2]

    def work() -> str:
        left[0] -= 1
        if left[0] >= 0:
            raise PermissionError("it is being read")
        return "done"

    monkeypatch.setattr(files.time, "sleep", waits.append)
    assert files.despite_readers(work) == "done" and waits == [0.01, 0.03]
    left[0] = 99
    with pytest.raises(PermissionError):
        files.despite_readers(work)


def test_a_picture_is_not_begun_where_the_temporary_folder_is_full(monkeypatch):
    monkeypatch.delattr("os.memfd_create", raising=False)
    with pytest.raises(OSError, match="No space left"), files.memory_file(".jpg", 1 << 62):
        pass
    with files.memory_file(".jpg", 10) as path:
        path.write_bytes(b"some")
    assert not path.exists()


def test_the_cache_is_where_the_system_keeps_caches(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert system.private_folder("kernels") == tmp_path / "postfx" / "kernels"
    monkeypatch.delattr("os.getuid")
    monkeypatch.setattr("getpass.getuser", lambda: "somebody")
    assert system.private_folder("kernels") == tmp_path / "postfx" / "kernels"
