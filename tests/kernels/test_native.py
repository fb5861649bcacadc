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
    "postfx.interpolate.timing.count_marks": [["<u4:1", "q"], ["<i8:1", "q"], ["<f8:1", "q"]],
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
from postfx.interpolate.timing import count_marks
from postfx.kernels.numeric import clamp, compiled

random = np.random.default_rng(1)
values = random.integers(0, 256, 1002, np.uint8)


def results(call):
    return [call(count_marks, values.astype(kind), 100) for kind in (np.uint32, np.int64, np.float64)]


native_results = results(lambda function, *arguments: function(*arguments))
assert "numba" not in sys.modules and "llvmlite" not in sys.modules
for one, other in zip(native_results, results(lambda function, *arguments: function.dispatcher(*arguments)),
                      strict=True):
    assert type(one) is type(other), (one, other)
    assert one == other > 0

known = len(count_marks.dispatcher.overloads)
assert count_marks(np.arange(7, dtype=np.uint32)[::2], 4) == 2  # with gaps: Numba's
assert len(count_marks.dispatcher.overloads) == known + 1


@compiled
def double(x):
    return 2 * clamp(x, 0, 1)


assert double(np.float32(3)) == 2  # it calls one that is not in the library, and is put into it
"""

PRODUCTS = """
import numpy as np

from postfx.kernels import native

native.FOLDER = native.FOLDER / "nowhere"
from postfx.kernels.vectors import multiply_codes, turn_codes, wide_rows

random = np.random.default_rng(2)
codes = random.integers(0, 256, (50, 12)).astype(np.uint8)
factors = random.integers(-64, 65, (8, 12)).astype(np.int8)
codes[0], factors[4] = 255, 64
turned, sums = np.zeros((3, wide_rows(50)), np.int32), np.zeros((4, wide_rows(50)), np.int32)
turn_codes(codes, turned)
multiply_codes(turned, factors, 4, sums)
np.testing.assert_array_equal(sums[:, :50], factors[4:].astype(int) @ codes.T.astype(int))
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


@pytest.mark.parametrize("level", native.LEVELS)
def test_products_of_8_bits_are_exact_at_every_level(level):
    levels = list(native.LEVELS)
    if native.processor_level() not in levels[:levels.index(level) + 1]:
        pytest.skip("a higher level than this processor's")
    run(PRODUCTS, **native.target_of(level))


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
    form = next(iter(functions()["postfx.interpolate.timing.count_marks"].values()))
    form._check(0)
    with pytest.raises(RuntimeError, match="kernel postfx.interpolate.timing.count_marks failed"):
        form._check(1)
