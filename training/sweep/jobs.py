"""Train variants one after the other on each of several GPUs."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections import deque
from dataclasses import dataclass
from pathlib import Path

import torch

FRESH = ("checkpoint.pt", "checkpoint.tmp", "log.csv", "validation.csv")
SAID = "said.txt"


@dataclass
class Job:
    """A process that trains a variant on a GPU."""

    name: str
    gpu: str
    process: subprocess.Popen


def notes(folder: Path) -> dict | None:
    """What a run's checkpoint tells of its training; None where there is no checkpoint."""
    path = folder / "checkpoint.pt"
    return torch.load(path, map_location="cpu", weights_only=True)["notes"] if path.exists() else None


class Queue:
    """Hands variants to GPUs as they become free. Runs that had their minutes are kept, others begin anew.

    `options` are those of training.train_denoise, but for --out.
    """

    def __init__(self, names: list[str], out: Path, gpus: list[str], minutes: float, options: list[str]) -> None:
        self._out, self._gpus, self._minutes, self._options = out, gpus, minutes, options
        self._todo = deque(name for name in names if not self._is_finished(name))
        self._all, self._jobs, self.failed = len(names), [], []
        threads = max(1, (os.cpu_count() or 1) // len(gpus))
        self._environment = {"OMP_NUM_THREADS": str(threads)} | os.environ

    def run(self, pause: float = 1.0, report: float = 30.0) -> None:
        """Until every variant is trained or has failed; ends its processes where it is interrupted."""
        print(f"{self._all - len(self._todo)} of {self._all} variants are there already", flush=True)
        reported = time.monotonic()
        try:
            while self._todo or self._jobs:
                self._start_all()
                time.sleep(pause)
                self._collect()
                if time.monotonic() - reported > report and self._jobs:
                    reported = time.monotonic()
                    print("; ".join(self._state(job) for job in self._jobs), flush=True)
        finally:
            for job in self._jobs:
                job.process.kill()
                job.process.wait()

    def _is_finished(self, name: str) -> bool:
        found = notes(self._out / name)
        return found is not None and found["minutes"] > self._minutes - 0.02

    def _start_all(self) -> None:
        for gpu in self._gpus:
            if self._todo and gpu not in [job.gpu for job in self._jobs]:
                self._jobs.append(self._start(self._todo.popleft(), gpu))

    def _start(self, name: str, gpu: str) -> Job:
        folder = self._out / name
        folder.mkdir(parents=True, exist_ok=True)
        for file in FRESH:
            (folder / file).unlink(missing_ok=True)
        command = [sys.executable, "-m", "training.sweep.one", f"--variant={name}", f"--out={folder}",
                   f"--minutes={self._minutes}", *self._options]
        with (folder / SAID).open("w") as said:
            process = subprocess.Popen(command, stdout=said, stderr=subprocess.STDOUT,
                                       env=self._environment | {"CUDA_VISIBLE_DEVICES": gpu})
        print(f"{name}: begun on GPU {gpu}", flush=True)
        return Job(name, gpu, process)

    def _collect(self) -> None:
        """Take the processes that have ended off the list and tell how they did."""
        for job in [job for job in self._jobs if job.process.poll() is not None]:
            self._jobs.remove(job)
            left = len(self._todo) + len(self._jobs)
            if job.process.returncode == 0:
                found = notes(self._out / job.name)
                print(f"{job.name}: {found['validation_psnr']:.2f} dB after {found['steps']} steps on "
                      f"{found['clips']} clips, {left} left", flush=True)
            else:
                self.failed.append(job.name)
                print(f"{job.name}: failed: {self._said(job.name)} (see {self._out / job.name / SAID})", flush=True)

    def _state(self, job: Job) -> str:
        return f"{job.name} on GPU {job.gpu}: {self._said(job.name)}"

    def _said(self, name: str) -> str:
        """The last line of what a process said."""
        lines = (self._out / name / SAID).read_text(errors="replace").split("\n")
        return next((line.strip() for line in reversed(lines) if line.strip()), "nothing yet")
