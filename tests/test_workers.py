"""Frames that a program writes while it ends are written."""

import subprocess
import sys
from pathlib import Path

import pytest

from postfx.frame import Role
from postfx.io.sequence import read_sequence
from postfx.workers import Workers

PROGRAM = """
import atexit, sys, threading, time
import numpy as np, postfx
from postfx.frame import Frame, Role

frame = Frame({Role.COLOUR: np.ones((16, 16, 3), np.float32)})
postfx.write_frame("before.exr", frame)  # its threads see that the interpreter ends

def write(name):
    time.sleep(0.5)
    postfx.write_frame(f"{name}.exr", frame)
    postfx.read_sequence(f"{name}.exr").read(1)

"""


@pytest.mark.parametrize("begin", [
    "threading.Thread(target=write, args=('late',)).start()", "atexit.register(write, 'late')",
    "threading.Thread(target=write, args=('late',)).start(); sys.exit(3)"])
def test_a_frame_is_written_while_the_interpreter_ends(tmp_path: Path, begin: str):
    done = subprocess.run([sys.executable, "-c", PROGRAM + begin], cwd=tmp_path, timeout=60,
                          capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (3 if "exit(3)" in begin else 0, "")
    assert (read_sequence(str(tmp_path / "late.exr")).read(1)[Role.COLOUR] == 1).all()


def test_a_pool_that_its_owner_ended_takes_no_more_work():
    pool = Workers(1)
    assert pool.submit(int, "1").result() == 1
    pool.shutdown()
    with pytest.raises(RuntimeError, match="after shutdown"):
        pool.submit(int, "2")
