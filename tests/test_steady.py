"""Frame after frame: no new memory, and no more time."""

from __future__ import annotations

import os
import sys
import time

import numpy as np
import pytest

import postfx
from postfx.frame import ROLES, Frame, Role
from postfx.runtime import Device

PLANES = (Role.COLOUR, Role.DEPTH, Role.MOTION, Role.NORMAL, Role.DIFFUSE_ALBEDO, Role.SPECULAR_ALBEDO, Role.ROUGHNESS)
WARM = 10


def frame(number: int) -> Frame:
    random = np.random.default_rng(number % 4)
    planes = {role: random.random((135, 240, ROLES[role].channels), np.float32) for role in PLANES}
    return Frame(planes, number=number, jitter=(0.1, -0.2))


def resident_bytes() -> int:
    with open("/proc/self/statm") as file:
        return int(file.read().split()[1]) * os.sysconf("SC_PAGE_SIZE")


@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
@pytest.mark.parametrize("threads", [1, 2])
@pytest.mark.parametrize("count", [150, pytest.param(1000, marks=pytest.mark.soak)])
def test_many_frames_take_no_more_memory_than_ten_and_no_more_time(count: int, threads: int) -> None:
    """Memory within 1 % and a MiB. Processor time of the last third's fastest frames is that of the middle one's: what
    grows makes all frames slower, other programs only some. That is asked of one thread: two wait for each other awake,
    the longer the more other programs run."""
    device = Device("cpu", threads=threads)
    chain = postfx.Pipeline([postfx.DenoiseUpscale(model="s"), postfx.ToneMap()], device)
    frames, heaps, process, times = [frame(number) for number in range(4)], set(), [], []
    for number in range(count):
        began = time.process_time()
        chain(frames[number % 4])
        if number >= WARM:
            times.append(time.process_time() - began)
            heaps.add((device.heap.size, device.heap.used, device.heap.peak))
            process.append(resident_bytes())
    assert len(heaps) == 1
    assert max(process) <= 1.01 * process[0] + (1 << 20)
    third = len(times) // 3
    middle, last = (np.quantile(part, 0.1) for part in (times[-2 * third:-third], times[-third:]))
    assert threads > 1 or last < 1.25 * middle
    print(f"{count} frames, {threads} threads: {process[0] / 1e6:.1f} MB at frame {WARM + 1}, "
          f"{max(process) / 1e6:.1f} MB at most; processor time a frame {1e3 * middle:.1f} ms in the middle third, "
          f"{1e3 * last:.1f} ms in the last")
