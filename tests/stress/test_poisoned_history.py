"""A broken history is forgotten within two frames: a NaN in it would otherwise stay to the end of a
shot."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import numpy as np
import pytest

from postfx.frame import Frame, Role
from postfx.kernels import Kernel
from postfx.kernels.denoise import DISTRUST
from postfx.kernels.denoise.prepare import ACCUMULATE
from postfx.kernels.denoise.upsample import UPSAMPLE, UPSAMPLE_GUIDED
from postfx.passes.tonemap import ToneMap
from postfx.pipeline import Pipeline
from postfx.runtime import Device
from tests.kernels import denoise_cases, host_cuda
from tests.kernels.test_cuda_kernels import by_cuda
from tests.kernels.test_denoise_kernels import assert_same
from tests.stress.scenes import colours, display_psnr, on, pipeline, portable, way

BROKEN = (np.nan, np.inf, -np.inf, 3e38)
AT = 3
"""First frame that has a broken history."""
LOST = 1.0
"""Decibels by which the second frame after it may be worse than one that begins a shot there."""
CASE = denoise_cases.Case(33, 47, 66, 94)


def poisoned(chain: Pipeline, frames: list[Frame], value: float) -> Pipeline:
    """The pipeline after some frames, with what it remembers of light replaced."""
    for frame in frames:
        chain(frame)
    history = {name: np.array(kept) for name, kept in chain.history().items()}
    for name, kept in history.items():
        if kept.ndim >= 3 or name.endswith("held"):
            kept[:] = value
    chain.recall(frames[-1], history)
    return chain


@pytest.mark.parametrize("value", [
    pytest.param(value, marks=pytest.mark.soak if value == -np.inf else []) for value in BROKEN],
                         ids=str)
@on(cpu=("s.fp32", "m.int8", "s.fp32, portable"), gpu=("s.fp32", "m.fp16", "s.fp32, portable"))
def test_all_of_the_history(
    model: str, value: float, rooms: list[Frame], device: Device, unbroken: Callable
) -> None:
    model, place = way(model, device)
    chain = poisoned(pipeline(model, place), rooms[:AT], value)
    found = [chain(frame)[Role.COLOUR] for frame in rooms[AT:]]
    (fresh,) = colours(rooms[AT + 1:AT + 2], model, device)
    wanted = unbroken(model, device)
    assert all(np.isfinite(colour).all() and colour.min() >= 0 for colour in found)
    assert display_psnr(found[1], wanted[AT + 1]) > display_psnr(fresh, wanted[AT + 1]) - LOST
    assert display_psnr(found[-1], wanted[-1]) > display_psnr(found[1], wanted[AT + 1])


@pytest.mark.parametrize("value", BROKEN, ids=str)
@pytest.mark.parametrize("tag", ["local", "auto"])
def test_what_the_tone_mapper_holds(tag: str, value: float, rooms: list[Frame],
                                    device: Device) -> None:
    """As if there was none before, at once."""
    chain = Pipeline([ToneMap(look=tag)], device, 0.0, cuts="none")
    frames = [Frame({Role.COLOUR: frame[Role.COLOUR]}, number)
              for number, frame in enumerate(rooms[:3])]
    fresh = chain(frames[2])[Role.COLOUR]
    chain.reset()
    poisoned(chain, frames[:2], value)
    np.testing.assert_array_equal(chain(frames[2])[Role.COLOUR], fresh)


def by_all(kernel: Kernel, inputs: dict[str, np.ndarray],
           device: Device) -> list[dict[str, np.ndarray]]:
    """What the device's own way (compiled rows, or the CUDA source on a GPU), the portable
    definition there and, with a compiler, the CUDA source on the host write."""
    found = [denoise_cases.run(kernel, place, inputs, CASE) for place in (device, portable(device))]
    if host_cuda.COMPILER is not None:
        shapes = {written: denoise_cases.shape(kernel, written, CASE) for written in kernel.writes}
        found.append(denoise_cases.in_frame(kernel, by_cuda(kernel, inputs, shapes), CASE))
    return found


def spoiled(kernel: Kernel, name: str, channels: int | None = None) -> dict[str, np.ndarray]:
    """A kernel's arguments, one of them with broken values in its first channels."""
    inputs = denoise_cases.arguments(kernel, CASE)
    flat = inputs[name][..., :channels].reshape(-1).copy()
    flat[::31] = np.resize(BROKEN, flat[::31].size)
    inputs[name][..., :channels] = flat.reshape(inputs[name][..., :channels].shape)
    # where it is not known, it counts nothing, and what is left of 3e38 is a matter of rounding
    if name == "past":
        inputs[name][..., 3] = np.abs(inputs[name][..., 3]) + 0.1
    return inputs


@pytest.mark.parametrize(("kernel", "name"), [(ACCUMULATE, "past"), (ACCUMULATE, "fine"),
                                              (UPSAMPLE, "warped"), (UPSAMPLE_GUIDED, "warped")],
                         ids=lambda one: getattr(one, "name", one))
def test_all_definitions_forget_alike(kernel: Kernel, name: str, device: Device) -> None:
    wanted, *others = by_all(kernel, spoiled(kernel, name, 3 if name == "past" else None), device)
    assert all(np.isfinite(value).all() for value in wanted.values())
    for found in others:
        assert_same(found, wanted)


@pytest.mark.parametrize("value", BROKEN, ids=str)
def test_light_is_this_frames_where_a_broken_one_counts_nothing(value: float,
                                                               device: Device) -> None:
    """The network's distrust is 1 there, as rounding in half precision makes it."""
    inputs = denoise_cases.arguments(ACCUMULATE, CASE)
    inputs["fine"][:, DISTRUST] = 1.0
    inputs["past"][..., :3] = 0.0
    wanted = by_all(ACCUMULATE, inputs, device)
    inputs["past"][..., :3] = value
    for found, fresh in zip(by_all(ACCUMULATE, inputs, device), wanted, strict=True):
        np.testing.assert_allclose(found["level"][:3], fresh["level"][:3], rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize("kernel", [UPSAMPLE, UPSAMPLE_GUIDED], ids=lambda kernel: kernel.name)
def test_a_networks_broken_answer_gives_finite_light(kernel: Kernel, device: Device) -> None:
    for found in by_all(kernel, spoiled(kernel, "fine"), device):
        assert all(np.isfinite(value).all() and value.min() >= 0 for value in found.values())


@pytest.fixture(scope="module")
def unbroken(rooms: list[Frame]) -> Callable[[str, Device], list[np.ndarray]]:
    """What the undisturbed run of a model on a device gives."""
    return cache(lambda model, device: colours(rooms, model, device))
