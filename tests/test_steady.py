"""Frame after frame: no new memory."""

from __future__ import annotations

import os
import sys

import numpy as np
import pytest

import postfx
from postfx.frame import ROLES, Frame, Role
from postfx.runtime import Device

PLANES = (Role.COLOUR, Role.DEPTH, Role.MOTION, Role.NORMAL, Role.DIFFUSE_ALBEDO, Role.SPECULAR_ALBEDO, Role.ROUGHNESS)
WARM, FRAMES = 10, 60


def frame(number: int) -> Frame:
    random = np.random.default_rng(number % 4)
    planes = {role: random.random((135, 240, ROLES[role].channels), np.float32) for role in PLANES}
    return Frame(planes, number=number, jitter=(0.1, -0.2))


def resident_bytes() -> int:
    with open("/proc/self/statm") as file:
        return int(file.read().split()[1]) * os.sysconf("SC_PAGE_SIZE")


@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
def test_sixty_frames_take_no_more_memory_than_ten() -> None:
    device = Device("cpu", threads=2)
    chain = postfx.Pipeline([postfx.DenoiseUpscale(model="s"), postfx.ToneMap()], device)
    frames, heaps, process = [frame(number) for number in range(4)], set(), []
    for number in range(FRAMES):
        chain(frames[number % 4])
        if number >= WARM:
            heaps.add((device.heap.size, device.heap.used, device.heap.peak))
            process.append(resident_bytes())
    assert len(heaps) == 1
    assert max(process) <= 1.01 * process[0] + (1 << 20)
