"""The process that measures one method."""

import json
import subprocess
import sys

import numpy as np

from postfx.bench.measure import timing
from postfx.bench.worker import peak_memory


def test_timing_of_runs():
    times = {"wall_ms": [[9.0, 1.0, 1.0], [2.0, 2.0, 90.0], [3.0, 3.0, 3.0]], "cpu_s": [[1.0, 2.0, 3.0]] * 3,
             "device_ms": [[0.5, 0.5, 4.0]] * 3, "first_ms": 50.0, "peak_mb": 100.0}
    found = timing(times, "cpu")
    assert [found[key] for key in ("wall_ms", "wall_ms_min", "wall_ms_max", "cpu_s")] == [2, 1, 3, 2]
    assert found["gpu_ms"] is None and timing(times, "cuda")["gpu_ms"] == 0.5


def test_peak_memory_is_the_process_own():
    """A parent that is large when it starts another process does not count there."""
    ballast = np.ones(150_000_000 // 8)
    code = "from postfx.bench.worker import peak_memory; import numpy as n; b = peak_memory(); a = n.ones(25_000_000); "
    code += "print([b, peak_memory()])"
    before, after = json.loads(subprocess.check_output([sys.executable, "-c", code], text=True))
    assert 190 < after - before < 230
    assert peak_memory() > before + ballast.nbytes / 1e6 / 2
