"""Passes on frame after frame: the plan for each, what is done to it before the passes run, and the
history from frame to frame. `postfx.flow` takes a frame through its passes."""

from __future__ import annotations

import copy
import dataclasses
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
from math import log2
from typing import TYPE_CHECKING, Any

import numpy as np

from postfx.cuts import CutDetector
from postfx.errors import CutError, DeviceError, EncodingError, FrameError, PassOptionError
from postfx.exposure import ExposureMeter, SmoothExposure, factor_of
from postfx.flow import Flow
from postfx.frame import LOG, Frame, FrameSpec, Role
from postfx.passes import Downloads, Pass, ResidentFrame, share_planes, spec_of
from postfx.passes.exposure_tool import with_tool
from postfx.plan import Plan, Skip, Step, make_plan
from postfx.planes import lend
from postfx.repair import is_unusable, repair_nonfinite
from postfx.runtime import BindingError, Device, Tensor, default_device
from postfx.wrap import (
    WRAP_AROUND,
    WRAP_AUTO,
    crop,
    is_panorama,
    validate_wrap,
    widen,
    widened_plan,
)

if TYPE_CHECKING:
    from postfx.doctor.first_frames import FirstFrames

RunUp = Callable[[Frame, Callable[[Frame], None]], Frame]
"""Called with a frame that begins a shot, and with a function that runs a frame for nothing but the
history. Runs other frames by that function; returns the frame to run for the given one."""


def _kind(thing: object) -> str:
    """The type of something, in words for a message."""
    return f"{type(thing).__module__}.{type(thing).__name__}".removeprefix("builtins.")


def _check_passes(passes: Sequence[Pass]) -> tuple[Pass, ...]:
    """The passes of a pipeline; PassOptionError for anything else, such as the picture itself."""
    how = ("give a list: Pipeline([postfx.DenoiseUpscale(), postfx.ToneMap()]), then call it with "
           "a postfx.Frame")
    if isinstance(passes, Pass):
        raise PassOptionError("a pipeline takes a list of passes, not one pass: "
                              f"Pipeline([{passes!r}])")
    found = tuple(passes) if isinstance(passes, Iterable) else (passes,)
    wrong = [one for one in found if not isinstance(one, Pass)]
    if wrong:
        raise PassOptionError(f"a pipeline takes passes, not {_kind(wrong[0])}: {how}")
    return found


