"""Frames that a program writes while it ends are written."""

import os
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


SLOWLY = """
begun = threading.Event()
def relax():
    begun.set()
    time.sleep(0.3)

threading.Thread(target=postfx.write_frame, args=("late.exr", frame, relax), daemon=True).start()
begun.wait()
"""


def test_a_frame_that_a_daemon_thread_began_to_write_is_written(tmp_path: Path):
    done = subprocess.run([sys.executable, "-c", PROGRAM + SLOWLY], cwd=tmp_path, timeout=60,
                          capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")
    assert (read_sequence(str(tmp_path / "late.exr")).read(1)[Role.COLOUR] == 1).all()


FORK = """
import os
begun = threading.Event()
def relax():
    begun.set()
    time.sleep(1)

writer = threading.Thread(target=postfx.write_frame, args=("late.exr", frame, relax))
writer.start()
begun.wait()
child = os.fork()
if child == 0:
    began = time.monotonic()
    atexit._run_exitfuncs()
    os._exit(time.monotonic() - began > 20)
sys.exit(os.waitpid(child, 0)[1] >> 8)
"""


@pytest.mark.skipif(not hasattr(os, "fork"), reason="this system has no fork")
def test_a_forked_child_waits_for_no_thread_of_its_parent(tmp_path: Path):
    done = subprocess.run([sys.executable, "-c", PROGRAM + FORK], cwd=tmp_path, timeout=60,
                          capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "late.exr").exists()


def test_a_pool_that_its_owner_ended_takes_no_more_work():
    pool = Workers(1)
    assert pool.submit(int, "1").result() == 1
    pool.shutdown()
    with pytest.raises(RuntimeError, match="after shutdown"):
        pool.submit(int, "2")
