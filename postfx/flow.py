"""One frame on its way through the passes: upload, encode, commit, wait, download.

`postfx.pipeline` decides which steps a frame goes through; here it goes.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from functools import partial

import numpy as np

from postfx.caching import LRUCache, SpareMemory
from postfx.errors import PassContractError
from postfx.frame import GUIDE_ROLES, Frame, Role
from postfx.passes import MOST_SIZES, ResidentFrame
from postfx.plan import Plan, Step
from postfx.runtime import CommandBuffer, CommandError, Device, Tensor
from postfx.runtime.encoders import Recordings
from postfx.runtime.memory import address

MOST_COPIES = MOST_SIZES * (len(Role) + len(GUIDE_ROLES))
"""Planes and guides, of all sizes, whose copies are kept ready."""
SMALL_COPY_BYTES = 1 << 20
"""Planes up to this size are copied sooner than commands are recorded again."""


class Flow:
    """Takes frames through the steps of a plan, whose passes are compiled for them.

    Attributes:
        timings: pass name -> milliseconds on the device, of the last frame.
    """

    def __init__(self, device: Device) -> None:
        self._device = device
        self._copies: LRUCache[tuple[str, tuple[int, ...]], Tensor] = LRUCache(MOST_COPIES)
        self._inputs: dict[str, Tensor] = {}  # the last frame's
        self._recordings = Recordings()
        self._results = SpareMemory(least=0, most=8)
        self.timings: dict[str, float] = {}

    def forget(self) -> None:
        """Release the memory that was kept ready for the frames so far."""
        for kept in (self._copies, self._inputs, self._recordings, self._results):
            kept.clear()

    def run(self, frame: Frame, plan: Plan, exposure_factor: float, unusable: bool,
            given: Frame) -> Frame:
        """The frame that comes out.

        Args:
            unusable: whether the next frame should not build on this one.
            given: the frame from which planes that no pass touches, and everything that is not a
                plane, are taken.
        """
        resident = self._upload(frame, plan, exposure_factor, unusable)
        inputs = dict(resident.tensors)
        with self._device.results_lock:  # the next commit may take the memory of the results
            self._run(plan.steps, resident)
            for step in plan.steps:
                step.instance.note_time(self.timings[step.name])
            return _finish(given, plan, resident, inputs, self._results)

    def run_on_device(self, resident: ResidentFrame, plan: Plan) -> dict[Role, Tensor]:
        """The planes that come out of a frame in the device's memory, each on memory of its own."""
        given, memory = dict(resident.tensors), self._device.memory
        with self._device.results_lock:
            self._run(plan.steps, resident)
            for step in plan.steps:
                step.instance.note_time(self.timings[step.name])
            found = dict(resident.tensors)
            for role, tensor in found.items():
                if tensor is not given.get(role):
                    found[role] = self._device.heap.tensor(str(role), tensor.shape)
                    memory.copy(found[role].start, tensor.resident().start, tensor.nbytes)
                    self._device.hazards.mark_written(found[role])
            memory.synchronise()
        return found

    def run_ahead(self, frame: Frame, plan: Plan, steps: Sequence[Step], exposure_factor: float,
                  unusable: bool) -> None:
        """Take a frame through the first steps of a plan, for nothing but their history."""
        resident = self._upload(frame, plan, exposure_factor, unusable)
        resident.history_only = True
        with self._device.results_lock:
            self._run(steps, resident)

    def _upload(self, frame: Frame, plan: Plan, exposure_factor: float,
                unusable: bool) -> ResidentFrame:
        """The frame as passes see it: the planes that they read lie on the device."""
        planes = {role: frame.planes[role] for role in plan.planes}
        guides = {role: frame.guides[role] for role in plan.guides}
        parts = {name: frame.parts[name] for name in plan.parts}
        return ResidentFrame(
            plan.input,
            {role: self._input(role, plane) for role, plane in planes.items()},
            number=frame.number,
            jitter=frame.jitter,
            exposure_factor=exposure_factor,
            reset=frame.reset,
            unusable=unusable,
            samples=frame.samples,
            world_to_camera=frame.world_to_camera,
            fov_x=frame.fov_x,
            metadata=frame.metadata,
            guides={role: self._input(f"guide {role}", guide) for role, guide in guides.items()},
            guide_jitter=frame.guide_jitter,
            host_planes=planes,
            host_guides=guides,
            parts={name: self._input(f"part {name}", part) for name, part in parts.items()},
            host_parts=parts,
        )

    def _input(self, name: str, array: np.ndarray) -> Tensor:
        """A plane as a tensor.

        Commands on the same memory as the last frame's need not be recorded again. So the last
        frame's tensor is taken if the plane lies in its memory; and a plane that is copied anyway,
        to a GPU or because it is small, is copied to the same place.
        """
        last = self._inputs.pop(name, None)  # it is no input any more if something fails here
        is_on_gpu = not self._device.memory.host_visible
        if last and not is_on_gpu and (last.start, last.shape) == (address(array), array.shape):
            self._inputs[name] = last
            return last  # it keeps its memory alive, so that nothing else can lie there
        if last and last.allocation.borrowed:
            last.release()
        copy = None
        if is_on_gpu or (last and array.nbytes <= SMALL_COPY_BYTES):
            copy = self._copies.get_or_make((name, array.shape),
                                            partial(self._device.heap.tensor, name, array.shape))
        if copy and not is_on_gpu:
            found = copy
            found.upload(array)
        else:
            found = self._device.wrap(name, array, copy)
        self._inputs[name] = found
        return found

    def _run(self, steps: Sequence[Step], resident: ResidentFrame) -> None:
        """Record the work of some passes on a frame, and wait until it is done."""
        commands = self._device.command_buffer(f"frame {resident.number}",
                                               not resident.history_only, self._recordings)
        try:
            for step in steps:
                _encode(step, commands, resident)
            commands.keep(*resident.tensors.values(), *resident.parts.values())
            commands.commit()
        except BaseException:
            commands.discard()
            raise
        try:
            commands.wait()
        except CommandError:
            raise
        except BaseException:  # as by Ctrl-C: the planes are in use until the commands are done
            with suppress(CommandError):
                commands.wait()
            raise
        self.timings = {step.name: sum([time for label, time in commands.timings
                                        if label.startswith(f"{step.name}/")])
                        for step in steps}


