"""What interrupts a run: frames that cannot be read or processed (`--on-error`), and signals."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable
from enum import StrEnum
from types import FrameType
from typing import Any, TypeVar

from postfx.cli.summary import RESAMPLED_INSTEAD, Fault, FrameResult
from postfx.errors import (
    FrameError,
    GuideError,
    Interrupted,
    MissingFrameError,
    MissingPlaneError,
    OptionError,
    PostfxError,
    WriteError,
)
from postfx.exposure import ExposureMeter, SmoothExposure
from postfx.frame import Frame, FrameSpec, Role
from postfx.io.sequence import Sequence
from postfx.passes import Pass
from postfx.pipeline import Pipeline
from postfx.plan import Plan
from postfx.runtime import Device
from postfx.system import usable_memory

EXIT_FAULTS = 3
"""Exit code of a run that reached its end, but not with all frames."""
Result = TypeVar("Result")


class OnError(StrEnum):
    """What to do about a frame that cannot be read or processed."""

    STOP = "stop"
    SKIP = "skip"
    COPY = "copy"


class Standin:
    """Makes the output of a frame from its picture alone: enlarged, not denoised, and shown like
    all others."""

    def __init__(
        self, sequence: Sequence, passes: list[Pass], device: Device,
        exposure: ExposureMeter | SmoothExposure
    ) -> None:
        self._sequence = sequence.pictures()
        self._pipeline = Pipeline(passes, device, exposure, "none")

    def __call__(self, number: int) -> FrameResult:
        """The frame to write. Raises as reading does."""
        try:
            frame = self._sequence.read(number, (Role.COLOUR, Role.ALPHA))
        except MissingPlaneError:
            frame = self._sequence.read(number, (Role.COLOUR,))
        result = self._pipeline(frame)
        return FrameResult(frame, result, self._pipeline.exposure_factor,
                           bad_pixels=self._pipeline.bad_pixels)


class Faults:
    """Goes on after frames that fail, as far as the policy allows, and keeps a list of them.

    With SKIP such a frame has no output. With COPY a stand-in makes it; where the picture itself
    cannot be read, there is none either. An output that cannot be written stops the run whatever
    the policy: the next ones would fail as well.

    Attributes:
        found: what failed so far.
    """

    def __init__(self, policy: OnError, standin: Standin | None = None) -> None:
        self._policy, self._standin = policy, standin
        self.found: list[Fault] = []

    def attempt(self, number: int, wanted: bool, work: Callable[[], Result]) -> Result | None:
        """The result of `work` on a frame; None if it failed and the run goes on. Failures of
        frames that are not `wanted` do not count."""
        try:
            return work()
        except WriteError:
            raise
        except PostfxError as error:
            if self._policy is OnError.STOP:
                raise
            if wanted:
                self._note(Fault(number, str(error)))
            return None

    def substitute(self, number: int) -> FrameResult | None:
        """What to write for a frame that failed; None for nothing."""
        if self._standin is None:
            return None
        try:
            done = self._standin(number)
        except PostfxError:
            return None
        next(fault for fault in self.found if fault.frame == number).instead = RESAMPLED_INSTEAD
        return done

    def _note(self, fault: Fault) -> None:
        """Keep a fault; one of the same frame is replaced, as the output of its stand-in has failed
        as well."""
        self.found = [one for one in self.found if one.frame != fault.frame] + [fault]


def first_readable(sequence: Sequence, policy: OnError) -> int:
    """Number of the first frame, or of the first one that can be read, where the policy allows to
    skip others.

    Where none can be, raises the error of the last one that is there.
    """
    sequence.refuse_none()
    errors: list[PostfxError] = []
    for number in sequence.numbers:
        try:
            with sequence.open(number) as files:
                files.spec()
                return number
        except PostfxError as error:
            errors.append(error)
            if policy is OnError.STOP:
                break
    raise next((error for error in reversed(errors) if not isinstance(error, MissingFrameError)),
               errors[0])


def check_sizes(frame: Frame, first: FrameSpec, sized: bool) -> None:
    """FrameError for a frame of another size than the first one's, GuideError for its guides: the
    output's size may follow from them, unless it is given (`sized`)."""
    spec = frame.spec
    guides = spec.guides
    if not sized and (spec.width, spec.height) != (first.width, first.height):
        raise FrameError(f"{frame.source}: frame {frame.number} is {spec.width}x{spec.height}, the "
                         f"first one {first.width}x{first.height}: render it at one size, or give "
                         "the output's with --size")
    for view in frame.views.values():
        if (view.spec.width, view.spec.height) != (spec.width, spec.height):
            raise FrameError(f"{view.source}: is {view.spec.width}x{view.spec.height}, the first "
                             f"view {spec.width}x{spec.height}: render all views at one size")
    if (guides and first.guides
        and (guides.width, guides.height) != (first.guides.width, first.guides.height)):
        raise GuideError(f"{guides.source}: guides are {guides.width}x{guides.height}, those of "
                         f"the first frame {first.guides.width}x{first.guides.height}: render them "
                         "at one size")


NETWORK_PIXEL_BYTES = 900
"""Least memory that a network takes for each pixel of a render: 970 to 1100 measured at 1x, 840 at
2x, on a CPU."""


def check_memory(plan: Plan, sequence: Sequence) -> None:
    """OptionError where a network's memory for a frame exceeds the machine's: the system would kill
    the run later."""
    size, there = plan.input, usable_memory()
    needs, is_masked = NETWORK_PIXEL_BYTES * size.width * size.height, Role.STRENGTH in plan.planes
    if needs > there and not is_masked and any(step.name == "denoise_upscale"
                                               for step in plan.steps):
        raise OptionError(f"{sequence.pattern}: to denoise {size.width}x{size.height} takes "
                          f"{needs >> 30} GB and more, this machine has {there >> 30} GB: give "
                          f"--memory {max(1, there * 6 // 10 >> 30)}G, which works in tiles")


SIGNALS = (signal.SIGINT, signal.SIGTERM)
Handler = Callable[[int, FrameType | None], Any] | int | signal.Handlers | None


class Stop:
    """Turns SIGINT (Ctrl-C) and SIGTERM into a request to stop. Use as a context manager in the
    main thread; in another thread it changes nothing.

    The first signal calls `tell` with a line for the user; a second one raises Interrupted at once,
    wherever that is.

    Attributes:
        signal: that asked the run to end after this frame; None as long as none did.
    """

    def __init__(self, tell: Callable[[str], None]) -> None:
        self._tell = tell
        self.signal: int | None = None
        self._before: dict[int, Handler] = {}

    def check(self) -> None:
        """Between two frames: raises Interrupted when the run shall end."""
        if self.signal is not None:
            raise Interrupted(self.signal)

    def __enter__(self) -> Stop:
        if threading.current_thread() is threading.main_thread():
            self._before = {number: signal.signal(number, self._request_stop) for number in SIGNALS}
        return self

    def __exit__(self, *_: object) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)

    def _request_stop(self, number: int, _: FrameType | None) -> None:
        if self.signal is not None:
            raise Interrupted(number)
        self.signal = number
        self._tell("stopping when this frame is finished; a second signal stops at once")
