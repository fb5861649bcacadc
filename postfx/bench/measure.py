"""Measures methods one after the other, each in a process of its own, and scores what they wrote."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from statistics import median
from typing import Any

import postfx
from postfx.bench.material import Material
from postfx.bench.metrics import SequenceScore
from postfx.bench.worker import Task
from postfx.errors import BenchError

ATTEMPTS = 4
"""The first process may compile kernels, and so may others on the machine meanwhile."""


def run_task(task: Task, tell: Callable[[int], None]) -> dict[str, Any]:
    """Times of a task, as `worker.measure` gives them; `tell` is called with the count of finished runs.

    Raises BenchError when the process fails.
    """
    for _ in range(ATTEMPTS):
        last = _run_process(task, tell)
        if "times" in last:
            times: dict[str, Any] = last["times"]
            return times
        if "error" in last:
            break
    raise BenchError(f"method '{task.method.name}': {last.get('error', 'kernels keep being compiled: try again')}")


def _run_process(task: Task, tell: Callable[[int], None]) -> dict[str, Any]:
    """The last thing that the worker said; an error where it ended badly."""
    package = str(Path(postfx.__file__).resolve().parent.parent)
    path = os.pathsep.join(filter(None, [package, os.environ.get("PYTHONPATH")]))
    command = [sys.executable, "-m", "postfx.bench.worker"]
    last: dict[str, Any] = {}
    with tempfile.TemporaryFile("w+") as words, tempfile.TemporaryFile("w+") as complaints:
        words.write(task.to_json() + "\n")
        words.seek(0)
        environment = {**os.environ, "PYTHONPATH": path}
        with subprocess.Popen(command, stdin=words, stdout=subprocess.PIPE, stderr=complaints, text=True,
                              env=environment) as process:
            for line in process.stdout or ():
                last = _message(line) or last
                if "run" in last:
                    tell(last["run"])
        complaints.seek(0)
        lines = complaints.read().strip().splitlines()
    if process.returncode and "error" not in last:
        return {"error": lines[-1] if lines else f"it ended with code {process.returncode}"}
    return last


def timing(times: dict[str, Any], device: str) -> dict[str, Any]:
    """The figures of interest; gpu_ms is None on the CPU.

    A run's milliseconds are the median over its frames, since other work on the machine slows single frames; then the
    median, least and most over the runs. cpu_s is the mean over frames, and its median over the runs.
    """
    wall = [median(run) for run in times["wall_ms"]]
    gpu = [median(run) for run in times["device_ms"]]
    return {
        "wall_ms": median(wall),
        "wall_ms_min": min(wall),
        "wall_ms_max": max(wall),
        "cpu_s": median(sum(run) / len(run) for run in times["cpu_s"]),
        "gpu_ms": median(gpu) if device != "cpu" else None,
        "first_ms": times["first_ms"],
        "peak_mb": times["peak_mb"],
    }


def score(material: Material, pattern: str) -> SequenceScore:
    """Scores of the results that a method wrote."""
    scores = SequenceScore()
    for number in material.noisy.numbers:
        result = next(iter(material.result(pattern, number).planes.values()))
        scores.add(result, material.reference(number), material.motion(number))
    return scores


def _message(line: str) -> dict[str, Any] | None:
    """A worker's line; None for what a library printed."""
    try:
        found = json.loads(line)
    except ValueError:
        return None
    return found if isinstance(found, dict) else None

