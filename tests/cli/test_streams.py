"""Standard output and error: closed, full, or read by nobody, they stop no frame, and no name
controls a terminal."""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import postfx
from postfx.cli.main import main
from postfx.frame import Frame, Role
from postfx.io.writer import write_frame

COMMAND = f"{sys.executable} -m postfx"
RUN = f"{COMMAND} run shot/in.####.exr -o out/ --denoise-only --model classic --overwrite"
JOBS = {
    "run": (RUN, 0), "run --json": (f"{RUN} --json", 0), "plan": (f"{RUN} --dry-run", 0),
    "verify": (f"{COMMAND} verify whole", 0), "models": (f"{COMMAND} models", 0),
    "help": (f"{COMMAND} run --help", 0),
    "an error": (f"{COMMAND} run nowhere.####.exr -o out/", 2),
    "wrong words": (f"{COMMAND} run --wrong", 2),
}
STREAMS = {
    "closed output": "{} >&-", "closed error": "{} 2>&-", "both closed": "{} >&- 2>&-",
    "all closed": "{} <&- >&- 2>&-", "full output": "{} >/dev/full", "full error": "{} 2>/dev/full",
    "both full": "{} >/dev/full 2>/dev/full",
    "a reader that goes away": "({}; echo $? >code) | true; exit $(cat code)",
    "a reader of errors that goes away": "({}; echo $? >code) 2>&1 >/dev/null | true; exit $(cat "
    "code)",
}
FRAMES = 2

pytestmark = pytest.mark.skipif(not os.path.exists("/dev/full"),
                                reason="there is no full device here")


@pytest.fixture(scope="module")
def place(tmp_path_factory) -> Path:
    """A folder with frames, and a whole output."""
    folder = tmp_path_factory.mktemp("streams")
    (folder / "shot").mkdir()
    for number in range(1, FRAMES + 1):
        colour = np.random.default_rng(number).random((24, 32, 3), np.float32)
        write_frame(folder / f"shot/in.{number:04d}.exr", Frame({Role.COLOUR: colour}))
    assert shell(folder, RUN.replace("out/", "whole/")).returncode == 0
    return folder


def shell(folder: Path, line: str) -> subprocess.CompletedProcess[str]:
    sources = str(Path(postfx.__file__).parents[1])
    environment = {**os.environ, "PYTHONPATH": sources}
    return subprocess.run(["sh", "-c", line], cwd=folder, env=environment, capture_output=True,
                          text=True, timeout=120)


MORE = ("closed error", "both closed", "both full")
"""Streams that a job beside `run --json` has, too."""
MOST = [
    pytest.param("run --json", stream, marks=pytest.mark.soak if stream in MORE else [])
    for stream in STREAMS] + [
    (job, stream) for job in ("an error", "models") for stream in ("both closed", "both full")] + [
    ("run", "full error"), ("plan", "a reader that goes away"), ("verify", "full output"),
    ("help", "both full"), ("wrong words", "closed error")]


@pytest.mark.parametrize(("job", "stream"), MOST)
def test_the_job_is_done_and_its_exit_code_told(place, job, stream):
    command, code = JOBS[job]
    for path in place.glob("out/*"):
        if path.is_file():
            path.unlink()
    done = shell(place, STREAMS[stream].format(command))
    assert done.returncode == code
    assert "Traceback" not in done.stderr + done.stdout and "Exception" not in done.stderr
    if job.startswith("run"):
        for number in range(1, FRAMES + 1):
            name = f"in.{number:04d}.exr"
            assert (place / "out" / name).read_bytes() == (place / "whole" / name).read_bytes()


ESCAPE = "\x1b[31m\x1b]0;title\x07\x9b2J"


@pytest.mark.parametrize("verb",
                         ["inspect", "run {} -o out/ --dry-run",
                          "run {} -o out/ --denoise-only --overwrite --model classic",
                          "inspect {} --profile {}.toml", "verify {}", "exposure {}",
                          "chunks {} -o out/ --size 1 --", "interpolate {} -o between/", "{}",
                          "run {}x -o out/", "config", "bench {} -o b/", "models --{}", "run --{}"])
def test_no_name_controls_the_terminal(tmp_path, verb, monkeypatch, capfd):
    folder = tmp_path / f"a{ESCAPE}"
    folder.mkdir()
    for number in (1, 2):
        planes = {Role.COLOUR: np.ones((24, 32, 3), np.float32)}
        write_frame(folder / f"in{ESCAPE}.{number:04d}.exr",
                    Frame(planes, metadata={"note": ESCAPE}))
    (tmp_path / "postfx.toml").write_text('[run]\npreset = "a\\u001b[31m"\n' if verb == "config"
                                          else "")
    words = [word.replace("{}", folder.name)
             for word in (verb if "{}" in verb else f"{verb} {{}}").split()]
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("POSTFX_CONFIG", raising=False)
    with contextlib.suppress(SystemExit):
        main(words)
    told = "".join(capfd.readouterr())
    assert told and not {letter for letter in told if not letter.isprintable()} - {"\n", "\t"}
    assert "Traceback" not in told


def test_names_that_a_terminal_cannot_show_are_no_error(place):
    line = f"PYTHONUTF8=0 LC_ALL=C PYTHONIOENCODING=ascii {COMMAND} inspect 'shot/\u00e4.exr'"
    done = shell(place, line)
    assert done.returncode == 2 and "error: shot/?" in done.stderr
