"""Render training clips on all GPUs of a machine.

    python -m training.datagen.render --out DIR --clips N --gpus 0,1,2,3 ...

Existing clips are kept, so the same command continues an earlier one. A worker that dies or hangs
is restarted; its clip goes into DIR/failed.txt and is skipped from then on (delete the file to try
again). DIR/worker.K.log has the messages of worker K. SIGTERM and Ctrl-C end the job at once and
leave no broken files.
"""

from __future__ import annotations

import argparse
import json
import os
import queue
import signal
import subprocess
import sys
import threading
import time
from collections import deque
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from training.datagen.render_worker import add_options, clip_path

GIVE_UP = 3  # deaths of a worker in a row, without a clip between them


@dataclass
class Worker:
    """A process for one GPU, and the clip that it is making."""

    gpu: str
    number: int
    process: subprocess.Popen[str] | None = None
    clip: int | None = None
    ready: bool = False
    since: float = 0.0
    deaths: int = 0

    @property
    def running(self) -> subprocess.Popen[str]:
        """Its process, which was started."""
        assert self.process is not None
        return self.process


def options() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    add_farm(parser)
    parser.set_defaults(handed=add_options(parser))
    return parser


def arguments(argv: list[str] | None = None) -> tuple[argparse.Namespace, list[str]]:
    """The options, and the command of a worker."""
    args = options().parse_args(argv)
    return args, worker_command("training.datagen.render_worker", args, args.handed)


def add_farm(parser: argparse.ArgumentParser) -> None:
    """Add the options of a Farm."""
    parser.add_argument("--out", type=Path, required=True, help="folder for clip.NNNNN.npz")
    parser.add_argument("--clips", type=int, required=True,
                        help="clips of the whole job, existing ones included")
    parser.add_argument("--gpus", default="0", help="numbers of the GPUs, comma-separated")
    parser.add_argument("--processes-per-gpu", type=int, default=8)
    parser.add_argument("--minutes", type=float, default=1e9, help="start no clip after this time")
    parser.add_argument("--clip-minutes", type=float, default=5,
                        help="a clip that takes longer is given up")
    parser.add_argument("--report", type=float, default=10,
                        help="seconds between two lines of progress")


def worker_command(module: str, args: argparse.Namespace, handed: list[str],
                   *words: str) -> list[str]:
    """Command line of a worker: a module, its command if it has several, and the options to hand
    on, by name."""
    values = {name: getattr(args, name) for name in handed}
    options = [f"--{name.replace('_', '-')}={value}"
               for name, value in values.items() if value is not None]
    return [sys.executable, "-m", module, *words, "--listen", f"--out={args.out}",
            f"--clips={args.clips}", *options]


