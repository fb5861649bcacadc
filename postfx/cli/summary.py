"""What `postfx run` tells: the plan (--explain), progress while it runs, and the report at the
end."""

from __future__ import annotations

import sys
import time
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from datetime import timedelta
from math import ceil, log2
from pathlib import Path
from statistics import median
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn

from postfx.frame import Frame, Role
from postfx.io.pattern import format_frames
from postfx.io.sequence import Sequence
from postfx.masks.cryptomatte import Coverage
from postfx.passes.composite import NO_OVERLAY
from postfx.plan import Plan, Skip, from_files
from postfx.repair import Fireflies
from postfx.streams import make_printable, styled
from postfx.temporal.reverse_order import RunUp

SHOWN_FRAMES = 3
"""Failed frames that are listed, a line each."""
SHOWN_CUTS = 12
"""Numbers of cuts that are listed."""
SEEN_FRAMES = 10
"""Frames whose lines leave a warning above them in sight: after more it is repeated at the end."""
LOG_SECONDS = 5
"""Between two lines of a log about what takes long."""


@dataclass(frozen=True)
class Explanation:
    """What would run.

    Attributes:
        plan: of the first frame that can be read, which has the number `first`.
        skips: what the arguments leave out, and why.
        run_up: what runs before the first frame of a shot.
        exposure: of that frame, or the mode alone where all frames have to be metered.
        before: frames that run before that one, for its history.
        between: frames that run between those that are asked for, for theirs.
    """

    plan: Plan
    sequence: Sequence
    first: int
    skips: list[Skip]
    run_up: RunUp | None
    exposure: ExposureUsed
    before: list[int]
    between: list[int]

    def as_dict(self) -> dict[str, Any]:
        """In plain types."""
        plan, missing = self.plan.as_dict(), self.sequence.missing()
        plan["skipped"] += [asdict(item) for item in self.skips]
        if alone := self._find_left_alone():
            plan["left_alone"] = alone.as_dict()
        return {**plan, "before": self.before, "ahead": self._list_ahead(),
                "frames": len(self.sequence), "missing": missing,
                "exposure": self.exposure.as_dict(), "warnings": self.sequence.warnings}

    def __str__(self) -> str:
        first, frames = self.first, describe_frames(self.sequence)
        lines = [f"input   {self.sequence.pattern}: {frames}{describe_views(self.sequence)}",
                 str(self.plan)]
        lines += [f"skips   {item.what}: {item.why}" for item in self.skips]
        if alone := self._find_left_alone():
            lines.append(f"masks   of frame {first}: {alone}")
        if self.exposure.is_applied:
            one = f"frame {first} by " if len(self.exposure.multipliers) == 1 else ""
            known = self.exposure.multipliers
            lines.append(f"exposes {one}{self.exposure}" if known
                         else "exposes all frames by what metering them gives")
        if self.before:
            lines.append(f"history {describe_preroll(self.before)} for frame {first} (--preroll 0 "
                         "leaves it out)")
        if self.between:
            lines.append(f"history {describe_between(self.between)}")
        if ahead := self._list_ahead():
            listed = f"frame{'s' * (len(ahead) > 1)} {', '.join(map(str, ahead))}"
            lines.append(f"run-up  of each shot: {listed} before frame {self._begin} (--run-up 0 "
                         "for none)")
        return "\n".join(lines + [f"warning {warning}" for warning in self.sequence.warnings])

    def _find_left_alone(self) -> Coverage | None:
        """What the first frame leaves as it is, where that is asked for."""
        asked = self.sequence.options.leave and Role.STRENGTH in self.plan.planes
        return self.sequence.coverage_of(self.first) if asked else None

    def _list_ahead(self) -> list[int]:
        """Frames that are run before the first one, in the order in which they are."""
        return (self.run_up.after(self._begin)[::-1]
                if self.run_up and self.plan.accumulating_steps() else [])

    @property
    def _begin(self) -> int:
        """The first frame that runs."""
        return (*self.before, self.first)[0]


