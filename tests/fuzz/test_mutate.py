"""Damaged files, tables and settings are read or refused in a line; nothing crashes, hangs or
leaves a traceback."""

import ast
import os
import subprocess
import sys
from pathlib import Path

import pytest

COUNTS = {"exr": 150, "settings": 200, "cube": 100, "spi3d": 50, "csp": 50, "cryptomatte": 80,
          "hdr": 60, "bomb": 22}
"""Inputs of each kind; more by hand: `python -m tests.fuzz.mutate exr 10000`."""


@pytest.mark.parametrize("kind", COUNTS)
def test_damage_is_survived(kind: str, tmp_path: Path) -> None:
    root = Path(__file__).parents[2]
    path = os.pathsep.join([str(root), os.environ.get("PYTHONPATH", "")])
    done = subprocess.run([sys.executable, "-m", "tests.fuzz.mutate", kind, str(COUNTS[kind])],
                          cwd=tmp_path, capture_output=True, text=True, timeout=300, check=False,
                          errors="replace", env={**os.environ, "PYTHONPATH": path})
    assert done.returncode == 0, f"input {(tmp_path / 'at').read_text()}: {done.stderr[-2000:]}"
    outcomes = ast.literal_eval(done.stdout.splitlines()[-1])
    assert outcomes["read"] > (0 if kind == "bomb" else 4) and outcomes["refused"] > 5, outcomes
