"""One benchmark: the request, the loop over the methods, its progress, and the files that it
writes."""

from __future__ import annotations

import json
import os
import platform
import sys
from dataclasses import asdict, dataclass, replace
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from postfx.bench import require
from postfx.bench.measure import Material, Sources, Task, output_pattern, run_task, score, timing
from postfx.bench.methods import Method, Omission, catalogue, select
from postfx.bench.report import ablations, choices, compare, front, write_csv
from postfx.errors import BenchError, WriteError
from postfx.files import write_text
from postfx.frame import Role
from postfx.passes.denoise.planes import ABSENT
from postfx.runtime import Device, Library
from postfx.streams import make_printable, styled
from postfx.version import __version__

MEASURING_LIBRARIES = (("flip_evaluator", "flip-evaluator"), ("skimage", "scikit-image"),
                       ("matplotlib", "matplotlib"))


@dataclass(frozen=True)
class Request:
    """Arguments of `postfx bench`, except those that name the frames."""

    output: Path
    methods: str | None = None
    models: str | None = None
    runs: int = 3
    device: str = "auto"
    threads: int | None = None
    ablations: bool = False


class Bench:
    """A benchmark. Its constructor checks everything that can be checked before measuring.

    Raises PostfxError if frames, methods or installed libraries do not fit.
    """

    def __init__(self, sources: Sources, wish: Request) -> None:
        for module, package in MEASURING_LIBRARIES:
            require(module, package, "measures or draws")
        self.material = Material(sources)
        device = Device(wish.device, wish.threads)
        self._device, self._threads, self._wish = device.name, device.threads, wish
        kind, motion = device.name.split(":")[0], self.material.spec.has(Role.MOTION)
        lost = ([str(role) for role in ABSENT if self.material.spec.has(role)] if wish.ablations
                else [])
        found = catalogue(Library().names(), kind, bool(self.material.spec.guides), motion, lost)
        self.methods, self.omissions = select(found, wish.methods, wish.models)
        if any(method.quality for method in self.methods):
            require("pyoidn", "pyoidn",
                    "runs Open Image Denoise (--methods ours,plain leaves it out)")
        try:
            wish.output.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise WriteError(f"{wish.output}: cannot be made: {error.strerror}; choose another "
                             "folder") from error

    def run(self) -> dict[str, Any]:
        """Measure and score all methods; returns all results and facts, in plain types."""
        rows: list[dict[str, Any]] = []
        with BenchProgress([method.name for method in self.methods], self._wish.runs) as progress:
            for method in self.methods:
                try:
                    rows.append(self._row(with_planes(method, rows), progress))
                except BenchError as error:
                    self.omissions = (*self.omissions, Omission(method.title, str(error)))
                    progress.skip(method.name, str(error))
        if not rows:
            raise BenchError("no method could be measured; the last error: "
                             f"{self.omissions[-1].why}")
        facts = self._facts(rows)
        self._write(facts)
        return facts

    def _write(self, facts: dict[str, Any]) -> None:
        from postfx.bench.pictures import (  # loads the libraries required above
            draw_crops,
            draw_worst,
            pareto,
        )

        folder = self._wish.output
        try:
            write_text(folder / "bench.json", json.dumps(facts, indent=1) + "\n")
            write_csv(folder / "bench.csv", facts["methods"])
            pareto(facts, "psnr_late", folder / "pareto_psnr.png")
            pareto(facts, "flicker_late", folder / "pareto_flicker.png")
            draw_crops(self.material, choices(facts["methods"]), folder / "crops.png")
            draw_worst(self.material, choices(facts["methods"]), folder / "crops_worst.png")
        except OSError as error:
            raise WriteError(f"{folder}: cannot be written: {error.strerror}; check rights and "
                             "free space") from error

    def _row(self, method: Method, progress: BenchProgress) -> dict[str, Any]:
        progress.begin(method.name)
        task = self._task(method)
        time = timing(run_task(task, progress.note_runs), self._device)
        progress.begin_scoring()
        scores = score(self.material, task.output)
        summary = scores.summary()
        progress.finish(time, summary)
        return {**asdict(method), "time": time, "scores": summary, "frames": scores.frames,
                "output": task.output}

    def _task(self, method: Method) -> Task:
        sources = self.material.sources
        return Task(method, sources.noisy, sources.guides if method.guides else None,
                    sources.profile, self.material.noisy.numbers, self.material.scale,
                    self.material.size, self._device, self._threads,
                    self._wish.runs, output_pattern(self._wish.output, method.name))

    def _facts(self, rows: list[dict[str, Any]]) -> dict[str, Any]:
        spec, size = self.material.spec, self.material.size
        time = "wall_ms" if self._device == "cpu" else "gpu_ms"
        return {
            "sequence": {**asdict(self.material.sources),
                         "frames": list(self.material.noisy.numbers)},
            "render_size": [spec.width, spec.height],
            "output_size": [size[1], size[0]],
            "scale": self.material.scale,
            "planes": [str(role) for role in spec.roles],
            "guides": [str(role) for role in spec.guide_roles],
            "device": self._device,
            "threads": self._threads,
            "runs": self._wish.runs,
            "machine": machine(),
            "versions": versions(),
            "methods": rows,
            "fronts": {figure: front(choices(rows), figure, time)
                       for figure in ("psnr_late", "flicker_late")},
            "against_best_baseline": compare(choices(rows)),
            "ablations": ablations(rows),
            "left_out": [item._asdict() for item in self.omissions],
        }


