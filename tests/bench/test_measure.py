"""The process that measures one method."""

import json
import subprocess
import sys

import numpy as np
import pytest

pytest.importorskip("flip_evaluator", reason="needs the extra 'bench'")
from postfx.compiled import library  # noqa: E402
from postfx.errors import BenchError  # noqa: E402
from postfx.tools.bench import measure  # noqa: E402
from postfx.tools.bench.measure import Task, peak_memory, run_task, timing  # noqa: E402
from postfx.tools.bench.methods import OTHERS, Method  # noqa: E402


def test_timing_of_runs():
    times = {"wall_ms": [[9.0, 1.0, 1.0], [2.0, 2.0, 90.0], [3.0, 3.0, 3.0]],
             "cpu_s": [[1.0, 2.0, 3.0]] * 3,
             "device_ms": [[0.5, 0.5, 4.0]] * 3, "first_ms": 50.0, "peak_mb": 100.0}
    found = timing(times, "cpu")
    assert [found[key] for key in ("wall_ms", "wall_ms_min", "wall_ms_max", "cpu_s")] == [2, 1, 3,
                                                                                          2]
    assert found["gpu_ms"] is None and timing(times, "cuda")["gpu_ms"] == 0.5


def test_peak_memory_is_the_process_own():
    """A parent that is large when it starts another process does not count there."""
    ballast = np.ones(150_000_000 // 8)
    code = "from postfx.tools.bench.measure import peak_memory; import numpy as n; "
    code += "b = peak_memory(); a = n.ones(25_000_000); print([b, peak_memory()])"
    before, after = json.loads(subprocess.check_output([sys.executable, "-c", code], text=True))
    assert 190 < after - before < 230
    assert peak_memory() > before + ballast.nbytes / 1e6 / 2


@pytest.fixture
def task(write_exr, tmp_path):
    """Makes a task on one small frame."""
    path = write_exr("in/noisy.0001.exr", dict.fromkeys("RGB", np.ones((16, 24))))

    def make(method: Method, **facts) -> Task:
        usual = {"guides": None, "profile": None, "frames": (1,), "scale": 2.0, "size": (32, 48),
                 "device": "cpu",
                 "threads": 1, "runs": 2, "output": str(tmp_path / "out.{number}.exr")}
        return Task(method, str(path.parent / "noisy.####.exr"), **usual | facts)

    return make


def test_a_task_survives_json(task):
    lacking = Method("m-without-depth", "m", "ours", "m", without=("depth",))
    for method in (OTHERS[0], lacking):
        assert Task.from_json(task(method).to_json()) == task(method)


@pytest.fixture
def no_kernels(tmp_path, monkeypatch):
    """A folder where kernels are compiled anew. Those that are there already are forgotten, and
    found again afterwards."""
    def forget():
        for kept in (library._whole_library, library.open_library, library._form):
            kept.cache_clear()
        library._compiled_parts.clear()

    folder = tmp_path / "native"
    with monkeypatch.context() as patch:
        patch.setattr(library, "_folders", lambda own: [folder])
        forget()
        yield folder
    forget()


def test_the_first_use_of_a_machine_does_not_count(task, tmp_path, monkeypatch, no_kernels):
    """Kernels are compiled in a first process, whose times are forgotten."""
    assert measure.measure(task(OTHERS[-1])) is None
    assert list(no_kernels.glob("*-*.*"))
    answers, runs, run = [{"again": True}], [], measure._run_process
    monkeypatch.setattr(measure, "_run_process",
                        lambda *words: answers.pop() if answers else run(*words))
    times = run_task(task(OTHERS[-1]), runs.append)
    assert not answers and runs == [1, 2] and len(times["wall_ms"]) == 2
    assert (tmp_path / "out.0001.exr").is_file()


def test_a_method_that_fails_says_why(task):
    with pytest.raises(BenchError, match="method 'x': no network 'none.fp32': give s"):
        run_task(task(Method("x", "x", "ours", model="none")), print)


def test_a_process_that_ends_without_a_word(task, monkeypatch):
    monkeypatch.setattr(measure.sys, "executable", "/bin/false")
    with pytest.raises(BenchError, match="method 'bicubic': it ended with code 1"):
        run_task(task(OTHERS[-1]), print)