def describe_frames(sequence: Sequence) -> str:
    """How many frames are wanted, which, and which of them are missing."""
    missing = sequence.missing()
    holes = f", {len(missing)} missing: {format_frames(missing)}" if missing else ""
    return f"{count_frames(len(sequence))} ({format_frames(sequence.numbers)}{holes})"


def describe_preroll(numbers: list[int]) -> str:
    """Which frames run before those of the range."""
    first, last = numbers[0], numbers[-1]
    return (f"frame {first} first, unwritten," if first == last
            else f"frames {first} to {last} first, unwritten,")


def describe_between(numbers: list[int]) -> str:
    """Which frames run between those of a range with gaps."""
    run = (f"frame {numbers[0]} runs" if len(numbers) == 1
           else f"frames {format_frames(numbers)} run")
    return f"{run}, too, unwritten, for the history of later ones (--preroll 0 leaves that out)"


def describe_sizes(plan: Plan, sequence: Sequence) -> str:
    """Size of the input, and of the output as its display window has it."""
    render, output = plan.available, sequence.shown_size(plan.output.width, plan.output.height)
    shown = sequence.shown_size(render.width, render.height)
    change = f"{shown[0]}x{shown[1]} to {output[0]}x{output[1]}"
    return change if output != shown else f"{output[0]}x{output[1]}, not enlarged"


def describe_views(sequence: Sequence) -> str:
    """Which views are read, '' where files hold one."""
    return (f", views {', '.join(filter(None, (sequence.view, *sequence.views)))}" if sequence.views
            else "")


def describe_outputs(paths: list[Path], is_overwritten: bool) -> str:
    """Files that a run would write, and what happens to those that exist."""
    there = sum(path.exists() for path in paths)
    more = f" ... {paths[-1]}" if len(paths) > 1 else ""
    fate = "replaced" if is_overwritten else "kept if they are whole"
    kept = f"; {there} there already, {fate}" if there else ""
    return f"writes  {paths[0]}{more}: {len(paths)} file{'s' * (len(paths) > 1)}{kept}"


class FrameProgress:
    """Counts finished frames. Use as a context manager.

    In a terminal: a bar with frames per second and time left. In a log: one line for each finished
    frame. Where it is `quiet`: nothing.
    """

    def __init__(self, total: int, quiet: bool = False) -> None:
        self._console = Console(file=styled(sys.stderr), markup=False, emoji=False, quiet=quiet)
        self._total, self._done, self._fresh = total, 0, 0
        self._others, self._run_others, self._other_seconds = 0, 0, 0.0
        self._begin = time.perf_counter()
        self._told: float | None = None
        self._bar = Progress(
            TextColumn("{task.description}"),
            BarColumn(),
            MofNCompleteColumn(),
            TextColumn("{task.fields[rate]}"),
            console=self._console,
            transient=True,
            disable=quiet or not self._console.is_terminal,
        )
        self._task = self._bar.add_task("frames", total=total, rate="")

    def __enter__(self) -> FrameProgress:
        self._bar.start()
        return self

    def __exit__(self, *_: object) -> None:
        if not self._bar.disable:  # rich before 14 ends a bar that was never there by an empty line
            self._bar.stop()

    def note(self, text: str) -> None:
        """Print a line above the bar."""
        self._console.print(make_printable(text), highlight=False, soft_wrap=True)

    def note_compilation(self, count: int) -> None:
        """Say that kernels are compiled, and how many files of them were begun before."""
        text = "compiling kernels for this processor, on the first run only"
        now = time.perf_counter()
        self._bar.update(self._task, description=f"compiling kernels, file {count + 1}")
        if self._told is None or (now - self._told > LOG_SECONDS and not self._console.is_terminal):
            self.note(f"{text}: file {count + 1}" if count else text)
            self._told = now

    def start(self, done: int, others: int = 0) -> float:
        """Start the clock, `done` frames needing no work, and `others` running without being
        written; the time on it."""
        self._done += done
        self._others = others
        self._bar.update(self._task, advance=done, description="frames")
        self._begin = time.perf_counter()
        return self._begin

    def pass_by(self, frames: int, seconds: float) -> None:
        """Note frames that ran without being written: those of a run-up take another time than
        others."""
        self._run_others += frames
        self._other_seconds += seconds

    def advance(self, path: str, apart: float = 0.0) -> None:
        """Count a frame that was written to `path`; `apart` seconds since the start do not count,
        as of compiling."""
        self._done, self._fresh = self._done + 1, self._fresh + 1
        elapsed = time.perf_counter() - self._begin - apart
        rate = f"{self._fresh / elapsed:.2f} frames/s"
        if self._done < self._total:
            rate += f", {timedelta(seconds=round(self._seconds_left(elapsed)))} left"
        self._bar.update(self._task, advance=1, rate=rate)
        if not self._console.is_terminal:
            self.note(f"{self._done}/{self._total} {path} ({rate})")

    def _seconds_left(self, elapsed: float) -> float:
        """Time that the frames to come take, if each takes as long as those of its kind did."""
        own = max(0.0, elapsed - self._other_seconds) / self._fresh
        other = self._other_seconds / max(1, self._run_others)
        return ((self._total - self._done) * own
                + max(0, self._others - self._run_others) * other)


