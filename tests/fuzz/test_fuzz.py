"""A few seconds of coverage-guided fuzzing of everything that reads what others wrote."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from tests.fuzz.targets import TARGETS

SECONDS = 4


@pytest.mark.parametrize("target", TARGETS)
def test_any_input_is_read_or_refused_in_one_line(target: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """No crash, no hang, no memory over the limit; more with `python tests/fuzz/fuzz.py TARGET SECONDS`."""
    pytest.importorskip("atheris")
    monkeypatch.setenv("POSTFX_FUZZ_OUT", str(tmp_path))
    script = Path(__file__).with_name("fuzz.py")
    done = subprocess.run([sys.executable, str(script), target, str(SECONDS)], capture_output=True, text=True,
                          check=False, timeout=180, errors="replace")
    assert done.returncode == 0, f"{sorted(tmp_path.iterdir())}\n{done.stderr[-3000:]}"
    runs = [line for line in done.stderr.splitlines() if line.startswith("stat::number_of_executed_units")]
    assert int(runs[0].split()[-1]) > 20, done.stderr[-2000:]
