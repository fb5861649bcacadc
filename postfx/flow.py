"""The way of one frame through the steps of a plan: upload, encode, commit, wait, download."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from functools import partial

import numpy as np

from postfx.caching import LRUCache
from postfx.errors import PassContractError
from postfx.frame import GUIDE_ROLES, Frame, FrameSpec, Role
from postfx.passes.base import MOST_SIZES, ResidentFrame
from postfx.plan import Plan, Step
from postfx.runtime import CommandBuffer, CommandError, Device, Tensor

MOST_COPIES = MOST_SIZES * (len(Role) + len(GUIDE_ROLES))
"""Planes and guides of all sizes that are kept ready."""


class Flow:
    """Takes frames through passes that are compiled for them.

    Attributes:
        timings: pass name -> milliseconds on the device, of the last frame.
    """

    def __init__(self, device: Device) -> None:
        self._device = device
        # of planes, where the host does not see the device's memory
        self._copies: LRUCache[tuple[str, tuple[int, ...]], Tensor] = LRUCache(MOST_COPIES)
        self.timings: dict[str, float] = {}

    def forget(self) -> None:
        """Give back what was kept ready for the frames so far."""
        self._copies.clear()

    def run(self, frame: Frame, plan: Plan, exposure: float, lost: bool, given: Frame) -> Frame:
        """The frame that comes out; of `given` are the planes that no pass touches, and what is no plane."""
        with self._uploaded(frame, plan, exposure, lost) as resident:
            inputs = dict(resident.tensors)
            with self._device.results_lock:  # the next commit may take the memory of the results
                self._run(plan.steps, resident)
                for step in plan.steps:
                    step.instance.ran(self.timings[step.name])
                return _finished(given, plan, resident, inputs)

    def run_ahead(self, frame: Frame, plan: Plan, steps: Sequence[Step], exposure: float, lost: bool) -> None:
        """Take a frame through the first steps of a plan, for nothing but their history."""
        with self._uploaded(frame, plan, exposure, lost) as resident:
            resident.wanted = False
            with self._device.results_lock:
                self._run(steps, resident)

    @contextmanager
    def _uploaded(self, frame: Frame, plan: Plan, exposure: float, lost: bool) -> Iterator[ResidentFrame]:
        inputs = {role: self._input(role, frame[role]) for role in plan.planes}
        guides = {role: self._input(f"guide {role}", frame.guides[role]) for role in plan.guides}
        try:
            yield _resident(frame, plan.input, inputs, guides, exposure, lost)
        finally:
            for tensor in (*inputs.values(), *guides.values()):
                tensor.release()

    def _input(self, name: str, array: np.ndarray) -> Tensor:
        """A plane as a tensor of this frame. Where it is copied to the device, it always comes to the same memory."""
        if self._device.memory.host_visible:
            return self._device.wrap(name, array)
        place = name, array.shape
        copy = self._copies.get_or_make(place, partial(self._device.heap.tensor, *place))
        return self._device.wrap(name, array, copy)

    def _run(self, steps: Sequence[Step], resident: ResidentFrame) -> None:
        commands = self._device.command_buffer(f"frame {resident.number}", captured=resident.wanted)
        try:
            for step in steps:
                _encode(step, commands, resident)
            commands.keep(*resident.tensors.values())
            commands.commit()
        finally:
            commands.discard()
        _wait(commands)
        self.timings = {step.name: _milliseconds(commands, step.name) for step in steps}


def _wait(commands: CommandBuffer) -> None:
    try:
        commands.wait()
    except CommandError:
        raise
    except BaseException:  # as by Ctrl-C: the planes are in use until the commands are done
        with suppress(CommandError):
            commands.wait()
        raise


def _resident(
    frame: Frame, spec: FrameSpec, tensors: dict[Role, Tensor], guides: dict[Role, Tensor], exposure: float,
    lost: bool
) -> ResidentFrame:
    return ResidentFrame(
        spec=spec,
        tensors=dict(tensors),
        guides=dict(guides),
        guide_jitter=frame.guide_jitter,
        number=frame.number,
        jitter=frame.jitter,
        exposure=exposure,
        reset=frame.reset,
        lost=lost,
        samples=frame.samples,
        world_to_camera=frame.world_to_camera,
        fov_x=frame.fov_x,
        metadata=frame.metadata,
        given={role: frame[role] for role in tensors},
        given_guides={role: frame.guides[role] for role in guides},
    )


def _encode(step: Step, commands: CommandBuffer, resident: ResidentFrame) -> None:
    """Let a pass record its work, then hold it to the output it declared."""
    with commands.group(step.name):
        step.instance.encode(commands, resident)
    output = step.reflection.output
    resident.tensors = {role: resident[role] for role in output.roles if role in resident}
    wrong = [role for role in output.roles if role not in resident or not _fits(resident[role], role, output)]
    if wrong:
        raise PassContractError(f"pass '{step.name}' did not leave plane '{wrong[0]}' as its reflection declares")
    resident.guides = {role: resident.guides[role] for role in output.guide_roles}
    resident.spec = output


def _fits(tensor: Tensor, role: Role, spec: FrameSpec) -> bool:
    return tensor.shape == (spec.height, spec.width, spec.channels(role))


def _finished(frame: Frame, plan: Plan, resident: ResidentFrame, inputs: dict[Role, Tensor]) -> Frame:
    """The frame that comes out: new planes copied from the device, the others as they came in."""
    same_size = (plan.output.width, plan.output.height) == (plan.available.width, plan.available.height)
    unread = [role for role in plan.available.roles if role not in plan.planes and same_size]
    planes = {role: frame[role] for role in unread}
    for role, tensor in resident.tensors.items():
        planes[role] = frame[role] if tensor is inputs.get(role) else tensor.download()
    gone = {} if same_size else {"guides": {}, "guide_size": None, "guide_jitter": (0.0, 0.0), "guide_source": None}
    return dataclasses.replace(frame, planes=planes, encoding=plan.output.encoding, jitter=resident.jitter, **gone)


def _milliseconds(commands: CommandBuffer, name: str) -> float:
    return sum(elapsed for label, elapsed in commands.timings if label.startswith(f"{name}/"))