_HOW = {"auto": "metered", "smooth": "metered on the whole sequence", "lit": "as it was lit",
        "metadata": "by the header"}
NIGHT_EV = 3.0
"""From here on metering makes day of a night shot."""


@dataclass(frozen=True)
class ExposureUsed:
    """How much frames were exposed, and who said so.

    Attributes:
        mode: as --exposure says it.
        is_applied: whether it is in the pixels, as in pictures; else it was only a hint to the
            denoiser.
        multipliers: frame number -> multiplier.
        lit_ev: stops that the headers of the same frames ask for, 0 where they ask for nothing.
    """

    mode: str = "auto"
    is_applied: bool = False
    multipliers: dict[int, float] = field(default_factory=dict)
    lit_ev: dict[int, float] = field(default_factory=dict)

    @property
    def ev(self) -> dict[int, float]:
        """Frame number -> stops."""
        return {number: log2(value) for number, value in self.multipliers.items()}

    @property
    def is_metered(self) -> bool:
        """Whether the pictures told it, and not their author."""
        return self.mode in ("auto", "smooth")

    def as_dict(self) -> dict[str, Any]:
        """In plain types."""
        ev = [round(stops, 4) for stops in self.ev.values()]
        return {"mode": self.mode, "metered": self.is_metered, "applied": self.is_applied,
                "ev": [min(ev), max(ev)] if ev else None, "multipliers": self.multipliers}

    def __str__(self) -> str:
        how = _HOW.get(self.mode, "as given")
        if not self.is_metered:
            return f"{_describe_stops(self.ev)}, {how}"
        known = ", by the header" if any(self.lit_ev.values()) else ""
        return (f"{_describe_stops(self.ev)}, {how} (as it was lit: "
                f"{_describe_stops(self.lit_ev)}{known}, with --exposure lit)")

    def warnings(self) -> list[str]:
        """That a dark scene comes out bright, which nobody may have wanted."""
        more = [stops - self.lit_ev.get(number, 0.0) for number, stops in self.ev.items()]
        if not (self.is_applied and self.is_metered and more and median(more) >= NIGHT_EV):
            return []
        return [f"metering shows this {median(more):.1f} EV brighter than it was lit: a night shot "
                "comes out as day; --exposure lit keeps the light"]


def _describe_stops(ev: Mapping[int, float]) -> str:
    """Stops of frames: '+1.2 EV' or '+1.2 to +1.9 EV'."""
    least, most = (f"{pick(ev.values()):+.1f}" for pick in (min, max))
    return f"{least} EV" if least == most else f"{least} to {most} EV"


@dataclass(frozen=True)
class Preparation:
    """Time before the first frame: all seconds, those in which kernels were compiled, and how many
    files of them, because no earlier run had kept them."""

    seconds: float = 0.0
    compile_seconds: float = 0.0
    kernels: int = 0