def with_planes(method: Method, rows: list[dict[str, Any]]) -> Method:
    """A method whose planes are 'best', with those of the OIDN high that measured best; prefiltered
    where none did."""
    if method.planes != "best":
        return method
    others = [row for row in rows if row["quality"] == method.quality and not row["accumulated"]]
    best = max(others, key=lambda row: row["scores"]["psnr_late"],
               default={"planes": "prefiltered"})
    return replace(method, planes=best["planes"])


def machine() -> dict[str, Any]:
    """Processor and operating system."""
    cpuinfo = Path("/proc/cpuinfo")
    lines = cpuinfo.read_text().splitlines() if cpuinfo.is_file() else []
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return {"processor": names[0] if names else platform.processor(), "cores": os.cpu_count(),
            "system": platform.platform()}


def versions() -> dict[str, str]:
    """Versions of the programs that were measured, and of those that measured them."""
    found = {"postfx": __version__}
    for name in ("onnxruntime", "onnxruntime-gpu", "pyoidn", "flip-evaluator", "scikit-image"):
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            continue
    return found


class BenchProgress:
    """Counts finished methods and runs. Use as a context manager."""

    def __init__(self, methods: list[str], runs: int) -> None:
        self._console = Console(file=styled(sys.stderr))
        self._methods, self._runs, self._count = methods, runs, 0
        self._bar = Progress(
            TextColumn("{task.fields[doing]}"), BarColumn(), MofNCompleteColumn(),
            TimeElapsedColumn(),
            console=self._console, transient=True, disable=not self._console.is_terminal,
        )
        self._task = self._bar.add_task("methods", total=len(methods) * (runs + 1), doing="")

    def __enter__(self) -> BenchProgress:
        self._bar.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._bar.stop()

    def begin(self, method: str) -> None:
        """Show that a method is about to be measured."""
        self._count += 1
        self._bar.update(self._task, doing=f"{method}: warming up",
                         completed=(self._count - 1) * (self._runs + 1))

    def note_runs(self, runs: int) -> None:
        """Show how many of its runs are done."""
        method = self._methods[self._count - 1]
        self._bar.update(self._task, doing=f"{method}: {runs} of {self._runs} runs", advance=1)

    def begin_scoring(self) -> None:
        """Show that its results are being scored."""
        self._bar.update(self._task, doing=f"{self._methods[self._count - 1]}: scoring")

    def finish(self, time: dict[str, Any], scores: dict[str, Any]) -> None:
        """Print the figures of a finished method."""
        text = f"{time['wall_ms']:.1f} ms a frame, PSNR {scores['psnr']:.2f} dB"
        self._print(self._methods[self._count - 1], text)

    def skip(self, method: str, reason: str) -> None:
        """Print why a method could not be measured."""
        self._print(method, f"failed: {reason}")

    def _print(self, method: str, text: str) -> None:
        self._bar.update(self._task, completed=self._count * (self._runs + 1))
        line = f"{self._count}/{len(self._methods)} {method}: {text}"
        self._console.print(make_printable(line), highlight=False, soft_wrap=True, markup=False)