class Pipeline:
    """Runs passes on frame after frame and keeps their history between calls.

    Args:
        passes: in the order in which they run, each of this pipeline alone; those that would change
            nothing are skipped.
        device: where to run, or its name as for `Device`: 'cpu', 'cuda', ...; default: one device
            shared by the process.
        exposure: 'auto', 'metadata' or a number of stops, see `postfx.exposure.ExposureMeter`; or a
            meter, such as a `postfx.exposure.SmoothExposure` of the whole sequence.
        cuts: 'auto' drops the history also before frames that are unrelated to the one before, as
            `postfx.cuts.CutDetector` finds them; 'none' only before frames marked with
            `frame.reset`.
        run_up: what fills the history before the first frame of a shot, such as a `postfx.RunUp`;
            None for nothing.
        checks: whether to look at the first frames that are denoised over time, and to tell the
            logger "postfx" what is plainly wrong with them, such as motion of the wrong sign; it
            takes a moment of the third frame.
        wrap: 'x' for panorama frames, whose right edge goes on at the left one: there is no seam,
            and motion leads across it; 'none' for others; 'auto' for what each frame's header says.
            Not for `on_device`.

    Where POSTFX_EXPOSURE_TOOL is 1 in the environment, `postfx.passes.exposure_tool` covers the
    upscaler's output.

    Attributes:
        plan: the plan of the last frame, None before the first.
        timings: pass name -> milliseconds on the device, of the last frame.
        ahead: milliseconds on the device of each frame that was run up to the last one.
        run_up_ms: milliseconds that these frames took in all, with reading them; 0 without any.
        exposure: stops used for the last frame; None before the first and when no pass ran.
        exposure_factor: likewise, what its light was multiplied by.
        cut: whether the last frame was found to begin another shot.
        bad_pixels: plane -> how many of its pixels in the last frame were not finite, see
            `postfx.repair.repair_nonfinite`.
        noticed: what passes found in the last frame that is to be mended, a line each, which is
            told once.

    The other views of a frame (`Frame.views`) run through copies of the passes, each with its own
    history, and with the exposure and the cuts of the frame itself; times and counts are those of
    all views.
    """

    def __init__(
        self,
        passes: Sequence[Pass],
        device: Device | str | None = None,
        exposure: str | float | ExposureMeter | SmoothExposure = "auto",
        cuts: str = "auto",
        run_up: RunUp | None = None,
        checks: bool = True,
        wrap: str = WRAP_AUTO,
    ) -> None:
        if cuts not in ("auto", "none"):
            raise CutError(f"cuts '{cuts}': use auto or none, and frame.reset for cuts that are "
                           "known")
        if not isinstance(device, Device | str | None):
            raise DeviceError(f"a pipeline runs on a device, not on {device!r}: give its name, "
                              "such as 'cpu', or a postfx.Device")
        self.passes = with_tool(_check_passes(passes))
        own = Device(device) if isinstance(device, str) else device
        self.device = own if own is not None else default_device()
        self.plan: Plan | None = None
        self.timings: dict[str, float] = {}
        self.exposure_factor: float | None = None
        self.cut = False
        self.bad_pixels: dict[Role, int] = {}
        self.noticed: tuple[str, ...] = ()
        self.ahead: tuple[float, ...] = ()
        self.run_up_ms = 0.0
        self._meter = exposure if callable(exposure) else ExposureMeter(exposure)
        self._detector = CutDetector() if cuts == "auto" else None
        self._run_up = run_up
        self._checks = checks
        self._looker: FirstFrames | None = None
        # planes that came or went within a shot, as the log was told
        self._changed_roles = set[Role]()
        self._wrap = validate_wrap(wrap)
        # for panoramas: the plan for frames with a margin, and the margin in pixels
        self._widened: tuple[Plan, int] | None = None
        # whether nothing is known of the frames before
        self._begins_shot = True
        self._flow = Flow(self.device)
        self._running = threading.Lock()
        self._own_device = own
        self._cuts = cuts
        self._views: dict[str, Pipeline] = {}
        # planes and guides of the last frame that came in the device's memory
        self._last_on_device: tuple[dict[Role, Tensor], dict[Role, Tensor]] = {}, {}

    @property
    def exposure(self) -> float | None:
        return None if self.exposure_factor is None else log2(self.exposure_factor)

    def __repr__(self) -> str:
        """The passes as one would write them, and where they run."""
        return f"Pipeline([{', '.join(map(repr, self.passes))}], device={self.device!r})"

    def __reduce__(self) -> tuple[Callable[..., Pipeline], tuple[Any, ...]]:
        """Pickled by its arguments: the copy is not compiled and has no history. Without a device
        of its own it runs on the default device of the process that it comes to."""
        return _make_pipeline, (self.passes, self._own_device, self._meter, self._cuts,
                                self._run_up, self._checks, self._wrap)

    def __call__(self, frame: Frame) -> Frame:
        """The frame after all passes; the given frame is not changed. For one thread at a time.

        Planes and guides that no pass touches are passed on as they are, unless a pass changed the
        size. Compiles when the frame's spec is not the last one's, which drops the history of
        passes that cannot go on with frames of another size. When anything fails, the history is
        dropped and the error is raised; FrameError for planes that do not fit together.
        EncodingError while another thread's frame runs, which goes on.
        """
        if not isinstance(frame, Frame):
            raise FrameError(f"a pipeline takes a postfx.Frame, not {_kind(frame)}: give "
                             "Frame({'colour': array}), or use postfx.denoise(array) for a "
                             "single picture")
        with self._alone(), lend(self.device.divide_planes):
            # planes may have been put into it since it was made
            return self._process(frame.copy_with(check=True, metadata=dict(frame.metadata)))

    @contextmanager
    def _alone(self) -> Iterator[None]:
        """While one frame runs; drops the history when it fails. EncodingError where another thread
        runs one: both would go on with the same history."""
        if not self._running.acquire(blocking=False):
            raise EncodingError("this pipeline runs a frame in another thread: its frames share "
                                "one history, so make a Pipeline of its own for each thread")
        try:
            yield
        except BaseException:
            self._reset_passes()
            for own in self._views.values():
                own._reset_passes()
            raise
        finally:
            self._running.release()

    def _process(self, frame: Frame) -> Frame:
        """One frame: its plan, repair, cut and exposure, then the passes, and its other views."""
        # What runs on it.
        before = self.plan if not (self._begins_shot or frame.reset) else None
        plan = self._make_plan(frame.spec, self._is_panorama(frame))
        self.ahead = ()
        self.run_up_ms = 0.0
        if self._checks and before and before is not plan:
            self._tell_changed_planes(frame.number, before, plan)
        if not plan.steps:
            self.timings = {}
            self.exposure_factor = None
            self.cut = False
            self.bad_pixels = {}
            self.noticed = ()
            return frame

        # What is done to it before, and what is found out about it.
        frame, self.bad_pixels = repair_nonfinite(frame, plan.planes, self.device.scratch)
        self.cut = (self._detector is not None and frame.encoding == "scene-linear"
                    and self._detector(frame))
        if self.cut:
            frame = frame.copy_with(reset=True)
            LOG.info("frame %d begins another shot: the history is dropped", frame.number)
        if frame.reset:
            self._reset_passes()
        self.exposure_factor = self._meter(frame) if Role.COLOUR in frame.planes else 1.0
        if self._checks and not self.device.scratch:
            self._look(frame, plan)

        # The passes, on this frame or on one that a run-up gave a longer history.
        seen = self._run_up_to(frame, plan) if self._begins_shot else frame
        run = self._run_widened if self._widened else self._flow.run
        result = run(seen, plan, self.exposure_factor, is_unusable(frame, self.bad_pixels), frame)
        self._begins_shot = False

        # What they told.
        self.timings = dict(self._flow.timings)
        self.noticed = tuple([text for step in plan.steps for text in step.instance.notices])
        for step in plan.steps:
            step.instance.notices = ()
        for text in self.noticed if self._checks else ():
            LOG.warning("frame %d: %s", frame.number, text)
        for role, pixels in self.bad_pixels.items():
            LOG.warning("frame %d: %d pixels of AOV '%s' were no finite numbers and were repaired",
                        frame.number, pixels, role)
        LOG.debug("frame %d: milliseconds by pass: %s", frame.number, self.timings)
        views = {name: self._process_view(name, view.copy_with(reset=view.reset or self.cut))
                 for name, view in frame.views.items()}
        return result.copy_with(views=views)

    def _run_widened(self, frame: Frame, plan: Plan, exposure_factor: float, unusable: bool,
                     given: Frame) -> Frame:
        """`Flow.run` of a panorama, with what lies beyond its edges."""
        assert self._widened is not None, "a panorama's plan has a margin"
        wide, margin = self._widened
        run = widen(frame, margin)
        whole = run if frame is given else widen(given, margin)
        found = self._flow.run(run, wide, exposure_factor, unusable, whole)
        return crop(found, given, plan)

    def _is_panorama(self, frame: Frame) -> bool:
        """Whether a frame's right edge goes on at the left one."""
        if self._wrap == WRAP_AUTO:
            return "textureformat" in frame.metadata and is_panorama(frame.metadata)
        return self._wrap == WRAP_AROUND

    def _look(self, frame: Frame, plan: Plan) -> None:
        """Tell the log what is plainly wrong with the first frames."""
        if frame.encoding != "scene-linear" or not plan.accumulating_steps():
            return
        if self._looker is None:
            from postfx.doctor.first_frames import (
                FirstFrames,  # loads the doctor, which stills need not wait for
            )

            self._looker = FirstFrames(on_gpu=not self.device.memory.host_visible, copies=True)
        for text in self._looker.look(frame):
            LOG.warning("%s", text)

    def _tell_changed_planes(self, number: int, before: Plan, plan: Plan) -> None:
        """Tell the log, once for each, of planes that a frame of a shot has and the one before had
        not, or lacks."""
        last, now = before.available, plan.available
        if (last.width, last.height) != (now.width, now.height):
            return
        come = {*plan.planes} - {*before.planes}
        gone = {*before.planes} - {*plan.planes}
        for roles, text in ((come, "has {}, which the frame before had not"),
                            (gone, "lacks {}, which the frame before had")):
            new = sorted(map(str, roles - self._changed_roles))
            if new:
                self._changed_roles |= roles
                LOG.warning("frame %d %s: its history begins anew; give it in all frames of a shot "
                            "or in none", number, text.format(" and ".join(new)))

    def _process_view(self, name: str, frame: Frame) -> Frame:
        own = self._of_view(name)
        result = own(frame)
        self.ahead += own.ahead
        self.run_up_ms += own.run_up_ms
        self.timings = {step: self.timings.get(step, 0.0) + own.timings.get(step, 0.0)
                        for step in {**self.timings, **own.timings}}
        self.bad_pixels = {role: self.bad_pixels.get(role, 0) + own.bad_pixels.get(role, 0)
                       for role in {**self.bad_pixels, **own.bad_pixels}}
        return result

    def _of_view(self, name: str) -> Pipeline:
        """The pipeline of another view."""
        if name not in self._views:
            of_view = getattr(self._run_up, "of_view", None)
            passes = [copy.copy(item) for item in self.passes]
            self._views[name] = Pipeline(passes, self.device, _SharedExposure(self), "none",
                                         of_view and of_view(name), checks=False, wrap=self._wrap)
        return self._views[name]

    def on_device(
        self,
        planes: Mapping[Role | str, Any],
        *,
        exposure: float | None = None,
        guides: Mapping[Role | str, Any] | None = None,
        number: int = 1,
        jitter: tuple[float, float] = (0.0, 0.0),
        guide_jitter: tuple[float, float] = (0.0, 0.0),
        reset: bool = False,
        samples: int | None = None,
        world_to_camera: np.ndarray | None = None,
        fov_x: float | None = None,
        encoding: str = "scene-linear",
    ) -> dict[Role, Tensor]:
        """Run the passes on planes that lie in the device's memory, and leave the results there.

        For renderers and training that keep their pictures on the GPU: nothing is uploaded, and
        results are shared by DLPack and `__cuda_array_interface__`, as in
        `torch.from_dlpack(result[Role.COLOUR])`. The results of the next call are on other memory.
        Planes that are always in the same memory are launched as a CUDA graph.

        Nothing looks at the pixels: cuts are known by `reset` alone, pixels that are not finite
        count as black or as the largest light, and what does not move is not told apart. Only a
        plane 'strength', and where reflections are followed depth and motion, are copied to the
        host.

        Args:
            planes, guides: role -> (height, width, channels) float32 without gaps, of any library
                with DLPack or CUDA's array interface. What is in the host's memory is uploaded.
            exposure: stops; None to have the pipeline's meter look at a copy of the colour.
            number, jitter, guide_jitter, reset, samples, world_to_camera, fov_x, encoding: as in
            `Frame`.

        Raises FrameError for planes that do not fit together, BindingError for arrays that cannot
        be read, ExposureError for stops that are not a number within -64..64, EncodingError while
        another thread's frame runs.
        """
        with self._alone():
            last, last_guides = self._last_on_device
            tensors = share_planes(self.device, "plane", planes, last)
            sharp = share_planes(self.device, "guide", guides or {}, last_guides)
            self._last_on_device = tensors, sharp
            spec = spec_of(tensors, sharp, encoding)
            plan = self._make_plan(spec)
            self.ahead = ()
            self.run_up_ms = 0.0
            self.cut = reset
            self.bad_pixels = {}
            if reset:
                self._reset_passes()
            self.exposure_factor = self._exposure_of(exposure, tensors, number, reset)
            used = {role: tensors[role] for role in plan.planes}
            seen = {role: sharp[role] for role in plan.guides}
            resident = ResidentFrame(
                plan.input, dict(used), number, jitter, self.exposure_factor, reset,
                samples=samples, fov_x=fov_x, world_to_camera=world_to_camera, guides=seen,
                guide_jitter=guide_jitter, came_on_device=True,
                host_planes=Downloads(used), host_guides=Downloads(seen))
            result = self._flow.run_on_device(resident, plan)
            self._begins_shot, self.timings = False, dict(self._flow.timings)
        same_size = (plan.output.width, plan.output.height) == (spec.width, spec.height)
        return {role: tensor for role, tensor in tensors.items()
                if same_size and role not in plan.planes} | result

    def _exposure_of(self, given: float | None, tensors: Mapping[Role, Tensor], number: int,
                     reset: bool) -> float:
        if given is not None:
            return factor_of(given)
        if Role.COLOUR not in tensors:
            return 1.0
        return self._meter(Frame({Role.COLOUR: tensors[Role.COLOUR].download()}, number,
                                 reset=reset))

    def compile(self, spec: FrameSpec, views: Sequence[str] = ()) -> Plan:
        """Make the passes ready for frames of a spec, so that the first one does not wait for it;
        the plan.

        views: names of the other views that each frame will hold, which have the same spec.
        Networks are loaded and kernels compiled. Raises ModelError and the like, as the first frame
        would.
        """
        for name in views:
            self._of_view(name).compile(spec)
        return self._make_plan(spec, self._wrap == WRAP_AROUND)

    def explain(self, spec: FrameSpec | None = None) -> Plan:
        """The plan for a spec, by default the last frame's, with what frames were spared so far.
        `print` it, or take `as_dict()` or `to_json()`."""
        if spec is not None:
            return make_plan(self.passes, spec)
        if self.plan is None:
            raise FrameError("there is no plan yet: give explain() a FrameSpec, or process a frame "
                             "first")
        return dataclasses.replace(self.plan, skips=(*self.plan.skips, *self.savings()))

    def savings(self) -> list[Skip]:
        """What the passes spared the frames so far, with the time that it saved."""
        steps = self.plan.steps if self.plan else ()
        return [Skip(f"{what} in {step.name}", why) for step in steps
                for what, why in step.instance.savings()]

    def reset(self) -> None:
        """Drop all history: the next frame is treated as the first of a sequence."""
        self._meter.reset()
        if self._detector:
            self._detector.reset()
        self._reset_passes()
        for own in self._views.values():
            own.reset()

    def remembers(self, plan: Plan) -> bool:
        """Whether results of this plan may depend on earlier frames."""
        passes = any(type(step.instance).reset is not Pass.reset for step in plan.steps)
        return bool(plan.steps) and (passes or getattr(self._meter, "remembers", True))

    def history(self) -> dict[str, np.ndarray] | None:
        """Between two frames: everything beside the next frame that its result depends on, by name.

        None before the first frame, and where a pass or the meter has a history that it does not
        tell. The arrays hold until the next frame begins.
        """
        if self.plan is None:
            return None
        found = {name: part.history()
                 for name, part in self._rememberers().items() if hasattr(part, "history")}
        found |= {f"{_VIEW}{name}": own.history() for name, own in self._views.items()}
        if len(found) < len(self._rememberers()) + len(self._views) or None in found.values():
            return None
        return {f"{name}/{key}": array for name, history in found.items()
                for key, array in (history or {}).items()}

    def recall(self, frame: Frame, history: Mapping[str, np.ndarray]) -> None:
        """Go on as a pipeline whose last frame was `frame`, and that then had this `history`.

        Raises FrameError when it is the history of other passes or of frames of another size.
        """
        self.reset()
        self._make_plan(frame.spec, self._is_panorama(frame))
        try:
            for key in history:
                if not key.startswith(_VIEW):
                    self._rememberers()[key.partition("/")[0]]
            for name, part in self._rememberers().items():
                part.recall(_histories_under(name, history))
            for name, view in frame.views.items():
                self._of_view(name).recall(view, _histories_under(f"{_VIEW}{name}", history))
            self._begins_shot = False
        except (KeyError, ValueError, IndexError, BindingError) as error:
            self.reset()
            raise FrameError(f"frame {frame.number}: the history does not fit the passes: "
                             f"{error}") from error

    def _rememberers(self) -> dict[str, Any]:
        """Whatever may have a history, by name."""
        found = {f"pass {step.name}": step.instance
                 for step in (self.plan.steps if self.plan else ())}
        return found | {"meter": self._meter} | ({"cuts": self._detector} if self._detector else {})

    def _make_plan(self, spec: FrameSpec, around: bool = False) -> Plan:
        """The plan for frames of a spec, with its passes ready. around: whether the frames' right
        edge goes on at the left one."""
        if (self.plan is not None and self.plan.available == spec
            and around == (self._widened is not None)):
            return self.plan
        plan = make_plan(self.passes, spec)
        wide = widened_plan(self.passes, plan) if around else None
        last = self._widened[0] if self._widened else self.plan
        ready = {step.instance: step.input for step in last.steps} if last else {}
        self.plan = None  # until all passes are ready
        self._widened = wide
        for step in wide[0].steps if wide else plan.steps:
            self._make_ready(step, ready.get(step.instance))
        self.plan = plan
        LOG.info("ready for frames of %dx%d: %s", spec.width, spec.height,
                 ", ".join(step.name for step in plan.steps) or "no pass has anything to do")
        for remark in self._told_remarks(plan):
            LOG.info("%s", remark)
        return plan

    def _told_remarks(self, plan: Plan) -> list[str]:
        """Remarks on a plan that are worth a line in the log."""
        return list(plan.remarks)

    def _make_ready(self, step: Step, before: FrameSpec | None) -> None:
        """Compile a pass, if it is not ready as it is, and cannot go on with frames of another
        size."""
        if before != step.input and not (before and step.instance.resize(step.input)):
            self._flow.forget()
            step.instance.compile(self.device, step.input)

    def _run_up_to(self, frame: Frame, plan: Plan) -> Frame:
        """The frame to run in place of one that begins a shot. If a pass profits from a history,
        the run-up fills it from the frames after."""
        if self._run_up is None:
            return frame
        plan = self._widened[0] if self._widened else plan
        steps = plan.accumulating_steps()
        if not steps:
            return frame
        begin = time.perf_counter()
        found = self._run_up(frame, partial(self._run_ahead, plan, steps))
        self.run_up_ms = (time.perf_counter() - begin) * 1000
        return found

    def _run_ahead(self, plan: Plan, steps: Sequence[Step], frame: Frame) -> None:
        """Run a frame for nothing but the history of these steps, the first ones of the plan."""
        frame, bad_pixels = repair_nonfinite(dataclasses.replace(frame), plan.planes,
                                             self.device.scratch)
        if frame.reset:
            self._reset_passes()
        frame = widen(frame, self._widened[1]) if self._widened else frame
        self._flow.run_ahead(frame, plan, steps, self.exposure_factor or 1.0,
                             is_unusable(frame, bad_pixels))
        self.ahead += (sum(self._flow.timings.values()),)

    def _reset_passes(self) -> None:
        self._begins_shot = True
        for instance in self.passes:
            instance.reset()


_VIEW = "view "
"""Before the names of other views in a history."""


def _histories_under(name: str, history: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    return {key.removeprefix(f"{name}/"): array
            for key, array in history.items() if key.startswith(f"{name}/")}


class _SharedExposure(ExposureMeter):
    """Meter of a pipeline that runs another view of the frames of another one: both eyes see the
    same exposure."""

    def __init__(self, first: Pipeline) -> None:
        super().__init__("metadata")
        self._first = first

    def __call__(self, frame: Frame) -> float:
        return self._first.exposure_factor or 1.0


def _make_pipeline(
    passes: Sequence[Pass], device: Device | None, meter: ExposureMeter | SmoothExposure, cuts: str,
    run_up: RunUp | None, checks: bool, wrap: str
) -> Pipeline:
    pipeline = Pipeline(passes, device, meter, cuts, run_up, checks, wrap)
    pipeline.reset()
    return pipeline
