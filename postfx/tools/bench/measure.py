"""The frames of a benchmark, and how one method is measured on them: its time, its memory and the
scores of its output.

Each method runs in its own process, so that peak memory counts this method only. `run_task` starts
the process, python -m postfx.tools.bench.measure. It reads a task as JSON from standard input and
writes progress, and at the end the times, as lines of JSON to standard output.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from statistics import median
from typing import TYPE_CHECKING, Any

import postfx
from postfx.compiled.library import CompileWatch
from postfx.errors import BenchError, MissingFrameError, PostfxError
from postfx.frame import Frame, FrameSpec, Role
from postfx.io.sequence import Sequence, read_sequence
from postfx.io.writer import write_frame
from postfx.runtime import Device
from postfx.tools.bench.methods import Chain, Method, Network, make

LEAST_RUN_SECONDS = 1.0
MOST_RUN_SECONDS = 3.0


@dataclass(frozen=True)
class Sources:
    """The user's input: patterns, a frame range and a renderer profile."""

    noisy: str
    reference: str
    guides: str | None = None
    frames: str | None = None
    profile: str | None = None


class Material:
    """Noisy frames and their references, checked before anything is measured.

    Attributes:
        noisy: the frames to process.
        spec: size, planes and guides of the first one.
        size: height and width of the references and the output.
        scale: output size over render size, 1 to 3.

    Raises BenchError if sizes do not fit, MissingFrameError if a frame has no reference, and errors
    of reading.
    """

    def __init__(self, sources: Sources) -> None:
        self.sources = sources
        self.noisy = read_sequence(sources.noisy, sources.frames, sources.profile,
                                   guides=sources.guides).first_view()
        self._references = Sequence(sources.reference)
        self._lone = len(self.noisy) == 1 and len(self._references) == 1
        self.spec = _one_spec(self.noisy, self.noisy.numbers)
        target = _one_spec(self._references,
                           [self._reference_number(number) for number in self.noisy.numbers])
        self.size = (target.height, target.width)
        self.scale = _scale(self.spec, target, self._references)
        _check_guides(self.spec, target)

    def reference(self, number: int) -> Frame:
        """Reference of a frame: its colour and header."""
        return self._references.read(self._reference_number(number), [Role.COLOUR])

    def motion(self, number: int) -> Frame:
        """The noisy frame with colour and, if it has any, motion only."""
        roles = [role for role in (Role.COLOUR, Role.MOTION) if self.spec.has(role)]
        return self.noisy.read(number, roles)

    def result(self, pattern: str, number: int) -> Frame:
        """A method's result, from the file that it wrote."""
        return next(iter(read_sequence(pattern.replace("{number}", f"{number:04d}"),
                                       planes=[Role.COLOUR])))

    def _reference_number(self, number: int) -> int:
        """Number of a frame's reference: the frame's own, unless there is one frame and one
        reference."""
        if self._lone:
            return self._references.numbers[0]
        if number not in self._references.present():
            path = self._references.pattern.path(number)
            raise MissingFrameError(
                f"{path}: frame {number} has no reference: render it, or choose frames that have "
                "one by --frames"
            )
        return number


def _one_spec(sequence: Sequence, numbers: list[int] | tuple[int, ...]) -> FrameSpec:
    """Spec of the first frame; BenchError when others differ in size."""
    first: FrameSpec | None = None
    for number in numbers:
        with sequence.open(number) as files:
            spec, path = files.spec(), files.path
        first = first or spec
        if (spec.width, spec.height) != (first.width, first.height):
            raise BenchError(
                f"{path}: is {spec.width}x{spec.height}, the first frame "
                f"{first.width}x{first.height}: measure frames of one size, chosen by --frames"
            )
    assert first is not None, "a sequence has frames"
    return first


def _scale(spec: FrameSpec, target: FrameSpec, references: Sequence) -> float:
    """The scale that turns one size into the other, as the denoiser rounds sizes."""
    sides = ((target.width, spec.width), (target.height, spec.height))
    low = max(LEAST_RUN_SECONDS, *((out - 0.5) / side for out, side in sides))
    high = min(MOST_RUN_SECONDS, *((out + 0.5) / side for out, side in sides))
    for scale in (target.width / spec.width, target.height / spec.height, (low + high) / 2):
        fits = [round(side * scale) == out for out, side in sides]
        if LEAST_RUN_SECONDS <= scale <= MOST_RUN_SECONDS and all(fits):
            return scale
    raise BenchError(
        f"{references.pattern}: references are {target.width}x{target.height}, frames "
        f"{spec.width}x{spec.height}: references must be 1 to 3 times as large, by the same factor "
        "both ways"
    )


def _check_guides(spec: FrameSpec, target: FrameSpec) -> None:
    guides = spec.guides
    if guides and (guides.width, guides.height) != (target.width, target.height):
        raise BenchError(
            f"{guides.source}: guides are {guides.width}x{guides.height}, references "
            f"{target.width}x{target.height}: render both at one size, the output's"
        )


def output_pattern(folder: Path, method: str) -> str:
    """Where a method's results go; '{number}' stands for the frame number."""
    return str(folder / "frames" / method / "frame.{number}.exr")


if TYPE_CHECKING:
    from postfx.tools.bench.metrics import SequenceScore

ATTEMPTS = 4
"""The first process may have to compile kernels, and so may other processes on the machine at the
same time."""


def run_task(task: Task, tell: Callable[[int], None]) -> dict[str, Any]:
    """Times of a task, as `measure` returns them; calls `tell` with the number of finished runs.

    Raises BenchError when the process fails.
    """
    for _ in range(ATTEMPTS):
        last = _run_process(task, tell)
        if "times" in last:
            times: dict[str, Any] = last["times"]
            return times
        if "error" in last:
            break
    raise BenchError(f"method '{task.method.name}': "
                     f"{last.get('error', 'kernels keep being compiled: try again')}")


