"""Training spread over processes: they take the same steps, and one may stop to validate and save
meanwhile."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

torch = pytest.importorskip("torch")

from tests.training.denoise.test_train import write_clips  # noqa: E402

REPOSITORY = Path(__file__).resolve().parents[3]
RUN = """
import sys
from training.denoise import train
train.KEEP_MINUTES = 0.0
sys.argv = ["train", *sys.argv[1:]]
train.main()
"""


@pytest.mark.soak
def test_two_processes_train_one_network(tmp_path: Path) -> None:
    write_clips(tmp_path, 8)
    (tmp_path / "run.py").write_text(RUN)
    out = tmp_path / "out"
    torchrun = [sys.executable, "-m", "torch.distributed.run", "--standalone", "--nproc-per-node",
                "2"]
    options = ["--minutes", "0.07", "--batch", "1", "--crop", "32", "--widths", "16", "16", "16",
               "16", "--depth", "1"]
    options += ["--wait", "2"]
    command = [*torchrun, str(tmp_path / "run.py"), "--clips", str(tmp_path), "--out", str(out),
               *options]
    done = subprocess.run(command, cwd=REPOSITORY, capture_output=True, text=True, timeout=600,
                          check=False, env={"PYTHONPATH": str(REPOSITORY), "OMP_NUM_THREADS": "1",
                                            "PATH": "/usr/bin:/bin"})
    assert done.returncode == 0, done.stderr[-2000:]
    notes = torch.load(out / "checkpoint.pt", weights_only=True)["notes"]
    assert notes["gpus"] == 2
    assert notes["steps"] > 0
    assert len(re.findall("^validation", done.stdout, re.MULTILINE)) >= 2