@dataclass(frozen=True)
class FrameResult:
    """A processed frame, and how it was made.

    Attributes:
        source: as it was read.
        result: as it is written.
        exposure_factor: what light was multiplied by; None if no pass ran.
        cut: whether its picture was found to begin a shot.
        milliseconds: in the passes; None for a stand-in.
        passes: pass name -> milliseconds on the device.
        bad_pixels: plane -> pixels that were not finite.
    """

    source: Frame
    result: Frame
    exposure_factor: float | None
    cut: bool = False
    milliseconds: float | None = None
    passes: Mapping[str, float] = field(default_factory=dict)
    bad_pixels: Mapping[Role, int] = field(default_factory=dict)

    def facts(self) -> dict[str, Any]:
        """What the log says."""
        passes = {name: round(elapsed, 3) for name, elapsed in self.passes.items()}
        took = None if self.milliseconds is None else round(self.milliseconds, 3)
        stops = None if self.exposure_factor is None else log2(self.exposure_factor)
        return {"ms": took, "passes": passes, "exposure_ev": stops, "cut": self.cut,
                "broken": dict(self.bad_pixels)}


LEFT_OUT = "left out"
RESAMPLED_INSTEAD = "resampled"


@dataclass
class Fault:
    """A frame that could not be processed, why, and what became of its output: LEFT_OUT or
    RESAMPLED_INSTEAD."""

    frame: int
    why: str
    instead: str = LEFT_OUT


