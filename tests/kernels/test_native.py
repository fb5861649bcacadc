"""Kernels that come compiled: the same results as Numba's, without Numba; and Numba wherever they do not fit."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from postfx.kernels import native

REPOSITORY = Path(__file__).resolve().parents[2]
WANTED = {
    "postfx.kernels.pixel_formats.predict_bytes": [["|u1:1", "|u1:1"], ["|u1:1r", "|u1:1"]],
    "postfx.kernels.pixel_formats.dither_rows": [["<f4:2", "f", "<f4:2", "|u1:2"]],
    "postfx.kernels.partner.enlarge_motion_rows": [["q", "q", "<f4:3", "<f4:1", "<f4:1", "<f4:1", "<f4:3"]],
    "postfx.runtime.threads.is_called": [["<i8:2", "q", "q", "q"]],
    "postfx.runtime.threads.hand_out": [["<i8:2", "q", "q", "q", "q"]],
    "postfx.runtime.threads.run_entry": [["q", "q"]],
    "postfx.runtime.threads.are_done": [["<i8:2", "q", "q"]],
    "postfx.runtime.threads.pauses": [["q"]],
}
BUILD = """
import json, sys
from pathlib import Path
from build_kernels import make_library
functions, path, level = sys.argv[1:]
make_library({name: list(map(tuple, forms)) for name, forms in json.loads(functions).items()}, Path(path), level)
"""
USE = """
import sys
from pathlib import Path

import numpy as np

from postfx.kernels import native

native.FOLDER = Path(sys.argv[1])
from postfx.kernels.numeric import clamp, compiled
from postfx.kernels.partner import ENLARGE_MOTION, enlarge_motion_rows
from postfx.kernels.pixel_formats import dither_rows, predict_bytes
from postfx.runtime import ArgumentTable, Device
from postfx.runtime.threads import are_done

random = np.random.default_rng(1)
light = random.random((40, 48, 3), np.float32)
motion, ratio = random.random((40, 48, 2), np.float32), np.float32([2, 3])
places = np.arange(17.0, dtype="f"), np.arange(31.0, dtype="f")
values = random.integers(0, 256, 1002, np.uint8)
fixed = values.copy()
fixed.flags.writeable = False


def results(call):
    bytes_of, codes = np.zeros(1002, np.uint8), np.zeros((40, 144), np.uint8)
    small = np.zeros((17, 31, 2), np.float32)
    flat, grey = light.reshape(40, 144), np.full((64, 64), 0.5, np.float32)
    found = [call(predict_bytes, values, bytes_of), bytes_of.copy(), call(predict_bytes, fixed, bytes_of), bytes_of,
             call(dither_rows, flat, np.float32(255), grey, codes), codes,
             call(are_done, np.zeros((2, 8), np.int64), 1, 10),
             call(enlarge_motion_rows, 0, 17, motion, *places, ratio, small), small]
    return found


native_results = results(lambda function, *arguments: function(*arguments))
device = Device("cpu", threads=2)
tensors = {name: device.wrap(name, array) for name, array in zip(ENLARGE_MOTION.reads, (motion, *places, ratio),
                                                                 strict=True)}
tensors["enlarged"] = device.heap.tensor("enlarged", (17, 31, 2))
state = device.compute_state(ENLARGE_MOTION)
commands = device.command_buffer("any")
with commands.compute_encoder("any") as encoder:
    encoder.dispatch(state, ArgumentTable(state, tensors))
commands.commit()
commands.wait(timeout=60)
by_device = tensors["enlarged"].array.copy()
assert "numba" not in sys.modules and "llvmlite" not in sys.modules
for one, other in zip(native_results, results(lambda function, *arguments: function.dispatcher(*arguments)),
                      strict=True):
    assert type(one) is type(other), (one, other)
    np.testing.assert_array_equal(one, other)
assert np.ptp(by_device) > 0
np.testing.assert_array_equal(by_device, native_results[-1])

@compiled
def double(x):
    return 2 * clamp(x, 0, 1)


assert double(np.float32(3)) == 2  # it calls one that is not in the library, and is put into it
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    level = native.processor_level()
    if level is None:
        pytest.skip("no library for this processor")
    path = tmp_path_factory.mktemp("kernels")
    run(BUILD, json.dumps(WANTED), str(path / level), level, **native.target_of(level))
    return path


def run(code, *arguments, **environment):
    done = subprocess.run([sys.executable, "-c", code, *arguments], cwd=REPOSITORY, capture_output=True, text=True,
                          env={**os.environ, **environment}, timeout=300)
    assert done.returncode == 0, done.stderr


@pytest.fixture
def functions(folder, monkeypatch):
    """Opens the library anew."""
    monkeypatch.setattr(native, "FOLDER", folder)
    return native.functions.__wrapped__


def test_they_do_what_numba_does_without_it(folder):
    run(USE, str(folder))


def test_those_of_other_sources_are_not_used(folder, functions):
    assert set(functions()) == set(WANTED)
    path = folder / f"{native.processor_level()}.json"
    whole = path.read_text()
    index = json.loads(whole)
    assert "kernels/numeric.py" in index["sources"] and "temporal/reverse_motion.py" in index["sources"]
    index["sources"]["kernels/numeric.py"] = "0" * 64
    path.write_text(json.dumps(index))
    assert not functions()
    path.write_text(whole)


def test_without_a_library_or_on_another_processor_there_are_none(functions, monkeypatch, tmp_path):
    monkeypatch.setattr(native, "processor_level", lambda: None)
    assert not functions()
    monkeypatch.undo()
    monkeypatch.setattr(native, "FOLDER", tmp_path)
    assert not native.functions.__wrapped__()


def test_a_function_that_fails_is_an_error(functions):
    (form,) = functions()["postfx.runtime.threads.pauses"].values()
    form._check(0)
    with pytest.raises(RuntimeError, match="kernel postfx.runtime.threads.pauses failed"):
        form._check(1)
