"""What a run of `postfx run` has told, taken and written so far."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable

from postfx.cli.summary import ExposureUsed, FrameResult, Preparation
from postfx.plan import Plan

BACKWARDS = "denoise_upscale backwards"
"""Name of the run in reverse order, in the summary."""


class RunRecord:
    """Tallies of a run, for its summary.

    Attributes:
        warnings: of the run and its history, told at the end.
        noticed: what was told at once, and is told again at the end of a long run.
        seconds: that the frames took, without compiling.
        preparation: what came before the first frame.
        exposure: of the frames that were written.
        frame_ms: time of each frame in the passes, in ms.
        ahead_ms: the same of frames that ran in a run-up.
        pass_ms: pass name -> time of each frame on the device, in ms.
        choices: pass name -> how often it chose what.
        cuts: numbers of frames that were found to begin a shot.
        bad_pixels: plane -> pixels that were not finite, and frames that had them.
        written: files.
        frames: how many were written.
    """

    def __init__(self, exposure: ExposureUsed) -> None:
        self.warnings: list[str] = []
        self.noticed: list[str] = []
        self.seconds = 0.0
        self.preparation = Preparation()
        self.exposure = exposure
        self.frame_ms: list[float] = []
        self.ahead_ms: list[float] = []
        self.pass_ms: dict[str, list[float]] = {}
        self.choices: dict[str, Counter[str]] = {}
        self.cuts: list[int] = []
        self.bad_pixels: dict[str, dict[str, int]] = {}
        self.written: list[str] = []
        self.frames = 0

    def tell(self, texts: Iterable[str], tell: Callable[[str], None]) -> None:
        """Tell at once what is to be mended, and again at the end of a long run."""
        for text in texts:
            self.noticed.append(text)
            tell(f"warning  {text}")

    def note_processed(self, done: FrameResult, plan: Plan, milliseconds: float,
                       backwards_ms: float | None) -> None:
        """Keep what a frame took, in reverse order too, and what was chosen for it."""
        self.frame_ms.append(milliseconds)
        backwards = {} if backwards_ms is None else {BACKWARDS: backwards_ms}
        for name, elapsed in {**backwards, **done.passes}.items():
            self.pass_ms.setdefault(name, []).append(elapsed)
        for role, pixels in done.bad_pixels.items():
            found = self.bad_pixels.setdefault(str(role), {"pixels": 0, "frames": 0})
            found["pixels"] += pixels
            found["frames"] += 1
        for step in plan.steps:
            if step.instance.choice:
                self.choices.setdefault(step.name, Counter())[step.instance.choice] += 1

    def note_written(self, done: FrameResult, paths: list[str]) -> None:
        """Keep a frame's files, and how it was exposed."""
        number, used = done.source.number, done.exposure_factor
        if used is not None:
            self.exposure.multipliers[number] = used
            self.exposure.lit_ev[number] = done.source.exposure or 0.0
        self.written += paths
        self.frames += 1
