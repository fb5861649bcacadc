"""The passes on one arena: the same pictures as on memory of their own, and nothing new from frame
to frame."""

from __future__ import annotations

import gc
import threading
import tracemalloc

import numpy as np
import pytest

import postfx
import postfx.runtime.device as device_module
from postfx.frame import GUIDE_ROLES, ROLES, Frame, Role
from postfx.runtime import Device
from postfx.runtime.device import ProviderMemory
from postfx.runtime.heap import Heap
from postfx.runtime.session import Placement
from postfx.tools.report.capture_data import compare
from postfx.tools.report.page import write_capture
from tests import toys

PLANES = (Role.COLOUR, Role.DEPTH, Role.MOTION, Role.NORMAL, Role.DIFFUSE_ALBEDO,
          Role.SPECULAR_ALBEDO, Role.ROUGHNESS)
WARM, FRAMES = 3, 12
CHAINS = {
    "upscale, tone map": ({}, ()),
    "weak, with alpha": ({"strength": 0.5}, (Role.ALPHA, Role.STRENGTH)),
    "resampled only": ({"strength": 0}, (Role.ALPHA,)),
    "same size": ({"scale": 1}, ()),
}


def make_frame(number: int = 0, size: tuple[int, int] = (70, 50), more: tuple[Role, ...] = (),
               **kept) -> Frame:
    random = np.random.default_rng(number % 4)
    planes = {role: random.random((*size[::-1], ROLES[role].channels), np.float32)
              for role in (*PLANES, *more)}
    return Frame(planes, number=number, **kept)


def make_chain(device: Device, **options) -> postfx.Pipeline:
    return postfx.Pipeline([postfx.DenoiseUpscale(model="s.fp32", **options), postfx.ToneMap()],
                           device, exposure=0.0)


@pytest.fixture
def remote(monkeypatch) -> Device:
    """A device whose memory the host cannot look at."""
    placement = Placement("CPUExecutionProvider", "cpu", 0, 2)
    monkeypatch.setattr(device_module, "choose",
                        lambda *rest: (placement, ProviderMemory(placement)))
    return Device("auto")


@pytest.fixture(params=["host", "remote"])
def device(request) -> Device:
    return (Device("cpu", threads=2) if request.param == "host"
            else request.getfixturevalue("remote"))


def state_of(heap: Heap) -> tuple[int, ...]:
    return heap.allocations, heap.arena.plans, heap.size, heap.used, heap.peak


@pytest.mark.parametrize("case", CHAINS)
def test_steady_frames_allocate_nothing(device, case):
    options, more = CHAINS[case]
    chain, states = make_chain(device, **options), set()
    for number in range(FRAMES):
        chain(make_frame(number, more=more))
        if number >= WARM - 1:
            states.add(state_of(device.heap))
    assert len(states) == 1 and device.heap.arena.plans <= 2  # a first frame has no history to warp


@pytest.mark.parametrize("case", CHAINS)
def test_every_tensor_is_as_on_memory_of_its_own(case, monkeypatch, tmp_path):
    options, more = CHAINS[case]
    for folder in ("shared", "own"):
        if folder == "own":
            monkeypatch.setattr(Heap, "transient", Heap.tensor)
        device = Device("cpu", threads=2)
        chain = make_chain(device, **options)
        chain(make_frame(0, more=more))
        with device.capture("all", folder=tmp_path / folder) as capture:
            chain(make_frame(1, more=more))
        write_capture(capture, tmp_path / folder, case)
        assert (device.heap.arena.plans > 0) == (folder == "shared")
    found = compare(tmp_path / "shared", tmp_path / "own", tolerance=0.0)
    assert found.first is None and len(found.differences) > 4


def test_the_upscaler_and_the_tone_mapper_share(device):
    chain = make_chain(device)
    chain(make_frame())
    plan = device.heap.arena.plan
    assert plan.nbytes <= 1.02 * plan.bound < 0.9 * plan.total
    assert ("arena", plan.nbytes) in device.heap.tensors()


def test_a_size_that_comes_back_finds_its_plan():
    device = Device("cpu", threads=2)
    chain = make_chain(device)
    small, large = make_frame(0), make_frame(0, (90, 60))
    first = chain(small)
    used = device.heap.used
    chain(large)
    assert device.heap.arena.plans == 2
    again = chain(small)
    assert np.array_equal(first[Role.COLOUR], again[Role.COLOUR])
    assert device.heap.arena.plans == 2 and device.heap.used == used


def test_frames_that_need_other_commands_leave_addresses_alone():
    device = Device("cpu", threads=2)
    chain = make_chain(device, scale=1)
    # the first are given detail back, the second are not
    clean, noisy = {"samples": 64}, {"samples": 4}
    for number, kept in enumerate((clean, noisy)):
        chain(make_frame(number, **kept))
    states = set()
    for number in range(8):
        chain(make_frame(number, **(clean, noisy)[number % 2]))
        states.add(state_of(device.heap))
    # of the two kinds, and of the first frame
    assert (len(states) == 1 and device.heap.arena.plans <= 3)


def test_objects_and_bytes_on_the_host_stay_as_many():
    device = Device("cpu", threads=2)
    chain, frames = make_chain(device), [make_frame(number) for number in range(4)]
    tracemalloc.start()  # before the first frame, as the pipeline keeps something of the last one
    for number in range(10):
        chain(frames[number % 4])
    gc.collect()
    before, objects = tracemalloc.get_traced_memory()[0], len(gc.get_objects())
    for number in range(40):
        chain(frames[number % 4])
    gc.collect()
    grown, more = tracemalloc.get_traced_memory()[0] - before, len(gc.get_objects()) - objects
    tracemalloc.stop()
    assert more < 40 and grown < 64_000  # less than an object and two kilobytes a frame


def test_two_threads_on_one_device_get_their_own_pictures():
    device = Device("cpu", threads=2)
    chains = [make_chain(device, scale=2), make_chain(device, scale=1)]
    alone = [[make_chain(Device("cpu", threads=2), scale=scale)(make_frame(0))[Role.COLOUR]]
             for scale in (2, 1)]
    results: list[list[np.ndarray]] = [[], []]

    def run(which: int) -> None:
        for _ in range(6):
            chains[which].reset()
            results[which].append(chains[which](make_frame(0))[Role.COLOUR])

    threads = [threading.Thread(target=run, args=(which,)) for which in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    for pictures, (picture,) in zip(results, alone, strict=True):
        assert len(pictures) == 6 and all(np.array_equal(picture, other) for other in pictures)


def test_guides_are_resampled_into_shared_memory(remote):
    guides = toys.make_guides((140, 100), GUIDE_ROLES)
    given = make_frame(0, guides=guides)
    one = make_chain(remote)(given)[Role.COLOUR]
    other = make_chain(Device("cpu", threads=2))(given)[Role.COLOUR]
    np.testing.assert_allclose(one, other, atol=2e-3)
    assert remote.heap.arena.plans == 1
