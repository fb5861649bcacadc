"""The toy training of docs/howto/train.md, by the page's own commands: held-out quality rises."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("torch")

ROOT = Path(__file__).resolve().parents[3]
PAGE = ROOT / "docs/howto/train.md"
LEAST_GAIN = 0.3  # dB


def commands() -> list[str]:
    """The lines of the section's block of code."""
    section = PAGE.read_text(encoding="utf-8").partition("## In a minute")[2]
    found = re.search(r"```sh\n(.*?)```", section, re.DOTALL)
    assert found
    return found[1].splitlines()


@pytest.mark.soak
def test_held_out_quality_rises(tmp_path: Path) -> None:
    threads, *lines = commands()
    name, _, value = threads.removeprefix("export ").partition("=")
    environment = os.environ | {"PYTHONPATH": str(ROOT), name: value}
    quality = []
    for line in lines:
        words = [sys.executable, *line.split()[1:]]
        done = subprocess.run(words, cwd=tmp_path, env=environment, capture_output=True, text=True,
                              check=True)
        told = re.findall(r"^validation (\{.*\})$", done.stdout, re.MULTILINE)
        quality += [json.loads(told[-1])["validation_psnr"]] if told else []
    start, end = quality
    assert end > start + LEAST_GAIN