@dataclass(frozen=True)
class Report:
    """Result of a run.

    Attributes:
        frames: count of frames written in this run.
        total: count of frames of the input.
        seconds: wall time of the frames, reading and writing included, without the `preparation`.
        frame_ms: milliseconds in the passes for each written frame, without reading and writing.
            That of the first one of each shot includes its run-up.
        pass_ms: pass name -> milliseconds on the device for each written frame.
        preparation: what it took to load networks and compile kernels before.
        ahead_ms: milliseconds on the device for each frame of the run-ups.
        skips: passes, planes and frames that were left out, and why.
        warnings: what was odd, each once.
        told: those of them that were shown while the run was on.
        outputs: paths that were written.
        choices: pass name -> what it chose (a network) -> frames, of passes that choose.
        pixel_filter: standard deviation, in pixels, of the filter that was undone before denoising
            and applied again; 0 for none.
        guides: size of the planes at output size, roles that were used, and whether the output's
            size follows from them; None without guides.
        exposure: by how much frames were exposed.
        cuts: frames at which a cut was found in the pictures.
        coverage: how much of the frames --leave left as it is.
        fireflies: what --clamp-fireflies took of the frames.
        bad_pixels: plane -> pixels that were not finite and frames that had them.
        capture: path of the capture's page, or None.
        page: path of the page that --report asks for, or None.
        faults: frames that failed, which the run went on after.
        error: why the run ended early, or None.
    """

    frames: int
    total: int
    seconds: float
    frame_ms: list[float]
    pass_ms: dict[str, list[float]]
    skips: list[Skip]
    warnings: list[str]
    outputs: list[str]
    preparation: Preparation = Preparation()
    ahead_ms: list[float] = field(default_factory=list)
    choices: dict[str, dict[str, int]] = field(default_factory=dict)
    pixel_filter: float = 0.0
    guides: dict[str, Any] | None = None
    exposure: ExposureUsed = ExposureUsed()
    cuts: list[int] = field(default_factory=list)
    coverage: Coverage = field(default_factory=Coverage)
    fireflies: Fireflies = field(default_factory=Fireflies)
    bad_pixels: dict[str, dict[str, int]] = field(default_factory=dict)
    capture: str | None = None
    page: str | None = None
    faults: list[Fault] = field(default_factory=list)
    error: str | None = None
    told: list[str] = field(default_factory=list)

    @property
    def has_run(self) -> bool:
        """Whether any frame was processed, or failed and was let pass."""
        return bool(self.frame_ms or self.frames or self.faults)

    def as_dict(self) -> dict[str, Any]:
        """The report in plain types."""
        result = {
            "frames": self.frames,
            "seconds": round(self.seconds, 3),
            "prepared": {"seconds": round(self.preparation.seconds, 3),
                         "compiling": round(self.preparation.compile_seconds, 3),
                         "compiled": self.preparation.kernels},
            "ms_per_frame": _spread(self.frame_ms),
            "passes": {name: round(median(times), 3) for name, times in self.pass_ms.items()},
            "run_up": {"frames": len(self.ahead_ms), "ms_per_frame": _spread(self.ahead_ms)},
            "skipped": [{"what": item.what, "why": item.why} for item in self.skips],
            "warnings": self.warnings,
            "outputs": self.outputs,
            "guides": self.guides,
            "chosen": self.choices,
            "pixel_filter": self.pixel_filter,
            "exposure": self.exposure.as_dict(),
            "cuts": self.cuts,
            "broken": self.bad_pixels,
        }
        if self.coverage.frames:
            result["left_alone"] = self.coverage.as_dict()
        if self.fireflies.light:
            result["fireflies"] = self.fireflies.as_dict()
        if self.faults:
            result["faults"] = [asdict(fault) for fault in self.faults]
        optional = {"capture": self.capture, "report": self.page, "error": self.error}
        return {**result, **{name: text for name, text in optional.items() if text}}

    def summary(self) -> str:
        """The report in a few lines."""
        lines = [f"{self.frames} of {count_frames(self.total)} in {self.seconds:.1f} s"
                 f"{self._speed()}"]
        if kernels := self.preparation.kernels:
            lines.append(f"compiled {kernels} file{'s' * (kernels > 1)} of kernels in "
                         f"{self.preparation.compile_seconds:.1f} s, which is not in these times; "
                         "they are kept for the next run")
        lines += [f"ran      {name}: {median(times):.1f} ms a frame"
                  for name, times in self.pass_ms.items()]
        if self.ahead_ms:
            lines.append(f"ran      {count_frames(len(self.ahead_ms))} first, in reverse order, "
                         f"for the first frames' history: {median(self.ahead_ms):.1f} ms a frame")
        lines += [f"chose    {name}: {_count_choices(counts)}"
                  for name, counts in self.choices.items()]
        if self.pixel_filter:
            lines.append(f"undid    a pixel filter of {self.pixel_filter:.2f} px before denoising, "
                         "and applied it to the picture (--pixel-filter none leaves it)")
        if self.exposure.is_applied and self.exposure.multipliers:
            lines.append(f"exposure {self.exposure}")
        lines += [f"guides   {_guides_text(self.guides)}"] if self.guides else []
        lines += ([f"cuts     found at {_list_numbers(self.cuts)} (--cuts says otherwise)"]
                  if self.cuts else [])
        if self.coverage.frames:
            lines.append(f"masks    {self.coverage}")
        if self.fireflies.light:
            lines.append(f"clamped  {self.fireflies}")
        lines += self._fault_lines()
        lines += [f"broken   {role}: {_broken_text(role, found)}"
                  for role, found in self.bad_pixels.items()]
        lines += [f"skipped  {what}: {why}" for what, why in self._skipped_by_reason()]
        lines += [f"warning  {warning}" for warning in self.warnings
                  if self.frames > SEEN_FRAMES or warning not in self.told]
        lines += [f"capture  {self.capture}"] if self.capture else []
        lines += [f"report   {self.page}"] if self.page else []
        if self.outputs:
            more = f" ... {self.outputs[-1]}" if len(self.outputs) > 1 else ""
            lines.append(f"wrote    {self.outputs[0]}{more}")
        return "\n".join(lines)

    def problems(self) -> str:
        """Lines of the summary that nobody must miss: frames that failed, and warnings."""
        return "\n".join([*self._fault_lines(),
                          *(f"warning  {warning}" for warning in self.warnings)])

    def _fault_lines(self) -> list[str]:
        """How many frames failed, and the first few of them."""
        if not self.faults:
            return []
        out = sum(fault.instead == LEFT_OUT for fault in self.faults)
        lines = [f"failed   {count_frames(len(self.faults))}: {out} left out, "
                 f"{len(self.faults) - out} resampled instead"]
        lines += [f"failed   frame {fault.frame}, {fault.instead}: {fault.why}"
                  for fault in self.faults[:SHOWN_FRAMES]]
        more = len(self.faults) - SHOWN_FRAMES
        return lines + ([f"failed   {count_frames(more)} more, see --json"] if more > 0 else [])

    def _skipped_by_reason(self) -> list[tuple[str, str]]:
        """Planes together, since they share a reason; of frames the first few. That there is no
        overlay needs no line."""
        planes = [
            item.what.removeprefix("AOV ").strip("'")
            for item in self.skips if item.what.startswith("AOV ")
        ]
        frames = [item for item in self.skips if item.what.startswith("frame ")]
        passes = [item
                  for item in self.skips
                  if not item.what.startswith(("AOV ", "guide ", "frame "))
                  and item.why != NO_OVERLAY]
        rows = [(item.what, item.why) for item in passes + frames[:SHOWN_FRAMES]]
        more = len(frames) - SHOWN_FRAMES
        rows += [(f"{count_frames(more)} more", "likewise")] if more > 0 else []
        return rows + ([("AOVs " + ", ".join(planes), "no pass reads them")] if planes else [])

    def _speed(self) -> str:
        if not self.frame_ms or not self.frames:
            return ""
        return (f", {self.frames / self.seconds:.2f} frames/s, {median(self.frame_ms):.0f} ms a "
                "frame in the passes")