def _run_process(task: Task, tell: Callable[[int], None]) -> dict[str, Any]:
    """The last message of the worker process; an error if it failed."""
    package = str(Path(postfx.__file__).resolve().parent.parent)
    path = os.pathsep.join(filter(None, [package, os.environ.get("PYTHONPATH")]))
    command = [sys.executable, "-m", "postfx.tools.bench.measure"]
    last: dict[str, Any] = {}
    with tempfile.TemporaryFile("w+") as words, tempfile.TemporaryFile("w+") as complaints:
        words.write(task.to_json() + "\n")
        words.seek(0)
        environment = {**os.environ, "PYTHONPATH": path}
        with subprocess.Popen(command, stdin=words, stdout=subprocess.PIPE, stderr=complaints,
                              text=True, env=environment) as process:
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
    """The figures to report; gpu_ms is None on the CPU.

    A run's milliseconds are the median over its frames, because other work slows single frames; the
    figures are the median, least and greatest of all runs. cpu_s is the mean over frames, and the
    median over the runs.
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
    """Score the results that a method wrote."""
    from postfx.tools.bench.metrics import (
        SequenceScore,  # imported here: its libraries must not count as a method's memory
    )

    scores = SequenceScore()
    for number in material.noisy.numbers:
        result = next(iter(material.result(pattern, number).planes.values()))
        scores.add(result, material.reference(number), material.motion(number))
    return scores


def _message(line: str) -> dict[str, Any] | None:
    """A message of the worker; None for a line that a library printed."""
    try:
        found = json.loads(line)
    except ValueError:
        return None
    return found if isinstance(found, dict) else None


@dataclass(frozen=True)
class Task:
    """A measurement to make: a method on a sequence, `runs` times; `output` holds '{number}' for
    the frame number."""

    method: Method
    noisy: str
    guides: str | None
    profile: str | None
    frames: tuple[int, ...]
    scale: float
    size: tuple[int, int]
    device: str
    threads: int
    runs: int
    output: str

    def to_json(self) -> str:
        """The task as one line."""
        return json.dumps(asdict(self))

    @classmethod
    def from_json(cls, text: str) -> Task:
        """The task that `to_json` wrote."""
        values = json.loads(text)
        facts = values.pop("method")
        method = Method(**facts | {"without": tuple(facts["without"])})
        return cls(method,
                   **values | {"frames": tuple(values["frames"]), "size": tuple(values["size"])})


def main() -> int:
    """Carry out the task on standard input."""
    task = Task.from_json(sys.stdin.readline())
    try:
        times = measure(task)
        _say(**({"times": times} if times else {"again": True}))
    except PostfxError as error:
        _say(error=str(error))
        return 2
    return 0


def measure(task: Task) -> dict[str, Any] | None:
    """Milliseconds (wall, device) and CPU seconds of every frame of every run, and the peak of
    memory in MB.

    A frame before the runs, `first_ms`, prepares everything. Reading and writing files is not
    timed. None if kernels had to be compiled, which happens once per machine: measure again,
    because the first frame waits for them.
    """
    with CompileWatch() as compiling:
        device = Device(task.device, task.threads)
        sequence = read_sequence(task.noisy, task.frames, task.profile,
                                 guides=task.guides).first_view()
        method = make(task.method, device, task.scale, task.size, sequence)
        first = _time(method, next(iter(sequence)))
    if compiling.count:
        return None
    runs = []
    for index in range(task.runs):
        method.reset()
        rows = [_frame(task, method, frame, index == task.runs - 1) for frame in sequence]
        runs.append(_even_out(rows) if task.method.both or task.method.run_up else rows)
        _say(run=index + 1)
    columns = {key: [[row[key] for row in run] for run in runs]
               for key in ("wall_ms", "cpu_s", "device_ms")}
    return {**columns, "first_ms": first["wall_ms"], "peak_mb": peak_memory()}


def peak_memory() -> float:
    """Greatest resident memory of this process in MB (10^6 bytes).

    From the kernel's high-water mark; `ru_maxrss` would include the parent process.
    """
    status = Path("/proc/self/status")
    if status.is_file():
        marks = [line for line in status.read_text().splitlines() if line.startswith("VmHWM:")]
        if marks:
            return int(marks[0].split()[1]) * 1024 / 1e6
    import psutil

    peak = getattr(psutil.Process().memory_info(), "peak_wset", None)
    if peak is not None:  # Windows
        return float(peak) / 1e6
    import resource

    factor = 1 if sys.platform == "darwin" else 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * factor / 1e6


def _frame(task: Task, method: Network | Chain, frame: Frame, write: bool) -> dict[str, Any]:
    row = _time(method, frame)
    result = row.pop("result")
    if write:
        path = task.output.replace("{number}", f"{frame.number:04d}")
        write_frame(path,
                    replace(frame, planes={Role.COLOUR: result}, guides={}, jitter=(0.0, 0.0)))
    return row


def _even_out(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Spread the time evenly over the frames: the first one of a part waits until others have run
    in reverse."""
    return [{key: sum(row[key] for row in rows) / len(rows) for key in rows[0]}] * len(rows)


def _time(method: Network | Chain, frame: Frame) -> dict[str, Any]:
    device, cpu, wall = method.device_ms, time.process_time(), time.perf_counter()
    result = method(frame)
    wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
    return {"wall_ms": 1e3 * wall, "cpu_s": cpu, "device_ms": method.device_ms - device,
            "result": result}


def _say(**values: object) -> None:
    print(json.dumps(values), flush=True)


if __name__ == "__main__":
    sys.exit(main())