class Farm:
    """Hands clip numbers to the workers and counts their answers.

    `command` starts a worker: it reads clip numbers from standard input and answers on standard
    output, {"ready": true} once and {"clip": number, "samples": count} for each.
    """

    def __init__(self, args: argparse.Namespace, command: list[str]) -> None:
        self._args, self._command = args, command
        self._failed = args.out / "failed.txt"
        lines = self._failed.read_text().splitlines() if self._failed.exists() else []
        skipped = {int(line.split()[0]) for line in lines}
        there = {index for index in range(args.clips) if clip_path(args.out, index).exists()}
        self._todo = deque(index for index in range(args.clips) if index not in there | skipped)
        self._events: queue.SimpleQueue[Any] = queue.SimpleQueue()
        slots = [gpu for _ in range(args.processes_per_gpu) for gpu in args.gpus.split(",")]
        self._workers = [Worker(gpu, k) for k, gpu in enumerate(slots)]
        self._began, self._ended = time.monotonic(), False
        self.there, self.made, self.samples, self.lost = len(there), 0, 0, 0

    def stop(self, *_: object) -> None:
        """End now; safe to call from a signal handler."""
        self._ended = True
        self._events.put((None, None, ""))

    def run(self) -> bool:
        """Work until all clips are made, the time is up or `stop` is called. False if workers kept
        failing."""
        for worker in self._workers:
            self._start(worker)
        reported = time.monotonic()
        while not self._ended and any(worker.process for worker in self._workers):
            try:
                worker, process, line = self._events.get(timeout=1)
                if worker is not None and worker.process is process:
                    self._answer(worker, line)
            except queue.Empty:
                pass
            self._end_hanging()
            if time.monotonic() - reported > self._args.report:
                print(self.progress(), flush=True)
                reported = time.monotonic()
        self._kill()
        self._count_untold()
        return self._ended or all(worker.deaths < GIVE_UP for worker in self._workers)

    def _start(self, worker: Worker) -> None:
        """Start a new process with its first clip, if any is left."""
        worker.process, worker.clip, worker.ready = None, None, False
        if not self._todo or self._late() or worker.deaths >= GIVE_UP:
            return
        environment = os.environ | {"CUDA_VISIBLE_DEVICES": worker.gpu}
        environment.setdefault("OMP_NUM_THREADS", "2")
        with open(self._args.out / f"worker.{worker.number}.log", "a") as log:
            worker.process = subprocess.Popen(self._command, stdin=subprocess.PIPE,
                                              stdout=subprocess.PIPE, stderr=log,
                                              text=True, env=environment)
        threading.Thread(target=self._listen, args=(worker, worker.process), daemon=True).start()
        self._next(worker)

    def _listen(self, worker: Worker, process: subprocess.Popen[str]) -> None:
        assert process.stdout is not None, "it is a pipe"
        for line in process.stdout:
            self._events.put((worker, process, line))
        process.wait()
        self._events.put((worker, process, ""))

    def _next(self, worker: Worker) -> None:
        """Hand out a clip. When none is left, the worker ends by itself."""
        worker.clip, pipe = None, worker.running.stdin
        assert pipe is not None
        try:
            if self._todo and not self._late():
                worker.clip, worker.since = self._todo.popleft(), time.monotonic()
                pipe.write(f"{worker.clip}\n")
                pipe.flush()
            else:
                pipe.close()
        except BrokenPipeError:
            pass  # it has died: the end of its output follows

    def _answer(self, worker: Worker, line: str) -> None:
        if not line:
            self._died(worker)
        elif line.startswith("{"):
            self._count(worker, json.loads(line))

    def _count(self, worker: Worker, answer: dict[str, Any]) -> None:
        worker.ready, worker.since = True, time.monotonic()
        if "clip" in answer:
            self.made, self.samples = self.made + 1, self.samples + answer["samples"]
            worker.deaths = 0
            self._next(worker)

    def _died(self, worker: Worker) -> None:
        """Restart a worker. The clip that it died of is skipped; one that it never began goes back
        to the queue."""
        self._sweep(worker.running.pid)
        clip = worker.clip
        reason = f"exit status {worker.running.returncode}, see worker.{worker.number}.log"
        if clip is not None:
            worker.deaths += 1
            print(f"worker {worker.number} ended at clip {clip}: {reason}", flush=True)
        if clip is not None and worker.ready:
            self.lost += 1
            with open(self._failed, "a") as file:
                file.write(f"{clip} {reason}\n")
        elif clip is not None:
            self._todo.appendleft(clip)
        self._start(worker)

    def _end_hanging(self) -> None:
        for worker in self._workers:
            if (worker.clip is not None
                and time.monotonic() - worker.since > 60 * self._args.clip_minutes):
                worker.running.kill()

    def _kill(self) -> None:
        running = [worker.process
                   for worker in self._workers if worker.process and worker.process.poll() is None]
        for process in running:
            process.kill()
        for process in running:
            process.wait()
            self._sweep(process.pid)

    def _count_untold(self) -> None:
        """Count clips whose workers finished them but were stopped before they could answer."""
        untold = [worker.clip for worker in self._workers if worker.clip is not None]
        self.made += sum(clip_path(self._args.out, clip).exists() for clip in untold)

    def _sweep(self, pid: int) -> None:
        """Remove the unfinished file of a killed worker."""
        for partial in self._args.out.glob(f".clip.*.{pid}.partial.npz"):
            partial.unlink()

    def _late(self) -> bool:
        return time.monotonic() - self._began > 60 * self._args.minutes

    def progress(self) -> str:
        """One line: clips, speed, time left."""
        seconds = time.monotonic() - self._began
        rate, done = self.made / seconds, self.there + self.made
        busy = sum(worker.clip is not None for worker in self._workers)
        left = (len(self._todo) + busy) / rate / 60 if self.made else self._args.minutes
        left = f"{min(left, max(self._args.minutes - seconds / 60, 0)):.1f}" if left < 1e6 else "?"
        return (f"{done}/{self._args.clips} clips, {rate:.2f} clips/s, "
                f"{self.samples / seconds / 1e6:.1f} M samples/s, {left} min left, {self.lost} "
                "failed")

    def summary(self) -> str:
        seconds = time.monotonic() - self._began
        size = sum(path.stat().st_size for path in self._args.out.glob("clip.*.npz"))
        return (f"made {self.made} clips in {seconds / 60:.1f} min: {self.made / seconds:.2f} "
                f"clips/s, {self.samples / seconds / 1e6:.1f} M samples/s, {self.lost} failed; "
                f"{self.there + self.made} of {self._args.clips} are in {self._args.out}, "
                f"{size / 2**30:.2f} GiB")


def run(args: argparse.Namespace, command: list[str]) -> int:
    """Run a farm; returns the exit code."""
    args.out.mkdir(parents=True, exist_ok=True)
    farm = Farm(args, command)
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, farm.stop)
    worked = farm.run()
    print(farm.summary(), flush=True)
    return 0 if worked else 1


if __name__ == "__main__":
    sys.exit(run(*arguments()))