def warn_of_budget(
    budget: float | None, pass_ms: Mapping[str, list[float]],
    chosen: Mapping[str, Mapping[str, int]]
) -> list[str]:
    """A warning where most frames took longer than --budget, in milliseconds."""
    times = pass_ms.get("denoise_upscale", [])
    if budget is None or not times or median(times) <= budget:
        return []
    over = sum(time > budget for time in times)
    networks = ", ".join(chosen.get("denoise_upscale", {}))
    return [f"--budget {budget:g} was missed by {over} of {count_frames(len(times))}: denoising "
            f"took {median(times):.0f} ms a frame with {networks}: take a smaller --model or "
            f"output, or allow {_round_up(max(times)):g}"]


def _round_up(milliseconds: float) -> float:
    """The number rounded up to two digits."""
    step = 10.0 ** max(0, len(str(int(milliseconds))) - 2)
    return ceil(milliseconds / step) * step


def guides_in(plan: Plan, sized: bool) -> dict[str, Any] | None:
    """Size of the guides, which are used, and whether the output's size, unless it is given,
    follows from them."""
    guides, output = plan.available.guides, plan.output
    if guides is None or not from_files(guides.roles):
        return None
    follows = not sized and (output.width, output.height) == (guides.width, guides.height)
    used = [str(role) for role in from_files(plan.guides)]
    return {"width": guides.width, "height": guides.height, "used": used, "output_follows": follows}


def _guides_text(guides: dict[str, Any]) -> str:
    text = f"{guides['width']}x{guides['height']}"
    text += f", used: {', '.join(guides['used'])}" if guides["used"] else ", not used"
    return text + ("; the output has their size" if guides["output_follows"] else "")


def _spread(times: list[float]) -> dict[str, float] | None:
    if not times:
        return None
    return {"median": round(median(times), 3), "min": round(min(times), 3),
            "max": round(max(times), 3)}


def count_frames(count: int) -> str:
    return f"{count} frame{'s' * (count != 1)}"


def _broken_text(role: str, found: dict[str, int]) -> str:
    repaired = (", repaired from the pixels around where those are known" if role == Role.COLOUR
                else "")
    return (f"{found['pixels']} pixel{'s' * (found['pixels'] > 1)} not finite in "
            f"{count_frames(found['frames'])}{repaired}")


def _list_numbers(numbers: list[int]) -> str:
    more = f" and {len(numbers) - SHOWN_CUTS} more" if len(numbers) > SHOWN_CUTS else ""
    return ", ".join(map(str, numbers[:SHOWN_CUTS])) + more


def _count_choices(counts: dict[str, int]) -> str:
    return ", ".join(f"{choice} for {count} frame{'s' * (count > 1)}"
                     for choice, count in counts.items())