def _encode(step: Step, commands: CommandBuffer, resident: ResidentFrame) -> None:
    """Let a pass record its work, then hold it to the output it declared."""
    with commands.group(step.name):
        step.instance.encode(commands, resident)
    left = resident.tensors
    wrong = [role for role, shape in step.shapes.items()
             if role not in left or left[role].shape != shape]
    if wrong:
        raise PassContractError(f"pass '{step.name}' did not leave plane '{wrong[0]}' as its "
                                "reflection declares")
    resident.spec = step.reflection.output
    resident.tensors = {role: left[role] for role in step.shapes}
    resident.guides = {role: resident.guides[role] for role in resident.spec.guide_roles}


def _finish(frame: Frame, plan: Plan, resident: ResidentFrame, inputs: dict[Role, Tensor],
            results: SpareMemory) -> Frame:
    """The frame that comes out: new planes copied from the device, the others as they came in."""
    same_size = (plan.output.width, plan.output.height) == (plan.available.width,
                                                            plan.available.height)
    unread = [role for role in plan.available.roles if role not in plan.planes and same_size]
    planes = {role: frame.planes[role] for role in unread}
    for role, tensor in resident.tensors.items():
        planes[role] = (frame.planes[role] if tensor is inputs.get(role)
                        else tensor.download(results.empty))
    parts = {name: part for name, part in frame.parts.items() if same_size}
    parts |= {name: tensor.download(results.empty) for name, tensor in resident.parts.items()}
    result = frame.copy_with(planes=planes, encoding=plan.output.encoding, jitter=resident.jitter,
                             parts=parts)
    if same_size:
        return result
    return result.copy_with(guides={}, guide_size=None, guide_jitter=(0.0, 0.0), guide_source=None)
