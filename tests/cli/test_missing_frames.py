"""`--on-error copy` beside every option that looks at frames: those that are missing lose no run."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from postfx.cli.main import main


@pytest.fixture
def troubled(write_exr, tmp_path: Path, monkeypatch) -> Path:
    """Six frames: the second is cut short, the third is missing, the fourth lacks the motion that others have."""
    random = np.random.default_rng(0)
    for number in (1, 2, 4, 5, 6):
        planes = {name: random.random((32, 48), np.float32) for name in "RGB"}
        planes |= {"motion.X": np.zeros((32, 48)), "motion.Y": np.zeros((32, 48))} if number != 4 else {}
        write_exr(f"in/shot.{number:04d}.exr", planes)
    second = tmp_path / "in/shot.0002.exr"
    second.write_bytes(second.read_bytes()[:900])
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.parametrize("options", [
    ("--report", "report.html"), ("--capture", "look"), ("--both-ways",), ("--run-up", "2"), ("--exposure", "smooth"),
    ("--log", "log.jsonl", "--checkpoint", "0"), ("--tonemap", "--report", "report.html"),
], ids=" ".join)
def test_missing_frames_lose_no_run(troubled, capsys, options):
    run = ["run", "in/shot.####.exr", "-o", "out/", "--device", "cpu", "--model", "s", "--on-error", "copy", "--json"]
    assert main([*run, *options]) == 3
    report = json.loads(capsys.readouterr().out)
    assert [(fault["frame"], fault["instead"]) for fault in report["faults"]] == [
        (2, "left out"), (3, "left out"), (4, "resampled")]
    assert sorted(path.name[5:9] for path in (troubled / "out").glob("*.exr")) == ["0001", "0004", "0005", "0006"]
    assert "--report" not in options or (troubled / "report.html").is_file()
    assert "--capture" not in options or json.loads((troubled / "look/capture.json").read_text())["buffers"]
